//! The report of the study: from the score to tables in Markdown.

use super::ideal::{Best, Ideal};
use super::noise::Family;
use super::poles::told_apart;
use super::programme::Programme;
use super::score::{LEAST_APART, Possible, STRENGTHS, Score, Share, family, mean, median, pooled, tenths};
use super::sensor::Kind;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// The report, Markdown.
pub fn report(score: &Score, command: &str, planned: usize) -> String {
    let mut text = format!(
        "# Blind study of the diagnosis\n\nMade with `{command}`: {} of {planned} runs, in random order. Random sensors, programmes, noise and hidden effects; the diagnosis sees \
         runs and positions only. Forms and noise of the generator are its own: low-passes, tanh knees, bent curves, sums of \
         relaxations of samples with random corners and a bend. The slow noise of the diagnosis is a sum of relaxations of means as well, \
         with fixed ratios of its corners and no bend. Strength k: the effect on the plateau means (on the samples where it is seen inside plateaus), whitened with the \
         true covariance of the noise, the run's own parameters projected out. In brackets the one-sided limits of 95 % of a share.\n",
        score.cases
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
    programmes(&mut text, score);
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
    let _ = writeln!(
        text,
        "\n## Intervals\n\nOf effects whose form is that of the catalogue, in runs with one and two effects.\n\n| parameter | in its interval of 95 %, % | \
         mean of value minus truth, in standard uncertainties, positive away from zero | root mean square |\n|---|---|---|---|"
    );
    for (name, (share, off)) in &score.interval_of {
        let rms = mean(&off.iter().map(|z| z * z).collect::<Vec<f64>>()).sqrt();
        let _ = writeln!(text, "| {name} | {} | {:+.2} | {rms:.2} |", counted(*share), mean(off));
    }
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

/// False alarms and power by programme, and what is said of damage that is no effect.
fn programmes(text: &mut String, score: &Score) {
    let _ = writeln!(
        text,
        "\n| programme of a linearity run | false alarms, % (upper limit) | found at k = 8 and more, % |\n|---|---|---|"
    );
    for programme in Programme::ALL {
        let of = |map: &BTreeMap<Programme, Share>| map.get(&programme).copied().unwrap_or_default();
        let (alarms, found) = (of(&score.alarms_of_programme), of(&score.found_of_programme));
        let _ = writeln!(text, "| {} | {} | {} |", programme.name(), upper(alarms), counted(found));
    }
    let _ = writeln!(text, "\n| noise of a null run | said to be undecided, % (upper limit) |\n|---|---|");
    score.undecided.iter().for_each(|(family, share)| _ = writeln!(text, "| {} | {} |", family.name(), upper(*share)));
    let missed = score.undecided_missed;
    let _ = writeln!(
        text,
        "\nOf effects of k = 15 and more, pairs and unknown ones among them, of which none is named: undecided {}.",
        counted(missed)
    );
    let _ = writeln!(text, "\n| damage that is no effect | a wrong name, % (upper limit) |\n|---|---|");
    score.decoys.iter().for_each(|(decoy, share)| _ = writeln!(text, "| {} | {} |", decoy.name(), upper(*share)));
}

/// Strengths of the table of poles, in tenths.
const POLES: [u64; 6] = [60, 80, 100, 150, 200, 500];

/// Whether what was said of an effect, first, is right of the true one.
type IsRight = fn(&str, &str) -> bool;

/// What searches find that know more than anyone can.
fn possible(text: &mut String, score: &Score, strengths: &[u64]) {
    if score.ideal_null.is_empty() || score.ideal.is_empty() {
        return;
    }
    type Of = fn(&Ideal) -> &Best;
    let least = |of: Of| found_from(score, of, ALARMS).unwrap_or(f64::NAN);
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
    let is_right: IsRight = |said, true_one| said == true_one;
    let is_of_family: IsRight = |said, true_one| family(said) == family(true_one);
    let told: [(&str, IsRight); 2] = [("first name", is_right), ("family", is_of_family)];
    for (what, is_right) in told {
        for ((name, of), least) in ways.into_iter().zip([known, drawn]) {
            row(text, &format!("{what} right with {name}, %"), strengths, |k| {
                share(k, &|p| of(&p.ideal).evidence > least, &|p| is_right(&of(&p.ideal).effect, &p.effect))
            });
        }
        row(text, &format!("{what} right in the diagnosis, %"), strengths, |k| {
            share(k, &|p| p.said.is_some(), &|p| p.said.as_ref().is_some_and(|said| is_right(said, &p.effect)))
        });
    }
    let runs = || score.ideal.values().flatten();
    let per_run = |wrong: usize| wrong as f64 / runs().count() as f64;
    let by_lottery = runs().filter(|p| p.ideal.drawn.evidence > drawn && p.ideal.drawn.effect != p.effect).count();
    let by_diagnosis = runs().filter(|p| p.said.as_ref().is_some_and(|said| *said != p.effect)).count();
    let _ = writeln!(
        text,
        "\nWrong first names per run: {:.3} with the lottery of the noise, {:.3} in the diagnosis, of {} runs.",
        per_run(by_lottery),
        per_run(by_diagnosis),
        runs().count()
    );
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
* Wrong terms: at k = 50 the difference between the generator's form of an effect and the catalogue's is four to ten standard \
deviations by itself, and is named.
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
    for (k, target) in [(60, 90.0), (80, 95.0), (100, 97.0)] {
        share_line(format!("first name right at k = {}", k / 10), target, at(&score.first_exact, k));
    }
    for k in [60, 80, 100] {
        share_line(format!("family right at k = {}", k / 10), 98.0, at(&score.first_family, k));
    }
    share_line("ambiguous set holds the truth, all k".to_owned(), 97.0, pooled(score.set_holds.values().copied()));
    share_line("outside the catalogue, right covariate, k = 20".to_owned(), 92.0, at(&score.outside_covariate, 200));
    share_line("effects that the run cannot show, said so".to_owned(), 99.0, pooled(score.absorbed_said.values().copied()));
    for (k, target) in [(50, 0.85), (60, 0.85), (80, 0.95), (100, 0.95)] {
        let of = score.ideal.get(&k).map_or(0, Vec::len);
        let name = format!("found at k = {}, over what is found by one who knows the lottery of the noise", k / 10);
        for (alarms, with) in [(ALARMS, ""), (alarms_of_diagnosis(score), ", with no more false alarms than the diagnosis")] {
            let ratio = relative_power(score, k, alarms).unwrap_or(f64::NAN);
            line(&format!("{name}{with}"), target, true, ratio, format!("{ratio:.2} of {of}"), "");
        }
    }
    for k in [80, 150] {
        let (both, one) = (at(&score.two_exact, k), score.found_at(k));
        let ratio = both.percent() / 100.0 / (one.percent() / 100.0).powi(2);
        let name = format!("two effects, both exact, over the square of the power of one, k = {}", k / 10);
        line(&name, 0.9, true, ratio, format!("{ratio:.2} ({} over {} squared)", counted(both), counted(one)), "");
    }
    let wrong = at(&score.outside_wrong, 200);
    line("outside the catalogue, confident wrong name, k = 20", 1.0, false, wrong.percent(), upper(wrong), " %");
    let wrong = score.is_wrong;
    line("steps that say \"is\" and are wrong, of all steps", 0.5, false, wrong.percent(), upper(wrong), " %");
    let decoys = pooled(score.decoys.values().copied());
    line("damage that is no effect is named as one", 1.0, false, decoys.percent(), upper(decoys), " %");
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
    for (name, cover) in [("one effect", score.interval), ("two effects", score.interval_two)] {
        let off = if cover.of == 0 { f64::NAN } else { (cover.percent() - 95.0).abs() };
        line(&format!("intervals of 95 % of amplitudes, {name}: distance from 95 %"), 1.5, false, off, counted(cover), " %");
    }
    if further > 0.0 {
        let _ = writeln!(
            text,
            "\nWrong terms that name the hidden effect beside them as one that they may be taken for: {:.0} % of {}.",
            score.further_in_set.percent(),
            score.further_in_set.of
        );
    }
}

/// What is found at a strength over what is found by one who knows the lottery from which the noise is drawn, of the same runs.
fn relative_power(score: &Score, k: u64, alarms: f64) -> Option<f64> {
    let runs = score.ideal.get(&k)?;
    let found = runs.iter().filter(|p| p.said.is_some()).count() as f64;
    Some(100.0 * found / runs.len() as f64 / lottery_power(score, k as f64 / 10.0, alarms)?.percent())
}

/// Part of the effects in plateau means that is found at a strength by one who knows the lottery from which the noise is drawn, with this part of false
/// alarms.
pub(super) fn lottery_power(score: &Score, k: f64, alarms: f64) -> Option<Share> {
    let least = found_from(score, |i| &i.drawn, alarms)?;
    let runs = score.ideal.get(&tenths(k))?;
    Some(Share { hits: runs.iter().filter(|p| p.ideal.drawn.evidence > least).count() as u64, of: runs.len() as u64 })
}

/// Part of null runs in which someone who knows more may name something: the target of the diagnosis.
pub(super) const ALARMS: f64 = 0.01;

/// Part of the same null runs in which the diagnosis names something, of one run at least.
fn alarms_of_diagnosis(score: &Score) -> f64 {
    let Share { hits, of } = score.ideal_null_named;
    hits.max(1) as f64 / of.max(1) as f64
}

/// Evidence that this part of null runs exceeds for someone who knows more.
fn found_from(score: &Score, of: impl Fn(&Ideal) -> &Best, alarms: f64) -> Option<f64> {
    let mut null: Vec<f64> = score.ideal_null.iter().map(|i| of(i).evidence).collect();
    null.sort_by(|a, b| b.total_cmp(a));
    null.get((alarms * null.len() as f64).round() as usize).copied()
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
