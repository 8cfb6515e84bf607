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
            formula: "x_i += Σ c_p P_p(τ), Legendre polynomials of order 3 and 4 (polynomial) or 3 to 6 (waves), or c exp(-t/time constant) (decay)",
            family: Family::Time,
            seen_in: "all",
            needs: "time",
            source: "CH-GFZ-TR-2601 section 7",
            best_measurement: "zero fields between the settings, and a longer run",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let mut specs = singly_and_together("polynomial");
        specs.extend(singly_and_together("waves"));
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
        let orders = if spec.form == "waves" { 3..=6 } else { 3..=4 };
        let columns = spec.axes.iter().flat_map(|&a| {
            orders.clone().map(move |p| Column::on(&format!("p{p}"), a, "enT", record, |_, r| legendre(p, record.tau(r.t_s()))))
        });
        Some(columns.collect())
    }
}

/// Legendre polynomial of an order, by its recurrence.
fn legendre(order: u32, u: f64) -> f64 {
    let (mut before, mut now) = (1.0, u);
    for n in 1..order {
        let n = f64::from(n);
        (before, now) = (now, ((2.0 * n + 1.0) * u * now - n * before) / (n + 1.0));
    }
    if order == 0 { before } else { now }
}
