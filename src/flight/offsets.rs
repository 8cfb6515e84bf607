//! Offsets that jump (RO-IGEP-TR0028 section 4.2.3.4): that of the interval which holds the time is subtracted.

use super::{Block, Step};
use crate::data::flags::Flags;
use crate::data::time::Tt2000;
use nalgebra::Vector3;

/// Offsets by time, `[from, to)`; outside of all of them nothing is subtracted, with a flag.
#[derive(Clone, Debug, PartialEq)]
pub struct OffsetsStep {
    /// From, to, nT.
    pub intervals: Vec<(Tt2000, Tt2000, Vector3<f64>)>,
    /// Intervals in which an offset is subtracted in another frame; absent for a step that leaves the flag to that one.
    pub elsewhere: Option<Vec<(Tt2000, Tt2000)>>,
}

impl Step for OffsetsStep {
    fn apply(&self, block: &mut Block) {
        let mut last: Option<&(Tt2000, Tt2000, Vector3<f64>)> = None;
        for row in 0..block.len() {
            let time = block.time[row];
            if !last.is_some_and(|(from, to, _)| (*from..*to).contains(&time)) {
                last = self.intervals.iter().find(|(from, to, _)| (*from..*to).contains(&time));
            }
            match last {
                Some((.., offset)) => (0..3).for_each(|i| block.field[i][row] -= offset[i]),
                None => {
                    let outside = |list: &Vec<(Tt2000, Tt2000)>| !list.iter().any(|(from, to)| (*from..*to).contains(&time));
                    if self.elsewhere.as_ref().is_some_and(outside) {
                        block.flags[row] |= Flags::JUMP.0;
                    }
                }
            }
        }
    }
}
