//! What a person leaves out of the evaluation by hand: a run, a setting of it or a stretch of time, always with the reason.

use super::run::{Header, Run, Setting, Vector, VectorSink};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Something that is left out by hand.
///
/// ```
/// use calfit::data::exclusion::{ExcludedPart, Exclusion};
/// let exclusion: Exclusion = "13-04-03_09-22-38#12=door opened".parse().unwrap();
/// assert_eq!(exclusion.part, ExcludedPart::Setting(12));
/// assert_eq!(exclusion.to_string(), "13-04-03_09-22-38#12=door opened");
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Exclusion {
    /// Run id.
    pub run: String,
    /// What of the run.
    pub part: ExcludedPart,
    /// Why.
    pub reason: String,
}

/// What of a run is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ExcludedPart {
    /// All of it.
    Run,
    /// A setting by its number, from 1.
    Setting(usize),
    /// A stretch of time, s since the run's start.
    Span([f64; 2]),
}

/// Why a text is no exclusion: what to write in its place.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum NoExclusion {
    /// There is no run.
    #[error("write RUN=REASON, RUN#SETTING=REASON or RUN:FROM-UNTIL=REASON")]
    Form,
    /// There is no reason.
    #[error("the reason is missing: what is left out by hand needs one, in a line of text behind the equals sign")]
    Reason,
    /// The setting is no number.
    #[error("the setting is a whole number, 1 for the first one of the run")]
    Setting,
    /// The times are none.
    #[error("the times are two numbers of seconds since the run's start, the earlier one first, 120-180 for example")]
    Span,
}

impl Exclusion {
    /// An exclusion with a reason.
    ///
    /// # Errors
    /// A part that is none, or no reason.
    pub fn new(run: &str, part: ExcludedPart, reason: &str) -> Result<Self, NoExclusion> {
        let reason = reason.trim();
        if run.is_empty() {
            return Err(NoExclusion::Form);
        }
        match part {
            _ if reason.is_empty() || reason.chars().any(char::is_control) => Err(NoExclusion::Reason),
            ExcludedPart::Setting(0) => Err(NoExclusion::Setting),
            ExcludedPart::Span([from, until]) if !(from.is_finite() && until.is_finite() && 0.0 <= from && from < until) => {
                Err(NoExclusion::Span)
            }
            part => Ok(Self { run: run.to_owned(), part, reason: reason.to_owned() }),
        }
    }

    /// Whether it takes something of a setting, which is number `index` from 0.
    #[must_use]
    pub fn touches(&self, index: usize, setting: &Setting) -> bool {
        match self.part {
            ExcludedPart::Run => true,
            ExcludedPart::Setting(number) => number == index + 1,
            ExcludedPart::Span([from, until]) => from < setting.t_end_s && setting.t_start_s < until,
        }
    }

    /// Why it takes nothing of a run, `None` where it takes something.
    #[must_use]
    pub fn misses(&self, run: &Run) -> Option<String> {
        let count = run.settings.len().max(run.blocks.len()).max(run.scalar.len());
        match self.part {
            ExcludedPart::Setting(number) if number > count => {
                Some(format!("the setting {number} that is to be left out by hand is none of the {count} of the run"))
            }
            ExcludedPart::Span([from, until]) => {
                let ends = run.settings.iter().map(|s| [s.t_start_s, s.t_end_s]);
                let ends = ends.chain(run.blocks.iter().map(|b| [b.setting.t_start_s, b.setting.t_end_s]));
                let ends = ends.chain(run.scalar.iter().map(|row| [row.t_s; 2])).chain(run.vectors.span_s);
                let span = ends.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
                let is_beside = until <= span[0] || span[1] < from;
                is_beside.then(|| {
                    format!("the stretch of {from} to {until} s that is to be left out by hand holds nothing of the run, which has data from {:.1} to {:.1} s", span[0], span[1])
                })
            }
            _ => None,
        }
    }

    /// What is left out, in words: `setting 12`.
    #[must_use]
    pub fn what(&self) -> String {
        match self.part {
            ExcludedPart::Run => "the run".to_owned(),
            ExcludedPart::Setting(number) => format!("setting {number}"),
            ExcludedPart::Span([from, until]) => format!("{from} to {until} s"),
        }
    }
}

impl fmt::Display for Exclusion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { run, part, reason } = self;
        match part {
            ExcludedPart::Run => write!(f, "{run}={reason}"),
            ExcludedPart::Setting(number) => write!(f, "{run}#{number}={reason}"),
            ExcludedPart::Span([from, until]) => write!(f, "{run}:{from}-{until}={reason}"),
        }
    }
}

impl FromStr for Exclusion {
    type Err = NoExclusion;

    fn from_str(text: &str) -> Result<Self, NoExclusion> {
        let (place, reason) = text.split_once('=').unwrap_or((text, ""));
        if let Some((run, number)) = place.split_once('#') {
            let number = number.parse().map_err(|_| NoExclusion::Setting)?;
            return Self::new(run, ExcludedPart::Setting(number), reason);
        }
        let Some((run, times)) = place.split_once(':') else { return Self::new(place, ExcludedPart::Run, reason) };
        let (from, until) = times.split_once('-').ok_or(NoExclusion::Span)?;
        let seconds = |text: &str| text.parse::<f64>().map_err(|_| NoExclusion::Span);
        Self::new(run, ExcludedPart::Span([seconds(from)?, seconds(until)?]), reason)
    }
}

