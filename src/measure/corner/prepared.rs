//! The amplitudes of one component as a fit takes them, and where fits start.

use super::refusal::Refusal;
use super::rows::{Amplitude, std_ent, usable};
use crate::fit::contaminated::Data;
use crate::fit::statistics::extremes;
use crate::model::response::Response;
use std::f64::consts::FRAC_1_SQRT_2;

/// Level above which amplitudes decide, relative to DC: -10 dB.
pub const DECIDING: f64 = 0.316_227_766_016_837_94;
/// Amplitudes above and below that level needed to tell their scatter apart: below those numbers a response could follow either.
const FEWEST_IN_GROUP: [usize; 2] = [12, 4];
/// Scatter above and below that level is not estimated below this share of the DC amplitude: rounding, and the lobes of the tables
/// of 2013, which a response can follow only where it gives up rows at the corner.
const LEAST_SCATTER: [f64; 2] = [1e-6, 0.05];
/// Share of the outliers that read too low: what is lost or mixed with another setting lowers an amplitude. A response through low
/// readings that leaves the good ones above it is hardly possible then.
const OUTLIERS_BELOW: f64 = 0.98;
/// Factors on the corner at the start.
const START_CORNER: [f64; 3] = [1.0, 0.85, 1.18];
/// First and last crossing of -3 dB are both tried if they differ by more than this factor.
const APART: f64 = 1.3;

/// The amplitudes of one component in the form the fit takes them, relative to a first guess of the DC amplitude.
pub(super) struct Prepared {
    /// Row of the table of each.
    pub rows: Vec<usize>,
    /// Frequency of each, Hz.
    pub frequencies: Vec<f64>,
    /// Time of each, -1 at the first and 1 at the last of the table; nan where that is not known.
    pub times: Vec<f64>,
    /// The amplitudes, relative to `dc`.
    pub data: Data,
    /// First guess of the DC amplitude, enT.
    pub dc: f64,
    /// First guesses, Hz.
    corners: Vec<f64>,
}

/// Middle of the shortest interval with half of the values: where most of them are, whatever the others do.
fn mode(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2 + 1;
    let middles = values.windows(half.min(values.len()).max(1)).filter_map(|w| Some((w.last()? - w.first()?, w)));
    let (_, shortest) = middles.min_by(|a, b| a.0.total_cmp(&b.0))?;
    shortest.get(shortest.len() / 2).copied()
}

/// Times of the rows of a table, -1 at the first and 1 at the last one; nan where one of them is not known.
pub(super) fn relative_times(table: &[Amplitude]) -> Vec<f64> {
    if table.iter().any(|row| row.usable && !row.t_s.is_finite()) {
        return vec![f64::NAN; table.len()];
    }
    let [first, last] = extremes(table.iter().filter(|row| row.usable).map(|row| row.t_s));
    table.iter().map(|row| (2.0 * row.t_s - first - last) / (last - first)).collect()
}

impl Prepared {
    pub fn new(table: &[Amplitude], component: usize, omitted: &[usize]) -> Result<Self, Refusal> {
        let rows = usable(table, component, omitted);
        let amplitude = |i: usize| table[i].amplitude_ent[component];
        let mut low: Vec<f64> = rows.iter().take(rows.len().div_ceil(2)).map(|&i| amplitude(i)).collect();
        let dc = mode(&mut low).filter(|dc| *dc > 0.0 && dc.is_finite()).ok_or(Refusal::NoAmplitude)?;
        let frequencies: Vec<f64> = rows.iter().map(|&i| table[i].frequency_hz).collect();
        let points: Vec<(f64, f64)> = frequencies.iter().copied().zip(rows.iter().map(|&i| amplitude(i) / dc)).collect();
        let last_above = |level: f64| points.iter().rposition(|(_, relative)| *relative >= level);
        let highest_hz = frequencies.last().copied().unwrap_or(0.0);
        let crossing = |i: usize| match (points.get(i), points.get(i + 1)) {
            (Some(&(low, above)), Some(&(high, below))) if above > below => {
                Some(low + (above - FRAC_1_SQRT_2) / (above - below) * (high - low))
            }
            _ => None,
        };
        let last = last_above(FRAC_1_SQRT_2).and_then(crossing).ok_or(Refusal::NoCrossing { highest_hz })?;
        // Two neighbours below are seldom damaged both, and a response may come up again.
        let fallen = |pair: &[(f64, f64)]| pair.iter().all(|(_, relative)| *relative < FRAC_1_SQRT_2);
        let first = points.windows(2).position(fallen).and_then(|i| crossing(i.checked_sub(1)?));
        let apart = |first: &f64| !(1.0 / APART..=APART).contains(&(first / last));
        let corners = std::iter::once(last).chain(first.filter(apart)).filter(|corner| *corner > 0.0).collect();
        let deciding = last_above(DECIDING).map_or(0, |i| i + 1);
        let counts = [deciding, rows.len() - deciding];
        let split = counts.iter().zip(FEWEST_IN_GROUP).all(|(count, fewest)| *count >= fewest);
        let data = Data {
            observations: points.iter().map(|(_, relative)| *relative).collect(),
            std: rows.iter().map(|&i| std_ent(&table[i], component) / dc).collect(),
            coarse: (0..rows.len()).map(|i| split && i >= deciding).collect(),
            range: 1.0,
            below: OUTLIERS_BELOW,
            least_scatter: LEAST_SCATTER,
        };
        let all_times = relative_times(table);
        let times = rows.iter().map(|&i| all_times[i]).collect();
        Ok(Self { rows, frequencies, times, data, dc, corners })
    }

    /// Number of scatters that are estimated.
    pub fn scatters(&self) -> usize {
        if self.data.coarse.contains(&true) { 2 } else { 1 }
    }

    /// Logarithms of the parameters to start a fit of a response from.
    pub fn starts(&self, response: Response) -> Vec<Vec<f64>> {
        let corners = START_CORNER.iter().flat_map(|factor| self.corners.iter().map(move |corner| factor * corner));
        let sets = corners.flat_map(|corner| response.starts(corner));
        sets.map(|start| std::iter::once(0.0).chain(start.iter().map(|p| p.ln())).collect()).collect()
    }
}
