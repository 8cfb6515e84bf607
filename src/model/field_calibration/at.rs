//! A calibration at one temperature, for the many vectors that were read at it.

use super::{FieldCalibration, PARAMETERS};
use crate::model::polynomial::value;
use nalgebra::{Matrix3, Vector3};

/// Rows and columns of the elements in which symmetric 3 x 3 matrices are kept: xx, xy, xz, yy, yz, zz.
pub const SYMMETRIC: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// Products of (1, m_x, m_y, m_z), m the linearised reading without its offset.
const PRODUCTS: [(usize, usize); 10] = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];

/// Offset, matrix, and the covariance of the field as a polynomial of the reading.
#[derive(Clone, Debug, PartialEq)]
pub struct AtTemperature {
    /// Offset, enT.
    pub offset_ent: Vector3<f64>,
    /// Takes linearised readings without their offset to the field, nT/enT.
    pub matrix: Matrix3<f64>,
    /// Coefficients of the products of (1, m) in the elements of the covariance of the field, nT²; `None` where it is not known.
    covariance: Option<[[f64; 6]; 10]>,
}

impl AtTemperature {
    /// A calibration that is exact.
    #[must_use]
    pub fn exact(offset_ent: Vector3<f64>, matrix: Matrix3<f64>) -> Self {
        Self { offset_ent, matrix, covariance: None }
    }

    /// The covariance of the field, nT², in the order of [`SYMMETRIC`], of a linearised reading without its offset; it is common to all
    /// vectors. Nan where it is not known.
    #[must_use]
    pub fn covariance_nt2(&self, measured: &Vector3<f64>) -> [f64; 6] {
        let Some(coefficients) = &self.covariance else { return [f64::NAN; 6] };
        let m = [1.0, measured.x, measured.y, measured.z];
        let mut sum = [0.0; 6];
        for ((a, b), own) in PRODUCTS.iter().zip(coefficients) {
            let product = m[*a] * m[*b];
            sum.iter_mut().zip(own).for_each(|(s, c)| *s += product * c);
        }
        sum
    }

    /// The same behind a rotation.
    #[must_use]
    pub fn turned(&self, rotation: &Matrix3<f64>) -> Self {
        let covariance = self.covariance.map(|list| list.map(|own| turned(rotation, &own)));
        Self { offset_ent: self.offset_ent, matrix: rotation * self.matrix, covariance }
    }
}

/// `R C Rᵀ` of a symmetric matrix, both in the order of [`SYMMETRIC`].
#[must_use]
pub fn turned(rotation: &Matrix3<f64>, c: &[f64; 6]) -> [f64; 6] {
    let matrix = Matrix3::new(c[0], c[1], c[2], c[1], c[3], c[4], c[2], c[4], c[5]);
    let turned = rotation * matrix * rotation.transpose();
    SYMMETRIC.map(|place| turned[place])
}

