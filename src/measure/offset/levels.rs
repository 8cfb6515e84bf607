//! What the readings say in every visit of a position: the zero level, and the response to applied fields.

use super::refusal::OffsetError;
use super::stay::{Stay, ids};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::units::COMPONENTS;
use crate::fit::statistics::{std_of, student_tail};
use crate::fit::{FitError, Limits, Solution, linear, student_factor};
use crate::record::conditions::{self, Within};
use crate::record::screens::{self, Implausible};
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Largest condition number of the designs: beyond it the fields of the run do not separate their effects.
const MOST_CONDITION: f64 = 1e4;
/// Fields smaller than this part of the largest one are rounding of the settings.
const LEAST_FIELD: f64 = 1e-6;
/// Uncertainty that rounding leaves, as a part of the readings.
const ROUNDING: f64 = 1e-9;
/// Angle, rad, by which a sensor may miss its nominal axes where the run does not show it.
pub(super) const NOMINAL_TILT: f64 = 0.02;
/// Share by which a sensitivity may miss 1 nT/enT where no field is applied that shows it.
pub(super) const NOMINAL_GAIN: f64 = 0.05;
/// Probability that noise alone makes as large a change within the visits, in any component.
const NO_NOISE: f64 = 1e-3;
/// Degrees of freedom with which the scatter of the plateau means tells their noise.
const ENOUGH_FREEDOM: usize = 3;

/// What the readings say before offset and residual field are told apart: the reading at zero applied field in every visit, and the
/// response to applied fields in every position.
pub(super) struct Levels {
    /// Ids of the positions of the visits.
    pub positions: Vec<u32>,
    /// Reading at zero applied field, visits x components, enT.
    pub reading_ent: DMatrix<f64>,
    /// Response per visit, enT/nT: rows are components, columns coil axes.
    pub response: Vec<Matrix3<f64>>,
    /// Directions in which the response was measured, per visit, with the column of their coefficients.
    pub directions: Vec<Vec<(usize, Vector3<f64>)>>,
    /// Covariance of all coefficients, `component * coefficients + coefficient`; the first ones are the readings of the visits.
    coefficients: DMatrix<f64>,
    /// Standard deviation that rounding leaves, enT.
    rounding_ent: f64,
    /// Standard deviation of a plateau mean, enT.
    pub plateau_std_ent: [f64; 3],
    /// Plateaus minus coefficients.
    pub degrees_of_freedom: usize,
    /// What a person should know of the noise.
    pub notes: Vec<Note>,
}

impl Levels {
    /// From the plateaus of all visits together.
    pub fn measure(stays: &[Stay]) -> Result<Self, OffsetError> {
        let fitted = Fitted::of(stays)?;
        let mut notes = Vec::new();
        let (covariance, plateau_std_ent) = noise(&fitted.solution, &fitted.rows, fitted.weights.as_deref(), &mut notes)?;
        notes.extend(fitted.anew(&covariance));
        let coefficients = by_component(&covariance, fitted.columns.values.len());
        Ok(fitted.levels(coefficients, plateau_std_ent, notes))
    }

    /// The same visits with other fields, and the noise as it is.
    pub fn with_fields_of(&self, stays: &[Stay]) -> Result<Self, OffsetError> {
        Ok(Fitted::of(stays)?.levels(self.coefficients.clone(), self.plateau_std_ent, Vec::new()))
    }

    /// Whether no field was applied in any visit: nothing shows directions or sensitivities.
    pub fn has_no_fields(&self) -> bool {
        self.directions.iter().all(Vec::is_empty)
    }

    /// Standard uncertainty of the reading of a visit, enT.
    pub fn std_ent(&self, visit: usize, component: usize) -> f64 {
        let index = component * (self.coefficients.nrows() / 3) + visit;
        std_of(self.coefficients[(index, index)])
    }

    /// Covariance of reading minus response times residual field, `component * visits + visit`: the measured response is uncertain,
    /// and where it was not measured so is the direction in which the sensor looks.
    pub fn covariance(&self, residual_nt: &Vector3<f64>) -> DMatrix<f64> {
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
        let unseen = |visit: usize| (Matrix3::identity() - seen(&self.directions[visit])) * residual_nt;
        for (visit, other) in (0..visits).flat_map(|visit| (0..visits).map(move |other| (visit, other))) {
            // The direction in which the sensor looks belongs to the position: all visits to it err by the same.
            let tilted = if self.positions[visit] == self.positions[other] { unseen(visit).dot(&unseen(other)) } else { 0.0 };
            let rounding = if visit == other { self.rounding_ent.powi(2) } else { 0.0 };
            for component in 0..3 {
                covariance[(component * visits + visit, component * visits + other)] += rounding + NOMINAL_TILT.powi(2) * tilted;
            }
        }
        covariance
    }
}

