use super::*;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

fn rows() -> Rows {
    let t_s: Vec<f64> = (0..40).map(|i| 10.0 * f64::from(i) + 3.0 * f64::from(i * i % 7)).collect();
    let white = (0..40).map(|i| [1.0, 1.2, 0.8].map(|w| w + 0.1 * f64::from(i % 5))).collect();
    let field = (0..40).map(|i| [0, 1, 2].map(|a| f64::from((i * (3 + a)) % 11 - 5) / 5.0)).collect();
    Rows { t_s, white, field, inside: None }
}

/// The filter is the inverse of the covariance that the module states, whatever the shares.
#[test]
fn whitening_is_that_of_the_dense_covariance() {
    let noises = Correlations::new(rows());
    let columns = DMatrix::from_fn(40, 3, |i, j| ((i * (j + 2)) as f64 * 0.37).sin());
    let designs = [0; 3].map(|_| DMatrix::from_element(40, 1, 1.0));
    let one = NoiseParameters { slow: 2.0, white_field: 3.0, slow_field: 0.7, ..NoiseParameters::WHITE };
    let all = (0..SHAPES)
        .map(|s| one.with_shape(s))
        .chain([NoiseParameters::WHITE, NoiseParameters { white_field: 2.0, ..NoiseParameters::WHITE }]);
    for parameters in all {
        let noise = noises.with_parameters(parameters, &columns, &designs).unwrap();
        for component in 0..3 {
            let mut white = columns.clone();
            noise.whiten(component, &mut white);
            let covariance = noise.covariance_of_rows(component, &(0..40).collect::<Vec<_>>());
            let cholesky = covariance.cholesky().unwrap();
            let expected = columns.tr_mul(&cholesky.solve(&columns));
            let difference = (white.tr_mul(&white) - &expected).amax();
            assert!(difference < 1e-10 * expected.amax(), "{parameters:?}: {difference}");
            let log_determinant = 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
            let of_filter = noise.log_determinant(component);
            assert!((of_filter - log_determinant).abs() < 1e-8, "{parameters:?}");
        }
    }
}

/// Rows in the middle by themselves, more columns than go through the filter together.
#[test]
fn a_stretch_is_whitened_by_its_own_covariance() {
    let noises = Correlations::new(rows());
    let columns = DMatrix::from_fn(40, 11, |i, j| ((i * (j + 2)) as f64 * 0.37).sin());
    let parameters = NoiseParameters { slow: 2.0, white_field: 3.0, slow_field: 0.7, ..NoiseParameters::WHITE };
    let readings = columns.columns(0, 3).into_owned();
    let noise = noises.with_parameters(parameters, &readings, &[0; 3].map(|_| DMatrix::from_element(40, 1, 1.0))).unwrap();
    let part = columns.rows(13, 17).into_owned();
    for component in 0..3 {
        let stretch = noise.of_stretch(component, 13..30).unwrap();
        let white = stretch.whitened(&part);
        let cholesky = noise.covariance_of_rows(component, &(13..30).collect::<Vec<_>>()).cholesky().unwrap();
        let expected = cholesky.l().solve_lower_triangular(&part).unwrap();
        assert!((white - &expected).amax() < 1e-10 * expected.amax());
        let fresh: Vec<f64> = stretch.fresh_std().collect();
        assert!(fresh.iter().zip(cholesky.l_dirty().diagonal().iter()).all(|(a, b)| (a / b - 1.0).abs() < 1e-10));
    }
}

/// A sum of relaxations with weights `τ^(a-1)` has a power density of about `f^-a` between the inverse time constants at its ends.
#[test]
fn relaxations_make_a_power_density() {
    let noises = Correlations::new(Rows {
        t_s: (0..3000).map(f64::from).collect(),
        white: vec![[1.0; 3]; 3000],
        field: vec![[0.0; 3]; 3000],
        inside: None,
    });
    // What the ends cut off at a thousandth and a hundredth is below (0.4/16)^0.75 and (160/7900)^0.5 of it for these exponents.
    for (a, slow) in EXPONENTS.iter().zip(&noises.0.slow).filter(|(a, _)| (0.75..=1.5).contains(*a)) {
        let density = |f: f64| {
            let terms = slow.tau_s.iter().zip(&slow.variance);
            terms.map(|(tau, v)| v * tau / (1.0 + (std::f64::consts::TAU * f * tau).powi(2))).sum::<f64>()
        };
        let slope = (density(1e-3) / density(1e-2)).log10();
        assert!((slope - a).abs() < 0.06, "{a}: {slope}");
    }
}

/// Readings of unit noise and their design, a mean and the field, with a factor on the noise.
fn noise_of(seed: u64, factor: f64) -> (Rows, DMatrix<f64>, [DMatrix<f64>; 3]) {
    let rows = Rows { white: vec![[1.0; 3]; 40], inside: Some(Inside { variance: [1.0; 3], freedom: 160.0 }), ..rows() };
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let readings = DMatrix::from_fn(40, 3, |_, _| -> f64 { StandardNormal.sample(&mut random) }) * factor;
    let designs = [0, 1, 2].map(|a| DMatrix::from_fn(40, 2, |i, j| if j == 0 { 1.0 } else { rows.field[i][a] }));
    (rows, readings, designs)
}

