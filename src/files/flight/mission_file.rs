//! The reader of `flight.toml`.

mod sensor;

use super::mission::{
    Celestial, Common, Disturbance, Heater, MeansFrame, Mission, Mode, OutsideTemperature, Rate, Roles, Sensor, Span, Wheels,
    overlap,
};
use super::times::{TimeColumn, TimeRule};
use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000, ns};
use crate::files::source::{Digested, read_whole, small_text};
use crate::files::text::{Group, Keys, decode};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The steps where a configuration states none, in their order.
pub const STEPS: [&str; 8] = ["counts", "temperature", "ground", "daily", "shift", "rotate", "offsets", "attitude"];
/// The step of `[[disturbance]]`, which takes off fields in axes of the sensor at corrected times: with one stated it stands before
/// `rotate`.
const DISTURBANCE: &str = "disturbance";
/// Days are read so far beyond their ends, s.
const LONGEST_SHIFT_S: f64 = 1800.0;
/// Intervals of means, s.
const MEANS_S: [f64; 2] = [1e-3, 86_400.0];

/// Reads a configuration of flight processing.
///
/// # Errors
/// The first thing that is wrong with it, with its place.
pub fn read(path: &Path, leap: &LeapSeconds) -> Result<(Mission, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let text = decode(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes)).into_owned();
    let folder = path.parent().map(Path::to_owned).unwrap_or_default();
    let keys = Keys::parse(&path.display().to_string(), 1, text)?;
    let reader = MissionFile { leap, folder };
    Ok((reader.mission(&keys.root())?, digested))
}

/// Whether a file is a configuration of flight processing, by its keys.
#[must_use]
pub fn is_mission(path: &Path) -> bool {
    let Some(text) = small_text(path) else { return false };
    let Ok(keys) = Keys::parse(&path.display().to_string(), 1, text) else { return false };
    let names = keys.root().names();
    ["mission", "instrument", "sensor", "input"].iter().filter(|key| names.contains(key)).count() >= 3
}

struct MissionFile<'a> {
    leap: &'a LeapSeconds,
    folder: PathBuf,
}

fn needed<T>(group: &Group<'_>, key: &str, value: Option<T>) -> Result<T, Finding> {
    value.ok_or_else(|| group.missing(key))
}

fn at_least_zero(group: &Group<'_>, key: &str, default: f64) -> Result<f64, Finding> {
    let value = group.number(key)?.unwrap_or(default);
    if value < 0.0 { Err(group.refuse(key, "must not be negative", "correct the value")) } else { Ok(value) }
}

fn positive(group: &Group<'_>, key: &str, value: Option<f64>) -> Result<Option<f64>, Finding> {
    match value {
        Some(v) if v <= 0.0 => Err(group.refuse(key, "must be positive", "correct the value")),
        other => Ok(other),
    }
}

