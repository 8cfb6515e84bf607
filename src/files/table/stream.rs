//! Long tables, read and written batch by batch: CSV, Parquet, Arrow IPC.

use super::as_read::AsReadWriter;
use super::columns::ParquetFile;
use super::frames::{AsRead, frame_of, is_own};
use super::guard::guarded;
use super::wrong;
use crate::data::error::Finding;
pub use crate::files::import::Format;
use crate::files::output::Pending;
use crate::files::source;
use crate::files::text::LONGEST_LINE;
use polars::io::csv::write::BatchedWriter as CsvBatches;
use polars::io::parquet::write::BatchedWriter as ParquetBatches;
use polars::prelude::{
    Column, CsvReadOptions, CsvWriter, DataFrame, DataType, KeyValueMetadata, ParquetCompression, ParquetReader, ParquetWriter,
    PolarsError, SerReader, SerWriter,
};
use polars_arrow::io::ipc::read::{FileReader, read_file_metadata};
use polars_arrow::record_batch::RecordBatch;
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

/// Rows of a batch: long enough for whole row groups of a usual Parquet file, short enough that a few batches take little memory.
const BATCH: usize = 1 << 18;

/// Some rows of a table with all their columns.
#[derive(Clone, Debug)]
pub struct Batch {
    frame: DataFrame,
    /// Columns that had another type in the file, as they were read.
    as_read: AsRead,
    /// Rows of the table before these.
    before: usize,
    /// Lines of the rows in a file of text.
    lines: Vec<u64>,
}

/// A table that is read batch by batch.
pub struct Reader {
    path: PathBuf,
    source: Rows,
    /// Rows read so far.
    done: usize,
}

enum Rows {
    Csv(Box<CsvRows>),
    Parquet {
        pieces: Box<dyn Iterator<Item = (usize, usize)> + Send>,
    },
    /// Parquet with columns of other types, group by group.
    Columns {
        file: Box<ParquetFile>,
        group: usize,
    },
    Ipc(Box<FileReader<BufReader<File>>>),
}

/// Lines of a CSV file. Cells stay text, so that columns that only pass go out as they came in.
struct CsvRows {
    lines: BufReader<File>,
    header: String,
    /// Cells of a row.
    cells: usize,
    /// Lines read so far.
    line: u64,
    /// Lines of the rows of the batch.
    lines_of: Vec<u64>,
    /// Whether a batch was read.
    begun: bool,
}

pub(super) fn refuse(path: &Path, error: &PolarsError) -> Finding {
    let file = path.display().to_string();
    if error.to_string().contains("more fields than defined") {
        let remedy =
            "write a comma between cells and a point in decimal fractions, or make a run of the table with `calfit import`";
        return Finding::error(&file, "cannot be read as a table: a row has more cells than the header line", remedy);
    }
    // What the library advises is for those who program with it.
    let first = error.to_string().lines().next().unwrap_or_default().to_owned();
    Finding::error(&file, format!("cannot be read as a table: {first}"), "check the file")
}

impl Reader {
    /// Opens a table.
    ///
    /// # Errors
    /// A name that tells no format, a file that cannot be opened or is no table of it.
    pub fn open(path: &Path) -> Result<Self, Finding> {
        let open = || source::open(path);
        let source = match Format::of_name(path) {
            Some(Format::Csv) => Rows::Csv(Box::new(CsvRows::open(path, open()?)?)),
            Some(Format::Parquet) => {
                let file = ParquetFile::open(path)?;
                if !file.fields().all(|field| is_own(&field.dtype)) {
                    return Ok(Self { path: path.to_owned(), source: Rows::Columns { file: Box::new(file), group: 0 }, done: 0 });
                }
                Rows::Parquet { pieces: Box::new(pieces(file.group_rows())) }
            }
            Some(Format::Ipc) => {
                let mut file = BufReader::new(open()?);
                let metadata = guarded(path, || read_file_metadata(&mut file).map_err(|e| refuse(path, &e)))?;
                Rows::Ipc(Box::new(FileReader::new(file, metadata, None, None)))
            }
            None => {
                let rule = "is no table: its name ends neither with .csv, .parquet, .pq, .arrow, .feather nor .ipc";
                return Err(Finding::error(&path.display().to_string(), rule, "name the file after its format"));
            }
        };
        Ok(Self { path: path.to_owned(), source, done: 0 })
    }

