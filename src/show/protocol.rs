//! The protocol of a campaign, in the order of BC-MAG-TR-0085: setup, measurements by day, thermal analyses, coil system and
//! thermistors where they were calibrated, temperature profile, mathematical description, nomenclature, origin and uncertainty.

mod first_page;
mod mathematics;

use super::document::{Block, Cell, Document, Figure, Section, Table, Text, cells};
use super::{Drawn, inputs, mode_at, or_not_stated, runs, thermal};
use crate::data::across::CalibratedRun;
use crate::data::exclusion::Exclusion;
use crate::data::note::Note;
use crate::data::provenance::Provenance;
use crate::data::result::{RowsUsed, RunHead};
use crate::data::run::{Header, Location, Run, time_of_id};
use crate::data::run_state::{Outcome, RunState};
use crate::files::campaign::Campaign;
use crate::measure::centre::AtCentre;
use crate::measure::sweep::Sweep;
use crate::measure::thermal::{Kind, Thermal};
use sha2::{Digest, Sha256};

/// A run in the protocol.
pub struct RunPart<'a> {
    /// Run id.
    pub id: String,
    /// File inside the campaign.
    pub file: String,
    /// What its file says at its head, if that can be read.
    pub header: Option<&'a Header>,
    /// The run as it was read; absent for one that was refused or left out.
    pub run: Option<&'a Run>,
    /// What became of it, and why.
    pub outcome: Outcome,
    /// What its analysis gave; absent for a run without one.
    pub analysis: Option<AnalysisPart<'a>>,
}

/// What the analysis of a run gave.
pub struct AnalysisPart<'a> {
    /// Name of the analysis in the protocol.
    pub name: &'static str,
    /// The run.
    pub head: &'a RunHead,
    /// The result in one line.
    pub headline: String,
    /// Whether its uncertainties hold what a facility file states of its own.
    pub has_type_b: bool,
    /// How many rows of the run it rests on.
    pub rows: Option<RowsUsed>,
    /// What a person should know.
    pub remarks: Vec<String>,
    /// The sections of its report.
    pub sections: Vec<Section>,
    /// Its figures.
    pub figures: &'a [Drawn],
}

/// A thermal analysis in the protocol.
pub struct ThermalPart<'a> {
    /// The analysis.
    pub thermal: &'a Thermal,
    /// Name of its parameter file.
    pub file_name: String,
    /// Its figures.
    pub figures: &'a [Drawn],
}

/// A result in the protocol that belongs to no single run: of the coil system, of a thermistor.
pub struct OtherPart {
    /// Its title.
    pub title: String,
    /// Its sections.
    pub sections: Vec<Section>,
    /// Its figures.
    pub figures: Vec<Drawn>,
}

/// Everything that the protocol is made of.
pub struct Protocol<'a> {
    /// The campaign.
    pub campaign: &'a Campaign,
    /// Runs in time order.
    pub runs: Vec<RunPart<'a>>,
    /// Thermal analyses by sensor and mode.
    pub thermals: Vec<ThermalPart<'a>>,
    /// Continuous sweeps.
    pub sweeps: Vec<&'a Sweep>,
    /// Results of single runs.
    pub points: Vec<CalibratedRun>,
    /// Runs that are at one temperature: which, and that there are no polynomials through them.
    pub not_applied: Vec<String>,
    /// Calibrations across temperatures that were taken to the centre of the coil system.
    pub centres: Vec<OtherPart>,
    /// The same as numbers, with the names of their files.
    pub at_centre: Vec<(&'a AtCentre, String)>,
    /// Calibrations across temperatures that hold beside the centre only.
    pub beside_alone: Vec<Note>,
    /// Results that contradict each other.
    pub contradictions: Vec<Note>,
    /// Calibrations of the coil system.
    pub coil: Vec<OtherPart>,
    /// Calibration tables of thermistors.
    pub thermistors: Vec<OtherPart>,
    /// Photographs that the campaign names.
    pub photos: Vec<Drawn>,
    /// The complete temperature profile.
    pub profile: Option<Drawn>,
    /// What failed beside runs: the file or group, and why.
    pub failed: Vec<(String, String)>,
    /// Files that belong to the protocol with their SHA-256.
    pub files: Vec<(String, String)>,
    /// Origin of the protocol; its inputs are all runs.
    pub provenance: Provenance,
}

/// Title of the protocol.
#[must_use]
pub fn title(campaign: &Campaign) -> String {
    stated(campaign, "Title")
        .map(str::to_owned)
        .or_else(|| campaign.file.name.clone())
        .unwrap_or_else(|| "Ground calibration of a magnetometer".to_owned())
}

