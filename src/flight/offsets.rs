//! Offsets that jump (RO-IGEP-TR0028 section 4.2.3.4): that of the interval which holds the time is subtracted.

use super::{Block, Step};
use crate::data::flags::Flags;
use crate::files::flight::mission::Jump;

/// Offsets by time, `[from, to)`; outside of all of them nothing is subtracted, with a flag.
#[derive(Clone, Debug, PartialEq)]
pub struct OffsetsStep {
    /// The offsets.
    pub intervals: Vec<Jump>,
    /// Offsets that are subtracted in another frame: where one of these holds, none is missing.
    pub elsewhere: Vec<Jump>,
}

impl Step for OffsetsStep {
    fn apply(&self, block: &mut Block) {
        let mut last: Option<&Jump> = None;
        for row in 0..block.len() {
            let (time, range) = (block.time[row], block.range[row]);
            if !last.is_some_and(|own| own.holds(time, range)) {
                last = self.intervals.iter().find(|own| own.holds(time, range));
            }
            match last {
                Some(own) => (0..3).for_each(|i| block.field[i][row] -= own.subtract_nt[i]),
                None if !self.elsewhere.iter().any(|own| own.holds(time, range)) => block.flags[row] |= Flags::JUMP.0,
                None => {}
            }
        }
    }
}
