//! The noise of the plateaus of a group, as its files have it.

use super::super::field::contradicts;
use crate::data::error::Finding;
use crate::data::units::COMPONENTS;
use crate::fit::noise::NoiseParameters;
use crate::fit::noise::dense::{GroupNoise, NoiseKind, Origin, Pooled};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The kinds of noise of the plateaus of a component, and how probable each is in a run of the group. Every list has an entry per kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoisePart {
    /// Component.
    pub component: String,
    /// Where slow noise comes from: `samples`, `plateaus` or `gain`.
    pub slow_noise_of: Vec<String>,
    /// Exponent of its power density.
    pub exponent: Vec<f64>,
    /// Its variance in a plateau over the white one that the samples let expect.
    pub slow_over_white: Vec<f64>,
    /// White variance of the plateaus over the one that the samples let expect.
    pub plateaus_over_samples: Vec<f64>,
    /// By how much the white variance at the largest reading is larger than at none, over the latter, beside what the samples show.
    pub growth: Vec<f64>,
    /// Probability.
    pub probability: Vec<f64>,
}

/// Probabilities of all kinds of noise add up to one within this, which is far above their rounding.
const ALL: f64 = 1e-6;
/// How origins of slow noise are written.
const ORIGINS: [(&str, Origin); 3] = [("samples", Origin::Samples), ("plateaus", Origin::Rows), ("gain", Origin::Gain)];

impl NoisePart {
    /// The tables of a group.
    #[must_use]
    pub fn of(group: &GroupNoise) -> Vec<Self> {
        let part = |(component, pooled): (&str, &Pooled)| {
            let mut part = NoisePart { component: component.to_owned(), ..NoisePart::default() };
            for (kind, probability) in pooled.kinds() {
                let origin = ORIGINS.iter().find(|(_, origin)| *origin == kind.origin).map_or("", |(name, _)| name);
                part.slow_noise_of.push(origin.to_owned());
                let own = kind.parameters;
                part.exponent.push(own.exponent);
                part.slow_over_white.push(if kind.origin == Origin::Gain { own.slow_field } else { own.slow });
                part.plateaus_over_samples.push(own.white);
                part.growth.push(own.white_field);
                part.probability.push(probability);
            }
            part
        };
        COMPONENTS.into_iter().zip(&group.components).map(part).collect()
    }

    /// Refuses tables that are not those of three components, or name an origin that slow noise does not have. That their lists go together
    /// is looked at in files of every kind.
    pub(super) fn are_sound(parts: &[Self], path: &Path) -> Result<(), Finding> {
        let named = |component: &str| parts.iter().filter(|part| part.component == component).count();
        if !parts.is_empty() && (parts.len() != COMPONENTS.len() || COMPONENTS.into_iter().any(|component| named(component) != 1))
        {
            return Err(contradicts(path, "noise does not have one table for each of x, y, z"));
        }
        let origins = parts.iter().flat_map(|part| &part.slow_noise_of);
        if let Some(other) = origins.into_iter().find(|name| ORIGINS.iter().all(|(own, _)| own != name)) {
            return Err(contradicts(path, format!("noise.slow_noise_of holds `{other}`, where slow noise does not come from")));
        }
        match parts.iter().find(|part| (part.probability.iter().sum::<f64>() - 1.0).abs() > ALL) {
            Some(part) => {
                Err(contradicts(path, format!("noise of {} has probabilities that do not add up to one", part.component)))
            }
            None => Ok(()),
        }
    }

    /// The noise of a group from its tables; `None` unless there is one per component.
    pub(super) fn together(parts: &[Self]) -> Option<GroupNoise> {
        let pooled = |component: &str| {
            let part = parts.iter().find(|part| part.component == component)?;
            let kind = |i: usize| {
                let origin = ORIGINS.iter().find(|(name, _)| *name == part.slow_noise_of[i])?.1;
                let (white, slow) = (*part.plateaus_over_samples.get(i)?, *part.slow_over_white.get(i)?);
                let parameters = NoiseParameters {
                    exponent: *part.exponent.get(i)?,
                    white,
                    slow: if origin == Origin::Gain { 0.0 } else { slow },
                    slow_field: if origin == Origin::Gain { slow } else { 0.0 },
                    white_field: *part.growth.get(i)?,
                    apart: white != 1.0,
                    ..NoiseParameters::WHITE
                };
                Some((NoiseKind { origin, parameters }, *part.probability.get(i)?))
            };
            Some(Pooled::of((0..part.slow_noise_of.len()).map(kind).collect::<Option<Vec<_>>>()?))
        };
        Some(GroupNoise { components: COMPONENTS.into_iter().map(pooled).collect::<Option<Vec<_>>>()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_of_other_components_origins_or_probabilities_is_refused() {
        let part = |component: &str| NoisePart {
            component: component.to_owned(),
            slow_noise_of: vec!["samples".to_owned(), "gain".to_owned()],
            probability: vec![0.25, 0.75],
            ..NoisePart::default()
        };
        let refused = |parts: &[NoisePart]| NoisePart::are_sound(parts, Path::new("T.TPF")).err().map(|f| f.to_string());
        let sound = [part("x"), part("y"), part("z")];
        assert_eq!((refused(&sound), refused(&[])), (None, None));
        let with = |change: fn(&mut NoisePart)| {
            let mut parts = sound.clone();
            change(&mut parts[1]);
            refused(&parts).unwrap_or_default()
        };
        assert!(with(|part| part.component = "x".to_owned()).contains("one table for each"));
        assert!(with(|part| part.slow_noise_of[0] = "weather".to_owned()).contains("`weather`"));
        assert!(with(|part| part.probability[0] = 0.5).contains("add up to one"));
        assert!(refused(&sound[..2]).is_some());
    }
}
