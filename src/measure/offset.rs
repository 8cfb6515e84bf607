//! Sensor offset and residual field of the coil system from one run in several positions (BC-MAG-TR-0085 section 3.4.2).
//!
//! In every position `B_r = B_off + A (B_c + B_res)`: turning the sensor changes the sign or the axis with which it sees the residual
//! field `B_res` of the coil system, and leaves the offset. The response `A` in each position is measured with the applied fields of
//! the run itself, so that a sensor which is turned by not quite 180° takes no part of the residual field for offset. For a turned
//! pair of an ideal sensor this is `B_off = (B_0 + B_180) / 2`, `B_res = (B_0 - B_180) / 2`.

use crate::data::calibration::Sensitivities;
use crate::data::note::{Note, NoteKind};
use crate::data::offset::{OffsetDrift, OffsetMethod, OffsetQuality, PositionVisit, RefusedComponent, ScaledOffset};
use crate::data::plateau::{LEAST_COVERAGE, Plateau, Plateaus, Settling};
use crate::data::provenance::Input;
use crate::data::result::{Covariance, Dropped, RunHead};
use crate::data::run::{Kind, Run};
use crate::data::units::COMPONENTS;
use crate::fit::{FitError, Limits, Solution, linear, order};
use crate::model::campaign::Instructions;
use crate::model::facility::{Facility, FacilityApplied};
use crate::model::position::Position;
use crate::model::sensor::SplitError;
use crate::record::conditions::{self, Temperatures};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use thiserror::Error;

/// How an offset analysis is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Settling after a step.
    pub settling: Settling,
    /// Least part of the expected samples of a plateau.
    pub least_coverage: f64,
    /// Go on when the readings do not follow the settings.
    pub allow_mismatch: bool,
    /// The linear calibration whose sensitivity turns enT into nT, with its file.
    pub cpf: Option<(Input, Sensitivities)>,
    /// The facility that turns settings into applied fields; its offset field stays part of the residual field that is measured.
    pub facility: Option<Facility>,
}

impl Default for Options {
    fn default() -> Self {
        Self { settling: Settling::Found, least_coverage: LEAST_COVERAGE, allow_mismatch: false, cpf: None, facility: None }
    }
}

/// Largest condition number of the designs: beyond it the fields of the run do not separate their effects.
const MOST_CONDITION: f64 = 1e4;
/// Fields smaller than this part of the largest one are rounding of the settings.
const LEAST_FIELD: f64 = 1e-6;
/// A component of a null vector that is larger couples its parameter to the others.
const COUPLED: f64 = 1e-6;
/// Uncertainty that rounding leaves, as a part of the readings.
const ROUNDING: f64 = 1e-9;
/// Angle, rad, by which a sensor may miss its nominal axes where the run does not show it.
const NOMINAL_TILT: f64 = 0.02;
/// Solutions with the covariance of the one before: the uncertainty of the response counts with the residual field.
const ROUNDS: usize = 3;
/// Degrees of freedom with which the scatter of the plateau means tells their noise.
const ENOUGH_FREEDOM: usize = 3;
/// Response of a component to its own axis outside this range, enT/nT, means a wrong position or a wrong setting.
const PLAUSIBLE_RESPONSE: std::ops::RangeInclusive<f64> = 0.5..=2.0;

/// Why a run has no offsets.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum OffsetError {
    /// Not an offset run.
    #[error("the run is of kind {0}, not offset")]
    Kind(Kind),
    /// Nothing to fit.
    #[error("the run has no plateaus: neither @BLOCKS nor @FIELDS with @VECTORS")]
    NoPlateaus,
    /// A position without axes.
    #[error("position {0} is not in the position table")]
    UnknownPosition(u32),
    /// Step edges elsewhere.
    #[error("the data do not step where the settings do: the edges are displaced by about {shift_s:+.2} s, or by whole settings")]
    Edges {
        /// Displacement, s.
        shift_s: f64,
    },
    /// Every plateau was dropped.
    #[error("none of the {total} plateaus can be used: {reason}")]
    NothingUsable {
        /// Plateaus in the run.
        total: usize,
        /// The reason of the first.
        reason: String,
    },
    /// Readings that do not follow the applied fields.
    #[error(
        "in position {position} component {component} responds with {response:.3} enT/nT to the {axis} field, not with about +1"
    )]
    Response {
        /// Position.
        position: u32,
        /// Component.
        component: &'static str,
        /// Coil axis with the sign with which the component looks along it.
        axis: String,
        /// Response along that direction.
        response: f64,
    },
    /// A component with one constant reading.
    #[error("component {component} is stuck at {reading_ent} enT")]
    Stuck {
        /// Component.
        component: &'static str,
        /// Reading, enT.
        reading_ent: f64,
    },
    /// The positions determine no component.
    #[error("no component has an offset: {0}")]
    NoPairs(String),
    /// A facility that no coil system can be.
    #[error(transparent)]
    Facility(#[from] SplitError),
    /// Another failure of the fit.
    #[error("the fit failed: {0}")]
    Fit(#[from] FitError),
}

impl OffsetError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            OffsetError::Kind(_) => "use the command for that kind",
            OffsetError::NoPlateaus => "check the file with `calfit check`",
            OffsetError::UnknownPosition(_) => "add [[position]] with this id and its axes to campaign.toml",
            OffsetError::Edges { .. } => {
                "correct the times of the settings or take those of this run, or go on with --allow mismatch"
            }
            OffsetError::NothingUsable { .. } => {
                "hold the fields longer, or say with --settling and --coverage what can be accepted"
            }
            OffsetError::Response { .. } => {
                "check the position table, the wiring and the settings, or go on with --allow mismatch"
            }
            OffsetError::Stuck { .. } => "check the component and its wiring",
            OffsetError::NoPairs(_) => "measure every component in a normal and a turned position",
            OffsetError::Facility(_) => "correct the facility",
            OffsetError::Fit(_) => "check the plateaus of the run",
        }
    }
}

