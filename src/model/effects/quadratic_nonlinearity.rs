//! Even non-linearity.

use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        Ok(singly_and_together("quadratic"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        Some(spec.axes.iter().map(|&a| Column::on("c2", a, "enT/enT^2", record, |_, r| r.linear_ent[a].powi(2))).collect())
    }
}
