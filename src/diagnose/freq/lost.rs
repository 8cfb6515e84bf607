//! Lost samples of a frequency run: in the counters, and in stretches that do not follow their sine.

use super::super::result::{Gap, Parameter, Step};
use super::CERTAIN;
use crate::data::run::Run;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{self, Oscillator};
use crate::measure::freq::Freq;
use crate::model::effects::lost_samples::LostSamples;
use crate::model::effects::{EffectRef, Spec};
use crate::record::scene::Samples;
use std::ops::Range;

/// A setting of which more than this part follows no sine is damaged.
const DAMAGED_PART: f64 = 0.05;
/// The begin of a setting may not follow its sine yet, s.
const SETTLING_S: f64 = 1.0;
/// A stretch follows a sine if its residuals, but for a tenth of them, are within this factor of those of another one.
const FOLLOWS: f64 = 2.0;

/// Settings with missing samples, or with stretches that do not follow their sine.
pub fn lost(run: &Run, samples: &Samples, freq: &Freq) -> Option<Step> {
    let mut damaged: Vec<(usize, String)> = Vec::new();
    let mut missing = 0;
    let rate_hz = freq.rate.as_ref().map_or(run.header.sample_rate_hz, |r| r.mean_hz);
    for (k, part) in freq.stretches.iter().enumerate() {
        let setting = &part.setting;
        let from = samples.t_s.partition_point(|t| *t < setting.t_start_s);
        let to = samples.t_s.partition_point(|t| *t < setting.t_end_s);
        let gaps: Vec<String> = (from + 1..to)
            .filter(|i| samples.n[*i] > samples.n[i - 1] + 1)
            .map(|i| {
                let lost = samples.n[i] - samples.n[i - 1] - 1;
                missing += lost;
                format!("{lost} samples missing at {:.1} s", samples.t_s[i - 1])
            })
            .collect();
        let length_s = setting.t_end_s - setting.t_start_s;
        let mut words = gaps;
        match part.used_s {
            Some(used_s)
                if length_s - (used_s[1] - used_s[0]) > DAMAGED_PART * length_s + SETTLING_S
                    && !follows(samples, from..to, used_s, setting.frequency_hz, rate_hz) =>
            {
                let [first, last] = used_s;
                words.push(format!("only {first:.1} to {last:.1} s follow one sine"));
            }
            None if length_s * setting.frequency_hz >= 2.0 => {
                let remark = freq.amplitude.get(k).map_or("", |a| a.remark.as_str());
                words.push(remark.to_owned());
            }
            _ => {}
        }
        if !words.is_empty() {
            damaged.push((k, format!("{} Hz: {}", setting.frequency_hz, words.join(", "))));
        }
    }
    if damaged.is_empty() {
        return None;
    }
    let list: Vec<String> = damaged.iter().map(|(_, words)| words.clone()).collect();
    let form = damaged
        .iter()
        .fold(Spec::new("stretches", &[]), |spec, (k, _)| spec.with("frequency", freq.stretches[*k].setting.frequency_hz, "Hz"));
    let count = |name: &str, value: f64| Parameter { name: name.to_owned(), value, std: None, unit: "1".to_owned() };
    let lost = EffectRef::new(&LostSamples);
    Some(Step {
        effect: lost,
        axes: COMPONENTS.map(str::to_owned).to_vec(),
        ambiguous_with: Vec::new(),
        form,
        further: Vec::new(),
        parameters: vec![count("damaged settings", damaged.len() as f64), count("missing samples", missing as f64)],
        place: list.join("; "),
        p_value: f64::MIN_POSITIVE,
        trials: freq.stretches.len(),
        p_value_corrected: f64::MIN_POSITIVE,
        gap_before: Gap::default(),
        gap_after: Gap::default(),
        // Every one of them is seen by itself.
        strength_k: CERTAIN + damaged.len() as f64,
        family: lost.about().family.name(),
        wording: "is",
        runners_up: Vec::new(),
        next_measurement: None,
        sentence: format!(
            "In {} of {} settings of run {} stretches are missing or do not follow their sine; amplitudes and phases rest on the rest.",
            damaged.len(),
            freq.stretches.len(),
            run.header.run
        ),
        covariate: None,
        shape: Vec::new(),
    })
}

/// What nine tenths of some values do not exceed.
fn most(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(9 * values.len() / 10).copied().unwrap_or(f64::NAN)
}

/// Whether nearly all of what a setting has beside its used stretch follows the sine of that: then single readings are far off, and nothing is
/// missing.
fn follows(samples: &Samples, setting: Range<usize>, used_s: [f64; 2], frequency_hz: f64, rate_hz: f64) -> bool {
    let is_used = |i: &usize| (used_s[0]..=used_s[1]).contains(&samples.t_s[*i]);
    let settled_s = samples.t_s.get(setting.start).map_or(0.0, |t| t + SETTLING_S);
    let used: Vec<usize> = setting.clone().filter(is_used).collect();
    let others: Vec<usize> = setting.filter(|i| !is_used(i) && samples.t_s[*i] > settled_s).collect();
    (0..3).all(|component| {
        let readings = |of: &[usize]| -> Vec<f64> { of.iter().map(|i| samples.reading_ent[*i][component]).collect() };
        let counters: Vec<u64> = used.iter().map(|i| samples.n[*i]).collect();
        let Ok(fit) = sine::three(&counters, &readings(&used), frequency_hz, rate_hz) else { return false };
        let mut oscillator = Oscillator::new(frequency_hz, rate_hz);
        let off: Vec<f64> = others
            .iter()
            .zip(readings(&others))
            .map(|(i, y)| {
                let [sin, cos] = oscillator.at(samples.n[*i]);
                (y - fit.offset - fit.sin * sin - fit.cos * cos).abs()
            })
            .collect();
        let own: Vec<f64> = fit.residuals.iter().map(|r| r.abs()).collect();
        !off.is_empty() && most(off) < FOLLOWS * most(own)
    })
}
