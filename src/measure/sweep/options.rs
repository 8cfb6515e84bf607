//! How a sweep is analysed.

use crate::data::plateau::Cut;
use crate::model::facility::Facility;
use crate::model::lag::{Lag, NoLag};
use crate::record::known::Known;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Settings of a window where nothing else is said, as in 1998.
pub const WINDOW: usize = 18;

/// Length of the sliding window.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Window {
    /// So many settings.
    Settings(usize),
    /// Settings of so many minutes.
    Minutes(f64),
}

impl Window {
    /// Whether it is the usual one, which a recipe does not name.
    #[must_use]
    pub fn is_usual(&self) -> bool {
        *self == Window::Settings(WINDOW)
    }
}

impl fmt::Display for Window {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Window::Settings(n) => write!(f, "{n} settings"),
            Window::Minutes(m) => write!(f, "{m} min"),
        }
    }
}

/// Which lag the sensor has behind its thermistor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum LagChoice {
    /// That of a model file if there is one, otherwise one that is significant.
    #[default]
    Auto,
    /// None.
    None,
    /// This one.
    Given(Lag),
}

impl LagChoice {
    /// Whether it is the usual one, which a recipe does not name.
    #[must_use]
    pub fn is_usual(&self) -> bool {
        *self == Self::default()
    }
}

impl FromStr for LagChoice {
    type Err = NoLag;

    fn from_str(text: &str) -> Result<Self, NoLag> {
        match text {
            "auto" => Ok(LagChoice::Auto),
            "none" => Ok(LagChoice::None),
            lag => lag.parse().map(LagChoice::Given),
        }
    }
}

impl fmt::Display for LagChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LagChoice::Auto => write!(f, "auto"),
            LagChoice::None => write!(f, "none"),
            LagChoice::Given(lag) => write!(f, "{lag}"),
        }
    }
}

impl From<LagChoice> for String {
    fn from(choice: LagChoice) -> Self {
        choice.to_string()
    }
}

impl TryFrom<String> for LagChoice {
    type Error = NoLag;

    fn try_from(text: String) -> Result<Self, NoLag> {
        text.parse()
    }
}

/// How a sweep is analysed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Which part of every setting is used.
    #[serde(flatten)]
    pub cut: Cut,
    /// Sliding window.
    #[serde(skip_serializing_if = "Window::is_usual")]
    pub window: Window,
    /// Settings at which the temperature moves faster are left out, K/min.
    #[serde(rename = "max_rate_k_per_min")]
    pub most_k_per_min: Option<f64>,
    /// Orders of the polynomials by quantity or family, `sigma_x` or `sigma` for example, where given.
    #[serde(rename = "order", skip_serializing_if = "Vec::is_empty")]
    pub orders: Vec<(String, usize)>,
    /// The lag of the sensor behind its thermistor.
    #[serde(skip_serializing_if = "LagChoice::is_usual")]
    pub lag: LagChoice,
    /// Go on when a sensitivity is far from 1.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_gain: bool,
    /// Go on when the readings do not follow the settings.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_mismatch: bool,
    /// The facility that turns settings into the reference field; `None` takes the settings as the field.
    #[serde(skip)]
    pub facility: Option<Facility>,
    /// Known effects, which are taken off the readings; a lag of the thermistor among them is used.
    #[serde(skip)]
    pub model: Option<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            cut: Cut::default(),
            window: Window::Settings(WINDOW),
            most_k_per_min: None,
            orders: Vec::new(),
            lag: LagChoice::Auto,
            allow_gain: false,
            allow_mismatch: false,
            facility: None,
            model: None,
        }
    }
}
