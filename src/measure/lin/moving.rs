//! A run during which the temperature of the sensor moves: its readings referred to one temperature, so that one response describes all
//! of them (docs/mathematics.md, "Temperature").
//!
//! `B_r = S(T) W B_c + B_or(T, t)` with `S = σ⁻¹ Qᵀ(ξ)` the response in the sensor frame and `W = ρᵀ R_nomᵀ`, which stays: the sensor is
//! taken as not turning in its mount during the run. What is subtracted from a mean reading is `(S(T) - S(T_0)) W B_c` and what the offset
//! follows of the temperature. Either polynomials of the sensor tell S(T), or it is found with everything else.

mod found;

use super::fit::{Fitted, Means, fit, stack};
use super::prepare::Prepared;
use super::refusal::LinError;
use crate::data::calibration::{SlopeSource, SlopeStd, TemperatureSlopes};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::result::AT_REST_K;
use crate::data::run::mean_over;
use crate::fit::noise::dense::GroupNoise;
use crate::fit::smooth::Course;
use crate::fit::statistics::{extremes, slope};
use crate::fit::{DenseNoise, FitError};
use crate::model::campaign::SlopeBounds;
use crate::model::sensor::{Split, SplitError, split};
use crate::model::sensor_polynomials::{SensorChange, SensorPolynomials, change_at, response};
use crate::record::carried;
use crate::record::conditions::{self, Temperatures, Within};
use found::{Found, observe};
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};

/// Times that the readings are referred to one temperature with what the last fit found; each brings the next two digits and more.
const MOST_ROUNDS: usize = 60;
/// They end when no reading changes by more than this part of the largest.
const SETTLED: f64 = 1e-13;
/// Probability that noise alone makes a curvature as large as one that is taken.
const CURVED: f64 = 1e-3;
/// The highest order in the temperature that a run by itself is asked for.
const MOST_ORDER: usize = 2;

/// A run at rest tells that its slopes are not known where that makes an uncertainty so many times as large.
const WIDENED: f64 = 1.2;

/// Number of parameters of the response: three sensitivities, three angles, three turns.
const PARAMETERS: usize = 9;

/// Where the change of sensitivities and angles with temperature comes from.
pub(super) enum Origin<'a> {
    /// From polynomials of the sensor.
    Polynomials(&'a SensorPolynomials),
    /// From the run itself, up to this order in the temperature, or as the run needs it.
    Run {
        /// The order that the campaign gives the polynomials of the sensor.
        order: Option<usize>,
        /// How large the slopes can be.
        bounds: SlopeBounds,
    },
    /// From a run whose sensor counts as being at rest, as far as slopes are not larger than stated, or else than published ones.
    Rest(SlopeBounds),
}

/// How large slopes can be, and what a file calls that.
struct Held {
    bounds: SlopeBounds,
    source: SlopeSource,
}

impl Held {
    /// By nothing but what is stated.
    fn stated(bounds: SlopeBounds) -> Self {
        Self { bounds, source: if bounds.is_stated() { SlopeSource::Bound } else { SlopeSource::Run } }
    }
}

/// Temperatures of the plateaus of a run whose sensor is not at rest.
pub(super) struct Moving {
    /// Temperature at which the parameters hold, °C.
    at_degc: f64,
    /// Temperatures of all plateaus over it, K.
    pub over_k: Vec<f64>,
    /// Standard uncertainty of their mean by the noise of the thermometer, K.
    std_k: f64,
    /// The smooth course of the temperature.
    course: Course,
    /// Whether the temperatures of the used plateaus differ by more than at rest, or scatter by more than in any of the courses that the noise of
    /// the thermometer alone makes.
    pub is_shown: bool,
    /// Lowest and highest temperature of the used plateaus, °C.
    pub range_degc: [f64; 2],
    /// Straight line through the temperatures of the used plateaus, K/h.
    pub rate_k_per_h: f64,
}

