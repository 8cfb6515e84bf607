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
//! The data decide between two treatments, for all components together:
//!
//! * **known noise**: every amplitude has its standard deviation, as amplitudes of waveforms do, and the best response leaves no more
//!   than they let expect: chi-square below its 99.99 % quantile and no residual beyond five standard deviations. Then
//!   weighted least squares is efficient, and its linearised covariance is the uncertainty. Chi-square above its 99 % quantile widens
//!   it by `sqrt(chi-square / dof)`. [`Corner::explained`] tells that it was so.
//! * **scatter**: otherwise, and for tables without standard deviations, what follows.
//!
//! None of the responses describes a printed table within its noise. What the best leaves in the tables of 2013 is 0.1 to 0.4 % of the
//! DC amplitude down to -10 dB and 5 to 7 % below, where the lobes of a digital filter are not those of the textbook; and stretches
//! with lost samples give amplitudes that are far too low. Residuals are therefore taken in amplitude, not in its logarithm, and
//! the fit ([`contaminated`]) estimates one scatter above -10 dB, another one of at least 5 % of DC below, and the probability that a
//! row belongs at all. Given standard deviations add to that scatter. The lobes thus choose between responses that do equally well
//! at the corner, and do not move it: with a free scatter the fits of x and y of 13-04-03-12-59-48 follow the lobes, call the good
//! reading at 100 Hz an outlier, and have the corner 0.2 and 0.5 Hz further up.
//!
//! # Uncertainty of the second treatment
//!
//! What a response leaves is systematic: the linearised covariance takes it for noise of independent rows, and knows nothing of the
//! choice of the model. The jackknife leaves one amplitude out at a time, chooses again, and has both in its spread,
//! `sqrt((n-1)/n Σ (θ_i - mean)²)`; but with few rows around the corner it may come out too small by chance. The larger of the two
//! is given. By its construction hardly any single amplitude can move the corner by more than one standard deviation.
//!
//! Neither knows of several rows that are missing together. Where lost samples spoil most of the rows around the corner, another
//! response may fit what is left: [`ModelCorner::neighbours_left_out`] counts them.

use crate::data::frequency::{ComparedResponse, FittedResponse};
use crate::fit::contaminated::{self, Contaminated, Data, State};
use crate::fit::nonlinear::{self, Model};
use crate::fit::statistics::chi2_tail;
use crate::fit::{FitError, Limits, aicc, order};
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
/// Least probability of a chi square that large, and residual over its standard deviation, up to which known noise explains what a
/// response leaves: one run in several thousand with nothing but that noise fails.
const EXPLAINED_PROBABILITY: f64 = 1e-4;
const EXPLAINED_RESIDUAL: f64 = 5.0;
/// As many starts, the closest ones, are followed with known noise.
const KNOWN_STARTS: usize = 3;
/// Responses whose AICc exceeds the least by no more stay in the choice when a row is left out.
const CONTENDERS: f64 = 30.0;

/// How the corner is found.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The responses to choose from.
    pub responses: Vec<Response>,
    /// Leave out one row at a time where known noise does not explain the amplitudes. Without, standard deviations are those of the
    /// linearised covariance, which are too small for tables that no response describes.
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
    /// From leaving out one row at a time, the choice of the model included, Hz; NaN where that was not done.
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
    /// Standard deviation of a residual above -10 dB, enT: beyond the given one, and all of it where known noise explains it.
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

/// What the best response leaves in units of the known standard deviations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Explained {
    /// Chi-square over all components.
    pub chi_square: f64,
    /// Amplitudes less parameters.
    pub dof: usize,
}

/// The corner of all components.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Corner {
    /// Name of the response chosen.
    pub model: Option<&'static str>,
    /// Known noise explains the amplitudes; `None` where they have a scatter of their own.
    pub explained: Option<Explained>,
    /// x, y, z.
    pub components: [Component; 3],
    /// Every response that was tried, in the order given.
    pub candidates: Vec<Candidate>,
}

impl Corner {
    /// Corners by interpolation, Hz; nan where there is none.
    #[must_use]
    pub fn igep_hz(&self) -> [f64; 3] {
        self.components.each_ref().map(|c| c.f_3db_igep_hz.unwrap_or(f64::NAN))
    }

    /// Corners by the response chosen, Hz; nan where there is none.
    #[must_use]
    pub fn model_hz(&self) -> [f64; 3] {
        self.components.each_ref().map(|c| c.model.as_ref().map_or(f64::NAN, |m| m.f_3db_model_hz))
    }

