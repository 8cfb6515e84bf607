use super::*;
use crate::fit::random::Random;
use crate::fit::{linear, polynomial};
use crate::model::sensor::split;
use levenberg_marquardt::LeastSquaresProblem;
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, Vector3};
use std::f64::consts::TAU;

/// Sensor of runs BS_11 of 2013 (BC-MAG-TR-0085 section 12.1), angles in degrees.
fn truth() -> [Vec<f64>; 6] {
    [
        vec![9.72692e-1, -1.80180e-5],
        vec![9.96420e-1, -1.56674e-5],
        vec![9.89066e-1, -1.96816e-5],
        vec![8.9789e1, -1.7948e-5],
        vec![9.0056e1, 4.5473e-5],
        vec![9.0013e1, -1.1504e-4],
    ]
}

const TEMPERATURES: [f64; 7] = [21.3, -71.2, -38.6, 55.1, 22.4, 118.7, 180.2];

/// A group of runs to simulate.
#[derive(Clone, Copy)]
struct Programme {
    /// Every how many-th setting of LIN2000XYZE.MAG is used.
    every: usize,
    runs: usize,
    noise_ent: f64,
    /// Change of the temperature from the first to the last plateau of a run, °C.
    slope_degc: f64,
    /// Part of that change after an exponential approach instead of a line.
    bend: f64,
    /// Scatter of the sensitivities from run to run.
    scatter: f64,
    /// Order of the offset trend that is fitted; that of the data is two.
    trend_order: usize,
}

const GROUP: Programme =
    Programme { every: 1, runs: 7, noise_ent: 0.02, slope_degc: 0.0, bend: 0.0, scatter: 0.0, trend_order: 2 };

/// Fields of LIN2000XYZE.MAG: each axis alone, plus and minus in steps of 200 nT to 2000, zeros between.
fn fields(every: usize) -> Vec<[f64; 3]> {
    let mut all = Vec::new();
    for axis in 0..3 {
        for step in 0..=10 {
            for sign in [1.0, -1.0] {
                let mut field = [0.0; 3];
                field[axis] = sign * 200.0 * f64::from(step);
                all.push(field);
            }
        }
        all.extend([[0.0; 3]; 2]);
    }
    all.into_iter().step_by(every).collect()
}

/// Turns by an angle about an axis, after Rodrigues.
fn turned(v: Vector3<f64>, by: &Vector3<f64>) -> Vector3<f64> {
    let angle = by.norm();
    if angle == 0.0 {
        return v;
    }
    let axis = by / angle;
    v * angle.cos() + axis.cross(&v) * angle.sin() + axis * axis.dot(&v) * (1.0 - angle.cos())
}

/// Three unit vectors with the given angles, degrees: the third from its cosines with the first two.
fn sensor_axes(xi_deg: [f64; 3]) -> [Vector3<f64>; 3] {
    let [xy, xz, yz] = xi_deg.map(|a| (a / 360.0 * TAU).cos());
    let x = Vector3::x();
    let y = Vector3::new(xy, (1.0 - xy * xy).sqrt(), 0.0);
    let gram = 1.0 - xy * xy;
    let (a, b) = ((xz - yz * xy) / gram, (yz - xz * xy) / gram);
    let flat = x * a + y * b;
    [x, y, flat + Vector3::z() * (1.0 - flat.norm_squared()).sqrt()]
}

