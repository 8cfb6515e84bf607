//! The covariance of the values of a ground calibration file, and what the file says of the way from a reading to the field.

use super::{B_OFF, B_OR, Family, RpcMag, SIGMA, XI};
use crate::data::across::CentreResidual;
use crate::data::apply::OffsetQuantity;
use crate::data::convention::Convention;
use crate::data::result::Covariance;
use crate::data::run::Location;
use crate::data::units::COMPONENTS;
use crate::files::parameter::{FieldPart, matrix_of};
use crate::model::alignment::UncertainAlignment;
use crate::model::field_calibration::{Coefficient, Coefficients, FieldRange, MatrixForm, Parameter};
use nalgebra::{DMatrix, Matrix3};
use std::collections::BTreeMap;
use std::path::Path;

/// The covariances that are known so far, in blocks that are independent of each other.
#[derive(Default)]
pub(super) struct Known {
    blocks: Vec<(Vec<String>, DMatrix<f64>)>,
    /// One of them is not known.
    lacks: bool,
}

/// Components of a family: axes, or pairs of them.
fn components(family: &Family) -> [&'static str; 3] {
    family.names.map(|name| name.rsplit_once('_').map_or(name, |(_, component)| component))
}

/// Name of the coefficient of a component: `SIGMA_00_x`.
fn label(family: &Family, power: usize, component: usize) -> Option<String> {
    Some(format!("{}_{}", family.labels.get(power)?, components(family)[component]))
}

impl Known {
    fn block(&mut self, block: Option<(Vec<String>, DMatrix<f64>)>) {
        match block.filter(|(_, c)| c.iter().all(|v| v.is_finite())) {
            Some(block) => self.blocks.push(block),
            None => self.lacks = true,
        }
    }

    /// Everything that the transfer from beside the centre makes.
    pub(super) fn together(&mut self, stated: Option<&Covariance>) {
        let block = stated.and_then(|c| {
            let whole = matrix_of(&c.matrix, c.parameters.len())?;
            let at: Vec<(usize, String)> =
                c.parameters.iter().enumerate().filter_map(|(i, name)| Some((i, of_together(name)?))).collect();
            let part = DMatrix::from_fn(at.len(), at.len(), |i, k| whole[(at[i].0, at[k].0)]);
            Some((at.into_iter().map(|(_, name)| name).collect(), part))
        });
        self.block(block);
    }

    /// Sensitivities and angles of polynomials at the centre.
    pub(super) fn alignment(&mut self, alignment: &UncertainAlignment) {
        let names =
            |family: &Family, i: usize, count: usize| -> Vec<String> { (0..count).filter_map(|k| label(family, k, i)).collect() };
        let families = [(SIGMA, &alignment.sigma), (XI, &alignment.xi_deg)];
        let all = families.iter().flat_map(|(family, polynomials)| {
            polynomials.iter().enumerate().flat_map(|(i, p)| names(family, i, p.coefficients.len()))
        });
        let all: Vec<String> = all.collect();
        self.block(alignment.covariance.clone().filter(|c| c.nrows() == all.len()).map(|c| (all, c)));
    }

    /// Offsets that a file of their own states.
    pub(super) fn offset(&mut self, stated: &BTreeMap<String, Vec<Vec<f64>>>) {
        for (i, name) in B_OFF.names.into_iter().enumerate() {
            let block = stated.get(name).and_then(|rows| {
                let names = (0..rows.len()).filter_map(|k| label(&B_OFF, k, i)).collect();
                Some((names, matrix_of(rows, rows.len())?))
            });
            self.block(block);
        }
    }

    /// Offset and residual field together, and the residual field that an offset at the temperature T2 tells:
    /// `B_RES = A_0 + A_1 T2 - B_off(T2)`.
    pub(super) fn offset_beside(&mut self, stated: &BTreeMap<String, Vec<Vec<f64>>>, residual: &CentreResidual) {
        for (i, name) in B_OR.names.into_iter().enumerate() {
            let block = stated.get(name).zip(residual.b_res_std_ent).and_then(|(rows, std)| {
                let n = rows.len();
                let own = matrix_of(rows, n)?;
                let powers = DMatrix::from_fn(n, 1, |k, _| residual.temperature_degc.powi(k as i32));
                let common = &own * &powers;
                let mut c = DMatrix::zeros(n + 1, n + 1);
                c.view_mut((0, 0), (n, n)).copy_from(&own);
                c.view_mut((0, n), (n, 1)).copy_from(&common);
                c.view_mut((n, 0), (1, n)).copy_from(&common.transpose());
                c[(n, n)] = std[i] * std[i];
                let names = (0..n).filter_map(|k| label(&B_OR, k, i)).chain([format!("B_RES_{}", COMPONENTS[i])]).collect();
                Some((names, c))
            });
            self.block(block);
        }
    }

    /// All of it, or nothing where a part is not known.
    pub(super) fn covariance(self) -> Option<Covariance> {
        if self.lacks || self.blocks.is_empty() {
            return None;
        }
        let parameters: Vec<String> = self.blocks.iter().flat_map(|(names, _)| names.clone()).collect();
        let n = parameters.len();
        let mut matrix = vec![vec![0.0; n]; n];
        let mut begin = 0;
        for (names, block) in &self.blocks {
            for i in 0..names.len() {
                for k in 0..names.len() {
                    matrix[begin + i][begin + k] = block[(i, k)];
                }
            }
            begin += names.len();
        }
        let units = parameters.iter().map(|name| unit(name).to_owned()).collect();
        Some(Covariance { parameters, units, matrix })
    }
}

