//! How often do intervals of 95 % hold the truth, and how far are the estimates from the smallest possible variance?
//!
//! Every run has a sensor, a rotation and offsets of its own, full-rate samples in the programmes of 2013, and passes the analysis without
//! a file between. The bounds are those of Cramér and Rao for the simulated noise, from the closed form of its covariance: for the
//! means of quarters of the plateaus (linearity, offset), for the density at the frequency of the sine or its alias (frequency).

mod moving;
mod samples;
mod sines;
mod table;

pub use samples::{NOISES, Noise};
pub use table::table;

use calfit::data::across::CalibratedRun;
use calfit::data::plateau::{Accumulator, Cut, Plateaus};
use calfit::data::run::{Run, Setting};
use calfit::data::units::FieldCoil;
use calfit::files::mag::{Programme, Step};
use calfit::files::twin::{RunTwin, Twin};
use calfit::fit::NORMAL_95;
use calfit::measure::freq::{self, Sines};
use calfit::measure::lin::Lin;
use calfit::measure::thermal::{Kind, groups, thermal};
use calfit::measure::{lin, null, offset};
use calfit::model::campaign::Instructions;
use calfit::model::sensor::split;
use calfit::simulate::Simulation;
use calfit::simulate::noise::Random;
use calfit::simulate::run::SimulatedRun;
use calfit::workflow::RunResult;
use moving::{demo, of_moving, of_sweep};
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};
use rayon::prelude::*;
use sines::{Tones, of_freq};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// One estimated parameter of one run.
pub struct Estimate {
    pub name: String,
    pub value: f64,
    pub std: f64,
    /// Standard uncertainties of an interval of 95 %.
    pub factor_95: f64,
    pub truth: f64,
    /// Smallest possible standard deviation; NaN where none was worked out.
    pub bound: f64,
}

/// All runs of one parameter.
#[derive(Clone, Copy, Default)]
pub struct Tally {
    pub runs: u32,
    pub held: u32,
    squares: f64,
    variances: f64,
    against_bound: f64,
    stated: f64,
}

impl Tally {
    pub fn coverage(&self) -> f64 {
        f64::from(self.held) / f64::from(self.runs)
    }

    /// The runs of another parameter as well.
    pub fn add(&mut self, other: &Tally) {
        self.runs += other.runs;
        self.held += other.held;
        self.squares += other.squares;
        self.variances += other.variances;
        self.against_bound += other.against_bound;
        self.stated += other.stated;
    }

    /// Root mean square of stated over that of real errors.
    pub fn width(&self) -> f64 {
        (self.variances / self.squares).sqrt()
    }

    /// Mean of the stated standard uncertainties over the smallest possible ones.
    pub fn stated(&self) -> f64 {
        self.stated / f64::from(self.runs)
    }

    /// Variance of the estimates over the bound.
    pub fn loss(&self) -> f64 {
        self.against_bound / f64::from(self.runs)
    }
}

/// Runs the study of `lin`, `lin moving`, `offset`, `freq`, `null`, `sweep` or `thermal`; parameters in the order of their names.
pub fn study(name: &str, noise: Noise, runs: u64) -> BTreeMap<String, Tally> {
    let mut tallies: BTreeMap<String, Tally> = BTreeMap::new();
    for e in estimates_of(name, noise, runs) {
        let tally = tallies.entry(e.name).or_default();
        let error = e.value - e.truth;
        tally.runs += 1;
        tally.held += u32::from(error.abs() <= e.factor_95 * e.std);
        tally.squares += error * error;
        tally.variances += e.std * e.std;
        tally.against_bound += (error / e.bound).powi(2);
        tally.stated += e.std / e.bound;
    }
    tallies
}

fn estimates_of(name: &str, noise: Noise, runs: u64) -> Vec<Estimate> {
    let demo = demo();
    let base = base(&demo);
    let estimates: Vec<Vec<Estimate>> = (0..runs)
        .into_par_iter()
        .map(|seed| match name {
            "lin" => of_lin(&base, noise, seed),
            "lin moving" => of_moving(&base, &demo, noise, seed),
            "sweep" => of_sweep(&demo, noise, seed),
            "offset" => of_offset(&base, noise, seed),
            "freq" => of_freq(&base, noise, seed),
            "null" => of_null(&base, noise, seed),
            _ => of_thermal(&base, noise, seed),
        })
        .collect();
    estimates.into_iter().flatten().collect()
}

