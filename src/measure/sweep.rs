//! Fields of constant modulus and random direction while the temperature moves (CH-GFZ-TR-2601 section 8; docs/mathematics.md,
//! "Temperature").
//!
//! The nine parameters are followed by a sliding window of settings, and fitted to all settings at once: σ_i, ξ_ij and `B_or,i` are
//! polynomials of the temperature at each setting, each of the order that is asked for, and the rotation of the sensor is one as well
//! (`measure::joint`). The elements of `A = Φ⁻¹` are no polynomials then: where σ is a straight line, they bend. A linear model of them is
//! the start.
//!
//! A thermistor shows the temperature of the part that matters earlier or later. The heating and the cooling branch then split; the lag is
//! the one that makes them one: either a delay, or the time constant of a body that is heated through its surface (first order).

mod fit;
mod judge;
mod lag;
mod means;
mod options;
mod orders;
mod refusal;
mod result;
mod step;
mod thermistors;
mod windows;

pub use options::{LagChoice, Options, WINDOW, Window};
pub use refusal::SweepError;
pub use result::{SettingCounts, Sweep, SweepBlock, Turning, WindowFit};

use super::structure;
use super::thermal::{QuantityFit, band};
use crate::data::across::{FollowedThermistor, LagDecision, LagForm, LinearScope};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Plateau, Plateaus};
use crate::data::quantity::QuantityFound;
use crate::data::run::{Kind, Run};
use crate::fit::order::Reason;
use crate::fit::smooth::Course;
use crate::fit::statistics::extremes;
use crate::fit::{Limits, NORMAL_95};
use crate::model::campaign::Instructions;
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor::split;
use crate::record::conditions::{self, Temperatures};
use crate::record::facility;
use crate::record::known::{self, Known};
use crate::record::position::{apply_limits, the_position};
use crate::record::screens::{self, inside};
use crate::record::temperature_faults;
use fit::Problem;
use means::Means;
use nalgebra::{DVectorView, Matrix3};
use orders::{Asked, Orders};
use std::ops::Range;
use step::Step;
use thermistors::Followed;

/// Names and units of the nine quantities.
const QUANTITIES: [(&str, &str, &str); 9] = [
    ("sigma_x", "x", "nT/enT"),
    ("sigma_y", "y", "nT/enT"),
    ("sigma_z", "z", "nT/enT"),
    ("xi_xy", "xy", "deg"),
    ("xi_xz", "xz", "deg"),
    ("xi_yz", "yz", "deg"),
    ("b_or_x", "x", "enT"),
    ("b_or_y", "y", "enT"),
    ("b_or_z", "z", "enT"),
];

/// Where the angles stand among them: after the sensitivities, before the offsets.
const ANGLES: Range<usize> = 3..6;

