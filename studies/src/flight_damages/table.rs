//! A table of flight inputs in memory, which damages change.

use calfit::data::time::LeapSeconds;
use calfit::files::table::long::{Column, LongWriter};
use calfit::files::table::series::SeriesTable;
use std::error::Error;
use std::fmt::Write;
use std::path::Path;

/// What a table says of itself that flight processing looks at.
const SAYS: [&str; 3] = ["frame", "attitude_order", "attitude_from_to"];

/// Values of a column.
#[derive(Clone, PartialEq)]
pub enum Values {
    Whole(Vec<i64>),
    /// ns since 1970.
    Utc(Vec<i64>),
    /// nan is a missing value.
    Numbers(Vec<f64>),
    Words(Vec<String>),
}

impl Values {
    fn pick(&self, rows: &[usize]) -> Self {
        fn of<T: Clone>(list: &[T], rows: &[usize]) -> Vec<T> {
            rows.iter().map(|row| list[*row].clone()).collect()
        }
        match self {
            Values::Whole(v) => Values::Whole(of(v, rows)),
            Values::Utc(v) => Values::Utc(of(v, rows)),
            Values::Numbers(v) => Values::Numbers(of(v, rows)),
            Values::Words(v) => Values::Words(of(v, rows)),
        }
    }

    fn len(&self) -> usize {
        match self {
            Values::Whole(v) | Values::Utc(v) => v.len(),
            Values::Numbers(v) => v.len(),
            Values::Words(v) => v.len(),
        }
    }
}

/// Words of a column as codes, and the words.
type Coded = (Vec<u8>, Vec<String>);

/// A table.
#[derive(Clone, PartialEq)]
pub struct Table {
    pub columns: Vec<(String, Values)>,
    says: Vec<(String, String)>,
}

impl Table {
    /// Reads a Parquet file.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn read(path: &Path, leap: &LeapSeconds) -> Result<Self, Box<dyn Error>> {
        let table = SeriesTable::open(path).map_err(|e| e.to_string())?;
        let mut columns = Vec::new();
        for name in table.names() {
            let kind = table.kind(&name).unwrap_or_default();
            let values = if kind.starts_with("Timestamp") {
                table.utc(&name, leap).map(|times| Values::Utc(times.iter().map(|t| leap.utc(*t).timestamp_ns()).collect()))
            } else if kind.contains("Utf8") {
                let words = table.words(&name);
                words.map(|words| Values::Words(words.codes.iter().map(|code| words.words[*code as usize].clone()).collect()))
            } else if kind.contains("Int") {
                table.whole(&name).map(Values::Whole)
            } else {
                table.numbers(&name).map(Values::Numbers)
            };
            columns.push((name, values.map_err(|e| e.to_string())?));
        }
        let says = SAYS.iter().filter_map(|key| Some(((*key).to_owned(), table.says(key)?.to_owned()))).collect();
        Ok(Self { columns, says })
    }

    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, values)| values.len())
    }

    /// Keeps some rows, in this order.
    pub fn pick(&mut self, rows: &[usize]) {
        self.columns.iter_mut().for_each(|(_, values)| *values = values.pick(rows));
    }

    pub fn column(&mut self, name: &str) -> Option<&mut Values> {
        self.columns.iter_mut().find(|(own, _)| own == name).map(|(_, values)| values)
    }

    /// Changes the numbers of a column, whole ones to whole ones.
    pub fn change(&mut self, name: &str, change: impl Fn(usize, f64) -> f64) -> bool {
        match self.column(name) {
            Some(Values::Whole(list)) => {
                list.iter_mut().enumerate().for_each(|(row, value)| *value = change(row, *value as f64).round() as i64);
            }
            Some(Values::Numbers(list)) => list.iter_mut().enumerate().for_each(|(row, value)| *value = change(row, *value)),
            _ => return false,
        }
        true
    }

    /// Exchanges the values of two columns.
    pub fn exchange(&mut self, a: &str, b: &str) -> bool {
        let place = |name: &str| self.columns.iter().position(|(own, _)| own == name);
        let (Some(a), Some(b)) = (place(a), place(b)) else { return false };
        let values = self.columns[a].1.clone();
        self.columns[a].1 = std::mem::replace(&mut self.columns[b].1, values);
        true
    }

    /// As Parquet.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn parquet(&self) -> Result<Vec<u8>, Box<dyn Error>> {
        let coded: Vec<Option<Coded>> = self
            .columns
            .iter()
            .map(|(_, values)| {
                let Values::Words(list) = values else { return None };
                let mut words: Vec<String> = list.clone();
                words.sort_unstable();
                words.dedup();
                // A column with more words than codes has numbers in text; the first ones are enough to see its type.
                words.truncate(256);
                let code = |word: &String| words.binary_search(word).unwrap_or_default() as u8;
                Some((list.iter().map(code).collect(), words.clone()))
            })
            .collect();
        let columns: Vec<(&str, Column<'_>)> = self
            .columns
            .iter()
            .zip(&coded)
            .map(|((name, values), coded)| {
                let column = match (values, coded) {
                    (Values::Whole(v), _) => Column::Whole(v),
                    (Values::Utc(v), _) => Column::Timestamps(v),
                    (Values::Numbers(v), _) => Column::Numbers(v),
                    (Values::Words(_), Some((codes, words))) => Column::Words(codes, words),
                    (Values::Words(_), None) => Column::Bytes(&[]),
                };
                (name.as_str(), column)
            })
            .collect();
        let mut bytes = Vec::new();
        let mut writer = LongWriter::new(&mut bytes, &columns, self.says.clone()).map_err(|e| e.to_string())?;
        if self.rows() > 0 {
            writer.write(&columns).map_err(|e| e.to_string())?;
        }
        writer.finish().map_err(|e| e.to_string())?;
        Ok(bytes)
    }

    /// As text with commas.
    pub fn csv(&self, leap: &LeapSeconds) -> String {
        let mut text = self.columns.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(",") + "\n";
        for row in 0..self.rows() {
            let cell = |(_, values): &(String, Values)| match values {
                Values::Whole(v) => v[row].to_string(),
                Values::Utc(v) => format!("{}Z", leap.utc(leap.tt2000_of_timestamp(v[row]))),
                Values::Numbers(v) if v[row].is_nan() => String::new(),
                Values::Numbers(v) => v[row].to_string(),
                Values::Words(v) => v[row].clone(),
            };
            let _ = writeln!(text, "{}", self.columns.iter().map(cell).collect::<Vec<_>>().join(","));
        }
        text
    }
}
