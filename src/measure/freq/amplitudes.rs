//! Amplitude and phase of every setting, with uncertainties from the noise near its frequency.

use super::clock::Clock;
use super::rounding::{self, Rounded};
use super::samples::Record;
use super::tones::Tone;
use crate::data::frequency::SineAmplitude;
use crate::data::note::Note;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{self, Residue, Sine, SineRefusal};
use crate::record::screens::inside;
use nalgebra::DMatrix;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// An amplitude of fewer standard uncertainties does not stand out of the noise.
pub(super) const DETECTED: f64 = 3.0;

/// Amplitude and phase of every setting; those that were refused say why. Beside them jumps of the gain inside settings.
pub(super) fn amplitudes(tones: &[Tone], records: &[&Record], clock: &Clock) -> (Vec<SineAmplitude>, Vec<Note>) {
    let fits: Vec<Result<Option<Fits>, SineRefusal>> =
        tones.par_iter().zip(records).map(|(tone, record)| Fits::of(tone, record, clock)).collect();
    let noise = noise(tones, records, &fits, clock);
    let of = |j: usize| fits[j].as_ref().ok().and_then(Option::as_ref).map(|f| jumps(&tones[j], records[j], f, noise[j]));
    let jumps: Vec<Vec<Note>> = (0..tones.len()).into_par_iter().filter_map(of).collect();
    let rounding: Vec<Vec<f64>> = (0..3).into_par_iter().map(|i| rounding_std(i, tones, records, &fits)).collect();
    let measured = (0..tones.len())
        .map(|j| amplitude(&tones[j], records[j], &fits[j], noise[j], [0, 1, 2].map(|i| rounding[i][j])))
        .collect();
    (measured, jumps.concat())
}

/// The sines of one setting.
struct Fits {
    rate_hz: f64,
    components: [Sine; 3],
}

impl Fits {
    /// `None` if no part of the setting is used, or why it has none.
    fn of(tone: &Tone, record: &Record, clock: &Clock) -> Result<Option<Self>, SineRefusal> {
        let used = tone.used.clone();
        let Some([first, last]) = record.ends_s(&used) else { return Ok(None) };
        let rate_hz = clock.at(0.5 * (first + last));
        let three = |i: usize| {
            let readings = &record.y[i][used.clone()];
            sine::three(&record.n[used.clone()], readings, tone.setting.frequency_hz, rate_hz)
        };
        Ok(Some(Self { rate_hz, components: [three(0)?, three(1)?, three(2)?] }))
    }
}

/// Standard deviation of a reading by the noise near the frequency, per setting and component, for amplitude and phase.
fn noise(
    tones: &[Tone],
    records: &[&Record],
    fits: &[Result<Option<Fits>, SineRefusal>],
    clock: &Clock,
) -> Vec<[Option<[f64; 2]>; 3]> {
    let present: Vec<(usize, &Fits)> =
        fits.iter().enumerate().filter_map(|(j, fits)| Some((j, fits.as_ref().ok()?.as_ref()?))).collect();
    let of = |i: usize| {
        let mut residues = Vec::with_capacity(present.len());
        for (j, fits) in &present {
            let (n, fit) = (&records[*j].n[tones[*j].used.clone()], &fits.components[i]);
            let frequency_hz = tones[*j].setting.frequency_hz;
            residues.push(Residue { n, residuals: &fit.residuals, frequency_hz, phase_rad: fit.phase_rad });
        }
        sine::noise_near(&residues, clock.mean_hz)
    };
    let components: Vec<Vec<Option<[f64; 2]>>> = (0..3).into_par_iter().map(of).collect();
    let mut noise = vec![[None; 3]; tones.len()];
    for (k, (j, _)) in present.iter().enumerate() {
        noise[*j] = std::array::from_fn(|i| components[i][k]);
    }
    noise
}

/// What the rounding of the readings leaves of the amplitudes of a component, one standard deviation per setting; zero where they show no step.
fn rounding_std(component: usize, tones: &[Tone], records: &[&Record], fits: &[Result<Option<Fits>, SineRefusal>]) -> Vec<f64> {
    let used = |j: usize| &records[j].y[component][tones[j].used.clone()];
    let Some(step) = rounding::resolution((0..tones.len()).map(used)) else { return vec![0.0; tones.len()] };
    let rounded = |j: usize| {
        let fits = fits[j].as_ref().ok()?.as_ref()?;
        let (n, frequency_hz) = (&records[j].n[tones[j].used.clone()], tones[j].setting.frequency_hz);
        Some(Rounded { n, frequency_hz, rate_hz: fits.rate_hz, sine: &fits.components[component] })
    };
    rounding::amplitude_stds(step, &(0..tones.len()).map(rounded).collect::<Vec<_>>())
}

