//! One run of a table: its samples or plateau means, settings and slow channels.

use super::clock::{Samples, agrees, from_times, since_first};
use super::columns::{Columns, Slow};
use super::settings::{Found, SettingsTable, from_columns};
use crate::data::error::{Finding, Severity};
use crate::data::run::{GivenBlock, Kind, ReadingUnit, Setting, SlowTable, Vector};
use crate::data::units::{FieldCoil, Reading, counted};
use crate::files::import::mapping::RowsAre;
use crate::files::import::{ForeignTable, Mapping};

/// A table with all that belongs to its runs.
pub(super) struct Source<'a> {
    pub table: &'a ForeignTable,
    pub mapping: &'a Mapping,
    pub columns: &'a Columns,
    pub settings: Option<&'a SettingsTable>,
}

/// Everything of a run but its head.
#[derive(Clone, Debug, Default)]
pub(super) struct Content {
    pub settings: Vec<Setting>,
    pub blocks: Vec<GivenBlock>,
    pub vectors: Vec<Vector>,
    /// Rows of the table, one per vector or block.
    pub rows: Vec<usize>,
    pub temperatures: SlowTable,
    pub channels: SlowTable,
    pub rate_hz: f64,
    /// What was done, for the head of the file.
    pub remarks: Vec<String>,
}

