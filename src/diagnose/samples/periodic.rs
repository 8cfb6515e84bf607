//! Periodic signals in the samples: lines of the spectrum, and combs of lines that switched signals make.

mod spectrum;
mod waves;

use super::{Inside, SIGNIFICANT, demean, interval_s, remove, remove_raw, rms};
use crate::diagnose::APART;
use crate::fit::scan::orthonormal;
use crate::fit::statistics::log_chi2_tail;
use crate::model::effects::in_samples::{Comb, Harmonic, InSamples, Line};
use crate::model::effects::{Catalogue, EffectRef, Record};
use crate::record::scene::{Samples, Scene};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use spectrum::{Grid, Spectrum, log_p_of_switched};
use std::f64::consts::{PI, TAU};
use waves::{Switched, Waves, evidence};

/// Periodic signals that are looked for at most.
const MOST_SIGNALS: usize = 4;
/// Independent trials per sample of the record, counted on noise: frequencies on each axis and on all together, and for combs phases and
/// duties, of which there are the more the stronger a signal is.
const TONES: usize = 12;
const COMBS: usize = 7500;
/// Cosines that slow changes are made of.
const SLOW: usize = 12;
/// Harmonics of a switched signal.
const HARMONICS: usize = 8;
/// A line this near to a harmonic of a known one, as a part of its frequency, is what the known one has beside a pure period.
const SAME_LINE: f64 = 0.005;

/// Periodic signals in what the plateau means leave.
pub fn periodic(scene: &Scene, samples: &Samples, known: &[Inside], catalogue: &Catalogue) -> Vec<Inside> {
    let signals = Signals::of(catalogue);
    let mut found: Vec<Inside> = Vec::new();
    let Some(rate_hz) = interval_s(samples).map(f64::recip) else { return found };
    let Some(grid) = Grid::new(samples, &scene.windows, rate_hz) else { return found };
    let mut spectrum = Spectrum::new(&grid);
    let mut residual = around_means(scene, samples, known);
    for _ in 0..MOST_SIGNALS {
        let Some(Found { signal, line_hz, left }) = strongest(&scene.record, &signals, &grid, &mut spectrum, &residual) else {
            break;
        };
        residual = left;
        // A signal that comes again with the settings had lost a slope that was its own.
        residual.par_iter_mut().for_each(|values| level(values, samples, &scene.windows));
        if !known.iter().chain(&found).any(|k| belongs(line_hz, k, rate_hz)) {
            found.push(signal);
        }
    }
    found
}

/// The effects of a catalogue that make periodic signals: one that makes a line, and those that make combs.
struct Signals {
    line: Option<(EffectRef, Line)>,
    combs: Vec<(EffectRef, Comb)>,
}

impl Signals {
    fn of(catalogue: &Catalogue) -> Self {
        let mut signals = Self { line: None, combs: Vec::new() };
        for effect in catalogue.iter() {
            match effect.in_samples() {
                Some(InSamples::Line(line)) => signals.line = signals.line.or(Some((effect, line))),
                Some(InSamples::Comb(comb)) => signals.combs.push((effect, comb)),
                _ => {}
            }
        }
        signals
    }
}

/// A periodic signal, the line that showed it, and what it leaves.
struct Found {
    signal: Inside,
    line_hz: f64,
    left: [Vec<f64>; 3],
}

/// Whether a line lies on a harmonic of a known signal, seen at the sampling frequency.
fn belongs(line_hz: f64, known: &Inside, rate_hz: f64) -> bool {
    let Some(known_hz) = known.effect.period_s(&known.spec).map(f64::recip) else { return false };
    let seen_hz = |f: f64| (f - rate_hz * (f / rate_hz).round()).abs();
    (1..=HARMONICS).any(|k| (seen_hz(k as f64 * known_hz) - seen_hz(line_hz)).abs() < SAME_LINE * known_hz)
}

/// Readings of the used samples around the means of their plateaus, without what is known already and without slow changes.
fn around_means(scene: &Scene, samples: &Samples, known: &[Inside]) -> [Vec<f64>; 3] {
    let mut residual: [Vec<f64>; 3] = [0, 1, 2].map(|a| samples.reading_ent.iter().map(|r| r[a]).collect());
    for signal in known {
        remove_raw(&mut residual, &scene.record, samples, &scene.windows, signal);
    }
    demean(&mut residual, &scene.windows);
    residual.par_iter_mut().for_each(|values| level(values, samples, &scene.windows));
    residual
}