fn horner(c: &[f64], x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

struct Simulated {
    runs: Vec<JointRun>,
    offsets: Vec<[f64; 3]>,
    turns: Vec<Vector3<f64>>,
}

fn simulate(p: Programme, truth: &[Vec<f64>; 6], seed: u64) -> Simulated {
    let mut random = Random::seeded(seed);
    let fields = fields(p.every);
    let n = fields.len();
    let orientations = [
        Matrix3::identity(),
        Matrix3::new(-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0),
        Matrix3::new(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0),
    ];
    let mut all = Simulated { runs: Vec::new(), offsets: Vec::new(), turns: Vec::new() };
    for index in 0..p.runs {
        let r_nom = orientations[index % 3];
        let turn = Vector3::from_fn(|_, _| 0.005 * random.gaussian());
        let offset: [f64; 3] = std::array::from_fn(|_| 3.0 * random.gaussian());
        let drift: [f64; 3] = std::array::from_fn(|_| 0.2 * random.gaussian());
        let bow: [f64; 3] = std::array::from_fn(|_| 0.1 * random.gaussian());
        let gain: [f64; 3] = std::array::from_fn(|_| 1.0 + p.scatter * random.gaussian());
        let middle = TEMPERATURES[index % 7] + 0.37 * (index / 7) as f64;
        let mut sums = [0.0; 3];
        let plateaus = (0..n)
            .map(|k| {
                let tau = 2.0 * k as f64 / (n - 1) as f64 - 1.0;
                let approach = 1.0 - 2.0 * (-(tau + 1.0) * 2.0f64).exp();
                let temperature_degc = middle + 0.5 * p.slope_degc * ((1.0 - p.bend) * tau + p.bend * approach);
                let axes = sensor_axes(std::array::from_fn(|i| horner(&truth[3 + i], temperature_degc)));
                let nominal = r_nom.transpose() * Vector3::from(fields[k]);
                let seen = turned(nominal, &-turn);
                let reading_ent = std::array::from_fn(|i| {
                    let trend = offset[i] + drift[i] * tau + bow[i] * tau * tau;
                    sums[i] += trend / n as f64;
                    let sigma = horner(&truth[i], temperature_degc) * gain[i];
                    axes[i].dot(&seen) / sigma + trend + p.noise_ent * random.gaussian()
                });
                JointPlateau { field_coil_nt: fields[k], reading_ent, temperature_degc, t_s: 24.0 * k as f64 }
            })
            .collect();
        let noise_ent = [if p.noise_ent > 0.0 { p.noise_ent } else { 0.02 }; 3];
        let rho = Matrix3::identity();
        all.runs.push(JointRun {
            run: format!("{index}"),
            r_nom,
            rho,
            plateaus,
            trend: Trend::Time(p.trend_order),
            rotation_order: 0,
            noise_ent,
        });
        all.offsets.push(sums);
        all.turns.push(turn);
    }
    all
}

/// Runs first, polynomials through their parameters after: coefficients and their standard deviations, the latter from the
/// scatter about the polynomials. Writes the rotations into the runs.
fn two_steps(runs: &mut [JointRun], truth: &[Vec<f64>; 6]) -> ([Vec<f64>; 6], [Vec<f64>; 6]) {
    let mut parameters = vec![Vec::new(); 6];
    let mut temperatures = Vec::new();
    for run in runs.iter_mut() {
        let Trend::Time(order) = run.trend else { panic!("no trend in time") };
        let (n, columns) = (run.plateaus.len(), 4 + order);
        let design = DMatrix::from_fn(n, columns, |k, j| {
            let p = &run.plateaus[k];
            let tau = 2.0 * k as f64 / (n - 1) as f64 - 1.0;
            if j < 3 { p.field_coil_nt[j] } else { tau.powi(j as i32 - 3) }
        });
        let read = DMatrix::from_fn(n, 3, |k, i| run.plateaus[k].reading_ent[i]);
        let factors = QR::new(design);
        let solution = factors.r().solve_upper_triangular(&(factors.q().transpose() * read)).unwrap();
        let phi = solution.fixed_view::<3, 3>(0, 0).transpose().try_inverse().unwrap();
        let parts = split(&phi, &run.r_nom).unwrap();
        run.rho = parts.rho;
        for (list, value) in parameters.iter_mut().zip(parts.sigma.into_iter().chain(parts.xi_deg)) {
            list.push(value);
        }
        temperatures.push(run.plateaus.iter().map(|p| p.temperature_degc).sum::<f64>() / n as f64);
    }
    let fits: [polynomial::Polynomial; 6] = std::array::from_fn(|i| {
        polynomial::fit(&temperatures, &parameters[i], None, truth[i].len() - 1, &linear::Limits::default()).unwrap()
    });
    let std = std::array::from_fn(|i| fits[i].covariance().diagonal().iter().map(|v| v.sqrt()).collect());
    (fits.map(|fit| fit.coefficients), std)
}

fn fitted(p: Programme, truth: &[Vec<f64>; 6], seed: u64) -> (Simulated, [Vec<f64>; 6], JointFit) {
    let mut simulated = simulate(p, truth, seed);
    let (start, _) = two_steps(&mut simulated.runs, truth);
    let joint = joint(&simulated.runs, &start, &Limits::default()).unwrap();
    (simulated, start, joint)
}

#[test]
fn data_without_noise_give_the_sensor_exactly() {
    let quadratic = [
        vec![9.97312e-1, 8.41537e-4, -2.34026e-6],
        vec![1.01904, 9.92588e-4, -2.21768e-6],
        vec![9.81879e-1, 6.63730e-4, -1.40862e-6],
        vec![9.0578e1, 1.4757e-3, -5.1834e-6],
        vec![8.9782e1, -4.0098e-4, 2.5339e-6],
        vec![9.0109e1, -4.8477e-4, 5.5736e-7],
    ];
    for (truth, slope_degc) in [(truth(), 0.0), (truth(), 5.0), (quadratic, 5.0)] {
        let p = Programme { every: 2, noise_ent: 0.0, slope_degc, bend: 0.3, ..GROUP };
        let (simulated, _, joint) = fitted(p, &truth, 3);
        for (found, expected) in joint.polynomials.iter().zip(&truth) {
            for (found, expected) in found.coefficients.iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected} {slope_degc}");
            }
        }
        assert!(joint.chi2 < 1e-12 * joint.dof as f64 && joint.inflation_within == 1.0);
        for ((run, offset), turn) in joint.runs.iter().zip(&simulated.offsets).zip(&simulated.turns) {
            for i in 0..3 {
                assert!((run.b_or_ent[i] - offset[i]).abs() < 1e-10);
                let unit = Vector3::from_fn(|row, _| f64::from(u8::from(row == i)));
                let seen = turned(unit, turn);
                assert!((run.rho.column(i) - seen).norm() < 1e-12);
                assert!((run.rotation_deg[i] - seen.cross(&unit).norm().asin().to_degrees()).abs() < 1e-10);
            }
        }
    }
}

