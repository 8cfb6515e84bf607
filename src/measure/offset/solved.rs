//! Offset and residual field from the zero levels of the visits.

use super::levels::{Levels, NOMINAL_GAIN, NOMINAL_TILT};
use super::refusal::OffsetError;
use super::sight::Sight;
use super::stay::{Stay, ids};
use crate::data::note::{Note, NoteKind};
use crate::data::offset::{OffsetDrift, OffsetMethod, OffsetValues, RefusedComponent};
use crate::data::result::Covariance;
use crate::data::units::COMPONENTS;
use crate::fit::statistics::{extremes, std_of};
use crate::fit::{FitError, Limits, Solution, linear, order};
use crate::record::conditions;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// A component of a null vector that is larger couples its parameter to the others.
const COUPLED: f64 = 1e-6;
/// Standard deviation of the slope of an offset with the sensor temperature that is allowed for, enT/K: some times the largest of the sensors of 2013
/// (0.02 enT/K at 180 °C).
const SLOPE_ENT_PER_K: f64 = 0.1;
/// Visits whose temperatures differ by less are at one temperature, K.
const AT_ONE_K: f64 = 0.1;
/// Solutions with the covariance of the one before: the uncertainty of the response counts with the residual field.
const ROUNDS: usize = 3;
/// Parameters: three offsets, three residual fields, three drifts.
const OFFSET: usize = 0;
const RESIDUAL: usize = 3;
const DRIFT: usize = 6;
const NAMES: [&str; 9] = [
    "offset_x",
    "offset_y",
    "offset_z",
    "residual_coil_x",
    "residual_coil_y",
    "residual_coil_z",
    "drift_x",
    "drift_y",
    "drift_z",
];
const UNITS: [&str; 9] = ["enT", "enT", "enT", "nT", "nT", "nT", "enT/h", "enT/h", "enT/h"];
const COIL_AXES: [&str; 3] = ["X", "Y", "Z"];

/// Offset and residual field with their uncertainties.
pub(super) struct Solved {
    /// Offset and residual field.
    pub values: OffsetValues,
    /// Drift, where positions repeat.
    pub drift: Option<OffsetDrift>,
    /// How the components were separated.
    pub method: OffsetMethod,
    /// Covariance of offsets, residual field and drift.
    pub covariance: Covariance,
    /// Their values, in the order of the covariance.
    pub parameters: Vec<f64>,
    /// Components that the positions do not determine.
    pub refused: Vec<RefusedComponent>,
    /// Reading minus model per visit, enT, without the refused components.
    pub residuals_ent: Vec<Vec<f64>>,
    /// Chi-square of the visits against the model.
    pub chi_square: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Factor by which the uncertainties were widened.
    pub widened: f64,
    /// Coil axes whose residual field is not determined: it is taken as zero with this standard uncertainty, nT.
    open_axes: Vec<usize>,
    assumed_nt: f64,
    drift_is_open: bool,
    /// Covariance of the zero levels with which it was solved.
    of_readings: DMatrix<f64>,
    /// How every visit counts in the offset of each component by the reading of that component; the sum is one.
    pub counts_by_visit: [Vec<f64>; 3],
}

/// What the visits can tell apart at all. That is a matter of the positions, not of the small angles by which they are missed.
struct Question {
    /// Number of parameters without those that are open: nine, or six without drifts.
    parameters: usize,
    /// Mean time of the visits, s since the run's start.
    reference_s: f64,
    /// Times of the visits from it, h.
    hours: Vec<f64>,
    /// Coil axes whose residual field is not determined.
    open_axes: Vec<usize>,
    /// Components whose offset is not determined.
    refused: Vec<usize>,
    /// Positions repeat, and yet drifts are not determined.
    drift_is_open: bool,
    /// Temperatures of the visits over that at which the offset of each component holds, K; absent where they are at one temperature.
    over_k: Option<[DVector<f64>; 3]>,
}

