//! The command line: arguments, progress, exit status. No mathematics, no file layout.

#[cfg(feature = "tables")]
mod apply;
mod check;
mod coil;
mod diagnose;
mod each;
mod effects;
mod export;
#[cfg(feature = "tables")]
mod flight;
mod freq;
mod help;
mod import;
mod inspect;
mod lin;
mod null;
mod offset;
mod options;
mod output;
mod report;
mod shell;
mod simulate;
mod thermal;
mod thermistor;
mod verify;

use crate::data::error::{Finding, Severity};
use crate::data::index::INDEX_FILE;
use crate::data::run::Kind;
use crate::data::run_state::{Outcome, RunState};
use crate::files::campaign::Campaign;
use crate::files::campaign::file::CampaignFile;
use crate::workflow::{Desk, Failure, Job, Left, Results, jobs};
use clap::parser::ValueSource;
use clap::{ArgAction, ArgMatches, Args, ColorChoice, FromArgMatches, Parser, Subcommand, ValueEnum};
use options::Excluding;
pub use output::Output;
use output::Terminal;
use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::process::ExitCode;

/// Ground calibration of fluxgate magnetometers at a coil facility.
///
/// From a campaign folder of run files to parameter files with uncertainties, figures and report tables.
#[derive(Debug, Parser)]
#[command(name = "calfit", version, propagate_version = true, arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Linear calibration of every linearity run: sensitivity, misalignment, rotation, offset.
    Lin(lin::Arguments),
    /// Sensor offset and residual field of every offset run, from normal and turned positions.
    Offset(offset::Arguments),
    /// Sampling frequency and frequency response of every frequency run, or of a table of amplitudes.
    Freq(freq::Arguments),
    /// Temperature polynomials of every sensor, mode and location, across runs or parameter files, and at the centre of the coil system.
    Thermal(thermal::Arguments),
    /// Offset drift, noise spectrum, Allan deviation and correlations of every zero-field run.
    Null(null::Arguments),
    /// Polynomial of a thermistor from its calibration table.
    Thermistor(thermistor::Arguments),
    /// Every analysis that a campaign allows, all files, and the protocol as Markdown and one HTML page.
    Report(report::Arguments),
    /// Raw readings to calibrated field, with uncertainty and flags, by parameter files.
    #[cfg(feature = "tables")]
    Apply(apply::Arguments),
    /// Telemetry of a mission to calibrated levels, by ground calibration files and a configuration; also `carry` and `daily`.
    #[cfg(feature = "tables")]
    Flight(flight::Arguments),
    /// Tables of any laboratory, CSV, Parquet or Arrow IPC, to the run files of a campaign; --guess proposes the mapping of the columns.
    Import(import::Arguments),
    /// Parameter files for other programs: JSON, CSV, a digital calibration certificate, a Rosetta-style ground calibration file.
    Export(export::Arguments),
    /// Write the run files of a campaign whose truth is known, from a twin of sensor, facility and programme.
    Simulate(simulate::Arguments),
    /// The facility's own calibration: scalar calibration, residual field, sensor and facility from several orientations.
    Coil(coil::Arguments),
    /// Find where the data disagree with the model, name the missing effect, add it, and show how the gap shrinks.
    Diagnose(diagnose::Arguments),
    /// List the effects that `diagnose` looks for, or explain one: formula, parameters, source, the measurement that shows it best.
    Effects(effects::Arguments),
    /// List the runs of a campaign: file, programme, sensor, mode, settings, vectors, losses, temperatures.
    Inspect(inspect::Arguments),
    /// Validate files and say everything that is wrong with each; changes nothing.
    Check(check::Arguments),
    /// Read the inputs of parameter files again, compare their hashes, fit again and compare the values.
    Verify(verify::Arguments),
    /// Write a completion script for a shell to standard output.
    Completions(shell::Completions),
    /// Write manual pages into a folder.
    Man(shell::Man),
}

