//! Periodic signals in the samples: lines of the spectrum, and combs of lines that switched signals make.
//!
//! This is no choice among candidates of a [`Problem`](crate::diagnose::problem::Problem) but a scan of a spectrum: a record of 20,000 samples
//! holds 240,000 independent tones and 150 million switched signals, far too many for columns that are scored one by one. The strongest line
//! of all is taken, its frequency, duty and delay are fitted to the samples, and it is taken off, until lines are no more than noise. The
//! probability of noise comes from numbers of independent trials that were counted on noise, and in the end every signal is fitted again beside
//! the others, so that there is nothing to drop or to swap. What is shared with the search is the difference of evidence that distinguishes
//! two explanations, and the builder of steps.

mod joint;
mod shape;
mod spectrum;
mod together;
mod waves;

use super::{Inside, demean, interval_s, remove, remove_raw};
use crate::diagnose::APART;
use crate::fit::scan::orthonormal;
use crate::fit::statistics::{log_chi2_tail, median};
use crate::model::effects::in_samples::{Comb, Harmonic, InSamples, Line};
use crate::model::effects::time_shift::{SHIFT, TimeShift};
use crate::model::effects::{Catalogue, EffectRef, Record, Spec};
use crate::record::prepared::{PreparedRun, Samples};
use joint::Seen;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use shape::sharpened;
use spectrum::{Grid, Noise, Spectrum, log_p_of_switched};
use std::f64::consts::{PI, TAU};
use together::Together;
use waves::{Switched, TONE_PARAMETERS, Wave, Waves, frequency_std_hz};

/// Probability that noise alone shows as much, all trials counted: in 2000 runs with other effects in them and noise that is seldom quite as
/// expected, lines of 10⁻⁴ to 10⁻³ came four times as often as they should.
const SIGNIFICANT: f64 = 1e-4;
/// Samples beside a displaced edge that have a part of the step.
const BESIDE_EDGE: usize = 2;
/// Periodic signals that are looked for at most.
const MOST_SIGNALS: usize = 4;
/// Independent trials per sample of the record, counted on noise: frequencies on each axis and on all together, and for combs phases and
/// duties, of which there are the more the stronger a signal is.
const TONES: usize = 12;
const COMBS: usize = 7500;
/// Cosines that slow changes are made of.
const SLOW: usize = 12;
/// Rows of a record without settings whose common mean is taken off, and the part of one by which their number changes.
const FEWEST_ROWS: usize = 3;
const MOST_ROWS: usize = 8;
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Samples on either side that a sample is compared with: of five the median follows edges, but no pulse of one or two.
const BESIDE: usize = 2;
/// A spike is so many standard deviations off them, where noise seldom is, and spikes are no more than this part of all samples.
const SPIKE: f64 = 10.0;
const FEW: f64 = 0.002;
/// Normal noise is within so many standard deviations in nine of ten cases.
const NORMAL_90: f64 = 1.644_853_626_951_472_2;
/// Harmonics of a switched signal.
const HARMONICS: usize = 8;
/// A line may be any harmonic of a switched signal up to this one.
const MOST_ORDER: usize = 4;
/// An axis has a signal if its amplitude is beyond so many standard uncertainties; the modulus of sine and cosine has √2 that of either.
const STANDS_OUT: f64 = 3.0;
const OF_MODULUS: f64 = 1.41;
/// A line this near to a harmonic of a known one, as a part of its frequency, is what the known one has beside a pure period. Harmonics above half the
/// sample rate are folded into places that have nothing to do with that: there it is the same line within so many widths of one, and one more for every order.
const SAME_LINE: f64 = 0.005;
const FOLDED_WIDTHS: f64 = 1.0;

/// Parts of a run by their first samples and those behind them, and what is left around their means, by component, enT.
pub type AroundMeans = (Vec<[usize; 2]>, [Vec<f64>; 3]);

/// Periodic signals, and what they and those that were known before leave.
#[derive(Default)]
pub struct Periodic {
    /// Periodic signals, in the order in which they were found.
    pub found: Vec<Inside>,
    /// `None` where there is too little for a spectrum.
    pub left: Option<AroundMeans>,
}

