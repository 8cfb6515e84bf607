//! The reader of run files: one pass, bounded memory, every byte validated.

use super::Section;
use super::layout::Layout;
use super::vectors::{Clock, Row, Tick, WINDOW, plain_row};
use crate::data::error::{Finding, Severity, excerpt};
use crate::data::run::{GivenBlock, Header, InputFile, Run, ScalarRow, Setting, SlowTable, Vector, VectorSink};
use crate::data::units::{FieldCoil, Reading};
use crate::files::source::{Piece, read_pieces};
use crate::files::text::{Cell, Columns, LONGEST_LINE, columns, decode, not_a_number, number};
use std::path::Path;

/// How a run file is read.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Read what is there of a file that ends before `@END`.
    pub allow_truncated: bool,
    /// Leave out repeated rows, however many.
    pub allow_duplicates: bool,
    /// Go on after an error, so that all of them are found. The first error still refuses the file.
    pub collect: bool,
    /// Read and hash on a second thread.
    pub two_threads: bool,
    /// Path to be shown and recorded in place of the one that is opened.
    pub recorded_path: Option<String>,
}

/// Errors of one file that are listed before the reader gives up.
const MOST_ERRORS: usize = 100;
/// Rows of other layouts after which one of them is learnt.
const MOST_DOUBTS: u32 = 64;
/// Bytes of TOML keys that are accepted.
const LONGEST_HEAD: usize = 1 << 20;

/// Reads a run file; its vectors go to `sink`, everything else is returned.
///
/// A file whose samples stand before its settings is read twice if the sink needs the settings first.
///
/// # Errors
/// All findings of the file, at least one of them an error: what the file system says, or the place, text, rule and remedy of what
/// is wrong with the file.
pub fn read<S: VectorSink>(path: &Path, options: &Options, sink: &mut S) -> Result<Run, Vec<Finding>> {
    let name = options.recorded_path.clone().unwrap_or_else(|| path.display().to_string());
    let mut parser = Parser::new(&name, options, sink);
    match parser.run(path) {
        Ok(()) => parser.finish(),
        Err(Stop::Error(finding)) => {
            parser.findings.push(*finding);
            Err(parser.findings)
        }
        Err(Stop::SettingsComeLater) => {
            let settings = read(path, options, &mut ())?.settings;
            let mut parser = Parser::new(&name, options, sink);
            parser.settings_known = Some(settings);
            match parser.run(path) {
                Ok(()) => parser.finish(),
                Err(Stop::Error(finding)) => Err(vec![*finding]),
                Err(Stop::SettingsComeLater) => {
                    Err(vec![Finding::error(&name, "changed while it was read", "wait until it is complete and run again")])
                }
            }
        }
    }
}

/// Reads the keys of a run file and nothing after them.
///
/// # Errors
/// As [`read`].
pub fn peek(path: &Path) -> Result<Header, Vec<Finding>> {
    let name = path.display().to_string();
    let mut nowhere = ();
    let options = Options::default();
    let mut parser = Parser::new(&name, &options, &mut nowhere);
    // The keys stand at the begin, so the first piece is enough; stopping there is not an error.
    let stopped = read_pieces(path, false, |piece| {
        let result = parser.piece(piece);
        match (&parser.header, result) {
            (None, Ok(())) => Ok(()),
            (None, Err(Stop::Error(finding))) => Err(*finding),
            _ => Err(Finding::error(&name, "", "")),
        }
    });
    match (parser.header, stopped) {
        (Some(header), _) => Ok(header),
        (None, Err(finding)) => Err(vec![finding]),
        (None, Ok(_)) => {
            Err(vec![Finding::error(&name, "the file has no keys and no sections", "check that this is a run file")])
        }
    }
}

enum Stop {
    Error(Box<Finding>),
    SettingsComeLater,
}

