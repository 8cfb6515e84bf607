//! A coil system whose parameters are known: what a facility file states, and what was done with it to the settings of a run.

use super::coil::Coil;
use super::sensor::SplitError;
use crate::data::note::Note;
use crate::data::provenance::Input;
use crate::data::result::Covariance;
use crate::data::start::Start;
use crate::fit::statistics::std_of;
use nalgebra::{DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why a facility cannot turn the settings of a run into fields.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FacilityError {
    /// Angles that no three axes have between them.
    #[error(transparent)]
    Axes(#[from] SplitError),
    /// The run lies outside of every period.
    #[error("{file} holds {periods}, and the run lasts {run}")]
    Outside {
        /// The facility file.
        file: String,
        /// Its periods, in words.
        periods: String,
        /// Begin and end of the settings, in words.
        run: String,
    },
}

impl FacilityError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            FacilityError::Axes(_) => "correct the facility",
            FacilityError::Outside { .. } => "name a facility file that holds at the time of the run",
        }
    }
}

/// A facility as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Facility {
    /// The file, under its name.
    pub input: Input,
    /// Its values with the times in which they hold, at least one.
    pub periods: Vec<Period>,
    /// Smallest and largest temperature of the coils at which it was measured, °C; absent where the file does not say so.
    pub valid_coil_degc: Option<[f64; 2]>,
    /// The same of the rack.
    pub valid_rack_degc: Option<[f64; 2]>,
    /// What qualifies its values.
    pub notes: Vec<Note>,
}

/// Values of a facility and the time in which they hold.
#[derive(Clone, Debug, PartialEq)]
pub struct Period {
    /// When they hold.
    pub span: PeriodSpan,
    /// The values.
    pub part: FacilityParameters,
    /// Covariance of the values, under the names of [`FacilityParameters::value_mut`]; absent where the file states none.
    pub covariance: Option<Covariance>,
}

/// The time in which values of a facility hold: from the first moment on, until before the second one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PeriodSpan {
    /// First moment, UTC; absent if they hold from ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<Start>,
    /// First moment at which they hold no longer, UTC; absent if they hold for ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<Start>,
}

impl PeriodSpan {
    /// Whether a moment lies in it, s since 1970.
    #[must_use]
    pub fn holds(&self, utc_s: f64) -> bool {
        self.from.as_ref().is_none_or(|from| from.seconds() <= utc_s) && self.to.as_ref().is_none_or(|to| utc_s < to.seconds())
    }

    /// Whether it has neither begin nor end.
    #[must_use]
    pub fn is_always(&self) -> bool {
        self.from.is_none() && self.to.is_none()
    }
}

impl std::fmt::Display for PeriodSpan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (&self.from, &self.to) {
            (Some(from), Some(to)) => write!(f, "from {from} to {to}"),
            (Some(from), None) => write!(f, "from {from} on"),
            (None, Some(to)) => write!(f, "until {to}"),
            (None, None) => write!(f, "always"),
        }
    }
}

impl Facility {
    /// The place of the period that holds at a moment, s since 1970; `None` outside of all.
    #[must_use]
    pub fn period_at(&self, utc_s: f64) -> Option<usize> {
        self.periods.iter().position(|p| p.span.holds(utc_s))
    }

    /// The periods in words.
    #[must_use]
    pub fn periods_in_words(&self) -> String {
        self.periods.iter().map(|p| p.span.to_string()).collect::<Vec<_>>().join("; ")
    }

    /// The values of a facility that has the same at all times; `None` if it has several periods.
    #[must_use]
    pub fn only_part(&self) -> Option<&FacilityParameters> {
        match self.periods.as_slice() {
            [one] => Some(&one.part),
            _ => None,
        }
    }

    /// The same without offset fields.
    #[must_use]
    pub fn without_offset(&self) -> Facility {
        let without = |p: &Period| Period {
            part: FacilityParameters { offset_nt: [0.0; 3], offset_nt_per_k: None, rack_offset_nt_per_k: None, ..p.part.clone() },
            covariance: p.covariance.as_ref().map(|c| keeping(c, |name| !name.contains("offset"))),
            span: p.span.clone(),
        };
        Facility { periods: self.periods.iter().map(without).collect(), ..self.clone() }
    }

    /// Whether its values, or their uncertainties, depend on the rack temperature.
    #[must_use]
    pub fn follows_rack(&self) -> bool {
        let is_uncertain = |p: &Period| p.is_uncertain(&["rack_scale_per_k_", "rack_offset_per_k_"]);
        self.periods.iter().any(|p| acts(p.part.rack_scale_per_k) || acts(p.part.rack_offset_nt_per_k) || is_uncertain(p))
    }

