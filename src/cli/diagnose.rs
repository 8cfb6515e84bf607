//! `calfit diagnose`: find what the model misses.

use super::options::{Excluding, refuse_given, without_excluded};
use super::output::{Terminal, json};
use super::{Common, Status, open_without, refused, report_failures, status};
use crate::data::error::Finding;
use crate::data::run::Kind;
#[cfg(feature = "tables")]
use crate::data::time::day_of;
use crate::diagnose;
use crate::files::import::Format;
use crate::files::parameter::{Cpf, is_named};
#[cfg(feature = "tables")]
use crate::workflow::flight::{DifferenceOptions, diagnose_flight};
use crate::workflow::{
    Across, Diagnosed, DiagnosedWith, Failure, diagnose_run, diagnose_table, each, jobs, publish_diagnosis, publish_model,
    read_model, temperature,
};
use clap::Args;
use jiff::civil::Date;
use serde::Serialize;
#[cfg(feature = "tables")]
use std::path::Path;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// A campaign folder or run files; a configuration of flight processing (flight.toml); tables of run results (.csv) and linear calibrations (.CPF) of several runs, which are looked
    /// at together, as are linearity runs of one sensor.
    #[arg(required_unless_present = "amplitudes", value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// A table of amplitudes in place of runs, as `calfit freq --amplitudes` reads it.
    #[arg(long, value_name = "TABLE.csv", conflicts_with_all = ["paths", "model", "write_model", "facility", "temperature", "field", "sensor", "from", "to", "exclude"])]
    amplitudes: Vec<PathBuf>,
    /// Effects that are known already, from `--write-model`: their sizes are fitted again between the plateaus and taken off inside them.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Write the known effects and those that are found into a model file.
    #[arg(long, value_name = "FILE")]
    write_model: Option<PathBuf>,
    /// Facility that turns settings into applied fields: scale, offset and angles of the coil system.
    #[arg(long, value_name = "FILE")]
    facility: Option<PathBuf>,
    /// Polynomials of the sensor (TPF): what linearity runs follow of a sensor temperature that moves is taken off.
    #[arg(long, value_name = "TPF")]
    temperature: Option<PathBuf>,
    /// With a configuration of flight processing: a table of the field at the spacecraft (`time_tt2000` or `time_utc`, `bx by bz`, nT) in the
    /// celestial frame of the configuration; without it the two sensors are compared.
    #[arg(long, value_name = "TABLE")]
    field: Option<PathBuf>,
    /// With a configuration of flight processing: the sensor that is compared.
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// With a configuration of flight processing: first day, YYYY-MM-DD, UTC.
    #[arg(long, value_name = "DATE")]
    from: Option<Date>,
    /// With a configuration of flight processing: last day, YYYY-MM-DD, UTC.
    #[arg(long, value_name = "DATE")]
    to: Option<Date>,
    #[command(flatten)]
    excluding: Excluding,
}

