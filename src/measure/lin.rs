//! The linear calibration of one run: `B_r = A B_c + Σ p_k τ^k` over plateau means, `Φ = A⁻¹`, and its split.

mod refusal;

pub use refusal::LinError;

use crate::data::calibration::{Angles, LinearQuality, LinearStd, LinearValidity, Matrices, OffsetTrend, PlateauNoise, Setup};
use crate::data::envelope::Column;
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Drop, LEAST_COVERAGE, Plateau, Plateaus, Settling};
use crate::data::result::{Covariance, Summary};
use crate::data::run::{Kind, Run};
use crate::data::units::{COMPONENTS, FieldCoil};
use crate::files::parameter::{Convention, Cpf};
use crate::fit::statistics::{extremes, median};
use crate::fit::{DenseNoise, FitError, Limits, Propagated, Robust, Solution, linear, propagate, robust};
use crate::measure::{linearise, structure};
use crate::model::campaign::Instructions;
use crate::model::facility::Facility;
use crate::model::linearisation::Linearisation;
use crate::model::position::Position;
use crate::model::sensor::{Linear, Split, SplitError, misplaced_axes, split};
use crate::record::baseline::Baseline;
use crate::record::conditions::{self, Temperatures};
use crate::record::known::{self, Applied, Known};
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::Serialize;

/// How a linear calibration is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Order of the offset trend, 0 to 2; `None` takes that of the campaign, or 2.
    pub trend_order: Option<usize>,
    /// Largest magnitude of the field along a nominal sensor axis, nT, beside those of the campaign.
    pub max_field_nt: [Option<f64>; 3],
    /// Give outlying plateaus less weight.
    pub robust: bool,
    /// Settling after a step.
    pub settling: Settling,
    /// Least part of the expected samples of a plateau.
    pub least_coverage: f64,
    /// Go on when a sensitivity is far from its nominal value.
    pub allow_gain: bool,
    /// Go on when the readings do not follow the settings.
    pub allow_mismatch: bool,
    /// The facility that turns settings into the reference field; `None` takes the settings as the field.
    pub facility: Option<Facility>,
    /// The polynomials that linearise the readings; `None` takes the readings as they are.
    pub linearisation: Option<Linearisation>,
    /// Known effects, which are taken off the readings.
    pub model: Option<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            trend_order: None,
            max_field_nt: [None; 3],
            robust: false,
            settling: Settling::Found,
            least_coverage: LEAST_COVERAGE,
            allow_gain: false,
            allow_mismatch: false,
            facility: None,
            linearisation: None,
            model: None,
        }
    }
}

/// Largest condition number of the design with columns scaled to one. A programme that drives the three axes has less than ten; at
/// this value the uncertainty of a sensitivity is four orders worse than the same programme could give.
const MOST_CONDITION: f64 = 1e4;
/// A sensitivity outside this factor of the nominal conversion means a wrong unit or factor.
const PLAUSIBLE_GAIN: f64 = 1.5;
/// Least part of the variance of a component that the applied field must explain.
const LEAST_EXPLAINED: f64 = 0.99;
/// A residual scatter of this many times the standard error of the plateau means is not noise of the samples.
const LACK_OF_FIT: f64 = 10.0;
/// A residual of this many robust standard deviations is an outlier.
const OUTLIER: f64 = 8.0;
/// Order of the offset trend where nothing else is said, as in the campaign of 2013.
const DEFAULT_ORDER: usize = 2;

/// One plateau in the light of the fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Block {
    /// The plateau.
    pub plateau: Plateau,
    /// Applied field minus modelled measurement `B_c - Φ B_m`, nT, coil axes; absent without a mean.
    pub residual_coil_nt: Option<FieldCoil>,
    /// Standard error of the plateau mean from the scatter of its samples, taken as independent, carried to coil axes, nT;
    /// absent if the file brings means only.
    pub standard_error_coil_nt: Option<[f64; 3]>,
    /// Weight in a robust fit; 1 otherwise, 0 for plateaus that were not used.
    pub weight: f64,
}