    /// Whether its values, or their uncertainties, depend on the coil temperature.
    #[must_use]
    pub fn follows_coil(&self) -> bool {
        let is_uncertain = |p: &Period| p.is_uncertain(&["scale_per_k_", "offset_per_k_"]);
        self.periods.iter().any(|p| acts(p.part.scale_per_k) || acts(p.part.offset_nt_per_k) || is_uncertain(p))
    }
}

fn acts(values: Option<[f64; 3]>) -> bool {
    values.is_some_and(|v| v.iter().any(|v| *v != 0.0))
}

/// The covariance of some of the parameters.
fn keeping(covariance: &Covariance, keep: impl Fn(&str) -> bool) -> Covariance {
    let places: Vec<usize> = (0..covariance.parameters.len()).filter(|i| keep(&covariance.parameters[*i])).collect();
    let of = |list: &[String]| places.iter().filter_map(|i| list.get(*i).cloned()).collect();
    Covariance {
        parameters: of(&covariance.parameters),
        units: of(&covariance.units),
        matrix: places.iter().map(|r| places.iter().map(|c| covariance.matrix[*r][*c]).collect()).collect(),
    }
}

impl Period {
    /// Whether the covariance gives a variance to a parameter whose name begins with one of these.
    fn is_uncertain(&self, beginnings: &[&str]) -> bool {
        self.covariance.as_ref().is_some_and(|covariance| {
            let is_meant = |name: &str| beginnings.iter().any(|beginning| name.starts_with(beginning));
            covariance.parameters.iter().enumerate().any(|(i, name)| is_meant(name) && covariance.matrix[i][i] > 0.0)
        })
    }

    /// The values moved by one standard deviation along each principal direction of their covariance. The sum of the squares of what
    /// these moves change in a result is the variance that the facility gives to it.
    #[must_use]
    pub fn moved(&self) -> Vec<FacilityParameters> {
        let Some(covariance) = &self.covariance else { return Vec::new() };
        let count = covariance.parameters.len();
        let given = DMatrix::from_fn(count, count, |r, c| covariance.matrix[r][c]);
        // The parameters have units of very different sizes: the directions are those of the correlations.
        let std: Vec<f64> = (0..count).map(|i| std_of(given[(i, i)])).collect();
        let inverse = |i: usize| if std[i] > 0.0 { 1.0 / std[i] } else { 0.0 };
        let correlation = DMatrix::from_fn(count, count, |r, c| given[(r, c)] * inverse(r) * inverse(c));
        let eigen = SymmetricEigen::new(correlation);
        let direction = |k: usize| {
            let size = eigen.eigenvalues[k].max(0.0).sqrt();
            let mut part = self.part.clone();
            for (i, name) in covariance.parameters.iter().enumerate() {
                if let Some(value) = part.value_mut(name) {
                    *value += size * eigen.eigenvectors[(i, k)] * std[i];
                }
            }
            part
        };
        (0..count).filter(|k| eigen.eigenvalues[*k] > 0.0).map(direction).collect()
    }
}

/// Parameters of the facility, or their standard uncertainties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FacilityParameters {
    /// Scale factors, nT/EU.
    pub scale_nt_per_eu: [f64; 3],
    /// Offset fields, nT.
    pub offset_nt: [f64; 3],
    /// Angles between the coils XY, XZ, YZ, degrees.
    pub angles_deg: [f64; 3],
    /// Relative change of the scale factors with the coil temperature, 1/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_per_k: Option<[f64; 3]>,
    /// Change of the offset fields with the coil temperature, nT/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset_nt_per_k: Option<[f64; 3]>,
    /// Coil temperature for which scale factors and offset fields hold, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_degc: Option<f64>,
    /// Relative change of the scale factors with the rack temperature, 1/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_scale_per_k: Option<[f64; 3]>,
    /// Change of the offset fields with the rack temperature, nT/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_offset_nt_per_k: Option<[f64; 3]>,
    /// Rack temperature for which they hold, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_reference_degc: Option<f64>,
}

impl FacilityParameters {
    /// Scale factors, offset fields and angles that do not depend on temperature.
    #[must_use]
    pub fn constant(scale_nt_per_eu: [f64; 3], offset_nt: [f64; 3], angles_deg: [f64; 3]) -> Self {
        Self {
            scale_nt_per_eu,
            offset_nt,
            angles_deg,
            scale_per_k: None,
            offset_nt_per_k: None,
            reference_degc: None,
            rack_scale_per_k: None,
            rack_offset_nt_per_k: None,
            rack_reference_degc: None,
        }
    }

