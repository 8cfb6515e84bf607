//! In flight: what the difference of two sensors, or of a sensor and a model of the field, follows. Its means are a problem of the same search
//! as the plateau means of a run; a constant is the linear model, and slow noise, which the field of a spacecraft has, is estimated beside
//! every set of effects.

use super::conclusion::Searched;
use super::means::Means;
use super::result::{Diagnosis, Pictures};
use super::{DiagnoseError, problem};
use crate::data::note::{Note, NoteKind};
use crate::data::run::Kind;
use crate::data::units::Scale;
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
        nt_per_ent: [1.0; 3],
        windows: Vec::new(),
        displacement: None,
        notes: Vec::new(),
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
        notes: vec![Note::new(NoteKind::Method, method(of))],
    };
    Ok(searched.diagnosis())
}

fn method(of: &Difference) -> String {
    let lengths: Vec<f64> = of.span_s.iter().map(|[a, b]| b - a).collect();
    let [low, high] = extremes(of.degc.iter().copied());
    let degc = if low.is_finite() { format!("; sensor temperature {low:.1} to {high:.1} °C") } else { String::new() };
    format!(
        "{} means of up to {:.0} s of {}, axes of the spacecraft, before heaters and wheels are taken off; times count from the first day{degc}",
        of.pairs.len(),
        lengths.into_iter().fold(0.0, f64::max),
        of.name
    )
}
