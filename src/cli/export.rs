//! `calfit export`: parameter files for other programs.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use crate::data::provenance::{Provenance, Role};
use crate::data::recipe::Recipe;
use crate::files::campaign::file;
use crate::files::export::{Exported, FORMATS, Options, Source, Write};
use crate::files::output::Folder;
use crate::workflow::ExportRecipe;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::collections::HashSet;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Parameter files that calfit wrote.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// rpcmag: one Rosetta-style ground calibration file of a sensor from TCF, TOF and THERMISTOR files; json, csv, dcc (digital
    /// calibration certificate): one file per parameter file.
    #[arg(long, value_name = "FORMAT", value_parser = PossibleValuesParser::new(FORMATS.map(|(name, _)| name)).map(format_named))]
    format: Format,
    /// rpcmag: the runs were made at the centre of the coil system, so that a TPF file takes the place of a TCF file.
    #[arg(long)]
    at_centre: bool,
    /// dcc: campaign.toml whose [report] states laboratory, item and persons.
    #[arg(long, value_name = "campaign.toml")]
    campaign: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug)]
struct Format {
    name: &'static str,
    write: Write,
}

/// The parser before it lets no other name through.
fn format_named(name: String) -> Format {
    let (name, write) = FORMATS.into_iter().find(|(known, _)| *known == name).unwrap_or(FORMATS[0]);
    Format { name, write }
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    for (given, option, needs) in
        [(arguments.at_centre, "--at-centre", "rpcmag"), (arguments.campaign.is_some(), "--campaign", "dcc")]
    {
        if given && arguments.format.name != needs {
            let rule = format!("changes nothing with --format {}", arguments.format.name);
            return Err(Finding::error(option, rule, format!("leave it out, or use --format {needs}")));
        }
    }
    let sources = arguments.files.iter().map(|path| Source::read(path)).collect::<Result<Vec<Source>, Finding>>()?;
    let mut input: Vec<_> = sources.iter().map(|s| s.input().clone()).collect();
    let report = match &arguments.campaign {
        Some(path) => {
            let mut findings = Vec::new();
            let read = file::read(path, &mut findings);
            findings.iter().for_each(|f| terminal.finding(f));
            let (file, digested) = read?;
            input.push(digested.input("campaign.toml".to_owned()).with_role(Role::Campaign));
            file.report
        }
        None => Vec::new(),
    };
    if arguments.format.name == "dcc" && arguments.campaign.is_none() {
        terminal.warning(
            "the certificate states neither laboratory, place, item, persons nor traceability; name a campaign.toml with [report] with --campaign",
        );
    }
    for note in sources.iter().flat_map(Source::notes) {
        terminal.warning(&note.to_string());
    }
    let recorded = ExportRecipe { format: arguments.format.name, at_centre: arguments.at_centre };
    let provenance = Provenance::new(Recipe::new("export", &recorded), input);
    let exported = (arguments.format.write)(&sources, &Options { provenance, at_centre: arguments.at_centre, report })?;
    let mut names = HashSet::new();
    if let Some(twice) = exported.iter().find(|e| !names.insert(e.name.as_str())) {
        let rule = "is the name of the results of two files";
        return Err(Finding::error(&twice.name, rule, "export them one by one into different folders with -o"));
    }
    let folder = Folder::open(&common.out, common.force)?;
    exported.iter().try_for_each(|e| folder.check(&e.name))?;
    exported.iter().try_for_each(|e| folder.write(&e.name, e.text.as_bytes()))?;
    folder.sync()?;
    if common.json {
        terminal.print(&json(&exported.iter().map(|e| common.out.join(&e.name)).collect::<Vec<_>>())?);
    } else {
        let told = |e: &Exported| terminal.tell(&format!("-> {}\n", common.out.join(&e.name).display()));
        exported.iter().for_each(told);
    }
    Ok(Status::Done)
}
