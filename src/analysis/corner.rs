//! The -3 dB corner of the AC response from a table of amplitudes, in two ways (mathematics.md section 3).
//!
//! * **igep**, as in the printed tables of 2013: the level in dB relative to the largest amplitude, and a straight line in (f, dB)
//!   between the two neighbours of -3 dB (not of `1/√2`, which is 0.01 dB lower and 0.08 Hz further up). Low readings cross that
//!   level several times: the crossing is the last one, found from the high frequencies.
//! * **model**: the response of [`RESPONSES`] with the least AICc, summed over the components, and where it has fallen to `1/√2` of
//!   its DC gain.
//!
//! # Errors of the amplitudes
//!
//! None of the responses describes a real table within its noise. What the best leaves in the tables of 2013 is 0.1 to 0.4 % of the
//! DC amplitude down to -10 dB and 5 to 7 % below, where the lobes of a digital filter are not those of the textbook; and stretches
//! with lost samples give amplitudes that are far too low. Residuals are therefore taken in amplitude, not in its logarithm, and
//! the fit ([`contaminated`]) estimates one scatter above -10 dB, another one of at least 5 % of DC below, and the probability that a
//! row belongs at all. Given standard deviations add to that scatter. The lobes thus choose between responses that do equally well
//! at the corner, and do not move it: with a free scatter the fits of x and y of 13-04-03-12-59-48 follow the lobes, call the good
//! reading at 100 Hz an outlier, and have the corner 0.2 and 0.5 Hz further up.
//!
//! # Uncertainty
//!
//! What a response leaves is systematic: the linearised covariance takes it for noise of independent rows, and knows nothing of the
//! choice of the model. The jackknife leaves one amplitude out at a time, chooses again, and has both in its spread,
//! `sqrt((n-1)/n Σ (θ_i - mean)²)`; but with few rows around the corner it may come out too small by chance. The larger of the two
//! is given. By its construction hardly any single amplitude can move the corner by more than one standard deviation.
//!
//! Neither knows of several rows that are missing together. Where lost samples spoil most of the rows around the corner, another
//! response may fit what is left: [`ModelCorner::neighbours_left_out`] counts them.

use crate::fit::contaminated::{self, Contaminated, Data, State};
use crate::fit::nonlinear::Model;
use crate::fit::{FitError, Limits, aicc};
use crate::model::response::{Parameter, RESPONSES, Response};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Serialize, Serializer};
use std::f64::consts::FRAC_1_SQRT_2;

/// Level of the corner by interpolation, dB.
const IGEP_LEVEL_DB: f64 = -3.0;
/// An amplitude of fewer standard deviations is not detected.
const DETECTED: f64 = 3.0;
/// Level above which amplitudes decide, relative to DC: -10 dB.
const DECIDING: f64 = 0.316_227_766_016_837_94;
/// Amplitudes above and below that level needed to tell their scatter apart: below those numbers a response could follow either.
const FEWEST_IN_GROUP: [usize; 2] = [12, 4];
/// Scatter above and below that level is not estimated below this share of the DC amplitude: rounding, and the lobes of the tables
/// of 2013, which a response can follow only where it gives up rows at the corner.
const LEAST_SCATTER: [f64; 2] = [1e-6, 0.05];
/// Scatter at the start: what is within is followed, what is without does not belong. The wide one is for starts far off.
const START_SCATTER: [[f64; 2]; 2] = [[0.02, 0.05], [0.08, 0.08]];
/// Share of the outliers that read too low: what is lost or mixed with another setting lowers an amplitude. A response through low
/// readings that leaves the good ones above it is hardly possible then.
const OUTLIERS_BELOW: f64 = 0.98;
/// Factors on the corner at the start.
const START_CORNER: [f64; 3] = [1.0, 0.85, 1.18];
/// First and last crossing of -3 dB are both tried if they differ by more than this factor.
const APART: f64 = 1.3;
/// Iterations before the best starts are chosen.
const FIRST_ITERATIONS: usize = 2;
/// As many starts are followed to the end.
const STARTS_CONTINUED: usize = 2;
/// Iterations after.
const ITERATIONS: usize = 200;
/// A response that makes outliers of more than this share of the rows does not describe them.
const MOST_OUTLYING: f64 = 0.4;
/// Responses whose AICc exceeds the least by no more stay in the choice when a row is left out.
const CONTENDERS: f64 = 30.0;

