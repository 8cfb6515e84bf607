//! Temperature polynomials at the centre of the coil system from a temperature cycle beside it (RO-IGEP-TR0028 section 3.2.2).
//!
//! A pair of linear calibrations at one temperature T1, off-centre and at the centre, gives `k_i` and `K`; these take the polynomials
//! measured off-centre to the centre. Without an off-centre run the polynomials themselves stand for it, as in the report.

use crate::data::convention::column_angles_deg;
use crate::files::parameter::{CentreConvention, CentreResidual, CentreRun, OffCentrePart, Point, Tcf, Tpf, Values};
use crate::fit::{FitError, Limits, polynomial, propagate};
use crate::measure::thermal::{SAME_DEGC, rows};
use crate::model::off_centre::Transfer;
use crate::model::polynomial::value;
use nalgebra::{DMatrix, Matrix3};
use std::collections::BTreeMap;
use thiserror::Error;

/// What the transfer needs beside the polynomials.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// Linear calibration at the centre; its temperature is T1.
    pub centre: &'a Point,
    /// Linear calibration off-centre at T1; without it the polynomials stand for it.
    pub off_centre: Option<&'a Point>,
    /// Offset measured by turning the sensor; without it the offset stays together with the residual field.
    pub offset: Option<&'a Point>,
}

impl Pair<'_> {
    /// Whether the pair is of the sensor and mode of these polynomials.
    #[must_use]
    pub fn fits(&self, tpf: &Tpf) -> bool {
        (&self.centre.run.sensor, &self.centre.run.mode) == (&tpf.head.sensor, &tpf.head.mode)
    }
}

/// Why there are no polynomials at the centre.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CentreError {
    /// A file of another kind.
    #[error("{file} is no {wanted}")]
    Kind {
        /// The file.
        file: String,
        /// What it should be.
        wanted: &'static str,
    },
    /// A run without temperature.
    #[error("{0} states no sensor temperature")]
    NoTemperature(String),
    /// A run of another sensor or mode.
    #[error("{file} is of {found}, {centre} of {wanted}")]
    Other {
        /// The file.
        file: String,
        /// Its sensor and mode.
        found: String,
        /// The file at the centre.
        centre: String,
        /// Its sensor and mode.
        wanted: String,
    },
    /// Values of no sensor.
    #[error(
        "{0} and the values off-centre give no k and K: a sensitivity is zero, or no three axes have such angles between them"
    )]
    NoTransfer(String),
    /// The numbers do not work out.
    #[error("the polynomials cannot be taken to the centre: {0}")]
    Fit(#[from] FitError),
}

impl CentreError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            CentreError::Kind { .. } => "name CPF files with --centre and --off-centre, an OPF file with --offset",
            CentreError::NoTemperature(_) => "write temperature_degc into its [run], or name a run that has it",
            CentreError::Other { .. } => "name files of one sensor in one mode",
            CentreError::NoTransfer(_) | CentreError::Fit(_) => "check the values of the files",
        }
    }
}

/// Temperatures at which the angles of ω⁰ are compared with their polynomials.
const NODES: usize = 33;
const SIGMA: [&str; 3] = ["sigma_x", "sigma_y", "sigma_z"];
const XI: [&str; 3] = ["xi_xy", "xi_xz", "xi_yz"];
const B_OR: [&str; 3] = ["b_or_x", "b_or_y", "b_or_z"];
const B_OFF: [&str; 3] = ["b_off_x", "b_off_y", "b_off_z"];

/// Values that are carried on, with their covariance as far as it is known.
struct Known {
    x: Vec<f64>,
    blocks: Vec<Option<DMatrix<f64>>>,
}

impl Known {
    fn new() -> Self {
        Self { x: Vec::new(), blocks: Vec::new() }
    }

    fn polynomial(mut self, p: &[f64], covariance: Option<&Vec<Vec<f64>>>) -> Self {
        let n = p.len();
        self.x.extend_from_slice(p);
        let square = covariance.filter(|c| c.len() == n && c.iter().all(|r| r.len() == n && r.iter().all(|v| v.is_finite())));
        self.blocks.push(square.map(|c| DMatrix::from_fn(n, n, |i, k| c[i][k])));
        self
    }

    fn value(mut self, value: f64, std: Option<f64>) -> Self {
        self.x.push(value);
        self.blocks.push(std.filter(|s| s.is_finite()).map(|s| DMatrix::from_element(1, 1, s * s)));
        self
    }

