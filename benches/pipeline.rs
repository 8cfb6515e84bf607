//! From the file to the figures: the reader, plateaus, the linear fit, and a whole run.
//!
//! All inputs are made here, the same ones every time.

use calfit::data::envelope::Envelope;
use calfit::data::plateau::{Accumulator, Plateaus};
use calfit::data::run::{Header, Kind, ReadingUnit, Run, Setting, SlowTable, Vector, VectorSink};
use calfit::data::units::{FieldCoil, Reading};
use calfit::files::campaign::Campaign;
use calfit::files::ccr::{self, Decimals, Section, Writer};
use calfit::measure::lin::{Lin, Options, lin};
use calfit::plot;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rayon::prelude::*;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;

const RATE_HZ: f64 = 128.0;

/// Pseudo-random numbers (xorshift).
struct Noise(u64);

impl Noise {
    /// The sum of four uniform numbers with mean 0 and standard deviation 1.
    fn next(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..4 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            sum += (self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
        }
        sum * 3_f64.sqrt()
    }
}

/// Steps from -2000 nT to 2000 nT on one axis after the other.
fn settings(count: usize, duration_s: f64) -> Vec<Setting> {
    let per_axis = count.div_ceil(3);
    let setting = |i: usize| {
        let mut field = [0.0; 3];
        field[i / per_axis] = -2000.0 + 4000.0 * (i % per_axis) as f64 / (per_axis - 1) as f64;
        Setting {
            t_start_s: i as f64 * duration_s,
            t_end_s: (i + 1) as f64 * duration_s,
            field: FieldCoil(field),
            frequency_hz: 0.0,
            position: 1,
        }
    };
    (0..count).map(setting).collect()
}

/// What a sensor with one percent of gain error and crosstalk reads in these settings.
fn vectors(settings: &[Setting], duration_s: f64, count: u64) -> impl Iterator<Item = Vector> {
    let mut noise = Noise(0x9E37_79B9_7F4A_7C15);
    (0..count).map(move |n| {
        let t_s = n as f64 / RATE_HZ;
        let [x, y, z] = settings.get((t_s / duration_s) as usize).map_or([0.0; 3], |s| s.field.0);
        let reading = [0.99 * x + 0.01 * y - 3.0, 1.01 * y - 0.01 * z + 4.0, z + 0.01 * x - 10.0].map(|b| b + 0.5 * noise.next());
        Vector { n, t_s, reading: Reading(reading) }
    })
}

/// Writes a run of this many vectors, evenly spread over the settings.
fn write_run(folder: &Path, setting_count: usize, vector_count: u64) -> PathBuf {
    let path = folder.join("09-00-00.CCR");
    let header = Header {
        run: "26-01-15_09-00-00".to_owned(),
        start: "2026-01-15T09:00:00Z".parse().unwrap(),
        kind: Kind::Linearity,
        configuration: "STEPS.MAG".to_owned(),
        sensor: "BS_11".to_owned(),
        mode: "science mode 0".to_owned(),
        sample_rate_hz: RATE_HZ,
        unit: ReadingUnit::Ent,
        field_source: "FLDS".to_owned(),
        coil_correction: Some(true),
        earthfield_compensation: vec!["DYNAMIC".to_owned(); 3],
    };
    let span_s = vector_count as f64 / RATE_HZ;
    let duration_s = span_s / setting_count as f64;
    let settings = settings(setting_count, duration_s);
    let t_s: Vec<f64> = (0..=100).map(|i| span_s * f64::from(i) / 100.0).collect();
    let drift = |from: f64| t_s.iter().map(|t| from + t / span_s).collect::<Vec<f64>>();
    let slow = SlowTable { names: vec!["T59".to_owned(), "T29".to_owned()], values: vec![drift(20.0), drift(19.0)], t_s };

    let file = std::io::BufWriter::new(std::fs::File::create(&path).expect("a new file"));
    let mut writer = Writer::new(file, &header, Decimals::default()).expect("the header is written");
    writer.fields(&settings).expect("settings are written");
    writer.slow(Section::Temperatures, &slow).expect("temperatures are written");
    writer.vectors(vectors(&settings, duration_s, vector_count)).expect("vectors are written");
    writer.end().expect("the file is complete");
    path
}

