//! The report of a linearisation.

use super::{number, or_not_stated, remarks, table};
use crate::data::units::{scientific_with_uncertainty, with_uncertainty};
use crate::files::parameter::{Body, LinearisationPanel};
use crate::measure::linearise::Linearised;
use std::fmt::Write;

/// Text for a probability.
fn probability(p: f64) -> String {
    if p < 1e-4 { "below 0.01 %".to_owned() } else { format!("{:.2} %", 100.0 * p) }
}

/// Blocks of the report with headings of the given level.
#[must_use]
pub fn sections(result: &Linearised, level: usize) -> String {
    let p = &result.parameters;
    let head = "#".repeat(level);
    let mut out = format!(
        "{head} Principle\n\nThe readings of each sensor axis are linearised by one polynomial, `r + c2 r² + c3 r³`, that all runs of the \
         sensor and mode share; offset and sensitivity belong to the runs. Polynomials and the parameters of every run are estimated \
         together.\n\nParameter file: `{}`.\n\n",
        p.file_name()
    );
    let c = &p.linearisation;
    let mut rows = vec![
        ["axis", "c2, 1/enT", "c3, 1/enT²", "readings, enT", "largest correction, enT", "probability by chance", "significant"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for (i, axis) in p.axis.iter().enumerate().take(3) {
        rows.push(vec![
            axis.name.clone(),
            scientific_with_uncertainty(c.c2_per_ent[i], c.c2_std_per_ent[i]),
            scientific_with_uncertainty(c.c3_per_ent2[i], c.c3_std_per_ent2[i]),
            format!("{:.0} to {:.0}", c.reading_ent[i][0], c.reading_ent[i][1]),
            format!("{:.3}", axis.largest_correction_ent),
            probability(axis.probability),
            if axis.significant { "yes" } else { "no" }.to_owned(),
        ]);
    }
    let _ = writeln!(out, "{head} Polynomials\n\n{}", table(&rows));
    let mut rows =
        vec![["run", "plateaus", "x before, nT", "y", "z", "x after, nT", "y", "z", "took part"].map(str::to_owned).to_vec()];
    for run in &p.run {
        let mut row = vec![run.id.clone(), run.blocks.to_string()];
        row.extend(run.residual_std_before_nt.iter().chain(&run.residual_std_after_nt).map(|s| number(*s, 3)));
        row.push(if run.used { "yes" } else { "no" }.to_owned());
        rows.push(row);
    }
    let _ = writeln!(
        out,
        "{head} The runs\n\nStandard deviation of applied field minus modelled measurement along the sensor axes, without and with the \
         linearisation:\n\n{}",
        table(&rows)
    );
    if p.axis.iter().any(|a| a.between_degrees_of_freedom > 0) {
        let list: Vec<String> =
            p.axis.iter().map(|a| format!("{} {:.1} for {}", a.name, a.between_chi2, a.between_degrees_of_freedom)).collect();
        let _ =
            writeln!(out, "What the runs say against the shared polynomials, χ² for degrees of freedom: {}.\n", list.join(", "));
    }
    panels(&mut out, &p.panel, &head);
    out.push_str(&remarks(&p.warnings, level));
    out
}

/// The nine panels as a table.
fn panels(out: &mut String, list: &[LinearisationPanel], head: &str) {
    let mut rows = vec![
        [
            "sensor axis",
            "coil axis",
            "quadratic, 1/nT",
            "cubic, 1/nT²",
            "quadratic at the largest field, nT",
            "cubic",
            "by chance",
        ]
        .map(str::to_owned)
        .to_vec(),
    ];
    for panel in list {
        let mut row =
            vec![panel.sensor_axis.clone(), format!("{}{}", panel.coil_axis, if panel.on_axis { " (along it)" } else { "" })];
        match &panel.fitted {
            Some(f) => {
                let (square, cube) = (panel.largest_field_nt.powi(2), panel.largest_field_nt.powi(3));
                row.extend([
                    scientific_with_uncertainty(f.quadratic_per_nt, f.quadratic_std_per_nt),
                    scientific_with_uncertainty(f.cubic_per_nt2, f.cubic_std_per_nt2),
                    with_uncertainty(f.quadratic_per_nt * square, f.quadratic_std_per_nt * square),
                    with_uncertainty(f.cubic_per_nt2 * cube, f.cubic_std_per_nt2 * cube),
                    probability(f.probability),
                ]);
            }
            None => row.extend(["not determined", "not determined", "", "", ""].map(str::to_owned)),
        }
        rows.push(row);
    }
    let _ = writeln!(
        out,
        "{head} Dependence on the field along and across the axes\n\nSquare and cube of the applied field in the residual (applied field \
         minus modelled measurement) of every sensor axis: along the axis itself without the linearisation, across it beside the \
         linearisation. Across an axis a probability below 1 % would be a transverse effect; one of six is below it in 6 % of all \
         cases by chance, and drifts can look like one. Where all fields have one magnitude the three squares add to a constant, and the \
         two across an axis are one effect with two signs.\n\n{}",
        table(&rows)
    );
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(result: &Linearised) -> String {
    let p = &result.parameters;
    let c = &p.linearisation;
    let three = |get: &dyn Fn(usize) -> String| (0..3).map(get).collect::<Vec<_>>().join(", ");
    let corrections: Vec<String> = p
        .axis
        .iter()
        .map(|a| format!("{:.3}{}", a.largest_correction_ent, if a.significant { "" } else { " (not significant)" }))
        .collect();
    format!(
        "linearisation of {} {}  {} runs\n  c2    {}  1/enT\n  c3    {}  1/enT²\n  largest correction {}  enT (x, y, z)\n",
        or_not_stated(&p.sensor),
        or_not_stated(&p.mode),
        p.used.len(),
        three(&|i| scientific_with_uncertainty(c.c2_per_ent[i], c.c2_std_per_ent[i])),
        three(&|i| scientific_with_uncertainty(c.c3_per_ent2[i], c.c3_std_per_ent2[i])),
        corrections.join(", ")
    )
}
