//! A twin in flight: what simulated telemetry is made of. `docs/reference/telemetry-twin.md` has all of its keys.

use super::SensorTwin;
use crate::data::convention::Convention;
use crate::data::error::Finding;
use crate::data::run::Location;
use crate::data::time::{LeapSeconds, Tt2000, ns};
use crate::files::flight::mission::{Boom, Jump, Mode, OffsetFrame, Rate, Span};
use crate::files::source::read_whole;
use crate::files::text::{Group, Keys, decode};
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::path::Path;

/// The key at the top that tells a twin in flight from one on ground.
const KIND: &str = "telemetry";

/// The temperature of a sensor over the hours since the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// Temperature at the start, °C.
    pub start_degc: f64,
    /// Its drift, K/h.
    pub drift_k_per_h: f64,
    /// Amplitude of its swing, K.
    pub swing_k: f64,
    /// Period of its swing, h.
    pub period_h: f64,
}

/// A sensor in flight.
#[derive(Clone, Debug)]
pub struct FlightSensor {
    /// Name in the telemetry.
    pub name: String,
    /// The sensor of the ground twin, at the centre of the coil system.
    pub twin: SensorTwin,
    /// The frame in which its field is stated.
    pub frame: Convention,
    /// Standard deviation of the white noise of a reading, enT.
    pub noise_ent: f64,
    /// `T_r = Σ T_k Uᵏ`, °C per Vᵏ.
    pub thermistor_degc: Vec<f64>,
    /// `T = T_r - T_OFF`, °C.
    pub t_off_degc: f64,
    /// Lowest and highest temperature for which the exact coefficient files hold, °C.
    pub valid_degc: [f64; 2],
    /// Its temperature.
    pub course: Course,
    /// Polynomials of the daily offset of x, y, z over the temperature, nT over °C.
    pub daily_nt: [Vec<f64>; 3],
    /// Relative scatter of their coefficients from day to day.
    pub daily_scatter: f64,
    /// Boom states.
    pub rotations: Vec<Boom>,
    /// Offsets that jump, in axes of the spacecraft.
    pub jumps: Vec<Jump>,
}

/// What becomes of packets on their way to ground: probabilities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packets {
    /// A packet is lost.
    pub lost: f64,
    /// A packet comes twice.
    pub repeated: f64,
    /// A packet comes behind the next one.
    pub swapped: f64,
    /// A vector is bad.
    pub bad_vectors: f64,
}

/// The external field in the celestial frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct External {
    /// Mean, nT.
    pub mean_nt: [f64; 3],
    /// Standard deviation of what moves, nT.
    pub scatter_nt: [f64; 3],
    /// The power density falls with the frequency to this power.
    pub slope: f64,
    /// Longest and shortest period, s.
    pub periods_s: [f64; 2],
}

/// What the spacecraft adds at the primary sensor, and how it shows at the secondary one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spacecraft {
    /// Amplitude density of its 1/f noise at 1 Hz per axis, nT/√Hz.
    pub noise_nt: [f64; 3],
    /// The noise at the secondary sensor is this matrix times that at the primary one.
    pub coupling: Matrix3<f64>,
    /// Amplitude of every fixed line of a mode, nT.
    pub line_nt: f64,
    /// Heaters, wheels and lines at the secondary sensor in units of those at the primary one.
    pub factors: [f64; 3],
}

/// The attitude: a turn at even speed.
#[derive(Clone, Debug, PartialEq)]
pub struct AttitudeTwin {
    /// Rotation vector from the spacecraft to the celestial frame at the start, degrees.
    pub start_deg: [f64; 3],
    /// Rotation vector of the turn, degrees per hour, in axes of the spacecraft.
    pub rate_deg_per_h: [f64; 3],
    /// Step of the table, s.
    pub step_s: f64,
    /// Stretches that the table lacks.
    pub holes: Vec<Span>,
}

/// The way of the spacecraft: a cubic in the hours since the start.
#[derive(Clone, Debug, PartialEq)]
pub struct OrbitTwin {
    /// Coefficients of x, y, z, km per hourᵏ, lowest first.
    pub km: [Vec<f64>; 3],
    /// Step of the table, s.
    pub step_s: f64,
}

