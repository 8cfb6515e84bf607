//! Damages x kinds of runs: whether a damaged run is refused, warned of, or gives other parameters without a word.

mod damage;
mod others;
mod parameters;
mod runs;
mod text;

pub use damage::{ALL, Damage};
pub use runs::{Kind, Undamaged, undamaged};

use parameters::parameters;
use rayon::prelude::*;
use serde_json::Value;
use std::collections::BTreeSet;
use std::error::Error;
use std::ffi::OsString;
use std::fmt::Write;
use std::path::Path;
use text::Text;

/// A wrong parameter is off by more than so many standard uncertainties.
const WRONG: f64 = 5.0;

/// What became of a run.
pub struct Analysed {
    /// Exit status.
    pub status: u8,
    /// What was printed on standard error.
    pub told: String,
    /// Warnings with their kinds.
    pub warnings: Vec<(String, String)>,
    /// Every parameter with its standard uncertainty.
    pub parameters: Vec<(String, f64, f64)>,
}

/// Analyses a run as a user does.
///
/// # Errors
/// Its files cannot be written.
pub fn analysed(kind: Kind, text: &Text, undamaged: &Undamaged) -> Result<Analysed, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let campaign = &undamaged.campaign;
    let path = match kind {
        Kind::Applied => return others::applied(text, &undamaged.runs[&Kind::Means], campaign, folder.path()),
        Kind::Imported => match others::imported(text, campaign, folder.path())? {
            Ok(path) => path,
            Err(refused) => return Ok(refused),
        },
        _ => runs::write(kind, text, campaign, folder.path())?,
    };
    let arguments = kind.command().iter().map(OsString::from).chain([path.into()]);
    let (status, view, told) = called(arguments, &folder.path().join("out"));
    let result = ["/runs/0/parameters", "/sweeps/0/parameters", "/parameters"].iter().find_map(|p| view.pointer(p));
    let texts = |key: &str| -> Vec<String> {
        let list = result.and_then(|r| r.get(key)).and_then(Value::as_array).into_iter().flatten();
        list.filter_map(|v| Some(v.as_str()?.to_owned())).collect()
    };
    Ok(Analysed {
        status,
        warnings: texts("warning_kinds").into_iter().zip(texts("warnings")).collect(),
        parameters: result.map(|r| parameters(kind, r)).unwrap_or_default(),
        told,
    })
}

/// Calls the program as a user does; its status, what it printed as JSON, and its messages.
pub(crate) fn called(arguments: impl IntoIterator<Item = OsString>, out: &Path) -> (u8, Value, String) {
    let mut all: Vec<OsString> = vec!["calfit".into()];
    all.extend(arguments);
    all.extend(["--no-plots", "--json", "--threads", "1", "-o"].map(Into::into));
    all.push(out.into());
    let (mut printed, mut told) = (Vec::new(), Vec::new());
    let status = calfit::cli::run(
        all,
        calfit::cli::Output { to: &mut printed, is_terminal: false },
        calfit::cli::Output { to: &mut told, is_terminal: false },
    );
    let view: Value = serde_json::from_slice(&printed).unwrap_or(Value::Null);
    (status as u8, view, String::from_utf8_lossy(&told).into_owned())
}

/// What is said of a damaged run.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The damage changes nothing in such a run.
    NotThere,
    Refused,
    /// With the kinds of the warnings that the undamaged run does not have.
    Warned(BTreeSet<String>),
    /// The parameters are those of the undamaged run within so many standard uncertainties.
    Unmoved(f64),
    /// They are wrong, and nothing in the run shows it.
    NotVisible(&'static str),
    /// They are wrong by so many standard uncertainties without a word.
    Silent(f64, String),
}

/// A damage in a kind of run, or in a kind of another input.
pub struct Cell<K = Kind> {
    pub damage: &'static str,
    pub kind: K,
    pub outcome: Outcome,
    pub told: String,
}

