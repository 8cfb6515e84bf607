//! One interval in cells of equal length: what the search for edges sees, whatever the rates of the modes.

use nalgebra::Vector3;

use super::screen::short_runs;
use super::{HeaterInterval, HeaterOptions};

/// Missing cells in a row that are filled by a straight line. A lost vector then costs one cell of evidence, and not all that
/// follow from it.
pub(super) const FILLED_CELLS: usize = 3;

/// Means of the field over the cells of one interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Middle of the first cell.
    pub start_tt2000: i64,
    /// Length of a cell.
    pub cell_ns: i64,
    /// Mean of every cell; NaN where a cell has no vector and is not one of a few that could be filled.
    pub field_nt: Vec<Vector3<f64>>,
    /// Rows of the vectors of short runs, which are in no cell.
    pub short: Vec<usize>,
}

impl Cells {
    /// The cells of the vectors within an interval; vectors that are null or of `short_runs` count as missing. `None` where the interval has no
    /// vector.
    #[must_use]
    pub fn of(time_tt2000: &[i64], field_nt: &[Vec<f64>; 3], interval: HeaterInterval, options: &HeaterOptions) -> Option<Self> {
        let cell_ns = (options.cell_s * 1e9).round() as i64;
        let rows = interval.rows(time_tt2000);
        let vector = |row: usize| Vector3::new(field_nt[0][row], field_nt[1][row], field_nt[2][row]);
        let short = short_runs(time_tt2000, field_nt, interval, options);
        let is_left = |row: &usize| vector(*row).iter().all(|value| value.is_finite()) && short.binary_search(row).is_err();
        let mut present = rows.filter(is_left).peekable();
        let start_tt2000 = time_tt2000[*present.peek()?];
        let cells = ((interval.to_tt2000 - start_tt2000) / cell_ns) as usize + 2;
        let (mut sums, mut counts) = (vec![Vector3::zeros(); cells], vec![0_u32; cells]);
        for row in present {
            let cell = ((time_tt2000[row] - start_tt2000 + cell_ns / 2) / cell_ns) as usize;
            sums[cell] += vector(row);
            counts[cell] += 1;
        }
        while counts.last() == Some(&0) {
            counts.pop();
        }
        let mut field: Vec<_> = sums.iter().zip(&counts).map(|(sum, &count)| sum / f64::from(count)).collect();
        fill(&mut field);
        Some(Cells { start_tt2000, cell_ns, field_nt: field, short })
    }

    /// Field of every cell minus that of the cell before, NaN where one of the two is missing; the first is always missing.
    pub(super) fn increments(&self) -> Vec<Vector3<f64>> {
        let missing = std::iter::once(Vector3::repeat(f64::NAN));
        missing.chain(self.field_nt.windows(2).map(|pair| pair[1] - pair[0])).collect()
    }

    /// The time of a place that is counted in cells from the middle of the first one.
    pub(super) fn time_tt2000(&self, cell: f64) -> i64 {
        self.start_tt2000 + (cell * self.cell_ns as f64).round() as i64
    }

    /// The place of a time, counted in cells from the middle of the first one.
    pub(super) fn place(&self, time_tt2000: i64) -> f64 {
        (time_tt2000 - self.start_tt2000) as f64 / self.cell_ns as f64
    }
}

/// Fills short runs of missing cells linearly.
fn fill(field: &mut [Vector3<f64>]) {
    let mut last: Option<usize> = None;
    for cell in 0..field.len() {
        if field[cell].x.is_nan() {
            continue;
        }
        if let Some(before) = last
            && (2..=FILLED_CELLS + 1).contains(&(cell - before))
        {
            let (from, step) = (field[before], (field[cell] - field[before]) / (cell - before) as f64);
            (before + 1..cell).for_each(|missing| field[missing] = from + step * (missing - before) as f64);
        }
        last = Some(cell);
    }
}

/// Share of a switched-on heater in the mean over a cell, against the distance in cells of the middle of the cell from the middle
/// of the edge.
///
/// The field of an edge rises linearly over `edge_cells`; the mean over a cell is the integral of that rise, which is a closed
/// form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Profile {
    /// Duration of the rise.
    pub edge_cells: f64,
    /// Length over which the field is averaged, 1 for the cells themselves.
    pub mean_cells: f64,
}

impl Profile {
    /// Distance from the middle of the edge beyond which nothing changes.
    pub fn half_cells(self) -> f64 {
        0.5 * (self.edge_cells + self.mean_cells)
    }

    /// The share at a distance, 0 long before and 1 long after the edge.
    pub fn share(self, distance: f64) -> f64 {
        let half = 0.5 * self.mean_cells;
        (self.integral(distance + half) - self.integral(distance - half)) / self.mean_cells
    }

    /// Integral of the rise from its start.
    fn integral(self, at: f64) -> f64 {
        let half = 0.5 * self.edge_cells;
        if at >= half {
            at
        } else if at <= -half {
            0.0
        } else {
            (at + half).powi(2) / (2.0 * self.edge_cells)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::heater::HeaterMethod;

    #[test]
    fn means_of_cells_gaps_and_nulls() {
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
        // 2 Hz, one vector null, one cell lost, a gap of five cells that stays open.
        let second = 1_000_000_000;
        let halves = [0, 1, 2, 3, 6, 7, 20, 21];
        let time: Vec<i64> = halves.iter().map(|half| 7 * second + half * second / 2).collect();
        let mut x: Vec<f64> = halves.iter().map(|&half| half as f64).collect();
        x[3] = f64::NAN;
        let field = [x, vec![1.0; 8], vec![-2.0; 8]];
        let interval = HeaterInterval { from_tt2000: 7 * second, to_tt2000: 100 * second };
        let cells = Cells::of(&time, &field, interval, &options).expect("there are vectors");
        assert_eq!((cells.start_tt2000, cells.cell_ns), (7 * second, second));
        // A cell holds the vectors within half a second before its middle to just below half a second after it.
        let expected = [0.0, 1.5, 3.75, 6.0, 7.0];
        for (cell, value) in expected.into_iter().enumerate() {
            assert!((cells.field_nt[cell].x - value).abs() < 1e-12, "{cell} {}", cells.field_nt[cell].x);
        }
        assert!((5..10).all(|cell| cells.field_nt[cell].x.is_nan()));
        assert_eq!(cells.field_nt[10], Vector3::new(20.0, 1.0, -2.0));
        assert!(Cells::of(&time, &field, HeaterInterval { from_tt2000: 0, to_tt2000: second }, &options).is_none());
    }

    #[test]
    fn the_profile_is_the_integral_of_a_ramp() {
        // Ramp and mean of equal length make two parabolas.
        let profile = Profile { edge_cells: 1.0, mean_cells: 1.0 };
        for (distance, share) in [(-1.0, 0.0), (-0.5, 0.125), (0.0, 0.5), (0.25, 0.71875), (1.0, 1.0), (5.0, 1.0)] {
            assert!((profile.share(distance) - share).abs() < 1e-12, "{distance}");
        }
        // A sudden edge is a ramp as long as the mean.
        let sudden = Profile { edge_cells: 0.0, mean_cells: 1.0 };
        assert!((sudden.share(0.25) - 0.75).abs() < 1e-12 && sudden.half_cells() == 0.5);
    }
}