    /// Their standard uncertainties, Hz.
    #[must_use]
    pub fn model_std_hz(&self) -> [f64; 3] {
        self.components.each_ref().map(|c| c.model.as_ref().map_or(f64::NAN, |m| m.f_3db_model_std_hz))
    }

    /// The response chosen, with the others that were compared.
    #[must_use]
    pub fn response(&self) -> FittedResponse {
        let models = || self.components.iter().map(|c| c.model.as_ref());
        let each = |get: &dyn Fn(&ModelCorner) -> Vec<f64>| models().map(|m| m.map_or_else(Vec::new, get)).collect();
        let parameters = models().flatten().next().map_or_else(Vec::new, |m| {
            let own = m.parameters.iter().map(|p| match p.parameter.unit {
                "1" => p.parameter.name.to_owned(),
                unit => format!("{} ({unit})", p.parameter.name),
            });
            std::iter::once("DC gain (enT)".to_owned()).chain(own).collect()
        });
        let least = self.candidates.iter().filter_map(|c| c.aicc).reduce(f64::min).unwrap_or(f64::NAN);
        let compared = |c: &Candidate| {
            Some(ComparedResponse {
                name: c.model.to_owned(),
                f_3db_hz: c.f_3db_hz.map(|f| f.unwrap_or(f64::NAN)),
                delta_aicc: c.aicc? - least,
            })
        };
        FittedResponse {
            name: self.model.unwrap_or("none").to_owned(),
            parameters,
            values: each(&|m| std::iter::once(m.dc_ent).chain(m.parameters.iter().map(|p| p.value)).collect()),
            std: each(&|m| std::iter::once(m.dc_std_ent).chain(m.parameters.iter().map(|p| p.std)).collect()),
            chi_square: self.explained.map(|e| e.chi_square),
            degrees_of_freedom: self.explained.map(|e| e.dof),
            residual_std: models().map(|m| m.map_or(f64::NAN, |m| m.residual_std_ent / m.dc_ent)).collect(),
            candidate: self.candidates.iter().filter_map(compared).collect(),
        }
    }
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

    /// Logarithms of the parameters to start a fit of a response from.
    fn starts(&self, response: Response) -> Vec<Vec<f64>> {
        let corners = START_CORNER.iter().flat_map(|factor| self.corners.iter().map(move |corner| factor * corner));
        let sets = corners.flat_map(|corner| response.starts(corner));
        sets.map(|start| std::iter::once(0.0).chain(start.iter().map(|p| p.ln())).collect()).collect()
    }

