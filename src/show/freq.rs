//! The report of a frequency measurement: the blocks of BC-MAG-TR-0085 section 3.6.1 in their order.

use super::document::{Cell, Section, Table, cells};
use super::{known_effects, number, remarks, run_line, triple, used_file, yes_or_no};
use crate::data::units::{COMPONENTS, with_uncertainty};
#[cfg(feature = "tables")]
#[cfg(feature = "tables")]
use crate::files::parameter::Fpf;
use crate::measure::freq::Freq;
use std::fmt::Write;

/// The sections of the report.
#[must_use]
pub fn sections(freq: &Freq, file_name: &str) -> Vec<Section> {
    let p = freq;
    let mut response = response(p);
    response.blocks.extend(p.effects.as_ref().map(|effects| known_effects(effects).into()));
    let mut sections = vec![used_file(&p.found.run, file_name), rate(p), corner(p), response, amplitudes(p)];
    sections.extend(remarks(&p.notes));
    sections
}

/// A value, or nan where it is not known.
fn known(value: Option<f64>) -> f64 {
    value.unwrap_or(f64::NAN)
}

fn rate(p: &Freq) -> Section {
    let section = Section::new("Sampling frequency");
    let (Some(f_s_hz), Some(clock)) = (p.values.f_s_hz, &p.found.clock) else {
        return section.with("A table of amplitudes tells no sampling frequency.");
    };
    let mut table = Table::new(["component", "f_s, Hz", "standard uncertainty, Hz"]);
    for i in 0..3 {
        table.push(cells![
            COMPONENTS[i],
            Cell::fixed(f_s_hz[i], 6),
            Cell::exponent(known(p.values.f_s_std_hz.map(|std| std[i])), 2).or("-")
        ]);
    }
    table.push(cells![
        "weighted mean",
        Cell::fixed(known(p.values.mean_f_s_hz), 6),
        Cell::exponent(known(p.values.mean_f_s_std_hz), 2)
    ]);
    let scatter =
        p.values.scatter_f_s_hz.map_or_else(String::new, |s| format!("Standard deviation of the three components {s:.2e} Hz. "));
    let mut words = format!("{scatter}All frequencies of the run together give one sampling frequency per component.");
    let drift: Vec<String> = (0..3)
        .map(|i| format!("{} {:+.1e} ± {:.1e}", COMPONENTS[i], clock.drift_hz_per_s[i], clock.drift_std_hz_per_s[i]))
        .collect();
    let is = if clock.drift_is_significant { "is significant and was taken into account" } else { "is not significant" };
    let _ = write!(words, " Its drift during the run, {} Hz/s, {is}.", drift.join(", "));
    if let Some(t_s) = clock.reference_s {
        let _ = write!(words, " The sampling frequencies above hold {t_s:.3} s after sample counter 0.");
    }
    let _ = match (clock.rival_hz, clock.rival_chi_square) {
        (Some(rival), Some(chi)) => {
            write!(words, " The next best value within 0.1 %, {rival:.5} Hz, is worse by {chi:.0} in chi-square.")
        }
        _ => write!(words, " There is no other value within 0.1 %."),
    };
    section.with(table).with(words)
}

fn corner(p: &Freq) -> Section {
    let mut table = Table::new(["component", "f_3dB igep, Hz", "f_3dB model, Hz ± standard uncertainty"]);
    for i in 0..3 {
        let model = Cell::uncertain(p.values.f_3db_model_hz[i], p.values.f_3db_model_std_hz[i]);
        table.push(cells![COMPONENTS[i], Cell::fixed(p.values.f_3db_igep_hz[i], 2), model]);
    }
    Section::new("-3 dB corner frequency").with(table).with(
        "igep: straight line in level against frequency between the neighbours of -3.000 dB below the largest amplitude. model: where the \
         response fitted to all amplitudes is 1/√2 of its DC gain (-3.0103 dB).",
    )
}

fn response(p: &Freq) -> Section {
    // Reports have had one more empty line here from the beginning.
    let section = Section::new("Response model").with("");
    let model = &p.found.model;
    if model.parameters.is_empty() {
        return section.with("No model could be fitted.");
    }
    let mut fitted = Table::new(std::iter::once("component").chain(model.parameters.iter().map(String::as_str)));
    for (i, (values, std)) in model.values.iter().zip(&model.std).enumerate() {
        let cell =
            |k: usize| Cell::uncertain(values.get(k).copied().unwrap_or(f64::NAN), std.get(k).copied().unwrap_or(f64::NAN));
        fitted.push(std::iter::once(COMPONENTS[i].into()).chain((0..model.parameters.len()).map(cell)).collect());
    }
    let basis = match (model.chi_square, model.degrees_of_freedom) {
        (Some(chi_square), Some(dof)) => format!(
            "It explains the amplitudes within their uncertainties (chi-square {chi_square:.1} with {dof} degrees of freedom), which give \
             those of its parameters."
        ),
        _ => "No model explains the amplitudes within their uncertainties: those of the parameters come from their scatter about the model, \
              outliers apart, and from leaving out one at a time."
            .to_owned(),
    };
    let mut candidates: Vec<_> = model.candidate.iter().collect();
    candidates.sort_by(|a, b| a.delta_aicc.total_cmp(&b.delta_aicc));
    let compared = candidates.into_iter().map(|c| {
        let [x, y, z] = c.f_3db_hz.map(|f| Cell::fixed(f, 2));
        cells![&c.name, Cell::fixed(c.delta_aicc, 1), x, y, z]
    });
    section
        .with(format!("Model: {}. {basis}", model.name))
        .with(fitted)
        .with("Models that were compared, over the three components:")
        .with(Table::new(["model", "ΔAICc", "f_3dB x, Hz", "f_3dB y, Hz", "f_3dB z, Hz"]).with_rows(compared))
}

