//! The blind study of the diagnosis.
//!
//!     cargo run --release -p calfit-studies --bin blind [-- --null 2000 --effects 3000 --kinds lin,sweep --minutes 60 --first 0]
//!     cargo run --release -p calfit-studies --bin blind -- --dump DIR --case SEED [with the options of the study that it is a case of]
//!     cargo run --release -p calfit-studies --bin blind -- --dump DIR --seed N [--kinds lin] [--hide cubic_nonlinearity,...] [--k 8]
//!     cargo run --release -p calfit-studies --bin blind -- --check 200
//!     cargo run --release -p calfit-studies --bin blind -- --names 40 [--first 0]
//!     cargo run --release -p calfit-studies --bin blind -- --pairs 100 [--first 0]
//!
//! The first writes `reports/blind-study.md` and its pictures (or into `--out DIR`), again and again while it goes on, and ends early after
//! `--minutes`; `--first` takes other draws, `--again FILE` only the cases whose numbers are the first words of its lines. The others write run files with `truth.json` beside
//! them, those of a case of a study or new ones. `--check` measures every effect and noise family with a matched filter over many draws of the noise: the mean must be the
//! strength that was asked for, the standard deviation one. `--names` tells how often the names of effects that resemble each other can be right
//! for someone who knows noise, axes and forms, and how often they are; `--pairs` the same of two effects in one linearity run.

use calfit::files::ccr::{Decimals, Section, Writer};
use calfit::model::position::Position;
use calfit_studies::blind::kinds::{Measure, generate, nuisance, plateau_cells, sample_cells};
use calfit_studies::blind::noise::{Family, Random};
use calfit_studies::blind::sensor::Kind;
use calfit_studies::blind::{self, Options, effects, names, pairs, picture, report, score};
use calfit_studies::repository;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

/// `--name value` pairs.
fn arguments() -> Result<BTreeMap<String, String>, Failure> {
    const KNOWN: [&str; 15] = [
        "null", "effects", "first", "kinds", "out", "dump", "case", "seed", "hide", "k", "check", "names", "pairs", "minutes",
        "again",
    ];
    let mut given = BTreeMap::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let name = word.strip_prefix("--").filter(|name| KNOWN.contains(name));
        let name = name.ok_or_else(|| format!("{word}: not an option; there are --{}", KNOWN.join(", --")))?;
        let value = words.next().ok_or_else(|| format!("{word}: a value must follow"))?;
        given.insert(name.to_owned(), value);
    }
    Ok(given)
}

fn kinds(given: Option<&String>) -> Result<Vec<Kind>, Failure> {
    let Some(given) = given else { return Ok(Kind::ALL.to_vec()) };
    let of = |name: &str| Kind::ALL.into_iter().find(|kind| kind.name() == name);
    let names = || Kind::ALL.map(Kind::name).join(", ");
    Ok(given
        .split(',')
        .map(|name| of(name).ok_or_else(|| format!("--kinds {name}: no such kind; there are {}", names())))
        .collect::<Result<_, _>>()?)
}

