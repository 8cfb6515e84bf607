//! Tables as CSV and Parquet, through polars; its types appear here only.

mod as_read;
pub mod columns;
mod footer;
mod frames;
mod guard;
pub mod long;
pub mod series;
pub mod stream;

use super::text::harmless;
use crate::data::error::Finding;
use crate::data::plain::one_line;
use polars::prelude::{
    Column, CsvParseOptions, CsvReadOptions, CsvWriter, DataFrame, DataType, KeyValueMetadata, ParquetReader, ParquetWriter,
    PolarsError, SerReader, SerWriter,
};
use std::io::Cursor;

/// A column of a table.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Text.
    Text(Vec<String>),
    /// Numbers; NaN is a missing value.
    Numbers(Vec<f64>),
    /// Counts.
    Counts(Vec<u64>),
}

/// A table of named columns of equal length. Units stand in the names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Columns in order.
    pub columns: Vec<(String, Values)>,
}

fn wrong(error: &PolarsError) -> Finding {
    Finding::error("table", error.to_string(), "check the columns of the table")
}

impl Table {
    /// Adds a column.
    pub fn push(&mut self, name: &str, values: Values) {
        self.columns.push((name.to_owned(), values));
    }

    fn frame(&self) -> Result<DataFrame, Finding> {
        let columns: Vec<Column> = self
            .columns
            .iter()
            .map(|(name, values)| match values {
                Values::Text(v) => Column::new(name.as_str().into(), v),
                Values::Numbers(v) => {
                    let cells: Vec<Option<f64>> = v.iter().map(|x| x.is_finite().then_some(*x)).collect();
                    Column::new(name.as_str().into(), cells)
                }
                Values::Counts(v) => Column::new(name.as_str().into(), v),
            })
            .collect();
        let height = columns.first().map_or(0, Column::len);
        DataFrame::new(height, columns).map_err(|e| wrong(&e))
    }

    fn from_frame(frame: &DataFrame) -> Result<Self, Finding> {
        let mut table = Table::default();
        for column in frame.columns() {
            let name = column.name().to_string();
            let values = if column.dtype() == &DataType::String {
                let text = column.str().map_err(|e| wrong(&e))?;
                Values::Text(text.iter().map(|c| c.unwrap_or_default().to_owned()).collect())
            } else {
                let cast = column.cast(&DataType::Float64).map_err(|e| wrong(&e))?;
                let numbers = cast.f64().map_err(|e| wrong(&e))?;
                Values::Numbers(numbers.iter().map(|c| c.unwrap_or(f64::NAN)).collect())
            };
            table.columns.push((name, values));
        }
        Ok(table)
    }

    /// CSV with a comment line `# calfit note` before the header line, by which the program knows its own tables. Texts are none that a
    /// spreadsheet takes for formulas.
    ///
    /// # Errors
    /// Columns of unequal length.
    pub fn csv(&self, note: &str) -> Result<Vec<u8>, Finding> {
        let mut out = format!("# calfit {}\n", one_line(note)).into_bytes();
        let as_cells = |values: &Values| match values {
            Values::Text(v) => Values::Text(v.iter().map(|text| harmless(text).into_owned()).collect()),
            other => other.clone(),
        };
        let columns = self.columns.iter().map(|(name, values)| (harmless(name).into_owned(), as_cells(values))).collect();
        CsvWriter::new(&mut out).finish(&mut Self { columns }.frame()?).map_err(|e| wrong(&e))?;
        Ok(out)
    }

    /// Parquet.
    ///
    /// # Errors
    /// Columns of unequal length.
    pub fn parquet(&self) -> Result<Vec<u8>, Finding> {
        let mark =
            KeyValueMetadata::from_static(vec![("written_by".to_owned(), format!("calfit {}", env!("CARGO_PKG_VERSION")))]);
        let mut out = Cursor::new(Vec::new());
        ParquetWriter::new(&mut out).with_key_value_metadata(Some(mark)).finish(&mut self.frame()?).map_err(|e| wrong(&e))?;
        Ok(out.into_inner())
    }

    /// Reads CSV; lines that begin with `#` are comments.
    ///
    /// # Errors
    /// Text that is no table.
    pub fn from_csv(bytes: &[u8]) -> Result<Self, Finding> {
        let options = CsvReadOptions::default()
            .with_has_header(true)
            .with_infer_schema_length(None)
            .with_parse_options(CsvParseOptions::default().with_comment_prefix(Some("#")));
        let frame = options.into_reader_with_file_handle(Cursor::new(bytes)).finish().map_err(|e| wrong(&e))?;
        Self::from_frame(&frame)
    }

    /// Reads Parquet.
    ///
    /// # Errors
    /// Bytes that are no table.
    pub fn from_parquet(bytes: &[u8]) -> Result<Self, Finding> {
        let frame = ParquetReader::new(Cursor::new(bytes.to_vec())).finish().map_err(|e| wrong(&e))?;
        Self::from_frame(&frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_survive_both_formats_to_the_last_bit() {
        let mut table = Table::default();
        table.push("run", Values::Text(vec!["a,b".to_owned(), "\"c\"".to_owned()]));
        table.push("sigma_x, nT/enT", Values::Numbers(vec![0.1 + 0.2, f64::NAN]));
        let check = |back: Table| {
            assert_eq!(back.columns[0], table.columns[0]);
            let Values::Numbers(v) = &back.columns[1].1 else { panic!("{back:?}") };
            assert!(v[0] == 0.1 + 0.2 && v[1].is_nan());
        };
        let csv = table.csv("lin").unwrap();
        assert!(csv.starts_with(b"# calfit lin\nrun,"));
        check(Table::from_csv(&csv).unwrap());
        check(Table::from_parquet(&table.parquet().unwrap()).unwrap());
    }
}
