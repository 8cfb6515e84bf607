//! What a result was made with, as data: nothing of the options is lost on the way through a file, nor through the command that people
//! read, and files that were made before there were recipes are made again from that command.

use crate::common;

use calfit::data::exclusion::{ExcludedPart, Exclusion};
use calfit::data::plateau::{Cut, Settling};
use calfit::data::provenance::{Input, Provenance, Role};
use calfit::data::recipe::{ANALYSES, Reading, Recipe, RecipeError};
use calfit::files::parameter::{FileKind, KINDS, toml};
use calfit::measure::coil::{scalar, tilt};
use calfit::measure::sweep::{LagChoice, Window};
use calfit::measure::thermistor::Signal;
use calfit::measure::{freq, lin, null, offset, sweep, thermistor};
use calfit::model::lag::Lag;
use calfit::workflow::ThermalOptions;
use common::check::{calfit, data, says, text, tree};
use proptest::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::path::PathBuf;

/// A recipe through the text of a file, with the options at its end, and once more through the command of that.
fn round<O: Serialize + DeserializeOwned + Debug + PartialEq>(analysis: &str, options: O, reading: Reading, files: &[Role]) {
    let input =
        |role: &Role| Input { path: format!("a {} file.toml", role.option()), sha256: format!("{role:?}"), ..Input::default() };
    let inputs: Vec<Input> = files.iter().map(|role| input(role).with_role(*role)).collect();
    let recipe = Recipe::new(analysis, &options).reading(reading);
    let provenance = Provenance::new(recipe.clone(), inputs.clone());
    let serde_json::Value::Object(table) = serde_json::to_value(&provenance).unwrap() else { panic!("no table") };
    let mut read: Provenance = toml_edit::de::from_str(&toml(&table)).unwrap();
    assert_eq!(read, provenance);
    assert_eq!(read.recipe().unwrap().options::<O>().unwrap(), options);

    // As it was recorded before there were recipes.
    let mut without: Vec<Input> = files.iter().map(input).collect();
    let mut from_command = Recipe::of_command(&provenance.command, &mut without).unwrap();
    assert_eq!(without, inputs, "{}", provenance.command);
    if analysis == "sweep" {
        // Its command is that of the groups; its run tells them apart.
        assert_eq!(from_command.analysis, "thermal");
        from_command.analysis = "sweep".to_owned();
    }
    assert_eq!(from_command, recipe, "{}", provenance.command);
    assert_eq!(from_command.options::<O>().unwrap(), options, "{}", provenance.command);
}

fn positive() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits).prop_filter("a number", |v| v.is_finite() && *v > 0.0)
}

fn finite() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits).prop_filter("a number", |v| v.is_finite())
}

fn settling() -> impl Strategy<Value = Settling> {
    prop_oneof![Just(Settling::Found), positive().prop_map(Settling::Given)]
}

fn window() -> impl Strategy<Value = Window> {
    prop_oneof![(5..10_000usize).prop_map(Window::Settings), positive().prop_map(Window::Minutes)]
}

fn lag() -> impl Strategy<Value = LagChoice> {
    prop_oneof![
        Just(LagChoice::Auto),
        Just(LagChoice::None),
        finite().prop_map(|s| LagChoice::Given(Lag::Delay(s))),
        positive().prop_map(|s| LagChoice::Given(Lag::FirstOrder(s))),
        positive().prop_map(|s| LagChoice::Given(Lag::InverseFirstOrder(s))),
    ]
}

fn orders() -> impl Strategy<Value = Vec<(String, usize)>> {
    proptest::collection::vec(("[a-z_]{1,8}", 0..9usize), 0..4)
}