/// Options of every command.
#[derive(Args, Clone, Debug)]
struct Common {
    /// Folder for results.
    #[arg(short, long, global = true, value_name = "DIR", default_value = "calfit-out")]
    out: PathBuf,
    /// Whether the folder was named.
    #[arg(skip)]
    out_given: bool,
    /// Print the result as JSON on standard output, and nothing else there.
    #[arg(long, global = true)]
    json: bool,
    /// Do not draw figures.
    #[arg(long, global = true)]
    no_plots: bool,
    /// Write over files that calfit did not write.
    #[arg(long, global = true)]
    force: bool,
    /// Threads to use; 0 is one per core and two that wait for the disk. Results do not depend on it.
    #[arg(long, global = true, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print errors only.
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Print notes as well as warnings.
    #[arg(short, long, global = true, action = ArgAction::Count)]
    verbose: u8,
    /// Colour of messages.
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto")]
    color: ColorChoice,
    /// Go on in spite of a problem with the data; recorded in the results.
    #[arg(long, global = true, value_name = "PROBLEM", value_enum)]
    allow: Vec<Allow>,
    /// The same as `--allow truncated`.
    #[arg(long, global = true)]
    allow_truncated: bool,
    /// The folder for results, where the command has one of a campaign.
    #[arg(skip)]
    results: Results,
}

impl Cli {
    fn of(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut cli = Self::from_arg_matches(matches)?;
        let source = matches.subcommand().and_then(|(_, own)| own.value_source("out"));
        cli.common.out_given = source == Some(ValueSource::CommandLine);
        Ok(cli)
    }
}

/// Threads beside those of the cores: while a file is brought to the disk its thread waits.
const WAITING: usize = 2;

/// Problems with the data that can be allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
enum Allow {
    /// A file that ends before @END.
    Truncated,
    /// More than a few repeated rows.
    Duplicates,
    /// A sensitivity far from its nominal value.
    Gain,
    /// Readings that do not follow the settings.
    Mismatch,
}

impl Common {
    fn allows(&self, problem: Allow) -> bool {
        self.allow.contains(&problem) || (problem == Allow::Truncated && self.allow_truncated)
    }

    /// Where results go, and what is allowed.
    fn desk(&self) -> Desk {
        Desk {
            out: self.out.clone(),
            force: self.force,
            plots: !self.no_plots,
            allow_truncated: self.allows(Allow::Truncated),
            allow_duplicates: self.allows(Allow::Duplicates),
            exclude: Vec::new(),
            results: self.results.clone(),
        }
    }

    /// Refuses a folder of results as the place of a campaign: its runs would lie among the results of another one.
    fn must_hold_no_results(&self) -> Result<(), Finding> {
        if self.force || !self.out.join(INDEX_FILE).is_file() {
            return Ok(());
        }
        let rule = "holds results of a campaign (INDEX.json), and runs would be written among them";
        Err(Finding::error(&self.out.display().to_string(), rule, "choose another folder with -o, or use --force"))
    }

    /// The same, with what is left out by hand.
    fn desk_without(&self, excluding: &Excluding) -> Desk {
        Desk { exclude: excluding.exclude.clone(), ..self.desk() }
    }
}

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Status {
    /// Everything was done.
    Done = 0,
    /// Something failed or was refused.
    Partly = 1,
    /// Wrong usage or unreadable input.
    Unusable = 2,
}

/// Nothing could be used of all that was named: unusable input. Something was used, or refused for a reason: partly done.
fn status<'a>(succeeded: usize, failures: impl IntoIterator<Item = &'a Failure>) -> Status {
    let mut failures = failures.into_iter().peekable();
    if failures.peek().is_none() {
        Status::Done
    } else if succeeded == 0 && failures.all(|f| matches!(f, Failure::Unreadable(_))) {
        Status::Unusable
    } else {
        Status::Partly
    }
}

impl From<Status> for ExitCode {
    fn from(status: Status) -> Self {
        Self::from(status as u8)
    }
}

/// Runs the program. The first argument is its name; results go to `out`, messages to `err`.
///
/// Nothing of the process is changed: the threads belong to the call, and the working folder is only read.
pub fn run<'a>(arguments: impl IntoIterator<Item = OsString>, out: Output<'a>, err: Output<'a>) -> Status {
    let cli = match help::command().try_get_matches_from(arguments).and_then(|matches| Cli::of(&matches)) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version go to standard output and are no error. A reader that has seen enough is none either.
            let (output, other, status) =
                if error.use_stderr() { (err, out, Status::Unusable) } else { (out, err, Status::Done) };
            let text = error.render();
            let text = if output.is_colored(ColorChoice::Auto) { text.ansi().to_string() } else { text.to_string() };
            return match output.to.write_all(text.as_bytes()).and_then(|()| output.to.flush()) {
                Err(error) if status == Status::Done && error.kind() != ErrorKind::BrokenPipe => {
                    // Nobody is left to be told that standard error is closed too.
                    let _ = writeln!(other.to, "error: cannot write to standard output: {error}");
                    Status::Partly
                }
                _ => status,
            };
        }
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = if cli.common.threads > 0 { cli.common.threads } else { cores + WAITING };
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
        Ok(pool) => pool.install(|| told(cli, out, err)),
        Err(error) => {
            let remedy = "ask for fewer with --threads";
            let terminal = Terminal::new(out, err, cli.common.color, false, false);
            terminal.finding(&Finding::error("calfit", format!("{threads} threads cannot be started: {error}"), remedy));
            Status::Unusable
        }
    }
}

