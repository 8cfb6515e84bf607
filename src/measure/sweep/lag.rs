//! Whether the sensor follows its thermistor with a lag, and the fit with the lag that it has.
//!
//! What a polynomial of too low an order leaves looks like a lag wherever the temperature moves in one direction only. A lag is therefore
//! claimed only where it is significant beside polynomials of one order higher than what was asked for or what the criterion prefers, both where
//! it fits best and to first order from none. It is a parameter of the fit then, so that its uncertainty is in that of all others; a lag that is
//! given is taken as it is. Of one that is not claimed it is said how long it might be without showing, and what it would do.

use super::QUANTITIES;
use super::fit::{Problem, polynomials};
use super::options::LagChoice;
use super::orders::{Asked, Orders};
use super::refusal::SweepError;
use super::thermistors::SIGNIFICANT;
use crate::data::across::{AppliedLag, LagDecision, LagForm, ThermistorLag};
use crate::data::note::{Note, NoteKind};
use crate::fit::smooth::Course;
use crate::fit::{DenseNoise, FitError};
use crate::measure::joint::SensorFit;
use crate::model::lag::Lag;
use crate::model::polynomial;
use nalgebra::{DMatrix, DVector};

/// Steps of the search for the lag of a fit; it starts beside the minimum.
const MOST_STEPS: usize = 12;
/// A step below this part of its standard deviation is none.
const SETTLED: f64 = 0.01;
/// Half of the distance over which the derivative by a lag is taken, s: the time over which thermistors are read.
const DISTANCE_S: f64 = 10.0;

/// The same for that by the temperature, K.
const DISTANCE_K: f64 = 0.1;
/// Longest lag that is thought of where none shows, s: that of a sensor in its box.
const LONGEST_HIDDEN_S: f64 = 600.0;
/// Changes by fewer stated uncertainties are not told.
const TOLD: f64 = 5.0;
/// Of lags that would not show the effect of none longer than this is told, s.
const MINUTE_S: f64 = 60.0;
/// Temperatures at which polynomials are compared.
const COMPARED: usize = 5;
/// Another kind of lag of a smaller probability than this is not told.
const UNLIKELY: f64 = 0.01;

/// The fit with what its uncertainty is.
pub(super) struct Settled {
    /// The fit.
    pub fit: SensorFit,
    /// Orders of its polynomials.
    pub orders: Orders,
    /// Temperature of the sensor at the settings, °C.
    pub degc: Vec<f64>,
    /// The thermistor with the lag, (s since the run's start, °C).
    pub moved: Vec<(f64, f64)>,
    /// Noise of the settings.
    pub noise: DenseNoise,
    /// Covariance of the parameters; that of a lag that was fitted is the last one.
    pub covariance: DMatrix<f64>,
    /// The lag.
    pub applied: AppliedLag,
}

impl Settled {
    /// What was applied of the lags of the thermistor.
    pub fn form(&self) -> LagForm {
        match self.applied.decision {
            LagDecision::NoneClaimed | LagDecision::NotLookedFor => LagForm::None,
            LagDecision::Given => LagForm::Given,
            LagDecision::OfTheModel => LagForm::OfTheModel,
            LagDecision::Found if self.applied.form == LagForm::Delay.name() => LagForm::Delay,
            LagDecision::Found => LagForm::FirstOrder,
        }
    }
}

/// A fit in which the lag is a parameter.
struct Lagged {
    fit: SensorFit,
    lag: Lag,
    degc: Vec<f64>,
    /// Derivative of the readings by the lag, enT/s.
    slope: DMatrix<f64>,
}

