//! Temperature polynomials across the runs of a sensor in one mode (BC-MAG-TR-0085 sections 12 and 13).

use crate::data::units::COMPONENTS;
use crate::files::campaign::file::{MOST_THERMAL_ORDER, ThermalEntry};
use crate::files::parameter::{
    Body, JointPart, ModelError, Point, QuantityPart, ResidualField, Rotation, Taf, ThermalConvention, ThermalHead, Tof, Tpf,
    Values,
};
use crate::fit::order::{self, Chosen, Reason};
use crate::fit::{FitError, Limits, NORMAL_95, student_95};
use crate::measure::joint::{self, Joint, JointError, JointPlateau, JointRun};
use crate::measure::lin::Lin;
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor::compose;
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;
use thiserror::Error;

/// Runs that are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Order per quantity or family of quantities, where given.
    pub orders: Vec<(String, usize)>,
    /// The runs by their ids, which is in time order.
    pub points: Vec<Point>,
    /// Runs of the same sensor and mode that state no sensor temperature: their kind and file.
    pub without_temperature: Vec<(Kind, String)>,
}

/// Which analysis the runs of a group come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Kind {
    /// Linear calibrations: TPF.
    Lin,
    /// Offset measurements: TOF.
    Offset,
    /// Frequency measurements: TAF.
    Freq,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 3] = [Kind::Lin, Kind::Offset, Kind::Freq];

    fn of(values: &Values) -> Kind {
        match values {
            Values::Lin { .. } => Kind::Lin,
            Values::Offset { .. } => Kind::Offset,
            Values::Freq { .. } => Kind::Freq,
        }
    }

    /// What the runs are called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Kind::Lin => "linearity",
            Kind::Offset => "offset",
            Kind::Freq => "frequency",
        }
    }
}

/// Why a group has no polynomials.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ThermalError {
    /// Not enough to compare.
    #[error("its {kind} runs ({files}) are at {temperatures} different temperature, polynomials need two")]
    TooFew {
        /// What the runs are.
        kind: &'static str,
        /// Their parameter files.
        files: String,
        /// Different temperatures.
        temperatures: usize,
    },
    /// A polynomial cannot be fitted.
    #[error("{quantity}: {error}")]
    Fit {
        /// Quantity.
        quantity: String,
        /// Why.
        error: FitError,
    },
}

impl ThermalError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            ThermalError::TooFew { .. } => "measure at further temperatures, or check the temperature channel of the runs",
            ThermalError::Fit { error: FitError::OrderTooHigh { .. } | FitError::TooFewPoints { .. }, .. } => {
                "give a lower order for it with --order or in campaign.toml"
            }
            ThermalError::Fit { .. } => "check the values of the runs",
        }
    }
}

/// A polynomial with the runs it rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// As in the parameter file, `sigma_x`.
    pub name: String,
    /// Component or pair of components, `x` or `xy`.
    pub component: String,
    /// Unit.
    pub unit: &'static str,
    /// Runs that count, as indices into the group.
    pub runs: Vec<usize>,
    /// Temperature, value and standard uncertainty (nan if not known) of those runs.
    pub points: Vec<[f64; 3]>,
    /// Standard uncertainties that make an interval of 95 %.
    pub factor_95: f64,
    /// Coefficients of the polynomial, lowest order first.
    pub coefficients: Vec<f64>,
    /// Temperature, value and standard uncertainty of the polynomial at even steps over its range.
    pub band: Vec<[f64; 3]>,
    /// The polynomial of the joint fit at the same temperatures, if there is one.
    pub joint: Vec<[f64; 3]>,
}

/// The files of a group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum File {
    /// Of linear calibrations.
    Tpf(Box<Tpf>),
    /// Of offset measurements.
    Tof(Box<Tof>),
    /// Of frequency measurements.
    Taf(Box<Taf>),
}

impl File {
    /// What all kinds state.
    #[must_use]
    pub fn head(&self) -> &ThermalHead {
        match self {
            File::Tpf(file) => &file.head,
            File::Tof(file) => &file.head,
            File::Taf(file) => &file.head,
        }
    }

    /// Name of the file.
    #[must_use]
    pub fn file_name(&self) -> String {
        match self {
            File::Tpf(file) => file.file_name(),
            File::Tof(file) => file.file_name(),
            File::Taf(file) => file.file_name(),
        }
    }
}

