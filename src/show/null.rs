//! The report of a zero-field run.

use super::document::{Block, Cell, Section, Table, Text, cells};
use super::{known_effects, remarks, run_line, triple, used_file};
use crate::data::units::{COMPONENTS, counted};
use crate::data::zero_field::{ChannelDependence, DataStop, NoiseDensity, ZeroFieldFound};
#[cfg(feature = "tables")]
use crate::files::parameter::Npf;
use crate::measure::null::Null;
use std::fmt::Write;

/// Lines that the report shows, the strongest first.
const MOST_LINES: usize = 20;

/// The sections of the report.
#[must_use]
pub fn sections(null: &Null, file_name: &str) -> Vec<Section> {
    let p = &null.found;
    let r = &p.record;
    let mut used = used_file(&p.run, file_name).with(format!(
        "{} samples from {:.1} to {:.1} s ({:.2} h) at {:.6} Hz; {} samples lost in {}, {} of them in short gaps that a straight line \
         bridges.",
        r.samples,
        r.time_s[0],
        r.time_s[1],
        (r.time_s[1] - r.time_s[0]) / 3600.0,
        r.sample_rate_hz,
        r.lost,
        counted(r.gaps, "gap"),
        r.bridged
    ));
    used.blocks.extend(null.model.as_ref().map(|model| known_effects(model).into()));
    let mut sections = vec![used, offset(p), noise(p)];
    sections.extend(lines(p));
    sections.push(allan(p));
    sections.extend(channels(p));
    sections.push(stops(p));
    sections.extend(remarks(&null.notes));
    sections
}

/// Name of the coefficient of a power of the time, in a unit of the field.
fn drift_name(power: usize, unit: &str) -> String {
    if power == 1 { format!("drift, {unit}/h") } else { format!("{unit}/h^{power}") }
}

fn offset(p: &ZeroFieldFound) -> Section {
    let o = &p.offset;
    let mut names = vec!["component".to_owned(), format!("reading at {:.0} s, enT", o.time_s)];
    names.extend((1..=o.order).map(|k| drift_name(k, "enT")));
    names.extend(["rms about it, enT", "range, enT"].map(str::to_owned));
    let mut table = Table::new(names);
    for c in 0..3 {
        let mut row = cells![COMPONENTS[c], Cell::uncertain(o.mean_ent[c], o.mean_std_ent[c])];
        row.extend((0..o.order).map(|k| Cell::uncertain(o.drift_ent_per_h[k][c], o.drift_std_ent_per_h[k][c])));
        row.extend([Cell::fixed(o.residual_std_ent[c], 4), Cell::fixed(o.range_ent[c], 3)]);
        table.push(row);
    }
    let section = Section::new("Offset and drift").with(table).with(format!(
        "Least squares of {} means, standard uncertainties with slow noise included. The reading holds the residual field of the coil \
         system as well as the offset of the sensor.",
        o.rows
    ));
    section.with_all(scaled(p).into_iter().flatten())
}

/// The same in nT, where a linear calibration gives the sensitivity.
fn scaled(p: &ZeroFieldFound) -> Option<[Block; 2]> {
    let s = p.scaled.as_ref()?;
    let mut names = vec!["component".to_owned(), format!("reading at {:.0} s, nT", p.offset.time_s)];
    names.extend((1..=s.drift_nt_per_h.len()).map(|k| drift_name(k, "nT")));
    let density = s.nt_per_root_hz.as_ref().zip(s.std_nt_per_root_hz.as_ref());
    names.extend(p.density.as_ref().zip(density).map(|(d, _)| format!("noise at {} Hz, nT/√Hz", d.frequency_hz)));
    let mut table = Table::new(names);
    for c in 0..3 {
        let mut row = cells![COMPONENTS[c], Cell::uncertain(s.mean_nt[c], s.mean_std_nt[c])];
        row.extend(s.drift_nt_per_h.iter().zip(&s.drift_std_nt_per_h).map(|(v, std)| Cell::uncertain(v[c], std[c])));
        row.extend(density.map(|(v, std)| Cell::uncertain(v[c], std[c]).unsigned()));
        table.push(row);
    }
    Some([Text::words_and_code(["With the sensitivities of ", &s.cpf, ":"]).into(), table.into()])
}

/// Density with its limits of 95 %.
fn with_limits(d: &NoiseDensity, c: usize) -> String {
    let v = d.ent_per_root_hz[c];
    let decimals = decimals(d.std_ent_per_root_hz[c]);
    format!("{v:.decimals$} ({:.decimals$} to {:.decimals$})", d.low_ent_per_root_hz[c], d.high_ent_per_root_hz[c])
}