/// What `--json` prints for several runs.
#[derive(Serialize)]
struct Listing<'a> {
    diagnoses: Vec<&'a Diagnosed>,
    failed: Vec<&'a Finding>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if !arguments.amplitudes.is_empty() {
        return tables(&arguments.amplitudes, common, terminal);
    }
    #[cfg(feature = "tables")]
    if let [path] = arguments.paths.as_slice()
        && path.extension().is_some_and(|end| end == "toml")
        && crate::files::flight::is_mission(path)
    {
        return flight(path, arguments, common, terminal);
    }
    if arguments.field.is_some() || arguments.sensor.is_some() || arguments.from.is_some() || arguments.to.is_some() {
        let rule = "--field, --sensor, --from and --to belong to a configuration of flight processing";
        return Err(Finding::error("calfit diagnose", rule, "take them away, or name one flight.toml alone"));
    }
    common.results.places(arguments.facility.iter().chain(&arguments.model).chain(&arguments.temperature));
    let mut together = Across::default();
    let paths = parameters(&arguments.paths, &mut together, common, terminal)?;
    let campaigns = if paths.is_empty() {
        refuse_without_runs(arguments)?;
        Vec::new()
    } else {
        open_without(&paths, &arguments.excluding, common, terminal)?
    };
    let (given, known) = arguments.model.as_ref().map(|path| read_model(path)).transpose()?.unzip();
    let with = DiagnosedWith {
        facility: terminal.facility(arguments.facility.as_ref())?,
        temperature: temperature(arguments.temperature.as_ref())?,
        model: known,
    };
    let (all, unmatched) = jobs(&campaigns, None);
    terminal.unmatched(&unmatched);
    let (mut jobs, excluded) = without_excluded(all, &common.results);
    jobs.retain(|job| job.named || job.header.as_ref().is_none_or(|h| diagnose::takes(h.kind)));
    if jobs.is_empty() && excluded.is_empty() && !paths.is_empty() {
        let shown: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        let rule = "holds no run with steps, sines, a sweep or zero field".to_owned();
        return Err(Finding::error(&shown.join(", "), rule, "list the runs with `calfit inspect`"));
    }
    let desk = common.desk_without(&arguments.excluding);
    let bar = terminal.progress(jobs.len(), "diagnosed");
    let two_threads = jobs.len() < rayon::current_num_threads();
    let results: Vec<Result<Diagnosed, Failure>> = each(&jobs, |job| {
        bar.of(&job.id(), || {
            let made = diagnose_run(job, &desk, &with, two_threads)?;
            let run = made.diagnosis.runs.first().map_or("", String::as_str);
            publish_diagnosis(&made, run, &desk).map_err(Failure::Refused)?;
            Ok(made)
        })
    });
    bar.finish();
    let mut results: Vec<(String, Result<Diagnosed, Failure>)> =
        jobs.iter().map(|job| job.recorded.clone()).zip(results).collect();
    let linear: Vec<_> = jobs.iter().filter(|j| j.header.as_ref().is_some_and(|h| h.kind == Kind::Linearity)).collect();
    let of_runs = together.count() == 0;
    if linear.len() > 1 || !of_runs {
        // What cannot be fitted was named when it was looked at by itself.
        together.runs(&linear, &with.of_runs(), &desk, &mut Vec::new());
        match together.diagnose() {
            Ok(made) => {
                publish_diagnosis(&made, "", &desk)?;
                results.push(("together".to_owned(), Ok(made)));
            }
            // Runs that have nothing in common were looked at one by one.
            Err(finding) if of_runs => terminal.warning(&format!("together: {finding}")),
            Err(finding) => return Err(finding),
        }
    }
    let total = results.len();
    let (done, failures) = told(results, common, terminal)?;
    if !common.json {
        excluded.iter().for_each(|one| terminal.tell(&one.told()));
    }
    let all: Vec<&Diagnosed> = done.iter().collect();
    if let Some(path) = &arguments.write_model {
        publish_model(path, &all, given.as_ref().map(|file| &file.body), common.force)?;
        if !common.json {
            terminal.tell(&format!("model -> {}\n", path.display()));
        }
    }
    report_failures(terminal, &failures, total);
    Ok(status(done.len(), failures.iter().map(|(_, f)| f)))
}

