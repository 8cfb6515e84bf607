//! From a raw reading to the field with its uncertainty, by the coefficients of parameter files: `B = ω(ξ) K⁻¹ σ (B_r - B_off)`, or
//! `B = M (B_r - B_off)` where a file states the whole matrix (BC-MAG-TR-0085 section 15.1, RO-IGEP-TR0028 section 3.3).
//!
//! Every parameter is a polynomial of the sensor temperature. With the covariance of all coefficients the uncertainty of a vector is
//! the diagonal of `J C Jᵀ`, with the derivatives `J` of the field by the parameters at its temperature.

mod at;

pub use at::{AtTemperature, SYMMETRIC, turned};

use super::linearisation::AxisLinearisation;
use super::polynomial::{TemperaturePolynomial, value};
use crate::data::apply::OffsetQuantity;
use crate::data::convention::{Convention, PlanarAxes};
use crate::data::flags::Flags;
use crate::data::linearisation::LinearisationPolynomials;
use crate::data::units::{COMPONENTS, Reading};
use crate::fit::propagate::block_diagonal;
use crate::fit::statistics::std_of;
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

/// A quantity on the way from the reading to the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Offset of a component, enT.
    Offset(usize),
    /// Sensitivity of a component, nT/enT.
    Sigma(usize),
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    Xi(usize),
    /// An element of `K⁻¹` by row and column.
    KInverse(usize, usize),
    /// An element of the whole matrix by row and column, nT/enT.
    Matrix(usize, usize),
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Parameter::Offset(i) => write!(f, "the offset of {}", COMPONENTS[*i]),
            Parameter::Sigma(i) => write!(f, "sigma of {}", COMPONENTS[*i]),
            Parameter::Xi(i) => write!(f, "xi of {}", ["xy", "xz", "yz"][*i]),
            Parameter::KInverse(row, column) => write!(f, "row {}, column {} of inverse(K)", row + 1, column + 1),
            Parameter::Matrix(row, column) => write!(f, "row {}, column {} of the matrix", row + 1, column + 1),
        }
    }
}

/// How many parameters there can be.
const PARAMETERS: usize = 27;

impl Parameter {
    fn index(self) -> usize {
        match self {
            Parameter::Offset(i) => i,
            Parameter::Sigma(i) => 3 + i,
            Parameter::Xi(i) => 6 + i,
            Parameter::KInverse(row, column) => 9 + 3 * row + column,
            Parameter::Matrix(row, column) => 18 + 3 * row + column,
        }
    }
}

/// A coefficient: the parameter has a part `value · T^power`, T in °C.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficient {
    /// Whose coefficient it is; several of the same power add.
    pub parameter: Parameter,
    /// Power of the temperature.
    pub power: usize,
    /// Value, in the unit of the parameter per °C to that power.
    pub value: f64,
}

/// The matrix of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MatrixForm {
    /// `ω(ξ) K⁻¹ σ`; `K⁻¹` is the identity where no coefficient names it.
    Alignment(Convention),
    /// Element by element.
    Whole,
}

/// The frame of a calibrated field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// That of the sensor, in the convention of its files.
    Sensor,
    /// The reference cube of the sensor.
    Reference,
    /// Coil axes.
    Coil,
}

/// The range of fields for which a calibration was made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldRange {
    /// From the frame of the matrix to that of the limits.
    pub turn: Matrix3<f64>,
    /// Lowest and highest field per component, nT.
    pub limits_nt: [[f64; 2]; 3],
}

/// A rotation from the sensor frame to another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// `B_to = rotation · B_sensor`.
    pub rotation: Matrix3<f64>,
    /// The convention whose sensor frame it starts from, where that is not the frame of the matrix: the two are turned against each other as
    /// the angles are at a temperature.
    pub from_other: Option<Convention>,
    /// Standard uncertainty about each of its axes, radians.
    pub std_rad: f64,
}

/// Why coefficients make no calibration.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CalibrationError {
    /// No sensitivities.
    #[error("there are no sensitivities and angles")]
    NoMatrix,
    /// Without this parameter there is no field.
    #[error("{0} is not among the coefficients")]
    Missing(Parameter),
    /// No temperature at which all files hold.
    #[error("the files hold at no common temperature")]
    NoCommonTemperature,
    /// Another size than the number of coefficients.
    #[error("the covariance has {found} rows for {wanted} coefficients")]
    Covariance {
        /// Rows that there are.
        found: usize,
        /// Coefficients.
        wanted: usize,
    },
}

