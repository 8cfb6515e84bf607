//! Tables of amplitudes: their outliers, and the response that the rest has.

use super::super::result::{Diagnosis, Gap, Map, NotIdentifiable, Parameter, Pictures, Step};
use super::words;
use crate::data::tables::AmplitudeRow;
use crate::data::units::COMPONENTS;
use crate::measure::freq as analysis;
use crate::model::effects::lost_samples::LostSamples;
use crate::model::effects::{Catalogue, EffectRef, Spec};

/// Rows of a table with less weight in the response are outliers.
const OUTLIER: f64 = 0.5;

/// Diagnoses a table of amplitudes; `id` names it.
#[must_use]
pub fn table(rows: &[AmplitudeRow], id: &str) -> Diagnosis {
    let freq = analysis::from_table(rows, id);
    let part = &freq.corner.response();
    let mut maps = Vec::new();
    let mut noise_floor_nt = [f64::NAN; 3];
    let mut outlying: Vec<(usize, String)> = Vec::new();
    for (row, amplitude) in rows.iter().enumerate() {
        let parts: Vec<String> = (0..3)
            .filter_map(|i| {
                let model = freq.corner.components[i].model.as_ref()?;
                let is_out = freq.amplitude[row].detected[i] && model.weight[row] < OUTLIER;
                is_out.then(|| {
                    format!("{} {:.2} instead of {:.2} enT", COMPONENTS[i], amplitude.amplitude_ent[i], model.fitted_ent[row])
                })
            })
            .collect();
        if !parts.is_empty() {
            outlying.push((row, format!("{} Hz ({})", amplitude.frequency_hz, parts.join(", "))));
        }
    }
    let (mut before, mut after) = (Gap::default(), Gap::default());
    for (i, component) in freq.corner.components.iter().enumerate() {
        let Some(model) = &component.model else { continue };
        noise_floor_nt[i] = model.residual_std_ent;
        let of = |keep: &dyn Fn(usize) -> bool| -> Vec<f64> {
            model.residual_ent.iter().enumerate().filter(|(k, r)| r.is_finite() && keep(*k)).map(|(_, r)| *r).collect()
        };
        let (all, kept) = (of(&|_| true), of(&|k| !outlying.iter().any(|(row, _)| *row == k)));
        for (gap, residuals) in [(&mut before, &all), (&mut after, &kept)] {
            let squares = residuals.iter().map(|r| r * r).sum::<f64>();
            gap.rms_nt[i] = (squares / residuals.len().max(1) as f64).sqrt();
            gap.max_nt = residuals.iter().fold(gap.max_nt, |m, r| m.max(r.abs()));
            gap.chi2_per_dof += squares / (3.0 * residuals.len().max(1) as f64 * model.residual_std_ent.powi(2));
        }
        maps.push(Map {
            covariate: "frequency".to_owned(),
            unit: "Hz".to_owned(),
            axis: i,
            x: rows.iter().map(|r| r.frequency_hz).collect(),
            before_nt: model.residual_ent.clone(),
            after_nt: (0..rows.len())
                .map(|k| if outlying.iter().any(|(row, _)| *row == k) { f64::NAN } else { model.residual_ent[k] })
                .collect(),
            noise_nt: model.residual_std_ent,
            step: 0,
        });
    }
    let lost = EffectRef::new(&LostSamples);
    let steps: Vec<Step> = if outlying.is_empty() {
        Vec::new()
    } else {
        let largest = outlying
            .iter()
            .flat_map(|(row, _)| freq.corner.components.iter().filter_map(|c| Some(c.model.as_ref()?.residual_ent[*row])))
            .fold(0.0_f64, |m, r| if r.abs() > m.abs() { r } else { m });
        let floor = noise_floor_nt.iter().copied().fold(f64::INFINITY, f64::min);
        let list: Vec<String> = outlying.iter().map(|(_, words)| words.clone()).collect();
        vec![Step {
            effect: lost,
            axes: COMPONENTS.map(str::to_owned).to_vec(),
            ambiguous_with: Vec::new(),
            form: outlying
                .iter()
                .fold(Spec::new("outliers", &[]), |spec, (row, _)| spec.with("frequency", rows[*row].frequency_hz, "Hz")),
            further: Vec::new(),
            parameters: vec![Parameter {
                name: "outlying amplitudes".to_owned(),
                value: outlying.len() as f64,
                std: None,
                unit: "1".to_owned(),
            }],
            place: list.join("; "),
            p_value: f64::MIN_POSITIVE,
            trials: rows.len(),
            p_value_corrected: f64::MIN_POSITIVE,
            gap_before: before,
            gap_after: after,
            strength_k: largest.abs() / floor,
            family: lost.about().family.name(),
            wording: "consistent with",
            runners_up: Vec::new(),
            next_measurement: Some("the runs with these amplitudes as waveforms, or these frequencies once more".to_owned()),
            sentence: format!(
                "{} of {} frequencies do not follow the response, as amplitudes of stretches with lost samples or of two settings do not.",
                outlying.len(),
                rows.len()
            ),
            covariate: None,
            shape: Vec::new(),
        }]
    };
    let corners: Vec<String> = (0..3)
        .map(|i| format!("{} {:.2} ± {:.2} Hz", COMPONENTS[i], freq.f_3db_model_hz[i], freq.f_3db_model_std_hz[i]))
        .collect();
    let reason = "a table of amplitudes has neither samples nor times nor uncertainties; what the response leaves is the only measure of noise";
    let not_identifiable = Catalogue::default()
        .iter()
        .filter(|effect| *effect != lost)
        .map(|effect| NotIdentifiable { effect, reason: reason.to_owned() })
        .collect();
    let pictures = Pictures { left: if steps.is_empty() { maps.clone() } else { Vec::new() }, ..Pictures::default() };
    Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![id.to_owned()],
        noise_floor_nt,
        noise: None,
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits: Vec::new(),
        response: Some(format!("{}, -3 dB at {}", part.name, corners.join(", "))),
        warnings: freq.notes.iter().map(ToString::to_string).collect(),
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        pictures,
    }
}
