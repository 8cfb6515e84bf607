//! The scalar calibration of the coil system: settings and moduli to scale factors, offset fields and angles, and to what
//! temperatures do to them (CH-GFZ-TR-2601 section 6; mathematics.md section 5).

use super::{ANGLES, AXES, CoilError};
use crate::data::note::{Note, NoteKind};
use crate::data::result::Covariance;
use crate::data::run::{Run, ScalarRow, interpolate};
use crate::fit::statistics::{extremes, median};
use crate::fit::{FitError, Limits, Model, NonlinearSolution, linear, nonlinear};
use crate::model::campaign::Instructions;
use crate::model::coil::Coil;
use crate::model::facility::FacilityParameters;
use crate::model::facility_calibration::{ScalarCalibration, ScalarFound, ScalarOutlier, ScalarQuality, ScalarValidity};
use nalgebra::{DMatrix, Matrix3, SymmetricEigen, Vector3};
use serde::{Deserialize, Serialize};

/// How a scalar calibration is made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Channel of the rack temperature in place of the campaign's.
    pub rack_channel: Option<String>,
}

/// Largest condition number of the design with columns scaled to one. Directions all over the sphere have less than three.
pub const MOST_CONDITION: f64 = 100.0;
/// Largest condition number where temperature coefficients are fitted, too.
const MOST_THERMAL_CONDITION: f64 = 1e3;
/// A residual of this many robust standard deviations is an outlier.
const OUTLIER: f64 = 6.0;
/// Smaller residuals are no outliers, nT.
const LEAST_OUTLIER_NT: f64 = 1e-3;
/// Rounds of leaving out.
const ROUNDS: usize = 10;
/// A larger share of rows left out asks for a look at the run.
const MANY_OUTLIERS: f64 = 0.05;
/// Least range of the temperatures of several calibrations in which coefficients are looked for, K.
const LEAST_RANGE_K: f64 = 0.2;
/// Calibrations that differ by this many standard deviations do not describe the same facility.
const DISAGREEMENT: f64 = 5.0;
/// Number of parameters at one temperature.
const CONSTANT: usize = 9;

/// One row in the light of the fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RowResidual {
    /// Run id.
    pub run: String,
    /// s since the run's start.
    pub t_s: f64,
    /// Setting, EU.
    pub setting_eu: [f64; 3],
    /// Measured modulus, nT.
    pub modulus_nt: f64,
    /// Measured minus modelled modulus, nT.
    pub residual_nt: f64,
    /// Whether the row was used.
    pub used: bool,
}

/// A scalar calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Scalar {
    /// What was found.
    pub found: ScalarFound,
    /// Residuals of all rows.
    pub rows: Vec<RowResidual>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// A row with its temperatures as differences from the references, K.
struct Observation {
    run: usize,
    row: usize,
    scalar: ScalarRow,
    coil_k: f64,
    rack_k: f64,
}

/// Which temperatures the model follows.
#[derive(Clone, Copy, PartialEq)]
struct Follows {
    coil: bool,
    rack: bool,
}

impl Follows {
    /// None.
    const CONSTANT: Self = Self { coil: false, rack: false };

    fn count(self) -> usize {
        CONSTANT + 6 * (usize::from(self.coil) + usize::from(self.rack))
    }

    /// First index of the rack's coefficients.
    fn rack_at(self) -> usize {
        CONSTANT + 6 * usize::from(self.coil)
    }

    /// Names in a parameter file, names for people, units.
    fn names(self) -> Vec<[String; 3]> {
        let mut list = Vec::new();
        let mut of = |key: &str, text: &str, unit: &str, axes: [&str; 3]| {
            list.extend(axes.map(|a| [format!("{key}_{}", a.to_lowercase()), text.replace('#', a), unit.to_owned()]));
        };
        of("scale", "the scale factor of #", "nT/EU", AXES);
        of("offset", "the offset field of #", "nT", AXES);
        of("angle", "the angle #", "deg", ANGLES);
        if self.coil {
            of("scale_per_k", "the change of the scale factor of # with the coil temperature", "1/K", AXES);
            of("offset_per_k", "the change of the offset field of # with the coil temperature", "nT/K", AXES);
        }
        if self.rack {
            of("rack_scale_per_k", "the change of the scale factor of # with the rack temperature", "1/K", AXES);
            of("rack_offset_per_k", "the change of the offset field of # with the rack temperature", "nT/K", AXES);
        }
        list
    }

