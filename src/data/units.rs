//! Units and frames used throughout, and their text forms.
//!
//! | quantity | unit | frame | suffix or type |
//! |---|---|---|---|
//! | applied field | nT | coil axes X_c Y_c Z_c | [`FieldCoil`], `_coil_nt` |
//! | field along the nominal sensor axes | nT | nominal sensor axes | `_nominal_nt` |
//! | raw reading | enT (engineering nanotesla) | sensor axes x y z | [`Reading`], `_ent` |
//! | reading before or after a calibration | enT or nT | | [`Scale`] |
//! | temperature | °C | | `_degc` |
//! | time since the run's start | s | facility clock | `_s` |
//! | sensitivity σ | nT/enT | sensor axes | |
//! | angle | degrees in files, D°M'S'' in tables | | `_deg` |

use serde::{Deserialize, Serialize};

/// Names of the three components, in the order of every array.
pub const COMPONENTS: [&str; 3] = ["x", "y", "z"];

/// A field applied by the coil system, nT, components along the coil axes X_c, Y_c, Z_c.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct FieldCoil(pub [f64; 3]);

/// A raw reading of the magnetometer, enT, components along its own (skew) sensor axes x, y, z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Reading(pub [f64; 3]);

/// What numbers along the axes of a sensor are: engineering nT before a calibration, nT after it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Readings of a ground campaign.
    #[default]
    Engineering,
    /// Levels of a mission.
    Calibrated,
}

impl Scale {
    /// The unit.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Scale::Engineering => "enT",
            Scale::Calibrated => "nT",
        }
    }

    /// Whose axes they are along.
    #[must_use]
    pub const fn axis(self) -> &'static str {
        match self {
            Scale::Engineering => "sensor axis",
            Scale::Calibrated => "spacecraft axis",
        }
    }

    /// What the diagnosis looks at.
    #[must_use]
    pub const fn means(self) -> &'static str {
        match self {
            Scale::Engineering => "plateau means",
            Scale::Calibrated => "means",
        }
    }

    /// What they are called that are diagnosed.
    #[must_use]
    pub const fn subject(self) -> &'static str {
        match self {
            Scale::Engineering => "run",
            Scale::Calibrated => "difference",
        }
    }

    /// Of a slope with the temperature.
    #[must_use]
    pub const fn per_kelvin(self) -> &'static str {
        match self {
            Scale::Engineering => "enT/K",
            Scale::Calibrated => "nT/K",
        }
    }

    /// Of a curvature with the temperature.
    #[must_use]
    pub const fn per_kelvin_squared(self) -> &'static str {
        match self {
            Scale::Engineering => "enT/K^2",
            Scale::Calibrated => "nT/K^2",
        }
    }
}

/// An angle as the protocols print it: sign, whole degrees, whole minutes, whole seconds, `+89°47'17''`.
#[must_use]
pub fn degrees_minutes_seconds(angle_deg: f64) -> String {
    if !angle_deg.is_finite() {
        return "not determined".to_owned();
    }
    let sign = if angle_deg < 0.0 { '-' } else { '+' };
    let total = (angle_deg.abs() * 3600.0).round();
    let degrees = (total / 3600.0).floor();
    let minutes = ((total - degrees * 3600.0) / 60.0).floor();
    let seconds = total - degrees * 3600.0 - minutes * 60.0;
    format!("{sign}{degrees:.0}°{minutes:.0}'{seconds:.0}''")
}

/// A value beside its standard uncertainty, the uncertainty with two significant digits: `0.972339 ± 0.000012`.
#[must_use]
pub fn with_uncertainty(value: f64, std: f64) -> String {
    if !std.is_finite() || std <= 0.0 {
        return format!("{value:.6} (uncertainty not determined)");
    }
    // Two significant digits of the uncertainty fix the digits of the value.
    let decimals = (1.0 - std.log10().floor()).clamp(0.0, 15.0) as usize;
    format!("{value:+.decimals$} ± {std:.decimals$}")
}