/// The difference of two sensors in flight, or of one and a model of the field.
#[cfg(feature = "tables")]
fn flight(path: &Path, arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if arguments.model.is_some()
        || arguments.write_model.is_some()
        || arguments.facility.is_some()
        || arguments.temperature.is_some()
        || !arguments.excluding.exclude.is_empty()
    {
        let rule = "--model, --write-model, --facility, --temperature and --exclude belong to runs of a facility";
        return Err(Finding::error("calfit diagnose", rule, "take them away"));
    }
    let options = DifferenceOptions {
        field: arguments.field.clone(),
        sensor: arguments.sensor.clone(),
        days: [arguments.from.map(day_of), arguments.to.map(day_of)],
    };
    let mut findings = Vec::new();
    let made = diagnose_flight(path, &options, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let made = made?;
    let desk = common.desk();
    publish_diagnosis(&made, made.diagnosis.runs.first().map_or("", String::as_str), &desk)?;
    let result = std::iter::once((path.display().to_string(), Ok(made)));
    told(result, common, terminal).map(|_| Status::Done)
}

/// Options that say how runs are looked at need runs.
fn refuse_without_runs(arguments: &Arguments) -> Result<(), Finding> {
    arguments.excluding.check(&[])?;
    let given = [
        ("--facility", arguments.facility.is_some()),
        ("--temperature", arguments.temperature.is_some()),
        ("--model", arguments.model.is_some()),
    ];
    let rule = "changes nothing where only tables and parameter files are named";
    refuse_given(&given, rule, "name the runs, or leave it out")
}

/// Tables of amplitudes, one after the other.
fn tables(paths: &[PathBuf], common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    common.results.accept_tables(paths)?;
    let desk = common.desk();
    let mut seen: Vec<String> = Vec::new();
    let results = paths.iter().map(|path| {
        let mut findings = Vec::new();
        let made = diagnose_table(path, &mut findings).map_err(|f| Failure::Unreadable(vec![f])).and_then(|made| {
            let id = made.diagnosis.runs.concat();
            if seen.contains(&id) {
                let rule = format!("gives the run id {id}, as an earlier table does");
                return Err(Failure::Refused(Finding::error(&path.display().to_string(), rule, "rename one of the two")));
            }
            publish_diagnosis(&made, &id, &desk).map_err(Failure::Refused)?;
            seen.push(id);
            Ok(made)
        });
        findings.iter().for_each(|f| terminal.finding(f));
        (path.display().to_string(), made)
    });
    let results: Vec<_> = results.collect();
    let (done, failures) = told(results, common, terminal)?;
    report_failures(terminal, &failures, paths.len());
    Ok(status(done.len(), failures.iter().map(|(_, f)| f)))
}

/// What was made and what failed, by the names of the inputs.
type Sorted = (Vec<Diagnosed>, Vec<(String, Failure)>);

/// Tells of every result.
fn told(
    results: impl IntoIterator<Item = (String, Result<Diagnosed, Failure>)>,
    common: &Common,
    terminal: &Terminal,
) -> Result<Sorted, Finding> {
    let mut done = Vec::new();
    let mut failures = Vec::new();
    for (recorded, result) in results {
        match result {
            Ok(made) => {
                made.diagnosis.notes.iter().for_each(|w| terminal.warning(&format!("{recorded}: {w}")));
                done.push(made);
            }
            Err(failure) => {
                common.results.looked(&recorded, refused(&failure));
                failures.push((recorded, failure));
            }
        }
    }
    let all: Vec<&Diagnosed> = done.iter().collect();
    if common.json {
        let failed: Vec<&Finding> = failures.iter().flat_map(|(_, f)| f.errors()).collect();
        let text = match (all.as_slice(), failed.as_slice()) {
            ([one], []) => json(one)?,
            _ => json(&Listing { diagnoses: all.clone(), failed })?,
        };
        terminal.print(&text);
    } else {
        for made in &all {
            // What holds for several runs stands in the folder itself.
            let id = if made.diagnosis.runs.len() > 1 { "" } else { made.diagnosis.runs.first().map_or("", String::as_str) };
            terminal.tell(&format!(
                "{}  -> {}\n",
                crate::show::diagnose::summary(&made.diagnosis),
                common.out.join(id).display()
            ));
        }
    }
    Ok((done, failures))
}

/// Takes tables and parameter files among the paths; the rest is returned.
fn parameters(paths: &[PathBuf], together: &mut Across, common: &Common, terminal: &Terminal) -> Result<Vec<PathBuf>, Finding> {
    let (cpfs, rest): (Vec<PathBuf>, Vec<PathBuf>) = paths.iter().cloned().partition(|path| is_named::<Cpf>(path));
    common.results.accept_tables(rest.iter().filter(|path| Format::Csv.is_of(path)))?;
    common.results.accept_files(&cpfs)?;
    let mut others = Vec::new();
    for path in paths {
        if Format::Csv.is_of(path) {
            let mut findings = Vec::new();
            let read = together.table(path, &mut findings);
            findings.iter().for_each(|f| terminal.finding(f));
            read?;
        } else if is_named::<Cpf>(path) {
            together.cpf(path)?;
        } else {
            others.push(path.clone());
        }
    }
    Ok(others)
}
