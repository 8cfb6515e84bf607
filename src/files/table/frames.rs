//! Columns of other software in the types that the tables of this program have: what they have as it is, short numbers as wider ones, moments and
//! days as text. Beside them stand these columns as they were read, for tables that pass them on.

use super::columns::{each, ns_of};
use super::guard::guarded;
use super::stream::refuse;
use crate::data::error::Finding;
use jiff::{SignedDuration, Timestamp, civil::Date};
use polars::prelude::{Column, DataFrame, NamedFrom, PlSmallStr, Series};
use polars_arrow::array::{Array, PrimitiveArray, new_empty_array};
use polars_arrow::compute::concatenate::concatenate;
use polars_arrow::datatypes::ArrowDataType;
use polars_arrow::types::NativeType;
use std::path::Path;

/// A column as a file has it: its name, its type, its pieces.
pub(super) type Pieces = (String, ArrowDataType, Vec<Box<dyn Array>>);

/// Whether the tables have a type themselves. Lists and bytes only pass.
pub(super) fn is_own(dtype: &ArrowDataType) -> bool {
    use ArrowDataType as T;
    match dtype {
        T::Boolean | T::Int32 | T::Int64 | T::UInt32 | T::UInt64 | T::Float32 | T::Float64 => true,
        T::Utf8 | T::LargeUtf8 | T::Utf8View | T::Binary | T::LargeBinary | T::BinaryView => true,
        T::List(of) | T::LargeList(of) => is_own(&of.dtype),
        _ => false,
    }
}

/// Columns as a file has them, by their names.
pub(super) type AsRead = Vec<(String, Box<dyn Array>)>;

/// Some rows of columns as a table, and those columns as they were read that have another type in it.
///
/// # Errors
/// A column of structures or another type that neither passes nor is a number, a text or a moment.
pub(super) fn frame_of(path: &Path, rows: usize, columns: Vec<Pieces>) -> Result<(DataFrame, AsRead), Finding> {
    let mut as_read = AsRead::new();
    let mut frame = Vec::with_capacity(columns.len());
    for (name, dtype, pieces) in columns {
        if !is_own(&dtype) {
            let pieces: Vec<&dyn Array> = pieces.iter().map(AsRef::as_ref).collect();
            let whole = if pieces.is_empty() { Ok(new_empty_array(dtype.clone())) } else { concatenate(&pieces) };
            as_read.push((name.clone(), whole.map_err(|e| refuse(path, &e))?));
        }
        frame.push(column_of(path, rows, (name, dtype, pieces))?);
    }
    Ok((DataFrame::new(rows, frame).map_err(|e| refuse(path, &e))?, as_read))
}

fn column_of(path: &Path, rows: usize, (name, dtype, pieces): Pieces) -> Result<Column, Finding> {
    use ArrowDataType as T;
    let pieces = if rows == 0 && pieces.is_empty() { vec![new_empty_array(dtype.clone())] } else { pieces };
    let series = match &dtype {
        own if is_own(own) && !pieces.is_empty() => {
            guarded(path, || Series::try_from((PlSmallStr::from_str(&name), pieces)).map_err(|e| refuse(path, &e)))?
        }
        T::Int8 => wider::<i8, i32>(&name, &pieces),
        T::Int16 => wider::<i16, i32>(&name, &pieces),
        T::UInt8 => wider::<u8, u32>(&name, &pieces),
        T::UInt16 => wider::<u16, u32>(&name, &pieces),
        T::Timestamp(unit, zone) => {
            let factor = i128::from(ns_of(*unit));
            let text = |value: &i64| moment(i128::from(*value) * factor, zone.is_some());
            texts::<i64>(&name, &pieces, text)
        }
        T::Date32 => texts::<i32>(&name, &pieces, |days| day(*days)),
        other => {
            let rule = format!("has the column `{name}` of the type {other:?}, which is no number, no text and no moment");
            return Err(Finding::error(&path.display().to_string(), rule, "take the column out, or write it as numbers or text"));
        }
    };
    Ok(series.into())
}

fn wider<T: NativeType, W: From<T>>(name: &str, pieces: &[Box<dyn Array>]) -> Series
where
    Series: NamedFrom<Vec<Option<W>>, [Option<W>]>,
{
    let values =
        each::<PrimitiveArray<T>, Option<W>>(pieces, |array, out| out.extend(array.iter().map(|v| v.map(|v| W::from(*v)))));
    Series::new(name.into(), values)
}

