//! The sines of a run: the settings that have a frequency, and what of them can be used.

use super::rates::{Rates, rates};
use super::refusal::FreqError;
use super::samples::{LEAST_SAMPLES, Record, Sines};
use super::tones::{Tone, undamaged};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Settling;
use crate::data::run::{Run, Setting};
use crate::data::units::COMPONENTS;
use crate::record::known::in_sines::InSines;
use crate::record::screens::Implausible;
use std::ops::Range;

/// A run of which more than this part of the settings hold something else belongs to other settings.
const MOST_DISTURBED: f64 = 0.5;
/// Highest frequency of a sine over the sample rate: the search for the sampling frequency grows with it, no sensor passes so much, and a cell
/// with a digit too many is likelier.
const HIGHEST: f64 = 100.0;

/// The settings of a run that are sines, with their samples.
pub(super) struct Applied<'a> {
    /// The settings; frequencies are those by the clock of the facility.
    pub settings: Vec<Setting>,
    /// The samples of each.
    pub records: Vec<&'a Record>,
    /// Notes about settings that are none of them.
    pub notes: Vec<Note>,
    /// Known effects in them.
    pub known: InSines,
}

impl<'a> Applied<'a> {
    /// The sines, or why the run has none that can be analysed.
    pub fn of(run: &Run, sines: &'a Sines, known: InSines) -> Result<Self, FreqError> {
        if sines.overflown {
            return Err(FreqError::TooLong);
        }
        let mut indices: Vec<usize> = (0..sines.settings.len()).filter(|i| sines.settings[*i].frequency_hz > 0.0).collect();
        let highest_hz = HIGHEST * run.header.sample_rate_hz;
        let mut notes = Vec::new();
        let first_hz = indices.first().map(|i| sines.settings[*i].frequency_hz);
        indices.retain(|i| {
            let hz = sines.settings[*i].frequency_hz;
            if hz > highest_hz {
                let text = format!("{hz} Hz was refused: it is above {highest_hz} Hz, {HIGHEST} times the sample rate");
                notes.push(
                    Note::new(NoteKind::Data, text).about(format!("{hz} Hz")).with_remedy("correct the frequency in @FIELDS"),
                );
            }
            hz <= highest_hz
        });
        if indices.is_empty() {
            return Err(first_hz.map_or(FreqError::NoSines, |frequency_hz| FreqError::NothingUsable {
                frequency_hz,
                why: format!("it is above {highest_hz} Hz, {HIGHEST} times the sample rate"),
            }));
        }
        if sines.kept == 0 {
            return Err(FreqError::NoSamples);
        }
        let records: Vec<&Record> = indices.iter().map(|i| &sines.records[*i]).collect();
        check_samples(&records)?;
        Ok(Self { settings: indices.iter().map(|i| sines.settings[*i]).collect(), records, notes, known })
    }

    /// The settings with the frequencies that the clock of the instrument sees. A clock that is fast sees low frequencies: with these
    /// its known course is taken off.
    fn seen(&self, ranges: &[Range<usize>]) -> Vec<Setting> {
        let middle = |(record, range): (&&Record, &Range<usize>)| record.ends_s(range).map_or(0.0, |[a, b]| 0.5 * (a + b));
        let times = self.records.iter().zip(ranges).map(middle);
        let hz = |(s, t): (&Setting, f64)| Setting { frequency_hz: s.frequency_hz / (1.0 + self.known.clock(t)), ..*s };
        self.settings.iter().zip(times).map(hz).collect()
    }

    /// What can be used of every setting, at the frequency that the clock of the instrument sees, and a first sampling frequency, Hz.
    pub fn tones(&self, run: &Run, settling: Settling) -> Result<(Vec<Tone>, f64), FreqError> {
        let nominal_hz = run.header.sample_rate_hz;
        let each = self.records.iter().zip(&self.settings);
        let settled: Vec<Range<usize>> = each.map(|(r, s)| r.settled(s, settling, 1.0 / nominal_hz)).collect();
        let settings = self.seen(&settled);
        if settled.iter().all(|range| range.len() < LEAST_SAMPLES) {
            return Err(FreqError::Unsettled);
        }
        // A first sampling frequency from everything that is settled, damage included: settings that disagree do not count in it.
        let first = |start_hz: f64| rates(&self.records, &settings, &settled, start_hz);
        // The time tags tell the sampling frequency well, unless they are coarse.
        let first = match run.vectors.measured_rate_hz {
            Some(measured_hz) => first(measured_hz).or_else(|_| first(nominal_hz))?,
            None => first(nominal_hz)?,
        };
        let rough_hz = first.mean_hz();
        let mut tones = undamaged(&self.records, &settings, &settled, rough_hz);
        let settings = self.seen(&ranges(&tones));
        tones.iter_mut().zip(&settings).for_each(|(tone, setting)| tone.setting = *setting);
        self.check_tones(&tones)?;
        Ok((tones, rough_hz))
    }

    /// Sampling frequencies from what is used of every setting, found from a first one.
    pub fn rates(&self, tones: &[Tone], rough_hz: f64) -> Result<Rates, FreqError> {
        let settings: Vec<Setting> = tones.iter().map(|t| t.setting).collect();
        rates(&self.records, &settings, &ranges(tones), rough_hz)
    }

    /// Time at which the sample counter is 0, s since the run's start: the counter may begin anywhere.
    pub fn begin_s(&self, rate_hz: f64) -> f64 {
        let first = self.records.iter().find_map(|r| Some((*r.n.first()?, *r.t_s.first()?)));
        first.map_or(0.0, |(n, t_s)| t_s - n as f64 / rate_hz)
    }

    /// Settings that mostly hold something else are those of another run.
    fn check_tones(&self, tones: &[Tone]) -> Result<(), FreqError> {
        let disturbed = tones.iter().filter(|t| t.disturbed).count();
        let usable = tones.iter().filter(|t| !t.used.is_empty()).count();
        if disturbed as f64 > MOST_DISTURBED * (disturbed + usable) as f64 {
            return Err(FreqError::Mismatch { disturbed, total: tones.len() });
        }
        match tones.iter().zip(&self.settings).find(|(t, _)| !t.remark.is_empty()) {
            Some((refused, setting)) if usable == 0 => {
                Err(FreqError::NothingUsable { frequency_hz: setting.frequency_hz, why: refused.remark.clone() })
            }
            _ => Ok(()),
        }
    }
}

/// The used samples of every setting.
fn ranges(tones: &[Tone]) -> Vec<Range<usize>> {
    tones.iter().map(|t| t.used.clone()).collect()
}

/// A component that gives one reading all the time tells nothing.
fn check_samples(records: &[&Record]) -> Result<(), FreqError> {
    for (i, component) in COMPONENTS.into_iter().enumerate() {
        let mut readings = records.iter().flat_map(|r| r.y[i].iter().copied());
        let (Some(first), Some(second)) = (readings.next(), readings.next()) else { continue };
        if second == first && readings.all(|y| y == first) {
            return Err(Implausible::Stuck { component, reading_ent: first }.into());
        }
    }
    Ok(())
}