#[test]
fn derivatives_are_those_of_the_model() {
    let truth = truth();
    let mut simulated = simulate(Programme { every: 9, runs: 2, slope_degc: 30.0, ..GROUP }, &truth, 1);
    // The second run turns with the temperature, and so does its offset.
    simulated.runs[1].rotation_order = 1;
    simulated.runs[1].trend = Trend::Temperature([0, 1, 2]);
    let layout = Layout::over(&simulated.runs, &truth).unwrap();
    let data: Vec<RunRows> = simulated.runs.iter().map(|run| RunRows::of(run, &layout)).collect();
    let mut parameters = layout.start(&truth);
    // Far from right angles and from no rotation, where every derivative counts.
    [0.2, -0.15, 0.1].iter().enumerate().for_each(|(i, d)| parameters[layout.starts[3 + i]] += d);
    parameters.rows_mut(layout.starts[6], 9).copy_from_slice(&[0.3, -0.2, 0.5, 1e-4, 2e-4, -1e-4, -0.03, 0.01, 0.02]);
    let mut point = SearchPoint { layout: &layout, data: &data, parameters, residuals: None, evaluations: 0 };
    let jacobian = point.jacobian().unwrap();
    for j in 0..layout.count() {
        let mut at = |step: f64| {
            let value = point.parameters[j];
            point.parameters[j] = value + step;
            point.evaluate();
            point.parameters[j] = value;
            point.residuals.clone().unwrap()
        };
        let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
        let error = (&numeric - jacobian.column(j)).norm() / numeric.norm();
        assert!(error < 1e-7, "{}: {error}", layout.names[j]);
    }
}

