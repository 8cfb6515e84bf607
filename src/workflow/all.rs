//! Every run of a campaign by the analysis of its kind, each read once.

use super::{Desk, Drawn, Failure, Job, Made, RunReport, RunResult, make, parameter_text, publish};
use crate::data::across::CalibratedRun;
use crate::data::calibration::Sensitivities;
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::run::{Kind, Run};
use crate::files::ccr;
use crate::files::output::Folder;
use crate::files::parameter::Body;
use crate::files::source::hex;
use crate::measure::lin::Lin;
use crate::measure::{freq, lin, null, offset, sweep};
use crate::model::facility::Facility;
use crate::record::known::Known;
use crate::show::protocol::{AnalysisPart, RunPart};
use sha2::{Digest, Sha256};

/// The options of all analyses of single runs.
#[derive(Clone, Debug, Default)]
pub struct Analyses {
    /// Of linear calibrations.
    pub lin: lin::Options,
    /// Of offset measurements.
    pub offset: offset::Options,
    /// Of frequency measurements.
    pub freq: freq::Options,
    /// Of continuous sweeps.
    pub sweep: sweep::Options,
    /// Of zero-field runs.
    pub null: null::Options,
}

/// What a run gave.
pub enum Measured {
    /// A linear calibration.
    Lin(Box<Made<Lin>>),
    /// Offsets.
    Offset(Box<Made<offset::Offset>>),
    /// A frequency response.
    Freq(Box<Made<freq::Freq>>),
    /// Parameters against temperature from a continuous sweep.
    Sweep(Box<Made<sweep::Sweep>>),
    /// Drift and noise in zero field.
    Null(Box<Made<null::Null>>),
    /// A run that no analysis here is for, or that the campaign takes out.
    Other(Box<Run>),
}

impl Analyses {
    /// All analyses as they are by default, with a facility where settings are turned into fields.
    #[must_use]
    pub fn with_facility(facility: Option<&Facility>) -> Self {
        Self {
            lin: lin::Options { facility: facility.cloned(), ..lin::Options::default() },
            offset: offset::Options { facility: facility.cloned(), ..offset::Options::default() },
            freq: freq::Options::default(),
            sweep: sweep::Options { facility: facility.cloned(), ..sweep::Options::default() },
            null: null::Options::default(),
        }
    }

    /// The same with known effects, which linear calibrations, sweeps and frequency measurements take off; offset and zero-field runs are
    /// analysed as they are.
    #[must_use]
    pub fn with_model(mut self, model: Option<&Known>) -> Self {
        self.lin.model = model.cloned();
        self.sweep.model = model.cloned();
        self.freq.model = model.cloned();
        self
    }

    /// Reads and analyses one run.
    ///
    /// # Errors
    /// The run cannot be read or is refused.
    pub fn make(&self, job: &Job, desk: &Desk, two_threads: bool) -> Result<Measured, Failure> {
        // A run that its analysis does not use is read for the run list only.
        let kind = job.header.as_ref().filter(|h| job.named || job.campaign.uses(h)).map(|h| h.kind);
        Ok(match kind {
            Some(Kind::Linearity) => Measured::Lin(Box::new(make(&self.lin, job, desk, two_threads)?)),
            Some(Kind::Offset) => Measured::Offset(Box::new(make(&self.offset, job, desk, two_threads)?)),
            Some(Kind::Frequency) => Measured::Freq(Box::new(make(&self.freq, job, desk, two_threads)?)),
            Some(Kind::Sweep) => Measured::Sweep(Box::new(make(&self.sweep, job, desk, two_threads)?)),
            Some(Kind::ZeroField) => Measured::Null(Box::new(make(&self.null, job, desk, two_threads)?)),
            _ => {
                job.unique()?;
                let run = ccr::read(&job.path, &desk.reading(&job.recorded, two_threads), &mut ());
                Measured::Other(Box::new(run.map_err(Failure::Unreadable)?))
            }
        })
    }
}

/// Under which name the parameter file of a linear calibration is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinName {
    /// That of a single run.
    Single,
    /// That of a run in a thermal group.
    Thermal,
}

