//! The offset drifts beyond the fitted trend.

use super::between::{self, BetweenRuns, Cause, Runs, TOGETHER_AND_SINGLY, Term};
use super::unknown::spline;
use super::{
    About, Acts, Column, Effect, Family, PART_OF_THE_OFFSETS, Record, ShapeParameter, Spec, TIME, Unseen, singly_and_together,
};
use crate::data::run::Kind;
use crate::fit::statistics::extent;
use crate::model::position::Class;
use std::f64::consts::{PI, TAU};

/// Order of a trend from which on a single order more is no line.
const FULL_TREND: usize = 2;
/// Time constants of a decay that are tried, as parts of the run.
const DECAYS: [f64; 3] = [0.03, 0.08, 0.2];
/// Turns of a cycle in a run: the least, the most, and the ratio of those that are tried. What turns less often is a trend.
const LEAST_TURNS: f64 = 0.75;
const MOST_TURNS: f64 = 4.7;
const RATIO: f64 = 1.25;

/// Prior weight beside a trend: slow noise is the usual cause of what looks like a drift.
const PRIOR: f64 = 0.1;
/// Form: one Legendre polynomial more than the trend has.
pub const LINE: &str = "line";
/// Forms: two and four of them.
const POLYNOMIAL: &str = "polynomial";
const WAVES: &str = "waves";
/// Form: cosines over the run.
const RIPPLES: &str = "ripples";
/// Form: a natural cubic spline over the run, with its knots in parts of the half run about its middle.
const SMOOTH: &str = "spline";
const KNOTS: [f64; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
/// Form: a sine of a period.
const CYCLE: &str = "cycle";
/// Form: an exponential from the begin of the run.
const DECAY: &str = "decay";
/// Shapes of a cycle and of a decay.
const PERIOD: &str = "period";
const TIME_CONSTANT: &str = "time constant";

/// The offset drifts beyond the fitted trend.
pub struct OffsetDrift;

impl Effect for OffsetDrift {
    fn id(&self) -> &'static str {
        "offset_drift"
    }

    fn about(&self) -> About {
        About {
            summary: "offset drifts beyond the fitted trend",
            formula: "x_i += Σ c_p P_p(τ), Legendre polynomials of the orders above those of the fitted trend: one (line, where the trend has less than two), two (polynomial) or four (waves); or Σ r_m cos(π m (τ + 1) / 2), eight of them (ripples); or a natural cubic spline of five knots (spline); or s sin(2π t/period) + c cos(2π t/period) (cycle); or c exp(-t/time constant) (decay); t since the run's begin",
            family: Family::Time,
            seen_in: "all",
            needs: "time",
            source: "CH-GFZ-TR-2601 section 7",
            best_measurement: "zero fields between the settings, and a longer run",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::BetweenRuns]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(PERIOD, "s"), ShapeParameter::continuous(TIME_CONSTANT, "s")] }
    }

    /// Slow noise is the usual cause of what looks like a drift; where the analyst fits no trend there may be one.
    fn prior(&self, trend_order: Option<usize>) -> f64 {
        if trend_order.is_some_and(|order| order >= FULL_TREND) { PRIOR } else { 1.0 }
    }

    fn is_of_one_run(&self, _form: &str) -> bool {
        true
    }

    fn shown_along(&self, _spec: &Spec) -> Option<String> {
        Some(TIME.to_owned())
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_OFFSETS)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let mut specs = singly_and_together(POLYNOMIAL);
        if record.trend_order < FULL_TREND {
            specs.extend(singly_and_together(LINE));
        }
        specs.extend(singly_and_together(WAVES));
        specs.extend(singly_and_together(RIPPLES));
        specs.extend(singly_and_together(SMOOTH));
        let length = record.span_s[1] - record.span_s[0];
        for turns in std::iter::successors(Some(LEAST_TURNS), |t| Some(t * RATIO)).take_while(|t| *t < MOST_TURNS) {
            specs.extend(singly_and_together(CYCLE).into_iter().map(|s| s.with(PERIOD, length / turns, "s")));
        }
        for part in DECAYS {
            specs.extend(singly_and_together(DECAY).into_iter().map(|s| s.with(TIME_CONSTANT, part * length, "s")));
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let unit = record.scale.unit();
        if spec.form == DECAY {
            let constant_s = spec.get(TIME_CONSTANT)?;
            let decay = |t: f64| (-(t - record.span_s[0]) / constant_s).exp();
            return Some(spec.axes.iter().map(|&a| Column::on("c", a, unit, record, |_, r| decay(r.t_s()))).collect());
        }
        if spec.form == CYCLE {
            let period_s = spec.get(PERIOD)?;
            let phase = |t: f64| TAU * (t - record.span_s[0]) / period_s;
            let columns = spec.axes.iter().flat_map(|&a| {
                let of = |name, part: fn(f64) -> f64| Column::on(name, a, unit, record, |_, r| part(phase(r.t_s())));
                [of("s", f64::sin), of("c", f64::cos)]
            });
            return Some(columns.collect());
        }
        let first = record.trend_order + 1;
        if spec.form == RIPPLES {
            // Cosines stay bounded where polynomials of high order run away beyond their data.
            let cosine = |m: usize, t_s: f64| (0.5 * PI * m as f64 * (record.tau(t_s) + 1.0)).cos();
            let columns = spec.axes.iter().flat_map(|&a| {
                (first..first + 8).map(move |m| Column::on(&format!("r{m}"), a, unit, record, |_, r| cosine(m, r.t_s())))
            });
            return Some(columns.collect());
        }
        if spec.form == SMOOTH {
            let columns = spec.axes.iter().flat_map(|&a| {
                (0..KNOTS.len() - 1).map(move |k| {
                    Column::on(&format!("s{}", k + 1), a, unit, record, |_, r| spline(&KNOTS, record.tau(r.t_s()))[k])
                })
            });
            return Some(columns.collect());
        }
        let orders = match spec.form.as_str() {
            LINE => first..first + 1,
            WAVES => first..first + 4,
            _ => first..first + 2,
        };
        let columns = spec.axes.iter().flat_map(|&a| {
            orders.clone().map(move |p| Column::on(&format!("p{p}"), a, unit, record, |_, r| legendre(p, record.tau(r.t_s()))))
        });
        Some(columns.collect())
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let Some(starts_s) = runs.starts_s() else {
            return Some(BetweenRuns::unseen(Cause::Time, between::NO_TIMES));
        };
        let (low, span) = (starts_s.iter().copied().fold(f64::INFINITY, f64::min), extent(starts_s.iter().copied()));
        let tau = |run: usize| 2.0 * (starts_s[run] - low) / span - 1.0;
        let term = |axes: &[usize]| Term {
            spec: Spec::new(LINE, axes),
            columns: between::Column::per_axis("p1", "nT", axes, Class::Offset, runs, tau),
        };
        Some(BetweenRuns::tried(Cause::Time, TOGETHER_AND_SINGLY.map(term).into()))
    }
}

/// Legendre polynomial (Bonnet's recursion).
fn legendre(order: usize, u: f64) -> f64 {
    let (mut before, mut now) = (0.0, 1.0);
    for n in 0..order {
        let n = n as f64;
        (before, now) = (now, ((2.0 * n + 1.0) * u * now - n * before) / (n + 1.0));
    }
    now
}

#[cfg(test)]
mod tests {
    /// Against the closed forms of the third and fourth polynomial.
    #[test]
    fn legendre_polynomials_are_those_of_the_tables() {
        for u in [-1.0, -0.3, 0.0, 0.7, 1.0] {
            assert!((super::legendre(3, u) - 0.5 * (5.0 * u * u - 3.0) * u).abs() < 1e-14);
            assert!((super::legendre(4, u) - 0.125 * ((35.0 * u * u - 30.0) * u * u + 3.0)).abs() < 1e-14);
        }
    }
}
