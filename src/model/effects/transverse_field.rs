//! The reading depends on the field across the axis.

use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, Unseen, one};
use crate::data::run::Kind;
use crate::data::units::COMPONENTS;

/// Form: the square of the field across the axis.
const EVEN: &str = "even";
/// Form: the same times the reading of the axis.
const ODD: &str = "odd";
/// Shape: the axis across.
const FROM: &str = "from";

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::fixed(FROM, "sensor axis, 0 to 2")] }
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        let pairs = (0..3).flat_map(|i| (0..3).filter(move |j| *j != i).map(move |j| (i, j)));
        Ok(pairs
            .flat_map(|(i, j)| [EVEN, ODD].map(|form| Spec::new(form, &[i]).with(FROM, j as f64, "sensor axis, 0 to 2")))
            .collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let (i, j) = (*spec.axes.first()?, spec.get(FROM).filter(|f| (0.0..=2.0).contains(f))? as usize);
        let name = format!("c_{}_from_{}", COMPONENTS[i], COMPONENTS[j]);
        let odd = spec.form == ODD;
        let unit = if odd { "enT/enT^3" } else { "enT/enT^2" };
        Some(vec![Column::of(name, unit, record, |_, r| {
            let across = r.linear_ent[j].powi(2);
            one(i, if odd { r.linear_ent[i] * across } else { across })
        })])
    }
}
