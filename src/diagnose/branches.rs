//! The temperature that the readings of a sweep speak of, against that of the thermistor, while it rises and while it falls.

use super::result::{BranchPoint, Branches};
use crate::data::run::interpolate;
use crate::model::effects::Record;
use nalgebra::DMatrix;

/// Points of a branch.
const POINTS: usize = 16;
/// Half of the time over which rising and falling temperatures are distinguished, s.
const HALF_S: f64 = 60.0;

/// Residuals and sensitivities to the temperature of one model of a sweep.
pub struct Side<'a> {
    /// The sensor as a function of its temperature.
    pub record: &'a Record,
    /// What predictions of held-out stretches leave, enT.
    pub residual_ent: &'a DMatrix<f64>,
}

impl Side<'_> {
    /// Difference of the temperature that row `i` speaks of to that of the model, K, and its weight, 1/K².
    fn difference(&self, i: usize, std_ent: [f64; 3]) -> Option<(f64, f64)> {
        let slope = self.record.thermal.as_ref()?.slope(i, self.record.rows[i].field_coil_nt);
        let over = |f: &dyn Fn(usize) -> f64| (0..3).map(|a| slope[a] * f(a) / std_ent[a].powi(2)).sum::<f64>();
        let weight = over(&|a| slope[a]);
        (weight > 0.0).then(|| (over(&|a| self.residual_ent[(i, a)]) / weight, weight))
    }
}

/// Both branches, with and without the lag; `std_ent` is the noise of a row.
#[must_use]
pub fn of(before: &Side, after: &Side, std_ent: [f64; 3], thermistor: &str, series: &[(f64, f64)], step: usize) -> Branches {
    let row = |i: usize| {
        let t_s = before.record.rows[i].t_s();
        let rise = interpolate(series, t_s + HALF_S) - interpolate(series, t_s - HALF_S);
        (i, interpolate(series, t_s), rise)
    };
    let rows: Vec<(usize, f64, f64)> = (0..before.record.rows.len()).map(row).collect();
    let branch = |rising: bool| -> Vec<BranchPoint> {
        let mut own: Vec<&(usize, f64, f64)> = rows.iter().filter(|r| if rising { r.2 > 0.0 } else { r.2 < 0.0 }).collect();
        own.sort_by(|a, b| a.1.total_cmp(&b.1));
        let point = |part: &[&(usize, f64, f64)]| -> Option<BranchPoint> {
            let mean = |side: &Side| -> Option<(f64, f64)> {
                let all = part.iter().filter_map(|r| side.difference(r.0, std_ent));
                let (sum, weight) = all.fold((0.0, 0.0), |(s, w), (d, own)| (s + d * own, w + own));
                (weight > 0.0).then(|| (sum / weight, weight.sqrt().recip()))
            };
            let ((before_k, _), (after_k, std_k)) = (mean(before)?, mean(after)?);
            let degc = part.iter().map(|r| r.1).sum::<f64>() / part.len() as f64;
            Some(BranchPoint { degc, before_k, after_k, std_k })
        };
        own.chunks(own.len().div_ceil(POINTS).max(1)).filter_map(point).collect()
    };
    Branches { step, thermistor: thermistor.to_owned(), rising: branch(true), falling: branch(false) }
}
