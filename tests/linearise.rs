//! `calfit lin --linearise`: polynomials that were put into readings come back, with intervals that hold them; a published run gives what
//! an independent calculation gives; what runs do not determine is refused.

use crate::common;

use calfit::data::plateau::{self, Plateau, Plateaus};
use calfit::data::run::{Run, Setting};
use calfit::data::units::{FieldCoil, Reading};
use calfit::files::campaign::Campaign;
use calfit::files::ccr;
use calfit::measure::lin::{Lin, Options, lin};
use calfit::measure::linearise::{Estimate, LineariseError, Linearised, linearise};
use calfit::workflow::RunResult;
use common::Gauss;
use common::check::{Case, calfit, cpf, number, parameters, process, says, text, three, tree};
use std::fmt::Write;
use std::path::{Path, PathBuf};

type Three = [f64; 3];

/// Polynomials as large as those of a converter: 2 to 4 nT at 60 000 nT.
const C2: Three = [6e-10, -9e-10, 3e-10];
const C3: Three = [-1.2e-14, 4e-15, 1.5e-14];
const NOISE_ENT: f64 = 0.1;

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A sensor whose readings are those of the linear model after the inverse of a polynomial, found by halving intervals.
#[derive(Clone)]
struct Sensor {
    /// enT per nT.
    response: [Three; 3],
    offset_ent: Three,
    c2: Three,
    c3: Three,
    /// Response of x to the square of the Y field, enT/nT².
    transverse: f64,
}

impl Sensor {
    fn with_offset(offset_ent: Three) -> Self {
        let response = [[1.0012, 0.011, -0.004], [-0.012, 0.9975, 0.006], [0.003, -0.007, 1.0007]];
        Self { response, offset_ent, c2: C2, c3: C3, transverse: 0.0 }
    }

    /// σ of a component: the inverse length of its row.
    fn sigma(&self, component: usize) -> f64 {
        self.response[component].iter().map(|a| a * a).sum::<f64>().sqrt().recip()
    }

    fn reading(&self, field: Three) -> Three {
        std::array::from_fn(|i| {
            let mut wanted = self.offset_ent[i] + (0..3).map(|j| self.response[i][j] * field[j]).sum::<f64>();
            if i == 0 {
                wanted += self.transverse * field[1] * field[1];
            }
            let reach = 1e3 + 0.3 * wanted.abs();
            let (mut low, mut high) = (wanted - reach, wanted + reach);
            for _ in 0..100 {
                let r = 0.5 * (low + high);
                if r + self.c2[i] * r * r + self.c3[i] * r * r * r < wanted {
                    low = r;
                } else {
                    high = r;
                }
            }
            0.5 * (low + high)
        })
    }
}

/// Random directions, magnitudes from 10 to 60 µT.
fn sphere(count: usize, gauss: &mut Gauss) -> Vec<Three> {
    let one = |_| {
        let v = [gauss.normal(), gauss.normal(), gauss.normal()];
        let size = (35_000.0 + 25_000.0 * gauss.uniform()) / v.iter().map(|v| v * v).sum::<f64>().sqrt();
        v.map(|v| v * size)
    };
    (0..count).map(one).collect()
}

/// Steps along one axis after the other.
fn axis_by_axis(steps: &[f64]) -> Vec<Three> {
    let along = |axis: usize| steps.iter().map(move |s| std::array::from_fn(|i| if i == axis { *s } else { 0.0 }));
    (0..3).flat_map(along).collect()
}

fn plateaus(sensor: &Sensor, fields: &[Three], noise_ent: f64, gauss: &mut Gauss) -> Plateaus {
    let plateau = |(index, field): (usize, &Three)| {
        let t = index as f64 * 25.0;
        Plateau {
            index,
            setting: Setting { t_start_s: t, t_end_s: t + 24.0, field: FieldCoil(*field), frequency_hz: 0.0, position: 1 },
            used_s: [t, t + 24.0],
            mean: Reading(sensor.reading(*field).map(|r| r + noise_ent * gauss.normal())),
            std_ent: None,
            count: None,
            spike_samples: 0,
            dropped: None,
            contrasts: Vec::new(),
        }
    };
    Plateaus { list: fields.iter().enumerate().map(plateau).collect(), ..plateau::from_blocks(&[]) }
}