/// A heater that switches at random.
#[derive(Clone, Debug, PartialEq)]
pub struct HeaterTwin {
    /// Name of its class.
    pub name: String,
    /// Its field at the primary sensor, nT, in axes of the spacecraft.
    pub field_nt: [f64; 3],
    /// Shortest and longest time that it is on, s.
    pub on_s: [f64; 2],
    /// Shortest and longest time between, s.
    pub off_s: [f64; 2],
}

/// A reaction wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelTwin {
    /// Rotations per second at the start.
    pub rate_hz: f64,
    /// Their drift, Hz/h.
    pub drift_hz_per_h: f64,
    /// Amplitude at the primary sensor, nT.
    pub amplitude_nt: f64,
}

/// All that a twin in flight says.
#[derive(Clone, Debug)]
pub struct TelemetryTwin {
    /// Seed of the random numbers unless the command gives another one.
    pub seed: u64,
    /// Name of the mission.
    pub mission: String,
    /// Name of the instrument.
    pub instrument: String,
    /// First and last moment of the packets.
    pub span: Span,
    /// Counts and temperatures are numbers without noise and steps.
    pub exact: bool,
    /// The truth of every so many vectors is written.
    pub truth_every: u32,
    /// Step of the housekeeping, s.
    pub hk_step_s: f64,
    /// The primary (outboard) and the secondary (inboard) sensor.
    pub sensors: [FlightSensor; 2],
    /// Modes.
    pub modes: Vec<Mode>,
    /// Stretches of modes, by their index.
    pub intervals: Vec<(Span, usize)>,
    /// Stretches without packets.
    pub gaps: Vec<Span>,
    /// What becomes of packets.
    pub packets: Packets,
    /// The celestial frame.
    pub frame: String,
    /// The field that is measured.
    pub external: External,
    /// What the spacecraft adds.
    pub spacecraft: Spacecraft,
    /// Attitude.
    pub attitude: AttitudeTwin,
    /// Orbit.
    pub orbit: OrbitTwin,
    /// Heaters.
    pub heaters: Vec<HeaterTwin>,
    /// Stretches in which heaters switch.
    pub heater_intervals: Vec<Span>,
    /// Wheels.
    pub wheels: Vec<WheelTwin>,
    /// Step of the table of wheel rates, s.
    pub wheel_step_s: f64,
    /// Half widths of stripes that level H takes off, by mode, Hz.
    pub half_width_hz: Vec<(String, f64)>,
}

fn parsed(path: &Path) -> Result<Keys, Finding> {
    let (bytes, _) = read_whole(path)?;
    let text = decode(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes)).into_owned();
    Keys::parse(&path.display().to_string(), 1, text)
}

/// Whether a file is a twin in flight.
///
/// # Errors
/// A file that cannot be read or is no TOML.
pub fn is_telemetry(path: &Path) -> Result<bool, Finding> {
    Ok(parsed(path)?.root().names().contains(&KIND))
}

/// Reads a twin in flight and the ground twin that it names; warnings of that go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<TelemetryTwin, Finding> {
    let keys = parsed(path)?;
    let root = keys.root();
    let reader = Reader { leap: LeapSeconds::default() };
    let head = root.group(KIND)?.ok_or_else(|| root.missing(KIND))?;
    let name = needed(&head, "ground_twin", head.text("ground_twin")?)?;
    let ground = super::read(&path.parent().unwrap_or(path).join(name), findings)?;
    reader.twin(&root, &head, &ground.sensors)
}

fn needed<T>(group: &Group<'_>, key: &str, value: Option<T>) -> Result<T, Finding> {
    value.ok_or_else(|| group.missing(key))
}

fn number(group: &Group<'_>, key: &str, default: f64) -> Result<f64, Finding> {
    Ok(group.number(key)?.unwrap_or(default))
}

fn not_negative(group: &Group<'_>, key: &str, default: f64) -> Result<f64, Finding> {
    let value = number(group, key, default)?;
    if value < 0.0 { Err(group.refuse(key, "must not be negative", "correct the value")) } else { Ok(value) }
}