impl MissionFile<'_> {
    fn path(&self, group: &Group<'_>, key: &str) -> Result<Option<PathBuf>, Finding> {
        Ok(group.text(key)?.map(|path| self.folder.join(path)))
    }

    fn time(&self, group: &Group<'_>, key: &str) -> Result<Option<Tt2000>, Finding> {
        let Some(text) = group.text(key)? else { return Ok(None) };
        let wrong = || group.refuse(key, "is no time", "write UTC as 2015-06-30T12:00:00Z");
        self.leap.parse(&text).map(Some).ok_or_else(wrong)
    }

    fn span(&self, group: &Group<'_>) -> Result<Span, Finding> {
        let from = needed(group, "from", self.time(group, "from")?)?;
        let to = needed(group, "to", self.time(group, "to")?)?;
        if from >= to {
            return Err(group.refuse("to", "must be after `from`", "intervals are half-open, [from, to)"));
        }
        Ok(Span { from, to })
    }

    fn mission(&self, root: &Group<'_>) -> Result<Mission, Finding> {
        root.only(&[
            "version",
            "mission",
            "instrument",
            "input",
            "hk",
            "time",
            "edited",
            "continuity",
            "campaign",
            "temperature",
            "celestial",
            "sensor",
            "mode",
            "role",
            "wheels",
            "heater",
            "pca",
            "means",
            "disturbance",
            "pipeline",
            "output",
        ])?;
        if needed(root, "version", root.whole("version")?)? != 1 {
            return Err(root.refuse("version", "must be 1", "take the program that the file was written for"));
        }
        let sensors = root.groups("sensor")?.iter().map(|group| self.sensor(group)).collect::<Result<Vec<_>, _>>()?;
        if sensors.is_empty() {
            return Err(root.missing("sensor"));
        }
        let continuity = root.group("continuity")?;
        let temperature = root.group("temperature")?;
        let (outside, extended_degc, smooth_s) =
            temperature.map_or(Ok((OutsideTemperature::Null, None, 0.0)), |g| outside(&g))?;
        let time = root.group("time")?;
        let (primary, tolerance_s) = time.map_or(Ok((None, 1e-3)), |g| time_rule(&g))?;
        let edited = root.group("edited")?;
        let (reject_mask, sid) = edited.map_or(Ok((7, None)), |g| edited_rule(&g))?;
        let (continuity, reset_gap_s) = continuity.map_or(Ok((true, 10_800.0)), |g| {
            g.only(&["enabled", "reset_gap_s"])?;
            Ok::<_, Finding>((g.truth("enabled")?.unwrap_or(true), at_least_zero(&g, "reset_gap_s", 10_800.0)?))
        })?;
        let mut modes = Vec::new();
        let mut mode_spans = Vec::new();
        for group in root.groups("mode")? {
            let sid = needed(&group, "sid", group.text("sid")?)?;
            if group.names().contains(&"from") {
                mode_spans.push((self.span(&group)?, sid.clone()));
            }
            if group.names().contains(&"packet_s") || !group.names().contains(&"from") {
                let mode = mode(&group, sid)?;
                if modes.iter().any(|m: &Mode| m.sid == mode.sid) {
                    return Err(group.refuse("sid", "is named twice", "state every mode once"));
                }
                modes.push(mode);
            }
        }
        let mut spans: Vec<Span> = mode_spans.iter().map(|(span, _): &(Span, String)| *span).collect();
        spans.sort_unstable();
        apart(root, "mode", &spans)?;
        let disturbances = root.groups("disturbance")?.iter().map(disturbance).collect::<Result<Vec<_>, _>>()?;
        let hk = self.path(root, "hk")?;
        if hk.is_none() && !disturbances.is_empty() {
            return Err(root.missing("hk"));
        }
        let mission = Mission {
            folder: self.folder.clone(),
            mission: needed(root, "mission", root.text("mission")?)?,
            instrument: needed(root, "instrument", root.text("instrument")?)?,
            input: needed(root, "input", self.path(root, "input")?)?,
            hk,
            time_rule: TimeRule { primary, tolerance_ns: ns(tolerance_s) },
            reject_mask,
            sid,
            mode_spans,
            continuity,
            reset_gap_ns: ns(reset_gap_s),
            campaigns: root
                .groups("campaign")?
                .iter()
                .map(|g| g.only(&["from", "to"]).and_then(|()| self.span(g)))
                .collect::<Result<_, _>>()?,
            outside,
            extended_degc,
            smooth_s,
            celestial: root.group("celestial")?.map(|g| self.celestial(&g)).transpose()?,
            roles: self.roles(root, &sensors)?,
            sensors,
            modes,
            wheels: root.group("wheels")?.map(|g| self.wheels(&g)).transpose()?,
            heater: root.group("heater")?.map(|g| self.heater(&g)).transpose()?,
            common: root.group("pca")?.map(|g| self.common(&g)).transpose()?.unwrap_or_default(),
            mean_ns: match root.group("means")? {
                None => SECOND_NS,
                Some(g) => {
                    g.only(&["mean_s"])?;
                    let mean_s = g.number("mean_s")?.unwrap_or(1.0);
                    if !(MEANS_S[0]..=MEANS_S[1]).contains(&mean_s) {
                        return Err(g.refuse("mean_s", "must be from a millisecond to a day", "write the length in seconds"));
                    }
                    ns(mean_s)
                }
            },
            steps: steps(root, !disturbances.is_empty())?,
            disturbances,
            uncertainty: output(root, "uncertainty", true)?,
            text: output(root, "text", false)?,
        };
        let stated = |sid: &str| mission.modes.iter().any(|mode| mode.sid == sid);
        let unknown = |sid: &str, what: &str| {
            root.refuse(
                "mode",
                &format!("has no {sid}, which {what} names"),
                "state every mode once, and name those that are stated",
            )
        };
        for sensor in &mission.sensors {
            if let Some(sid) = sensor.noise_ent.keys().flatten().find(|sid| !stated(sid)) {
                return Err(unknown(sid, "`sensor.noise_ent`"));
            }
        }
        let widths = mission.wheels.iter().flat_map(|w| w.half_width_hz.keys());
        let named = mission.mode_spans.iter().map(|(_, sid)| sid).chain(&mission.sid);
        if let Some(sid) = widths.chain(named).find(|sid| !stated(sid)) {
            return Err(unknown(sid, "another key"));
        }
        Ok(mission)
    }

    fn roles(&self, root: &Group<'_>, sensors: &[Sensor]) -> Result<Roles, Finding> {
        let Some(group) = root.group("role")? else {
            return if sensors.len() > 1 { Err(root.missing("role")) } else { Ok(Roles::default()) };
        };
        group.only(&["primary", "secondary", "interval"])?;
        let known = |group: &Group<'_>, key: &str| -> Result<Option<String>, Finding> {
            let name = group.text(key)?;
            match &name {
                Some(name) if !sensors.iter().any(|s| s.name == *name) => {
                    Err(group.refuse(key, "is no sensor of this file", "name one of [[sensor]]"))
                }
                _ => Ok(name),
            }
        };
        let mut intervals = Vec::new();
        for interval in group.groups("interval")? {
            interval.only(&["from", "to", "primary"])?;
            let primary = needed(&interval, "primary", known(&interval, "primary")?)?;
            intervals.push((self.span(&interval)?, primary));
        }
        let spans: Vec<Span> = intervals.iter().map(|(span, _)| *span).collect();
        apart(&group, "interval", &spans)?;
        let roles = Roles { primary: known(&group, "primary")?, secondary: known(&group, "secondary")?, intervals };
        if sensors.len() > 1 && roles.primary.is_none() {
            return Err(group.missing("primary"));
        }
        if sensors.len() > 1 && roles.secondary.is_none() {
            return Err(group.missing("secondary"));
        }
        if roles.primary.is_some() && roles.primary == roles.secondary {
            return Err(group.refuse("secondary", "is the primary sensor", "name the other one"));
        }
        Ok(roles)
    }

    fn celestial(&self, group: &Group<'_>) -> Result<Celestial, Finding> {
        group.only(&[
            "frame",
            "attitude",
            "attitude_order",
            "attitude_from_to",
            "attitude_max_gap_s",
            "attitude_std_rad",
            "position",
        ])?;
        let one_of = |key: &str, first: &str, second: &str| -> Result<bool, Finding> {
            match needed(group, key, group.text(key)?)?.as_str() {
                word if word == first => Ok(true),
                word if word == second => Ok(false),
                _ => Err(group.refuse(key, &format!("must be \"{first}\" or \"{second}\""), "see how the table was made")),
            }
        };
        Ok(Celestial {
            frame: match needed(group, "frame", group.text("frame")?)? {
                empty if empty.trim().is_empty() => {
                    return Err(group.refuse("frame", "is empty", "name the frame, ECLIPJ2000 for example"));
                }
                frame => frame,
            },
            attitude: needed(group, "attitude", self.path(group, "attitude")?)?,
            scalar_first: one_of("attitude_order", "scalar-first", "scalar-last")?,
            from_sc: one_of("attitude_from_to", "sc to celestial", "celestial to sc")?,
            max_gap_ns: ns(at_least_zero(group, "attitude_max_gap_s", 60.0)?),
            std_rad: at_least_zero(group, "attitude_std_rad", 0.0)?,
            position: self.path(group, "position")?,
        })
    }

    fn wheels(&self, group: &Group<'_>) -> Result<Wheels, Finding> {
        group.only(&["table", "harmonics", "method", "half_width_hz", "seed"])?;
        let stripe = match group.text("method")?.as_deref() {
            None | Some("fit") => false,
            Some("stripe") => true,
            Some(_) => return Err(group.refuse("method", "must be \"fit\" or \"stripe\"", "correct the value")),
        };
        let harmonics = group.numbers("harmonics")?.unwrap_or_else(|| vec![1.0]);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "looked at before")]
        let harmonics = if harmonics.iter().all(|h| (1.0..=1000.0).contains(h) && h.fract() == 0.0) && !harmonics.is_empty() {
            harmonics.into_iter().map(|h| h as u32).collect()
        } else {
            return Err(group.refuse("harmonics", "must be whole numbers from 1", "write [1] for the wheels alone"));
        };
        let mut half_width_hz = BTreeMap::new();
        if let Some(widths) = group.group("half_width_hz")? {
            for mode in widths.names() {
                let width = positive(&widths, mode, widths.number(mode)?)?;
                half_width_hz.insert(mode.to_owned(), needed(&widths, mode, width)?);
            }
        }
        if half_width_hz.is_empty() {
            return Err(group.missing("half_width_hz"));
        }
        let seed = u64::from(group.whole("seed")?.unwrap_or(1));
        Ok(Wheels { table: needed(group, "table", self.path(group, "table")?)?, harmonics, stripe, half_width_hz, seed })
    }

    fn heater(&self, group: &Group<'_>) -> Result<Heater, Finding> {
        group.only(&["table", "classes", "method", "interval", "edge_s"])?;
        let from_table = match group.whole("method")? {
            None | Some(1) => false,
            Some(2) => true,
            Some(_) => return Err(group.refuse("method", "must be 1 or 2", "1 finds the jumps, 2 takes them from the table")),
        };
        let table = self.path(group, "table")?;
        if from_table && table.is_none() {
            return Err(group.missing("table"));
        }
        let classes = group.texts("classes")?.unwrap_or_default();
        if classes.is_empty() {
            return Err(group.missing("classes"));
        }
        let mut intervals = Vec::new();
        for interval in group.groups("interval")? {
            interval.only(&["from", "to"])?;
            intervals.push(self.span(&interval)?);
        }
        apart(group, "interval", &intervals)?;
        intervals.sort_unstable();
        let edge_s = group.number("edge_s")?;
        if edge_s.is_some_and(|s| !(0.0..=60.0).contains(&s)) {
            return Err(group.refuse("edge_s", "must be 0 to 60 s", "0 is a field that switches at once"));
        }
        Ok(Heater { table, classes, from_table, edge_s, intervals })
    }

    fn common(&self, group: &Group<'_>) -> Result<Common, Finding> {
        group.only(&["method", "coupling", "from", "to", "inputs"])?;
        let coupling = group.three_rows("coupling")?.map(|rows| Matrix3::from_fn(|row, column| rows[row][column]));
        let coupling = match group.text("method")?.as_deref() {
            None | Some("pca") if coupling.is_some() => {
                let rule = "changes nothing of principal components";
                return Err(group.refuse("coupling", rule, "state method = \"gradiometer\" beside it, or take it away"));
            }
            None | Some("pca") => None,
            Some("gradiometer") => Some(needed(group, "coupling", coupling)?),
            Some(_) => return Err(group.refuse("method", "must be \"pca\" or \"gradiometer\"", "correct the value")),
        };
        let inputs = match group.texts("inputs")? {
            None => Common::default().inputs,
            Some(list) => {
                let letters: Vec<char> = list.iter().filter_map(|word| word.chars().next().filter(|_| word.len() == 1)).collect();
                match letters[..] {
                    [a, b] if list.len() == 2 && [a, b].iter().all(|c| "EFGI".contains(*c)) => [a, b],
                    _ => return Err(group.refuse("inputs", "must be two of the levels E, F, G, I", "write [\"G\", \"G\"]")),
                }
            }
        };
        if MeansFrame::of(inputs[0]) != MeansFrame::of(inputs[1]) {
            let rule = "are levels of different axes, which have no field in common";
            return Err(group.refuse(
                "inputs",
                rule,
                "write levels of one frame: [\"E\", \"E\"], [\"F\", \"F\"] or [\"G\", \"G\"]",
            ));
        }
        let has_span = ["from", "to"].iter().any(|key| group.names().contains(key));
        let span = if has_span { Some(self.span(group)?) } else { None };
        Ok(Common { coupling, inputs, span })
    }
}