/// The published run lends its header, with an id of its own.
fn header(number: usize) -> Run {
    let mut run = ccr::read(&repository("runs/champ-1998/98-03-23/00-00-04.CCR"), &ccr::Options::default(), &mut ()).unwrap();
    run.header.run = format!("98-03-23_00-00-{number:02}");
    run
}

/// Its campaign has the position of these runs.
fn its_campaign() -> Campaign {
    Campaign::open(&[repository("runs/champ-1998")], &mut Vec::new()).unwrap().remove(0)
}

fn constant_offset() -> Options {
    Options { trend_order: Some(0), ..Options::default() }
}

/// Fits runs of some sensors with their fields without a linearisation.
fn first_fits(made: &[(Sensor, Vec<Three>)], noise_ent: f64, gauss: &mut Gauss) -> Vec<Lin> {
    let campaign = its_campaign();
    let fit = |(k, (sensor, fields)): (usize, &(Sensor, Vec<Three>))| {
        lin(&header(k + 1), &plateaus(sensor, fields, noise_ent, gauss), &campaign.file.instructions, &constant_offset()).unwrap()
    };
    made.iter().enumerate().map(fit).collect()
}

/// Fits the same runs with it.
fn second_fits(first: &[Lin], estimate: &Estimate) -> Vec<Lin> {
    let options = Options { linearisation: Some(estimate.linearisation.clone()), ..constant_offset() };
    let campaign = its_campaign();
    let fit = |(k, l): (usize, &Lin)| lin(&header(k + 1), &l.given, &campaign.file.instructions, &options).unwrap();
    first.iter().enumerate().map(fit).collect()
}

fn complete(first: &[Lin], estimate: Estimate) -> (Linearised, Vec<Lin>) {
    let second = second_fits(first, &estimate);
    let result = estimate.complete(&first.iter().collect::<Vec<_>>(), &second.iter().map(Some).collect::<Vec<_>>());
    (result, second)
}

/// Three runs with different offsets and fields.
fn three_runs(count: usize, gauss: &mut Gauss) -> Vec<(Sensor, Vec<Three>)> {
    [[-165.0, -157.0, -77.0], [900.0, 400.0, -2500.0], [20.0, -3000.0, 5.0]]
        .into_iter()
        .map(|offset| (Sensor::with_offset(offset), sphere(count, gauss)))
        .collect()
}

#[test]
fn readings_without_noise_give_the_polynomials_and_the_linear_parameters_of_every_run() {
    let mut gauss = Gauss(1);
    let made = three_runs(60, &mut gauss);
    let first = first_fits(&made, 0.0, &mut gauss);
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    let part = &estimate.linearisation.part;
    for a in 0..3 {
        // The readings are rounded to 7e-12 enT; four orders more are still a millionth of the noise of a real one.
        assert!((part.c2_per_ent[a] - C2[a]).abs() * 6e4_f64.powi(2) < 1e-7, "{:?}", part.c2_per_ent);
        assert!((part.c3_per_ent2[a] - C3[a]).abs() * 6e4_f64.powi(3) < 1e-7, "{:?}", part.c3_per_ent2);
    }
    for ((sensor, _), after) in made.iter().zip(second_fits(&first, &estimate)) {
        let p = &after.calibration;
        for i in 0..3 {
            assert!((p.matrix.sigma[i][i] - sensor.sigma(i)).abs() < 1e-11);
            assert!((p.offset.b_or_ent[i] - sensor.offset_ent[i]).abs() < 1e-6);
        }
        assert!(after.parameters().convention.model.contains("linearised reading"));
        assert_eq!(after.linearisation.as_ref().unwrap().applied, *part);
    }
}

