//! `calfit thermal`: temperature polynomials across the runs of every sensor and mode.

use super::options::{Excluding, Order, Runs, Sweeping, refuse_given, without_excluded};
use super::output::{Terminal, json};
use super::{Common, Status, does_not_apply, open_beside_files, refused, report_failures, status};
use crate::data::across::CalibratedRun;
use crate::data::error::{Finding, Severity};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{LEAST_COVERAGE, Settling};
use crate::files::campaign::Campaign;
use crate::files::index;
use crate::files::parameter::{Body, FileKind, Tpf, alone_of, files_of, is_named};
use crate::measure::sweep;
use crate::model::campaign::ThermalEntry;
use crate::record::known::Known;
use crate::show;
use crate::workflow::{
    Analyses, CentreMade, Desk, Failure, Measured, NoThermal, PairFiles, RunResult, ThermalInput, ThermalShown, each, jobs,
    refer, settle,
};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// A campaign folder, run files, parameter files (.CPF, .OPF, .FPF; with --centre also .TPF), or folders of parameter files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    runs: Runs,
    #[command(flatten)]
    sweeping: Sweeping,
    /// Also fit the temperature-dependent model to the plateaus of all runs at once (needs runs, not parameter files).
    #[arg(long)]
    joint: bool,
    /// Linear calibration at the centre of the coil system: the runs were measured beside it and their polynomials, or those of a TPF
    /// among the paths, are taken to the centre as well [default: where runs say that they were made beside the centre, `[[at]]` of
    /// campaign.toml, the linearity and offset runs at the centre of the same sensor and mode].
    #[arg(long, value_name = "CPF")]
    centre: Option<PathBuf>,
    /// Linear calibration beside the centre at the temperature of --centre [default: the polynomials at that temperature].
    #[arg(long, value_name = "CPF", requires = "centre")]
    off_centre: Option<PathBuf>,
    /// Offset measured by turning the sensor: tells offset and residual field of the temperature cycle apart.
    #[arg(long, value_name = "OPF", requires = "centre")]
    offset: Option<PathBuf>,
    #[command(flatten)]
    excluding: Excluding,
}

