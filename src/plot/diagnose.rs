//! Figures of a diagnosis: where readings and model disagree, why an effect was named, and what is left with it.

use super::parts::Named;
use super::rows::shades;
use super::{Band, CellRow, Figure, Marks, Panel, Scale, Series, Style};
use crate::data::units::Scale::{Calibrated, Engineering};
use crate::data::units::{COMPONENTS, three_digits};
use crate::diagnose::result::{Branches, Diagnosis, Evidence, InsideMap, Map, Place, Step, VerdictKind};
use crate::model::effects::GAIN_WITH;

/// Steps that have figures; a run has fewer effects.
const STEPS: usize = 12;
/// Rows of each panel of the map of disagreement.
const PLACES: usize = 8;
const RESIDUALS: [&str; STEPS] =
    ["step_1", "step_2", "step_3", "step_4", "step_5", "step_6", "step_7", "step_8", "step_9", "step_10", "step_11", "step_12"];
const INSIDE: [&str; STEPS] = [
    "step_1_inside",
    "step_2_inside",
    "step_3_inside",
    "step_4_inside",
    "step_5_inside",
    "step_6_inside",
    "step_7_inside",
    "step_8_inside",
    "step_9_inside",
    "step_10_inside",
    "step_11_inside",
    "step_12_inside",
];
const EVIDENCE: [&str; STEPS] = [
    "step_1_evidence",
    "step_2_evidence",
    "step_3_evidence",
    "step_4_evidence",
    "step_5_evidence",
    "step_6_evidence",
    "step_7_evidence",
    "step_8_evidence",
    "step_9_evidence",
    "step_10_evidence",
    "step_11_evidence",
    "step_12_evidence",
];
const STYLES: [Style; 3] = [Style::X, Style::Y, Style::Z];

/// Stem of the figure of the disagreement before anything is named.
pub const WHERE: &str = "where";
/// Stem of the figure of what is left in the end.
pub const LEFT: &str = "residuals";

/// Stems of the figures of a step.
#[must_use]
pub fn stems(step: usize) -> Vec<&'static str> {
    [RESIDUALS, INSIDE, EVIDENCE].iter().filter_map(|names| names.get(step).copied()).collect()
}

/// The map of disagreement; residuals, insides of the plateaus and evidence of every step; what is left in the end.
#[must_use]
pub fn figures(diagnosis: &Diagnosis) -> Vec<Named> {
    let pictures = &diagnosis.pictures;
    let mut all: Vec<Named> = places(diagnosis).into_iter().collect();
    for (index, step) in diagnosis.steps.iter().enumerate().take(STEPS) {
        let mut add = |stem: &'static str, figure: Figure| all.push(Named { stem, figure });
        for map in diagnosis.maps.iter().filter(|m| m.step == index) {
            add(RESIDUALS[index], residuals(diagnosis, step, map));
        }
        if let Some(branches) = pictures.branches.as_ref().filter(|b| b.step == index) {
            add(INSIDE[index], heating_and_cooling(diagnosis, branches));
        }
        if let Some(map) = pictures.inside.iter().find(|m| m.step == index) {
            add(INSIDE[index], inside(diagnosis, step, map));
        }
        // A single bar compares nothing.
        if let Some(evidence) = pictures.evidence.iter().find(|e| e.step == index && e.bars.len() > 1) {
            add(EVIDENCE[index], bars(diagnosis, step, evidence));
        }
    }
    all.extend(left(diagnosis));
    all
}

/// The run, or the first and the last one of those that were looked at together.
fn subject(diagnosis: &Diagnosis) -> String {
    match diagnosis.runs.as_slice() {
        [first, .., last] => format!("{} runs, {first} to {last}", diagnosis.runs.len()),
        one => match diagnosis.pictures.scale {
            Engineering => format!("Run {}", one.concat()),
            Calibrated => format!("Difference {}", one.concat()),
        },
    }
}

fn name(step: &Step) -> String {
    step.covariate.as_ref().map_or_else(|| step.effect.to_string(), |c| format!("{} ({c})", step.effect))
}

fn with_unit(quantity: &str, unit: &str) -> String {
    if unit.is_empty() { quantity.to_owned() } else { format!("{quantity}, {unit}") }
}

/// Multiples of the noise from which a cell has its number.
const TOLD: f64 = 3.0;