    /// A function of the values with its covariance.
    fn carry(&self, f: impl Fn(&[f64]) -> Vec<f64>) -> Result<(Vec<f64>, Option<DMatrix<f64>>), FitError> {
        let all: Option<Vec<&DMatrix<f64>>> = self.blocks.iter().map(Option::as_ref).collect();
        let Some(blocks) = all else { return Ok((f(&self.x), None)) };
        let mut covariance = DMatrix::zeros(self.x.len(), self.x.len());
        let mut at = 0;
        for block in blocks {
            covariance.view_mut((at, at), block.shape()).copy_from(block);
            at += block.nrows();
        }
        let carried = propagate::propagate(f, &self.x, &covariance)?;
        Ok((carried.values, Some(carried.covariance)))
    }
}

/// The polynomials of a temperature cycle beside the centre as they are at the centre.
///
/// # Errors
/// [`CentreError`]: files of another kind, sensor or mode, a missing temperature, values of no sensor.
pub fn centre(tpf: &Tpf, pair: Pair) -> Result<Tcf, CentreError> {
    let mut warnings = Vec::new();
    let centre = linear(pair.centre, pair.centre)?;
    let t1 = centre.temperature_degc.ok_or_else(|| CentreError::NoTemperature(centre.file.clone()))?;
    let off_run = pair.off_centre.map(|p| linear(p, pair.centre)).transpose()?;
    let sigma1 = [&tpf.sigma_x, &tpf.sigma_y, &tpf.sigma_z];
    let xi1 = [&tpf.xi_xy, &tpf.xi_xz, &tpf.xi_yz];
    let b_or = [&tpf.b_or_x, &tpf.b_or_y, &tpf.b_or_z];
    let covariance1 = |name: &str| tpf.head.covariance.get(name);
    let each = |p: [&Vec<f64>; 3]| p.map(|p| value(p, t1));
    let [low, high] = tpf.head.valid_degc;
    if !(low..=high).contains(&t1) {
        warnings
            .push(format!("T1 = {t1:.2} °C lies outside of the temperatures {low:.1} to {high:.1} °C of the off-centre runs"));
    }
    let off = off_run.clone().unwrap_or_else(|| CentreRun {
        file: "polynomials".to_owned(),
        temperature_degc: Some(t1),
        sigma: each(sigma1),
        xi_deg: each(xi1),
        sigma_std: None,
        xi_std_deg: None,
    });
    match off.temperature_degc {
        None => warnings.push(format!("{} states no sensor temperature: whether it was at T1 cannot be told", off.file)),
        Some(t) if (t - t1).abs() > SAME_DEGC => {
            let ppm = (0..3).map(|i| (value(sigma1[i], t) / value(sigma1[i], t1) - 1.0).abs() * 1e6).fold(0.0, f64::max);
            let angle = (0..3).map(|i| (value(xi1[i], t) - value(xi1[i], t1)).abs() * 3600.0).fold(0.0, f64::max);
            warnings.push(format!(
                "the pair is not at one temperature: {} at {t:.2} °C, {} at {t1:.2} °C; the sensor alone changes k by up to {ppm:.1} ppm and the \
                 angles by up to {angle:.2}'' between them",
                off.file, centre.file
            ));
        }
        Some(_) => {}
    }

    let transfer = Transfer::new((off.sigma, off.xi_deg), (centre.sigma, centre.xi_deg))
        .map_err(|_| CentreError::NoTransfer(centre.file.clone()))?;
    let mut covariance = BTreeMap::new();
    let mut keep = |name: &str, c: Option<DMatrix<f64>>| {
        if let Some(c) = c {
            covariance.insert(name.to_owned(), rows(&c));
        }
    };
    let std_of = |std: &Option<[f64; 3]>, i: usize| std.map(|s| s[i]);

    let mut sigma0: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::new());
    let mut k_std = Some([0.0; 3]);
    for i in 0..3 {
        let n = sigma1[i].len();
        let mut known =
            Known::new().polynomial(sigma1[i], covariance1(SIGMA[i])).value(centre.sigma[i], std_of(&centre.sigma_std, i));
        if let Some(run) = &off_run {
            known = known.value(run.sigma[i], std_of(&run.sigma_std, i));
        }
        let (mut values, c) = known.carry(|x| {
            let at_t1 = x.get(n + 1).copied().unwrap_or_else(|| value(&x[..n], t1));
            let k = at_t1 / x[n];
            x[..n].iter().map(|p| p / k).chain([k]).collect()
        })?;
        values.truncate(n);
        sigma0[i] = values;
        k_std = k_std.zip(c.as_ref()).map(|(mut all, c)| {
            all[i] = c[(n, n)].max(0.0).sqrt();
            all
        });
        keep(SIGMA[i], c.map(|c| c.view((0, 0), (n, n)).into_owned()));
    }

    let (xi0, k_inverse_std, xi_remainder_deg) = {
        let counts = xi1.map(|p| p.len());
        let coefficients: usize = counts.iter().sum();
        let mut known = Known::new();
        for i in 0..3 {
            known = known.polynomial(xi1[i], covariance1(XI[i]));
        }
        for run in std::iter::once(&centre).chain(&off_run) {
            for i in 0..3 {
                known = known.value(run.xi_deg[i], std_of(&run.xi_std_deg, i));
            }
        }
        let order = counts.into_iter().max().unwrap_or(1).saturating_sub(1);
        // Chebyshev's temperatures, both ends among them, keep the polynomial close everywhere in the range.
        let node = |i: usize| {
            let phase = std::f64::consts::PI * i as f64 / (NODES - 1) as f64;
            0.5 * (low + high) + 0.5 * (high - low) * phase.cos()
        };
        let nodes: Vec<f64> = (0..NODES).map(node).collect();
        let angles = |x: &[f64]| -> Option<(Matrix3<f64>, [polynomial::Polynomial; 3])> {
            let mut from = 0;
            let p: [&[f64]; 3] = counts.map(|n| {
                from += n;
                &x[from - n..from]
            });
            let three = |at: usize| -> [f64; 3] { std::array::from_fn(|i| x[coefficients + at + i]) };
            let at_t1 = if x.len() > coefficients + 3 { three(3) } else { p.map(|p| value(p, t1)) };
            let transfer = Transfer::new((off.sigma, at_t1), (centre.sigma, three(0))).ok()?;
            let at = |t: &f64| Some(column_angles_deg(&transfer.omega(p.map(|p| value(p, *t))).ok()?));
            let xi: Vec<[f64; 3]> = nodes.iter().map(at).collect::<Option<_>>()?;
            let one = |i: usize| {
                let y: Vec<f64> = xi.iter().map(|xi| xi[i]).collect();
                polynomial::fit(&nodes, &y, None, order, &Limits::default()).ok()
            };
            Some((transfer.k_inverse, [one(0)?, one(1)?, one(2)?]))
        };
        let flat = |x: &[f64]| match angles(x) {
            Some((k_inverse, fits)) => {
                fits.iter().flat_map(|f| f.coefficients.iter().copied()).chain(k_inverse.transpose().iter().copied()).collect()
            }
            None => vec![f64::NAN; 3 * (order + 1) + 9],
        };
        let (values, c) = known.carry(flat)?;
        if values.iter().any(|v| !v.is_finite()) {
            return Err(CentreError::NoTransfer(centre.file.clone()));
        }
        let n = order + 1;
        let xi0: [Vec<f64>; 3] = std::array::from_fn(|i| values[i * n..(i + 1) * n].to_vec());
        for i in 0..3 {
            keep(XI[i], c.as_ref().map(|c| c.view((i * n, i * n), (n, n)).into_owned()));
        }
        let element = |c: &DMatrix<f64>, at: usize| c[(3 * n + at, 3 * n + at)].max(0.0).sqrt();
        let std = c.map(|c| std::array::from_fn(|r| std::array::from_fn(|s| element(&c, 3 * r + s))));
        let largest = |f: &polynomial::Polynomial| f.residuals.iter().copied().map(f64::abs).fold(0.0, f64::max);
        let remainder = angles(&known.x).map_or([f64::NAN; 3], |(_, fits)| std::array::from_fn(|i| largest(&fits[i])));
        (xi0, std, remainder)
    };

    let mut b_off: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::new());
    let residual_field = pair.offset.map(|p| residual(p, pair.centre)).transpose()?.map(|(mut part, std)| {
        let t2 = part.temperature_degc;
        let mut all_std = Some([0.0; 3]);
        for i in 0..3 {
            let n = b_or[i].len();
            let known = Known::new().polynomial(b_or[i], covariance1(B_OR[i])).value(part.b_off_ent[i], std_of(&std, i));
            let (mut values, c) = known.carry(|x| {
                let b_res = value(&x[..n], t2) - x[n];
                x[..n].iter().enumerate().map(|(k, p)| if k == 0 { p - b_res } else { *p }).chain([b_res]).collect()
            })?;
            part.b_res_ent[i] = values[n];
            all_std = all_std.zip(c.as_ref()).map(|(mut all, c)| {
                all[i] = c[(n, n)].max(0.0).sqrt();
                all
            });
            values.truncate(n);
            b_off[i] = values;
            keep(B_OFF[i], c.map(|c| c.view((0, 0), (n, n)).into_owned()));
        }
        part.b_res_std_ent = all_std;
        if !(low..=high).contains(&t2) {
            warnings.push(format!("{} at {t2:.2} °C lies outside of the temperatures of the off-centre runs", part.file));
        }
        Ok::<CentreResidual, CentreError>(part)
    });
    let residual_field = residual_field.transpose()?;
    let known: Vec<&str> = SIGMA.iter().chain(&XI).chain(B_OFF.iter().filter(|_| residual_field.is_some())).copied().collect();
    let unknown: Vec<&str> = known.into_iter().filter(|name| !covariance.contains_key(*name)).collect();
    if !unknown.is_empty() {
        warnings.push(format!(
            "the uncertainty of {} at the centre is not known: a file it rests on states none",
            unknown.join(", ")
        ));
    }

    let [sigma_x, sigma_y, sigma_z] = sigma0;
    let [xi_xy, xi_xz, xi_yz] = xi0;
    let [b_off_x, b_off_y, b_off_z] = b_off;
    let named = [(SIGMA, sigma1), (XI, xi1), (B_OR, b_or)];
    let coefficients = named.iter().flat_map(|(names, p)| (0..3).map(|i| (names[i].to_owned(), p[i].clone()))).collect();
    let matrix = |m: &Matrix3<f64>| std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]));
    Ok(Tcf {
        sigma_x,
        sigma_y,
        sigma_z,
        xi_xy,
        xi_xz,
        xi_yz,
        b_off_x,
        b_off_y,
        b_off_z,
        xi_remainder_deg,
        k: transfer.k,
        k_std,
        k_matrix: matrix(&transfer.k_matrix),
        k_inverse: matrix(&transfer.k_inverse),
        k_inverse_std,
        reference_degc: t1,
        valid_degc: tpf.head.valid_degc,
        channel: tpf.head.channel.clone(),
        sensor: tpf.head.sensor.clone(),
        mode: tpf.head.mode.clone(),
        used: tpf.head.used.clone(),
        runs: tpf.head.runs.clone(),
        convention: CentreConvention::default(),
        covariance,
        centre,
        off_centre: OffCentrePart { at_reference: off, coefficients, covariance: tpf.head.covariance.clone() },
        residual_field,
        warnings,
    })
}

