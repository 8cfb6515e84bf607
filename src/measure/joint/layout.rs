//! Where the parameters of the joint fit stand, and the plateaus of a run made ready for it.

use super::{JointError, JointRun, QUANTITIES, Trend};
use crate::fit::{FitError, order};
use crate::model::polynomial::powers_of_line;
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, DVector, Vector3};

/// Where the parameters stand: the coefficients of the quantities in powers of the mapped temperature, angles in radians, then
/// for each run the rotation vector from its start, radians, one vector per power of the mapped temperature.
pub(super) struct Layout {
    /// First coefficient of each quantity, and the end of the last.
    pub(super) starts: [usize; 7],
    /// First coefficient of the rotation of each run, and the end of the last.
    turns: Vec<usize>,
    pub(super) centre_degc: f64,
    pub(super) half_range_degc: f64,
    pub(super) span_degc: [f64; 2],
    pub(super) rows: usize,
    pub(super) names: Vec<String>,
}

impl Layout {
    pub(super) fn over(runs: &[JointRun], start: &[Vec<f64>; 6]) -> Result<Self, JointError> {
        if runs.is_empty() {
            return Err(JointError::NoRuns);
        }
        let temperatures = || runs.iter().flat_map(|run| &run.plateaus).map(|p| p.temperature_degc);
        let low = temperatures().fold(f64::INFINITY, f64::min);
        let high = temperatures().fold(f64::NEG_INFINITY, f64::max);
        let mut starts = [0; 7];
        let mut names = Vec::new();
        for (i, (coefficients, quantity)) in start.iter().zip(QUANTITIES).enumerate() {
            if coefficients.is_empty() || coefficients.iter().any(|c| !c.is_finite()) {
                return Err(JointError::Start { quantity });
            }
            let order = coefficients.len() - 1;
            if order > order::HIGHEST_ORDER {
                return Err(FitError::OrderTooHigh { order, highest: order::HIGHEST_ORDER }.into());
            }
            starts[i + 1] = starts[i] + coefficients.len();
            names.extend((0..=order).map(|k| format!("{quantity} T^{k}")));
        }
        let mut turns = vec![starts[6]];
        for run in runs {
            let name = |power: usize, axis: &str| match power {
                0 => format!("the rotation of run {} about {axis}", run.run),
                _ => format!("the rotation of run {} about {axis}, T^{power}", run.run),
            };
            names.extend((0..=run.rotation_order).flat_map(|power| ["x", "y", "z"].map(|axis| name(power, axis))));
            turns.push(names.len());
        }
        Ok(Layout {
            starts,
            turns,
            centre_degc: 0.5 * (low + high),
            half_range_degc: if high > low { 0.5 * (high - low) } else { 1.0 },
            span_degc: [low, high],
            rows: runs.iter().map(|run| 3 * run.plateaus.len()).sum(),
            names,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.names.len()
    }

    /// The rotation of a run.
    pub(super) fn turn(&self, run: usize) -> std::ops::Range<usize> {
        self.turns[run]..self.turns[run + 1]
    }

    /// A temperature, °C, mapped to -1 to 1.
    pub(super) fn mapped(&self, degc: f64) -> f64 {
        (degc - self.centre_degc) / self.half_range_degc
    }

    pub(super) fn range(&self, quantity: usize) -> std::ops::Range<usize> {
        self.starts[quantity]..self.starts[quantity + 1]
    }

    /// Factor from the unit in which a quantity is fitted to the one it is given in.
    pub(super) fn unit(quantity: usize) -> f64 {
        if quantity < 3 { 1.0 } else { 1f64.to_degrees() }
    }

    /// Column k holds `((T - centre) / half range)^k` in powers of T.
    pub(super) fn to_raw(&self, count: usize) -> DMatrix<f64> {
        powers_of_line(count, -self.centre_degc / self.half_range_degc, 1.0 / self.half_range_degc)
    }

    /// The start in mapped powers; the rotations start at zero.
    pub(super) fn start(&self, start: &[Vec<f64>; 6]) -> DVector<f64> {
        let mut parameters = DVector::zeros(self.count());
        for (i, coefficients) in start.iter().enumerate() {
            let to_mapped = powers_of_line(coefficients.len(), self.centre_degc, self.half_range_degc);
            let mapped = to_mapped * DVector::from_column_slice(coefficients) / Self::unit(i);
            parameters.rows_mut(self.starts[i], coefficients.len()).copy_from(&mapped);
        }
        parameters
    }
}

/// A run made ready.
pub(super) struct RunRows {
    /// The applied field along the sensor axes of the start were they orthogonal, `ρ⁻¹ R_nom⁻¹ B_c`, nT.
    pub(super) fields: Vec<Vector3<f64>>,
    pub(super) readings: Vec<[f64; 3]>,
    /// Mapped temperatures.
    pub(super) mapped: Vec<f64>,
    /// Orthonormal columns of which the first span the offset trend of a component: one more than its order.
    trend: DMatrix<f64>,
    /// The offset.
    pub(super) offset: Trend,
    pub(super) noise: [f64; 3],
}

impl RunRows {
    pub(super) fn of(run: &JointRun, layout: &Layout) -> Self {
        let to_sensor = run.rho.transpose() * run.r_nom.transpose();
        let plateaus = || run.plateaus.iter();
        let begin = plateaus().map(|p| p.t_s).fold(f64::INFINITY, f64::min);
        let end = plateaus().map(|p| p.t_s).fold(f64::NEG_INFINITY, f64::max);
        let tau = |t_s: f64| if end > begin { 2.0 * (t_s - begin) / (end - begin) - 1.0 } else { 0.0 };
        let mapped: Vec<f64> = plateaus().map(|p| layout.mapped(p.temperature_degc)).collect();
        let powers = DMatrix::from_fn(run.plateaus.len(), run.trend.highest() + 1, |k, j| match run.trend {
            Trend::Time(_) => tau(run.plateaus[k].t_s).powi(j as i32),
            Trend::Temperature(_) => mapped[k].powi(j as i32),
        });
        RunRows {
            fields: plateaus().map(|p| to_sensor * Vector3::from(p.field_coil_nt)).collect(),
            readings: plateaus().map(|p| p.reading_ent).collect(),
            mapped,
            trend: QR::new(powers).q(),
            offset: run.trend,
            noise: run.noise_ent,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.fields.len()
    }

    /// Takes the part along the trend of a component out of a column, one value per plateau.
    pub(super) fn project(&self, component: usize, column: &mut [f64]) {
        for direction in self.trend.columns(0, self.offset.order(component) + 1).column_iter() {
            let share: f64 = direction.iter().zip(column.iter()).map(|(a, b)| a * b).sum();
            column.iter_mut().zip(direction.iter()).for_each(|(value, d)| *value -= share * d);
        }
    }
}
