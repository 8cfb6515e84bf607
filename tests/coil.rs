//! `calfit coil`: the facility's parameters come back, printed numbers too, and what the data do not determine is refused by name.

use crate::common;

use calfit::data::note::Told;
use calfit::data::provenance::Provenance;
use calfit::data::recipe::Recipe;
use calfit::data::run::{Header, InputFile, Kind, ReadingUnit, Run, ScalarRow, SlowTable, VectorAccount};
use calfit::files::parameter::{self, CoilConvention, CoilScalar};
use calfit::fit::student_95;
use calfit::measure::coil::scalar::{Options, Scalar, scalar};
use calfit::model::campaign::Instructions;
use calfit::model::facility_calibration::Explanation;
use common::check::{Case, calfit, close, cpf, number, parameters, says, sigma, text, three};
use common::{Gauss, Plan, programme};
use std::path::{Path, PathBuf};

type Three = [f64; 3];

/// The facility of March 1998, CH-GFZ-TR-2601 section 6.
const SCALE: Three = [0.99988, 0.99993, 0.99994];
const OFFSET_NT: Three = [2.0, -2.2, -1.2];
const ANGLES_DEG: Three = [90.0031, 89.9962, 89.9664];
/// Coil temperatures of its four scalar calibrations, °C, and what the temperature changes.
const CALIBRATIONS_DEGC: [f64; 4] = [16.56, 16.38, 16.60, 17.03];
const SCALE_PER_K: Three = [1.90e-5, 1.65e-5, 1.75e-5];
const OFFSET_PER_K: Three = [0.35, 0.0, 0.80];
const RACK_SCALE_PER_K: f64 = -8e-7;

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A facility of the test's own: the coil axes come from the Cholesky factor of the table of their cosines.
#[derive(Clone, Copy)]
struct Facility {
    scale: Three,
    offset_nt: Three,
    angles_deg: Three,
}

const FACILITY: Facility = Facility { scale: SCALE, offset_nt: OFFSET_NT, angles_deg: ANGLES_DEG };

impl Facility {
    /// Rows of the matrix from settings to field.
    fn matrix(&self) -> [Three; 3] {
        let [xy, xz, yz] = self.angles_deg.map(|a| a.to_radians().cos());
        let cosines = [[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]];
        let mut lower = [[0.0f64; 3]; 3];
        for i in 0..3 {
            for j in 0..=i {
                let sum: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                lower[i][j] = if i == j { (cosines[i][i] - sum).sqrt() } else { (cosines[i][j] - sum) / lower[j][j] };
            }
        }
        std::array::from_fn(|row| std::array::from_fn(|coil| lower[coil][row] * self.scale[coil]))
    }

    fn field(&self, setting: Three) -> Three {
        let m = self.matrix();
        std::array::from_fn(|r| self.offset_nt[r] + (0..3).map(|c| m[r][c] * setting[c]).sum::<f64>())
    }

    fn modulus(&self, setting: Three) -> f64 {
        self.field(setting).iter().map(|b| b * b).sum::<f64>().sqrt()
    }
}

/// 83 random directions, 30 and 50 µT in turn.
fn directions(gauss: &mut Gauss) -> Vec<Three> {
    let direction = |i: usize, gauss: &mut Gauss| {
        let v = [gauss.normal(), gauss.normal(), gauss.normal()];
        let size = if i.is_multiple_of(2) { 30_000.0 } else { 50_000.0 } / v.iter().map(|v| v * v).sum::<f64>().sqrt();
        v.map(|v| v * size)
    };
    (0..83).map(|i| direction(i, gauss)).collect()
}

/// A scalar run with moduli of 0.1 nT noise.
fn run(day: usize, facility: &Facility, settings: &[Three], channels: &[(&str, f64)], gauss: &mut Gauss) -> Run {
    let row = |(i, setting): (usize, &Three)| ScalarRow {
        t_s: 20.0 * i as f64 + 10.0,
        setting: *setting,
        modulus_nt: facility.modulus(*setting) + 0.1 * gauss.normal(),
    };
    let scalar: Vec<ScalarRow> = settings.iter().enumerate().map(row).collect();
    Run {
        header: Header {
            run: format!("98-03-{day:02}_10-49-00"),
            start: format!("1998-03-{day:02}T10:49:00Z").parse().unwrap(),
            kind: Kind::Scalar,
            configuration: String::new(),
            sensor: String::new(),
            mode: String::new(),
            sample_rate_hz: 1.0,
            unit: ReadingUnit::Ent,
            field_source: String::new(),
            coil_correction: None,
            earthfield_compensation: Vec::new(),
        },
        settings: Vec::new(),
        blocks: Vec::new(),
        temperatures: SlowTable {
            names: channels.iter().map(|(name, _)| (*name).to_owned()).collect(),
            t_s: vec![0.0, 2000.0],
            values: channels.iter().map(|(_, degc)| vec![*degc; 2]).collect(),
        },
        channels: SlowTable::default(),
        scalar,
        vectors: VectorAccount::default(),
        input: InputFile { path: "test".to_owned(), size_bytes: 0, sha256: String::new() },
        findings: Vec::new(),
        exclusions: Vec::new(),
    }
}

fn calibrate(runs: &[Run], options: &Options) -> Scalar {
    let instructions = Instructions::default();
    scalar(&runs.iter().map(|run| (run, &instructions)).collect::<Vec<_>>(), options).unwrap()
}

/// The text of a scalar run.
fn ccr(run: &Run) -> String {
    let mut out = format!(
        "CCR 1\nrun = \"{}\"\nstart = \"{}\"\nkind = \"scalar\"\nsample_rate = 1.0\nunit = \"enT\"\n@SCALAR\nt,bx,by,bz,f\n",
        run.header.run, run.header.start
    );
    for ScalarRow { t_s, setting: [x, y, z], modulus_nt } in &run.scalar {
        out.push_str(&format!("{t_s:.1},{x:.2},{y:.2},{z:.2},{modulus_nt:.3}\n"));
    }
    out + "@END\n"
}

/// `calfit coil METHOD PATH... -o OUT ...` with its exit status and both outputs.
fn coil(case: &Case, method: &str, paths: &[&Path], options: &[&str]) -> (Option<i32>, String, String) {
    let output = calfit().args(["coil", method]).args(paths).arg("-o").arg(case.out()).args(options).output().unwrap();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn nine_parameters_come_back_and_the_intervals_cover() {
    const SEEDS: u64 = 200;
    let truth = [SCALE, OFFSET_NT, ANGLES_DEG].concat();
    let most: Vec<f64> = [[2e-6; 3], [0.1; 3], [1.0 / 3600.0; 3]].concat();
    let (mut covered, mut beyond, mut worst) = ([0u32; 9], [0u32; 9], [0.0f64; 9]);
    for seed in 0..SEEDS {
        let mut gauss = Gauss(1000 + seed);
        let settings = directions(&mut gauss);
        let result = calibrate(&[run(23, &FACILITY, &settings, &[], &mut gauss)], &Options::default());
        let p = &result;
        let of =
            |part: &calfit::model::facility::FacilityParameters| [part.scale_nt_per_eu, part.offset_nt, part.angles_deg].concat();
        let (found, std) = (of(&p.found.facility), of(&p.found.std));
        let factor = student_95(p.found.quality.degrees_of_freedom);
        for j in 0..9 {
            let error = (found[j] - truth[j]).abs();
            beyond[j] += u32::from(error > most[j]);
            worst[j] = worst[j].max(error);
            covered[j] += u32::from(error < factor * std[j]);
        }
        assert!((0.07..0.13).contains(&p.found.quality.residual_std_nt) && p.found.quality.condition < 5.0);
    }
    println!("covered of {SEEDS}: {covered:?}; largest errors {worst:?}; beyond {beyond:?}");
    // 2e-6 are three standard uncertainties of 83 moduli with 0.1 nT of noise: one error in 400 is larger.
    assert!(beyond[..3].iter().sum::<u32>() <= 5 && worst[..3].iter().all(|w| *w < 3e-6), "{worst:?}");
    assert!(beyond[3..].iter().all(|b| *b == 0), "{worst:?}");
    let share = f64::from(covered.iter().sum::<u32>()) / (9.0 * SEEDS as f64);
    assert!((0.93..0.97).contains(&share), "{covered:?}");
    assert!(covered.iter().all(|c| (0.90..0.99).contains(&(f64::from(*c) / SEEDS as f64))), "{covered:?}");
}

#[test]
fn temperature_coefficients_come_back_from_four_calibrations() {
    let mut gauss = Gauss(5);
    let rack_degc = [31.0, 33.4, 30.2, 32.6];
    let calibration = |i: usize, gauss: &mut Gauss| {
        let (coil_k, rack_k) = (CALIBRATIONS_DEGC[i] - 16.5, rack_degc[i] - 32.0);
        let facility = Facility {
            scale: std::array::from_fn(|k| SCALE[k] * (1.0 + SCALE_PER_K[k] * coil_k) * (1.0 + RACK_SCALE_PER_K * rack_k)),
            offset_nt: std::array::from_fn(|k| OFFSET_NT[k] + OFFSET_PER_K[k] * coil_k),
            ..FACILITY
        };
        let settings = directions(gauss);
        run(23 + i, &facility, &settings, &[("T29", CALIBRATIONS_DEGC[i]), ("T55", rack_degc[i])], gauss)
    };
    let runs: Vec<Run> = (0..4).map(|i| calibration(i, &mut gauss)).collect();
    let p = calibrate(&runs, &Options { rack_channel: Some("T55".to_owned()) });
    assert_eq!((p.found.facility.reference_degc, p.found.facility.rack_reference_degc), (Some(16.6), Some(31.8)));
    let within = |found: Option<Three>, std: Option<Three>, truth: Three, most: f64| {
        for k in 0..3 {
            let (found, std) = (found.unwrap()[k], std.unwrap()[k]);
            assert!((found - truth[k]).abs() < 3.5 * std && std < most, "{found} ± {std} is not {}", truth[k]);
        }
    };
    // The moduli alone give 1.4e-6: 6.7e-7 in each calibration, through the inverse normal matrix of value, coil and rack. One degree of freedom
    // tells little of what else differs between calibrations; were that as large as the noise, the uncertainty would be 2.0e-6, so twice is enough.
    within(p.found.facility.scale_per_k, p.found.std.scale_per_k, SCALE_PER_K, 2.8e-6);
    within(p.found.facility.offset_nt_per_k, p.found.std.offset_nt_per_k, OFFSET_PER_K, 0.06);
    within(p.found.facility.rack_scale_per_k, p.found.std.rack_scale_per_k, [RACK_SCALE_PER_K; 3], 4e-7);
    within(p.found.facility.rack_offset_nt_per_k, p.found.std.rack_offset_nt_per_k, [0.0; 3], 0.02);
    assert!(p.found.calibration.len() == 4 && p.notes.is_empty(), "{:?}", p.notes);
    let table = exported(&p).unwrap();
    let facility = &p.found.facility;
    for (name, values, std, unit) in [
        ("scale_per_k", facility.scale_per_k, p.found.std.scale_per_k, "1/K"),
        ("offset_per_k", facility.offset_nt_per_k, p.found.std.offset_nt_per_k, "nT/K"),
        ("rack_scale_per_k", facility.rack_scale_per_k, p.found.std.rack_scale_per_k, "1/K"),
    ] {
        for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let row = format!("\n{name},{axis},{:?},{:?},{unit},", values.unwrap()[k], std.unwrap()[k]);
            assert!(table.contains(&row), "{row} is not in {table}");
        }
    }
    says(&table, &["\nreference_temperature,,16.6,", "\nrack_reference_temperature,,31.8,"]);
}