impl Measured {
    /// Writes what the run gave; returns the figures.
    ///
    /// # Errors
    /// What cannot be drawn or written.
    pub fn publish(&self, desk: &Desk, name: LinName) -> Result<Vec<Drawn>, Finding> {
        match self {
            Measured::Lin(made) => {
                let p = made.result.parameters();
                let file = if name == LinName::Single { p.file_name() } else { p.thermal_file_name() };
                publish::<lin::Options>(made, desk, &file)
            }
            Measured::Offset(made) => publish::<offset::Options>(made, desk, &made.result.parameters().file_name()),
            Measured::Freq(made) => publish::<freq::Options>(made, desk, &made.result.parameters().file_name()),
            Measured::Sweep(made) => publish::<sweep::Options>(made, desk, &made.result.parameters().file_name()),
            Measured::Null(made) => publish::<null::Options>(made, desk, &made.result.parameters().file_name()),
            Measured::Other(_) => Ok(Vec::new()),
        }
    }

    /// The run as it was read.
    #[must_use]
    pub fn run(&self) -> Option<&Run> {
        match self {
            Measured::Lin(made) => made.run.as_ref(),
            Measured::Offset(made) => made.run.as_ref(),
            Measured::Freq(made) => made.run.as_ref(),
            Measured::Sweep(made) => made.run.as_ref(),
            Measured::Null(made) => made.run.as_ref(),
            Measured::Other(run) => Some(run),
        }
    }

    /// Its part in an analysis across temperatures.
    #[must_use]
    pub fn point(&self) -> Option<CalibratedRun> {
        match self {
            Measured::Lin(made) => Some((&made.result.parameters()).into()),
            Measured::Offset(made) => Some((&made.result.parameters()).into()),
            Measured::Freq(made) => Some((&made.result.parameters()).into()),
            Measured::Sweep(_) | Measured::Null(_) | Measured::Other(_) => None,
        }
    }

    /// The linear calibration, if it is one.
    #[must_use]
    pub fn lin(&self) -> Option<&Made<Lin>> {
        match self {
            Measured::Lin(made) => Some(made),
            _ => None,
        }
    }

    /// The sweep, if it is one.
    #[must_use]
    pub fn sweep(&self) -> Option<&sweep::Sweep> {
        match self {
            Measured::Sweep(made) => Some(&made.result),
            _ => None,
        }
    }

    /// The result for people, if there is one.
    #[must_use]
    pub fn report(&self) -> Option<&dyn RunReport> {
        match self {
            Measured::Lin(made) => Some(&made.result),
            Measured::Offset(made) => Some(&made.result),
            Measured::Freq(made) => Some(&made.result),
            Measured::Sweep(made) => Some(&made.result),
            Measured::Null(made) => Some(&made.result),
            Measured::Other(_) => None,
        }
    }

    /// Its part in the protocol, with the figures that were drawn.
    #[must_use]
    pub fn part<'a>(&'a self, figures: &'a [Drawn]) -> RunPart<'a> {
        let analysis = self.report().map(|result| AnalysisPart {
            name: result.analysis(),
            head: result.head(),
            headline: result.headline(),
            remarks: result.notes().len(),
            sections: result.sections(),
            figures,
        });
        RunPart { run: self.run(), analysis }
    }

    /// Where the result comes from, if there is one.
    #[must_use]
    pub fn provenance(&self) -> Option<&Provenance> {
        match self {
            Measured::Lin(made) => Some(&made.provenance),
            Measured::Offset(made) => Some(&made.provenance),
            Measured::Freq(made) => Some(&made.provenance),
            Measured::Sweep(made) => Some(&made.provenance),
            Measured::Null(made) => Some(&made.provenance),
            Measured::Other(_) => None,
        }
    }

    /// What a person should know.
    #[must_use]
    pub fn notes(&self) -> Vec<Note> {
        match (self, self.report()) {
            (Measured::Other(run), _) => {
                run.findings.iter().map(|f| Note::new(NoteKind::Data, f.rule.as_ref()).with_remedy(f.remedy.as_ref())).collect()
            }
            (_, report) => report.map_or_else(Vec::new, RunReport::notes),
        }
    }

