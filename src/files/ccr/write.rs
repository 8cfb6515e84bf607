//! The writer of run files.

use super::Section;
use crate::data::run::{GivenBlock, Header, ReadingUnit, ScalarRow, Setting, SlowTable, Vector};
use crate::files::text::{fixed, quoted};
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
/// Room for a row of vectors with numbers of any size.
const LONGEST_ROW: usize = 1 << 9;
/// Whole numbers below this are exact, and so are halves in between.
const EXACT: f64 = 4_503_599_627_370_496.0;
/// Room for the numbers of a row that are written fast: at most sixteen digits each.
const ROW: usize = 128;

/// A row of numbers, written from its end to its begin. Samples come by the million.
struct RowText {
    bytes: [u8; ROW],
    begin: usize,
}

impl RowText {
    fn new() -> Self {
        Self { bytes: [b'\n'; ROW], begin: ROW - 1 }
    }

    fn text(&self) -> &[u8] {
        &self.bytes[self.begin..]
    }

    fn put(&mut self, byte: u8) {
        self.begin -= 1;
        self.bytes[self.begin] = byte;
    }

    fn whole(&mut self, mut number: u64) {
        loop {
            self.put(b'0' + (number % 10) as u8);
            number /= 10;
            if number == 0 {
                break;
            }
        }
    }

    /// A number with a fixed number of decimals, as [`fixed`] has it; false where that has to work the digits out: large numbers, and
    /// those so near to the middle between two neighbours that rounding the product could decide.
    fn number(&mut self, value: f64, decimals: usize) -> bool {
        let Some(power) = POWERS.get(decimals) else { return false };
        let product = (value * power).abs();
        if product.is_nan() || product >= EXACT {
            return false;
        }
        // Adding and taking away a number without fraction bits rounds, without a call.
        let scaled = (product + EXACT) - EXACT;
        if ((product - scaled).abs() - 0.5).abs() <= product * f64::EPSILON {
            return false;
        }
        let mut rest = scaled as u64;
        if decimals > 0 {
            for _ in 0..decimals {
                self.put(b'0' + (rest % 10) as u8);
                rest /= 10;
            }
            self.put(b'.');
        }
        self.whole(rest);
        if value < 0.0 && scaled > 0.0 {
            self.put(b'-');
        }
        true
    }
}

/// Powers of ten.
const POWERS: [f64; 10] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];

/// The magic line and the keys of a run file.
fn write_header(out: &mut impl Write, header: &Header) -> io::Result<()> {
    writeln!(out, "CCR 1")?;
    for (key, value) in [("run", header.run.as_str()), ("start", header.start.as_str())] {
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
    /// An error of the writer.
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
    /// An error of the writer.
    pub fn remark(&mut self, text: &str) -> io::Result<()> {
        writeln!(self.out, "# {}", text.replace(['\r', '\n'], " "))
    }

    /// `@SCALAR`.
    ///
    /// # Errors
    /// An error of the writer.
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
    /// An error of the writer.
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
    /// An error of the writer.
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
    /// An error of the writer.
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
    /// An error of the writer.
    pub fn vectors(&mut self, vectors: impl IntoIterator<Item = Vector>) -> io::Result<()> {
        self.names(Section::Vectors, 5)?;
        let d = self.decimals;
        let mut text = Vec::with_capacity(BUFFER + LONGEST_ROW);
        for v in vectors {
            let readings = v.reading.0.map(|r| r * self.units_per_ent);
            let mut row = RowText::new();
            let mut fast = true;
            for reading in readings.into_iter().rev() {
                fast = fast && row.number(reading, d.reading);
                row.put(b',');
            }
            fast = fast && row.number(v.t_s, d.time);
            if fast {
                row.put(b',');
                row.whole(v.n);
                text.extend_from_slice(row.text());
            } else {
                let [x, y, z] = readings.map(|r| fixed(r, d.reading));
                writeln!(text, "{},{},{x},{y},{z}", v.n, fixed(v.t_s, d.time))?;
            }
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
    /// An error of the writer.
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
        let compare = |value: f64, decimals: usize| {
            let mut row = RowText::new();
            if row.number(value, decimals) {
                assert_eq!(std::str::from_utf8(row.text()).unwrap().trim_end(), fixed(value, decimals), "{value} {decimals}");
            }
            row.begin < ROW - 1
        };
        let (mut value, mut fast, mut all) = (1.0e-7, 0, 0);
        while value < 1e12 {
            for decimals in [0, 1, 2, 3, 4, 9] {
                fast += u32::from(compare(value, decimals)) + u32::from(compare(-value, decimals));
                all += 2;
            }
            value *= 1.000_37 + value.fract() * 1e-4;
        }
        assert!(f64::from(fast) > 0.8 * f64::from(all), "{fast} of {all}");
        for value in [-0.001, 0.0, -0.0, -0.004_999, 0.125, 2.5, f64::MAX, f64::NAN, -1.005] {
            (0..10).for_each(|decimals| _ = compare(value, decimals));
        }
    }

    #[test]
    fn a_row_that_is_not_written_fast_is_written_all_the_same() {
        let header = Header {
            run: "r".to_owned(),
            start: "2026-01-01T00:00:00Z".parse().unwrap(),
            kind: crate::data::run::Kind::ZeroField,
            configuration: String::new(),
            sensor: String::new(),
            mode: String::new(),
            sample_rate_hz: 1.0,
            unit: ReadingUnit::Ent,
            field_source: String::new(),
            coil_correction: None,
            earthfield_compensation: Vec::new(),
        };
        let mut writer = Writer::new(Vec::new(), &header, Decimals::default()).unwrap();
        let reading = |r: [f64; 3]| crate::data::units::Reading(r);
        writer.vectors([Vector { n: 7, t_s: 0.5, reading: reading([1.0, 0.0005, -2.25]) }]).unwrap();
        writer.vectors([Vector { n: u64::MAX, t_s: 1e18, reading: reading([-1e15, 0.25, 1e300]) }]).unwrap();
        let text = String::from_utf8(writer.out).unwrap();
        assert!(text.contains("\n7,0.5000,1.000,0.001,-2.250\n") || text.contains("\n7,0.5000,1.000,0.000,-2.250\n"), "{text}");
        assert!(text.contains("\n18446744073709551615,1000000000000000000.0000,-1000000000000000.000,0.250,1"), "{text}");
    }
}
