//! What parameter files say of the way from a reading to the field.

use super::thermal::NO_CHANNEL;
use super::{Cpf, Opf, Tcf, ThermalHead, Tof, Tpf};
use crate::data::across::FollowedThermistor;
use crate::data::apply::OffsetQuantity;
use crate::data::convention::Convention;
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::provenance::Input;
use crate::data::reference::{Reference, is_orthonormal, is_rotation};
use crate::data::result::{Covariance, Rows, valid_of_run};
use crate::data::run::Location;
use crate::data::units::COMPONENTS;
use crate::fit::propagate::block_diagonal;
use crate::model::field_calibration::{Coefficient, Coefficients, FieldRange, Frame, MatrixForm, Parameter};
use crate::model::lag::Lag;
use crate::model::polynomial::{TemperaturePolynomial, value};
use nalgebra::{DMatrix, DVector, Matrix3};
use std::path::Path;

/// Sensitivities and angles, in the order in which a calibration takes them.
const QUANTITIES: [&str; 6] = ["sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz"];
/// Offset and residual field behind them.
const B_OR: [&str; 3] = ["b_or_x", "b_or_y", "b_or_z"];

/// The position of the sensor in which a file holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeldIn {
    /// Id of the position.
    pub id: u32,
    /// Sensor axes along coil axes.
    pub axes: [String; 3],
}

/// The part of one file.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldPart {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Where the sensor stood.
    pub location: Location,
    /// The position in which its result stands in coil axes; absent for any other frame.
    pub position: Option<HeldIn>,
    /// Channel of the sensor temperature, if the file tells it and it matters: in files over temperature.
    pub channel: Option<String>,
    /// Model files whose effects were taken off the readings of the runs before.
    pub known_effects: Vec<String>,
    /// These model files themselves, where the file says with which it was made; a ground calibration file has their names alone.
    pub models: Vec<Input>,
    /// What qualifies its values.
    pub notes: Vec<Note>,
    /// How the sensor stands in its reference cube, if the file tells it.
    pub reference: Option<Reference>,
    /// How the part of the sensor whose temperature the coefficients follow goes after the thermistor, where the two differ.
    pub lag: Option<Lag>,
    /// The frame of the result, in words.
    pub frame: String,
    /// The coefficients.
    pub coefficients: Coefficients,
}

/// A covariance as rows, where it has as many rows as there are parameters.
pub(in crate::files) fn matrix_of(rows: &[Vec<f64>], n: usize) -> Option<DMatrix<f64>> {
    let square = rows.len() == n && rows.iter().all(|row| row.len() == n);
    square.then(|| DMatrix::from_fn(n, n, |i, k| rows[i][k]))
}

/// A polynomial of a file with the covariance that the file states under its name; one of size zero is not known.
pub(super) fn stated_polynomial(
    coefficients: &[f64],
    covariance: Option<&Vec<Vec<f64>>>,
    valid_degc: [f64; 2],
) -> TemperaturePolynomial {
    let stated = covariance.and_then(|rows| matrix_of(rows, coefficients.len()));
    TemperaturePolynomial {
        coefficients: coefficients.to_vec(),
        covariance: stated.unwrap_or_else(|| DMatrix::zeros(0, 0)),
        valid_degc,
    }
}

fn matrix3(rows: &Rows) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| rows[row][column])
}

/// Coefficients of offset, σ and ξ.
fn with_three(parts: Coefficients, of: fn(usize) -> Parameter, polynomials: &[TemperaturePolynomial; 3]) -> Coefficients {
    polynomials.iter().enumerate().fold(parts, |parts, (i, p)| parts.with(of(i), p))
}

/// The limits of a file that states them along the nominal sensor axes, which the axes of the sensor frame follow within the misalignment.
fn along_sensor_axes(limits_nt: Option<[[f64; 2]; 3]>) -> Option<FieldRange> {
    limits_nt.map(|limits_nt| FieldRange { turn: Matrix3::identity(), limits_nt })
}

/// What a file says twice must agree to this: printed matrices have six decimals, printed angles full seconds of arc (5e-6), and a turned
/// sign of a misalignment is far above.
const PRINTED: f64 = 1e-5;

