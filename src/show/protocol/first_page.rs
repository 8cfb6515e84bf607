//! The first page of a protocol: what became of the campaign, the final parameters of every sensor and mode at one temperature, the runs
//! without a result, and the figures that say most.

use super::{Protocol, RunPart, identifier, in_words, stated};
use crate::data::across::{CalibratedRun, CommonChange, RunValues};
use crate::data::note::{Note, NoteKind};
use crate::data::run::{Location, Run};
use crate::data::run_state::{RunCounts, RunState};
use crate::data::start::Start;
use crate::files::campaign::file::CampaignFile;
use crate::measure::centre::AtCentre;
use crate::measure::thermal::QuantityFit;
use crate::show::document::{Block, Cell, Table, Text, cells};
use crate::show::{Drawn, degc, mode_at, or_not_stated};

/// Where the campaign states no temperature, °C.
const USUAL_DEGC: f64 = 20.0;
/// Figures on the first page.
const FIGURES: usize = 4;
/// The figures that say most, the first ones before the later ones: parts of the names of their files.
const TELLING: [&str; 10] = [
    "THERMAL_sensitivities",
    "THERMAL_OFF_offsets",
    "_frequency_response",
    "TEMPERATURE_PROFILE",
    "THERMAL_misalignment",
    "_sensitivities",
    "_residuals_field_x",
    "_zero_levels",
    "_amplitude_density",
    "_differences",
];

/// The first page; its figures are numbered on from the last number used.
pub(super) fn blocks(p: &Protocol, figure: &mut usize) -> Vec<Block> {
    let mut page: Vec<Block> = vec![verdict(p).into()];
    page.extend(failures(p));
    page.extend(p.contradictions.iter().cloned().map(Block::from));
    page.push(facts(p).into());
    page.extend(p.campaign.file.stated.remarks.iter().map(|text| Block::from(text.as_str())));
    let parameters: Vec<Block> = parts(p).iter().flat_map(|of| of.blocks(p)).collect();
    if !parameters.is_empty() {
        page.push(
            "Readings in enT become fields in nT along the sensor axes by subtracting the offset and multiplying with the sensitivity; \
             ω of the angles makes the axes orthogonal. Uncertainties are standard uncertainties, coverage factor 1, with what the \
             facility's file states of type B.".into(),
        );
    }
    page.extend(parameters);
    for (result, file) in &p.at_centre {
        page.extend(taken_to_centre(result, file, p.campaign.file.reference_degc));
    }
    page.extend(without_result(p));
    page.extend(figures(p, figure));
    page.push("The results hold for the sensors and electronics named here only.".into());
    page
}

fn counts(p: &Protocol) -> RunCounts {
    p.runs.iter().map(|part| part.outcome.state).collect()
}

/// The campaign in a sentence.
fn verdict(p: &Protocol) -> Text {
    let counts = counts(p);
    let complete = counts.refused == 0 && p.failed.is_empty();
    let analyses = match p.thermals.len() {
        0 => "no analysis across temperatures".to_owned(),
        1 => "1 analysis across temperatures".to_owned(),
        n => format!("{n} analyses across temperatures"),
    };
    let with_remarks =
        p.runs.iter().filter(|part| part.analysis.as_ref().is_some_and(|analysis| !analysis.remarks.is_empty())).count();
    let remarks = match with_remarks {
        0 => "no run has a remark".to_owned(),
        1 => "1 run has a remark".to_owned(),
        n => format!("{n} runs have remarks"),
    };
    let verdict = match (complete, p.contradictions.is_empty()) {
        (true, true) => "Everything that applies to this campaign was done.",
        (true, false) => "Everything that applies to this campaign was done, and results contradict each other.",
        (false, true) => "The calibration is incomplete.",
        (false, false) => "The calibration is incomplete, and results contradict each other.",
    };
    Text::default().strong(verdict).and(format!(" {counts}; {analyses}; {remarks}."))
}