#[derive(Serialize)]
struct Listing<'a, G, S, C> {
    groups: Vec<G>,
    sweeps: Vec<S>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    centre: Vec<C>,
    /// Runs at one temperature, which have no polynomials.
    #[serde(skip_serializing_if = "<[Finding]>::is_empty")]
    not_applied: &'a [Finding],
    failed: Vec<&'a Finding>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let (polynomials, paths): (Vec<PathBuf>, Vec<PathBuf>) = arguments.paths.iter().cloned().partition(|p| is_named::<Tpf>(p));
    if let (Some(path), None) = (polynomials.first(), &arguments.centre) {
        let rule = "holds polynomials already";
        return Err(Finding::error(&path.display().to_string(), rule, "name --centre CPF to take them to the centre"));
    }
    let Sorted { files, given_up, campaigns: campaign_paths } = sort_paths(&paths, terminal)?;
    if campaign_paths.is_empty() {
        refuse_without_runs(arguments)?;
    }
    let named = arguments.centre.iter().chain(&arguments.off_centre).chain(&arguments.offset).chain(&polynomials);
    common.results.places(named.chain(arguments.runs.files()));
    common.results.accept_files(&files)?;
    let options = arguments.runs.options(arguments.joint, common, terminal)?;
    let pair = pair(arguments, terminal)?;
    let mut failures: Vec<(String, Failure)> = Vec::new();
    let mut input = ThermalInput::default();
    read_files(&files, &mut input, terminal, &mut failures);
    let mut missing = arguments.excluding.clone();
    for exclusion in &arguments.excluding.exclude {
        let left_out = input.leave_out(exclusion)?;
        left_out.iter().for_each(|file| terminal.warning(&format!("{file} is left out: {}", exclusion.reason)));
        let is_given_up = given_up.contains(&exclusion.run);
        missing.exclude.retain(|e| e != exclusion || (left_out.is_empty() && !is_given_up));
    }
    let campaigns = if campaign_paths.is_empty() {
        missing.check(&[])?;
        Vec::new()
    } else {
        open_beside_files(&campaign_paths, &arguments.excluding, &missing, common, terminal)?
    };
    let desk = common.desk_without(&arguments.excluding);
    let (mut measured, total) =
        measure(&campaigns, &options.analyses(arguments.sweeping.options()), &desk, terminal, &mut failures);
    warn_of_model(options.model.as_ref(), &measured, terminal);
    let entries: Vec<ThermalEntry> = campaigns.iter().flat_map(|c| c.file.instructions.thermal.iter().cloned()).collect();
    if let Some(note) = settle(&mut measured, &entries, &options.orders) {
        terminal.warning(&note.to_string());
    }
    input.measured(&measured);
    if let Some(pair) = &pair {
        input.leave_out_centre(pair);
    }
    let lins: Vec<_> = measured.iter().filter_map(Measured::lin).map(|made| &made.result).collect();
    let results = input.groups(&lins, &entries, &options, &desk);
    let has_temperature = |p: &CalibratedRun| p.run.temperature_degc.is_some_and(f64::is_finite);
    if !input.points().is_empty() && !input.points().iter().any(has_temperature) {
        failures.push(no_temperature(input.points()));
    }
    // What the runs of this command say was shown with them.
    let are_shown = files.is_empty();
    let (groups, at_one_temperature) = sort_results(results, are_shown, &mut failures, terminal);
    // Nothing failed where the analysis does not apply; runs without a temperature lack something.
    let at_one_temperature = if input.points().iter().all(has_temperature) {
        at_one_temperature.iter().for_each(|f| terminal.finding(&f.clone().weighing(Severity::Warning)));
        at_one_temperature
    } else {
        failures.extend(at_one_temperature.into_iter().map(|f| (f.file.to_string(), Failure::Refused(f))));
        Vec::new()
    };
    warn_of_left_out(input.points(), &groups, terminal);
    if pair.is_none() {
        input.without_centre(&groups).iter().for_each(|note| terminal.warning(&note.to_string()));
    }
    let taken = match &pair {
        Some(pair) => input.to_centre(pair, &polynomials, &groups, &options, &desk),
        None => input.to_own_centre(&groups, &options, &desk),
    };
    refer(&mut measured, Vec::new(), &groups, &desk);
    publish_runs(&measured, &desk, terminal, &mut failures);
    if let Err(finding) = desk.results.renew_tables(&desk) {
        failures.push(("the tables of all runs".to_owned(), Failure::Refused(finding)));
    }
    let done = Done {
        centres: sort_centres(taken, are_shown && pair.is_none(), &mut failures, terminal),
        sweeps: measured.iter().filter_map(Measured::sweep).collect(),
        groups,
        at_one_temperature,
    };
    done.tell(&failures, common, terminal)?;
    if done.is_empty() && input.points().is_empty() && polynomials.is_empty() && failures.is_empty() {
        let shown: Vec<String> = arguments.paths.iter().map(|p| p.display().to_string()).collect();
        terminal.finding(&does_not_apply(&shown.join(", "), "linearity, offset, frequency or sweep"));
    }
    report_failures(terminal, &failures, total + files.len() + polynomials.len());
    // Runs at one temperature were read and judged.
    let judged = done.count() + done.at_one_temperature.len();
    Ok(status(judged, failures.iter().map(|(_, f)| f)))
}

/// The files of `--centre`, `--off-centre` and `--offset`.
fn pair(arguments: &Arguments, terminal: &Terminal) -> Result<Option<PairFiles>, Finding> {
    let Some(centre) = &arguments.centre else { return Ok(None) };
    let mut findings = Vec::new();
    let read = PairFiles::read(centre, arguments.off_centre.as_ref(), arguments.offset.as_ref(), &mut findings)?;
    findings.iter().for_each(|f| terminal.finding(f));
    Ok(Some(read))
}

