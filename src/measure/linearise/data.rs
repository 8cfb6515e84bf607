//! The runs of a linearisation as its fits take them.

use crate::data::plateau::Plateau;
use crate::measure::lin::Lin;
use nalgebra::{DMatrix, DVector};

/// One run made ready.
pub(super) struct Data<'a> {
    /// Its linear calibration.
    pub lin: &'a Lin,
    /// The plateaus that were used.
    pub used: Vec<&'a Plateau>,
    /// Field, then powers of τ: the design of its own fit.
    pub own: DMatrix<f64>,
}

impl<'a> Data<'a> {
    /// From the linear calibration of the run.
    pub fn of(lin: &'a Lin) -> Self {
        let offset = &lin.calibration.offset;
        let [begin, end] = offset.tau_span_s;
        let tau = |t_s: f64| if end > begin { 2.0 * (t_s - begin) / (end - begin) - 1.0 } else { 0.0 };
        let used: Vec<&Plateau> = lin.blocks.iter().map(|b| &b.plateau).filter(|p| p.dropped.is_none()).collect();
        let own = DMatrix::from_fn(used.len(), 4 + offset.trend_order, |row, column| {
            let p = used[row];
            if column < 3 { p.setting.field.0[column] } else { tau(p.t_s()).powi(column as i32 - 3) }
        });
        Self { lin, used, own }
    }

    /// Whether it says something beside its own parameters.
    pub fn is_long_enough(&self) -> bool {
        self.own.nrows() > self.own.ncols() + 2
    }

    /// Mean readings of a sensor axis, enT.
    pub fn readings(&self, axis: usize) -> DVector<f64> {
        DVector::from_iterator(self.used.len(), self.used.iter().map(|p| p.mean.0[axis]))
    }

    /// Fields along a coil axis, nT.
    pub fn fields(&self, coil: usize) -> impl Iterator<Item = f64> {
        self.used.iter().map(move |p| p.setting.field.0[coil])
    }
}