const RATE_HZ: f64 = 128.0;
/// Length of a record in zero field, s.
const NULL_S: f64 = 3600.0;
/// Parts of it whose means the bounds know.
const NULL_PARTS: usize = 512;
/// Amplitude over its standard deviation from which phases are compared.
const CLEAR: f64 = 10.0;
/// Parts of a plateau whose means the bounds know.
const PARTS: usize = 4;
/// Temperatures of a thermal group, °C.
const TEMPERATURES_DEGC: [f64; 7] = [-71.0, -21.0, 17.3, 30.0, 80.0, 130.0, 180.0];

/// The twin of the demonstration at rest, with short sines.
fn base(demo: &Twin) -> Twin {
    let mut twin = demo.clone();
    twin.thermal_box.phases.clear();
    twin.thermistors[0].noise_k = 0.0;
    let programme = |name: &str| twin.programmes.iter().find(|p| p.name == name).cloned().unwrap();
    let mut sines: Programme = programme("FREQ2000.MAG");
    let shorter = |step: &Step| Step { duration_s: (5.0 / step.frequency_hz).max(10.0), ..*step };
    sines.steps = sines.steps.iter().filter(|s| s.frequency_hz > 0.4).map(shorter).collect();
    let mut zero: Programme = programme("NULL.MAG");
    zero.steps.truncate(1);
    zero.steps[0].duration_s = NULL_S;
    twin.programmes = vec![programme("LIN2000XYZE.MAG"), programme("OFFSET_200.MAG"), sines, zero];
    twin
}

/// The base with a sensor, a rotation, a residual field and noise of its own; one programme, at one temperature.
fn drawn(base: &Twin, noise: Noise, programme: usize, random: &mut Random) -> Twin {
    let mut twin = base.clone();
    twin.runs.truncate(1);
    let run: &mut RunTwin = &mut twin.runs[0];
    (run.programme, run.pause_s, run.longest_s, run.nominal_rate_hz) = (programme, 0.0, None, None);
    run.position = (programme == 2).then_some(5);
    let mut around = |middle: f64, by: f64| middle + by * (2.0 * random.uniform() - 1.0);
    let sensor = &mut twin.sensors[0];
    for i in 0..3 {
        sensor.model.sigma[i] = vec![around(1.0, 0.05), around(0.0, 2e-5)];
        sensor.model.xi_deg[i] = vec![around(90.0, 0.3), around(0.0, 1e-4)];
        sensor.model.b_off_ent[i] = vec![around(0.0, 10.0), around(0.0, 5e-3), around(0.0, 1e-4)];
        sensor.model.f_3db_hz[i] = vec![around(57.0, 5.0), around(0.0, 0.05)];
        sensor.rotation_deg[i] = around(0.0, 1.0);
        twin.facility.residual[0].field_nt[i] = around(0.0, 10.0);
    }
    sensor.rate_hz = around(127.999, 0.0005);
    let (white_ent, flicker_ent) = noise.own();
    (sensor.white_ent, sensor.flicker_ent) = ([white_ent; 3], [flicker_ent; 3]);
    twin.facility.setting_scatter_nt = [noise.scatter_nt; 3];
    sensor.flicker_lowest_hz = lowest_hz(&twin.programmes[programme], noise);
    twin
}

/// The longest relaxation is as long as the run where nothing else is said.
fn lowest_hz(programme: &Programme, noise: Noise) -> f64 {
    noise.lowest_hz.unwrap_or(1.0 / (TAU * programme.lasts_s(0.0)))
}

fn simulated<T>(twin: &Twin, seed: u64, then: impl FnOnce(&SimulatedRun) -> T) -> T {
    let simulation = Simulation::new(twin, seed);
    let run = simulation.run(&twin.runs[0]).unwrap_or_else(|e| panic!("{e}"));
    then(&run)
}

