//! `campaign.toml`: what the run headers do not tell.

use super::stated::Stated;
use crate::data::convention::Convention;
use crate::data::error::{Finding, Severity};
use crate::data::exclusion::{ExcludedPart, Exclusion, NoExclusion};
use crate::data::reference::{StatedReference, is_rotation};
use crate::data::run::{Kind, Location};
use crate::data::thermistor::HIGHEST_ORDER;
use crate::files::source::{Digested, read_whole};
use crate::files::text::{Group, Keys, decode};
use crate::model::campaign::{
    FieldLimits, Instructions, MOST_THERMAL_ORDER, SensorChannels, SlopeBounds, THERMAL_QUANTITIES, ThermalEntry,
};
use crate::model::position::Position;
use std::collections::BTreeMap;
use std::path::Path;

/// The whole file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CampaignFile {
    /// Name of the campaign.
    pub name: Option<String>,
    /// Instrument.
    pub instrument: Option<String>,
    /// What the analyses need to know of the runs beside their headers.
    pub instructions: Instructions,
    /// Run ids that the analysis of a kind uses; a kind that is missing uses all its runs.
    pub runs: Vec<(Kind, Vec<String>)>,
    /// What the protocol states about laboratory, item and persons: the label of the entry and its text.
    pub report: Vec<(&'static str, String)>,
    /// Temperature at which the protocol gives the final parameters, °C.
    pub reference_degc: Option<f64>,
    /// Calibration tables of thermistors.
    pub thermistors: Vec<ThermistorEntry>,
    /// What the protocol states in words of the laboratory.
    pub stated: Stated,
    /// What is left out by hand.
    pub exclude: Vec<Exclusion>,
}

/// A calibration table of a thermistor, which the protocol shows and ground calibration files take. Paths are from the campaign's folder.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermistorEntry {
    /// The table.
    pub table: String,
    /// Readings beside a reference thermometer, as `calfit thermistor --reference` takes them.
    pub reference: Option<String>,
    /// The sensor that the thermistor sits in; absent for one that goes with every sensor.
    pub sensor: Option<String>,
    /// Order of the polynomial; chosen if absent.
    pub order: Option<u32>,
    /// Reference voltage, V, and series resistance, Ω, of its divider.
    pub divider: Option<[f64; 2]>,
    /// Its files may lie outside the campaign.
    pub is_outside: bool,
}

