//! What a day of flight processing takes from its neighbours and from the other sensor: gaps over midnight, days whose continuity is not known,
//! intervals over midnight and the uncertainty of what two sensors share.

use crate::apply::with_its_hash;
use crate::common::check::{calfit, data, says, text};
use crate::flight::{Set, Small, three};
use crate::flight_faults::PLAIN;
use calfit::files::table::series::SeriesTable;
use std::fs;

const GAP: i64 = 32;

fn first_flag(table: &SeriesTable) -> i64 {
    table.whole("flags").unwrap()[0]
}

#[test]
fn the_first_vector_behind_a_gap_over_midnight_has_its_flag() {
    let configuration = PLAIN.replace("sid = \"N\"", "sid = \"N\"\nname = \"normal\"");
    let head = "time_utc,bx,by,bz,quality,sid\n";
    // The last vector of the day before: a second, 40 minutes, and two days before the first one of the day.
    for (day, time, gap) in [
        ("2015-06-30", "2015-06-30T23:59:60Z", 0),
        ("2015-06-30", "2015-06-30T23:20:00Z", GAP),
        ("2015-06-28", "2015-06-28T12:00:00Z", GAP),
    ] {
        let small = Small::new(&configuration, "");
        fs::remove_dir_all(small.folder.path().join("edited/sensor=OB")).unwrap();
        for (day, time) in [(day, time), ("2015-07-01", "2015-07-01T00:00:00Z")] {
            let folder = small.folder.path().join(format!("edited/sensor=OB/date={day}"));
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join("a.csv"), format!("{head}{time},1,2,3,0,N\n")).unwrap();
        }
        let out = small.folder.path().join("out");
        let made = calfit()
            .args(["flight", "A", "--no-plots"])
            .arg(small.folder.path().join("flight.toml"))
            .arg("-o")
            .arg(&out)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", text(&made.stderr));
        let level = |day: &str| {
            let name = format!("level=A/sensor=OB/date={day}/calfit-A-OB-{}.parquet", day.replace('-', ""));
            SeriesTable::open(&out.join(name)).unwrap()
        };
        assert_eq!(first_flag(&level("2015-07-01")) & GAP, gap, "{time}");
        // Nothing was before the first vector of all.
        assert_eq!(first_flag(&level(day)) & GAP, 0);
    }
}

#[test]
fn a_mode_may_stand_in_a_configuration_before_its_rate_is_known() {
    let set = Set::of("telemetry");
    set.change("sid = \"SID6\"\n", "sid = \"SID6\"\nname = \"test\"\n").made("A", &["--no-plots"]);
    // Where vectors need it, it is asked for.
    let configuration = fs::read_to_string(set.path("flight.toml")).unwrap();
    let begin = configuration.find("sid = \"SID6\"").unwrap();
    let rate = configuration[begin..].find("rate_hz").unwrap() + begin;
    let end = configuration[rate..].find(", ").unwrap() + rate + 2;
    fs::write(set.path("flight.toml"), format!("{}{}", &configuration[..rate], &configuration[end..])).unwrap();
    let output = set.flight("A", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["mode SID6 states no `rate_hz` with a `shift_s` for the primary sensor"]);
}

#[test]
fn the_first_pass_names_days_that_are_not_known_and_the_others_go_on() {
    let set = Set::of("telemetry");
    fs::write(set.path("daily/RPCMAG_150630_006_CALIB_IB.toml"), "format = \"RPCMAG-DAILY\"\n").unwrap();
    set.change("enabled = false", "enabled = true");
    let carry = set.path("carry.parquet");
    let made = calfit().args(["flight", "carry"]).arg(set.path("flight.toml")).arg("-o").arg(&carry).output().unwrap();
    assert_eq!(made.status.code(), Some(1));
    says(
        &text(&made.stderr),
        &["IB 2015-07-01: how the model goes on at midnight is not known", "RPCMAG_150630_006_CALIB_IB.toml"],
    );
    let output = set.flight("A", &["--carry", &carry.display().to_string(), "--from", "2015-07-01", "--no-plots"]);
    assert_eq!(output.status.code(), Some(1));
    // The reason is that of the first pass.
    says(&text(&output.stderr), &["IB 2015-07-01", "is not known", "RPCMAG_150630_006_CALIB_IB.toml"]);
    assert!(set.out().join("level=A/sensor=OB/date=2015-07-01").exists());
    assert!(!set.out().join("level=A/sensor=IB/date=2015-07-01").exists());
}