#[test]
fn coefficients_lie_within_their_uncertainty() {
    let truth = truth();
    for seed in 0..3 {
        let (_, start, joint) = fitted(Programme { every: 2, ..GROUP }, &truth, seed);
        for (i, (found, expected)) in joint.polynomials.iter().zip(&truth).enumerate() {
            for (k, std) in found.std().into_iter().enumerate() {
                assert!((found.coefficients[k] - expected[k]).abs() < 3.5 * std, "{} {k}", QUANTITIES[i]);
                assert!((joint.change[i][k] - (found.coefficients[k] - start[i][k])).abs() < 1e-15);
            }
        }
        assert!(joint.chi2 < joint.start_chi2 && joint.inflation_within == 1.0);
        assert!((joint.chi2 / joint.dof as f64 - 1.0).abs() < 0.2);
        assert!(joint.runs.iter().flat_map(|run| run.residual_std_ent).all(|std| (0.012..0.028).contains(&std)));
        assert_eq!((joint.between[0].dof, joint.runs.len()), (7 - 2, 7));
        assert_eq!(joint.polynomials[0].valid_degc, [-71.2, 180.2]);
    }
}

#[test]
fn scatter_between_runs_widens_the_uncertainty() {
    let truth = truth();
    let (_, _, quiet) = fitted(Programme { every: 2, ..GROUP }, &truth, 6);
    let (_, _, loud) = fitted(Programme { every: 2, scatter: 3e-5, ..GROUP }, &truth, 6);
    assert_eq!((quiet.inflation_within, loud.inflation_within), (1.0, 1.0));
    for i in 0..6 {
        let (quiet, loud) = (&quiet.between[i], &loud.between[i]);
        assert!(quiet.inflation == 1.0 && (loud.inflation > 2.0) == (i < 3), "{} {}", QUANTITIES[i], loud.inflation);
        // Deviations follow the noise where nothing else scatters.
        let largest = quiet.deviation.iter().zip(&quiet.std).map(|(d, s)| (d / s).abs()).fold(0.0, f64::max);
        assert!((0.3..4.0).contains(&largest), "{largest}");
    }
}

/// A factor for each quantity: its variances have the square, and what two of them share the product.
#[test]
fn uncertainties_are_widened_by_the_factors_of_the_quantities() {
    let (_, _, plain) = fitted(GROUP, &truth(), 1);
    let factors = [1.0, 2.0, 1.0, 1.0, 3.0, 1.0];
    let wide = plain.clone().widened(&factors);
    assert_eq!(wide.polynomials[0], plain.polynomials[0]);
    let std = |fit: &JointFit, i: usize| fit.polynomials[i].evaluate(20.0).1;
    assert!((std(&wide, 1) / std(&plain, 1) - 2.0).abs() < 1e-9 && (std(&wide, 4) / std(&plain, 4) - 3.0).abs() < 1e-9);
    // Two coefficients each: the first of sigma_y is the third, the first of xi_xz the ninth.
    let ratio = |r: usize, c: usize| wide.covariance[(r, c)] / plain.covariance[(r, c)];
    assert!((ratio(2, 8) - 6.0).abs() < 1e-9 && (ratio(0, 8) - 3.0).abs() < 1e-9 && (ratio(0, 1) - 1.0).abs() < 1e-9);
}

#[test]
fn what_the_runs_do_not_determine_is_refused_by_name() {
    let truth = truth();
    let simulated = simulate(Programme { every: 6, runs: 3, ..GROUP }, &truth, 1);
    type Change<'a> = &'a dyn Fn(&mut Vec<JointRun>, &mut [Vec<f64>; 6]);
    let refused = |change: Change| {
        let (mut runs, mut start) = (simulated.runs.clone(), truth.clone());
        change(&mut runs, &mut start);
        joint(&runs, &start, &Limits::default()).unwrap_err().to_string()
    };
    assert_eq!(refused(&|runs, _| runs.clear()), "no runs to fit");
    let message = refused(&|_, start| start[2].extend([0.0, 0.0]));
    assert!(message.starts_with("the data do not determine sigma_z T^0, sigma_z T^1, sigma_z T^2, sigma_z T^3"), "{message}");
    let message = refused(&|runs, _| runs[1].plateaus.iter_mut().for_each(|p| p.field_coil_nt = [p.field_coil_nt[0], 0.0, 0.0]));
    assert!(message.contains("the rotation of run 1 about x"), "{message}");
    assert!(refused(&|runs, _| runs[1].plateaus[4].temperature_degc = f64::NAN).starts_with("run 1: plateau 5 has a field"));
    assert!(refused(&|runs, _| runs[0].noise_ent[1] = 0.0).ends_with("must be positive, not 0 enT"));
    assert!(refused(&|runs, _| runs[0].plateaus.truncate(5)).starts_with("run 0: 5 plateaus cannot carry"));
    assert!(refused(&|runs, _| runs[2].trend = Trend::Time(3)).starts_with("run 2: offset trend of order 3"));
    assert_eq!(refused(&|_, start| start[3].clear()), "xi_xy has no polynomial to start from");
    assert_eq!(
        refused(&|_, start| start[4] = vec![0.0]),
        "the polynomials to start from describe no sensor at the temperature of some plateau"
    );
    assert_eq!(refused(&|_, start| start[1] = vec![1.0; 7]), "order 6 is higher than 5, the highest that is fitted");
}

