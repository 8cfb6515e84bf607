//! Damages x kinds of flight inputs: whether damaged telemetry, a damaged table beside it or a wrong configuration is refused, warned of, or gives
//! another field without a word.

mod damage;
mod table;

pub use damage::{ALL, Damage, Inputs};

use crate::damages::{self, Outcome, called, silent, words};
use crate::repository;
use calfit::data::flags::Flags;
use calfit::data::time::LeapSeconds;
use calfit::files::table::series::SeriesTable;
use rayon::prelude::*;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use table::Table;

/// A field is wrong if it is off by more than so many of its standard uncertainties.
const WRONG: f64 = 5.0;

/// A kind of flight input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Telemetry of the primary sensor.
    Science,
    /// The same as text.
    Csv,
    /// Housekeeping, which a field follows.
    Housekeeping,
    Attitude,
    Wheels,
    /// When heaters are on, of which the field is taken off by it.
    Heaters,
    /// `flight.toml`.
    Configuration,
}

impl Kind {
    pub const ALL: [Kind; 7] =
        [Kind::Science, Kind::Csv, Kind::Housekeeping, Kind::Attitude, Kind::Wheels, Kind::Heaters, Kind::Configuration];

    pub fn name(self) -> &'static str {
        match self {
            Kind::Science => "science",
            Kind::Csv => "science CSV",
            Kind::Housekeeping => "housekeeping",
            Kind::Attitude => "attitude",
            Kind::Wheels => "wheels",
            Kind::Heaters => "heaters",
            Kind::Configuration => "flight.toml",
        }
    }

    /// Its files in the folder of the mission.
    fn files(self) -> &'static [&'static str] {
        match self {
            Kind::Science | Kind::Csv => {
                &["edited/sensor=OB/date=2015-06-30/part-0.parquet", "edited/sensor=OB/date=2015-07-01/part-0.parquet"]
            }
            Kind::Housekeeping => &["hk/date=2015-06-30/part-0.parquet", "hk/date=2015-07-01/part-0.parquet"],
            Kind::Attitude => &["attitude/attitude.parquet"],
            Kind::Wheels => &["wheels/wheels.parquet"],
            Kind::Heaters => &["heater/romap.parquet"],
            Kind::Configuration => &[],
        }
    }

    /// The configuration that needs such files.
    fn configuration(self, plain: &str) -> String {
        match self {
            Kind::Heaters => plain.replace("classes = [\"h1\", \"h2\"]", "classes = [\"h1\", \"h2\"]\nmethod = 2"),
            Kind::Housekeeping => format!(
                "{plain}\n[[disturbance]]\ncolumn = \"pos_voltage\"\nvector_nt_per_unit = [0.1, 0.05, -0.02]\n[pipeline]\nsteps = [\"counts\", \
                 \"temperature\", \"ground\", \"daily\", \"shift\", \"disturbance\", \"rotate\", \"offsets\", \"attitude\"]\n"
            ),
            _ => plain.to_owned(),
        }
    }
}

/// A vector of a level: field, its standard uncertainty, flags.
#[derive(Clone, Copy)]
struct Vector {
    field_nt: [f64; 3],
    std_nt: [f64; 3],
    flags: u32,
    /// Vectors that a mean is of; 0 of a single one.
    count: i64,
}

/// Level and sensor, time and mode of a vector; of equal ones, the number.
type Key = (String, i64, String, usize);
type Vectors = HashMap<Key, Vector>;

/// What became of a mission.
struct Made {
    status: u8,
    told: String,
    /// Notes, by the day or mission that they are of.
    notes: BTreeSet<String>,
    /// Whether days failed.
    failed: bool,
    vectors: Vectors,
}

/// The mission without damage: `configs/rosetta-telemetry.toml` with exact ground files.
pub struct Undamaged {
    folder: tempfile::TempDir,
    configuration: String,
    leap: LeapSeconds,
}