prop_compose! {
    fn reading()(
        (allow_truncated, allow_duplicates) in any::<(bool, bool)>(),
        (setting, span) in (proptest::option::of(1..99usize), proptest::option::of((positive(), positive()))),
        reason in "[a-z][a-z ='\"]{0,12}[a-z]",
    ) -> Reading {
        let span = span.filter(|(from, until)| from < until).map(|(from, until)| ExcludedPart::Span([from, until]));
        let parts = [Some(ExcludedPart::Run), setting.map(ExcludedPart::Setting), span];
        let exclusion = |part| Exclusion::new("13-04-03_09-22-38", part, &reason).unwrap();
        Reading { allow_truncated, allow_duplicates, exclude: parts.into_iter().flatten().map(exclusion).collect() }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn options_come_back_from_a_recipe_and_from_its_command(
        (settling, coverage) in (settling(), 0.0..1.0f64),
        (trend_order, drift_order, order) in (proptest::option::of(0..3usize), proptest::option::of(0..4usize), 0..4usize),
        max_field_nt in proptest::array::uniform3(proptest::option::of(positive())),
        [robust, gain, mismatch, joint, keep] in any::<[bool; 5]>(),
        (orders, window, most_k_per_min, lag) in (orders(), window(), proptest::option::of(positive()), lag()),
        (signal, within_degc) in (proptest::option::of(any::<bool>()), positive()),
        divider in proptest::option::of([positive(), positive()]),
        compare in proptest::option::of(proptest::collection::vec(finite(), 2..6)),
        // A name as a laboratory gives it.
        name in proptest::option::of("[A-Za-z0-9_°][A-Za-z0-9 _.\"'°-]{0,12}[A-Za-z0-9]").prop_filter("no option", |n| !n.as_ref().is_some_and(|n| n.contains(" --"))),
        reading in reading(),
    ) {
        let cut = Cut { settling, least_coverage: coverage };
        let linear = lin::Options {
            trend_order,
            max_field_nt,
            robust,
            cut,
            allow_gain: gain,
            allow_mismatch: mismatch,
            ..lin::Options::default()
        };
        round("lin", linear.clone(), reading.clone(), &[Role::Facility, Role::Linearisation, Role::Model]);
        round("linearise", linear, reading.clone(), &[Role::Facility, Role::Model]);
        let offsets = offset::Options { cut, allow_mismatch: mismatch, ..offset::Options::default() };
        round("offset", offsets, reading.clone(), &[Role::Cpf, Role::Facility, Role::Model]);
        round("freq", freq::Options { settling, ..freq::Options::default() }, reading.clone(), &[Role::Model]);
        round("freq", freq::Options::default(), Reading::default(), &[Role::Amplitudes]);
        round("null", null::Options { order, ..null::Options::default() }, reading.clone(), &[Role::Cpf, Role::Model]);
        let swept = sweep::Options {
            cut,
            window,
            most_k_per_min,
            orders: orders.clone(),
            lag,
            ..sweep::Options::default()
        };
        round("sweep", swept, reading.clone(), &[Role::Facility, Role::Model]);
        let groups = ThermalOptions {
            orders,
            joint,
            trend_order,
            drift_order,
            max_field_nt,
            robust,
            cut,
            allow_gain: gain,
            allow_mismatch: mismatch,
            ..ThermalOptions::default()
        };
        round("thermal", groups, reading.clone(), &[Role::Facility, Role::Linearisation, Role::Model, Role::Centre, Role::OffCentre, Role::Offset]);
        let signal = signal.map(|volt| if volt { Signal::Voltage } else { Signal::Resistance });
        let polynomial = thermistor::Options { order: trend_order, signal, divider, compare, within_degc, sensor: name.clone() };
        round("thermistor", polynomial, Reading::default(), &[Role::Reference]);
        round("coil scalar", scalar::Options { rack_channel: name.clone() }, reading.clone(), &[]);
        round("coil residual", std::collections::BTreeMap::<String, f64>::new(), reading.clone(), &[]);
        round("coil tilt", tilt::Options { sensor: name, keep_all: keep }, reading, &[Role::Facility]);
    }
}

#[test]
fn an_option_of_another_analysis_is_refused_and_named() {
    let refused = |command: &str| Recipe::of_command(command, &mut []).and_then(|r| r.options::<null::Options>()).unwrap_err();
    assert_eq!(refused("calfit"), RecipeError::Command("calfit".to_owned()));
    assert_eq!(refused("calfit man"), RecipeError::Command("calfit man".to_owned()));
    assert_eq!(refused("calfit null --orders 1"), RecipeError::Option("orders".to_owned()));
    let value = |value: &str| RecipeError::Value { option: "order".to_owned(), value: value.to_owned() };
    assert_eq!(refused("calfit null --order 1.5"), value("1.5"));
    assert_eq!(refused("calfit null --order"), value(""));
    says(&refused("calfit null --robust").to_string(), &["`null`", "robust"]);
    // Also beside options that analyses share.
    let linear = Recipe::of_command("calfit lin --settling 2 --coverage 0.5 --joint", &mut []).unwrap();
    says(&linear.options::<lin::Options>().unwrap_err().to_string(), &["`lin`", "joint"]);
    let facility = Input { path: "f".to_owned(), ..Input::default() };
    let other = Recipe::of_command("calfit null --facility f", &mut [facility]).unwrap_err();
    assert_eq!(other, RecipeError::Option("facility".to_owned()));
}

/// Parameter files of every kind that were made before there were recipes; see `tests/data/README.md`.
#[test]
fn files_without_a_recipe_are_read_checked_and_made_again() {
    let folder = data("tests/data/version-1/files");
    let all: Vec<PathBuf> = tree(&folder).into_keys().map(|name| folder.join(name)).collect();
    // Files whose misalignment has the wrong sign are refused, with the reason.
    let (refused, all): (Vec<PathBuf>, Vec<PathBuf>) =
        all.into_iter().partition(|path| path.extension().is_some_and(|e| e == "TCF" || e == "TXT"));
    assert_eq!(refused.len(), 3);
    for path in &refused {
        for command in ["check", "verify"] {
            if command == "verify" && path.extension().is_some_and(|e| e == "TXT") {
                continue;
            }
            let output = calfit().arg(command).arg(path).output().unwrap();
            assert_eq!(output.status.code(), Some(1), "{command} {}", path.display());
            says(&text(&output.stderr), &["misalignment has the wrong sign"]);
        }
    }
    let files: Vec<&PathBuf> = all.iter().filter(|path| FileKind::of_name(path).is_some()).collect();
    let output = calfit().arg("check").args(&all).arg(data("tests/data/version-1/inputs/model.toml")).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));

    let places = ["tests/data/version-1", "tests/data/version-1/files", "tests/data", "runs"].map(data);
    let output = calfit().arg("verify").args(&files).args(&places).output().unwrap();
    let said = text(&output.stdout);
    // The folders among the places hold the refused files too.
    let told = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    // Earlier versions took the scatter of the settings for slow noise: uncertainties of calibrations are others, and so are the offsets and
    // polynomials that are weighted with them. Of linear calibrations nothing else is, unless a facility was taken at the mean temperature of the
    // run, which is now that of every setting. Sweeps are fitted in another way.
    let of_noise = [
        "/PARAMETER_LIN__26-03",
        "/PARAMETER_LIN__26-05",
        "/PARAMETER_TEMPLIN__",
        "/OFF_PARAMETER__",
        "/THERMAL_OFF_PARAMETER__",
        // Of two of its runs four and five samples that are none were left out as spikes.
        "/tilt_both/COIL_TILT__",
        // What a sensor that stands a little beside its nominal orientation sees beyond the first order was not taken off.
        "/tilt_cpf/COIL_TILT__",
    ];
    let is_among = |text: &str, names: &[&str]| names.iter().any(|name| text.contains(name));
    // The order of a polynomial was chosen, which is in its uncertainty since, and what the runs scatter by is added to each.
    let of_choice = "centre2/THERMAL_PARAMETER__";
    let of_noise = [of_noise.as_slice(), &["thermal/THERMAL_PARAMETER__", of_choice]].concat();
    let chosen = told.lines().filter(|line| line.contains(of_choice) && line.contains("comes back as"));
    let of_weights = [": covariance.", ": sigma_", ": xi_", ": b_or_", ": quantity.", ": joint.", ": warnings."];
    assert!(chosen.clone().all(|line| is_among(line, &of_weights)), "{told}");
    let with_facility = ["lin/PARAMETER_LIN__26", "offset/OFF_PARAMETER"];
    let explained = ["is a TCF file of version 1", "before those of a sweep were fitted as polynomials of the model itself"];
    // What settles at the begin of a setting was told as data that step late; without that the notes behind it have other numbers.
    let late = "the data step +0.08 s after the settings do";
    let file_of = |line: &str| line.split(": warnings.").next().unwrap_or_default().to_owned();
    let with_note = |note: &str| -> Vec<String> {
        told.lines().filter(|line| line.contains(": warnings.") && line.contains(note)).map(file_of).collect()
    };
    let with_late = with_note(late);
    // Settings with one or two samples in a part lost samples of plain noise as spikes: their means were others.
    let with_false_spikes = with_note("samples in stretches with spikes were left out does not come back");
    // Model files did not tell of which sensor they are, which is said before the other notes.
    let with_old_model = with_note("does not tell of which sensor and mode its effects are");
    // Single pairs of moduli show no noise, which is said since.
    let unseen = "no axis has two pairs of moduli";
    let with_unseen = with_note(unseen);
    assert!(!with_unseen.is_empty());
    // The temperature of a sensor that counted as being at rest did move, and its slopes were taken as zero.
    let of_slopes = |line: &str| line.contains(": convention.model") && line.contains("everything holds at slopes.at_degc");
    let with_slopes: Vec<&str> = told.lines().filter(|l| of_slopes(l)).filter_map(|l| l.split(": convention.").next()).collect();
    let expected = |line: &str| {
        let differs = line.contains("comes back as") || line.contains("more values differ");
        let is_linear = is_among(line, &["/PARAMETER_LIN__", "/PARAMETER_TEMPLIN__"]) && !is_among(line, &with_facility);
        let is_uncertainty = line.contains(": std.") || line.contains("more values differ");
        let is_late = line.contains(": warnings.") && with_late.contains(&file_of(line));
        // What a thermistor's polynomial leaves of its table is of the kind of notes that go with the values.
        let is_of_thermistor = line.contains("/THERMISTOR__") && line.contains(" comes back as FIT: the polynomial of order");
        let is_of_model = line.contains(": warnings.") && with_old_model.contains(&file_of(line));
        let is_of_false_spikes = with_false_spikes.iter().any(|file| line.starts_with(&format!("{file}: ")));
        // The mean of a temperature is one in time, and was that of the readings; polynomials of it follow.
        let of_mean =
            [": run.temperature_degc", ": run.coil_temperature_degc", ": conditions.", "more values", "/THERMAL_AC_PARAMETER__"];
        // A run at 80 °C has values in nT by sensitivities at 20 °C, which is said.
        let is_of_mean =
            (differs && is_among(line, &of_mean)) || line.contains("values in nT are made with the sensitivities of");
        // Coefficients of the coil temperature that a calibration does not tell are in its uncertainty since, as its convention says.
        let of_coils = [": std.", ": covariance.", ": convention.uncertainty", "more values"];
        let is_of_coils = differs && line.contains("/COIL_SCALAR__") && is_among(line, &of_coils);
        // The scatter of few amplitudes tells their response with Student's factor since.
        let of_few = [": model.std.", ": f_3db_model_std_hz", "more values"];
        let is_of_few = differs && line.contains("/FREQ_PARAMETER__") && is_among(line, &of_few);
        // Squares and cubes across the axes were judged by the freedom of the fit along the axis, and scatter in proportion to the settings counted
        // for none.
        let of_panels = [".fitted.probability", ".fitted.quadratic_std_per_nt", ".fitted.cubic_std_per_nt2"];
        let is_of_panels = differs && line.contains("/LINEARISATION__") && is_among(line, &of_panels);
        // What a thermistor's polynomial leaves of its table is an uncertainty of its values since.
        let of_left = [": coefficients_std.0", ": covariance.matrix.0.0", ": convention.uncertainty", ".std_degc", "more values"];
        let is_of_left = differs && line.contains("/THERMISTOR__") && is_among(line, &of_left);
        // A channel that is read on both sides of the settings covers them.
        let is_covered = line.contains("covers the time from") && line.contains("does not come back");
        line.is_empty()
            || is_among(line, &explained)
            || is_of_coils
            || is_of_panels
            || is_of_few
            || is_of_left
            || is_covered
            || is_late
            || is_of_model
            || is_of_thermistor
            || is_of_false_spikes
            || is_of_mean
            || line.contains(unseen)
            || with_slopes.iter().any(|file| line.starts_with(&format!("{file}: ")))
            || (differs && is_among(line, &of_noise) && (is_uncertainty || !is_linear))
    };
    let unexpected: Vec<&str> = told.lines().filter(|line| !expected(line)).collect();
    assert!(unexpected.is_empty(), "{unexpected:#?}");
    let (of_sweep, others): (Vec<&PathBuf>, Vec<&PathBuf>) =
        files.iter().partition(|file| file.parent().unwrap().ends_with("sweep"));
    assert_eq!(of_sweep.len(), 1);
    says(&told, &[&of_sweep[0].display().to_string(), explained[1]]);
    let with_mean = [
        "freq/FREQ_PARAMETER__",
        "table/FREQ_PARAMETER__",
        "/NULL_PARAMETER__",
        "/THERMAL_AC_PARAMETER__",
        "scalar/COIL_SCALAR__",
    ];
    let differ = [of_noise.as_slice(), &with_mean, &["/THERMISTOR__", "/LINEARISATION__"]].concat();
    let (otherwise, same): (Vec<&PathBuf>, Vec<&PathBuf>) =
        others.into_iter().partition(|file| is_among(&file.display().to_string(), &differ));
    let is_unseen = |file: &&PathBuf| with_unseen.iter().any(|told| told.ends_with(&file.display().to_string()));
    for file in same.into_iter().filter(|file| !is_unseen(file)) {
        says(&said, &[&format!("{}: verified", file.display())]);
    }
    for file in otherwise {
        let name = file.display().to_string();
        assert!(told.lines().any(|line| line.contains(&name) && line.contains("comes back as")), "{name}");
    }
    let formats: BTreeSet<&str> = files.iter().map(|path| FileKind::of_name(path).unwrap().format).collect();
    let kinds: BTreeSet<&str> =
        KINDS.iter().map(|kind| kind.format).filter(|format| !["MODEL", "TCF"].contains(format)).collect();
    assert_eq!(formats, kinds);

    // Every analysis that makes them is among them, and every file is one without a recipe.
    let mut analyses = BTreeSet::new();
    for file in &files {
        let mut provenance = calfit::files::parameter::read_any(file).unwrap().provenance;
        assert!(provenance.recipe.is_none());
        let command = provenance.command.clone();
        let recipe = provenance.recipe().unwrap();
        // The command is the same text as before.
        assert_eq!(recipe.command(&provenance.input), command);
        analyses.insert(recipe.analysis);
    }
    let making = |name: &&str| !["sweep", "diagnose", "report", "export"].contains(name);
    let expected: BTreeSet<String> = ANALYSES.iter().map(|a| a.name).filter(making).map(str::to_owned).collect();
    assert_eq!(analyses, expected);
}
