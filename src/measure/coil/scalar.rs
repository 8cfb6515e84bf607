//! The scalar calibration of the coil system: settings and moduli to scale factors, offset fields and angles, and to what
//! temperatures do to them (CH-GFZ-TR-2601 section 6; docs/mathematics.md, "The coil system"). A facility that stepped between two
//! calibrations has periods.

mod scatter;
mod steps;
mod terms;
mod unknown;

use super::CoilError;
use crate::data::note::{Note, NoteKind};
use crate::data::run::{Run, interpolate};
use crate::data::start::Start;
use crate::fit::statistics::{extremes, median};
use crate::fit::{FitError, Limits, Model, NonlinearSolution, linear, nonlinear};
use crate::model::campaign::Instructions;
use crate::model::facility::{FacilityParameters, PeriodSpan};
use crate::model::facility_calibration::{
    ScalarCalibration, ScalarFound, ScalarOutlier, ScalarPeriod, ScalarQuality, ScalarStep, ScalarValidity,
};
use crate::record::screens::{self, inside};
use crate::record::temperature_faults;
use nalgebra::{DMatrix, Matrix3, SymmetricEigen, Vector3};
use scatter::Scatter;
use serde::{Deserialize, Serialize};
use steps::{Explained, agreeing_with_their_own, explain};
use terms::{CONSTANT, Modulus, Observation, Terms};

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
/// Residuals of this part of the moduli are not those of any coil system.
const UNRELATED: f64 = 0.01;
/// A coil system in order and a scalar magnetometer agree to some tenths of a nanotesla in 50 000 nT: residuals of this part of the moduli are told.
const ROUGH: f64 = 2e-5;
/// Rounds of leaving out.
const ROUNDS: usize = 10;
/// A larger share of rows left out asks for a look at the run.
const MANY_OUTLIERS: f64 = 0.05;
/// Least range of the temperatures of several calibrations in which coefficients are looked for, K.
const LEAST_RANGE_K: f64 = 0.2;
/// Calibrations that differ by this many standard deviations do not describe the same facility.
const DISAGREEMENT: f64 = 5.0;

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

struct Fitted {
    solution: NonlinearSolution,
    used: Vec<bool>,
    /// Rows that stand out and stay, since as many as there are parameters would be left without them.
    stand_out: usize,
}

/// Fits rows, leaves out those that stand out, and fits again.
fn fit(rows: &[Observation], terms: &Terms, most_condition: f64) -> Result<Fitted, CoilError> {
    let limits = Limits { max_condition: most_condition };
    let explain = |error: FitError| match error {
        FitError::Undetermined { parameters, condition } => {
            CoilError::Undetermined { parameters, condition, most: most_condition }
        }
        other => CoilError::Fit(other),
    };
    if rows.len() <= terms.count() {
        return Err(CoilError::TooFewRows { rows: rows.len() });
    }
    let model = Modulus { rows, terms };
    let moduli: Vec<f64> = rows.iter().map(|r| r.scalar.modulus_nt).collect();
    let start = start(rows, terms);
    // The geometry is the same everywhere: what the directions do not determine is seen at the start, before any search.
    let mut jacobian = DMatrix::zeros(rows.len(), start.len());
    model.jacobian(&start, &mut jacobian);
    let design = linear::Design::new(model.names(), jacobian).map_err(explain)?;
    linear::solve(&design, &DMatrix::from_column_slice(rows.len(), 1, &moduli), None, &limits).map_err(explain)?;

    let mut used = vec![true; rows.len()];
    for round in 0..ROUNDS {
        let weights: Vec<f64> = used.iter().map(|used| f64::from(u8::from(*used))).collect();
        let solution = nonlinear::solve(&model, &moduli, Some(&weights), &start, &limits).map_err(explain)?;
        let mut sizes: Vec<f64> = solution.residuals.iter().map(|r| r.abs()).collect();
        let limit_nt = (OUTLIER * median(&mut sizes) / 0.6745).max(LEAST_OUTLIER_NT);
        // A row that comes and goes is left out for good in the end.
        let may_return = |row: usize| used[row] || round < ROUNDS / 2;
        let now: Vec<bool> = solution.residuals.iter().enumerate().map(|(i, r)| r.abs() <= limit_nt && may_return(i)).collect();
        let left = now.iter().filter(|used| **used).count();
        if now == used || left <= terms.count() {
            let stand_out = if now == used { 0 } else { rows.len() - left };
            return Ok(Fitted { solution, used, stand_out });
        }
        used = now;
    }
    Err(CoilError::Fit(FitError::NotSettled { what: "the choice of rows", iterations: ROUNDS }))
}

