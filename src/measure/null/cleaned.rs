//! What takes the vectors of a zero-field run: known effects are taken off its samples on their way into the record.

use super::Record;
use crate::data::note::Note;
use crate::data::run::{Header, Setting, Vector, VectorSink};
use crate::data::units::Reading;
use crate::model::applied::ModelApplied;
use crate::record::known::OffSamples;

/// Samples of which the effects are computed at once, so that memory does not grow with the run.
const AT_ONCE: usize = 1 << 14;

/// A record whose samples come without known effects, if some are given.
#[derive(Default)]
pub struct Cleaned {
    record: Record,
    known: Option<Box<TakenOff>>,
}

/// Effects, and the samples that wait for them.
struct TakenOff {
    effects: OffSamples,
    notes: Vec<Note>,
    waiting: Vec<Vector>,
}

impl Cleaned {
    /// A record of samples without effects; `notes` tell what cannot be taken off.
    #[must_use]
    pub fn without(effects: OffSamples, notes: Vec<Note>) -> Self {
        let known = TakenOff { effects, notes, waiting: Vec::with_capacity(AT_ONCE) };
        Self { record: Record::default(), known: Some(Box::new(known)) }
    }

    /// The record, with what was taken off and what is to be told of it.
    #[must_use]
    pub fn finish(mut self) -> (Record, Option<(ModelApplied, Vec<Note>)>) {
        let known = self.known.map(|mut known| {
            known.pass_on(&mut self.record);
            (known.effects.applied(), known.notes)
        });
        (self.record, known)
    }
}

impl TakenOff {
    fn pass_on(&mut self, record: &mut Record) {
        let t_s: Vec<f64> = self.waiting.iter().map(|vector| vector.t_s).collect();
        let mut readings: Vec<[f64; 3]> = self.waiting.iter().map(|vector| vector.reading.0).collect();
        self.effects.take(&t_s, &mut readings);
        for (vector, reading) in self.waiting.drain(..).zip(readings) {
            record.vector(Vector { reading: Reading(reading), ..vector });
        }
    }
}

impl VectorSink for Cleaned {
    fn begin(&mut self, header: &Header, settings: &[Setting]) {
        self.record.begin(header, settings);
        if let Some(known) = &mut self.known {
            known.waiting.clear();
        }
    }

    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        match &mut self.known {
            None => self.record.vector(vector),
            Some(known) => {
                known.waiting.push(vector);
                if known.waiting.len() == AT_ONCE {
                    known.pass_on(&mut self.record);
                }
            }
        }
    }
}
