//! What a diagnosis found.

use crate::data::note::{Note, told};
use crate::data::units::Scale;
use crate::fit::noise::NoiseParameters;
use crate::model::effects::{EffectRef, Spec};
use serde::Serialize;

/// Everything that was found in one run, or in several that were looked at together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// `diagnosis`.
    pub format: &'static str,
    /// 1.
    pub version: u32,
    /// Run ids, or names of parameter files.
    pub runs: Vec<String>,
    /// Standard deviation of a mean, the noise alone, nT along the sensor axes.
    pub noise_floor_nt: [f64; 3],
    /// Parameters of the noise: shares of its parts, and exponent or memory of the slow one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<NoiseParameters>,
    /// What was missing, in the order in which it was found.
    pub steps: Vec<Step>,
    /// What these data cannot show, whatever its size.
    pub not_identifiable: Vec<NotIdentifiable>,
    /// Smallest effects that these data would have shown with a probability of 90 %.
    pub detection_limits: Vec<DetectionLimit>,
    /// Response to alternating fields that describes the data, in words; of frequency runs only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response: Option<String>,
    /// What was looked at together, and how, where it is not one run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub basis: Option<String>,
    /// In one line.
    pub verdict: String,
    /// What kind of verdict it is.
    pub verdict_kind: VerdictKind,
    /// What is left that is neither explained nor the noise of the readings.
    pub left: Option<Left>,
    /// How the disagreement on held-out stretches shrinks with every step, from none to all of them; it never grows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub gap_chain: Vec<Link>,
    /// What a person should know.
    #[serde(flatten, serialize_with = "told")]
    pub notes: Vec<Note>,
    /// Smallest and largest reading of the sensor axes, without offset, enT.
    #[serde(skip)]
    pub reading_ent: [[f64; 2]; 3],
    /// Residuals before, and after each step, for the pictures.
    #[serde(skip)]
    pub maps: Vec<Map>,
    /// Everything else that the pictures show.
    #[serde(flatten)]
    pub pictures: Pictures,
}

/// Kind of a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum VerdictKind {
    /// Nothing is missing, and nothing is left.
    None,
    /// Something was found.
    Found,
    /// Nothing was found, but what is left is more than the noise of the readings.
    Undecided,
}

impl VerdictKind {
    /// Of what was found and what is left.
    #[must_use]
    pub fn of(steps: &[Step], left: Option<&Left>) -> Self {
        match (steps.is_empty(), left) {
            (false, _) => Self::Found,
            (true, Some(_)) => Self::Undecided,
            (true, None) => Self::None,
        }
    }
}

/// What is left that is neither explained nor the noise of the readings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Left {
    /// Component, and the covariate that it follows.
    #[serde(rename = "where")]
    pub place: String,
    /// Root mean square of all that is left there, nT.
    pub rms_nt: f64,
    /// The same over the noise of the readings.
    pub times_noise: f64,
    /// What it is like.
    #[serde(skip)]
    pub like: LeftLike,
}

/// What something that is left is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftLike {
    /// Slow: a drift of the offset, or slow noise.
    Slow,
    /// Slow in proportion to the reading: a drift of the gain, or slow noise of it.
    SlowGain,
    /// Scatter from reading to reading.
    Scatter,
    /// Single plateaus far from the others.
    Plateaus,
    /// Settings that show the field of the one beside them for longer than the others do.
    Edges,
    /// A component that stands still for a while.
    Still,
    /// Something in a narrow band of the spectrum of the samples.
    Band,
    /// Disagreement of any other kind.
    Disagreement,
}

/// Disagreement on held-out stretches with the steps so far.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Link {
    /// Numbers of the steps, from 1, that are in the model since the link before; what was found before the plateau means were looked at is
    /// in the first link. Steps that show only together are together.
    pub steps: Vec<usize>,
    /// Weighted squares over their number, with the noise of the final model.
    pub chi2_per_dof: f64,
    /// Weighted root mean square, all axes, nT; slow noise that passes from reading to reading is not in it.
    pub rms_nt: f64,
}

/// What the pictures of a diagnosis show beside the residuals of its steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Pictures {
    /// Where readings and model disagree before anything is named: the largest first.
    #[serde(rename = "where", skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<Place>,
    /// Evidence of each step that has rivals.
    #[serde(skip)]
    pub evidence: Vec<Evidence>,
    /// What happens inside the plateaus.
    #[serde(skip)]
    pub inside: Vec<InsideMap>,
    /// Temperatures that the readings speak of.
    #[serde(skip)]
    pub branches: Option<Branches>,
    /// Residuals of the whole model, an entry per component.
    #[serde(skip)]
    pub left: Vec<Map>,
    /// What the readings are.
    #[serde(skip)]
    pub scale: Scale,
}

