//! What the results of several analyses hold: the run, its temperatures, the plateaus left out, spreads and covariances.
//!
//! Parameter files hold these types as they are, so that each is defined here only.

use super::run::Location;
use super::start::{Start, or_empty};
use serde::{Deserialize, Serialize};

/// A 3 x 3 matrix as its three rows.
pub type Rows = [[f64; 3]; 3];

/// The run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunHead {
    /// Run id.
    pub id: String,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Where the sensor stood.
    #[serde(default, skip_serializing_if = "Location::is_centre")]
    pub location: Location,
    /// Mean sensor temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_degc: Option<f64>,
    /// Mean coil-system temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_temperature_degc: Option<f64>,
    /// Campaign and instrument, or what was assumed without a campaign file.
    pub campaign: String,
    /// Start, UTC; not known of a table of amplitudes.
    #[serde(with = "or_empty")]
    pub start: Option<Start>,
    /// Field programme.
    pub configuration: String,
    /// Source of the field.
    pub field_source: String,
    /// Whether the facility corrected its coil parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_correction: Option<bool>,
    /// Earth-field compensation per coil axis.
    pub earthfield_compensation: Vec<String>,
}

impl RunHead {
    /// The run id as it stands in the file names of offset, frequency and thermal analyses: `13-04-03-09-53-35`.
    #[must_use]
    pub fn dashed_id(&self) -> String {
        self.id.replace('_', "-")
    }
}

/// Temperatures during the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// Channel of the sensor temperature.
    pub sensor_channel: String,
    /// Smallest, mean and largest sensor temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_degc: Option<[f64; 3]>,
    /// Highest minus lowest sensor temperature of the settings used, K, where it moved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_range_k: Option<f64>,
    /// Straight line through the sensor temperatures of the settings used, K/h, where they moved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_rate_k_per_h: Option<f64>,
    /// Channel of the coil temperature.
    pub coil_channel: String,
    /// Smallest, mean and largest coil temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_degc: Option<[f64; 3]>,
}

/// A sensor whose temperature moves by less during a run is at rest, K.
pub const AT_REST_K: f64 = 1.0;

/// Lowest and highest temperature, °C, for which values hold that belong to the mean temperature of a run: those of the run, or what counts
/// as rest about the mean where the sensor moved. From its smallest, mean and largest temperature, °C.
#[must_use]
pub fn valid_of_run([low, mean, high]: [f64; 3]) -> [f64; 2] {
    if high - low > AT_REST_K { [mean - 0.5 * AT_REST_K, mean + 0.5 * AT_REST_K] } else { [low, high] }
}

/// A plateau that was not used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dropped {
    /// Index of the setting, from 1.
    pub block: usize,
    /// Begin of the setting, s.
    pub t_start_s: f64,
    /// Field, nT, coil axes.
    pub field_coil_nt: [f64; 3],
    /// Why.
    pub reason: String,
}

/// How many rows of a run its result rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct RowsUsed {
    /// Rows used.
    pub used: usize,
    /// Rows in the run.
    pub total: usize,
    /// Why the others were not, with the number of rows for each reason.
    pub rejected: Vec<(String, usize)>,
}

impl RowsUsed {
    /// The rows that are not used, each with its reason.
    #[must_use]
    pub fn new(used: usize, total: usize, reasons: impl Iterator<Item = String>) -> Self {
        let mut rejected: Vec<(String, usize)> = Vec::new();
        for reason in reasons {
            match rejected.iter_mut().find(|(own, _)| *own == reason) {
                Some((_, count)) => *count += 1,
                None => rejected.push((reason, 1)),
            }
        }
        Self { used, total, rejected }
    }

    /// The same of settings.
    #[must_use]
    pub fn of_settings(used: usize, total: usize, dropped: &[Dropped]) -> Self {
        Self::new(used, total, dropped.iter().map(|d| d.reason.clone()))
    }
}

/// Smallest, mean and largest of a quantity per component.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Smallest.
    pub min: [f64; 3],
    /// Mean.
    pub mean: [f64; 3],
    /// Largest.
    pub max: [f64; 3],
}

/// Standard deviation and extremes per component.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Standard deviation (divided by the number of values).
    pub std: [f64; 3],
    /// Largest.
    pub max: [f64; 3],
    /// Smallest.
    pub min: [f64; 3],
}

/// Covariance of `Φ` (nine elements, row by row) and `B_or` (three).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Covariance {
    /// Names of rows and columns.
    pub parameters: Vec<String>,
    /// Units of the parameters.
    pub units: Vec<String>,
    /// Rows.
    pub matrix: Vec<Vec<f64>>,
}

impl Covariance {
    /// With that of independent errors of the same parameters.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let rows = self.matrix.iter().zip(&other.matrix);
        Self { matrix: rows.map(|(a, b)| a.iter().zip(b).map(|(a, b)| a + b).collect()).collect(), ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_not_used_are_counted_by_their_reasons() {
        let reasons = ["field beyond ±1900 nT on x", "by hand: door", "field beyond ±1900 nT on x"].map(str::to_owned);
        let rows = RowsUsed::new(69, 72, reasons.into_iter());
        assert_eq!(rows.rejected, [("field beyond ±1900 nT on x".to_owned(), 2), ("by hand: door".to_owned(), 1)]);
    }

    #[test]
    fn values_of_a_run_that_moved_hold_about_its_mean_temperature() {
        assert_eq!(valid_of_run([20.0, 20.25, 21.0]), [20.0, 21.0]);
        assert_eq!(valid_of_run([20.0, 30.0, 44.0]), [29.5, 30.5]);
    }
}
