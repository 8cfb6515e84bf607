//! The report table of a linear calibration: the blocks of BC-MAG-TR-0085 section 3.4.1 in their order.

use super::document::{Block, Cell, Section, Table, Text, cells};
use super::{known_effects, not_used, or_not_stated, remarks, run_line, triple, used_file};
use crate::data::calibration::{LinearCalibration, SlopeSource, TemperatureSlopes};
use crate::data::result::{AT_REST_K, Conditions};
use crate::data::units::{COMPONENTS, with_uncertainty};
#[cfg(feature = "tables")]
use crate::files::parameter::Cpf;
use crate::measure::lin::Lin;
use crate::model::campaign::{LARGEST_SIGMA_PER_K, LARGEST_XI_DEG_PER_K};

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// A matrix as lines of fixed pitch.
pub(super) fn matrix(rows: &[[f64; 3]; 3]) -> Block {
    // What rounds to zero is printed without a sign of its own.
    let rows = rows.map(|row| row.map(|v| if v.abs() < 5e-7 { 0.0 } else { v }));
    Block::Code(rows.iter().map(|r| format!("{:+10.6}  {:+10.6}  {:+10.6}\n", r[0], r[1], r[2])).collect())
}

/// The sections of the report, with the name of the parameter file.
#[must_use]
pub fn sections(lin: &Lin, parameter_file: &str) -> Vec<Section> {
    let p = &lin.calibration;
    let mut sections = vec![used_file(&p.run, parameter_file), facility(p)];
    sections.extend(p.slopes.as_ref().map(|slopes| movement(lin, slopes)));
    sections.extend([offset(p), raw_data(lin), parameters(p), model_quality(p), uncertainty(p), validity(p)]);
    sections.extend(not_used(&lin.dropped));
    sections.extend(remarks(&lin.notes));
    sections
}

/// The result in one line.
#[must_use]
pub fn headline(lin: &Lin) -> String {
    let p = &lin.calibration;
    let moved = moved(lin).map_or_else(String::new, |moved| format!("; {moved}"));
    format!("σ {} nT/enT{moved}", triple(&p.sigma_nt_per_ent(), &p.whole_std().sigma))
}

/// By how much the sensor temperature moved, and where the slopes come from; nothing for a sensor at rest.
fn moved(lin: &Lin) -> Option<String> {
    let conditions = lin.temperatures.conditions.as_ref()?;
    let (range_k, rate) = (conditions.sensor_range_k?, conditions.sensor_rate_k_per_h?);
    let slopes = lin.calibration.slopes.as_ref()?;
    Some(format!("sensor temperature moved by {range_k:.1} K ({rate:+.1} K/h), slopes: {}", slopes.source))
}

