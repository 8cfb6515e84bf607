//! What is left beside the final model, and the chain of gaps that leads there.

use super::candidate::Candidate;
use super::means::{HeldOut, Means, MeansModel, Residuals};
use super::result::{Left, LeftLike, Link};
use crate::data::units::COMPONENTS;
use crate::fit::noise::state_space::Inside;
use crate::fit::scan::orthonormal;
use crate::fit::statistics::{fisher_tail, robust_std};
use crate::model::effects::{Covariate, Spec, TIME, UNKNOWN};
use nalgebra::{DMatrix, DVector};

/// Slow noise from this many times the white noise on is told as something that is left: less is usual for a good sensor. Slow noise of the gain is not: a
/// step or drift of the gain looks like it, and is told as soon as it is clear and makes a part of the noise at the largest reading.
const SLOW: f64 = 4.0;
const SLOW_GAIN: f64 = 1.2;
/// Scatter of the means from this many times that of the samples inside them on is not explained by these: where it is white, and where slow
/// noise that is nearly white makes a part of it.
const SCATTER: f64 = 1.5;
const NEARLY_WHITE: f64 = 2.0;
/// Probability with which noise alone may seem to scatter as much.
const FALSE_ALARM: f64 = 1e-4;
/// Chi square of predictions over their number from which on they fail.
const SURPRISE: f64 = 3.0;
/// Logarithm of the likelihood ratio by which slow noise has to be better than white noise, where no samples tell the white noise.
const CLEAR: f64 = 5.0;
/// Slow noise that is forgotten after so many rows, or has a power density of no larger exponent, is nearly white.
const FORGOTTEN_ROWS: f64 = 1.0;
const FLAT: f64 = 0.5;

/// A plateau this many robust standard deviations from the others stands out, and so many of them are not told one by one. Of noise with heavy
/// tails more than twice as many plateaus are beyond half of that: of such a noise none stands out.
pub(super) const OUTLIER: f64 = 8.0;
/// So many are beyond any noise, whatever its tails: what lies as far off makes all others scatter beside the fit.
const FAR_OFF: f64 = 50.0;
const MOST_OUTLIERS: usize = 6;
const OF_TAILS: f64 = 0.5;
/// With fewer degrees of freedom a fit makes half of the residuals small by itself.
const LEAST_FREEDOM: f64 = 15.0;

/// What is left in the end, and on which axes it is no noise of any kind.
pub(super) struct Rest {
    /// Where most of it is; `None` where nothing is left.
    pub left: Option<Left>,
    /// The axis of what is left, and those on which the readings scatter more than the samples inside them let expect, where no slow noise accounts for
    /// it: whatever was named there did not close the gap.
    pub open: [bool; 3],
}

/// What is left that is more than the noise of the readings.
pub(super) fn left(means: &Means, model: &MeansModel, all: &[&Candidate]) -> Rest {
    let noise = &model.noise.parameters;
    let prepared = means.prepared;
    let residuals = means.residuals(all);
    let is_gain = noise.slow_field > noise.slow;
    let is_slow = noise.slow + noise.slow_field > 0.0;
    let is_flat = if noise.memory_rows > 0.0 { noise.memory_rows <= FORGOTTEN_ROWS } else { noise.exponent <= FLAT };
    // Means that follow each other may be slow noise, of which the scatter of the samples around their means says nothing.
    let stated = prepared.scatter.filter(|_| !is_slow || is_flat);
    let is_scatter = stated.is_some() || (prepared.inside.is_some() && (noise.apart || (is_slow && is_flat)));
    let white_ent = match stated {
        Some(stated) => std::array::from_fn(|a| (stated.variance[a] * mean_white(means, a)).sqrt()),
        None => means.white_std(model),
    };
    let of_samples = prepared.inside.or(stated);
    let times: [f64; 3] = std::array::from_fn(|a| {
        let seen = residuals[a].rms() / white_ent[a].max(f64::MIN_POSITIVE);
        // Noise of the gain is largest at the largest reading, where a calibration needs it, and few settings are there.
        if is_gain && !is_scatter { seen.max(at_largest(means, &residuals[a], white_ent[a], a)) } else { seen }
    });
    let axis = (0..3).max_by(|a, b| times[*a].total_cmp(&times[*b])).unwrap_or(0);
    let is_more = |a: usize, inside: Inside| fisher_tail(times[a].powi(2), [residuals[a].freedom, inside.freedom]) < FALSE_ALARM;
    let open: [bool; 3] = std::array::from_fn(|a| {
        let beside = of_samples.filter(|_| is_scatter || !is_slow);
        let least = if prepared.inside.is_some() && !is_slow && !noise.apart { 1.0 } else { SCATTER };
        beside.is_some_and(|inside| times[a] >= least && is_more(a, inside))
    });
    let is_clear = match of_samples {
        Some(inside) if !is_gain => is_more(axis, inside),
        // Nothing tells how much of a scatter without memory is white.
        None if is_flat => false,
        _ => is_slow && means.slow_over_white(model, all) > CLEAR,
    };
    let least = match (is_scatter, is_slow) {
        _ if stated.is_some() => NEARLY_WHITE,
        (_, false) => SCATTER,
        (true, true) => NEARLY_WHITE,
        (false, true) if is_gain => SLOW_GAIN,
        (false, true) => SLOW,
    };
    // Whatever was named where predictions fail did not close the gap, however slow the noise is that was found beside it.
    let surprise = means.surprise(&model.noise, all);
    let open: [bool; 3] = std::array::from_fn(|a| open[a] || surprise[a] > SURPRISE);
    if !is_clear || times[axis] < least {
        let axis = (0..3).max_by(|a, b| surprise[*a].total_cmp(&surprise[*b])).filter(|a| surprise[*a] > SURPRISE);
        if let Some(axis) = axis {
            let times_noise = surprise[axis].sqrt();
            let left = Left {
                place: format!("{}, {}", COMPONENTS[axis], follows(means, axis, &residuals[axis].ent)),
                rms_nt: times_noise * means.mean_noise_nt(&means.row_std(model, all))[axis],
                times_noise,
                like: LeftLike::Disagreement,
            };
            return Rest { left: Some(left), open };
        }
        let most = standing_out(means, all).into_iter().max_by(|a, b| a.times().total_cmp(&b.times()));
        let left = most.map(|most| Left {
            place: format!("{}, at {} s", COMPONENTS[most.axis], most.times_s(means)),
            rms_nt: most.largest_ent * prepared.nt_per_ent[most.axis],
            times_noise: most.times(),
            like: LeftLike::Plateaus,
        });
        return Rest { left, open };
    }
    let (like, along) = if is_scatter {
        (LeftLike::Scatter, follows(means, axis, &residuals[axis].ent))
    } else if is_gain {
        (LeftLike::SlowGain, "along the gain with time".to_owned())
    } else if is_slow {
        (LeftLike::Slow, "along the time".to_owned())
    } else {
        (LeftLike::Disagreement, follows(means, axis, &residuals[axis].ent))
    };
    let rms_nt = times[axis] * white_ent[axis] * prepared.nt_per_ent[axis];
    let place = format!("{}, {along}", COMPONENTS[axis]);
    // Whatever was named there did not close the gap either.
    let open = std::array::from_fn(|a| open[a] || a == axis);
    Rest { left: Some(Left { place, rms_nt, times_noise: times[axis], like }), open }
}