/// What a calibration consists of, as far as one file tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coefficients {
    /// The linearisation of the raw reading, if there is one.
    pub linearisation: Option<LinearisationPolynomials>,
    /// The matrix; absent in files of the offset alone.
    pub matrix: Option<MatrixForm>,
    /// Which offset is taken off; absent in files without one.
    pub offset: Option<OffsetQuantity>,
    /// All coefficients.
    pub coefficients: Vec<Coefficient>,
    /// Their covariance in the same order; `None` where it is not known, and then no uncertainty of the field is.
    pub covariance: Option<DMatrix<f64>>,
    /// Standard uncertainties of parameters beside it, independent of it and of each other.
    pub remainders: Vec<(Parameter, f64)>,
    /// Lowest and highest temperature, °C.
    pub valid_degc: Option<[f64; 2]>,
    /// Fields for which it was made.
    pub range: Option<FieldRange>,
    /// From the frame of the matrix to that of the result.
    pub turn: Option<Turn>,
}

impl Coefficients {
    /// A polynomial of the temperature for a parameter, independent of all others.
    #[must_use]
    pub fn with(mut self, parameter: Parameter, polynomial: &TemperaturePolynomial) -> Self {
        let first = self.coefficients.is_empty();
        let own = polynomial.coefficients.iter().enumerate();
        self.coefficients.extend(own.map(|(power, value)| Coefficient { parameter, power, value: *value }));
        let n = polynomial.coefficients.len();
        let known = polynomial.covariance.shape() == (n, n) && polynomial.covariance.iter().all(|v| v.is_finite());
        let before = if first { Some(DMatrix::zeros(0, 0)) } else { self.covariance.take() };
        self.covariance = before.filter(|_| known).map(|c| block_diagonal([&c, &polynomial.covariance]));
        self
    }

    /// The same with the offset of another file in place of its own.
    ///
    /// # Errors
    /// No temperature at which both hold.
    pub fn with_offset_of(mut self, other: Coefficients) -> Result<Self, CalibrationError> {
        let kept: Vec<usize> =
            (0..self.coefficients.len()).filter(|i| !matches!(self.coefficients[*i].parameter, Parameter::Offset(_))).collect();
        self.covariance = self.covariance.map(|c| c.select_rows(&kept).select_columns(&kept));
        self.coefficients = kept.into_iter().map(|i| self.coefficients[i]).chain(other.coefficients).collect();
        self.covariance = self.covariance.zip(other.covariance).map(|(a, b)| block_diagonal([&a, &b]));
        self.remainders.extend(other.remainders);
        self.offset = other.offset;
        self.valid_degc = match (self.valid_degc, other.valid_degc) {
            (Some([a, b]), Some([c, d])) if a.max(c) > b.min(d) => return Err(CalibrationError::NoCommonTemperature),
            (Some([a, b]), Some([c, d])) => Some([a.max(c), b.min(d)]),
            (own, others) => own.or(others),
        };
        Ok(self)
    }
}

/// A covariance of two parameters as a polynomial of the temperature.
#[derive(Clone, Debug, PartialEq)]
struct Pair {
    parameters: [usize; 2],
    polynomial: Vec<f64>,
}

/// A calibration that can be applied.
///
/// ```
/// use calfit::data::{convention::Convention, units::Reading};
/// use calfit::model::field_calibration::{Coefficient, Coefficients, FieldCalibration, MatrixForm, Parameter};
/// let constant = |parameter, value| Coefficient { parameter, power: 0, value };
/// let of_axis = |i| [(Parameter::Offset(i), 10.0), (Parameter::Sigma(i), 0.5), (Parameter::Xi(i), 90.0)];
/// let coefficients = (0..3).flat_map(of_axis).map(|(parameter, value)| constant(parameter, value)).collect();
/// let matrix = Some(MatrixForm::Alignment(Convention::BepiColombo));
/// let calibration = FieldCalibration::new(Coefficients { matrix, coefficients, ..Coefficients::default() })?;
/// let found = calibration.apply(Reading([110.0, 10.0, 10.0]), Some(20.0));
/// assert!((found.field_nt[0] - 50.0).abs() < 1e-9 && found.field_nt[1].abs() < 1e-9);
/// // Without a covariance there is no uncertainty.
/// assert!(found.std_nt[0].is_nan());
/// # Ok::<(), calfit::model::field_calibration::CalibrationError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct FieldCalibration {
    parts: Coefficients,
    matrix: MatrixForm,
    polynomials: Vec<Vec<f64>>,
    /// Parameters whose derivatives the uncertainty needs.
    uncertain: Vec<bool>,
    pairs: Vec<Pair>,
    with_k: bool,
}

