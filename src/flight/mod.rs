//! From telemetry to calibrated levels: one file per step, levels are lists of steps (RO-IGEP-TR0028 section 4).
//!
//! The vectors of one sensor and day stand in [`Block`]s of columns. A [`Step`] changes every vector of a block by itself, so that blocks go
//! through the steps side by side; what needs the neighbours of a vector (means, wheels, heaters, two sensors) works on the [`Series`] of
//! a day.

pub mod assemble;
pub mod attitude;
pub mod calm;
pub mod comparison;
pub mod counts;
pub mod daily;
pub mod daily_fit;
pub mod delay;
pub mod disturbance;
pub mod field_steps;
pub mod ground;
pub mod heater;
pub mod housekeeping;
pub mod made;
pub mod means;
pub mod offsets;
pub mod rotate;
pub mod screens;
pub mod table_edges;
pub mod temperature;
pub mod two_sensors;
pub mod wheels;

use crate::data::flags::Flags;
use crate::data::time::Tt2000;

/// Vectors in a row of columns, all of one length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Block {
    /// Corrected times, rising.
    pub time: Vec<Tt2000>,
    /// Clock of the spacecraft, s since 2003, corrected as the times.
    pub obt_s: Vec<f64>,
    /// What is calibrated: counts at first, then enT, then nT; nan where there is no vector.
    pub field: [Vec<f64>; 3],
    /// Counts of the thermistor.
    pub thermistor: Vec<f64>,
    /// Sensor temperature, °C.
    pub t_degc: Vec<f64>,
    /// Index of the mode.
    pub mode: Vec<u8>,
    /// Quality as it was read.
    pub quality: Vec<u8>,
    /// Range index.
    pub range: Vec<u8>,
    /// Flags.
    pub flags: Vec<u32>,
    /// Covariance of a vector that others do not share as a whole, nT², in the order of `SYMMETRIC`: noise of the reading and error of the
    /// thermistor; empty if it is not wanted.
    pub own_nt2: Vec<[f32; 6]>,
    /// Change of the field with one standard uncertainty of the thermistor reading, nT: this part of `own_nt2` all vectors share that have the
    /// same reading. Empty if it is not wanted.
    pub thermistor_nt: Vec<[f32; 3]>,
    /// Covariance that all vectors share, nT²; empty if it is not wanted.
    pub common_nt2: Vec<[f32; 6]>,
}

impl Block {
    /// Vectors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// The rows whose times lie in a stretch.
    #[must_use]
    pub fn rows_in(&self, span: &std::ops::Range<Tt2000>) -> std::ops::Range<usize> {
        self.time.partition_point(|t| *t < span.start)..self.time.partition_point(|t| *t < span.end)
    }

    /// Some of its vectors.
    #[must_use]
    pub fn part(&self, rows: &std::ops::Range<usize>) -> Block {
        fn cut<T: Clone>(list: &[T], rows: &std::ops::Range<usize>) -> Vec<T> {
            list.get(rows.clone()).map(<[_]>::to_vec).unwrap_or_default()
        }
        let uncertain = (cut(&self.own_nt2, rows), cut(&self.thermistor_nt, rows), cut(&self.common_nt2, rows));
        let rows = rows.clone();
        Block {
            time: self.time[rows.clone()].to_vec(),
            obt_s: self.obt_s[rows.clone()].to_vec(),
            field: self.field.each_ref().map(|c| c[rows.clone()].to_vec()),
            thermistor: self.thermistor[rows.clone()].to_vec(),
            t_degc: self.t_degc[rows.clone()].to_vec(),
            mode: self.mode[rows.clone()].to_vec(),
            quality: self.quality[rows.clone()].to_vec(),
            range: self.range[rows.clone()].to_vec(),
            flags: self.flags[rows].to_vec(),
            own_nt2: uncertain.0,
            thermistor_nt: uncertain.1,
            common_nt2: uncertain.2,
        }
    }

