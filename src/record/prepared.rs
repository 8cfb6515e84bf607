//! A run as rows with covariates, and the linear model that is fitted to them before any effect is looked for.

use super::{row_noise, temperature_faults};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{self, Course as SettingCourse, Displacement, Plateau, Plateaus};
use crate::data::run::{Kind, Run, Setting, SlowTable, Vector, VectorSink, interpolate, mean_over};
use crate::data::units::Scale;
use crate::fit::Limits;
use crate::fit::noise::state_space::Inside;
use crate::fit::smooth::Course;
use crate::fit::statistics::{extent, extremes, median, robust_std};
use crate::model::campaign::Instructions;
use crate::model::effects::record::{Channel, EARLIER, Step, earlier_fields};
use crate::model::effects::{Record, Row, Thermal};
use crate::model::facility::Facility;
use crate::model::lag::Lag;
use crate::model::sensor::split;
use crate::model::sensor_polynomials::{SensorChange, SensorPolynomials};
use crate::record::baseline::Baseline;
use crate::record::facility as reference_field;
use nalgebra::{DMatrix, Matrix3, Vector3};
use std::borrow::Cow;

/// Channels of the variometer.
const VARIOMETER: [&str; 3] = ["VARX", "VARY", "VARZ"];
/// A sensor temperature that moves by this much is a polynomial in the model of a sweep, K.
const LEAST_RANGE_K: f64 = 5.0;
/// Order of the temperature polynomials of a sweep.
const THERMAL_ORDER: usize = 2;
/// Order of the offset trend of a linearity run and of a zero-field run, unless the campaign states another one.
pub const TREND_ORDER: usize = 2;
/// A mean so many standard deviations beside its neighbours is an outlier, in a record of at least so many means.
const OUTLIER: f64 = 5.0;
const LEAST_FOR_OUTLIERS: usize = 200;
/// Samples of usual scatter that are added to those of every row.
const SHRINK: f64 = 20.0;
/// Rows into which a record without settings is divided.
const PARTS: usize = 200;

/// Samples of a run, kept for what happens inside a plateau.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Sample counter.
    pub n: Vec<u64>,
    /// Time, s since the run's start.
    pub t_s: Vec<f64>,
    /// Reading, enT.
    pub reading_ent: Vec<[f64; 3]>,
}

impl VectorSink for Samples {
    fn vector(&mut self, vector: Vector) {
        self.n.push(vector.n);
        self.t_s.push(vector.t_s);
        self.reading_ent.push(vector.reading.0);
    }
}

/// Rows, their mean readings, and the columns of the linear model.
#[derive(Clone)]
pub struct PreparedRun {
    /// Covariates.
    pub record: Record,
    /// Mean readings, enT: a row per row, a column per component.
    pub readings: DMatrix<f64>,
    /// Columns of the linear model of each component.
    pub design: DMatrix<f64>,
    /// White variance of each row relative to the others, per component.
    pub white: Vec<[f64; 3]>,
    /// White noise by the samples inside the rows.
    pub inside: Option<Inside>,
    /// The same by the scatter of these samples, as a file without them states it: other than white noise is not told from this.
    pub scatter: Option<Inside>,
    /// nT per enT of each component.
    pub nt_per_ent: [f64; 3],
    /// Time and settings of the used plateaus, by index into the samples: first and one past the last.
    pub windows: Vec<[usize; 2]>,
    /// How the data step against the settings, sample by sample.
    pub displacement: Option<Displacement>,
    /// What a person should know.
    pub notes: Vec<Note>,
    /// Readings of the sensor's thermistor, (s since the run's start, °C), which the record has as a smooth course.
    pub thermistor: Vec<(f64, f64)>,
    /// By how long the temperatures of the rows follow or lead the thermistor, s: so near to the begin and end of its readings they are not known.
    pub lag_s: f64,
    /// Damaged data: the temperatures of the record are without it.
    pub faults: Vec<temperature_faults::Jumps>,
}

/// Why a run cannot be looked at.
pub struct Unfit(pub String);

