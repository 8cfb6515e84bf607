//! Columns of long tables as the types that a reader asks for: whole numbers to the last digit, numbers, words, times. Parquet and CSV.

use super::columns::{ParquetFile, each, ns_of};
use super::stream::{Batch, Format, Reader};
use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, Tt2000, is_possible};
use crate::files::source::room_for;
use polars_arrow::array::{Array, PrimitiveArray, Utf8Array, Utf8ViewArray};
use polars_arrow::datatypes::{ArrowDataType, Field};
use polars_arrow::types::NativeType;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Words of a column: every cell is the index of one of a few words.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Words {
    /// The words that occur, in the order of their first row.
    pub words: Vec<String>,
    /// Index of the word of every row.
    pub codes: Vec<u32>,
}

impl Words {
    fn push(&mut self, known: &mut HashMap<String, u32>, word: &str) {
        // Most rows repeat the word of the row before.
        if let Some(last) = self.codes.last()
            && self.words[*last as usize] == word
        {
            self.codes.push(*last);
            return;
        }
        let code = match known.get(word) {
            Some(code) => *code,
            None => {
                let code = u32::try_from(self.words.len()).unwrap_or(u32::MAX);
                known.insert(word.to_owned(), code);
                self.words.push(word.to_owned());
                code
            }
        };
        self.codes.push(code);
    }
}

/// A table whose columns are read one by one.
pub struct SeriesTable {
    path: PathBuf,
    body: Body,
    /// Groups of rows that are read.
    groups: Vec<usize>,
    /// Rows of the file before the first one that is read.
    before: usize,
    rows: usize,
}

enum Body {
    Parquet(Box<ParquetFile>),
    Csv(Vec<Batch>),
}

impl SeriesTable {
    /// Opens a table.
    ///
    /// # Errors
    /// A file that cannot be read or is no table of the format that its name tells.
    pub fn open(path: &Path) -> Result<Self, Finding> {
        if Format::of_name(path) == Some(Format::Csv) {
            let mut reader = Reader::open(path)?;
            // Every cell is a text of its own.
            room_for(path, std::fs::metadata(path).map_or(0, |meta| meta.len()).saturating_mul(4))?;
            let mut batches = Vec::new();
            while let Some(batch) = reader.next_batch()? {
                batches.push(batch);
            }
            let rows = batches.iter().map(Batch::len).sum();
            return Ok(Self { path: path.to_owned(), body: Body::Csv(batches), groups: vec![0], before: 0, rows });
        }
        let file = ParquetFile::open(path)?;
        let groups = file.group_rows();
        // A damaged file states any number of rows; those that are there are counted as they are read.
        let rows = groups.iter().fold(0, |sum: usize, rows| sum.saturating_add(*rows));
        Ok(Self {
            path: path.to_owned(),
            groups: (0..groups.len()).collect(),
            body: Body::Parquet(Box::new(file)),
            before: 0,
            rows,
        })
    }

    /// Rows that are read.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Rows of the file before the first one that is read.
    #[must_use]
    pub fn before(&self) -> usize {
        self.before
    }

