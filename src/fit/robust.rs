//! Huber's estimator: rows which do not belong lose their weight, none is thrown away.

use nalgebra::DMatrix;

use super::FitError;
use super::linear::{Design, Limits, Solution, solve};
use super::statistics::central_median;

/// Distance, in standard deviations, at which a row starts to lose weight: 95 % efficiency for Gaussian noise.
const TUNING: f64 = 1.345;
/// Median of the magnitude of a standard Gaussian.
const MEDIAN_MAGNITUDE: f64 = 0.674_489_750_196_081_7;
/// Iterations in which the scale is estimated again. With a fixed scale the iteration always converges.
const SCALE_ITERATIONS: usize = 50;
/// Iterations altogether.
const MAX_ITERATIONS: usize = 500;
/// Largest change of a weight that ends the iteration.
const SETTLED: f64 = 1e-8;

/// A robust fit.
#[derive(Clone, Debug)]
pub struct Robust {
    /// The weighted fit at the final weights, with the residuals of the data.
    pub solution: Solution,
    /// The plain fit of the pseudo-values: the data with the weight of a row taken from its residual instead. It has the
    /// same coefficients, and its standard deviations, or those of [`dense::estimate`](super::noise::dense::estimate)
    /// on it, are the right ones for them with and without slow noise.
    pub pseudo: Solution,
    /// Given weights times Huber weights, one per row.
    pub weights: Vec<f64>,
    /// Rows whose Huber weight is below one.
    pub downweighted: usize,
    /// Robust standard deviation of a row of unit weight, per right-hand side.
    pub scales: Vec<f64>,
    /// Per right-hand side the factor from the variances of `solution` to the right ones for independent noise, as `pseudo`
    /// has them: choosing weights by the residuals is not free, and outliers weigh less than their squares. One where no
    /// row lost weight.
    pub covariance_factor: Vec<f64>,
}

/// Fits all right-hand sides (n x m) with one Huber weight per row.
///
/// Right-hand sides share the weight because what disturbs a row disturbs the measurement as a whole, and because a common
/// weight keeps one design, hence one covariance, for all of them. The distance of a row is the root mean square over
/// right-hand sides of its residuals divided by their scale, the scale the median magnitude of the residuals over 0.6745,
/// the weight `min(1, 1.345 / distance)`. A row which stands alone at the end of a column (high leverage) is not protected
/// against.
///
/// # Errors
///
/// Those of [`solve`], and [`FitError::NotSettled`].
pub fn fit(design: &Design, rhs: &DMatrix<f64>, weights: Option<&[f64]>, limits: &Limits) -> Result<Robust, FitError> {
    let mut solution = solve(design, rhs, weights, limits)?;
    let given = weights.map_or_else(|| vec![1.0; rhs.nrows()], <[f64]>::to_vec);
    let counted = solution.kept.clone();
    // Rounding of the data must not pass for noise.
    let floors: Vec<f64> = rhs.column_iter().map(|column| column.amax() * f64::EPSILON).collect();
    let mut huber = vec![1.0; rhs.nrows()];
    let mut scales = Vec::new();
    for iteration in 0..MAX_ITERATIONS {
        let standard =
            DMatrix::from_fn(counted.len(), rhs.ncols(), |i, a| solution.residuals[(counted[i], a)] * given[counted[i]].sqrt());
        if iteration < SCALE_ITERATIONS {
            scales = standard.column_iter().zip(&floors).map(|(column, floor)| scale(column.iter()).max(*floor)).collect();
        }
        let standard = DMatrix::from_fn(standard.nrows(), standard.ncols(), |i, a| {
            if scales[a] > 0.0 { standard[(i, a)] / scales[a] } else { 0.0 }
        });
        let mut change: f64 = 0.0;
        for (i, row) in standard.row_iter().enumerate() {
            let weight = weight(distance(row.iter()));
            change = change.max((weight - huber[counted[i]]).abs());
            huber[counted[i]] = weight;
        }
        if change <= SETTLED {
            return finish(design, rhs, Settled { solution, given, huber, standard, scales }, limits);
        }
        let combined: Vec<f64> = given.iter().zip(&huber).map(|(given, huber)| given * huber).collect();
        solution = solve(design, rhs, Some(&combined), limits)?;
    }
    Err(FitError::NotSettled { what: "robust weights", iterations: MAX_ITERATIONS })
}

/// Standard deviation from the median magnitude.
fn scale<'a>(residuals: impl Iterator<Item = &'a f64>) -> f64 {
    let mut magnitudes: Vec<f64> = residuals.map(|residual| residual.abs()).collect();
    if magnitudes.is_empty() { 0.0 } else { central_median(&mut magnitudes) / MEDIAN_MAGNITUDE }
}

/// Root mean square over right-hand sides.
fn distance<'a>(standard: impl ExactSizeIterator<Item = &'a f64>) -> f64 {
    let count = standard.len().max(1) as f64;
    (standard.map(|z| z * z).sum::<f64>() / count).sqrt()
}

