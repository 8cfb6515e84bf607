//! The reading depends on the field across the axis.

use super::{About, Column, Effect, Family, Record, Spec, one};
use crate::data::units::COMPONENTS;

/// The reading depends on the field across the axis.
pub struct TransverseField;

impl Effect for TransverseField {
    fn id(&self) -> &'static str {
        "transverse_field"
    }

    fn about(&self) -> About {
        About {
            summary: "reading depends on the field across the axis",
            formula: "x_i += c x_j² (even) or c x_i x_j² (odd), j ≠ i",
            family: Family::CrossField,
            seen_in: "lin, sweep",
            needs: "readings of all axes",
            source: "CH-GFZ-TR-2601 section 1.1c",
            best_measurement: "fields across the axis of both signs, alone and together with a field along it",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        let pairs = (0..3).flat_map(|i| (0..3).filter(move |j| *j != i).map(move |j| (i, j)));
        Ok(pairs
            .flat_map(|(i, j)| ["even", "odd"].map(|form| Spec::new(form, &[i]).with("from", j as f64, "sensor axis, 0 to 2")))
            .collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let (i, j) = (*spec.axes.first()?, spec.get("from").filter(|f| (0.0..=2.0).contains(f))? as usize);
        let name = format!("c_{}_from_{}", COMPONENTS[i], COMPONENTS[j]);
        let odd = spec.form == "odd";
        let unit = if odd { "enT/enT^3" } else { "enT/enT^2" };
        Some(vec![Column::of(name, unit, record, |_, r| {
            let across = r.linear_ent[j].powi(2);
            one(i, if odd { r.linear_ent[i] * across } else { across })
        })])
    }
}
