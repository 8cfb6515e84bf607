//! Sensor and facility from runs of one sensor in several orientations (CH-GFZ-TR-2601 sections 7 and 9; docs/mathematics.md, "The coil
//! system").
//!
//! A sensor axis i along the coil axis k with the sign s sees wrong parameters of the facility as its own: the sensitivity
//! `σ_i (1 - ds_k)`, the offset `o_i + s db_k`, and the angle `ξ_ij + s_i s_j dα_kl` between two axes. In other orientations it sees
//! those of other coils, so that sensor and facility are told apart. To first order the three families do not mix. What a mounting adds that
//! stands a little beside the nominal orientation, the products of its angles with the parameters of the facility, follows from the rotation that
//! the runs show, and is taken off (`Oriented::beyond_first_order`).

use super::{ANGLES, AXES, CoilError};
use crate::data::note::{Note, NoteKind};
use crate::data::result::Covariance;
use crate::fit::statistics::{chi2_tail, fisher_tail, median, std_of};
use crate::fit::{FitError, Limits, linear};
use crate::model::facility::FacilityParameters;
use crate::model::facility_calibration::{SensorValues, TiltFound, TiltOrientation};
use crate::model::position::{Class, OrientedRun, PAIRS, Position};
use crate::model::sensor::{compose, split};
use nalgebra::{DMatrix, DVector, Matrix3, SymmetricEigen, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How sensor and facility are told apart.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Sensor, where there are several.
    pub sensor: Option<String>,
    /// Keep an orientation that does not agree with the others.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub keep_all: bool,
}

/// An orientation is left out where the scatter without it is so much less, in scale factors, offsets and angles together, as it is by chance less often
/// than this for the best of all orientations. The fourth orientation of CH-GFZ-TR-2601, which the report leaves out, has 0.02.
const UNLIKELY: f64 = 0.05;
/// So many orientations must remain.
const LEAST_LEFT: usize = 3;
/// Scatter of scale factors, offsets (nT) and angles (degrees) that is rounding.
const ROUNDING: [f64; 3] = [1e-10, 1e-7, 1e-10];
/// Most rounds for what is beyond the first order, and rounds for the rotation against the axes of the coils: every one takes an order of the
/// parameters further, so that a mounting within a few degrees takes four.
const ROUNDS: usize = 30;
const ROTATIONS: usize = 3;
/// Offsets of orientations differ from those of one sensor and one facility by so many times what runs within an orientation do, and by so much, nT, where
/// an orientation has another sign or the facility changed: 2 to 13 times and 0.5 to 3.2 nT with CH-GFZ-TR-2601, as printed and with one sign wrong.
const FAR: f64 = 6.0;
const LEAST_FAR_NT: f64 = 1.0;
/// Eigenvalues of the normal matrix below this are zero: its entries are small whole numbers.
const NULL: f64 = 1e-9;