impl Moving {
    /// Of the plateaus of a run; `None` without a temperature.
    pub fn of(list: &[Plateau], temperatures: &Temperatures, span_s: [f64; 2]) -> Option<Self> {
        let [_, at_degc, _] = temperatures.sensor_degc()?;
        let course = Course::smooth(&temperatures.sensor);
        let over_k: Vec<f64> = list.iter().map(|p| mean_over(&course.series, p.used_s) - at_degc).collect();
        let readings = course.series.iter().filter(|(t, _)| (span_s[0]..=span_s[1]).contains(t)).count();
        let std_k = course.noise / (readings.max(1) as f64).sqrt();
        let used = || list.iter().zip(&over_k).filter(|(p, _)| p.dropped.is_none());
        let [low, high] = extremes(used().map(|(_, over)| *over));
        let is_shown = high - low > AT_REST_K || {
            let of_noise = |noise: Course| sum_of_squares(used().map(|(p, _)| mean_over(&noise.series, p.used_s)));
            let noises: Vec<f64> = course.noises().map(of_noise).collect();
            let largest = noises.iter().fold(0.0, |a: f64, v| a.max(*v));
            // All courses together are the noise once.
            sum_of_squares(used().map(|(_, over)| *over)) > largest * noises.len() as f64
        };
        Some(Self {
            rate_k_per_h: 3600.0 * slope(&used().map(|(p, over)| (p.t_s(), *over)).collect::<Vec<_>>()),
            range_degc: [at_degc + low, at_degc + high],
            at_degc,
            over_k,
            std_k,
            course,
            is_shown,
        })
    }

    /// Whether the sensor moves by more than at rest.
    pub fn is_moving(&self) -> bool {
        self.range_k() > AT_REST_K
    }

    /// What its readings do within the plateaus.
    fn within(&self) -> Within {
        if self.is_moving() { Within::Drift } else { Within::Still }
    }

    /// Highest minus lowest temperature, K.
    pub fn range_k(&self) -> f64 {
        self.range_degc[1] - self.range_degc[0]
    }
}

/// Sum of the squares of values about their mean.
fn sum_of_squares(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|v| (v - mean).powi(2)).sum()
}

/// The fit of a run whose readings were referred to one temperature.
pub(super) struct Referred {
    /// The fit, with the columns that the temperature brings.
    pub means: Means,
    /// Its solution.
    pub fitted: Fitted,
    /// Its noise.
    pub noise: DenseNoise,
    /// Coefficients of the baseline at the stated temperature, component after component.
    pub stacked: Vec<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// What the parameters follow of the temperature.
    pub slopes: TemperatureSlopes,
    /// By how much the uncertainty of an element of the response is at most larger than it were if the slopes were known.
    widened: f64,
}

/// Derivatives of S, row by row, by σ_x, σ_y, σ_z (nT/enT), ξ_xy, ξ_xz, ξ_yz (degrees) and a turn about the axes (radians).
fn derivatives(at: &Split) -> Option<SMatrix<f64, PARAMETERS, PARAMETERS>> {
    // Wide enough that the rounding of the angles does not matter, and narrow enough for the third derivatives not to.
    const STEP_DEG: f64 = 1e-2;
    let s = response(at.sigma, at.xi_deg)?;
    let mut columns = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    let mut set = |k: usize, d: Matrix3<f64>| columns.set_column(k, &SVector::from_column_slice(d.transpose().as_slice()));
    for i in 0..3 {
        set(i, Matrix3::from_fn(|row, j| if row == i { -s[(row, j)] / at.sigma[i] } else { 0.0 }));
        let moved = |by: f64| {
            let mut xi = at.xi_deg;
            xi[i] += by;
            response(at.sigma, xi)
        };
        set(3 + i, (moved(STEP_DEG)? - moved(-STEP_DEG)?) / (2.0 * STEP_DEG));
        let unit = Vector3::from_fn(|row, _| f64::from(u8::from(row == i)));
        set(6 + i, -s * unit.cross_matrix());
    }
    Some(columns)
}