/// Periodic signals in what the plateau means leave.
pub fn periodic(prepared: &PreparedRun, samples: &Samples, known: &[Inside], catalogue: &Catalogue) -> Periodic {
    let signals = Signals::of(catalogue);
    let mut found: Vec<Inside> = Vec::new();
    let Some(rate_hz) = interval_s(samples).map(f64::recip) else { return Periodic::default() };
    let has_fields = prepared.record.has_fields();
    let windows = inside_of(prepared, samples, known, rate_hz);
    let Some(grid) = Grid::new(samples, &windows, rate_hz) else { return Periodic::default() };
    // However long the parts are whose means are taken off, slow noise has the lowest frequencies for itself.
    let grid = if has_fields { grid } else { grid.over_rows(&prepared.windows) };
    let slopes = Slopes::new(samples, &windows);
    // The plan of the transform takes one thread some time.
    let (mut spectrum, mut residual) = rayon::join(|| Spectrum::new(&grid), || around_means(prepared, samples, &windows, known));
    let mut quiet = Default::default();
    let mut is_level = [false; 3];
    let level = |residual: &mut [Vec<f64>; 3], is_level: &mut [bool; 3]| {
        residual.par_iter_mut().zip(is_level.par_iter_mut()).for_each(|(values, is_level)| {
            *is_level |= slopes.as_ref().is_some_and(|slopes| slopes.level(values));
        });
    };
    level(&mut residual, &mut is_level);
    // What a known one has beside a pure period, which is no signal of its own.
    let mut beside_known: Vec<Inside> = Vec::new();
    // The noise of what the spectrum is of, if it is still that of what is left, all of it or but for harmonics of a tone that are left.
    let mut beside: Option<NoiseBeside> = None;
    for _ in 0..MOST_SIGNALS {
        let all = |spectrum: &mut Spectrum| Some(NoiseBeside { noise: spectrum.take(&grid, &residual)?, is_all: true });
        let Some(mut now) = beside.take().or_else(|| all(&mut spectrum)) else { break };
        let mut line = shown(&signals, &grid, &spectrum, &now);
        // Only all of what is left says that there is nothing more.
        if line.is_none() && !now.is_all {
            let Some(whole) = all(&mut spectrum) else { break };
            now = whole;
            line = shown(&signals, &grid, &spectrum, &now);
        }
        let Some(line) = line else {
            beside = Some(now);
            break;
        };
        let taken = Taken { slopes: slopes.as_ref(), is_level };
        let mut left = Remaining { grid: &grid, spectrum: &mut spectrum, residual: &mut residual, quiet: &mut quiet };
        let Some(Found { signal, line_hz, beside: of_found }) =
            taken_off(&prepared.record, &signals, &taken, &mut left, &line, &now.noise)
        else {
            break;
        };
        // A signal that comes again with the settings had lost a slope that was its own.
        level(&mut residual, &mut is_level);
        beside = Some(of_found).filter(|_| signal.line().is_some() && is_level == taken.is_level);
        let is_new = !known.iter().chain(&found).any(|k| belongs(line_hz, k, &grid));
        if is_new { &mut found } else { &mut beside_known }.push(signal);
    }
    for rest in &beside_known {
        remove(&mut residual, &prepared.record, samples, &windows, &rest.negative());
    }
    if !found.is_empty()
        && let Some(noise) = beside.map(|beside| beside.noise).or_else(|| spectrum.take(&grid, &residual))
    {
        let taken = Taken { slopes: slopes.as_ref(), is_level };
        let together = Together { record: &prepared.record, signals: &signals, taken: &taken, grid: &grid, noise: &noise };
        if found.len() + beside_known.len() > 1 {
            together.fit(&mut found, &mut residual);
        }
        together.measure(&mut found, &residual);
    }
    Periodic { found, left: Some((windows, residual)) }
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

/// A periodic signal, the line that showed it, and what there is beside this.
struct Found {
    signal: Inside,
    line_hz: f64,
    beside: NoiseBeside,
}

/// The noise beside a line and those of its harmonics that stand out.
struct NoiseBeside {
    noise: Noise,
    /// Whether there are no such harmonics: if it is a tone, what is left without them is all that is left.
    is_all: bool,
}

/// Whether a line lies on a harmonic of a known signal, where the samples show it.
fn belongs(line_hz: f64, known: &Inside, grid: &Grid) -> bool {
    let Some(known_hz) = known.effect.period_s(&known.spec).map(f64::recip) else { return false };
    let width_hz = grid.rate_hz / grid.length as f64;
    (1..=HARMONICS).any(|k| {
        let order = k as f64;
        let is_folded = order * known_hz > 0.5 * grid.rate_hz;
        let near_hz = if is_folded { (FOLDED_WIDTHS + order) * width_hz } else { SAME_LINE * known_hz };
        (grid.seen_hz(order * known_hz) - grid.seen_hz(line_hz)).abs() < near_hz
    })
}

/// The parts of a run whose means are taken off: plateaus, or parts of a record without settings.
fn inside_of(prepared: &PreparedRun, samples: &Samples, known: &[Inside], rate_hz: f64) -> Vec<[usize; 2]> {
    if prepared.record.has_fields() { beside_edges(prepared, samples, known, rate_hz) } else { joined(&prepared.windows) }
}

/// Readings of the used samples around the means of their plateaus, without what is known already.
fn around_means(prepared: &PreparedRun, samples: &Samples, windows: &[[usize; 2]], known: &[Inside]) -> [Vec<f64>; 3] {
    let mut residual: [Vec<f64>; 3] = [0, 1, 2].map(|a| samples.reading_ent.par_iter().map(|r| r[a]).collect());
    for signal in known {
        remove_raw(&mut residual, &prepared.record, samples, windows, signal);
    }
    residual.par_iter_mut().for_each(|values| clip(values, windows));
    demean(&mut residual, windows);
    residual
}

/// The parts of a record without settings whose means are taken off, of unequal numbers of its rows: equal ones would beat with every period
/// near a multiple of their length, and take much of what is slower.
fn joined(rows: &[[usize; 2]]) -> Vec<[usize; 2]> {
    let mut parts = Vec::new();
    let mut from = 0;
    while from < rows.len() {
        // Parts of the golden ratio follow no period.
        let part = (parts.len() as f64 * GOLDEN).fract();
        let count = FEWEST_ROWS + (part * (MOST_ROWS - FEWEST_ROWS + 1) as f64) as usize;
        let to = if from + count + FEWEST_ROWS > rows.len() { rows.len() } else { from + count };
        parts.push([rows[from][0], rows[to - 1][1]]);
        from = to;
    }
    parts
}

/// The plateaus without the samples that displaced edges reach: of a displacement that is known to a part of a sample, a part of a whole step is
/// left in the samples beside it, and comes again with the settings.
fn beside_edges(prepared: &PreparedRun, samples: &Samples, known: &[Inside], rate_hz: f64) -> Vec<[usize; 2]> {
    let shifts_s = known.iter().filter(|k| k.effect.is(&TimeShift)).filter_map(|k| k.spec.get(SHIFT));
    let [late_s, early_s] = shifts_s.fold([0.0_f64; 2], |[late, early], s| [late.max(s), early.max(-s)]);
    let off = |shift_s: f64| if shift_s > 0.0 { (shift_s * rate_hz).ceil() as usize + BESIDE_EDGE } else { 0 };
    let last = samples.t_s.len();
    let of = |[from, to]: &[usize; 2]| [(from + off(late_s)).min(last), to.saturating_sub(off(early_s))];
    prepared.windows.iter().map(of).filter(|[from, to]| from < to).collect()
}

/// Puts the median of its neighbours in the place of every sample that stands alone far off them. Where many do they are no accidents but a
/// signal, and stay.
fn clip(values: &mut [f64], windows: &[[usize; 2]]) {
    let around = |values: &[f64], from: usize, to: usize, k: usize| {
        let begin = k.saturating_sub(BESIDE).max(from).min(to.saturating_sub(2 * BESIDE + 1).max(from));
        let near = &values[begin..(begin + 2 * BESIDE + 1).min(to)];
        // Nearly all samples have as many neighbours.
        <[f64; 2 * BESIDE + 1]>::try_from(near).map_or_else(|_| median(&mut near.to_vec()), median_of_five)
    };
    let of_window = |[from, to]: &[usize; 2]| -> Vec<f64> {
        (*from..*to).map(|k| (values[k] - around(values, *from, *to, k)).abs()).collect()
    };
    let off: Vec<Vec<f64>> = windows.par_iter().map(of_window).collect();
    let mut sizes = off.concat();
    let place = sizes.len() * 9 / 10;
    if place >= sizes.len() {
        return;
    }
    let most = SPIKE / NORMAL_90 * *sizes.select_nth_unstable_by(place, f64::total_cmp).1;
    let spikes_of = |([from, to], off): (&[usize; 2], &Vec<f64>)| -> Vec<(usize, f64)> {
        let is_spike = |(_, off): &(usize, &f64)| **off > most && most > 0.0;
        (*from..*to).zip(off).filter(is_spike).map(|(k, _)| (k, around(values, *from, *to, k))).collect()
    };
    let spikes: Vec<(usize, f64)> = windows.iter().zip(&off).flat_map(spikes_of).collect();
    if spikes.len() as f64 <= FEW * sizes.len() as f64 {
        spikes.into_iter().for_each(|(k, value)| values[k] = value);
    }
}

/// The median of five values: of the one that is not in two pairs, the larger of their smaller ones and the smaller of their larger ones.
fn median_of_five([a, b, c, d, e]: [f64; 2 * BESIDE + 1]) -> f64 {
    let (low, high) = (a.min(b).max(c.min(d)), a.max(b).min(c.max(d)));
    low.min(e).max(low.max(e).min(high))
}

/// Slow changes of plateaus whose means are zero, which would be a saw at the rate of the settings: their slopes follow cosines over the run.
struct Slopes<'a> {
    samples: &'a Samples,
    windows: &'a [[usize; 2]],
    /// Middle of each plateau, s.
    middles_s: Vec<f64>,
    /// Squares of the time of each plateau, s².
    squares: Vec<f64>,
    /// The cosines, at right angles, for slopes in units of their standard deviation at noise of 1.
    base: DMatrix<f64>,
}