/// A linear calibration with what is needed to judge it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Lin {
    /// The parameters, as in the parameter file.
    pub parameters: Cpf,
    /// What a person should know.
    #[serde(skip)]
    pub notes: Vec<Note>,
    /// Every plateau of the run.
    pub blocks: Vec<Block>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
    /// The plateaus that were given, with settings and readings as they are in the file, for another fit.
    #[serde(skip)]
    pub given: Plateaus,
    /// Extremes of the raw readings, for the figure of the measured data.
    #[serde(skip)]
    pub samples: Option<Vec<Column>>,
}

/// Fits one run.
///
/// # Errors
/// [`LinError`]: the run is refused, with the reason and what to do.
pub fn lin(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Lin, LinError> {
    let header = &run.header;
    if header.kind != Kind::Linearity {
        return Err(LinError::Kind(header.kind));
    }
    let order = options
        .trend_order
        .or_else(|| instructions.offset_trend_order.and_then(|o| usize::try_from(o).ok()))
        .unwrap_or(DEFAULT_ORDER);
    if order > 2 {
        return Err(LinError::Order(order));
    }
    if plateaus.list.is_empty() {
        return Err(LinError::NoPlateaus);
    }
    if plateaus.edge_shift_s.abs() > plateaus.tolerable_shift_s && !options.allow_mismatch {
        return Err(LinError::Edges { shift_s: plateaus.edge_shift_s });
    }
    if plateaus.still_settling {
        return Err(LinError::Unsettled { settling_s: plateaus.settling_s });
    }
    let (position_id, position) = the_position(plateaus, instructions)?;
    let mut list = plateaus.list.clone();
    apply_limits(&mut list, position, &limits_nt(run, instructions, options));
    let mut notes: Vec<Note> = Vec::new();
    let facility =
        options.facility.as_ref().map(|f| conditions::apply_facility(f, run, instructions, &mut list, &mut notes)).transpose()?;
    let known = options.model.as_ref().map(|m| known::apply(m, run, plateaus, &mut list, instructions, &mut notes));
    let linearisation = options.linearisation.as_ref().map(|l| linearise::apply(l, run, &mut list, &mut notes));
    let used: Vec<&Plateau> = list.iter().filter(|p| p.dropped.is_none()).collect();
    let count = 4 + order;
    if used.len() <= count {
        return Err(too_few(&list, used.len(), count));
    }

    let means = Means::of(&used, order);
    let fitted = fit(&used, &means, options.robust)?;
    if !options.allow_mismatch {
        check_followed(&used, &fitted.solution)?;
    }
    let noise = conditions::noise(fitted.for_noise(), &used).map_err(LinError::Fit)?;
    let stacked = stack(&fitted.solution.coefficients);
    let r_nom = position.r_nom();
    let derived = Derived::of(&stacked, &means, &r_nom)?;
    let mut covariance_of_coefficients = noise.covariance();
    if let Some(linearisation) = &options.linearisation {
        covariance_of_coefficients +=
            linearise::carried(linearisation, &means.design().map_err(LinError::Fit)?, &used).map_err(LinError::Fit)?;
    }
    if let Some(known) = &known {
        covariance_of_coefficients += carried(known, &list, &means.design().map_err(LinError::Fit)?).map_err(LinError::Fit)?;
    }
    let uncertain = propagate(
        |x| Derived::of(x, &means, &r_nom).map(|d| d.list()).unwrap_or_else(|_| vec![f64::NAN; Derived::COUNT]),
        &stacked,
        &covariance_of_coefficients,
    )
    .map_err(LinError::Fit)?;
    if !options.allow_gain {
        for (component, sigma) in COMPONENTS.into_iter().zip(derived.split.sigma) {
            if !(1.0 / PLAUSIBLE_GAIN..=PLAUSIBLE_GAIN).contains(&sigma) {
                return Err(LinError::Gain { component, sigma });
            }
        }
    }

    let sensor = Linear::new(derived.split.phi)?;
    let model = |p: &Plateau| -> FieldCoil {
        let modelled = sensor.field(p.mean, means.baseline.at(&stacked, p.t_s()).1);
        FieldCoil(std::array::from_fn(|axis| p.setting.field.0[axis] - modelled.0[axis]))
    };
    let mut weights = fitted.weights.iter();
    let blocks: Vec<Block> = list
        .iter()
        .map(|p| Block {
            residual_coil_nt: p.mean.0.iter().all(|v| v.is_finite()).then(|| model(p)),
            standard_error_coil_nt: standard_error_coil_nt(p, &derived.split.phi),
            weight: if p.dropped.is_none() { weights.next().copied().unwrap_or(1.0) } else { 0.0 },
            plateau: p.clone(),
        })
        .collect();

    let span_s = [
        used.iter().map(|p| p.used_s[0]).fold(f64::INFINITY, f64::min),
        used.iter().map(|p| p.used_s[1]).fold(f64::NEG_INFINITY, f64::max),
    ];
    let temperatures = Temperatures::of(run, instructions, span_s, &mut notes);
    warn_of_axes(&mut notes, &derived.split);
    conditions::warn_of_plateaus(&mut notes, run, plateaus);
    conditions::warn_of_run(&mut notes, run);

    judge_fit(&mut notes, &blocks);
    if !options.robust {
        notes.extend(structure_of(&temperatures, &list, &used, &means, &noise));
    }
    let readings = used.iter().flat_map(|p| p.mean.0).fold(0.0, |a: f64, v| a.max(v.abs()));
    if noise.noise.iter().any(|n| n.std < 1e-12 * readings) {
        let text = "the readings follow the model to the last digit: their scatter does not tell the uncertainties";
        notes.push(Note::new(NoteKind::Method, text));
    }
    let std = |range: std::ops::Range<usize>| uncertain.std.get(range).map_or_else(|| vec![f64::NAN; 9], <[f64]>::to_vec);
    let three = |from: usize| -> [f64; 3] { std(from..from + 3).try_into().unwrap_or([f64::NAN; 3]) };
    let rows_of_std = |from: usize| -> [[f64; 3]; 3] { [three(from), three(from + 3), three(from + 6)] };
    let split = &derived.split;
    let [xi_xy, xi_xz, xi_yz] = split.xi_deg;
    let [lambda_x, mu_y, nu_z] = split.rotation_deg;
    let mut durations: Vec<f64> = used.iter().map(|p| p.setting.t_end_s - p.setting.t_start_s).collect();
    let convention = if linearisation.is_some() { Convention::linearised() } else { Convention::default() };
    let parameters = Cpf {
        convention: if known.is_some() { convention.without_effects() } else { convention },
        run: conditions::head(run, instructions, &temperatures),
        setup: Setup {
            position: position_id,
            position_axes: position.names(),
            field_duration_s: median(&mut durations),
            settling_s: plateaus.settling_s,
            early_end_s: plateaus.early_end_s,
        },
        matrix: Matrices {
            omega_convention: "BepiColombo".to_owned(),
            r_nom: rows(&split.r_nom),
            rho: rows(&split.rho),
            omega: rows(&split.omega),
            sigma: rows(&Matrix3::from_diagonal(&Vector3::from(split.sigma))),
            phi: rows(&split.phi),
            phi_tilde: rows(&split.phi_tilde),
        },
        angle_deg: Angles { xi_xy, xi_xz, xi_yz, lambda_x, mu_y, nu_z },
        offset: OffsetTrend {
            b_or_ent: derived.b_or_ent,
            trend_order: order,
            trend_ent: std::array::from_fn(|a| means.baseline.offsets_ent(&stacked, a).to_vec()),
            tau_span_s: means.span_s,
        },
        quality: LinearQuality {
            blocks_used: used.len(),
            blocks_total: list.len(),
            lost_samples: run.vectors.lost,
            spike_samples: list.iter().map(|p| p.spike_samples).sum(),
            downweighted_blocks: fitted.downweighted,
            condition: fitted.solution.condition,
            degrees_of_freedom: fitted.solution.dof,
            rotation_determinant: split.rho.determinant(),
            raw_std_ent: conditions::raw_std(&used),
            residual_nt: residual_summary(&blocks),
        },
        std: LinearStd {
            sigma: three(Derived::SIGMA),
            xi_deg: three(Derived::XI),
            b_or_ent: three(Derived::B_OR),
            lambda_mu_nu_deg: rotation_std(split, &uncertain),
            phi: rows_of_std(Derived::PHI),
            phi_tilde: rows_of_std(Derived::PHI_TILDE),
        },
        covariance: covariance(&uncertain),
        noise: PlateauNoise {
            std_ent: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.std)),
            correlated_share: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.share)),
            effective_blocks: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.independent_rows)),
        },
        valid: LinearValidity {
            field_coil_nt: std::array::from_fn(|axis| {
                let fields = used.iter().map(|p| p.setting.field.0[axis]);
                fields.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], b| [low.min(b), high.max(b)])
            }),
            temperature_degc: temperatures.sensor_range_degc(),
            time_s: span_s,
        },
        conditions: temperatures.conditions.clone(),
        facility,
        linearisation,
        model: known.map(|k| k.part),
        dropped: conditions::dropped(&list),
        warnings: notes.iter().map(Note::to_string).collect(),
    };
    Ok(Lin { parameters, notes, blocks, temperatures, given: plateaus.clone(), samples: None })
}

