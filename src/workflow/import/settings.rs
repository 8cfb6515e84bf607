//! Settings of a run: from columns of fields beside the readings, or from a table of settings.

use super::numbers::scaled;
use crate::data::error::{Finding, Severity};
use crate::data::run::Setting;
use crate::data::time::ns;
use crate::data::units::FieldCoil;
use crate::files::import::mapping::{FieldKeys, FieldScale};
use crate::files::import::{Dialect, ForeignTable, Mapping, time};
use std::ops::Range;

/// Fields beyond this are no fields of a coil system, nT.
const MOST_FIELD_NT: f64 = 1e7;

/// The field of every row, nT; NaN where none is stated.
#[derive(Clone, Debug)]
pub(super) struct Fields {
    pub nt: [Vec<f64>; 3],
    pub frequency_hz: Vec<f64>,
}

impl Fields {
    /// Reads the columns of a table.
    pub fn read(table: &ForeignTable, keys: &FieldKeys, columns: &[String; 3]) -> Result<Self, Finding> {
        let mut nt = [Vec::new(), Vec::new(), Vec::new()];
        for (axis, name) in columns.iter().enumerate() {
            let factor = match keys.scale {
                FieldScale::Same(factor) => factor,
                FieldScale::Current(each) => each[axis],
            };
            nt[axis] = table.numbers(name)?.into_iter().map(|v| scaled(v, factor)).collect();
            if let Some(row) = nt[axis].iter().position(|v| v.abs() > MOST_FIELD_NT) {
                let rule = format!("a field of {} nT cannot be", nt[axis][row]);
                return Err(table.refuse(row, Some(name), &rule, "correct the cell, or `unit` and `nt_per_a` under [field]"));
            }
        }
        let frequency_hz = match &keys.frequency {
            None => vec![0.0; table.rows()],
            Some(name) => table.numbers(name)?.into_iter().map(|f| if f.is_nan() { 0.0 } else { f }).collect(),
        };
        if let Some(row) = frequency_hz.iter().position(|f| *f < 0.0) {
            return Err(table.refuse(
                row,
                keys.frequency.as_deref(),
                "the frequency is negative",
                "write 0 for a constant field",
            ));
        }
        Ok(Self { nt, frequency_hz })
    }

    pub fn at(&self, row: usize) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.nt[axis][row])
    }

    /// Whether the row states its field.
    pub fn known(&self, row: usize) -> bool {
        self.at(row).iter().all(|v| v.is_finite())
    }
}

/// Settings with what a person should know about them.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub settings: Vec<Setting>,
    pub remarks: Vec<String>,
}

/// Rows in which the field stays where it is: settings of at least two rows. `rows` are those of the run in order, `t_s` their times, `period_s`
/// the time of a sample.
pub(super) fn from_columns(
    fields: &Fields,
    positions: &[u32],
    rows: &[usize],
    t_s: &[f64],
    period_s: f64,
    within_nt: f64,
) -> Found {
    let mut stretches: Vec<Range<usize>> = Vec::new();
    let mut begin = 0;
    for i in 1..=rows.len() {
        let same = i < rows.len() && {
            let (first, this) = (rows[begin], rows[i]);
            let near = |(a, b): (f64, f64)| (a - b).abs() <= within_nt || (a.is_nan() && b.is_nan());
            fields.at(first).into_iter().zip(fields.at(this)).all(near)
                && fields.frequency_hz[first] == fields.frequency_hz[this]
                && positions[first] == positions[this]
        };
        if !same {
            stretches.push(begin..i);
            begin = i;
        }
    }
    let mut found = Found::default();
    let mut alone = 0;
    for stretch in stretches {
        if !fields.known(rows[stretch.start]) {
            continue;
        }
        if stretch.len() < 2 {
            alone += 1;
            continue;
        }
        // The field changes somewhere between two samples; where samples are lost, at most half a period from the one that is there.
        let edge = |before: Option<f64>, after: Option<f64>, own: f64, out: f64| match (before, after) {
            (Some(b), Some(a)) if a - b <= 1.6 * period_s => 0.5 * (b + a),
            _ => own + out,
        };
        let time = |i: usize| t_s.get(i).copied();
        let (first, last) = (stretch.start, stretch.end - 1);
        let t_start_s = edge(first.checked_sub(1).and_then(time), time(first), t_s[first], -0.5 * period_s);
        let t_end_s = edge(time(last), time(last + 1), t_s[last], 0.5 * period_s);
        let field = [0, 1, 2].map(|axis| mean(stretch.clone().map(|i| fields.nt[axis][rows[i]])));
        let row = rows[first];
        found.settings.push(Setting {
            t_start_s: round_ns(t_start_s),
            t_end_s: round_ns(t_end_s),
            field: FieldCoil(field),
            frequency_hz: fields.frequency_hz[row],
            position: positions[row],
        });
    }
    if alone > 0 {
        found
            .remarks
            .push(format!("{alone} rows have a field that no neighbour has within {within_nt} nT; they belong to no setting"));
    }
    found
}