impl<'a> Slopes<'a> {
    /// Of plateaus; `None` of so few that nothing follows.
    fn new(samples: &'a Samples, windows: &'a [[usize; 2]]) -> Option<Self> {
        let count = SLOW.min(windows.len() / 4);
        if count == 0 {
            return None;
        }
        let middles_s: Vec<f64> = windows.iter().map(|[from, to]| mean(&samples.t_s[*from..*to])).collect();
        let (begin_s, end_s) = (middles_s[0], middles_s[middles_s.len() - 1]);
        let own = windows.iter().zip(&middles_s);
        let squares: Vec<f64> =
            own.map(|([from, to], middle_s)| samples.t_s[*from..*to].iter().map(|t| (t - middle_s).powi(2)).sum()).collect();
        let cosine = |i: usize, m: usize| (PI * m as f64 * (middles_s[i] - begin_s) / (end_s - begin_s)).cos();
        let design = DMatrix::from_fn(windows.len(), count, |i, m| squares[i].sqrt() * cosine(i, m));
        let base = orthonormal(&design, None, 1e-9);
        Some(Self { samples, windows, middles_s, squares, base })
    }

    /// The slopes of values.
    fn of(&self, values: &[f64]) -> DVector<f64> {
        DVector::from_fn(self.windows.len(), |i, _| {
            let [from, to] = self.windows[i];
            let along = |k: usize| values[k] * (self.samples.t_s[k] - self.middles_s[i]);
            (from..to).map(along).sum::<f64>() / self.squares[i].max(f64::MIN_POSITIVE).sqrt()
        })
    }

