use std::f64::consts::TAU;

use super::kernel::contrast_variance;
use super::*;
use crate::fit::linear::{Design, Limits, solve};
use crate::fit::noise::{NoiseParameters, state_space};
use crate::fit::random::Random;

const TIMES: [f64; 12] = [0.0, 1.0, 2.0, 3.5, 4.5, 5.5, 7.0, 8.0, 9.0, 10.5, 12.0, 13.0];
const X: [f64; 12] = [1.0, -1.0, 2.0, 0.0, -2.0, 1.0, 0.0, -1.0, 2.0, -2.0, 1.0, 0.0];
const Y: [[f64; 12]; 2] = [
    [0.3, 0.9, 1.6, 1.1, 0.2, 1.2, 0.4, -0.7, 0.5, -1.6, -0.9, -1.4],
    [1.2, -0.3, 2.5, -0.4, -1.1, 1.9, 0.6, -1.4, 1.8, -2.6, 0.2, 0.5],
];
const WEIGHTS: [f64; 12] = [1.0, 1.0, 0.5, 1.0, 2.0, 1.0, 1.0, 1.0, 0.25, 1.0, 1.0, 1.0];

fn design(columns: DMatrix<f64>) -> Design {
    Design::new((0..columns.ncols()).map(|j| format!("c{j}")).collect(), columns).unwrap()
}

fn example(weights: Option<&[f64]>) -> DenseNoise {
    let columns = DMatrix::from_fn(12, 2, |i, j| [1.0, X[i]][j]);
    let rhs = DMatrix::from_fn(12, 2, |i, a| Y[a][i]);
    let fit = solve(&design(columns), &rhs, weights, &Limits::default()).unwrap();
    estimate(&fit, &TIMES, None).unwrap()
}

fn assert_relative(found: f64, expected: f64, tolerance: f64) {
    assert!((found / expected - 1.0).abs() < tolerance, "{found} is not {expected}");
}

/// Expected values: the restricted likelihood with dense inverses and determinants, its maximum by bounded search and
/// its averages by adaptive quadrature, in numpy and scipy.
#[test]
fn a_dense_calculation_agrees() {
    let model = example(None);
    for (found, expected) in time_constants(&TIMES).unwrap().iter().zip([1.0, 3.605551275463989, 13.0]) {
        assert_relative(*found, expected, 1e-14);
    }
    assert_eq!(model.noise[0].most_likely_share, 0.999);
    assert_relative(model.noise[0].most_likely_std, 0.8789191757143893, 1e-9);
    assert_relative(model.noise[0].share, 0.8719740365697541, 1e-4);
    assert_relative(model.noise[0].std, 0.8660016449102372, 1e-4);
    assert_relative(model.noise[0].independent_rows, 2.668032053010304, 1e-4);
    assert_relative(model.noise[1].most_likely_share, 0.4883151307610789, 1e-6);
    assert_relative(model.noise[1].most_likely_std, 0.6930875705372179, 1e-6);
    assert_relative(model.noise[1].share, 0.6509654101058637, 1e-4);
    assert_relative(model.noise[1].std, 0.7506993418555138, 1e-4);
    assert_relative(model.correlation[(0, 1)], 0.5607100786669085, 1e-12);
    let covariance = model.averaged_covariance();
    let expected = [
        [0.28165235978099956, -0.003994299304120085, 0.1213573810266733, -0.0018238132027509125],
        [-0.003994299304120085, 0.014976164479596528, -0.0018238132027509097, 0.008045640035809173],
        [0.1213573810266733, -0.0018238132027509097, 0.16995235303892156, -0.002809798176326363],
        [-0.0018238132027509125, 0.008045640035809173, -0.002809798176326363, 0.015230173755554452],
    ];
    for (row, expected) in covariance.row_iter().zip(&expected) {
        for (found, expected) in row.iter().zip(expected) {
            assert_relative(*found, *expected, 1e-4);
        }
    }
}

#[test]
fn a_dense_calculation_with_weights_agrees() {
    let model = example(Some(&WEIGHTS));
    assert_relative(model.noise[1].most_likely_std, 0.8994331254195118, 1e-9);
    assert_relative(model.noise[1].share, 0.7312699312352156, 1e-4);
    assert_relative(model.noise[1].std, 0.7872581315628461, 1e-4);
    assert_relative(model.noise[1].independent_rows, 2.977555858896663, 1e-4);
    assert_relative(model.correlation[(0, 1)], 0.5754791460775297, 1e-12);
    let covariance = model.averaged_covariance();
    assert_relative(covariance[(0, 0)], 0.28812135999874905, 1e-4);
    assert_relative(covariance[(0, 2)], 0.13900325172168507, 1e-4);
    assert_relative(covariance[(3, 2)], -0.0022169964597244783, 2e-4);
    assert_relative(covariance[(3, 3)], 0.019432862172151632, 1e-4);
    // The unit of the weights is nobody's business.
    let scaled: Vec<f64> = WEIGHTS.iter().map(|weight| 400.0 * weight).collect();
    let scaled = example(Some(&scaled));
    assert_relative(scaled.noise[1].std, model.noise[1].std, 1e-12);
    assert!((scaled.averaged_covariance() - covariance).amax() < 1e-14);
}