/// How the readings of one axis disagree with the model along a covariate, before anything is named.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Covariate; one that begins with `gain with` multiplies the reading.
    pub covariate: String,
    /// Its unit.
    pub unit: &'static str,
    /// Sensor axis.
    pub axis: &'static str,
    /// Middle of the bin that disagrees most, in units of the covariate.
    pub at: f64,
    /// Its displacement, nT along the sensor axis; of a gain, at the largest reading.
    pub displacement_nt: f64,
    /// Its displacement over the standard uncertainty.
    pub multiples_of_noise: f64,
    /// Squares, over the noise, that a smooth function of the covariate explains of stretches that were held out.
    pub predicted: f64,
    /// All bins in the order of the covariate.
    #[serde(skip)]
    pub bins: Vec<Bin>,
}

/// Rows with similar values of a covariate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// Where the bin begins and ends when the rows are ordered by the covariate, 0 to 1.
    pub share: [f64; 2],
    /// Mean of the covariate.
    pub at: f64,
    /// Displacement of the readings of the bin beside the model, nT.
    pub displacement_nt: f64,
    /// Displacement over its standard uncertainty.
    pub multiples_of_noise: f64,
}

/// Evidence of the effect of a step and of its rivals.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// Step, from 0.
    pub step: usize,
    /// Id and natural logarithm of the likelihood ratio to a model without it, prior and number of choices included; the step's own first.
    pub bars: Vec<(String, f64)>,
    /// Difference below which two explanations are not distinguished.
    pub apart: f64,
}

/// Means of the samples over their place inside the plateaus, over that around the steps, or over the phase of a periodic signal.
#[derive(Clone, Debug, PartialEq)]
pub struct InsideMap {
    /// Step, from 0.
    pub step: usize,
    /// What the samples are ordered by, with its unit.
    pub covariate: String,
    /// What is shown of them, with its unit.
    pub quantity: String,
    /// In the order of the covariate.
    pub bins: Vec<InsideBin>,
}

/// Samples of a similar phase. A component without samples is not a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InsideBin {
    /// Mean of the covariate.
    pub x: f64,
    /// Mean without the effect.
    pub before: [f64; 3],
    /// Mean with the effect.
    pub after: [f64; 3],
    /// Standard uncertainty of either.
    pub std: [f64; 3],
}

/// Difference between the temperature that the readings speak of and that of the thermistor while it rises and while it falls.
#[derive(Clone, Debug, PartialEq)]
pub struct Branches {
    /// Step, from 0.
    pub step: usize,
    /// Thermistor.
    pub thermistor: String,
    /// Heating.
    pub rising: Vec<BranchPoint>,
    /// Cooling.
    pub falling: Vec<BranchPoint>,
}

/// Rows of similar temperature on one branch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BranchPoint {
    /// Mean temperature of the thermistor, °C.
    pub degc: f64,
    /// Difference without the lag, K.
    pub before_k: f64,
    /// Difference with it, K.
    pub after_k: f64,
    /// Standard uncertainty of either, K.
    pub std_k: f64,
}

/// A further form of an effect that was missing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FurtherForm {
    /// What was fitted, complete with its shape.
    pub form: Spec,
    /// Its parameters with standard uncertainties, corrected for having been selected.
    pub parameters: Vec<Parameter>,
    /// The plateau without which little of it is left, s since the run's start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub one_plateau_s: Option<f64>,
}

/// One effect that was missing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// The effect.
    pub effect: EffectRef,
    /// Axes on which it acts.
    pub axes: Vec<String>,
    /// Other effects that these data cannot distinguish from it.
    pub ambiguous_with: Vec<EffectRef>,
    /// What was fitted, complete with its shape.
    pub form: Spec,
    /// Further forms of the same effect, as a second step of the offset.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub further: Vec<FurtherForm>,
    /// Parameters with standard uncertainties, corrected for having been selected.
    pub parameters: Vec<Parameter>,
    /// Where the data disagree, in words.
    #[serde(rename = "where")]
    pub place: String,
    /// Probability that noise alone gives this candidate as large a score.
    pub p_value: f64,
    /// Candidates that were tried.
    pub trials: usize,
    /// Probability that noise alone gives any candidate as much evidence.
    pub p_value_corrected: f64,
    /// Disagreement on held-out plateaus without the effect.
    pub gap_before: Gap,
    /// Disagreement on held-out plateaus with the effect.
    pub gap_after: Gap,
    /// Signal to noise ratio of the effect beside all that is fitted.
    pub strength_k: f64,
    /// Family of the effect.
    pub family: &'static str,
    /// Whether the name is certain: `is` (alone in its set, strong, nothing left over) or `consistent with`.
    pub wording: &'static str,
    /// Evidence of the candidates next to it: id, logarithm of the likelihood ratio to the best.
    pub runners_up: Vec<RunnerUp>,
    /// What to measure to distinguish the members of an ambiguous set.
    pub next_measurement: Option<String>,
    /// What runs of a menu would tell, the best first; where the name is not certain.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub next_forecast: Vec<Forecast>,
    /// The sentence for the protocol.
    pub sentence: String,
    /// How it is told.
    #[serde(skip)]
    pub telling: Telling,
    /// What an unknown dependence follows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub covariate: Option<String>,
    /// The unknown dependence.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub shape: Vec<ShapePoint>,
    /// Names of its points, where their covariate is a number in a list.
    #[serde(skip)]
    pub shape_names: Vec<String>,
    /// The plateau without which little of it is left, s since the run's start: one that was disturbed looks the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub one_plateau_s: Option<f64>,
}

