//! Settings as fields of a facility that is known: every setting at the temperatures of coils and rack in its own time, with the values of
//! the period that it lies in (CH-GFZ-TR-2601 section 6: the facility is corrected with the temperatures during the run;
//! docs/mathematics.md, "The coil system").

use super::temperature_faults;
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::result::AT_REST_K;
use crate::data::run::{Run, mean_over};
use crate::fit::statistics::{extremes, median};
use crate::model::campaign::Instructions;
use crate::model::coil::{Coil, OFFSET_NT_PER_K, SCALE_APART_PER_K, SCALE_PER_K};
use crate::model::facility::{Facility, FacilityApplied, FacilityError, Period};
use crate::model::sensor::SplitError;
use nalgebra::{Matrix3, Vector3};

/// A reading this many usual intervals away from a setting is near it: one that fails does not make a gap.
const NEAR_INTERVALS: f64 = 3.0;
/// Digits of the hash of a facility file that tell it from others of the same name.
const HASH_DIGITS: usize = 12;

/// What a facility did to the settings of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Driven {
    /// For the parameter file.
    pub part: FacilityApplied,
    /// What one standard deviation along each principal direction of the covariance that the file states does to the fields; none where it
    /// states none. They are common to all runs that use the file.
    pub moved: Vec<Moved>,
}

/// What one standard deviation of something that a facility file does not know better does to the fields of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// What it is, in the same words for every run: the file with the begin of its hash, the period and the principal direction.
    pub source: String,
    /// Changes of the fields of all plateaus, nT, coil axes.
    pub nt: Vec<[f64; 3]>,
}

