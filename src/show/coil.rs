//! The reports of the facility's own calibration.

use super::document::{Block, Cell, Section, Table, cells};
use super::{or_not_stated, parameter_file, remarks, triple, value, yes_or_no};
use crate::data::units::{COMPONENTS, scientific_with_uncertainty};
use crate::measure::coil::{ANGLES, AXES, Residual, Scalar, Tilt};
use crate::model::facility::FacilityParameters;
use crate::model::facility_calibration::{ScalarFound, ScalarHypothesis, ScalarOutlier, SensorValues, TiltFound};
use std::fmt::Write;

/// Arc seconds in a degree.
const ARCSEC: f64 = 3600.0;

/// The parameters of a facility with their uncertainties.
fn parameters(title: &str, facility: &FacilityParameters, std: &FacilityParameters) -> Section {
    let mut table = Table::new(["axis", "scale factor, nT/EU", "offset field, nT", "angle", "between, degrees"]);
    for k in 0..3 {
        table.push(cells![
            AXES[k],
            Cell::uncertain(facility.scale_nt_per_eu[k], std.scale_nt_per_eu[k]),
            Cell::uncertain(facility.offset_nt[k], std.offset_nt[k]),
            ANGLES[k],
            Cell::uncertain(facility.angles_deg[k], std.angles_deg[k]),
        ]);
    }
    let mut section = Section::new(title).with(table);
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
        let row = |k: usize| cells![AXES[k], Cell::scientific(scale[k], scale_std[k]), Cell::uncertain(offset[k], offset_std[k])];
        section.push(format!("Change with the {what} temperature, from {reference:.1} °C:"));
        section.push(Table::new(["axis", "scale factor, 1/K", "offset field, nT/K"]).with_rows((0..3).map(row)));
    }
    section
}

/// The sections on a scalar calibration.
#[must_use]
pub fn scalar(result: &Scalar, file_name: &str) -> Vec<Section> {
    let p = &result.found;
    let principle = Section::new("Principle")
        .with(
            "Settings in many directions and the modulus of the field that a scalar magnetometer measures at the centre determine three \
             scale factors, three offset fields and three angles between the coils.",
        )
        .with(parameter_file(file_name));
    let mut single = Table::new([
        "run",
        "coil, °C",
        "rack, °C",
        "scale factors, nT/EU",
        "offset fields, nT",
        "angles, degrees",
        "residual, nT",
    ]);
    for c in &p.calibration {
        let degc = |t: Option<f64>| t.map_or(Cell::Missing("not recorded"), |t| Cell::fixed(t, 2));
        single.push(cells![
            &c.run,
            degc(c.coil_degc),
            degc(c.rack_degc),
            triple(&c.facility.scale_nt_per_eu, &c.std.scale_nt_per_eu),
            triple(&c.facility.offset_nt, &c.std.offset_nt),
            triple(&c.facility.angles_deg, &c.std.angles_deg),
            Cell::fixed(c.residual_std_nt, 3),
        ]);
    }
    let single = Section::new("Every calibration on its own").with(single);
    let mut sections = vec![principle];
    if p.period.is_empty() {
        sections.push(parameters("The facility", &p.facility, &p.std));
    }
    sections.extend(p.period.iter().map(|one| parameters(&format!("The facility, {}", one.span), &one.facility, &one.std)));
    sections.extend(explanations(p));
    sections.extend([single, scalar_quality(p)]);
    if !p.outlier.is_empty() {
        let row = |o: &ScalarOutlier| {
            cells![&o.run, o.row, Cell::fixed(o.t_s, 1), Cell::fixed(o.modulus_nt, 2), Cell::signed(o.residual_nt, 2)]
        };
        let table = Table::new(["run", "row", "time, s", "modulus, nT", "residual, nT"]);
        sections.push(Section::new("Rows not used").with(table.with_rows(p.outlier.iter().map(row))));
    }
    sections.extend(remarks(&result.notes));
    sections
}

