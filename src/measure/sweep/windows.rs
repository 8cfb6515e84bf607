//! The nine parameters in a sliding window of settings.

use super::fit::LIMITS;
use super::means::Means;
use super::options::Window;
use super::result::WindowFit;
use super::thermistors::{Series, rate_k_per_s};
use crate::data::plateau::Plateau;
use crate::data::run::interpolate;
use crate::fit::noise::NoiseModel;
use crate::fit::statistics::extremes;
use crate::fit::{DenseNoise, propagate};
use crate::measure::joint::SensorFit;
use crate::model::sensor::split;
use crate::record::baseline::Baseline;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Sliding windows by the thermistor as it was read and with its lag; those that do not determine the nine parameters are passed over.
/// `degc` are the temperatures of the settings, `joint` the polynomials of all of them, `noise` that of the settings.
pub(super) fn windows(
    (used, degc, joint, noise): (&[&Plateau], &[f64], &SensorFit, &DenseNoise),
    [read, moved]: [&Series; 2],
    r_nom: &Matrix3<f64>,
    window: Window,
) -> Vec<WindowFit> {
    let end_of = |from: usize| match window {
        Window::Settings(n) => from + n,
        Window::Minutes(minutes) => used.partition_point(|p| p.t_s() <= used[from].t_s() + 60.0 * minutes),
    };
    (0..used.len())
        .filter(|from| end_of(*from) <= used.len())
        .filter_map(|from| {
            let own = from..end_of(from);
            let rows: Vec<usize> = own.clone().collect();
            let noise = [0, 1, 2].map(|component| noise.covariance_of_rows(component, &rows));
            fit((&used[own.clone()], &degc[own], joint, &noise), [read, moved], r_nom)
        })
        .collect()
}

/// Refers the readings of a window to its mean temperature, as the polynomials tell: what the temperature makes of them within the window
/// is no noise, and it moves the sensitivities of the three components against each other.
fn refer(means: &mut Means, degc: &[f64], joint: &SensorFit) -> Option<()> {
    let at = |degc: f64| {
        let (sensor, b_or) = joint.sensor(degc).ok()?;
        Some((*sensor.response(), Vector3::from(b_or)))
    };
    let (response, b_or) = at(degc.iter().sum::<f64>() / degc.len() as f64)?;
    for (row, degc) in degc.iter().enumerate() {
        let (own_response, own_b_or) = at(*degc)?;
        let change = (response - own_response) * Vector3::from(means.fields_nt[row]) + b_or - own_b_or;
        (0..3).for_each(|component| means.readings_ent[(row, component)] += change[component]);
    }
    Some(())
}

/// The fit of one window; what varies slowly from setting to setting is in the covariance of its readings, and not in what it leaves itself.
fn fit(
    (own, degc, joint, noise): (&[&Plateau], &[f64], &SensorFit, &[DMatrix<f64>; 3]),
    [read, moved]: [&Series; 2],
    r_nom: &Matrix3<f64>,
) -> Option<WindowFit> {
    let mut means = Means::of(own);
    refer(&mut means, degc, joint)?;
    let baseline = Baseline::in_time(extremes(means.t_s.iter().copied()), 0);
    let fit = baseline.fit(&means.fields_nt, &means.t_s, &means.readings_ent, &LIMITS).ok()?;
    let phi = |x: &[f64]| baseline.responses(x).first()?.try_inverse();
    let quantities = |x: &[f64]| -> Vec<f64> {
        let parts = phi(x).and_then(|phi| split(&phi, r_nom).ok());
        parts.map_or(vec![f64::NAN; 9], |s| [s.sigma, s.xi_deg, [x[3], x[7], x[11]]].concat())
    };
    let by_reading = &fit.unscaled_covariance * baseline.columns(&means.fields_nt, &means.t_s).transpose();
    let of_component = noise.each_ref().map(|noise| &by_reading * noise * by_reading.transpose());
    let covariance = DMatrix::from_fn(12, 12, |r, c| if r / 4 == c / 4 { of_component[r / 4][(r % 4, c % 4)] } else { 0.0 });
    let stacked = fit.coefficients.as_slice().to_vec();
    let found = propagate(quantities, &stacked, &covariance).ok()?;
    let phi = phi(&stacked)?;
    let residual_nt = std::array::from_fn(|k| {
        let squares = (0..own.len()).map(|r| (0..3).map(|i| phi[(k, i)] * fit.residuals[(r, i)]).sum::<f64>().powi(2));
        (squares.sum::<f64>() / fit.dof.max(1) as f64).sqrt()
    });
    let mean = |series: &[(f64, f64)]| own.iter().map(|p| interpolate(series, p.t_s())).sum::<f64>() / own.len() as f64;
    let t_s = own.iter().map(|p| p.t_s()).sum::<f64>() / own.len() as f64;
    Some(WindowFit {
        t_s,
        temperature_degc: [mean(read), mean(moved)],
        heating: rate_k_per_s(read, t_s) > 0.0,
        values: found.values.try_into().ok()?,
        std: found.std.try_into().ok()?,
        residual_nt,
    })
}
