//! Shipped programmes hold what their names say, and run files survive writing and reading.

use calfit::data::run::{GivenBlock, Header, Kind, ReadingUnit, Setting, SlowTable, Vector, VectorSink};
use calfit::data::units::{FieldCoil, Reading};
use calfit::files::{ccr, mag};
use std::path::{Path, PathBuf};

fn programme(name: &str) -> mag::Programme {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(format!("{name}.MAG"));
    let mut findings = Vec::new();
    let programme = mag::read(&path, &mut findings).unwrap();
    assert!(findings.is_empty(), "{findings:?}");
    assert_eq!(programme.name, format!("{name}.MAG"));
    programme
}

#[test]
fn the_linearity_programme_drives_every_axis_alone_to_2000_nt() {
    let p = programme("LIN2000XYZE");
    assert_eq!(p.kind, Kind::Linearity);
    for axis in 0..3 {
        let values: Vec<f64> = p.steps.iter().map(|s| s.field.0[axis]).collect();
        assert_eq!(values.iter().copied().fold(f64::NEG_INFINITY, f64::max), 2000.0);
        assert_eq!(values.iter().copied().fold(f64::INFINITY, f64::min), -2000.0);
    }
    assert!(p.steps.iter().all(|s| s.field.0.iter().filter(|b| **b != 0.0).count() <= 1 && s.duration_s == 24.0));
}

#[test]
fn the_offset_programme_visits_all_four_positions_with_200_nt() {
    let p = programme("OFFSET_200");
    assert_eq!(p.kind, Kind::Offset);
    for position in 1..=4 {
        let here: Vec<_> = p.steps.iter().filter(|s| s.position == position).collect();
        assert!(here.iter().any(|s| s.field.0 == [0.0; 3]));
        for axis in 0..3 {
            assert!([200.0, -200.0].iter().all(|b| here.iter().any(|s| s.field.0[axis] == *b)));
        }
    }
}

#[test]
fn the_frequency_programme_is_a_sine_of_1000_nt_on_y_from_a_tenth_to_a_thousand_hertz() {
    let p = programme("FREQ2000");
    assert_eq!(p.kind, Kind::Frequency);
    assert!(p.steps.iter().all(|s| s.field.0 == [0.0, 1000.0, 0.0] && s.frequency_hz * s.duration_s >= 3.0));
    let frequencies = || p.steps.iter().map(|s| s.frequency_hz);
    assert_eq!(frequencies().fold(f64::INFINITY, f64::min), 0.1);
    assert!(frequencies().fold(0.0, f64::max) >= 199.0);
}

#[test]
fn the_random_programme_has_a_constant_modulus_and_no_preferred_direction() {
    let p = programme("RANDOM50000");
    assert_eq!(p.kind, Kind::Sweep);
    let n = p.steps.len() as f64;
    for s in &p.steps {
        let modulus = s.field.0.iter().map(|b| b * b).sum::<f64>().sqrt();
        assert!((modulus - 50_000.0).abs() < 0.02, "{modulus}");
    }
    for axis in 0..3 {
        let mean = p.steps.iter().map(|s| s.field.0[axis]).sum::<f64>() / n;
        let square = p.steps.iter().map(|s| s.field.0[axis].powi(2)).sum::<f64>() / n;
        assert!(mean.abs() < 100.0, "{mean}");
        assert!((square / (50_000.0 * 50_000.0 / 3.0) - 1.0).abs() < 0.01);
    }
}

#[test]
fn the_zero_field_programmes_apply_nothing() {
    for (name, least_s) in [("NULL", 600.0), ("NULL_LANG", 15.0 * 3600.0), ("NULL_STATISCH", 600.0)] {
        let p = programme(name);
        assert_eq!(p.kind, Kind::ZeroField);
        assert!(p.steps.iter().all(|s| s.field.0 == [0.0; 3] && s.frequency_hz == 0.0));
        assert!(p.steps.iter().map(|s| s.duration_s).sum::<f64>() >= least_s);
    }
}

