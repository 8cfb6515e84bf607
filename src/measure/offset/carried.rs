//! What errors of fields or readings do to offset and residual field: the visits are solved again with what is wrong, each by one standard
//! uncertainty of something that is independent of the others.

use super::levels::Levels;
use super::refusal::OffsetError;
use super::solved::Solved;
use super::stay::{pooled, stays};
use crate::data::offset::{OffsetStd, OffsetValues};
use crate::data::plateau::Plateaus;
use crate::model::campaign::Instructions;

/// Changes below this part of the largest value are rounding.
const ROUNDING: f64 = 1e-9;

/// Variances by what was moved.
pub(super) struct Carried {
    /// Covariance of the parameters.
    pub matrix: Vec<Vec<f64>>,
    /// Variances of offset, residual field in sensor axes, and in coil axes.
    squares: [[f64; 3]; 3],
}

impl Carried {
    /// Of plateaus that were moved by one thing after the other.
    ///
    /// # Errors
    /// Moved plateaus that cannot be solved.
    pub fn of(
        moved: impl Iterator<Item = Plateaus>,
        instructions: &Instructions,
        levels: &Levels,
        solved: &Solved,
    ) -> Result<Self, OffsetError> {
        let largest = solved.parameters.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let change = |moved: f64, value: f64| if (moved - value).abs() > ROUNDING * largest { moved - value } else { 0.0 };
        let mut matrix = vec![vec![0.0; solved.parameters.len()]; solved.parameters.len()];
        let mut squares = [[0.0; 3]; 3];
        for plateaus in moved {
            let visits = pooled(stays(&plateaus, instructions)?);
            let again = solved.again(&visits, &levels.with_fields_of(&visits)?)?;
            let changes: Vec<f64> = again.parameters.iter().zip(&solved.parameters).map(|(m, v)| change(*m, *v)).collect();
            for (row, own) in matrix.iter_mut().zip(&changes) {
                row.iter_mut().zip(&changes).for_each(|(sum, other)| *sum += own * other);
            }
            let values = three(&again.values).into_iter().zip(three(&solved.values));
            for (sums, (m, v)) in squares.iter_mut().zip(values) {
                (0..3).for_each(|i| sums[i] += change(m[i], v[i]).powi(2));
            }
        }
        Ok(Self { matrix, squares })
    }

    /// Standard uncertainties; what is not determined has none.
    pub fn std(&self, values: &OffsetValues) -> OffsetStd {
        let std = |which: usize| {
            let values = three(values)[which];
            std::array::from_fn(|i| if values[i].is_nan() { f64::NAN } else { self.squares[which][i].sqrt() })
        };
        OffsetStd { offset_ent: std(0), residual_ent: std(1), residual_coil_nt: std(2) }
    }
}

fn three(values: &OffsetValues) -> [[f64; 3]; 3] {
    [values.offset_ent, values.residual_ent, values.residual_coil_nt]
}
