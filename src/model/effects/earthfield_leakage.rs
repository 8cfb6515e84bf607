//! The dynamic compensation of the Earth field is imperfect.

use super::coil_temperature::moving;
use super::record::centred;
use super::{About, Acts, Column, Effect, Family, PART_OF_THE_OFFSETS, Record, Spec, Unseen, one, singly_and_together};
use crate::data::run::Kind;
use crate::data::units::COMPONENTS;

/// Form: each axis has a part of its own variometer axis.
const OWN: &str = "own axis";
/// The covariate in words.
const VARIOMETER: &str = "variometer";
/// Form: the compensation acts on the wrong axes too, as with coils or a variometer that are turned.
const CROSSED: &str = "crossed axes";

/// The dynamic compensation of the Earth field is imperfect.
pub struct EarthfieldLeakage;

impl Effect for EarthfieldLeakage {
    fn id(&self) -> &'static str {
        "earthfield_leakage"
    }

    fn about(&self) -> About {
        About {
            summary: "imperfect dynamic compensation of the Earth field",
            formula: "B_k += κ_k v_k on coil axis k (own axis), or B_k += Σ_j κ_kj v_j (crossed axes), v = variometer less its mean over the run",
            family: Family::Facility,
            seen_in: "lin, zero-field",
            needs: "variometer",
            source: "BC-MAG-TR-0085 section 8",
            best_measurement: "zero field during a disturbed night, with the variometer recorded",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_OFFSETS)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let variometer = record.variometer.as_ref().ok_or(Unseen::NotRecorded(VARIOMETER))?;
        for channel in variometer {
            moving(Some(channel), VARIOMETER)?;
        }
        let mut specs = singly_and_together(OWN);
        specs.extend(singly_and_together(CROSSED));
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let variometer = record.variometer.as_ref()?;
        let deviations = [0, 1, 2].map(|k: usize| centred(&variometer[k]));
        let column = |name: String, k: usize, from: usize| {
            Column::of(name, "nT/nT", record, |i, _| record.reading(one(k, deviations[from][i])))
        };
        let own = |&k: &usize| column(format!("kappa_{}", COMPONENTS[k]), k, k);
        if spec.form != CROSSED {
            return Some(spec.axes.iter().map(own).collect());
        }
        let crossed = |&k: &usize| [0, 1, 2].map(|from| column(format!("kappa_{}{}", COMPONENTS[k], COMPONENTS[from]), k, from));
        Some(spec.axes.iter().flat_map(crossed).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    /// The sensor of the example stands along the coils and reads nT: what the variometer's y does on coil axis x is read on x alone.
    #[test]
    fn crossed_axes_are_read_where_they_act() {
        let record = example::of(&EarthfieldLeakage).unwrap().record;
        let columns = EarthfieldLeakage.columns(&record, &Spec::new(CROSSED, &[0, 1, 2])).unwrap();
        let names: Vec<&str> = columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names[..4], ["kappa_xx", "kappa_xy", "kappa_xz", "kappa_yx"]);
        let y = &record.variometer.as_ref().unwrap()[1];
        for (value, deviation) in columns[1].values.iter().zip(&y.values) {
            assert_eq!(*value, [deviation - y.mean, 0.0, 0.0]);
        }
    }
}