/// Plateaus of an axis that a model leaves far from the others.
pub(super) struct StandingOut {
    /// Axis of the sensor.
    pub axis: usize,
    /// Their rows.
    rows: Vec<usize>,
    /// The largest of what is left of them, and the robust standard deviation of all, enT.
    largest_ent: f64,
    std_ent: f64,
}

impl StandingOut {
    /// The largest over the standard deviation.
    fn times(&self) -> f64 {
        self.largest_ent / self.std_ent
    }

    /// When they are, s since the run's start, in words.
    pub fn times_s(&self, means: &Means) -> String {
        let time = |row: &usize| format!("{:.0}", means.prepared.record.rows[*row].t_s());
        self.rows.iter().map(time).collect::<Vec<String>>().join(", ")
    }
}

/// Plateaus that the final model leaves far from the others: one that was disturbed is no effect, and hardly makes them scatter more. Of many it does.
pub(super) fn standing_out(means: &Means, all: &[&Candidate]) -> Vec<StandingOut> {
    let one = |(axis, left): (usize, Residuals)| {
        let std_ent = robust_std(left.ent.iter().copied());
        let rows = beyond_tails(left.ent.as_slice(), std_ent);
        let is_told = std_ent > 0.0 && left.freedom >= LEAST_FREEDOM && (1..=MOST_OUTLIERS).contains(&rows.len());
        is_told.then(|| StandingOut { axis, rows, largest_ent: left.ent.amax(), std_ent })
    };
    means.residuals(all).into_iter().enumerate().filter_map(one).collect()
}

/// Rows that are [`OUTLIER`] standard deviations off; where the noise has heavy tails that reach as far, those that are [`FAR_OFF`].
fn beyond_tails(left_ent: &[f64], std_ent: f64) -> Vec<usize> {
    let beyond = |times: f64| (0..left_ent.len()).filter(|row| left_ent[*row].abs() > times * std_ent).collect::<Vec<usize>>();
    let rows = beyond(OUTLIER);
    let has_tails = beyond(OF_TAILS * OUTLIER).len() > 2 * rows.len();
    if has_tails { beyond(FAR_OFF) } else { rows }
}

/// Mean white variance of the rows over that of the usual one.
fn mean_white(means: &Means, axis: usize) -> f64 {
    let white = &means.prepared.white;
    white.iter().map(|w| w[axis]).sum::<f64>() / white.len() as f64
}

