//! Signals beside each other: each was measured while others were still in the samples, of which plateaus and the ends of the record spread a part to
//! its place. A tone is fitted again by sums over short stretches, to which its own part is added as a formula; of a switched signal the sizes are.

use super::spectrum::{Grid, Noise};
use super::waves::{TONE_PARAMETERS, Waves, frequency_std_hz};
use super::{Signals, Taken, as_tone};
use crate::diagnose::samples::{Inside, remove, rms, squares_of_all};
use crate::model::effects::in_samples::InSamples;
use crate::model::effects::{Record, Spec};

/// Rounds in which all are fitted again, one after the other.
const MOST_ROUNDS: usize = 8;
/// A signal that moves by less than this part of its standard uncertainties is where it belongs.
const SETTLED: f64 = 0.05;

/// What some signals are fitted to beside each other.
pub struct Together<'a> {
    pub record: &'a Record,
    pub signals: &'a Signals,
    pub taken: &'a Taken<'a>,
    pub grid: &'a Grid<'a>,
    pub noise: &'a Noise,
}

impl Together<'_> {
    /// Fits each of some signals beside all others, until none moves; the residuals are those without them.
    pub fn fit(&self, found: &mut [Inside], residual: &mut [Vec<f64>; 3]) {
        for _ in 0..MOST_ROUNDS {
            let mut is_settled = true;
            for signal in &mut *found {
                let better = match signal.effect.in_samples() {
                    Some(InSamples::Line(_)) => self.tone(signal, residual),
                    Some(InSamples::Comb(_)) => self.switched(signal, residual),
                    _ => None,
                };
                if let Some(better) = better {
                    self.put(&signal.negative(), residual);
                    self.put(&better, residual);
                    *signal = better;
                    is_settled = false;
                }
            }
            if is_settled {
                return;
            }
        }
    }

    /// What the samples are without the signals before each, and without it as well: squares over the noise beside all of them, and root mean squares.
    pub fn measure(&self, found: &mut [Inside], residual: &[Vec<f64>; 3]) {
        let of = |residual: &[Vec<f64>; 3]| {
            let squares = squares_of_all(residual, self.grid.windows);
            (self.noise.weighted(self.grid, &squares), rms(&squares, self.grid.windows))
        };
        let mut left = residual.clone();
        let mut after = of(&left);
        for signal in found.iter_mut().rev() {
            self.put(&signal.negative(), &mut left);
            let before = of(&left);
            signal.squares = [before.0, after.0, 3.0 * self.grid.used as f64];
            signal.rms_ent = [before.1, after.1];
            after = before;
        }
    }

    /// Takes a signal off.
    fn put(&self, signal: &Inside, residual: &mut [Vec<f64>; 3]) {
        remove(residual, self.record, self.grid.samples, self.grid.windows, signal);
    }

    /// A tone by what is left with it; `None` where it does not move.
    fn tone(&self, signal: &Inside, residual: &[Vec<f64>; 3]) -> Option<Inside> {
        let (effect, line) = self.signals.line?;
        let (_, hz) = signal.line()?;
        let waves = Waves { grid: self.grid, noise: self.noise, residual };
        let sizes = signal.sin_and_cos();
        let band = waves.band(hz).with(self.grid, sizes);
        let now_hz = waves.refined(&band, hz);
        let wave = waves.wave(&band, now_hz)?;
        // The phase at the begin of the run moves with the frequency.
        let before = waves.wave(&band, hz)?;
        let is_settled = (now_hz - hz).abs() < SETTLED * frequency_std_hz(self.grid, wave.chi)
            && signal.spec.axes.iter().all(|&a| {
                let by = (before.sin[a] - sizes[a][0]).hypot(before.cos[a] - sizes[a][1]);
                by < SETTLED * TONE_PARAMETERS.sqrt() * before.std[a]
            });
        (!is_settled).then(|| {
            let tone = as_tone(effect, line, &wave, now_hz, signal.p_value, self.grid);
            Inside { values: tone.values, spec: tone.spec, shape_std: tone.shape_std, strength: tone.strength, ..signal.clone() }
        })
    }

    /// A switched signal with the sizes by what is left with it.
    fn switched(&self, signal: &Inside, residual: &[Vec<f64>; 3]) -> Option<Inside> {
        let waves = Waves { grid: self.grid, noise: self.noise, residual };
        let on_all = Spec { axes: vec![0, 1, 2], ..signal.spec.clone() };
        let more = self.taken.sizes_ent(self.record, &waves, signal.effect, on_all)?;
        let axes = signal.spec.axes.iter();
        let values: Vec<(f64, f64)> = axes.zip(&signal.values).map(|(a, (size, std))| (size + more[*a], *std)).collect();
        let moves = values.iter().zip(&signal.values).any(|(now, before)| (now.0 - before.0).abs() > SETTLED * now.1);
        moves.then(|| Inside { values, ..signal.clone() })
    }
}
