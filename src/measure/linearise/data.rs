//! The runs of a linearisation as its fits take them.

use crate::data::calibration::SlopeSource;
use crate::data::plateau::Plateau;
use crate::measure::lin::{Block, Lin};
use nalgebra::{DMatrix, DVector};

/// One run made ready.
#[derive(Clone)]
pub(super) struct Data<'a> {
    /// Its linear calibration.
    pub lin: &'a Lin,
    /// The plateaus that were used, with their readings.
    pub used: Vec<&'a Block>,
    /// Field, then powers of τ, then what follows the temperature where that moves: the design of its own fit.
    pub own: DMatrix<f64>,
    /// Whether readings count as they were measured: slopes with the temperature that were found without a polynomial have taken a part of it.
    pub is_as_measured: bool,
}

impl<'a> Data<'a> {
    /// From the linear calibration of the run.
    pub fn of(lin: &'a Lin) -> Self {
        let offset = &lin.calibration.offset;
        let [begin, end] = offset.tau_span_s;
        let tau = |t_s: f64| if end > begin { 2.0 * (t_s - begin) / (end - begin) - 1.0 } else { 0.0 };
        let used: Vec<&Block> = lin.blocks.iter().filter(|b| b.plateau.dropped.is_none()).collect();
        let powers = 4 + offset.trend_order;
        let moving = lin.with_temperature.as_ref().map_or(0, DMatrix::ncols);
        let own = DMatrix::from_fn(used.len(), powers + moving, |row, column| {
            let p = &used[row].plateau;
            match (column.checked_sub(powers), &lin.with_temperature) {
                (Some(column), Some(columns)) => columns[(row, column)],
                _ if column < 3 => p.setting.field.0[column],
                _ => tau(p.t_s()).powi(column as i32 - 3),
            }
        });
        let slopes = lin.calibration.slopes.as_ref();
        let is_as_measured = slopes.is_some_and(|s| !matches!(s.source, SlopeSource::Polynomials(_)));
        Self { lin, used, own, is_as_measured }
    }

    /// Whether it says something beside its own parameters.
    pub fn is_long_enough(&self) -> bool {
        self.own.nrows() > self.own.ncols() + 2
    }

    /// The plateaus that were used.
    pub fn plateaus(&self) -> Vec<&'a Plateau> {
        self.used.iter().map(|b| &b.plateau).collect()
    }

    /// Mean readings of a sensor axis, enT.
    pub fn readings(&self, axis: usize) -> DVector<f64> {
        let reading = |b: &&Block| if self.is_as_measured { b.reading_ent()[axis] } else { b.plateau.mean.0[axis] };
        DVector::from_iterator(self.used.len(), self.used.iter().map(reading))
    }

    /// Fields along a coil axis, nT.
    pub fn fields(&self, coil: usize) -> impl Iterator<Item = f64> {
        self.used.iter().map(move |b| b.plateau.setting.field.0[coil])
    }
}
