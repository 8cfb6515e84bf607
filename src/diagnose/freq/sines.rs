//! What the samples of every setting show of its sine: amplitude, phase, and how fast the phase runs away, with their noise.

use crate::data::run::{Setting, SlowTable};
use crate::diagnose::DiagnoseError;
use crate::fit::sine::{self, Residue};
use crate::measure::freq::Freq;
use crate::model::effects::in_sine::{SineRun, SineSetting, Triple};
use crate::record::prepared::Samples;
use nalgebra::DVector;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Fewest settings with sines: they have to determine a response, a clock and an effect.
const LEAST_SINES: usize = 8;
/// Sines below this many standard uncertainties of their amplitude are left out: the logarithm of the rest is as good as normal.
const LEAST_RATIO: f64 = 10.0;
/// Phases refer to the begins of the settings if so many of them agree with the response to within so much, rad.
const AGREEING: f64 = 0.8;
const AGREES_RAD: f64 = 0.4;
/// Settings of the lowest frequencies that show which axes see the field with the opposite sign: a part of all, and at least so many.
const LOWEST_PART: usize = 4;
const LEAST_LOWEST: usize = 3;
/// An uncertainty of the time of the counter from which it is a parameter, s: a sine of 100 Hz turns by 6e-6 rad.
const LEAST_ROUNDING_S: f64 = 1e-8;

/// Amplitude, phase at the middle of the setting relative to a sine that begins with the setting, and its rate of change, of one component.
#[derive(Clone, Copy, Debug)]
pub struct Tone {
    /// Logarithm of the amplitude, enT.
    pub log_amplitude: f64,
    /// Phase, rad; of an axis that sees the field with the opposite sign, half a turn on.
    pub phase_rad: f64,
    /// Change of the phase beside the sampling frequency of [`SineRun::rate_hz`], rad/s.
    pub slope_rad_per_s: f64,
    /// Standard uncertainties of the three.
    pub std: [f64; 3],
}

/// One setting with sines in all components.
#[derive(Clone, Debug)]
pub struct SineOf {
    /// The setting.
    pub setting: Setting,
    /// Middle of its samples, s after sample counter 0.
    pub middle_s: f64,
    /// Length of the used stretch, s.
    pub length_s: f64,
    /// x, y, z.
    pub tones: [Tone; 3],
    /// Two contrasts of whitened phases in which a phase common to all components does not show.
    contrasts: [[f64; 3]; 2],
}

/// All settings of a run.
#[derive(Clone, Debug)]
pub struct Sines {
    /// In the order of the run.
    pub list: Vec<SineOf>,
    /// The run as effects read it.
    pub run: SineRun,
}

impl Sines {
    /// Of the undamaged stretches that the frequency analysis found.
    pub fn new(samples: &Samples, freq: &Freq, temperatures: &SlowTable) -> Result<Self, DiagnoseError> {
        let rate_hz = freq.values.mean_f_s_hz.ok_or(DiagnoseError::NoSamplingFrequency)?;
        let (zero_s, zero_std_s) = counter_zero(samples, rate_hz);
        let stretches: Vec<(Setting, usize, usize)> = freq
            .stretches
            .iter()
            .filter_map(|s| {
                let [first, last] = s.used_s?;
                let from = samples.t_s.partition_point(|t| *t < first);
                let to = samples.t_s.partition_point(|t| *t <= last);
                (to > from + 8).then_some((s.setting, from, to))
            })
            .collect();
        let fits: Vec<Option<Fitted>> = stretches
            .par_iter()
            .map(|(setting, from, to)| Fitted::new(samples, *from..*to, setting.frequency_hz, rate_hz))
            .collect();
        let present: Vec<(&Setting, Fitted)> =
            stretches.iter().zip(fits).filter_map(|((s, _, _), fit)| Some((s, fit?))).collect();
        let near: Vec<Vec<Option<[f64; 2]>>> = (0..3)
            .into_par_iter()
            .map(|i| {
                let residues: Vec<Residue> = present
                    .iter()
                    .map(|(setting, fit)| Residue {
                        n: &fit.n,
                        residuals: &fit.sines[i].residuals,
                        frequency_hz: setting.frequency_hz,
                        phase_rad: fit.sines[i].phase_rad,
                    })
                    .collect();
                sine::noise_near(&residues, rate_hz)
            })
            .collect();
        let mut list = Vec::new();
        for (j, (setting, fit)) in present.iter().enumerate() {
            let begin_cycles = setting.frequency_hz * (setting.t_start_s - zero_s);
            let tones: [Tone; 3] = std::array::from_fn(|i| {
                let sine = &fit.sines[i];
                let [of_amplitude, of_phase] = match near[i][j] {
                    Some(near) if sine.residual_std > 0.0 => near.map(|near| near / sine.residual_std),
                    _ => [1.0; 2],
                };
                Tone {
                    log_amplitude: sine.amplitude.ln(),
                    phase_rad: wrapped(sine.phase_rad + TAU * (begin_cycles - begin_cycles.round())),
                    slope_rad_per_s: fit.slopes[i][0],
                    std: [
                        of_amplitude * sine.amplitude_std / sine.amplitude,
                        of_phase * sine.phase_std_rad,
                        of_phase * fit.slopes[i][1],
                    ],
                }
            });
            let good = |t: &Tone| t.std.iter().all(|s| s.is_finite() && *s > 0.0) && t.std[0] < 1.0 / LEAST_RATIO;
            if tones.iter().all(good) {
                let contrasts = contrasts(tones.map(|t| 1.0 / t.std[1]));
                let (middle_s, length_s) = (fit.middle / rate_hz, fit.length_s);
                list.push(SineOf { setting: **setting, middle_s, length_s, tones, contrasts });
            }
        }
        if list.len() < LEAST_SINES {
            return Err(DiagnoseError::FewSines { found: list.len(), needed: LEAST_SINES });
        }
        let opposite = opposite(&list);
        turn(&mut list, opposite);
        let length_s = samples.t_s.last().copied().unwrap_or(1.0);
        let setting = |sine: &SineOf| SineSetting { frequency_hz: sine.setting.frequency_hz, middle_s: sine.middle_s + zero_s };
        let run = SineRun {
            settings: list.iter().map(setting).collect(),
            rate_hz,
            length_s,
            begins_known: false,
            tags_are_rounded: zero_std_s > LEAST_ROUNDING_S,
            temperatures: temperatures.clone(),
        };
        Ok(Self { list, run })
    }

