//! Reads what the files of a sensor say of the way from a reading to the field, whatever their kind.

use super::export::rpcmag;
use super::parameter::{FieldPart, FileKind};
use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::data::reference::is_rotation;
use crate::model::field_calibration::{Frame, MatrixForm, Turn};
use nalgebra::Matrix3;
use std::path::Path;

/// Whether a file is a parameter file or a ground calibration file, by its name or its key `format`.
#[must_use]
pub fn is_parameter_file(path: &Path) -> bool {
    rpcmag::is_named(path) || FileKind::of_file(path).is_some()
}

/// Reads what a parameter file or a ground calibration file says of the way from a reading to the field, in a frame; notes on the file go
/// to `findings`.
///
/// # Errors
/// What is wrong with the file, a file of which nothing is applied to readings, a frame that it does not state.
pub fn read_field(path: &Path, frame: Frame, findings: &mut Vec<Finding>) -> Result<(FieldPart, Input), Finding> {
    let shown = path.display().to_string();
    let (part, input) = part(path, frame, findings)?;
    let Some(matrix) = part.coefficients.matrix else { return Ok((part, input)) };
    match frame {
        Frame::Sensor => Ok((part, input)),
        Frame::Coil if matrix == MatrixForm::Whole => Ok((part, input)),
        Frame::Coil => {
            let rule = "does not say how the sensor stood in the coil system";
            Err(Finding::error(&shown, rule, "use --frame sensor, or name a CPF file"))
        }
        Frame::Reference => Ok((in_reference_cube(part, &shown)?, input)),
    }
}

fn part(path: &Path, frame: Frame, findings: &mut Vec<Finding>) -> Result<(FieldPart, Input), Finding> {
    let shown = path.display().to_string();
    if rpcmag::is_named(path) {
        let (file, digested) = rpcmag::read_alone(path, findings)?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let notes = file.told.with_values_of(&name);
        return Ok((FieldPart { notes, ..file.field_part() }, digested.input(name)));
    }
    let Some(kind) = FileKind::of_file(path) else {
        let remedy = "name CPF, TPF, TOF, OPF, TCF files, or a ground calibration file RPCMAG_GND_CALIB_*.TXT";
        return Err(Finding::error(&shown, "is no parameter file", remedy));
    };
    let (part, input) = kind.field(path, frame)?;
    part.map(|part| (part, input)).ok_or_else(|| {
        let rule = format!("is a {} file, of which nothing is applied to readings", kind.format);
        Finding::error(&shown, rule, "name a CPF, TPF, TOF, OPF or TCF file")
    })
}

/// The same with the rotation to the reference cube behind it.
fn in_reference_cube(mut part: FieldPart, file: &str) -> Result<FieldPart, Finding> {
    let Some(reference) = &part.reference else {
        let rule = "does not say how the sensor stands in its reference cube";
        return Err(Finding::error(file, rule, "state it in campaign.toml as [[reference]] and make the file again"));
    };
    let refuse = |rule: &str| Finding::error(file, rule, "correct the file, or make it again");
    if !is_rotation(&reference.rotation) {
        return Err(refuse("reference.rotation is no rotation"));
    }
    if reference.from != part.frame {
        return Err(refuse("reference.from is not the frame of the file"));
    }
    if reference.std_deg.is_nan() || reference.std_deg < 0.0 {
        return Err(refuse("reference.std_deg is no uncertainty"));
    }
    // A matrix of one temperature has one rotation; where its angles move, the frame for which another convention states it moves with them.
    let stated = reference.stated_rotation.filter(|_| matches!(part.coefficients.matrix, Some(MatrixForm::Alignment(_))));
    if stated.as_ref().is_some_and(|rows| !is_rotation(rows)) {
        return Err(refuse("reference.stated_rotation is no rotation"));
    }
    let rows = stated.unwrap_or(reference.rotation);
    part.coefficients.turn = Some(Turn {
        rotation: Matrix3::from_fn(|row, column| rows[row][column]),
        from_other: stated.map(|_| reference.stated_for),
        std_rad: reference.std_deg.to_radians(),
    });
    part.frame = "reference cube of the sensor".to_owned();
    Ok(part)
}
