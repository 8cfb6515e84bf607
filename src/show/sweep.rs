//! The report of a continuous temperature sweep.

use super::{number, remarks, run_line, table, used_file};
use crate::data::units::{scientific_with_uncertainty, with_uncertainty};
use crate::files::parameter::{Body, LagForm, LagPart};
use crate::measure::sweep::Sweep;
use std::fmt::Write;

/// The blocks of the report with headings of the given level.
#[must_use]
pub fn sections(sweep: &Sweep, level: usize) -> String {
    let p = &sweep.parameters;
    let head = "#".repeat(level);
    let mut out = used_file(&sweep.run, &p.file_name(), level);
    if let Some(part) = &p.sweep {
        let _ = writeln!(
            out,
            "{} of {} settings are used, {} were left out because the temperature moved too fast. Temperatures of channel {} from {:.1} to {:.1} °C, \
             its lag included; beyond them the polynomials are extrapolations.\n",
            part.settings_used,
            part.settings_total,
            part.settings_too_fast,
            p.head.channel,
            p.head.valid_degc[0],
            p.head.valid_degc[1]
        );
        if let Some(model) = &part.model {
            let _ = writeln!(out, "{}\n", model.sentence());
        }
        let mut rows = vec![
            ["channel", "applied", "delay, min", "time constant, min", "gain", "delay over first order", "residuals, enT"]
                .map(str::to_owned)
                .to_vec(),
        ];
        for lag in &part.lag {
            let minutes = |value: f64, std: f64| with_uncertainty(value / 60.0, std / 60.0);
            rows.push(vec![
                lag.channel.clone(),
                if lag.channel == p.head.channel { lag.form.name().to_owned() } else { "not used".to_owned() },
                minutes(lag.delay_s, lag.delay_std_s),
                minutes(lag.time_constant_s, lag.time_constant_std_s),
                format!("{:.1}", lag.gain),
                format!("{:+.1}", lag.delay_over_first_order),
                number(lag.residual_std_ent, 4),
            ]);
        }
        let _ = writeln!(
            out,
            "{head} How the sensor follows the thermistors\n\n{}\nPositive: the sensor is later than the thermistor. Gain and difference of the two \
             forms are in twice the log likelihood. A lag is applied if it exceeds four standard uncertainties.\n",
            table(&rows)
        );
        let residual: Vec<String> = part.residual_nt.iter().map(|r| format!("{r:.3}")).collect();
        let _ = writeln!(
            out,
            "{head} Joint fit of all settings\n\n{}\nCoefficient k multiplies T^k, T in °C. Root mean square of applied field minus modelled measurement \
             {} nT (X, Y, Z). The figures show a sliding window of {} beside the polynomials.\n",
            coefficients(sweep),
            residual.join(", "),
            part.window
        );
    }
    out.push_str(&remarks(&p.head.warnings, level));
    out
}

fn coefficients(sweep: &Sweep) -> String {
    let most = sweep.curves.iter().map(|c| c.coefficients.len()).max().unwrap_or(0);
    let mut rows =
        vec![std::iter::once("quantity".to_owned()).chain((0..most).map(|k| format!("power {k}"))).collect::<Vec<_>>()];
    for curve in &sweep.curves {
        let covariance = sweep.parameters.head.covariance.get(&curve.name);
        let cell = |k: usize| {
            let std = covariance.and_then(|c| c.get(k)?.get(k)).map_or(f64::NAN, |v| v.sqrt());
            curve.coefficients.get(k).map_or_else(String::new, |c| scientific_with_uncertainty(*c, std))
        };
        rows.push(std::iter::once(format!("{}, {}", curve.name, curve.unit)).chain((0..most).map(cell)).collect());
    }
    table(&rows)
}

fn used_lag(sweep: &Sweep) -> Option<&LagPart> {
    let p = &sweep.parameters;
    p.sweep.as_ref()?.lag.iter().find(|l| l.channel == p.head.channel)
}

/// The result in one line.
#[must_use]
pub fn headline(sweep: &Sweep) -> String {
    let [low, high] = sweep.parameters.head.valid_degc;
    let lag = used_lag(sweep).map_or_else(String::new, |l| match l.form {
        LagForm::Delay => format!(", delay {} min", with_uncertainty(l.delay_s / 60.0, l.delay_std_s / 60.0)),
        LagForm::FirstOrder => {
            format!(", time constant {} min", with_uncertainty(l.time_constant_s / 60.0, l.time_constant_std_s / 60.0))
        }
        LagForm::None | LagForm::OfTheModel => ", no lag".to_owned(),
    });
    format!("{low:.1} to {high:.1} °C by {}{lag}", sweep.parameters.head.channel)
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(sweep: &Sweep) -> String {
    let p = &sweep.parameters;
    let orders: Vec<String> = p.head.quantity.iter().map(|q| format!("{} {}", q.name, q.order)).collect();
    format!("{}\n  {}\n  orders {}\n", run_line(&sweep.run), headline(sweep), orders.join(", "))
}

/// One row per window.
#[cfg(feature = "tables")]
#[must_use]
pub fn window_table(sweep: &Sweep) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    let column =
        |get: &dyn Fn(&crate::measure::sweep::WindowFit) -> f64| Values::Numbers(sweep.windows.iter().map(get).collect());
    table.push("t_s", column(&|w| w.t_s));
    table.push("temperature_degc", column(&|w| w.temperature_degc[0]));
    table.push("temperature_with_lag_degc", column(&|w| w.temperature_degc[1]));
    for (k, curve) in sweep.curves.iter().enumerate() {
        table.push(&curve.name, column(&|w| w.values[k]));
        table.push(&format!("{}_std", curve.name), column(&|w| w.std[k]));
    }
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("residual_{axis}_nt"), column(&|w| w.residual_nt[k]));
    }
    table
}

/// One row per run, for a campaign.
#[cfg(feature = "tables")]
#[must_use]
pub fn parameter_table(runs: &[&Sweep]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    super::head_columns(&mut table, runs.iter().map(|s| &s.run));
    let numbers = |get: &dyn Fn(&Sweep) -> f64| Values::Numbers(runs.iter().map(|s| get(s)).collect());
    let lag = |s: &Sweep, of: fn(&LagPart) -> f64| used_lag(s).map_or(f64::NAN, of);
    table.push("low_degc", numbers(&|s| s.parameters.head.valid_degc[0]));
    table.push("high_degc", numbers(&|s| s.parameters.head.valid_degc[1]));
    table.push("delay_s", numbers(&|s| lag(s, |l| l.delay_s)));
    table.push("delay_std_s", numbers(&|s| lag(s, |l| l.delay_std_s)));
    table.push("time_constant_s", numbers(&|s| lag(s, |l| l.time_constant_s)));
    table.push("time_constant_std_s", numbers(&|s| lag(s, |l| l.time_constant_std_s)));
    table
}
