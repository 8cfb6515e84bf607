//! By how much the steps of the data are displaced against the table of settings, from what single settings show at their ends: the level of
//! before where the data are late, the level of after where they are early. The field between the settings says nothing: it may change there
//! at any time.

use crate::fit::statistics::{median, robust_std};
use std::borrow::Cow;
use std::f64::consts::TAU;

/// A step of this many standard deviations of a value shows where its edge is.
const CLEAR: f64 = 50.0;
/// A value within this part of a step shows the level before or after it.
const AT_LEVEL: f64 = 0.2;
/// Fewest edges that agree.
const LEAST_EDGES: usize = 4;
/// An edge is looked for in half of a setting and so many values beyond: what is further from one end is nearer to the other.
const BEYOND_HALF: usize = 3;
/// Edges agree within so many intervals, or within this part of the displacement.
const AGREE: f64 = 2.0;
const AGREE_PART: f64 = 0.1;
/// Standard deviation of a rounded value, in units of the last place.
const ROUNDING: f64 = 0.29;
/// Parts of the error of a rounded value, as harmonics of where it lies between two values; those that are left out are a hundredth of it.
const HARMONICS: usize = 60;

/// A setting as values at equal intervals from its begin to its end.
#[derive(Clone, Debug)]
pub struct Course<'a> {
    /// Begin, s since the run's start.
    pub begin_s: f64,
    /// End, s since the run's start.
    pub end_s: f64,
    /// Whether no field is applied.
    pub is_zero: bool,
    /// Time from value to value, s.
    pub interval_s: f64,
    /// By how much more than half an interval the first value is after the begin, and the last one before the end, s: zero for means over the
    /// intervals.
    pub beside_s: [f64; 2],
    /// Readings or means of readings, enT; none of a setting whose field is not constant.
    pub values: Cow<'a, [[f64; 3]]>,
}

/// Displacement of the data's steps against the table of settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// s; positive when the data are late.
    pub shift_s: f64,
    /// Its standard uncertainty, s: scatter of the edges, and that every edge is known to a sample, alike where edges lie alike.
    pub std_s: f64,
    /// Standard uncertainty by the scatter alone, as far as it can be known, s: beside it a displacement is one or none.
    pub scatter_s: f64,
    /// How long settings show the other level, in values from that end of them, s: whether there is a displacement at all.
    pub shown_s: f64,
    /// Edges that agree.
    pub agreeing: usize,
    /// Edges that are to be seen.
    pub clear: usize,
}

