//! Reads what the files of a sensor say of the way from a reading to the field, whatever their kind.

use super::export::rpcmag;
use super::parameter::{FieldPart, FileKind};
use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::model::field_calibration::{Frame, MatrixForm};
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
/// What is wrong with the file, or a file of which nothing is applied to readings.
pub fn read_field(path: &Path, frame: Frame, findings: &mut Vec<Finding>) -> Result<(FieldPart, Input), Finding> {
    let shown = path.display().to_string();
    if rpcmag::is_named(path) {
        let (file, digested) = rpcmag::read(path, findings)?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if frame == Frame::Coil {
            return Err(no_coil_axes(&shown));
        }
        return Ok((file.field_part(), digested.input(name)));
    }
    let Some(kind) = FileKind::of_file(path) else {
        return Err(Finding::error(
            &shown,
            "is no parameter file",
            "name CPF, TPF, TOF, OPF, TCF files, or a ground calibration file RPCMAG_GND_CALIB_*.TXT",
        ));
    };
    let (part, input) = kind.field(path, frame)?;
    match part {
        Some(part) if frame == Frame::Coil && part.coefficients.matrix.is_some_and(|m| m != MatrixForm::Whole) => {
            Err(no_coil_axes(&shown))
        }
        Some(part) => Ok((part, input)),
        None => {
            let rule = format!("is a {} file, of which nothing is applied to readings", kind.format);
            Err(Finding::error(&shown, rule, "name a CPF, TPF, TOF, OPF or TCF file"))
        }
    }
}

fn no_coil_axes(file: &str) -> Finding {
    Finding::error(file, "does not say how the sensor stood in the coil system", "use --frame sensor, or name a CPF file")
}
