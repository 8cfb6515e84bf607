//! The candidates of a frequency run beside a fitted response: their scores, the price of trying them, and their best forms.

use super::model::{Fit, Term};
use super::sines::Sines;
use super::{DOUBTFUL, FALSE_ALARM, Found};
use crate::fit::aicc;
use crate::fit::scan::orthonormal;
use crate::fit::statistics::fisher_tail;
use crate::model::effects::{Catalogue, EffectRef};
use nalgebra::{DMatrix, DVector};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rayon::prelude::*;

/// Draws of noise for the price of the trials.
const DRAWS: usize = 1000;
/// A column of which less than this part is left beside others is one of them.
const ROUNDING: f64 = 1e-6;

/// A candidate with what the base leaves of its columns.
pub struct Entry {
    pub term: Term,
    pub hz: f64,
    /// Columns without what the base takes of them, at right angles and of unit length.
    pub base: DMatrix<f64>,
    /// Length of the first column after that.
    pub norm: f64,
}

/// All candidates beside a fit, and the price of trying them.
pub struct Bank {
    pub entries: Vec<Entry>,
    /// Independent trials that make as many false alarms.
    independent: f64,
}

/// A candidate by its score.
pub struct Hit {
    pub p_value: f64,
}

impl Bank {
    pub fn new(base: &Fit, sines: &Sines, catalogue: &Catalogue, found: &[Found]) -> Self {
        // What was found is not looked for again, what is known only in the same form.
        let is_new = |term: &Term| {
            !found.iter().any(|f| f.term.effect == term.effect) && !base.model.terms.iter().any(|t| t.is_like(term))
        };
        let corner_hz = base.model.corner_hz(&base.p);
        let mut effects: Vec<EffectRef> = catalogue.iter().collect();
        effects.sort_by_key(|effect| effect.changes());
        let of_effect = |effect: EffectRef| {
            let forms = effect.sine_terms(&sines.run, corner_hz).into_iter();
            forms.map(move |form| Term::new(effect, form))
        };
        let of_poles = |term: Term| {
            let poles_hz = if term.has_pole() { term.poles_hz() } else { vec![0.0] };
            poles_hz.into_iter().map(move |hz| (term.clone(), hz))
        };
        let terms: Vec<(Term, f64)> =
            effects.into_iter().flat_map(of_effect).filter(|term| is_new(term)).flat_map(of_poles).collect();
        let taken = orthonormal(&base.jacobian, None, ROUNDING);
        let entries: Vec<Entry> = terms
            .into_par_iter()
            .map(|(term, hz)| {
                let columns = DMatrix::from_columns(&base.columns(&term, hz, sines));
                let left = &columns - &taken * taken.tr_mul(&columns);
                let norm = left.column(0).norm();
                Entry { term, hz, base: orthonormal(&left, Some(&columns), ROUNDING), norm }
            })
            .filter(|e| e.base.ncols() > 0)
            .collect();
        let mut bank = Self { entries, independent: 1.0 };
        let rows = base.residual.len();
        let mut least: Vec<f64> = (0..DRAWS)
            .into_par_iter()
            .map(|draw| {
                let mut random = Xoshiro256PlusPlus::seed_from_u64(draw as u64);
                let noise = DVector::from_fn(rows, |_, _| StandardNormal.sample(&mut random));
                let left = &noise - &taken * taken.tr_mul(&noise);
                let dof = base.dof();
                // The largest of equally many columns has the least probability.
                let mut largest = [0.0_f64; 4];
                bank.entries
                    .iter()
                    .for_each(|e| largest[e.base.ncols().min(3)] = largest[e.base.ncols().min(3)].max(e.drop(&left)));
                let squares = left.norm_squared();
                (1..=3).map(|count| tail(largest[count], count as f64, squares, dof)).fold(1.0, f64::min)
            })
            .collect();
        least.sort_by(f64::total_cmp);
        let at = (FALSE_ALARM * DRAWS as f64) as usize;
        bank.independent = (FALSE_ALARM / least[at].max(f64::MIN_POSITIVE)).max(1.0);
        bank
    }

    /// The effects that have candidates, in their order.
    pub fn effects(&self) -> Vec<EffectRef> {
        let mut all: Vec<EffectRef> = Vec::new();
        for effect in self.entries.iter().map(|e| e.term.effect) {
            if !all.contains(&effect) {
                all.push(effect);
            }
        }
        all
    }

