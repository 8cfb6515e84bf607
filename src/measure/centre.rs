//! Temperature polynomials at the centre of the coil system from a temperature cycle beside it (RO-IGEP-TR0028 section 3.2.2).
//!
//! A pair of linear calibrations at one temperature T1, off-centre and at the centre, gives `k_i` and `K`; these take the polynomials
//! measured off-centre to the centre. Without an off-centre run the polynomials themselves stand for it, as in the report.

use crate::data::across::{CalibratedRun, CentreResidual, PairedCalibration, RunValues};
use crate::data::convention::column_angles_deg;
use crate::data::note::{Note, NoteKind};
use crate::data::result::Rows;
use crate::fit::{FitError, Limits, polynomial, propagate};
use crate::measure::thermal::SAME_DEGC;
use crate::model::off_centre::Transfer;
use crate::model::polynomial::{TemperaturePolynomial, value};
use nalgebra::{DMatrix, Matrix3};
use thiserror::Error;

/// Polynomials of a temperature cycle beside the centre. A covariance of another size than the coefficients stands for one that is not
/// known.
#[derive(Clone, Debug, PartialEq)]
pub struct OffCentre {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Ids of the runs.
    pub runs: Vec<String>,
    /// Lowest and highest temperature for which all polynomials hold, °C.
    pub valid_degc: [f64; 2],
    /// Sensitivities, nT/enT.
    pub sigma: [TemperaturePolynomial; 3],
    /// Angles ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [TemperaturePolynomial; 3],
    /// Offset and residual field, enT.
    pub b_or_ent: [TemperaturePolynomial; 3],
}

/// What the transfer needs beside the polynomials.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// Linear calibration at the centre; its temperature is T1.
    pub centre: &'a CalibratedRun,
    /// Linear calibration off-centre at T1; without it the polynomials stand for it.
    pub off_centre: Option<&'a CalibratedRun>,
    /// Offset measured by turning the sensor; without it the offset stays together with the residual field.
    pub offset: Option<&'a CalibratedRun>,
}

impl Pair<'_> {
    /// Whether the pair is of this sensor and mode.
    #[must_use]
    pub fn fits(&self, sensor: &str, mode: &str) -> bool {
        (self.centre.run.sensor.as_str(), self.centre.run.mode.as_str()) == (sensor, mode)
    }
}

/// Temperature polynomials at the centre. A covariance of size zero is not known.
#[derive(Clone, Debug, PartialEq)]
pub struct AtCentre {
    /// The polynomials they were made from.
    pub beside: OffCentre,
    /// Sensitivities, nT/enT.
    pub sigma: [TemperaturePolynomial; 3],
    /// Angles ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [TemperaturePolynomial; 3],
    /// Offset and residual field of the coil system, where the offset at the centre was measured.
    pub offset: Option<OffsetAtCentre>,
    /// Largest difference between the polynomials ξ and the angles of ω⁰(T) over the range, degrees.
    pub xi_remainder_deg: [f64; 3],
    /// `k`, `K` and `K⁻¹`.
    pub transfer: Transfer,
    /// Standard uncertainty of `k_i`.
    pub k_std: Option<[f64; 3]>,
    /// Standard uncertainties of the elements of `K⁻¹`.
    pub k_inverse_std: Option<Rows>,
    /// T1, the sensor temperature of the run at the centre, °C.
    pub reference_degc: f64,
    /// The run at the centre.
    pub centre: PairedCalibration,
    /// What stands for σ¹(T1) and ξ¹(T1).
    pub at_reference: PairedCalibration,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// The offset at the centre.
#[derive(Clone, Debug, PartialEq)]
pub struct OffsetAtCentre {
    /// Offsets, enT.
    pub b_off_ent: [TemperaturePolynomial; 3],
    /// Residual field of the coil system where the temperature cycle was measured.
    pub residual: CentreResidual,
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

/// Temperatures at which the angles of ω⁰ are compared with their polynomials: several per coefficient at the highest order, 5.
const NODES: usize = 33;

/// Values that are carried on, with their covariance as far as it is known.
struct Uncertain {
    x: Vec<f64>,
    blocks: Vec<Option<DMatrix<f64>>>,
}

impl Uncertain {
    fn new() -> Self {
        Self { x: Vec::new(), blocks: Vec::new() }
    }