pub(super) fn contradicts(path: &Path, rule: impl Into<Box<str>>) -> Finding {
    Finding::error(&path.display().to_string(), rule, "correct the file, or fit again")
}

/// Refuses sensitivities that are not positive and angles that no three axes have between them, at both ends of the temperatures.
fn is_a_sensor(
    path: &Path,
    convention: Convention,
    sigma: [&Vec<f64>; 3],
    xi_deg: [&Vec<f64>; 3],
    valid_degc: [f64; 2],
) -> Result<(), Finding> {
    for t in valid_degc {
        if let Some(i) = (0..3).find(|i| value(sigma[*i], t).partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater)) {
            return Err(contradicts(path, format!("sigma_{} is not positive at {t} °C", COMPONENTS[i])));
        }
        let xi_deg = xi_deg.map(|p| value(p, t));
        if !xi_deg.iter().all(|xi| is_between_axes(*xi)) || convention.omega(xi_deg).is_err() {
            return Err(contradicts(path, format!("no three axes have the angles xi between them at {t} °C")));
        }
    }
    Ok(())
}

/// Whether two numbers of a file are the same as printed.
fn is_near(a: f64, b: f64) -> bool {
    (a - b).abs() <= PRINTED * a.abs().max(b.abs())
}

/// Whether two axes can have an angle between them, degrees.
fn is_between_axes(xi_deg: f64) -> bool {
    xi_deg > 0.0 && xi_deg < 180.0
}

impl Cpf {
    /// Refuses matrices and angles that are not those of one sensor.
    pub(super) fn is_consistent(&self, path: &Path) -> Result<(), Finding> {
        let (m, a) = (&self.calibration.matrix, &self.calibration.angle_deg);
        let sigma = matrix3(&m.sigma);
        let [r_nom, rho, omega, phi_tilde] = [&m.r_nom, &m.rho, &m.omega, &m.phi_tilde].map(matrix3);
        // Axes that are left-handed against the position are told where they are found, and the file says so too.
        let is_told = self.calibration.quality.rotation_determinant < 0.0 && is_orthonormal(&m.rho);
        if !is_rotation(&m.r_nom) {
            return Err(contradicts(path, "matrix.r_nom is no rotation"));
        }
        if !is_rotation(&m.rho) && !is_told {
            return Err(contradicts(path, "matrix.rho is no rotation"));
        }
        if sigma != Matrix3::from_diagonal(&sigma.diagonal()) || sigma.diagonal().iter().any(|s| s.is_nan() || *s <= 0.0) {
            return Err(contradicts(path, "matrix.sigma is not diagonal and positive"));
        }
        let convention = match m.omega_convention.as_str() {
            "BepiColombo" => Convention::BepiColombo,
            other => {
                let rule = format!("matrix.omega_convention is `{other}`, not that of the files of calfit, BepiColombo");
                return Err(contradicts(path, rule));
            }
        };
        let xi_deg = [a.xi_xy, a.xi_xz, a.xi_yz];
        let of_angles = convention.omega(xi_deg).ok().filter(|_| xi_deg.iter().all(|xi| is_between_axes(*xi)));
        let of_angles = of_angles.ok_or_else(|| contradicts(path, "no three axes have the angles of angle_deg between them"))?;
        for (stated, wanted, rule) in [
            (&omega, of_angles, "matrix.omega is not that of the angles"),
            (&phi_tilde, omega * sigma, "matrix.phi_tilde is not omega sigma"),
            (&matrix3(&m.phi), r_nom * rho * phi_tilde, "matrix.phi is not r_nom rho omega sigma"),
        ] {
            // A matrix that holds nan agrees with nothing.
            if (stated - wanted).iter().any(|d| d.is_nan() || d.abs() > PRINTED * sigma.amax().max(1.0)) {
                return Err(contradicts(path, rule));
            }
        }
        Ok(())
    }

