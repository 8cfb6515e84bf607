//! The reports of the facility's own calibration.

use super::{number, remarks, table, triple, value};
use crate::data::units::scientific_with_uncertainty;
use crate::files::parameter::{Body, FacilityPart, TiltValues};
use crate::measure::coil::{ANGLES, AXES, Residual, Scalar, Tilt};
use std::fmt::Write;

/// Arc seconds in a degree.
const ARCSEC: f64 = 3600.0;

/// The parameters of a facility with their uncertainties.
fn parameters(out: &mut String, facility: &FacilityPart, std: &FacilityPart, head: &str) {
    let mut rows =
        vec![["axis", "scale factor, nT/EU", "offset field, nT", "angle", "between, degrees"].map(str::to_owned).to_vec()];
    for k in 0..3 {
        rows.push(vec![
            AXES[k].to_owned(),
            value(facility.scale_nt_per_eu[k], std.scale_nt_per_eu[k]),
            value(facility.offset_nt[k], std.offset_nt[k]),
            ANGLES[k].to_owned(),
            value(facility.angles_deg[k], std.angles_deg[k]),
        ]);
    }
    let _ = writeln!(out, "{head} The facility\n\n{}", table(&rows));
    for (what, reference, scale, offset, scale_std, offset_std) in [
        ("coil", facility.reference_degc, facility.scale_per_k, facility.offset_nt_per_k, std.scale_per_k, std.offset_nt_per_k),
        (
            "rack",
            facility.rack_reference_degc,
            facility.rack_scale_per_k,
            facility.rack_offset_nt_per_k,
            std.rack_scale_per_k,
            std.rack_offset_nt_per_k,
        ),
    ] {
        let (Some(reference), Some(scale), Some(offset)) = (reference, scale, offset) else { continue };
        let (scale_std, offset_std) = (scale_std.unwrap_or([f64::NAN; 3]), offset_std.unwrap_or([f64::NAN; 3]));
        let mut rows = vec![["axis", "scale factor, 1/K", "offset field, nT/K"].map(str::to_owned).to_vec()];
        for k in 0..3 {
            rows.push(vec![
                AXES[k].to_owned(),
                scientific_with_uncertainty(scale[k], scale_std[k]),
                value(offset[k], offset_std[k]),
            ]);
        }
        let _ = writeln!(out, "Change with the {what} temperature, from {reference:.1} °C:\n\n{}", table(&rows));
    }
}