/// A calibrated vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibratedField {
    /// The field, nT, in the frame of the calibration; nan where there is none.
    pub field_nt: [f64; 3],
    /// Its standard uncertainty from the coefficients, nT, common to all vectors; nan where it is not known.
    pub std_nt: [f64; 3],
    /// What is to be known of it.
    pub flags: Flags,
}

impl CalibratedField {
    const NONE: Self = Self { field_nt: [f64::NAN; 3], std_nt: [f64::NAN; 3], flags: Flags(0) };
}

impl FieldCalibration {
    /// A calibration from its coefficients.
    ///
    /// # Errors
    /// A parameter without coefficient, a covariance of another size.
    pub fn new(parts: Coefficients) -> Result<Self, CalibrationError> {
        let mut polynomials = vec![Vec::new(); PARAMETERS];
        for c in &parts.coefficients {
            let polynomial: &mut Vec<f64> = &mut polynomials[c.parameter.index()];
            polynomial.resize(polynomial.len().max(c.power + 1), 0.0);
            polynomial[c.power] += c.value;
        }
        let vectors = |of: fn(usize) -> Parameter| (0..3).map(of);
        let matrix = parts.matrix.ok_or(CalibrationError::NoMatrix)?;
        let needed: Vec<Parameter> = match matrix {
            MatrixForm::Alignment(_) => {
                [Parameter::Offset, Parameter::Sigma, Parameter::Xi].into_iter().flat_map(vectors).collect()
            }
            MatrixForm::Whole => vectors(Parameter::Offset).chain((0..9).map(|e| Parameter::Matrix(e / 3, e % 3))).collect(),
        };
        if let Some(missing) = needed.into_iter().find(|p| polynomials[p.index()].is_empty()) {
            return Err(CalibrationError::Missing(missing));
        }
        let with_k = (0..9).any(|e| !polynomials[Parameter::KInverse(e / 3, e % 3).index()].is_empty());
        let mut pairs: Vec<Pair> = Vec::new();
        let mut add = |parameters: [usize; 2], power: usize, covariance: f64| {
            if covariance == 0.0 {
                return;
            }
            let pair = if let Some(at) = pairs.iter().position(|p| p.parameters == parameters) {
                &mut pairs[at]
            } else {
                pairs.push(Pair { parameters, polynomial: Vec::new() });
                let last = pairs.len() - 1;
                &mut pairs[last]
            };
            pair.polynomial.resize(pair.polynomial.len().max(power + 1), 0.0);
            pair.polynomial[power] += covariance;
        };
        if let Some(covariance) = &parts.covariance {
            if covariance.shape() != (parts.coefficients.len(), parts.coefficients.len()) {
                return Err(CalibrationError::Covariance { found: covariance.nrows(), wanted: parts.coefficients.len() });
            }
            for (i, a) in parts.coefficients.iter().enumerate() {
                for (k, b) in parts.coefficients.iter().enumerate() {
                    let [first, second] = [a.parameter.index(), b.parameter.index()];
                    add([first.min(second), first.max(second)], a.power + b.power, covariance[(i, k)]);
                }
            }
            for (parameter, std) in &parts.remainders {
                add([parameter.index(); 2], 0, std * std);
            }
        }
        let mut uncertain = vec![false; PARAMETERS];
        pairs.iter().flat_map(|p| p.parameters).for_each(|p| uncertain[p] = true);
        Ok(Self { parts, matrix, polynomials, uncertain, pairs, with_k })
    }

    /// What it was made of.
    #[must_use]
    pub fn parts(&self) -> &Coefficients {
        &self.parts
    }

    /// Whether its parameters are polynomials of the temperature, so that there is no field without one.
    #[must_use]
    pub fn needs_temperature(&self) -> bool {
        matches!(self.matrix, MatrixForm::Alignment(_))
    }

    /// The offset that is taken off at a temperature, °C, enT.
    #[must_use]
    pub fn offset_ent(&self, degc: f64) -> [f64; 3] {
        self.three(Parameter::Offset, degc)
    }