/// Where the search for the parameters begins: ideal coils with one scale factor.
fn start(rows: &[Observation], terms: &Terms) -> Vec<f64> {
    let moduli: f64 = rows.iter().map(|r| r.scalar.modulus_nt.powi(2)).sum();
    let settings: f64 = rows.iter().map(|r| Vector3::from(r.scalar.setting).norm_squared()).sum();
    let scale = (moduli / settings).sqrt();
    let mut start = vec![0.0; terms.count()];
    start[..3].fill(if scale.is_finite() { scale } else { 1.0 });
    start[6..9].fill(90.0);
    start
}

/// Temperatures of the rows of all runs, of one body or of one for each coil axis.
struct RowTemperatures<const N: usize> {
    /// Run by run, °C.
    degc: Vec<Vec<[f64; N]>>,
    /// Mean over the runs, on the tenth of a kelvin.
    reference_degc: f64,
}

impl<const N: usize> RowTemperatures<N> {
    /// `None` if a run has none.
    fn of(runs: &[(&Run, &Instructions)], channels: impl Fn(&Run, &Instructions) -> [String; N]) -> Option<Self> {
        let rows = |(run, instructions): &(&Run, &Instructions)| -> Option<Vec<[f64; N]>> {
            let mut series = Vec::with_capacity(N);
            let span_s = extremes(run.scalar.iter().map(|row| row.t_s));
            for channel in channels(run, instructions) {
                series.push(temperature_faults::readings(run, &channel, span_s).filter(|s| !s.is_empty())?);
            }
            Some(run.scalar.iter().map(|row| std::array::from_fn(|k| interpolate(&series[k], row.t_s))).collect())
        };
        let degc: Vec<Vec<[f64; N]>> = runs.iter().map(rows).collect::<Option<_>>()?;
        let means: Vec<f64> = degc.iter().map(|d| mean(d.iter().flatten())).collect();
        Some(Self { degc, reference_degc: (10.0 * mean(&means)).round() / 10.0 })
    }

    fn mean_of(&self, run: usize) -> Option<f64> {
        self.degc.get(run).map(|d| mean(d.iter().flatten()))
    }

    fn difference_k(&self, run: usize, row: usize) -> [f64; N] {
        self.degc[run][row].map(|degc| degc - self.reference_degc)
    }

    /// Mean differences from the reference in a run, K.
    fn mean_difference_k(&self, run: usize) -> [f64; N] {
        std::array::from_fn(|k| mean(self.degc[run].iter().map(|degc| &degc[k])) - self.reference_degc)
    }

    /// Smallest and largest, °C.
    fn range_degc(&self) -> [f64; 2] {
        extremes(self.degc.iter().flatten().flatten().copied())
    }

    /// Whether there are enough calibrations, at temperatures that differ.
    fn tell_coefficients(&self, least: usize) -> bool {
        let differ = |k: usize| {
            let [low, high] = extremes((0..self.degc.len()).map(|run| self.mean_difference_k(run)[k]));
            high - low >= LEAST_RANGE_K
        };
        self.degc.len() >= least && (0..N).all(differ)
    }
}

fn mean<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    sum / count
}

/// Temperatures of coil system and rack, as far as every run has them.
struct Climate {
    coil: Option<RowTemperatures<3>>,
    rack: Option<RowTemperatures<1>>,
}

impl Climate {
    fn of(runs: &[(&Run, &Instructions)], options: &Options, notes: &mut Vec<Note>) -> Self {
        let coil = RowTemperatures::of(runs, |run, instructions| instructions.coil_channels(&run.header));
        let rack = RowTemperatures::of(runs, |_, instructions| {
            [options.rack_channel.clone().unwrap_or_else(|| instructions.rack_channel().to_owned())]
        });
        if let (None, Some(channel)) = (&rack, &options.rack_channel) {
            let text = format!("not every run has a channel {channel}: the rack temperature was not used");
            notes.push(Note::new(NoteKind::Temperature, text));
        }
        Self { coil, rack }
    }