/// Refers the mean readings of all plateaus to the stated temperature and fits them.
///
/// # Errors
/// The run does not determine what it is asked for, or has no fit.
pub(super) fn refer(
    prepared: &mut Prepared,
    moving: &Moving,
    order: usize,
    is_robust: bool,
    origin: &Origin,
) -> Result<Referred, LinError> {
    let raw = prepared.list.clone();
    match origin {
        Origin::Polynomials(polynomials) => {
            let change = SensorChange::of(polynomials, moving.at_degc);
            let directions = directions(polynomials, moving.at_degc);
            // The offset follows the polynomials and what the run finds beside them, on which nothing is stated.
            let by = Held { bounds: SlopeBounds::default(), source: SlopeSource::Polynomials(polynomials.input.path.clone()) };
            held(prepared, &raw, moving, order, is_robust, change, &directions, &by, polynomials.noise.as_ref())
        }
        Origin::Rest(stated) => {
            let source = if stated.is_complete() { SlopeSource::Bound } else { SlopeSource::Assumed };
            let held = Held { bounds: stated.or_published(), source };
            free_or_held(prepared, &raw, moving, order, is_robust, 1, &held)
        }
        Origin::Run { order: Some(highest), bounds } => {
            free_or_held(prepared, &raw, moving, order, is_robust, (*highest).clamp(1, MOST_ORDER), &Held::stated(*bounds))
        }
        Origin::Run { order: None, bounds } => {
            let held = Held::stated(*bounds);
            let straight = free_or_held(prepared, &raw, moving, order, is_robust, 1, &held)?;
            let list = prepared.list.clone();
            // A curvature that the run does not show, or not determine, is left out.
            match free(prepared, &raw, moving, order, is_robust, MOST_ORDER, &held) {
                Ok((curved, probability)) if probability < CURVED => Ok(curved),
                _ => {
                    prepared.list = list;
                    Ok(straight)
                }
            }
        }
    }
}

/// With slopes from the run itself, or of zero within their bounds where the run does not determine them.
fn free_or_held(
    prepared: &mut Prepared,
    raw: &[Plateau],
    moving: &Moving,
    order: usize,
    is_robust: bool,
    highest: usize,
    by: &Held,
) -> Result<Referred, LinError> {
    match free(prepared, raw, moving, order, is_robust, highest, by) {
        Err(Open::Slopes) => match (by.bounds.sigma_per_k, by.bounds.xi_deg_per_k) {
            (Some(sigma), Some(xi_deg)) => {
                let of = |k: usize| (k, vec![if k < 3 { sigma } else { xi_deg }]);
                let directions: Vec<_> = (0..6).map(of).collect();
                held(prepared, raw, moving, order, is_robust, SensorChange::default(), &directions, by, None)
            }
            _ => Err(LinError::Slopes { range_k: moving.range_k() }),
        },
        Err(Open::Other(error)) => Err(error),
        Ok((referred, _)) => Ok(referred),
    }
}

/// Independent changes of one standard uncertainty each: the quantity, and its coefficients in powers of `T - T_0`.
fn directions(polynomials: &SensorPolynomials, degc: f64) -> Vec<(usize, Vec<f64>)> {
    let all = polynomials.sigma.iter().chain(&polynomials.xi_deg).enumerate();
    all.flat_map(|(quantity, polynomial)| {
        let covariance = polynomial.about(degc).covariance;
        let count = covariance.nrows().saturating_sub(1);
        if count == 0 {
            return Vec::new();
        }
        let slopes = covariance.view((covariance.nrows() - count, covariance.nrows() - count), (count, count)).into_owned();
        // Powers differ by orders of magnitude in size: decomposed in units of their standard uncertainties.
        let scale = DVector::from_fn(count, |k, _| slopes[(k, k)].max(0.0).sqrt().max(f64::MIN_POSITIVE));
        let eigen = DMatrix::from_fn(count, count, |j, k| slopes[(j, k)] / (scale[j] * scale[k])).symmetric_eigen();
        (0..count)
            .map(|k| {
                let size = eigen.eigenvalues[k].max(0.0).sqrt();
                (quantity, (0..count).map(|j| size * scale[j] * eigen.eigenvectors[(j, k)]).collect())
            })
            .collect::<Vec<(usize, Vec<f64>)>>()
    })
    .collect()
}