fn main() -> Result<(), Failure> {
    let given = arguments()?;
    let number = |name: &str, default: u64| -> Result<u64, Failure> {
        given.get(name).map_or(Ok(default), |v| v.parse().map_err(|e| format!("--{name} {v}: {e}; give a whole number").into()))
    };
    let kinds = kinds(given.get("kinds"))?;
    let (null, with_effects, first) = (number("null", 2000)?, number("effects", 3000)?, number("first", 0)?);
    let mut cases = score::plan_from(first, null, with_effects, &kinds);
    if let (Some(folder), Some(_)) = (given.get("dump"), given.get("case")) {
        let seed = number("case", 0)?;
        let case = cases.iter().find(|case| case.seed == seed).ok_or_else(|| format!("--case {seed}: not in this study"))?;
        return dump(Path::new(folder), seed, case.kind, &case.options);
    }
    if let Some(folder) = given.get("dump") {
        let k = given.get("k").map_or(Ok(8.0), |v| v.parse()).map_err(|e| format!("--k: {e}; give a number"))?;
        let hidden: Option<Vec<String>> = given.get("hide").map(|names| names.split(',').map(str::to_owned).collect());
        let (seed, kind) = (number("seed", 1)?, kinds[0]);
        let drawn = || {
            let mut random = Random::new(seed, "dump");
            let names = effects::visible(kind);
            vec![names[random.below(names.len())].to_owned()]
        };
        let effects = hidden.unwrap_or_else(drawn).into_iter().filter(|name| !name.is_empty()).collect();
        return dump(Path::new(folder), seed, kind, &Options { effects, strength_k: k, noise: None, ..Options::default() });
    }
    if given.contains_key("check") {
        return check(&kinds, number("check", 200)?);
    }
    if given.contains_key("names") {
        print!("{}", names::table(first, number("names", 40)?));
        return Ok(());
    }
    if given.contains_key("pairs") {
        print!("{}", pairs::table(kinds[0], first, number("pairs", 100)?));
        return Ok(());
    }
    if let Some(path) = given.get("again") {
        let text = fs::read_to_string(path)?;
        let wanted: BTreeSet<u64> = text.lines().filter_map(|line| line.split_whitespace().next()?.parse().ok()).collect();
        cases.retain(|case| wanted.contains(&case.seed));
    }
    let minutes = number("minutes", u64::MAX)?;
    let begin = Instant::now();
    // A study that is stopped has some of everything.
    Random::new(0, "order").shuffle(&mut cases);
    let out = given.get("out").map_or_else(|| repository("reports"), PathBuf::from);
    fs::create_dir_all(&out)?;
    let names = kinds.iter().map(|k| k.name()).collect::<Vec<_>>().join(",");
    let mut command =
        format!("cargo run --release -p calfit-studies --bin blind -- --null {null} --effects {with_effects} --kinds {names}");
    if first > 0 {
        command.push_str(&format!(" --first {first}"));
    }
    let mut judged = Vec::new();
    for part in cases.chunks(AT_ONCE) {
        if begin.elapsed().as_secs() / 60 >= minutes {
            break;
        }
        judged.extend(score::run(part, blind::judge::judge_beside_ideal, || {})?);
        eprintln!("{} of {}", judged.len(), cases.len());
        write(&out, &score::Score::of(&judged), &command, cases.len())?;
        fs::write(out.join(CASES), judged.iter().map(score::Judged::line).collect::<String>())?;
    }
    print!("{}", fs::read_to_string(out.join(TABLES))?);
    Ok(())
}

/// Cases that are judged before the tables are written again.
const AT_ONCE: usize = 100;
/// What was hidden and said in each case.
const CASES: &str = "blind-study-cases.txt";
/// The tables.
const TABLES: &str = "blind-study.md";

/// Tables and pictures of what was judged so far.
fn write(out: &Path, score: &score::Score, command: &str, planned: usize) -> Result<(), Failure> {
    let mut text = report::report(score, command, planned);
    text.push_str(
        "\n![Effects found against their strength](blind-study-power.png)\n\n![Confusion of names](blind-study-confusion.png)\n",
    );
    fs::write(out.join(TABLES), &text)?;
    fs::write(out.join("blind-study-power.png"), picture::power(score)?)?;
    fs::write(out.join("blind-study-confusion.png"), picture::confusion(score)?)?;
    Ok(())
}

/// `campaign.toml` with the positions.
fn campaign_text(blind: &blind::Blind) -> String {
    let entry = |(id, position): &(u32, Position)| format!("[[position]]\nid = {id}\naxes = {:?}\n", position.names());
    blind.campaign.file.instructions.positions.iter().map(entry).collect::<Vec<_>>().join("\n")
}

/// Run files of one set in a campaign folder, with `truth.json`.
fn dump(folder: &Path, seed: u64, kind: Kind, options: &Options) -> Result<(), Failure> {
    let blind = generate(seed, kind, options)?;
    fs::create_dir_all(folder)?;
    fs::write(folder.join("campaign.toml"), campaign_text(&blind))?;
    fs::write(folder.join("truth.json"), serde_json::to_string_pretty(&blind.truth)? + "\n")?;
    for (run, vectors) in &blind.runs {
        let (day, time) = run.header.run.split_once('_').ok_or("a run id has a day and a time")?;
        fs::create_dir_all(folder.join(day))?;
        let path = folder.join(day).join(format!("{time}.CCR"));
        let decimals = Decimals { time: if kind == Kind::Sweep { 1 } else { 4 }, ..Decimals::default() };
        let mut writer = Writer::new(fs::File::create(&path)?, &run.header, decimals)?;
        if run.blocks.is_empty() {
            writer.fields(&run.settings)?;
        } else {
            writer.blocks(&run.blocks)?;
        }
        writer.slow(Section::Temperatures, &run.temperatures)?;
        if !run.channels.names.is_empty() {
            writer.slow(Section::Channels, &run.channels)?;
        }
        if !vectors.is_empty() {
            writer.vectors(vectors.iter().copied())?;
        }
        writer.end()?;
        println!("{}", path.display());
    }
    Ok(())
}

