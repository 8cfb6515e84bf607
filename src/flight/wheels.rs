//! Level H: interference of reaction wheels and of lines of constant frequency removed (RO-IGEP-TR0028, section 4.9).
//!
//! A wheel with the rotation rate f is seen at its alias `|f - f_s round(f / f_s)|`. Two methods take it away:
//!
//! * [`Method::Stripe`] is that of R: in windows of 1024 vectors the bins of the Fourier transform at the alias take the level of the
//!   bins beside them, and random phases.
//! * [`Method::Fit`] knows the phase φ of every wheel, the integral of its rate, and fits `a cos φ + b sin φ` to the vectors themselves,
//!   so that the natural field at the same frequency stays. Folding needs no thought: φ is evaluated at the times of the vectors.
//!
//! Vectors are cleaned in stretches: one mode, no gap of more than 5 steps, within the table of rates. Nothing is extrapolated: vectors
//! outside the table pass unchanged and are flagged and counted. So are stretches of fewer than 128 vectors.

mod chain;
mod orders;
mod rates;
mod seen;
mod stripe;
#[cfg(test)]
mod tests;

pub use rates::{WheelRates, leaps};
pub use seen::{RatesLate, Seen};

use rates::{Table, seconds};
use rayon::prelude::*;

/// Flag of a vector that was changed.
pub const WHEEL: u32 = crate::data::flags::Flags::WHEEL.0;
/// Flag of a vector of a cleaned mode that could not be cleaned.
pub const NOT_CLEANED: u32 = crate::data::flags::Flags::NOT_CLEANED.0;

/// Steps from one vector to the next at most, within a stretch.
const LONGEST_GAP_STEPS: f64 = 5.5;
/// Steps, missing ones included, that a stretch has at least.
const SHORTEST_STRETCH: usize = 128;

/// How interference is removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Waves along the phases of the wheels are fitted and subtracted.
    Fit,
    /// Bins of the spectrum are replaced, as R does it.
    Stripe,
}

/// What the removal needs to know of a mode.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelMode {
    /// Vectors per second.
    pub rate_hz: f64,
    /// Half of the width of a stripe; modes without it pass unchanged, whatever the method.
    pub half_width_hz: Option<f64>,
    /// Lines of constant frequency in the data of this mode (Langmuir probe), below half of the rate.
    pub lines_hz: Vec<f64>,
}

/// How to remove.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelOptions {
    /// Multiples of the rotation rate that are removed.
    pub harmonics: Vec<u32>,
    /// The method.
    pub method: Method,
    /// Seed of the phases of [`Method::Stripe`]: equal seeds give equal results.
    pub seed: u64,
    /// Rows of the table of rates further apart have a gap between them, in which nothing is cleaned.
    pub longest_table_gap_s: f64,
    /// The report counts the vectors of these times only; all without it. What is removed does not depend on it.
    pub counted: Option<std::ops::Range<i64>>,
}

impl Default for WheelOptions {
    fn default() -> Self {
        Self { harmonics: vec![1], method: Method::Fit, seed: 1, longest_table_gap_s: 60.0, counted: None }
    }
}

/// Why nothing was removed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages tell what the fields are")]
pub enum WheelError {
    /// Columns of the table differ in length.
    #[error("wheel {wheel} of the table of rates has {found} rows, its times have {rows}")]
    Length { wheel: usize, found: usize, rows: usize },
    /// The times of the table do not rise.
    #[error("row {row} of the table of wheel rates is not later than the row before it; sort the table by time, each time once")]
    Order { row: usize },
    /// The columns of the vectors differ in length.
    #[error("{what} has {found} rows, the times have {rows}")]
    Rows { what: &'static str, found: usize, rows: usize },
    /// Vectors are not in the order of their times.
    #[error("vector {row} is earlier than the vector before it")]
    Vectors { row: usize },
    /// A vector names a mode that is not there.
    #[error("vector {row} is of mode {mode}, of {modes}")]
    Mode { row: usize, mode: u8, modes: usize },
    /// A rate, width or line of a mode that cannot be.
    #[error("{what} of mode {mode} is {value} Hz; {rule}")]
    Frequency { what: &'static str, mode: usize, value: f64, rule: &'static str },
}

/// What was removed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WheelReport {
    /// One for every mode, also those that passed unchanged.
    pub modes: Vec<ModeReport>,
}

