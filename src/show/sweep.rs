//! The report of a continuous temperature sweep.

use super::document::{Cell, Section, Table, cells};
use super::{known_effects, remarks, run_line, used_file};
use crate::data::across::{LagForm, ThermistorLag};
use crate::data::units::with_uncertainty;
use crate::measure::sweep::Sweep;

/// The sections of the report.
#[must_use]
pub fn sections(sweep: &Sweep, file_name: &str) -> Vec<Section> {
    let mut used = used_file(&sweep.run, file_name);
    used.push(format!(
        "{} of {} settings are used, {} were left out because the temperature moved too fast. Temperatures of channel {} from {:.1} to {:.1} °C, \
         its lag included; beyond them the polynomials are extrapolations.",
        sweep.settings.used,
        sweep.settings.total,
        sweep.settings.too_fast,
        sweep.channel,
        sweep.valid_degc[0],
        sweep.valid_degc[1]
    ));
    used.blocks.extend(sweep.model.as_ref().map(|model| known_effects(model).into()));
    let mut sections = vec![used, lags(sweep), joint_fit(sweep)];
    sections.extend(remarks(&sweep.notes));
    sections
}

/// How the sensor follows each thermistor; the lag of the one that the polynomials are of is applied.
fn lags(sweep: &Sweep) -> Section {
    let mut table = Table::new([
        "channel",
        "applied",
        "delay, min",
        "time constant, min",
        "gain",
        "delay over first order",
        "residuals, enT",
    ]);
    for lag in &sweep.lags {
        let minutes = |value: f64, std: f64| Cell::uncertain(value / 60.0, std / 60.0);
        table.push(cells![
            &lag.channel,
            if lag.channel == sweep.channel { lag.form.name() } else { "not used" },
            minutes(lag.delay_s, lag.delay_std_s),
            minutes(lag.time_constant_s, lag.time_constant_std_s),
            Cell::fixed(lag.gain, 1),
            Cell::signed(lag.delay_over_first_order, 1),
            Cell::fixed(lag.residual_std_ent, 4),
        ]);
    }
    Section::new("How the sensor follows the thermistors").with(table).with(
        "Positive: the sensor is later than the thermistor. Gain and difference of the two forms are in twice the log likelihood. A lag is \
         applied if it exceeds four standard uncertainties.",
    )
}

fn joint_fit(sweep: &Sweep) -> Section {
    let residual: Vec<String> = sweep.residual_nt.iter().map(|r| format!("{r:.3}")).collect();
    Section::new("Joint fit of all settings").with(coefficients(sweep)).with(format!(
        "Coefficient k multiplies T^k, T in °C. Root mean square of applied field minus modelled measurement {} nT (X, Y, Z). The figures \
         show a sliding window of {} beside the polynomials.",
        residual.join(", "),
        sweep.window
    ))
}

fn coefficients(sweep: &Sweep) -> Table {
    let most = sweep.quantities.iter().map(|q| q.polynomial.coefficients.len()).max().unwrap_or(0);
    let mut table = Table::new(std::iter::once("quantity".to_owned()).chain((0..most).map(|k| format!("power {k}"))));
    for curve in &sweep.quantities {
        let cell = |k: usize| {
            let std = curve.polynomial.covariance.get((k, k)).map_or(f64::NAN, |v| v.sqrt());
            curve.polynomial.coefficients.get(k).map_or(Cell::Missing(""), |c| Cell::scientific(*c, std))
        };
        table.push(
            std::iter::once(format!("{}, {}", curve.found.name, curve.found.unit).into()).chain((0..most).map(cell)).collect(),
        );
    }
    table
}

fn used_lag(sweep: &Sweep) -> Option<&ThermistorLag> {
    sweep.lags.iter().find(|l| l.channel == sweep.channel)
}

/// The result in one line.
#[must_use]
pub fn headline(sweep: &Sweep) -> String {
    let [low, high] = sweep.valid_degc;
    let lag = used_lag(sweep).map_or_else(String::new, |l| match l.form {
        LagForm::Delay => format!(", delay {} min", with_uncertainty(l.delay_s / 60.0, l.delay_std_s / 60.0)),
        LagForm::FirstOrder => {
            format!(", time constant {} min", with_uncertainty(l.time_constant_s / 60.0, l.time_constant_std_s / 60.0))
        }
        LagForm::None | LagForm::OfTheModel => ", no lag".to_owned(),
    });
    format!("{low:.1} to {high:.1} °C by {}{lag}", sweep.channel)
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(sweep: &Sweep) -> String {
    let orders: Vec<String> = sweep.quantities.iter().map(|q| format!("{} {}", q.found.name, q.polynomial.order())).collect();
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
    for (k, curve) in sweep.quantities.iter().enumerate() {
        table.push(&curve.found.name, column(&|w| w.values[k]));
        table.push(&format!("{}_std", curve.found.name), column(&|w| w.std[k]));
    }
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("residual_{axis}_nt"), column(&|w| w.residual_nt[k]));
    }
    table
}