/// A sweep: fields in all directions while the temperature falls by 150 K, offsets that follow it, a mount that turns by 0.1° per 100 K.
fn sweep(noise_ent: f64) -> (JointRun, [Vec<f64>; 6], [[f64; 3]; 3]) {
    let truth = truth();
    let mut simulated = simulate(Programme { runs: 1, slope_degc: -150.0, noise_ent: 0.0, ..GROUP }, &truth, 4);
    let mut run = simulated.runs.remove(0);
    let offsets = [[3.0, 2e-3, 7e-5], [-1.0, -3e-3, 0.0], [0.5, 1e-3, -1e-5]];
    let mut random = Random::seeded(17);
    for (k, p) in run.plateaus.iter_mut().enumerate() {
        let k = k as f64;
        p.field_coil_nt = [1.7, 2.3, 3.1].map(|rate| 2000.0 * (rate * k + rate).sin());
        let degc = p.temperature_degc;
        let axes = sensor_axes(std::array::from_fn(|i| horner(&truth[3 + i], degc)));
        let turn = Vector3::new(0.004, -0.003, 0.002) + Vector3::new(0.0, 1.0, 0.5) * (1e-3f64.to_radians() * degc);
        let seen = turned(Vector3::from(p.field_coil_nt), &-turn);
        p.reading_ent = std::array::from_fn(|i| {
            axes[i].dot(&seen) / horner(&truth[i], degc) + horner(&offsets[i], degc) + noise_ent * random.gaussian()
        });
    }
    run.trend = Trend::Temperature([2, 1, 2]);
    run.rotation_order = 1;
    (run, truth, offsets)
}

/// The polynomials of a sweep without noise come back, and its mount: rotation vectors that are straight lines make one that nearly is.
#[test]
fn a_sweep_without_noise_gives_its_polynomials() {
    let (mut run, truth, offsets) = sweep(0.0);
    run.rotation_order = 3;
    let fit = one_run(&run, &truth.clone().map(|c| vec![c[0] * (1.0 + 1e-4), c[1] * 1.1]), &Limits::default()).unwrap();
    for (k, expected) in truth.iter().chain(&offsets.map(|c| c.to_vec())).enumerate() {
        let found = fit.coefficients(k);
        let at = |c: &[f64], degc: f64| horner(c, degc);
        for degc in [-50.0, 20.0, 90.0] {
            assert!((at(&found, degc) - at(expected, degc)).abs() < 1e-8 * expected[0].abs().max(1.0), "{k} {found:?}");
        }
    }
    assert!(fit.residual_ent.amax() < 1e-6);
    let [low, high] = fit.valid_degc.map(|degc| fit.rho(degc));
    let turned_deg = (0.5 * ((low.transpose() * high).trace() - 1.0)).acos().to_degrees();
    let expected = 1e-3 * 1.25f64.sqrt() * (fit.valid_degc[1] - fit.valid_degc[0]);
    assert!((turned_deg / expected - 1.0).abs() < 1e-3, "{turned_deg} {expected}");
}

