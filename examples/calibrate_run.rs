//! A run calibrated through the library: what `calfit lin` does, without its files.
//!
//!     cargo run --release --example calibrate_run -- runs/champ-1998

use calfit::data::plateau::{self, Accumulator};
use calfit::files::campaign::Campaign;
use calfit::files::ccr;
use calfit::measure::lin::{Options, lin};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let path = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "runs/champ-1998".to_owned()));
    let mut findings = Vec::new();
    for campaign in Campaign::open(&[path], &mut findings).map_err(|e| e.to_string())? {
        for file in &campaign.runs {
            // Vectors go into the accumulator while the file is read, so that no run has to fit into memory.
            let mut means = Accumulator::default();
            let run = match ccr::read(&file.path, &ccr::Options::default(), &mut means) {
                Ok(run) => run,
                Err(findings) => {
                    findings.iter().for_each(|finding| eprintln!("{finding}"));
                    continue;
                }
            };
            let options = Options::default();
            let plateaus = plateau::of_run(&run, means, options.cut);
            match lin(&run, &plateaus, &campaign.file.instructions, &options) {
                Ok(result) => {
                    let (matrix, std) = (&result.calibration.matrix, &result.calibration.std);
                    println!("{}", run.header.run);
                    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
                        println!("  sigma_{axis} = {:.8} ± {:.8} nT/enT", matrix.sigma[i][i], std.sigma[i]);
                    }
                    result.notes.iter().for_each(|note| println!("  {note}"));
                }
                Err(refusal) => println!("{}: {refusal}; {}", run.header.run, refusal.remedy()),
            }
        }
    }
    Ok(())
}
