//! Nominal positions: `R_nom` from "-Z +Y +X" (BC-MAG-TR-0085 sections 1 and 15).

use nalgebra::Matrix3;
use serde::Serialize;
use std::fmt;
use thiserror::Error;

/// Why a position is refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PositionError {
    /// Not three axes.
    #[error("a position has three axes, not {0}")]
    Count(usize),
    /// Not an axis.
    #[error("`{0}` is not an axis; write +X, -X, +Y, -Y, +Z or -Z")]
    Axis(String),
    /// An axis twice.
    #[error("two sensor axes lie along the same coil axis in `{0}`")]
    Repeated(String),
    /// Not reachable by turning a right-handed sensor.
    #[error("`{0}` is left-handed: no rotation leads there")]
    LeftHanded(String),
}

/// Pairs of axes that the three angles lie between.
pub const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The three classes of parameters of sensor and coil system, which do not mix to first order (docs/mathematics.md, "The coil system").
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Scale factors: ln σ of a sensor.
    Scale,
    /// Offsets, nT.
    Offset,
    /// Angles between the axes, degrees.
    Angle,
}

impl Class {
    /// All of them.
    pub const ALL: [Class; 3] = [Class::Scale, Class::Offset, Class::Angle];

    /// Which parameter of the facility the sensor's parameter `i` sees, and with which factor.
    #[must_use]
    pub fn sees(self, position: &Position, i: usize) -> (usize, f64) {
        match self {
            Class::Scale => (position.along(i).0, -1.0),
            Class::Offset => position.along(i),
            Class::Angle => {
                let (a, b) = PAIRS[i];
                let ((k, s), (l, t)) = (position.along(a), position.along(b));
                let pair = PAIRS.iter().position(|p| *p == (k.min(l), k.max(l))).unwrap_or_default();
                (pair, s * t)
            }
        }
    }

    /// A parameter of the facility in words.
    #[must_use]
    pub fn facility_name(self) -> &'static str {
        match self {
            Class::Scale => "scale factor",
            Class::Offset => "offset field",
            Class::Angle => "angle",
        }
    }

    /// Name of the sensor's parameters.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Class::Scale => "sigma",
            Class::Offset => "offset",
            Class::Angle => "xi",
        }
    }
}

/// How the nominal sensor axes lie along the coil axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Position {
    /// For each sensor axis X_m, Y_m, Z_m the coil axis (0, 1, 2) and whether it points the other way.
    axes: [(usize, bool); 3],
}

impl Position {
    /// `X_m = +X_c, Y_m = +Y_c, Z_m = +Z_c`.
    pub const STANDARD: Position = Position { axes: [(0, false), (1, false), (2, false)] };

    /// Reads `["-Z", "+Y", "+X"]`: X_m, Y_m, Z_m along coil axes.
    ///
    /// # Errors
    /// Names that are no axes, an axis twice, a left-handed triple.
    pub fn from_axes(names: &[String]) -> Result<Self, PositionError> {
        let [x, y, z] = names else { return Err(PositionError::Count(names.len())) };
        let axis = |name: &String| {
            let (negative, letter) = match name.strip_prefix('-') {
                Some(rest) => (true, rest),
                None => (false, name.strip_prefix('+').unwrap_or(name)),
            };
            let index = match letter {
                "X" | "x" => 0,
                "Y" | "y" => 1,
                "Z" | "z" => 2,
                _ => return Err(PositionError::Axis(name.clone())),
            };
            Ok((index, negative))
        };
        let position = Position { axes: [axis(x)?, axis(y)?, axis(z)?] };
        let [a, b, c] = position.axes.map(|(index, _)| index);
        if a == b || a == c || b == c {
            return Err(PositionError::Repeated(position.to_string()));
        }
        if position.r_nom().determinant() < 0.0 {
            return Err(PositionError::LeftHanded(position.to_string()));
        }
        Ok(position)
    }

    /// `R_nom`, which takes nominal sensor coordinates to coil coordinates; the axes are the rows of its transpose.
    #[must_use]
    pub fn r_nom(&self) -> Matrix3<f64> {
        let mut to_sensor = Matrix3::zeros();
        for (row, (axis, negative)) in self.axes.into_iter().enumerate() {
            to_sensor[(row, axis)] = if negative { -1.0 } else { 1.0 };
        }
        to_sensor.transpose()
    }

    /// A field in coil coordinates along the nominal sensor axes.
    #[must_use]
    pub fn to_nominal(&self, field_coil: [f64; 3]) -> [f64; 3] {
        self.axes.map(|(axis, negative)| if negative { -field_coil[axis] } else { field_coil[axis] })
    }