/// Zero levels and responses by least squares, before anything is known of their noise.
struct Fitted<'a> {
    stays: &'a [Stay<'a>],
    rows: Vec<Row<'a>>,
    columns: Columns,
    readings: DMatrix<f64>,
    weights: Option<Vec<f64>>,
    solution: Solution,
}

impl<'a> Fitted<'a> {
    fn of(stays: &'a [Stay<'a>]) -> Result<Self, OffsetError> {
        let rows: Vec<Row> = stays.iter().enumerate().flat_map(|(v, s)| s.plateaus.iter().map(move |p| (v, *p))).collect();
        let columns = Columns::of(stays, &rows);
        let readings = DMatrix::from_fn(rows.len(), 3, |row, component| rows[row].1.mean.0[component]);
        let weights = weights(&rows);
        let solution = columns.solve(stays, &rows, &readings, weights.as_deref())?;
        Ok(Self { stays, rows, columns, readings, weights, solution })
    }

    /// Says of a change within the visits that is the same in all of them, and no noise.
    fn anew(&self, covariance: &DMatrix<f64>) -> Option<Note> {
        let (full, drift) = (self.solution.coefficients.nrows(), self.columns.values.len());
        if full == drift {
            return None;
        }
        let of = |i: usize| {
            let (value, at) = (self.solution.coefficients[(drift, i)], i * full + drift);
            let std = std_of(covariance[(at, at)]);
            (COMPONENTS[i], value, std)
        };
        let is_seen = |(_, value, std): &(&str, f64, f64)| {
            student_tail(value.abs() / std, self.solution.dof).is_some_and(|tail| 2.0 * 3.0 * tail < NO_NOISE)
        };
        let seen: Vec<(&str, f64, f64)> = (0..3).map(of).filter(is_seen).collect();
        let texts: Vec<String> =
            seen.iter().map(|(name, value, std)| format!("{value:+.2} ± {std:.2} enT/h in {name}")).collect();
        (!texts.is_empty()).then(|| {
            let text = format!(
                "the readings change within the visits to the positions, alike in all of them: {}; a change that begins anew with every turn is in \
                 offset and residual field, and in no uncertainty",
                texts.join(", ")
            );
            Note::new(NoteKind::Method, text).with_remedy("wait after every turn until the readings are steady, or visit every position twice")
        })
    }

    fn levels(self, coefficients: DMatrix<f64>, plateau_std_ent: [f64; 3], notes: Vec<Note>) -> Levels {
        let Self { stays, columns, readings, solution, .. } = self;
        let response = |stay: &Stay| {
            let nominal = stay.position.r_nom().transpose();
            let own = columns.of_stay(stay);
            let measured: Matrix3<f64> =
                own.iter().map(|(column, d)| Vector3::from_fn(|i, _| solution.coefficients[(*column, i)]) * d.transpose()).sum();
            measured + nominal * (Matrix3::identity() - seen(&own))
        };
        Levels {
            positions: stays.iter().map(|stay| stay.id).collect(),
            reading_ent: DMatrix::from_fn(stays.len(), 3, |v, i| solution.coefficients[(v, i)]),
            response: stays.iter().map(response).collect(),
            directions: stays.iter().map(|stay| columns.of_stay(stay)).collect(),
            coefficients,
            // Data without scatter still have a last digit.
            rounding_ent: ROUNDING * (1.0 + readings.amax()),
            plateau_std_ent,
            degrees_of_freedom: solution.dof,
            notes,
        }
    }
}

/// A plateau with the index of its visit.
type Row<'a> = (usize, &'a Plateau);

/// The columns of the design: the zero level of every visit, then the responses.
struct Columns {
    names: Vec<String>,
    values: Vec<Vec<f64>>,
    /// Position, column and direction of every response.
    directions: Vec<(u32, usize, Vector3<f64>)>,
}

