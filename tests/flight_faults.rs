//! What is wrong with the inputs of flight processing is named with file and row, nothing is half written, and the other days go on.

use crate::common::check::{calfit, says, text, tree};
use crate::flight::{Set, Small, three};
use calfit::files::table::long::{Column, LongWriter};
use calfit::files::table::series::SeriesTable;
use std::fs;
use std::path::Path;

/// A sensor whose counts are its field, with one mode of a vector a second.
pub const PLAIN: &str = r#"
[[sensor]]
name = "OB"
ent_per_count = 1.0
[[sensor.matrix]]
from = "2015-01-01"
to = "2016-01-01"
matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
[[mode]]
sid = "N"
packet_s = 1
primary = { rate_hz = 1.0, shift_s = 0.0 }
"#;
pub const HEAD: &str = "time_utc,bx,by,bz,quality,sid\n";

/// Every file of a folder of results.
fn files(folder: &Path) -> Vec<String> {
    let mut out = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).into_iter().flatten().flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else {
                out.push(entry.file_name().to_string_lossy().into_owned());
            }
        }
    }
    out
}

#[test]
fn a_wrong_row_is_named_and_the_other_day_is_made() {
    for (row, words) in [
        ("2015-06-29T11:00:01Z,524288,0,0,0,N", "row 2: the count 524288 is none of the converter, -524288 to 524287"),
        ("2015-06-29T11:00:01Z,0,-524289,0,0,N", "row 2: the count -524289 is none of the converter"),
        ("2015-06-29T11:00:01Z,0,0,0,256,N", "row 2: `quality` is 256, not 0 to 255"),
        ("2015-06-29T11:00:01Z,0,0,0,0,M", "row 2: its mode M is not stated"),
        ("2015-07-08T11:00:01Z,0,0,0,0,N", "row 2: the time 2015-07-08T11:00:01.000000000 is not of the day of the partition"),
        ("2015-06-29T25:00:01Z,0,0,0,0,N", "row 2: the cell in column `time_utc` is no time"),
        ("2015-06-29T11:00:01Z,0,,0,0,N", "row 2: a count has no value"),
    ] {
        // A converter of 20 bits, as in RO-IGEP-TR0028, where nothing else is stated.
        let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n{row}\n"));
        let day = small.folder.path().join("edited/sensor=OB/date=2015-06-30");
        fs::create_dir_all(&day).unwrap();
        fs::write(day.join("b.csv"), format!("{HEAD}2015-06-30T12:00:00Z,4,5,6,0,N\n")).unwrap();
        let out = small.folder.path().join("out");
        let mut command = calfit();
        let output =
            command.args(["flight", "A", "--no-plots"]).arg(small.folder.path().join("flight.toml")).arg("-o").arg(&out).output();
        let output = output.unwrap();
        assert_eq!(output.status.code(), Some(1), "{row}: {}", text(&output.stderr));
        says(&text(&output.stderr), &["a.csv", words, "OB 2015-06-29 was not made"]);
        // The other day is there, and of the broken one not even a part.
        let tables: Vec<String> = files(&out).into_iter().filter(|name| name.contains("calfit-")).collect();
        assert_eq!(tables, ["calfit-A-OB-20150630.parquet"], "{row}");
    }
}

#[test]
fn a_table_that_ends_inside_a_line_is_refused() {
    // The last count is 1234: half of it is there, nothing of it, or all of it, which the file does not tell.
    let small = Small::new(PLAIN, HEAD);
    let path = small.folder.path().join("edited/sensor=OB/date=2015-06-29/a.csv");
    let head = "time_utc,quality,sid,bx,by,bz\n2015-06-29T11:00:00Z,0,N,1,2,1200\n";
    for last in ["2015-06-29T11:00:01Z,0,N,1,2,12", "2015-06-29T11:00:01Z,0,N,1", "2015-06-29T11:00:01Z,0,N,1,2,1234"] {
        fs::write(&path, format!("{head}{last}")).unwrap();
        let mut command = calfit();
        command.args(["flight", "A", "--no-plots"]).arg(small.folder.path().join("flight.toml"));
        let output = command.arg("-o").arg(small.folder.path().join("out")).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{last}: {}", text(&output.stderr));
        says(&text(&output.stderr), &["a.csv:3", "the file ends inside a line; the last good row is line 2"]);
    }
    // With its line end it is whole.
    fs::write(&path, format!("{head}2015-06-29T11:00:01Z,0,N,1,2,1234\n")).unwrap();
    assert_eq!(small.level_a().numbers("bz").unwrap(), [1200.0, 1234.0]);
}

