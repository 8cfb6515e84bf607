//! Temperature from the voltage or resistance of a thermistor (RO-IGEP-TR0028 section 3.3.3).
//!
//! `T(s) = Σ c_k s^k` is fitted to a calibration table, s the voltage U of a divider, `U = U_ref / (R_ser/R + 1)`, or the resistance R.
//! The comparison with a reference thermometer gives `T_O`, the mean of polynomial minus reference: `T_c = T_r - T_O`.

mod told;

use crate::data::note::{Note, NoteKind};
use crate::data::result::Covariance;
use crate::data::tables::ThermistorRow;
use crate::data::thermistor::{
    ComparedPolynomial, FittedTableRow, HIGHEST_ORDER, ReferenceComparison, ThermistorPolynomial, TriedOrder,
};
use crate::fit::statistics::{extremes, fisher_tail};
use crate::fit::{Chosen, FitError, Limits, Polynomial, order, polynomial, student_factor};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Largest residual that is asked for where nothing else is said, °C.
pub const WITHIN_DEGC: f64 = 0.01;

/// Probability by chance below which a difference to the reference changes with temperature.
const BY_CHANCE: f64 = 0.003;

/// What the polynomial takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Signal {
    /// Voltage, V.
    #[serde(rename = "u")]
    Voltage,
    /// Resistance, Ω.
    #[serde(rename = "r")]
    Resistance,
}

impl Signal {
    /// Name in options and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Signal::Voltage => "u",
            Signal::Resistance => "r",
        }
    }

    /// Its unit.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Signal::Voltage => "V",
            Signal::Resistance => "ohm",
        }
    }
}

/// How a table is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Order; chosen by AICc and leave-one-out error if absent.
    pub order: Option<usize>,
    /// Signal; the voltage where the table has one, if absent.
    pub signal: Option<Signal>,
    /// Reference voltage, V, and series resistance, Ω, of a divider that turns resistances into voltages.
    pub divider: Option<[f64; 2]>,
    /// Coefficients of a polynomial to compare with, lowest first.
    pub compare: Option<Vec<f64>>,
    /// Largest residual asked for, °C.
    pub within_degc: f64,
    /// The sensor in which the thermistor sits.
    pub sensor: Option<String>,
}

impl Default for Options {
    fn default() -> Self {
        Self { order: None, signal: None, divider: None, compare: None, within_degc: WITHIN_DEGC, sensor: None }
    }
}

/// Why a table has no polynomial.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ThermistorError {
    /// The wanted signal is missing.
    #[error("the table holds no {0}")]
    NoSignal(&'static str),
    /// The fit has no answer.
    #[error("the polynomial cannot be fitted: {0}")]
    Fit(#[from] FitError),
}

impl ThermistorError {
    /// What to do.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            ThermistorError::NoSignal(_) => "add the column u_volt or r_ohm, or name --divider to turn resistances into voltages",
            ThermistorError::Fit(_) => "choose a lower --order, or add rows at other temperatures",
        }
    }
}

/// A polynomial with its table.
#[derive(Clone, Debug)]
pub struct Thermistor {
    /// The polynomial.
    pub polynomial: ThermistorPolynomial,
    /// Covariance of the coefficients.
    pub covariance: Covariance,
    /// A polynomial given for comparison.
    pub compared: Option<ComparedPolynomial>,
    /// Comparison with a reference thermometer.
    pub reference: Option<ReferenceComparison>,
    /// All orders that were fitted.
    pub orders: Vec<TriedOrder>,
    /// The table with its residuals.
    pub row: Vec<FittedTableRow>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// The signal of every row.
fn signals(rows: &[ThermistorRow], signal: Signal, divider: Option<[f64; 2]>) -> Result<Vec<f64>, ThermistorError> {
    let of = |row: &ThermistorRow| match (signal, divider) {
        (Signal::Resistance, _) => row.r_ohm,
        (Signal::Voltage, Some([reference_v, series_ohm])) if row.u_volt.is_nan() => reference_v / (series_ohm / row.r_ohm + 1.0),
        (Signal::Voltage, _) => row.u_volt,
    };
    let list: Vec<f64> = rows.iter().map(of).collect();
    let missing = match signal {
        Signal::Voltage => "voltages",
        Signal::Resistance => "resistances",
    };
    if list.iter().any(|s| s.is_nan()) { Err(ThermistorError::NoSignal(missing)) } else { Ok(list) }
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, f64::max)
}

