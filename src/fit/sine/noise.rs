//! Noise of the readings near the sines of many settings, by one spectrum for all of them where there is one.
//!
//! Near one sine there are some thirty independent bins of the periodogram: a standard deviation good to one part in eight, and too
//! few bins where the stretch has only a few cycles. The noise of an instrument does not change from setting to setting, so that
//! all bins together tell a spectrum `w (1 + c / f)`, white and 1/f noise, to a few percent. Settings whose own bins contradict it
//! count by themselves, and so do all if most contradict.

use std::f64::consts::FRAC_1_SQRT_2;

use crate::fit::scalar::minimum_by_thirds;

use super::{BINS, Basis, LEAST_COVERAGE, Oscillator, Turn, check, local_noise_std, periodogram, stretch};

/// Distance of a bin from 0 and half of the rate, in cycles over the stretch: offset and mirrored sine took their share below.
const LEAST_DISTANCE: f64 = 1.5;
/// A setting agrees if its mean level is within so many standard deviations of the common one, in its logarithm.
const AGREES: f64 = 3.0;
/// Share of the settings that must agree.
const LEAST_AGREEING: f64 = 0.5;
/// Fits after the search, each to the settings that agree with the one before.
const ROUNDS: usize = 2;
/// Frequencies of equal white and 1/f noise that are tried, cycles per sample: from the lowest, by this factor, so many.
const LOWEST_CORNER: f64 = 1e-5;
const CORNER_RATIO: f64 = 2.0;
const CORNERS: i32 = 20;
/// Cuts to two thirds of the width.
const THIRDS: usize = 10;
/// Cycles of the alias in the stretch from which the density at the alias is that of the whole line.
const MANY_CYCLES: f64 = 8.0;
/// Share of 1/f noise below which it does not matter.
const NO_COLOUR: f64 = 0.01;

/// Residuals of the readings of a setting after the fit of a sine.
#[derive(Clone, Copy, Debug)]
pub struct Residue<'a> {
    /// Rising counters.
    pub n: &'a [u64],
    /// One residual per counter.
    pub residuals: &'a [f64],
    /// Frequency of the sine, Hz.
    pub frequency_hz: f64,
    /// Its phase at counter 0, rad.
    pub phase_rad: f64,
}

/// The bins near one sine.
struct Bins {
    /// Cycles per sample and the variance of a reading of white noise of that density.
    rows: Vec<(f64, f64)>,
}

impl Bins {
    /// `None` where the samples show none.
    fn of(residue: &Residue, rate_hz: f64) -> Option<Self> {
        let (n, residuals) = (residue.n, residue.residuals);
        let turn = check(n, residuals, residue.frequency_hz, rate_hz, 8).ok()?;
        if (n.len() as f64) < LEAST_COVERAGE * stretch(n) {
            return None;
        }
        let (alias, bin) = (turn.alias(), 1.0 / stretch(n));
        let inside = |cycles: &f64| *cycles > LEAST_DISTANCE * bin && *cycles < 0.5 - LEAST_DISTANCE * bin;
        let near = BINS.flat_map(|k| [alias - f64::from(k) * bin, alias + f64::from(k) * bin]).filter(inside);
        let scale = 0.5 * n.len() as f64;
        let rows: Vec<(f64, f64)> = near.map(|cycles| (cycles, scale * periodogram(n, residuals, cycles))).collect();
        (!rows.is_empty()).then_some(Self { rows })
    }

    /// White part of the noise if its spectrum has this corner.
    fn level(&self, corner: f64) -> f64 {
        self.rows.iter().map(|(cycles, variance)| variance / (1.0 + corner / cycles)).sum::<f64>() / self.rows.len() as f64
    }

    /// Squared distance of a level of these bins from the common one, in its variance.
    fn distance(&self, level: f64, common: f64) -> f64 {
        let ratio = (level / common).ln();
        if ratio.is_finite() { self.rows.len() as f64 * ratio * ratio } else { f64::INFINITY }
    }
}

/// `w (1 + c / f)`: variance of a reading for white noise of the density at f, cycles per sample.
#[derive(Clone, Copy, Debug)]
struct Spectrum {
    white: f64,
    corner: f64,
}

impl Spectrum {
    /// The spectrum with which most settings agree; `None` where that is not half of them.
    fn of(all: &[&Bins]) -> Option<Self> {
        let mut corners: Vec<f64> = (0..CORNERS).map(|i| LOWEST_CORNER * CORNER_RATIO.powi(i)).collect();
        corners.push(0.0);
        let mut spectrum = corners.iter().flat_map(|corner| Self::consensus(all, *corner)).min_by(|a, b| a.0.total_cmp(&b.0))?.1;
        for _ in 0..ROUNDS {
            let agreeing: Vec<&Bins> = all.iter().copied().filter(|bins| spectrum.agrees(bins)).collect();
            if (agreeing.len() as f64) < LEAST_AGREEING * all.len() as f64 || agreeing.is_empty() {
                return None;
            }
            spectrum = Self::most_likely(&agreeing, &corners);
        }
        Some(spectrum)
    }

