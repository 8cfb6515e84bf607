//! Temperature polynomials across the runs of a sensor in one mode (BC-MAG-TR-0085 sections 12 and 13).

mod group;
mod parts;
mod quantity;
mod result;

pub use group::{Kind, RunGroup, groups};
pub use result::{Corner, LinAcross, OfKind, QuantityFit, RunsUsed, SamplingAcross, Thermal};

pub(super) use group::asked_order;
pub(super) use result::band;

use crate::data::across::{CalibratedRun, LinearScope, LinearisedDifferently, RunValues};
use crate::data::note::{Note, NoteKind};
use crate::data::reference::StatedReference;
use crate::data::result::Rows;
use crate::fit::FitError;
use crate::measure::lin::Lin;
use parts::{common_noise, joint_fit, model_error, residual_field, rotation};
use quantity::{different_temperatures, fit, quantities};
use thiserror::Error;

/// Why a group has no polynomials.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ThermalError {
    /// Not enough to compare.
    #[error("its {kind} runs ({files}) are at {temperatures} different temperature, polynomials need two")]
    TooFew {
        /// What the runs are.
        kind: &'static str,
        /// Their parameter files.
        files: String,
        /// Different temperatures.
        temperatures: usize,
    },
    /// A polynomial cannot be fitted.
    #[error("{quantity}: {error}")]
    Fit {
        /// Quantity.
        quantity: String,
        /// Why.
        error: FitError,
    },
    /// Readings that were not linearised in one way.
    #[error("{error} ({files})")]
    Linearised {
        /// Their parameter files.
        files: String,
        /// What is wrong.
        error: LinearisedDifferently,
    },
}

impl ThermalError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            ThermalError::TooFew { .. } => "measure at further temperatures, or check the temperature channel of the runs",
            ThermalError::Fit { error: FitError::OrderTooHigh { .. } | FitError::TooFewPoints { .. }, .. } => {
                "give a lower order for it with --order or in campaign.toml"
            }
            ThermalError::Fit { .. } => "check the values of the runs",
            ThermalError::Linearised { .. } => "calibrate all of them with the same linearisation, or all without one",
        }
    }
}

/// Runs within this range are at one temperature, °C: a chamber holds its temperature within a few tenths during a run.
pub(super) const SAME_DEGC: f64 = 0.5;

/// The polynomials of one kind of runs of a group. `runs` are the linear calibrations with their plateaus, as far as they are at hand;
/// a joint fit needs them.
///
/// # Errors
/// [`ThermalError`]: too few temperatures, or an order that they do not carry.
pub fn thermal(group: &RunGroup, kind: Kind, runs: &[&Lin], with_joint: bool) -> Result<Thermal, ThermalError> {
    let mut notes = left_out(group, kind);
    let points = without_copies(group.of_kind(kind), &mut notes);
    let temperatures: Vec<f64> = points.iter().filter_map(|p| p.run.temperature_degc).collect();
    check_temperatures(group, kind, &points, &temperatures)?;
    let corner = corner_of(&points, kind, &mut notes);
    let mut fits = Vec::new();
    let has_own_residual = in_one_position(&points, &temperatures, &mut notes);
    for quantity in quantities(&points, kind, corner, &has_own_residual) {
        match fit(group, &quantity, &points, &temperatures, &mut notes)? {
            Some(fitted) => fits.push(fitted),
            None => {
                let text = format!("{} is not determined in enough of the runs", quantity.name);
                notes.push(Note::new(NoteKind::Data, text).about(&quantity.name));
            }
        }
    }
    let channel = common_channel(&points, &mut notes);
    let reference = common_reference(&points, &mut notes);
    let joint = if with_joint && kind == Kind::Lin {
        joint_fit(&points, runs, &fits)
            .map_err(|error| notes.push(Note::new(NoteKind::Method, format!("no joint fit: {error}"))))
            .ok()
    } else {
        None
    };
    for (fitted, polynomial) in fits.iter_mut().zip(joint.iter().flat_map(|j| &j.polynomials)) {
        fitted.joint_band = band(polynomial.valid_degc, |t| polynomial.evaluate(t));
    }
    let of_kind = match kind {
        Kind::Lin => OfKind::Lin(Box::new(LinAcross {
            rotation: rotation(&points),
            model_error: model_error(&points, runs, &fits),
            joint,
            scope: common_scope(&points)?,
            noise: common_noise(&points, runs),
        })),
        Kind::Offset => OfKind::Offset(residual_field(&points, &mut notes)),
        Kind::Freq => OfKind::Freq(sampling(&points, corner)),
    };
    notes.extend(points.iter().flat_map(|p| p.notes.iter().cloned()));
    Ok(Thermal {
        valid_degc: common_range(&fits),
        runs: RunsUsed {
            files: points.iter().map(|p| p.file.clone()).collect(),
            ids: points.iter().map(|p| p.run.id.clone()).collect(),
            sensor: group.sensor.clone(),
            mode: group.mode.clone(),
            location: group.location,
            channel,
            temperature_degc: temperatures,
            coil_temperature_degc: points.iter().map(|p| p.run.coil_temperature_degc.unwrap_or(f64::NAN)).collect(),
            reference,
        },
        quantities: fits,
        of_kind,
        notes,
    })
}