/// The protocol.
#[must_use]
pub fn document(p: &Protocol) -> Document {
    let days = days(&p.runs);
    let mut figure = 0;
    let front = first_page::blocks(p, &mut figure);
    let mut chapters = vec![introduction(p, &mut figure)];
    let mut shown: Vec<Shown> = Vec::new();
    // Behind the introduction and the days.
    let combined = chapters.len() + days.len() + 1;
    for (day, runs) in &days {
        chapters.push(measurements(p, day, runs, combined, &mut shown, &mut figure));
    }
    chapters.push(thermals(p, &mut figure));
    let parts = [
        ("Calibration at the centre of the coil system", &p.centres),
        ("Calibration of the coil system", &p.coil),
        ("Thermistors", &p.thermistors),
    ];
    for (title, parts) in parts {
        if !parts.is_empty() {
            chapters.push(others(title, parts, &mut figure));
        }
    }
    let profile = Section::new("Complete temperature profile");
    chapters.push(match &p.profile {
        Some(drawn) => profile.with_all(Drawn::number(std::slice::from_ref(drawn), "", &mut figure)),
        None => profile.with("Drawn without figures, or no run recorded a temperature."),
    });
    chapters.push(mathematics::description());
    chapters.push(mathematics::nomenclature());
    chapters.push(origin(p));
    number(&mut chapters);
    let colophon = Some(Text::from(format!("End of the protocol {}.", identifier(p))));
    Document { title: title(p.campaign), front, sections: chapters, colophon }
}

/// The identifier that the campaign states, or one that no other inputs have.
fn identifier(p: &Protocol) -> String {
    const DIGITS: usize = 6;
    stated(p.campaign, "Document").map_or_else(
        || {
            let mut hash = Sha256::new();
            for input in &p.provenance.input {
                hash.update(format!("{} {}\n", input.sha256, input.path));
            }
            let digits: String = hash.finalize().iter().take(DIGITS).map(|byte| format!("{byte:02x}")).collect();
            format!("calfit-{digits}")
        },
        str::to_owned,
    )
}

/// Numbers chapters and their sections from 1.
fn number(chapters: &mut [Section]) {
    for (c, chapter) in (1..).zip(chapters) {
        chapter.number = Some(format!("{c}"));
        for (s, section) in (1..).zip(&mut chapter.sections) {
            section.number = Some(format!("{c}.{s}"));
        }
    }
}

fn day_name(day: &str) -> String {
    time_of_id(&format!("{day}_00-00-00")).map_or_else(|| day.to_owned(), |t| t.strftime("%B %-d, %Y").to_string())
}

/// Runs by the day of their ids.
fn days<'a, 'b>(runs: &'b [RunPart<'a>]) -> Vec<(String, Vec<&'b RunPart<'a>>)> {
    let mut days: Vec<(String, Vec<&RunPart>)> = Vec::new();
    for part in runs {
        let id = part.id.as_str();
        let day = id.split('_').next().unwrap_or(id);
        match days.last_mut() {
            Some((last, list)) if last == day => list.push(part),
            _ => days.push((day.to_owned(), vec![part])),
        }
    }
    days
}

/// What `campaign.toml` says for the protocol.
fn stated<'a>(campaign: &'a Campaign, label: &str) -> Option<&'a str> {
    campaign.file.report.iter().find(|(l, _)| *l == label).map(|(_, text)| text.as_str())
}