    fn polynomial(mut self, p: &TemperaturePolynomial) -> Self {
        let n = p.coefficients.len();
        self.x.extend_from_slice(&p.coefficients);
        let is_known = p.covariance.shape() == (n, n) && p.covariance.iter().all(|v| v.is_finite());
        self.blocks.push(is_known.then(|| p.covariance.clone()));
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
pub fn centre(beside: &OffCentre, pair: Pair) -> Result<AtCentre, CentreError> {
    let centre = linear(pair.centre, pair.centre)?;
    let t1_degc = centre.temperature_degc.ok_or_else(|| CentreError::NoTemperature(centre.file.clone()))?;
    let off_run = pair.off_centre.map(|p| linear(p, pair.centre)).transpose()?;
    let members = Members { beside, centre, off_run, t1_degc };
    let at_reference = members.at_reference();
    let mut notes = members.notes(&at_reference);
    let transfer = Transfer::new((at_reference.sigma, at_reference.xi_deg), (members.centre.sigma, members.centre.xi_deg))
        .map_err(|_| CentreError::NoTransfer(members.centre.file.clone()))?;
    let (sigma, k_std) = members.sensitivities()?;
    let angles = members.angles(at_reference.sigma)?;
    let offset = pair.offset.map(|p| members.offset(residual(p, pair.centre)?, &mut notes)).transpose()?;
    notes.extend(unknown_uncertainties(&sigma, &angles.xi_deg, offset.as_ref()));
    Ok(AtCentre {
        beside: beside.clone(),
        sigma,
        xi_deg: angles.xi_deg,
        offset,
        xi_remainder_deg: angles.remainder_deg,
        transfer,
        k_std,
        k_inverse_std: angles.k_inverse_std,
        reference_degc: t1_degc,
        centre: members.centre,
        at_reference,
        notes,
    })
}

/// A note that names the quantities at the centre without an uncertainty.
fn unknown_uncertainties(
    sigma: &[TemperaturePolynomial; 3],
    xi_deg: &[TemperaturePolynomial; 3],
    offset: Option<&OffsetAtCentre>,
) -> Option<Note> {
    const SIGMA: [&str; 3] = ["sigma_x", "sigma_y", "sigma_z"];
    const XI: [&str; 3] = ["xi_xy", "xi_xz", "xi_yz"];
    const B_OFF: [&str; 3] = ["b_off_x", "b_off_y", "b_off_z"];
    let offsets = offset.into_iter().flat_map(|o| B_OFF.into_iter().zip(&o.b_off_ent));
    let all = SIGMA.into_iter().zip(sigma).chain(XI.into_iter().zip(xi_deg)).chain(offsets);
    let unknown: Vec<&str> = all.filter(|(_, p)| p.covariance.is_empty()).map(|(name, _)| name).collect();
    (!unknown.is_empty()).then(|| {
        let text =
            format!("the uncertainty of {} at the centre is not known: a file it rests on states none", unknown.join(", "));
        Note::new(NoteKind::Method, text)
    })
}

/// What takes part in the transfer.
struct Members<'a> {
    beside: &'a OffCentre,
    centre: PairedCalibration,
    /// The run beside the centre at T1, if there is one.
    off_run: Option<PairedCalibration>,
    t1_degc: f64,
}

/// Angles at the centre.
struct AnglesAtCentre {
    xi_deg: [TemperaturePolynomial; 3],
    k_inverse_std: Option<Rows>,
    remainder_deg: [f64; 3],
}

impl Members<'_> {
    /// What stands for σ¹(T1) and ξ¹(T1): the run beside the centre, or the polynomials.
    fn at_reference(&self) -> PairedCalibration {
        let each = |p: &[TemperaturePolynomial; 3]| std::array::from_fn(|i| value(&p[i].coefficients, self.t1_degc));
        self.off_run.clone().unwrap_or_else(|| PairedCalibration {
            file: "polynomials".to_owned(),
            temperature_degc: Some(self.t1_degc),
            sigma: each(&self.beside.sigma),
            xi_deg: each(&self.beside.xi_deg),
            sigma_std: None,
            xi_std_deg: None,
        })
    }