impl PreparedRun {
    /// One run made ready to fit.
    ///
    /// # Errors
    /// Several positions, too few rows, or fields that do not determine the response.
    pub fn new(
        run: &Run,
        plateaus: &Plateaus,
        samples: Option<&Samples>,
        instructions: &Instructions,
        facility: Option<&Facility>,
    ) -> Result<Self, Unfit> {
        let mut notes = Vec::new();
        let kind = run.header.kind;
        let mut list = plateaus.list.clone();
        let positions = plateaus.positions();
        if positions.len() > 1 {
            let all = positions.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
            return Err(Unfit(format!("the run holds settings in positions {all}; a diagnosis needs one position")));
        }
        if let Some(facility) = facility {
            reference_field::apply(facility, run, instructions, &mut list, &mut notes).map_err(|e| Unfit(e.to_string()))?;
        }
        let parts = match (kind, samples) {
            (Kind::ZeroField, Some(samples)) if run.blocks.is_empty() => parts_of(samples),
            _ => list.iter().filter(|p| p.dropped.is_none()).map(Part::of).collect(),
        };
        let (still, temperatures) = temperature_faults::without_still(run, instructions);
        let (sensor_name, coil_name) = instructions.channels(&run.header);
        let mut parts: Vec<Part> = parts;
        for stretch in still.iter().filter(|s| kind == Kind::Sweep && s.channel == sensor_name) {
            let [begin, end] = stretch.time_s;
            let before = parts.len();
            parts.retain(|p| p.used_s[1] <= begin || p.used_s[0] > end);
            let (gone, channel) = (before - parts.len(), &sensor_name);
            if gone > 0 {
                let text = format!(
                    "{gone} settings from {begin:.0} to {end:.0} s are left out: their temperature is not known while {channel} stands still"
                );
                notes.push(Note::new(NoteKind::Temperature, text).about(channel));
            }
        }
        if parts.len() < 12 {
            return Err(Unfit(format!("{} usable plateaus are too few to tell an effect from noise", parts.len())));
        }
        let earlier = earlier_of(&list, &parts);
        let readings = DMatrix::from_fn(parts.len(), 3, |i, a| parts[i].mean_ent[a]);
        let span_s = [parts[0].used_s[0], parts[parts.len() - 1].used_s[1]];
        let (faults, temperatures) = temperature_faults::without_jumps(&temperatures, span_s);
        let rack_name = instructions.rack_channel();
        let used_s: Vec<[f64; 2]> = parts.iter().map(|p| p.used_s).collect();
        let at_rows = |table: &SlowTable, name: &str| of_rows(table, name, &used_s, |readings| Course::exact(readings.to_vec()));
        // Thermal masses are slow and their thermistors noisy: a smooth course stands for the readings.
        let degc = |name: &str| of_rows(&temperatures, name, &used_s, Course::smooth);
        let mut sensor = degc(&sensor_name);
        let mut thermistors = Vec::new();
        for name in temperatures.names.iter().filter(|n| **n != sensor_name && **n != coil_name && *n != rack_name) {
            let Some(other) = degc(name) else { continue };
            // A sweep names its thermistors as it likes: the first one that moves is the sensor's.
            if sensor.is_none() { sensor = Some(other) } else { thermistors.push(other) }
        }
        let with_temperature =
            kind == Kind::Sweep && sensor.as_ref().is_some_and(|c| extent(c.values.iter().copied()) > LEAST_RANGE_K);
        let triple = VARIOMETER.map(|name| at_rows(&run.channels, name));
        let variometer = match triple {
            [Some(x), Some(y), Some(z)] => Some([x, y, z]),
            _ => None,
        };
        let others = run.channels.names.iter().filter(|n| !VARIOMETER.contains(&n.as_str()));
        let rows = parts
            .iter()
            .zip(earlier)
            .map(|(p, earlier_coil_nt)| Row {
                run: 0,
                used_s: p.used_s,
                field_coil_nt: p.field_coil_nt,
                earlier_coil_nt,
                linear_ent: [0.0; 3],
            })
            .collect();
        let mut record = Record {
            kind,
            scale: Scale::Engineering,
            rows,
            response: Matrix3::identity(),
            span_s,
            steps: Vec::new(),
            sensor,
            thermistors,
            coil: degc(&coil_name),
            rack: degc(rack_name),
            variometer,
            others: others.filter_map(|name| at_rows(&run.channels, name)).collect(),
            thermal: None,
            // What the campaign does not fit is no part of the model, and shows as a drift.
            trend_order: instructions.offset_trend_order.map_or(TREND_ORDER, |o| TREND_ORDER.min(o as usize)),
            has_samples: samples.is_some_and(|s| !s.t_s.is_empty()),
        };
        if with_temperature {
            let degc = record.sensor.as_ref().map(|c| c.values.clone()).unwrap_or_default();
            set_temperature(&mut record, degc);
        }
        let design = design(&record);
        fit_linear(&mut record, &readings)?;
        let inverse = record.response.try_inverse().ok_or_else(|| Unfit("the response has no inverse".to_owned()))?;
        let nt_per_ent = std::array::from_fn(|a| inverse.column(a).norm());
        let windows = samples.map_or_else(Vec::new, |s| {
            let at = |t: f64| s.t_s.partition_point(|x| *x < t - 1e-9);
            parts.iter().map(|p| [at(p.used_s[0]), at(p.used_s[1])]).collect()
        });
        let white = white_variances(&parts);
        let inside = samples.and_then(|samples| row_noise::inside(&record, &white, &windows, samples));
        let stated: Vec<Option<([f64; 3], u64)>> = parts.iter().map(|p| p.std_ent.zip(p.count)).collect();
        let scatter = if inside.is_none() { row_noise::scatter(&white, &stated) } else { None };
        let displacement = samples.and_then(|samples| displacement(&list, samples, run.header.sample_rate_hz));
        let thermistor = record.sensor.as_ref().and_then(|sensor| temperatures.channel(&sensor.name)).unwrap_or_default();
        let mut prepared = Self {
            record,
            readings,
            design,
            white,
            inside,
            scatter,
            nt_per_ent,
            windows,
            displacement,
            notes,
            thermistor,
            lag_s: 0.0,
            faults,
        };
        prepared.doubt_outliers();
        if let Some(samples) = samples {
            let shift_s = displacement.map_or(0.0, |d| d.shift_s);
            prepared.record.steps = steps(&prepared.record, &list, samples, shift_s);
        }
        Ok(prepared)
    }

