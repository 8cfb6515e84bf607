//! What is missing between runs: the parameters of several runs disagree where nothing may differ.
//!
//! Every run gives nine values: ln σ (3), offset (3, nT) and ξ (3, degrees). What is common to the runs of a sensor is fitted, with
//! polynomials of its temperature where the runs span temperatures; candidates are the first-order consequences of wrong facility
//! parameters (mathematics.md section 5, CH-GFZ-TR-2601 sections 7 and 9), of temperatures, of time and of a place beside the centre.
//! The scatter of each of the three classes has its own unknown scale. Where the runs bring uncertainties and do not contradict them,
//! these count as values without parameters; otherwise the scatter is known from repeats and from what the model leaves.

use super::result::{DetectionLimit, Diagnosis, Gap, Map, NotIdentifiable, Parameter, Pictures, RunnerUp, ShapePoint, Step};
use super::{selection, words};
use crate::analysis::coil::tilt::{Family, PAIRS};
use crate::analysis::lin;
use crate::campaign::Campaign;
use crate::fit::propagate::propagate;
use crate::fit::scan::{ABSORBED, Fitted, Group, Score};
use crate::formats::orientations::RunResult;
use crate::formats::parameter::{Cpf, TiltValues};
use crate::model::effects::{self, Spec};
use crate::model::position::Position;
use crate::model::sensor::split;
use crate::plateau::Plateaus;
use crate::run::Run;
use crate::units::COMPONENTS;
use nalgebra::{DMatrix, DVector, Matrix3};
use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor};

/// Classes of values that have a scatter of their own.
const CLASSES: [&str; 3] = ["sigma", "offset", "xi"];
/// Rounding of values that come without uncertainties: ln σ, nT, degrees.
const ROUNDING: [f64; 3] = [1e-10, 1e-7, 1e-10];
/// Values without parameters that stand for known uncertainties: those of a run are known to a tenth or so themselves.
const MOST_ANCHORS: f64 = 40.0;
/// Uncertainties of runs within this factor are pooled: each for itself is known to some ten percent.
const ALIKE_STD: f64 = 4.0;
/// Uncertainties are not believed where the best models leave so unlikely a scatter.
const CONTRADICTED: f64 = 0.01;
/// Sensor temperatures that span more than this are part of the sensor's model, K.
const LEAST_SPAN_K: f64 = 5.0;
/// Temperatures that span less than this show nothing, K.
const LEAST_SHOWN_K: f64 = 0.2;
/// Temperatures within this are the same, K.
const SAME_K: f64 = 1.0;
/// As many orientations must agree before another one can stand out.
const LEAST_AGREEING: usize = 3;
/// A candidate is taken if noise alone gives as much evidence less often than this.
const SIGNIFICANT: f64 = 0.003;
/// Strength from which an effect is significant, about: what selection does to values depends on it little.
const LEAST: f64 = 4.0;
/// Below this evidence noise alone gives as much in one case of a few.
const HOPELESS: f64 = 2.0;
/// Prior of an orientation or a run that stands out, relative to an effect of the catalogue.
const UNKNOWN_PRIOR: f64 = 0.04;
/// Most effects.
const MOST_STEPS: usize = 6;
/// A term gives way to another one whose evidence is larger by this much.
const SWAP: f64 = 1.0;
const SEED: u64 = 0x0ca1_ac05;

/// The parameters of one run, and the conditions under which they were found.
#[derive(Clone, Debug, PartialEq)]
pub struct RunValues {
    /// Run id.
    pub run: String,
    /// Sensor and mode: runs of one name have one sensor.
    pub sensor: String,
    /// Set of runs that was made in one place: the campaign, or the table.
    pub set: String,
    /// Orientation.
    pub position: Position,
    /// Start, s.
    pub time: Option<f64>,
    /// Mean sensor temperature, °C.
    pub sensor_degc: Option<f64>,
    /// Mean temperature of the coil system, °C.
    pub coil_degc: Option<f64>,
    /// Largest applied field, nT: deviations of scale factors and angles are given in nT at this field.
    pub field_nt: Option<f64>,
    /// Sensitivity nT/enT, offset nT, angles degrees.
    pub values: TiltValues,
    /// Their standard uncertainties, where known.
    pub std: Option<TiltValues>,
    /// Independent values from which the uncertainties are known.
    pub freedom: f64,
}

impl RunValues {
    /// From a linear calibration. The offset is that in the middle of the run.
    ///
    /// # Errors
    /// The position is none.
    pub fn of_cpf(cpf: &Cpf) -> Result<Self, String> {
        let sigma: [f64; 3] = std::array::from_fn(|i| cpf.matrix.sigma[i][i]);
        let a = &cpf.angle_deg;
        // The mean of a run contains a part of the trend's curvature, which is no property of the sensor; a fitted parabola makes
        // the value in the middle 3/2 times as uncertain as the mean (equidistant times).
        let (offset_ent, factor): ([f64; 3], f64) = match cpf.offset.trend_order {
            0 | 1 => (cpf.offset.b_or_ent, 1.0),
            _ => (std::array::from_fn(|i| cpf.offset.trend_ent[i].first().copied().unwrap_or(cpf.offset.b_or_ent[i])), 1.5),
        };
        let std = TiltValues {
            scale: cpf.std.sigma,
            offset_nt: std::array::from_fn(|i| factor * sigma[i] * cpf.std.b_or_ent[i]),
            angles_deg: cpf.std.xi_deg,
        };
        let known = [std.scale, std.offset_nt, std.angles_deg].iter().flatten().all(|s| s.is_finite() && *s > 0.0);
        let most = cpf.valid.field_coil_nt.iter().flatten().fold(0.0, |m: f64, b| m.max(b.abs()));
        Ok(Self {
            run: cpf.run.id.clone(),
            sensor: format!("{}, {}", cpf.run.sensor, cpf.run.mode),
            set: cpf.run.campaign.clone(),
            position: Position::from_axes(&cpf.setup.position_axes).map_err(|e| e.to_string())?,
            time: cpf.run.start.parse::<jiff::Timestamp>().ok().map(|t| t.as_second() as f64),
            sensor_degc: cpf.run.temperature_degc,
            coil_degc: cpf.run.coil_temperature_degc,
            field_nt: Some(most).filter(|m| m.is_finite() && *m > 0.0),
            values: TiltValues {
                scale: sigma,
                offset_nt: std::array::from_fn(|i| sigma[i] * offset_ent[i]),
                angles_deg: [a.xi_xy, a.xi_xz, a.xi_yz],
            },
            std: known.then_some(std),
            // Slow noise may exceed what a parameter file says of it: its uncertainties count little beside the scatter of the runs.
            freedom: 1.0,
        })
    }

