//! A run as data: header, settings, slow channels, and the account of its vectors.

use crate::data::error::Finding;
use crate::data::exclusion::Exclusion;
use crate::data::sketch::Sketch;
use crate::data::start::Start;
use crate::data::units::{FieldCoil, Reading};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What a run was made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Steps on the three axes: `lin`.
    Linearity,
    /// Steps in normal and turned positions: `offset`.
    Offset,
    /// Sines: `freq`.
    Frequency,
    /// Long records in zero field.
    ZeroField,
    /// Settings while the temperature moves.
    Sweep,
    /// Scalar calibration of the coil system.
    Scalar,
}

impl Kind {
    /// What to do about a run of this kind where another one was asked for.
    #[must_use]
    pub fn command(self) -> &'static str {
        match self {
            Kind::Linearity => "use `calfit lin`",
            Kind::Offset => "use `calfit offset`",
            Kind::Frequency => "use `calfit freq`",
            Kind::ZeroField => "use `calfit null`",
            Kind::Sweep => "use `calfit thermal`",
            Kind::Scalar => "use `calfit coil scalar`",
        }
    }
}

/// Where the sensor stood in the coil system during a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Location {
    /// At the centre of the coil system, where the reference field holds.
    #[default]
    Centre,
    /// Beside the centre: the field differs from the reference field by constant factors (RO-IGEP-TR0028 section 3.2.2).
    OffCentre,
}

impl Location {
    /// All locations with the names used in files.
    pub const NAMES: [(Location, &'static str); 2] = [(Location::Centre, "centre"), (Location::OffCentre, "off-centre")];

    /// The location with this name in files.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Location> {
        Self::NAMES.iter().find(|(_, n)| *n == name).map(|(location, _)| *location)
    }

    /// Whether it is the centre, which files do not state.
    #[must_use]
    pub fn is_centre(&self) -> bool {
        *self == Location::Centre
    }

    /// What stands behind sensor and mode where people read them: nothing at the centre.
    #[must_use]
    pub fn suffix(self) -> &'static str {
        match self {
            Location::Centre => "",
            Location::OffCentre => ", off-centre",
        }
    }
}

/// The time that a run id tells, `13-04-03_09-22-38`; years below 70 belong to this century.
#[must_use]
pub fn time_of_id(id: &str) -> Option<jiff::civil::DateTime> {
    let parts: Vec<i16> = id.split(['-', '_']).map(|p| p.parse().ok()).collect::<Option<_>>()?;
    let [year, rest @ ..] = parts.as_slice() else { return None };
    let [month, day, hour, minute, second] = rest.iter().map(|v| i8::try_from(*v).ok()).collect::<Option<Vec<i8>>>()?[..] else {
        return None;
    };
    let year = if *year < 70 { 2000 + year } else { 1900 + year };
    jiff::civil::DateTime::new(year, month, day, hour, minute, second, 0).ok()
}

impl Kind {
    /// All kinds with the names used in files.
    pub const NAMES: [(Kind, &'static str); 6] = [
        (Kind::Linearity, "linearity"),
        (Kind::Offset, "offset"),
        (Kind::Frequency, "frequency"),
        (Kind::ZeroField, "zero-field"),
        (Kind::Sweep, "sweep"),
        (Kind::Scalar, "scalar"),
    ];

    /// Whether analyses across temperatures rest on runs of this kind.
    #[must_use]
    pub fn is_thermal(self) -> bool {
        matches!(self, Kind::Linearity | Kind::Offset | Kind::Frequency | Kind::Sweep)
    }

    /// The kind with this name in files.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Kind> {
        Self::NAMES.iter().find(|(_, n)| *n == name).map(|(kind, _)| *kind)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::NAMES.iter().find(|(kind, _)| kind == self).map_or("?", |(_, name)| name);
        f.write_str(name)
    }
}

/// Unit of the readings in a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ReadingUnit {
    /// Engineering nanotesla.
    Ent,
    /// Counts of the converter, with the nominal factor in enT per count.
    Counts {
        /// enT per count.
        ent_per_count: f64,
    },
}

impl ReadingUnit {
    /// enT per unit of the file.
    #[must_use]
    pub fn ent_per_unit(self) -> f64 {
        match self {
            ReadingUnit::Ent => 1.0,
            ReadingUnit::Counts { ent_per_count } => ent_per_count,
        }
    }
}

