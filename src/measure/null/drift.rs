//! Drift of the offset, and what the offset follows.

use super::rows::{Level, Row};
use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::data::zero_field::{ChannelDependence, JointDependence, ZeroFieldOffset};
use crate::fit::noise::dense::{self, Octave, Sampled};
use crate::fit::{DenseNoise, Design, FitError, Limits, solve};
use crate::measure::structure::{Beside, is_no_noise};
use crate::record::conditions;
use nalgebra::{DMatrix, DVector};

/// A channel whose means vary by less than this part of their size does not vary.
const LEAST_VARIATION: f64 = 1e-9;

/// Rows before the first place of a step that is looked for and behind the last one. It is looked for beside every other row: a place that is a row or
/// two beside the step leaves so much that slow noise explains it better.
const EDGE: usize = 2;

/// Coefficients of one component with their covariance.
struct Fitted {
    coefficients: DMatrix<f64>,
    /// Parameter j of component a at `a * p + j`.
    covariance: DMatrix<f64>,
    residual_std: Vec<f64>,
    /// The columns and the means of the rows that were fitted, and the noise of these.
    columns: DMatrix<f64>,
    means_ent: DMatrix<f64>,
    noise: DenseNoise,
}

/// Fits to the means of a record.
pub(super) struct Fitter<'a> {
    /// The means.
    pub rows: &'a [Row],
    /// Contrasts within them, which show slow noise.
    pub octaves: &'a [Octave],
}

