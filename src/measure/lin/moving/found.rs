//! What a run tells of the slopes itself, with what is known of them besides: conditions on the parameters of a fit with the columns of a
//! temperature.

use super::{Moving, PARAMETERS, Places, derivatives};
use crate::data::calibration::{SlopeSource, SlopeStd, TemperatureSlopes};
use crate::fit::statistics::{fisher_tail, std_of};
use crate::model::campaign::SlopeBounds;
use crate::model::sensor::Split;
use crate::model::sensor_polynomials::SensorChange;
use nalgebra::{DMatrix, DVector, SMatrix};

/// Takes that a parameter, which has a value and a step of it that is known now, is zero within a variance.
pub(super) fn observe(step: &mut DVector<f64>, covariance: &mut DMatrix<f64>, index: usize, value: f64, variance: f64) {
    let column = covariance.column(index).into_owned();
    let total = column[index] + variance;
    if total <= 0.0 {
        return;
    }
    let innovation = -(value + step[index]);
    *step += &column * (innovation / total);
    *covariance -= &column * column.transpose() / total;
}

/// What a fit found with powers of the temperature, as parameters of the sensor: for every power, the zeroth first, three sensitivities,
/// three angles and a turn; then the trends of the components, then the slopes of their offsets.
#[derive(Clone)]
pub(super) struct Found<'a> {
    at: &'a Split,
    places: &'a Places,
    /// From the parameters of the response to its elements, in the sensor frame.
    derivatives: SMatrix<f64, PARAMETERS, PARAMETERS>,
    pub change: SensorChange,
    covariance: DMatrix<f64>,
    /// What conditions on the parameters add to them.
    pub step: DVector<f64>,
}

impl<'a> Found<'a> {
    /// Of a fit at a sensor, with the change that it was made about.
    pub fn of(at: &'a Split, places: &'a Places, covariance: &DMatrix<f64>, change: SensorChange) -> Option<Self> {
        let derivatives = derivatives(at)?;
        let inverse = derivatives.try_inverse()?;
        let to_coil = at.r_nom * at.rho;
        let response = PARAMETERS * (places.powers + 1);
        let trend = places.base - 3;
        let count = response + 3 * (trend + places.offset);
        let mut map = DMatrix::zeros(count, 3 * places.per);
        for a in 0..3 {
            for power in 0..=places.powers {
                for j in 0..3 {
                    let column = places.at(a, power, j);
                    for r in 0..PARAMETERS {
                        map[(PARAMETERS * power + r, column)] = (0..3).map(|c| inverse[(r, 3 * a + c)] * to_coil[(j, c)]).sum();
                    }
                }
            }
            for k in 0..trend {
                map[(response + a * trend + k, a * places.per + 3 + k)] = 1.0;
            }
            if let Some(slope) = places.offset_slope(a) {
                map[(response + 3 * trend + a, slope)] = 1.0;
            }
        }
        let covariance = &map * covariance * map.transpose();
        Some(Self { at, places, derivatives, change, covariance, step: DVector::zeros(count) })
    }

    fn response(&self) -> usize {
        PARAMETERS * (self.places.powers + 1)
    }

    /// Place of the slope of the offset of a component.
    pub fn offset_slope(&self, a: usize) -> usize {
        self.response() + 3 * (self.places.base - 3) + a
    }

    /// Takes that a parameter, which has a value now, is zero within a variance.
    fn observe(&mut self, index: usize, value: f64, variance: f64) {
        observe(&mut self.step, &mut self.covariance, index, value, variance);
    }

    /// The sensor does not turn with its temperature.
    pub fn without_turns(&mut self) {
        for power in 1..=self.places.powers {
            for i in 0..3 {
                self.observe(PARAMETERS * power + 6 + i, self.change.turn[power - 1][i], 0.0);
            }
        }
        self.change.turn.clear();
    }