    /// Names of the columns.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        match &self.body {
            Body::Parquet(file) => file.fields().map(|field| field.name.to_string()).collect(),
            Body::Csv(batches) => batches.first().map(Batch::names).unwrap_or_default(),
        }
    }

    /// The type of a column of a Parquet file, as Arrow names it.
    #[must_use]
    pub fn kind(&self, name: &str) -> Option<String> {
        match &self.body {
            Body::Parquet(file) => file.fields().find(|f| f.name.as_str() == name).map(|f| format!("{:?}", f.dtype)),
            Body::Csv(_) => None,
        }
    }

    /// What a Parquet file says of itself under a key.
    #[must_use]
    pub fn says(&self, key: &str) -> Option<&str> {
        match &self.body {
            Body::Parquet(file) => file.says(key),
            Body::Csv(_) => None,
        }
    }

    /// Rows of every group of the file.
    #[must_use]
    pub fn group_rows(&self) -> Vec<usize> {
        match &self.body {
            Body::Parquet(file) => file.group_rows(),
            Body::Csv(batches) => vec![batches.iter().map(Batch::len).sum()],
        }
    }

    /// Reads from now on only the groups of rows that hold a range of rows.
    pub fn narrow(&mut self, wanted: std::ops::Range<usize>) {
        let Body::Parquet(file) = &self.body else { return };
        let mut begin = 0_usize;
        let mut kept = Vec::new();
        let mut first = None;
        self.rows = 0;
        for (index, rows) in file.group_rows().into_iter().enumerate() {
            let end = begin.saturating_add(rows);
            if begin < wanted.end && end > wanted.start {
                first.get_or_insert(begin);
                kept.push(index);
                self.rows = self.rows.saturating_add(rows);
            }
            begin = end;
        }
        self.groups = kept;
        self.before = first.unwrap_or(0);
    }

    fn complain(&self, rule: impl Into<Box<str>>, remedy: &str) -> Finding {
        Finding::error(&self.path.display().to_string(), rule, remedy)
    }

    fn field(&self, file: &ParquetFile, name: &str) -> Result<Field, Finding> {
        let found = file.fields().find(|field| field.name.as_str() == name);
        found.cloned().ok_or_else(|| {
            let rule = format!("has no column `{name}`; it has {}", self.names().join(", "));
            self.complain(rule, "rename the column, or add it")
        })
    }

    /// The values of a column; every row that is read has one.
    fn pieces(&self, file: &ParquetFile, field: &Field) -> Result<Vec<Box<dyn Array>>, Finding> {
        let pieces = file.pieces(field, &self.groups)?;
        let rows: usize = pieces.iter().map(|piece| piece.len()).sum();
        if rows == self.rows {
            return Ok(pieces);
        }
        let rule = format!("column `{}` holds values of the type {:?}, which are not read", field.name, field.dtype);
        Err(self.complain(rule, "convert the column"))
    }

    fn no_value(&self, name: &str, row: usize) -> Finding {
        let rule = format!("row {}: column `{name}` has no value", self.before + row + 1);
        self.complain(rule, "leave the row out, or take the file from the archive again")
    }

    fn wrong_type(&self, name: &str, found: &ArrowDataType, wanted: &str) -> Finding {
        self.complain(format!("column `{name}` holds values of the type {found:?}, not {wanted}"), "convert the column")
    }

    fn cells<T>(
        &self,
        batches: &[Batch],
        name: &str,
        parse: impl Fn(&str) -> Option<T>,
        wanted: &str,
    ) -> Result<Vec<T>, Finding> {
        let mut out = Vec::with_capacity(self.rows);
        for batch in batches {
            for (row, cell) in batch.texts(&self.path, name)?.into_iter().enumerate() {
                let Some(value) = parse(cell.trim()) else {
                    let rule = format!("row {}: the cell in column `{name}` is no {wanted}", out.len() + 1);
                    let finding = self.complain(rule, "correct it").found(cell.as_bytes());
                    return Err(batch.placed(finding, &self.path, name, row));
                };
                out.push(value);
            }
        }
        Ok(out)
    }

    /// A column of whole numbers without missing values.
    ///
    /// # Errors
    /// No such column, another type, a missing value or one that is not whole.
    pub fn whole(&self, name: &str) -> Result<Vec<i64>, Finding> {
        let file = match &self.body {
            Body::Csv(batches) => return self.cells(batches, name, |cell| cell.parse().ok(), "whole number"),
            Body::Parquet(file) => file,
        };
        let field = self.field(file, name)?;
        let pieces = self.pieces(file, &field)?;
        use ArrowDataType as T;
        match &field.dtype {
            T::Int8 => self.values::<i8, _>(name, &pieces, i64::from),
            T::Int16 => self.values::<i16, _>(name, &pieces, i64::from),
            T::Int32 => self.values::<i32, _>(name, &pieces, i64::from),
            T::Int64 => self.values::<i64, _>(name, &pieces, |v| v),
            T::UInt8 => self.values::<u8, _>(name, &pieces, i64::from),
            T::UInt16 => self.values::<u16, _>(name, &pieces, i64::from),
            T::UInt32 => self.values::<u32, _>(name, &pieces, i64::from),
            T::UInt64 => self.values::<u64, _>(name, &pieces, |v| i64::try_from(v).unwrap_or(i64::MAX)),
            other => Err(self.wrong_type(name, other, "whole numbers")),
        }
    }

    /// A column of numbers; a missing value is nan.
    ///
    /// # Errors
    /// No such column, or another type.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, Finding> {
        let file = match &self.body {
            Body::Csv(batches) => {
                let parse = |cell: &str| if cell.is_empty() { Some(f64::NAN) } else { cell.parse().ok() };
                return self.cells(batches, name, parse, "number");
            }
            Body::Parquet(file) => file,
        };
        let field = self.field(file, name)?;
        let pieces = self.pieces(file, &field)?;
        use ArrowDataType as T;
        #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
        Ok(match &field.dtype {
            T::Int8 => or_nan::<i8>(&pieces, f64::from),
            T::Int16 => or_nan::<i16>(&pieces, f64::from),
            T::Int32 => or_nan::<i32>(&pieces, f64::from),
            T::Int64 => or_nan::<i64>(&pieces, |v| v as f64),
            T::UInt8 => or_nan::<u8>(&pieces, f64::from),
            T::UInt16 => or_nan::<u16>(&pieces, f64::from),
            T::UInt32 => or_nan::<u32>(&pieces, f64::from),
            T::UInt64 => or_nan::<u64>(&pieces, |v| v as f64),
            T::Float32 => or_nan::<f32>(&pieces, f64::from),
            T::Float64 => or_nan::<f64>(&pieces, |v| v),
            other => return Err(self.wrong_type(name, other, "numbers")),
        })
    }

    /// A column of words; a missing one is empty.
    ///
    /// # Errors
    /// No such column, or another type.
    pub fn words(&self, name: &str) -> Result<Words, Finding> {
        let mut out = Words::default();
        let mut known = HashMap::new();
        let file = match &self.body {
            Body::Csv(batches) => {
                for batch in batches {
                    batch.texts(&self.path, name)?.iter().for_each(|cell| out.push(&mut known, cell.trim()));
                }
                return Ok(out);
            }
            Body::Parquet(file) => file,
        };
        let field = self.field(file, name)?;
        for piece in self.pieces(file, &field)? {
            let any = piece.as_any();
            if let Some(array) = any.downcast_ref::<Utf8ViewArray>() {
                let mut last = None;
                for (view, word) in array.views().iter().zip(array.iter()) {
                    // Equal views are equal words; most rows repeat the word of the row before.
                    match out.codes.last().copied().filter(|_| word.is_some() && last == Some(view)) {
                        Some(code) => out.codes.push(code),
                        None => out.push(&mut known, word.unwrap_or_default()),
                    }
                    last = word.is_some().then_some(view);
                }
            } else if let Some(array) = any.downcast_ref::<Utf8Array<i64>>() {
                array.iter().for_each(|word| out.push(&mut known, word.unwrap_or_default()));
            } else if let Some(array) = any.downcast_ref::<Utf8Array<i32>>() {
                array.iter().for_each(|word| out.push(&mut known, word.unwrap_or_default()));
            } else {
                return Err(self.wrong_type(name, &field.dtype, "text"));
            }
        }
        Ok(out)
    }

    /// A column of times, TT2000.
    ///
    /// # Errors
    /// As [`SeriesTable::whole`], and a time that cannot be.
    pub fn tt2000(&self, name: &str) -> Result<Vec<Tt2000>, Finding> {
        self.possible(name, self.whole(name)?)
    }

    /// A column of seconds of the clock of a spacecraft.
    ///
    /// # Errors
    /// As [`SeriesTable::numbers`], a missing value, a time that cannot be.
    pub fn clock(&self, name: &str, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
        let clock_s = self.numbers(name)?;
        if let Some(row) = clock_s.iter().position(|s| !s.is_finite()) {
            let rule = format!("row {}: `{name}` has no value", self.before + row + 1);
            return Err(self.complain(rule, "leave the row out"));
        }
        self.possible(name, leap.of_clock(&clock_s))
    }

    /// Refuses times that no mission has: differences of them would come round again.
    fn possible(&self, name: &str, times: Vec<Tt2000>) -> Result<Vec<Tt2000>, Finding> {
        match times.iter().position(|time| !is_possible(*time)) {
            Some(row) => {
                let rule = format!("row {}: the time in column `{name}` lies before 1900 or after 2099", self.before + row + 1);
                Err(self.complain(rule, "correct it, or leave the row out"))
            }
            None => Ok(times),
        }
    }

    /// A column of UTC, as timestamps or as text.
    ///
    /// # Errors
    /// No such column, another type, a missing value, text that is no time.
    pub fn utc(&self, name: &str, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
        let file = match &self.body {
            Body::Csv(batches) => return self.cells(batches, name, |cell| leap.parse(cell), "time"),
            Body::Parquet(file) => file,
        };
        let field = self.field(file, name)?;
        if let ArrowDataType::Timestamp(unit, _) = field.dtype {
            let factor = ns_of(unit);
            let pieces = self.pieces(file, &field)?;
            let times = self.values::<i64, _>(name, &pieces, |v| leap.tt2000_of_timestamp(v.saturating_mul(factor)))?;
            return self.possible(name, times);
        }
        let words = self.words(name)?;
        let times: Vec<Option<Tt2000>> = words.words.iter().map(|word| leap.parse(word)).collect();
        let time = |(row, code): (usize, &u32)| {
            times[*code as usize].ok_or_else(|| {
                let rule = format!("row {}: the cell in column `{name}` is no time", self.before + row + 1);
                self.complain(rule, "write 2015-06-30T12:00:00.000Z").found(words.words[*code as usize].as_bytes())
            })
        };
        words.codes.iter().enumerate().map(time).collect()
    }

    fn values<T: NativeType, V>(
        &self,
        name: &str,
        pieces: &[Box<dyn Array>],
        convert: impl Fn(T) -> V,
    ) -> Result<Vec<V>, Finding> {
        let mut out = Vec::with_capacity(self.rows);
        for piece in pieces {
            let Some(array) = piece.as_any().downcast_ref::<PrimitiveArray<T>>() else { continue };
            if array.null_count() == 0 {
                out.extend(array.values().iter().map(|v| convert(*v)));
            } else {
                let row = array.iter().position(|v| v.is_none()).unwrap_or(0);
                return Err(self.no_value(name, out.len() + row));
            }
        }
        Ok(out)
    }
}

fn or_nan<T: NativeType>(pieces: &[Box<dyn Array>], convert: impl Fn(T) -> f64) -> Vec<f64> {
    each::<PrimitiveArray<T>, _>(pieces, |array, out| {
        if array.null_count() == 0 {
            out.extend(array.values().iter().map(|v| convert(*v)));
        } else {
            out.extend(array.iter().map(|v| v.map_or(f64::NAN, |v| convert(*v))));
        }
    })
}