/// What is said while level A is made.
fn told_of_level_a(small: &Small) -> String {
    let mut command = calfit();
    let config = small.folder.path().join("flight.toml");
    let output = command.args(["flight", "A", "--no-plots"]).arg(config).arg("-o").arg(small.folder.path().join("out")).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout) + &text(&output.stderr)
}

/// Ten minutes of a steady field of 200, -300 and 400 nT, a vector a second in steps of 0.01 nT, and what a fault makes of the counts by the second.
fn ten_minutes(more: &str, fault: &dyn Fn(i64, [i64; 3]) -> [i64; 3]) -> Small {
    let configuration = PLAIN.replace("ent_per_count = 1.0", "ent_per_count = 0.01");
    let row = |second: i64| {
        let noise = |k: i64| (second * 7919 + k * 101) % 11 - 5;
        let [x, y, z] = fault(second, [20_000 + noise(1), -30_000 + noise(2), 40_000 + noise(3)]);
        format!("2015-06-29T11:{:02}:{:02}Z,{x},{y},{z},0,N\n", second / 60, second % 60)
    };
    let rows: String = (0..600).map(row).collect();
    Small::new(&format!("{configuration}{more}"), &format!("{HEAD}{rows}"))
}

#[test]
fn a_sign_or_a_gain_that_changes_within_a_day_is_told() {
    const STEPS: &str = "the field of the sensor steps";
    let flipped = |second: i64, [x, y, z]: [i64; 3]| [x, y, if second < 300 { z } else { -z }];
    let half = |second: i64, counts: [i64; 3]| if second < 300 { counts } else { counts.map(|count| count / 2) };
    let sound = |_: i64, counts: [i64; 3]| counts;
    let told = told_of_level_a(&ten_minutes("", &flipped));
    let at = "at 2015-06-29T11:05:00.000000000, and by no more than";
    says(&told, &[&format!("{STEPS} by -800."), &format!("nT in z {at}"), "no table states a change there"]);
    let told = told_of_level_a(&ten_minutes("", &half));
    says(&told, &[&format!("{STEPS} by -100."), "nT in y, -200.", &format!("nT in z {at}")]);
    assert!(!told_of_level_a(&ten_minutes("", &sound)).contains(STEPS));
    // The housekeeping has the field as it is, every ten seconds: RO-IGEP-TR0028 section 4.2.2, 65535 counts over 32768 enT from -16384 enT on.
    let count = |ent: f64| (((ent + 16_384.0) * 65_535.0 / 32_768.0).round() as i64 + 32_768) % 65_536;
    let [x, y, z] = [200.0, -300.0, 400.0].map(count);
    let row = |k: i64| format!("2015-06-29T11:{:02}:{:02}Z,{x},{y},{z}\n", k / 6, k % 6 * 10);
    let rows: String = (0..60).map(row).collect();
    let beside = |fault: &dyn Fn(i64, [i64; 3]) -> [i64; 3]| {
        let small = ten_minutes("", fault);
        let day = small.folder.path().join("hk/date=2015-06-29");
        fs::create_dir_all(&day).unwrap();
        fs::write(day.join("a.csv"), format!("time_utc,bx_ob,by_ob,bz_ob\n{rows}")).unwrap();
        told_of_level_a(&small)
    };
    let from = "from 2015-06-29T11:05:00.000000000 on: one of the two";
    let told = beside(&half);
    says(&told, &["30 of 60 of `bx_ob` by up to 100 enT", "30 of 60 of `bz_ob` by up to 200 enT", from]);
    let factor: f64 = told.split("all three by a factor ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((factor - 2.0).abs() < 0.01, "{told}");
    says(&beside(&flipped), &["telemetry beside them, 30 of 60 of `bz_ob` by up to 800 enT", from]);
    assert!(!beside(&sound).contains("readings of the housekeeping"));
}

#[test]
fn an_offset_of_a_table_that_is_in_other_axes_is_told() {
    // The sensor's y axis is the -x axis of the spacecraft: the field jumps by 6 nT along x there, which the table takes off.
    let jumping = |second: i64, [x, y, z]: [i64; 3]| [x, if second < 300 { y } else { y - 600 }, z];
    let table = |frame: &str| {
        let jump = |from: &str, to: &str, x: &str| {
            format!("[[sensor.jump]]\nfrom = \"{from}\"\nto = \"{to}\"\nframe = \"{frame}\"\nsubtract_nt = [{x}, 0.0, 0.0]\n")
        };
        let rotation = "[[sensor.rotation]]\nboom = \"deployed\"\nfrom = \"2015-01-01\"\nto = \"2016-01-01\"\n\
                        uvw_to_sc = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n";
        let middle = "2015-06-29T11:05:00Z";
        format!("{rotation}{}{}", jump("2015-01-01", middle, "0.0"), jump(middle, "2016-01-01", "6.0"))
    };
    assert!(!told_of_level_a(&ten_minutes(&table("sc"), &jumping)).contains("where the table of offsets changes"));
    // Taken off along the x axis of the sensor, it leaves 6 nT along x and makes 6 nT along y of the spacecraft.
    let told = told_of_level_a(&ten_minutes(&table("uvw"), &jumping));
    let at = "nT at 2015-06-29T11:05:00.000000000, where the table of offsets changes";
    says(&told, &["the field still steps by 8.", at, "check its frame"]);
}

#[test]
fn a_file_without_rows_is_named_and_its_day_is_missing() {
    let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    for (day, rows) in [("2015-06-30", ""), ("2015-07-01", "2015-07-01T12:00:00Z,4,5,6,0,N\n")] {
        let folder = small.folder.path().join(format!("edited/sensor=OB/date={day}"));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("b.csv"), format!("{HEAD}{rows}")).unwrap();
    }
    let told = told_of_level_a(&small);
    let empty = "edited/sensor=OB/date=2015-06-30/b.csv has no rows: the vectors of this day are missing";
    says(&told, &[empty, "OB has no vectors on 2015-06-30, between days that have some"]);
}

