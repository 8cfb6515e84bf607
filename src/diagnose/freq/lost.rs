//! Lost samples of a frequency run: in the counters, and in stretches that do not follow their sine.

use crate::data::run::Run;
use crate::data::units::COMPONENTS;
use crate::diagnose::CERTAIN;
use crate::diagnose::result::{Parameter, Step, Telling};
use crate::diagnose::steps::{Facts, Name, Significance};
use crate::fit::sine::{self, Oscillator};
use crate::measure::freq::Freq;
use crate::model::effects::lost_samples::LostSamples;
use crate::model::effects::{EffectRef, Spec};
use crate::record::prepared::Samples;
use std::ops::Range;

/// A setting of which more than this part follows no sine is damaged.
const DAMAGED_PART: f64 = 0.05;
/// The begin of a setting may not follow its sine yet, s.
const SETTLING_S: f64 = 1.0;
/// A setting of fewer cycles has no sine to follow.
const LEAST_CYCLES: f64 = 2.0;
/// A stretch follows a sine if its residuals, but for a tenth of them, are within this factor of those of another one.
const FOLLOWS: f64 = 2.0;

/// Settings with missing samples, or with stretches that do not follow their sine.
pub fn lost(run: &Run, samples: &Samples, freq: &Freq) -> Option<Step> {
    let rate_hz = freq.values.mean_f_s_hz.unwrap_or(run.header.sample_rate_hz);
    let mut damaged: Vec<(f64, String)> = Vec::new();
    let (mut missing, mut without_gap) = (0, 0);
    for (k, part) in freq.stretches.iter().enumerate() {
        let setting = &part.setting;
        let at = |t_s: f64| samples.t_s.partition_point(|t| *t < t_s);
        let range = at(setting.t_start_s)..at(setting.t_end_s);
        let gaps = gaps(samples, range.clone());
        missing += gaps.iter().map(|(lost, _)| lost).sum::<u64>();
        let mut words: Vec<String> = gaps.iter().map(|(lost, t_s)| format!("{lost} samples missing at {t_s:.1} s")).collect();
        let length_s = setting.t_end_s - setting.t_start_s;
        match part.used_s {
            Some(used_s)
                if length_s - (used_s[1] - used_s[0]) > DAMAGED_PART * length_s + SETTLING_S
                    && !follows(samples, range, used_s, setting.frequency_hz, rate_hz) =>
            {
                let [first, last] = used_s;
                words.push(format!("only {first:.1} to {last:.1} s follow one sine"));
            }
            None if length_s * setting.frequency_hz >= LEAST_CYCLES => {
                let remark = freq.amplitude.get(k).map_or("", |a| a.remark.as_str());
                words.push(remark.to_owned());
            }
            _ => {}
        }
        if !words.is_empty() {
            without_gap += usize::from(gaps.is_empty());
            damaged.push((setting.frequency_hz, format!("{} Hz: {}", setting.frequency_hz, words.join(", "))));
        }
    }
    (!damaged.is_empty()).then(|| step(run, freq, &damaged, (missing, without_gap)))
}

/// Samples missing between the samples of a range: how many, and at which time, s.
fn gaps(samples: &Samples, range: Range<usize>) -> Vec<(u64, f64)> {
    let after_gap = (range.start + 1..range.end).filter(|i| samples.n[*i] > samples.n[i - 1] + 1);
    after_gap.map(|i| (samples.n[i] - samples.n[i - 1] - 1, samples.t_s[i - 1])).collect()
}

/// The step that describes damaged settings, by their frequency and in words, with the samples that the counter misses and the settings in which it
/// misses none.
fn step(run: &Run, freq: &Freq, damaged: &[(f64, String)], (missing, without_gap): (u64, usize)) -> Step {
    let list: Vec<&str> = damaged.iter().map(|(_, words)| words.as_str()).collect();
    let form = Spec::new("stretches", &[]);
    let form = damaged.iter().fold(form, |spec, (frequency_hz, _)| spec.with("frequency", *frequency_hz, "Hz"));
    let count = |name: &str, value: f64| Parameter { name: name.to_owned(), value, std: None, unit: "1".to_owned() };
    // Every one of them is seen by itself.
    let significance = Significance::seen(freq.stretches.len(), CERTAIN + damaged.len() as f64);
    // Where no counter jumps, a field, a sensor or a clock that changes inside a setting is another explanation.
    let (name, what, why) = if without_gap == 0 {
        (Name::Certain, "are missing or do not follow their sine", "".to_owned())
    } else {
        let of_them = if missing > 0 { format!(" in {without_gap} of them") } else { String::new() };
        let why = format!(", and the counter misses no sample{of_them}: what changed inside them is not known");
        (Name::Doubted, if missing > 0 { "are missing or do not follow their sine" } else { "do not follow their sine" }, why)
    };
    Facts {
        axes: COMPONENTS.to_vec(),
        parameters: vec![count("damaged settings", damaged.len() as f64), count("missing samples", missing as f64)],
        place: list.join("; "),
        name,
        telling: Telling::always(format!(
            "In {} of {} settings of run {} stretches {what}{why}; amplitudes and phases rest on the rest.",
            damaged.len(),
            freq.stretches.len(),
            run.header.run
        )),
        ..Facts::new(EffectRef::new(&LostSamples), form, significance)
    }
    .step()
}

/// What nine tenths of some values do not exceed.
fn most(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(9 * values.len() / 10).copied().unwrap_or(f64::NAN)
}

/// Whether nearly all of what a setting has beside its used stretch follows the sine of that: then single readings are far off, and nothing is
/// missing. The clock may run a little faster or slower than on the average of the run: then the whole setting follows a sine of its own
/// frequency, as none does in which samples are missing.
fn follows(samples: &Samples, setting: Range<usize>, used_s: [f64; 2], frequency_hz: f64, rate_hz: f64) -> bool {
    let is_used = |i: &usize| (used_s[0]..=used_s[1]).contains(&samples.t_s[*i]);
    let settled_s = samples.t_s.get(setting.start).map_or(0.0, |t| t + SETTLING_S);
    let used: Vec<usize> = setting.clone().filter(is_used).collect();
    let settled: Vec<usize> = setting.filter(|i| is_used(i) || samples.t_s[*i] > settled_s).collect();
    let others: Vec<usize> = settled.iter().copied().filter(|i| !is_used(i)).collect();
    (0..3).all(|component| {
        let readings = |of: &[usize]| -> Vec<f64> { of.iter().map(|i| samples.reading_ent[*i][component]).collect() };
        let counters = |of: &[usize]| -> Vec<u64> { of.iter().map(|i| samples.n[*i]).collect() };
        let Ok(fit) = sine::three(&counters(&used), &readings(&used), frequency_hz, rate_hz) else { return false };
        let mut oscillator = Oscillator::new(frequency_hz, rate_hz);
        let off: Vec<f64> = others
            .iter()
            .zip(readings(&others))
            .map(|(i, y)| {
                let [sin, cos] = oscillator.at(samples.n[*i]);
                (y - fit.offset - fit.sin * sin - fit.cos * cos).abs()
            })
            .collect();
        let own = most(fit.residuals.iter().map(|r| r.abs()).collect());
        let of_its_own = || {
            let whole = sine::four(&counters(&settled), &readings(&settled), frequency_hz, rate_hz).ok()?;
            let beside = settled.iter().zip(&whole.residuals).filter(|(i, _)| !is_used(i));
            Some(most(beside.map(|(_, r)| r.abs()).collect()))
        };
        !off.is_empty() && (most(off) < FOLLOWS * own || of_its_own().is_some_and(|off| off < FOLLOWS * own))
    })
}
