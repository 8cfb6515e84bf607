//! The linear calibration gives the published, the true and the hand-made parameters back.

use calfit::data::note::NoteKind;
use calfit::data::plateau::{self, Accumulator, Plateau, Plateaus};
use calfit::data::run::{Kind, Run, Setting};
use calfit::data::units::{FieldCoil, Reading};
use calfit::files::campaign::Campaign;
use calfit::files::{ccr, parameter};
use calfit::measure::lin::{Lin, Options, lin};
use calfit::model::position::Position;
use calfit::model::sensor::split;
use calfit::workflow::RunResult;
use nalgebra::{Matrix3, Vector3};
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn document(path: &Path) -> DocumentMut {
    std::fs::read_to_string(path).unwrap().parse().unwrap()
}

fn numbers(item: &toml_edit::Item) -> Vec<f64> {
    let number = |v: &toml_edit::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64)).unwrap();
    item.as_array().unwrap().iter().map(number).collect()
}

fn matrix(item: &toml_edit::Item) -> Matrix3<f64> {
    let rows = item.as_array().unwrap();
    Matrix3::from_fn(|r, c| rows.get(r).unwrap().as_array().unwrap().get(c).unwrap().as_float().unwrap())
}

/// Reads, reduces and fits a run file as the program does.
fn fit(path: &Path, options: &Options) -> (Run, Lin) {
    let campaign = Campaign::open(&[path.to_owned()], &mut Vec::new()).unwrap().remove(0);
    let mut accumulator = Accumulator::default();
    let run = ccr::read(path, &ccr::Options::default(), &mut accumulator).unwrap();
    let plateaus = if run.blocks.is_empty() { accumulator.finish(options.cut) } else { plateau::from_blocks(&run.blocks) };
    let result = lin(&run, &plateaus, &campaign.file.instructions, options).unwrap();
    (run, result)
}

/// Arc seconds of `+89°47'17''`.
fn arc_seconds(text: &str) -> f64 {
    let parts: Vec<f64> =
        text.trim_start_matches('+').split(['°', '\'']).filter(|p| !p.is_empty()).map(|p| p.parse().unwrap()).collect();
    3600.0 * parts[0] + 60.0 * parts[1] + parts[2]
}

#[test]
fn the_printed_transfer_matrices_of_2013_split_into_the_printed_parts() {
    let mut worst_decimal: f64 = 0.0;
    let mut worst_second: f64 = 0.0;
    for file in ["lin_13-04-03_09-22-38.toml", "lin_13-04-09_09-52-27.toml"] {
        let printed = document(&repository("tests/data/bepicolombo").join(file));
        let s = split(&matrix(&printed["phi"]), &matrix(&printed["r_nom"])).unwrap();
        let sigma = Matrix3::from_diagonal(&Vector3::from(s.sigma));
        for (name, mine) in [("rho", s.rho), ("omega", s.omega), ("sigma", sigma), ("phi_tilde", s.phi_tilde)] {
            let difference = (mine * 1e6).map(f64::round) - (matrix(&printed[name]) * 1e6).map(f64::round);
            assert!(difference.amax() <= 1.0, "{file} {name}: {mine} differs by {difference} in the sixth decimal");
            worst_decimal = worst_decimal.max(difference.amax());
        }
        let [xy, xz, yz] = s.xi_deg;
        let [lambda, mu, nu] = s.rotation_deg;
        for (name, mine) in [
            ("xi_xy", xy),
            ("xi_xz", xz),
            ("xi_yz", yz),
            ("rotation_angle_lambda_x", lambda),
            ("rotation_angle_mu_y", mu),
            ("rotation_angle_nu_z", nu),
        ] {
            let difference = (3600.0 * mine).round() - arc_seconds(printed[name].as_str().unwrap());
            assert!(difference.abs() <= 1.0, "{file} {name}: {mine} differs by {difference} arc seconds");
            worst_second = worst_second.max(difference.abs());
        }
    }
    println!("largest difference: {worst_decimal} in the sixth decimal, {worst_second} arc seconds");
}