fn value(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

fn leave_one_out(fit: &Polynomial, x: &[f64]) -> f64 {
    let square = |(r, x): (&f64, &f64)| (r / (1.0 - fit.evaluate_unscaled(*x).1.powi(2))).powi(2);
    (fit.residuals.iter().zip(x).map(square).sum::<f64>() / x.len() as f64).sqrt()
}

/// Covariance of the coefficients. No polynomial is a thermistor: what it leaves of the table is no noise that many rows average, and any value may
/// be off by as much, which is an uncertainty of the constant.
fn with_what_is_left(fit: &Polynomial) -> DMatrix<f64> {
    let mut covariance = fit.covariance();
    covariance[(0, 0)] += fit.residual_std.powi(2);
    covariance
}

/// Fits a table; `name` is that of the table without its end.
///
/// # Errors
/// Why it has no polynomial.
pub fn thermistor(
    name: &str,
    rows: &[ThermistorRow],
    reference: Option<&[ThermistorRow]>,
    options: &Options,
) -> Result<Thermistor, ThermistorError> {
    let has_voltage = rows.iter().all(|r| r.u_volt.is_finite()) || options.divider.is_some();
    let signal = options.signal.unwrap_or(if has_voltage { Signal::Voltage } else { Signal::Resistance });
    let x = signals(rows, signal, options.divider)?;
    let y: Vec<f64> = rows.iter().map(|r| r.t_degc).collect();
    let limits = Limits::default();

    let chosen = order::choose(&x, &y, None, order::HIGHEST_ORDER, None, &limits)?;
    let (wanted, reason) = match options.order {
        Some(order) => (order, "given".to_owned()),
        None => (chosen.order, format!("{:?}", chosen.reason)),
    };
    let fit = polynomial::fit(&x, &y, None, wanted, &limits)?;
    let orders = tried(&x, &y, wanted, &chosen);
    let mut notes: Vec<Note> = told::as_if_in_kelvin(&y, "t_degc").into_iter().collect();
    notes.extend(told::one_row(&x, &y, signal, chosen.polynomial.residual_std, options.within_degc));
    let order_within = orders.iter().find(|o| o.residual_max_degc <= options.within_degc).map(|o| o.order);
    let residual_max_degc = largest(fit.residuals.iter().copied());
    if residual_max_degc > options.within_degc {
        let reaches = order_within.map_or_else(|| "no order does".to_owned(), |o| format!("order {o} does"));
        notes.push(Note::new(
            NoteKind::Fit,
            format!(
                "the polynomial of order {wanted} leaves up to {residual_max_degc:.4} °C, more than {} °C; {reaches}",
                options.within_degc
            ),
        ));
    }
    let best = options.compare.as_ref().map(|c| polynomial::fit(&x, &y, None, c.len().saturating_sub(1), &limits)).transpose()?;
    let compared = options.compare.as_ref().zip(best.as_ref()).map(|(c, best)| compared(c, best, &x, &y));
    let reference = reference
        .map(|rows| compare_with(rows, &fit, signal, options.divider, extremes(x.iter().copied()), &mut notes))
        .transpose()?;
    let covariance = with_what_is_left(&fit);
    let row = (0..rows.len()).map(|i| FittedTableRow {
        signal: x[i],
        t_degc: y[i],
        residual_degc: fit.residuals[i],
        std_degc: fit.evaluate(x[i]).1.hypot(fit.residual_std),
        compared_residual_degc: options.compare.as_ref().map(|c| y[i] - value(c, x[i])),
        best_residual_degc: best.as_ref().map(|b| b.residuals[i]),
    });
    Ok(Thermistor {
        polynomial: ThermistorPolynomial {
            table: name.to_owned(),
            sensor: options.sensor.clone(),
            signal: signal.name().to_owned(),
            signal_unit: signal.unit().to_owned(),
            order: wanted,
            reason,
            coefficients: fit.coefficients.clone(),
            coefficients_std: (0..=wanted).map(|k| covariance[(k, k)].sqrt()).collect(),
            residual_max_degc,
            residual_std_degc: fit.residual_std,
            within_degc: options.within_degc,
            order_within,
            valid_signal: extremes(x.iter().copied()),
            valid_degc: extremes(y.iter().copied()),
        },
        covariance: Covariance {
            parameters: (0..=wanted).map(|k| format!("c_{k}")).collect(),
            units: (0..=wanted).map(|k| format!("degC/{}^{k}", signal.unit())).collect(),
            matrix: covariance.row_iter().map(|r| r.iter().copied().collect()).collect(),
        },
        compared,
        reference,
        orders,
        row: row.collect(),
        notes,
    })
}

/// The polynomials of all orders that the table determines.
fn tried(x: &[f64], y: &[f64], wanted: usize, chosen: &Chosen) -> Vec<TriedOrder> {
    let highest = HIGHEST_ORDER.max(wanted).min(x.len().saturating_sub(2));
    // Above an order that is not determined no other is better determined.
    let fits = (1..=highest).map_while(|order| Some((order, polynomial::fit(x, y, None, order, &Limits::default()).ok()?)));
    fits.map(|(order, fit)| TriedOrder {
        order,
        residual_max_degc: largest(fit.residuals.iter().copied()),
        residual_std_degc: fit.residual_std,
        leave_one_out_degc: leave_one_out(&fit, x),
        aicc: chosen.candidates.iter().find(|c| c.order == order).and_then(|c| c.aicc).filter(|a| a.is_finite()),
    })
    .collect()
}

/// A polynomial that was given, beside the best one of its order.
fn compared(given: &[f64], best: &Polynomial, x: &[f64], y: &[f64]) -> ComparedPolynomial {
    let residuals: Vec<f64> = x.iter().zip(y).map(|(x, y)| y - value(given, *x)).collect();
    ComparedPolynomial {
        coefficients: given.to_vec(),
        residual_max_degc: largest(residuals.iter().copied()),
        residual_rms_degc: (residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64).sqrt(),
        best_max_degc: largest(best.residuals.iter().copied()),
        difference_max_degc: largest(residuals.iter().zip(&best.residuals).map(|(a, b)| a - b)),
    }
}

/// T_O from readings beside a reference thermometer.
fn compare_with(
    rows: &[ThermistorRow],
    fit: &Polynomial,
    signal: Signal,
    divider: Option<[f64; 2]>,
    valid: [f64; 2],
    notes: &mut Vec<Note>,
) -> Result<ReferenceComparison, ThermistorError> {
    let x = signals(rows, signal, divider)?;
    let outside = x.iter().filter(|x| **x < valid[0] || **x > valid[1]).count();
    if outside > 0 {
        notes.push(Note::new(NoteKind::Data, format!("{outside} readings beside the reference lie outside the table")));
    }
    let t: Vec<f64> = rows.iter().map(|r| r.t_degc).collect();
    notes.extend(told::as_if_in_kelvin(&t, "reference_degc"));
    let difference: Vec<f64> = x.iter().zip(&t).map(|(x, t)| fit.evaluate(*x).0 - t).collect();
    let mean = polynomial::fit(&t, &difference, None, 0, &Limits::default())?;
    let slope = polynomial::fit(&t, &difference, None, 1, &Limits::default()).ok().filter(|s| s.dof > 0);
    let slope_std = slope.as_ref().map(|s| s.covariance()[(1, 1)].sqrt());
    if let (Some(s), Some(std)) = (&slope, slope_std)
        && fisher_tail((s.coefficients[1] / std).powi(2), [1.0, s.dof as f64]) < BY_CHANCE
    {
        notes.push(Note::new(
            NoteKind::Method,
            format!("the difference to the reference changes by {:+.2e} K per K: T_O is no constant", s.coefficients[1]),
        ));
    }
    let low = t.iter().copied().fold(f64::INFINITY, f64::min);
    let high = t.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let of_parts = of_parts(&difference);
    if of_parts.is_some() {
        notes.push(Note::new(
            NoteKind::Method,
            "the differences to the reference follow each other slowly from row to row: the uncertainty of T_O is that of four parts of the rows, and \
             what is slower than all of them is not in it",
        ));
    }
    let offset_std_degc = Some(of_parts.unwrap_or(mean.covariance()[(0, 0)].sqrt())).filter(|s| s.is_finite());
    if offset_std_degc.is_none() {
        notes.push(Note::new(NoteKind::Method, "T_O rests on a single reading, so its uncertainty is not known"));
    }
    Ok(ReferenceComparison {
        offset_degc: mean.coefficients[0],
        offset_std_degc,
        readings: rows.len(),
        range_degc: [low, high],
        slope: slope.as_ref().map(|s| s.coefficients[1]),
        slope_std,
    })
}

/// Parts of the rows whose means are independent of each other, or nearly so, where neighbouring rows are not.
const PARTS: usize = 4;
/// Standard deviations of von Neumann's ratio, by which rows that follow each other are more alike than chance makes them.
const ALIKE: f64 = 3.0;

/// Standard uncertainty of the mean of values in the order of their rows, from the means of parts of them, with Student's factor; `None` where
/// neighbouring values differ as much as any others (von Neumann, Ann. Math. Statist. 12, 367, 1941).
fn of_parts(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    if values.len() < 2 * PARTS {
        return None;
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let middle = mean(values);
    let squares: f64 = values.iter().map(|v| (v - middle).powi(2)).sum();
    let successive: f64 = values.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let ratio = successive / squares;
    let std = 2.0 * ((n - 2.0) / (n * n - 1.0)).sqrt();
    if ratio.is_nan() || 2.0 - ratio < ALIKE * std {
        return None;
    }
    let edge = |part: usize| part * values.len() / PARTS;
    let parts: Vec<f64> = (0..PARTS).map(|part| mean(&values[edge(part)..edge(part + 1)])).collect();
    let of_parts: f64 = parts.iter().map(|part| (part - middle).powi(2)).sum::<f64>() / (PARTS * (PARTS - 1)) as f64;
    Some(of_parts.sqrt() * student_factor(PARTS - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings beside a reference with noise that lasts over 60 of 600 rows, white noise, and a drift: 1.96 standard uncertainties of the mean
    /// hold the truth in 95 %, which 300 draws tell to 1.3 %.
    #[test]
    fn the_mean_of_rows_that_follow_each_other_is_no_better_than_its_parts() {
        let mut random = crate::fit::random::Random::seeded(3);
        let mut share = |slow: f64, white: f64| {
            let held = (0..300).filter(|_| {
                let (mut state, keep) = (random.gaussian(), (-1.0_f64 / 60.0).exp());
                let values: Vec<f64> = (0..600)
                    .map(|_| {
                        state = keep * state + (1.0 - keep * keep).sqrt() * random.gaussian();
                        slow * state + white * random.gaussian()
                    })
                    .collect();
                let mean = values.iter().sum::<f64>() / 600.0;
                let of_rows = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 599.0 / 600.0).sqrt();
                mean.abs() < 1.96 * of_parts(&values).unwrap_or(of_rows)
            });
            held.count() as f64 / 300.0
        };
        for (slow, white) in [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            let share = share(slow, white);
            assert!((0.90..0.995).contains(&share), "{slow} {white}: {share}");
        }
        let drift: Vec<f64> = (0..600).map(|i| f64::from(i) / 600.0).collect();
        assert!(of_parts(&drift).is_some_and(|std| std > 0.1));
        assert!(of_parts(&[1.0; 20]).is_none());
    }

    const PRINTED: [f64; 4] = [-368.61072, 458.49304, -356.02890, 180.00644];

    fn pt1000() -> Vec<ThermistorRow> {
        let text = include_str!("../../tests/data/rosetta/pt1000_table.csv");
        let row = |line: &str| {
            let v: Vec<f64> = line.split(',').map(|c| c.parse().unwrap()).collect();
            ThermistorRow { t_degc: v[0], r_ohm: v[1], u_volt: v[2] }
        };
        text.lines().skip(1).map(row).collect()
    }

    fn options() -> Options {
        Options { order: None, signal: None, divider: None, compare: None, within_degc: 0.01, sensor: None }
    }

    fn row(t_degc: f64, u_volt: f64) -> ThermistorRow {
        ThermistorRow { t_degc, u_volt, r_ohm: f64::NAN }
    }

    #[test]
    fn the_printed_cubic_leaves_what_the_best_cubic_leaves_and_order_five_a_hundredth() {
        let options = Options { compare: Some(PRINTED.to_vec()), ..options() };
        let p = thermistor("pt1000", &pt1000(), None, &options).unwrap();
        // By numpy.polynomial.Polynomial.fit.
        let best = [28.374_304_949, 4.096_588_018, 0.626_568_800_5, 0.094_811_463_53, 0.009_727_525_67, 0.002_814_997_52];
        for (part, best) in p.orders.iter().zip(best) {
            assert!((part.residual_max_degc / best - 1.0).abs() < 1e-5, "{part:?} {best}");
        }
        assert!((p.orders[2].residual_std_degc - 0.303_384_947).abs() < 1e-8);
        let compared = p.compared.unwrap();
        assert!((compared.residual_max_degc - 0.626_556_366_9).abs() < 1e-9);
        assert!(compared.difference_max_degc < 1e-3, "the printed cubic is the best one");
        assert_eq!((p.polynomial.order_within, p.polynomial.order), (Some(5), 5));
    }

    /// The table of a platinum resistor has no noise but its last digit: what a polynomial of it is off by is what the order leaves out, and
    /// 19 of 20 rows are within 1.96 of the standard uncertainties that are stated.
    #[test]
    fn what_an_order_leaves_out_is_in_the_uncertainty_of_its_values() {
        for order in [1, 2, 3, 4, 5] {
            let p = thermistor("pt1000", &pt1000(), None, &Options { order: Some(order), ..options() }).unwrap();
            let held = p.row.iter().filter(|row| row.residual_degc.abs() < 1.96 * row.std_degc).count();
            assert!(held as f64 >= 0.9 * p.row.len() as f64, "order {order}: {held} of {}", p.row.len());
            // As of the covariance of the file.
            let row = &p.row[3];
            let powers = DMatrix::from_fn(order + 1, 1, |k, _| row.signal.powi(k as i32));
            let matrix = DMatrix::from_fn(order + 1, order + 1, |r, c| p.covariance.matrix[r][c]);
            let std = (powers.transpose() * matrix * &powers)[(0, 0)].sqrt();
            assert!((std / row.std_degc - 1.0).abs() < 1e-3, "order {order}: {std} {}", row.std_degc);
        }
    }

    #[test]
    fn voltages_follow_from_resistances() {
        let divided: Vec<ThermistorRow> = pt1000().iter().map(|r| ThermistorRow { u_volt: f64::NAN, ..*r }).collect();
        let options = Options { divider: Some([2.5, 1000.0]), order: Some(3), ..options() };
        let p = thermistor("pt1000", &divided, None, &options).unwrap();
        // The table rounds its voltages to 1e-5 V.
        for (k, (c, printed)) in p.polynomial.coefficients.iter().zip(PRINTED).enumerate() {
            assert!((c - printed).abs() < 0.2, "{k} {c} {printed}");
        }
        let refused = thermistor("t", &divided, None, &Options { signal: Some(Signal::Voltage), ..self::options() }).unwrap_err();
        assert_eq!(refused, ThermistorError::NoSignal("voltages"));
        let resistance = thermistor("t", &divided, None, &self::options()).unwrap();
        assert_eq!(resistance.polynomial.signal, "r");
    }

    #[test]
    fn the_reference_gives_the_offset() {
        // T = 10 + 20 U; readings whose polynomial is 1.4, 1.5, 1.6 below the reference: mean -1.5, s 0.1, of the mean 0.1/√3.
        let table: Vec<ThermistorRow> = (0..6).map(|i| row(10.0 + 20.0 * f64::from(i), f64::from(i))).collect();
        let reference = [row(31.4, 1.0), row(51.6, 2.0), row(71.5, 3.0)];
        let options = Options { order: Some(1), ..options() };
        let p = thermistor("t", &table, Some(&reference), &options).unwrap();
        assert!((p.polynomial.coefficients[0] - 10.0).abs() < 1e-12 && (p.polynomial.coefficients[1] - 20.0).abs() < 1e-12);
        let r = p.reference.unwrap();
        assert!((r.offset_degc + 1.5).abs() < 1e-12);
        assert!((r.offset_std_degc.unwrap() - 0.1 / 3f64.sqrt()).abs() < 1e-12);
        let single = thermistor("t", &table, Some(&reference[..1]), &options).unwrap();
        assert!(single.reference.unwrap().offset_std_degc.is_none());
        assert!(single.notes.iter().any(|n| n.text.contains("single reading")));
    }

    /// A resistance of 1010 in place of 1000 ohm is worth 2.56 °C at 3.9083 ohm/°C: its row is named, and no row of the table itself, of one that scatters
    /// by 0.02 °C, or of a thermistor that no polynomial describes.
    #[test]
    fn a_row_with_a_slip_is_named() {
        let platinum = |t: f64| 1000.0 * (1.0 + 3.9083e-3 * t - 5.775e-7 * t * t);
        let table = |noise_degc: f64, seed: u64| -> Vec<ThermistorRow> {
            let mut random = crate::fit::random::Random::seeded(seed);
            let degc = |i: i32| -40.0 + 10.0 * f64::from(i);
            (0..13)
                .map(|i| ThermistorRow { r_ohm: platinum(degc(i)), ..row(degc(i) + noise_degc * random.gaussian(), f64::NAN) })
                .collect()
        };
        let told = |rows: &[ThermistorRow]| -> Vec<String> {
            let notes = thermistor("t", rows, None, &options()).unwrap().notes;
            notes.into_iter().filter(|n| n.kind == NoteKind::Data).map(|n| n.text).collect()
        };
        for (noise_degc, seed) in [(0.0, 0), (0.002, 1), (0.02, 2), (0.02, 3), (0.02, 4), (0.02, 5)] {
            let mut rows = table(noise_degc, seed);
            assert_eq!(told(&rows), Vec::<String>::new());
            rows[4].r_ohm += 10.0;
            let told = told(&rows);
            assert!(told.len() == 1 && told[0].starts_with("row 5 of the table"), "{noise_degc}: {told:?}");
        }
        let ntc: Vec<ThermistorRow> = (0..13)
            .map(|i| {
                let degc = -40.0 + 10.0 * f64::from(i);
                let r_ohm = 1e4 * (3900.0 * (1.0 / (degc + 273.15) - 1.0 / 298.15)).exp();
                row(degc, 5.0 / (1e4 / r_ohm + 1.0))
            })
            .collect();
        assert_eq!(told(&ntc), Vec::<String>::new());
        assert_eq!(told(&pt1000()), Vec::<String>::new());
        let kelvin: Vec<ThermistorRow> =
            table(0.0, 0).iter().map(|r| ThermistorRow { t_degc: r.t_degc + 273.15, ..*r }).collect();
        let told = told(&kelvin);
        assert!(told.len() == 1 && told[0].contains("as if in kelvin: -40.0 to 80.0 °C"), "{told:?}");
    }

    #[test]
    fn too_high_an_order_is_refused() {
        let table: Vec<ThermistorRow> = (0..3).map(|i| row(f64::from(i), f64::from(i))).collect();
        let error = thermistor("t", &table, None, &Options { order: Some(4), ..options() }).unwrap_err();
        assert!(error.to_string().contains("cannot be fitted"), "{error}");
    }
}
