//! The blind study of the diagnosis: run sets with a hidden truth, the verdict on each, and the score.
//!
//! Sensors, programmes, noise and effects are made with formulas of this folder alone, whose forms differ from those of the catalogue:
//! low-passes where it delays, tanh knees, bent and ramped curves, noise that is not quite a power law, and effects it does not know.
//!
//! * `sensor`: sensor, temperatures; `programme`: settings; `decoy`: damage that is no effect; `freq`: the same for sines
//! * `noise`: families, and whitening with their true covariance
//! * `effects`: what can be hidden
//! * `kinds`: strength of an effect, and run sets in memory
//! * `ideal`: what could be found by someone who knows the noise, or the distribution from which it is drawn
//! * `names`: how often one of two effects that resemble each other can be named rightly at all
//! * `pairs`: how often two effects can both be named at all
//! * `poles`: how well one pole and two poles in the field could be distinguished
//! * `judge`: the call of the diagnosis
//! * `score`: from verdicts to counts; `report` and `picture`: from counts to tables and figures

pub mod decoy;
pub mod effects;
pub mod freq;
pub mod ideal;
pub mod judge;
pub mod kinds;
pub mod names;
pub mod noise;
pub mod pairs;
pub mod picture;
pub mod poles;
pub mod programme;
pub mod report;
pub mod score;
pub mod sensor;

use calfit::data::run::{Run, Vector};
use calfit::files::campaign::Campaign;
use calfit::record::plan::Plan;
use decoy::Decoy;
use freq::TrueSines;
use noise::{Family, Noise};
use programme::Programme;
use sensor::{CleanRun, Kind, Matrix, Sensor};
use serde::Serialize;

/// What is hidden.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Names of `effects::visible`, `effects::outside` or `effects::absorbed`.
    pub effects: Vec<String>,
    /// Strength of each of them; effects of nature's own size have their own.
    pub strength_k: f64,
    /// Drawn if not given.
    pub noise: Option<Family>,
    /// Settings of a linearity run.
    pub programme: Programme,
    /// Damage of the data that is no effect.
    pub decoy: Option<Decoy>,
    /// The same sensor with the same effects is measured once more, in another way; strengths in the truth are those of the first run.
    pub then: Option<Plan>,
}

/// A run set and its truth.
pub struct Blind {
    /// What the diagnosis may see.
    pub runs: Vec<(Run, Vec<Vector>)>,
    /// Positions and channels, which it may see as well.
    pub campaign: Campaign,
    pub truth: Truth,
    /// Without noise, what every effect adds to the mean of every plateau (128 parts of a night), enT: effect, run, plateau.
    pub oracle: Vec<Vec<Vec<[f64; 3]>>>,
    /// The same per sample.
    pub hidden_ent: Vec<Vec<Vec<[f64; 3]>>>,
    /// Mean readings of the same plateaus, enT.
    pub means: Vec<Vec<[f64; 3]>>,
    /// The runs without noise and effects.
    pub clean_runs: Vec<CleanRun>,
}

/// Everything that is true about a run set.
#[derive(Clone, Debug, Serialize)]
pub struct Truth {
    pub seed: u64,
    pub kind: Kind,
    pub noise: Noise,
    pub effects: Vec<TrueEffect>,
    pub parameters: Sensor,
    /// Response at 0 °C per run, enT/nT, from coil coordinates; empty for sines.
    pub response_ent_per_nt: Vec<Matrix>,
    /// For sines only.
    pub sines: Option<TrueSines>,
}

/// A hidden effect.
#[derive(Clone, Debug, Serialize)]
pub struct TrueEffect {
    /// Name in the catalogue, or `unknown`.
    pub effect: String,
    /// Name of the generator.
    pub drawn_as: String,
    pub form: String,
    /// Sensor axes; none where no reading changes.
    pub axes: Vec<String>,
    /// Accepted names of the quantity that it depends on.
    pub covariates: Vec<String>,
    pub parameters: Vec<TrueParameter>,
    /// The form is that of the catalogue, so that parameters of the same name can be compared.
    pub exact_form: bool,
    /// In multiples of the noise: whitened with its true covariance, the run's own parameters projected out.
    pub strength_k: f64,
    /// Not scaled to a strength.
    pub natural_size: bool,
    /// The run can tell it from its own parameters.
    pub identifiable: bool,
    /// Part of the effect that the run's own parameters leave.
    pub surviving_share: f64,
    /// Strength with the other effect of a pair among the run's own parameters.
    pub beside_other_k: Option<f64>,
    pub seen_inside_plateaus: bool,
}

/// A true parameter.
#[derive(Clone, Debug, Serialize)]
pub struct TrueParameter {
    pub name: String,
    pub unit: String,
    pub value: f64,
}

/// What the diagnosis says.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verdict {
    pub steps: Vec<VerdictStep>,
    /// Nothing is named, and it is said that something is left.
    pub undecided: bool,
    /// Effects that it says this run set cannot show.
    pub not_identifiable: Vec<String>,
    /// Held-out χ² without and with the true effects in the folds of the diagnosis, where it can tell; else the study works it out.
    pub oracle_chi2: Option<[f64; 2]>,
    /// What could be found, where the run has one position and plateaus.
    pub ideal: Option<ideal::Ideal>,
}

/// One effect that is named.
#[derive(Clone, Debug, Default, Serialize)]
pub struct VerdictStep {
    pub effect: String,
    pub axes: Vec<String>,
    /// The other members of the ambiguous set.
    pub ambiguous_with: Vec<String>,
    pub family: String,
    /// Said to be this effect, not only to be consistent with it.
    pub confident: bool,
    /// The rival of largest evidence, and the logarithm of its likelihood ratio.
    pub runner_up: Option<(String, f64)>,
    pub covariate: Option<String>,
    pub strength_k: f64,
    /// What runs of the menu would tell, the best first.
    pub next: Vec<Proposal>,
    pub amplitudes: Vec<Amplitude>,
    /// Sum of squares on held-out blocks over the noise, before and after the effect.
    pub gap_before_chi2: f64,
    pub gap_after_chi2: f64,
}

/// A run that is proposed.
#[derive(Clone, Debug, Serialize)]
pub struct Proposal {
    #[serde(skip)]
    pub plan: Plan,
    /// Strength that is forecast for the effect, and for what no rival can take of it.
    pub strength_k: f64,
    pub apart_k: f64,
}

/// A parameter with its standard uncertainty, in the unit of the catalogue.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Amplitude {
    pub name: String,
    pub value: f64,
    pub std: f64,
}