/// Huber's weight.
fn weight(distance: f64) -> f64 {
    if distance > TUNING { TUNING / distance } else { 1.0 }
}

/// Where the iteration came to rest.
struct Settled {
    solution: Solution,
    given: Vec<f64>,
    huber: Vec<f64>,
    /// Residuals of the counted rows over their scales.
    standard: DMatrix<f64>,
    scales: Vec<f64>,
}

/// Adds what follows from the final weights.
fn finish(design: &Design, rhs: &DMatrix<f64>, settled: Settled, limits: &Limits) -> Result<Robust, FitError> {
    let Settled { solution, given, huber, standard, scales } = settled;
    let stretch = stretch(&standard, design.names().len());
    let values = DMatrix::from_fn(rhs.nrows(), rhs.ncols(), |i, a| {
        rhs[(i, a)] + solution.residuals[(i, a)] * (huber[i] * stretch[a] - 1.0)
    });
    let pseudo = solve(design, &values, Some(&given), limits)?;
    let mean_weight = solution.kept.iter().map(|&i| huber[i]).sum::<f64>() / solution.kept.len() as f64;
    let covariance_factor = pseudo
        .residual_std
        .iter()
        .zip(&solution.residual_std)
        .map(|(pseudo, weighted)| if *weighted > 0.0 { mean_weight * (pseudo / weighted).powi(2) } else { 1.0 })
        .collect();
    Ok(Robust {
        downweighted: huber.iter().filter(|weight| **weight < 1.0).count(),
        weights: given.iter().zip(&huber).map(|(given, huber)| given * huber).collect(),
        scales,
        covariance_factor,
        pseudo,
        solution,
    })
}

