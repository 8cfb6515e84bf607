//! Counts to engineering units (RO-IGEP-TR0028 section 4.2.3.1): `B_r = (n + 2^(b-1)) (B_max - B_min)/(2^b - 1) + B_min`.

use super::{Block, Step};
use crate::data::flags::Flags;

/// Counts to enT.
#[derive(Clone, Debug, PartialEq)]
pub struct CountsStep {
    /// enT per count, by range; the last one for all further ranges.
    pub ent_per_count: Vec<f64>,
    /// enT that are added: a converter with an even number of steps has none at zero.
    pub shift_ent: f64,
    /// The lowest and the highest count of the converter.
    pub limits: [f64; 2],
}

impl Step for CountsStep {
    fn apply(&self, block: &mut Block) {
        for row in 0..block.len() {
            let range = usize::from(block.range[row]).min(self.ent_per_count.len().saturating_sub(1));
            let factor = self.ent_per_count.get(range).copied().unwrap_or(f64::NAN);
            for component in &mut block.field {
                if self.limits.contains(&component[row]) {
                    block.flags[row] |= Flags::SATURATED.0;
                }
                component[row] = component[row] * factor + self.shift_ent;
            }
        }
    }
}