/// Sensor and facility.
#[derive(Clone, Debug, PartialEq)]
pub struct Tilt {
    /// What was found.
    pub found: TiltFound,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// The values of one run or orientation in which the facility acts by addition.
pub(crate) fn additive(class: Class, values: &SensorValues) -> [f64; 3] {
    match class {
        Class::Scale => values.scale.map(f64::ln),
        Class::Offset => values.offset_nt,
        Class::Angle => values.angles_deg,
    }
}

/// The answer for one family.
struct Solved {
    sensor: [f64; 3],
    facility: [f64; 3],
    sensor_std: [f64; 3],
    covariance: Matrix3<f64>,
    residual_std: f64,
    dof: usize,
    /// Directions of the facility that the orientations do not see.
    unseen: Vec<Vector3<f64>>,
}

/// Solves one family by least squares. What the orientations leave undetermined the correction of the facility has no part of.
fn solve(family: Class, orientations: &[(Position, [f64; 3])]) -> Result<Solved, FitError> {
    let rows = 3 * orientations.len();
    let mut design = DMatrix::zeros(rows, 6);
    let mut rhs = DVector::zeros(rows);
    for (g, (position, values)) in orientations.iter().enumerate() {
        for i in 0..3 {
            let (k, factor) = family.sees(position, i);
            design[(3 * g + i, i)] = 1.0;
            design[(3 * g + i, 3 + k)] = factor;
            rhs[3 * g + i] = values[i];
        }
    }
    // A null direction always has a part in the facility: the sensor's own parameters are seen in every orientation.
    let eigen = SymmetricEigen::new(design.transpose() * &design);
    let null = (0..6).filter(|j| eigen.eigenvalues[*j] < NULL);
    let unseen = orthonormal(null.map(|j| Vector3::from_fn(|k, _| eigen.eigenvectors[(3 + k, j)])).collect());
    let seen = orthonormal(
        [Vector3::x(), Vector3::y(), Vector3::z()]
            .into_iter()
            .map(|axis| unseen.iter().fold(axis, |left, u| left - u * u.dot(&axis)))
            .collect(),
    );
    let basis = DMatrix::from_fn(3, seen.len(), |k, j| seen[j][k]);
    let columns = DMatrix::from_fn(rows, 3 + seen.len(), |r, c| {
        if c < 3 { design[(r, c)] } else { (0..3).map(|k| design[(r, 3 + k)] * basis[(k, c - 3)]).sum() }
    });
    let names = (0..columns.ncols()).map(|c| format!("{} {c}", family.facility_name())).collect();
    let design = linear::Design::new(names, columns)?;
    let solution = linear::solve(&design, &DMatrix::from_column_slice(rows, 1, rhs.as_slice()), None, &Limits::default())?;
    let found: Vec<f64> = solution.coefficients.iter().copied().collect();
    let residual_std = solution.residual_std[0];
    let all = &solution.unscaled_covariance * residual_std.powi(2);
    let own = all.view((3, 3), (seen.len(), seen.len())).into_owned();
    let covariance = &basis * own * basis.transpose();
    Ok(Solved {
        sensor: std::array::from_fn(|i| found[i]),
        facility: std::array::from_fn(|k| (0..seen.len()).map(|j| basis[(k, j)] * found[3 + j]).sum()),
        sensor_std: std::array::from_fn(|i| all[(i, i)].sqrt()),
        covariance: Matrix3::from_fn(|r, c| covariance[(r, c)]),
        residual_std,
        dof: solution.dof,
        unseen,
    })
}

/// An orthonormal basis of what some vectors span, the longest first.
fn orthonormal(mut vectors: Vec<Vector3<f64>>) -> Vec<Vector3<f64>> {
    let mut basis: Vec<Vector3<f64>> = Vec::new();
    while let Some(longest) = (0..vectors.len()).max_by(|a, b| vectors[*a].norm().total_cmp(&vectors[*b].norm())) {
        let next = vectors.swap_remove(longest);
        if next.norm() < 1e-6 {
            break;
        }
        let next = next.normalize();
        vectors.iter_mut().for_each(|v| *v -= next * next.dot(v));
        basis.push(next);
    }
    basis
}

/// What the runs of one orientation gave.
#[derive(Clone, Debug)]
struct Oriented {
    position: Position,
    /// Rotation of the real against the nominal orientation, where the runs tell it.
    rho: Option<Matrix3<f64>>,
    values: SensorValues,
}

/// What the values of an orientation have beyond the first order, additive, by [`Class::ALL`].
type Beyond = [[f64; 3]; 3];

impl Oriented {
    fn of(position: Position, runs: &[&OrientedRun]) -> Self {
        let known: Vec<Matrix3<f64>> = runs.iter().filter_map(|run| run.rho).collect();
        // The rotation nearest to the mean; axes that are exchanged or reversed are none.
        let svd = known.iter().sum::<Matrix3<f64>>().svd(true, true);
        let nearest = svd.u.zip(svd.v_t).map(|(u, v_t)| u * v_t);
        let rho = nearest.filter(|rho| !known.is_empty() && rho.determinant() > 0.0);
        Self { position, rho, values: mean_values(runs) }
    }

