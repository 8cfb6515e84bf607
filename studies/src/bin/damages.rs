//! `cargo run --release -p calfit-studies --bin damages` damages runs of every kind in every way, analyses them, and writes
//! `reports/damages.md`. It ends with 1 if an answer is wrong without a word.

use calfit_studies::damages::{ALL, Kind, Outcome, markdown, table};
use calfit_studies::repository;
use std::process::ExitCode;

const HEAD: &str = "# Damaged runs\n\n\
`cargo run --release -p calfit-studies --bin damages` makes small runs of every kind, damages them, and analyses them as a user does.\n\
`refused`: no result. A word: the result stands with a new warning of that kind. A number in brackets: no warning, and no parameter\n\
moves by more than so many of its standard uncertainties. `not visible`: parameters are wrong and nothing in such a run can show it.\n\
`-`: the kind has nothing that the damage could change.\n\n";

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let cells = table(&Kind::ALL, &ALL)?;
    let is_silent = |o: &Outcome| matches!(o, Outcome::Silent(..));
    let silent = cells.iter().filter(|c| is_silent(&c.outcome)).count();
    let made = cells.iter().filter(|c| c.outcome != Outcome::NotThere).count();
    let text = format!("{HEAD}{}\n{made} damaged runs; wrong without a word: {silent}.\n", markdown(&cells, &Kind::ALL));
    std::fs::write(repository("reports/damages.md"), &text)?;
    print!("{text}");
    if std::env::args().any(|a| a == "--told") {
        cells.iter().filter(|c| c.outcome != Outcome::NotThere).for_each(|c| eprintln!("== {} / {}\n{}", c.damage, c.kind.name(), c.told));
    }
    Ok(if silent == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
