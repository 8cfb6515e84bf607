//! What is wrong with an input: the place, the offending text, the rule and the remedy.

use super::plain::{is_unseen, one_line};
use serde::Serialize;
use std::fmt;
use std::path::Path;

/// How much a finding weighs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Worth knowing, nothing to do.
    Note,
    /// The input is used, but a person should look.
    Warning,
    /// The input is refused.
    Error,
}

/// One thing found in an input file. With [`Severity::Error`] it is the reason why the file is refused.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Weight.
    pub severity: Severity,
    /// The file as the user named it.
    pub file: Box<str>,
    /// Line, counted from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<u64>,
    /// Byte column, counted from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<u64>,
    /// The offending text, escaped, at most 40 characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found: Option<Box<str>>,
    /// The rule that it breaks.
    pub rule: Box<str>,
    /// What to do about it.
    pub remedy: Box<str>,
}

impl Finding {
    /// An error about a whole file.
    pub fn error(file: &str, rule: impl Into<Box<str>>, remedy: impl Into<Box<str>>) -> Self {
        Self {
            severity: Severity::Error,
            file: file.into(),
            line: None,
            column: None,
            found: None,
            rule: rule.into(),
            remedy: remedy.into(),
        }
    }

    /// The same with a line and byte column (both from 1; column 0 means the whole line).
    #[must_use]
    pub fn at(mut self, line: u64, column: u64) -> Self {
        self.line = Some(line);
        self.column = (column > 0).then_some(column);
        self
    }

    /// The same with the offending text, escaped and cut to 40 characters.
    #[must_use]
    pub fn found(mut self, text: &[u8]) -> Self {
        self.found = Some(excerpt(text).into());
        self
    }

    /// The same with another weight.
    #[must_use]
    pub fn weighing(mut self, severity: Severity) -> Self {
        self.severity = severity;
        self
    }

    /// An input or output error of the operating system.
    pub fn io(file: &Path, action: &str, error: &std::io::Error) -> Self {
        let remedy = match error.kind() {
            std::io::ErrorKind::NotFound => "check the path",
            std::io::ErrorKind::PermissionDenied => "check the permissions",
            std::io::ErrorKind::StorageFull => "free some space and run again",
            std::io::ErrorKind::FileTooLarge => "raise the limit on the size of files (`ulimit -f`) and run again",
            std::io::ErrorKind::OutOfMemory => "give the program more memory, or name fewer or smaller files",
            _ => "see the reason given by the operating system",
        };
        Self::error(&file.display().to_string(), format!("cannot {action}: {error}"), remedy)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Names of files hold anything.
        write!(f, "{}", one_line(&self.file))?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
            if let Some(column) = self.column {
                write!(f, ":{column}")?;
            }
        }
        write!(f, ": ")?;
        if let Some(found) = &self.found {
            write!(f, "found `{found}`: ")?;
        }
        write!(f, "{}; {}", self.rule, self.remedy)
    }
}

impl std::error::Error for Finding {}

/// Text of any bytes, printable and at most 40 characters long.
#[must_use]
pub fn excerpt(text: &[u8]) -> String {
    const LONGEST: usize = 40;
    // 200 bytes are more than 40 characters of any encoding.
    let decoded = String::from_utf8_lossy(&text[..text.len().min(200)]);
    let mut out = String::new();
    let mut length = 0;
    for c in decoded.chars() {
        let escaped: String = if is_unseen(c) { c.escape_default().collect() } else { c.to_string() };
        if length + escaped.chars().count() > LONGEST {
            out.push('…');
            break;
        }
        length += escaped.chars().count();
        out.push_str(&escaped);
    }
    out
}