#[test]
fn a_row_of_weight_zero_does_not_exist() {
    let mut weights = [1.0; 12];
    weights[5] = 0.0;
    let rows: Vec<usize> = (0..12).filter(|&i| i != 5).collect();
    let columns = DMatrix::from_fn(11, 2, |i, j| [1.0, X[rows[i]]][j]);
    let rhs = DMatrix::from_fn(11, 2, |i, a| Y[a][rows[i]]);
    let fit = solve(&design(columns), &rhs, None, &Limits::default()).unwrap();
    let times: Vec<f64> = rows.iter().map(|&i| TIMES[i]).collect();
    let without = estimate(&fit, &times, None).unwrap();
    assert!((example(Some(&weights)).averaged_covariance() - without.averaged_covariance()).amax() < 1e-13);
}

fn mean_of(rhs: DMatrix<f64>, times: &[f64]) -> Result<DenseNoise, FitError> {
    let ones = design(DMatrix::from_element(rhs.nrows(), 1, 1.0));
    estimate(&solve(&ones, &rhs, None, &Limits::default()).unwrap(), times, None)
}

#[test]
fn noise_that_alternates_has_no_slow_part() {
    let rhs = DMatrix::from_fn(20, 1, |i, _| 3.0 + [1.0, -1.0][i % 2]);
    let times: Vec<f64> = (0..20).map(f64::from).collect();
    let model = mean_of(rhs, &times).unwrap();
    assert_eq!(model.noise[0].most_likely_share, 0.0);
    // White noise of the sample variance 20 / 19, averaged over 20 rows.
    assert_relative(model.noise[0].most_likely_std.powi(2) / 20.0, 1.0 / 19.0, 1e-12);
    assert!(model.noise[0].share < 0.2, "{}", model.noise[0].share);
}