/// Offsets and residual field of one run, with what is needed to judge them. What is not determined is nan.
#[derive(Clone, Debug, PartialEq)]
pub struct Offset {
    /// Offset of the sensor, enT, sensor axes.
    pub offset_ent: [f64; 3],
    /// Standard uncertainty of the offset, enT.
    pub offset_std_ent: [f64; 3],
    /// Residual field of the coil system, enT, along the sensor axes in the normal position.
    pub residual_ent: [f64; 3],
    /// Standard uncertainty of the residual field, enT.
    pub residual_std_ent: [f64; 3],
    /// Residual field of the coil system, nT, coil axes.
    pub residual_coil_nt: [f64; 3],
    /// Its standard uncertainty, nT.
    pub residual_coil_std_nt: [f64; 3],
    /// Run and conditions.
    pub run: RunHead,
    /// How the offsets were found, per component.
    pub method: OffsetMethod,
    /// Offsets in nT with the sensitivity of a linear calibration.
    pub scaled: Option<ScaledOffset>,
    /// Covariance of offsets and residual field.
    pub covariance: Covariance,
    /// OffsetDrift between visits of the same position.
    pub drift: Option<OffsetDrift>,
    /// Quality of the data.
    pub quality: OffsetQuality,
    /// The visits of positions in time order.
    pub visit: Vec<PositionVisit>,
    /// Components that were refused.
    pub refused: Vec<RefusedComponent>,
    /// The facility whose scale factors and angles turned settings into applied fields; absent if the settings were taken as fields.
    pub facility: Option<FacilityApplied>,
    /// Plateaus that were not used.
    pub dropped: Vec<Dropped>,
    /// Every plateau of the run.
    pub plateaus: Vec<Plateau>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// Consecutive plateaus in one position.
struct Stay<'a> {
    id: u32,
    position: Position,
    plateaus: Vec<&'a Plateau>,
}

impl Stay<'_> {
    fn time_s(&self) -> [f64; 2] {
        let first = self.plateaus.iter().map(|p| p.used_s[0]).fold(f64::INFINITY, f64::min);
        let last = self.plateaus.iter().map(|p| p.used_s[1]).fold(f64::NEG_INFINITY, f64::max);
        [first, last]
    }

    /// Mean time of the readings, s.
    fn mean_s(&self) -> f64 {
        self.plateaus.iter().map(|p| p.t_s()).sum::<f64>() / self.plateaus.len() as f64
    }
}

