//! Effects by reference, and the lists in which they are looked for.

use super::{Effect, unknown::Unknown};
use serde::{Serialize, Serializer};
use std::borrow::Borrow;
use std::fmt;
use std::ops::Deref;

/// A reference to an effect. Two references are equal if they refer to the same effect; ids are unique, so that the id decides.
#[derive(Clone, Copy)]
pub struct EffectRef(&'static dyn Effect);

/// The smooth function of a covariate that stands for what no effect of a catalogue explains. It is no member of a catalogue.
pub const UNKNOWN: EffectRef = EffectRef(&Unknown);

impl EffectRef {
    /// A reference to an effect.
    #[must_use]
    pub const fn new(effect: &'static dyn Effect) -> Self {
        Self(effect)
    }

    /// Whether it is this effect.
    #[must_use]
    pub fn is(self, effect: &dyn Effect) -> bool {
        self.0.id() == effect.id()
    }

    /// Whether it stands for what no effect of a catalogue explains.
    #[must_use]
    pub fn is_unknown(self) -> bool {
        self == UNKNOWN
    }

    /// The id, which stands in files.
    #[must_use]
    pub fn as_str(&self) -> &'static str {
        self.0.id()
    }
}

impl Deref for EffectRef {
    type Target = dyn Effect;

    fn deref(&self) -> &Self::Target {
        self.0
    }
}

impl PartialEq for EffectRef {
    fn eq(&self, other: &Self) -> bool {
        self.0.id() == other.0.id()
    }
}

impl Eq for EffectRef {}

/// For those who read results by their ids, as files have them.
impl PartialEq<str> for EffectRef {
    fn eq(&self, id: &str) -> bool {
        self.0.id() == id
    }
}

impl PartialEq<&str> for EffectRef {
    fn eq(&self, id: &&str) -> bool {
        self.0.id() == *id
    }
}

impl Borrow<str> for EffectRef {
    fn borrow(&self) -> &str {
        self.0.id()
    }
}

impl fmt::Display for EffectRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.0.id())
    }
}

impl fmt::Debug for EffectRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.0.id(), f)
    }
}

impl Serialize for EffectRef {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0.id())
    }
}

/// The effects that a diagnosis looks for, in the order in which they are listed.
#[derive(Clone, Debug, PartialEq)]
pub struct Catalogue(Vec<EffectRef>);

/// The effects of this program.
impl Default for Catalogue {
    fn default() -> Self {
        Self(super::STANDARD.iter().map(|effect| EffectRef(*effect)).collect())
    }
}

/// An effect was added whose id is taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the catalogue has an effect `{id}` already; give the new one another id")]
pub struct IdTaken {
    /// The id.
    pub id: &'static str,
}

impl Catalogue {
    /// These effects alone; their ids differ.
    #[must_use]
    pub fn of(effects: &[&'static dyn Effect]) -> Self {
        Self(effects.iter().map(|effect| EffectRef(*effect)).collect())
    }

    /// With a further effect, the last of the list.
    ///
    /// # Errors
    /// An effect of the catalogue has its id.
    pub fn with(mut self, effect: &'static dyn Effect) -> Result<Self, IdTaken> {
        if self.named(effect.id()).is_some() {
            return Err(IdTaken { id: effect.id() });
        }
        self.0.push(EffectRef(effect));
        Ok(self)
    }

    /// All effects.
    pub fn iter(&self) -> impl Iterator<Item = EffectRef> + '_ {
        self.0.iter().copied()
    }

    /// An effect by its id, [`UNKNOWN`] included.
    #[must_use]
    pub fn named(&self, id: &str) -> Option<EffectRef> {
        self.iter().chain([UNKNOWN]).find(|e| *e == id)
    }
}

#[cfg(test)]
mod tests {
    use super::super::cubic_nonlinearity::CubicNonlinearity;
    use super::*;

    #[test]
    fn ids_are_unique_and_unknown_is_no_member() {
        let catalogue = Catalogue::default();
        let mut ids: Vec<&str> = catalogue.iter().map(|e| e.id()).collect();
        assert!(!ids.contains(&UNKNOWN.as_str()));
        let count = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), count);
        assert_eq!(catalogue.with(&CubicNonlinearity).unwrap_err().id, CubicNonlinearity.id());
    }

    #[test]
    fn references_are_equal_where_the_effect_is() {
        let named = Catalogue::default().named(CubicNonlinearity.id()).unwrap();
        assert_eq!(named, EffectRef::new(&CubicNonlinearity));
        assert!(named.is(&CubicNonlinearity) && named != UNKNOWN);
    }
}
