//! `calfit completions` and `calfit man`.

use super::help::command;
use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Completions {
    /// Shell to complete for.
    shell: clap_complete::Shell,
}

#[derive(Args, Debug)]
pub(super) struct Man {
    /// Folder for the pages.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Pages {
    pages: Vec<PathBuf>,
}

pub(super) fn completions(arguments: &Completions, terminal: &Terminal) -> Result<Status, Finding> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut command(), "calfit", &mut text);
    terminal.print(&String::from_utf8_lossy(&text));
    Ok(Status::Done)
}

pub(super) fn manual(arguments: &Man, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let wrong = |e: std::io::Error| Finding::io(&arguments.folder, "write manual pages", &e);
    std::fs::create_dir_all(&arguments.folder).map_err(wrong)?;
    clap_mangen::generate_to(command(), &arguments.folder).map_err(wrong)?;
    if common.json {
        let mut pages = Vec::new();
        for entry in std::fs::read_dir(&arguments.folder).map_err(wrong)? {
            let path = entry.map_err(wrong)?.path();
            if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("calfit")) {
                pages.push(path);
            }
        }
        pages.sort();
        terminal.print(&json(&Pages { pages })?);
    }
    Ok(Status::Done)
}
