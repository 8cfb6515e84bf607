//! The settings of a sweep as its fits take them, and the linear model that comes near.

use crate::data::plateau::Plateau;
use crate::data::run::interpolate;
use crate::record::baseline::Baseline;
use nalgebra::DMatrix;

/// Orders of a linear model: of the elements of the response, and of the offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LinearOrders {
    /// Of the response.
    pub response: usize,
    /// Of the offset.
    pub offset: usize,
}

impl LinearOrders {
    /// Parameters of a component.
    pub fn count(self) -> usize {
        3 * (self.response + 1) + self.offset + 1
    }
}

/// The mean readings of the settings that are used, and their fields.
pub(super) struct Means {
    /// Fields, nT.
    pub fields_nt: Vec<[f64; 3]>,
    /// Middles, s since the run's start.
    pub t_s: Vec<f64>,
    /// Readings, enT: a row per setting.
    pub readings_ent: DMatrix<f64>,
}

impl Means {
    /// Of some settings.
    pub fn of(used: &[&Plateau]) -> Self {
        Self {
            fields_nt: used.iter().map(|p| p.setting.field.0).collect(),
            t_s: used.iter().map(|p| p.t_s()).collect(),
            readings_ent: DMatrix::from_fn(used.len(), 3, |row, i| used[row].mean.0[i]),
        }
    }

    /// The linear model with polynomials of the temperature.
    pub fn baseline(&self, degc: &[f64], orders: LinearOrders) -> Baseline {
        Baseline::in_temperature(degc, orders.response, orders.offset)
    }

    /// Minus twice the log likelihood of temperatures of the settings: components count by their own noise.
    pub fn deviance(&self, degc: &[f64], orders: LinearOrders) -> f64 {
        deviance(self.baseline(degc, orders).squares_ent2(&self.fields_nt, degc, &self.readings_ent), degc.len())
    }

    /// Temperatures of the settings by a series, (s, °C).
    pub fn degc(&self, series: &[(f64, f64)]) -> Vec<f64> {
        self.t_s.iter().map(|t| interpolate(series, *t)).collect()
    }
}

/// Minus twice the log likelihood of what a model leaves of so many settings, from the sums of squares of the components.
pub(super) fn deviance(squares: [f64; 3], settings: usize) -> f64 {
    let n = settings as f64;
    squares.iter().map(|s| n * (s / n).ln()).sum()
}