/// The same in powers of ten, for values of any size: `-1.8018e-5 ± 1.2e-9`.
#[must_use]
pub fn scientific_with_uncertainty(value: f64, std: f64) -> String {
    if !std.is_finite() || std <= 0.0 {
        return format!("{value:.5e}");
    }
    // The last digit of the value stands where the second one of the uncertainty does.
    let digits = if value == 0.0 { 0.0 } else { value.abs().log10().floor() - std.log10().floor() + 1.0 };
    let digits = digits.clamp(0.0, 16.0) as usize;
    format!("{value:.digits$e} ± {std:.1e}")
}

/// A value of three digits: `12.5`, in powers of ten where that would need many zeros: `3.71e-7`.
#[must_use]
pub fn three_digits(value: f64) -> String {
    // What is rounded up to the next power of ten is counted as that.
    let scientific = format!("{value:.2e}");
    match scientific.split_once('e').and_then(|(_, exponent)| exponent.parse::<i32>().ok()) {
        Some(exponent @ -3..=2) => format!("{value:.0$}", (2 - exponent) as usize),
        _ => scientific,
    }
}

/// A place on an axis with six digits, four of them decimals at most.
#[must_use]
pub fn six_digits(value: f64) -> String {
    let decimals = (5.0 - value.abs().log10().floor()).clamp(0.0, 4.0) as usize;
    format!("{value:.decimals$}")
}

/// The first of some times in words, s, and how many more there are.
#[must_use]
pub fn first_times(times_s: impl ExactSizeIterator<Item = f64>, most: usize) -> String {
    let more = times_s.len().saturating_sub(most);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    let first: Vec<String> = times_s.take(most).map(|t_s| format!("{t_s:.0}")).collect();
    format!("{} s{more}", first.join(", "))
}

/// A number of things by the noun for one of them: `1 gap`, `2 gaps`.
#[must_use]
pub fn counted(count: u64, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_carry_seconds_over_into_minutes_and_degrees() {
        assert_eq!(degrees_minutes_seconds(89.788_055_6), "+89°47'17''");
        assert_eq!(degrees_minutes_seconds(0.999_999), "+1°0'0''");
        assert_eq!(degrees_minutes_seconds(-0.5), "-0°30'0''");
        assert_eq!(degrees_minutes_seconds(f64::NAN), "not determined");
    }

    #[test]
    fn uncertainty_has_two_digits_and_fixes_those_of_the_value() {
        assert_eq!(with_uncertainty(0.972_339_21, 0.000_012_34), "+0.972339 ± 0.000012");
        assert_eq!(with_uncertainty(-10.561, 0.25), "-10.56 ± 0.25");
        assert_eq!(with_uncertainty(12345.0, 130.0), "+12345 ± 130");
        assert_eq!(scientific_with_uncertainty(1.001_000_4, 1.7e-6), "1.0010004e0 ± 1.7e-6");
        assert_eq!(scientific_with_uncertainty(-1.801_8e-5, 1.2e-7), "-1.802e-5 ± 1.2e-7");
    }

    #[test]
    fn one_thing_is_no_plural() {
        assert_eq!([0, 1, 2].map(|n| counted(n, "gap")), ["0 gaps", "1 gap", "2 gaps"]);
    }

    #[test]
    fn six_digits_have_no_more_decimals_than_they_need() {
        let pairs = [(765_605_566.327_9, "765605566"), (-12_345.678, "-12345.7"), (18.5, "18.5000"), (0.0, "0.0000")];
        for (value, text) in pairs {
            assert_eq!(six_digits(value), text);
        }
    }

    #[test]
    fn three_digits_are_plain_where_they_can_be_read() {
        let pairs = [
            (1.0, "1.00"),
            (-12.345, "-12.3"),
            (999.6, "1.00e3"),
            (0.001_234_9, "0.00123"),
            (0.000_999_9, "0.00100"),
            (3.7e-7, "3.70e-7"),
            (0.0, "0.00"),
            (f64::INFINITY, "inf"),
        ];
        for (value, text) in pairs {
            assert_eq!(three_digits(value), text);
        }
    }
}
