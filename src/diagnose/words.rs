//! What was found in words, and the numbers that words need.

use super::result::{Gap, Left, LeftLike, Parameter, ShapePoint, Step};
use crate::data::units::{six_digits, three_digits};
use crate::model::effects::{self, Covariate, EffectRef, Record};
use nalgebra::{DMatrix, DVector};

/// Points of an unknown dependence.
const POINTS: usize = 12;

/// The verdict in one line; `caution` is what makes the effects less sure than their probabilities say.
#[must_use]
pub fn verdict(steps: &[Step], caution: Option<&str>, left: Option<&Left>) -> String {
    let found = match steps.len() {
        0 => None,
        1 => Some("1 effect found".to_owned()),
        n => Some(format!("{n} effects found")),
    };
    let found = found.map(|count| format!("{count}: {}{}", named(steps), caution.map_or_else(String::new, |c| format!("; {c}"))));
    match (found, left.map(not_explained)) {
        (None, None) => "no missing effect".to_owned(),
        (Some(found), None) => found,
        (None, Some(left)) => left,
        (Some(found), Some(left)) => format!("{found}; what is left is not explained: {left}"),
    }
}

/// The effects that were found: those whose name is certain, then those that others may be taken for.
fn named(steps: &[Step]) -> String {
    let name = |step: &Step| match &step.covariate {
        Some(covariate) => format!("{} ({covariate})", step.effect),
        None => step.effect.to_string(),
    };
    let (certain, doubted): (Vec<&Step>, Vec<&Step>) = steps.iter().partition(|step| step.wording == "is");
    let list = |steps: Vec<&Step>| steps.into_iter().map(name).collect::<Vec<String>>().join(", ");
    match (list(certain), list(doubted)) {
        (certain, doubted) if doubted.is_empty() => certain,
        (certain, doubted) if certain.is_empty() => format!("consistent with {doubted}"),
        (certain, doubted) => format!("{certain}; consistent with {doubted}"),
    }
}

/// What is left, in words.
fn not_explained(left: &Left) -> String {
    let Left { place, rms_nt, times_noise, like } = left;
    let size = format!("{} nT ({place}), {times_noise:.1} times the noise", three_digits(*rms_nt));
    match like {
        LeftLike::Slow => format!("slow change of {size}: drift or slow noise, these data cannot tell"),
        LeftLike::SlowGain => format!("slow change of the gain, up to {size}: drift or slow noise, these data cannot tell"),
        LeftLike::Scatter => {
            format!(
                "the plateau means scatter by {size} of the samples inside them: a dependence that was not found, or noise between them"
            )
        }
        LeftLike::Plateaus => format!("single plateaus stand out, by up to {size}: they were disturbed"),
        LeftLike::Edges => {
            format!(
                "a part of the edges stands elsewhere than the others: settings show the field of the one beside them, {size} of a sample"
            )
        }
        LeftLike::Still => format!("a component stands still ({place}): its readings there tell nothing"),
        LeftLike::Band => format!("something periodic or of a narrow band is left in the samples, {size} of the bands beside it"),
        LeftLike::Disagreement => format!("the data disagree by {size}"),
    }
}

/// The covariate that a contribution follows best, or the one that is given: name, unit, values. Fields of settings before count for what `remembers` them.
#[must_use]
pub fn follows(record: &Record, contribution: &[f64], given: Option<&str>, remembers: bool) -> (String, &'static str, Vec<f64>) {
    let mut all: Vec<Covariate> = Covariate::all(record).into_iter().collect();
    if let Some(found) = given.and_then(|name| all.iter().position(|c| c.name == name)) {
        let c = all.swap_remove(found);
        return (c.name, c.unit, c.values);
    }
    let y = DVector::from_column_slice(contribution);
    let left =
        |c: &Covariate| -> f64 {
            let knots = c.knots();
            if knots.len() < 2 {
                return f64::INFINITY;
            }
            let columns = DMatrix::from_fn(c.values.len(), knots.len(), |i, j| {
                if j == 0 { 1.0 } else { effects::spline(&knots, c.values[i])[j - 1] }
            });
            let q = columns.qr().q();
            (&y - &q * q.tr_mul(&y)).norm()
        };
    // A rate says something where the temperature itself does not: it takes less than half of what any other covariate leaves.
    let cost = |c: &Covariate| left(c) * if c.name.starts_with("rate of") { 2.0 } else { 1.0 };
    let is_open = |c: &&Covariate| !c.gain && (remembers || !c.is_of_history());
    let best = all.iter().filter(is_open).min_by(|a, b| cost(a).total_cmp(&cost(b)));
    best.map_or_else(
        || ("time".to_owned(), "s", record.rows.iter().map(effects::Row::t_s).collect()),
        |c| (c.name.clone(), c.unit, c.values.clone()),
    )
}