fn output(root: &Group<'_>, key: &str, default: bool) -> Result<bool, Finding> {
    let Some(group) = root.group("output")? else { return Ok(default) };
    group.only(&["uncertainty", "text"])?;
    Ok(group.truth(key)?.unwrap_or(default))
}

/// The steps in their order; fields that follow the housekeeping are taken off where they are stated, and nowhere else.
fn steps(root: &Group<'_>, has_disturbance: bool) -> Result<Vec<String>, Finding> {
    let Some(group) = root.group("pipeline")? else {
        let before_rotation = STEPS.into_iter().flat_map(|step| {
            let first = (has_disturbance && step == "rotate").then_some(DISTURBANCE);
            first.into_iter().chain([step])
        });
        return Ok(before_rotation.map(str::to_owned).collect());
    };
    group.only(&["steps"])?;
    let steps = needed(&group, "steps", group.texts("steps")?)?;
    match (has_disturbance, steps.iter().any(|step| step == DISTURBANCE)) {
        (true, false) => {
            let rule = "lacks `disturbance`, so that no [[disturbance]] would be taken off";
            Err(group.refuse("steps", rule, "name `disturbance` behind `ground`, or take [[disturbance]] away"))
        }
        (false, true) => {
            let rule = "names `disturbance`, and there is no [[disturbance]] to be taken off";
            Err(group.refuse("steps", rule, "state its column and vector in [[disturbance]], or take the step away"))
        }
        _ => Ok(steps),
    }
}

