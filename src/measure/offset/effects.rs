//! Known effects of the sensor in an offset run: those that are functions of the reading without its offset are taken off the mean readings
//! of all positions; all others belong to circumstances that a turned sensor does not share with the run in which they were found.

use super::carried::Carried;
use super::levels::Levels;
use super::refusal::OffsetError;
use super::solved::Solved;
use super::stay::{pooled, stays};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateaus;
use crate::data::result::Covariance;
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::record::known::Known;
use crate::record::single_readings::SingleReadings;

/// What was taken off the means of a run.
pub(super) struct Taken {
    /// For the parameter file.
    pub part: ModelApplied,
    /// For every uncertain parameter the changes of the means of all plateaus by its standard uncertainty, enT.
    changes_ent: Vec<Vec<[f64; 3]>>,
}

impl Taken {
    /// Takes the effects off all plateaus, with the offsets that the run shows before.
    pub fn off(
        known: &Known,
        plateaus: &mut Plateaus,
        instructions: &Instructions,
        notes: &mut Vec<Note>,
    ) -> Result<Self, OffsetError> {
        notes.extend(known.untold());
        let file = &known.input.path;
        let (effects, left_out) = SingleReadings::of_these(known);
        for left in &left_out {
            let text = format!("not taken off: {} of {file}: {}", left.name, left.why);
            notes.push(Note::new(NoteKind::Model, text).about(left.name.as_str()));
        }
        let (offset_ent, nt_per_ent) = {
            let visits = pooled(stays(plateaus, instructions)?);
            let levels = Levels::measure(&visits)?;
            // A response without an inverse is refused afterwards.
            let inverse = levels.response.first().and_then(|a| a.try_inverse());
            let nt_per_ent = std::array::from_fn(|a| inverse.map_or(0.0, |inverse| inverse.column(a).norm()));
            (Solved::of(&visits, &levels, None)?.values.offset_ent, nt_per_ent)
        };
        // A component without an offset has no result that anything could be taken off.
        let offset_ent = offset_ent.map(|v| if v.is_nan() { 0.0 } else { v });
        let readings: Vec<[f64; 3]> =
            plateaus.list.iter().map(|p| std::array::from_fn(|a| p.mean.0[a] - offset_ent[a])).collect();
        let taken = effects.taken_off(&readings);
        let count = taken.first().map_or(0, |one| one.uncertain_ent.len());
        let changes_ent = (0..count).map(|k| taken.iter().map(|one| one.uncertain_ent[k]).collect()).collect();
        if taken.iter().zip(&plateaus.list).any(|(one, p)| one.beyond && p.dropped.is_none()) {
            let text = format!("effects of {file} are taken off readings beyond those with which they were found");
            notes.push(Note::new(NoteKind::Model, text).about(file.as_str()));
        }
        for (plateau, one) in plateaus.list.iter_mut().zip(&taken) {
            (0..3).for_each(|a| plateau.mean.0[a] -= one.sum_ent[a]);
        }
        let part = ModelApplied {
            file: file.clone(),
            effect: effects.applied(&readings, nt_per_ent),
            left_out: left_out.into_iter().map(|left| left.name).collect(),
        };
        Ok(Self { part, changes_ent })
    }

    /// Adds to the uncertainties what those of the effects do.
    pub fn widen(
        &self,
        plateaus: &Plateaus,
        instructions: &Instructions,
        levels: &Levels,
        solved: &mut Solved,
    ) -> Result<(), OffsetError> {
        let moved = self.changes_ent.iter().map(|changes| {
            let mut moved = plateaus.clone();
            for (plateau, by) in moved.list.iter_mut().zip(changes) {
                (0..3).for_each(|a| plateau.mean.0[a] += by[a]);
            }
            moved
        });
        let carried = Carried::of(moved, instructions, levels, solved)?;
        let std = carried.std(&solved.values);
        let values = &mut solved.values;
        let widened = [
            (&mut values.offset_std_ent, std.offset_ent),
            (&mut values.residual_std_ent, std.residual_ent),
            (&mut values.residual_coil_std_nt, std.residual_coil_nt),
        ];
        for (own, by) in widened {
            (0..3).for_each(|i| own[i] = own[i].hypot(by[i]));
        }
        solved.covariance = solved.covariance.plus(&Covariance { matrix: carried.matrix, ..solved.covariance.clone() });
        Ok(())
    }
}