/// Takes slow changes off plateaus whose means are zero: they would be a saw at the rate of the settings. Their slopes follow cosines over the
/// run; where these are no more than noise, nothing is taken.
fn level(values: &mut [f64], samples: &Samples, windows: &[[usize; 2]]) {
    let count = SLOW.min(windows.len() / 4);
    if count == 0 {
        return;
    }
    let middles_s: Vec<f64> = windows.iter().map(|[from, to]| mean(&samples.t_s[*from..*to])).collect();
    let (begin_s, end_s) = (middles_s[0], middles_s[middles_s.len() - 1]);
    let along = |i: usize, k: usize| samples.t_s[k] - middles_s[i];
    // Squares of the time of each plateau, and slopes in units of their standard deviation at noise of 1.
    let squares: Vec<f64> =
        windows.iter().enumerate().map(|(i, [from, to])| (*from..*to).map(|k| along(i, k).powi(2)).sum::<f64>()).collect();
    let slopes = DVector::from_fn(windows.len(), |i, _| {
        let [from, to] = windows[i];
        (from..to).map(|k| values[k] * along(i, k)).sum::<f64>() / squares[i].max(f64::MIN_POSITIVE).sqrt()
    });
    let cosine = |i: usize, m: usize| (PI * m as f64 * (middles_s[i] - begin_s) / (end_s - begin_s)).cos();
    let design = DMatrix::from_fn(windows.len(), count, |i, m| squares[i].sqrt() * cosine(i, m));
    let base = orthonormal(&design, None, 1e-9);
    let fitted = &base * base.tr_mul(&slopes);
    // Slopes that do not follow tell their noise.
    let noise = (slopes - &fitted).norm_squared() / (windows.len() - count) as f64;
    if log_chi2_tail(fitted.norm_squared() / noise, count as f64) < SIGNIFICANT.ln() {
        for (i, [from, to]) in windows.iter().enumerate() {
            let slope = fitted[i] / squares[i].max(f64::MIN_POSITIVE).sqrt();
            (*from..*to).for_each(|k| values[k] -= slope * along(i, k));
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The strongest line of the spectra of all components together, as a tone or as a switched signal.
fn strongest(
    record: &Record,
    signals: &Signals,
    grid: &Grid,
    spectrum: &mut Spectrum,
    residual: &[Vec<f64>; 3],
) -> Option<Found> {
    let (step_hz, length) = (grid.step_hz(), grid.length);
    let noise = spectrum.take(grid, residual)?;
    let lines = spectrum.lines(&noise);
    let (peak, tone_p) = lines.tone()?;
    let trials = TONES * length;
    let is_tone = tone_p + (trials as f64).ln() < SIGNIFICANT.ln();
    let comb_log_trials = (COMBS as f64 * length as f64).ln();
    let shapes: Vec<Harmonic> = signals.combs.iter().map(|(_, comb)| comb.harmonic).collect();
    let comb = lines.comb(&shapes).filter(|c| c.log_p + comb_log_trials < SIGNIFICANT.ln());
    let (line_hz, p_value) = match &comb {
        _ if is_tone => (peak as f64 * step_hz, tone_p.exp()),
        Some(c) => (c.strongest as f64 * c.base * step_hz, (c.log_p + comb_log_trials - (trials as f64).ln()).exp()),
        None => return None,
    };
    // A signal is no noise: weights and levels are those of what is left without it, and it is measured with them.
    let with_signal = Waves { grid, noise: &noise, residual };
    let mut quiet = residual.clone();
    let waves = with_signal.harmonics(with_signal.refine(line_hz), HARMONICS)?;
    with_signal.take_off(&mut quiet, &waves);
    demean(&mut quiet, grid.windows);
    let noise = spectrum.take(grid, &quiet)?;
    drop(quiet);
    let waves = &Waves { grid, noise: &noise, residual };
    let line_hz = waves.refine(line_hz);
    let sines = waves.harmonics(line_hz, 1)?;
    let wave = sines.first()?;
    let tone = Waves::chi(wave);
    let tone_evidence = evidence(tone, 6.0);
    // The line may be a harmonic of a switched signal.
    let orders = (1..=4).map(|order| (order as f64, line_hz / order as f64));
    let switched = orders
        .chain(comb.map(|c| (c.strongest as f64, c.base * step_hz)))
        .flat_map(|(order, base_hz)| {
            signals.combs.iter().filter_map(move |(effect, form)| Some((*effect, *form, waves.switched(form, base_hz, order)?)))
        })
        .max_by(|a, b| a.2.evidence.total_cmp(&b.2.evidence));
    let axes_of = |values: &[(f64, f64)]| -> Vec<usize> {
        (0..3).filter(|a| values[*a].0.abs() > 3.0 * values[*a].1 || values.iter().all(|v| v.0.abs() <= 3.0 * v.1)).collect()
    };
    let tone_axes: Vec<usize> = {
        let sizes: Vec<(f64, f64)> = (0..3).map(|a| (wave.sin[a].hypot(wave.cos[a]), wave.std[a] * 1.41)).collect();
        axes_of(&sizes)
    };
    let frequency_std = grid.rate_hz / length as f64 * 0.55 / (tone / 2.0).sqrt();
    // The phase is known best in the middle of the record; at the run's start the frequency has its part in it.
    let phase_std = TAU * frequency_std * mean(&grid.samples.t_s);
    let (tone_effect, line) = signals.line?;
    let as_tone = || Inside {
        effect: tone_effect,
        spec: (line.term)(&tone_axes, line_hz),
        values: tone_axes
            .iter()
            .flat_map(|a| {
                let (sin, cos, std) = (wave.sin[*a], wave.cos[*a], wave.std[*a]);
                [(sin, std.hypot(cos * phase_std)), (cos, std.hypot(sin * phase_std))]
            })
            .collect(),
        shape_std: vec![(line.frequency.to_owned(), frequency_std)],
        strength: tone.sqrt(),
        p_value: p_value.max(f64::MIN_POSITIVE),
        trials,
        ambiguous_with: Vec::new(),
        squares: [0.0; 3],
        rms_ent: [[0.0; 3]; 2],
    };
    let mut inside = match switched {
        Some((switched_effect, comb_form, found)) if found.evidence > tone_evidence => {
            let Switched { base_hz, duty, delay, .. } = waves.polish(&comb_form, &found);
            // On and off cannot be told apart: the shorter part is called on.
            let (duty, delay) = if duty > 0.5 { (1.0 - duty, (delay + duty).rem_euclid(1.0)) } else { (duty, delay) };
            let harmonics = waves.harmonics(base_hz, HARMONICS)?;
            let (gain, values) = waves.matched(&comb_form, &harmonics, base_hz, duty, delay);
            // Lines of a spectrum lie beside the harmonics; the fit has to confirm what they showed.
            if !is_tone && log_p_of_switched(values.map(|v| (v.0 / v.1).powi(2))) + comb_log_trials >= SIGNIFICANT.ln() {
                return None;
            }
            let axes = axes_of(&values);
            let period_s = base_hz.recip();
            Inside {
                effect: switched_effect,
                spec: (comb_form.term)(&axes, period_s, duty, delay * period_s),
                values: axes.iter().map(|a| values[*a]).collect(),
                shape_std: vec![(
                    comb_form.period.to_owned(),
                    period_s * period_s * 0.55 / (length as f64 / grid.rate_hz) / (gain / 2.0).sqrt(),
                )],
                strength: gain.sqrt(),
                ambiguous_with: if found.evidence - tone_evidence < APART { vec![tone_effect] } else { Vec::new() },
                ..as_tone()
            }
        }
        Some((other, _, switched)) if tone_evidence - switched.evidence < APART => {
            Inside { ambiguous_with: vec![other], ..as_tone() }
        }
        _ => as_tone(),
    };
    let mut left = residual.clone();
    remove(&mut left, record, grid.samples, grid.windows, &inside);
    inside.squares = [waves.squares(residual), waves.squares(&left), 3.0 * grid.used as f64];
    inside.rms_ent = [rms(residual, grid.windows), rms(&left, grid.windows)];
    Some(Found { signal: inside, line_hz, left })
}

#[cfg(test)]
mod tests {
    use super::{demean, level};
    use crate::record::scene::Samples;

    /// 90 plateaus of 6 s every 7 s at 32 Hz.
    fn plateaus() -> (Samples, Vec<[usize; 2]>) {
        let samples = Samples { t_s: (0..90 * 224).map(|k| k as f64 / 32.0).collect(), ..Samples::default() };
        (samples, (0..90).map(|i| [224 * i, 224 * i + 192]).collect())
    }

    fn squares(values: &[f64]) -> f64 {
        values.iter().map(|v| v * v).sum()
    }

    /// A wave of 400 s leaves a saw of its slopes, and of that its bends: over 6 s with slope `w` and bend `w²` of a unit wave the saw has a
    /// root mean square of `w · 6 / √12`, the bends `w² · 36 / √720`, each times the mean of a squared cosine.
    #[test]
    fn slow_changes_are_taken_off_the_plateaus() {
        let (samples, windows) = plateaus();
        let omega = std::f64::consts::TAU / 400.0;
        let mut values = [0, 1, 2].map(|a| samples.t_s.iter().map(|t| (omega * t + f64::from(a)).sin()).collect::<Vec<f64>>());
        demean(&mut values, &windows);
        for values in &mut values {
            let within = |v: &[f64]| windows.iter().map(|[from, to]| squares(&v[*from..*to])).sum::<f64>() / (90.0 * 192.0);
            let before = within(values);
            assert!((before.sqrt() / (omega * 6.0 / 24.0_f64.sqrt()) - 1.0).abs() < 0.05, "{before}");
            level(values, &samples, &windows);
            let bends = omega * omega * 36.0 / (2.0 * 720.0_f64).sqrt();
            // What the cosines do not follow at the ends of the run adds to the bends.
            assert!(within(values).sqrt() < 0.05 * before.sqrt() + bends, "{}", within(values).sqrt());
        }
    }

    /// A saw that changes its sign from plateau to plateau is no slow change.
    #[test]
    fn what_is_quick_stays() {
        let (samples, windows) = plateaus();
        let mut values = vec![0.0; samples.t_s.len()];
        for (i, [from, to]) in windows.iter().enumerate() {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            (*from..*to).for_each(|k| values[k] = sign * (samples.t_s[k] - samples.t_s[*from] - 191.0 / 64.0));
        }
        let before = values.clone();
        level(&mut values, &samples, &windows);
        assert_eq!(values, before);
    }
}
