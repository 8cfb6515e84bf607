//! `calfit report`: every analysis that the campaign allows, all files, the protocol.

mod others;
mod told;

use super::options::{Excluded, Excluding, Linearise, Runs, Sweeping, without_excluded};
use super::output::Terminal;
use super::thermal::{sort_centres, sort_results, warn_of_model};
use super::{Common, Status, open_without, refused};
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::Recipe;
use crate::data::run::{Header, Kind};
use crate::data::run_state::{Outcome, RunState};
use crate::files::campaign::Campaign;
use crate::files::ledger::{Ledger, Origin};
use crate::files::output::Folder;
use crate::files::parameter::{Body, LinearisationFile};
use crate::files::source::room_for;
use crate::measure::lin::Lin;
use crate::measure::sweep::{LagChoice, Window};
use crate::plot::{self, Named};
use crate::show::protocol::{self, Protocol, RunPart, ThermalPart};
use crate::show::{Drawn, html, markdown};
use crate::workflow::{
    Alone, Analyses, CentreMade, Desk, Failure, First, Job, Measured, Renewed, RunResult, ThermalInput, ThermalOptions,
    ThermalShown, alone, by_sensor_and_mode, contradictions, draw, each, jobs, linearise_group, publish_alone,
    publish_thermal_names, refer, renew, scale_to_nt, settle,
};
use clap::Args;
use others::{Ground, Others, Photos, Thermistors};
use serde::Serialize;
use std::path::PathBuf;
use told::Told;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folder.
    #[arg(value_name = "CAMPAIGN")]
    campaign: PathBuf,
    #[command(flatten)]
    runs: Runs,
    #[command(flatten)]
    linearise: Linearise,
    #[command(flatten)]
    sweeping: Sweeping,
    #[command(flatten)]
    excluding: Excluding,
}

/// The options that a report records.
#[derive(Serialize)]
struct RecordedOptions {
    #[serde(flatten)]
    across: ThermalOptions,
    #[serde(skip_serializing_if = "Window::is_usual")]
    window: Window,
    max_rate_k_per_min: Option<f64>,
    #[serde(skip_serializing_if = "LagChoice::is_usual")]
    lag: LagChoice,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    linearise: bool,
}

/// Memory that a report keeps of every run, bytes: of small linearity runs 98 kB were measured from 500 to 2000 runs; this is a third more.
const MEMORY_PER_RUN: u64 = 130_000;
const FILES: [&str; 2] = ["REPORT.md", "REPORT.html"];

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let campaigns = open_without(std::slice::from_ref(&arguments.campaign), &arguments.excluding, common, terminal)?;
    let campaign = campaigns
        .first()
        .ok_or_else(|| Finding::error(&arguments.campaign.display().to_string(), "is no campaign", "name a campaign folder"))?;
    let folder = Folder::open(&common.out, common.force)?;
    FILES.iter().try_for_each(|name| folder.check(name))?;
    let (all, unmatched) = jobs(&campaigns, None);
    terminal.unmatched(&unmatched);
    let (jobs, excluded) = without_excluded(all, &common.results);
    room_for(&arguments.campaign, MEMORY_PER_RUN.saturating_mul(jobs.len() as u64))?;
    common.results.places(arguments.runs.files());
    let options = arguments.runs.options(true, common, terminal)?;
    let desk = common.desk_without(&arguments.excluding);
    let mut work = Work { campaign, desk, common, terminal, excluded, refused: Vec::new(), failures: Vec::new() };

    let mut measured = work.measure(&jobs, &options.analyses(arguments.sweeping.options()));
    if arguments.linearise.linearise {
        measured = work.linearise(&jobs, measured, &options);
    }
    warn_of_model(options.model.as_ref(), &measured, terminal);
    let across = work.across(&mut measured, &options)?;
    let figures = work.publish(&measured)?;
    publish_alone(&across.alone, &work.desk)?;
    for files in across.groups.iter().map(|group| &group.thermal.runs.files).chain(across.centres.iter().map(|made| &made.pair)) {
        publish_thermal_names(&measured, files, &work.desk)?;
    }
    // The files of coils, thermistors and ground calibration, which follow, stand in no table of runs.
    common.results.all_made();
    if let Err(finding) = common.results.renew_tables(&work.desk) {
        work.failures.push(("the tables of all runs".to_owned(), Failure::Refused(finding)));
    }
    let coil = work.coil(&measured);
    let thermistors = work.thermistors();
    let ground = work.ground(&across.groups, &across.centres, &thermistors.of_sensor);
    let photos = work.photos();
    let renewed = work.renew();
    let parts = work.run_parts(&measured, &figures, &coil);
    let ids: Vec<&str> = parts.iter().map(|part| part.id.as_str()).collect();
    for about in campaign.file.remarks_on_nothing(&ids) {
        terminal.warning(&format!("campaign.toml: the remark on {about} goes with no run of the campaign; check its spelling"));
    }
    across
        .beside_alone
        .iter()
        .chain(&across.contradictions)
        .chain(&ground.lacking)
        .for_each(|note| terminal.warning(&note.to_string()));
    let told = Told {
        runs: parts.iter().map(told::RunTold::from).collect(),
        thermal: &across.groups,
        centres: &across.centres,
        ground: ground.files.clone(),
        coil: coil.files.clone(),
        thermistors: thermistors.others.files.clone(),
        renewed,
    };
    // The joint fit belongs to every report.
    let recorded = RecordedOptions {
        across: ThermalOptions { joint: false, ..options.clone() },
        window: arguments.sweeping.window,
        max_rate_k_per_min: arguments.sweeping.max_rate,
        lag: arguments.sweeping.lag,
        linearise: arguments.linearise.linearise,
    };
    let made = Made { measured: &measured, figures: &figures, across: &across, coil, thermistors, ground, photos };
    work.write_protocol(made, &options, &recorded)?;
    told.tell(&measured, &work, common)
}

