//! The report of a zero-field run.

use super::{number, remarks, run_line, table, triple, used_file, value};
use crate::data::units::{COMPONENTS, scientific_with_uncertainty};
use crate::files::parameter::{Body, ChannelPart, DensityPart, Npf};
use crate::measure::null::Null;
use std::fmt::Write;

/// Lines that the report shows, the strongest first.
const MOST_LINES: usize = 20;

/// The blocks of the report with headings of the given level.
#[must_use]
pub fn sections(null: &Null, level: usize) -> String {
    let p = &null.parameters;
    let head = "#".repeat(level);
    let mut out = used_file(&p.run, &p.file_name(), level);
    let r = &p.record;
    let _ = writeln!(
        out,
        "{} samples from {:.1} to {:.1} s ({:.2} h) at {:.6} Hz; {} samples lost in {} gaps, {} of them in short gaps that a straight line \
         bridges.\n",
        r.samples,
        r.time_s[0],
        r.time_s[1],
        (r.time_s[1] - r.time_s[0]) / 3600.0,
        r.sample_rate_hz,
        r.lost,
        r.gaps,
        r.bridged
    );
    offset(&mut out, p, &head);
    scaled(&mut out, p);
    noise(&mut out, p, &head);
    lines(&mut out, p, &head);
    allan(&mut out, p, &head);
    channels(&mut out, p, &head);
    stops(&mut out, p, &head);
    out.push_str(&remarks(&p.warnings, level));
    out
}

fn offset(out: &mut String, p: &Npf, head: &str) {
    let o = &p.offset;
    let mut names = vec!["component".to_owned(), format!("reading at {:.0} s, enT", o.time_s)];
    names.extend((1..=o.order).map(|k| if k == 1 { "drift, enT/h".to_owned() } else { format!("enT/h^{k}") }));
    names.extend(["rms about it, enT", "range, enT"].map(str::to_owned));
    let mut rows = vec![names];
    for c in 0..3 {
        let mut row = vec![COMPONENTS[c].to_owned(), value(o.mean_ent[c], o.mean_std_ent[c])];
        row.extend((0..o.order).map(|k| value(o.drift_ent_per_h[k][c], o.drift_std_ent_per_h[k][c])));
        row.extend([number(o.residual_std_ent[c], 4), number(o.range_ent[c], 3)]);
        rows.push(row);
    }
    let _ = writeln!(
        out,
        "{head} Offset and drift\n\n{}\nLeast squares of {} means, standard uncertainties with slow noise included. The reading holds the \
         residual field of the coil system as well as the offset of the sensor.\n",
        table(&rows),
        o.rows
    );
}

/// The same in nT, where a linear calibration gives the sensitivity.
fn scaled(out: &mut String, p: &Npf) {
    let Some(s) = &p.scaled else { return };
    let mut names = vec!["component".to_owned(), format!("reading at {:.0} s, nT", p.offset.time_s)];
    names.extend((1..=s.drift_nt_per_h.len()).map(|k| if k == 1 { "drift, nT/h".to_owned() } else { format!("nT/h^{k}") }));
    let density = s.nt_per_root_hz.as_ref().zip(s.std_nt_per_root_hz.as_ref());
    names.extend(p.density.as_ref().zip(density).map(|(d, _)| format!("noise at {} Hz, nT/√Hz", d.frequency_hz)));
    let mut rows = vec![names];
    for c in 0..3 {
        let mut row = vec![COMPONENTS[c].to_owned(), value(s.mean_nt[c], s.mean_std_nt[c])];
        row.extend(s.drift_nt_per_h.iter().zip(&s.drift_std_nt_per_h).map(|(v, std)| value(v[c], std[c])));
        row.extend(density.map(|(v, std)| value(v[c], std[c]).replace('+', "")));
        rows.push(row);
    }
    let _ = writeln!(out, "With the sensitivities of `{}`:\n\n{}", s.cpf, table(&rows));
}

/// Density with its limits of 95 %.
fn with_limits(d: &DensityPart, c: usize) -> String {
    let v = d.ent_per_root_hz[c];
    let decimals = decimals(d.std_ent_per_root_hz[c]);
    format!("{v:.decimals$} ({:.decimals$} to {:.decimals$})", d.low_ent_per_root_hz[c], d.high_ent_per_root_hz[c])
}