    /// What a sensor and a facility of these parameters give in this orientation, beyond the first order: `B_c = G B_stated + d` with
    /// `G = C S (C S)_stated⁻¹`, `d = o - G o_stated`, so that runs evaluated with the stated facility give `Φ_stated = G⁻¹ Φ` and
    /// `B_or,stated = B_or + Φ⁻¹ d`. Zero where the rotation is not known; `None` where no axes have such angles.
    fn beyond_first_order(&self, solved: &[Solved; 3], stated: &FacilityParameters) -> Option<Beyond> {
        let Some(seen_rho) = self.rho else { return Some(Beyond::default()) };
        let [scale, offset, angle] = solved;
        let (after, _) = corrected_facility(stated, solved);
        let coils = |facility: &FacilityParameters| {
            Some(facility.coil().axes()? * Matrix3::from_diagonal(&Vector3::from(facility.scale_nt_per_eu)))
        };
        let moved = coils(&after)? * coils(stated)?.try_inverse()?;
        let added_nt = Vector3::from(after.offset_nt) - moved * Vector3::from(stated.offset_nt);
        let back = moved.try_inverse()?;
        let (r_nom, sigma) = (self.position.r_nom(), scale.sensor.map(f64::exp));
        // The rotation that the runs show is one against the stated axes of the coils.
        let mut rho = seen_rho;
        let mut phi = compose(&r_nom, &rho, angle.sensor, sigma).ok()?;
        for _ in 0..ROTATIONS {
            let shown = split(&(back * phi), &r_nom).ok()?;
            rho = seen_rho * shown.rho.transpose() * rho;
            phi = compose(&r_nom, &rho, angle.sensor, sigma).ok()?;
        }
        let shown = split(&(back * phi), &r_nom).ok()?;
        let seen_ent = phi.try_inverse()? * added_nt;
        let exact = [
            shown.sigma.map(f64::ln),
            std::array::from_fn(|i| shown.sigma[i] * (offset.sensor[i] / sigma[i] + seen_ent[i])),
            shown.xi_deg,
        ];
        let first =
            |family: usize, i: usize| solved[family].sensor[i] + solved[family].seen(Class::ALL[family], &self.position, i);
        Some(std::array::from_fn(|family| std::array::from_fn(|i| exact[family][i] - first(family, i))))
    }
}

impl Solved {
    /// What a parameter of the sensor sees of the facility, to first order.
    fn seen(&self, family: Class, position: &Position, i: usize) -> f64 {
        let (k, factor) = family.sees(position, i);
        factor * self.facility[k]
    }
}

/// All three families, without what the values have beyond the first order.
fn solve_all(orientations: &[Oriented], stated: &FacilityParameters) -> Result<[Solved; 3], FitError> {
    let families = |beyond: &[Beyond]| -> Result<[Solved; 3], FitError> {
        let family = |index: usize| {
            let own = orientations.iter().zip(beyond).map(|(own, beyond)| {
                let values = additive(Class::ALL[index], &own.values);
                (own.position, std::array::from_fn(|i| values[i] - beyond[index][i]))
            });
            solve(Class::ALL[index], &own.collect::<Vec<_>>())
        };
        Ok([family(0)?, family(1)?, family(2)?])
    };
    let mut solved = families(&vec![Beyond::default(); orientations.len()])?;
    let mut before = vec![Beyond::default(); orientations.len()];
    // Without an end the values are of no mounting that is near its nominal orientation.
    let endless = || FitError::NotSettled { what: "products of mounting and facility", iterations: ROUNDS };
    for _ in 0..ROUNDS {
        let beyond: Option<Vec<Beyond>> = orientations.iter().map(|own| own.beyond_first_order(&solved, stated)).collect();
        let beyond = beyond.ok_or_else(endless)?;
        solved = families(&beyond)?;
        let stands = |family: usize| {
            let change = |(a, b): (&Beyond, &Beyond)| (0..3).map(|i| (a[family][i] - b[family][i]).abs()).fold(0.0, f64::max);
            beyond.iter().zip(&before).map(change).all(|change| change < ROUNDING[family])
        };
        if (0..ROUNDING.len()).all(stands) {
            return Ok(solved);
        }
        before = beyond;
    }
    Err(endless())
}

/// The orientation that does not agree with the others, if there is one.
fn odd_one_out(orientations: &[Oriented], stated: &FacilityParameters) -> Result<Option<usize>, FitError> {
    if orientations.len() <= LEAST_LEFT {
        return Ok(None);
    }
    let all = solve_all(orientations, stated)?;
    if all.iter().zip(ROUNDING).any(|(solved, rounding)| solved.residual_std.is_nan() || solved.residual_std < rounding) {
        return Ok(None);
    }
    let mut best: Option<(usize, f64)> = None;
    for out in 0..orientations.len() {
        let others: Vec<Oriented> = orientations.iter().enumerate().filter(|(i, _)| *i != out).map(|(_, o)| o.clone()).collect();
        let Ok(left) = solve_all(&others, stated) else { continue };
        let comparable = left.iter().zip(&all).all(|(l, a)| l.dof > 0 && l.dof < a.dof && l.unseen.len() == a.unseen.len());
        if !comparable {
            continue;
        }
        // Fisher's test of each family, and his combination of the three; the most unlikely of all orientations is looked at.
        let by_chance = left.iter().zip(&all).map(|(left, all)| {
            let (gained, rest) = ((all.dof - left.dof) as f64, left.dof as f64);
            let [with, without] = [all, left].map(|solved| solved.residual_std.powi(2) * solved.dof as f64);
            fisher_tail((with - without) / gained / (without / rest), [gained, rest])
        });
        let together = chi2_tail(-2.0 * by_chance.map(f64::ln).sum::<f64>(), 2.0 * all.len() as f64);
        let probability = together * orientations.len() as f64;
        if probability < UNLIKELY && best.is_none_or(|(_, least)| probability < least) {
            best = Some((out, probability));
        }
    }
    Ok(best.map(|(out, _)| out))
}

fn mean_values(runs: &[&OrientedRun]) -> SensorValues {
    let of = |get: fn(&OrientedRun) -> [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|i| runs.iter().map(|r| get(r)[i]).sum::<f64>() / runs.len() as f64)
    };
    SensorValues { scale: of(|r| r.sigma), offset_nt: of(|r| r.offset_nt), angles_deg: of(|r| r.xi_deg) }
}

