//! The plan of the study, the score of its verdicts, and the report.

use super::decoy::Decoy;
use super::effects;
use super::ideal::Ideal;
use super::kinds::{self, Column, generate};
use super::noise::{Family, Random};
use super::programme::Programme;
use super::sensor::Kind;
use super::{Blind, Options, Truth, Verdict, VerdictStep};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// What a case is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    Null,
    One,
    Two,
    Outside,
    Absorbed,
    Decoy,
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

/// Part of the linearity runs that have another programme than the usual one.
const OTHER_PROGRAMME: f64 = 0.6;
/// One null run in so many has damage that is no effect.
const DECOYS: u64 = 10;

/// The cases: null runs in all noise families, a tenth of them with damage that is no effect; of those with effects six in ten have one, 15 %
/// two, 15 % one outside the catalogue, and 10 % one that the run cannot show. Kinds, families and damage go around, programmes, names and
/// strengths are drawn.
pub fn plan(null: u64, with_effects: u64, kinds: &[Kind]) -> Vec<Case> {
    plan_from(0, null, with_effects, kinds)
}

/// The same with other draws and seeds: cases that something was tuned on are none on which it is judged.
pub fn plan_from(first: u64, null: u64, with_effects: u64, kinds: &[Kind]) -> Vec<Case> {
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
        let mut random = Random::new(first + index, "plan");
        let mut kind = around[random.below(around.len())];
        let family = Family::ALL[(index % Family::ALL.len() as u64) as usize];
        let any = |names: &[&'static str], random: &mut Random| {
            (!names.is_empty()).then(|| names[random.below(names.len())].to_owned())
        };
        let decoy = (index < null && index % DECOYS == DECOYS - 1)
            .then(|| Decoy::ALL[(index / DECOYS % Decoy::ALL.len() as u64) as usize])
            .filter(|decoy| kinds.contains(&decoy.kind()));
        kind = decoy.map_or(kind, Decoy::kind);
        let wanted = match decoy {
            Some(_) => Purpose::Decoy,
            None if index < null => Purpose::Null,
            None => purpose(index - null),
        };
        if wanted == Purpose::Absorbed && effects::absorbed(kind).is_empty() {
            kind = if kinds.contains(&Kind::Lin) { Kind::Lin } else { kind };
        }
        let (purpose, names, strength_k) = match wanted {
            Purpose::Null | Purpose::Decoy => (wanted, Vec::new(), 0.0),
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
        let mut random = Random::new(first + index, "programme");
        let programme = if kind == Kind::Lin && random.chance(OTHER_PROGRAMME) {
            Programme::ALL[1 + random.below(Programme::ALL.len() - 1)]
        } else {
            Programme::default()
        };
        cases.push(Case {
            seed: FIRST_SEED + first + index,
            kind,
            purpose,
            options: Options { effects: names, strength_k, noise: Some(family), programme, decoy, then: None },
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

impl Judged {
    /// A line: what the run was, what was hidden, what was said.
    pub fn line(&self) -> String {
        let Case { seed, kind, purpose, options } = &self.case;
        let hidden: Vec<String> =
            self.truth.effects.iter().map(|e| format!("{} {} ({})", e.effect, e.axes.join(""), e.form)).collect();
        let step = |s: &VerdictStep| {
            let is = if s.confident { "is" } else { "?" };
            let covariate = s.covariate.as_deref().filter(|_| s.effect == "unknown").unwrap_or_default();
            let sizes: Vec<String> =
                s.amplitudes.iter().take(3).map(|a| format!("{}={:.4e}+-{:.1e}", a.name, a.value, a.std)).collect();
            let rival = s.runner_up.as_ref().map_or_else(String::new, |(name, ratio)| format!(" [{name} {ratio:+.1}]"));
            let set = if s.ambiguous_with.is_empty() { String::new() } else { format!(" or {}", s.ambiguous_with.join(", ")) };
            format!("{is} {} {} {covariate} k{:.1}{set}{rival} {}", s.effect, s.axes.join(""), s.strength_k, sizes.join(" "))
        };
        let said: Vec<String> = self.verdict.steps.iter().map(step).collect();
        let exact: Vec<String> = self
            .truth
            .effects
            .iter()
            .filter(|e| e.exact_form)
            .flat_map(|e| &e.parameters)
            .map(|p| format!("{}={:.4e}", p.name, p.value))
            .collect();
        format!(
            "{seed} {} {:?} {:?} {} k={} | {} | {} | {}\n",
            kind.name(),
            options.programme,
            purpose,
            self.truth.noise.family.name(),
            options.strength_k,
            hidden.join("; "),
            exact.join(" "),
            if self.verdict.undecided { "undecided".to_owned() } else { said.join("; ") }
        )
    }
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
    /// The same by kind, and for pairs that the run distinguishes.
    pub two_by_kind: BTreeMap<(Kind, u64), Share>,
    pub two_apart: BTreeMap<u64, Share>,
    pub further_terms: Vec<f64>,
    /// Of the wrong terms, those that are named beside a hidden effect that they may be taken for.
    pub further_in_set: Share,
    pub outside_wrong: BTreeMap<u64, Share>,
    pub outside_covariate: BTreeMap<u64, Share>,
    pub outside_found: BTreeMap<u64, Share>,
    pub absorbed_said: BTreeMap<String, Share>,
    pub gap_ratio: BTreeMap<u64, Vec<f64>>,
    /// Intervals of 95 % that hold the truth, of runs with one effect and with two.
    pub interval: Share,
    pub interval_two: Share,
    /// The same by parameter, with how far they are off in standard uncertainties.
    pub interval_of: BTreeMap<String, (Share, Vec<f64>)>,
    /// Null runs of which it is said that something is left, by family of noise, and the same of effects from k = 15 on that are not found.
    pub undecided: BTreeMap<Family, Share>,
    pub undecided_missed: Share,
    /// By programme of a linearity run: false alarms, and effects that are found from k = 8 on.
    pub alarms_of_programme: BTreeMap<Programme, Share>,
    pub found_of_programme: BTreeMap<Programme, Share>,
    /// Wrong names among all steps that say "is", and among all steps.
    pub is_wrong: Share,
    /// Wrong names for damage that is no effect.
    pub decoys: BTreeMap<Decoy, Share>,
    /// Cases that were judged.
    pub cases: u64,
    /// What could be found where there is noise only, and of effects in plateau means by strength.
    pub ideal_null: Vec<Ideal>,
    /// Whether the diagnosis named something in the same runs.
    pub ideal_null_named: Share,
    pub ideal: BTreeMap<u64, Vec<Possible>>,
}

/// What could be found of an effect, and what was.
pub struct Possible {
    pub ideal: Ideal,
    pub effect: String,
    /// First name of the diagnosis.
    pub said: Option<String>,
}

/// Effects of a pair are distinguished where each keeps this part of its strength beside the other.
pub(super) const LEAST_APART: f64 = 0.8;
/// Standard uncertainties of an interval of 95 %.
const NORMAL_95: f64 = 1.959_963_984_540_054;

pub(super) fn tenths(k: f64) -> u64 {
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
                self.undecided.entry(truth.noise.family).or_default().add(verdict.undecided);
                if case.kind == Kind::Lin {
                    self.alarms_of_programme.entry(case.options.programme).or_default().add(named);
                }
                if let Some(ideal) = verdict.ideal.clone() {
                    self.ideal_null.push(ideal);
                    self.ideal_null_named.add(named);
                }
            }
            Purpose::Decoy => {
                if let Some(decoy) = case.options.decoy {
                    let wrong = said.iter().any(|effect| !decoy.may_be_named(effect));
                    self.decoys.entry(decoy).or_default().add(wrong);
                }
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
        self.cases += 1;
        let is_strong = matches!(case.purpose, Purpose::One | Purpose::Two | Purpose::Outside) && k >= 150;
        if is_strong && !named {
            self.undecided_missed.add(verdict.undecided);
        }
        for step in &verdict.steps {
            let right = hidden.contains(step.effect.as_str()) || case.options.decoy.is_some_and(|d| d.may_be_named(&step.effect));
            // An effect of the catalogue that is hidden may be followed by what its form leaves.
            self.is_wrong.add(step.confident && !right);
        }
        if matches!(case.purpose, Purpose::One | Purpose::Two) {
            let wrong: Vec<&VerdictStep> = verdict.steps.iter().filter(|s| !hidden.contains(s.effect.as_str())).collect();
            self.further_terms.push(wrong.len() as f64);
            for step in wrong {
                self.further_in_set.add(step.ambiguous_with.iter().any(|name| hidden.contains(name.as_str())));
            }
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
                    let holds = (a.value - parameter.value).abs() <= NORMAL_95 * a.std;
                    let shares = if case.purpose == Purpose::Two { &mut self.interval_two } else { &mut self.interval };
                    shares.add(holds);
                    let name =
                        format!("{} {}", effect.effect, parameter.name.trim_end_matches(['x', 'y', 'z']).trim_end_matches('_'));
                    let (share, off) = self.interval_of.entry(name).or_default();
                    share.add(holds);
                    off.push((a.value - parameter.value) * parameter.value.signum() / a.std);
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
        if case.kind == Kind::Lin && k >= 80 {
            self.found_of_programme.entry(case.options.programme).or_default().add(first.is_some());
        }
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
    pub(super) fn alarms(&self, of: Option<Family>) -> Share {
        pooled(self.false_alarms.iter().filter(|((_, family), _)| of.is_none_or(|f| f == *family)).map(|(_, s)| *s))
    }

    /// Share found at a strength, of all kinds together.
    pub fn found_at(&self, k: u64) -> Share {
        pooled(self.found.iter().filter(|((_, at), _)| *at == k).map(|(_, s)| *s))
    }
}

pub(super) fn pooled(shares: impl Iterator<Item = Share>) -> Share {
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

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

pub(super) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