/// The thermal analysis of one kind of runs of one group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Thermal {
    /// Which runs.
    pub kind: Kind,
    /// What goes into the file.
    pub file: File,
    /// The polynomials with their runs, in the order of the file.
    pub curves: Vec<Curve>,
}

/// Runs within this range are at one temperature, °C.
pub(super) const SAME_DEGC: f64 = 0.5;
/// Points of a band.
const BAND: usize = 121;

/// Sorts runs into groups: those that the campaign names, or one per sensor and mode. Runs without a sensor temperature make none. Orders given on the command line come first.
#[must_use]
pub fn groups(points: &[Point], entries: &[ThermalEntry], orders: &[(String, usize)]) -> Vec<Group> {
    let (mut points, without): (Vec<&Point>, Vec<&Point>) =
        points.iter().partition(|p| p.run.temperature_degc.is_some_and(f64::is_finite));
    points.sort_by(|a, b| (&a.run.id, &a.file).cmp(&(&b.run.id, &b.file)));
    let mut keys: Vec<(&str, &str)> = points.iter().map(|p| (p.run.sensor.as_str(), p.run.mode.as_str())).collect();
    keys.sort_unstable();
    keys.dedup();
    let mut groups = Vec::new();
    for (sensor, mode) in keys {
        let own = || points.iter().filter(move |p| (p.run.sensor.as_str(), p.run.mode.as_str()) == (sensor, mode));
        let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
        let entries: Vec<&ThermalEntry> =
            entries.iter().filter(|e| applies(&e.sensor, sensor) && applies(&e.mode, mode)).collect();
        let group = |orders: Vec<(String, usize)>, points: Vec<Point>| Group {
            sensor: sensor.to_owned(),
            mode: mode.to_owned(),
            orders,
            points,
            without_temperature: without
                .iter()
                .filter(|p| (p.run.sensor.as_str(), p.run.mode.as_str()) == (sensor, mode))
                .map(|p| (Kind::of(&p.values), p.file.clone()))
                .collect(),
        };
        if entries.is_empty() {
            groups.push(group(orders.iter().rev().cloned().collect(), own().map(|p| (*p).clone()).collect()));
        }
        for entry in entries {
            let listed = |p: &&&Point| entry.runs.as_ref().is_none_or(|runs| runs.contains(&p.run.id));
            let all =
                orders.iter().rev().cloned().chain(entry.orders.iter().map(|(name, order)| (name.clone(), *order as usize)));
            groups.push(group(all.collect(), own().filter(listed).map(|p| (*p).clone()).collect()));
        }
    }
    groups.retain(|g| !g.points.is_empty());
    groups
}

impl Group {
    /// Runs of a kind.
    fn of_kind(&self, kind: Kind) -> Vec<&Point> {
        self.points.iter().filter(|p| Kind::of(&p.values) == kind).collect()
    }

    /// The order given for a quantity, by its own name before that of its family.
    fn order(&self, quantity: &str) -> Option<usize> {
        let find = |name: &str| self.orders.iter().find(|(n, _)| n == name).map(|(_, order)| *order);
        let family = quantity.rsplit_once('_').map_or(quantity, |(family, _)| family);
        find(quantity).or_else(|| find(family))
    }

    /// Whether there are runs of a kind at all.
    #[must_use]
    pub fn has(&self, kind: Kind) -> bool {
        self.points.iter().any(|p| Kind::of(&p.values) == kind)
    }
}

/// One quantity of the runs before its polynomial is fitted.
struct Quantity {
    name: String,
    component: String,
    unit: &'static str,
    /// Value and standard uncertainty per run; nan where there is none.
    values: Vec<(f64, f64)>,
    may_be_missing: bool,
}