/// One sweep.
///
/// # Errors
/// [`SweepError`]: the run is refused, with the reason and what to do.
pub fn sweep(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Sweep, SweepError> {
    if run.header.kind != Kind::Sweep {
        return Err(SweepError::Kind(run.header.kind));
    }
    if !options.allow_mismatch {
        screens::edges(plateaus)?;
    }
    let (_, position) = the_position(plateaus, instructions)?;
    let mut list = plateaus.list.clone();
    apply_limits(&mut list, position, &instructions.limits_nt(&run.header));
    let mut notes: Vec<Note> = Vec::new();
    let facility = options.facility.as_ref().map(|f| facility::apply(f, run, instructions, &mut list, &mut notes));
    let facility = facility.transpose()?;
    let model = options.model.as_ref().map(|m| known::apply(m, run, plateaus, &mut list, instructions, &mut notes));

    let usable: Vec<&Plateau> = list.iter().filter(|p| p.dropped.is_none()).collect();
    let span_s = [usable.first().map_or(0.0, |p| p.used_s[0]), usable.last().map_or(0.0, |p| p.used_s[1])];
    let mut of_temperatures: Vec<Note> = Vec::new();
    let temperatures = Temperatures::of(run, instructions, span_s, &mut of_temperatures);
    let (own, coil) = instructions.channels(&run.header);
    let asked = Asked::of(run, instructions, options);
    // Between its readings the temperature is a straight line; what is missing of that of the coil system counts for nothing here.
    notes.extend(of_temperatures.into_iter().filter(|note| note.about.as_ref() == Some(&own)));
    let parameters = asked.usual().linear().count();
    let too_few = |used: usize| SweepError::TooFew { used, total: list.len(), parameters };
    if usable.len() < 2 * parameters {
        return Err(too_few(usable.len()));
    }
    let channels = thermistors::moving(run, &coil, &usable)?;
    let (_, series) = channels.iter().find(|(name, _)| *name == own).unwrap_or(&channels[0]);
    let is_slow =
        |p: &Plateau| options.most_k_per_min.is_none_or(|most| 60.0 * thermistors::rate_k_per_s(series, p.t_s()).abs() <= most);
    let mut used: Vec<&Plateau> = usable.iter().copied().filter(|p| is_slow(p)).collect();
    let too_fast = usable.len() - used.len();
    if used.len() < 2 * parameters {
        return Err(too_few(used.len()));
    }

    let mut means = Means::of(&used);
    let r_nom = position.r_nom();
    notes.extend(plausible(&means, &means.degc(series), &asked, &r_nom, options)?);
    let Followed { mut lags, chosen } = Followed::of(&channels, &own, &means, asked.usual().higher().linear(), &mut notes);
    let (channel, series) = &channels[chosen];
    let linear = asked.usual().higher().linear();
    let whole = thermistors::without_wrong_ends(channel, series, &means, linear, &mut notes);
    if let Some(whole) = &whole {
        lags[chosen] = thermistors::find_lag(channel, whole, &means, linear);
    }
    let series = whole.as_ref().unwrap_or(series);
    let told_s = temperature_faults::largest_jump_s(run, channel, span_s);
    let seen = match told_s {
        Some(t_s) => Step::beyond(series, &means, linear, t_s),
        None => Step::of(series, &means, linear, lags[chosen].gain),
    };
    let (step, rival) = (seen.filter(|step| step.is_claimed), seen.filter(|step| !step.is_claimed));
    let mended = step.map(|step| step.taken_off(series));
    if let (Some(step), Some(mended)) = (step, &mended) {
        notes.push(if told_s.is_some() { step.note_beyond(channel) } else { step.note(channel) });
        lags[chosen] = thermistors::find_lag(channel, mended, &means, linear);
    }
    let series = mended.as_ref().unwrap_or(series);
    let known_lag = options.model.as_ref().and_then(Known::thermal_lag);
    let course = Course::smooth(series);
    let possible = lag::possible(&lags[chosen], options.lag, known_lag);
    let known_s = [
        possible.iter().filter_map(|lag| lag.known_from_s(&course)).reduce(f64::max),
        possible.iter().filter_map(|lag| lag.known_until_s(&course)).reduce(f64::min),
    ];
    if let (true, Some(lag)) = (known_s.iter().any(Option::is_some), possible.first()) {
        let [begin_s, end_s] = [known_s[0].unwrap_or(f64::NEG_INFINITY), known_s[1].unwrap_or(f64::INFINITY)];
        let [before, after] =
            [used.iter().filter(|p| p.used_s[0] < begin_s).count(), used.iter().filter(|p| p.used_s[1] > end_s).count()];
        used.retain(|p| p.used_s[0] >= begin_s && p.used_s[1] <= end_s);
        if used.len() < 2 * parameters {
            return Err(too_few(used.len()));
        }
        means = Means::of(&used);
        let about_s = lag.seconds().abs();
        if before > 0 {
            let text = format!(
                "{before} settings before {begin_s:.0} s are left out: {channel} moves already at its first reading, and where the sensor, which \
                 follows it by about {about_s:.0} s, came from is not known"
            );
            notes.push(Note::new(NoteKind::Temperature, text).about(channel));
        }
        if after > 0 {
            let text = format!(
                "{after} settings behind {end_s:.0} s are left out: {channel} still moves at its last reading, and what the sensor, which is ahead of it \
                 by about {about_s:.0} s, had reached then is not known"
            );
            notes.push(Note::new(NoteKind::Temperature, text).about(channel));
        }
        // What was not known made one kind of lag look like another. Where the rest shows no lag to a linear model, the fit itself judges the one
        // that all settings showed.
        let of_rest = thermistors::find_lag(channel, series, &means, linear);
        if of_rest.form != LagForm::None {
            lags[chosen] = of_rest;
        }
    }
    let problem = Problem { run: &run.header.run, r_nom, used: &used, means: &means, step };
    let settled = lag::settle(&problem, &asked, &course, &lags[chosen], options.lag, known_lag, &mut notes)?;
    lags[chosen].form = settled.form();
    if settled.applied.decision == LagDecision::Found {
        notes.extend(rival.map(|rival| rival.rival(channel)));
    }
    let (fit, degc) = (&settled.fit, &settled.degc);
    let windows = windows::windows((&used, degc, fit, &settled.noise), [series, &settled.moved], &r_nom, options.window);
    let blocks = problem.blocks(fit, degc);

    conditions::warn_of_plateaus(&mut notes, run, plateaus);
    conditions::warn_of_run(&mut notes, run, instructions);
    // One order higher: the elements of the response bend where sensitivities are straight.
    let columns = means.baseline(degc, settled.orders.higher().linear()).columns(&means.fields_nt, degc);
    notes.extend(gain_jumps(&means, degc, settled.orders));
    notes.extend(judge::orders_too_low(&problem, &asked, &settled));
    notes.extend(judge::standing_out(&blocks));
    // The temperature with its lag: what the polynomials are of.
    notes.extend(structure::notes(&structure::Rows::of(&list, &used, &settled.moved, &columns, &settled.noise)));
    let mut head = conditions::head(run, instructions, &temperatures);
    head.temperature_degc = Some(degc.iter().sum::<f64>() / degc.len() as f64);
    let polynomials = fit::polynomials(fit, &settled.covariance);
    let uncertain = facility.as_ref().filter(|driven| !driven.moved.is_empty());
    let changes = uncertain.map(|driven| fit::of_facility(fit, degc, &driven.moved_of(&list, &used))).transpose()?;
    let sources = || uncertain.into_iter().flat_map(|driven| driven.moved.iter().map(|moved| moved.source.clone()));
    let together = fit::together(fit, &settled.covariance);
    let together_combined = changes.as_ref().map(|b| &together + fit::together(fit, &(b * b.transpose())));
    let change_of = |k: usize, change: DVectorView<f64>| fit.range(k).map(|place| change[place]).collect::<Vec<f64>>();
    let quantity = |k: usize| QuantityFit {
        common: changes.as_ref().map(|of| sources().zip(of.column_iter().map(|change| change_of(k, change))).collect()),
        ..describe(k, run, &polynomials[k], &windows, asked.has(k), used.len())
    };
    let rms = |of: &dyn Fn(&SweepBlock) -> f64| (blocks.iter().map(|b| of(b).powi(2)).sum::<f64>() / blocks.len() as f64).sqrt();
    Ok(Sweep {
        run: head,
        file: run.input.path.clone(),
        channel: channel.clone(),
        valid_degc: fit.valid_degc,
        scope: LinearScope {
            valid_field_nt: Some(field_range_nt(&used, &r_nom)),
            linearisation: None,
            known_effects: model.iter().map(|m| m.part.file.clone()).collect(),
            thermistor_lag: FollowedThermistor::of(&settled.applied),
        },
        quantities: (0..QUANTITIES.len()).map(quantity).collect(),
        together,
        together_combined,
        rotation: fit::rotation(fit, &settled.covariance),
        turning: fit::turning(fit, &settled.covariance, settled.orders.rotation),
        settings: SettingCounts { used: used.len(), total: list.len(), too_fast },
        window: options.window,
        residual_nt: std::array::from_fn(|k| rms(&|b: &SweepBlock| b.residual_nt[k])),
        lag: settled.applied,
        lags,
        facility: facility.map(|driven| driven.part),
        model: model.map(|m| m.part),
        reference: instructions.references.get(&run.header.sensor).copied(),
        notes,
        windows,
        blocks,
        temperatures,
    })
}

/// Whether the readings can be those of the settings, by the linear model with polynomials of the temperature; what it says of the axes.
fn plausible(
    means: &Means,
    degc: &[f64],
    asked: &Asked,
    r_nom: &Matrix3<f64>,
    options: &Options,
) -> Result<Vec<Note>, SweepError> {
    let baseline = means.baseline(degc, asked.usual().linear());
    let fit = baseline.fit(&means.fields_nt, degc, &means.readings_ent, &Limits::default())?;
    let mut notes = Vec::new();
    screens::judge(screens::followed(&means.readings_ent, &fit.residuals), options.allow_mismatch, &mut notes)?;
    let (response, _) = baseline.at(fit.coefficients.as_slice(), baseline.middle());
    let no_sensor = SweepError::NoSensor { degc: baseline.middle() };
    let phi = response.try_inverse().ok_or_else(|| no_sensor.clone())?;
    let split = split(&phi, r_nom).map_err(|_| no_sensor)?;
    screens::judge(screens::gain(&split), options.allow_gain, &mut notes)?;
    notes.extend(screens::axes(&split));
    Ok(notes)
}

/// Jumps of the gain beside a linear model one order higher than the polynomials, or of their orders where the settings do not determine more.
/// The temperature is that with its lag: without it, fast cooling passes for a jump.
fn gain_jumps(means: &Means, degc: &[f64], orders: Orders) -> Vec<Note> {
    let judged = [orders.higher(), orders].into_iter().find_map(|orders| {
        let linear = means.baseline(degc, orders.linear());
        let left = linear.fit(&means.fields_nt, degc, &means.readings_ent, &Limits::default()).ok()?;
        Some((linear, left))
    });
    let Some((linear, left)) = judged else { return Vec::new() };
    let columns = linear.columns(&means.fields_nt, degc);
    inside::gain_jumps(&columns, 3 * (linear.response_order() + 1), &left.coefficients, &left.residuals, &means.t_s)
}

/// Lowest and highest field of the settings along the nominal sensor axes, nT.
fn field_range_nt(used: &[&Plateau], r_nom: &Matrix3<f64>) -> [[f64; 2]; 3] {
    let coil_nt = std::array::from_fn(|axis| extremes(used.iter().map(|p| p.setting.field.0[axis])));
    LinearScope::along_sensor_axes(&coil_nt, &std::array::from_fn(|row| std::array::from_fn(|column| r_nom[(row, column)])))
}

/// A quantity with its polynomial. Windows that follow each other share settings: those stand beside it that share none.
fn describe(
    k: usize,
    run: &Run,
    polynomial: &TemperaturePolynomial,
    windows: &[WindowFit],
    given: bool,
    settings: usize,
) -> QuantityFit {
    let (name, component, unit) = QUANTITIES[k];
    let apart: Vec<&WindowFit> = windows.iter().step_by(WINDOW).collect();
    let residual: Vec<f64> = apart.iter().map(|w| w.values[k] - polynomial.evaluate(w.temperature_degc[1]).0).collect();
    let [min_error, max_error] = extremes(residual.iter().copied());
    QuantityFit {
        found: QuantityFound {
            name: name.to_owned(),
            unit: unit.to_owned(),
            runs: vec![run.header.run.clone()],
            valid_degc: polynomial.valid_degc,
            degrees_of_freedom: settings.saturating_sub(polynomial.coefficients.len()),
            factor_95: NORMAL_95,
            order: polynomial.order(),
            order_by: if given { Reason::Given } else { Reason::AboveLeastAicc },
            aicc: Vec::new(),
            leave_one_out: Vec::new(),
            value: apart.iter().map(|w| w.values[k]).collect(),
            std: apart.iter().map(|w| w.std[k]).collect(),
            residual,
            scatter: 0.0,
            widened: 1.0,
            min_error,
            max_error,
        },
        choice: 1.0,
        component: component.to_owned(),
        runs: Vec::new(),
        temperature_degc: apart.iter().map(|w| w.temperature_degc[1]).collect(),
        polynomial: polynomial.clone(),
        common: None,
        band: band(polynomial.valid_degc, |t| polynomial.evaluate(t)),
        joint_band: Vec::new(),
    }
}