fn texts<T: NativeType>(name: &str, pieces: &[Box<dyn Array>], text: impl Fn(&T) -> Option<String>) -> Series {
    let values =
        each::<PrimitiveArray<T>, Option<String>>(pieces, |array, out| out.extend(array.iter().map(|v| v.and_then(&text))));
    Series::new(name.into(), values)
}

/// A moment, ns since 1970, as in `2014-08-01T12:00:00.5Z`; without the letter where the file states no zone.
fn moment(ns: i128, has_zone: bool) -> Option<String> {
    let moment = Timestamp::from_nanosecond(ns).ok()?;
    let text = moment.to_string();
    Some(if has_zone { text } else { text.trim_end_matches('Z').to_owned() })
}

/// A day, counted from 1970, as in `2014-08-01`.
fn day(days: i32) -> Option<String> {
    let begin = Date::constant(1970, 1, 1);
    Some(begin.checked_add(SignedDuration::from_hours(24 * i64::from(days))).ok()?.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::table::long::{Column as Long, LongWriter};
    use crate::files::table::stream::Reader;
    use polars_arrow::array::BooleanArray;
    use polars_arrow::datatypes::TimeUnit;

    fn of(dtype: ArrowDataType, pieces: Vec<Box<dyn Array>>) -> Result<Column, Finding> {
        column_of(Path::new("table.arrow"), 2, ("c".to_owned(), dtype, pieces))
    }

    #[test]
    fn moments_days_and_short_numbers_come_through() {
        let utc = ArrowDataType::Timestamp(TimeUnit::Microsecond, Some("UTC".into()));
        let at = PrimitiveArray::<i64>::from(vec![Some(1_406_894_400_500_000), None]).to(utc.clone()).boxed();
        let found = of(utc, vec![at]).unwrap();
        assert_eq!(found.str().unwrap().iter().collect::<Vec<_>>(), [Some("2014-08-01T12:00:00.5Z"), None]);
        let days = PrimitiveArray::<i32>::from(vec![Some(0), Some(16_283)]).to(ArrowDataType::Date32).boxed();
        let found = of(ArrowDataType::Date32, vec![days]).unwrap();
        assert_eq!(found.str().unwrap().iter().collect::<Vec<_>>(), [Some("1970-01-01"), Some("2014-08-01")]);
        let bytes = PrimitiveArray::<u8>::from(vec![Some(7), None]).boxed();
        let found = of(ArrowDataType::UInt8, vec![bytes]).unwrap();
        assert_eq!(found.u32().unwrap().iter().collect::<Vec<_>>(), [Some(7), None]);
    }

    #[test]
    fn a_table_of_telemetry_is_read_with_all_its_columns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vectors.parquet");
        let words = ["normal".to_owned(), "burst".to_owned()];
        let columns = [
            ("time_utc", Long::Timestamps(&[0, 1_500_000_000])),
            ("x", Long::Numbers(&[1.5, f64::NAN])),
            ("quality", Long::Bytes(&[3, 250])),
            ("mode", Long::Words(&[1, 0], &words)),
        ];
        let mut writer = LongWriter::new(std::fs::File::create(&path).unwrap(), &columns, Vec::new()).unwrap();
        writer.write(&columns).unwrap();
        writer.finish().unwrap();
        let mut reader = Reader::open(&path).unwrap();
        let batch = reader.next_batch().unwrap().unwrap();
        assert_eq!(batch.names(), ["time_utc", "x", "quality", "mode"]);
        assert_eq!(batch.texts(&path, "time_utc").unwrap(), ["1970-01-01T00:00:00Z", "1970-01-01T00:00:01.5Z"]);
        assert_eq!(batch.numbers(&path, "quality").unwrap(), [3.0, 250.0]);
        assert_eq!(batch.texts(&path, "mode").unwrap(), ["burst", "normal"]);
        assert!(batch.numbers(&path, "x").unwrap()[1].is_nan());
        assert!(reader.next_batch().unwrap().is_none());
    }

    #[test]
    fn what_is_no_number_text_or_moment_is_refused_by_name() {
        let told = of(ArrowDataType::Duration(TimeUnit::Second), vec![BooleanArray::from_slice([true]).boxed()]).unwrap_err();
        assert!(told.to_string().contains("column `c` of the type Duration"), "{told}");
    }
}
