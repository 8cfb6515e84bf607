//! Short forms of the studies, and what the studies themselves promise.

mod across;
mod blind;
mod campaigns;
mod corner;
mod damages;
mod freq;
mod interruptions;
mod structure;

use statrs::distribution::{Binomial, DiscreteCDF};

/// How many runs a test makes, by the environment variable `CALFIT_STUDY`: `short`, which is the default, or `full`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Size {
    /// Minutes for all tests together.
    Short,
    /// Hours, in a release build less.
    Full,
}

impl Size {
    fn asked() -> Self {
        match std::env::var("CALFIT_STUDY").as_deref() {
            Err(_) | Ok("short") => Self::Short,
            Ok("full") => Self::Full,
            Ok(other) => panic!("CALFIT_STUDY is {other}; write short or full"),
        }
    }

    /// The number for this size.
    fn of<T>(self, short: T, full: T) -> T {
        match self {
            Self::Short => short,
            Self::Full => full,
        }
    }
}

/// The smallest count that so many trials with this probability reach less often than in one of 150 studies.
fn too_many(trials: u64, probability: f64) -> u64 {
    let binomial = Binomial::new(probability, trials).unwrap();
    (1..=trials).find(|count| binomial.sf(count - 1) < 1.0 / 150.0).unwrap_or(trials + 1)
}