    fn take(&self, values: &mut [f64], fitted: &DVector<f64>) {
        for (i, [from, to]) in self.windows.iter().enumerate() {
            let slope = fitted[i] / self.squares[i].max(f64::MIN_POSITIVE).sqrt();
            (*from..*to).for_each(|k| values[k] -= slope * (self.samples.t_s[k] - self.middles_s[i]));
        }
    }

    /// Takes them off, whatever they are.
    fn take_off(&self, values: &mut [f64]) {
        let slopes = self.of(values);
        self.take(values, &(&self.base * self.base.tr_mul(&slopes)));
    }

    /// Takes them off where they are more than noise; whether they are.
    fn level(&self, values: &mut [f64]) -> bool {
        let slopes = self.of(values);
        let fitted = &self.base * self.base.tr_mul(&slopes);
        // The slopes that do not follow give their noise.
        let (count, windows) = (self.base.ncols(), self.windows.len());
        let noise = (slopes - &fitted).norm_squared() / (windows - count) as f64;
        let is_more = log_chi2_tail(fitted.norm_squared() / noise, count as f64) < SIGNIFICANT.ln();
        if is_more {
            self.take(values, &fitted);
        }
        is_more
    }
}

/// What was taken off the readings beside the means of the plateaus, on each axis.
struct Taken<'a> {
    slopes: Option<&'a Slopes<'a>>,
    is_level: [bool; 3],
}