/// Covariates that explain most on any axis, in the same order for all axes that show a disagreement.
fn places(diagnosis: &Diagnosis) -> Option<Named> {
    let (places, scale) = (&diagnosis.pictures.places, diagnosis.pictures.scale);
    let mut names: Vec<&str> = Vec::new();
    for place in places {
        if !names.contains(&place.covariate.as_str()) {
            names.push(&place.covariate);
        }
    }
    names.truncate(PLACES);
    if names.is_empty() {
        return None;
    }
    let is_told = |axis: &&&str| {
        let own = places.iter().filter(|p| p.axis == **axis && names.contains(&p.covariate.as_str()));
        own.flat_map(|p| &p.bins).any(|b| b.multiples_of_noise.abs() >= TOLD)
    };
    let told: Vec<&str> = COMPONENTS.iter().filter(is_told).copied().collect();
    let axes = if told.is_empty() { COMPONENTS.to_vec() } else { told };
    let row = |place: &Place| CellRow {
        name: place.covariate.clone(),
        cells: place.bins.iter().map(|b| (100.0 * b.share[0], 100.0 * b.share[1], b.multiples_of_noise)).collect(),
    };
    let panel = |axis: &str| Panel {
        y_label: axis.to_owned(),
        y_scale: Scale::Linear,
        series: vec![Series {
            label: String::new(),
            style: Style::Single,
            marks: Marks::Cells(
                names.iter().filter_map(|n| places.iter().find(|p| p.axis == axis && p.covariate == *n)).map(row).collect(),
            ),
        }],
        bands: Vec::new(),
    };
    let figure = Figure {
        title: format!("{}: where readings and model disagree", subject(diagnosis)),
        caption: format!(
            "Before anything is named: displacement of the readings along the {} {} (top to bottom) for bins of the \
             covariates, fitted beside the model, in multiples of its standard uncertainty. Blue cells are below the model, orange \
             ones above, the darker the larger: {}. Noise alone gives 3 or more in one cell of 370. {} of {} covariates; those stand first \
             whose smooth functions predict most of what was left out of their fit. A gain multiplies the reading.{}",
            if axes.len() == 1 { scale.axis().to_owned() } else { scale.axis().replace("axis", "axes") },
            axes.join(", "),
            shades(),
            names.len(),
            places.len() / 3,
            if axes.len() < COMPONENTS.len() { " Axes without such a cell are left out." } else { "" }
        ),
        x_label: match scale {
            Engineering => "plateaus in the order of the covariate, %".to_owned(),
            Calibrated => "means in the order of the covariate, %".to_owned(),
        },
        x_scale: Scale::Linear,
        panels: axes.iter().map(|axis| panel(axis)).collect(),
    };
    Some(Named { stem: WHERE, figure })
}

fn panel(map: &Map, y_label: String, values: &[f64], style: Style, label: &str) -> Panel {
    let points = map.x.iter().zip(values).map(|(x, y)| (*x, *y, None)).collect();
    // Before and after are seen on one scale.
    let both = map.x.iter().zip(&map.before_nt).chain(map.x.iter().zip(&map.after_nt));
    let shown = unseen(both.map(|(x, y)| (*x, *y)).collect());
    let named = map.x.iter().copied().zip(map.names.iter().cloned()).collect();
    let names = Series { label: String::new(), style: Style::Reference, marks: Marks::Names(named) };
    Panel {
        y_label,
        y_scale: Scale::Linear,
        series: vec![Series { label: label.to_owned(), style, marks: Marks::Points(points) }, shown, names],
        bands: vec![Band {
            label: format!("±2 noise, {:.3} nT", 2.0 * map.noise_nt),
            low: -2.0 * map.noise_nt,
            high: 2.0 * map.noise_nt,
        }],
    }
}

/// Root mean square of the points that are drawn.
fn rms(values: &[f64]) -> f64 {
    let drawn: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    (drawn.iter().map(|v| v * v).sum::<f64>() / drawn.len().max(1) as f64).sqrt()
}

/// Places that a panel shows beside its data.
fn unseen(places: Vec<(f64, f64)>) -> Series {
    Series { label: String::new(), style: Style::Reference, marks: Marks::Shown(places) }
}

/// Frequencies are spread by ratios.
fn x_scale(map: &Map) -> Scale {
    if map.unit == "Hz" { Scale::Logarithmic } else { Scale::Linear }
}

fn residuals(diagnosis: &Diagnosis, step: &Step, map: &Map) -> Figure {
    let axis = COMPONENTS[map.axis];
    let is_gain = map.covariate.starts_with(GAIN_WITH);
    let label = if is_gain { "residual with the sign of the reading, nT" } else { "residual, nT" }.to_owned();
    Figure {
        title: format!("{}: {} on {axis}, before and after", subject(diagnosis), name(step)),
        caption: format!(
            "Measured minus modelled reading on the {} {axis} (of a calibration the residuals are applied minus modelled field, of the other \
             sign), every point predicted by a fit that did not see it: above without {}, below with it. Root mean square of the points {} and {} nT; the band is twice the noise of a mean.",
            diagnosis.pictures.scale.axis(),
            step.effect,
            three_digits(rms(&map.before_nt)),
            three_digits(rms(&map.after_nt))
        ),
        x_label: with_unit(&map.covariate, &map.unit),
        x_scale: x_scale(map),
        panels: vec![
            panel(map, label.clone(), &map.before_nt, Style::Y, "without the effect"),
            panel(map, label, &map.after_nt, Style::X, "with the effect"),
        ],
    }
}