/// What may explain that the calibrations differ; `None` for a single one.
fn explanations(p: &ScalarFound) -> Option<Section> {
    let least = p.hypothesis.iter().map(|h| h.bic).reduce(f64::min)?;
    let row = |h: &ScalarHypothesis| {
        cells![
            h.explanation.words(),
            h.parameters,
            h.degrees_of_freedom,
            Cell::fixed(h.residual_std_nt, 3),
            Cell::fixed(h.bic - least, 1),
            yes_or_no(h.chosen),
        ]
    };
    let table = Table::new([
        "calibrations differ by",
        "parameters",
        "degrees of freedom",
        "residual, nT",
        "evidence above the best",
        "chosen",
    ]);
    let steps: Vec<String> = p
        .step
        .iter()
        .map(|s| {
            format!(
                "{} from {:.6} to {:.6} between {} and {}",
                s.parameter, s.before, s.after, s.last_run_before, s.first_run_after
            )
        })
        .collect();
    let found = if steps.is_empty() {
        "No step is convincing beside what was chosen.".to_owned()
    } else {
        format!(
            "Steps: {}. Where a step lies between two calibrations is not known; the periods meet in the middle of that time.",
            steps.join("; ")
        )
    };
    Some(
        Section::new("Steps and temperatures")
            .with(
                "A facility that steps between two calibrations and one that follows a temperature look alike in few calibrations. Both were \
                 fitted to the same rows. The evidence is the Bayesian information criterion, n ln(S/n) + k ln n; half of a difference is about \
                 the logarithm of the odds, and a step has to be better by 10.",
            )
            .with(table.with_rows(p.hypothesis.iter().map(row)))
            .with(found),
    )
}

fn scalar_quality(p: &ScalarFound) -> Section {
    let q = &p.quality;
    let share = q.direction_share.map(|s| format!("{:.0} %", 100.0 * s));
    Section::new("Quality").with(format!(
        "{} of {} rows used, moduli from {:.0} to {:.0} nT. Standard deviation of measured minus modelled modulus {:.3} nT, largest {:.3} \
         nT, {} degrees of freedom. The squared settings lie along their principal directions by {} (a third each if they are spread \
         evenly); condition number {:.1}.",
        q.rows_used,
        q.rows_total,
        p.valid.modulus_nt[0],
        p.valid.modulus_nt[1],
        q.residual_std_nt,
        q.residual_max_nt,
        q.degrees_of_freedom,
        share.join(", "),
        q.condition
    ))
}