/// Takes the parameter files of runs.
fn read_files(files: &[PathBuf], input: &mut ThermalInput, terminal: &Terminal, failures: &mut Vec<(String, Failure)>) {
    for path in files {
        let mut findings = Vec::new();
        match input.file(path, &mut findings) {
            Ok(Some(earlier)) => {
                terminal.warning(&format!("{}: {earlier} is of the same run and is used", path.display()));
            }
            Ok(None) => {}
            Err(finding) => failures.push((path.display().to_string(), Failure::Unreadable(vec![finding]))),
        }
        findings.iter().for_each(|f| terminal.finding(f));
    }
}

/// Options that say how runs are analysed need runs: a file that states one would claim what nothing did.
fn refuse_without_runs(arguments: &Arguments) -> Result<(), Finding> {
    let Runs { order, linear, corrections, cut } = &arguments.runs;
    let sweeping = arguments.sweeping.options();
    let usual = sweep::Options::default();
    let is_of_runs = |order: &Order| !matches!(order, Order::Quantity(..));
    let given = [
        ("--order N", order.iter().any(is_of_runs)),
        ("--max-field", !linear.max_field.is_empty()),
        ("--robust", linear.robust),
        ("--linearisation", linear.linearisation.is_some()),
        ("--facility", corrections.facility.is_some()),
        ("--model", corrections.model.is_some()),
        ("--settling", cut.settling != Settling::Found),
        ("--coverage", cut.coverage != LEAST_COVERAGE),
        ("--window", !sweeping.window.is_usual()),
        ("--max-rate", sweeping.most_k_per_min.is_some()),
        ("--lag", sweeping.lag != usual.lag),
        ("--joint", arguments.joint),
    ];
    refuse_given(&given, "changes nothing where only parameter files are named", "name the runs, or leave it out")
}

/// No run has a temperature.
fn no_temperature(points: &[CalibratedRun]) -> (String, Failure) {
    let files: Vec<&str> = points.iter().map(|p| p.file.as_str()).collect();
    let rule = "states no sensor temperature, nor does any other run";
    let remedy = "check the temperature channels of the runs, or temperature_degc in the files";
    (files.join(", "), Failure::Refused(Finding::error(&files.join(", "), rule, remedy)))
}

/// Names the runs without temperature that no group tells of: they may be of a sensor and mode that no other run has.
fn warn_of_left_out(points: &[CalibratedRun], groups: &[ThermalShown], terminal: &Terminal) {
    for point in points.iter().filter(|p| p.run.temperature_degc.is_none()) {
        let is_told = |d: &ThermalShown| {
            d.thermal.notes.iter().any(|n| n.kind == NoteKind::LeftOut && n.about.as_ref() == Some(&point.file))
        };
        if !groups.iter().any(is_told) {
            terminal.warning(&format!("{} states no sensor temperature and was left out", point.file));
        }
    }
}

/// The polynomials that were taken to the centre, with their warnings shown, but for those of runs and polynomials that are shown; the others
/// go to the failures.
pub(super) fn sort_centres(
    results: Vec<Result<CentreMade, Failure>>,
    are_shown: bool,
    failures: &mut Vec<(String, Failure)>,
    terminal: &Terminal,
) -> Vec<CentreMade> {
    let mut done = Vec::new();
    for result in results {
        match result {
            Ok(made) => {
                tell(&made.result.notes, &made.file.file_name(), are_shown, terminal);
                done.push(made);
            }
            Err(failure) => {
                let file = failure.errors().next().map_or_else(String::new, |f| f.file.to_string());
                failures.push((file, failure));
            }
        }
    }
    done
}

/// What the command made.
struct Done<'a> {
    groups: Vec<ThermalShown>,
    sweeps: Vec<&'a sweep::Sweep>,
    centres: Vec<CentreMade>,
    /// Runs that are at one temperature.
    at_one_temperature: Vec<Finding>,
}

