//! Known effects that are taken off the samples of a record in zero field, a stretch at a time.

use super::{Known, KnownEffect, set_tail};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::from_blocks;
use crate::data::run::Run;
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::model::effects::{Family, Record, Row};
use crate::model::position::Position;
use crate::record::prepared::{PreparedRun, Samples};

/// Samples that stand for the record: means and ranges of channels, which some effects refer to, are those at their times.
const PLACES: usize = 2000;

/// The known effects of a run without applied field, as a diagnosis of such a run finds them: every sensor is an ideal one there.
#[derive(Clone, Debug)]
pub struct OffSamples {
    file: String,
    /// Nothing where the run cannot be made ready.
    record: Option<Record>,
    base: usize,
    /// Each with its largest contribution so far, enT.
    effects: Vec<(KnownEffect, f64)>,
    left_out: Vec<String>,
}

impl OffSamples {
    /// For a run whose channels and time span are known. What cannot be taken off is left and told.
    pub fn new(known: &Known, run: &Run, instructions: &Instructions, notes: &mut impl Extend<Note>) -> Self {
        notes.extend(known.untold());
        let file = known.input.path.clone();
        let mut off = Self { file, record: None, base: 0, effects: Vec::new(), left_out: Vec::new() };
        let [begin, end] = run.vectors.span_s.unwrap_or_default();
        let t_s: Vec<f64> = (0..PLACES).map(|i| begin + (end - begin) * i as f64 / (PLACES - 1) as f64).collect();
        let samples = Samples { n: (0..PLACES as u64).collect(), reading_ent: vec![[0.0; 3]; PLACES], t_s };
        let prepared = match PreparedRun::new(run, &from_blocks(&[]), Some(&samples), instructions, None) {
            Ok(prepared) => prepared,
            Err(reason) => {
                let text = format!("no effect of {} was taken off: {}", off.file, reason.0);
                notes.extend([Note::new(NoteKind::Model, text).about(off.file.as_str())]);
                off.left_out = known.effects.iter().map(KnownEffect::name).collect();
                return off;
            }
        };
        for effect in &known.effects {
            let reason = effect.given.of_another(&run.header.run).or_else(|| effect.unusable(&prepared.record));
            match reason.or_else(|| acts_elsewhere(effect, run, instructions)) {
                Some(reason) => {
                    notes.extend([Note::new(NoteKind::Model, format!("not taken off: {reason}")).about(effect.name())]);
                    off.left_out.push(effect.name());
                }
                None => {
                    notes.extend(effect.refers_to(&prepared.record));
                    off.effects.push((effect.clone(), 0.0));
                }
            }
        }
        off.base = prepared.record.rows.len();
        off.record = Some(prepared.record);
        off
    }

    /// Takes the effects off readings, enT, at some times, ascending, s since the run's start.
    pub fn take(&mut self, t_s: &[f64], readings_ent: &mut [[f64; 3]]) {
        let Some(record) = &mut self.record else { return };
        let zero = [0.0; 3];
        let row =
            |t: &f64| Row { run: 0, used_s: [*t; 2], field_coil_nt: zero, earlier_coil_nt: Default::default(), linear_ent: zero };
        set_tail(record, self.base, t_s.iter().map(row).collect());
        for (effect, largest_ent) in &mut self.effects {
            let columns = effect.columns(record).unwrap_or_default();
            let own = effect.contribution(&columns, record.rows.len());
            for (reading, own) in readings_ent.iter_mut().zip(&own[self.base..]) {
                for (value, part) in reading.iter_mut().zip(own) {
                    *value -= part;
                    *largest_ent = largest_ent.max(part.abs());
                }
            }
        }
    }

    /// For a parameter file: what was taken off. Sensitivities are not known here, and are within some percent of one.
    #[must_use]
    pub fn applied(&self) -> ModelApplied {
        let effect = self.effects.iter().map(|(effect, largest_ent)| effect.applied(*largest_ent)).collect();
        ModelApplied { file: self.file.clone(), effect, left_out: self.left_out.clone() }
    }
}

/// Why an effect of the facility is not taken off: it acts along the coils, and without a field nothing but the position tells where the
/// sensor axes look. One that was found in the run itself was found along its sensor axes.
fn acts_elsewhere(effect: &KnownEffect, run: &Run, instructions: &Instructions) -> Option<String> {
    let is_own = effect.given.runs.contains(&run.header.run);
    if effect.given.effect.about().family != Family::Facility || is_own {
        return None;
    }
    let id = run.settings.first()?.position;
    let position = instructions.position(id)?;
    let along = Position::from_axes(&["+X", "+Y", "+Z"].map(str::to_owned)).ok();
    let text = || format!("{} acts along the coils, and the sensor axes look elsewhere in position {id}", effect.given.effect);
    (along != Some(position)).then(text)
}
