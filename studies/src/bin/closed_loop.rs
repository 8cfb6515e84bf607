//! `cargo run --release -p calfit-studies --bin closed_loop [-- SEEDS]` simulates the campaign of April 2013, analyses it, and writes
//! `reports/closed-loop-2013.md`: every coefficient as printed and as found. With several seeds it also counts how many intervals
//! hold the printed value.

use calfit::files::twin;
use calfit_studies::closed_loop::{self, Row};
use calfit_studies::repository;
use std::fmt::Write;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seeds: u64 = std::env::args().nth(1).map_or(Ok(1), |n| n.parse())?;
    let twin = twin::read(&repository("configs/magnetsrode-2013.toml"), &mut Vec::new()).map_err(|e| e.to_string())?;
    let printed = std::fs::read_to_string(repository("tests/data/bepicolombo/thermal.toml"))?;
    let mut all: Vec<Vec<Row>> = Vec::new();
    for seed in 0..seeds {
        all.push(closed_loop::compare(&twin, &printed, twin.seed + seed).map_err(|e| e.to_string())?);
    }
    let mut text = head(&all);
    let mut group = (String::new(), String::new());
    for (i, row) in all[0].iter().enumerate() {
        if group != (row.sensor.clone(), row.mode.clone()) {
            group = (row.sensor.clone(), row.mode.clone());
            let _ = write!(
                text,
                "\n## {}, {}\n\n| quantity | power | printed | found | standard uncertainty | difference in it |",
                row.sensor, row.mode
            );
            text.push_str(if seeds > 1 {
                " intervals that hold it |\n|---|---|---|---|---|---|---|\n"
            } else {
                "\n|---|---|---|---|---|---|\n"
            });
        }
        let _ = write!(
            text,
            "| {} | {} | {:.6e} | {:.6e} | {:.1e} | {:+.2} |",
            row.quantity,
            row.power,
            row.printed,
            row.found,
            row.std,
            row.z()
        );
        if seeds > 1 {
            let held = all.iter().filter(|rows| rows[i].covered()).count();
            let _ = write!(text, " {held} of {seeds} |");
        }
        text.push('\n');
    }
    std::fs::write(repository("reports/closed-loop-2013.md"), &text)?;
    print!("{}", head(&all));
    Ok(())
}

fn head(all: &[Vec<Row>]) -> String {
    let rows: Vec<&Row> = all.iter().flatten().collect();
    let held = rows.iter().filter(|r| r.covered()).count();
    let largest = rows.iter().map(|r| r.z().abs()).fold(0.0, f64::max);
    let mean_square = rows.iter().map(|r| r.z().powi(2)).sum::<f64>() / rows.len() as f64;
    format!(
        "# The campaign of April 2013, simulated and analysed\n\n`configs/magnetsrode-2013.toml` has the polynomials of BC-MAG-TR-0085 \
         sections 12 and 13 as truth. Made with `cargo run --release -p calfit-studies --bin closed_loop -- {}`.\n\n{} coefficients in {} campaigns: \
         {held} intervals of 95 % hold the printed value ({:.1} %). Mean square of difference over standard uncertainty {mean_square:.2}, \
         largest {largest:.2}. Sigma in nT/enT, xi in degrees, b_or and b_off in enT, f_3db in Hz, per °C to the power given.\n",
        all.len(),
        rows.len(),
        all.len(),
        100.0 * held as f64 / rows.len() as f64
    )
}