impl Done<'_> {
    fn count(&self) -> usize {
        self.groups.len() + self.sweeps.len() + self.centres.len()
    }

    fn is_empty(&self) -> bool {
        self.count() == 0
    }

    fn tell(&self, failures: &[(String, Failure)], common: &Common, terminal: &Terminal) -> Result<(), Finding> {
        if common.json {
            let failed = failures.iter().flat_map(|(_, f)| f.errors()).collect();
            let groups = self.groups.iter().map(ThermalShown::view).collect();
            let sweeps = self.sweeps.iter().map(|s| s.view()).collect();
            let centre = self.centres.iter().map(CentreMade::view).collect();
            terminal.print(&json(&Listing { groups, sweeps, centre, not_applied: &self.at_one_temperature, failed })?);
            return Ok(());
        }
        let tell = |summary: String, place: &str| {
            terminal.tell(&format!("{summary}  -> {}\n", common.out.join(place).display()));
        };
        for one in &self.groups {
            tell(show::thermal::summary(&one.thermal), &one.file.file_name());
        }
        for sweep in &self.sweeps {
            tell(show::sweep::summary(sweep), &sweep.run.id);
        }
        for made in &self.centres {
            tell(show::centre::summary(&made.result), &made.file.file_name());
        }
        Ok(())
    }
}

/// Shows the notes on a file, without those of other results where these are shown.
fn tell(notes: &[Note], file: &str, are_shown: bool, terminal: &Terminal) {
    for note in notes.iter().filter(|note| note.of.is_none() || !are_shown) {
        terminal.warning(&format!("{file}: {note}"));
    }
}

/// The analyses that were made, with their warnings shown, but for those of runs that are shown, and those that do not apply to runs at one
/// temperature; those that are refused go to the failures.
pub(super) fn sort_results(
    results: Vec<Result<ThermalShown, NoThermal>>,
    are_shown: bool,
    failures: &mut Vec<(String, Failure)>,
    terminal: &Terminal,
) -> (Vec<ThermalShown>, Vec<Finding>) {
    let (mut done, mut at_one_temperature) = (Vec::new(), Vec::new());
    for result in results {
        match result {
            Ok(one) => {
                tell(&one.thermal.notes, &one.file.file_name(), are_shown, terminal);
                done.push(one);
            }
            Err(NoThermal::OfPair) => {}
            Err(NoThermal::OneTemperature(finding)) => at_one_temperature.push(finding),
            Err(NoThermal::Refused(finding)) => failures.push((finding.file.to_string(), Failure::Refused(finding))),
        }
    }
    (done, at_one_temperature)
}

/// Says which runs are analysed as they are in spite of a model.
pub(super) fn warn_of_model(model: Option<&Known>, measured: &[Measured], terminal: &Terminal) {
    let Some(model) = model else { return };
    let as_it_is = |m: &&Measured| m.made().is_some_and(|made| !made.takes_model());
    let count = measured.iter().filter(as_it_is).count();
    if count > 0 {
        let file = &model.input.path;
        terminal.warning(&format!("{file}: its effects have no influence on {count} runs, whose analysis takes none"));
    }
}

/// The analyses of all runs that a group can use.
fn measure(
    campaigns: &[Campaign],
    analyses: &Analyses,
    desk: &Desk,
    terminal: &Terminal,
    failures: &mut Vec<(String, Failure)>,
) -> (Vec<Measured>, usize) {
    let (all, unmatched) = jobs(campaigns, None);
    terminal.unmatched(&unmatched);
    let (mut jobs, excluded) = without_excluded(all, &desk.results);
    excluded.iter().for_each(|one| terminal.warning(one.told().trim_end()));
    jobs.retain(|job| job.named || job.header.as_ref().is_none_or(|h| h.kind.is_thermal() && job.campaign.uses(h)));
    let bar = terminal.progress(jobs.len(), "analysed");
    let two_threads = jobs.len() < rayon::current_num_threads();
    let results: Vec<Result<Measured, Failure>> = each(&jobs, |job| bar.of(&job.id(), || analyses.make(job, desk, two_threads)));
    bar.finish();
    let mut done = Vec::new();
    for (job, result) in jobs.iter().zip(results) {
        match result {
            Ok(measured) => {
                if let Some(made) = measured.made() {
                    desk.results.done(made.head(), made.provenance());
                }
                done.push(measured);
            }
            Err(failure) => {
                desk.results.outcome(&job.recorded, refused(&failure));
                failures.push((job.recorded.clone(), failure));
            }
        }
    }
    (done, jobs.len())
}

