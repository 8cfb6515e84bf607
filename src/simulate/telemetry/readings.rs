//! What a sensor reads: the way of level A back, from the field to counts.

use super::schedule::Row;
use crate::data::convention::{Convention, PlanarAxes};
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::files::flight::mission::Counts;
use crate::files::twin::telemetry::FlightSensor;
use crate::flight::temperature::Thermometer;
use crate::model::polynomial::value;
use crate::simulate::noise::Random;
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// The converter of the readings: 20 bits over ±15000 enT (RO-IGEP-TR0028 section 4.2.3.1).
pub const CONVERTER: Counts = Counts::Converter { bits: 20, full_scale_ent: 15_000.0 };
/// Continuity at midnight ends with a gap that is longer, ns.
pub const RESET_GAP_NS: i64 = 10_800 * SECOND_NS;

/// A sensor at a temperature.
#[derive(Clone, Copy, Debug)]
pub struct Sensing {
    /// From the field in the sensor frame to readings without their offset, enT/nT.
    pub response: Matrix3<f64>,
    /// Offset, enT.
    pub offset_ent: Vector3<f64>,
}

/// A sensor at a temperature, °C, in its frame.
///
/// # Errors
/// Angles that no three axes have between them.
pub fn sensing(sensor: &FlightSensor, degc: f64) -> Result<Sensing, PlanarAxes> {
    let model = &sensor.twin.model;
    let each = |polynomials: &[Vec<f64>; 3]| -> [f64; 3] { std::array::from_fn(|i| value(&polynomials[i], degc)) };
    let matrix = Convention::BepiColombo.omega(each(&model.xi_deg))? * Matrix3::from_diagonal(&Vector3::from(each(&model.sigma)));
    let matrix = sensor.frame.frame_of(&matrix) * matrix;
    let response = matrix.try_inverse().ok_or(PlanarAxes)?;
    Ok(Sensing { response, offset_ent: Vector3::from(model.offset_ent(degc)) })
}

/// The daily offsets of a sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Daily {
    /// Polynomials of x, y, z over the temperature by day since 1970, nT over °C.
    pub polynomials: BTreeMap<i32, [Vec<f64>; 3]>,
    /// `S_d` by day, nT.
    pub continuity_nt: BTreeMap<i32, [f64; 3]>,
}

impl Daily {
    /// The models of the days of a sensor, joined at midnight by the temperatures that telemetry tells.
    #[must_use]
    pub fn new(
        sensor: &FlightSensor,
        index: usize,
        rows: &[Row],
        thermometer: &Thermometer,
        leap: &LeapSeconds,
        seed: u64,
    ) -> Self {
        // The first and the last accepted vector of every day.
        let mut ends: BTreeMap<i32, [(Tt2000, f64); 2]> = BTreeMap::new();
        for row in rows.iter().filter(|row| row.bad == 0) {
            let own = (row.time, row.thermistor[index]);
            let end = ends.entry(leap.utc(row.time).day).or_insert([own; 2]);
            if own.0 < end[0].0 {
                end[0] = own;
            }
            if own.0 > end[1].0 {
                end[1] = own;
            }
        }
        let mut daily = Self::default();
        let mut before: Option<(Tt2000, [f64; 3])> = None;
        for (day, [first, last]) in ends {
            let mut random = Random::new(seed, &["daily", &sensor.name, &day.to_string()]);
            let polynomials = sensor.daily_nt.each_ref().map(|coefficients| -> Vec<f64> {
                coefficients.iter().map(|c| c * (1.0 + sensor.daily_scatter * random.normal())).collect()
            });
            let at = |count: f64| polynomials.each_ref().map(|p| value(p, thermometer.degc(count)));
            let joined = before.filter(|(time, _)| first.0 - time <= RESET_GAP_NS);
            let begin = at(first.1);
            let sum: [f64; 3] = joined.map_or([0.0; 3], |(_, end)| std::array::from_fn(|i| end[i] - begin[i]));
            let end = at(last.1);
            before = Some((last.0, std::array::from_fn(|i| sum[i] + end[i])));
            daily.continuity_nt.insert(day, sum);
            daily.polynomials.insert(day, polynomials);
        }
        daily
    }

    /// The offset at a time, nT.
    #[must_use]
    pub fn at(&self, day: i32, degc: f64) -> Vector3<f64> {
        let (Some(polynomials), Some(sum)) = (self.polynomials.get(&day), self.continuity_nt.get(&day)) else {
            return Vector3::zeros();
        };
        Vector3::from_fn(|i, _| value(&polynomials[i], degc) + sum[i])
    }
}

/// Counts of a reading, enT, without their step.
#[must_use]
pub fn counts(reading_ent: &Vector3<f64>) -> [f64; 3] {
    let (factor, shift) = (CONVERTER.ent_per_count(0), CONVERTER.shift_ent());
    std::array::from_fn(|i| (reading_ent[i] - shift) / factor)
}

/// Counts as the converter gives them.
#[must_use]
pub fn stepped(counts: [f64; 3]) -> [f64; 3] {
    let [low, high] = CONVERTER.limits();
    counts.map(|c| c.round().clamp(low, high))
}