/// Offsets and residual field of one run.
///
/// # Errors
/// [`OffsetError`]: the run is refused. Components without a turned position are refused by name in the result.
pub fn offset(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Offset, OffsetError> {
    let header = &run.header;
    if header.kind != Kind::Offset {
        return Err(OffsetError::Kind(header.kind));
    }
    if plateaus.list.is_empty() {
        return Err(OffsetError::NoPlateaus);
    }
    if plateaus.edge_shift_s.abs() > plateaus.tolerable_shift_s && !options.allow_mismatch {
        return Err(OffsetError::Edges { shift_s: plateaus.edge_shift_s });
    }
    let mut plateaus = plateaus.clone();
    let mut of_facility: Vec<Note> = Vec::new();
    let facility = options
        .facility
        .as_ref()
        .map(|f| conditions::apply_facility(&f.without_offset(), run, instructions, &mut plateaus.list, &mut of_facility))
        .transpose()?;
    let stays = stays(&plateaus, instructions)?;
    let levels = Levels::measure(&stays)?;
    check_components(&stays, &levels, options)?;
    let solved = Solved::of(&stays, &levels)?;
    if solved.offset_ent.iter().all(|v| v.is_nan()) {
        let reasons: Vec<String> = solved.refused.iter().map(|r| format!("{}: {}", r.component, r.reason)).collect();
        return Err(OffsetError::NoPairs(reasons.join("; ")));
    }

    let span_s = [stays.first().map_or(0.0, |s| s.time_s()[0]), stays.last().map_or(0.0, |s| s.time_s()[1])];
    let mut notes = solved.notes(&levels);
    let temperatures = Temperatures::of(run, instructions, span_s, &mut notes);
    conditions::warn_of_plateaus(&mut notes, run, &plateaus);
    conditions::warn_of_run(&mut notes, run);
    let mut offset = Offset {
        run: conditions::head(run, instructions, &temperatures),
        scaled: None,
        quality: quality(run, &plateaus, &stays, &levels, &solved),
        visit: visits(&stays, &levels, &solved),
        offset_ent: solved.offset_ent,
        offset_std_ent: solved.offset_std_ent,
        residual_ent: solved.residual_ent,
        residual_std_ent: solved.residual_std_ent,
        residual_coil_nt: solved.residual_coil_nt,
        residual_coil_std_nt: solved.residual_coil_std_nt,
        method: solved.method,
        covariance: solved.covariance,
        drift: solved.drift,
        refused: solved.refused,
        facility,
        dropped: conditions::dropped(&plateaus.list),
        plateaus: plateaus.list.clone(),
        temperatures,
        notes,
    };
    if let Some((input, sensitivities)) = &options.cpf {
        offset.scale(&input.path, sensitivities);
    }
    offset.notes.extend(of_facility);
    Ok(offset)
}

fn quality(run: &Run, plateaus: &Plateaus, stays: &[Stay], levels: &Levels, solved: &Solved) -> OffsetQuality {
    let used: Vec<&Plateau> = stays.iter().flat_map(|s| s.plateaus.iter().copied()).collect();
    OffsetQuality {
        blocks_used: used.len(),
        blocks_total: plateaus.list.len(),
        lost_samples: run.vectors.lost,
        raw_std_ent: conditions::raw_std(&used),
        plateau_std_ent: levels.plateau_std_ent,
        chi_square: solved.chi_square,
        degrees_of_freedom: solved.degrees_of_freedom,
        plateau_degrees_of_freedom: levels.degrees_of_freedom,
        widened: solved.widened,
    }
}

fn visits(stays: &[Stay], levels: &Levels, solved: &Solved) -> Vec<PositionVisit> {
    let visit = |(v, stay): (usize, &Stay)| PositionVisit {
        position: stay.id,
        axes: stay.position.names(),
        time_s: stay.time_s(),
        blocks: stay.plateaus.len(),
        reading_ent: std::array::from_fn(|i| levels.reading_ent[(v, i)]),
        std_ent: std::array::from_fn(|i| levels.std_ent(v, i)),
        residual_ent: solved.residuals_ent.get(v).cloned().unwrap_or_default(),
    };
    stays.iter().enumerate().map(visit).collect()
}

impl Offset {
    /// Gives the offsets in nT as well, with the sensitivities of a linear calibration; `name` is that of its file.
    pub fn scale(&mut self, name: &str, of: &Sensitivities) {
        if (&of.sensor, &of.mode) != (&self.run.sensor, &self.run.mode) {
            let text = format!(
                "the sensitivities of {name} belong to {} {}, the offsets to {} {}",
                of.sensor, of.mode, self.run.sensor, self.run.mode
            );
            self.notes.push(Note::new(NoteKind::Method, text).about(name));
        }
        self.scaled = Some(ScaledOffset {
            cpf: name.to_owned(),
            sigma: of.sigma_nt_per_ent,
            offset_nt: of.to_nt(&self.offset_ent),
            offset_std_nt: of.to_nt(&self.offset_std_ent),
            residual_nt: of.to_nt(&self.residual_ent),
            residual_std_nt: of.to_nt(&self.residual_std_ent),
        });
    }
}

/// The visits of positions in time order; plateaus that are dropped belong to none.
fn stays<'a>(plateaus: &'a Plateaus, instructions: &Instructions) -> Result<Vec<Stay<'a>>, OffsetError> {
    let mut stays: Vec<Stay> = Vec::new();
    for plateau in plateaus.list.iter().filter(|p| p.dropped.is_none()) {
        let id = plateau.setting.position;
        match stays.last_mut() {
            Some(stay) if stay.id == id => stay.plateaus.push(plateau),
            _ => {
                let position = instructions.position(id).ok_or(OffsetError::UnknownPosition(id))?;
                stays.push(Stay { id, position, plateaus: vec![plateau] });
            }
        }
    }
    if stays.is_empty() {
        let reason = plateaus.list.iter().find_map(|p| p.dropped.as_ref()).map_or_else(String::new, ToString::to_string);
        return Err(OffsetError::NothingUsable { total: plateaus.list.len(), reason });
    }
    Ok(stays)
}

/// What the readings say before offset and residual field are told apart: the reading at zero applied field in every visit, and the
/// response to applied fields in every position.
struct Levels {
    /// Reading at zero applied field, visits x components, enT.
    reading_ent: DMatrix<f64>,
    /// Response per visit, enT/nT: rows are components, columns coil axes.
    response: Vec<Matrix3<f64>>,
    /// Directions in which the response was measured, per visit, with the column of their coefficients.
    directions: Vec<Vec<(usize, Vector3<f64>)>>,
    /// Covariance of all coefficients, `component * coefficients + coefficient`; the first ones are the readings of the visits.
    coefficients: DMatrix<f64>,
    /// Standard deviation that rounding leaves, enT.
    rounding_ent: f64,
    plateau_std_ent: [f64; 3],
    /// Plateaus minus coefficients.
    degrees_of_freedom: usize,
}

