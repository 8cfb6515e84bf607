//! The next measurement: what runs of a menu would tell between an effect and what it is confused with.
//!
//! A run of the menu has rows with covariates as they would be ([`crate::record::plan`]). With the columns of the effect, of its rivals and of
//! the linear model there, and the noise of the run that was measured, linear algebra gives the signal to noise ratio of what is left of the
//! effect beside each rival, `k √(1 - ρ²)`: from about three on their likelihoods differ by a hundred, from about five on surely.

use super::candidate::Candidate;
use super::means::{Means, MeansModel};
use super::result::{Forecast, TOLD_APART};
use crate::fit::noise::NoiseModel;
use crate::fit::scan::{ABSORBED, orthonormal};
use crate::model::effects::{EffectRef, Family};
use crate::record::plan::{self, Plan, Planned};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Columns of which the others leave less than this part depend on them.
const INDEPENDENT: f64 = 1e-6;
/// Of records with more rows than this only the best candidate of a rival is looked at: more would take its time.
const MANY_ROWS: usize = 600;

/// Whitens columns of the rows of an axis in place.
type Whiten = Box<dyn Fn(usize, &mut DMatrix<f64>) + Sync>;

/// The linear model of a run, whitened: what it leaves of columns.
struct Beside {
    noise: Whiten,
    bases: [DMatrix<f64>; 3],
    /// What it leaves of the other terms.
    others: DMatrix<f64>,
    rows: usize,
}

impl Beside {
    fn new(noise: impl NoiseModel + Sync + 'static, design: &DMatrix<f64>) -> Self {
        let bases = [0, 1, 2].map(|a| {
            let mut own = design.clone();
            noise.whiten(a, &mut own);
            orthonormal(&own, None, INDEPENDENT)
        });
        let rows = design.nrows();
        Self { bases, others: DMatrix::zeros(3 * rows, 0), rows, noise: Box::new(move |a, columns| noise.whiten(a, columns)) }
    }

    /// With other terms, which are fitted too.
    fn with(mut self, others: &[DMatrix<f64>]) -> Self {
        let mut all = DMatrix::zeros(3 * self.rows, others.iter().map(DMatrix::ncols).sum());
        let mut at = 0;
        for other in others {
            all.columns_mut(at, other.ncols()).copy_from(&self.left(other));
            at += other.ncols();
        }
        self.others = orthonormal(&all, None, INDEPENDENT);
        self
    }

    /// Whitened columns, component after component: what the linear model and the other terms leave of them.
    fn left(&self, stacked: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = stacked.clone();
        for (a, base) in self.bases.iter().enumerate() {
            let mut part = out.rows(a * self.rows, self.rows).into_owned();
            (self.noise)(a, &mut part);
            let left = &part - base * base.tr_mul(&part);
            out.rows_mut(a * self.rows, self.rows).copy_from(&left);
        }
        &out - &self.others * self.others.tr_mul(&out)
    }

    /// What is left of an effect of known size beside a rival, too: its norm is a signal to noise ratio.
    fn beside(&self, effect: &DVector<f64>, rival: &DMatrix<f64>) -> f64 {
        let left = self.left(rival);
        if left.norm() <= ABSORBED * rival.norm() {
            return effect.norm();
        }
        let base = orthonormal(&left, None, INDEPENDENT);
        (effect - &base * base.tr_mul(effect)).norm()
    }
}

/// An effect that was named, with its size and with what it may be confused with.
pub(super) struct Named<'a> {
    /// The term.
    pub candidate: &'a Candidate,
    /// The other terms, which are fitted with it.
    pub others: Vec<&'a Candidate>,
    /// Its linear parameters.
    pub values: Vec<f64>,
    /// Keys of its rivals.
    pub rivals: Vec<String>,
    /// The best candidate of each of them.
    pub best: Vec<usize>,
}

/// What each run of the menu would tell, the best first; none where none of them is possible.
pub(super) fn forecasts(means: &Means, model: &MeansModel, named: &Named) -> Vec<Forecast> {
    let Some(now) = strengths(means, model, named, None) else { return Vec::new() };
    let is_static = matches!(named.candidate.effect.about().family, Family::StaticOdd | Family::StaticEven);
    let is_on_menu = |plan: &&Plan| **plan != Plan::TestSignal || is_static;
    let forecast = |plan: &Plan| {
        let planned = plan::planned(means.prepared, *plan)?;
        let then = strengths(means, model, named, Some(&planned))?;
        let against = (0..named.rivals.len()).min_by(|a, b| then.beside[*a].total_cmp(&then.beside[*b]));
        Some(Forecast {
            measurement: plan.name(),
            words: plan.words(),
            strength_k: then.alone,
            against: against.map(|r| named.rivals[r].clone()),
            k_now: against.map_or(now.alone, |r| now.beside[r]),
            k: against.map_or(then.alone, |r| then.beside[r]),
        })
    };
    let menu: Vec<&Plan> = Plan::ALL.iter().filter(is_on_menu).collect();
    let mut all: Vec<Forecast> = menu.into_par_iter().filter_map(forecast).collect();
    // What a move would tell is known from the run once more: it stands last.
    let is_move = |forecast: &Forecast| forecast.measurement == Plan::Moved.name();
    all.sort_by(|a, b| is_move(a).cmp(&is_move(b)).then(b.k.total_cmp(&a.k)));
    all
}

