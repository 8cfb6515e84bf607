//! What an error of the facility does to offset and residual field.
//!
//! Fields that are `(1 + E)` times what the file says, with one small matrix E for all positions, give every position the response
//! `A (1 + E)` in place of A. What the positions show of the residual field stays, `A B_res`, so that the offsets and the residual field as
//! the sensor reads it have no part of E; the residual field in coil axes becomes `(1 + E)⁻¹ B_res`. An offset field of the coils is part of
//! the residual field that is measured. What does not cancel is an error that differs between the positions, as in a run across
//! two periods of the facility or with coils whose temperature changes. The visits are therefore solved again with every field moved.

use super::carried::Carried;
use super::levels::Levels;
use super::refusal::OffsetError;
use super::solved::Solved;
use crate::data::offset::OffsetTypeB;
use crate::data::plateau::Plateaus;
use crate::data::result::Covariance;
use crate::data::units::FieldCoil;
use crate::model::campaign::Instructions;
use crate::record::facility::{self, Driven};

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
    let moved = driven.moved.iter().map(|facility::Moved { nt: moved_nt, .. }| {
        let mut moved = plateaus.clone();
        for (plateau, by_nt) in moved.list.iter_mut().zip(moved_nt) {
            plateau.setting.field = FieldCoil(std::array::from_fn(|axis| plateau.setting.field.0[axis] + by_nt[axis]));
        }
        moved
    });
    let carried = Carried::of(moved, instructions, levels, solved)?;
    let std_b = carried.std(&solved.values);
    let covariance_b = Covariance { matrix: carried.matrix, ..solved.covariance.clone() };
    solved.method.std_b_covers = Some(COVERS.to_owned());
    Ok(OffsetTypeB::with(std_b, covariance_b, &solved.values, &solved.covariance))
}
