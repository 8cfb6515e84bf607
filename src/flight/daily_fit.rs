//! The daily offset model from calm minutes: a polynomial of the field over the sensor temperature (RO-IGEP-TR0028 section 4.2.3.3).
//!
//! The field of a calm time changes slowly by itself. A polynomial is therefore weighed against slow noise of every kind: a higher order is
//! taken if its information criterion, with the noise that a lower order leaves, is smaller by [`CLEAR`], and if it foretells hours that
//! had no part in the fit better than every lower order does. Coefficients and covariance are averaged over the noise that the
//! residuals allow.

use super::calm::CalmRow;
use crate::data::time::SECOND_NS;
use crate::fit::choice::aicc;
use crate::fit::noise::NoiseModel;
use crate::fit::noise::state_space::{Correlations, Noise, Rows};
use crate::model::polynomial::{TemperaturePolynomial, powers_of_line};
use nalgebra::{DMatrix, DVector};
use thiserror::Error;

/// A higher order lowers the information criterion by so much at least: odds of twenty to one.
pub const CLEAR: f64 = 6.0;
/// Parameters of the noise of a component: variance, share and exponent of slow noise.
const NOISE_PARAMETERS: usize = 3;
/// An hour, ns.
const HOUR_NS: i64 = 3600 * SECOND_NS;
/// Hours that a comparison with hours that were left out needs.
const LEAST_HOURS: usize = 3;
/// Temperatures that differ by less do not determine a slope, K.
const LEAST_RANGE_K: f64 = 0.01;

/// Why there is no model.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DailyError {
    /// Too few minutes.
    #[error("there are {0} calm minutes, and ten are needed")]
    TooFew(usize),
    /// The noise of the rows has no estimate.
    #[error("the calm minutes do not tell their noise: they are all alike")]
    NoNoise,
}

impl DailyError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        "state calm times with --calm, or do without a model on this day"
    }
}

/// The model of a day.
#[derive(Clone, Debug, PartialEq)]
pub struct DailyFit {
    /// nT over °C, axes of the sensor.
    pub polynomials: [TemperaturePolynomial; 3],
    /// Share of the squares of hours without part in the fit that the temperature explains, 0 for order 0; `None` with fewer than three hours.
    pub explained: [Option<f64>; 3],
    /// What is left about the polynomials, nT rms.
    pub residual_nt: [f64; 3],
    /// A higher order than the one chosen lowered the information criterion a little, or did not hold in hours without part in the fit.
    pub refused: [bool; 3],
}

/// Mapped temperatures of the rows, and what maps them.
struct Mapped {
    u: Vec<f64>,
    centre_degc: f64,
    half_k: f64,
}

impl Mapped {
    fn of(rows: &[CalmRow]) -> Self {
        let low = rows.iter().map(|r| r.degc).fold(f64::INFINITY, f64::min);
        let high = rows.iter().map(|r| r.degc).fold(f64::NEG_INFINITY, f64::max);
        let (centre_degc, half_k) = (0.5 * (low + high), (0.5 * (high - low)).max(LEAST_RANGE_K / 2.0));
        Self { u: rows.iter().map(|r| (r.degc - centre_degc) / half_k).collect(), centre_degc, half_k }
    }

    fn design(&self, order: usize) -> DMatrix<f64> {
        DMatrix::from_fn(self.u.len(), order + 1, |row, k| self.u[row].powi(k as i32))
    }
}

/// Generalised least squares of a component: coefficients and covariance.
fn solve(noise: &Noise, component: usize, design: &DMatrix<f64>, y: &DVector<f64>) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let count = design.ncols();
    let mut columns = design.clone().insert_column(count, 0.0);
    columns.set_column(count, y);
    noise.whiten(component, &mut columns);
    let (x, y) = (columns.columns(0, count), columns.column(count));
    let inverse = (x.transpose() * x).try_inverse()?;
    let coefficients = &inverse * x.transpose() * y;
    coefficients.iter().all(|c| c.is_finite()).then_some((coefficients, inverse))
}

/// Some rows with their noise.
struct Data {
    readings: DMatrix<f64>,
    correlations: Correlations,
}

impl Data {
    fn of(rows: &[&CalmRow]) -> Self {
        let begin = rows[0].from;
        let mean = rows.iter().map(|r| 1.0 / r.vectors as f64).sum::<f64>() / rows.len() as f64;
        let correlations = Correlations::new(Rows {
            t_s: rows.iter().map(|r| (r.from - begin) as f64 / SECOND_NS as f64).collect(),
            white: rows.iter().map(|r| [1.0 / r.vectors as f64 / mean; 3]).collect(),
            field: vec![[0.0; 3]; rows.len()],
            inside: None,
        });
        Self { readings: DMatrix::from_fn(rows.len(), 3, |row, c| rows[row].field_nt[c]), correlations }
    }

    fn component(&self, c: usize) -> DVector<f64> {
        self.readings.column(c).into_owned()
    }
}