/// What was removed from a mode.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct ModeReport {
    /// Vectors that are not null.
    pub vectors: usize,
    /// Of these, changed.
    pub changed: usize,
    /// Of these, in stretches that are too short.
    pub in_short_stretches: usize,
    /// Of these, outside the table of rates or in its gaps.
    pub outside_table: usize,
    /// Stretches that were cleaned.
    pub stretches: usize,
    /// Root mean square of what was removed, per component.
    pub removed_rms_nt: [f64; 3],
    /// The waves of the wheels, by [`Method::Fit`] only.
    pub waves: Vec<Wave>,
    /// The amplitudes of the lines in the order of the mode, by [`Method::Fit`] only: see [`Wave::amplitude_nt`].
    pub lines_nt: Vec<f64>,
    /// Whether the waves of every wheel, for all multiples, and then the lines are in the data.
    pub seen: Vec<Seen>,
    /// How late the rates are, if they are.
    pub rates_late: Option<RatesLate>,
}

/// A multiple of a wheel's rate.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Wave {
    /// Column of the table of rates, from 0.
    pub wheel: usize,
    /// Multiple of the rate.
    pub harmonic: u32,
    /// Median over time of its amplitude: root of the sum of the squared amplitudes of the components.
    pub amplitude_nt: f64,
    /// How fast its amplitude and phase wander, in nT per root of a second: along the phase, which the resolution of the table of rates
    /// makes, where its rate changes from row to row, and in any other way.
    pub wander_nt_per_root_s: [f64; 2],
}

/// Vectors of one mode without a long gap; rows count from the first vector of the day, slots are steps since the first of the stretch.
struct Stretch {
    rows: Vec<u32>,
    slots: Vec<u32>,
    /// Number of gaps of the table before it.
    table_gaps: usize,
}

impl Stretch {
    /// Steps, missing ones included.
    fn length(&self) -> usize {
        self.slots.last().map_or(0, |last| *last as usize + 1)
    }

    /// The entries of `rows` and `slots` for a range of slots.
    fn entries(&self, slots: std::ops::Range<usize>) -> std::ops::Range<usize> {
        let at = |slot: usize| self.slots.partition_point(|s| (*s as usize) < slot);
        at(slots.start)..at(slots.end)
    }
}

/// A day as the methods see it.
struct Day<'a> {
    times: &'a [i64],
    field: &'a [Vec<f64>; 3],
    table: Table,
    mode: &'a WheelMode,
    options: &'a WheelOptions,
}

/// Removes wheels and lines from vectors, in place, and sets their flags.
///
/// `field_nt` holds NaN where a vector is null; such rows stay as they are. `mode_of_row` counts `modes`. Vectors that are not changed
/// keep every bit. A table without wheels removes lines only, at any time. The result does not depend on the number of threads.
///
/// # Errors
///
/// [`WheelError`]; the vectors are as they were then.
pub fn clean(
    time_tt2000: &[i64],
    mode_of_row: &[u8],
    modes: &[WheelMode],
    wheels: &WheelRates,
    options: &WheelOptions,
    field_nt: &mut [Vec<f64>; 3],
    flags: &mut [u32],
) -> Result<WheelReport, WheelError> {
    check(time_tt2000, mode_of_row, modes, field_nt, flags)?;
    let mut table = Table::new(wheels, options.longest_table_gap_s)?;
    let mut report = WheelReport::default();
    for (index, mode) in modes.iter().enumerate() {
        let is_here = |row: usize| usize::from(mode_of_row[row]) == index && field_nt.iter().all(|b| b[row].is_finite());
        let rows: Vec<u32> = (0..time_tt2000.len()).filter(|row| is_here(*row)).map(|row| row as u32).collect();
        let is_counted = |row: &u32| options.counted.as_ref().is_none_or(|span| span.contains(&time_tt2000[*row as usize]));
        let counted = rows.iter().filter(|row| is_counted(row)).count();
        let mut entry = ModeReport { vectors: counted, ..ModeReport::default() };
        let idle = mode.lines_hz.is_empty() && (table.wheels() == 0 || options.harmonics.is_empty());
        if mode.half_width_hz.is_none() || idle {
            report.modes.push(entry);
            continue;
        }
        let (found, outside) = stretches(time_tt2000, &rows, mode.rate_hz, &table);
        entry.outside_table = outside.iter().filter(|row| is_counted(row)).count();
        let (found, short): (Vec<Stretch>, Vec<Stretch>) = found.into_iter().partition(|s| s.length() >= SHORTEST_STRETCH);
        entry.in_short_stretches = short.iter().flat_map(|s| &s.rows).filter(|row| is_counted(row)).count();
        for row in outside.iter().chain(short.iter().flat_map(|s| &s.rows)) {
            flags[*row as usize] |= NOT_CLEANED;
        }
        let day = Day { times: time_tt2000, field: field_nt, table, mode, options };
        let removed = match options.method {
            Method::Stripe => stripe::removal(&day, &found),
            Method::Fit => {
                let fitted = orders::removal(&day, &found);
                (entry.waves, entry.lines_nt) = (fitted.waves, fitted.lines_nt);
                fitted.removed
            }
        };
        (entry.seen, entry.rates_late) = seen::seen(&day, &found, &removed);
        table = day.table;
        let mut squares = [0.0; 3];
        for (row, removed) in found.iter().flat_map(|s| &s.rows).zip(&removed) {
            let counts = is_counted(row);
            entry.changed += usize::from(counts);
            for (c, (b, part)) in field_nt.iter_mut().zip(removed).enumerate() {
                b[*row as usize] -= part;
                squares[c] += if counts { part * part } else { 0.0 };
            }
            flags[*row as usize] |= WHEEL;
        }
        entry.stretches = found.len();
        entry.removed_rms_nt = squares.map(|sum: f64| (sum / entry.changed.max(1) as f64).sqrt());
        report.modes.push(entry);
    }
    Ok(report)
}

