//! The Python package: it reads what the program writes, and applies it.

use crate::common;

use calfit::files::parameter::KINDS;
use common::check::{Case, data, text};
use common::python::Environment;
use std::path::Path;

/// Every kind of parameter file that can be had from a small campaign, and the twins and ground calibration files made of them. The
/// campaign's own orders of the polynomials describe the twin; a ground calibration file holds straight lines only.
fn files(case: &Case) {
    let campaign = data("tests/data/version-1/campaign");
    let reference = data("tests/data/version-1/inputs/reference.csv");
    let model = data("tests/data/version-1/inputs/model.toml");
    let run = |name: &str| campaign.join("26-03-02").join(name);
    let polynomials = "THERMAL_PARAMETER__26-03-02-08-00-00.TPF";
    let centre = "26-03-02_08-00-00/PARAMETER_TEMPLIN__26-03-02_08-00-00.CPF";
    let tcf = "THERMAL_CENTRE_PARAMETER__26-03-02-08-00-00.TCF";

    let thermal = case.made("thermal", &["thermal"], &[&campaign]);
    let offset = thermal.join("26-03-02_08-05-00/OFF_PARAMETER__26-03-02-08-05-00.OPF");
    let of = |folder: &Path| [folder.join(polynomials), folder.join(centre)];
    let [tpf, cpf] = of(&thermal);
    let at_centre = case.made("centre", &["thermal"], &[&tpf, Path::new("--centre"), &cpf, Path::new("--offset"), &offset]);
    let line = case.made("line", &["thermal", "--order", "b_or=1", "--order", "b_off=1"], &[&campaign]);
    let [line_tpf, line_cpf] = of(&line);
    let line_centre = case.made("line_centre", &["thermal"], &[&line_tpf, Path::new("--centre"), &line_cpf]);
    let thermistor = case.made(
        "thermistor",
        &["thermistor", "--signal", "u", "--order", "3"],
        &[&data("tests/data/rosetta/pt1000_table.csv"), Path::new("--reference"), &reference],
    );
    case.made("linearise", &["lin", "--linearise", "--order", "0"], &[&data("runs/champ-1998")]);
    case.made("model", &["lin"], &[&data("tests/data/cases/26-05-02.CCR.gz"), Path::new("--model"), &model]);
    case.made("null", &["null"], &[&campaign]);
    case.made("scalar", &["coil", "scalar"], &[&run("07-00-00.CCR.gz")]);
    case.made("residual", &["coil", "residual"], &[&run("07-30-00.CCR.gz")]);

    let tof = |folder: &Path| folder.join("THERMAL_OFF_PARAMETER__26-03-02-08-05-00.TOF");
    let table = thermistor.join("THERMISTOR__pt1000_table.toml");
    case.made("rpcmag", &["export", "--format", "rpcmag"], &[&line_centre.join(tcf), &tof(&line), &table]);
    case.made("json", &["export", "--format", "json"], &[&tpf, &tof(&thermal), &cpf, &offset, &at_centre.join(tcf)]);
}

#[test]
fn the_package_reads_and_applies_what_the_program_writes() {
    let Some(environment) = Environment::of("calfit", &["numpy", "pytest"], &["python"]) else { return };
    let case = Case::new();
    files(&case);
    let output = environment
        .python()
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"])
        .arg(data("python/tests"))
        .env("CALFIT_FILES", case.path())
        .env("CALFIT_KINDS", KINDS.iter().map(|kind| kind.format).collect::<Vec<_>>().join(" "))
        .output()
        .unwrap();
    let said = text(&output.stdout);
    assert!(output.status.success(), "{said}{}", text(&output.stderr));
    // With the files of the program and the project around it nothing is left out.
    assert!(said.contains(" passed") && !said.contains("skipped"), "{said}");
}