/// The table of the quantities of a scalar calibration, or why there is none.
fn exported(found: &Scalar) -> Result<String, String> {
    let case = Case::new();
    let body = CoilScalar { convention: CoilConvention::scalar(), found: found.found.clone(), told: Told::of(&found.notes) };
    let text = parameter::to_text(&body, &Provenance::new(Recipe::plain("coil scalar"), Vec::new())).unwrap();
    let path = case.put("COIL_SCALAR__1.toml", text);
    let output = calfit().args(["export", "--format", "csv", "-o"]).arg(case.out()).arg(path).output().unwrap();
    match output.status.code() {
        Some(0) => Ok(std::fs::read_to_string(case.out().join("COIL_SCALAR__1.toml.csv")).unwrap()),
        _ => Err(text_of(&output)),
    }
}

/// A calibration whose coils warm up by so many kelvins, and whose settings along X come first.
fn while_warming(day: usize, degc: f64, by_k: f64, gauss: &mut Gauss) -> Run {
    // Not the coefficients that are published.
    const PER_K: Three = [1.9e-5, 2.1e-5, 1.7e-5];
    let mut settings = directions(gauss);
    settings.sort_by(|a, b| (b[0] / b[1].hypot(b[2])).abs().total_cmp(&(a[0] / a[1].hypot(a[2])).abs()));
    let mut made = run(day, &FACILITY, &settings, &[("T29", degc)], gauss);
    let at = |t_s: f64| degc + by_k * (t_s / 1650.0 - 0.5);
    made.temperatures.t_s = (0..=20).map(|i| 82.5 * f64::from(i)).collect();
    made.temperatures.values = vec![made.temperatures.t_s.iter().map(|t| at(*t)).collect()];
    for row in &mut made.scalar {
        let scale = std::array::from_fn(|k| SCALE[k] * (1.0 + PER_K[k] * (at(row.t_s) - 16.5)));
        row.modulus_nt += Facility { scale, ..FACILITY }.modulus(row.setting) - FACILITY.modulus(row.setting);
    }
    made
}

/// One calibration tells no coefficients. What they did to it is uncertain by what they may be: a kelvin made the scale factor of X wrong by six
/// uncertainties. Several calibrations tell them, and the movement within each of them is no disagreement.
#[test]
fn coils_that_warm_up_within_a_calibration() {
    for (by_k, is_told) in [(0.0, false), (0.5, true), (1.0, true)] {
        let mut squares = 0.0;
        for seed in 0..20 {
            let p = calibrate(&[while_warming(23, 16.5, by_k, &mut Gauss(700 + seed))], &Options::default());
            let (found, std) = (p.found.facility.scale_nt_per_eu[0], p.found.std.scale_nt_per_eu[0]);
            squares += ((found - SCALE[0]) / std).powi(2) / 20.0;
            // No more than the whole movement at 2e-5 per kelvin, beside the noise.
            assert!(std < 1e-6 + 2e-5 * by_k, "{std}");
            let told = p.notes.iter().any(|n| n.text.contains("the coil temperature moved by"));
            assert_eq!(told, is_told, "{:?}", p.notes);
        }
        println!("{by_k} K: {:.2}", squares.sqrt());
        assert!(squares.sqrt() < 1.4, "{by_k} K: {squares}");
    }
    let mut gauss = Gauss(8);
    let runs: Vec<Run> = (0..3).map(|i| while_warming(23 + i, 12.0 + 3.0 * i as f64, 3.0, &mut gauss)).collect();
    let p = calibrate(&runs, &Options::default());
    let (found, std) = (p.found.facility.scale_per_k.unwrap(), p.found.std.scale_per_k.unwrap());
    assert!((found[1] - 2.1e-5).abs() < 3.5 * std[1] && std[1] < 1e-6, "{found:?} {std:?}");
    assert!(p.notes.is_empty(), "{:?}", p.notes);
}

#[test]
fn a_step_between_two_calibrations_makes_two_periods() {
    // On 25 March 1998 the offset field of Y went from -2.2 to -4.4 nT.
    let mut gauss = Gauss(6);
    let later = Facility { offset_nt: [2.0, -4.4, -1.2], ..FACILITY };
    let settings = directions(&mut gauss);
    let runs = [run(23, &FACILITY, &settings, &[], &mut gauss), run(25, &later, &settings, &[], &mut gauss)];
    let p = calibrate(&runs, &Options::default());
    let [before, after] = p.found.period.as_slice() else { panic!("{:?}", p.found.period) };
    for (period, truth) in [(before, OFFSET_NT), (after, later.offset_nt)] {
        for k in 0..3 {
            let (found, std) = (period.facility.offset_nt[k], period.std.offset_nt[k]);
            // One calibration has 0.025 nT; that the facility differs by as much from one to the other two of them cannot exclude.
            assert!((found - truth[k]).abs() < 3.5 * std && std < 0.04, "{found} ± {std} is not {}", truth[k]);
        }
    }
    // The runs begin at 10:49 and their last row is 1650 s later: the middle of the 46.54 h between them.
    assert_eq!(before.span.from, None);
    assert_eq!(before.span.to.as_ref().unwrap().as_str(), "1998-03-24T11:02:45Z");
    assert_eq!((&after.span.from, &after.span.to), (&before.span.to, &None));
    assert_eq!(p.found.facility, after.facility);
    says(&exported(&p).unwrap_err(), &["values for several periods", "--format json"]);
    let [step] = p.found.step.as_slice() else { panic!("{:?}", p.found.step) };
    assert_eq!(step.parameter, "offset field of Y");
    says(
        &p.notes.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"),
        &[
            "the offset field of Y stepped between the calibrations 98-03-23_10-49-00 and 98-03-25_10-49-00",
            "1998-03-24T11:02:45Z",
        ],
    );
}

/// Four calibrations at the temperatures of 1998, with the facility of each.
fn four(facility: impl Fn(usize, f64, f64) -> Facility, gauss: &mut Gauss) -> Scalar {
    const RACK_DEGC: [f64; 4] = [30.4, 32.2, 33.6, 31.6];
    let calibration = |i: usize, gauss: &mut Gauss| {
        let (coil, rack) = (CALIBRATIONS_DEGC[i], RACK_DEGC[i]);
        let settings = directions(gauss);
        run(23 + i, &facility(i, coil - 16.5, rack - 32.0), &settings, &[("T29", coil), ("T55", rack)], gauss)
    };
    let runs: Vec<Run> = (0..4).map(|i| calibration(i, gauss)).collect();
    calibrate(&runs, &Options::default())
}

#[test]
fn a_step_is_told_from_a_temperature_coefficient_by_the_evidence_of_both() {
    let thermal = |offset_y_nt: f64, per_k: f64, coil_k: f64| Facility {
        scale: std::array::from_fn(|k| SCALE[k] * (1.0 + SCALE_PER_K[k] * coil_k)),
        offset_nt: [
            OFFSET_NT[0] + OFFSET_PER_K[0] * coil_k,
            offset_y_nt + per_k * coil_k,
            OFFSET_NT[2] + OFFSET_PER_K[2] * coil_k,
        ],
        ..FACILITY
    };
    for seed in 0..3 {
        let mut gauss = Gauss(100 + seed);
        let stepped = four(|i, coil_k, _| thermal(if i < 2 { -2.2 } else { -4.4 }, 0.0, coil_k), &mut gauss);
        let [before, after] = stepped.found.period.as_slice() else { panic!("{:?}", stepped.found.hypothesis) };
        for (period, truth) in [(before, -2.2), (after, -4.4)] {
            let (found, std) = (period.facility.offset_nt[1], period.std.offset_nt[1]);
            assert!((found - truth).abs() < 3.5 * std && std < 0.2, "{found} ± {std}");
        }
        // -3.9 ± 0.08 nT/K is what the temperatures alone make of it.
        let (per_k, std) = (after.facility.offset_nt_per_k.unwrap()[1], after.std.offset_nt_per_k.unwrap()[1]);
        assert!(per_k.abs() < 3.5 * std || (per_k == 0.0 && std.is_nan()), "{per_k} ± {std}");
        let bic = |of: &Scalar, explanation| of.found.hypothesis.iter().find(|h| h.explanation == explanation).unwrap().bic;
        assert!(bic(&stepped, Explanation::Temperatures) > bic(&stepped, Explanation::Both) + 10.0);
        assert_eq!(stepped.found.hypothesis.iter().filter(|h| h.chosen).count(), 1);

        let mut gauss = Gauss(200 + seed);
        let warm = four(|_, coil_k, _| thermal(-2.2, -3.9, coil_k), &mut gauss);
        assert!(warm.found.period.is_empty() && warm.found.step.is_empty(), "{:?}", warm.found.step);
        let (per_k, std) = (warm.found.facility.offset_nt_per_k.unwrap()[1], warm.found.std.offset_nt_per_k.unwrap()[1]);
        assert!((per_k + 3.9).abs() < 3.5 * std && std < 0.1, "{per_k} ± {std}");
        let chosen = warm.found.hypothesis.iter().find(|h| h.chosen).unwrap();
        assert_eq!(chosen.explanation, Explanation::Temperatures);
        assert!(bic(&warm, Explanation::Nothing) > chosen.bic + 10.0 && bic(&warm, Explanation::Steps).is_finite());
    }
}

