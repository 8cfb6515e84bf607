//! `calfit report`: every analysis that the campaign allows, all files, the protocol.

use super::options::{Excluded, Excluding, without_excluded};
use super::output::{Terminal, json};
use super::thermal::{LAG, lag, order, sort_centres, sort_results, warn_of_model};
use super::{Common, Status, open_without, refused, report_failures, status};
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::Recipe;
use crate::data::run::{Kind, Run};
use crate::data::run_state::{Outcome, RunState};
use crate::data::start::Start;
use crate::files::campaign::Campaign;
use crate::files::ledger::{Ledger, Origin};
use crate::files::output::Folder;
use crate::files::parameter::Body;
use crate::measure::coil::{residual::is_check, scalar};
use crate::measure::sweep::{self, LagChoice};
use crate::measure::{thermal, thermistor};
use crate::plot::{self, Named};
use crate::show::document::{Section, Text};
use crate::show::protocol::{self, OtherPart, Protocol, RunPart, ThermalPart};
use crate::show::{self, Drawn, html, markdown};
use crate::workflow::{
    Analyses, CentreMade, CoilMade, CoilResult, CoilRun, Desk, Failure, Measured, NoGround, ThermalInput, ThermalOptions,
    ThermalShown, alone, draw, facility, ground_calibration, jobs, known, publish_alone, publish_coil, publish_thermal_names,
    publish_thermistor, refer, residual_of, scalar_of, scale_to_nt, settle, thermistor_of,
};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folder.
    #[arg(value_name = "CAMPAIGN")]
    campaign: PathBuf,
    /// Order of the polynomial of a quantity or family, as for `calfit thermal`.
    #[arg(long, value_name = "QUANTITY=N", value_parser = order)]
    order: Vec<(String, usize)>,
    /// Lag of the sensor behind the thermistor of a continuous sweep, as for `calfit thermal`.
    #[arg(long, value_name = LAG, default_value = "auto", allow_negative_numbers = true, value_parser = lag)]
    lag: LagChoice,
    /// Facility that turns the settings of the runs into fields, as for `calfit lin` and `calfit offset`.
    #[arg(long, value_name = "FILE")]
    facility: Option<PathBuf>,
    /// Model file of `calfit diagnose --write-model`: its effects are taken off the readings of linearity runs and sweeps and off sines.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    excluding: Excluding,
}

/// The options that a report records.
#[derive(Serialize)]
struct RecordedOptions {
    #[serde(flatten)]
    across: ThermalOptions,
    #[serde(skip_serializing_if = "LagChoice::is_usual")]
    lag: LagChoice,
}

#[derive(Serialize)]
struct Listing<'a> {
    runs: Vec<String>,
    thermal: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    centre: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    ground: Vec<String>,
    coil: Vec<String>,
    thermistors: Vec<String>,
    protocol: [&'static str; 2],
    #[serde(skip_serializing_if = "<[Excluded]>::is_empty")]
    excluded: &'a [Excluded],
    failed: Vec<&'a Finding>,
}