    /// From a run: weighted least squares with the noise that a diagnosis finds in it, slow noise and noise of the gain included.
    ///
    /// # Errors
    /// The run has no linear calibration.
    pub fn of_run(run: &Run, plateaus: &Plateaus, campaign: &Campaign, options: &lin::Options) -> Result<Self, String> {
        let made = lin::lin(run, plateaus, campaign, options).map_err(|e| e.to_string())?;
        let mut own = Self::of_cpf(&made.parameters)?;
        let scene = super::Scene::new(run, plateaus, None, campaign, options.facility.as_ref()).map_err(|e| e.0)?;
        let (n, p) = scene.design.shape();
        // Where fields beyond a limit were left out, the calibration stands as it is.
        let linear = (n == made.parameters.quality.blocks_used && p > 3)
            .then(|| super::Search::new(&scene, scene.readings.clone()).linear())
            .flatten();
        let Some((found, covariance)) = linear else { return Ok(own) };
        let most = scene.record.rows.iter().flat_map(|r| r.field_coil_nt).fold(0.0, |m: f64, b| m.max(b.abs()));
        let r_nom = own.position.r_nom();
        let nine = |x: &[f64]| -> Vec<f64> {
            let a = Matrix3::from_fn(|i, k| x[i * p + k] / most);
            match a.try_inverse().and_then(|phi| split(&phi, &r_nom).ok()) {
                Some(s) => (0..3).map(|i| s.sigma[i]).chain((0..3).map(|i| s.sigma[i] * x[i * p + 3])).chain(s.xi_deg).collect(),
                None => vec![f64::NAN; 9],
            }
        };
        let Ok(made) = propagate(nine, found.as_slice(), &covariance) else { return Ok(own) };
        let values =
            |v: &[f64]| TiltValues { scale: [v[0], v[1], v[2]], offset_nt: [v[3], v[4], v[5]], angles_deg: [v[6], v[7], v[8]] };
        own.values = values(&made.values);
        own.std = Some(values(&made.std));
        own.freedom = (n - p) as f64;
        Ok(own)
    }

    /// From a row of a table of run results.
    #[must_use]
    pub fn of_row(row: &RunResult, table: &str) -> Self {
        Self {
            run: row.run.clone(),
            sensor: row.sensor.clone(),
            set: table.to_owned(),
            position: row.position,
            // The runs of a table state no time.
            time: None,
            sensor_degc: None,
            coil_degc: None,
            field_nt: row.field_nt,
            values: TiltValues { scale: row.sigma, offset_nt: row.offset_nt, angles_deg: row.xi_deg },
            std: None,
            freedom: 0.0,
        }
    }

    /// ln σ, offset nT, ξ degrees.
    fn of(&self, class: usize) -> [f64; 3] {
        Family::ALL[class].of(&self.values)
    }

    /// Standard uncertainty of the same, or rounding.
    fn std_of(&self, class: usize) -> [f64; 3] {
        let Some(std) = &self.std else { return [ROUNDING[class]; 3] };
        match class {
            0 => std::array::from_fn(|i| std.scale[i] / self.values.scale[i]),
            1 => std.offset_nt,
            _ => std.angles_deg,
        }
    }

    /// Change of a reading by one unit of a class, nT: of ln σ and ξ at the largest field.
    fn nt_per_unit(&self, class: usize) -> f64 {
        let field = self.field_nt.unwrap_or(0.0);
        [field, 1.0, field.to_radians()][class]
    }
}

/// Sensor axis whose reading an angle between two axes changes: the later one, as ω is triangular.
fn axis_of(class: usize, i: usize) -> usize {
    if class == 2 { PAIRS[i].1 } else { i }
}

/// Something that may be missing: its columns on all values, class after class, run after run.
#[derive(Clone)]
struct Candidate {
    id: &'static str,
    key: String,
    spec: Spec,
    parameters: Vec<(String, &'static str)>,
    columns: DMatrix<f64>,
    /// Orientation or run that it concerns alone.
    alone: Option<Vec<usize>>,
}

/// The runs with what is fitted before anything is missed.
struct Scene<'a> {
    runs: &'a [RunValues],
    /// Orientation of each run, sensor by sensor.
    orientation: Vec<usize>,
    y: DVector<f64>,
    std: DVector<f64>,
    nuisance: DMatrix<f64>,
    anchors: [usize; 3],
}

fn extent(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    (high - low).max(0.0)
}

/// Indices of equal things, in the order of their first appearance.
fn numbered<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<usize> {
    let mut seen: Vec<T> = Vec::new();
    all.map(|one| {
        seen.iter().position(|s| *s == one).unwrap_or_else(|| {
            seen.push(one);
            seen.len() - 1
        })
    })
    .collect()
}

fn count(numbers: &[usize]) -> usize {
    numbers.iter().max().map_or(0, |m| m + 1)
}

