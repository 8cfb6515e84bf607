//! Facility files, TOML: `scale_nt_per_eu`, `offset_nt`, `angles_deg`, and optionally what temperatures do to them, in a table
//! `facility` or `model` or among the keys of the file. The files that `calfit coil` writes are among them.

use super::parameter;
use super::source::read_whole;
use super::text::{Keys, decode};
use crate::data::error::Finding;
use crate::data::provenance::Role;
use crate::model::facility::{Facility, FacilityParameters};
use std::path::Path;

/// Reads a facility file.
///
/// # Errors
/// Not TOML, a missing key, values that no coil system has, or a file of this program that was changed.
pub fn read(path: &Path) -> Result<Facility, Finding> {
    let (bytes, digested) = read_whole(path)?;
    let shown = path.display().to_string();
    let text = decode(&bytes).into_owned();
    if text.lines().any(|l| l.starts_with("content_sha256 = ")) {
        // A file of this program carries its hash.
        parameter::read_any(path)?;
    }
    let keys = Keys::parse(&shown, 1, text)?;
    let part = part(&keys)?;
    if part.coil().axes().is_none() {
        return Err(Finding::error(
            &shown,
            "no three axes have the angles angles_deg between them",
            "correct the angles XY, XZ, YZ",
        ));
    }
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Facility { input: digested.input(name).with_role(Role::Facility), part })
}

fn part(keys: &Keys) -> Result<FacilityParameters, Finding> {
    let root = keys.root();
    let table = match root.group("facility")? {
        Some(group) => group,
        None => root.group("model")?.unwrap_or(root),
    };
    let needed = |key: &str| table.three(key)?.ok_or_else(|| table.missing(key));
    let either = |one: &str, other: &str| -> Result<Option<f64>, Finding> { Ok(table.number(one)?.or(table.number(other)?)) };
    let part = FacilityParameters {
        scale_nt_per_eu: needed("scale_nt_per_eu")?,
        offset_nt: needed("offset_nt")?,
        angles_deg: needed("angles_deg")?,
        scale_per_k: table.three("scale_per_k")?,
        offset_nt_per_k: table.three("offset_nt_per_k")?,
        reference_degc: either("reference_degc", "reference_temperature_degc")?,
        rack_scale_per_k: table.three("rack_scale_per_k")?,
        rack_offset_nt_per_k: table.three("rack_offset_nt_per_k")?,
        rack_reference_degc: either("rack_reference_degc", "rack_reference_temperature_degc")?,
    };
    if part.scale_nt_per_eu.iter().any(|s| *s <= 0.0) {
        return Err(table.refuse("scale_nt_per_eu", "must be positive", "write the nT of one unit of the setting per axis"));
    }
    if (part.scale_per_k.is_some() || part.offset_nt_per_k.is_some()) && part.reference_degc.is_none() {
        return Err(table.missing("reference_degc"));
    }
    if (part.rack_scale_per_k.is_some() || part.rack_offset_nt_per_k.is_some()) && part.rack_reference_degc.is_none() {
        return Err(table.missing("rack_reference_degc"));
    }
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<FacilityParameters, Finding> {
        part(&Keys::parse("facility.toml", 1, text.to_owned()).unwrap())
    }

    #[test]
    fn keys_are_found_in_a_table_or_without_one() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\nangles_deg = [90.1, 90.0, 89.9]\n";
        let expected = FacilityParameters::constant([0.9, 1.0, 1.1], [1.0, 2.0, 3.0], [90.1, 90.0, 89.9]);
        assert_eq!(parse(plain).unwrap(), expected);
        assert_eq!(parse(&format!("[facility]\n{plain}")).unwrap(), expected);
        let model = parse(&format!(
            "[[scalar_calibration]]\n{plain}[model]\n{plain}scale_per_k = [1e-5, 0, 0]\nreference_temperature_degc = 16.5"
        ));
        assert_eq!(model.unwrap().reference_degc, Some(16.5));
    }

    #[test]
    fn what_is_missing_or_impossible_is_named() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\n";
        for (text, words) in [
            (plain.to_owned(), "angles_deg"),
            (format!("{plain}angles_deg = [90, 90]"), "three numbers"),
            (format!("{plain}angles_deg = [90, 90, 90]\nscale_per_k = [0, 0, 1e-5]"), "reference_degc"),
            ("scale_nt_per_eu = [0, 1, 1]\noffset_nt = [1, 2, 3]\nangles_deg = [90, 90, 90]".to_owned(), "positive"),
        ] {
            let error = parse(&text).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