    /// Samples of the settings without what the temperature moves while the field stays: a saw and a transient that are no signals.
    #[must_use]
    pub fn at_steady_temperature<'a>(&self, samples: &'a Samples, settings: &[[f64; 2]]) -> Cow<'a, Samples> {
        if self.record.thermal.is_none() {
            return Cow::Borrowed(samples);
        }
        let mut steady = samples.clone();
        let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
        for (i, row) in self.record.rows.iter().enumerate() {
            // They are in the order of time.
            let after = settings.partition_point(|[begin, _]| *begin <= row.t_s());
            let Some([begin, end]) = after.checked_sub(1).map(|k| &settings[k]).filter(|[_, end]| row.t_s() <= *end) else {
                continue;
            };
            let drift = self.record.drift_ent_per_s(i);
            for k in at(*begin)..at(*end) {
                let since_s = samples.t_s[k] - row.t_s();
                steady.reading_ent[k].iter_mut().zip(drift).for_each(|(reading, drift)| *reading -= drift * since_s);
            }
        }
        Cow::Owned(steady)
    }

    /// Gives single means that lie far off less weight, where the file brings no more than one value each.
    fn doubt_outliers(&mut self) {
        let n = self.readings.nrows();
        if self.record.has_samples || n < LEAST_FOR_OUTLIERS {
            return;
        }
        let left = self.left_by_design(&self.readings);
        for a in 0..3 {
            let column: Vec<f64> = left.column(a).iter().copied().collect();
            // Against its neighbours: what changes slowly is no outlier.
            let beside = |i: usize| -> f64 {
                let mut near: Vec<f64> = (i.saturating_sub(4)..(i + 5).min(n)).filter(|j| *j != i).map(|j| column[j]).collect();
                column[i] - median(&mut near)
            };
            let off: Vec<f64> = (0..n).map(beside).collect();
            let usual = robust_std(off.iter().copied());
            for (white, v) in self.white.iter_mut().zip(&off) {
                let z = v.abs() / usual.max(f64::MIN_POSITIVE);
                if z > OUTLIER {
                    white[a] = white[a].max(z * z / 4.0);
                }
            }
        }
    }

    /// What the linear model leaves of readings, a row per row, enT: plain least squares.
    #[must_use]
    pub fn left_by_design(&self, readings: &DMatrix<f64>) -> DMatrix<f64> {
        let q = self.design.clone().qr().q();
        readings - &q * q.tr_mul(readings)
    }

    /// What the model of a sweep leaves of the readings with other temperatures of the rows: the sum of its squares, enT².
    #[must_use]
    pub fn squares_with(&self, readings: &DMatrix<f64>, degc: &[f64]) -> f64 {
        let baseline = Baseline::in_temperature(degc, THERMAL_ORDER, THERMAL_ORDER);
        baseline.squares_ent2(&fields_nt(&self.record.rows), degc, readings).iter().sum()
    }

    /// Refers the readings to the mean sensor temperature with the polynomials of the sensor, so that one response describes all of them; a run
    /// without a sensor temperature stays as it is. Returns by how much the temperature moves, K.
    ///
    /// # Errors
    /// A response that belongs to no sensor.
    pub fn refer(&mut self, polynomials: &SensorPolynomials, r_nom: &Matrix3<f64>) -> Result<f64, Unfit> {
        // Each round makes what is left smaller by the relative change of the response, a few percent at most.
        const ROUNDS: usize = 12;
        let Some(sensor) = &self.record.sensor else { return Ok(0.0) };
        let degc = match polynomials.lag {
            None => sensor.values.clone(),
            Some(lag) => {
                let lagged = lag.in_run(&sensor.course.series);
                self.record.rows.iter().map(|row| interpolate(&lagged, row.t_s())).collect()
            }
        };
        let mean_degc = degc.iter().sum::<f64>() / degc.len() as f64;
        let over_k: Vec<f64> = degc.iter().map(|degc| degc - mean_degc).collect();
        let change = SensorChange::of(polynomials, mean_degc);
        let raw = self.readings.clone();
        for _ in 0..ROUNDS {
            let no_sensor = || Unfit("the response belongs to no sensor with three axes".to_owned());
            let phi = self.record.response.try_inverse().ok_or_else(no_sensor)?;
            let at = split(&phi, r_nom).map_err(|_| no_sensor())?;
            for (i, row) in self.record.rows.iter().enumerate() {
                let by = change.reading_ent(&at, over_k[i], row.field_coil_nt).ok_or_else(no_sensor)?;
                (0..3).for_each(|a| self.readings[(i, a)] = raw[(i, a)] - by[a]);
            }
            fit_linear(&mut self.record, &self.readings)?;
        }
        Ok(extent(over_k))
    }

    /// Fits the linear model once more, to readings from which something was taken off.
    pub fn refit(&mut self, readings: &DMatrix<f64>) {
        // The same rows had a fit before.
        let _ = fit_linear(&mut self.record, readings);
    }

    /// The run with the readings of a temperature channel as they were recorded, its jumps included; `None` where nothing rests on the channel.
    #[must_use]
    pub fn as_recorded(&self, run: &Run, name: &str) -> Option<Self> {
        let mut other = self.clone();
        other.faults.retain(|fault| fault.channel != name);
        other.with_channel(&run.temperatures, name)
    }

    /// The run without jumps of a temperature channel that holds none so far; `None` where nothing rests on the channel.
    #[must_use]
    pub fn without(&self, run: &Run, jumps: &temperature_faults::Jumps) -> Option<Self> {
        let mut table = run.temperatures.clone();
        jumps.take_off_of(&mut table);
        let mut other = self.clone();
        other.faults.push(jumps.clone());
        other.with_channel(&table, &jumps.channel)
    }

    /// With a temperature channel of a table in place of its own; `None` where nothing rests on the channel.
    fn with_channel(mut self, table: &SlowTable, name: &str) -> Option<Self> {
        let used_s: Vec<[f64; 2]> = self.record.rows.iter().map(|r| r.used_s).collect();
        let recorded = of_rows(table, name, &used_s, Course::smooth)?;
        let record = &mut self.record;
        let single = [&mut record.sensor, &mut record.coil, &mut record.rack].into_iter().flatten();
        let mut is_used = false;
        for channel in single.chain(&mut record.thermistors).filter(|c| c.name == name) {
            *channel = recorded.clone();
            is_used = true;
        }
        if !is_used {
            return None;
        }
        if self.record.sensor.as_ref().is_some_and(|s| s.name == name) {
            self.thermistor = table.channel(name).unwrap_or_default();
            if self.record.thermal.is_some() {
                self.with_temperatures(recorded.values);
            }
        }
        Some(self)
    }

    /// Gives a sweep the temperatures of the part that matters, which follows or leads the thermistor.
    pub fn follow(&mut self, lag: Lag) {
        if self.record.thermal.is_some()
            && let Some(sensor) = &self.record.sensor
        {
            let lagged = lag.of(&sensor.course);
            self.lag_s = lag.seconds().abs();
            self.with_temperatures(self.record.rows.iter().map(|r| interpolate(&lagged, r.t_s())).collect());
        }
    }

    /// Replaces the temperature of every row and fits once more.
    pub fn with_temperatures(&mut self, degc: Vec<f64>) {
        set_temperature(&mut self.record, degc);
        self.design = design(&self.record);
        // The same rows had a fit before.
        let _ = fit_linear(&mut self.record, &self.readings);
    }
}