/// With given slopes, the uncertainty of which is carried on.
#[expect(
    clippy::too_many_arguments,
    reason = "the run, how it is fitted, the slopes with uncertainty, bounds and source, the noise of the group"
)]
fn held(
    prepared: &mut Prepared,
    raw: &[Plateau],
    moving: &Moving,
    order: usize,
    is_robust: bool,
    change: SensorChange,
    directions: &[(usize, Vec<f64>)],
    by: &Held,
    group: Option<&GroupNoise>,
) -> Result<Referred, LinError> {
    let (means, fitted, at) = settle(prepared, raw, moving, order, is_robust, 0, &mut change.clone())?;
    let used = prepared.used(order)?;
    let noise = conditions::noise_in_group(fitted.for_noise(), &used, moving.within(), group).map_err(LinError::Fit)?;
    let known = prepared.covariance(&noise, &means, &used).map_err(LinError::Fit)?;
    let mut changes = changes_ent(directions, &at, raw, moving);
    changes.extend(changes_by_thermometer_ent(&change, &at, raw, moving));
    let carry = || carried::covariance(&changes, raw, &means.design()?);
    let mut covariance = &known + carry().map_err(LinError::Fit)?;
    let mut stacked = DVector::from_vec(stack(&fitted.solution.coefficients));
    let std = |quantity: usize| {
        let first = directions.iter().filter(|(q, _)| *q == quantity).map(|(_, own)| own.first().copied().unwrap_or(0.0));
        first.map(|c| c * c).sum::<f64>().sqrt()
    };
    let sensor = |from: usize| std::array::from_fn(|i| change.sensor[from + i].first().copied().unwrap_or(0.0));
    let places = Places::of(&means);
    if let Some(std) = by.bounds.offset_ent_per_k {
        let mut step = DVector::zeros(stacked.len());
        for k in (0..3).filter_map(|a| places.offset_slope(a)) {
            observe(&mut step, &mut covariance, k, stacked[k], std * std);
        }
        stacked += step;
    }
    let stacked = stacked.as_slice();
    let offset = places.of_offset(|k| stacked[k]);
    let slopes = TemperatureSlopes {
        at_degc: moving.at_degc,
        order: change.sensor.iter().map(Vec::len).max().unwrap_or(0).max(1),
        sigma: sensor(0),
        xi_deg: sensor(3),
        b_or_ent: offset.map(|o| std::array::from_fn(|a| o[a] + change.b_or[a].first().copied().unwrap_or(0.0))),
        std: SlopeStd {
            sigma: std::array::from_fn(std),
            xi_deg: std::array::from_fn(|i| std(3 + i)),
            b_or_ent: places.of_offset(|k| covariance[(k, k)].sqrt()),
        },
        source: by.source.clone(),
    };
    subtract_offset(prepared, moving, offset.unwrap_or_default());
    let known = places.of_baseline(stacked, &known).1;
    let (stacked, covariance) = places.of_baseline(stacked, &covariance);
    let widened = places.widening(&covariance, &known);
    Ok(Referred { means, fitted, noise, stacked, covariance, slopes, widened })
}

/// Temperatures over the stated one of the plateaus that are used, K.
fn raw_used(raw: &[Plateau], moving: &Moving) -> Vec<f64> {
    raw.iter().zip(&moving.over_k).filter(|(p, _)| p.dropped.is_none()).map(|(_, over)| *over).collect()
}

/// Takes what the offset follows of the temperature off all readings.
fn subtract_offset(prepared: &mut Prepared, moving: &Moving, slope_ent_per_k: [f64; 3]) {
    for (plateau, over_k) in prepared.list.iter_mut().zip(&moving.over_k) {
        plateau.mean.0.iter_mut().zip(slope_ent_per_k).for_each(|(mean, slope)| *mean -= slope * over_k);
    }
}

/// Changes of the mean readings of all plateaus, enT, by independent changes of given slopes of one standard uncertainty each.
fn changes_ent(directions: &[(usize, Vec<f64>)], at: &Split, list: &[Plateau], moving: &Moving) -> Vec<Vec<[f64; 3]>> {
    let Some(derivatives) = derivatives(at) else { return Vec::new() };
    let to_sensor = (at.r_nom * at.rho).transpose();
    let change = |(quantity, coefficients): &(usize, Vec<f64>)| {
        let by = Matrix3::from_row_slice(derivatives.column(*quantity).as_slice()) * to_sensor;
        let one =
            |(p, over_k): (&Plateau, &f64)| (by * Vector3::from(p.setting.field.0) * change_at(coefficients, *over_k)).into();
        list.iter().zip(&moving.over_k).map(one).collect()
    };
    directions.iter().map(change).collect()
}

