//! Odd non-linearity of converter or feedback.

use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, Spec, Unseen, singly_and_together};
use crate::data::run::Kind;

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        Ok(singly_and_together("cubic"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        Some(spec.axes.iter().map(|&a| Column::on("c3", a, "enT/enT^3", record, |_, r| r.linear_ent[a].powi(3))).collect())
    }
}