/// Response `A` of the sensor in a position at a temperature, enT/nT.
fn response(twin: &Twin, position: u32, degc: f64) -> Matrix3<f64> {
    let (nominal, missed) = twin.places[&position];
    let turn = |v: [f64; 3]| Rotation3::from_scaled_axis(Vector3::from(v.map(f64::to_radians))).into_inner();
    let rho = turn(missed) * turn(twin.sensors[0].rotation_deg);
    *twin.sensors[0].model.at(degc, &nominal.r_nom(), &rho).unwrap().response()
}

/// Covariance of the means over quarters of plateaus, and the settings they belong to.
fn parts(
    settings: &[Setting],
    noise: Noise,
    lowest_hz: f64,
    reading_ent: impl Fn(&Setting) -> f64,
) -> (Vec<(Setting, f64)>, DMatrix<f64>) {
    parts_of(settings, PARTS, noise, lowest_hz, reading_ent)
}

/// The same for any number of equal parts.
fn parts_of(
    settings: &[Setting],
    parts: usize,
    noise: Noise,
    lowest_hz: f64,
    reading_ent: impl Fn(&Setting) -> f64,
) -> (Vec<(Setting, f64)>, DMatrix<f64>) {
    let intervals: Vec<(Setting, [f64; 2])> = settings
        .iter()
        .flat_map(|s| {
            let length = (s.t_end_s - s.t_start_s) / parts as f64;
            (0..parts).map(move |k| (*s, [s.t_start_s + length * k as f64, s.t_start_s + length * (k + 1) as f64]))
        })
        .collect();
    let mut covariance = DMatrix::zeros(intervals.len(), intervals.len());
    for (variance, tau) in noise.relaxations(RATE_HZ, lowest_hz) {
        for i in 0..intervals.len() {
            let [a, b] = intervals[i].1;
            let x = (b - a) / tau;
            covariance[(i, i)] += variance * 2.0 * (x - 1.0 + (-x).exp()) / (x * x);
            for j in i + 1..intervals.len() {
                let [c, d] = intervals[j].1;
                let y = (d - c) / tau;
                let value = variance * -(-x).exp_m1() * -(-y).exp_m1() / (x * y) * (-(c - b) / tau).exp();
                covariance[(i, j)] += value;
                covariance[(j, i)] += value;
            }
        }
    }
    for (i, (setting, [a, b])) in intervals.iter().enumerate() {
        let variance = noise.white_ent.powi(2) + (noise.of_reading * reading_ent(setting)).powi(2);
        covariance[(i, i)] += variance / ((b - a) * RATE_HZ);
        for j in (i - i % parts)..(i - i % parts + parts) {
            covariance[(i, j)] += noise.scatter_nt.powi(2);
        }
    }
    (intervals.iter().map(|(s, [a, b])| (*s, 0.5 * (a + b))).collect(), covariance)
}

/// Smallest covariance of the parameters of a linear model.
fn smallest(design: &DMatrix<f64>, covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let lower = covariance.clone().cholesky().unwrap().l();
    let white = lower.solve_lower_triangular(design).unwrap();
    (white.transpose() * white).try_inverse().unwrap()
}

/// Standard deviations of functions of parameters, by differences.
fn carried(covariance: &DMatrix<f64>, at: &DVector<f64>, steps: &[f64], f: impl Fn(&DVector<f64>) -> Vec<f64>) -> Vec<f64> {
    let count = f(at).len();
    let mut jacobian = DMatrix::zeros(count, at.len());
    for j in 0..at.len() {
        let moved = |by: f64| {
            let mut x = at.clone();
            x[j] += by;
            f(&x)
        };
        for (i, (up, down)) in moved(steps[j]).into_iter().zip(moved(-steps[j])).enumerate() {
            jacobian[(i, j)] = (up - down) / (2.0 * steps[j]);
        }
    }
    (0..count).map(|i| (jacobian.row(i) * covariance * jacobian.row(i).transpose())[0].sqrt()).collect()
}

