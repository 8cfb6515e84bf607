//! What the results of all runs say about the run itself: its head, its temperatures, the plateaus left out, and notes.

use super::temperature_faults;
use crate::data::error::Severity;
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Drop, Plateau, Plateaus};
use crate::data::result::{AT_REST_K, Conditions, Dropped, RunHead, Spread};
use crate::data::run::{Run, interpolate};
use crate::data::units::{COMPONENTS, counted};
use crate::fit::noise::dense::{self, GroupNoise, Octave, Sampled};
use crate::fit::statistics::{extremes, median};
use crate::fit::{DenseNoise, FitError, Solution};
use crate::model::campaign::Instructions;
use crate::model::lag::Lag;
use nalgebra::DMatrix;
use serde::Serialize;

/// A temperature without readings for this part of a run is told whatever it does, and for this one while it moves, where that is many times the usual
/// distance of two readings.
const LONG_GAP: f64 = 0.5;
const SHORT_GAP: f64 = 0.03;
const MANY_INTERVALS: f64 = 10.0;
/// Difference of two mean temperatures of one thermometer in a run that its readings tell, K.
const LEAST_DIFFERENCE_K: f64 = 0.005;

/// Parts of plateaus whose lengths differ by less than this share are compared together.
const SAME_LENGTH: f64 = 1e-3;

/// A stated standard deviation of so many times the usual one is that of a disturbed block: not even three samples reach it by chance.
const FAR_SCATTER: f64 = 10.0;

type Series = Vec<(f64, f64)>;

/// Temperatures during a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Temperatures {
    /// Sensor temperature without jumps of its channel, (s since the run's start, °C).
    pub sensor: Series,
    /// Coil-system temperature, likewise, (s since the run's start, °C).
    pub coil: Series,
    /// Channels with smallest, mean and largest value while the fields were applied; absent if there is no temperature at all.
    pub conditions: Option<Conditions>,
}

impl Temperatures {
    /// Temperatures of a run over the time in which fields were applied.
    #[must_use]
    pub fn of(run: &Run, instructions: &Instructions, span_s: [f64; 2], notes: &mut impl Extend<Note>) -> Self {
        let (sensor_channel, coil_channel) = instructions.channels(&run.header);
        let (sensor, sensor_degc) = temperature(run, &sensor_channel, "sensor", span_s, notes);
        let (coil, coil_degc) = temperature(run, &coil_channel, "coil system", span_s, notes);
        let any = sensor_degc.is_some() || coil_degc.is_some();
        let conditions = any.then_some(Conditions {
            sensor_channel,
            sensor_degc,
            sensor_range_k: None,
            sensor_rate_k_per_h: None,
            coil_channel,
            coil_degc,
        });
        Self { sensor, coil, conditions }
    }

    /// Takes the temperature of the part of the sensor that goes after the thermistor with a lag in place of that of the thermistor, over the time in
    /// which fields were applied. Returns whether it is known in all of that time, but for the distance of two readings at its ends.
    pub fn follow(&mut self, lag: Lag, file: &str, span_s: [f64; 2], notes: &mut impl Extend<Note>) -> bool {
        let Some(conditions) = self.conditions.as_mut().filter(|c| c.sensor_degc.is_some()) else { return true };
        self.sensor = lag.in_run(&self.sensor);
        let inside = self.sensor.iter().filter(|(t_s, _)| (span_s[0]..=span_s[1]).contains(t_s));
        conditions.sensor_degc = around_mean(mean_in_time(&self.sensor, span_s), inside.map(|(_, degc)| *degc));
        let channel = &conditions.sensor_channel;
        let text = format!(
            "the sensor temperature is that of the part that goes after channel {channel} with a {} of {:.0} s, as {file} has it",
            lag.form(),
            lag.seconds()
        );
        notes.extend([Note::new(NoteKind::Temperature, text).about(channel)]);
        let [first_s, last_s] = extremes(self.sensor.iter().map(|(t_s, _)| *t_s));
        let usual_s = (last_s - first_s) / (self.sensor.len().max(2) - 1) as f64;
        first_s <= span_s[0] + usual_s && last_s >= span_s[1] - usual_s
    }

