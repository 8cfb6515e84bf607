//! Results of one campaign against each other (docs/mathematics.md, "Comparing calibrations"): where two results of one quantity differ by far more than
//! their uncertainties let expect, one of them has other readings, fields, positions or temperatures than it says.
//!
//! * sensitivities and angles as polynomials of the temperature, from groups of runs and from sweeps, where their ranges overlap
//! * sensitivities and angles of linearity runs at one temperature that are in no group together
//! * offset and residual field of a linearity run, against those of an offset run and against the mean of a zero-field run

use super::coil::AXES;
use super::sweep::Sweep;
use super::thermal::{QuantityFit, Thermal};
use crate::data::across::{CalibratedRun, CommonChange, RunValues};
use crate::data::note::{Note, NoteKind};
use crate::data::result::{Rows, RunHead};
use crate::data::run::Location;
use crate::data::units::{COMPONENTS, counted, six_digits};
use crate::data::zero_field::ZeroFieldFound;
use crate::model::campaign::{LARGEST_SIGMA_PER_K, LARGEST_XI_DEG_PER_K};
use crate::model::polynomial;
use crate::model::position::Position;

/// Standard uncertainties of a difference beyond which it is told: `E_n` = 2.5.
const CLEAR: f64 = 5.0;
/// Temperatures of linearity runs that differ by no more, K, are compared with room for the largest slopes that are published.
const NEAR_K: f64 = 1.0;
/// Offsets are compared at one temperature, K, where no polynomials take them from one to the other.
const SAME_K: f64 = 0.2;
/// By so much, enT, the residual field of a coil system and the offset of a sensor may differ from run to run.
const MOVES_ENT: f64 = 0.5;
/// Axes whose directions no file tells are not turned by more, radians.
const TURNED: f64 = 0.05;
/// Sensitivities and angles by name.
const QUANTITIES: [[&str; 3]; 2] = [["sigma_x", "sigma_y", "sigma_z"], ["xi_xy", "xi_xz", "xi_yz"]];
/// Their units.
const UNITS: [&str; 2] = ["nT/enT", "deg"];

/// A zero-field run with the orientation of the sensor in it.
pub struct ZeroField<'a> {
    /// What it gave.
    pub found: &'a ZeroFieldFound,
    /// How the sensor stood; absent where the run does not tell.
    pub position: Option<Position>,
}

/// The results of a campaign.
pub struct Results<'a> {
    /// Of single runs.
    pub points: &'a [CalibratedRun],
    /// Across temperatures.
    pub groups: Vec<&'a Thermal>,
    /// Of sweeps.
    pub sweeps: Vec<&'a Sweep>,
    /// Of zero-field runs.
    pub zero_fields: Vec<ZeroField<'a>>,
}

/// Sensor, mode and place, for which one calibration holds.
type Key<'a> = (&'a str, &'a str, Location);

/// A value and its standard uncertainty.
type Value = (f64, f64);

/// By how much two results of one quantity differ.
struct Difference {
    quantity: String,
    unit: &'static str,
    by: f64,
    std: f64,
}

impl Difference {
    /// `None` where a value or an uncertainty is not known.
    fn of(quantity: impl Into<String>, unit: &'static str, [a, b]: [Value; 2]) -> Option<Self> {
        let (by, std) = (a.0 - b.0, a.1.hypot(b.1));
        (by.is_finite() && std > 0.0).then(|| Self { quantity: quantity.into(), unit, by, std })
    }

    fn times(&self) -> f64 {
        self.by.abs() / self.std
    }

    /// The clearest of several, if any is clear.
    fn clearest(all: impl Iterator<Item = Self>) -> Option<Self> {
        all.filter(|d| d.times() > CLEAR).max_by(|a, b| a.times().total_cmp(&b.times()))
    }

    fn note(&self, [a, b]: [&str; 2], remedy: &str) -> Note {
        let Self { quantity, unit, by, std } = self;
        let size = if by.abs() < 0.01 { format!("{by:.1e}") } else { six_digits(*by) };
        let text = format!(
            "{quantity} of {a} and of {b} differ by {size} {unit}, {:.0} standard uncertainties of the difference",
            (by / std).abs()
        );
        Note::new(NoteKind::Mismatch, text).about(a).with_remedy(remedy)
    }
}

