//! What flight processing has to find in telemetry, counted from what was made.

use super::Telemetry;
use super::schedule::Row;
use super::tables::attitude_times;
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000, date_of, ns};
use crate::files::twin::telemetry::TelemetryTwin;
use crate::flight::temperature::Thermometer;
use serde::Serialize;
use std::collections::BTreeMap;

/// Neighbours of the table of attitudes that are further apart leave a hole, s.
pub const ATTITUDE_GAP_S: f64 = 60.0;
/// A vector follows a gap if it is later than so many steps.
const GAP_STEPS: f64 = 1.5;

/// A day of a sensor by corrected times.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DayTruth {
    /// Day, `YYYY-MM-DD`.
    pub day: String,
    /// Rows.
    pub read: usize,
    /// Rows that repeat others.
    pub duplicates: usize,
    /// Bad vectors, each once.
    pub rejected: usize,
    /// Vectors that remain.
    pub written: usize,
    /// Vectors by flag, in the words of flight processing.
    pub flags: BTreeMap<&'static str, usize>,
}

/// The name of a day.
#[must_use]
pub fn name(day: i32) -> String {
    let date = date_of(day);
    format!("{:04}-{:02}-{:02}", date.year(), date.month(), date.day())
}

/// Counts rows and flags of a sensor.
#[must_use]
pub fn days(
    twin: &TelemetryTwin,
    index: usize,
    rows: &[Row],
    counts: &[Vec<f64>; 3],
    thermometer: &Thermometer,
    leap: &LeapSeconds,
) -> Vec<DayTruth> {
    let sensor = &twin.sensors[index];
    let attitude = attitude_times(twin);
    let limits = super::readings::CONVERTER.limits();
    let mut days: BTreeMap<i32, DayTruth> = BTreeMap::new();
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by_key(|i| (rows[*i].time, *i));
    let mut before: Option<Tt2000> = None;
    for i in order {
        let row = &rows[i];
        let utc = leap.utc(row.time);
        let own = days.entry(utc.day).or_insert_with(|| DayTruth { day: name(utc.day), ..DayTruth::default() });
        own.read += 1;
        if row.repeated {
            own.duplicates += 1;
            continue;
        }
        if row.bad != 0 {
            own.rejected += 1;
            continue;
        }
        own.written += 1;
        let rate = twin.modes[usize::from(row.mode)].rates[index].map_or(f64::NAN, |r| r.rate_hz);
        #[expect(clippy::cast_precision_loss, reason = "differences of times")]
        let late = before.is_some_and(|t| (row.time - t) as f64 / SECOND_NS as f64 * rate > GAP_STEPS);
        before = Some(row.time);
        let next = attitude.partition_point(|t| *t <= row.time);
        let hole = match (next.checked_sub(1).map(|k| attitude[k]), attitude.get(next)) {
            (Some(last), Some(next)) => last < row.time && (next - last) > ns(ATTITUDE_GAP_S),
            (last, _) => last != Some(row.time),
        };
        let [low, high] = sensor.valid_degc;
        let flags = [
            (Flags::TEMPERATURE, !(low..=high).contains(&thermometer.degc(row.thermistor[index]))),
            (Flags::ROTATION, !sensor.rotations.iter().any(|state| state.span.holds(row.time))),
            (Flags::JUMP, !sensor.jumps.is_empty() && !sensor.jumps.iter().any(|jump| jump.span.holds(row.time))),
            (Flags::ATTITUDE, hole),
            (Flags::LEAP, utc.in_leap_second()),
            (Flags::GAP, late),
            (Flags::SATURATED, counts.iter().any(|c| limits.contains(&c[i]))),
        ];
        for (flag, _) in flags.into_iter().filter(|(_, set)| *set) {
            let words = Flags::ALL.iter().find(|(f, _)| *f == flag).map_or("", |(_, words)| *words);
            *own.flags.entry(words).or_default() += 1;
        }
    }
    days.into_values().collect()
}

#[derive(Serialize)]
struct SensorTruth<'a> {
    name: &'a str,
    ground_sensor: &'a str,
    frame: String,
    sigma: &'a [Vec<f64>; 3],
    xi_deg: &'a [Vec<f64>; 3],
    b_off_ent: &'a [Vec<f64>; 3],
    thermistor_degc: &'a [f64],
    t_off_degc: f64,
    noise_ent: f64,
    packets_arrived: usize,
    packets_lost: usize,
    packets_repeated: usize,
    packets_swapped: usize,
    days: &'a [DayTruth],
    daily_nt: Vec<DailyTruth<'a>>,
}

#[derive(Serialize)]
struct DailyTruth<'a> {
    day: String,
    polynomials: &'a [Vec<f64>; 3],
    continuity_nt: [f64; 3],
}

#[derive(Serialize)]
struct Truth<'a> {
    written_by: String,
    seed: u64,
    exact: bool,
    truth_every: u32,
    heater_sc_nt: BTreeMap<&'a str, [f64; 3]>,
    coupling: [[f64; 3]; 3],
    factors: BTreeMap<&'static str, f64>,
    sensors: Vec<SensorTruth<'a>>,
}

/// The truth that is no table.
///
/// # Errors
/// Values that have no text form.
pub fn json(telemetry: &Telemetry<'_>) -> Result<String, Finding> {
    let twin = telemetry.twin;
    let sensors = twin.sensors.iter().zip(&telemetry.sensors).map(|(stated, made)| {
        let daily = made.daily.polynomials.iter().map(|(day, polynomials)| DailyTruth {
            day: name(*day),
            polynomials,
            continuity_nt: made.daily.continuity_nt.get(day).copied().unwrap_or_default(),
        });
        SensorTruth {
            name: &stated.name,
            ground_sensor: &stated.twin.name,
            frame: stated.frame.to_string(),
            sigma: &stated.twin.model.sigma,
            xi_deg: &stated.twin.model.xi_deg,
            b_off_ent: &stated.twin.model.b_off_ent,
            thermistor_degc: &stated.thermistor_degc,
            t_off_degc: stated.t_off_degc,
            noise_ent: stated.noise_ent,
            packets_arrived: made.packets.arrived,
            packets_lost: made.packets.lost,
            packets_repeated: made.packets.repeated,
            packets_swapped: made.packets.swapped,
            days: &made.days,
            daily_nt: daily.collect(),
        }
    });
    let coupling = twin.spacecraft.coupling;
    let truth = Truth {
        written_by: format!("calfit {}", env!("CARGO_PKG_VERSION")),
        seed: telemetry.seed,
        exact: twin.exact,
        truth_every: twin.truth_every,
        heater_sc_nt: twin.heaters.iter().map(|h| (h.name.as_str(), h.field_nt)).collect(),
        coupling: std::array::from_fn(|row| std::array::from_fn(|column| coupling[(row, column)])),
        factors: ["heaters", "wheels", "lines"].into_iter().zip(twin.spacecraft.factors).collect(),
        sensors: sensors.collect(),
    };
    let mut text = serde_json::to_string_pretty(&truth)
        .map_err(|e| Finding::error("truth.json", format!("the truth has no text form: {e}"), "correct the twin"))?;
    text.push('\n');
    Ok(text)
}