impl From<Finding> for Stop {
    fn from(finding: Finding) -> Self {
        Stop::Error(Box::new(finding))
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Magic,
    Head,
    ColumnNames(Section),
    Rows(Section),
    UnknownSection,
    Ended,
}

struct Parser<'a, S> {
    file: &'a str,
    options: &'a Options,
    sink: &'a mut S,
    state: State,
    /// Number of the line that is being read, from 1.
    line: u64,
    last_good_line: u64,
    head: String,
    header: Option<Header>,
    seen: Vec<Section>,
    columns: Columns,
    /// The columns of `@VECTORS` are exactly the wanted ones in order, so rows can take the fast path.
    plain_columns: bool,
    /// Layout of a recent row, which the next rows most likely have too.
    layout: Option<Layout>,
    /// Rows of other layouts since, less the rows of this one.
    doubts: u32,
    clock: Clock,
    begun: bool,
    scale: f64,
    settings_known: Option<Vec<Setting>>,
    settings: Vec<Setting>,
    blocks: Vec<GivenBlock>,
    temperatures: SlowTable,
    channels: SlowTable,
    scalar: Vec<ScalarRow>,
    input: InputFile,
    findings: Vec<Finding>,
    errors: usize,
}

impl<'a, S: VectorSink> Parser<'a, S> {
    fn new(file: &'a str, options: &'a Options, sink: &'a mut S) -> Self {
        Self {
            file,
            options,
            sink,
            state: State::Magic,
            line: 0,
            last_good_line: 0,
            head: String::new(),
            header: None,
            seen: Vec::new(),
            columns: Columns { names: Vec::new(), wanted: Vec::new() },
            plain_columns: false,
            layout: None,
            doubts: 0,
            clock: Clock::new(1.0),
            begun: false,
            scale: 1.0,
            settings_known: None,
            settings: Vec::new(),
            blocks: Vec::new(),
            temperatures: SlowTable::default(),
            channels: SlowTable::default(),
            scalar: Vec::new(),
            input: InputFile { path: file.to_owned(), size_bytes: 0, sha256: String::new() },
            findings: Vec::new(),
            errors: 0,
        }
    }

    fn run(&mut self, path: &Path) -> Result<(), Stop> {
        // The chunk reader knows one kind of error; a restart is noted beside it.
        let mut restart = false;
        let result = read_pieces(path, self.options.two_threads, |piece| {
            self.piece(piece).map_err(|stop| match stop {
                Stop::Error(finding) => *finding,
                Stop::SettingsComeLater => {
                    restart = true;
                    Finding::error("", "", "")
                }
            })
        });
        if restart {
            return Err(Stop::SettingsComeLater);
        }
        let digested = result.map_err(|mut finding| {
            finding.file = self.file.into();
            finding
        })?;
        self.input.size_bytes = digested.size_bytes;
        self.input.sha256 = digested.sha256;
        Ok(())
    }

    fn piece(&mut self, piece: Piece) -> Result<(), Stop> {
        match piece {
            Piece::Lines(bytes) => self.lines(bytes),
            Piece::Rest(bytes) => self.rest(bytes),
            Piece::Overlong(bytes) => {
                self.line += 1;
                if self.line == 1 {
                    self.encoding(bytes)?;
                }
                Err(if bytes.contains(&b'\r') {
                    self.carriage_returns()
                } else if let Some(at) = bytes.iter().position(|b| *b == 0) {
                    self.control_byte(bytes, at)
                } else {
                    Finding::error(
                        self.file,
                        format!("a line is longer than {LONGEST_LINE} bytes"),
                        "check that this is a run file",
                    )
                    .at(self.line, 1)
                    .found(bytes)
                }
                .into())
            }
        }
    }

    fn lines(&mut self, mut bytes: &[u8]) -> Result<(), Stop> {
        loop {
            if self.plain_columns && self.state == State::Rows(Section::Vectors) {
                bytes = self.plain_rows(bytes)?;
            }
            let Some(end) = memchr::memchr(b'\n', bytes) else { return Ok(()) };
            let (line, rest) = bytes.split_at(end);
            self.line += 1;
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            let result = self.one_line(line);
            self.absorb(result)?;
            bytes = rest.get(1..).unwrap_or_default();
        }
    }

