//! A polynomial in the temperature needs a higher order.

use super::between::{self, BetweenRuns, Cause, Runs, TOGETHER_AND_SINGLY, Term};
use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, Spec, Unseen, singly_and_together};
use crate::data::run::Kind;
use crate::model::position::Class;

/// Forms: what needs the next power.
const OFFSET: &str = "offset";
const SENSITIVITY: &str = "sensitivity";

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::BetweenRuns]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if record.thermal.is_none() {
            return Err(Unseen::NoThermalModel);
        }
        let mut specs = singly_and_together(OFFSET);
        specs.extend(singly_and_together(SENSITIVITY));
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let thermal = record.thermal.as_ref()?;
        let power = i32::try_from(thermal.response.len()).ok()?;
        Some(match spec.form.as_str() {
            OFFSET => {
                spec.axes.iter().map(|&a| Column::on("offset_c", a, "enT", record, |i, _| thermal.u(i).powi(power))).collect()
            }
            _ => {
                let column =
                    |&a: &usize| Column::on("sigma_c", a, "1", record, |i, r| r.linear_ent[a] * thermal.u(i).powi(power));
                spec.axes.iter().map(column).collect()
            }
        })
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let curved: Vec<usize> = (0..runs.sensors()).filter(|s| runs.thermal_order(*s) > 0).collect();
        if curved.is_empty() {
            return Some(BetweenRuns::unseen(Cause::ThermalModel, "the runs span too few temperatures"));
        }
        let mut terms = Vec::new();
        for sensor in curved {
            let (u, power) = (runs.scaled_temperature(sensor), runs.thermal_order(sensor) as i32 + 1);
            let value = |run: usize| if runs.0[run].sensor == sensor { u(run).powi(power) } else { 0.0 };
            for (class, unit) in Class::ALL.into_iter().zip(["", "nT", "deg"]) {
                terms.extend(TOGETHER_AND_SINGLY.map(|axes| Term {
                    spec: Spec::new(class.name(), axes),
                    columns: between::Column::per_axis(&format!("{}_t{power}", class.name()), unit, axes, class, runs, value),
                }));
            }
        }
        Some(BetweenRuns::tried(Cause::ThermalModel, terms))
    }
}