impl Taken<'_> {
    /// Sizes of a switched signal on the axes, by least squares with all of it in the samples, of which the same was taken off as of the
    /// readings; `None` if it is none.
    fn sizes_ent(&self, record: &Record, waves: &Waves, effect: EffectRef, on_all_axes: Spec) -> Option<[f64; 3]> {
        let (samples, windows) = (waves.grid.samples, waves.grid.windows);
        let unit = Inside { values: vec![(-1.0, 0.0); 3], ..Inside::new(effect, on_all_axes) };
        let mut signal: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; samples.t_s.len()]);
        remove(&mut signal, record, samples, windows, &unit);
        for (values, _) in signal.iter_mut().zip(self.is_level).filter(|(_, is_level)| *is_level) {
            self.slopes.iter().for_each(|slopes| slopes.take_off(values));
        }
        let size = |a: usize| {
            let (mut along, mut square) = (0.0, 0.0);
            for ([from, to], weight) in windows.iter().zip(&waves.noise.weights[a]) {
                for (s, r) in signal[a][*from..*to].iter().zip(&waves.residual[a][*from..*to]) {
                    along += weight * s * r;
                    square += weight * s * s;
                }
            }
            along / square
        };
        let sizes = [0, 1, 2].map(size);
        sizes.iter().all(|size| size.is_finite()).then_some(sizes)
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// A line that is no noise, or the strongest line of a comb that is none.
struct Shown {
    line_hz: f64,
    /// Probability of one tone; that of a comb as if it had been one of as many trials.
    p_value: f64,
    is_tone: bool,
    comb: Option<spectrum::Comb>,
}

/// What the numbers of independent trials of a record are.
#[derive(Clone, Copy)]
struct Trials {
    tones: usize,
    /// Logarithm.
    combs: f64,
}

impl Trials {
    fn of(grid: &Grid) -> Self {
        Self { tones: TONES * grid.length, combs: (COMBS as f64 * grid.length as f64).ln() }
    }

    fn log_tones(self) -> f64 {
        (self.tones as f64).ln()
    }
}

/// The strongest line of the spectra of all components together, if it is no noise; combs of lines that are no tones are looked for in all of what is
/// left.
fn shown(signals: &Signals, grid: &Grid, spectrum: &Spectrum, NoiseBeside { noise, is_all }: &NoiseBeside) -> Option<Shown> {
    let (step_hz, trials) = (grid.step_hz(), Trials::of(grid));
    let lines = spectrum.lines(noise);
    let (peak, log_p_tone) = lines.tone()?;
    let significant = SIGNIFICANT.ln() - trials.log_tones();
    let is_tone = log_p_tone < significant;
    if !is_tone && !is_all {
        return None;
    }
    let peak = if is_tone { lines.strongest_around(grid, peak, significant) } else { peak };
    let shapes: Vec<Harmonic> = signals.combs.iter().map(|(_, comb)| comb.harmonic).collect();
    let comb = if is_tone { lines.comb_of(peak, &shapes) } else { lines.comb(&shapes) };
    let comb = comb.filter(|c| c.log_p + trials.combs < SIGNIFICANT.ln());
    let (line_hz, p_value) = match &comb {
        _ if is_tone => (peak as f64 * step_hz, log_p_tone.exp()),
        Some(c) => (c.strongest as f64 * c.base * step_hz, (c.log_p + trials.combs - trials.log_tones()).exp()),
        None => return None,
    };
    Some(Shown { line_hz, p_value, is_tone, comb })
}

/// What is left of a record, and its spectrum.
struct Remaining<'a> {
    grid: &'a Grid<'a>,
    spectrum: &'a mut Spectrum,
    residual: &'a mut [Vec<f64>; 3],
    /// Memory for what is left without a signal that is measured.
    quiet: &'a mut [Vec<f64>; 3],
}