/// What was refused or failed, to be seen.
fn failures(p: &Protocol) -> Vec<Block> {
    let refused = p.runs.iter().filter(|part| part.outcome.state == RunState::Refused);
    let refused = refused.map(|part| (part.file.as_str(), part.outcome.reason.as_deref().unwrap_or("")));
    let all: Vec<(&str, &str)> = refused.chain(p.failed.iter().map(|(what, why)| (what.as_str(), why.as_str()))).collect();
    if all.is_empty() {
        return Vec::new();
    }
    let text = if all.len() == 1 {
        "One thing failed or was refused:".to_owned()
    } else {
        format!("{} things failed or were refused:", all.len())
    };
    vec![Note::new(NoteKind::LeftOut, text).into(), by_reason(all)]
}

/// What is stated of laboratory, item and persons, and when it was measured and evaluated.
fn facts(p: &Protocol) -> Table {
    let mut table = Table::new(["", ""]);
    for (_, label) in CampaignFile::REPORT.into_iter().filter(|(_, label)| *label != "Title") {
        if let Some(text) = stated(p.campaign, label) {
            table.push(cells![label, text]);
        }
    }
    if stated(p.campaign, "Document").is_none() {
        table.push(cells!["Document", identifier(p)]);
    }
    let personnel = &p.campaign.file.stated.personnel;
    if !personnel.is_empty() {
        table.push(cells!["Personnel", personnel.join("; ")]);
    }
    if let Some(instrument) = &p.campaign.file.instrument {
        table.push(cells!["Instrument", instrument]);
    }
    let starts: Vec<&Start> = p.runs.iter().filter_map(|part| part.header).map(|header| &header.start).collect();
    // Of a run that was not read its start is all that is known.
    let of_run = |part: &RunPart| Some(part.header?.start.after(part.run.map_or(0.0, Run::duration_s)));
    if let (Some(first), Some(last)) = (starts.iter().min(), p.runs.iter().filter_map(of_run).max()) {
        table.push(cells!["Measurements", format!("from {first} to {last}")]);
    }
    table.push(cells!["Date of issue", &p.provenance.created]);
    table.push(cells!["Software", format!("{} {} ({})", p.provenance.tool, p.provenance.tool_version, p.provenance.build)]);
    table
}

/// Runs without a result for which nobody is to blame.
fn without_result(p: &Protocol) -> Option<Block> {
    let quiet = |state| matches!(state, RunState::Excluded | RunState::Gone | RunState::NotApplicable);
    let parts = p.runs.iter().filter(|part| quiet(part.outcome.state));
    let all: Vec<(&str, String)> = parts.map(|part| (part.id.as_str(), in_words(&part.outcome))).collect();
    (!all.is_empty()).then(|| by_reason(all.iter().map(|(id, words)| (*id, words.as_str()))))
}

/// A list of runs or files with what became of them, one item for every reason.
fn by_reason<'a>(all: impl IntoIterator<Item = (&'a str, &'a str)>) -> Block {
    let mut reasons: Vec<(&str, Vec<&str>)> = Vec::new();
    for (name, words) in all {
        match reasons.iter_mut().find(|(other, _)| *other == words) {
            Some((_, names)) => names.push(name),
            None => reasons.push((words, vec![name])),
        }
    }
    Block::List(reasons.iter().map(|(words, names)| Text::of_note(&format!("{}: {words}", names.join(", ")))).collect())
}

/// The figures that say most.
fn figures(p: &Protocol, last: &mut usize) -> Vec<Block> {
    let of_runs = p.runs.iter().filter_map(|part| part.analysis.as_ref());
    let of_runs = of_runs.flat_map(|part| part.figures.iter().map(move |drawn| (format!("{}/", part.head.id), drawn)));
    let of_groups = p.thermals.iter().flat_map(|part| part.figures.iter().map(|drawn| (String::new(), drawn)));
    let of_all = p.profile.iter().map(|drawn| (String::new(), drawn));
    let all: Vec<(String, &Drawn)> = of_groups.chain(of_all).chain(of_runs).collect();
    let mut chosen: Vec<&(String, &Drawn)> = Vec::new();
    for part in TELLING {
        let is_new = |one: &&(String, &Drawn)| !chosen.iter().any(|other| other.1.file == one.1.file);
        if let Some(found) = all.iter().filter(|(_, drawn)| drawn.file.contains(part)).find(is_new)
            && chosen.len() < FIGURES
        {
            chosen.push(found);
        }
    }
    let numbered = chosen.into_iter().flat_map(|(folder, drawn)| Drawn::number(std::slice::from_ref(drawn), folder, last));
    numbered.map(Block::Figure).collect()
}