impl Levels {
    fn measure(stays: &[Stay]) -> Result<Self, OffsetError> {
        let rows: Vec<(usize, &Plateau)> =
            stays.iter().enumerate().flat_map(|(v, s)| s.plateaus.iter().map(move |p| (v, *p))).collect();
        let mut names: Vec<String> = stays.iter().map(|s| format!("the zero level in position {}", s.id)).collect();
        let mut columns: Vec<Vec<f64>> =
            (0..stays.len()).map(|v| rows.iter().map(|(of, _)| f64::from(u8::from(*of == v))).collect()).collect();
        let mut ids: Vec<u32> = stays.iter().map(|s| s.id).collect();
        ids.sort_unstable();
        ids.dedup();
        // The response is one for all visits of a position, along the directions in which fields were applied there.
        let mut directions: Vec<(u32, usize, Vector3<f64>)> = Vec::new();
        for &id in &ids {
            let fields: Vec<[f64; 3]> = rows.iter().filter(|(v, _)| stays[*v].id == id).map(|(_, p)| p.setting.field.0).collect();
            for direction in spanned(&fields) {
                directions.push((id, columns.len(), direction));
                names.push(format!("the response to applied fields in position {id}"));
                let along = |(v, p): &(usize, &Plateau)| {
                    if stays[*v].id == id { direction.dot(&Vector3::from(p.setting.field.0)) } else { 0.0 }
                };
                columns.push(rows.iter().map(along).collect());
            }
        }
        // A drift within the visits, if the plateaus can tell it.
        let p = columns.len();
        let middle: Vec<f64> = stays.iter().map(Stay::mean_s).collect();
        let drift: Vec<f64> = rows.iter().map(|(v, p)| (p.t_s() - middle[*v]) / 3600.0).collect();
        let readings = DMatrix::from_fn(rows.len(), 3, |row, component| rows[row].1.mean.0[component]);
        let counts: Option<Vec<f64>> = rows.iter().map(|(_, p)| p.count.map(|n| n as f64)).collect();
        let weights = counts.map(|c| {
            let mean = c.iter().sum::<f64>() / c.len() as f64;
            c.iter().map(|n| n / mean).collect::<Vec<f64>>()
        });
        let limits = Limits { max_condition: MOST_CONDITION };
        let solve = |columns: &[Vec<f64>], names: &[String]| -> Result<Solution, FitError> {
            let design = DMatrix::from_fn(rows.len(), columns.len(), |row, column| columns[column][row]);
            linear::solve(&linear::Design::new(names.to_vec(), design)?, &readings, weights.as_deref(), &limits)
        };
        let drifting = || {
            let with = [columns.as_slice(), std::slice::from_ref(&drift)].concat();
            let named = [names.as_slice(), &["the drift within a visit".to_owned()]].concat();
            solve(&with, &named).ok().filter(|s| s.dof >= ENOUGH_FREEDOM)
        };
        let solution = match drifting() {
            Some(solution) => solution,
            None => solve(&columns, &names)?,
        };

        let sampled = sampled_std(&rows, weights.as_deref());
        let full = solution.unscaled_covariance.nrows();
        let (all, plateau_std_ent) = match (solution.dof >= ENOUGH_FREEDOM, sampled) {
            (true, sampled) => {
                let used: Vec<&Plateau> = rows.iter().map(|(_, p)| *p).collect();
                let noise = conditions::noise(&solution, &used)?;
                // A few plateaus may scatter less by chance than their samples allow, where only their scatter is known.
                let wider: [f64; 3] = std::array::from_fn(|i| {
                    let scatter = solution.residual_std[i];
                    let chance = |s: [f64; 3]| if scatter > 0.0 { (s[i] / scatter).max(1.0) } else { 1.0 };
                    sampled.filter(|_| !noise.is_from_samples()).map_or(1.0, chance)
                });
                let covariance = noise.covariance();
                let scaled = DMatrix::from_fn(3 * full, 3 * full, |r, c| covariance[(r, c)] * wider[r / full] * wider[c / full]);
                (scaled, std::array::from_fn(|i| noise.noise[i].std * wider[i]))
            }
            // Too few plateaus to see how their means scatter: what the scatter of their samples lets expect.
            (false, Some(std)) => {
                let of = |row: usize, column: usize| {
                    std[row / full] * std[column / full] * solution.unscaled_covariance[(row % full, column % full)]
                };
                (DMatrix::from_fn(3 * full, 3 * full, of), std)
            }
            (false, None) => return Err(FitError::NoNoise { why: "too few plateaus, and no scatter of their samples" }.into()),
        };
        // How the components scatter together is not known well enough from so few plateaus to weigh them by it.
        let coefficients =
            DMatrix::from_fn(
                3 * p,
                3 * p,
                |r, c| {
                    if r / p == c / p { all[(r / p * full + r % p, c / p * full + c % p)] } else { 0.0 }
                },
            );
        let own = |stay: &Stay| -> Vec<(usize, Vector3<f64>)> {
            directions.iter().filter(|(id, ..)| *id == stay.id).map(|(_, column, d)| (*column, *d)).collect()
        };
        let response = stays
            .iter()
            .map(|stay| {
                let nominal = stay.position.r_nom().transpose();
                let measured: Matrix3<f64> = own(stay)
                    .iter()
                    .map(|(column, d)| Vector3::from_fn(|i, _| solution.coefficients[(*column, i)]) * d.transpose())
                    .sum();
                measured + nominal * (Matrix3::identity() - seen(&own(stay)))
            })
            .collect();
        Ok(Self {
            reading_ent: DMatrix::from_fn(stays.len(), 3, |v, i| solution.coefficients[(v, i)]),
            response,
            directions: stays.iter().map(own).collect(),
            coefficients,
            // Data without scatter still have a last digit.
            rounding_ent: ROUNDING * (1.0 + readings.amax()),
            plateau_std_ent,
            degrees_of_freedom: solution.dof,
        })
    }