/// Root mean square deviation of some orientations from their mean.
fn spread(values: &[SensorValues]) -> SensorValues {
    let of = |get: fn(&SensorValues) -> [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|i| {
            let mean = values.iter().map(|v| get(v)[i]).sum::<f64>() / values.len() as f64;
            (values.iter().map(|v| (get(v)[i] - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
        })
    };
    SensorValues { scale: of(|v| v.scale), offset_nt: of(|v| v.offset_nt), angles_deg: of(|v| v.angles_deg) }
}

/// The runs of the sensor that is asked for, or of the only one with several orientations.
fn runs_of_sensor<'a>(
    runs: &'a [OrientedRun],
    options: &Options,
    notes: &mut Vec<Note>,
) -> Result<Vec<&'a OrientedRun>, CoilError> {
    let mut sensors: Vec<&str> = Vec::new();
    for run in runs {
        if !sensors.contains(&run.sensor.as_str()) {
            sensors.push(&run.sensor);
        }
    }
    let count = |sensor: &str| {
        let mut positions: Vec<Position> = Vec::new();
        for run in runs.iter().filter(|r| r.sensor == sensor) {
            if !positions.contains(&run.position) {
                positions.push(run.position);
            }
        }
        positions.len()
    };
    let chosen = match &options.sensor {
        Some(sensor) if sensors.contains(&sensor.as_str()) => sensor.as_str(),
        Some(sensor) => return Err(CoilError::NoSensor(sensor.clone())),
        None => match sensors.iter().filter(|s| count(s) > 1).copied().collect::<Vec<_>>().as_slice() {
            [] => return Err(CoilError::Orientations(sensors.iter().map(|s| count(s)).max().unwrap_or_default())),
            [only] => only,
            several => return Err(CoilError::Sensors(several.join(", "))),
        },
    };
    if count(chosen) < 2 {
        return Err(CoilError::Orientations(count(chosen)));
    }
    let others: Vec<&str> = runs.iter().filter(|r| r.sensor != chosen).map(|r| r.run.as_str()).collect();
    if !others.is_empty() {
        notes.push(Note::new(NoteKind::LeftOut, format!("of another sensor than {chosen} and not used: {}", others.join(", "))));
    }
    let own: Vec<&OrientedRun> = runs.iter().filter(|r| r.sensor == chosen).collect();
    let modes: BTreeSet<&str> = own.iter().filter_map(|r| r.mode.as_deref()).collect();
    if modes.len() > 1 {
        let modes = modes.into_iter().collect::<Vec<_>>().join(", ");
        return Err(CoilError::Modes { sensor: chosen.to_owned(), modes });
    }
    Ok(own)
}

