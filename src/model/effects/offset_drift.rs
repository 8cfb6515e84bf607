//! The offset drifts beyond the fitted trend.

use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};

/// Time constants of a decay that are tried, as parts of the run.
const DECAYS: [f64; 3] = [0.03, 0.08, 0.2];

/// The offset drifts beyond the fitted trend.
pub struct OffsetDrift;

impl Effect for OffsetDrift {
    fn id(&self) -> &'static str {
        "offset_drift"
    }

    fn about(&self) -> About {
        About {
            summary: "offset drifts beyond the fitted trend",
            formula: "x_i += Σ c_p P_p(τ), Legendre polynomials of order 3 and 4 (polynomial), or c exp(-t/time constant) (decay)",
            family: Family::Time,
            seen_in: "all",
            needs: "time",
            source: "CH-GFZ-TR-2601 section 7",
            best_measurement: "zero fields between the settings, and a longer run",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let mut specs = singly_and_together("polynomial");
        let length = record.span_s[1] - record.span_s[0];
        for part in DECAYS {
            for axis in 0..3 {
                specs.push(Spec::new("decay", &[axis]).with("time constant", part * length, "s"));
            }
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        if spec.form == "decay" {
            let constant_s = spec.get("time constant")?;
            let decay = |t: f64| (-(t - record.span_s[0]) / constant_s).exp();
            return Some(spec.axes.iter().map(|&a| Column::on("c", a, "enT", record, |_, r| decay(r.t_s()))).collect());
        }
        let third = |u: f64| 0.5 * (5.0 * u * u - 3.0) * u;
        let fourth = |u: f64| 0.125 * ((35.0 * u * u - 30.0) * u * u + 3.0);
        let columns = spec.axes.iter().flat_map(|&a| {
            [
                Column::on("p3", a, "enT", record, |_, r| third(record.tau(r.t_s()))),
                Column::on("p4", a, "enT", record, |_, r| fourth(record.tau(r.t_s()))),
            ]
        });
        Some(columns.collect())
    }
}
