//! Sampling frequency and frequency response from sines of known frequency (BC-MAG-TR-0085 section 3.6, mathematics section 3).
//!
//! The facility clock is the reference: a sine of frequency f has the phase `2π f n / f_s` at sample counter n. One `f_s` per component
//! follows from the phase progress within all settings together; frequencies above half the sampling frequency are seen as aliases
//! and tell it best. Stretches that no sine of the setting's frequency describes are left out, instead of letting them lower the
//! amplitude.

use crate::data::frequency::{ClockDrift, SineAmplitude};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Settling;
use crate::data::result::RunHead;
use crate::data::run::{Header, Kind, Location, Run, Setting, Vector, VectorSink};
use crate::data::tables::AmplitudeRow;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{self, CommonRate, Oscillator, Packet, RateRefusal, Residue, Sine, SineRefusal, Sums, Verdict};
use crate::fit::statistics::median;
use crate::fit::{Limits, order, polynomial};
use crate::measure::corner::{self, Amplitude, Corner};
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::model::response::Response;
use crate::record::conditions::{self, Temperatures};
use crate::record::known::Known;
use crate::record::known::in_sines::{InSines, Responses};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::ops::Range;
use thiserror::Error;

/// How a frequency analysis is made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Time left out after a change of frequency.
    #[serde(rename = "settling_s")]
    pub settling: Settling,
    /// Effects that are known: taken off the sines before the response is fitted.
    #[serde(skip)]
    pub model: Option<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self { settling: Settling::Found, model: None }
    }
}

/// Samples that are kept at most: seventeen hours at 128 Hz in 256 MB.
const MOST_SAMPLES: usize = 8_000_000;
/// Part of a setting that is left out after a change of frequency where nothing else is said, and its bounds, s.
const SETTLING_PART: f64 = 1.0 / 32.0;
const SETTLING_S: [f64; 2] = [0.1, 1.0];
/// Segments in which damage is looked for, and their least number of samples.
const SEGMENTS: usize = 48;
const LEAST_SAMPLES: usize = 16;
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
/// An amplitude of fewer standard uncertainties does not stand out of the noise.
const DETECTED: f64 = 3.0;
/// Weight in the response fit from which an amplitude counts as used.
const USED: f64 = 0.5;
/// Difference of chi-square below which the next best sampling frequency is as good.
const AMBIGUOUS: f64 = 25.0;
/// Largest relative uncertainty of a sampling frequency that is one: beyond it a setting does not keep its phase.
const KNOWN_RATE: f64 = 1e-3;
/// A run of which more than this part of the settings hold something else belongs to other settings.
const MOST_DISTURBED: f64 = 0.5;
/// A drift of this many standard uncertainties is one.
const DRIFTS: f64 = 4.0;

/// Why a run has no frequency analysis.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FreqError {
    /// Not a frequency run.
    #[error("the run is of kind {0}, not frequency")]
    Kind(Kind),
    /// No sines.
    #[error("no setting is a sine: the frequencies in @FIELDS are all 0")]
    NoSines,
    /// No samples.
    #[error("no samples fall into the settings")]
    NoSamples,
    /// Settling leaves nothing.
    #[error("no setting has {LEAST_SAMPLES} samples after its settling")]
    Unsettled,
    /// A component that gives the same reading always.
    #[error("component {component} is stuck at {reading_ent} enT")]
    Stuck {
        /// Component.
        component: &'static str,
        /// Its reading, enT.
        reading_ent: f64,
    },
    /// More than fits into memory.
    #[error("the settings hold more than {MOST_SAMPLES} samples")]
    TooLong,
    /// Every frequency is refused.
    #[error("no frequency can be used; the first, {frequency_hz} Hz: {why}")]
    NothingUsable {
        /// Frequency, Hz.
        frequency_hz: f64,
        /// Why.
        why: String,
    },
    /// Settings of another run.
    #[error("{disturbed} of {total} settings hold no sine of their frequencies")]
    Mismatch {
        /// Settings that hold something else.
        disturbed: usize,
        /// Settings with a frequency.
        total: usize,
    },
    /// No sampling frequency.
    #[error("component {component} has no sampling frequency: {why}")]
    NoRate {
        /// Component.
        component: &'static str,
        /// Why.
        why: String,
    },
}

impl FreqError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            FreqError::Kind(_) => "use the command for that kind",
            FreqError::NoSines => "check `kind` and the settings of the run",
            FreqError::NoSamples => "check the times of the settings; a table of amplitudes goes with --amplitudes",
            FreqError::Unsettled => "say with --settling how much time to leave out after a change of frequency",
            FreqError::Stuck { .. } => "check the component and its wiring",
            FreqError::TooLong => "split the run",
            FreqError::NothingUsable { .. } => "check the frequencies and times of the settings",
            FreqError::Mismatch { .. } => "check that settings and times are those of this run",
            FreqError::NoRate { .. } => "check the sample rate in the head of the file and the frequencies of the settings",
        }
    }
}