/// The runs of one orientation.
type Group<'a> = (Position, Vec<&'a OrientedRun>);

/// Tells sensor and facility apart; `facility` is the one that the runs were evaluated with, `stated` the covariance of its values, if it
/// has one. What the orientations do not see keeps the uncertainty that it had.
///
/// # Errors
/// [`CoilError`]: fewer than two orientations, or several sensors.
pub fn tilt(
    runs: &[OrientedRun],
    facility: &FacilityParameters,
    stated: Option<&Covariance>,
    options: &Options,
) -> Result<Tilt, CoilError> {
    let mut notes = Vec::new();
    let groups = by_orientation(each_once(runs_of_sensor(runs, options, &mut notes)?, &mut notes));
    // The runs of an orientation share place, mounting and state of the facility, so every orientation counts once.
    let all: Vec<Oriented> = groups.iter().map(|(position, members)| Oriented::of(*position, members)).collect();
    let said = notes.len();
    let is_used = agreeing(&all, facility, options, &mut notes)?;
    // Of one that does not agree and is used all the same it is known.
    let is_told = options.keep_all && notes.len() > said;
    let own: Vec<Oriented> = all.iter().zip(&is_used).filter(|(_, used)| **used).map(|(o, _)| o.clone()).collect();
    let mut solved = solve_all(&own, facility)?;
    if !is_told {
        notes.extend(far_apart(&own, &solved[1], within_nt(&groups), facility));
    }
    for (family, solved) in Class::ALL.into_iter().zip(&mut solved) {
        let kept: Matrix3<f64> = solved.unseen.iter().map(|u| u * u.transpose()).sum();
        solved.covariance += kept * additive_covariance(family, facility, stated) * kept;
    }
    if solved.iter().any(|s| s.dof == 0) {
        notes.push(Note::new(NoteKind::Method, "there are as many values as parameters: nothing tells the uncertainties"));
    }

    let orientation: Vec<TiltOrientation> = groups
        .iter()
        .zip(&all)
        .zip(&is_used)
        .map(|(((position, members), own), used)| TiltOrientation {
            axes: position.orientation(),
            runs: members.iter().map(|r| r.run.clone()).collect(),
            used: *used,
            before: own.values,
            after: corrected(own, &solved, facility),
        })
        .collect();
    let used: Vec<&TiltOrientation> = orientation.iter().filter(|o| o.used).collect();
    let [scale, offset, angle] = &solved;
    let (after, std) = corrected_facility(facility, &solved);
    let sigma = scale.sensor.map(f64::exp);
    let found = TiltFound {
        sensor: groups.first().and_then(|(_, members)| members.first()).map_or_else(String::new, |r| r.sensor.clone()),
        used: used.iter().flat_map(|o| o.runs.iter().cloned()).collect(),
        covariance: covariance(&solved, after.scale_nt_per_eu, stated),
        facility: after,
        std,
        facility_before: facility.clone(),
        correction: SensorValues { scale: scale.facility, offset_nt: offset.facility, angles_deg: angle.facility },
        sensor_parameters: SensorValues { scale: sigma, offset_nt: offset.sensor, angles_deg: angle.sensor },
        sensor_std: SensorValues {
            scale: std::array::from_fn(|i| sigma[i] * scale.sensor_std[i]),
            offset_nt: offset.sensor_std,
            angles_deg: angle.sensor_std,
        },
        undetermined: Class::ALL.into_iter().zip(&solved).flat_map(|(f, s)| s.unseen.iter().map(move |u| name(f, u))).collect(),
        spread_before: spread(&used.iter().map(|o| o.before).collect::<Vec<_>>()),
        spread_after: spread(&used.iter().map(|o| o.after).collect::<Vec<_>>()),
        residual_std: [scale.residual_std, offset.residual_std, angle.residual_std],
        degrees_of_freedom: [scale.dof, offset.dof, angle.dof],
        orientation,
    };
    Ok(Tilt { found, notes })
}