    fn part(self, values: &[f64]) -> FacilityParameters {
        let three = |from: usize| -> [f64; 3] { std::array::from_fn(|i| values.get(from + i).copied().unwrap_or(f64::NAN)) };
        let mut part = FacilityParameters::constant(three(0), three(3), three(6));
        if self.coil {
            part.scale_per_k = Some(three(CONSTANT));
            part.offset_nt_per_k = Some(three(CONSTANT + 3));
        }
        if self.rack {
            part.rack_scale_per_k = Some(three(self.rack_at()));
            part.rack_offset_nt_per_k = Some(three(self.rack_at() + 3));
        }
        part
    }

    /// The coil system with these parameters and references of zero.
    fn coil(self, values: &[f64]) -> Coil {
        let part = FacilityParameters { reference_degc: Some(0.0), rack_reference_degc: Some(0.0), ..self.part(values) };
        part.coil()
    }
}

/// The modulus of the field of every row.
struct Modulus<'a> {
    rows: &'a [Observation],
    follows: Follows,
}

impl Model for Modulus<'_> {
    fn names(&self) -> Vec<String> {
        self.follows.names().into_iter().map(|[_, text, _]| text).collect()
    }

    fn values(&self, parameters: &[f64], values: &mut [f64]) {
        let coil = self.follows.coil(parameters);
        let Some(axes) = coil.axes() else { return values.fill(f64::NAN) };
        for (value, row) in values.iter_mut().zip(self.rows) {
            *value = Vector3::from(coil.field(&axes, row.scalar.setting, [row.coil_k; 3], row.rack_k).0).norm();
        }
    }

    fn jacobian(&self, parameters: &[f64], jacobian: &mut DMatrix<f64>) {
        let coil = self.follows.coil(parameters);
        let (Some(axes), Some(by_angle)) = (coil.axes(), coil.axes_per_degree()) else { return jacobian.fill(f64::NAN) };
        for (i, row) in self.rows.iter().enumerate() {
            let unit = Vector3::from(coil.field(&axes, row.scalar.setting, [row.coil_k; 3], row.rack_k).0).normalize();
            let along = axes.transpose() * unit;
            let coil_factor = |k: usize| 1.0 + coil.scale_per_k[k] * row.coil_k;
            let rack_factor = |k: usize| 1.0 + coil.rack_scale_per_k[k] * row.rack_k;
            let driven =
                Vector3::from_fn(|k, _| coil.scale_nt_per_eu[k] * coil_factor(k) * rack_factor(k) * row.scalar.setting[k]);
            for k in 0..3 {
                let setting = along[k] * row.scalar.setting[k];
                jacobian[(i, k)] = setting * coil_factor(k) * rack_factor(k);
                jacobian[(i, 3 + k)] = unit[k];
                jacobian[(i, 6 + k)] = unit.dot(&(by_angle[k] * driven));
                if self.follows.coil {
                    jacobian[(i, CONSTANT + k)] = setting * coil.scale_nt_per_eu[k] * row.coil_k * rack_factor(k);
                    jacobian[(i, CONSTANT + 3 + k)] = unit[k] * row.coil_k;
                }
                if self.follows.rack {
                    let at = self.follows.rack_at();
                    jacobian[(i, at + k)] = setting * coil.scale_nt_per_eu[k] * coil_factor(k) * row.rack_k;
                    jacobian[(i, at + 3 + k)] = unit[k] * row.rack_k;
                }
            }
        }
    }
}

struct Fitted {
    solution: NonlinearSolution,
    used: Vec<bool>,
}