fn header(unit: ReadingUnit) -> Header {
    Header {
        run: "13-04-03_09-22-38".to_owned(),
        start: "2013-04-03T09:22:38Z".parse().unwrap(),
        kind: Kind::Linearity,
        configuration: "LIN \"quoted\" °.MAG".to_owned(),
        sensor: "BS_11".to_owned(),
        mode: "science mode 0".to_owned(),
        sample_rate_hz: 128.0,
        unit,
        field_source: "FLDS".to_owned(),
        coil_correction: Some(true),
        earthfield_compensation: ["DYNAMIC", "STATIC", "DYNAMIC"].map(str::to_owned).to_vec(),
    }
}

fn setting(t: f64, field: [f64; 3]) -> Setting {
    Setting { t_start_s: t, t_end_s: t + 1.0, field: FieldCoil(field), frequency_hz: 0.0, position: 1 }
}

#[derive(Default)]
struct All(Vec<Vector>);

impl VectorSink for All {
    fn vector(&mut self, vector: Vector) {
        self.0.push(vector);
    }
}

fn folder_with(name: &str, text: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

#[test]
fn a_run_with_samples_survives_writing_and_reading() {
    for unit in [ReadingUnit::Ent, ReadingUnit::Counts { ent_per_count: 0.0625 }] {
        let settings = [setting(0.0, [0.0; 3]), setting(1.5, [-2000.0, 0.25, 1.0])];
        let temperatures = SlowTable {
            names: vec!["T59".to_owned(), "T29".to_owned()],
            t_s: vec![0.0, 2.0],
            values: vec![vec![17.25, f64::NAN], vec![16.5, 16.625]],
        };
        // Multiples of 1/16 are exact in text with four decimals and in counts.
        let vectors: Vec<Vector> = (0..256u32)
            .map(|i| {
                let v = f64::from(i) / 16.0;
                Vector { n: u64::from(i), t_s: f64::from(i) / 128.0, reading: Reading([v, -v, v - 8.0]) }
            })
            .collect();
        let decimals = ccr::Decimals { time: 7, field: 2, reading: 4, slow: 3 };
        let mut writer = ccr::Writer::new(Vec::new(), &header(unit), decimals).unwrap();
        writer.fields(&settings).unwrap();
        writer.slow(ccr::Section::Temperatures, &temperatures).unwrap();
        writer.vectors(vectors.iter().copied()).unwrap();
        let text = writer.end().unwrap();
        let (_folder, path) = folder_with("09-22-38.CCR", &text);
        let mut all = All::default();
        let run = ccr::read(&path, &ccr::Options::default(), &mut all).unwrap();
        assert_eq!(run.header, header(unit));
        assert_eq!(run.settings, settings);
        assert_eq!(run.temperatures.names, temperatures.names);
        assert_eq!(run.temperatures.channel("T59").unwrap(), [(0.0, 17.25)]);
        assert_eq!(all.0, vectors);
        assert!(run.findings.is_empty(), "{:?}", run.findings);
    }
}

#[test]
fn plateau_means_survive_writing_and_reading() {
    for (std_ent, count) in [(None, None), (Some([0.5, 0.25, 0.125]), Some(3072))] {
        let blocks = [GivenBlock { setting: setting(0.0, [1.0, 2.0, 3.0]), mean: Reading([-1.5, 2.25, 1e5]), std_ent, count }];
        let mut writer = ccr::Writer::new(Vec::new(), &header(ReadingUnit::Ent), ccr::Decimals::default()).unwrap();
        writer.blocks(&blocks).unwrap();
        let (_folder, path) = folder_with("09-22-38.CCR", &writer.end().unwrap());
        assert_eq!(ccr::read(&path, &ccr::Options::default(), &mut ()).unwrap().blocks, blocks);
    }
}