/// A sensor in a mode at a place, with everything that its parameters follow from.
struct Parameters<'a> {
    sensor: &'a str,
    mode: &'a str,
    location: Location,
    /// Polynomials, with what they rest on and the name of their file.
    quantities: Vec<(&'a QuantityFit, String, String)>,
    points: Vec<&'a CalibratedRun>,
}

/// A family of parameters: its name in files, its words, symbol, components and unit for people.
type Family = (&'static str, &'static str, &'static str, [&'static str; 3], &'static str);

/// The families in their order.
const FAMILIES: [Family; 6] = [
    ("sigma", "sensitivity", "σ", ["x", "y", "z"], "nT/enT"),
    ("xi", "angle", "ξ", ["xy", "xz", "yz"], "°"),
    ("b_off", "offset", "B_off", ["x", "y", "z"], "enT"),
    ("b_or", "offset and residual field", "B_or", ["x", "y", "z"], "enT"),
    ("f_3db", "-3 dB frequency", "f_3dB", ["x", "y", "z"], "Hz"),
    ("f_3db_igep", "-3 dB frequency between amplitudes", "f_3dB", ["x", "y", "z"], "Hz"),
];
/// What says less than the family before it, where both are there.
const SAYS_LESS: [(&str, &str); 2] = [("b_or", "b_off"), ("f_3db_igep", "f_3db")];

/// All sensors and modes, in the order of their names.
fn parts<'a>(p: &'a Protocol) -> Vec<Parameters<'a>> {
    let mut all: Vec<Parameters> = Vec::new();
    let groups = p.thermals.iter().map(|part| {
        let runs = &part.thermal.runs;
        let from = format!("{} runs", runs.ids.len());
        ((runs.sensor.as_str(), runs.mode.as_str(), runs.location), &part.thermal.quantities, from, part.file_name.clone())
    });
    let sweeps = p.sweeps.iter().map(|sweep| {
        let run = &sweep.run;
        ((run.sensor.as_str(), run.mode.as_str(), run.location), &sweep.quantities, format!("sweep {}", run.id), String::new())
    });
    for (key, quantities, from, file) in groups.chain(sweeps) {
        let own = of_sensor(&mut all, key);
        // What the runs of a group gave goes before what a sweep gave.
        for quantity in quantities {
            if !own.quantities.iter().any(|(other, ..)| other.found.name == quantity.found.name) {
                own.quantities.push((quantity, from.clone(), file.clone()));
            }
        }
    }
    for point in &p.points {
        let run = &point.run;
        of_sensor(&mut all, (run.sensor.as_str(), run.mode.as_str(), run.location)).points.push(point);
    }
    all.sort_by_key(|own| (own.sensor, own.mode, own.location));
    all
}

fn of_sensor<'a, 'b>(all: &'b mut Vec<Parameters<'a>>, key: (&'a str, &'a str, Location)) -> &'b mut Parameters<'a> {
    let (sensor, mode, location) = key;
    let index = all.iter().position(|own| (own.sensor, own.mode, own.location) == key).unwrap_or_else(|| {
        all.push(Parameters { sensor, mode, location, quantities: Vec::new(), points: Vec::new() });
        all.len() - 1
    });
    &mut all[index]
}

