//! `calfit effects`: the catalogue of effects that a diagnosis knows.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use crate::data::units::three_digits;
use crate::diagnose::signature::{Explained, explain};
use crate::files::output::Folder;
use crate::model::effects::{About, Catalogue, EffectRef, UNKNOWN};
use crate::workflow::draw;
use clap::Args;
use serde::Serialize;
use std::fmt::Write;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Effect to explain; all are listed without it.
    #[arg(value_name = "NAME")]
    name: Option<String>,
}

/// What `--json` prints of every effect in the list.
#[derive(Serialize)]
struct Entry {
    effect: &'static str,
    #[serde(flatten)]
    about: About,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let catalogue = Catalogue::default();
    let Some(name) = &arguments.name else {
        let entries: Vec<Entry> = catalogue.iter().chain([UNKNOWN]).map(|e| Entry { effect: e.id(), about: e.about() }).collect();
        terminal.print(&if common.json { json(&entries)? } else { list(&entries) });
        return Ok(Status::Done);
    };
    let effect = catalogue.named(name).ok_or_else(|| unknown(name, &catalogue))?;
    let explained = explain(effect);
    terminal.print(&if common.json { json(&explained)? } else { text(&explained) });
    if common.out_given && !common.no_plots {
        let figures = crate::plot::effects::figures(&explained);
        if figures.is_empty() {
            terminal.warning(&format!("{name} has no picture: {}", reason(effect)));
            return Ok(Status::Done);
        }
        let folder = Folder::open(&common.out, common.force)?;
        for drawn in draw(&folder, &figures, |stem| format!("EFFECT_{name}_{stem}.png"))? {
            if !common.json {
                terminal.tell(&format!("-> {}\n", common.out.join(drawn.file).display()));
            }
        }
        folder.sync()?;
    }
    Ok(Status::Done)
}

fn reason(effect: EffectRef) -> String {
    format!("the readings of one run do not show it; it is seen in {}", effect.about().seen_in)
}

/// A refusal with the name that was perhaps meant.
fn unknown(name: &str, catalogue: &Catalogue) -> Finding {
    let parts: Vec<&str> = name.split(['_', '-', ' ']).filter(|p| p.len() > 3).collect();
    let near: Vec<&str> =
        catalogue.iter().chain([UNKNOWN]).map(|e| e.id()).filter(|id| parts.iter().any(|p| id.contains(p))).collect();
    let remedy = if near.is_empty() {
        "list the catalogue with `calfit effects`".to_owned()
    } else {
        format!("perhaps {}; list the catalogue with `calfit effects`", near.join(" or "))
    };
    Finding::error(name, "is no effect of the catalogue", remedy)
}

fn list(entries: &[Entry]) -> String {
    let width = entries.iter().map(|e| e.effect.len()).max().unwrap_or(0);
    let mut out = String::new();
    for Entry { effect, about } in entries {
        let _ = writeln!(out, "{effect:width$}  {}  [{}; {}]", about.summary, about.family.name(), about.seen_in);
    }
    out
}

fn text(explained: &Explained) -> String {
    let about = &explained.about;
    let mut out = format!("{}: {}\n", explained.effect, about.summary);
    let _ = writeln!(out, "  formula           {}", about.formula);
    for form in &explained.forms {
        let names = |all: &[(String, String)]| all.iter().map(|(n, u)| format!("{n} [{u}]")).collect::<Vec<_>>().join(", ");
        let shape = if form.shape.is_empty() { String::new() } else { format!("; shape: {}", names(&form.shape)) };
        let _ = writeln!(out, "  form              {}: {}{shape}", form.form, names(&form.parameters));
    }
    let _ = writeln!(out, "  family            {}", about.family.name());
    let _ = writeln!(out, "  seen in           {}", about.seen_in);
    let _ = writeln!(out, "  covariates        {}", about.needs);
    let _ = writeln!(out, "  source            {}", about.source);
    let _ = writeln!(out, "  best measurement  {}", about.best_measurement);
    if let Some(example) = &explained.example {
        let values: Vec<String> = example.parameters.iter().map(|(n, v, u)| format!("{n} = {} {u}", three_digits(*v))).collect();
        let _ = writeln!(out, "  1 nT at most      {} in an example run: {}", values.join(", "), example.run);
    }
    out
}
