//! The non-linearity of the readings of one sensor and mode (CH-GFZ-TR-2601 section 7): one third-order polynomial per sensor axis
//! that all its runs share, and the check for dependence on fields across an axis.
//!
//! `r + c2 r² + c3 r³ = A B_c + Σ p_k τ^k`: every run has its own response and offset trend, `c2` and `c3` are common. The argument of
//! the polynomial is the reading without its noise, so that the model of a reading is the inverse of the polynomial at the linear model,
//! and Gauss-Newton steps lead to the least squares of the readings themselves. In every step the runs' own parameters are projected
//! out ([`partitioned`](crate::fit::partitioned)).

mod axis;
mod data;
mod panel;
mod refusal;
mod shown;
mod told;

pub use refusal::LineariseError;
pub use shown::{BinMean, PanelData};

use crate::data::linearisation::{LinearisationPolynomials, LinearisedRun, SharedLinearisation};
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::data::result::Covariance;
use crate::data::units::COMPONENTS;
use crate::measure::lin::Lin;
use crate::model::linearisation::Linearisation;
use axis::{AxisFit, fit_axis};
use data::Data;
use nalgebra::Matrix2;
use rayon::prelude::*;
use shown::{panel_data, residual_std_nt};

/// The polynomials of a sensor and mode, before the runs are fitted with them.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The polynomials, ready for [`lin`](crate::measure::lin::Options). Its input is empty: there is no file yet.
    pub linearisation: Linearisation,
    /// What the runs share; the runs with it are not yet there.
    pub shared: SharedLinearisation,
    took_part: Vec<bool>,
    notes: Vec<Note>,
}

/// A linearisation with what its figures show.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised {
    /// What the runs share, and what that makes of each.
    pub shared: SharedLinearisation,
    /// What a person should know.
    pub notes: Vec<Note>,
    /// What the panels show, in the order of those of `shared`: sensor axis by sensor axis.
    pub panels: Vec<PanelData>,
}

/// Finds the polynomials that runs of one sensor and mode share. The runs are linear calibrations without a linearisation.
///
/// # Errors
/// [`LineariseError`]: what the runs do not determine.
pub fn linearise(runs: &[&Lin]) -> Result<Estimate, LineariseError> {
    let all: Vec<Data> = runs.iter().map(|lin| Data::of(lin)).collect();
    let took_part: Vec<bool> = all.iter().map(Data::is_long_enough).collect();
    let used: Vec<String> = runs.iter().map(|l| l.calibration.run.id.clone()).collect();
    let mut notes: Vec<Note> = Vec::new();
    for (id, _) in used.iter().zip(&took_part).filter(|(_, took_part)| !**took_part) {
        let text = format!("run {id} has too few plateaus to say anything about the polynomials");
        notes.push(Note::new(NoteKind::LeftOut, text).about(id));
    }
    let data: Vec<Data> = all.into_iter().filter(Data::is_long_enough).collect();
    let Some(head) = data.first().map(|d| &d.lin.calibration.run) else {
        return Err(LineariseError::NoRuns);
    };
    // The error of the first axis, whichever thread is the first.
    let fits: Vec<_> = (0..3).into_par_iter().map(|axis| fit_axis(&data, axis)).collect();
    let axes: Vec<AxisFit> = fits.into_iter().collect::<Result<_, _>>()?;
    notes.extend(doubts(&axes));

    let polynomials = LinearisationPolynomials {
        c2_per_ent: std::array::from_fn(|a| axes[a].polynomial.c2_per_ent),
        c2_std_per_ent: std::array::from_fn(|a| axes[a].covariance[(0, 0)].sqrt()),
        c3_per_ent2: std::array::from_fn(|a| axes[a].polynomial.c3_per_ent2),
        c3_std_per_ent2: std::array::from_fn(|a| axes[a].covariance[(1, 1)].sqrt()),
        reading_ent: std::array::from_fn(|a| axes[a].range_ent),
    };
    let covariance = std::array::from_fn(|a| axes[a].covariance);
    Ok(Estimate {
        linearisation: Linearisation {
            input: Input::default(),
            sensor: head.sensor.clone(),
            mode: head.mode.clone(),
            part: polynomials.clone(),
            covariance,
        },
        shared: SharedLinearisation {
            sensor: head.sensor.clone(),
            mode: head.mode.clone(),
            campaign: head.campaign.clone(),
            used,
            polynomials,
            covariance: named(&covariance),
            panel: axes.iter().flat_map(|a| a.panels.clone()).collect(),
            axis: axes.into_iter().map(|a| a.about).collect(),
            run: Vec::new(),
        },
        took_part,
        notes,
    })
}

/// Where the polynomials may be none, or the runs do not agree about them.
fn doubts(axes: &[AxisFit]) -> Vec<Note> {
    let mut notes = Vec::new();
    let weak: Vec<&str> = axes.iter().filter(|a| !a.about.significant).map(|a| a.about.name.as_str()).collect();
    if !weak.is_empty() {
        let text = format!(
            "the non-linearity of {} is not significant: it may be absent, or the readings may not reach far enough to show it; the runs \
             are linearised all the same, which makes their parameters more uncertain",
            weak.join(", ")
        );
        notes.push(Note::new(NoteKind::Method, text));
    }
    for a in axes.iter().filter(|a| a.about.inflation > 1.0) {
        let text = format!(
            "the runs disagree about the polynomial of {} by {:.1} times their noise; its standard uncertainties are larger by this",
            a.about.name, a.about.inflation
        );
        notes.push(Note::new(NoteKind::Method, text).about(&a.about.name));
    }
    notes
}

impl Estimate {
    /// The whole result, with the runs fitted without and with the polynomials, in the order of [`linearise`]; a run whose second fit
    /// failed is absent.
    #[must_use]
    pub fn complete(self, before: &[&Lin], after: &[Option<&Lin>]) -> Linearised {
        let both = || before.iter().zip(after).filter_map(|(b, a)| Some((*b, (*a)?)));
        let run = before.iter().zip(after).zip(&self.took_part).filter_map(|((before, after), took_part)| {
            Some(LinearisedRun {
                id: before.calibration.run.id.clone(),
                used: *took_part,
                blocks: before.calibration.quality.blocks_used,
                residual_std_before_nt: residual_std_nt(before),
                residual_std_after_nt: residual_std_nt((*after)?),
            })
        });
        let panels = (0..9).map(|i| panel_data(both(), i / 3, i % 3)).collect();
        Linearised { shared: SharedLinearisation { run: run.collect(), ..self.shared }, notes: self.notes, panels }
    }
}

/// The covariance of the six coefficients with their names.
fn named(blocks: &[Matrix2<f64>; 3]) -> Covariance {
    let of = |what: &dyn Fn(&str) -> [String; 2]| COMPONENTS.into_iter().flat_map(what).collect();
    let entry = |i: usize, j: usize| if i / 2 == j / 2 { blocks[i / 2][(i % 2, j % 2)] } else { 0.0 };
    Covariance {
        parameters: of(&|axis| [format!("c2_{axis}"), format!("c3_{axis}")]),
        units: of(&|_| ["1/enT".to_owned(), "1/enT^2".to_owned()]),
        matrix: (0..6).map(|i| (0..6).map(|j| entry(i, j)).collect()).collect(),
    }
}