/// How the corner is found.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The responses to choose from.
    pub responses: Vec<Response>,
    /// Leave out one row at a time. Without, standard deviations are those of the linearised covariance, which are too small for
    /// tables that no response describes.
    pub jackknife: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { responses: RESPONSES.to_vec(), jackknife: true }
    }
}

/// One row of the table of amplitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Amplitude {
    /// Frequency of the field, Hz.
    pub frequency_hz: f64,
    /// Amplitudes, enT; a component without one has NaN.
    pub amplitude_ent: [f64; 3],
    /// Their standard deviations, enT; NaN where unknown.
    pub std_ent: [f64; 3],
    /// Whether the row counts.
    pub usable: bool,
}

/// Why a component has no corner.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// No row is usable with a positive amplitude.
    #[error("no amplitude is positive")]
    NoAmplitude,
    /// The highest frequency is still above -3 dB.
    #[error("the amplitudes do not fall below -3 dB up to {highest_hz} Hz")]
    NoCrossing {
        /// The highest frequency, Hz.
        highest_hz: f64,
    },
    /// No response could be fitted to all components.
    #[error("no response fits: {why}")]
    NoModel {
        /// Why the first candidate failed.
        why: String,
    },
    /// Too few rows for an AICc.
    #[error("{rows} amplitudes are too few for {parameters} parameters")]
    TooFew {
        /// Amplitudes.
        rows: usize,
        /// Parameters with DC gain and scatter.
        parameters: usize,
    },
    /// The response makes outliers of too many rows.
    #[error("{outlying:.0} of {rows} amplitudes do not follow the response")]
    Outlying {
        /// Expected number of outliers.
        outlying: f64,
        /// Amplitudes.
        rows: usize,
    },
    /// The fitted response has its corner outside of the frequencies measured.
    #[error("the response has no -3 dB corner between the frequencies measured")]
    Outside,
    /// The fit has no answer.
    #[error(transparent)]
    Fit(#[from] FitError),
}

impl Serialize for Refusal {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A fitted parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fitted {
    /// Which one.
    #[serde(flatten)]
    pub parameter: Parameter,
    /// Its value, in its unit.
    pub value: f64,
    /// Its standard deviation, in its unit: the larger one of linearised covariance and jackknife.
    pub std: f64,
}

/// The -3 dB corner of one component from the response model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelCorner {
    /// Smallest frequency at which the response is `1/√2` of its DC gain, Hz.
    pub f_3db_model_hz: f64,
    /// Its standard deviation, Hz: the larger one of the next two.
    pub f_3db_model_std_hz: f64,
    /// From the linearised covariance, Hz.
    pub linearised_std_hz: f64,
    /// From leaving out one row at a time, the choice of the model included, Hz.
    pub jackknife_std_hz: f64,
    /// How many of the four rows around the corner, two on either side, do not belong (weight below one half).
    pub neighbours_left_out: usize,
    /// Rows the jackknife could leave out. Without the others the data have no answer.
    pub jackknife_rows: usize,
    /// DC amplitude, enT.
    pub dc_ent: f64,
    /// Its standard deviation, enT.
    pub dc_std_ent: f64,
    /// Parameters of the response.
    pub parameters: Vec<Fitted>,
    /// Standard deviation of a residual above -10 dB, beyond the given one, enT.
    pub residual_std_ent: f64,
    /// The same below -10 dB, enT.
    pub stop_residual_std_ent: f64,
    /// Response at every row of the table, enT.
    pub fitted_ent: Vec<f64>,
    /// Amplitude minus response, enT; NaN without an amplitude.
    pub residual_ent: Vec<f64>,
    /// Probability that the row belongs; 0 for rows that did not count.
    pub weight: Vec<f64>,
}

/// One component.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Component {
    /// Corner by interpolation, Hz.
    pub f_3db_igep_hz: Option<f64>,
    /// Why there is none.
    pub igep_refusal: Option<Refusal>,
    /// Corner by the response chosen.
    pub model: Option<ModelCorner>,
    /// Why there is none.
    pub model_refusal: Option<Refusal>,
    /// Rows with an amplitude below three standard deviations: not in the interpolation.
    pub undetected: Vec<bool>,
}

