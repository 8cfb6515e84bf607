//! `docs/reference/files.md` names every file that `calfit report` writes, and every key and column in it.

use crate::common;

use calfit::files::campaign::RunFile;
use calfit::files::parameter::FileKind;
use calfit::files::twin;
use calfit::simulate::write_campaign;
use common::check::{Case, calfit, data, text, tree};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// The words between backticks of the reference, by the first word of the heading above them. Those below `Common` hold for all kinds.
struct Reference(BTreeMap<String, BTreeSet<String>>);

impl Reference {
    fn read() -> Self {
        let page = fs::read_to_string(data("docs/reference/files.md")).unwrap();
        let mut sections: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        let mut section = String::new();
        for line in page.lines() {
            if let Some(heading) = line.strip_prefix("## ").or_else(|| line.strip_prefix("### ")) {
                section = heading.split([' ', ':']).next().unwrap_or_default().to_owned();
            }
            let words = line.split('`').skip(1).step_by(2).map(str::to_owned);
            sections.entry(section.clone()).or_default().extend(words);
        }
        Self(sections)
    }

    /// Whether a key is named, alone or with keys above it: `quality.residual_nt.std` is named by `residual_nt.std`.
    fn names(&self, format: &str, path: &[String]) -> bool {
        let ends: Vec<String> = (0..path.len()).map(|from| path[from..].join(".")).collect();
        let mut sections = [format, "Common"].into_iter().filter_map(|name| self.0.get(name));
        sections.any(|words| ends.iter().any(|end| words.contains(end)))
    }

    /// Whether a file is named: `LIN_applied_fields__ID.png` names that of every run.
    fn names_file(&self, name: &str) -> bool {
        let begin = name.split_once("__").map(|(begin, _)| format!("{begin}__"));
        let is_it = |word: &String| begin.as_ref().map_or(word == name, |begin| word.starts_with(begin.as_str()));
        self.0.values().flatten().any(is_it)
    }

    /// The keys of a file that are not named. Entries of lists have no name, and entries of tables by run are named after their runs.
    fn unnamed(&self, format: &str, value: &Value, path: &[String], runs: &BTreeSet<String>) -> Vec<String> {
        match value {
            Value::Array(list) => list.iter().flat_map(|entry| self.unnamed(format, entry, path, runs)).collect(),
            Value::Object(table) => {
                let below = |(key, entry): (&String, &Value)| {
                    if runs.contains(key) {
                        return self.unnamed(format, entry, path, runs);
                    }
                    let own = [path, std::slice::from_ref(key)].concat();
                    let mut list = self.unnamed(format, entry, &own, runs);
                    if !self.names(format, &own) {
                        list.push(format!("{format}: {}", own.join(".")));
                    }
                    list
                };
                table.iter().flat_map(below).collect()
            }
            _ => Vec::new(),
        }
    }
}

/// Every file, key and column of a result folder is named; `sensors` are those after which files are named.
#[track_caller]
fn complete(campaign: &Path, out: &Path, sensors: &[&str]) {
    let reference = Reference::read();
    let runs: BTreeSet<String> =
        tree(campaign).into_keys().filter(|path| path.contains('/')).map(|path| RunFile::id(&path)).collect();
    let mut unnamed = BTreeSet::new();
    for (path, bytes) in tree(out) {
        let name = path.rsplit('/').next().unwrap();
        let general = sensors.iter().fold(name.to_owned(), |name, sensor| name.replace(sensor, "SENSOR"));
        if !reference.names_file(&general) {
            unnamed.insert(format!("the file {general}"));
        }
        let end = name.rsplit('.').next().unwrap();
        if ["md", "html", "png", "parquet", "lock"].contains(&end) {
            continue;
        }
        let content = text(&bytes);
        if end == "csv" {
            let table = name.split("__").next().unwrap().trim_end_matches(".csv");
            let columns = content.lines().nth(1).unwrap().split(',').map(|column| vec![column.to_owned()]);
            unnamed.extend(columns.filter(|c| !reference.names(table, c)).map(|c| format!("{table}: {}", c.concat())));
            continue;
        }
        let value: Value = if end == "json" {
            serde_json::from_str(&content).unwrap()
        } else {
            assert!(end == "TXT" || FileKind::of_name(&out.join(&path)).is_some(), "{path} is of no kind that is known here");
            toml_edit::de::from_str(&content).unwrap()
        };
        unnamed.extend(reference.unnamed(value["format"].as_str().unwrap(), &value, &[], &runs));
    }
    assert!(unnamed.is_empty(), "docs/reference/files.md does not name {unnamed:#?}");
}

#[test]
fn all_that_a_report_of_the_demonstration_writes_is_in_the_reference() {
    let case = Case::new();
    let twin = twin::read(&data("configs/demo.toml"), &mut Vec::new()).unwrap();
    write_campaign(&twin, 1, &case.campaign(), false, || ()).unwrap();
    let output = calfit().arg("report").arg(case.campaign()).arg("-o").arg(case.out()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    complete(&case.campaign(), &case.out(), &[]);
}

#[test]
fn all_that_a_report_with_facility_and_model_writes_is_in_the_reference() {
    let case = Case::new();
    let campaign = data("tests/data/version-1/campaign");
    let coil = case.made("coil", &["coil", "scalar"], &[&campaign.join("26-03-02/07-00-00.CCR.gz")]);
    let facility = coil.join("COIL_SCALAR__26-03-02_07-00-00.toml");
    let model = data("tests/data/version-1/inputs/model.toml");
    let out = case.made("report", &["report"], &[&campaign, Path::new("--facility"), &facility, Path::new("--model"), &model]);
    complete(&campaign, &out, &[]);
}

#[test]
fn all_that_a_report_of_runs_beside_the_centre_writes_is_in_the_reference() {
    let case = Case::new();
    let mut twin = twin::read(&data("configs/rosetta-ground.toml"), &mut Vec::new()).unwrap();
    twin.campaign_toml.push_str(
        "\n[[thermistor]]\ntable = \"pt1000.csv\"\nreference = \"reference.csv\"\norder = 3\n\n\
         [[reference]]\nsensor = \"FM-IB\"\nrotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\nstd_deg = 0.01\n",
    );
    write_campaign(&twin, 1, &case.campaign(), false, || ()).unwrap();
    case.put("pt1000.csv", fs::read(data("tests/data/rosetta/pt1000_table.csv")).unwrap());
    case.put("reference.csv", fs::read(data("tests/data/version-1/inputs/reference.csv")).unwrap());
    let out = case.made("report", &["report"], &[&case.campaign()]);
    assert!(out.join("RPCMAG_GND_CALIB_FM-IB.TXT").is_file());
    complete(&case.campaign(), &out, &["FM-IB", "FM-OB"]);
}