/// Four runs whose sensor warms by 1.5 K while the axes are driven one after the other, with sensitivities that follow it by 2e-5 per kelvin: slopes that
/// are found without a polynomial take most of its cube. Readings as they were measured, with the slopes beside it, give it back.
#[test]
fn a_temperature_that_moves_takes_nothing_of_the_polynomials() {
    let (c2, c3) = ([3e-8, 0.0, -5e-8], [2e-11, -4e-11, 0.0]);
    let fields = axis_by_axis(&[500.0, -500.0, 1000.0, -1000.0, 2000.0, -2000.0, 1500.0, -1500.0]);
    let last = fields.len() as f64 - 1.0;
    let campaign = its_campaign();
    let mut gauss = Gauss(12);
    let fit = |k: usize| {
        let base = Sensor { c2, c3, ..Sensor::with_offset([10.0, -5.0, 3.0]) };
        // Ever more slowly, with an offset that follows it by 0.1 enT per kelvin.
        let over_k = |i: usize| 1.5 * (0.5 - (-3.0 * i as f64 / last).exp());
        let mut made = plateaus(&base, &fields, 0.0, &mut Gauss(1));
        for (i, p) in made.list.iter_mut().enumerate() {
            let warm = Sensor { response: base.response.map(|row| row.map(|a| a * (1.0 + 2e-5 * over_k(i)))), ..base.clone() };
            p.mean = Reading(warm.reading(fields[i]).map(|r| r + 0.1 * over_k(i) + 0.01 * gauss.normal()));
        }
        let mut run = header(k);
        let degc = |i: usize| 20.0 + over_k(i);
        run.temperatures.t_s = (0..fields.len()).map(|i| 25.0 * i as f64 + 12.0).collect();
        run.temperatures.values = vec![(0..fields.len()).map(degc).collect(); run.temperatures.names.len()];
        lin(&run, &made, &campaign.file.instructions, &constant_offset()).unwrap()
    };
    let first: Vec<Lin> = (1..=4).map(fit).collect();
    assert!(first.iter().all(|l| l.with_temperature.is_some()));
    let part = linearise(&first.iter().collect::<Vec<_>>()).unwrap().linearisation.part;
    for a in 0..3 {
        assert!((part.c2_per_ent[a] - c2[a]).abs() < 4.0 * part.c2_std_per_ent[a], "{part:?}");
        assert!((part.c3_per_ent2[a] - c3[a]).abs() < 4.0 * part.c3_std_per_ent2[a], "{part:?}");
    }
    // The cube of y shows.
    assert!(part.c3_per_ent2[1].abs() > 5.0 * part.c3_std_per_ent2[1], "{part:?}");
}

#[test]
fn intervals_of_polynomials_and_of_what_rests_on_them_hold_the_truth_in_95_percent_of_made_campaigns() {
    // Student's t for 106 degrees of freedom (120 plateaus, 12 own parameters, 2 shared ones) and for 36, from the table.
    const T_106: f64 = 1.983;
    const T_36: f64 = 2.028;
    let campaigns = 100;
    let (mut coefficients, mut linear, mut farthest) = (0, 0, 0.0_f64);
    for seed in 0..campaigns {
        let mut gauss = Gauss(1000 + seed);
        let made = three_runs(40, &mut gauss);
        let first = first_fits(&made, NOISE_ENT, &mut gauss);
        let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
        let part = &estimate.linearisation.part;
        for a in 0..3 {
            for z in
                [(part.c2_per_ent[a] - C2[a]) / part.c2_std_per_ent[a], (part.c3_per_ent2[a] - C3[a]) / part.c3_std_per_ent2[a]]
            {
                coefficients += usize::from(z.abs() < T_106);
                farthest = farthest.max(z.abs());
            }
        }
        for ((sensor, _), after) in made.iter().zip(second_fits(&first, &estimate)) {
            let p = &after.calibration;
            for i in 0..3 {
                linear += usize::from((p.matrix.sigma[i][i] - sensor.sigma(i)).abs() < T_36 * p.std.sigma[i]);
                linear += usize::from((p.offset.b_or_ent[i] - sensor.offset_ent[i]).abs() < T_36 * p.std.b_or_ent[i]);
            }
        }
    }
    let share = |held: usize, of: u64| held as f64 / of as f64;
    let (coefficients, linear) = (share(coefficients, 6 * campaigns), share(linear, 18 * campaigns));
    println!("intervals of 95 %: {:.1} % of polynomials, {:.1} % of linear parameters", 100.0 * coefficients, 100.0 * linear);
    // 600 intervals: three standard errors are 2.7 %. Slow noise that is not there makes intervals wider, of offsets by far.
    assert!((0.923..=0.99).contains(&coefficients), "{coefficients}");
    assert!(linear >= 0.923, "{linear}");
    // The farthest of 600 values of Student's distribution is beyond 5 once in 700 such tests.
    assert!(farthest < 5.0, "{farthest}");
}