const FILES: [&str; 2] = ["REPORT.md", "REPORT.html"];

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let campaigns = open_without(std::slice::from_ref(&arguments.campaign), &arguments.excluding, common, terminal)?;
    let campaign = campaigns
        .first()
        .ok_or_else(|| Finding::error(&arguments.campaign.display().to_string(), "is no campaign", "name a campaign folder"))?;
    let folder = Folder::open(&common.out, common.force)?;
    FILES.iter().try_for_each(|name| folder.check(name))?;
    let desk = common.desk_without(&arguments.excluding);
    let mut failures: Vec<(String, Failure)> = Vec::new();
    let (all, unmatched) = jobs(&campaigns, None);
    terminal.unmatched(&unmatched);
    let (jobs, excluded) = without_excluded(all, &common.results);

    let facility = facility(arguments.facility.as_ref())?;
    let model = known(arguments.model.as_ref())?;
    let sweep = sweep::Options {
        orders: arguments.order.clone(),
        lag: arguments.lag,
        facility: facility.clone(),
        model: model.clone(),
        ..sweep::Options::default()
    };
    let analyses = Analyses::new(facility.as_ref(), model.as_ref()).with(sweep);
    let bar = terminal.progress(2 * jobs.len());
    let two_threads = jobs.len() < rayon::current_num_threads();
    let made: Vec<Result<Measured, Failure>> = jobs
        .par_iter()
        .map(|job| {
            let measured = analyses.make(job, &desk, two_threads);
            bar.inc(1);
            measured
        })
        .collect();
    let mut measured = Vec::new();
    for (job, result) in jobs.iter().zip(made) {
        match result {
            Ok(one) => {
                if let Some(made) = one.made() {
                    common.results.done(made.head(), made.provenance());
                }
                measured.push(one);
            }
            Err(failure) => {
                common.results.outcome(&job.recorded, refused(&failure));
                failures.push((job.recorded.clone(), failure));
            }
        }
    }
    warn_of_model(model.as_ref(), &measured, terminal);
    measured.sort_by_key(key);
    let options = ThermalOptions { orders: arguments.order.clone(), joint: true, facility, model };
    let entries = &campaign.file.instructions.thermal;
    let alone = alone(&measured, &desk)?;
    settle(&mut measured, entries, &options.orders);
    let mut across = ThermalInput::default();
    across.measured(&measured);
    let lins: Vec<_> = measured.iter().filter_map(Measured::lin).map(|made| &made.result).collect();
    let results = across.groups(&lins, entries, &options, &desk);
    let (groups, at_one_temperature) = sort_results(results, &mut failures, terminal);
    let not_applied: Vec<String> = at_one_temperature.iter().map(|f| format!("{}: {}", f.file, f.rule)).collect();
    let centres = sort_centres(across.to_own_centre(&groups, &options, &desk), &mut failures, terminal);
    let alone = refer(&mut measured, alone, &groups, &desk);
    scale_to_nt(&mut measured, &desk)?;
    let drawn: Vec<Result<Vec<Drawn>, Finding>> = measured
        .par_iter()
        .map(|one| {
            let figures = one.publish(&desk, false);
            bar.inc(1);
            figures
        })
        .collect();
    bar.finish_and_clear();
    let mut figures = Vec::new();
    for (one, result) in measured.iter().zip(drawn) {
        let name = one.run().map_or_else(String::new, |r| r.input.path.clone());
        one.notes().iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
        figures.push(result.unwrap_or_else(|finding| {
            let failure = Failure::Refused(finding);
            common.results.outcome(&name, refused(&failure));
            failures.push((name, failure));
            Vec::new()
        }));
    }
    publish_alone(&alone, &desk)?;
    for files in groups.iter().map(|group| &group.thermal.runs.files).chain(centres.iter().map(|made| &made.pair)) {
        publish_thermal_names(&measured, files, &desk)?;
    }
    if let Err(finding) = common.results.renew_tables(&desk) {
        failures.push(("the tables of all runs".to_owned(), Failure::Refused(finding)));
    }

    let coil = coil(campaign, &measured, &desk, terminal, &mut failures);
    let thermistors = thermistors(campaign, &desk, terminal, &mut failures);
    let ground = ground(&groups, &centres, &thermistors.of_sensor, &desk, &mut failures);
    let beside_alone = across.without_centre(&groups);
    beside_alone.iter().chain(&ground.lacking).for_each(|note| terminal.warning(&note.to_string()));
    let mut input: Vec<Input> = measured.iter().filter_map(Measured::run).map(|run| Input::from(&run.input)).collect();
    input.extend(campaign.input.clone());
    input.extend(thermistors.others.input);
    input.extend(options.facility.iter().map(|f| f.input.clone()));
    input.extend(options.model.iter().map(|m| m.input.clone()));
    let failed: Vec<(String, String)> = failures
        .iter()
        .flat_map(|(name, f)| f.errors().map(move |e| (name.clone(), format!("{}; {}", e.rule, e.remedy))))
        .collect();
    // The joint fit belongs to every report.
    let recorded = RecordedOptions { across: ThermalOptions { joint: false, ..options }, lag: arguments.lag };
    let provenance = Provenance::new(Recipe::new("report", &recorded).reading(desk.allowed()), input);
    let drawing = desk.folder("", Origin::of(&provenance))?;
    let profile = if common.no_plots { None } else { profile(campaign, &measured, &drawing)? };
    let files: Vec<(String, String)> =
        desk.results.ledger().iter().flat_map(Ledger::written).map(|(path, written)| (path, written.sha256)).collect();
    let folder = desk.folder("", Origin::of(&provenance).using(files.iter().map(|(path, _)| path.clone())))?;
    let document = protocol::document(&Protocol {
        campaign,
        runs: run_parts(&measured, &figures, &excluded),
        thermals: groups
            .iter()
            .map(|g| ThermalPart { thermal: &g.thermal, file_name: g.file.file_name(), figures: &g.figures })
            .collect(),
        not_applied,
        centres: ground.parts,
        beside_alone,
        coil: coil.parts,
        thermistors: thermistors.others.parts,
        profile,
        failed,
        files,
        provenance,
    });
    let page = html::page(&document, &mut |file| std::fs::read(folder.path().join(file)).ok());
    folder.write(FILES[0], markdown::page(&document).as_bytes())?;
    folder.write(FILES[1], page.as_bytes())?;
    folder.sync()?;

    let total = jobs.len() + groups.len() + centres.len() + campaign.file.thermistors.len();
    if common.json {
        let runs = measured.iter().filter_map(Measured::run).map(|r| r.header.run.clone()).collect();
        let thermal = groups.iter().map(|g| g.file.file_name()).collect();
        let failed = failures.iter().flat_map(|(_, f)| f.errors()).collect();
        terminal.print(&json(&Listing {
            runs,
            thermal,
            centre: centres.iter().map(|made| made.file.file_name()).collect(),
            ground: ground.files,
            coil: coil.files,
            thermistors: thermistors.others.files,
            protocol: FILES,
            excluded: &excluded,
            failed,
        })?);
    } else {
        excluded.iter().for_each(|one| terminal.tell(&one.told()));
        for one in &groups {
            terminal.tell(&show::thermal::summary(&one.thermal));
        }
        for made in &centres {
            terminal.tell(&show::centre::summary(&made.result));
        }
        terminal.tell(&format!(
            "{} runs, {} thermal analyses\n  -> {}\n",
            measured.len(),
            groups.len(),
            common.out.join(FILES[1]).display()
        ));
    }
    report_failures(terminal, &failures, total);
    let partial = if measured.iter().any(Measured::is_partial) { Status::Partly } else { Status::Done };
    Ok(status(measured.len(), failures.iter().map(|(_, f)| f)).max(partial))
}

