//! The part of every setting that one sine describes in all components.

use super::rounding;
use super::samples::{LEAST_SAMPLES, Record};
use crate::data::run::Setting;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{self, Oscillator, SineRefusal, Sums};
use crate::fit::statistics::median;
use rayon::prelude::*;
use std::ops::Range;

/// Segments in which damage is looked for.
const SEGMENTS: usize = 48;
/// Least part of a setting that must be undamaged.
const LEAST_PART: f64 = 0.25;
/// Least number of cycles in a setting: with fewer, offset and amplitude trade against each other.
const LEAST_CYCLES: f64 = 1.0;
/// A stretch belongs to the sine if its residuals are within this factor of those of the other settings.
const TOLERANCE: f64 = 4.0;
/// Residuals of this part of the amplitude are distortion and no damage.
const DISTORTION: f64 = 1e-3;
/// A component is cut off if more than this part of its readings is equal to an end of its range, with this many levels between.
const RESTING_PART: f64 = 0.05;
const LEAST_LEVELS: usize = 100;
/// A whole number of periods is used where it costs no more than this part of the samples.
const WHOLE_PERIODS_PART: f64 = 0.02;

/// What was found of one setting.
pub(super) struct Tone {
    pub setting: Setting,
    pub used: Range<usize>,
    /// It holds something else than its sine.
    pub disturbed: bool,
    pub remark: String,
}

/// The settled samples of one setting, cut into segments with the sums of a sine in each.
struct Cut {
    /// Begins of the segments and end of the last.
    edges: Vec<usize>,
    sums: [Vec<Sums>; 3],
}

impl Cut {
    fn of(record: &Record, setting: &Setting, range: &Range<usize>, rate_hz: f64) -> Self {
        let per_segment = (range.len() / SEGMENTS).max(LEAST_SAMPLES);
        let count = (range.len() / per_segment).max(1);
        let edge = |segment: usize| if segment == count { range.end } else { range.start + segment * per_segment };
        let edges: Vec<usize> = (0..=count).map(edge).collect();
        let sums = std::array::from_fn(|i| {
            let mut oscillator = Oscillator::new(setting.frequency_hz, rate_hz);
            let segment = |ends: &[usize]| {
                let mut sums = Sums::new(record.y[i].get(range.start).copied().unwrap_or_default());
                for k in ends[0]..ends[1] {
                    sums.add(oscillator.at(record.n[k]), record.y[i][k]);
                }
                sums
            };
            edges.windows(2).map(segment).collect()
        });
        Self { edges, sums }
    }

    /// Amplitude of one sine through all segments of a component.
    fn amplitude(&self, component: usize) -> f64 {
        let mut all = self.sums[component].clone().into_iter();
        let Some(mut total) = all.next() else { return 0.0 };
        all.for_each(|segment| total.merge(&segment));
        total.solve().map_or(0.0, |(a, b, ..)| a.hypot(b))
    }

    /// Typical standard deviation of the samples about a sine of their own segment: damage between segments does not show in it.
    fn noise(&self, component: usize) -> Option<f64> {
        let of = |sums: &Sums| {
            let free = sums.count().checked_sub(3).filter(|free| *free > 0)?;
            sums.solve().map(|(.., rss)| (rss / free as f64).sqrt())
        };
        let mut all: Vec<f64> = self.sums[component].iter().filter_map(of).collect();
        (!all.is_empty()).then(|| median(&mut all))
    }
}

/// The part of every setting that one sine describes in all components, cut to whole periods where that costs little.
pub(super) fn undamaged(records: &[&Record], settings: &[Setting], settled: &[Range<usize>], rate_hz: f64) -> Vec<Tone> {
    let search = Search::new(records, settings, settled, rate_hz);
    (0..records.len()).into_par_iter().map(|j| search.tone(j)).collect()
}

/// Why a setting is not used.
struct Refused {
    /// It holds something else than its sine.
    disturbed: bool,
    remark: String,
}

impl From<String> for Refused {
    fn from(remark: String) -> Self {
        Self { disturbed: false, remark }
    }
}

/// The settled samples of all settings, with what is typical of the run.
struct Search<'a> {
    records: &'a [&'a Record],
    settings: &'a [Setting],
    settled: &'a [Range<usize>],
    rate_hz: f64,
    cuts: Vec<Cut>,
    /// Noise of a good setting per component, and at least what rounding leaves of a reading, enT.
    floor_ent: [f64; 3],
    /// Smallest and largest reading of the run per component, enT.
    ends_ent: [[f64; 2]; 3],
}

