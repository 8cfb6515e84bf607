//! The walls of the house: which room may call which. The table is that of `docs/ARCHITECTURE.md`.

use std::collections::BTreeSet;
use std::path::Path;

/// The rooms of `src` from the highest floor to the lowest. A room may call those that stand after it, and itself.
const FLOORS: [&str; 13] =
    ["cli", "workflow", "show", "plot", "diagnose", "simulate", "flight", "measure", "record", "files", "model", "data", "fit"];
/// Calls down that are not wanted all the same: results know no layout of a file.
const FORBIDDEN: [(&str, &str); 1] = [("measure", "files")];

/// A source file: its path below `src`, with `/`, and its text.
type Source = (String, String);

/// Everything that a file calls outside of its own room, as (line, room).
fn calls((path, text): &Source) -> Vec<(usize, String)> {
    // So many `super` lead from the module of the file to the root.
    let mut depth = path.matches('/').count() + usize::from(!path.ends_with("mod.rs"));
    let mut list = Vec::new();
    let mut grouped = false;
    for (index, line) in text.lines().enumerate() {
        let code = line.split("//").next().unwrap_or_default();
        // The module of the tests in a file is one deeper.
        depth += usize::from(code.starts_with("#[cfg(test)]"));
        // `crate::room::…`, and `crate::{a::…, b::…}` over one or several lines.
        for piece in code.split("crate::").skip(1) {
            let name: String = piece.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
            if piece.starts_with('{') {
                grouped = true;
            } else {
                list.push((index + 1, name));
            }
        }
        if grouped {
            let inner = code.split("crate::{").last().unwrap_or_default();
            let first_words = inner.split(',').filter_map(|p| p.trim().split("::").next());
            list.extend(first_words.map(|w| (index + 1, w.trim_matches(['{', '}', ';', ' ']).to_owned())));
            grouped = !code.contains("};");
        }
        // A chain of `super` that reaches the root goes around the table.
        let words = code.split(|c: char| !(c.is_ascii_alphanumeric() || c == ':' || c == '_'));
        let supers = words.map(|word| word.matches("super::").count()).max().unwrap_or(0);
        if supers >= depth {
            list.push((index + 1, "super".to_owned()));
        }
    }
    list
}

/// Calls that the table of floors does not allow.
fn violations(sources: &[Source]) -> Vec<String> {
    let floor = |room: &str| FLOORS.iter().position(|f| *f == room);
    let mut list = Vec::new();
    for source in sources {
        let Some((room, _)) = source.0.split_once('/') else { continue };
        let Some(own) = floor(room) else {
            list.push(format!("src/{}: the room `{room}` is not in the table of floors", source.0));
            continue;
        };
        for (line, called) in calls(source) {
            let told = match floor(&called) {
                _ if called == "super" => "goes up with `super` to the root; name the room with `crate::`".to_owned(),
                Some(other) if other < own => format!("calls `{called}`, which stands above `{room}`"),
                Some(_) if FORBIDDEN.contains(&(room, called.as_str())) => {
                    format!("calls `{called}`, which `{room}` must not know")
                }
                _ => continue,
            };
            list.push(format!("src/{}:{line}: {told}", source.0));
        }
    }
    list
}

fn read(folder: &Path, under: &str, sources: &mut Vec<Source>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap()).collect();
    entries.sort_by_key(std::fs::DirEntry::file_name);
    for entry in entries {
        let name = entry.file_name().into_string().unwrap();
        let path = if under.is_empty() { name.clone() } else { format!("{under}/{name}") };
        if entry.file_type().unwrap().is_dir() {
            read(&entry.path(), &path, sources);
        } else if name.ends_with(".rs") {
            sources.push((path, std::fs::read_to_string(entry.path()).unwrap()));
        }
    }
}

fn house() -> Vec<Source> {
    let mut sources = Vec::new();
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), "", &mut sources);
    sources
}

#[test]
fn rooms_call_down_only() {
    let sources = house();
    let rooms: BTreeSet<&str> = sources.iter().filter_map(|(path, _)| path.split_once('/').map(|(room, _)| room)).collect();
    assert!(FLOORS.iter().all(|f| rooms.contains(f)), "a room of the table is not there: {rooms:?}");
    let list = violations(&sources);
    assert!(list.is_empty(), "{} calls that the table of floors does not allow:\n{}", list.len(), list.join("\n"));
}

#[test]
fn a_call_upwards_is_seen() {
    let file = |path: &str, text: &str| vec![(path.to_owned(), text.to_owned())];
    let count = |path: &str, text: &str| violations(&file(path, text)).len();
    assert_eq!(count("fit/linear.rs", "use crate::data::run::Run;"), 1);
    assert_eq!(count("record/known.rs", "fn f() { crate::diagnose::run(); }"), 1);
    assert_eq!(count("measure/null.rs", "use crate::files::parameter::Npf;"), 1);
    assert_eq!(count("show/lin.rs", "use crate::{\n    data::run::Run,\n    workflow::Measured,\n};"), 1);
    assert_eq!(count("model/effects/cubic.rs", "use super::super::super::cli::Common;"), 1);
    assert_eq!(count("attic/old.rs", ""), 1);
    // What is allowed: down, inside the room, and in a comment.
    assert_eq!(count("cli/lin.rs", "use crate::workflow::make;\nuse super::output::Terminal; // crate::cli"), 0);
    assert_eq!(count("model/effects/cubic.rs", "use super::super::sensor::Split;\nuse crate::data::units::Reading;"), 0);
    assert_eq!(count("fit/linear.rs", "/// See [`crate::model`]."), 0);
}