/// Turns the settings of plateaus into fields of the facility.
///
/// # Errors
/// Angles that no three axes have between them, or settings at times for which the file holds no values.
pub fn apply(
    facility: &Facility,
    run: &Run,
    instructions: &Instructions,
    list: &mut [Plateau],
    notes: &mut impl Extend<Note>,
) -> Result<Driven, FacilityError> {
    if run.header.coil_correction == Some(true) {
        notes.extend([Note::new(
            NoteKind::Facility,
            "the run says that its settings are corrected already; --facility corrects them once more",
        )]);
    }
    notes.extend(facility.notes.iter().cloned());
    let periods = periods(facility, run, list, notes)?;
    let spans_s: Vec<[f64; 2]> = list.iter().map(span_s).collect();
    let channels = instructions.coil_channels(&run.header);
    let mut courses: Vec<(&String, Option<Vec<f64>>)> = Vec::new();
    if facility.follows_coil() {
        for channel in &channels {
            if courses.iter().all(|(known, _)| *known != channel) {
                courses.push((channel, degc(facility, run, channel, "coil", &spans_s, notes)));
            }
        }
    }
    let of = |channel: &String| courses.iter().find(|(known, _)| *known == channel).and_then(|(_, degc)| degc.as_deref());
    let coil_degc = channels.each_ref().map(of);
    let rack = instructions.rack_channel();
    let rack_degc = if facility.follows_rack() { degc(facility, run, rack, "rack", &spans_s, notes) } else { None };

    let coils: Vec<(Coil, Matrix3<f64>)> = facility.periods.iter().map(coil_of).collect::<Result<_, _>>()?;
    let field = |(coil, axes): &(Coil, Matrix3<f64>), i: usize, setting: [f64; 3]| {
        let at_coil = coil_degc.map(|degc| degc.map_or(coil.reference_degc, |degc| degc[i]));
        let at_rack = rack_degc.as_ref().map_or(coil.rack_reference_degc, |degc| degc[i]);
        coil.field(axes, setting, at_coil, at_rack)
    };
    let settings: Vec<[f64; 3]> = list.iter().map(|p| p.setting.field.0).collect();
    for (i, (plateau, period)) in list.iter_mut().zip(&periods).enumerate() {
        plateau.setting.field = field(&coils[*period], i, settings[i]);
    }
    let mut all_moved = Vec::new();
    let file: String = facility.input.sha256.chars().take(HASH_DIGITS).collect();
    for (place, period) in facility.periods.iter().enumerate().filter(|(place, _)| periods.contains(place)) {
        for (direction, part) in period.moved().into_iter().enumerate() {
            let moved = coil_of(&Period { part, ..period.clone() })?;
            let change = |i: usize| {
                if periods[i] != place {
                    return [0.0; 3];
                }
                let (before, after) = (list[i].setting.field.0, field(&moved, i, settings[i]).0);
                std::array::from_fn(|axis| after[axis] - before[axis])
            };
            let source = format!("{} {file}, period {}, direction {}", facility.input.path, place + 1, direction + 1);
            all_moved.push(Moved { source, nt: (0..list.len()).map(change).collect() });
        }
    }
    if let Some(range_degc) = facility.valid_coil_degc.filter(|_| !facility.follows_coil()) {
        let courses = channels.each_ref().map(|channel| degc_of(run, channel, &spans_s).map(|course| course.degc));
        let fields: Vec<[f64; 3]> = list.iter().map(|p| p.setting.field.0).collect();
        let name = format!("{} {file}, coil temperature", facility.input.path);
        all_moved.extend(by_unknown_coefficients(&name, &fields, &courses, range_degc));
    }
    let used: Vec<f64> = coil_degc.iter().flatten().flat_map(|degc| degc.iter().copied()).collect();
    // Where nothing follows a temperature it was not needed so far, but where the values hold is stated all the same.
    let beside = |channels: &[&str]| -> Option<[f64; 2]> {
        let mean = |channel: &&str| degc_of(run, channel, &spans_s).map(|course| course.degc).unwrap_or_default();
        range(&channels.iter().flat_map(mean).collect::<Vec<f64>>())
    };
    let coil_channels: Vec<&str> = channels.iter().map(String::as_str).collect();
    for (what, valid, follows, degc, channels) in [
        ("coil", facility.valid_coil_degc, facility.follows_coil(), range(&used), coil_channels),
        ("rack", facility.valid_rack_degc, facility.follows_rack(), rack_degc.as_deref().and_then(range), vec![rack]),
    ] {
        let at = if follows { degc } else { beside(&channels) };
        let Some(([low, high], [from, to])) = valid.zip(at) else { continue };
        if from < low - AT_REST_K || to > high + AT_REST_K {
            let outside = match (follows, what) {
                (true, _) => "outside, its temperature coefficients are extrapolated".to_owned(),
                (false, "coil") => format!(
                    "it has no coefficients of the coil temperature; taken as zero with the size of those of CH-GFZ-TR-2601 section 6 as their \
                     uncertainty ({SCALE_PER_K:.1e} per kelvin of the scale factors, {OFFSET_NT_PER_K:.1} nT/K of the offset fields), they are in the \
                     uncertainties of type B"
                ),
                (false, _) => {
                    format!("it has no coefficients of the {what} temperature, and what that changes is in no uncertainty")
                }
            };
            let text = format!(
                "{} was measured at {what} temperatures from {low:.1} to {high:.1} °C and is used from {from:.1} to {to:.1} °C: {outside}",
                facility.input.path
            );
            let note = Note::new(NoteKind::Facility, text).about(facility.input.path.as_str());
            let remedy = "calibrate the coil system at this temperature, or at several for its coefficients";
            notes.extend([if follows { note } else { note.with_remedy(remedy) }]);
        }
    }
    let first = &facility.periods[periods.first().copied().unwrap_or_default()];
    let part = FacilityApplied {
        file: facility.input.path.clone(),
        coil_degc: mean(&used),
        coil_range_degc: range(&used),
        rack_degc: rack_degc.as_deref().and_then(mean),
        rack_range_degc: rack_degc.as_deref().and_then(range),
        period: (!first.span.is_always()).then(|| first.span.clone()),
        applied: first.part.clone(),
    };
    Ok(Driven { part, moved: all_moved })
}

