//! What an error of the facility does to offset and residual field.
//!
//! Fields that are `(1 + E)` times what the file says, with one small matrix E for all positions, give every position the response
//! `A (1 + E)` in place of A. What the positions show of the residual field stays, `A B_res`, so that the offsets and the residual field as
//! the sensor reads it have no part of E; the residual field in coil axes becomes `(1 + E)⁻¹ B_res`. An offset field of the coils is part of
//! the residual field that is measured. What does not cancel is an error that differs between the positions, as in a run across
//! two periods of the facility or with coils whose temperature changes. The visits are therefore solved again with every field moved.

use super::levels::Levels;
use super::refusal::OffsetError;
use super::solved::Solved;
use super::stay::{pooled, stays};
use crate::data::offset::{OffsetStd, OffsetTypeB, OffsetValues};
use crate::data::plateau::Plateaus;
use crate::data::result::Covariance;
use crate::data::units::FieldCoil;
use crate::model::campaign::Instructions;
use crate::record::facility::{self, Driven};

/// Changes below this part of the largest value are rounding.
const ROUNDING: f64 = 1e-9;

/// In words, for the file.
const COVERS: &str = "scale factors and angles of the coils, as the facility file states them; an error that is the same in all positions \
                      cancels in offset_ent and residual_ent and stays in residual_coil_nt; an offset field of the coils is part of the \
                      residual field; a turn that is not exact is in the response that is measured in every position";

/// Type B uncertainties by what moves with every move of the facility; says in `solved` what they cover.
pub(super) fn of_facility(
    driven: &Driven,
    plateaus: &Plateaus,
    instructions: &Instructions,
    levels: &Levels,
    solved: &mut Solved,
) -> Result<OffsetTypeB, OffsetError> {
    let largest = solved.parameters.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let change = |moved: f64, value: f64| if (moved - value).abs() > ROUNDING * largest { moved - value } else { 0.0 };
    let mut matrix = vec![vec![0.0; solved.parameters.len()]; solved.parameters.len()];
    let mut squares = [[0.0; 3]; 3];
    for facility::Moved { nt: moved_nt, .. } in &driven.moved {
        let mut moved = plateaus.clone();
        for (plateau, by_nt) in moved.list.iter_mut().zip(moved_nt) {
            plateau.setting.field = FieldCoil(std::array::from_fn(|axis| plateau.setting.field.0[axis] + by_nt[axis]));
        }
        let visits = pooled(stays(&moved, instructions)?);
        let again = solved.again(&visits, &levels.with_fields_of(&visits)?)?;
        let changes: Vec<f64> = again.parameters.iter().zip(&solved.parameters).map(|(m, v)| change(*m, *v)).collect();
        for (row, own) in matrix.iter_mut().zip(&changes) {
            row.iter_mut().zip(&changes).for_each(|(sum, other)| *sum += own * other);
        }
        for (sums, [m, v]) in
            squares.iter_mut().zip(three(&again.values).into_iter().zip(three(&solved.values)).map(<[_; 2]>::from))
        {
            (0..3).for_each(|i| sums[i] += change(m[i], v[i]).powi(2));
        }
    }
    // What is not determined has no uncertainty.
    let std = |which: usize| {
        let values = three(&solved.values)[which];
        std::array::from_fn(|i| if values[i].is_nan() { f64::NAN } else { f64::sqrt(squares[which][i]) })
    };
    let std_b = OffsetStd { offset_ent: std(0), residual_ent: std(1), residual_coil_nt: std(2) };
    let covariance_b = Covariance { matrix, ..solved.covariance.clone() };
    solved.method.std_b_covers = Some(COVERS.to_owned());
    Ok(OffsetTypeB::with(std_b, covariance_b, &solved.values, &solved.covariance))
}

fn three(values: &OffsetValues) -> [[f64; 3]; 3] {
    [values.offset_ent, values.residual_ent, values.residual_coil_nt]
}