/// One response in the choice.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// Its name.
    pub model: &'static str,
    /// AICc summed over the components; `None` where it does not fit to all.
    pub aicc: Option<f64>,
    /// AICc per component.
    pub component_aicc: [Option<f64>; 3],
    /// Its -3 dB corner per component, Hz.
    pub f_3db_hz: [Option<f64>; 3],
    /// Why it is out.
    pub refusal: Option<Refusal>,
}

/// The corner of all components.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Corner {
    /// Name of the response chosen.
    pub model: Option<&'static str>,
    /// x, y, z.
    pub components: [Component; 3],
    /// Every response that was tried, in the order given.
    pub candidates: Vec<Candidate>,
}

/// The corner by interpolation, Hz, from points (Hz, positive amplitude) by ascending frequency.
///
/// # Errors
/// [`Refusal::NoAmplitude`] and [`Refusal::NoCrossing`].
pub fn igep_corner_hz(points: &[(f64, f64)]) -> Result<f64, Refusal> {
    let largest = points.iter().map(|(_, amplitude)| *amplitude).fold(0.0, f64::max);
    let Some(&(highest_hz, _)) = points.last().filter(|_| largest > 0.0) else { return Err(Refusal::NoAmplitude) };
    let level = |amplitude: f64| 20.0 * (amplitude / largest).log10();
    let crossing = points.windows(2).rev().find_map(|pair| match *pair {
        [(low, above), (high, below)] if level(above) >= IGEP_LEVEL_DB && level(below) < IGEP_LEVEL_DB => {
            let (above, below) = (level(above), level(below));
            Some(low + (IGEP_LEVEL_DB - above) / (below - above) * (high - low))
        }
        _ => None,
    });
    // A table that ends above the level after low readings has its crossing still to come.
    match points.last() {
        Some((_, last)) if level(*last) < IGEP_LEVEL_DB => crossing.ok_or(Refusal::NoCrossing { highest_hz }),
        _ => Err(Refusal::NoCrossing { highest_hz }),
    }
}

/// A response with its DC gain as model of amplitudes: parameters are logarithms, relative DC gain first.
struct Shape<'a> {
    response: Response,
    frequencies: &'a [f64],
}

/// The parameters of the response.
fn shape_parameters(logarithms: &[f64]) -> Vec<f64> {
    logarithms.iter().skip(1).map(|logarithm| logarithm.exp()).collect()
}

impl Model for Shape<'_> {
    fn names(&self) -> Vec<String> {
        let own = self.response.parameters().into_iter().map(|parameter| parameter.name.to_owned());
        std::iter::once("dc".to_owned()).chain(own).collect()
    }

    fn values(&self, parameters: &[f64], values: &mut [f64]) {
        let (dc, shape) = (parameters[0].exp(), shape_parameters(parameters));
        values.iter_mut().zip(self.frequencies).for_each(|(value, &f)| *value = dc * self.response.value(f, &shape));
    }

    fn jacobian(&self, parameters: &[f64], jacobian: &mut DMatrix<f64>) {
        let (dc, shape) = (parameters[0].exp(), shape_parameters(parameters));
        for (mut row, &f) in jacobian.row_iter_mut().zip(self.frequencies) {
            let (value, slopes) = self.response.value_and_slopes(f, &shape);
            let derivatives = std::iter::once(value).chain(slopes);
            row.iter_mut().zip(derivatives).for_each(|(entry, derivative)| *entry = dc * derivative);
        }
    }
}

/// The amplitudes of one component in the form the fit takes them, relative to a first guess of the DC amplitude.
struct Prepared {
    /// Row of the table of each.
    rows: Vec<usize>,
    frequencies: Vec<f64>,
    data: Data,
    dc: f64,
    /// First guesses, Hz.
    corners: Vec<f64>,
}

/// Usable rows of a component by ascending frequency.
fn usable(table: &[Amplitude], component: usize, omitted: Option<usize>) -> Vec<usize> {
    let counts = |(i, row): (usize, &Amplitude)| {
        let amplitude = row.amplitude_ent[component];
        let good =
            row.usable && amplitude.is_finite() && amplitude >= 0.0 && row.frequency_hz.is_finite() && row.frequency_hz >= 0.0;
        (good && Some(i) != omitted).then_some(i)
    };
    let mut rows: Vec<usize> = table.iter().enumerate().filter_map(counts).collect();
    rows.sort_by(|&a, &b| table[a].frequency_hz.total_cmp(&table[b].frequency_hz));
    rows
}

