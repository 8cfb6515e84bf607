//! A polynomial in the temperature needs a higher order.

use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};

/// A polynomial in the temperature needs a higher order.
pub struct ThermalCurvature;

impl Effect for ThermalCurvature {
    fn id(&self) -> &'static str {
        "thermal_curvature"
    }

    fn about(&self) -> About {
        About {
            summary: "a polynomial in T needs a higher order",
            formula: "next power of u = (T - middle)/(half range) in σ_i (x_i += c u³ x_i) or in the offset (x_i += c u³)",
            family: Family::Thermal,
            seen_in: "sweep, thermal",
            needs: "sensor temperature",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "more temperatures, at the ends of the range above all",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        if record.thermal.is_none() {
            return Err("no polynomials of the temperature are fitted to this kind of run".to_owned());
        }
        let mut specs = singly_and_together("offset");
        specs.extend(singly_and_together("sensitivity"));
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let thermal = record.thermal.as_ref()?;
        let power = i32::try_from(thermal.response.len()).ok()?;
        Some(match spec.form.as_str() {
            "offset" => {
                spec.axes.iter().map(|&a| Column::on("offset_c", a, "enT", record, |i, _| thermal.u(i).powi(power))).collect()
            }
            _ => {
                let column =
                    |&a: &usize| Column::on("sigma_c", a, "1", record, |i, r| r.linear_ent[a] * thermal.u(i).powi(power));
                spec.axes.iter().map(column).collect()
            }
        })
    }
}