/// Results that belong to no single run, as they were published.
#[derive(Default)]
struct Others {
    files: Vec<String>,
    parts: Vec<OtherPart>,
    input: Vec<Input>,
}

/// Calibrates the coil system with the scalar runs: those with settings on the axes alone tell the residual field, the others the rest.
fn coil(
    campaign: &Campaign,
    measured: &[Measured],
    desk: &Desk,
    terminal: &Terminal,
    failures: &mut Vec<(String, Failure)>,
) -> Others {
    let runs = measured.iter().filter_map(Measured::run).filter(|run| run.header.kind == Kind::Scalar);
    let (checks, others): (Vec<&Run>, Vec<&Run>) = runs.partition(|run| is_check(run));
    let given = |runs: Vec<&Run>| runs.into_iter().map(|run| CoilRun { run: run.clone(), campaign }).collect();
    let mut all = Others::default();
    if let Some(made) = keep(scalar_of(given(others), &scalar::Options::default(), desk), failures).flatten() {
        all.add_coil(&made, desk, terminal, failures);
    }
    if let Some(made) = keep(residual_of(given(checks), desk), failures).flatten() {
        all.add_coil(&made, desk, terminal, failures);
    }
    all
}

/// Calibrates the thermistors whose tables the campaign names.
fn thermistors(campaign: &Campaign, desk: &Desk, terminal: &Terminal, failures: &mut Vec<(String, Failure)>) -> Thermistors {
    let (mut all, mut of_sensor) = (Others::default(), Vec::new());
    for entry in &campaign.file.thermistors {
        let mut findings = Vec::new();
        let order = entry.order.map(|order| order as usize);
        let options = thermistor::Options { order, divider: entry.divider, ..thermistor::Options::default() };
        let reference = entry.reference.as_ref().map(|table| campaign.root.join(table));
        let made = thermistor_of(&campaign.root.join(&entry.table), reference.as_deref(), &options, &mut findings);
        findings.iter().for_each(|f| terminal.finding(f));
        let published = made.and_then(|made| publish_thermistor(&made, desk).map(|published| (made, published)));
        if let Some((made, (name, figures))) = keep(published, failures) {
            made.result.notes.iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
            let (title, sections) = (show::thermistor::title(&made.result), show::thermistor::sections(&made.result, &name));
            of_sensor.push((entry.sensor.clone(), name.clone()));
            all.files.push(name);
            all.parts.push(OtherPart { title, sections, figures });
            all.input.extend(made.provenance.input);
        }
    }
    Thermistors { others: all, of_sensor }
}

/// Thermistors that were calibrated: their parts, and their files with the sensors that they sit in.
struct Thermistors {
    others: Others,
    of_sensor: Vec<(Option<String>, String)>,
}

