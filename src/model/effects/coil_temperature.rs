//! The coil constant follows the temperature of the coils.

use super::one;
use super::record::{Channel, centred};
use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};
use crate::units::COMPONENTS;

/// The coil constant follows the temperature of the coils.
pub struct CoilTemperature;

impl Effect for CoilTemperature {
    fn id(&self) -> &'static str {
        "coil_temperature"
    }

    fn about(&self) -> About {
        About {
            summary: "coil constant follows the coil temperature",
            formula: "B_k (1 + α_k (T_coil - T_0)) on coil axis k; T_0 is the mean over the run",
            family: Family::Facility,
            seen_in: "lin, sweep",
            needs: "coil temperature",
            source: "CH-GFZ-TR-2601 section 6",
            best_measurement: "the same settings with the coils at two temperatures, the sensor at one",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        moves(record.coil.as_ref(), "coil temperature")?;
        let mut specs = singly_and_together("per axis");
        specs.push(Spec::new("common", &[0, 1, 2]));
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = centred(record.coil.as_ref()?);
        Some(scale_columns(record, spec, "alpha", &deviation))
    }
}

/// Refuses a channel that is not there or stands still.
///
/// # Errors
/// The reason.
pub(super) fn moves(channel: Option<&Channel>, what: &str) -> Result<(), String> {
    let channel = channel.ok_or_else(|| format!("no {what} was recorded"))?;
    let spread = centred(channel).iter().map(|v| v.abs()).fold(0.0, f64::max);
    if spread > 0.0 { Ok(()) } else { Err(format!("the {what} stands still")) }
}

/// A scale factor that follows a channel: one per coil axis, or one for all.
pub(super) fn scale_columns(record: &Record, spec: &Spec, name: &str, deviation: &[f64]) -> Vec<Column> {
    if spec.form.starts_with("common") {
        return vec![Column::of(name, "1/K", record, |i, r| r.linear_ent.map(|x| x * deviation[i]))];
    }
    let column = |&k: &usize| {
        let reading = |i: usize, field: [f64; 3]| record.reading(one(k, field[k] * deviation[i]));
        Column::of(format!("{name}_{}", COMPONENTS[k]), "1/K", record, |i, r| reading(i, r.field_coil_nt))
    };
    spec.axes.iter().map(column).collect()
}