    /// The level of the setting with which most others agree, and the loss, for a given corner.
    fn consensus(all: &[&Bins], corner: f64) -> Option<(f64, Self)> {
        let levels: Vec<f64> = all.iter().map(|bins| bins.level(corner)).collect();
        let loss = |common: f64| -> f64 {
            let each = all.iter().zip(&levels).map(|(bins, level)| bins.distance(*level, common).min(AGREES * AGREES));
            each.sum()
        };
        let losses = levels.iter().filter(|level| **level > 0.0).map(|level| (loss(*level), Self { white: *level, corner }));
        losses.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Maximum of Whittle's likelihood, in which a bin is exponentially distributed around its density.
    fn most_likely(bins: &[&Bins], corners: &[f64]) -> Self {
        let rows = || bins.iter().flat_map(|bins| &bins.rows);
        let count = rows().count() as f64;
        let at = |corner: f64| {
            let (sum, logarithms) = rows().fold((0.0, 0.0), |(sum, logarithms), (cycles, variance)| {
                let shape = 1.0 + corner / cycles;
                (sum + variance / shape, logarithms + shape.ln())
            });
            (logarithms + count * (sum / count).ln(), Self { white: sum / count, corner })
        };
        let tried = corners.iter().map(|corner| at(*corner)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, coarse)) = tried.filter(|(_, best)| best.corner > 0.0) else { return at(0.0).1 };
        let around = [coarse.corner / CORNER_RATIO, coarse.corner * CORNER_RATIO];
        at(minimum_by_thirds(|corner| at(corner).0, around, THIRDS)).1
    }

    fn agrees(&self, bins: &Bins) -> bool {
        bins.distance(bins.level(self.corner), self.white) <= AGREES * AGREES
    }

    /// Standard deviation of a reading of white noise that does the same to amplitude and phase of a sine.
    fn near(&self, residue: &Residue, rate_hz: f64) -> [f64; 2] {
        let turn = Turn::new(residue.frequency_hz.into(), rate_hz);
        let (alias, length) = (turn.alias(), stretch(residue.n));
        let many = alias * length > MANY_CYCLES || self.corner < NO_COLOUR * alias;
        let inverse = if many { None } else { mean_inverse(residue, turn) };
        inverse.unwrap_or([1.0 / alias; 2]).map(|inverse| (self.white * (1.0 + self.corner * inverse)).sqrt())
    }
}

/// Mean of 1/f, in samples per cycle, over what amplitude and phase of a sine of few cycles take from the spectrum.
fn mean_inverse(residue: &Residue, turn: Turn) -> Option<[f64; 2]> {
    let n = residue.n;
    let basis = Basis::new(n, turn)?;
    let (sin, cos) = residue.phase_rad.sin_cos();
    let [ss, sc, cc] = basis.inverse;
    // A reading moves A and B by these, and amplitude and phase by their turned combinations.
    let moved = |[s, c]: [f64; 2]| {
        let (s, c) = (s - basis.mean[0], c - basis.mean[1]);
        let (a, b) = (ss * s + sc * c, sc * s + cc * c);
        [cos * a + sin * b, cos * b - sin * a]
    };
    let moves: Vec<[f64; 2]> = basis.columns.iter().map(|column| moved(*column)).collect();
    let step = 0.5 / stretch(n);
    let highest = (turn.alias() + 4.0 * MANY_CYCLES * step).min(0.5);
    let mut sums = [0.0; 2];
    let mut cycles = 0.5 * step;
    while cycles < highest {
        let mut oscillator = Oscillator::of(Turn(cycles.into()));
        let mut seen = [[0.0; 2]; 2];
        for (&n, own) in n.iter().zip(&moves) {
            let [sin, cos] = oscillator.at(n);
            for (seen, own) in seen.iter_mut().zip(own) {
                seen[0] += own * sin;
                seen[1] += own * cos;
            }
        }
        for (sum, [s, c]) in sums.iter_mut().zip(seen) {
            *sum += 2.0 * step * (s * s + c * c) / cycles;
        }
        cycles += step;
    }
    Some(std::array::from_fn(|i| sums[i] / moves.iter().map(|own| own[i] * own[i]).sum::<f64>()))
}

/// Standard deviation of a reading by the noise near the frequency of each sine: what independent readings would have to scatter by
/// to give its amplitude, and its phase, the uncertainty they have. `None` where the samples of a sine do not show it.
pub fn noise_near(residues: &[Residue], rate_hz: f64) -> Vec<Option<[f64; 2]>> {
    let bins: Vec<Option<Bins>> = residues.iter().map(|residue| Bins::of(residue, rate_hz)).collect();
    let spectrum = Spectrum::of(&bins.iter().flatten().collect::<Vec<_>>());
    let near = |(residue, bins): (&Residue, &Option<Bins>)| match spectrum
        .filter(|spectrum| bins.as_ref().is_some_and(|bins| spectrum.agrees(bins)))
    {
        Some(spectrum) => Some(spectrum.near(residue, rate_hz)),
        None => {
            let std = local_noise_std(residue.n, residue.residuals, residue.frequency_hz, rate_hz)?;
            Some([std * FRAC_1_SQRT_2 * (residue.n.len() as f64).sqrt(); 2])
        }
    };
    residues.iter().zip(&bins).map(near).collect()
}