    /// States by how much and how fast the sensor temperature moved.
    pub fn state_movement(&mut self, range_k: f64, rate_k_per_h: f64) {
        if let Some(conditions) = &mut self.conditions {
            conditions.sensor_range_k = Some(range_k);
            conditions.sensor_rate_k_per_h = Some(rate_k_per_h);
        }
    }

    /// Smallest, mean and largest sensor temperature, °C.
    #[must_use]
    pub fn sensor_degc(&self) -> Option<[f64; 3]> {
        self.conditions.as_ref()?.sensor_degc
    }

    /// By how much the sensor temperature moves, K, if it is not at rest.
    #[must_use]
    pub fn moved_k(&self) -> Option<f64> {
        self.sensor_degc().map(|[low, _, high]| high - low).filter(|range_k| *range_k > AT_REST_K)
    }

    /// The temperatures at which the values of the components hold, °C, where one of them is another than the mean of the run as far as thermometers
    /// tell.
    #[must_use]
    pub fn beside_the_mean(&self, degc: [f64; 3]) -> Option<[f64; 3]> {
        let [_, mean_degc, _] = self.sensor_degc()?;
        degc.iter().any(|t| (t - mean_degc).abs() > LEAST_DIFFERENCE_K).then_some(degc)
    }

    /// Smallest and largest sensor temperature, °C.
    #[must_use]
    pub fn sensor_range_degc(&self) -> Option<[f64; 2]> {
        self.sensor_degc().map(|[low, _, high]| [low, high])
    }
}

/// The head of a parameter file.
#[must_use]
pub fn head(run: &Run, instructions: &Instructions, temperatures: &Temperatures) -> RunHead {
    let header = &run.header;
    let mean = |degc: Option<[f64; 3]>| degc.map(|[_, mean, _]| mean);
    RunHead {
        id: header.run.clone(),
        sensor: header.sensor.clone(),
        mode: header.mode.clone(),
        location: instructions.location(&header.run),
        temperature_degc: mean(temperatures.sensor_degc()),
        coil_temperature_degc: mean(temperatures.conditions.as_ref().and_then(|c| c.coil_degc)),
        campaign: instructions.description.clone(),
        start: Some(header.start.clone()),
        configuration: header.configuration.clone(),
        field_source: header.field_source.clone(),
        coil_correction: header.coil_correction,
        earthfield_compensation: header.earthfield_compensation.clone(),
    }
}

/// Smallest, mean and largest standard deviation of the samples within a plateau, enT; `None` if the file brings means only.
#[must_use]
pub fn raw_std(used: &[&Plateau]) -> Option<Spread> {
    let all: Vec<[f64; 3]> = used.iter().map(|p| p.std_ent).collect::<Option<_>>()?;
    let fold = |start: f64, join: fn(f64, f64) -> f64| std::array::from_fn(|a| all.iter().map(|s| s[a]).fold(start, join));
    Some(Spread {
        min: fold(f64::INFINITY, f64::min),
        mean: std::array::from_fn(|a| all.iter().map(|s| s[a]).sum::<f64>() / all.len() as f64),
        max: fold(f64::NEG_INFINITY, f64::max),
    })
}

/// What the readings do within a plateau beside their noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Within {
    /// They stay.
    Still,
    /// They may change steadily, as with a temperature that moves. Such a change makes all contrasts of a plateau alike and is no noise:
    /// contrasts are taken about their mean then, and the scatter of the samples about a straight line.
    Drift,
}