/// White variance of each part relative to the others: the scatter of its samples over their number.
fn white_variances(parts: &[Part]) -> Vec<[f64; 3]> {
    let count = |p: &Part| p.count.map_or(1.0, |n| n.max(1) as f64);
    let most = parts.iter().map(count).fold(1.0, f64::max);
    let usual = usual_variances(parts);
    let scatter = |p: &Part, a: usize| {
        let own = p.std_ent.map_or(1.0, |s| s[a] * s[a] / usual[a]);
        // Few samples say little, and a single part with a spike is no law: at most ten times, at least a fifth of the usual.
        (((count(p) - 1.0) * own + SHRINK) / (count(p) - 1.0 + SHRINK)).clamp(0.2, 10.0)
    };
    parts.iter().map(|p| std::array::from_fn(|a| scatter(p, a) * most / count(p))).collect()
}

/// Median variance of the samples of a part; one where they are not known, or do not scatter.
fn usual_variances(parts: &[Part]) -> [f64; 3] {
    std::array::from_fn(|a| {
        let mut all: Vec<f64> = parts.iter().map(|p| p.std_ent.map_or(1.0, |s| s[a] * s[a])).collect();
        Some(median(&mut all)).filter(|v| *v > 0.0).unwrap_or(1.0)
    })
}