/// The quantities of a linear calibration from the response, with B_or last.
fn quantities(a: &Matrix3<f64>, r_nom: &Matrix3<f64>, b_or: [f64; 3]) -> Vec<f64> {
    let s = split(&a.try_inverse().unwrap(), r_nom).unwrap();
    let phi: Vec<f64> = s.phi.transpose().iter().copied().collect();
    [s.sigma.to_vec(), s.xi_deg.to_vec(), s.rotation_deg.to_vec(), phi, b_or.to_vec()].concat()
}

const LIN_NAMES: [&str; 21] = [
    "sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz", "lambda_x", "mu_y", "nu_z", "phi_xx", "phi_xy", "phi_xz",
    "phi_yx", "phi_yy", "phi_yz", "phi_zx", "phi_zy", "phi_zz", "b_or_x", "b_or_y", "b_or_z",
];

/// Bounds of the quantities of a linear calibration.
fn lin_bounds(twin: &Twin, settings: &[Setting], noise: Noise, a: &Matrix3<f64>, b_or: [f64; 3]) -> Vec<f64> {
    let end_s = settings.last().unwrap().t_end_s;
    let tau = |t: f64| 2.0 * t / end_s - 1.0;
    let of_component = |i: usize| {
        let reading_ent = |s: &Setting| (a.row(i) * Vector3::from(s.field.0))[0];
        let (rows, covariance) = parts(settings, noise, twin.sensors[0].flicker_lowest_hz, reading_ent);
        let design =
            DMatrix::from_fn(rows.len(), 6, |r, c| if c < 3 { rows[r].0.field.0[c] } else { tau(rows[r].1).powi(c as i32 - 3) });
        smallest(&design, &covariance)
    };
    let first = of_component(0);
    let each =
        if noise.of_reading > 0.0 { [first, of_component(1), of_component(2)] } else { [first.clone(), first.clone(), first] };
    let covariance = DMatrix::from_fn(18, 18, |r, c| if r / 6 == c / 6 { each[r / 6][(r % 6, c % 6)] } else { 0.0 });
    let mean_square = settings.iter().map(|s| tau(0.5 * (s.t_start_s + s.t_end_s)).powi(2)).sum::<f64>() / settings.len() as f64;
    let at = DVector::from_fn(18, |k, _| match k % 6 {
        c if c < 3 => a[(k / 6, c)],
        3 => b_or[k / 6],
        _ => 0.0,
    });
    let r_nom = twin.places[&1].0.r_nom();
    let steps: Vec<f64> = (0..18).map(|k| if k % 6 < 3 { 1e-6 } else { 1e-3 }).collect();
    carried(&covariance, &at, &steps, |x| {
        let a = Matrix3::from_fn(|i, k| x[6 * i + k]);
        quantities(&a, &r_nom, std::array::from_fn(|i| x[6 * i + 3] + mean_square * x[6 * i + 5]))
    })
}

/// Parameters of one run with normal intervals.
fn estimates(names: &[&str], values: &[f64], std: &[f64], truth: &[f64], bounds: &[f64]) -> Vec<Estimate> {
    let one = |k: usize| Estimate {
        name: names[k].to_owned(),
        value: values[k],
        std: std[k],
        factor_95: NORMAL_95,
        truth: truth[k],
        bound: bounds[k],
    };
    (0..names.len()).map(one).collect()
}

fn plateaus(twin: &Twin, noise: Noise, seed: u64, run: &SimulatedRun) -> (Run, Plateaus) {
    let mut accumulator = Accumulator::default();
    let run = noise.play(run, twin.sensors[0].flicker_lowest_hz, seed, &mut accumulator);
    (run, accumulator.finish(Cut::default()))
}

