//! The reader of twins.

use super::{
    Approach, Body, BoxTwin, Climate, FacilityTwin, Heater, Jump, Phase, Residual, RunTwin, SensorTwin, Thermistor, Twin,
};
use crate::data::error::Finding;
use crate::data::run::Location;
use crate::data::start::NoStart;
use crate::files::campaign::file::{self, CampaignFile};
use crate::files::mag::{self, Programme};
use crate::files::source::read_whole;
use crate::files::text::{Group, Keys, decode};
use crate::model::coil::Coil;
use crate::model::position::Position;
use crate::model::response::{RESPONSES, Response};
use crate::model::thermal::ThermalSensor;
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::path::Path;

const ROOT: [&str; 9] = ["seed", "campaign", "place", "sensor", "facility", "box", "temperatures", "run", "electronics"];
const ELECTRONICS: [&str; 6] =
    ["sample_rate_hz", "range_ent", "resolution_ent", "packet_samples", "packet_loss", "flicker_lowest_hz"];
const SENSOR: [&str; 11] = [
    "name",
    "mode",
    "location",
    "real_sample_rate_hz",
    "response",
    "response_parameters",
    "rotation_deg",
    "rotation_per_k_deg",
    "white_ent",
    "flicker_ent",
    "resolution_ent",
];
/// Polynomials of a sensor, named as in parameter files, in four groups of x, y, z (or xy, xz, yz).
const POLYNOMIALS: [[&str; 3]; 4] = [
    ["sigma_x", "sigma_y", "sigma_z"],
    ["xi_xy", "xi_xz", "xi_yz"],
    ["b_off_x", "b_off_y", "b_off_z"],
    ["f_3db_x", "f_3db_y", "f_3db_z"],
];
const FACILITY: [&str; 19] = [
    "field_source",
    "coil_correction",
    "earthfield_compensation",
    "scale_nt_per_eu",
    "scale_per_k",
    "rack_scale_per_k",
    "offset_nt",
    "offset_nt_per_k",
    "rack_offset_nt_per_k",
    "angles_deg",
    "reference_degc",
    "rack_reference_degc",
    "setting_scatter_nt",
    "residual",
    "daily_nt",
    "irregular_nt",
    "leakage",
    "variometer_noise_nt",
    "scalar_noise_nt",
];
const PHASE: [&str; 4] = ["from", "target_degc", "rate_k_per_h", "time_constant_h"];
const HEATER: [&str; 3] = ["field_nt", "longest_s", "delay_s"];
const THERMISTOR: [&str; 6] = ["channel", "of", "time_constant_s", "offset_k", "noise_k", "jump"];
const RUN: [&str; 10] =
    ["start", "programme", "sensor", "mode", "position", "pause_s", "longest_s", "sample_rate_hz", "repeat", "field_factor"];
/// Default lowest frequency of the 1/f noise, Hz: a period of about a day.
const LOWEST_HZ: f64 = 1e-5;

/// Reads a twin, and the field programmes that stand beside it; warnings go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<Twin, Finding> {
    let (bytes, _) = read_whole(path)?;
    let text = decode(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes)).into_owned();
    let mut programmes: Vec<(String, Programme)> = Vec::new();
    let folder = path.parent().unwrap_or(path);
    parse(&path.display().to_string(), text, findings, |name, findings| {
        if let Some(index) = programmes.iter().position(|(known, _)| known == name) {
            return Ok(index);
        }
        programmes.push((name.to_owned(), mag::read(&folder.join(name), findings)?));
        Ok(programmes.len() - 1)
    })
    .map(|twin| Twin { programmes: programmes.into_iter().map(|(_, programme)| programme).collect(), ..twin })
    .and_then(|twin| {
        within_limits(&path.display().to_string(), &twin)?;
        Ok(twin)
    })
}

/// Longest run, s: a year. A longer one is a slip in a number.
const LONGEST_RUN_S: f64 = 366.0 * 86_400.0;
/// Most samples of a run: files of half a terabyte.
const MOST_SAMPLES: f64 = 1e10;
/// Most settings of a run, and most readings of a thermistor: what is held in memory.
const MOST_SETTINGS: f64 = 1e6;
const MOST_SLOW: f64 = 1e7;

