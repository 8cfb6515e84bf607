//! README and guide: every command in them works as it stands, from top to bottom of a page in a clone, and every link leads somewhere.

use crate::common::check::data;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Stands for cargo: what it would run is run, what it would build or test is done already.
const CARGO: &str = "#!/bin/sh
case \"$1\" in
  run) while [ \"$1\" != -- ]; do shift; done; shift; exec calfit \"$@\";;
  install|test|bench) exit 0;;
  *) echo \"cargo $1: not known to this test\" >&2; exit 1;;
esac
";

/// The pages of the guide and the README, by their paths in the repository.
fn pages() -> Vec<PathBuf> {
    let mut pages = vec![PathBuf::from("README.md")];
    for folder in ["docs", "docs/howto", "docs/reference"] {
        let mut names: Vec<PathBuf> =
            fs::read_dir(data(folder)).unwrap().map(|entry| entry.unwrap().file_name().into()).collect();
        names.sort();
        pages.extend(names.into_iter().filter(|n| n.extension().is_some_and(|e| e == "md")).map(|n| Path::new(folder).join(n)));
    }
    pages
}

fn read(page: &Path) -> String {
    fs::read_to_string(data(page.to_str().unwrap())).unwrap()
}

/// What stands in the shell blocks of a page.
fn commands(page: &Path) -> String {
    let text = read(page);
    let mut blocks = text.split("```");
    let mut commands = String::new();
    blocks.next();
    while let (Some(block), _) = (blocks.next(), blocks.next()) {
        if let Some(script) = block.strip_prefix("sh\n") {
            commands.push_str(script);
        }
    }
    commands
}

/// Runs the commands of a page in an empty folder that has what a clone has.
#[track_caller]
fn run(page: &str) {
    let script = commands(Path::new(page));
    assert!(!script.is_empty(), "{page} has no commands");
    let dir = tempfile::tempdir().unwrap();
    for part in ["configs", "runs", "tests"] {
        symlink(data(part), dir.path().join(part)).unwrap();
    }
    let bin = dir.path().join(".bin");
    fs::create_dir(&bin).unwrap();
    symlink(env!("CARGO_BIN_EXE_calfit"), bin.join("calfit")).unwrap();
    fs::write(bin.join("cargo"), CARGO).unwrap();
    fs::set_permissions(bin.join("cargo"), fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap_or_default());
    let output = Command::new("sh").args(["-e", "-c", &script]).current_dir(dir.path()).env("PATH", path).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{page}: {:?}\n{script}\n{errors}", output.status.code());
}

#[test]
fn the_commands_of_the_readme_work() {
    run("README.md");
}

#[test]
fn the_tutorial_works() {
    run("docs/tutorial.md");
}

#[test]
fn the_page_on_data_that_are_left_out_works() {
    run("docs/howto/exclude.md");
}

#[test]
fn the_page_on_linearisation_works() {
    run("docs/howto/linearise.md");
}

#[test]
fn the_page_on_moving_temperatures_works() {
    run("docs/howto/temperature.md");
}

#[test]
fn the_page_on_sweeps_works() {
    run("docs/howto/sweep.md");
}

#[test]
fn the_page_on_sensors_beside_the_centre_works() {
    run("docs/howto/off-centre.md");
}

#[test]
fn the_page_on_the_facility_works() {
    run("docs/howto/facility.md");
}

#[test]
fn the_page_on_missing_effects_works() {
    run("docs/howto/missing-effect.md");
}

#[test]
fn the_page_on_applying_a_calibration_works() {
    run("docs/howto/apply.md");
}

#[test]
fn the_page_on_verifying_works() {
    run("docs/howto/verify.md");
}

#[test]
fn the_page_on_flight_data_works() {
    run("docs/howto/flight.md");
}

#[test]
fn the_page_on_twins_in_flight_works() {
    run("docs/reference/telemetry-twin.md");
}

