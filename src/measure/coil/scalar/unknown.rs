//! What a coil temperature that moves does where the calibrations tell no coefficients of it, and calibrations on their own where they do.
//!
//! Every setting is at another temperature, and what that changes looks like scale factors and offset fields. No residual of one calibration
//! need show it. Coefficients that are not told are therefore taken as zero with the size of published ones as their standard uncertainty,
//! type B: those of the coil system of CH-GFZ-TR-2601 section 6. They are sized by the expansion of a metal frame, which other coil systems share.

use super::Fitted;
use super::terms::{CONSTANT, Modulus, Observation, Terms};
use crate::data::note::{Note, NoteKind};
use crate::fit::Model;
use crate::fit::statistics::extremes;
use crate::model::coil::{OFFSET_NT_PER_K, SCALE_APART_PER_K, SCALE_PER_K};
use nalgebra::{DMatrix, DVector};

/// What coefficients of the coil temperature that are not known may have done to the parameters of a fit: changes by one standard deviation of
/// each, a column each. `None` where the coefficients are fitted.
pub(super) fn moved(rows: &[Observation], terms: &Terms, fitted: &Fitted) -> Option<DMatrix<f64>> {
    if terms.coil {
        return None;
    }
    let used: Vec<&Observation> = rows.iter().zip(&fitted.used).filter(|(_, used)| **used).map(|(row, _)| row).collect();
    let mean_k: [f64; 3] = std::array::from_fn(|k| used.iter().map(|row| row.coil_k[k]).sum::<f64>() / used.len() as f64);
    // The parameters hold at the mean temperature of the rows.
    let about = |row: &&Observation| Observation { coil_k: std::array::from_fn(|k| row.coil_k[k] - mean_k[k]), ..(*row).clone() };
    let rows: Vec<Observation> = used.iter().map(about).collect();
    let with = Terms { coil: true, rack: false, steps: Vec::new(), held: Vec::new() };
    let mut own = DMatrix::zeros(rows.len(), terms.count());
    Modulus { rows: &rows, terms }.jacobian(&fitted.solution.parameters, &mut own);
    // The coefficients act alike before and after a step to first order: the first state serves.
    let mut start = fitted.solution.parameters[..CONSTANT].to_vec();
    start.resize(with.count(), 0.0);
    let mut all = DMatrix::zeros(rows.len(), with.count());
    Modulus { rows: &rows, terms: &with }.jacobian(&start, &mut all);
    let column = |place: usize, size: f64| -> DVector<f64> { all.column(CONSTANT + place) * size };
    let alike = (0..3).fold(DVector::zeros(rows.len()), |sum, k| sum + column(k, SCALE_PER_K));
    let apart = (0..3).map(|k| column(k, SCALE_APART_PER_K));
    let offsets = (3..6).map(|k| column(k, OFFSET_NT_PER_K));
    let moduli: Vec<DVector<f64>> = [alike].into_iter().chain(apart).chain(offsets).collect();
    let influence = &fitted.solution.unscaled_covariance * own.transpose();
    Some(influence * DMatrix::from_columns(&moduli))
}

/// Says of such a movement, where what it may have done is more than what a parameter is uncertain by without it.
pub(super) fn note(rows: &[Observation], covariance: &DMatrix<f64>, moved: &DMatrix<f64>) -> Option<Note> {
    let share = |j: &usize| (moved.row(*j).norm_squared() / covariance[(*j, *j)]).sqrt();
    let worst = (0..CONSTANT).max_by(|a, b| share(a).total_cmp(&share(b))).filter(|j| share(j) > 1.0)?;
    let range = |k: usize| {
        let [low, high] = extremes(rows.iter().map(|row| row.coil_k[k]));
        high - low
    };
    let moved_k = (0..3).map(range).fold(0.0, f64::max);
    let unit = ["nT/EU", "nT", "degrees"][worst / 3];
    let text = format!(
        "the coil temperature moved by {moved_k:.2} K during the settings, and the calibrations tell no coefficients of it: taken as zero with the size of \
         those of CH-GFZ-TR-2601 section 6 as their uncertainty ({SCALE_PER_K:.1e} per kelvin of the scale factors, {OFFSET_NT_PER_K:.1} nT/K of the offset \
         fields), they add {:.1e} {unit} to the uncertainty of {}, which is {:.1e} without",
        moved.row(worst).norm(),
        Terms::name(worst),
        covariance[(worst, worst)].sqrt(),
    );
    Some(
        Note::new(NoteKind::Temperature, text)
            .with_remedy("keep the coils at one temperature, or calibrate three times at temperatures that differ"),
    )
}

/// The rows of each calibration as if its coils and the rack had been at their mean temperatures of its rows all the time, by the coefficients that all
/// calibrations tell, with no temperatures of their own any more.
pub(super) fn at_their_means(rows: &[Observation], terms: &Terms, parameters: &[f64]) -> Vec<Observation> {
    let values = |rows: &[Observation]| {
        let mut values = vec![0.0; rows.len()];
        Modulus { rows, terms }.values(parameters, &mut values);
        values
    };
    let mean = |run: usize| {
        let own = || rows.iter().filter(move |row| row.run == run);
        let count = own().count() as f64;
        let coil_k: [f64; 3] = std::array::from_fn(|k| own().map(|row| row.coil_k[k]).sum::<f64>() / count);
        (coil_k, own().map(|row| row.rack_k).sum::<f64>() / count)
    };
    let runs = rows.iter().map(|row| row.run + 1).max().unwrap_or_default();
    let means: Vec<([f64; 3], f64)> = (0..runs).map(mean).collect();
    let at_mean = |row: &Observation| Observation { coil_k: means[row.run].0, rack_k: means[row.run].1, ..row.clone() };
    let level: Vec<Observation> = rows.iter().map(at_mean).collect();
    let (there, level) = (values(rows), values(&level));
    let one = |((row, there), level): ((&Observation, f64), f64)| {
        let mut own = Observation { coil_k: [0.0; 3], rack_k: 0.0, ..row.clone() };
        own.scalar.modulus_nt += level - there;
        own
    };
    rows.iter().zip(there).zip(level).map(one).collect()
}