/// What contradicts itself, the clearest difference of each kind.
#[must_use]
pub fn contradictions(all: &Results) -> Vec<Note> {
    let curves: Vec<Curves> =
        all.groups.iter().filter_map(|g| Curves::of_group(g)).chain(all.sweeps.iter().map(|s| Curves::of_sweep(s))).collect();
    let mut notes = spelled_otherwise(all.points);
    notes.extend(between_curves(&curves));
    let runs: Vec<Linear> = all.points.iter().filter_map(Linear::of).collect();
    notes.extend(between_runs(&runs, &all.groups));
    notes.extend(of_offsets(all, &runs, &curves));
    notes
}

/// Names of sensors, or of modes of a sensor, that differ by nothing but capitals, blanks and marks: their runs are in groups of their own.
fn spelled_otherwise(points: &[CalibratedRun]) -> Vec<Note> {
    let plain = |name: &str| -> String { name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect() };
    let mut names: Vec<(&str, &str)> = points.iter().map(|p| (p.run.sensor.as_str(), p.run.mode.as_str())).collect();
    names.sort_unstable();
    names.dedup();
    let mut notes = Vec::new();
    for (k, (sensor, mode)) in names.iter().enumerate() {
        for (other, its) in &names[k + 1..] {
            if plain(sensor) == plain(other) && plain(mode) == plain(its) {
                let text = format!(
                    "runs of `{sensor}` in mode `{mode}` and of `{other}` in mode `{its}` are taken as of two, whose names are nearly equal"
                );
                let remedy = "write the names in one way in the heads of the runs if they are of one";
                notes.push(Note::new(NoteKind::Mismatch, text).about(*sensor).with_remedy(remedy));
            }
        }
    }
    notes
}

/// Polynomials of one sensor.
struct Curves<'a> {
    name: String,
    key: Key<'a>,
    quantities: &'a [QuantityFit],
}

impl<'a> Curves<'a> {
    /// Nothing where the group is none of linearity runs.
    fn of_group(group: &'a Thermal) -> Option<Self> {
        let runs = &group.runs;
        let is_linear = group.quantities.iter().any(|q| q.found.name == QUANTITIES[0][0]);
        is_linear.then(|| Self {
            name: format!("the runs {} to {}", runs.ids.first().map_or("", |id| id), runs.ids.last().map_or("", |id| id)),
            key: (&runs.sensor, &runs.mode, runs.location),
            quantities: &group.quantities,
        })
    }

    fn of_sweep(sweep: &'a Sweep) -> Self {
        Self {
            name: format!("the sweep {}", sweep.run.id),
            key: (&sweep.run.sensor, &sweep.run.mode, sweep.run.location),
            quantities: &sweep.quantities,
        }
    }

    fn quantity(&self, name: &str) -> Option<&QuantityFit> {
        self.quantities.iter().find(|q| q.found.name == name)
    }

    /// Change of the offset with the residual field from one temperature to another, °C, where both are in range.
    fn offset_change(&self, component: usize, [from_degc, to_degc]: [f64; 2]) -> Option<f64> {
        let own = &self.quantity(&format!("b_or_{}", COMPONENTS[component]))?.polynomial;
        let is_inside = [from_degc, to_degc].into_iter().all(|degc| own.covers(degc));
        is_inside.then(|| own.evaluate(to_degc).0 - own.evaluate(from_degc).0)
    }
}

/// Value of a polynomial at a temperature, with its uncertainty of both types.
fn at(fit: &QuantityFit, degc: f64) -> Value {
    let (value, std) = fit.polynomial.evaluate(degc);
    let of_facility: f64 = fit.common.iter().flatten().map(|(_, change)| polynomial::value(change, degc).powi(2)).sum();
    (value, std.hypot(of_facility.sqrt()))
}

