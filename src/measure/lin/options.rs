//! How a linear calibration is made.

use crate::data::plateau::Cut;
use crate::data::recipe::axes;
use crate::model::facility::Facility;
use crate::model::linearisation::Linearisation;
use crate::model::sensor_polynomials::SensorPolynomials;
use crate::record::known::Known;
use serde::{Deserialize, Serialize};

/// How a linear calibration is made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Order of the offset trend, 0 to 2; `None` takes that of the campaign, or 2.
    #[serde(rename = "order")]
    pub trend_order: Option<usize>,
    /// Largest magnitude of the field along a nominal sensor axis, nT, beside those of the campaign.
    #[serde(with = "axes", skip_serializing_if = "axes::none")]
    pub max_field_nt: [Option<f64>; 3],
    /// Give outlying plateaus less weight.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub robust: bool,
    /// Which part of every setting is used.
    #[serde(flatten)]
    pub cut: Cut,
    /// Go on when a sensitivity is far from its nominal value.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_gain: bool,
    /// Go on when the readings do not follow the settings.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_mismatch: bool,
    /// The facility that turns settings into the reference field; `None` takes the settings as the field.
    #[serde(skip)]
    pub facility: Option<Facility>,
    /// The polynomials that linearise the readings; `None` takes the readings as they are.
    #[serde(skip)]
    pub linearisation: Option<Linearisation>,
    /// Known effects, which are taken off the readings.
    #[serde(skip)]
    pub model: Option<Known>,
    /// What sensitivities, angles and offset follow of the sensor temperature; `None` finds it in the run where the temperature moves.
    #[serde(skip)]
    pub temperature: Option<SensorPolynomials>,
}
