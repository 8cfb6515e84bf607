//! The table of the study.

use super::{NOISES, Tally, study};
use std::collections::BTreeMap;
use std::fmt::Write;

const STUDIES: [&str; 7] = ["lin", "lin moving", "offset", "freq", "null", "sweep", "thermal"];

/// Runs of a study, or thermal groups of 21 runs.
fn count(name: &str, runs: u64) -> u64 {
    match name {
        "lin" | "lin moving" | "offset" | "null" => 4 * runs,
        "sweep" => 3 * runs,
        "thermal" => runs.div_ceil(2),
        _ => runs,
    }
}

/// Frequencies of a programme go together.
fn group(parameter: &str) -> String {
    match parameter.split_once(" at ") {
        Some((what, hz)) => {
            let hz: f64 = hz.trim_end_matches(" Hz").parse().unwrap_or(f64::NAN);
            let range = if hz < 10.0 {
                "below 10 Hz"
            } else if hz < 64.0 {
                "10 to 64 Hz"
            } else {
                "above 64 Hz"
            };
            format!("{what}s {range}")
        }
        None => parameter.to_owned(),
    }
}

/// Makes all studies, or one of them, and writes what they show.
pub fn table(runs: u64, only: Option<&str>) -> String {
    let mut text = format!(
        "# Coverage and efficiency\n\nMade with `cargo run --release -p calfit-studies --bin coverage -- {runs}`. Sensors, rotations, offsets, residual \
         fields and sample rates are drawn at random; 128 Hz, programmes of 2013 (sines shortened to 10 s, zero field to an hour). Slow noise has a memory as long \
         as the run. A thermal group has 21 runs at 7 temperatures; its linearity runs are calibrated with its polynomials and with the noise that they show together. Moving runs are of a sensor that cools by 14 K while the axes are driven one after the other, with \
         slopes from the run itself; their bound is that of a sensor at rest. A sweep has 720 settings of 40 s at 4 Hz, from 130 to -20 degC; its polynomials are compared at four temperatures.\n\nEach cell: the share of the intervals of 95 % that hold the truth, in per cent (1.96 standard uncertainties; for \
         thermal coefficients the factor that the file states); the mean of the stated standard uncertainties over the smallest possible one, that of Cramér and \
         Rao for the simulated noise; the root mean square of the errors over the same. The estimates are ordinary least squares over plateau means; the bound \
         knows the noise, and weighs quarters of plateaus with it. Where no bound was worked out, the last figure is the root mean square of the errors over that of the stated standard uncertainties.\n\nThe noises: growing with the field is white noise of the samples with a standard deviation of 5e-4 of the \
         reading besides; heavy tails are those of Student's distribution with three degrees of freedom; the last is that of the twin of 2013: 1/f noise with a corner at 0.1 Hz, and \
         every setting of every coil axis wrong by 0.03 nT.\n\nWhat no single run can see: noise so slow that it hardly moves within a run acts on offsets alone. A corner at \
         0.003 Hz is seen in some runs only, and what it does to an offset is understated in the others.\n"
    );
    for name in STUDIES.into_iter().filter(|name| only.is_none_or(|o| o == *name)) {
        let count = count(name, runs);
        let results: Vec<BTreeMap<String, Tally>> = NOISES
            .into_iter()
            .map(|noise| {
                let mut groups: BTreeMap<String, Tally> = BTreeMap::new();
                for (parameter, tally) in study(name, noise, count) {
                    groups.entry(group(&parameter)).or_default().add(&tally);
                }
                groups
            })
            .collect();
        let _ = write!(
            text,
            "\n## {name}\n\n{count} {}; one standard deviation of a coverage {:.1} %, of an error {:.1} % (groups of frequencies: less).\n\n| parameter |",
            if name == "thermal" { "groups" } else { "runs" },
            100.0 * (0.95 * 0.05 / count as f64).sqrt(),
            100.0 * (0.5 / count as f64).sqrt(),
        );
        for noise in NOISES {
            let _ = write!(text, " {} |", noise.name);
        }
        text.push_str("\n|---|");
        text.push_str(&"---|".repeat(NOISES.len()));
        text.push('\n');
        for parameter in results[0].keys() {
            let _ = write!(text, "| {parameter} |");
            for tallies in &results {
                match tallies.get(parameter) {
                    Some(t) if t.stated().is_nan() => {
                        let _ = write!(text, " {:.1} / - / {:.2} |", 100.0 * t.coverage(), 1.0 / t.width());
                    }
                    Some(t) => {
                        let _ = write!(text, " {:.1} / {:.2} / {:.2} |", 100.0 * t.coverage(), t.stated(), t.loss().sqrt());
                    }
                    None => text.push_str(" - |"),
                }
            }
            text.push('\n');
        }
    }
    text
}