fn check(times: &[i64], mode_of_row: &[u8], modes: &[WheelMode], field: &[Vec<f64>; 3], flags: &[u32]) -> Result<(), WheelError> {
    let rows = times.len();
    let [x, y, z] = field.each_ref().map(Vec::len);
    for (what, found) in [("the modes", mode_of_row.len()), ("x", x), ("y", y), ("z", z), ("the flags", flags.len())] {
        if found != rows {
            return Err(WheelError::Rows { what, found, rows });
        }
    }
    if let Some(row) = (1..rows).find(|&i| times[i] < times[i - 1]) {
        return Err(WheelError::Vectors { row });
    }
    if let Some(row) = mode_of_row.iter().position(|mode| usize::from(*mode) >= modes.len()) {
        return Err(WheelError::Mode { row, mode: mode_of_row[row], modes: modes.len() });
    }
    for (index, mode) in modes.iter().enumerate() {
        let wrong = |what, value, rule| Err(WheelError::Frequency { what, mode: index, value, rule });
        if !(mode.rate_hz > 0.0 && mode.rate_hz.is_finite()) {
            return wrong("the rate", mode.rate_hz, "it is positive");
        }
        if let Some(width) = mode.half_width_hz.filter(|width| !(*width > 0.0 && *width < 0.5 * mode.rate_hz)) {
            return wrong("the half width", width, "it is positive and below half of the rate");
        }
        if let Some(line) = mode.lines_hz.iter().find(|f| !(**f > 0.0 && **f < 0.5 * mode.rate_hz)) {
            return wrong("a line", *line, "state it as it is seen, between 0 and half of the rate");
        }
    }
    Ok(())
}

/// Stretches of vectors of one mode, and the vectors which no rate is known for.
fn stretches(times: &[i64], rows: &[u32], rate_hz: f64, table: &Table) -> (Vec<Stretch>, Vec<u32>) {
    let (mut found, mut outside): (Vec<Stretch>, Vec<u32>) = (Vec::new(), Vec::new());
    let mut near = 0;
    let mut before = None;
    for &row in rows {
        let time = times[row as usize];
        let table_gaps = if table.wheels() == 0 {
            0
        } else if let Some((place, gaps)) = table.place(time, near) {
            near = place.row();
            gaps
        } else {
            outside.push(row);
            before = None;
            continue;
        };
        let steps = before.map(|before| seconds(time - before) * rate_hz);
        match (found.last_mut(), steps) {
            (Some(stretch), Some(steps)) if steps < LONGEST_GAP_STEPS && stretch.table_gaps == table_gaps => {
                let slot = stretch.length() as u32 - 1 + (steps.round() as u32).max(1);
                stretch.rows.push(row);
                stretch.slots.push(slot);
            }
            _ => found.push(Stretch { rows: vec![row], slots: vec![0], table_gaps }),
        }
        before = Some(time);
    }
    (found, outside)
}

/// Work for every item on all threads with buffers of their own; results in the order of the items.
fn in_parallel<T: Sync, B: Default + Send, R: Send>(items: &[T], work: impl Fn(&mut B, &T) -> R + Sync) -> Vec<R> {
    items.par_iter().map_init(B::default, |buffers, item| work(buffers, item)).collect()
}
