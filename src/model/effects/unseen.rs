//! Why a record cannot show an effect, whatever its size.

use crate::data::run::Kind;

/// Why a record cannot show an effect.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unseen {
    /// The settings are all zero.
    #[error("no field is applied")]
    NoField,
    /// A covariate that the effect needs was not recorded.
    #[error("no {0} was recorded")]
    NotRecorded(&'static str),
    /// A covariate that the effect needs has one value in the whole record.
    #[error("the {0} stands still")]
    StandsStill(&'static str),
    /// The effect acts inside the plateaus, and the record holds their means alone. The words say where in the run it shows.
    #[error("it shows {0}, and the file brings means only")]
    MeansOnly(&'static str),
    /// The linear model of the record is no polynomial of the temperature.
    #[error("no polynomials of the temperature are fitted to this kind of run")]
    NoThermalModel,
    /// The effect acts on sines alone.
    #[error("needs a frequency run")]
    NeedsSines,
    /// The catalogue states no form in which the effect acts on a kind of run, and no reason.
    #[error("the catalogue has no form of it for a {0} run")]
    NoForm(Kind),
    /// A reason that the effect itself states.
    #[error("{0}")]
    Stated(&'static str),
}

impl Unseen {
    /// What is missing, and where.
    #[must_use]
    pub fn place(&self) -> &'static str {
        match self {
            Unseen::NoField => "settings",
            Unseen::NotRecorded(channel) | Unseen::StandsStill(channel) => channel,
            Unseen::MeansOnly(_) => "samples",
            Unseen::NoThermalModel | Unseen::NeedsSines | Unseen::NoForm(_) => "kind of the run",
            Unseen::Stated(_) => "run",
        }
    }

    /// What to do to see the effect.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            Unseen::NoField => "apply fields along all three axes",
            Unseen::NotRecorded(_) => "record it during the run",
            Unseen::StandsStill(_) => "let it move while all else stays",
            Unseen::MeansOnly(_) => "diagnose the run with its samples",
            Unseen::NoThermalModel => "measure a temperature sweep",
            Unseen::NeedsSines => "measure a frequency run",
            Unseen::NoForm(_) | Unseen::Stated(_) => "see the best measurement of the effect with `calfit effects NAME`",
        }
    }
}
