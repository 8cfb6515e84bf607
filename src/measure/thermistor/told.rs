//! What looks wrong in a calibration table: temperatures in another unit, and a row that alone spoils all polynomials.

use super::Signal;
use crate::data::note::{Note, NoteKind};
use crate::fit::statistics::{extremes, fisher_tail};
use crate::fit::{Limits, order, polynomial};
use crate::record::temperature_faults::PLAUSIBLE_DEGC;

/// 0 °C, K.
const ICE_K: f64 = 273.15;
/// A row that chance makes stand out so far less often than this, in any of the rows, does not belong to the others.
const UNLIKELY: f64 = 1e-3;
/// Without it the others scatter by so many times less, and by so many times less than without any other row: what no polynomial describes is left
/// whichever row is taken away.
const CALMER: [f64; 2] = [5.0, 3.0];
/// Rows beyond the coefficients that tell by how much the others scatter.
const LEAST_FREEDOM: usize = 3;

/// Says of temperatures that reach beyond those of sensors and would be usual ones in kelvin.
pub(super) fn as_if_in_kelvin(degc: &[f64], column: &str) -> Option<Note> {
    let [low, high] = extremes(degc.iter().copied());
    let is_kelvin = high > *PLAUSIBLE_DEGC.end() && [low, high].iter().all(|t| PLAUSIBLE_DEGC.contains(&(t - ICE_K)));
    is_kelvin.then(|| {
        let text = format!(
            "the temperatures in {column} go from {low:.1} to {high:.1} °C, as if in kelvin: {:.1} to {:.1} °C",
            low - ICE_K,
            high - ICE_K
        );
        Note::new(NoteKind::Data, text).with_remedy("subtract 273.15 if they are")
    })
}

/// The other rows by a polynomial of the order that they choose.
struct Without {
    /// Table minus polynomial at the row that is not among them, °C.
    off_degc: f64,
    order: usize,
    /// Standard deviation of the others about it, °C.
    std_degc: f64,
    /// Probability that chance makes the row stand out so far.
    chance: f64,
}

impl Without {
    /// `None` if too few others are left.
    fn of(x: &[f64], y: &[f64], row: usize) -> Option<Self> {
        let others = |all: &[f64]| all.iter().enumerate().filter(|(i, _)| *i != row).map(|(_, v)| *v).collect::<Vec<f64>>();
        let (own_x, own_y) = (others(x), others(y));
        let highest = own_x.len().checked_sub(LEAST_FREEDOM + 1)?.min(order::HIGHEST_ORDER);
        let order = order::choose(&own_x, &own_y, None, highest, None, &Limits::default()).ok()?.order;
        let fit = polynomial::fit(&own_x, &own_y, None, order, &Limits::default()).ok()?;
        let (value, unit_std) = fit.evaluate_unscaled(x[row]);
        let off_degc = y[row] - value;
        let ratio = (off_degc / fit.residual_std).powi(2) / (1.0 + unit_std * unit_std);
        Some(Self { off_degc, order, std_degc: fit.residual_std, chance: fisher_tail(ratio, [1.0, fit.dof as f64]) })
    }
}

/// Says of one row that does not belong to the others, by more than `within_degc`; `std_degc` is what the polynomial through all of them leaves.
pub(super) fn one_row(x: &[f64], y: &[f64], signal: Signal, std_degc: f64, within_degc: f64) -> Option<Note> {
    let all: Vec<(usize, Without)> = (0..x.len()).filter_map(|row| Some((row, Without::of(x, y, row)?))).collect();
    let (row, without) = all.iter().min_by(|a, b| a.1.std_degc.total_cmp(&b.1.std_degc))?;
    let next = all.iter().filter(|(other, _)| other != row).map(|(_, w)| w.std_degc).fold(f64::INFINITY, f64::min);
    let stands_out = without.off_degc.abs() > within_degc
        && without.chance * (x.len() as f64) < UNLIKELY
        && std_degc > CALMER[0] * without.std_degc
        && next > CALMER[1] * without.std_degc;
    stands_out.then(|| {
        let text = format!(
            "row {} of the table ({} °C, {} {}) does not go with the others: it lies {:+.3} °C from their polynomial of order {}, about which they scatter \
             by {:.1e} °C; with it the polynomial of the file is spoilt",
            row + 1,
            y[*row],
            x[*row],
            signal.unit(),
            without.off_degc,
            without.order,
            without.std_degc
        );
        Note::new(NoteKind::Data, text).with_remedy("correct the row, or take it out")
    })
}
