//! The reader of run files: one pass, bounded memory, every byte validated.

mod ending;
mod rows;

use super::Section;
use super::layout::Layout;
use super::vectors::{Clock, Row, Tick, WINDOW, plain_row};
use crate::data::error::{Finding, Severity, excerpt};
use crate::data::run::{GivenBlock, Header, InputFile, Run, ScalarRow, Setting, SlowTable, Vector, VectorSink};
use crate::data::units::Reading;
use crate::files::import::foreign_kind;
use crate::files::source::{Piece, read_pieces};
use crate::files::text::{Columns, LONGEST_LINE, columns, decode};
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
    /// Whether a time tag was found away from the sample counter.
    rate_disagrees: bool,
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
            rate_disagrees: false,
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
                    self.foreign(bytes)?;
                }
                Err(if bytes.contains(&b'\r') {
                    self.carriage_returns(bytes)
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

    /// Tables of other software become runs first.
    fn foreign(&self, begin: &[u8]) -> Result<(), Stop> {
        let text = begin.strip_prefix(b"\xef\xbb\xbf").unwrap_or(begin);
        if text.starts_with(b"CCR") {
            return Ok(());
        }
        match foreign_kind(self.file, begin) {
            None => Ok(()),
            Some(what) => Err(Finding::error(
                self.file,
                format!("is {what}, not a run file"),
                "make runs of tables with `calfit import`; `calfit import --guess FILE` proposes the mapping",
            )
            .into()),
        }
    }

    /// CR line ends, unless bytes beside them show that they are none.
    fn carriage_returns(&self, bytes: &[u8]) -> Finding {
        if let Some(at) = bytes.iter().position(|b| is_control(*b) && *b != b'\r') {
            return self.control_byte(bytes, at);
        }
        Finding::error(self.file, "the file has CR line ends", "convert it to LF or CRLF line ends").at(self.line, 0)
    }

    fn no_text(&self) -> Finding {
        Finding::error(
            self.file,
            "the file is no text: its bytes are those of another kind of file, or damaged",
            "check its name, or take it from the archive again",
        )
        .at(self.line, 0)
    }

    fn control_byte(&self, line: &[u8], at: usize) -> Finding {
        // Who has begun to read a run file knows that it is text; NUL bytes are what is left of one.
        if self.line == 1 && !line.starts_with(b"CCR") && line.get(at) != Some(&0) {
            return self.no_text();
        }
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
            self.foreign(line)?;
        }
        if let Some(at) = line.iter().position(|b| is_control(*b)) {
            return Err(
                if line.get(at) == Some(&b'\r') { self.carriage_returns(line) } else { self.control_byte(line, at) }.into()
            );
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
                ("the file is not a run file", "the first line must be `CCR 1`; tables become runs with `calfit import`")
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
            let word = name.split(u8::is_ascii_whitespace).next().unwrap_or_default();
            if let Some(section) = Section::ALL.into_iter().find(|s| s.name().as_bytes() == word) {
                // Its rows would be lost, and the run would seem to have none.
                let rule = format!("{} has more on its line than its name", section.name());
                return Err(Finding::error(
                    self.file,
                    rule,
                    "write the name alone on its line, and a comment on a line of its own that begins with #",
                )
                .at(self.line, word.len() as u64 + 1)
                .found(name)
                .into());
            }
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
}

/// Whether a byte stands in no line of text.
fn is_control(byte: u8) -> bool {
    byte < 0x20 && byte != b'\t'
}

fn slow_table(columns: &Columns) -> SlowTable {
    let t_at = columns.wanted.first().copied().flatten();
    let names: Vec<String> =
        columns.names.iter().enumerate().filter(|(i, _)| Some(*i) != t_at).map(|(_, name)| name.clone()).collect();
    let values = vec![Vec::new(); names.len()];
    SlowTable { names, t_s: Vec::new(), values }
}