/// Beside 160 differences inside them, 38 free rows hardly move the white noise: its standard deviation is known to
/// `1/sqrt(2 (160 + 38))`, 5 %, of which four are allowed. Rows that scatter three times as much are believed instead: whitened
/// they scatter by one, not by nine, give or take `sqrt(2/38)`.
#[test]
fn white_noise_is_that_inside_the_rows_unless_they_scatter_apart() {
    for seed in 0..8 {
        let (rows, readings, designs) = noise_of(seed, 1.0);
        let noise = Correlations::new(rows).estimate(&readings, &designs).unwrap();
        assert!(!noise.parameters.apart, "{seed}: {:?}", noise.parameters);
        assert!(noise.inside.iter().all(|[_, count]| *count == 160.0));
        assert!(noise.white_std.iter().all(|s| (s - 1.0).abs() < 4.0 * 0.05), "{seed}: {:?}", noise.white_std);

        let (rows, readings, designs) = noise_of(seed, 3.0);
        let noise = Correlations::new(rows).estimate(&readings, &designs).unwrap();
        for (a, design) in designs.iter().enumerate() {
            let (mut white, mut reading) = (design.clone(), readings.columns(a, 1).into_owned());
            noise.whiten(a, &mut white);
            noise.whiten(a, &mut reading);
            let base = white.qr().q();
            let left = (&reading - &base * base.tr_mul(&reading)).norm_squared() / 38.0;
            assert!(left < 1.0 + 4.0 * 0.23, "{seed}, {a}: {left}");
        }
    }
}

/// What is not in the model may look like noise that grows with the field: white noise of the samples' size stays one of the
/// possibilities, and the probabilities are those of alternatives.
#[test]
fn noise_that_grows_is_one_possibility_among_others() {
    let (rows, mut readings, designs) = noise_of(3, 1.0);
    for i in 0..40 {
        readings[(i, 1)] += 4.0 * rows.field[i][1].powi(2);
    }
    let noises = Correlations::new(rows);
    let found = NoiseParameters { white_field: 3.0, ..NoiseParameters::WHITE };
    let plausible = noises.plausible(&found, &readings, &designs);
    let total: f64 = plausible.iter().map(|(_, p)| p.exp()).sum();
    assert!((total - 1.0).abs() < 1e-9, "{total}");
    let last = plausible.last().unwrap();
    assert_eq!(last.0.parameters, NoiseParameters::WHITE);
    let with = |growth: f64| plausible.iter().filter(|(n, _)| n.parameters.white_field == growth).count();
    assert!(with(0.0) > 0 && with(3.0) == with(0.0));
}

/// Of many rows most noises are ruled out by a part of them: every one of these has less than e^-15 of the probability of the best one.
#[test]
fn noises_that_a_part_of_many_rows_rules_out_have_no_probability() {
    let count = 1300;
    let rows = Rows {
        t_s: (0..count).map(|i| 7.0 * f64::from(i)).collect(),
        white: vec![[1.0; 3]; count as usize],
        field: (0..count).map(|i| [0, 1, 2].map(|a| f64::from((i * (3 + a)) % 11 - 5) / 5.0)).collect(),
        inside: None,
    };
    let designs = [0, 1, 2].map(|a| DMatrix::from_fn(rows.t_s.len(), 2, |i, j| if j == 0 { 1.0 } else { rows.field[i][a] }));
    let noises = Correlations::new(rows);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    for gain in [0.0, 0.5] {
        // Noise that forgets after eight rows, of the offset or of the gain.
        let mut slow = [0.0; 3];
        let readings = DMatrix::from_fn(3, count as usize, |a, i| {
            let [white, new]: [f64; 2] = [0; 2].map(|_| StandardNormal.sample(&mut random));
            slow[a] = (-0.125_f64).exp() * slow[a] + (1.0 - (-0.25_f64).exp()).sqrt() * new;
            white + slow[a] * if gain > 0.0 { 2.0 * noises.0.rows.field[i][a] } else { 1.0 }
        })
        .transpose();
        let data = Data { readings: &readings, designs: &designs };
        let all = noises.around(&NoiseParameters { slow_field: gain, slow: 1.0, ..NoiseParameters::WHITE });
        let kept = noises.hopeful(all.clone(), &data);
        assert!(2 * kept.len() < all.len(), "{} of {}", kept.len(), all.len());
        assert_eq!(kept.last(), all.last());
        let of =
            |(c, prior): &(NoiseParameters, f64)| noises.likelihood(c, &data).map_or(f64::NEG_INFINITY, |(l, _)| l + prior.ln());
        let best = all.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
        for one in all.iter().filter(|one| !kept.contains(one)) {
            assert!(of(one) < best - 15.0, "{:?}: {}", one.0, of(one) - best);
        }
    }
}