    /// All rows of all runs.
    fn rows(&self, runs: &[(&Run, &Instructions)]) -> Vec<Observation> {
        let all = runs.iter().enumerate();
        all.flat_map(|(run, (data, _))| data.scalar.iter().enumerate().map(move |(row, scalar)| (run, row, *scalar)))
            .map(|(run, row, scalar)| Observation {
                run,
                row,
                scalar,
                coil_k: self.coil.as_ref().map_or([0.0; 3], |t| t.difference_k(run, row)),
                rack_k: self.rack.as_ref().map_or(0.0, |t| t.difference_k(run, row)[0]),
            })
            .collect()
    }

    /// The temperatures whose coefficients the runs may tell.
    fn terms(&self) -> Terms {
        Terms {
            coil: self.coil.as_ref().is_some_and(|t| t.tell_coefficients(3)),
            rack: self.rack.as_ref().is_some_and(|t| t.tell_coefficients(4)),
            ..Terms::constant()
        }
    }

    /// Reference temperatures of coil and rack, °C.
    fn references_degc(&self) -> [Option<f64>; 2] {
        [self.coil.as_ref().map(|t| t.reference_degc), self.rack.as_ref().map(|t| t.reference_degc)]
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
    for (run, instructions) in runs {
        let of_run = |note: Note| Note { text: format!("run {}: {}", run.header.run, note.text), ..note };
        notes.extend(temperature_faults::notes(run, instructions).into_iter().map(of_run));
    }
    let climate = Climate::of(runs, options, &mut notes);
    let rows = climate.rows(runs);
    let (first, thermal) = fit_what_they_tell(&rows, climate.terms(), &mut notes)?;
    let explained = if runs.len() > 1 {
        let level = unknown::at_their_means(&rows, &thermal, &first.solution.parameters);
        let counts = agreeing_with_their_own(&level, runs.len());
        let calibration = each(&level, runs, &counts, &climate);
        let beside = beside_the_fit(&calibration, &thermal, &first.solution, runs, &climate);
        explain(&rows, &counts, &thermal, |step, taken| scatter::is_beyond(step, taken, &beside, thermal.count()))
    } else {
        Explained::by(thermal)
    };
    notes.extend(explained.note());
    notes.extend(scatter::instead_of_steps(explained.scatters));
    let terms = &explained.terms;
    let fitted = fit(&rows, terms, if *terms == Terms::constant() { MOST_CONDITION } else { MOST_THERMAL_CONDITION })?;
    let solution = &fitted.solution;
    let level = unknown::at_their_means(&rows, terms, &solution.parameters);
    let calibration = each(&level, runs, &fitted.used, &climate);
    let found = beside_the_fit(&calibration, terms, solution, runs, &climate);
    notes.extend(disagreements(&found));
    let scatter = Scatter::of(&found, terms.count());
    notes.extend(scatter.notes());
    let mut covariance = scatter.widened(&solution.unscaled_covariance * noise_variance(&calibration, solution));
    if let Some(moved) = unknown::moved(&rows, terms, &fitted) {
        notes.extend(unknown::note(&rows, &covariance, &moved));
        covariance += &moved * moved.transpose();
    }
    let period = periods(runs, terms, solution, &climate, &covariance);
    let step = stepped(runs, terms, &period, &mut notes);
    if let Some(step) = explained.undecided {
        notes.push(Note::new(NoteKind::Fit, format!(
            "a step of {} between the calibrations {} and {} explains the rows a little better than the temperatures do, by less than what \
             decides; the temperatures were taken",
            Terms::name(step.parameter), runs[step.from_run - 1].0.header.run, runs[step.from_run].0.header.run,
        )).with_remedy("calibrate at other temperatures"));
    }
    if climate.coil.is_none() {
        let text = "not every run has a coil temperature: the parameters hold for that of the calibration";
        notes.push(Note::new(NoteKind::Temperature, text));
    }
    // The last state of the facility is that of now.
    let Some(last) = period.last().cloned() else { return Err(CoilError::NoRows) };
    let outlier = outliers(&rows, runs, &fitted);
    notes.extend(rough(&rows, &fitted)?);
    warn_of_outliers(&mut notes, &outlier, rows.len());
    if fitted.stand_out > 0 {
        let text = format!(
            "{} of {} rows stand out, and no more would be left without them than there are parameters: they were used, and the parameters are not \
             to be trusted",
            fitted.stand_out,
            rows.len()
        );
        notes.push(Note::new(NoteKind::Fit, text).with_remedy("check the rows, or use a longer programme"));
    }
    notes.extend(jumps(&rows, runs, terms, &fitted));
    notes.extend(far_from_nominal(&last.facility));
    let used_rows: Vec<&Observation> = rows.iter().zip(&fitted.used).filter(|(_, used)| **used).map(|(row, _)| row).collect();
    let found = ScalarFound {
        used: runs.iter().map(|(run, _)| run.header.run.clone()).collect(),
        campaign: runs.first().map_or_else(String::new, |(_, instructions)| instructions.description.clone()),
        facility: last.facility,
        std: last.std,
        covariance: last.covariance,
        hypothesis: explained.hypotheses,
        step,
        period: if period.len() > 1 { period } else { Vec::new() },
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
fn fit_what_they_tell(rows: &[Observation], mut terms: Terms, notes: &mut Vec<Note>) -> Result<(Fitted, Terms), CoilError> {
    let constant = Terms::constant();
    loop {
        let most = if terms == constant { MOST_CONDITION } else { MOST_THERMAL_CONDITION };
        match fit(rows, &terms, most) {
            Err(CoilError::Undetermined { condition, .. }) if terms.rack => {
                let text = format!(
                    "rack and coil temperatures of the calibrations do not tell their coefficients apart (condition {condition:.0e}): \
                     the rack temperature was not used"
                );
                notes.push(Note::new(NoteKind::Temperature, text));
                terms.rack = false;
            }
            Err(CoilError::Undetermined { .. } | CoilError::TooFewRows { .. }) if terms != constant => terms = constant.clone(),
            other => return Ok((other?, terms)),
        }
    }
}

/// The states of the facility with the times in which they hold. Where the step lies between two calibrations is not known: the boundary is
/// the middle of the time between them.
fn periods(
    runs: &[(&Run, &Instructions)],
    terms: &Terms,
    solution: &NonlinearSolution,
    climate: &Climate,
    fitted: &DMatrix<f64>,
) -> Vec<ScalarPeriod> {
    let begins = terms.begins();
    let boundary = |from_run: usize| -> Start {
        let (before, after) = (runs[from_run - 1].0, runs[from_run].0);
        let end_s = before.scalar.iter().map(|row| row.t_s).fold(0.0, f64::max);
        let apart_s = after.header.start.seconds() - before.header.start.seconds();
        before.header.start.after(0.5 * (end_s + apart_s))
    };
    let references_degc = climate.references_degc();
    let one = |(i, run): (usize, &usize)| {
        let span = PeriodSpan { from: (i > 0).then(|| boundary(*run)), to: begins.get(i + 1).map(|next| boundary(*next)) };
        let covariance = terms.covariance(fitted, *run);
        let mut facility = terms.part(&solution.parameters, *run);
        let mut std = FacilityParameters::constant([f64::NAN; 3], [f64::NAN; 3], [f64::NAN; 3]);
        if terms.coil {
            (std.scale_per_k, std.offset_nt_per_k) = (Some([f64::NAN; 3]), Some([f64::NAN; 3]));
            facility.reference_degc = references_degc[0];
        }
        if terms.rack {
            (std.rack_scale_per_k, std.rack_offset_nt_per_k) = (Some([f64::NAN; 3]), Some([f64::NAN; 3]));
            facility.rack_reference_degc = references_degc[1];
        }
        for (k, name) in covariance.parameters.iter().enumerate() {
            if let Some(value) = std.value_mut(name) {
                *value = covariance.matrix[k][k].sqrt();
            }
        }
        ScalarPeriod { span, facility, std, covariance }
    };
    begins.iter().enumerate().map(one).collect()
}

/// The steps that were found, with a note on each.
fn stepped(runs: &[(&Run, &Instructions)], terms: &Terms, periods: &[ScalarPeriod], notes: &mut Vec<Note>) -> Vec<ScalarStep> {
    let begins = terms.begins();
    let mut list = Vec::new();
    for step in &terms.steps {
        let Some(place) = begins.iter().position(|run| *run == step.from_run) else { continue };
        let (before, after) = (&periods[place - 1], &periods[place]);
        let found = ScalarStep {
            parameter: Terms::name(step.parameter).trim_start_matches("the ").to_owned(),
            before: nine(&before.facility)[step.parameter],
            after: nine(&after.facility)[step.parameter],
            last_run_before: runs[step.from_run - 1].0.header.run.clone(),
            first_run_after: runs[step.from_run].0.header.run.clone(),
        };
        let (digits, unit) = match step.parameter {
            0..3 => (6, "nT/EU"),
            3..6 => (2, "nT"),
            _ => (4, "degrees"),
        };
        notes.push(Note::new(NoteKind::Facility, format!(
            "the {} stepped between the calibrations {} and {}, from {:.digits$} to {:.digits$} {unit}: the file has periods, and where the step lies \
             between the two is not known; the middle of the time between them was taken, {}",
            found.parameter,
            found.last_run_before,
            found.first_run_after,
            found.before,
            found.after,
            after.span.from.as_ref().map_or("?", Start::as_str),
        )));
        list.push(found);
    }
    if !list.is_empty() && runs.len() == 2 {
        let text = "two calibrations differ, and nothing tells whether the facility stepped between them, differs from one day to the next, or follows \
                    its temperature: the values of each hold for its own time and temperature";
        notes.push(Note::new(NoteKind::Facility, text).with_remedy("calibrate once more"));
    }
    list
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

/// Every calibration on its own, its rows at one temperature, if it can stand alone.
fn each(rows: &[Observation], runs: &[(&Run, &Instructions)], used: &[bool], climate: &Climate) -> Vec<ScalarCalibration> {
    let one = |(index, (run, _)): (usize, &(&Run, &Instructions))| {
        let own: Vec<Observation> = rows
            .iter()
            .zip(used)
            .filter(|(row, used)| row.run == index && **used)
            .map(|(row, _)| Observation { run: 0, ..row.clone() })
            .collect();
        let constant = Terms::constant();
        let fitted = fit(&own, &constant, MOST_CONDITION).ok()?;
        Some(ScalarCalibration {
            run: run.header.run.clone(),
            start: run.header.start.clone(),
            rows: fitted.used.iter().filter(|used| **used).count(),
            coil_degc: climate.coil.as_ref().and_then(|t| t.mean_of(index)),
            rack_degc: climate.rack.as_ref().and_then(|t| t.mean_of(index)),
            residual_std_nt: fitted.solution.residual_std,
            condition: fitted.solution.condition,
            facility: constant.part(&fitted.solution.parameters, 0),
            std: constant.part(&fitted.solution.std(), 0),
        })
    };
    runs.iter().enumerate().filter_map(one).collect()
}

/// Variance of a row, nT²: that about the calibrations alone, since that about the fit to all of them has their scatter in it as well.
fn noise_variance(calibration: &[ScalarCalibration], solution: &NonlinearSolution) -> f64 {
    let dof = |own: &ScalarCalibration| own.rows.saturating_sub(CONSTANT) as f64;
    let total: f64 = calibration.iter().map(dof).sum();
    let squares: f64 = calibration.iter().map(|own| dof(own) * own.residual_std_nt.powi(2)).sum();
    if total > 0.0 { squares / total } else { solution.residual_std.powi(2) }
}

/// The nine values of one temperature.
fn nine(part: &FacilityParameters) -> [f64; CONSTANT] {
    std::array::from_fn(|i| [part.scale_nt_per_eu, part.offset_nt, part.angles_deg][i / 3][i % 3])
}

/// Says of parameters that differ between calibrations by far more than their noise.
fn disagreements(found: &[scatter::Found]) -> Vec<Note> {
    let far = |j: &usize| found.iter().map(|one| (one.difference[*j] / one.std[*j]).abs()).fold(0.0, f64::max);
    (0..CONSTANT)
        .filter(|j| far(j) > DISAGREEMENT)
        .map(|j| {
            Note::new(NoteKind::Fit, format!(
                "{} differs between the calibrations by up to {:.0} standard deviations; the facility changed, or follows a temperature that \
                 was not used",
                Terms::name(j), far(&j)
            ))
        })
        .collect()
}

/// Every calibration on its own beside the fit to all of them.
fn beside_the_fit(
    calibration: &[ScalarCalibration],
    terms: &Terms,
    solution: &NonlinearSolution,
    runs: &[(&Run, &Instructions)],
    climate: &Climate,
) -> Vec<scatter::Found> {
    let one = |own: &ScalarCalibration| {
        let run = runs.iter().position(|(run, _)| run.header.run == own.run).unwrap_or_default();
        let coil = terms.coil(&solution.parameters, run);
        let coil_k = climate.coil.as_ref().map_or([0.0; 3], |t| t.mean_difference_k(run));
        let rack_k = climate.rack.as_ref().map_or(0.0, |t| t.mean_difference_k(run)[0]);
        let expected = |j: usize| {
            let k = j % 3;
            match j {
                0..3 => {
                    coil.scale_nt_per_eu[k] * (1.0 + coil.scale_per_k[k] * coil_k[k]) * (1.0 + coil.rack_scale_per_k[k] * rack_k)
                }
                3..6 => coil.offset_nt[k] + coil.offset_nt_per_k[k] * coil_k[k] + coil.rack_offset_nt_per_k[k] * rack_k,
                _ => coil.angles_deg[k],
            }
        };
        let (value, std) = (nine(&own.facility), nine(&own.std));
        scatter::Found {
            run,
            difference: std::array::from_fn(|j| value[j] - expected(j)),
            std,
            derivatives: std::array::from_fn(|j| terms.derivatives(j, run, &coil, coil_k, rack_k)),
        }
    };
    calibration.iter().map(one).collect()
}

/// Jumps of all moduli inside a calibration.
fn jumps(rows: &[Observation], runs: &[(&Run, &Instructions)], terms: &Terms, fitted: &Fitted) -> Vec<Note> {
    let model = Modulus { rows, terms };
    let mut jacobian = DMatrix::zeros(rows.len(), terms.count());
    model.jacobian(&fitted.solution.parameters, &mut jacobian);
    let of = |(index, (run, _)): (usize, &(&Run, &Instructions))| {
        let own: Vec<usize> = (0..rows.len()).filter(|i| rows[*i].run == index && fitted.used[*i]).collect();
        let column = |value: &dyn Fn(usize) -> f64| own.iter().map(|i| value(*i)).collect::<Vec<f64>>();
        let columns = jacobian.select_rows(&own);
        let jump = inside::gain_jump(&inside::Rows {
            columns: &columns,
            residuals: &column(&|i| fitted.solution.residuals[i]),
            course: &column(&|i| rows[i].scalar.modulus_nt),
            t_s: &column(&|i| rows[i].scalar.t_s),
            excess: 1.0,
            has_signs: false,
        })?;
        Some(jump.note(&format!("the modulus in run {}", run.header.run), rows[own[jump.row]].scalar.t_s))
    };
    runs.iter().enumerate().filter_map(of).collect()
}

/// Says of scale factors that settings or moduli may be in another unit than nT.
fn far_from_nominal(facility: &FacilityParameters) -> Option<Note> {
    let scale = facility.scale_nt_per_eu;
    (!scale.iter().all(|s| screens::is_plausible(*s))).then(|| {
        let text = format!(
            "the scale factors are {:.4e}, {:.4e}, {:.4e} nT per unit of the settings, far from 1",
            scale[0], scale[1], scale[2]
        );
        Note::new(NoteKind::Gain, text).with_remedy("correct the unit if settings and moduli are meant to be in nT")
    })
}

/// Says of residuals that are far larger than those of a coil system in order.
///
/// # Errors
/// Moduli that are not those of the settings.
fn rough(rows: &[Observation], fitted: &Fitted) -> Result<Option<Note>, CoilError> {
    let residual_nt = fitted.solution.residual_std;
    let modulus_nt = median(&mut rows.iter().map(|row| row.scalar.modulus_nt).collect::<Vec<f64>>());
    if residual_nt > UNRELATED * modulus_nt {
        return Err(CoilError::Unrelated { residual_nt, modulus_nt });
    }
    Ok((residual_nt > ROUGH * modulus_nt).then(|| {
        let text = format!(
            "the residuals are {residual_nt:.2} nT beside moduli of {modulus_nt:.0} nT, far more than a coil system in order and a scalar magnetometer \
             leave: the parameters are not to be trusted"
        );
        Note::new(NoteKind::Fit, text).with_remedy("check signs, order and unit of settings and moduli in the table of residuals")
    }))
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