impl Source<'_> {
    /// Seconds since the run's start.
    fn seconds(ns: i64, start_ns: i64) -> f64 {
        (ns - start_ns) as f64 / 1e9
    }

    /// The content of a run that begins at `start_ns` and has these rows of the table.
    pub fn content(
        &self,
        rows: std::ops::Range<usize>,
        start_ns: i64,
        kind: Kind,
        unit: ReadingUnit,
        findings: &mut Vec<Finding>,
    ) -> Result<Content, Finding> {
        self.order(rows.clone())?;
        let there: Vec<usize> = rows.clone().filter(|row| self.columns.reading(*row).is_some()).collect();
        let Some(first) = there.first().copied() else {
            return Err(self.table.refuse(
                rows.start,
                None,
                "no row of the run has a reading",
                "correct `columns` under [reading]",
            ));
        };
        let mut content = match self.mapping.rows {
            RowsAre::Samples => self.samples(&there, start_ns, kind, unit, findings)?,
            RowsAre::Plateaus { .. } => self.plateaus(&there, start_ns, unit)?,
        };
        let without = rows.len() - there.len();
        if without > 0 {
            let row = rows.clone().find(|row| self.columns.reading(*row).is_none()).unwrap_or(first);
            let rule = format!("{without} of {} rows have no reading and were left out, this one first", rows.len());
            findings.push(self.table.refuse(row, None, &rule, "see whether readings are missing").weighing(Severity::Warning));
            content
                .remarks
                .push(format!("{without} rows without a reading were left out, the first of them {}", self.table.row_name(row)));
        }
        // The mean of a plateau belongs to its middle.
        let ends: Option<Vec<f64>> = (!content.blocks.is_empty())
            .then(|| content.blocks.iter().map(|b| 0.5 * (b.setting.t_start_s + b.setting.t_end_s)).collect());
        let slow_rows: Vec<usize> = if ends.is_some() { content.rows.clone() } else { rows.collect() };
        let at: Vec<f64> =
            ends.unwrap_or_else(|| slow_rows.iter().map(|row| Self::seconds(self.columns.times.ns[*row], start_ns)).collect());
        content.temperatures = slow_table(&self.columns.temperatures, &slow_rows, &at);
        content.channels = slow_table(&self.columns.channels, &slow_rows, &at);
        Ok(content)
    }

    /// Times must not go back.
    fn order(&self, rows: std::ops::Range<usize>) -> Result<(), Finding> {
        let ns = &self.columns.times.ns;
        for row in rows.start + 1..rows.end {
            if ns[row] < ns[row - 1] {
                let back = (ns[row - 1] - ns[row]) as f64 / 1e9;
                let rule = format!("time goes back by {back} s from the row above");
                let remedy =
                    "sort the rows, split files that were joined (`split_column`), or correct `format` and `zone` under [time]";
                return Err(self.table.refuse(row, Some(&self.mapping.time.column), &rule, remedy));
            }
        }
        Ok(())
    }

    fn samples(
        &self,
        rows: &[usize],
        start_ns: i64,
        kind: Kind,
        unit: ReadingUnit,
        findings: &mut Vec<Finding>,
    ) -> Result<Content, Finding> {
        let ns: Vec<i64> = rows.iter().map(|row| self.columns.times.ns[*row]).collect();
        let given = self.mapping.run.sample_rate_hz;
        let file = self.table.file();
        let (clock, how) = match &self.columns.counter {
            None => (from_times(file, &ns, given)?, "from the times".to_owned()),
            Some(counter) => {
                let n: Vec<u64> = rows.iter().map(|row| counter[*row]).collect();
                self.counted(rows, n, &ns, given)?
            }
        };
        let rows = self.once(rows, &clock, &ns, findings)?;
        let t_s: Vec<f64> = rows.iter().map(|(_, i)| Self::seconds(ns[*i], start_ns)).collect();
        let scale = unit.ent_per_unit();
        let vectors: Vec<Vector> = rows
            .iter()
            .zip(&t_s)
            .map(|((row, i), t_s)| {
                let reading = Reading([0, 1, 2].map(|c| self.columns.readings[c][*row] * scale));
                Vector { n: clock.n[*i], t_s: *t_s, reading }
            })
            .collect();
        let lost = vectors.last().zip(vectors.first()).map_or(0, |(last, first)| last.n - first.n + 1 - vectors.len() as u64);
        if lost as f64 > vectors.len() as f64 {
            let rule = format!("{lost} of {} samples would be missing at {} Hz", lost + vectors.len() as u64, clock.rate_hz);
            let remedy =
                "correct `sample_rate`, or set `are = \"plateaus\"` under [rows] if the rows are means; `split_gap_s` parts runs";
            return Err(Finding::error(file, rule, remedy));
        }
        let missing = |pair: &[(usize, usize)]| (pair[1].0, clock.n[pair[1].1] - clock.n[pair[0].1] - 1);
        let gaps: Vec<(usize, u64)> = rows.windows(2).map(missing).filter(|(_, samples)| *samples > 0).collect();
        if let Some((row, samples)) = gaps.first() {
            let are = if *samples == 1 { "is" } else { "are" };
            let mut rule = format!("{} {are} missing before this row", counted(*samples, "sample"));
            if gaps.len() > 1 {
                rule.push_str(&format!(", and {} in {} behind it", lost - samples, counted(gaps.len() as u64 - 1, "gap")));
            }
            let remedy = "see whether the recording lost them; `split_gap_s` under [run] parts runs";
            findings.push(self.table.refuse(*row, None, &rule, remedy).weighing(Severity::Warning));
        }
        let mut remarks = vec![format!(
            "sample counter {how}; {} Hz nominal, {:.6} Hz by the times; {lost} samples lost",
            clock.rate_hz, clock.measured_hz
        )];
        if let Some(step_s) = clock.coarse_s {
            remarks.push(format!(
                "the time column has steps of {step_s} s, longer than a sample: losses within a step cannot be seen"
            ));
        }
        let row_list: Vec<usize> = rows.iter().map(|(row, _)| *row).collect();
        let smooth_s: Vec<f64> = rows.iter().map(|(_, i)| (clock.smooth_ns[*i] + (ns[0] - start_ns) as f64) / 1e9).collect();
        let found =
            self.settings_of(&row_list, &smooth_s, start_ns, [ns[0], ns[ns.len() - 1]], kind, 1.0 / clock.rate_hz, findings)?;
        remarks.extend(found.remarks.iter().cloned());
        for remark in &found.remarks {
            findings.push(
                Finding::error(file, remark.clone(), "see `same_setting_within_nt` under [field]").weighing(Severity::Warning),
            );
        }
        Ok(Content { settings: found.settings, vectors, rows: row_list, rate_hz: clock.rate_hz, remarks, ..Content::default() })
    }

    /// A counter of the table, which must go on and go with the times.
    fn counted(&self, rows: &[usize], n: Vec<u64>, ns: &[i64], given: Option<f64>) -> Result<(Samples, String), Finding> {
        let name = self.mapping.time.counter.as_deref();
        for i in 1..n.len() {
            if n[i] < n[i - 1] {
                let rule = format!("the sample counter goes back from {} to {}", n[i - 1], n[i]);
                return Err(self.table.refuse(
                    rows[i],
                    name,
                    &rule,
                    "split files that were joined, or take `counter` out of [time]",
                ));
            }
        }
        let (samples, span_ns) = (n[n.len() - 1] - n[0], ns[ns.len() - 1] - ns[0]);
        if samples == 0 || span_ns == 0 {
            let rule = "counter or times are the same in all rows";
            return Err(self.table.refuse(rows[0], name, rule, "name another column as `counter`, or none, under [time]"));
        }
        let measured_hz = samples as f64 / (span_ns as f64 / 1e9);
        let rate_hz = given.unwrap_or_else(|| super::clock::nominal(measured_hz));
        agrees(self.table.file(), rate_hz, measured_hz)?;
        // The counter counts samples if the times, looked at alone, have the same rate.
        let alone = super::clock::measured_hz(ns);
        if alone.is_some_and(|alone| (alone / measured_hz - 1.0).abs() > 0.2) {
            let rule = format!("the counter runs at {measured_hz:.4} Hz, and the rows come at {:.4} Hz", alone.unwrap_or(0.0));
            return Err(self.table.refuse(rows[0], name, &rule, "name another column as `counter`, or none, under [time]"));
        }
        let smooth_ns = since_first(ns);
        Ok((
            Samples { n, smooth_ns, rate_hz, measured_hz, coarse_s: None },
            format!("from column `{}`", name.unwrap_or_default()),
        ))
    }

    /// Rows with their index in the clock, without repetitions. A sample that stands twice with two readings is refused.
    fn once(
        &self,
        rows: &[usize],
        clock: &Samples,
        ns: &[i64],
        findings: &mut Vec<Finding>,
    ) -> Result<Vec<(usize, usize)>, Finding> {
        let mut kept: Vec<(usize, usize)> = Vec::with_capacity(rows.len());
        let mut repeated = Vec::new();
        for (i, row) in rows.iter().enumerate() {
            match kept.last() {
                Some((before, j)) if clock.n[*j] == clock.n[i] => {
                    if self.columns.reading(*before) != self.columns.reading(*row) {
                        let rule = format!(
                            "the row has the {} of the row above, and other readings",
                            if ns[i] == ns[*j] { "time" } else { "counter" }
                        );
                        return Err(self.table.refuse(
                            *row,
                            Some(&self.mapping.time.column),
                            &rule,
                            "take one of the two rows out",
                        ));
                    }
                    repeated.push(*row);
                }
                _ => kept.push((*row, i)),
            }
        }
        if let Some(row) = repeated.first() {
            let rule = format!("{} rows repeat the row above them, this one first; they were left out", repeated.len());
            findings.push(self.table.refuse(*row, None, &rule, "see how the file was written").weighing(Severity::Warning));
        }
        Ok(kept)
    }

    #[expect(clippy::too_many_arguments, reason = "what settings are made of")]
    fn settings_of(
        &self,
        rows: &[usize],
        t_s: &[f64],
        start_ns: i64,
        span_ns: [i64; 2],
        kind: Kind,
        period_s: f64,
        findings: &mut Vec<Finding>,
    ) -> Result<Found, Finding> {
        if let (Some(fields), Some(keys)) = (&self.columns.fields, &self.mapping.field) {
            let found = from_columns(fields, &self.columns.positions, rows, t_s, period_s, keys.same_setting_within_nt);
            if found.settings.is_empty() {
                let rule = "no two rows in a row have the same field, so that there is no setting";
                let remedy = "raise `same_setting_within_nt` under [field], or set `are = \"plateaus\"` under [rows]";
                return Err(self.table.refuse(rows[0], None, rule, remedy));
            }
            let moves =
                || rows.windows(2).any(|w| fields.known(w[0]) && fields.known(w[1]) && fields.at(w[0]) != fields.at(w[1]));
            if found.settings.len() == 1 && kind != Kind::ZeroField && moves() {
                let rule = format!("all fields are within {} nT, and make one setting", keys.same_setting_within_nt);
                let remedy = "correct `unit` under [field], or lower `same_setting_within_nt`";
                return Err(self.table.refuse(rows[0], None, &rule, remedy));
            }
            // Steps between every two or three samples are the noise of a source that is read back, not a programme.
            if rows.len() > 20 && found.settings.len() * 4 > rows.len() {
                let rule =
                    format!("{} settings in {} rows: the field changes almost with every row", found.settings.len(), rows.len());
                let remedy = "raise `same_setting_within_nt` under [field], or set `are = \"plateaus\"` under [rows]";
                return Err(self.table.refuse(rows[0], None, &rule, remedy));
            }
            return Ok(found);
        }
        let position = rows.first().map_or(1, |row| self.columns.positions[*row]);
        if let Some(table) = self.settings {
            let settings = table.of_run(start_ns, span_ns, position, findings)?;
            return Ok(Found { settings, remarks: Vec::new() });
        }
        if kind != Kind::ZeroField {
            let rule = format!("a run of the kind {kind} needs the applied field");
            return Err(Finding::error(self.table.file(), rule, "add [field] to the mapping, or set `kind = \"zero-field\"`"));
        }
        let (first, last) = (t_s.first().copied().unwrap_or(0.0), t_s.last().copied().unwrap_or(0.0));
        let whole = Setting {
            t_start_s: (first - 0.5 * period_s).max(0.0),
            t_end_s: last + 0.5 * period_s,
            field: FieldCoil([0.0; 3]),
            frequency_hz: 0.0,
            position,
        };
        Ok(Found {
            settings: vec![whole],
            remarks: vec!["no field is stated: one setting of zero field from the first to the last row".to_owned()],
        })
    }

    fn plateaus(&self, rows: &[usize], start_ns: i64, unit: ReadingUnit) -> Result<Content, Finding> {
        let Some(fields) = &self.columns.fields else {
            let rule = "plateau means need the columns of the applied field";
            return Err(Finding::error(self.table.file(), rule, "add [field] to the mapping"));
        };
        let (ends, mut remarks) = self.plateau_ends(rows)?;
        let mut content = Content::default();
        let scale = unit.ent_per_unit();
        for (row, end) in rows.iter().zip(ends) {
            if !fields.known(*row) {
                let remedy = "write the field, or take the row out";
                return Err(self.table.refuse(*row, None, "the plateau has no field", remedy));
            }
            let three = |columns: &[Vec<f64>; 3]| [0, 1, 2].map(|i| columns[i][*row] * scale);
            let std_ent = self.columns.std.as_ref().map(three);
            if std_ent.is_some_and(|s| s.iter().any(|v| v.is_nan() || *v < 0.0)) {
                let rule = "a standard deviation is missing or negative";
                return Err(self.table.refuse(*row, None, rule, "correct it, or take `std` and `count` out of [reading]"));
            }
            let setting = Setting {
                t_start_s: Self::seconds(self.columns.times.ns[*row], start_ns),
                t_end_s: Self::seconds(end, start_ns),
                field: FieldCoil(fields.at(*row)),
                frequency_hz: 0.0,
                position: self.columns.positions[*row],
            };
            let count = self.columns.count.as_ref().map(|c| u64::from(c[*row]));
            content.blocks.push(GivenBlock { setting, mean: Reading(three(&self.columns.readings)), std_ent, count });
            content.rows.push(*row);
        }
        content.rate_hz = self.mapping.run.sample_rate_hz.unwrap_or(1.0);
        if self.mapping.run.sample_rate_hz.is_none() {
            remarks
                .push("the rows are means of plateaus; their sample rate is not known, and sample_rate is a stand-in".to_owned());
        }
        content.remarks = remarks;
        Ok(content)
    }

    /// Ends of plateaus: as the table says, or the next begin; before a pause the usual length.
    fn plateau_ends(&self, rows: &[usize]) -> Result<(Vec<i64>, Vec<String>), Finding> {
        /// A plateau that would be so many times as long as usual ends before a pause.
        const PAUSE: i64 = 2;
        let ns = &self.columns.times.ns;
        let time = &self.mapping.time.column;
        if let Some(row) = rows.windows(2).find(|w| ns[w[1]] == ns[w[0]]).map(|w| w[1]) {
            return Err(self.table.refuse(
                row,
                Some(time),
                "two plateaus begin at the same time",
                "take one of the two rows out",
            ));
        }
        if let Some(ends) = &self.columns.ends {
            for (i, row) in rows.iter().enumerate() {
                let next = rows.get(i + 1).map(|r| ns[*r]);
                let rule = if ends[*row] <= ns[*row] {
                    "the plateau ends before it begins"
                } else if next.is_some_and(|next| next < ends[*row]) {
                    "the plateau ends after the next one begins"
                } else {
                    continue;
                };
                return Err(self.table.refuse(*row, None, rule, "correct `t_start` and `t_end` under [rows], or the times"));
            }
            return Ok((
                rows.iter().map(|row| ends[*row]).collect(),
                vec!["begin and end of the plateaus from their columns".to_owned()],
            ));
        }
        let mut lengths: Vec<i64> = rows.windows(2).map(|w| ns[w[1]] - ns[w[0]]).collect();
        lengths.sort_unstable();
        let Some(usual) = lengths.get(lengths.len() / 2).copied() else {
            let rule = "the end of a single plateau is not known";
            return Err(self.table.refuse(rows[0], Some(time), rule, "name its column as `t_end` under [rows]"));
        };
        let mut pauses = 0;
        let ends = (0..rows.len())
            .map(|i| {
                let begin = ns[rows[i]];
                match rows.get(i + 1).map(|next| ns[*next]) {
                    Some(next) if next - begin <= PAUSE * usual => next,
                    Some(_) => {
                        pauses += 1;
                        begin + usual
                    }
                    None => begin + usual,
                }
            })
            .collect();
        let usual_s = usual as f64 / 1e9;
        let mut remark = format!("a plateau lasts from its time to that of the next row, the last one {usual_s} s");
        if pauses > 0 {
            remark += &format!("; {pauses} plateaus before pauses were given the usual {usual_s} s as well");
        }
        Ok((ends, vec![remark]))
    }
}

/// A table of slow channels, without rows in which all cells are empty.
fn slow_table(channels: &[Slow], rows: &[usize], t_s: &[f64]) -> SlowTable {
    let mut table = SlowTable {
        names: channels.iter().map(|c| c.name.clone()).collect(),
        t_s: Vec::new(),
        values: vec![Vec::new(); channels.len()],
    };
    for (row, t) in rows.iter().zip(t_s) {
        if channels.iter().any(|c| c.values[*row].is_finite()) {
            table.t_s.push(*t);
            channels.iter().zip(&mut table.values).for_each(|(c, column)| column.push(c.values[*row]));
        }
    }
    table
}
