//! Temperature polynomials at the centre of the coil system as a file and a report.

use super::thermal::{ThermalOptions, covariance_together, rows};
use super::{Desk, Outcome};
use crate::data::across::CalibratedRun;
use crate::data::convention::{Alignment, Convention};
use crate::data::error::Finding;
use crate::data::note::{Note, Told};
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::result::Covariance;
use crate::files::ledger::Origin;
use crate::files::parameter::{Body, CentreConvention, OffCentrePart, Tcf, Tpf, read_point};
use crate::measure::centre::{self, AtCentre, OffCentre, Pair};
use crate::model::polynomial::{TemperaturePolynomial, value};
use crate::show;
use nalgebra::{DMatrix, Matrix3};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A result that takes part in a pair.
#[derive(Clone, Debug)]
pub(super) struct Member {
    /// The result.
    pub point: CalibratedRun,
    /// The parameter files that it was made of.
    pub files: Vec<String>,
    /// What it rests on.
    pub inputs: Vec<Input>,
}

/// A pair, and the offset at the centre: parameter files that were named, or results of a campaign.
#[derive(Clone, Debug)]
pub struct PairFiles {
    centre: Member,
    off_centre: Option<Member>,
    offset: Option<Member>,
    notes: Vec<Note>,
}

impl PairFiles {
    /// Reads them; notes on the files go to `findings`.
    ///
    /// # Errors
    /// What is wrong with a file.
    pub fn read(
        centre: &PathBuf,
        off_centre: Option<&PathBuf>,
        offset: Option<&PathBuf>,
        findings: &mut Vec<Finding>,
    ) -> Result<Self, Finding> {
        let mut one = |path: &PathBuf, role| {
            read_point(path, findings).map(|(point, d)| Member {
                files: vec![point.file.clone()],
                inputs: vec![d.input(point.file.clone()).with_role(role)],
                point,
            })
        };
        let read = Self {
            centre: one(centre, Role::Centre)?,
            off_centre: off_centre.map(|path| one(path, Role::OffCentre)).transpose()?,
            offset: offset.map(|path| one(path, Role::Offset)).transpose()?,
            notes: Vec::new(),
        };
        for (path, member) in [(Some(centre), Some(&read.centre)), (offset, read.offset.as_ref())] {
            let (Some(path), Some(member)) = (path, member) else { continue };
            if !member.point.run.location.is_centre() {
                let told = "it was measured beside the centre of the coil system (location = \"off-centre\"), and is given as one at the centre";
                return Err(Finding::error(&path.display().to_string(), told, "name the result of a run at the centre"));
            }
        }
        if let (Some(path), Some(member)) = (off_centre, &read.off_centre)
            && member.inputs.iter().any(|own| read.centre.inputs.iter().any(|other| own.sha256 == other.sha256))
        {
            let told = "it is the same as the result at the centre";
            return Err(Finding::error(
                &path.display().to_string(),
                told,
                "name the results of two runs, at the centre and beside it",
            ));
        }
        Ok(read)
    }

    /// Results of runs at the centre, which stand among those that the polynomials come from; the polynomials stand for the run beside
    /// the centre.
    pub(super) fn of_campaign(centre: Member, offset: Option<Member>, notes: Vec<Note>) -> Self {
        Self { centre, off_centre: None, offset, notes }
    }