impl<'a> Scene<'a> {
    fn new(runs: &'a [RunValues]) -> Self {
        let n = runs.len();
        let at = |class: usize, run: usize, i: usize| (class * n + run) * 3 + i;
        let (mut y, mut std) = (DVector::zeros(9 * n), DVector::zeros(9 * n));
        for (r, run) in runs.iter().enumerate() {
            for class in 0..3 {
                for i in 0..3 {
                    y[at(class, r, i)] = run.of(class)[i];
                    std[at(class, r, i)] = run.std_of(class)[i];
                }
            }
        }
        let sensors = numbered(runs.iter().map(|r| r.sensor.as_str()));
        for sensor in 0..count(&sensors) {
            for value in 0..9 {
                let rows: Vec<usize> = (0..n).filter(|r| sensors[*r] == sensor).map(|r| at(value / 3, r, value % 3)).collect();
                let (low, high) = rows.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), r| (l.min(std[*r]), h.max(std[*r])));
                if high < ALIKE_STD * low {
                    let pooled = (rows.iter().map(|r| std[*r] * std[*r]).sum::<f64>() / rows.len() as f64).sqrt();
                    rows.iter().for_each(|r| std[*r] = pooled);
                }
            }
        }
        let mut columns = Vec::new();
        for sensor in 0..count(&sensors) {
            let order = thermal_order(runs, &sensors, sensor);
            let u = scaled(runs, &sensors, sensor);
            for class in 0..3 {
                for i in 0..3 {
                    for power in 0..=order {
                        let mut column = DVector::zeros(9 * n);
                        for r in (0..n).filter(|r| sensors[*r] == sensor) {
                            column[at(class, r, i)] = if power == 0 { 1.0 } else { u(r).powi(power as i32) };
                        }
                        columns.push(column);
                    }
                }
            }
        }
        let orientation = numbered(runs.iter().map(|r| (r.sensor.as_str(), r.position.orientation())));
        let nuisance = DMatrix::from_columns(&columns);
        Self { runs, orientation, y, std, nuisance, anchors: [0; 3] }
    }

    fn count(&self) -> usize {
        self.runs.len()
    }

    /// Divided by the uncertainties, with the rows of the anchors.
    fn whiten(&self, columns: &DMatrix<f64>, anchor: f64) -> DMatrix<f64> {
        let (edges, n) = (self.edges(), 3 * self.count());
        let mut out = DMatrix::from_element(edges[3], columns.ncols(), anchor);
        for class in 0..3 {
            for r in 0..n {
                for c in 0..columns.ncols() {
                    out[(edges[class] + r, c)] = columns[(class * n + r, c)] / self.std[class * n + r];
                }
            }
        }
        out
    }

    fn edges(&self) -> [usize; 4] {
        let mut edges = [0; 4];
        for class in 0..3 {
            edges[class + 1] = edges[class] + 3 * self.count() + self.anchors[class];
        }
        edges
    }

    fn model(&self, terms: &[&Candidate]) -> DMatrix<f64> {
        let mut columns: Vec<DVector<f64>> = self.nuisance.column_iter().map(|c| c.into_owned()).collect();
        columns.extend(terms.iter().flat_map(|t| t.columns.column_iter().map(|c| c.into_owned())));
        DMatrix::from_columns(&columns)
    }

    fn fitted(&self, terms: &[&Candidate]) -> Fitted {
        let y = DMatrix::from_column_slice(self.y.len(), 1, self.y.as_slice());
        Fitted::new(&self.whiten(&y, 1.0).column(0).into_owned(), &self.whiten(&self.model(terms), 0.0), self.edges())
    }

    fn group(&self, fitted: &Fitted, candidate: &Candidate) -> Group {
        fitted.group(&self.whiten(&candidate.columns, 0.0))
    }

    /// Squares of what a model leaves of a class in units of the uncertainties, anchors not counted, and its degrees of freedom.
    fn left(&self, class: usize, terms: &[&Candidate]) -> (f64, f64) {
        let n = 3 * self.count();
        let part = |m: &DMatrix<f64>| DMatrix::from_fn(n, m.ncols(), |r, c| m[(class * n + r, c)] / self.std[class * n + r]);
        let y = part(&DMatrix::from_column_slice(self.y.len(), 1, self.y.as_slice())).column(0).into_owned();
        let fitted = Fitted::new(&y, &part(&self.model(terms)), [0, n, n, n]);
        (fitted.residual.norm_squared(), fitted.freedom()[0])
    }

    /// Believes the uncertainties of those classes whose scatter does not contradict them.
    fn anchor(&mut self, bank: &[Candidate], warnings: &mut Vec<String>) {
        let known = self.runs.iter().all(|r| r.std.is_some());
        let number = self.runs.iter().map(|r| r.freedom.max(0.0)).sum::<f64>().clamp(4.0, MOST_ANCHORS) as usize;
        let facility: Vec<&Candidate> = bank.iter().filter(|c| c.id.starts_with("facility") && c.spec.axes.len() == 3).collect();
        for class in 0..3 {
            // A single further effect is allowed for, so that what is looked for does not pass as noise.
            let mut best: Option<f64> = None;
            let mut squares = (f64::INFINITY, 0.0);
            for further in std::iter::once(None).chain(bank.iter().map(Some)) {
                let terms: Vec<&Candidate> = facility.iter().copied().chain(further).collect();
                let (sum, freedom) = self.left(class, &terms);
                let p = if freedom < 0.5 { 1.0 } else { ChiSquared::new(freedom).map_or(1.0, |d| d.sf(sum)) };
                if best.is_none_or(|b| p > b) {
                    best = Some(p);
                    squares = (sum, freedom);
                }
                if further.is_none() && freedom < 0.5 {
                    break;
                }
            }
            let agrees = best.is_some_and(|p| p > CONTRADICTED) && (known || squares.1 > 0.5);
            if agrees {
                self.anchors[class] = number;
            } else if known {
                warnings.push(format!(
                    "{}: the runs scatter {:.1} times as much as their own uncertainties; the scatter itself is taken as noise",
                    CLASSES[class],
                    (squares.0 / squares.1.max(1.0)).sqrt()
                ));
            }
        }
    }

    /// Standard deviation of each class in units of the uncertainties.
    fn scales(&self, fitted: &Fitted) -> [f64; 3] {
        let (edges, freedom) = (self.edges(), fitted.freedom());
        std::array::from_fn(|c| {
            let squares = fitted.residual.rows(edges[c], edges[c + 1] - edges[c]).norm_squared();
            (squares / freedom[c].max(1.0)).sqrt().max(f64::MIN_POSITIVE)
        })
    }

    /// Deviations of every run from a model that has not seen it, in the units of the values.
    fn held_out(&self, terms: &[&Candidate], scales: &[f64; 3]) -> DVector<f64> {
        let n = self.count();
        let p = self.nuisance.ncols();
        let weighted = |r: usize, v: f64| v / (self.std[r] * scales[r / (3 * n)]);
        let columns = self.model(terms);
        let mut out = DVector::zeros(9 * n);
        for run in 0..n {
            let of = |r: &usize| (r / 3) % n == run;
            let train: Vec<usize> = (0..9 * n).filter(|r| !of(r)).collect();
            let mut design = DMatrix::from_fn(train.len(), columns.ncols(), |i, c| weighted(train[i], columns[(train[i], c)]));
            let y = DVector::from_fn(train.len(), |i, _| weighted(train[i], self.y[train[i]]));
            let norms: Vec<f64> = design.column_iter().map(|c| c.norm()).map(|n| if n > 0.0 { n } else { 1.0 }).collect();
            for (c, norm) in norms.iter().enumerate() {
                design.column_mut(c).scale_mut(1.0 / norm);
            }
            // The shortest solution for the terms: what the others do not determine of them is not predicted.
            let (own, further) = (design.columns(0, p).into_owned(), design.columns(p, columns.ncols() - p).into_owned());
            let sensor = Fitted::new(&y, &own, [0, train.len(), train.len(), train.len()]);
            let size = if further.ncols() == 0 {
                DVector::zeros(0)
            } else {
                sensor
                    .beside(&further)
                    .svd(true, true)
                    .solve(&sensor.residual, 1e-6)
                    .unwrap_or_else(|_| DVector::zeros(further.ncols()))
            };
            let Ok(base) = own.svd(true, true).solve(&(&y - &further * &size), 1e-9) else { continue };
            for r in (0..9 * n).filter(of) {
                let coefficient = |c: usize| if c < p { base[c] } else { size[c - p] };
                let model: f64 = (0..columns.ncols()).map(|c| columns[(r, c)] * coefficient(c) / norms[c]).sum();
                out[r] = self.y[r] - model;
            }
        }
        out
    }

    /// Weighted squares of held-out deviations over the runs that `terms` do not concern alone.
    fn gap(&self, deviations: &DVector<f64>, scales: &[f64; 3], terms: &[&Candidate], classes: [bool; 3]) -> (Gap, f64) {
        let n = self.count();
        let shared: Vec<usize> =
            (0..n).filter(|r| terms.iter().all(|t| t.alone.as_ref().is_none_or(|own| !own.contains(r)))).collect();
        let (mut sum, mut number, mut most, mut squares) = (0.0, 0.0, 0.0_f64, [0.0; 3]);
        for class in (0..3).filter(|c| classes[*c]) {
            for r in &shared {
                for i in 0..3 {
                    let row = (class * n + r) * 3 + i;
                    let nt = deviations[row] * self.runs[*r].nt_per_unit(class);
                    sum += (deviations[row] / (self.std[row] * scales[class])).powi(2);
                    number += 1.0;
                    squares[axis_of(class, i)] += nt * nt;
                    most = most.max(nt.abs());
                }
            }
        }
        let rms_nt = squares.map(|s| (s / shared.len().max(1) as f64).sqrt());
        (Gap { rms_nt, chi2_per_dof: sum / f64::max(number, 1.0), max_nt: most }, sum)
    }
}

