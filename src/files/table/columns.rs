//! Tables of other software, Parquet and Arrow IPC, whole: their columns with the types that they have, times among them.

use super::footer::lists_fit;
use super::frames::Pieces;
use super::guard::guarded;
use crate::data::error::Finding;
use crate::files::import::{Cells, Format};
use crate::files::source::{open, room_for};
use polars_arrow::array::{Array, BooleanArray, PrimitiveArray, Utf8Array, Utf8ViewArray};
use polars_arrow::datatypes::{ArrowDataType, ArrowSchema, Field, TimeUnit};
use polars_arrow::io::ipc::read::{FileReader, read_file_metadata};
use polars_arrow::types::NativeType;
use polars_buffer::Buffer;
use polars_parquet::parquet::page::CompressedPage;
use polars_parquet::read::{
    BasicDecompressor, ColumnChunkMetadata, FileMetadata, PageReader, column_iter_to_arrays, infer_schema, read_metadata,
};
use std::fmt::Display;
use std::fs::File;
use std::io::{BufReader, Cursor};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

fn refuse(path: &Path, error: &dyn Display) -> Finding {
    let remedy = "the file is damaged, cut, or no table of its format; take it from the archive again";
    Finding::error(&path.display().to_string(), format!("cannot be read as a table: {error}"), remedy)
}

/// Reads all columns of a table.
///
/// # Errors
/// Why the file is no table of the format.
pub fn read(path: &Path, format: Format) -> Result<Vec<(String, Cells)>, Finding> {
    let columns = match format {
        Format::Parquet => parquet(path)?,
        Format::Ipc | Format::Csv => guarded(path, || ipc(path))?,
    };
    let mut list = Vec::with_capacity(columns.len());
    for (name, dtype, pieces) in columns {
        list.push((name, cells(&dtype, &pieces)));
    }
    Ok(list)
}

fn ipc(path: &Path) -> Result<Vec<Pieces>, Finding> {
    let mut file = BufReader::new(open(path)?);
    let metadata = read_file_metadata(&mut file).map_err(|e| refuse(path, &e))?;
    let mut columns: Vec<Pieces> =
        metadata.schema.iter_values().map(|f| (f.name.to_string(), f.dtype.clone(), Vec::new())).collect();
    for batch in FileReader::new(file, metadata, None, None) {
        let arrays = batch.map_err(|e| refuse(path, &e))?.into_arrays();
        columns.iter_mut().zip(arrays).for_each(|((_, _, pieces), array)| pieces.push(array));
    }
    Ok(columns)
}

/// A Parquet file, whose columns are read and decoded one by one.
pub(super) struct ParquetFile {
    path: PathBuf,
    file: File,
    metadata: FileMetadata,
    schema: ArrowSchema,
}

impl ParquetFile {
    pub(super) fn open(path: &Path) -> Result<Self, Finding> {
        let mut file = open(path)?;
        let (metadata, mut schema) = guarded(path, || {
            if !lists_fit(&mut file).map_err(|e| refuse(path, &e))? {
                return Err(refuse(path, &"its footer contradicts itself"));
            }
            let metadata = read_metadata(&mut file).map_err(|e| refuse(path, &e))?;
            let schema = infer_schema(&metadata).map_err(|e| refuse(path, &e))?;
            Ok((metadata, schema))
        })?;
        // A column that refers to a list of words in memory holds the words themselves in the file.
        for field in schema.iter_values_mut() {
            if let ArrowDataType::Dictionary(_, values, _) = &field.dtype {
                field.dtype = values.as_ref().clone();
            }
        }
        Ok(Self { path: path.to_owned(), file, metadata, schema })
    }

    /// The columns in their order.
    pub(super) fn fields(&self) -> impl Iterator<Item = &Field> {
        self.schema.iter_values()
    }

    /// The value of a key of its metadata.
    pub(super) fn says(&self, key: &str) -> Option<&str> {
        self.metadata.key_value_metadata.as_ref()?.iter().find(|entry| entry.key == key)?.value.as_deref()
    }

