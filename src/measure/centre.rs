//! Temperature polynomials at the centre of the coil system from a temperature cycle beside it (RO-IGEP-TR0028 section 3.2.2).
//!
//! A pair of linear calibrations at one temperature T1, off-centre and at the centre, gives `k_i` and `K`; these take the polynomials
//! measured off-centre to the centre. Without an off-centre run the polynomials themselves stand for it, as in the report.
//!
//! The report's ω is that of the Rosetta convention; the calibrations of runs and their polynomials state angles and sensitivities in the
//! BepiColombo convention. Everything is converted exactly before `k` and `K` are formed.

mod refusal;
#[cfg(test)]
mod tests;

pub use refusal::CentreError;

use crate::data::across::{CalibratedRun, CentreResidual, CommonChange, LinearScope, PairedCalibration, RunValues};
use crate::data::convention::{Alignment, Convention};
use crate::data::note::{Note, NoteKind};
use crate::data::result::Rows;
use crate::fit::statistics::std_of;
use crate::fit::{FitError, Limits, order, propagate};
use crate::measure::thermal::SAME_DEGC;
use crate::model::alignment::{AlignmentPolynomials, Through, nodes_degc};
use crate::model::off_centre::Transfer;
use crate::model::polynomial::{TemperaturePolynomial, value};
use nalgebra::{DMatrix, DVector};

/// Polynomials of a temperature cycle beside the centre. A covariance of another size than the coefficients stands for one that is not
/// known.
#[derive(Clone, Debug, PartialEq)]
pub struct OffCentre {
    /// Convention of σ and ξ: BepiColombo as they come in, Rosetta in a result.
    pub convention: Convention,
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
    /// What they hold for, beside temperatures.
    pub scope: LinearScope,
    /// What the facility that the runs share adds to the uncertainty of σ and ξ: how their coefficients, σ_x to ξ_yz, change by one standard
    /// deviation of everything that is not known better, with what that is. Absent where it is not stated, and neither as one change per
    /// quantity; covariances are those of both types then.
    pub of_facility: Option<Vec<(String, [Vec<f64>; 6])>>,
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

/// The results of runs of one kind, sensor and mode at the centre as one: the mean of those at one temperature, each weighted with its
/// uncertainty, which is widened where they scatter by more. That temperature is the one nearest to `near_degc`, or without it the one at
/// which there are most runs, the first of them where it is a draw. Runs at other temperatures, or without one, are left out, and a note
/// names them.
///
/// The mean has the names of its files and runs with commas between them.
#[must_use]
pub fn together(runs: &[&CalibratedRun], near_degc: Option<f64>) -> Option<(CalibratedRun, Vec<String>, Option<Note>)> {
    let degc = |p: &CalibratedRun| p.run.temperature_degc.filter(|t| t.is_finite());
    let beside = |at: f64| runs.iter().filter(move |p| degc(p).is_some_and(|t| (t - at).abs() <= SAME_DEGC));
    let mut temperatures: Vec<f64> = runs.iter().filter_map(|p| degc(p)).collect();
    match near_degc {
        Some(near) => temperatures.sort_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs())),
        None => temperatures.sort_by_key(|t| std::cmp::Reverse(beside(*t).count())),
    }
    let mut used: Vec<&CalibratedRun> = beside(*temperatures.first()?).copied().collect();
    // Values of readings that were made straight are no values of raw ones.
    let first = *used.first()?;
    used.retain(|p| LinearScope::common(scope_of(first).into_iter().chain(scope_of(p))).is_ok());
    let files: Vec<String> = used.iter().map(|p| p.file.clone()).collect();
    let left_out: Vec<&str> = runs.iter().map(|p| p.file.as_str()).filter(|file| !files.iter().any(|f| f == file)).collect();
    let note = (!left_out.is_empty()).then(|| {
        let text = format!("{} took no part: at the centre, {} was used", left_out.join(", "), files.join(", "));
        Note::new(NoteKind::LeftOut, text)
    });
    let mean = |get: &dyn Fn(&RunValues) -> Option<Triple>| -> Option<Triple> {
        Some(weighted_mean(&used.iter().map(|p| get(&p.values)).collect::<Option<Vec<Triple>>>()?))
    };
    let mut point = first.clone();
    if used.len() > 1 {
        point.file = files.join(", ");
        point.notes = used.iter().flat_map(|p| p.notes.iter().cloned()).collect();
        point.run.id = used.iter().map(|p| p.run.id.as_str()).collect::<Vec<_>>().join(", ");
        point.run.temperature_degc = Some(used.iter().filter_map(|p| degc(p)).sum::<f64>() / used.len() as f64);
        match &mut point.values {
            RunValues::Lin { sigma, xi_deg, std, scope: own, common, .. } => {
                **own = LinearScope::common(used.iter().filter_map(|p| scope_of(p))).ok()?;
                *common = mean_change(&used);
                (*sigma, std[0]) = mean(&|v| match v {
                    RunValues::Lin { sigma, std, .. } => Some((*sigma, std[0])),
                    _ => None,
                })?;
                (*xi_deg, std[1]) = mean(&|v| match v {
                    RunValues::Lin { xi_deg, std, .. } => Some((*xi_deg, std[1])),
                    _ => None,
                })?;
            }
            RunValues::Offset { offset_ent, std, .. } => {
                (*offset_ent, *std) = mean(&|v| match v {
                    RunValues::Offset { offset_ent, std, .. } => Some((*offset_ent, *std)),
                    _ => None,
                })?;
            }
            RunValues::Freq { .. } => return None,
        }
    }
    Some((point, files, note))
}