impl Fitter<'_> {
    /// Least squares of all three components; rows with a gap in a column do not count.
    fn fit(&self, names: &[&str], columns: &[Vec<f64>]) -> Result<Fitted, FitError> {
        let used: Vec<usize> = (0..self.rows.len()).filter(|i| columns.iter().all(|c| c[*i].is_finite())).collect();
        let design = Design::new(
            names.iter().map(|n| (*n).to_owned()).collect(),
            DMatrix::from_fn(used.len(), columns.len(), |i, j| columns[j][used[i]]),
        )?;
        let rhs = DMatrix::from_fn(used.len(), 3, |i, c| self.rows[used[i]].mean_ent[c]);
        let counts: Vec<f64> = used.iter().map(|i| self.rows[*i].count as f64).collect();
        let mean = counts.iter().sum::<f64>() / counts.len().max(1) as f64;
        let weights: Vec<f64> = counts.iter().map(|n| n / mean).collect();
        let solution = solve(&design, &rhs, Some(&weights), &Limits::default())?;
        let intervals: Vec<[f64; 2]> = used.iter().map(|i| self.rows[*i].interval_s).collect();
        let noise = dense::estimate_with(
            &solution,
            &Sampled { intervals: &intervals, counts: &counts, octaves: self.octaves, scatter: None, group: None },
        )?;
        Ok(Fitted {
            covariance: noise.covariance(),
            residual_std: solution.residual_std.clone(),
            coefficients: solution.coefficients,
            columns: design.columns().clone(),
            means_ent: rhs,
            noise,
        })
    }

    /// The drift, a polynomial of `(t - centre) / half`.
    pub fn drift(&self, order: usize, centre_s: f64, half_s: f64) -> Result<Drift, FitError> {
        let x: Vec<f64> = self.rows.iter().map(|r| (r.t_s() - centre_s) / half_s).collect();
        let names = &["mean", "drift", "drift^2", "drift^3"][..=order];
        let columns: Vec<Vec<f64>> = (0..=order as i32).map(|k| x.iter().map(|x| x.powi(k)).collect()).collect();
        let fit = self.fit(names, &columns)?;
        let p = order + 1;
        let std = |c: usize, j: usize| fit.covariance[(c * p + j, c * p + j)].sqrt();
        let per_h = |j: usize| (3600.0 / half_s).powi(j as i32);
        let values = |j: usize| std::array::from_fn(|c| fit.coefficients[(j, c)] * per_h(j));
        let stds = |j: usize| std::array::from_fn(|c| std(c, j) * per_h(j));
        let at = |x: f64, c: usize| {
            let value = (0..p).map(|j| fit.coefficients[(j, c)] * x.powi(j as i32)).sum();
            let variance: f64 = (0..p)
                .flat_map(|j| (0..p).map(move |k| (j, k)))
                .map(|(j, k)| fit.covariance[(c * p + j, c * p + k)] * x.powi((j + k) as i32))
                .sum();
            [value, variance.sqrt()]
        };
        let drift = x.iter().map(|x| std::array::from_fn(|c| at(*x, c))).collect();
        let range = |c: usize| {
            let means = self.rows.iter().map(|r| r.mean_ent[c]);
            means.clone().fold(f64::NEG_INFINITY, f64::max) - means.fold(f64::INFINITY, f64::min)
        };
        let offset = ZeroFieldOffset {
            time_s: centre_s,
            order,
            mean_ent: values(0),
            mean_std_ent: stds(0),
            drift_ent_per_h: (1..p).map(values).collect(),
            drift_std_ent_per_h: (1..p).map(stds).collect(),
            residual_std_ent: std::array::from_fn(|c| fit.residual_std[c]),
            range_ent: std::array::from_fn(range),
            rows: self.rows.len(),
            std_covers: Some(covers(2.0 * half_s)),
        };
        let note = self.undescribed(&fit, &x, names, &columns, [centre_s, half_s]);
        Ok(Drift { offset, levels: drift, note })
    }

    /// Says of a component that does not follow its drift: a power of the time, or a step, stands out of the noise. The noise of the drift alone may
    /// have taken it for slow noise, so that what stands out most is judged by the noise beside it.
    fn undescribed(
        &self,
        fit: &Fitted,
        x: &[f64],
        names: &[&str],
        columns: &[Vec<f64>],
        [centre_s, half_s]: [f64; 2],
    ) -> Option<Note> {
        let order = columns.len() - 1;
        let trials: Vec<Lacking> = Lacking::all(order, x).collect();
        let beside = Beside::of(&fit.columns, &fit.means_ent, &fit.noise);
        let judged = (0..3).filter_map(|c| {
            let explained = beside.explained(c, trials.iter().map(|trial| DVector::from_vec(trial.column(x))));
            let best =
                (0..trials.len()).filter(|k| explained[*k].is_finite()).max_by(|a, b| explained[*a].total_cmp(&explained[*b]))?;
            let with =
                self.fit(&[names, &["what the drift lacks"]].concat(), &[columns, &[trials[best].column(x)]].concat()).ok()?;
            let p = order + 2;
            let at = c * p + p - 1;
            let score = with.coefficients[(p - 1, c)].abs() / with.covariance[(at, at)].sqrt();
            Some((c, trials[best], score))
        });
        let (component, lacking, score) = judged.filter(|(.., score)| score.is_finite()).max_by(|a, b| a.2.total_cmp(&b.2))?;
        if !is_no_noise(score, x.len().saturating_sub(order + 2), 3 * trials.len()) {
            return None;
        }
        let what = match lacking {
            Lacking::Power(power) => format!("a drift of order {power}"),
            Lacking::Step(place) => format!("a step at about {:.0} s", centre_s + half_s * place),
        };
        let name = COMPONENTS[component];
        let text = format!(
            "the means of {name} do not follow a drift of order {order}: {what} stands out of the noise by {score:.1} standard deviations; mean and \
             drift, and their uncertainties, are without it"
        );
        let note = Note::new(NoteKind::Method, text).about(name);
        Some(note.with_remedy("look at the record, give another order with --order, or leave a part out with --exclude"))
    }

    /// The means against one channel; `None` if that does not vary.
    pub fn channel(&self, name: &str, unit: &str, values: &[f64]) -> Option<ChannelDependence> {
        let (centred, spread) = centred(values)?;
        let fit = self.fit(&["mean", name], &[vec![1.0; values.len()], centred.clone()]).ok()?;
        let correlation = |c: usize| {
            let pairs: Vec<(f64, f64)> =
                centred.iter().zip(self.rows).filter(|(x, _)| x.is_finite()).map(|(x, r)| (*x, r.mean_ent[c])).collect();
            let mean = pairs.iter().map(|(_, y)| y).sum::<f64>() / pairs.len() as f64;
            let product: f64 = pairs.iter().map(|(x, y)| x * (y - mean)).sum();
            let squares: f64 = pairs.iter().map(|(_, y)| (y - mean).powi(2)).sum();
            product / (squares * pairs.iter().map(|(x, _)| x * x).sum::<f64>()).sqrt()
        };
        Some(ChannelDependence {
            name: name.to_owned(),
            unit: unit.to_owned(),
            range: spread,
            coefficient_ent: std::array::from_fn(|c| fit.coefficients[(1, c)]),
            coefficient_std_ent: std::array::from_fn(|c| fit.covariance[(c * 2 + 1, c * 2 + 1)].sqrt()),
            correlation: std::array::from_fn(correlation),
        })
    }

    /// The means against several channels at once; `None` if they cannot be told apart.
    pub fn together(&self, channels: &[&(String, Vec<f64>)]) -> Option<JointDependence> {
        let mut names = vec!["mean"];
        let mut columns = vec![vec![1.0; self.rows.len()]];
        for (name, values) in channels {
            names.push(name);
            columns.push(centred(values)?.0);
        }
        let fit = self.fit(&names, &columns).ok()?;
        let p = names.len();
        Some(JointDependence {
            channels: channels.iter().map(|(name, _)| name.clone()).collect(),
            coefficient_ent: (1..p).map(|j| std::array::from_fn(|c| fit.coefficients[(j, c)])).collect(),
            coefficient_std_ent: (1..p).map(|j| std::array::from_fn(|c| fit.covariance[(c * p + j, c * p + j)].sqrt())).collect(),
            residual_std_ent: std::array::from_fn(|c| fit.residual_std[c]),
        })
    }
}