/// Fits rows, leaves out those that stand out, and fits again.
fn fit(rows: &[Observation], follows: Follows, most_condition: f64) -> Result<Fitted, CoilError> {
    let limits = Limits { max_condition: most_condition };
    let explain = |error: FitError| match error {
        FitError::Undetermined { parameters, condition } => {
            CoilError::Undetermined { parameters, condition, most: most_condition }
        }
        other => CoilError::Fit(other),
    };
    if rows.len() <= follows.count() {
        return Err(CoilError::TooFewRows { rows: rows.len() });
    }
    let model = Modulus { rows, follows };
    let moduli: Vec<f64> = rows.iter().map(|r| r.scalar.modulus_nt).collect();
    let settings: f64 = rows.iter().map(|r| Vector3::from(r.scalar.setting).norm_squared()).sum();
    let scale = (moduli.iter().map(|f| f * f).sum::<f64>() / settings).sqrt();
    let mut start = vec![0.0; follows.count()];
    start[..3].fill(if scale.is_finite() { scale } else { 1.0 });
    start[6..9].fill(90.0);
    // The geometry is the same everywhere: what the directions do not determine is seen at the start, before any search.
    let mut jacobian = DMatrix::zeros(rows.len(), start.len());
    model.jacobian(&start, &mut jacobian);
    let design = linear::Design::new(model.names(), jacobian).map_err(explain)?;
    linear::solve(&design, &DMatrix::from_column_slice(rows.len(), 1, &moduli), None, &limits).map_err(explain)?;

    let mut used = vec![true; rows.len()];
    for _ in 0..ROUNDS {
        let weights: Vec<f64> = used.iter().map(|used| f64::from(u8::from(*used))).collect();
        let solution = nonlinear::solve(&model, &moduli, Some(&weights), &start, &limits).map_err(explain)?;
        let mut sizes: Vec<f64> = solution.residuals.iter().map(|r| r.abs()).collect();
        let limit_nt = (OUTLIER * median(&mut sizes) / 0.6745).max(LEAST_OUTLIER_NT);
        let now: Vec<bool> = solution.residuals.iter().map(|r| r.abs() <= limit_nt).collect();
        if now == used || now.iter().filter(|used| **used).count() <= follows.count() {
            return Ok(Fitted { solution, used });
        }
        used = now;
    }
    Err(CoilError::Fit(FitError::NotSettled { what: "the choice of rows", iterations: ROUNDS }))
}

/// Temperatures of the rows of all runs in one channel.
struct RowTemperatures {
    /// Run by run, °C.
    degc: Vec<Vec<f64>>,
    /// Mean over the runs, on the tenth of a kelvin.
    reference_degc: f64,
}

impl RowTemperatures {
    /// `None` if a run has none.
    fn of(runs: &[(&Run, &Instructions)], channel: impl Fn(&Run, &Instructions) -> String) -> Option<Self> {
        let rows = |(run, instructions): &(&Run, &Instructions)| -> Option<Vec<f64>> {
            let series = run.slow_channel(&channel(run, instructions)).filter(|s| !s.is_empty())?;
            Some(run.scalar.iter().map(|row| interpolate(&series, row.t_s)).collect())
        };
        let degc: Vec<Vec<f64>> = runs.iter().map(rows).collect::<Option<_>>()?;
        let means: Vec<f64> = degc.iter().map(|d| mean(d)).collect();
        Some(Self { degc, reference_degc: (10.0 * mean(&means)).round() / 10.0 })
    }

    fn mean_of(&self, run: usize) -> Option<f64> {
        self.degc.get(run).map(|d| mean(d))
    }

    fn difference_k(&self, run: usize, row: usize) -> f64 {
        self.degc[run][row] - self.reference_degc
    }

    /// Smallest and largest, °C.
    fn range_degc(&self) -> [f64; 2] {
        extremes(self.degc.iter().flatten().copied())
    }

