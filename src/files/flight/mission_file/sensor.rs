//! The part of `flight.toml` that is about one sensor.

use super::{MissionFile, apart, at_least_zero, needed, positive};
use crate::data::convention::Convention;
use crate::data::error::Finding;
use crate::files::flight::mission::{Boom, Counts, Jump, OffsetFrame, RangeMatrix, Sensor, Span, overlap};
use crate::files::parameter::is_covariance;
use crate::files::text::Group;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Keys that say how ground files are taken.
const OF_GROUND: [&str; 4] = ["ground_sensor", "frame", "accept_b_or", "residual"];
/// How far a matrix may be from a rotation.
const ROTATION: f64 = 1e-6;
/// A converter has at most so many bits.
const MOST_BITS: u32 = 32;

impl MissionFile<'_> {
    pub(super) fn sensor(&self, group: &Group<'_>) -> Result<Sensor, Finding> {
        group.only(&[
            "name",
            "ground",
            "model",
            "ground_sensor",
            "frame",
            "accept_b_or",
            "residual",
            "daily",
            "daily_to",
            "daily_missing",
            "thermistor_column",
            "adc_bits",
            "full_scale_ent",
            "ent_per_count",
            "noise_ent",
            "rotation",
            "jump",
            "offsets",
            "offsets_frame",
            "matrix",
        ])?;
        let name = needed(group, "name", group.text("name")?)?;
        let matrices = group.groups("matrix")?.iter().map(|g| self.matrix(g)).collect::<Result<Vec<_>, _>>()?;
        let ground = group.texts("ground")?.map(|list| list.iter().map(|path| self.folder.join(path)).collect::<Vec<_>>());
        let ground = if matrices.is_empty() { needed(group, "ground", ground)? } else { ground.unwrap_or_default() };
        if !matrices.is_empty() && !ground.is_empty() {
            let rule = "stands beside `ground`, and a sensor has one calibration";
            return Err(group.refuse("matrix", rule, "state the one or the other"));
        }
        if let Some(key) = OF_GROUND.into_iter().find(|key| ground.is_empty() && group.names().contains(key)) {
            let remedy = "take it out, or name the files of the calibration with `ground`";
            return Err(group.refuse(key, "is of ground files, and changes nothing of matrices", remedy));
        }
        if group.names().contains(&"daily_to") && !group.names().contains(&"daily") {
            return Err(group.refuse("daily_to", "changes nothing without `daily`", "take it out, or name the daily models"));
        }
        let model = self.path(group, "model")?;
        if model.is_some() && ground.is_empty() {
            let remedy = "take it out, or name the files of the calibration with `ground`";
            return Err(group.refuse("model", "goes with the ground calibration that was made with it", remedy));
        }
        let frame = match group.text("frame")?.as_deref() {
            None => None,
            Some("rosetta") => Some(Convention::Rosetta),
            Some("bepicolombo") => Some(Convention::BepiColombo),
            Some(_) => {
                return Err(group.refuse(
                    "frame",
                    "must be \"rosetta\" or \"bepicolombo\"",
                    "leave it out for that of the files",
                ));
            }
        };
        let counts = counts(group)?;
        let rotations = group.groups("rotation")?.iter().map(|g| self.rotation(g)).collect::<Result<Vec<_>, _>>()?;
        let jumps = group.groups("jump")?.iter().map(|g| self.jump(g)).collect::<Result<Vec<_>, _>>()?;
        let table = self.path(group, "offsets")?;
        let offsets = table.map(|table| frame_of(group, "offsets_frame").map(|frame| (table, frame))).transpose()?;
        let spans: Vec<Span> = rotations.iter().map(|r| r.span).collect();
        apart(group, "rotation", &spans)?;
        let spans: Vec<Span> = jumps.iter().map(|j: &Jump| j.span).collect();
        apart(group, "jump", &spans)?;
        if overlap(matrices.iter().map(|m| (m.span, m.range))).is_some() {
            let remedy = "let one matrix hold for every moment and range; one without `range` is for all ranges";
            return Err(group.refuse("matrix", "has intervals that overlap for one range", remedy));
        }
        let word = |key: &str, default: &str, other: &str| -> Result<bool, Finding> {
            match group.text(key)?.as_deref() {
                None => Ok(false),
                Some(word) if word == default => Ok(false),
                Some(word) if word == other => Ok(true),
                Some(_) => Err(group.refuse(key, &format!("must be \"{default}\" or \"{other}\""), "correct the value")),
            }
        };
        Ok(Sensor {
            thermistor_column: group.text("thermistor_column")?.unwrap_or_else(|| format!("t_{}", name.to_lowercase())),
            ground,
            model,
            ground_sensor: group.text("ground_sensor")?,
            frame,
            accept_b_or: group.truth("accept_b_or")?.unwrap_or(false),
            ignore_residual: word("residual", "subtract", "ignore")?,
            daily: group.text("daily")?,
            daily_to: self.time(group, "daily_to")?,
            daily_may_lack: word("daily_missing", "error", "no model")?,
            counts,
            noise_ent: noise(group)?,
            rotations,
            jumps,
            offsets,
            matrices,
            name,
        })
    }

    fn rotation(&self, group: &Group<'_>) -> Result<Boom, Finding> {
        group.only(&["boom", "from", "to", "uvw_to_sc"])?;
        let rows = needed(group, "uvw_to_sc", group.three_rows("uvw_to_sc")?)?;
        let uvw_to_sc = Matrix3::from_fn(|row, column| rows[row][column]);
        let error = (uvw_to_sc * uvw_to_sc.transpose() - Matrix3::identity()).abs().max();
        if error >= ROTATION {
            let rule = format!("is no rotation: R transpose(R) differs from 1 by {error:.1e}");
            return Err(group.refuse("uvw_to_sc", &rule, "write its rows with all their digits"));
        }
        if uvw_to_sc.determinant() < 0.0 {
            return Err(group.refuse("uvw_to_sc", "mirrors: its determinant is -1", "check the signs of its rows"));
        }
        Ok(Boom { boom: group.text("boom")?.unwrap_or_default(), span: self.span(group)?, uvw_to_sc })
    }

    fn jump(&self, group: &Group<'_>) -> Result<Jump, Finding> {
        group.only(&["from", "to", "frame", "subtract_nt"])?;
        let frame = frame_of(group, "frame")?;
        let subtract_nt = needed(group, "subtract_nt", group.three("subtract_nt")?)?;
        Ok(Jump { span: self.span(group)?, range: None, frame, subtract_nt: Vector3::from(subtract_nt) })
    }

    fn matrix(&self, group: &Group<'_>) -> Result<RangeMatrix, Finding> {
        group.only(&["from", "to", "range", "matrix", "offset", "offset_sign", "covariance"])?;
        let rows = needed(group, "matrix", group.three_rows("matrix")?)?;
        let range = match group.whole("range")? {
            None => None,
            Some(range) => Some(u8::try_from(range).map_err(|_| group.refuse("range", "is no range", "write 0 to 255"))?),
        };
        let offset = Vector3::from(group.three("offset")?.unwrap_or_default());
        let added = match group.text("offset_sign")?.as_deref() {
            Some("added") => true,
            Some("subtracted") => false,
            None if offset == Vector3::zeros() => false,
            None => return Err(group.missing("offset_sign")),
            Some(_) => {
                let remedy = "`subtracted` is taken off the reading before the matrix, `added` to the field behind it";
                return Err(group.refuse("offset_sign", "must be \"added\" or \"subtracted\"", remedy));
            }
        };
        let covariance = group.rows("covariance")?;
        if covariance.as_ref().is_some_and(|c| c.len() != 12 || c.iter().any(|row| row.len() != 12)) {
            return Err(group.refuse("covariance", "must be 12 by 12", "nine elements row by row, then three offsets"));
        }
        if let Some(Err(rule)) = covariance.as_deref().map(is_covariance) {
            return Err(group.refuse("covariance", rule, "take it from its source again, with all digits"));
        }
        let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
        if matrix.determinant() == 0.0 || !matrix.iter().all(|v| v.is_finite()) {
            return Err(group.refuse("matrix", "has no inverse", "write its rows with all their digits"));
        }
        Ok(RangeMatrix { span: self.span(group)?, range, matrix, offset, added, covariance })
    }
}