/// Who reads the pages one after the other has one folder: each result folder in it belongs to one campaign, and `import` writes over no
/// campaign that is there.
#[test]
fn the_pages_share_no_folder_for_different_campaigns() {
    let mut sources: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut imported: BTreeSet<String> = BTreeSet::new();
    for page in pages() {
        let script = commands(&page).replace("\\\n", " ").replace("&&", "\n").replace("cargo run --release --", "calfit");
        for line in script.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [program, command, rest @ ..] = words.as_slice() else { continue };
            let out = rest.iter().position(|word| *word == "-o").and_then(|at| rest.get(at + 1)).copied();
            let with_index = ["lin", "offset", "freq", "thermal", "null", "report", "diagnose", "coil", "simulate"];
            if *program != "calfit" || rest.contains(&"--guess") {
                continue;
            } else if *command == "import" {
                let out = out.unwrap_or_default().to_owned();
                assert!(imported.insert(out.clone()), "{}: {out} is there already: {line}", page.display());
            } else if with_index.contains(command) {
                let skipped = usize::from(*command == "coil");
                let path = rest.iter().skip(skipped).find(|word| !word.starts_with('-')).copied().unwrap_or_default();
                // A run of a campaign belongs to it; what is in the clone is named by its whole path.
                let is_made = !["runs/", "tests/", "configs/"].iter().any(|folder| path.starts_with(folder));
                let campaign = if is_made { path.split('/').next().unwrap_or_default() } else { path };
                sources.entry(out.unwrap_or("calfit-out").to_owned()).or_default().insert(campaign.to_owned());
            }
        }
    }
    assert!(sources.len() > 15 && !imported.is_empty(), "{sources:?}");
    let shared: Vec<_> = sources.iter().filter(|(_, campaigns)| campaigns.len() > 1).collect();
    assert!(shared.is_empty(), "{shared:#?}");
}

/// In pandas `flags` is an attribute of every table, so that a column of this name is none.
#[test]
fn columns_are_not_named_as_attributes_that_tables_of_pandas_have() {
    let wrong: Vec<_> = pages().into_iter().filter(|page| read(page).contains("c.flags")).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// A page with commands that no test above runs is a page whose commands may be wrong.
#[test]
fn every_page_with_commands_has_a_test() {
    let tests = include_str!("docs.rs");
    for page in pages().iter().filter(|page| !commands(page).is_empty()) {
        assert!(tests.contains(&format!("run(\"{}\");", page.display())), "no test runs the commands of {}", page.display());
    }
}

/// A page of the guide links to nothing outside it, since the site that is made of the guide does not have it.
#[test]
fn every_link_leads_somewhere() {
    let guide = data("docs").canonicalize().unwrap();
    let mut lost = BTreeSet::new();
    for page in pages() {
        let text = read(&page);
        for (_, rest) in text.match_indices("](").map(|(at, _)| text.split_at(at + 2)) {
            let target = rest.split(')').next().unwrap_or_default();
            let file = target.split('#').next().unwrap_or_default();
            if file.is_empty() || target.contains("://") {
                continue;
            }
            let path = data(page.parent().unwrap().join(file).to_str().unwrap());
            let is_outside = page.starts_with("docs") && path.canonicalize().is_ok_and(|real| !real.starts_with(&guide));
            if !path.exists() || is_outside {
                lost.insert(format!("{}: {target}", page.display()));
            }
        }
    }
    assert!(lost.is_empty(), "{lost:#?}");
}

#[test]
fn every_page_of_the_guide_is_in_its_contents() {
    let contents = read(Path::new("docs/SUMMARY.md"));
    for page in pages().iter().filter_map(|page| page.strip_prefix("docs").ok()).filter(|page| *page != Path::new("SUMMARY.md")) {
        assert!(contents.contains(&format!("({})", page.display())), "{} is not in docs/SUMMARY.md", page.display());
    }
}

#[test]
fn the_readme_is_short() {
    let words = read(Path::new("README.md")).split_whitespace().count();
    assert!(words <= 900, "{words} words");
}