    /// The next rows; `None` after the last ones. A table without rows has one batch of none.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn next_batch(&mut self) -> Result<Option<Batch>, Finding> {
        let plain = |frame: DataFrame| (frame, AsRead::new());
        let frame = match &mut self.source {
            Rows::Csv(rows) => rows.next_frame(&self.path)?.map(plain),
            Rows::Parquet { pieces } => match pieces.next() {
                None => None,
                Some(piece) => {
                    let file = source::open(&self.path)?;
                    let read = || ParquetReader::new(file).with_slice(Some(piece)).finish().map_err(|e| refuse(&self.path, &e));
                    Some(plain(guarded(&self.path, read)?))
                }
            },
            Rows::Ipc(reader) => {
                let next = guarded(&self.path, || reader.next().transpose().map_err(|e| refuse(&self.path, &e)))?;
                let columns = |batch: RecordBatch| {
                    let rows = batch.len();
                    let (schema, arrays) = batch.into_schema_and_arrays();
                    let named = schema.iter_values().map(|field| (field.name.to_string(), field.dtype.clone()));
                    let pieces = named.zip(arrays).map(|((name, dtype), array)| (name, dtype, vec![array])).collect();
                    frame_of(&self.path, rows, pieces)
                };
                next.map(columns).transpose()?
            }
            Rows::Columns { file, group } => {
                let rows = file.group_rows();
                let last = rows.len().max(1);
                if *group >= last {
                    None
                } else {
                    let columns = file.fields().map(|f| Ok((f.name.to_string(), f.dtype.clone(), file.pieces(f, &[*group])?)));
                    let columns = columns.collect::<Result<_, Finding>>()?;
                    let frame = frame_of(&self.path, rows.get(*group).copied().unwrap_or_default(), columns)?;
                    *group += 1;
                    Some(frame)
                }
            }
        };
        let before = self.done;
        Ok(frame.map(|(frame, as_read)| {
            self.done += frame.height();
            let lines = match &mut self.source {
                Rows::Csv(rows) => std::mem::take(&mut rows.lines_of),
                _ => Vec::new(),
            };
            Batch { frame, as_read, before, lines }
        }))
    }
}

/// Slices of row groups, none of them longer than a batch; one empty slice for a table without rows. A damaged file states any number of
/// rows, so that no list is made of them.
fn pieces(groups: Vec<usize>) -> impl Iterator<Item = (usize, usize)> + Send {
    let empty = groups.iter().all(|rows| *rows == 0).then_some((0, 0));
    let mut done = 0_usize;
    let slices = groups.into_iter().flat_map(move |rows| {
        let (begin, end) = (done, done.saturating_add(rows));
        done = end;
        (begin..end).step_by(BATCH).map(move |at| (at, BATCH.min(end - at)))
    });
    slices.chain(empty)
}