/// All damages in some kinds of runs.
///
/// # Errors
/// The runs cannot be made, or one without damage has no result.
pub fn table(kinds: &[Kind], damages: &[Damage]) -> Result<Vec<Cell>, Box<dyn Error>> {
    let undamaged = undamaged()?;
    let mut cells = Vec::new();
    for kind in kinds {
        let whole = analysed(*kind, &undamaged.runs[kind], &undamaged)?;
        if whole.status != 0 || whole.parameters.is_empty() {
            return Err(format!("{}: the run without damage has no result: {}", kind.name(), whole.told).into());
        }
        let own: Vec<Result<Cell, String>> = damages
            .par_iter()
            .map(|damage| {
                let mut text = undamaged.runs[kind].clone();
                let is_there = (damage.apply)(&mut text) && text.text() != undamaged.runs[kind].text();
                let (outcome, told) = if is_there {
                    let found = analysed(*kind, &text, &undamaged).map_err(|e| e.to_string())?;
                    (outcome(*kind, damage.name, &whole, &found), found.told)
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

fn outcome(kind: Kind, damage: &str, whole: &Analysed, found: &Analysed) -> Outcome {
    if found.parameters.is_empty() && found.status != 0 {
        return Outcome::Refused;
    }
    let plain = |text: &str| text.chars().filter(|c| !c.is_ascii_digit() && !".-+e".contains(*c)).collect::<String>();
    let known: BTreeSet<String> = whole.warnings.iter().map(|(_, text)| plain(text)).collect();
    let new: BTreeSet<String> =
        found.warnings.iter().filter(|(_, text)| !known.contains(&plain(text))).map(|(kind, _)| kind.clone()).collect();
    if !new.is_empty() {
        return Outcome::Warned(new);
    }
    if found.status != 0 {
        return Outcome::Refused;
    }
    // A parameter that is gone without a word is as wrong as can be.
    let mut worst = (0.0, String::new());
    for (name, before, _) in whole.parameters.iter().filter(|(_, before, _)| before.is_finite()) {
        let value_and_std = found.parameters.iter().find(|(n, ..)| n == name).map(|(_, value, std)| (value - before, *std));
        let z = match value_and_std {
            Some((0.0, _)) => 0.0,
            Some((off, std)) if off.is_finite() && std.is_finite() => off.abs() / std.max(1e-300),
            _ => f64::INFINITY,
        };
        if z > worst.0 {
            worst = (z, name.clone());
        }
    }
    match (worst.0 > WRONG, not_visible(kind, damage)) {
        (false, _) => Outcome::Unmoved(worst.0),
        (true, Some(reason)) => Outcome::NotVisible(reason),
        (true, None) => Outcome::Silent(worst.0, worst.1),
    }
}

/// Why a damage cannot be seen in a run of a kind.
fn not_visible(kind: Kind, damage: &str) -> Option<&'static str> {
    let exchanged = ["x and y exchanged", "y and z exchanged", "x, y, z turned round"].contains(&damage);
    let reversed = ["x reversed", "all axes reversed"].contains(&damage);
    let scaled = damage.starts_with("readings ") && damage != "readings rounded to 10 nT";
    match kind {
        Kind::ZeroField if scaled || exchanged || reversed => {
            Some("nothing is applied, so that no size, sign or axis of the readings is known")
        }
        Kind::Amplitudes if scaled => Some("the table does not say what was applied"),
        Kind::Sines if exchanged || damage == "readings of x x 2" => {
            Some("how the sensor stands in the field of the sines is not known, and their modulus stays within the factor 1.5")
        }
        Kind::Scalar if damage.starts_with("settings of X") || damage == "all settings reversed" => {
            Some("a modulus has no sign: the coil system that is mirrored in the same way gives the same moduli")
        }
        Kind::Applied if !damage.starts_with("temperature") => Some(
            "readings in flight have no reference: sizes, signs, axes and offsets are taken as they are, within the ranges of the calibration",
        ),
        Kind::Moving if damage == "channels of sensor and coil exchanged" => {
            Some("channels are told apart by their names alone, and any of the two bodies may be the warm one")
        }
        _ => None,
    }
}

const HEAD: &str = "# Damaged runs\n\n\
`cargo run --release -p calfit-studies --bin damages` makes small runs of every kind, damages them, and analyses them as a user does.\n\
`refused`: no result. A word: the result stands with a new warning of that kind. A number in brackets: no warning, and no parameter\n\
moves by more than so many of its standard uncertainties. `not visible`: parameters are wrong and nothing in such a run can show it, for\n\
the reason below. `-`: the kind has nothing that the damage could change.\n";

/// The answers that are wrong without a word.
#[must_use]
pub fn silent<K>(cells: &[Cell<K>]) -> Vec<&Cell<K>> {
    cells.iter().filter(|c| matches!(c.outcome, Outcome::Silent(..))).collect()
}

/// The table in Markdown, with the reasons why damages are not visible.
#[must_use]
pub fn report(cells: &[Cell], kinds: &[Kind]) -> String {
    let mut text = format!("{HEAD}\n| damage | {} |\n", kinds.iter().map(|k| k.name()).collect::<Vec<_>>().join(" | "));
    let _ = writeln!(text, "|---|{}", "---|".repeat(kinds.len()));
    let mut names: Vec<&str> = Vec::new();
    for cell in cells.iter().filter(|c| c.kind == kinds[0]) {
        names.push(cell.damage);
    }
    for name in names {
        let own = kinds.iter().map(|kind| {
            let cell = cells.iter().find(|c| c.damage == name && c.kind == *kind);
            cell.map_or_else(String::new, |c| words(&c.outcome))
        });
        let _ = writeln!(text, "| {name} | {} |", own.collect::<Vec<_>>().join(" | "));
    }
    text.push_str("\nNot visible:\n\n");
    for kind in kinds {
        let reasons: BTreeSet<&str> = cells
            .iter()
            .filter(|c| c.kind == *kind)
            .filter_map(|c| if let Outcome::NotVisible(r) = c.outcome { Some(r) } else { None })
            .collect();
        reasons.iter().for_each(|reason| {
            let _ = writeln!(text, "* {}: {reason}.", kind.name());
        });
    }
    let made = cells.iter().filter(|c| c.outcome != Outcome::NotThere).count();
    let _ = writeln!(text, "\n{made} damaged runs; wrong without a word: {}.", silent(cells).len());
    text
}

pub(crate) fn words(outcome: &Outcome) -> String {
    match outcome {
        Outcome::NotThere => "-".to_owned(),
        Outcome::Refused => "refused".to_owned(),
        Outcome::Warned(kinds) => kinds.iter().cloned().collect::<Vec<_>>().join(", "),
        Outcome::Unmoved(z) => format!("({z:.1})"),
        Outcome::NotVisible(_) => "not visible".to_owned(),
        Outcome::Silent(z, name) => format!("**SILENT** {name} {z:.0}"),
    }
}