/// The noise of the plateau means of a fit, one row per plateau: from what happens within the plateaus and from the residuals, from stated standard
/// deviations and numbers of samples where the file brings means, or from the residuals alone where it brings nothing else.
///
/// # Errors
/// Those of [`dense::estimate`].
pub fn noise(solution: &Solution, used: &[&Plateau], within: Within) -> Result<DenseNoise, FitError> {
    noise_of(solution, used, &[0, 1, 2], within, None)
}

/// The same of a run of a group whose runs show their noise together.
///
/// # Errors
/// Those of [`dense::estimate`].
pub fn noise_in_group(
    solution: &Solution,
    used: &[&Plateau],
    within: Within,
    group: Option<&GroupNoise>,
) -> Result<DenseNoise, FitError> {
    noise_of(solution, used, &[0, 1, 2], within, group)
}

/// The same for right-hand sides that are some components of the reading, 0 to 2.
///
/// # Errors
/// Those of [`dense::estimate`].
pub fn noise_of(
    solution: &Solution,
    used: &[&Plateau],
    components: &[usize],
    within: Within,
    group: Option<&GroupNoise>,
) -> Result<DenseNoise, FitError> {
    let mut octaves: Vec<Octave> = Vec::new();
    // One of the contrasts tells the steady change.
    let taken = if within == Within::Drift { 1.0 } else { 0.0 };
    for contrasts in used.iter().flat_map(|p| &p.contrasts).filter(|c| c.count as f64 > taken) {
        let same = |o: &&mut Octave| (o.length / contrasts.part_s - 1.0).abs() < SAME_LENGTH;
        let octave = match octaves.iter_mut().find(same) {
            Some(octave) => octave,
            None => {
                octaves.push(Octave { length: contrasts.part_s, count: 0.0, white: 0.0, squares: vec![0.0; components.len()] });
                let last = octaves.len() - 1;
                &mut octaves[last]
            }
        };
        let (all, count) = (contrasts.count as f64, contrasts.count as f64 - taken);
        octave.count += count;
        octave.white += count * contrasts.inverse_samples;
        for (sum, component) in octave.squares.iter_mut().zip(components) {
            *sum += all * (contrasts.mean_square[*component] - taken * contrasts.mean[*component].powi(2)).max(0.0);
        }
    }
    let readings = DMatrix::from_fn(used.len(), components.len(), |i, a| used[i].mean.0[components[a]]);
    octaves.extend(octaves.is_empty().then(|| stated_scatter(used, components)).flatten());
    if octaves.is_empty() {
        let times: Vec<f64> = used.iter().map(|p| p.t_s()).collect();
        return dense::estimate(solution, &times, Some(&readings));
    }
    for octave in &mut octaves {
        octave.white /= octave.count;
    }
    let samples: Vec<f64> = used.iter().map(|p| p.count.map_or(f64::NAN, |n| n as f64)).collect();
    let intervals: Vec<[f64; 2]> = used.iter().map(|p| p.used_s).collect();
    let variances = DMatrix::from_fn(used.len(), components.len(), |i, a| match within {
        Within::Drift => scatter_about_a_line(used[i], components[a]),
        Within::Still => used[i].std_ent.map_or(f64::NAN, |s| s[components[a]].powi(2)),
    });
    let scatter = Some([&variances, &readings]);
    dense::estimate_with(solution, &Sampled { intervals: &intervals, counts: &samples, octaves: &octaves, scatter, group })
}

/// What standard deviations and numbers of samples say that a file brings with its means: neighbouring samples differ by noise that is white between
/// them. Of slow noise they say nothing, which is left to the means.
fn stated_scatter(used: &[&Plateau], components: &[usize]) -> Option<Octave> {
    let mut scatter = Octave { length: f64::INFINITY, count: 0.0, white: 0.0, squares: vec![0.0; components.len()] };
    for p in used {
        let (std_ent, count) = (p.std_ent?, p.count.filter(|n| *n > 1)? as f64);
        scatter.length = scatter.length.min((p.used_s[1] - p.used_s[0]) / count);
        scatter.count += count - 1.0;
        scatter.white += count - 1.0;
        for (sum, component) in scatter.squares.iter_mut().zip(components) {
            *sum += (count - 1.0) * std_ent[*component].powi(2);
        }
    }
    (scatter.count > 0.0).then_some(scatter)
}