/// The samples of one sine.
#[derive(Clone, Debug, Default)]
struct Record {
    n: Vec<u64>,
    t_s: Vec<f64>,
    y: [Vec<f64>; 3],
}

/// Keeps the samples of settings that are sines.
#[derive(Clone, Debug, Default)]
pub struct Sines {
    settings: Vec<Setting>,
    records: Vec<Record>,
    current: usize,
    kept: usize,
    overflown: bool,
}

impl VectorSink for Sines {
    fn needs_settings(&self) -> bool {
        true
    }

    fn begin(&mut self, _header: &Header, settings: &[Setting]) {
        *self = Self { settings: settings.to_vec(), records: vec![Record::default(); settings.len()], ..Self::default() };
    }

    fn vector(&mut self, vector: Vector) {
        while self.settings.get(self.current).is_some_and(|s| vector.t_s >= s.t_end_s) {
            self.current += 1;
        }
        let Some(setting) = self.settings.get(self.current) else { return };
        if setting.frequency_hz <= 0.0 || vector.t_s < setting.t_start_s {
            return;
        }
        if self.kept == MOST_SAMPLES {
            self.overflown = true;
            return;
        }
        self.kept += 1;
        let record = &mut self.records[self.current];
        record.n.push(vector.n);
        record.t_s.push(vector.t_s);
        record.y.iter_mut().zip(vector.reading.0).for_each(|(y, r)| y.push(r));
    }
}

/// One applied frequency with its used stretch.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stretch {
    /// The setting.
    pub setting: Setting,
    /// Begin and end of the used part, s since the run's start; absent if the frequency was refused.
    pub used_s: Option<[f64; 2]>,
}

/// The sampling frequency against the clock of the facility.
#[derive(Clone, Debug, PartialEq)]
pub struct SamplingRate {
    /// Per component, Hz; nan where a component tells none.
    pub component_hz: [f64; 3],
    /// Its standard uncertainty, Hz.
    pub component_std_hz: [f64; 3],
    /// Weighted mean of the components, Hz.
    pub mean_hz: f64,
    /// Its standard uncertainty, Hz.
    pub mean_std_hz: f64,
    /// Standard deviation of the components about their mean, Hz; absent if fewer than two tell one.
    pub scatter_hz: Option<f64>,
    /// Drift and the next best value.
    pub clock: ClockDrift,
}