/// Order of the temperature polynomials of a sensor.
fn thermal_order(runs: &[RunValues], sensors: &[usize], sensor: usize) -> usize {
    let own: Option<Vec<f64>> = (0..runs.len()).filter(|r| sensors[*r] == sensor).map(|r| runs[r].sensor_degc).collect();
    let Some(mut own) = own else { return 0 };
    if extent(own.iter().copied()) <= LEAST_SPAN_K {
        return 0;
    }
    own.sort_by(f64::total_cmp);
    let mut distinct = 0;
    let mut last = f64::NEG_INFINITY;
    for t in own {
        if t > last + SAME_K {
            distinct += 1;
            last = t;
        }
    }
    match distinct {
        0..=2 => 0,
        3 | 4 => 1,
        _ => 2,
    }
}

/// Temperature of the runs of a sensor from -1 to 1.
fn scaled<'a>(runs: &'a [RunValues], sensors: &[usize], sensor: usize) -> impl Fn(usize) -> f64 + 'a {
    let own: Vec<f64> = (0..runs.len()).filter(|r| sensors[*r] == sensor).filter_map(|r| runs[r].sensor_degc).collect();
    let (low, high) = own.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let half = (0.5 * (high - low)).max(f64::MIN_POSITIVE);
    move |r| runs[r].sensor_degc.map_or(0.0, |t| (t - 0.5 * (low + high)) / half)
}

