//! The residual field of the facility from moduli at plus and minus F on one coil axis: half their difference (BC-MAG-TR-0085
//! section 1; docs/mathematics.md, "The coil system"). Fields across the axis act on both alike.

use super::{AXES, CoilError};
use crate::data::note::{Note, NoteKind};
use crate::data::run::Run;
use crate::data::tables::ModulusRow;
use crate::model::facility::FacilityParameters;
use crate::model::facility_calibration::{AxisResidual, ResidualFound, ResidualState};

/// Other axes are at zero if their settings are below this share of that of the axis.
const ASIDE: f64 = 1e-6;
/// Plus and minus F belong together if they differ by less than this share.
const SAME: f64 = 1e-3;
/// Decimals of a modulus that are looked at for its resolution.
const MOST_DECIMALS: i32 = 6;

/// Residual fields.
#[derive(Clone, Debug, PartialEq)]
pub struct Residual {
    /// What was found.
    pub found: ResidualFound,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// One pair of moduli, with the magnitudes of the settings.
#[derive(Clone, Debug)]
struct Pair {
    state: String,
    axis: usize,
    plus_nt: f64,
    minus_nt: f64,
    /// Magnitude of the positive setting minus that of the negative one.
    setting_difference: f64,
    std_nt: Option<f64>,
}

/// Residual fields from a table of moduli, which has the name `used`.
///
/// # Errors
/// No rows.
pub fn of_table(rows: &[ModulusRow], used: &str) -> Result<Residual, CoilError> {
    let pair = |r: &ModulusRow| Pair {
        state: r.state.clone(),
        axis: r.axis,
        plus_nt: r.plus_nt,
        minus_nt: r.minus_nt,
        setting_difference: 0.0,
        std_nt: r.std_nt,
    };
    of_pairs(&rows.iter().map(pair).collect::<Vec<_>>(), vec![used.to_owned()])
}

/// Residual fields from the `@SCALAR` rows of some runs in time order; every run is a state of the facility.
///
/// # Errors
/// No row with a setting on one axis that has its opposite.
pub fn residual(runs: &[&Run]) -> Result<Residual, CoilError> {
    let mut pairs = Vec::new();
    let mut used = Vec::new();
    for run in runs {
        let found = pairs_of(run);
        if !found.is_empty() {
            used.push(run.header.run.clone());
        }
        pairs.extend(found);
    }
    of_pairs(&pairs, used)
}

/// Whether a run only checks the residual field: all its settings lie on one axis, which no scalar calibration can do with.
#[must_use]
pub fn is_check(run: &Run) -> bool {
    !run.scalar.is_empty() && run.scalar.iter().all(|row| axis_of(row.setting).is_some())
}

/// The axis along which a setting lies alone.
fn axis_of(setting: [f64; 3]) -> Option<usize> {
    let axis = (0..3).max_by(|a, b| setting[*a].abs().total_cmp(&setting[*b].abs()))?;
    let alone = (0..3).all(|k| k == axis || setting[k].abs() <= ASIDE * setting[axis].abs());
    (alone && setting[axis] != 0.0).then_some(axis)
}

/// Every positive setting on one axis alone with the first negative one of the same size that is not taken.
fn pairs_of(run: &Run) -> Vec<Pair> {
    let on_axis: Vec<(usize, f64, f64)> =
        run.scalar.iter().filter_map(|row| axis_of(row.setting).map(|axis| (axis, row.setting[axis], row.modulus_nt))).collect();
    let mut taken = vec![false; on_axis.len()];
    let mut pairs = Vec::new();
    for (axis, plus, plus_nt) in on_axis.iter().filter(|(_, setting, _)| *setting > 0.0) {
        let opposite = on_axis
            .iter()
            .enumerate()
            .position(|(i, (a, minus, _))| !taken[i] && a == axis && *minus < 0.0 && (plus + minus).abs() <= SAME * plus);
        if let Some(i) = opposite {
            taken[i] = true;
            let (_, minus, minus_nt) = on_axis[i];
            pairs.push(Pair {
                state: run.header.run.clone(),
                axis: *axis,
                plus_nt: *plus_nt,
                minus_nt,
                setting_difference: plus + minus,
                std_nt: None,
            });
        }
    }
    pairs
}

fn of_pairs(pairs: &[Pair], used: Vec<String>) -> Result<Residual, CoilError> {
    if pairs.is_empty() {
        return Err(CoilError::NoPairs);
    }
    let resolution_nt = resolution(pairs);
    let mut names: Vec<&str> = Vec::new();
    for pair in pairs {
        if !names.contains(&pair.state.as_str()) {
            names.push(&pair.state);
        }
    }
    let state: Vec<ResidualState> = names
        .iter()
        .map(|name| {
            let of = |axis: usize| pairs.iter().filter(|p| p.state == *name && p.axis == axis).collect::<Vec<_>>();
            ResidualState {
                name: (*name).to_owned(),
                axis: (0..3).filter_map(|axis| one(axis, &of(axis), resolution_nt)).collect(),
            }
        })
        .collect();
    let mut notes = Vec::new();
    let mut facility = FacilityParameters::constant([1.0; 3], [0.0; 3], [90.0; 3]);
    let mut std = FacilityParameters::constant([f64::NAN; 3], [f64::NAN; 3], [f64::NAN; 3]);
    if let Some(last) = state.last() {
        for (k, name) in AXES.into_iter().enumerate() {
            match last.axis.iter().find(|a| a.axis == name) {
                Some(found) => {
                    facility.offset_nt[k] = found.residual_nt;
                    std.offset_nt[k] = found.std_nt;
                }
                None => {
                    let text = format!(
                        "the {name} axis has no pair of moduli in the last state ({}): its offset field is taken as zero",
                        last.name
                    );
                    notes.push(Note::new(NoteKind::Method, text).about(name));
                }
            }
        }
    }
    Ok(Residual { found: ResidualFound { used, facility, std, state }, notes })
}

/// The residual field along one axis in one state.
fn one(axis: usize, pairs: &[&Pair], resolution_nt: f64) -> Option<AxisResidual> {
    if pairs.is_empty() {
        return None;
    }
    let n = pairs.len() as f64;
    let mean = |get: &dyn Fn(&Pair) -> f64| pairs.iter().map(|p| get(p)).sum::<f64>() / n;
    let value = |p: &Pair| 0.5 * (p.plus_nt - p.minus_nt - p.setting_difference);
    let residual_nt = mean(&value);
    // Two moduli with the uncertainty of a uniform distribution, or as stated; each counts half.
    let stated = mean(&|p| 0.5 * p.std_nt.unwrap_or(resolution_nt / 12f64.sqrt()).powi(2)) / n;
    let scatter = if n > 1.0 { mean(&|p| (value(p) - residual_nt).powi(2)) / (n - 1.0) } else { 0.0 };
    Some(AxisResidual {
        axis: AXES[axis].to_owned(),
        plus_nt: mean(&|p| p.plus_nt),
        minus_nt: mean(&|p| p.minus_nt),
        residual_nt,
        std_nt: stated.max(scatter).sqrt(),
        pairs: pairs.len(),
    })
}

/// The step of the moduli: the decimals that they all do without.
fn resolution(pairs: &[Pair]) -> f64 {
    let whole = |step: f64| {
        let on_step = |v: f64| (v / step - (v / step).round()).abs() < 1e-6;
        pairs.iter().all(|p| on_step(p.plus_nt) && on_step(p.minus_nt))
    };
    (0..MOST_DECIMALS).map(|d| 10f64.powi(-d)).find(|step| whole(*step)).unwrap_or(10f64.powi(-MOST_DECIMALS))
}
