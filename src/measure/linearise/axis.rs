//! The polynomial of one sensor axis from the runs together.

use super::data::Data;
use super::panel::panel;
use super::refusal::{LineariseError, MOST_CONDITION};
use super::told::{probability, tell};
use crate::data::linearisation::{LinearisationPanel, LinearisedAxis};
use crate::data::units::COMPONENTS;
use crate::fit::partitioned::{self, Part, Projected, Shared};
use crate::fit::statistics::extremes;
use crate::fit::{FitError, Limits};
use crate::model::linearisation::{AxisLinearisation, LEAST_SLOPE};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// Gauss-Newton steps; each shrinks the error by the size of the non-linearity.
const MAX_STEPS: usize = 30;
/// A step that changes no reading by more than this share of the largest ends them.
const FINISHED: f64 = 1e-12;
/// A noise below this share of the largest reading is rounding and weighs no more.
const LEAST_NOISE: f64 = 1e-12;
/// Coefficients less probable without non-linearity are significant.
const SIGNIFICANT: f64 = 0.01;

/// The polynomial of one sensor axis.
pub(super) struct AxisFit {
    /// The polynomial.
    pub polynomial: AxisLinearisation,
    /// Covariance of c2, 1/enT, and c3, 1/enT².
    pub covariance: Matrix2<f64>,
    /// Smallest and largest reading, enT.
    pub range_ent: [f64; 2],
    /// What is known of it.
    pub about: LinearisedAxis,
    /// Dependence on the fields along the three coil axes.
    pub panels: Vec<LinearisationPanel>,
}

/// Where the iteration stands: the effects of square and cube at the largest reading, enT, and the own parameters of every run.
struct Point {
    effect_ent: DVector<f64>,
    own: Vec<DVector<f64>>,
}

/// The readings of one sensor axis in all runs.
struct Problem<'a> {
    data: &'a [Data<'a>],
    axis: usize,
    readings: Vec<DVector<f64>>,
    /// The largest reading, enT.
    scale_ent: f64,
}

/// Fits the polynomial of a sensor axis, 0 to 2, to the runs, and judges it.
pub(super) fn fit_axis(data: &[Data], axis: usize) -> Result<AxisFit, LineariseError> {
    let problem = Problem::of(data, axis);
    let (point, projected) = problem.settle()?;
    let fitted = problem.polynomial(&point.effect_ent);
    let range_ent = extremes(problem.readings.iter().flat_map(|r| r.iter().copied()));
    if fitted.least_slope(range_ent) < LEAST_SLOPE {
        return Err(LineariseError::NotMonotone { component: problem.component() });
    }
    let solved = problem.solve(&projected)?;
    let told = tell(data, axis, &projected, &solved).map_err(|e| problem.explain(e))?;
    let to_natural = Matrix2::from_diagonal(&Vector2::new(problem.scale_ent.powi(-2), problem.scale_ent.powi(-3)));
    let covariance_ent2 = told.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let degrees_of_freedom = data.iter().map(|d| d.own.nrows() - d.own.ncols()).sum::<usize>() - 2;
    let dof = (!told.from_samples).then_some(degrees_of_freedom);
    let effect = Vector2::new(point.effect_ent[0], point.effect_ent[1]);
    let probability = probability(&effect, &covariance_ent2, dof);
    let panels = (0..3).map(|coil| panel(data, axis, coil, &problem.readings, &projected, told.from_samples)).collect();
    Ok(AxisFit {
        polynomial: fitted,
        covariance: to_natural * covariance_ent2 * to_natural,
        range_ent,
        about: LinearisedAxis {
            name: problem.component().to_owned(),
            largest_correction_ent: largest_correction_ent(&fitted, range_ent),
            probability,
            significant: probability < SIGNIFICANT,
            degrees_of_freedom,
            between_chi2: told.chi2,
            between_degrees_of_freedom: told.dof,
            inflation: told.inflation,
            condition: solved.condition,
        },
        panels,
    })
}

