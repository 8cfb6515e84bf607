//! What is printed: results on standard output, messages and progress on standard error.

use super::Status;
use crate::data::error::{Finding, Severity};
use crate::data::plain;
use crate::data::provenance::Provenance;
use crate::model::facility::Facility;
use crate::workflow::facility;
use clap::ColorChoice;
use indicatif::{ProgressBar, ProgressStyle};
use std::cell::{Cell, RefCell};
use std::io::{self, Write};
use std::path::PathBuf;

/// Standard output or standard error of the program.
pub struct Output<'a> {
    /// Where the text goes.
    pub to: &'a mut (dyn Write + Send),
    /// Whether it is a terminal: then messages have colours, and on standard error there is a progress bar.
    pub is_terminal: bool,
}

impl Output<'_> {
    /// Whether text has colours.
    pub(super) fn is_colored(&self, color: ColorChoice) -> bool {
        match color {
            ColorChoice::Always => true,
            ColorChoice::Never => false,
            ColorChoice::Auto => self.is_terminal && std::env::var_os("NO_COLOR").is_none(),
        }
    }
}

/// The two outputs of a command.
pub(super) struct Terminal<'a> {
    /// Standard output and standard error; none of work whose outcome is told by another command.
    outputs: RefCell<[Output<'a>; 2]>,
    colored: bool,
    quiet: bool,
    verbose: bool,
    failed: Cell<bool>,
    closed: Cell<bool>,
}

impl<'a> Terminal<'a> {
    pub fn new(out: Output<'a>, err: Output<'a>, color: ColorChoice, quiet: bool, verbose: bool) -> Self {
        let colored = err.is_colored(color);
        let outputs = RefCell::new([out, err]);
        Self { outputs, colored, quiet, verbose, failed: Cell::new(false), closed: Cell::new(false) }
    }

    /// Text on standard output. A reader that hangs up ends the output quietly; a full disk is an error.
    pub fn print(&self, text: &str) {
        if self.closed.get() || self.failed.get() {
            return;
        }
        let printed = {
            let out = &mut self.outputs.borrow_mut()[0].to;
            out.write_all(plain::shown(text).as_bytes()).and_then(|()| out.flush())
        };
        if let Err(error) = printed {
            if error.kind() == io::ErrorKind::BrokenPipe {
                self.closed.set(true);
            } else {
                self.failed.set(true);
                self.error(&format!("cannot write to standard output: {error}"));
            }
        }
    }

    /// Text for a person, not with `-q`. A standard output that was closed from the beginning is wanted so.
    pub fn tell(&self, text: &str) {
        if !self.quiet && self.must_be_open().is_ok() {
            self.print(text);
        }
    }

    /// Refuses work whose result would go to a standard output that is closed.
    pub fn must_be_open(&self) -> Result<(), Finding> {
        match self.outputs.borrow_mut()[0].to.flush() {
            Err(error) if error.kind() == io::ErrorKind::NotConnected => {
                let remedy = "let it lead to a file or another program";
                Err(Finding::error("standard output", format!("cannot be written: {error}"), remedy))
            }
            _ => Ok(()),
        }
    }

    /// A finding with its weight, unless it is not wanted.
    pub fn finding(&self, finding: &Finding) {
        match finding.severity {
            Severity::Error => self.error(&finding.to_string()),
            Severity::Warning => self.warning(&finding.to_string()),
            Severity::Note if self.verbose && !self.quiet => self.line("note", "36", &finding.to_string()),
            Severity::Note => {}
        }
    }

    /// An error message.
    pub fn error(&self, text: &str) {
        self.line("error", "31;1", text);
    }

    /// A warning, not with `-q`.
    pub fn warning(&self, text: &str) {
        if !self.quiet {
            self.line("warning", "33;1", text);
        }
    }

    /// The facility of an option, with what its file is warned about.
    ///
    /// # Errors
    /// The file is no facility.
    pub fn facility(&self, path: Option<&PathBuf>) -> Result<Option<Facility>, Finding> {
        let mut findings = Vec::new();
        let read = facility(path, &mut findings);
        findings.iter().for_each(|f| self.finding(f));
        read
    }

    /// Entries of `campaign.toml` and options that go with no run.
    pub fn unmatched(&self, entries: &[String]) {
        for entry in entries {
            self.warning(&format!("{entry} goes with no run of the campaign; check its spelling"));
        }
    }

    fn line(&self, label: &str, color: &str, text: &str) {
        let text = plain::shown(text);
        let line = if self.colored { format!("\x1b[{color}m{label}\x1b[0m: {text}\n") } else { format!("{label}: {text}\n") };
        // Nobody is left to be told that standard error is closed.
        let _ = self.outputs.borrow_mut()[1].to.write_all(line.as_bytes());
    }

    /// A progress bar on standard error when that is a terminal and the work has several parts; `what` is done with each.
    pub fn progress(&self, parts: usize, what: &str) -> Progress {
        let is_terminal = self.outputs.borrow()[1].is_terminal;
        if self.quiet || parts < 2 || !is_terminal {
            return Progress(ProgressBar::hidden());
        }
        let bar = ProgressBar::new(parts as u64);
        if let Ok(style) = ProgressStyle::with_template(&format!("{{bar:30}} {{pos}}/{{len}} {what}, {{eta}} left  {{msg}}")) {
            bar.set_style(style);
        }
        Progress(bar)
    }

    /// The exit status, which is a failure if output was lost.
    pub fn finish(&self, status: Status) -> Status {
        if self.failed.get() { status.max(Status::Partly) } else { status }
    }
}

/// How far the work is, what it is at, and how long it will take.
pub(super) struct Progress(ProgressBar);

impl Progress {
    /// Does one part of the work, which has a name.
    pub fn of<T>(&self, name: &str, work: impl FnOnce() -> T) -> T {
        self.0.set_message(plain::one_line(name).into_owned());
        let done = work();
        self.0.inc(1);
        done
    }

    /// All is done: the bar goes away.
    pub fn finish(&self) {
        self.0.finish_and_clear();
    }
}

/// A result of a command with its parameter file and its origin, as `--json` prints it.
#[derive(serde::Serialize)]
pub(super) struct Printed<'a, V> {
    #[serde(flatten)]
    pub result: V,
    pub parameter_file: &'a str,
    pub provenance: &'a Provenance,
}

/// JSON text with a line end.
pub(super) fn json(value: &impl serde::Serialize) -> Result<String, Finding> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|e| Finding::error("standard output", format!("the result has no JSON form: {e}"), "report this"))?;
    text.push('\n');
    Ok(plain::json(text))
}