impl Parameters<'_> {
    fn blocks(&self, p: &Protocol) -> Vec<Block> {
        let ranges: Vec<[f64; 2]> = self.quantities.iter().map(|(quantity, ..)| quantity.polynomial.valid_degc).collect();
        let (at_degc, why) = reference(&ranges, p.campaign.file.reference_degc);
        let (mut rows, mut found): (Vec<Vec<Cell>>, Vec<&str>) = (Vec::new(), Vec::new());
        for family in &FAMILIES {
            if SAYS_LESS.iter().any(|(less, more)| *less == family.0 && found.contains(more)) {
                continue;
            }
            if let Some(of_family) = self.row(family, at_degc) {
                rows.push(of_family);
                found.push(family.0);
            }
        }
        if rows.is_empty() {
            return Vec::new();
        }
        let mut files: Vec<&str> = self.quantities.iter().map(|(_, _, file)| file.as_str()).filter(|f| !f.is_empty()).collect();
        files.dedup();
        let title = format!("{} {}", or_not_stated(self.sensor), mode_at(self.mode, self.location));
        vec![heading(title, &why, &files).into(), parameters().with_rows(rows).into()]
    }

    /// A family at a temperature: by its polynomials, or by the run that is nearest.
    fn row(&self, of: &Family, at_degc: f64) -> Option<Vec<Cell>> {
        let (family, _, _, components, _) = of;
        let fit = |component: &str| {
            let wanted = format!("{family}_{component}");
            self.quantities.iter().find(|(quantity, ..)| quantity.found.name == wanted)
        };
        if let [Some(x), Some(y), Some(z)] = components.map(fit) {
            let all = [x, y, z];
            let mut from: Vec<&str> = all.iter().map(|(_, from, _)| from.as_str()).collect();
            from.dedup();
            return Some(row(of, all.map(|(quantity, ..)| at(quantity, at_degc)), &from.join(", ")));
        }
        let measured = self.points.iter().filter_map(|point| Some((point, values(&point.values, family)?)));
        let far = |point: &CalibratedRun| point.run.temperature_degc.map_or(f64::INFINITY, |t| (t - at_degc).abs());
        let (point, (value, std)) = measured.min_by(|a, b| far(a.0).total_cmp(&far(b.0)))?;
        let from = format!("run {}, {}", point.run.id, degc(point.run.temperature_degc));
        Some(row(of, std::array::from_fn(|i| Cell::uncertain(value[i], std[i])), &from))
    }
}

/// A table of parameters, one family in a row.
fn parameters() -> Table {
    Table::new(["parameter", "x or xy", "y or xz", "z or yz", "from"])
}

/// A family with its three components.
fn row((_, words, symbol, _, unit): &Family, components: [Cell; 3], from: &str) -> Vec<Cell> {
    let mut row = cells![format!("{words} {symbol}, {unit}")];
    row.extend(components);
    row.push(from.into());
    row
}

/// What stands above a table of parameters.
fn heading(title: String, why: &str, files: &[&str]) -> Text {
    let mut text = Text::default().strong(title).and(format!(" {why}."));
    for (i, file) in files.iter().enumerate() {
        text = text.and(if i == 0 { " Files: " } else { ", " }).code(*file);
    }
    if files.is_empty() { text } else { text.and(".") }
}

/// The temperature at which parameters are given, and the words that say why; `ranges` are those of their polynomials.
fn reference(ranges: &[[f64; 2]], stated: Option<f64>) -> (f64, String) {
    let low = ranges.iter().map(|[low, _]| *low).fold(f64::NEG_INFINITY, f64::max);
    let high = ranges.iter().map(|[_, high]| *high).fold(f64::INFINITY, f64::min);
    let asked = stated.unwrap_or(USUAL_DEGC);
    let whose = if stated.is_some() { ", the reference temperature of campaign.toml" } else { "" };
    let Some([first_low, first_high]) = ranges.first().copied() else {
        return (asked, format!("by the runs nearest to {asked} °C{whose}; there are no polynomials"));
    };
    if (low..=high).contains(&asked) {
        return (asked, format!("at {asked} °C{whose}; the polynomials hold from {low:.1} to {high:.1} °C"));
    }
    let (low, high) = if low <= high { (low, high) } else { (first_low, first_high) };
    let middle = 0.5 * (low + high);
    let why = format!(
        "at {middle:.1} °C, the middle of the range of the polynomials, {low:.1} to {high:.1} °C, in which {asked} °C is not"
    );
    (middle, why)
}