/// What the uncertainty of known effects adds to the covariance of all coefficients, parameter j of component a at `a * p + j`. The
/// parameters of the effects are taken as independent of each other.
fn carried(known: &Applied, list: &[Plateau], design: &linear::Design) -> Result<DMatrix<f64>, FitError> {
    let places: Vec<usize> = (0..list.len()).filter(|i| list[*i].dropped.is_none()).collect();
    let count = design.names().len();
    let mut covariance = DMatrix::zeros(3 * count, 3 * count);
    for (std, values) in &known.carried {
        let rhs = DMatrix::from_fn(places.len(), 3, |i, a| std * values[places[i]][a]);
        let moved = linear::solve(design, &rhs, None, &Limits::default())?.coefficients;
        let stacked = nalgebra::DVector::from_vec(stack(&moved));
        covariance += &stacked * stacked.transpose();
    }
    Ok(covariance)
}

/// Whether the residuals depend on something that the model does not have.
fn structure_of(
    temperatures: &Temperatures,
    list: &[Plateau],
    used: &[&Plateau],
    means: &Means,
    noise: &DenseNoise,
) -> Option<Note> {
    let columns = means.baseline.columns(&means.fields_nt, &means.t_s);
    structure::note(&structure::Rows::of(list, used, &temperatures.sensor, &columns, noise))
}