/// Per right-hand side `κ / mean(ψ')`: `ψ'` is the derivative of the weighted residual by the residual, so that the stretched
/// weighted residual follows a small common shift of the noise one to one, and κ Huber's correction for small samples.
fn stretch(standard: &DMatrix<f64>, parameters: usize) -> Vec<f64> {
    let (n, m) = (standard.nrows() as f64, standard.ncols() as f64);
    let distances: Vec<f64> = standard.row_iter().map(|row| distance(row.iter())).collect();
    standard
        .column_iter()
        .map(|column| {
            let slopes: Vec<f64> = column
                .iter()
                .zip(&distances)
                .map(|(z, &distance)| {
                    let weight = weight(distance);
                    if weight < 1.0 { weight * (1.0 - z * z / (m * distance * distance)) } else { 1.0 }
                })
                .collect();
            let mean = slopes.iter().sum::<f64>() / n;
            let variance = slopes.iter().map(|slope| (slope - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
            (1.0 + parameters as f64 * variance / (n * mean * mean)) / mean
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Brownlee's stack loss data: loss, air flow, water temperature, acid concentration.
    const STACK_LOSS: [[f64; 4]; 21] = [
        [42.0, 80.0, 27.0, 89.0],
        [37.0, 80.0, 27.0, 88.0],
        [37.0, 75.0, 25.0, 90.0],
        [28.0, 62.0, 24.0, 87.0],
        [18.0, 62.0, 22.0, 87.0],
        [18.0, 62.0, 23.0, 87.0],
        [19.0, 62.0, 24.0, 93.0],
        [20.0, 62.0, 24.0, 93.0],
        [15.0, 58.0, 23.0, 87.0],
        [14.0, 58.0, 18.0, 80.0],
        [14.0, 58.0, 18.0, 89.0],
        [13.0, 58.0, 17.0, 88.0],
        [11.0, 58.0, 18.0, 82.0],
        [12.0, 58.0, 19.0, 93.0],
        [8.0, 50.0, 18.0, 89.0],
        [7.0, 50.0, 18.0, 86.0],
        [8.0, 50.0, 19.0, 72.0],
        [8.0, 50.0, 19.0, 79.0],
        [9.0, 50.0, 20.0, 80.0],
        [15.0, 56.0, 20.0, 82.0],
        [15.0, 70.0, 20.0, 91.0],
    ];

    fn stack_loss() -> (Design, DMatrix<f64>) {
        let columns = DMatrix::from_fn(21, 4, |i, j| if j == 0 { 1.0 } else { STACK_LOSS[i][j] });
        let names = ["1", "air", "water", "acid"].map(str::to_owned).to_vec();
        (Design::new(names, columns).unwrap(), DMatrix::from_fn(21, 1, |i, _| STACK_LOSS[i][0]))
    }

    fn line(rows: usize) -> Design {
        let columns = DMatrix::from_fn(rows, 2, |i, j| if j == 0 { 1.0 } else { i as f64 });
        Design::new(vec!["offset".into(), "slope".into()], columns).unwrap()
    }

    #[test]
    fn stack_loss_agrees_with_other_programs() {
        // Coefficients, scale and weights from statsmodels (HuberT, MAD about zero), standard deviations from the
        // formula of MASS::summary.rlm evaluated in numpy.
        let (design, loss) = stack_loss();
        let fit = fit(&design, &loss, None, &Limits::default()).unwrap();
        let coefficients = [-41.02649835240013, 0.8293843346001136, 0.9260659661966392, -0.12784672494578717];
        let std = [9.80696300064339, 0.11117599060581816, 0.3033962095133693, 0.12884753741988247];
        for j in 0..4 {
            assert!((fit.solution.coefficients[j] / coefficients[j] - 1.0).abs() < 1e-7);
            assert!((fit.pseudo.coefficients[j] / coefficients[j] - 1.0).abs() < 1e-7);
            assert!((fit.pseudo.std()[j] / std[j] - 1.0).abs() < 1e-7);
        }
        assert!((fit.scales[0] / 2.440536091721106 - 1.0).abs() < 1e-7);
        for (row, weight) in [(2, 0.7858129803797594), (3, 0.5048671960226014), (20, 0.36809168216631943)] {
            assert!((fit.weights[row] / weight - 1.0).abs() < 1e-7);
        }
        assert_eq!(fit.downweighted, 3);
        // Meaning of the factor: sample variance of the pseudo-values over that of the weighted residuals.
        let mean_weight = fit.weights.iter().sum::<f64>() / 21.0;
        let expected = mean_weight * (2.6738028214543816 / fit.solution.residual_std[0]).powi(2);
        assert!((fit.covariance_factor[0] / expected - 1.0).abs() < 1e-7);
    }

    #[test]
    fn rows_that_belong_keep_their_weight() {
        // Residuals of equal size are all within 0.6745 standard deviations.
        let y = DMatrix::from_fn(8, 2, |i, a| [i as f64, 3.0][a] + [1.0, -1.0, -1.0, 1.0][i % 4]);
        let robust = fit(&line(8), &y, None, &Limits::default()).unwrap();
        let plain = solve(&line(8), &y, None, &Limits::default()).unwrap();
        assert_eq!(robust.downweighted, 0);
        assert_eq!(robust.weights, [1.0; 8]);
        assert_eq!(robust.solution.coefficients, plain.coefficients);
        assert!((&robust.pseudo.coefficients - &plain.coefficients).amax() < 1e-15);
        assert!(robust.covariance_factor.iter().all(|factor| (factor - 1.0).abs() < 1e-14));
    }

    #[test]
    fn an_outlier_in_one_right_hand_side_weighs_less_in_all() {
        let wiggle = |i: usize| 0.01 * [1.0, -0.4, -0.9, 0.3, 0.7, -1.1, 0.2][i % 7];
        let mut y = DMatrix::from_fn(30, 3, |i, a| 2.0 + (a as f64 - 1.0) * i as f64 + wiggle(i * (a + 1)));
        y[(11, 1)] += 5.0;
        let plain = solve(&line(30), &y, None, &Limits::default()).unwrap();
        let robust = fit(&line(30), &y, None, &Limits::default()).unwrap();
        assert!(robust.weights[11] < 0.01, "{}", robust.weights[11]);
        assert!((plain.coefficients[(0, 1)] - 2.0).abs() > 0.1);
        for a in 0..3 {
            assert!((robust.solution.coefficients[(0, a)] - 2.0).abs() < 0.01);
            assert!((robust.solution.coefficients[(1, a)] - (a as f64 - 1.0)).abs() < 1e-3);
        }
        assert!((robust.solution.residuals[(11, 1)] - 5.0).abs() < 0.03);
    }

    #[test]
    fn given_weights_are_kept() {
        let (design, loss) = stack_loss();
        let mut weights = vec![2.0; 21];
        weights[3] = 0.0;
        let weighted = fit(&design, &loss, Some(&weights), &Limits::default()).unwrap();
        let rows: Vec<usize> = (0..21).filter(|&i| i != 3).collect();
        let without = Design::new(design.names().to_vec(), design.columns().select_rows(&rows)).unwrap();
        let without = fit(&without, &loss.select_rows(&rows), None, &Limits::default()).unwrap();
        assert!((&weighted.solution.coefficients - &without.solution.coefficients).amax() < 1e-6);
        assert!((weighted.pseudo.std() - without.pseudo.std()).amax() < 1e-6);
        assert_eq!(weighted.weights[3], 0.0);
        assert_eq!(weighted.downweighted, without.downweighted);
    }

    #[test]
    fn data_without_noise_are_no_obstacle() {
        let mut y = DMatrix::from_fn(10, 1, |i, _| 0.1 + 0.3 * i as f64);
        y[4] += 1.0;
        let robust = fit(&line(10), &y, None, &Limits::default()).unwrap();
        assert!((robust.solution.coefficients[1] - 0.3).abs() < 1e-8);
        let zeros = fit(&line(10), &DMatrix::zeros(10, 1), None, &Limits::default()).unwrap();
        assert_eq!((zeros.solution.coefficients.amax(), zeros.downweighted), (0.0, 0));
    }
}
