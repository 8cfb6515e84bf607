//! What linear calibrations and offset measurements have across temperatures beside their polynomials.

use super::QuantityFit;
use crate::data::across::{CalibratedRun, RunModelErrors, RunResidualFields, RunRotations, RunValues};
use crate::data::note::{Note, NoteKind};
use crate::data::result::Rows;
use crate::data::run::mean_over;
use crate::fit::Limits;
use crate::fit::noise::dense::GroupNoise;
use crate::fit::smooth::Course;
use crate::measure::joint::{JointError, JointFit, JointPlateau, JointRun, QUANTITIES, Trend, joint};
use crate::measure::lin::{Block, Lin};
use crate::model::sensor::compose;
use nalgebra::{Matrix3, Vector3};

/// Rotation of the sensor in every run.
pub(super) fn rotation(points: &[&CalibratedRun]) -> RunRotations {
    let of = |point: &&CalibratedRun| match &point.values {
        RunValues::Lin { rotation_deg, rotation_std_deg, .. } => (*rotation_deg, *rotation_std_deg),
        _ => ([f64::NAN; 3], [f64::NAN; 3]),
    };
    let all: Vec<([f64; 3], [f64; 3])> = points.iter().map(of).collect();
    let angle = |i: usize| all.iter().map(|(angle, _)| angle[i]).collect();
    let std = |i: usize| all.iter().map(|(_, std)| std[i]).collect();
    let initial = points.first().and_then(|p| match &p.values {
        RunValues::Lin { rho, .. } => *rho,
        _ => None,
    });
    RunRotations {
        lambda_x_deg: angle(0),
        mu_y_deg: angle(1),
        nu_z_deg: angle(2),
        lambda_x_std_deg: std(0),
        mu_y_std_deg: std(1),
        nu_z_std_deg: std(2),
        initial,
    }
}

/// Residual field of the coil system in every run.
pub(super) fn residual_field(points: &[&CalibratedRun], notes: &mut Vec<Note>) -> RunResidualFields {
    let of = |point: &&CalibratedRun| match &point.values {
        RunValues::Offset { residual_ent, residual_std, seen_along, .. } => (*residual_ent, *residual_std, seen_along.clone()),
        _ => ([f64::NAN; 3], [f64::NAN; 3], Vec::new()),
    };
    let all: Vec<([f64; 3], [f64; 3], Vec<String>)> = points.iter().map(of).collect();
    let seen_along = all.first().map_or_else(Vec::new, |(.., axes)| axes.clone());
    let other: Vec<&str> =
        points.iter().zip(&all).filter(|(_, (.., axes))| *axes != seen_along).map(|(p, _)| p.run.id.as_str()).collect();
    if !other.is_empty() {
        let text = format!(
            "the residual field of {} was seen along other coil axes than in the first run: its components do not compare",
            other.join(", ")
        );
        notes.push(Note::new(NoteKind::Facility, text));
    }
    let value = |i: usize| all.iter().map(|(v, ..)| v[i]).collect();
    let std = |i: usize| all.iter().map(|(_, s, _)| s[i]).collect();
    RunResidualFields {
        x_ent: value(0),
        y_ent: value(1),
        z_ent: value(2),
        x_std_ent: std(0),
        y_std_ent: std(1),
        z_std_ent: std(2),
        seen_along,
    }
}