/// Files of runs of a kind that state no sensor temperature.
fn without_temperature(group: &RunGroup, kind: Kind) -> impl Iterator<Item = &str> {
    group.without_temperature.iter().filter(move |(k, _)| *k == kind).map(|(_, file)| file.as_str())
}

/// A note about every run without a sensor temperature.
fn left_out(group: &RunGroup, kind: Kind) -> Vec<Note> {
    let note = |file| Note::new(NoteKind::LeftOut, format!("{file} states no sensor temperature and was left out")).about(file);
    without_temperature(group, kind).map(note).collect()
}

/// The runs without those that are copies of another one under another id, which would count twice: no two measurements give the same temperature and
/// the same values to the last bit, and no reading belongs to two of them.
fn without_copies<'a>(points: Vec<&'a CalibratedRun>, notes: &mut Vec<Note>) -> Vec<&'a CalibratedRun> {
    let mut kept: Vec<&CalibratedRun> = Vec::with_capacity(points.len());
    for point in &points {
        let is_same = |other: &&&CalibratedRun| {
            let degc = [other, &point].map(|p| p.run.temperature_degc.map(f64::to_bits));
            degc[0] == degc[1] && quantity::has_values_of(&other.values, &point.values)
        };
        let id = &point.run.id;
        let text = if let Some(first) = kept.iter().find(is_same) {
            format!(
                "run {id} was left out: its values and its temperature are those of run {} to the last digit, it is a copy of the same readings under \
                 another id and would count twice",
                first.run.id
            )
        } else if let Some(other) = point.copy_of.as_ref().filter(|other| points.iter().any(|p| p.run.id == **other)) {
            format!(
                "run {id} was left out: most of its readings stand in run {other} as well, both are of one recording and it would count twice"
            )
        } else {
            kept.push(*point);
            continue;
        };
        notes.push(Note::new(NoteKind::LeftOut, text).about(id).with_remedy("take one of the two away"));
    }
    kept
}

/// Refuses runs that are all at one temperature.
fn check_temperatures(
    group: &RunGroup,
    kind: Kind,
    points: &[&CalibratedRun],
    temperatures_degc: &[f64],
) -> Result<(), ThermalError> {
    let temperatures = different_temperatures(temperatures_degc);
    if temperatures >= 2 {
        return Ok(());
    }
    let mut files = points.iter().map(|p| p.file.as_str()).collect::<Vec<_>>().join(", ");
    let without: Vec<&str> = without_temperature(group, kind).collect();
    if !without.is_empty() {
        files.push_str(&format!("; without one: {}", without.join(", ")));
    }
    Err(ThermalError::TooFew { kind: kind.name(), files, temperatures })
}

/// Which -3 dB frequency all runs have: that of a model if each has one.
fn corner_of(points: &[&CalibratedRun], kind: Kind, notes: &mut Vec<Note>) -> Corner {
    let has_model =
        |p: &&&CalibratedRun| matches!(&p.values, RunValues::Freq { model_hz: Some(hz), .. } if hz.iter().any(|v| v.is_finite()));
    let without: Vec<&str> = points.iter().filter(|p| !has_model(p)).map(|p| p.file.as_str()).collect();
    if without.is_empty() {
        return Corner::Model;
    }
    if kind == Kind::Freq && without.len() < points.len() {
        let text = format!("f_3dB by interpolation (igep) is used for all runs: {} hold none of a model", without.join(", "));
        notes.push(Note::new(NoteKind::Method, text));
    }
    Corner::Interpolated
}

