//! Even non-linearity.

use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, Spec, Unseen, singly_and_together};
use crate::data::run::Kind;

/// Even non-linearity.
pub struct QuadraticNonlinearity;

impl Effect for QuadraticNonlinearity {
    fn id(&self) -> &'static str {
        "quadratic_nonlinearity"
    }

    fn about(&self) -> About {
        About {
            summary: "even non-linearity of an axis",
            formula: "x += c2 x² per axis",
            family: Family::StaticEven,
            seen_in: "lin, sweep",
            needs: "reading",
            source: "CH-GFZ-TR-2601 section 7",
            best_measurement: "equal fields of both signs along the axis",
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
        Ok(singly_and_together("quadratic"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        Some(spec.axes.iter().map(|&a| Column::on("c2", a, "enT/enT^2", record, |_, r| r.linear_ent[a].powi(2))).collect())
    }
}
