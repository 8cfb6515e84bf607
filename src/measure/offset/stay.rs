//! The visits of positions.

use super::refusal::OffsetError;
use crate::data::plateau::{Plateau, Plateaus};
use crate::model::campaign::Instructions;
use crate::model::position::Position;
use crate::record::position::position;

/// Most visits that have a zero level each: the equations grow with the cube of them, and nobody reads a longer table.
const MOST_VISITS: usize = 48;

/// Consecutive plateaus in one position, or those of several visits to it one soon after the other.
pub(super) struct Stay<'a> {
    /// Id of the position.
    pub id: u32,
    /// The position.
    pub position: Position,
    /// The plateaus.
    pub plateaus: Vec<&'a Plateau>,
}

impl Stay<'_> {
    /// First and last used time, s since the run's start.
    pub fn time_s(&self) -> [f64; 2] {
        let first = self.plateaus.iter().map(|p| p.used_s[0]).fold(f64::INFINITY, f64::min);
        let last = self.plateaus.iter().map(|p| p.used_s[1]).fold(f64::NEG_INFINITY, f64::max);
        [first, last]
    }

    /// Mean time of the readings, s.
    pub fn mean_s(&self) -> f64 {
        self.plateaus.iter().map(|p| p.t_s()).sum::<f64>() / self.plateaus.len() as f64
    }
}

/// The visits of positions in time order; plateaus that are dropped belong to none.
pub(super) fn stays<'a>(plateaus: &'a Plateaus, instructions: &Instructions) -> Result<Vec<Stay<'a>>, OffsetError> {
    let mut stays: Vec<Stay> = Vec::new();
    for plateau in plateaus.list.iter().filter(|p| p.dropped.is_none()) {
        let id = plateau.setting.position;
        match stays.last_mut() {
            Some(stay) if stay.id == id => stay.plateaus.push(plateau),
            _ => {
                let position = position(id, instructions)?;
                stays.push(Stay { id, position, plateaus: vec![plateau] });
            }
        }
    }
    if stays.is_empty() {
        let reason = plateaus.list.iter().find_map(|p| p.dropped.as_ref()).map_or_else(String::new, ToString::to_string);
        return Err(OffsetError::NothingUsable { total: plateaus.list.len(), reason });
    }
    Ok(stays)
}

/// Visits to a position in the same stretch of the run taken together, so that there are not more than [`MOST_VISITS`] as long as there
/// are fewer positions.
pub(super) fn pooled(stays: Vec<Stay<'_>>) -> Vec<Stay<'_>> {
    if stays.len() <= MOST_VISITS {
        return stays;
    }
    let stretches = (MOST_VISITS / ids(&stays).len()).max(1);
    let visits = stays.len();
    let mut pooled: Vec<(usize, Stay)> = Vec::new();
    for (visit, stay) in stays.into_iter().enumerate() {
        let stretch = visit * stretches / visits;
        match pooled.iter_mut().rev().take_while(|(s, _)| *s == stretch).find(|(_, p)| p.id == stay.id) {
            Some((_, same)) => same.plateaus.extend(stay.plateaus),
            None => pooled.push((stretch, stay)),
        }
    }
    pooled.into_iter().map(|(_, stay)| stay).collect()
}

/// The ids of the positions, each once, in their order.
pub(super) fn ids(stays: &[Stay]) -> Vec<u32> {
    let mut ids: Vec<u32> = stays.iter().map(|s| s.id).collect();
    ids.sort_unstable();
    ids.dedup();
    ids
}