impl CsvRows {
    fn open(path: &Path, file: File) -> Result<Self, Finding> {
        let lines = BufReader::with_capacity(1 << 20, file);
        let mut rows = Self { lines, header: String::new(), cells: 0, line: 0, lines_of: Vec::new(), begun: false };
        let mut line = Vec::new();
        loop {
            line.clear();
            if rows.read_row(path, &mut line)? == 0 {
                let remedy = "write the names of the columns into the first line";
                return Err(Finding::error(&path.display().to_string(), "has no header line", remedy));
            }
            let text = line.trim_ascii();
            if !text.is_empty() && !text.starts_with(b"#") {
                break;
            }
        }
        rows.cells = cells(&line);
        if rows.cells == 1 && line.contains(&b';') {
            let rule = "has its cells apart by semicolons, and no comma: a table of vectors has commas between cells and a point in decimal fractions";
            let remedy = "write it anew with commas and decimal points, or make a run of it with `calfit import`";
            return Err(rows.refuse(path, &line, rule, remedy));
        }
        rows.header = String::from_utf8(line).map_err(|e| rows.refuse(path, e.as_bytes(), "is not UTF-8 text", "convert it"))?;
        if let Some(twice) = named_twice(&rows.header) {
            let rule = format!("names two columns `{twice}`, of which nobody knows which is meant");
            return Err(rows.refuse(path, rows.header.trim_end().as_bytes(), &rule, "rename one of them, or take it out"));
        }
        if !rows.header.ends_with('\n') {
            rows.header.push('\n');
        }
        Ok(rows)
    }

    /// Adds the next row to the text, with its line end; its length, 0 behind the last one.
    fn read_row(&mut self, path: &Path, text: &mut Vec<u8>) -> Result<usize, Finding> {
        let begin = text.len();
        let io = |e: std::io::Error| Finding::io(path, "read", &e);
        loop {
            // A file without line ends must not fill the memory.
            let length = (&mut self.lines).take(LONGEST_LINE as u64).read_until(b'\n', text).map_err(io)?;
            self.line += u64::from(length > 0);
            if self.line == 1 && text[begin..].starts_with(b"\xef\xbb\xbf") {
                text.drain(begin..begin + 3);
            }
            let row = &text[begin..];
            if self.line == 1 && (row.starts_with(b"\xff\xfe") || row.starts_with(b"\xfe\xff")) {
                return Err(self.refuse(path, row, "is UTF-16 text", "convert it to UTF-8"));
            }
            let line = &text[text.len() - length.min(row.len())..];
            if let Some(at) = memchr::memchr(0, line) {
                return Err(self.refuse(
                    path,
                    &line[at..],
                    "holds a NUL byte, as files have after a power loss",
                    "take it from the archive again",
                ));
            }
            let body = line.strip_suffix(b"\n").unwrap_or(line);
            if memchr::memchr(b'\r', body.strip_suffix(b"\r").unwrap_or(body)).is_some() {
                return Err(self.refuse(path, row, "has CR line ends", "convert them to LF"));
            }
            if length >= LONGEST_LINE {
                return Err(self.refuse(path, row, "is longer than any row of a table", "check that this is a table of text"));
            }
            // A line that ends within quotes goes on in the next one.
            if length == 0 || memchr::memchr_iter(b'"', row).count().is_multiple_of(2) {
                return Ok(row.len());
            }
        }
    }

    fn refuse(&self, path: &Path, found: &[u8], rule: &str, remedy: &str) -> Finding {
        Finding::error(&path.display().to_string(), format!("the line {rule}"), remedy).at(self.line, 0).found(found)
    }

    fn next_frame(&mut self, path: &Path) -> Result<Option<DataFrame>, Finding> {
        let mut text = self.header.clone().into_bytes();
        let mut rows = 0;
        self.lines_of.clear();
        while rows < BATCH {
            let begin = text.len();
            if self.read_row(path, &mut text)? == 0 {
                break;
            }
            if text[begin..].trim_ascii().is_empty() {
                text.truncate(begin);
                continue;
            }
            if !text.ends_with(b"\n") {
                let rule = format!("the file ends inside a line; the last good row is line {}", self.line.saturating_sub(1));
                let remedy = "take the file from the archive again, or, if its last row is whole, put a line end behind it";
                let finding = Finding::error(&path.display().to_string(), rule, remedy).at(self.line, 1);
                return Err(finding.found(&text[begin..]));
            }
            rows += 1;
            self.lines_of.push(self.line);
            let found = cells(&text[begin..]);
            if found != self.cells {
                let rule = format!("has {found} cells where the header line has {}", self.cells);
                return Err(self.refuse(path, &text[begin..], &rule, "complete the row or take it out"));
            }
        }
        // A table without rows has one batch of none; every further batch has rows.
        if rows == 0 && self.begun {
            return Ok(None);
        }
        self.begun = true;
        let options = CsvReadOptions::default().with_has_header(true).with_infer_schema_length(Some(0));
        let frame = options.into_reader_with_file_handle(Cursor::new(text)).finish().map_err(|e| refuse(path, &e))?;
        Ok(Some(frame))
    }
}