    /// Puts vectors back where [`Block::part`] took them from, from a row on, with what a step may have changed.
    pub fn put_part(&mut self, begin: usize, part: &Block) {
        let rows = begin..begin + part.len();
        (0..3).for_each(|i| self.field[i][rows.clone()].copy_from_slice(&part.field[i]));
        self.t_degc[rows.clone()].copy_from_slice(&part.t_degc);
        self.flags[rows.clone()].copy_from_slice(&part.flags);
        for (own, other) in [(&mut self.own_nt2, &part.own_nt2), (&mut self.common_nt2, &part.common_nt2)] {
            if let Some(place) = own.get_mut(rows.clone()) {
                place.copy_from_slice(other);
            }
        }
        if let Some(place) = self.thermistor_nt.get_mut(rows) {
            place.copy_from_slice(&part.thermistor_nt);
        }
    }

    /// One vector.
    #[must_use]
    pub fn vector(&self, row: usize) -> nalgebra::Vector3<f64> {
        nalgebra::Vector3::new(self.field[0][row], self.field[1][row], self.field[2][row])
    }

    /// Puts a vector in its place.
    pub fn put(&mut self, row: usize, vector: &nalgebra::Vector3<f64>) {
        (0..3).for_each(|i| self.field[i][row] = vector[i]);
    }

    /// Takes a vector away, with the reason.
    pub fn take_away(&mut self, row: usize, reason: Flags) {
        self.flags[row] |= reason.0;
        (0..3).for_each(|i| self.field[i][row] = f64::NAN);
        for list in [&mut self.own_nt2, &mut self.common_nt2] {
            if let Some(covariance) = list.get_mut(row) {
                *covariance = [f32::NAN; 6];
            }
        }
        if let Some(change) = self.thermistor_nt.get_mut(row) {
            *change = [f32::NAN; 3];
        }
    }

    /// Turns the covariances of a vector.
    pub fn turn_covariances(&mut self, row: usize, rotation: &nalgebra::Matrix3<f64>) {
        for list in [&mut self.own_nt2, &mut self.common_nt2] {
            if let Some(covariance) = list.get_mut(row) {
                *covariance = turned(rotation, covariance);
            }
        }
        if let Some(change) = self.thermistor_nt.get_mut(row) {
            let turned = rotation * nalgebra::Vector3::from(change.map(f64::from));
            #[expect(clippy::cast_possible_truncation, reason = "uncertainties need few digits")]
            (0..3).for_each(|i| change[i] = turned[i] as f32);
        }
    }
}

/// `R C Rᵀ` in single precision.
fn turned(rotation: &nalgebra::Matrix3<f64>, covariance: &[f32; 6]) -> [f32; 6] {
    let wide = covariance.map(f64::from);
    #[expect(clippy::cast_possible_truncation, reason = "variances need few digits")]
    crate::model::field_calibration::turned(rotation, &wide).map(|v| v as f32)
}

/// A step that changes every vector by itself.
pub trait Step: Send + Sync {
    /// Changes the vectors of a block.
    fn apply(&self, block: &mut Block);
}

/// The levels of single vectors: A in axes of the sensor, B in those of the spacecraft, C in the celestial frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Axes of the sensor.
    A,
    /// Axes of the spacecraft.
    B,
    /// Celestial frame.
    C,
}

/// The stage that a step leads to; `None` for no step of this name.
#[must_use]
pub fn stage_of(step: &str) -> Option<Stage> {
    Some(match step {
        "counts" | "temperature" | "ground" | "daily" | "shift" | "disturbance" => Stage::A,
        "rotate" | "offsets" => Stage::B,
        "attitude" => Stage::C,
        _ => return None,
    })
}

/// The vectors of a day as one series, for what needs their neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Corrected times, rising.
    pub time: Vec<Tt2000>,
    /// nT; nan where there is no vector.
    pub field_nt: [Vec<f64>; 3],
    /// Index of the mode.
    pub mode: Vec<u8>,
    /// Flags.
    pub flags: Vec<u32>,
}

impl Series {
    /// The vectors of blocks, one block after the other.
    #[must_use]
    pub fn of(blocks: &[Block]) -> Self {
        let mut out = Self::default();
        for block in blocks {
            out.time.extend_from_slice(&block.time);
            (0..3).for_each(|i| out.field_nt[i].extend_from_slice(&block.field[i]));
            out.mode.extend_from_slice(&block.mode);
            out.flags.extend_from_slice(&block.flags);
        }
        out
    }
}