/// Temperatures of the visits over the mean of those that show a component in its normal and in its turned position, K.
fn over_k(stays: &[Stay], degc: &[f64]) -> Option<[DVector<f64>; 3]> {
    let [low, high] = extremes(degc.iter().copied());
    (high - low > AT_ONE_K).then(|| {
        [0, 1, 2].map(|component| {
            let seen = Sight::of(stays, component);
            let compared: Vec<usize> =
                if seen.turned.is_empty() { (0..stays.len()).collect() } else { [vec![seen.normal], seen.turned].concat() };
            let middle = compared.iter().map(|v| degc[*v]).sum::<f64>() / compared.len() as f64;
            DVector::from_fn(stays.len(), |v, _| degc[v] - middle)
        })
    })
}

impl Question {
    fn of(stays: &[Stay], degc: Option<&[f64]>) -> Self {
        let visits = stays.len();
        let repeats = visits > ids(stays).len();
        let reference_s = stays.iter().map(Stay::mean_s).sum::<f64>() / visits as f64;
        let hours: Vec<f64> = stays.iter().map(|s| (s.mean_s() - reference_s) / 3600.0).collect();

        let mut parameters = if repeats { 9 } else { 6 };
        let nominal: Vec<Matrix3<f64>> = stays.iter().map(|s| s.position.r_nom().transpose()).collect();
        let mut null = null_space(&rows(&nominal, &hours, parameters));
        let undetermined = |null: &DMatrix<f64>, j: usize| null.row(j).norm() > COUPLED;
        let drift_is_open = repeats && (DRIFT..9).any(|j| undetermined(&null, j));
        if drift_is_open {
            parameters = 6;
            null = null_space(&rows(&nominal, &hours, parameters));
        }
        Self {
            parameters,
            reference_s,
            hours,
            open_axes: (0..3).filter(|k| undetermined(&null, RESIDUAL + k)).collect(),
            refused: (0..3).filter(|i| undetermined(&null, OFFSET + i)).collect(),
            drift_is_open,
            over_k: degc.and_then(|degc| over_k(stays, degc)),
        }
    }

    /// The parameters that are fitted.
    fn kept(&self) -> Vec<usize> {
        let is_open = |j: &usize| (RESIDUAL..DRIFT).contains(j) && self.open_axes.contains(&(j - RESIDUAL));
        (0..self.parameters).filter(|j| !is_open(j)).collect()
    }
}

/// The least squares of the zero levels.
struct Answer<'a> {
    question: &'a Question,
    levels: &'a Levels,
    kept: Vec<usize>,
    /// All columns, those of open axes among them.
    full: DMatrix<f64>,
    /// The columns that are fitted.
    design: DMatrix<f64>,
    /// Readings, `component * visits + visit`, enT.
    readings: DVector<f64>,
    /// Values of the fitted parameters.
    values: DVector<f64>,
    covariance: DMatrix<f64>,
    chi_square: f64,
    degrees_of_freedom: usize,
    widened: f64,
    /// Residual field that the uncertainty of the response acts on, nT.
    residual_nt: Vector3<f64>,
    /// How large a residual field may be that is not determined, nT.
    assumed_nt: f64,
    /// Covariance of the readings with which it was solved.
    of_readings: DMatrix<f64>,
}

