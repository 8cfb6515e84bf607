//! Compression near the end of the range.

use super::{About, Column, Effect, Family, Record, Spec};

/// Onsets that are tried, as a part of the largest reading.
/// Lower ones look like an odd polynomial.
const ONSETS: [f64; 4] = [0.6, 0.7, 0.8, 0.9];

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        let mut specs = Vec::new();
        for axis in 0..3 {
            let most = record.most_ent(axis);
            for part in ONSETS {
                for form in ["knee", "bend"] {
                    specs.push(Spec::new(form, &[axis]).with("onset", part * most, "enT"));
                }
            }
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let onset = spec.get("onset")?;
        let power = if spec.form == "knee" { 1 } else { 2 };
        let unit = if power == 1 { "enT/enT" } else { "enT/enT^2" };
        let beyond = |x: f64| -x.signum() * (x.abs() - onset).max(0.0).powi(power);
        Some(spec.axes.iter().map(|&a| Column::on("c", a, unit, record, |_, r| beyond(r.linear_ent[a]))).collect())
    }
}
