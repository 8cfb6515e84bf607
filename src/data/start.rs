//! When a run began.

use jiff::Timestamp;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;
use std::str::FromStr;

/// The start of a run: a moment, and the text that tells it, which is written as it was read. Starts are in the order of their moments.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Start {
    moment: Timestamp,
    text: String,
}

/// A text that is no start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("is not a date and time in UTC")]
pub struct NoStart;

impl NoStart {
    /// What to write.
    pub const REMEDY: &'static str = "write it as 2013-04-03T09:22:38Z";
}

impl Start {
    /// Whole seconds since 1970, UTC.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.moment.as_second() as f64
    }

    /// The moment some whole seconds later; the start itself where no calendar has it.
    #[must_use]
    pub fn after(&self, seconds: f64) -> Start {
        let later = jiff::SignedDuration::from_secs(seconds.round() as i64);
        self.moment.checked_add(later).map_or_else(|_| self.clone(), Start::from)
    }

    /// Its day in UTC, YYYY-MM-DD.
    #[must_use]
    pub fn day(&self) -> String {
        self.moment.strftime("%Y-%m-%d").to_string()
    }

    /// The text that tells it.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.text
    }
}

impl FromStr for Start {
    type Err = NoStart;
    fn from_str(text: &str) -> Result<Self, NoStart> {
        let moment = text.parse().map_err(|_| NoStart)?;
        Ok(Self { moment, text: text.to_owned() })
    }
}

impl From<Timestamp> for Start {
    fn from(moment: Timestamp) -> Self {
        Self { moment, text: moment.to_string() }
    }
}

impl fmt::Display for Start {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Serialize for Start {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

impl<'de> Deserialize<'de> for Start {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        read(&String::deserialize(deserializer)?)
    }
}

fn read<E: de::Error>(text: &str) -> Result<Start, E> {
    text.parse().map_err(|e: NoStart| E::custom(format!("the start `{text}` {e}; {}", NoStart::REMEDY)))
}

/// A start that may not be known, which files state as an empty text.
pub mod or_empty {
    use super::Start;
    use serde::{Deserialize, Deserializer, Serializer};

    /// Writes it.
    pub fn serialize<S: Serializer>(start: &Option<Start>, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(start.as_ref().map_or("", Start::as_str))
    }

    /// Reads it.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Start>, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.is_empty() { Ok(None) } else { super::read(&text).map(Some) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Head {
        #[serde(with = "or_empty")]
        start: Option<Start>,
    }

    #[test]
    fn a_start_is_a_moment_and_keeps_its_text() {
        let [east, utc, later] =
            ["2013-04-03T11:22:38+02:00", "2013-04-03T09:22:38Z", "2013-04-03T10:22:38Z"].map(|t| t.parse::<Start>().unwrap());
        assert_eq!(east.seconds(), 1_364_980_958.0);
        assert_eq!(east.seconds(), utc.seconds());
        // The text of the first one would be the last of all.
        assert!(east < later && utc < later);
        assert_eq!(serde_json::to_string(&east).unwrap(), "\"2013-04-03T11:22:38+02:00\"");
        for text in ["", "2013-04-03", "2013-04-03 09:22:38", "noon"] {
            assert_eq!(text.parse::<Start>(), Err(NoStart), "{text}");
        }
        assert!(serde_json::from_str::<Start>("\"noon\"").unwrap_err().to_string().contains("`noon` is not a date and time"));
    }

    #[test]
    fn a_start_that_is_not_known_is_an_empty_text() {
        for text in ["{\"start\":\"\"}", "{\"start\":\"2013-04-03T09:22:38Z\"}"] {
            let head: Head = serde_json::from_str(text).unwrap();
            assert_eq!(head.start.is_none(), text.contains("\"\""));
            assert_eq!(serde_json::to_string(&head).unwrap(), text);
        }
        assert!(serde_json::from_str::<Head>("{\"start\":\"noon\"}").is_err());
    }
}
