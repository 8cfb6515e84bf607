//! Where simulated and measured data disagree, which effect is missing, and how the gap shrinks with it.
//!
//! A run becomes rows with covariates and a linear model ([`crate::record::prepared`]); jumps of thermistors are taken off
//! ([`crate::record::temperature_faults`]). What happens inside the plateaus is looked for in the samples ([`samples`]) and taken off. The noise of the
//! means is estimated before anything is named; then every term of the catalogue ([`crate::model::effects`]) and a smooth function of every
//! covariate are scored beside the model ([`means`]). One search ([`problem`]) serves these means, the parameters of several runs
//! ([`across`]) and sines ([`freq`]): the best term is added if it predicts stretches that were held out, all is fitted again, and terms are
//! dropped and swapped, until nothing significant is left. One builder (`steps`) makes a step of whatever was found. Results are plain
//! structs ([`result`]).

pub mod across;
mod beside;
pub mod branches;
pub mod candidate;
mod conclusion;
mod error;
mod explanations;
mod fault;
pub mod flight;
pub mod freq;
pub mod inside_maps;
mod lag;
mod left;
mod limits;
pub mod means;
mod next;
mod one_run;
pub mod problem;
pub mod result;
pub mod samples;
pub mod selection;
pub mod signature;
mod steps;
pub mod where_map;
pub mod words;

use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateaus;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::model::effects::bad_thermistor::BadThermistor;
use crate::model::effects::{Catalogue, EffectRef};
use crate::model::facility::Facility;
use crate::model::sensor_polynomials::SensorPolynomials;
pub use crate::record::known::Given;
pub use crate::record::prepared::Samples;
use crate::record::temperature_faults::{self, ChannelFault, Fault};
pub use error::DiagnoseError;
use result::Diagnosis;

/// Two explanations are distinguished if their likelihoods differ by this ratio (natural logarithm): one in a hundred.
const APART: f64 = 4.605;
/// Candidates with this canonical correlation beside the model look alike: a signal to noise ratio of twenty just distinguishes them.
const ALIKE: f64 = 0.99;
/// Signal to noise ratio of an effect of three parameters that is found with a probability of 90 %, at one false alarm in a hundred runs and
/// about twenty independent trials.
const FOUND_90: f64 = 5.2;
/// Signal to noise ratio from which a name may be called certain: below it a near twin is the usual error, see reports/blind-study.md.
const CERTAIN: f64 = 10.0;
/// An effect of which less than this part is left beside the fitted parameters cannot be shown.
const SHOWN: f64 = 0.02;

/// How a diagnosis is made.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The facility that turns settings into the reference field.
    pub facility: Option<Facility>,
    /// What a sensor follows of its temperature: taken off the readings of linearity runs.
    pub temperature: Option<SensorPolynomials>,
    /// Effects that are known already. What acts between the means is fitted again; what acts inside the plateaus is taken off.
    pub given: Vec<Given>,
    /// The effects that are looked for.
    pub catalogue: Catalogue,
    /// Whether the pictures go without what happens inside the plateaus: nothing else rests on it, and it takes all samples.
    pub without_insides: bool,
}

/// Diagnoses one run with fields in steps, a sweep, sines, or a run in zero field.
///
/// # Errors
/// Why the run cannot be looked at.
pub fn run(
    run: &Run,
    plateaus: &Plateaus,
    samples: Option<&Samples>,
    campaign: &Campaign,
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    let mut diagnosis = if run.header.kind == Kind::Frequency {
        freq::run(run, samples, campaign, options)?
    } else {
        one_run::run(run, plateaus, samples, campaign, options)?
    };
    // A jump that was taken off is a step of the diagnosis.
    let of_faults: Vec<&str> =
        diagnosis.steps.iter().filter(|s| s.effect == EffectRef::new(&BadThermistor)).map(|s| s.place.as_str()).collect();
    let is_step = |note: &Note| note.about.as_deref().is_some_and(|name| of_faults.iter().any(|place| place.contains(name)));
    let told = temperature_faults::told(run, &campaign.file.instructions);
    // One that the readings follow is none.
    let is_followed = |fault: &ChannelFault, note: &Note| {
        matches!(fault.fault, Fault::Jumps { .. })
            && diagnosis.notes.iter().any(|told| told.kind == NoteKind::Temperature && told.about == note.about)
    };
    let left = told.into_iter().filter(|(fault, note)| !is_step(note) && !is_followed(fault, note));
    let notes: Vec<Note> = left.map(|(_, note)| note).collect();
    diagnosis.notes.extend(notes);
    Ok(diagnosis)
}

/// Kinds of runs that [`run`] takes.
#[must_use]
pub fn takes(kind: Kind) -> bool {
    matches!(kind, Kind::Linearity | Kind::Sweep | Kind::ZeroField | Kind::Frequency)
}