#[test]
fn a_perfect_fit_has_no_noise() {
    let rhs = DMatrix::from_fn(6, 2, |i, a| [0.0, 1.0, 0.0, -1.0, 1.0, -1.0][i * a]);
    let model = mean_of(rhs, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
    let covariance = model.covariance();
    assert_eq!((model.noise[0].std, covariance[(0, 0)], covariance[(0, 1)]), (0.0, 0.0, 0.0));
    assert!(covariance[(1, 1)] > 0.0);
}

#[test]
fn records_without_information_are_refused() {
    let refused = |rows: usize, times: &[f64]| mean_of(DMatrix::from_fn(rows, 1, |i, _| i as f64), times).unwrap_err();
    assert!(matches!(refused(2, &[1.0, 1.0]), FitError::NoNoise { .. }));
    assert!(matches!(refused(1, &[1.0]), FitError::NoNoise { .. }));
    assert!(matches!(refused(2, &[1.0]), FitError::Length { expected: 2, found: 1, .. }));
    let error = refused(2, &[1.0, f64::INFINITY]);
    assert!(matches!(error, FitError::NotFinite { row: 1, .. }));
    assert!(mean_of(DMatrix::from_row_slice(2, 1, &[1.0, 2.0]), &[0.0, 1.0]).is_ok());
}

impl Random {
    /// Noise of unit variance with a spectrum 1/f from 1/2 down to 1 / (2 π n), flat below: a sum of waves, which has
    /// nothing in common with the kernel of the estimate.
    pub(super) fn flicker(&mut self, n: usize) -> Vec<f64> {
        let waves = 100;
        // Between these frequencies lie `folds` factors e of equal power, below them the power of one more.
        let folds = (0.5 * TAU * n as f64).ln();
        let scale = f64::from(waves).sqrt().recip();
        let mut noise = vec![0.0; n];
        for k in 0..waves {
            let fold = (folds + 1.0) * (f64::from(k) + self.uniform()) / f64::from(waves);
            let step = if fold < folds { 0.5 * TAU * (-fold).exp() } else { (fold - folds) / n as f64 };
            let (sine, cosine) = (self.gaussian() * scale, self.gaussian() * scale);
            for (i, value) in noise.iter_mut().enumerate() {
                let (s, c) = (step * i as f64).sin_cos();
                *value += sine * s + cosine * c;
            }
        }
        noise
    }
}

/// How often 95 % intervals hold the true value: a quickly changing column and the mean with the averaged covariance,
/// and the mean with slow noise ignored.
fn coverage(share: f64) -> [f64; 3] {
    let (n, records) = (50, 200);
    let mut random = Random(88_172_645_463_325_252);
    let columns = DMatrix::from_fn(n, 2, |_, j| [random.uniform() - 0.5, 1.0][j]);
    let design = design(columns);
    let times: Vec<f64> = (0..n).map(|i| i as f64).collect();
    let mut held = [0.0; 3];
    for _ in 0..records {
        let slow = random.flicker(n);
        let mut noise = |i: usize| (1.0 - share).sqrt() * random.gaussian() + share.sqrt() * slow[i];
        let rhs = DMatrix::from_fn(n, 1, |i, _| noise(i));
        let fit = solve(&design, &rhs, None, &Limits::default()).unwrap();
        let std = estimate(&fit, &times, None).unwrap().covariance().diagonal().map(f64::sqrt);
        for (held, (j, std)) in held.iter_mut().zip([(0, std[0]), (1, std[1]), (1, fit.std()[1])]) {
            // Student's t for 48 degrees of freedom.
            *held += f64::from(fit.coefficients[j].abs() <= 2.011 * std);
        }
    }
    held.map(|count| count / f64::from(records))
}

#[test]
fn intervals_hold_the_truth_as_often_as_they_say() {
    // 200 records: a true coverage of 95 % scatters by 1.5 %.
    let [quick, mean, ignored] = coverage(0.0);
    assert!((0.905..0.995).contains(&quick), "{quick}");
    assert!(mean > 0.95, "{mean}");
    assert!((0.905..0.995).contains(&ignored), "{ignored}");
    let [quick, mean, ignored] = coverage(0.5);
    assert!((0.905..0.995).contains(&quick), "{quick}");
    assert!((0.905..0.995).contains(&mean), "{mean}");
    assert!(ignored < 0.7, "{ignored}");
}

/// Four parts of 3 with a gap of 2 after the second.
const PARTS: [[f64; 2]; 4] = [[0.0, 3.0], [3.0, 6.0], [8.0, 11.0], [11.0, 14.0]];

#[test]
fn covariances_of_means_have_their_closed_form() {
    // Whatever the time constant: a sum over fine steps.
    for tau in [0.05, 1.0, 40.0] {
        let kernel = Relaxations::of_means(&PARTS, &[tau], &[1.0]).dense();
        let steps = 1500;
        let at = |part: usize, k: usize| PARTS[part][0] + 3.0 * (k as f64 + 0.5) / f64::from(steps);
        for (a, b) in [(0, 0), (0, 1), (0, 2), (1, 3)] {
            let one = |k: usize| (0..steps as usize).map(|l| (-(at(a, k) - at(b, l)).abs() / tau).exp()).sum::<f64>();
            let sum: f64 = (0..steps as usize).map(one).sum::<f64>() / f64::from(steps * steps);
            assert!((kernel[(a, b)] - sum).abs() < 1e-5, "{tau}: {} is not {sum}", kernel[(a, b)]);
        }
    }
}

#[test]
fn contrasts_and_means_share_one_covariance() {
    let constants = octave_constants(0.1, 100.0);
    let shares = parts(&constants, 1.5);
    let parts = Relaxations::of_means(&PARTS, &constants, &shares).dense();
    let contrast = parts[(0, 0)] + parts[(1, 1)] - 2.0 * parts[(0, 1)];
    assert_relative(contrast_variance(3.0, &constants, &shares), contrast, 1e-12);
    assert_relative(mean_of_variances(&PARTS, &constants, &shares), parts.diagonal().mean(), 1e-12);
    // Two parts make a whole, also across the gap and in any order.
    let whole = Relaxations::of_means(&[[8.0, 14.0], [0.0, 6.0]], &constants, &shares).dense();
    let of_parts =
        |a: [usize; 2], b: [usize; 2]| a.iter().map(|i| b.iter().map(|j| parts[(*i, *j)]).sum::<f64>()).sum::<f64>() / 4.0;
    assert_relative(whole[(1, 1)], of_parts([0, 1], [0, 1]), 1e-12);
    assert_relative(whole[(0, 1)], of_parts([0, 1], [2, 3]), 1e-12);
    // 1/f noise has contrasts of the same variance at every length: 4 ln 2 per octave of the spectrum and unit of ln τ.
    let constants = octave_constants(1e-6, 1e6);
    let step = (constants[1] / constants[0]).ln();
    for length in [0.1, 1.0, 10.0] {
        let variance = contrast_variance(length, &constants, &super::parts(&constants, 1.0)) * constants.len() as f64 * step;
        assert_relative(variance, 4.0 * 2f64.ln(), 1e-2);
    }
}

fn sampled<'a>(intervals: &'a [[f64; 2]], counts: &'a [f64], octaves: &'a [Octave]) -> Sampled<'a> {
    Sampled { intervals, counts, octaves, scatter: None, group: None }
}