/// The published numbers of CHAMP run 04.
struct Champ {
    parameters: Matrix3<f64>,
    offset_eu: Vec<f64>,
    sensitivity: Vec<f64>,
    offset_nt: Vec<f64>,
    misalignment_deg: Vec<f64>,
    rows: Vec<[f64; 6]>,
}

fn champ() -> Champ {
    let facility = document(&repository("tests/data/champ/facility.toml"));
    let run04 = &facility["run04"];
    let text = std::fs::read_to_string(repository("tests/data/champ/run04_settings_residuals.csv")).unwrap();
    let rows = text
        .lines()
        .skip(1)
        .map(|l| {
            let cells: Vec<f64> = l.split(',').skip(1).map(|c| c.parse().unwrap()).collect();
            cells.try_into().unwrap()
        })
        .collect();
    Champ {
        parameters: matrix(&run04["parameters_eu"]),
        offset_eu: numbers(&run04["offset_eu"]),
        sensitivity: numbers(&run04["sensitivity_nt_per_eu"]),
        offset_nt: numbers(&run04["offset_nt"]),
        misalignment_deg: numbers(&run04["misalignment_deg"]),
        rows,
    }
}

#[test]
fn the_shipped_champ_run_is_what_the_report_prints() {
    let published = champ();
    let path = repository("runs/champ-1998/98-03-23/00-00-04.CCR");
    let run = ccr::read(&path, &ccr::Options::default(), &mut ()).unwrap();
    assert_eq!(run.blocks.len(), published.rows.len());
    for (block, row) in run.blocks.iter().zip(&published.rows) {
        assert_eq!(block.setting.field.0, [row[0], row[1], row[2]]);
        for axis in 0..3 {
            let field: f64 = (0..3).map(|i| row[i] * published.parameters[(i, axis)]).sum();
            let reading = field + published.offset_eu[axis] + row[3 + axis] / published.sensitivity[axis];
            assert!((block.mean.0[axis] - reading).abs() < 1e-6);
        }
    }
}

#[test]
fn champ_run_04_gives_the_published_parameters() {
    let published = champ();
    let (_, result) = fit(&repository("runs/champ-1998/98-03-23/00-00-04.CCR"), &Options::default());
    let p = &result.calibration;
    assert_eq!(p.offset.trend_order, 0, "campaign.toml asks for the constant offset of the report");
    let xi = [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz];
    for i in 0..3 {
        let sigma = p.matrix.sigma[i][i];
        let offset_nt = p.offset.b_or_ent[i] * sigma;
        let difference =
            (sigma - published.sensitivity[i], offset_nt - published.offset_nt[i], xi[i] - published.misalignment_deg[i]);
        println!(
            "{i}: sensitivity {:+.1e} nT/EU, offset {:+.4} nT, misalignment {:+.1e} deg",
            difference.0, difference.1, difference.2
        );
        assert!(difference.0.abs() < 1e-6 && difference.1.abs() < 0.01 && difference.2.abs() < 1e-4, "{difference:?}");
    }
    let rounded = p.quality.residual_nt.std.map(|s| (s * 1000.0).round() / 1000.0);
    assert_eq!(rounded, [0.165, 0.129, 0.140]);
}