/// The polynomials of one kind of runs of a group. `runs` are the linear calibrations with their plateaus, as far as they are at hand;
/// a joint fit needs them.
///
/// # Errors
/// [`ThermalError`]: too few temperatures, or an order that they do not carry.
pub fn thermal(group: &Group, kind: Kind, runs: &[&Lin], with_joint: bool) -> Result<Thermal, ThermalError> {
    let points = group.of_kind(kind);
    let without: Vec<&str> =
        group.without_temperature.iter().filter(|(k, _)| *k == kind).map(|(_, file)| file.as_str()).collect();
    let mut warnings: Vec<String> =
        without.iter().map(|file| format!("{file} states no sensor temperature and was left out")).collect();
    let temperatures: Vec<f64> = points.iter().filter_map(|p| p.run.temperature_degc).collect();
    let different = different_temperatures(&temperatures);
    if different < 2 {
        let files: Vec<&str> = points.iter().map(|p| p.file.as_str()).collect();
        let without = if without.is_empty() { String::new() } else { format!("; without one: {}", without.join(", ")) };
        return Err(ThermalError::TooFew { kind: kind.name(), files: files.join(", ") + &without, temperatures: different });
    }
    let without_model: Vec<&str> = points.iter().filter(|p| !has_model(&p.values)).map(|p| p.file.as_str()).collect();
    let corner_of_model = without_model.is_empty();
    if kind == Kind::Freq && !corner_of_model && without_model.len() < points.len() {
        warnings.push(format!(
            "f_3dB by interpolation (igep) is used for all runs: {} hold none of a model",
            without_model.join(", ")
        ));
    }
    let mut curves = Vec::new();
    let mut fitted = Vec::new();
    for quantity in quantities(&points, kind, corner_of_model) {
        match fit(group, &quantity, &points, &temperatures, &mut warnings)? {
            Some((curve, part, polynomial)) => {
                curves.push(curve);
                fitted.push((part, polynomial));
            }
            None => warnings.push(format!("{} is not determined in enough of the runs", quantity.name)),
        }
    }
    let mut channels: Vec<&str> = points.iter().filter_map(|p| p.channel.as_deref()).collect();
    channels.sort_unstable();
    channels.dedup();
    if channels.len() > 1 {
        warnings.push(format!("the runs took their temperature from different channels: {}", channels.join(", ")));
    }
    let coefficients = |name: &str| -> Vec<f64> {
        fitted.iter().find(|(part, _)| part.name == name).map_or_else(Vec::new, |(_, p)| p.coefficients.clone())
    };
    let joint = if with_joint && kind == Kind::Lin {
        joint_fit(&points, runs, &fitted).map_err(|error| warnings.push(format!("no joint fit: {error}"))).ok()
    } else {
        None
    };
    for (curve, polynomial) in curves.iter_mut().zip(joint.iter().flat_map(|j| &j.polynomials)) {
        curve.joint = band(polynomial.valid_degc, |t| polynomial.evaluate(t));
    }
    // Where all polynomials of the file hold.
    let valid_degc = fitted.iter().fold([f64::NEG_INFINITY, f64::INFINITY], |[low, high], (part, _)| {
        [low.max(part.valid_degc[0]), high.min(part.valid_degc[1])]
    });
    let residual_field = residual_field(&points, &mut warnings);
    let head = ThermalHead {
        used: points.iter().map(|p| p.file.clone()).collect(),
        channel: channels.first().map_or_else(|| "not stated".to_owned(), |c| (*c).to_owned()),
        valid_degc,
        sensor: group.sensor.clone(),
        mode: group.mode.clone(),
        runs: points.iter().map(|p| p.run.id.clone()).collect(),
        temperature_degc: temperatures,
        coil_temperature_degc: points.iter().map(|p| p.run.coil_temperature_degc.unwrap_or(f64::NAN)).collect(),
        convention: ThermalConvention::default(),
        covariance: fitted.iter().map(|(part, p)| (part.name.clone(), rows(&p.covariance))).collect(),
        quantity: fitted.iter().map(|(part, _)| part.clone()).collect(),
        warnings,
    };
    let file = match kind {
        Kind::Lin => File::Tpf(Box::new(Tpf {
            sigma_x: coefficients("sigma_x"),
            sigma_y: coefficients("sigma_y"),
            sigma_z: coefficients("sigma_z"),
            xi_xy: coefficients("xi_xy"),
            xi_xz: coefficients("xi_xz"),
            xi_yz: coefficients("xi_yz"),
            b_or_x: coefficients("b_or_x"),
            b_or_y: coefficients("b_or_y"),
            b_or_z: coefficients("b_or_z"),
            rotation: rotation(&points),
            model_error: model_error(&points, runs, &fitted),
            joint: joint.as_ref().map(joint_part),
            sweep: None,
            head,
        })),
        Kind::Offset => File::Tof(Box::new(Tof {
            b_off_x: coefficients("b_off_x"),
            b_off_y: coefficients("b_off_y"),
            b_off_z: coefficients("b_off_z"),
            residual_field,
            head,
        })),
        Kind::Freq => {
            let f_s: Vec<(f64, f64)> = points
                .iter()
                .map(|p| match &p.values {
                    Values::Freq { f_s_hz, f_s_std_hz, .. } => (f_s_hz.unwrap_or(f64::NAN), f_s_std_hz.unwrap_or(f64::NAN)),
                    _ => (f64::NAN, f64::NAN),
                })
                .collect();
            let mean = |values: Vec<f64>| {
                let known: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
                (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
            };
            File::Taf(Box::new(Taf {
                f_3db_x: coefficients("f_3db_x"),
                f_3db_y: coefficients("f_3db_y"),
                f_3db_z: coefficients("f_3db_z"),
                mean_sample_rate_hz: mean(f_s.iter().map(|v| v.0).collect()),
                mean_std_sample_rate_hz: mean(f_s.iter().map(|v| v.1).collect()),
                corner: if corner_of_model { "model" } else { "igep" }.to_owned(),
                f_s_hz: f_s.iter().map(|v| v.0).collect(),
                f_s_std_hz: f_s.iter().map(|v| v.1).collect(),
                head,
            }))
        }
    };
    Ok(Thermal { kind, file, curves })
}

fn has_model(values: &Values) -> bool {
    matches!(values, Values::Freq { model_hz: Some(hz), .. } if hz.iter().any(|v| v.is_finite()))
}

/// Number of temperatures that differ by more than runs at one temperature do.
fn different_temperatures(temperatures_degc: &[f64]) -> usize {
    let mut sorted = temperatures_degc.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut last = f64::NEG_INFINITY;
    sorted
        .into_iter()
        .filter(|t| {
            let new = *t > last + SAME_DEGC;
            last = if new { *t } else { last };
            new
        })
        .count()
}

/// Value and standard uncertainty of the three components of a family in one run.
type Triple = ([f64; 3], Option<[f64; 3]>);

/// The quantities of a kind in the order of the file.
fn quantities(points: &[&Point], kind: Kind, corner_of_model: bool) -> Vec<Quantity> {
    let pairs = ["xy", "xz", "yz"];
    let triple = |family: &str, components: [&str; 3], unit: &'static str, get: &dyn Fn(&Values) -> Triple| {
        let all: Vec<Triple> = points.iter().map(|p| get(&p.values)).collect();
        (0..3)
            .map(|i| Quantity {
                name: format!("{family}_{}", components[i]),
                component: components[i].to_owned(),
                unit,
                values: all.iter().map(|(value, std)| (value[i], std.map_or(f64::NAN, |s| s[i]))).collect(),
                may_be_missing: kind != Kind::Lin,
            })
            .collect::<Vec<Quantity>>()
    };
    const NONE: Triple = ([f64::NAN; 3], None);
    match kind {
        Kind::Lin => {
            let part = |which: usize| {
                move |values: &Values| match values {
                    Values::Lin { sigma, xi_deg, b_or_ent, std, .. } => ([*sigma, *xi_deg, *b_or_ent][which], std[which]),
                    _ => NONE,
                }
            };
            [
                triple("sigma", COMPONENTS, "nT/enT", &part(0)),
                triple("xi", pairs, "deg", &part(1)),
                triple("b_or", COMPONENTS, "enT", &part(2)),
            ]
            .into_iter()
            .flatten()
            .collect()
        }
        Kind::Offset => triple("b_off", COMPONENTS, "enT", &|values| match values {
            Values::Offset { offset_ent, std, .. } => (*offset_ent, *std),
            _ => NONE,
        }),
        Kind::Freq => triple("f_3db", COMPONENTS, "Hz", &|values| match values {
            Values::Freq { model_hz: Some(hz), model_std_hz, .. } if corner_of_model => (*hz, *model_std_hz),
            Values::Freq { igep_hz: Some(hz), .. } => (*hz, None),
            _ => NONE,
        }),
    }
}

