//! An amplitude of the field that drifts, in place of what a response does. Where the frequencies follow each other from low to high or back, time is the
//! frequency under another name: a source that gets weaker looks like a sensor that reads less.

use super::candidates::Refined;
use super::model::{EffectTerm, Fit};
use super::sines::Sines;
use crate::diagnose::APART;
use crate::diagnose::result::RunnerUp;
use crate::fit::aicc;
use crate::model::effects::in_sine::{SineParameter, SineRun, SineTerm, Triple};
use crate::model::effects::{Spec, UNKNOWN};
use std::sync::Arc;

/// Highest degree of the drift that is tried.
const HIGHEST_DEGREE: usize = 3;
/// What is told of it.
const NAME: &str = "amplitude with time";

/// The logarithm of the amplitude of the field as a polynomial of the run time, of a degree, over the length of the run.
#[derive(Debug)]
struct AmplitudeInTime(usize);

impl SineTerm for AmplitudeInTime {
    fn kind(&self) -> &'static str {
        NAME
    }

    fn form(&self) -> String {
        NAME.to_owned()
    }

    fn count(&self) -> usize {
        self.0
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, _i: usize, to: &mut Triple) {
        let u = run.settings[j].middle_s / run.length_s;
        to[0] += p.iter().take(self.0).enumerate().map(|(k, c)| c * u.powi(k as i32 + 1)).sum::<f64>();
    }

    fn is_of_timing(&self) -> bool {
        false
    }

    fn report(
        &self,
        _run: &SineRun,
        _p: &[f64],
        _std: &dyn Fn(usize) -> Option<f64>,
        _correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>) {
        (Spec::new(NAME, &self.axes()), Vec::new())
    }

    fn limit(&self, _run: &SineRun, least: f64, _hz: f64) -> String {
        format!("{NAME} by {least:.1e} of it")
    }
}

/// A drift of the amplitude of the field that describes the sines as well as the best candidate beside `fit` does; none of what changes their times.
pub(super) fn rival(fit: &Fit, best: &Refined, sines: &Sines) -> Option<RunnerUp> {
    if best.term.is_of_timing() {
        return None;
    }
    let drift = |degree: usize| {
        let term = EffectTerm::new(UNKNOWN, Arc::new(AmplitudeInTime(degree)));
        let fit = fit.with(&term, &vec![0.0; degree], sines)?;
        Some(Refined { term, fit, aicc: f64::INFINITY })
    };
    let drifts: Vec<Refined> = (1..=HIGHEST_DEGREE).filter_map(drift).collect();
    let noise = drifts.iter().chain([best]).map(|r| r.fit.chi2 / r.fit.dof()).fold(f64::INFINITY, f64::min).max(1.0);
    let of = |r: &Refined| aicc(r.fit.chi2 / noise, r.fit.p.len(), r.fit.residual.len()).unwrap_or(f64::INFINITY);
    let drift = drifts.iter().min_by(|a, b| of(a).total_cmp(&of(b)))?;
    let log_ratio = 0.5 * (of(best) - of(drift));
    let effect = format!("{UNKNOWN}: {NAME}");
    (log_ratio > -APART).then(|| RunnerUp { effect, log_ratio, correlation: fit.correlation(best, drift, sines) })
}
