//! A run made ready for its linear fit: what refuses it before any fit, and the plateaus as the fit takes them.

use super::fit::Means;
use super::options::Options;
use super::refusal::LinError;
use crate::data::linearisation::LinearisationApplied;
use crate::data::note::Note;
use crate::data::plateau::{Drop, Plateau, Plateaus};
use crate::data::run::{Kind, Run};
use crate::fit::{DenseNoise, FitError};
use crate::model::campaign::Instructions;
use crate::model::position::Position;
use crate::record::facility::{self, Driven};
use crate::record::known::{self, Applied};
use crate::record::position::{apply_limits, the_position};
use crate::record::{carried, linearised, screens};
use nalgebra::{DMatrix, Matrix3};

/// Order of the offset trend where nothing else is said, as in the campaign of 2013.
const DEFAULT_ORDER: usize = 2;

/// Order of the offset trend of a run that can be fitted.
pub(super) fn trend_order(
    run: &Run,
    plateaus: &Plateaus,
    instructions: &Instructions,
    options: &Options,
) -> Result<usize, LinError> {
    if run.header.kind != Kind::Linearity {
        return Err(LinError::Kind(run.header.kind));
    }
    let order = options
        .trend_order
        .or_else(|| instructions.offset_trend_order.and_then(|o| usize::try_from(o).ok()))
        .unwrap_or(DEFAULT_ORDER);
    if order > 2 {
        return Err(LinError::Order(order));
    }
    if plateaus.list.is_empty() {
        return Err(LinError::NoPlateaus);
    }
    if plateaus.lack_samples(run) {
        return Err(LinError::NoSamples { total: plateaus.list.len() });
    }
    if !options.allow_mismatch {
        screens::edges(plateaus)?;
    }
    if plateaus.still_settling {
        return Err(LinError::Unsettled { settling_s: plateaus.settling_s });
    }
    Ok(order)
}

/// The plateaus of a run with reference fields and corrected readings, and what was applied to them.
pub(super) struct Prepared<'a> {
    options: &'a Options,
    /// Id of the position.
    pub position_id: u32,
    /// The position of all plateaus.
    pub position: Position,
    /// All plateaus; those that the fit does not take have a reason.
    pub list: Vec<Plateau>,
    /// The facility that turned settings into fields.
    pub facility: Option<Driven>,
    /// The known effects that were taken off.
    pub known: Option<Applied>,
    /// The linearisation of the readings.
    pub linearisation: Option<LinearisationApplied>,
}

impl<'a> Prepared<'a> {
    /// Applies limits, facility, known effects and linearisation, each once and in this order.
    pub fn of(
        run: &Run,
        plateaus: &Plateaus,
        instructions: &Instructions,
        options: &'a Options,
        notes: &mut Vec<Note>,
    ) -> Result<Self, LinError> {
        let (position_id, position) = the_position(plateaus, instructions)?;
        let mut list = plateaus.list.clone();
        apply_limits(&mut list, position, &limits_nt(run, instructions, options));
        let facility = options.facility.as_ref().map(|f| facility::apply(f, run, instructions, &mut list, notes)).transpose()?;
        let known = options.model.as_ref().map(|m| known::apply(m, run, plateaus, &mut list, instructions, notes));
        let linearisation = options.linearisation.as_ref().map(|l| linearised::apply(l, run, &mut list, notes));
        Ok(Self { options, position_id, position, list, facility, known, linearisation })
    }

    /// The plateaus that the fit takes, or why they are too few for a trend of this order.
    pub fn used(&self, order: usize) -> Result<Vec<&Plateau>, LinError> {
        let used: Vec<&Plateau> = self.list.iter().filter(|p| p.dropped.is_none()).collect();
        let parameters = 4 + order;
        if used.len() > parameters { Ok(used) } else { Err(too_few(&self.list, used.len(), parameters)) }
    }

    /// Covariance of all coefficients, parameter j of component a at `a * p + j`: from the noise, and from the uncertainty of what was
    /// applied to the readings.
    pub fn covariance(&self, noise: &DenseNoise, means: &Means, used: &[&Plateau]) -> Result<DMatrix<f64>, FitError> {
        let mut covariance = noise.covariance();
        if let Some(linearisation) = &self.options.linearisation {
            covariance += linearised::carried(linearisation, &means.design()?, used)?;
        }
        if let Some(known) = &self.known {
            // The parameters of the effects are taken as independent of each other.
            covariance += carried::covariance(&known.changes_ent(), &self.list, &means.design()?)?;
        }
        Ok(covariance)
    }

    /// Changes of the coefficients of the baseline by what the facility does not know better, type B; `None` where its file states no uncertainty. A field that is not what was set acts on the response at one temperature as
    /// on that of a sensor at rest.
    pub fn changes_of_facility(&self, response: &Matrix3<f64>, means: &Means) -> Result<Option<OfFacility<'_>>, FitError> {
        let Some(driven) = self.facility.as_ref().filter(|driven| !driven.moved.is_empty()) else { return Ok(None) };
        let design = means.baseline.design(&means.fields_nt, &means.t_s)?;
        let changes = carried::changes(&driven.changes_ent(response), &self.list, &design)?;
        Ok(Some(OfFacility { sources: driven.moved.iter().map(|moved| moved.source.as_str()).collect(), changes }))
    }
}

/// What the facility does not know better, by name, and the changes of the coefficients of the baseline by one standard deviation of each: a
/// row per coefficient and a column per source.
pub struct OfFacility<'a> {
    pub sources: Vec<&'a str>,
    pub changes: DMatrix<f64>,
}

fn limits_nt(run: &Run, instructions: &Instructions, options: &Options) -> [Option<f64>; 3] {
    let mut limits = instructions.limits_nt(&run.header);
    for (limit, own) in limits.iter_mut().zip(options.max_field_nt) {
        // What the analyst asks for now replaces what the campaign says.
        *limit = own.or(*limit);
    }
    limits
}

fn too_few(list: &[Plateau], used: usize, parameters: usize) -> LinError {
    let mut reasons: Vec<(String, usize)> = Vec::new();
    for reason in list.iter().filter_map(|p| p.dropped.as_ref()).map(Drop::to_string) {
        match reasons.iter_mut().find(|(r, _)| *r == reason) {
            Some((_, n)) => *n += 1,
            None => reasons.push((reason, 1)),
        }
    }
    reasons.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    let unsettled = reasons.first().is_some_and(|(reason, _)| *reason == Drop::NoSamples.to_string());
    let reasons = match reasons.as_slice() {
        [] => "none".to_owned(),
        some => some.iter().take(3).map(|(reason, n)| format!("{n} x {reason}")).collect::<Vec<_>>().join(", "),
    };
    LinError::TooFew { used, parameters, dropped: list.len() - used, total: list.len(), reasons, unsettled }
}