/// A run without a result.
struct Refused {
    run: String,
    /// File inside the campaign.
    file: String,
    header: Option<Header>,
    failure: Failure,
}

/// What a report works with, and what did not come out of it.
struct Work<'a, 't> {
    campaign: &'a Campaign,
    desk: Desk,
    common: &'a Common,
    terminal: &'a Terminal<'t>,
    excluded: Vec<Excluded>,
    refused: Vec<Refused>,
    /// What failed of what belongs to several runs or to none.
    failures: Vec<(String, Failure)>,
}

/// What was found across temperatures.
struct Across {
    groups: Vec<ThermalShown>,
    centres: Vec<CentreMade>,
    /// Runs that are at one temperature: which, and that there are no polynomials through them.
    not_applied: Vec<String>,
    /// Calibrations that hold beside the centre only.
    beside_alone: Vec<Note>,
    /// Results that contradict each other.
    contradictions: Vec<Note>,
    /// Linear calibrations of runs alone.
    alone: Vec<Alone>,
}

/// Everything that was made.
struct Made<'a> {
    measured: &'a [Measured],
    figures: &'a [Vec<Drawn>],
    across: &'a Across,
    coil: Others,
    thermistors: Thermistors,
    ground: Ground,
    photos: Photos,
}

impl Work<'_, '_> {
    /// Reads and analyses all runs; the list is in time order.
    fn measure(&mut self, jobs: &[Job], analyses: &Analyses) -> Vec<Measured> {
        let bar = self.terminal.progress(jobs.len(), "analysed");
        let two_threads = jobs.len() < rayon::current_num_threads();
        let made: Vec<Result<Measured, Failure>> =
            each(jobs, |job| bar.of(&job.id(), || analyses.make(job, &self.desk, two_threads)));
        bar.finish();
        let mut measured = Vec::new();
        for (job, result) in jobs.iter().zip(made) {
            match result {
                Ok(one) => {
                    if let Some(made) = one.made() {
                        self.common.results.done(made.head(), made.provenance());
                    }
                    measured.push(one);
                }
                Err(failure) => self.refuse(job, failure),
            }
        }
        in_time_order(measured)
    }

    /// Finds the linearisation that the linearity runs of every sensor and mode share, and fits them with it.
    fn linearise(&mut self, jobs: &[Job], measured: Vec<Measured>, options: &ThermalOptions) -> Vec<Measured> {
        let (linear, mut all): (Vec<Measured>, Vec<Measured>) = measured.into_iter().partition(|one| one.lin().is_some());
        let of = |made: &crate::workflow::Made<Lin>| {
            jobs.iter().find(|job| made.run.as_ref().is_some_and(|run| run.input.path == job.recorded))
        };
        let runs = linear.into_iter().filter_map(Measured::into_lin);
        let runs: Vec<First> = runs.filter_map(|made| Some(First { job: of(&made)?, made })).collect();
        for group in by_sensor_and_mode(runs) {
            let of_group: Vec<&Job> = group.iter().map(|first| first.job).collect();
            match linearise_group(group, &options.linear(), &self.desk) {
                Ok((result, runs)) => {
                    let name = LinearisationFile::from(&result).file_name();
                    result.notes.iter().for_each(|w| self.terminal.warning(&format!("{name}: {w}")));
                    for (job, made) in runs {
                        match made {
                            Ok(made) => {
                                self.common.results.done(made.result.head(), &made.provenance);
                                all.push(Measured::Analysed(Box::new(made)));
                            }
                            Err(finding) => self.refuse(job, Failure::Refused(finding)),
                        }
                    }
                }
                // Without the linearisation there are no parameters as they were asked for, of none of its runs.
                Err(finding) => of_group.into_iter().for_each(|job| self.refuse(job, Failure::Refused(finding.clone()))),
            }
        }
        in_time_order(all)
    }