    /// Rows on the fast path, up to the first one that needs care; returns what is left.
    #[inline(never)]
    fn plain_rows<'b>(&mut self, mut bytes: &'b [u8]) -> Result<&'b [u8], Stop> {
        while let Some(window) = bytes.first_chunk::<WINDOW>() {
            let (row, length) = match &self.layout {
                Some(layout) if layout.fits(window) => {
                    self.doubts = self.doubts.saturating_sub(1);
                    (layout.row(window), layout.length())
                }
                _ => {
                    let Some((row, length)) = plain_row(window) else { break };
                    self.other_layout(bytes.get(..length).unwrap_or_default());
                    (row, length)
                }
            };
            self.line += 1;
            match self.clock.tick(&row, self.line) {
                Tick::Sample(t_s) => self.deliver(&row, t_s),
                tick => {
                    let line = bytes.get(..length).unwrap_or_default().trim_ascii_end();
                    let result = self.refuse(tick, line);
                    self.absorb(result)?;
                }
            }
            bytes = bytes.get(length..).unwrap_or_default();
        }
        Ok(bytes)
    }

    /// A plain row that is not laid out as the rows before it. Single ones are passed over, as layouts take longer to learn than rows
    /// to read.
    #[inline(never)]
    fn other_layout(&mut self, row: &[u8]) {
        self.doubts += 1;
        if self.layout.is_none() || self.doubts > MOST_DOUBTS {
            self.doubts = 0;
            self.layout = Layout::of(row);
        }
    }

    #[inline(always)]
    fn deliver(&mut self, row: &Row, t_s: f64) {
        let [x, y, z] = row.reading;
        let reading = Reading([x * self.scale, y * self.scale, z * self.scale]);
        self.sink.vector(Vector { n: row.n, t_s, reading });
    }

    /// In collecting mode errors are kept and reading goes on.
    fn absorb(&mut self, result: Result<(), Stop>) -> Result<(), Stop> {
        match result {
            Err(Stop::Error(finding)) if self.options.collect && self.header.is_some() && self.errors < MOST_ERRORS => {
                self.errors += 1;
                self.findings.push(*finding);
                Ok(())
            }
            Ok(()) => {
                self.last_good_line = self.line;
                Ok(())
            }
            other => other,
        }
    }

    fn encoding(&self, start: &[u8]) -> Result<(), Stop> {
        let utf16 = start.starts_with(&[0xff, 0xfe])
            || start.starts_with(&[0xfe, 0xff])
            || start.starts_with(b"C\0C\0")
            || start.starts_with(b"\0C\0C");
        if utf16 {
            return Err(Finding::error(self.file, "the text is UTF-16", "convert it with `iconv -f UTF-16 -t UTF-8`")
                .at(1, 1)
                .into());
        }
        Ok(())
    }

    fn carriage_returns(&self) -> Finding {
        Finding::error(self.file, "the file has CR line ends", "convert it to LF or CRLF line ends").at(self.line, 0)
    }

    fn control_byte(&self, line: &[u8], at: usize) -> Finding {
        let byte = line.get(at).copied().unwrap_or_default();
        let what = match byte {
            0 => "a NUL byte (0x00), as a power loss leaves behind".to_owned(),
            0x1a => "a Ctrl-Z byte (0x1a)".to_owned(),
            other => format!("a control byte (0x{other:02x})"),
        };
        let around = line.get(at.saturating_sub(16)..).unwrap_or_default();
        Finding::error(self.file, format!("the line holds {what}"), "take the file from the archive again, or cut it there")
            .at(self.line, at as u64 + 1)
            .found(around)
    }

    fn one_line(&mut self, line: &[u8]) -> Result<(), Stop> {
        if self.line == 1 {
            self.encoding(line)?;
        }
        if let Some(at) = line.iter().position(|b| *b < 0x20 && *b != b'\t') {
            return Err(if line.get(at) == Some(&b'\r') { self.carriage_returns() } else { self.control_byte(line, at) }.into());
        }
        match self.state {
            State::Magic => self.magic(line),
            State::Head if line.starts_with(b"@") => {
                let text = std::mem::take(&mut self.head);
                let header = super::header::parse(self.file, text, &mut self.findings)?;
                self.clock = Clock::new(header.sample_rate_hz);
                self.scale = header.unit.ent_per_unit();
                self.header = Some(header);
                self.section(line)
            }
            State::Head => {
                if self.head.len() + line.len() > LONGEST_HEAD {
                    let rule = format!("no section begins within the first {LONGEST_HEAD} bytes");
                    return Err(Finding::error(self.file, rule, "check that this is a run file").at(self.line, 1).into());
                }
                self.head.push_str(&decode(line));
                self.head.push('\n');
                Ok(())
            }
            State::Ended if line.trim_ascii().is_empty() => Ok(()),
            State::Ended => {
                Err(Finding::error(self.file, "text stands after @END", "take it out, or split files that were joined")
                    .at(self.line, 1)
                    .found(line)
                    .into())
            }
            _ if line.starts_with(b"@") => self.section(line),
            _ if line.trim_ascii().is_empty() || line.starts_with(b"#") => Ok(()),
            State::ColumnNames(section) => self.column_names(section, line),
            State::Rows(section) => self.row(section, line),
            State::UnknownSection => Ok(()),
        }
    }

    fn magic(&mut self, line: &[u8]) -> Result<(), Stop> {
        let text = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii_end();
        if text != b"CCR 1" {
            let (rule, remedy) = if text.starts_with(b"CCR ") {
                ("this version of the format is not known", "the first line must be `CCR 1`")
            } else {
                ("the file is not a run file", "the first line must be `CCR 1`")
            };
            return Err(Finding::error(self.file, rule, remedy).at(1, 1).found(line).into());
        }
        self.state = State::Head;
        Ok(())
    }

    fn section(&mut self, line: &[u8]) -> Result<(), Stop> {
        let name = line.trim_ascii_end();
        if name == b"@END" {
            self.state = State::Ended;
            return Ok(());
        }
        let Some(section) = Section::ALL.into_iter().find(|s| s.name().as_bytes() == name) else {
            self.state = State::UnknownSection;
            self.findings.push(
                Finding::error(
                    self.file,
                    format!("the section {} is not known and was not used", excerpt(name)),
                    "check its name",
                )
                .at(self.line, 1)
                .found(name)
                .weighing(Severity::Warning),
            );
            return Ok(());
        };
        if self.seen.contains(&section) {
            self.state = State::UnknownSection;
            return Err(Finding::error(
                self.file,
                format!("{} stands twice", section.name()),
                "join the two sections, or split the file",
            )
            .at(self.line, 1)
            .into());
        }
        self.seen.push(section);
        self.state = State::ColumnNames(section);
        if section == Section::Vectors {
            self.begin_vectors()?;
        }
        Ok(())
    }

    fn begin_vectors(&mut self) -> Result<(), Stop> {
        if self.sink.needs_settings() && self.settings_known.is_none() && !self.seen.contains(&Section::Fields) {
            return Err(Stop::SettingsComeLater);
        }
        if let Some(header) = &self.header {
            let settings = self.settings_known.as_deref().unwrap_or(&self.settings);
            self.sink.begin(header, settings);
            self.begun = true;
        }
        Ok(())
    }

    fn column_names(&mut self, section: Section, line: &[u8]) -> Result<(), Stop> {
        let (wanted, required) = section.columns();
        // Rows whose columns are unknown cannot be judged.
        self.state = State::UnknownSection;
        let columns = columns(self.file, self.line, line, section.name(), wanted, required)?;
        match section {
            Section::Temperatures => self.temperatures = slow_table(&columns),
            Section::Channels => self.channels = slow_table(&columns),
            _ => self.findings.extend(columns.unknown(self.file, self.line, section.name(), wanted)),
        }
        if section == Section::Vectors {
            self.plain_columns = columns.names == *wanted;
        }
        self.columns = columns;
        self.state = State::Rows(section);
        Ok(())
    }

    fn row(&mut self, section: Section, line: &[u8]) -> Result<(), Stop> {
        let mut cells = Vec::with_capacity(self.columns.names.len());
        self.columns.row(self.file, self.line, line, section.name(), &mut cells)?;
        match section {
            Section::Vectors => self.careful_row(line, &cells),
            Section::Fields => self.setting_row(line, &cells),
            Section::Blocks => self.block_row(line, &cells),
            Section::Temperatures | Section::Channels => self.slow_row(section, line, &cells),
            Section::Scalar => self.scalar_row(&cells),
        }
    }

    fn number(&self, row: &[Cell], wanted: usize) -> Result<f64, Stop> {
        Ok(self.columns.required(self.file, self.line, row, wanted)?)
    }

    fn numbers<const N: usize>(&self, row: &[Cell], first: usize) -> Result<[f64; N], Stop> {
        let mut out = [0.0; N];
        for (i, value) in out.iter_mut().enumerate() {
            *value = self.number(row, first + i)?;
        }
        Ok(out)
    }

    fn whole(&self, row: &[Cell], wanted: usize) -> Result<u64, Stop> {
        let value = self.number(row, wanted)?;
        if value < 0.0 || value.fract() != 0.0 || value >= 1e15 {
            let at = self.columns.wanted.get(wanted).copied().flatten().unwrap_or_default();
            let name = self.columns.names.get(at).map_or("?", String::as_str);
            let finding =
                Finding::error(self.file, format!("column `{name}` must be a whole number, 0 or more"), "repair the value");
            return Err(match row.get(at) {
                Some(cell) => finding.at(self.line, cell.column).found(cell.text),
                None => finding.at(self.line, 1),
            }
            .into());
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked just above")]
        Ok(value as u64)
    }

    fn bad_row(&self, line: &[u8], rule: impl Into<Box<str>>, remedy: &str) -> Stop {
        Finding::error(self.file, rule, remedy).at(self.line, 1).found(line).into()
    }

    fn careful_row(&mut self, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let n = self.whole(cells, 0)?;
        let t_s = self.number(cells, 1)?;
        let reading = self.numbers(cells, 2)?;
        let at = self.columns.wanted.get(1).copied().flatten().unwrap_or_default();
        let tag = cells.get(at).map_or(&b""[..], |cell| cell.text);
        let decimals = tag.iter().position(|b| *b == b'.').map_or(0, |point| tag.len() - point - 1);
        let row = Row { n, t_s, t_decimals: decimals.min(12) as u32, reading };
        match self.clock.tick(&row, self.line) {
            Tick::Sample(t_s) => {
                self.deliver(&row, t_s);
                Ok(())
            }
            tick => self.refuse(tick, line),
        }
    }

    /// A row at which the clock stopped.
    #[cold]
    fn refuse(&self, tick: Tick, line: &[u8]) -> Result<(), Stop> {
        const CLOCK_REMEDY: &str = "split files that were joined, or sort out the clock reset";
        match tick {
            Tick::Sample(_) | Tick::Duplicate => Ok(()),
            Tick::CounterBack { from, to } => {
                Err(self.bad_row(line, format!("the sample counter goes back from {from} to {to}"), CLOCK_REMEDY))
            }
            Tick::TimeBack { from_s, to_s } => {
                Err(self.bad_row(line, format!("time goes back from {from_s} s to {to_s} s"), CLOCK_REMEDY))
            }
            Tick::Disagrees { by_s, rate_hz } => {
                let nominal = self.header.as_ref().map_or(0.0, |h| h.sample_rate_hz);
                Err(self.bad_row(
                    line,
                    format!("the time tag is {by_s:+.4} s away from the sample counter at {nominal} Hz (so far {rate_hz:.4} Hz)"),
                    "correct `sample_rate`, or repair counter or time tags",
                ))
            }
        }
    }

    fn setting_row(&mut self, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let [t_start_s, t_end_s, bx, by, bz, frequency_hz] = self.numbers(cells, 0)?;
        let setting =
            Setting { t_start_s, t_end_s, field: FieldCoil([bx, by, bz]), frequency_hz, position: self.position(cells, 6)? };
        self.check_times(line, &setting, self.settings.last().map(|s| s.t_end_s))?;
        if frequency_hz < 0.0 {
            return Err(self.bad_row(line, "the frequency is negative", "write 0 for a constant field"));
        }
        self.settings.push(setting);
        Ok(())
    }

    fn position(&self, cells: &[Cell], wanted: usize) -> Result<u32, Stop> {
        // An id beyond 32 bits cannot be in any position table.
        Ok(u32::try_from(self.whole(cells, wanted)?).unwrap_or(u32::MAX))
    }

    fn check_times(&self, line: &[u8], setting: &Setting, previous_end_s: Option<f64>) -> Result<(), Stop> {
        // Printed times may overlap by their last digit.
        const ROUNDING_S: f64 = 1e-3;
        if setting.t_end_s <= setting.t_start_s {
            return Err(self.bad_row(line, "the setting ends before it begins", "repair t_start and t_end"));
        }
        match previous_end_s {
            Some(end_s) if setting.t_start_s < end_s - ROUNDING_S => Err(self.bad_row(
                line,
                format!("the setting begins at {} s, before the one above it ends at {end_s} s", setting.t_start_s),
                "put the settings in order of time and repair overlaps",
            )),
            _ => Ok(()),
        }
    }

    fn block_row(&mut self, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let [t_start_s, t_end_s, bx, by, bz] = self.numbers(cells, 0)?;
        let setting =
            Setting { t_start_s, t_end_s, field: FieldCoil([bx, by, bz]), frequency_hz: 0.0, position: self.position(cells, 5)? };
        self.check_times(line, &setting, self.blocks.last().map(|b| b.setting.t_end_s))?;
        let scaled = |v: [f64; 3]| v.map(|c| c * self.scale);
        let mean = Reading(scaled(self.numbers(cells, 6)?));
        let has = |wanted: usize| self.columns.wanted.get(wanted).copied().flatten().is_some();
        let std_ent = if has(9) && has(10) && has(11) { Some(scaled(self.numbers(cells, 9)?)) } else { None };
        if std_ent.is_some_and(|s| s.iter().any(|v| *v < 0.0)) {
            return Err(self.bad_row(line, "a standard deviation is negative", "repair the value"));
        }
        let count = if has(12) { Some(self.whole(cells, 12)?) } else { None };
        self.blocks.push(GivenBlock { setting, mean, std_ent, count });
        Ok(())
    }

    fn slow_row(&mut self, section: Section, line: &[u8], cells: &[Cell]) -> Result<(), Stop> {
        let t_s = self.number(cells, 0)?;
        let t_at = self.columns.wanted.first().copied().flatten().unwrap_or_default();
        let table = if section == Section::Temperatures { &self.temperatures } else { &self.channels };
        if let Some(before) = table.t_s.last().filter(|before| t_s < **before) {
            return Err(self.bad_row(
                line,
                format!("time goes back from {before} s to {t_s} s"),
                "put the rows in order of time",
            ));
        }
        let mut values = Vec::with_capacity(cells.len());
        for (i, cell) in cells.iter().enumerate().filter(|(i, _)| *i != t_at) {
            if cell.text.is_empty() {
                values.push(f64::NAN);
            } else {
                let name = self.columns.names.get(i).map_or("?", String::as_str);
                values.push(number(cell.text).ok_or_else(|| not_a_number(self.file, self.line, *cell, name))?);
            }
        }
        let table = if section == Section::Temperatures { &mut self.temperatures } else { &mut self.channels };
        table.t_s.push(t_s);
        for (column, value) in table.values.iter_mut().zip(values) {
            column.push(value);
        }
        Ok(())
    }

    fn scalar_row(&mut self, cells: &[Cell]) -> Result<(), Stop> {
        let [t_s, bx, by, bz, modulus_nt] = self.numbers(cells, 0)?;
        self.scalar.push(ScalarRow { t_s, setting: [bx, by, bz], modulus_nt });
        Ok(())
    }

    /// What stands after the last line end: nothing, `@END`, or a cut line.
    fn rest(&mut self, bytes: &[u8]) -> Result<(), Stop> {
        if self.line == 0 && bytes.is_empty() {
            return Err(Finding::error(self.file, "the file is empty", "take it from the archive again").into());
        }
        if !bytes.is_empty() {
            self.line += 1;
            if self.line == 1 {
                self.encoding(bytes)?;
            }
            if bytes.contains(&b'\r') {
                return Err(self.carriage_returns().into());
            }
            let whole = bytes.trim_ascii_end() == b"@END" || self.state == State::Ended;
            if whole || bytes.iter().any(|b| *b < 0x20 && *b != b'\t') || self.state == State::Magic {
                let result = self.one_line(bytes);
                self.absorb(result)?;
            } else if !self.options.allow_truncated {
                let finding = Finding::error(
                    self.file,
                    format!("the file ends inside a line; the last good row is line {}", self.last_good()),
                    "take the file from the archive again, or read what is there with --allow-truncated",
                );
                return Err(finding.at(self.line, 1).found(bytes).into());
            }
        }
        if self.state == State::Ended {
            return Ok(());
        }
        let finding = Finding::error(
            self.file,
            format!("the file ends without @END; the last good row is line {}", self.last_good()),
            "take the file from the archive again, or read what is there with --allow-truncated",
        )
        .at(self.line, 0);
        if self.options.allow_truncated && self.header.is_some() {
            self.findings.push(finding.weighing(Severity::Warning));
            return Ok(());
        }
        Err(finding.into())
    }

    fn last_good(&self) -> u64 {
        // Rows of the fast path are good unless they stopped the reader.
        if self.errors == 0 && self.line > 0 { self.line.saturating_sub(1).max(self.last_good_line) } else { self.last_good_line }
    }

    /// What the clock has noticed beside single rows.
    fn clock_findings(&self) -> Vec<Finding> {
        let clock = &self.clock;
        let mut findings = Vec::new();
        // A few repetitions are left out; many mean that something is wrong with the file.
        let mut repeated = |what: &str, count: u64, lines: &[u64], remedy: &str| {
            if count == 0 {
                return;
            }
            let many = count > 10.max(clock.account.count / 1000) && !self.options.allow_duplicates;
            let lines: Vec<String> = lines.iter().map(u64::to_string).collect();
            findings.push(
                Finding::error(
                    self.file,
                    format!("{count} {what} of the row above them (lines {} ...)", lines.join(", ")),
                    if many { "repair the file, or go on with --allow duplicates" } else { remedy },
                )
                .weighing(if many { Severity::Error } else { Severity::Warning }),
            );
        };
        repeated("rows repeat the sample counter", clock.account.duplicates, &clock.duplicate_lines, "they were left out");
        match clock.coarse_step_s() {
            None => {
                repeated("rows repeat the time tag", clock.equal_tags, &clock.equal_lines, "times come from the sample counter")
            }
            Some(step_s) => {
                findings.push(
                    Finding::error(
                        self.file,
                        format!("the time column has steps of about {step_s:.3} s, longer than a sample"),
                        "times were rebuilt from the sample counter; plateau edges are uncertain by up to one step",
                    )
                    .weighing(Severity::Warning),
                );
                let nominal = self.header.as_ref().map_or(0.0, |h| h.sample_rate_hz);
                if let Some(rate_hz) = clock.wrong_rate_hz() {
                    findings.push(Finding::error(
                        self.file,
                        format!("the time tags run at {rate_hz:.4} Hz, the header says {nominal} Hz"),
                        "correct `sample_rate`, or repair counter or time tags",
                    ));
                }
            }
        }
        findings
    }

    fn finish(mut self) -> Result<Run, Vec<Finding>> {
        let file = self.file;
        let clock_findings = self.clock_findings();
        self.findings.extend(clock_findings);
        let header = self.header.take();
        if !self.blocks.is_empty() && (self.seen.contains(&Section::Vectors) || self.seen.contains(&Section::Fields)) {
            self.findings.push(Finding::error(
                file,
                "@BLOCKS stands beside @FIELDS or @VECTORS, so it is open which of them holds",
                "keep the plateau means or the samples, not both",
            ));
        }
        let Some(header) = header else {
            self.findings.push(Finding::error(file, "the file has no keys and no sections", "check that this is a run file"));
            return Err(self.findings);
        };
        if !file.ends_with(&format!("{}.CCR", header.run.replace('_', "/"))) && header.run.len() == 17 {
            let stem = Path::new(file).file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let time = header.run.get(9..).unwrap_or_default();
            if !stem.starts_with(time) {
                self.findings.push(
                    Finding::error(
                        file,
                        format!("the run id `{}` does not go with the file name", header.run),
                        "outputs are named after the run id",
                    )
                    .weighing(Severity::Warning),
                );
            }
        }
        if self.findings.iter().any(|f| f.severity == Severity::Error) {
            return Err(self.findings);
        }
        if !self.begun {
            self.sink.begin(&header, &self.settings);
        }
        Ok(Run {
            header,
            settings: self.settings,
            blocks: self.blocks,
            temperatures: self.temperatures,
            channels: self.channels,
            scalar: self.scalar,
            vectors: self.clock.finish(),
            input: self.input,
            findings: self.findings,
        })
    }
}

fn slow_table(columns: &Columns) -> SlowTable {
    let t_at = columns.wanted.first().copied().flatten();
    let names: Vec<String> =
        columns.names.iter().enumerate().filter(|(i, _)| Some(*i) != t_at).map(|(_, name)| name.clone()).collect();
    let values = vec![Vec::new(); names.len()];
    SlowTable { names, t_s: Vec::new(), values }
}