impl TryFrom<String> for Exclusion {
    type Error = NoExclusion;

    fn try_from(text: String) -> Result<Self, NoExclusion> {
        text.parse()
    }
}

impl From<Exclusion> for String {
    fn from(exclusion: Exclusion) -> Self {
        exclusion.to_string()
    }
}

impl Run {
    /// Why a setting, which is number `index` from 0, or a part of it is left out by hand.
    #[must_use]
    pub fn excluded_because(&self, index: usize, setting: &Setting) -> Option<&str> {
        self.exclusions.iter().find(|e| e.touches(index, setting)).map(|e| e.reason.as_str())
    }

    /// The same of a setting that is known by its time.
    #[must_use]
    pub fn excluded_because_at(&self, setting: &Setting) -> Option<&str> {
        let index = self.settings.iter().position(|s| s.t_start_s == setting.t_start_s)?;
        self.excluded_because(index, setting)
    }
}

/// Keeps the vectors that are left out by hand from another sink, which sees them as if they had been lost.
pub struct Without<S> {
    sink: S,
    exclusions: Vec<Exclusion>,
    /// Begin of the stretch that is left out now or next, s.
    begin_s: f64,
    /// Stretches that do not overlap, the last one first.
    spans: Vec<[f64; 2]>,
    left_out: u64,
}

impl<S> Without<S> {
    /// The sink of a run of which something is left out.
    #[must_use]
    pub fn new(sink: S, exclusions: Vec<Exclusion>) -> Self {
        Self { sink, exclusions, begin_s: f64::INFINITY, spans: Vec::new(), left_out: 0 }
    }

    /// The sink, with the run that was read told what was left out of it.
    #[must_use]
    pub fn finish(self, run: &mut Run) -> S {
        let rows = std::mem::take(&mut run.scalar).into_iter().enumerate();
        let stays = |(index, row): &(usize, super::run::ScalarRow)| {
            !self.exclusions.iter().any(|e| match e.part {
                ExcludedPart::Run => true,
                ExcludedPart::Setting(number) => number == index + 1,
                ExcludedPart::Span([from, until]) => (from..until).contains(&row.t_s),
            })
        };
        run.scalar = rows.filter(stays).map(|(_, row)| row).collect();
        run.vectors.excluded = self.left_out;
        run.exclusions = self.exclusions;
        self.sink
    }

    #[cold]
    fn is_left_out(&mut self, t_s: f64) -> bool {
        while self.spans.last().is_some_and(|[_, end]| *end <= t_s) {
            self.spans.pop();
        }
        self.begin_s = self.spans.last().map_or(f64::INFINITY, |[begin, _]| *begin);
        self.begin_s <= t_s
    }
}

impl<S: VectorSink> VectorSink for Without<S> {
    fn needs_settings(&self) -> bool {
        self.sink.needs_settings() || self.exclusions.iter().any(|e| matches!(e.part, ExcludedPart::Setting(_)))
    }

    fn begin(&mut self, header: &Header, settings: &[Setting]) {
        let span = |e: &Exclusion| match e.part {
            ExcludedPart::Run => Some([f64::NEG_INFINITY, f64::INFINITY]),
            ExcludedPart::Setting(number) => settings.get(number.checked_sub(1)?).map(|s| [s.t_start_s, s.t_end_s]),
            ExcludedPart::Span(span) => Some(span),
        };
        let mut spans: Vec<[f64; 2]> = self.exclusions.iter().filter_map(span).collect();
        spans.sort_by(|a, b| b[0].total_cmp(&a[0]));
        self.spans = spans;
        self.begin_s = self.spans.last().map_or(f64::INFINITY, |[begin, _]| *begin);
        self.sink.begin(header, settings);
    }

    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        if vector.t_s >= self.begin_s && self.is_left_out(vector.t_s) {
            self.left_out += 1;
        } else {
            self.sink.vector(vector);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_comes_back_from_its_text() {
        let run = "13-04-03_09-22-38";
        for part in [ExcludedPart::Run, ExcludedPart::Setting(3), ExcludedPart::Span([0.0, 12.5])] {
            let exclusion = Exclusion::new(run, part, "a = b, door opened").unwrap();
            assert_eq!(exclusion.to_string().parse(), Ok(exclusion));
        }
    }

    #[test]
    fn what_is_no_exclusion_says_why() {
        let wrong = |text: &str| text.parse::<Exclusion>().unwrap_err();
        assert_eq!(wrong("13-04-03_09-22-38"), NoExclusion::Reason);
        assert_eq!(wrong("13-04-03_09-22-38=  "), NoExclusion::Reason);
        assert_eq!(wrong("=door"), NoExclusion::Form);
        assert_eq!(wrong("a#0=door"), NoExclusion::Setting);
        assert_eq!(wrong("a#x=door"), NoExclusion::Setting);
        assert_eq!(wrong("a:5=door"), NoExclusion::Span);
        assert_eq!(wrong("a:9-5=door"), NoExclusion::Span);
    }
}