/// A frequency analysis with what is needed to judge it.
#[derive(Clone, Debug, PartialEq)]
pub struct Freq {
    /// The run.
    pub run: RunHead,
    /// Sampling frequency; absent for a table of amplitudes.
    pub rate: Option<SamplingRate>,
    /// -3 dB frequency from the two neighbouring amplitudes, Hz; nan where the amplitudes do not fall by 3 dB.
    pub f_3db_igep_hz: [f64; 3],
    /// -3 dB frequency of the model, Hz; nan where no model fits.
    pub f_3db_model_hz: [f64; 3],
    /// Its standard uncertainty with that of the known effects, Hz.
    pub f_3db_model_std_hz: [f64; 3],
    /// The response fit; its rows are the amplitudes in their order.
    pub corner: Corner,
    /// Known effects that were taken off the sines.
    pub effects: Option<ModelApplied>,
    /// One entry per applied frequency, in the order of the run.
    pub amplitude: Vec<SineAmplitude>,
    /// The settings and the parts of them that were used; empty for a table of amplitudes.
    pub stretches: Vec<Stretch>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// What was found of one setting.
struct Tone {
    setting: Setting,
    used: Range<usize>,
    /// It holds something else than its sine.
    disturbed: bool,
    remark: String,
}

/// Sampling frequency, amplitudes and response of one run.
///
/// # Errors
/// [`FreqError`]: the run is refused. Single frequencies are refused in the result.
pub fn freq(run: &Run, sines: &Sines, instructions: &Instructions, options: &Options) -> Result<Freq, FreqError> {
    if run.header.kind != Kind::Frequency {
        return Err(FreqError::Kind(run.header.kind));
    }
    if sines.overflown {
        return Err(FreqError::TooLong);
    }
    let indices: Vec<usize> = (0..sines.settings.len()).filter(|i| sines.settings[*i].frequency_hz > 0.0).collect();
    if indices.is_empty() {
        return Err(FreqError::NoSines);
    }
    if sines.kept == 0 {
        return Err(FreqError::NoSamples);
    }
    let records: Vec<&Record> = indices.iter().map(|i| &sines.records[*i]).collect();
    let applied: Vec<Setting> = indices.iter().map(|i| sines.settings[*i]).collect();
    let mut notes: Vec<Note> = Vec::new();
    let known = options.model.as_ref();
    let known = known.map_or_else(InSines::default, |m| InSines::new(m, run, Responses::OfTheInstrument, &mut notes));
    // A clock that is fast sees low frequencies: with these its known course is taken off.
    let seen = |ranges: &[Range<usize>]| -> Vec<Setting> {
        let middle = |(record, range): (&&Record, &Range<usize>)| ends_s(record, range).map_or(0.0, |[a, b]| 0.5 * (a + b));
        let times = records.iter().zip(ranges).map(middle);
        let hz = |(s, t): (&Setting, f64)| Setting { frequency_hz: s.frequency_hz / (1.0 + known.clock(t)), ..*s };
        applied.iter().zip(times).map(hz).collect()
    };
    check_samples(&records)?;
    let nominal_hz = run.header.sample_rate_hz;

    // A first sampling frequency from everything that is settled, damage included: settings that disagree do not count in it.
    let settled: Vec<Range<usize>> =
        records.iter().zip(&applied).map(|(r, s)| settled(r, s, options.settling, 1.0 / nominal_hz)).collect();
    let settings = seen(&settled);
    if settled.iter().all(|range| range.len() < LEAST_SAMPLES) {
        return Err(FreqError::Unsettled);
    }
    // The time tags tell the sampling frequency well, unless they are coarse.
    let first = match run.vectors.measured_rate_hz {
        Some(measured_hz) => {
            rates(&records, &settings, &settled, measured_hz).or_else(|_| rates(&records, &settings, &settled, nominal_hz))?
        }
        None => rates(&records, &settings, &settled, nominal_hz)?,
    };
    let rough_hz = first.mean_hz();
    let mut tones = undamaged(&records, &settings, settled, rough_hz);
    let ranges: Vec<Range<usize>> = tones.iter().map(|t| t.used.clone()).collect();
    let settings = seen(&ranges);
    tones.iter_mut().zip(&settings).for_each(|(tone, setting)| tone.setting = *setting);
    let disturbed = tones.iter().filter(|t| t.disturbed).count();
    let usable = ranges.iter().filter(|r| !r.is_empty()).count();
    if disturbed as f64 > MOST_DISTURBED * (disturbed + usable) as f64 {
        return Err(FreqError::Mismatch { disturbed, total: settings.len() });
    }
    let refused = tones.iter().zip(&applied).find(|(t, _)| !t.remark.is_empty());
    if let Some((refused, setting)) = refused.filter(|_| ranges.iter().all(Range::is_empty)) {
        return Err(FreqError::NothingUsable { frequency_hz: setting.frequency_hz, why: refused.remark.clone() });
    }
    let found = rates(&records, &settings, &ranges, rough_hz)?;
    let clock = Clock::of(&found);

    let fits: Vec<Result<Option<Fits>, SineRefusal>> =
        tones.par_iter().zip(&records).map(|(tone, record)| Fits::of(tone, record, &clock)).collect();
    let noise = noise(&tones, &records, &fits, &clock);
    let mut measured: Vec<SineAmplitude> =
        (0..tones.len()).map(|j| amplitude(&tones[j], records[j], &fits[j], noise[j])).collect();
    for (part, setting) in measured.iter_mut().zip(&applied) {
        part.frequency_hz = setting.frequency_hz;
        take_off(&known, part);
    }
    notes.extend(clock.notes(&found, &applied));
    notes.extend(refusals_and_damage(&measured));

    let span = |join: fn(f64, f64) -> f64, end: usize| {
        measured.iter().filter_map(|a| a.used_s).map(|s| s[end]).reduce(join).unwrap_or_default()
    };
    let temperatures = Temperatures::of(run, instructions, [span(f64::min, 0), span(f64::max, 1)], &mut notes);
    conditions::warn_of_run(&mut notes, run);
    let stretches = measured.iter().zip(&applied).map(|(a, s)| Stretch { setting: *s, used_s: a.used_s }).collect();
    let corner = respond(&mut measured, &mut notes);
    let f_3db_model_std_hz = widen(&known, &mut measured, &corner);
    // The sampling frequency holds where the run tells it best; the counter may begin anywhere.
    let first = records.iter().find_map(|r| Some((*r.n.first()?, *r.t_s.first()?)));
    let begin_s = first.map_or(0.0, |(n, t_s)| t_s - n as f64 / clock.mean_hz);
    let effects = options.model.as_ref().map(|model| ModelApplied {
        file: model.input.path.clone(),
        effect: known.applied(),
        left_out: known.left_out.clone(),
    });
    Ok(Freq {
        run: conditions::head(run, instructions, &temperatures),
        rate: Some(clock.rate(1.0 + known.clock(clock.centre_s + begin_s), known.moves_clock())),
        f_3db_igep_hz: corner.igep_hz(),
        f_3db_model_hz: corner.model_hz(),
        f_3db_model_std_hz,
        corner,
        effects,
        amplitude: measured,
        stretches,
        temperatures,
        notes,
    })
}

/// Frequencies that were refused, then those of which a part was left out.
fn refusals_and_damage(measured: &[SineAmplitude]) -> Vec<Note> {
    let about = |a: &SineAmplitude| format!("{} Hz", a.frequency_hz);
    let refused = measured
        .iter()
        .filter(|a| a.used_s.is_none())
        .map(|a| Note::new(NoteKind::Data, format!("{} Hz was refused: {}", a.frequency_hz, a.remark)).about(about(a)));
    let damaged = measured
        .iter()
        .filter(|a| a.used_s.is_some() && !a.remark.is_empty())
        .map(|a| Note::new(NoteKind::Data, format!("{} Hz: {}", a.frequency_hz, a.remark)).about(about(a)));
    refused.chain(damaged).collect()
}

/// The response alone, from a table of amplitudes; `id` names it.
#[must_use]
pub fn from_table(rows: &[AmplitudeRow], id: &str) -> Freq {
    let mut measured: Vec<SineAmplitude> = rows
        .iter()
        .map(|row| SineAmplitude {
            frequency_hz: row.frequency_hz,
            b_ent: row.amplitude_ent,
            b_std_ent: row.std_ent,
            phase_deg: None,
            phase_std_deg: None,
            phase_counter: None,
            used: true,
            weight: [1.0; 3],
            // Without an uncertainty a positive amplitude is taken for one.
            detected: std::array::from_fn(|i| {
                row.amplitude_ent[i] > if row.std_ent[i].is_finite() { DETECTED * row.std_ent[i] } else { 0.0 }
            }),
            alias_hz: None,
            used_s: None,
            samples: None,
            remark: String::new(),
        })
        .collect();
    let head = RunHead {
        id: id.to_owned(),
        sensor: String::new(),
        mode: String::new(),
        location: Location::Centre,
        temperature_degc: None,
        coil_temperature_degc: None,
        campaign: "a table of amplitudes, without a campaign".to_owned(),
        start: String::new(),
        configuration: String::new(),
        field_source: String::new(),
        coil_correction: None,
        earthfield_compensation: Vec::new(),
    };
    let text = "the table tells neither sensor, mode nor temperature, and no sampling frequency";
    let mut notes = vec![Note::new(NoteKind::Method, text)];
    let corner = respond(&mut measured, &mut notes);
    Freq {
        run: head,
        rate: None,
        f_3db_igep_hz: corner.igep_hz(),
        f_3db_model_hz: corner.model_hz(),
        f_3db_model_std_hz: corner.model_std_hz(),
        corner,
        effects: None,
        amplitude: measured,
        stretches: Vec::new(),
        temperatures: Temperatures::default(),
        notes,
    }
}

/// The settled samples of a setting, without the one at its end, which may belong to the next by rounding of the times.
fn settled(record: &Record, setting: &Setting, settling: Settling, sample_s: f64) -> Range<usize> {
    let settling_s = match settling {
        Settling::Given(s) => s,
        Settling::Found => (SETTLING_PART * (setting.t_end_s - setting.t_start_s)).clamp(SETTLING_S[0], SETTLING_S[1]),
    };
    let end = record.t_s.partition_point(|t| *t < setting.t_end_s - sample_s);
    let begin = record.t_s.partition_point(|t| *t < setting.t_start_s + settling_s);
    begin.min(end)..end
}

/// The sampling frequency of every component, or why it has none.
struct Rates {
    found: [Option<CommonRate>; 3],
    refused: Vec<String>,
}

impl Rates {
    /// Weighted mean of the components, Hz.
    fn mean_hz(&self) -> f64 {
        let weighted = |get: fn(&CommonRate) -> f64| self.found.iter().flatten().map(|r| get(r) / r.std_hz.powi(2)).sum::<f64>();
        weighted(|r| r.rate_hz) / weighted(|_| 1.0)
    }
}

/// The sampling frequency of every component; an error if none has one. A component that sees nothing of the field tells none.
fn rates(records: &[&Record], settings: &[Setting], ranges: &[Range<usize>], start_hz: f64) -> Result<Rates, FreqError> {
    let results: Vec<Result<CommonRate, RateRefusal>> = (0..3)
        .into_par_iter()
        .map(|component| {
            let packets: Vec<Packet> = records
                .iter()
                .zip(settings)
                .zip(ranges)
                .map(|((record, setting), range)| Packet {
                    n: &record.n[range.clone()],
                    y: &record.y[component][range.clone()],
                    frequency_hz: setting.frequency_hz,
                })
                .collect();
            sine::common_rate(&packets, start_hz)
        })
        .collect();
    // A rate beyond this is that of noise.
    let is_known = |rate: &CommonRate| rate.std_hz.is_finite() && rate.std_hz > 0.0 && rate.std_hz < KNOWN_RATE * rate.rate_hz;
    let mut rates = Rates { found: [None, None, None], refused: Vec::new() };
    let mut first = None;
    for (component, result) in results.into_iter().enumerate() {
        let why = match result {
            Ok(rate) if is_known(&rate) => {
                rates.found[component] = Some(rate);
                continue;
            }
            Ok(rate) => format!("it is {:.4} Hz with an uncertainty of {:.4} Hz", rate.rate_hz, rate.std_hz),
            Err(refusal) => refusal.to_string(),
        };
        rates.refused.push(format!("component {} tells no sampling frequency: {why}", COMPONENTS[component]));
        first.get_or_insert(FreqError::NoRate { component: COMPONENTS[component], why });
    }
    match first {
        Some(error) if rates.found.iter().all(Option::is_none) => Err(error),
        _ => Ok(rates),
    }
}

/// A component that gives one reading all the time tells nothing.
fn check_samples(records: &[&Record]) -> Result<(), FreqError> {
    for (i, component) in COMPONENTS.into_iter().enumerate() {
        let mut readings = records.iter().flat_map(|r| r.y[i].iter().copied());
        let (Some(first), Some(second)) = (readings.next(), readings.next()) else { continue };
        if second == first && readings.all(|y| y == first) {
            return Err(FreqError::Stuck { component, reading_ent: first });
        }
    }
    Ok(())
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
fn undamaged(records: &[&Record], settings: &[Setting], settled: Vec<Range<usize>>, rate_hz: f64) -> Vec<Tone> {
    let cuts: Vec<Cut> =
        (0..records.len()).into_par_iter().map(|j| Cut::of(records[j], &settings[j], &settled[j], rate_hz)).collect();
    // Settings that hold other frequencies have large residuals everywhere; a quarter of good ones is enough to know the noise.
    let floor: [f64; 3] = std::array::from_fn(|i| {
        let mut all: Vec<f64> = cuts.iter().filter_map(|cut| cut.noise(i)).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 4).copied().unwrap_or(0.0)
    });
    let ends: [[f64; 2]; 3] = std::array::from_fn(|i| {
        let readings = || records.iter().flat_map(|r| r.y[i].iter().copied());
        [readings().fold(f64::INFINITY, f64::min), readings().fold(f64::NEG_INFINITY, f64::max)]
    });
    (0..records.len())
        .into_par_iter()
        .map(|j| {
            let (record, setting, cut) = (records[j], settings[j], &cuts[j]);
            let range = settled[j].clone();
            let refused = |remark: String| Tone { setting, used: 0..0, disturbed: false, remark };
            let seen_s = record.t_s.get(range.start).zip(record.t_s.last());
            let cycles = seen_s.map_or(0.0, |(first, last)| (last - first) * setting.frequency_hz);
            if cycles < LEAST_CYCLES {
                return refused(format!("its settled samples span {cycles:.2} cycles, at least {LEAST_CYCLES} is needed"));
            }
            if let Err(refusal) =
                sine::three(&record.n[range.clone()], &record.y[0][range.clone()], setting.frequency_hz, rate_hz)
            {
                return refused(refusal.to_string());
            }
            let count = cut.edges.len() - 1;
            let mut kept = 0..count;
            for (i, name) in COMPONENTS.into_iter().enumerate() {
                if rests_at_end(&record.y[i][range.clone()], ends[i]) {
                    return refused(format!("component {name} rests at the end of its range"));
                }
                let limit_std = floor[i].max(DISTORTION * cut.amplitude(i));
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive number")]
                let least = ((count as f64 * LEAST_PART).ceil() as usize).max(1);
                match sine::coherent(&cut.sums[i], limit_std, TOLERANCE, least) {
                    Some(run) => kept = kept.start.max(run.start)..kept.end.min(run.end),
                    None => {
                        let remark =
                            format!("no stretch of component {name} follows a sine of this frequency; the setting is disturbed, or another one");
                        return Tone { disturbed: true, ..refused(remark) };
                    }
                }
            }
            if (kept.len() as f64) < LEAST_PART * count as f64 {
                return refused("the components have no undamaged stretch in common".to_owned());
            }
            let used = whole_periods(record, cut.edges[kept.start]..cut.edges[kept.end], setting.frequency_hz);
            let remark = if kept.len() < count {
                format!("{:.0} % of the setting is damaged and was left out", 100.0 * (1.0 - kept.len() as f64 / count as f64))
            } else {
                String::new()
            };
            match sine::three(&record.n[used.clone()], &record.y[0][used.clone()], setting.frequency_hz, rate_hz) {
                Ok(_) => Tone { setting, used, disturbed: false, remark },
                Err(refusal) => refused(format!("of its undamaged part, {refusal}")),
            }
        })
        .collect()
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

/// The clock of the instrument.
struct Clock {
    rate_hz: [f64; 3],
    std_hz: [f64; 3],
    mean_hz: f64,
    mean_std_hz: f64,
    scatter_hz: f64,
    /// The three components disagree by more than their uncertainties.
    disagree: bool,
    /// Drift of all components together, Hz/s, if there is one, and the time at which the mean holds, s after counter 0.
    drift_hz_per_s: Option<f64>,
    centre_s: f64,
    /// Factor by which the uncertainty of each component was widened.
    inflation: [f64; 3],
    part: ClockDrift,
}

impl Clock {
    fn of(rates: &Rates) -> Self {
        let found = &rates.found;
        let drift = |get: fn(&sine::Drift) -> f64| -> [f64; 3] {
            std::array::from_fn(|i| found[i].as_ref().and_then(|f| f.drift.as_ref()).map_or(f64::NAN, get))
        };
        let (drift_hz_per_s, drift_std) = (drift(|d| d.hz_per_s), drift(|d| d.std_hz_per_s));
        let drift_weights = drift_std.map(|s| if s.is_finite() && s > 0.0 { s.powi(-2) } else { 0.0 });
        let drift_total: f64 = drift_weights.iter().sum();
        let common =
            (0..3).filter(|i| drift_weights[*i] > 0.0).map(|i| drift_weights[i] * drift_hz_per_s[i]).sum::<f64>() / drift_total;
        let drift_is_significant = drift_total > 0.0 && common.abs() * drift_total.sqrt() > DRIFTS;
        // The rates hold for the time around which the information of the packets is balanced.
        let informed = found.iter().flatten().flat_map(|f| &f.packets).filter(|p| p.verdict == Verdict::Used && p.std_hz > 0.0);
        let (sum, weight) = informed.fold((0.0, 0.0), |(sum, weight), p| {
            let w = p.std_hz.powi(-2);
            (sum + w * p.time_s, weight + w)
        });
        let centre_s = if weight > 0.0 { sum / weight } else { 0.0 };
        let at_centre: [Option<(f64, f64, f64)>; 3] =
            found.each_ref().map(|f| f.as_ref().filter(|_| drift_is_significant).and_then(|f| line_at(f, centre_s)));
        let of = |i: usize| {
            let plain = found[i].as_ref().map_or((f64::NAN, f64::NAN, 1.0), |f| (f.rate_hz, f.std_hz, f.inflation));
            at_centre[i].unwrap_or(plain)
        };
        let rate_hz: [f64; 3] = std::array::from_fn(|i| of(i).0);
        let std_hz: [f64; 3] = std::array::from_fn(|i| of(i).1);
        let inflation: [f64; 3] = std::array::from_fn(|i| of(i).2);
        let known: Vec<usize> = (0..3).filter(|i| rate_hz[*i].is_finite()).collect();
        let sum = |get: &dyn Fn(usize) -> f64| known.iter().map(|i| get(*i)).sum::<f64>();
        let total = sum(&|i| std_hz[i].powi(-2));
        let mean_hz = sum(&|i| rate_hz[i] * std_hz[i].powi(-2)) / total;
        let chi_square = sum(&|i| ((rate_hz[i] - mean_hz) / std_hz[i]).powi(2));
        let widened = order::excess(chi_square, known.len().saturating_sub(1));
        let plain = sum(&|i| rate_hz[i]) / known.len() as f64;
        let scatter_hz = (sum(&|i| (rate_hz[i] - plain).powi(2)) / (known.len() as f64 - 1.0)).sqrt();
        let rival = found
            .iter()
            .flatten()
            .filter_map(|f| f.runner_up.as_ref())
            .min_by(|a, b| a.chi_square_excess.total_cmp(&b.chi_square_excess));
        Self {
            rate_hz,
            std_hz,
            mean_hz,
            mean_std_hz: widened / total.sqrt(),
            scatter_hz,
            disagree: widened > 1.0,
            drift_hz_per_s: drift_is_significant.then_some(common),
            centre_s,
            inflation,
            part: ClockDrift {
                reference_s: drift_is_significant.then_some(centre_s),
                drift_hz_per_s,
                drift_std_hz_per_s: drift_std,
                drift_is_significant,
                rival_hz: rival.map(|r| r.rate_hz),
                rival_chi_square: rival.map(|r| r.chi_square_excess),
            },
        }
    }

    /// The rate during a stretch, Hz.
    fn at(&self, t_s: f64) -> f64 {
        self.mean_hz + self.drift_hz_per_s.map_or(0.0, |d| d * (t_s - self.centre_s))
    }

    /// The sampling frequency without a known drift, by which it is `moved` at its time; `known_drift` gives it a time even if it has
    /// no drift of its own.
    fn rate(&self, moved: f64, known_drift: bool) -> SamplingRate {
        SamplingRate {
            component_hz: self.rate_hz.map(|f| f * moved),
            component_std_hz: self.std_hz,
            mean_hz: self.mean_hz * moved,
            mean_std_hz: self.mean_std_hz,
            scatter_hz: Some(self.scatter_hz).filter(|s| s.is_finite()),
            clock: ClockDrift {
                reference_s: self.part.reference_s.or(known_drift.then_some(self.centre_s)),
                ..self.part.clone()
            },
        }
    }

    fn notes(&self, rates: &Rates, settings: &[Setting]) -> Vec<Note> {
        let note = |text: String| Note::new(NoteKind::Method, text);
        let mut notes: Vec<Note> = rates.refused.iter().cloned().map(note).collect();
        for ((component, rate), inflation) in COMPONENTS.into_iter().zip(&rates.found).zip(self.inflation) {
            let Some(rate) = rate else { continue };
            let note = |text: String| note(text).about(component);
            if let Some(rival) = rate.runner_up.as_ref().filter(|r| r.chi_square_excess < AMBIGUOUS) {
                notes.push(note(format!(
                    "the sampling frequency of {component} is ambiguous: {:.5} Hz describes the data almost as well (chi-square {:.1} more)",
                    rival.rate_hz, rival.chi_square_excess
                )));
            }
            let apart: Vec<String> = rate
                .packets
                .iter()
                .zip(settings)
                .filter(|(p, _)| matches!(p.verdict, Verdict::Disagrees { .. }))
                .map(|(_, s)| format!("{} Hz", s.frequency_hz))
                .collect();
            if !apart.is_empty() {
                notes.push(note(format!(
                    "the sampling frequency of {component} rests on the other frequencies than {}",
                    apart.join(", ")
                )));
            }
            if inflation > 1.0 {
                notes.push(note(format!(
                    "the sampling frequencies that the settings give for {component} scatter by {inflation:.1} times what their noise lets \
                     expect; its uncertainty was widened by it"
                )));
            }
        }
        if self.disagree {
            notes.push(note(
                "the components disagree on the sampling frequency by more than their uncertainties; that of the mean was widened"
                    .to_owned(),
            ));
        }
        if let Some(drift) = self.drift_hz_per_s {
            notes.push(note(format!(
                "the sampling frequency drifts by {drift:+.2e} Hz/s; the value given holds {:.3} s after sample counter 0, and amplitudes take the \
                 drift into account",
                self.centre_s
            )));
        }
        notes
    }
}

/// The rate at a time, its standard uncertainty and the factor by which that was widened, from a straight line through the rates of
/// the packets; `None` where they do not determine one.
fn line_at(rate: &CommonRate, time_s: f64) -> Option<(f64, f64, f64)> {
    let used: Vec<_> = rate.packets.iter().filter(|p| p.verdict == Verdict::Used && p.std_hz > 0.0).collect();
    let x: Vec<f64> = used.iter().map(|p| p.time_s - time_s).collect();
    let y: Vec<f64> = used.iter().map(|p| p.rate_hz - rate.rate_hz).collect();
    let weights: Vec<f64> = used.iter().map(|p| p.std_hz.powi(-2)).collect();
    let line = polynomial::fit(&x, &y, Some(&weights), 1, &Limits::default()).ok()?;
    let chi_square: f64 = line.residuals.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
    let inflation = order::excess(chi_square, line.dof);
    Some((rate.rate_hz + line.coefficients[0], inflation * line.unscaled_covariance[(0, 0)].sqrt(), inflation))
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
        let Some([first, last]) = ends_s(record, &used) else { return Ok(None) };
        let rate_hz = clock.at(0.5 * (first + last));
        let three = |i: usize| {
            let readings = &record.y[i][used.clone()];
            sine::three(&record.n[used.clone()], readings, tone.setting.frequency_hz, rate_hz)
        };
        Ok(Some(Self { rate_hz, components: [three(0)?, three(1)?, three(2)?] }))
    }
}

/// Times of the first and the last sample of a stretch, s.
fn ends_s(record: &Record, used: &Range<usize>) -> Option<[f64; 2]> {
    let stretch = record.t_s.get(used.clone())?;
    Some([*stretch.first()?, *stretch.last()?])
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

/// Amplitude and phase of one setting.
fn amplitude(
    tone: &Tone,
    record: &Record,
    fits: &Result<Option<Fits>, SineRefusal>,
    noise: [Option<[f64; 2]>; 3],
) -> SineAmplitude {
    let frequency_hz = tone.setting.frequency_hz;
    let mut part = SineAmplitude {
        frequency_hz,
        b_ent: [f64::NAN; 3],
        b_std_ent: [f64::NAN; 3],
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
        let std = of_amplitude * fit.amplitude_std;
        part.b_ent[i] = fit.amplitude;
        part.b_std_ent[i] = std;
        part.detected[i] = fit.amplitude > DETECTED * std;
        if part.detected[i] {
            let phase = (fit.phase_rad + turned) / TAU;
            phase_deg[i] = within_a_turn_deg(phase);
            phase_std_deg[i] = of_phase * fit.phase_std_rad.to_degrees();
        }
    }
    let cycles = frequency_hz / fits.rate_hz;
    part.alias_hz = Some((cycles - cycles.round()).abs() * fits.rate_hz);
    part.phase_counter = Some(middle);
    part.phase_deg = Some(phase_deg);
    part.phase_std_deg = Some(phase_std_deg);
    part.used_s = ends_s(record, &tone.used);
    part.samples = Some(n.len() as u64);
    part.used = true;
    part
}

/// Cycles as an angle from -180 to 180 degrees.
fn within_a_turn_deg(cycles: f64) -> f64 {
    360.0 * (cycles - cycles.round())
}

/// Takes known effects off an amplitude and its phase; the noise of the amplitude goes with it.
fn take_off(known: &InSines, part: &mut SineAmplitude) {
    if known.is_empty() {
        return;
    }
    for i in 0..3 {
        let factor = known.factor(part.frequency_hz, i);
        part.b_ent[i] /= factor.norm();
        part.b_std_ent[i] /= factor.norm();
        if let Some(phase) = &mut part.phase_deg {
            phase[i] = within_a_turn_deg((phase[i] - factor.arg().to_degrees()) / 360.0);
        }
    }
}

/// Carries the uncertainty of known effects into amplitudes, phases and -3 dB frequencies. All amplitudes share it, so that it is no noise
/// and has no part in the fit of the response. Returns the standard uncertainties of the -3 dB frequencies.
fn widen(known: &InSines, measured: &mut [SineAmplitude], corner: &Corner) -> [f64; 3] {
    for part in measured {
        for i in 0..3 {
            let [std, phase_std_rad] = known.factor_std(part.frequency_hz, i);
            part.b_std_ent[i] = part.b_std_ent[i].hypot(std * part.b_ent[i]);
            if let Some(std) = &mut part.phase_std_deg {
                std[i] = std[i].hypot(phase_std_rad.to_degrees());
            }
        }
    }
    let mut model_std_hz = corner.model_std_hz();
    let Some(response) = corner.model.and_then(Response::named) else { return model_std_hz };
    for i in 0..3 {
        let Some(model) = &corner.components[i].model else { continue };
        let shape: Vec<f64> = model.parameters.iter().map(|p| p.value).collect();
        let corner_hz = model.f_3db_model_hz;
        let [std, _] = known.factor_std(corner_hz, i);
        if std > 0.0 {
            let moved_hz = corner_hz * std / response.steepness(corner_hz, &shape);
            model_std_hz[i] = model_std_hz[i].hypot(moved_hz);
        }
    }
    model_std_hz
}

fn add_remark(part: &mut SineAmplitude, remark: String) {
    part.remark = if part.remark.is_empty() { remark } else { format!("{}; {remark}", part.remark) };
}

/// Fits the response to the amplitudes.
fn respond(measured: &mut [SineAmplitude], notes: &mut Vec<Note>) -> Corner {
    let table: Vec<Amplitude> = measured
        .iter()
        .map(|a| Amplitude {
            frequency_hz: a.frequency_hz,
            // What is not detected is no amplitude, and a fit of noise would find a corner in it.
            amplitude_ent: std::array::from_fn(|i| if a.detected[i] { a.b_ent[i] } else { f64::NAN }),
            std_ent: a.b_std_ent,
            usable: a.used && a.detected.contains(&true),
        })
        .collect();
    let corner = corner::corner(&table, &corner::Options::default());
    for (row, part) in measured.iter_mut().enumerate() {
        part.used &= part.detected.contains(&true);
        part.weight = std::array::from_fn(|i| {
            let fitted = corner.components[i].model.as_ref().and_then(|m| m.weight.get(row)).copied();
            fitted.unwrap_or(f64::from(u8::from(part.used)))
        });
        let outlying: Vec<&str> =
            (0..3).filter(|i| part.used && part.detected[*i] && part.weight[*i] < USED).map(|i| COMPONENTS[i]).collect();
        if !outlying.is_empty() {
            add_remark(part, format!("{} does not follow the response and has little weight in it", outlying.join(", ")));
        }
        part.used = part.used && (0..3).all(|i| !part.detected[i] || part.weight[i] >= USED);
        let silent: Vec<&str> =
            (0..3).filter(|i| part.b_ent[*i].is_finite() && !part.detected[*i]).map(|i| COMPONENTS[i]).collect();
        if !silent.is_empty() {
            add_remark(part, format!("not detected in {}", silent.join(", ")));
        }
    }
    for (name, component) in COMPONENTS.into_iter().zip(&corner.components) {
        let reasons = [(&component.igep_refusal, "by interpolation"), (&component.model_refusal, "by a model")];
        for (refusal, how) in reasons {
            if let Some(refusal) = refusal {
                let text = format!("{name} has no -3 dB frequency {how}: {refusal}");
                notes.push(Note::new(NoteKind::Method, text).about(name));
            }
        }
    }
    corner
}