#[test]
fn one_campaign_is_within_three_standard_deviations_and_the_residuals_fall_to_the_noise() {
    let mut gauss = Gauss(42);
    let made = three_runs(60, &mut gauss);
    let first = first_fits(&made, NOISE_ENT, &mut gauss);
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    let (result, _) = complete(&first, estimate);
    let p = &result.shared;
    for a in 0..3 {
        let c = &p.polynomials;
        assert!((c.c2_per_ent[a] - C2[a]).abs() < 3.0 * c.c2_std_per_ent[a]);
        assert!((c.c3_per_ent2[a] - C3[a]).abs() < 3.0 * c.c3_std_per_ent2[a]);
        assert!(p.axis[a].significant && p.axis[a].degrees_of_freedom == 166 && p.axis[a].between_degrees_of_freedom == 4);
        // Matrix and vectors say the same.
        assert!((p.covariance.matrix[2 * a][2 * a].sqrt() / c.c2_std_per_ent[a] - 1.0).abs() < 1e-12);
    }
    assert_eq!(p.used.len(), 3);
    for run in &p.run {
        for a in 0..3 {
            // 60 plateaus with 4 own parameters: the standard deviation is 0.097 and known to a tenth of itself, 3 of those.
            assert!((run.residual_std_after_nt[a] - 0.097).abs() < 0.03, "{run:?}");
            assert!(run.residual_std_before_nt[a] > 2.0 * run.residual_std_after_nt[a], "{run:?}");
        }
    }
    // Six panels across: no effect was made. The chance that one of six is below 1e-4 is 6e-4.
    for panel in &p.panel {
        let fit = panel.fitted.unwrap();
        assert_eq!(panel.on_axis, panel.sensor_axis.eq_ignore_ascii_case(&panel.coil_axis));
        assert!(if panel.on_axis { fit.probability < 1e-6 } else { fit.probability > 1e-4 }, "{panel:?}");
    }
    for data in &result.panels {
        assert_eq!(data.points.len(), 180, "directions are spread: every setting is shown");
        assert_eq!(data.after.iter().map(|b| b.count).sum::<usize>(), 180);
    }
}

#[test]
fn a_transverse_effect_is_found_in_its_panel_and_leaves_the_polynomial_alone() {
    let mut gauss = Gauss(7);
    // 1.8 nT at 60 000 nT.
    let transverse = 5e-10;
    let runs: Vec<(Sensor, Vec<Three>)> = three_runs(60, &mut gauss)
        .into_iter()
        .map(|(sensor, fields)| (Sensor { transverse, c2: [0.0; 3], c3: [0.0; 3], ..sensor }, fields))
        .collect();
    let first = first_fits(&runs, NOISE_ENT, &mut gauss);
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    let (result, _) = complete(&first, estimate);
    let panel = &result.shared.panel[1];
    assert_eq!((panel.sensor_axis.as_str(), panel.coil_axis.as_str()), ("x", "Y"));
    let fit = panel.fitted.unwrap();
    // Applied minus modelled field is too small where the reading is too large.
    let wanted = -transverse * runs[0].0.sigma(0);
    assert!((fit.quadratic_per_nt - wanted).abs() < 3.0 * fit.quadratic_std_per_nt, "{fit:?}, truth {wanted}");
    assert!(fit.cubic_per_nt2.abs() < 3.0 * fit.cubic_std_per_nt2, "{fit:?}");
    assert!(fit.probability < 1e-6);
    let others = [(1, 0), (1, 2), (2, 0), (2, 1)].map(|(i, j)| result.shared.panel[3 * i + j].fitted.unwrap().probability);
    assert!(others.into_iter().all(|p| p > 1e-4), "{others:?}");
}

