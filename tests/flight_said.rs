//! What flight processing says of itself holds: counts and conventions in the files, the result as JSON, what tables hold of a day, and
//! what `check` finds before anything is made.

use crate::common::check::{calfit, data, says, text};
use crate::flight::{Set, Small, three};
use crate::flight_faults::{HEAD, PLAIN};
use calfit::data::time::LeapSeconds;
use calfit::files::table::long::{Column, LongWriter};
use calfit::files::table::series::{SeriesTable, Words};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Output;

/// The counts that a level states.
fn counts(table: &SeriesTable) -> Value {
    serde_json::from_str(table.says("counts").unwrap()).unwrap()
}

fn nulls_of(table: &SeriesTable) -> u64 {
    table.numbers("bx").unwrap().iter().filter(|value| value.is_nan()).count() as u64
}

fn check(path: &Path) -> Output {
    calfit().arg("check").arg(path).output().unwrap()
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&output.stdout)))
}

#[test]
fn counts_are_those_of_the_rows_of_the_file() {
    let set = Set::of("telemetry");
    // From 40 s behind midnight on nothing says how the boom of OB stands.
    set.change("to = \"2015-07-03T00:00:00.000000Z\"", "to = \"2015-07-01T00:00:40Z\"");
    let output = set.flight("BFGJ", &["--no-plots", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let made = json(&output);
    let day = "2015-07-01";
    for (level, sensor) in [("B", "OB"), ("F", "OB"), ("G", "OB"), ("G", "IB"), ("J", "common"), ("J", "own_OB"), ("J", "own_IB")]
    {
        let table = set.level(level, sensor, day);
        let said = counts(&table);
        assert_eq!(said["written"], table.rows(), "{level} {sensor}");
        let null: u64 = said["null"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
        assert_eq!(null, nulls_of(&table), "{level} {sensor}");
    }
    // What both sensors share is made of their means.
    let shared = set.level("J", "common", day);
    let means = set.level("G", "OB", day).rows() + set.level("G", "IB", day).rows();
    assert_eq!(counts(&shared)["read"], means);
    assert!(nulls_of(&shared) > 0, "none of {} rows is null", shared.rows());
    assert_eq!(counts(&shared)["null"]["no boom state"], nulls_of(&shared));
    let days = made["days"].as_array().unwrap();
    let row = days.iter().find(|row| row["sensor"] == "common" && row["day"] == day).unwrap();
    assert_eq!(row["null"], nulls_of(&shared));
}

#[test]
fn text_tables_are_made_of_what_both_sensors_share_as_well() {
    let set = Set::of("telemetry");
    let output = set.change("[temperature]", "[output]\ntext = true\n\n[temperature]").flight("J", &["--hk", "--no-plots"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let day = "2015-07-01";
    for sensor in ["common", "own_OB", "own_IB"] {
        let stem = set.out().join(format!("level=J/sensor={sensor}/date={day}/RPCMAG_150701_CLJ_{sensor}"));
        let table = fs::read_to_string(stem.with_extension("TAB")).unwrap();
        assert_eq!(table.lines().count(), set.level("J", sensor, day).rows());
        let label = fs::read_to_string(stem.with_extension("LBL")).unwrap();
        // Columns that the table does not have are not described.
        assert!(!label.contains("ua ") && !label.contains("uc "), "{label}");
        says(&label, &["NOTE = \"the table has no uncertainties\""]);
    }
    // Housekeeping is a table as well, with temperatures in kelvin.
    let folder = set.out().join("level=HK/date=2015-06-30");
    let table = SeriesTable::open(&folder.join("calfit-HK-20150630.parquet")).unwrap();
    let lines = fs::read_to_string(folder.join("RPCMAG_150630_CLA_HK.TAB")).unwrap();
    assert_eq!(lines.lines().count(), table.rows());
    let degc = table.numbers("t_ob").unwrap();
    // Behind TIME_UTC and TIME_OBT, where the Parquet file has three columns of time.
    let place = table.names().iter().position(|name| name == "t_ob").unwrap() - 1;
    for (line, degc) in lines.lines().zip(&degc) {
        let cell: f64 = line.split_whitespace().nth(place).unwrap().parse().unwrap();
        assert!((cell - 273.15 - degc).abs() < 6e-4, "{line} {degc}");
    }
    let label = fs::read_to_string(folder.join("RPCMAG_150630_CLA_HK.LBL")).unwrap();
    says(&label, &["NAME = T_OB", "UNIT = \"KELVIN\"", &format!("FILE_RECORDS = {}", table.rows())]);
}

#[test]
fn a_field_that_follows_the_housekeeping_is_taken_off_without_a_list_of_steps() {
    let stated = "[[disturbance]]\ncolumn = \"solar_a\"\nvector_nt_per_unit = [2.0, -1.0, 0.5]\n";
    let rows = format!("{HEAD}2015-06-29T11:00:05Z,100,200,300,0,N\n");
    let with = |configuration: &str| {
        let small = Small::new(configuration, &rows);
        let day = small.folder.path().join("hk/date=2015-06-29");
        fs::create_dir_all(&day).unwrap();
        fs::write(day.join("a.csv"), "time_utc,solar_a\n2015-06-29T11:00:00Z,1.0\n2015-06-29T11:00:20Z,5.0\n").unwrap();
        small
    };
    let level = with(&format!("{PLAIN}{stated}")).level_a();
    let [x, y, z] = three(&level, ["bx", "by", "bz"]);
    // A quarter of the way from 1 to 5.
    assert_eq!([x[0], y[0], z[0]], [96.0, 202.0, 299.0]);
    assert_eq!(level.says("steps"), Some("counts temperature ground daily shift disturbance rotate offsets attitude"));
    let lacking = format!("{PLAIN}{stated}[pipeline]\nsteps = [\"counts\", \"ground\", \"shift\"]\n");
    let without = format!("{PLAIN}[pipeline]\nsteps = [\"counts\", \"ground\", \"disturbance\", \"shift\"]\n");
    let absent = format!("{PLAIN}{}", stated.replace("solar_a", "lunar_a"));
    for (configuration, words) in [
        (lacking, ["`pipeline.steps` lacks `disturbance`", "[[disturbance]]"]),
        (without, ["`pipeline.steps` names `disturbance`", "there is no [[disturbance]]"]),
        (absent, ["has no column `lunar_a`; it has", "solar_a"]),
    ] {
        let output = check(&with(&configuration).folder.path().join("flight.toml"));
        assert_eq!(output.status.code(), Some(1), "{words:?}");
        says(&text(&output.stderr), &words);
    }
    let small = with(&format!("{PLAIN}{stated}"));
    let path = small.folder.path().join("flight.toml");
    fs::write(&path, fs::read_to_string(&path).unwrap().replace("hk = \"hk\"\n", "")).unwrap();
    says(&text(&check(&path).stderr), &["the key `hk` is missing"]);
}

#[test]
fn check_finds_columns_and_folders_that_are_missing() {
    let of = |from: &str, to: &str| {
        let set = Set::of("telemetry");
        let output = check(&set.change(from, to).path("flight.toml"));
        assert_eq!(output.status.code(), Some(1), "{to}");
        text(&output.stderr)
    };
    let told = of("thermistor_column = \"t_ob\"", "thermistor_column = \"t_xx\"");
    says(&told, &["part-0.parquet: has no column `t_xx`; it has"]);
    // All files of the sensor lack it, which is said once.
    assert_eq!(told.matches("has no column").count(), 1, "{told}");
    says(&of("hk = \"hk\"", "hk = \"nohk\""), &["nohk: cannot list the folder"]);
    for (head, words) in [
        ("time_utc,bx,by,bz,sid", "has no column `quality`"),
        ("time_utc,bx,bz,quality,sid", "has no column `by`"),
        ("time,bx,by,bz,quality,sid", "has no column `time_tt2000` or `time_utc` or `time_obt`"),
        ("time_utc,bx,by,bz,quality,mode", "has no column `sid`, and nothing else says the mode"),
    ] {
        let small = Small::new(PLAIN, &format!("{head}\n"));
        fs::create_dir_all(small.folder.path().join("hk/date=2015-06-29")).unwrap();
        let output = check(&small.folder.path().join("flight.toml"));
        assert_eq!(output.status.code(), Some(1), "{head}");
        says(&text(&output.stderr), &["a.csv", words]);
    }
}

#[test]
fn the_first_pass_and_the_report_are_told_as_json() {
    let set = Set::of("telemetry");
    set.change("enabled = false", "enabled = true").made("A", &["--no-plots"]);
    let file = set.path("carry.parquet");
    let run = |what: &str, out: &Path| {
        let output =
            calfit().args(["flight", what]).arg(set.path("flight.toml")).arg("-o").arg(out).arg("--json").output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        json(&output)
    };
    let said = run("carry", &file);
    assert_eq!(said["file"], file.display().to_string());
    let table = SeriesTable::open(&file).unwrap();
    let days = said["days"].as_array().unwrap();
    let modes = table.words("modes").unwrap();
    assert_eq!(days.len(), table.rows());
    assert!(days.len() >= 4 && said["unknown"].as_array().unwrap().is_empty(), "{said}");
    let (first, sums) = (table.whole("first_tt2000").unwrap(), table.numbers("s_y_nt").unwrap());
    let leap = LeapSeconds::default();
    let dates = table.utc("date", &leap).unwrap();
    for (row, day) in days.iter().enumerate() {
        assert_eq!((day["first_tt2000"].as_i64(), day["continuity_nt"][1].as_f64()), (Some(first[row]), Some(sums[row])));
        let own: Vec<&str> = modes.words[modes.codes[row] as usize].split(' ').collect();
        assert_eq!(serde_json::json!(own), day["modes"]);
        assert!(own.iter().all(|sid| sid.starts_with("SID")), "{own:?}");
        assert!(leap.utc(dates[row]).to_string().starts_with(&format!("{}T00:00:00", day["day"].as_str().unwrap())));
    }
    let said = run("report", &set.out());
    assert_eq!(said, serde_json::json!({ "file": set.out().join("report/REPORT.html").display().to_string() }));
}

/// The table of the first pass has every sensor and day with vectors; those without a model that is joined to others have no sums.
#[test]
fn the_first_pass_has_the_days_without_daily_models_too() {
    let rows = |set: &Set| {
        let file = set.path("carry.parquet");
        let output = calfit().args(["flight", "carry"]).arg(set.path("flight.toml")).arg("-o").arg(&file).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        let table = SeriesTable::open(&file).unwrap();
        let [sensors, modes] = ["sensor", "modes"].map(|name| table.words(name).unwrap());
        let [day, first, last, reset, model] =
            ["day", "first_tt2000", "last_tt2000", "reset", "daily_model"].map(|name| table.whole(name).unwrap());
        let [t_first, sum] = ["t_first_degc", "s_y_nt"].map(|name| table.numbers(name).unwrap());
        let word = |words: &Words, i: usize| words.words[words.codes[i] as usize].clone();
        let row = |i: usize| {
            let of_vectors = (word(&sensors, i), day[i], [first[i], last[i]], t_first[i].to_bits(), word(&modes, i));
            (of_vectors, (model[i], reset[i], sum[i]))
        };
        // What follows of the vectors, and what of the models.
        (0..table.rows()).map(row).unzip::<_, _, Vec<_>, Vec<_>>()
    };
    let joined = Set::of("telemetry");
    joined.change("enabled = false", "enabled = true");
    let alone = Set::of("telemetry");
    let ((days, with), (same_days, without)) = (rows(&joined), rows(&alone));
    assert!(with.len() >= 4 && with.iter().all(|(model, ..)| *model == 1), "{with:?}");
    assert!(with.iter().any(|(_, reset, sum)| *reset == 0 && *sum != 0.0), "{with:?}");
    assert_eq!(days, same_days);
    assert!(without.iter().all(|known| *known == (0, 1, 0.0)), "{without:?}");
    // The levels need nothing of such days, and do not change with them.
    let made = |set: &Set, more: &[&str]| {
        let output = set.flight("A", &[&["--no-plots", "--sensor", "IB"], more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        crate::common::check::tree(&set.out().join("level=A"))
    };
    let plain = made(&alone, &[]);
    let file = alone.path("carry.parquet").display().to_string();
    let with_table = made(&alone, &["--carry", &file, "--force"]);
    assert!(!plain.is_empty() && plain == with_table);
}

#[test]
fn what_tables_hold_of_a_day_is_told() {
    let set = Set::of("telemetry");
    // Positions of an hour that ends a day before the first vector.
    let head = "time_utc,x_km,y_km,z_km";
    let rows = "2015-06-29T00:00:00Z,1,2,3\n2015-06-29T00:30:00Z,2,3,4\n2015-06-29T01:00:00Z,3,4,5";
    fs::write(set.path("attitude/short.csv"), format!("{head}\n{rows}\n")).unwrap();
    set.change("attitude/position.parquet", "attitude/short.csv");
    let inspect = |more: &[&str]| calfit().arg("inspect").arg(set.path("flight.toml")).args(more).output().unwrap();
    let days = json(&inspect(&["--json"]));
    let day = days.as_array().unwrap().iter().find(|day| day["sensor"] == "OB" && day["day"] == "2015-07-01").unwrap();
    let table = |name: &str| day["tables"].as_array().unwrap().iter().find(|table| table["table"] == name).cloned().unwrap();
    let position = table("position");
    assert_eq!((&position["file"], &position["covered"]), (&Value::from("attitude/short.csv"), &Value::from(0.0)));
    says(position["from"].as_str().unwrap(), &["2015-06-29T00:00:00"]);
    says(position["to"].as_str().unwrap(), &["2015-06-29T01:00:00"]);
    assert_eq!(table("attitude")["covered"], 1.0);
    // Every gap that the flags count is placed, the longest one first.
    let counted =
        day["flags"].as_object().unwrap().iter().find(|(words, _)| words.contains("gap")).map_or(0, |(_, n)| n.as_u64().unwrap());
    let gaps = day["gaps"].as_array().unwrap();
    let lengths: Vec<f64> = gaps.iter().map(|gap| gap["seconds"].as_f64().unwrap()).collect();
    assert!(gaps.len() as u64 <= counted && gaps.len() as u64 + 1 >= counted.min(100), "{counted} {gaps:?}");
    assert!(lengths.windows(2).all(|pair| pair[0] >= pair[1]));
    assert!(gaps.iter().all(|gap| gap["from"].as_str() < gap["to"].as_str()));
    assert_eq!(table("rotation")["covered"], 1.0);
    assert_eq!(table("daily")["covered"], 1.0);
    says(&text(&inspect(&[]).stdout), &["attitude 100.0 %", "position 0.0 % (2015-06-29T00:00:00"]);
    set.made("C", &["--no-plots", "--sensor", "OB"]);
    let level = set.level("C", "OB", "2015-07-01");
    assert!(level.numbers("position_x_km").unwrap().iter().all(|value| value.is_nan()));
    let rows = level.rows();
    says(level.says("notes").unwrap(), &[&format!("{rows} of {rows} rows of level C have no position")]);
}

#[test]
fn check_knows_the_files_that_flight_processing_writes() {
    let set = Set::of("telemetry");
    set.made("A", &["--no-plots"]);
    let record = fs::read_dir(set.out().join("report/days")).unwrap().next().unwrap().unwrap().path();
    let model = set.path("daily/RPCMAG_150701_006_CALIB_OB.toml");
    for path in [&record, &model] {
        let output = check(path);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    }
    let changed = |name: &str, of: &Path, from: &str, to: &str| {
        let path = set.path(name);
        let before = fs::read_to_string(of).unwrap();
        assert!(before.contains(from), "{before}");
        fs::write(&path, before.replacen(from, to, 1)).unwrap();
        let output = check(&path);
        assert_eq!(output.status.code(), Some(1), "{name}");
        text(&output.stderr)
    };
    says(&changed("model.toml", &model, "valid_degc", "valid_degf"), &["model.toml", "valid_degf"]);
    says(&changed("foreign.toml", &model, "RPCMAG-DAILY", "SOME-OTHER"), &["states the format `SOME-OTHER`"]);
    says(&changed("day.json", &record, "\"figures\"", "\"fingers\""), &["day.json", "is no record of a day"]);
    says(&changed("some.json", &record, "\"notes_of_mission\"", "\"notes\""), &["is JSON of no kind that calfit knows"]);
}

/// A day within the telemetry that has no vectors is nothing that a program should try again.
#[test]
fn a_day_in_a_gap_is_done_and_told() {
    let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    let folder = small.folder.path().join("edited/sensor=OB/date=2015-07-04");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("a.csv"), format!("{HEAD}2015-07-04T12:00:00Z,4,5,6,0,N\n")).unwrap();
    let of = |day: &str| {
        let config = small.folder.path().join("flight.toml");
        let out = small.folder.path().join("out");
        calfit().args(["flight", "A", "--json", "--from", day, "--to", day]).arg(config).arg("-o").arg(out).output().unwrap()
    };
    let output = of("2015-07-02");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let said = json(&output);
    assert!(said["days"].as_array().unwrap().is_empty() && said["failed"].as_array().unwrap().is_empty(), "{said}");
    says(&said["notes"].to_string(), &["there are no vectors in these days"]);
    assert_eq!(of("2016-07-02").status.code(), Some(2));
}

#[test]
fn a_table_that_tells_no_sensor_is_of_the_one_that_is_asked_for() {
    let second = PLAIN.split("[[mode]]").next().unwrap().replace("\"OB\"", "\"IB\"");
    let configuration = format!("{second}{PLAIN}[role]\nprimary = \"OB\"\nsecondary = \"IB\"\n");
    let small = Small::new(&configuration, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    fs::write(small.folder.path().join("edited/x.csv"), format!("{HEAD}2015-06-29T11:00:01Z,4,5,6,0,N\n")).unwrap();
    let of = |sensor: &[&str]| {
        let config = small.folder.path().join("flight.toml");
        let out = small.folder.path().join("out");
        calfit().args(["flight", "A", "--no-plots"]).arg(config).args(sensor).arg("-o").arg(out).output().unwrap()
    };
    let output = of(&[]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["x.csv: does not tell of which sensor it is", "--sensor"]);
    let output = of(&["--sensor", "OB"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let path = small.folder.path().join("out/level=A/sensor=OB/date=2015-06-29/calfit-A-OB-20150629.parquet");
    assert_eq!(SeriesTable::open(&path).unwrap().numbers("bx").unwrap(), [1.0, 4.0]);
}

#[test]
fn inspect_takes_one_configuration_and_names_what_is_none() {
    let set = Set::of("telemetry");
    let inspect = |paths: &[&Path]| calfit().arg("inspect").args(paths).output().unwrap();
    let config = set.path("flight.toml");
    let (by_file, by_folder) = (inspect(&[&config]), inspect(&[&set.path("")]));
    assert_eq!(by_folder.status.code(), Some(0), "{}", text(&by_folder.stderr));
    assert_eq!(text(&by_file.stdout), text(&by_folder.stdout));
    let model = set.path("daily/RPCMAG_150701_006_CALIB_OB.toml");
    for (paths, file, words) in [
        (
            vec![config.as_path(), config.as_path()],
            &config,
            "is a configuration of flight processing, and other paths are named beside it",
        ),
        (vec![model.as_path()], &model, "is no run, and no configuration of flight processing; look at it with `calfit check`"),
    ] {
        let output = inspect(&paths);
        assert_eq!(output.status.code(), Some(2));
        says(&text(&output.stderr), &[&format!("{}: {words}", file.display())]);
    }
}

#[test]
fn positions_of_another_frame_are_refused() {
    let set = Set::of("telemetry");
    let path = set.path("attitude/position.parquet");
    let table = SeriesTable::open(&path).unwrap();
    let (time, km) = (table.whole("time_tt2000").unwrap(), three(&table, ["x_km", "y_km", "z_km"]));
    let mut columns = vec![("time_tt2000", Column::Whole(&time))];
    columns.extend(["x_km", "y_km", "z_km"].into_iter().zip(&km).map(|(name, values)| (name, Column::Numbers(values))));
    let of = |frame: &str| {
        let mut file = fs::File::create(&path).unwrap();
        let mut writer = LongWriter::new(&mut file, &columns, vec![("frame".to_owned(), frame.to_owned())]).unwrap();
        writer.write(&columns).unwrap();
        writer.finish().unwrap();
        check(&set.path("flight.toml"))
    };
    assert_eq!(of("ECLIPJ2000").status.code(), Some(0));
    let output = of("CSEQ");
    assert_eq!(output.status.code(), Some(1));
    let words = "position.parquet: is of the frame CSEQ, the attitude of the configuration of ECLIPJ2000";
    says(&text(&output.stderr), &[words, "take positions of the same frame"]);
}

#[test]
fn a_thermistor_of_another_sensor_is_refused_beside_the_files_of_one() {
    let set = Set::of("telemetry");
    let table = data("tests/data/rosetta/pt1000_table.csv");
    set.change("ground/THERMISTOR__FM-IB.toml", "ground/THERMISTOR__pt1000_table.toml");
    let of_sensor = |sensor: &str| {
        let made = calfit()
            .args(["thermistor", "--order", "3", "--no-plots", "--sensor", sensor, "-o"])
            .arg(set.path("ground"))
            .arg(&table)
            .output()
            .unwrap();
        assert_eq!(made.status.code(), Some(0), "{}", text(&made.stderr));
        text(&check(&set.path("flight.toml")).stderr)
    };
    says(&of_sensor("FM-OB"), &["THERMISTOR__pt1000_table.toml", "is of sensor FM-OB, the other files are of FM-IB"]);
    assert!(!of_sensor("FM-IB").contains("the other files are of"));
}