/// Level of the values in a part of a setting, in quarters of it; `None` where there are none.
fn level(values: &[[f64; 3]], quarters: [usize; 2]) -> Option<[f64; 3]> {
    let part = &values[quarters[0] * values.len() / 4..quarters[1] * values.len() / 4];
    let middle = |a: usize| median(&mut part.iter().map(|v| v[a]).filter(|v| v.is_finite()).collect::<Vec<f64>>());
    let level = [middle(0), middle(1), middle(2)];
    level.iter().all(|v| v.is_finite()).then_some(level)
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

/// Standard deviation of the values by the differences of neighbours, all components together.
fn noise(settings: &[Course]) -> f64 {
    let pairs = settings.iter().flat_map(|s| s.values.windows(2).map(|w| dot(minus(w[1], w[0]), minus(w[1], w[0]))));
    let mut squares: Vec<f64> = pairs.filter(|v| v.is_finite()).collect();
    if squares.is_empty() { 0.0 } else { (0.5 * median(&mut squares)).sqrt() }
}

/// How long a setting shows the level `before` ahead of its own one, in intervals, with the values in the order in which the edge is passed.
/// `None` where it does not, or where the values creep: of what settles there is no edge.
fn edge(mut value: impl FnMut(usize) -> [f64; 3], count: usize, own: [f64; 3], before: [f64; 3]) -> Option<f64> {
    let step = minus(before, own);
    let part: Vec<f64> = (0..count).map(|k| dot(minus(value(k), own), step) / dot(step, step)).collect();
    let last = part.iter().rposition(|p| *p > 0.5)?;
    let is_before = |k: &usize| (part[*k] - 1.0).abs() <= AT_LEVEL;
    let end = (0..=last).rev().find(is_before)?;
    let run = (0..=end).rev().take_while(is_before).count();
    let after = (end + 1..count).find(|k| part[*k].abs() <= AT_LEVEL)?;
    (after - end - 1 <= run).then(|| end as f64 + part[end..=after].iter().sum::<f64>())
}

/// Settings at one of whose ends the data may show another level.
struct Side {
    late: bool,
    /// Level of every setting away from this end.
    own: Vec<Option<[f64; 3]>>,
}

impl Side {
    fn new(settings: &[Course], late: bool) -> Self {
        let quarters = if late { [2, 3] } else { [1, 2] };
        Self { late, own: settings.iter().map(|s| level(&s.values, quarters)).collect() }
    }

    /// Levels beyond the end of every setting, if nothing is applied between the settings, and if the neighbour goes on until there.
    fn beyond(&self, settings: &[Course]) -> [Vec<Option<[f64; 3]>>; 2] {
        let at_end = |s: &Course| if self.late { s.values.first() } else { s.values.last() }.copied();
        let zeros: Vec<[f64; 3]> =
            settings.iter().zip(&self.own).filter(|(s, _)| s.is_zero).filter_map(|(_, own)| *own).collect();
        // Without a setting of no field: what most settings show at this end.
        let common = if zeros.is_empty() { settings.iter().filter_map(at_end).collect() } else { zeros };
        let common = level(&common, [0, 4]);
        let n = settings.len();
        let neighbour = |i: usize| if self.late { i.checked_sub(1) } else { Some(i + 1).filter(|k| *k < n) };
        let neighbours = (0..n).map(|i| neighbour(i).and_then(|k| self.own[k])).collect();
        [vec![common; n], neighbours]
    }

    /// The displacement that settings show whose levels beyond this end are known.
    fn displacement(&self, settings: &[Course], beyond: &[Option<[f64; 3]>], least: f64, sample_s: f64) -> Option<Displacement> {
        let mut clear = 0;
        // Displacement, interval, time of the setting's end, and how long it shows the other level.
        let mut edges: Vec<[f64; 4]> = Vec::new();
        for ((setting, own), beyond) in settings.iter().zip(&self.own).zip(beyond) {
            let (Some(own), Some(beyond)) = (*own, *beyond) else { continue };
            let step = minus(beyond, own);
            if dot(step, step).sqrt() <= least {
                continue;
            }
            clear += 1;
            let (values, n) = (&setting.values, setting.values.len());
            let at = |k: usize| values[if self.late { k } else { n - 1 - k }];
            let [end_s, beside_s] =
                if self.late { [setting.begin_s, setting.beside_s[0]] } else { [setting.end_s, setting.beside_s[1]] };
            // The edge is half way between the last value before it and the first one after it.
            edges.extend(
                edge(at, (n / 2 + BEYOND_HALF).min(n), own, beyond)
                    .map(|p| [p * setting.interval_s + beside_s, setting.interval_s, end_s, p * setting.interval_s]),
            );
        }
        let middle_s = median(&mut edges.iter().map(|e| e[0]).collect::<Vec<f64>>());
        edges.retain(|[by_s, interval_s, ..]| (by_s - middle_s).abs() <= (AGREE * interval_s).max(AGREE_PART * middle_s));
        if edges.len() < LEAST_EDGES || 2 * edges.len() < clear {
            return None;
        }
        let n = edges.len() as f64;
        // Whole samples: only the mean of edges that lie otherwise between them is nearer than one.
        let shift_s = edges.iter().map(|e| e[0]).sum::<f64>() / n;
        let scatter_s = robust_std(edges.iter().map(|e| e[0] - shift_s)) / n.sqrt();
        let turns: Vec<f64> = edges.iter().map(|e| TAU * (e[2] / sample_s).fract()).collect();
        let std_s = scatter_s.max(sample_s * rounding(&turns));
        Some(Displacement {
            shift_s: if self.late { shift_s } else { -shift_s },
            std_s,
            scatter_s: scatter_s.max(ROUNDING * sample_s / n.sqrt()),
            shown_s: median(&mut edges.iter().map(|e| e[3]).collect::<Vec<f64>>()),
            agreeing: edges.len(),
            clear,
        })
    }
}

/// Standard deviation of the mean of rounded values, in units of the last place, whose places between two values are given as phases: the error of
/// each is a saw, of which phases that spread leave the harmonics in which they still agree.
fn rounding(turns: &[f64]) -> f64 {
    let n = turns.len() as f64;
    let variance = |harmonic: usize| {
        let h = harmonic as f64;
        let (sin, cos) = turns.iter().fold((0.0, 0.0), |(s, c), turn| (s + (h * turn).sin(), c + (h * turn).cos()));
        2.0 * (sin * sin + cos * cos) / (n * TAU * h).powi(2)
    };
    (1..=HARMONICS).map(variance).sum::<f64>().sqrt()
}

/// The displacement of the data's steps, as at least half of the edges show it that are to be seen; `None` where they show none.
#[must_use]
pub fn displacement(settings: &[Course], sample_s: f64) -> Option<Displacement> {
    let least = CLEAR * noise(settings);
    let sides = [true, false].map(|late| Side::new(settings, late));
    let all =
        sides.iter().flat_map(|side| side.beyond(settings).map(|beyond| side.displacement(settings, &beyond, least, sample_s)));
    all.flatten()
        .max_by(|a, b| a.agreeing.cmp(&b.agreeing).then(b.clear.cmp(&a.clear)).then(b.shift_s.abs().total_cmp(&a.shift_s.abs())))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings of 7.3 s every 7.4 s in samples of an eighth of a second that are late by 0.33 s: every edge is seen as a whole number of samples,
    /// and their mean is the displacement to a part of one. Settings that begin with a sample show no more than the next whole number.
    #[test]
    fn a_displacement_is_known_to_a_part_of_a_sample() {
        const SAMPLE_S: f64 = 0.125;
        let field = |k: usize| [1000.0 * ((k * 7 % 5) as f64 - 2.0), 300.0, 0.0];
        let shown = |every_s: f64| {
            let begin_s = |k: usize| k as f64 * every_s;
            let at = |t_s: f64| field((((t_s - 0.33) / every_s).floor().max(0.0) as usize).min(60));
            let course = |k: usize| {
                let [begin_s, end_s] = [begin_s(k), begin_s(k) + 7.3];
                let times: Vec<f64> =
                    (0..4000).map(|n| n as f64 * SAMPLE_S).filter(|t| *t >= begin_s - 1e-9 && *t < end_s - 1e-9).collect();
                Course {
                    begin_s,
                    end_s,
                    is_zero: false,
                    interval_s: SAMPLE_S,
                    beside_s: [times[0] - begin_s - 0.5 * SAMPLE_S, end_s - times[times.len() - 1] - 0.5 * SAMPLE_S],
                    values: times.into_iter().map(at).collect::<Vec<[f64; 3]>>().into(),
                }
            };
            displacement(&(0..60).map(course).collect::<Vec<Course>>(), SAMPLE_S).unwrap()
        };
        // Begins at five places between two samples: the mean is known to a fifth of one.
        let found = shown(7.4);
        assert!((found.shift_s - 0.33).abs() < 0.5 * SAMPLE_S / 5.0, "{found:?}");
        assert!((found.std_s / (SAMPLE_S / 5.0 / 12.0_f64.sqrt()) - 1.0).abs() < 0.1, "{found:?}");
        let found = shown(7.5);
        assert!((found.shift_s - 0.3125).abs() < 1e-9, "{found:?}");
        assert!((found.std_s / (SAMPLE_S / 12.0_f64.sqrt()) - 1.0).abs() < 0.1, "{found:?}");
    }
}