/// The calibrations at the centre, each with its ground calibration file or what that lacks.
#[derive(Default)]
struct Ground {
    files: Vec<String>,
    lacking: Vec<Note>,
    parts: Vec<OtherPart>,
}

/// Writes the ground calibration files of the sensors that were taken to the centre. What is missing for one is no failure: nobody asked
/// for it, and the files that it would rest on are there.
fn ground(
    groups: &[ThermalShown],
    centres: &[CentreMade],
    thermistors: &[(Option<String>, String)],
    desk: &Desk,
    failures: &mut Vec<(String, Failure)>,
) -> Ground {
    let mut all = Ground::default();
    for made in centres {
        let tcf = &made.file;
        let own_offsets = |g: &&ThermalShown| {
            let runs = &g.thermal.runs;
            g.thermal.kind() == thermal::Kind::Offset && (&runs.sensor, &runs.mode) == (&tcf.sensor, &tcf.mode)
        };
        let tof = groups.iter().find(own_offsets).filter(|_| tcf.residual_field.is_none()).map(|g| g.file.file_name());
        // The thermistor of the sensor goes before one that goes with every sensor.
        let of = |sensor: Option<&String>| thermistors.iter().find(|(own, _)| own.as_ref() == sensor).map(|(_, name)| name);
        let thermistor = of(Some(&tcf.sensor)).or_else(|| of(None)).map(String::as_str);
        let name = tcf.file_name();
        let section = Section::new("Ground calibration file");
        let section = match ground_calibration(&name, tof.as_deref(), thermistor, desk) {
            Ok(file) => {
                let section =
                    section.with(Text::default().code(&file).and(" holds these values with the labels of RO-IGEP-TR0028."));
                all.files.push(file);
                section
            }
            Err(NoGround::Failed(finding)) => {
                failures.push((name.clone(), Failure::Refused(finding)));
                section
            }
            Err(NoGround::Lacking(finding)) => {
                let text = format!("there is no ground calibration file of {} {}: {}", tcf.sensor, tcf.mode, finding.rule);
                let note = Note::new(NoteKind::LeftOut, text).about(&tcf.sensor).with_remedy(finding.remedy.as_ref());
                all.lacking.push(note.clone());
                section.with(note)
            }
        };
        let mut sections = show::centre::sections(&made.result, &name);
        sections.push(section);
        all.parts.push(OtherPart { title: show::centre::title(&made.result), sections, figures: Vec::new() });
    }
    all
}

/// The value, or its error among the failures.
fn keep<T>(result: Result<T, Finding>, failures: &mut Vec<(String, Failure)>) -> Option<T> {
    result.map_err(|finding| failures.push((finding.file.to_string(), Failure::Refused(finding)))).ok()
}

impl Others {
    /// Publishes a calibration of the coil system and takes it.
    fn add_coil<R: CoilResult>(
        &mut self,
        made: &CoilMade<R>,
        desk: &Desk,
        terminal: &Terminal,
        failures: &mut Vec<(String, Failure)>,
    ) {
        let Some((name, figures)) = keep(publish_coil(made, desk), failures) else { return };
        made.result.notes().iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
        self.parts.push(OtherPart { title: made.result.title(), sections: (R::SHOWN.sections)(&made.result, &name), figures });
        self.files.push(name);
    }
}

/// All runs in the order of their ids, which is that of their start.
fn run_parts<'a>(measured: &'a [Measured], figures: &'a [Vec<Drawn>], excluded: &'a [Excluded]) -> Vec<RunPart<'a>> {
    let mut parts: Vec<RunPart> = measured.iter().zip(figures).map(|(measured, figures)| measured.part(figures)).collect();
    parts.extend(excluded.iter().map(|one| RunPart {
        id: one.run.clone(),
        header: one.header.as_ref(),
        run: None,
        outcome: Outcome::new(RunState::Excluded, one.reason.as_str()),
        analysis: None,
    }));
    parts.sort_by(|a, b| a.id.cmp(&b.id));
    parts
}

/// Runs in the order of their start.
fn key(measured: &Measured) -> Option<(Start, String)> {
    measured.run().map(|run| (run.header.start.clone(), run.header.run.clone()))
}

/// Draws the temperatures of all runs.
fn profile(campaign: &Campaign, measured: &[Measured], folder: &Folder) -> Result<Option<Drawn>, Finding> {
    let runs: Vec<plot::profile::ProfileRun> = measured
        .iter()
        .filter_map(Measured::run)
        .map(|run| {
            let (sensor, coil) = campaign.file.instructions.channels(&run.header);
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
