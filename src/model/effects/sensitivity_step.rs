//! The sensitivity jumps once.

use super::offset_step::{ONSET, near_onset, onsets_s, part_after};
use super::{About, Acts, Column, Effect, Family, GAIN_WITH, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, TIME, Unseen};
use crate::data::run::Kind;

/// Form: an axis by itself.
const STEP: &str = "step";
/// Form: all axes by the same part.
const COMMON: &str = "common step";
/// Most onsets that are tried: half as many as of an offset, since the settings with large fields tell one.
const MOST_ONSETS: usize = 24;

/// The sensitivity jumps once.
pub struct SensitivityStep;

impl Effect for SensitivityStep {
    fn id(&self) -> &'static str {
        "sensitivity_step"
    }

    fn about(&self) -> About {
        About {
            summary: "sensitivity jumps once, of an axis or of all, as that of a reference voltage does",
            formula: "x_i (1 + g) for t > onset",
            family: Family::Time,
            seen_in: "lin, sweep",
            needs: "time, and large fields before and after",
            source: "BC-MAG-TR-0085, remarks",
            best_measurement: "one large field again and again between the settings, and the run once more",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(ONSET, "s")] }
    }

    fn is_of_one_run(&self, _form: &str) -> bool {
        true
    }

    fn begins_s(&self, spec: &Spec) -> Option<f64> {
        spec.get(ONSET)
    }

    fn shown_along(&self, _spec: &Spec) -> Option<String> {
        Some(format!("{GAIN_WITH}{TIME}"))
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn shape_range(&self, record: &Record, _spec: &Spec, _name: &str, value: f64) -> [f64; 2] {
        near_onset(record, value)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        let forms = [Spec::new(STEP, &[0]), Spec::new(STEP, &[1]), Spec::new(STEP, &[2]), Spec::new(COMMON, &[0, 1, 2])];
        let with = |onset_s: f64| forms.clone().map(|form| form.with(ONSET, onset_s, "s"));
        Ok(onsets_s(record, MOST_ONSETS).into_iter().flat_map(with).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let onset_s = spec.get(ONSET)?;
        if spec.form == COMMON {
            let of_all = Column::of("g", "1", record, |_, row| row.linear_ent.map(|x| x * part_after(onset_s, row.used_s)));
            return Some(vec![of_all]);
        }
        let of =
            |axis: usize| Column::on("g", axis, "1", record, |_, row| row.linear_ent[axis] * part_after(onset_s, row.used_s));
        Some(spec.axes.iter().map(|axis| of(*axis)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    /// A jump by a millionth adds a millionth of the reading, from the onset on.
    #[test]
    fn it_changes_readings_in_proportion_and_only_behind_the_onset() {
        let record = example::of(&SensitivityStep).unwrap().record;
        let last = record.rows.len() - 1;
        let onset_s = 0.5 * (record.rows[last - 1].t_s() + record.rows[last].t_s());
        let columns = SensitivityStep.columns(&record, &Spec::new(COMMON, &[0, 1, 2]).with(ONSET, onset_s, "s")).unwrap();
        assert_eq!(columns.len(), 1);
        assert_eq!(columns[0].values[0], [0.0; 3]);
        let [begin, end] = record.rows[last].used_s;
        let part = (end - onset_s.max(begin)) / (end - begin);
        for axis in 0..3 {
            let expected = record.rows[last].linear_ent[axis] * part;
            assert!((columns[0].values[last][axis] - expected).abs() <= 1e-9 * expected.abs(), "axis {axis}");
        }
    }
}