#[test]
fn calibrations_of_a_steady_facility_have_no_step() {
    let mut steps = 0;
    for seed in 0..12 {
        let mut gauss = Gauss(300 + seed);
        let p = four(|_, _, _| FACILITY, &mut gauss);
        steps += p.found.step.len();
    }
    assert_eq!(steps, 0);
}

#[test]
fn a_file_with_periods_is_a_facility_for_runs_of_its_periods() {
    let mut gauss = Gauss(6);
    let later = Facility { offset_nt: [2.0, -104.4, -1.2], ..FACILITY };
    let settings = directions(&mut gauss);
    let case = Case::of(ccr(&run(23, &later, &settings, &[], &mut gauss)));
    case.put("98-03-25/10-49-00.CCR", ccr(&run(25, &FACILITY, &settings, &[], &mut gauss)));
    let (status, _, errors) = coil(&case, "scalar", &[&case.campaign()], &["--no-plots"]);
    assert_eq!(status, Some(0), "{errors}");
    let file = case.out().join("COIL_SCALAR__98-03-23_10-49-00.toml");
    says(
        &std::fs::read_to_string(&file).unwrap(),
        &["[[period]]", "to = \"1998-03-24T", "from = \"1998-03-24T", "[period.covariance]"],
    );
    // The run of 2013 lies in the last period, which has no end.
    let (plan, made) = in_facility(&FACILITY);
    let linear = Case::of(made.text());
    linear.done(&["--facility", file.to_str().unwrap(), "--order", "0"]);
    close(three(&linear.cpf(), "offset.b_or_ent"), plan.truth.reading([0.0; 3]), 0.15);
}

#[test]
fn a_disturbed_row_is_named_and_left_out() {
    let mut gauss = Gauss(7);
    let settings = directions(&mut gauss);
    let mut disturbed = run(23, &FACILITY, &settings, &[], &mut gauss);
    disturbed.scalar[40].modulus_nt += 25.0;
    let case = Case::of(ccr(&disturbed));
    let (status, _, errors) = coil(&case, "scalar", &[&case.campaign()], &["--no-plots"]);
    assert_eq!(status, Some(0), "{errors}");
    says(&errors, &["row 41", "810 s", "left out"]);
    let file = parameters(&case.out().join("COIL_SCALAR__98-03-23_10-49-00.toml"));
    close(three(&file, "facility.scale_nt_per_eu"), SCALE, 2e-6);
    close(three(&file, "facility.offset_nt"), OFFSET_NT, 0.1);
    close(three(&file, "facility.angles_deg"), ANGLES_DEG, 1.0 / 3600.0);
    assert_eq!((number(&file, "quality.rows_used"), number(&file, "quality.rows_total")), (82.0, 83.0));
    assert!((file["outlier"][0]["residual_nt"].as_float().unwrap() - 25.0).abs() < 0.5);
}

/// Settings in the rows of others, or with a wrong sign of one component in the second half of the rows.
#[test]
fn moduli_that_are_not_those_of_the_settings_are_refused_or_told() {
    let mut gauss = Gauss(9);
    let settings = directions(&mut gauss);
    let sound = run(1, &FACILITY, &settings, &[], &mut gauss);
    let found = calibrate(std::slice::from_ref(&sound), &Options::default());
    let is_told =
        |found: &Scalar| found.notes.iter().any(|note| note.to_string().contains("far more than a coil system in order"));
    assert!(!is_told(&found), "{:?}", found.notes);
    let mut shifted = sound.clone();
    let first = shifted.scalar[0].setting;
    let half = shifted.scalar.len() / 2;
    for row in half..shifted.scalar.len() {
        shifted.scalar[row].setting = sound.scalar.get(row + 1).map_or(first, |next| next.setting);
    }
    let instructions = Instructions::default();
    let refused = scalar(&[(&shifted, &instructions)], &Options::default()).unwrap_err();
    says(&refused.to_string(), &["the moduli are not those of the settings"]);
    let mut reversed = sound;
    reversed.scalar[half..].iter_mut().for_each(|row| row.setting[2] = -row.setting[2]);
    match scalar(&[(&reversed, &instructions)], &Options::default()) {
        Ok(found) => assert!(is_told(&found), "{:?}", found.notes),
        Err(refused) => says(&refused.to_string(), &["the moduli are not those of the settings"]),
    }
}

#[test]
fn directions_that_leave_parameters_open_are_refused_by_name() {
    let mut gauss = Gauss(8);
    let all = directions(&mut gauss);
    let flat: Vec<Three> = all.iter().map(|[x, y, _]| [*x, *y, 0.0]).collect();
    let narrow: Vec<Three> = all.iter().map(|[x, y, z]| [0.02 * x, 0.02 * y, 40_000.0 + 0.02 * z]).collect();
    for (settings, words, others) in [
        (flat, vec!["the scale factor of Z", "the angle XZ", "the angle YZ"], vec!["the scale factor of X", "the angle XY"]),
        (narrow, vec!["condition number"], vec![]),
    ] {
        let case = Case::of(ccr(&run(23, &FACILITY, &settings, &[], &mut gauss)));
        let (status, _, errors) = coil(&case, "scalar", &[&case.campaign()], &["--no-plots"]);
        assert_eq!(status, Some(1), "{errors}");
        says(&errors, &words);
        says(&errors, &["add settings in other directions", "09-22-38.CCR"]);
        assert!(others.iter().all(|word| !errors.contains(word)), "{errors}");
        assert!(!case.out().join("COIL_SCALAR__98-03-23_10-49-00.toml").exists());
    }
    let few = Case::of(ccr(&run(23, &FACILITY, &all[..9], &[], &mut gauss)));
    says(&coil(&few, "scalar", &[&few.campaign()], &[]).2, &["9 @SCALAR rows", "longer programme"]);
}

#[test]
fn printed_moduli_give_the_printed_residual_fields() {
    let case = Case::new();
    let table = repository("tests/data/bepicolombo/residual_field.csv");
    let (status, shown, errors) = coil(&case, "residual", &[&table], &[]);
    assert_eq!(status, Some(0), "{errors}");
    says(&shown, &["X -2.50 ", "Y -1.00 ", "Z -40.00 ", "X +0.00 ", "Y +0.00 ", "Z -7.00 "]);
    let file = parameters(&case.out().join("COIL_RESIDUAL__residual_field.toml"));
    let found = |state: usize, axis: usize| file["state"][state]["axis"][axis]["residual_nt"].as_float().unwrap();
    assert_eq!([0, 1, 2].map(|axis| found(0, axis)), [-2.5, -1.0, -40.0]);
    assert_eq!([0, 1, 2].map(|axis| found(1, axis)), [0.0, 0.0, -7.0]);
    assert_eq!(three(&file, "facility.offset_nt"), [0.0, 0.0, -7.0]);
    // Two moduli in steps of 1 nT, each of uniform distribution, half of their difference.
    close(three(&file, "std.offset_nt"), [(1.0f64 / 24.0).sqrt(); 3], 1e-12);
    assert!(case.out().join("COIL_RESIDUAL_fields__residual_field.png").is_file());
    assert!(case.out().join("REPORT_COIL_RESIDUAL__residual_field.md").is_file());
    let checked = calfit().args(["verify"]).arg(case.out()).arg(repository("tests/data/bepicolombo")).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
}

#[test]
fn residual_fields_come_back_from_runs_with_both_signs() {
    let mut gauss = Gauss(9);
    let residual_nt = [-2.5, 8.0, -40.0];
    let ideal = Facility { scale: [1.0; 3], offset_nt: residual_nt, angles_deg: [90.0; 3] };
    let axis = |k: usize, v: f64| -> Three { std::array::from_fn(|i| if i == k { v } else { 0.0 }) };
    let settings: Vec<Three> = (0..3).flat_map(|k| [49_000.0, -49_000.0, 49_000.0, -49_000.0].map(|v| axis(k, v))).collect();
    let case = Case::of(ccr(&run(23, &ideal, &settings, &[], &mut gauss)));
    let (status, _, errors) = coil(&case, "residual", &[&case.campaign()], &["--no-plots"]);
    assert_eq!(status, Some(0), "{errors}");
    let file = parameters(&case.out().join("COIL_RESIDUAL__98-03-23_10-49-00.toml"));
    // Two pairs of 0.1 nT noise each: 0.1 / 2 nT.
    close(three(&file, "facility.offset_nt"), residual_nt, 0.2);
    let none = Case::of(ccr(&run(23, &ideal, &directions(&mut gauss), &[], &mut gauss)));
    says(&coil(&none, "residual", &[&none.campaign()], &[]).2, &["plus and minus F", "both signs"]);
}

/// The facility file that the runs of 1998 were evaluated with.
fn facility_file(case: &Case, facility: &Facility) -> PathBuf {
    let Facility { scale, offset_nt, angles_deg } = facility;
    case.put("facility.toml", format!("scale_nt_per_eu = {scale:?}\noffset_nt = {offset_nt:?}\nangles_deg = {angles_deg:?}\n"))
}