/// The keys at the head of a run file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Header {
    /// Run id, `YY-MM-DD_hh-mm-ss`.
    pub run: String,
    /// Start, UTC.
    pub start: Start,
    /// What the run was made for.
    pub kind: Kind,
    /// Name of the field programme, empty if not stated.
    pub configuration: String,
    /// Sensor, empty if not stated.
    pub sensor: String,
    /// Mode of the instrument, empty if not stated.
    pub mode: String,
    /// Nominal sample rate, Hz.
    pub sample_rate_hz: f64,
    /// Unit of the readings in the file.
    pub unit: ReadingUnit,
    /// Source of the field, empty if not stated.
    pub field_source: String,
    /// Whether the facility corrected the coil parameters automatically.
    pub coil_correction: Option<bool>,
    /// Earth-field compensation per coil axis, empty if not stated.
    pub earthfield_compensation: Vec<String>,
}

/// One setting of the field programme.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// Begin, s since the run's start.
    pub t_start_s: f64,
    /// End, s since the run's start.
    pub t_end_s: f64,
    /// Applied field, or amplitude of the sine (half peak to peak), nT, coil coordinates.
    pub field: FieldCoil,
    /// Frequency of the sine, Hz; 0 is a constant field.
    pub frequency_hz: f64,
    /// Id of the position.
    pub position: u32,
}

/// One sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vector {
    /// Sample counter.
    pub n: u64,
    /// Time from the counter, s since the run's start.
    pub t_s: f64,
    /// Raw reading.
    pub reading: Reading,
}

/// One plateau mean that the file itself brings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GivenBlock {
    /// The setting.
    pub setting: Setting,
    /// Mean reading.
    pub mean: Reading,
    /// Standard deviation of the samples, enT, if the file has it.
    pub std_ent: Option<[f64; 3]>,
    /// Number of samples, if the file has it.
    pub count: Option<u64>,
}

/// One row of a scalar calibration of the coil system.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScalarRow {
    /// s since the run's start.
    pub t_s: f64,
    /// Settings of the three coil axes, EU or nT as the file says.
    pub setting: [f64; 3],
    /// Modulus measured by the scalar magnetometer, nT.
    pub modulus_nt: f64,
}

/// Slow channels: a time column and one column of readings per name; NaN is no reading.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SlowTable {
    /// Names of the channels.
    pub names: Vec<String>,
    /// s since the run's start, ascending.
    pub t_s: Vec<f64>,
    /// One vector per channel, as long as `t_s`.
    pub values: Vec<Vec<f64>>,
}

impl SlowTable {
    /// The readings of one channel as (s, value), without the empty cells.
    #[must_use]
    pub fn channel(&self, name: &str) -> Option<Vec<(f64, f64)>> {
        let index = self.names.iter().position(|n| n == name)?;
        let values = self.values.get(index)?;
        Some(self.t_s.iter().copied().zip(values.iter().copied()).filter(|(_, v)| v.is_finite()).collect())
    }
}

/// Mean of a series, (s, value), over a time; between the readings around its middle where it holds too few of them to stand for all of it.
#[must_use]
pub fn mean_over(series: &[(f64, f64)], [begin, end]: [f64; 2]) -> f64 {
    let inside = &series[series.partition_point(|(t, _)| *t < begin)..series.partition_point(|(t, _)| *t <= end)];
    if inside.len() > 2 {
        inside.iter().map(|(_, v)| v).sum::<f64>() / inside.len() as f64
    } else {
        interpolate(series, 0.5 * (begin + end))
    }
}

/// A slow channel at a time, straight between its readings; the first or last one outside, NaN without any.
#[must_use]
pub fn interpolate(series: &[(f64, f64)], t_s: f64) -> f64 {
    let after = series.partition_point(|(t, _)| *t <= t_s);
    match (after.checked_sub(1).and_then(|i| series.get(i)), series.get(after)) {
        (Some((t0, v0)), Some((t1, v1))) => v0 + (v1 - v0) * (t_s - t0) / (t1 - t0),
        (Some((_, v)), None) | (None, Some((_, v))) => *v,
        (None, None) => f64::NAN,
    }
}

/// A stretch of lost samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// Line of the first sample after the gap.
    pub line: u64,
    /// Time of that sample, s.
    pub t_s: f64,
    /// Samples missing.
    pub lost: u64,
}