fn introduction(p: &Protocol, figure: &mut usize) -> Section {
    let c = &p.campaign.file;
    let mut positions = Table::new(["position", "X_m", "Y_m", "Z_m"]);
    for (id, position) in &c.instructions.positions {
        let axes = position.names().map(|axis| format!("{axis}_c").into());
        positions.push(std::iter::once((*id).into()).chain(axes).collect());
    }
    let heads: Vec<&Run> = p.runs.iter().filter_map(|r| r.run).collect();
    let mut sensors: Vec<(&str, &str)> = heads.iter().map(|r| (r.header.sensor.as_str(), r.header.mode.as_str())).collect();
    sensors.sort_unstable();
    sensors.dedup();
    let mut table = Table::new(["sensor", "mode", "runs", "sensor temperature", "coil temperature", "field limits"]);
    for (sensor, mode) in sensors {
        let own: Vec<&&Run> =
            heads.iter().filter(|r| (r.header.sensor.as_str(), r.header.mode.as_str()) == (sensor, mode)).collect();
        let Some(first) = own.first() else { continue };
        let (sensor_channel, coil_channel) = p.campaign.file.instructions.channels(&first.header);
        let limits: Vec<String> = ["x", "y", "z"]
            .iter()
            .zip(p.campaign.file.instructions.limits_nt(&first.header))
            .filter_map(|(axis, limit)| Some(format!("{axis} ±{} nT", limit?)))
            .collect();
        let limits = if limits.is_empty() { "none".to_owned() } else { limits.join(", ") };
        table.push(cells![or_not_stated(sensor), or_not_stated(mode), own.len(), sensor_channel, coil_channel, limits]);
    }
    let setup = Section::new("General setup")
        .with("Nominal sensor axes along the coil axes, by position:")
        .with(positions)
        .with("Sensors and modes, temperature channels and limits of the applied field along the nominal sensor axes:")
        .with(table);
    let stated = c.stated.tables.iter().map(|of| {
        let rows = of.rows.iter().map(|row| row.iter().map(Cell::from).collect());
        Section::new(of.title.as_str()).with(Table::new(&of.head).with_rows(rows))
    });
    let photos = Section::new("Photographs").with_all(Drawn::number(&p.photos, "", figure));
    let photos = (!p.photos.is_empty()).then_some(photos);
    Section::new("Introduction")
        .with_sections(std::iter::once(setup).chain(stated).chain(photos).chain(left_out_by_hand(p.campaign)))
}

/// Sensor, mode, location and analysis.
type Shown<'a> = (&'a str, &'a str, Location, &'static str);

/// The chapter of a day. Every analysis is shown in full once for a sensor, mode and location, as in the protocol of 2013, and `shown` holds
/// those that were; the others are in their own files.
fn measurements<'a>(
    p: &Protocol,
    day: &str,
    parts: &[&'a RunPart],
    combined: usize,
    shown: &mut Vec<Shown<'a>>,
    figure: &mut usize,
) -> Section {
    let data = Section::new("Data").with_all(p.campaign.file.stated.on(day)).with(data_of_the_day(p, parts));
    let mut chapter = Section::new(format!("Measurements on {}", day_name(day))).with_sections([data]);
    let analyses: Vec<&AnalysisPart> = parts.iter().filter_map(|part| part.analysis.as_ref()).collect();
    for &part in &analyses {
        let key = (part.head.sensor.as_str(), part.head.mode.as_str(), part.head.location, part.name);
        if !shown.contains(&key) {
            shown.push(key);
            chapter.sections.push(analysis(part, figure));
        }
    }
    if !analyses.is_empty() {
        let thermal =
            if p.thermals.is_empty() { String::new() } else { format!(" Thermal analysis: refer to chapter {combined}.") };
        let words = format!("The full report of every run stands in its folder.{thermal}");
        chapter.sections.push(Section::new("Results of the day").with(words).with(results_of_the_day(&analyses)));
    }
    chapter
}

/// All runs of a day, narrow enough for an upright page. The temperature is that of the result where there is one.
fn data_of_the_day(p: &Protocol, parts: &[&RunPart]) -> Table {
    let row = |part: &&RunPart| {
        let text = |get: fn(&Header) -> &str| part.header.map_or(Cell::Missing("-"), |h| or_not_stated(get(h)).into());
        let configuration = part.header.map_or(Cell::Missing("-"), |h| match h.configuration.as_str() {
            "" => h.kind.to_string().into(),
            name => name.into(),
        });
        let line = part.run.map(runs::RunLine::of);
        let of_line = |get: &dyn Fn(&runs::RunLine) -> Cell| line.as_ref().map_or(Cell::Missing("-"), get);
        let of_channel = || {
            let line = line.as_ref()?;
            let channel = p.campaign.file.instructions.channels(part.header?).0;
            line.temperatures.iter().find(|t| t.channel == channel).map(|t| t.degc[1])
        };
        let degc = part.analysis.as_ref().map_or_else(of_channel, |analysis| analysis.head.temperature_degc);
        cells![
            &part.id,
            configuration,
            text(|h| &h.sensor),
            text(|h| &h.mode),
            of_line(&|l| l.vectors.into()),
            of_line(&|l| l.lost.into()),
            of_line(&|l| runs::duration(l.duration_s).into()),
            degc.map_or(Cell::Missing("-"), |degc| Cell::fixed(degc, 1)),
            p.campaign.file.stated.on(&part.id).fold(in_words(&part.outcome), |words, remark| format!("{words}. {remark}")),
        ]
    };
    let head = ["run", "configuration", "sensor", "mode", "vectors", "lost", "duration", "sensor, °C", "what became of it"];
    Table::new(head).with_rows(parts.iter().map(row))
}

