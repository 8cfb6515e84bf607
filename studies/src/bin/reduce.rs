//! Reads one run file into plateau statistics and prints what it took, for comparison with `benches/baseline`.
//!
//!     reduce FILE [REPETITIONS]
//!
//! The whole file is read, hashed, validated and reduced; the best time of all repetitions is printed.

use calfit::data::plateau::{Accumulator, Cut, Settling};
use calfit::files::ccr;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Peak memory of this process in MiB, where the system tells it.
fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let Some(path) = arguments.next().map(PathBuf::from) else {
        eprintln!("usage: reduce FILE [REPETITIONS]");
        return ExitCode::from(2);
    };
    let repetitions: u32 = arguments.next().and_then(|text| text.parse().ok()).unwrap_or(1);
    let options = ccr::Options { two_threads: true, ..ccr::Options::default() };
    let mut best_s = f64::INFINITY;
    let mut summary = String::new();
    for _ in 0..repetitions.max(1) {
        let begin = Instant::now();
        let mut accumulator = Accumulator::default();
        let run = match ccr::read(&path, &options, &mut accumulator) {
            Ok(run) => run,
            Err(findings) => {
                findings.iter().for_each(|finding| eprintln!("{finding}"));
                return ExitCode::FAILURE;
            }
        };
        let plateaus = accumulator.finish(Cut { settling: Settling::Given(0.0), least_coverage: 0.0 });
        best_s = best_s.min(begin.elapsed().as_secs_f64());
        let used: u64 = plateaus.list.iter().filter_map(|p| p.count).sum();
        let sum_x: f64 = plateaus.list.iter().map(|p| p.mean.0[0]).filter(|mean| mean.is_finite()).sum();
        summary = format!(
            "{} vectors, {used} in {} settings, sum of the x means {sum_x:.6}, {:.1} MB",
            run.vectors.count,
            plateaus.list.len(),
            run.input.size_bytes as f64 / 1e6
        );
    }
    let peak = peak_mib().map_or_else(String::new, |peak| format!("\npeak memory {peak:.1} MiB"));
    match writeln!(std::io::stdout(), "{summary}, {best_s:.4} s{peak}") {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}
