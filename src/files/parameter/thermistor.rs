//! THERMISTOR: temperature from voltage or resistance, from a calibration table.

use super::Body;
use super::field::contradicts;
use super::kind::Naming;
use super::quantity::Shape::Scalar;
use super::quantity::{Argument, Entry, Polynomial, Quantities, VALID_DEGC};
use crate::data::apply::Apply;
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::result::Covariance;
use crate::data::thermistor::{ComparedPolynomial, FittedTableRow, ReferenceComparison, ThermistorPolynomial, TriedOrder};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermistorConvention {
    /// The polynomial.
    pub model: String,
    /// What uncertainties are.
    pub uncertainty: String,
}

impl Default for ThermistorConvention {
    fn default() -> Self {
        Self {
            model: "T_r = sum_k coefficients[k] s^k, degC, s the signal in signal_unit; T_c = T_r - T_O, T_O = offset_degc of [reference]; with a divider U = U_ref / (R_ser/R + 1)".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1, from the residuals of the table, which are misfit of the polynomial as much as noise: the variance of the constant holds all of it, so that a value has it at every signal; those of the table itself are not in them".to_owned(),
        }
    }
}

/// The result of a calibration table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermistorFile {
    /// The polynomial.
    #[serde(flatten)]
    pub polynomial: ThermistorPolynomial,
    /// What the numbers mean.
    pub convention: ThermistorConvention,
    /// Covariance of the coefficients.
    pub covariance: Covariance,
    /// A polynomial given for comparison.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compared: Option<ComparedPolynomial>,
    /// Comparison with a reference thermometer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<ReferenceComparison>,
    /// All orders that were fitted.
    pub orders: Vec<TriedOrder>,
    /// The table with its residuals.
    pub row: Vec<FittedTableRow>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl ThermistorFile {
    /// Lowest and highest temperature that the table tells, °C, with the offset against the reference thermometer taken off.
    #[must_use]
    pub fn range_degc(&self) -> [f64; 2] {
        let offset_degc = self.reference.as_ref().map_or(0.0, |reference| reference.offset_degc);
        self.polynomial.valid_degc.map(|degc| degc - offset_degc)
    }

    /// The temperatures of other files that the table tells as well, °C; `None` where there is none.
    #[must_use]
    pub fn within(&self, valid_degc: [f64; 2]) -> Option<[f64; 2]> {
        let own = self.range_degc();
        let both = [own[0].max(valid_degc[0]), own[1].min(valid_degc[1])];
        (both[0] < both[1]).then_some(both)
    }
}

impl Body for ThermistorFile {
    fn apply(&self) -> Option<Apply> {
        let without = "T = sum over k of coefficients[k] s^k, s the signal in signal_unit";
        let formula =
            if self.reference.is_some() { format!("{without}, minus reference.offset_degc") } else { without.to_owned() };
        Some(Apply::evaluated(&formula, "temperature, degC"))
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        let (order, count) = (self.polynomial.order, self.polynomial.coefficients.len());
        if count == order + 1 {
            return Ok(());
        }
        Err(contradicts(path, format!("the polynomial of order {order} has {count} coefficients")))
    }
    const FORMAT: &'static str = "THERMISTOR";
    const NAMING: Naming = Naming::Begin("THERMISTOR__");
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &[Polynomial {
            key: "coefficients",
            name: "c_",
            component: "",
            unit: "degC",
            frame: "thermistor",
            of: Argument::Signal,
        }],
        entries: &[Entry::of(
            "T_O",
            Scalar(""),
            "/reference/offset_degc",
            "/reference/offset_std_degc",
            "degC",
            "thermistor minus reference thermometer",
        )],
        valid_degc: VALID_DEGC,
    });
    const MAY_LACK: &'static [&'static str] = &["coefficients_std", "covariance", "orders", "row"];
    fn file_name(&self) -> String {
        format!("THERMISTOR__{}.toml", self.polynomial.table)
    }
}
