//! A simulated campaign through the whole chain, files included: are the polynomials that went in those that come out?

use calfit::data::error::Finding;
use calfit::files::campaign::Campaign;
use calfit::files::twin::Twin;
use calfit::measure::thermal::{Kind, Thermal, groups, thermal};
use calfit::simulate::write_campaign;
use calfit::workflow::{Analyses, Desk, Measured, jobs};
use rayon::prelude::*;
use std::path::Path;
use toml_edit::{DocumentMut, Table};

/// One coefficient of a polynomial.
pub struct Row {
    pub sensor: String,
    pub mode: String,
    pub quantity: String,
    /// Power of the temperature.
    pub power: usize,
    pub printed: f64,
    pub found: f64,
    pub std: f64,
    /// Standard uncertainties of an interval of 95 %.
    pub factor_95: f64,
}

impl Row {
    /// Difference in standard uncertainties.
    pub fn z(&self) -> f64 {
        (self.found - self.printed) / self.std
    }

    pub fn covered(&self) -> bool {
        self.z().abs() <= self.factor_95
    }
}

/// Writes the campaign of a twin to a temporary folder, analyses it as `calfit report` does, and compares every coefficient with the
/// printed one. `printed` is the text of `thermal.toml`: a table per file, found by the run that gives it its name.
pub fn compare(twin: &Twin, printed: &str, seed: u64) -> Result<Vec<Row>, Finding> {
    let folder = tempfile::tempdir().map_err(|e| Finding::io(Path::new("a temporary folder"), "create", &e))?;
    write_campaign(twin, seed, folder.path(), false, || ())?;
    let mut findings = Vec::new();
    let campaigns = Campaign::open(&[folder.path().to_owned()], &mut findings)?;
    let desk = Desk::plain(folder.path().to_owned());
    let (jobs, _) = jobs(&campaigns, None);
    // Runs that the operators broke off have no calibration; their reasons are the report's business.
    let measured: Vec<Measured> = jobs.par_iter().filter_map(|job| Analyses::default().make(job, &desk, false).ok()).collect();
    let points: Vec<_> = measured.iter().filter_map(Measured::point).collect();
    let lins: Vec<_> = measured.iter().filter_map(Measured::lin).map(|made| &made.result).collect();
    let document: DocumentMut = printed
        .parse()
        .map_err(|e| Finding::error("the printed polynomials", format!("are no TOML: {e}"), "use thermal.toml"))?;
    let files: Vec<&Table> = document["file"].as_array_of_tables().into_iter().flatten().collect();
    let mut rows = Vec::new();
    for group in groups(&points, &campaigns[0].file.instructions.thermal, &[]) {
        for kind in Kind::ALL.into_iter().filter(|kind| group.has(*kind)) {
            let Ok(result) = thermal(&group, kind, &lins, false) else { continue };
            let first = digits(&result.runs.files[0]);
            let file = files.iter().find(|f| f["used"][0].as_str().is_some_and(|used| digits(used) == first));
            if let Some(file) = file {
                rows.extend(rows_of(&result, file));
            }
        }
    }
    Ok(rows)
}

/// What tells the run in the name of a parameter file.
fn digits(name: &str) -> String {
    let run = name.split("__").nth(1).unwrap_or(name);
    run.chars().filter(char::is_ascii_digit).collect()
}

fn rows_of(result: &Thermal, file: &Table) -> Vec<Row> {
    let head = &result.runs;
    let mut rows = Vec::new();
    for curve in &result.quantities {
        let Some(printed) = file.get(&curve.found.name).and_then(|item| item.as_array()) else { continue };
        for (power, value) in printed.iter().enumerate() {
            rows.push(Row {
                sensor: head.sensor.clone(),
                mode: head.mode.clone(),
                quantity: curve.found.name.clone(),
                power,
                printed: value.as_float().unwrap_or(f64::NAN),
                found: curve.polynomial.coefficients.get(power).copied().unwrap_or(f64::NAN),
                std: curve.polynomial.covariance.get((power, power)).map_or(f64::NAN, |v| v.sqrt()),
                factor_95: curve.found.factor_95,
            });
        }
    }
    rows
}