/// Noise of samples of about unit variance.
#[derive(Clone, Copy)]
struct Simulated {
    /// Share of 1/f noise.
    share: f64,
    /// Scatter of the rows besides.
    between: f64,
    /// White variance of the samples that grows with the square of the first column.
    growing: f64,
    /// Scatter of the rows in proportion to the first column, which only every fourth row has then.
    source: f64,
}

const QUIET: Simulated = Simulated { share: 0.0, between: 0.0, growing: 0.0, source: 0.0 };

/// Rows that are no means of samples, with a noise of 0.01, of a source that is wrong by a part of its settings, so much at the largest: of ten rows three
/// tell a gain, of 28 nine. The interval of the gain of `n` rows holds so often, and in the mean it is so many times as wide as its errors scatter.
fn coverage_of_settings(n: usize, source: f64) -> [f64; 2] {
    let mut random = Random(88_172_645_463_325_252);
    let set: Vec<f64> = (0..n).map(|i| if i % 3 == 1 { [1.0, -1.0, 0.5, -0.5][i / 3 % 4] } else { 0.0 }).collect();
    let columns = DMatrix::from_fn(n, 2, |i, j| [set[i], 1.0][j]);
    let readings = DMatrix::from_fn(n, 1, |i, _| 1000.0 * set[i]);
    let times: Vec<f64> = (0..n).map(|i| i as f64).collect();
    let (mut held, mut errors, mut stated) = (0.0, 0.0, 0.0);
    let records = if n < 100 { 400 } else { 100 };
    for _ in 0..records {
        let rhs = DMatrix::from_fn(n, 1, |i, _| 0.01 * random.gaussian() + source * set[i] * random.gaussian());
        let fit = solve(&design(columns.clone()), &rhs, None, &Limits::default()).unwrap();
        let std = estimate(&fit, &times, Some(&readings)).unwrap().covariance()[(0, 0)].sqrt();
        held += f64::from(fit.coefficients[0].abs() <= student_95(n - 2) * std) / f64::from(records);
        errors += fit.coefficients[0].powi(2);
        stated += std;
    }
    [held, stated / f64::from(records) / (errors / f64::from(records)).sqrt()]
}

/// 400 intervals of 95 % scatter by 1.1 %, 100 by 2.2 %: three of these less; ten rows cannot always tell that the scatter grows.
#[test]
fn settings_without_samples_that_scatter_in_proportion_are_in_the_uncertainty_of_the_gain() {
    for (n, source, least) in [(10, 0.02, 0.9), (28, 0.02, 0.917), (28, 0.05, 0.917), (28, 1.0, 0.917), (120, 10.0, 0.884)] {
        let [held, _] = coverage_of_settings(n, source);
        assert!(held > least, "{n} {source}: {held}");
    }
    for n in [10, 28] {
        let [held, width] = coverage_of_settings(n, 0.0);
        assert!(held > 0.917 && width < 2.0, "{n}: {held} {width}");
    }
}

/// How often 95 % intervals hold a quickly changing column and the mean of rows of 32 samples with contrasts inside, and the
/// mean standard deviation of both over the true one.
fn coverage_with_contrasts(noise: Simulated) -> [f64; 4] {
    let Simulated { share, between, growing, source } = noise;
    let (n, m, records) = (40, 32, 150);
    let mut random = Random(88_172_645_463_325_252);
    let is_there = |i: usize| source == 0.0 || i.is_multiple_of(4);
    let columns = DMatrix::from_fn(n, 2, |i, j| [(random.uniform() - 0.5) * f64::from(u8::from(is_there(i))), 1.0][j]);
    let readings = columns.columns(0, 1).map(|x| 1000.0 * x);
    let design = design(columns.clone());
    let intervals: Vec<[f64; 2]> = (0..n).map(|i| [(m * i) as f64, (m * i + m) as f64]).collect();
    let (mut held, mut errors, mut stated) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    for _ in 0..records {
        let slow = if share > 0.0 { random.flicker(n * m) } else { vec![0.0; n * m] };
        let white = |i: usize| (1.0 - share + growing * columns[(i / m, 0)].powi(2)).sqrt();
        let scatter: Vec<f64> = (0..n).map(|i| between.hypot(source * columns[(i, 0)]) * random.gaussian()).collect();
        let value = |(i, s): (usize, &f64)| white(i) * random.gaussian() + share.sqrt() * s + scatter[i / m];
        let samples: Vec<f64> = slow.iter().enumerate().map(value).collect();
        let variances = DMatrix::from_fn(n, 1, |i, _| {
            let mean = samples[m * i..m * (i + 1)].iter().sum::<f64>() / m as f64;
            samples[m * i..m * (i + 1)].iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (m - 1) as f64
        });
        let mean = |from: usize, length: usize| samples[from..from + length].iter().sum::<f64>() / length as f64;
        let rhs = DMatrix::from_fn(n, 1, |i, _| mean(m * i, m));
        let octaves: Vec<Octave> = [4, 8, 16]
            .into_iter()
            .map(|length| {
                let starts = (0..n * m).step_by(2 * length);
                let squares = starts.map(|k| (mean(k, length) - mean(k + length, length)).powi(2)).sum();
                let count = (n * m / (2 * length)) as f64;
                Octave { length: length as f64, count, white: 2.0 / length as f64, squares: vec![squares] }
            })
            .collect();
        let fit = solve(&design, &rhs, None, &Limits::default()).unwrap();
        let scatter = Some([&variances, &readings]);
        let counts = vec![m as f64; n];
        let model = estimate_with(&fit, &Sampled { scatter, ..sampled(&intervals, &counts, &octaves) }).unwrap();
        let std = model.covariance().diagonal().map(f64::sqrt);
        for j in 0..2 {
            held[j] += f64::from(fit.coefficients[j].abs() <= NORMAL_95 * std[j]) / f64::from(records);
            errors[j] += fit.coefficients[j].powi(2) / f64::from(records);
            stated[j] += std[j] / f64::from(records);
        }
    }
    [held[0], held[1], stated[0] / errors[0].sqrt(), stated[1] / errors[1].sqrt()]
}