fn positive(group: &Group<'_>, key: &str, default: Option<f64>) -> Result<f64, Finding> {
    let value = needed(group, key, group.number(key)?.or(default))?;
    if value <= 0.0 { Err(group.refuse(key, "must be positive", "correct the value")) } else { Ok(value) }
}

fn probability(group: &Group<'_>, key: &str) -> Result<f64, Finding> {
    let value = not_negative(group, key, 0.0)?;
    if value >= 1.0 { Err(group.refuse(key, "must be a probability below 1", "correct the value")) } else { Ok(value) }
}

fn rising(group: &Group<'_>, key: &str, default: Option<[f64; 2]>) -> Result<[f64; 2], Finding> {
    let pair = match group.numbers(key)? {
        None => needed(group, key, default)?,
        Some(list) => list.try_into().map_err(|_| group.refuse(key, "must be two numbers", "write the lower one first"))?,
    };
    if pair[0] < pair[1] { Ok(pair) } else { Err(group.refuse(key, "must rise", "write the lower one first")) }
}

/// A table below another one, or an empty place for its defaults.
fn section<'a>(root: &Group<'a>, key: &str, known: &[&str]) -> Result<Group<'a>, Finding> {
    let group = needed(root, key, root.group(key)?)?;
    group.only(known)?;
    Ok(group)
}

struct Reader {
    leap: LeapSeconds,
}

impl Reader {
    fn time(&self, group: &Group<'_>, key: &str) -> Result<Tt2000, Finding> {
        let text = needed(group, key, group.text(key)?)?;
        self.leap.parse(&text).ok_or_else(|| group.refuse(key, "is no time", "write UTC as 2015-06-30T23:00:00Z"))
    }

    fn span(&self, group: &Group<'_>) -> Result<Span, Finding> {
        let span = Span { from: self.time(group, "from")?, to: self.time(group, "to")? };
        if span.from < span.to {
            return Ok(span);
        }
        Err(group.refuse("to", "must be after `from`", "intervals are half-open, [from, to)"))
    }

    fn spans(&self, root: &Group<'_>, key: &str) -> Result<Vec<Span>, Finding> {
        let mut list = Vec::new();
        for group in root.groups(key)? {
            group.only(&["from", "to"])?;
            list.push(self.span(&group)?);
        }
        list.sort_unstable();
        if list.windows(2).any(|pair| pair[0].meets(&pair[1])) {
            return Err(root.refuse(key, "has intervals that overlap", "intervals are half-open, [from, to)"));
        }
        Ok(list)
    }