    /// Its part: `Φ` in coil axes, `φ̃` in the sensor frame.
    pub(super) fn part(&self, frame: Frame) -> FieldPart {
        let own = &self.calibration;
        let names: Vec<String> = ["x", "y", "z"].iter().flat_map(|r| ["x", "y", "z"].map(|c| format!("phi_{r}{c}"))).collect();
        let stated =
            sub_covariance(own.whole_covariance(), &[names, ["x", "y", "z"].map(|c| format!("b_or_{c}")).to_vec()].concat());
        let to_coil = matrix3(&own.matrix.r_nom) * matrix3(&own.matrix.rho);
        let (matrix, turn, covariance) = if frame == Frame::Coil {
            (matrix3(&own.matrix.phi), Matrix3::identity(), stated)
        } else {
            let phi_tilde = matrix3(&own.matrix.phi_tilde);
            let covariance = stated.zip(rotation_taken_off(&to_coil, &phi_tilde)).map(|(c, j)| &j * c * j.transpose());
            (phi_tilde, to_coil, covariance)
        };
        let elements = (0..9).map(|e| (Parameter::Matrix(e / 3, e % 3), matrix[(e / 3, e % 3)]));
        let offsets = (0..3).map(|i| (Parameter::Offset(i), own.offset.b_or_ent[i]));
        let coefficients = elements.chain(offsets).map(|(parameter, value)| Coefficient { parameter, power: 0, value });
        FieldPart {
            sensor: own.run.sensor.clone(),
            mode: own.run.mode.clone(),
            location: own.run.location,
            position: (frame == Frame::Coil).then(|| HeldIn { id: own.setup.position, axes: own.setup.position_axes.clone() }),
            channel: None,
            known_effects: self.model.iter().map(|m| m.file.clone()).collect(),
            models: Vec::new(),
            notes: Vec::new(),
            reference: own.reference.clone(),
            lag: None,
            frame: match frame {
                Frame::Coil => "coil: X_c, Y_c, Z_c".to_owned(),
                _ => Convention::BepiColombo.sensor_frame().to_owned(),
            },
            coefficients: Coefficients {
                linearisation: self.linearisation.as_ref().map(|l| l.applied.clone()),
                matrix: Some(MatrixForm::Whole),
                offset: Some(OffsetQuantity::BOr),
                coefficients: coefficients.collect(),
                covariance,
                valid_degc: own.valid.temperature_degc,
                range: Some(FieldRange { turn, limits_nt: own.valid.field_coil_nt }),
                ..Coefficients::default()
            },
        }
    }
}

/// A lag as a file states it.
pub(super) fn lag_of(followed: Option<&FollowedThermistor>) -> Option<Lag> {
    followed.and_then(|followed| Lag::named(&followed.form, followed.lag_s))
}

/// Derivatives of the elements of `φ̃` and of the offsets by those of `Φ = R φ̃` and the offsets. `φ̃` stays lower triangular, so that
/// what a change of `Φ` has above the diagonal of `Rᵀ dΦ φ̃⁻¹` is a turn.
fn rotation_taken_off(rotation: &Matrix3<f64>, phi_tilde: &Matrix3<f64>) -> Option<DMatrix<f64>> {
    let inverse = phi_tilde.try_inverse()?;
    let mut jacobian = DMatrix::identity(12, 12);
    for element in 0..9 {
        let mut change = Matrix3::zeros();
        change[(element / 3, element % 3)] = 1.0;
        let seen = rotation.transpose() * change * inverse;
        let above = seen.upper_triangle() - Matrix3::from_diagonal(&seen.diagonal());
        let own = (seen - (above - above.transpose())) * phi_tilde;
        for row in 0..9 {
            jacobian[(row, element)] = own[(row / 3, row % 3)];
        }
    }
    Some(jacobian)
}

/// Rows and columns of a covariance by their names.
fn sub_covariance(covariance: &Covariance, names: &[String]) -> Option<DMatrix<f64>> {
    let at: Option<Vec<usize>> = names.iter().map(|name| covariance.parameters.iter().position(|p| p == name)).collect();
    let (at, whole) = (at?, matrix_of(&covariance.matrix, covariance.parameters.len())?);
    let part = DMatrix::from_fn(at.len(), at.len(), |i, k| whole[(at[i], at[k])]);
    part.iter().all(|v| v.is_finite()).then_some(part)
}