#[test]
fn the_cases_are_fitted_and_the_one_without_a_hidden_effect_gives_the_truth() {
    for case in ["26-05-01", "26-05-02", "26-05-03", "26-05-04", "26-05-09", "26-05-10"] {
        let (run, result) = fit(&repository(&format!("tests/data/cases/{case}.CCR.gz")), &Options::default());
        assert_eq!(run.header.kind, Kind::Linearity);
        assert_eq!(run.vectors.lost, 0);
        let p = &result.calibration;
        assert_eq!(p.quality.blocks_used, p.quality.blocks_total, "{case}: {:?}", result.dropped);
        let text = std::fs::read_to_string(repository(&format!("tests/data/cases/{case}.json"))).unwrap();
        let truth: serde_json::Value = serde_json::from_str(&text).unwrap();
        if !truth["effects"].as_object().unwrap().is_empty() {
            continue;
        }
        let truth = &truth["parameters"];
        let mut worst: f64 = 0.0;
        let mut check = |name: &str, value: f64, true_value: f64, std: f64| {
            let z = (value - true_value) / std;
            worst = worst.max(z.abs());
            assert!(z.abs() < 4.0, "{case} {name}: {value} ± {std}, truth {true_value}");
        };
        let xi = [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz];
        let rotation = [p.angle_deg.lambda_x, p.angle_deg.mu_y, p.angle_deg.nu_z];
        for i in 0..3 {
            check("sigma", p.matrix.sigma[i][i], truth["sigma"][i].as_f64().unwrap(), p.std.sigma[i]);
            check("xi", xi[i], truth["xi_deg"][i].as_f64().unwrap(), p.std.xi_deg[i]);
            check("offset", p.offset.b_or_ent[i], truth["offset_ent"][i].as_f64().unwrap(), p.std.b_or_ent[i]);
            let angle = truth["rho"][i][i].as_f64().unwrap().acos().to_degrees();
            check("rotation", rotation[i], angle, p.std.lambda_mu_nu_deg[i]);
        }
        println!("{case}: largest deviation {worst:.2} standard uncertainties");
    }
}

#[test]
fn settling_is_found_where_there_is_some_and_not_where_there_is_none() {
    let (_, with) = fit(&repository("tests/data/cases/26-05-03.CCR.gz"), &Options::default());
    // 0.2 % of the step decays with 0.676 s: after 1.5 s a tenth of it is left, 1/5000 of a step.
    assert!(with.calibration.setup.settling_s > 1.5, "{}", with.calibration.setup.settling_s);
    let (_, without) = fit(&repository("tests/data/cases/26-05-01.CCR.gz"), &Options::default());
    assert_eq!(without.calibration.setup.settling_s, 0.0);
}

/// A generator of its own for the tests: uniform bits to Gaussian numbers.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn gaussian(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A sensor given by its axes in coil coordinates: reading i = axis_i . B / σ_i + offset_i.
struct Sensor {
    axes: [Vector3<f64>; 3],
    sigma: [f64; 3],
    offset_ent: [f64; 3],
}

impl Sensor {
    fn reading(&self, field: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.axes[i].dot(&Vector3::from(field)) / self.sigma[i] + self.offset_ent[i])
    }
}

fn programme() -> Vec<[f64; 3]> {
    let mut fields = Vec::new();
    for axis in 0..3 {
        for step in [0.0, 500.0, -500.0, 1000.0, -1000.0, 1500.0, -1500.0, 2000.0, -2000.0, 0.0] {
            let mut field = [0.0; 3];
            field[axis] = step;
            fields.push(field);
        }
    }
    fields
}

fn plateaus(sensor: &Sensor, position: u32, noise_ent: f64, noise: &mut Noise) -> Plateaus {
    let blocks: Vec<Plateau> = programme()
        .into_iter()
        .enumerate()
        .map(|(index, field)| {
            let t = index as f64 * 25.0;
            let mean = sensor.reading(field).map(|r| r + noise_ent * noise.gaussian());
            let setting = Setting { t_start_s: t, t_end_s: t + 24.0, field: FieldCoil(field), frequency_hz: 0.0, position };
            Plateau {
                index,
                setting,
                used_s: [t, t + 24.0],
                mean: Reading(mean),
                std_ent: None,
                count: None,
                spike_samples: 0,
                dropped: None,
                contrasts: Vec::new(),
            }
        })
        .collect();
    Plateaus { list: blocks, ..plateau::from_blocks(&[]) }
}

/// The shipped sample run and campaign serve as header and position table.
fn sample_run() -> Run {
    ccr::read(&repository("runs/sample/26-01-15/09-00-00.CCR"), &ccr::Options::default(), &mut ()).unwrap()
}

