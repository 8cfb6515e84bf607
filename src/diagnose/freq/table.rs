//! Tables of amplitudes: their outliers, and the response that the rest has.

use crate::data::tables::AmplitudeRow;
use crate::data::units::COMPONENTS;
use crate::diagnose::DiagnoseError;
use crate::diagnose::result::{Diagnosis, Gap, Map, NotIdentifiable, Parameter, Pictures, Step, Telling, VerdictKind};
use crate::diagnose::steps::{Facts, Name, Significance};
use crate::diagnose::words;
use crate::measure::corner::Component;
use crate::measure::freq::{self as analysis, Freq};
use crate::model::effects::lost_samples::LostSamples;
use crate::model::effects::{Catalogue, EffectRef, Spec};

/// Rows of a table with less weight in the response are outliers.
const OUTLIER: f64 = 0.5;
/// Amplitudes beyond the parameters of a response without which nothing can stand out: one that is wrong and two that disagree with it.
const FEWEST_BEYOND: usize = 3;

/// Diagnoses a table of amplitudes; `id` names it.
///
/// # Errors
/// The table has so few amplitudes that any would follow a response.
pub fn table(rows: &[AmplitudeRow], id: &str) -> Result<Diagnosis, DiagnoseError> {
    let freq = analysis::from_table(rows, id);
    is_overdetermined(rows, &freq)?;
    let outliers = outliers(rows, &freq);
    let noise_ent: [f64; 3] =
        std::array::from_fn(|i| freq.corner.components[i].model.as_ref().map_or(f64::NAN, |m| m.residual_std_ent));
    let maps = maps(rows, &freq, &outliers);
    let steps: Vec<Step> = if outliers.is_empty() { Vec::new() } else { vec![step(rows, &freq, &outliers, noise_ent)] };
    let pictures = Pictures { left: if steps.is_empty() { maps.clone() } else { Vec::new() }, ..Pictures::default() };
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![id.to_owned()],
        noise_floor_nt: noise_ent,
        noise: None,
        basis: None,
        verdict: words::verdict(&steps, None, None),
        verdict_kind: VerdictKind::of(&steps, None),
        left: None,
        gap_chain: Vec::new(),
        steps,
        not_identifiable: not_identifiable(),
        detection_limits: Vec::new(),
        response: Some(response_words(&freq)),
        notes: freq.notes,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        pictures,
    })
}

/// At least one component has more amplitudes than its response can follow.
fn is_overdetermined(rows: &[AmplitudeRow], freq: &Freq) -> Result<(), DiagnoseError> {
    let amplitudes = |i: usize| (0..rows.len()).filter(|row| freq.amplitude[*row].detected[i]).count();
    let found = (0..3).map(amplitudes).max().unwrap_or(0);
    let of_component = |component: &Component| component.model.as_ref().map(|m| 1 + m.parameters.len() + FEWEST_BEYOND);
    let needed = freq.corner.components.iter().filter_map(of_component).min().ok_or(DiagnoseError::NoResponse)?;
    if found < needed { Err(DiagnoseError::FewAmplitudes { found, needed }) } else { Ok(()) }
}

/// A row that does not follow the response, by its index, in words.
struct Outlier {
    row: usize,
    words: String,
}

fn is_outlier(outliers: &[Outlier], row: usize) -> bool {
    outliers.iter().any(|o| o.row == row)
}

fn outliers(rows: &[AmplitudeRow], freq: &Freq) -> Vec<Outlier> {
    let of_row = |(row, amplitude): (usize, &AmplitudeRow)| {
        let of_component = |i: usize| {
            let model = freq.corner.components[i].model.as_ref()?;
            let is_out = freq.amplitude[row].detected[i] && model.weight[row] < OUTLIER;
            is_out.then(|| {
                format!("{} {:.2} instead of {:.2} enT", COMPONENTS[i], amplitude.amplitude_ent[i], model.fitted_ent[row])
            })
        };
        let parts: Vec<String> = (0..3).filter_map(of_component).collect();
        (!parts.is_empty()).then(|| Outlier { row, words: format!("{} Hz ({})", amplitude.frequency_hz, parts.join(", ")) })
    };
    rows.iter().enumerate().filter_map(of_row).collect()
}