impl Undamaged {
    /// Simulates it.
    ///
    /// # Errors
    /// The twin cannot be read or simulated.
    pub fn new() -> Result<Self, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let twin = repository("configs/rosetta-telemetry.toml");
        let (status, _, told) = called(["simulate".into(), twin.into()], folder.path());
        if status != 0 {
            return Err(told.into());
        }
        std::fs::remove_dir_all(folder.path().join("truth"))?;
        let configuration = std::fs::read_to_string(folder.path().join("flight.toml"))?;
        Ok(Self { folder, configuration, leap: LeapSeconds::default() })
    }

    /// The inputs of a kind.
    ///
    /// # Errors
    /// They cannot be read.
    fn inputs(&self, kind: Kind) -> Result<Inputs, Box<dyn Error>> {
        let read = |of: &dyn Fn(&str) -> String| -> Result<Vec<Table>, Box<dyn Error>> {
            kind.files().iter().map(|file| Table::read(&self.folder.path().join(of(file)), &self.leap)).collect()
        };
        let is_science = matches!(kind, Kind::Science | Kind::Csv);
        Ok(Inputs {
            kind,
            tables: read(&str::to_owned)?,
            others: if is_science { read(&|file| file.replace("sensor=OB", "sensor=IB"))? } else { Vec::new() },
            configuration: kind.configuration(&self.configuration),
            bytes: None,
            gone: false,
        })
    }

    /// Writes a mission with these inputs and makes levels of it.
    ///
    /// # Errors
    /// It cannot be written.
    fn made(&self, inputs: &Inputs, levels: &str) -> Result<Made, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        copy(self.folder.path(), folder.path())?;
        std::fs::write(folder.path().join("flight.toml"), &inputs.configuration)?;
        for (file, table) in inputs.kind.files().iter().zip(&inputs.tables) {
            let path = folder.path().join(file);
            std::fs::remove_file(&path)?;
            let (path, bytes) = match inputs.kind {
                Kind::Csv => (path.with_extension("csv"), table.csv(&self.leap).into_bytes()),
                _ => (path, table.parquet()?),
            };
            if !inputs.gone {
                std::fs::write(path, inputs.bytes.map_or(bytes.clone(), |change| change(bytes)))?;
            }
        }
        let out = folder.path().join("levels");
        let arguments = ["flight".into(), levels.into(), folder.path().join("flight.toml").into()];
        let (status, view, told) = called(arguments, &out);
        let told = told.replace(&folder.path().display().to_string(), "");
        let texts = |value: Option<&Value>| -> Vec<String> {
            let list = value.and_then(Value::as_array).into_iter().flatten();
            list.filter_map(|v| v.as_str().map(plain)).collect()
        };
        let mut notes: BTreeSet<String> = texts(view.get("notes")).into_iter().collect();
        for day in view.get("days").and_then(Value::as_array).into_iter().flatten() {
            let name = |key: &str| day.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
            let count = |key: &str| day.get(key).and_then(Value::as_u64).unwrap_or(0);
            notes.extend(texts(day.get("notes")).into_iter().map(|note| format!("{} {}: {note}", name("sensor"), name("day"))));
            // What the terminal tells of rows.
            let rows = ["conflicts", "contradicting"].into_iter().filter(|key| count(key) > 0);
            notes.extend(rows.map(|key| format!("{} {}: {key}", name("sensor"), name("day"))));
        }
        let failed = view.get("failed").and_then(Value::as_array).is_some_and(|list| !list.is_empty());
        Ok(Made { status, told, notes, failed, vectors: vectors(&out) })
    }
}

/// A text without its numbers, which differ between notes on the same thing.
fn plain(text: &str) -> String {
    text.chars().filter(|c| !c.is_ascii_digit() && !".-+e".contains(*c)).collect()
}

fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            copy(&entry.path(), &target)?;
        } else {
            std::fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}

fn files(folder: &Path, list: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        match entry.path() {
            path if path.is_dir() => files(&path, list),
            path if path.extension().is_some_and(|end| end == "parquet") => list.push(path),
            _ => {}
        }
    }
}

