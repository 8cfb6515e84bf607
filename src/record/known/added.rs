//! Known effects in simulated samples: what they add to readings that are made without them.

use super::{Given, Known, KnownEffect, set_tail};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Drop, Plateau, Plateaus, from_blocks};
use crate::data::run::{Kind, Run, Setting};
use crate::data::units::Reading;
use crate::model::campaign::Instructions;
use crate::model::effects::record::earlier_fields;
use crate::model::effects::{Changes, Record, Row};
use crate::record::prepared::{PreparedRun, Samples};

/// Samples that are evaluated at a time, so that memory does not grow with the run.
pub const CHUNK: usize = 4096;
/// Samples that stand for a simulated record in zero field.
const ZERO_FIELD_SAMPLES: usize = 2000;

/// What known effects add to the samples of a run, a chunk at a time.
#[derive(Clone, Debug)]
pub struct Added {
    record: Record,
    base: usize,
    settings: Vec<Setting>,
    effects: Vec<KnownEffect>,
}

impl Added {
    /// For a run whose readings without effects and noise are `level_ent` at any time. What the run cannot have is warned about.
    pub fn new(
        known: &Known,
        run: &Run,
        level_ent: impl Fn(f64) -> [f64; 3],
        instructions: &Instructions,
        notes: &mut impl Extend<Note>,
    ) -> Option<Self> {
        let (file, id, kind) = (&known.input.path, &run.header.run, run.header.kind);
        if !matches!(kind, Kind::Linearity | Kind::Sweep | Kind::ZeroField) {
            notes.extend([Note::new(
                NoteKind::Model,
                format!("the effects of {file} are not added to run {id}, which is of kind {kind}"),
            )
            .about(id.as_str())]);
            return None;
        }
        let plateau = |(index, s): (usize, &Setting)| Plateau {
            index,
            setting: *s,
            used_s: [s.t_start_s, s.t_end_s],
            mean: Reading(level_ent(0.5 * (s.t_start_s + s.t_end_s))),
            std_ent: None,
            count: None,
            spike_samples: 0,
            dropped: (s.frequency_hz > 0.0).then_some(Drop::Sine),
            contrasts: Vec::new(),
        };
        let list: Vec<Plateau> = run.settings.iter().enumerate().map(plateau).collect();
        let times: Vec<f64> = if kind == Kind::ZeroField {
            let [begin, end] = [list.first().map_or(0.0, |p| p.used_s[0]), list.last().map_or(0.0, |p| p.used_s[1])];
            (0..ZERO_FIELD_SAMPLES).map(|i| begin + (end - begin) * i as f64 / (ZERO_FIELD_SAMPLES - 1) as f64).collect()
        } else {
            let ends = run.settings.windows(2).map(|w| [w[0].t_end_s, w[1].t_start_s]);
            ends.filter(|[end, begin]| begin > end).map(|[end, begin]| 0.5 * (end + begin)).collect()
        };
        let samples = Samples {
            n: (0..times.len() as u64).collect(),
            reading_ent: times.iter().map(|t| level_ent(*t)).collect(),
            t_s: times,
        };
        let plateaus = Plateaus { list, ..from_blocks(&[]) };
        let prepared = match PreparedRun::new(run, &plateaus, Some(&samples), instructions, None) {
            Ok(prepared) => prepared,
            Err(reason) => {
                notes.extend([Note::new(
                    NoteKind::Model,
                    format!("the effects of {file} are not added to run {id}: {}", reason.0),
                )
                .about(id.as_str())]);
                return None;
            }
        };
        let mut effects = Vec::new();
        for effect in &known.effects {
            // The readings that are simulated follow the part that matters: its lag is a term of theirs.
            let effect = match effect.given.effect.changes() {
                Changes::Temperatures => {
                    KnownEffect { given: Given { values: vec![1.0], ..effect.given.clone() }, ..effect.clone() }
                }
                _ => effect.clone(),
            };
            match effect.unusable(&prepared.record) {
                Some(reason) => {
                    notes.extend([Note::new(NoteKind::Model, format!("not added to run {id}: {reason}")).about(effect.name())])
                }
                None => {
                    effect.extrapolates(&prepared.record, file, notes);
                    effects.push(effect);
                }
            }
        }
        let base = prepared.record.rows.len();
        (!effects.is_empty()).then(|| Self { record: prepared.record, base, settings: run.settings.clone(), effects })
    }

    /// The sum of the effects at some times, ascending, s since the run's start: enT.
    pub fn at(&mut self, t_s: &[f64]) -> Vec<[f64; 3]> {
        let row = |t: &f64| {
            // The setting that holds, or the one before a pause.
            let last = self.settings.partition_point(|s| s.t_start_s <= *t).checked_sub(1);
            let setting = last.map(|i| &self.settings[i]);
            let holds = setting.is_some_and(|s| *t < s.t_end_s && s.frequency_hz == 0.0);
            let zero = [0.0; 3];
            // In a pause the last setting is one of those before.
            let pause = usize::from(!holds);
            let before = |back: usize| self.settings.get((last? + pause).checked_sub(back)?).map(|s| s.field.0);
            let field = setting.map_or(zero, |s| s.field.0);
            Row {
                run: 0,
                used_s: [*t; 2],
                field_coil_nt: if holds { field } else { zero },
                earlier_coil_nt: earlier_fields(before),
                linear_ent: zero,
            }
        };
        let rows = t_s.iter().map(row).collect();
        set_tail(&mut self.record, self.base, rows);
        let mut sum = vec![[0.0; 3]; t_s.len()];
        for effect in &self.effects {
            for (column, value) in effect.columns(&self.record).unwrap_or_default().iter().zip(&effect.given.values) {
                for (total, unit) in sum.iter_mut().zip(&column.values[self.base..]) {
                    (0..3).for_each(|a| total[a] += value * unit[a]);
                }
            }
        }
        sum
    }
}