    /// A parameter by the name that it has in a covariance: `scale_x`, `offset_y`, `angle_xz`, `scale_per_k_x`, `offset_per_k_x`,
    /// `rack_scale_per_k_x`, `rack_offset_per_k_x`; `None` for any other. Coefficients that are not stated become zeros.
    pub fn value_mut(&mut self, name: &str) -> Option<&mut f64> {
        let (quantity, component) = name.rsplit_once('_')?;
        let names = if quantity == "angle" { ["xy", "xz", "yz"] } else { ["x", "y", "z"] };
        let place = names.iter().position(|n| *n == component)?;
        let values = match quantity {
            "scale" => &mut self.scale_nt_per_eu,
            "offset" => &mut self.offset_nt,
            "angle" => &mut self.angles_deg,
            "scale_per_k" => self.scale_per_k.get_or_insert_default(),
            "offset_per_k" => self.offset_nt_per_k.get_or_insert_default(),
            "rack_scale_per_k" => self.rack_scale_per_k.get_or_insert_default(),
            "rack_offset_per_k" => self.rack_offset_nt_per_k.get_or_insert_default(),
            _ => return None,
        };
        Some(&mut values[place])
    }

    /// The coil system with these parameters; what is not stated does not depend on temperature.
    #[must_use]
    pub fn coil(&self) -> Coil {
        Coil {
            scale_nt_per_eu: self.scale_nt_per_eu,
            offset_nt: self.offset_nt,
            angles_deg: self.angles_deg,
            scale_per_k: self.scale_per_k.unwrap_or_default(),
            offset_nt_per_k: self.offset_nt_per_k.unwrap_or_default(),
            rack_scale_per_k: self.rack_scale_per_k.unwrap_or_default(),
            rack_offset_nt_per_k: self.rack_offset_nt_per_k.unwrap_or_default(),
            reference_degc: self.reference_degc.unwrap_or(Coil::IDEAL.reference_degc),
            rack_reference_degc: self.rack_reference_degc.unwrap_or(Coil::IDEAL.rack_reference_degc),
        }
    }
}

/// The facility that turned the settings of a run into the reference field, every setting at the temperatures of its own time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FacilityApplied {
    /// File it came from, which is among the inputs.
    pub file: String,
    /// Mean coil temperature over the settings, °C; absent if nothing depends on it or it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_degc: Option<f64>,
    /// Smallest and largest coil temperature that was used, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_range_degc: Option<[f64; 2]>,
    /// Mean rack temperature over the settings, °C; absent if nothing depends on it or it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_degc: Option<f64>,
    /// Smallest and largest rack temperature that was used, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_range_degc: Option<[f64; 2]>,
    /// Period of the facility file, that of the first setting; absent if the file holds always.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub period: Option<PeriodSpan>,
    /// Its parameters, in this period.
    pub applied: FacilityParameters,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A coefficient of zero that is uncertain makes the temperature matter as any other does.
    #[test]
    fn a_facility_follows_the_temperatures_whose_coefficients_are_uncertain() {
        let with = |name: &str, variance: f64| Facility {
            valid_coil_degc: None,
            valid_rack_degc: None,
            notes: Vec::new(),
            input: Input::default(),
            periods: vec![Period {
                span: PeriodSpan::default(),
                part: FacilityParameters {
                    scale_per_k: Some([0.0; 3]),
                    rack_scale_per_k: Some([0.0; 3]),
                    ..FacilityParameters::constant([1.0; 3], [0.0; 3], [90.0; 3])
                },
                covariance: Some(Covariance {
                    parameters: vec![name.to_owned()],
                    units: vec!["1/K".to_owned()],
                    matrix: vec![vec![variance]],
                }),
            }],
        };
        let follows = |name: &str, variance: f64| {
            let facility = with(name, variance);
            (facility.follows_coil(), facility.follows_rack())
        };
        assert_eq!(follows("scale_per_k_x", 1e-12), (true, false));
        assert_eq!(follows("offset_per_k_z", 1e-12), (true, false));
        assert_eq!(follows("rack_scale_per_k_y", 1e-12), (false, true));
        assert_eq!(follows("rack_offset_per_k_y", 1e-12), (false, true));
        assert_eq!(follows("scale_per_k_x", 0.0), (false, false));
        assert_eq!(follows("scale_x", 1e-12), (false, false));
    }
}