/// Signal to noise ratios of an effect in a run.
struct Strengths {
    /// Beside the linear model alone.
    alone: f64,
    /// Beside each rival, too.
    beside: Vec<f64>,
}

/// In the run that was measured, or in another one.
fn strengths(means: &Means, model: &MeansModel, named: &Named, planned: Option<&Planned>) -> Option<Strengths> {
    let columns = |candidate: &Candidate| match planned {
        None => Some(candidate.columns.clone()),
        Some(next) => {
            let columns = candidate.effect.columns(&next.record, &candidate.spec)?;
            Some(Candidate::of_readings(candidate.effect, candidate.spec.clone(), columns).columns)
        }
    };
    let beside = match planned {
        None => Beside::new(model.noise.clone(), &means.prepared.design),
        Some(next) => Beside::new(means.noise_of(&model.noise, next)?, &next.design),
    };
    let others: Vec<DMatrix<f64>> = named.others.iter().filter_map(|other| columns(other)).collect();
    let beside = beside.with(&others);
    let own = columns(named.candidate)?;
    let size = DVector::from_fn(own.ncols(), |j, _| named.values.get(j).copied().unwrap_or_default());
    let signal = beside.left(&DMatrix::from_column_slice(own.nrows(), 1, (own * size).as_slice())).column(0).into_owned();
    let is_large = means.prepared.readings.nrows() > MANY_ROWS;
    let of_rival = |(key, best): (&String, &usize)| {
        let all = (0..means.candidates.len()).filter(|c| if is_large { c == best } else { means.candidates[*c].key == *key });
        let left = all.filter_map(|c| Some(beside.beside(&signal, &columns(&means.candidates[c])?)));
        left.fold(signal.norm(), f64::min)
    };
    let rivals = named.rivals.iter().zip(&named.best).map(of_rival).collect();
    Some(Strengths { alone: signal.norm(), beside: rivals })
}

/// The best of the runs in words, in front of what shows the effects in general.
pub(super) fn words(effect: EffectRef, forecasts: &[Forecast], in_general: Option<String>) -> Option<String> {
    let best = Forecast::best(forecasts).map(|best| {
        let Forecast { words, against, k, k_now, .. } = best;
        match against {
            _ if !best.tells_apart() => {
                let what = against.as_ref().map_or_else(|| format!("shows {effect}"), |rival| format!("tells {effect} from {rival}"));
                format!(
                    "none of the {} runs that were looked at {what}: k {TOLD_APART} is needed, and the best of them, {words}, gives {k:.1} (now {k_now:.1})",
                    forecasts.len()
                )
            }
            Some(rival) => format!("{words}: it would tell {effect} from {rival} with k {k:.1} (now {k_now:.1})"),
            None => format!("{words}: it would show {effect} with k {k:.1} (now {k_now:.1})"),
        }
    });
    let all: Vec<String> = best.into_iter().chain(in_general).collect();
    (!all.is_empty()).then(|| all.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::remanence::Remanence;

    fn forecast(words: &str, k: f64) -> Forecast {
        let against = Some("saturation".to_owned());
        Forecast { measurement: "run", words: words.to_owned(), strength_k: 9.0, against, k_now: 3.4, k }
    }

    /// The signal to noise ratio from which on two effects are told apart decides whether a run is said to do it.
    #[test]
    fn a_run_that_tells_nothing_apart_is_not_recommended() {
        let effect = EffectRef::new(&Remanence);
        let of = |forecasts: &[Forecast]| words(effect, forecasts, None);
        let weak = of(&[forecast("twice the field", 3.8), forecast("longer", 3.5)]).unwrap();
        assert_eq!(
            weak,
            "none of the 2 runs that were looked at tells remanence from saturation: k 5 is needed, and the best of them, twice the \
             field, gives 3.8 (now 3.4)"
        );
        // A run that tells them stands first, wherever it stands in the list.
        let strong = of(&[forecast("twice the field", 3.8), forecast("moved", 5.1)]).unwrap();
        assert_eq!(strong, "moved: it would tell remanence from saturation with k 5.1 (now 3.4)");
        // Nothing is said of runs that tell no more than the one that was measured.
        assert_eq!(of(&[forecast("the same again", 3.3)]), None);
    }
}