/// Square roots of sums of squares with weights, component by component.
fn together(weights: [f64; 2], stds: [f64; 2]) -> f64 {
    (weights[0] * stds[0]).hypot(weights[1] * stds[1])
}

#[test]
fn what_two_sensors_share_has_the_uncertainty_of_both() {
    let set = Set::of("telemetry");
    set.made("EJ", &["--no-plots"]);
    let set_e = set.change("[[mode]]", "[pca]\ninputs = [\"E\", \"E\"]\n\n[[mode]]");
    fs::remove_dir_all(set.out()).unwrap();
    set_e.made("EJ", &["--no-plots"]);
    let day = "2015-07-01";
    let [ob, ib] = ["OB", "IB"].map(|sensor| set.level("E", sensor, day));
    let places = |table: &SeriesTable| -> std::collections::HashMap<i64, usize> {
        table.whole("time_tt2000").unwrap().into_iter().enumerate().map(|(row, time)| (time, row)).collect()
    };
    let (of_ob, of_ib) = (places(&ob), places(&ib));
    for (name, rest) in [("common", [0.0, 0.0]), ("own_OB", [1.0, 0.0]), ("own_IB", [0.0, 1.0])] {
        let shared = set.level("J", name, day);
        let times = shared.whole("time_tt2000").unwrap();
        assert!(times.len() > 50);
        assert!(shared.says("uncertainty").unwrap().contains("both sensors"));
        for (column, axis) in [("x", "axis_x"), ("y", "axis_y"), ("z", "axis_z")] {
            let words: Vec<f64> =
                shared.says(axis).unwrap().split([' ', ',']).filter_map(|word| word.parse().ok()).take(2).collect();
            let sum = words[0] + words[1];
            // The common part is the weighted mean; the rest is a sensor less that mean.
            let weights = [rest[0] - words[0] / sum, rest[1] - words[1] / sum];
            for kind in ["ua", "uc"] {
                let of = |table: &SeriesTable| table.numbers(&format!("{kind}_{column}")).unwrap();
                let (a, b, found) = (of(&ob), of(&ib), of(&shared));
                for (row, time) in times.iter().enumerate() {
                    let wanted = together(weights, [a[of_ob[time]], b[of_ib[time]]]);
                    // Columns of uncertainties have seven digits.
                    assert!((found[row] - wanted).abs() <= 1e-5 * wanted, "{name} {kind}_{column}: {} {wanted}", found[row]);
                }
            }
        }
    }
}

#[test]
fn principal_axes_of_an_interval_over_midnight_are_those_of_the_whole_interval() {
    let set = Set::of("telemetry");
    let interval = "[pca]\nfrom = \"2015-06-30T23:59:30Z\"\nto = \"2015-07-01T00:00:40Z\"\n\n[[mode]]";
    set.change("[[mode]]", interval).made("J", &["--no-plots"]);
    let days = ["2015-06-30", "2015-07-01"].map(|day| set.level("J", "common", day));
    let said = days.each_ref().map(|table| ["axis_x", "axis_y", "axis_z"].map(|axis| table.says(axis).unwrap().to_owned()));
    assert_eq!(said[0], said[1]);
    let rows = days.each_ref().map(|table| table.rows());
    // Both sensors have only a few means in common before midnight.
    assert!(rows[0] >= 1 && rows[1] > 10, "{rows:?}");
    assert!(said[0][0].ends_with(&format!("{} pairs", rows[0] + rows[1])), "{} {rows:?}", said[0][0]);
    assert!(three(&days[0], ["bx", "by", "bz"])[0].iter().all(|v| v.is_finite()));
}

