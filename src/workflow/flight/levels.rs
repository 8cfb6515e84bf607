//! The levels of flight processing and what each needs.

use super::Prepared;
use crate::files::flight::mission::MeansFrame;
use crate::flight::Stage;
use std::collections::BTreeSet;
use thiserror::Error;

/// A level (RO-IGEP-TR0028 section 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Axes of the sensor.
    A,
    /// Axes of the spacecraft.
    B,
    /// Celestial frame.
    C,
    /// Figures of the difference of both sensors.
    D,
    /// Means of A.
    E,
    /// Means of B.
    F,
    /// Means of C.
    G,
    /// C without wheels and lines.
    H,
    /// Means of H.
    I,
    /// What both sensors share.
    J,
    /// B without heater jumps.
    K,
    /// K in the celestial frame.
    L,
}

impl Level {
    /// All of them.
    pub const ALL: [Level; 12] =
        [Level::A, Level::B, Level::C, Level::D, Level::E, Level::F, Level::G, Level::H, Level::I, Level::J, Level::K, Level::L];

    /// Its letter.
    #[must_use]
    pub fn letter(self) -> &'static str {
        const LETTERS: [&str; 12] = ["A", "B", "C", "D", "E", "F", "G", "H", "I", "J", "K", "L"];
        LETTERS[self as usize]
    }
}

impl Level {
    /// Whether heater jumps are taken off for it.
    #[must_use]
    pub fn needs_heater(self) -> bool {
        use Level::{F, G, H, I, J, K, L};
        matches!(self, F | G | H | I | J | K | L)
    }

    /// The stage of single vectors that it is made of.
    #[must_use]
    pub fn stage(self) -> Stage {
        use Level::{A, B, C, D, E, F, G, H, I, J, K, L};
        match self {
            A | E => Stage::A,
            B | F | K => Stage::B,
            C | D | G | H | I | J | L => Stage::C,
        }
    }

    /// Whether it is made of two sensors.
    #[must_use]
    pub fn is_of_two(self) -> bool {
        matches!(self, Level::D | Level::J)
    }

    /// Whether it is in the celestial frame.
    #[must_use]
    pub fn is_celestial(self) -> bool {
        use Level::{C, G, H, I, L};
        matches!(self, C | G | H | I | L)
    }
}

/// Levels that are wanted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Levels {
    /// The levels; every one that can be made if `all`.
    named: BTreeSet<Level>,
    /// Every level whose inputs the configuration names.
    all: bool,
    /// Housekeeping.
    pub hk: bool,
}

/// Why levels cannot be made.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoLevels {
    /// No such level.
    #[error("`{0}` is no level")]
    Unknown(String),
    /// A level of two sensors where one is asked for.
    #[error("level {0} is made of two sensors, and --sensor names one")]
    OfTwo(&'static str),
    /// Something is missing.
    #[error("level {level} needs {what}, which is not there")]
    Missing {
        /// Level.
        level: &'static str,
        /// What it needs.
        what: &'static str,
    },
}

impl NoLevels {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            NoLevels::Unknown(_) => "name levels by their letters, A to L, such as ABC, or `all`",
            NoLevels::OfTwo(_) => "leave --sensor out, or the level, or make it with --sensor common",
            NoLevels::Missing { .. } => "state it in the configuration, see `input`, or leave the level out",
        }
    }
}

impl Levels {
    /// Reads `ABC` or `all`.
    ///
    /// # Errors
    /// A letter of no level.
    pub fn parse(text: &str, hk: bool) -> Result<Self, NoLevels> {
        if text.eq_ignore_ascii_case("all") {
            return Ok(Self { named: BTreeSet::new(), all: true, hk: true });
        }
        let level = |letter: char| {
            let found = Level::ALL.into_iter().find(|level| level.letter().chars().eq(letter.to_uppercase()));
            found.ok_or_else(|| NoLevels::Unknown(letter.to_string()))
        };
        let named = text.chars().map(level).collect::<Result<BTreeSet<Level>, _>>()?;
        if named.is_empty() && !hk { Err(NoLevels::Unknown(String::new())) } else { Ok(Self { named, all: false, hk }) }
    }

    /// The levels that are written.
    #[must_use]
    pub fn of(&self, prepared: &Prepared) -> BTreeSet<Level> {
        if self.all {
            Level::ALL.into_iter().filter(|level| level.lacks(prepared).is_none()).collect()
        } else {
            self.named.clone()
        }
    }

    /// Checks that every level that is named can be made, of one sensor alone if one is asked for.
    ///
    /// # Errors
    /// The first level that cannot, with what it lacks.
    pub fn can_be_made(&self, prepared: &Prepared, of_one: bool) -> Result<(), NoLevels> {
        if let Some(level) = self.named.iter().find(|level| of_one && level.is_of_two()) {
            return Err(NoLevels::OfTwo(level.letter()));
        }
        let missing = self.named.iter().find_map(|level| level.lacks(prepared).map(|what| (level.letter(), what)));
        let hk = (self.hk && !self.all && prepared.mission.hk.is_none()).then_some(("HK", "the folder `hk`"));
        match missing.or(hk) {
            Some((level, what)) => Err(NoLevels::Missing { level, what }),
            None => Ok(()),
        }
    }
}

impl Level {
    /// What is missing to make it.
    #[must_use]
    pub fn lacks(self, prepared: &Prepared) -> Option<&'static str> {
        let mission = &prepared.mission;
        let has_step = |name: &str| mission.steps.iter().any(|s| s == name);
        let rotation =
            || (mission.sensors.iter().any(|s| s.rotations.is_empty()) && has_step("rotate")).then_some("[[sensor.rotation]]");
        let celestial = || (prepared.attitude.is_none() || !has_step("attitude")).then_some("[celestial] with an attitude table");
        let wheels = || prepared.wheels.is_none().then_some("[wheels]");
        let heater = || mission.heater.is_none().then_some("[heater]");
        let with_telemetry = || mission.sensors.iter().filter(|s| !prepared.catalogue.of(&s.name).is_empty()).count();
        let two = || (with_telemetry() < 2).then_some("telemetry of two sensors");
        match self {
            Level::A | Level::E => None,
            Level::B | Level::F => rotation(),
            Level::C | Level::G => rotation().or_else(celestial),
            Level::H | Level::I => rotation().or_else(celestial).or_else(wheels),
            Level::D => rotation().or_else(two),
            Level::J => match mission.common.frame() {
                MeansFrame::Sensor => two(),
                MeansFrame::Spacecraft => rotation().or_else(two),
                MeansFrame::Celestial => rotation().or_else(celestial).or_else(two),
            },
            Level::K => rotation().or_else(heater),
            Level::L => rotation().or_else(celestial).or_else(heater),
        }
    }
}