pub(super) fn the_position(plateaus: &Plateaus, instructions: &Instructions) -> Result<(u32, Position), LinError> {
    match plateaus.positions().as_slice() {
        [id] => instructions.position(*id).map(|p| (*id, p)).ok_or(LinError::UnknownPosition(*id)),
        several => Err(LinError::Positions(several.iter().map(u32::to_string).collect::<Vec<_>>().join(", "))),
    }
}

fn limits_nt(run: &Run, instructions: &Instructions, options: &Options) -> [Option<f64>; 3] {
    let mut limits = instructions.limits_nt(&run.header);
    for (limit, own) in limits.iter_mut().zip(options.max_field_nt) {
        // What the analyst asks for now replaces what the campaign says.
        *limit = own.or(*limit);
    }
    limits
}

pub(super) fn apply_limits(list: &mut [Plateau], position: Position, limits_nt: &[Option<f64>; 3]) {
    for plateau in list.iter_mut().filter(|p| p.dropped.is_none()) {
        let along = position.to_nominal(plateau.setting.field.0);
        plateau.dropped = (0..3).find_map(|component| {
            let limit_nt = limits_nt[component]?;
            (along[component].abs() > limit_nt).then_some(Drop::FieldLimit { component, limit_nt })
        });
    }
}

fn too_few(list: &[Plateau], used: usize, parameters: usize) -> LinError {
    let mut reasons: Vec<(String, usize)> = Vec::new();
    for reason in list.iter().filter_map(|p| p.dropped.as_ref()).map(Drop::to_string) {
        match reasons.iter_mut().find(|(r, _)| *r == reason) {
            Some((_, n)) => *n += 1,
            None => reasons.push((reason, 1)),
        }
    }
    reasons.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    let unsettled = reasons.first().is_some_and(|(reason, _)| *reason == Drop::NoSamples.to_string());
    let reasons = match reasons.as_slice() {
        [] => "none".to_owned(),
        some => some.iter().take(3).map(|(reason, n)| format!("{n} x {reason}")).collect::<Vec<_>>().join(", "),
    };
    LinError::TooFew { used, parameters, dropped: list.len() - used, total: list.len(), reasons, unsettled }
}

