//! The report of a diagnosis.

use super::document::{Block, Cell, Figure, Section, Table, Text, cells};
use super::{number, remarks};
use crate::data::units::{Scale, six_digits, three_digits};
use crate::diagnose::result::{Diagnosis, Forecast, Gap, Link, Place, RunnerUp, ShapePoint, Step, TOLD_APART};
use crate::diagnose::words;
use crate::model::effects::GAIN_WITH;
use crate::plot::diagnose::{LEFT, WHERE, stems};
use std::fmt::Write;

/// Its title.
#[must_use]
pub fn title(diagnosis: &Diagnosis) -> String {
    format!("Diagnosis of {} {}", diagnosis.pictures.scale.subject(), diagnosis.runs.join(", "))
}

/// Displacements from this many standard uncertainties on are told.
const TOLD: f64 = 4.0;
/// Most rows of the table of disagreement.
const PLACES: usize = 8;

/// The sections of the report; `figure` gives the figure of a stem, if it was drawn.
#[must_use]
pub fn sections(diagnosis: &Diagnosis, figure: &dyn Fn(&str) -> Option<Figure>) -> Vec<Section> {
    let mut sections = vec![verdict(diagnosis)];
    sections.extend(chain(diagnosis));
    if !diagnosis.pictures.places.is_empty() {
        let section = Section::new("Where the data disagree");
        sections.push(section.with_all(places(&diagnosis.pictures.places, diagnosis.pictures.scale)).with_all(figure(WHERE)));
    }
    for (index, one) in diagnosis.steps.iter().enumerate() {
        sections.push(step(index, one).with_all(stems(index).into_iter().filter_map(figure)));
    }
    if let Some(left) = figure(LEFT) {
        sections.push(Section::new("What is left").with(left));
    }
    if !diagnosis.not_identifiable.is_empty() {
        let rows = diagnosis.not_identifiable.iter().map(|n| cells![n.effect.as_str(), &n.reason]);
        let table = Table::new(["effect", "why these data cannot show it"]).with_rows(rows);
        sections.push(Section::new("What cannot be shown").with(table));
    }
    if !diagnosis.detection_limits.is_empty() {
        let limits = diagnosis.detection_limits.iter();
        let rows = limits.map(|d| cells![d.effect.as_str(), &d.axis, Cell::fixed(d.amplitude_nt, 4), &d.parameter]);
        sections.push(
            Section::new("Detection limits")
                .with("Smallest effects that would have been found in nine of ten such runs.")
                .with(Table::new(["effect", "axis", "largest contribution, nT", "parameter"]).with_rows(rows)),
        );
    }
    sections.extend(remarks(&diagnosis.notes));
    sections
}

fn verdict(diagnosis: &Diagnosis) -> Section {
    let floor: Vec<String> = diagnosis.noise_floor_nt.iter().map(|n| number(*n, 4)).collect();
    let mut words = format!(" Noise of a mean: {} nT (x, y, z).", floor.join(", "));
    if let Some(basis) = &diagnosis.basis {
        let _ = write!(words, " Looked at: {basis}.");
    }
    if let Some(response) = &diagnosis.response {
        let _ = write!(words, " Response: {response}.");
    }
    if let Some(noise) = diagnosis.noise {
        let _ = write!(
            words,
            " It is white{}{}{}{}.",
            if noise.slow > 0.0 {
                let shape = if noise.memory_rows > 0.0 {
                    format!("forgotten after {} means", noise.memory_rows)
                } else {
                    format!("power density f^-{}", noise.exponent)
                };
                format!(" and slow, {shape}, variance {:.2} of the white one", noise.slow)
            } else {
                String::new()
            },
            if noise.white_field > 0.0 {
                format!("; its white variance grows {:.1}-fold to the largest field", 1.0 + noise.white_field)
            } else {
                String::new()
            },
            if noise.slow_field > 0.0 {
                format!("; slow noise of the gain reaches {:.2} of the white variance at the largest field", noise.slow_field)
            } else {
                String::new()
            },
            if noise.apart { "; the means scatter otherwise than the samples inside them let expect" } else { "" }
        );
    }
    Section::new("Verdict").with(Text::default().strong(format!("{}.", diagnosis.verdict)).and(words))
}