#[test]
fn programmes_along_the_axes_are_shown_axis_by_axis() {
    let mut gauss = Gauss(3);
    let fields = axis_by_axis(&[0.0, 5e4, -5e4, 2.5e4, -2.5e4, 4e4, -4e4, 1e4, -1e4, 0.0]);
    let first = first_fits(&[(Sensor::with_offset([10.0, -20.0, 5.0]), fields)], NOISE_ENT, &mut gauss);
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    let (result, _) = complete(&first, estimate);
    for (i, data) in result.panels.iter().enumerate() {
        // Eight settings along the axis and two of zero for each of three axes.
        assert_eq!(data.points.len(), 14);
        assert!(data.points.iter().filter(|p| p[0] == 0.0).count() == 6, "panel {i}");
    }
    let c = &result.shared.polynomials;
    for a in 0..3 {
        assert!((c.c2_per_ent[a] - C2[a]).abs() < 3.5 * c.c2_std_per_ent[a]);
        assert!((c.c3_per_ent2[a] - C3[a]).abs() < 3.5 * c.c3_std_per_ent2[a]);
    }
}

#[test]
fn three_fields_per_axis_are_refused_alone_and_taken_with_a_run_that_has_more() {
    let mut gauss = Gauss(5);
    let straight =
        |offset| Sensor { response: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..Sensor::with_offset(offset) };
    let few = (straight([10.0, 20.0, 30.0]), axis_by_axis(&[0.0, 5e4, -5e4, 0.0, 5e4, -5e4]));
    let first = first_fits(std::slice::from_ref(&few), NOISE_ENT, &mut gauss);
    // Every component is refused; the first one is named whichever thread is the first.
    for _ in 0..50 {
        let error = linearise(&first.iter().collect::<Vec<_>>()).unwrap_err();
        assert!(matches!(&error, LineariseError::Undetermined { component: "x", .. }), "{error}");
        says(&format!("{error}; {}", error.remedy()), &["do not determine", "the cube", "at least four different fields"]);
    }

    let first = first_fits(&[few, (straight([-500.0, 0.0, 0.0]), sphere(60, &mut gauss))], NOISE_ENT, &mut gauss);
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    for a in 0..3 {
        let c = &estimate.linearisation.part;
        assert!((c.c2_per_ent[a] - C2[a]).abs() < 3.5 * c.c2_std_per_ent[a]);
    }
}