/// The axes in which an offset is taken off.
fn frame_of(group: &Group<'_>, key: &str) -> Result<OffsetFrame, Finding> {
    match needed(group, key, group.text(key)?)?.as_str() {
        "sc" => Ok(OffsetFrame::Sc),
        "uvw" => Ok(OffsetFrame::Uvw),
        _ => Err(group.refuse(key, "must be \"sc\" or \"uvw\"", "say in which axes the offset is")),
    }
}

/// How counts become engineering units; a factor stands in place of the full scale, the bits say which counts there are with either.
fn counts(group: &Group<'_>) -> Result<Counts, Finding> {
    let bits = group.whole("adc_bits")?.unwrap_or(20);
    if !(2..=MOST_BITS).contains(&bits) {
        return Err(group.refuse("adc_bits", "is no number of bits of a converter", "write 2 to 32"));
    }
    let full_scale_ent = positive(group, "full_scale_ent", group.number("full_scale_ent")?)?;
    let Some(ent_per_count) = group.numbers_or_one("ent_per_count")? else {
        return Ok(Counts::Converter { bits, full_scale_ent: full_scale_ent.unwrap_or(15_000.0) });
    };
    if full_scale_ent.is_some() {
        return Err(group.refuse("ent_per_count", "stands beside `full_scale_ent`", "state the one or the other"));
    }
    if ent_per_count.is_empty() || ent_per_count.contains(&0.0) {
        return Err(group.refuse("ent_per_count", "must be a factor, or one per range", "a factor of 0 leaves no field"));
    }
    Ok(Counts::Factor { ent_per_count, bits })
}

fn noise(group: &Group<'_>) -> Result<BTreeMap<Option<String>, f64>, Finding> {
    let mut list = BTreeMap::new();
    if let Ok(Some(by_mode)) = group.group("noise_ent") {
        for sid in by_mode.names() {
            list.insert(Some(sid.to_owned()), at_least_zero(&by_mode, sid, 0.0)?);
        }
    } else if group.number("noise_ent")?.is_some() {
        list.insert(None, at_least_zero(group, "noise_ent", 0.0)?);
    }
    Ok(list)
}