/// Parameters move with the readings as the influence says, and with readings that a parameter beside them moves.
#[test]
fn the_influence_of_readings_is_what_they_change() {
    let (run, truth, _) = sweep(0.02);
    let fit = one_run(&run, &truth, &Limits::default()).unwrap();
    let influence = fit.influence(None).unwrap();
    for (plateau, component) in [(3, 0), (20, 1), (41, 2)] {
        let mut moved = run.clone();
        moved.plateaus[plateau].reading_ent[component] += 0.1;
        let step = one_run(&moved, &truth, &Limits::default()).unwrap().values() - fit.values();
        let expected = influence[component].column(plateau) * 0.1;
        for j in 0..fit.count() {
            let size = influence.iter().map(|g| g.row(j).norm()).fold(0.0, f64::max);
            assert!((step[j] - expected[j]).abs() < 1e-3 * 0.1 * size, "{j}: {} {}", step[j], expected[j]);
        }
    }
    // What the fit itself follows tells nothing of a parameter beside it; what it does not follow tells all.
    let degc: Vec<f64> = run.plateaus.iter().map(|p| p.temperature_degc).collect();
    let unit = 1.0 + 2.0 * fit.count() as f64;
    let beside = DMatrix::from_fn(degc.len(), 3, |k, _| (unit * k as f64).sin());
    let with = fit.influence(Some(&beside)).unwrap();
    let told: f64 = (0..3).map(|c| (with[c].row(fit.count()) * beside.column(c))[0]).sum();
    assert!((told - 1.0).abs() < 1e-9, "{told}");
    let by_offset = fit.readings_ent(&degc).unwrap();
    assert!(
        (by_offset + &fit.residual_ent - DMatrix::from_fn(degc.len(), 3, |k, c| run.plateaus[k].reading_ent[c])).amax() < 1e-9
    );
}

/// Errors over many simulated groups.
struct Statistics {
    /// Share of 95 % intervals of coefficients that hold the truth: those of sensitivities, of angles.
    held: [f64; 2],
    /// The same for the offsets.
    offsets_held: f64,
    /// Per coefficient: standard deviation of the joint fit, its mean and root mean square error, those of the two steps.
    coefficients: Vec<[f64; 5]>,
    /// Share of polynomials about which the runs are said to scatter: of sensitivities, of angles.
    inflated: [f64; 2],
}

fn statistics(p: Programme, truth: &[Vec<f64>; 6], seeds: u64) -> Statistics {
    let n = seeds as f64;
    let mut all = Statistics { held: [0.0; 2], offsets_held: 0.0, coefficients: Vec::new(), inflated: [0.0; 2] };
    all.coefficients.resize(truth.iter().map(Vec::len).sum(), [0.0; 5]);
    for seed in 0..seeds {
        let (simulated, start, joint) = fitted(p, truth, seed);
        let mut sums = all.coefficients.iter_mut();
        for i in 0..6 {
            let group = i / 3;
            let count = truth[3 * group..3 * group + 3].iter().map(Vec::len).sum::<usize>() as f64;
            all.inflated[group] += f64::from(u8::from(joint.between[i].inflation > 1.0)) / n / 3.0;
            // Student's t for five and four degrees of freedom.
            let student = if joint.between[i].inflation > 1.0 { [2.571, 2.776][truth[i].len() - 2] } else { 1.96 };
            for (k, std) in joint.polynomials[i].std().into_iter().enumerate() {
                let error = joint.polynomials[i].coefficients[k] - truth[i][k];
                let of_start = start[i][k] - truth[i][k];
                all.held[group] += f64::from(u8::from(error.abs() <= student * std)) / n / count;
                let terms = [std * std, error, error * error, of_start, of_start * of_start];
                sums.next().unwrap().iter_mut().zip(terms).for_each(|(sum, term)| *sum += term / n);
            }
        }
        for (run, offset) in joint.runs.iter().zip(&simulated.offsets) {
            for i in 0..3 {
                let held = (run.b_or_ent[i] - offset[i]).abs() <= 1.96 * run.b_or_std_ent[i];
                all.offsets_held += f64::from(u8::from(held)) / n / (3 * p.runs) as f64;
            }
        }
    }
    for c in &mut all.coefficients {
        *c = [c[0].sqrt(), c[1], c[2].sqrt(), c[3], c[4].sqrt()];
    }
    all
}

