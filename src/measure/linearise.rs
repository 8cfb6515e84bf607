//! The non-linearity of the readings of one sensor and mode (CH-GFZ-TR-2601 section 7): one third-order polynomial per sensor axis
//! that all its runs share, and the check for dependence on fields across an axis.
//!
//! `r + c2 r² + c3 r³ = A B_c + Σ p_k τ^k`: every run has its own response and offset trend, `c2` and `c3` are common. The argument of
//! the polynomial is the reading without its noise, so that the model of a reading is the inverse of the polynomial at the linear model,
//! and Gauss-Newton steps lead to the least squares of the readings themselves. In every step the runs' own parameters are projected
//! out ([`partitioned`]).

use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::provenance::Input;
use crate::data::result::Covariance;
use crate::data::run::Run;
use crate::data::units::COMPONENTS;
use crate::files::parameter::{
    LinearisationConvention, LinearisationFile, LinearisationPanel, LinearisedAxis, LinearisedRun, PanelFit,
    linearisation_file_name,
};
use crate::fit::partitioned::{self, Part, Projected};
use crate::fit::{FitError, Limits, linear, order};
use crate::measure::lin::Lin;
use crate::model::linearisation::Linearisation;
use crate::model::linearisation::LinearisationApplied;
use crate::model::linearisation::LinearisationPolynomials;
use crate::model::linearisation::{AxisLinearisation, LEAST_SLOPE};
use crate::record::conditions;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use thiserror::Error;

/// Largest condition number of square and cube with the runs' own parameters projected out, columns of unit norm.
const MOST_CONDITION: f64 = 1e4;
/// Gauss-Newton steps; each shrinks the error by the size of the non-linearity.
const MAX_STEPS: usize = 30;
/// A step that changes no reading by more than this share of the largest ends them.
const FINISHED: f64 = 1e-12;
/// A noise below this share of the largest reading is rounding and weighs no more.
const LEAST_NOISE: f64 = 1e-12;
/// Coefficients less probable without non-linearity are significant.
const SIGNIFICANT: f64 = 0.01;
/// A field whose component along an axis is this part of its magnitude lies along it.
const ALONG: f64 = 0.99;
/// A field below this part of the run's largest is none, and shown in every panel.
const NO_FIELD: f64 = 0.01;
/// A programme whose fields lie along coil axes in at least this part of its settings is shown axis by axis.
const MOSTLY: f64 = 0.9;
/// Bins of a panel.
const BINS: usize = 12;
/// Names of the coil axes.
const COIL: [&str; 3] = ["X", "Y", "Z"];

/// Why there is no linearisation.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LineariseError {
    /// No run is long enough.
    #[error("no run has more plateaus than response, offset trend, square and cube have parameters")]
    NoRuns,
    /// The settings do not determine a coefficient.
    #[error(
        "the runs do not determine {} of component {component} beside sensitivity and offset (condition number {condition:.1e}, at \
         most {MOST_CONDITION:.0e} is accepted)",
        parameters.join(" and ")
    )]
    Undetermined {
        /// Component of the reading.
        component: &'static str,
        /// What is not determined.
        parameters: Vec<String>,
        /// Condition number.
        condition: f64,
    },
    /// No small correction.
    #[error(
        "the polynomial of component {component} has a slope below {LEAST_SLOPE} within the readings: that is no small correction"
    )]
    NotMonotone {
        /// Component of the reading.
        component: &'static str,
    },
    /// Another failure of the fit.
    #[error("component {component}: the fit failed: {error}")]
    Fit {
        /// Component of the reading.
        component: &'static str,
        /// The failure.
        error: FitError,
    },
}

impl LineariseError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            LineariseError::NoRuns => "use a longer programme, or fit without --linearise",
            LineariseError::Undetermined { .. } => {
                "add runs with at least four different fields along every sensor axis, both signs among them, or fit without --linearise"
            }
            LineariseError::NotMonotone { .. } => {
                "look at the residuals of the runs for outliers and saturation, and use at least four different fields along every axis"
            }
            LineariseError::Fit { .. } => "check the plateaus of the runs fitted without --linearise",
        }
    }
}

