//! Noise of a long record: spectrum, lines, white and 1/f noise, Allan deviation.

use super::record::Kept;
use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::data::zero_field::{AllanDeviations, NoiseCorner, NoiseDensity, NoiseSpectrum, SpectralLine};
use crate::fit::allan::{self, Deviation};
use crate::fit::spectrum::{self, FIRST_BIN, Line, NEXT_BIN, Point, Stage, WhiteAndSlow, limits};

/// Points of the spectrum in a decade.
const PER_DECADE: f64 = 16.0;
/// The density is stated at this frequency, Hz, from the bins within this factor of it.
pub const STATED_HZ: f64 = 1.0;
const STATED_RATIO: f64 = 1.15;
/// White and 1/f noise are fitted from here, Hz, to a quarter of the sample rate, above which the instrument's own filter shows.
const FIT_FROM_HZ: f64 = 2e-3;
const FIT_TO_RATE: f64 = 0.25;
/// χ² per degree of freedom from which on white and 1/f noise do not describe the spectrum.
const BAD_FIT: f64 = 3.0;

/// What a record shows of its noise.
pub(super) struct Noise {
    /// Amplitude density at [`STATED_HZ`].
    pub density: Option<NoiseDensity>,
    /// White and 1/f noise.
    pub corner: NoiseCorner,
    /// Lines in the spectrum.
    pub line: Vec<SpectralLine>,
    /// The spectrum without them.
    pub spectrum: NoiseSpectrum,
    /// The Allan deviation.
    pub allan: AllanDeviations,
}

impl Noise {
    /// Of a record with a sample rate.
    pub fn of(record: &Kept, rate_hz: f64) -> Self {
        let stages = stages(record, rate_hz);
        let mut lines: Vec<Line> = stages.iter().flat_map(spectrum::lines).collect();
        lines.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz).then(a.component.cmp(&b.component)));
        let points = spectrum::bands(&stages, PER_DECADE, &lines);
        Self {
            density: density(&stages, &lines),
            corner: corner_part(&corner(&points, rate_hz)),
            line: lines.iter().map(line_part).collect(),
            spectrum: spectrum_part(&points),
            allan: allan_part(&allan::deviations(&record.within, &record.bins, record.bin_samples, rate_hz)),
        }
    }

    /// What a person should know of it; the sample rate is that of the record.
    pub fn notes(&self, rate_hz: f64) -> Vec<Note> {
        let mut notes = Vec::new();
        if self.density.is_none() {
            let text = format!(
                "no density at {STATED_HZ} Hz: the sample rate or the record does not reach it, or lines take all of its band"
            );
            notes.push(Note::new(NoteKind::Method, text));
        }
        for (name, chi_square) in COMPONENTS.into_iter().zip(self.corner.chi_square_per_degree) {
            if chi_square > BAD_FIT {
                let text = format!(
                    "{name}: white and 1/f noise do not describe the spectrum (χ² {chi_square:.1} per degree of freedom)"
                );
                notes.push(Note::new(NoteKind::Method, text).about(name));
            }
        }
        notes.extend(unseen_white(self.corner.corner_hz, rate_hz));
        notes
    }
}

/// Says of corners where white noise is hardly seen.
fn unseen_white(corner_hz: [f64; 3], rate_hz: f64) -> impl Iterator<Item = Note> {
    let beyond = COMPONENTS.into_iter().zip(corner_hz).filter(move |(_, corner_hz)| *corner_hz > 0.5 * rate_hz);
    beyond.map(|(name, corner_hz)| {
        let text = format!(
            "{name}: the corner of white and 1/f noise ({corner_hz:.2} Hz) lies beyond half of the sampling frequency: hardly any white noise is seen, \
             and the corner may be several times as high as its uncertainty says"
        );
        Note::new(NoteKind::Method, text).about(name).with_remedy("record at a higher rate to tell it")
    })
}

/// The spectrum from the lowest frequency to the highest: long segments of the slow record, then the full rate.
fn stages(record: &Kept, rate_hz: f64) -> Vec<Stage> {
    let full = record.welch.density(rate_hz).filter(|_| record.head.is_none());
    let (slow, slow_hz) = match &record.head {
        Some(head) => (head, rate_hz),
        None => (&record.slow, rate_hz / record.slow_samples as f64),
    };
    // Above this the full rate takes over, or the record is at full rate itself.
    let until_hz = full.as_ref().map_or(f64::INFINITY, |f| NEXT_BIN as f64 * f.step_hz);
    let mut stages = Vec::new();
    let mut length = spectrum::longest_segment(slow[0].len());
    let mut from = FIRST_BIN as f64;
    while length >= 64 {
        let Some(density) = spectrum::of_record(slow.each_ref().map(Vec::as_slice), slow_hz, length) else {
            // Gaps leave no segment of this length.
            length = length / 4 * 2;
            continue;
        };
        let next = length / 8 * 2;
        let step = density.step_hz;
        let is_last = next < 64 || NEXT_BIN as f64 * slow_hz / next as f64 > until_hz;
        let top = density.power[0].len() - 1;
        let end_hz = if is_last { until_hz } else { NEXT_BIN as f64 * slow_hz / next as f64 };
        let end = if end_hz.is_finite() { ((end_hz / step).ceil() as usize).min(top) } else { top };
        let begin = from.ceil() as usize;
        if end > begin {
            stages.push(Stage { density, bins: [begin, end] });
        }
        from = NEXT_BIN as f64;
        if is_last {
            break;
        }
        length = next;
    }
    if let Some(full) = full {
        let top = full.power[0].len() - 1;
        let begin = if stages.is_empty() { FIRST_BIN } else { NEXT_BIN };
        stages.push(Stage { density: full, bins: [begin, top] });
    }
    stages
}

