//! `cargo run --release -p calfit-studies --bin damages` damages runs of every kind in every way, analyses them, and writes
//! `reports/damages.md`. It ends with 1 if an answer is wrong without a word. With names of kinds it prints the table of those and writes
//! nothing, and the messages of every run with `--told`.

use calfit_studies::damages::{ALL, Kind, report, silent, table};
use calfit_studies::repository;
use std::process::ExitCode;

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let named: Vec<Kind> = Kind::ALL.into_iter().filter(|k| arguments.iter().any(|a| a == k.name())).collect();
    let kinds = if named.is_empty() { Kind::ALL.to_vec() } else { named.clone() };
    let cells = table(&kinds, &ALL)?;
    let text = report(&cells, &kinds);
    if named.is_empty() {
        std::fs::write(repository("reports/damages.md"), &text)?;
    }
    print!("{text}");
    if arguments.iter().any(|a| a == "--told") {
        cells.iter().filter(|c| !c.told.is_empty()).for_each(|c| eprintln!("== {} / {}\n{}", c.damage, c.kind.name(), c.told));
    }
    Ok(if silent(&cells).is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