/// Stretches of one list must not overlap.
fn apart(group: &Group<'_>, key: &str, spans: &[Span]) -> Result<(), Finding> {
    match overlap(spans.iter().map(|span| (*span, None))) {
        Some(_) => {
            Err(group.refuse(key, "has intervals that overlap", "intervals are half-open, [from, to), one for every moment"))
        }
        None => Ok(()),
    }
}

/// Temperatures, °C, with the reason.
type Extended = Option<([f64; 2], String)>;

fn outside(group: &Group<'_>) -> Result<(OutsideTemperature, Extended, f64), Finding> {
    group.only(&["outside", "extended_degc", "reason", "smooth_s"])?;
    let outside = match group.text("outside")?.as_deref() {
        None | Some("null") => OutsideTemperature::Null,
        Some("flag") => OutsideTemperature::Flag,
        Some(_) => return Err(group.refuse("outside", "must be \"null\" or \"flag\"", "correct the value")),
    };
    let extended = match group.numbers("extended_degc")? {
        None if outside == OutsideTemperature::Flag => return Err(group.missing("extended_degc")),
        None => None,
        Some(_) if outside == OutsideTemperature::Null => {
            let rule = "extends nothing while vectors outside become null";
            return Err(group.refuse("extended_degc", rule, "state outside = \"flag\" beside it, or take it away"));
        }
        Some(range) => match range[..] {
            [low, high] if low < high => Some(([low, high], needed(group, "reason", group.text("reason")?)?)),
            _ => return Err(group.refuse("extended_degc", "must be two temperatures that rise", "write [-140, 70]")),
        },
    };
    Ok((outside, extended, at_least_zero(group, "smooth_s", 0.0)?))
}

