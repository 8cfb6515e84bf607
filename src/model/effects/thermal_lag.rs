//! The thermistor leads or lags the part that matters.

use super::{About, Acts, Changes, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, Unseen};
use crate::data::run::Kind;
use crate::data::run::interpolate;
use crate::model::lag::Lag;

/// Lags that are tried, s: a template serves its neighbours to a factor of two.
const LAGS_S: [f64; 9] = [60.0, 120.0, 240.0, 360.0, 480.0, 720.0, 1080.0, 1800.0, 3600.0];
/// Longest lag, as a part of the sweep.
const MOST_PART: f64 = 0.2;

/// Shape.
pub const LAG: &str = "lag";

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn changes(&self) -> Changes {
        Changes::Temperatures
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(LAG, "s")] }
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if record.thermal.is_none() {
            return Err(Unseen::NoThermalModel);
        }
        let length = record.span_s[1] - record.span_s[0];
        let lags = LAGS_S.into_iter().filter(|lag| *lag < MOST_PART * length);
        Ok(lags
            .flat_map(|lag| [Lag::Delay(lag), Lag::Delay(-lag), Lag::FirstOrder(lag), Lag::InverseFirstOrder(lag)])
            .map(spec)
            .collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let thermal = record.thermal.as_ref()?;
        let lagged = of(spec)?.of(&record.sensor.as_ref()?.course);
        let change: Vec<f64> =
            record.rows.iter().zip(&thermal.degc).map(|(row, now)| interpolate(&lagged, row.t_s()) - now).collect();
        Some(vec![Column::of("part", "1", record, |i, r| thermal.slope(i, r.field_coil_nt).map(|s| s * change[i]))])
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(spec(Lag::FirstOrder(480.0)))
    }
}

/// A lag as a term of the catalogue.
#[must_use]
pub fn spec(lag: Lag) -> Spec {
    Spec::new(lag.form(), &[0, 1, 2]).with(LAG, lag.seconds(), "s")
}

/// The lag of a term.
#[must_use]
pub fn of(spec: &Spec) -> Option<Lag> {
    Lag::named(&spec.form, spec.get(LAG)?)
}