/// Which runs tell offset and residual field: those in the position of most of them, since a sensor that stands otherwise sees the residual
/// field of the coil system along other axes, which is no dependence on temperature. All of them where one position has a single temperature.
fn in_one_position(points: &[&CalibratedRun], temperatures_degc: &[f64], notes: &mut Vec<Note>) -> Vec<bool> {
    let position = |p: &CalibratedRun| match &p.values {
        RunValues::Lin { r_nom, .. } => r_nom.as_deref().copied(),
        _ => None,
    };
    let positions: Vec<Option<Rows>> = points.iter().map(|p| position(p)).collect();
    let count = |of: &Rows| positions.iter().flatten().filter(|p| *p == of).count();
    // The first of equals; a run that does not tell its position is taken to stand as most do.
    let most = positions.iter().rev().flatten().max_by_key(|p| count(p));
    let kept: Vec<bool> = positions.iter().map(|p| p.as_ref().is_none_or(|p| Some(p) == most)).collect();
    if kept.iter().all(|kept| *kept) {
        return kept;
    }
    let own: Vec<f64> = temperatures_degc.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(degc, _)| *degc).collect();
    let others: Vec<&str> = points.iter().zip(&kept).filter(|(_, kept)| !**kept).map(|(p, _)| p.run.id.as_str()).collect();
    let why =
        "the sensor stood in several positions, in which it sees the residual field of the coil system along different axes";
    if different_temperatures(&own) < 2 {
        let text = format!("{why}: what b_or follows of the temperature holds it as well; b_off does not");
        notes.push(Note::new(NoteKind::Method, text));
        return vec![true; points.len()];
    }
    let text = format!("{why}: b_or is that of the position of most runs, without {}", others.join(", "));
    notes.push(Note::new(NoteKind::Method, text));
    kept
}

/// The channel of the sensor temperature, the first by name if the runs took it from several.
fn common_channel(points: &[&CalibratedRun], notes: &mut Vec<Note>) -> Option<String> {
    let mut channels: Vec<&str> = points.iter().filter_map(|p| p.channel.as_deref()).collect();
    channels.sort_unstable();
    channels.dedup();
    if channels.len() > 1 {
        let text = format!("the runs took their temperature from different channels: {}", channels.join(", "));
        notes.push(Note::new(NoteKind::Temperature, text));
    }
    channels.first().map(|c| (*c).to_owned())
}

/// The rotation to the reference cube that all runs state which state one.
fn common_reference(points: &[&CalibratedRun], notes: &mut Vec<Note>) -> Option<StatedReference> {
    let mut stated = points.iter().filter_map(|p| p.reference);
    let first = stated.next()?;
    if stated.all(|other| first.is_like(&other)) {
        return Some(first);
    }
    let text = "the runs state different rotations to the reference cube: none is carried on";
    notes.push(Note::new(NoteKind::Method, text));
    None
}

/// What the linear calibrations hold for together.
fn common_scope(points: &[&CalibratedRun]) -> Result<LinearScope, ThermalError> {
    let scopes = points.iter().filter_map(|p| match &p.values {
        RunValues::Lin { scope, .. } => Some(scope.as_ref()),
        _ => None,
    });
    LinearScope::common(scopes).map_err(|error| {
        let files = points.iter().map(|p| p.file.as_str()).collect::<Vec<_>>().join(", ");
        ThermalError::Linearised { files, error }
    })
}

/// The temperatures for which all polynomials hold, °C.
fn common_range(fits: &[QuantityFit]) -> [f64; 2] {
    fits.iter()
        .map(|f| f.polynomial.valid_degc)
        .fold([f64::NEG_INFINITY, f64::INFINITY], |[low, high], [from, to]| [low.max(from), high.min(to)])
}

/// Sampling frequencies of frequency measurements.
fn sampling(points: &[&CalibratedRun], corner: Corner) -> SamplingAcross {
    let (f_s_hz, f_s_std_hz) = points
        .iter()
        .map(|p| match &p.values {
            RunValues::Freq { f_s_hz, f_s_std_hz, .. } => (f_s_hz.unwrap_or(f64::NAN), f_s_std_hz.unwrap_or(f64::NAN)),
            _ => (f64::NAN, f64::NAN),
        })
        .unzip();
    SamplingAcross { corner, f_s_hz, f_s_std_hz }
}