type Fitted = (Curve, QuantityPart, TemperaturePolynomial);

/// The polynomial of one quantity; `None` where too few runs determine it and it may be missing.
fn fit(
    group: &Group,
    quantity: &Quantity,
    points: &[&Point],
    temperatures: &[f64],
    warnings: &mut Vec<String>,
) -> Result<Option<Fitted>, ThermalError> {
    let runs: Vec<usize> = (0..temperatures.len()).filter(|i| quantity.values[*i].0.is_finite()).collect();
    let x: Vec<f64> = runs.iter().map(|i| temperatures[*i]).collect();
    let y: Vec<f64> = runs.iter().map(|i| quantity.values[*i].0).collect();
    let std: Vec<f64> = runs.iter().map(|i| quantity.values[*i].1).collect();
    let usable = |s: &f64| s.is_finite() && *s > 0.0;
    let known = std.iter().all(usable);
    if !known && std.iter().any(usable) {
        warnings.push(format!("{}: not all runs state an uncertainty; all count alike", quantity.name));
    }
    let different = different_temperatures(&x);
    if different < 2 {
        let error = FitError::TooFewPoints { order: 1, distinct: different };
        return if quantity.may_be_missing {
            Ok(None)
        } else {
            Err(ThermalError::Fit { quantity: quantity.name.clone(), error })
        };
    }
    let wanted = group.order(&quantity.name);
    let highest = (MOST_THERMAL_ORDER as usize).min(different.saturating_sub(1));
    let chosen = match wanted {
        Some(order) if order > highest => Err(FitError::TooFewPoints { order, distinct: different }),
        wanted => order::choose(&x, &y, known.then_some(std.as_slice()), highest, wanted, &Limits::default()),
    }
    .map_err(|error| ThermalError::Fit { quantity: quantity.name.clone(), error })?;
    let valid_degc = [x.iter().copied().fold(f64::INFINITY, f64::min), x.iter().copied().fold(f64::NEG_INFINITY, f64::max)];
    if runs.len() < points.len() {
        warnings.push(format!(
            "{}: {} of {} runs determine it, {:.1} to {:.1} °C",
            quantity.name,
            runs.len(),
            points.len(),
            valid_degc[0],
            valid_degc[1]
        ));
    }
    // Uncertainties that the scatter of a few runs tells want wider intervals than known ones.
    let degrees_of_freedom = chosen.polynomial.dof;
    let factor_95 = if known && chosen.inflation == 1.0 { NORMAL_95 } else { student_95(degrees_of_freedom) };
    let polynomial = TemperaturePolynomial {
        coefficients: chosen.polynomial.coefficients.clone(),
        covariance: finite(&chosen.covariance),
        valid_degc,
    };
    let residual = chosen.polynomial.residuals.clone();
    let extreme = |join: fn(f64, f64) -> f64| residual.iter().copied().reduce(join).unwrap_or(f64::NAN);
    if chosen.inflation > 1.0 && known {
        warnings.push(format!(
            "{}: the runs scatter by {:.1} times what their uncertainties let expect; the uncertainty of the polynomial was widened by it",
            quantity.name, chosen.inflation
        ));
    }
    let part = QuantityPart {
        name: quantity.name.clone(),
        unit: quantity.unit.to_owned(),
        runs: runs.iter().map(|i| points[*i].run.id.clone()).collect(),
        valid_degc,
        degrees_of_freedom,
        factor_95,
        order: chosen.order,
        order_by: how(&chosen).to_owned(),
        aicc: chosen.candidates.iter().map(|c| c.aicc.unwrap_or(f64::NAN)).collect(),
        leave_one_out: chosen.candidates.iter().map(|c| c.leave_one_out.unwrap_or(f64::NAN)).collect(),
        value: y.clone(),
        std: if known { std.clone() } else { Vec::new() },
        min_error: extreme(f64::min),
        max_error: extreme(f64::max),
        residual,
        widened: if known { chosen.inflation } else { 1.0 },
    };
    let curve = Curve {
        name: quantity.name.clone(),
        component: quantity.component.clone(),
        unit: quantity.unit,
        points: (0..x.len()).map(|i| [x[i], y[i], if known { std[i] } else { f64::NAN }]).collect(),
        runs,
        factor_95,
        coefficients: polynomial.coefficients.clone(),
        band: band(valid_degc, |t| chosen.evaluate(t)),
        joint: Vec::new(),
    };
    Ok(Some((curve, part, polynomial)))
}