/// The first name that stands twice in a header line.
fn named_twice(header: &str) -> Option<String> {
    let mut is_quoted = false;
    let names = header.trim_end().split(|c: char| {
        is_quoted ^= c == '"';
        c == ',' && !is_quoted
    });
    let mut seen = HashSet::new();
    names.map(|name| name.trim().trim_matches('"')).find(|name| !name.is_empty() && !seen.insert(*name)).map(str::to_owned)
}

/// Cells of a row; commas within quotes divide nothing.
fn cells(row: &[u8]) -> usize {
    if memchr::memchr(b'"', row).is_none() {
        return memchr::memchr_iter(b',', row).count() + 1;
    }
    let mut is_quoted = false;
    let divides = |b: &&u8| {
        is_quoted ^= **b == b'"';
        **b == b',' && !is_quoted
    };
    row.iter().filter(divides).count() + 1
}

/// Bytes of a row before a cell; commas within quotes divide nothing.
fn begin_of_cell(row: &[u8], cell: usize) -> usize {
    let mut is_quoted = false;
    let mut before = cell;
    for (at, byte) in row.iter().enumerate() {
        if before == 0 {
            return at;
        }
        is_quoted ^= *byte == b'"';
        before -= usize::from(*byte == b',' && !is_quoted);
    }
    row.len()
}