    /// Rows per setting.
    pub fn rows(&self) -> usize {
        if self.run.begins_known { 9 } else { 8 }
    }

    /// Triples of every setting and component in units of their noise: three amplitudes, phases (all, or two contrasts), three slopes.
    pub fn whiten(&self, triple: impl Fn(usize, usize) -> Triple) -> DVector<f64> {
        let mut out = Vec::with_capacity(self.rows() * self.list.len());
        for (j, sine) in self.list.iter().enumerate() {
            let raw: [Triple; 3] = std::array::from_fn(|i| triple(j, i));
            let white = |i: usize, what: usize| raw[i][what] / sine.tones[i].std[what];
            out.extend((0..3).map(|i| white(i, 0)));
            if self.run.begins_known {
                out.extend((0..3).map(|i| white(i, 1)));
            } else {
                out.extend(sine.contrasts.map(|c| (0..3).map(|i| c[i] * white(i, 1)).sum::<f64>()));
            }
            out.extend((0..3).map(|i| white(i, 2)));
        }
        DVector::from_vec(out)
    }

    /// Measured less predicted, whitened.
    pub fn residual(&self, predicted: impl Fn(usize, usize) -> Triple) -> DVector<f64> {
        let all: Vec<[Triple; 3]> = (0..self.list.len())
            .map(|j| {
                let tones = &self.list[j].tones;
                let mut difference: [Triple; 3] = std::array::from_fn(|i| {
                    let [a, p, s] = predicted(j, i);
                    [tones[i].log_amplitude - a, tones[i].phase_rad - p, tones[i].slope_rad_per_s - s]
                });
                // A phase of the setting's own is taken off before whole turns are.
                let common = if self.run.begins_known { 0.0 } else { difference[0][1] };
                difference.iter_mut().for_each(|d| d[1] = wrapped(d[1] - common));
                difference
            })
            .collect();
        self.whiten(|j, i| all[j][i])
    }

    /// Whether the phases of the field are those of sines that begin with their settings, by a response: upright, or of opposite sign on all
    /// axes, which are turned then.
    pub fn see_begins(&mut self, predicted: impl Fn(usize, usize) -> Triple) {
        let agree = |j: usize, by: f64| -> bool {
            (0..3).all(|i| wrapped(self.list[j].tones[i].phase_rad + by - predicted(j, i)[1]).abs() < AGREES_RAD)
        };
        let is_seen = |by: f64| {
            let agreeing = (0..self.list.len()).filter(|j| agree(*j, by)).count();
            agreeing as f64 >= AGREEING * self.list.len() as f64
        };
        let is_opposite = is_seen(PI);
        self.run.begins_known = is_opposite || is_seen(0.0);
        if is_opposite {
            turn(&mut self.list, [true; 3]);
        }
    }
}

/// The axes that see the field with another sign than x does: at the lowest frequencies no response turns a phase by much, so that what lies
/// near half a turn there is the sign.
fn opposite(list: &[SineOf]) -> [bool; 3] {
    let mut order: Vec<&SineOf> = list.iter().collect();
    order.sort_by(|a, b| a.setting.frequency_hz.total_cmp(&b.setting.frequency_hz));
    let lowest = &order[..(list.len() / LOWEST_PART).max(LEAST_LOWEST).min(list.len())];
    let along = |i: usize| lowest.iter().map(|s| (s.tones[i].phase_rad - s.tones[0].phase_rad).cos()).sum::<f64>();
    std::array::from_fn(|i| along(i) < 0.0)
}