/// What a linearity run holds for.
fn scope_of(run: &CalibratedRun) -> Option<&LinearScope> {
    match &run.values {
        RunValues::Lin { scope, .. } => Some(scope),
        _ => None,
    }
}

/// What moves the mean of linearity runs together: of every source the mean of its changes, none in the runs that do not share it. `None` where one
/// does not tell.
fn mean_change(runs: &[&CalibratedRun]) -> Option<Vec<CommonChange>> {
    let mut mean: Vec<CommonChange> = Vec::new();
    let share = (runs.len() as f64).recip();
    for run in runs {
        let RunValues::Lin { common, .. } = &run.values else { continue };
        for one in common.as_ref()? {
            let [sigma, xi_deg, b_or_ent] = one.all().map(|change| change.map(|value| value * share));
            match mean.iter_mut().find(|known| known.source == one.source) {
                Some(known) => {
                    for (sum, change) in [(&mut known.sigma, sigma), (&mut known.xi_deg, xi_deg), (&mut known.b_or_ent, b_or_ent)]
                    {
                        (0..3).for_each(|i| sum[i] += change[i]);
                    }
                }
                None => mean.push(CommonChange { source: one.source.clone(), sigma, xi_deg, b_or_ent }),
            }
        }
    }
    Some(mean)
}

/// Values of three components with their standard uncertainties, if those are known.
type Triple = ([f64; 3], Option<[f64; 3]>);

/// Mean per component with the weights of known uncertainties, to which what the runs scatter by is added, or of equal ones whose size is then not known.
fn weighted_mean(all: &[Triple]) -> Triple {
    let (mut value, mut std) = ([f64::NAN; 3], Some([f64::NAN; 3]));
    for i in 0..3 {
        let values: Vec<f64> = all.iter().map(|(v, _)| v[i]).collect();
        let own: Option<Vec<f64>> = all.iter().map(|(_, s)| s.map(|s| s[i]).filter(|s| s.is_finite() && *s > 0.0)).collect();
        let known = own.is_some();
        let scatter = own
            .as_ref()
            .map_or(0.0, |own| order::scatter(&vec![0.0; all.len()], &values, own, 0, &Limits::default()).unwrap_or(0.0));
        let own = own.unwrap_or_else(|| vec![1.0; all.len()]);
        let weights: Vec<f64> = own.iter().map(|s| s.hypot(scatter).powi(-2)).collect();
        let sum: f64 = weights.iter().sum();
        value[i] = values.iter().zip(&weights).map(|(v, w)| w * v).sum::<f64>() / sum;
        std = std.filter(|_| known).map(|mut std| {
            std[i] = sum.sqrt().recip();
            std
        });
    }
    (value, std)
}