/// Decimals that show two digits of an uncertainty.
fn decimals(std: f64) -> usize {
    if std > 0.0 && std.is_finite() { (1.0 - std.log10().floor()).clamp(0.0, 12.0) as usize } else { 4 }
}

fn noise(p: &ZeroFieldFound) -> Section {
    let k = &p.corner;
    let mut table = Table::new([
        "component",
        "at 1 Hz, enT/√Hz (95 %)",
        "white, enT/√Hz",
        "1/f at 1 Hz, enT/√Hz",
        "corner, Hz",
        "χ² per degree",
    ]);
    for c in 0..3 {
        table.push(cells![
            COMPONENTS[c],
            p.density.as_ref().map_or(Cell::Missing("not reached"), |d| with_limits(d, c).into()),
            Cell::uncertain(k.white_ent_per_root_hz[c], k.white_std_ent_per_root_hz[c]).unsigned(),
            Cell::exponent(k.slow_ent_per_root_hz[c], 3).or("-"),
            Cell::scientific(k.corner_hz[c], k.corner_std_hz[c]).or("-"),
            Cell::fixed(k.chi_square_per_degree[c], 2),
        ]);
    }
    let band = p.density.as_ref().map_or_else(String::new, |d| {
        format!(
            " The value at 1 Hz is the mean from {:.3} to {:.3} Hz with {:.0} degrees of freedom.",
            d.band_hz[0], d.band_hz[1], d.degrees_of_freedom
        )
    });
    let f = &p.spectrum.frequency_hz;
    let method = format!(
        "One-sided amplitude density by Welch's method, {} bands from {:.1e} to {:.1} Hz, lines left out.{band} White and 1/f noise are a \
         fit of ",
        f.len(),
        f.first().copied().unwrap_or(f64::NAN),
        f.last().copied().unwrap_or(f64::NAN),
    );
    Section::new("Noise")
        .with(table)
        .with(Text::from(method).code("S = W + A/f").and("; a χ² far above 1 means that the noise has another shape."))
}

fn lines(p: &ZeroFieldFound) -> Option<Section> {
    if p.line.is_empty() {
        return None;
    }
    let mut strongest: Vec<_> = p.line.iter().collect();
    strongest.sort_by(|a, b| b.power_ratio.total_cmp(&a.power_ratio));
    let mut table = Table::new(["component", "frequency, Hz", "amplitude, enT", "power over noise"]);
    for l in strongest.iter().take(MOST_LINES) {
        table.push(cells![
            &l.component,
            Cell::place(l.frequency_hz, 0.5 * l.resolution_hz, 4),
            Cell::uncertain(l.amplitude_ent, l.amplitude_std_ent).unsigned(),
            Cell::fixed(l.power_ratio, 1),
        ]);
    }
    let more = strongest.len().saturating_sub(MOST_LINES);
    let more = if more > 0 { format!("{more} weaker ones stand in the parameter file. ") } else { String::new() };
    Some(Section::new("Lines").with(table).with(format!(
        "Amplitudes are half peak to peak. {more}A line may be the alias of a frequency above half the sample rate."
    )))
}

fn allan(p: &ZeroFieldFound) -> Section {
    let a = &p.allan;
    let mut table = Table::new(["τ, s", "x, enT", "y, enT", "z, enT", "limits of 95 %"]);
    for (i, tau) in a.tau_s.iter().enumerate() {
        let [x, y, z] = [&a.x_ent, &a.y_ent, &a.z_ent].map(|v| Cell::exponent(v[i], 3));
        table.push(cells![Cell::fixed(*tau, 4), x, y, z, format!("× {:.3} to {:.3}", a.low_factor[i], a.high_factor[i])]);
    }
    Section::new("Allan deviation").with(table)
}

fn coefficients(values: &[f64; 3], std: &[f64; 3]) -> [Cell; 3] {
    std::array::from_fn(|c| Cell::uncertain(values[c], std[c]))
}

