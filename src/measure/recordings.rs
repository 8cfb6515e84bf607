//! The runs of a campaign against each other as recordings, before any analysis: readings that stand in two of them, which would count twice, and times at
//! which one sensor would have been in two runs at once.

use crate::data::note::{Note, NoteKind};
use crate::data::run::{Kind, Run};
use crate::data::sketch::{LEAST, Sketch};
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

/// A run of which more than this part stands in another one is a copy of that: two exports of one recording differ at their ends. What two runs have in
/// common that were cut of one record, a few minutes around the cut, is less.
const MOST: f64 = 0.5;
/// Runs that overlap by less, s, may follow each other: starts are whole seconds, and clocks of files and of facilities differ.
const OVERLAP_S: f64 = 10.0;
/// Runs that a note names.
const MOST_NAMED: usize = 8;

/// What is compared of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Run id.
    pub id: String,
    sensor: String,
    mode: String,
    kind: Kind,
    /// First and last reading, s since 1970; absent for a run without readings.
    times_s: Option<[f64; 2]>,
    readings: Sketch,
    temperatures: Sketch,
}

impl Recording {
    /// Of a run whose readings were looked at while it was read, or that holds means.
    #[must_use]
    pub fn of(run: &Run) -> Self {
        let header = &run.header;
        let readings = if run.vectors.sketch.count() > 0 {
            run.vectors.sketch.clone()
        } else {
            let moduli = run.scalar.iter().map(|row| std::slice::from_ref(&row.modulus_nt));
            Sketch::of_means(run.blocks.iter().map(|block| block.mean.0.as_slice()).chain(moduli))
        };
        let table = &run.temperatures;
        let rows: Vec<Vec<f64>> = (0..table.t_s.len())
            .map(|row| table.values.iter().filter_map(|channel| channel.get(row).copied()).collect())
            .collect();
        // Settings may go on where a run was broken off, so that they tell less than readings.
        let blocks = run.blocks.iter().map(|block| [block.setting.t_start_s, block.setting.t_end_s]);
        let rows_of_table = blocks.chain(run.scalar.iter().map(|row| [row.t_s; 2]));
        let together = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        let times_s = run.vectors.span_s.or_else(|| rows_of_table.reduce(together));
        Self {
            id: header.run.clone(),
            sensor: header.sensor.clone(),
            mode: header.mode.clone(),
            kind: header.kind,
            times_s: times_s.map(|times| times.map(|t| header.start.seconds() + t)),
            readings,
            temperatures: Sketch::of_means(rows.iter().map(Vec::as_slice)),
        }
    }

    /// Which part of its readings stands in another one, where they are of one recording: readings and temperatures go together.
    fn part_in(&self, other: &Self) -> Option<f64> {
        let part = self.readings.shared_with(&other.readings);
        (part > MOST && self.temperatures.goes_with(&other.temperatures)).then_some(part)
    }
}

/// A run of whose readings most stand in another one, one after the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Copied {
    /// The one that holds fewer of them; the later one of equals.
    pub copy: usize,
    /// The other one, which is no copy itself.
    pub of: usize,
    /// Part of the readings that stand in it.
    pub part: f64,
}

/// The runs that are copies of others, by their places in the list. Only marks that two sketches share lead to a comparison, so that it takes no time where
/// nothing is shared, however many runs there are.
#[must_use]
pub fn copies(all: &[Recording]) -> Vec<Copied> {
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by_key(|index| Reverse(all[*index].readings.count()));
    let mut with_mark: HashMap<u64, Vec<usize>> = HashMap::new();
    let mut found = Vec::new();
    for index in order {
        let own = &all[index];
        let mut common: BTreeMap<usize, usize> = BTreeMap::new();
        for other in own.readings.marks().iter().filter_map(|mark| with_mark.get(mark)).flatten() {
            *common.entry(*other).or_default() += 1;
        }
        let mut near = common.into_iter().filter(|(_, marks)| *marks >= LEAST);
        match near.find_map(|(of, _)| Some(Copied { copy: index, of, part: own.part_in(&all[of])? })) {
            Some(copied) => found.push(copied),
            None => own.readings.marks().iter().for_each(|mark| with_mark.entry(*mark).or_default().push(index)),
        }
    }
    found.sort_by_key(|copied| copied.copy);
    found
}

