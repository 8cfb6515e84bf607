//! What a person should know about a result: every warning of an analysis is a [`Note`].

use serde::{Deserialize, Serialize, Serializer};
use std::fmt;

/// What a note is about. Programs decide by it, never by the text; in files it is the word in snake case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoteKind {
    /// The axes of the sensor do not stand as the position table says.
    Axes,
    /// A component looks against its nominal axis.
    ReversedAxis,
    /// A component looks along the nominal axis of another.
    SwappedAxes,
    /// The conversion is far from the nominal one.
    Gain,
    /// The conversion changes inside the run.
    GainJump,
    /// Readings and settings do not belong together.
    Mismatch,
    /// A component gives the same reading always.
    Stuck,
    /// Single readings far from those beside them.
    Spikes,
    /// Readings that are missing.
    Losses,
    /// The model does not describe the readings, or the run does not determine it well.
    Fit,
    /// Known effects of a model file that were taken off, or were not.
    Model,
    /// Damaged, lost or unused readings.
    Data,
    /// Temperatures that are missing, move, or are no temperatures.
    Temperature,
    /// A temperature channel on which the result rests is wrong.
    TemperatureFault,
    /// The reference field: coil system, facility file, Earth's field compensation.
    Facility,
    /// A limit of the method, or an assumption that the result rests on.
    Method,
    /// A run or file that was left out of what was made from several.
    LeftOut,
    /// From a file of an earlier version, which does not tell the kinds of its notes.
    Earlier,
}

impl NoteKind {
    /// The word that stands before the text; only for kinds that concern a result as a whole.
    fn label(self) -> Option<&'static str> {
        match self {
            NoteKind::Axes | NoteKind::ReversedAxis | NoteKind::SwappedAxes => Some("AXES"),
            NoteKind::Fit => Some("FIT"),
            NoteKind::Model => Some("MODEL"),
            _ => None,
        }
    }

    /// Whether a note of this kind qualifies the values: they are not to be used, or not without knowing it, so that it goes with them to
    /// whoever takes them from a file. The other kinds tell how a result came about.
    #[must_use]
    pub fn qualifies_values(self) -> bool {
        match self {
            NoteKind::Axes
            | NoteKind::ReversedAxis
            | NoteKind::SwappedAxes
            | NoteKind::Gain
            | NoteKind::GainJump
            | NoteKind::Mismatch
            | NoteKind::Stuck
            | NoteKind::Fit
            | NoteKind::Model
            | NoteKind::TemperatureFault
            | NoteKind::Facility
            | NoteKind::Earlier => true,
            NoteKind::Spikes
            | NoteKind::Losses
            | NoteKind::Data
            | NoteKind::Temperature
            | NoteKind::Method
            | NoteKind::LeftOut => false,
        }
    }
}

/// A warning: the result stands, and a person should know this about it.
///
/// Parameter files and `--json` hold it as one line of text, which is what [`fmt::Display`] writes.
///
/// ```
/// use calfit::data::note::{Note, NoteKind};
/// let note = Note::new(NoteKind::Fit, "the residuals follow the time").with_remedy("try --order 2");
/// assert_eq!(note.to_string(), "FIT: the residuals follow the time; try --order 2");
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// What it is about.
    pub kind: NoteKind,
    /// The channel, file, run or axis that it is about; absent if it is the result as a whole.
    pub about: Option<String>,
    /// What is the case, without the label of the kind.
    pub text: String,
    /// What to do about it.
    pub remedy: Option<String>,
    /// The run or file with whose values it came here; absent for a note on what was made here.
    pub of: Option<String>,
}

impl Note {
    /// A note about the result as a whole.
    #[must_use]
    pub fn new(kind: NoteKind, text: impl Into<String>) -> Self {
        Self { kind, about: None, text: text.into(), remedy: None, of: None }
    }

    /// About a channel, file, run or axis.
    #[must_use]
    pub fn about(mut self, what: impl Into<String>) -> Self {
        self.about = Some(what.into());
        self
    }

    /// With what to do about it.
    #[must_use]
    pub fn with_remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }

    /// Whether it concerns the result as a whole, so that a report begins with it.
    #[must_use]
    pub fn comes_first(&self) -> bool {
        self.of.is_none() && self.kind != NoteKind::Model && self.kind.label().is_some()
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(label) = self.kind.label() {
            write!(f, "{label}: ")?;
        }
        if let Some(of) = &self.of {
            write!(f, "{of}: ")?;
        }
        f.write_str(&self.text)?;
        match &self.remedy {
            Some(remedy) => write!(f, "; {remedy}"),
            None => Ok(()),
        }
    }
}

impl Serialize for Note {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Notes as files and `--json` hold them: a line of text each, and beside them what each is about.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Told {
    /// A line per note.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// The kind of each, in the same order. Files of earlier versions have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warning_kinds: Vec<NoteKind>,
}

impl Told {
    /// All notes of a result.
    #[must_use]
    pub fn of(notes: &[Note]) -> Self {
        Self { warnings: notes.iter().map(Note::to_string).collect(), warning_kinds: notes.iter().map(|n| n.kind).collect() }
    }

    /// The notes that go with the values of a file or run to what is made from them: those that qualify the values. A file that does not tell
    /// the kinds of its notes gives all of them.
    #[must_use]
    pub fn with_values_of(&self, of: &str) -> Vec<Note> {
        let kinds = self.warning_kinds.iter().copied().chain(std::iter::repeat(NoteKind::Earlier));
        let carried = |(line, kind): (&String, NoteKind)| {
            // The label is written before what it is of.
            let text = kind.label().and_then(|label| line.strip_prefix(label)?.strip_prefix(": ")).unwrap_or(line);
            Note { of: Some(of.to_owned()), ..Note::new(kind, text) }
        };
        self.warnings.iter().zip(kinds).filter(|(_, kind)| kind.qualifies_values()).map(carried).collect()
    }
}

/// Writes the notes of a structure that holds them as they are.
///
/// # Errors
/// Those of the serializer.
pub fn told<S: Serializer>(notes: &[Note], serializer: S) -> Result<S::Ok, S::Error> {
    Told::of(notes).serialize(serializer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_that_qualify_values_go_with_them_and_keep_their_labels() {
        let notes = [
            Note::new(NoteKind::Fit, "the residuals bend").with_remedy("look at them"),
            Note::new(NoteKind::Data, "a row is repeated"),
            Note::new(NoteKind::GainJump, "the gain jumps"),
        ];
        let lines = |told: &Told| told.with_values_of("run A").iter().map(Note::to_string).collect::<Vec<_>>();
        let told = Told::of(&notes);
        assert_eq!(lines(&told), ["FIT: run A: the residuals bend; look at them", "run A: the gain jumps"]);
        // A file of an earlier version does not tell which of them matter.
        let earlier = Told { warning_kinds: Vec::new(), ..told };
        assert_eq!(earlier.with_values_of("run A").len(), 3);
    }
}
