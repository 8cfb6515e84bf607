//! At which temperature a -3 dB frequency holds where the temperature of the sensor moves during the run.
//!
//! One frequency after the other is applied, each at a temperature of its own. A response whose frequencies all move by the same part, as an
//! f_3dB that follows the temperature moves them, changes every amplitude by its own share; the fit makes a change of f_3dB of each
//! share, and these sum up to one. With these weights the mean of the temperatures of the sines is the temperature at which f_3dB
//! holds, whatever its slope is, as long as that is the same over the range. What the gain follows of the temperature is not in it.

use crate::data::frequency::SineAmplitude;
use crate::data::note::{Note, NoteKind};
use crate::data::run::mean_over;
use crate::data::units::COMPONENTS;
use crate::fit::smooth::Course;
use crate::fit::{Limits, order};
use crate::measure::corner::{Corner, DECIDING, ModelCorner};
use crate::model::response::{RESPONSES, Response};
use nalgebra::{DMatrix, DVector};

/// Highest order of the course of a temperature at rest.
const REST_ORDER: usize = 3;

/// Temperatures of the -3 dB frequencies of the models by the course of the sensor temperature, (s, °C); nan where a component has none.
pub(super) fn of_corners(corner: &Corner, measured: &[SineAmplitude], course: &[(f64, f64)]) -> [f64; 3] {
    let degc: Vec<f64> = measured.iter().map(|a| a.used_s.map_or(f64::NAN, |used| mean_over(course, used))).collect();
    let response = RESPONSES.iter().find(|r| Some(r.name) == corner.model);
    std::array::from_fn(|c| {
        let model = corner.components[c].model.as_ref().zip(response);
        model
            .and_then(|(model, response)| of_corner(model, *response, corner.explained.is_some(), measured, c, &degc))
            .unwrap_or(f64::NAN)
    })
}

/// The course of the sensor temperature, (s, °C): its readings where it moves; where it is at rest a polynomial through them, since few sines have most of
/// the influence and the noise of the thermometer in their time is more than what the temperature does. `None` where it stands still.
pub(super) fn course(readings: &[(f64, f64)], is_at_rest: bool) -> Option<Vec<(f64, f64)>> {
    if !is_at_rest {
        return Some(Course::smooth(readings).series);
    }
    let (t_s, degc): (Vec<f64>, Vec<f64>) = readings.iter().copied().unzip();
    let found = order::choose(&t_s, &degc, None, REST_ORDER, None, &Limits::default()).ok()?;
    let value = |t_s: f64| (t_s, found.polynomial.evaluate_unscaled(t_s).0);
    (found.order > 0).then(|| t_s.into_iter().map(value).collect())
}