#[test]
fn contrasts_inside_the_rows_tell_slow_noise_from_white() {
    for share in [0.3, 0.9] {
        let [quick, mean, quick_ratio, mean_ratio] = coverage_with_contrasts(Simulated { share, ..QUIET });
        // 150 records: a true coverage of 95 % scatters by 1.8 %.
        assert!((0.895..0.995).contains(&quick), "{share}: {quick}");
        assert!((0.895..1.0).contains(&mean), "{share}: {mean}");
        assert!((0.8..1.25).contains(&quick_ratio) && (0.8..1.25).contains(&mean_ratio), "{quick_ratio} {mean_ratio}");
    }
    let [quick, mean, quick_ratio, _] = coverage_with_contrasts(QUIET);
    assert!((0.895..0.995).contains(&quick) && mean > 0.9, "{quick} {mean}");
    assert!((0.85..1.2).contains(&quick_ratio), "{quick_ratio}");
}

#[test]
fn scatter_between_the_rows_is_white_beside_slow_noise_inside_them() {
    // Three times the white noise of a row, and 1/f noise as large.
    let [quick, _, quick_ratio, _] = coverage_with_contrasts(Simulated { share: 0.3, between: 0.45, ..QUIET });
    assert!((0.895..0.995).contains(&quick), "{quick}");
    assert!((0.85..1.2).contains(&quick_ratio), "{quick_ratio}");
}

#[test]
fn noise_that_grows_with_the_reading_counts_where_it_is() {
    // Taken as equal in all rows it would leave two thirds of the uncertainty.
    let [quick, mean, quick_ratio, mean_ratio] = coverage_with_contrasts(Simulated { growing: 100.0, ..QUIET });
    assert!((0.895..0.995).contains(&quick) && mean > 0.895, "{quick} {mean}");
    assert!((0.85..1.2).contains(&quick_ratio) && mean_ratio > 0.85, "{quick_ratio} {mean_ratio}");
}

/// A source whose settings are wrong by a part of themselves: at the largest of ten settings on an axis by 1.8 times the noise of a mean. Ten rows cannot
/// always tell, so that 150 records are allowed 4 % less than 95 %, and 1.8 % for chance.
#[test]
fn scatter_in_proportion_to_few_settings_is_in_the_uncertainty_of_the_gain() {
    let [gain, mean, ..] = coverage_with_contrasts(Simulated { source: 0.64, ..QUIET });
    assert!(gain > 0.89 && mean > 0.9, "{gain} {mean}");
}

#[test]
fn rows_that_scatter_more_than_their_samples_are_believed() {
    // Rows alternate by 1, their samples by a hundredth.
    let rhs = DMatrix::from_fn(20, 1, |i, _| [1.0, -1.0][i % 2]);
    let fit = solve(&design(DMatrix::from_element(20, 1, 1.0)), &rhs, None, &Limits::default()).unwrap();
    let intervals: Vec<[f64; 2]> = (0..20).map(|i| [f64::from(i), f64::from(i) + 1.0]).collect();
    let octave = |squares: f64| Octave { length: 0.5, count: 20.0, white: 0.5, squares: vec![squares] };
    let with = estimate_with(&fit, &sampled(&intervals, &[8.0; 20], &[octave(20.0 * 1e-4)])).unwrap();
    // Twenty rows tell their scatter with nineteen degrees of freedom: Student's interval in terms of the normal one.
    let widening = crate::fit::student_95(19) / NORMAL_95;
    assert_relative(with.covariance()[(0, 0)], widening.powi(2) / 19.0, 0.03);
    // Samples without scatter leave the noise to the residuals.
    let without = estimate_with(&fit, &sampled(&intervals, &[8.0; 20], &[octave(0.0)])).unwrap();
    let middles: Vec<f64> = intervals.iter().map(|i| i[0] + 0.5).collect();
    assert_eq!(without.noise, estimate(&fit, &middles, None).unwrap().noise);
}

