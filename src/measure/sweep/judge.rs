//! What the fit of a sweep leaves that a person should know.

use super::QUANTITIES;
use super::fit::Problem;
use super::lag::Settled;
use super::orders::Asked;
use super::result::SweepBlock;
use super::thermistors::SIGNIFICANT;
use crate::data::note::{Note, NoteKind};
use crate::data::units::first_times;
use crate::fit::statistics::robust_std;
use crate::measure::structure::OUTLIER;

/// Settings that stand out are told one by one up to so many.
const MOST_TOLD: usize = 8;

/// Names quantities that bend beyond the order that was asked for. What is left of them is in no uncertainty, and shows in no residual beside a
/// model of the next order, which is what the other checks of a sweep use.
pub(super) fn orders_too_low(problem: &Problem, asked: &Asked, settled: &Settled) -> Option<Note> {
    let (orders, above) = (settled.orders, asked.above(settled.orders));
    if above == orders {
        return None;
    }
    let fit = problem.fit(&settled.degc, above).ok()?;
    let noise = problem.noise(&fit, &settled.degc, above).ok()?;
    let covariance = noise.covariance_of(&fit.influence(None).ok()?);
    let values = fit.values();
    let times = |quantity: usize| {
        let last = fit.range(quantity).end - 1;
        values[last].abs() / covariance[(last, last)].sqrt()
    };
    let raised = (0..QUANTITIES.len()).filter(|k| above.quantities[*k] > orders.quantities[*k]);
    let low: Vec<(&str, f64)> = raised.map(|k| (QUANTITIES[k].0, times(k))).filter(|(_, times)| *times > SIGNIFICANT).collect();
    let most = low.iter().map(|(_, times)| *times).reduce(f64::max)?;
    let names: Vec<&str> = low.iter().map(|(name, _)| *name).collect();
    let text = format!(
        "the orders that were asked for are too low: the next coefficient of {} is up to {most:.0} standard uncertainties, and what it does is in no \
         uncertainty",
        names.join(", ")
    );
    Some(
        Note::new(NoteKind::Fit, text)
            .with_remedy("give higher orders with --order or in campaign.toml, or leave them to the program"),
    )
}

/// Says which settings stand out: one that was disturbed moves the polynomials, and makes their uncertainties large.
pub(super) fn standing_out(blocks: &[SweepBlock]) -> Vec<Note> {
    let of_axis = |axis: usize| {
        let usual = robust_std(blocks.iter().map(|b| b.residual_nt[axis]));
        let size_nt = |b: &SweepBlock| b.residual_nt[axis].abs();
        let mut far: Vec<&SweepBlock> = blocks.iter().filter(|b| usual > 0.0 && size_nt(b) > OUTLIER * usual).collect();
        far.sort_by(|a, b| size_nt(b).total_cmp(&size_nt(a)));
        let largest_nt = size_nt(far.first()?);
        let name = ["X", "Y", "Z"][axis];
        let text = format!(
            "settings at {} stand out in {name} by more than {OUTLIER:.0} standard deviations, up to {largest_nt:.2} nT: they were disturbed, and the \
             polynomials are with them",
            first_times(far.iter().map(|b| b.t_s), MOST_TOLD)
        );
        Some(
            Note::new(NoteKind::Fit, text)
                .about(name)
                .with_remedy("look at them, and leave them out with --exclude or [[exclude]]"),
        )
    };
    (0..3).filter_map(of_axis).collect()
}