impl Batch {
    /// Rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frame.height()
    }

    /// Whether there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Rows of the table before these.
    #[must_use]
    pub fn before(&self) -> usize {
        self.before
    }

    /// Whether the table has a column.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.frame.column(name).is_ok()
    }

    /// Names of the columns.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.frame.columns().iter().map(|c| c.name().to_string()).collect()
    }

    /// A column as numbers; an empty cell is nan.
    ///
    /// # Errors
    /// No such column, or a cell that is no number, with its row.
    pub fn numbers(&self, path: &Path, name: &str) -> Result<Vec<f64>, Finding> {
        let shown = path.display().to_string();
        let column = self.column(path, name)?;
        if column.dtype() == &DataType::String {
            let cells = column.str().map_err(|e| refuse(path, &e))?;
            let number = |(row, cell): (usize, Option<&str>)| match cell.map(str::trim) {
                None | Some("") => Ok(f64::NAN),
                Some(text) => text.parse().map_err(|_| {
                    let row = self.before + row + 1;
                    let rule = format!("row {row}: the cell in column `{name}` is no number");
                    let finding = Finding::error(&shown, rule, "correct it, or leave the cell empty").found(text.as_bytes());
                    self.placed(finding, path, name, row - self.before - 1)
                }),
            };
            return cells.iter().enumerate().map(number).collect();
        }
        if !column.dtype().is_primitive_numeric() {
            let rule = format!("column `{name}` holds {}, not numbers", column.dtype());
            return Err(Finding::error(&shown, rule, "name a column of numbers"));
        }
        let cast = column.cast(&DataType::Float64).map_err(|e| refuse(path, &e))?;
        let values = cast.f64().map_err(|e| refuse(path, &e))?;
        Ok(values.iter().map(|v| v.unwrap_or(f64::NAN)).collect())
    }

    /// A finding with line and byte column of a cell in a file of text; `row` is that of the batch.
    pub(super) fn placed(&self, finding: Finding, path: &Path, name: &str, row: usize) -> Finding {
        let place = || {
            let line = *self.lines.get(row)?;
            let column = self.names().iter().position(|own| own == name)?;
            // Errors are few, and the text of the row was not kept.
            let text = BufReader::new(File::open(path).ok()?).split(b'\n').nth(usize::try_from(line).ok()? - 1)?.ok()?;
            Some((line, begin_of_cell(&text, column) as u64 + 1))
        };
        match place() {
            Some((line, column)) => finding.at(line, column),
            None => finding,
        }
    }

    /// A column of text; an empty cell is empty text. Cells of CSV are text whatever they hold.
    ///
    /// # Errors
    /// No such column, or one that holds no text.
    pub fn texts(&self, path: &Path, name: &str) -> Result<Vec<String>, Finding> {
        let column = self.column(path, name)?;
        let cells = column.str().map_err(|e| refuse(path, &e))?;
        Ok(cells.iter().map(|cell| cell.unwrap_or_default().to_owned()).collect())
    }

    fn column(&self, path: &Path, name: &str) -> Result<&Column, Finding> {
        self.frame.column(name).map_err(|_| {
            let rule = format!("has no column `{name}`; it has {}", self.names().join(", "));
            Finding::error(&path.display().to_string(), rule, "rename the column, or name another one")
        })
    }

    /// The same with a further column; nan becomes an empty cell.
    ///
    /// # Errors
    /// Another number of rows.
    pub fn push(&mut self, name: &str, values: Vec<f64>) -> Result<(), Finding> {
        let column = if values.iter().any(|v| v.is_nan()) {
            let cells: Vec<Option<f64>> = values.into_iter().map(|v| (!v.is_nan()).then_some(v)).collect();
            Column::new(name.into(), cells)
        } else {
            Column::new(name.into(), values)
        };
        self.frame.with_column(column).map(drop).map_err(|e| wrong(&e))
    }

    /// The same with a further column of bits.
    ///
    /// # Errors
    /// Another number of rows.
    pub fn push_bits(&mut self, name: &str, values: Vec<u32>) -> Result<(), Finding> {
        self.frame.with_column(Column::new(name.into(), values)).map(drop).map_err(|e| wrong(&e))
    }

    /// A batch of columns of numbers.
    ///
    /// # Errors
    /// Columns of unequal length.
    pub fn of_numbers(columns: Vec<(&str, Vec<f64>)>, before: usize) -> Result<Self, Finding> {
        let height = columns.first().map_or(0, |(_, values)| values.len());
        let mut batch = Self { frame: DataFrame::empty_with_height(height), as_read: AsRead::new(), before, lines: Vec::new() };
        columns.into_iter().try_for_each(|(name, values)| batch.push(name, values))?;
        Ok(batch)
    }
}

/// A table that is written batch by batch into a file that has its name only once it is complete. The first batch says which columns it has.
pub struct Writer<'a> {
    file: Option<&'a mut Pending>,
    format: Format,
    note: &'a str,
    to: Option<To<'a>>,
}