/// Matched filters over many draws of the noise, per kind and family and per kind and effect.
fn check(kinds: &[Kind], draws: u64) -> Result<(), Failure> {
    const WANTED: f64 = 6.0;
    println!(
        "| kind | noise | effect | k asked | k reached | mean | standard deviation | survives | ms per run |\n|---|---|---|---|---|---|---|---|---|"
    );
    for kind in kinds {
        let mut cases: Vec<(&str, Family)> = Vec::new();
        for (index, name) in effects::visible(*kind).iter().chain(effects::outside(*kind)).enumerate() {
            cases.push((name, Family::WITHOUT_SPIKES[index % Family::WITHOUT_SPIKES.len()]));
        }
        let seen = if *kind == Kind::ZeroField { "offset_drift" } else { effects::visible(*kind)[0] };
        cases.extend(Family::WITHOUT_SPIKES.map(|family| (seen, family)));
        for (index, (name, family)) in cases.into_iter().enumerate() {
            let options =
                Options { effects: vec![name.to_owned()], strength_k: WANTED, noise: Some(family), ..Options::default() };
            let begin = std::time::Instant::now();
            let blind = generate(index as u64 + 1, *kind, &options)?;
            let ms = begin.elapsed().as_secs_f64() * 1e3;
            let effect = &blind.truth.effects[0];
            if effect.natural_size {
                println!(
                    "| {} | {} | {name} | natural | {:.1} | - | - | {:.2} | {ms:.0} |",
                    kind.name(),
                    family.name(),
                    effect.strength_k,
                    effect.surviving_share
                );
                continue;
            }
            let cells =
                if effect.seen_inside_plateaus { sample_cells(&blind.clean_runs) } else { plateau_cells(&blind.clean_runs) };
            let own = nuisance(&blind.clean_runs, &cells);
            let measure = Measure::new(&blind.clean_runs, &blind.truth.noise, cells, &own);
            let hidden = hidden_records(&blind);
            let (_, template) = measure.white(&hidden);
            let norm = template.iter().map(|v| v * v).sum::<f64>().sqrt();
            let values: Vec<f64> = (0..draws)
                .into_par_iter()
                .map(|draw| {
                    let mut random = Random::new(draw, "matched filter");
                    let mut records: Vec<Vec<[f64; 3]>> =
                        blind.clean_runs.iter().map(|s| blind.truth.noise.record(s, &mut random)).collect();
                    for (record, hidden) in records.iter_mut().zip(&hidden) {
                        record.iter_mut().zip(hidden).for_each(|(r, h)| (0..3).for_each(|i| r[i] += h[i]));
                    }
                    let (_, white) = measure.white(&records);
                    white.iter().zip(&template).map(|(a, b)| a * b).sum::<f64>() / norm
                })
                .collect();
            let mean = values.iter().sum::<f64>() / draws as f64;
            let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (draws - 1) as f64).sqrt();
            println!(
                "| {} | {} | {name} | {WANTED} | {:.3} | {mean:.3} | {std:.3} | {:.2} | {ms:.0} |",
                kind.name(),
                family.name(),
                effect.strength_k,
                effect.surviving_share
            );
        }
    }
    Ok(())
}

/// The effects alone, in the samples.
fn hidden_records(blind: &blind::Blind) -> Vec<Vec<[f64; 3]>> {
    let mut sum: Vec<Vec<[f64; 3]>> = blind.clean_runs.iter().map(|s| vec![[0.0; 3]; s.count]).collect();
    for effect in &blind.hidden_ent {
        for (total, record) in sum.iter_mut().zip(effect) {
            total.iter_mut().zip(record).for_each(|(t, r)| (0..3).for_each(|i| t[i] += r[i]));
        }
    }
    sum
}
