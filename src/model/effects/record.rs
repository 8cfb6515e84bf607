//! What a run tells about the conditions of each reading: the covariates that effects are functions of.

use super::Unseen;
use crate::data::run::{Kind, interpolate};
use crate::data::units::Scale;
use crate::fit::smooth::Course;
use nalgebra::{Matrix3, Vector3};

/// Settings before a reading that it may depend on.
pub const EARLIER: usize = 3;

/// Conditions of one reading, or of the mean of the readings of a plateau.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Run, by its index.
    pub run: usize,
    /// First and last time, s since the run's start; equal for a single sample.
    pub used_s: [f64; 2],
    /// Reference field, nT, coil axes.
    pub field_coil_nt: [f64; 3],
    /// Reference fields of the settings before, nT, coil axes, the last of them first; zero where there is none.
    pub earlier_coil_nt: [[f64; 3]; EARLIER],
    /// Reading of the linear sensor without its offset, enT.
    pub linear_ent: [f64; 3],
}

/// Fields of the settings before, given by how many settings they lie back; zero where there is none.
#[must_use]
pub fn earlier_fields(field_nt: impl Fn(usize) -> Option<[f64; 3]>) -> [[f64; 3]; EARLIER] {
    std::array::from_fn(|k| field_nt(k + 1).unwrap_or_default())
}

impl Row {
    /// Middle, s since the run's start.
    #[must_use]
    pub fn t_s(&self) -> f64 {
        0.5 * (self.used_s[0] + self.used_s[1])
    }

    /// Modulus of the reference field, nT.
    #[must_use]
    pub fn modulus_nt(&self) -> f64 {
        Vector3::from(self.field_coil_nt).norm()
    }
}

/// A change of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Time, s since the run's start.
    pub t_s: f64,
    /// Change of the reading of the linear sensor, enT.
    pub change_ent: [f64; 3],
}

/// Response and offset as polynomials of the sensor temperature, of `u = (T - middle) / half`.
#[derive(Clone, Debug, PartialEq)]
pub struct Thermal {
    /// Middle of the temperatures, °C.
    pub middle_degc: f64,
    /// Half of their range, K.
    pub half_k: f64,
    /// Response, enT/nT, one matrix per power of u.
    pub response: Vec<Matrix3<f64>>,
    /// Offset, enT, one vector per power of u.
    pub offset_ent: Vec<[f64; 3]>,
    /// Temperature of every row, °C.
    pub degc: Vec<f64>,
}

impl Thermal {
    /// `(T - middle) / half` of a row.
    #[must_use]
    pub fn u(&self, row: usize) -> f64 {
        (self.degc[row] - self.middle_degc) / self.half_k
    }

    /// Change of the reading in a field per kelvin, enT/K.
    #[must_use]
    pub fn slope(&self, row: usize, field_coil_nt: [f64; 3]) -> [f64; 3] {
        let u = self.u(row);
        let field = Vector3::from(field_coil_nt);
        let mut slope = Vector3::zeros();
        for (power, (response, offset)) in self.response.iter().zip(&self.offset_ent).enumerate().skip(1) {
            slope += (response * field + Vector3::from(*offset)) * (power as f64 * u.powi(power as i32 - 1) / self.half_k);
        }
        slope.into()
    }
}

/// A slow channel at every row, with its readings.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name.
    pub name: String,
    /// Readings over the time since the run's start.
    pub course: Course,
    /// Mean over the time of each row.
    pub values: Vec<f64>,
    /// Mean over the rows of the run, to which effects refer; the rows may be only a part of them.
    pub mean: f64,
}

/// The rows of one or several runs with their covariates.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Kind of the runs.
    pub kind: Kind,
    /// What the readings are; effects state their sizes in it.
    pub scale: Scale,
    /// Rows in time order, run after run.
    pub rows: Vec<Row>,
    /// Response of the linear sensor, enT/nT, coil axes to sensor axes.
    pub response: Matrix3<f64>,
    /// First and last time, s.
    pub span_s: [f64; 2],
    /// Changes of the field, in time order; pauses between the settings included.
    pub steps: Vec<Step>,
    /// Sensor temperature, °C.
    pub sensor: Option<Channel>,
    /// Other temperatures of the sensor, °C: more thermistors that move with it.
    pub thermistors: Vec<Channel>,
    /// Coil temperature, °C.
    pub coil: Option<Channel>,
    /// Temperature of the facility's electronics, °C.
    pub rack: Option<Channel>,
    /// Variometer, nT.
    pub variometer: Option<[Channel; 3]>,
    /// All other channels.
    pub others: Vec<Channel>,
    /// The linear sensor as a function of its temperature, for sweeps.
    pub thermal: Option<Thermal>,
    /// Order of the polynomial in time that the model of the offset has where it is no polynomial of the temperature.
    pub trend_order: usize,
    /// Whether the rows are samples or means of samples (and not means that a file brought).
    pub has_samples: bool,
}

impl Record {
    /// Time from -1 to 1 over the record.
    #[must_use]
    pub fn tau(&self, t_s: f64) -> f64 {
        let [begin, end] = self.span_s;
        if end > begin { 2.0 * (t_s - begin) / (end - begin) - 1.0 } else { 0.0 }
    }

    /// Largest reading of an axis, enT.
    #[must_use]
    pub fn most_ent(&self, axis: usize) -> f64 {
        self.rows.iter().map(|r| r.linear_ent[axis].abs()).fold(0.0, f64::max)
    }

    /// Whether fields are applied.
    #[must_use]
    pub fn has_fields(&self) -> bool {
        self.rows.iter().any(|r| r.modulus_nt() > 0.0)
    }

    /// Change of the reading that a change of the field makes, enT.
    #[must_use]
    pub fn reading(&self, field_coil_nt: [f64; 3]) -> [f64; 3] {
        (self.response * Vector3::from(field_coil_nt)).into()
    }

    /// Change of the readings of a row while its field stays, because the temperature moves, enT/s; zero without a model of the temperature.
    #[must_use]
    pub fn drift_ent_per_s(&self, row: usize) -> [f64; 3] {
        let Some(thermal) = &self.thermal else { return [0.0; 3] };
        let (from, to) = (row.saturating_sub(1), (row + 1).min(self.rows.len() - 1));
        let seconds = self.rows[to].t_s() - self.rows[from].t_s();
        let kelvin = thermal.degc[to] - thermal.degc[from];
        thermal.slope(row, self.rows[row].field_coil_nt).map(|s| if seconds > 0.0 { s * kelvin / seconds } else { 0.0 })
    }

    /// What a run without fields cannot show.
    ///
    /// # Errors
    /// The reason.
    pub fn require_fields(&self) -> Result<(), Unseen> {
        if self.has_fields() { Ok(()) } else { Err(Unseen::NoField) }
    }
}

/// Values of a channel without their mean: what a fit with a constant can tell of it.
#[must_use]
pub fn centred(channel: &Channel) -> Vec<f64> {
    channel.values.iter().map(|v| v - channel.mean).collect()
}

/// Values of a channel some time before each row, without the mean of the run; where that is before its first reading, the first one.
#[must_use]
pub fn delayed(channel: &Channel, rows: &[Row], lag_s: f64) -> Vec<f64> {
    rows.iter().map(|row| interpolate(&channel.course.series, row.t_s() - lag_s) - channel.mean).collect()
}
