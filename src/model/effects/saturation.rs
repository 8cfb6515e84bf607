//! Compression near the end of the range.

use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, Unseen, around};
use crate::data::run::Kind;

/// Onsets that are tried, as a part of the largest reading. Lower ones look like an odd polynomial.
const ONSETS: [f64; 4] = [0.6, 0.7, 0.8, 0.9];

/// Highest onset that is looked for, as a part of the largest reading: beyond it no settings are left.
const HIGHEST_ONSET: f64 = 0.97;
/// Form: a straight line of another slope beyond the onset.
const KNEE: &str = "knee";
/// Form: a parabola beyond the onset.
const BEND: &str = "bend";
/// Shape.
const ONSET: &str = "onset";

/// Compression near the end of the range.
pub struct Saturation;

impl Effect for Saturation {
    fn id(&self) -> &'static str {
        "saturation"
    }

    fn about(&self) -> About {
        About {
            summary: "compression near the end of the range",
            formula: "x -= c sign(x) max(|x| - onset, 0)^p, p = 1 (knee) or 2 (bend), per axis",
            family: Family::StaticOdd,
            seen_in: "lin",
            needs: "reading",
            source: "BC-MAG-TR-0085, remarks",
            best_measurement: "more settings between the onset and the end of the range",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(ONSET, "enT")] }
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn shape_range(&self, record: &Record, spec: &Spec, _name: &str, value: f64) -> [f64; 2] {
        // An onset beyond the readings has no column.
        let [low, _] = around(value);
        [low, (HIGHEST_ONSET * record.most_ent(spec.axes[0])).max(low)]
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        let mut specs = Vec::new();
        for axis in 0..3 {
            let most = record.most_ent(axis);
            for part in ONSETS {
                for form in [KNEE, BEND] {
                    specs.push(Spec::new(form, &[axis]).with(ONSET, part * most, "enT"));
                }
            }
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let onset = spec.get(ONSET)?;
        let power = if spec.form == KNEE { 1 } else { 2 };
        let unit = if power == 1 { "enT/enT" } else { "enT/enT^2" };
        let beyond = |x: f64| -x.signum() * (x.abs() - onset).max(0.0).powi(power);
        Some(spec.axes.iter().map(|&a| Column::on("c", a, unit, record, |_, r| beyond(r.linear_ent[a]))).collect())
    }
}