/// The means of a fit with the model that is fitted to them.
struct Means {
    baseline: Baseline,
    fields_nt: Vec<[f64; 3]>,
    t_s: Vec<f64>,
    span_s: [f64; 2],
}

impl Means {
    /// Of the plateaus that are used; tau runs from -1 to +1 over their middles.
    fn of(used: &[&Plateau], order: usize) -> Self {
        let t_s: Vec<f64> = used.iter().map(|p| p.t_s()).collect();
        let span_s = extremes(t_s.iter().copied());
        let fields_nt = used.iter().map(|p| p.setting.field.0).collect();
        Self { baseline: Baseline::in_time(span_s, order), fields_nt, t_s, span_s }
    }

    fn design(&self) -> Result<linear::Design, FitError> {
        self.baseline.design(&self.fields_nt, &self.t_s)
    }

    /// Mean `B_or` over the plateaus, enT.
    fn mean_b_or_ent(&self, stacked: &[f64]) -> [f64; 3] {
        let mean =
            |k: usize| self.t_s.iter().map(|t| self.baseline.mapped(*t).powi(k as i32)).sum::<f64>() / self.t_s.len() as f64;
        let powers: Vec<f64> = (0..=self.baseline.offset_order()).map(mean).collect();
        std::array::from_fn(|a| self.baseline.offsets_ent(stacked, a).iter().zip(&powers).map(|(c, m)| c * m).sum())
    }
}

struct Fitted {
    solution: Solution,
    pseudo: Option<Solution>,
    weights: Vec<f64>,
    downweighted: Option<usize>,
}

impl Fitted {
    /// The solution whose residuals show the noise.
    fn for_noise(&self) -> &Solution {
        self.pseudo.as_ref().unwrap_or(&self.solution)
    }
}

fn fit(used: &[&Plateau], means: &Means, is_robust: bool) -> Result<Fitted, LinError> {
    let rhs = DMatrix::from_fn(used.len(), 3, |row, component| used[row].mean.0[component]);
    let limits = Limits { max_condition: MOST_CONDITION };
    let explain = |error: FitError| match error {
        FitError::Undetermined { parameters, condition } => LinError::Undetermined { parameters, condition },
        other => LinError::Fit(other),
    };
    let design = means.design().map_err(explain)?;
    if is_robust {
        let Robust { solution, pseudo, weights, downweighted, .. } =
            robust::fit(&design, &rhs, None, &limits).map_err(explain)?;
        Ok(Fitted { solution, pseudo: Some(pseudo), weights, downweighted: Some(downweighted) })
    } else {
        let solution = linear::solve(&design, &rhs, None, &limits).map_err(explain)?;
        Ok(Fitted { solution, pseudo: None, weights: vec![1.0; used.len()], downweighted: None })
    }
}

