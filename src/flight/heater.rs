//! Disturbance by heaters, level K (R 4.12): when they switched, what they add to the field, and the field without it.
//!
//! R takes the jumps one by one. Here the whole of an interval is one question, which has a most probable answer:
//!
//! 1. The vectors of an interval become means over cells of a second ([`Cells`]); what follows sees only these, whatever the
//!    mode. Short runs of vectors that stand out of those on both sides are not in them: no heater is on for so short.
//! 2. Steps of the field that stand out of the noise of their surroundings fall into classes, those of all intervals together.
//! 3. The course of the states of all heaters is the most probable one (Viterbi), given the class vectors, how long the heaters
//!    use to stay off and on, and a background whose increments are predicted from those before, with the coefficients of their
//!    surroundings. An interval begins and ends with all heaters off, so that there is one polarity.
//! 4. Class vectors by generalised least squares from all edges, times in a state, and background follow from the course, and the
//!    course from them, a few times; then every edge moves to its most probable time.
//! 5. The class vectors are subtracted, and the samples of an edge are closed, by its shape or by a straight line
//!    ([`HeaterClosing`]), with the flag HEATER.
//!
//! An interval stays as it is where the field without heaters would not be more probable by far, and a heater whose polarity is
//! not clear is left alone.
//!
//! With a table of times ([`HeaterMethod::Table`]) step 3 is given, and only its small errors of time are removed.
//!
//! [`learn`] gives the classes from intervals of any number of days; [`find`] and [`close`] then need one interval at a time, and
//! depend on nothing else. [`close_jumps`] does all three where everything is in memory.

mod background;
mod cells;
mod classes;
mod closing;
mod courses;
mod edges;
mod learning;
mod screen;
#[cfg(test)]
mod simulated;
mod states;
mod table;
mod unlisted;

use crate::fit::statistics::std_of;
use std::ops::Range;

pub use crate::files::flight::auxiliary::HeaterOn;
use nalgebra::Vector3;
use rayon::prelude::*;

pub use cells::Cells;
pub use closing::close;
pub use learning::learn;
pub use table::{TableTimes, table_times};
pub use unlisted::unlisted;

use background::Background;
use cells::Profile;
use courses::Course;
use edges::Evidence;
use states::{Dwell, Ends};

/// The flag of vectors that were disturbed by an edge and closed.
pub const HEATER: u32 = crate::data::flags::Flags::HEATER.0;

/// Times for which the field of a heater may rise or fall, s, where none is stated.
pub const EDGES_S: [f64; 5] = [0.0, 0.5, 1.0, 2.0, 4.0];

/// Rounds of course, classes and background.
const ROUNDS: usize = 3;
/// Logarithm of the probability that a heater must gain in an interval to be there at all.
const PRESENCE: f64 = 30.0;
/// Times in a state from which their mean and scatter are taken.
const LEAST_TIMES: usize = 10;
/// Least scatter of these times, in cells.
const LEAST_SCATTER_CELLS: f64 = 0.7;
/// How far an edge may be moved from where the course has it, and from where a table has it in standard deviations.
const REACH_CELLS: f64 = 1.0;
const REACH_STDS: f64 = 4.0;

/// Half-open interval `[from, to)` in which heaters may switch; they are off at both of its ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeaterInterval {
    /// Start.
    pub from_tt2000: i64,
    /// End.
    pub to_tt2000: i64,
}

impl HeaterInterval {
    /// The rows of a sorted column of times that lie within.
    #[must_use]
    pub fn rows(&self, time_tt2000: &[i64]) -> Range<usize> {
        let place = |at: i64| time_tt2000.partition_point(|&time| time < at);
        let start = place(self.from_tt2000);
        start..place(self.to_tt2000).max(start)
    }
}

/// Where the times of switching come from.
#[derive(Clone, Debug, PartialEq)]
pub enum HeaterMethod {
    /// Method 1: they are found in the field.
    Found,
    /// Method 2: they are given, in any order.
    Table(Vec<HeaterOn>),
}