/// Runs one command and tells why it could not be run.
fn told<'a>(cli: Cli, out: Output<'a>, err: Output<'a>) -> Status {
    let terminal = Terminal::new(out, err, cli.common.color, cli.common.quiet, cli.common.verbose > 0);
    let status = execute(cli, &terminal).unwrap_or_else(|finding| {
        terminal.finding(&finding);
        Status::Unusable
    });
    // Output that could not be printed is a failure, a reader that has seen enough is not.
    terminal.finish(status)
}

impl Command {
    /// Whether the results belong to a campaign, and their folder has an index.
    fn has_index(&self) -> bool {
        use Command::{Coil, Diagnose, Freq, Lin, Null, Offset, Report, Thermal};
        matches!(self, Lin(_) | Offset(_) | Freq(_) | Thermal(_) | Null(_) | Coil(_) | Diagnose(_) | Report(_))
    }
}

/// Runs one command. The folder for results is this process's alone before anything else is looked at, and its index is written last,
/// whatever became of the command.
fn execute(mut cli: Cli, terminal: &Terminal) -> Result<Status, Finding> {
    if cli.common.json {
        terminal.must_be_open()?;
    }
    if cli.command.has_index() {
        cli.common.results = Results::open(&cli.common.out, cli.common.force)?;
    }
    let results = cli.common.results.clone();
    let status = dispatch(cli, terminal);
    match results.close() {
        Ok(left) => tell_left(&left, terminal),
        Err(finding) => {
            terminal.finding(&finding);
            return status.map(|status| status.max(Status::Partly));
        }
    }
    status
}

/// Names files that are there and rest on others that were changed.
fn tell_left(left: &Left, terminal: &Terminal) {
    const MOST: usize = 3;
    let named = |files: &[String]| {
        let more = if files.len() > MOST { ", ..." } else { "" };
        files.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(", ") + more
    };
    let count = |files: &[String]| if files.len() == 1 { "1 file is".to_owned() } else { format!("{} files are", files.len()) };
    if !left.stale.is_empty() {
        let (count, names) = (count(&left.stale), named(&left.stale));
        terminal.warning(&format!(
            "{count} stale, made from what has changed since: {names}; INDEX.json says why; make them again with `calfit report` or the command of each"
        ));
    }
    if !left.given_up.is_empty() {
        let (count, names) = (count(&left.given_up), named(&left.given_up));
        terminal.warning(&format!(
            "{count} marked: the runs that are left do not give what was made before: {names}; INDEX.json says why; leave them out, or take them away"
        ));
    }
}

fn dispatch(cli: Cli, terminal: &Terminal) -> Result<Status, Finding> {
    match cli.command {
        Command::Lin(arguments) => lin::run(&arguments, &cli.common, terminal),
        Command::Offset(arguments) => offset::run(&arguments, &cli.common, terminal),
        Command::Freq(arguments) => freq::run(&arguments, &cli.common, terminal),
        Command::Thermal(arguments) => thermal::run(&arguments, &cli.common, terminal),
        Command::Null(arguments) => null::run(&arguments, &cli.common, terminal),
        Command::Thermistor(arguments) => thermistor::run(&arguments, &cli.common, terminal),
        Command::Report(arguments) => report::run(&arguments, &cli.common, terminal),
        #[cfg(feature = "tables")]
        Command::Apply(arguments) => apply::run(&arguments, &cli.common, terminal),
        #[cfg(feature = "tables")]
        Command::Flight(arguments) => flight::run(&arguments, &cli.common, terminal),
        Command::Import(arguments) => import::run(&arguments, &cli.common, terminal),
        Command::Export(arguments) => export::run(&arguments, &cli.common, terminal),
        Command::Simulate(arguments) => simulate::run(&arguments, &cli.common, terminal),
        Command::Coil(arguments) => coil::run(&arguments, &cli.common, terminal),
        Command::Diagnose(arguments) => diagnose::run(&arguments, &cli.common, terminal),
        Command::Effects(arguments) => effects::run(&arguments, &cli.common, terminal),
        Command::Inspect(arguments) => inspect::run(&arguments, &cli.common, terminal),
        Command::Check(arguments) => check::run(&arguments, &cli.common, terminal),
        Command::Verify(arguments) => verify::run(&arguments, &cli.common, terminal),
        Command::Completions(arguments) => shell::completions(&arguments, terminal),
        Command::Man(arguments) => shell::manual(&arguments, &cli.common, terminal),
    }
}