/// The account of a run's vectors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct VectorAccount {
    /// Samples read.
    pub count: u64,
    /// Samples missing according to the counter.
    pub lost: u64,
    /// Repeated rows that were left out.
    pub duplicates: u64,
    /// Samples that were read and left out by hand.
    pub excluded: u64,
    /// The gaps; at most [`VectorAccount::MOST_GAPS`] are kept, `lost` counts all.
    pub gaps: Vec<Gap>,
    /// Number of gaps.
    pub gap_count: u64,
    /// Time of the first and last sample, s.
    pub span_s: Option<[f64; 2]>,
    /// Sample rate from counter and time column, Hz.
    pub measured_rate_hz: Option<f64>,
    /// Which readings they are, as far as who read the run looked at it.
    #[serde(skip)]
    pub sketch: Sketch,
}

impl VectorAccount {
    /// Gaps that are kept one by one.
    pub const MOST_GAPS: usize = 1000;
}

/// The file a run came from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InputFile {
    /// Path inside the campaign, with forward slashes.
    pub path: String,
    /// Size in bytes.
    pub size_bytes: u64,
    /// SHA-256 of the file's bytes, hexadecimal.
    pub sha256: String,
}

/// Everything of a run but its vectors, which go to a [`VectorSink`] while the file is read.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Header.
    pub header: Header,
    /// Settings in time order; from `@FIELDS`.
    pub settings: Vec<Setting>,
    /// Plateau means of `@BLOCKS`, in place of settings and vectors.
    pub blocks: Vec<GivenBlock>,
    /// Temperatures, °C.
    pub temperatures: SlowTable,
    /// Other slow channels.
    pub channels: SlowTable,
    /// Scalar calibration rows.
    pub scalar: Vec<ScalarRow>,
    /// Account of the vectors.
    pub vectors: VectorAccount,
    /// The file.
    pub input: InputFile,
    /// Warnings and notes made while reading.
    pub findings: Vec<Finding>,
    /// Parts that are left out by hand; the vectors of these did not go to the sink.
    pub exclusions: Vec<Exclusion>,
}

impl Run {
    /// Time from its start to its last setting, mean or vector, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        let ends = self.settings.iter().map(|s| s.t_end_s).chain(self.blocks.iter().map(|b| b.setting.t_end_s));
        let ends = ends.chain(self.scalar.iter().map(|s| s.t_s));
        ends.chain(self.vectors.span_s.map(|s| s[1])).fold(0.0, f64::max)
    }

    /// The readings of a slow channel as (s, value): that of the temperatures before another one of the same name.
    #[must_use]
    pub fn slow_channel(&self, name: &str) -> Option<Vec<(f64, f64)>> {
        self.temperatures.channel(name).or_else(|| self.channels.channel(name))
    }
}

/// Takes the vectors of a run while its file is read, in the order of the file.
pub trait VectorSink {
    /// Whether the settings must be known before the first vector.
    fn needs_settings(&self) -> bool {
        false
    }
    /// Called once before the first vector.
    fn begin(&mut self, _header: &Header, _settings: &[Setting]) {}
    /// Called for every sample.
    fn vector(&mut self, vector: Vector);
}

/// Lets the vectors go by; the account of them is kept all the same.
impl VectorSink for () {
    fn vector(&mut self, _vector: Vector) {}
}

/// Two sinks side by side.
impl<A: VectorSink, B: VectorSink> VectorSink for (A, B) {
    fn needs_settings(&self) -> bool {
        self.0.needs_settings() || self.1.needs_settings()
    }
    fn begin(&mut self, header: &Header, settings: &[Setting]) {
        self.0.begin(header, settings);
        self.1.begin(header, settings);
    }
    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        self.0.vector(vector);
        self.1.vector(vector);
    }
}

/// A sink that may be absent.
impl<A: VectorSink> VectorSink for Option<A> {
    fn needs_settings(&self) -> bool {
        self.as_ref().is_some_and(VectorSink::needs_settings)
    }
    fn begin(&mut self, header: &Header, settings: &[Setting]) {
        if let Some(sink) = self {
            sink.begin(header, settings);
        }
    }
    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        if let Some(sink) = self {
            sink.vector(vector);
        }
    }
}