/// The interface speaks of the covariance that the module states, with weights and without.
#[test]
fn the_covariance_of_rows_is_that_of_the_module() {
    for weights in [None, Some(WEIGHTS.as_slice())] {
        let model = example(weights);
        let mean_weight = weights.map_or(1.0, |w| w.iter().sum::<f64>() / 12.0);
        let ComponentNoise { std, share, .. } = model.noise[1];
        let covariance = model.covariance_of_rows(1, &[2, 7]);
        let constants = time_constants(&TIMES).unwrap();
        let slow = |lag: f64| constants.iter().map(|tau| (-lag / tau).exp()).sum::<f64>() / 3.0;
        let white = |i: usize| weights.map_or(1.0, |w| mean_weight / w[i]);
        assert_relative(covariance[(0, 0)], std * std * ((1.0 - share) * white(2) + share), 1e-12);
        assert_relative(covariance[(0, 1)], std * std * share * slow(6.0), 1e-12);
        // What is whitened has the identity as its covariance, and the likelihood is that of a normal distribution.
        let all = model.covariance_of_rows(1, &(0..12).collect::<Vec<_>>());
        let mut columns = DMatrix::from_fn(12, 2, |i, j| if j == 0 { X[i] } else { 1.0 });
        let raw = columns.clone();
        model.whiten(1, &mut columns);
        let inverse = all.clone().try_inverse().unwrap();
        assert!((columns.tr_mul(&columns) - raw.tr_mul(&(&inverse * &raw))).amax() < 1e-10);
        let normal = -0.5 * ((raw.column(0).transpose() * &inverse * raw.column(0))[0] + (TAU * all).determinant().ln());
        assert_relative(model.log_likelihood(1, &X), normal, 1e-10);
    }
}

/// Coefficients are estimates that are linear in the rows: `(XᵀWX)⁻¹ XᵀW`.
#[test]
fn the_covariance_of_estimates_is_that_of_the_coefficients() {
    for weights in [None, Some(WEIGHTS.as_slice())] {
        let model = example(weights);
        let columns = DMatrix::from_fn(12, 2, |i, j| [1.0, X[i]][j]);
        let weighted = DMatrix::from_fn(12, 2, |i, j| columns[(i, j)] * weights.map_or(1.0, |w| w[i]));
        let estimates = weighted.tr_mul(&columns).try_inverse().unwrap() * weighted.transpose();
        let influence: Vec<DMatrix<f64>> =
            (0..2).map(|a| DMatrix::from_fn(4, 12, |i, row| if i / 2 == a { estimates[(i % 2, row)] } else { 0.0 })).collect();
        let (found, expected) = (model.covariance_of(&influence), model.covariance());
        for (found, expected) in found.iter().zip(expected.iter()) {
            assert_relative(*found, *expected, 1e-10);
        }
        // The sum of two estimates from two right-hand sides has the variance that their covariance lets expect, where they are widened alike.
        let sum: Vec<DMatrix<f64>> = (0..2).map(|_| estimates.rows(1, 1).into_owned()).collect();
        let expected = expected[(1, 1)] + 2.0 * expected[(1, 3)] + expected[(3, 3)];
        assert_relative(model.covariance_of(&sum)[(0, 0)], expected, 0.05);
    }
}

/// Rows with gaps, in an order of their own, and a design of three columns.
fn scattered_rows(n: usize) -> (Vec<[f64; 2]>, Solution) {
    let mut random = Random(7_046_029_254_386_353_131);
    let begin = |i: usize| 3.0 * i as f64 + if i > n / 2 { 500.0 } else { 0.0 };
    let mut intervals: Vec<[f64; 2]> = (0..n).map(|i| [begin(i), begin(i) + 1.5 + random.uniform()]).collect();
    for i in (1..n).rev() {
        intervals.swap(i, (random.uniform() * i as f64) as usize);
    }
    let columns = DMatrix::from_fn(n, 3, |i, j| if j == 0 { 1.0 } else { random.gaussian() * (i % 7) as f64 });
    let rhs = DMatrix::from_fn(n, 2, |i, a| random.gaussian() + a as f64 * (intervals[i][0] / 200.0).sin());
    (intervals, solve(&design(columns), &rhs, None, &Limits::default()).unwrap())
}