/// The drift of a record.
pub(super) struct Drift {
    /// Mean and drift.
    pub offset: ZeroFieldOffset,
    /// Value and uncertainty of the drift at every row.
    pub levels: Vec<Level>,
    /// What the drift does not describe.
    pub note: Option<Note>,
}

/// What a drift may lack.
#[derive(Clone, Copy)]
enum Lacking {
    /// A power of the time.
    Power(usize),
    /// A step at a place from -1 to 1.
    Step(f64),
}

impl Lacking {
    /// Everything that is looked for beside a drift of some order in rows at times from -1 to 1.
    fn all(order: usize, x: &[f64]) -> impl Iterator<Item = Self> {
        let places = EDGE..x.len().saturating_sub(EDGE - 1);
        let steps = places.map(|row| Self::Step(0.5 * (x[row - 1] + x[row])));
        [order + 1, order + 2].map(Self::Power).into_iter().chain(steps)
    }

    /// Its column at times from -1 to 1.
    fn column(self, x: &[f64]) -> Vec<f64> {
        let value = |x: f64| match self {
            Self::Power(power) => x.powi(power as i32),
            Self::Step(place) => f64::from(u8::from(x > place)),
        };
        x.iter().map(|x| value(*x)).collect()
    }
}

/// For which noise the uncertainties of a record in zero field hold: it has one setting.
fn covers(seconds: f64) -> String {
    format!(
        "{}; an error of the field that is the same during all of it, as where every setting of a source is a little wrong, does not show \
         either: it is one of the residual field, which is part of the mean",
        conditions::noise_in_std(seconds, "the record")
    )
}

/// Values less their mean, with their range; `None` if they hardly vary or are few.
fn centred(values: &[f64]) -> Option<(Vec<f64>, f64)> {
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    let (low, high) = known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let varies = known.len() >= 8 && high - low > LEAST_VARIATION * mean.abs().max(1.0);
    varies.then(|| (values.iter().map(|v| v - mean).collect(), high - low))
}