    /// The fit of a response with known standard deviations, from the best of several starts.
    fn known_fit(&self, response: Response) -> Result<Outcome, Refusal> {
        // A Butterworth of each order is a response of its own here: the order is one for all components, and data with known noise
        // leave no doubt about it.
        let parameters = response.parameters().len() + 1;
        let rows = self.rows.len();
        let too_few = Refusal::TooFew { rows, parameters };
        if aicc(0.0, parameters, rows).is_none() {
            return Err(too_few);
        }
        let weights: Vec<f64> = self.data.std.iter().map(|std| std.powi(-2)).collect();
        let shape = Shape { response, frequencies: &self.frequencies };
        let mut values = vec![0.0; rows];
        let mut left = |start: &[f64]| -> f64 {
            shape.values(start, &mut values);
            values.iter().zip(&self.data.observations).zip(&weights).map(|((value, y), w)| w * (y - value).powi(2)).sum()
        };
        let mut starts: Vec<(f64, Vec<f64>)> = self.starts(response).into_iter().map(|start| (left(&start), start)).collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut refusal = None;
        let mut best: Option<Contaminated> = None;
        for (_, start) in starts.into_iter().take(KNOWN_STARTS) {
            match nonlinear::solve(&shape, &self.data.observations, Some(&weights), &start, &Limits::default()) {
                Ok(solution) => {
                    let chi_square = solution.residuals.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
                    if best.as_ref().is_none_or(|best| chi_square < best.deviance) {
                        let state = State { parameters: solution.parameters.clone(), scatter: [0.0; 2] };
                        let dof = solution.dof;
                        best =
                            Some(Contaminated { solution, state, weights: vec![1.0; rows], deviance: chi_square, settled: true });
                        // There is nothing left for another minimum to explain.
                        if is_likely(chi_square, dof) {
                            break;
                        }
                    }
                }
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        let found = best.ok_or_else(|| refusal.map_or(Refusal::Outside, Refusal::Fit))?;
        self.outcome(response, found, parameters)
    }

    /// Whether known standard deviations explain the residuals one by one.
    fn explains(&self, outcome: &Outcome) -> bool {
        outcome.found.solution.residuals.iter().zip(&self.data.std).all(|(r, std)| r.abs() <= EXPLAINED_RESIDUAL * std)
    }

    /// The fit of a response from the best of several starts.
    fn fit(&self, response: Response) -> Result<Outcome, Refusal> {
        let mut refusal = None;
        let mut found = Vec::new();
        for parameters in self.starts(response) {
            for scatter in START_SCATTER {
                let state = State { parameters: parameters.clone(), scatter };
                match self.climb(response, &state, FIRST_ITERATIONS) {
                    Ok(first) => found.push(first),
                    Err(error) => refusal = refusal.or(Some(error)),
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
        self.outcome(response, found, response.freedom() + 1 + self.scatters())
    }

    /// The corner of a fitted response, and its AICc with so many parameters.
    fn outcome(&self, response: Response, found: Contaminated, parameters: usize) -> Result<Outcome, Refusal> {
        let shape = shape_parameters(&found.state.parameters);
        let within = |corner: &f64| {
            let counted = || self.frequencies.iter().zip(&found.weights).filter(|(_, weight)| **weight > 0.5).map(|(f, _)| *f);
            counted().fold(f64::INFINITY, f64::min) <= *corner && *corner <= counted().fold(0.0, f64::max)
        };
        let corner_hz = response.corner_hz(&shape).filter(within).ok_or(Refusal::Outside)?;
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
    /// Where scatter was estimated, weights are inverse variances, most likely ones: what the parameters take from the scatter is
    /// given back, as the rows above -10 dB have it, for the others do not scatter as much as they are allowed to.
    fn covariance(&self, data: &Data, explained: Option<Explained>) -> DMatrix<f64> {
        let factor = match explained {
            Some(explained) => order::excess(explained.chi_square, explained.dof).powi(2),
            None => {
                let weights = self.found.weights.iter().zip(&data.coarse);
                let deciding: f64 = weights.filter(|(_, coarse)| !**coarse).map(|(w, _)| w).sum();
                deciding / (deciding - self.found.state.parameters.len() as f64).max(1.0)
            }
        };
        &self.found.solution.unscaled_covariance * factor
    }

    /// Scatter of the residuals above and below -10 dB, relative to the first guess of the DC amplitude.
    fn scatter(&self, data: &Data, explained: Option<Explained>) -> [f64; 2] {
        if explained.is_none() {
            return self.found.state.scatter;
        }
        let rows = data.observations.len() as f64;
        let spare = rows - self.found.state.parameters.len() as f64;
        [false, true].map(|coarse| {
            let group = self.found.solution.residuals.iter().zip(&data.coarse).filter(|(_, own)| **own == coarse);
            let (sum, count) = group.fold((0.0, 0.0), |(sum, count), (r, _)| (sum + r * r, count + 1.0));
            // The parameters take from all residuals alike.
            (sum / count * rows / spare).sqrt()
        })
    }
}

/// The fits of every response to every component there is.
type Fits = Vec<[Option<Result<Outcome, Refusal>>; 3]>;

fn fit_all(
    responses: &[Response],
    prepared: &[Result<Prepared, Refusal>; 3],
    fit: impl Fn(&Prepared, Response) -> Result<Outcome, Refusal> + Sync,
) -> Fits {
    let each = |response: &Response| std::array::from_fn(|c| prepared[c].as_ref().ok().map(|prepared| fit(prepared, *response)));
    responses.par_iter().map(each).collect()
}

/// The fits with known standard deviations, if the best response leaves no more than they let expect.
fn explain(responses: &[Response], prepared: &[Result<Prepared, Refusal>; 3]) -> Option<(Fits, Explained)> {
    let mut present = prepared.iter().flatten().peekable();
    present.peek()?;
    if !present.all(|prepared| prepared.data.std.iter().all(|std| *std > 0.0)) {
        return None;
    }
    let fits = fit_all(responses, prepared, Prepared::known_fit);
    let best = least(&fits.iter().map(|fit| total(&each_aicc(fit))).collect::<Vec<_>>())?;
    let mut explained = Explained { chi_square: 0.0, dof: 0 };
    for (prepared, outcome) in prepared.iter().flatten().zip(fits[best].iter().flatten().flatten()) {
        if !prepared.explains(outcome) {
            return None;
        }
        explained.chi_square += outcome.found.deviance;
        explained.dof += outcome.found.solution.dof;
    }
    is_likely(explained.chi_square, explained.dof).then_some((fits, explained))
}

/// Whether known noise gives a chi square as large as this.
fn is_likely(chi_square: f64, dof: usize) -> bool {
    dof > 0 && chi2_tail(chi_square, dof as f64) >= EXPLAINED_PROBABILITY
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
    let (fits, explained) = match explain(responses, &prepared) {
        Some((fits, explained)) => (fits, Some(explained)),
        None => (fit_all(responses, &prepared, Prepared::fit), None),
    };
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
        Some(chosen) if options.jackknife && explained.is_none() => {
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
            (Ok(prepared), Some((best, Ok(outcome)))) => {
                Ok(describe(table, c, responses[best], prepared, outcome, explained, &replicates))
            }
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
    Corner { model: chosen.map(|best| responses[best].name), explained, components, candidates }
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
    explained: Option<Explained>,
    replicates: &[Replicate],
) -> ModelCorner {
    let covariance = outcome.covariance(&prepared.data, explained);
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
    let [fine, coarse] = outcome.scatter(&prepared.data, explained);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    const TRUTH: [f64; 2] = [62.0, 0.73];
    const DC_ENT: f64 = 600.0;
    const STD_ENT: f64 = 0.05;

    fn options() -> Options {
        let names = ["first order", "second order", "second order with zero", "Butterworth 2"];
        Options { responses: names.iter().filter_map(|name| Response::named(name)).collect(), jackknife: true }
    }

    /// Amplitudes of a second order with noise, which the rows know.
    fn measured(random: &mut Random) -> Vec<Amplitude> {
        let response = Response::named("second order").unwrap();
        (0..24)
            .map(|i| {
                let frequency_hz = 0.5 * 1.35f64.powi(i);
                let clean = DC_ENT * response.value(frequency_hz, &TRUTH);
                let amplitude_ent = std::array::from_fn(|_| clean + STD_ENT * random.gaussian());
                Amplitude { frequency_hz, amplitude_ent, std_ent: [STD_ENT; 3], usable: true }
            })
            .collect()
    }

    fn corners(found: &Corner) -> [[f64; 2]; 3] {
        std::array::from_fn(|c| {
            let model = found.components[c].model.as_ref().unwrap();
            [model.f_3db_model_hz, model.f_3db_model_std_hz]
        })
    }

    #[test]
    fn known_noise_gives_the_uncertainty_of_weighted_least_squares() {
        let truth = Response::named("second order").unwrap().corner_hz(&TRUTH).unwrap();
        let mut random = Random::seeded(3);
        let mut pulls = Vec::new();
        for _ in 0..40 {
            let found = corner(&measured(&mut random), &options());
            let explained = found.explained.unwrap();
            assert!(explained.dof >= 60 && explained.chi_square < 2.0 * explained.dof as f64, "{explained:?}");
            let models = found.components.iter().map(|component| component.model.as_ref().unwrap());
            assert!(models.clone().all(|m| m.jackknife_std_hz.is_nan() && m.weight.iter().all(|w| *w == 1.0)));
            if found.model == Some("second order") {
                // Noise of 0.05 enT in 600 enT: a scatter of 5 % below -10 dB would give up most of what these rows tell.
                assert!(models.clone().all(|m| m.dc_std_ent < 0.03 && m.f_3db_model_std_hz < 0.015));
            }
            pulls.extend(corners(&found).map(|[value, std]| (value - truth) / std));
        }
        let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len() as f64).sqrt();
        let within = pulls.iter().filter(|p| p.abs() < 1.96).count() as f64 / pulls.len() as f64;
        // 120 values: standard errors 0.065 and 0.02.
        assert!((0.8..1.2).contains(&rms) && (0.885..=1.0).contains(&within), "{rms} {within}");
    }

    #[test]
    fn what_known_noise_does_not_explain_has_a_scatter() {
        let truth = Response::named("second order").unwrap().corner_hz(&TRUTH).unwrap();
        let mut random = Random::seeded(4);
        let clean = measured(&mut random);
        let mut low = clean.clone();
        low[12].amplitude_ent[1] *= 0.8;
        let mut unaware = clean.clone();
        unaware.iter_mut().for_each(|row| row.std_ent = [0.2 * STD_ENT; 3]);
        let mut unknown = clean;
        unknown[3].std_ent[2] = f64::NAN;
        for rows in [low, unaware, unknown] {
            let found = corner(&rows, &options());
            assert_eq!(found.explained, None);
            for [value, std] in corners(&found) {
                assert!((value - truth).abs() < 4.0 * std, "{value} ± {std} for {truth}");
            }
            assert!(found.components.iter().all(|c| c.model.as_ref().unwrap().jackknife_std_hz > 0.0));
        }
    }
}
