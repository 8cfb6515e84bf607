//! How the coefficients of a file are applied: the table `[apply]` of every file with coefficients. Who reads it needs nothing else.

use super::convention::Convention;
use serde::{Deserialize, Serialize};

/// One step from a raw reading to the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ApplyStep {
    /// The linearised reading in place of the raw one: `r + c2 r² + c3 r³` per sensor axis.
    Linearise,
    /// The offset is taken off, enT.
    SubtractOffset,
    /// Times σ, per sensor axis.
    Sigma,
    /// Times ω.
    Omega,
    /// Times ρ: from the sensor frame to the nominal sensor frame.
    Rho,
    /// Times `R_nom`: from the nominal sensor frame to coil axes.
    RNom,
    /// A polynomial is evaluated: in files that are not applied to readings of the field.
    Evaluate,
}

/// Which offset a file takes off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OffsetQuantity {
    /// The offset of the sensor.
    BOff,
    /// Offset and residual field of the coil system together.
    BOr,
}

/// Where and how the offset acts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OffsetApplied {
    /// What it is.
    pub quantity: OffsetQuantity,
    /// Where it acts.
    pub acts: String,
    /// Its sign.
    pub sign: String,
    /// Its unit.
    pub unit: String,
}

impl OffsetApplied {
    /// An offset in the unit of the readings that is taken off before the matrix: the only one that this program writes and applies.
    #[must_use]
    pub fn before_the_matrix(quantity: OffsetQuantity) -> Self {
        Self { quantity, acts: "before the matrix".to_owned(), sign: "subtracted".to_owned(), unit: "enT".to_owned() }
    }
}

/// The table `[apply]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Apply {
    /// The steps in their order.
    pub steps: Vec<ApplyStep>,
    /// `bepicolombo` or `rosetta`; absent where the file has no ω.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub omega: Option<Convention>,
    /// ω as a function of ξ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub omega_formula: Option<String>,
    /// `Q` as a function of ξ, since not everyone has the reports.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub q_formula: Option<String>,
    /// The polynomial of the step `evaluate`; absent without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub formula: Option<String>,
    /// The offset; absent where the file has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset: Option<OffsetApplied>,
    /// The frame of the result.
    pub frame: String,
}

/// `Q(ξ)` in words that a program can follow.
pub const Q_FORMULA: &str =
    "Q = [[1, cos(xy), cos(xz)], [0, sin(xy), q], [0, 0, sqrt(sin(xz)^2 - q^2)]], q = (cos(yz) - cos(xy) cos(xz)) / sin(xy)";

impl Apply {
    /// Whether a table says the same as the one that a file of its content has; formulas are words that a file may lack.
    #[must_use]
    pub fn agrees_with(&self, own: &Self) -> bool {
        let same = |stated: &Option<String>, own: &Option<String>| stated.is_none() || stated == own;
        (&self.steps, self.omega, &self.offset, &self.frame) == (&own.steps, own.omega, &own.offset, &own.frame)
            && same(&self.omega_formula, &own.omega_formula)
            && same(&self.q_formula, &own.q_formula)
            && same(&self.formula, &own.formula)
    }

    /// Offset, σ and ω in a convention; the result stands in the sensor frame of that convention.
    #[must_use]
    pub fn to_sensor_frame(convention: Convention, offset: Option<OffsetQuantity>) -> Self {
        let mut steps = vec![ApplyStep::Sigma, ApplyStep::Omega];
        if offset.is_some() {
            steps.insert(0, ApplyStep::SubtractOffset);
        }
        Self {
            steps,
            omega: Some(convention),
            omega_formula: Some(convention.formula().to_owned()),
            q_formula: Some(Q_FORMULA.to_owned()),
            formula: None,
            offset: offset.map(OffsetApplied::before_the_matrix),
            frame: convention.sensor_frame().to_owned(),
        }
    }

    /// The offset alone, for files that go with a file of σ and ω.
    #[must_use]
    pub fn offset_alone(quantity: OffsetQuantity) -> Self {
        Self {
            steps: vec![ApplyStep::SubtractOffset],
            omega: None,
            omega_formula: None,
            q_formula: None,
            formula: None,
            offset: Some(OffsetApplied::before_the_matrix(quantity)),
            frame: "along the sensor axes, before sigma and omega".to_owned(),
        }
    }

    /// The linearisation alone, for files that go with a calibration of linearised readings.
    #[must_use]
    pub fn linearisation_alone() -> Self {
        Self {
            steps: vec![ApplyStep::Linearise],
            offset: None,
            frame: "along the sensor axes, enT: the reading that offset, sigma and omega of a calibration with this linearisation take"
                .to_owned(),
            ..Self::offset_alone(OffsetQuantity::BOff)
        }
    }

    /// A polynomial of what is no reading of the field, and what its value is.
    #[must_use]
    pub fn evaluated(formula: &str, value: &str) -> Self {
        Self {
            steps: vec![ApplyStep::Evaluate],
            offset: None,
            formula: Some(formula.to_owned()),
            frame: value.to_owned(),
            ..Self::offset_alone(OffsetQuantity::BOff)
        }
    }

    /// The same with the rotation of the run behind it, to coil axes.
    #[must_use]
    pub fn on_to_coil_axes(mut self) -> Self {
        self.steps.extend([ApplyStep::Rho, ApplyStep::RNom]);
        self.frame = format!("coil: X_c, Y_c, Z_c; before rho: {}", self.frame);
        self
    }

    /// The same for readings that are linearised first.
    #[must_use]
    pub fn of_linearised_readings(mut self) -> Self {
        self.steps.insert(0, ApplyStep::Linearise);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_are_those_of_the_contract() {
        let table =
            serde_json::to_value(Apply::to_sensor_frame(Convention::BepiColombo, Some(OffsetQuantity::BOr)).on_to_coil_axes());
        let table = table.unwrap();
        assert_eq!(table["steps"], serde_json::json!(["subtract_offset", "sigma", "omega", "rho", "r_nom"]));
        assert_eq!(table["omega"], "bepicolombo");
        assert_eq!(table["omega_formula"], "omega = inverse(transpose(Q(xi)))");
        assert_eq!(
            table["offset"],
            serde_json::json!({"quantity": "b_or", "acts": "before the matrix", "sign": "subtracted", "unit": "enT"})
        );
        let rosetta = Apply::to_sensor_frame(Convention::Rosetta, None);
        assert_eq!(rosetta.omega_formula.as_deref(), Some("omega = Q(xi)"));
        assert_eq!(rosetta.steps, [ApplyStep::Sigma, ApplyStep::Omega]);
    }
}
