//! The candidates of a frequency run beside a fitted response: their scores, the price of trying them, and their best forms. A candidate is
//! scored by its linear part; the poles of the most promising ones are fitted.

use super::DOUBTFUL;
use super::model::{EffectTerm, Fit};
use super::sines::Sines;
use crate::fit::aicc;
use crate::fit::scan::orthonormal;
use crate::fit::statistics::fisher_tail;
use crate::model::effects::{Catalogue, EffectRef};
use nalgebra::{DMatrix, DVector};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rayon::prelude::*;

/// Forms of an effect that are fitted with all parameters.
const FITTED: usize = 3;
/// Starts of a fit with a free quality: it has several minima.
const FITTED_FREE: usize = 6;
/// Parts of the field that pass poles from which a fit starts: a linear score says little about larger ones.
const LEAST_PART: f64 = -0.9;
const MOST_PART: f64 = 1.2;
/// Further poles from which a fit starts, Hz: a few per decade over the range of sampled sines.
const FURTHER_POLES_HZ: [f64; 4] = [60.0, 200.0, 800.0, 3000.0];
/// Qualities of two poles from which a fit starts where they are free.
const FURTHER_QUALITIES: [f64; 3] = [0.5, 0.65, 0.8];
/// The lowest poles from which such a fit starts, over the lowest that are allowed.
const BESIDE_LOWEST: f64 = 1.1;
/// Probability with which noise alone may tell as much of what a form takes for given.
const TOLD: f64 = 0.005;
/// Draws of noise for the price of the trials.
const DRAWS: usize = 1000;
/// A column of which less than this part is left beside others is one of them.
const ROUNDING: f64 = 1e-6;

/// A candidate beside a fit, with what the fit leaves of its columns.
pub struct ScoredTerm {
    pub term: EffectTerm,
    pub hz: f64,
    /// Columns without what the fit takes of them, at right angles and of unit length.
    pub base: DMatrix<f64>,
    /// Length of the first column after that.
    pub norm: f64,
}

/// All candidates beside a fit, and the price of trying them.
pub struct Scored {
    pub terms: Vec<ScoredTerm>,
    /// Independent trials that make as many false alarms.
    pub independent: f64,
}

/// Probability that noise alone gives any of so many independent candidates as small a probability.
pub fn corrected(independent: f64, p_value: f64) -> f64 {
    (-(independent * (-p_value).ln_1p()).exp_m1()).max(p_value).clamp(f64::MIN_POSITIVE, 1.0)
}

/// Terms that may be missing, each with the pole it is tried with. What was found is not looked for again, what is known only in the same
/// form.
fn candidates(fit: &Fit, sines: &Sines, catalogue: &Catalogue, found: &[EffectRef]) -> Vec<(EffectTerm, f64)> {
    let is_new = |term: &EffectTerm| !found.contains(&term.effect) && !fit.model.terms.iter().any(|t| t.is_like(term));
    let corner_hz = fit.model.corner_hz(&fit.p);
    let mut effects: Vec<EffectRef> = catalogue.iter().collect();
    effects.sort_by_key(|effect| effect.changes());
    let of_effect = |effect: EffectRef| {
        let forms = effect.sine_terms(&sines.run, corner_hz).into_iter();
        forms.map(move |form| EffectTerm::new(effect, form))
    };
    let of_poles = |term: EffectTerm| {
        let poles_hz = if term.has_pole() { term.poles_hz() } else { vec![0.0] };
        poles_hz.into_iter().map(move |hz| (term.clone(), hz))
    };
    effects.into_iter().flat_map(of_effect).filter(|term| is_new(term)).flat_map(of_poles).collect()
}

impl Scored {
    /// All candidates beside a fit in which some effects were found; the price of trying them is that of noise at a level of false alarms.
    pub fn new(fit: &Fit, sines: &Sines, catalogue: &Catalogue, found: &[EffectRef], false_alarm: f64) -> Self {
        let taken = orthonormal(&fit.jacobian, None, ROUNDING);
        let terms: Vec<ScoredTerm> = candidates(fit, sines, catalogue, found)
            .into_par_iter()
            .map(|(term, hz)| {
                let columns = DMatrix::from_columns(&fit.columns(&term, &[0.0, hz.ln()], sines));
                let left = &columns - &taken * taken.tr_mul(&columns);
                let norm = left.column(0).norm();
                ScoredTerm { term, hz, base: orthonormal(&left, Some(&columns), ROUNDING), norm }
            })
            .filter(|e| e.base.ncols() > 0)
            .collect();
        let least = least_by_noise(fit, &taken, &terms);
        let at = (false_alarm * DRAWS as f64) as usize;
        let independent = (false_alarm / least[at].max(f64::MIN_POSITIVE)).max(1.0);
        Self { terms, independent }
    }