fn summary_of(facility: &FacilityParameters, std: &FacilityParameters) -> String {
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
    let p = &result.found;
    let mut out = format!(
        "{}  {} of {} rows, residual standard deviation {:.3} nT, condition {:.1}\n{}",
        p.used.join(", "),
        p.quality.rows_used,
        p.quality.rows_total,
        p.quality.residual_std_nt,
        p.quality.condition,
        if p.period.is_empty() { summary_of(&p.facility, &p.std) } else { String::new() }
    );
    for period in &p.period {
        let _ = write!(out, "  {}\n{}", period.span, summary_of(&period.facility, &period.std));
    }
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

/// The sections on residual fields.
#[must_use]
pub fn residual(result: &Residual, file_name: &str) -> Vec<Section> {
    let p = &result.found;
    let principle = Section::new("Principle")
        .with(
            "The same field with both signs on one coil axis: half the difference of the moduli is the residual field along that axis.",
        )
        .with(parameter_file(file_name));
    let mut sections = vec![principle];
    for state in &p.state {
        let mut table = Table::new(["axis", "modulus at +F, nT", "modulus at -F, nT", "pairs", "residual field, nT"]);
        for a in &state.axis {
            table.push(cells![
                &a.axis,
                Cell::fixed(a.plus_nt, 2),
                Cell::fixed(a.minus_nt, 2),
                a.pairs,
                Cell::uncertain(a.residual_nt, a.std_nt),
            ]);
        }
        sections.push(Section::new(format!("Residual field, {}", or_not_stated(&state.name))).with(table));
    }
    sections.extend(remarks(&result.notes));
    sections
}

/// A few lines for the terminal.
#[must_use]
pub fn residual_summary(result: &Residual) -> String {
    let mut out = String::new();
    for state in &result.found.state {
        let fields: Vec<String> = state.axis.iter().map(|a| format!("{} {}", a.axis, value(a.residual_nt, a.std_nt))).collect();
        let _ = writeln!(out, "{}  residual field  {}  nT", or_not_stated(&state.name), fields.join(", "));
    }
    out
}

/// The sections on sensor and facility from several orientations.
#[must_use]
pub fn tilt(result: &Tilt, file_name: &str) -> Vec<Section> {
    let p = &result.found;
    let principle = Section::new("Principle")
        .with(
            "Runs of one sensor in several orientations disagree where the parameters of the facility are wrong: what belongs to a coil \
             changes to another sensor axis, or its sign, with the orientation. Sensor and facility are solved for together, and every \
             orientation counts once.",
        )
        .with(parameter_file(file_name));
    let facility = parameters("The facility", &p.facility, &p.std).with_all(corrections(p));
    let mut sections = vec![principle, facility, tilt_sensor(p), orientations(p)];
    sections.extend(remarks(&result.notes));
    sections
}

fn undetermined(p: &TiltFound) -> String {
    if p.undetermined.is_empty() { "nothing".to_owned() } else { p.undetermined.join("; ") }
}

fn corrections(p: &TiltFound) -> [Block; 3] {
    let mut table = Table::new(["axis", "scale factor, 1e-6", "offset field, nT", "angle", "by, arc seconds"]);
    for k in 0..3 {
        let relative = 1e6 / p.facility.scale_nt_per_eu[k];
        table.push(cells![
            AXES[k],
            Cell::uncertain(1e6 * p.correction.scale[k], relative * p.std.scale_nt_per_eu[k]),
            Cell::uncertain(p.correction.offset_nt[k], p.std.offset_nt[k]),
            ANGLES[k],
            Cell::uncertain(ARCSEC * p.correction.angles_deg[k], ARCSEC * p.std.angles_deg[k]),
        ]);
    }
    let left = format!("The orientations leave undetermined: {}. The corrections have no part of it.", undetermined(p));
    ["Corrections of the facility that the runs were evaluated with:".into(), table.into(), left.into()]
}

fn tilt_sensor(p: &TiltFound) -> Section {
    let mut table = Table::new([
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
    ]);
    let (s, std, before, after) = (&p.sensor_parameters, &p.sensor_std, &p.spread_before, &p.spread_after);
    for i in 0..3 {
        table.push(cells![
            format!("{}, {}", COMPONENTS[i], ["xy", "xz", "yz"][i]),
            Cell::uncertain(s.scale[i], std.scale[i]),
            Cell::fixed(1e6 * before.scale[i], 1),
            Cell::fixed(1e6 * after.scale[i], 1),
            Cell::uncertain(s.offset_nt[i], std.offset_nt[i]),
            Cell::fixed(before.offset_nt[i], 2),
            Cell::fixed(after.offset_nt[i], 2),
            Cell::uncertain(s.angles_deg[i], std.angles_deg[i]),
            Cell::fixed(ARCSEC * before.angles_deg[i], 1),
            Cell::fixed(ARCSEC * after.angles_deg[i], 1),
        ]);
    }
    let used = p.orientation.iter().filter(|o| o.used).count();
    Section::new("The sensor")
        .with(format!("Spread: root mean square deviation of the {used} used orientations from their mean."))
        .with(table)
}

fn orientations(p: &TiltFound) -> Section {
    let mut table = Table::new(["orientation", "runs", "used", "facility", "sensitivities", "offsets, nT", "angles, degrees"]);
    for o in &p.orientation {
        for (which, v) in [("before", &o.before), ("corrected", &o.after)] {
            table.push(cells![
                &o.axes,
                o.runs.join(", "),
                yes_or_no(o.used),
                which,
                v.scale.map(|s| format!("{s:.6}")).join(", "),
                v.offset_nt.map(|s| format!("{s:.2}")).join(", "),
                v.angles_deg.map(|s| format!("{s:.4}")).join(", "),
            ]);
        }
    }
    Section::new("The orientations").with(table)
}

/// A few lines for the terminal.
#[must_use]
pub fn tilt_summary(result: &Tilt) -> String {
    let p = &result.found;
    let line = |v: &SensorValues| {
        format!(
            "{} e-6, {} nT, {} arc seconds",
            v.scale.map(|s| format!("{:.1}", 1e6 * s)).join(" "),
            v.offset_nt.map(|s| format!("{s:.2}")).join(" "),
            v.angles_deg.map(|s| format!("{:.1}", ARCSEC * s)).join(" ")
        )
    };
    format!(
        "{}  {} runs in {} orientations\n{}  spread before  {}\n  spread after   {}\n  undetermined: {}\n",
        or_not_stated(&p.sensor),
        p.used.len(),
        p.orientation.iter().filter(|o| o.used).count(),
        summary_of(&p.facility, &p.std),
        line(&p.spread_before),
        line(&p.spread_after),
        undetermined(p)
    )
}