enum To<'a> {
    Csv(CsvBatches<&'a mut Pending>),
    Parquet(Box<ParquetBatches<&'a mut Pending>>),
    /// Parquet with columns that pass in the types of their file.
    AsRead(Box<AsReadWriter<&'a mut Pending>>),
}

impl<'a> Writer<'a> {
    /// A table without batches so far. `note` is what the file says of itself: a comment line of CSV, an entry of the metadata of Parquet.
    pub fn new(file: &'a mut Pending, format: Format, note: &'a str) -> Self {
        Self { file: Some(file), format, note, to: None }
    }

    /// Whether a batch was written.
    #[must_use]
    pub fn has_begun(&self) -> bool {
        self.to.is_some()
    }

    /// Writes a batch.
    ///
    /// # Errors
    /// Other columns than those of the first batch, or what the operating system says.
    pub fn write(&mut self, batch: &Batch) -> Result<(), Finding> {
        if let Some(file) = self.file.take() {
            self.to = Some(To::begin(file, self.format, batch, self.note)?);
        }
        match &mut self.to {
            Some(To::Csv(writer)) => writer.write_batch(&batch.frame),
            Some(To::Parquet(writer)) => writer.write_batch(&batch.frame),
            Some(To::AsRead(writer)) => writer.write(&batch.frame, &batch.as_read),
            None => Ok(()),
        }
        .map_err(|e| wrong(&e))
    }

    /// Writes what ends the table.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn finish(self) -> Result<(), Finding> {
        match self.to {
            Some(To::Csv(mut writer)) => writer.finish(),
            Some(To::Parquet(writer)) => writer.finish().map(drop),
            Some(To::AsRead(writer)) => writer.finish(),
            None => Ok(()),
        }
        .map_err(|e| wrong(&e))
    }
}

impl<'a> To<'a> {
    fn begin(file: &'a mut Pending, format: Format, first: &Batch, note: &str) -> Result<Self, Finding> {
        let schema = first.frame.schema();
        if format == Format::Csv {
            use std::io::Write;
            let line = format!("# calfit {note}\n");
            file.write_all(line.as_bytes()).map_err(|e| Finding::error("table", e.to_string(), "check the disk"))?;
            return Ok(To::Csv(CsvWriter::new(file).batched(schema).map_err(|e| wrong(&e))?));
        }
        let says = vec![
            ("written_by".to_owned(), format!("calfit {}", env!("CARGO_PKG_VERSION"))),
            ("calfit".to_owned(), note.to_owned()),
        ];
        if !first.as_read.is_empty() {
            let writer = AsReadWriter::new(file, &first.frame, &first.as_read, says).map_err(|e| wrong(&e))?;
            return Ok(To::AsRead(Box::new(writer)));
        }
        let mark = KeyValueMetadata::from_static(says);
        let writer =
            ParquetWriter::new(file).with_key_value_metadata(Some(mark)).with_compression(ParquetCompression::Zstd(None));
        Ok(To::Parquet(Box::new(writer.batched(schema).map_err(|e| wrong(&e))?)))
    }
}

/// The same table of CSV with another note at its head, for what is known only once its rows are written. The file that was written first vanishes.
///
/// # Errors
/// What the operating system says.
pub fn with_note(mut written: Pending, mut file: Pending, note: &str) -> Result<Pending, Finding> {
    use std::io::Write;
    let failed = |e: std::io::Error| Finding::error("table", e.to_string(), "check the disk");
    let mut from = BufReader::new(File::open(written.so_far()?).map_err(failed)?);
    from.read_until(b'\n', &mut Vec::new()).map_err(failed)?;
    file.write_all(format!("# calfit {note}\n").as_bytes()).map_err(failed)?;
    std::io::copy(&mut from, &mut file).map_err(failed)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_text_are_placed_by_line_and_byte() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("t.csv");
        std::fs::write(&path, "# of a laboratory\nname,x,y\n\"a,b\",1,2\nµ,3,abc\n").unwrap();
        let batch = Reader::open(&path).unwrap().next_batch().unwrap().unwrap();
        let told = batch.numbers(&path, "y").unwrap_err();
        // The fourth line begins with a letter of two bytes.
        assert_eq!((told.line, told.column), (Some(4), Some(6)), "{told}");
        assert!(told.to_string().contains("row 2") && told.to_string().contains("abc"), "{told}");
        assert_eq!(begin_of_cell(b"\"a,b\",1,2", 2), 8);
    }

    #[test]
    fn groups_of_rows_are_cut_into_batches_however_many_a_damaged_file_states() {
        let of = |groups: &[usize]| pieces(groups.to_vec()).take(4).collect::<Vec<_>>();
        assert_eq!(of(&[]), [(0, 0)]);
        assert_eq!(of(&[0, 0]), [(0, 0)]);
        assert_eq!(of(&[3, 0, BATCH + 1]), [(0, 3), (3, BATCH), (BATCH + 3, 1)]);
        assert_eq!(of(&[3, usize::MAX, 5])[..2], [(0, 3), (3, BATCH)]);
    }
}