    /// Rows of every group.
    pub(super) fn group_rows(&self) -> Vec<usize> {
        self.metadata.row_groups.iter().map(|group| group.num_rows()).collect()
    }

    /// The values of a column in some groups of rows; none for columns of lists and structures.
    pub(super) fn pieces(&self, field: &Field, groups: &[usize]) -> Result<Vec<Box<dyn Array>>, Finding> {
        let mut pieces = Vec::new();
        for group in groups.iter().filter_map(|g| self.metadata.row_groups.get(*g)) {
            let chunks: Vec<&ColumnChunkMetadata> = group.columns_under_root_iter(&field.name).into_iter().flatten().collect();
            // Lists and structures have several, and are no columns of readings.
            let [chunk] = chunks[..] else { continue };
            if is_plain(&field.dtype) {
                pieces.extend(decoded(&self.path, &self.file, chunk, field, group.num_rows())?);
            }
        }
        Ok(pieces)
    }
}

fn parquet(path: &Path) -> Result<Vec<Pieces>, Finding> {
    let file = ParquetFile::open(path)?;
    let groups: Vec<usize> = (0..file.metadata.row_groups.len()).collect();
    let rows = file.group_rows().into_iter().fold(0_u64, |sum, rows| sum.saturating_add(rows as u64));
    room_for(path, rows.saturating_mul(file.fields().count() as u64).saturating_mul(CELL_BYTES))?;
    file.fields().map(|field| Ok((field.name.to_string(), field.dtype.clone(), file.pieces(field, &groups)?))).collect()
}

/// Reads a Parquet file to its end, one column of one group of rows after the other.
///
/// # Errors
/// Why it is no whole table.
pub fn check_parquet(path: &Path) -> Result<(), Finding> {
    let file = ParquetFile::open(path)?;
    for group in 0..file.metadata.row_groups.len() {
        file.fields().try_for_each(|field| file.pieces(field, &[group]).map(drop))?;
    }
    Ok(())
}

/// What a cell takes in memory, as it is decoded and as a number, a moment or a short text.
const CELL_BYTES: u64 = 24;

/// The values of a column in one group of rows.
fn decoded(
    path: &Path,
    file: &File,
    chunk: &ColumnChunkMetadata,
    field: &Field,
    rows: usize,
) -> Result<Vec<Box<dyn Array>>, Finding> {
    let range = chunk.byte_range();
    let size = file.metadata().map_err(|e| Finding::io(path, "read", &e))?.len();
    if range.start > range.end || range.end > size {
        let remedy = "the file is damaged or cut; take it from the archive again";
        return Err(Finding::error(
            &path.display().to_string(),
            format!("column `{}` reaches beyond the end of the file", field.name),
            remedy,
        ));
    }
    let mut bytes = vec![0; (range.end - range.start) as usize];
    file.read_exact_at(&mut bytes, range.start).map_err(|e| Finding::io(path, "read", &e))?;
    let bytes = Buffer::from(bytes);
    let pages = || PageReader::new(Cursor::new(bytes.clone()), chunk, Vec::new(), usize::MAX);
    guarded(path, || {
        check_pages(path, field, rows, pages())?;
        let kind = &chunk.descriptor().descriptor.primitive_type;
        let read = column_iter_to_arrays(vec![BasicDecompressor::new(pages(), Vec::new())], vec![kind], field.clone(), None);
        Ok(read.map_err(|e| refuse(path, &e))?.0)
    })
}

/// Whether the pages of a column hold a value for every row, and find room: the decoder asks for as much memory as they state.
fn check_pages(path: &Path, field: &Field, rows: usize, pages: PageReader) -> Result<(), Finding> {
    let mut values = 0_usize;
    for page in pages {
        if let CompressedPage::Data(page) = page.map_err(|e| refuse(path, &e))? {
            values = values.saturating_add(page.num_values());
            room_for(path, page.uncompressed_size() as u64)?;
        }
    }
    if values == rows {
        return Ok(());
    }
    Err(refuse(path, &format!("column `{}` states {values} values for {rows} rows", field.name)))
}

