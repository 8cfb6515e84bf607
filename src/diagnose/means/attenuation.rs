//! Noise of thermistors in the columns of effects: it makes their sizes too small where little of a temperature is left beside the model.
//!
//! A column that is noise by a part λ of its squares, beside all others, gives `1 - λ` of the true size. The part is found with draws of the noise
//! of the readings, taken the same way to the rows as the readings were.

use super::{Means, MeansModel};
use crate::diagnose::candidate::Candidate;
use crate::fit::smooth::Course;
use crate::model::effects::Record;
use crate::model::effects::record::Channel;
use crate::record::prepared;
use nalgebra::DVector;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

/// Draws; a part is known to a tenth of itself with the columns of a hundred rows.
const DRAWS: u64 = 4;
/// Of columns that are noise by a larger part nothing is known.
const MOST: f64 = 0.5;
/// Uncertainty of the part, as a part of it: noise of thermistors is found from the neighbours of each reading.
const PART_STD: f64 = 0.3;
/// Parts below this have no influence.
const LEAST: f64 = 1e-3;
/// Seed of the draws.
const SEED: u64 = 0x7e39;

impl Means<'_> {
    /// Corrects values and standard uncertainties of the linear parameters of terms for noise of the thermistors.
    pub(super) fn without_attenuation(&self, model: &MeansModel, terms: &[&Candidate], sizes: &mut [Vec<(f64, f64)>]) {
        let record = &self.prepared.record;
        let thermistors = [&record.sensor, &record.coil, &record.rack].into_iter().flatten().chain(&record.thermistors);
        if record.thermal.is_some() || thermistors.into_iter().all(|c| c.course.noise == 0.0) {
            return;
        }
        let drawn: Vec<Record> = (0..DRAWS).map(|draw| with_noise(record, SEED + draw)).collect();
        for (term, sizes) in terms.iter().zip(sizes) {
            let mut squares = DVector::<f64>::zeros(term.columns.ncols());
            for other in &drawn {
                let Some(columns) = term.effect.columns(other, &term.spec) else { return };
                let noise = Candidate::of_readings(term.effect, term.spec.clone(), columns).columns - &term.columns;
                if noise.amax() == 0.0 {
                    break;
                }
                let left = model.fitted.beside(&self.whiten(&model.noise, &noise));
                left.column_iter().zip(squares.iter_mut()).for_each(|(c, s)| *s += c.norm_squared() / DRAWS as f64);
            }
            for ((value, std), noise) in sizes.iter_mut().zip(squares.iter()) {
                // One over the variance is the squares that are left of a column beside all others.
                let part = (noise * *std * *std).min(MOST);
                if part > LEAST {
                    *value /= 1.0 - part;
                    *std = (*std / (1.0 - part)).hypot(*value * part * PART_STD);
                }
            }
        }
    }
}

/// The same record with as much noise in its thermistors once more.
fn with_noise(record: &Record, seed: u64) -> Record {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let used_s: Vec<[f64; 2]> = record.rows.iter().map(|r| r.used_s).collect();
    let mut noisy = |channel: &Channel| {
        let Course { series, noise, .. } = &channel.course;
        let draws: Vec<f64> = series
            .iter()
            .map(|_| {
                let z: f64 = StandardNormal.sample(&mut random);
                noise * z
            })
            .collect();
        let drawn = channel.course.weights().course(&draws);
        let both = series.iter().zip(&drawn.series).map(|((t, v), (_, noise))| (*t, v + noise)).collect();
        prepared::channel(&channel.name, Course::exact(both), &used_s)
    };
    Record {
        sensor: record.sensor.as_ref().map(&mut noisy),
        coil: record.coil.as_ref().map(&mut noisy),
        rack: record.rack.as_ref().map(&mut noisy),
        thermistors: record.thermistors.iter().map(&mut noisy).collect(),
        ..record.clone()
    }
}
