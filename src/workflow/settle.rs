//! Linear calibrations of a thermal group and its polynomials: each is made with the other until both stay (docs/mathematics.md,
//! "Temperature").

use super::all::{copies, told_of_copies};
use super::thermal::ThermalFile;
use super::{Desk, Made, Measured, RunResult, ThermalShown, each, recipe};
use crate::data::across::CalibratedRun;
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance, Role};
use crate::files::ledger::Origin;
use crate::files::parameter::{Body, Cpf};
use crate::measure::lin::{Lin, Options};
use crate::measure::thermal::{Kind, RunGroup, RunsUsed, Thermal, groups, thermal};
use crate::model::campaign::ThermalEntry;
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor_polynomials::SensorPolynomials;
use std::collections::HashSet;

/// Rounds of calibrations and polynomials; each makes what is left smaller by the share of the runs that moved.
const MOST_ROUNDS: usize = 30;
/// They end when no coefficient changes by more than this part of its standard uncertainty, and no standard uncertainty by more than this part: files
/// that are made again are the same to this part.
const SETTLED: f64 = 1e-9;

/// The linear calibration of a run alone, where one with the polynomials of its group takes its place.
pub struct Alone {
    /// Run id.
    pub run: String,
    /// Name of its file.
    pub name: String,
    /// Its text.
    pub text: String,
    /// Where it comes from.
    pub origin: Origin,
}

/// Refers the linear calibrations of thermal groups to one temperature each, with the polynomials of the group; says of groups whose orders
/// change with every round that they do not settle.
pub fn settle(measured: &mut [Measured], entries: &[ThermalEntry], orders: &[(String, usize)]) -> Option<Note> {
    let mut before: Vec<Thermal> = Vec::new();
    let mut changing: Vec<String> = Vec::new();
    let copies = copies(measured);
    for _ in 0..MOST_ROUNDS {
        let points = measured.iter().filter_map(Measured::lin).filter_map(|made| made.result.point());
        let points: Vec<CalibratedRun> = points.map(|point| told_of_copies(point, &copies)).collect();
        let groups: Vec<RunGroup> = groups(&points, entries, orders);
        // What has no polynomials says so when they are made to be written.
        let lins: Vec<&Lin> = measured.iter().filter_map(Measured::lin).map(|made| &made.result).collect();
        let now: Vec<Thermal> = groups.iter().filter_map(|group| thermal(group, Kind::Lin, &lins, false).ok()).collect();
        if now.is_empty() || (now.len() == before.len() && now.iter().zip(&before).all(|(a, b)| is_settled(a, b))) {
            return None;
        }
        let changed = now.iter().zip(&before).filter(|(now, before)| orders_of(now) != orders_of(before));
        changing = changed.map(|(now, _)| format!("{} {}", now.runs.sensor, now.runs.mode)).collect();
        let found: Vec<(SensorPolynomials, Vec<String>)> =
            now.iter().filter_map(|result| Some((polynomials(result)?, result.runs.ids.clone()))).collect();
        each(measured.iter_mut().filter_map(Measured::lin_mut), |made| {
            let id = &made.result.calibration.run.id;
            if let Some((own, _)) = found.iter().find(|(_, ids)| ids.contains(id)) {
                // A run that cannot be referred keeps what it has, and says so in the last round.
                if let Ok(result) = with_polynomials(made, own) {
                    made.result = result;
                }
            }
        });
        before = now;
    }
    let text = || {
        let groups = changing.join(", ");
        format!(
            "the polynomials of {groups} and their runs whose temperature moves do not settle: the orders change with every round"
        )
    };
    let remedy = "give the orders with --order or in campaign.toml";
    (!changing.is_empty()).then(|| Note::new(NoteKind::Method, text()).with_remedy(remedy))
}

/// The orders of the polynomials of a group.
fn orders_of(result: &Thermal) -> Vec<usize> {
    result.quantities.iter().map(|q| q.found.order).collect()
}

/// The polynomials of a group that is not written yet.
fn polynomials(result: &Thermal) -> Option<SensorPolynomials> {
    let ThermalFile::Tpf(tpf) = ThermalFile::of(result) else { return None };
    let input = Input { path: tpf.file_name(), role: Some(Role::Temperature), ..Input::default() };
    Some(tpf.polynomials(input)).filter(|p| p.without_covariance().is_none())
}

