//! Parquet whose columns pass in the types of the file from which they were read: moments, days and short numbers, which the tables of this
//! program hold as text and as wider numbers.

use super::frames::AsRead;
use polars::prelude::{Column, CompatLevel, DataFrame, PolarsError};
use polars_arrow::array::Array;
use polars_arrow::datatypes::{ArrowSchema, Field};
use polars_parquet::read::ParquetError;
use polars_parquet::write::{
    CompressedPage, CompressionOptions, Compressor, DynIter, DynStreamingIterator, Encoding, FileWriter, KeyValue, ParquetType,
    StatisticsOptions, Version, WriteOptions, array_to_columns, fallible_streaming_iterator, schema_to_metadata_key,
};
use std::io::Write;

/// A table on its way into a file, a batch a group of rows.
pub(super) struct AsReadWriter<W: Write> {
    writer: FileWriter<W>,
    types: Vec<ParquetType>,
    options: WriteOptions,
    says: Vec<(String, String)>,
}

/// A column in the type of the file, if it had another one there.
fn array_of(column: &Column, as_read: &AsRead) -> Box<dyn Array> {
    match as_read.iter().find(|(name, _)| *name == column.name().as_str()) {
        Some((_, array)) => array.clone(),
        None => column.as_materialized_series().rechunk().to_arrow(0, CompatLevel::oldest()),
    }
}

impl<W: Write> AsReadWriter<W> {
    /// A table with the columns of a first batch, which is not written yet; `says` are its keys and values.
    pub fn new(file: W, first: &DataFrame, as_read: &AsRead, says: Vec<(String, String)>) -> Result<Self, PolarsError> {
        let field = |column: &Column| Field::new(column.name().clone(), array_of(column, as_read).dtype().clone(), true);
        let schema: ArrowSchema = first.columns().iter().map(field).map(|f| (f.name.clone(), f)).collect();
        let options = WriteOptions {
            statistics: StatisticsOptions::default(),
            version: Version::V1,
            compression: CompressionOptions::Zstd(None),
            data_page_size: None,
        };
        let writer = FileWriter::try_new(file, schema, options)?;
        let types = writer.parquet_schema().fields().to_vec();
        Ok(Self { writer, types, options, says })
    }

    /// Writes a batch; one without rows has no group.
    pub fn write(&mut self, frame: &DataFrame, as_read: &AsRead) -> Result<(), PolarsError> {
        if frame.height() == 0 {
            return Ok(());
        }
        let mut encoded: Vec<Vec<CompressedPage>> = Vec::new();
        for (column, kind) in frame.columns().iter().zip(&self.types) {
            let array = array_of(column, as_read);
            for pages in array_to_columns(array, kind.clone(), self.options, &[Encoding::Plain])? {
                let pages = pages.map(|page| page.map_err(|e| ParquetError::FeatureNotSupported(e.to_string())));
                encoded.push(Compressor::new_from_vec(pages, self.options.compression, Vec::new()).collect::<Result<_, _>>()?);
            }
        }
        let group = DynIter::new(encoded.iter().map(|pages| {
            Ok(DynStreamingIterator::new(fallible_streaming_iterator::convert(pages.iter().map(Ok::<_, PolarsError>))))
        }));
        self.writer.write(frame.height() as u64, group)
    }

    /// Writes what ends the table.
    pub fn finish(mut self) -> Result<(), PolarsError> {
        let mut metadata = vec![schema_to_metadata_key(self.writer.schema())];
        metadata.extend(self.says.drain(..).map(|(key, value)| KeyValue { key, value: Some(value) }));
        self.writer.end(Some(metadata)).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use crate::files::output::Folder;
    use crate::files::table::columns::ParquetFile;
    use crate::files::table::long::{Column, LongWriter};
    use crate::files::table::stream::{Format, Reader, Writer};
    use polars_arrow::datatypes::{ArrowDataType as T, TimeUnit};

    #[test]
    fn columns_that_pass_keep_their_types_and_values() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("vectors.parquet");
        let words = ["normal".to_owned(), "burst".to_owned()];
        let columns = [
            ("time_utc", Column::Timestamps(&[0, 1_500_000_001])),
            ("x", Column::Numbers(&[1.5, f64::NAN])),
            ("quality", Column::Bytes(&[3, 250])),
            ("mode", Column::Words(&[1, 0], &words)),
        ];
        let mut writer = LongWriter::new(std::fs::File::create(&path).unwrap(), &columns, Vec::new()).unwrap();
        writer.write(&columns).unwrap();
        writer.finish().unwrap();

        let folder = Folder::open(home.path(), false).unwrap();
        let mut file = folder.create("out.parquet").unwrap();
        let mut writer = Writer::new(&mut file, Format::Parquet, "note");
        let mut reader = Reader::open(&path).unwrap();
        while let Some(mut batch) = reader.next_batch().unwrap() {
            batch.push("bx_nt", vec![7.0; batch.len()]).unwrap();
            batch.push_bits("flags", vec![1; batch.len()]).unwrap();
            writer.write(&batch).unwrap();
        }
        writer.finish().unwrap();
        file.finish().unwrap();

        let out = home.path().join("out.parquet");
        let types: Vec<(String, T)> = {
            let file = ParquetFile::open(&out).unwrap();
            assert_eq!(file.says("calfit"), Some("note"));
            file.fields().map(|f| (f.name.to_string(), f.dtype.clone())).collect()
        };
        let utc = T::Timestamp(TimeUnit::Nanosecond, Some("UTC".into()));
        assert_eq!(types[0], ("time_utc".to_owned(), utc));
        assert_eq!(types[2], ("quality".to_owned(), T::UInt8));
        assert_eq!(
            types.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(),
            ["time_utc", "x", "quality", "mode", "bx_nt", "flags"]
        );
        let batch = Reader::open(&out).unwrap().next_batch().unwrap().unwrap();
        assert_eq!(batch.texts(&out, "time_utc").unwrap(), ["1970-01-01T00:00:00Z", "1970-01-01T00:00:01.500000001Z"]);
        assert_eq!(batch.numbers(&out, "quality").unwrap(), [3.0, 250.0]);
        assert_eq!(batch.numbers(&out, "bx_nt").unwrap(), [7.0, 7.0]);
        assert_eq!(batch.texts(&out, "mode").unwrap(), ["burst", "normal"]);
        assert!(batch.numbers(&out, "x").unwrap()[1].is_nan());
    }
}