impl Driven {
    /// The changes of the fields of some of the plateaus of a list, nT, in their order.
    #[must_use]
    pub fn moved_of(&self, list: &[Plateau], some: &[&Plateau]) -> Vec<Vec<[f64; 3]>> {
        let places: Vec<usize> =
            list.iter().enumerate().filter(|(_, p)| some.iter().any(|s| std::ptr::eq(*s, *p))).map(|(place, _)| place).collect();
        self.moved.iter().map(|moved| places.iter().map(|place| moved.nt[*place]).collect()).collect()
    }

    /// The changes of the mean readings by one standard deviation of the facility, enT: the readings stay and the fields move, which is as
    /// if the readings of the same fields moved by `response` times the change.
    #[must_use]
    pub fn changes_ent(&self, response: &Matrix3<f64>) -> Vec<Vec<[f64; 3]>> {
        let change = |moved_nt: &[f64; 3]| (response * Vector3::from(*moved_nt)).into();
        self.moved.iter().map(|moved| moved.nt.iter().map(change).collect()).collect()
    }
}

/// What coefficients of the coil temperature that a file does not have may do to the fields, by one standard deviation of each: the coils were at other
/// temperatures than when they were calibrated, `range_degc`. Nothing where they were not.
fn by_unknown_coefficients(
    name: &str,
    fields_nt: &[[f64; 3]],
    courses: &[Option<Vec<f64>>; 3],
    [low, high]: [f64; 2],
) -> Vec<Moved> {
    let beyond_k = |axis: usize, i: usize| courses[axis].as_ref().map_or(0.0, |degc| degc[i] - degc[i].clamp(low, high));
    if (0..3).all(|axis| (0..fields_nt.len()).all(|i| beyond_k(axis, i) == 0.0)) {
        return Vec::new();
    }
    let moved = |what: &str, change: &dyn Fn(usize, usize) -> f64| Moved {
        source: format!("{name}, {what}"),
        nt: (0..fields_nt.len()).map(|i| std::array::from_fn(|axis| change(axis, i))).collect(),
    };
    let scale = |axis: usize, i: usize| fields_nt[i][axis] * beyond_k(axis, i);
    let mut all = vec![moved("all scale factors", &|axis, i| SCALE_PER_K * scale(axis, i))];
    for (k, axis) in ["X", "Y", "Z"].into_iter().enumerate() {
        let own = |axis: usize, value: f64| if axis == k { value } else { 0.0 };
        all.push(moved(&format!("scale factor {axis}"), &|axis, i| own(axis, SCALE_APART_PER_K * scale(axis, i))));
        all.push(moved(&format!("offset field {axis}"), &|axis, i| own(axis, OFFSET_NT_PER_K * beyond_k(axis, i))));
    }
    all
}

fn coil_of(period: &Period) -> Result<(Coil, Matrix3<f64>), SplitError> {
    let coil = period.part.coil();
    let axes = coil.axes().ok_or(SplitError::Planar)?;
    Ok((coil, axes))
}

/// The time of a plateau that was used, or that of its setting, s since the run's start.
fn span_s(plateau: &Plateau) -> [f64; 2] {
    let [begin, end] = plateau.used_s;
    if end > begin { plateau.used_s } else { [plateau.setting.t_start_s, plateau.setting.t_end_s] }
}