/// Everything that is tried, and why the rest of the catalogue is not.
fn bank(scene: &Scene) -> (Vec<Candidate>, Vec<NotIdentifiable>) {
    let (runs, n) = (scene.runs, scene.count());
    let at = |class: usize, run: usize, i: usize| (class * n + run) * 3 + i;
    let sensors = numbered(runs.iter().map(|r| r.sensor.as_str()));
    let mut bank: Vec<Candidate> = Vec::new();
    let mut none: Vec<NotIdentifiable> = Vec::new();
    let mut refuse = |id: &str, reason: String| none.push(NotIdentifiable { effect: id.to_owned(), reason });
    // Columns by a function of class, run and value; one per axis.
    let mut add =
        |id: &'static str, spec: Spec, names: Vec<(String, &'static str)>, f: &dyn Fn(usize, usize, usize, usize) -> f64| {
            let axes = spec.axes.clone();
            let columns = DMatrix::from_fn(9 * n, names.len(), |row, c| {
                f(row / (3 * n), (row / 3) % n, row % 3, axes.get(c % axes.len().max(1)).copied().unwrap_or(c))
            });
            bank.push(Candidate { id, key: id.to_owned(), spec, parameters: names, columns, alone: None });
        };
    let together = [vec![0, 1, 2], vec![0], vec![1], vec![2]];
    let named = |stem: &str, axes: &[usize], unit: &'static str| -> Vec<(String, &'static str)> {
        axes.iter().map(|a| (format!("{stem}_{}", COMPONENTS[*a]), unit)).collect()
    };

    // The facility: what a sensor axis sees of it depends on the orientation.
    let turned = (0..count(&sensors))
        .map(|s| numbered((0..n).filter(|r| sensors[*r] == s).map(|r| runs[r].position.orientation())))
        .map(|o| count(&o))
        .max()
        .unwrap_or(0);
    const FACILITY: [(&str, &str, &str); 3] =
        [("facility_scale", "scale", ""), ("facility_offset", "offset", "nT"), ("facility_angle", "angle", "deg")];
    for (class, (id, stem, unit)) in FACILITY.into_iter().enumerate() {
        if turned < 2 {
            refuse(id, "every sensor has one orientation: its own parameters take it up".to_owned());
            continue;
        }
        for axes in &together {
            let names = if class == 2 {
                axes.iter().map(|a| (format!("angle_{}", ["xy", "xz", "yz"][*a]), unit)).collect()
            } else {
                named(stem, axes, unit)
            };
            add(id, Spec::new("between runs", axes), names, &|c, r, i, k| {
                let (along, factor) = Family::ALL[class].sees(&runs[r].position, i);
                if c == class && along == k { factor } else { 0.0 }
            });
        }
    }
    if turned >= 2 {
        refuse(
            "facility_scale",
            "of its three factors two ratios: the common scale of coil system and sensor is seen by no orientation".to_owned(),
        );
    }

    // Temperatures.
    let moved = |of: &dyn Fn(&RunValues) -> Option<f64>| -> Option<Vec<f64>> {
        let all: Vec<f64> = runs.iter().map(of).collect::<Option<_>>()?;
        let mean = all.iter().sum::<f64>() / n as f64;
        (extent(all.iter().copied()) > LEAST_SHOWN_K).then(|| all.iter().map(|t| t - mean).collect())
    };
    let orders: Vec<usize> = (0..count(&sensors)).map(|s| thermal_order(runs, &sensors, s)).collect();
    let sensor_k = moved(&|r| r.sensor_degc);
    for (id, class, stem, unit) in
        [("sensor_temperature_sensitivity", 0, "a", "1/K"), ("sensor_temperature_offset", 1, "b", "nT/K")]
    {
        match &sensor_k {
            _ if orders.iter().any(|o| *o > 0) => {
                refuse(id, "part of the model: the sensor is a polynomial of its temperature".to_owned())
            }
            None => refuse(id, "the runs bring no sensor temperatures that differ".to_owned()),
            Some(k) => {
                for axes in &together {
                    add(id, Spec::new("between runs", axes), named(stem, axes, unit), &|c, r, i, a| {
                        if c == class && i == a { k[r] } else { 0.0 }
                    });
                }
            }
        }
    }
    match moved(&|r| r.coil_degc) {
        None => refuse("coil_temperature", "the runs bring no coil temperatures that differ".to_owned()),
        Some(k) => {
            for axes in &together {
                add("coil_temperature", Spec::new("between runs", axes), named("alpha", axes, "1/K"), &|c, r, i, a| {
                    let (along, factor) = Family::Scale.sees(&runs[r].position, i);
                    if c == 0 && along == a { factor * k[r] } else { 0.0 }
                });
            }
        }
    }
    let curved: Vec<usize> = (0..count(&sensors)).filter(|s| orders[*s] > 0).collect();
    if curved.is_empty() {
        refuse("thermal_curvature", "the runs span too few temperatures".to_owned());
    }
    for sensor in curved {
        let (u, power) = (scaled(runs, &sensors, sensor), orders[sensor] as i32 + 1);
        for (class, unit) in [(0, ""), (1, "nT"), (2, "deg")] {
            for axes in &together {
                let names = named(&format!("{}_t{power}", CLASSES[class]), axes, unit);
                add("thermal_curvature", Spec::new(CLASSES[class], axes), names, &|c, r, i, a| {
                    if c == class && i == a && sensors[r] == sensor { u(r).powi(power) } else { 0.0 }
                });
            }
        }
    }

    // Two places of one sensor.
    let sets = |s: usize| numbered((0..n).filter(|r| sensors[*r] == s).map(|r| runs[r].set.as_str()));
    let two: Vec<usize> = (0..count(&sensors)).filter(|s| count(&sets(*s)) == 2).collect();
    let mut moved_ones: Vec<Candidate> = Vec::new();
    if two.is_empty() {
        refuse("off_centre", "needs two sets of runs of one sensor, told apart by their campaigns".to_owned());
    }
    for sensor in two {
        let first = runs.iter().zip(&sensors).find(|(_, s)| **s == sensor).map_or("", |(r, _)| r.set.as_str());
        let other = |r: usize| sensors[r] == sensor && runs[r].set != first;
        add("off_centre", Spec::new("k", &[0, 1, 2]), named("k", &[0, 1, 2], ""), &|c, r, i, a| {
            if c == 0 && i == a && other(r) { 1.0 } else { 0.0 }
        });
        let names = [named("k", &[0, 1, 2], ""), vec![("xi_xy".into(), "deg"), ("xi_xz".into(), "deg"), ("xi_yz".into(), "deg")]];
        let columns = DMatrix::from_fn(9 * n, 6, |row, c| {
            let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if other(r) && class == 2 * (c / 3) && i == c % 3 { 1.0 } else { 0.0 }
        });
        let spec = Spec::new("k and K", &[0, 1, 2]);
        let key = "off_centre".to_owned();
        moved_ones.push(Candidate { id: "off_centre", key, spec, parameters: names.concat(), columns, alone: None });
    }

    bank.extend(moved_ones);

    // Time.
    let mut add = |id: &'static str, spec: Spec, names: Vec<(String, &'static str)>, f: &dyn Fn(usize, usize) -> f64| {
        let axes = spec.axes.clone();
        let columns = DMatrix::from_fn(9 * n, names.len(), |row, c| {
            let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if class == 1 && axes[c % axes.len()] == i { f(r, c / axes.len()) } else { 0.0 }
        });
        bank.push(Candidate { id, key: id.to_owned(), spec, parameters: names, columns, alone: None });
    };
    let times: Option<Vec<f64>> = runs.iter().map(|r| r.time).collect();
    match times.filter(|t| extent(t.iter().copied()) > 0.0) {
        None => {
            for id in ["offset_drift", "offset_step"] {
                refuse(id, "the runs bring no times".to_owned());
            }
        }
        Some(t) => {
            let (low, span) = (t.iter().copied().fold(f64::INFINITY, f64::min), extent(t.iter().copied()));
            let tau = |r: usize| 2.0 * (t[r] - low) / span - 1.0;
            for axes in &together {
                add("offset_drift", Spec::new("line", axes), named("p1", axes, "nT"), &|r, _| tau(r));
            }
            let mut order: Vec<f64> = t.clone();
            order.sort_by(f64::total_cmp);
            order.dedup();
            for pair in order.windows(2) {
                let middle = 0.5 * (pair[0] + pair[1]);
                for axes in &together {
                    let spec = Spec::new("step", axes).with("tau_0", middle, "s");
                    add("offset_step", spec, named("b", axes, "nT"), &|r, _| if t[r] > middle { 1.0 } else { 0.0 });
                }
            }
        }
    }

    // An orientation or a run by itself.
    let orientations = count(&scene.orientation);
    let members = |o: usize| (0..n).filter(|r| scene.orientation[*r] == o).collect::<Vec<usize>>();
    let mut outliers: Vec<(&str, Vec<usize>)> = Vec::new();
    if orientations > LEAST_AGREEING {
        outliers.extend((0..orientations).map(|o| ("orientation", members(o))));
    }
    for r in 0..n {
        let own = members(scene.orientation[r]);
        if own.len() > 2 {
            outliers.push(("run", vec![r]));
        }
    }
    for (what, own) in outliers {
        let name = if what == "run" { runs[own[0]].run.clone() } else { runs[own[0]].position.orientation() };
        for classes in [&[0, 1, 2][..], &[0], &[1], &[2]] {
            let columns = DMatrix::from_fn(9 * n, 3 * classes.len(), |row, c| {
                let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
                if class == classes[c / 3] && own.contains(&r) && i == c % 3 { 1.0 } else { 0.0 }
            });
            let parameters = classes
                .iter()
                .flat_map(|class| {
                    (0..3).map(|i| {
                        (
                            format!("{}_{}", CLASSES[*class], [COMPONENTS, COMPONENTS, ["xy", "xz", "yz"]][*class][i]),
                            ["", "nT", "deg"][*class],
                        )
                    })
                })
                .collect();
            let spec = Spec::new(&format!("{what} {name}"), &[0, 1, 2]);
            bank.push(Candidate {
                id: "unknown",
                key: format!("unknown: {what}"),
                spec,
                parameters,
                columns,
                alone: Some(own.clone()),
            });
        }
    }
    debug_assert!(bank.iter().all(|c| c.columns.nrows() == at(2, n - 1, 2) + 1));
    (bank, none)
}

/// Evidence of all candidates of one key.
struct Explanation {
    key: String,
    evidence: f64,
    best: usize,
    best_evidence: f64,
}

struct Search<'a> {
    scene: Scene<'a>,
    bank: Vec<Candidate>,
    vetoed: Vec<usize>,
}