    /// The matrix that takes readings without their offset to the field at a temperature, °C, nT/enT; `None` for angles of no sensor.
    #[must_use]
    pub fn matrix(&self, degc: f64) -> Option<Matrix3<f64>> {
        let matrix = match self.matrix {
            MatrixForm::Whole => self.square(Parameter::Matrix, degc),
            MatrixForm::Alignment(convention) => {
                let omega = convention.omega(self.three(Parameter::Xi, degc)).ok()?;
                let omega = if self.with_k { omega * self.square(Parameter::KInverse, degc) } else { omega };
                omega * Matrix3::from_diagonal(&Vector3::from(self.three(Parameter::Sigma, degc)))
            }
        };
        Some(self.rotation(&matrix) * matrix)
    }

    /// From the frame of a matrix to that of the result. The sensitivities, factors of its columns, are in it or not: they turn nothing.
    fn rotation(&self, matrix: &Matrix3<f64>) -> Matrix3<f64> {
        let Some(turn) = &self.parts.turn else { return Matrix3::identity() };
        turn.from_other.map_or(turn.rotation, |convention| turn.rotation * convention.frame_of(matrix))
    }

    fn three(&self, of: fn(usize) -> Parameter, degc: f64) -> [f64; 3] {
        std::array::from_fn(|i| value(&self.polynomials[of(i).index()], degc))
    }

    fn square(&self, of: fn(usize, usize) -> Parameter, degc: f64) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| value(&self.polynomials[of(row, column).index()], degc))
    }

    /// The field of a reading at a sensor temperature, °C; `None` where it is not known.
    ///
    /// The field is nan where the temperature is needed and not known, where the reading is not finite, and where the angles at that
    /// temperature belong to no three axes. Outside of the ranges the field is given all the same, and the flags say so.
    #[must_use]
    pub fn apply(&self, reading: Reading, degc: Option<f64>) -> CalibratedField {
        let mut found = CalibratedField::NONE;
        let is_reading = reading.0.iter().all(|r| r.is_finite());
        if !is_reading {
            found.flags |= Flags::NO_READING;
        }
        let degc = degc.filter(|t| t.is_finite());
        match (degc, self.parts.valid_degc) {
            (Some(t), Some([low, high])) if !(low..=high).contains(&t) => found.flags |= Flags::TEMPERATURE,
            (None, Some(_)) => found.flags |= Flags::NO_TEMPERATURE,
            _ => {}
        }
        if degc.is_none() && self.needs_temperature() {
            found.flags |= Flags::NO_TEMPERATURE;
            return found;
        }
        // Without a temperature nothing depends on it.
        let degc = degc.unwrap_or(0.0);
        if !is_reading {
            return found;
        }
        let measured = Vector3::from(self.linearised_ent(reading)) - Vector3::from(self.three(Parameter::Offset, degc));
        if let Ok(slopes) = self.field_and_slopes(measured, degc) {
            if self.is_beyond(reading, &slopes.field) {
                found.flags |= Flags::FIELD;
            }
            found.field_nt = (slopes.rotation * slopes.field).into();
            found.std_nt = self.std_nt(slopes, degc);
        }
        found
    }

    /// Whether a reading, or its field in the frame of the matrix (nT), lies outside the ranges that the calibration was made for.
    #[must_use]
    pub fn is_beyond(&self, reading: Reading, field: &Vector3<f64>) -> bool {
        let beyond = |p: &LinearisationPolynomials| leave_out(&p.reading_ent, reading.0);
        self.parts.linearisation.as_ref().is_some_and(beyond)
            || self.parts.range.is_some_and(|range| leave_out(&range.limits_nt, (range.turn * field).into()))
    }

    /// A reading after the linearisation, enT.
    #[must_use]
    pub fn linearised_ent(&self, reading: Reading) -> [f64; 3] {
        match &self.parts.linearisation {
            None => reading.0,
            Some(polynomials) => std::array::from_fn(|i| AxisLinearisation::of(polynomials, i).linearised_ent(reading.0[i])),
        }
    }

    /// The field of a linearised reading without its offset, and its derivatives by all parameters.
    fn field_and_slopes(&self, measured: Vector3<f64>, degc: f64) -> Result<Slopes, PlanarAxes> {
        let mut by = [Vector3::zeros(); PARAMETERS];
        let (field, rotation) = match self.matrix {
            MatrixForm::Whole => {
                let matrix = self.square(Parameter::Matrix, degc);
                for i in 0..3 {
                    by[Parameter::Offset(i).index()] = -matrix.column(i);
                    for row in 0..3 {
                        by[Parameter::Matrix(row, i).index()][row] = measured[i];
                    }
                }
                (matrix * measured, self.rotation(&matrix))
            }
            MatrixForm::Alignment(convention) => {
                let sigma = Vector3::from(self.three(Parameter::Sigma, degc));
                let scaled = sigma.component_mul(&measured);
                let (omega, slopes) = convention.omega_and_slopes(self.three(Parameter::Xi, degc))?;
                let (matrix, inner) = if self.with_k {
                    let k_inverse = self.square(Parameter::KInverse, degc);
                    for row in 0..3 {
                        for column in 0..3 {
                            by[Parameter::KInverse(row, column).index()] = omega.column(row) * scaled[column];
                        }
                    }
                    (omega * k_inverse, k_inverse * scaled)
                } else {
                    (omega, scaled)
                };
                for i in 0..3 {
                    by[Parameter::Offset(i).index()] = matrix.column(i) * -sigma[i];
                    by[Parameter::Sigma(i).index()] = matrix.column(i) * measured[i];
                    by[Parameter::Xi(i).index()] = slopes[i] * inner;
                }
                let field = omega * inner;
                if let Some(other) = self.parts.turn.and_then(|turn| turn.from_other) {
                    let k_inverse = if self.with_k { self.square(Parameter::KInverse, degc) } else { Matrix3::identity() };
                    for i in 0..3 {
                        by[Parameter::Xi(i).index()] += spin(other, &matrix, &(slopes[i] * k_inverse)) * field;
                    }
                    for element in (0..9).filter(|_| self.with_k) {
                        let mut change = Matrix3::zeros();
                        change.set_column(element % 3, &omega.column(element / 3));
                        by[Parameter::KInverse(element / 3, element % 3).index()] += spin(other, &matrix, &change) * field;
                    }
                }
                (field, self.rotation(&matrix))
            }
        };
        Ok(Slopes { field, rotation, by })
    }

    fn std_nt(&self, Slopes { field, rotation, mut by }: Slopes, degc: f64) -> [f64; 3] {
        if self.parts.covariance.is_none() {
            return [f64::NAN; 3];
        }
        let mut variance = Vector3::zeros();
        if let Some(turn) = &self.parts.turn {
            for (column, _) in by.iter_mut().zip(&self.uncertain).filter(|(_, uncertain)| **uncertain) {
                *column = rotation * *column;
            }
            // Turned by small angles about the three axes, each component takes what stands across it.
            let turned = rotation * field;
            let across = turned.map(|component| turned.norm_squared() - component * component);
            variance += across * (turn.std_rad * turn.std_rad);
        }
        for pair in &self.pairs {
            let [first, second] = pair.parameters;
            let product = by[first].component_mul(&by[second]);
            // A polynomial of a pair holds both of its places in the covariance already.
            variance += product * value(&pair.polynomial, degc);
        }
        variance.map(std_of).into()
    }
}