/// The fit of a sweep by the readings of one thermistor. `screened` is what a linear model says of its lag, `of_model` a lag that is known.
pub(super) fn settle(
    problem: &Problem,
    asked: &Asked,
    course: &Course,
    screened: &ThermistorLag,
    choice: LagChoice,
    of_model: Option<Lag>,
    notes: &mut Vec<Note>,
) -> Result<Settled, SweepError> {
    let (mut lag, mut decision) = begin(screened, choice, of_model);
    let mut declined = None;
    if let (LagDecision::Found, Some(candidate)) = (decision, lag) {
        match claimed(problem, asked, course, [candidate, other_kind(screened)], notes)? {
            Claim::Made(settled) => return Ok(*settled),
            Claim::Declined(rival) => declined = Some((candidate, rival)),
        }
        (lag, decision) = (None, LagDecision::NoneClaimed);
    }
    if decision == LagDecision::NotLookedFor {
        declined = candidate(screened).map(|lag| (lag, Rival::NotAsked));
    }
    if of_model.is_some() && decision != LagDecision::OfTheModel {
        let text =
            "the effects of the model are those with its lag; the polynomials are of the temperature with the one of --lag";
        notes.push(Note::new(NoteKind::Temperature, text));
    }
    let moved = lag.map_or_else(|| course.series.clone(), |lag| lag.of(course));
    let degc = problem.means.degc(&moved);
    let orders = asked.choose(problem, &degc)?;
    let fit = problem.fit(&degc, orders)?;
    let noise = problem.noise(&fit, &degc, orders)?;
    let influence = fit.influence(None)?;
    let covariance = noise.covariance_of(&influence) + of_thermistor(problem, &fit, course, lag, &degc, &influence);
    if matches!(decision, LagDecision::NoneClaimed | LagDecision::NotLookedFor) {
        let effect = effect(problem, &fit, course, &noise, &influence, &covariance);
        notes.extend(unclaimed(&screened.channel, declined, effect));
    }
    Ok(Settled { fit, orders, degc, moved, noise, covariance, applied: applied(lag, None, decision) })
}

/// Derivative of readings by what moves them, from half of a distance either way.
fn slope(distance: f64, beside: impl Fn(f64) -> Option<DMatrix<f64>>) -> Option<DMatrix<f64>> {
    Some((beside(distance)? - beside(-distance)?) / (2.0 * distance))
}

/// Derivative of the readings of a fit without a lag by a delay, enT/s.
fn slope_at_none(problem: &Problem, fit: &SensorFit, course: &Course) -> Option<DMatrix<f64>> {
    slope(DISTANCE_S, |by_s| fit.readings_ent(&problem.means.degc(&Lag::Delay(by_s).of(course))))
}

/// How a lag follows from the readings, from the influence with the lag as its last parameter: a row per component, a column per plateau.
fn of_lag(influence: &[DMatrix<f64>; 3]) -> [DMatrix<f64>; 3] {
    influence.each_ref().map(|all| all.rows(all.nrows() - 1, 1).into_owned())
}

/// The step of a lag that the residuals of a fit ask for, s.
fn step_s(rows: &[DMatrix<f64>; 3], fit: &SensorFit) -> f64 {
    (0..3).map(|c| (&rows[c] * fit.residual_ent.column(c))[0]).sum()
}

/// The lag that the residuals of a fit without one ask for, to first order, and its standard uncertainty, s; `None` where the readings hold
/// nothing of it.
fn lag_beside(fit: &SensorFit, slope: &DMatrix<f64>, noise: &DenseNoise) -> Option<(f64, f64)> {
    let rows = of_lag(&fit.influence(Some(slope)).ok()?);
    Some((step_s(&rows, fit), noise.covariance_of(&rows)[(0, 0)].sqrt()))
}

/// What a lag that is not claimed would do.
struct Effect {
    /// Longest lag that would not show, s.
    hidden_s: f64,
    /// Change of the quantity that changes most, in its stated uncertainties, of a lag of a second.
    per_s: f64,
    /// Name of that quantity.
    quantity: &'static str,
}