/// Polynomials that were taken to the centre, at the reference temperature.
fn taken_to_centre(result: &AtCentre, file: &str, stated: Option<f64>) -> [Block; 2] {
    let (at_degc, why) = reference(&[result.beside.valid_degc], stated);
    let families = [
        ("sigma", Some(&result.sigma)),
        ("xi", Some(&result.xi_deg)),
        ("b_off", result.offset.as_ref().map(|offset| &offset.b_off_ent)),
    ];
    let mut table = parameters();
    for (name, polynomials) in families {
        let Some(family) = FAMILIES.iter().find(|family| family.0 == name) else { continue };
        if let Some(polynomials) = polynomials {
            let components = polynomials.each_ref().map(|polynomial| polynomial.evaluate(at_degc));
            let components = components.map(|(value, std)| Cell::uncertain(value, std));
            table.push(row(family, components, "polynomials beside the centre, k and K"));
        }
    }
    let of = format!("{} {} at the centre", or_not_stated(&result.beside.sensor), or_not_stated(&result.beside.mode));
    let lacks =
        if result.beside.of_facility.is_some() { "" } else { "; uncertainties are without what the facility adds of type B" };
    let why = format!("taken there from beside the centre of the coil system, in the Rosetta convention of ω, {why}{lacks}");
    [heading(of, &why, &[file]).into(), table.into()]
}

/// A quantity at a temperature, with what the facility adds to its uncertainty.
fn at(quantity: &QuantityFit, at_degc: f64) -> Cell {
    let (value, std) = quantity.polynomial.evaluate(at_degc);
    let of_facility = quantity.covariance_b().map_or(0.0, |covariance| {
        let power = |k: usize| (0..k).fold(1.0, |product, _| product * at_degc);
        let sum = |i: usize| (0..covariance.ncols()).map(|j| covariance[(i, j)] * power(i) * power(j)).sum::<f64>();
        (0..covariance.nrows()).map(sum).sum()
    });
    Cell::uncertain(value, (std * std + of_facility.max(0.0)).sqrt())
}

/// Standard uncertainties by what runs share, of σ, ξ or B_or.
fn of(common: &Option<Vec<CommonChange>>, which: usize) -> Option<[f64; 3]> {
    Some(CommonChange::std_of(common.as_deref()?)[which])
}

/// Values of a run and their standard uncertainties.
fn values(values: &RunValues, family: &str) -> Option<([f64; 3], [f64; 3])> {
    const UNKNOWN: [f64; 3] = [f64::NAN; 3];
    match (values, family) {
        (RunValues::Lin { sigma, std, common, .. }, "sigma") => Some((*sigma, both(std[0], of(common, 0)))),
        (RunValues::Lin { xi_deg, std, common, .. }, "xi") => Some((*xi_deg, both(std[1], of(common, 1)))),
        (RunValues::Lin { b_or_ent, std, common, .. }, "b_or") => Some((*b_or_ent, both(std[2], of(common, 2)))),
        (RunValues::Offset { offset_ent, std, .. }, "b_off") => Some((*offset_ent, std.unwrap_or(UNKNOWN))),
        (RunValues::Freq { model_hz, model_std_hz, .. }, "f_3db") => Some(((*model_hz)?, model_std_hz.unwrap_or(UNKNOWN))),
        (RunValues::Freq { igep_hz, .. }, "f_3db_igep") => Some(((*igep_hz)?, UNKNOWN)),
        _ => None,
    }
}

/// Type A and type B together.
fn both(a: Option<[f64; 3]>, b: Option<[f64; 3]>) -> [f64; 3] {
    let (a, b) = (a.unwrap_or([f64::NAN; 3]), b.unwrap_or_default());
    std::array::from_fn(|i| a[i].hypot(if b[i].is_finite() { b[i] } else { 0.0 }))
}