fn of_lin(base: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let twin = drawn(base, noise, 0, &mut Random::new(seed, &["lin"]));
    let degc = twin.thermal_box.start_degc;
    let (result, settings) = simulated(&twin, seed, |run| {
        let (run, plateaus) = plateaus(&twin, noise, seed, run);
        (lin::lin(&run, &plateaus, &twin.campaign.instructions, &lin::Options::default()).unwrap(), run.settings)
    });
    let a = response(&twin, 1, degc);
    let residual = a * Vector3::from(twin.facility.residual[0].field_nt);
    let offset = twin.sensors[0].model.offset_ent(degc);
    let b_or: [f64; 3] = std::array::from_fn(|i| offset[i] + residual[i]);
    let truth = quantities(&a, &twin.places[&1].0.r_nom(), b_or);
    let bounds = lin_bounds(&twin, &settings, noise, &a, b_or);
    let p = &result.calibration;
    let angles = &p.angle_deg;
    let values = [
        (0..3).map(|i| p.matrix.sigma[i][i]).collect(),
        vec![angles.xi_xy, angles.xi_xz, angles.xi_yz, angles.lambda_x, angles.mu_y, angles.nu_z],
        p.matrix.phi.concat(),
        p.offset.b_or_ent.to_vec(),
    ]
    .concat();
    let std = [
        p.std.sigma.to_vec(),
        p.std.xi_deg.to_vec(),
        p.std.lambda_mu_nu_deg.to_vec(),
        p.std.phi.concat(),
        p.std.b_or_ent.to_vec(),
    ]
    .concat();
    estimates(&LIN_NAMES, &values, &std, &truth, &bounds)
}

/// Truth and smallest standard deviation of offsets, residual field in coil coordinates, and residual field as the sensor reads it.
fn offset_bounds(twin: &Twin, settings: &[Setting], noise: Noise, degc: f64) -> (Vec<f64>, Vec<f64>) {
    let residual = Vector3::from(twin.facility.residual[0].field_nt);
    let responses: Vec<Matrix3<f64>> = (1..=4).map(|p| response(twin, p, degc)).collect();
    let offset = twin.sensors[0].model.offset_ent(degc);
    // Offsets, residual field, then the rows of the response per component and position: only their own readings know them.
    let mut information = DMatrix::zeros(42, 42);
    for i in 0..3 {
        let reading_ent =
            |s: &Setting| (responses[s.position as usize - 1].row(i) * (Vector3::from(s.field.0) + residual))[0] + offset[i];
        let (rows, covariance) = parts(settings, noise, twin.sensors[0].flicker_lowest_hz, reading_ent);
        let lower = covariance.cholesky().unwrap().l();
        let design = DMatrix::from_fn(rows.len(), 42, |r, j| {
            let Setting { field: FieldCoil(b), position, .. } = rows[r].0;
            let p = position as usize - 1;
            match j {
                0..3 => f64::from(u8::from(j == i)),
                3..6 => responses[p][(i, j - 3)],
                _ if (j - 6) / 3 == 4 * i + p => b[(j - 6) % 3] + residual[(j - 6) % 3],
                _ => 0.0,
            }
        });
        let white = lower.solve_lower_triangular(&design).unwrap();
        information += white.transpose() * white;
    }
    let bound = information.try_inverse().unwrap();
    let truth_of = |x: &DVector<f64>| {
        let seen = |i: usize, p: usize| (0..3).map(|k| x[6 + 12 * i + 3 * p + k] * x[3 + k]).sum::<f64>();
        let half = |i: usize, (normal, turned): (usize, usize)| (seen(i, normal) - seen(i, turned)) / 2.0;
        let residual_ent = [half(0, (0, 1)), half(1, (0, 1)), half(2, (2, 3))];
        [x.rows(0, 6).iter().copied().collect::<Vec<f64>>(), residual_ent.to_vec()].concat()
    };
    let at = DVector::from_fn(42, |j, _| match j {
        0..3 => offset[j],
        3..6 => residual[j - 3],
        _ => responses[(j - 6) / 3 % 4][((j - 6) / 12, (j - 6) % 3)],
    });
    (truth_of(&at), carried(&bound, &at, &[1e-4; 42], truth_of))
}