/// A channel that a file tells.
fn stated(channel: &str) -> Option<String> {
    (channel != NO_CHANNEL).then(|| channel.to_owned())
}

impl ThermalHead {
    fn stated_channel(&self) -> Option<String> {
        stated(&self.channel)
    }
}

impl Tpf {
    /// Model files whose effects were taken off before; files of sweeps from before that key name theirs with the sweep.
    fn known_effects(&self) -> Vec<String> {
        let of_sweep = self.sweep.as_ref().and_then(|sweep| sweep.model.as_ref()).map(|model| model.file.clone());
        if self.scope.known_effects.is_empty() { of_sweep.into_iter().collect() } else { self.scope.known_effects.clone() }
    }

    /// The lag of its temperatures; files of sweeps from before that key have it with the sweep.
    pub(super) fn lag(&self) -> Option<Lag> {
        let of_sweep = || FollowedThermistor::of(self.sweep.as_ref()?.applied_lag.as_ref()?);
        lag_of(self.scope.thermistor_lag.clone().or_else(of_sweep).as_ref())
    }

    /// Covariance of the coefficients of σ, ξ and B_or with what they have in common: as one fit gave it, or the blocks of type A and one change
    /// of all of them for every source that the runs share; `None` where the file states neither.
    fn whole_covariance(&self, counts: &[usize]) -> Option<DMatrix<f64>> {
        let named = QUANTITIES.iter().chain(&B_OR).zip(counts);
        let names: Vec<String> = named.clone().flat_map(|(name, n)| (0..*n).map(move |k| format!("{name}.{k}"))).collect();
        // One of type A does not stand for combined ones.
        if self.head.covariance_combined.is_empty() {
            return sub_covariance(self.together.as_ref()?, &names);
        }
        if let Some(together) = &self.together_combined {
            return sub_covariance(together, &names);
        }
        if self.head.common.is_empty() {
            return None;
        }
        let own: Option<Vec<DMatrix<f64>>> =
            named.clone().map(|(name, n)| matrix_of(self.head.covariance.get(*name)?, *n)).collect();
        let mut whole = block_diagonal(own?.iter());
        for source in &self.head.common {
            let change = named.clone().map(|(name, n)| match source.change.get(*name) {
                None => Some(vec![0.0; *n]),
                Some(change) => Some(change.clone()).filter(|change| change.len() == *n),
            });
            let change = DVector::from_vec(change.collect::<Option<Vec<_>>>()?.concat());
            whole += &change * change.transpose();
        }
        Some(whole)
    }

    /// Refuses polynomials of no sensor.
    pub(super) fn is_consistent(&self, path: &Path) -> Result<(), Finding> {
        let sigma = [&self.sigma_x, &self.sigma_y, &self.sigma_z];
        is_a_sensor(path, Convention::BepiColombo, sigma, [&self.xi_xy, &self.xi_xz, &self.xi_yz], self.head.valid_degc)
    }

    /// Its part.
    pub(super) fn part(&self) -> FieldPart {
        let (sigma, xi, offset) = (self.sigma(), self.xi_deg(), self.b_or_ent());
        let parts = with_three(Coefficients::default(), Parameter::Sigma, &sigma);
        let parts = with_three(parts, Parameter::Xi, &xi);
        let mut parts = with_three(parts, Parameter::Offset, &offset);
        let counts: Vec<usize> = sigma.iter().chain(&xi).chain(&offset).map(|p| p.coefficients.len()).collect();
        // The blocks of single quantities are without what they have in common.
        if let Some(whole) = self.whole_covariance(&counts) {
            parts.covariance = Some(whole);
        }
        FieldPart {
            sensor: self.head.sensor.clone(),
            mode: self.head.mode.clone(),
            location: self.head.location,
            position: None,
            channel: self.head.stated_channel(),
            known_effects: self.known_effects(),
            models: Vec::new(),
            notes: Vec::new(),
            reference: self.reference.clone(),
            lag: self.lag(),
            frame: Convention::BepiColombo.sensor_frame().to_owned(),
            coefficients: Coefficients {
                linearisation: self.scope.linearisation.as_ref().map(|l| l.applied.clone()),
                matrix: Some(MatrixForm::Alignment(Convention::BepiColombo)),
                offset: Some(OffsetQuantity::BOr),
                valid_degc: Some(self.head.valid_degc),
                range: along_sensor_axes(self.scope.valid_field_nt),
                ..parts
            },
        }
    }
}