/// Turns the phases of axes by half a turn.
fn turn(list: &mut [SineOf], axes: [bool; 3]) {
    for sine in list {
        for (tone, _) in sine.tones.iter_mut().zip(axes).filter(|(_, turned)| *turned) {
            tone.phase_rad = wrapped(tone.phase_rad + PI);
        }
    }
}

/// Time of counter 0 in the time of the settings and its standard uncertainty by the rounding of the time tags, s: a straight line through
/// the tags, because an error of the sampling frequency would displace their mean.
fn counter_zero(samples: &Samples, rate_hz: f64) -> (f64, f64) {
    let count = samples.n.len() as f64;
    let offset = |n: u64, t: f64| t - n as f64 / rate_hz;
    let pairs = || samples.n.iter().zip(&samples.t_s).map(|(n, t)| (*n as f64, offset(*n, *t)));
    let (mean_n, mean_t) = pairs().fold((0.0, 0.0), |(a, b), (n, t)| (a + n / count, b + t / count));
    let (nn, nt) = pairs().fold((0.0, 0.0), |(a, b), (n, t)| (a + (n - mean_n).powi(2), b + (n - mean_n) * (t - mean_t)));
    let slope = if nn > 0.0 { nt / nn } else { 0.0 };
    let zero = mean_t - slope * mean_n;
    let squares: f64 = pairs().map(|(n, t)| (t - zero - slope * n).powi(2)).sum();
    (zero, (squares / count * (1.0 / count + if nn > 0.0 { mean_n * mean_n / nn } else { 0.0 })).sqrt())
}

/// Within half a turn of zero, rad.
pub fn wrapped(phase_rad: f64) -> f64 {
    let turns = phase_rad / TAU;
    let rest = TAU * (turns - turns.round());
    if rest <= -PI { rest + TAU } else { rest }
}

/// Two unit vectors at right angles to a vector and to each other.
fn contrasts(v: [f64; 3]) -> [[f64; 3]; 2] {
    let v = nalgebra::Vector3::from(v).normalize();
    let least = v.iamin();
    let first = v.cross(&nalgebra::Vector3::ith(least, 1.0)).normalize();
    let second = v.cross(&first);
    [first.into(), second.into()]
}

/// The sines of one setting.
struct Fitted {
    n: Vec<u64>,
    sines: [sine::Sine; 3],
    /// Change of the phase and its standard uncertainty, rad/s.
    slopes: [[f64; 2]; 3],
    /// Counter to which the phases refer as far as their change goes.
    middle: f64,
    length_s: f64,
}

impl Fitted {
    fn new(samples: &Samples, range: std::ops::Range<usize>, frequency_hz: f64, rate_hz: f64) -> Option<Self> {
        let n = samples.n[range.clone()].to_vec();
        let middle = n.iter().map(|n| *n as f64).sum::<f64>() / n.len() as f64;
        let mut slopes = [[0.0; 2]; 3];
        let mut sines = Vec::with_capacity(3);
        for i in 0..3 {
            let y: Vec<f64> = samples.reading_ent[range.clone()].iter().map(|r| r[i]).collect();
            let sine = sine::three(&n, &y, frequency_hz, rate_hz).ok()?;
            slopes[i] = slope(&n, &sine, middle, frequency_hz, rate_hz)?;
            sines.push(sine);
        }
        let length_s = (n.last()? - n.first()?) as f64 / rate_hz;
        Some(Self { n, sines: sines.try_into().ok()?, slopes, middle, length_s })
    }
}

/// Rate of change of the phase of a fitted sine and its standard uncertainty for white noise, rad/s: residuals along the derivative of the
/// sine, of which sine, cosine and one were taken off.
fn slope(n: &[u64], sine: &sine::Sine, middle: f64, frequency_hz: f64, rate_hz: f64) -> Option<[f64; 2]> {
    let mut oscillator = sine::Oscillator::new(frequency_hz, rate_hz);
    let base: Vec<[f64; 3]> = n.iter().map(|n| oscillator.at(*n)).map(|[s, c]| [s, c, 1.0]).collect();
    let along: Vec<f64> =
        n.iter().zip(&base).map(|(n, [s, c, _])| (*n as f64 - middle) / rate_hz * (sine.sin * c - sine.cos * s)).collect();
    let mut normal = nalgebra::Matrix3::zeros();
    let mut right = nalgebra::Vector3::zeros();
    for (b, d) in base.iter().zip(&along) {
        let b = nalgebra::Vector3::from(*b);
        normal += b * b.transpose();
        right += b * *d;
    }
    let taken = normal.cholesky()?.solve(&right);
    let (mut product, mut square) = (0.0, 0.0);
    for ((b, d), r) in base.iter().zip(&along).zip(&sine.residuals) {
        let left = d - (0..3).map(|k| taken[k] * b[k]).sum::<f64>();
        product += left * r;
        square += left * left;
    }
    (square > 0.0).then(|| [product / square, sine.residual_std / square.sqrt()])
}