    pub fn best(&self, base: &Fit) -> Option<Hit> {
        let all = self.entries.iter().map(|e| e.p_value(&base.residual, base.dof()));
        all.min_by(f64::total_cmp).map(|p_value| Hit { p_value })
    }

    /// Probability that noise alone gives any candidate as small a probability.
    pub fn corrected(&self, p_value: f64) -> f64 {
        (-(self.independent * (-p_value).ln_1p()).exp_m1()).max(p_value).clamp(f64::MIN_POSITIVE, 1.0)
    }

    /// How much two fitted candidates look alike beside the base.
    pub fn alike(base: &Fit, a: &Refined, b: &Refined, sines: &Sines) -> f64 {
        let change = |r: &Refined| {
            let taken = orthonormal(&base.jacobian, None, ROUNDING);
            let values = &r.fit.p[base.p.len()..];
            let hz = values.get(1).map_or(0.0, |l| l.exp());
            let columns = base.columns(&r.term, hz, sines);
            let sum = columns.iter().zip(values).fold(DVector::zeros(base.residual.len()), |s, (c, v)| s + c * *v);
            let left = &sum - &taken * taken.tr_mul(&sum);
            left.normalize()
        };
        change(a).dot(&change(b)).abs()
    }
}

impl Entry {
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
    /// Probability that noise alone makes a fit with more terms as much better than this one; trials of poles are counted elsewhere.
    pub fn p_value_of(&self, better: &Fit) -> f64 {
        let poles = |fit: &Fit| fit.model.terms.iter().filter(|t| t.has_pole()).count();
        let count = better.p.len() - self.p.len() - (poles(better) - poles(self));
        tail((self.chi2 - better.chi2).max(0.0), count as f64, self.chi2, self.dof())
    }
}

/// A candidate that was fitted with everything else.
pub struct Refined {
    pub term: Term,
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
pub fn refined(base: &Fit, bank: &Bank, sines: &Sines) -> Vec<Refined> {
    let effects = bank.effects();
    let strong = base.chi2 > DOUBTFUL * base.dof();
    let mut all: Vec<Refined> = effects
        .par_iter()
        .flat_map_iter(|effect| {
            let mut own: Vec<(f64, &Entry)> = bank
                .entries
                .iter()
                .filter(|e| e.term.effect == *effect)
                .map(|e| (e.p_value(&base.residual, base.dof()), e))
                .collect();
            own.sort_by(|a, b| a.0.total_cmp(&b.0));
            let fits = own.iter().take(3).flat_map(move |(_, entry)| {
                let mut starts: Vec<Vec<f64>> = vec![vec![0.0; entry.term.count()]];
                if entry.hz > 0.0 {
                    let column = &base.columns(&entry.term, entry.hz, sines)[0];
                    let size = entry.base.column(0).dot(&base.residual) / entry.base.column(0).dot(column);
                    starts[0] = vec![size.clamp(-0.9, 1.2), entry.hz.ln()];
                    if strong {
                        starts.extend([60.0_f64, 200.0, 800.0, 3000.0].map(|hz| vec![1.0, hz.ln()]));
                    }
                }
                starts
                    .into_iter()
                    .filter_map(|s| Some((entry.term.clone(), base.with(&entry.term, &s, sines)?)))
                    .collect::<Vec<_>>()
            });
            let fits = fits.filter(|(term, fit)| term.is_told(&fit.p[base.p.len()..], &sines.run));
            let scored = fits.filter_map(|(term, fit)| Some((aicc(fit.chi2, fit.p.len(), fit.residual.len())?, term, fit)));
            let best = scored.min_by(|a, b| a.0.total_cmp(&b.0));
            best.map(|(aicc, term, fit)| Refined { term, fit, aicc }).into_iter()
        })
        .collect();
    let scale = all.iter().map(|r| r.fit.chi2 / r.fit.dof()).fold(f64::INFINITY, f64::min).max(1.0);
    for r in &mut all {
        r.aicc = aicc(r.fit.chi2 / scale, r.fit.p.len(), r.fit.residual.len()).unwrap_or(f64::INFINITY);
    }
    all.sort_by(|a, b| a.aicc.total_cmp(&b.aicc));
    all
}