impl Tof {
    /// Its part. A component that the runs did not determine has no coefficient.
    pub(super) fn part(&self) -> FieldPart {
        let named = [("b_off_x", &self.b_off_x), ("b_off_y", &self.b_off_y), ("b_off_z", &self.b_off_z)];
        let parts = Coefficients {
            offset: Some(OffsetQuantity::BOff),
            valid_degc: Some(self.head.valid_degc),
            ..Coefficients::default()
        };
        FieldPart {
            sensor: self.head.sensor.clone(),
            mode: self.head.mode.clone(),
            location: self.head.location,
            position: None,
            channel: self.head.stated_channel(),
            known_effects: Vec::new(),
            models: Vec::new(),
            notes: Vec::new(),
            reference: None,
            lag: None,
            frame: String::new(),
            coefficients: with_three(parts, Parameter::Offset, &self.head.polynomials(named)),
        }
    }
}

impl Opf {
    /// Refuses standard uncertainties that are not those of the covariance, and fields in nT that are not those in enT times the sensitivity.
    pub(super) fn is_consistent(&self, path: &Path) -> Result<(), Finding> {
        let (v, covariance) = (&self.values, &self.found.covariance);
        if let Some(std) = &self.std {
            let own = v.std();
            for (key, a, b) in [
                ("std.offset_ent", std.offset_ent, own.offset_ent),
                ("std.residual_ent", std.residual_ent, own.residual_ent),
                ("std.residual_coil_nt", std.residual_coil_nt, own.residual_coil_nt),
            ] {
                if !(0..3).all(|i| (a[i].is_nan() && b[i].is_nan()) || is_near(a[i], b[i])) {
                    return Err(contradicts(path, format!("{key} is not the one of the values")));
                }
            }
        }
        for (quantity, key, value, std) in [
            ("offset", "offset_std_ent", v.offset_ent, v.offset_std_ent),
            ("residual_coil", "residual_coil_std_nt", v.residual_coil_nt, v.residual_coil_std_nt),
        ] {
            for (i, axis) in ["x", "y", "z"].into_iter().enumerate().filter(|(i, _)| value[*i].is_finite()) {
                let name = format!("{quantity}_{axis}");
                let at = covariance.parameters.iter().position(|p| *p == name);
                let Some(variance) = at.and_then(|at| covariance.matrix.get(at)?.get(at)) else { continue };
                if !is_near(std[i], variance.sqrt()) {
                    return Err(contradicts(path, format!("{key} is not the root of the variance of {name}")));
                }
            }
        }
        let Some(scaled) = &self.found.scaled else { return Ok(()) };
        for (key, nt, ent) in [
            ("offset_nt", scaled.offset_nt, v.offset_ent),
            ("offset_std_nt", scaled.offset_std_nt, v.offset_std_ent),
            ("residual_nt", scaled.residual_nt, v.residual_ent),
            ("residual_std_nt", scaled.residual_std_nt, v.residual_std_ent),
        ] {
            if !(0..3).all(|i| ent[i].is_nan() || is_near(nt[i], scaled.sigma[i] * ent[i])) {
                return Err(contradicts(path, format!("scaled.{key} is not scaled.sigma times its value in enT")));
            }
        }
        Ok(())
    }