    /// Part of what was asked for is refused.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.report().is_some_and(RunReport::is_partial)
    }
}

/// Gives offsets and zero-field readings in nT as well, each with the sensitivities of the linear calibration of the same sensor and
/// mode that is nearest in time. Its file becomes an input of theirs.
///
/// # Errors
/// A calibration without a text form.
pub fn scale_to_nt(all: &mut [Measured]) -> Result<(), Finding> {
    let seconds = |start: &str| start.parse::<jiff::Timestamp>().map_or(f64::NAN, |t| t.as_second() as f64);
    let mut found = Vec::new();
    for (index, measured) in all.iter().enumerate() {
        let head = match measured {
            Measured::Offset(made) => &made.result.found.run,
            Measured::Null(made) => &made.result.found.run,
            _ => continue,
        };
        let distance = |lin: &&Made<Lin>| (seconds(&lin.result.calibration.run.start) - seconds(&head.start)).abs();
        let nearest = all
            .iter()
            .filter_map(Measured::lin)
            .filter(|lin| {
                let other = &lin.result.calibration.run;
                (&other.sensor, &other.mode) == (&head.sensor, &head.mode)
            })
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        if let Some(lin) = nearest {
            let parameters = lin.result.parameters();
            let name = parameters.file_name();
            let text = parameter_text(&name, &parameters, &lin.provenance)?;
            let input = Input {
                path: name,
                size_bytes: text.len() as u64,
                sha256: hex(&Sha256::digest(text.as_bytes())),
                role: Some(Role::Cpf),
            };
            found.push((index, input, Sensitivities::from(&lin.result.calibration)));
        }
    }
    for (index, input, sensitivities) in found {
        let provenance = match all.get_mut(index) {
            Some(Measured::Offset(made)) => {
                made.result.scale(&input.path, &sensitivities);
                &mut made.provenance
            }
            Some(Measured::Null(made)) => {
                made.result.scale(&input.path, &sensitivities);
                &mut made.provenance
            }
            _ => continue,
        };
        *provenance = provenance.clone().with_input(input);
    }
    Ok(())
}

/// Writes the linear calibrations on which a thermal group rests under their names there.
///
/// # Errors
/// What cannot be written.
pub fn publish_thermal_names(all: &[Measured], used: &[String], desk: &Desk) -> Result<(), Finding> {
    for made in all.iter().filter_map(Measured::lin) {
        let p = made.result.parameters();
        let name = p.thermal_file_name();
        if used.contains(&name) {
            let folder = Folder::open(&desk.out.join(&p.calibration.run.id), desk.force)?;
            folder.write(&name, parameter_text(&name, &p, &made.provenance)?.as_bytes())?;
            folder.sync()?;
        }
    }
    Ok(())
}

/// Writes the tables of all runs of every kind.
///
/// # Errors
/// What cannot be written.
#[cfg(feature = "tables")]
pub fn publish_tables(folder: &Folder, all: &[Measured]) -> Result<(), Finding> {
    let lins: Vec<&Lin> = all.iter().filter_map(Measured::lin).map(|made| &made.result).collect();
    super::publish_table::<lin::Options>(folder, &lins)?;
    let offsets = all.iter().filter_map(|m| if let Measured::Offset(made) = m { Some(&made.result) } else { None });
    super::publish_table::<offset::Options>(folder, &offsets.collect::<Vec<_>>())?;
    let freqs = all.iter().filter_map(|m| if let Measured::Freq(made) = m { Some(&made.result) } else { None });
    super::publish_table::<freq::Options>(folder, &freqs.collect::<Vec<_>>())?;
    let nulls = all.iter().filter_map(|m| if let Measured::Null(made) = m { Some(&made.result) } else { None });
    super::publish_table::<null::Options>(folder, &nulls.collect::<Vec<_>>())
}

/// Without tables there is nothing to write.
///
/// # Errors
/// None.
#[cfg(not(feature = "tables"))]
pub fn publish_tables(_folder: &Folder, _all: &[Measured]) -> Result<(), Finding> {
    Ok(())
}
