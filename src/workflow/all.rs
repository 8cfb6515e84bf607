//! Every run of a campaign by the analysis of its kind, each read once.

use super::kind::{RUN_KINDS, RunAnalysis, RunMade};
use super::{Alone, Desk, Failure, Job, Made, PerRun, RunResult, ThermalShown, read};
use crate::data::across::CalibratedRun;
use crate::data::calibration::Sensitivities;
use crate::data::error::{Finding, Severity};
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::data::run_state::{Outcome, RunState};
use crate::data::start::Start;
use crate::files::ledger::Origin;
use crate::files::source::hex;
use crate::measure::compare::{self, Results, ZeroField};
use crate::measure::lin::Lin;
use crate::measure::null::Null;
use crate::measure::recordings::{self, Recording};
use crate::measure::sweep::Sweep;
use crate::model::campaign::Instructions;
use crate::model::facility::Facility;
use crate::record::known::Known;
use crate::show::Drawn;
use crate::show::protocol::RunPart;
use sha2::{Digest, Sha256};
use std::collections::HashMap;

/// The analyses of single runs with their options.
pub struct Analyses(Vec<Box<dyn RunAnalysis>>);

impl Default for Analyses {
    fn default() -> Self {
        Self::new(None, None)
    }
}

impl Analyses {
    /// All analyses as they are by default, with a facility that turns settings into fields and known effects where they take them.
    #[must_use]
    pub fn new(facility: Option<&Facility>, model: Option<&Known>) -> Self {
        Self(RUN_KINDS.iter().map(|kind| kind.usual(facility, model)).collect())
    }

    /// The same with other options of one analysis.
    #[must_use]
    pub fn with<A: PerRun>(mut self, options: A) -> Self {
        self.0.retain(|analysis| analysis.kind() != A::KIND);
        self.0.push(Box::new(options));
        self
    }

    /// Reads and analyses one run. A run that its analysis does not use is read for the run list only.
    ///
    /// # Errors
    /// The run cannot be read or is refused.
    pub fn make(&self, job: &Job, desk: &Desk, two_threads: bool) -> Result<Measured, Failure> {
        let kind = job.header.as_ref().filter(|h| job.named || job.campaign.uses(h)).map(|h| h.kind);
        match self.0.iter().find(|analysis| Some(analysis.kind()) == kind) {
            Some(analysis) => Ok(Measured::Analysed(analysis.make(job, desk, two_threads)?)),
            None => {
                let (run, ()) = read(job, desk, two_threads, ())?;
                Ok(Measured::Other(Box::new(run)))
            }
        }
    }
}

/// A run that was read, with what it gave.
pub enum Measured {
    /// A run with the result of its analysis.
    Analysed(Box<dyn RunMade>),
    /// A run that no analysis here is for, or that the campaign takes out.
    Other(Box<Run>),
}

impl Measured {
    /// What it gave, if there is a result.
    #[must_use]
    pub fn made(&self) -> Option<&dyn RunMade> {
        match self {
            Measured::Analysed(made) => Some(made.as_ref()),
            Measured::Other(_) => None,
        }
    }

    /// The result of one analysis, if it is of that.
    #[must_use]
    pub fn of<R: RunResult>(&self) -> Option<&Made<R>> {
        self.made()?.as_any().downcast_ref()
    }

    /// The linear calibration itself, if it is one.
    #[must_use]
    pub fn into_lin(self) -> Option<Made<Lin>> {
        match self {
            Measured::Analysed(made) => made.into_any().downcast().ok().map(|made| *made),
            Measured::Other(_) => None,
        }
    }

    /// The linear calibration, if it is one, to be made once more.
    #[must_use]
    pub fn lin_mut(&mut self) -> Option<&mut Made<Lin>> {
        match self {
            Measured::Analysed(made) => made.as_any_mut().downcast_mut(),
            Measured::Other(_) => None,
        }
    }

    /// The linear calibration, if it is one.
    #[must_use]
    pub fn lin(&self) -> Option<&Made<Lin>> {
        self.of()
    }

    /// The sweep, if it is one.
    #[must_use]
    pub fn sweep(&self) -> Option<&Sweep> {
        self.of().map(|made| &made.result)
    }

    /// Writes what the run gave, under the names in a thermal group or those of a single run; returns the figures.
    ///
    /// # Errors
    /// What cannot be drawn or written.
    pub fn publish(&self, desk: &Desk, in_group: bool) -> Result<Vec<Drawn>, Finding> {
        self.made().map_or_else(|| Ok(Vec::new()), |made| made.publish(desk, in_group))
    }

    /// The run as it was read.
    #[must_use]
    pub fn run(&self) -> Option<&Run> {
        match self {
            Measured::Analysed(made) => made.run(),
            Measured::Other(run) => Some(run),
        }
    }