/// Refuses a run of another sensor or mode than the one at the centre.
fn same_sensor(point: &Point, centre: &Point) -> Result<(), CentreError> {
    let of = |p: &Point| format!("sensor `{}` mode `{}`", p.run.sensor, p.run.mode);
    if (&point.run.sensor, &point.run.mode) == (&centre.run.sensor, &centre.run.mode) {
        return Ok(());
    }
    Err(CentreError::Other { file: point.file.clone(), found: of(point), centre: centre.file.clone(), wanted: of(centre) })
}

fn linear(point: &Point, centre: &Point) -> Result<CentreRun, CentreError> {
    same_sensor(point, centre)?;
    let Values::Lin { sigma, xi_deg, std, .. } = &point.values else {
        return Err(CentreError::Kind { file: point.file.clone(), wanted: "linear calibration (CPF)" });
    };
    Ok(CentreRun {
        file: point.file.clone(),
        temperature_degc: point.run.temperature_degc,
        sigma: *sigma,
        xi_deg: *xi_deg,
        sigma_std: std[0],
        xi_std_deg: std[1],
    })
}

/// The residual field before it is computed, and the uncertainty of the offset.
fn residual(point: &Point, centre: &Point) -> Result<(CentreResidual, Option<[f64; 3]>), CentreError> {
    same_sensor(point, centre)?;
    let Values::Offset { offset_ent, std, .. } = &point.values else {
        return Err(CentreError::Kind { file: point.file.clone(), wanted: "offset measurement (OPF)" });
    };
    if let Some(i) = (0..3).find(|i| !offset_ent[*i].is_finite()) {
        let wanted = ["offset measurement of x", "offset measurement of y", "offset measurement of z"][i];
        return Err(CentreError::Kind { file: point.file.clone(), wanted });
    }
    let temperature_degc = point.run.temperature_degc.ok_or_else(|| CentreError::NoTemperature(point.file.clone()))?;
    let part = CentreResidual {
        file: point.file.clone(),
        temperature_degc,
        b_off_ent: *offset_ent,
        b_res_ent: [0.0; 3],
        b_res_std_ent: None,
    };
    Ok((part, *std))
}