fn read(path: &Path, two_threads: bool, sink: &mut impl VectorSink) -> Run {
    let options = ccr::Options { two_threads, ..ccr::Options::default() };
    ccr::read(path, &options, sink).expect("a run without faults")
}

fn plateaus(accumulator: Accumulator) -> Plateaus {
    let options = Options::default();
    accumulator.finish(options.cut)
}

/// The campaign that a single run file stands for: position 1 along the coil axes.
fn campaign(path: &Path) -> Campaign {
    let campaigns = Campaign::open(&[path.to_owned()], &mut Vec::new()).expect("a run file");
    campaigns.into_iter().next().expect("one campaign")
}

fn fit(run: &Run, plateaus: &Plateaus, campaign: &Campaign) -> Lin {
    lin(run, plateaus, &campaign.file.instructions, &Options::default()).expect("a run that can be fitted")
}

/// A million vectors: reading alone on one and on two threads, and with plateaus.
fn reader(c: &mut Criterion) {
    let folder = TempDir::new().expect("a temporary folder");
    let path = write_run(folder.path(), 90, 1_000_000);
    let bytes = std::fs::metadata(&path).expect("the file that was just written").len();
    let mut group = c.benchmark_group("million_vectors");
    group.throughput(Throughput::Bytes(bytes));
    group.sample_size(20);
    for two_threads in [false, true] {
        group.bench_function(BenchmarkId::new("reader_threads", 1 + u32::from(two_threads)), |b| {
            b.iter(|| read(&path, two_threads, &mut ()));
        });
    }
    group.bench_function("plateaus", |b| {
        b.iter(|| {
            let mut accumulator = Accumulator::default();
            let run = read(&path, true, &mut accumulator);
            (run, plateaus(accumulator))
        });
    });
    group.finish();
}

/// The fit alone, for the programmes of 72 to 90 plateaus in use.
fn linear_fit(c: &mut Criterion) {
    let mut group = c.benchmark_group("linear_fit");
    for count in [72, 81, 90] {
        let folder = TempDir::new().expect("a temporary folder");
        let path = write_run(folder.path(), count, 256 * count as u64);
        let campaign = campaign(&path);
        let mut accumulator = Accumulator::default();
        let run = read(&path, true, &mut accumulator);
        let plateaus = plateaus(accumulator);
        group.bench_function(BenchmarkId::new("plateaus", count), |b| {
            b.iter(|| fit(black_box(&run), black_box(&plateaus), &campaign));
        });
    }
    group.finish();
}

/// A run of half an hour with all its figures, which stay in memory.
fn run_with_figures(c: &mut Criterion) {
    let folder = TempDir::new().expect("a temporary folder");
    let path = write_run(folder.path(), 90, 230_400);
    let campaign = campaign(&path);
    let mut group = c.benchmark_group("run");
    group.sample_size(20);
    group.measurement_time(Duration::from_secs(10));
    group.bench_function("read_fit_draw", |b| {
        b.iter(|| {
            let mut sinks = (Accumulator::default(), Envelope::default());
            let run = read(&path, true, &mut sinks);
            let (accumulator, envelope) = sinks;
            let mut lin = fit(&run, &plateaus(accumulator), &campaign);
            lin.samples = Some(envelope.columns());
            let figures = plot::lin::figures(&lin);
            figures.par_iter().map(|named| plot::render(&named.figure).expect("a figure").len()).sum::<usize>()
        });
    });
    group.finish();
}

criterion_group!(pipeline, reader, linear_fit, run_with_figures);
criterion_main!(pipeline);