/// Two results that differ.
struct Pair<'a> {
    names: [&'a str; 2],
    key: Key<'a>,
    /// Whether the sensor stood in two orientations.
    is_turned: bool,
    difference: Difference,
}

/// Where a sensor stood in two orientations.
const TURNED_REMEDY: &str = "the sensor stood in two orientations: scale factors and angles of the coil system look like those of the sensor, name its facility \
                             file with --facility; otherwise one of them has other fields or readings than it says";

/// The clearest of the pairs of every sensor, mode and place in one orientation, and of those in two.
fn clearest_of_each(mut pairs: Vec<Pair>, remedy: &str) -> Vec<Note> {
    let mut notes = Vec::new();
    while let Some(first) = pairs.first() {
        let (key, is_turned) = (first.key, first.is_turned);
        let (own, others): (Vec<Pair>, Vec<Pair>) = pairs.into_iter().partition(|p| p.key == key && p.is_turned == is_turned);
        pairs = others;
        let more = own.len() - 1;
        let Some(most) = own.into_iter().max_by(|a, b| a.difference.times().total_cmp(&b.difference.times())) else { continue };
        let mut note = most.difference.note(most.names, if is_turned { TURNED_REMEDY } else { remedy });
        if more > 0 {
            note.text.push_str(&format!("; {} of them differ as clearly", counted(more as u64, "other pair")));
        }
        notes.push(note);
    }
    notes
}

fn between_curves(curves: &[Curves]) -> Vec<Note> {
    let mut pairs = Vec::new();
    for (k, a) in curves.iter().enumerate() {
        for b in curves[k + 1..].iter().filter(|b| b.key == a.key) {
            let each = QUANTITIES.iter().zip(UNITS).flat_map(|(names, unit)| names.iter().map(move |name| (*name, unit)));
            let differences = each.flat_map(|(name, unit)| {
                let both = a.quantity(name).zip(b.quantity(name));
                both.into_iter().flat_map(move |(a, b)| {
                    let [low, high] = [0, 1].map(|end| (a.polynomial.valid_degc[end], b.polynomial.valid_degc[end]));
                    let (low, high) = (low.0.max(low.1), high.0.min(high.1));
                    let steps = [low, 0.5 * (low + high), high].into_iter().filter(move |_| low <= high);
                    steps.filter_map(move |degc| {
                        let name = format!("{name} at {degc:.1} °C");
                        Difference::of(name, unit, [at(a, degc), at(b, degc)])
                    })
                })
            });
            if let Some(difference) = Difference::clearest(differences) {
                pairs.push(Pair { names: [&a.name, &b.name], key: a.key, is_turned: false, difference });
            }
        }
    }
    let remedy = "one of them has other fields, readings, temperatures or another thermistor than it says, or the sensor stood in two orientations without \
                  the facility file of the coil system; find out which before either is used";
    clearest_of_each(pairs, remedy)
}

/// A linearity run.
struct Linear<'a> {
    id: &'a str,
    file: &'a str,
    key: Key<'a>,
    degc: f64,
    /// σ, ξ and B_or in turn.
    values: [[Value; 3]; 3],
    r_nom: Option<&'a Rows>,
    /// By how much its axes are turned against the nominal ones, radians.
    turned: f64,
}

impl<'a> Linear<'a> {
    fn of(point: &'a CalibratedRun) -> Option<Self> {
        let RunValues::Lin { sigma, xi_deg, b_or_ent, std, common, r_nom, rotation_deg, .. } = &point.values else { return None };
        let turned_deg = rotation_deg.iter().map(|angle| angle.abs()).sum::<f64>();
        let of_facility = common.as_deref().map_or([[0.0; 3]; 3], CommonChange::std_of);
        let of = |which: usize, values: &[f64; 3]| {
            let own = std[which].unwrap_or([f64::NAN; 3]);
            [0, 1, 2].map(|i| (values[i], own[i].hypot(of_facility[which][i])))
        };
        Some(Self {
            id: &point.run.id,
            file: &point.file,
            key: key(point),
            degc: point.run.temperature_degc?,
            values: [of(0, sigma), of(1, xi_deg), of(2, b_or_ent)],
            r_nom: r_nom.as_deref(),
            turned: if turned_deg.is_finite() { turned_deg.to_radians() } else { TURNED },
        })
    }
}