/// Changes of the mean readings of all plateaus, enT, by the noise of the thermometer, each by one standard deviation of something that is
/// independent of the others: of a sensor that shows no movement by a temperature that is wrong during the whole run, as the parameters then
/// hold elsewhere than stated; of one that moves by random courses of the noise.
fn changes_by_thermometer_ent(change: &SensorChange, at: &Split, list: &[Plateau], moving: &Moving) -> Vec<Vec<[f64; 3]>> {
    let readings = |p: &Plateau, over_k: f64| change.reading_ent(at, over_k, p.setting.field.0).unwrap_or_default();
    if !moving.is_shown {
        return vec![list.iter().map(|p| readings(p, moving.std_k)).collect()];
    }
    let change = |noise: Course| {
        let of = |(p, over_k): (&Plateau, &f64)| {
            let [there, here] = [over_k + mean_over(&noise.series, p.used_s), *over_k].map(|over_k| readings(p, over_k));
            std::array::from_fn(|a| there[a] - here[a])
        };
        list.iter().zip(&moving.over_k).map(of).collect()
    };
    moving.course.noises().map(change).collect()
}

/// Fits and refers in turn until the readings stay; columns of the field times the powers of the temperature up to `free` find what the
/// change lacks, and give it to it.
fn settle(
    prepared: &mut Prepared,
    raw: &[Plateau],
    moving: &Moving,
    order: usize,
    is_robust: bool,
    free: usize,
    change: &mut SensorChange,
) -> Result<(Means, Fitted, Split), LinError> {
    let over_k = raw_used(raw, moving);
    let largest = raw.iter().filter(|p| p.dropped.is_none()).flat_map(|p| p.mean.0).fold(0.0, |a: f64, v| a.max(v.abs()));
    for _ in 0..MOST_ROUNDS {
        let used = prepared.used(order)?;
        let means = Means::of(&used, order).with_temperature(&over_k, free);
        let fitted = fit(&used, &means, is_robust)?;
        let stacked = stack(&fitted.solution.coefficients);
        let places = Places::of(&means);
        let at = split(&places.response(&stacked).try_inverse().ok_or(SplitError::Singular)?, &prepared.position.r_nom())?;
        take(change, &at, &places, &stacked).ok_or(SplitError::Planar)?;
        let mut moved: f64 = 0.0;
        for ((plateau, raw), over_k) in prepared.list.iter_mut().zip(raw).zip(&moving.over_k) {
            let by = change.reading_ent(&at, *over_k, plateau.setting.field.0).ok_or(SplitError::Planar)?;
            for (a, by) in by.into_iter().enumerate() {
                let mean = raw.mean.0[a] - by;
                if plateau.dropped.is_none() {
                    moved = moved.max((mean - plateau.mean.0[a]).abs());
                }
                plateau.mean.0[a] = mean;
            }
        }
        if moved <= SETTLED * largest {
            return Ok((means, fitted, at));
        }
    }
    let what = "readings at one temperature";
    Err(LinError::Fit(FitError::NotSettled { what, iterations: MOST_ROUNDS }))
}

/// Where the coefficients of a fit with the columns of a temperature stand: those of the baseline, response and trend, then for every
/// component the slope of the offset, then the response to the field times powers of the temperature.
struct Places {
    /// Coefficients per component.
    per: usize,
    /// Of the baseline.
    base: usize,
    /// Of the offset with the temperature, one or none.
    offset: usize,
    /// Powers of the temperature.
    powers: usize,
}

impl Places {
    fn of(means: &Means) -> Self {
        let base = means.baseline.count();
        let [offset, response] = means.extra();
        Self { per: base + offset + response, base, offset, powers: response / 3 }
    }

    /// Coefficient of component a for coil axis j in the response, to a power of the temperature.
    fn at(&self, a: usize, power: usize, j: usize) -> usize {
        a * self.per + if power == 0 { j } else { self.base + self.offset + 3 * (power - 1) + j }
    }