/// The runs without those that stand a second time in what was named, which would count twice.
fn each_once<'a>(runs: Vec<&'a OrientedRun>, notes: &mut Vec<Note>) -> Vec<&'a OrientedRun> {
    let mut kept: Vec<&OrientedRun> = Vec::with_capacity(runs.len());
    for run in runs {
        let text = match kept.iter().copied().find(|earlier| earlier.run == run.run) {
            Some(earlier) if earlier == run => format!("run {} stands twice and was counted once", run.run),
            Some(_) => {
                kept.push(run);
                format!("run {} stands twice, with other values: both were counted", run.run)
            }
            None => {
                kept.push(run);
                continue;
            }
        };
        notes.push(Note::new(NoteKind::Data, text).about(&run.run).with_remedy("take one of the two away, or correct its name"));
    }
    kept
}

/// How far the offsets of the runs of an orientation usually are from each other, nT; `None` where no orientation has several.
fn within_nt(groups: &[Group]) -> Option<f64> {
    let std = |runs: &[&OrientedRun], i: usize| {
        let mean = runs.iter().map(|run| run.offset_nt[i]).sum::<f64>() / runs.len() as f64;
        (runs.iter().map(|run| (run.offset_nt[i] - mean).powi(2)).sum::<f64>() / (runs.len() - 1) as f64).sqrt()
    };
    let several = groups.iter().filter(|(_, runs)| runs.len() > 1);
    // The median, since one run that was measured in another field does not make the others worse.
    let mut all: Vec<f64> = several.flat_map(|(_, runs)| (0..3).map(move |i| std(runs, i))).collect();
    (!all.is_empty()).then(|| median(&mut all))
}

/// The same coil axes with the other signs that a sensor can have along them.
fn other_signs(position: &Position) -> Vec<Position> {
    let own = position.orientation();
    let names: Vec<&str> = own.split(' ').collect();
    let turned = |name: &str| match name.strip_prefix('-') {
        Some(axis) => format!("+{axis}"),
        None => format!("-{}", name.trim_start_matches('+')),
    };
    let of = |(a, b): &(usize, usize)| {
        let parts = names.iter().enumerate().map(|(k, name)| if k == *a || k == *b { turned(name) } else { (*name).to_owned() });
        Position::from_orientation(&parts.collect::<Vec<_>>().join(" ")).ok()
    };
    PAIRS.iter().filter_map(of).collect()
}