/// Variance of the samples of a plateau about a straight line, enT²: a line that rises by r from begin to end has the variance r²/12. The
/// longest parts tell it best.
fn scatter_about_a_line(plateau: &Plateau, component: usize) -> f64 {
    let rise = plateau
        .contrasts
        .last()
        .map_or(0.0, |longest| longest.mean[component] / longest.part_s * (plateau.used_s[1] - plateau.used_s[0]));
    plateau.std_ent.map_or(f64::NAN, |s| (s[component].powi(2) - rise * rise / 12.0).max(0.0))
}

/// Probability from which noise steeper than 1/f is told.
const STEEP: f64 = 0.5;

/// For which noise the uncertainty of an offset holds: the residuals of what lasts so long show no slower one.
#[must_use]
pub fn noise_in_std(seconds: f64, lasting: &str) -> String {
    format!(
        "noise that changes within the {seconds:.0} s of {lasting}; what changes more slowly shows in no residual of one run: compare the \
         offsets of several runs"
    )
}

/// Says that there is noise slower than the run, where the run shows signs of it: no uncertainty of an offset can hold what it does.
pub fn warn_of_slow_noise(notes: &mut impl Extend<Note>, noise: &DenseNoise, span_s: [f64; 2]) {
    let steep: Vec<&str> =
        (0..3).filter(|a| noise.steep_probability(*a).is_some_and(|p| p > STEEP)).map(|a| COMPONENTS[a]).collect();
    if !steep.is_empty() {
        let text = format!(
            "the noise of {} grows towards low frequencies faster than 1/f: what changes more slowly than in the {:.0} s of the run shows in \
             no residual, and the uncertainty of the offset is without it",
            steep.join(", "),
            span_s[1] - span_s[0]
        );
        notes.extend([Note::new(NoteKind::Method, text).with_remedy("compare the offsets of several runs")]);
    }
}

/// The plateaus that were not used, with their reasons.
#[must_use]
pub fn dropped(list: &[Plateau]) -> Vec<Dropped> {
    list.iter()
        .filter_map(|p| {
            let reason = p.dropped.as_ref()?.to_string();
            Some(Dropped { block: p.index + 1, t_start_s: p.setting.t_start_s, field_coil_nt: p.setting.field.0, reason })
        })
        .collect()
}