impl<'a> Answer<'a> {
    /// With the covariance of the readings that follows from the residual field itself, or with a given one.
    fn of(question: &'a Question, levels: &'a Levels, given: Option<&DMatrix<f64>>) -> Result<Self, OffsetError> {
        let visits = levels.response.len();
        let kept = question.kept();
        let full = rows(&levels.response, &question.hours, question.parameters);
        let design = DMatrix::from_fn(full.nrows(), kept.len(), |row, column| full[(row, kept[column])]);
        let readings = DVector::from_fn(3 * visits, |index, _| levels.reading_ent[(index % visits, index / visits)]);
        let mut answer = Self {
            question,
            levels,
            values: DVector::zeros(kept.len()),
            covariance: DMatrix::zeros(kept.len(), kept.len()),
            kept,
            full,
            design,
            readings,
            chi_square: f64::NAN,
            degrees_of_freedom: 0,
            widened: 1.0,
            residual_nt: Vector3::zeros(),
            assumed_nt: 0.0,
            of_readings: given.cloned().unwrap_or_default(),
        };
        for _ in 0..if given.is_some() { 1 } else { ROUNDS } {
            if given.is_none() {
                answer.of_readings = answer.covariance_of_readings();
            }
            let solution = answer.round()?;
            answer.take(&solution);
        }
        Ok(answer)
    }

    /// What follows from the residual field of the round before.
    fn covariance_of_readings(&self) -> DMatrix<f64> {
        let mut covariance = self.levels.covariance(&self.residual_nt);
        for axis in &self.question.open_axes {
            let seen = self.full.column(RESIDUAL + axis);
            covariance += seen * seen.transpose() * (self.assumed_nt * self.assumed_nt);
        }
        // Visits at other temperatures say less of an offset than those at its own.
        let visits = self.levels.response.len();
        for (component, over_k) in self.question.over_k.iter().flatten().enumerate() {
            let mut own = covariance.view_mut((component * visits, component * visits), (visits, visits));
            own += over_k * over_k.transpose() * SLOPE_ENT_PER_K.powi(2);
        }
        covariance
    }

    fn round(&self) -> Result<Solution, OffsetError> {
        let no_scatter = || FitError::NoNoise { why: "the plateau means have no scatter" };
        let lower = self.of_readings.clone().cholesky().ok_or_else(no_scatter)?.l();
        let white_design = lower.solve_lower_triangular(&self.design).ok_or_else(no_scatter)?;
        let white_readings = lower.solve_lower_triangular(&self.readings).ok_or_else(no_scatter)?;
        let rhs = DMatrix::from_column_slice(self.readings.len(), 1, white_readings.as_slice());
        let names: Vec<String> = self.kept.iter().map(|j| NAMES[*j].to_owned()).collect();
        Ok(linear::solve(&linear::Design::new(names, white_design)?, &rhs, None, &Limits::default())?)
    }

    fn take(&mut self, solution: &Solution) {
        self.values = solution.coefficients.column(0).into_owned();
        self.chi_square = solution.residuals.norm_squared();
        self.degrees_of_freedom = solution.dof;
        self.widened = order::excess(self.chi_square, solution.dof).max(self.excess_of_positions());
        self.covariance = &solution.unscaled_covariance * self.widened.powi(2);
        for (at, j) in self.kept.iter().enumerate().filter(|(_, j)| (RESIDUAL..DRIFT).contains(*j)) {
            self.residual_nt[j - RESIDUAL] = self.values[at];
        }
        // A residual field that is not determined may be as large as those that are, and as what the components read that would
        // show it.
        let Question { open_axes, refused, .. } = self.question;
        let read = refused.iter().flat_map(|i| self.levels.reading_ent.column(*i).iter().copied().collect::<Vec<f64>>());
        let determined = (0..3).filter(|k| !open_axes.contains(k)).map(|k| self.residual_nt[k]);
        self.assumed_nt = read.chain(determined).map(f64::abs).fold(0.0, f64::max);
    }

