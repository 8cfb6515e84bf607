//! An effect of one's own in the catalogue: hidden in a run that has none, looked for with the others, and named.
//!
//!     cargo run --release --example own_effect

use calfit::data::plateau::{self, Accumulator};
use calfit::diagnose;
use calfit::files::campaign::Campaign;
use calfit::files::ccr;
use calfit::measure::lin;
use calfit::model::effects::{About, Acts, Catalogue, Column, Effect, Family, Record, Spec, Unseen, singly_and_together};
use std::error::Error;
use std::path::Path;

/// The reading of an axis follows the product of the fields along the two other axes.
struct ProductOfFields;

/// `B_j B_k` of the two other axes, nT²; the field in nT along the coil axes.
fn product(axis: usize, field_coil_nt: [f64; 3]) -> f64 {
    field_coil_nt[(axis + 1) % 3] * field_coil_nt[(axis + 2) % 3]
}

impl Effect for ProductOfFields {
    fn id(&self) -> &'static str {
        "product_of_fields"
    }

    fn about(&self) -> About {
        About {
            summary: "the reading of an axis follows the product of the fields across it",
            formula: "δr_i = c B_j B_k",
            family: Family::CrossField,
            seen_in: "linearity runs and sweeps with settings along more than one axis",
            needs: "fields",
            source: "an example",
            best_measurement: "settings along the diagonals of the coil system, with both signs",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        Ok(singly_and_together("product"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let column = |axis: &usize| Column::on("c", *axis, "enT/nT^2", record, |_, row| product(*axis, row.field_coil_nt));
        Some(spec.axes.iter().map(column).collect())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    // A linearity run without a hidden effect.
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases/26-05-01.CCR.gz");
    let mut means = Accumulator::default();
    let run = ccr::read(&path, &ccr::Options::default(), &mut means).map_err(|findings| findings[0].to_string())?;
    let options = lin::Options::default();
    let mut plateaus = plateau::of_run(&run, means, options.cut);

    // The effect on z, hidden in the means: 1e-6 enT/nT² are 4 enT in 2000 nT along x and y together.
    for p in &mut plateaus.list {
        p.mean.0[2] += 1e-6 * product(2, p.setting.field.0);
    }
    let campaign = Campaign::default();
    let with_own = Catalogue::default().with(&ProductOfFields)?;
    for (name, catalogue) in [("the catalogue", Catalogue::default()), ("the catalogue and the effect", with_own)] {
        let options = diagnose::Options { catalogue, ..diagnose::Options::default() };
        let diagnosis = diagnose::run(&run, &plateaus, None, &campaign, &options)?;
        println!("With {name}: {}", diagnosis.verdict);
        for step in &diagnosis.steps {
            let values: Vec<String> =
                step.parameters.iter().map(|p| format!("{} = {:.4e} {}", p.name, p.value, p.unit)).collect();
            println!("  {} on {}: {}", step.effect, step.axes.join(", "), values.join(", "));
        }
    }
    Ok(())
}