/// Refuses runs of a size that no measurement has, before anything is made of them.
fn within_limits(file: &str, twin: &Twin) -> Result<(), Finding> {
    for run in &twin.runs {
        let Some(programme) = twin.programmes.get(run.programme) else { continue };
        let settings = f64::from(run.repeat) * programme.steps.len() as f64;
        let longest_s = run.longest_s.unwrap_or(f64::INFINITY);
        let lasts_s = (f64::from(run.repeat) * programme.lasts_s(run.pause_s)).min(longest_s + run.pause_s);
        let nominal_hz = run.nominal_rate_hz.or_else(|| twin.sensors.get(run.sensor).map(|s| s.nominal_rate_hz));
        let rate_hz = twin.sensors.get(run.sensor).map_or(0.0, |s| s.rate_hz).max(nominal_hz.unwrap_or(0.0));
        for (value, most, what, keys) in [
            (lasts_s, LONGEST_RUN_S, "seconds", "`duration`, `pause_s` and `repeat`"),
            (settings.min(longest_s / programme.shortest_s()), MOST_SETTINGS, "settings", "`repeat`"),
            (lasts_s * rate_hz, MOST_SAMPLES, "samples", "`sample_rate_hz` and `real_sample_rate_hz`"),
            (lasts_s / twin.slow_interval_s, MOST_SLOW, "readings of every temperature", "`interval_s`"),
        ] {
            if value > most {
                let rule = format!("the run {} would have {value:.3e} {what}, more than {most:.0e}", run.id);
                return Err(Finding::error(file, rule, format!("correct {keys}")));
            }
        }
    }
    Ok(())
}

/// As [`read`], from text that is in memory; `programme` gives the index of a programme by its file name.
///
/// # Errors
/// The first fault of the file, with its place.
fn parse(
    file: &str,
    text: String,
    findings: &mut Vec<Finding>,
    mut programme: impl FnMut(&str, &mut Vec<Finding>) -> Result<usize, Finding>,
) -> Result<Twin, Finding> {
    let campaign_toml = campaign_text(&text);
    let keys = Keys::parse(file, 1, text)?;
    let root = keys.root();
    findings.extend(root.unknown(&ROOT));
    let campaign_group = root.group("campaign")?.ok_or_else(|| root.missing("campaign"))?;
    let campaign = file::parse(&campaign_group, findings)?;
    let sensors = sensors(&root, findings)?;
    let facility = facility(&root, findings)?;
    let places = places(&root, &campaign, findings)?;
    let (coil_climate, rack_climate, thermistors, slow_interval_s) = temperatures(&root, findings)?;
    let mut runs = Vec::new();
    for group in root.groups("run")? {
        findings.extend(group.unknown(&RUN));
        let start = time(&group, "start")?.ok_or_else(|| group.missing("start"))?;
        let name = group.text("programme")?.ok_or_else(|| group.missing("programme"))?;
        let (sensor, mode) = (group.text("sensor")?.unwrap_or_default(), group.text("mode")?.unwrap_or_default());
        let position = group.whole("position")?;
        if position.is_some_and(|id| !places.contains_key(&id)) {
            return Err(group.refuse("position", "is not in the position table", "add [[campaign.position]]"));
        }
        let id = jiff::fmt::strtime::format("%y-%m-%d_%H-%M-%S", start)
            .map_err(|_| group.refuse("start", "is not a time that a run id can tell", "use the years 1970 to 2069"))?;
        // A sensor that is described at one place only is the same at the other one.
        let described = |location: Option<Location>| {
            let here = |s: &SensorTwin| location.is_none_or(|l| l == s.location);
            sensors.iter().position(|s| s.name == sensor && s.mode == mode && here(s))
        };
        let location = campaign.instructions.location(&id);
        runs.push(RunTwin {
            id,
            start,
            programme: programme(&name, findings)?,
            sensor: described(Some(location)).or_else(|| described(None)).ok_or_else(|| {
                group.refuse("sensor", "and `mode` are not those of a [[sensor]]", "use the name and mode of one of them")
            })?,
            position,
            pause_s: not_negative(&group, "pause_s")?.unwrap_or(0.0),
            longest_s: positive(&group, "longest_s")?,
            nominal_rate_hz: positive(&group, "sample_rate_hz")?,
            repeat: group.whole("repeat")?.unwrap_or(1).max(1),
            field_factor: positive(&group, "field_factor")?.unwrap_or(1.0),
        });
    }
    if let Some(run) = campaign.instructions.at.keys().find(|id| runs.iter().all(|run| run.id != **id)) {
        let rule = format!("`campaign.at.runs` name the run {run}, which is none of the twin");
        return Err(Finding::error(file, rule, "correct its id: its start as YY-MM-DD_hh-mm-ss").found(run.as_bytes()));
    }
    runs.sort_by_key(|run| run.start);
    if let Some(pair) = runs.windows(2).find(|pair| pair[0].id == pair[1].id) {
        let rule = format!("two runs start at {}", pair[0].start);
        return Err(Finding::error(file, rule, "give every run a start of its own"));
    }
    if runs.is_empty() {
        return Err(root.missing("run"));
    }
    Ok(Twin {
        seed: root.whole("seed")?.unwrap_or(1).into(),
        campaign_toml,
        campaign,
        places,
        sensors,
        facility,
        thermal_box: thermal_box(&root, findings)?,
        coil_climate,
        rack_climate,
        thermistors,
        slow_interval_s,
        programmes: Vec::new(),
        runs,
    })
}

