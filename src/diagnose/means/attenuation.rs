//! Noise of thermistors in the columns of effects: it makes their sizes too small where little of a temperature is left beside the model.
//!
//! A column that is noise by a part λ of its squares, beside all others, gives `1 - λ` of the true size. The part is found with draws of the noise
//! of the readings, taken the same way to the rows as the readings were. What a fit takes the noise of a draw for, in multiples of the column, is the
//! error that such noise makes of the size, as a part of it: a smoothed temperature is off by the same for a while, as the model of the noise does not know.

use super::estimate::solution;
use super::{Means, MeansModel};
use crate::diagnose::candidate::Candidate;
use crate::fit::smooth::Course;
use crate::model::effects::Record;
use crate::model::effects::record::Channel;
use crate::record::prepared;
use nalgebra::DMatrix;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

/// Draws; a part is known to a twentieth of itself with the columns of a hundred rows, and the error that one draw makes to a fifth.
const DRAWS: usize = 16;
/// Of columns that are noise by a larger part nothing is known.
const MOST: f64 = 0.5;
/// Uncertainty of the part, as a part of it: noise of thermistors is found from the neighbours of each reading.
const PART_STD: f64 = 0.3;
/// Parts below this have no influence.
const LEAST: f64 = 1e-3;
/// Seed of the draws.
const SEED: u64 = 0x7e39;

impl Means<'_> {
    /// Corrects values and standard uncertainties of the linear parameters of terms for noise of the thermistors; `terms` are the last columns of the
    /// model.
    pub(super) fn without_attenuation(&self, model: &MeansModel, terms: &[&Candidate], sizes: &mut [Vec<(f64, f64)>]) {
        let record = &self.prepared.record;
        let thermistors = [&record.sensor, &record.coil, &record.rack].into_iter().flatten().chain(&record.thermistors);
        if record.thermal.is_some() || thermistors.into_iter().all(|c| c.course.noise == 0.0) {
            return;
        }
        let Some((_, covariance)) = solution(&model.columns, &model.columns, &model.readings) else { return };
        let drawn = self.drawn.get_or_init(|| with_noise(record));
        let mut at = model.columns.ncols() - terms.iter().map(|t| t.columns.ncols()).sum::<usize>();
        for (term, sizes) in terms.iter().zip(sizes) {
            let Some(noises) = self.noises(model, term, drawn) else { return };
            let linear = if noises.is_empty() { 0 } else { term.columns.ncols() };
            for (j, (value, std)) in sizes.iter_mut().enumerate().take(linear) {
                let columns = DMatrix::from_fn(model.readings.len(), noises.len(), |i, draw| noises[draw][(i, j)]);
                let squares = model.fitted.beside(&columns).norm_squared() / DRAWS as f64;
                // One over the variance is the squares that are left of a column beside all others.
                let part = (squares * *std * *std).min(MOST);
                if part <= LEAST {
                    continue;
                }
                *value /= 1.0 - part;
                // The noise makes an error of its own. What the rows scatter by it is in the uncertainty, but not that it is the same for a while.
                let of_draws = covariance.row(at + j) * model.columns.tr_mul(&columns);
                let rows = columns.column(0).iter().filter(|v| **v != 0.0).count().max(1);
                let scatter = *std * *std * squares / rows as f64;
                let of_noise = (of_draws.norm_squared() / DRAWS as f64 - scatter).max(0.0);
                *std = (*std / (1.0 - part)).hypot(*value * (part * PART_STD).hypot(of_noise.sqrt()));
            }
            at += term.columns.ncols();
        }
    }

    /// What the noise of the thermistors makes of the whitened columns of a term, draw after draw; nothing where it makes nothing.
    fn noises(&self, model: &MeansModel, term: &Candidate, drawn: &[Record]) -> Option<Vec<DMatrix<f64>>> {
        let of_draw = |other: &Record| {
            let columns = term.effect.columns(other, &term.spec)?;
            Some(Candidate::of_readings(term.effect, term.spec.clone(), columns).columns - &term.columns)
        };
        let (first, others) = drawn.split_first()?;
        let first = of_draw(first)?;
        if first.amax() == 0.0 {
            return Some(Vec::new());
        }
        let all = std::iter::once(Some(first)).chain(others.iter().map(of_draw));
        all.map(|noise| Some(self.whiten(&model.noise, &noise?))).collect()
    }
}

/// The same record with as much noise in its thermistors once more, draw after draw.
fn with_noise(record: &Record) -> Vec<Record> {
    let used_s: Vec<[f64; 2]> = record.rows.iter().map(|r| r.used_s).collect();
    let mut drawn = vec![record.clone(); DRAWS];
    let mut random = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let mut noisy = |channel: &Channel| -> Vec<Channel> {
        let Course { series, noise, .. } = &channel.course;
        let weights = channel.course.weights();
        let one = |_: usize| {
            let draws: Vec<f64> = series
                .iter()
                .map(|_| {
                    let z: f64 = StandardNormal.sample(&mut random);
                    noise * z
                })
                .collect();
            let both = series.iter().zip(&weights.course(&draws).series).map(|((t, v), (_, noise))| (*t, v + noise)).collect();
            prepared::channel(&channel.name, Course::exact(both), &used_s)
        };
        (0..DRAWS).map(one).collect()
    };
    let single: [fn(&mut Record) -> &mut Option<Channel>; 3] = [|r| &mut r.sensor, |r| &mut r.coil, |r| &mut r.rack];
    for (place, channel) in single.into_iter().zip([&record.sensor, &record.coil, &record.rack]) {
        let Some(channel) = channel else { continue };
        drawn.iter_mut().zip(noisy(channel)).for_each(|(other, channel)| *place(other) = Some(channel));
    }
    for (k, channel) in record.thermistors.iter().enumerate() {
        drawn.iter_mut().zip(noisy(channel)).for_each(|(other, channel)| other.thermistors[k] = channel);
    }
    drawn
}