impl CampaignFile {
    /// The groups that list runs, with the kind of runs that they list.
    pub const ANALYSES: [(&'static str, Kind); 3] =
        [("lin", Kind::Linearity), ("offset", Kind::Offset), ("freq", Kind::Frequency)];
    /// Keys of `[report]` with their labels.
    pub const REPORT: [(&'static str, &'static str); 19] = [
        ("title", "Title"),
        ("identifier", "Document"),
        ("issue", "Issue"),
        ("replaces", "Replaces"),
        ("author", "Author"),
        ("distribution", "Distribution"),
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

const KNOWN: [&str; 21] = [
    "name",
    "instrument",
    "offset_trend_order",
    "temperature_channel",
    "coil_temperature_channel",
    "coil_temperature_channels",
    "rack_temperature_channel",
    "position",
    "sensor",
    "limit",
    "lin",
    "offset",
    "freq",
    "thermal",
    "at",
    "exclude",
    "reference",
    "thermistor",
    "uncertainty",
    "report",
    "remark",
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
    let (name, instrument) = (root.text("name")?, root.text("instrument")?);
    let mut campaign = CampaignFile { instructions: instructions(root, findings)?, name, instrument, ..CampaignFile::default() };
    campaign.instructions.description = described(&campaign);
    for (name, kind) in CampaignFile::ANALYSES {
        if let Some(group) = root.group(name)? {
            findings.extend(group.unknown(&["runs"]));
            campaign.runs.extend(group.texts("runs")?.map(|runs| (kind, runs)));
        }
    }
    campaign.exclude = exclusions(root, findings)?;
    campaign.stated.take_remarks(root, findings)?;
    for group in root.groups("thermistor")? {
        findings.extend(group.unknown(&["sensor", "table", "reference", "order", "divider", "outside"]));
        campaign.thermistors.push(thermistor(&group)?);
    }
    if let Some(group) = root.group("report")? {
        let known: Vec<&str> = CampaignFile::REPORT
            .iter()
            .map(|(key, _)| *key)
            .chain(["thermistors", "reference_temperature_degc"])
            .chain(Stated::KEYS)
            .collect();
        findings.extend(group.unknown(&known));
        let tables = group.texts("thermistors")?.unwrap_or_default();
        campaign.thermistors.extend(tables.into_iter().map(|table| ThermistorEntry { table, ..ThermistorEntry::default() }));
        campaign.stated.take(&group, findings)?;
        campaign.reference_degc = group.number("reference_temperature_degc")?;
        for (key, label) in CampaignFile::REPORT {
            campaign.report.extend(group.text(key)?.map(|text| (label, text)));
        }
    }
    Ok(campaign)
}

/// Name and instrument of a campaign.
fn described(campaign: &CampaignFile) -> String {
    match (&campaign.name, &campaign.instrument) {
        (Some(name), Some(instrument)) => format!("{name}; {instrument}"),
        (name, instrument) => name.clone().or_else(|| instrument.clone()).unwrap_or_else(|| "not named".to_owned()),
    }
}

fn instructions(root: &Group, findings: &mut Vec<Finding>) -> Result<Instructions, Finding> {
    let mut instructions = Instructions {
        offset_trend_order: root.whole("offset_trend_order")?,
        temperature_channel: root.text("temperature_channel")?,
        coil_temperature_channel: root.text("coil_temperature_channel")?,
        coil_temperature_channels: coil_channels(root)?,
        rack_temperature_channel: root.text("rack_temperature_channel")?,
        ..Instructions::default()
    };
    if instructions.offset_trend_order.is_some_and(|order| order > 2) {
        return Err(root.refuse("offset_trend_order", "must be 0, 1 or 2", "use the lowest order that the drift needs"));
    }
    let positions = positions(root, findings)?;
    if !positions.is_empty() {
        instructions.positions = positions;
    }
    for group in root.groups("sensor")? {
        findings.extend(group.unknown(&["name", "temperature_channel", "coil_temperature_channel", "coil_temperature_channels"]));
        instructions.sensors.push(SensorChannels {
            name: group.text("name")?.ok_or_else(|| group.missing("name"))?,
            temperature_channel: group.text("temperature_channel")?,
            coil_temperature_channel: group.text("coil_temperature_channel")?,
            coil_temperature_channels: coil_channels(&group)?,
        });
    }
    for group in root.groups("limit")? {
        findings.extend(group.unknown(&["sensor", "mode", "max_field_nt"]));
        instructions.limits.push(limit(&group)?);
    }
    for group in root.groups("thermal")? {
        findings.extend(group.unknown(&["sensor", "mode", "runs", "order"]));
        instructions.thermal.push(thermal(&group, findings)?);
    }
    instructions.at = locations(root, findings)?;
    instructions.references = references(root, findings)?;
    instructions.slope_bounds = slope_bounds(root, findings)?;
    Ok(instructions)
}

/// `coil_temperature_channels`: one channel for each of the coils X, Y and Z.
fn coil_channels(group: &Group) -> Result<Option<[String; 3]>, Finding> {
    const KEY: &str = "coil_temperature_channels";
    let three = |list: Vec<String>| {
        list.try_into().map_err(|_| group.refuse(KEY, "must be three names", "write the channels of the coils X, Y and Z"))
    };
    group.texts(KEY)?.map(three).transpose()
}

/// Quantities of `[[uncertainty]]` that are carried nowhere yet.
const LATER: [&str; 9] = [
    "coil_constant",
    "coil_angle",
    "current_source",
    "orientation",
    "thermometer",
    "temperature_gradient",
    "clock",
    "converter",
    "scalar_reference",
];

/// `[[uncertainty]]`: how large the slopes of sensors with their temperature can be.
fn slope_bounds(root: &Group, findings: &mut Vec<Finding>) -> Result<SlopeBounds, Finding> {
    let mut bounds = SlopeBounds::default();
    for group in root.groups("uncertainty")? {
        findings.extend(group.unknown(&["quantity", "std", "unit", "source", "common"]));
        let quantity = group.text("quantity")?.ok_or_else(|| group.missing("quantity"))?;
        let std = group.number("std")?.ok_or_else(|| group.missing("std"))?;
        if std.is_nan() || std <= 0.0 {
            return Err(group.refuse("std", "must be positive", "write the standard uncertainty in the unit of `unit`"));
        }
        if group.text("common")?.is_some_and(|common| !["none", "axes", "runs"].contains(&common.as_str())) {
            return Err(group.refuse("common", "is what shares one error", "write none, axes or runs"));
        }
        let (bound, unit) = match quantity.as_str() {
            "slope_sigma" => (&mut bounds.sigma_per_k, "nT/enT/K"),
            "slope_xi" => (&mut bounds.xi_deg_per_k, "deg/K"),
            "slope_offset" => (&mut bounds.offset_ent_per_k, "enT/K"),
            other if LATER.contains(&other) => {
                let rule = format!("of {other} is read and not used: no uncertainty in the results contains it");
                findings
                    .push(group.refuse("quantity", &rule, "add it to the uncertainties yourself").weighing(Severity::Warning));
                continue;
            }
            _ => {
                let names =
                    ["slope_sigma", "slope_xi", "slope_offset"].iter().chain(&LATER).copied().collect::<Vec<_>>().join(", ");
                return Err(group.refuse("quantity", "is none of those that can be stated", &format!("write one of {names}")));
            }
        };
        if group.text("unit")?.ok_or_else(|| group.missing("unit"))? != unit {
            return Err(group.refuse("unit", &format!("of {quantity} must be \"{unit}\""), "convert the value"));
        }
        if bound.replace(std).is_some() {
            return Err(group.refuse("quantity", "stands twice", "leave one of the two out"));
        }
    }
    Ok(bounds)
}

fn positions(root: &Group, findings: &mut Vec<Finding>) -> Result<Vec<(u32, Position)>, Finding> {
    let mut positions: Vec<(u32, Position)> = Vec::new();
    for group in root.groups("position")? {
        findings.extend(group.unknown(&["id", "axes"]));
        let id = group.whole("id")?.ok_or_else(|| group.missing("id"))?;
        let axes = group.texts("axes")?.ok_or_else(|| group.missing("axes"))?;
        let position = Position::from_axes(&axes)
            .map_err(|e| group.refuse("axes", &format!("of position {id} cannot be used: {e}"), "correct its axes"))?;
        if positions.iter().any(|(other, _)| *other == id) {
            return Err(group.refuse("id", "stands twice", "give every position an id of its own"));
        }
        positions.push((id, position));
    }
    Ok(positions)
}

/// `[[at]]`: where the sensor stood, by run.
fn locations(root: &Group, findings: &mut Vec<Finding>) -> Result<BTreeMap<String, Location>, Finding> {
    let mut locations = BTreeMap::new();
    for group in root.groups("at")? {
        findings.extend(group.unknown(&["runs", "location"]));
        let location = location(&group)?;
        for run in group.texts("runs")?.ok_or_else(|| group.missing("runs"))? {
            if locations.contains_key(&run) {
                let rule = format!("name the run {run} a second time, and a run has one location");
                return Err(group.refuse("runs", &rule, "take it out of one of the lists"));
            }
            locations.insert(run, location);
        }
    }
    Ok(locations)
}

/// `[[exclude]]`: what is left out by hand.
fn exclusions(root: &Group, findings: &mut Vec<Finding>) -> Result<Vec<Exclusion>, Finding> {
    let mut exclusions = Vec::new();
    for group in root.groups("exclude")? {
        findings.extend(group.unknown(&["run", "setting", "from_s", "until_s", "reason"]));
        let run = group.text("run")?.ok_or_else(|| group.missing("run"))?;
        let reason = group.text("reason")?.ok_or_else(|| group.missing("reason"))?;
        let part = match (group.whole("setting")?, group.number("from_s")?, group.number("until_s")?) {
            (None, None, None) => ExcludedPart::Run,
            (Some(number), None, None) => ExcludedPart::Setting(number as usize),
            (None, Some(from), Some(until)) => ExcludedPart::Span([from, until]),
            (None, Some(_), None) => return Err(group.missing("until_s")),
            (None, None, Some(_)) => return Err(group.missing("from_s")),
            (Some(_), ..) => {
                let rule = "stands beside from_s or until_s, and an entry leaves out one thing";
                return Err(group.refuse("setting", rule, "make two entries of it"));
            }
        };
        let exclusion = Exclusion::new(&run, part, &reason).map_err(|error| {
            let (key, rule) = match error {
                NoExclusion::Reason => ("reason", "must be a line of text"),
                NoExclusion::Setting => ("setting", "must be 1 or more"),
                NoExclusion::Span => ("until_s", "must be after from_s, and both not before the run's start"),
                NoExclusion::Form => ("run", "must be the id of a run"),
            };
            group.refuse(key, rule, &error.to_string())
        })?;
        exclusions.push(exclusion);
    }
    Ok(exclusions)
}

/// `[[reference]]`: how sensors stand in their reference cubes.
fn references(root: &Group, findings: &mut Vec<Finding>) -> Result<BTreeMap<String, StatedReference>, Finding> {
    let mut references = BTreeMap::new();
    for group in root.groups("reference")? {
        findings.extend(group.unknown(&["sensor", "rotation", "std_deg", "convention"]));
        let sensor = group.text("sensor")?.ok_or_else(|| group.missing("sensor"))?;
        let rotation = group.three_rows("rotation")?.ok_or_else(|| group.missing("rotation"))?;
        if !is_rotation(&rotation) {
            let rule = format!(
                "of sensor {sensor} is no rotation: its rows must have length 1, stand at right angles and be right-handed"
            );
            return Err(group.refuse("rotation", &rule, "write the rows with at least seven digits"));
        }
        let std_deg = group.number("std_deg")?.ok_or_else(|| group.missing("std_deg"))?;
        if std_deg < 0.0 {
            return Err(group.refuse("std_deg", "must not be negative", "write the standard uncertainty in degrees"));
        }
        let convention = match group.text("convention")? {
            Some(name) => Convention::from_name(&name).ok_or_else(|| {
                let remedy = "write \"bepicolombo\" or \"rosetta\": the sensor frame that the rotation starts from";
                group.refuse("convention", "is no convention of omega", remedy)
            })?,
            None => Convention::BepiColombo,
        };
        if references.insert(sensor.clone(), StatedReference { rotation, std_deg, convention }).is_some() {
            return Err(group.refuse("sensor", "has a reference already", "take one of the two out"));
        }
    }
    Ok(references)
}

/// The key `location`; the centre where it is missing.
///
/// # Errors
/// Another name.
pub fn location(group: &Group) -> Result<Location, Finding> {
    let Some(name) = group.text("location")? else { return Ok(Location::Centre) };
    Location::from_name(&name).ok_or_else(|| {
        let names = Location::NAMES.map(|(_, name)| format!("\"{name}\"")).join(" or ");
        group.refuse("location", "is no place of a sensor", &format!("write {names}"))
    })
}

fn thermistor(group: &Group) -> Result<ThermistorEntry, Finding> {
    let order = group.whole("order")?;
    if order.is_some_and(|order| !(1..=HIGHEST_ORDER).contains(&(order as usize))) {
        let rule = format!("must be 1 to {HIGHEST_ORDER}");
        return Err(group.refuse("order", &rule, "ground calibration files take 3 at most"));
    }
    let divider = group.numbers("divider")?.map(|values| match values[..] {
        [v, ohm] if v > 0.0 && ohm > 0.0 => Ok([v, ohm]),
        _ => {
            Err(group.refuse("divider", "must be two positive numbers", "write reference voltage, V, and series resistance, ohm"))
        }
    });
    Ok(ThermistorEntry {
        table: group.text("table")?.ok_or_else(|| group.missing("table"))?,
        reference: group.text("reference")?,
        sensor: group.text("sensor")?,
        order,
        divider: divider.transpose()?,
        is_outside: group.truth("outside")?.unwrap_or(false),
    })
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

fn limit(group: &Group) -> Result<FieldLimits, Finding> {
    let values = group.numbers("max_field_nt")?.ok_or_else(|| group.missing("max_field_nt"))?;
    let max_field_nt: [f64; 3] =
        values.try_into().ok().filter(|v: &[f64; 3]| v.iter().all(|l| *l > 0.0)).ok_or_else(|| {
            group.refuse("max_field_nt", "must be three positive numbers", "write the limits of x, y and z in nT")
        })?;
    Ok(FieldLimits { sensor: group.text("sensor")?, mode: group.text("mode")?, max_field_nt })
}
