//! Linearisations to apply: the LINEARISATION files that `calfit lin --linearise` writes.

use super::parameter::{self, LinearisationFile};
use crate::data::error::Finding;
use crate::data::linearisation::SharedLinearisation;
use crate::data::units::COMPONENTS;
use crate::model::linearisation::{LEAST_SLOPE, Linearisation};
use nalgebra::Matrix2;
use std::path::Path;

/// Reads a LINEARISATION file.
///
/// # Errors
/// No such file, a covariance of another size, or polynomials without an inverse within their range.
pub fn read(path: &Path) -> Result<Linearisation, Finding> {
    let parameter::ParameterFile { input, body, .. } = parameter::read::<LinearisationFile>(path)?;
    let refuse = |rule: String| Finding::error(&path.display().to_string(), rule, "linearise the runs again");
    let SharedLinearisation { sensor, mode, polynomials: part, covariance, .. } = body.shared;
    let matrix = &covariance.matrix;
    if matrix.len() != 6 || matrix.iter().any(|row| row.len() != 6) {
        return Err(refuse("the covariance of six coefficients has not six rows and columns".to_owned()));
    }
    let covariance = std::array::from_fn(|a| Matrix2::from_fn(|r, c| matrix[2 * a + r][2 * a + c]));
    let linearisation = Linearisation { input, sensor, mode, part, covariance };
    for (axis, name) in COMPONENTS.into_iter().enumerate() {
        let slope = linearisation.axis(axis).least_slope(linearisation.part.reading_ent[axis]);
        if slope.is_nan() || slope < LEAST_SLOPE {
            return Err(refuse(format!("the polynomial of {name} has a slope of {slope:.2} within its range, not near 1")));
        }
    }
    Ok(linearisation)
}
