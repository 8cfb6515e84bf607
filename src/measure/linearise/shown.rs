//! What the figures of a linearisation show: residuals of the runs without and with it, along the real sensor axes.

use crate::data::plateau::Plateau;
use crate::measure::lin::Lin;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// A field whose component along an axis is this part of its magnitude lies along it.
const ALONG: f64 = 0.99;
/// A field below this part of the run's largest is none, and shown in every panel.
const NO_FIELD: f64 = 0.01;
/// A programme whose fields lie along coil axes in at least this part of its settings is shown axis by axis.
const MOSTLY: f64 = 0.9;
/// Bins of a panel.
const BINS: usize = 12;

/// Residuals of one sensor axis against the field along one coil axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PanelData {
    /// Field, nT, and residual with the linearisation, nT.
    pub points: Vec<[f64; 2]>,
    /// Means over bins of the field with the linearisation.
    pub after: Vec<BinMean>,
    /// The same without it.
    pub before: Vec<BinMean>,
}

/// Mean residual over a bin of the field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BinMean {
    /// Mean field, nT.
    pub field_nt: f64,
    /// Mean residual, nT.
    pub residual_nt: f64,
    /// Its standard error from the scatter in the bin, nT; absent for a single residual.
    pub std_nt: Option<f64>,
    /// Residuals in the bin.
    pub count: usize,
}

/// Residual of every used plateau, applied field minus modelled measurement, along the real sensor axes, nT.
fn along_sensor_nt(lin: &Lin) -> Vec<(&Plateau, [f64; 3])> {
    let phi = Matrix3::from_fn(|r, c| lin.calibration.matrix.phi[r][c]);
    let response = phi.try_inverse().unwrap_or_else(Matrix3::zeros);
    let axes: [Vector3<f64>; 3] = std::array::from_fn(|a| response.row(a).transpose().normalize());
    let used = lin.blocks.iter().filter(|b| b.plateau.dropped.is_none());
    used.filter_map(|b| {
        let residual = Vector3::from(b.residual_coil_nt?.0);
        Some((&b.plateau, axes.map(|axis| axis.dot(&residual))))
    })
    .collect()
}

/// Standard deviation of the residuals along the sensor axes, nT.
pub(super) fn residual_std_nt(lin: &Lin) -> [f64; 3] {
    let residuals = along_sensor_nt(lin);
    let n = residuals.len() as f64;
    std::array::from_fn(|a| {
        let mean = residuals.iter().map(|(_, r)| r[a]).sum::<f64>() / n;
        (residuals.iter().map(|(_, r)| (r[a] - mean).powi(2)).sum::<f64>() / n).sqrt()
    })
}

/// Whether a setting is shown against the field along a coil axis: those along it where the programme goes axis by axis, otherwise all.
fn shown(plateaus: &[(&Plateau, [f64; 3])], coil: usize) -> Vec<bool> {
    let norm = |p: &Plateau| Vector3::from(p.setting.field.0).norm();
    let largest = plateaus.iter().map(|(p, _)| norm(p)).fold(0.0, f64::max);
    let is_none = |p: &Plateau| norm(p) <= NO_FIELD * largest;
    let is_along = |p: &Plateau, axis: usize| p.setting.field.0[axis].abs() >= ALONG * norm(p);
    let applied: Vec<&Plateau> = plateaus.iter().map(|(p, _)| *p).filter(|p| !is_none(p)).collect();
    let on_axes = applied.iter().filter(|p| (0..3).any(|axis| is_along(p, axis))).count();
    let axis_by_axis = on_axes as f64 >= MOSTLY * applied.len() as f64;
    plateaus.iter().map(|(p, _)| !axis_by_axis || is_none(p) || is_along(p, coil)).collect()
}

/// What a panel shows of runs without and with the linearisation.
pub(super) fn panel_data<'a>(runs: impl Iterator<Item = (&'a Lin, &'a Lin)>, sensor: usize, coil: usize) -> PanelData {
    let (mut before, mut after) = (Vec::new(), Vec::new());
    for (first, second) in runs {
        for (lin, points) in [(first, &mut before), (second, &mut after)] {
            let residuals = along_sensor_nt(lin);
            let shown = shown(&residuals, coil);
            let kept = residuals.iter().zip(shown).filter(|(_, shown)| *shown);
            points.extend(kept.map(|((p, r), _)| [p.setting.field.0[coil], r[sensor]]));
        }
    }
    PanelData { before: bins(&before), after: bins(&after), points: after }
}

/// Means over bins of equal width; the standard errors take the residuals as independent.
fn bins(points: &[[f64; 2]]) -> Vec<BinMean> {
    let low = points.iter().map(|p| p[0]).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|p| p[0]).fold(f64::NEG_INFINITY, f64::max);
    let bin_of = |field: f64| {
        let share = if high > low { (field - low) / (high - low) } else { 0.0 };
        ((share * BINS as f64) as usize).min(BINS - 1)
    };
    let mut members: Vec<Vec<[f64; 2]>> = vec![Vec::new(); BINS];
    points.iter().for_each(|p| members[bin_of(p[0])].push(*p));
    members
        .into_iter()
        .filter(|m| !m.is_empty())
        .map(|m| {
            let n = m.len() as f64;
            let mean = |i: usize| m.iter().map(|p| p[i]).sum::<f64>() / n;
            let squares: f64 = m.iter().map(|p| (p[1] - mean(1)).powi(2)).sum();
            let std_nt = (m.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt());
            BinMean { field_nt: mean(0), residual_nt: mean(1), std_nt, count: m.len() }
        })
        .collect()
}
