//! The report of a continuous temperature sweep.

use super::document::{Cell, Section, Table, cells};
use super::{known_effects, remarks, run_line, used_file};
use crate::data::across::{AppliedLag, LagDecision};
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
    Section::new("How the sensor follows the thermistors").with(decided(sweep)).with(table).with(
        "Positive: the sensor is later than the thermistor. The table is of linear models with polynomials of one order higher; gain and \
         difference of the two forms are in twice the log likelihood. A lag is claimed if it exceeds four standard uncertainties beside \
         polynomials of one order higher than given or preferred, both where it fits best and to first order from none. It is a parameter of \
         the fit then: its uncertainty is in that of all coefficients.",
    )
}

/// The lag that the temperatures have, and how that was decided.
fn decided(sweep: &Sweep) -> String {
    let (channel, lag) = (&sweep.channel, &sweep.lag);
    let is = format!("The temperatures are those of {channel} with the lag");
    let value = minutes(lag);
    match lag.decision {
        LagDecision::Found => format!("{is} that was found: {value}."),
        LagDecision::Given => format!("{is} that was given: {value}. It is taken as exact."),
        LagDecision::OfTheModel => format!("{is} of the model file: {value}. It is taken as exact."),
        LagDecision::NoneClaimed => format!("No lag is claimed: the temperatures are those of {channel}."),
        LagDecision::NotLookedFor => format!("The temperatures are those of {channel}: no lag was to be taken."),
    }
}

/// A lag as people read it, `time constant 8.00 ± 0.04 min` for example.
fn minutes(lag: &AppliedLag) -> String {
    let value = match lag.std_s {
        Some(std_s) => with_uncertainty(lag.lag_s / 60.0, std_s / 60.0),
        None => format!("{:.3}", lag.lag_s / 60.0),
    };
    match lag.form.as_str() {
        "delay" => format!("delay {value} min"),
        "first order" => format!("time constant {value} min"),
        _ => format!("time constant {value} min of the thermistor behind the sensor"),
    }
}

fn joint_fit(sweep: &Sweep) -> Section {
    let residual: Vec<String> = sweep.residual_nt.iter().map(|r| format!("{r:.3}")).collect();
    let turned = match sweep.turning.order {
        0 => "The sensor stands still.".to_owned(),
        order => format!(
            "The sensor is turned by {}° at the highest temperature against the lowest (polynomial of order {order}).",
            with_uncertainty(sweep.turning.angle_deg, sweep.turning.std_deg)
        ),
    };
    Section::new("Joint fit of all settings").with(coefficients(sweep)).with(format!(
        "Coefficient k multiplies T^k, T in °C. {turned} Root mean square of applied field minus modelled measurement {} nT (X, Y, Z). The figures \
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

/// The result in one line.
#[must_use]
pub fn headline(sweep: &Sweep) -> String {
    let [low, high] = sweep.valid_degc;
    let lag = match sweep.lag.decision {
        LagDecision::Found => minutes(&sweep.lag),
        LagDecision::Given => format!("{} as given", minutes(&sweep.lag)),
        LagDecision::OfTheModel => format!("{} of the model", minutes(&sweep.lag)),
        LagDecision::NoneClaimed => "no lag claimed".to_owned(),
        LagDecision::NotLookedFor => "no lag taken".to_owned(),
    };
    format!("{low:.1} to {high:.1} °C by {}, {lag}", sweep.channel)
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
