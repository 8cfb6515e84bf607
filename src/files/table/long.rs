//! Long tables as Parquet, written row group by row group from columns with types of their own: times, numbers, flags, words.

use super::wrong;
use crate::data::error::Finding;
use polars::prelude::PolarsError;
use polars_arrow::array::{Array, DictionaryArray, PrimitiveArray, Utf8ViewArray};
use polars_arrow::bitmap::Bitmap;
use polars_arrow::datatypes::{ArrowDataType, ArrowSchema, Field, IntegerType, TimeUnit};
use polars_arrow::types::NativeType;
use polars_parquet::read::ParquetError;
use polars_parquet::write::{
    CompressedPage, CompressionOptions, Compressor, DynIter, DynStreamingIterator, Encoding, FileWriter, KeyValue, ParquetType,
    StatisticsOptions, Version, WriteOptions, ZstdLevel, array_to_columns, fallible_streaming_iterator, schema_to_metadata_key,
};
use rayon::prelude::*;
use std::io::Write;
use std::sync::Arc;

/// Rows of a group.
pub const GROUP_ROWS: usize = 262_144;

/// Some rows of a column. Slices of equal length make a group.
#[derive(Clone, Copy, Debug)]
pub enum Column<'a> {
    /// Whole numbers that mostly rise by equal steps, such as times.
    Whole(&'a [i64]),
    /// Timestamps in UTC, ns since 1970.
    Timestamps(&'a [i64]),
    /// Numbers that differ from row to row; nan is null.
    Numbers(&'a [f64]),
    /// Numbers that repeat over many rows; nan is null.
    Repeated(&'a [f64]),
    /// Numbers in single precision; nan is null.
    Single(&'a [f32]),
    /// Numbers in single precision that repeat over many rows; nan is null.
    RepeatedSingle(&'a [f32]),
    /// Signed counts of a converter.
    Counts(&'a [i32]),
    /// Bits and counts.
    Bits(&'a [u32]),
    /// The same of one byte.
    Bytes(&'a [u8]),
    /// Words by their index in a list.
    Words(&'a [u8], &'a [String]),
}

impl Column<'_> {
    fn len(&self) -> usize {
        match self {
            Column::Whole(v) | Column::Timestamps(v) => v.len(),
            Column::Numbers(v) | Column::Repeated(v) => v.len(),
            Column::Single(v) | Column::RepeatedSingle(v) => v.len(),
            Column::Counts(v) => v.len(),
            Column::Bits(v) => v.len(),
            Column::Bytes(v) | Column::Words(v, _) => v.len(),
        }
    }

    fn dtype(&self) -> ArrowDataType {
        match self {
            Column::Whole(_) => ArrowDataType::Int64,
            Column::Timestamps(_) => ArrowDataType::Timestamp(TimeUnit::Nanosecond, Some("UTC".into())),
            Column::Numbers(_) | Column::Repeated(_) => ArrowDataType::Float64,
            Column::Single(_) | Column::RepeatedSingle(_) => ArrowDataType::Float32,
            Column::Counts(_) => ArrowDataType::Int32,
            Column::Bits(_) => ArrowDataType::UInt32,
            Column::Bytes(_) => ArrowDataType::UInt8,
            Column::Words(..) => ArrowDataType::Dictionary(IntegerType::UInt32, Box::new(ArrowDataType::Utf8View), false),
        }
    }

    /// Lowest and highest value of a group help a reader who looks for times or flags, and nobody in numbers that differ from row to row.
    fn statistics(&self) -> StatisticsOptions {
        let ends = !matches!(self, Column::Numbers(_) | Column::Single(_));
        StatisticsOptions {
            min_value: ends,
            max_value: ends,
            distinct_count: false,
            null_count: true,
            ..StatisticsOptions::empty()
        }
    }

    fn may_be_null(&self) -> bool {
        matches!(self, Column::Numbers(_) | Column::Repeated(_) | Column::Single(_) | Column::RepeatedSingle(_))
    }

    fn encoding(&self) -> Encoding {
        match self {
            Column::Whole(_) | Column::Timestamps(_) => Encoding::DeltaBinaryPacked,
            Column::Numbers(_) | Column::Single(_) | Column::Counts(_) => Encoding::Plain,
            _ => Encoding::RleDictionary,
        }
    }

    fn array(&self) -> Result<Box<dyn Array>, PolarsError> {
        let dtype = self.dtype();
        Ok(match self {
            Column::Whole(v) | Column::Timestamps(v) => PrimitiveArray::try_new(dtype, v.to_vec().into(), None)?.boxed(),
            Column::Numbers(v) | Column::Repeated(v) => or_null(dtype, v, |v| !v.is_nan())?,
            Column::Single(v) | Column::RepeatedSingle(v) => or_null(dtype, v, |v| !v.is_nan())?,
            Column::Counts(v) => PrimitiveArray::try_new(dtype, v.to_vec().into(), None)?.boxed(),
            Column::Bits(v) => PrimitiveArray::try_new(dtype, v.to_vec().into(), None)?.boxed(),
            Column::Bytes(v) => PrimitiveArray::try_new(dtype, v.to_vec().into(), None)?.boxed(),
            Column::Words(codes, words) => {
                let keys: Vec<u32> = codes.iter().map(|code| u32::from(*code)).collect();
                let values = Utf8ViewArray::from_slice_values(words).boxed();
                DictionaryArray::try_new(dtype, PrimitiveArray::from_vec(keys), values)?.boxed()
            }
        })
    }
}

fn or_null<T: NativeType>(
    dtype: ArrowDataType,
    values: &[T],
    is_there: impl Fn(&T) -> bool,
) -> Result<Box<dyn Array>, PolarsError> {
    let validity = values.iter().any(|v| !is_there(v)).then(|| values.iter().map(&is_there).collect::<Bitmap>());
    Ok(PrimitiveArray::try_new(dtype, values.to_vec().into(), validity)?.boxed())
}

/// A column of a group as it stands in a file: several tables may hold the same one.
pub struct Encoded(Vec<CompressedPage>);

/// A long table on its way into a file.
pub struct LongWriter<W: Write> {
    writer: FileWriter<W>,
    types: Vec<ParquetType>,
    options: WriteOptions,
    metadata: Vec<KeyValue>,
}

/// The first level of zstd: columns of noisy numbers do not become smaller with higher ones, and take several times as long.
const LEVEL: i32 = 1;

impl<W: Write> LongWriter<W> {
    /// A table with the columns of a first group, none of them written yet; `metadata` are its keys and values.
    ///
    /// # Errors
    /// Types that the format does not have.
    pub fn new(file: W, columns: &[(&str, Column<'_>)], metadata: Vec<(String, String)>) -> Result<Self, Finding> {
        let field = |(name, column): &(&str, Column<'_>)| Field::new((*name).into(), column.dtype(), column.may_be_null());
        let schema: ArrowSchema = columns.iter().map(field).map(|f| (f.name.clone(), f)).collect();
        let options = WriteOptions {
            statistics: StatisticsOptions::empty(),
            version: Version::V1,
            compression: CompressionOptions::Zstd(Some(ZstdLevel::try_new(LEVEL).map_err(|e| wrong(&e))?)),
            data_page_size: None,
        };
        let writer = FileWriter::try_new(file, schema, options).map_err(|e| wrong(&e))?;
        let types = writer.parquet_schema().fields().to_vec();
        let metadata = metadata.into_iter().map(|(key, value)| KeyValue { key, value: Some(value) }).collect();
        Ok(Self { writer, types, options, metadata })
    }

    /// Writes a group of rows, the columns in the order of the first ones.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn write(&mut self, columns: &[(&str, Column<'_>)]) -> Result<(), Finding> {
        let none = vec![None; columns.len()];
        self.write_with(columns, &none).map(drop)
    }

    /// The same, where some columns were encoded for another table already; gives all columns as they stand in the file. The values of
    /// those that are known are not looked at.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn write_with(
        &mut self,
        columns: &[(&str, Column<'_>)],
        known: &[Option<Arc<Encoded>>],
    ) -> Result<Vec<Arc<Encoded>>, Finding> {
        let rows = columns.iter().map(|(_, column)| column.len()).max().unwrap_or(0);
        if rows == 0 {
            return Ok(Vec::new());
        }
        let options = self.options;
        let encoded: Vec<Arc<Encoded>> = columns
            .par_iter()
            .zip(&self.types)
            .zip(known)
            .map(|(((_, column), kind), known)| match known {
                Some(known) => Ok(Arc::clone(known)),
                None => encode(column, kind, options).map(Arc::new),
            })
            .collect::<Result<_, PolarsError>>()
            .map_err(|e| wrong(&e))?;
        let group = DynIter::new(encoded.iter().map(|column| {
            Ok(DynStreamingIterator::new(fallible_streaming_iterator::convert(column.0.iter().map(Ok::<_, PolarsError>))))
        }));
        self.writer.write(rows as u64, group).map_err(|e| wrong(&e))?;
        Ok(encoded)
    }

    /// Writes what ends the table.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn finish(mut self) -> Result<(), Finding> {
        // Words are text for every reader; that the file keeps each of them once is nobody's concern.
        let mut schema = self.writer.schema().clone();
        for field in schema.iter_values_mut() {
            if matches!(field.dtype, ArrowDataType::Dictionary(..)) {
                field.dtype = ArrowDataType::LargeUtf8;
            }
        }
        let mut metadata = vec![schema_to_metadata_key(&schema)];
        metadata.append(&mut self.metadata);
        self.writer.end(Some(metadata)).map(drop).map_err(|e| wrong(&e))
    }
}

fn encode(column: &Column<'_>, kind: &ParquetType, options: WriteOptions) -> Result<Encoded, PolarsError> {
    let options = WriteOptions { statistics: column.statistics(), ..options };
    let mut compressed = Vec::new();
    for pages in array_to_columns(column.array()?, kind.clone(), options, &[column.encoding()])? {
        let pages = pages.map(|page| page.map_err(|e| ParquetError::FeatureNotSupported(e.to_string())));
        for page in Compressor::new_from_vec(pages, options.compression, Vec::new()) {
            compressed.push(page?);
        }
    }
    Ok(Encoded(compressed))
}