/// Opens the campaigns of a list of paths, whose results the folder for results must be able to take, and shows what `campaign.toml` is
/// warned about.
fn open(paths: &[PathBuf], common: &Common, terminal: &Terminal) -> Result<Vec<Campaign>, Finding> {
    open_without(paths, &Excluding::default(), common, terminal)
}

/// The same, with what is left out by hand.
fn open_without(
    paths: &[PathBuf],
    excluding: &Excluding,
    common: &Common,
    terminal: &Terminal,
) -> Result<Vec<Campaign>, Finding> {
    open_beside_files(paths, excluding, excluding, common, terminal)
}

/// The same, where some of what is left out may be of parameter files beside the runs; `of_runs` must be among the runs.
fn open_beside_files(
    paths: &[PathBuf],
    excluding: &Excluding,
    of_runs: &Excluding,
    common: &Common,
    terminal: &Terminal,
) -> Result<Vec<Campaign>, Finding> {
    let mut findings = Vec::new();
    let campaigns = Campaign::open_without(paths, &excluding.exclude, &mut findings)?;
    findings.iter().for_each(|f| terminal.finding(f));
    of_runs.check(&campaigns)?;
    common.results.accept(&campaigns)?;
    Ok(campaigns)
}

/// The runs of a kind in the campaigns of some paths. A campaign without such a run is one to which the analysis does not apply: that is
/// told, and is no failure. Runs that `campaign.toml` names must be there.
fn jobs_of<'a>(campaigns: &'a [Campaign], paths: &[PathBuf], kind: Kind, terminal: &Terminal) -> Result<Vec<Job<'a>>, Finding> {
    let (jobs, unmatched) = jobs(campaigns, Some(kind));
    terminal.unmatched(&unmatched);
    if jobs.is_empty() {
        let shown: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        let listed = CampaignFile::ANALYSES.into_iter().find(|(_, listed)| *listed == kind);
        let listed = listed.filter(|_| campaigns.iter().any(|c| c.file.runs.iter().any(|(of, _)| *of == kind)));
        let shown = shown.join(", ");
        if let Some((group, _)) = listed {
            let rule = format!("holds no {kind} run that `runs` of [{group}] in campaign.toml names");
            let remedy = "correct the ids there, or take the list out; `calfit inspect` lists the runs";
            return Err(Finding::error(&shown, rule, remedy));
        }
        terminal.finding(&does_not_apply(&shown, &kind.to_string()));
    }
    Ok(jobs)
}

/// What is told of a campaign that holds no run of the kinds that an analysis takes.
fn does_not_apply(campaigns: &str, kinds: &str) -> Finding {
    let rule = format!("holds no {kinds} run, so that the analysis does not apply to it");
    Finding::error(campaigns, rule, "list the runs with `calfit inspect`").weighing(Severity::Warning)
}

/// The outcome of a run without a result.
fn refused(failure: &Failure) -> Outcome {
    let errors: Vec<String> = failure.errors().map(|f| format!("{}; {}", f.rule, f.remedy)).collect();
    Outcome::new(RunState::Refused, errors.join("; "))
}

/// Prints the errors of the runs that have no result and counts them.
fn report_failures(terminal: &Terminal, failures: &[(String, Failure)], total: usize) {
    for (_, failure) in failures {
        failure.errors().for_each(|f| terminal.finding(f));
    }
    if !failures.is_empty() && total > 1 {
        let mut names: Vec<&str> = Vec::new();
        // Several analyses of one sensor and mode have one name.
        for (name, _) in failures.iter().filter(|(name, _)| !name.is_empty()) {
            if !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
        terminal.error(&format!("{} of {total} failed: {}", failures.len(), names.join(", ")));
    }
}