/// The effect of a lag on a fit without one, from its influence and covariance; `None` where the readings hold nothing of a lag.
///
/// Where the temperature goes one way, a lag shifts the temperatures by the same amount all along, which polynomials follow: no residual shows
/// it.
fn effect(
    problem: &Problem,
    fit: &SensorFit,
    course: &Course,
    noise: &DenseNoise,
    influence: &[DMatrix<f64>; 3],
    covariance: &DMatrix<f64>,
) -> Option<Effect> {
    let slope = slope_at_none(problem, fit, course)?;
    let (_, std_s) = lag_beside(fit, &slope, noise)?;
    let changes: DVector<f64> = (0..3).map(|c| &influence[c] * slope.column(c)).sum();
    let stated = polynomials(fit, covariance);
    let change = |degc: f64, quantity: usize| {
        polynomial::value(&changes.as_slice()[fit.range(quantity)], degc).abs() / stated[quantity].evaluate(degc).1
    };
    let [low, high] = fit.valid_degc;
    let (per_s, quantity) = (0..COMPARED)
        .map(|k| low + (high - low) * k as f64 / (COMPARED - 1) as f64)
        .flat_map(|degc| (0..QUANTITIES.len()).map(move |quantity| (degc, quantity)))
        .map(|(degc, quantity)| (change(degc, quantity), QUANTITIES[quantity].0))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(Effect { hidden_s: (SIGNIFICANT * std_s).min(LONGEST_HIDDEN_S), per_s, quantity })
}

/// What is said of a lag that is not claimed: that `declined` would explain the readings, or how long one would not show; and what such a lag
/// would do, or one of a minute if longer ones would not show either.
fn unclaimed(channel: &str, declined: Option<(Lag, Rival)>, effect: Option<Effect>) -> Option<Note> {
    let (why, lag_s) = match (declined, &effect) {
        (Some((lag, rival)), _) => {
            let lag_s = lag.signed_seconds();
            let but = match rival {
                Rival::NotAsked => "--lag none was given".to_owned(),
                Rival::Polynomials => "so do polynomials of one order higher".to_owned(),
                Rival::Readings { t_s } => {
                    format!(
                        "only those near {t_s:.0} s show it, as where a reading of {channel} there is wrong or the temperature moves there alone"
                    )
                }
                Rival::Drift { by_k } => {
                    format!(
                        "{channel} that drifts by {by_k:.2} K within the run explains them better; the polynomials are without either"
                    )
                }
            };
            (format!("a lag of {lag_s:.0} s behind {channel} explains the readings, but {but}: none is claimed"), lag_s.abs())
        }
        (None, Some(effect)) if effect.hidden_s * effect.per_s > TOLD => {
            let hidden = seconds(effect.hidden_s);
            let drift =
                if effect.hidden_s < LONGEST_HIDDEN_S { "" } else { ", nor would a gain or a thermistor that drifts with time" };
            let text =
                format!("no lag behind {channel} is claimed, but one of up to {hidden} s would not show in this run{drift}");
            (text, effect.hidden_s.min(MINUTE_S))
        }
        (None, _) => return None,
    };
    let what = effect.map_or_else(String::new, |Effect { per_s, quantity, .. }| {
        format!(
            "; one of {} s would change {quantity} by {:.1} times its stated uncertainty, which is without it",
            seconds(lag_s),
            lag_s * per_s
        )
    });
    let note = Note::new(NoteKind::Temperature, why + &what).about(channel);
    Some(note.with_remedy("give the lag with --lag if it is known, or let the temperature go up and down"))
}

/// Seconds with as many decimals as tell them.
fn seconds(s: f64) -> String {
    let decimals = if s < 1.0 { 2 } else { usize::from(s < 10.0) };
    format!("{s:.decimals$}")
}

/// What a file says of a lag.
fn applied(lag: Option<Lag>, std_s: Option<f64>, decision: LagDecision) -> AppliedLag {
    let form = lag.map_or_else(|| LagForm::None.name(), Lag::form).to_owned();
    AppliedLag { form, lag_s: lag.map_or(0.0, Lag::seconds), std_s, decision }
}

/// The lag that a linear model lets expect.
fn candidate(screened: &ThermistorLag) -> Option<Lag> {
    match screened.form {
        LagForm::Delay => Some(Lag::Delay(screened.delay_s)),
        LagForm::FirstOrder => Some(Lag::time_constant(screened.time_constant_s)),
        LagForm::None | LagForm::Given | LagForm::OfTheModel => None,
    }
}

/// The lag of the other kind, which a linear model prefers less.
fn other_kind(screened: &ThermistorLag) -> Lag {
    match screened.form {
        LagForm::Delay => Lag::time_constant(screened.time_constant_s),
        _ => Lag::Delay(screened.delay_s),
    }
}