/// Temperature polynomials at the centre, everything in the Rosetta convention of ω. A covariance of size zero is not known.
#[derive(Clone, Debug, PartialEq)]
pub struct AtCentre {
    /// The polynomials they were made from.
    pub beside: OffCentre,
    /// What the polynomials at the centre hold for, beside temperatures.
    pub scope: LinearScope,
    /// Sensitivities, nT/enT.
    pub sigma: [TemperaturePolynomial; 3],
    /// Angles ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [TemperaturePolynomial; 3],
    /// Offset and residual field of the coil system, where the offset at the centre was measured.
    pub offset: Option<OffsetAtCentre>,
    /// Largest difference between the polynomials σ and the lengths of the columns of ω⁰(T) σ⁰(T) over the range, nT/enT.
    pub sigma_remainder: [f64; 3],
    /// Largest difference between the polynomials ξ and the angles of ω⁰(T) over the range, degrees.
    pub xi_remainder_deg: [f64; 3],
    /// Covariance of all coefficients of σ and ξ at the centre, of ξ beside it, and of `K⁻¹` row by row; `None` if it is not known.
    pub together: Option<DMatrix<f64>>,
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

/// Values that are carried on, with their covariance as far as it is known.
struct Uncertain {
    x: Vec<f64>,
    blocks: Vec<Option<DMatrix<f64>>>,
    /// How the values change by one standard deviation each of what several of them share.
    common: Vec<Vec<f64>>,
}

impl Uncertain {
    fn new() -> Self {
        Self { x: Vec::new(), blocks: Vec::new(), common: Vec::new() }
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
        let mut covariance = propagate::block_diagonal(blocks);
        for change in self.common.iter().map(|change| DVector::from_column_slice(change)) {
            covariance += &change * change.transpose();
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
    let common = [Some(pair.centre), pair.off_centre].map(|run| run.map_or_else(Vec::new, of_facility));
    let members = Members { beside, centre, off_run, common, t1_degc };
    let mut notes = members.notes();
    let scope = scope(beside, &pair)?;
    let linear = members.linear()?;
    let offset = pair.offset.map(|p| members.offset(residual(p, pair.centre)?, &mut notes)).transpose()?;
    notes.extend(unknown_uncertainties(&linear.sigma, &linear.xi_deg, offset.as_ref()));
    let [centre, off_centre] = linear.found.pair;
    Ok(AtCentre {
        beside: OffCentre {
            convention: Convention::Rosetta,
            sigma: linear.beside_sigma,
            xi_deg: linear.beside_xi_deg,
            ..beside.clone()
        },
        scope,
        sigma: linear.sigma,
        xi_deg: linear.xi_deg,
        offset,
        sigma_remainder: linear.found.centre.sigma_remainder,
        xi_remainder_deg: linear.found.centre.xi_remainder_deg,
        together: linear.together,
        transfer: linear.found.transfer,
        k_std: linear.k_std,
        k_inverse_std: linear.k_inverse_std,
        reference_degc: t1_degc,
        centre: in_rosetta(&members.centre, centre)?,
        at_reference: match &members.off_run {
            Some(run) => in_rosetta(run, off_centre)?,
            None => PairedCalibration {
                file: "polynomials".to_owned(),
                temperature_degc: Some(t1_degc),
                sigma: off_centre.sigma,
                xi_deg: off_centre.xi_deg,
                sigma_std: None,
                xi_std_deg: None,
            },
        },
        notes,
    })
}

/// What the polynomials at the centre hold for: the runs beside it and at it.
fn scope(beside: &OffCentre, pair: &Pair) -> Result<LinearScope, CentreError> {
    let own = [Some(pair.centre), pair.off_centre].into_iter().flatten().filter_map(scope_of);
    LinearScope::common(std::iter::once(&beside.scope).chain(own))
        .map_err(|error| CentreError::Linearised { centre: pair.centre.file.clone(), error })
}

/// A calibration of a run in the Rosetta convention, with its uncertainties.
fn in_rosetta(run: &PairedCalibration, alignment: Alignment) -> Result<PairedCalibration, CentreError> {
    let stated = Alignment { convention: Convention::BepiColombo, sigma: run.sigma, xi_deg: run.xi_deg };
    let (_, [sigma_std, xi_std_deg]) = stated
        .in_convention(Convention::Rosetta, [run.sigma_std, run.xi_std_deg])
        .map_err(|_| CentreError::NoTransfer(run.file.clone()))?;
    let (sigma, xi_deg) = (alignment.sigma, alignment.xi_deg);
    Ok(PairedCalibration { sigma, xi_deg, sigma_std, xi_std_deg, ..run.clone() })
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
    /// Changes of σ and ξ of the runs at and beside the centre by everything that they share with others; none where none are stated.
    common: [Vec<(String, [f64; 6])>; 2],
    t1_degc: f64,
}

/// The transfer, everything in the Rosetta convention.
struct Transferred {
    beside: Through,
    centre: Through,
    transfer: Transfer,
    /// The sensor at T1, at the centre and beside it.
    pair: [Alignment; 2],
}

impl Transferred {
    /// Sensitivities and angles at the centre, angles and sensitivities beside it, `k`, `K⁻¹` row by row.
    fn values(&self) -> Vec<f64> {
        let (centre, beside) = (&self.centre.polynomials, &self.beside.polynomials);
        let polynomials = centre.sigma.iter().chain(&centre.xi_deg).chain(&beside.xi_deg).chain(&beside.sigma).flatten();
        polynomials.chain(&self.transfer.k).chain(self.transfer.k_inverse.transpose().iter()).copied().collect()
    }
}

/// σ and ω at the centre.
struct LinearAtCentre {
    sigma: [TemperaturePolynomial; 3],
    xi_deg: [TemperaturePolynomial; 3],
    beside_sigma: [TemperaturePolynomial; 3],
    beside_xi_deg: [TemperaturePolynomial; 3],
    k_std: Option<[f64; 3]>,
    k_inverse_std: Option<Rows>,
    together: Option<DMatrix<f64>>,
    found: Transferred,
}

impl Members<'_> {
    /// Whether the pair is at one temperature, within those of the polynomials.
    fn notes(&self) -> Vec<Note> {
        let mut notes = Vec::new();
        let t1 = self.t1_degc;
        let [low, high] = self.beside.valid_degc;
        if !(low..=high).contains(&t1) {
            let text =
                format!("T1 = {t1:.2} °C lies outside of the temperatures {low:.1} to {high:.1} °C of the off-centre runs");
            notes.push(Note::new(NoteKind::Temperature, text));
        }
        // Polynomials that stand for the run beside the centre are taken at T1.
        let Some(off) = &self.off_run else { return notes };
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

    /// The polynomials beside the centre, the run at the centre, and the run beside it if there is one, each as its file has it.
    fn known(&self) -> Uncertain {
        let polynomials = self.beside.sigma.iter().chain(&self.beside.xi_deg).fold(Uncertain::new(), Uncertain::polynomial);
        let mut known = std::iter::once(&self.centre).chain(&self.off_run).fold(polynomials, |known, run| {
            let sigma = (0..3).map(|i| (run.sigma[i], run.sigma_std.map(|s| s[i])));
            let xi = (0..3).map(|i| (run.xi_deg[i], run.xi_std_deg.map(|s| s[i])));
            sigma.chain(xi).fold(known, |known, (value, std)| known.value(value, std))
        });
        known.common = self.of_facility(known.x.len());
        known
    }

    /// How the values of [`Members::known`] change by one standard deviation of everything that polynomials and runs share.
    fn of_facility(&self, count: usize) -> Vec<Vec<f64>> {
        let Some(polynomials) = &self.beside.of_facility else { return Vec::new() };
        let coefficients: usize = self.beside.sigma.iter().chain(&self.beside.xi_deg).map(|p| p.coefficients.len()).sum();
        let runs = &self.common[..(count - coefficients) / 6];
        let mut sources: Vec<&String> = Vec::new();
        for source in polynomials.iter().map(|(source, _)| source).chain(runs.iter().flatten().map(|(source, _)| source)) {
            if !sources.contains(&source) {
                sources.push(source);
            }
        }
        let change = |source: &String| {
            let mut change = vec![0.0; count];
            if let Some((_, own)) = polynomials.iter().find(|(s, _)| s == source) {
                change[..coefficients].copy_from_slice(&own.concat());
            }
            for (run, own) in runs.iter().enumerate() {
                if let Some((_, own)) = own.iter().find(|(s, _)| s == source) {
                    change[coefficients + 6 * run..coefficients + 6 * run + 6].copy_from_slice(own);
                }
            }
            change
        };
        sources.into_iter().map(change).collect()
    }

    /// The transfer in the Rosetta convention for the values `x`, in the order of [`Members::known`].
    fn transferred(&self, x: &[f64], nodes_degc: &[f64]) -> Option<Transferred> {
        let mut rest = x;
        let mut take = |n: usize| {
            let (taken, left) = rest.split_at(n);
            rest = left;
            taken.to_vec()
        };
        let sigma = self.beside.sigma.each_ref().map(|p| take(p.coefficients.len()));
        let xi_deg = self.beside.xi_deg.each_ref().map(|p| take(p.coefficients.len()));
        let beside = AlignmentPolynomials { convention: self.beside.convention, sigma, xi_deg };
        let in_rosetta = |stated: Alignment| stated.to_other().ok().map(|c| c.alignment);
        let mut run = || {
            let [sigma, xi_deg] = [take(3), take(3)];
            in_rosetta(Alignment {
                convention: Convention::BepiColombo,
                sigma: std::array::from_fn(|i| sigma[i]),
                xi_deg: std::array::from_fn(|i| xi_deg[i]),
            })
        };
        let centre = run()?;
        let off_centre = if self.off_run.is_some() { run()? } else { in_rosetta(beside.at(self.t1_degc))? };
        let transfer = Transfer::new((off_centre.sigma, off_centre.xi_deg), (centre.sigma, centre.xi_deg)).ok()?;
        let at_beside: Vec<Alignment> = nodes_degc.iter().map(|t| in_rosetta(beside.at(*t))).collect::<Option<_>>()?;
        let at_centre: Vec<Alignment> = at_beside.iter().map(|a| transfer.to_centre(a).ok()).collect::<Option<_>>()?;
        let orders = beside.orders_in_other();
        Some(Transferred {
            beside: AlignmentPolynomials::through(nodes_degc, &at_beside, orders)?,
            centre: AlignmentPolynomials::through(nodes_degc, &at_centre, orders)?,
            transfer,
            pair: [centre, off_centre],
        })
    }

    /// σ and ω at the centre with all uncertainties.
    fn linear(&self) -> Result<LinearAtCentre, CentreError> {
        let impossible = || CentreError::NoTransfer(self.centre.file.clone());
        let nodes = nodes_degc(self.beside.valid_degc);
        let known = self.known();
        let found = self.transferred(&known.x, &nodes).ok_or_else(impossible)?;
        let count = found.values().len();
        let (values, covariance) =
            known.carry(|x| self.transferred(x, &nodes).map_or_else(|| vec![f64::NAN; count], |t| t.values()))?;
        if values.iter().any(|v| !v.is_finite()) {
            return Err(impossible());
        }
        let mut at = 0;
        let mut next = |coefficients: &Vec<f64>| {
            let n = coefficients.len();
            let own = covariance.as_ref().map(|c| c.view((at, at), (n, n)).into_owned());
            at += n;
            self.polynomial(coefficients.clone(), own)
        };
        let sigma = found.centre.polynomials.sigma.each_ref().map(&mut next);
        let xi_deg = found.centre.polynomials.xi_deg.each_ref().map(&mut next);
        let beside_xi_deg = found.beside.polynomials.xi_deg.each_ref().map(&mut next);
        let beside_sigma = found.beside.polynomials.sigma.each_ref().map(&mut next);
        let std = |from: usize| covariance.as_ref().map(|c| std::array::from_fn(|i| std_of(c[(from + i, from + i)])));
        // Sensitivities and angles at the centre, angles beside it, and K⁻¹: what a ground calibration file takes.
        let (beside_sigma_from, k_inverse_from) = (at - 3 * beside_sigma[0].coefficients.len(), at + 3);
        let places: Vec<usize> = (0..beside_sigma_from).chain(k_inverse_from..k_inverse_from + 9).collect();
        let together =
            covariance.as_ref().map(|c| DMatrix::from_fn(places.len(), places.len(), |i, k| c[(places[i], places[k])]));
        let rows = |from: usize| std(from).zip(std(from + 3)).zip(std(from + 6)).map(|((a, b), c)| [a, b, c]);
        Ok(LinearAtCentre {
            k_std: std(at),
            k_inverse_std: rows(k_inverse_from),
            sigma,
            xi_deg,
            beside_sigma,
            beside_xi_deg,
            together,
            found,
        })
    }

    /// Slope of a sensitivity at a temperature over itself, 1/K.
    fn relative_slope(&self, component: usize, degc: f64) -> f64 {
        let about = self.beside.sigma[component].about(degc).coefficients;
        about.get(1).map_or(0.0, |slope| slope / about[0])
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
            // A field of so many nanotesla is B_res sigma(T2) / sigma(T) in readings. The file takes it as constant, as those who use it do.
            let follows = residual.b_res_ent[i] * self.relative_slope(i, t2);
            values.truncate(n);
            let covariance = c.map(|c| {
                let mut own = c.view((0, 0), (n, n)).into_owned();
                let by =
                    DVector::from_fn(n, |k, _| if n > 1 { [-follows * t2, follows].get(k).copied().unwrap_or(0.0) } else { 0.0 });
                own += &by * by.transpose();
                own
            });
            found[i] = self.polynomial(values, covariance);
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
        all[component] = std_of(c[(at, at)]);
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

/// Changes of σ and ξ of a run by everything that it shares with others; none where none are stated.
fn of_facility(point: &CalibratedRun) -> Vec<(String, [f64; 6])> {
    let RunValues::Lin { common: Some(common), .. } = &point.values else { return Vec::new() };
    let known = |value: f64| if value.is_finite() { value } else { 0.0 };
    let six = |change: &CommonChange| std::array::from_fn(|i| known(if i < 3 { change.sigma[i] } else { change.xi_deg[i - 3] }));
    common.iter().map(|change| (change.source.clone(), six(change))).collect()
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