fn std_ent(row: &Amplitude, component: usize) -> f64 {
    let std = row.std_ent[component];
    if std.is_finite() && std > 0.0 { std } else { 0.0 }
}

fn detected(row: &Amplitude, component: usize) -> bool {
    let amplitude = row.amplitude_ent[component];
    amplitude > 0.0 && amplitude >= DETECTED * std_ent(row, component)
}

/// Middle of the shortest interval with half of the values: where most of them are, whatever the others do.
fn mode(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2 + 1;
    let middles = values.windows(half.min(values.len()).max(1)).filter_map(|w| Some((w.last()? - w.first()?, w)));
    let (_, shortest) = middles.min_by(|a, b| a.0.total_cmp(&b.0))?;
    shortest.get(shortest.len() / 2).copied()
}

impl Prepared {
    fn new(table: &[Amplitude], component: usize, omitted: Option<usize>) -> Result<Self, Refusal> {
        let rows = usable(table, component, omitted);
        let amplitude = |i: usize| table[i].amplitude_ent[component];
        let mut low: Vec<f64> = rows.iter().take(rows.len().div_ceil(2)).map(|&i| amplitude(i)).collect();
        let dc = mode(&mut low).filter(|dc| *dc > 0.0 && dc.is_finite()).ok_or(Refusal::NoAmplitude)?;
        let frequencies: Vec<f64> = rows.iter().map(|&i| table[i].frequency_hz).collect();
        let points: Vec<(f64, f64)> = frequencies.iter().copied().zip(rows.iter().map(|&i| amplitude(i) / dc)).collect();
        let last_above = |level: f64| points.iter().rposition(|(_, relative)| *relative >= level);
        let highest_hz = frequencies.last().copied().unwrap_or(0.0);
        let crossing = |i: usize| match (points.get(i), points.get(i + 1)) {
            (Some(&(low, above)), Some(&(high, below))) if above > below => {
                Some(low + (above - FRAC_1_SQRT_2) / (above - below) * (high - low))
            }
            _ => None,
        };
        let last = last_above(FRAC_1_SQRT_2).and_then(crossing).ok_or(Refusal::NoCrossing { highest_hz })?;
        // Two neighbours below are seldom damaged both, and a response may come up again.
        let fallen = |pair: &[(f64, f64)]| pair.iter().all(|(_, relative)| *relative < FRAC_1_SQRT_2);
        let first = points.windows(2).position(fallen).and_then(|i| crossing(i.checked_sub(1)?));
        let apart = |first: &f64| !(1.0 / APART..=APART).contains(&(first / last));
        let corners = std::iter::once(last).chain(first.filter(apart)).filter(|corner| *corner > 0.0).collect();
        let deciding = last_above(DECIDING).map_or(0, |i| i + 1);
        let counts = [deciding, rows.len() - deciding];
        let split = counts.iter().zip(FEWEST_IN_GROUP).all(|(count, fewest)| *count >= fewest);
        let data = Data {
            observations: points.iter().map(|(_, relative)| *relative).collect(),
            std: rows.iter().map(|&i| std_ent(&table[i], component) / dc).collect(),
            coarse: (0..rows.len()).map(|i| split && i >= deciding).collect(),
            range: 1.0,
            below: OUTLIERS_BELOW,
            least_scatter: LEAST_SCATTER,
        };
        Ok(Self { rows, frequencies, data, dc, corners })
    }

    /// Number of scatters that are estimated.
    fn scatters(&self) -> usize {
        if self.data.coarse.contains(&true) { 2 } else { 1 }
    }