/// The report of a scalar calibration.
#[must_use]
pub fn scalar(result: &Scalar, level: usize) -> String {
    let p = &result.parameters;
    let head = "#".repeat(level);
    let mut out = format!(
        "{head} Principle\n\nSettings in many directions and the modulus of the field that a scalar magnetometer measures at the centre \
         determine three scale factors, three offset fields and three angles between the coils.\n\nParameter file: `{}`.\n\n",
        p.file_name()
    );
    parameters(&mut out, &p.facility, &p.std, &head);
    let mut rows = vec![
        ["run", "coil, °C", "rack, °C", "scale factors, nT/EU", "offset fields, nT", "angles, degrees", "residual, nT"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for c in &p.calibration {
        let degc = |t: Option<f64>| t.map_or_else(|| "not recorded".to_owned(), |t| format!("{t:.2}"));
        rows.push(vec![
            c.run.clone(),
            degc(c.coil_degc),
            degc(c.rack_degc),
            triple(&c.facility.scale_nt_per_eu, &c.std.scale_nt_per_eu),
            triple(&c.facility.offset_nt, &c.std.offset_nt),
            triple(&c.facility.angles_deg, &c.std.angles_deg),
            format!("{:.3}", c.residual_std_nt),
        ]);
    }
    let _ = writeln!(out, "{head} Every calibration on its own\n\n{}", table(&rows));
    let q = &p.quality;
    let share = q.direction_share.map(|s| format!("{:.0} %", 100.0 * s));
    let _ = writeln!(
        out,
        "{head} Quality\n\n{} of {} rows used, moduli from {:.0} to {:.0} nT. Standard deviation of measured minus modelled modulus {:.3} nT, \
         largest {:.3} nT, {} degrees of freedom. The squared settings lie along their principal directions by {} (a third each if \
         they are spread evenly); condition number {:.1}.\n",
        q.rows_used,
        q.rows_total,
        p.valid.modulus_nt[0],
        p.valid.modulus_nt[1],
        q.residual_std_nt,
        q.residual_max_nt,
        q.degrees_of_freedom,
        share.join(", "),
        q.condition
    );
    if !p.outlier.is_empty() {
        let mut rows = vec![["run", "row", "time, s", "modulus, nT", "residual, nT"].map(str::to_owned).to_vec()];
        for o in &p.outlier {
            rows.push(vec![
                o.run.clone(),
                o.row.to_string(),
                format!("{:.1}", o.t_s),
                format!("{:.2}", o.modulus_nt),
                format!("{:+.2}", o.residual_nt),
            ]);
        }
        let _ = writeln!(out, "{head} Rows not used\n\n{}", table(&rows));
    }
    out.push_str(&remarks(&p.warnings, level));
    out
}

fn summary_of(facility: &FacilityPart, std: &FacilityPart) -> String {
    format!(
        "  scale   {}  nT/EU\n  offset  {}  nT\n  angles  {}  degrees\n",
        triple(&facility.scale_nt_per_eu, &std.scale_nt_per_eu),
        triple(&facility.offset_nt, &std.offset_nt),
        triple(&facility.angles_deg, &std.angles_deg),
    )
}

/// A few lines for the terminal.
#[must_use]
pub fn scalar_summary(result: &Scalar) -> String {
    let p = &result.parameters;
    let mut out = format!(
        "{}  {} of {} rows, residual standard deviation {:.3} nT, condition {:.1}\n{}",
        p.used.join(", "),
        p.quality.rows_used,
        p.quality.rows_total,
        p.quality.residual_std_nt,
        p.quality.condition,
        summary_of(&p.facility, &p.std)
    );
    for (what, scale, std) in
        [("coil", p.facility.scale_per_k, p.std.scale_per_k), ("rack", p.facility.rack_scale_per_k, p.std.rack_scale_per_k)]
    {
        if let (Some(scale), Some(std)) = (scale, std) {
            let list: Vec<String> = (0..3).map(|k| scientific_with_uncertainty(scale[k], std[k])).collect();
            let _ = writeln!(out, "  scale with the {what} temperature  {}  1/K", list.join(", "));
        }
    }
    out
}

/// The report of residual fields.
#[must_use]
pub fn residual(result: &Residual, level: usize) -> String {
    let p = &result.parameters;
    let head = "#".repeat(level);
    let mut out = format!(
        "{head} Principle\n\nThe same field with both signs on one coil axis: half the difference of the moduli is the residual field along \
         that axis.\n\nParameter file: `{}`.\n\n",
        p.file_name()
    );
    for state in &p.state {
        let mut rows =
            vec![["axis", "modulus at +F, nT", "modulus at -F, nT", "pairs", "residual field, nT"].map(str::to_owned).to_vec()];
        for a in &state.axis {
            rows.push(vec![
                a.axis.clone(),
                number(a.plus_nt, 2),
                number(a.minus_nt, 2),
                a.pairs.to_string(),
                value(a.residual_nt, a.std_nt),
            ]);
        }
        let _ = writeln!(out, "{head} Residual field, {}\n\n{}", super::or_not_stated(&state.name), table(&rows));
    }
    out.push_str(&remarks(&p.warnings, level));
    out
}

/// A few lines for the terminal.
#[must_use]
pub fn residual_summary(result: &Residual) -> String {
    let mut out = String::new();
    for state in &result.parameters.state {
        let fields: Vec<String> = state.axis.iter().map(|a| format!("{} {}", a.axis, value(a.residual_nt, a.std_nt))).collect();
        let _ = writeln!(out, "{}  residual field  {}  nT", super::or_not_stated(&state.name), fields.join(", "));
    }
    out
}

/// The report of sensor and facility from several orientations.
#[must_use]
pub fn tilt(result: &Tilt, level: usize) -> String {
    let p = &result.parameters;
    let head = "#".repeat(level);
    let mut out = format!(
        "{head} Principle\n\nRuns of one sensor in several orientations disagree where the parameters of the facility are wrong: what belongs \
         to a coil changes to another sensor axis, or its sign, with the orientation. Sensor and facility are solved for together, and \
         every orientation counts once.\n\nParameter file: `{}`.\n\n",
        p.file_name()
    );
    parameters(&mut out, &p.facility, &p.std, &head);
    let mut rows =
        vec![["axis", "scale factor, 1e-6", "offset field, nT", "angle", "by, arc seconds"].map(str::to_owned).to_vec()];
    for k in 0..3 {
        let relative = 1e6 / p.facility.scale_nt_per_eu[k];
        rows.push(vec![
            AXES[k].to_owned(),
            value(1e6 * p.correction.scale[k], relative * p.std.scale_nt_per_eu[k]),
            value(p.correction.offset_nt[k], p.std.offset_nt[k]),
            ANGLES[k].to_owned(),
            value(ARCSEC * p.correction.angles_deg[k], ARCSEC * p.std.angles_deg[k]),
        ]);
    }
    let _ = writeln!(out, "Corrections of the facility that the runs were evaluated with:\n\n{}", table(&rows));
    let undetermined = if p.undetermined.is_empty() { "nothing".to_owned() } else { p.undetermined.join("; ") };
    let _ = writeln!(out, "The orientations leave undetermined: {undetermined}. The corrections have no part of it.\n");

    let names = ["x", "y", "z"];
    let mut rows = vec![
        [
            "sensor",
            "sensitivity, nT/enT",
            "spread before, 1e-6",
            "after",
            "offset, nT",
            "before, nT",
            "after",
            "angle, degrees",
            "before, ″",
            "after",
        ]
        .map(str::to_owned)
        .to_vec(),
    ];
    let (s, std, before, after) = (&p.sensor_parameters, &p.sensor_std, &p.spread_before, &p.spread_after);
    for i in 0..3 {
        rows.push(vec![
            format!("{}, {}", names[i], ["xy", "xz", "yz"][i]),
            value(s.scale[i], std.scale[i]),
            number(1e6 * before.scale[i], 1),
            number(1e6 * after.scale[i], 1),
            value(s.offset_nt[i], std.offset_nt[i]),
            number(before.offset_nt[i], 2),
            number(after.offset_nt[i], 2),
            value(s.angles_deg[i], std.angles_deg[i]),
            number(ARCSEC * before.angles_deg[i], 1),
            number(ARCSEC * after.angles_deg[i], 1),
        ]);
    }
    let _ = writeln!(
        out,
        "{head} The sensor\n\nSpread: root mean square deviation of the {} used orientations from their mean.\n\n{}",
        p.orientation.iter().filter(|o| o.used).count(),
        table(&rows)
    );
    let mut rows = vec![
        ["orientation", "runs", "used", "facility", "sensitivities", "offsets, nT", "angles, degrees"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for o in &p.orientation {
        let mut push = |which: &str, v: &TiltValues| {
            rows.push(vec![
                o.axes.clone(),
                o.runs.join(", "),
                if o.used { "yes" } else { "no" }.to_owned(),
                which.to_owned(),
                v.scale.map(|s| format!("{s:.6}")).join(", "),
                v.offset_nt.map(|s| format!("{s:.2}")).join(", "),
                v.angles_deg.map(|s| format!("{s:.4}")).join(", "),
            ]);
        };
        push("before", &o.before);
        push("corrected", &o.after);
    }
    let _ = writeln!(out, "{head} The orientations\n\n{}", table(&rows));
    out.push_str(&remarks(&p.warnings, level));
    out
}

/// A few lines for the terminal.
#[must_use]
pub fn tilt_summary(result: &Tilt) -> String {
    let p = &result.parameters;
    let line = |v: &TiltValues| {
        format!(
            "{} e-6, {} nT, {} arc seconds",
            v.scale.map(|s| format!("{:.1}", 1e6 * s)).join(" "),
            v.offset_nt.map(|s| format!("{s:.2}")).join(" "),
            v.angles_deg.map(|s| format!("{:.1}", ARCSEC * s)).join(" ")
        )
    };
    format!(
        "{}  {} runs in {} orientations\n{}  spread before  {}\n  spread after   {}\n  undetermined: {}\n",
        super::or_not_stated(&p.sensor),
        p.used.len(),
        p.orientation.iter().filter(|o| o.used).count(),
        summary_of(&p.facility, &p.std),
        line(&p.spread_before),
        line(&p.spread_after),
        if p.undetermined.is_empty() { "nothing".to_owned() } else { p.undetermined.join("; ") }
    )
}
