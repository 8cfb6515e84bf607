//! What is to be known of a calibrated vector, as bits of one number.

use serde::{Deserialize, Serialize};
use std::ops::BitOrAssign;

/// Flags of a vector. The bits are the same in all files of calibrated vectors, so that a mask serves them all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flags(pub u32);

impl Flags {
    /// The temperature lies outside the range of the calibration.
    pub const TEMPERATURE: Self = Self(1);
    /// No state of the boom is known.
    pub const ROTATION: Self = Self(1 << 1);
    /// Outside of the table of offsets.
    pub const JUMP: Self = Self(1 << 2);
    /// No attitude within the limit.
    pub const ATTITUDE: Self = Self(1 << 3);
    /// Within a leap second.
    pub const LEAP: Self = Self(1 << 4);
    /// The first vector after a gap.
    pub const GAP: Self = Self(1 << 5);
    /// Disturbed by a heater, or closed where one switched.
    pub const HEATER: Self = Self(1 << 6);
    /// Changed where wheels or lines were taken off.
    pub const WHEEL: Self = Self(1 << 7);
    /// A count at the end of the converter.
    pub const SATURATED: Self = Self(1 << 8);
    /// In a stretch too short to take wheels off.
    pub const NOT_CLEANED: Self = Self(1 << 9);
    /// Outside of a stated validity in time of the calibration.
    pub const TIME: Self = Self(1 << 10);
    /// The field lies outside the range of the calibration.
    pub const FIELD: Self = Self(1 << 16);
    /// The temperature is not known.
    pub const NO_TEMPERATURE: Self = Self(1 << 17);
    /// A component of the reading is missing or is no finite number.
    pub const NO_READING: Self = Self(1 << 18);
    /// The flags that applying a calibration can set, with their words.
    pub const OF_CALIBRATION: [(Self, &'static str); 4] = [
        (Self::TEMPERATURE, "temperature outside the range of the calibration"),
        (Self::FIELD, "field outside the range of the calibration"),
        (Self::NO_TEMPERATURE, "temperature not known"),
        (Self::NO_READING, "reading missing or no number"),
    ];

    /// All flags, with their words.
    pub const ALL: [(Self, &'static str); 14] = [
        (Self::TEMPERATURE, "temperature outside the range of the calibration"),
        (Self::ROTATION, "no boom state"),
        (Self::JUMP, "outside the table of offsets"),
        (Self::ATTITUDE, "no attitude"),
        (Self::LEAP, "inside a leap second"),
        (Self::GAP, "first vector after a gap"),
        (Self::HEATER, "heater"),
        (Self::WHEEL, "wheels or lines taken off"),
        (Self::SATURATED, "a count at the end of the converter"),
        (Self::NOT_CLEANED, "stretch too short to take wheels off"),
        (Self::TIME, "outside the validity in time"),
        (Self::FIELD, "field outside the range of the calibration"),
        (Self::NO_TEMPERATURE, "temperature not known"),
        (Self::NO_READING, "reading missing or no number"),
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
