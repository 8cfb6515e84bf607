//! `cargo run --release -p calfit-studies --bin coverage [-- RUNS [STUDY]]`: how often intervals of 95 % hold the truth, and how far the estimates are
//! from the smallest possible variance, over simulated runs; writes `reports/coverage.md` if all studies were made.

use calfit_studies::coverage::{NOISES, Tally, study};
use calfit_studies::repository;
use std::collections::BTreeMap;
use std::fmt::Write;

const STUDIES: [&str; 4] = ["lin", "offset", "freq", "thermal"];

/// Runs of a study, or thermal groups of 21 runs.
fn count(name: &str, runs: u64) -> u64 {
    match name {
        "lin" | "offset" => 4 * runs,
        "thermal" => runs.div_ceil(4),
        _ => runs,
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let runs: u64 = std::env::args().nth(1).map_or(Ok(1000), |n| n.parse())?;
    let only = std::env::args().nth(2);
    let mut text = format!(
        "# Coverage and efficiency\n\nMade with `cargo run --release -p calfit-studies --bin coverage -- {runs}`. Sensors, rotations, offsets, residual \
         fields and sample rates are drawn at random; 128 Hz, programmes of 2013 (sines shortened to 10 s). 1/f noise has a memory as long \
         as the run. A thermal group has 21 runs at 7 temperatures.\n\n* coverage: share of the intervals of 95 % that hold the truth \
         (1.96 standard uncertainties; for thermal coefficients the factor that the file states).\n* width: stated over real root mean \
         square error.\n* variance: mean square error over the Cramér-Rao bound for the simulated noise. The estimates are ordinary least \
         squares over plateau means; under 1/f noise the bound knows the noise and weighs quarters of plateaus with it.\n"
    );
    for name in STUDIES.into_iter().filter(|name| only.as_deref().is_none_or(|o| o == *name)) {
        let count = count(name, runs);
        let results: Vec<BTreeMap<String, Tally>> = NOISES.into_iter().map(|noise| study(name, noise, count)).collect();
        let _ = write!(
            text,
            "\n## {name}\n\n{count} {}; one standard deviation of a coverage {:.1} %, of a variance {:.0} % (rows that pool three components: less by 1.7).\n\n| parameter |",
            if name == "thermal" { "groups" } else { "runs" },
            100.0 * (0.95 * 0.05 / count as f64).sqrt(),
            100.0 * (2.0 / count as f64).sqrt(),
        );
        for noise in NOISES {
            let _ = write!(text, " {}: coverage, % | width | variance |", noise.name);
        }
        text.push_str("\n|---|");
        text.push_str(&"---|---|---|".repeat(NOISES.len()));
        text.push('\n');
        for parameter in results[0].keys() {
            let _ = write!(text, "| {parameter} |");
            for tallies in &results {
                match tallies.get(parameter) {
                    Some(t) => {
                        let _ = write!(text, " {:.1} | {:.3} | {:.3} |", 100.0 * t.coverage(), t.width(), t.loss());
                    }
                    None => text.push_str(" - | - | - |"),
                }
            }
            text.push('\n');
        }
    }
    if only.is_none() {
        std::fs::write(repository("reports/coverage.md"), &text)?;
    }
    print!("{text}");
    Ok(())
}