    /// Whether there are enough calibrations, at temperatures that differ.
    fn tell_coefficients(&self, least: usize) -> bool {
        let [low, high] = extremes(self.degc.iter().map(|d| mean(d)));
        self.degc.len() >= least && high - low >= LEAST_RANGE_K
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Temperatures of coil system and rack, as far as every run has them.
struct Climate {
    coil: Option<RowTemperatures>,
    rack: Option<RowTemperatures>,
}

impl Climate {
    fn of(runs: &[(&Run, &Instructions)], options: &Options, notes: &mut Vec<Note>) -> Self {
        let coil = RowTemperatures::of(runs, |run, instructions| instructions.channels(&run.header).1);
        let rack = RowTemperatures::of(runs, |_, instructions| {
            options.rack_channel.clone().unwrap_or_else(|| instructions.rack_channel().to_owned())
        });
        if let (None, Some(channel)) = (&rack, &options.rack_channel) {
            let text = format!("not every run has a channel {channel}: the rack temperature was not used");
            notes.push(Note::new(NoteKind::Temperature, text));
        }
        Self { coil, rack }
    }

    /// All rows of all runs.
    fn rows(&self, runs: &[(&Run, &Instructions)]) -> Vec<Observation> {
        let difference_k = |channel: &Option<RowTemperatures>, run: usize, row: usize| {
            channel.as_ref().map_or(0.0, |t| t.difference_k(run, row))
        };
        let all = runs.iter().enumerate();
        all.flat_map(|(run, (data, _))| data.scalar.iter().enumerate().map(move |(row, scalar)| (run, row, *scalar)))
            .map(|(run, row, scalar)| Observation {
                run,
                row,
                scalar,
                coil_k: difference_k(&self.coil, run, row),
                rack_k: difference_k(&self.rack, run, row),
            })
            .collect()
    }

    /// The temperatures whose coefficients the runs may tell.
    fn follows(&self) -> Follows {
        let tells = |channel: &Option<RowTemperatures>, least| channel.as_ref().is_some_and(|t| t.tell_coefficients(least));
        Follows { coil: tells(&self.coil, 3), rack: tells(&self.rack, 4) }
    }

    /// Reference temperatures of coil and rack, °C.
    fn references_degc(&self) -> [Option<f64>; 2] {
        [&self.coil, &self.rack].map(|channel| channel.as_ref().map(|t| t.reference_degc))
    }
}

/// Calibrates the coil system with the `@SCALAR` rows of some runs, which stand in time order.
///
/// # Errors
/// [`CoilError`]: too few rows, or directions that leave a parameter undetermined.
pub fn scalar(runs: &[(&Run, &Instructions)], options: &Options) -> Result<Scalar, CoilError> {
    if runs.iter().all(|(run, _)| run.scalar.is_empty()) {
        return Err(CoilError::NoRows);
    }
    let mut notes = Vec::new();
    let climate = Climate::of(runs, options, &mut notes);
    let rows = climate.rows(runs);
    let (fitted, follows) = fit_what_they_tell(&rows, climate.follows(), &mut notes)?;
    let solution = &fitted.solution;
    let calibration = each(&rows, runs, &fitted.used, &climate);
    let references_degc = climate.references_degc();
    let mut std = solution.std();
    widen(&mut std, &calibration, follows, solution, references_degc, &mut notes);
    let mut facility = follows.part(&solution.parameters);
    facility.reference_degc = references_degc[0].filter(|_| follows.coil);
    facility.rack_reference_degc = references_degc[1].filter(|_| follows.rack);
    if climate.coil.is_none() {
        let text = "not every run has a coil temperature: the parameters hold for that of the calibration";
        notes.push(Note::new(NoteKind::Temperature, text));
    }
    let outlier = outliers(&rows, runs, &fitted);
    warn_of_outliers(&mut notes, &outlier, rows.len());
    let used_rows: Vec<&Observation> = rows.iter().zip(&fitted.used).filter(|(_, used)| **used).map(|(row, _)| row).collect();
    let found = ScalarFound {
        used: runs.iter().map(|(run, _)| run.header.run.clone()).collect(),
        campaign: runs.first().map_or_else(String::new, |(_, instructions)| instructions.description.clone()),
        facility,
        std: follows.part(&std),
        covariance: covariance(solution, follows),
        quality: quality(&used_rows, rows.len(), &fitted),
        calibration,
        outlier,
        valid: ScalarValidity {
            modulus_nt: extremes(used_rows.iter().map(|r| r.scalar.modulus_nt)),
            coil_degc: climate.coil.as_ref().map(RowTemperatures::range_degc),
            rack_degc: climate.rack.as_ref().map(RowTemperatures::range_degc),
        },
    };
    Ok(Scalar { found, rows: residuals(&rows, runs, &fitted), notes })
}

/// Fits with the coefficients of all temperatures that may be told, and with fewer where they cannot.
fn fit_what_they_tell(rows: &[Observation], mut follows: Follows, notes: &mut Vec<Note>) -> Result<(Fitted, Follows), CoilError> {
    let constant = Follows::CONSTANT;
    loop {
        let most = if follows == constant { MOST_CONDITION } else { MOST_THERMAL_CONDITION };
        match fit(rows, follows, most) {
            Err(CoilError::Undetermined { condition, .. }) if follows.rack => {
                let text = format!(
                    "rack and coil temperatures of the calibrations do not tell their coefficients apart (condition {condition:.0e}): \
                     the rack temperature was not used"
                );
                notes.push(Note::new(NoteKind::Temperature, text));
                follows.rack = false;
            }
            Err(CoilError::Undetermined { .. } | CoilError::TooFewRows { .. }) if follows != constant => follows = constant,
            other => return Ok((other?, follows)),
        }
    }
}

/// The rows that were left out.
fn outliers(rows: &[Observation], runs: &[(&Run, &Instructions)], fitted: &Fitted) -> Vec<ScalarOutlier> {
    rows.iter()
        .zip(&fitted.used)
        .zip(&fitted.solution.residuals)
        .filter(|((_, used), _)| !**used)
        .map(|((row, _), residual_nt)| ScalarOutlier {
            run: runs[row.run].0.header.run.clone(),
            row: row.row + 1,
            t_s: row.scalar.t_s,
            setting_eu: row.scalar.setting,
            modulus_nt: row.scalar.modulus_nt,
            residual_nt: *residual_nt,
        })
        .collect()
}

fn covariance(solution: &NonlinearSolution, follows: Follows) -> Covariance {
    let names = follows.names();
    let matrix = solution.covariance();
    Covariance {
        parameters: names.iter().map(|[key, _, _]| key.clone()).collect(),
        units: names.iter().map(|[_, _, unit]| unit.clone()).collect(),
        matrix: (0..names.len()).map(|r| (0..names.len()).map(|c| matrix[(r, c)]).collect()).collect(),
    }
}

fn quality(used: &[&Observation], total: usize, fitted: &Fitted) -> ScalarQuality {
    let solution = &fitted.solution;
    let kept = solution.residuals.iter().zip(&fitted.used).filter(|(_, used)| **used);
    ScalarQuality {
        rows_used: used.len(),
        rows_total: total,
        degrees_of_freedom: solution.dof,
        condition: solution.condition,
        direction_share: direction_share(used),
        residual_std_nt: solution.residual_std,
        residual_max_nt: kept.fold(0.0, |most: f64, (r, _)| most.max(r.abs())),
    }
}

/// Every row with what the calibration leaves of its modulus.
fn residuals(rows: &[Observation], runs: &[(&Run, &Instructions)], fitted: &Fitted) -> Vec<RowResidual> {
    rows.iter()
        .zip(&fitted.solution.residuals)
        .zip(&fitted.used)
        .map(|((row, residual_nt), used)| RowResidual {
            run: runs[row.run].0.header.run.clone(),
            t_s: row.scalar.t_s,
            setting_eu: row.scalar.setting,
            modulus_nt: row.scalar.modulus_nt,
            residual_nt: *residual_nt,
            used: *used,
        })
        .collect()
}

/// Every calibration on its own, if it can stand alone.
fn each(rows: &[Observation], runs: &[(&Run, &Instructions)], used: &[bool], climate: &Climate) -> Vec<ScalarCalibration> {
    let one = |(index, (run, _)): (usize, &(&Run, &Instructions))| {
        let own: Vec<Observation> = rows
            .iter()
            .zip(used)
            .filter(|(row, used)| row.run == index && **used)
            .map(|(row, _)| Observation { coil_k: 0.0, rack_k: 0.0, ..*row })
            .collect();
        let fitted = fit(&own, Follows::CONSTANT, MOST_CONDITION).ok()?;
        Some(ScalarCalibration {
            run: run.header.run.clone(),
            start: run.header.start.clone(),
            rows: fitted.used.iter().filter(|used| **used).count(),
            coil_degc: climate.coil.as_ref().and_then(|t| t.mean_of(index)),
            rack_degc: climate.rack.as_ref().and_then(|t| t.mean_of(index)),
            residual_std_nt: fitted.solution.residual_std,
            condition: fitted.solution.condition,
            facility: Follows::CONSTANT.part(&fitted.solution.parameters),
            std: Follows::CONSTANT.part(&fitted.solution.std()),
        })
    };
    runs.iter().enumerate().filter_map(one).collect()
}

/// The nine values of one temperature.
fn nine(part: &FacilityParameters) -> [f64; CONSTANT] {
    std::array::from_fn(|i| [part.scale_nt_per_eu, part.offset_nt, part.angles_deg][i / 3][i % 3])
}

/// Where several calibrations differ by more than their noise, their spread is the uncertainty, and a warning says so.
fn widen(
    std: &mut [f64],
    calibration: &[ScalarCalibration],
    follows: Follows,
    solution: &NonlinearSolution,
    references: [Option<f64>; 2],
    notes: &mut Vec<Note>,
) {
    let count = calibration.len();
    if count < 2 {
        return;
    }
    let coil = follows.coil(&solution.parameters);
    let names = follows.names();
    for j in 0..CONSTANT {
        let mut squares = 0.0;
        let mut worst: f64 = 0.0;
        for one in calibration {
            let k = |degc: Option<f64>, reference: Option<f64>| degc.zip(reference).map_or(0.0, |(t, r)| t - r);
            let (coil_k, rack_k) = (k(one.coil_degc, references[0]), k(one.rack_degc, references[1]));
            let expected = match j {
                0..3 => {
                    coil.scale_nt_per_eu[j] * (1.0 + coil.scale_per_k[j] * coil_k) * (1.0 + coil.rack_scale_per_k[j] * rack_k)
                }
                3..6 => coil.offset_nt[j - 3] + coil.offset_nt_per_k[j - 3] * coil_k + coil.rack_offset_nt_per_k[j - 3] * rack_k,
                _ => coil.angles_deg[j - 6],
            };
            let difference = nine(&one.facility)[j] - expected;
            squares += difference * difference;
            worst = worst.max(difference.abs() / nine(&one.std)[j]);
        }
        let spread = (squares / ((count - 1) * count) as f64).sqrt();
        std[j] = std[j].max(spread);
        if worst > DISAGREEMENT {
            notes.push(Note::new(NoteKind::Fit, format!(
                "{} differs between the calibrations by up to {worst:.0} standard deviations; the facility changed, or follows a \
                 temperature that was not used",
                names[j][1]
            )));
        }
    }
}

fn warn_of_outliers(notes: &mut Vec<Note>, outliers: &[ScalarOutlier], total: usize) {
    for o in outliers {
        notes.push(Note::new(
            NoteKind::Data,
            format!("row {} of run {} ({:.0} s) stands out by {:+.2} nT and was left out", o.row, o.run, o.t_s, o.residual_nt),
        ));
    }
    if outliers.len() as f64 > MANY_OUTLIERS * total as f64 {
        notes.push(Note::new(
            NoteKind::Fit,
            format!("{} of {total} rows stand out; check the scalar magnetometer", outliers.len()),
        ));
    }
}

/// Shares of the squared settings along their principal directions, the largest first.
fn direction_share(rows: &[&Observation]) -> [f64; 3] {
    let sum = rows.iter().fold(Matrix3::zeros(), |sum, row| {
        let u = Vector3::from(row.scalar.setting);
        sum + u * u.transpose()
    });
    let mut shares: Vec<f64> = (SymmetricEigen::new(sum).eigenvalues / sum.trace()).iter().copied().collect();
    shares.sort_by(|a, b| b.total_cmp(a));
    std::array::from_fn(|i| shares.get(i).copied().unwrap_or(f64::NAN).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_jacobian_is_that_of_differences() {
        let row = |setting: [f64; 3], coil_k: f64, rack_k: f64| Observation {
            run: 0,
            row: 0,
            scalar: ScalarRow { t_s: 0.0, setting, modulus_nt: 0.0 },
            coil_k,
            rack_k,
        };
        let rows = [row([3e4, -2e4, 1e4], 0.7, -1.1), row([-1e4, 4e4, 2e4], -0.4, 0.3), row([0.0, 0.0, -5e4], 1.0, 1.0)];
        let model = Modulus { rows: &rows, follows: Follows { coil: true, rack: true } };
        let mut parameters = vec![0.99, 1.01, 1.002, 20.0, -30.0, 5.0, 89.7, 90.4, 90.2];
        parameters.extend([1.9e-3, -1.6e-3, 1.7e-3, 0.3, -0.2, 0.8, -8e-4, 5e-4, 2e-4, 0.1, 0.2, -0.3]);
        let (mut own, mut differences) = (DMatrix::zeros(3, 21), DMatrix::zeros(3, 21));
        model.jacobian(&parameters, &mut own);
        nonlinear::differentiate(&model, &parameters, &mut differences);
        for i in 0..3 {
            for j in 0..21 {
                let size = own.column(j).amax();
                assert!(
                    (own[(i, j)] - differences[(i, j)]).abs() <= 1e-7 * size,
                    "{i} {j}: {} {}",
                    own[(i, j)],
                    differences[(i, j)]
                );
            }
        }
    }
}
