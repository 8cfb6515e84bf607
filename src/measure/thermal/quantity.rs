//! The polynomial of one quantity through the values of the runs.

use super::result::{BySource, band};
use super::{Corner, Kind, QuantityFit, RunGroup, SAME_DEGC, ThermalError};
use crate::data::across::{CalibratedRun, CommonChange, RunValues};
use crate::data::note::{Note, NoteKind};
use crate::data::quantity::QuantityFound;
use crate::data::units::COMPONENTS;
use crate::fit::order::{self, Chosen};
use crate::fit::{FitError, Limits, NORMAL_95, student_95, student_factor};
use crate::model::campaign::MOST_THERMAL_ORDER;
use crate::model::polynomial::TemperaturePolynomial;
use nalgebra::DMatrix;

/// One quantity of the runs before its polynomial is fitted.
pub(super) struct Quantity {
    /// `sigma_x`, for example.
    pub(super) name: String,
    component: String,
    unit: &'static str,
    /// Value and standard uncertainty per run; nan where there is none.
    values: Vec<(f64, f64)>,
    /// Changes of the values of all runs by everything that runs share, with what that is: zero in a run that does not share it. `None` where
    /// a run does not tell.
    common: Option<BySource>,
    /// Temperature at which its value holds in each run, °C; nan where that is the one of the run.
    degc: Vec<f64>,
    /// Whether too few runs may determine it.
    may_be_missing: bool,
}

/// The family of the -3 dB frequencies between neighbouring amplitudes.
pub(super) const INTERPOLATED: &str = "f_3db_igep";

/// Values and standard uncertainties, type A, of the three components of a family in one run.
type Triple = ([f64; 3], Option<[f64; 3]>);

/// Number of temperatures that differ by more than those of runs at one temperature do.
pub(super) fn different_temperatures(temperatures_degc: &[f64]) -> usize {
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

/// Temperature at which a component of a run holds, °C; nan where that is the one of the run.
fn own_degc(values: &RunValues, component: usize) -> f64 {
    match values {
        RunValues::Freq { model_degc: Some(degc), .. } | RunValues::Offset { degc: Some(degc), .. } => degc[component],
        _ => f64::NAN,
    }
}

/// The quantities of a kind in the order of the file; offset and residual field of those runs only that are said to tell them.
pub(super) fn quantities(points: &[&CalibratedRun], kind: Kind, corner: Corner, has_own_residual: &[bool]) -> Vec<Quantity> {
    const PAIRS: [&str; 3] = ["xy", "xz", "yz"];
    const NONE: Triple = ([f64::NAN; 3], None);
    let triple = |family: &str, components: [&str; 3], unit: &'static str, get: &dyn Fn(&RunValues) -> Triple| {
        let all: Vec<Triple> = points.iter().map(|p| get(&p.values)).collect();
        (0..3)
            .map(|i| Quantity {
                name: format!("{family}_{}", components[i]),
                component: components[i].to_owned(),
                unit,
                values: all.iter().map(|(value, std)| (value[i], std.map_or(f64::NAN, |s| s[i]))).collect(),
                common: common(points, family, i),
                degc: points.iter().map(|p| own_degc(&p.values, i)).collect(),
                may_be_missing: kind != Kind::Lin,
            })
            .collect::<Vec<Quantity>>()
    };
    match kind {
        Kind::Lin => {
            let part = |which: usize| {
                move |values: &RunValues| match values {
                    RunValues::Lin { sigma, xi_deg, b_or_ent, std, freedom, .. } => {
                        // Intervals of the polynomials are normal ones.
                        let factor = freedom.map_or(1.0, |dof| student_factor(dof.max(1)));
                        ([*sigma, *xi_deg, *b_or_ent][which], std[which].map(|s| s.map(|s| factor * s)))
                    }
                    _ => NONE,
                }
            };
            [
                triple("sigma", COMPONENTS, "nT/enT", &part(0)),
                triple("xi", PAIRS, "deg", &part(1)),
                in_position(triple("b_or", COMPONENTS, "enT", &part(2)), has_own_residual),
            ]
            .into_iter()
            .flatten()
            .collect()
        }
        Kind::Offset => triple("b_off", COMPONENTS, "enT", &|values| match values {
            RunValues::Offset { offset_ent, std, .. } => (*offset_ent, *std),
            _ => NONE,
        }),
        Kind::Freq => {
            let igep = |values: &RunValues| match values {
                RunValues::Freq { igep_hz: Some(hz), .. } => (*hz, None),
                _ => NONE,
            };
            let of_corner = |values: &RunValues| match values {
                RunValues::Freq { model_hz: Some(hz), model_std_hz, .. } if corner == Corner::Model => (*hz, *model_std_hz),
                values => igep(values),
            };
            let mut all = triple("f_3db", COMPONENTS, "Hz", &of_corner);
            // Runs may have the corner of their models alone.
            let interpolated = triple(INTERPOLATED, COMPONENTS, "Hz", &igep);
            all.extend(interpolated.into_iter().filter(|q| q.values.iter().any(|(hz, _)| hz.is_finite())));
            all
        }
    }
}

