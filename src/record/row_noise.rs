//! White noise of the means of rows, by what their samples say of it.

use super::prepared::Samples;
use crate::fit::noise::state_space::Inside;
use crate::fit::statistics::median;
use crate::model::effects::Record;

/// Fewest samples of an eighth of a row, and fewest rows, from which the noise is estimated; rows with this many times the usual scatter are
/// left out of it.
const LEAST_IN_EIGHTH: usize = 3;
const LEAST_FOR_INSIDE: usize = 12;
const SPIKY: f64 = 10.0;

/// White noise of a mean by the differences of neighbouring eighths of the parts: filtered samples, or a tone between them, do not deceive
/// it as they do the scatter of samples.
pub(super) fn inside(record: &Record, white: &[[f64; 3]], windows: &[[usize; 2]], samples: &Samples) -> Option<Inside> {
    const EIGHTHS: usize = 8;
    let mut all: [Vec<f64>; 3] = Default::default();
    for (row, ([from, to], white)) in windows.iter().zip(white).enumerate() {
        let length = (to - from) / EIGHTHS;
        if length < LEAST_IN_EIGHTH {
            continue;
        }
        let drift = record.drift_ent_per_s(row);
        let apart_s = samples.t_s[from + length] - samples.t_s[*from];
        for (a, all) in all.iter_mut().enumerate() {
            let mean = |k: usize| {
                let own = &samples.reading_ent[from + k * length..from + (k + 1) * length];
                own.iter().map(|v| v[a]).sum::<f64>() / length as f64
            };
            let squares: f64 = (0..EIGHTHS).step_by(2).map(|k| (mean(k + 1) - mean(k) - drift[a] * apart_s).powi(2)).sum();
            // The variance of a difference is twice that of the mean of an eighth.
            let per_pair = squares / (EIGHTHS / 2) as f64 * 0.5 * length as f64 / (to - from) as f64;
            all.push(per_pair / white[a]);
        }
    }
    averaged(all.map(|values| values.into_iter().map(|v| (v, (EIGHTHS / 2) as f64)).collect()))
}

/// White noise of a mean by the standard deviations, enT, and numbers of the samples of the rows, as a file states them; `white` are the
/// variances of the rows over each other. Samples that a filter makes alike scatter less than their means let expect.
pub(super) fn scatter(white: &[[f64; 3]], stated: &[Option<([f64; 3], u64)>]) -> Option<Inside> {
    let known = || white.iter().zip(stated).filter_map(|(white, stated)| Some((white, (*stated)?))).filter(|(_, (_, n))| *n > 1);
    let of = |a: usize| known().map(|(white, (std, n))| (std[a] * std[a] / n as f64 / white[a], (n - 1) as f64)).collect();
    averaged([of(0), of(1), of(2)])
}

/// Mean of the variances that rows tell, each with its degrees of freedom; what happens in single rows is no noise.
fn averaged(all: [Vec<(f64, f64)>; 3]) -> Option<Inside> {
    if all[0].len() < LEAST_FOR_INSIDE {
        return None;
    }
    let mut freedom = f64::INFINITY;
    let variance = all.map(|mut values| {
        let most = SPIKY * median(&mut values.iter().map(|v| v.0).collect::<Vec<f64>>());
        values.retain(|v| v.0 <= most);
        freedom = freedom.min(values.iter().map(|v| v.1).sum());
        values.iter().map(|v| v.0).sum::<f64>() / values.len().max(1) as f64
    });
    variance.iter().all(|v| *v > 0.0).then_some(Inside { variance, freedom })
}
