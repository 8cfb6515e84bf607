//! Which part of a setting is a plateau.

use serde::{Deserialize, Serialize};

/// Where a setting's samples stop to be influenced by the step before it. As data it is a number of seconds, or nothing where it is found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Option<f64>", into = "Option<f64>")]
pub enum Settling {
    /// Found from the data.
    Found,
    /// Given, s after the begin of the setting.
    Given(f64),
}

impl From<Option<f64>> for Settling {
    fn from(given_s: Option<f64>) -> Self {
        given_s.map_or(Settling::Found, Settling::Given)
    }
}

impl From<Settling> for Option<f64> {
    fn from(settling: Settling) -> Self {
        match settling {
            Settling::Found => None,
            Settling::Given(s) => Some(s),
        }
    }
}

/// Default of the least part of the expected samples that a plateau must have.
pub const LEAST_COVERAGE: f64 = 0.9;

/// Which part of a setting is used, and how much of it must be there: options that analyses of plateaus share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Cut {
    /// Settling after a step.
    #[serde(rename = "settling_s")]
    pub settling: Settling,
    /// Least part of the expected samples of a plateau.
    #[serde(rename = "coverage", skip_serializing_if = "is_usual")]
    pub least_coverage: f64,
}

impl Default for Cut {
    fn default() -> Self {
        Self { settling: Settling::Found, least_coverage: LEAST_COVERAGE }
    }
}

/// The usual coverage is not named in a recipe.
fn is_usual(least_coverage: &f64) -> bool {
    *least_coverage == LEAST_COVERAGE
}