#[test]
fn a_damaged_file_takes_away_its_own_day_and_what_rests_on_it() {
    for (damaged, other, is_made) in [("2015-07-01", "2015-06-30", true), ("2015-06-30", "2015-07-01", false)] {
        let set = Set::of("telemetry");
        let path = set.path(&format!("edited/sensor=OB/date={damaged}/part-0.parquet"));
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let output = set.change("enabled = false", "enabled = true").flight("A", &["--sensor", "OB", "--no-plots"]);
        assert_eq!(output.status.code(), Some(1), "{damaged}: {}", text(&output.stderr));
        let told = text(&output.stderr);
        says(&told, &[&format!("date={damaged}/part-0.parquet"), &format!("OB {damaged} was not made")]);
        let tables: Vec<String> = files(&set.out()).into_iter().filter(|name| name.contains("calfit-")).collect();
        if is_made {
            // The day before the damage has its model and its begin.
            assert_eq!(tables, [format!("calfit-A-OB-{}.parquet", other.replace('-', ""))]);
        } else {
            // The sum at midnight behind it is not known, and the reason is that file.
            assert!(tables.is_empty(), "{tables:?}");
            says(
                &told,
                &[&format!("OB {other}: how the model goes on at midnight is not known from a day before it"), "part-0.parquet"],
            );
        }
    }
}