    fn refuse(&mut self, job: &Job, failure: Failure) {
        self.common.results.outcome(&job.recorded, refused(&failure));
        self.refused.push(Refused { run: job.id(), file: job.recorded.clone(), header: job.header.clone(), failure });
    }

    /// Compares the runs across temperatures, which gives linear calibrations the polynomials of their groups.
    fn across(&mut self, measured: &mut [Measured], options: &ThermalOptions) -> Result<Across, Finding> {
        let entries = &self.campaign.file.instructions.thermal;
        let alone = alone(measured, &self.desk)?;
        if let Some(note) = settle(measured, entries, &options.orders) {
            self.terminal.warning(&note.to_string());
        }
        let mut input = ThermalInput::default();
        input.measured(measured);
        let lins: Vec<_> = measured.iter().filter_map(Measured::lin).map(|made| &made.result).collect();
        let results = input.groups(&lins, entries, options, &self.desk);
        let (groups, at_one_temperature) = sort_results(results, true, &mut self.failures, self.terminal);
        let not_applied = at_one_temperature.iter().map(|f| format!("{}: {}", f.file, f.rule)).collect();
        let centres = sort_centres(input.to_own_centre(&groups, options, &self.desk), true, &mut self.failures, self.terminal);
        let alone = refer(measured, alone, &groups, &self.desk);
        scale_to_nt(measured, &self.desk)?;
        let beside_alone = input.without_centre(&groups);
        let contradictions = contradictions(measured, &groups, &self.campaign.file.instructions);
        Ok(Across { groups, centres, not_applied, beside_alone, contradictions, alone })
    }

    /// Writes what every run gave; returns the figures of every run.
    fn publish(&mut self, measured: &[Measured]) -> Result<Vec<Vec<Drawn>>, Finding> {
        let bar = self.terminal.progress(measured.len(), "written");
        let id = |one: &Measured| one.run().map_or_else(String::new, |run| run.header.run.clone());
        let drawn: Vec<Result<Vec<Drawn>, Finding>> = each(measured, |one| bar.of(&id(one), || one.publish(&self.desk, false)));
        bar.finish();
        let mut figures = Vec::new();
        for (one, result) in measured.iter().zip(drawn) {
            let file = one.run().map_or_else(String::new, |r| r.input.path.clone());
            one.notes().iter().for_each(|w| self.terminal.warning(&format!("{file}: {w}")));
            figures.push(result.unwrap_or_else(|finding| {
                let (header, failure) = (one.run().map(|run| run.header.clone()), Failure::Refused(finding));
                self.common.results.outcome(&file, refused(&failure));
                self.refused.push(Refused { run: id(one), file, header, failure });
                Vec::new()
            }));
        }
        Ok(figures)
    }

    /// Makes again what rests on what has changed and no analysis of the report has made; the paths of those files.
    fn renew(&mut self) -> Vec<String> {
        let renewed = match renew(&self.desk) {
            Ok(renewed) => renewed,
            Err(finding) => {
                self.failures.push((finding.file.to_string(), Failure::Refused(finding)));
                return Vec::new();
            }
        };
        let mut done = Vec::new();
        for Renewed { path, made } in renewed {
            match made {
                Ok(()) => done.push(path),
                Err(finding) => self.failures.push((path, Failure::Refused(finding))),
            }
        }
        done
    }

