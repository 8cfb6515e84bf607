//! `campaign.toml`: what the run headers do not tell.

use super::source::{Digested, read_whole};
use super::text::{Group, Keys, decode};
use crate::error::Finding;
use serde::Serialize;
use std::path::Path;

/// A position as the file names it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PositionEntry {
    /// Id used in settings.
    pub id: u32,
    /// X_m, Y_m, Z_m along coil axes, `["-Z", "+Y", "+X"]`.
    pub axes: Vec<String>,
}

/// Channels of a sensor.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SensorEntry {
    /// Name as in the run headers.
    pub name: String,
    /// Channel of the sensor temperature.
    pub temperature_channel: Option<String>,
    /// Channel of the coil system's temperature.
    pub coil_temperature_channel: Option<String>,
}

/// Field limits of a sensor and mode.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitEntry {
    /// Sensor; `None` is any.
    pub sensor: Option<String>,
    /// Mode; `None` is any.
    pub mode: Option<String>,
    /// Largest magnitude along the nominal sensor axes, nT.
    pub max_field_nt: [f64; 3],
}

/// The whole file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CampaignFile {
    /// Name of the campaign.
    pub name: Option<String>,
    /// Instrument.
    pub instrument: Option<String>,
    /// Order of the offset trend in linearity runs.
    pub offset_trend_order: Option<u32>,
    /// Channel of the sensor temperature for all sensors.
    pub temperature_channel: Option<String>,
    /// Channel of the coil temperature for all sensors.
    pub coil_temperature_channel: Option<String>,
    /// Positions.
    pub positions: Vec<PositionEntry>,
    /// Sensors.
    pub sensors: Vec<SensorEntry>,
    /// Field limits.
    pub limits: Vec<LimitEntry>,
    /// Run ids that `lin` uses; `None` is all linearity runs.
    pub lin_runs: Option<Vec<String>>,
}

const KNOWN: [&str; 12] = [
    "name",
    "instrument",
    "offset_trend_order",
    "temperature_channel",
    "coil_temperature_channel",
    "position",
    "sensor",
    "limit",
    "lin",
    "offset",
    "freq",
    "thermal",
];

/// Reads a campaign file; warnings go to `findings`.
///
/// # Errors
/// What is wrong with it, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(CampaignFile, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let file = path.display().to_string();
    let text = decode(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes)).into_owned();
    let keys = Keys::parse(&file, 1, text)?;
    let root = keys.root();
    findings.extend(root.unknown(&KNOWN));
    let mut campaign = CampaignFile {
        name: root.text("name")?,
        instrument: root.text("instrument")?,
        offset_trend_order: root.whole("offset_trend_order")?,
        temperature_channel: root.text("temperature_channel")?,
        coil_temperature_channel: root.text("coil_temperature_channel")?,
        ..CampaignFile::default()
    };
    if campaign.offset_trend_order.is_some_and(|order| order > 2) {
        return Err(root.refuse("offset_trend_order", "must be 0, 1 or 2", "use the lowest order that the drift needs"));
    }
    for group in root.groups("position")? {
        findings.extend(group.unknown(&["id", "axes"]));
        let id = group.whole("id")?.ok_or_else(|| group.missing("id"))?;
        let axes = group.texts("axes")?.ok_or_else(|| group.missing("axes"))?;
        if campaign.positions.iter().any(|p| p.id == id) {
            return Err(group.refuse("id", "stands twice", "give every position an id of its own"));
        }
        campaign.positions.push(PositionEntry { id, axes });
    }
    for group in root.groups("sensor")? {
        findings.extend(group.unknown(&["name", "temperature_channel", "coil_temperature_channel"]));
        campaign.sensors.push(SensorEntry {
            name: group.text("name")?.ok_or_else(|| group.missing("name"))?,
            temperature_channel: group.text("temperature_channel")?,
            coil_temperature_channel: group.text("coil_temperature_channel")?,
        });
    }
    for group in root.groups("limit")? {
        findings.extend(group.unknown(&["sensor", "mode", "max_field_nt"]));
        campaign.limits.push(limit(&group)?);
    }
    if let Some(group) = root.group("lin")? {
        findings.extend(group.unknown(&["runs"]));
        campaign.lin_runs = group.texts("runs")?;
    }
    Ok((campaign, digested))
}

fn limit(group: &Group) -> Result<LimitEntry, Finding> {
    let values = group.numbers("max_field_nt")?.ok_or_else(|| group.missing("max_field_nt"))?;
    let max_field_nt: [f64; 3] =
        values.try_into().ok().filter(|v: &[f64; 3]| v.iter().all(|l| *l > 0.0)).ok_or_else(|| {
            group.refuse("max_field_nt", "must be three positive numbers", "write the limits of x, y and z in nT")
        })?;
    Ok(LimitEntry { sensor: group.text("sensor")?, mode: group.text("mode")?, max_field_nt })
}