    /// Its part, at the temperatures of its run. A component that was not determined has no coefficient.
    pub(super) fn part(&self) -> FieldPart {
        let std = self.found.of_facility.as_ref().map_or(self.values.offset_std_ent, |b| b.std_combined.offset_ent);
        let offset = self.values.offset_ent;
        let constant = |i: usize| TemperaturePolynomial {
            coefficients: Some(offset[i]).filter(|v| v.is_finite()).into_iter().collect(),
            covariance: DMatrix::from_element(1, 1, std[i] * std[i]),
            valid_degc: [f64::NEG_INFINITY, f64::INFINITY],
        };
        let parts = Coefficients {
            offset: Some(OffsetQuantity::BOff),
            valid_degc: self.conditions.as_ref().and_then(|c| c.sensor_degc).map(valid_of_run),
            ..Coefficients::default()
        };
        let mut parts = with_three(parts, Parameter::Offset, &[0, 1, 2].map(constant));
        if let Some(together) = sub_covariance(self.found.covariance_of_both(), &["x", "y", "z"].map(|c| format!("offset_{c}"))) {
            parts.covariance = Some(together);
        }
        FieldPart {
            sensor: self.found.run.sensor.clone(),
            mode: self.found.run.mode.clone(),
            location: self.found.run.location,
            position: None,
            channel: self.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            known_effects: Vec::new(),
            models: Vec::new(),
            notes: Vec::new(),
            reference: None,
            lag: None,
            frame: String::new(),
            coefficients: parts,
        }
    }
}

impl Tcf {
    /// Refuses polynomials of no sensor.
    pub(super) fn is_consistent(&self, path: &Path) -> Result<(), Finding> {
        let sigma = [&self.sigma_x, &self.sigma_y, &self.sigma_z];
        is_a_sensor(path, Convention::Rosetta, sigma, [&self.xi_xy, &self.xi_xz, &self.xi_yz], self.valid_degc)
    }

    /// Its part, at the centre; without an offset where none was measured there.
    pub(super) fn part(&self) -> FieldPart {
        let named =
            |name: &str, coefficients: &Vec<f64>| stated_polynomial(coefficients, self.covariance.get(name), self.valid_degc);
        let sigma = [("sigma_x", &self.sigma_x), ("sigma_y", &self.sigma_y), ("sigma_z", &self.sigma_z)];
        let xi = [("xi_xy", &self.xi_xy), ("xi_xz", &self.xi_xz), ("xi_yz", &self.xi_yz)];
        let parts = with_three(Coefficients::default(), Parameter::Sigma, &sigma.map(|(n, c)| named(n, c)));
        let mut parts = with_three(parts, Parameter::Xi, &xi.map(|(n, c)| named(n, c)));
        // What the transfer from beside the centre makes common to all of them.
        let names = sigma.iter().chain(&xi).flat_map(|(name, c)| (0..c.len()).map(move |k| format!("{name}.{k}")));
        let names: Vec<String> = names.collect();
        if let Some(together) = self.together.as_ref().and_then(|c| sub_covariance(c, &names)) {
            parts.covariance = Some(together);
        }
        if !self.b_off_x.is_empty() {
            let b_off = [("b_off_x", &self.b_off_x), ("b_off_y", &self.b_off_y), ("b_off_z", &self.b_off_z)];
            parts = with_three(parts, Parameter::Offset, &b_off.map(|(n, c)| named(n, c)));
        }
        let stds = |of: fn(usize) -> Parameter, std: [f64; 3]| (0..3).map(move |i| (of(i), std[i]));
        FieldPart {
            sensor: self.sensor.clone(),
            mode: self.mode.clone(),
            location: Location::Centre,
            position: None,
            channel: stated(&self.channel),
            known_effects: self.scope.known_effects.clone(),
            models: Vec::new(),
            notes: Vec::new(),
            reference: self.reference.clone(),
            lag: lag_of(self.scope.thermistor_lag.as_ref()),
            frame: Convention::Rosetta.sensor_frame().to_owned(),
            coefficients: Coefficients {
                linearisation: self.scope.linearisation.as_ref().map(|l| l.applied.clone()),
                matrix: Some(MatrixForm::Alignment(Convention::Rosetta)),
                offset: (!self.b_off_x.is_empty()).then_some(OffsetQuantity::BOff),
                remainders: stds(Parameter::Sigma, self.sigma_remainder)
                    .chain(stds(Parameter::Xi, self.xi_remainder_deg))
                    .collect(),
                valid_degc: Some(self.valid_degc),
                range: along_sensor_axes(self.scope.valid_field_nt),
                ..parts
            },
        }
    }
}