/// The polynomials of a sensor and mode, before the runs are fitted with them.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The polynomials, ready for [`lin`](crate::measure::lin::Options). Its input has its name only: the file is not yet written.
    pub linearisation: Linearisation,
    campaign: String,
    runs: Vec<String>,
    used: Vec<bool>,
    axes: Vec<LinearisedAxis>,
    panels: Vec<LinearisationPanel>,
    warnings: Vec<String>,
}

/// A linearisation with what its figures show.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Linearised {
    /// The parameters, as in the file.
    pub parameters: LinearisationFile,
    /// What the panels show, in the order of those of the file: sensor axis by sensor axis.
    pub panels: Vec<PanelData>,
}

/// Residuals of one sensor axis against the field along one coil axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PanelData {
    /// Field, nT, and residual with the linearisation, nT.
    pub points: Vec<[f64; 2]>,
    /// Means over bins of the field with the linearisation.
    pub after: Vec<BinMean>,
    /// The same without it.
    pub before: Vec<BinMean>,
}

/// Mean residual over a bin of the field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BinMean {
    /// Mean field, nT.
    pub field_nt: f64,
    /// Mean residual, nT.
    pub residual_nt: f64,
    /// Its standard error from the scatter in the bin, nT; absent for a single residual.
    pub std_nt: Option<f64>,
    /// Residuals in the bin.
    pub count: usize,
}

/// One run made ready.
struct Data<'a> {
    lin: &'a Lin,
    used: Vec<&'a Plateau>,
    /// Field, then powers of τ: the design of its own fit.
    own: DMatrix<f64>,
}

impl<'a> Data<'a> {
    fn of(lin: &'a Lin) -> Self {
        let offset = &lin.parameters.offset;
        let [begin, end] = offset.tau_span_s;
        let tau = |t_s: f64| if end > begin { 2.0 * (t_s - begin) / (end - begin) - 1.0 } else { 0.0 };
        let used: Vec<&Plateau> = lin.blocks.iter().map(|b| &b.plateau).filter(|p| p.dropped.is_none()).collect();
        let own = DMatrix::from_fn(used.len(), 4 + offset.trend_order, |row, column| {
            let p = used[row];
            if column < 3 { p.setting.field.0[column] } else { tau(p.t_s()).powi(column as i32 - 3) }
        });
        Self { lin, used, own }
    }

    fn is_long_enough(&self) -> bool {
        self.own.nrows() > self.own.ncols() + 2
    }

    fn readings(&self, axis: usize) -> DVector<f64> {
        DVector::from_iterator(self.used.len(), self.used.iter().map(|p| p.mean.0[axis]))
    }

    fn fields(&self, coil: usize) -> impl Iterator<Item = f64> {
        self.used.iter().map(move |p| p.setting.field.0[coil])
    }
}