#[test]
fn states_carried_from_row_to_row_are_the_matrix() {
    let n = 60;
    let (intervals, _) = scattered_rows(n);
    let constants = octave_constants(0.2, 700.0);
    let shares = parts(&constants, 1.0);
    let slow = Relaxations::of_means(&intervals, &constants, &shares).scaled(|row| 1.0 + row as f64 / 40.0);
    let dense = slow.dense();
    let columns = DMatrix::from_fn(n, 3, |i, j| (i as f64 * (0.3 + j as f64)).cos());
    assert!((slow.times(&columns) - &dense * &columns).amax() < 1e-9);
    for (white, share) in [(1.0, 0.0), (0.7, 0.3), (1e-3, 1.0)] {
        let all = DMatrix::identity(n, n) * white + &dense * share;
        let (white_columns, log_determinant) = slow.whiten(white, share, &columns).unwrap();
        let expected = columns.tr_mul(&all.clone().cholesky().unwrap().solve(&columns));
        assert!((white_columns.tr_mul(&white_columns) - &expected).amax() < 1e-8 * expected.amax());
        let expected = 2.0 * all.cholesky().unwrap().l().diagonal().map(f64::ln).sum();
        assert!((log_determinant - expected).abs() < 1e-8, "{log_determinant} is not {expected}");
    }
}

/// Both forms of the likelihood are the same function, so that the number of rows decides about nothing but the time.
#[test]
fn many_rows_have_the_likelihood_of_few() {
    let (intervals, solution) = scattered_rows(150);
    let constants = octave_constants(0.2, 1200.0);
    let slow = Relaxations::of_means(&intervals, &constants, &parts(&constants, 1.5));
    let fitted = Fitted::of(&solution);
    let [few, many] = [true, false].map(|few| Projected::with(&fitted, &fitted.by_weights, &slow, few));
    assert_eq!(few.log_scale, many.log_scale);
    for a in 0..2 {
        let (few, many) = (few.likelihood(a), many.likelihood(a));
        for ratio in [0.0, 1e-4, 0.03, 0.77, 1.0, 5.1, 300.0, 2e4] {
            let (found, expected) = (many.absolute(0.3, 0.3 * ratio), few.absolute(0.3, 0.3 * ratio));
            assert!((found - expected).abs() < 1e-3, "{a} {ratio}: {found} is not {expected}");
        }
        let (found, expected) = (many.estimate().noise, few.estimate().noise);
        assert_relative(found.std, expected.std, 1e-4);
        assert_relative(1.0 - found.share, 1.0 - expected.share, 1e-3);
        assert_relative(found.most_likely_std, expected.most_likely_std, 1e-4);
    }
}

/// The dense form and the one of a filter have the same parameters and give the same restricted likelihood for the same rows, but for what no
/// parameter changes. Few rows and many, white noise of differing rows, noise that grows with the field, slow noise of any exponent, of the
/// readings or of the gain.
#[test]
fn both_forms_have_the_same_likelihood_for_the_same_data() {
    const ROWS: usize = 50;
    let mut random = Random::seeded(5);
    let t_s: Vec<f64> = (0..ROWS).map(|i| 10.0 * i as f64 + 4.0 * random.uniform()).collect();
    let field: Vec<f64> = (0..ROWS).map(|i| ((i * 7) % 11) as f64 / 5.0 - 1.0).collect();
    let white: Vec<f64> = (0..ROWS).map(|i| 1.0 + 0.3 * (i % 4) as f64).collect();
    let columns = DMatrix::from_fn(ROWS, 2, |i, j| if j == 0 { 1.0 } else { field[i] });
    let readings = DMatrix::from_fn(ROWS, 3, |i, _| random.gaussian() + (t_s[i] / 60.0).sin());
    let rows = state_space::Rows {
        t_s: t_s.clone(),
        white: white.iter().map(|w| [*w; 3]).collect(),
        field: field.iter().map(|u| [*u; 3]).collect(),
        inside: None,
    };
    let correlations = state_space::Correlations::new(rows);
    let designs = [0; 3].map(|_| columns.clone());
    let of_filter = |p: &NoiseParameters| correlations.restricted(p, &readings, &designs);
    let fitted = Fitted::of(&solve(&design(columns.clone()), &readings, None, &Limits::default()).unwrap());
    let of_dense = |p: &NoiseParameters, few: bool| -> f64 {
        let (tau_s, variance) = correlations.relaxations(p);
        let spread = DVector::from_fn(ROWS, |i, _| white[i] * p.white_at(field[i]));
        // Slow noise of the readings and of the gain are two sums of relaxations; the dense form takes one of them at a time.
        let slow = Relaxations::at(&t_s, tau_s, variance);
        let slow = if p.slow_field > 0.0 { slow.scaled(|row| field[row]) } else { slow };
        let projected = Projected::with(&fitted, &spread, &slow, few);
        let freedom = (ROWS - 2) as f64;
        let of = |a: usize| {
            let at = |variance: f64| projected.likelihood(a).absolute(variance, variance * p.all_slow());
            // Minus twice the log likelihood is a logarithm and squares over the variance: two variances tell the squares, and one of them has the
            // largest likelihood.
            let squares = 2.0 * (at(1.0) - at(2.0) + freedom * 2f64.ln());
            at(squares / freedom) + projected.log_scale
        };
        -0.5 * (0..3).map(of).sum::<f64>()
    };
    let one = NoiseParameters::WHITE;
    let all = [
        NoiseParameters { white_field: 3.0, ..one },
        NoiseParameters { slow: 0.3, exponent: 0.5, ..one },
        NoiseParameters { slow: 2.0, ..one },
        NoiseParameters { slow: 30.0, exponent: 1.5, white_field: 1.0, ..one },
        NoiseParameters { slow: 3.0, exponent: 2.0, ..one },
        NoiseParameters { slow_field: 1.0, exponent: 0.75, ..one },
        NoiseParameters { slow_field: 10.0, white_field: 0.5, ..one },
        NoiseParameters { slow: 1.0, exponent: 2.0, memory_rows: 4.0, ..one },
    ];
    for few in [true, false] {
        for p in &all {
            let [found, expected] = [of_dense(p, few) - of_dense(&one, few), of_filter(p) - of_filter(&one)];
            // The form of many rows interpolates.
            let allowed = if few { 1e-8 } else { 3e-3 };
            assert!((found - expected).abs() < allowed, "{p:?}: {found} is not {expected}");
        }
    }
}