/// The vectors of all levels in a folder; housekeeping has none.
fn vectors(out: &Path) -> Vectors {
    let mut list = Vec::new();
    files(out, &mut list);
    list.sort_unstable();
    let mut all = Vectors::new();
    for path in list {
        let Ok(table) = SeriesTable::open(&path) else { continue };
        let three = |prefix: &str| ["x", "y", "z"].map(|axis| table.numbers(&format!("{prefix}{axis}")).unwrap_or_default());
        let (field, own, common) = (three("b"), three("ua_"), three("uc_"));
        let (Ok(time), Ok(mode), Ok(flags)) = (table.whole("time_tt2000"), table.words("sid"), table.whole("flags")) else {
            continue;
        };
        if own[0].len() != time.len() {
            continue;
        }
        let counts = table.whole("count").unwrap_or_default();
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        // calfit-A-OB-20150630.parquet
        let level: String = name.split('-').skip(1).take(2).collect::<Vec<_>>().join(" ");
        let mut repeated: HashMap<(i64, u32), usize> = HashMap::new();
        for row in 0..time.len() {
            let count = repeated.entry((time[row], mode.codes[row])).or_default();
            let key = (level.clone(), time[row], mode.words[mode.codes[row] as usize].clone(), *count);
            *count += 1;
            let field_nt = field.each_ref().map(|c| c[row]);
            let std_nt = [0, 1, 2].map(|i| own[i][row].hypot(common[i][row]));
            let count = counts.get(row).copied().unwrap_or(0);
            all.insert(key, Vector { field_nt, std_nt, flags: u32::try_from(flags[row]).unwrap_or(0), count });
        }
    }
    all
}

/// A damage in a kind of input.
pub type Cell = damages::Cell<Kind>;

/// Some damages in some kinds of input, seen in some levels.
///
/// # Errors
/// The mission cannot be simulated, or has no levels without damage.
pub fn table(kinds: &[Kind], damages: &[&Damage], levels: &str) -> Result<Vec<Cell>, Box<dyn Error>> {
    let undamaged = Undamaged::new()?;
    let mut cells = Vec::new();
    for kind in kinds {
        let inputs = undamaged.inputs(*kind)?;
        let whole = undamaged.made(&inputs, levels)?;
        if whole.status != 0 || whole.vectors.is_empty() {
            return Err(format!("{}: the mission without damage has no levels: {}", kind.name(), whole.told).into());
        }
        let own: Vec<Result<Cell, String>> = damages
            .par_iter()
            .map(|damage| {
                let mut damaged = inputs.clone();
                let is_there = (damage.apply)(&mut damaged) && is_changed(&inputs, &damaged);
                let (outcome, told) = if is_there {
                    let found = undamaged.made(&damaged, levels).map_err(|e| e.to_string())?;
                    (
                        outcome(*kind, damage.name, &whole, &found),
                        found.told + &found.notes.iter().cloned().collect::<Vec<_>>().join("\n"),
                    )
                } else {
                    (Outcome::NotThere, String::new())
                };
                Ok(Cell { damage: damage.name, kind: *kind, outcome, told })
            })
            .collect();
        cells.extend(own.into_iter().collect::<Result<Vec<Cell>, String>>()?);
    }
    Ok(cells)
}

fn is_changed(before: &Inputs, after: &Inputs) -> bool {
    after.gone || after.bytes.is_some() || after.configuration != before.configuration || after.tables != before.tables
}

fn outcome(kind: Kind, damage: &str, whole: &Made, found: &Made) -> Outcome {
    if found.status > 1 || found.failed {
        return Outcome::Refused;
    }
    let mut told = BTreeSet::new();
    if found.notes.difference(&whole.notes).next().is_some() {
        told.insert("note".to_owned());
    }
    // A vector that has a new flag is told of; one that is gone is no wrong one.
    let mut worst: BTreeMap<bool, (f64, &str)> = BTreeMap::new();
    let is_flagged = |key: &Key, before: &Vector| found.vectors.get(key).is_some_and(|after| after.flags & !before.flags != 0);
    // What both sensors share is made of all vectors at once, also of those that are left of a day with flags.
    let any_flag = whole.vectors.iter().any(|(key, before)| is_flagged(key, before));
    for (key, before) in whole.vectors.iter().filter(|(key, _)| !(any_flag && key.0.starts_with('J'))) {
        // The mean of fewer vectors is another one, and says of how many it is.
        let Some(after) = found.vectors.get(key).filter(|after| after.count == before.count) else { continue };
        let z = (0..3).map(|i| (after.field_nt[i] - before.field_nt[i]).abs() / after.std_nt[i].min(before.std_nt[i]));
        let z = z.filter(|z| z.is_finite()).fold(0.0, f64::max);
        // Beside a heater that switches a vector is not that of the field alone, and says so; without damage it is no truth either.
        let is_told = is_flagged(key, before) || (after.flags | before.flags) & Flags::HEATER.0 != 0;
        let own = worst.entry(is_told).or_insert((0.0, ""));
        if (z, key.0.as_str()) > *own {
            *own = (z, key.0.as_str());
        }
    }
    if worst.get(&true).is_some_and(|(z, _)| *z > WRONG) {
        told.insert("flags".to_owned());
    }
    let (z, level) = worst.get(&false).copied().unwrap_or((0.0, ""));
    match (told.is_empty() || (z > WRONG && !told.contains("note")), z > WRONG, not_visible(kind, damage)) {
        (false, ..) => Outcome::Warned(told),
        (true, false, _) => Outcome::Unmoved(z),
        (true, true, Some(reason)) => Outcome::NotVisible(reason),
        (true, true, None) => Outcome::Silent(z, level.to_owned()),
    }
}