/// The lag that a fit of a sweep begins with; one that a linear model shows is not claimed yet.
fn begin(screened: &ThermistorLag, choice: LagChoice, of_model: Option<Lag>) -> (Option<Lag>, LagDecision) {
    match (choice, of_model) {
        (LagChoice::Auto, Some(lag)) => (Some(lag), LagDecision::OfTheModel),
        (LagChoice::Auto, None) => match candidate(screened) {
            Some(lag) => (Some(lag), LagDecision::Found),
            None => (None, LagDecision::NoneClaimed),
        },
        (LagChoice::None, _) => (None, LagDecision::NotLookedFor),
        (LagChoice::Given(lag), _) => (Some(lag), LagDecision::Given),
    }
}

/// The lags that the fit may end with, the one that it begins with first; none where it begins without.
pub(super) fn possible(screened: &ThermistorLag, choice: LagChoice, of_model: Option<Lag>) -> Vec<Lag> {
    match begin(screened, choice, of_model) {
        (Some(lag), LagDecision::Found) => {
            vec![lag, Lag::Delay(screened.delay_s), Lag::time_constant(screened.time_constant_s)]
        }
        (lag, _) => lag.into_iter().collect(),
    }
}

/// Why a lag that explains the readings is not claimed, mostly something else that explains them as well.
enum Rival {
    /// Nobody asked for one.
    NotAsked,
    /// Polynomials of one order higher.
    Polynomials,
    /// A wrong reading of the thermistor at this time, s since the run's start: without the settings beside it no lag is left.
    Readings { t_s: f64 },
    /// A thermistor that drifts steadily, K from the first to the last setting.
    Drift { by_k: f64 },
}

/// Whether a lag is claimed.
enum Claim {
    Made(Box<Settled>),
    Declined(Rival),
}

/// The time of the reading of the thermistor, s, without which a lag that residuals ask for would not be significant: a lag acts wherever the
/// temperature moves, a wrong reading beside itself. Not asked where more than half of what tells a lag is beside one reading.
fn rests_on_one_reading(
    problem: &Problem,
    fit: &SensorFit,
    slope: &DMatrix<f64>,
    course: &Course,
    noise: &DenseNoise,
) -> Option<f64> {
    let rows = of_lag(&fit.influence(Some(slope)).ok()?);
    let std_s = noise.covariance_of(&rows)[(0, 0)].sqrt();
    // What every setting adds to the lag, and its part of what tells one.
    let sums: Vec<[f64; 2]> = (0..problem.settings())
        .map(|i| [&fit.residual_ent, slope].map(|of| (0..3).map(|c| rows[c][i] * of[(i, c)]).sum()))
        .collect();
    let lag_s: f64 = sums.iter().map(|sum| sum[0]).sum();
    let beside = course.reach() + 1;
    let time = |j: usize| course.series[j].0;
    (0..course.series.len()).find_map(|j| {
        let near_s = [time(j.saturating_sub(beside)), time((j + beside).min(course.series.len() - 1))];
        let near = problem.means.t_s.iter().zip(&sums).filter(|(t_s, _)| near_s[0] <= **t_s && **t_s <= near_s[1]);
        let [of_lag, part] = near.fold([0.0; 2], |[a, b], (_, sum)| [a + sum[0], b + sum[1]]);
        let rest = (lag_s - of_lag) * lag_s.signum();
        (part < 0.5 && rest < SIGNIFICANT * std_s * (1.0 - part).sqrt()).then(|| time(j))
    })
}

/// A steady drift of the thermistor, K from the first to the last setting, and what it takes off the deviance of a fit without a lag.
fn drift(problem: &Problem, fit: &SensorFit, degc: &[f64], orders: Orders) -> Option<(f64, f64)> {
    let t_s = &problem.means.t_s;
    let (first, last) = (t_s.first()?, t_s.last()?);
    let drifted = |by_k: f64| -> Vec<f64> {
        degc.iter().zip(t_s).map(|(degc, t)| degc + by_k * ((t - first) / (last - first) - 0.5)).collect()
    };
    let slope = slope(DISTANCE_K, |by_k| fit.readings_ent(&drifted(by_k)))?;
    let by_k = step_s(&of_lag(&fit.influence(Some(&slope)).ok()?), fit);
    let refit = problem.fit(&drifted(by_k), orders).ok()?;
    Some((by_k, problem.deviance(fit) - problem.deviance(&refit)))
}