    /// Whether the pair is at one temperature, within those of the polynomials.
    fn notes(&self, off: &PairedCalibration) -> Vec<Note> {
        let mut notes = Vec::new();
        let t1 = self.t1_degc;
        let [low, high] = self.beside.valid_degc;
        if !(low..=high).contains(&t1) {
            let text =
                format!("T1 = {t1:.2} °C lies outside of the temperatures {low:.1} to {high:.1} °C of the off-centre runs");
            notes.push(Note::new(NoteKind::Temperature, text));
        }
        match off.temperature_degc {
            None => {
                let text = format!("{} states no sensor temperature: whether it was at T1 cannot be told", off.file);
                notes.push(Note::new(NoteKind::Temperature, text).about(&off.file));
            }
            Some(t) if (t - t1).abs() > SAME_DEGC => {
                let (sigma, xi) = (&self.beside.sigma, &self.beside.xi_deg);
                let change = |p: &TemperaturePolynomial| (value(&p.coefficients, t), value(&p.coefficients, t1));
                let ppm = sigma.iter().map(change).map(|(at, at_t1)| (at / at_t1 - 1.0).abs() * 1e6).fold(0.0, f64::max);
                let angle = xi.iter().map(change).map(|(at, at_t1)| (at - at_t1).abs() * 3600.0).fold(0.0, f64::max);
                let text = format!(
                    "the pair is not at one temperature: {} at {t:.2} °C, {} at {t1:.2} °C; the sensor alone changes k by up to {ppm:.1} ppm and the \
                     angles by up to {angle:.2}'' between them",
                    off.file, self.centre.file
                );
                notes.push(Note::new(NoteKind::Temperature, text).about(&off.file));
            }
            Some(_) => {}
        }
        notes
    }

    fn polynomial(&self, coefficients: Vec<f64>, covariance: Option<DMatrix<f64>>) -> TemperaturePolynomial {
        let covariance = covariance.unwrap_or_else(|| DMatrix::zeros(0, 0));
        TemperaturePolynomial { coefficients, covariance, valid_degc: self.beside.valid_degc }
    }

    /// `σ⁰(T) = σ¹(T) / k` and the standard uncertainties of `k`.
    fn sensitivities(&self) -> Result<([TemperaturePolynomial; 3], Option<[f64; 3]>), CentreError> {
        let mut found = self.beside.sigma.clone();
        let mut k_std = Some([0.0; 3]);
        for i in 0..3 {
            let p = &self.beside.sigma[i];
            let n = p.coefficients.len();
            let mut known = Uncertain::new().polynomial(p).value(self.centre.sigma[i], self.centre.sigma_std.map(|s| s[i]));
            if let Some(run) = &self.off_run {
                known = known.value(run.sigma[i], run.sigma_std.map(|s| s[i]));
            }
            let (mut values, c) = known.carry(|x| {
                let at_t1 = x.get(n + 1).copied().unwrap_or_else(|| value(&x[..n], self.t1_degc));
                let k = at_t1 / x[n];
                x[..n].iter().map(|p| p / k).chain([k]).collect()
            })?;
            values.truncate(n);
            keep_std(&mut k_std, i, c.as_ref(), n);
            found[i] = self.polynomial(values, c.map(|c| c.view((0, 0), (n, n)).into_owned()));
        }
        Ok((found, k_std))
    }