impl<'a> Search<'a> {
    fn new(records: &'a [&'a Record], settings: &'a [Setting], settled: &'a [Range<usize>], rate_hz: f64) -> Self {
        let cuts: Vec<Cut> =
            (0..records.len()).into_par_iter().map(|j| Cut::of(records[j], &settings[j], &settled[j], rate_hz)).collect();
        // Settings that hold other frequencies have large residuals everywhere; a quarter of good ones is enough to know the noise.
        let floor_ent = std::array::from_fn(|i| {
            let mut all: Vec<f64> = cuts.iter().filter_map(|cut| cut.noise(i)).collect();
            all.sort_by(f64::total_cmp);
            let noise = all.get(all.len() / 4).copied().unwrap_or(0.0);
            // Where few phases are met, the sine of a segment takes their rounding errors with it; in a longer stretch they remain.
            noise.max(rounding::resolution(records.iter().map(|r| r.y[i].as_slice())).map_or(0.0, rounding::uniform_std))
        });
        let ends_ent = std::array::from_fn(|i| {
            let readings = || records.iter().flat_map(|r| r.y[i].iter().copied());
            [readings().fold(f64::INFINITY, f64::min), readings().fold(f64::NEG_INFINITY, f64::max)]
        });
        Self { records, settings, settled, rate_hz, cuts, floor_ent, ends_ent }
    }

    fn tone(&self, j: usize) -> Tone {
        let setting = self.settings[j];
        match self.used(j) {
            Ok((used, remark)) => Tone { setting, used, disturbed: false, remark },
            Err(Refused { disturbed, remark }) => Tone { setting, used: 0..0, disturbed, remark },
        }
    }

    /// The samples of a setting that are used, with a remark if they are not all.
    fn used(&self, j: usize) -> Result<(Range<usize>, String), Refused> {
        let (record, frequency_hz, range) = (self.records[j], self.settings[j].frequency_hz, &self.settled[j]);
        let seen_s = record.t_s.get(range.start).zip(record.t_s.last());
        let cycles = seen_s.map_or(0.0, |(first, last)| (last - first) * frequency_hz);
        if cycles < LEAST_CYCLES {
            return Err(format!("its settled samples span {cycles:.2} cycles, at least {LEAST_CYCLES} is needed").into());
        }
        self.check_sine(j, range).map_err(|refusal| refusal.to_string())?;
        let edges = &self.cuts[j].edges;
        let count = edges.len() - 1;
        let kept = self.segments(j)?;
        let used = whole_periods(record, edges[kept.start]..edges[kept.end], frequency_hz);
        self.check_sine(j, &used).map_err(|refusal| format!("of its undamaged part, {refusal}"))?;
        let remark = if kept.len() < count {
            format!("{:.0} % of the setting is damaged and was left out", 100.0 * (1.0 - kept.len() as f64 / count as f64))
        } else {
            String::new()
        };
        Ok((used, remark))
    }

    /// Whether samples of a setting determine its sine.
    fn check_sine(&self, j: usize, range: &Range<usize>) -> Result<(), SineRefusal> {
        let record = self.records[j];
        let (n, readings) = (&record.n[range.clone()], &record.y[0][range.clone()]);
        sine::three(n, readings, self.settings[j].frequency_hz, self.rate_hz).map(drop)
    }

    /// The segments of a setting that one sine describes in all components.
    fn segments(&self, j: usize) -> Result<Range<usize>, Refused> {
        let (record, cut) = (self.records[j], &self.cuts[j]);
        let count = cut.edges.len() - 1;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive number")]
        let least = ((count as f64 * LEAST_PART).ceil() as usize).max(1);
        let mut kept = 0..count;
        for (i, name) in COMPONENTS.into_iter().enumerate() {
            if rests_at_end(&record.y[i][self.settled[j].clone()], self.ends_ent[i]) {
                return Err(format!("component {name} rests at the end of its range").into());
            }
            let limit_std = self.floor_ent[i].max(DISTORTION * cut.amplitude(i));
            match sine::coherent(&cut.sums[i], limit_std, TOLERANCE, least) {
                Some(run) => kept = kept.start.max(run.start)..kept.end.min(run.end),
                None => {
                    let remark = format!(
                        "no stretch of component {name} follows a sine of this frequency; the setting is disturbed, or another one"
                    );
                    return Err(Refused { disturbed: true, remark });
                }
            }
        }
        if (kept.len() as f64) < LEAST_PART * count as f64 {
            return Err("the components have no undamaged stretch in common".to_owned().into());
        }
        Ok(kept)
    }
}