/// Finds the polynomials that runs of one sensor and mode share. The runs are linear calibrations without a linearisation.
///
/// # Errors
/// [`LineariseError`]: what the runs do not determine.
pub fn linearise(runs: &[&Lin]) -> Result<Estimate, LineariseError> {
    let all: Vec<Data> = runs.iter().map(|lin| Data::of(lin)).collect();
    let used: Vec<bool> = all.iter().map(Data::is_long_enough).collect();
    let ids: Vec<String> = runs.iter().map(|l| l.parameters.run.id.clone()).collect();
    let mut warnings: Vec<String> = Vec::new();
    for (id, _) in ids.iter().zip(&used).filter(|(_, used)| !**used) {
        warnings.push(format!("run {id} has too few plateaus to say anything about the polynomials"));
    }
    let data: Vec<Data> = all.into_iter().filter(Data::is_long_enough).collect();
    let Some(head) = data.first().map(|d| &d.lin.parameters.run) else {
        return Err(LineariseError::NoRuns);
    };
    // The error of the first axis, whichever thread is the first.
    let fits: Vec<_> = (0..3).into_par_iter().map(|axis| fit_axis(&data, axis)).collect();
    let axes: Vec<AxisFit> = fits.into_iter().collect::<Result<_, _>>()?;

    let weak: Vec<&str> = axes.iter().filter(|a| !a.about.significant).map(|a| a.about.name.as_str()).collect();
    if !weak.is_empty() {
        warnings.push(format!(
            "the non-linearity of {} is not significant: it may be absent, or the readings may not reach far enough to show it; the runs \
             are linearised all the same, which makes their parameters more uncertain",
            weak.join(", ")
        ));
    }
    for a in axes.iter().filter(|a| a.about.inflation > 1.0) {
        warnings.push(format!(
            "the runs disagree about the polynomial of {} by {:.1} times their noise; its standard uncertainties are larger by this",
            a.about.name, a.about.inflation
        ));
    }
    let part = LinearisationPolynomials {
        c2_per_ent: std::array::from_fn(|a| axes[a].polynomial.c2_per_ent),
        c2_std_per_ent: std::array::from_fn(|a| axes[a].covariance[(0, 0)].sqrt()),
        c3_per_ent2: std::array::from_fn(|a| axes[a].polynomial.c3_per_ent2),
        c3_std_per_ent2: std::array::from_fn(|a| axes[a].covariance[(1, 1)].sqrt()),
        reading_ent: std::array::from_fn(|a| axes[a].range_ent),
    };
    let input = Input { path: linearisation_file_name(&ids), size_bytes: 0, sha256: String::new() };
    Ok(Estimate {
        linearisation: Linearisation {
            input,
            sensor: head.sensor.clone(),
            mode: head.mode.clone(),
            part,
            covariance: std::array::from_fn(|a| axes[a].covariance),
        },
        campaign: head.campaign.clone(),
        runs: ids,
        used,
        panels: axes.iter().flat_map(|a| a.panels.clone()).collect(),
        axes: axes.into_iter().map(|a| a.about).collect(),
        warnings,
    })
}

/// The polynomial of one sensor axis.
struct AxisFit {
    polynomial: AxisLinearisation,
    covariance: Matrix2<f64>,
    range_ent: [f64; 2],
    about: LinearisedAxis,
    panels: Vec<LinearisationPanel>,
}

/// Where the iteration stands: the effects of square and cube at the largest reading, enT, and the own parameters of every run.
struct Point {
    effect_ent: DVector<f64>,
    own: Vec<DVector<f64>>,
}