/// What became of a run, in words.
fn in_words(outcome: &Outcome) -> String {
    let state = match outcome.state {
        RunState::Done => "analysed",
        RunState::Refused => "refused",
        RunState::Excluded => "left out by hand",
        RunState::Gone => "its file is gone",
        RunState::NotApplicable => "not analysed",
    };
    outcome.reason.as_ref().map_or_else(|| state.to_owned(), |reason| format!("{state}: {reason}"))
}

/// What was left out by hand, with the reasons; nothing where nothing was.
fn left_out_by_hand(campaign: &Campaign) -> Option<Section> {
    let all: Vec<&Exclusion> = campaign.file.exclude.iter().chain(&campaign.exclude).collect();
    let rows = all.iter().map(|e| cells![&e.run, e.what(), &e.reason]);
    let table = Table::new(["run", "what", "reason"]).with_rows(rows);
    (!all.is_empty()).then(|| Section::new("Left out by hand").with(table))
}

/// An analysis in full.
fn analysis(part: &AnalysisPart, figure: &mut usize) -> Section {
    let head = part.head;
    let title = format!(
        "{} at {}, {} {}, run {}",
        part.name,
        super::degc(head.temperature_degc),
        or_not_stated(&head.sensor),
        mode_at(&head.mode, head.location),
        head.id
    );
    with_figures(Section::new(title), &part.sections, Drawn::number(part.figures, &format!("{}/", head.id), figure))
}

/// A section with the sections of a result, and its figures at the end of the last of them.
fn with_figures(section: Section, sections: &[Section], figures: Vec<Figure>) -> Section {
    let mut section = section.with_sections(sections.iter().cloned());
    let blocks = section.sections.last_mut().map_or(&mut section.blocks, |last| &mut last.blocks);
    blocks.extend(figures.into_iter().map(Block::Figure));
    section
}

fn results_of_the_day(analyses: &[&AnalysisPart]) -> Table {
    let row = |part: &&AnalysisPart| {
        cells![
            &part.head.id,
            part.name,
            or_not_stated(&part.head.sensor),
            mode_at(&part.head.mode, part.head.location),
            Cell::degc(part.head.temperature_degc),
            part.rows.as_ref().map_or(Cell::Missing("-"), |rows| format!("{} of {}", rows.used, rows.total).into()),
            &part.headline,
            Text::of_note(&part.remarks.join(". ")),
        ]
    };
    Table::new(["run", "analysis", "sensor", "mode", "temperature", "rows used", "result", "remarks"])
        .with_rows(analyses.iter().map(row))
}

fn thermals(p: &Protocol, figure: &mut usize) -> Section {
    let mut chapter = Section::new("Combined measurements");
    let not_applied = || p.not_applied.iter().map(|which| Block::from(format!("No polynomials: {which}.")));
    if p.thermals.is_empty() {
        let words = "The runs are not at different temperatures: there is no thermal analysis.";
        return chapter.with(words).with_all(not_applied());
    }
    for part in &p.thermals {
        let head = &part.thermal.runs;
        let title = format!(
            "Thermal analysis, {} {}: {}",
            or_not_stated(&head.sensor),
            mode_at(&head.mode, head.location),
            thermal::title(part.thermal.kind()).to_lowercase().replace("ac transfer", "AC transfer")
        );
        let figures = Drawn::number(part.figures, "", figure);
        chapter.sections.push(with_figures(Section::new(title), &thermal::sections(part.thermal, &part.file_name), figures));
    }
    let missing: Vec<&str> =
        Kind::ALL.iter().filter(|k| !p.thermals.iter().any(|t| t.thermal.kind() == **k)).map(|k| k.name()).collect();
    if !missing.is_empty() {
        let words = format!("No thermal analysis of {} runs: there are none, or not at two temperatures.", missing.join(" and "));
        last_blocks(&mut chapter).push(words.into());
    }
    let last = last_blocks(&mut chapter);
    last.extend(not_applied());
    last.extend(p.beside_alone.iter().cloned().map(Block::from));
    chapter
}

/// The blocks at the very end of a section: those of its last section, of that one's last, and so on.
fn last_blocks(section: &mut Section) -> &mut Vec<Block> {
    match section.sections.is_empty() {
        true => &mut section.blocks,
        false => {
            let last = section.sections.len() - 1;
            last_blocks(&mut section.sections[last])
        }
    }
}