/// Fits the model of a day to its calm minutes, in the order of their times.
///
/// # Errors
/// Too few minutes, or minutes without any scatter.
pub fn fit(rows: &[CalmRow], most_order: usize) -> Result<DailyFit, DailyError> {
    if rows.len() < 10 {
        return Err(DailyError::TooFew(rows.len()));
    }
    if (0..3).any(|c| rows.iter().all(|row| row.field_nt[c] == rows[0].field_nt[c])) {
        return Err(DailyError::NoNoise);
    }
    let mapped = Mapped::of(rows);
    let most_order = if mapped.half_k * 2.0 > LEAST_RANGE_K { most_order } else { 0 };
    let data = Data::of(&rows.iter().collect::<Vec<_>>());
    let designs: Vec<DMatrix<f64>> = (0..=most_order).map(|order| mapped.design(order)).collect();
    let of_order =
        |design: &DMatrix<f64>| data.correlations.estimate(&data.readings, &[design.clone(), design.clone(), design.clone()]);
    let noises: Vec<Option<Noise>> = designs.iter().map(of_order).collect();
    if noises[0].is_none() {
        return Err(DailyError::NoNoise);
    }
    let held_out = held_out(rows, &mapped, &noises);
    let mut refused = [false; 3];
    let chosen: [usize; 3] = std::array::from_fn(|c| {
        let y = data.component(c);
        let mut best = 0;
        for order in 1..designs.len() {
            // Both are weighed with the noise of the lower order: noise that is estimated anew for every order lets slow noise pass for a
            // polynomial of a temperature that changes as slowly.
            let Some(noise) = &noises[best] else { continue };
            let criterion = |order: usize| -> Option<f64> {
                let (coefficients, _) = solve(noise, c, &designs[order], &y)?;
                let left = &y - &designs[order] * coefficients;
                aicc(-2.0 * noise.log_likelihood(c, left.as_slice()), order + 1 + NOISE_PARAMETERS, rows.len())
            };
            let (Some(lower), Some(higher)) = (criterion(best), criterion(order)) else { continue };
            let foretells = held_out.as_ref().is_none_or(|squares| (0..order).all(|low| squares[order][c] < squares[low][c]));
            if higher < lower - CLEAR && foretells {
                (best, refused[c]) = (order, false);
            } else {
                refused[c] |= higher < lower;
            }
        }
        best
    });
    let own = chosen.map(|order| designs[order].clone());
    let noise = noises[chosen.into_iter().max().unwrap_or(0)].as_ref().ok_or(DailyError::NoNoise)?;
    let plausible = data.correlations.plausible(&noise.parameters, &data.readings, &own);
    let range = [mapped.centre_degc - mapped.half_k, mapped.centre_degc + mapped.half_k];
    let mut residual_nt = [0.0; 3];
    let mut polynomials = Vec::with_capacity(3);
    for c in 0..3 {
        let y = data.component(c);
        let (coefficients, covariance) = averaged(&plausible, c, &own[c], &y).ok_or(DailyError::NoNoise)?;
        residual_nt[c] = (&y - &own[c] * &coefficients).norm() / (rows.len() as f64).sqrt();
        let map = powers_of_line(own[c].ncols(), -mapped.centre_degc / mapped.half_k, 1.0 / mapped.half_k);
        polynomials.push(TemperaturePolynomial {
            coefficients: (&map * coefficients).as_slice().to_vec(),
            covariance: &map * covariance * map.transpose(),
            valid_degc: range,
        });
    }
    let explained = std::array::from_fn(|c| held_out.as_ref().map(|squares| 1.0 - squares[chosen[c]][c] / squares[0][c]));
    let polynomials: [TemperaturePolynomial; 3] = polynomials.try_into().map_err(|_| DailyError::NoNoise)?;
    Ok(DailyFit { polynomials, explained, residual_nt, refused })
}

/// Coefficients and covariance over the noise that the residuals allow: the mean, and the scatter of the means besides.
fn averaged(
    plausible: &[(Noise, f64)],
    c: usize,
    design: &DMatrix<f64>,
    y: &DVector<f64>,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let solved: Vec<(f64, DVector<f64>, DMatrix<f64>)> = plausible
        .iter()
        .filter_map(|(noise, ln)| solve(noise, c, design, y).map(|(b, covariance)| (ln.exp(), b, covariance)))
        .collect();
    let sum: f64 = solved.iter().map(|s| s.0).sum();
    if sum.is_nan() || sum <= 0.0 {
        return None;
    }
    let count = design.ncols();
    let mean = solved.iter().fold(DVector::zeros(count), |all, (p, b, _)| all + b * (p / sum));
    let covariance = solved.iter().fold(DMatrix::zeros(count, count), |all, (p, b, own)| {
        let apart = b - &mean;
        all + (own + &apart * apart.transpose()) * (p / sum)
    });
    Some((mean, covariance))
}

