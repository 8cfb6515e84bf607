//! The parameter files of a measured run that is to be simulated once more, where nobody names them: those that the run itself gives.

use super::{Desk, Failure, Job, RUN_KINDS, jobs};
use crate::data::error::Finding;
use crate::data::run::Kind;
use crate::files::campaign::Campaign;
use crate::files::parameter::files_of;
use crate::record::known::Known;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Parameter files in a folder that goes away with this.
pub struct OwnParameters {
    _folder: TempDir,
    /// The files.
    pub files: Vec<PathBuf>,
    /// The linearity run whose calibration stands beside the offsets of an offset run.
    pub linearity: Option<String>,
}

/// Analyses a run, and beside an offset run the linearity run of the same sensor and mode in its campaign that is nearest in time. Runs of a
/// kind without such files give none.
///
/// # Errors
/// The run cannot be read, or its analysis refuses it.
pub fn own_parameters(run: &Path, model: Option<&Known>) -> Result<OwnParameters, Finding> {
    let io = |e: std::io::Error| Finding::io(&std::env::temp_dir(), "make a folder", &e);
    let folder = tempfile::tempdir().map_err(io)?;
    let desk = Desk::plain(folder.path().to_owned());
    let campaigns = Campaign::open(&[run.to_owned()], &mut Vec::new())?;
    let (own, _) = jobs(&campaigns, None);
    let mut linearity = None;
    if let Some(job) = own.first() {
        publish(job, model, &desk)?;
        if job.header.as_ref().is_some_and(|header| header.kind == Kind::Offset) {
            let whole = Campaign::open(std::slice::from_ref(&job.campaign.root), &mut Vec::new())?;
            let (others, _) = jobs(&whole, Some(Kind::Linearity));
            if let Some(beside) = nearest(job, &others) {
                publish(beside, model, &desk)?;
                linearity = Some(beside.id());
            }
        }
    }
    let files = files_of(folder.path())?;
    Ok(OwnParameters { _folder: folder, files, linearity })
}

/// Analyses a run as usual and writes its files.
fn publish(job: &Job, model: Option<&Known>, desk: &Desk) -> Result<(), Finding> {
    const WITH_FILES: [Kind; 3] = [Kind::Linearity, Kind::Offset, Kind::Frequency];
    let kind = job.header.as_ref().map(|header| header.kind).filter(|kind| WITH_FILES.contains(kind));
    let Some(analysis) = RUN_KINDS.iter().find(|of| Some(of.kind) == kind) else { return Ok(()) };
    let made = analysis.usual(None, model).make(job, desk, false);
    let made = made.map_err(|failure: Failure| {
        let rule = "cannot be analysed, so that it gives no parameter files";
        failure.errors().next().cloned().unwrap_or_else(|| Finding::error(&job.recorded, rule, "name some with --parameters"))
    })?;
    made.publish(desk, false).map(drop)
}

/// The run of the same sensor and mode whose start is nearest.
fn nearest<'a, 'b>(job: &Job, others: &'b [Job<'a>]) -> Option<&'b Job<'a>> {
    let own = job.header.as_ref()?;
    let is_like = |other: &&Job| {
        other.header.as_ref().is_some_and(|h| (&h.sensor, &h.mode) == (&own.sensor, &own.mode)) && other.excluded.is_none()
    };
    let distance =
        |other: &&Job| other.header.as_ref().map_or(f64::INFINITY, |header| (header.start.seconds() - own.start.seconds()).abs());
    others.iter().filter(is_like).min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