fn key(point: &CalibratedRun) -> Key<'_> {
    (&point.run.sensor, &point.run.mode, point.run.location)
}

fn between_runs(runs: &[Linear], groups: &[&Thermal]) -> Vec<Note> {
    const LARGEST: [f64; 2] = [LARGEST_SIGMA_PER_K, LARGEST_XI_DEG_PER_K];
    let in_one_group = |a: &Linear, b: &Linear| {
        let holds = |group: &Thermal, run: &Linear| group.runs.files.iter().any(|file| file == run.file);
        groups.iter().any(|group| holds(group, a) && holds(group, b))
    };
    let mut pairs = Vec::new();
    for (k, a) in runs.iter().enumerate() {
        for b in runs[k + 1..].iter().filter(|b| b.key == a.key && !in_one_group(a, b)) {
            let apart_k = (a.degc - b.degc).abs();
            if apart_k > NEAR_K {
                continue;
            }
            let differences = (0..6).filter_map(|n| {
                let (which, i) = (n / 3, n % 3);
                let (value, std) = b.values[which][i];
                let other = (value, std.hypot(LARGEST[which] * apart_k));
                Difference::of(QUANTITIES[which][i], UNITS[which], [a.values[which][i], other])
            });
            if let Some(difference) = Difference::clearest(differences) {
                pairs.push(Pair { names: [a.id, b.id], key: a.key, is_turned: a.r_nom != b.r_nom, difference });
            }
        }
    }
    clearest_of_each(
        pairs,
        "the runs are of one sensor, mode and temperature: one of them has other fields or readings than it says",
    )
}

/// Offset with residual field as another run has it.
struct OffsetSum<'a> {
    id: &'a str,
    key: Key<'a>,
    /// Temperature, °C, and value, enT, of every component that is known.
    values: [Option<(f64, Value)>; 3],
    /// Coil axis along which every component sees the residual field, with its sign, and this field, enT; `None` where it is a part of the value that is not
    /// told apart: the linearity run has to have the same orientation then.
    seen: [(usize, f64, Option<f64>); 3],
    /// Modulus of the residual field, enT; zero where nothing is turned.
    residual_ent: f64,
}

fn of_offsets(all: &Results, runs: &[Linear], curves: &[Curves]) -> Vec<Note> {
    let others = all.points.iter().filter_map(of_offset_run).chain(all.zero_fields.iter().filter_map(of_zero_field));
    others.filter_map(|other| against_linear(&other, runs, curves, moves_ent(all.points, other.key))).collect()
}

/// By how much offset and residual field move from run to run, enT: as the residual fields of the offset runs of a sensor differ, and by [`MOVES_ENT`] at least.
fn moves_ent(points: &[CalibratedRun], of: Key) -> f64 {
    let residuals: Vec<[f64; 3]> = points
        .iter()
        .filter(|point| key(point) == of)
        .filter_map(|point| match &point.values {
            RunValues::Offset { residual_ent, .. } => Some(*residual_ent),
            _ => None,
        })
        .collect();
    let std = |i: usize| {
        let known: Vec<f64> = residuals.iter().map(|r| r[i]).filter(|r| r.is_finite()).collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        let squares: f64 = known.iter().map(|r| (r - mean).powi(2)).sum();
        if known.len() > 1 { (squares / (known.len() - 1) as f64).sqrt() } else { 0.0 }
    };
    (0..3).map(std).fold(MOVES_ENT, f64::max)
}

/// The nominal axis that a component of a linearity run has along a coil axis: its sign, or zero where it has another one.
fn sign_along(r_nom: &Rows, coil: usize, component: usize) -> f64 {
    let along = r_nom[coil][component];
    if along.abs() > 0.9 { along.signum() } else { 0.0 }
}