#[test]
fn intervals_cover_where_two_steps_are_biased() {
    // The temperature moves while the axes are driven one after another: x is measured colder than the mean, z warmer.
    let all = statistics(Programme { every: 5, slope_degc: 20.0, ..GROUP }, &truth(), 20);
    // 240 intervals which in part depend on each other.
    assert!(all.held.iter().all(|held| (0.88..=0.995).contains(held)), "{:?}", all.held);
    assert!((0.9..0.99).contains(&all.offsets_held), "{}", all.offsets_held);
    // σ_z at 0 °C.
    let [std, mean, _, two_steps, _] = all.coefficients[4];
    assert!(mean.abs() < 0.8 * std && two_steps.abs() > 3.0 * std, "{mean} {two_steps} {std}");
}

/// Printed with `--nocapture`: coverage, bias and times. Where the sensitivities do not scatter from run to run, intervals of 95 % hold
/// the truth, whether the temperature moves or not; `CALFIT_STUDY=full` makes 200 groups of each kind.
#[test]
fn figures() {
    let seeds = if std::env::var("CALFIT_STUDY").is_ok_and(|size| size == "full") { 200 } else { 20 };
    let strong: [Vec<f64>; 6] = std::array::from_fn(|i| {
        let linear = if i < 3 { 8e-4 } else { truth()[i][1] };
        vec![truth()[i][0], linear, if i < 3 { -2e-6 } else { -5e-6 }]
    });
    let slope = Programme { slope_degc: 5.0, ..GROUP };
    for (name, p, truth) in [
        ("plain", GROUP, truth()),
        ("slope 5", slope, truth()),
        ("slope 5, strong", slope, strong.clone()),
        ("slope 5 bent, strong", Programme { bend: 1.0, ..slope }, strong.clone()),
        ("scatter 2e-6", Programme { scatter: 2e-6, ..GROUP }, truth()),
        ("scatter 4e-6", Programme { scatter: 4e-6, ..GROUP }, truth()),
        ("scatter 1e-5", Programme { scatter: 1e-5, ..GROUP }, truth()),
        ("scatter 1e-4", Programme { scatter: 1e-4, ..GROUP }, truth()),
    ] {
        let clock = std::time::Instant::now();
        let all = statistics(p, &truth, seeds);
        let each_ms = clock.elapsed().as_secs_f64() * 1e3 / seeds as f64;
        println!(
            "{name}: sigma, xi held {:.3?} offsets held {:.3} inflated {:.3?} {each_ms:.1} ms each",
            all.held, all.offsets_held, all.inflated
        );
        // 120 or more intervals of each kind, which in part depend on each other.
        assert!(p.scatter > 0.0 || all.held.iter().all(|held| (0.85..=1.0).contains(held)), "{name}: {:?}", all.held);
        assert!((0.9..0.99).contains(&all.offsets_held), "{name}: {}", all.offsets_held);
        for [std, mean, rms, two_mean, two_rms] in all.coefficients {
            let [a, b, c, d] = [mean, rms, two_mean, two_rms].map(|v| v / std);
            println!("  std {std:.2e}: joint mean {a:+.2} rms {b:.2}   two steps mean {c:+.2} rms {d:.2}");
        }
    }
    let mut simulated = simulate(Programme { runs: 20, slope_degc: 5.0, ..GROUP }, &strong, 1);
    // 90 plateaus a run.
    simulated.runs.iter_mut().for_each(|run| run.plateaus.extend_from_within(..18));
    for coefficients in [3, 5, 6] {
        let (mut start, _) = two_steps(&mut simulated.runs, &strong);
        start.iter_mut().for_each(|c| c.resize(coefficients, 0.0));
        let clock = std::time::Instant::now();
        let joint = joint(&simulated.runs, &start, &Limits::default()).unwrap();
        let (seconds, parameters) = (clock.elapsed().as_secs_f64(), 60 + 6 * coefficients);
        println!(
            "{parameters} parameters: {seconds:.3} s, {} evaluations, chi2 {:.1} / {}",
            joint.evaluations, joint.chi2, joint.dof
        );
    }
}