    /// `ω⁰(T) = Q(ξ¹(T)) K⁻¹` as polynomials of its angles.
    fn angles(&self, sigma_off: [f64; 3]) -> Result<AnglesAtCentre, CentreError> {
        let mut known = self.beside.xi_deg.iter().fold(Uncertain::new(), Uncertain::polynomial);
        for run in std::iter::once(&self.centre).chain(&self.off_run) {
            for i in 0..3 {
                known = known.value(run.xi_deg[i], run.xi_std_deg.map(|s| s[i]));
            }
        }
        let order = self.beside.xi_deg.iter().map(|p| p.coefficients.len()).max().unwrap_or(1).saturating_sub(1);
        let nodes = self.nodes_degc();
        let flat = |x: &[f64]| match self.angle_fits(x, sigma_off, &nodes, order) {
            Some((k_inverse, fits)) => {
                fits.iter().flat_map(|f| f.coefficients.iter().copied()).chain(k_inverse.transpose().iter().copied()).collect()
            }
            None => vec![f64::NAN; 3 * (order + 1) + 9],
        };
        let (values, c) = known.carry(flat)?;
        if values.iter().any(|v| !v.is_finite()) {
            return Err(CentreError::NoTransfer(self.centre.file.clone()));
        }
        let n = order + 1;
        let xi_deg = std::array::from_fn(|i| {
            let own = c.as_ref().map(|c| c.view((i * n, i * n), (n, n)).into_owned());
            self.polynomial(values[i * n..(i + 1) * n].to_vec(), own)
        });
        let element = |c: &DMatrix<f64>, at: usize| c[(3 * n + at, 3 * n + at)].max(0.0).sqrt();
        let k_inverse_std = c.map(|c| std::array::from_fn(|r| std::array::from_fn(|s| element(&c, 3 * r + s))));
        let largest = |f: &polynomial::Polynomial| f.residuals.iter().copied().map(f64::abs).fold(0.0, f64::max);
        let remainder_deg = self
            .angle_fits(&known.x, sigma_off, &nodes, order)
            .map_or([f64::NAN; 3], |(_, fits)| std::array::from_fn(|i| largest(&fits[i])));
        Ok(AnglesAtCentre { xi_deg, k_inverse_std, remainder_deg })
    }

    /// Chebyshev's temperatures, both ends among them, which keep a polynomial close everywhere in the range, °C.
    fn nodes_degc(&self) -> Vec<f64> {
        let [low, high] = self.beside.valid_degc;
        let node = |i: usize| {
            let phase = std::f64::consts::PI * i as f64 / (NODES - 1) as f64;
            0.5 * (low + high) + 0.5 * (high - low) * phase.cos()
        };
        (0..NODES).map(node).collect()
    }

    /// `K⁻¹` and the polynomials of the angles of ω⁰ for the values `x`: coefficients of ξ¹, the angles at the centre, those of the run
    /// beside it if there is one.
    fn angle_fits(
        &self,
        x: &[f64],
        sigma_off: [f64; 3],
        nodes_degc: &[f64],
        order: usize,
    ) -> Option<(Matrix3<f64>, [polynomial::Polynomial; 3])> {
        let mut from = 0;
        let p: [&[f64]; 3] = std::array::from_fn(|i| {
            let n = self.beside.xi_deg[i].coefficients.len();
            from += n;
            &x[from - n..from]
        });
        let coefficients = from;
        let three = |at: usize| -> [f64; 3] { std::array::from_fn(|i| x[coefficients + at + i]) };
        let at_t1 = if x.len() > coefficients + 3 { three(3) } else { p.map(|p| value(p, self.t1_degc)) };
        let transfer = Transfer::new((sigma_off, at_t1), (self.centre.sigma, three(0))).ok()?;
        let at = |t: &f64| Some(column_angles_deg(&transfer.omega(p.map(|p| value(p, *t))).ok()?));
        let xi: Vec<[f64; 3]> = nodes_degc.iter().map(at).collect::<Option<_>>()?;
        let one = |i: usize| {
            let y: Vec<f64> = xi.iter().map(|xi| xi[i]).collect();
            polynomial::fit(nodes_degc, &y, None, order, &Limits::default()).ok()
        };
        Some((transfer.k_inverse, [one(0)?, one(1)?, one(2)?]))
    }