/// Two runs of one sensor at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// The one that began first.
    pub first: usize,
    /// The one that began while it went on.
    pub second: usize,
    /// For how long, s.
    pub for_s: f64,
}

/// The runs that begin before another one of the same sensor ends, by their places in the list. Copies, whose times are those of what they were copied from,
/// are passed over, and so are records of one measurement in two modes of the instrument. Runs that name no sensor may be of several.
#[must_use]
pub fn overlaps(all: &[Recording], copies: &[Copied]) -> Vec<Overlap> {
    let is_copy = |index: &usize| copies.iter().any(|copied| copied.copy == *index);
    let mut timed: Vec<(&str, [f64; 2], usize)> = (0..all.len())
        .filter(|index| !is_copy(index) && !all[*index].sensor.is_empty())
        .filter_map(|index| Some((all[index].sensor.as_str(), all[index].times_s?, index)))
        .collect();
    timed.sort_by(|a, b| a.0.cmp(b.0).then(a.1[0].total_cmp(&b.1[0])).then(a.2.cmp(&b.2)));
    let mut found = Vec::new();
    let mut before: Option<(&str, [f64; 2], usize)> = None;
    for now in timed {
        let Some(longest) = before.filter(|longest| longest.0 == now.0) else {
            before = Some(now);
            continue;
        };
        let for_s = longest.1[1].min(now.1[1]) - now.1[0];
        let (a, b) = (&all[longest.2], &all[now.2]);
        if for_s > OVERLAP_S && (a.mode == b.mode || a.kind != b.kind) {
            found.push(Overlap { first: longest.2, second: now.2, for_s });
        }
        if now.1[1] > longest.1[1] {
            before = Some(now);
        }
    }
    found.sort_by_key(|overlap| (overlap.second, overlap.first));
    found
}

impl Copied {
    /// What is the case, with the name of the other run.
    #[must_use]
    pub fn text(&self, of: &str) -> String {
        format!(
            "{:.0} % of its readings stand in {of} as well, one after the other, beside the same temperatures: both are of one recording",
            100.0 * self.part
        )
    }

    /// What to do about it.
    pub const REMEDY: &'static str = "take one of the two away, or leave it out with [[exclude]]: it would count twice";
}

impl Overlap {
    /// What is the case, with the name of the other run.
    #[must_use]
    pub fn text(&self, of: &str) -> String {
        let shown = if self.for_s < 120.0 { format!("{:.0} s", self.for_s) } else { format!("{:.0} min", self.for_s / 60.0) };
        format!("begins while {of} of the same sensor goes on; {shown} of both are at the same time")
    }

    /// What to do about it.
    pub const REMEDY: &'static str = "correct `start` in one of the two, or take one away where both are of one record: temperatures and periods follow the time";
}

/// What is told of the recordings of a campaign: a note of copies and one of overlaps, however many there are.
#[must_use]
pub fn told(all: &[Recording]) -> Vec<Note> {
    let copied = copies(all);
    let overlapping = overlaps(all, &copied);
    let note = |first: String, about: usize, others: Vec<&str>, remedy: &str| {
        let mut text = first;
        if !others.is_empty() {
            let named = others.iter().take(MOST_NAMED).copied().collect::<Vec<_>>().join(", ");
            let more = others.len().saturating_sub(MOST_NAMED);
            text.push_str(&format!("; the same is to be said of {named}"));
            if more > 0 {
                text.push_str(&format!(" and {more} more"));
            }
        }
        Note::new(NoteKind::Data, text).about(&all[about].id).with_remedy(remedy)
    };
    let name = |index: usize| all[index].id.as_str();
    let mut notes = Vec::new();
    if let Some((first, rest)) = copied.split_first() {
        let text = format!("run {}: {}", name(first.copy), first.text(&format!("run {}", name(first.of))));
        notes.push(note(text, first.copy, rest.iter().map(|other| name(other.copy)).collect(), Copied::REMEDY));
    }
    if let Some((first, rest)) = overlapping.split_first() {
        let text = format!("run {} {}", name(first.second), first.text(&format!("run {}", name(first.first))));
        notes.push(note(text, first.second, rest.iter().map(|other| name(other.second)).collect(), Overlap::REMEDY));
    }
    notes
}

#[cfg(test)]
mod tests;