/// Rows of 4 and of 64 samples of unit variance: a column that only the short rows have is known to `1 / (2 √(Σ x²))`, one of the long ones to a
/// quarter of that; where every row scatters alike, whatever its samples do, both are known alike.
#[test]
fn rows_of_few_samples_are_noisier_unless_all_scatter_alike() {
    let n = 40;
    let counts: Vec<f64> = (0..n).map(|i| [4.0, 64.0][i % 2]).collect();
    let intervals: Vec<[f64; 2]> = (0..n).map(|i| [i as f64, i as f64 + 0.9]).collect();
    let sign = |i: usize| if (i / 2).is_multiple_of(2) { 1.0 } else { -1.0 };
    let columns = DMatrix::from_fn(n, 3, |i, j| {
        if j == 2 {
            1.0
        } else if i % 2 == j {
            sign(i)
        } else {
            0.0
        }
    });
    let mut random = Random(362_436_069);
    let octaves = [Octave { length: 0.1, count: 1000.0, white: 0.5, squares: vec![500.0] }];
    let mut ratio = |alike: f64| {
        let ratios: Vec<f64> = (0..100)
            .map(|_| {
                let rhs = DMatrix::from_fn(n, 1, |i, _| random.gaussian() * counts[i].sqrt().recip().hypot(alike));
                let fit = solve(&design(columns.clone()), &rhs, None, &Limits::default()).unwrap();
                let std =
                    estimate_with(&fit, &sampled(&intervals, &counts, &octaves)).unwrap().covariance().diagonal().map(f64::sqrt);
                std[0] / std[1]
            })
            .collect();
        ratios.iter().sum::<f64>() / 100.0
    };
    let (by_samples, alike) = (ratio(0.0), ratio(5.0));
    assert!((by_samples / 4.0 - 1.0).abs() < 0.1, "{by_samples}");
    assert!((alike - 1.0).abs() < 0.1, "{alike}");
}

/// Every fifth row has samples that scatter ten times as much: a column of these 8 rows is known to 10/√8, one of the 32 others to 1/√32.
#[test]
fn rows_whose_samples_scatter_more_are_noisier() {
    let n = 40;
    let variance = |i: usize| if i.is_multiple_of(5) { 100.0 } else { 1.0 };
    let counts = vec![16.0; n];
    let intervals: Vec<[f64; 2]> = (0..n).map(|i| [i as f64, i as f64 + 0.9]).collect();
    let columns = DMatrix::from_fn(n, 3, |i, j| match j {
        2 => 1.0,
        _ if i.is_multiple_of(5) == (j == 0) => [1.0, -1.0][i % 2],
        _ => 0.0,
    });
    // A fifth of the samples has the variance 100, the others 1.
    let octaves = [Octave { length: 0.1, count: 1000.0, white: 0.5, squares: vec![500.0 * 20.8] }];
    let (variances, readings) = (DMatrix::from_fn(n, 1, |i, _| variance(i)), DMatrix::from_element(n, 1, 1.0));
    let mut random = Random(362_436_069);
    let ratios = (0..50).map(|_| {
        let rhs = DMatrix::from_fn(n, 1, |i, _| random.gaussian() * f64::sqrt(variance(i) / counts[i]));
        let fit = solve(&design(columns.clone()), &rhs, None, &Limits::default()).unwrap();
        let scatter = Some([&variances, &readings]);
        let noise = estimate_with(&fit, &Sampled { scatter, ..sampled(&intervals, &counts, &octaves) }).unwrap();
        let std = noise.covariance().diagonal().map(f64::sqrt);
        std[0] / std[1]
    });
    let ratio = ratios.sum::<f64>() / 50.0;
    assert!((ratio / 20.0 - 1.0).abs() < 0.1, "{ratio}");
}