/// What is left of an axis at its largest reading, in multiples of the white noise, where it grows with the reading.
fn at_largest(means: &Means, residuals: &Residuals, white_ent: f64, axis: usize) -> f64 {
    let record = &means.prepared.record;
    let most_ent = record.most_ent(axis).max(f64::MIN_POSITIVE);
    // Least squares with the squares of the reading: of what is left the fit took a part.
    let kept = residuals.ent.len() as f64 / residuals.freedom;
    let (mut along, mut square) = (0.0, 0.0);
    for (row, left) in record.rows.iter().zip(residuals.ent.iter()) {
        let part = (row.linear_ent[axis] / most_ent).powi(2);
        along += part * (kept * left * left - white_ent * white_ent);
        square += part * part;
    }
    let gain = if square > 0.0 { (along / square).max(0.0) } else { 0.0 };
    (1.0 + gain / (white_ent * white_ent).max(f64::MIN_POSITIVE)).sqrt()
}

/// The covariate that what is left on an axis follows best, if that is no chance.
fn follows(means: &Means, axis: usize, left: &DVector<f64>) -> String {
    let n = left.len();
    // A function of time is no candidate of its own: a drift of the offset is.
    let time = Covariate::all(&means.prepared.record).into_iter().find(|c| c.name == TIME);
    let of_time = time.and_then(|t| t.smooth(&means.prepared.record, axis));
    let of_time = of_time.map(|columns| Candidate::of_readings(UNKNOWN, Spec::new(TIME, &[axis]), columns));
    let unknown = means.candidates.iter().filter(|c| c.effect.is_unknown() && c.spec.axes == [axis]);
    let own: Vec<&Candidate> = unknown.chain(&of_time).collect();
    let design = orthonormal(&means.prepared.design, None, INDEPENDENT);
    let explained = |candidate: &&Candidate| {
        let columns: DMatrix<f64> = candidate.columns.rows(axis * n, n).into_owned();
        let beside = &columns - &design * design.tr_mul(&columns);
        let base = orthonormal(&beside, Some(&columns), INDEPENDENT);
        let (count, squares) = (base.ncols() as f64, base.tr_mul(left).norm_squared());
        let freedom = n as f64 - design.ncols() as f64 - count;
        let ratio = squares / count / ((left.norm_squared() - squares) / freedom);
        if count > 0.0 && freedom > 0.0 { fisher_tail(ratio, [count, freedom]) } else { 1.0 }
    };
    let all = own.iter().map(|c| (explained(c), c.covariate.as_deref().unwrap_or_default()));
    let best = all.min_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(p, _)| p * (own.len() as f64) < FALSE_ALARM)
        .map_or_else(|| "along no covariate of the run".to_owned(), |(_, covariate)| format!("along the {covariate}"))
}

/// A column that keeps less than this part of itself beside the model is one of the model.
const INDEPENDENT: f64 = 1e-6;

/// Disagreement on held-out stretches: without terms, with the first, with the first two, and so on. `steps` are the numbers of the steps of
/// the terms, from 1; `before` are steps that are in the readings or the model already. Terms without which the next ones predict worse than
/// nothing are taken together with these, so that the chain falls.
pub(super) fn chain(means: &Means, model: &MeansModel, all: &[&Candidate], steps: &[usize], before: Vec<usize>) -> Vec<Link> {
    let given = all.len() - steps.len();
    let cells = 3.0 * means.prepared.readings.nrows() as f64;
    let link = |steps: Vec<usize>, held: &HeldOut| Link { steps, chi2_per_dof: held.sum / cells, rms_nt: held.weighted_rms_nt() };
    let with = |count: usize| means.predicted(&model.noise, &all[..given + count]);
    let mut links = vec![link(before, &with(0))];
    let mut waiting: Vec<usize> = Vec::new();
    for (count, step) in steps.iter().enumerate() {
        if !waiting.contains(step) {
            waiting.push(*step);
        }
        let next_is_same = steps.get(count + 1) == Some(step);
        let held = with(count + 1);
        let falls = links.last().is_some_and(|last| held.sum / cells <= last.chi2_per_dof);
        if (falls && !next_is_same) || count + 1 == steps.len() {
            links.push(link(std::mem::take(&mut waiting), &held));
        }
    }
    links
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    /// 400 plateaus with the noise of Student's distribution with three degrees of freedom, and as many of normal noise of which two are disturbed by
    /// twelve and thirty standard deviations.
    #[test]
    fn plateaus_stand_out_of_normal_noise_and_none_of_heavy_tails() {
        let mut random = Random::seeded(31);
        let (mut far, mut told) = (0, 0);
        for _ in 0..200 {
            let mut student = || {
                let squares: f64 = (0..3).map(|_| random.gaussian().powi(2)).sum();
                random.gaussian() / (squares / 3.0).sqrt()
            };
            let heavy: Vec<f64> = (0..400).map(|_| student()).collect();
            let std = robust_std(heavy.iter().copied());
            far += usize::from(heavy.iter().any(|v| v.abs() > OUTLIER * std));
            told += usize::from(!beyond_tails(&heavy, std).is_empty());
            let mut normal: Vec<f64> = (0..400).map(|_| random.gaussian()).collect();
            (normal[17], normal[230]) = (12.0, -30.0);
            assert_eq!(beyond_tails(&normal, robust_std(normal.iter().copied())), [17, 230]);
        }
        // Of 400 such values 1.2 are expected beyond eight robust standard deviations, and eight beyond four.
        assert!(far > 115 && told < 10, "{told} of {far}");
    }
}