    /// Its part in an analysis across temperatures.
    #[must_use]
    pub fn point(&self) -> Option<CalibratedRun> {
        self.made()?.point()
    }

    /// Its part in the protocol, with the figures that were drawn.
    #[must_use]
    pub fn part<'a>(&'a self, figures: &'a [Drawn]) -> RunPart<'a> {
        let run = self.run();
        RunPart {
            id: run.map_or_else(String::new, |r| r.header.run.clone()),
            file: run.map_or_else(String::new, |r| r.input.path.clone()),
            header: run.map(|r| &r.header),
            run,
            outcome: self.outcome(),
            analysis: self.made().map(|made| made.part(figures)),
        }
    }

    /// What became of the run.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        match self {
            Measured::Analysed(_) => Outcome::done(),
            Measured::Other(run) => {
                let kind = run.header.kind;
                let reason = match kind {
                    Kind::Scalar => "scalar runs are analysed together, in the calibration of the coil system".to_owned(),
                    _ => format!("the list of {kind} runs in campaign.toml does not name it"),
                };
                Outcome::new(RunState::NotApplicable, reason)
            }
        }
    }

    /// Where the result comes from, if there is one.
    #[must_use]
    pub fn provenance(&self) -> Option<&Provenance> {
        self.made().map(RunMade::provenance)
    }

    /// What a person should know.
    #[must_use]
    pub fn notes(&self) -> Vec<Note> {
        match self {
            Measured::Analysed(made) => made.notes().to_vec(),
            Measured::Other(run) => run
                .findings
                .iter()
                .filter(|f| f.severity > Severity::Note)
                .map(|f| Note::new(NoteKind::Data, f.rule.as_ref()).with_remedy(f.remedy.as_ref()))
                .collect(),
        }
    }

    /// Part of what was asked for is refused.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.made().is_some_and(RunMade::is_partial)
    }
}

/// Gives results in enT in nT as well, each with the sensitivities of a linear calibration, whose file becomes an input of theirs.
///
/// # Errors
/// A calibration without a text form.
pub fn scale_to_nt(all: &mut [Measured], desk: &Desk) -> Result<(), Finding> {
    let mut found = Vec::new();
    for (index, made) in all.iter().enumerate().filter_map(|(index, one)| Some((index, one.made()?))) {
        if !made.is_scalable() {
            continue;
        }
        if let Some(lin) = nearest(made.head(), all.iter().filter_map(Measured::lin), |lin| &lin.result.calibration.run) {
            let parameters = lin.result.parameters();
            let path = lin.file_name();
            let text = desk.parameter_text(&parameters.calibration.run.id, &path, &parameters, &lin.provenance)?;
            let sha256 = hex(&Sha256::digest(text.as_bytes()));
            let input = Input { path, size_bytes: text.len() as u64, sha256, role: Some(Role::Cpf), ..Input::default() };
            found.push((index, input, Sensitivities::from(&lin.result.calibration)));
        }
    }
    for (index, input, sensitivities) in found {
        if let Some(Measured::Analysed(made)) = all.get_mut(index) {
            made.scale(input, &sensitivities);
        }
    }
    Ok(())
}

/// The runs as recordings, before any analysis.
fn recordings_of(all: &[Measured]) -> Vec<Recording> {
    all.iter().filter_map(Measured::run).map(Recording::of).collect()
}

/// The ids of runs that are copies of parts of others, each with that of the other one.
pub(super) fn copies(all: &[Measured]) -> HashMap<String, String> {
    let recordings = recordings_of(all);
    let id = |index: usize| recordings[index].id.clone();
    recordings::copies(&recordings).into_iter().map(|copied| (id(copied.copy), id(copied.of))).collect()
}

/// The part of a run in an analysis across temperatures, which says of what it is a copy.
pub(super) fn told_of_copies(point: CalibratedRun, copies: &HashMap<String, String>) -> CalibratedRun {
    CalibratedRun { copy_of: copies.get(&point.run.id).cloned(), ..point }
}

/// What runs of a campaign, and results of them, contradict each other in.
#[must_use]
pub fn contradictions(all: &[Measured], shown: &[ThermalShown], instructions: &Instructions) -> Vec<Note> {
    let points: Vec<CalibratedRun> = all.iter().filter_map(Measured::point).collect();
    let zero_fields = all.iter().filter_map(|one| {
        let found = &one.of::<Null>()?.result.found;
        let position = one.run().and_then(|run| run.settings.first()).and_then(|setting| instructions.position(setting.position));
        Some(ZeroField { found, position })
    });
    let mut notes = recordings::told(&recordings_of(all));
    notes.extend(compare::contradictions(&Results {
        points: &points,
        groups: shown.iter().map(|one| &one.thermal).collect(),
        sweeps: all.iter().filter_map(Measured::sweep).collect(),
        zero_fields: zero_fields.collect(),
    }));
    notes
}