/// The gap with every step; none where nothing was found.
fn chain(diagnosis: &Diagnosis) -> Option<Section> {
    let row = |(index, link): (usize, &Link)| {
        let names: Vec<String> = link
            .steps
            .iter()
            .filter_map(|number| Some(format!("{number} {}", diagnosis.steps.get(number.checked_sub(1)?)?.effect)))
            .collect();
        let with = match (index, names.is_empty()) {
            (0, true) => "no step".to_owned(),
            (0, false) => names.join(", "),
            _ => format!("and {}", names.join(", ")),
        };
        cells![with, Cell::fixed(link.chi2_per_dof, 3), Cell::fixed(link.rms_nt, 4)]
    };
    let links = &diagnosis.gap_chain;
    let table = Table::new(["with step", "chi²/dof", "weighted rms, nT"]).with_rows(links.iter().enumerate().map(row));
    (links.len() > 1).then(|| {
        Section::new("How the gap shrinks")
            .with(format!(
                "On stretches of {} that were left out of the fit, one step after the other, with the noise of the final model.",
                diagnosis.pictures.scale.means()
            ))
            .with(table)
    })
}

/// A probability; numbers end somewhere below the smallest that is written.
fn probability(p: f64) -> String {
    const LEAST: f64 = 1e-300;
    if p < LEAST { format!("less than {LEAST:e}") } else { format!("{p:.1e}") }
}

fn largest(places: &[Place]) -> Option<&Place> {
    places.iter().max_by(|a, b| a.multiples_of_noise.abs().total_cmp(&b.multiples_of_noise.abs()))
}

/// The disagreements that are predicted best, in words and as a table.
fn places(places: &[Place], scale: Scale) -> Vec<Block> {
    let told: Vec<&Place> = places.iter().filter(|p| p.multiples_of_noise.abs() >= TOLD).take(PLACES).collect();
    let Some(first) = told.first().copied().or_else(|| largest(places)) else { return Vec::new() };
    let of = |p: &Place| {
        let unit = if p.unit.is_empty() { String::new() } else { format!(" {}", p.unit) };
        format!(
            "{}, where the {} is about {}{unit}: {:+.3} nT, {:.1} times its standard uncertainty",
            p.axis,
            p.covariate,
            six_digits(p.at),
            p.displacement_nt,
            p.multiples_of_noise.abs()
        )
    };
    if told.is_empty() {
        let words = format!(
            "The plateau means disagree nowhere by {TOLD} standard uncertainties or more. The largest displacement before anything is named: {}.",
            of(first)
        );
        return vec![words.into()];
    }
    let row = |p: &Place| {
        cells![
            p.axis,
            &p.covariate,
            Cell::six_digits(p.at).with_unit(p.unit),
            Cell::signed(p.displacement_nt, 3),
            Cell::signed(p.multiples_of_noise, 1),
        ]
    };
    let table = Table::new(["axis", "covariate", "at", "displacement, nT", "over its standard uncertainty"])
        .with_rows(told.into_iter().map(row));
    vec![format!("Before anything is named the {} disagree most on {}.", scale.means(), of(first)).into(), table.into()]
}