/// Says of offsets that are far from those of one sensor and one facility which orientation makes the difference.
fn far_apart(own: &[Oriented], offset: &Solved, within_nt: Option<f64>, stated: &FacilityParameters) -> Option<Note> {
    let within_nt = within_nt?;
    let far_nt = offset.residual_std;
    if offset.dof == 0 || far_nt.is_nan() || far_nt < LEAST_FAR_NT.max(FAR * within_nt) {
        return None;
    }
    let left_nt = |orientations: &[Oriented]| {
        let [_, left, _] = solve_all(orientations, stated).ok()?;
        (left.dof > 0 && left.unseen.len() == offset.unseen.len()).then_some(left.residual_std)
    };
    let name = |index: usize| own[index].position.orientation();
    let without = (0..own.len()).filter_map(|out| {
        let others: Vec<Oriented> = own.iter().enumerate().filter(|(i, _)| *i != out).map(|(_, o)| o.clone()).collect();
        Some((left_nt(&others)?, format!("without {}", name(out))))
    });
    let otherwise =
        (0..own.len()).flat_map(|index| other_signs(&own[index].position).into_iter().map(move |position| (index, position)));
    let otherwise = otherwise.filter_map(|(index, position)| {
        let mut all = own.to_vec();
        // The rotation that runs show is one against the orientation that they state.
        all[index] = Oriented { position, rho: None, values: own[index].values };
        Some((left_nt(&all)?, format!("with {} in place of {}", position.orientation(), name(index))))
    });
    let least = |all: Vec<(f64, String)>| all.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(nt, _)| *nt < far_nt);
    let best: Vec<String> = [least(without.collect()), least(otherwise.collect())]
        .into_iter()
        .flatten()
        .map(|(nt, words)| format!("{nt:.2} nT {words}"))
        .collect();
    let best = if best.is_empty() { String::new() } else { format!("; it is {}", best.join(", and ")) };
    let text = format!(
        "the offsets of the orientations scatter by {far_nt:.2} nT about those of one sensor and one facility, and by {within_nt:.2} nT within an \
         orientation{best}"
    );
    let remedy = "check the signs of every orientation; a facility that changed between them looks the same";
    Some(Note::new(NoteKind::Fit, text).with_remedy(remedy))
}

/// The runs of every orientation, in the order of their first runs.
fn by_orientation(runs: Vec<&OrientedRun>) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for run in runs {
        match groups.iter_mut().find(|(position, _)| *position == run.position) {
            Some((_, members)) => members.push(run),
            None => groups.push((run.position, vec![run])),
        }
    }
    groups
}

/// Which orientations are used: those that do not agree with the others are left out one after the other, unless all are wanted.
fn agreeing(
    all: &[Oriented],
    stated: &FacilityParameters,
    options: &Options,
    notes: &mut Vec<Note>,
) -> Result<Vec<bool>, FitError> {
    let mut is_used = vec![true; all.len()];
    loop {
        let kept: Vec<usize> = (0..all.len()).filter(|g| is_used[*g]).collect();
        let own: Vec<Oriented> = kept.iter().map(|g| all[*g].clone()).collect();
        let Some(out) = odd_one_out(&own, stated)? else { return Ok(is_used) };
        let orientation = own[out].position.orientation();
        if options.keep_all {
            let text = format!("orientation {orientation} does not agree with the others");
            notes.push(Note::new(NoteKind::Fit, text));
            return Ok(is_used);
        }
        is_used[kept[out]] = false;
        let text = format!(
            "orientation {orientation} does not agree with the others and was left out; the facility may have changed between \
             (--keep-all uses it)"
        );
        notes.push(Note::new(NoteKind::Fit, text));
    }
}

/// What the runs of an orientation would have given with the corrected facility.
fn corrected(own: &Oriented, solved: &[Solved; 3], stated: &FacilityParameters) -> SensorValues {
    let beyond = own.beyond_first_order(solved, stated).unwrap_or_default();
    let of = |family: usize, i: usize| solved[family].seen(Class::ALL[family], &own.position, i) + beyond[family][i];
    let values = &own.values;
    SensorValues {
        scale: std::array::from_fn(|i| values.scale[i] * (-of(0, i)).exp()),
        offset_nt: std::array::from_fn(|i| values.offset_nt[i] - of(1, i)),
        angles_deg: std::array::from_fn(|i| values.angles_deg[i] - of(2, i)),
    }
}