impl Remaining<'_> {
    /// Weights and levels of the noise beside a line: a signal is no noise, and it is measured with what is left without it and those of its harmonics that
    /// stand out, of which the spectrum is then. These are given as well.
    fn noise_beside(&mut self, line_hz: f64, noise: &Noise) -> Option<(Noise, Vec<Wave>)> {
        let with_signal = Waves { grid: self.grid, noise, residual: self.residual };
        let mut waves = with_signal.harmonics(line_hz, HARMONICS)?;
        let line_hz = waves.first()?.hz;
        waves.retain(|wave| wave.hz == line_hz || log_chi2_tail(wave.chi, TONE_PARAMETERS) < SIGNIFICANT.ln());
        self.quiet.par_iter_mut().zip(&*self.residual).for_each(|(quiet, values)| quiet.clone_from(values));
        with_signal.take_off(self.quiet, &waves);
        demean(self.quiet, self.grid.windows);
        Some((self.spectrum.take(self.grid, self.quiet)?, waves))
    }
}

/// What made a line, as a tone or as a switched signal, which is taken off what is left.
fn taken_off(
    record: &Record,
    signals: &Signals,
    taken: &Taken,
    left: &mut Remaining,
    shown: &Shown,
    noise: &Noise,
) -> Option<Found> {
    let grid = left.grid;
    let waves = Waves { grid, noise, residual: left.residual };
    let line_hz = waves.unrepeated(waves.refine(shown.line_hz));
    let (noise, harmonics) = left.noise_beside(line_hz, noise)?;
    let residual = &mut *left.residual;
    let waves = &Waves { grid, noise: &noise, residual };
    let line_hz = waves.refine(line_hz);
    let sines = waves.harmonics(line_hz, 1)?;
    let wave = sines.first()?;
    let (tone_effect, line) = signals.line?;
    let tone = as_tone(tone_effect, line, wave, line_hz, shown.p_value, grid);
    let tone_evidence = Waves::tone_evidence(wave);
    let seen = Seen { waves: &harmonics, spectrum: left.spectrum };
    let signal = match switched(signals, waves, &seen, line_hz, shown.comb.as_ref(), tone_evidence - APART) {
        // Of a signal with one harmonic in sight nothing shows that it is switched.
        Some((effect, form, found)) if found.evidence > tone_evidence && !found.single => {
            let near = found.evidence - tone_evidence < APART;
            let signal = as_switched(effect, &form, &found, waves, shown, record, |[period_s, duty, delay_s]| {
                taken.sizes_ent(record, waves, effect, (form.term)(&[0, 1, 2], period_s, duty, delay_s))
            })?;
            Inside { ambiguous_with: if near { vec![tone_effect] } else { Vec::new() }, ..signal }
        }
        Some((other, _, found)) if tone_evidence - found.evidence < APART => Inside { ambiguous_with: vec![other], ..tone },
        _ => tone,
    };
    remove(residual, record, grid.samples, grid.windows, &signal);
    let is_all = harmonics.len() == 1;
    Some(Found { signal, line_hz, beside: NoiseBeside { noise, is_all } })
}

/// Axes on which values stand out of their uncertainties; all where none does.
fn axes_of(values: &[(f64, f64); 3]) -> Vec<usize> {
    let stands_out = |v: &(f64, f64)| v.0.abs() > STANDS_OUT * v.1;
    let none = !values.iter().any(stands_out);
    (0..3).filter(|a| none || stands_out(&values[*a])).collect()
}

/// A line as a tone. The phase is known best in the middle of the record; at the run's start the frequency has its part in it.
fn as_tone(effect: EffectRef, line: Line, wave: &Wave, line_hz: f64, p_value: f64, grid: &Grid) -> Inside {
    let axes = axes_of(&[0, 1, 2].map(|a: usize| (wave.sin[a].hypot(wave.cos[a]), wave.std[a] * OF_MODULUS)));
    let chi = wave.chi;
    let frequency_std = frequency_std_hz(grid, chi);
    let phase_std = TAU * frequency_std * mean(&grid.samples.t_s);
    let values = axes.iter().flat_map(|a| {
        let (sin, cos, std) = (wave.sin[*a], wave.cos[*a], wave.std[*a]);
        [(sin, std.hypot(cos * phase_std)), (cos, std.hypot(sin * phase_std))]
    });
    Inside {
        values: values.collect(),
        shape_std: vec![(line.frequency.to_owned(), frequency_std)],
        strength: chi.sqrt(),
        p_value: p_value.max(f64::MIN_POSITIVE),
        trials: Trials::of(grid).tones,
        ..Inside::new(effect, (line.term)(&axes, line_hz))
    }
}

