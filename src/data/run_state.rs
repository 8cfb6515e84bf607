//! What became of a run of a campaign: the five states that the index of a result folder, the protocol and the counts of a command share.

use serde::{Deserialize, Serialize};
use std::fmt;

/// What became of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunState {
    /// It was analysed, and its results are there.
    Done,
    /// It cannot be read, the analysis refuses it, or its results cannot be written. This is a failure.
    Refused,
    /// Somebody left it out by hand. No failure.
    Excluded,
    /// It gave results, and its file is no longer in the campaign. No failure; the results stay.
    Gone,
    /// No analysis that was asked for takes runs of its kind, or the campaign does not use it. No failure.
    NotApplicable,
}

impl RunState {
    /// Whether results that a run of this state has are of another time: it gives none now.
    #[must_use]
    pub fn is_over(self) -> bool {
        self != RunState::Done
    }

    /// The name in files.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            RunState::Done => "done",
            RunState::Refused => "refused",
            RunState::Excluded => "excluded",
            RunState::Gone => "gone",
            RunState::NotApplicable => "not_applicable",
        }
    }
}

impl fmt::Display for RunState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// What became of a run, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcome {
    /// What became of it.
    pub state: RunState,
    /// Why, in a sentence for people; absent for a run that was analysed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl Outcome {
    /// A run that was analysed.
    #[must_use]
    pub fn done() -> Self {
        Self { state: RunState::Done, reason: None }
    }

    /// A run of another state, with its reason.
    #[must_use]
    pub fn new(state: RunState, reason: impl Into<String>) -> Self {
        Self { state, reason: Some(reason.into()) }
    }
}

/// How many runs there are of every state. Every run of a campaign counts once, whatever became of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RunCounts {
    /// All runs.
    pub runs: usize,
    /// Those that were analysed.
    pub done: usize,
    /// Those that were refused.
    pub refused: usize,
    /// Those that were left out by hand.
    pub excluded: usize,
    /// Those whose file is gone.
    pub gone: usize,
    /// Those that no analysis takes.
    pub not_applicable: usize,
}

impl FromIterator<RunState> for RunCounts {
    fn from_iter<I: IntoIterator<Item = RunState>>(states: I) -> Self {
        let mut counts = Self::default();
        for state in states {
            counts.runs += 1;
            *match state {
                RunState::Done => &mut counts.done,
                RunState::Refused => &mut counts.refused,
                RunState::Excluded => &mut counts.excluded,
                RunState::Gone => &mut counts.gone,
                RunState::NotApplicable => &mut counts.not_applicable,
            } += 1;
        }
        counts
    }
}

impl fmt::Display for RunCounts {
    /// `24 runs: 22 analysed, 1 refused, 1 left out by hand`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            (self.done, "analysed"),
            (self.refused, "refused"),
            (self.excluded, "left out by hand"),
            (self.gone, "gone"),
            (self.not_applicable, "not analysed"),
        ];
        let said: Vec<String> = parts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
        write!(f, "{} {}: {}", self.runs, if self.runs == 1 { "run" } else { "runs" }, said.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_run_counts_once() {
        let counts: RunCounts = [RunState::Done, RunState::Refused, RunState::Done].into_iter().collect();
        assert_eq!(counts.to_string(), "3 runs: 2 analysed, 1 refused");
    }

    #[test]
    fn names_in_files_are_those_of_the_contract() {
        let states = [RunState::Done, RunState::Refused, RunState::Excluded, RunState::Gone, RunState::NotApplicable];
        let names = serde_json::to_value(states).unwrap();
        assert_eq!(names, serde_json::json!(["done", "refused", "excluded", "gone", "not_applicable"]));
        for (state, name) in states.iter().zip(names.as_array().unwrap()) {
            assert_eq!(name.as_str(), Some(state.as_str()));
        }
        assert_eq!(serde_json::to_value(Outcome::done()).unwrap(), serde_json::json!({ "state": "done" }));
        let refused = Outcome::new(RunState::Refused, "no");
        assert_eq!(serde_json::to_value(&refused).unwrap(), serde_json::json!({ "state": "refused", "reason": "no" }));
    }
}