/// A component whose variance the field does not explain belongs to other settings, or is stuck.
fn check_followed(used: &[&Plateau], solution: &Solution) -> Result<(), LinError> {
    for (component, name) in COMPONENTS.into_iter().enumerate() {
        let values: Vec<f64> = used.iter().map(|p| p.mean.0[component]).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let total: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let left: f64 = solution.residuals.column(component).norm_squared();
        if total == 0.0 {
            return Err(LinError::Stuck { component: name, reading_ent: mean });
        }
        let explained = 1.0 - left / total;
        if explained < LEAST_EXPLAINED {
            return Err(LinError::Unrelated { component: name, explained });
        }
    }
    Ok(())
}

fn stack(coefficients: &DMatrix<f64>) -> Vec<f64> {
    coefficients.column_iter().flat_map(|column| column.iter().copied().collect::<Vec<f64>>()).collect()
}

/// Everything that follows from the coefficients, in one list, so that one propagation gives all uncertainties.
struct Derived {
    split: Split,
    b_or_ent: [f64; 3],
}

impl Derived {
    const PHI: usize = 0;
    const B_OR: usize = 9;
    const SIGMA: usize = 12;
    const XI: usize = 15;
    const ROTATION: usize = 18;
    const RHO: usize = 21;
    const PHI_TILDE: usize = 30;
    const COUNT: usize = 39;

    fn of(stacked: &[f64], means: &Means, r_nom: &Matrix3<f64>) -> Result<Derived, SplitError> {
        let response = means.baseline.responses(stacked).first().copied().ok_or(SplitError::Singular)?;
        let phi = response.try_inverse().ok_or(SplitError::Singular)?;
        Ok(Derived { split: split(&phi, r_nom)?, b_or_ent: means.mean_b_or_ent(stacked) })
    }

    fn list(&self) -> Vec<f64> {
        let s = &self.split;
        let matrix = |m: &Matrix3<f64>| m.transpose().iter().copied().collect::<Vec<f64>>();
        [
            matrix(&s.phi),
            self.b_or_ent.to_vec(),
            s.sigma.to_vec(),
            s.xi_deg.to_vec(),
            s.rotation_deg.to_vec(),
            matrix(&s.rho),
            matrix(&s.phi_tilde),
        ]
        .concat()
    }
}

/// First order, except where an axis is turned by less than its uncertainty: there the angle behaves like a length, and the root
/// mean square of its two components is taken.
fn rotation_std(split: &Split, uncertain: &Propagated) -> [f64; 3] {
    std::array::from_fn(|i| {
        let variance = |row: usize| uncertain.std.get(Derived::RHO + 3 * row + i).map_or(f64::NAN, |s| s * s);
        let aside: f64 = (0..3).filter(|row| *row != i).map(variance).sum();
        let floor = (0.5 * aside).sqrt().to_degrees();
        match uncertain.std.get(Derived::ROTATION + i) {
            Some(std) if split.rotation_deg[i] > 3.0 * floor && std.is_finite() => *std,
            _ => floor,
        }
    })
}

fn covariance(uncertain: &Propagated) -> Covariance {
    let axes = ["x", "y", "z"];
    let mut parameters: Vec<String> = axes.iter().flat_map(|r| axes.iter().map(move |c| format!("phi_{r}{c}"))).collect();
    parameters.extend(axes.iter().map(|c| format!("b_or_{c}")));
    let mut units = vec!["nT/enT".to_owned(); 9];
    units.extend(vec!["enT".to_owned(); 3]);
    let matrix = (0..12).map(|row| (0..12).map(|column| uncertain.covariance[(row, column)]).collect()).collect();
    Covariance { parameters, units, matrix }
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    // Adding zero turns a negative zero into a positive one.
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)] + 0.0))
}

