//! Long studies of `calfit`: how often its intervals hold the truth, how often a diagnosis is right, wrong and silent, and whether the
//! polynomials of a simulated campaign come back.
//!
//! Every study is a program that writes its table into `reports`, for example `cargo run --release -p calfit-studies --bin blind`.
//! The tests of this package are the same studies over few runs; `CALFIT_STUDY=full` makes them long.

pub mod blind;
pub mod closed_loop;
pub mod coverage;
pub mod damages;
pub mod flight_damages;
pub mod interruptions;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

/// A file of the repository.
pub fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}