struct Part {
    used_s: [f64; 2],
    field_coil_nt: [f64; 3],
    mean_ent: [f64; 3],
    count: Option<u64>,
    /// Standard deviation of the samples, enT, if they are known.
    std_ent: Option<[f64; 3]>,
    index: Option<usize>,
}

impl Part {
    fn of(p: &Plateau) -> Self {
        Part {
            used_s: p.used_s,
            field_coil_nt: p.setting.field.0,
            mean_ent: p.mean.0,
            count: p.count,
            std_ent: p.std_ent,
            index: Some(p.index),
        }
    }
}

/// Equal parts of a record in zero field.
fn parts_of(samples: &Samples) -> Vec<Part> {
    let n = samples.t_s.len();
    let length = n.div_ceil(PARTS).max(1);
    samples
        .t_s
        .chunks(length)
        .zip(samples.reading_ent.chunks(length))
        .filter(|(t, _)| 2 * t.len() >= length)
        .map(|(t, r)| {
            let mean = |a: usize| r.iter().map(|v| v[a]).sum::<f64>() / r.len() as f64;
            let mean_ent = [mean(0), mean(1), mean(2)];
            let std = |a: usize| {
                let squares: f64 = r.iter().map(|v| (v[a] - mean_ent[a]).powi(2)).sum();
                (squares / (r.len() - 1).max(1) as f64).sqrt()
            };
            Part {
                used_s: [t[0], t[t.len() - 1]],
                field_coil_nt: [0.0; 3],
                mean_ent,
                count: Some(r.len() as u64),
                std_ent: Some([std(0), std(1), std(2)]),
                index: None,
            }
        })
        .collect()
}