/// Decimals that show two digits of an uncertainty.
fn decimals(std: f64) -> usize {
    if std > 0.0 && std.is_finite() { (1.0 - std.log10().floor()).clamp(0.0, 12.0) as usize } else { 4 }
}

fn noise(out: &mut String, p: &Npf, head: &str) {
    let k = &p.corner;
    let mut rows = vec![
        ["component", "at 1 Hz, enT/√Hz (95 %)", "white, enT/√Hz", "1/f at 1 Hz, enT/√Hz", "corner, Hz", "χ² per degree"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for c in 0..3 {
        rows.push(vec![
            COMPONENTS[c].to_owned(),
            p.density.as_ref().map_or_else(|| "not reached".to_owned(), |d| with_limits(d, c)),
            value(k.white_ent_per_root_hz[c], k.white_std_ent_per_root_hz[c]).replace('+', ""),
            if k.slow_ent_per_root_hz[c].is_finite() { format!("{:.3e}", k.slow_ent_per_root_hz[c]) } else { "-".to_owned() },
            if k.corner_hz[c].is_finite() {
                scientific_with_uncertainty(k.corner_hz[c], k.corner_std_hz[c])
            } else {
                "-".to_owned()
            },
            number(k.chi_square_per_degree[c], 2),
        ]);
    }
    let band = p.density.as_ref().map_or_else(String::new, |d| {
        format!(
            " The value at 1 Hz is the mean from {:.3} to {:.3} Hz with {:.0} degrees of freedom.",
            d.band_hz[0], d.band_hz[1], d.degrees_of_freedom
        )
    });
    let f = &p.spectrum.frequency_hz;
    let _ = writeln!(
        out,
        "{head} Noise\n\n{}\nOne-sided amplitude density by Welch's method, {} bands from {:.1e} to {:.1} Hz, lines left out.{band} White and 1/f \
         noise are a fit of `S = W + A/f`; a χ² far above 1 means that the noise has another shape.\n",
        table(&rows),
        f.len(),
        f.first().copied().unwrap_or(f64::NAN),
        f.last().copied().unwrap_or(f64::NAN),
    );
}

fn lines(out: &mut String, p: &Npf, head: &str) {
    if p.line.is_empty() {
        return;
    }
    let mut strongest: Vec<_> = p.line.iter().collect();
    strongest.sort_by(|a, b| b.power_ratio.total_cmp(&a.power_ratio));
    let mut rows = vec![["component", "frequency, Hz", "amplitude, enT", "power over noise"].map(str::to_owned).to_vec()];
    for l in strongest.iter().take(MOST_LINES) {
        rows.push(vec![
            l.component.clone(),
            format!("{:.4} ± {:.1e}", l.frequency_hz, 0.5 * l.resolution_hz),
            value(l.amplitude_ent, l.amplitude_std_ent).replace('+', ""),
            format!("{:.1}", l.power_ratio),
        ]);
    }
    let more = strongest.len().saturating_sub(MOST_LINES);
    let more = if more > 0 { format!("{more} weaker ones stand in the parameter file. ") } else { String::new() };
    let _ = writeln!(
        out,
        "{head} Lines\n\n{}\nAmplitudes are half peak to peak. {more}A line may be the alias of a frequency above half the sample rate.\n",
        table(&rows)
    );
}

fn allan(out: &mut String, p: &Npf, head: &str) {
    let a = &p.allan;
    let mut rows = vec![["τ, s", "x, enT", "y, enT", "z, enT", "limits of 95 %"].map(str::to_owned).to_vec()];
    for (i, tau) in a.tau_s.iter().enumerate() {
        let mut row = vec![format!("{tau:.4}")];
        row.extend([&a.x_ent, &a.y_ent, &a.z_ent].map(|v| format!("{:.3e}", v[i])));
        row.push(format!("× {:.3} to {:.3}", a.low_factor[i], a.high_factor[i]));
        rows.push(row);
    }
    let _ = writeln!(out, "{head} Allan deviation\n\n{}", table(&rows));
}

fn coefficients(values: &[f64; 3], std: &[f64; 3]) -> Vec<String> {
    (0..3).map(|c| value(values[c], std[c])).collect()
}

fn channels(out: &mut String, p: &Npf, head: &str) {
    if p.channel.is_empty() {
        return;
    }
    let mut rows = vec![
        ["channel", "range", "x, enT per unit", "y, enT per unit", "z, enT per unit", "correlation x, y, z"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for ChannelPart { name, unit, range, coefficient_ent, coefficient_std_ent, correlation } in &p.channel {
        let mut row = vec![name.clone(), format!("{range:.3} {unit}")];
        row.extend(coefficients(coefficient_ent, coefficient_std_ent));
        row.push(correlation.map(|r| format!("{r:+.2}")).join(", "));
        rows.push(row);
    }
    let _ = writeln!(
        out,
        "{head} What the readings follow\n\n{}\nEach channel alone, standard uncertainties with slow noise included. Channels that run alike cannot be \
         told apart this way.\n",
        table(&rows)
    );
    if let Some(t) = &p.together {
        let mut rows = vec![["channel", "x, enT per unit", "y, enT per unit", "z, enT per unit"].map(str::to_owned).to_vec()];
        for (i, name) in t.channels.iter().enumerate() {
            let mut row = vec![name.clone()];
            row.extend(coefficients(&t.coefficient_ent[i], &t.coefficient_std_ent[i]));
            rows.push(row);
        }
        let left = t.residual_std_ent.map(|v| format!("{v:.4}")).join(", ");
        let _ =
            writeln!(out, "Sensor temperature and variometer in one fit, which leaves {left} enT (x, y, z):\n\n{}", table(&rows));
    }
}

fn stops(out: &mut String, p: &Npf, head: &str) {
    let mut rows = vec![["from, s", "until, s", "length, min", "what"].map(str::to_owned).to_vec()];
    for s in &p.stop {
        rows.push(vec![
            format!("{:.1}", s.from_s),
            format!("{:.1}", s.until_s),
            format!("{:.1}", (s.until_s - s.from_s) / 60.0),
            s.what.clone(),
        ]);
    }
    let body =
        if p.stop.is_empty() { "The data run from the begin to the end of the setting.\n".to_owned() } else { table(&rows) };
    let _ = writeln!(out, "{head} Stops of the data\n\n{body}");
}

/// The result in one line.
#[must_use]
pub fn headline(null: &Null) -> String {
    let p = &null.parameters;
    let drift = p.offset.drift_ent_per_h.first().zip(p.offset.drift_std_ent_per_h.first());
    let density = p.density.as_ref().map_or_else(String::new, |d| {
        format!(", {} enT/√Hz at 1 Hz", triple(&d.ent_per_root_hz, &d.std_ent_per_root_hz).replace('+', ""))
    });
    format!("drift {} enT/h{density}", drift.map_or_else(|| "not fitted".to_owned(), |(v, s)| triple(v, s)))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(null: &Null) -> String {
    let p = &null.parameters;
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
pub fn parameter_table(runs: &[&Null]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    super::head_columns(&mut table, runs.iter().map(|o| &o.parameters.run));
    let numbers = |get: &dyn Fn(&Npf) -> f64| Values::Numbers(runs.iter().map(|o| get(&o.parameters)).collect());
    let first = |list: &[[f64; 3]], i: usize| list.first().map_or(f64::NAN, |v| v[i]);
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("mean_{axis}_ent"), numbers(&|p| p.offset.mean_ent[i]));
        table.push(&format!("mean_{axis}_std_ent"), numbers(&|p| p.offset.mean_std_ent[i]));
        table.push(&format!("drift_{axis}_ent_per_h"), numbers(&|p| first(&p.offset.drift_ent_per_h, i)));
        table.push(&format!("drift_{axis}_std_ent_per_h"), numbers(&|p| first(&p.offset.drift_std_ent_per_h, i)));
        let density = |p: &Npf, get: fn(&DensityPart) -> &[f64; 3]| p.density.as_ref().map_or(f64::NAN, |d| get(d)[i]);
        table.push(&format!("density_1hz_{axis}_ent"), numbers(&|p| density(p, |d| &d.ent_per_root_hz)));
        table.push(&format!("density_1hz_{axis}_std_ent"), numbers(&|p| density(p, |d| &d.std_ent_per_root_hz)));
        table.push(&format!("corner_{axis}_hz"), numbers(&|p| p.corner.corner_hz[i]));
    }
    table
}