impl Search<'_> {
    fn prior(&self, index: usize) -> f64 {
        let key = &self.bank[index].key;
        let same = self.bank.iter().filter(|c| c.key == *key).count() as f64;
        ((if self.bank[index].id == "unknown" { UNKNOWN_PRIOR } else { 1.0 }) / same).ln()
    }

    /// A term that leaves too few orientations to compare is no candidate.
    fn is_open(&self, index: usize, terms: &[&Candidate]) -> bool {
        let candidate = &self.bank[index];
        if self.vetoed.contains(&index) || terms.iter().any(|t| t.key == candidate.key && t.spec == candidate.spec) {
            return false;
        }
        let alone = |t: &Candidate| t.key == "unknown: orientation";
        !alone(candidate) || count(&self.scene.orientation) > LEAST_AGREEING + terms.iter().filter(|t| alone(t)).count()
    }

    fn explanations(&self, fitted: &Fitted, groups: &[Group], terms: &[&Candidate]) -> Vec<Explanation> {
        let keys = numbered(self.bank.iter().map(|c| c.key.as_str()));
        let mut all: Vec<Explanation> = (0..count(&keys))
            .filter_map(|key| {
                let own: Vec<(usize, f64)> = (0..self.bank.len())
                    .filter(|i| keys[*i] == key && self.is_open(*i, terms) && groups[*i].surviving > ABSORBED)
                    .map(|i| (i, fitted.score(&groups[i]).evidence + self.prior(i)))
                    .filter(|(_, e)| e.is_finite())
                    .collect();
                let (best, best_evidence) = own.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
                let evidence = best_evidence + own.iter().map(|(_, e)| (e - best_evidence).exp()).sum::<f64>().ln();
                Some(Explanation { key: self.bank[best].key.clone(), evidence, best, best_evidence })
            })
            .collect();
        all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        all
    }

    fn groups(&self, fitted: &Fitted) -> Vec<Group> {
        self.bank.iter().map(|c| self.scene.group(fitted, c)).collect()
    }

    fn classes(candidates: &[&Candidate], n: usize) -> [bool; 3] {
        std::array::from_fn(|c| candidates.iter().any(|t| t.columns.rows(c * 3 * n, 3 * n).norm() > 0.0))
    }

    /// The terms with probability that noise alone gives as much, and how many were tried.
    fn run(&mut self) -> Vec<(Candidate, f64, usize)> {
        let mut terms: Vec<(Candidate, f64, usize)> = Vec::new();
        for _ in 0..3 * MOST_STEPS {
            if terms.len() >= MOST_STEPS {
                break;
            }
            let now: Vec<&Candidate> = terms.iter().map(|t| &t.0).collect();
            let fitted = self.scene.fitted(&now);
            if fitted.freedom().iter().sum::<f64>() < 2.0 {
                break;
            }
            let groups = self.groups(&fitted);
            let explanations = self.explanations(&fitted, &groups, &now);
            let most = explanations.iter().map(|e| e.best_evidence).fold(f64::NEG_INFINITY, f64::max);
            let Some(best) = explanations.first().filter(|_| most > HOPELESS) else { break };
            let usable: Vec<usize> = (0..groups.len())
                .filter(|i| self.is_open(*i, &now) && groups[*i].surviving > ABSORBED && groups[*i].count() > 0)
                .collect();
            let tried: Vec<&Group> = usable.iter().map(|i| &groups[*i]).collect();
            let priors: Vec<f64> = usable.iter().map(|i| self.prior(*i)).collect();
            let p_global = fitted.simulate(&tried, &priors, SEED).global_p(most);
            if p_global > SIGNIFICANT {
                break;
            }
            let (index, candidate) = (best.best, self.bank[best.best].clone());
            let mut with = now.clone();
            with.push(&candidate);
            let scales = self.scene.scales(&self.scene.fitted(&with));
            let classes = Self::classes(&[&candidate], self.scene.count());
            let sum = |terms: &[&Candidate]| self.scene.gap(&self.scene.held_out(terms, &scales), &scales, &with, classes).1;
            if sum(&with) >= sum(&now) {
                // It does not predict what it has not seen.
                self.vetoed.push(index);
                continue;
            }
            let number = usable.len();
            terms.push((candidate, p_global, number));
            self.merge(&mut terms);
            self.repair(&mut terms);
        }
        terms
    }

    /// One term on all axes in place of two of one effect on different axes.
    fn merge(&self, terms: &mut Vec<(Candidate, f64, usize)>) {
        let Some(last) = terms.last().cloned() else { return };
        let earlier = terms.len() - 1;
        let joins = |t: &Candidate| {
            t.id != "unknown" && t.key == last.0.key && t.spec.form == last.0.spec.form && t.spec.shape == last.0.spec.shape
        };
        if let Some(index) = terms[..earlier].iter().position(|t| joins(&t.0))
            && let Some(all) = self.bank.iter().find(|c| joins(c) && c.spec.axes.len() == 3)
        {
            terms[index].0 = all.clone();
            terms.pop();
        }
    }

    /// Drops what the others made superfluous, and swaps what something else explains better.
    fn repair(&self, terms: &mut Vec<(Candidate, f64, usize)>) {
        let mut index = 0;
        while index < terms.len() && terms.len() > 1 {
            let others: Vec<&Candidate> = terms.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, t)| &t.0).collect();
            let fitted = self.scene.fitted(&others);
            let groups = self.groups(&fitted);
            let explanations = self.explanations(&fitted, &groups, &others);
            let own = explanations.iter().find(|e| e.key == terms[index].0.key).map_or(f64::NEG_INFINITY, |e| e.evidence);
            let own = own.max(fitted.score(&self.scene.group(&fitted, &terms[index].0)).evidence - 3.0);
            let better = explanations.first().filter(|b| b.evidence > own + SWAP && b.key != terms[index].0.key).map(|b| b.best);
            if own < 0.0 {
                terms.remove(index);
                continue;
            }
            if let Some(better) = better {
                terms[index].0 = self.bank[better].clone();
            }
            index += 1;
        }
    }
}

/// Diagnoses runs together.
///
/// # Errors
/// Why these runs show nothing together.
pub fn across(runs: &[RunValues]) -> Result<Diagnosis, String> {
    let mut warnings = Vec::new();
    let has_others = |run: &RunValues| runs.iter().filter(|r| r.sensor == run.sensor).count() > 1;
    let (kept, alone): (Vec<RunValues>, Vec<RunValues>) = runs.iter().cloned().partition(has_others);
    if kept.is_empty() {
        return Err("no sensor has several runs: nothing can disagree".to_owned());
    }
    warnings.extend(alone.iter().map(|r| format!("run {} is the only one of sensor {} and was not used", r.run, r.sensor)));
    let runs = kept.as_slice();
    let mut scene = Scene::new(runs);
    let (bank, mut not_identifiable) = bank(&scene);
    let left: f64 = (0..3).map(|c| scene.left(c, &[]).1).sum();
    if left < 3.0 {
        return Err("the runs have as many values as parameters".to_owned());
    }
    if runs.iter().any(|r| r.field_nt.is_none()) {
        warnings.push("a run states no field: the deviations of its scale factors and angles have no size in nT".to_owned());
    }
    scene.anchor(&bank, &mut warnings);
    let mut search = Search { scene, bank, vetoed: Vec::new() };
    let found = search.run();
    let scene = &search.scene;
    let all: Vec<&Candidate> = found.iter().map(|t| &t.0).collect();
    let fitted = scene.fitted(&all);
    let scales = scene.scales(&fitted);
    let mut maps = Vec::new();
    let mut steps: Vec<Step> = Vec::new();
    for index in 0..found.len() {
        let (step, map) = step(&search, &found, index, &scales);
        maps.push(map);
        steps.push(step);
    }
    let n = scene.count();
    let noise_floor_nt = std::array::from_fn(|a| {
        let mut sum = 0.0;
        for (r, run) in runs.iter().enumerate() {
            for class in 0..3 {
                for i in (0..3).filter(|i| axis_of(class, *i) == a) {
                    sum += (scene.std[(class * n + r) * 3 + i] * scales[class] * run.nt_per_unit(class)).powi(2);
                }
            }
        }
        (sum / n as f64).sqrt()
    });
    if remaining(scene, &all, &mut warnings) {
        steps.iter_mut().for_each(|s| s.wording = "consistent with");
    }
    if maps.is_empty() {
        let deviations = scene.held_out(&[], &scales);
        maps = (0..3).map(|a| map_of(scene, 1, a, 0, &deviations, &deviations, noise_floor_nt[a])).collect();
    }
    not_identifiable.retain(|e| e.effect == "facility_scale" || steps.iter().all(|s| s.effect != e.effect));
    let detection_limits = limits(&search, &fitted, &scales, &steps, &mut not_identifiable);
    let orientations = count(&scene.orientation);
    warnings.push(format!(
        "{n} runs, {orientations} orientation{}; every run in turn was held out; nT of scale factors and angles at the largest field of the run",
        if orientations == 1 { "" } else { "s" }
    ));
    let left = if steps.is_empty() { maps.clone() } else { Vec::new() };
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: runs.iter().map(|r| r.run.clone()).collect(),
        noise_floor_nt,
        noise: None,
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits,
        warnings,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        response: None,
        pictures: Pictures { left, ..Pictures::default() },
    })
}