/// Amplitude and phase of one setting.
fn amplitude(
    tone: &Tone,
    record: &Record,
    fits: &Result<Option<Fits>, SineRefusal>,
    noise: [Option<[f64; 2]>; 3],
    rounding_std: [f64; 3],
) -> SineAmplitude {
    let frequency_hz = tone.setting.frequency_hz;
    let mut part = SineAmplitude {
        frequency_hz,
        b_ent: [f64::NAN; 3],
        b_std_ent: [f64::NAN; 3],
        applied_nt: None,
        phase_deg: None,
        phase_std_deg: None,
        phase_counter: None,
        used: false,
        weight: [0.0; 3],
        detected: [false; 3],
        alias_hz: None,
        used_s: None,
        samples: None,
        remark: tone.remark.clone(),
    };
    let fits = match fits {
        Ok(Some(fits)) => fits,
        Ok(None) => return part,
        Err(refusal) => {
            part.remark = refusal.to_string();
            return part;
        }
    };
    let n = &record.n[tone.used.clone()];
    // In the middle of the stretch the phase is seen, elsewhere it depends on the sampling frequency.
    let middle = n[n.len() / 2];
    let turned = sine::phase(frequency_hz, fits.rate_hz, middle);
    let (mut phase_deg, mut phase_std_deg) = ([f64::NAN; 3], [f64::NAN; 3]);
    for (i, fit) in fits.components.iter().enumerate() {
        // Standard deviations of the fit take the residuals for white noise.
        let [of_amplitude, of_phase] = match noise[i] {
            Some(near) if fit.residual_std > 0.0 => near.map(|near| near / fit.residual_std),
            _ => [1.0; 2],
        };
        let std = rounding_std[i].hypot(of_amplitude * fit.amplitude_std);
        part.b_ent[i] = fit.amplitude;
        part.b_std_ent[i] = std;
        part.detected[i] = fit.amplitude > DETECTED * std;
        if part.detected[i] {
            let phase = (fit.phase_rad + turned) / TAU;
            phase_deg[i] = within_a_turn_deg(phase);
            phase_std_deg[i] = (rounding_std[i] / fit.amplitude).hypot(of_phase * fit.phase_std_rad).to_degrees();
        }
    }
    let cycles = frequency_hz / fits.rate_hz;
    part.alias_hz = Some((cycles - cycles.round()).abs() * fits.rate_hz);
    part.phase_counter = Some(middle);
    part.phase_deg = Some(phase_deg);
    part.phase_std_deg = Some(phase_std_deg);
    part.used_s = record.ends_s(&tone.used);
    part.samples = Some(n.len() as u64);
    part.used = true;
    part
}

/// Jumps of the gain inside a setting.
fn jumps(tone: &Tone, record: &Record, fits: &Fits, noise: [Option<[f64; 2]>; 3]) -> Vec<Note> {
    let (n, t_s) = (&record.n[tone.used.clone()], &record.t_s[tone.used.clone()]);
    let angles: Vec<f64> = n.iter().map(|n| sine::phase(tone.setting.frequency_hz, fits.rate_hz, *n)).collect();
    let columns = DMatrix::from_fn(angles.len(), 3, |i, j| match j {
        0 => 1.0,
        1 => angles[i].sin(),
        _ => angles[i].cos(),
    });
    let of = |i: usize| {
        let fit = &fits.components[i];
        let course: Vec<f64> = angles.iter().map(|a| fit.amplitude * (a + fit.phase_rad).sin()).collect();
        // Noise near the frequency, and not that of all frequencies, makes amplitudes.
        let excess = noise[i].map_or(1.0, |[near, _]| if fit.residual_std > 0.0 { near / fit.residual_std } else { 1.0 });
        let rows = inside::Rows { columns: &columns, residuals: &fit.residuals, course: &course, t_s, excess, has_signs: true };
        inside::gain_jump(&rows).map(|jump| jump.note(COMPONENTS[i], t_s[jump.row]))
    };
    (0..3).filter_map(of).collect()
}

/// Cycles as an angle from -180 to 180 degrees.
pub(super) fn within_a_turn_deg(cycles: f64) -> f64 {
    360.0 * (cycles - cycles.round())
}
