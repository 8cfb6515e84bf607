//! What stands below the options in `--help` and in the manual pages of every command: examples, exit status, files.

use super::Cli;
use clap::CommandFactory;

/// Examples of a command, and the files that it reads and writes.
struct Further {
    command: &'static str,
    examples: &'static [&'static str],
    files: &'static [&'static str],
}

const STATUS: &str = "0  everything was done; what does not apply to a campaign, and what is left out by hand, is no failure
  1  done, but something failed or was refused; the messages say what
  2  wrong usage, or input that cannot be read";

/// What holds of every command that writes results.
const RESULTS: &str = "OUT/<run id>/ has the files of a run, OUT those of several; OUT is calfit-out, or the folder of -o";

const FURTHER: [Further; 19] = [
    Further {
        command: "lin",
        examples: &[
            "calfit lin CAMPAIGN -o OUT",
            "calfit lin CAMPAIGN/13-04-03/09-22-38.CCR --max-field x=1900 --robust",
            "calfit lin CAMPAIGN --exclude '13-04-03_09-22-38#12=door opened'",
        ],
        files: &[RESULTS, "PARAMETER_LIN__*.CPF  parameters; REPORT_LIN__*.md, LIN_*.png, LIN_BLOCKS__*.csv beside it"],
    },
    Further {
        command: "offset",
        examples: &["calfit offset CAMPAIGN -o OUT", "calfit offset CAMPAIGN --cpf OUT/RUN/PARAMETER_LIN__RUN.CPF"],
        files: &[RESULTS, "OFF_PARAMETER__*.OPF  offsets and residual field"],
    },
    Further {
        command: "freq",
        examples: &["calfit freq CAMPAIGN -o OUT", "calfit freq --amplitudes freq_13-04-03-14-41-31.csv"],
        files: &[RESULTS, "FREQ_PARAMETER__*.FPF  sampling frequency, amplitudes, -3 dB frequencies"],
    },
    Further {
        command: "thermal",
        examples: &["calfit thermal CAMPAIGN -o OUT", "calfit thermal OUT --order sigma=1 --order b_or=3", "calfit thermal CAMPAIGN --joint"],
        files: &[RESULTS, "THERMAL_PARAMETER__*.TPF, THERMAL_OFF_PARAMETER__*.TOF, THERMAL_AC_PARAMETER__*.TAF  polynomials"],
    },
    Further {
        command: "null",
        examples: &["calfit null CAMPAIGN -o OUT", "calfit null CAMPAIGN --order 2"],
        files: &[RESULTS, "NULL_PARAMETER__*.toml  drift, noise, Allan deviation, correlations"],
    },
    Further {
        command: "thermistor",
        examples: &["calfit thermistor pt1000.csv -o OUT"],
        files: &["THERMISTOR_*.toml  the polynomial, with its report and figure beside it in OUT"],
    },
    Further {
        command: "report",
        examples: &[
            "calfit report CAMPAIGN -o OUT",
            "calfit report CAMPAIGN --robust --order 1 --order null=2 --order sigma=1",
            "calfit report CAMPAIGN --exclude '13-04-03_09-22-38:120-180=crane moved' --json",
        ],
        files: &[
            RESULTS,
            "REPORT.md, REPORT.html  the protocol; the page needs no other file, its pictures lead to those beside it",
            "campaign.toml  in CAMPAIGN: positions, channels, limits, what is left out, what the protocol states",
        ],
    },
    Further {
        command: "apply",
        examples: &[
            "calfit apply THERMAL_PARAMETER__26-03-02-08-00-00.TPF THERMAL_OFF_PARAMETER__26-03-02-08-31-00.TOF day.parquet -o out",
            "calfit apply PARAMETER_LIN__26-03-02_08-00-00.CPF 26-03-02_08-00-00.CCR --frame coil -o out",
        ],
        files: &[
            "parameters: one CPF, TPF or TCF file, or a ground calibration file RPCMAG_GND_CALIB_*.TXT; with a TPF also a TOF or OPF file for
  the offset of the sensor alone",
            "data: run files, or tables with the columns x, y, z (enT) and t_degc (°C)",
            "OUT/<stem of the data>.calibrated.parquet, or .csv  field, uncertainty and flags",
        ],
    },
    Further {
        command: "flight",
        examples: &[
            "calfit flight ABC flight.toml -o OUT",
            "calfit flight all flight.toml --from 2015-06-29 --to 2015-06-30 --sensor OB -o OUT",
            "calfit flight carry flight.toml -o carry.parquet",
            "calfit flight daily flight.toml -o daily",
        ],
        files: &[
            "flight.toml  sensors, ground calibration files, modes, frames, tables; docs/reference/flight.md has all its keys",
            "OUT/level=A/sensor=OB/date=YYYY-MM-DD/calfit-A-OB-YYYYMMDD.parquet  a level of a sensor and day",
        ],
    },
    Further {
        command: "export",
        examples: &["calfit export --format csv OUT/RUN/PARAMETER_LIN__RUN.CPF"],
        files: &["the parameter file in another format, in OUT"],
    },
    Further {
        command: "simulate",
        examples: &["calfit simulate configs/demo.toml -o CAMPAIGN --seed 3"],
        files: &["CAMPAIGN/campaign.toml and CAMPAIGN/YY-MM-DD/hh-mm-ss.CCR  a campaign like a measured one"],
    },
    Further {
        command: "coil",
        examples: &["calfit coil scalar CAMPAIGN -o OUT", "calfit coil residual nulling.csv", "calfit coil tilt orientations.csv"],
        files: &["COIL_SCALAR__*.toml, COIL_RESIDUAL__*.toml, COIL_TILT__*.toml  the facility, as --facility takes it"],
    },
    Further {
        command: "diagnose",
        examples: &[
            "calfit diagnose tests/data/cases/26-05-02.CCR.gz -o diagnosis",
            "calfit diagnose CAMPAIGN --write-model model.toml",
            "calfit diagnose CAMPAIGN --model model.toml -o again",
        ],
        files: &[
            "OUT/<run id>/diagnosis.json, a report as Markdown and HTML, and figures: where readings and model disagree before anything is
  named, what is left without and with each effect, what happens inside the plateaus, and the evidence of the effect beside that of
  its rivals; `calfit effects` lists what can be named",
        ],
    },
    Further {
        command: "effects",
        examples: &["calfit effects", "calfit effects cubic_nonlinearity -o effect"],
        files: &[
            "with -o DIR the pictures of the effect: its contribution to the readings of an example run, against what it follows and
  against time; effects that only a comparison of several runs shows have none",
        ],
    },
    Further { command: "inspect", examples: &["calfit inspect CAMPAIGN"], files: &["nothing is written"] },
    Further { command: "check", examples: &["calfit check CAMPAIGN", "calfit check OUT/RUN/PARAMETER_LIN__RUN.CPF"], files: &["nothing is written"] },
    Further {
        command: "verify",
        examples: &["calfit verify OUT CAMPAIGN", "calfit verify OUT/RUN/PARAMETER_LIN__RUN.CPF CAMPAIGN"],
        files: &["nothing is written; inputs are looked for beside the file, in the named folders and above them"],
    },
    Further {
        command: "completions",
        examples: &["calfit completions bash > ~/.local/share/bash-completion/completions/calfit"],
        files: &["the script goes to standard output"],
    },
    Further { command: "man", examples: &["calfit man ~/.local/share/man/man1"], files: &["DIR/calfit.1, DIR/calfit-lin.1 ...  manual pages"] },
];

/// The whole command line, with what stands below the options.
pub(super) fn command() -> clap::Command {
    FURTHER.iter().fold(Cli::command(), |command, further| {
        if command.find_subcommand(further.command).is_none() {
            return command;
        }
        command.mut_subcommand(further.command, |own| own.after_long_help(text(further)))
    })
}

fn text(further: &Further) -> String {
    format!(
        "EXAMPLES:\n  {}\n\nEXIT STATUS:\n  {STATUS}\n\nFILES:\n  {}",
        further.examples.join("\n  "),
        further.files.join("\n  ")
    )
}