fn against_linear(other: &OffsetSum, runs: &[Linear], curves: &[Curves], moves_ent: f64) -> Option<Note> {
    let compared = runs.iter().filter(|run| run.key == other.key).filter_map(|run| {
        let r_nom = run.r_nom?;
        let mut apart_k = f64::INFINITY;
        let differences: Vec<Difference> = (0..3)
            .filter_map(|i| {
                let (degc, (value, std)) = other.values[i]?;
                let (coil, sign, residual_ent) = other.seen[i];
                // An axis that is turned a little sees a part of the residual field of the others, in its own way in every position.
                let std = std.hypot(run.turned * other.residual_ent).hypot(moves_ent);
                let turned = sign_along(r_nom, coil, i) * sign;
                let value = match residual_ent {
                    _ if turned == 1.0 => value,
                    Some(residual_ent) if turned == -1.0 => value - 2.0 * residual_ent,
                    _ => return None,
                };
                let own_change = curves.iter().filter(|c| c.key == run.key).find_map(|c| c.offset_change(i, [run.degc, degc]));
                let change = match own_change {
                    Some(change) => change,
                    None if (run.degc - degc).abs() <= SAME_K => 0.0,
                    None => return None,
                };
                apart_k = apart_k.min((run.degc - degc).abs());
                let (own, own_std) = run.values[2][i];
                let name = format!("offset with residual field of {} at {degc:.1} °C", COMPONENTS[i]);
                Difference::of(name, "enT", [(own + change, own_std), (value, std)])
            })
            .collect();
        (!differences.is_empty()).then_some((apart_k, run, differences))
    });
    // The run nearest in temperature.
    let (_, run, differences) = compared.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let remedy =
        "one of them has other readings or positions than it says, or the offset moved between them: repeat one of the two";
    Difference::clearest(differences.into_iter()).map(|d| d.note([run.id, other.id], remedy))
}

/// The coil axis of a name such as `-Y`, and its sign.
fn coil_axis(name: &str) -> Option<(usize, f64)> {
    let axis = AXES.iter().position(|axis| name.ends_with(axis))?;
    Some((axis, if name.starts_with('-') { -1.0 } else { 1.0 }))
}

fn of_offset_run(point: &CalibratedRun) -> Option<OffsetSum<'_>> {
    let RunValues::Offset { offset_ent, std, std_b, degc, residual_ent, residual_std, seen_along } = &point.values else {
        return None;
    };
    let own = point.run.temperature_degc?;
    let [x, y, z] = seen_along.as_slice() else { return None };
    let [x, y, z] = [coil_axis(x)?, coil_axis(y)?, coil_axis(z)?];
    let of_facility = std_b.unwrap_or([0.0; 3]);
    let values = [0, 1, 2].map(|i| {
        let std = (*std)?[i].hypot(of_facility[i]).hypot(residual_std[i]);
        Some((degc.map_or(own, |degc| degc[i]), (offset_ent[i] + residual_ent[i], std)))
    });
    let seen = [(0, x), (1, y), (2, z)].map(|(i, (axis, sign))| (axis, sign, Some(residual_ent[i])));
    let modulus_ent = residual_ent.iter().map(|r| r * r).sum::<f64>().sqrt();
    Some(OffsetSum { id: &point.run.id, key: key(point), values, seen, residual_ent: modulus_ent })
}

fn of_zero_field<'a>(zero: &ZeroField<'a>) -> Option<OffsetSum<'a>> {
    let RunHead { id, sensor, mode, location, temperature_degc, .. } = &zero.found.run;
    let (own, position) = ((*temperature_degc)?, zero.position.as_ref()?);
    let offset = &zero.found.offset;
    // What it moved by during the record it may have moved by before.
    let value = |i: usize| (offset.mean_ent[i], offset.mean_std_ent[i].hypot(offset.range_ent[i]));
    let seen = [0, 1, 2].map(|i| {
        let (axis, sign) = position.along(i);
        (axis, sign, None)
    });
    Some(OffsetSum {
        id,
        key: (sensor, mode, *location),
        values: [0, 1, 2].map(|i| Some((own, value(i)))),
        seen,
        residual_ent: 0.0,
    })
}
