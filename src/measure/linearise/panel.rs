//! The check for transverse effects: square and cube of the field along every coil axis in the residuals of a sensor axis.

use super::data::Data;
use super::refusal::MOST_CONDITION;
use super::told::{probability, tell};
use crate::data::linearisation::{LinearisationPanel, PanelFit};
use crate::data::units::COMPONENTS;
use crate::fit::Limits;
use crate::fit::partitioned::{self, Part, Projected};
use crate::measure::lin::Lin;
use nalgebra::{DMatrix, DVector, Vector2};

/// Names of the coil axes.
const COIL: [&str; 3] = ["X", "Y", "Z"];

/// Coil axis along which a sensor axis nominally lies.
fn nominal_axis(lin: &Lin, sensor: usize) -> usize {
    let r_nom = &lin.calibration.matrix.r_nom;
    (0..3).find(|coil| r_nom[*coil][sensor] != 0.0).unwrap_or(sensor)
}

/// Square and cube of the field along a coil axis in the residual of a sensor axis. Along the axis itself they are what the
/// linearisation takes away; across it they are fitted beside the linearisation, which they would otherwise imitate: where the fields
/// have one magnitude, the square along an axis is a constant less the squares across it.
pub(super) fn panel(
    data: &[Data],
    axis: usize,
    coil: usize,
    readings: &[DVector<f64>],
    projected: &[Projected],
    from_samples: bool,
) -> LinearisationPanel {
    let on_axis = data.iter().all(|d| nominal_axis(d.lin, axis) == coil);
    let scale_nt = data.iter().flat_map(|d| d.fields(coil)).fold(0.0, |a: f64, b| a.max(b.abs()));
    let fitted = || {
        // What the fit has before square and cube of the field: nothing, or square and cube of the reading.
        let before = if on_axis { 0 } else { 2 };
        let (kept, parts): (Vec<Data>, Vec<Projected>) = data
            .iter()
            .zip(readings)
            .zip(projected)
            .filter_map(|((d, readings), projected)| {
                let part = &projected.part;
                let fields: Vec<f64> = d.fields(coil).map(|b| b / scale_nt).collect();
                let shared = DMatrix::from_fn(fields.len(), before + 2, |i, j| {
                    if j < before { part.shared[(i, j)] } else { fields[i].powi((j - before) as i32 + 2) }
                });
                let (own, rhs) = if on_axis { (&d.own, readings) } else { (&part.own, &part.rhs) };
                // A run too short for more columns says nothing here.
                let one = Projected::of(Part { own: own.clone(), shared, rhs: rhs.clone(), weight: part.weight }).ok()?;
                Some((Data { own: own.clone(), ..d.clone() }, one))
            })
            .unzip();
        fit(&kept, &parts, axis, before, scale_nt, from_samples)
    };
    LinearisationPanel {
        sensor_axis: COMPONENTS[axis].to_owned(),
        coil_axis: COIL[coil].to_owned(),
        on_axis,
        largest_field_nt: scale_nt,
        fitted: if scale_nt > 0.0 { fitted() } else { None },
    }
}

/// Square and cube of the field, the last two shared columns, in the residual of a sensor axis; `None` where the runs do not determine
/// them.
fn fit(data: &[Data], parts: &[Projected], axis: usize, before: usize, scale_nt: f64, from_samples: bool) -> Option<PanelFit> {
    let names: Vec<String> = (0..before + 2).map(|j| format!("column {j}")).collect();
    let solved = partitioned::solve(parts, &names, &Limits { max_condition: MOST_CONDITION }).ok()?;
    let told = tell(data, axis, parts, &solved).ok()?;
    // A reading that is too large makes applied minus modelled field too small.
    let sigma = data.iter().map(|d| d.lin.calibration.matrix.sigma[axis][axis]).sum::<f64>() / data.len() as f64;
    let values = Vector2::new(solved.values[before], solved.values[before + 1]);
    let covariance = told.covariance.view((before, before), (2, 2)).fixed_view::<2, 2>(0, 0).into_owned();
    let std = |i: usize| sigma * covariance[(i, i)].sqrt();
    // Of the runs that count here, with the columns that are fitted here.
    let own: usize = parts.iter().map(|p| p.part.own.nrows() - p.part.own.ncols()).sum();
    let freedom = own.saturating_sub(before + 2);
    Some(PanelFit {
        quadratic_per_nt: -sigma * values[0] / scale_nt.powi(2),
        quadratic_std_per_nt: std(0) / scale_nt.powi(2),
        cubic_per_nt2: -sigma * values[1] / scale_nt.powi(3),
        cubic_std_per_nt2: std(1) / scale_nt.powi(3),
        probability: probability(&values, &covariance, (!from_samples).then_some(freedom)),
    })
}