/// What the response leaves of the amplitudes, with and without the outliers.
fn maps(rows: &[AmplitudeRow], freq: &Freq, outliers: &[Outlier]) -> Vec<Map> {
    let of_component = |(axis, component): (usize, &Component)| {
        let model = component.model.as_ref()?;
        let kept = |k: usize| if is_outlier(outliers, k) { f64::NAN } else { model.residual_ent[k] };
        Some(Map {
            covariate: "frequency".to_owned(),
            unit: "Hz".to_owned(),
            axis,
            x: rows.iter().map(|r| r.frequency_hz).collect(),
            before_nt: model.residual_ent.clone(),
            after_nt: (0..rows.len()).map(kept).collect(),
            noise_nt: model.residual_std_ent,
            step: 0,
            names: Vec::new(),
        })
    };
    freq.corner.components.iter().enumerate().filter_map(of_component).collect()
}

/// What the response leaves of the amplitudes in rows that are kept.
fn gap(freq: &Freq, is_kept: impl Fn(usize) -> bool) -> Gap {
    let mut gap = Gap::default();
    for (i, component) in freq.corner.components.iter().enumerate() {
        let Some(model) = &component.model else { continue };
        let kept = model.residual_ent.iter().enumerate().filter(|(k, r)| r.is_finite() && is_kept(*k));
        let residuals: Vec<f64> = kept.map(|(_, r)| *r).collect();
        let squares = residuals.iter().map(|r| r * r).sum::<f64>();
        gap.rms_nt[i] = (squares / residuals.len().max(1) as f64).sqrt();
        gap.max_nt = residuals.iter().fold(gap.max_nt, |m, r| m.max(r.abs()));
        gap.chi2_per_dof += squares / (3.0 * residuals.len().max(1) as f64 * model.residual_std_ent.powi(2));
    }
    gap
}

/// The step that describes the outliers.
fn step(rows: &[AmplitudeRow], freq: &Freq, outliers: &[Outlier], noise_ent: [f64; 3]) -> Step {
    let components = || freq.corner.components.iter();
    let residuals = outliers.iter().flat_map(|o| components().filter_map(|c| Some(c.model.as_ref()?.residual_ent[o.row])));
    let largest = residuals.fold(0.0_f64, |m, r| if r.abs() > m.abs() { r } else { m });
    let least_noise_ent = noise_ent.iter().copied().fold(f64::INFINITY, f64::min);
    let list: Vec<&str> = outliers.iter().map(|o| o.words.as_str()).collect();
    let form = Spec::new("outliers", &[]);
    let form = outliers.iter().fold(form, |spec, o| spec.with("frequency", rows[o.row].frequency_hz, "Hz"));
    Facts {
        axes: COMPONENTS.to_vec(),
        parameters: vec![Parameter {
            name: "outlying amplitudes".to_owned(),
            value: outliers.len() as f64,
            std: None,
            unit: "1".to_owned(),
        }],
        place: list.join("; "),
        gaps: [gap(freq, |_| true), gap(freq, |row| !is_outlier(outliers, row))],
        name: Name::Doubted,
        next_measurement: Some("the runs with these amplitudes as waveforms, or these frequencies once more".to_owned()),
        telling: Telling::always(format!(
            "{} of {} frequencies do not follow the response, as amplitudes of stretches with lost samples or of two settings do not.",
            outliers.len(),
            rows.len()
        )),
        ..Facts::new(EffectRef::new(&LostSamples), form, Significance::seen(rows.len(), largest.abs() / least_noise_ent))
    }
    .step()
}

/// Everything but outliers.
fn not_identifiable() -> Vec<NotIdentifiable> {
    let reason = "a table of amplitudes has neither samples nor times nor uncertainties; what the response leaves is the only measure of noise";
    let catalogue = Catalogue::default();
    let others = catalogue.iter().filter(|effect| !effect.is(&LostSamples));
    others.map(|effect| NotIdentifiable { effect, reason: reason.to_owned() }).collect()
}

/// The response in words, with its -3 dB frequencies.
fn response_words(freq: &Freq) -> String {
    let corners: Vec<String> = (0..3)
        .map(|i| format!("{} {:.2} ± {:.2} Hz", COMPONENTS[i], freq.values.f_3db_model_hz[i], freq.values.f_3db_model_std_hz[i]))
        .collect();
    format!("{}, -3 dB at {}", freq.corner.response().name, corners.join(", "))
}