    /// Factor on the uncertainties that the disagreement of the positions asks for: what belongs to a position, as a field that changes with every turn, is
    /// the same in all its visits, and these are no more than one then.
    fn excess_of_positions(&self) -> f64 {
        let positions = &self.levels.positions;
        let visits = positions.len();
        let mut ids = positions.clone();
        ids.sort_unstable();
        ids.dedup();
        let mean = DMatrix::from_fn(3 * ids.len(), 3 * visits, |row, column| {
            let is_own = row / ids.len() == column / visits && positions[column % visits] == ids[row % ids.len()];
            if is_own { 1.0 / positions.iter().filter(|p| **p == ids[row % ids.len()]).count() as f64 } else { 0.0 }
        });
        // A drift acts within the positions.
        let parameters = self.kept.iter().filter(|j| **j < DRIFT).count();
        let left = &mean * (&self.readings - &self.design * &self.values);
        match (&mean * &self.of_readings * mean.transpose()).cholesky() {
            Some(factors) if left.len() > parameters && ids.len() < visits => {
                order::excess(left.dot(&factors.solve(&left)), left.len() - parameters)
            }
            _ => 1.0,
        }
    }

    /// Value and standard uncertainty of a parameter.
    fn parameter(&self, j: usize) -> (f64, f64) {
        let value = self.kept.iter().position(|k| *k == j).map_or(f64::NAN, |at| self.values[at]);
        let of_gain = if (RESIDUAL..DRIFT).contains(&j) { self.of_gain_nt(j - RESIDUAL) } else { 0.0 };
        (value, self.combined(|k| f64::from(u8::from(k == j))).1.hypot(of_gain))
    }

    /// Standard uncertainty of the residual field along a coil axis by that of the sensitivities, nT, where no field was applied that shows them. In enT
    /// the residual field is as it was read.
    fn of_gain_nt(&self, axis: usize) -> f64 {
        if self.levels.has_no_fields() { NOMINAL_GAIN * self.residual_nt[axis].abs() } else { 0.0 }
    }

    /// Value and standard uncertainty of a sum of parameters with factors.
    fn combined(&self, factor: impl Fn(usize) -> f64) -> (f64, f64) {
        let factors = DVector::from_fn(self.kept.len(), |at, _| factor(self.kept[at]));
        (factors.dot(&self.values), std_of(factors.dot(&(&self.covariance * &factors))))
    }

    /// Value and standard uncertainty of the residual field that a component sees, enT: half the difference of what it sees in the
    /// normal and in the turned position; in tilted positions what it sees in the first.
    fn residual_of(&self, component: usize, seen: &Sight) -> (f64, f64) {
        let row = |v: usize| self.levels.response[v].row(component).transpose();
        let sight = match seen.turned.first() {
            Some(turned) => (row(seen.normal) - row(*turned)) / 2.0,
            None => row(seen.normal),
        };
        self.combined(|j| if (RESIDUAL..DRIFT).contains(&j) { sight[j - RESIDUAL] } else { 0.0 })
    }

    /// How the readings of a component in every visit count in its offset; nan for an offset that is not determined.
    fn counts_by_visit(&self, component: usize) -> Vec<f64> {
        let visits = self.levels.response.len();
        let at = self.kept.iter().position(|j| *j == OFFSET + component);
        let weighed = self.of_readings.clone().cholesky().map(|c| c.solve(&self.design));
        let normal = weighed.as_ref().and_then(|w| w.tr_mul(&self.design).try_inverse());
        match (at, weighed, normal) {
            (Some(at), Some(weighed), Some(normal)) => {
                let own = weighed.rows(component * visits, visits) * normal.column(at);
                own.iter().copied().collect()
            }
            _ => vec![f64::NAN; visits],
        }
    }

    fn drift(&self) -> Option<OffsetDrift> {
        let of = |i: usize| self.parameter(DRIFT + i);
        (self.question.parameters == 9).then(|| OffsetDrift {
            ent_per_h: std::array::from_fn(|i| of(i).0),
            std_ent_per_h: std::array::from_fn(|i| of(i).1),
            reference_s: self.question.reference_s,
        })
    }

    /// Places of the parameters without those of refused components.
    fn shown(&self) -> Vec<usize> {
        (0..self.kept.len()).filter(|at| !self.question.refused.contains(&self.kept[*at])).collect()
    }

