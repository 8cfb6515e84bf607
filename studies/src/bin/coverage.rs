//! `cargo run --release -p calfit-studies --bin coverage [-- RUNS [STUDY]]`: how often intervals of 95 % hold the truth, and how far the estimates are
//! from the smallest possible variance, over simulated runs; writes `reports/coverage.md` if all studies were made.

use calfit_studies::coverage::table;
use calfit_studies::repository;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let runs: u64 = std::env::args().nth(1).map_or(Ok(100), |n| n.parse())?;
    let only = std::env::args().nth(2);
    let text = table(runs, only.as_deref());
    if only.is_none() {
        std::fs::write(repository("reports/coverage.md"), &text)?;
    }
    print!("{text}");
    Ok(())
}