/// Writes what every run gave, and says what a person should know of it.
fn publish_runs(measured: &[Measured], desk: &Desk, terminal: &Terminal, failures: &mut Vec<(String, Failure)>) {
    let written: Vec<Result<_, Finding>> = each(measured, |one| one.publish(desk, true));
    for (one, result) in measured.iter().zip(written) {
        let name = one.run().map_or_else(String::new, |run| run.input.path.clone());
        one.notes().iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
        if let Err(finding) = result {
            let failure = Failure::Refused(finding);
            desk.results.outcome(&name, refused(&failure));
            failures.push((name, failure));
        }
    }
}

/// What the named paths hold.
#[derive(Default)]
struct Sorted {
    /// Parameter files.
    files: Vec<PathBuf>,
    /// Runs whose files the index of their folder gives up.
    given_up: Vec<String>,
    /// What holds runs.
    campaigns: Vec<PathBuf>,
}

fn sort_paths(paths: &[PathBuf], terminal: &Terminal) -> Result<Sorted, Finding> {
    let Sorted { mut files, mut given_up, mut campaigns } = Sorted::default();
    for path in paths {
        if is_parameter_file(path) {
            files.push(path.clone());
        } else if path.is_dir() && Campaign::run_files(path)?.is_empty() {
            let mut found = Vec::new();
            found.extend(files_of(path)?.into_iter().filter(|file| is_parameter_file(file)));
            if found.is_empty() {
                let shown = path.display().to_string();
                return Err(Finding::error(&shown, "the folder holds neither runs nor parameter files", "check the path"));
            }
            let (left, runs) = those_that_hold(path, found, terminal)?;
            if left.is_empty() {
                let rule = "the runs of all parameter files of the folder are gone, refused or left out by its index";
                return Err(Finding::error(&path.display().to_string(), rule, "make the results again, or name single files"));
            }
            files.extend(left);
            given_up.extend(runs);
        } else {
            campaigns.push(path.clone());
        }
    }
    Ok(Sorted { files, given_up, campaigns })
}

/// The files that the index of their folder does not give up, since their runs are gone, refused or left out; of a run with two calibrations that of
/// its thermal group, unless the index says that that of the run alone was made again since. The runs of the others are named as well.
fn those_that_hold(folder: &Path, mut found: Vec<PathBuf>, terminal: &Terminal) -> Result<(Vec<PathBuf>, Vec<String>), Finding> {
    found.sort();
    let index = index::read(folder)?;
    let inside = |path: &Path| path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
    let listed = |path: &Path| index.as_ref().and_then(|index| index.file(&inside(path)));
    let mut given_up = Vec::new();
    found.retain(|path| {
        let state = listed(path).and_then(|file| file.mark);
        if let Some(state) = state {
            terminal.warning(&format!("{} is left out: its run is {state} by the index of the folder", path.display()));
            given_up.extend(inside(path).split_once('/').map(|(run, _)| run.to_owned()));
        }
        state.is_none()
    });
    for path in &found {
        if let Some(file) = listed(path).filter(|file| file.stale) {
            let why = file.reason.as_deref().unwrap_or("what it was made from has changed");
            terminal.warning(&format!("{} is stale and used as it is: {why}", path.display()));
        }
    }
    let is_overtaken = |path: &Path| index.as_ref().is_some_and(|index| index.is_overtaken(&inside(path)));
    let pair = |path: &PathBuf| alone_of(&path.to_string_lossy()).map(PathBuf::from).filter(|alone| found.contains(alone));
    let left: Vec<PathBuf> = found
        .iter()
        .filter_map(|path| Some((path, pair(path)?)))
        .map(|(path, alone)| if is_overtaken(path) { path.clone() } else { alone })
        .collect();
    found.retain(|path| !left.contains(path));
    Ok((found, given_up))
}

/// Whether a file is named like the results of single runs that take part.
fn is_parameter_file(path: &Path) -> bool {
    FileKind::of_name(path).is_some_and(|kind| kind.point.is_some())
}