    fn std_ent(&self, visit: usize, component: usize) -> f64 {
        let index = component * (self.coefficients.nrows() / 3) + visit;
        self.coefficients[(index, index)].max(0.0).sqrt()
    }

    /// Covariance of reading minus response times residual field, `component * visits + visit`: the measured response is uncertain,
    /// and where it was not measured so is the direction in which the sensor looks.
    fn covariance(&self, residual_nt: &Vector3<f64>) -> DMatrix<f64> {
        let (visits, p) = (self.response.len(), self.coefficients.nrows() / 3);
        let combine = DMatrix::from_fn(3 * visits, 3 * p, |row, column| {
            let (component, visit, coefficient) = (row / visits, row % visits, column % p);
            if column / p != component {
                0.0
            } else if coefficient == visit {
                1.0
            } else {
                self.directions[visit].iter().find(|(c, _)| *c == coefficient).map_or(0.0, |(_, d)| -d.dot(residual_nt))
            }
        });
        let mut covariance = &combine * &self.coefficients * combine.transpose();
        for visit in 0..visits {
            let unseen = (Matrix3::identity() - seen(&self.directions[visit])) * residual_nt;
            for component in 0..3 {
                let index = component * visits + visit;
                covariance[(index, index)] += self.rounding_ent.powi(2) + (NOMINAL_TILT * unseen.norm()).powi(2);
            }
        }
        covariance
    }
}

/// Projection on measured directions.
fn seen(directions: &[(usize, Vector3<f64>)]) -> Matrix3<f64> {
    directions.iter().map(|(_, d)| d * d.transpose()).sum()
}

/// Orthonormal directions that the applied fields span.
fn spanned(fields: &[[f64; 3]]) -> Vec<Vector3<f64>> {
    let matrix = DMatrix::from_fn(fields.len(), 3, |row, axis| fields[row][axis]);
    // The smaller Gram matrix has the same right singular vectors and exists for any number of fields.
    let gram = Matrix3::from_fn(|i, j| matrix.column(i).dot(&matrix.column(j)));
    let eigen = gram.symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let mut directions: Vec<(f64, Vector3<f64>)> = (0..3)
        .filter(|i| largest > 0.0 && eigen.eigenvalues[*i] > LEAST_FIELD * largest)
        .map(|i| (eigen.eigenvalues[i], eigen.eigenvectors.column(i).into_owned()))
        .collect();
    directions.sort_by(|a, b| b.0.total_cmp(&a.0));
    directions.into_iter().map(|(_, d)| d).collect()
}

/// Standard deviation of a plateau mean of mean weight per component from the scatter of the samples, taken as independent, enT.
fn sampled_std(rows: &[(usize, &Plateau)], weights: Option<&[f64]>) -> Option<[f64; 3]> {
    let weights = weights?;
    let variances: Vec<[f64; 3]> = rows
        .iter()
        .zip(weights)
        .map(|((_, p), w)| {
            let (std, count) = (p.std_ent?, p.count.filter(|n| *n > 1)?);
            Some(std.map(|s| w * s * s / count as f64))
        })
        .collect::<Option<_>>()?;
    Some(std::array::from_fn(|i| (variances.iter().map(|v| v[i]).sum::<f64>() / variances.len() as f64).sqrt()))
}

/// Readings of other settings, or of a component that does not work, must not become offsets.
fn check_components(stays: &[Stay], levels: &Levels, options: &Options) -> Result<(), OffsetError> {
    for (i, component) in COMPONENTS.into_iter().enumerate() {
        let values: Vec<f64> = stays.iter().flat_map(|s| s.plateaus.iter().map(|p| p.mean.0[i])).collect();
        let silent = stays.iter().flat_map(|s| &s.plateaus).all(|p| p.std_ent.is_none_or(|s| s[i] == 0.0));
        if silent && values.len() > 1 && values.iter().all(|v| *v == values[0]) {
            return Err(OffsetError::Stuck { component, reading_ent: values[0] });
        }
        for (v, stay) in stays.iter().enumerate() {
            let row = stay.position.r_nom().transpose().row(i).transpose();
            let response = (levels.response[v].row(i) * row)[0];
            if !levels.directions[v].is_empty() && !PLAUSIBLE_RESPONSE.contains(&response) && !options.allow_mismatch {
                let axis = stay.position.names()[i].clone();
                return Err(OffsetError::Response { position: stay.id, component, axis, response });
            }
        }
    }
    Ok(())
}