/// Applied field minus modelled measurement with the polynomials in place of the run's own sensitivities and angles; `None` unless all
/// runs are at hand with their plateaus.
pub(super) fn model_error(points: &[&CalibratedRun], runs: &[&Lin], fits: &[QuantityFit]) -> Option<RunModelErrors> {
    let mut error = RunModelErrors::default();
    for point in points {
        let p = *runs.iter().find(|lin| lin.calibration.run.id == point.run.id)?;
        let t = point.run.temperature_degc?;
        let at = |name: &str| fits.iter().find(|f| f.found.name == name).map(|f| f.polynomial.evaluate(t).0);
        let three = |names: [&str; 3]| -> Option<[f64; 3]> { Some([at(names[0])?, at(names[1])?, at(names[2])?]) };
        let sigma = three(["sigma_x", "sigma_y", "sigma_z"])?;
        let xi_deg = three(["xi_xy", "xi_xz", "xi_yz"])?;
        let modelled = compose(&matrix(&p.calibration.matrix.r_nom), &matrix(&p.calibration.matrix.rho), xi_deg, sigma).ok()?;
        // The run's own model leaves its residual; the two models differ in the matrix only.
        let own = matrix(&p.calibration.matrix.phi);
        let change = (modelled - own) * own.try_inverse()?;
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for block in p.blocks.iter().filter(|b| b.plateau.dropped.is_none()) {
            let residual = Vector3::from(block.residual_coil_nt?.0);
            let modelled_nt = Vector3::from(block.plateau.setting.field.0) - residual;
            let left = residual - change * modelled_nt;
            for axis in 0..3 {
                min[axis] = min[axis].min(left[axis]);
                max[axis] = max[axis].max(left[axis]);
            }
        }
        error.min_nt.push(min);
        error.max_nt.push(max);
    }
    Some(error)
}

/// What the runs show of their noise together.
pub(super) fn common_noise(points: &[&CalibratedRun], runs: &[&Lin]) -> Option<GroupNoise> {
    let tried = |point: &&CalibratedRun| {
        let own = runs.iter().find(|lin| lin.calibration.run.id == point.run.id)?;
        own.noise_tried.as_deref()
    };
    GroupNoise::shown_by(&points.iter().map(tried).collect::<Option<Vec<_>>>()?)
}

/// The joint fit of the runs of a group, started at the two-step result.
pub(super) fn joint_fit(points: &[&CalibratedRun], runs: &[&Lin], fits: &[QuantityFit]) -> Result<JointFit, JointError> {
    let own = |point: &CalibratedRun| runs.iter().find(|lin| lin.calibration.run.id == point.run.id);
    let missing: Vec<&str> = points.iter().filter(|p| own(p).is_none()).map(|p| p.file.as_str()).collect();
    if !missing.is_empty() {
        return Err(JointError::NotAtHand { files: missing.into_iter().map(str::to_owned).collect() });
    }
    let runs: Vec<JointRun> = points.iter().filter_map(|p| own(p)).map(|lin| joint_run(lin)).collect();
    let start: [Vec<f64>; 6] = std::array::from_fn(|i| {
        fits.iter().find(|f| f.found.name == QUANTITIES[i]).map_or_else(Vec::new, |f| f.polynomial.coefficients.clone())
    });
    let choice = std::array::from_fn(|i| fits.iter().find(|f| f.found.name == QUANTITIES[i]).map_or(1.0, |f| f.choice));
    Ok(joint(&runs, &start, &Limits::default())?.widened(&choice))
}

/// Plateaus that a robust fit of their run gives less weight do not belong to the joint fit, which has no weights of its own.
const JOINT_WEIGHT: f64 = 0.5;

/// A linear calibration as a run of the joint fit.
fn joint_run(lin: &Lin) -> JointRun {
    let mean_degc = lin.calibration.run.temperature_degc.unwrap_or(f64::NAN);
    // The same course that a calibration takes: the noise of a thermometer is none of the sensor.
    let course = Course::smooth(&lin.temperatures.sensor).series;
    let plateau = |block: &Block| JointPlateau {
        field_coil_nt: block.plateau.setting.field.0,
        reading_ent: block.reading_ent(),
        temperature_degc: match course.as_slice() {
            [] => mean_degc,
            series => mean_over(series, block.plateau.used_s),
        },
        t_s: block.plateau.t_s(),
    };
    JointRun {
        run: lin.calibration.run.id.clone(),
        r_nom: matrix(&lin.calibration.matrix.r_nom),
        rho: matrix(&lin.calibration.matrix.rho),
        plateaus: lin.blocks.iter().filter(|b| b.plateau.dropped.is_none() && b.weight >= JOINT_WEIGHT).map(plateau).collect(),
        trend: Trend::Time(lin.calibration.offset.trend_order),
        rotation_order: 0,
        noise_ent: lin.calibration.noise.std_ent,
    }
}

fn matrix(rows: &Rows) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c])
}