    fn offset_slope(&self, a: usize) -> Option<usize> {
        (self.offset > 0).then_some(a * self.per + self.base)
    }

    /// Values at the slopes of the offset, if there are any.
    fn of_offset(&self, value: impl Fn(usize) -> f64) -> Option<[f64; 3]> {
        let [x, y, z] = std::array::from_fn(|a| self.offset_slope(a));
        Some([value(x?), value(y?), value(z?)])
    }

    /// Response of the fit, enT/nT, that goes with a power of the temperature.
    fn to_power(&self, stacked: &[f64], power: usize) -> Matrix3<f64> {
        Matrix3::from_fn(|a, j| stacked[self.at(a, power, j)])
    }

    /// Response at the stated temperature, enT/nT.
    fn response(&self, stacked: &[f64]) -> Matrix3<f64> {
        self.to_power(stacked, 0)
    }

    /// The coefficients of the baseline alone.
    fn of_baseline(&self, stacked: &[f64], covariance: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
        let kept: Vec<usize> = (0..3).flat_map(|a| (0..self.base).map(move |k| (a, k))).map(|(a, k)| a * self.per + k).collect();
        let values = kept.iter().map(|k| stacked[*k]).collect();
        (values, DMatrix::from_fn(kept.len(), kept.len(), |r, c| covariance[(kept[r], kept[c])]))
    }

    /// How many times as large as with another covariance of the baseline the uncertainty of an element of the response is at most.
    fn widening(&self, covariance: &DMatrix<f64>, than: &DMatrix<f64>) -> f64 {
        let elements = (0..3).flat_map(|a| (0..3).map(move |j| a * self.base + j));
        elements.map(|k| (covariance[(k, k)] / than[(k, k)]).sqrt()).fold(1.0, f64::max)
    }
}

/// No change, up to a power of the temperature.
fn no_change(powers: usize) -> SensorChange {
    SensorChange {
        sensor: std::array::from_fn(|_| vec![0.0; powers]),
        turn: vec![Vector3::zeros(); powers],
        ..SensorChange::default()
    }
}

/// Gives a change what a fit found with powers of the temperature.
fn take(change: &mut SensorChange, at: &Split, places: &Places, stacked: &[f64]) -> Option<()> {
    let to_parameters = derivatives(at)?.try_inverse()?;
    for power in 1..=places.powers {
        let found = places.to_power(stacked, power) * (at.r_nom * at.rho);
        let step = to_parameters * SVector::<f64, PARAMETERS>::from_column_slice(found.transpose().as_slice());
        for quantity in 0..6 {
            change.sensor[quantity][power - 1] += step[quantity];
        }
        change.turn[power - 1] += Vector3::new(step[6], step[7], step[8]);
    }
    Some(())
}

/// Why slopes are not found in a run.
enum Open {
    /// The run does not determine them.
    Slopes,
    /// The run has no fit at all.
    Other(LinError),
}