    /// Covariance of the parameters without those of refused components.
    fn covariance(&self) -> Covariance {
        let shown = self.shown();
        let mut covariance = self.covariance.clone();
        for (at, j) in self.kept.iter().enumerate().filter(|(_, j)| (RESIDUAL..DRIFT).contains(*j)) {
            covariance[(at, at)] += self.of_gain_nt(j - RESIDUAL).powi(2);
        }
        Covariance {
            parameters: shown.iter().map(|at| NAMES[self.kept[*at]].to_owned()).collect(),
            units: shown.iter().map(|at| UNITS[self.kept[*at]].to_owned()).collect(),
            matrix: shown.iter().map(|r| shown.iter().map(|c| covariance[(*r, *c)]).collect()).collect(),
        }
    }

    /// Reading minus model per visit, enT, without the refused components.
    fn residuals_ent(&self) -> Vec<Vec<f64>> {
        let residuals = &self.readings - &self.design * &self.values;
        let visits = self.levels.response.len();
        let own = |v: usize| (0..3).filter(|i| !self.question.refused.contains(i)).map(|i| residuals[i * visits + v]).collect();
        (0..visits).map(own).collect()
    }
}

/// Length of the longest visit, s.
fn longest_s(stays: &[Stay]) -> f64 {
    stays.iter().map(|s| s.time_s()[1] - s.time_s()[0]).fold(0.0, f64::max)
}

impl Solved {
    /// Least squares of the zero levels of visits at some temperatures, °C, with the reasons why components have no offset.
    pub fn of(stays: &[Stay], levels: &Levels, degc: Option<&[f64]>) -> Result<Self, OffsetError> {
        Self::with(stays, levels, degc, None)
    }

    /// The same visits with other fields, weighed as they were.
    pub fn again(&self, stays: &[Stay], levels: &Levels) -> Result<Self, OffsetError> {
        Self::with(stays, levels, None, Some(&self.of_readings))
    }

    fn with(stays: &[Stay], levels: &Levels, degc: Option<&[f64]>, given: Option<&DMatrix<f64>>) -> Result<Self, OffsetError> {
        let question = Question::of(stays, degc);
        let answer = Answer::of(&question, levels, given)?;
        let mut values = OffsetValues::UNDETERMINED;
        for k in (0..3).filter(|k| !question.open_axes.contains(k)) {
            (values.residual_coil_nt[k], values.residual_coil_std_nt[k]) = answer.parameter(RESIDUAL + k);
        }
        let mut refused = Vec::new();
        let mut method = OffsetMethod {
            component: std::array::from_fn(|_| "none".to_owned()),
            positions: std::array::from_fn(|_| Vec::new()),
            normal_axis: std::array::from_fn(|_| String::new()),
            response: if levels.directions.iter().all(|d| d.len() == 3) { "run" } else { "nominal" }.to_owned(),
            std_covers: Some(conditions::noise_in_std(longest_s(stays), "the longest visit of a position")),
            std_b_covers: None,
        };
        for i in 0..3 {
            let seen = Sight::of(stays, i);
            method.normal_axis[i].clone_from(&seen.normal_axis);
            if question.refused.contains(&i) {
                refused.push(seen.refusal(COMPONENTS[i]));
                continue;
            }
            (values.offset_ent[i], values.offset_std_ent[i]) = answer.parameter(OFFSET + i);
            (values.residual_ent[i], values.residual_std_ent[i]) = answer.residual_of(i, &seen);
            method.component[i] = if seen.turned.is_empty() { "tilted" } else { "turned" }.to_owned();
            method.positions[i] = seen.positions;
        }
        Ok(Self {
            values,
            drift: answer.drift(),
            method,
            covariance: answer.covariance(),
            parameters: answer.shown().into_iter().map(|at| answer.values[at]).collect(),
            refused,
            residuals_ent: answer.residuals_ent(),
            chi_square: answer.chi_square,
            degrees_of_freedom: answer.degrees_of_freedom,
            widened: answer.widened,
            counts_by_visit: [0, 1, 2].map(|i| answer.counts_by_visit(i)),
            assumed_nt: answer.assumed_nt,
            of_readings: answer.of_readings,
            open_axes: question.open_axes,
            drift_is_open: question.drift_is_open,
        })
    }

