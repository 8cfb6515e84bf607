//! What cannot be the work of a heater: short runs of vectors that stand out of those on both sides, and steps far larger than all others.

use nalgebra::Vector3;

use super::{HeaterInterval, HeaterOptions};
use crate::fit::statistics::central_median;

/// Time between the vectors on both sides of a run, in cells. A heater that is on for less cannot be told: two edges are at least two cells
/// and a quarter apart in the search.
const LONGEST_CELLS: f64 = 2.2;
/// Of noise, neighbours differ by this many of their mean differences once in 1e40 vectors: thirteen standard deviations of a vector.
const OUTSTANDING: f64 = 12.0;
/// The vectors on both sides of a run agree within half of what stands out, or within this part of the run's distance from them.
const AGREE: f64 = 0.1;
/// Mean over median of the modulus of a normal deviate.
const MEAN_OVER_MEDIAN: f64 = 1.183;
/// Nothing stands out by less, nT: readings without noise have no usual difference.
const LEAST_NT: f64 = 1.0;
/// Vectors in a row from which their usual difference is told.
const BLOCK: usize = 256;
const LEAST_VECTORS: usize = 8;
/// A step is strange that is so many times the usual difference of neighbouring cells, ...
const STRANGE: f64 = 50.0;
/// ... and so many times the field of all heaters together.
const BEYOND_ALL: f64 = 2.0;

/// The rows of short runs of vectors within an interval that stand out of those on both sides by far more than noise does, which agree with
/// each other. They say nothing of heaters.
pub(super) fn short_runs(
    time_tt2000: &[i64],
    field_nt: &[Vec<f64>; 3],
    interval: HeaterInterval,
    options: &HeaterOptions,
) -> Vec<usize> {
    let vector = |row: usize| Vector3::new(field_nt[0][row], field_nt[1][row], field_nt[2][row]);
    let rows: Vec<usize> =
        interval.rows(time_tt2000).filter(|&row| vector(row).iter().all(|component| component.is_finite())).collect();
    if rows.len() < LEAST_VECTORS {
        return Vec::new();
    }
    let length = rows.len().div_ceil(rows.len().div_ceil(BLOCK));
    let usual: Vec<Vector3<f64>> = rows
        .chunks(length)
        .map(|block| {
            Vector3::from_fn(|c, _| {
                let mut steps: Vec<f64> = block.windows(2).map(|w| (field_nt[c][w[1]] - field_nt[c][w[0]]).abs()).collect();
                let middle = if steps.is_empty() { 0.0 } else { central_median(&mut steps) };
                (MEAN_OVER_MEDIAN * middle).max(LEAST_NT / OUTSTANDING)
            })
        })
        .collect();
    let longest_ns = (LONGEST_CELLS * options.cell_s * 1e9) as i64;
    let mut found = Vec::new();
    let mut at = 1;
    while at < rows.len() {
        let before = vector(rows[at - 1]);
        let usual = usual[(at - 1) / length];
        let distance = |place: usize| (vector(rows[place]) - before).component_div(&usual).amax();
        let mut nearest = f64::INFINITY;
        let reach = (at..rows.len()).take_while(|place| time_tt2000[rows[*place]] - time_tt2000[rows[at - 1]] <= longest_ns);
        let mut end = None;
        for place in reach {
            let own = distance(place);
            if place > at && own <= (0.5 * OUTSTANDING).max(AGREE * nearest) {
                end = Some(place);
                break;
            }
            if own <= OUTSTANDING {
                break;
            }
            nearest = nearest.min(own);
        }
        match end {
            Some(end) => {
                found.extend_from_slice(&rows[at..end]);
                at = end + 1;
            }
            None => at += 1,
        }
    }
    found
}

/// The step between neighbouring cells, nT, beyond which no heater of these fields makes it.
pub(super) fn strange_nt(increments: &[Vector3<f64>], vectors_nt: &[Vector3<f64>]) -> f64 {
    let mut steps: Vec<f64> = increments.iter().map(|step| step.norm()).filter(|step| step.is_finite()).collect();
    if steps.len() < LEAST_VECTORS {
        return f64::INFINITY;
    }
    let all: f64 = vectors_nt.iter().map(|vector| vector.norm()).sum();
    (STRANGE * central_median(&mut steps)).max(BEYOND_ALL * all).max(LEAST_NT)
}

/// Increments of which strange steps are missing.
pub(super) fn without_strange(mut increments: Vec<Vector3<f64>>, vectors_nt: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let most_nt = strange_nt(&increments, vectors_nt);
    increments.iter_mut().filter(|step| step.norm() > most_nt).for_each(|step| *step = Vector3::repeat(f64::NAN));
    increments
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;
    use crate::flight::heater::HeaterMethod;

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn short_runs_that_return_stand_out_and_steps_and_long_runs_do_not() {
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
        for rate in [1, 20] {
            let mut random = Random::seeded(3);
            let time: Vec<i64> = (0..600 * rate).map(|row| row * SECOND / rate).collect();
            // Noise of 0.05 nT about a field that moves by 2 nT.
            let quiet = [0, 1, 2]
                .map(|_| time.iter().map(|t| 2.0 * (*t as f64 * 1e-11).sin() + 0.05 * random.gaussian()).collect::<Vec<f64>>());
            let interval = HeaterInterval { from_tt2000: 0, to_tt2000: 600 * SECOND };
            assert!(short_runs(&time, &quiet, interval, &options).is_empty());
            let rows = |from_s: f64, to_s: f64| (from_s * rate as f64) as usize..(to_s * rate as f64) as usize;
            let mut field = quiet.clone();
            // One vector; a second; three seconds; a step that stays.
            let one = 100 * rate as usize;
            field[1][one] += 90.0;
            field[0][rows(200.0, 201.0)].iter_mut().for_each(|x| *x -= 5.0);
            field[2][rows(300.0, 303.0)].iter_mut().for_each(|x| *x += 5.0);
            field[0][rows(400.0, 600.0)].iter_mut().for_each(|x| *x += 5.0);
            let wanted: Vec<usize> = std::iter::once(one).chain(rows(200.0, 201.0)).collect();
            assert_eq!(short_runs(&time, &field, interval, &options), wanted, "{rate}");
        }
    }

    #[test]
    fn a_step_is_strange_beyond_fifty_usual_ones_and_twice_all_heaters() {
        let mut steps = vec![Vector3::new(0.1, 0.0, 0.0); 20];
        (steps[5].x, steps[9].x) = (4.9, 5.1);
        let missing = |vectors: &[Vector3<f64>]| {
            let left = without_strange(steps.clone(), vectors);
            (0..20).filter(|&cell| left[cell].x.is_nan()).collect::<Vec<usize>>()
        };
        assert_eq!(missing(&[Vector3::new(1.0, 0.0, 0.0)]), [9]);
        assert_eq!(missing(&[Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.6, 0.0)]), [0_usize; 0]);
    }
}