fn residual_summary(blocks: &[Block]) -> Summary {
    let used: Vec<[f64; 3]> =
        blocks.iter().filter(|b| b.plateau.dropped.is_none()).filter_map(|b| b.residual_coil_nt).map(|r| r.0).collect();
    let n = used.len() as f64;
    Summary {
        std: std::array::from_fn(|a| {
            let mean = used.iter().map(|r| r[a]).sum::<f64>() / n;
            (used.iter().map(|r| (r[a] - mean).powi(2)).sum::<f64>() / n).sqrt()
        }),
        max: std::array::from_fn(|a| used.iter().map(|r| r[a]).fold(f64::NEG_INFINITY, f64::max)),
        min: std::array::from_fn(|a| used.iter().map(|r| r[a]).fold(f64::INFINITY, f64::min)),
    }
}

/// Standard error of a plateau mean carried to coil axes, nT.
fn standard_error_coil_nt(plateau: &Plateau, phi: &Matrix3<f64>) -> Option<[f64; 3]> {
    let (std_ent, count) = (plateau.std_ent?, plateau.count.filter(|n| *n > 0)?);
    let variance_ent2 = std_ent.map(|s| s * s / count as f64);
    Some(std::array::from_fn(|axis| (0..3).map(|c| phi[(axis, c)].powi(2) * variance_ent2[c]).sum::<f64>().sqrt()))
}

/// Says where the residuals are larger than what the samples scatter, and which plateaus stand out.
fn judge_fit(notes: &mut Vec<Note>, blocks: &[Block]) {
    let used: Vec<&Block> = blocks.iter().filter(|b| b.plateau.dropped.is_none()).collect();
    for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
        let residuals: Vec<f64> = used.iter().filter_map(|b| b.residual_coil_nt).map(|r| r.0[axis]).collect();
        let errors: Option<Vec<f64>> = used.iter().map(|b| b.standard_error_coil_nt.map(|e| e[axis])).collect();
        let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        let scatter = rms(&residuals);
        if let Some(expected) = errors.map(|e| rms(&e)).filter(|e| *e > 0.0 && scatter > LACK_OF_FIT * *e) {
            let text = format!(
                "the {name} residuals scatter by {scatter:.3} nT where the samples of the plateaus let expect {expected:.3} nT; \
                 the model lacks something, or plateaus are disturbed"
            );
            notes.push(Note::new(NoteKind::Fit, text).about(name));
        }
        let mut magnitudes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        let robust_std = median(&mut magnitudes) / 0.6745;
        let outliers: Vec<String> = used
            .iter()
            .filter(|b| b.residual_coil_nt.is_some_and(|r| robust_std > 0.0 && r.0[axis].abs() > OUTLIER * robust_std))
            .map(|b| (b.plateau.index + 1).to_string())
            .collect();
        if !outliers.is_empty() {
            let text = format!("blocks {} stand out in {name} by more than {OUTLIER} standard deviations", outliers.join(", "));
            notes.push(Note::new(NoteKind::Fit, text).about(name).with_remedy("look at them, or use --robust"));
        }
    }
}

fn warn_of_axes(notes: &mut Vec<Note>, split: &Split) {
    let misplaced = misplaced_axes(split);
    if split.rho.determinant() < 0.0 {
        let text = "the sensor axes are left-handed against the position; two components are swapped or one has the wrong sign, and no rotation leads there";
        notes.push(Note::new(NoteKind::Axes, text));
    }
    for (component, along) in misplaced {
        let name = COMPONENTS.get(component).copied().unwrap_or("?");
        let text = format!("component {name} looks along the nominal {along} axis");
        notes.push(Note::new(NoteKind::Axes, text).about(name).with_remedy("check the position, the wiring and the signs"));
    }
}