/// The best switched signal of which a line may be a harmonic, of those that may have more evidence than the least that matters.
fn switched(
    signals: &Signals,
    waves: &Waves,
    seen: &Seen,
    line_hz: f64,
    comb: Option<&spectrum::Comb>,
    least_evidence: f64,
) -> Option<(EffectRef, Comb, Switched)> {
    // A fundamental may be too slow to be looked for by itself.
    let slow_hz = waves.grid.slowest_hz()..waves.grid.lowest_hz();
    let parts = |hz: f64, strongest: usize, most: usize| {
        let all = (1..=HARMONICS).map(move |order| ((strongest * order) as f64, hz / order as f64));
        let slow_hz = slow_hz.clone();
        all.enumerate().filter(move |(k, (_, hz))| *k < most || slow_hz.contains(hz)).map(|(_, part)| part)
    };
    let of_comb = |c: &spectrum::Comb| parts(c.base * waves.grid.step_hz(), c.strongest, 1);
    let all: Vec<(f64, f64)> = parts(line_hz, 1, MOST_ORDER).chain(comb.into_iter().flat_map(of_comb)).collect();
    let of_part = |(order, base_hz): &(f64, f64)| -> Vec<(EffectRef, Comb, Switched)> {
        let may_be = |(_, form): &&(EffectRef, Comb)| waves.most_evidence(seen, form, *base_hz, *order) > least_evidence;
        let of = |(effect, form): &(EffectRef, Comb)| Some((*effect, *form, waves.switched(form, *base_hz, *order)?));
        signals.combs.iter().filter(may_be).filter_map(of).collect()
    };
    // In the order of the parts, whatever the threads.
    let fitted: Vec<Vec<(EffectRef, Comb, Switched)>> = all.par_iter().map(of_part).collect();
    fitted.into_iter().flatten().max_by(|a, b| a.2.evidence.total_cmp(&b.2.evidence))
}

/// A switched signal with its best period, duty and delay; `None` where the fit does not confirm what lines showed that are no tone by
/// themselves: lines of a spectrum lie beside the harmonics.
/// `sizes_ent` are its sizes by the samples.
fn as_switched(
    effect: EffectRef,
    form: &Comb,
    found: &Switched,
    waves: &Waves,
    shown: &Shown,
    record: &Record,
    sizes_ent: impl Fn([f64; 3]) -> Option<[f64; 3]>,
) -> Option<Inside> {
    let (grid, trials) = (waves.grid, Trials::of(waves.grid));
    let (Switched { base_hz, duty, delay, gain, .. }, values) = waves.polish(form, found)?;
    // On and off cannot be distinguished: the shorter part is called on.
    let (duty, delay) = if duty > 0.5 { (1.0 - duty, (delay + duty).rem_euclid(1.0)) } else { (duty, delay) };
    if !shown.is_tone && log_p_of_switched(values.map(|v| (v.0 / v.1).powi(2))) + trials.combs >= SIGNIFICANT.ln() {
        return None;
    }
    let axes = axes_of(&values);
    // The sum of the first harmonics is not the whole signal.
    let shape = sharpened(waves, record, effect, form, [base_hz.recip(), duty, delay / base_hz]);
    let sizes_ent = sizes_ent(shape)?;
    let [period_s, duty, delay_s] = shape;
    let period_std_s = period_s * period_s * frequency_std_hz(grid, gain);
    Some(Inside {
        values: axes.iter().map(|a| (sizes_ent[*a], values[*a].1)).collect(),
        shape_std: vec![(form.period.to_owned(), period_std_s)],
        strength: gain.sqrt(),
        p_value: shown.p_value.max(f64::MIN_POSITIVE),
        trials: trials.tones,
        ..Inside::new(effect, (form.term)(&axes, period_s, duty, delay_s))
    })
}

#[cfg(test)]
mod tests;
