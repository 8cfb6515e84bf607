//! The linear calibration of one run: `B_r = A B_c + Σ p_k τ^k` over plateau means, `Φ = A⁻¹`, and its split.

mod derived;
mod fit;
mod judge;
mod options;
mod prepare;
mod refusal;
mod result;

pub use options::Options;
pub use refusal::LinError;
pub use result::{Block, Lin};

use crate::data::calibration::{LinearCalibration, LinearQuality, LinearValidity, OffsetTrend, PlateauNoise, Setup};
use crate::data::note::Note;
use crate::data::plateau::{Plateau, Plateaus};
use crate::data::run::Run;
use crate::data::units::COMPONENTS;
use crate::fit::DenseNoise;
use crate::fit::statistics::{extremes, median};
use crate::model::campaign::Instructions;
use crate::model::sensor::Split;
use crate::record::conditions::{self, Temperatures};
use derived::{Derived, Parameters};
use fit::{Means, check_followed, fit, stack};
use prepare::{Prepared, trend_order};

/// A sensitivity outside this factor of the nominal conversion means a wrong unit or factor.
const PLAUSIBLE_GAIN: f64 = 1.5;

/// Fits one run.
///
/// # Errors
/// [`LinError`]: the run is refused, with the reason and what to do.
pub fn lin(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Lin, LinError> {
    let order = trend_order(run, plateaus, instructions, options)?;
    let mut notes: Vec<Note> = Vec::new();
    let prepared = Prepared::of(run, plateaus, instructions, options, &mut notes)?;
    let used = prepared.used(order)?;

    let means = Means::of(&used, order);
    let fitted = fit(&used, &means, options.robust)?;
    if !options.allow_mismatch {
        check_followed(&used, &fitted.solution)?;
    }
    let noise = conditions::noise(fitted.for_noise(), &used).map_err(LinError::Fit)?;
    let stacked = stack(&fitted.solution.coefficients);
    let r_nom = prepared.position.r_nom();
    let derived = Derived::of(&stacked, &means, &r_nom)?;
    let covariance = prepared.covariance(&noise, &means, &used).map_err(LinError::Fit)?;
    let parameters = Parameters::of(derived, &stacked, &covariance, &means, &r_nom)?;
    if !options.allow_gain {
        check_gain(&parameters.split)?;
    }
    let blocks = judge::blocks(&prepared.list, &fitted.weights, &parameters.split, &means, &stacked)?;

    let span_s = span_s(&used);
    let temperatures = Temperatures::of(run, instructions, span_s, &mut notes);
    judge::warn_of_axes(&mut notes, &parameters.split);
    conditions::warn_of_plateaus(&mut notes, run, plateaus);
    conditions::warn_of_run(&mut notes, run);
    judge::judge_fit(&mut notes, &blocks);
    if !options.robust {
        notes.extend(judge::structure_of(&temperatures, &prepared.list, &used, &means, &noise));
    }
    notes.extend(judge::rounding_of(&used, &noise));
    conditions::warn_of_slow_noise(&mut notes, &noise, span_s);

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
        noise: noise_of_plateaus(&noise),
        valid: validity(&used, &temperatures, span_s),
        reference: None,
    };
    let stated = instructions.references.get(&run.header.sensor);
    calibration.reference = stated.and_then(|stated| stated.in_frame_of(&calibration.alignment()).ok());
    Ok(Lin {
        calibration,
        facility: prepared.facility,
        linearisation: prepared.linearisation,
        model: prepared.known.map(|k| k.part),
        dropped: conditions::dropped(&prepared.list),
        notes,
        blocks,
        temperatures,
        given: plateaus.clone(),
        samples: None,
    })
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

fn noise_of_plateaus(noise: &DenseNoise) -> PlateauNoise {
    PlateauNoise {
        std_ent: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.std)),
        correlated_share: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.share)),
        effective_blocks: std::array::from_fn(|a| noise.noise.get(a).map_or(f64::NAN, |n| n.independent_rows)),
    }
}

fn validity(used: &[&Plateau], temperatures: &Temperatures, span_s: [f64; 2]) -> LinearValidity {
    LinearValidity {
        field_coil_nt: std::array::from_fn(|axis| extremes(used.iter().map(|p| p.setting.field.0[axis]))),
        temperature_degc: temperatures.sensor_range_degc(),
        time_s: span_s,
    }
}

/// A sensitivity far from the nominal one means a wrong unit or factor.
fn check_gain(split: &Split) -> Result<(), LinError> {
    for (component, sigma) in COMPONENTS.into_iter().zip(split.sigma) {
        if !(1.0 / PLAUSIBLE_GAIN..=PLAUSIBLE_GAIN).contains(&sigma) {
            return Err(LinError::Gain { component, sigma });
        }
    }
    Ok(())
}
