//! `cargo run --release -p calfit-studies --bin interruptions -- target/release/calfit` kills and disturbs reports of `runs/sample`, and writes
//! `reports/interruptions.md`. It ends with 1 if anything was torn, wrong without a word, or not mended by the next run. It needs strace.

use calfit_studies::interruptions::{Counts, Scene, report};
use calfit_studies::repository;
use std::path::PathBuf;
use std::process::ExitCode;

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let program = std::env::args_os().nth(1).map(PathBuf::from).ok_or("name the program: target/release/calfit")?;
    let folder = tempfile::tempdir()?;
    let scene = Scene::new(&program.canonicalize()?, &repository("runs/sample"), folder.path())?;
    let mut list = vec![scene.kills(1000)?, scene.pairs(100)?];
    list.extend(scene.failed_calls(usize::MAX)?);
    let text = report(&list);
    std::fs::write(repository("reports/interruptions.md"), &text)?;
    print!("{text}");
    Ok(if list.iter().all(Counts::is_clean) { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