/// A chapter of results that belong to no single run.
fn others(title: &str, parts: &[OtherPart], figure: &mut usize) -> Section {
    let section = |part: &OtherPart| {
        let figures = Drawn::number(&part.figures, "", figure);
        with_figures(Section::new(part.title.as_str()), &part.sections, figures)
    };
    Section::new(title).with_sections(parts.iter().map(section))
}

fn origin(p: &Protocol) -> Section {
    let hash = |text: &str| Text::default().code(text);
    let files = p.files.iter().map(|(file, sha256)| cells![hash(file), hash(sha256)]);
    let method = "Fits and conventions are those of the mathematical description. Samples after a step or a change of frequency are left out \
                  until the data no longer show it; stretches with spikes, plateaus with missing samples and fields beyond the stated limits \
                  are left out with their reason. ";
    let analyses: Vec<&AnalysisPart> = p.runs.iter().filter_map(|run| run.analysis.as_ref()).collect();
    Section::new("Origin and uncertainty")
        .with_sections([
            uncertainty(p),
            Section::new("Method").with(Text::words_and_code([method, &p.provenance.command, "."])),
            Section::new("Inputs").with(inputs(&p.provenance)),
            Section::new("Files that belong to this protocol").with(Table::new(["file", "SHA-256"]).with_rows(files)),
        ])
        .with_sections(rows_used(&analyses))
        .with_sections(signatures(p.campaign))
}

/// How many rows every result rests on, and why the others are not used.
fn rows_used(analyses: &[&AnalysisPart]) -> Option<Section> {
    let row = |part: &&AnalysisPart| {
        let rows = part.rows.as_ref()?;
        let reasons: Vec<String> = rows.rejected.iter().map(|(reason, count)| format!("{count}: {reason}")).collect();
        let reasons = if reasons.is_empty() { "none".to_owned() } else { reasons.join("; ") };
        Some(cells![&part.head.id, part.name, rows.used, rows.total, reasons])
    };
    let table = Table::new(["run", "analysis", "rows used", "rows", "not used"]).with_rows(analyses.iter().filter_map(row));
    let section = Section::new("Rows of the runs")
        .with("Rows are settings with their means, or sines. Their single places stand in the reports and parameter files of the runs.")
        .with(table);
    (!analyses.is_empty()).then_some(section)
}

/// Lines to sign on, where the campaign says who signs.
fn signatures(campaign: &Campaign) -> Option<Section> {
    const LINE: &str = "______________________";
    let names = &campaign.file.stated.signatures;
    let rows = names.iter().map(|name| cells![name, LINE, LINE]);
    let table = Table::new(["name", "date", "signature"]).with_rows(rows);
    (!names.is_empty()).then(|| Section::new("Signatures").with(table))
}

fn uncertainty(p: &Protocol) -> Section {
    let campaign = p.campaign;
    let analyses: Vec<&AnalysisPart> = p.runs.iter().filter_map(|run| run.analysis.as_ref()).collect();
    let of_facility = match analyses.iter().filter(|a| a.has_type_b).count() {
        0 => "no".to_owned(),
        with => format!("in {with} of {} analysed runs, from the facility file; common to them all", analyses.len()),
    };
    let rows = [
        ["noise of the readings, white and slow", "A", "yes, from the scatter of the data"],
        ["scatter between runs", "A", "in the thermal polynomials, where it exceeds that of the single runs"],
        ["choice of the response model", "A", "in f_3dB, by leaving out one amplitude at a time"],
        ["coil constants and coil angles", "B", &of_facility],
        ["alignment of the coil axes, homogeneity over the sensor", "B", "no"],
        ["field source, earth-field compensation", "B", "no"],
        ["reading and place of the thermometers", "B", "no"],
        ["facility clock", "B", "no"],
    ];
    Section::new("Uncertainty")
        .with(
            "All uncertainties are standard uncertainties with coverage factor 1. An interval of 1.96 of them is meant to hold the true \
             value with a probability of 95 %; where few runs or plateau means tell them, the factor is that of Student's t, which stands in the \
             parameter file or beside its polynomial. Degrees of freedom and the full covariance of every result stand in its parameter file.",
        )
        .with(Table::new(["contribution", "type", "contained"]).with_rows(rows.map(|r| r.map(Cell::from).to_vec())))
        .with(format!(
            "Traceability of the reference field: {}. Uncertainty of the reference field: {}. No statement of conformity is made.",
            stated(campaign, "Traceability of the reference field").unwrap_or("not stated"),
            stated(campaign, "Uncertainty of the reference field").unwrap_or("not stated")
        ))
}
