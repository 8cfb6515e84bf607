//! The reading remembers the setting before.

use super::{About, Column, Effect, Family, Record, Row, Spec, singly_and_together};

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        let mut specs = singly_and_together("own axis");
        specs.push(Spec::new("common", &[0, 1, 2]));
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let before = |row: &Row| record.reading(row.previous_coil_nt);
        Some(match spec.form.as_str() {
            "common" => vec![Column::of("c", "enT/enT", record, |_, r| before(r))],
            _ => spec.axes.iter().map(|&a| Column::on("c", a, "enT/enT", record, |_, r| before(r)[a])).collect(),
        })
    }
}