/// Estimates of a term beside the others: the shortest solution, so that what the runs do not determine is not in it.
fn estimate(scene: &Scene, terms: &[&Candidate], at: usize, scales: &[f64; 3]) -> Vec<(f64, f64)> {
    let n = 3 * scene.count();
    let weighted = |m: &DMatrix<f64>| DMatrix::from_fn(m.nrows(), m.ncols(), |r, c| m[(r, c)] / (scene.std[r] * scales[r / n]));
    let others: Vec<&Candidate> = terms.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, t)| *t).collect();
    let y = weighted(&DMatrix::from_column_slice(scene.y.len(), 1, scene.y.as_slice())).column(0).into_owned();
    let beside = Fitted::new(&y, &weighted(&scene.model(&others)), [0, n, 2 * n, 3 * n]);
    let left = beside.beside(&weighted(&terms[at].columns));
    let svd = left.svd(true, true);
    let least = 1e-7 * svd.singular_values.max();
    let Some((u, v)) = svd.u.as_ref().zip(svd.v_t.as_ref()) else { return Vec::new() };
    (0..v.ncols())
        .map(|p| {
            let seen = (0..svd.singular_values.len()).filter(|k| svd.singular_values[*k] > least);
            seen.fold((0.0, 0.0_f64), |(value, std), k| {
                let along = v[(k, p)] / svd.singular_values[k];
                (value + along * u.column(k).dot(&beside.residual), std.hypot(along))
            })
        })
        .collect()
}

fn map_of(scene: &Scene, class: usize, i: usize, step: usize, before: &DVector<f64>, after: &DVector<f64>, noise_nt: f64) -> Map {
    let n = scene.count();
    let nt =
        |d: &DVector<f64>| (0..n).map(|r| d[(class * n + r) * 3 + i] * scene.runs[r].nt_per_unit(class)).collect::<Vec<f64>>();
    let what = ["sensitivity", "offset", "angle"][class];
    Map {
        covariate: format!("run in the order given ({what})"),
        unit: String::new(),
        axis: axis_of(class, i),
        x: (1..=n).map(|r| r as f64).collect(),
        before_nt: nt(before),
        after_nt: nt(after),
        noise_nt,
        step,
    }
}

fn step(search: &Search, found: &[(Candidate, f64, usize)], at: usize, scales: &[f64; 3]) -> (Step, Map) {
    let (scene, n) = (&search.scene, search.scene.count());
    let terms: Vec<&Candidate> = found.iter().map(|t| &t.0).collect();
    let others: Vec<&Candidate> = terms.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, t)| *t).collect();
    let candidate = terms[at];
    let without = scene.fitted(&others);
    let groups = search.groups(&without);
    let own_group = scene.group(&without, candidate);
    let score: Score = without.score(&own_group);
    let explanations = search.explanations(&without, &groups, &others);
    let own =
        explanations.iter().find(|e| e.key == candidate.key).map_or(score.evidence, |e| e.evidence).max(score.evidence - 3.0);
    let mut ambiguous: Vec<String> = Vec::new();
    let mut runners_up = Vec::new();
    for e in explanations.iter().filter(|e| e.key != candidate.key) {
        let correlation = Fitted::correlation(&groups[e.best], &own_group);
        let id = search.bank[e.best].id.to_owned();
        let twin = correlation > super::ALIKE && groups[e.best].count() == own_group.count() && id != "unknown";
        if (e.evidence > own - super::APART || twin) && id != candidate.id && !ambiguous.contains(&id) {
            ambiguous.push(id);
        }
        if runners_up.len() < 5 {
            runners_up.push(RunnerUp { effect: e.key.clone(), log_ratio: e.evidence - own, correlation });
        }
    }
    let once = counted_once(scene, &others, candidate);
    let values = estimate(scene, &terms, at, scales);
    let parameters: Vec<Parameter> = candidate
        .parameters
        .iter()
        .zip(selection::corrected(&values, score.strength, LEAST))
        .map(|((name, unit), (value, std))| Parameter { name: name.clone(), value, std: Some(std), unit: (*unit).to_owned() })
        .collect();
    let contribution = &candidate.columns * DVector::from_fn(values.len(), |j, _| values[j].0);
    let classes = Search::classes(&[candidate], n);
    let (before, after) = (scene.held_out(&others, scales), scene.held_out(&terms, scales));
    let (gap_before, gap_after) = (scene.gap(&before, scales, &terms, classes).0, scene.gap(&after, scales, &terms, classes).0);
    // Drawn and told where the contribution is largest.
    let in_nt = |row: usize| contribution[row] * scene.runs[(row / 3) % n].nt_per_unit(row / (3 * n));
    let size = |row: usize| in_nt(row).abs() + 1e-9 * (contribution[row] / scene.std[row]).abs().min(1.0);
    let most = (0..9 * n).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
    let (class, r, i) = (most / (3 * n), (most / 3) % n, most % 3);
    let noise_nt = scene.std[most] * scales[class] * scene.runs[r].nt_per_unit(class);
    let axis = COMPONENTS[axis_of(class, i)];
    let place = format!(
        "{} of {axis}, run {} in {}: up to {:.2} nT ({:.1} noise)",
        ["sensitivity", "offset", "angle"][class],
        scene.runs[r].run,
        scene.runs[r].position.orientation(),
        in_nt(most).abs(),
        (contribution[most] / (scene.std[most] * scales[class])).abs()
    );
    let about = effects::named(candidate.id).map(effects::Effect::about);
    let is_unknown = candidate.id == "unknown";
    let certain = ambiguous.is_empty() && score.strength > super::CERTAIN && once.is_none_or(|p| p < 0.01) && !is_unknown;
    let covariate = is_unknown.then(|| candidate.key.trim_start_matches("unknown: ").to_owned());
    let shape = if is_unknown {
        let own_row = |k: usize| (class * n + k) * 3 + i;
        let point = |k: usize| ShapePoint {
            covariate: (k + 1) as f64,
            residual_nt: contribution[own_row(k)] * scene.runs[k].nt_per_unit(class),
            std_nt: scene.std[own_row(k)] * scales[class] * scene.runs[k].nt_per_unit(class),
        };
        (0..n).map(point).collect()
    } else {
        Vec::new()
    };
    let mut step = Step {
        effect: candidate.id.to_owned(),
        axes: candidate.spec.axis_names().into_iter().map(str::to_owned).collect(),
        next_measurement: words::next_measurement(candidate.id, &ambiguous),
        ambiguous_with: ambiguous,
        // What runs disagree by is no term of a reading: a model file has no use for it.
        form: Spec { axes: Vec::new(), ..candidate.spec.clone() },
        further: Vec::new(),
        parameters,
        place,
        p_value: score.p_value(),
        trials: found[at].2,
        p_value_corrected: found[at].1,
        gap_before,
        gap_after,
        strength_k: score.strength,
        family: about.map_or("unknown", |a| a.family.name()),
        wording: if certain { "is" } else { "consistent with" },
        runners_up,
        sentence: String::new(),
        covariate,
        shape,
    };
    step.sentence = if is_unknown {
        format!(
            "{} does not agree with the others, by up to {:.2} nT, in a way that no effect of the catalogue explains; without it chi square over degrees of freedom of the others, held out, goes from {:.2} to {:.2}.",
            step.form.form,
            in_nt(most).abs(),
            step.gap_before.chi2_per_dof,
            step.gap_after.chi2_per_dof
        )
    } else {
        words::sentence(&step)
    };
    if let Some(p) = once.filter(|_| !is_unknown) {
        step.sentence.push_str(&format!(
            " Repeats of an orientation tell the noise; where every orientation counts once and the scatter between them is the noise, the probability is {p:.1e}."
        ));
    }
    let map = map_of(scene, class, i, at, &before, &after, noise_nt);
    (step, map)
}