    /// The effects that have candidates, in their order.
    pub fn effects(&self) -> Vec<EffectRef> {
        let mut all: Vec<EffectRef> = Vec::new();
        for effect in self.terms.iter().map(|e| e.term.effect) {
            if !all.contains(&effect) {
                all.push(effect);
            }
        }
        all
    }

    /// The least probability that noise alone gives a candidate its score, of those that are no form of some effects.
    pub fn least_p_value(&self, fit: &Fit, ruled_out: &[EffectRef]) -> Option<f64> {
        let open = self.terms.iter().filter(|e| !ruled_out.contains(&e.term.effect));
        open.map(|e| e.p_value(&fit.residual, fit.dof())).min_by(f64::total_cmp)
    }

    /// Probability that noise alone gives any candidate as small a probability.
    pub fn corrected(&self, p_value: f64) -> f64 {
        corrected(self.independent, p_value)
    }
}

/// Least probabilities that draws of noise give any of the candidates, ascending.
fn least_by_noise(fit: &Fit, taken: &DMatrix<f64>, terms: &[ScoredTerm]) -> Vec<f64> {
    let (rows, dof) = (fit.residual.len(), fit.dof());
    let mut least: Vec<f64> = (0..DRAWS)
        .into_par_iter()
        .map(|draw| {
            let mut random = Xoshiro256PlusPlus::seed_from_u64(draw as u64);
            let noise = DVector::from_fn(rows, |_, _| StandardNormal.sample(&mut random));
            let left = &noise - taken * taken.tr_mul(&noise);
            // The largest of equally many columns has the least probability.
            let mut largest = [0.0_f64; 4];
            terms.iter().for_each(|e| largest[e.base.ncols().min(3)] = largest[e.base.ncols().min(3)].max(e.drop(&left)));
            let squares = left.norm_squared();
            (1..=3).map(|count| tail(largest[count], count as f64, squares, dof)).fold(1.0, f64::min)
        })
        .collect();
    least.sort_by(f64::total_cmp);
    least
}

impl ScoredTerm {
    /// Decrease of chi-square with it.
    fn drop(&self, residual: &DVector<f64>) -> f64 {
        self.base.tr_mul(residual).norm_squared()
    }

    fn p_value(&self, residual: &DVector<f64>, dof: f64) -> f64 {
        tail(self.drop(residual), self.base.ncols() as f64, residual.norm_squared(), dof)
    }
}

/// Probability that noise alone decreases its squares as much by so many columns.
fn tail(drop: f64, count: f64, squares: f64, dof: f64) -> f64 {
    let f = drop / count / ((squares - drop).max(f64::MIN_POSITIVE) / (dof - count));
    fisher_tail(f, [count, dof - count]).max(f64::MIN_POSITIVE)
}

impl Fit {
    /// How much two candidates that were fitted beside this fit look alike.
    pub fn correlation(&self, a: &Refined, b: &Refined, sines: &Sines) -> f64 {
        let change = |r: &Refined| {
            let taken = orthonormal(&self.jacobian, None, ROUNDING);
            let values = &r.fit.p[self.p.len()..];
            let columns = self.columns(&r.term, values, sines);
            let sum = columns.iter().zip(values).fold(DVector::zeros(self.residual.len()), |s, (c, v)| s + c * *v);
            let left = &sum - &taken * taken.tr_mul(&sum);
            left.normalize()
        };
        change(a).dot(&change(b)).abs()
    }

    /// Probability that noise alone makes a fit with more terms as much better than this one; trials of poles are counted elsewhere.
    pub fn p_value_of(&self, better: &Fit) -> f64 {
        let poles = |fit: &Fit| fit.model.terms.iter().filter(|t| t.has_pole()).count();
        let count = better.p.len() - self.p.len() - (poles(better) - poles(self));
        tail((self.chi2 - better.chi2).max(0.0), count as f64, self.chi2, self.dof())
    }
}

/// A candidate that was fitted with everything else.
pub struct Refined {
    pub term: EffectTerm,
    pub fit: Fit,
    /// In units of the noise that the best of them leaves.
    pub aicc: f64,
}

impl Refined {
    pub fn effect(&self) -> EffectRef {
        self.term.effect
    }
}

/// The best form of every effect, fitted with all parameters, best effect first.
pub fn refined(base: &Fit, scored: &Scored, sines: &Sines) -> Vec<Refined> {
    let effects = scored.effects();
    let best = |effect: &EffectRef| best_of_effect(*effect, base, scored, sines);
    let mut all: Vec<Refined> = effects.par_iter().filter_map(best).collect();
    let scale = all.iter().map(|r| r.fit.chi2 / r.fit.dof()).fold(f64::INFINITY, f64::min).max(1.0);
    for r in &mut all {
        r.aicc = aicc(r.fit.chi2 / scale, r.fit.p.len(), r.fit.residual.len()).unwrap_or(f64::INFINITY);
    }
    all.sort_by(|a, b| a.aicc.total_cmp(&b.aicc));
    all
}