/// Times are whole ns.
fn round_ns(t_s: f64) -> f64 {
    (t_s * 1e9).round() / 1e9
}

/// The mean, exact where all values are equal.
fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let first = values.clone().next().unwrap_or(f64::NAN);
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + (v - first), count + 1.0));
    let mean = first + sum / count;
    // What a source reads back has no more digits than this.
    if sum == 0.0 { first } else { (mean * 1e6).round() / 1e6 }
}

/// A table of settings; its times are seconds since the run's start, or tell the date.
pub(super) struct SettingsTable {
    table: ForeignTable,
    /// Begin and end, ns, and whether they tell the date.
    times: Vec<[i64; 2]>,
    absolute: bool,
    fields: Fields,
    positions: Option<Vec<u32>>,
}

impl SettingsTable {
    /// Reads it; columns that are not used go to `findings`.
    pub fn read(mapping: &Mapping, keys: &FieldKeys, findings: &mut Vec<Finding>) -> Result<Option<Self>, Finding> {
        let Some(path) = &keys.table else { return Ok(None) };
        let dialect = Dialect { separator: None, skip_rows: 0, ..mapping.dialect.clone() };
        let table = ForeignTable::read(path, None, &dialect)?;
        let columns = keys.columns.clone().unwrap_or_else(|| ["bx", "by", "bz"].map(str::to_owned));
        let frequency = keys.frequency.clone().or_else(|| table.has("frequency").then(|| "frequency".to_owned()));
        let fields = Fields::read(&table, &FieldKeys { frequency: frequency.clone(), ..keys.clone() }, &columns)?;
        let positions = if table.has("position") { Some(whole(&table, "position")?) } else { None };
        let (begins, absolute) = moments(&table, "t_start", mapping)?;
        let ends = if table.has("t_end") {
            let (ends, also) = moments(&table, "t_end", mapping)?;
            if also != absolute {
                let rule = "t_start and t_end are not written in the same way";
                return Err(table.refuse(
                    0,
                    Some("t_end"),
                    rule,
                    "write both as seconds since the run's start, or both with the date",
                ));
            }
            ends
        } else {
            let durations = table.numbers("duration")?;
            begins.iter().zip(durations).map(|(b, d)| b + ns(d)).collect()
        };
        let times: Vec<[i64; 2]> = begins.into_iter().zip(ends).map(|(b, e)| [b, e]).collect();
        check(&table, &times, &fields)?;
        let known = ["t_start", "t_end", "duration", "frequency", "position"];
        let unknown: Vec<&String> = table
            .names()
            .iter()
            .filter(|n| !known.contains(&n.as_str()) && !columns.contains(n) && frequency.as_ref() != Some(n) && !n.is_empty())
            .collect();
        if !unknown.is_empty() {
            findings.push(super::unused(table.file(), &unknown));
        }
        Ok(Some(Self { table, times, absolute, fields, positions }))
    }

    /// File and hash, for the head of the run.
    pub fn told(&self) -> String {
        format!("{} (sha256 {})", self.table.file(), self.table.digested.sha256)
    }