/// Temperatures that differ by less are one: the mean of a run is known to some hundredths of a degree.
const SAME_DEGC: f64 = 0.1;

/// Of the runs of the same sensor, mode and location the one nearest in sensor temperature, since the sensitivities follow it; of several
/// at one temperature, or where a run states none, the one nearest in time.
fn nearest<'a, T>(own: &RunHead, all: impl Iterator<Item = &'a T>, head: impl Fn(&T) -> &RunHead) -> Option<&'a T> {
    let seconds = |run: &RunHead| run.start.as_ref().map_or(f64::NAN, Start::seconds);
    let key = |run: &RunHead| (run.sensor.clone(), run.mode.clone(), run.location);
    let distance = |one: &&T| {
        let run = head(one);
        let degc = run.temperature_degc.zip(own.temperature_degc).map_or(f64::INFINITY, |(a, b)| (a - b).abs());
        let steps = (degc / SAME_DEGC).floor();
        (steps, (seconds(run) - seconds(own)).abs())
    };
    let fits = all.filter(|one| key(head(one)) == key(own));
    fits.min_by(|a, b| {
        let ((a_degc, a_s), (b_degc, b_s)) = (distance(a), distance(b));
        a_degc.total_cmp(&b_degc).then(a_s.total_cmp(&b_s))
    })
}

/// Writes the linear calibrations on which a thermal group rests under their names there.
///
/// # Errors
/// What cannot be written.
pub fn publish_thermal_names(all: &[Measured], used: &[String], desk: &Desk) -> Result<(), Finding> {
    // Those that were made with results of the group have that name anyway.
    for made in all.iter().filter_map(Measured::lin).filter(|made| !made.in_group) {
        let p = made.result.parameters();
        let name = p.thermal_file_name();
        if used.contains(&name) {
            let id = &p.calibration.run.id;
            let folder = desk.folder(id, Origin::of(&made.provenance).telling(&made.result.notes))?;
            folder.write(&name, desk.parameter_text(id, &name, &p, &made.provenance)?.as_bytes())?;
            folder.sync()?;
        }
    }
    Ok(())
}

/// Writes the linear calibrations of runs alone beside those that were made with the polynomials of their groups.
///
/// # Errors
/// What cannot be written.
pub fn publish_alone(alone: &[Alone], desk: &Desk) -> Result<(), Finding> {
    for one in alone {
        let folder = desk.folder(&one.run, one.origin.clone())?;
        folder.write(&one.name, one.text.as_bytes())?;
        folder.sync()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::run::Location;

    fn head(id: &str, degc: Option<f64>, start: &str) -> RunHead {
        RunHead {
            id: id.to_owned(),
            sensor: "S".to_owned(),
            mode: "m".to_owned(),
            location: Location::Centre,
            temperature_degc: degc,
            coil_temperature_degc: None,
            campaign: String::new(),
            start: format!("2013-04-03T{start}:00Z").parse().ok(),
            configuration: String::new(),
            field_source: String::new(),
            coil_correction: None,
            earthfield_compensation: Vec::new(),
        }
    }

    fn found(own: &RunHead, all: &[RunHead]) -> Option<String> {
        nearest(own, all.iter(), |run| run).map(|run| run.id.clone())
    }

    #[test]
    fn the_temperature_decides_before_the_time() {
        let own = head("own", Some(17.30), "09:53");
        let cold = head("cold", Some(4.63), "10:15");
        let same = head("same", Some(17.31), "09:22");
        assert_eq!(found(&own, &[cold.clone(), same.clone()]).as_deref(), Some("same"));
        // At one temperature the time decides, and a thousandth of a degree does not.
        let earlier = head("earlier", Some(17.30), "08:00");
        assert_eq!(found(&own, &[earlier, same.clone()]).as_deref(), Some("same"));
        // Without a temperature the time is all there is.
        let unknown = head("unknown", None, "09:50");
        assert_eq!(found(&unknown, &[cold.clone(), same.clone()]).as_deref(), Some("cold"));
        assert_eq!(found(&own, &[unknown, cold]).as_deref(), Some("cold"));
        // Another sensor, mode or place has other sensitivities.
        let others = [
            RunHead { sensor: "T".to_owned(), ..same.clone() },
            RunHead { mode: "n".to_owned(), ..same.clone() },
            RunHead { location: Location::OffCentre, ..same },
        ];
        assert_eq!(found(&own, &others), None);
    }
}