fn earlier_of(list: &[Plateau], parts: &[Part]) -> Vec<[[f64; 3]; EARLIER]> {
    // Both are in the order of time.
    let mut at = 0;
    parts
        .iter()
        .map(|part| {
            at = list.iter().skip(at).position(|p| Some(p.index) == part.index).map_or(at, |further| at + further);
            let is_setting = list.get(at).is_some_and(|p| Some(p.index) == part.index);
            earlier_fields(|before| list.get(at.checked_sub(before).filter(|_| is_setting)?).map(|p| p.setting.field.0))
        })
        .collect()
}

/// A channel as means over times.
fn of_rows(table: &SlowTable, name: &str, used_s: &[[f64; 2]], course: impl Fn(&[(f64, f64)]) -> Course) -> Option<Channel> {
    Some(channel(name, course(&table.channel(name).filter(|s| s.len() > 1)?), used_s))
}

/// A course of a channel as means over times.
pub(crate) fn channel(name: &str, course: Course, used_s: &[[f64; 2]]) -> Channel {
    let values: Vec<f64> = used_s.iter().map(|used_s| mean_over(&course.series, *used_s)).collect();
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    Channel { name: name.to_owned(), course, values, mean }
}

fn set_temperature(record: &mut Record, degc: Vec<f64>) {
    let [low, high] = extremes(degc.iter().copied());
    record.thermal = Some(Thermal {
        middle_degc: 0.5 * (low + high),
        half_k: (0.5 * (high - low)).max(f64::MIN_POSITIVE),
        response: vec![Matrix3::zeros(); THERMAL_ORDER + 1],
        offset_ent: vec![[0.0; 3]; THERMAL_ORDER + 1],
        degc,
    });
}

fn fields_nt(rows: &[Row]) -> Vec<[f64; 3]> {
    rows.iter().map(|r| r.field_coil_nt).collect()
}

/// The linear model of a record and the times or temperatures of its rows: a trend in a run, temperature polynomials in a sweep.
fn baseline(record: &Record) -> (Baseline, Vec<f64>) {
    let fields_nt = fields_nt(&record.rows);
    let (baseline, x) = match &record.thermal {
        Some(thermal) => (Baseline::in_temperature(&thermal.degc, THERMAL_ORDER, THERMAL_ORDER), thermal.degc.clone()),
        None => (Baseline::in_time(record.span_s, record.trend_order), record.rows.iter().map(Row::t_s).collect()),
    };
    (baseline.in_units_of(&fields_nt), x)
}

/// Columns of the linear model of a record.
pub(super) fn design(record: &Record) -> DMatrix<f64> {
    let (baseline, x) = baseline(record);
    baseline.columns(&fields_nt(&record.rows), &x)
}

/// Ordinary least squares for what the effects need to know of the sensor: response, and readings without offset.
fn fit_linear(record: &mut Record, readings: &DMatrix<f64>) -> Result<(), Unfit> {
    let (baseline, x) = baseline(record);
    let solution = baseline
        .fit(&fields_nt(&record.rows), &x, readings, &Limits::default())
        .map_err(|_| Unfit("fields and times do not determine the response".to_owned()))?;
    let stacked = solution.coefficients.as_slice();
    let response = baseline.responses(stacked);
    // Where no field is applied, every sensor is an ideal one.
    record.response = response.first().copied().unwrap_or_else(Matrix3::identity);
    if let Some(thermal) = &mut record.thermal {
        for power in 0..=THERMAL_ORDER {
            thermal.response[power] = response.get(power).copied().unwrap_or_else(Matrix3::zeros);
            thermal.offset_ent[power] = std::array::from_fn(|i| baseline.offsets_ent(stacked, i)[power]);
        }
    }
    set_linear(record);
    Ok(())
}