/// The table `[campaign]` as a file of its own, comments included.
fn campaign_text(text: &str) -> String {
    let mut document = toml_edit::DocumentMut::new();
    if let Ok(whole) = text.parse::<toml_edit::DocumentMut>()
        && let Some(table) = whole.get("campaign").and_then(|item| item.as_table())
    {
        *document.as_table_mut() = table.clone();
    }
    document.to_string()
}

fn time(group: &Group, key: &str) -> Result<Option<Timestamp>, Finding> {
    let Some(text) = group.text(key)? else { return Ok(None) };
    text.parse().map(Some).map_err(|_| group.refuse(key, &NoStart.to_string(), NoStart::REMEDY))
}

fn positive(group: &Group, key: &str) -> Result<Option<f64>, Finding> {
    match group.number(key)? {
        Some(value) if value <= 0.0 => Err(group.refuse(key, "must be positive", "correct the value")),
        value => Ok(value),
    }
}

fn not_negative(group: &Group, key: &str) -> Result<Option<f64>, Finding> {
    match group.number(key)? {
        Some(value) if value < 0.0 => Err(group.refuse(key, "must not be negative", "correct the value")),
        value => Ok(value),
    }
}

/// Three numbers that are not negative, zero where nothing is said.
fn three_sizes(group: &Group, key: &str) -> Result<[f64; 3], Finding> {
    match group.three(key)?.unwrap_or_default() {
        values if values.iter().all(|v| *v >= 0.0) => Ok(values),
        _ => Err(group.refuse(key, "must not be negative", "correct the values")),
    }
}

fn places(
    root: &Group,
    campaign: &CampaignFile,
    findings: &mut Vec<Finding>,
) -> Result<BTreeMap<u32, (Position, [f64; 3])>, Finding> {
    let nominal = &campaign.instructions.positions;
    let mut places: BTreeMap<u32, (Position, [f64; 3])> = nominal.iter().map(|(id, p)| (*id, (*p, [0.0; 3]))).collect();
    for group in root.groups("place")? {
        findings.extend(group.unknown(&["position", "rotation_deg"]));
        let id = group.whole("position")?.ok_or_else(|| group.missing("position"))?;
        let rotation_deg = group.three("rotation_deg")?.unwrap_or([0.0; 3]);
        let place = places
            .get_mut(&id)
            .ok_or_else(|| group.refuse("position", "is not in the position table", "add [[campaign.position]]"))?;
        place.1 = rotation_deg;
    }
    Ok(places)
}