/// An unknown dependence as a table: means of the contribution, with what is left beside it, over equal numbers of rows; `std_ent` is the noise
/// of the rows. What multiplies the reading, of which `reading_ent` are the values, is told at the largest one: by least squares, since
/// readings of both signs would cancel out.
#[must_use]
pub fn shape(
    x: &[f64],
    contribution_ent: &[f64],
    std_ent: &[f64],
    reading_ent: Option<&[f64]>,
    nt_per_ent: f64,
) -> Vec<ShapePoint> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let length = x.len().div_ceil(POINTS).max(1);
    let most_ent = reading_ent.map_or(1.0, |all| all.iter().fold(0.0, |most: f64, r| most.max(r.abs())));
    let part = |i: usize| reading_ent.map_or(1.0, |all| all[i] / most_ent);
    order
        .chunks(length)
        .map(|rows| {
            let sum = |f: &dyn Fn(usize) -> f64| rows.iter().map(|i| f(*i)).sum::<f64>();
            let square = sum(&|i| part(i).powi(2));
            ShapePoint {
                covariate: sum(&|i| x[i]) / rows.len() as f64,
                residual_nt: nt_per_ent * sum(&|i| part(i) * contribution_ent[i]) / square,
                std_nt: nt_per_ent * sum(&|i| (part(i) * std_ent[i]).powi(2)).sqrt() / square,
            }
        })
        // Where the axis shows nothing there is no gain.
        .filter(|point| point.residual_nt.is_finite() && point.std_nt.is_finite())
        .collect()
}

/// What to measure to distinguish the members of an ambiguous set.
#[must_use]
pub fn next_measurement(effect: EffectRef, others: &[EffectRef]) -> Option<String> {
    if others.is_empty() {
        return None;
    }
    let effects = std::iter::once(&effect).chain(others).filter(|e| !e.is_unknown());
    let all: Vec<String> = effects.map(|e| format!("{e}: {}", e.about().best_measurement)).collect();
    Some(all.join("; "))
}

/// A unit behind a number; nothing for numbers without one.
#[must_use]
pub fn unit(unit: &str) -> String {
    if matches!(unit, "" | "1") { String::new() } else { format!(" {unit}") }
}

/// The sentence for the protocol.
#[must_use]
pub fn sentence(step: &Step) -> String {
    let what = match &step.covariate {
        Some(covariate) => format!("a dependence on the {covariate} that no effect of the catalogue explains"),
        None => format!("{} ({})", step.effect, step.effect.about().summary),
    };
    let on = if step.axes.is_empty() { String::new() } else { format!(" on {}", step.axes.join(", ")) };
    let values = |parameters: &[Parameter]| -> String {
        let value = |p: &Parameter| match p.std {
            Some(std) => format!(", {} = {}{}", p.name, number(p.value, std), unit(&p.unit)),
            None => format!(", {} = {:.4e}{}", p.name, p.value, unit(&p.unit)),
        };
        parameters.iter().take(4).map(value).collect()
    };
    let with = if step.covariate.is_some() {
        String::new()
    } else {
        let further: String = step.further.iter().map(|one| format!("; once more{}", values(&one.parameters))).collect();
        values(&step.parameters) + &further
    };
    let rest = ambiguous(&step.ambiguous_with);
    let verb = if step.wording == "is" { "show" } else { "are consistent with" };
    // Damage is named without a prediction.
    let gap = if step.gap_before.chi2_per_dof > 0.0 {
        let of = if step.effect.in_samples().is_some() {
            "of the samples inside the plateaus"
        } else {
            "on stretches that were left out of the fit"
        };
        let [before, after] = [&step.gap_before, &step.gap_after].map(|gap| gap.chi2_per_dof);
        format!("; {of}, chi square over degrees of freedom goes from {before:.2} to {after:.2}")
    } else {
        String::new()
    };
    format!("The data {verb} {what}{on}{with}{gap}.{rest}")
}

fn number(value: f64, std: f64) -> String {
    if value.abs() < 1e-3 || value.abs() >= 1e5 {
        crate::data::units::scientific_with_uncertainty(value, std)
    } else {
        crate::data::units::with_uncertainty(value, std)
    }
}

/// The sentence for a lag with its standard uncertainty, certain or beside rivals that these data cannot tell from it.
#[must_use]
pub fn lag(name: &str, form: &str, [lag_s, std_s]: [f64; 2], gaps: &[Gap; 2], is_certain: bool, rivals: &[EffectRef]) -> String {
    let (how, size) = match form {
        "first order" => ("follows", lag_s),
        "inverse first order" => ("is followed by", lag_s),
        _ if lag_s > 0.0 => ("comes after", lag_s),
        _ => ("comes before", -lag_s),
    };
    let [before, after] = gaps;
    let begin = if is_certain { "The part" } else { "The data are consistent with this: the part" };
    let others = ambiguous(rivals);
    format!(
        "{begin} of the sensor that matters {how} the thermistor {name} by {:.2} ± {:.2} min ({form}); with its temperature chi square over degrees of freedom on stretches that were left out goes from {:.2} to {:.2}.{others}",
        size / 60.0,
        std_s / 60.0,
        before.chi2_per_dof,
        after.chi2_per_dof
    )
}

