//! The writer of run files.

use super::Section;
use crate::formats::text::fixed;
use crate::run::{GivenBlock, Header, ReadingUnit, Setting, SlowTable, Vector};
use std::io::{self, Write};

/// Decimals of the numbers that are written.
#[derive(Clone, Copy, Debug)]
pub struct Decimals {
    /// Time, s.
    pub time: usize,
    /// Field, nT.
    pub field: usize,
    /// Readings in the unit of the header.
    pub reading: usize,
    /// Slow channels.
    pub slow: usize,
}

impl Default for Decimals {
    fn default() -> Self {
        Self { time: 4, field: 2, reading: 3, slow: 3 }
    }
}

fn quoted(text: &str) -> String {
    toml_edit::Value::from(text).to_string().trim().to_owned()
}

/// The magic line and the keys of a run file.
fn write_header(out: &mut impl Write, header: &Header) -> io::Result<()> {
    writeln!(out, "CCR 1")?;
    for (key, value) in [("run", &header.run), ("start", &header.start)] {
        writeln!(out, "{key} = {}", quoted(value))?;
    }
    writeln!(out, "kind = \"{}\"", header.kind)?;
    for (key, value) in [("configuration", &header.configuration), ("sensor", &header.sensor), ("mode", &header.mode)] {
        if !value.is_empty() {
            writeln!(out, "{key} = {}", quoted(value))?;
        }
    }
    writeln!(out, "sample_rate = {:?}", header.sample_rate_hz)?;
    match header.unit {
        ReadingUnit::Ent => writeln!(out, "unit = \"enT\"")?,
        ReadingUnit::Counts { ent_per_count } => {
            writeln!(out, "unit = \"counts\"\nnominal_factor = {ent_per_count:?}")?;
        }
    }
    if !header.field_source.is_empty() {
        writeln!(out, "field_source = {}", quoted(&header.field_source))?;
    }
    if let Some(used) = header.coil_correction {
        writeln!(out, "coil_correction = {used}")?;
    }
    if !header.earthfield_compensation.is_empty() {
        let axes: Vec<String> = header.earthfield_compensation.iter().map(|a| quoted(a)).collect();
        writeln!(out, "earthfield_compensation = [{}]", axes.join(", "))?;
    }
    Ok(())
}

/// Writes a run file section by section; [`Writer::end`] completes it.
pub struct Writer<W: Write> {
    out: W,
    decimals: Decimals,
    units_per_ent: f64,
}

impl<W: Write> Writer<W> {
    /// Begins with the keys.
    ///
    /// # Errors
    /// What the writer says.
    pub fn new(mut out: W, header: &Header, decimals: Decimals) -> io::Result<Self> {
        write_header(&mut out, header)?;
        Ok(Self { out, decimals, units_per_ent: 1.0 / header.unit.ent_per_unit() })
    }

    fn row(&mut self, cells: &[String]) -> io::Result<()> {
        writeln!(self.out, "{}", cells.join(","))
    }

    fn names(&mut self, section: Section, count: usize) -> io::Result<()> {
        let (columns, _) = section.columns();
        writeln!(self.out, "{}\n{}", section.name(), columns.get(..count).unwrap_or(columns).join(","))
    }

    fn setting(&self, s: &Setting) -> Vec<String> {
        let d = self.decimals;
        let mut cells = vec![fixed(s.t_start_s, d.time), fixed(s.t_end_s, d.time)];
        cells.extend(s.field.0.iter().map(|b| fixed(*b, d.field)));
        cells
    }

    /// `@FIELDS`.
    ///
    /// # Errors
    /// What the writer says.
    pub fn fields(&mut self, settings: &[Setting]) -> io::Result<()> {
        self.names(Section::Fields, 7)?;
        for s in settings {
            let mut cells = self.setting(s);
            cells.push(format!("{}", s.frequency_hz));
            cells.push(s.position.to_string());
            self.row(&cells)?;
        }
        Ok(())
    }

    /// `@BLOCKS`; standard deviations and counts are written if every block has them.
    ///
    /// # Errors
    /// What the writer says.
    pub fn blocks(&mut self, blocks: &[GivenBlock]) -> io::Result<()> {
        let full = blocks.iter().all(|b| b.std_ent.is_some() && b.count.is_some());
        self.names(Section::Blocks, if full { 13 } else { 9 })?;
        let d = self.decimals;
        for b in blocks {
            let mut cells = self.setting(&b.setting);
            cells.push(b.setting.position.to_string());
            cells.extend(b.mean.0.iter().map(|v| fixed(v * self.units_per_ent, d.reading)));
            if let (true, Some(std), Some(count)) = (full, b.std_ent, b.count) {
                cells.extend(std.iter().map(|v| fixed(v * self.units_per_ent, d.reading)));
                cells.push(count.to_string());
            }
            self.row(&cells)?;
        }
        Ok(())
    }

    /// `@TEMPERATURES` or `@CHANNELS`; NaN becomes an empty cell.
    ///
    /// # Errors
    /// What the writer says.
    pub fn slow(&mut self, section: Section, table: &SlowTable) -> io::Result<()> {
        writeln!(self.out, "{}\nt,{}", section.name(), table.names.join(","))?;
        for (i, t_s) in table.t_s.iter().enumerate() {
            let mut cells = vec![fixed(*t_s, self.decimals.time)];
            cells.extend(table.values.iter().map(|column| {
                let value = column.get(i).copied().unwrap_or(f64::NAN);
                if value.is_finite() { fixed(value, self.decimals.slow) } else { String::new() }
            }));
            self.row(&cells)?;
        }
        Ok(())
    }

    /// `@VECTORS`.
    ///
    /// # Errors
    /// What the writer says.
    pub fn vectors(&mut self, vectors: impl IntoIterator<Item = Vector>) -> io::Result<()> {
        self.names(Section::Vectors, 5)?;
        let d = self.decimals;
        for v in vectors {
            write!(self.out, "{},{}", v.n, fixed(v.t_s, d.time))?;
            for component in v.reading.0 {
                write!(self.out, ",{}", fixed(component * self.units_per_ent, d.reading))?;
            }
            writeln!(self.out)?;
        }
        Ok(())
    }

    /// `@END`; gives the writer back, flushed.
    ///
    /// # Errors
    /// What the writer says.
    pub fn end(mut self) -> io::Result<W> {
        writeln!(self.out, "@END")?;
        self.out.flush()?;
        Ok(self.out)
    }
}
