//! Linearisations to apply: the LINEARISATION files that `calfit lin --linearise` writes.

use super::parameter::{self, LinearisationFile};
use crate::data::error::Finding;
use crate::data::linearisation::SharedLinearisation;
use crate::data::provenance::Role;
use crate::data::units::COMPONENTS;
use crate::model::linearisation::{AxisLinearisation, LEAST_SLOPE, Linearisation};
use nalgebra::Matrix2;
use std::path::Path;

/// Reads a LINEARISATION file.
///
/// # Errors
/// No such file, a covariance of another size, or polynomials without an inverse within their range.
pub fn read(path: &Path) -> Result<Linearisation, Finding> {
    let parameter::ParameterFile { input, body, .. } = parameter::read::<LinearisationFile>(path)?;
    let covariance = covariances(&body, path)?;
    let SharedLinearisation { sensor, mode, polynomials: part, .. } = body.shared;
    Ok(Linearisation { input: input.with_role(Role::Linearisation), sensor, mode, part, covariance })
}

/// The covariances of the two coefficients of every axis, of polynomials that have an inverse.
pub(in crate::files) fn covariances(body: &LinearisationFile, path: &Path) -> Result<[Matrix2<f64>; 3], Finding> {
    let refuse = |rule: String| Finding::error(&path.display().to_string(), rule, "linearise the runs again");
    let SharedLinearisation { polynomials, covariance, .. } = &body.shared;
    let matrix = &covariance.matrix;
    if matrix.len() != 6 || matrix.iter().any(|row| row.len() != 6) {
        return Err(refuse("the covariance of six coefficients has not six rows and columns".to_owned()));
    }
    for (axis, name) in COMPONENTS.into_iter().enumerate() {
        let slope = AxisLinearisation::of(polynomials, axis).least_slope(polynomials.reading_ent[axis]);
        if slope.is_nan() || slope < LEAST_SLOPE {
            return Err(refuse(format!("the polynomial of {name} has a slope of {slope:.2} within its range, not near 1")));
        }
    }
    Ok(std::array::from_fn(|a| Matrix2::from_fn(|r, c| matrix[2 * a + r][2 * a + c])))
}
