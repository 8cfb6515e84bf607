//! The thermistor leads or lags the part that matters.

use super::{About, Column, Effect, Family, Record, Spec};
use crate::data::run::interpolate;
use crate::model::lag::follow;

/// Lags that are tried, s: a template serves its neighbours to a factor of two.
const LAGS_S: [f64; 9] = [60.0, 120.0, 240.0, 360.0, 480.0, 720.0, 1080.0, 1800.0, 3600.0];
/// Longest lag, as a part of the sweep.
const MOST_PART: f64 = 0.2;

/// The thermistor leads or lags the part that matters.
pub struct ThermalLag;

impl Effect for ThermalLag {
    fn id(&self) -> &'static str {
        "thermal_lag"
    }

    fn about(&self) -> About {
        About {
            summary: "the thermistor leads or lags the part that matters",
            formula: "T(t) is replaced by T(t - lag) (delay) or by what follows T with a time constant (first order); an inverse first order where the thermistor is the one that follows",
            family: Family::Thermal,
            seen_in: "sweep",
            needs: "sensor temperature that rises and falls",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "a sweep that heats and cools through the same temperatures",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        if record.thermal.is_none() {
            return Err("no polynomials of the temperature are fitted to this kind of run".to_owned());
        }
        let length = record.span_s[1] - record.span_s[0];
        let lags = LAGS_S.into_iter().filter(|lag| *lag < MOST_PART * length);
        Ok(lags
            .flat_map(|lag| [("delay", lag), ("delay", -lag), ("first order", lag), ("inverse first order", lag)])
            .map(|(form, lag)| Spec::new(form, &[0, 1, 2]).with("lag", lag, "s"))
            .collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let thermal = record.thermal.as_ref()?;
        let lagged = shifted(&record.sensor.as_ref()?.series, &spec.form, spec.get("lag")?);
        let change: Vec<f64> =
            record.rows.iter().zip(&thermal.degc).map(|(row, now)| interpolate(&lagged, row.t_s()) - now).collect();
        Some(vec![Column::of("part", "1", record, |i, r| thermal.slope(i, r.field_coil_nt).map(|s| s * change[i]))])
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(Spec::new("first order", &[0, 1, 2]).with("lag", 480.0, "s"))
    }
}

/// A series of temperatures as the part that matters has it.
#[must_use]
pub fn shifted(series: &[(f64, f64)], form: &str, lag_s: f64) -> Vec<(f64, f64)> {
    match form {
        "first order" => {
            let mut body = series.first().map_or(f64::NAN, |(_, v)| *v);
            let mut from = series.first().copied().unwrap_or((0.0, f64::NAN));
            series
                .iter()
                .map(|&(t, v)| {
                    if t > from.0 {
                        body = follow(body, from.1, v, (t - from.0) / lag_s);
                        from = (t, v);
                    }
                    (t, body)
                })
                .collect()
        }
        "inverse first order" => {
            let rate = |i: usize| {
                let (a, b) = (series[i.saturating_sub(WIDTH)], series[(i + WIDTH).min(series.len() - 1)]);
                if b.0 > a.0 { (b.1 - a.1) / (b.0 - a.0) } else { 0.0 }
            };
            (0..series.len()).map(|i| (series[i].0, series[i].1 + lag_s * rate(i))).collect()
        }
        _ => series.iter().map(|&(t, v)| (t + lag_s, v)).collect(),
    }
}

/// Readings to either side over which the rate of a thermistor is taken.
const WIDTH: usize = 4;
