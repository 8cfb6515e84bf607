//! The linear calibration of one run: `B_r = A B_c + Σ p_k τ^k` over plateau means, `Φ = A⁻¹`, and its split.

mod derived;
mod fit;
mod judge;
mod moving;
mod options;
mod prepare;
mod refusal;
mod result;

pub use options::Options;
pub use refusal::LinError;
pub use result::{Block, Lin};

use crate::data::calibration::{
    LinearCalibration, LinearQuality, LinearTypeB, LinearValidity, OffsetTrend, PlateauNoise, Setup, SlopeSource,
    TemperatureSlopes,
};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Plateau, Plateaus};
use crate::data::result::AT_REST_K;
use crate::data::run::Run;
use crate::data::units::Reading;
use crate::fit::DenseNoise;
use crate::fit::statistics::{extremes, median};
use crate::model::campaign::Instructions;
use crate::record::conditions::{self, Temperatures, Within};
use crate::record::screens::{self, inside};
use derived::{Derived, Parameters};
use fit::{Fitted, Means, fit, stack};
use moving::{Moving, Origin, Referred};
use nalgebra::DMatrix;
use prepare::{OfFacility, Prepared, trend_order};

/// Fits one run.
///
/// # Errors
/// [`LinError`]: the run is refused, with the reason and what to do.
pub fn lin(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Lin, LinError> {
    let order = trend_order(run, plateaus, instructions, options)?;
    let mut notes: Vec<Note> = Vec::new();
    let mut prepared = Prepared::of(run, plateaus, instructions, options, &mut notes)?;
    let span_s = span_s(&prepared.used(order)?);
    let mut of_temperatures: Vec<Note> = Vec::new();
    let mut temperatures = Temperatures::of(run, instructions, span_s, &mut of_temperatures);
    if let Some((lag, polynomials)) = options.temperature.as_ref().and_then(|own| own.lag.zip(Some(own))) {
        let file = &polynomials.input.path;
        if !temperatures.follow(lag, file, span_s, &mut of_temperatures) {
            return Err(LinError::LagUnknown { file: file.clone(), lag_s: lag.seconds() });
        }
    }
    let moving = Moving::of(&prepared.list, &temperatures, span_s);
    let origin = origin(run, instructions, options, &temperatures, moving.as_ref(), &mut of_temperatures)?;
    let before: Vec<Reading> = prepared.list.iter().map(|p| p.mean).collect();
    let solved = match (&moving, &origin) {
        (Some(moving), Some(origin)) => {
            let referred = moving::refer(&mut prepared, moving, order, options.robust, origin)?;
            let channel = temperatures.conditions.as_ref().map_or("", |c| c.sensor_channel.as_str());
            of_temperatures.extend(referred.note(moving, channel, &instructions.slope_bounds));
            referred.into()
        }
        _ => Solved::at_rest(&prepared, order, options)?,
    };
    let Solved { means, fitted, noise, stacked, covariance, slopes } = solved;
    let used = prepared.used(order)?;
    let followed = screens::followed(&readings_ent(&used), &fitted.solution.residuals);
    screens::judge(followed, options.allow_mismatch, &mut notes)?;
    if let Some(moving) = moving.as_ref().filter(|m| m.is_moving()) {
        temperatures.state_movement(moving.range_k(), moving.rate_k_per_h);
    }
    let r_nom = prepared.position.r_nom();
    let derived = Derived::of(&stacked, &means, &r_nom)?;
    let response = derived.response();
    let parameters = Parameters::of(derived, &stacked, &covariance, &means, &r_nom)?;
    let of_facility = match prepared.changes_of_facility(&response, &means).map_err(LinError::Fit)? {
        Some(OfFacility { sources, changes }) => {
            let derived = Derived::of(&stacked, &means, &r_nom)?;
            let mut common = Vec::new();
            for (source, change) in sources.into_iter().zip(changes.column_iter()) {
                let moved: Vec<f64> = stacked.iter().zip(&change).map(|(value, by)| value + by).collect();
                common.push(derived.change_to(&Derived::of(&moved, &means, &r_nom)?, source));
            }
            let b = Parameters::of(derived, &stacked, &(&changes * changes.transpose()), &means, &r_nom)?;
            Some(LinearTypeB::with(b.std(), b.covariance(), common, &parameters.std(), &parameters.covariance()))
        }
        None => None,
    };
    screens::judge(screens::gain(&parameters.split), options.allow_gain, &mut notes)?;
    let blocks = judge::blocks(
        &prepared.list,
        slopes.is_some().then_some(before.as_slice()),
        &fitted.weights,
        &parameters.split,
        &means,
        &stacked,
    )?;

    notes.extend(of_temperatures);
    notes.extend(screens::axes(&parameters.split));
    conditions::warn_of_plateaus(&mut notes, run, plateaus);
    conditions::warn_of_run(&mut notes, run, instructions);
    judge::judge_fit(&mut notes, &blocks);
    if !options.robust {
        let (responses, solution) = (3 * (means.baseline.response_order() + 1), &fitted.solution);
        notes.extend(inside::gain_jumps(&means.columns(), responses, &solution.coefficients, &solution.residuals, &means.t_s));
        notes.extend(judge::structure_of(&temperatures, &prepared.list, &used, &means, &noise));
    }
    notes.extend(judge::rounding_of(&used, &noise));
    notes.extend(judge::few_means(&noise, fitted.solution.dof));
    conditions::warn_of_slow_noise(&mut notes, &noise, span_s);

    let is_free = slopes.as_ref().is_some_and(|s| !matches!(s.source, SlopeSource::Polynomials(_)));
    let powers = slopes.as_ref().map_or(1, |s| s.order.max(1));
    let with_temperature = moving.filter(|m| is_free && m.is_moving()).and_then(|m| {
        let over_k: Vec<f64> =
            prepared.list.iter().zip(&m.over_k).filter(|(p, _)| p.dropped.is_none()).map(|(_, k)| *k).collect();
        Means::of(&used, order).with_temperature(&over_k, powers).into_extra()
    });
    let mut calibration = LinearCalibration {
        run: conditions::head(run, instructions, &temperatures),
        setup: setup(&prepared, &used, plateaus),
        matrix: parameters.matrices(),
        angle_deg: parameters.angles(),
        offset: OffsetTrend {
            b_or_ent: parameters.b_or_ent,
            trend_order: order,
            trend_ent: std::array::from_fn(|a| means.baseline.offsets_ent(&stacked, a).to_vec()),
            tau_span_s: means.span_s,
            std_covers: Some(conditions::noise_in_std(span_s[1] - span_s[0], "the run")),
        },
        quality: LinearQuality {
            blocks_used: used.len(),
            blocks_total: prepared.list.len(),
            lost_samples: run.vectors.lost,
            spike_samples: prepared.list.iter().map(|p| p.spike_samples).sum(),
            downweighted_blocks: fitted.downweighted,
            condition: fitted.solution.condition,
            degrees_of_freedom: fitted.solution.dof,
            rotation_determinant: parameters.split.rho.determinant(),
            raw_std_ent: conditions::raw_std(&used),
            residual_nt: judge::residual_summary(&blocks),
        },
        std: parameters.std(),
        covariance: parameters.covariance(),
        of_facility,
        noise: noise_of_plateaus(&noise),
        valid: validity(&used, &temperatures, span_s),
        slopes,
        reference: None,
    };
    let std_ent = calibration.of_facility.as_ref().map_or(&calibration.std, |both| &both.std_combined).b_or_ent;
    notes.extend(judge::moving_offset(&calibration.offset, std_ent));
    let is_lag_known = options.temperature.as_ref().is_some_and(|polynomials| polynomials.lag.is_some());
    if let (false, Some(slopes), Some(conditions)) = (is_lag_known, &calibration.slopes, &temperatures.conditions) {
        let std = calibration.of_facility.as_ref().map_or(&calibration.std, |both| &both.std_combined);
        let rate = conditions.sensor_rate_k_per_h;
        notes.extend(rate.and_then(|rate| judge::late_sensor(slopes, std, rate, &conditions.sensor_channel)));
    }
    let stated = instructions.references.get(&run.header.sensor);
    calibration.reference = stated.and_then(|stated| stated.in_frame_of(&calibration.alignment()).ok());
    Ok(Lin {
        calibration,
        facility: prepared.facility.map(|driven| driven.part),
        linearisation: prepared.linearisation,
        model: prepared.known.map(|k| k.part),
        dropped: conditions::dropped(&prepared.list),
        notes,
        blocks,
        with_temperature,
        temperatures,
        given: plateaus.clone(),
        noise_tried: noise.tried().map(<[_]>::to_vec),
        samples: None,
    })
}

/// The fit of a run.
struct Solved {
    means: Means,
    fitted: Fitted,
    noise: DenseNoise,
    /// Coefficients of the baseline, component after component, with their covariance.
    stacked: Vec<f64>,
    covariance: DMatrix<f64>,
    slopes: Option<TemperatureSlopes>,
}

impl Solved {
    /// With one response for the whole run, whatever the temperature did.
    fn at_rest(prepared: &Prepared, order: usize, options: &Options) -> Result<Self, LinError> {
        let used = prepared.used(order)?;
        let means = Means::of(&used, order);
        let fitted = fit(&used, &means, options.robust)?;
        // Readings of other settings have no noise to speak of.
        if !options.allow_mismatch {
            screens::followed(&readings_ent(&used), &fitted.solution.residuals)?;
        }
        let noise = conditions::noise(fitted.for_noise(), &used, Within::Still).map_err(LinError::Fit)?;
        let stacked = stack(&fitted.solution.coefficients);
        let covariance = prepared.covariance(&noise, &means, &used).map_err(LinError::Fit)?;
        Ok(Self { means, fitted, noise, stacked, covariance, slopes: None })
    }
}

impl From<Referred> for Solved {
    fn from(referred: Referred) -> Self {
        let Referred { means, fitted, noise, stacked, covariance, slopes, .. } = referred;
        Self { means, fitted, noise, stacked, covariance, slopes: Some(slopes) }
    }
}

/// Where the slopes with the sensor temperature come from; `None` where the sensor is at rest and nothing is known of them, and where the
/// run has no temperature.
fn origin<'a>(
    run: &Run,
    instructions: &Instructions,
    options: &'a Options,
    temperatures: &Temperatures,
    moving: Option<&Moving>,
    notes: &mut Vec<Note>,
) -> Result<Option<Origin<'a>>, LinError> {
    let (header, channel) = (&run.header, instructions.channels(&run.header).0);
    let own = || {
        let (order, bounds) = (instructions.order_of_sensor(header), instructions.slope_bounds);
        match moving? {
            m if m.is_moving() => Some(Origin::Run { order, bounds }),
            m if m.is_shown => Some(Origin::Rest(bounds)),
            _ => None,
        }
    };
    let Some(polynomials) = &options.temperature else { return Ok(own()) };
    let file = &polynomials.input.path;
    let other_channel = polynomials.channel.as_ref().filter(|own| **own != channel);
    let other_sensor = (&polynomials.sensor, &polynomials.mode) != (&header.sensor, &header.mode);
    if other_sensor || (other_channel.is_some() && temperatures.sensor_degc().is_some()) {
        let named = |sensor: &str, mode: &str, channel: &str| format!("{sensor} {mode} over {channel}");
        return Err(LinError::OtherSensor {
            file: file.clone(),
            of: named(
                &polynomials.sensor,
                &polynomials.mode,
                polynomials.channel.as_deref().unwrap_or("a channel that is not stated"),
            ),
            run: named(&header.sensor, &header.mode, &channel),
        });
    }
    let Some(moving) = moving else {
        let text = format!("{file} has no influence: the run has no sensor temperature");
        notes.push(Note::new(NoteKind::Temperature, text).about(file));
        return Ok(None);
    };
    if let Some(quantity) = polynomials.without_slope.as_ref().filter(|_| moving.is_shown) {
        let text = format!(
            "{file} tells no slope of {quantity}: its runs show none, and the order 0 was not given; the slopes of {file} are not used"
        );
        let note = Note::new(NoteKind::Temperature, text).about(file);
        // What that does to a sensor at rest is told where it matters.
        notes.extend(moving.is_moving().then(|| note.with_remedy("give the order with --order or in campaign.toml")));
        return Ok(own());
    }
    let ([low, high], [from, to]) = (moving.range_degc, polynomials.valid_degc);
    if low < from - AT_REST_K || high > to + AT_REST_K {
        let text = format!(
            "the sensor temperature, {low:.1} to {high:.1} °C, leaves the range of {file}, {from:.1} to {to:.1} °C: slopes are \
             extrapolated there, and their uncertainty with them"
        );
        notes.push(Note::new(NoteKind::Temperature, text).about(file));
    }
    Ok(Some(Origin::Polynomials(polynomials)))
}