fn sensors(root: &Group, findings: &mut Vec<Finding>) -> Result<Vec<SensorTwin>, Finding> {
    let electronics = root.group("electronics")?.ok_or_else(|| root.missing("electronics"))?;
    findings.extend(electronics.unknown(&ELECTRONICS));
    let required = |key: &str| positive(&electronics, key)?.ok_or_else(|| electronics.missing(key));
    let (nominal_rate_hz, range_ent) = (required("sample_rate_hz")?, required("range_ent")?);
    let resolution_ent = required("resolution_ent")?;
    let packet_loss = not_negative(&electronics, "packet_loss")?.unwrap_or(0.0);
    if packet_loss >= 1.0 {
        return Err(electronics.refuse("packet_loss", "must be a probability below 1", "correct the value"));
    }
    let packet_samples = electronics.whole("packet_samples")?.unwrap_or(1).max(1);
    let flicker_lowest_hz = positive(&electronics, "flicker_lowest_hz")?.unwrap_or(LOWEST_HZ);
    let mut sensors: Vec<SensorTwin> = Vec::new();
    for group in root.groups("sensor")? {
        let known: Vec<&str> = SENSOR.iter().copied().chain(POLYNOMIALS.into_iter().flatten()).collect();
        findings.extend(group.unknown(&known));
        let (name, mode) = (group.text("name")?.ok_or_else(|| group.missing("name"))?, group.text("mode")?.unwrap_or_default());
        let location = file::location(&group)?;
        if sensors.iter().any(|s| s.name == name && s.mode == mode && s.location == location) {
            let remedy = "describe every sensor and mode once at every location";
            return Err(group.refuse("mode", "stands twice for this sensor", remedy));
        }
        sensors.push(SensorTwin {
            name,
            mode,
            location,
            model: thermal_sensor(&group)?,
            rotation_deg: group.three("rotation_deg")?.unwrap_or([0.0; 3]),
            rotation_per_k_deg: group.three("rotation_per_k_deg")?.unwrap_or([0.0; 3]),
            nominal_rate_hz,
            rate_hz: positive(&group, "real_sample_rate_hz")?.unwrap_or(nominal_rate_hz),
            range_ent,
            resolution_ent: positive(&group, "resolution_ent")?.unwrap_or(resolution_ent),
            white_ent: three_sizes(&group, "white_ent")?,
            flicker_ent: three_sizes(&group, "flicker_ent")?,
            flicker_lowest_hz,
            packet_samples,
            packet_loss,
        });
    }
    if sensors.is_empty() {
        return Err(root.missing("sensor"));
    }
    Ok(sensors)
}

fn thermal_sensor(group: &Group) -> Result<ThermalSensor, Finding> {
    let mut polynomials: [[Vec<f64>; 3]; 4] = Default::default();
    for (names, list) in POLYNOMIALS.iter().zip(&mut polynomials) {
        for (name, coefficients) in names.iter().zip(list) {
            *coefficients = group.numbers(name)?.filter(|c| !c.is_empty()).ok_or_else(|| group.missing(name))?;
        }
    }
    let [sigma, xi_deg, b_off_ent, f_3db_hz] = polynomials;
    let name = group.text("response")?.ok_or_else(|| group.missing("response"))?;
    let response = Response::named(&name).ok_or_else(|| {
        let names: Vec<&str> = RESPONSES.iter().map(|r| r.name).collect();
        group.refuse("response", "is not a response", &format!("use one of {}", names.join(", ")))
    })?;
    let response_parameters = group.numbers("response_parameters")?.unwrap_or_else(|| vec![1.0; response.parameters().len()]);
    if response.corner_hz(&response_parameters).is_none() {
        let names: Vec<String> = response.parameters().iter().map(|p| format!("{} in {}", p.name, p.unit)).collect();
        return Err(group.refuse("response_parameters", "are not those of the response", &format!("write {}", names.join(", "))));
    }
    Ok(ThermalSensor { sigma, xi_deg, b_off_ent, f_3db_hz, response, response_parameters })
}