    fn twin(&self, root: &Group<'_>, head: &Group<'_>, ground: &[SensorTwin]) -> Result<TelemetryTwin, Finding> {
        root.only(&[
            KIND,
            "sensor",
            "mode",
            "interval",
            "gap",
            "packets",
            "external",
            "spacecraft",
            "attitude",
            "orbit",
            "heaters",
            "wheels",
        ])?;
        head.only(&["seed", "mission", "instrument", "from", "to", "ground_twin", "exact", "truth_every", "hk_step_s", "frame"])?;
        let sensors = root.groups("sensor")?.iter().map(|group| self.sensor(group, ground)).collect::<Result<Vec<_>, _>>()?;
        let count = sensors.len();
        let sensors: [FlightSensor; 2] = sensors.try_into().map_err(|_| {
            root.refuse("sensor", &format!("stands {count} times"), "describe two sensors, the primary one first")
        })?;
        if sensors[0].name == sensors[1].name {
            return Err(root.refuse("sensor", "has one name twice", "give the sensors different names"));
        }
        let modes = root.groups("mode")?.iter().map(mode).collect::<Result<Vec<_>, _>>()?;
        let span = self.span(head)?;
        let mut intervals = Vec::new();
        for group in root.groups("interval")? {
            group.only(&["sid", "from", "to"])?;
            let sid = needed(&group, "sid", group.text("sid")?)?;
            let index = modes.iter().position(|m| m.sid == sid);
            let index = index.ok_or_else(|| group.refuse("sid", "is not described", "add it as [[mode]]"))?;
            intervals.push((self.span(&group)?, index));
        }
        intervals.sort_unstable();
        if intervals.is_empty() {
            return Err(root.missing("interval"));
        }
        if intervals.windows(2).any(|pair| pair[0].0.meets(&pair[1].0)) {
            return Err(root.refuse("interval", "has intervals that overlap", "the instrument is in one mode at a time"));
        }
        if intervals.iter().any(|(own, _)| own.from < span.from || own.to > span.to) {
            let remedy = "shorten it, or change `from` and `to` of [telemetry]";
            return Err(root.refuse("interval", "reaches beyond the telemetry", remedy));
        }
        let packets = section(root, "packets", &["lost", "repeated", "swapped", "bad_vectors"])?;
        let (wheels, wheel_step_s, half_width_hz) = wheels(root, &modes)?;
        let (heaters, heater_intervals) = self.heaters(root)?;
        let truth_every = head.whole("truth_every")?.unwrap_or(1);
        if truth_every == 0 {
            return Err(head.refuse("truth_every", "must be 1 or more", "write 1 for all vectors"));
        }
        Ok(TelemetryTwin {
            seed: u64::from(head.whole("seed")?.unwrap_or(1)),
            mission: needed(head, "mission", head.text("mission")?)?,
            instrument: needed(head, "instrument", head.text("instrument")?)?,
            frame: needed(head, "frame", head.text("frame")?)?,
            span,
            exact: head.truth("exact")?.unwrap_or(false),
            truth_every,
            hk_step_s: positive(head, "hk_step_s", Some(64.0))?,
            sensors,
            modes,
            intervals,
            gaps: self.spans(root, "gap")?,
            packets: Packets {
                lost: probability(&packets, "lost")?,
                repeated: probability(&packets, "repeated")?,
                swapped: probability(&packets, "swapped")?,
                bad_vectors: probability(&packets, "bad_vectors")?,
            },
            external: external(root)?,
            spacecraft: spacecraft(root)?,
            attitude: self.attitude(root)?,
            orbit: orbit(root)?,
            heaters,
            heater_intervals,
            wheels,
            wheel_step_s,
            half_width_hz,
        })
    }

