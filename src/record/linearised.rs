//! The linearisation of a run: its mean readings put through the polynomials, and what the uncertainty of these means for a fit to them.

use crate::data::linearisation::LinearisationApplied;
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::run::Run;
use crate::data::units::COMPONENTS;
use crate::fit::{FitError, Limits, linear};
use crate::model::linearisation::Linearisation;
use nalgebra::DMatrix;

/// Linearises the mean readings of a run. That the mean of a square is not the square of the mean changes every plateau by the same
/// `c2 s² + ...`, which belongs to the offset; scatter and contrasts within the plateaus keep the scale of the raw readings, from which
/// the slope of the polynomial hardly differs.
pub fn apply(
    linearisation: &Linearisation,
    run: &Run,
    list: &mut [Plateau],
    notes: &mut impl Extend<Note>,
) -> LinearisationApplied {
    let header = &run.header;
    if (header.sensor.as_str(), header.mode.as_str()) != (linearisation.sensor.as_str(), linearisation.mode.as_str()) {
        let text = format!(
            "{} was made with {} {}, the run is of {} {}",
            linearisation.input.path, linearisation.sensor, linearisation.mode, header.sensor, header.mode
        );
        notes.extend([Note::new(NoteKind::Data, text).about(&linearisation.input.path)]);
    }
    for (axis, name) in COMPONENTS.into_iter().enumerate() {
        let [low, high] = linearisation.part.reading_ent[axis];
        let beyond = list.iter().filter(|p| p.dropped.is_none() && !(low..=high).contains(&p.mean.0[axis]));
        let (count, farthest) =
            beyond.fold((0, 0.0_f64), |(n, far), p| (n + 1, far.max(low - p.mean.0[axis]).max(p.mean.0[axis] - high)));
        // Runs of one programme end within a small part of each other.
        if farthest > 0.01 * (high - low) {
            let text = format!(
                "{count} mean readings of {name} lie up to {farthest:.0} enT beyond the range of {}, {low:.0} to {high:.0} enT",
                linearisation.input.path
            );
            notes.extend([Note::new(NoteKind::Method, text).about(name)]);
        }
    }
    for plateau in list {
        for axis in 0..3 {
            plateau.mean.0[axis] = linearisation.axis(axis).linearised_ent(plateau.mean.0[axis]);
        }
    }
    LinearisationApplied { file: linearisation.input.path.clone(), applied: linearisation.part.clone() }
}

/// What the uncertainty of the polynomials adds to the covariance of all coefficients of a run, parameter j of component a at
/// `a * p + j`. In the joint estimate it is independent of the noise that acts on the coefficients at known polynomials. The readings
/// may be linearised ones: the difference is of second order.
///
/// # Errors
/// Those of [`linear::solve`].
pub fn carried(linearisation: &Linearisation, design: &linear::Design, used: &[&Plateau]) -> Result<DMatrix<f64>, FitError> {
    let powers = DMatrix::from_fn(used.len(), 6, |i, j| used[i].mean.0[j / 2].powi(j as i32 % 2 + 2));
    let effect = linear::solve(design, &powers, None, &Limits::default())?.coefficients;
    let count = effect.nrows();
    let mut covariance = DMatrix::zeros(3 * count, 3 * count);
    for axis in 0..3 {
        let own = effect.columns(2 * axis, 2);
        let part = own * linearisation.covariance[axis] * own.transpose();
        covariance.view_mut((axis * count, axis * count), (count, count)).copy_from(&part);
    }
    Ok(covariance)
}