/// Offset and residual field with their uncertainties.
struct Solved {
    offset_ent: [f64; 3],
    offset_std_ent: [f64; 3],
    residual_ent: [f64; 3],
    residual_std_ent: [f64; 3],
    residual_coil_nt: [f64; 3],
    residual_coil_std_nt: [f64; 3],
    drift: Option<OffsetDrift>,
    method: OffsetMethod,
    covariance: Covariance,
    refused: Vec<RefusedComponent>,
    residuals_ent: Vec<Vec<f64>>,
    chi_square: f64,
    degrees_of_freedom: usize,
    widened: f64,
    /// Coil axes whose residual field is not determined: it is taken as zero with this standard uncertainty, nT.
    open_axes: Vec<usize>,
    assumed_nt: f64,
    drift_is_open: bool,
}

/// Parameters: three offsets, three residual fields, three drifts.
const OFFSET: usize = 0;
const RESIDUAL: usize = 3;
const DRIFT: usize = 6;
const NAMES: [&str; 9] = [
    "offset_x",
    "offset_y",
    "offset_z",
    "residual_coil_x",
    "residual_coil_y",
    "residual_coil_z",
    "drift_x",
    "drift_y",
    "drift_z",
];
const UNITS: [&str; 9] = ["enT", "enT", "enT", "nT", "nT", "nT", "enT/h", "enT/h", "enT/h"];
const COIL_AXES: [&str; 3] = ["X", "Y", "Z"];