    /// Slopes are not larger than what is stated of them lets expect; those of the offset are what the fit found, enT/K, if it has them.
    pub fn within(&mut self, bounds: &SlopeBounds, offset: Option<[f64; 3]>) {
        if let (Some(std), Some(offset)) = (bounds.offset_ent_per_k, offset) {
            for a in 0..3 {
                self.observe(self.offset_slope(a), offset[a], std * std);
            }
        }
        for quantity in 0..6 {
            let bound = if quantity < 3 { bounds.sigma_per_k } else { bounds.xi_deg_per_k };
            if let Some(std) = bound {
                self.observe(PARAMETERS + quantity, self.change.sensor[quantity][0], std * std);
            }
        }
        for power in 1..=self.places.powers {
            for quantity in 0..6 {
                self.change.sensor[quantity][power - 1] += self.step[PARAMETERS * power + quantity];
            }
        }
    }

    /// As if the slopes were known to be what they are.
    pub fn with_slopes_known(mut self) -> Self {
        for power in 1..=self.places.powers {
            for quantity in 0..6 {
                let index = PARAMETERS * power + quantity;
                self.observe(index, -self.step[index], 0.0);
            }
        }
        self
    }

    /// Probability that noise alone, which the fit tells with so many degrees of freedom, makes the changes with the highest power as large.
    pub fn probability_of_the_highest(&self, freedom: usize) -> f64 {
        let first = PARAMETERS * self.places.powers;
        let values = DVector::from_fn(6, |q, _| self.change.sensor[q].last().copied().unwrap_or(0.0));
        let scale = DVector::from_fn(6, |q, _| self.covariance[(first + q, first + q)].sqrt());
        let scaled = DMatrix::from_fn(6, 6, |r, c| self.covariance[(first + r, first + c)] / (scale[r] * scale[c]));
        let Some(cholesky) = scaled.cholesky() else { return 1.0 };
        let values = values.component_div(&scale);
        fisher_tail(values.dot(&cholesky.solve(&values)) / 6.0, [6.0, freedom as f64])
    }

    fn std(&self, index: usize) -> f64 {
        std_of(self.covariance[(index, index)])
    }

    /// The slopes at the stated temperature.
    pub fn slopes(&self, moving: &Moving, offset: Option<[f64; 3]>, source: SlopeSource) -> TemperatureSlopes {
        TemperatureSlopes {
            at_degc: moving.at_degc,
            order: self.places.powers,
            sigma: std::array::from_fn(|i| self.change.sensor[i][0]),
            xi_deg: std::array::from_fn(|i| self.change.sensor[3 + i][0]),
            b_or_ent: offset,
            std: SlopeStd {
                sigma: std::array::from_fn(|i| self.std(PARAMETERS + i)),
                xi_deg: std::array::from_fn(|i| self.std(PARAMETERS + 3 + i)),
                b_or_ent: offset.map(|_| std::array::from_fn(|a| self.std(self.offset_slope(a)))),
            },
            source,
        }
    }

    /// Coefficients of the baseline and their covariance.
    pub fn of_baseline(&self, stacked: &[f64]) -> (Vec<f64>, DMatrix<f64>) {
        let base = self.places.base;
        let from_coil = (self.at.r_nom * self.at.rho).transpose();
        let mut map = DMatrix::zeros(3 * base, self.step.len());
        for a in 0..3 {
            for j in 0..3 {
                for r in 0..PARAMETERS {
                    map[(a * base + j, r)] = (0..3).map(|c| self.derivatives[(3 * a + c, r)] * from_coil[(c, j)]).sum();
                }
            }
            for k in 0..base - 3 {
                map[(a * base + 3 + k, self.response() + a * (base - 3) + k)] = 1.0;
            }
        }
        let step = &map * &self.step;
        let values = (0..3 * base).map(|i| stacked[i / base * self.places.per + i % base] + step[i]).collect();
        (values, &map * &self.covariance * map.transpose())
    }
}