#[test]
fn the_printed_runs_of_1998_agree_once_the_facility_is_corrected() {
    let case = Case::new();
    let facility = facility_file(&case, &FACILITY);
    let table = repository("tests/data/champ/runs_ambient.csv");
    let options = ["--facility", facility.to_str().unwrap()];
    let (status, _, errors) = coil(&case, "tilt", &[&table], &options);
    assert_eq!(status, Some(0), "{errors}");
    says(&errors, &["run 18 has no orientation", "-Z +X -Y does not agree with the others"]);
    let file = parameters(&case.out().join("COIL_TILT__1.toml"));
    for i in 0..3 {
        let after = |key: &str| number(&file, &format!("spread_after.{key}.{i}"));
        assert!(after("scale") < 6e-6 && after("offset_nt") < 0.5 && 3600.0 * after("angles_deg") < 2.0);
        let before = |key: &str| number(&file, &format!("spread_before.{key}.{i}"));
        assert!(before("scale") > 1e-5 && before("offset_nt") > 1.8 && 3600.0 * before("angles_deg") > 2.8);
        for key in ["scale_nt_per_eu", "offset_nt", "angles_deg"] {
            assert!(number(&file, &format!("std.{key}.{i}")) > 0.0);
        }
    }
    // Least squares on the means of groups 1 to 3, done apart with numpy's lstsq.
    close(three(&file, "correction.scale"), [1.656_6e-6, -18.283_2e-6, 16.626_5e-6], 1e-9);
    close(three(&file, "correction.offset_nt"), [-3.0, -2.36, -6.315], 1e-9);
    close(three(&file, "correction.angles_deg").map(|a| 3600.0 * a), [-3.9435, -7.5135, -0.8055], 1e-6);
    assert_eq!(file["undetermined"].as_array().unwrap().len(), 1);
    says(file["undetermined"][0].as_str().unwrap(), &["common scale factor"]);
    assert!(case.out().join("COIL_TILT_offset__1.png").is_file());
    let (campaign, data) = (case.campaign(), repository("tests/data/champ"));
    let checked = calfit().args(["verify"]).args([case.out(), campaign, data]).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));

    let (status, _, errors) = coil(&case, "tilt", &[&table], &[&options[..], &["--keep-all", "--no-plots"]].concat());
    assert_eq!(status, Some(0), "{errors}");
    let file = parameters(&case.out().join("COIL_TILT__1.toml"));
    assert!(number(&file, "spread_after.offset_nt.0") > 1.0, "run 17 does not fit the others");
    assert_eq!(file["used"].as_array().unwrap().len(), 13);
}

/// Orientations do not see the common scale factor: its uncertainty is the one that the facility had. The rest is orthogonal to it.
#[test]
fn what_orientations_do_not_see_keeps_the_uncertainty_of_the_facility() {
    let case = Case::new();
    let Facility { scale, offset_nt, angles_deg } = &FACILITY;
    let common = 2e-5;
    let rows: Vec<Vec<f64>> = scale.iter().map(|a| scale.iter().map(|b| common * common * a * b).collect()).collect();
    let facility = case.put(
        "facility.toml",
        format!(
            "scale_nt_per_eu = {scale:?}\noffset_nt = {offset_nt:?}\nangles_deg = {angles_deg:?}\n[covariance]\n\
             parameters = [\"scale_x\", \"scale_y\", \"scale_z\"]\nmatrix = {rows:?}\n"
        ),
    );
    let table = repository("tests/data/champ/runs_ambient.csv");
    let (status, _, errors) = coil(&case, "tilt", &[&table], &["--facility", facility.to_str().unwrap(), "--no-plots"]);
    assert_eq!(status, Some(0), "{errors}");
    let file = parameters(&case.out().join("COIL_TILT__1.toml"));
    let entry = |r: usize, c: usize| number(&file, &format!("covariance.matrix.{r}.{c}"));
    let after = |k: usize| number(&file, &format!("facility.scale_nt_per_eu.{k}"));
    let relative: f64 = (0..9).map(|i| entry(i / 3, i % 3) / (after(i / 3) * after(i % 3))).sum();
    assert!((relative / (9.0 * common * common) - 1.0).abs() < 1e-6, "{relative}");
    assert!((0..3).all(|k| number(&file, &format!("std.scale_nt_per_eu.{k}")) > common * after(k)));
}

fn product(a: &[Three; 3], b: &[Three; 3]) -> [Three; 3] {
    std::array::from_fn(|r| std::array::from_fn(|c| (0..3).map(|k| a[r][k] * b[k][c]).sum()))
}

/// Inverse of an upper triangular matrix.
fn inverse(m: &[Three; 3]) -> [Three; 3] {
    let [[a, b, c], [_, d, e], [_, _, f]] = *m;
    [[1.0 / a, -b / (a * d), (b * e - c * d) / (a * d * f)], [0.0, 1.0 / d, -e / (d * f)], [0.0, 0.0, 1.0 / f]]
}

#[test]
fn sensor_and_facility_come_back_from_three_orientations() {
    let used = Facility { scale: [1.0; 3], offset_nt: [0.0; 3], angles_deg: [90.0; 3] };
    // The mean of the scale factors is one, as nothing tells it.
    let real =
        Facility { scale: [1.000_03, 0.999_98, 0.999_99], offset_nt: [3.0, -5.0, 8.0], angles_deg: [90.003, 89.996, 90.008] };
    let truth = common::Truth { turned_deg: [0.3, -0.2, 0.4], ..common::Truth::default() };
    let wrong = product(&real.matrix(), &inverse(&used.matrix()));
    let mut table =
        "run,orientation,sx_nt_per_eu,sy_nt_per_eu,sz_nt_per_eu,x0_nt,y0_nt,z0_nt,xi_xy_deg,xi_xz_deg,xi_yz_deg\n".to_owned();
    for (i, (orientation, axes)) in
        [("+X +Y +Z", ["+X", "+Y", "+Z"]), ("-Y +X +Z", ["+Y", "-X", "+Z"]), ("-Z +Y +X", ["+Z", "+Y", "-X"])]
            .into_iter()
            .enumerate()
    {
        let place = common::Truth { axes, ..truth.clone() };
        // What a fit against the field of the wrong facility finds: its rows are the sensor axes over the sensitivities.
        let seen = product(&place.response(), &wrong);
        let zero = place.reading(real.offset_nt);
        let size = |r: usize| seen[r].iter().map(|v| v * v).sum::<f64>().sqrt();
        let sigma: Three = std::array::from_fn(|r| 1.0 / size(r));
        let xi = |a: usize, b: usize| {
            let cosine = (0..3).map(|k| seen[a][k] * seen[b][k]).sum::<f64>() / (size(a) * size(b));
            cosine.acos().to_degrees()
        };
        let offset: Three = std::array::from_fn(|r| sigma[r] * zero[r]);
        let cells: Vec<String> =
            [sigma, offset, [xi(0, 1), xi(0, 2), xi(1, 2)]].concat().iter().map(|v| format!("{v:.12}")).collect();
        table.push_str(&format!("r{i},{orientation},{}\n", cells.join(",")));
    }
    let case = Case::new();
    let path = case.put("runs.csv", table);
    let (status, _, errors) = coil(&case, "tilt", &[&path], &["--no-plots"]);
    assert_eq!(status, Some(0), "{errors}");
    says(&errors, &["no --facility"]);
    let file = parameters(&case.out().join("COIL_TILT__r0.toml"));
    // To first order: the second one is the sensor's turn of half a degree times the corrections.
    close(three(&file, "facility.scale_nt_per_eu"), real.scale, 1e-6);
    close(three(&file, "facility.offset_nt"), real.offset_nt, 0.1);
    close(three(&file, "facility.angles_deg"), real.angles_deg, 0.2 / 3600.0);
    close(three(&file, "sensor_parameters.scale"), truth.sigma, 1e-6);
    close(three(&file, "sensor_parameters.angles_deg"), truth.xi_deg, 0.3 / 3600.0);
}

#[test]
fn orientations_that_do_not_tell_are_named_or_refused() {
    let head = "run,orientation,sx_nt_per_eu,sy_nt_per_eu,sz_nt_per_eu,x0_nt,y0_nt,z0_nt,xi_xy_deg,xi_xz_deg,xi_yz_deg\n";
    let case = Case::new();
    let one = case.put("one.csv", format!("{head}1,+X +Y +Z,1,1,1,1,2,3,90,90,90\n2,+X +Y +Z,1,1,1,1,2,3,90,90,90\n"));
    let (status, _, errors) = coil(&case, "tilt", &[&one], &[]);
    assert_eq!(status, Some(1));
    says(&errors, &["one.csv", "1 orientation", "turned by 90°"]);
    // Turned about Z by 180°: the scale factors, the offset along Z and the angle XY stay as they are.
    let half = case.put("half.csv", format!("{head}1,+X +Y +Z,1,1,1,1,2,3,90,90,90\n2,-X -Y +Z,1,1,1,-1,-2,3,90,90,90\n"));
    let (status, _, errors) = coil(&case, "tilt", &[&half], &["--no-plots"]);
    assert_eq!(status, Some(0), "{errors}");
    let file = parameters(&case.out().join("COIL_TILT__1.toml"));
    let named: Vec<&str> = file["undetermined"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
    assert_eq!(named.len(), 5, "{named:?}");
    let about = |what: &str| named.iter().filter(|n| n.starts_with(what)).count();
    assert_eq!((about("scale factors"), about("offset fields"), about("angles")), (3, 1, 1));
    close(three(&file, "facility.offset_nt"), [1.0, 2.0, 0.0], 1e-12);
}

/// Readings in the field that the facility makes of the settings.
fn in_facility(facility: &Facility) -> (Plan, common::Run) {
    let settings = programme(&[-40_000.0, -20_000.0, 20_000.0, 40_000.0], 2.0);
    let mut driven = settings.clone();
    driven.iter_mut().for_each(|s| s.field = facility.field(s.field));
    let plan = Plan { settings: driven, noise_ent: 0.05, ..Plan::default() };
    let mut run = plan.run().key("coil_correction", "false");
    run.settings = settings;
    (plan, run)
}

#[test]
fn lin_applies_a_facility_to_the_reference_field() {
    let (plan, run) = in_facility(&FACILITY);
    let case = Case::of(run.text());
    let facility = facility_file(&case, &FACILITY);
    let messages = case.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
    assert!(!messages.contains("facility"), "{messages}");
    let with = case.cpf();
    close(sigma(&with), plan.truth.sigma, 1e-6);
    close(
        [number(&with, "angle_deg.xi_xy"), number(&with, "angle_deg.xi_xz"), number(&with, "angle_deg.xi_yz")],
        plan.truth.xi_deg,
        1e-4,
    );
    close(three(&with, "offset.b_or_ent"), plan.truth.reading([0.0; 3]), 0.05);
    assert_eq!(with["facility"]["file"].as_str(), Some("facility.toml"));
    close(three(&with, "facility.applied.scale_nt_per_eu"), SCALE, 0.0);
    let inputs = with["provenance"]["input"].as_array_of_tables().unwrap();
    assert!(inputs.iter().any(|i| i["path"].as_str() == Some("facility.toml")));
    let checked = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));

    case.done(&["--order", "0"]);
    let without = cpf(&case.out(), common::RUN_ID);
    assert!((sigma(&without)[0] / plan.truth.sigma[0] - 1.0).abs() > 5e-5, "the settings are not the field");
    assert!(without.get("facility").is_none());
}

