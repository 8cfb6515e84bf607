//! `calfit apply` on ten million vectors, Parquet to Parquet, beside the time that reading the raw columns and writing the calibrated ones
//! takes: `cargo bench --bench apply`.

use calfit::data::apply::OffsetQuantity;
use calfit::data::convention::Convention;
use calfit::data::recipe::Reading;
use calfit::files::output::{Folder, Pending};
use calfit::files::table::stream::{Batch, Format, Reader, Writer};
use calfit::model::field_calibration::{Coefficient, Coefficients, FieldCalibration, Frame, MatrixForm, Parameter};
use calfit::workflow::{Applied, ApplyOptions, Outside, apply_to};
use nalgebra::DMatrix;
use std::path::Path;
use std::time::{Duration, Instant};

const ROWS: usize = 10_000_000;
const BATCH: usize = 250_000;

/// A sensor whose nine quantities are straight lines of the temperature, with a covariance of all eighteen coefficients.
fn calibration() -> Applied {
    let parameters = (0..3).flat_map(|i| [Parameter::Offset(i), Parameter::Sigma(i), Parameter::Xi(i)]);
    let coefficients: Vec<Coefficient> = parameters
        .flat_map(|parameter| {
            let value = match parameter {
                Parameter::Sigma(_) => 1.0,
                Parameter::Xi(_) => 90.3,
                _ => 5.0,
            };
            [(0, value), (1, 1e-5)].map(|(power, value)| Coefficient { parameter, power, value })
        })
        .collect();
    let n = coefficients.len();
    let covariance = DMatrix::from_fn(n, n, |i, k| if i == k { 1e-10 } else { 1e-12 });
    let calibration = FieldCalibration::new(Coefficients {
        matrix: Some(MatrixForm::Alignment(Convention::BepiColombo)),
        offset: Some(OffsetQuantity::BOff),
        coefficients,
        covariance: Some(covariance),
        valid_degc: Some([-60.0, 60.0]),
        ..Coefficients::default()
    });
    let Ok(calibration) = calibration else { unreachable!("all parameters are there") };
    let text = || "bench".to_owned();
    Applied {
        calibration,
        sensor: text(),
        mode: text(),
        frame: text(),
        position: None,
        channel: None,
        lag: None,
        effects: None,
        inputs: Vec::new(),
        notes: Vec::new(),
    }
}

/// Readings of a noisy sensor in a field that turns slowly, 24 bits.
fn raw(file: &mut Pending) {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut noise = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let mut writer = Writer::new(file, Format::Parquet, "raw");
    for begin in (0..ROWS).step_by(BATCH) {
        let t: Vec<f64> = (begin..begin + BATCH).map(|n| n as f64 / 128.0).collect();
        let lsb = 0.01;
        let mut axis = |phase: f64| -> Vec<f64> {
            t.iter().map(|t| ((3000.0 * (t / 900.0 + phase).sin() + noise()) / lsb).round() * lsb).collect()
        };
        let (x, y, z) = (axis(0.0), axis(1.0), axis(2.0));
        let degc = t.iter().map(|t| ((20.0 + 15.0 * (t / 5000.0).sin()) / 0.01).round() * 0.01).collect();
        let batch = Batch::of_numbers(vec![("t", t), ("x", x), ("y", y), ("z", z), ("t_degc", degc)], begin).unwrap();
        writer.write(&batch).unwrap();
    }
    writer.finish().unwrap();
}

/// All batches of a table.
fn read(path: &Path, mut take: impl FnMut(Batch)) -> Duration {
    let begin = Instant::now();
    let mut reader = Reader::open(path).unwrap();
    while let Some(batch) = reader.next_batch().unwrap() {
        take(batch);
    }
    begin.elapsed()
}

/// Reads a table and writes it again.
fn copied(path: &Path, folder: &Folder) -> Duration {
    let begin = Instant::now();
    let mut file = folder.create("copy.parquet").unwrap();
    let mut writer = Writer::new(&mut file, Format::Parquet, "copy");
    read(path, |batch| writer.write(&batch).unwrap());
    writer.finish().unwrap();
    file.finish().unwrap();
    begin.elapsed()
}

/// The largest memory of the process so far, MiB.
fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}

fn main() {
    let dir = tempfile::tempdir().unwrap();
    let folder = Folder::open(dir.path(), true).unwrap();
    let mut file = folder.create("raw.parquet").unwrap();
    raw(&mut file);
    file.finish().unwrap();
    let data = dir.path().join("raw.parquet");
    let options = ApplyOptions {
        frame: Frame::Sensor,
        outside: Outside::Flag,
        temperature_column: None,
        temperature_degc: None,
        effects_taken_off: false,
    };
    let applied = calibration();
    for round in 1..=3 {
        let begin = Instant::now();
        let counts = apply_to(&data, &applied, &options, &Reading::default(), &folder).unwrap();
        let took = begin.elapsed().as_secs_f64();
        let peak = peak_mib().map_or_else(String::new, |mib| format!(", at most {mib:.0} MiB so far"));
        let result = dir.path().join(&counts.file);
        // Reading the raw columns and writing those of the result.
        let raw_read = read(&data, drop).as_secs_f64();
        let whole = copied(&result, &folder).as_secs_f64() - read(&result, drop).as_secs_f64() + raw_read;
        println!(
            "{round}: {} vectors in {took:.2} s{peak}; reading and writing alone {whole:.2} s: {:.2} times",
            counts.rows,
            took / whole
        );
    }
}