/// Why a damage cannot be seen in a kind of input.
fn not_visible(kind: Kind, damage: &str) -> Option<&'static str> {
    const ATTITUDE: &str = "nothing else tells how the spacecraft stands: rows of the attitude are looked at against each other, and what the \
                            table says of itself against the configuration";
    let is_turn = ["first column reversed", "first two columns exchanged", "conjugated", "scalar last", "+ 20 min", "- 20 min"];
    match (kind, damage) {
        (Kind::Attitude, _) if is_turn.contains(&damage) => Some(ATTITUDE),
        (Kind::Configuration, "scalar last stated" | "other direction of the attitude stated") => Some(ATTITUDE),
        (Kind::Housekeeping, "first column x 2" | "first column x 1.1 from 60 % on") => Some(
            "what follows a channel is taken off both sensors alike, and the field outside changes by more: nothing else tells the scale of a channel",
        ),
        (Kind::Configuration, "shift of SID4 missing") => Some("nothing else tells the delay of a mode"),
        (Kind::Configuration, "heater interval half an hour late") => {
            Some("which steps of the field outside of the stated intervals are those of heaters is not known")
        }
        _ => None,
    }
}

const HEAD: &str = "# Damaged flight inputs\n\n\
`cargo run --release -p calfit-studies --bin damages -- flight` makes the mission of `configs/rosetta-telemetry.toml`, damages one kind of its\n\
inputs, and makes all levels as a user does. `refused`: days or the whole are not made, with the reason. `note`: they are made with a note that\n\
the mission without damage does not have. `flags`: the vectors that are wrong have a flag that they do not have without damage, or that of a\n\
heater that switches, with or without it. A number in brackets: not a word, and no vector moves by more than so many of its standard uncertainties. `not visible`: vectors are wrong and nothing in\n\
the inputs can show it, for the reason below. `-`: the kind has nothing that the damage could change.\n";

/// The table in Markdown, with the reasons why damages are not visible.
#[must_use]
pub fn report(cells: &[Cell], kinds: &[Kind]) -> String {
    let mut text = format!("{HEAD}\n| damage | {} |\n", kinds.iter().map(|k| k.name()).collect::<Vec<_>>().join(" | "));
    let _ = writeln!(text, "|---|{}", "---|".repeat(kinds.len()));
    for name in cells.iter().filter(|c| c.kind == kinds[0]).map(|c| c.damage) {
        let own: Vec<&Cell> = cells.iter().filter(|c| c.damage == name).collect();
        if own.iter().all(|c| c.outcome == Outcome::NotThere) {
            continue;
        }
        let told: Vec<String> = own.iter().map(|c| words(&c.outcome)).collect();
        let _ = writeln!(text, "| {name} | {} |", told.join(" | "));
    }
    let mut reasons: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    for cell in cells {
        if let Outcome::NotVisible(reason) = cell.outcome {
            reasons.entry(reason).or_default().insert(format!("{} ({})", cell.damage, cell.kind.name()));
        }
    }
    if !reasons.is_empty() {
        text.push_str("\nNot visible:\n\n");
    }
    for (reason, of) in reasons {
        let _ = writeln!(text, "* {}: {reason}.", of.into_iter().collect::<Vec<_>>().join(", "));
    }
    let made = cells.iter().filter(|c| c.outcome != Outcome::NotThere).count();
    let _ = writeln!(text, "\n{made} damaged missions; wrong without a word: {}.", silent(cells).len());
    text
}