    /// What a person should know of it.
    pub fn notes(&self, levels: &Levels) -> Vec<Note> {
        let refused = |r: &RefusedComponent| {
            let text = format!("component {} is refused: {}", r.component, r.reason);
            Note::new(NoteKind::Method, text).about(r.component.as_str()).with_remedy(r.remedy.as_str())
        };
        let mut notes: Vec<Note> = self.refused.iter().map(refused).collect();
        for axis in &self.open_axes {
            let leaks: Vec<String> = (0..3)
                .filter(|i| self.values.offset_ent[*i].is_finite())
                .map(|i| {
                    let share = levels.response.iter().map(|a| a[(i, *axis)].abs()).fold(0.0, f64::max);
                    format!("{share:.4} enT per nT in {}", COMPONENTS[i])
                })
                .collect();
            if !leaks.is_empty() {
                let text = format!(
                    "the residual field along {}_c is not determined and taken as 0 ± {:.1} nT, which is in the uncertainties; it enters the \
                     offsets with {}",
                    COIL_AXES[*axis],
                    self.assumed_nt,
                    leaks.join(", ")
                );
                notes.push(Note::new(NoteKind::Method, text).about(COIL_AXES[*axis]));
            }
        }
        if self.method.response == "nominal" {
            let text = format!(
                "fields were not applied along all axes in every position: the sensor is taken to lie along the nominal axes within {:.1}°{}",
                NOMINAL_TILT.to_degrees(),
                if levels.has_no_fields() {
                    format!(", and to have sensitivities of 1 within {:.0} %, for the residual field in nT", 100.0 * NOMINAL_GAIN)
                } else {
                    String::new()
                }
            );
            notes.push(Note::new(NoteKind::Method, text));
        }
        if self.drift_is_open {
            let text = "a position repeats, but the visits do not separate a drift from the offsets; none was estimated";
            notes.push(Note::new(NoteKind::Method, text));
        }
        if self.widened > 1.0 {
            let text = format!(
                "the zero levels of the visits disagree with one offset and one residual field (chi-square {:.1} with {} degrees of freedom); \
                 the uncertainties were multiplied by {:.1}",
                self.chi_square, self.degrees_of_freedom, self.widened
            );
            notes.push(Note::new(NoteKind::Method, text));
        }
        notes
    }
}

/// Rows of the model `reading = offset + A residual + drift * hours`, `component * visits + visit`.
fn rows(response: &[Matrix3<f64>], hours: &[f64], parameters: usize) -> DMatrix<f64> {
    let visits = response.len();
    DMatrix::from_fn(3 * visits, parameters, |row, j| {
        let (i, v) = (row / visits, row % visits);
        match j {
            OFFSET..RESIDUAL => f64::from(u8::from(i == j)),
            RESIDUAL..DRIFT => response[v][(i, j - RESIDUAL)],
            _ => f64::from(u8::from(i == j - DRIFT)) * hours[v],
        }
    })
}

/// Orthonormal vectors that a design takes to zero, as columns.
fn null_space(design: &DMatrix<f64>) -> DMatrix<f64> {
    let scales: Vec<f64> = design.column_iter().map(|c| c.norm()).map(|n| if n > 0.0 { n } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(design.nrows(), design.ncols(), |r, c| design[(r, c)] / scales[c]);
    let eigen = (scaled.transpose() * &scaled).symmetric_eigen();
    let null: Vec<usize> = (0..design.ncols()).filter(|i| eigen.eigenvalues[*i] < 1e-9).collect();
    DMatrix::from_fn(design.ncols(), null.len(), |r, c| eigen.eigenvectors[(r, null[c])])
}