fn how(chosen: &Chosen) -> &'static str {
    match chosen.reason {
        Reason::Given => "given",
        Reason::Exact => "the lowest that leaves only rounding",
        Reason::LeastAicc => "AICc",
        Reason::LeaveOneOut => "leave-one-out error",
        Reason::TooFewPoints => "too few points for more",
    }
}

/// Without a degree of freedom the scatter tells nothing; a file holds no covariance then but zeros would claim certainty.
fn finite(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    if covariance.iter().all(|v| v.is_finite()) { covariance.clone() } else { DMatrix::zeros(0, 0) }
}

pub(super) fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn band(range: [f64; 2], evaluate: impl Fn(f64) -> (f64, f64)) -> Vec<[f64; 3]> {
    (0..BAND)
        .map(|i| {
            let t = range[0] + (range[1] - range[0]) * i as f64 / (BAND - 1) as f64;
            let (value, std) = evaluate(t);
            [t, value, std]
        })
        .collect()
}

fn rotation(points: &[&Point]) -> Rotation {
    let of = |point: &&Point| match &point.values {
        Values::Lin { rotation_deg, rotation_std_deg, .. } => (*rotation_deg, *rotation_std_deg),
        _ => ([f64::NAN; 3], [f64::NAN; 3]),
    };
    let all: Vec<([f64; 3], [f64; 3])> = points.iter().map(of).collect();
    let angle = |i: usize| all.iter().map(|(angle, _)| angle[i]).collect();
    let std = |i: usize| all.iter().map(|(_, std)| std[i]).collect();
    let initial = points.first().and_then(|p| match &p.values {
        Values::Lin { rho, .. } => *rho,
        _ => None,
    });
    Rotation {
        lambda_x_deg: angle(0),
        mu_y_deg: angle(1),
        nu_z_deg: angle(2),
        lambda_x_std_deg: std(0),
        mu_y_std_deg: std(1),
        nu_z_std_deg: std(2),
        initial,
    }
}