/// The best form of an effect among those of the largest linear scores, and among those with what they take for given as a parameter.
fn best_of_effect(effect: EffectRef, base: &Fit, scored: &Scored, sines: &Sines) -> Option<Refined> {
    let own = scored.terms.iter().filter(|e| e.term.effect == effect);
    let mut own: Vec<(f64, &ScoredTerm)> = own.map(|e| (e.p_value(&base.residual, base.dof()), e)).collect();
    own.sort_by(|a, b| a.0.total_cmp(&b.0));
    let with_aicc =
        |(term, fit): (EffectTerm, Fit)| Some(Refined { aicc: aicc(fit.chi2, fit.p.len(), fit.residual.len())?, term, fit });
    let of_form = |e: &ScoredTerm| {
        let fits = starts(base, e, sines).into_iter().filter_map(|s| base.with(&e.term, &s, sines));
        let reported = fits.filter(|fit| e.term.is_reported(&fit.p[base.p.len()..], &sines.run));
        reported.filter_map(|fit| with_aicc((e.term.clone(), fit))).collect::<Vec<Refined>>()
    };
    let best_of = |all: Vec<Refined>| all.into_iter().min_by(|a, b| a.aicc.total_cmp(&b.aicc));
    let best = best_of(own.iter().take(FITTED).flat_map(|(_, e)| of_form(e)).collect())?;
    // Where what is taken for given is wrong, one axis may describe more by itself than all axes.
    let takes_for_given = |e: &&ScoredTerm| e.term.freed(&[0.0, e.hz.ln()]).is_some();
    let forms = own.iter().map(|(_, e)| *e).filter(takes_for_given);
    let on_most_axes = forms.min_by_key(|e| std::cmp::Reverse(e.term.axes().len())).filter(|e| !e.term.is_same(&best.term));
    let on_most_axes = on_most_axes.and_then(|e| best_of(of_form(e)));
    let fixed = || std::iter::once(&best).chain(&on_most_axes);
    let free: Vec<Refined> = fixed().filter_map(|r| with_aicc(told(base, &r.term, &r.fit, sines)?)).collect();
    best_of(free.into_iter().chain([best]).collect())
}

/// A term with what its form takes for given as a parameter, fitted, where the sines tell it: another effect would be named for the difference.
/// The best of several starts, since what is taken for wrong may lead far away.
fn told(base: &Fit, term: &EffectTerm, fit: &Fit, sines: &Sines) -> Option<(EffectTerm, Fit)> {
    let (freed, values) = term.freed(&fit.p[base.p.len()..])?;
    let taken = orthonormal(&base.jacobian, None, ROUNDING);
    let from = |hz: f64, quality: f64| {
        let mut start = vec![0.0, hz.ln(), quality.ln()];
        let column = &base.columns(&freed, &start, sines)[0];
        let left = column - &taken * taken.tr_mul(column);
        let (along, square) = (left.dot(&base.residual), left.norm_squared());
        start[0] = (along / square).clamp(LEAST_PART, MOST_PART);
        (along * along / square, start)
    };
    // The poles may lie below the first one that is tried.
    let lowest_hz = freed.pole_range_hz().map(|range| BESIDE_LOWEST * range[0]);
    let pairs = freed.poles_hz().into_iter().chain(lowest_hz).flat_map(|hz| FURTHER_QUALITIES.map(|quality| (hz, quality)));
    let mut starts: Vec<(f64, Vec<f64>)> = pairs.map(|(hz, quality)| from(hz, quality)).filter(|s| s.0.is_finite()).collect();
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    let starts = starts.into_iter().take(FITTED_FREE).map(|s| s.1).chain([values]);
    let best = starts.filter_map(|s| base.with(&freed, &s, sines)).min_by(|a, b| a.chi2.total_cmp(&b.chi2))?;
    (fit.p_value_of(&best) < TOLD).then_some((freed, best))
}

/// Values of a candidate from which it is fitted: a pole from its linear score, and where the fit without it is bad, from others as well.
fn starts(base: &Fit, scored: &ScoredTerm, sines: &Sines) -> Vec<Vec<f64>> {
    if scored.hz <= 0.0 {
        return vec![vec![0.0; scored.term.count()]];
    }
    let column = &base.columns(&scored.term, &[0.0, scored.hz.ln()], sines)[0];
    let along = scored.base.column(0);
    let size = along.dot(&base.residual) / along.dot(column);
    let mut starts = vec![vec![size.clamp(LEAST_PART, MOST_PART), scored.hz.ln()]];
    if base.chi2 > DOUBTFUL * base.dof() {
        starts.extend(FURTHER_POLES_HZ.map(|hz| vec![1.0, hz.ln()]));
    }
    starts
}