/// Amplitude density at 1 Hz from the bins around it.
fn density(stages: &[Stage], lines: &[Line]) -> Option<NoiseDensity> {
    let [low, high] = [STATED_HZ / STATED_RATIO, STATED_HZ * STATED_RATIO];
    let covers = |s: &&Stage, bins: [usize; 2]| {
        bins[0] as f64 * s.density.step_hz <= low && (bins[1] - 1) as f64 * s.density.step_hz >= high
    };
    let whole = |s: &Stage| [FIRST_BIN, s.density.power[0].len()];
    let own = stages.iter().filter(|s| covers(s, s.bins));
    // The band may lie across two stages, or a line may take all of its bins in one: the others reach beyond their own bins, the last has the most segments.
    let others = stages.iter().rev().filter(|s| covers(s, whole(s)));
    let point = own.chain(others).find_map(|stage| {
        let step = stage.density.step_hz;
        let bins = [(low / step).ceil() as usize, (high / step).floor() as usize + 1];
        // One band of all of it.
        spectrum::bands(&[Stage { density: stage.density.clone(), bins }], 0.5, lines).first().copied()
    })?;
    let [low, high] = point.limits();
    let amplitude: [f64; 3] = std::array::from_fn(|c| point.amplitude(c));
    Some(NoiseDensity {
        frequency_hz: STATED_HZ,
        band_hz: point.band_hz,
        ent_per_root_hz: amplitude,
        std_ent_per_root_hz: amplitude.map(|a| a / (2.0 * point.degrees_of_freedom).sqrt()),
        low_ent_per_root_hz: amplitude.map(|a| a * low),
        high_ent_per_root_hz: amplitude.map(|a| a * high),
        degrees_of_freedom: point.degrees_of_freedom,
    })
}

fn corner(points: &[Point], rate_hz: f64) -> [Option<WhiteAndSlow>; 3] {
    let used: Vec<&Point> =
        points.iter().filter(|p| p.frequency_hz >= FIT_FROM_HZ && p.frequency_hz <= FIT_TO_RATE * rate_hz).collect();
    std::array::from_fn(|c| spectrum::white_and_slow(&used, c))
}

fn corner_part(corner: &[Option<WhiteAndSlow>; 3]) -> NoiseCorner {
    let get = |f: &dyn Fn(&WhiteAndSlow) -> f64| std::array::from_fn(|c| corner[c].as_ref().map_or(f64::NAN, f));
    NoiseCorner {
        white_ent_per_root_hz: get(&|w| w.white.max(0.0).sqrt()),
        white_std_ent_per_root_hz: get(&|w| 0.5 * w.white_std / w.white.sqrt()),
        slow_ent_per_root_hz: get(&|w| w.slow.max(0.0).sqrt()),
        corner_hz: get(&|w| w.corner_hz),
        corner_std_hz: get(&|w| w.corner_std_hz),
        chi_square_per_degree: get(&|w| w.chi_square_per_degree),
    }
}

fn line_part(line: &Line) -> SpectralLine {
    SpectralLine {
        component: COMPONENTS[line.component].to_owned(),
        frequency_hz: line.frequency_hz,
        resolution_hz: line.step_hz,
        amplitude_ent: line.amplitude,
        amplitude_std_ent: line.amplitude_std,
        power_ratio: line.ratio,
    }
}

fn spectrum_part(points: &[Point]) -> NoiseSpectrum {
    let density = |c: usize| points.iter().map(|p| p.amplitude(c)).collect();
    NoiseSpectrum {
        frequency_hz: points.iter().map(|p| p.frequency_hz).collect(),
        x_ent_per_root_hz: density(0),
        y_ent_per_root_hz: density(1),
        z_ent_per_root_hz: density(2),
        low_factor: points.iter().map(|p| p.limits()[0]).collect(),
        high_factor: points.iter().map(|p| p.limits()[1]).collect(),
        degrees_of_freedom: points.iter().map(|p| p.degrees_of_freedom).collect(),
    }
}

fn allan_part(list: &[Deviation]) -> AllanDeviations {
    let deviation = |c: usize| list.iter().map(|d| d.deviation[c]).collect();
    AllanDeviations {
        tau_s: list.iter().map(|d| d.tau_s).collect(),
        x_ent: deviation(0),
        y_ent: deviation(1),
        z_ent: deviation(2),
        low_factor: list.iter().map(|d| limits(d.degrees_of_freedom)[0]).collect(),
        high_factor: list.iter().map(|d| limits(d.degrees_of_freedom)[1]).collect(),
        degrees_of_freedom: list.iter().map(|d| d.degrees_of_freedom).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_beyond_half_of_the_sampling_frequency_is_told() {
        let told: Vec<Note> = unseen_white([1.9, 3.0, f64::NAN], 4.0).collect();
        assert!(matches!(told.as_slice(), [note] if note.text.contains("y: the corner")), "{told:?}");
    }
}
