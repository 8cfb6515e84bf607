//! The report of a linearisation.

use super::document::{Cell, Section, Table, Text, cells};
use super::{NOT_DETERMINED, or_not_stated, parameter_file, remarks, yes_or_no};
use crate::data::linearisation::{LinearisationPanel, SharedLinearisation};
use crate::data::units::{counted, scientific_with_uncertainty};
use crate::measure::linearise::Linearised;

/// Text for a probability.
fn probability(p: f64) -> String {
    if p < 1e-4 { "below 0.01 %".to_owned() } else { format!("{:.2} %", 100.0 * p) }
}

/// The sections of the report, with the name of the parameter file.
#[must_use]
pub fn sections(result: &Linearised, file: &str) -> Vec<Section> {
    let p = &result.shared;
    let principle = Section::new("Principle")
        .with(Text::words_and_code([
            "The readings of each sensor axis are linearised by one polynomial, ",
            "r + c2 r² + c3 r³",
            ", that all runs of the sensor and mode share; offset and sensitivity belong to the runs. Polynomials and the parameters of \
             every run are estimated together.",
        ]))
        .with(parameter_file(file));
    let mut sections = vec![principle, polynomials(p), runs(p), panels(&p.panel)];
    sections.extend(remarks(&result.notes));
    sections
}

fn polynomials(p: &SharedLinearisation) -> Section {
    let c = &p.polynomials;
    let mut table = Table::new([
        "axis",
        "c2, 1/enT",
        "c3, 1/enT²",
        "readings, enT",
        "largest correction, enT",
        "probability by chance",
        "significant",
    ]);
    for (i, axis) in p.axis.iter().enumerate().take(3) {
        table.push(cells![
            &axis.name,
            Cell::scientific(c.c2_per_ent[i], c.c2_std_per_ent[i]),
            Cell::scientific(c.c3_per_ent2[i], c.c3_std_per_ent2[i]),
            format!("{:.0} to {:.0}", c.reading_ent[i][0], c.reading_ent[i][1]),
            Cell::fixed(axis.largest_correction_ent, 3),
            probability(axis.probability),
            yes_or_no(axis.significant),
        ]);
    }
    Section::new("Polynomials").with(table)
}

fn runs(p: &SharedLinearisation) -> Section {
    let mut table = Table::new(["run", "plateaus", "x before, nT", "y", "z", "x after, nT", "y", "z", "took part"]);
    for run in &p.run {
        let mut row = cells![&run.id, run.blocks];
        row.extend(run.residual_std_before_nt.iter().chain(&run.residual_std_after_nt).map(|s| Cell::fixed(*s, 3)));
        row.push(yes_or_no(run.used).into());
        table.push(row);
    }
    let mut section = Section::new("The runs")
        .with(
            "Standard deviation of applied field minus modelled measurement along the sensor axes, without and with the linearisation:",
        )
        .with(table);
    if p.axis.iter().any(|a| a.between_degrees_of_freedom > 0) {
        let list: Vec<String> =
            p.axis.iter().map(|a| format!("{} {:.1} for {}", a.name, a.between_chi2, a.between_degrees_of_freedom)).collect();
        section
            .push(format!("What the runs say against the shared polynomials, χ² for degrees of freedom: {}.", list.join(", ")));
    }
    section
}

/// The nine panels as a table.
fn panels(list: &[LinearisationPanel]) -> Section {
    let mut table = Table::new([
        "sensor axis",
        "coil axis",
        "quadratic, 1/nT",
        "cubic, 1/nT²",
        "quadratic at the largest field, nT",
        "cubic",
        "by chance",
    ]);
    for panel in list {
        let coil_axis = format!("{}{}", panel.coil_axis, if panel.on_axis { " (along it)" } else { "" });
        table.push(match &panel.fitted {
            Some(f) => {
                let (square, cube) = (panel.largest_field_nt.powi(2), panel.largest_field_nt.powi(3));
                cells![
                    &panel.sensor_axis,
                    coil_axis,
                    Cell::scientific(f.quadratic_per_nt, f.quadratic_std_per_nt),
                    Cell::scientific(f.cubic_per_nt2, f.cubic_std_per_nt2),
                    Cell::uncertain(f.quadratic_per_nt * square, f.quadratic_std_per_nt * square),
                    Cell::uncertain(f.cubic_per_nt2 * cube, f.cubic_std_per_nt2 * cube),
                    probability(f.probability),
                ]
            }
            None => {
                let (unknown, empty) = (Cell::Missing(NOT_DETERMINED), Cell::Missing(""));
                cells![&panel.sensor_axis, coil_axis, unknown.clone(), unknown, empty.clone(), empty.clone(), empty]
            }
        });
    }
    Section::new("Dependence on the field along and across the axes")
        .with(
            "Square and cube of the applied field in the residual (applied field minus modelled measurement) of every sensor axis: \
             along the axis itself without the linearisation, across it beside the linearisation. Across an axis a probability below \
             1 % would be a transverse effect; one of six is below it in 6 % of all cases by chance, and drifts can look like one. \
             Where all fields have one magnitude the three squares add to a constant, and the two across an axis are one effect with \
             two signs.",
        )
        .with(table)
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(result: &Linearised) -> String {
    let p = &result.shared;
    let c = &p.polynomials;
    let three = |get: &dyn Fn(usize) -> String| (0..3).map(get).collect::<Vec<_>>().join(", ");
    let corrections: Vec<String> = p
        .axis
        .iter()
        .map(|a| format!("{:.3}{}", a.largest_correction_ent, if a.significant { "" } else { " (not significant)" }))
        .collect();
    format!(
        "linearisation of {} {}  {}\n  c2    {}  1/enT\n  c3    {}  1/enT²\n  largest correction {}  enT (x, y, z)\n",
        or_not_stated(&p.sensor),
        or_not_stated(&p.mode),
        counted(p.used.len() as u64, "run"),
        three(&|i| scientific_with_uncertainty(c.c2_per_ent[i], c.c2_std_per_ent[i])),
        three(&|i| scientific_with_uncertainty(c.c3_per_ent2[i], c.c3_std_per_ent2[i])),
        corrections.join(", ")
    )
}