fn facility(root: &Group, findings: &mut Vec<Finding>) -> Result<FacilityTwin, Finding> {
    let group = root.group("facility")?.ok_or_else(|| root.missing("facility"))?;
    findings.extend(group.unknown(&FACILITY));
    let ideal = Coil::IDEAL;
    let coil = Coil {
        scale_nt_per_eu: group.three("scale_nt_per_eu")?.unwrap_or(ideal.scale_nt_per_eu),
        scale_per_k: group.three("scale_per_k")?.unwrap_or([0.0; 3]),
        rack_scale_per_k: group.three("rack_scale_per_k")?.unwrap_or([0.0; 3]),
        offset_nt: group.three("offset_nt")?.unwrap_or([0.0; 3]),
        offset_nt_per_k: group.three("offset_nt_per_k")?.unwrap_or([0.0; 3]),
        rack_offset_nt_per_k: group.three("rack_offset_nt_per_k")?.unwrap_or([0.0; 3]),
        angles_deg: group.three("angles_deg")?.unwrap_or(ideal.angles_deg),
        reference_degc: group.number("reference_degc")?.unwrap_or(ideal.reference_degc),
        rack_reference_degc: group.number("rack_reference_degc")?.unwrap_or(ideal.rack_reference_degc),
    };
    if coil.axes().is_none() {
        return Err(group.refuse("angles_deg", "are not angles between three axes", "write XY, XZ, YZ, near 90"));
    }
    let mut residual = Vec::new();
    for entry in group.groups("residual")? {
        findings.extend(entry.unknown(&["from", "field_nt"]));
        let from = time(&entry, "from")?.ok_or_else(|| entry.missing("from"))?;
        residual.push(Residual { from, field_nt: entry.three("field_nt")?.unwrap_or([0.0; 3]) });
    }
    residual.sort_by_key(|r| r.from);
    Ok(FacilityTwin {
        field_source: group.text("field_source")?.unwrap_or_default(),
        coil_correction: group.truth("coil_correction")?,
        compensation: group.texts("earthfield_compensation")?.unwrap_or_default(),
        coil,
        setting_scatter_nt: three_sizes(&group, "setting_scatter_nt")?,
        residual,
        daily_nt: three_sizes(&group, "daily_nt")?,
        irregular_nt: three_sizes(&group, "irregular_nt")?,
        leakage: group.three("leakage")?.unwrap_or([0.0; 3]),
        variometer_noise_nt: not_negative(&group, "variometer_noise_nt")?.unwrap_or(0.0),
        scalar_noise_nt: not_negative(&group, "scalar_noise_nt")?.unwrap_or(0.0),
    })
}

fn thermal_box(root: &Group, findings: &mut Vec<Finding>) -> Result<BoxTwin, Finding> {
    let group = root.group("box")?.ok_or_else(|| root.missing("box"))?;
    findings.extend(group.unknown(&["start_degc", "sensor_time_constant_s", "phase", "heater"]));
    let mut phases = Vec::new();
    for entry in group.groups("phase")? {
        findings.extend(entry.unknown(&PHASE));
        let approach = match (positive(&entry, "rate_k_per_h")?, positive(&entry, "time_constant_h")?) {
            (Some(rate), None) => Approach::Rate(rate),
            (None, Some(time)) => Approach::Time(time),
            _ => return Err(entry.missing("rate_k_per_h` or `time_constant_h")),
        };
        phases.push(Phase {
            from: time(&entry, "from")?.ok_or_else(|| entry.missing("from"))?,
            target_degc: entry.number("target_degc")?.ok_or_else(|| entry.missing("target_degc"))?,
            approach,
        });
    }
    phases.sort_by_key(|p| p.from);
    let heater = match group.group("heater")? {
        Some(entry) => {
            findings.extend(entry.unknown(&HEATER));
            Some(Heater {
                field_nt: entry.three("field_nt")?.unwrap_or([0.0; 3]),
                longest_s: positive(&entry, "longest_s")?.ok_or_else(|| entry.missing("longest_s"))?,
                delay_s: not_negative(&entry, "delay_s")?.unwrap_or(0.0),
            })
        }
        None => None,
    };
    Ok(BoxTwin {
        start_degc: group.number("start_degc")?.ok_or_else(|| group.missing("start_degc"))?,
        sensor_time_constant_s: not_negative(&group, "sensor_time_constant_s")?.unwrap_or(0.0),
        phases,
        heater,
    })
}

