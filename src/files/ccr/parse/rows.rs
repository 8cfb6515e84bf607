//! The rows of the sections of a run file.

use super::{Parser, Stop};
use crate::data::error::Finding;
use crate::data::run::{GivenBlock, ScalarRow, Setting, VectorSink};
use crate::data::units::{FieldCoil, Reading};
use crate::files::ccr::Section;
use crate::files::ccr::vectors::{Row, Tick};
use crate::files::text::{Cell, not_a_number, number};

impl<S: VectorSink> Parser<'_, S> {
    pub(super) fn row(&mut self, section: Section, line: &[u8]) -> Result<(), Stop> {
        let mut cells = Vec::with_capacity(self.columns.names.len());
        self.columns.row(self.file, self.line, line, section.name(), &mut cells)?;
        match section {
            Section::Vectors => self.careful_row(line, &cells),
            Section::Fields => self.setting_row(line, &cells),
            Section::Blocks => self.block_row(line, &cells),
            Section::Temperatures | Section::Channels => self.slow_row(section, line, &cells),
            Section::Scalar => self.scalar_row(&cells),
        }
    }

    fn number(&self, row: &[Cell], wanted: usize) -> Result<f64, Stop> {
        Ok(self.columns.required(self.file, self.line, row, wanted)?)
    }

    fn numbers<const N: usize>(&self, row: &[Cell], first: usize) -> Result<[f64; N], Stop> {
        let mut out = [0.0; N];
        for (i, value) in out.iter_mut().enumerate() {
            *value = self.number(row, first + i)?;
        }
        Ok(out)
    }

    fn whole(&self, row: &[Cell], wanted: usize) -> Result<u64, Stop> {
        let value = self.number(row, wanted)?;
        if value < 0.0 || value.fract() != 0.0 || value >= 1e15 {
            let at = self.columns.wanted.get(wanted).copied().flatten().unwrap_or_default();
            let name = self.columns.names.get(at).map_or("?", String::as_str);
            let finding =
                Finding::error(self.file, format!("column `{name}` must be a whole number, 0 or more"), "repair the value");
            return Err(match row.get(at) {
                Some(cell) => finding.at(self.line, cell.column).found(cell.text),
                None => finding.at(self.line, 1),
            }
            .into());
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked just above")]
        Ok(value as u64)
    }

    fn bad_row(&self, line: &[u8], rule: impl Into<Box<str>>, remedy: &str) -> Stop {
        Finding::error(self.file, rule, remedy).at(self.line, 1).found(line).into()
    }

    fn careful_row(&mut self, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let n = self.whole(cells, 0)?;
        let t_s = self.number(cells, 1)?;
        let reading = self.numbers(cells, 2)?;
        let at = self.columns.wanted.get(1).copied().flatten().unwrap_or_default();
        let tag = cells.get(at).map_or(&b""[..], |cell| cell.text);
        let decimals = tag.iter().position(|b| *b == b'.').map_or(0, |point| tag.len() - point - 1);
        let row = Row { n, t_s, t_decimals: decimals.min(12) as u32, reading };
        match self.clock.tick(&row, self.line) {
            Tick::Sample(t_s) => {
                self.deliver(&row, t_s);
                Ok(())
            }
            tick => self.refuse(tick, line),
        }
    }

    /// A row at which the clock stopped.
    #[cold]
    pub(super) fn refuse(&mut self, tick: Tick, line: &[u8]) -> Result<(), Stop> {
        const CLOCK_REMEDY: &str = "split files that were joined, or sort out the clock reset";
        match tick {
            Tick::Sample(_) | Tick::Duplicate => Ok(()),
            Tick::CounterBack { from, to } => {
                Err(self.bad_row(line, format!("the sample counter goes back from {from} to {to}"), CLOCK_REMEDY))
            }
            Tick::TimeBack { from_s, to_s } => {
                Err(self.bad_row(line, format!("time goes back from {from_s} s to {to_s} s"), CLOCK_REMEDY))
            }
            // A wrong rate comes to light over and over again; it is one fault.
            Tick::Disagrees { .. } if self.rate_disagrees => Ok(()),
            Tick::Disagrees { by_s, rate_hz } => {
                self.rate_disagrees = true;
                let nominal = self.header.as_ref().map_or(0.0, |h| h.sample_rate_hz);
                Err(self.bad_row(
                    line,
                    format!("the time tag is {by_s:+.4} s away from the sample counter at {nominal} Hz (so far {rate_hz:.4} Hz)"),
                    "correct `sample_rate`, or repair counter or time tags",
                ))
            }
        }
    }

    fn setting_row(&mut self, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let [t_start_s, t_end_s, bx, by, bz, frequency_hz] = self.numbers(cells, 0)?;
        let setting =
            Setting { t_start_s, t_end_s, field: FieldCoil([bx, by, bz]), frequency_hz, position: self.position(cells, 6)? };
        self.check_times(line, &setting, self.settings.last().map(|s| s.t_end_s))?;
        if frequency_hz < 0.0 {
            return Err(self.bad_row(line, "the frequency is negative", "write 0 for a constant field"));
        }
        self.settings.push(setting);
        Ok(())
    }

    fn position(&self, cells: &[Cell], wanted: usize) -> Result<u32, Stop> {
        // An id beyond 32 bits cannot be in any position table.
        Ok(u32::try_from(self.whole(cells, wanted)?).unwrap_or(u32::MAX))
    }

    fn check_times(&self, line: &[u8], setting: &Setting, previous_end_s: Option<f64>) -> Result<(), Stop> {
        // Printed times may overlap by their last digit.
        const ROUNDING_S: f64 = 1e-3;
        if setting.t_end_s <= setting.t_start_s {
            return Err(self.bad_row(line, "the setting ends before it begins", "repair t_start and t_end"));
        }
        match previous_end_s {
            Some(end_s) if setting.t_start_s < end_s - ROUNDING_S => Err(self.bad_row(
                line,
                format!("the setting begins at {} s, before the one above it ends at {end_s} s", setting.t_start_s),
                "put the settings in order of time and repair overlaps",
            )),
            _ => Ok(()),
        }
    }

    fn block_row(&mut self, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let [t_start_s, t_end_s, bx, by, bz] = self.numbers(cells, 0)?;
        let setting =
            Setting { t_start_s, t_end_s, field: FieldCoil([bx, by, bz]), frequency_hz: 0.0, position: self.position(cells, 5)? };
        self.check_times(line, &setting, self.blocks.last().map(|b| b.setting.t_end_s))?;
        let scaled = |v: [f64; 3]| v.map(|c| c * self.scale);
        let mean = Reading(scaled(self.numbers(cells, 6)?));
        let has = |wanted: usize| self.columns.wanted.get(wanted).copied().flatten().is_some();
        let std_ent = if has(9) && has(10) && has(11) { Some(scaled(self.numbers(cells, 9)?)) } else { None };
        if std_ent.is_some_and(|s| s.iter().any(|v| *v < 0.0)) {
            return Err(self.bad_row(line, "a standard deviation is negative", "repair the value"));
        }
        let count = if has(12) { Some(self.whole(cells, 12)?) } else { None };
        self.blocks.push(GivenBlock { setting, mean, std_ent, count });
        Ok(())
    }

    fn slow_row(&mut self, section: Section, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let t_s = self.number(cells, 0)?;
        let t_at = self.columns.wanted.first().copied().flatten().unwrap_or_default();
        let table = if section == Section::Temperatures { &self.temperatures } else { &self.channels };
        if let Some(before) = table.t_s.last().filter(|before| t_s < **before) {
            return Err(self.bad_row(
                line,
                format!("time goes back from {before} s to {t_s} s"),
                "put the rows in order of time",
            ));
        }
        let mut values = Vec::with_capacity(cells.len());
        for (i, cell) in cells.iter().enumerate().filter(|(i, _)| *i != t_at) {
            if cell.text.is_empty() {
                values.push(f64::NAN);
            } else {
                let name = self.columns.names.get(i).map_or("?", String::as_str);
                values.push(number(cell.text).ok_or_else(|| not_a_number(self.file, self.line, *cell, name))?);
            }
        }
        let table = if section == Section::Temperatures { &mut self.temperatures } else { &mut self.channels };
        table.t_s.push(t_s);
        for (column, value) in table.values.iter_mut().zip(values) {
            column.push(value);
        }
        Ok(())
    }

    fn scalar_row(&mut self, cells: &[Cell]) -> Result<(), Stop> {
        let [t_s, bx, by, bz, modulus_nt] = self.numbers(cells, 0)?;
        self.scalar.push(ScalarRow { t_s, setting: [bx, by, bz], modulus_nt });
        Ok(())
    }
}
