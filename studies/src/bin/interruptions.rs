//! `cargo run --release -p calfit-studies --bin interruptions -- target/release/calfit` kills and disturbs reports of the short runs of
//! `runs/sample`, and writes `reports/interruptions.md`, anew after every kind of interruption. It ends with 1 if anything was torn, wrong without
//! a word, or not mended by the next run. It needs strace and takes some minutes.

use calfit_studies::interruptions::{Counts, Scene, line, report};
use calfit_studies::repository;
use std::path::PathBuf;
use std::process::ExitCode;

/// Of each kind of call so many fail, one after the other; most calls behind them are those of the same loop over the runs.
const MOST: usize = 150;
/// After so many trials the counts so far are told.
const EVERY: usize = 100;

fn so_far(counts: &Counts) {
    if counts.trials.is_multiple_of(EVERY) {
        eprint!("{}", line(counts));
    }
}

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let program = std::env::args_os().nth(1).map(PathBuf::from).ok_or("name the program: target/release/calfit")?;
    if !Scene::has_tracer() {
        return Err("system calls are made to fail with strace, which is not there: install it".into());
    }
    let folder = tempfile::tempdir()?;
    let scene = Scene::new(&program.canonicalize()?, &repository("runs/sample"), folder.path())?;
    let mut list = Vec::new();
    let mut keep = |more: Vec<Counts>| {
        more.iter().for_each(|counts| print!("{}", line(counts)));
        list.extend(more);
        std::fs::write(repository("reports/interruptions.md"), report(&list)).map(|()| list.iter().all(Counts::is_clean))
    };
    keep(vec![scene.pairs(100, so_far)?])?;
    keep(scene.failed_calls(MOST, so_far)?)?;
    keep(scene.killed_at_calls(MOST, so_far)?)?;
    let is_clean = keep(vec![scene.kills(1000, so_far)?])?;
    Ok(if is_clean { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
