//! In flight: what the difference of two sensors, or of a sensor and a model of the field, follows. Its means are a problem of the same search
//! as the plateau means of a run; a constant is the linear model, and slow noise, which the field of a spacecraft has, is estimated beside
//! every set of effects.

use super::beside::Beside;
use super::conclusion::Searched;
use super::means::Means;
use super::result::{Diagnosis, Pictures};
use super::{DiagnoseError, problem};
use crate::data::run::Kind;
use crate::data::units::{Scale, counted};
use crate::fit::smooth::Course;
use crate::fit::statistics::extremes;
use crate::model::effects::record::{Channel, EARLIER};
use crate::model::effects::{Record, Row, in_flight};
use crate::record::prepared::PreparedRun;
use nalgebra::{DMatrix, Matrix3};

/// Fewest means.
pub const LEAST_ROWS: usize = 24;

/// Means of a difference with what it may follow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Difference {
    /// What it is of, as `OB-IB`.
    pub name: String,
    /// Begin and end of every mean, s.
    pub span_s: Vec<[f64; 2]>,
    /// Pairs of every mean.
    pub pairs: Vec<usize>,
    /// nT, axes of the spacecraft.
    pub difference_nt: Vec<[f64; 3]>,
    /// Temperature of the first sensor, °C; nan where it is not known.
    pub degc: Vec<f64>,
    /// Everything else by name, see [`in_flight`]; those with values that are not known are not used.
    pub channels: Vec<(String, Vec<f64>)>,
}

fn channel(name: &str, t_s: &[f64], values: &[f64]) -> Channel {
    Channel {
        name: name.to_owned(),
        course: Course::exact(t_s.iter().copied().zip(values.iter().copied()).collect()),
        mean: values.iter().sum::<f64>() / values.len() as f64,
        values: values.to_vec(),
    }
}

fn prepared(of: &Difference) -> PreparedRun {
    let n = of.pairs.len();
    let t_s: Vec<f64> = of.span_s.iter().map(|[a, b]| 0.5 * (a + b)).collect();
    let known = |values: &[f64]| values.iter().all(|v| v.is_finite());
    let row = |span: &[f64; 2]| Row {
        run: 0,
        used_s: *span,
        field_coil_nt: [0.0; 3],
        earlier_coil_nt: [[0.0; 3]; EARLIER],
        linear_ent: [0.0; 3],
    };
    let record = Record {
        kind: Kind::ZeroField,
        scale: Scale::Calibrated,
        rows: of.span_s.iter().map(row).collect(),
        response: Matrix3::identity(),
        span_s: [of.span_s[0][0], of.span_s[n - 1][1]],
        steps: Vec::new(),
        sensor: known(&of.degc).then(|| channel("sensor", &t_s, &of.degc)),
        thermistors: Vec::new(),
        coil: None,
        rack: None,
        variometer: None,
        others: of.channels.iter().filter(|(_, v)| known(v)).map(|(name, v)| channel(name, &t_s, v)).collect(),
        thermal: None,
        trend_order: 0,
        has_samples: false,
    };
    let mean = of.pairs.iter().map(|pairs| 1.0 / *pairs as f64).sum::<f64>() / n as f64;
    PreparedRun {
        readings: DMatrix::from_fn(n, 3, |row, c| of.difference_nt[row][c]),
        design: DMatrix::from_element(n, 1, 1.0),
        white: of.pairs.iter().map(|pairs| [1.0 / *pairs as f64 / mean; 3]).collect(),
        inside: None,
        scatter: None,
        nt_per_ent: [1.0; 3],
        windows: Vec::new(),
        displacement: None,
        notes: Vec::new(),
        thermistor: Vec::new(),
        lag_s: 0.0,
        faults: Vec::new(),
        record,
    }
}

/// Looks for what the difference follows.
///
/// # Errors
/// Too few means, or means that do not tell their noise.
pub fn of_difference(of: &Difference) -> Result<Diagnosis, DiagnoseError> {
    let n = of.pairs.len();
    if n < LEAST_ROWS {
        return Err(DiagnoseError::Record(format!("there are {n} means with both fields, and {LEAST_ROWS} are needed")));
    }
    let catalogue = in_flight::catalogue();
    let prepared = prepared(of);
    let mut means = Means::new(&prepared, prepared.readings.clone(), &catalogue, Vec::new());
    let outcome = problem::search(&mut means).ok_or(DiagnoseError::NoNoise)?;
    let searched = Searched {
        means: &means,
        outcome: &outcome,
        catalogue: &catalogue,
        readings: &prepared.readings,
        design: &prepared.design,
        runs: vec![of.name.clone()],
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        steps: Vec::new(),
        pictures: Pictures::default(),
        beside: Beside::default(),
        notes: outcome.note().into_iter().collect(),
    };
    Ok(Diagnosis { basis: Some(basis(of)), ..searched.diagnosis() })
}

/// What was looked at.
fn basis(of: &Difference) -> String {
    let lengths: Vec<f64> = of.span_s.iter().map(|[a, b]| b - a).collect();
    let [low, high] = extremes(of.degc.iter().copied());
    let degc = if low.is_finite() { format!("; sensor temperature {low:.1} to {high:.1} °C") } else { String::new() };
    format!(
        "{} of up to {:.0} s of {}, axes of the spacecraft, before heaters and wheels are taken off; times count from the first day{degc}",
        counted(of.pairs.len() as u64, "mean"),
        lengths.into_iter().fold(0.0, f64::max),
        of.name
    )
}

