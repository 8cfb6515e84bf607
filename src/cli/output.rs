//! What is printed: results on standard output, messages and progress on standard error.

use super::Status;
use crate::data::error::{Finding, Severity};
use clap::ColorChoice;
use indicatif::{ProgressBar, ProgressStyle};
use std::cell::Cell;
use std::io::{self, IsTerminal, Write};

/// The two outputs of the program.
pub(super) struct Terminal {
    colored: bool,
    quiet: bool,
    verbose: bool,
    silent: bool,
    failed: Cell<bool>,
    closed: Cell<bool>,
}

impl Terminal {
    pub fn new(color: ColorChoice, quiet: bool, verbose: bool) -> Self {
        let colored = match color {
            ColorChoice::Always => true,
            ColorChoice::Never => false,
            ColorChoice::Auto => io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
        };
        Self { colored, quiet, verbose, silent: false, failed: Cell::new(false), closed: Cell::new(false) }
    }

    /// Prints nothing at all, not even errors: for work whose outcome is told by another command.
    pub fn silent() -> Self {
        Self { silent: true, ..Self::new(ColorChoice::Never, true, false) }
    }

    /// Text on standard output. A reader that hangs up ends the output quietly; a full disk is an error.
    pub fn print(&self, text: &str) {
        if self.silent || self.closed.get() || self.failed.get() {
            return;
        }
        let mut out = io::stdout().lock();
        if let Err(error) = out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            if error.kind() == io::ErrorKind::BrokenPipe {
                self.closed.set(true);
            } else {
                self.failed.set(true);
                self.error(&format!("cannot write to standard output: {error}"));
            }
        }
    }

    /// Text for a person, not with `-q`.
    pub fn tell(&self, text: &str) {
        if !self.quiet {
            self.print(text);
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

    /// Entries of `campaign.toml` that go with no run.
    pub fn unmatched(&self, entries: &[String]) {
        for entry in entries {
            self.warning(&format!("campaign.toml: {entry} goes with no run of the campaign; check its spelling"));
        }
    }

    fn line(&self, label: &str, color: &str, text: &str) {
        if self.silent {
            return;
        }
        // Nobody is left to be told that standard error is closed.
        let _ = if self.colored {
            writeln!(io::stderr(), "\x1b[{color}m{label}\x1b[0m: {text}")
        } else {
            writeln!(io::stderr(), "{label}: {text}")
        };
    }

    /// A progress bar on standard error when that is a terminal and the work has several parts.
    pub fn progress(&self, parts: usize) -> ProgressBar {
        if self.quiet || parts < 2 || !io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let bar = ProgressBar::new(parts as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} runs, {elapsed} {msg}") {
            bar.set_style(style);
        }
        bar
    }

    /// The exit status, which is a failure if output was lost.
    pub fn finish(&self, status: Status) -> Status {
        if self.failed.get() { status.max(Status::Partly) } else { status }
    }
}

/// JSON text with a line end.
pub(super) fn json(value: &impl serde::Serialize) -> Result<String, Finding> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|e| Finding::error("standard output", format!("the result has no JSON form: {e}"), "report this"))?;
    text.push('\n');
    Ok(text)
}