impl<'a> Problem<'a> {
    fn of(data: &'a [Data<'a>], axis: usize) -> Self {
        let readings: Vec<DVector<f64>> = data.iter().map(|d| d.readings(axis)).collect();
        let scale_ent = readings.iter().map(DVector::amax).fold(0.0, f64::max);
        Self { data, axis, readings, scale_ent }
    }

    fn component(&self) -> &'static str {
        COMPONENTS[self.axis]
    }

    fn explain(&self, error: FitError) -> LineariseError {
        let component = self.component();
        match error {
            FitError::Undetermined { parameters, condition } => LineariseError::Undetermined { component, parameters, condition },
            error => LineariseError::Fit { component, error },
        }
    }

    fn not_settled(&self) -> LineariseError {
        self.explain(FitError::NotSettled { what: "the linearisation", iterations: MAX_STEPS })
    }

    fn polynomial(&self, effect_ent: &DVector<f64>) -> AxisLinearisation {
        AxisLinearisation {
            c2_per_ent: effect_ent[0] / self.scale_ent.powi(2),
            c3_per_ent2: effect_ent[1] / self.scale_ent.powi(3),
        }
    }

    fn weight(&self, noise_ent: f64) -> f64 {
        noise_ent.max(LEAST_NOISE * self.scale_ent).powi(-2)
    }

    /// The linear fit of every run. Square and cube of the readings themselves would hold their noise, and seem determined by it where
    /// the settings determine nothing.
    fn start(&self) -> Result<Point, LineariseError> {
        let own: Option<_> = self.data.iter().zip(&self.readings).map(|(d, r)| partitioned::alone(&d.own, r)).collect();
        Ok(Point { own: own.ok_or_else(|| self.not_settled())?, effect_ent: DVector::zeros(2) })
    }

    /// The least squares of all runs, with the parts of its last step. They are found a second time with the weights that the residuals
    /// then show: those of the runs alone contain the non-linearity.
    fn settle(&self) -> Result<(Point, Vec<Projected>), LineariseError> {
        let mut point = self.start()?;
        let alone = self.data.iter().map(|d| self.weight(d.lin.calibration.noise.std_ent[self.axis]));
        let first = self.iterate(&mut point, &alone.collect::<Vec<f64>>())?;
        let shown = first.iter().map(|p| self.weight(p.left_std()));
        let projected = self.iterate(&mut point, &shown.collect::<Vec<f64>>())?;
        Ok((point, projected))
    }

    /// Steps with given weights until no reading changes any more.
    fn iterate(&self, point: &mut Point, weights: &[f64]) -> Result<Vec<Projected>, LineariseError> {
        for _ in 0..MAX_STEPS {
            let projected = self.parts(point, weights)?;
            let step = self.solve(&projected)?.values;
            let own: Option<Vec<DVector<f64>>> = projected.iter().map(|p| p.own(&step)).collect();
            let own = own.ok_or_else(|| self.not_settled())?;
            point.effect_ent += &step;
            point.own.iter_mut().zip(own).for_each(|(value, step)| *value += step);
            if step.amax() <= FINISHED * self.scale_ent {
                return self.parts(point, weights);
            }
        }
        Err(self.not_settled())
    }

    /// The parts of a linear step: rows are divided by the slope, which turns linearised readings into readings.
    fn parts(&self, point: &Point, weights: &[f64]) -> Result<Vec<Projected>, LineariseError> {
        let current = self.polynomial(&point.effect_ent);
        let each = self.data.iter().zip(&self.readings).zip(&point.own).zip(weights);
        each.map(|(((d, readings), own), weight)| {
            let linear = &d.own * own;
            let modelled: Option<Vec<f64>> = linear.iter().map(|l| current.reading_ent(*l)).collect();
            let modelled = modelled.ok_or_else(|| LineariseError::NotMonotone { component: self.component() })?;
            let slopes: Vec<f64> = modelled.iter().map(|r| current.slope(*r)).collect();
            let power = |i: usize, j: usize| (modelled[i] / self.scale_ent).powi(j as i32 + 2);
            let part = Part {
                own: DMatrix::from_fn(d.own.nrows(), d.own.ncols(), |i, j| d.own[(i, j)] / slopes[i]),
                shared: DMatrix::from_fn(modelled.len(), 2, |i, j| -power(i, j) / slopes[i]),
                rhs: DVector::from_fn(modelled.len(), |i, _| readings[i] - modelled[i]),
                weight: *weight,
            };
            Projected::of(part).map_err(|e| self.explain(e))
        })
        .collect()
    }

    fn solve(&self, parts: &[Projected]) -> Result<Shared, LineariseError> {
        let names = ["the square".to_owned(), "the cube".to_owned()];
        partitioned::solve(parts, &names, &Limits { max_condition: MOST_CONDITION }).map_err(|e| self.explain(e))
    }
}

/// The correction is largest at an end of the range or where its derivative vanishes.
fn largest_correction_ent(polynomial: &AxisLinearisation, [low, high]: [f64; 2]) -> f64 {
    let turn = -2.0 * polynomial.c2_per_ent / (3.0 * polynomial.c3_per_ent2);
    let inside = if turn > low && turn < high { turn } else { low };
    [low, high, inside].into_iter().map(|r| polynomial.correction_ent(r).abs()).fold(0.0, f64::max)
}
