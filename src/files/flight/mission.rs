//! What `flight.toml` says: a mission's sensors, modes, frames, tables and the steps of its processing.

use super::times::TimeRule;
use crate::data::convention::Convention;
use crate::data::time::Tt2000;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A half-open stretch of time, `[from, to)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Span {
    /// Begin.
    pub from: Tt2000,
    /// End, not of it.
    pub to: Tt2000,
}

impl Span {
    /// Whether a time lies in it.
    #[must_use]
    pub fn holds(&self, time: Tt2000) -> bool {
        (self.from..self.to).contains(&time)
    }

    /// Whether it has a moment in common with another one.
    #[must_use]
    pub fn meets(&self, other: &Span) -> bool {
        self.from < other.to && other.from < self.to
    }
}

/// A moment at which two of some entries hold, each for some time and for a range, or for all ranges without one; `None` where there is none.
#[must_use]
pub fn overlap(entries: impl IntoIterator<Item = (Span, Option<u8>)>) -> Option<Tt2000> {
    let mut sorted: Vec<(Span, Option<u8>)> = entries.into_iter().collect();
    sorted.sort_unstable();
    sorted.iter().enumerate().find_map(|(index, (span, range))| {
        let mut later = sorted[index + 1..].iter().take_while(|(other, _)| other.from < span.to);
        later.find(|(_, other)| range.is_none() || other.is_none() || range == other).map(|(other, _)| other.from)
    })
}

/// What becomes of vectors outside of the temperatures of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutsideTemperature {
    /// No vector, with its flag.
    Null,
    /// The vector is kept with its flag.
    Flag,
}

/// The frame in which an offset is taken off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OffsetFrame {
    /// Axes of the sensor.
    Uvw,
    /// Axes of the spacecraft.
    Sc,
}

/// A rotation that holds for some time.
#[derive(Clone, Debug, PartialEq)]
pub struct Boom {
    /// State of the boom.
    pub boom: String,
    /// When.
    pub span: Span,
    /// From the sensor to the spacecraft.
    pub uvw_to_sc: Matrix3<f64>,
}

/// An offset that is taken off for some time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// When.
    pub span: Span,
    /// Of which range index; of all ranges without one.
    pub range: Option<u8>,
    /// In which frame.
    pub frame: OffsetFrame,
    /// nT, to be subtracted.
    pub subtract_nt: Vector3<f64>,
}

impl Jump {
    /// Whether it holds for a vector.
    #[must_use]
    pub fn holds(&self, time: Tt2000, range: u8) -> bool {
        self.span.holds(time) && self.range.is_none_or(|own| own == range)
    }
}

/// A matrix with an offset in place of a ground calibration, for a range and some time.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeMatrix {
    /// When.
    pub span: Span,
    /// Range index; all ranges without one.
    pub range: Option<u8>,
    /// nT/enT.
    pub matrix: Matrix3<f64>,
    /// Subtracted from the reading before the matrix (enT), or added behind it (nT).
    pub offset: Vector3<f64>,
    /// Whether the offset is added behind the matrix.
    pub added: bool,
    /// Covariance of the nine elements, row by row, and the three offsets.
    pub covariance: Option<Vec<Vec<f64>>>,
}

/// One sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    /// Name.
    pub name: String,
    /// Files of its ground calibration.
    pub ground: Vec<PathBuf>,
    /// Model file whose effects were taken off the runs of the calibration.
    pub model: Option<PathBuf>,
    /// Its name there.
    pub ground_sensor: Option<String>,
    /// The frame that is asked for, if it is not that of the files.
    pub frame: Option<Convention>,
    /// `b_or` in place of the offset is accepted.
    pub accept_b_or: bool,
    /// The residual field of the coil system is left in the offset, as RO-IGEP-TR0028 section 4.2.3.2 has it.
    pub ignore_residual: bool,
    /// Pattern of the names of the daily models.
    pub daily: Option<String>,
    /// From when on there are none.
    pub daily_to: Option<Tt2000>,
    /// A day without its file has no model; otherwise that is an error.
    pub daily_may_lack: bool,
    /// Column of its thermistor.
    pub thermistor_column: String,
    /// How counts become engineering units.
    pub counts: Counts,
    /// Noise of a reading, enT, by mode; the entry without a mode is for all others.
    pub noise_ent: BTreeMap<Option<String>, f64>,
    /// Boom states.
    pub rotations: Vec<Boom>,
    /// Offsets that jump.
    pub jumps: Vec<Jump>,
    /// A table of further ones, and the frame that they are in.
    pub offsets: Option<(PathBuf, OffsetFrame)>,
    /// Matrices in place of ground files.
    pub matrices: Vec<RangeMatrix>,
}

/// How counts become engineering units.
#[derive(Clone, Debug, PartialEq)]
pub enum Counts {
    /// A converter of so many bits over `± full_scale_ent` (RO-IGEP-TR0028 section 4.2.3.1).
    Converter {
        /// Bits.
        bits: u32,
        /// enT.
        full_scale_ent: f64,
    },
    /// A factor per range.
    Factor {
        /// enT per count.
        ent_per_count: Vec<f64>,
        /// Bits of the converter.
        bits: u32,
    },
}

impl Counts {
    /// enT per count in a range.
    #[must_use]
    pub fn ent_per_count(&self, range: u8) -> f64 {
        match self {
            Counts::Converter { bits, full_scale_ent } => 2.0 * full_scale_ent / (2.0_f64.powi(*bits as i32) - 1.0),
            Counts::Factor { ent_per_count, .. } => {
                ent_per_count.get(usize::from(range)).or(ent_per_count.last()).copied().unwrap_or(f64::NAN)
            }
        }
    }

    /// enT that are added behind the factor: a converter with an even number of steps has none at zero.
    #[must_use]
    pub fn shift_ent(&self) -> f64 {
        match self {
            Counts::Converter { .. } => 0.5 * self.ent_per_count(0),
            Counts::Factor { .. } => 0.0,
        }
    }

    /// The lowest and highest count that there can be.
    #[must_use]
    pub fn limits(&self) -> [f64; 2] {
        let (Counts::Converter { bits, .. } | Counts::Factor { bits, .. }) = self;
        let half = 2.0_f64.powi(*bits as i32 - 1);
        [-half, half - 1.0]
    }
}

/// Rate and time shift of one role in a mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Vectors per second.
    pub rate_hz: f64,
    /// ns that are added to the time of a vector; absent where none is stated.
    pub shift_ns: Option<i64>,
}

/// A mode of the instrument.
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// Its name.
    pub sid: String,
    /// Length of a packet, s.
    pub packet_s: f64,
    /// Of the primary and of the secondary sensor.
    pub rates: [Option<Rate>; 2],
    /// Fixed lines of other instruments, Hz.
    pub lines_hz: Vec<f64>,
}

/// Which sensor is the primary one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Roles {
    /// The primary sensor; absent with one sensor.
    pub primary: Option<String>,
    /// The secondary sensor.
    pub secondary: Option<String>,
    /// Stretches with another primary sensor.
    pub intervals: Vec<(Span, String)>,
}

impl Roles {
    /// 0 for the primary sensor, 1 for the secondary one.
    #[must_use]
    pub fn of(&self, sensor: &str, time: Tt2000) -> usize {
        usize::from(self.primary_at(time).is_some_and(|name| name != sensor))
    }

    fn primary_at(&self, time: Tt2000) -> Option<&String> {
        let other = self.intervals.iter().find(|(span, _)| span.holds(time)).map(|(_, primary)| primary);
        other.or(self.primary.as_ref())
    }

    /// Whether another sensor becomes the primary one within a stretch, behind its begin.
    #[must_use]
    pub fn change_within(&self, stretch: &std::ops::Range<Tt2000>) -> bool {
        let ends = self.intervals.iter().flat_map(|(span, _)| [span.from, span.to]);
        let mut within = ends.filter(|time| stretch.start < *time && *time < stretch.end);
        within.any(|time| self.primary_at(time - 1) != self.primary_at(time))
    }
}

/// The attitude and orbit of the spacecraft.
#[derive(Clone, Debug, PartialEq)]
pub struct Celestial {
    /// The frame of level C.
    pub frame: String,
    /// Table of quaternions.
    pub attitude: PathBuf,
    /// Whether the scalar part comes first.
    pub scalar_first: bool,
    /// Whether the quaternions turn from the spacecraft to the frame; otherwise back.
    pub from_sc: bool,
    /// Longest gap over which the attitude is interpolated, ns.
    pub max_gap_ns: i64,
    /// Standard uncertainty of the attitude, radians.
    pub std_rad: f64,
    /// Table of positions.
    pub position: Option<PathBuf>,
}

/// How interference of wheels and lines is taken off.
#[derive(Clone, Debug, PartialEq)]
pub struct Wheels {
    /// Table of rates.
    pub table: PathBuf,
    /// Harmonics of every wheel.
    pub harmonics: Vec<u32>,
    /// `stripe` of RO-IGEP-TR0028 section 4.9, else the least-squares fit.
    pub stripe: bool,
    /// Half width of a stripe by mode, Hz; the modes that are cleaned.
    pub half_width_hz: BTreeMap<String, f64>,
    /// Seed of the phases of replaced bins.
    pub seed: u64,
}

/// How heater jumps are taken off.
#[derive(Clone, Debug, PartialEq)]
pub struct Heater {
    /// Table of heater states, for method 2.
    pub table: Option<PathBuf>,
    /// Names of the heaters.
    pub classes: Vec<String>,
    /// Whether the states come from the table.
    pub from_table: bool,
    /// Time that the field of a heater takes to rise or fall, s; found in the data if it is not stated.
    pub edge_s: Option<f64>,
    /// Intervals with heater operation.
    pub intervals: Vec<Span>,
}

/// The axes of the means of a level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeansFrame {
    /// Those of the sensor.
    Sensor,
    /// Those of the spacecraft.
    Spacecraft,
    /// Celestial ones, those of the attitude.
    Celestial,
}

impl MeansFrame {
    /// Of the level with a letter: E, F, or G and I.
    #[must_use]
    pub fn of(letter: char) -> Self {
        match letter {
            'E' => MeansFrame::Sensor,
            'F' => MeansFrame::Spacecraft,
            _ => MeansFrame::Celestial,
        }
    }
}

/// How the field that two sensors share is found.
#[derive(Clone, Debug, PartialEq)]
pub struct Common {
    /// Coupling of the disturbance at the secondary sensor to that at the primary one; without it principal components.
    pub coupling: Option<Matrix3<f64>>,
    /// The levels of the means that are used, primary and secondary.
    pub inputs: [char; 2],
    /// The stretch of the principal components; a day without it.
    pub span: Option<Span>,
}

impl Default for Common {
    fn default() -> Self {
        Self { coupling: None, inputs: ['G', 'G'], span: None }
    }
}

impl Common {
    /// The axes of both inputs, and of what they share.
    #[must_use]
    pub fn frame(&self) -> MeansFrame {
        MeansFrame::of(self.inputs[0])
    }
}

/// A field that follows a current or another reading of the housekeeping.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance {
    /// Column.
    pub column: String,
    /// nT per unit of the column, in axes of the sensor.
    pub vector_nt_per_unit: Vector3<f64>,
}

/// All that `flight.toml` says.
#[derive(Clone, Debug, PartialEq)]
pub struct Mission {
    /// Its folder, from which its paths count.
    pub folder: PathBuf,
    /// Name of the mission.
    pub mission: String,
    /// Name of the instrument.
    pub instrument: String,
    /// Folder of the telemetry.
    pub input: PathBuf,
    /// Folder of the housekeeping.
    pub hk: Option<PathBuf>,
    /// Which column of times counts, and how far others may differ.
    pub time_rule: TimeRule,
    /// Vectors with one of these bits of `quality` are rejected.
    pub reject_mask: u8,
    /// Mode of all vectors.
    pub sid: Option<String>,
    /// Modes by time.
    pub mode_spans: Vec<(Span, String)>,
    /// Daily models are joined at midnight.
    pub continuity: bool,
    /// A gap over midnight that is longer ends that, ns.
    pub reset_gap_ns: i64,
    /// Campaigns, at whose begins it ends too.
    pub campaigns: Vec<Span>,
    /// What becomes of vectors outside of the temperatures.
    pub outside: OutsideTemperature,
    /// Temperatures to which vectors are kept, °C, with the reason.
    pub extended_degc: Option<([f64; 2], String)>,
    /// Running median of the temperatures, s; 0 for none.
    pub smooth_s: f64,
    /// Attitude and orbit.
    pub celestial: Option<Celestial>,
    /// Sensors.
    pub sensors: Vec<Sensor>,
    /// Modes.
    pub modes: Vec<Mode>,
    /// Roles of the sensors.
    pub roles: Roles,
    /// Interference of wheels and lines.
    pub wheels: Option<Wheels>,
    /// Heater jumps.
    pub heater: Option<Heater>,
    /// The field that two sensors share.
    pub common: Common,
    /// Length of the intervals of means, ns.
    pub mean_ns: i64,
    /// Fields that follow readings of the housekeeping.
    pub disturbances: Vec<Disturbance>,
    /// Names of the steps in their order.
    pub steps: Vec<String>,
    /// Columns of the uncertainty are written.
    pub uncertainty: bool,
    /// Text tables with labels are written.
    pub text: bool,
}

impl Mission {
    /// The mode of a name.
    #[must_use]
    pub fn mode(&self, sid: &str) -> Option<usize> {
        self.modes.iter().position(|mode| mode.sid == sid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_of_the_primary_sensor_is_seen_within_a_stretch_only() {
        let interval = |from, to, name: &str| (Span { from, to }, name.to_owned());
        let intervals = vec![interval(100, 150, "IB"), interval(150, 200, "IB"), interval(300, 350, "OB")];
        let roles = Roles { primary: Some("OB".to_owned()), secondary: Some("IB".to_owned()), intervals };
        let changes = |from: Tt2000, to: Tt2000| roles.change_within(&(from..to));
        assert!(changes(50, 101) && changes(160, 201));
        // At the ends of the stretch, between intervals of one sensor, and where the sensor stays the same.
        assert!(!changes(100, 200) && !changes(0, 100) && !changes(110, 190) && !changes(250, 400));
    }
}