/// The field of a reading, and what it follows.
struct Slopes {
    /// The field in the frame of the matrix, nT.
    field: Vector3<f64>,
    /// From that frame to that of the result.
    rotation: Matrix3<f64>,
    /// Derivatives of the field in the frame of the result by all parameters, seen in the frame of the matrix.
    by: [Vector3<f64>; PARAMETERS],
}

/// By how much the sensor frame of a convention turns where a matrix changes, seen in the frame of the matrix: an antisymmetric matrix that
/// keeps it triangular there (see [`Convention::frame_of`]). Zero for a matrix without an inverse.
fn spin(convention: Convention, matrix: &Matrix3<f64>, change: &Matrix3<f64>) -> Matrix3<f64> {
    let Some(inverse) = matrix.try_inverse() else { return Matrix3::zeros() };
    let frame = convention.frame_of(matrix);
    let seen = frame * change * inverse * frame.transpose();
    // What has to vanish: below the diagonal of an upper triangular matrix, above that of a lower one.
    let triangle = match convention {
        Convention::Rosetta => seen.lower_triangle(),
        Convention::BepiColombo => seen.upper_triangle(),
    };
    let beside = triangle - Matrix3::from_diagonal(&seen.diagonal());
    frame.transpose() * (beside.transpose() - beside) * frame
}

/// Whether a component lies beyond its limits.
fn leave_out(limits: &[[f64; 2]; 3], components: [f64; 3]) -> bool {
    limits.iter().zip(components).any(|([low, high], c)| !(*low..=*high).contains(&c))
}