impl Solved {
    fn of(stays: &[Stay], levels: &Levels) -> Result<Self, OffsetError> {
        let visits = stays.len();
        let mut ids: Vec<u32> = stays.iter().map(|s| s.id).collect();
        ids.sort_unstable();
        ids.dedup();
        let repeats = visits > ids.len();
        let reference_s = stays.iter().map(Stay::mean_s).sum::<f64>() / visits as f64;
        let hours: Vec<f64> = stays.iter().map(|s| (s.mean_s() - reference_s) / 3600.0).collect();

        // What can be told apart at all is a matter of the positions, not of the small angles by which they are missed.
        let mut parameters = if repeats { 9 } else { 6 };
        let nominal: Vec<Matrix3<f64>> = stays.iter().map(|s| s.position.r_nom().transpose()).collect();
        let mut null = null_space(&rows(&nominal, &hours, parameters));
        let undetermined = |null: &DMatrix<f64>, j: usize| null.row(j).norm() > COUPLED;
        let drift_is_open = repeats && (DRIFT..9).any(|j| undetermined(&null, j));
        if drift_is_open {
            parameters = 6;
            null = null_space(&rows(&nominal, &hours, parameters));
        }
        let open_axes: Vec<usize> = (0..3).filter(|k| undetermined(&null, RESIDUAL + k)).collect();
        let refused_components: Vec<usize> = (0..3).filter(|i| undetermined(&null, OFFSET + i)).collect();

        let kept: Vec<usize> =
            (0..parameters).filter(|j| !(RESIDUAL..DRIFT).contains(j) || !open_axes.contains(&(j - RESIDUAL))).collect();
        let full = rows(&levels.response, &hours, parameters);
        let design = DMatrix::from_fn(full.nrows(), kept.len(), |row, column| full[(row, kept[column])]);
        let readings = DVector::from_fn(3 * visits, |index, _| levels.reading_ent[(index % visits, index / visits)]);
        let names: Vec<String> = kept.iter().map(|j| NAMES[*j].to_owned()).collect();
        let no_scatter = || FitError::NoNoise { why: "the plateau means have no scatter" };
        let mut residual_nt = Vector3::zeros();
        let mut assumed_nt = 0.0;
        let mut round = || -> Result<Solution, OffsetError> {
            let mut covariance = levels.covariance(&residual_nt);
            for axis in &open_axes {
                let seen = full.column(RESIDUAL + axis);
                covariance += seen * seen.transpose() * (assumed_nt * assumed_nt);
            }
            let lower = covariance.cholesky().ok_or_else(no_scatter)?.l();
            let white_design = lower.solve_lower_triangular(&design).ok_or_else(no_scatter)?;
            let white_readings = lower.solve_lower_triangular(&readings).ok_or_else(no_scatter)?;
            let rhs = DMatrix::from_column_slice(3 * visits, 1, white_readings.as_slice());
            let solution = linear::solve(&linear::Design::new(names.clone(), white_design)?, &rhs, None, &Limits::default())?;
            for (at, j) in kept.iter().enumerate().filter(|(_, j)| (RESIDUAL..DRIFT).contains(*j)) {
                residual_nt[j - RESIDUAL] = solution.coefficients[(at, 0)];
            }
            // A residual field that is not determined may be as large as those that are, and as what the components read that would
            // show it.
            let read =
                refused_components.iter().flat_map(|i| levels.reading_ent.column(*i).iter().copied().collect::<Vec<f64>>());
            let determined = (0..3).filter(|k| !open_axes.contains(k)).map(|k| residual_nt[k]);
            assumed_nt = read.chain(determined).map(f64::abs).fold(0.0, f64::max);
            for axis in &open_axes {
                residual_nt[*axis] = 0.0;
            }
            Ok(solution)
        };
        let mut solution = round()?;
        for _ in 1..ROUNDS {
            solution = round()?;
        }
        let chi_square = solution.residuals.norm_squared();
        let widened = order::excess(chi_square, solution.dof);
        let covariance = &solution.unscaled_covariance * widened.powi(2);
        let coefficient = |j: usize| kept.iter().position(|k| *k == j).map(|at| solution.coefficients[(at, 0)]);
        let variance = |combination: &DVector<f64>| combination.dot(&(&covariance * combination)).max(0.0);
        let unit = |j: usize| DVector::from_fn(kept.len(), |at, _| f64::from(u8::from(kept[at] == j)));

        let mut solved = Solved {
            offset_ent: [f64::NAN; 3],
            offset_std_ent: [f64::NAN; 3],
            residual_ent: [f64::NAN; 3],
            residual_std_ent: [f64::NAN; 3],
            residual_coil_nt: [f64::NAN; 3],
            residual_coil_std_nt: [f64::NAN; 3],
            drift: None,
            method: OffsetMethod {
                component: std::array::from_fn(|_| "none".to_owned()),
                positions: std::array::from_fn(|_| Vec::new()),
                normal_axis: std::array::from_fn(|_| String::new()),
                response: if levels.directions.iter().all(|d| d.len() == 3) { "run" } else { "nominal" }.to_owned(),
            },
            covariance: Covariance { parameters: Vec::new(), units: Vec::new(), matrix: Vec::new() },
            refused: Vec::new(),
            residuals_ent: Vec::new(),
            chi_square,
            degrees_of_freedom: solution.dof,
            widened,
            open_axes: open_axes.clone(),
            assumed_nt,
            drift_is_open,
        };
        for k in (0..3).filter(|k| !open_axes.contains(k)) {
            solved.residual_coil_nt[k] = coefficient(RESIDUAL + k).unwrap_or(f64::NAN);
            solved.residual_coil_std_nt[k] = variance(&unit(RESIDUAL + k)).sqrt();
        }
        for i in 0..3 {
            let seen = Seen::of(stays, i);
            solved.method.normal_axis[i] = seen.normal_axis.clone();
            if refused_components.contains(&i) {
                solved.refused.push(seen.refusal(COMPONENTS[i]));
                continue;
            }
            solved.offset_ent[i] = coefficient(OFFSET + i).unwrap_or(f64::NAN);
            solved.offset_std_ent[i] = variance(&unit(OFFSET + i)).sqrt();
            solved.method.component[i] = if seen.turned.is_empty() { "tilted" } else { "turned" }.to_owned();
            solved.method.positions[i] = seen.positions.clone();
            // Half the difference of what the component sees of the residual field in the normal and in the turned position; in
            // tilted positions what it sees in the first.
            let row = |v: usize| levels.response[v].row(i).transpose();
            let sight = match seen.turned.first() {
                Some(turned) => (row(seen.normal) - row(*turned)) / 2.0,
                None => row(seen.normal),
            };
            let combination = DVector::from_fn(kept.len(), |at, _| {
                if (RESIDUAL..DRIFT).contains(&kept[at]) { sight[kept[at] - RESIDUAL] } else { 0.0 }
            });
            solved.residual_ent[i] = combination.dot(&solution.coefficients.column(0));
            solved.residual_std_ent[i] = variance(&combination).sqrt();
        }
        if parameters == 9 {
            solved.drift = Some(OffsetDrift {
                ent_per_h: std::array::from_fn(|i| coefficient(DRIFT + i).unwrap_or(f64::NAN)),
                std_ent_per_h: std::array::from_fn(|i| variance(&unit(DRIFT + i)).sqrt()),
                reference_s,
            });
        }
        let shown: Vec<usize> = (0..kept.len()).filter(|at| !refused_components.contains(&kept[*at])).collect();
        solved.covariance = Covariance {
            parameters: shown.iter().map(|at| NAMES[kept[*at]].to_owned()).collect(),
            units: shown.iter().map(|at| UNITS[kept[*at]].to_owned()).collect(),
            matrix: shown.iter().map(|r| shown.iter().map(|c| covariance[(*r, *c)]).collect()).collect(),
        };
        let residuals = readings - &design * solution.coefficients.column(0);
        solved.residuals_ent = (0..visits)
            .map(|v| (0..3).filter(|i| !refused_components.contains(i)).map(|i| residuals[i * visits + v]).collect())
            .collect();
        Ok(solved)
    }