    fn sensor(&self, group: &Group<'_>, ground: &[SensorTwin]) -> Result<FlightSensor, Finding> {
        group.only(&[
            "name",
            "ground_sensor",
            "ground_mode",
            "frame",
            "noise_ent",
            "thermistor_degc",
            "t_off_degc",
            "valid_degc",
            "temperature",
            "daily_x",
            "daily_y",
            "daily_z",
            "daily_scatter",
            "rotation",
            "jump",
        ])?;
        let name = needed(group, "name", group.text("name")?)?;
        let stated = group.text("ground_sensor")?.unwrap_or_else(|| name.clone());
        let mode = group.text("ground_mode")?;
        let fits = |s: &&SensorTwin| s.name == stated && mode.as_ref().is_none_or(|m| *m == s.mode);
        // A sensor that is described at one place is the same at the other.
        let at_centre = ground.iter().filter(fits).find(|s| s.location == Location::Centre);
        let twin = at_centre.or_else(|| ground.iter().find(fits)).cloned();
        let twin =
            twin.ok_or_else(|| group.refuse("ground_sensor", "is not in the ground twin", "name one of its [[sensor]]"))?;
        let frame = group.text("frame")?.unwrap_or_else(|| "bepicolombo".to_owned());
        let frame = Convention::from_name(&frame)
            .ok_or_else(|| group.refuse("frame", "must be \"rosetta\" or \"bepicolombo\"", "see docs/mathematics.md"))?;
        let thermistor_degc = needed(group, "thermistor_degc", group.numbers("thermistor_degc")?)?;
        if thermistor_degc.len() != 4 {
            return Err(group.refuse("thermistor_degc", "must be four numbers", "write a cubic in V, lowest order first"));
        }
        let temperature = section(group, "temperature", &["start_degc", "drift_k_per_h", "swing_k", "period_h"])?;
        let daily = |key: &str| -> Result<Vec<f64>, Finding> {
            let list = group.numbers(key)?.unwrap_or_else(|| vec![0.0]);
            if (1..=6).contains(&list.len()) {
                return Ok(list);
            }
            Err(group.refuse(key, "must have one to six coefficients", "write them lowest order first"))
        };
        let mut rotations = Vec::new();
        for state in group.groups("rotation")? {
            state.only(&["boom", "from", "to", "turn_deg"])?;
            let turn = Vector3::from(needed(&state, "turn_deg", state.three("turn_deg")?)?.map(f64::to_radians));
            let uvw_to_sc: Matrix3<f64> = Rotation3::new(turn).into_inner();
            rotations.push(Boom { boom: needed(&state, "boom", state.text("boom")?)?, span: self.span(&state)?, uvw_to_sc });
        }
        if rotations.is_empty() {
            return Err(group.missing("rotation"));
        }
        let mut jumps = Vec::new();
        for jump in group.groups("jump")? {
            jump.only(&["from", "to", "field_nt"])?;
            let subtract_nt = Vector3::from(needed(&jump, "field_nt", jump.three("field_nt")?)?);
            jumps.push(Jump { span: self.span(&jump)?, range: None, frame: OffsetFrame::Sc, subtract_nt });
        }
        Ok(FlightSensor {
            frame,
            noise_ent: not_negative(group, "noise_ent", 0.0)?,
            thermistor_degc,
            t_off_degc: number(group, "t_off_degc", 0.0)?,
            valid_degc: rising(group, "valid_degc", Some([-100.0, 100.0]))?,
            course: Course {
                start_degc: needed(&temperature, "start_degc", temperature.number("start_degc")?)?,
                drift_k_per_h: number(&temperature, "drift_k_per_h", 0.0)?,
                swing_k: number(&temperature, "swing_k", 0.0)?,
                period_h: positive(&temperature, "period_h", Some(24.0))?,
            },
            daily_nt: [daily("daily_x")?, daily("daily_y")?, daily("daily_z")?],
            daily_scatter: not_negative(group, "daily_scatter", 0.0)?,
            rotations,
            jumps,
            name,
            twin,
        })
    }

    fn attitude(&self, root: &Group<'_>) -> Result<AttitudeTwin, Finding> {
        let group = section(root, "attitude", &["start_deg", "rate_deg_per_h", "step_s", "hole"])?;
        Ok(AttitudeTwin {
            start_deg: group.three("start_deg")?.unwrap_or_default(),
            rate_deg_per_h: group.three("rate_deg_per_h")?.unwrap_or_default(),
            step_s: positive(&group, "step_s", Some(10.0))?,
            holes: self.spans(&group, "hole")?,
        })
    }

    fn heaters(&self, root: &Group<'_>) -> Result<(Vec<HeaterTwin>, Vec<Span>), Finding> {
        let Some(group) = root.group("heaters")? else { return Ok((Vec::new(), Vec::new())) };
        group.only(&["class", "interval"])?;
        let mut list = Vec::new();
        for class in group.groups("class")? {
            class.only(&["name", "field_nt", "on_s", "off_s"])?;
            list.push(HeaterTwin {
                name: needed(&class, "name", class.text("name")?)?,
                field_nt: needed(&class, "field_nt", class.three("field_nt")?)?,
                on_s: rising(&class, "on_s", None)?,
                off_s: rising(&class, "off_s", None)?,
            });
            if list.last().is_some_and(|h| h.on_s[0] <= 0.0 || h.off_s[0] <= 0.0) {
                return Err(class.refuse("on_s", "and `off_s` must be positive", "correct the values"));
            }
        }
        if list.is_empty() {
            return Err(group.missing("class"));
        }
        Ok((list, self.spans(&group, "interval")?))
    }
}