fn temperatures(root: &Group, findings: &mut Vec<Finding>) -> Result<(Climate, Climate, Vec<Thermistor>, f64), Finding> {
    let group = root.group("temperatures")?.ok_or_else(|| root.missing("temperatures"))?;
    findings.extend(group.unknown(&["interval_s", "coil", "rack", "thermistor"]));
    let climate = |key: &str, findings: &mut Vec<Finding>| -> Result<Climate, Finding> {
        let entry = group.group(key)?.ok_or_else(|| group.missing(key))?;
        findings.extend(entry.unknown(&["mean_degc", "reading", "daily_k"]));
        let mut readings = Vec::new();
        for reading in entry.groups("reading")? {
            findings.extend(reading.unknown(&["at", "degc"]));
            let at = time(&reading, "at")?.ok_or_else(|| reading.missing("at"))?;
            readings.push((at, reading.number("degc")?.ok_or_else(|| reading.missing("degc"))?));
        }
        readings.sort_by_key(|(at, _)| *at);
        let mean = entry.number("mean_degc")?.or_else(|| readings.first().map(|(_, degc)| *degc));
        Ok(Climate {
            mean_degc: mean.ok_or_else(|| entry.missing("mean_degc"))?,
            readings,
            daily_k: entry.number("daily_k")?.unwrap_or(0.0),
        })
    };
    let (coil, rack) = (climate("coil", findings)?, climate("rack", findings)?);
    let mut thermistors: Vec<Thermistor> = Vec::new();
    for entry in group.groups("thermistor")? {
        findings.extend(entry.unknown(&THERMISTOR));
        let channel = entry.text("channel")?.ok_or_else(|| entry.missing("channel"))?;
        if thermistors.iter().any(|t| t.channel == channel) {
            return Err(entry.refuse("channel", "stands twice", "give every thermistor a channel of its own"));
        }
        let name = entry.text("of")?.ok_or_else(|| entry.missing("of"))?;
        let body = Body::NAMES.iter().find(|(_, n)| *n == name).map(|(body, _)| *body).ok_or_else(|| {
            let names: Vec<&str> = Body::NAMES.iter().map(|(_, n)| *n).collect();
            entry.refuse("of", "is not a body", &format!("use one of {}", names.join(", ")))
        })?;
        let mut jumps = Vec::new();
        for jump in entry.groups("jump")? {
            findings.extend(jump.unknown(&["from", "until", "by_k"]));
            let by_k = jump.numbers("by_k")?.and_then(|v| v.try_into().ok());
            let by_k = by_k.filter(|[low, high]: &[f64; 2]| low <= high);
            jumps.push(Jump {
                from: time(&jump, "from")?.ok_or_else(|| jump.missing("from"))?,
                until: time(&jump, "until")?.ok_or_else(|| jump.missing("until"))?,
                by_k: by_k.ok_or_else(|| jump.refuse("by_k", "must be two numbers", "write the smallest and largest change"))?,
            });
        }
        thermistors.push(Thermistor {
            channel,
            of: body,
            time_constant_s: not_negative(&entry, "time_constant_s")?.unwrap_or(0.0),
            offset_k: entry.number("offset_k")?.unwrap_or(0.0),
            noise_k: not_negative(&entry, "noise_k")?.unwrap_or(0.0),
            jumps,
        });
    }
    Ok((coil, rack, thermistors, positive(&group, "interval_s")?.unwrap_or(30.0)))
}