/// The fit with a lag, if it is significant beside polynomials of one order higher, all along the run, and no worse than a drift of the
/// thermistor. The first of two kinds is that of a linear model; the second one goes before it where the fit itself likes it better.
fn claimed(
    problem: &Problem,
    asked: &Asked,
    course: &Course,
    [candidate, other]: [Lag; 2],
    notes: &mut Vec<Note>,
) -> Result<Claim, SweepError> {
    let orders = asked.choose(problem, &problem.means.degc(&candidate.of(course)))?;
    let above = asked.above(orders);
    let declined = |rival: Rival| Ok(Claim::Declined(rival));
    let Ok(higher) = lagged(problem, course, candidate, above) else { return declined(Rival::Polynomials) };
    let given_degc = problem.means.degc(&course.series);
    let without = problem.fit(&given_degc, above)?;
    let gain = problem.deviance(&without) - problem.deviance(&higher.fit);
    let Ok(first) = lagged(problem, course, candidate, orders) else { return declined(Rival::Polynomials) };
    let (own, other) = match lagged(problem, course, other, orders) {
        Ok(second) if problem.deviance(&second.fit) < problem.deviance(&first.fit) => (second, Some(first)),
        Ok(second) => (first, Some(second)),
        Err(_) => (first, None),
    };
    let noise = problem.noise(&own.fit, &own.degc, orders)?;
    let uncertain = |lagged: &Lagged, influence: &[DMatrix<f64>; 3]| {
        let Lagged { fit, lag, degc, .. } = lagged;
        noise.covariance_of(influence) + of_thermistor(problem, fit, course, Some(*lag), degc, influence)
    };
    let mut covariance = uncertain(&own, &own.fit.influence(Some(&own.slope))?);
    if let Some(other) = other {
        notes.extend(of_kind(problem, &own, &other, &mut covariance));
    }
    let std_s = covariance[(own.fit.count(), own.fit.count())].sqrt();
    let higher_std_s = uncertain(&higher, &of_lag(&higher.fit.influence(Some(&higher.slope))?))[(0, 0)].sqrt();
    let (lag_s, higher_s) = (own.lag.signed_seconds(), higher.lag.signed_seconds());
    // Where nothing depends on the temperature any lag is as good as none, whatever its neighbours are: it must show from none as well.
    let shows = |(lag_s, std_s): (f64, f64)| lag_s.abs() > SIGNIFICANT * std_s;
    let at_none = slope_at_none(problem, &without, course);
    let from_none = at_none.as_ref().and_then(|slope| lag_beside(&without, slope, &noise));
    let is_significant = shows((higher_s, higher_std_s)) && from_none.is_some_and(shows) && gain > SIGNIFICANT * SIGNIFICANT;
    if !is_significant {
        return declined(Rival::Polynomials);
    }
    if let Some(t_s) = at_none.and_then(|slope| rests_on_one_reading(problem, &without, &slope, course, &noise)) {
        return declined(Rival::Readings { t_s });
    }
    if let Some((by_k, of_drift)) = drift(problem, &without, &given_degc, above)
        && of_drift > gain + SIGNIFICANT * SIGNIFICANT
    {
        return declined(Rival::Drift { by_k });
    }
    // What the shorter polynomials add to the knowledge of the lag.
    let apart_s = (higher_std_s.powi(2) - std_s.powi(2)).max(0.0).sqrt();
    if (lag_s - higher_s).abs() > SIGNIFICANT * apart_s.max(std_s) {
        let text = format!(
            "the lag is {lag_s:.0} s with the polynomials of the file and {higher_s:.0} ± {higher_std_s:.0} s with those of one order higher: \
             the orders are too low"
        );
        notes.push(Note::new(NoteKind::Fit, text).with_remedy("give higher orders with --order or in campaign.toml"));
    }
    let applied = applied(Some(own.lag), Some(std_s), LagDecision::Found);
    let moved = own.lag.of(course);
    Ok(Claim::Made(Box::new(Settled { fit: own.fit, orders, degc: own.degc, moved, noise, covariance, applied })))
}