fn step(index: usize, step: &Step) -> Section {
    let further = step.further.iter().flat_map(|one| &one.parameters);
    let parameters = step.parameters.iter().chain(further).map(|p| {
        let std = p.std.map_or(Cell::Missing("-"), |s| Cell::exponent(s, 1));
        cells![&p.name, Cell::exponent(p.value, 5), std, &p.unit]
    });
    let mut section = Section::new(format!("Step {}: {}", index + 1, step.effect))
        .with(step.sentence.as_str())
        .with(format!("Where: {}.", step.place));
    // The coefficients of a smooth function mean nothing one by one: its shape is shown.
    let along = step.covariate.as_ref().filter(|_| step.shape_names.is_empty());
    match along.and_then(|covariate| words::course(covariate, &step.shape)) {
        Some(course) => section.push(course),
        None => section.push(Table::new(["parameter", "value", "standard uncertainty", "unit"]).with_rows(parameters)),
    }
    let mut section = section
        .with(format!(
            "Signal to noise ratio {:.1}; probability that noise alone gives as much: {} for this candidate, {} for any of {} tried. Family: {}.",
            step.strength_k,
            probability(step.p_value),
            probability(step.p_value_corrected),
            step.trials,
            step.family
        ))
        .with(held_out(step));
    if !step.runners_up.is_empty() {
        let row = |r: &RunnerUp| cells![&r.effect, Cell::fixed(r.log_ratio, 1), Cell::fixed(r.correlation, 2)];
        let table = Table::new(["runner-up", "ln of the likelihood ratio to the best", "correlation"]);
        section.push(table.with_rows(step.runners_up.iter().map(row)));
    }
    if !step.shape.is_empty() {
        let covariate = if step.shape_names.is_empty() { step.covariate.as_deref().unwrap_or_default() } else { "run" };
        let place = |(k, p): (usize, &ShapePoint)| {
            step.shape_names.get(k).map_or(Cell::fixed(p.covariate, 5), |name| name.as_str().into())
        };
        let points = step.shape.iter().enumerate();
        let rows = points.map(|(k, p)| cells![place((k, p)), Cell::signed(p.residual_nt, 4), Cell::fixed(p.std_nt, 4)]);
        let what = if covariate.starts_with(GAIN_WITH) { "contribution to the largest reading, nT" } else { "contribution, nT" };
        section.push(Table::new([covariate, what, "standard uncertainty, nT"]).with_rows(rows));
    }
    if let Some(next) = &step.next_measurement {
        section.push(format!("Next measurement: {next}."));
    }
    if !step.next_forecast.is_empty() {
        let row = |f: &Forecast| {
            let against = f.against.as_deref().unwrap_or("nothing else");
            cells![&f.words, against, Cell::fixed(f.k_now, 1), Cell::fixed(f.k, 1), Cell::fixed(f.strength_k, 1)]
        };
        let head = ["what could be measured", "hardest to tell it from", "k now", "k then", "k of the effect itself"];
        section.push(format!(
            "Signal to noise ratios, by linear algebra with the noise of this run: of what the rival cannot take of the effect, and of the \
             effect itself. From k = {TOLD_APART} on the two are told apart."
        ));
        section.push(Table::new(head).with_rows(step.next_forecast.iter().map(row)));
    }
    section
}

/// How well the stretches that the fit did not see are predicted without and with the step.
fn held_out(step: &Step) -> Table {
    let row = |name: &str, g: &Gap| {
        let [x, y, z] = g.rms_nt.map(|rms| Cell::fixed(rms, 4));
        cells![name, x, y, z, Cell::fixed(g.chi2_per_dof, 3), Cell::fixed(g.max_nt, 3)]
    };
    Table::new(["held-out stretches", "rms x, nT", "rms y, nT", "rms z, nT", "chi²/dof", "largest, nT"])
        .with_rows([row("without", &step.gap_before), row("with", &step.gap_after)])
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(diagnosis: &Diagnosis) -> String {
    let mut out = format!("{}  {}\n", diagnosis.runs.join(", "), diagnosis.verdict);
    if let Some(basis) = &diagnosis.basis {
        let _ = writeln!(out, "  {basis}");
    }
    if let Some(response) = &diagnosis.response {
        let _ = writeln!(out, "  response: {response}");
    }
    if diagnosis.gap_chain.len() > 1 {
        let links = diagnosis.gap_chain.iter();
        let gaps: Vec<String> = links.map(|l| format!("{:.2} ({} nT)", l.chi2_per_dof, three_digits(l.rms_nt))).collect();
        let _ = writeln!(out, "  held out chi²/dof step by step: {}", gaps.join(" -> "));
    }
    for step in &diagnosis.steps {
        let set = if step.ambiguous_with.is_empty() { String::new() } else { format!(" or {}", step.ambiguous_with.join(", ")) };
        let covariate = step.covariate.as_ref().map_or_else(String::new, |c| format!(" ({c})"));
        // Damage is named without a prediction.
        let gap = if step.gap_before.chi2_per_dof > 0.0 {
            format!(", held out chi²/dof {:.2} -> {:.2}", step.gap_before.chi2_per_dof, step.gap_after.chi2_per_dof)
        } else {
            String::new()
        };
        let _ = writeln!(
            out,
            "  {} {}{covariate}{set}: {}; signal to noise k {:.1}{gap}",
            step.wording, step.effect, step.place, step.strength_k
        );
        if let Some(next) = Forecast::best(&step.next_forecast) {
            let rival = next.against.as_deref().unwrap_or("noise");
            let _ = if next.tells_apart() {
                writeln!(out, "    next: {}: tells it from {rival} with k {:.1} (now {:.1})", next.words, next.k, next.k_now)
            } else {
                writeln!(
                    out,
                    "    next: none of {} runs that were looked at tells it from {rival}: k {TOLD_APART} is needed, the best gives {:.1} (now {:.1})",
                    step.next_forecast.len(),
                    next.k,
                    next.k_now
                )
            };
        }
    }
    out
}