/// With slopes up to a power of the temperature from the run itself; and the probability that noise alone makes the change of the highest
/// power as large.
fn free(
    prepared: &mut Prepared,
    raw: &[Plateau],
    moving: &Moving,
    order: usize,
    is_robust: bool,
    powers: usize,
    by: &Held,
) -> Result<(Referred, f64), Open> {
    prepared.list = raw.to_vec();
    let used = prepared.used(order).map_err(Open::Other)?;
    // A run that cannot be fitted at rest says so by its own reason.
    fit(&used, &Means::of(&used, order), is_robust).map_err(Open::Other)?;
    if used.len() <= order + 5 + 3 * powers {
        return Err(Open::Slopes);
    }
    let mut change = no_change(powers);
    let (means, fitted, at) = settle(prepared, raw, moving, order, is_robust, powers, &mut change).map_err(|_| Open::Slopes)?;
    let used = prepared.used(order).map_err(Open::Other)?;
    let noise = conditions::noise(fitted.for_noise(), &used, moving.within()).map_err(|e| Open::Other(LinError::Fit(e)))?;
    let of_noise = prepared.covariance(&noise, &means, &used).map_err(|e| Open::Other(LinError::Fit(e)))?;
    let stacked = stack(&fitted.solution.coefficients);
    let places = Places::of(&means);
    let slopes_of_offset = places.of_offset(|k| stacked[k]);
    let of = |covariance: &DMatrix<f64>| {
        let mut found = Found::of(&at, &places, covariance, change.clone()).ok_or(Open::Slopes)?;
        found.without_turns();
        found.within(&by.bounds, slopes_of_offset);
        Ok(found)
    };
    // A movement of less than a kelvin tells slopes so poorly that the noise of the thermometer times them would be far more than it does.
    let followed = if moving.is_moving() { change.clone() } else { of(&of_noise)?.change };
    let changes = changes_by_thermometer_ent(&followed, &at, raw, moving);
    let of_thermometer = || carried::covariance(&changes, raw, &means.design()?);
    let covariance = of_noise + of_thermometer().map_err(|e| Open::Other(LinError::Fit(e)))?;
    let found = of(&covariance)?;
    let probability = found.probability_of_the_highest(fitted.solution.dof);
    let offset = slopes_of_offset.map(|o| std::array::from_fn(|a| o[a] + found.step[found.offset_slope(a)]));
    let slopes = found.slopes(moving, offset, by.source.clone());
    let known = found.clone().with_slopes_known().of_baseline(&stacked).1;
    let (stacked, covariance) = found.of_baseline(&stacked);
    let widened = places.widening(&covariance, &known);
    let response = Matrix3::from_fn(|a, j| stacked[a * places.base + j]);
    let singular = || Open::Slopes;
    let at = split(&response.try_inverse().ok_or_else(singular)?, &at.r_nom).map_err(|_| Open::Slopes)?;
    let change = found.change;
    for ((plateau, raw), over_k) in prepared.list.iter_mut().zip(raw).zip(&moving.over_k) {
        let by = change.reading_ent(&at, *over_k, plateau.setting.field.0).ok_or_else(singular)?;
        plateau.mean.0 = std::array::from_fn(|a| raw.mean.0[a] - by[a]);
    }
    subtract_offset(prepared, moving, offset.unwrap_or_default());
    Ok((Referred { means, fitted, noise, stacked, covariance, slopes, widened }, probability))
}

impl Referred {
    /// Says what moved, where the parameters hold, and where the slopes come from, for which a run at rest has room within `bounds`; nothing of
    /// a sensor at rest the slopes of which hardly matter.
    pub fn note(&self, moving: &Moving, channel: &str, bounds: &SlopeBounds) -> Option<Note> {
        let [low, high] = moving.range_degc;
        let (slopes, widened) = (&self.slopes, self.widened);
        let origin = match &slopes.source {
            SlopeSource::Run => "the slopes were found in the run itself, which widens the uncertainties".to_owned(),
            SlopeSource::Bound => "the slopes are held by the bounds of campaign.toml".to_owned(),
            SlopeSource::Assumed => {
                let SlopeBounds { sigma_per_k, xi_deg_per_k, .. } = bounds.or_published();
                let [sigma, xi_deg] = [sigma_per_k, xi_deg_per_k].map(Option::unwrap_or_default);
                format!(
                    "its slopes are not known, and room for {sigma} nT/enT/K and {xi_deg} deg/K makes uncertainties up to {widened:.1} \
                     times as large"
                )
            }
            SlopeSource::Polynomials(file) => format!("the slopes are those of {file}"),
        };
        if !moving.is_moving() && (widened < WIDENED || slopes.source != SlopeSource::Assumed) {
            return None;
        }
        let decimals = if moving.is_moving() { 1 } else { 2 };
        let text = format!(
            "the sensor temperature moved by {:.decimals$} K, {low:.decimals$} to {high:.decimals$} °C: the parameters hold at {:.2} °C; \
             {origin}",
            moving.range_k(),
            slopes.at_degc
        );
        let note = Note::new(NoteKind::Temperature, text).about(channel);
        Some(match &slopes.source {
            SlopeSource::Run => note.with_remedy("name polynomials of the sensor with --temperature"),
            SlopeSource::Assumed => {
                note.with_remedy("name polynomials of the sensor with --temperature, or state bounds in campaign.toml")
            }
            _ => note,
        })
    }
}

#[cfg(test)]
mod tests;