/// How the samples of an edge are closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeaterClosing {
    /// By a straight line between the samples beside them, as R does.
    Line,
    /// By subtraction of the part of the class vector that the known shape of the edge has at its time, where that time is known
    /// well; else by a straight line. This keeps what the field does within the edge.
    Shape,
}

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct HeaterOptions {
    /// Names of the classes; one heater each.
    pub classes: Vec<String>,
    /// Where the times come from.
    pub method: HeaterMethod,
    /// Length of the cells in which edges are looked for, s.
    pub cell_s: f64,
    /// Time that the field of a heater takes to rise or fall, s; `None` takes the most probable of [`EDGES_S`].
    pub edge_s: Option<f64>,
    /// Increments before one from which it is predicted.
    pub order: usize,
    /// Standard deviation of the times of a table, s.
    pub table_std_s: f64,
    /// How the samples of an edge are closed.
    pub closing: HeaterClosing,
}

impl HeaterOptions {
    /// The usual numbers.
    #[must_use]
    pub fn new(classes: Vec<String>, method: HeaterMethod) -> Self {
        HeaterOptions { classes, method, cell_s: 1.0, edge_s: None, order: 4, table_std_s: 0.1, closing: HeaterClosing::Shape }
    }

    /// The same with edges of a length.
    fn with_edges(&self, edge_s: f64) -> Self {
        HeaterOptions { edge_s: Some(edge_s), ..self.clone() }
    }

    fn profile(&self) -> Profile {
        Profile { edge_cells: self.edge_s.unwrap_or(EDGES_S[0]) / self.cell_s, mean_cells: 1.0 }
    }
}

/// A class of jumps: what a heater adds to the field while it is on, and how long it uses to be off and on.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct HeaterClass {
    /// Its name.
    pub name: String,
    /// Field of the heater in the axes of the vectors, nT; zero where no edge was seen.
    pub vector_nt: [f64; 3],
    /// Standard deviation of it, nT.
    pub std_nt: [f64; 3],
    /// Mean and standard deviation of the times off, s; NaN where there are too few.
    pub off_s: [f64; 2],
    /// Mean and standard deviation of the times on, s.
    pub on_s: [f64; 2],
    /// Edges that this is made from.
    pub edges: usize,
    /// Time that its field takes to rise or fall, s: the same for all heaters of a sensor.
    pub edge_s: f64,
}

/// A jump of the field.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Jump {
    /// Middle of the edge.
    pub time_tt2000: i64,
    /// Standard deviation of the time, s; infinite where no vector says it.
    pub time_std_s: f64,
    /// Index of the interval, as given to [`close_jumps`]; 0 from [`find`].
    pub interval: usize,
    /// Index of the class.
    pub class: usize,
    /// The heater is switched on.
    pub on: bool,
    /// Field with the heater minus field without it, measured at this edge alone, nT; NaN where no vector says it.
    pub height_nt: [f64; 3],
    /// Standard deviation of it, nT.
    pub std_nt: [f64; 3],
}

impl Jump {
    /// Whether vectors show it: within a gap, or at the end of an interval, it is found by what follows from the others.
    #[must_use]
    pub fn is_shown(&self) -> bool {
        self.height_nt.iter().all(|height| height.is_finite())
    }
}

