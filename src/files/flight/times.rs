//! Times of the rows of a table of flight processing: one of three columns counts, and the others must say the same.

use super::edited::plain;
use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, Tt2000};
use crate::files::table::series::SeriesTable;
use std::path::Path;

/// Which of the time columns counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeColumn {
    /// `time_tt2000`.
    Tt2000,
    /// `time_utc`.
    Utc,
    /// `time_obt`.
    Obt,
}

impl TimeColumn {
    /// The columns in the order in which they count.
    pub const ALL: [TimeColumn; 3] = [TimeColumn::Tt2000, TimeColumn::Utc, TimeColumn::Obt];

    /// Its name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            TimeColumn::Tt2000 => "time_tt2000",
            TimeColumn::Utc => "time_utc",
            TimeColumn::Obt => "time_obt",
        }
    }
}

/// Which column of times counts where there are several, and how far they may differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimeRule {
    /// The column that counts; absent for the first of those that a table has.
    pub primary: Option<TimeColumn>,
    /// How far columns of times may differ, ns.
    pub tolerance_ns: i64,
}

impl TimeRule {
    /// The same for a table that may lack the column that counts: then the first one counts that it has.
    #[must_use]
    pub fn beside(self, table: &SeriesTable) -> Self {
        let has = |column: &TimeColumn| table.names().iter().any(|name| plain(name) == column.name());
        Self { primary: self.primary.filter(has), ..self }
    }

    /// The times of the rows that are read, after a look whether all columns of times say the same.
    ///
    /// # Errors
    /// A table without the column, a time that is none, times that contradict each other, with the row.
    pub fn times(self, table: &SeriesTable, path: &Path, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
        let names = table.names();
        let name_of = |column: TimeColumn| names.iter().find(|name| plain(name) == column.name());
        let read = |column: TimeColumn| match (name_of(column), column) {
            (None, _) => Ok(Vec::new()),
            (Some(name), TimeColumn::Tt2000) => table.tt2000(name),
            (Some(name), TimeColumn::Utc) => table.utc(name, leap),
            (Some(name), TimeColumn::Obt) => table.clock(name, leap),
        };
        let there: Vec<TimeColumn> = TimeColumn::ALL.into_iter().filter(|column| name_of(*column).is_some()).collect();
        let first = self.primary.filter(|c| there.contains(c)).or(there.first().copied());
        let Some(primary) = first.filter(|_| self.primary.is_none_or(|c| there.contains(&c))) else {
            let wanted = self.primary.map_or("time_tt2000, time_utc or time_obt", TimeColumn::name);
            let rule = format!("has no column of times: {wanted}");
            return Err(Finding::error(&path.display().to_string(), rule, "add it"));
        };
        let mut times = read(primary)?;
        for other in there.iter().filter(|c| **c != primary) {
            let others = read(*other)?;
            // Timestamps know no leap second, so that the label of a time counts there, not the time.
            let with_utc = [*other, primary].contains(&TimeColumn::Utc);
            self.agree(&times, &others, with_utc, leap).map_err(|row| {
                let told = [(primary.name(), times[row]), (other.name(), others[row])];
                contradiction(path, table.before() + row, told, leap)
            })?;
            if primary == TimeColumn::Utc {
                // A timestamp has one value for a whole leap second; the other column tells the times within.
                let is_within = |time: Tt2000| leap.through_timestamp(time) != time;
                let told = times.iter_mut().zip(&others).filter(|(time, other)| is_within(**other) && !is_within(**time));
                told.for_each(|(time, other)| *time = *other);
            }
        }
        Ok(times)
    }

    /// Whether two columns say the same; otherwise the first row in which they do not.
    fn agree(self, times: &[Tt2000], others: &[Tt2000], with_utc: bool, leap: &LeapSeconds) -> Result<(), usize> {
        let far = |a: Tt2000, b: Tt2000| (a - b).abs() > self.tolerance_ns;
        let differs = |(a, b): (&Tt2000, &Tt2000)| {
            far(*a, *b) && (!with_utc || far(leap.through_timestamp(*a), leap.through_timestamp(*b)))
        };
        times.iter().zip(others).position(differs).map_or(Ok(()), Err)
    }

    /// The ends of intervals: `{name}_tt2000`, or `{name}` as UTC; both must say the same.
    ///
    /// # Errors
    /// A table with neither, a time that is none, times that contradict each other, with the row.
    pub fn ends(self, table: &SeriesTable, name: &str, path: &Path, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
        let whole = format!("{name}_tt2000");
        let names = table.names();
        let has = |wanted: &str| names.iter().any(|own| own == wanted);
        if !has(&whole) {
            return table.utc(name, leap);
        }
        let times = table.tt2000(&whole)?;
        if has(name) {
            let others = table.utc(name, leap)?;
            self.agree(&times, &others, true, leap).map_err(|row| {
                contradiction(path, table.before() + row, [(whole.as_str(), times[row]), (name, others[row])], leap)
            })?;
        }
        Ok(times)
    }
}

fn contradiction(path: &Path, row: usize, told: [(&str, Tt2000); 2], leap: &LeapSeconds) -> Finding {
    let [(name, time), (other, otherwise)] = told.map(|(name, time)| (name, leap.utc(time)));
    let rule = format!("row {}: `{name}` says {time}, `{other}` {otherwise}", row + 1);
    let remedy = "say which one counts with [time] primary, and how far they may differ with tolerance_s";
    Finding::error(&path.display().to_string(), rule, remedy)
}
