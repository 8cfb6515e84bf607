//! What the means of a run show by themselves that cannot be right, for every analysis with applied fields: components that do not follow the
//! fields or stand still, conversions far from the nominal one, axes elsewhere than the position says.

pub mod inside;

use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateaus;
use crate::data::units::COMPONENTS;
use crate::model::sensor::{Split, misplaced_axes};
use nalgebra::DMatrix;
use thiserror::Error;

/// Least part of the variance of a component that the applied field must explain.
const LEAST_EXPLAINED: f64 = 0.99;
/// A sensitivity outside this factor of the nominal conversion means a wrong unit or factor.
const PLAUSIBLE_GAIN: f64 = 1.5;
/// A component that varies by less than this part of its reading shows the last digit of a constant.
const ROUNDING: f64 = 1e-12;

/// What cannot be right.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Implausible {
    /// Step edges elsewhere.
    #[error("the data do not step where the settings do: the edges are displaced by about {shift_s:+.2} s, or by whole settings")]
    Edges {
        /// Displacement, s.
        shift_s: f64,
    },
    /// Readings that do not follow the field.
    #[error("component {component} does not follow the applied field, which explains {:.2} % of its variance", 100.0 * explained)]
    Unrelated {
        /// Component of the reading.
        component: &'static str,
        /// Part of the variance that the field explains.
        explained: f64,
    },
    /// A component that gives the same reading always.
    #[error("component {component} is stuck at {reading_ent} enT")]
    Stuck {
        /// Component of the reading.
        component: &'static str,
        /// Its reading, enT.
        reading_ent: f64,
    },
    /// An implausible sensitivity.
    #[error("the sensitivity of component {component} is {sigma:.4} nT per enT, far from 1")]
    Gain {
        /// Component of the reading.
        component: &'static str,
        /// Sensitivity, nT/enT.
        sigma: f64,
    },
    /// Implausible amplitudes of sines.
    #[error("sines of up to {applied_nt:.1} nT are read with amplitudes of {read_ent:.4} enT at most, {:.4} enT per nT, far from 1", read_ent / applied_nt)]
    Amplitude {
        /// Applied amplitude, nT.
        applied_nt: f64,
        /// Amplitude of the readings, enT.
        read_ent: f64,
    },
}

impl Implausible {
    /// What it is about.
    #[must_use]
    pub fn kind(&self) -> NoteKind {
        match self {
            Implausible::Edges { .. } | Implausible::Unrelated { .. } => NoteKind::Mismatch,
            Implausible::Stuck { .. } => NoteKind::Stuck,
            Implausible::Gain { .. } | Implausible::Amplitude { .. } => NoteKind::Gain,
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            Implausible::Edges { .. } => {
                "correct the times of the settings or take those of this run, or go on with --allow mismatch"
            }
            Implausible::Unrelated { .. } => {
                "check that the settings are those of this run and that the component works, or go on with --allow mismatch"
            }
            Implausible::Stuck { .. } => "check the component and its wiring",
            Implausible::Gain { .. } | Implausible::Amplitude { .. } => {
                "check `unit` and `nominal_factor`, or go on with --allow gain"
            }
        }
    }
}

/// Refuses what cannot be right, or tells it where the user goes on with it.
///
/// # Errors
/// What was found, if it is not allowed.
pub fn judge(found: Result<(), Implausible>, is_allowed: bool, notes: &mut impl Extend<Note>) -> Result<(), Implausible> {
    match found {
        Err(implausible) if is_allowed => {
            notes.extend([Note::new(implausible.kind(), format!("{implausible}, which was allowed"))]);
            Ok(())
        }
        other => other,
    }
}

/// Data that step elsewhere than the settings belong to other settings, or to another clock.
///
/// # Errors
/// [`Implausible::Edges`].
pub fn edges(plateaus: &Plateaus) -> Result<(), Implausible> {
    let shift_s = plateaus.edge_shift_s;
    if shift_s.abs() > plateaus.tolerable_shift_s { Err(Implausible::Edges { shift_s }) } else { Ok(()) }
}

/// A component whose variance the fit does not explain belongs to other settings, or is stuck.
///
/// # Errors
/// [`Implausible::Stuck`], [`Implausible::Unrelated`].
pub fn followed(readings_ent: &DMatrix<f64>, residuals_ent: &DMatrix<f64>) -> Result<(), Implausible> {
    for (component, name) in COMPONENTS.into_iter().enumerate() {
        let values = readings_ent.column(component);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let total: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        if total <= (ROUNDING * mean).powi(2) * values.len() as f64 {
            return Err(Implausible::Stuck { component: name, reading_ent: mean });
        }
        let explained = 1.0 - residuals_ent.column(component).norm_squared() / total;
        if explained < LEAST_EXPLAINED {
            return Err(Implausible::Unrelated { component: name, explained });
        }
    }
    Ok(())
}

/// Sensitivities far from the nominal conversion.
///
/// # Errors
/// [`Implausible::Gain`].
pub fn gain(split: &Split) -> Result<(), Implausible> {
    for (component, sigma) in COMPONENTS.into_iter().zip(split.sigma) {
        if !is_plausible(sigma) {
            return Err(Implausible::Gain { component, sigma });
        }
    }
    Ok(())
}

/// Amplitudes of sines far from those that were applied, both as moduli over the axes: a sensor attenuates what is fast and amplifies nothing,
/// so that the largest ratio is that of the conversion.
///
/// # Errors
/// [`Implausible::Amplitude`].
pub fn amplitude(pairs: impl Iterator<Item = (f64, f64)>) -> Result<(), Implausible> {
    let most = pairs.filter(|(applied, _)| *applied > 0.0).max_by(|a, b| (a.1 / a.0).total_cmp(&(b.1 / b.0)));
    match most {
        Some((applied_nt, read_ent)) if !is_plausible(read_ent / applied_nt) => {
            Err(Implausible::Amplitude { applied_nt, read_ent })
        }
        _ => Ok(()),
    }
}

/// Whether a conversion is within the factor of the nominal one that sensors keep.
#[must_use]
pub fn is_plausible(gain: f64) -> bool {
    (1.0 / PLAUSIBLE_GAIN..=PLAUSIBLE_GAIN).contains(&gain)
}

/// Says which axes do not stand as the position has them.
#[must_use]
pub fn axes(split: &Split) -> Vec<Note> {
    let mut notes = Vec::new();
    if split.rho.determinant() < 0.0 {
        let text = "the sensor axes are left-handed against the position; two components are swapped or one has the wrong sign, and no rotation leads there";
        notes.push(Note::new(NoteKind::Axes, text));
    }
    for (component, along) in misplaced_axes(split) {
        let name = COMPONENTS.get(component).copied().unwrap_or("?");
        let text = format!("component {name} looks along the nominal {along} axis");
        let kind = if along.ends_with(name) { NoteKind::ReversedAxis } else { NoteKind::SwappedAxes };
        notes.push(Note::new(kind, text).about(name).with_remedy("check the position, the wiring and the signs"));
    }
    notes
}