    /// The settings of a run that began at `start_ns` and whose readings go from the first to the last of `span_ns`.
    pub fn of_run(
        &self,
        start_ns: i64,
        span_ns: [i64; 2],
        default_position: u32,
        findings: &mut Vec<Finding>,
    ) -> Result<Vec<Setting>, Finding> {
        let base = if self.absolute { start_ns } else { 0 };
        let span = span_ns.map(|t| t - start_ns);
        let (mut settings, mut outside) = (Vec::new(), Vec::new());
        for (row, [begin, end]) in self.times.iter().enumerate() {
            let (begin, end) = (begin - base, end - base);
            if end <= span[0] || begin >= span[1] {
                outside.push(row);
                continue;
            }
            settings.push(Setting {
                t_start_s: begin as f64 / 1e9,
                t_end_s: end as f64 / 1e9,
                field: FieldCoil(self.fields.at(row)),
                frequency_hz: self.fields.frequency_hz[row],
                position: self.positions.as_ref().map_or(default_position, |p| p[row]),
            });
        }
        let times =
            format!("the readings go from {:.3} s to {:.3} s after the run's start", span[0] as f64 / 1e9, span[1] as f64 / 1e9);
        if let Some(row) = outside.first() {
            let rule = format!("{} of {} settings lie outside of the readings; {times}", outside.len(), self.times.len());
            let remedy = "compare the times of both tables; `start` and `zone` of the mapping hold for both";
            let finding = self.table.refuse(*row, None, &rule, remedy);
            if settings.is_empty() {
                return Err(finding);
            }
            findings.push(finding.weighing(Severity::Warning));
        }
        Ok(settings)
    }

    /// Whether its times tell the date.
    pub fn is_absolute(&self) -> bool {
        self.absolute
    }

    /// Its file.
    pub fn file(&self) -> &str {
        self.table.file()
    }
}

/// Order and completeness of settings.
fn check(table: &ForeignTable, times: &[[i64; 2]], fields: &Fields) -> Result<(), Finding> {
    /// Printed times may overlap by their last digit, ns.
    const ROUNDING: i64 = 1_000_000;
    for (row, [begin, end]) in times.iter().enumerate() {
        let rule = if !fields.known(row) {
            "the setting has no field"
        } else if end <= begin {
            "the setting ends before it begins"
        } else if row > 0 && *begin < times[row - 1][0] {
            "the setting begins before the one above it"
        } else if row > 0 && *begin < times[row - 1][1] - ROUNDING {
            "the setting begins before the one above it ends"
        } else {
            continue;
        };
        return Err(table.refuse(row, None, rule, "put the settings in order of time and repair overlaps"));
    }
    Ok(())
}

/// A column of times of a table of settings.
fn moments(table: &ForeignTable, column: &str, mapping: &Mapping) -> Result<(Vec<i64>, bool), Finding> {
    let texts = table.texts(column)?;
    let (mut all, mut first) = (Vec::with_capacity(texts.len()), None);
    for (row, text) in texts.iter().enumerate() {
        let number = table.number(row, column, text).ok().filter(|v| v.is_finite());
        let text = number.map_or_else(|| text.clone(), |v| v.to_string());
        let (ns, absolute) = time::one(&text, mapping.time.format.as_ref(), &mapping.time.zone)
            .map_err(|(rule, remedy)| table.refuse(row, Some(column), &rule, &remedy))?;
        if *first.get_or_insert(absolute) != absolute {
            let rule = "the time is not written as that of the first setting";
            return Err(table.refuse(
                row,
                Some(column),
                rule,
                "write all as seconds since the run's start, or all with the date",
            ));
        }
        all.push(ns);
    }
    Ok((all, first.unwrap_or(false)))
}

/// Whole numbers of a column.
pub(super) fn whole(table: &ForeignTable, column: &str) -> Result<Vec<u32>, Finding> {
    let one = |(row, v): (usize, f64)| {
        let is_whole = v >= 0.0 && v.fract() == 0.0 && v <= f64::from(u32::MAX);
        let rule = "the cell must be a whole number, 0 or more";
        if is_whole { Ok(v as u32) } else { Err(table.refuse(row, Some(column), rule, "repair the value")) }
    };
    table.numbers(column)?.into_iter().enumerate().map(one).collect()
}