/// First and last used time, s since the run's start.
fn span_s(used: &[&Plateau]) -> [f64; 2] {
    [
        used.iter().map(|p| p.used_s[0]).fold(f64::INFINITY, f64::min),
        used.iter().map(|p| p.used_s[1]).fold(f64::NEG_INFINITY, f64::max),
    ]
}

fn setup(prepared: &Prepared, used: &[&Plateau], plateaus: &Plateaus) -> Setup {
    let mut durations: Vec<f64> = used.iter().map(|p| p.setting.t_end_s - p.setting.t_start_s).collect();
    Setup {
        position: prepared.position_id,
        position_axes: prepared.position.names(),
        field_duration_s: median(&mut durations),
        settling_s: plateaus.settling_s,
        early_end_s: plateaus.early_end_s,
    }
}

/// Mean readings, a row per plateau, enT.
fn readings_ent(used: &[&Plateau]) -> DMatrix<f64> {
    DMatrix::from_fn(used.len(), 3, |row, component| used[row].mean.0[component])
}

fn noise_of_plateaus(noise: &DenseNoise) -> PlateauNoise {
    PlateauNoise {
        std_ent: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.std)),
        correlated_share: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.share)),
        effective_blocks: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.independent_rows)),
    }
}

fn validity(used: &[&Plateau], temperatures: &Temperatures, span_s: [f64; 2]) -> LinearValidity {
    let is_moving = temperatures.conditions.as_ref().is_some_and(|c| c.sensor_range_k.is_some());
    let near = |[_, at, _]: [f64; 3]| [at - 0.5 * AT_REST_K, at + 0.5 * AT_REST_K];
    LinearValidity {
        field_coil_nt: std::array::from_fn(|axis| extremes(used.iter().map(|p| p.setting.field.0[axis]))),
        // The parameters of a run that moved hold at one temperature.
        temperature_degc: if is_moving { temperatures.sensor_degc().map(near) } else { temperatures.sensor_range_degc() },
        time_s: span_s,
    }
}
