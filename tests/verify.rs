//! `calfit verify`: every parameter file of a campaign is made again from its inputs, and what was changed shows.

use crate::common;

use common::check::{Case, calfit, says, text};
use common::{campaign, check};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

fn run(arguments: &[&str], paths: &[&Path]) -> Output {
    calfit().args(arguments).args(paths).output().unwrap()
}

fn verify(paths: &[&Path]) -> (Option<i32>, String) {
    let output = run(&["verify"], paths);
    (output.status.code(), text(&output.stdout) + &text(&output.stderr))
}

fn parameter_files(folder: &Path) -> Vec<PathBuf> {
    let ends = ["CPF", "OPF", "FPF", "TPF", "TOF", "TAF"];
    let is_one = |n: &String| ends.iter().any(|e| n.ends_with(e)) || n.contains("/NULL_PARAMETER__");
    let names = check::tree(folder).into_keys().filter(is_one);
    names.map(|n| folder.join(n)).collect()
}

#[test]
fn all_parameter_files_of_a_campaign_are_verified_and_changes_show() {
    let case = Case::new();
    campaign::write(&case);
    // Two temperatures are enough.
    for day in ["13-04-05", "13-04-06"] {
        fs::remove_dir_all(case.campaign().join(day)).unwrap();
    }
    let output = run(&["report", "--no-plots", "-o"], &[&case.out(), &case.campaign()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let files = parameter_files(&case.out());
    // Two of lin under two names, two of offset and of freq, those of the sweep and of zero field, and the three thermal ones.
    assert_eq!(files.len(), 2 * 4 + 1 + 1 + 3, "{files:?}");

    let (status, said) = verify(&[&case.out(), &case.campaign()]);
    assert_eq!(status, Some(0), "{said}");
    assert_eq!(said.matches(": verified, ").count(), files.len(), "{said}");
    assert!(!said.contains(", 0 values"), "{said}");

    // A campaign beside the results is found without being named, one that is gone is not.
    let cpf = case.out().join(campaign::id(8, 0)).join(format!("PARAMETER_LIN__{}.CPF", campaign::id(8, 0)));
    let (status, said) = verify(&[&cpf]);
    assert_eq!(status, Some(0), "{said}");
    let away = tempfile::tempdir().unwrap();
    fs::copy(&cpf, away.path().join("A.CPF")).unwrap();
    let (status, said) = verify(&[&away.path().join("A.CPF")]);
    assert_eq!(status, Some(1));
    says(&said, &["08-00-00.CCR is not found", "name its campaign folder"]);

    // A value that was changed.
    let original = fs::read_to_string(&cpf).unwrap();
    fs::write(&cpf, original.replace("trend_order = 0", "trend_order = 1")).unwrap();
    let (status, said) = verify(&[&cpf]);
    assert_eq!(status, Some(1));
    says(&said, &["was changed after it was written"]);
    fs::write(&cpf, original).unwrap();

    // An input that was changed.
    let run_file = case.campaign().join("13-04-03/08-00-00.CCR");
    let bytes = fs::read_to_string(&run_file).unwrap();
    fs::write(&run_file, bytes.replace("FLDS", "SOLARTRON")).unwrap();
    let (status, said) = verify(&[&cpf, &case.campaign()]);
    assert_eq!(status, Some(1));
    says(&said, &["is not what the file was made from", "SHA-256"]);
}

#[test]
fn a_value_that_the_inputs_do_not_give_shows_even_with_a_right_hash() {
    let case = Case::of(common::small().text());
    let output = run(&["lin", "--no-plots", "--order", "1", "-o"], &[&case.out(), &case.campaign()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let cpf = case.out().join(common::RUN_ID).join(format!("PARAMETER_LIN__{}.CPF", common::RUN_ID));
    // The same run with another option gives a file with a right hash; the recipe of the first one put in makes it false.
    let other = case.path().join("other");
    let output = run(&["lin", "--no-plots", "--order", "0", "-o"], &[&other, &case.campaign()]);
    assert_eq!(output.status.code(), Some(0));
    let text_of = fs::read_to_string(other.join(common::RUN_ID).join(cpf.file_name().unwrap())).unwrap();
    let verdict_on = |changes: &[(&str, &str)]| {
        let mut forged = text_of.clone();
        for (from, to) in changes {
            assert!(forged.contains(from), "`{from}` is not in the file");
            forged = forged.replace(from, to);
        }
        fs::write(&cpf, with_right_hash(&forged)).unwrap();
        let (status, said) = verify(&[&cpf, &case.campaign()]);
        assert_eq!(status, Some(1), "{said}");
        said
    };
    let command = ("calfit lin --order 0", "calfit lin --order 1");
    let option = ("[provenance.recipe.options]\norder = 0", "[provenance.recipe.options]\norder = 1");
    says(&verdict_on(&[command, option]), &["matrix.rho.0.1 = ", "comes back as", "more values differ"]);
    // The command is that of the recipe.
    says(&verdict_on(&[command]), &["the command `calfit lin --order 1` does not say what the recipe says"]);

    // A recipe that makes no parameter file is not followed, nor is one that this version does not know.
    let analysis = |to| ("[provenance.recipe]\nanalysis = \"lin\"", to);
    let inspect = verdict_on(&[command_to("inspect --order 0"), analysis("[provenance.recipe]\nanalysis = \"inspect\"")]);
    says(&inspect, &["makes no parameter file"]);
    let sideways = verdict_on(&[("[provenance.recipe.options]\n", "[provenance.recipe.options]\nsideways = true\n")]);
    says(&sideways, &["the recipe of `lin` is not one of this version", "sideways"]);
    // A file without a recipe is made again from its command.
    let without = |to| {
        let recipe = "[provenance.recipe]\nanalysis = \"lin\"\n\n[provenance.recipe.options]\norder = 0\n\n";
        verdict_on(&[(recipe, ""), command_to(to)])
    };
    says(&without("lin --order 1"), &["comes back as"]);
    says(&without("inspect"), &["the recorded command `calfit inspect` is not one of this version"]);
    says(&without("lin --sideways"), &["there is no option `--sideways`"]);
    says(&without("lin --order much"), &["`--order much` has no such value"]);
    says(&without("lin --joint"), &["the recipe of `lin` is not one of this version", "joint"]);
    says(&without("lin --facility f.toml"), &["f.toml of `--facility` is not among the recorded inputs"]);
}

/// Another command in place of that of the file.
fn command_to(other: &'static str) -> (&'static str, &'static str) {
    ("lin --order 0\"", Box::leak(format!("{other}\"").into_boxed_str()))
}

/// The hash as README and the parameter files define it: SHA-256 of all lines but `created` and `content_sha256`.
fn with_right_hash(file: &str) -> String {
    use sha2::{Digest, Sha256};
    let mut hash = Sha256::new();
    for line in file.lines().filter(|l| !l.starts_with("created = ") && !l.starts_with("content_sha256 = ")) {
        hash.update(line.as_bytes());
        hash.update(b"\n");
    }
    let digest: String = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
    let old = file.lines().find(|l| l.starts_with("content_sha256 = ")).unwrap();
    file.replace(old, &format!("content_sha256 = \"{digest}\""))
}

#[test]
fn a_table_of_amplitudes_and_thermal_files_from_parameter_files_are_verified() {
    let case = Case::new();
    let table = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bepicolombo/freq_13-04-03-12-59-48.csv");
    let output = run(&["freq", "--no-plots", "-o"], &[&case.out(), Path::new("--amplitudes"), &table]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let (status, said) = verify(&[&case.out(), table.parent().unwrap()]);
    assert_eq!(status, Some(0), "{said}");

    let folder = case.path().join("files");
    fs::create_dir_all(&folder).unwrap();
    for (i, degc) in [-50.0, 20.0, 110.0].into_iter().enumerate() {
        let values: Vec<f64> = [0.1, -0.2, 0.3].iter().map(|b| b + 1e-3 * degc).collect();
        let body = format!(
            "format = \"OPF\"\nversion = 1\noffset_ent = {values:?}\n[run]\nid = \"13-04-0{}_09-00-00\"\nsensor = \"A\"\nmode = \"m\"\n\
             temperature_degc = {degc:?}\n",
            i + 1
        );
        fs::write(folder.join(format!("OFF_PARAMETER__{i}.OPF")), body).unwrap();
    }
    let thermal = case.path().join("thermal");
    let output = run(&["thermal", "--no-plots", "-o"], &[&thermal, &folder]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let (status, said) = verify(&[&thermal.join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF")]);
    assert_eq!(status, Some(0), "{said}");
    says(&said, &["3 inputs unchanged"]);
}

#[test]
fn a_group_of_runs_and_files_without_one_of_the_files_is_verified() {
    let case = Case::new();
    campaign::write(&case);
    let files = case.path().join("files");
    fs::create_dir_all(&files).unwrap();
    for index in [0, 1] {
        let id = campaign::id(8, index);
        let file = case.campaign().join(format!("{}.CCR", id.replace('_', "/")));
        let out = case.made("alone", &["lin"], &[&file]);
        let name = format!("PARAMETER_LIN__{id}.CPF");
        fs::copy(out.join(&id).join(&name), files.join(&name)).unwrap();
    }
    for day in ["13-04-03", "13-04-04"] {
        fs::remove_dir_all(case.campaign().join(day)).unwrap();
    }
    let left_out = format!("{}=door opened", campaign::id(8, 0));
    let out = case.made("thermal", &["thermal", "--exclude", &left_out], &[&case.campaign(), &files]);
    let tpf = out.join(format!("THERMAL_PARAMETER__{}.TPF", campaign::id(8, 1).replace('_', "-")));
    let used = check::parameters(&tpf)["used"].as_array().unwrap().len();
    assert_eq!(used, 3);
    let (status, said) = verify(&[&out, &case.campaign(), &files]);
    assert!(said.contains("THERMAL_PARAMETER__") && said.contains("verified"), "{said}");
    // The files named beside it have inputs that are gone.
    let of_group: Vec<&str> = said.lines().filter(|line| line.contains("/thermal/") && line.contains("error")).collect();
    assert!(of_group.is_empty(), "{status:?} {said}");
}