/// What an effect cannot be told from; nothing where there is none.
fn ambiguous(rivals: &[EffectRef]) -> String {
    if rivals.is_empty() { String::new() } else { format!(" These data cannot tell it from {}.", rivals.join(", ")) }
}

/// The shape of an unknown dependence in words; `None` without points. Between two turns it rises or falls by more than its uncertainty.
#[must_use]
pub fn course(covariate: &str, points: &[ShapePoint]) -> Option<String> {
    let (first, last) = (points.first()?, points.last()?);
    // Turns of the course: from each the next one that is further away than what lies between them and than its uncertainty.
    let mut turns = vec![first];
    for point in &points[1..] {
        let now = turns[turns.len() - 1];
        let by_nt = point.residual_nt - now.residual_nt;
        let goes_on = match turns.len() {
            1 => false,
            n => by_nt * (now.residual_nt - turns[n - 2].residual_nt) > 0.0,
        };
        if goes_on {
            *turns.last_mut()? = point;
        } else if by_nt.abs() > 2.0 * point.std_nt.hypot(now.std_nt) {
            turns.push(point);
        }
    }
    let what = if covariate.starts_with(effects::GAIN_WITH) { "contribution to the largest reading" } else { "contribution" };
    let place = |p: &ShapePoint| format!("{:+.3} ± {:.3} nT at {}", p.residual_nt, p.std_nt, six_digits(p.covariate));
    let way: Vec<String> = turns
        .windows(2)
        .map(|w| format!("{} to {}", if w[1].residual_nt > w[0].residual_nt { "rises" } else { "falls" }, place(w[1])))
        .collect();
    Some(if way.is_empty() {
        format!(
            "Along the {covariate} no single point of the {what} stands out: {} and {} at its ends.",
            place(first),
            place(last)
        )
    } else {
        format!("Along the {covariate} the {what} begins with {} and {}.", place(first), way.join(", then "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A valley between two hills of the same height, with bumps that are no more than noise on its way; and noise alone.
    #[test]
    fn a_course_turns_where_it_is_more_than_noise() {
        let points = |nt: &[f64]| -> Vec<ShapePoint> {
            let point = |(k, nt): (usize, &f64)| ShapePoint { covariate: 10.0 * k as f64, residual_nt: *nt, std_nt: 0.05 };
            nt.iter().enumerate().map(point).collect()
        };
        assert_eq!(
            course("field x", &points(&[1.0, 0.6, 0.65, -0.8, -1.0, -0.95, 0.2, 0.15, 1.0])).unwrap(),
            "Along the field x the contribution begins with +1.000 ± 0.050 nT at 0.0000 and falls to -1.000 ± 0.050 nT at 40.0000, then \
             rises to +1.000 ± 0.050 nT at 80.0000."
        );
        let flat = course("field x", &points(&[0.03, -0.02, 0.05, 0.0])).unwrap();
        assert!(flat.contains("no single point") && !flat.contains("rises"), "{flat}");
        assert_eq!(course("field x", &[]), None);
    }

    /// A gain that falls evenly by 2e-4 over the run, seen in readings of both signs and sizes without noise: 0.2 nT at the largest reading of
    /// 1000 nT.
    #[test]
    fn the_shape_of_a_gain_is_that_of_the_gain() {
        let n: i32 = 120;
        let x: Vec<f64> = (0..n).map(f64::from).collect();
        let reading: Vec<f64> = (0..n).map(|i| [1000.0, -400.0, -800.0, 0.0, 700.0][(i % 5) as usize]).collect();
        let gain = |x: f64| 1e-4 - 2e-4 * x / f64::from(n - 1);
        let contribution: Vec<f64> = x.iter().zip(&reading).map(|(x, r)| gain(*x) * r).collect();
        let points = shape(&x, &contribution, &[0.01; 120], Some(&reading), 1.0);
        assert_eq!(points.len(), 12);
        for point in points {
            let expected = 1000.0 * gain(point.covariate);
            assert!((point.residual_nt - expected).abs() < 0.005, "{point:?} {expected}");
            // Ten rows with squares of 1, 0.16, 0.64, 0 and 0.49, each twice.
            assert!((point.std_nt - 0.01 / 4.58_f64.sqrt()).abs() < 1e-12, "{point:?}");
        }
    }
}