fn mode(group: &Group<'_>) -> Result<Mode, Finding> {
    group.only(&["sid", "packet_s", "primary", "secondary", "lines_hz"])?;
    let rate = |key: &str| -> Result<Option<Rate>, Finding> {
        let own = section(group, key, &["rate_hz", "shift_s"])?;
        let shift_s = needed(&own, "shift_s", own.number("shift_s")?)?;
        Ok(Some(Rate { rate_hz: positive(&own, "rate_hz", None)?, shift_ns: Some(ns(shift_s)) }))
    };
    let lines_hz = group.numbers("lines_hz")?.unwrap_or_default();
    if lines_hz.iter().any(|f| *f <= 0.0) {
        return Err(group.refuse("lines_hz", "must be positive frequencies", "correct the value"));
    }
    Ok(Mode {
        sid: needed(group, "sid", group.text("sid")?)?,
        packet_s: positive(group, "packet_s", None)?,
        rates: [rate("primary")?, rate("secondary")?],
        lines_hz,
    })
}

fn external(root: &Group<'_>) -> Result<External, Finding> {
    let group = section(root, "external", &["mean_nt", "scatter_nt", "slope", "periods_s"])?;
    let periods_s = rising(&group, "periods_s", Some([20.0, 7200.0]))?;
    if periods_s[0] <= 0.0 {
        return Err(group.refuse("periods_s", "must be positive", "correct the value"));
    }
    Ok(External {
        mean_nt: group.three("mean_nt")?.unwrap_or_default(),
        scatter_nt: group.three("scatter_nt")?.unwrap_or_default(),
        slope: number(&group, "slope", 5.0 / 3.0)?,
        periods_s,
    })
}

fn spacecraft(root: &Group<'_>) -> Result<Spacecraft, Finding> {
    let known = ["noise_nt", "coupling", "line_nt", "heater_factor", "wheel_factor", "line_factor"];
    let group = section(root, "spacecraft", &known)?;
    let coupling = needed(&group, "coupling", group.three_rows("coupling")?)?;
    Ok(Spacecraft {
        noise_nt: group.three("noise_nt")?.unwrap_or_default(),
        coupling: Matrix3::from_fn(|row, column| coupling[row][column]),
        line_nt: not_negative(&group, "line_nt", 0.0)?,
        factors: [
            number(&group, "heater_factor", 1.0)?,
            number(&group, "wheel_factor", 1.0)?,
            number(&group, "line_factor", 1.0)?,
        ],
    })
}

fn orbit(root: &Group<'_>) -> Result<OrbitTwin, Finding> {
    let group = section(root, "orbit", &["x_km", "y_km", "z_km", "step_s"])?;
    let one = |key: &str| -> Result<Vec<f64>, Finding> {
        let list = needed(&group, key, group.numbers(key)?)?;
        if list.len() <= 4 { Ok(list) } else { Err(group.refuse(key, "has more than four coefficients", "write a cubic")) }
    };
    Ok(OrbitTwin { km: [one("x_km")?, one("y_km")?, one("z_km")?], step_s: positive(&group, "step_s", Some(300.0))? })
}

/// Wheels, the step of their table, and half widths by mode.
type Wheels = (Vec<WheelTwin>, f64, Vec<(String, f64)>);

fn wheels(root: &Group<'_>, modes: &[Mode]) -> Result<Wheels, Finding> {
    let Some(group) = root.group("wheels")? else { return Ok((Vec::new(), 8.0, Vec::new())) };
    group.only(&["step_s", "half_width_hz", "wheel"])?;
    let mut list = Vec::new();
    for wheel in group.groups("wheel")? {
        wheel.only(&["rate_hz", "drift_hz_per_h", "amplitude_nt"])?;
        list.push(WheelTwin {
            rate_hz: positive(&wheel, "rate_hz", None)?,
            drift_hz_per_h: number(&wheel, "drift_hz_per_h", 0.0)?,
            amplitude_nt: not_negative(&wheel, "amplitude_nt", 0.0)?,
        });
    }
    if list.is_empty() {
        return Err(group.missing("wheel"));
    }
    let widths = needed(&group, "half_width_hz", group.group("half_width_hz")?)?;
    let sids: Vec<&str> = modes.iter().map(|m| m.sid.as_str()).collect();
    widths.only(&sids)?;
    let half = widths.names().into_iter().map(|sid| Ok((sid.to_owned(), positive(&widths, sid, None)?)));
    Ok((list, positive(&group, "step_s", Some(8.0))?, half.collect::<Result<Vec<_>, Finding>>()?))
}