/// Whether two runs gave the same values to the last bit, at least one of them a number.
pub(super) fn has_values_of(one: &RunValues, other: &RunValues) -> bool {
    let values = |values: &RunValues| -> Vec<f64> {
        match values {
            RunValues::Lin { sigma, xi_deg, b_or_ent, .. } => [*sigma, *xi_deg, *b_or_ent].concat(),
            RunValues::Offset { offset_ent, residual_ent, .. } => [*offset_ent, *residual_ent].concat(),
            RunValues::Freq { model_hz, igep_hz, f_s_hz, .. } => {
                let all = model_hz.iter().chain(igep_hz).flatten().chain(f_s_hz);
                all.copied().collect()
            }
        }
    };
    let [one, other] = [one, other].map(values);
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
    one.iter().any(|v| v.is_finite()) && bits(&one) == bits(&other)
}

/// The same quantities of some of the runs.
fn in_position(mut all: Vec<Quantity>, kept: &[bool]) -> Vec<Quantity> {
    for quantity in &mut all {
        quantity.values.iter_mut().zip(kept).filter(|(_, kept)| !**kept).for_each(|(value, _)| *value = (f64::NAN, f64::NAN));
    }
    all
}

/// The changes of a component of a family in all runs by everything that they share. Files of offsets state how much that is and not in which
/// direction: it is the same in all runs, which leaves the most to their mean.
fn common(points: &[&CalibratedRun], family: &str, component: usize) -> Option<BySource> {
    if family == "b_off" {
        let change = |point: &&CalibratedRun| match &point.values {
            RunValues::Offset { std_b, .. } => std_b.map(|std| std[component]),
            _ => None,
        };
        let changes: Vec<f64> = points.iter().map(change).collect::<Option<_>>()?;
        return Some(vec![(CommonChange::source_of(&format!("b_off_{}", COMPONENTS[component])), changes)]);
    }
    let which = ["sigma", "xi", "b_or"].iter().position(|name| *name == family)?;
    let mut all = BySource::new();
    for (run, point) in points.iter().enumerate() {
        let RunValues::Lin { common: Some(changes), .. } = &point.values else { return None };
        for change in changes {
            let place = all.iter().position(|(source, _)| *source == change.source).unwrap_or_else(|| {
                all.push((change.source.clone(), vec![0.0; points.len()]));
                all.len() - 1
            });
            all[place].1[run] = change.all()[which][component];
        }
    }
    Some(all)
}

/// The values of the runs that determine a quantity.
struct Values {
    /// Indices of the runs.
    runs: Vec<usize>,
    degc: Vec<f64>,
    value: Vec<f64>,
    std: Vec<f64>,
    /// Whether all standard uncertainties are usable.
    std_known: bool,
}

impl Values {
    fn of(quantity: &Quantity, temperatures_degc: &[f64], notes: &mut Vec<Note>) -> Self {
        let runs: Vec<usize> = (0..temperatures_degc.len()).filter(|i| quantity.values[*i].0.is_finite()).collect();
        let std: Vec<f64> = runs.iter().map(|i| quantity.values[*i].1).collect();
        let usable = |s: &f64| s.is_finite() && *s > 0.0;
        let std_known = std.iter().all(usable);
        if !std_known && std.iter().any(usable) {
            let text = format!("{}: not all runs state an uncertainty; all count alike", quantity.name);
            notes.push(Note::new(NoteKind::Data, text).about(&quantity.name));
        }
        Self {
            degc: runs
                .iter()
                .map(|i| if quantity.degc[*i].is_finite() { quantity.degc[*i] } else { temperatures_degc[*i] })
                .collect(),
            value: runs.iter().map(|i| quantity.values[*i].0).collect(),
            runs,
            std,
            std_known,
        }
    }
}