#[cfg(test)]
mod tests {
    use super::{Difference, of_difference};
    use crate::diagnose::result::Step;
    use crate::model::effects::in_flight::{FIELD, HEATER, RATE, TEMPERATURE, WHEEL};
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;
    use std::f64::consts::TAU;

    const ROWS: usize = 120;
    const STEP_S: f64 = 480.0;
    const PAIRS: usize = 480;
    /// Noise of a pair, nT.
    const NOISE_NT: f64 = 0.05;

    fn wave(period_s: f64, phase: f64) -> Vec<f64> {
        (0..ROWS).map(|row| (TAU * (row as f64 + 0.5) * STEP_S / period_s + phase).sin()).collect()
    }

    /// Sixteen hours of noise that is white and some that is slow, and everything that it could follow and does not.
    fn quiet(seed: u64) -> Difference {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let mut slow = [0.0; 3];
        let mut mean = || {
            slow = slow.map(|value| 0.9 * value + 0.002 * normal());
            slow.map(|value| value + NOISE_NT / (PAIRS as f64).sqrt() * normal())
        };
        let difference_nt = (0..ROWS).map(|_| mean()).collect();
        let [own, other] = [wave(9000.0, 0.2), wave(14_000.0, 1.7)];
        let rate = |values: &[f64], period_s: f64, phase: f64, swing_k: f64| -> Vec<f64> {
            wave(period_s, phase + 0.25 * TAU).iter().zip(values).map(|(cosine, _)| swing_k * TAU / period_s * cosine).collect()
        };
        // On for parts of the time within a third of it.
        let share = |row: usize| if (30..70).contains(&row) { 0.5 + 0.4 * (1.7 * row as f64).sin() } else { 0.0 };
        let channels = vec![
            (format!("{TEMPERATURE}IB"), other.iter().map(|v| -30.0 + 5.0 * v).collect()),
            (format!("{WHEEL}1"), wave(21_000.0, 0.9).iter().map(|v| 27.0 + 4.0 * v).collect()),
            (format!("{HEATER}h1"), (0..ROWS).map(share).collect()),
            (format!("{FIELD}x"), wave(3700.0, 2.2).iter().map(|v| 40.0 * v).collect()),
            (format!("{RATE}IB"), rate(&other, 14_000.0, 1.7, 5.0)),
            (format!("{RATE}OB"), rate(&own, 9000.0, 0.2, 6.0)),
        ];
        Difference {
            name: "OB-IB".to_owned(),
            span_s: (0..ROWS).map(|row| [row as f64 * STEP_S, (row as f64 + 1.0) * STEP_S]).collect(),
            pairs: vec![PAIRS; ROWS],
            difference_nt,
            degc: own.iter().map(|v| -40.0 + 6.0 * v).collect(),
            channels,
        }
    }

    /// With a part of a channel, of its square about its mean if `bent`.
    fn with(mut of: Difference, channel: &str, size: [f64; 3], bent: bool) -> Difference {
        let values = &of.channels.iter().find(|(name, _)| name == channel).unwrap().1;
        let mean = values.iter().sum::<f64>() / ROWS as f64;
        for (row, value) in of.difference_nt.iter_mut().zip(values) {
            let part = if bent { (value - mean).powi(2) } else { value - mean };
            (0..3).for_each(|axis| row[axis] += size[axis] * part);
        }
        of
    }

    fn steps(of: &Difference) -> Vec<Step> {
        of_difference(of).unwrap().steps
    }

    #[test]
    fn nothing_is_found_in_noise() {
        for seed in 0..2 {
            let found = steps(&quiet(seed));
            assert!(found.is_empty(), "{seed}: {:?}", found.iter().map(|s| &s.sentence).collect::<Vec<_>>());
        }
    }

    /// Heaters and wheels are hidden in the telemetry of a twin, `tests/flight_diagnosis.rs`.
    #[test]
    fn what_was_hidden_is_named_with_its_size_in_nt() {
        for (channel, effect, size, unit, bent) in [
            (format!("{FIELD}x"), "field_difference", [4e-4, -5e-4, 6e-4], "nT/nT", false),
            (format!("{RATE}OB"), "temperature_rate", [4.0, -5.0, 6.0], "nT s/K", false),
            (format!("{TEMPERATURE}IB"), "other_sensor_temperature", [0.0015, -0.0012, 0.002], "nT/K^2", true),
        ] {
            let found = steps(&with(quiet(11), &channel, size, bent));
            let words: Vec<&String> = found.iter().map(|s| &s.sentence).collect();
            assert!(found.len() == 1 && found[0].effect.id() == effect, "{channel}: {words:?}");
            // Behind the slopes of a parabola stand its curvatures.
            let own = found[0].parameters.iter().filter(|p| p.unit == unit);
            let own: Vec<(f64, f64)> = own.map(|p| (p.value, p.std.unwrap())).collect();
            assert_eq!(own.len(), 3, "{words:?}");
            for ((value, std), wanted) in own.into_iter().zip(size) {
                assert!((value - wanted).abs() < 4.0 * std && std < 0.3 * wanted.abs(), "{channel}: {value} ± {std}, {wanted}");
            }
        }
    }
}