#[test]
fn a_day_without_telemetry_between_others_is_named() {
    let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    for day in ["2015-07-01", "2015-07-04"] {
        let folder = small.folder.path().join(format!("edited/sensor=OB/date={day}"));
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("a.csv"), format!("{HEAD}{day}T12:00:00Z,4,5,6,0,N\n")).unwrap();
    }
    let told = told_of_level_a(&small);
    says(&told, &["OB has no vectors on 2015-06-30, between", "OB has no vectors from 2015-07-02 to 2015-07-03"]);
    assert_eq!(told.matches("has no vectors").count(), 2, "{told}");
}

/// Nothing is made without a word: days without vectors, a folder without days, options that change nothing.
#[test]
fn what_gives_nothing_is_refused() {
    let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    let out = small.folder.path().join("out");
    for (levels, options, words) in [
        ("A", ["--from", "2016-07-01"].as_slice(), "gives no vectors in these days"),
        ("report", &[], "holds no days of flight processing"),
        ("report", &["--sensor", "OB"], "--sensor: changes nothing of `report`"),
        ("carry", &["--from", "2015-06-29"], "--from: changes nothing of `carry`"),
    ] {
        let config = small.folder.path().join("flight.toml");
        let output = calfit().args(["flight", levels]).arg(config).args(options).arg("-o").arg(&out).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{levels} {options:?}: {}", text(&output.stdout));
        says(&text(&output.stderr), &[words]);
    }
}

#[test]
fn telemetry_of_a_sensor_that_is_not_stated_is_refused() {
    let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    fs::create_dir_all(small.folder.path().join("edited/sensor=IB/date=2015-06-29")).unwrap();
    let output = calfit().args(["flight", "A"]).arg(small.folder.path().join("flight.toml")).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["sensor=IB: holds telemetry of sensor IB, which is none of the configuration"]);
}

#[test]
fn a_factor_stands_in_place_of_the_full_scale_and_beside_the_bits() {
    let row = format!("{HEAD}2015-06-29T11:00:00Z,524288,0,0,0,N\n");
    let small = Small::new(&PLAIN.replace("ent_per_count = 1.0\n", "ent_per_count = 1.0\nadc_bits = 24\n"), &row);
    assert_eq!(small.level_a().numbers("bx").unwrap(), [524_288.0]);
    let small = Small::new(&PLAIN.replace("ent_per_count = 1.0\n", "ent_per_count = 1.0\nfull_scale_ent = 15000.0\n"), &row);
    let mut command = calfit();
    let output = command.args(["flight", "A"]).arg(small.folder.path().join("flight.toml")).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["`sensor.ent_per_count` stands beside `full_scale_ent`", "state the one or the other"]);
}

#[test]
fn rows_may_stand_in_any_order_and_repeat() {
    // A packet twice, one of the two with another count; packets that were swapped; a vector that quality rejects.
    let rows = "2015-06-29T11:00:03Z,7,0,0,0,N\n2015-06-29T11:00:04Z,8,0,0,0,N\n2015-06-29T11:00:00Z,4,0,0,0,N\n\
                2015-06-29T11:00:01Z,5,0,0,0,N\n2015-06-29T11:00:00Z,4,0,0,0,N\n2015-06-29T11:00:01Z,55,0,0,0,N\n\
                2015-06-29T11:00:02Z,6,0,0,2,N\n";
    let small = Small::new(PLAIN, &format!("{HEAD}{rows}"));
    let level = small.level_a();
    let [x, ..] = three(&level, ["bx", "by", "bz"]);
    assert_eq!(x, [4.0, 5.0, 7.0, 8.0]);
    // The rejected vector leaves a gap of two steps.
    assert_eq!(level.whole("flags").unwrap(), [0, 0, 32, 0]);
    let counts: serde_json::Value = serde_json::from_str(level.says("counts").unwrap()).unwrap();
    for (key, wanted) in [("read", 7), ("duplicate", 2), ("conflicting", 1), ("rejected", 1), ("written", 4)] {
        assert_eq!(counts[key], wanted, "{key}: {counts}");
    }
    let (mission, again) = (small.folder.path().join("flight.toml"), small.folder.path().join("again"));
    let output = calfit().args(["flight", "A"]).arg(mission).arg("-o").arg(again).output().unwrap();
    says(&text(&output.stdout), &["repeated rows with other counts than the first of their time and mode: 1"]);
}