    /// `B_off(T) = B_or(T) - B_res` with the residual field from the offset that was measured at T2.
    fn offset(
        &self,
        (mut residual, std): (CentreResidual, Option<[f64; 3]>),
        notes: &mut Vec<Note>,
    ) -> Result<OffsetAtCentre, CentreError> {
        let t2 = residual.temperature_degc;
        let mut found = self.beside.b_or_ent.clone();
        let mut all_std = Some([0.0; 3]);
        for i in 0..3 {
            let p = &self.beside.b_or_ent[i];
            let n = p.coefficients.len();
            let known = Uncertain::new().polynomial(p).value(residual.b_off_ent[i], std.map(|s| s[i]));
            let (mut values, c) = known.carry(|x| {
                let b_res = value(&x[..n], t2) - x[n];
                x[..n].iter().enumerate().map(|(k, p)| if k == 0 { p - b_res } else { *p }).chain([b_res]).collect()
            })?;
            residual.b_res_ent[i] = values[n];
            keep_std(&mut all_std, i, c.as_ref(), n);
            values.truncate(n);
            found[i] = self.polynomial(values, c.map(|c| c.view((0, 0), (n, n)).into_owned()));
        }
        residual.b_res_std_ent = all_std;
        let [low, high] = self.beside.valid_degc;
        if !(low..=high).contains(&t2) {
            let text = format!("{} at {t2:.2} °C lies outside of the temperatures of the off-centre runs", residual.file);
            notes.push(Note::new(NoteKind::Temperature, text).about(&residual.file));
        }
        Ok(OffsetAtCentre { b_off_ent: found, residual })
    }
}

/// Keeps the standard uncertainty of element `at` for a component, as long as all components have one.
fn keep_std(all: &mut Option<[f64; 3]>, component: usize, covariance: Option<&DMatrix<f64>>, at: usize) {
    *all = all.zip(covariance).map(|(mut all, c)| {
        all[component] = c[(at, at)].max(0.0).sqrt();
        all
    });
}

/// Refuses a run of another sensor or mode than the one at the centre.
fn same_sensor(point: &CalibratedRun, centre: &CalibratedRun) -> Result<(), CentreError> {
    let of = |p: &CalibratedRun| format!("sensor `{}` mode `{}`", p.run.sensor, p.run.mode);
    if (&point.run.sensor, &point.run.mode) == (&centre.run.sensor, &centre.run.mode) {
        return Ok(());
    }
    Err(CentreError::Other { file: point.file.clone(), found: of(point), centre: centre.file.clone(), wanted: of(centre) })
}

fn linear(point: &CalibratedRun, centre: &CalibratedRun) -> Result<PairedCalibration, CentreError> {
    same_sensor(point, centre)?;
    let RunValues::Lin { sigma, xi_deg, std, .. } = &point.values else {
        return Err(CentreError::Kind { file: point.file.clone(), wanted: "linear calibration (CPF)" });
    };
    Ok(PairedCalibration {
        file: point.file.clone(),
        temperature_degc: point.run.temperature_degc,
        sigma: *sigma,
        xi_deg: *xi_deg,
        sigma_std: std[0],
        xi_std_deg: std[1],
    })
}

/// The residual field before it is computed, and the uncertainty of the offset.
fn residual(point: &CalibratedRun, centre: &CalibratedRun) -> Result<(CentreResidual, Option<[f64; 3]>), CentreError> {
    same_sensor(point, centre)?;
    let RunValues::Offset { offset_ent, std, .. } = &point.values else {
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