/// How a step is told: where its name is certain, and where it is not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Telling {
    /// The sentences for the one and the other, if they are not the usual ones.
    pub own: Option<[String; 2]>,
    /// What the sentence is followed by.
    pub remark: String,
}

/// A parameter of an effect.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parameter {
    /// Name, as `c3_z`.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard uncertainty; absent for a shape parameter that was found on a grid.
    pub std: Option<f64>,
    /// Unit.
    pub unit: String,
}

/// How simulated and measured data disagree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Gap {
    /// Root mean square, nT along the sensor axes.
    pub rms_nt: [f64; 3],
    /// Weighted squares over their number.
    pub chi2_per_dof: f64,
    /// Largest deviation, nT.
    pub max_nt: f64,
}

/// A candidate beside the one that was taken.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunnerUp {
    /// Id, with the covariate of an unknown one.
    pub effect: String,
    /// Natural logarithm of its evidence over that of the one that was taken.
    pub log_ratio: f64,
    /// How much the two look alike: canonical correlation of their best forms.
    pub correlation: f64,
}

/// What a run would tell that could be measured next.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Its name in the menu.
    pub measurement: &'static str,
    /// What to do.
    pub words: String,
    /// Signal to noise ratio of the effect in that run, beside what is fitted.
    pub strength_k: f64,
    /// The rival that is hardest to tell from it there; none where there is none.
    pub against: Option<String>,
    /// Signal to noise ratio of what that rival cannot take of the effect in the run that was measured.
    pub k_now: f64,
    /// The same in that run.
    pub k: f64,
}

/// Signal to noise ratio of what is left of an effect beside a rival from which on the two are told apart for sure: at 3.03 their
/// likelihoods differ by a hundred on the average, and noise makes that of single runs less.
pub const TOLD_APART: f64 = 5.0;

impl Forecast {
    /// Whether the run would tell the effect from its rivals.
    #[must_use]
    pub fn tells_apart(&self) -> bool {
        self.k >= TOLD_APART
    }

    /// The first of several runs that would tell the effect from its rivals, or else the first; none where it tells no more than the run that
    /// was measured.
    #[must_use]
    pub fn best(all: &[Forecast]) -> Option<&Forecast> {
        all.iter().find(|f| f.tells_apart()).or(all.first()).filter(|f| f.k > f.k_now)
    }
}

/// An effect that these data cannot show.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NotIdentifiable {
    /// The effect.
    pub effect: EffectRef,
    /// Why.
    pub reason: String,
}

impl NotIdentifiable {
    /// An effect of which the fitted parameters leave too little; `surviving` are the parts of its terms that are left beside them.
    pub(super) fn absorbed(effect: EffectRef, surviving: impl Iterator<Item = f64>) -> Self {
        let most = surviving.fold(0.0, f64::max);
        Self { effect, reason: format!("{:.1} % of it is left beside the fitted parameters", 100.0 * most) }
    }
}

/// Smallest effect that would have been found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DetectionLimit {
    /// The effect.
    pub effect: EffectRef,
    /// Axis, or several.
    pub axis: String,
    /// Largest contribution to a reading, nT.
    pub amplitude_nt: f64,
    /// Value of the parameter, with its unit.
    pub parameter: String,
}

/// A point of an unknown dependence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ShapePoint {
    /// Value of the covariate.
    pub covariate: f64,
    /// Contribution, nT along the sensor axis.
    pub residual_nt: f64,
    /// Standard uncertainty, nT.
    pub std_nt: f64,
}

/// Residuals of one stage for the pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// What the residuals are drawn over.
    pub covariate: String,
    /// Its unit.
    pub unit: String,
    /// Component.
    pub axis: usize,
    /// Values of the covariate.
    pub x: Vec<f64>,
    /// Residuals before, nT.
    pub before_nt: Vec<f64>,
    /// Residuals after, nT.
    pub after_nt: Vec<f64>,
    /// Noise, nT.
    pub noise_nt: f64,
    /// Step, from 0.
    pub step: usize,
    /// Names of the values of the covariate, where they are numbers in a list.
    pub names: Vec<String>,
}
