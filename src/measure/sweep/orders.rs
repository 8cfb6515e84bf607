//! The orders of the polynomials of a sweep: asked for, or chosen from the settings.

use super::fit::Problem;
use super::means::LinearOrders;
use super::options::Options;
use super::refusal::SweepError;
use super::{ANGLES, QUANTITIES};
use crate::data::run::Run;
use crate::fit::{aicc, order};
use crate::measure::joint::SensorFit;
use crate::measure::thermal::asked_order;
use crate::model::campaign::Instructions;

/// Orders that are tried where none is given; the mount may keep still as well.
const LOWEST: usize = 1;
const HIGHEST: usize = 4;
/// Order of what nobody asks an order for, until the choice.
const USUAL: usize = 2;

/// Orders of the polynomials of the temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Orders {
    /// Of the quantities, in their order.
    pub quantities: [usize; 9],
    /// Of the rotation of the sensor, which is no result: a mount turns with the temperature by what it likes.
    pub rotation: usize,
}

impl Orders {
    /// Number of coefficients.
    pub fn count(&self) -> usize {
        self.quantities.iter().map(|order| order + 1).sum::<usize>() + 3 * (self.rotation + 1)
    }

    /// Orders of a linear model that comes near: of the response and of the offset.
    pub fn linear(&self) -> LinearOrders {
        let highest = |orders: &[usize]| orders.iter().copied().fold(0, usize::max);
        LinearOrders {
            response: highest(&self.quantities[..ANGLES.end]).max(self.rotation),
            offset: highest(&self.quantities[ANGLES.end..]),
        }
    }

    /// One order higher, all of them, as far as polynomials are fitted.
    pub fn higher(self) -> Self {
        let next = |order: usize| (order + 1).min(order::HIGHEST_ORDER);
        Self { quantities: self.quantities.map(next), rotation: next(self.rotation) }
    }

    /// Which of the parameters of a fit with higher orders are those of these orders.
    fn among(&self, fit: &SensorFit) -> Vec<bool> {
        let mut free = vec![false; fit.count()];
        for (polynomial, order) in self.quantities.into_iter().enumerate() {
            free[fit.range(polynomial)][..=order].fill(true);
        }
        free[fit.turn()][..3 * (self.rotation + 1)].fill(true);
        free
    }
}

/// Orders that the analyst or the campaign asks for.
pub(super) struct Asked([Option<usize>; 9]);

impl Asked {
    /// What the analyst asks for now goes before what the campaign says.
    pub fn of(run: &Run, instructions: &Instructions, options: &Options) -> Self {
        let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
        let entries = instructions.thermal.iter();
        let entry = entries.filter(|e| applies(&e.sensor, &run.header.sensor) && applies(&e.mode, &run.header.mode));
        let of_campaign = entry.flat_map(|e| e.orders.iter().map(|(n, o)| (n.clone(), *o as usize)));
        let all: Vec<(String, usize)> = options.orders.iter().rev().cloned().chain(of_campaign).collect();
        Self(QUANTITIES.map(|(name, ..)| asked_order(&all, name)))
    }

    /// Whether the order of a quantity was asked for.
    pub fn has(&self, quantity: usize) -> bool {
        self.0[quantity].is_some()
    }

    fn with(&self, other: usize, rotation: usize) -> Orders {
        Orders { quantities: self.0.map(|order| order.unwrap_or(other)), rotation }
    }

    /// Second order where nothing is asked for.
    pub fn usual(&self) -> Orders {
        self.with(USUAL, USUAL)
    }

    /// These orders, one higher where they were asked for. The others are higher than they need be already, see [`Asked::choose`].
    pub fn above(&self, orders: Orders) -> Orders {
        let higher = orders.higher();
        Orders {
            quantities: std::array::from_fn(|k| if self.has(k) { higher.quantities[k] } else { orders.quantities[k] }),
            ..orders
        }
    }

    /// Those that were asked for, the others one above those that the AICc of all quantities together prefers: from the highest that the
    /// settings determine, one after the other is lowered as long as that is no worse than by [`order::TIE`].
    ///
    /// A coefficient of some 2 standard deviations is left out as often as not. What that does to the others is in no covariance: slopes are off
    /// by three times what they state. With one order more, whatever is left out is small beside what is stated.
    ///
    /// # Errors
    /// Not even the lowest are determined.
    pub fn choose(&self, problem: &Problem, degc: &[f64]) -> Result<Orders, SweepError> {
        let mut highest = HIGHEST;
        let fit = loop {
            match problem.fit(degc, self.with(highest, highest)) {
                Ok(fit) => break fit,
                Err(error) if highest == LOWEST => return Err(error),
                Err(_) => highest -= 1,
            }
        };
        let information = fit.information();
        let rows = problem.settings();
        let criterion = |orders: &Orders| {
            let squares = fit.squares_with(&information, &orders.among(&fit))?;
            let deviance: f64 = squares.iter().map(|s| rows as f64 * (s / rows as f64).ln()).sum();
            aicc(deviance, orders.count() + 3, 3 * rows)
        };
        let mut best = self.with(highest, highest);
        let mut now = criterion(&best).unwrap_or(f64::INFINITY);
        loop {
            let lower = (0..best.quantities.len()).filter(|k| !self.has(*k) && best.quantities[*k] > LOWEST).map(|k| {
                let mut orders = best;
                orders.quantities[k] -= 1;
                orders
            });
            let stiller = (best.rotation > 0).then(|| Orders { rotation: best.rotation - 1, ..best });
            let scored = lower.chain(stiller).filter_map(|orders| Some((criterion(&orders)?, orders)));
            match scored.min_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((value, orders)) if value <= now + order::TIE => (now, best) = (value, orders),
                _ => return Ok(self.raised(best, highest)),
            }
        }
    }

    fn raised(&self, orders: Orders, highest: usize) -> Orders {
        let next = |order: usize| (order + 1).min(highest);
        let quantities = std::array::from_fn(|k| if self.has(k) { orders.quantities[k] } else { next(orders.quantities[k]) });
        Orders { quantities, rotation: next(orders.rotation) }
    }
}