fn channels(p: &ZeroFieldFound) -> Option<Section> {
    if p.channel.is_empty() {
        return None;
    }
    let mut table =
        Table::new(["channel", "range", "x, enT per unit", "y, enT per unit", "z, enT per unit", "correlation x, y, z"]);
    for ChannelDependence { name, unit, range, coefficient_ent, coefficient_std_ent, correlation } in &p.channel {
        let [x, y, z] = coefficients(coefficient_ent, coefficient_std_ent);
        let range = Cell::fixed(*range, 3).with_unit(unit);
        table.push(cells![name, range, x, y, z, correlation.map(|r| format!("{r:+.2}")).join(", ")]);
    }
    let mut section = Section::new("What the readings follow").with(table).with(
        "Each channel alone, standard uncertainties with slow noise included. Channels that run alike cannot be told apart this way.",
    );
    if let Some(t) = &p.together {
        let mut table = Table::new(["channel", "x, enT per unit", "y, enT per unit", "z, enT per unit"]);
        for (i, name) in t.channels.iter().enumerate() {
            let [x, y, z] = coefficients(&t.coefficient_ent[i], &t.coefficient_std_ent[i]);
            table.push(cells![name, x, y, z]);
        }
        let left = t.residual_std_ent.map(|v| format!("{v:.4}")).join(", ");
        section.push(format!("Sensor temperature and variometer in one fit, which leaves {left} enT (x, y, z):"));
        section.push(table);
    }
    Some(section)
}

fn stops(p: &ZeroFieldFound) -> Section {
    let section = Section::new("Stops of the data");
    if p.stop.is_empty() {
        return section.with("The data run from the begin to the end of the setting.");
    }
    let row = |s: &DataStop| {
        let minutes = Cell::fixed((s.until_s - s.from_s) / 60.0, 1);
        cells![Cell::fixed(s.from_s, 1), Cell::fixed(s.until_s, 1), minutes, &s.what]
    };
    section.with(Table::new(["from, s", "until, s", "length, min", "what"]).with_rows(p.stop.iter().map(row)))
}

/// The result in one line.
#[must_use]
pub fn headline(null: &Null) -> String {
    let p = &null.found;
    let drift = p.offset.drift_ent_per_h.first().zip(p.offset.drift_std_ent_per_h.first());
    let density = p.density.as_ref().map_or_else(String::new, |d| {
        format!(", {} enT/√Hz at 1 Hz", triple(&d.ent_per_root_hz, &d.std_ent_per_root_hz).replace('+', ""))
    });
    format!("drift {} enT/h{density}", drift.map_or_else(|| "not fitted".to_owned(), |(v, s)| triple(v, s)))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(null: &Null) -> String {
    let p = &null.found;
    let mut out = format!(
        "{}  {} samples, {:.2} h\n  mean   {}  enT\n",
        run_line(&p.run),
        p.record.samples,
        (p.record.time_s[1] - p.record.time_s[0]) / 3600.0,
        triple(&p.offset.mean_ent, &p.offset.mean_std_ent),
    );
    if let (Some(v), Some(s)) = (p.offset.drift_ent_per_h.first(), p.offset.drift_std_ent_per_h.first()) {
        let _ = writeln!(out, "  drift  {}  enT/h", triple(v, s));
    }
    if let Some(d) = &p.density {
        let _ =
            writeln!(out, "  noise  {}  enT/√Hz at 1 Hz", triple(&d.ent_per_root_hz, &d.std_ent_per_root_hz).replace('+', ""));
    }
    for s in &p.stop {
        let _ = writeln!(out, "  stop   {:.1} to {:.1} s: {}", s.from_s, s.until_s, s.what);
    }
    out
}

/// One row per run, for a campaign.
#[cfg(feature = "tables")]
#[must_use]
pub fn parameter_table(runs: &[Npf]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    super::head_columns(&mut table, runs.iter().map(|o| &o.found.run));
    let numbers = |get: &dyn Fn(&ZeroFieldFound) -> f64| Values::Numbers(runs.iter().map(|o| get(&o.found)).collect());
    let first = |list: &[[f64; 3]], i: usize| list.first().map_or(f64::NAN, |v| v[i]);
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("mean_{axis}_ent"), numbers(&|p| p.offset.mean_ent[i]));
        table.push(&format!("mean_{axis}_std_ent"), numbers(&|p| p.offset.mean_std_ent[i]));
        table.push(&format!("drift_{axis}_ent_per_h"), numbers(&|p| first(&p.offset.drift_ent_per_h, i)));
        table.push(&format!("drift_{axis}_std_ent_per_h"), numbers(&|p| first(&p.offset.drift_std_ent_per_h, i)));
        let density =
            |p: &ZeroFieldFound, get: fn(&NoiseDensity) -> &[f64; 3]| p.density.as_ref().map_or(f64::NAN, |d| get(d)[i]);
        table.push(&format!("density_1hz_{axis}_ent"), numbers(&|p| density(p, |d| &d.ent_per_root_hz)));
        table.push(&format!("density_1hz_{axis}_std_ent"), numbers(&|p| density(p, |d| &d.std_ent_per_root_hz)));
        table.push(&format!("corner_{axis}_hz"), numbers(&|p| p.corner.corner_hz[i]));
    }
    table
}
