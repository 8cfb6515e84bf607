//! Which runs are compared: those of one sensor in one mode at one location, or those that the campaign names.

use super::quantity::INTERPOLATED;
use crate::data::across::{CalibratedRun, RunValues};
use crate::data::run::Location;
use crate::model::campaign::ThermalEntry;
use serde::Serialize;

/// Runs that are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct RunGroup {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Where the sensor stood.
    pub location: Location,
    /// The campaign names the runs: polynomials through them are asked for.
    pub is_listed: bool,
    /// Order per quantity or family of quantities, where given.
    pub orders: Vec<(String, usize)>,
    /// The runs by their ids, which is in time order.
    pub points: Vec<CalibratedRun>,
    /// Runs of the same sensor, mode and location that state no sensor temperature: their kind and file.
    pub without_temperature: Vec<(Kind, String)>,
}

/// Which analysis the runs of a group come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Kind {
    /// Linear calibrations: TPF.
    Lin,
    /// Offset measurements: TOF.
    Offset,
    /// Frequency measurements: TAF.
    Freq,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 3] = [Kind::Lin, Kind::Offset, Kind::Freq];

    fn of(values: &RunValues) -> Kind {
        match values {
            RunValues::Lin { .. } => Kind::Lin,
            RunValues::Offset { .. } => Kind::Offset,
            RunValues::Freq { .. } => Kind::Freq,
        }
    }

    /// What the runs are called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Kind::Lin => "linearity",
            Kind::Offset => "offset",
            Kind::Freq => "frequency",
        }
    }
}

/// Sorts runs into groups: those that the campaign names, or one per sensor, mode and location. Runs without a sensor temperature make none.
/// `orders`, of the command line, count before those of the campaign, the last of them first.
#[must_use]
pub fn groups(points: &[CalibratedRun], entries: &[ThermalEntry], orders: &[(String, usize)]) -> Vec<RunGroup> {
    let (mut points, without): (Vec<&CalibratedRun>, Vec<&CalibratedRun>) =
        points.iter().partition(|p| p.run.temperature_degc.is_some_and(f64::is_finite));
    points.sort_by(|a, b| (&a.run.id, &a.file).cmp(&(&b.run.id, &b.file)));
    let key = |p: &CalibratedRun| (p.run.sensor.clone(), p.run.mode.clone(), p.run.location);
    let mut keys: Vec<(String, String, Location)> = points.iter().map(|p| key(p)).collect();
    keys.sort_unstable();
    keys.dedup();
    let mut groups = Vec::new();
    for own_key in keys {
        let (sensor, mode, location) = &own_key;
        let is_own = |p: &&&CalibratedRun| key(p) == own_key;
        let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
        let entries: Vec<&ThermalEntry> =
            entries.iter().filter(|e| applies(&e.sensor, sensor) && applies(&e.mode, mode)).collect();
        let group = |is_listed: bool, orders: Vec<(String, usize)>, points: Vec<CalibratedRun>| RunGroup {
            sensor: sensor.clone(),
            mode: mode.clone(),
            location: *location,
            is_listed,
            orders,
            points,
            without_temperature: without.iter().filter(is_own).map(|p| (Kind::of(&p.values), p.file.clone())).collect(),
        };
        let given = || orders.iter().rev().cloned();
        if entries.is_empty() {
            groups.push(group(false, given().collect(), points.iter().filter(is_own).map(|p| (*p).clone()).collect()));
        }
        for entry in entries {
            let listed = |p: &&&CalibratedRun| entry.runs.as_ref().is_none_or(|runs| runs.contains(&p.run.id));
            let own = points.iter().filter(is_own).filter(listed).map(|p| (*p).clone()).collect();
            let orders = entry.orders.iter().map(|(name, order)| (name.clone(), *order as usize));
            groups.push(group(entry.runs.is_some(), given().chain(orders).collect(), own));
        }
    }
    groups.retain(|g| !g.points.is_empty());
    groups
}

impl RunGroup {
    /// Sensor, mode and location, as people read them.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{} {}{}", self.sensor, self.mode, self.location.suffix())
    }

    /// Runs of a kind.
    pub(super) fn of_kind(&self, kind: Kind) -> Vec<&CalibratedRun> {
        self.points.iter().filter(|p| Kind::of(&p.values) == kind).collect()
    }

    /// The order given for a quantity.
    pub(super) fn order(&self, quantity: &str) -> Option<usize> {
        asked_order(&self.orders, quantity)
    }

    /// Whether there are runs of a kind at all.
    #[must_use]
    pub fn has(&self, kind: Kind) -> bool {
        self.points.iter().any(|p| Kind::of(&p.values) == kind)
    }
}

/// The first order given for a quantity, by its own name before that of its family; both corner frequencies share one where nothing is said
/// of the one between neighbouring amplitudes.
pub(in crate::measure) fn asked_order(orders: &[(String, usize)], quantity: &str) -> Option<usize> {
    let find = |name: &str| orders.iter().find(|(n, _)| n == name).map(|(_, order)| *order);
    let (family, component) = quantity.rsplit_once('_').unwrap_or((quantity, ""));
    let own = find(quantity).or_else(|| find(family));
    own.or_else(|| (family == INTERPOLATED).then(|| find(&format!("f_3db_{component}")).or_else(|| find("f_3db"))).flatten())
}