fn residual_field(points: &[&Point], warnings: &mut Vec<String>) -> ResidualField {
    let of = |point: &&Point| match &point.values {
        Values::Offset { residual_ent, residual_std, seen_along, .. } => (*residual_ent, *residual_std, seen_along.clone()),
        _ => ([f64::NAN; 3], [f64::NAN; 3], Vec::new()),
    };
    let all: Vec<([f64; 3], [f64; 3], Vec<String>)> = points.iter().map(of).collect();
    let seen_along = all.first().map_or_else(Vec::new, |(.., axes)| axes.clone());
    let other: Vec<&str> =
        points.iter().zip(&all).filter(|(_, (.., axes))| *axes != seen_along).map(|(p, _)| p.run.id.as_str()).collect();
    if !other.is_empty() {
        warnings.push(format!(
            "the residual field of {} was seen along other coil axes than in the first run: its components do not compare",
            other.join(", ")
        ));
    }
    let value = |i: usize| all.iter().map(|(v, ..)| v[i]).collect();
    let std = |i: usize| all.iter().map(|(_, s, _)| s[i]).collect();
    ResidualField {
        x_ent: value(0),
        y_ent: value(1),
        z_ent: value(2),
        x_std_ent: std(0),
        y_std_ent: std(1),
        z_std_ent: std(2),
        seen_along,
    }
}