/// The facility with its corrections, and its standard uncertainties.
fn corrected_facility(
    before: &FacilityParameters,
    [scale, offset, angle]: &[Solved; 3],
) -> (FacilityParameters, FacilityParameters) {
    let add = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| a[i] + b[i]) };
    let scaled: [f64; 3] = std::array::from_fn(|k| before.scale_nt_per_eu[k] * scale.facility[k].exp());
    let root = |s: &Solved| -> [f64; 3] { std::array::from_fn(|k| std_of(s.covariance[(k, k)])) };
    let after = FacilityParameters {
        scale_nt_per_eu: scaled,
        offset_nt: add(before.offset_nt, offset.facility),
        angles_deg: add(before.angles_deg, angle.facility),
        ..before.clone()
    };
    let std = FacilityParameters::constant(std::array::from_fn(|k| scaled[k] * root(scale)[k]), root(offset), root(angle));
    (after, std)
}

/// A combination that the orientations do not see, for people.
fn name(family: Class, direction: &Vector3<f64>) -> String {
    let names = if matches!(family, Class::Angle) { ANGLES } else { AXES };
    let what = family.facility_name();
    let first = direction[0];
    if matches!(family, Class::Scale) && direction.iter().all(|v| (v - first).abs() < 1e-9) {
        return "the common scale factor of coil system and sensor".to_owned();
    }
    let parts: Vec<String> =
        (0..3).filter(|k| direction[*k].abs() > 1e-9).map(|k| format!("{:+.2} {}", direction[k], names[k])).collect();
    format!("{what}s of the coil system against those of the sensor: {}", parts.join(" "))
}

/// Names of the three values of a family in the covariance of a facility.
fn names_of(family: Class) -> [String; 3] {
    let (key, axes) = match family {
        Class::Scale => ("scale", AXES),
        Class::Offset => ("offset", AXES),
        Class::Angle => ("angle", ANGLES),
    };
    axes.map(|axis| format!("{key}_{}", axis.to_lowercase()))
}

/// The covariance that a facility states for a family, of what acts by addition: of the logarithms of scale factors, see [`additive`]. Zero
/// for what it does not state.
fn additive_covariance(family: Class, facility: &FacilityParameters, stated: Option<&Covariance>) -> Matrix3<f64> {
    let Some(stated) = stated else { return Matrix3::zeros() };
    let at = names_of(family).map(|name| stated.parameters.iter().position(|p| *p == name));
    let unit = |k: usize| if matches!(family, Class::Scale) { facility.scale_nt_per_eu[k] } else { 1.0 };
    Matrix3::from_fn(|r, c| match (at[r], at[c]) {
        (Some(i), Some(j)) => stated.matrix[i][j] / (unit(r) * unit(c)),
        _ => 0.0,
    })
}

/// The covariance of the corrected facility; its temperature coefficients, which are kept, keep that of the facility before.
fn covariance(solved: &[Solved; 3], scale: [f64; 3], before: Option<&Covariance>) -> Covariance {
    let mut parameters = Class::ALL.map(names_of).concat();
    let mut units: Vec<String> =
        ["nT/EU", "nT", "deg"].into_iter().flat_map(|u| [u.to_owned(), u.to_owned(), u.to_owned()]).collect();
    let constants = parameters.len();
    let mut kept = Vec::new();
    for (index, name) in before.iter().flat_map(|b| b.parameters.iter().enumerate()) {
        if !parameters[..constants].contains(name) {
            kept.push(index);
            parameters.push(name.clone());
            units.push(before.and_then(|b| b.units.get(index)).cloned().unwrap_or_default());
        }
    }
    let factor = |family: usize, k: usize| if family == 0 { scale[k] } else { 1.0 };
    let entry = |r: usize, c: usize| {
        let family = r / 3;
        match (r.checked_sub(constants), c.checked_sub(constants)) {
            (None, None) if family == c / 3 => {
                solved[family].covariance[(r % 3, c % 3)] * factor(family, r % 3) * factor(family, c % 3)
            }
            (Some(i), Some(j)) => before.map_or(0.0, |b| b.matrix[kept[i]][kept[j]]),
            _ => 0.0,
        }
    };
    let size = parameters.len();
    Covariance { parameters, units, matrix: (0..size).map(|r| (0..size).map(|c| entry(r, c)).collect()).collect() }
}

#[cfg(test)]
mod tests;