impl Columns {
    fn of(stays: &[Stay], rows: &[Row]) -> Self {
        let mut names: Vec<String> = stays.iter().map(|s| format!("the zero level in position {}", s.id)).collect();
        let mut values: Vec<Vec<f64>> =
            (0..stays.len()).map(|v| rows.iter().map(|(of, _)| f64::from(u8::from(*of == v))).collect()).collect();
        // The response is one for all visits of a position, along the directions in which fields were applied there.
        let mut directions: Vec<(u32, usize, Vector3<f64>)> = Vec::new();
        for id in ids(stays) {
            let fields: Vec<[f64; 3]> = rows.iter().filter(|(v, _)| stays[*v].id == id).map(|(_, p)| p.setting.field.0).collect();
            for direction in spanned(&fields) {
                directions.push((id, values.len(), direction));
                names.push(format!("the response to applied fields in position {id}"));
                let along = |(v, p): &Row| {
                    if stays[*v].id == id { direction.dot(&Vector3::from(p.setting.field.0)) } else { 0.0 }
                };
                values.push(rows.iter().map(along).collect());
            }
        }
        Self { names, values, directions }
    }

    /// The directions in which the response was measured in the position of a visit, with their columns.
    fn of_stay(&self, stay: &Stay) -> Vec<(usize, Vector3<f64>)> {
        self.directions.iter().filter(|(id, ..)| *id == stay.id).map(|(_, column, d)| (*column, *d)).collect()
    }

    /// Least squares; with a drift within the visits, the last column, if the plateaus can tell it.
    fn solve(
        &self,
        stays: &[Stay],
        rows: &[Row],
        readings: &DMatrix<f64>,
        weights: Option<&[f64]>,
    ) -> Result<Solution, FitError> {
        let limits = Limits { max_condition: MOST_CONDITION };
        let solve = |columns: &[Vec<f64>], names: &[String]| -> Result<Solution, FitError> {
            let design = DMatrix::from_fn(rows.len(), columns.len(), |row, column| columns[column][row]);
            linear::solve(&linear::Design::new(names.to_vec(), design)?, readings, weights, &limits)
        };
        let middle: Vec<f64> = stays.iter().map(Stay::mean_s).collect();
        let drift: Vec<f64> = rows.iter().map(|(v, p)| (p.t_s() - middle[*v]) / 3600.0).collect();
        let with = [self.values.as_slice(), &[drift]].concat();
        let named = [self.names.as_slice(), &["the drift within a visit".to_owned()]].concat();
        match solve(&with, &named).ok().filter(|s| s.dof >= ENOUGH_FREEDOM) {
            Some(solution) => Ok(solution),
            None => solve(&self.values, &self.names),
        }
    }
}

/// Weights of mean one by the number of samples, where the file tells it.
fn weights(rows: &[Row]) -> Option<Vec<f64>> {
    let counts: Vec<f64> = rows.iter().map(|(_, p)| p.count.map(|n| n as f64)).collect::<Option<_>>()?;
    let mean = counts.iter().sum::<f64>() / counts.len() as f64;
    Some(counts.iter().map(|n| n / mean).collect())
}

/// Covariance of all coefficients, `component * coefficients + coefficient`, and the standard deviation of a plateau mean, enT.
fn noise(
    solution: &Solution,
    rows: &[Row],
    weights: Option<&[f64]>,
    notes: &mut Vec<Note>,
) -> Result<(DMatrix<f64>, [f64; 3]), FitError> {
    let full = solution.unscaled_covariance.nrows();
    match (solution.dof >= ENOUGH_FREEDOM, sampled_std(rows, weights)) {
        (true, sampled) => {
            let used: Vec<&Plateau> = rows.iter().map(|(_, p)| *p).collect();
            let noise = conditions::noise(solution, &used, Within::Still)?;
            let longest = |[a, b]: [f64; 2], p: &&Plateau| [a.min(p.used_s[0]), b.max(p.used_s[1])];
            let span_s = used.iter().fold([f64::INFINITY, f64::NEG_INFINITY], longest);
            conditions::warn_of_slow_noise(notes, &noise, span_s);
            // A few plateaus may scatter less by chance than their samples allow, where only their scatter is known.
            let wider: [f64; 3] = std::array::from_fn(|i| {
                let scatter = solution.residual_std[i];
                let chance = |s: [f64; 3]| if scatter > 0.0 { (s[i] / scatter).max(1.0) } else { 1.0 };
                sampled.filter(|_| !noise.is_from_samples()).map_or(1.0, chance)
            });
            let covariance = noise.covariance();
            let scaled = DMatrix::from_fn(3 * full, 3 * full, |r, c| covariance[(r, c)] * wider[r / full] * wider[c / full]);
            Ok((scaled, std::array::from_fn(|i| noise.noise[i].std * wider[i])))
        }
        // Too few plateaus to see well how their means scatter: what the scatter of their samples lets expect, or what little is left of the
        // means lets not exclude, for sources scatter from setting to setting as well.
        (false, Some(sampled)) => {
            let dof = solution.dof;
            let left = |i: usize| if dof > 0 { solution.residual_std[i] * student_factor(dof) } else { 0.0 };
            let std: [f64; 3] = std::array::from_fn(|i| sampled[i].max(left(i)));
            let of = |row: usize, column: usize| {
                std[row / full] * std[column / full] * solution.unscaled_covariance[(row % full, column % full)]
            };
            Ok((DMatrix::from_fn(3 * full, 3 * full, of), std))
        }
        (false, None) => Err(FitError::NoNoise { why: "too few plateaus, and no scatter of their samples" }),
    }
}