#[test]
fn a_small_range_shows_nothing_and_says_so() {
    let mut gauss = Gauss(8);
    // At 2000 nT the square is 4e-3 nT, the cube 1e-4 nT, the noise 0.1 nT.
    let fields = axis_by_axis(&[0.0, 2e3, -2e3, 1e3, -1e3, 1.5e3, -1.5e3, 5e2, -5e2, 0.0]);
    let first = first_fits(&[(Sensor::with_offset([0.0; 3]), fields)], NOISE_ENT, &mut gauss);
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    let (result, second) = complete(&first, estimate);
    let p = &result.shared;
    assert!(p.axis.iter().all(|a| !a.significant), "{:?}", p.axis);
    says(&result.notes.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"), &["x, y, z", "not significant"]);
    // The range is stated, and the sensitivity pays for the cube.
    assert!(p.polynomials.reading_ent.iter().all(|[low, high]| *low < -1990.0 && *high < 2010.0));
    for a in 0..3 {
        assert!(second[0].calibration.std.sigma[a] > 1.3 * first[0].calibration.std.sigma[a]);
    }
}

#[test]
fn too_short_runs_and_polynomials_that_turn_back_are_refused() {
    let mut gauss = Gauss(9);
    let short: Vec<Three> = sphere(6, &mut gauss);
    let first = first_fits(&[(Sensor::with_offset([0.0; 3]), short)], NOISE_ENT, &mut gauss);
    assert_eq!(linearise(&first.iter().collect::<Vec<_>>()).unwrap_err(), LineariseError::NoRuns);
    assert_eq!(linearise(&[]).unwrap_err(), LineariseError::NoRuns);
    // The slope 1 - 1.5e-10 r² is 0.46 at 60 000 enT.
    let bent = Sensor { c3: [0.0, 0.0, -5e-11], ..Sensor::with_offset([0.0; 3]) };
    let fields = axis_by_axis(&[0.0, 5e4, -5e4, 2.5e4, -2.5e4, 4e4, -4e4, 1e4, -1e4, 0.0]);
    let first = first_fits(&[(bent, fields)], NOISE_ENT, &mut gauss);
    assert_eq!(linearise(&first.iter().collect::<Vec<_>>()).unwrap_err(), LineariseError::NotMonotone { component: "z" });
}

#[test]
fn champ_run_04_gives_what_an_independent_calculation_gives() {
    let path = repository("runs/champ-1998/98-03-23/00-00-04.CCR");
    let run = ccr::read(&path, &ccr::Options::default(), &mut ()).unwrap();
    let campaign = Campaign::open(&[path], &mut Vec::new()).unwrap().remove(0);
    let first = vec![lin(&run, &plateau::from_blocks(&run.blocks), &campaign.file.instructions, &Options::default()).unwrap()];
    let estimate = linearise(&first.iter().collect::<Vec<_>>()).unwrap();
    // Gauss-Newton in numpy: coefficients, standard deviations for independent noise of 74 degrees of freedom, and that noise, enT.
    let c2 = [5.050314014255466e-11, 9.308327191199887e-12, -3.008700455783988e-11];
    let c3 = [-1.1140728512312202e-15, 1.3567887710224165e-15, -5.078194989402034e-16];
    let c2_std = [1.6472945045126156e-11, 1.304105657780239e-11, 1.4213281482764792e-11];
    let c3_std = [5.448404008878606e-16, 4.343224831820165e-16, 4.644581088523955e-16];
    let noise_ent = [0.15830224891392455, 0.12564504152942393, 0.1403327003561601];
    let (result, _) = complete(&first, estimate);
    let p = &result.shared;
    for a in 0..3 {
        let c = &p.polynomials;
        assert!((c.c2_per_ent[a] / c2[a] - 1.0).abs() < 1e-6, "{:?}", c.c2_per_ent);
        assert!((c.c3_per_ent2[a] / c3[a] - 1.0).abs() < 1e-6, "{:?}", c.c3_per_ent2);
        // Slow noise only adds; for the slowest columns it is known to double white uncertainties.
        for (std, white) in [(c.c2_std_per_ent[a], c2_std[a]), (c.c3_std_per_ent2[a], c3_std[a])] {
            assert!(std > 0.999 * white && std < 2.4 * white, "{std} beside {white}");
        }
        let sigma = [0.9989426, 1.001764, 0.9993179][a];
        let left = sigma * noise_ent[a] * (74.0_f64 / 80.0).sqrt();
        assert!((p.run[0].residual_std_after_nt[a] / left - 1.0).abs() < 1e-4);
    }
    // CH-GFZ-TR-2601 prints residuals of linearised readings: what is left is a few tenths of nT at most, section 7.
    assert!(p.axis.iter().all(|a| a.largest_correction_ent < 0.6), "{:?}", p.axis);
}

/// A run file of plateau means.
fn file(number: usize, sensor_name: &str, sensor: &Sensor, fields: &[Three], noise_ent: f64, gauss: &mut Gauss) -> String {
    let mut out = format!(
        "CCR 1\nrun = \"13-04-03_10-00-{number:02}\"\nstart = \"2013-04-03T10:00:{number:02}Z\"\nkind = \"linearity\"\n\
         configuration = \"TEST\"\nsensor = \"{sensor_name}\"\nmode = \"normal\"\nsample_rate = 1.0\nunit = \"enT\"\n@BLOCKS\n\
         t_start,t_end,bx,by,bz,position,x,y,z\n"
    );
    for (i, [bx, by, bz]) in fields.iter().enumerate() {
        let [x, y, z] = sensor.reading([*bx, *by, *bz]).map(|r| r + noise_ent * gauss.normal());
        writeln!(out, "{},{},{bx},{by},{bz},1,{x},{y},{z}", 40 * i, 40 * i + 40).unwrap();
    }
    out + "@END\n"
}

fn name(number: usize) -> String {
    format!("13-04-03/10-00-{number:02}.CCR")
}

/// Two runs of one sensor, one of another.
fn campaign(gauss: &mut Gauss) -> Case {
    let case = Case::new();
    case.put("campaign.toml", "offset_trend_order = 0\n");
    for (number, sensor_name, offset) in
        [(1, "A", [-165.0, -157.0, -77.0]), (2, "A", [900.0, 400.0, -2500.0]), (3, "B", [0.0; 3])]
    {
        let fields = sphere(50, gauss);
        case.put(&name(number), file(number, sensor_name, &Sensor::with_offset(offset), &fields, NOISE_ENT, gauss));
    }
    case
}

#[test]
fn the_command_writes_a_file_per_sensor_that_the_runs_name_and_verify_repeats() {
    let mut gauss = Gauss(21);
    let case = campaign(&mut gauss);
    let output = case.lin(&["--linearise", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let listing: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(listing["linearisation"].as_array().unwrap().len(), 2);
    let of_a = "LINEARISATION__13-04-03_10-00-01.toml";
    let files = tree(&case.out());
    for wanted in [
        of_a,
        "LINEARISATION__13-04-03_10-00-03.toml",
        "REPORT_LINEARISATION__13-04-03_10-00-01.md",
        "LINEARISATION_residuals_coil_x__13-04-03_10-00-01.png",
        "LINEARISATION_residuals_coil_y__13-04-03_10-00-01.png",
        "LINEARISATION_residuals_coil_z__13-04-03_10-00-01.png",
    ] {
        assert!(files.contains_key(wanted), "no {wanted} in {:?}", files.keys());
    }
    let a = parameters(&case.out().join(of_a));
    assert_eq!(a["used"].as_array().unwrap().len(), 2);
    let one = cpf(&case.out(), "13-04-03_10-00-02");
    assert_eq!(one["linearisation"]["file"].as_str(), Some(of_a));
    assert_eq!(three(&one, "linearisation.applied.c2_per_ent"), three(&a, "linearisation.c2_per_ent"));
    // What is exported of a run holds for readings that only these coefficients linearise.
    let path = case.out().join("13-04-03_10-00-02/PARAMETER_LIN__13-04-03_10-00-02.CPF");
    let out = case.path().join("exported");
    let export = calfit().args(["export", "--format", "csv", "-o"]).arg(&out).arg(path).output().unwrap();
    assert_eq!(export.status.code(), Some(0), "{}", text(&export.stderr));
    let table = std::fs::read_to_string(out.join("PARAMETER_LIN__13-04-03_10-00-02.CPF.csv")).unwrap();
    let (c2, c3) = (three(&a, "linearisation.c2_per_ent"), three(&a, "linearisation.c3_per_ent2"));
    says(&table, &[&format!("\nlinearisation_c2,z,{:?},", c2[2]), &format!("\nlinearisation_c3,x,{:?},", c3[0])]);
    let report = text(&files["REPORT_LINEARISATION__13-04-03_10-00-01.md"]);
    says(&report, &["13-04-03_10-00-02", "| x | X (along it) |", "| z | Y |", "c2, 1/enT"]);
    says(&text(&files["13-04-03_10-00-02/REPORT_LIN__13-04-03_10-00-02.md"]), &["linearised with", of_a]);

    let verified = calfit().args(["verify"]).arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}{}", text(&verified.stdout), text(&verified.stderr));
    assert_eq!(text(&verified.stdout).matches("verified").count(), 5);
    let checked = calfit().arg("check").arg(case.out().join(of_a)).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));

    // The same polynomials from the file give the same run.
    let other = tempfile::tempdir().unwrap();
    let again = calfit()
        .args(["lin", "--no-plots", "--linearisation"])
        .arg(case.out().join(of_a))
        .arg(case.campaign().join(name(2)))
        .arg("-o")
        .arg(other.path())
        .output()
        .unwrap();
    assert_eq!(again.status.code(), Some(0), "{}", text(&again.stderr));
    assert_eq!(common::check::numbers(&cpf(other.path(), "13-04-03_10-00-02")), common::check::numbers(&one));
}