/// Why heaters cannot be dealt with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages tell what the fields are")]
pub enum HeaterError {
    #[error("heater.classes: no class is named; name one per heater")]
    NoClass,
    #[error("heater.classes: {given} classes are known from before and {asked} are named; both must be the same heaters")]
    Classes { given: usize, asked: usize },
    #[error("heater table, row {row}: class {class} of {classes}; name it in heater.classes")]
    Class { row: usize, class: usize, classes: usize },
    #[error("heater table, row {row}: it ends before it starts")]
    Backwards { row: usize },
    #[error("heater.{key} is {value}; it must be {rule}")]
    Option { key: &'static str, value: f64, rule: &'static str },
    #[error("{what}: {found} rows, {expected} needed; all columns have one row per vector")]
    Length { what: &'static str, expected: usize, found: usize },
    #[error("heater.interval {interval}: it overlaps the one before, or ends before it starts; intervals are in order and apart")]
    Interval { interval: usize },
}

/// The jumps of one interval, of classes that are known.
///
/// # Errors
/// Options, classes or a table that contradict themselves.
pub fn find(cells: &Cells, classes: &[HeaterClass], options: &HeaterOptions) -> Result<Vec<Jump>, HeaterError> {
    check(options)?;
    if classes.len() != options.classes.len() {
        return Err(HeaterError::Classes { given: classes.len(), asked: options.classes.len() });
    }
    let options = &options.with_edges(edge_s(classes));
    let profile = options.profile();
    let vectors = vectors(classes);
    let increments = match options.method {
        HeaterMethod::Found => screen::without_strange(cells.increments(), &vectors),
        HeaterMethod::Table(_) => cells.increments(),
    };
    let mut course = if let HeaterMethod::Table(table) = &options.method {
        courses::given(&increments, &courses::of_table(table, cells, options), &vectors, options)
    } else {
        let dwells: Vec<Dwell> = classes.iter().map(|class| dwell(class, options)).collect();
        // The first course is against white noise, since edges that are not known yet would colour the background. Which heaters
        // are there is asked with the first background that is coloured, and at the end.
        let background = Background::of(&increments, 0);
        let evidence = Evidence { increments: &increments, background: &background, profile };
        let (_, edges) = courses::most_probable(&evidence, &vectors, &dwells, None, Ends::Off);
        let mut found = Course { edges, background };
        for round in 1..=ROUNDS {
            found = courses::next(&increments, &found, &vectors, &dwells, round == 2, Ends::Off, options);
        }
        if !courses::better(&increments, &found, &vectors, options) {
            found.edges.clear();
        }
        let evidence = Evidence { increments: &increments, background: &found.background, profile };
        evidence.refine(&mut found.edges, &vectors, f64::INFINITY, REACH_CELLS);
        found
    };
    let evidence = Evidence { increments: &increments, background: &course.background, profile };
    let innovations = course.background.innovations(&evidence.without(&course.edges, &vectors));
    evidence.spread(&mut course.edges, &vectors, &innovations);
    let jumps = course.edges.iter().map(|edge| {
        let height = evidence.height(*edge, vectors[edge.heater], &innovations);
        let (height, std_nt) = height.map_or(([f64::NAN; 3], [f64::NAN; 3]), |(height, covariance)| {
            (height.into(), covariance.diagonal().map(std_of).into())
        });
        Jump {
            time_tt2000: cells.time_tt2000(edge.cell),
            time_std_s: edge.std_cells * options.cell_s,
            interval: 0,
            class: edge.heater,
            on: edge.on,
            height_nt: height,
            std_nt,
        }
    });
    let mut jumps: Vec<Jump> = jumps.collect();
    jumps.sort_by_key(|jump| (jump.time_tt2000, jump.class));
    Ok(jumps)
}

/// The steps of one interval, in order of time, that are too large for heaters of these classes: they are taken for none.
#[must_use]
pub fn strange_steps(cells: &Cells, classes: &[HeaterClass]) -> Vec<i64> {
    let increments = cells.increments();
    let most_nt = screen::strange_nt(&increments, &vectors(classes));
    let strange = increments.iter().enumerate().filter(|(_, step)| step.norm() > most_nt);
    strange.map(|(cell, _)| cells.time_tt2000(cell as f64 - 0.5)).collect()
}

/// Everything at once: classes from all intervals unless they are known, jumps, and the field without them. Intervals are in
/// order and apart.
///
/// # Errors
/// Columns, intervals, classes or a table that contradict themselves.
pub fn close_jumps(
    time_tt2000: &[i64],
    field_nt: &mut [Vec<f64>; 3],
    flags: &mut [u32],
    intervals: &[HeaterInterval],
    known: Option<&[HeaterClass]>,
    options: &HeaterOptions,
) -> Result<(Vec<HeaterClass>, Vec<Jump>), HeaterError> {
    check_lengths(time_tt2000, field_nt, flags)?;
    for (index, interval) in intervals.iter().enumerate() {
        if interval.to_tt2000 < interval.from_tt2000 || index > 0 && interval.from_tt2000 < intervals[index - 1].to_tt2000 {
            return Err(HeaterError::Interval { interval: index });
        }
    }
    let records: Vec<(usize, Cells)> = intervals
        .par_iter()
        .enumerate()
        .filter_map(|(index, interval)| Some((index, Cells::of(time_tt2000, field_nt, *interval, options)?)))
        .collect();
    let classes = match known {
        Some(classes) => classes.to_vec(),
        None => learn(&records.iter().map(|(_, cells)| cells.clone()).collect::<Vec<_>>(), options)?,
    };
    let found: Vec<Vec<Jump>> =
        records.par_iter().map(|(_, cells)| find(cells, &classes, options)).collect::<Result<_, HeaterError>>()?;
    let mut all = Vec::new();
    for ((index, _), jumps) in records.iter().zip(found) {
        close(time_tt2000, field_nt, flags, intervals[*index], &jumps, &classes, options)?;
        all.extend(jumps.into_iter().map(|jump| Jump { interval: *index, ..jump }));
    }
    Ok((classes, all))
}

/// How long a heater stays off and on, in cells.
fn dwell(class: &HeaterClass, options: &HeaterOptions) -> Dwell {
    let cells = |[mean, std]: [f64; 2]| [mean / options.cell_s, (std / options.cell_s).hypot(LEAST_SCATTER_CELLS)];
    Dwell::of([cells(class.off_s), cells(class.on_s)])
}

/// Classes of which nothing is known.
fn unknown(options: &HeaterOptions) -> Vec<HeaterClass> {
    let class = |name: &String| HeaterClass {
        name: name.clone(),
        vector_nt: [0.0; 3],
        std_nt: [f64::INFINITY; 3],
        off_s: [f64::NAN; 2],
        on_s: [f64::NAN; 2],
        edges: 0,
        edge_s: options.edge_s.unwrap_or(EDGES_S[0]),
    };
    options.classes.iter().map(class).collect()
}

/// Time that the fields of heaters take to rise or fall, s.
fn edge_s(classes: &[HeaterClass]) -> f64 {
    classes.first().map_or(EDGES_S[0], |class| class.edge_s)
}

fn vectors(classes: &[HeaterClass]) -> Vec<Vector3<f64>> {
    classes.iter().map(|class| class.vector_nt.into()).collect()
}

/// Refuses options and tables that contradict themselves.
fn check(options: &HeaterOptions) -> Result<(), HeaterError> {
    if options.classes.is_empty() {
        return Err(HeaterError::NoClass);
    }
    for (key, value, least) in
        [("cell_s", options.cell_s, f64::MIN_POSITIVE), ("edge_s", options.edge_s.unwrap_or(EDGES_S[0]), 0.0)]
    {
        if !(least..=3600.0).contains(&value) {
            return Err(HeaterError::Option { key, value, rule: "positive, and at most an hour" });
        }
    }
    if let HeaterMethod::Table(table) = &options.method {
        for (row, on) in table.iter().enumerate() {
            if on.class >= options.classes.len() {
                return Err(HeaterError::Class { row, class: on.class, classes: options.classes.len() });
            }
            if on.to_tt2000 < on.from_tt2000 {
                return Err(HeaterError::Backwards { row });
            }
        }
    }
    Ok(())
}

/// Refuses columns of different length.
fn check_lengths(time_tt2000: &[i64], field_nt: &[Vec<f64>; 3], flags: &[u32]) -> Result<(), HeaterError> {
    let expected = time_tt2000.len();
    let columns = [("x", field_nt[0].len()), ("y", field_nt[1].len()), ("z", field_nt[2].len()), ("flags", flags.len())];
    match columns.into_iter().find(|(_, found)| *found != expected) {
        Some((what, found)) => Err(HeaterError::Length { what, expected, found }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    const SECOND: i64 = 1_000_000_000;

    /// Two intervals of 1000 s at a rate per second, 300 s apart, with a random walk, white noise of 0.03 nT and two heaters of
    /// which the first interval has one and the second both; they switch about every 15 s and 17 s.
    struct Record {
        time: Vec<i64>,
        field: [Vec<f64>; 3],
        background: [Vec<f64>; 3],
        intervals: Vec<HeaterInterval>,
        table: Vec<HeaterOn>,
    }

    const VECTORS: [[f64; 3]; 2] = [[0.7, -0.1, 0.3], [0.4, 1.0, 0.5]];

    fn record(seed: u64, rate: i64) -> Record {
        with_edges(seed, rate, 1.0)
    }

    fn with_edges(seed: u64, rate: i64, edge_cells: f64) -> Record {
        let mut random = Random::seeded(seed);
        let intervals: Vec<HeaterInterval> =
            [0, 1300].map(|start| HeaterInterval { from_tt2000: start * SECOND, to_tt2000: (start + 1000) * SECOND }).to_vec();
        let mut table = Vec::new();
        for (start, classes) in [(0, 0..1), (1300, 0..2)] {
            for class in classes {
                for k in 0..(900 / (30 + 4 * class as i64)) {
                    let mut at = |half: i64| {
                        let seconds =
                            (start + 50) as f64 + (15 + 2 * class as i64) as f64 * (2 * k + half) as f64 + 3.0 * random.uniform();
                        (seconds * 1e9) as i64
                    };
                    table.push(HeaterOn { from_tt2000: at(0), to_tt2000: at(1), class });
                }
            }
        }
        let time: Vec<i64> = (-200 * rate..2500 * rate).map(|row| row * SECOND / rate).collect();
        let profile = Profile { edge_cells, mean_cells: 1.0 / rate as f64 };
        let walk_nt = 0.06 / (rate as f64).sqrt();
        let background = [0, 1, 2].map(|_| {
            let mut level = 0.0;
            let step = |_: &i64| {
                level += walk_nt * random.gaussian();
                level + 0.03 * random.gaussian()
            };
            time.iter().map(step).collect::<Vec<f64>>()
        });
        let mut field = background.clone();
        for on in &table {
            let near = HeaterInterval { from_tt2000: on.from_tt2000 - 2 * SECOND, to_tt2000: on.to_tt2000 + 2 * SECOND };
            for row in near.rows(&time) {
                let share = |edge: i64| profile.share((time[row] - edge) as f64 * 1e-9);
                let part = share(on.from_tt2000) - share(on.to_tt2000);
                (0..3).for_each(|component| field[component][row] += part * VECTORS[on.class][component]);
            }
        }
        Record { time, field, background, intervals, table }
    }

    fn names() -> Vec<String> {
        vec!["first".into(), "second".into()]
    }

    /// Root mean square of a field about the background of the record, within its intervals.
    fn rms(record: &Record, field: &[Vec<f64>; 3]) -> f64 {
        let rows: Vec<usize> = record.intervals.iter().flat_map(|interval| interval.rows(&record.time)).collect();
        let square = |&row: &usize| (0..3).map(|c| (field[c][row] - record.background[c][row]).powi(2)).sum::<f64>() / 3.0;
        (rows.iter().map(square).sum::<f64>() / rows.len() as f64).sqrt()
    }

    #[test]
    fn both_methods_find_the_classes_and_leave_the_background() {
        for (seed, rate) in [(1, 1), (2, 5), (3, 20)] {
            let record = record(seed, rate);
            for method in [HeaterMethod::Found, HeaterMethod::Table(record.table.clone())] {
                let found = method == HeaterMethod::Found;
                let options = HeaterOptions::new(names(), method);
                let (mut field, mut flags) = (record.field.clone(), vec![0; record.time.len()]);
                let (classes, jumps) = close_jumps(&record.time, &mut field, &mut flags, &record.intervals, None, &options)
                    .expect("all is in order");
                for (class, truth) in classes.iter().zip(VECTORS) {
                    for ((value, std), truth) in class.vector_nt.iter().zip(class.std_nt).zip(truth) {
                        assert!((value - truth).abs() < 5.0 * std && std < 0.02, "{class:?}");
                    }
                }
                // Every jump of the truth has one of the same class and direction within 1.6 s, and there are hardly others.
                let truth: Vec<(i64, usize, bool)> = record
                    .table
                    .iter()
                    .flat_map(|on| [(on.from_tt2000, on.class, true), (on.to_tt2000, on.class, false)])
                    .collect();
                let matched = |(at, class, on): &(i64, usize, bool)| {
                    jumps
                        .iter()
                        .any(|jump| jump.class == *class && jump.on == *on && (jump.time_tt2000 - at).abs() < 8 * SECOND / 5)
                };
                let share = truth.iter().filter(|jump| matched(jump)).count() as f64 / truth.len() as f64;
                assert!(share >= if found { 0.97 } else { 1.0 }, "{rate} {share}");
                assert!(jumps.len() as f64 <= 1.02 * truth.len() as f64);
                // What is left is the error of times and class vectors alone, far below the noise of 0.03 nT and the 0.5 nT
                // before.
                let (before, after) = (rms(&record, &record.field), rms(&record, &field));
                assert!(before > 0.3 && after < if found { 0.04 } else { 0.02 }, "{rate} {before} {after}");
                let inside = |row: usize| record.intervals.iter().any(|interval| interval.rows(&record.time).contains(&row));
                for row in (0..record.time.len()).filter(|&row| !inside(row)) {
                    assert!(flags[row] == 0 && (0..3).all(|c| field[c][row].to_bits() == record.field[c][row].to_bits()));
                }
            }
        }
    }

    #[test]
    fn the_length_of_edges_is_found_and_heights_are_those_of_such_edges() {
        for (edge_s, seed) in [(0.0, 8), (1.0, 9), (2.0, 10)] {
            let record = with_edges(seed, 20, edge_s);
            for method in [HeaterMethod::Found, HeaterMethod::Table(record.table.clone())] {
                let options = HeaterOptions::new(names(), method);
                let mut field = record.field.clone();
                let mut flags = vec![0; record.time.len()];
                let (classes, _) = close_jumps(&record.time, &mut field, &mut flags, &record.intervals, None, &options)
                    .expect("all is in order");
                for (class, truth) in classes.iter().zip(VECTORS) {
                    assert_eq!(class.edge_s, edge_s, "{class:?}");
                    let pull = |c: usize| (class.vector_nt[c] - truth[c]).abs() / class.std_nt[c];
                    assert!((0..3).all(|c| pull(c) < 5.0), "{edge_s} {class:?}");
                }
            }
        }
    }

    #[test]
    fn heights_agree_with_the_classes_within_their_standard_deviations() {
        let record = record(4, 1);
        // Times that are not moved do not take part in the errors.
        let options =
            HeaterOptions { table_std_s: 0.0, ..HeaterOptions::new(names(), HeaterMethod::Table(record.table.clone())) };
        let (_, jumps) =
            close_jumps(&record.time, &mut record.field.clone(), &mut vec![0; 2700], &record.intervals, None, &options)
                .expect("all is in order");
        let pulls: Vec<f64> =
            jumps.iter().flat_map(|jump| (0..3).map(|c| (jump.height_nt[c] - VECTORS[jump.class][c]) / jump.std_nt[c])).collect();
        let square = pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64;
        assert!((0.8..1.2).contains(&square), "{square}");
        assert!(jumps.is_sorted_by_key(|jump| (jump.interval, jump.time_tt2000)));
    }

    #[test]
    fn an_interval_alone_with_known_classes_gives_what_it_gives_among_others() {
        let record = record(5, 1);
        let options = HeaterOptions::new(names(), HeaterMethod::Found);
        let mut together = record.field.clone();
        let (classes, jumps) = close_jumps(&record.time, &mut together, &mut vec![0; 2700], &record.intervals, None, &options)
            .expect("all is in order");
        let mut alone = record.field.clone();
        for interval in record.intervals.iter().rev() {
            let cells = Cells::of(&record.time, &alone, *interval, &options).expect("there are vectors");
            let own = find(&cells, &classes, &options).expect("all is in order");
            close(&record.time, &mut alone, &mut vec![0; 2700], *interval, &own, &classes, &options).expect("all is in order");
        }
        assert_eq!(alone, together);
        // One thread or many: the same bits.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
        let single = pool.install(|| {
            close_jumps(&record.time, &mut record.field.clone(), &mut vec![0; 2700], &record.intervals, None, &options)
        });
        assert_eq!(single, Ok((classes, jumps)));
    }

    #[test]
    fn a_field_without_heaters_stays_as_it_is() {
        let record = record(6, 1);
        let options = HeaterOptions::new(names(), HeaterMethod::Found);
        let mut field = record.background.clone();
        let (classes, jumps) = close_jumps(&record.time, &mut field, &mut vec![0; 2700], &record.intervals, None, &options)
            .expect("all is in order");
        assert_eq!((jumps, field), (Vec::new(), record.background));
        assert!(classes.iter().all(|class| class.edges == 0 && class.vector_nt == [0.0; 3]));
    }

    #[test]
    fn three_heaters_are_searched_in_pairs() {
        let mut record = record(7, 1);
        // The third one is on four times as long, in the second interval only.
        let third = [-0.9, 0.2, 1.1];
        let times: Vec<(i64, i64)> = (0..14).map(|k| ((1340 + 60 * k) * SECOND, (1370 + 60 * k) * SECOND)).collect();
        let profile = Profile { edge_cells: 1.0, mean_cells: 1.0 };
        for (row, time) in record.time.iter().enumerate() {
            let share = |edge: i64| profile.share((time - edge) as f64 * 1e-9);
            let on: f64 = times.iter().map(|(from, to)| share(*from) - share(*to)).sum();
            (0..3).for_each(|component| record.field[component][row] += on * third[component]);
        }
        let options = HeaterOptions::new(vec!["a".into(), "b".into(), "c".into()], HeaterMethod::Found);
        let (classes, _) =
            close_jumps(&record.time, &mut record.field.clone(), &mut vec![0; 2700], &record.intervals, None, &options)
                .expect("all is in order");
        for truth in VECTORS.iter().chain([&third]) {
            let pull = |class: &HeaterClass, c: usize| (class.vector_nt[c] - truth[c]).abs() / class.std_nt[c];
            assert!(classes.iter().any(|class| (0..3).all(|c| pull(class, c) < 5.0)), "{truth:?} {classes:?}");
        }
    }

    #[test]
    fn contradictions_are_named() {
        let options = HeaterOptions::new(names(), HeaterMethod::Found);
        let none = HeaterOptions::new(Vec::new(), HeaterMethod::Found);
        assert_eq!(learn(&[], &none), Err(HeaterError::NoClass));
        assert_eq!(learn(&[], &options).map(|classes| classes.len()), Ok(2));
        let table = |on: HeaterOn| HeaterOptions::new(names(), HeaterMethod::Table(vec![on]));
        let strange = table(HeaterOn { from_tt2000: 0, to_tt2000: 1, class: 2 });
        assert_eq!(learn(&[], &strange), Err(HeaterError::Class { row: 0, class: 2, classes: 2 }));
        let backwards = table(HeaterOn { from_tt2000: 2, to_tt2000: 1, class: 1 });
        assert_eq!(learn(&[], &backwards), Err(HeaterError::Backwards { row: 0 }));
        let zero = HeaterOptions { cell_s: 0.0, ..options.clone() };
        assert!(matches!(learn(&[], &zero), Err(HeaterError::Option { key: "cell_s", .. })));
        let cells = Cells { start_tt2000: 0, cell_ns: SECOND, field_nt: vec![Vector3::zeros(); 20], short: Vec::new() };
        assert_eq!(find(&cells, &[], &options), Err(HeaterError::Classes { given: 0, asked: 2 }));
        let overlap = [(0, 10), (9, 20)].map(|(from_tt2000, to_tt2000)| HeaterInterval { from_tt2000, to_tt2000 });
        let empty = || [Vec::new(), Vec::new(), Vec::new()];
        let refused = close_jumps(&[], &mut empty(), &mut [], &overlap, None, &options);
        assert_eq!(refused, Err(HeaterError::Interval { interval: 1 }));
    }
}