/// The polynomial of one quantity; `None` where too few runs determine it and it may be missing.
pub(super) fn fit(
    group: &RunGroup,
    quantity: &Quantity,
    points: &[&CalibratedRun],
    temperatures_degc: &[f64],
    notes: &mut Vec<Note>,
) -> Result<Option<QuantityFit>, ThermalError> {
    let values = Values::of(quantity, temperatures_degc, notes);
    let refuse = |error| ThermalError::Fit { quantity: quantity.name.clone(), error };
    let different = different_temperatures(&values.degc);
    if different < 2 {
        let error = FitError::TooFewPoints { order: 1, distinct: different };
        return if quantity.may_be_missing { Ok(None) } else { Err(refuse(error)) };
    }
    let highest = (MOST_THERMAL_ORDER as usize).min(different.saturating_sub(1));
    let wanted = group.order(&quantity.name);
    let choose = |std: Option<&[f64]>| match wanted {
        Some(order) if order > highest => Err(FitError::TooFewPoints { order, distinct: different }),
        wanted => order::choose(&values.degc, &values.value, std, highest, wanted, &Limits::default()),
    };
    let own = values.std_known.then_some(values.std.as_slice());
    let by_own = choose(own).map_err(refuse)?;
    // A scatter between the runs is the same for those that are known well and those that are not.
    let scatter = match (own, wanted) {
        (Some(own), None) if own.len() >= order::LEAST_FOR_SCATTER => {
            order::likely_scatter(&values.degc, &values.value, own, highest, &Limits::default())
        }
        (Some(own), _) if by_own.inflation > 1.0 => {
            order::scatter(&values.degc, &values.value, own, by_own.order, &Limits::default())
        }
        _ => Ok(0.0),
    }
    .map_err(refuse)?;
    let with_scatter: Vec<f64> = values.std.iter().map(|std| std.hypot(scatter)).collect();
    let std = own.map(|_| with_scatter.as_slice());
    let chosen = if scatter > 0.0 { choose(std).map_err(refuse)? } else { by_own.clone() };
    let valid_degc = [
        values.degc.iter().copied().fold(f64::INFINITY, f64::min),
        values.degc.iter().copied().fold(f64::NEG_INFINITY, f64::max),
    ];
    if values.runs.len() < points.len() {
        let text = format!(
            "{}: {} of {} runs determine it, {:.1} to {:.1} °C",
            quantity.name,
            values.runs.len(),
            points.len(),
            valid_degc[0],
            valid_degc[1]
        );
        notes.push(Note::new(NoteKind::Data, text).about(&quantity.name));
    }
    if scatter > 0.0 {
        let text = format!(
            "{}: the runs scatter by {:.1} times what their uncertainties let expect; a scatter of {scatter:.1e} {} was added to those of all runs",
            quantity.name,
            order::times(&values.degc, &values.value, &values.std, chosen.order, &Limits::default()).map_err(refuse)?,
            quantity.unit
        );
        notes.push(Note::new(NoteKind::Method, text).about(&quantity.name));
    }
    let common = moved(quantity, &values, std, chosen.order).map_err(refuse)?;
    let widened = if own.is_some() { by_own.inflation.max(chosen.inflation) } else { 1.0 };
    Ok(Some(QuantityFit { common, ..described(quantity, values, points, (&chosen, [scatter, widened]), valid_degc) }))
}

/// What everything that the runs share does to the coefficients: the polynomial is linear in the values, so that the polynomial through their
/// changes, with their signs and the same weights, is the change of the coefficients, however many runs there are. `None` where the runs do not
/// tell.
fn moved(quantity: &Quantity, values: &Values, std: Option<&[f64]>, order: usize) -> Result<Option<BySource>, FitError> {
    let Some(common) = &quantity.common else { return Ok(None) };
    let mut all = Vec::new();
    for (source, changes) in common {
        let changes: Vec<f64> = values.runs.iter().map(|i| changes[*i]).collect();
        if changes.iter().any(|change| !change.is_finite()) {
            return Ok(None);
        }
        let fitted = order::choose(&values.degc, &changes, std, order, Some(order), &Limits::default())?;
        all.push((source.clone(), fitted.polynomial.coefficients));
    }
    Ok(Some(all))
}

/// The polynomial with its values.
fn described(
    quantity: &Quantity,
    values: Values,
    points: &[&CalibratedRun],
    (chosen, [scatter, widened]): (&Chosen, [f64; 2]),
    valid_degc: [f64; 2],
) -> QuantityFit {
    let Values { runs, degc, value, std, std_known } = values;
    // Where the scatter of a few runs tells the uncertainties, intervals are wider than where they are known.
    let degrees_of_freedom = chosen.polynomial.dof;
    let factor_95 =
        if std_known && scatter == 0.0 && chosen.inflation == 1.0 { NORMAL_95 } else { student_95(degrees_of_freedom) };
    let residual = chosen.polynomial.residuals.clone();
    let extreme = |join: fn(f64, f64) -> f64| residual.iter().copied().reduce(join).unwrap_or(f64::NAN);
    QuantityFit {
        found: QuantityFound {
            name: quantity.name.clone(),
            unit: quantity.unit.to_owned(),
            runs: runs.iter().map(|i| points[*i].run.id.clone()).collect(),
            valid_degc,
            degrees_of_freedom,
            factor_95,
            order: chosen.order,
            order_by: chosen.reason,
            aicc: chosen.candidates.iter().map(|c| c.aicc.unwrap_or(f64::NAN)).collect(),
            leave_one_out: chosen.candidates.iter().map(|c| c.leave_one_out.unwrap_or(f64::NAN)).collect(),
            value,
            std: if std_known { std } else { Vec::new() },
            min_error: extreme(f64::min),
            max_error: extreme(f64::max),
            residual,
            scatter,
            widened: widened * chosen.choice,
        },
        choice: chosen.choice,
        component: quantity.component.clone(),
        runs,
        temperature_degc: degc,
        polynomial: TemperaturePolynomial {
            coefficients: chosen.polynomial.coefficients.clone(),
            covariance: finite(&chosen.covariance),
            valid_degc,
        },
        common: None,
        band: band(valid_degc, |t| chosen.evaluate(t)),
        joint_band: Vec::new(),
    }
}

/// The covariance, or none of size zero: without a degree of freedom the scatter tells nothing, and zeros would claim certainty.
fn finite(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    if covariance.iter().all(|v| v.is_finite()) { covariance.clone() } else { DMatrix::zeros(0, 0) }
}