/// A temperature channel and its smallest, mean and largest value while the fields were applied.
fn temperature(
    run: &Run,
    channel: &str,
    what: &str,
    span_s: [f64; 2],
    notes: &mut impl Extend<Note>,
) -> (Series, Option<[f64; 3]>) {
    let Some(series) = temperature_faults::readings(run, channel, span_s) else {
        notes
            .extend([Note::new(NoteKind::Temperature, format!("no {what} temperature: the run has no channel {channel}"))
                .about(channel)]);
        return (Vec::new(), None);
    };
    let count = run.slow_channel(channel).map_or(0, |all| all.len());
    if series.len() < count {
        let text = temperature_faults::left_out_text(count - series.len(), channel);
        notes.extend([Note::new(NoteKind::Temperature, text).about(channel)]);
    }
    let inside: Series = series.iter().copied().filter(|(t, _)| (span_s[0]..=span_s[1]).contains(t)).collect();
    let values: Vec<f64> = inside.iter().map(|(_, v)| *v).collect();
    if values.is_empty() {
        notes.extend([Note::new(
            NoteKind::Temperature,
            format!("no {what} temperature: channel {channel} holds no reading from the time of the settings"),
        )
        .about(channel)]);
        return (series, None);
    }
    if let [(t_s, _)] = inside.as_slice() {
        notes.extend([Note::new(
            NoteKind::Temperature,
            format!("the {what} temperature (channel {channel}) is a single reading at {t_s} s"),
        )
        .about(channel)]);
    } else {
        let times = [vec![span_s[0]], inside.iter().map(|(t, _)| *t).collect(), vec![span_s[1]]].concat();
        let gaps = || times.windows(2).map(|w| w[1] - w[0]);
        let length = span_s[1] - span_s[0];
        let read_s = [f64::min, f64::max].map(|end| series.iter().map(|(t, _)| *t).reduce(end).unwrap_or(f64::NAN));
        let at_ends = (read_s[0] - span_s[0]).max(0.0) + (span_s[1] - read_s[1]).max(0.0);
        if let (true, [first, last]) = (at_ends > 0.1 * length, read_s) {
            notes.extend([Note::new(
                NoteKind::Temperature,
                format!("the {what} temperature (channel {channel}) covers the time from {first} to {last} s only"),
            )
            .about(channel)]);
        } else if let Some(longest) = gaps().reduce(f64::max).filter(|longest| *longest > LONG_GAP * length) {
            notes.extend([Note::new(
                NoteKind::Temperature,
                format!("the {what} temperature (channel {channel}) has no reading for {longest:.0} s of the run"),
            )
            .about(channel)]);
        } else if let Some((gap_s, by_k)) = gap_while_moving(&inside).filter(|(gap_s, _)| *gap_s > SHORT_GAP * length) {
            let text = format!(
                "the {what} temperature (channel {channel}) has no reading for {gap_s:.0} s in which it moved by {by_k:.1} K: it is taken straight between the \
                 readings beside, and what it really did there is in no uncertainty"
            );
            notes.extend([Note::new(NoteKind::Temperature, text).about(channel)]);
        }
    }
    let range = around_mean(mean_in_time(&series, span_s), values.into_iter());
    (series, range)
}