/// The period of every plateau. The field has one value in the middle of a setting: a setting belongs to the period of its middle, also in
/// a run that goes on across a boundary, for which a note says so.
fn periods(facility: &Facility, run: &Run, list: &[Plateau], notes: &mut impl Extend<Note>) -> Result<Vec<usize>, FacilityError> {
    let start_s = run.header.start.seconds();
    let at = |plateau: &Plateau| {
        let [begin, end] = span_s(plateau);
        facility.period_at(start_s + 0.5 * (begin + end))
    };
    let Some(periods) = list.iter().map(at).collect::<Option<Vec<usize>>>() else {
        let [first, last] = extremes(list.iter().flat_map(span_s));
        return Err(FacilityError::Outside {
            file: facility.input.path.clone(),
            periods: facility.periods_in_words(),
            run: format!("from {} to {}", run.header.start.after(first), run.header.start.after(last)),
        });
    };
    let used = |period: usize| periods.iter().filter(|p| **p == period).count();
    let parts: Vec<String> = (0..facility.periods.len())
        .filter(|period| used(*period) > 0)
        .map(|period| format!("{} settings with the values that hold {}", used(period), facility.periods[period].span))
        .collect();
    if parts.len() > 1 {
        let text = format!(
            "the run goes on across a boundary of {}: {}; where the step really lies between two calibrations is not known",
            facility.input.path,
            parts.join(", ")
        );
        notes.extend([Note::new(NoteKind::Facility, text)
            .about(facility.input.path.as_str())
            .with_remedy("a run that lies in one period is better")]);
    }
    Ok(periods)
}

/// The temperature of a channel in the time of every setting, °C: the mean of the readings in it, else straight between those beside it;
/// `None` and a note without any reading.
fn degc(
    facility: &Facility,
    run: &Run,
    channel: &str,
    what: &str,
    spans_s: &[[f64; 2]],
    notes: &mut impl Extend<Note>,
) -> Option<Vec<f64>> {
    let file = &facility.input.path;
    let Some(Course { degc, without, farthest_s }) = degc_of(run, channel, spans_s) else {
        let coil = facility.periods[0].part.coil();
        let reference_degc = if what == "rack" { coil.rack_reference_degc } else { coil.reference_degc };
        let text = format!(
            "{file} depends on the {what} temperature, which the run does not tell (channel {channel}): its values for \
             {reference_degc:.1} °C were used"
        );
        notes.extend([Note::new(NoteKind::Temperature, text).about(channel)]);
        return None;
    };
    if without > 0 {
        let text = format!(
            "{without} of {} settings have no reading of the {what} temperature (channel {channel}) near them, up to {farthest_s:.0} s \
             away: {file} was used with the temperature straight between the readings beside them, or with the nearest one",
            spans_s.len()
        );
        notes.extend([Note::new(NoteKind::Temperature, text).about(channel)]);
    }
    Some(degc)
}

/// The temperature of a channel in the time of every setting.
struct Course {
    /// One for each setting, °C.
    degc: Vec<f64>,
    /// Settings without a reading near them.
    without: usize,
    /// How far the nearest reading is from one of these at most, s.
    farthest_s: f64,
}

/// The temperature of a channel in the time of every setting, without notes; `None` without any reading.
fn degc_of(run: &Run, channel: &str, spans_s: &[[f64; 2]]) -> Option<Course> {
    let (begin, end) = (spans_s.first().map_or(0.0, |s| s[0]), spans_s.last().map_or(0.0, |s| s[1]));
    let series = temperature_faults::readings(run, channel, [begin, end]).filter(|series| !series.is_empty())?;
    let mut intervals_s: Vec<f64> = series.windows(2).map(|w| w[1].0 - w[0].0).collect();
    let near_s = if intervals_s.is_empty() { 0.0 } else { NEAR_INTERVALS * median(&mut intervals_s) };
    let mut without = 0;
    let mut farthest_s: f64 = 0.0;
    let mut one = |[begin, end]: &[f64; 2]| {
        let from = series.partition_point(|(t, _)| t < begin);
        let before_s = from.checked_sub(1).map_or(f64::INFINITY, |i| begin - series[i].0);
        // Zero or less with a reading inside.
        let after_s = series.get(from).map_or(f64::INFINITY, |(t, _)| t - end);
        let away_s = before_s.min(after_s);
        if away_s > near_s {
            without += 1;
            farthest_s = farthest_s.max(away_s);
        }
        mean_over(&series, [*begin, *end])
    };
    let degc = spans_s.iter().map(&mut one).collect();
    Some(Course { degc, without, farthest_s })
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn range(values: &[f64]) -> Option<[f64; 2]> {
    (!values.is_empty()).then(|| extremes(values.iter().copied()))
}