fn campaign_with(position: &str) -> Campaign {
    let folder = tempfile::tempdir().unwrap();
    let day = folder.path().join("26-01-15");
    std::fs::create_dir(&day).unwrap();
    std::fs::write(folder.path().join("campaign.toml"), format!("[[position]]\nid = 4\naxes = {position}\n")).unwrap();
    std::fs::write(day.join("09-00-00.CCR"), "CCR 1\n").unwrap();
    Campaign::open(&[folder.path().to_owned()], &mut Vec::new()).unwrap().remove(0)
}

#[test]
fn in_a_position_that_is_not_symmetric_rho_is_near_the_identity_and_phi_gives_coil_coordinates() {
    // X_m = -Z_c, Y_m = +Y_c, Z_m = +X_c, each turned a little; axes written down in coil coordinates.
    let axes = [Vector3::new(0.004, -0.003, -1.0), Vector3::new(0.002, 1.0, 0.005), Vector3::new(1.0, 0.001, 0.0035)]
        .map(|a| a.normalize());
    let sensor = Sensor { axes, sigma: [0.972, 0.996, 0.989], offset_ent: [-0.2, -0.3, -10.5] };
    let campaign = campaign_with(r#"["-Z", "+Y", "+X"]"#);
    let list = plateaus(&sensor, 4, 0.0, &mut Noise(1));
    let result = lin(&sample_run(), &list, &campaign.file.instructions, &Options::default()).unwrap();
    let p = &result.calibration;
    for (row, rho) in p.matrix.rho.iter().enumerate() {
        for (column, value) in rho.iter().enumerate() {
            let identity = if row == column { 1.0 } else { 0.0 };
            assert!((value - identity).abs() < 0.01, "rho {:?}", p.matrix.rho);
        }
    }
    assert!((p.quality.rotation_determinant - 1.0).abs() < 1e-12);
    let phi = Matrix3::from_fn(|r, c| p.matrix.phi[r][c]);
    for field in [[1000.0, 0.0, 0.0], [0.0, -300.0, 700.0], [12.0, 34.0, 56.0]] {
        let b_m = Vector3::from(sensor.reading(field)) - Vector3::from(p.offset.b_or_ent);
        assert!((phi * b_m - Vector3::from(field)).amax() < 1e-8);
    }
    for i in 0..3 {
        assert!((p.matrix.sigma[i][i] - sensor.sigma[i]).abs() < 1e-12);
    }
    assert!(result.notes.iter().all(|n| n.kind != NoteKind::Axes), "{:?}", result.notes);
    let between = |a: usize, b: usize| axes[a].dot(&axes[b]).acos().to_degrees();
    assert!((p.angle_deg.xi_xy - between(0, 1)).abs() < 1e-9 && (p.angle_deg.xi_yz - between(1, 2)).abs() < 1e-9);
    assert_eq!(Position::from_axes(p.setup.position_axes.as_ref()).unwrap().to_string(), "-Z +Y +X");
}

#[test]
fn nominal_95_percent_intervals_hold_the_truth_in_95_percent_of_made_runs() {
    let axes = [Vector3::new(1.0, 0.003, -0.004), Vector3::new(-0.002, 1.0, 0.005), Vector3::new(0.001, -0.006, 1.0)]
        .map(|a| a.normalize());
    let sensor = Sensor { axes, sigma: [0.972, 0.996, 0.989], offset_ent: [-0.2, -0.3, -10.5] };
    let between = |a: usize, b: usize| axes[a].dot(&axes[b]).acos().to_degrees();
    let xi = [between(0, 1), between(0, 2), between(1, 2)];
    let campaign = campaign_with(r#"["+X", "+Y", "+Z"]"#);
    let run = sample_run();
    let mut noise = Noise(20_130_403);
    // Student's t for 24 degrees of freedom (30 plateaus, 6 parameters per component), from the table.
    const T_24: f64 = 2.0639;
    let (runs, mut held) = (500, 0);
    for _ in 0..runs {
        let list = plateaus(&sensor, 4, 0.05, &mut noise);
        let result = lin(&run, &list, &campaign.file.instructions, &Options::default()).unwrap();
        let p = &result.calibration;
        let mine = [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz];
        for i in 0..3 {
            held += usize::from((p.matrix.sigma[i][i] - sensor.sigma[i]).abs() < T_24 * p.std.sigma[i]);
            held += usize::from((mine[i] - xi[i]).abs() < T_24 * p.std.xi_deg[i]);
        }
    }
    let share = f64::from(held as u32) / f64::from(6 * runs as u32);
    println!("95 % intervals of sensitivities and angles hold the truth in {:.1} %", 100.0 * share);
    // Three standard errors of 3000 intervals of 95 % are 1.2 %.
    assert!((0.935..=0.965).contains(&share), "{share}");
}

/// An offset that drifts by 4 enT from the first to the last setting is 2 enT off its mean at both ends, 300 times what the mean is uncertain by.
#[test]
fn an_offset_that_moves_within_the_run_is_told_with_its_size() {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let sensor = Sensor { axes, sigma: [1.0; 3], offset_ent: [-0.2, -0.3, -10.5] };
    let campaign = campaign_with(r#"["+X", "+Y", "+Z"]"#);
    for drift_ent in [0.0, 4.0] {
        let mut list = plateaus(&sensor, 4, 0.01, &mut Noise(5));
        let last = (list.list.len() - 1) as f64;
        for plateau in &mut list.list {
            plateau.mean.0[2] += drift_ent * (plateau.index as f64 / last - 0.5);
        }
        let options = Options { trend_order: Some(1), ..Options::default() };
        let result = lin(&sample_run(), &list, &campaign.file.instructions, &options).unwrap();
        let told: Vec<&str> =
            result.notes.iter().filter(|n| n.text.starts_with("the offset moves")).map(|n| n.text.as_str()).collect();
        if drift_ent == 0.0 {
            assert!(told.is_empty(), "{told:?}");
            continue;
        }
        // The times are those of the begin of the first and the end of the last setting: half a setting of 30 more at either end.
        let [told] = told.as_slice() else { panic!("{told:?}") };
        let by: f64 = told.split(" enT in z").next().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
        assert!((by - 2.0).abs() < 0.1 && !told.contains("enT in x"), "{told}");
    }
}

#[test]
fn a_parameter_file_reads_back_to_the_last_bit_and_notices_changes() {
    let (run, result) = fit(&repository("runs/sample/26-01-15/09-00-00.CCR"), &Options::default());
    let provenance = calfit::data::provenance::Provenance::new(calfit::data::recipe::Recipe::plain("lin"), vec![(&run).into()]);
    let text = parameter::to_text(&result.parameters(), &provenance).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.CPF");
    std::fs::write(&path, &text).unwrap();
    let back = parameter::read::<parameter::Cpf>(&path).unwrap();
    assert_eq!(back.body, result.parameters());
    assert_eq!(back.provenance, provenance);
    std::fs::write(&path, text.replacen("trend_order = 2", "trend_order = 1", 1)).unwrap();
    assert!(parameter::read::<parameter::Cpf>(&path).unwrap_err().rule.contains("hash"));
}

#[test]
fn the_sample_run_gives_its_truth_and_leaves_out_what_the_campaign_says() {
    let (run, result) = fit(&repository("runs/sample/26-01-15/09-00-00.CCR"), &Options::default());
    assert_eq!((run.vectors.lost, run.vectors.gap_count), (56, 2));
    let p = &result.calibration;
    assert_eq!(result.dropped.iter().map(|d| d.block).collect::<Vec<_>>(), [8, 9]);
    // The truth stands in the head of the file.
    for (i, (sigma, xi)) in [(0.9723, 89.79), (0.9962, 90.05), (0.9887, 90.01)].into_iter().enumerate() {
        let mine = [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz][i];
        assert!((p.matrix.sigma[i][i] - sigma).abs() < 4.0 * p.std.sigma[i]);
        assert!((mine - xi).abs() < 4.0 * p.std.xi_deg[i]);
    }
    assert!((run.vectors.measured_rate_hz.unwrap() - 127.9989).abs() < 1e-4);
}