#[test]
fn days_in_the_wrong_order_are_refused_and_levels_of_two_sensors_are_named() {
    let set = Set::of("telemetry");
    let output = set.flight("A", &["--from", "2015-07-01", "--to", "2015-06-30"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["--from 2015-07-01 is after --to 2015-06-30"]);
    let output = set.flight("all", &["--sensor", "OB", "--no-plots"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    says(&text(&output.stdout), &["levels D and J are made of two sensors, and are left out with --sensor"]);
    // They are made by themselves, byte by byte as with all others.
    let file = "level=J/sensor=common/date=2015-07-01/calfit-J-common-20150701.parquet";
    assert!(!set.out().join(file).exists());
    set.made("all", &["--sensor", "common", "--no-plots"]);
    let alone = fs::read(set.out().join(file)).unwrap();
    fs::remove_dir_all(set.out()).unwrap();
    set.made("all", &["--no-plots"]);
    assert!(alone == fs::read(set.out().join(file)).unwrap());
    let output = set.flight("AB", &["--sensor", "common"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["what two sensors share is in levels D and J, and none of them is asked for"]);
}

#[test]
fn one_matrix_holds_for_a_moment_and_range_and_its_covariance_is_one() {
    let matrix = |from: &str, to: &str, rest: &str| {
        format!(
            "[[sensor.matrix]]\nfrom = \"{from}\"\nto = \"{to}\"\nmatrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n{rest}\n"
        )
    };
    let mode = "[[mode]]\nsid = \"N\"\npacket_s = 1\nprimary = { rate_hz = 1.0, shift_s = 0.0 }\n";
    let negative: Vec<String> = (0..12)
        .map(|row| {
            format!(
                "[{}]",
                (0..12)
                    .map(|c| if c != row {
                        "0"
                    } else if row == 4 {
                        "-1"
                    } else {
                        "1"
                    })
                    .collect::<Vec<_>>()
                    .join(",")
            )
        })
        .collect();
    let negative = format!("covariance = [{}]", negative.join(","));
    let cases = [
        // A matrix for every range, and one of its own for range 1 in the same time.
        (matrix("2015-01-01", "2016-01-01", "") + &matrix("2015-06-01", "2015-07-01", "range = 1"), "overlap for one range"),
        (
            matrix("2015-01-01", "2016-01-01", "range = 1") + &matrix("2015-06-01", "2015-07-01", "range = 1"),
            "overlap for one range",
        ),
        (matrix("2015-01-01", "2016-01-01", &negative), "has a negative variance"),
        (matrix("2015-01-01", "2016-01-01", "").replace("[0.0, 0.0, 1.0]", "[0.0, 1.0, 0.0]"), "has no inverse"),
        (
            format!("frame = \"rosetta\"\n{}", matrix("2015-01-01", "2016-01-01", "")),
            "`sensor.frame` is of ground files, and changes nothing of matrices",
        ),
        (format!("ground = [\"a.TXT\"]\n{}", matrix("2015-01-01", "2016-01-01", "")), "`sensor.matrix` stands beside `ground`"),
    ];
    for (matrices, words) in cases {
        let configuration = format!("[[sensor]]\nname = \"OB\"\nent_per_count = 1.0\n{matrices}{mode}");
        let small = Small::new(&configuration, "time_utc,bx,by,bz,quality,sid\n2015-06-29T11:00:00Z,1,2,3,0,N\n");
        let output = calfit().arg("check").arg(small.folder.path().join("flight.toml")).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{words}");
        says(&text(&output.stderr), &[words]);
    }
}

#[test]
fn the_configuration_of_rosetta_is_read_as_far_as_it_is_printed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.toml");
    fs::copy(data("tests/data/flight/rosetta-flight.toml"), &path).unwrap();
    let output = calfit().arg("check").arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    // Nothing is wrong with it but that its files are not here.
    for line in text(&output.stderr).lines().filter(|line| line.contains("error")) {
        assert!(line.contains("No such file or directory"), "{line}");
    }
}

#[test]
fn offsets_of_a_table_are_taken_off_by_time_and_range() {
    let keys = "ent_per_count = [1.0, 1.0]\noffsets = \"offsets.csv\"\noffsets_frame = \"uvw\"";
    let configuration = PLAIN.replace("ent_per_count = 1.0", keys);
    let rows = "time_utc,bx,by,bz,quality,sid,range\n2015-06-29T11:00:00Z,100,200,300,0,N,0\n2015-06-29T11:00:01Z,100,200,300,0,N,1\n\
                2015-06-29T12:00:00Z,100,200,300,0,N,0\n";
    let head = "from,to,sensor,range,x_nt,y_nt,z_nt\n";
    let own =
        "2015-06-29T00:00:00Z,2015-06-29T11:30:00Z,OB,0,1.5,-2,3\n2015-06-29T00:00:00Z,2015-06-29T11:30:00Z,OB,1,10,20,30\n";
    let other = "2015-06-29T00:00:00Z,2015-06-30T00:00:00Z,IB,,7,7,7\n";
    let small = Small::new(&configuration, rows);
    let table = small.folder.path().join("offsets.csv");
    fs::write(&table, format!("{head}{own}{other}")).unwrap();
    let level = small.level_a();
    let [x, y, z] = three(&level, ["bx", "by", "bz"]);
    // The last vector is outside of all intervals, and has the flag JUMP of the level in which offsets act.
    assert_eq!([x, y, z], [vec![98.5, 90.0, 100.0], vec![202.0, 180.0, 200.0], vec![297.0, 270.0, 300.0]]);
    let flags: Vec<i64> = level.whole("flags").unwrap().iter().map(|flags| flags & 4).collect();
    assert_eq!(flags, [0, 0, 4]);
    for (row, words) in [
        ("2015-06-29T11:00:00Z,2015-06-29T13:00:00Z,OB,,1,1,1\n", "two offsets of the sensor hold at 2015-06-29T11:00:00"),
        ("2015-06-29T13:00:00Z,2015-06-29T12:00:00Z,OB,,1,1,1\n", "the interval ends before it begins"),
        ("2015-06-29T12:00:00Z,2015-06-29T13:00:00Z,OB,1.5,1,1,1\n", "`range` is 1.5, not 0 to 255"),
        ("2015-06-29T12:00:00Z,2015-06-29T13:00:00Z,OB,,1,,1\n", "has an offset that is no number"),
    ] {
        fs::write(&table, format!("{head}{own}{row}")).unwrap();
        let output = calfit().arg("check").arg(small.folder.path().join("flight.toml")).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{row}");
        says(&text(&output.stderr), &["offsets.csv", words]);
    }
    fs::write(&table, format!("{head}{other}")).unwrap();
    let output = calfit().arg("check").arg(small.folder.path().join("flight.toml")).output().unwrap();
    says(&text(&output.stderr), &["has no row of sensor OB"]);
}

#[test]
fn vectors_beyond_the_table_of_the_thermistor_are_null_with_their_flag() {
    let set = Set::of("telemetry");
    let file = set.path("ground/THERMISTOR__FM-IB.toml");
    let before = fs::read_to_string(&file).unwrap();
    assert!(before.contains("valid_degc = [-150.0, 150.0]"));
    // The sensor is at 10 to 20 °C.
    fs::write(&file, with_its_hash(&before.replace("valid_degc = [-150.0, 150.0]", "valid_degc = [40.0, 150.0]"))).unwrap();
    set.made("A", &["--sensor", "IB", "--no-plots"]);
    let level = set.level("A", "IB", "2015-07-01");
    assert!(level.rows() > 10);
    assert!(level.whole("flags").unwrap().iter().all(|flags| flags & 1 != 0));
    assert!(level.numbers("bx").unwrap().iter().all(|v| v.is_nan()));
    // A table that has no temperature in common with the calibration is none of this sensor.
    fs::write(&file, with_its_hash(&before.replace("valid_degc = [-150.0, 150.0]", "valid_degc = [400.0, 500.0]"))).unwrap();
    let output = set.flight("A", &["--sensor", "IB", "--no-plots"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["THERMISTOR__FM-IB.toml", "at which the calibration does not hold"]);
}

/// Levels of an earlier state of telemetry or configuration stay beside those that are made now, which has to be said.
#[test]
fn levels_from_before_that_are_of_other_inputs_are_told() {
    let set = Set::of("telemetry");
    let said = |levels: &str| {
        let output = set.flight(levels, &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    assert!(!said("ABE").contains("from before"));
    assert!(!said("A").contains("from before"));
    let path = set.path("flight.toml");
    let configuration = fs::read_to_string(&path).unwrap();
    fs::write(&path, format!("{configuration}\n# looked through\n")).unwrap();
    let told = said("AB");
    says(
        &told,
        &[
            "note: level E of OB on 2015-06-30 stands in the folder from before",
            "`calfit flight all`",
            "level E of IB on 2015-07-01",
        ],
    );
    assert!(!told.contains("level A of"), "{told}");
    assert!(!said("E").contains("from before"));
}