    fn notes(&self, levels: &Levels) -> Vec<Note> {
        let refused = |r: &RefusedComponent| {
            let text = format!("component {} is refused: {}", r.component, r.reason);
            Note::new(NoteKind::Method, text).about(r.component.as_str()).with_remedy(r.remedy.as_str())
        };
        let mut notes: Vec<Note> = self.refused.iter().map(refused).collect();
        for axis in &self.open_axes {
            let leaks: Vec<String> = (0..3)
                .filter(|i| self.offset_ent[*i].is_finite())
                .map(|i| {
                    let share = levels.response.iter().map(|a| a[(i, *axis)].abs()).fold(0.0, f64::max);
                    format!("{share:.4} enT per nT in {}", COMPONENTS[i])
                })
                .collect();
            if !leaks.is_empty() {
                let text = format!(
                    "the residual field along {}_c is not determined and taken as 0 ± {:.1} nT, which is in the uncertainties; it enters the \
                     offsets with {}",
                    COIL_AXES[*axis],
                    self.assumed_nt,
                    leaks.join(", ")
                );
                notes.push(Note::new(NoteKind::Method, text).about(COIL_AXES[*axis]));
            }
        }
        if self.method.response == "nominal" {
            let text = format!(
                "fields were not applied along all axes in every position: the sensor is taken to lie along the nominal axes within {:.1}°",
                NOMINAL_TILT.to_degrees()
            );
            notes.push(Note::new(NoteKind::Method, text));
        }
        if self.drift_is_open {
            let text = "a position repeats, but the visits do not separate a drift from the offsets; none was estimated";
            notes.push(Note::new(NoteKind::Method, text));
        }
        if self.widened > 1.0 {
            let text = format!(
                "the zero levels of the visits disagree with one offset and one residual field (chi-square {:.1} with {} degrees of freedom); \
                 the uncertainties were multiplied by {:.1}",
                self.chi_square, self.degrees_of_freedom, self.widened
            );
            notes.push(Note::new(NoteKind::Method, text));
        }
        notes
    }
}

/// Rows of the model `reading = offset + A residual + drift * hours`, `component * visits + visit`.
fn rows(response: &[Matrix3<f64>], hours: &[f64], parameters: usize) -> DMatrix<f64> {
    let visits = response.len();
    DMatrix::from_fn(3 * visits, parameters, |row, j| {
        let (i, v) = (row / visits, row % visits);
        match j {
            OFFSET..RESIDUAL => f64::from(u8::from(i == j)),
            RESIDUAL..DRIFT => response[v][(i, j - RESIDUAL)],
            _ => f64::from(u8::from(i == j - DRIFT)) * hours[v],
        }
    })
}

/// Orthonormal vectors that a design takes to zero, as columns.
fn null_space(design: &DMatrix<f64>) -> DMatrix<f64> {
    let scales: Vec<f64> = design.column_iter().map(|c| c.norm()).map(|n| if n > 0.0 { n } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(design.nrows(), design.ncols(), |r, c| design[(r, c)] / scales[c]);
    let eigen = (scaled.transpose() * &scaled).symmetric_eigen();
    let null: Vec<usize> = (0..design.ncols()).filter(|i| eigen.eigenvalues[*i] < 1e-9).collect();
    DMatrix::from_fn(design.ncols(), null.len(), |r, c| eigen.eigenvectors[(r, null[c])])
}

/// How one component saw the coil axes.
struct Seen {
    /// First visit of its normal position.
    normal: usize,
    /// First visits of the positions in which the component looks the other way.
    turned: Vec<usize>,
    positions: Vec<u32>,
    normal_axis: String,
    /// The axes it looked along, without repeats.
    axes: Vec<String>,
}

impl Seen {
    fn of(stays: &[Stay], component: usize) -> Self {
        // The position with the lowest id is the normal one of a pair.
        let mut order: Vec<usize> = (0..stays.len()).collect();
        order.sort_by_key(|v| stays[*v].id);
        order.dedup_by_key(|v| stays[*v].id);
        let axis = |v: usize| stays[v].position.names()[component].clone();
        let flips = |a: usize, b: usize| axis(a)[1..] == axis(b)[1..] && axis(a) != axis(b);
        let normal = order.iter().copied().find(|v| order.iter().any(|w| flips(*v, *w))).unwrap_or(order[0]);
        let turned: Vec<usize> = order.iter().copied().filter(|w| flips(normal, *w)).collect();
        let compared: Vec<usize> = if turned.is_empty() {
            order.clone()
        } else {
            let same_axis = |v: &usize| axis(*v)[1..] == axis(normal)[1..] && *v != normal;
            std::iter::once(normal).chain(order.iter().copied().filter(same_axis)).collect()
        };
        let mut axes: Vec<String> = order.iter().map(|v| axis(*v)).collect();
        axes.sort();
        axes.dedup();
        Self { normal, turned, positions: compared.iter().map(|v| stays[*v].id).collect(), normal_axis: axis(normal), axes }
    }

    fn refusal(&self, component: &str) -> RefusedComponent {
        RefusedComponent {
            component: component.to_owned(),
            reason: format!(
                "no position shows it turned: it looks along {} only, and residual field and offset are the same there",
                self.axes.join(" and ")
            ),
            remedy: format!("measure a position in which {component} looks the other way"),
        }
    }
}