fn inside(diagnosis: &Diagnosis, step: &Step, map: &InsideMap) -> Figure {
    let unit = map.quantity.rsplit(", ").next().unwrap_or_default();
    let panel = |title: &str, after: bool| Panel {
        y_label: with_unit(title, unit),
        y_scale: Scale::Linear,
        series: (0..3)
            .map(|a| {
                let value = |b: &crate::diagnose::result::InsideBin| if after { b.after[a] } else { b.before[a] };
                Series {
                    label: COMPONENTS[a].to_owned(),
                    style: STYLES[a],
                    marks: Marks::Points(map.bins.iter().map(|b| (b.x, value(b), Some(b.std[a]))).collect()),
                }
            })
            .chain([unseen(map.bins.iter().flat_map(|b| b.before.into_iter().chain(b.after).map(|y| (b.x, y))).collect())])
            .collect(),
        bands: Vec::new(),
    };
    Figure {
        title: format!("{}: {} inside the plateaus", subject(diagnosis), step.effect),
        caption: format!(
            "Means of the samples ({}) along the sensor axes x, y, z with standard uncertainties: above without {}, below with it. \
             Chi square over degrees of freedom of the samples goes from {:.2} to {:.2}.",
            map.quantity, step.effect, step.gap_before.chi2_per_dof, step.gap_after.chi2_per_dof
        ),
        x_label: map.covariate.clone(),
        x_scale: Scale::Linear,
        panels: vec![panel("without", false), panel("with", true)],
    }
}

fn heating_and_cooling(diagnosis: &Diagnosis, branches: &Branches) -> Figure {
    let all = branches.rising.iter().chain(&branches.falling);
    let both: Vec<(f64, f64)> = all.flat_map(|p| [(p.degc, p.before_k), (p.degc, p.after_k)]).collect();
    let panel = |title: &str, after: bool| {
        let series = |label: &str, style: Style, points: &[crate::diagnose::result::BranchPoint]| Series {
            label: label.to_owned(),
            style,
            marks: Marks::Points(
                points.iter().map(|p| (p.degc, if after { p.after_k } else { p.before_k }, Some(p.std_k))).collect(),
            ),
        };
        Panel {
            y_label: title.to_owned(),
            y_scale: Scale::Linear,
            series: vec![
                series("heating", Style::Y, &branches.rising),
                series("cooling", Style::X, &branches.falling),
                unseen(both.clone()),
            ],
            bands: Vec::new(),
        }
    };
    Figure {
        title: format!("{}: heating and cooling, thermistor {}", subject(diagnosis), branches.thermistor),
        caption: format!(
            "Temperature that the readings speak of, from the residuals of held-out stretches over the sensitivity to the \
             temperature, minus that of the thermistor {}: above without a lag, below with it. Heating and cooling come apart where \
             the thermistor leads or lags.",
            branches.thermistor
        ),
        x_label: format!("temperature of the thermistor {}, °C", branches.thermistor),
        x_scale: Scale::Linear,
        panels: vec![panel("without, K", false), panel("with, K", true)],
    }
}

fn bars(diagnosis: &Diagnosis, step: &Step, evidence: &Evidence) -> Figure {
    let own = evidence.bars.first().map_or(0.0, |b| b.1);
    let limit = own - evidence.apart;
    let bottom = 0.5 - evidence.bars.len() as f64;
    let series = vec![
        Series {
            label: "evidence".to_owned(),
            style: Style::X,
            marks: Marks::Bars(evidence.bars.iter().map(|(name, to)| (name.clone(), vec![(0.0, *to)])).collect()),
        },
        Series {
            label: format!("a hundredth of {}", name(step)),
            style: Style::Y,
            marks: Marks::Line(vec![(limit, 0.5), (limit, bottom)]),
        },
    ];
    Figure {
        title: format!("{}: evidence of {} and its rivals", subject(diagnosis), name(step)),
        caption: format!(
            "Natural logarithm of the likelihood ratio of each explanation to a model without it, with its prior and the number of \
             its forms paid for. Rivals that reach the line, ln 100 = {:.1} below the effect that was named, cannot be told from it.",
            evidence.apart
        ),
        x_label: "ln of the likelihood ratio".to_owned(),
        x_scale: Scale::Linear,
        panels: vec![Panel { y_label: String::new(), y_scale: Scale::Linear, series, bands: Vec::new() }],
    }
}

fn left(diagnosis: &Diagnosis) -> Option<Named> {
    let maps = &diagnosis.pictures.left;
    let first = maps.first()?;
    let what = match diagnosis.verdict_kind {
        VerdictKind::None => "no missing effect",
        VerdictKind::Found => "what is left with all effects",
        VerdictKind::Undecided => "more than noise is left, no effect is named",
    };
    let figure = Figure {
        title: format!("{}: {what}", subject(diagnosis)),
        caption: format!(
            "Measured minus modelled reading along each {}, every point predicted by a fit that did not see it; the bands are twice the \
             noise of a mean.",
            diagnosis.pictures.scale.axis()
        ),
        x_label: with_unit(&first.covariate, &first.unit),
        x_scale: x_scale(first),
        panels: maps
            .iter()
            .map(|map| {
                let axis = COMPONENTS[map.axis];
                panel(map, format!("{axis}, nT"), &map.after_nt, STYLES[map.axis], axis)
            })
            .collect(),
    };
    Some(Named { stem: LEFT, figure })
}
