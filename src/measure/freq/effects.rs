//! Known effects in amplitudes, phases and -3 dB frequencies.

use super::amplitudes::within_a_turn_deg;
use crate::data::frequency::SineAmplitude;
use crate::measure::corner::Corner;
use crate::model::response::Response;
use crate::record::known::in_sines::InSines;

/// Takes known effects off an amplitude and its phase; the noise of the amplitude goes with it.
pub(super) fn take_off(known: &InSines, part: &mut SineAmplitude) {
    if known.is_empty() {
        return;
    }
    for i in 0..3 {
        let factor = known.factor(part.frequency_hz, i);
        part.b_ent[i] /= factor.norm();
        part.b_std_ent[i] /= factor.norm();
        if let Some(phase) = &mut part.phase_deg {
            phase[i] = within_a_turn_deg((phase[i] - factor.arg().to_degrees()) / 360.0);
        }
    }
}

/// Carries the uncertainty of known effects into amplitudes, phases and -3 dB frequencies. All amplitudes share it, so that it is no noise
/// and has no part in the fit of the response. Returns the standard uncertainties of the -3 dB frequencies.
pub(super) fn widen(known: &InSines, measured: &mut [SineAmplitude], corner: &Corner) -> [f64; 3] {
    for part in measured {
        for i in 0..3 {
            let [std, phase_std_rad] = known.factor_std(part.frequency_hz, i);
            part.b_std_ent[i] = part.b_std_ent[i].hypot(std * part.b_ent[i]);
            if let Some(std) = &mut part.phase_std_deg {
                std[i] = std[i].hypot(phase_std_rad.to_degrees());
            }
        }
    }
    let mut model_std_hz = corner.model_std_hz();
    let Some(response) = corner.model.and_then(Response::named) else { return model_std_hz };
    for i in 0..3 {
        let Some(model) = &corner.components[i].model else { continue };
        let shape: Vec<f64> = model.parameters.iter().map(|p| p.value).collect();
        let corner_hz = model.f_3db_model_hz;
        let [std, _] = known.factor_std(corner_hz, i);
        if std > 0.0 {
            let moved_hz = corner_hz * std / response.steepness(corner_hz, &shape);
            model_std_hz[i] = model_std_hz[i].hypot(moved_hz);
        }
    }
    model_std_hz
}