/// Whether many readings are equal to the smallest or the largest one of the run, and far apart from each other: a sine that is cut off.
fn rests_at_end(readings: &[f64], [low, high]: [f64; 2]) -> bool {
    let largest = readings.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let smallest = readings.iter().copied().fold(f64::INFINITY, f64::min);
    let mut levels = readings.to_vec();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    // Of a sine of a few digits many readings are equal anyway.
    levels.len() > LEAST_LEVELS
        && [(low, smallest), (high, largest)].into_iter().any(|(end, own)| {
            let resting = readings.iter().filter(|y| **y == own).count();
            own == end && resting as f64 > RESTING_PART * readings.len() as f64
        })
}

/// The stretch without the samples beyond the last whole period, if they are few.
fn whole_periods(record: &Record, range: Range<usize>, frequency_hz: f64) -> Range<usize> {
    let (Some(first), Some(last)) = (record.t_s.get(range.start), record.t_s.get(range.end.saturating_sub(1))) else {
        return range;
    };
    let periods = ((last - first) * frequency_hz).floor();
    let end_s = first + periods / frequency_hz;
    let end = range.start + record.t_s[range.clone()].partition_point(|t| *t < end_s);
    if (range.end - end) as f64 <= WHOLE_PERIODS_PART * range.len() as f64 { range.start..end } else { range }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::units::FieldCoil;
    use crate::fit::random::Random;
    use std::f64::consts::TAU;

    /// Sines at frequencies that meet few phases, and at some that drift through all, whose readings are rounded by more than their noise: nothing
    /// of them is damaged, and a part of another phase is found.
    #[test]
    fn rounding_is_no_damage() {
        const RATE: f64 = 128.0;
        for noise in [0.02, 0.1, 0.3] {
            let mut random = Random::seeded(7);
            let frequencies = [32.0, 32.0, 32.0, RATE / 3.0, RATE / 3.0, 7.123, 3.01, 16.01, 32.003, 8.001];
            let mut record = |frequency: f64, is_damaged: bool| {
                let n: Vec<u64> = (0..3000).collect();
                let (amplitude, phase) = (8.0 + 30.0 * random.uniform(), TAU * random.uniform());
                let mut reading = |n: &u64, component: usize| {
                    let slip = if is_damaged && *n > 2250 { 1.0 } else { 0.0 };
                    let angle = sine::phase(frequency, RATE, *n) + phase + slip;
                    (amplitude * (1.0 - 0.1 * component as f64) * angle.sin() + 0.3 + noise * random.gaussian()).round()
                };
                let y = std::array::from_fn(|component| n.iter().map(|n| reading(n, component)).collect());
                Record { t_s: n.iter().map(|n| *n as f64 / RATE).collect(), n, y }
            };
            let setting = |frequency_hz: f64| Setting {
                t_start_s: 0.0,
                t_end_s: 3000.0 / RATE,
                field: FieldCoil([10.0, 0.0, 0.0]),
                frequency_hz,
                position: 1,
            };
            for damaged in [None, Some(0), Some(5)] {
                let records: Vec<Record> = frequencies.iter().enumerate().map(|(j, f)| record(*f, damaged == Some(j))).collect();
                let settings = frequencies.map(setting);
                let tones = undamaged(&records.iter().collect::<Vec<_>>(), &settings, &vec![0..3000; settings.len()], RATE);
                for (j, tone) in tones.iter().enumerate() {
                    let at = format!("noise {noise}, {} Hz: {:?} {}", frequencies[j], tone.used, tone.remark);
                    if damaged == Some(j) {
                        assert!(tone.used.end <= 2320 && tone.used.len() > 2000 && tone.remark.contains("damaged"), "{at}");
                    } else {
                        assert!(tone.remark.is_empty() && tone.used.len() > 2900, "{at}");
                    }
                }
            }
        }
    }
}
