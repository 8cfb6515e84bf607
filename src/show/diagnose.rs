//! The report of a diagnosis.

use super::{number, table};
use crate::data::units::{COMPONENTS, six_digits};
use crate::diagnose::result::{Diagnosis, Gap, Place, Step};
use crate::plot::diagnose::{LEFT, WHERE, stems};
use std::fmt::Write;

/// Its title.
#[must_use]
pub fn title(diagnosis: &Diagnosis) -> String {
    format!("Diagnosis of run {}", diagnosis.runs.join(", "))
}

/// Displacements from this many standard uncertainties on are told.
const TOLD: f64 = 4.0;
/// Most rows of the table of disagreement.
const PLACES: usize = 8;

/// The blocks of the report with headings of the given level; `figure` gives the figure of a stem, or nothing.
#[must_use]
pub fn sections(diagnosis: &Diagnosis, level: usize, figure: &dyn Fn(&str) -> String) -> String {
    let head = "#".repeat(level);
    let floor: Vec<String> = diagnosis.noise_floor_nt.iter().map(|n| number(*n, 4)).collect();
    let mut out = format!("{head} Verdict\n\n**{}.** Noise of a mean: {} nT (x, y, z).", diagnosis.verdict, floor.join(", "));
    if let Some(response) = &diagnosis.response {
        let _ = write!(out, " Response: {response}.");
    }
    if let Some(colour) = diagnosis.noise {
        let _ = write!(
            out,
            " It is white{}{}{}{}.",
            if colour.slow > 0.0 {
                let shape = if colour.memory_rows > 0.0 {
                    format!("forgotten after {} means", colour.memory_rows)
                } else {
                    format!("power density f^-{}", colour.exponent)
                };
                format!(" and slow, {shape}, variance {:.2} of the white one", colour.slow)
            } else {
                String::new()
            },
            if colour.white_field > 0.0 {
                format!("; its white variance grows {:.1}-fold to the largest field", 1.0 + colour.white_field)
            } else {
                String::new()
            },
            if colour.slow_field > 0.0 {
                format!("; slow noise of the gain reaches {:.2} of the white variance at the largest field", colour.slow_field)
            } else {
                String::new()
            },
            if colour.apart { "; the means scatter otherwise than the samples inside them let expect" } else { "" }
        );
    }
    out.push_str("\n\n");
    if !diagnosis.pictures.places.is_empty() {
        let _ = write!(out, "{head} Where the data disagree\n\n{}\n{}", places(&diagnosis.pictures.places), figure(WHERE));
    }
    for (index, step) in diagnosis.steps.iter().enumerate() {
        let figures: String = stems(index).into_iter().map(figure).collect();
        let _ = write!(out, "{head} Step {}: {}\n\n{}\n{figures}", index + 1, step.effect, step_text(step));
    }
    let left = figure(LEFT);
    if !left.is_empty() {
        let _ = write!(out, "{head} What is left\n\n{left}");
    }
    if !diagnosis.not_identifiable.is_empty() {
        let mut rows = vec![["effect", "why these data cannot show it"].map(str::to_owned).to_vec()];
        rows.extend(diagnosis.not_identifiable.iter().map(|n| vec![n.effect.clone(), n.reason.clone()]));
        let _ = writeln!(out, "{head} What cannot be shown\n\n{}", table(&rows));
    }
    if !diagnosis.detection_limits.is_empty() {
        let mut rows = vec![["effect", "axis", "largest contribution, nT", "parameter"].map(str::to_owned).to_vec()];
        rows.extend(
            diagnosis
                .detection_limits
                .iter()
                .map(|d| vec![d.effect.clone(), d.axis.clone(), number(d.amplitude_nt, 4), d.parameter.clone()]),
        );
        let _ = writeln!(
            out,
            "{head} Detection limits\n\nSmallest effects that would have been found in nine of ten such runs.\n\n{}",
            table(&rows)
        );
    }
    out
}

/// A probability; numbers end somewhere below the smallest that is written.
fn probability(p: f64) -> String {
    const LEAST: f64 = 1e-300;
    if p < LEAST { format!("less than {LEAST:e}") } else { format!("{p:.1e}") }
}