#[test]
fn every_program_reads_the_mode_as_text() {
    let small = Small::new(PLAIN, &format!("{HEAD}2015-06-29T11:00:00Z,1,2,3,0,N\n"));
    small.level_a();
    let path = small.folder.path().join("out/level=A/sensor=OB/date=2015-06-29/calfit-A-OB-20150629.parquet");
    let table = SeriesTable::open(&path).unwrap();
    let kind = |name: &str| table.kind(name).unwrap();
    assert_eq!(kind("sid"), "Utf8View");
    assert_eq!([kind("time_tt2000"), kind("bx"), kind("flags"), kind("quality")], ["Int64", "Float64", "UInt32", "UInt8"]);
}

#[test]
fn tables_beside_the_telemetry_are_checked_row_by_row() {
    let head = "time_utc,q0,q1,q2,q3\n2015-06-30T00:00:00Z,1.0,0.0,0.0,0.0\n";
    for (row, words) in [
        ("2015-06-30T00:00:10Z,0.5,0.0,0.0,0.0", "row 2: the quaternion has the length 0.500000, not 1"),
        ("2015-06-29T00:00:10Z,1.0,0.0,0.0,0.0", "row 2: the times do not rise"),
        ("2015-06-30T00:00:10Z,1.0,,0.0,0.0", "row 2: the quaternion has the length NaN, not 1"),
    ] {
        let set = Set::of("telemetry");
        fs::write(set.path("attitude/a.csv"), format!("{head}{row}\n")).unwrap();
        let output = set.change("attitude/attitude.parquet", "attitude/a.csv").flight("C", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
        says(&text(&output.stderr), &["a.csv", words]);
        assert!(files(&set.out()).is_empty());
    }
    // A table that says of itself that it is of another order, direction or frame.
    for (key, own) in [("attitude_order", "scalar-last"), ("attitude_from_to", "celestial to sc"), ("frame", "CSEQ")] {
        let set = Set::of("telemetry");
        let table = SeriesTable::open(&set.path("attitude/attitude.parquet")).unwrap();
        let time = table.whole("time_tt2000").unwrap();
        let q = ["q0", "q1", "q2", "q3"].map(|name| table.numbers(name).unwrap());
        let mut columns = vec![("time_tt2000", Column::Whole(&time))];
        columns.extend(["q0", "q1", "q2", "q3"].into_iter().zip(&q).map(|(name, c)| (name, Column::Numbers(c))));
        let mut file = fs::File::create(set.path("attitude/b.parquet")).unwrap();
        let mut writer = LongWriter::new(&mut file, &columns, vec![(key.to_owned(), own.to_owned())]).unwrap();
        writer.write(&columns).unwrap();
        writer.finish().unwrap();
        let output = set.change("attitude/attitude.parquet", "attitude/b.parquet").flight("C", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
        says(&text(&output.stderr), &["b.parquet", &format!("says `{key}` of itself as `{own}`")]);
    }
}

#[test]
fn a_coupling_in_axes_that_turn_against_the_spacecraft_is_told() {
    const NOTE: &str = "the coupling of [pca] is applied to means of the levels";
    let gradiometer = "[pca]\nmethod = \"gradiometer\"\ncoupling = [[1.5, 0.1, 0.1], [0.1, 1.8, 0.1], [0.1, 0.1, 1.7]]\n";
    for (inputs, wanted) in [("", 1), ("inputs = [\"I\", \"G\"]\n", 1), ("inputs = [\"F\", \"F\"]\n", 0)] {
        let set = Set::of("telemetry");
        set.change("[celestial]", &format!("{gradiometer}{inputs}\n[celestial]"));
        let output = calfit().arg("check").arg(set.path("flight.toml")).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let told = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(told.matches(NOTE).count(), wanted, "{inputs}: {told}");
    }
}

#[test]
fn what_two_sensors_share_has_the_axes_of_their_means() {
    // Levels of different axes have no field in common.
    let set = Set::of("telemetry");
    let output = set.change("[celestial]", "[pca]\ninputs = [\"E\", \"G\"]\n\n[celestial]").flight("J", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["pca.inputs", "different axes"]);
    // One sensor has no such level.
    let set = Set::of("telemetry");
    let output = set.flight("J", &["--sensor", "OB", "--no-plots"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["level J is made of two sensors", "leave --sensor out"]);
    for (inputs, frame) in [("F", "spacecraft"), ("G", "ECLIPJ2000")] {
        let set = Set::of("telemetry");
        let stated = format!("[pca]\ninputs = [\"{inputs}\", \"{inputs}\"]\n\n[celestial]");
        let output = set.change("[celestial]", &stated).flight("J", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let all = tree(&set.out());
        let name = all.keys().find(|name| name.contains("calfit-J-") && name.ends_with(".parquet")).unwrap();
        assert_eq!(SeriesTable::open(&set.out().join(name)).unwrap().says("frame"), Some(frame));
    }
}

#[test]
fn ground_files_of_another_sensor_or_convention_are_refused() {
    const OB: &str = "ground/RPCMAG_001_CALIB_FSDPU_FMOB.TXT";
    for (from, to, words) in [
        ("sensor = \"FM-OB\"", "sensor = \"FM-XX\"", "FM-XX"),
        ("omega_convention = \"Rosetta\"", "omega_convention = \"BepiColombo\"", "omega_convention"),
        ("offset_unit = \"enT\"", "offset_unit = \"nT\"", "offset_unit"),
        ("offset_sign = \"subtracted\"", "offset_sign = \"added\"", "offset_sign"),
        ("offset_acts = \"before the matrix\"", "offset_acts = \"after the matrix\"", "offset_acts"),
        ("sensor = \"FM-OB\"", "sensor = \"FM-OB\"\nknown_effects = [\"cubic.toml\"]", "effects of cubic.toml were taken off"),
    ] {
        let set = Set::of("telemetry");
        let ground = fs::read_to_string(set.path(OB)).unwrap();
        assert!(ground.contains(from), "{from}");
        fs::write(set.path(OB), ground.replace(from, to)).unwrap();
        let output = set.flight("A", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(2), "{to}: {}", text(&output.stderr));
        says(&text(&output.stderr), &["RPCMAG_001_CALIB_FSDPU_FMOB.TXT", words]);
        assert!(files(&set.out()).is_empty());
    }
    // Files of one sensor that name different ones.
    let set = Set::of("telemetry");
    let tof = fs::read_dir(set.path("ground")).unwrap().flatten().map(|e| e.path());
    let tof = tof.into_iter().find(|path| path.extension().is_some_and(|end| end == "TOF")).unwrap();
    fs::write(&tof, fs::read_to_string(&tof).unwrap().replace("FM-IB", "FM-OB")).unwrap();
    let output = set.flight("A", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &[".TOF"]);
}

#[test]
fn housekeeping_has_the_names_and_times_that_telemetry_has() {
    let set = Set::of("telemetry");
    let day = set.path("hk/date=2015-06-30");
    fs::remove_dir_all(&day).unwrap();
    fs::create_dir_all(&day).unwrap();
    // 2015-06-30T00:00:32 UTC: 4563 days since 2003, 32 s, and three leap seconds between.
    fs::write(day.join("a.csv"), "TIME_OBT,T_OB,BX.OB,POS_VOLTAGE,STAGE_A_ID\n394243235.0,13837,0,1,7\n").unwrap();
    set.made("A", &["--hk", "--sensor", "IB", "--no-plots"]);
    let table = SeriesTable::open(&set.out().join("level=HK/date=2015-06-30/calfit-HK-20150630.parquet")).unwrap();
    assert_eq!(table.whole("stage_a_id").unwrap(), [7]);
    // RO-IGEP-TR0028 section 4.2.2: the count 0 is a quarter of an enT, one count of the supply 2.5620 mV.
    assert!((table.numbers("bx_ob").unwrap()[0] - 0.25).abs() < 1e-3);
    assert!((table.numbers("pos_voltage").unwrap()[0] - 5.002_562_0).abs() < 1e-6);
    assert!(table.numbers("t_ob").unwrap()[0].is_finite());
    let utc = table.utc("time_utc", &calfit::data::time::LeapSeconds::default()).unwrap();
    assert_eq!(utc, table.whole("time_tt2000").unwrap());
    // 2015-07-01T00:00:00 UTC is 488980868184000000; the day before ends with a leap second.
    assert_eq!(utc, [488_980_868_184_000_000 - (86_401 - 32) * 1_000_000_000]);
}

#[test]
fn a_field_that_follows_the_housekeeping_takes_its_readings_with_the_same_checks() {
    let steps = "[pipeline]\nsteps = [\"counts\", \"ground\", \"disturbance\", \"shift\"]\n";
    let stated = "[[disturbance]]\ncolumn = \"pos_voltage\"\nvector_nt_per_unit = [2.0, -1.0, 0.5]\n";
    let small = Small::new(&format!("{PLAIN}{stated}{steps}"), &format!("{HEAD}2015-06-29T11:00:05Z,100,200,300,0,N\n"));
    let day = small.folder.path().join("hk/date=2015-06-29");
    fs::create_dir_all(&day).unwrap();
    // 2015-06-29T11:00:00 UTC is 394196403 s of the clock: 4562 days since 2003, 11 h, and three leap seconds between.
    fs::write(day.join("a.csv"), "TIME_OBT,POS_VOLTAGE\n394196403.0,10\n394196423.0,50\n").unwrap();
    let [x, y, z] = three(&small.level_a(), ["bx", "by", "bz"]);
    // A quarter of the way from 10 to 50 counts.
    assert_eq!([x[0], y[0], z[0]], [60.0, 220.0, 290.0]);
    fs::remove_dir_all(small.folder.path().join("out")).unwrap();
    let head = "time_utc,time_obt,pos_voltage\n2015-06-29T11:00:00Z,394196403.0,10\n";
    for (row, words) in [
        ("2015-06-29T11:00:20Z,394196423.0,300", "row 2: the count 300 of `pos_voltage` is none of 8 bits"),
        ("2015-06-29T11:00:20Z,394196423.0,", "row 2: column `pos_voltage` has no value"),
        ("2015-06-29T11:00:20Z,394197023.0,50", "row 2: `time_utc` says 2015-06-29T11:00:20"),
        (
            "2015-06-27T11:00:20Z,394023623.0,50",
            "row 2: the time 2015-06-27T11:00:20.000000000 is not of the day of the partition",
        ),
    ] {
        fs::write(day.join("a.csv"), format!("{head}{row}\n")).unwrap();
        let mut command = calfit();
        command.args(["flight", "A", "--no-plots"]).arg(small.folder.path().join("flight.toml"));
        let output = command.arg("-o").arg(small.folder.path().join("out")).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{row}: {}", text(&output.stderr));
        says(&text(&output.stderr), &["a.csv", words]);
    }
}

#[test]
fn housekeeping_outside_of_partitions_belongs_to_the_days_of_its_times() {
    let set = Set::of("telemetry");
    fs::remove_dir_all(set.path("hk")).unwrap();
    fs::create_dir_all(set.path("hk/date=2015-07-01")).unwrap();
    let head = "time_utc,t_ob,stage_a_id\n";
    fs::write(set.path("hk/all.csv"), format!("{head}2015-06-30T23:59:60.5Z,13837,6\n2015-07-01T00:00:00Z,13837,7\n")).unwrap();
    fs::write(set.path("hk/date=2015-07-01/a.csv"), format!("{head}2015-07-01T00:01:04Z,13837,8\n")).unwrap();
    set.made("A", &["--hk", "--sensor", "IB", "--no-plots"]);
    for (day, wanted) in [("2015-06-30", vec![6]), ("2015-07-01", vec![7, 8])] {
        let path = format!("level=HK/date={day}/calfit-HK-{}.parquet", day.replace('-', ""));
        let table = SeriesTable::open(&set.out().join(path)).unwrap();
        assert_eq!(table.whole("stage_a_id").unwrap(), wanted, "{day}");
    }
}