#[test]
fn a_facility_that_cannot_be_used_is_refused_and_a_second_correction_is_warned_of() {
    let (_, run) = in_facility(&FACILITY);
    let case = Case::of(run.key("coil_correction", "true").text());
    let facility = facility_file(&case, &FACILITY);
    says(&case.done(&["--facility", facility.to_str().unwrap()]), &["corrects them once more"]);
    let broken = case.put("broken.toml", "scale_nt_per_eu = [1, 1, 1]\noffset_nt = [0, 0, 0]\n");
    let output = case.lin(&["--facility", broken.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["broken.toml", "angles_deg", "missing"]);
    // `check` takes both for what they are.
    for (file, status) in [(&facility, 0), (&broken, 1)] {
        let output = calfit().arg("check").arg(file).output().unwrap();
        assert_eq!(output.status.code(), Some(status), "{}", text(&output.stderr));
        assert_eq!(text(&output.stderr).contains("angles_deg"), status == 1, "{}", text(&output.stderr));
    }
}

#[test]
fn runs_in_several_orientations_give_the_facility_from_their_parameter_files_and_from_themselves() {
    let mut paths = Vec::new();
    let case = Case::new();
    let real =
        Facility { scale: [1.000_03, 0.999_98, 0.999_99], offset_nt: [3.0, -5.0, 8.0], angles_deg: [90.003, 89.996, 90.008] };
    let used = Facility { scale: [1.0; 3], offset_nt: [0.0; 3], angles_deg: [90.0; 3] };
    let positions = [(1, ["+X", "+Y", "+Z"]), (2, ["+Y", "-X", "+Z"]), (3, ["+Z", "+Y", "-X"])];
    case.put("campaign.toml", common::position_table(&positions));
    for (id, _) in positions {
        let settings: Vec<common::Setting> = programme(&[-40_000.0, -20_000.0, 20_000.0, 40_000.0], 2.0)
            .into_iter()
            .map(|s| common::Setting { position: id, ..s })
            .collect();
        let driven = settings.iter().map(|s| common::Setting { field: real.field(s.field), ..*s }).collect();
        let plan =
            Plan { settings: driven, positions: positions.to_vec(), noise_ent: 0.02, seed: u64::from(id), ..Plan::default() };
        let name = format!("13-04-03_0{id}-00-00");
        let mut run = plan.run().key("coil_correction", "false").named(&name);
        run.settings = settings;
        case.put(&format!("13-04-03/0{id}-00-00.CCR"), run.text());
        paths.push(case.out().join(&name).join(format!("PARAMETER_LIN__{name}.CPF")));
    }
    let facility = facility_file(&case, &used);
    let options = ["--facility", facility.to_str().unwrap(), "--no-plots"];
    assert_eq!(case.lin(&[&options[..], &["--order", "0"]].concat()).status.code(), Some(0));
    let files: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
    let campaign = case.campaign();
    // The parameter files say which facility they were made with.
    for (paths, options) in [(files, &["--no-plots"][..]), (vec![campaign.as_path()], &options[..])] {
        let (status, _, errors) = coil(&case, "tilt", &paths, options);
        assert_eq!(status, Some(0), "{errors}");
        assert!(!errors.contains("no --facility"), "{errors}");
        let file = parameters(&case.out().join("COIL_TILT__13-04-03_01-00-00.toml"));
        close(three(&file, "facility.scale_nt_per_eu"), real.scale, 2e-6);
        close(three(&file, "facility.offset_nt"), real.offset_nt, 0.2);
        close(three(&file, "facility.angles_deg"), real.angles_deg, 0.5 / 3600.0);
    }
    // The scale factor that coils and sensor have in common is not known from turning the sensor, and who uses the file is told.
    let tilt = case.out().join("COIL_TILT__13-04-03_01-00-00.toml");
    let case_of = Case::of(std::fs::read_to_string(case.campaign().join("13-04-03/01-00-00.CCR")).unwrap());
    case_of.done(&["--facility", tilt.to_str().unwrap(), "--order", "0"]);
    let file = cpf(&case_of.out(), "13-04-03_01-00-00");
    says(
        &file["warnings"].to_string(),
        &["COIL_TILT__13-04-03_01-00-00.toml: its runs leave undetermined", "the common scale factor of coil system"],
    );
    assert!(file["warning_kinds"].to_string().contains("facility"), "{}", file["warning_kinds"]);
    // Sensitivities and offsets belong to a mode.
    let run = case.campaign().join("13-04-03/03-00-00.CCR");
    let text = std::fs::read_to_string(&run).unwrap();
    let mode = text.lines().find(|l| l.starts_with("mode = ")).unwrap();
    std::fs::write(&run, text.replace(mode, "mode = \"another\"")).unwrap();
    let (status, _, errors) = coil(&case, "tilt", &[&campaign], &options);
    assert_eq!(status, Some(1), "{errors}");
    says(&errors, &["in several modes: another, ", "name the runs of one mode"]);
}

/// Readings in four positions in the field that the facility makes of the settings without its own offset field.
fn turned_in(facility: &Facility, residual_nt: Three) -> (Plan, Case) {
    let settings = common::in_positions(&[1, 2, 3, 4], &common::offset_fields(), 4.0);
    let driven = |s: &common::Setting| {
        let field = Facility { offset_nt: [0.0; 3], ..*facility }.field(s.field);
        common::Setting { field, ..*s }
    };
    let plan = Plan {
        settings: settings.iter().map(driven).collect(),
        positions: common::POSITIONS.to_vec(),
        residual_nt,
        noise_ent: 0.05,
        ..Plan::default()
    };
    let mut run = plan.run().key("kind", "\"offset\"").key("coil_correction", "false");
    run.settings = settings;
    let case = Case::of(run.text());
    case.put("campaign.toml", common::position_table(&common::POSITIONS));
    (plan, case)
}

#[test]
fn offset_takes_scale_factors_and_angles_but_measures_the_offset_field_itself() {
    let residual_nt = [4.0, -7.0, 11.0];
    let facility = Facility { scale: [1.02, 0.99, 1.01], ..FACILITY };
    let (plan, case) = turned_in(&facility, residual_nt);
    let path = facility_file(&case, &facility);
    let output = case.run("offset", &["--no-plots", "--facility", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let opf = parameters(&case.out().join("13-04-03_09-22-38/OFF_PARAMETER__13-04-03-09-22-38.OPF"));
    close(three(&opf, "offset_ent"), plan.truth.offset_ent, 0.1);
    // Without the facility the response and with it the residual field in nT would be wrong by up to two per cent, 0.2 nT.
    close(three(&opf, "residual_coil_nt"), residual_nt, 0.08);
    close(three(&opf, "facility.applied.offset_nt"), [0.0; 3], 0.0);
    let checked = calfit().arg("verify").args([case.out(), case.campaign()]).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
}

/// With fields that are `(1 + E)` times those of the file, the response that every position shows is `A (1 + E)`, so that what it shows of the
/// residual field stays and the residual field in coil axes becomes `(1 + E)⁻¹ B_res`; E has the relative errors of the coils.
#[test]
fn an_error_of_the_facility_stays_in_the_residual_field_of_the_coils_and_cancels_in_the_offset() {
    let (_, case) = turned_in(&FACILITY, [40.0, -70.0, 110.0]);
    let facility = case.put("facility.toml", with_covariance(SCALE, OFFSET_NT));
    let arguments = ["--no-plots", "--facility", facility.to_str().unwrap()];
    let output = case.run("offset", &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let path = case.out().join("13-04-03_09-22-38/OFF_PARAMETER__13-04-03-09-22-38.OPF");
    let opf = parameters(&path);
    let of = |key: &str| three(&opf, key);
    close(of("std_b.offset_ent"), [0.0; 3], 0.0);
    close(of("std_b.residual_ent"), [0.0; 3], 0.0);
    let residual_nt = of("residual_coil_nt");
    let expected = [1e-5 * residual_nt[0] / SCALE[0], 2e-5 * residual_nt[1] / SCALE[1], 0.0];
    // The angles between the coils differ from right ones by less than a thousandth.
    close(of("std_b.residual_coil_nt"), expected.map(f64::abs), 1e-3 * expected[1].abs());
    let parameters_of = opf["covariance_b"]["parameters"].as_array().unwrap();
    let place = |name: &str| parameters_of.iter().position(|p| p.as_str() == Some(name)).unwrap();
    let entry = |a: &str, b: &str| opf["covariance_b"]["matrix"][place(a)][place(b)].as_float().unwrap();
    let both = entry("residual_coil_x", "residual_coil_y");
    assert!((both / (0.8 * expected[0] * expected[1]) - 1.0).abs() < 5e-3, "{both}");
    assert_eq!(entry("offset_x", "offset_x"), 0.0);
    for (key, std) in [("offset_ent", "offset_std_ent"), ("residual_coil_nt", "residual_coil_std_nt")] {
        for k in 0..3 {
            let [a, b, both] = [std, &format!("std_b.{key}"), &format!("std_combined.{key}")].map(|key| of(key)[k]);
            assert!((both - a.hypot(b)).abs() <= 1e-12 * both, "{key} {a} {b} {both}");
        }
    }
    says(opf["method"]["std_b_covers"].as_str().unwrap(), &["cancels in offset_ent", "stays in residual_coil_nt"]);
    let checked = calfit().arg("verify").args([case.out(), case.campaign()]).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
    let read = calfit().arg("check").arg(&path).output().unwrap();
    assert_eq!(read.status.code(), Some(0), "{}", text(&read.stderr));
    // A facility of which no uncertainty is stated adds none.
    let plain = case.put("facility.toml", with_covariance(SCALE, OFFSET_NT).split("[covariance]").next().unwrap());
    let arguments = ["--no-plots", "--force", "--facility", plain.to_str().unwrap()];
    let output = case.run("offset", &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let without = parameters(&path);
    assert!(without.get("std_b").is_none() && without["method"].get("std_b_covers").is_none());
    close(three(&without, "offset_std_ent"), of("offset_std_ent"), 0.0);
}

#[test]
fn a_simulated_campaign_has_its_coil_system_back() {
    let case = Case::new();
    let twin = std::fs::read_to_string(repository("configs/demo.toml")).unwrap();
    let (head, _) = twin.split_once("[[run]]").unwrap();
    let changed = head
        .replace("scale_nt_per_eu = [1.0, 1.0, 1.0]", &format!("scale_nt_per_eu = {SCALE:?}"))
        .replace("angles_deg = [90.0, 90.0, 90.0]", &format!("angles_deg = {ANGLES_DEG:?}"))
        .replace("\noffset_nt = [0.0, 0.0, 0.0]", &format!("\noffset_nt = {OFFSET_NT:?}"))
        .replace("field_nt = [-0.4, 0.2, -7.0]", "field_nt = [0.0, 0.0, 0.0]")
        .replace("leakage = [5e-4, 5e-4, 5e-4]", "leakage = [0.0, 0.0, 0.0]");
    let run = "[[run]]\nstart = \"2026-03-02T07:00:00Z\"\nprogramme = \"SCALAR_83.MAG\"\nsensor = \"FGM\"\nmode = \"science\"\n";
    let twin = case.put("twin.toml", format!("{changed}{run}"));
    std::fs::copy(repository("configs/SCALAR_83.MAG"), case.campaign().join("SCALAR_83.MAG")).unwrap();
    let simulated = case.path().join("simulated");
    let output = calfit().arg("simulate").arg(&twin).arg("-o").arg(&simulated).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let (status, _, errors) = coil(&case, "scalar", &[&simulated], &[]);
    assert_eq!(status, Some(0), "{errors}");
    let file = parameters(&case.out().join("COIL_SCALAR__26-03-02_07-00-00.toml"));
    close(three(&file, "facility.scale_nt_per_eu"), SCALE, 2e-6);
    close(three(&file, "facility.offset_nt"), OFFSET_NT, 0.1);
    close(three(&file, "facility.angles_deg"), ANGLES_DEG, 1.0 / 3600.0);
    assert!(case.out().join("COIL_SCALAR_residuals_x__26-03-02_07-00-00.png").is_file());
    // The result is a facility file itself.
    let (_, run) = in_facility(&FACILITY);
    let linear = Case::of(run.text());
    let found = case.out().join("COIL_SCALAR__26-03-02_07-00-00.toml");
    linear.done(&["--facility", found.to_str().unwrap(), "--order", "0"]);
    close(sigma(&linear.cpf()), common::Truth::default().sigma, 3e-6);
}

#[test]
fn lin_applies_the_temperatures_of_coil_and_rack() {
    // Ten times the coefficients of CH-GFZ-TR-2601 section 6 and more, at 20.5 °C of the coils and 30 °C of the rack.
    let (rack_scale_per_k, rack_offset_per_k) = ([-8e-6, 5e-6, 3e-6], [0.75, 0.0, 2.0]);
    let (coil_k, rack_k) = (20.5 - 16.5, 30.0 - 32.0);
    let real = Facility {
        scale: std::array::from_fn(|k| SCALE[k] * (1.0 + SCALE_PER_K[k] * coil_k) * (1.0 + rack_scale_per_k[k] * rack_k)),
        offset_nt: std::array::from_fn(|k| OFFSET_NT[k] + OFFSET_PER_K[k] * coil_k + rack_offset_per_k[k] * rack_k),
        ..FACILITY
    };
    let (plan, run) = in_facility(&real);
    let with_rack = |channel: &str| {
        let rows = format!("@CHANNELS\nt,{channel}\n0,30.0\n30,30.0\n@VECTORS");
        Case::of(run.text().replacen("@VECTORS", &rows, 1))
    };
    let facility = |case: &Case| {
        let text = format!(
            "scale_nt_per_eu = {SCALE:?}\noffset_nt = {OFFSET_NT:?}\nangles_deg = {ANGLES_DEG:?}\nreference_degc = 16.5\n\
             scale_per_k = {SCALE_PER_K:?}\noffset_nt_per_k = {OFFSET_PER_K:?}\nrack_reference_degc = 32.0\n\
             rack_scale_per_k = {rack_scale_per_k:?}\nrack_offset_nt_per_k = {rack_offset_per_k:?}\n"
        );
        case.put("facility.toml", text).to_str().unwrap().to_owned()
    };
    let named = with_rack("RACK");
    named.put("campaign.toml", "rack_temperature_channel = \"RACK\"\n");
    for case in [with_rack("T55"), named] {
        let messages = case.done(&["--facility", &facility(&case), "--order", "0"]);
        assert!(!messages.contains("rack"), "{messages}");
        let file = case.cpf();
        close(sigma(&file), plan.truth.sigma, 1e-6);
        close(three(&file, "offset.b_or_ent"), plan.truth.reading([0.0; 3]), 0.05);
        assert!((number(&file, "facility.rack_degc") - 30.0).abs() < 1e-12);
        assert!((number(&file, "facility.coil_degc") - 20.5).abs() < 1e-12);
    }
    let case = Case::of(run.text());
    says(
        &case.done(&["--facility", &facility(&case), "--order", "0"]),
        &["rack temperature", "channel T55", "32.0 °C were used"],
    );
    let file = case.cpf();
    assert!(file["facility"].get("rack_degc").is_none());
    // What the rack did is now in the sensitivities: nT per enT are as much too large as the fields were taken too large.
    let wanted: Three = std::array::from_fn(|k| plan.truth.sigma[k] / (1.0 + rack_scale_per_k[k] * rack_k));
    close(sigma(&file), wanted, 1.5e-6);
}

/// Coils at 20.5 °C: a facility that was measured up to 20 °C holds there, one that was measured up to 17 °C is extrapolated.
#[test]
fn a_facility_beyond_the_temperatures_of_its_own_calibration_is_told() {
    let (_, run) = in_facility(&FACILITY);
    let case = Case::of(run.text());
    for (highest, is_told) in [(20.0, false), (17.0, true)] {
        let text = format!("{}[valid]\ncoil_degc = [15.0, {highest:?}]\n", with_coefficients(OFFSET_NT));
        let facility = case.put("facility.toml", text);
        let messages = case.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
        assert_eq!(messages.contains("coefficients are extrapolated"), is_told, "{messages}");
        // One calibration alone has no coefficients, and holds where it was made all the same.
        let text = format!(
            "scale_nt_per_eu = {SCALE:?}\noffset_nt = {OFFSET_NT:?}\nangles_deg = {ANGLES_DEG:?}\n[valid]\ncoil_degc = [15.0, {highest:?}]\n"
        );
        let facility = case.put("constant.toml", text);
        let messages = case.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
        let words = "is used from 20.5 to 20.5 °C: it has no coefficients of the coil temperature";
        assert_eq!(messages.contains(words), is_told, "{messages}");
        // The published ones of CH-GFZ-TR-2601, beyond the calibration: 1.9e-5 per kelvin in all axes together, and 0.25e-5 in each by itself.
        let file = case.cpf();
        let beyond_k = 20.5 - highest;
        let expected = sigma(&file).map(|sigma| beyond_k * sigma * 1.9e-5_f64.hypot(0.25e-5));
        three(&file, "std_b.sigma").iter().zip(expected).for_each(|(found, wanted)| {
            assert!((found / wanted - 1.0).abs() < 0.01, "{highest}: {found} {wanted}");
        });
    }
}

/// A facility whose coils have 1.9e-5, 1.65e-5 and 1.75e-5 per kelvin, in a file.
fn with_coefficients(offset_nt: Three) -> String {
    format!(
        "scale_nt_per_eu = {SCALE:?}\noffset_nt = {offset_nt:?}\nangles_deg = {ANGLES_DEG:?}\nreference_degc = 16.5\n\
         scale_per_k = {SCALE_PER_K:?}\noffset_nt_per_k = {OFFSET_PER_K:?}\n"
    )
}

/// A run of 16 settings of 2 s in a facility whose coils X, Y and Z warm up by 0.2, -0.1 and 0.05 K/s.
fn while_the_coils_warm_up() -> (Plan, String) {
    let settings = programme(&[-40_000.0, -20_000.0, 20_000.0, 40_000.0], 2.0);
    let degc = |t_s: f64| [16.5 + 0.2 * t_s, 20.0 - 0.1 * t_s, 15.0 + 0.05 * t_s];
    let driven = settings.iter().map(|s| {
        let coil_k = degc(0.5 * (s.t_start + s.t_end)).map(|t| t - 16.5);
        let real = Facility {
            scale: std::array::from_fn(|k| SCALE[k] * (1.0 + SCALE_PER_K[k] * coil_k[k])),
            offset_nt: std::array::from_fn(|k| OFFSET_NT[k] + OFFSET_PER_K[k] * coil_k[k]),
            ..FACILITY
        };
        common::Setting { field: real.field(s.field), ..*s }
    });
    let plan = Plan { settings: driven.collect(), noise_ent: 0.05, ..Plan::default() };
    let mut run = plan.run().key("coil_correction", "false");
    run.settings = settings;
    let mut rows = "@CHANNELS\nt,T_X,T_Y,T_Z\n".to_owned();
    for i in 0..=320 {
        let [x, y, z] = degc(0.1 * f64::from(i));
        rows.push_str(&format!("{:.1},{x:.4},{y:.4},{z:.4}\n", 0.1 * f64::from(i)));
    }
    (plan, run.text().replacen("@VECTORS", &format!("{rows}@VECTORS"), 1))
}

#[test]
fn every_setting_has_the_temperatures_of_its_own_time_and_coil() {
    let (plan, text) = while_the_coils_warm_up();
    let case = Case::of(text);
    case.put("campaign.toml", "coil_temperature_channels = [\"T_X\", \"T_Y\", \"T_Z\"]\n");
    let facility = case.put("facility.toml", with_coefficients(OFFSET_NT));
    let messages = case.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
    assert!(!messages.contains("coil temperature"), "{messages}");
    let file = case.cpf();
    // The X coil is driven between 2 and 12 s: with the mean of the run its sensitivity would be off by 3.4e-5.
    close(sigma(&file), plan.truth.sigma, 1e-6);
    close(three(&file, "offset.b_or_ent"), plan.truth.reading([0.0; 3]), 0.05);
    let [low, high] = [0, 1].map(|i| file["facility"]["coil_range_degc"][i].as_float().unwrap());
    assert!((15.0..15.2).contains(&low) && (22.6..22.9).contains(&high), "{low} {high}");
    // One name only is the channel of all coils.
    let one = Case::of(while_the_coils_warm_up().1);
    one.put("campaign.toml", "coil_temperature_channel = \"T_X\"\n");
    let facility = one.put("facility.toml", with_coefficients(OFFSET_NT));
    one.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
    assert!((sigma(&one.cpf())[1] / plan.truth.sigma[1] - 1.0).abs() > 1e-5);
    let wrong = Case::of(while_the_coils_warm_up().1);
    wrong.put("campaign.toml", "coil_temperature_channels = [\"T_X\", \"T_Y\"]\n");
    says(&text_of(&wrong.lin(&[])), &["coil_temperature_channels", "three names"]);
}

fn text_of(output: &std::process::Output) -> String {
    text(&output.stderr)
}

#[test]
fn settings_without_a_temperature_near_them_are_counted() {
    let (_, mut text) = while_the_coils_warm_up();
    // The channels end after 8 s, where the fifth setting begins; the readings come every 0.1 s.
    let from = text.find("\n8.1,").unwrap();
    let to = text.find("@VECTORS").unwrap();
    text.replace_range(from + 1..to, "");
    let case = Case::of(text);
    case.put("campaign.toml", "coil_temperature_channels = [\"T_X\", \"T_Y\", \"T_Z\"]\n");
    let facility = case.put("facility.toml", with_coefficients(OFFSET_NT));
    let messages = case.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
    says(&messages, &["11 of 16 settings have no reading of the coil temperature (channel T_X) near them", "channel T_Z"]);
}

#[test]
fn a_facility_holds_in_its_periods_only() {
    // The run of 2013-04-03 begins at 09:22:38 and lasts for 32 s.
    let (plan, run) = in_facility(&FACILITY);
    let period = |from: &str, to: &str, offset_nt: Three| {
        let bound = |key: &str, text: &str| if text.is_empty() { String::new() } else { format!("{key} = \"{text}\"\n") };
        let values = format!("scale_nt_per_eu = {SCALE:?}\noffset_nt = {offset_nt:?}\nangles_deg = {ANGLES_DEG:?}\n");
        format!("[[period]]\n{}{}{values}", bound("from", from), bound("to", to))
    };
    let fitted = |periods: &[String]| {
        let case = Case::of(run.text());
        let facility = case.put("facility.toml", periods.concat());
        let output = case.lin(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
        (case, output)
    };
    let later = [2.0, -102.2, -1.2];
    for (periods, first) in [
        ([period("", "2013-04-03T09:00:00Z", later), period("2013-04-03T09:00:00Z", "", OFFSET_NT)], "2013-04-03T09:00:00Z"),
        (
            [period("2013-04-03T09:30:00Z", "", later), period("2013-04-01T00:00:00Z", "2013-04-03T09:30:00Z", OFFSET_NT)],
            "2013-04-01T00:00:00Z",
        ),
    ] {
        let (case, output) = fitted(&periods);
        assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
        let file = case.cpf();
        close(three(&file, "offset.b_or_ent"), plan.truth.reading([0.0; 3]), 0.05);
        assert_eq!(file["facility"]["period"]["from"].as_str(), Some(first));
    }
    let (_, output) =
        fitted(&[period("2013-04-04T00:00:00Z", "2013-04-05T00:00:00Z", later), period("2013-04-06T00:00:00Z", "", later)]);
    assert_eq!(output.status.code(), Some(1));
    says(
        &text_of(&output),
        &[
            "facility.toml holds from 2013-04-04T00:00:00Z to 2013-04-05T00:00:00Z; from 2013-04-06T00:00:00Z on",
            "the run lasts from 2013-04-03T09:22:38Z to 2013-04-03T09:23:10Z",
            "name a facility file that holds at the time of the run",
        ],
    );
    // Eight settings of 2 s before the boundary, eight after it.
    let (_, output) = fitted(&[period("", "2013-04-03T09:22:54Z", OFFSET_NT), period("2013-04-03T09:22:54Z", "", OFFSET_NT)]);
    assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
    says(
        &text_of(&output),
        &["goes on across a boundary of facility.toml", "8 settings with the values that hold until 2013-04-03T09:22:54Z"],
    );
    let (_, output) = fitted(&[period("", "2013-04-03T10:00:00Z", later), period("2013-04-03T09:00:00Z", "", OFFSET_NT)]);
    assert_eq!(output.status.code(), Some(2));
    says(&text_of(&output), &["facility.toml", "`period` overlaps another"]);
}

/// Facility values with the covariance of two of them: relative errors of the X and Y coils of 1e-5 and 2e-5 that go together by 0.8, and an
/// offset field of X known to 0.5 nT.
fn with_covariance(scale: Three, offset_nt: Three) -> String {
    format!(
        "scale_nt_per_eu = {scale:?}\noffset_nt = {offset_nt:?}\nangles_deg = {ANGLES_DEG:?}\n[covariance]\n\
         parameters = [\"scale_x\", \"scale_y\", \"offset_x\"]\n\
         matrix = [[1e-10, 1.6e-10, 0.0], [1.6e-10, 4e-10, 0.0], [0.0, 0.0, 0.25]]\n"
    )
}

#[test]
fn the_uncertainty_of_the_facility_stands_beside_that_of_the_run() {
    let (plan, run) = in_facility(&FACILITY);
    let fitted = |text: String| {
        let case = Case::of(run.text());
        let facility = case.put("facility.toml", text);
        case.done(&["--facility", facility.to_str().unwrap(), "--order", "0"]);
        case.cpf()
    };
    let file = fitted(with_covariance(SCALE, OFFSET_NT));
    let of = |key: &str| three(&file, key);
    let sigma = plan.truth.sigma;
    // The sensor stands as the coils do: an error of a coil is one of the sensitivity along it, and the offset field one of B_or.
    close(of("std_b.sigma"), [1e-5 * sigma[0] / SCALE[0], 2e-5 * sigma[1] / SCALE[1], 0.0], 3e-8);
    assert!((of("std_b.b_or_ent")[0] - 0.5 / sigma[0]).abs() < 5e-3, "{:?}", of("std_b.b_or_ent"));
    for key in ["sigma", "b_or_ent", "xi_deg"] {
        for k in 0..3 {
            let [a, b, both] = ["std", "std_b", "std_combined"].map(|table| of(&format!("{table}.{key}"))[k]);
            assert!((both - a.hypot(b)).abs() <= 1e-12 * both, "{key} {a} {b} {both}");
        }
    }
    // What the covariance says is what calibrations with the moved facility do: along the two directions of the two coils, and the offset.
    let names: Vec<String> = ["phi_xx", "phi_yy"].map(str::to_owned).to_vec();
    let stated = file["covariance_b"]["parameters"].as_array().unwrap();
    let place = |name: &String| stated.iter().position(|p| p.as_str() == Some(name)).unwrap();
    let entry = |i: usize, k: usize| file["covariance_b"]["matrix"][place(&names[i])][place(&names[k])].as_float().unwrap();
    let phi = |file: &toml_edit::DocumentMut, k: usize| file["matrix"]["phi"][k][k].as_float().unwrap();
    // Columns of the Cholesky factor of the covariance.
    let moves = [[1e-5, 1.6e-5], [0.0, (4e-10f64 - 2.56e-10).sqrt()]];
    let moved: Vec<[f64; 2]> = moves
        .iter()
        .map(|[x, y]| {
            let other = fitted(with_covariance([SCALE[0] + x, SCALE[1] + y, SCALE[2]], OFFSET_NT));
            [0, 1].map(|k| phi(&other, k) - phi(&file, k))
        })
        .collect();
    for (i, k) in [(0, 0), (0, 1), (1, 1)] {
        let expected: f64 = moved.iter().map(|m| m[i] * m[k]).sum();
        assert!((entry(i, k) / expected - 1.0).abs() < 1e-3, "{i} {k}: {} is not {expected}", entry(i, k));
    }
    says(file["convention"]["uncertainty"].as_str().unwrap(), &["of type A", "in std_b", "in std_combined"]);
    let without = fitted(with_covariance(SCALE, OFFSET_NT).split("[covariance]").next().unwrap().to_owned());
    assert!(without.get("std_b").is_none() && without.get("covariance_combined").is_none());
    says(without["convention"]["uncertainty"].as_str().unwrap(), &["coil constants and coil angles not included"]);
    close(three(&without, "std.sigma"), of("std.sigma"), 0.0);
}

#[test]
fn polynomials_keep_what_the_runs_share_of_the_facility() {
    let case = Case::new();
    let half = 0.5_f64.sqrt();
    let instructions = std::fs::read_to_string(case.campaign().join("campaign.toml")).unwrap_or_default();
    let reference = format!(
        "\n[[reference]]\nsensor = \"BS_11\"\nrotation = [[{half}, {half}, 0.0], [-{half}, {half}, 0.0], [0.0, 0.0, 1.0]]\nstd_deg = 0.0\n"
    );
    case.put("campaign.toml", instructions + &reference);
    let facility = case.put("facility.toml", with_covariance(SCALE, OFFSET_NT));
    let mut files = Vec::new();
    for (i, degc) in [0.0, 10.0, 20.0, 30.0, 40.0, 50.0].into_iter().enumerate() {
        let (_, mut run) = in_facility(&FACILITY);
        run.temperatures = (0..=4).map(|i| (8.0 * f64::from(i), [Some(20.5), Some(degc)])).collect();
        let name = format!("13-04-03_1{i}-00-00");
        case.put(&format!("13-04-03/1{i}-00-00.CCR"), run.named(&name).text());
        files.push(case.out().join(&name).join(format!("PARAMETER_LIN__{name}.CPF")));
    }
    let options = ["--facility", facility.to_str().unwrap(), "--no-plots"];
    assert_eq!(case.lin(&[&options[..], &["--order", "0"]].concat()).status.code(), Some(0));
    let out = case.out().join("thermal");
    let output =
        calfit().arg("thermal").args(&files).args(["--no-plots", "--order", "sigma=1", "-o"]).arg(&out).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
    let tpf = parameters(&out.join("THERMAL_PARAMETER__13-04-03-10-00-00.TPF"));
    let entry = |table: &str, quantity: &str| tpf[table][quantity][0][0].as_float().unwrap();
    // Six runs share one error of 1e-5: their mean has it as well.
    let expected = 1e-5 * Plan::default().truth.sigma[0] / SCALE[0];
    assert!((entry("covariance_b", "sigma_x").sqrt() / expected - 1.0).abs() < 0.01);
    assert!((tpf["covariance_b"]["sigma_x"][1][1].as_float().unwrap()).sqrt() < 1e-3 * expected);
    for quantity in ["sigma_x", "b_or_x", "xi_xy"] {
        let sum = entry("covariance", quantity) + entry("covariance_b", quantity);
        assert!((entry("covariance_combined", quantity) / sum - 1.0).abs() < 1e-12);
    }
    // A cube turned by 45° about z sees both coils along its x and y: their errors of 1e-5 and 2e-5, correlated by 0.8, and that of 0.5 nT.
    let table = case.put("readings.csv", "x,y,z,t_degc\n30000,30000,0,25\n");
    let applied = case.out().join("applied");
    let tpf_path = out.join("THERMAL_PARAMETER__13-04-03-10-00-00.TPF");
    let output =
        calfit().arg("apply").arg(tpf_path).arg(table).args(["--frame", "reference", "-o"]).arg(&applied).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
    let csv = std::fs::read_to_string(applied.join("readings.calibrated.csv")).unwrap();
    let mut lines = csv.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(',').collect::<Vec<_>>());
    let (names, row) = (lines.next().unwrap(), lines.next().unwrap());
    let value = |name: &str| row[names.iter().position(|own| *own == name).unwrap()].parse::<f64>().unwrap();
    let [b_x, b_y] = [0, 1].map(|k| 30_000.0 * Plan::default().truth.sigma[k]);
    let (own, both) = ((1e-10 * b_x * b_x + 4e-10 * b_y * b_y + 0.25) / 2.0, 1.6e-10 * b_x * b_y);
    for (name, variance) in [("u_bx_nt", own + both), ("u_by_nt", own - both)] {
        // The noise of the runs is a hundredth of it.
        assert!((value(name) / variance.sqrt() - 1.0).abs() < 0.03, "{name} {} is not {}", value(name), variance.sqrt());
    }
    // The joint fit is of the same runs with the same orders, and has the same error.
    let joint = case.out().join("joint");
    let output = calfit()
        .arg("thermal")
        .arg(case.campaign())
        .args(["--no-plots", "--joint", "--order", "sigma=1", "--facility", facility.to_str().unwrap(), "-o"])
        .arg(&joint)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
    let tpf = parameters(&joint.join("THERMAL_PARAMETER__13-04-03-10-00-00.TPF"));
    let entry = |table: &str, quantity: &str| tpf["joint"][table][quantity][0][0].as_float().unwrap();
    assert!((entry("covariance_b", "sigma_x").sqrt() / expected - 1.0).abs() < 0.01);
    for quantity in ["sigma_x", "sigma_y", "xi_xy"] {
        let sum = entry("covariance", quantity) + entry("covariance_b", quantity);
        assert!((entry("covariance_combined", quantity) / sum - 1.0).abs() < 1e-12);
    }
    // Its coefficients together: of one quantity what stands beside it, of two a covariance that is possible.
    let together = &tpf["joint"]["together"];
    let names: Vec<&str> = together["parameters"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    let at = |a: &str, b: &str| {
        let [row, column] = [a, b].map(|name| names.iter().position(|n| *n == name).unwrap());
        together["matrix"][row][column].as_float().unwrap()
    };
    let own = |k: usize, l: usize| tpf["joint"]["covariance"]["sigma_x"][k][l].as_float().unwrap();
    assert!((0..2).all(|k| (0..2).all(|l| at(&format!("sigma_x.{k}"), &format!("sigma_x.{l}")) == own(k, l))));
    let (x, y, both) = (at("sigma_x.0", "sigma_x.0"), at("sigma_y.0", "sigma_y.0"), at("sigma_x.0", "sigma_y.0"));
    assert!(both != 0.0 && both * both < x * y, "{both} {x} {y}");
    // What is applied has both.
    let reading = case.put("reading.csv", "t,x,y,z,t_degc\n0,30000,0,0,25\n");
    let output = calfit()
        .arg("apply")
        .arg(out.join("THERMAL_PARAMETER__13-04-03-10-00-00.TPF"))
        .arg(&reading)
        .arg("-o")
        .arg(&out)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
    let table = std::fs::read_to_string(out.join("reading.calibrated.csv")).unwrap();
    let mut lines = table.lines().filter(|l| !l.starts_with('#'));
    let at = lines.next().unwrap().split(',').position(|c| c == "u_bx_nt").unwrap();
    let u_nt: f64 = lines.next().unwrap().split(',').nth(at).unwrap().parse().unwrap();
    // 0.3 nT of the coil and 0.5 nT of the offset field.
    assert!((0.5..0.7).contains(&u_nt), "{u_nt}");
}

/// A temperature coefficient of the coils that is known to 1e-6 per kelvin, and coils that are warmer by a tenth of a kelvin for every kelvin
/// of the sensor: below their reference temperature it makes sensitivities smaller, above larger, so that the slope over the sensor temperature
/// is uncertain by a tenth of it, however many runs there are.
#[test]
fn an_uncertain_coefficient_of_the_coils_makes_slopes_over_the_sensor_temperature_uncertain() {
    const STD_PER_K: f64 = 1e-6;
    let case = Case::new();
    let text = format!(
        "scale_nt_per_eu = {SCALE:?}\noffset_nt = {OFFSET_NT:?}\nangles_deg = {ANGLES_DEG:?}\nreference_degc = 20.5\n\
         scale_per_k = [0.0, 0.0, 0.0]\noffset_nt_per_k = [0.0, 0.0, 0.0]\n[covariance]\nparameters = [\"scale_per_k_x\"]\n\
         matrix = [[{:e}]]\n",
        STD_PER_K * STD_PER_K
    );
    let facility = case.put("facility.toml", text);
    for (i, degc) in [0.0, 10.0, 20.0, 30.0, 40.0, 50.0].into_iter().enumerate() {
        let (_, mut run) = in_facility(&FACILITY);
        let coil = 20.5 + 0.1 * (degc - 25.0);
        run.temperatures = (0..=4).map(|i| (8.0 * f64::from(i), [Some(coil), Some(degc)])).collect();
        let name = format!("13-04-03_1{i}-00-00");
        case.put(&format!("13-04-03/1{i}-00-00.CCR"), run.named(&name).text());
    }
    let sigma = Plan::default().truth.sigma[0];
    let judge = |tpf: &toml_edit::DocumentMut| {
        let entry = |r: usize, c: usize| tpf["covariance_b"]["sigma_x"][r][c].as_float().unwrap();
        let slope = 0.1 * STD_PER_K * sigma;
        assert!((entry(1, 1).sqrt() / slope - 1.0).abs() < 0.01, "{} {slope}", entry(1, 1).sqrt());
        assert!((entry(0, 0).sqrt() / (25.0 * slope) - 1.0).abs() < 0.01, "{}", entry(0, 0).sqrt());
        assert!((entry(0, 1) / (-25.0 * slope * slope) - 1.0).abs() < 0.01, "{}", entry(0, 1));
        assert!((tpf["covariance_b"]["sigma_y"][1][1].as_float().unwrap()).sqrt() < 1e-3 * slope);
        let common = tpf["common"].as_array_of_tables().unwrap();
        assert_eq!(common.len(), 1);
        says(common.get(0).unwrap()["source"].as_str().unwrap(), &["facility.toml", "period 1", "direction 1"]);
    };
    let options = ["--no-plots", "--order", "sigma=1", "--order", "xi=0", "--facility", facility.to_str().unwrap()];
    let tpf_of = |out: &std::path::Path, inputs: &[std::path::PathBuf], options: &[&str]| {
        let output = calfit().arg("thermal").args(inputs).args(options).arg("-o").arg(out).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
        parameters(&out.join("THERMAL_PARAMETER__13-04-03-10-00-00.TPF"))
    };
    judge(&tpf_of(&case.out().join("runs"), &[case.campaign()], &options));
    // The same from the files of the runs.
    assert_eq!(case.lin(&["--facility", facility.to_str().unwrap(), "--no-plots", "--order", "0"]).status.code(), Some(0));
    let files: Vec<_> = (0..6)
        .map(|i| format!("13-04-03_1{i}-00-00"))
        .map(|name| case.out().join(&name).join(format!("PARAMETER_LIN__{name}.CPF")))
        .collect();
    judge(&tpf_of(&case.out().join("files"), &files, &options[..5]));
}

/// The second orientation of the runs of 1998 with other signs, and a row of theirs once more.
#[test]
fn an_orientation_of_the_wrong_sign_and_a_row_that_stands_twice_are_told() {
    let table = std::fs::read_to_string(repository("tests/data/champ/runs_ambient.csv")).unwrap();
    let told = |name: &str, table: String| {
        let case = Case::new();
        let facility = facility_file(&case, &FACILITY);
        let path = case.put(name, table);
        let options = ["--facility", facility.to_str().unwrap(), "--no-plots"];
        let (status, _, errors) = coil(&case, "tilt", &[&path], &options);
        assert_eq!(status, Some(0), "{errors}");
        errors
    };
    let scatter = "the offsets of the orientations scatter by ";
    let wrong = told("wrong.csv", table.replace("-Y +X +Z", "+Y -X +Z"));
    says(&wrong, &[scatter, " nT within an orientation; it is ", "check the signs of every orientation"]);
    let row = table.lines().find(|line| line.starts_with("5,")).unwrap();
    let twice = told("twice.csv", format!("{}\n{row}\n", table.trim_end()));
    says(&twice, &["run 5 stands twice and was counted once"]);
    assert!(!twice.contains(scatter), "{twice}");
}