    /// The fit of a response from the best of several starts.
    fn fit(&self, response: Response) -> Result<Outcome, Refusal> {
        let mut refusal = None;
        let mut found = Vec::new();
        for corner in START_CORNER.iter().flat_map(|factor| self.corners.iter().map(move |corner| factor * corner)) {
            for start in response.starts(corner) {
                let parameters: Vec<f64> = std::iter::once(0.0).chain(start.iter().map(|p| p.ln())).collect();
                for scatter in START_SCATTER {
                    let state = State { parameters: parameters.clone(), scatter };
                    match self.climb(response, &state, FIRST_ITERATIONS) {
                        Ok(first) => found.push(first),
                        Err(error) => refusal = refusal.or(Some(error)),
                    }
                }
            }
        }
        found.sort_by(|a, b| a.deviance.total_cmp(&b.deviance));
        let mut best: Option<Outcome> = None;
        for first in found.iter().take(STARTS_CONTINUED) {
            match self.continued(response, &first.state) {
                Ok(outcome) if best.as_ref().is_none_or(|best| outcome.aicc < best.aicc) => best = Some(outcome),
                Ok(_) => {}
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        best.ok_or_else(|| refusal.unwrap_or(Refusal::Outside))
    }

    fn climb(&self, response: Response, state: &State, iterations: usize) -> Result<Contaminated, Refusal> {
        let parameters = response.freedom() + 1 + self.scatters();
        let rows = self.rows.len();
        if aicc(0.0, parameters, rows).is_none() {
            return Err(Refusal::TooFew { rows, parameters });
        }
        let shape = Shape { response, frequencies: &self.frequencies };
        let found = contaminated::fit(&shape, &self.data, state, iterations, &Limits::default())?;
        let outlying: f64 = found.weights.iter().map(|weight| 1.0 - weight).sum();
        if outlying > MOST_OUTLYING * rows as f64 {
            return Err(Refusal::Outlying { outlying, rows });
        }
        Ok(found)
    }

    /// The fit of a response from a state close to it.
    fn continued(&self, response: Response, state: &State) -> Result<Outcome, Refusal> {
        let found = self.climb(response, state, ITERATIONS)?;
        let shape = shape_parameters(&found.state.parameters);
        let within = |corner: &f64| {
            let counted = || self.frequencies.iter().zip(&found.weights).filter(|(_, weight)| **weight > 0.5).map(|(f, _)| *f);
            counted().fold(f64::INFINITY, f64::min) <= *corner && *corner <= counted().fold(0.0, f64::max)
        };
        let corner_hz = response.corner_hz(&shape).filter(within).ok_or(Refusal::Outside)?;
        let parameters = response.freedom() + 1 + self.scatters();
        let rows = self.rows.len();
        let aicc = aicc(found.deviance, parameters, rows).ok_or(Refusal::TooFew { rows, parameters })?;
        Ok(Outcome { found, shape, corner_hz, aicc })
    }
}

/// A response fitted to a component.
struct Outcome {
    found: Contaminated,
    shape: Vec<f64>,
    corner_hz: f64,
    aicc: f64,
}

impl Outcome {
    /// DC amplitude relative to the first guess and parameters of the response.
    fn values(&self, dc: f64) -> Vec<f64> {
        std::iter::once(dc * self.found.state.parameters[0].exp()).chain(self.shape.iter().copied()).collect()
    }

    /// Covariance of the logarithms of DC amplitude and parameters.
    ///
    /// Weights are inverse variances, most likely ones: what the parameters take from the scatter is given back, as the rows above
    /// -10 dB have it, for the others do not scatter as much as they are allowed to.
    fn covariance(&self, data: &Data) -> DMatrix<f64> {
        let deciding: f64 = self.found.weights.iter().zip(&data.coarse).filter(|(_, coarse)| !**coarse).map(|(w, _)| w).sum();
        let spare = (deciding - self.found.state.parameters.len() as f64).max(1.0);
        &self.found.solution.unscaled_covariance * (deciding / spare)
    }
}

/// Sum over the components that are there; `None` where one has no value.
fn total(per_component: &[Option<Result<f64, ()>>; 3]) -> Option<f64> {
    per_component.iter().flatten().try_fold(0.0, |sum, value| Some(sum + value.ok()?))
}

/// What is left when one row is left out: corner of the response then best, and parameters of the one chosen with all rows.
struct Replicate {
    corner_hz: [Option<f64>; 3],
    values: [Option<Vec<f64>>; 3],
}

/// Finds the corner of all components.
///
/// Never fails as a whole: a component without an answer says why. Rows may come in any order.
#[must_use]
pub fn corner(table: &[Amplitude], options: &Options) -> Corner {
    let responses = &options.responses;
    let prepared: [Result<Prepared, Refusal>; 3] = std::array::from_fn(|c| Prepared::new(table, c, None));
    let fits: Vec<[Option<Result<Outcome, Refusal>>; 3]> = responses
        .par_iter()
        .map(|response| std::array::from_fn(|c| prepared[c].as_ref().ok().map(|prepared| prepared.fit(*response))))
        .collect();
    let totals: Vec<Option<f64>> = fits.iter().map(|fit| total(&each_aicc(fit))).collect();
    let any = prepared.iter().any(Result::is_ok);
    let chosen = least(&totals).filter(|_| any);

    let contenders: Vec<usize> = match chosen.and_then(|best| totals[best]) {
        Some(best) => (0..fits.len()).filter(|&m| totals[m].is_some_and(|aicc| aicc <= best + CONTENDERS)).collect(),
        None => Vec::new(),
    };
    let rows: Vec<usize> =
        (0..table.len()).filter(|i| prepared.iter().flatten().any(|prepared| prepared.rows.contains(i))).collect();
    let replicates: Vec<Replicate> = match chosen {
        Some(chosen) if options.jackknife => {
            rows.par_iter().map(|&row| without(table, row, responses, &prepared, &fits, &contenders, chosen)).collect()
        }
        _ => Vec::new(),
    };

    let components = std::array::from_fn(|c| {
        let undetected: Vec<bool> = table.iter().map(|row| row.amplitude_ent[c].is_finite() && !detected(row, c)).collect();
        let points: Vec<(f64, f64)> = usable(table, c, None)
            .into_iter()
            .filter(|&i| detected(&table[i], c))
            .map(|i| (table[i].frequency_hz, table[i].amplitude_ent[c]))
            .collect();
        let igep = igep_corner_hz(&points);
        let model = match (&prepared[c], chosen.and_then(|best| fits[best][c].as_ref().map(|fit| (best, fit)))) {
            (Err(refusal), _) => Err(refusal.clone()),
            (Ok(_), Some((_, Err(refusal)))) => Err(refusal.clone()),
            (Ok(_), None) => Err(no_model(&fits)),
            (Ok(prepared), Some((best, Ok(outcome)))) => Ok(describe(table, c, responses[best], prepared, outcome, &replicates)),
        };
        Component {
            f_3db_igep_hz: igep.as_ref().ok().copied(),
            igep_refusal: igep.err(),
            model: model.as_ref().ok().cloned(),
            model_refusal: model.err(),
            undetected,
        }
    });
    let candidates = responses
        .iter()
        .zip(&fits)
        .zip(&totals)
        .map(|((response, fit), total)| Candidate {
            model: response.name,
            aicc: total.filter(|_| any),
            component_aicc: std::array::from_fn(|c| fit[c].as_ref()?.as_ref().ok().map(|outcome| outcome.aicc)),
            f_3db_hz: std::array::from_fn(|c| fit[c].as_ref()?.as_ref().ok().map(|outcome| outcome.corner_hz)),
            refusal: fit.iter().flatten().find_map(|fit| fit.as_ref().err().cloned()),
        })
        .collect();
    Corner { model: chosen.map(|best| responses[best].name), components, candidates }
}

fn each_aicc(fit: &[Option<Result<Outcome, Refusal>>; 3]) -> [Option<Result<f64, ()>>; 3] {
    std::array::from_fn(|c| fit[c].as_ref().map(|fit| fit.as_ref().map(|outcome| outcome.aicc).map_err(|_| ())))
}

/// The first of the smallest.
fn least(totals: &[Option<f64>]) -> Option<usize> {
    let present = totals.iter().enumerate().filter_map(|(m, total)| total.map(|total| (m, total)));
    present.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(m, _)| m)
}

fn no_model(fits: &[[Option<Result<Outcome, Refusal>>; 3]]) -> Refusal {
    let why = fits.iter().flatten().flatten().find_map(|fit| fit.as_ref().err());
    Refusal::NoModel { why: why.map_or_else(String::new, ToString::to_string) }
}

/// Repeats choice and fit without a row.
fn without(
    table: &[Amplitude],
    row: usize,
    responses: &[Response],
    all: &[Result<Prepared, Refusal>; 3],
    fits: &[[Option<Result<Outcome, Refusal>>; 3]],
    contenders: &[usize],
    chosen: usize,
) -> Replicate {
    let prepared: [Option<Prepared>; 3] = std::array::from_fn(|c| {
        fits[chosen][c].as_ref()?;
        Prepared::new(table, c, Some(row)).ok()
    });
    let refit = |m: usize, c: usize| -> Option<Result<Outcome, Refusal>> {
        let full = fits[m][c].as_ref()?.as_ref().ok()?;
        let fitted = match &prepared[c] {
            Some(prepared) => {
                let mut state = full.found.state.clone();
                // Relative to the first guess of the DC amplitude, which moves with the rows.
                let whole = all[c].as_ref().ok()?;
                state.parameters[0] += (whole.dc / prepared.dc).ln();
                prepared.continued(responses[m], &state)
            }
            None => Err(Refusal::NoAmplitude),
        };
        Some(fitted)
    };
    let again: Vec<[Option<Result<Outcome, Refusal>>; 3]> =
        contenders.iter().map(|&m| std::array::from_fn(|c| refit(m, c))).collect();
    let totals: Vec<Option<f64>> = again.iter().map(|fit| total(&each_aicc(fit))).collect();
    let best = least(&totals);
    let same = contenders.iter().position(|&m| m == chosen);
    let outcome = |m: Option<usize>, c: usize| again.get(m?)?[c].as_ref()?.as_ref().ok();
    Replicate {
        corner_hz: std::array::from_fn(|c| outcome(best, c).map(|outcome| outcome.corner_hz)),
        values: std::array::from_fn(|c| Some(outcome(same, c)?.values(prepared[c].as_ref()?.dc))),
    }
}

/// Standard deviation of the jackknife, NaN for fewer than two replicates.
fn jackknife(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    if values.len() < 2 {
        return f64::NAN;
    }
    let mean = values.iter().sum::<f64>() / n;
    ((n - 1.0) / n * values.iter().map(|value| (value - mean).powi(2)).sum::<f64>()).sqrt()
}

/// Rows next to the corner that do not belong.
fn neighbours_left_out(prepared: &Prepared, outcome: &Outcome) -> usize {
    let above = prepared.frequencies.partition_point(|f| *f < outcome.corner_hz);
    let weights = outcome.found.weights.iter().skip(above.saturating_sub(2)).take(above.min(2) + 2);
    weights.filter(|weight| **weight < 0.5).count()
}

/// The answer for one component.
fn describe(
    table: &[Amplitude],
    component: usize,
    response: Response,
    prepared: &Prepared,
    outcome: &Outcome,
    replicates: &[Replicate],
) -> ModelCorner {
    let covariance = outcome.covariance(&prepared.data);
    let slopes: Vec<f64> = std::iter::once(0.0).chain(response.corner_slopes(outcome.corner_hz, &outcome.shape)).collect();
    let slopes = DVector::from_vec(slopes);
    let linearised_std_hz = outcome.corner_hz * (slopes.transpose() * &covariance * &slopes)[(0, 0)].max(0.0).sqrt();
    let corners: Vec<f64> = replicates.iter().filter_map(|replicate| replicate.corner_hz[component]).collect();
    let jackknife_std_hz = jackknife(&corners);
    let values = outcome.values(prepared.dc);
    let std = |j: usize| {
        let column: Vec<f64> =
            replicates.iter().filter_map(|replicate| replicate.values[component].as_ref()?.get(j).copied()).collect();
        // Of a logarithm: the relative standard deviation.
        (values[j] * covariance[(j, j)].max(0.0).sqrt()).max(jackknife(&column))
    };
    let fitted_ent: Vec<f64> = table.iter().map(|row| values[0] * response.value(row.frequency_hz, &outcome.shape)).collect();
    let residual_ent = table.iter().zip(&fitted_ent).map(|(row, fitted)| row.amplitude_ent[component] - fitted).collect();
    let mut weight = vec![0.0; table.len()];
    prepared.rows.iter().zip(&outcome.found.weights).for_each(|(&row, &w)| weight[row] = w);
    let [fine, coarse] = outcome.found.state.scatter;
    let parameters = response.parameters().into_iter().zip(&outcome.shape).enumerate();
    ModelCorner {
        f_3db_model_hz: outcome.corner_hz,
        f_3db_model_std_hz: linearised_std_hz.max(jackknife_std_hz),
        linearised_std_hz,
        jackknife_std_hz,
        neighbours_left_out: neighbours_left_out(prepared, outcome),
        jackknife_rows: corners.len(),
        dc_ent: values[0],
        dc_std_ent: std(0),
        parameters: parameters.map(|(j, (parameter, &value))| Fitted { parameter, value, std: std(j + 1) }).collect(),
        residual_std_ent: prepared.dc * fine,
        stop_residual_std_ent: prepared.dc * coarse,
        fitted_ent,
        residual_ent,
        weight,
    }
}
