//! How a sensor stands in its reference cube: the rotation from the sensor's frame, as `campaign.toml` states it and as parameter files
//! carry it in the table `[reference]`.
//!
//! The sensor frames of the two conventions of ω are turned against each other. A rotation is stated for one of them, and every file holds
//! the rotation from the frame of its own result, converted exactly with the angles and sensitivities of the file.

use super::convention::{Alignment, Convention, PlanarAxes};
use super::result::Rows;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// The rotation from the sensor frame of one convention to the reference cube, as it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatedReference {
    /// Takes vectors in the sensor frame to the axes of the cube, rows.
    pub rotation: Rows,
    /// Standard uncertainty of the rotation about any axis, degrees.
    pub std_deg: f64,
    /// The convention whose sensor frame it is stated for.
    pub convention: Convention,
}

/// The table `[reference]`: the rotation from the sensor frame of a file to the reference cube.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    /// Takes vectors in the frame `from` to the axes of the reference cube, rows.
    pub rotation: Rows,
    /// Standard uncertainty of the rotation about any axis, degrees.
    pub std_deg: f64,
    /// The frame from which it leads: the sensor frame in which σ and ω of the file give the field.
    pub from: String,
    /// The convention whose sensor frame it was stated for.
    pub stated_for: Convention,
    /// The rotation as it was stated, where that is another convention than the file's: the two sensor frames are turned against each other as
    /// the angles are, so that `rotation` holds at the mean temperature of the file and this one at every temperature. Absent in files from
    /// before it was told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stated_rotation: Option<Rows>,
}

/// What a matrix that is printed with six decimals may miss of a rotation: half a unit in the products of three pairs of elements, twice.
const ROUNDING: f64 = 2e-6;

/// Whether rows are those of a rotation: lengths of one, right angles, no mirror.
#[must_use]
pub fn is_rotation(rows: &Rows) -> bool {
    is_orthonormal(rows) && matrix(rows).determinant() > 0.0
}

/// The same, or a rotation with a mirror.
#[must_use]
pub fn is_orthonormal(rows: &Rows) -> bool {
    let r = matrix(rows);
    (r * r.transpose() - Matrix3::identity()).amax() < ROUNDING
}

impl StatedReference {
    /// Whether it is the same but for rounding.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        let same = (matrix(&self.rotation) - matrix(&other.rotation)).amax() < ROUNDING;
        same && (self.std_deg, self.convention) == (other.std_deg, other.convention)
    }

    /// The rotation from the sensor frame in which `alignment` gives the field.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn in_frame_of(&self, alignment: &Alignment) -> Result<Reference, PlanarAxes> {
        Ok(Reference {
            rotation: rows(&(matrix(&self.rotation) * to_frame_of(self.convention, alignment)?)),
            std_deg: self.std_deg,
            from: alignment.convention.sensor_frame().to_owned(),
            stated_for: self.convention,
            stated_rotation: (self.convention != alignment.convention).then_some(self.rotation),
        })
    }
}

impl Reference {
    /// The rotation as it was stated; `alignment` is that of the file.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn stated(&self, alignment: &Alignment) -> Result<StatedReference, PlanarAxes> {
        Ok(StatedReference {
            rotation: rows(&(matrix(&self.rotation) * to_frame_of(self.stated_for, alignment)?.transpose())),
            std_deg: self.std_deg,
            convention: self.stated_for,
        })
    }
}

/// Takes vectors in the sensor frame in which `alignment` gives the field to the sensor frame of a convention.
fn to_frame_of(convention: Convention, alignment: &Alignment) -> Result<Matrix3<f64>, PlanarAxes> {
    if convention == alignment.convention {
        return Ok(Matrix3::identity());
    }
    Ok(alignment.to_other()?.rotation.transpose())
}

fn matrix(rows: &Rows) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c])
}

fn rows(matrix: &Matrix3<f64>) -> Rows {
    std::array::from_fn(|r| std::array::from_fn(|c| matrix[(r, c)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    fn turned() -> Rows {
        rows(Rotation3::from_scaled_axis(Vector3::new(0.02, -0.3, 1.1)).matrix())
    }

    #[test]
    fn one_reading_is_one_field_in_the_cube_whatever_the_convention() {
        let bepi = Alignment { convention: Convention::BepiColombo, sigma: [1.0, 1.01, 0.98], xi_deg: [90.7, 89.2, 90.4] };
        let rosetta = bepi.to_other().unwrap().alignment;
        let reading = Vector3::new(1000.0, -2000.0, 500.0);
        for convention in [Convention::BepiColombo, Convention::Rosetta] {
            let stated = StatedReference { rotation: turned(), std_deg: 0.01, convention };
            let [a, b] = [bepi, rosetta].map(|alignment| {
                let reference = stated.in_frame_of(&alignment).unwrap();
                assert!(is_rotation(&reference.rotation));
                assert_eq!(reference.from, alignment.convention.sensor_frame());
                let back = reference.stated(&alignment).unwrap();
                assert!((matrix(&back.rotation) - matrix(&stated.rotation)).amax() < 1e-14);
                matrix(&reference.rotation) * alignment.transfer().unwrap() * reading
            });
            assert!((a - b).amax() < 1e-9, "{a} {b}");
            // In the convention that it is stated for, it is the stated one.
            let own = if convention == Convention::BepiColombo { bepi } else { rosetta };
            assert_eq!(stated.in_frame_of(&own).unwrap().rotation, stated.rotation);
        }
    }

    #[test]
    fn what_is_no_rotation_is_told() {
        assert!(is_rotation(&turned()) && is_rotation(&[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]));
        let mirror = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]];
        let long = [[1.001, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let skew = [[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for rows in [mirror, long, skew] {
            assert!(!is_rotation(&rows));
        }
    }
}