fn of_offset(base: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let twin = drawn(base, noise, 1, &mut Random::new(seed, &["offset"]));
    let degc = twin.thermal_box.start_degc;
    let (result, settings) = simulated(&twin, seed, |run| {
        let (run, plateaus) = plateaus(&twin, noise, seed, run);
        (offset::offset(&run, &plateaus, &twin.campaign.instructions, &offset::Options::default()).unwrap(), run.settings)
    });
    let (truth, bounds) = offset_bounds(&twin, &settings, noise, degc);
    let p = &result;
    let names = [
        "offset_x",
        "offset_y",
        "offset_z",
        "residual_coil_x",
        "residual_coil_y",
        "residual_coil_z",
        "residual_x",
        "residual_y",
        "residual_z",
    ];
    let values = [p.values.offset_ent, p.values.residual_coil_nt, p.values.residual_ent].concat();
    let std = [p.values.offset_std_ent, p.values.residual_coil_std_nt, p.values.residual_std_ent].concat();
    estimates(&names, &values, &std, &truth, &bounds)
}

fn of_null(base: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let twin = drawn(base, noise, 3, &mut Random::new(seed, &["null"]));
    let degc = twin.thermal_box.start_degc;
    let (result, settings) = simulated(&twin, seed, |run| {
        let mut record = null::Record::default();
        let run = noise.play(run, twin.sensors[0].flicker_lowest_hz, seed, &mut record);
        (null::null(&run, record, &twin.campaign.instructions, &null::Options::default()).unwrap(), run.settings)
    });
    let residual = response(&twin, 1, degc) * Vector3::from(twin.facility.residual[0].field_nt);
    let offset = twin.sensors[0].model.offset_ent(degc);
    let (rows, mut covariance) = parts_of(&settings, NULL_PARTS, noise, twin.sensors[0].flicker_lowest_hz, |_| 0.0);
    // One setting has one error, which is the field.
    covariance.add_scalar_mut(-noise.scatter_nt.powi(2));
    let hours = |t: f64| (t - 0.5 * NULL_S) / 3600.0;
    let design = DMatrix::from_fn(rows.len(), 2, |r, c| if c == 0 { 1.0 } else { hours(rows[r].1) });
    let bound = smallest(&design, &covariance);
    let found = &result.found.offset;
    let values = [found.mean_ent.to_vec(), found.drift_ent_per_h[0].to_vec()].concat();
    let std = [found.mean_std_ent.to_vec(), found.drift_std_ent_per_h[0].to_vec()].concat();
    let truth: Vec<f64> = (0..6).map(|k| if k < 3 { offset[k] + residual[k] } else { 0.0 }).collect();
    let bounds: Vec<f64> = (0..6).map(|k| bound[(k / 3, k / 3)].sqrt()).collect();
    estimates(&["mean_x", "mean_y", "mean_z", "drift_x", "drift_y", "drift_z"], &values, &std, &truth, &bounds)
}

/// A linearity run with its calibration by itself.
struct Linear {
    run: Run,
    plateaus: Plateaus,
    lin: Lin,
}

impl Linear {
    fn of(run: &Run, plateaus: &Plateaus, instructions: &Instructions) -> Self {
        let lin = lin::lin(run, plateaus, instructions, &lin::Options::default()).unwrap();
        Self { run: run.clone(), plateaus: plateaus.clone(), lin }
    }
}