#[test]
fn results_do_not_depend_on_threads() {
    let mut gauss = Gauss(22);
    let case = campaign(&mut gauss);
    let with = |threads: &str| {
        let mut command = process();
        command.arg("lin").arg(case.campaign()).arg("-o").arg(case.out());
        let output = command.args(["--linearise", "--no-plots", "--threads", threads]).output().unwrap();
        assert_eq!(output.status.code(), Some(0));
        tree(&case.out())
    };
    assert!(with("1") == with("4"), "other bytes with other threads");
}

#[test]
fn other_runs_are_told_from_those_the_polynomials_were_made_for() {
    let mut gauss = Gauss(23);
    let case = campaign(&mut gauss);
    assert_eq!(case.lin(&["--linearise", "--no-plots"]).status.code(), Some(0));
    let of_a = case.out().join("LINEARISATION__13-04-03_10-00-01.toml");
    let far: Vec<Three> = sphere(50, &mut gauss).into_iter().map(|f| f.map(|b| 1.5 * b)).collect();
    let sensor = Sensor::with_offset([0.0; 3]);
    let run = case.put(&name(9), file(9, "C", &sensor, &far, NOISE_ENT, &mut gauss));
    let apply = |linearisation: &Path| {
        let mut command = calfit();
        command.args(["lin", "--no-plots", "--linearisation"]).arg(linearisation).arg(&run).arg("-o").arg(case.out());
        command.output().unwrap()
    };
    let output = apply(&of_a);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["was made with A normal, the run is of C normal", "beyond the range of LINEARISATION__"]);

    // A file that was changed, and one of another kind.
    let changed = case.path().join("changed.toml");
    let original = std::fs::read_to_string(&of_a).unwrap();
    std::fs::write(&changed, original.replacen("c2_per_ent = [", "c2_per_ent = [1.0, ", 1)).unwrap();
    let output = apply(&changed);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["changed.toml", "was changed after it was written"]);
    let output = apply(&case.out().join("13-04-03_10-00-02/PARAMETER_LIN__13-04-03_10-00-02.CPF"));
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["holds format CPF, not LINEARISATION"]);
}

