//! FPF: sampling frequency and frequency response of one run.

use super::kind::Naming;
use super::point::{self, Point};
use super::quantity::Shape::{Scalar, Vector};
use super::quantity::{Entry, Quantities, RUN_DEGC, SENSOR};
use super::{Body, Kept};
use crate::data::frequency::{FrequencyFound, FrequencyValues, SineAmplitude};
use crate::data::note::Told;
use crate::data::result::Conditions;
use crate::model::applied::ModelApplied;
use serde::{Deserialize, Serialize};

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrequencyConvention {
    /// Equation of the model.
    pub model: String,
    /// What `f_3db_igep_hz` and `f_3db_model_hz` are.
    pub corner: String,
    /// What the uncertainties are.
    pub uncertainty: String,
}

impl Default for FrequencyConvention {
    fn default() -> Self {
        Self {
            model: "B_r = c + b sin(2 pi f (n - phase_counter) / f_s + phase), n the sample counter and f the frequency by the facility clock; amplitudes are half peak to peak, enT, sensor axes".to_owned(),
            corner: "f_3db_igep_hz: straight line in level against frequency between the neighbours of -3.000 dB below the largest amplitude; f_3db_model_hz: the fitted response at 1/sqrt(2) of its DC gain (-3.0103 dB)".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1; that of f_3db_model_hz follows from those of the amplitudes where model.chi_square stands, otherwise it is the larger one of linearised covariance and delete-one jackknife; the facility clock and the flatness of the coil field are not included".to_owned(),
        }
    }
}

/// Sampling frequency and frequency response. Without waveforms the sampling frequency is absent, and nan in files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fpf {
    /// Sampling frequency and -3 dB frequencies.
    #[serde(flatten)]
    pub values: FrequencyValues,
    /// What the numbers mean.
    pub convention: FrequencyConvention,
    /// What they were found with.
    #[serde(flatten)]
    pub found: FrequencyFound,
    /// Known effects that were taken off the sines: amplitudes, phases and -3 dB frequencies are those without them, with their
    /// uncertainties; those of the parameters of the response are without. f_s is that at `clock.reference_s`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effects: Option<ModelApplied>,
    /// One entry per applied frequency, in the order of the run.
    pub amplitude: Vec<SineAmplitude>,
    /// Temperatures during the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<Conditions>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for Fpf {
    const FORMAT: &'static str = "FPF";
    const NAMING: Naming = Naming::Extension;
    const POINT: Option<Point> = Some(point::fpf);
    const KEPT: &'static [Kept] =
        &[Kept::vector("f_s_hz"), Kept::vector("f_s_std_hz"), Kept::number("mean_f_s_hz"), Kept::number("mean_f_s_std_hz")];
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &[],
        entries: &[
            Entry::of("f_3db_model", Vector, "/f_3db_model_hz", "/f_3db_model_std_hz", "Hz", SENSOR),
            Entry::of("f_3db_igep", Vector, "/f_3db_igep_hz", "", "Hz", SENSOR),
            Entry::of("f_s", Vector, "/f_s_hz", "/f_s_std_hz", "Hz", SENSOR),
            Entry::of("mean_f_s", Scalar(""), "/mean_f_s_hz", "/mean_f_s_std_hz", "Hz", "facility clock"),
            Entry::of("temperature", Scalar(""), "/run/temperature_degc", "", "degC", "sensor"),
        ],
        valid_degc: RUN_DEGC,
    });
    const MAY_LACK: &'static [&'static str] = &[
        "f_3db_igep_hz",
        "f_3db_model_hz",
        "f_3db_model_std_hz",
        "f_3db_model_degc",
        "f_s_hz",
        "f_s_std_hz",
        "model",
        "clock",
        "amplitude",
    ];
    fn file_name(&self) -> String {
        format!("FREQ_PARAMETER__{}.FPF", self.found.run.dashed_id())
    }
}
