//! `cargo run --release -p calfit-studies --bin damages` damages runs of every kind and flight inputs of every kind in every way, analyses them,
//! and writes `reports/damages.md` and `reports/flight-damages.md`. It ends with 1 if an answer is wrong without a word. With names of kinds, or
//! `flight` for all of flight, it makes those; a table of some kinds is printed and not written. `--told` adds the messages of every run.

use calfit_studies::damages::{ALL, Kind, report, silent, table};
use calfit_studies::{flight_damages as flight, repository};
use std::process::ExitCode;

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let is_named = |name: &str| arguments.iter().any(|a| a == name);
    let is_told = is_named("--told");
    let named: Vec<Kind> = Kind::ALL.into_iter().filter(|k| is_named(k.name())).collect();
    let named_flight: Vec<flight::Kind> = flight::Kind::ALL.into_iter().filter(|k| is_named(k.name())).collect();
    let all = named.is_empty() && named_flight.is_empty();
    let mut is_silent = false;
    if !named.is_empty() || (all && !is_named("flight")) {
        let kinds = if all { Kind::ALL.to_vec() } else { named };
        let cells = table(&kinds, &ALL)?;
        let text = report(&cells, &kinds);
        if all {
            std::fs::write(repository("reports/damages.md"), &text)?;
        }
        print!("{text}");
        let told = cells.iter().filter(|c| is_told && !c.told.is_empty());
        told.for_each(|c| eprintln!("== {} / {}\n{}", c.damage, c.kind.name(), c.told));
        is_silent |= !silent(&cells).is_empty();
    }
    if !named_flight.is_empty() || all {
        let kinds = if all { flight::Kind::ALL.to_vec() } else { named_flight };
        let cells = flight::table(&kinds, &flight::ALL.iter().collect::<Vec<_>>(), "all")?;
        let text = flight::report(&cells, &kinds);
        if all {
            std::fs::write(repository("reports/flight-damages.md"), &text)?;
        }
        print!("{text}");
        let told = cells.iter().filter(|c| is_told && !c.told.is_empty());
        told.for_each(|c| eprintln!("== {} / {}\n{}", c.damage, c.kind.name(), c.told));
        is_silent |= !silent(&cells).is_empty();
    }
    Ok(if is_silent { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