/// The largest disagreements in words and as a table.
fn places(places: &[Place]) -> String {
    let told: Vec<&Place> = places.iter().filter(|p| p.multiples_of_noise.abs() >= TOLD).take(PLACES).collect();
    let Some(first) = places.first() else { return String::new() };
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
        return format!(
            "Nowhere by {TOLD} standard uncertainties or more. The largest displacement before anything is named: {}.\n",
            of(first)
        );
    }
    let mut rows =
        vec![["axis", "covariate", "at", "displacement, nT", "over its standard uncertainty"].map(str::to_owned).to_vec()];
    rows.extend(told.iter().map(|p| {
        vec![
            p.axis.to_owned(),
            p.covariate.clone(),
            format!("{} {}", six_digits(p.at), p.unit),
            format!("{:+.3}", p.displacement_nt),
            format!("{:+.1}", p.multiples_of_noise),
        ]
    }));
    format!("Before anything is named the plateau means disagree most on {}.\n\n{}", of(first), table(&rows))
}

fn step_text(step: &Step) -> String {
    let mut out = format!("{}\n\nWhere: {}.\n\n", step.sentence, step.place);
    let mut rows = vec![["parameter", "value", "standard uncertainty", "unit"].map(str::to_owned).to_vec()];
    rows.extend(step.parameters.iter().map(|p| {
        vec![
            p.name.clone(),
            format!("{:.5e}", p.value),
            p.std.map_or_else(|| "-".to_owned(), |s| format!("{s:.1e}")),
            p.unit.clone(),
        ]
    }));
    out.push_str(&table(&rows));
    let _ = write!(
        out,
        "\nSignal to noise ratio {:.1}; probability that noise alone gives as much: {} for this candidate, {} for any of {} tried. Family: {}.\n\n",
        step.strength_k,
        probability(step.p_value),
        probability(step.p_value_corrected),
        step.trials,
        step.family
    );
    let mut rows = vec![
        ["held-out stretches", "rms x, nT", "rms y, nT", "rms z, nT", "chi²/dof", "largest, nT"].map(str::to_owned).to_vec(),
    ];
    let row = |name: &str, g: &Gap| {
        let mut row = vec![name.to_owned()];
        row.extend(COMPONENTS.iter().enumerate().map(|(a, _)| number(g.rms_nt[a], 4)));
        row.extend([number(g.chi2_per_dof, 3), number(g.max_nt, 3)]);
        row
    };
    rows.push(row("without", &step.gap_before));
    rows.push(row("with", &step.gap_after));
    out.push_str(&table(&rows));
    if !step.runners_up.is_empty() {
        let mut rows = vec![["runner-up", "ln of the likelihood ratio to the best", "correlation"].map(str::to_owned).to_vec()];
        rows.extend(
            step.runners_up
                .iter()
                .map(|r| vec![r.effect.clone(), format!("{:.1}", r.log_ratio), format!("{:.2}", r.correlation)]),
        );
        let _ = write!(out, "\n{}", table(&rows));
    }
    if !step.shape.is_empty() {
        let covariate = step.covariate.clone().unwrap_or_default();
        let mut rows = vec![vec![covariate, "contribution, nT".to_owned(), "standard uncertainty, nT".to_owned()]];
        rows.extend(
            step.shape.iter().map(|p| vec![format!("{:.5}", p.covariate), format!("{:+.4}", p.residual_nt), number(p.std_nt, 4)]),
        );
        let _ = write!(out, "\n{}", table(&rows));
    }
    if let Some(next) = &step.next_measurement {
        let _ = write!(out, "\nNext measurement: {next}.\n");
    }
    out
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(diagnosis: &Diagnosis) -> String {
    let mut out = format!("{}  {}\n", diagnosis.runs.join(", "), diagnosis.verdict);
    if let Some(response) = &diagnosis.response {
        let _ = writeln!(out, "  response: {response}");
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
        let _ =
            writeln!(out, "  {} {}{covariate}{set}: {}; k {:.1}{gap}", step.wording, step.effect, step.place, step.strength_k);
    }
    out
}