/// Temperature of the -3 dB frequency of a component.
fn of_corner(
    model: &ModelCorner,
    response: Response,
    is_explained: bool,
    measured: &[SineAmplitude],
    component: usize,
    degc: &[f64],
) -> Option<f64> {
    let parameters: Vec<f64> = model.parameters.iter().map(|p| p.value).collect();
    let count = 1 + parameters.len();
    let kinds = response.parameters();
    let used: Vec<usize> = (0..measured.len()).filter(|i| model.weight[*i] > 0.0 && degc[*i].is_finite()).collect();
    let mut derivatives = DMatrix::zeros(used.len(), count);
    let mut scaled = DMatrix::zeros(used.len(), count);
    // What a relative change of all frequencies of the response makes of every amplitude.
    let mut by_frequency = DVector::zeros(used.len());
    for (row, i) in used.iter().enumerate() {
        let (value, slopes) = response.value_and_slopes(measured[*i].frequency_hz, &parameters);
        let scatter = match is_explained {
            true => 0.0,
            false if value < DECIDING => model.stop_residual_std_ent,
            false => model.residual_std_ent,
        };
        let std_ent = measured[*i].b_std_ent[component];
        let variance = scatter.powi(2) + if std_ent.is_finite() { std_ent.powi(2) } else { 0.0 };
        let weight = model.weight[*i] / variance;
        for k in 0..count {
            derivatives[(row, k)] = if k == 0 { value } else { slopes[k - 1] };
            scaled[(row, k)] = derivatives[(row, k)] * weight;
        }
        by_frequency[row] = kinds.iter().zip(slopes).filter(|(kind, _)| kind.unit == "Hz").map(|(_, slope)| slope).sum();
    }
    let normal = scaled.tr_mul(&derivatives);
    // Parameters differ in how well they are known by orders of magnitude.
    let scale = normal.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
    let scaled_normal = DMatrix::from_fn(count, count, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let slopes = response.corner_slopes(model.f_3db_model_hz, &parameters);
    let of_corner = DVector::from_fn(count, |k, _| if k == 0 { 0.0 } else { slopes[k - 1] * scale[k] });
    let influence = scaled_normal.cholesky()?.solve(&of_corner).component_mul(&scale);
    let shares = (scaled * influence).component_mul(&by_frequency);
    let sum = shares.sum();
    let mean = shares.iter().zip(&used).map(|(share, i)| share * degc[*i]).sum::<f64>() / sum;
    mean.is_finite().then_some(mean)
}

/// Says of a sensor temperature that moved what it means.
pub(super) fn note(range_k: f64, corners_degc: Option<&[f64; 3]>) -> Note {
    let corners = corners_degc.map_or_else(String::new, |degc| {
        let at: Vec<String> = COMPONENTS.iter().zip(degc).map(|(name, degc)| format!("{name} {degc:.1}")).collect();
        format!("; the -3 dB frequencies of the model hold at {} °C, those by interpolation at about the same", at.join(", "))
    });
    let text = format!(
        "the sensor temperature moved by {range_k:.1} K while one frequency after the other was applied: amplitudes belong to no single \
         temperature{corners}; what the gain follows of the temperature in between is in no uncertainty"
    );
    Note::new(NoteKind::Temperature, text).with_remedy("measure at a steady temperature")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;
    use crate::measure::corner::{self, Amplitude};

    /// Sines of 2013 at temperatures that rise while they are applied, through a response whose f_3dB falls by 0.02 Hz/K.
    #[test]
    fn a_corner_holds_at_the_temperature_of_the_sines_that_tell_it() {
        let response = RESPONSES.iter().find(|r| r.name == "first order").copied().unwrap();
        let at = |degc: f64| 58.0 - 0.02 * degc;
        let frequencies: Vec<f64> = (0..31).map(|k| 0.5 * 10f64.powf(f64::from(k) / 11.0)).collect();
        let degc = |k: usize| 20.0 + 33.0 * k as f64 / 30.0;
        let row = |(k, f): (usize, &f64)| {
            let value = 1000.0 * response.value(*f, &[at(degc(k))]);
            // More than the temperature makes of any amplitude, 2 enT: no row stands out, and every row has the same weight.
            Amplitude { frequency_hz: *f, amplitude_ent: [value; 3], std_ent: [5.0; 3], t_s: f64::NAN, usable: true }
        };
        let table: Vec<Amplitude> = frequencies.iter().enumerate().map(row).collect();
        let options = corner::Options { responses: vec![response], ..corner::Options::default() };
        let corner = corner::corner(&table, &options);
        let sine = |(k, a): (usize, &Amplitude)| SineAmplitude {
            frequency_hz: a.frequency_hz,
            b_ent: a.amplitude_ent,
            applied_nt: None,
            b_std_ent: a.std_ent,
            phase_deg: None,
            phase_std_deg: None,
            phase_counter: None,
            used: true,
            weight: [1.0; 3],
            detected: [true; 3],
            alias_hz: None,
            used_s: Some([60.0 * k as f64, 60.0 * (k + 1) as f64]),
            samples: None,
            remark: String::new(),
        };
        let measured: Vec<SineAmplitude> = table.iter().enumerate().map(sine).collect();
        let readings: Vec<(f64, f64)> =
            (0..95).map(|i| (20.0 * f64::from(i), degc(0) + 33.0 * (20.0 * f64::from(i) - 30.0) / 1800.0)).collect();
        let found = corner.components[0].model.as_ref().unwrap().f_3db_model_hz;
        let [holds_degc, ..] = of_corners(&corner, &measured, &readings);
        let mean_degc = 36.5;
        let [unexplained, left] = [mean_degc, holds_degc].map(|degc| (found - at(degc)).abs());
        assert!(unexplained > 0.05, "{found} {}", at(mean_degc));
        // What is left is of second order: f_3dB changes by 1.2 % in the run, and so much of the first order, times a small number.
        assert!(left < 0.06 * unexplained, "{left} {unexplained}");
    }

    /// Thirty readings with a noise of 0.03 K: a temperature that stands still has no course in most runs, and that of one that moves by 0.6 K is known
    /// to a few hundredths of a kelvin everywhere.
    #[test]
    fn the_course_of_a_temperature_at_rest_is_smooth() {
        let mut random = Random::seeded(4);
        let mut readings = |range_k: f64| -> Vec<(f64, f64)> {
            (0..30).map(|i| (20.0 * f64::from(i), 20.0 + range_k * f64::from(i) / 29.0 + 0.03 * random.gaussian())).collect()
        };
        let still = (0..200).filter(|_| course(&readings(0.0), true).is_none()).count();
        assert!(still > 160, "{still}");
        for _ in 0..20 {
            let found = course(&readings(0.6), true).unwrap();
            assert!(found.iter().all(|(t_s, degc)| (degc - 20.0 - 0.6 * t_s / 580.0).abs() < 0.06), "{found:?}");
        }
    }
}
