//! `campaign.toml`: what the run headers do not tell.

use crate::data::error::Finding;
use crate::data::run::Kind;
use crate::files::source::{Digested, read_whole};
use crate::files::text::{Group, Keys, decode};
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

/// Runs that are compared across temperatures.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ThermalEntry {
    /// Sensor; `None` is any.
    pub sensor: Option<String>,
    /// Mode; `None` is any.
    pub mode: Option<String>,
    /// Run ids; `None` is all of sensor and mode.
    pub runs: Option<Vec<String>>,
    /// Polynomial order per quantity, `sigma`, `sigma_x`, `xi`, `b_or`, `b_off`, `f_3db` for example.
    pub orders: Vec<(String, u32)>,
}

/// Quantities of a thermal analysis, and the names under which several share one order.
pub const THERMAL_QUANTITIES: [&str; 20] = [
    "sigma", "xi", "b_or", "b_off", "f_3db", "sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz", "b_or_x", "b_or_y",
    "b_or_z", "b_off_x", "b_off_y", "b_off_z", "f_3db_x", "f_3db_y", "f_3db_z",
];
/// Largest order of a temperature polynomial.
pub const MOST_THERMAL_ORDER: u32 = 5;

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
    /// Channel of the temperature of the facility's electronics rack.
    pub rack_temperature_channel: Option<String>,
    /// Positions.
    pub positions: Vec<PositionEntry>,
    /// Sensors.
    pub sensors: Vec<SensorEntry>,
    /// Field limits.
    pub limits: Vec<LimitEntry>,
    /// Run ids that the analysis of a kind uses; a kind that is missing uses all its runs.
    pub runs: Vec<(Kind, Vec<String>)>,
    /// Thermal groups; without any they follow from sensor and mode.
    pub thermal: Vec<ThermalEntry>,
    /// What the protocol states about laboratory, item and persons: the label of the entry and its text.
    pub report: Vec<(&'static str, String)>,
    /// Calibration tables of thermistors that the protocol shows, paths from the campaign's folder.
    pub thermistors: Vec<String>,
}

impl CampaignFile {
    /// The groups that list runs, with the kind of runs that they list.
    pub const ANALYSES: [(&'static str, Kind); 3] =
        [("lin", Kind::Linearity), ("offset", Kind::Offset), ("freq", Kind::Frequency)];
    /// Keys of `[report]` with their labels.
    pub const REPORT: [(&'static str, &'static str); 17] = [
        ("title", "Title"),
        ("identifier", "Document"),
        ("issue", "Issue"),
        ("replaces", "Replaces"),
        ("laboratory", "Laboratory"),
        ("place", "Place of the measurements"),
        ("customer", "Customer"),
        ("responsible", "Responsible"),
        ("checked_by", "Checked by"),
        ("maker", "Maker of the instrument"),
        ("model", "Model"),
        ("serial", "Serial numbers of sensor and electronics"),
        ("firmware", "Range and firmware"),
        ("condition", "Condition of the instrument"),
        ("setup", "Setup"),
        ("traceability", "Traceability of the reference field"),
        ("field_uncertainty", "Uncertainty of the reference field"),
    ];
}

const KNOWN: [&str; 14] = [
    "name",
    "instrument",
    "offset_trend_order",
    "temperature_channel",
    "coil_temperature_channel",
    "rack_temperature_channel",
    "position",
    "sensor",
    "limit",
    "lin",
    "offset",
    "freq",
    "thermal",
    "report",
];

/// Reads a campaign file; warnings go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(CampaignFile, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let file = path.display().to_string();
    let text = decode(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes)).into_owned();
    let keys = Keys::parse(&file, 1, text)?;
    Ok((parse(&keys.root(), findings)?, digested))
}

/// The keys of a campaign; warnings go to `findings`.
///
/// # Errors
/// The first fault, with its place.
pub fn parse(root: &Group, findings: &mut Vec<Finding>) -> Result<CampaignFile, Finding> {
    findings.extend(root.unknown(&KNOWN));
    let mut campaign = CampaignFile {
        name: root.text("name")?,
        instrument: root.text("instrument")?,
        offset_trend_order: root.whole("offset_trend_order")?,
        temperature_channel: root.text("temperature_channel")?,
        coil_temperature_channel: root.text("coil_temperature_channel")?,
        rack_temperature_channel: root.text("rack_temperature_channel")?,
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
    for (name, kind) in CampaignFile::ANALYSES {
        if let Some(group) = root.group(name)? {
            findings.extend(group.unknown(&["runs"]));
            campaign.runs.extend(group.texts("runs")?.map(|runs| (kind, runs)));
        }
    }
    for group in root.groups("thermal")? {
        findings.extend(group.unknown(&["sensor", "mode", "runs", "order"]));
        campaign.thermal.push(thermal(&group, findings)?);
    }
    if let Some(group) = root.group("report")? {
        let known: Vec<&str> = CampaignFile::REPORT.iter().map(|(key, _)| *key).chain(["thermistors"]).collect();
        findings.extend(group.unknown(&known));
        campaign.thermistors = group.texts("thermistors")?.unwrap_or_default();
        for (key, label) in CampaignFile::REPORT {
            campaign.report.extend(group.text(key)?.map(|text| (label, text)));
        }
    }
    Ok(campaign)
}

fn thermal(group: &Group, findings: &mut Vec<Finding>) -> Result<ThermalEntry, Finding> {
    let mut orders = Vec::new();
    if let Some(order) = group.group("order")? {
        findings.extend(order.unknown(&THERMAL_QUANTITIES));
        for quantity in THERMAL_QUANTITIES {
            if let Some(value) = order.whole(quantity)? {
                if value > MOST_THERMAL_ORDER {
                    return Err(order.refuse(quantity, "must be 0 to 5", "use the lowest order that the data need"));
                }
                orders.push((quantity.to_owned(), value));
            }
        }
    }
    Ok(ThermalEntry { sensor: group.text("sensor")?, mode: group.text("mode")?, runs: group.texts("runs")?, orders })
}

fn limit(group: &Group) -> Result<LimitEntry, Finding> {
    let values = group.numbers("max_field_nt")?.ok_or_else(|| group.missing("max_field_nt"))?;
    let max_field_nt: [f64; 3] =
        values.try_into().ok().filter(|v: &[f64; 3]| v.iter().all(|l| *l > 0.0)).ok_or_else(|| {
            group.refuse("max_field_nt", "must be three positive numbers", "write the limits of x, y and z in nT")
        })?;
    Ok(LimitEntry { sensor: group.text("sensor")?, mode: group.text("mode")?, max_field_nt })
}
