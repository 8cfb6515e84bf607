//! Odd non-linearity of converter or feedback.

use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};

/// Odd non-linearity of converter or feedback.
pub struct CubicNonlinearity;

impl Effect for CubicNonlinearity {
    fn id(&self) -> &'static str {
        "cubic_nonlinearity"
    }

    fn about(&self) -> About {
        About {
            summary: "ADC or feedback non-linearity, odd",
            formula: "x += c3 x³ per axis",
            family: Family::StaticOdd,
            seen_in: "lin, sweep",
            needs: "reading",
            source: "CH-GFZ-TR-2601 section 7",
            best_measurement: "fields along the axis up to the end of its range; a test signal into the converter tells the sensor from the electronics",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        Ok(singly_and_together("cubic"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        Some(spec.axes.iter().map(|&a| Column::on("c3", a, "enT/enT^3", record, |_, r| r.linear_ent[a].powi(3))).collect())
    }
}