impl FieldCalibration {
    /// The calibration at a sensor temperature, °C; `None` for angles of no sensor.
    ///
    /// The covariance is that of [`FieldCalibration::apply`] with its elements beside the diagonal. The uncertainty of a rotation behind the
    /// matrix is not in it.
    #[must_use]
    pub fn at(&self, degc: f64) -> Option<AtTemperature> {
        let slopes = |measured: Vector3<f64>| -> Option<[Vector3<f64>; PARAMETERS]> {
            let slopes = self.field_and_slopes(measured, degc).ok()?;
            Some(slopes.by.map(|column| slopes.rotation * column))
        };
        let matrix = self.matrix(degc)?;
        let offset_ent = Vector3::from(self.offset_ent(degc));
        if self.parts.covariance.is_none() {
            return Some(AtTemperature { offset_ent, matrix, covariance: None });
        }
        // The derivatives are linear in the reading: their values at zero, and what each component adds.
        let zero = slopes(Vector3::zeros())?;
        let mut by = [zero; 4];
        for component in 0..3 {
            let one = slopes(Vector3::ith(component, 1.0))?;
            (0..PARAMETERS).for_each(|p| by[component + 1][p] = one[p] - zero[p]);
        }
        let mut covariance = [[0.0; 6]; 10];
        for pair in &self.pairs {
            let [first, second] = pair.parameters;
            // A polynomial of a pair holds both of its places in the covariance already.
            let c = 0.5 * value(&pair.polynomial, degc);
            for ((a, b), own) in PRODUCTS.iter().zip(&mut covariance) {
                for (element, (row, column)) in own.iter_mut().zip(SYMMETRIC) {
                    let product = |a: usize, b: usize| {
                        by[a][first][row] * by[b][second][column] + by[a][second][row] * by[b][first][column]
                    };
                    *element += c * if a == b { product(*a, *b) } else { product(*a, *b) + product(*b, *a) };
                }
            }
        }
        Some(AtTemperature { offset_ent, matrix, covariance: Some(covariance) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::convention::{Alignment, Convention};
    use crate::data::units::Reading;
    use crate::model::field_calibration::{Coefficient, Coefficients, MatrixForm, Parameter, Turn};
    use nalgebra::{DMatrix, Rotation3};

    /// Coefficients of offset, sensitivities and angles, and of an inverse K if wanted, with slopes of these angles, deg/K.
    fn coefficients(slope_xi: f64, with_k: bool) -> Vec<Coefficient> {
        let of_axis = |i: usize| {
            let x = i as f64;
            let all = [
                (Parameter::Offset(i), 20.0 - 13.0 * x, 0.3),
                (Parameter::Sigma(i), 1.05 + 0.02 * x, 1e-5),
                (Parameter::Xi(i), 89.9 + 0.1 * x, slope_xi),
                (Parameter::KInverse(i, i), 1.0, 0.0),
            ];
            all.into_iter().take(if with_k { 4 } else { 3 })
        };
        let both = |(parameter, value, slope)| {
            [Coefficient { parameter, power: 0, value }, Coefficient { parameter, power: 1, value: slope }]
        };
        (0..3).flat_map(of_axis).flat_map(both).collect()
    }

    /// A covariance with every element filled: A Aᵀ of a matrix without structure.
    fn covariance(n: usize) -> DMatrix<f64> {
        let root = DMatrix::from_fn(n, n, |i, k| 1e-4 * ((1 + 7 * i + 3 * k) as f64).sin());
        &root * root.transpose()
    }

    #[test]
    fn a_cube_stated_for_the_other_convention_stands_still_while_the_angles_move() {
        let cube = Rotation3::from_scaled_axis(Vector3::new(0.1, -0.3, 0.8)).into_inner();
        let reading = Vector3::new(3000.0, -2000.0, 500.0);
        // The field by the definition: the same sensor described in the other convention, whose frame the cube stands in.
        let by_definition = |own: Convention, values: &[f64], degc: f64| {
            let at = |of: usize| std::array::from_fn(|i| values[6 * i + 2 * of] + degc * values[6 * i + 2 * of + 1]);
            let [offset, sigma, xi_deg]: [[f64; 3]; 3] = [at(0), at(1), at(2)];
            let other = Alignment { convention: own, sigma, xi_deg }.to_other().unwrap().alignment;
            cube * other.transfer().unwrap() * (reading - Vector3::from(offset))
        };
        for own in [Convention::BepiColombo, Convention::Rosetta] {
            let coefficients = coefficients(2e-2, false);
            let values: Vec<f64> = coefficients.iter().map(|c| c.value).collect();
            let covariance = covariance(values.len());
            let turn = Turn { rotation: cube, from_other: Some(own.other()), std_rad: 0.0 };
            let parts = Coefficients {
                matrix: Some(MatrixForm::Alignment(own)),
                coefficients,
                covariance: Some(covariance.clone()),
                turn: Some(turn),
                ..Coefficients::default()
            };
            let calibration = FieldCalibration::new(parts).unwrap();
            for degc in [-40.0, 12.0, 55.0] {
                let found = calibration.apply(Reading(reading.into()), Some(degc));
                let wanted = by_definition(own, &values, degc);
                // Derivatives by differences of the definition, whose steps leave a part in a million.
                let mut jacobian = DMatrix::zeros(3, values.len());
                for k in 0..values.len() {
                    let step = 1e-4 * values[k].abs().max(1e-3);
                    let [up, down] = [step, -step].map(|by| {
                        let mut changed = values.clone();
                        changed[k] += by;
                        by_definition(own, &changed, degc)
                    });
                    jacobian.set_column(k, &((up - down) / (2.0 * step)));
                }
                let wanted_covariance = &jacobian * &covariance * jacobian.transpose();
                for i in 0..3 {
                    assert!((found.field_nt[i] - wanted[i]).abs() < 1e-8, "{own:?} {degc} {found:?} {wanted}");
                    let std = wanted_covariance[(i, i)].sqrt();
                    assert!((found.std_nt[i] / std - 1.0).abs() < 1e-4, "{own:?} {degc} {found:?} {std}");
                }
            }
        }
    }

    #[test]
    fn field_and_uncertainty_are_those_of_single_readings() {
        let coefficients = coefficients(2e-5, true);
        let covariance = Some(covariance(coefficients.len()));
        let matrix = Some(MatrixForm::Alignment(Convention::Rosetta));
        let calibration =
            FieldCalibration::new(Coefficients { matrix, coefficients, covariance, ..Coefficients::default() }).unwrap();
        for (reading, degc) in [([1000.0, -200.0, 30.0], -40.0), ([0.0, 0.0, 0.0], 12.0), ([-9000.0, 4000.0, 7.0], 55.0)] {
            let wanted = calibration.apply(Reading(reading), Some(degc));
            let at = calibration.at(degc).unwrap();
            let measured = Vector3::from(reading) - at.offset_ent;
            let field = at.matrix * measured;
            let found = at.covariance_nt2(&measured);
            for (i, element) in [0, 3, 5].into_iter().enumerate() {
                assert!((field[i] - wanted.field_nt[i]).abs() < 1e-9);
                assert!((found[element].sqrt() / wanted.std_nt[i] - 1.0).abs() < 1e-9, "{found:?} {wanted:?}");
            }
        }
    }
}