/// Readings of the linear sensor of a record at temperatures that may have changed since it was fitted.
pub(super) fn with_same_sensor(record: &mut Record) {
    if let (Some(thermal), Some(sensor)) = (&mut record.thermal, &record.sensor) {
        thermal.degc.clone_from(&sensor.values);
    }
    set_linear(record);
}

fn set_linear(record: &mut Record) {
    for i in 0..record.rows.len() {
        let response = record.thermal.as_ref().map_or(record.response, |thermal| {
            let u = thermal.u(i);
            thermal.response.iter().enumerate().fold(Matrix3::zeros(), |sum, (power, m)| sum + m * u.powi(power as i32))
        });
        let row = &mut record.rows[i];
        row.linear_ent = (response * Vector3::from(row.field_coil_nt)).into();
    }
}

/// How the samples step against the settings.
fn displacement(list: &[Plateau], samples: &Samples, sample_rate_hz: f64) -> Option<Displacement> {
    let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
    let course = |setting: &Setting| {
        let used = if setting.frequency_hz == 0.0 { at(setting.t_start_s)..at(setting.t_end_s) } else { 0..0 };
        let (interval_s, times_s) = (sample_rate_hz.recip(), &samples.t_s[used.clone()]);
        let beside_s = |first: Option<&f64>, last: Option<&f64>| {
            [first.map_or(0.0, |t| t - setting.t_start_s), last.map_or(0.0, |t| setting.t_end_s - t)]
                .map(|s| s - 0.5 * interval_s)
        };
        SettingCourse {
            begin_s: setting.t_start_s,
            end_s: setting.t_end_s,
            is_zero: setting.field.0 == [0.0; 3],
            interval_s,
            beside_s: beside_s(times_s.first(), times_s.last()),
            values: (&samples.reading_ent[used]).into(),
        }
    };
    let courses: Vec<SettingCourse> = list.iter().map(|p| course(&p.setting)).collect();
    plateau::displacement(&courses, sample_rate_hz.recip())
}

/// The changes of the field, with what is applied in the pauses: nothing, the setting before, or the one after, as the samples say, which are
/// late by `shift_s`.
fn steps(record: &Record, list: &[Plateau], samples: &Samples, shift_s: f64) -> Vec<Step> {
    let level = |field: [f64; 3]| record.reading(field);
    let mut votes = [0usize; 3];
    for pair in list.windows(2) {
        let (end, begin) = (pair[0].setting.t_end_s, pair[1].setting.t_start_s);
        let middle = samples.t_s.partition_point(|t| *t < 0.5 * (end + begin) + shift_s);
        let Some(reading) = samples.reading_ent.get(middle).filter(|_| begin > end) else { continue };
        let zero = [0.0; 3];
        let options = [zero, level(pair[0].setting.field.0), level(pair[1].setting.field.0)];
        let distance = |o: &[f64; 3]| (0..3).map(|a| (reading[a] - o[a]).powi(2)).sum::<f64>();
        let best = (0..3).min_by(|a, b| distance(&options[*a]).total_cmp(&distance(&options[*b])));
        if let Some(best) = best {
            votes[best] += 1;
        }
    }
    let pause = (0..3).max_by_key(|k| votes[*k]).unwrap_or(0);
    let mut steps = Vec::new();
    let mut now = [0.0; 3];
    let mut turn = |t_s: f64, to: [f64; 3], now: &mut [f64; 3]| {
        let change_ent: [f64; 3] = std::array::from_fn(|a| to[a] - now[a]);
        if change_ent.iter().any(|c| c.abs() > 0.0) {
            steps.push(Step { t_s, change_ent });
        }
        *now = to;
    };
    for (i, plateau) in list.iter().enumerate() {
        turn(plateau.setting.t_start_s, level(plateau.setting.field.0), &mut now);
        let next = list.get(i + 1);
        if next.is_none_or(|n| n.setting.t_start_s > plateau.setting.t_end_s + 1e-9) {
            let to = match (pause, next) {
                (0, _) | (2, None) => [0.0; 3],
                (2, Some(next)) => level(next.setting.field.0),
                _ => now,
            };
            turn(plateau.setting.t_end_s, to, &mut now);
        }
    }
    steps
}