/// The covariance of the first `count` coefficients of every component. How the components scatter together is not known well enough
/// from so few plateaus to weigh them by it.
fn by_component(covariance: &DMatrix<f64>, count: usize) -> DMatrix<f64> {
    let full = covariance.nrows() / 3;
    DMatrix::from_fn(3 * count, 3 * count, |r, c| {
        if r / count == c / count { covariance[(r / count * full + r % count, c / count * full + c % count)] } else { 0.0 }
    })
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
fn sampled_std(rows: &[Row], weights: Option<&[f64]>) -> Option<[f64; 3]> {
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
pub(super) fn check_components(
    stays: &[Stay],
    levels: &Levels,
    allow_mismatch: bool,
    notes: &mut Vec<Note>,
) -> Result<(), OffsetError> {
    for (i, component) in COMPONENTS.into_iter().enumerate() {
        let values: Vec<f64> = stays.iter().flat_map(|s| s.plateaus.iter().map(|p| p.mean.0[i])).collect();
        let silent = stays.iter().flat_map(|s| &s.plateaus).all(|p| p.std_ent.is_none_or(|s| s[i] == 0.0));
        if silent && values.len() > 1 && values.iter().all(|v| *v == values[0]) {
            return Err(Implausible::Stuck { component, reading_ent: values[0] }.into());
        }
        for (v, stay) in stays.iter().enumerate() {
            let row = stay.position.r_nom().transpose().row(i).transpose();
            let response = (levels.response[v].row(i) * row)[0];
            if levels.directions[v].is_empty() || screens::is_plausible(response) {
                continue;
            }
            let axis = stay.position.names()[i].clone();
            let error = OffsetError::Response { position: stay.id, component, axis, response };
            if !allow_mismatch {
                return Err(error);
            }
            notes.push(Note::new(NoteKind::Mismatch, format!("{error}, which was allowed")).about(component));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of ten visits to one position errs by its unknown tilt as one visit does; that of visits to ten positions does not.
    #[test]
    fn the_unknown_tilt_is_common_to_the_visits_of_a_position() {
        let visits = 10;
        let std_ent = |positions: Vec<u32>| {
            let levels = Levels {
                positions,
                reading_ent: DMatrix::zeros(visits, 3),
                response: vec![Matrix3::identity(); visits],
                directions: vec![Vec::new(); visits],
                coefficients: DMatrix::identity(3 * visits, 3 * visits) * 1e-6,
                rounding_ent: 0.0,
                plateau_std_ent: [1e-3; 3],
                degrees_of_freedom: 1,
                notes: Vec::new(),
            };
            let covariance = levels.covariance(&Vector3::new(50.0, 0.0, 0.0));
            let mean: f64 = (0..visits).flat_map(|v| (0..visits).map(move |w| (v, w))).map(|at| covariance[at]).sum();
            assert_eq!(covariance[(0, visits)], 0.0, "the components err independently");
            mean.sqrt() / visits as f64
        };
        let tilted = 50.0 * NOMINAL_TILT;
        assert!((std_ent(vec![1; visits]) / tilted - 1.0).abs() < 1e-3);
        assert!((std_ent((0..10).collect()) / (tilted / 10f64.sqrt()) - 1.0).abs() < 1e-3);
    }
}