fn of_thermal(base: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let mut random = Random::new(seed, &["thermal"]);
    let mut drawn_once = drawn(base, noise, 0, &mut random);
    drawn_once.facility.residual[0].field_nt = [0.0; 3];
    let mut points: Vec<CalibratedRun> = Vec::new();
    let mut linear: Vec<Linear> = Vec::new();
    let mut bounds: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (index, degc) in TEMPERATURES_DEGC.into_iter().enumerate() {
        for programme in 0..3 {
            let mut twin = drawn_once.clone();
            twin.thermal_box.start_degc = degc;
            let run = &mut twin.runs[0];
            run.id = format!("26-03-{:02}_{programme:02}-00-00", index + 1);
            (run.programme, run.position) = (programme, (programme == 2).then_some(5));
            twin.sensors[0].flicker_lowest_hz = lowest_hz(&twin.programmes[programme], noise);
            let instructions = &twin.campaign.instructions;
            let seed = seed * 100 + 10 * index as u64 + programme as u64;
            simulated(&twin, seed, |run| match programme {
                0 => {
                    let (run, plateaus) = plateaus(&twin, noise, seed, run);
                    linear.push(Linear::of(&run, &plateaus, instructions));
                    let a = response(&twin, 1, degc);
                    let own = lin_bounds(&twin, &run.settings, noise, &a, twin.sensors[0].model.offset_ent(degc));
                    for (name, bound) in LIN_NAMES.iter().zip(own) {
                        bounds.entry((*name).to_owned()).or_default().push(bound);
                    }
                }
                1 => {
                    let (run, plateaus) = plateaus(&twin, noise, seed, run);
                    let result = offset::offset(&run, &plateaus, instructions, &offset::Options::default()).unwrap();
                    points.push((&result.parameters()).into());
                    let (_, own) = offset_bounds(&twin, &run.settings, noise, degc);
                    for (component, bound) in ["x", "y", "z"].into_iter().zip(own) {
                        bounds.entry(format!("b_off_{component}")).or_default().push(bound);
                    }
                }
                _ => {
                    let mut sines = Sines::default();
                    let run = noise.play(run, twin.sensors[0].flicker_lowest_hz, seed, &mut sines);
                    let result = freq::freq(&run, &sines, instructions, &freq::Options::default()).unwrap();
                    points.push((&result.parameters()).into());
                    for (i, component) in ["x", "y", "z"].into_iter().enumerate() {
                        let tones = Tones::of(&twin, noise, degc, i, |step| Some(step.duration_s * RATE_HZ));
                        bounds.entry(format!("f_3db_{component}")).or_default().push(tones.corner.1);
                    }
                }
            });
        }
    }
    let orders = [("sigma", 1), ("xi", 1), ("b_or", 2), ("b_off", 2), ("f_3db", 1)].map(|(n, o)| (n.to_owned(), o));
    let lins = moving::in_group(&linear, &orders, &drawn_once.campaign.instructions);
    points.extend(lins.iter().map(|lin| CalibratedRun::from(&lin.parameters())));
    let model = &drawn_once.sensors[0].model;
    let mut estimates = Vec::new();
    for group in groups(&points, &[], &orders) {
        for kind in Kind::ALL {
            let of_kind: Vec<&Lin> = if kind == Kind::Lin { lins.iter().collect() } else { Vec::new() };
            let result = thermal(&group, kind, &of_kind, false).unwrap();
            // The twin has the corner of the model as truth, not the one between neighbouring amplitudes.
            for curve in result.quantities.iter().filter(|curve| !curve.found.name.starts_with("f_3db_igep")) {
                let (family, component) = curve.found.name.rsplit_once('_').unwrap();
                let i = ["x", "y", "z"].iter().position(|c| *c == component);
                let i = i.or_else(|| ["xy", "xz", "yz"].iter().position(|c| *c == component)).unwrap();
                let truth = match family {
                    "sigma" => &model.sigma[i],
                    "xi" => &model.xi_deg[i],
                    "f_3db" => &model.f_3db_hz[i],
                    _ => &model.b_off_ent[i],
                };
                // The smallest variance with runs at their bounds.
                let least = bounds.get(&curve.found.name).map(|bounds| {
                    let design = DMatrix::from_fn(7, truth.len(), |r, c| TEMPERATURES_DEGC[r].powi(c as i32));
                    let covariance = DMatrix::from_diagonal(&DVector::from_iterator(7, bounds.iter().map(|b| b * b)));
                    smallest(&design, &covariance)
                });
                for (k, truth) in truth.iter().enumerate() {
                    estimates.push(Estimate {
                        name: format!("{} power {k}", curve.found.name),
                        value: curve.polynomial.coefficients[k],
                        std: curve.polynomial.covariance[(k, k)].sqrt(),
                        factor_95: curve.found.factor_95,
                        truth: *truth,
                        bound: least.as_ref().map_or(f64::NAN, |l| l[(k, k)].sqrt()),
                    });
                }
            }
        }
    }
    estimates
}