/// Adds to the covariance of a fit what another kind of lag would change, by the probability that it is that one; says so where this is not small. The
/// lag itself has another meaning there, and keeps its own uncertainty.
fn of_kind(problem: &Problem, own: &Lagged, other: &Lagged, covariance: &mut DMatrix<f64>) -> Option<Note> {
    let part = 1.0 / (1.0 + (0.5 * (problem.deviance(&other.fit) - problem.deviance(&own.fit))).exp());
    let mut change = DVector::zeros(covariance.nrows());
    for k in 0..QUANTITIES.len() {
        let by = DVector::from_vec(other.fit.coefficients(k)) - DVector::from_vec(own.fit.coefficients(k));
        change.rows_mut(own.fit.range(k).start, by.len()).copy_from(&by);
    }
    *covariance += part * &change * change.transpose();
    let named = |lag: Lag| match lag {
        Lag::Delay(delay_s) => format!("a delay of {} s", seconds(delay_s)),
        Lag::FirstOrder(tau_s) | Lag::InverseFirstOrder(tau_s) => format!("a time constant of {} s", seconds(tau_s)),
    };
    (part > UNLIKELY).then(|| {
        let text = format!(
            "{} and {} explain the readings nearly alike, the latter with a probability of {:.0} %: the polynomials are those with the former, and \
             their uncertainties contain what the latter would change",
            named(own.lag),
            named(other.lag),
            100.0 * part
        );
        Note::new(NoteKind::Temperature, text).with_remedy("give the lag with --lag if its kind is known, or let the temperature rest and move")
    })
}

/// The fit in which the lag is a parameter, from a lag near by.
fn lagged(problem: &Problem, course: &Course, near: Lag, orders: Orders) -> Result<Lagged, SweepError> {
    let degc = |lag: Lag| problem.means.degc(&lag.of(course));
    let mut lag = near;
    for _ in 0..MOST_STEPS {
        let now = degc(lag);
        let fit = problem.fit(&now, orders)?;
        let slope =
            slope(DISTANCE_S, |by_s| fit.readings_ent(&degc(lag.later_by(by_s)))).ok_or(SweepError::NoSensor { degc: now[0] })?;
        let rows = of_lag(&fit.influence(Some(&slope))?);
        let step_s = step_s(&rows, &fit);
        let variance: f64 = (0..3).map(|c| rows[c].norm_squared() * fit.residual_ent.column(c).norm_squared()).sum();
        if step_s.abs() <= SETTLED * (variance / problem.settings() as f64).sqrt() {
            return Ok(Lagged { fit, lag, degc: now, slope });
        }
        lag = lag.later_by(step_s);
    }
    Err(FitError::NotSettled { what: "lag", iterations: MOST_STEPS }.into())
}

/// What the noise of the thermistor, and a jump that was taken off it, add to the covariance of parameters with this influence of the readings.
///
/// The noise is smoothed before it moves the temperatures: it is the same for settings that follow each other, where that of the readings is
/// not, and hardly shows in what the fit leaves.
fn of_thermistor(
    problem: &Problem,
    fit: &SensorFit,
    course: &Course,
    lag: Option<Lag>,
    degc: &[f64],
    influence: &[DMatrix<f64>; 3],
) -> DMatrix<f64> {
    let count = influence[0].nrows();
    let beside = |by_k: f64| fit.readings_ent(&degc.iter().map(|t| t + by_k).collect::<Vec<f64>>());
    let Some(slope) = slope(DISTANCE_K, beside) else { return DMatrix::zeros(count, count) };
    let by_degc: DMatrix<f64> = (0..3)
        .map(|c| {
            let mut own = influence[c].clone();
            own.column_iter_mut().zip(slope.column(c).iter()).for_each(|(mut column, slope)| column *= *slope);
            own
        })
        .sum();
    let mut covariance = DMatrix::zeros(count, count);
    let of_step = problem.step.iter().map(|step| step.uncertain(course));
    for noise in course.noises().chain(of_step) {
        let moved = lag.map_or_else(|| noise.series.clone(), |lag| lag.of(&noise));
        let step = &by_degc * DVector::from_vec(problem.means.degc(&moved));
        covariance += &step * step.transpose();
    }
    covariance
}