    /// The pair.
    #[must_use]
    pub fn pair(&self) -> Pair<'_> {
        Pair {
            centre: &self.centre.point,
            off_centre: self.off_centre.as_ref().map(|member| &member.point),
            offset: self.offset.as_ref().map(|member| &member.point),
        }
    }

    fn members(&self) -> impl Iterator<Item = &Member> {
        std::iter::once(&self.centre).chain(&self.off_centre).chain(&self.offset)
    }

    /// Takes polynomials to the centre and writes file and report. `options` and `inputs` are those of the polynomials.
    ///
    /// # Errors
    /// Why that is not possible, or what cannot be written.
    pub fn publish(
        &self,
        tpf: &Tpf,
        options: &ThermalOptions,
        mut inputs: Vec<Input>,
        desk: &Desk,
    ) -> Result<CentreMade, Finding> {
        let mut result = centre::centre(&off_centre(tpf), self.pair())
            .map_err(|e| Finding::error(&tpf.file_name(), e.to_string(), e.remedy()))?;
        result.notes.extend(self.notes.iter().cloned());
        result.notes.extend(tpf.head.told.with_values_of(&tpf.file_name()));
        result.notes.extend(self.members().flat_map(|member| member.point.notes.iter().cloned()));
        for input in self.members().flat_map(|member| &member.inputs) {
            // What the runs of a campaign have in common, such as its campaign.toml, is one input.
            if !inputs.contains(input) {
                inputs.push(input.clone());
            }
        }
        let provenance = Provenance::new(options.recipe(desk), inputs);
        let file = tcf(&result, tpf);
        let name = file.file_name();
        let used = std::iter::once(tpf.file_name()).chain(self.members().flat_map(|member| member.files.clone()));
        let folder = desk.folder("", Origin::of(&provenance).using(used).telling(&result.notes))?;
        folder.check(&name)?;
        let outcome = Outcome {
            name: &name,
            parameters: desk.parameter_text("", &name, &file, &provenance)?,
            report: format!("REPORT_{}.md", name.trim_end_matches(".TCF")),
            title: show::centre::title(&result),
            notes: &result.notes,
            sections: show::centre::sections(&result, &name),
            provenance: &provenance,
        };
        outcome.write(&folder, &[])?;
        Ok(CentreMade { result, file, pair: self.members().flat_map(|member| member.files.clone()).collect(), provenance })
    }
}

/// Polynomials that were taken to the centre, with what their file holds.
pub struct CentreMade {
    /// The result.
    pub result: AtCentre,
    /// What its parameter file holds.
    pub file: Tcf,
    /// Its origin.
    pub provenance: Provenance,
    /// The parameter files of the runs at the centre, and of the one beside it where that is a run.
    pub pair: Vec<String>,
}

impl CentreMade {
    /// The result as `--json` prints it.
    #[must_use]
    pub fn view(&self) -> impl Serialize + '_ {
        CentreView { file: &self.file, provenance: &self.provenance }
    }
}

#[derive(Serialize)]
struct CentreView<'a> {
    #[serde(flatten)]
    file: &'a Tcf,
    provenance: &'a Provenance,
}

const SIGMA: [&str; 3] = ["sigma_x", "sigma_y", "sigma_z"];
const XI: [&str; 3] = ["xi_xy", "xi_xz", "xi_yz"];
const B_OR: [&str; 3] = ["b_or_x", "b_or_y", "b_or_z"];
const B_OFF: [&str; 3] = ["b_off_x", "b_off_y", "b_off_z"];

/// The polynomials of a file, with the covariances that it states.
fn off_centre(tpf: &Tpf) -> OffCentre {
    let common = tpf.of_facility();
    let (sigma, xi_deg) = if common.is_some() { tpf.of_type_a() } else { (tpf.sigma(), tpf.xi_deg()) };
    OffCentre {
        convention: Convention::BepiColombo,
        sensor: tpf.head.sensor.clone(),
        mode: tpf.head.mode.clone(),
        runs: tpf.head.runs.clone(),
        valid_degc: tpf.head.valid_degc,
        sigma,
        xi_deg,
        b_or_ent: tpf.b_or_ent(),
        scope: tpf.scope.clone(),
        of_facility: common,
    }
}

