//! What is to be known of a calibrated vector, as bits of one number.

use serde::{Deserialize, Serialize};
use std::ops::BitOrAssign;

/// Flags of a vector. The bits are the same in all files of calibrated vectors, so that a mask serves them all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flags(pub u32);

impl Flags {
    /// The temperature lies outside the range of the calibration.
    pub const TEMPERATURE: Self = Self(1);
    /// The field lies outside the range of the calibration.
    pub const FIELD: Self = Self(1 << 16);
    /// The temperature is not known.
    pub const NO_TEMPERATURE: Self = Self(1 << 17);
    /// The flags that applying a calibration can set, with their words.
    pub const OF_CALIBRATION: [(Self, &'static str); 3] = [
        (Self::TEMPERATURE, "temperature outside the range of the calibration"),
        (Self::FIELD, "field outside the range of the calibration"),
        (Self::NO_TEMPERATURE, "temperature not known"),
    ];

    /// Whether one of these is set.
    #[must_use]
    pub fn any_of(self, others: Self) -> bool {
        self.0 & others.0 != 0
    }
}

impl BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}