/// The name in a ground calibration file of a coefficient that a file of the centre names; `None` for those that are not in it.
fn of_together(name: &str) -> Option<String> {
    if let Some(place) = name.strip_prefix("k_inverse.") {
        let (row, column) = place.split_once('.')?;
        let (row, column): (usize, usize) = (row.parse().ok()?, column.parse().ok()?);
        // K⁻¹ is upper triangular.
        return (row <= column).then(|| format!("K_{row}_{}", COMPONENTS[column]));
    }
    let (key, power) = name.rsplit_once('.')?;
    let power: usize = power.parse().ok()?;
    let family = |family: &Family, key: &str| {
        let component = family.names.iter().position(|n| *n == key)?;
        label(family, power, component)
    };
    match key.strip_prefix("off_centre.") {
        Some(key) => family(&XI, key),
        None => family(&SIGMA, key),
    }
}

fn unit(name: &str) -> &'static str {
    let units = [
        ("A_0_", "enT"),
        ("A_1_", "enT/degC"),
        ("B_RES_", "enT"),
        ("SIGMA_00_", "nT/enT"),
        ("SIGMA_01_", "nT/enT/degC"),
        ("XI_10_", "deg"),
        ("XI_11_", "deg/degC"),
    ];
    units.iter().find(|(begin, _)| name.starts_with(begin)).map_or("1", |(_, unit)| unit)
}

/// Whether a file is named like a ground calibration file.
#[must_use]
pub fn is_named(path: &Path) -> bool {
    path.extension().is_some_and(|end| end.eq_ignore_ascii_case("txt"))
}

impl RpcMag {
    /// What it says of the way from a reading to the field, T the calibrated temperature `T_c`.
    ///
    /// Files without a covariance have the standard uncertainties of their values, which are then taken as independent.
    #[must_use]
    pub fn field_part(&self) -> FieldPart {
        let angles = components(&XI);
        let mut named: Vec<(String, f64, Coefficient)> = Vec::new();
        let mut put = |label: String, sign: f64, parameter: Parameter, power: usize, value: f64| {
            named.push((label, sign, Coefficient { parameter, power, value: sign * value }));
        };
        for i in 0..3 {
            let axis = COMPONENTS[i];
            for power in 0..2 {
                put(format!("A_{power}_{axis}"), 1.0, Parameter::Offset(i), power, self.a[power][i]);
                put(format!("SIGMA_0{power}_{axis}"), 1.0, Parameter::Sigma(i), power, self.sigma[power][i]);
                put(format!("XI_1{power}_{}", angles[i]), 1.0, Parameter::Xi(i), power, self.xi[power][i]);
            }
            put(format!("B_RES_{axis}"), -1.0, Parameter::Offset(i), 0, self.b_res_ent[i]);
            for column in i..3 {
                let label = format!("K_{i}_{}", COMPONENTS[column]);
                put(label, 1.0, Parameter::KInverse(i, column), 0, self.k_inverse[i][column]);
            }
        }
        let n = named.len();
        let covariance = match &self.covariance {
            Some(stated) => {
                let at: Vec<Option<usize>> =
                    named.iter().map(|(label, ..)| stated.parameters.iter().position(|p| p == label)).collect();
                let whole = matrix_of(&stated.matrix, stated.parameters.len());
                // What has no row is exact: a slope that was not fitted, K at the centre.
                whole.map(|c| {
                    DMatrix::from_fn(n, n, |i, k| {
                        at[i].zip(at[k]).map_or(0.0, |(row, column)| named[i].1 * named[k].1 * c[(row, column)])
                    })
                })
            }
            None => {
                let stds: Option<Vec<f64>> = named.iter().map(|(label, ..)| self.std_of(label)).collect();
                stds.map(|stds| DMatrix::from_fn(n, n, |i, k| if i == k { stds[i] * stds[i] } else { 0.0 }))
            }
        };
        FieldPart {
            sensor: self.sensor.clone(),
            mode: self.mode.clone(),
            location: Location::Centre,
            position: None,
            channel: None,
            known_effects: self.known_effects.clone(),
            models: Vec::new(),
            notes: Vec::new(),
            reference: self.reference.clone(),
            lag: None,
            frame: Convention::Rosetta.sensor_frame().to_owned(),
            coefficients: Coefficients {
                matrix: Some(MatrixForm::Alignment(Convention::Rosetta)),
                offset: Some(OffsetQuantity::BOff),
                coefficients: named.into_iter().map(|(.., coefficient)| coefficient).collect(),
                covariance,
                valid_degc: Some(self.valid_degc),
                range: self.valid_field_nt.map(|limits_nt| FieldRange { turn: Matrix3::identity(), limits_nt }),
                ..Coefficients::default()
            },
        }
    }

    /// The standard uncertainty of a value, where it is stated: `SIGMA_00_x`.
    fn std_of(&self, label: &str) -> Option<f64> {
        let (family, component) = label.rsplit_once('_')?;
        let place = match component {
            "x" | "xy" => 0,
            "y" | "xz" => 1,
            _ => 2,
        };
        // Without a transfer to the centre K is the identity, and an offset of a turned sensor holds no residual field: both are exact.
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let exact = match family {
            "B_RES" => self.b_res_ent == [0.0; 3],
            "K_0" | "K_1" | "K_2" => self.k_inverse == identity,
            _ => false,
        };
        let stated = self.std.get(family).and_then(|std| std.get(place)).copied();
        stated.or(exact.then_some(0.0))
    }
}