/// Types whose values are single numbers, texts or moments.
fn is_plain(dtype: &ArrowDataType) -> bool {
    use ArrowDataType as T;
    dtype.is_numeric()
        || matches!(dtype, T::Boolean | T::Utf8 | T::LargeUtf8 | T::Utf8View | T::Timestamp(..) | T::Date32 | T::Null)
}

/// The pieces of a column as one.
fn cells(dtype: &ArrowDataType, pieces: &[Box<dyn Array>]) -> Cells {
    use ArrowDataType as T;
    match dtype {
        T::Int8 => numbers::<i8>(pieces, f64::from),
        T::Int16 => numbers::<i16>(pieces, f64::from),
        T::Int32 => numbers::<i32>(pieces, f64::from),
        T::Int64 => numbers::<i64>(pieces, |v| v as f64),
        T::UInt8 => numbers::<u8>(pieces, f64::from),
        T::UInt16 => numbers::<u16>(pieces, f64::from),
        T::UInt32 => numbers::<u32>(pieces, f64::from),
        T::UInt64 => numbers::<u64>(pieces, |v| v as f64),
        T::Float32 => numbers::<f32>(pieces, f64::from),
        T::Float64 => numbers::<f64>(pieces, |v| v),
        T::Boolean => Cells::Numbers(each::<BooleanArray, _>(pieces, |array, out| {
            out.extend(array.iter().map(|v| v.map_or(f64::NAN, |v| f64::from(u8::from(v)))));
        })),
        T::Utf8 => texts::<Utf8Array<i32>>(pieces, |array, out| out.extend(array.iter().map(owned))),
        T::LargeUtf8 => texts::<Utf8Array<i64>>(pieces, |array, out| out.extend(array.iter().map(owned))),
        T::Utf8View => texts::<Utf8ViewArray>(pieces, |array, out| out.extend(array.iter().map(owned))),
        T::Timestamp(unit, zone) => {
            let factor = ns_of(*unit);
            let ns = each::<PrimitiveArray<i64>, _>(pieces, |array, out| {
                out.extend(array.iter().map(|v| v.and_then(|v| v.checked_mul(factor))));
            });
            Cells::Moments { ns, utc: zone.is_some() }
        }
        other => Cells::Other(format!("values of the type {other:?}")),
    }
}

/// ns in a unit of timestamps.
pub(super) fn ns_of(unit: TimeUnit) -> i64 {
    match unit {
        TimeUnit::Second => 1_000_000_000,
        TimeUnit::Millisecond => 1_000_000,
        TimeUnit::Microsecond => 1000,
        TimeUnit::Nanosecond => 1,
    }
}

fn owned(value: Option<&str>) -> String {
    value.unwrap_or_default().to_owned()
}

pub(super) fn each<A: 'static, T>(pieces: &[Box<dyn Array>], take: impl Fn(&A, &mut Vec<T>)) -> Vec<T> {
    let mut out = Vec::with_capacity(pieces.iter().map(|piece| piece.len()).sum());
    for piece in pieces {
        if let Some(array) = piece.as_any().downcast_ref::<A>() {
            take(array, &mut out);
        }
    }
    out
}

fn numbers<T: NativeType>(pieces: &[Box<dyn Array>], convert: impl Fn(T) -> f64) -> Cells {
    Cells::Numbers(each::<PrimitiveArray<T>, _>(pieces, |array, out| {
        out.extend(array.iter().map(|v| v.map_or(f64::NAN, |v| convert(*v))));
    }))
}

fn texts<A: 'static>(pieces: &[Box<dyn Array>], take: impl Fn(&A, &mut Vec<String>)) -> Cells {
    Cells::Texts(each::<A, String>(pieces, take))
}