/// Applied field minus modelled measurement with the polynomials in place of the run's own sensitivities and angles; `None` unless all
/// runs are at hand with their plateaus.
fn model_error(points: &[&Point], runs: &[&Lin], fitted: &[(QuantityPart, TemperaturePolynomial)]) -> Option<ModelError> {
    let mut error = ModelError::default();
    for point in points {
        let lin = runs.iter().find(|lin| lin.parameters.run.id == point.run.id)?;
        let p = &lin.parameters;
        let t = point.run.temperature_degc?;
        let at = |name: &str| fitted.iter().find(|(part, _)| part.name == name).map(|(_, polynomial)| polynomial.evaluate(t).0);
        let three = |names: [&str; 3]| -> Option<[f64; 3]> { Some([at(names[0])?, at(names[1])?, at(names[2])?]) };
        let sigma = three(["sigma_x", "sigma_y", "sigma_z"])?;
        let xi_deg = three(["xi_xy", "xi_xz", "xi_yz"])?;
        let matrix = |rows: &[[f64; 3]; 3]| Matrix3::from_fn(|r, c| rows[r][c]);
        let modelled = compose(&matrix(&p.matrix.r_nom), &matrix(&p.matrix.rho), xi_deg, sigma).ok()?;
        // The run's own model leaves its residual; the two models differ in the matrix only.
        let own = matrix(&p.matrix.phi);
        let change = (modelled - own) * own.try_inverse()?;
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for block in lin.blocks.iter().filter(|b| b.plateau.dropped.is_none()) {
            let residual = Vector3::from(block.residual_coil_nt?.0);
            let modelled_nt = Vector3::from(block.plateau.setting.field.0) - residual;
            let left = residual - change * modelled_nt;
            for axis in 0..3 {
                min[axis] = min[axis].min(left[axis]);
                max[axis] = max[axis].max(left[axis]);
            }
        }
        error.min_nt.push(min);
        error.max_nt.push(max);
    }
    Some(error)
}

/// The joint fit of the runs of a group, started at the two-step result.
fn joint_fit(points: &[&Point], runs: &[&Lin], fitted: &[(QuantityPart, TemperaturePolynomial)]) -> Result<Joint, JointError> {
    let at_hand = |point: &&&Point| runs.iter().any(|lin| lin.parameters.run.id == point.run.id);
    let missing: Vec<&str> = points.iter().filter(|p| !at_hand(p)).map(|p| p.file.as_str()).collect();
    if !missing.is_empty() {
        return Err(JointError::NotAtHand { files: missing.into_iter().map(str::to_owned).collect() });
    }
    let runs: Vec<JointRun> = points
        .iter()
        .filter_map(|point| runs.iter().find(|lin| lin.parameters.run.id == point.run.id))
        .map(|lin| {
            let p = &lin.parameters;
            let matrix = |rows: &[[f64; 3]; 3]| Matrix3::from_fn(|r, c| rows[r][c]);
            let mean_degc = p.run.temperature_degc.unwrap_or(f64::NAN);
            JointRun {
                run: p.run.id.clone(),
                r_nom: matrix(&p.matrix.r_nom),
                rho: matrix(&p.matrix.rho),
                plateaus: lin
                    .blocks
                    .iter()
                    .filter(|b| b.plateau.dropped.is_none())
                    .map(|b| JointPlateau {
                        field_coil_nt: b.plateau.setting.field.0,
                        reading_ent: b.plateau.mean.0,
                        temperature_degc: match lin.temperatures.sensor.as_slice() {
                            [] => mean_degc,
                            series => crate::data::run::interpolate(series, b.plateau.t_s()),
                        },
                        t_s: b.plateau.t_s(),
                    })
                    .collect(),
                trend_order: p.offset.trend_order,
                noise_ent: p.noise.std_ent,
            }
        })
        .collect();
    let start: [Vec<f64>; 6] = std::array::from_fn(|i| {
        fitted.iter().find(|(part, _)| part.name == joint::QUANTITIES[i]).map_or_else(Vec::new, |(_, p)| p.coefficients.clone())
    });
    joint::joint(&runs, &start, &Limits::default())
}

fn joint_part(joint: &Joint) -> JointPart {
    let named = |get: &dyn Fn(&TemperaturePolynomial) -> Vec<Vec<f64>>| -> BTreeMap<String, Vec<Vec<f64>>> {
        joint::QUANTITIES.iter().zip(&joint.polynomials).map(|(name, p)| ((*name).to_owned(), get(p))).collect()
    };
    JointPart {
        coefficients: joint::QUANTITIES
            .iter()
            .zip(&joint.polynomials)
            .map(|(name, p)| ((*name).to_owned(), p.coefficients.clone()))
            .collect(),
        covariance: named(&|p| rows(&p.covariance)),
        chi_square: joint.chi2,
        degrees_of_freedom: joint.dof,
        widened: joint.inflation_within,
        evaluations: joint.evaluations,
    }
}