/// Squares of what every order foretells of hours without part in its fit, order by order and component by component; `None` with too
/// few hours.
fn held_out(rows: &[CalmRow], mapped: &Mapped, noises: &[Option<Noise>]) -> Option<Vec<[f64; 3]>> {
    let hour = |row: &CalmRow| row.from.div_euclid(HOUR_NS);
    let hours: Vec<i64> = rows.chunk_by(|a, b| hour(a) == hour(b)).map(|list| hour(&list[0])).collect();
    if hours.len() < LEAST_HOURS {
        return None;
    }
    let mut squares = vec![[0.0; 3]; noises.len()];
    for left_out in hours {
        let (own, other): (Vec<usize>, Vec<usize>) = (0..rows.len()).partition(|i| hour(&rows[*i]) == left_out);
        let rest: Vec<&CalmRow> = other.iter().map(|i| &rows[*i]).collect();
        if rest.len() <= noises.len() {
            return None;
        }
        let data = Data::of(&rest);
        for (order, noise) in noises.iter().enumerate() {
            let design = mapped.design(order);
            let part = design.select_rows(&other);
            let with = noise.as_ref().and_then(|n| {
                data.correlations.with_parameters(n.parameters, &data.readings, &[part.clone(), part.clone(), part.clone()])
            });
            for c in 0..3 {
                let foretold = with.as_ref().and_then(|n| solve(n, c, &part, &data.component(c)));
                squares[order][c] += match foretold {
                    Some((b, _)) => {
                        let values = design.select_rows(&own) * b;
                        own.iter().zip(values.iter()).map(|(i, v)| (rows[*i].field_nt[c] - v).powi(2)).sum::<f64>()
                    }
                    None => f64::INFINITY,
                };
            }
        }
    }
    Some(squares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;
    use crate::flight::calm::ROW_NS;

    /// Minutes of some hours with a sine of the temperature of 5 K, noise of 0.01 nT and a slow field of `slow_nt` of every time constant.
    fn minutes(seed: u64, count: usize, slow_nt: f64, offset: impl Fn(f64) -> f64) -> Vec<CalmRow> {
        let mut random = Random::seeded(seed);
        let taus: Vec<f64> = (0..5).map(|i| 2.0 * 4.0_f64.powi(i)).collect();
        let mut states: Vec<[f64; 3]> = taus.iter().map(|_| std::array::from_fn(|_| random.gaussian())).collect();
        (0..count)
            .map(|i| {
                for (state, tau) in states.iter_mut().zip(&taus) {
                    let keep = (-1.0 / tau).exp();
                    state.iter_mut().for_each(|s| *s = *s * keep + (1.0 - keep * keep).sqrt() * random.gaussian());
                }
                let degc = -40.0 + 5.0 * (i as f64 / 55.0).sin();
                let slow = |c: usize| slow_nt * states.iter().map(|s| s[c]).sum::<f64>();
                CalmRow {
                    from: i as i64 * ROW_NS,
                    to: (i as i64 + 1) * ROW_NS,
                    field_nt: std::array::from_fn(|c| offset(degc) * [1.0, 0.0, -1.0][c] + slow(c) + 0.01 * random.gaussian()),
                    degc,
                    vectors: 1200,
                }
            })
            .collect()
    }

    #[test]
    fn a_real_dependence_comes_back_within_its_uncertainty_and_none_is_made_up() {
        let truth = |t: f64| 1.5 + 0.05 * t + 8e-3 * t * t;
        let (mut inside, mut all, mut made_up, mut squares) = (0, 0, 0, 0.0_f64);
        for seed in 0..10 {
            let found = fit(&minutes(seed, 300, 0.02, truth), 3).unwrap();
            made_up += usize::from(found.polynomials[1].order() > 0);
            for (c, sign) in [(0, 1.0), (2, -1.0)] {
                assert!(found.polynomials[c].order() >= 2, "seed {seed}: {:?}", found.polynomials[c]);
                assert!(found.explained[c].is_some_and(|share| share > 0.9), "{:?}", found.explained);
                for degc in [-44.0, -40.0, -36.5] {
                    let (value, std) = found.polynomials[c].evaluate(degc);
                    let pull = (value - sign * truth(degc)) / std;
                    squares += pull * pull;
                    inside += u32::from(pull.abs() < 1.96);
                    all += 1;
                }
            }
        }
        // Three values of one fit are not independent: 20 fits of variance one have a mean square of 1 with a scatter below 0.4.
        assert!(inside * 100 >= 85 * all, "{inside} of {all}");
        let mean_square = squares / f64::from(all);
        assert!((0.3..2.0).contains(&mean_square), "{mean_square}");
        assert!(made_up <= 1, "{made_up} of 10");
    }

    #[test]
    fn minutes_without_scatter_or_too_few_of_them_make_no_model() {
        let mut rows = minutes(1, 30, 0.0, |_| 0.0);
        assert_eq!(fit(&rows[..9], 3), Err(DailyError::TooFew(9)));
        // Half an hour holds no hours out, and its uncertainty is stated all the same.
        assert_eq!(fit(&rows, 3).unwrap().explained, [None; 3]);
        rows.iter_mut().for_each(|row| row.field_nt = [1.0, 2.0, 3.0]);
        assert_eq!(fit(&rows, 3), Err(DailyError::NoNoise));
    }
}
