//! Runs during which the temperature of the sensor moves: linearity runs whose slopes are found in the run itself, and continuous sweeps.

use super::{
    Estimate, LIN_NAMES, Linear, Noise, RATE_HZ, drawn, estimates, lin_bounds, plateaus, quantities, response, simulated,
};
use crate::repository;
use calfit::data::across::CalibratedRun;
use calfit::data::provenance::Input;
use calfit::files::twin::{self, Approach, Phase, Twin};
use calfit::fit::NORMAL_95;
use calfit::measure::lin::Lin;
use calfit::measure::thermal::{Kind, OfKind, groups, thermal};
use calfit::measure::{lin, sweep};
use calfit::model::campaign::Instructions;
use calfit::model::polynomial::value;
use calfit::model::sensor_polynomials::SensorPolynomials;
use calfit::simulate::noise::Random;
use calfit::workflow::RunResult;
use nalgebra::Vector3;

/// Target and rate of the box while a linearity run lasts, °C and K/h.
const COOLING: (f64, f64) = (-60.0, 30.0);
/// Largest slopes of sensitivities and angles, per K: those of a sensor in open loop.
const SLOPES: [f64; 2] = [5e-4, 1e-3];
/// Quantities of a linear calibration that are compared: sensitivities and angles.
const COMPARED: usize = 6;
/// Sample rate of sweeps, Hz.
const SWEEP_RATE_HZ: f64 = 4.0;
/// Temperatures at which the polynomials of a sweep are compared, °C.
const AT_DEGC: [f64; 4] = [0.0, 40.0, 80.0, 120.0];

/// The twin of the demonstration without anything that is not sensor, temperature or noise.
pub(super) fn demo() -> Twin {
    let path = repository("configs/demo.toml");
    let mut twin = twin::read(&path, &mut Vec::new()).unwrap_or_else(|e| panic!("{e}"));
    let facility = &mut twin.facility;
    (facility.setting_scatter_nt, facility.daily_nt, facility.irregular_nt) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    twin.thermal_box.heater = None;
    twin.thermistors.truncate(1);
    twin.sensors[0].packet_loss = 0.0;
    twin.sensors[0].rotation_per_k_deg = [0.0; 3];
    twin
}

pub(super) fn of_moving(base: &Twin, demo: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let mut random = Random::new(seed, &["lin moving"]);
    let mut twin = drawn(base, noise, 0, &mut random);
    let mut slope = |largest: f64| largest * (2.0 * random.uniform() - 1.0);
    for i in 0..3 {
        twin.sensors[0].model.sigma[i][1] = slope(SLOPES[0]);
        twin.sensors[0].model.xi_deg[i][1] = slope(SLOPES[1]);
    }
    twin.thermistors[0].noise_k = demo.thermistors[0].noise_k;
    let from = demo.thermal_box.phases[0].from;
    let (target_degc, k_per_h) = COOLING;
    twin.thermal_box.phases = vec![Phase { from, target_degc, approach: Approach::Rate(k_per_h) }];
    twin.runs[0].start = from;
    let (result, settings) = simulated(&twin, seed, |run| {
        let (run, plateaus) = plateaus(&twin, noise, seed, run);
        (lin::lin(&run, &plateaus, &twin.campaign.instructions, &lin::Options::default()).unwrap(), run.settings)
    });
    let p = &result.calibration;
    let a = response(&twin, 1, p.run.temperature_degc.unwrap());
    let truth = quantities(&a, &twin.places[&1].0.r_nom(), [0.0; 3]);
    let bounds = lin_bounds(&twin, &settings, noise, &a, [0.0; 3]);
    let angles = &p.angle_deg;
    let values = [p.matrix.sigma[0][0], p.matrix.sigma[1][1], p.matrix.sigma[2][2], angles.xi_xy, angles.xi_xz, angles.xi_yz];
    let std = [p.std.sigma, p.std.xi_deg].concat();
    estimates(&LIN_NAMES[..COMPARED], &values, &std, &truth[..COMPARED], &bounds[..COMPARED])
}

/// Linear calibrations of a thermal group made with its polynomials, and with the noise that its runs show together, as `thermal` makes them.
pub(super) fn in_group(linear: &[Linear], orders: &[(String, usize)], instructions: &Instructions) -> Vec<Lin> {
    let points: Vec<CalibratedRun> = linear.iter().map(|own| CalibratedRun::from(&own.lin.parameters())).collect();
    let lins: Vec<&Lin> = linear.iter().map(|own| &own.lin).collect();
    let group = groups(&points, &[], orders).into_iter().next().unwrap();
    let result = thermal(&group, Kind::Lin, &lins, false).unwrap();
    let OfKind::Lin(across) = &result.of_kind else { unreachable!("a group of linear calibrations") };
    let three =
        |names: [&str; 3]| names.map(|name| result.quantities.iter().find(|q| q.found.name == name).unwrap().polynomial.clone());
    let polynomials = SensorPolynomials {
        input: Input::default(),
        sensor: linear[0].run.header.sensor.clone(),
        mode: linear[0].run.header.mode.clone(),
        channel: None,
        lag: None,
        valid_degc: result.valid_degc,
        sigma: three(["sigma_x", "sigma_y", "sigma_z"]),
        xi_deg: three(["xi_xy", "xi_xz", "xi_yz"]),
        b_or_ent: three(["b_or_x", "b_or_y", "b_or_z"]),
        without_slope: None,
        noise: across.noise.clone(),
    };
    let options = lin::Options { temperature: Some(polynomials), ..lin::Options::default() };
    linear.iter().map(|own| lin::lin(&own.run, &own.plateaus, instructions, &options).unwrap()).collect()
}

pub(super) fn of_sweep(demo: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let mut base = demo.clone();
    let run = base.runs.iter().find(|run| base.programmes[run.programme].name.starts_with("RANDOM")).unwrap().clone();
    base.programmes = vec![base.programmes[run.programme].clone()];
    base.runs = vec![run];
    let noise = Noise { rate_hz: SWEEP_RATE_HZ, ..noise };
    let mut twin = drawn(&base, noise, 0, &mut Random::new(seed, &["sweep"]));
    twin.runs[0].nominal_rate_hz = Some(SWEEP_RATE_HZ);
    twin.sensors[0].rate_hz = RATE_HZ;
    let result = simulated(&twin, seed, |run| {
        let (run, plateaus) = plateaus(&twin, noise, seed, run);
        sweep::sweep(&run, &plateaus, &twin.campaign.instructions, &sweep::Options::default()).unwrap()
    });
    let residual = Vector3::from(twin.facility.residual[0].field_nt);
    let model = &twin.sensors[0].model;
    let truth = |k: usize, degc: f64| match k {
        0..3 => value(&model.sigma[k], degc),
        3..6 => value(&model.xi_deg[k - 3], degc),
        _ => model.offset_ent(degc)[k - 6] + (response(&twin, 1, degc) * residual)[k - 6],
    };
    let estimate = |(k, degc): (usize, f64)| {
        let (found, std) = result.quantities[k].polynomial.evaluate(degc);
        let name = result.quantities[k].found.name.clone();
        Estimate { name, value: found, std, factor_95: NORMAL_95, truth: truth(k, degc), bound: f64::NAN }
    };
    (0..9).flat_map(|k| AT_DEGC.map(|degc| (k, degc))).map(estimate).collect()
}