/// The longest stretch without readings in which a temperature moves by more than at rest, s, and by how much, K; many times the usual distance of two.
fn gap_while_moving(series: &[(f64, f64)]) -> Option<(f64, f64)> {
    let steps = || series.windows(2).map(|w| (w[1].0 - w[0].0, (w[1].1 - w[0].1).abs()));
    let mut lengths_s: Vec<f64> = steps().map(|(s, _)| s).collect();
    let least_s = MANY_INTERVALS * if lengths_s.is_empty() { f64::INFINITY } else { median(&mut lengths_s) };
    steps().filter(|(s, k)| *s > least_s && *k > AT_REST_K).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Smallest, mean and largest temperature; `None` without any. Few readings need not lie on both sides of a mean that is taken straight to the ends of
/// the time.
fn around_mean(mean: f64, inside: impl Iterator<Item = f64>) -> Option<[f64; 3]> {
    let [low, high] = extremes(inside);
    (low <= high).then(|| [low.min(mean), mean, high.max(mean)])
}

/// Mean of a channel over the part of a time that its readings cover, straight between them: a thermometer that is logged more often while it moves
/// says no more of that time.
fn mean_in_time(series: &[(f64, f64)], [begin_s, end_s]: [f64; 2]) -> f64 {
    let ([first, ..], [.., last]) = (series, series) else { return f64::NAN };
    let span_s = [begin_s.max(first.0), end_s.min(last.0)];
    let [begin, end] = span_s.map(|t_s| (t_s, interpolate(series, t_s)));
    let inside = series.iter().copied().filter(|(t_s, _)| (span_s[0]..=span_s[1]).contains(t_s));
    let points: Vec<(f64, f64)> = std::iter::once(begin).chain(inside).chain([end]).collect();
    let area: f64 = points.windows(2).map(|w| 0.5 * (w[0].1 + w[1].1) * (w[1].0 - w[0].0)).sum();
    if end.0 > begin.0 { area / (end.0 - begin.0) } else { begin.1 }
}

/// Whether the data step at other times than the settings, by more than a 64th of the shortest plateau.
pub fn displaced(plateaus: &Plateaus) -> Option<Note> {
    let shift_s = plateaus.edge_shift_s;
    let is_large = plateaus.list.iter().any(|p| shift_s.abs() > (p.setting.t_end_s - p.setting.t_start_s) / 64.0);
    let text = format!("the data step {shift_s:+.2} s after the settings do; the disturbed ends of the plateaus were left out");
    (shift_s.abs() > 0.0 && is_large).then(|| Note::new(NoteKind::Mismatch, text))
}

/// What the plateaus show about timing, spikes and stuck components.
pub fn warn_of_plateaus(notes: &mut impl Extend<Note>, run: &Run, plateaus: &Plateaus) {
    for (name, count) in COMPONENTS.into_iter().zip(plateaus.without_scatter) {
        if count > 0 {
            notes.extend([
                Note::new(NoteKind::Stuck, format!("component {name} has no scatter at all in {count} plateaus")).about(name)
            ]);
        }
    }
    if !run.blocks.is_empty() {
        notes.extend(scattered_blocks(&plateaus.list));
    }
    notes.extend(displaced(plateaus));
    if plateaus.settling_found_s > plateaus.settling_s + 1e-9 && run.blocks.is_empty() {
        notes.extend([Note::new(
            NoteKind::Data,
            format!(
                "the data show the step before for {:.2} s, longer than the {:.2} s that were left out",
                plateaus.settling_found_s, plateaus.settling_s
            ),
        )]);
    }
    if let Some([part, std]) = plateaus.still_follows {
        let text = format!(
            "the readings still follow the step before a setting: from the first half of what is used of a setting to the second they lose {part:.1e} \
             ± {std:.0e} of it; what is left then is in the means and in no uncertainty"
        );
        notes.extend([Note::new(NoteKind::Data, text).with_remedy("hold the fields longer, or leave out more with --settling")]);
    }
    let incomplete = |p: &&Plateau| matches!(p.dropped, Some(Drop::NoSamples | Drop::Coverage { .. }));
    let lacking = plateaus.list.iter().filter(incomplete).count();
    if lacking > 0 {
        let text = format!("{lacking} of {} settings have too few samples and were left out", plateaus.list.len());
        notes.extend([Note::new(NoteKind::Losses, text)]);
    }
    let spikes: u64 = plateaus.list.iter().map(|p| p.spike_samples).sum();
    if spikes > 0 {
        notes.extend([Note::new(NoteKind::Spikes, format!("{spikes} samples in stretches with spikes were left out"))]);
    }
}

/// Blocks whose stated standard deviation is far above that of the others.
fn scattered_blocks(list: &[Plateau]) -> impl Iterator<Item = Note> {
    let used: Vec<&Plateau> = list.iter().filter(|p| p.dropped.is_none()).collect();
    (0..3).filter_map(move |a| {
        let of = |p: &&Plateau| p.std_ent.map_or(f64::NAN, |s| s[a]);
        let usual_ent = median(&mut used.iter().map(of).filter(|s| s.is_finite()).collect::<Vec<f64>>());
        let far: Vec<&&Plateau> = used.iter().filter(|p| usual_ent > 0.0 && of(p) > FAR_SCATTER * usual_ent).collect();
        let most_ent = far.iter().map(|p| of(p)).fold(0.0, f64::max);
        let numbers: Vec<String> = far.iter().map(|p| (p.index + 1).to_string()).collect();
        let text = format!(
            "the samples of {} scatter in {} by up to {most_ent:.3} enT as the file states, those of the others by {usual_ent:.3} enT",
            if far.len() == 1 { format!("block {}", numbers[0]) } else { format!("blocks {}", numbers.join(", ")) },
            COMPONENTS[a]
        );
        (!far.is_empty()).then(|| Note::new(NoteKind::Data, text).about(COMPONENTS[a]).with_remedy("look at them, or leave them out with --exclude"))
    })
}

/// What was left out of a run by hand.
pub fn excluded(run: &Run) -> impl Iterator<Item = Note> {
    run.exclusions.iter().map(|exclusion| match exclusion.misses(run) {
        Some(text) => Note::new(NoteKind::LeftOut, text).with_remedy("correct it, or take it out"),
        None => Note::new(NoteKind::LeftOut, format!("{} was left out by hand: {}", exclusion.what(), exclusion.reason)),
    })
}

/// Lost samples, in words.
#[must_use]
pub fn lost(samples: u64, gaps: u64) -> String {
    let are = if samples == 1 { "is" } else { "are" };
    format!("{} {are} missing in {}", counted(samples, "sample"), counted(gaps, "gap"))
}

/// What was left out by hand, lost samples, faults of temperature channels, and what the reader found.
pub fn warn_of_run(notes: &mut impl Extend<Note>, run: &Run, instructions: &Instructions) {
    notes.extend(excluded(run));
    notes.extend(temperature_faults::notes(run, instructions));
    if run.vectors.lost > 0 {
        notes.extend([Note::new(NoteKind::Losses, lost(run.vectors.lost, run.vectors.gap_count))]);
    }
    for finding in run.findings.iter().filter(|f| f.severity > Severity::Note) {
        let place = finding.line.map_or_else(String::new, |line| format!("line {line}: "));
        notes.extend([Note::new(NoteKind::Data, format!("{place}{}", finding.rule)).with_remedy(finding.remedy.as_ref())]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::plateau::Contrasts;
    use crate::data::run::Setting;
    use crate::data::units::{FieldCoil, Reading};
    use crate::fit::random::Random;
    use crate::fit::{Design, Limits, solve};

    const PLATEAUS: usize = 40;
    const SAMPLES: usize = 64;
    /// Readings are far above their noise, and alternate.
    const FIELD_ENT: f64 = 1000.0;

    fn sign(index: usize) -> f64 {
        if index.is_multiple_of(2) { 1.0 } else { -1.0 }
    }

    /// White noise of unit variance on readings that rise within every plateau by so much, and are back at its middle.
    fn plateaus(rise_ent: f64) -> Vec<Plateau> {
        plateaus_of(11, rise_ent)
    }

    fn plateaus_of(seed: u64, rise_ent: f64) -> Vec<Plateau> {
        let mut random = Random::seeded(seed);
        let one = |index: usize| {
            let sample = |i: usize, noise: f64| noise + rise_ent * ((i as f64 + 0.5) / SAMPLES as f64 - 0.5);
            let samples: Vec<f64> = (0..SAMPLES).map(|i| sample(i, random.gaussian())).collect();
            let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
            let middle = mean(&samples);
            let contrasts = [4, 8, 16, 32].map(|length| {
                let pairs: Vec<f64> = samples.chunks(2 * length).map(|p| mean(&p[length..]) - mean(&p[..length])).collect();
                Contrasts {
                    part_s: length as f64,
                    count: pairs.len() as u64,
                    inverse_samples: 2.0 / length as f64,
                    mean_square: [pairs.iter().map(|d| d * d).sum::<f64>() / pairs.len() as f64; 3],
                    mean: [mean(&pairs); 3],
                }
            });
            let used_s = [(SAMPLES * index) as f64, (SAMPLES * (index + 1)) as f64];
            let [t_start_s, t_end_s] = used_s;
            let variance = samples.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / (SAMPLES - 1) as f64;
            Plateau {
                index,
                setting: Setting { t_start_s, t_end_s, field: FieldCoil([0.0; 3]), frequency_hz: 0.0, position: 1 },
                used_s,
                mean: Reading([middle + FIELD_ENT * sign(index); 3]),
                std_ent: Some([variance.sqrt(); 3]),
                count: Some(SAMPLES as u64),
                spike_samples: 0,
                dropped: None,
                contrasts: contrasts.to_vec(),
            }
        };
        (0..PLATEAUS).map(one).collect()
    }

    fn noise_of_mean(list: &[Plateau], within: Within) -> DenseNoise {
        let used: Vec<&Plateau> = list.iter().collect();
        let columns = DMatrix::from_fn(list.len(), 2, |i, j| if j == 0 { 1.0 } else { sign(i) });
        let design = Design::new(vec!["mean".to_owned(), "field".to_owned()], columns).unwrap();
        let rhs = DMatrix::from_fn(list.len(), 3, |i, a| list[i].mean.0[a]);
        noise(&solve(&design, &rhs, None, &Limits::default()).unwrap(), &used, within).unwrap()
    }

    /// The mean of 40 means of 64 samples of unit variance is uncertain by 1/√2560. Its noise is known to 12 % from 40 rows and better with what
    /// is inside them; three times that is allowed, and a tenth for the chance of slow noise that no record excludes.
    #[test]
    fn a_steady_change_within_the_plateaus_is_no_noise() {
        let expected = ((PLATEAUS * SAMPLES) as f64).sqrt().recip();
        let std =
            |rise_ent: f64, within: Within| noise_of_mean(&plateaus(rise_ent), within).covariance()[(0, 0)].sqrt() / expected;
        for rise_ent in [0.0, 0.5, 2.0, 10.0] {
            let found = std(rise_ent, Within::Drift);
            assert!((0.64..1.5).contains(&found), "{rise_ent} enT: {found}");
        }
        // Taken for noise, it is many times the real one.
        let taken = std(2.0, Within::Still);
        assert!(taken > 2.0, "{taken}");
    }

    /// Four means of 64 samples leave two degrees of freedom, which tell the noise within a factor of ten; what the file states of the samples tells
    /// it to 4 %. Two thirds more are allowed for the chance of scatter between the means.
    #[test]
    fn stated_scatter_and_numbers_of_samples_tell_the_noise_of_few_means() {
        let expected = ((4 * SAMPLES) as f64).sqrt().recip();
        let (mut stated, mut alone) = (Vec::new(), Vec::new());
        for seed in 0..40 {
            let mut list = plateaus_of(seed, 0.0);
            list.truncate(4);
            list.iter_mut().for_each(|p| p.contrasts.clear());
            let std = |list: &[Plateau]| noise_of_mean(list, Within::Still).covariance()[(3, 3)].sqrt() / expected;
            stated.push(std(&list));
            list.iter_mut().for_each(|p| p.std_ent = None);
            alone.push(std(&list));
        }
        let least = |all: &[f64]| all.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(least(&stated) > 0.85 && median(&mut stated) < 1.67, "{stated:?}");
        assert!(least(&alone) < 0.3, "{alone:?}");
    }

    #[test]
    fn a_block_that_scatters_far_more_than_the_others_is_told() {
        let mut list = plateaus(0.0);
        assert_eq!(scattered_blocks(&list).count(), 0);
        list[6].std_ent = list[6].std_ent.map(|[x, y, z]| [x, 100.0 * y, z]);
        let told: Vec<String> = scattered_blocks(&list).map(|note| note.to_string()).collect();
        assert!(told.len() == 1 && told[0].contains("block 7 scatter in y"), "{told:?}");
    }

    #[test]
    fn the_scatter_of_samples_is_that_about_a_line() {
        for rise_ent in [0.0, 10.0] {
            let list = plateaus(rise_ent);
            let mean = list.iter().map(|p| scatter_about_a_line(p, 0)).sum::<f64>() / PLATEAUS as f64;
            // A line takes one more of 64 degrees of freedom; 2560 samples tell a variance to 2.8 %. What the halves tell of the line errs by
            // 2√(2/32), which times the rise is without a mean, and its square a 32nd of the variance times a third.
            let allowed = 3.0 * (0.028 + rise_ent * 0.5 / 6.0 / (PLATEAUS as f64).sqrt());
            assert!((mean - 1.0).abs() < allowed, "{rise_ent}: {mean}");
        }
    }
}
