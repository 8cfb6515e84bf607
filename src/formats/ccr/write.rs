//! The writer of run files.

use super::Section;
use crate::formats::text::fixed;
use crate::run::{GivenBlock, Header, ReadingUnit, ScalarRow, Setting, SlowTable, Vector};
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

/// Text of vectors that is collected before it is written.
const BUFFER: usize = 1 << 18;
/// Room for a row of vectors.
const LONGEST_ROW: usize = 1 << 9;
/// Whole numbers below this are exact.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// A whole number in decimal.
fn push_whole(text: &mut Vec<u8>, mut number: u64) {
    let mut digits = [0; 20];
    let mut at = digits.len();
    loop {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            break;
        }
    }
    text.extend_from_slice(&digits[at..]);
}

/// A number with a fixed number of decimals, as [`fixed`] has it but faster, since samples come by the million.
fn push_fixed(text: &mut Vec<u8>, value: f64, decimals: usize) {
    let power = POWERS.get(decimals).copied().unwrap_or(f64::INFINITY);
    let product = (value * power).abs();
    let scaled = product.round();
    // Where the rounding of the product could decide, and beyond whole numbers, digits are worked out exactly.
    let near_tie = ((product - scaled).abs() - 0.5).abs() <= product * f64::EPSILON;
    if scaled.is_nan() || scaled >= EXACT || near_tie {
        text.extend_from_slice(fixed(value, decimals).as_bytes());
        return;
    }
    if value < 0.0 && scaled > 0.0 {
        text.push(b'-');
    }
    let (whole, power) = (scaled as u64, power as u64);
    push_whole(text, whole / power);
    if decimals > 0 {
        text.push(b'.');
        let mut part = whole % power;
        let from = text.len();
        text.resize(from + decimals, b'0');
        for digit in text.iter_mut().skip(from).rev() {
            *digit = b'0' + (part % 10) as u8;
            part /= 10;
        }
    }
}

/// Powers of ten.
const POWERS: [f64; 10] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];

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

    /// A comment among the keys, for a person who reads the file.
    ///
    /// # Errors
    /// What the writer says.
    pub fn remark(&mut self, text: &str) -> io::Result<()> {
        writeln!(self.out, "# {}", text.replace(['\r', '\n'], " "))
    }

    /// `@SCALAR`.
    ///
    /// # Errors
    /// What the writer says.
    pub fn scalar(&mut self, rows: &[ScalarRow]) -> io::Result<()> {
        self.names(Section::Scalar, 5)?;
        let d = self.decimals;
        for row in rows {
            let mut cells = vec![fixed(row.t_s, d.time)];
            cells.extend(row.setting.iter().chain([&row.modulus_nt]).map(|v| fixed(*v, d.field)));
            self.row(&cells)?;
        }
        Ok(())
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
        let mut text = Vec::with_capacity(BUFFER + LONGEST_ROW);
        for v in vectors {
            push_whole(&mut text, v.n);
            text.push(b',');
            push_fixed(&mut text, v.t_s, d.time);
            for component in v.reading.0 {
                text.push(b',');
                push_fixed(&mut text, component * self.units_per_ent, d.reading);
            }
            text.push(b'\n');
            if text.len() >= BUFFER {
                self.out.write_all(&text)?;
                text.clear();
            }
        }
        self.out.write_all(&text)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_digits_are_those_of_the_formatter() {
        let mut value = 1.0e-7;
        while value < 1e12 {
            for sign in [1.0, -1.0] {
                for decimals in [0, 1, 2, 3, 4, 9] {
                    let mut text = Vec::new();
                    push_fixed(&mut text, sign * value, decimals);
                    assert_eq!(String::from_utf8(text).unwrap(), fixed(sign * value, decimals), "{value} {decimals}");
                }
            }
            value *= 1.000_37 + value.fract() * 1e-4;
        }
        for (value, expected) in [(-0.001, "0.00"), (0.0, "0.00"), (-0.005001, "-0.01"), (f64::MAX, "")] {
            let mut text = Vec::new();
            push_fixed(&mut text, value, 2);
            assert!(expected.is_empty() || text == expected.as_bytes(), "{value}");
        }
    }
}
