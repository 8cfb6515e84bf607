//! The residual field of the facility from moduli at plus and minus F on one coil axis: half their difference (BC-MAG-TR-0085
//! section 1; docs/mathematics.md, "The coil system"). Fields across the axis act on both alike.

use super::{AXES, CoilError};
use crate::data::note::{Note, NoteKind};
use crate::data::result::Covariance;
use crate::data::run::{Run, ScalarRow};
use crate::data::tables::ModulusRow;
use crate::fit::statistics::extremes;
use crate::fit::student_factor;
use crate::model::facility::FacilityParameters;
use crate::model::facility_calibration::{AxisResidual, ResidualFound, ResidualState};

/// Other axes are at zero if their settings are below this share of that of the axis.
const ASIDE: f64 = 1e-6;
/// Plus and minus F belong together if they differ by less than this share.
const SAME: f64 = 1e-3;
/// A residual field above this part of the modulus is more likely two moduli that do not belong together.
const STRANGE: f64 = 0.05;
/// Moduli of one table are in one unit if the largest is no more times the smallest.
const ONE_UNIT: f64 = 50.0;
/// Decimals of a modulus that are looked at for its resolution.
const MOST_DECIMALS: i32 = 6;

/// Residual fields.
#[derive(Clone, Debug, PartialEq)]
pub struct Residual {
    /// What was found.
    pub found: ResidualFound,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// One pair of moduli, with the magnitudes of the settings.
#[derive(Clone, Debug)]
struct Pair {
    state: String,
    axis: usize,
    plus_nt: f64,
    minus_nt: f64,
    /// Magnitude of the positive setting minus that of the negative one, nT.
    setting_difference_nt: f64,
    std_nt: Option<f64>,
}

/// Residual fields from a table of moduli, which has the name `used`.
///
/// # Errors
/// No rows.
pub fn of_table(rows: &[ModulusRow], used: &str) -> Result<Residual, CoilError> {
    let pair = |r: &ModulusRow| Pair {
        state: r.state.clone(),
        axis: r.axis,
        plus_nt: r.plus_nt,
        minus_nt: r.minus_nt,
        setting_difference_nt: 0.0,
        std_nt: r.std_nt,
    };
    of_pairs(&rows.iter().map(pair).collect::<Vec<_>>(), vec![used.to_owned()])
}

/// Residual fields from the `@SCALAR` rows of some runs in time order; every run is a state of the facility.
///
/// # Errors
/// No row with a setting on one axis that has its opposite.
pub fn residual(runs: &[&Run]) -> Result<Residual, CoilError> {
    let mut pairs = Vec::new();
    let mut used = Vec::new();
    for run in runs {
        let found = pairs_of(&run.header.run, &run.scalar);
        if !found.is_empty() {
            used.push(run.header.run.clone());
        }
        pairs.extend(found);
    }
    of_pairs(&pairs, used)
}

/// Whether a run only checks the residual field: all its settings lie on one axis, which no scalar calibration can do with.
#[must_use]
pub fn is_check(run: &Run) -> bool {
    !run.scalar.is_empty() && run.scalar.iter().all(|row| axis_of(row.setting).is_some())
}

/// The axis along which a setting lies alone.
fn axis_of(setting: [f64; 3]) -> Option<usize> {
    let axis = (0..3).max_by(|a, b| setting[*a].abs().total_cmp(&setting[*b].abs()))?;
    let alone = (0..3).all(|k| k == axis || setting[k].abs() <= ASIDE * setting[axis].abs());
    (alone && setting[axis] != 0.0).then_some(axis)
}

/// Every positive setting on one axis alone with the first negative one of the same size that is not taken.
fn pairs_of(run: &str, rows: &[ScalarRow]) -> Vec<Pair> {
    let on_axis: Vec<(usize, f64, f64)> =
        rows.iter().filter_map(|row| axis_of(row.setting).map(|axis| (axis, row.setting[axis], row.modulus_nt))).collect();
    let mut taken = vec![false; on_axis.len()];
    let mut pairs = Vec::new();
    for (axis, plus, plus_nt) in on_axis.iter().filter(|(_, setting, _)| *setting > 0.0) {
        let opposite = on_axis
            .iter()
            .enumerate()
            .position(|(i, (a, minus, _))| !taken[i] && a == axis && *minus < 0.0 && (plus + minus).abs() <= SAME * plus);
        if let Some(i) = opposite {
            taken[i] = true;
            let (_, minus, minus_nt) = on_axis[i];
            pairs.push(Pair {
                state: run.to_owned(),
                axis: *axis,
                plus_nt: *plus_nt,
                minus_nt,
                // Settings are in the unit of the source; the pair itself shows how many nT one is.
                setting_difference_nt: (plus + minus) * (plus_nt + minus_nt) / (plus - minus),
                std_nt: None,
            });
        }
    }
    pairs
}

fn of_pairs(pairs: &[Pair], used: Vec<String>) -> Result<Residual, CoilError> {
    if pairs.is_empty() {
        return Err(CoilError::NoPairs);
    }
    let [least_nt, most_nt] = extremes(pairs.iter().flat_map(|pair| [pair.plus_nt, pair.minus_nt]));
    if most_nt > ONE_UNIT * least_nt {
        return Err(CoilError::Units { least_nt, most_nt });
    }
    let mut names: Vec<&str> = Vec::new();
    for pair in pairs {
        if !names.contains(&pair.state.as_str()) {
            names.push(&pair.state);
        }
    }
    let groups: Vec<[Vec<&Pair>; 3]> = names
        .iter()
        .map(|name| [0, 1, 2].map(|axis| pairs.iter().filter(|p| p.state == *name && p.axis == axis).collect()))
        .collect();
    let noise = Noise::of(&groups, resolution(pairs));
    let state: Vec<ResidualState> = names
        .iter()
        .zip(&groups)
        .map(|(name, groups)| ResidualState {
            name: (*name).to_owned(),
            axis: groups.iter().enumerate().filter_map(|(axis, pairs)| one(axis, pairs, &noise)).collect(),
        })
        .collect();
    let unseen = noise.unseen(pairs);
    let is_known = unseen.is_none();
    let mut notes: Vec<Note> = unseen.into_iter().chain(strange(pairs)).collect();
    let mut covariance = Covariance { parameters: Vec::new(), units: Vec::new(), matrix: Vec::new() };
    let mut facility = FacilityParameters::constant([1.0; 3], [0.0; 3], [90.0; 3]);
    let mut std = FacilityParameters::constant([f64::NAN; 3], [f64::NAN; 3], [f64::NAN; 3]);
    if let Some(last) = state.last() {
        for (k, name) in AXES.into_iter().enumerate() {
            match last.axis.iter().find(|a| a.axis == name) {
                Some(found) => {
                    facility.offset_nt[k] = found.residual_nt;
                    std.offset_nt[k] = found.std_nt;
                    covariance.parameters.push(format!("offset_{}", name.to_lowercase()));
                    covariance.units.push("nT".to_owned());
                }
                None => {
                    let text = format!(
                        "the {name} axis has no pair of moduli in the last state ({}): its offset field is taken as zero",
                        last.name
                    );
                    notes.push(Note::new(NoteKind::Method, text).about(name));
                }
            }
        }
    }
    // Every pair belongs to one axis: the axes share no error. The last digit is no uncertainty that others may rest on.
    let variances: Vec<f64> = std.offset_nt.iter().filter(|s| s.is_finite()).map(|s| s * s).collect();
    let row = |i: usize| (0..variances.len()).map(|k| if i == k { variances[i] } else { 0.0 }).collect();
    covariance.matrix = (0..variances.len()).map(row).collect();
    Ok(Residual { found: ResidualFound { used, facility, std, covariance: is_known.then_some(covariance), state }, notes })
}

/// The noise of one pair: half the difference of its moduli. One magnetometer measures all of them, so that the pairs of all axes and states
/// tell it together; two or three pairs of one axis alone hardly do.
struct Noise {
    /// Standard deviation about the means of axes and states, nT, times what Student's t needs in place of a normal one; 0 where no axis has two
    /// pairs.
    std_nt: f64,
    /// The step of the moduli, nT.
    resolution_nt: f64,
    freedom: usize,
}

impl Noise {
    fn of(groups: &[[Vec<&Pair>; 3]], resolution_nt: f64) -> Self {
        let several = groups.iter().flatten().filter(|pairs| pairs.len() > 1);
        let freedom = several.clone().map(|pairs| pairs.len() - 1).sum();
        let squares: f64 = several.map(|pairs| scatter_nt2(pairs)).sum();
        let std_nt = if freedom > 0 { (squares / freedom as f64).sqrt() * student_factor(freedom) } else { 0.0 };
        Self { std_nt, resolution_nt, freedom }
    }