#[test]
fn what_cannot_be_linearised_leaves_no_file_and_does_not_stop_the_others() {
    let mut gauss = Gauss(24);
    let case = campaign(&mut gauss);
    let straight = Sensor { response: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..Sensor::with_offset([3.0; 3]) };
    let few = axis_by_axis(&[0.0, 5e4, -5e4, 0.0, 5e4, -5e4]);
    case.put(&name(4), file(4, "D", &straight, &few, NOISE_ENT, &mut gauss));
    case.put(&name(5), "CCR 1\nrun = \"13-04-03_10-00-05\"\n");
    let output = case.lin(&["--linearise", "--no-plots"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &[&name(4), "do not determine", "at least four different fields", &name(5)]);
    let files = tree(&case.out());
    assert!(files.keys().all(|f| !f.contains("10-00-04") && !f.contains("10-00-05")), "{:?}", files.keys());
    assert!(files.contains_key("13-04-03_10-00-01/PARAMETER_LIN__13-04-03_10-00-01.CPF"));
    assert!(number(&cpf(&case.out(), "13-04-03_10-00-01"), "linearisation.applied.c2_per_ent.0").abs() > 0.0);

    for extra in [&["--robust"][..], &["--linearisation", "x.toml"]] {
        let output = case.lin(&[&["--linearise"], extra].concat());
        assert_eq!(output.status.code(), Some(2), "{extra:?}");
    }
}
