//! The reading remembers the setting before.

use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, Row, Spec, Unseen, singly_and_together};
use crate::data::run::Kind;

/// Form: a factor for each axis.
const OWN: &str = "own axis";
/// Form: one factor for all.
const COMMON: &str = "common";

/// The reading remembers the setting before.
pub struct Remanence;

impl Effect for Remanence {
    fn id(&self) -> &'static str {
        "remanence"
    }

    fn about(&self) -> About {
        About {
            summary: "reading remembers the previous setting",
            formula: "x_i += c_i x_i of the setting before, one c per axis or a common one",
            family: Family::History,
            seen_in: "lin",
            needs: "previous setting",
            source: "RO-IGEP-TR0028 section 3",
            best_measurement: "the same field once after a strong and once after a weak one",
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
        let mut specs = singly_and_together(OWN);
        specs.push(of_one_cause(&[0, 1, 2]));
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let before = |row: &Row| record.reading(row.earlier_coil_nt[0]);
        Some(match spec.form.as_str() {
            COMMON => vec![Column::of("c", "enT/enT", record, |_, r| before(r))],
            _ => spec.axes.iter().map(|&a| Column::on("c", a, "enT/enT", record, |_, r| before(r)[a])).collect(),
        })
    }
}

/// A memory of the same part on all of some axes.
#[must_use]
pub fn of_one_cause(axes: &[usize]) -> Spec {
    match axes {
        [_] => Spec::new(OWN, axes),
        _ => Spec::new(COMMON, &[0, 1, 2]),
    }
}