    /// Says that nothing tells the noise.
    fn unseen(&self, pairs: &[Pair]) -> Option<Note> {
        let text = "no axis has two pairs of moduli, and no uncertainty is stated: the standard uncertainties are those of the last digit of the moduli";
        let is_open = self.freedom == 0 && pairs.iter().any(|p| p.std_nt.is_none());
        is_open.then(|| {
            Note::new(NoteKind::Method, text)
                .with_remedy("measure every pair several times, or state the uncertainty of the moduli")
        })
    }
}

/// The residual field that a pair shows, nT.
fn field_nt(pair: &Pair) -> f64 {
    0.5 * (pair.plus_nt - pair.minus_nt - pair.setting_difference_nt)
}

/// Mean over some pairs.
fn mean(pairs: &[&Pair], get: impl Fn(&Pair) -> f64) -> f64 {
    pairs.iter().map(|p| get(p)).sum::<f64>() / pairs.len() as f64
}

/// Sum of the squared deviations of some pairs from their mean, nT².
fn scatter_nt2(pairs: &[&Pair]) -> f64 {
    let middle_nt = mean(pairs, field_nt);
    pairs.iter().map(|p| (field_nt(p) - middle_nt).powi(2)).sum()
}

/// Says of pairs that look as if their moduli were not at plus and minus the same field.
fn strange(pairs: &[Pair]) -> Option<Note> {
    let is_strange = |p: &&Pair| field_nt(p).abs() > STRANGE * 0.5 * (p.plus_nt + p.minus_nt);
    let found: Vec<&Pair> = pairs.iter().filter(is_strange).collect();
    let first = found.first()?;
    let text = format!(
        "{} of {} pairs show a residual field of more than {:.0} % of their moduli, first {:.1} and {:.1} nT of the {} axis ({}): they may not be at plus \
         and minus the same field",
        found.len(),
        pairs.len(),
        100.0 * STRANGE,
        first.plus_nt,
        first.minus_nt,
        AXES[first.axis],
        first.state
    );
    Some(Note::new(NoteKind::Fit, text).with_remedy("put moduli of the same field into one row"))
}

/// The residual field along one axis in one state.
fn one(axis: usize, pairs: &[&Pair], noise: &Noise) -> Option<AxisResidual> {
    if pairs.is_empty() {
        return None;
    }
    let n = pairs.len() as f64;
    // Two moduli with the uncertainty of a uniform distribution, or as stated; each counts half.
    let stated = mean(pairs, |p| 0.5 * p.std_nt.unwrap_or(noise.resolution_nt / 12f64.sqrt()).powi(2));
    // An axis that scatters by more than the others has more.
    let own = if n > 1.0 { scatter_nt2(pairs) / (n - 1.0) } else { 0.0 };
    let of_all = if pairs.iter().all(|p| p.std_nt.is_some()) { 0.0 } else { noise.std_nt.powi(2) };
    Some(AxisResidual {
        axis: AXES[axis].to_owned(),
        plus_nt: mean(pairs, |p| p.plus_nt),
        minus_nt: mean(pairs, |p| p.minus_nt),
        residual_nt: mean(pairs, field_nt),
        std_nt: (stated.max(own).max(of_all) / n).sqrt(),
        pairs: pairs.len(),
    })
}

/// The step of the moduli: the decimals that they all do without.
fn resolution(pairs: &[Pair]) -> f64 {
    let whole = |step: f64| {
        let on_step = |v: f64| (v / step - (v / step).round()).abs() < 1e-6;
        pairs.iter().all(|p| on_step(p.plus_nt) && on_step(p.minus_nt))
    };
    (0..MOST_DECIMALS).map(|d| 10f64.powi(-d)).find(|step| whole(*step)).unwrap_or(10f64.powi(-MOST_DECIMALS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::NORMAL_95;
    use crate::fit::random::Random;

    /// Pairs of moduli whose noise is 0.1 nT at residual fields of 1, 2 and 3 nT.
    fn pairs(each: usize, random: &mut Random) -> Vec<Pair> {
        let pair = |axis: usize| Pair {
            state: "state".to_owned(),
            axis,
            plus_nt: 50_001.0 + axis as f64 + 0.1 * random.gaussian(),
            minus_nt: 49_999.0 - axis as f64 + 0.1 * random.gaussian(),
            setting_difference_nt: 0.0,
            std_nt: None,
        };
        (0..3 * each).map(|i| i % 3).map(pair).collect()
    }

    /// 1.96 standard uncertainties hold the residual field in 95 % of the cases, however few the pairs: 1500 values tell that to 0.6 %. An axis that
    /// scatters by chance more than the others has more, so that intervals hold a little more often.
    #[test]
    fn few_pairs_state_what_they_do_not_know() {
        for each in [2, 3, 6] {
            let mut random = Random::seeded(7);
            let mut held = 0;
            for _ in 0..500 {
                let found = of_pairs(&pairs(each, &mut random), Vec::new()).unwrap().found;
                for (k, axis) in found.state[0].axis.iter().enumerate() {
                    held += usize::from((axis.residual_nt - 1.0 - k as f64).abs() < NORMAL_95 * axis.std_nt);
                    let of_file = found.covariance.as_ref().unwrap();
                    assert_eq!(
                        (&*of_file.parameters[k], of_file.matrix[k][k]),
                        (["offset_x", "offset_y", "offset_z"][k], axis.std_nt.powi(2))
                    );
                }
            }
            let share = held as f64 / 1500.0;
            assert!((0.932..0.99).contains(&share), "{each} pairs: {share}");
        }
    }

    /// A source of 125 nT per unit whose negative setting is 0.2 units short, at a residual field of 2 nT: 400 · 125 + 2 and 399.8 · 125 - 2 nT.
    #[test]
    fn settings_of_any_unit_and_of_unequal_size_are_set_off() {
        let row = |x: f64, modulus_nt: f64| ScalarRow { t_s: 0.0, setting: [x, 0.0, 0.0], modulus_nt };
        let pairs = pairs_of("run", &[row(400.0, 50_002.0), row(-399.8, 49_973.0)]);
        assert_eq!(pairs.len(), 1);
        // The pair shows 125 nT per unit to 3 parts in 10⁸, and half a difference of 25 nT is set off.
        assert!((field_nt(&pairs[0]) - 2.0).abs() < 1e-6, "{}", field_nt(&pairs[0]));
        assert!(strange(&pairs).is_none());
        let other = Pair { minus_nt: 40_000.0, ..pairs[0].clone() };
        assert!(strange(&[pairs[0].clone(), other]).is_some_and(|note| note.text.starts_with("1 of 2 pairs")));
    }

    #[test]
    fn single_pairs_say_that_nothing_shows_their_noise() {
        let mut random = Random::seeded(8);
        let mut list = pairs(1, &mut random);
        let open = of_pairs(&list, Vec::new()).unwrap();
        assert_eq!((open.notes.len(), open.found.covariance), (1, None));
        list.iter_mut().for_each(|p| p.std_nt = Some(0.1));
        let stated = of_pairs(&list, Vec::new()).unwrap();
        assert!(stated.notes.is_empty());
        assert!((stated.found.std.offset_nt[0] - 0.1 / 2f64.sqrt()).abs() < 1e-12);
    }
}
