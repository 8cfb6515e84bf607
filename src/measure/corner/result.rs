//! What the corner of a table of amplitudes is, and how it was found.

use super::drift::Drifting;
use super::fit::Outcome;
use super::prepared::Prepared;
use super::refusal::Refusal;
use crate::data::frequency::{ComparedResponse, FittedResponse, FrequencyValues};
use crate::model::response::Parameter;
use serde::Serialize;

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
    /// Its standard deviation, Hz: the larger one of the next two, and beside it what a drift would do that is possible.
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

/// A drift of the amplitudes beside a response.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AmplitudeDrift {
    /// The response that it stands with.
    pub model: &'static str,
    /// Relative change of the amplitude of each component from the first to the last row; nan for a component without an answer.
    pub change: [f64; 3],
    /// f_3dB beside it, Hz, and beside other drifts that are about as likely.
    pub f_3db_model_hz: [Vec<f64>; 3],
    /// The same of the DC amplitude in the middle of the run, enT.
    pub dc_ent: [Vec<f64>; 3],
    /// Whether it describes the amplitudes far better than the responses alone and is in the answer; otherwise it does about as well, and what it
    /// would change is in the uncertainty.
    pub is_found: bool,
}

impl AmplitudeDrift {
    /// What the fits beside a response of this name say.
    pub(super) fn of(model: &'static str, drifting: &Drifting, prepared: &[Result<Prepared, Refusal>; 3]) -> Self {
        let of = |get: &dyn Fn(&Outcome, f64) -> f64| {
            std::array::from_fn(|c| {
                let Ok(prepared) = &prepared[c] else { return Vec::new() };
                let fits = std::iter::once(&drifting.fit).chain(&drifting.others);
                fits.filter_map(|fit| Some(get(fit[c].as_ref()?.as_ref().ok()?, prepared.dc))).collect()
            })
        };
        let change: [Vec<f64>; 3] = of(&|outcome, _| outcome.drift.factor(1.0) / outcome.drift.factor(-1.0) - 1.0);
        Self {
            model,
            change: change.map(|all| all.first().copied().unwrap_or(f64::NAN)),
            f_3db_model_hz: of(&|outcome, _| outcome.corner_hz),
            dc_ent: of(&|outcome, dc| outcome.values(dc)[0]),
            is_found: drifting.is_found,
        }
    }

    /// The answer for a component with what this drift, and others that are as likely, would change in its uncertainties.
    pub(super) fn widen(&self, model: ModelCorner, component: usize) -> ModelCorner {
        let beside = |std: f64, others: &[Vec<f64>; 3], own: f64| {
            std.hypot(others[component].iter().map(|other| (other - own).abs()).fold(0.0, f64::max))
        };
        ModelCorner {
            f_3db_model_std_hz: beside(model.f_3db_model_std_hz, &self.f_3db_model_hz, model.f_3db_model_hz),
            dc_std_ent: beside(model.dc_std_ent, &self.dc_ent, model.dc_ent),
            ..model
        }
    }
}

/// The corner of all components.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Corner {
    /// Name of the response chosen.
    pub model: Option<&'static str>,
    /// Known noise explains the amplitudes; `None` where they have a scatter of their own.
    pub explained: Option<Explained>,
    /// A drift of the amplitudes that was found or is possible.
    pub drift: Option<AmplitudeDrift>,
    /// x, y, z.
    pub components: [Component; 3],
    /// Every response that was tried, in the order given.
    pub candidates: Vec<Candidate>,
}

impl Corner {
    /// -3 dB frequencies, nan where there is none, without a sampling frequency.
    #[must_use]
    pub fn values(&self) -> FrequencyValues {
        FrequencyValues {
            f_3db_igep_hz: self.components.each_ref().map(|c| c.f_3db_igep_hz.unwrap_or(f64::NAN)),
            f_3db_model_hz: self.components.each_ref().map(|c| c.model.as_ref().map_or(f64::NAN, |m| m.f_3db_model_hz)),
            f_3db_model_std_hz: self.model_std_hz(),
            ..FrequencyValues::default()
        }
    }

    /// Standard uncertainties of the corners by the response chosen, Hz; nan where there is none.
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