    /// All runs in the order of their ids, which is that of their start: every one stands here once, whatever became of it.
    fn run_parts<'a>(&'a self, measured: &'a [Measured], figures: &'a [Vec<Drawn>], coil: &Others) -> Vec<RunPart<'a>> {
        let mut parts: Vec<RunPart> = measured.iter().zip(figures).map(|(measured, figures)| measured.part(figures)).collect();
        for part in parts.iter_mut().filter(|part| part.header.is_some_and(|h| h.kind == Kind::Scalar)) {
            // They are analysed together.
            if !coil.files.is_empty() && part.outcome.state == RunState::NotApplicable {
                part.outcome = Outcome::done();
            }
        }
        for one in &self.refused {
            let reason = one.failure.errors().map(|e| format!("{}; {}", e.rule, e.remedy)).next().unwrap_or_default();
            let outcome = Outcome::new(RunState::Refused, reason);
            // What was analysed and could not be written is there already.
            match parts.iter_mut().find(|part| part.run.is_some_and(|run| run.input.path == one.file)) {
                Some(part) => (part.outcome, part.analysis) = (outcome, None),
                None => parts.push(RunPart {
                    id: one.run.clone(),
                    file: one.file.clone(),
                    header: one.header.as_ref(),
                    run: None,
                    outcome,
                    analysis: None,
                }),
            }
        }
        parts.extend(self.excluded.iter().map(|one| RunPart {
            id: one.run.clone(),
            file: one.file.clone(),
            header: one.header.as_ref(),
            run: None,
            outcome: Outcome::new(RunState::Excluded, one.reason.as_str()),
            analysis: None,
        }));
        parts.sort_by(|a, b| (&a.id, &a.file).cmp(&(&b.id, &b.file)));
        parts
    }

    /// Writes the protocol.
    fn write_protocol(&self, made: Made, options: &ThermalOptions, recorded: &RecordedOptions) -> Result<(), Finding> {
        let Made { measured, figures, across, coil, thermistors, ground, photos } = made;
        let mut input: Vec<Input> = measured.iter().filter_map(Measured::run).map(Input::from).collect();
        input.extend(self.campaign.input.clone());
        input.extend(thermistors.others.input);
        input.extend(photos.input);
        input.extend(options.facility.iter().map(|f| f.input.clone()));
        input.extend(options.linearisation.iter().map(|l| l.input.clone()));
        input.extend(options.model.iter().map(|m| m.input.clone()));
        let provenance = Provenance::new(Recipe::new("report", recorded).reading(self.desk.allowed()), input);
        let drawing = self.desk.folder("", Origin::of(&provenance).listing_all_runs())?;
        let profile = if self.desk.plots { self.profile(measured, &drawing)? } else { None };
        let ledger = self.desk.results.ledger();
        let written = ledger.iter().flat_map(Ledger::written);
        let files: Vec<(String, String)> = written.map(|(path, written)| (path, written.sha256)).collect();
        let folder =
            self.desk.folder("", Origin::of(&provenance).listing_all_runs().using(files.iter().map(|(path, _)| path.clone())))?;
        let failed = self.failures.iter();
        let failed = failed.flat_map(|(name, f)| f.errors().map(move |e| (name.clone(), format!("{}; {}", e.rule, e.remedy))));
        let groups = across.groups.iter();
        let thermal = |g| {
            let ThermalShown { thermal, file, figures, .. }: &ThermalShown = g;
            ThermalPart { thermal, file_name: file.file_name(), figures }
        };
        let document = protocol::document(&Protocol {
            campaign: self.campaign,
            runs: self.run_parts(measured, figures, &coil),
            thermals: groups.map(thermal).collect(),
            sweeps: measured.iter().filter_map(Measured::sweep).collect(),
            points: measured.iter().filter_map(Measured::point).collect(),
            not_applied: across.not_applied.clone(),
            centres: ground.parts,
            at_centre: across.centres.iter().map(|made| (&made.result, made.file.file_name())).collect(),
            beside_alone: across.beside_alone.clone(),
            contradictions: across.contradictions.clone(),
            coil: coil.parts,
            thermistors: thermistors.others.parts,
            photos: photos.drawn,
            profile,
            failed: failed.collect(),
            files,
            provenance,
        });
        let page = html::page(&document, &mut |file| std::fs::read(folder.path().join(file)).ok());
        folder.write(FILES[0], markdown::page(&document).as_bytes())?;
        folder.write(FILES[1], page.as_bytes())?;
        folder.sync()
    }

    /// Draws the temperatures of all runs.
    fn profile(&self, measured: &[Measured], folder: &Folder) -> Result<Option<Drawn>, Finding> {
        let instructions = &self.campaign.file.instructions;
        let runs: Vec<plot::profile::ProfileRun> = measured
            .iter()
            .filter_map(Measured::run)
            .map(|run| {
                let (sensor, coil) = instructions.channels(&run.header);
                let channel = |name: &str| run.slow_channel(name).unwrap_or_default();
                plot::profile::ProfileRun { start_s: run.header.start.seconds(), sensor: channel(&sensor), coil: channel(&coil) }
            })
            .collect();
        if runs.iter().all(|r| r.sensor.is_empty() && r.coil.is_empty()) {
            return Ok(None);
        }
        let first = measured.iter().find_map(Measured::run).map_or("", |r| r.header.run.as_str());
        let named = Named { stem: "complete", figure: plot::profile::figure(&runs, first) };
        Ok(draw(folder, &[named], |_| "TEMPERATURE_PROFILE.png".to_owned())?.pop())
    }
}

fn in_time_order(mut measured: Vec<Measured>) -> Vec<Measured> {
    measured.sort_by_key(|one| one.run().map(|run| (run.header.start.clone(), run.header.run.clone())));
    measured
}