    /// The coil axis (0, 1, 2) along which a sensor axis (0, 1, 2) lies, and its sign: +1, or -1 where it points the other way.
    #[must_use]
    pub fn along(&self, sensor_axis: usize) -> (usize, f64) {
        let (axis, negative) = self.axes[sensor_axis];
        (axis, if negative { -1.0 } else { 1.0 })
    }

    /// Reads `-Y +X +Z`, which names the sensor axes along the coil axes X, Y, Z.
    ///
    /// # Errors
    /// As [`Position::from_axes`].
    pub fn from_orientation(text: &str) -> Result<Self, PositionError> {
        let named: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
        let sensor = Self::from_axes(&named)?;
        // The inverse assignment: the sensor axis that lies along coil axis k.
        let mut axes = [(0, false); 3];
        for (coil_axis, (sensor_axis, negative)) in sensor.axes.into_iter().enumerate() {
            axes[sensor_axis] = (coil_axis, negative);
        }
        Ok(Self { axes })
    }

    /// The sensor axes along the coil axes X, Y, Z: `-Y +X +Z`.
    #[must_use]
    pub fn orientation(&self) -> String {
        let mut names = [""; 3].map(str::to_owned);
        for (sensor_axis, (coil_axis, negative)) in self.axes.into_iter().enumerate() {
            names[coil_axis] = format!("{}{}", if negative { '-' } else { '+' }, ["X", "Y", "Z"][sensor_axis]);
        }
        names.join(" ")
    }

    /// The names of the axes, `["-Z", "+Y", "+X"]`.
    #[must_use]
    pub fn names(&self) -> [String; 3] {
        self.axes.map(|(axis, negative)| {
            format!("{}{}", if negative { '-' } else { '+' }, ["X", "Y", "Z"].get(axis).copied().unwrap_or("?"))
        })
    }
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names().join(" "))
    }
}

/// The linear calibration of a sensor in a position that is named by its orientation.
#[derive(Clone, Debug, PartialEq)]
pub struct OrientedRun {
    /// Run.
    pub run: String,
    /// Sensor, empty if not stated.
    pub sensor: String,
    /// Mode, absent if not stated.
    pub mode: Option<String>,
    /// Orientation.
    pub position: Position,
    /// Rotation of the real against the nominal orientation, where it is known.
    pub rho: Option<Matrix3<f64>>,
    /// Sensitivities along the sensor axes, nT/enT.
    pub sigma: [f64; 3],
    /// Offsets, nT.
    pub offset_nt: [f64; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [f64; 3],
    /// Largest applied field, nT, where stated.
    pub field_nt: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn position(text: &str) -> Result<Position, PositionError> {
        Position::from_axes(&text.split(' ').map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn the_positions_of_2013_are_proper_rotations() {
        for text in ["+X +Y +Z", "-X -Y +Z", "-Z -Y -X", "-Z +Y +X"] {
            let p = position(text).unwrap();
            assert_eq!(p.r_nom().determinant(), 1.0);
            assert_eq!(p.to_string(), text);
        }
    }

    #[test]
    fn a_sensor_axis_taken_to_coil_coordinates_is_the_coil_axis_it_lies_along() {
        // X_m = -Z_c, Y_m = +Y_c, Z_m = +X_c
        let p = position("-Z +Y +X").unwrap();
        assert_eq!(p.r_nom() * Vector3::x(), -Vector3::z());
        assert_eq!(p.r_nom() * Vector3::y(), Vector3::y());
        assert_eq!(p.r_nom() * Vector3::z(), Vector3::x());
        assert_eq!(p.to_nominal([1.0, 2.0, 3.0]), [-3.0, 2.0, 1.0]);
    }

    #[test]
    fn an_orientation_names_the_sensor_axes_along_the_coil_axes() {
        // Group 2 of CH-GFZ-TR-2601: sensor -Y to the north, +X to the east, +Z to the zenith.
        let p = Position::from_orientation("-Y +X +Z").unwrap();
        assert_eq!(p.to_string(), "+Y -X +Z");
        assert_eq!([p.along(0), p.along(1), p.along(2)], [(1, 1.0), (0, -1.0), (2, 1.0)]);
        for text in ["+X +Y +Z", "-Y +X +Z", "-Z +Y +X", "-Z +X -Y"] {
            assert_eq!(Position::from_orientation(text).unwrap().orientation(), text);
        }
        assert!(Position::from_orientation("skewed 45 deg").is_err());
    }

    #[test]
    fn impossible_positions_are_refused() {
        assert!(matches!(position("+X +Y -Z"), Err(PositionError::LeftHanded(_))));
        assert!(matches!(position("+X +X +Z"), Err(PositionError::Repeated(_))));
        assert!(matches!(position("+X +Y"), Err(PositionError::Count(2))));
        assert!(matches!(position("+X +Y +W"), Err(PositionError::Axis(_))));
    }
}