/// What the parameters follow of the sensor temperature.
fn movement(lin: &Lin, slopes: &TemperatureSlopes) -> Section {
    let mut section = Section::new("Sensor temperature during the run");
    let text = match &lin.temperatures.conditions {
        Some(Conditions { sensor_range_k: Some(range_k), sensor_rate_k_per_h: Some(rate), .. }) => {
            format!("The sensor temperature moved by {range_k:.2} K, a straight line through it by {rate:+.1} K/h. ")
        }
        _ => format!("The sensor temperature moved by less than {AT_REST_K} K. "),
    };
    let origin = match &slopes.source {
        SlopeSource::Run => "found in the run itself together with everything else".to_owned(),
        SlopeSource::Bound => "held by the bounds that the campaign states".to_owned(),
        SlopeSource::Assumed => format!(
            "not known: what the run tells of them is held by what the campaign states, or else by the largest that are published of fluxgates, \
             {LARGEST_SIGMA_PER_K} nT/enT/K and {LARGEST_XI_DEG_PER_K} deg/K as standard uncertainties about zero"
        ),
        SlopeSource::Polynomials(file) => format!("those of {file}"),
    };
    let place = format!(
        "All readings were referred to {:.3} °C, at which the parameters hold. The slopes of sensitivities and angles are {origin}; the sensor \
         is taken as not turning in its mount, and the offset follows the temperature beside its trend in time as the run says.",
        slopes.at_degc
    );
    section.push(Text::from(text).and(place));
    let mut table = Table::new(["slope at this temperature", "value ± standard uncertainty", "unit"]);
    let mut rows = |names: [&str; 3], values: [f64; 3], std: [f64; 3], unit: &str| {
        for i in 0..3 {
            table.push(cells![names[i], Cell::uncertain(values[i], std[i]), unit]);
        }
    };
    rows(["σ_x", "σ_y", "σ_z"], slopes.sigma, slopes.std.sigma, "nT/enT/K");
    rows(["ξ_xy", "ξ_xz", "ξ_yz"], slopes.xi_deg, slopes.std.xi_deg, "degrees/K");
    if let (Some(slope), Some(std)) = (slopes.b_or_ent, slopes.std.b_or_ent) {
        rows(["B_or x", "B_or y", "B_or z"], slope, std, "enT/K");
    }
    section.with(table)
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(lin: &Lin) -> String {
    let p = &lin.calibration;
    let sigma: Vec<String> = (0..3).map(|i| with_uncertainty(p.matrix.sigma[i][i], p.whole_std().sigma[i])).collect();
    let b_or: Vec<String> = (0..3).map(|i| with_uncertainty(p.offset.b_or_ent[i], p.whole_std().b_or_ent[i])).collect();
    let residual = p.quality.residual_nt.std.map(|s| format!("{s:.3}"));
    format!(
        "{}  {} of {} blocks{}\n{}  σ     {}  nT/enT\n  B_or  {}  enT\n  residual standard deviation {}  nT (X, Y, Z)\n",
        run_line(&p.run),
        p.quality.blocks_used,
        p.quality.blocks_total,
        lin.linearisation.as_ref().map_or_else(String::new, |l| format!(", linearised with {}", l.file))
            + &lin.model.as_ref().map_or_else(String::new, |m| format!(", without the effects of {}", m.file)),
        moved(lin).map_or_else(String::new, |moved| format!("  {moved}\n")),
        sigma.join(", "),
        b_or.join(", "),
        residual.join(", "),
    )
}

fn facility(p: &LinearCalibration) -> Section {
    let axes = &p.setup.position_axes;
    let setup = format!(
        "Nominal sensor setup, position {}: X_m = {}_c, Y_m = {}_c, Z_m = {}_c; ",
        p.setup.position, axes[0], axes[1], axes[2]
    );
    let angles = [p.angle_deg.lambda_x, p.angle_deg.mu_y, p.angle_deg.nu_z];
    let mut rotation = Table::new(["rotation angle", "value", "degrees ± standard uncertainty"]);
    for (i, name) in ["(X_c, X_m): λ_x", "(Y_c, Y_m): μ_y", "(Z_c, Z_m): ν_z"].into_iter().enumerate() {
        rotation.push(cells![name, Cell::angle(angles[i]), Cell::uncertain(angles[i], p.whole_std().lambda_mu_nu_deg[i])]);
    }
    Section::new("Facility parameter")
        .with(Text::from(setup).code("R_nom").and(" takes nominal sensor coordinates to coil coordinates:"))
        .with(matrix(&p.matrix.r_nom))
        .with(Text::from("Calculated sensor rotation ").code("ρ").and(":"))
        .with(matrix(&p.matrix.rho))
        .with(rotation)
        .with(conditions(p))
}

fn conditions(p: &LinearCalibration) -> Table {
    let correction = match p.run.coil_correction {
        Some(true) => "used",
        Some(false) => "not used",
        None => "not stated",
    };
    let compensation = if p.run.earthfield_compensation.is_empty() {
        "not stated".to_owned()
    } else {
        AXES.iter().zip(&p.run.earthfield_compensation).map(|(a, c)| format!("{a} = {c}")).collect::<Vec<_>>().join(", ")
    };
    Table::new(["condition", "value"]).with_rows([
        cells!["Determinant of the rotation matrix", Cell::fixed(p.quality.rotation_determinant, 5)],
        cells!["Nominal field source", or_not_stated(&p.run.field_source)],
        cells!["Campaign", &p.run.campaign],
        cells!["Fields applied for", Cell::fixed(p.setup.field_duration_s, 1).with_unit("s")],
        cells!["Left out after a step", Cell::fixed(p.setup.settling_s, 2).with_unit("s")],
        cells!["Mean sensor temperature", Cell::degc(p.run.temperature_degc)],
        cells!["Mean coil system temperature", Cell::degc(p.run.coil_temperature_degc)],
        cells!["Automatic coil correction", correction],
        cells!["Earthfield compensation", compensation],
    ])
}

fn offset(p: &LinearCalibration) -> Section {
    let trend = match p.offset.trend_order {
        0 => "A constant offset was fitted together with the sensor model.".to_owned(),
        order => format!("A polynomial offset trend of order {order} was fitted together with the sensor model."),
    };
    let values: Vec<String> = (0..3)
        .map(|i| format!("{} = {} enT", COMPONENTS[i], with_uncertainty(p.offset.b_or_ent[i], p.whole_std().b_or_ent[i])))
        .collect();
    let mean = Text::from("Mean coil system residual + sensor offset ").code("B_or");
    Section::new("Offset treatment").with(trend).with(mean.and(format!(", along the sensor axes: {}", values.join(", "))))
}

fn raw_data(lin: &Lin) -> Section {
    let quality = &lin.calibration.quality;
    let mut section = Section::new("Raw data quality");
    if let Some(linearisation) = &lin.linearisation {
        section.push(Text::words_and_code([
            "The readings were linearised with ",
            &linearisation.file,
            ", ",
            "r + c2 r² + c3 r³",
            "; all parameters hold for linearised readings.",
        ]));
    }
    section.blocks.extend(lin.model.as_ref().map(|model| known_effects(model).into()));
    match &quality.raw_std_ent {
        None => section.push("The file brings plateau means without standard deviations."),
        Some(s) => {
            section.push("Standard deviation of the used raw data blocks:");
            let rows = [("minimum", s.min), ("mean", s.mean), ("maximum", s.max)];
            section.push(three_columns(["values in enT", "s_x", "s_y", "s_z"], rows));
        }
    }
    section.with(format!(
        "{} of {} blocks used; {} samples lost, {} left out beside spikes.",
        quality.blocks_used, quality.blocks_total, quality.lost_samples, quality.spike_samples
    ))
}

/// Rows of three values with three decimals.
fn three_columns(head: [&str; 4], rows: [(&str, [f64; 3]); 3]) -> Table {
    let row = |(name, [x, y, z]): (&str, [f64; 3])| cells![name, Cell::fixed(x, 3), Cell::fixed(y, 3), Cell::fixed(z, 3)];
    Table::new(head).with_rows(rows.map(row))
}

fn parameters(p: &LinearCalibration) -> Section {
    let mut section = Section::new("Calibration parameter");
    for (words, symbol, unit, rows) in [
        ("Transfer matrix ", "Φ = R_nom ρ ω σ", ", nT/enT:", &p.matrix.phi),
        ("Reduced transfer matrix ", "φ̃ = ω σ", ", nT/enT:", &p.matrix.phi_tilde),
        ("Sensitivity ", "σ", ", nT/enT:", &p.matrix.sigma),
        ("Misalignment ", "ω", " (BepiColombo convention):", &p.matrix.omega),
    ] {
        section.push(Text::words_and_code([words, symbol, unit]));
        section.push(matrix(rows));
    }
    let mut table = Table::new(["sensor misalignment angle", "value", "degrees ± standard uncertainty"]);
    let angles = [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz];
    for (i, name) in ["ξ_xy", "ξ_xz", "ξ_yz"].into_iter().enumerate() {
        table.push(cells![name, Cell::angle(angles[i]), Cell::uncertain(angles[i], p.whole_std().xi_deg[i])]);
    }
    section.with(table)
}

fn model_quality(p: &LinearCalibration) -> Section {
    let q = &p.quality.residual_nt;
    let rows = [("standard deviation", q.std), ("maximum error", q.max), ("minimum error", q.min)];
    Section::new("Model quality")
        .with(Text::words_and_code(["Applied field minus modelled measurement, ", "B_c - Φ B_m", ":"]))
        .with(three_columns(["values in nT, coil axes", "X", "Y", "Z"], rows))
}

fn uncertainty(p: &LinearCalibration) -> Section {
    let mut table = Table::new(["sensitivity", "nT/enT ± standard uncertainty"]);
    for i in 0..3 {
        table.push(cells![format!("σ_{}", COMPONENTS[i]), Cell::uncertain(p.matrix.sigma[i][i], p.whole_std().sigma[i])]);
    }
    let mut section = Section::new("Uncertainty").with(table);
    if let Some(b) = &p.of_facility {
        let mut both = Table::new(["quantity", "type A", "type B, facility", "combined"]);
        let families = [
            ("σ", COMPONENTS, "nT/enT", [p.std.sigma, b.std_b.sigma, b.std_combined.sigma]),
            ("ξ", ["xy", "xz", "yz"], "°", [p.std.xi_deg, b.std_b.xi_deg, b.std_combined.xi_deg]),
            ("B_or", COMPONENTS, "enT", [p.std.b_or_ent, b.std_b.b_or_ent, b.std_combined.b_or_ent]),
        ];
        for (family, components, unit, [type_a, type_b, combined]) in families {
            for (i, component) in components.into_iter().enumerate() {
                let cell = |std: f64| format!("{std:.2e}");
                both.push(cells![format!("{family}_{component}, {unit}"), cell(type_a[i]), cell(type_b[i]), cell(combined[i])]);
            }
        }
        section = section.with(both).with(
            "Type B is what the covariance of the facility file gives; it is common to all runs that use the file and does not become less \
             with their number.",
        );
    }
    section.with(format!(
        "Standard uncertainties (coverage factor 1) from the scatter of the samples within the plateaus and of the plateau means about \
         the model; that of the coil constants and coil angles is in them where a facility file states it, where the sensor temperature moved, the noise of the \
         thermometer is in them, its calibration is not. {} degrees of freedom per component, \
         condition number {:.2}. Noise of a plateau mean {:.3}, {:.3}, {:.3} enT, of which a part of {:.2}, {:.2}, {:.2} of the variance is \
         correlated from plateau to plateau ({:.0}, {:.0}, {:.0} effective plateaus). The full covariance is in the parameter file.",
        p.quality.degrees_of_freedom,
        p.quality.condition,
        p.noise.std_ent[0],
        p.noise.std_ent[1],
        p.noise.std_ent[2],
        p.noise.correlated_share[0],
        p.noise.correlated_share[1],
        p.noise.correlated_share[2],
        p.noise.effective_blocks[0],
        p.noise.effective_blocks[1],
        p.noise.effective_blocks[2],
    ))
}

fn validity(p: &LinearCalibration) -> Section {
    let field = p.valid.field_coil_nt.map(|[low, high]| format!("{low:.0} to {high:.0} nT"));
    let temperature =
        p.valid.temperature_degc.map_or_else(|| "not recorded".to_owned(), |[low, high]| format!("{low:.1} to {high:.1} °C"));
    Section::new("Validity").with(format!(
        "Fields X {}, Y {}, Z {} (coil axes); sensor temperature {temperature}. The results hold for the sensor and mode named above.",
        field[0], field[1], field[2]
    ))
}

/// One row per run, for a campaign.
#[cfg(feature = "tables")]
#[must_use]
pub fn parameter_table(runs: &[Cpf]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    let numbers = |get: &dyn Fn(&LinearCalibration) -> f64| Values::Numbers(runs.iter().map(|l| get(&l.calibration)).collect());
    super::head_columns(&mut table, runs.iter().map(|l| &l.calibration.run));
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("sigma_{axis}"), numbers(&|p| p.matrix.sigma[i][i]));
        table.push(&format!("sigma_{axis}_std"), numbers(&|p| p.whole_std().sigma[i]));
    }
    for (i, name) in ["xy", "xz", "yz"].into_iter().enumerate() {
        table.push(&format!("xi_{name}_deg"), numbers(&|p| [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz][i]));
        table.push(&format!("xi_{name}_std_deg"), numbers(&|p| p.whole_std().xi_deg[i]));
    }
    for (i, name) in ["lambda_x", "mu_y", "nu_z"].into_iter().enumerate() {
        table.push(&format!("{name}_deg"), numbers(&|p| [p.angle_deg.lambda_x, p.angle_deg.mu_y, p.angle_deg.nu_z][i]));
        table.push(&format!("{name}_std_deg"), numbers(&|p| p.whole_std().lambda_mu_nu_deg[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("b_or_{axis}_ent"), numbers(&|p| p.offset.b_or_ent[i]));
        table.push(&format!("b_or_{axis}_std_ent"), numbers(&|p| p.whole_std().b_or_ent[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("residual_{axis}_std_nt"), numbers(&|p| p.quality.residual_nt.std[i]));
    }
    let conditions = |get: &dyn Fn(&Conditions) -> Option<f64>| {
        let of = |l: &Cpf| l.conditions.as_ref().and_then(get).unwrap_or(f64::NAN);
        Values::Numbers(runs.iter().map(of).collect())
    };
    table.push("sensor_range_k", conditions(&|c| c.sensor_degc.map(|[low, _, high]| high - low)));
    table.push("sensor_rate_k_per_h", conditions(&|c| c.sensor_rate_k_per_h));
    let source = |l: &Cpf| l.calibration.slopes.as_ref().map_or_else(String::new, |s| s.source.to_string());
    table.push("slopes_from", Values::Text(runs.iter().map(source).collect()));
    table.push("blocks_used", Values::Counts(runs.iter().map(|l| l.calibration.quality.blocks_used as u64).collect()));
    table.push("blocks_total", Values::Counts(runs.iter().map(|l| l.calibration.quality.blocks_total as u64).collect()));
    table
}

/// One row per plateau of a run.
#[cfg(feature = "tables")]
#[must_use]
pub fn block_table(lin: &Lin) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    use crate::measure::lin::Block;
    let mut table = Table::default();
    let numbers = |get: &dyn Fn(&Block) -> f64| Values::Numbers(lin.blocks.iter().map(get).collect());
    table.push("block", Values::Counts(lin.blocks.iter().map(|b| b.plateau.index as u64 + 1).collect()));
    table.push("used_from_s", numbers(&|b| b.plateau.used_s[0]));
    table.push("used_to_s", numbers(&|b| b.plateau.used_s[1]));
    table.push("samples", Values::Counts(lin.blocks.iter().map(|b| b.plateau.count.unwrap_or_default()).collect()));
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("b{axis}_nt"), numbers(&|b| b.plateau.setting.field.0[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("{axis}_ent"), numbers(&|b| b.plateau.mean.0[i]));
    }
    if lin.calibration.slopes.is_some() {
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            table.push(&format!("{axis}_at_its_temperature_ent"), numbers(&|b| b.reading_ent()[i]));
        }
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("std_{axis}_ent"), numbers(&|b| b.plateau.std_ent.map_or(f64::NAN, |s| s[i])));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("residual_{axis}_nt"), numbers(&|b| b.residual_coil_nt.map_or(f64::NAN, |r| r.0[i])));
    }
    table.push("weight", numbers(&|b| b.weight));
    let reason = |b: &Block| b.plateau.dropped.as_ref().map_or_else(String::new, ToString::to_string);
    table.push("not_used_because", Values::Text(lin.blocks.iter().map(reason).collect()));
    table
}