/// Whether the sensor temperature moved during a run, by so little as it may be.
fn moves(lin: &Lin) -> bool {
    lin.calibration.slopes.is_some()
}

/// Whether no coefficient differs by more than a small part of its standard uncertainty, nor this by more than a small part.
fn is_settled(now: &Thermal, before: &Thermal) -> bool {
    let close = |a: &TemperaturePolynomial, b: &TemperaturePolynomial| {
        let stds = a.std().into_iter().zip(b.std());
        a.coefficients.len() == b.coefficients.len()
            && stds
                .zip(a.coefficients.iter().zip(&b.coefficients))
                .all(|((std, before), (a, b))| (a - b).abs() <= SETTLED * std && (std - before).abs() <= SETTLED * std)
    };
    now.quantities.len() == before.quantities.len()
        && now.quantities.iter().zip(&before.quantities).all(|(a, b)| close(&a.polynomial, &b.polynomial))
}

/// The run fitted once more with polynomials.
fn with_polynomials(made: &Made<Lin>, polynomials: &SensorPolynomials) -> Result<Lin, Finding> {
    made.again(&Options { temperature: Some(polynomials.clone()), ..made.options.clone() })
}

/// Gives the runs of thermal groups, and all others of the same sensor, mode and location whose sensor temperature moved, the polynomials
/// as they were written; returns the calibrations of these runs alone, in their order.
pub fn refer(measured: &mut [Measured], alone: Vec<Alone>, shown: &[ThermalShown], desk: &Desk) -> Vec<Alone> {
    let mut written: Vec<(SensorPolynomials, &RunsUsed)> = Vec::new();
    for one in shown {
        let ThermalFile::Tpf(tpf) = &one.file else { continue };
        let polynomials = tpf.polynomials(one.written.clone().with_role(Role::Temperature));
        if polynomials.without_covariance().is_none() {
            written.push((polynomials, &one.thermal.runs));
        }
    }
    let referred: Vec<Option<String>> = each(measured.iter_mut().filter_map(Measured::lin_mut), |made| {
        let head = made.result.calibration.run.clone();
        let of_group = |runs: &RunsUsed| runs.ids.contains(&head.id);
        let of_sensor = |runs: &RunsUsed| (&runs.sensor, &runs.mode, runs.location) == (&head.sensor, &head.mode, head.location);
        let with = |fits: &dyn Fn(&RunsUsed) -> bool| written.iter().find(|(_, runs)| fits(runs));
        let (polynomials, _) = with(&of_group).or_else(|| with(&of_sensor).filter(|_| moves(&made.result)))?;
        match with_polynomials(made, polynomials) {
            Ok(result) => {
                made.result = result;
                made.options.temperature = Some(polynomials.clone());
                let input = [made.provenance.input.as_slice(), std::slice::from_ref(&polynomials.input)].concat();
                made.provenance = Provenance::new(recipe(&made.options, &made.result, desk), input);
                made.in_group = true;
                Some(head.id)
            }
            Err(refusal) => {
                let file = &polynomials.input.path;
                let text = format!("the slopes of {file} are not used: {}", refusal.rule);
                made.result.notes.push(Note::new(NoteKind::Temperature, text).about(file));
                None
            }
        }
    });
    let referred: HashSet<String> = referred.into_iter().flatten().collect();
    alone.into_iter().filter(|one| referred.contains(&one.run)).collect()
}

/// The linear calibrations of single runs as files, before their groups have polynomials.
///
/// # Errors
/// A calibration without a text form.
pub fn alone(measured: &[Measured], desk: &Desk) -> Result<Vec<Alone>, Finding> {
    measured
        .iter()
        .filter_map(Measured::lin)
        .map(|made| {
            let parameters: Cpf = made.result.parameters();
            let name = parameters.file_name();
            let run = parameters.calibration.run.id.clone();
            let text = desk.parameter_text(&run, &name, &parameters, &made.provenance)?;
            Ok(Alone { run, name, text, origin: Origin::of(&made.provenance).telling(&made.result.notes) })
        })
        .collect()
}