/// What the file of a result holds; `tpf` are the polynomials that it was made from.
fn tcf(result: &AtCentre, tpf: &Tpf) -> Tcf {
    let coefficients = |p: &[TemperaturePolynomial; 3]| p.clone().map(|p| p.coefficients);
    let matrix = |m: &Matrix3<f64>| std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]));
    let [sigma_x, sigma_y, sigma_z] = coefficients(&result.sigma);
    let [xi_xy, xi_xz, xi_yz] = coefficients(&result.xi_deg);
    let offset = result.offset.as_ref();
    let mean_degc = tpf.mean_degc();
    let at_mean = |p: &[TemperaturePolynomial; 3]| p.each_ref().map(|p| value(&p.coefficients, mean_degc));
    let alignment = Alignment { convention: Convention::Rosetta, sigma: at_mean(&result.sigma), xi_deg: at_mean(&result.xi_deg) };
    let [b_off_x, b_off_y, b_off_z] = offset.map(|o| coefficients(&o.b_off_ent)).unwrap_or_default();
    let covariance = [(SIGMA, Some(&result.sigma)), (XI, Some(&result.xi_deg)), (B_OFF, offset.map(|o| &o.b_off_ent))]
        .into_iter()
        .flat_map(|(names, polynomials)| names.into_iter().zip(polynomials.into_iter().flatten()))
        .filter(|(_, p)| !p.covariance.is_empty())
        .map(|(name, p)| (name.to_owned(), rows(&p.covariance)))
        .collect();
    Tcf {
        sigma_x,
        sigma_y,
        sigma_z,
        xi_xy,
        xi_xz,
        xi_yz,
        b_off_x,
        b_off_y,
        b_off_z,
        sigma_remainder: result.sigma_remainder,
        xi_remainder_deg: result.xi_remainder_deg,
        k: result.transfer.k,
        k_std: result.k_std,
        k_matrix: matrix(&result.transfer.k_matrix),
        k_inverse: matrix(&result.transfer.k_inverse),
        k_inverse_std: result.k_inverse_std,
        reference_degc: result.reference_degc,
        valid_degc: tpf.head.valid_degc,
        scope: result.scope.clone(),
        channel: tpf.head.channel.clone(),
        sensor: tpf.head.sensor.clone(),
        mode: tpf.head.mode.clone(),
        used: tpf.head.used.clone(),
        runs: tpf.head.runs.clone(),
        convention: CentreConvention::default(),
        covariance,
        together: result.together.as_ref().map(|c| together(result, c)),
        reference: tpf.stated_reference().and_then(|stated| stated.in_frame_of(&alignment).ok()),
        centre: result.centre.clone(),
        off_centre: OffCentrePart {
            at_reference: result.at_reference.clone(),
            coefficients: beside(&result.beside),
            covariance: named_covariances(&result.beside),
        },
        residual_field: offset.map(|o| o.residual.clone()),
        told: Told::of(&result.notes),
    }
}

/// The covariance of everything that a ground calibration file takes, with its names.
fn together(result: &AtCentre, covariance: &DMatrix<f64>) -> Covariance {
    let families = [
        ("", SIGMA, &result.sigma, "nT/enT"),
        ("", XI, &result.xi_deg, "deg"),
        ("off_centre.", XI, &result.beside.xi_deg, "deg"),
    ];
    let named = families.into_iter().flat_map(|(place, names, polynomials, unit)| {
        let one = move |(name, p): (&str, &TemperaturePolynomial)| (format!("{place}{name}"), unit, p.coefficients.len());
        names.into_iter().zip(polynomials).map(one)
    });
    let named: Vec<(String, &str, usize)> = named.collect();
    let polynomials: Vec<(&str, &str, usize)> = named.iter().map(|(name, unit, count)| (name.as_str(), *unit, *count)).collect();
    let mut together = covariance_together(&polynomials, covariance);
    for place in 0..9 {
        together.parameters.push(format!("k_inverse.{}.{}", place / 3, place % 3));
        together.units.push("1".to_owned());
    }
    together
}

/// The known covariances of the polynomials beside the centre by their names.
fn named_covariances(off: &OffCentre) -> BTreeMap<String, Vec<Vec<f64>>> {
    [(SIGMA, &off.sigma), (XI, &off.xi_deg), (B_OR, &off.b_or_ent)]
        .into_iter()
        .flat_map(|(names, p)| names.into_iter().zip(p))
        .filter(|(_, p)| !p.covariance.is_empty())
        .map(|(name, p)| (name.to_owned(), rows(&p.covariance)))
        .collect()
}

/// The coefficients beside the centre by their names.
fn beside(off: &OffCentre) -> BTreeMap<String, Vec<f64>> {
    [(SIGMA, &off.sigma), (XI, &off.xi_deg), (B_OR, &off.b_or_ent)]
        .into_iter()
        .flat_map(|(names, p)| names.into_iter().zip(p))
        .map(|(name, p)| (name.to_owned(), p.coefficients.clone()))
        .collect()
}