fn fit_axis(data: &[Data], axis: usize) -> Result<AxisFit, LineariseError> {
    let component = COMPONENTS[axis];
    let names = ["the square".to_owned(), "the cube".to_owned()];
    let limits = Limits { max_condition: MOST_CONDITION };
    let explain = |error: FitError| match error {
        FitError::Undetermined { parameters, condition } => LineariseError::Undetermined { component, parameters, condition },
        error => LineariseError::Fit { component, error },
    };
    let readings: Vec<DVector<f64>> = data.iter().map(|d| d.readings(axis)).collect();
    let scale_ent = readings.iter().map(DVector::amax).fold(0.0, f64::max);
    let polynomial = |effect: &DVector<f64>| AxisLinearisation {
        c2_per_ent: effect[0] / scale_ent.powi(2),
        c3_per_ent2: effect[1] / scale_ent.powi(3),
    };
    let weight = |noise_ent: f64| noise_ent.max(LEAST_NOISE * scale_ent).powi(-2);
    let mut weights: Vec<f64> = data.iter().map(|d| weight(d.lin.parameters.noise.std_ent[axis])).collect();

    // The parts of a linear step: rows are divided by the slope, which turns linearised readings into readings.
    let parts = |point: &Point, weights: &[f64]| -> Result<Vec<Projected>, LineariseError> {
        let current = polynomial(&point.effect_ent);
        let each = data.iter().zip(&readings).zip(&point.own).zip(weights).map(|(((d, readings), own), weight)| {
            let linear = &d.own * own;
            let modelled: Option<Vec<f64>> = linear.iter().map(|l| current.reading_ent(*l)).collect();
            let modelled = modelled.ok_or(LineariseError::NotMonotone { component })?;
            let slopes: Vec<f64> = modelled.iter().map(|r| current.slope(*r)).collect();
            let part = Part {
                own: DMatrix::from_fn(d.own.nrows(), d.own.ncols(), |i, j| d.own[(i, j)] / slopes[i]),
                shared: DMatrix::from_fn(modelled.len(), 2, |i, j| -(modelled[i] / scale_ent).powi(j as i32 + 2) / slopes[i]),
                rhs: DVector::from_fn(modelled.len(), |i, _| readings[i] - modelled[i]),
                weight: *weight,
            };
            Projected::of(part).map_err(explain)
        });
        each.collect()
    };

    // The start is the linear fit of every run. Square and cube of the readings themselves would hold their noise, and seem
    // determined by it where the settings determine nothing.
    let own: Option<Vec<DVector<f64>>> = data.iter().zip(&readings).map(|(d, r)| partitioned::alone(&d.own, r)).collect();
    let own = own.ok_or_else(|| explain(not_settled()))?;
    let mut point = Point { own, effect_ent: DVector::zeros(2) };

    // A second time with the weights that the residuals then show: those of the runs alone contain the non-linearity.
    let mut projected = Vec::new();
    for round in 0..2 {
        let mut settled = false;
        for _ in 0..MAX_STEPS {
            projected = parts(&point, &weights)?;
            let step = partitioned::solve(&projected, &names, &limits).map_err(explain)?.values;
            let own = own_parameters(&projected, &step).ok_or_else(|| explain(not_settled()))?;
            point.effect_ent += &step;
            point.own.iter_mut().zip(own).for_each(|(value, step)| *value += step);
            settled = step.amax() <= FINISHED * scale_ent;
            if settled {
                break;
            }
        }
        if !settled {
            return Err(explain(not_settled()));
        }
        projected = parts(&point, &weights)?;
        if round == 0 {
            weights = projected.iter().map(|p| weight(p.left_std())).collect();
        }
    }

    let range_ent = [
        readings.iter().map(DVector::min).fold(f64::INFINITY, f64::min),
        readings.iter().map(DVector::max).fold(f64::NEG_INFINITY, f64::max),
    ];
    let fitted = polynomial(&point.effect_ent);
    if fitted.least_slope(range_ent) < LEAST_SLOPE {
        return Err(LineariseError::NotMonotone { component });
    }
    let solved = partitioned::solve(&projected, &names, &limits).map_err(explain)?;
    let told = tell(data, axis, &projected, &solved).map_err(explain)?;
    let to_natural = Matrix2::from_diagonal(&Vector2::new(scale_ent.powi(-2), scale_ent.powi(-3)));
    let covariance_ent2 = told.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let degrees_of_freedom = data.iter().map(|d| d.own.nrows() - d.own.ncols()).sum::<usize>() - 2;
    let dof = (!told.from_samples).then_some(degrees_of_freedom);
    let effect = Vector2::new(point.effect_ent[0], point.effect_ent[1]);
    let probability = probability(&effect, &covariance_ent2, dof);
    let panels = (0..3).map(|coil| panel(data, axis, coil, &readings, &projected, dof)).collect();
    Ok(AxisFit {
        polynomial: fitted,
        covariance: to_natural * covariance_ent2 * to_natural,
        range_ent,
        about: LinearisedAxis {
            name: component.to_owned(),
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

fn not_settled() -> FitError {
    FitError::NotSettled { what: "the linearisation", iterations: MAX_STEPS }
}

fn own_parameters(parts: &[Projected], shared: &DVector<f64>) -> Option<Vec<DVector<f64>>> {
    parts.iter().map(|p| p.own(shared)).collect()
}

/// The correction is largest at an end of the range or where its derivative vanishes.
fn largest_correction_ent(polynomial: &AxisLinearisation, [low, high]: [f64; 2]) -> f64 {
    let turn = -2.0 * polynomial.c2_per_ent / (3.0 * polynomial.c3_per_ent2);
    let inside = if turn > low && turn < high { turn } else { low };
    [low, high, inside].into_iter().map(|r| polynomial.correction_ent(r).abs()).fold(0.0, f64::max)
}

/// What the noise of the runs says about shared parameters.
struct Told {
    covariance: DMatrix<f64>,
    chi2: f64,
    dof: usize,
    inflation: f64,
    from_samples: bool,
}

/// Uncertainty of shared parameters of a component from the noise model of every run.
fn tell(data: &[Data], axis: usize, parts: &[Projected], solved: &partitioned::Shared) -> Result<Told, FitError> {
    let mut from_samples = true;
    let mut noise = Vec::new();
    for (d, projected) in data.iter().zip(parts) {
        let (rows, own, shared) = (d.own.nrows(), d.own.ncols(), projected.basis.ncols());
        let columns = DMatrix::from_fn(rows, own + shared, |i, j| {
            if j < own { projected.part.own[(i, j)] } else { projected.basis[(i, j - own)] }
        });
        let design = linear::Design::new((0..own + shared).map(|j| format!("column {j}")).collect(), columns)?;
        let rhs = DMatrix::from_column_slice(rows, 1, projected.part.rhs.as_slice());
        let solution = linear::solve(&design, &rhs, None, &Limits::default())?;
        let model = conditions::noise_of(&solution, &d.used, &[axis])?;
        from_samples &= model.is_from_samples();
        noise.push(model.covariance().view((own, own), (shared, shared)).into_owned());
    }
    let told = partitioned::uncertainty(parts, solved, &noise);
    let inflation = order::excess(told.chi2, told.dof);
    Ok(Told { covariance: told.covariance * inflation.powi(2), chi2: told.chi2, dof: told.dof, inflation, from_samples })
}

/// Probability of two values as large as these if the true ones are zero: Hotelling's T² with the degrees of freedom of the noise, the
/// normal limit without.
fn probability(values: &Vector2<f64>, covariance: &Matrix2<f64>, dof: Option<usize>) -> f64 {
    let Some(inverse) = covariance.try_inverse() else {
        return if values.amax() > 0.0 { 0.0 } else { 1.0 };
    };
    let squares = (values.transpose() * inverse * values)[(0, 0)].max(0.0);
    match dof {
        Some(dof) => (1.0 + squares / dof as f64).powf(-0.5 * dof as f64),
        None => (-0.5 * squares).exp(),
    }
}

/// Coil axis along which a sensor axis nominally lies.
fn nominal_axis(lin: &Lin, sensor: usize) -> usize {
    let r_nom = &lin.parameters.matrix.r_nom;
    (0..3).find(|coil| r_nom[*coil][sensor] != 0.0).unwrap_or(sensor)
}

/// Square and cube of the field along a coil axis in the residual of a sensor axis. Along the axis itself they are what the
/// linearisation takes away; across it they are fitted beside the linearisation, which they would otherwise imitate: where the fields
/// have one magnitude, the square along an axis is a constant less the squares across it.
fn panel(
    data: &[Data],
    axis: usize,
    coil: usize,
    readings: &[DVector<f64>],
    projected: &[Projected],
    dof: Option<usize>,
) -> LinearisationPanel {
    let on_axis = data.iter().all(|d| nominal_axis(d.lin, axis) == coil);
    let scale_nt = data.iter().flat_map(|d| d.fields(coil)).fold(0.0, |a: f64, b| a.max(b.abs()));
    let fitted = || -> Option<PanelFit> {
        let mut kept = Vec::new();
        let mut parts = Vec::new();
        for ((d, readings), projected) in data.iter().zip(readings).zip(projected) {
            let part = &projected.part;
            let fields: Vec<f64> = d.fields(coil).map(|b| b / scale_nt).collect();
            let before = if on_axis { 0 } else { 2 };
            let shared = DMatrix::from_fn(fields.len(), before + 2, |i, j| {
                if j < before { part.shared[(i, j)] } else { fields[i].powi((j - before) as i32 + 2) }
            });
            let (own, rhs) = if on_axis { (&d.own, readings) } else { (&part.own, &part.rhs) };
            // A run too short for more columns says nothing here.
            if let Ok(one) = Projected::of(Part { own: own.clone(), shared, rhs: rhs.clone(), weight: part.weight }) {
                parts.push(one);
                kept.push(Data { lin: d.lin, used: d.used.clone(), own: own.clone() });
            }
        }
        let count = if on_axis { 2 } else { 4 };
        let names: Vec<String> = (0..count).map(|j| format!("column {j}")).collect();
        let solved = partitioned::solve(&parts, &names, &Limits { max_condition: MOST_CONDITION }).ok()?;
        let told = tell(&kept, axis, &parts, &solved).ok()?;
        // A reading that is too large makes applied minus modelled field too small.
        let sigma = kept.iter().map(|d| d.lin.parameters.matrix.sigma[axis][axis]).sum::<f64>() / kept.len() as f64;
        let (at, last) = (count - 2, count - 1);
        let values = Vector2::new(solved.values[at], solved.values[last]);
        let covariance = told.covariance.view((at, at), (2, 2)).fixed_view::<2, 2>(0, 0).into_owned();
        let std = |i: usize| sigma * covariance[(i, i)].sqrt();
        Some(PanelFit {
            quadratic_per_nt: -sigma * values[0] / scale_nt.powi(2),
            quadratic_std_per_nt: std(0) / scale_nt.powi(2),
            cubic_per_nt2: -sigma * values[1] / scale_nt.powi(3),
            cubic_std_per_nt2: std(1) / scale_nt.powi(3),
            probability: probability(&values, &covariance, dof),
        })
    };
    LinearisationPanel {
        sensor_axis: COMPONENTS[axis].to_owned(),
        coil_axis: COIL[coil].to_owned(),
        on_axis,
        largest_field_nt: scale_nt,
        fitted: if scale_nt > 0.0 { fitted() } else { None },
    }
}

/// Linearises the mean readings of a run. That the mean of a square is not the square of the mean changes every plateau by the same
/// `c2 s² + ...`, which belongs to the offset; scatter and contrasts within the plateaus keep the scale of the raw readings, from which
/// the slope of the polynomial hardly differs.
pub(super) fn apply(
    linearisation: &Linearisation,
    run: &Run,
    list: &mut [Plateau],
    notes: &mut impl Extend<Note>,
) -> LinearisationApplied {
    let header = &run.header;
    if (header.sensor.as_str(), header.mode.as_str()) != (linearisation.sensor.as_str(), linearisation.mode.as_str()) {
        let text = format!(
            "{} was made with {} {}, the run is of {} {}",
            linearisation.input.path, linearisation.sensor, linearisation.mode, header.sensor, header.mode
        );
        notes.extend([Note::new(NoteKind::Data, text).about(&linearisation.input.path)]);
    }
    for (axis, name) in COMPONENTS.into_iter().enumerate() {
        let [low, high] = linearisation.part.reading_ent[axis];
        let beyond = list.iter().filter(|p| p.dropped.is_none() && !(low..=high).contains(&p.mean.0[axis]));
        let (count, farthest) =
            beyond.fold((0, 0.0_f64), |(n, far), p| (n + 1, far.max(low - p.mean.0[axis]).max(p.mean.0[axis] - high)));
        // Runs of one programme end within a small part of each other.
        if farthest > 0.01 * (high - low) {
            let text = format!(
                "{count} mean readings of {name} lie up to {farthest:.0} enT beyond the range of {}, {low:.0} to {high:.0} enT",
                linearisation.input.path
            );
            notes.extend([Note::new(NoteKind::Method, text).about(name)]);
        }
    }
    for plateau in list {
        for axis in 0..3 {
            plateau.mean.0[axis] = linearisation.axis(axis).linearised_ent(plateau.mean.0[axis]);
        }
    }
    LinearisationApplied { file: linearisation.input.path.clone(), applied: linearisation.part.clone() }
}

/// What the uncertainty of the polynomials adds to the covariance of all coefficients of a run, parameter j of component a at
/// `a * p + j`. In the joint estimate it is independent of the noise that acts on the coefficients at known polynomials. The readings
/// may be linearised ones: the difference is of second order.
///
/// # Errors
/// Those of [`linear::solve`].
pub(super) fn carried(
    linearisation: &Linearisation,
    design: &linear::Design,
    used: &[&Plateau],
) -> Result<DMatrix<f64>, FitError> {
    let powers = DMatrix::from_fn(used.len(), 6, |i, j| used[i].mean.0[j / 2].powi(j as i32 % 2 + 2));
    let effect = linear::solve(design, &powers, None, &Limits::default())?.coefficients;
    let count = effect.nrows();
    let mut covariance = DMatrix::zeros(3 * count, 3 * count);
    for axis in 0..3 {
        let own = effect.columns(2 * axis, 2);
        let part = own * linearisation.covariance[axis] * own.transpose();
        covariance.view_mut((axis * count, axis * count), (count, count)).copy_from(&part);
    }
    Ok(covariance)
}

impl Estimate {
    /// The whole result, with the runs fitted without and with the polynomials, in the order of [`linearise`]; a run whose second fit
    /// failed is absent.
    #[must_use]
    pub fn complete(self, before: &[&Lin], after: &[Option<&Lin>]) -> Linearised {
        let both = || before.iter().zip(after).filter_map(|(b, a)| Some((*b, (*a)?)));
        let run = before
            .iter()
            .zip(after)
            .zip(&self.used)
            .filter_map(|((b, a), used)| {
                let after = (*a)?;
                Some(LinearisedRun {
                    id: b.parameters.run.id.clone(),
                    used: *used,
                    blocks: b.parameters.quality.blocks_used,
                    residual_std_before_nt: residual_std_nt(b),
                    residual_std_after_nt: residual_std_nt(after),
                })
            })
            .collect();
        let panels = (0..9).map(|i| panel_data(both(), i / 3, i % 3)).collect();
        let Linearisation { sensor, mode, part, covariance, .. } = self.linearisation;
        let parameters = LinearisationFile {
            convention: LinearisationConvention::default(),
            sensor,
            mode,
            campaign: self.campaign,
            used: self.runs,
            linearisation: part,
            covariance: named(&covariance),
            axis: self.axes,
            run,
            panel: self.panels,
            warnings: self.warnings,
        };
        Linearised { parameters, panels }
    }
}

fn named(blocks: &[Matrix2<f64>; 3]) -> Covariance {
    let of = |what: &dyn Fn(&str) -> [String; 2]| COMPONENTS.into_iter().flat_map(what).collect();
    let entry = |i: usize, j: usize| if i / 2 == j / 2 { blocks[i / 2][(i % 2, j % 2)] } else { 0.0 };
    Covariance {
        parameters: of(&|axis| [format!("c2_{axis}"), format!("c3_{axis}")]),
        units: of(&|_| ["1/enT".to_owned(), "1/enT^2".to_owned()]),
        matrix: (0..6).map(|i| (0..6).map(|j| entry(i, j)).collect()).collect(),
    }
}

/// Residual of every used plateau, applied field minus modelled measurement, along the real sensor axes, nT.
fn along_sensor_nt(lin: &Lin) -> Vec<(&Plateau, [f64; 3])> {
    let phi = Matrix3::from_fn(|r, c| lin.parameters.matrix.phi[r][c]);
    let response = phi.try_inverse().unwrap_or_else(Matrix3::zeros);
    let axes: [Vector3<f64>; 3] = std::array::from_fn(|a| response.row(a).transpose().normalize());
    let used = lin.blocks.iter().filter(|b| b.plateau.dropped.is_none());
    used.filter_map(|b| {
        let residual = Vector3::from(b.residual_coil_nt?.0);
        Some((&b.plateau, axes.map(|axis| axis.dot(&residual))))
    })
    .collect()
}

fn residual_std_nt(lin: &Lin) -> [f64; 3] {
    let residuals = along_sensor_nt(lin);
    let n = residuals.len() as f64;
    std::array::from_fn(|a| {
        let mean = residuals.iter().map(|(_, r)| r[a]).sum::<f64>() / n;
        (residuals.iter().map(|(_, r)| (r[a] - mean).powi(2)).sum::<f64>() / n).sqrt()
    })
}

/// Whether a setting is shown against the field along a coil axis: those along it where the programme goes axis by axis, otherwise all.
fn shown(plateaus: &[(&Plateau, [f64; 3])], coil: usize) -> Vec<bool> {
    let norm = |p: &Plateau| Vector3::from(p.setting.field.0).norm();
    let largest = plateaus.iter().map(|(p, _)| norm(p)).fold(0.0, f64::max);
    let is_none = |p: &Plateau| norm(p) <= NO_FIELD * largest;
    let is_along = |p: &Plateau, axis: usize| p.setting.field.0[axis].abs() >= ALONG * norm(p);
    let applied: Vec<&Plateau> = plateaus.iter().map(|(p, _)| *p).filter(|p| !is_none(p)).collect();
    let on_axes = applied.iter().filter(|p| (0..3).any(|axis| is_along(p, axis))).count();
    let axis_by_axis = on_axes as f64 >= MOSTLY * applied.len() as f64;
    plateaus.iter().map(|(p, _)| !axis_by_axis || is_none(p) || is_along(p, coil)).collect()
}

fn panel_data<'a>(runs: impl Iterator<Item = (&'a Lin, &'a Lin)>, sensor: usize, coil: usize) -> PanelData {
    let (mut before, mut after) = (Vec::new(), Vec::new());
    for (first, second) in runs {
        for (lin, points) in [(first, &mut before), (second, &mut after)] {
            let residuals = along_sensor_nt(lin);
            let shown = shown(&residuals, coil);
            let kept = residuals.iter().zip(shown).filter(|(_, shown)| *shown);
            points.extend(kept.map(|((p, r), _)| [p.setting.field.0[coil], r[sensor]]));
        }
    }
    PanelData { before: bins(&before), after: bins(&after), points: after }
}

/// Means over bins of equal width; the standard errors take the residuals as independent.
fn bins(points: &[[f64; 2]]) -> Vec<BinMean> {
    let low = points.iter().map(|p| p[0]).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|p| p[0]).fold(f64::NEG_INFINITY, f64::max);
    let bin_of = |field: f64| {
        let share = if high > low { (field - low) / (high - low) } else { 0.0 };
        ((share * BINS as f64) as usize).min(BINS - 1)
    };
    let mut members: Vec<Vec<[f64; 2]>> = vec![Vec::new(); BINS];
    points.iter().for_each(|p| members[bin_of(p[0])].push(*p));
    members
        .into_iter()
        .filter(|m| !m.is_empty())
        .map(|m| {
            let n = m.len() as f64;
            let mean = |i: usize| m.iter().map(|p| p[i]).sum::<f64>() / n;
            let squares: f64 = m.iter().map(|p| (p[1] - mean(1)).powi(2)).sum();
            let std_nt = (m.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt());
            BinMean { field_nt: mean(0), residual_nt: mean(1), std_nt, count: m.len() }
        })
        .collect()
}