fn time_rule(group: &Group<'_>) -> Result<(Option<TimeColumn>, f64), Finding> {
    group.only(&["primary", "tolerance_s"])?;
    let primary = match group.text("primary")? {
        None => None,
        Some(name) => {
            let known = TimeColumn::ALL.into_iter().find(|column| column.name() == name);
            let wrong = || group.refuse("primary", "is no column of times", "name time_tt2000, time_utc or time_obt");
            Some(known.ok_or_else(wrong)?)
        }
    };
    Ok((primary, at_least_zero(group, "tolerance_s", 1e-3)?))
}

fn edited_rule(group: &Group<'_>) -> Result<(u8, Option<String>), Finding> {
    group.only(&["sensor_axes", "quality_reject_mask", "sid"])?;
    if group.text("sensor_axes")?.is_some_and(|axes| axes != "uvw") {
        return Err(group.refuse("sensor_axes", "must be \"uvw\"", "telemetry is in the axes of the sensor"));
    }
    let mask = group.whole("quality_reject_mask")?.unwrap_or(7);
    let mask =
        u8::try_from(mask).map_err(|_| group.refuse("quality_reject_mask", "must be 0 to 255", "quality has eight bits"))?;
    Ok((mask, group.text("sid")?))
}

fn mode(group: &Group<'_>, sid: String) -> Result<Mode, Finding> {
    // The name is for people; the telemetry and the other keys name the mode by its `sid`.
    group.only(&["sid", "name", "packet_s", "primary", "secondary", "lap_lines_hz", "from", "to"])?;
    group.text("name")?;
    let rate = |key: &str| -> Result<Option<Rate>, Finding> {
        let Some(own) = group.group(key)? else { return Ok(None) };
        own.only(&["rate_hz", "shift_s"])?;
        let rate_hz = positive(&own, "rate_hz", own.number("rate_hz")?)?;
        let shift_s = own.number("shift_s")?;
        if shift_s.is_some_and(|s| s.abs() > LONGEST_SHIFT_S) {
            return Err(own.refuse("shift_s", "is longer than 1800 s", "days are read so far beyond their ends"));
        }
        // A mode whose rate is not known yet may stand in a configuration; vectors that need it are refused.
        Ok(rate_hz.map(|rate_hz| Rate { rate_hz, shift_ns: shift_s.map(ns) }))
    };
    let lines_hz = group.numbers("lap_lines_hz")?.unwrap_or_default();
    if lines_hz.iter().any(|f| *f <= 0.0) {
        return Err(group.refuse("lap_lines_hz", "must be positive frequencies", "correct the value"));
    }
    let packet_s = needed(group, "packet_s", positive(group, "packet_s", group.number("packet_s")?)?)?;
    Ok(Mode { sid, packet_s, rates: [rate("primary")?, rate("secondary")?], lines_hz })
}

fn disturbance(group: &Group<'_>) -> Result<Disturbance, Finding> {
    group.only(&["column", "vector_nt_per_unit"])?;
    let vector = needed(group, "vector_nt_per_unit", group.three("vector_nt_per_unit")?)?;
    Ok(Disturbance { column: needed(group, "column", group.text("column")?)?, vector_nt_per_unit: Vector3::from(vector) })
}