fn amplitudes(p: &Freq) -> Section {
    let mut table =
        Table::new(["applied frequency, Hz", "Bx, enT", "By, enT", "Bz, enT", "standard uncertainty, enT", "used", "remark"]);
    for a in &p.amplitude {
        let std = a.b_std_ent.iter().copied().filter(|s| s.is_finite()).reduce(f64::max);
        let std = std.map_or(Cell::Missing("not known"), |s| Cell::fixed(s, 4));
        let [x, y, z] = a.b_ent.map(|b| Cell::fixed(b, 3));
        table.push(cells![Cell::fixed(a.frequency_hz, 3), x, y, z, std, yes_or_no(a.used), &a.remark]);
    }
    Section::new("Applied frequencies and measured amplitudes")
        .with(table)
        .with("Half peak to peak, along the sensor axes; the largest uncertainty of the three components.")
}

/// The result in one line.
#[must_use]
pub fn headline(freq: &Freq) -> String {
    format!("f_3dB {} Hz", triple(&freq.values.f_3db_model_hz, &freq.values.f_3db_model_std_hz))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(freq: &Freq) -> String {
    let p = freq;
    let used = p.amplitude.iter().filter(|a| a.used).count();
    let of_rate = |hz: f64| format!("  f_s    {}  Hz\n", with_uncertainty(hz, known(p.values.mean_f_s_std_hz)));
    let rate = p.values.mean_f_s_hz.map_or_else(String::new, of_rate);
    let igep: Vec<String> = p.values.f_3db_igep_hz.iter().map(|f| number(*f, 2)).collect();
    format!(
        "{}  {used} of {} frequencies\n{rate}  f_3dB  {}  Hz (igep)\n         {}  Hz ({})\n",
        run_line(&p.found.run),
        p.amplitude.len(),
        igep.join(", "),
        triple(&p.values.f_3db_model_hz, &p.values.f_3db_model_std_hz),
        p.corner.model.unwrap_or("none")
    )
}

/// One row per run, for a campaign.
#[cfg(feature = "tables")]
#[must_use]
pub fn parameter_table(runs: &[Fpf]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    super::head_columns(&mut table, runs.iter().map(|f| &f.found.run));
    let numbers = |get: &dyn Fn(&Fpf) -> f64| Values::Numbers(runs.iter().map(get).collect());
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("f_s_{axis}_hz"), numbers(&|p| known(p.values.f_s_hz.map(|f| f[i]))));
        table.push(&format!("f_s_{axis}_std_hz"), numbers(&|p| known(p.values.f_s_std_hz.map(|std| std[i]))));
    }
    table.push("mean_f_s_hz", numbers(&|p| known(p.values.mean_f_s_hz)));
    table.push("mean_f_s_std_hz", numbers(&|p| known(p.values.mean_f_s_std_hz)));
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("f_3db_igep_{axis}_hz"), numbers(&|p| p.values.f_3db_igep_hz[i]));
        table.push(&format!("f_3db_model_{axis}_hz"), numbers(&|p| p.values.f_3db_model_hz[i]));
        table.push(&format!("f_3db_model_{axis}_std_hz"), numbers(&|p| p.values.f_3db_model_std_hz[i]));
    }
    table.push("model", Values::Text(runs.iter().map(|f| f.found.model.name.clone()).collect()));
    table
}

/// One row per applied frequency.
#[cfg(feature = "tables")]
#[must_use]
pub fn amplitude_table(freq: &Freq) -> crate::files::table::Table {
    use crate::data::frequency::SineAmplitude;
    use crate::files::table::{Table, Values};
    let rows = &freq.amplitude;
    let mut table = Table::default();
    let numbers = |get: &dyn Fn(&SineAmplitude) -> f64| Values::Numbers(rows.iter().map(get).collect());
    let of = |list: Option<[f64; 3]>, i: usize| list.map_or(f64::NAN, |l| l[i]);
    table.push("frequency_hz", numbers(&|a| a.frequency_hz));
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("b{axis}_ent"), numbers(&|a| a.b_ent[i]));
    }
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("b{axis}_std_ent"), numbers(&|a| a.b_std_ent[i]));
    }
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("phase_{axis}_deg"), numbers(&|a| of(a.phase_deg, i)));
        table.push(&format!("phase_{axis}_std_deg"), numbers(&|a| of(a.phase_std_deg, i)));
    }
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("weight_{axis}"), numbers(&|a| a.weight[i]));
    }
    table.push("phase_counter", Values::Counts(rows.iter().map(|a| a.phase_counter.unwrap_or_default()).collect()));
    table.push("alias_hz", numbers(&|a| a.alias_hz.unwrap_or(f64::NAN)));
    table.push("used_from_s", numbers(&|a| a.used_s.map_or(f64::NAN, |s| s[0])));
    table.push("used_to_s", numbers(&|a| a.used_s.map_or(f64::NAN, |s| s[1])));
    table.push("samples", Values::Counts(rows.iter().map(|a| a.samples.unwrap_or_default()).collect()));
    table.push("remark", Values::Text(rows.iter().map(|a| a.remark.clone()).collect()));
    table
}