/// Probability of a term where every orientation counts once, with the scatter between the orientations as noise: what would be left
/// of the evidence if the orientations differed by themselves. `None` without repeats.
fn counted_once(scene: &Scene, others: &[&Candidate], candidate: &Candidate) -> Option<f64> {
    let (n, g) = (scene.count(), count(&scene.orientation));
    if n == g {
        return None;
    }
    let number = |o: usize| scene.orientation.iter().filter(|r| **r == o).count() as f64;
    let mean = DMatrix::from_fn(9 * g, 9 * n, |row, column| {
        let (o, r) = ((row / 3) % g, (column / 3) % n);
        let same = row / (3 * g) == column / (3 * n) && row % 3 == column % 3 && scene.orientation[r] == o;
        if same { 1.0 / number(o) } else { 0.0 }
    });
    let fitted = Fitted::new(&(&mean * &scene.y), &(&mean * scene.model(others)), [0, 3 * g, 6 * g, 9 * g]);
    let group = fitted.group(&(&mean * &candidate.columns));
    let score = fitted.score(&group);
    let left: f64 = fitted.freedom().iter().sum();
    (left > score.count as f64 + 1.0).then(|| score.p_value())
}

/// Whether the runs still disagree; says by how much.
fn remaining(scene: &Scene, terms: &[&Candidate], warnings: &mut Vec<String>) -> bool {
    let (n, orientations) = (scene.count(), count(&scene.orientation));
    let mut disagree = false;
    for class in 0..3 {
        let (sum, freedom) = scene.left(class, terms);
        // What every orientation may have of its own leaves the repeats.
        let own = DMatrix::from_fn(9 * n, 9 * orientations, |row, c| {
            let (k, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if scene.orientation[r] == c / 9 && (c % 9) / 3 == k && c % 3 == i { 1.0 } else { 0.0 }
        });
        let free = Candidate {
            id: "unknown",
            key: String::new(),
            spec: Spec::new("", &[]),
            parameters: Vec::new(),
            columns: own,
            alone: None,
        };
        let with: Vec<&Candidate> = terms.iter().copied().chain(std::iter::once(&free)).collect();
        let (within, within_freedom) = scene.left(class, &with);
        let (between, between_freedom) = (sum - within, freedom - within_freedom);
        if between_freedom < 0.5 {
            continue;
        }
        let (p, noise) = if within_freedom > 1.5 {
            let noise = within / within_freedom;
            (FisherSnedecor::new(between_freedom, within_freedom).map_or(1.0, |f| f.sf(between / between_freedom / noise)), noise)
        } else if scene.anchors[class] > 0 {
            (ChiSquared::new(between_freedom).map_or(1.0, |d| d.sf(between)), 1.0)
        } else {
            continue;
        };
        if p < CONTRADICTED {
            disagree = true;
            let ratio = (between / between_freedom / noise).sqrt();
            warnings.push(format!(
                "{}: the orientations still differ by {ratio:.1} times what repeats let expect (p = {p:.1e}), and nothing that was tried explains it",
                CLASSES[class]
            ));
        }
    }
    disagree
}

fn limits(
    search: &Search,
    fitted: &Fitted,
    scales: &[f64; 3],
    steps: &[Step],
    none: &mut Vec<NotIdentifiable>,
) -> Vec<DetectionLimit> {
    let (scene, n) = (&search.scene, search.scene.count());
    let mut limits = Vec::new();
    let mut ids: Vec<&str> = search.bank.iter().map(|c| c.id).filter(|id| *id != "unknown").collect();
    ids.dedup();
    for id in ids.into_iter().filter(|id| steps.iter().all(|s| s.effect != *id)) {
        let own: Vec<&Candidate> = search.bank.iter().filter(|c| c.id == id).collect();
        let groups: Vec<Group> = own.iter().map(|c| scene.group(fitted, c)).collect();
        if groups.iter().all(|g| g.surviving < super::SHOWN) {
            let most = groups.iter().map(|g| g.surviving).fold(0.0, f64::max);
            let reason = format!("{:.1} % of it is left beside the fitted parameters", 100.0 * most);
            none.push(NotIdentifiable { effect: id.to_owned(), reason });
            continue;
        }
        for axis in 0..3 {
            let best = own
                .iter()
                .zip(&groups)
                .filter(|(c, g)| c.spec.axes == [axis] && c.columns.ncols() == 1 && g.surviving >= super::SHOWN)
                .map(|(c, g)| {
                    let class = (0..3).find(|k| c.columns.rows(k * 3 * n, 3 * n).norm() > 0.0).unwrap_or(0);
                    let least = super::FOUND_90 * scales[class] / g.norms[0];
                    let size = (0..9 * n)
                        .map(|row| c.columns[(row, 0)].abs() * scene.runs[(row / 3) % n].nt_per_unit(class))
                        .fold(0.0, f64::max);
                    (least * size, least, *c)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((amplitude_nt, least, c)) = best {
                let (name, unit) = &c.parameters[0];
                limits.push(DetectionLimit {
                    effect: id.to_owned(),
                    axis: COMPONENTS[axis].to_owned(),
                    amplitude_nt,
                    parameter: format!("{name} = {least:.2e} {unit}").trim_end().to_owned(),
                });
            }
        }
    }
    limits
}
