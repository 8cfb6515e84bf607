//! A chosen term, and what may stand in its place.

use super::{Means, MeansModel};
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::RunnerUp;
use crate::fit::scan::{ABSORBED, Fitted, Group, Score};

/// A term beside the model without it.
#[derive(Clone, Copy)]
pub(super) struct Chosen<'a> {
    pub means: &'a Means<'a>,
    /// The model of all others, with the noise that is left with all of them.
    pub without: &'a MeansModel,
    pub candidate: &'a Candidate,
    /// Its columns and its score beside that model.
    pub group: &'a Group,
    pub score: &'a Score,
}

impl Chosen<'_> {
    /// Another one in its place, the best of so many that are tried: by how much it describes the readings better; `None` where the model absorbs it.
    pub fn rival(&self, other: &Candidate, tried: usize) -> Option<RunnerUp> {
        let own = self.means.group(self.without, other);
        if own.surviving <= ABSORBED || own.count() == 0 {
            return None;
        }
        let log_ratio = self.without.fitted.score(&own).evidence - (tried as f64).ln() - self.score.evidence;
        Some(RunnerUp { effect: other.key.clone(), log_ratio, correlation: Fitted::correlation(&own, self.group) })
    }
}
