//! `calfit flight`: telemetry becomes the field that was there, every time tag the right one, every vector with the uncertainty that holds,
//! and nothing that is wrong with an input passes in silence.

use crate::common;

use calfit::files::table::series::SeriesTable;
use common::check::{calfit, data, says, text};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use tempfile::TempDir;

/// A copy of a set of telemetry, which a test may change.
struct Set {
    folder: TempDir,
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

impl Set {
    fn of(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&data("tests/data/flight").join(name), &folder.path().join("set"));
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join("set").join(name)
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    /// The configuration with some text in place of other text.
    fn change(&self, from: &str, to: &str) -> &Self {
        let path = self.path("flight.toml");
        let before = fs::read_to_string(&path).unwrap();
        assert!(before.contains(from), "the configuration holds no `{from}`");
        fs::write(path, before.replacen(from, to, 1)).unwrap();
        self
    }

    fn flight(&self, levels: &str, arguments: &[&str]) -> Output {
        calfit()
            .args(["flight", levels])
            .arg(self.path("flight.toml"))
            .args(arguments)
            .arg("-o")
            .arg(self.out())
            .output()
            .unwrap()
    }

    fn made(&self, levels: &str, arguments: &[&str]) {
        let output = self.flight(levels, arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }

    fn level(&self, level: &str, sensor: &str, day: &str) -> SeriesTable {
        let name = format!("calfit-{level}-{sensor}-{}.parquet", day.replace('-', ""));
        SeriesTable::open(&self.out().join(format!("level={level}/sensor={sensor}/date={day}")).join(name)).unwrap()
    }

    fn truth(&self, sensor: &str, day: &str) -> SeriesTable {
        SeriesTable::open(&self.path(&format!("truth/sensor={sensor}/date={day}/truth.parquet"))).unwrap()
    }
}

fn three(table: &SeriesTable, names: [&str; 3]) -> [Vec<f64>; 3] {
    names.map(|name| table.numbers(name).unwrap())
}

/// Differences between a level and its truth, component by component, of all vectors that both have.
fn errors(level: &SeriesTable, truth: &SeriesTable, names: [&str; 3]) -> [Vec<f64>; 3] {
    let key = |table: &SeriesTable| -> Vec<(i64, String)> {
        let words = table.words("sid").unwrap();
        let time = table.whole("time_tt2000").unwrap();
        time.into_iter().zip(&words.codes).map(|(t, c)| (t, words.words[*c as usize].clone())).collect()
    };
    let place: HashMap<(i64, String), usize> = key(level).into_iter().enumerate().map(|(i, k)| (k, i)).collect();
    let (found, wanted) = (three(level, ["bx", "by", "bz"]), three(truth, names));
    let mut out: [Vec<f64>; 3] = Default::default();
    for (row, own) in key(truth).into_iter().enumerate() {
        if let Some(at) = place.get(&own).filter(|at| found[0][**at].is_finite()) {
            (0..3).for_each(|i| out[i].push(found[i][*at] - wanted[i][row]));
        }
    }
    out
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

const UVW: [&str; 3] = ["a_uvw_x", "a_uvw_y", "a_uvw_z"];

#[test]
fn exact_counts_come_back_as_the_field() {
    let set = Set::of("exact");
    set.made("A", &[]);
    // OB by a ground calibration file in the Rosetta convention, IB by polynomials in that of BepiColombo.
    for (sensor, vectors) in [("OB", 115), ("IB", 60)] {
        let found = errors(&set.level("A", sensor, "2015-06-29"), &set.truth(sensor, "2015-06-29"), UVW);
        assert!(found[0].len() >= vectors, "{sensor}: {} vectors", found[0].len());
        let worst = found.iter().flatten().fold(0.0_f64, |worst, e| worst.max(e.abs()));
        assert!(worst <= 1e-8, "{sensor}: {worst:e} nT");
    }
}

#[test]
fn counts_come_back_within_noise_and_steps() {
    let set = Set::of("telemetry");
    set.made("AB", &[]);
    let mut all: [[Vec<f64>; 3]; 2] = Default::default();
    for sensor in ["OB", "IB"] {
        let (level, truth) = (set.level("A", sensor, "2015-07-01"), set.truth(sensor, "2015-07-01"));
        let found = errors(&level, &truth, UVW);
        assert_eq!(found[0].len(), 72, "{sensor}");
        (0..3).for_each(|i| all[0][i].extend(&found[i]));
        let stated = three(&level, ["ua_x", "ua_y", "ua_z"]);
        for i in 0..3 {
            // The stated uncertainty is that of noise of 0.03 enT, steps of 0.0286 enT, and steps of the thermistor; 72 vectors scatter
            // by 8 % about it.
            let ratio = rms(&found[i]) / rms(&stated[i]);
            assert!((0.7..1.35).contains(&ratio), "{sensor} {i}: {ratio}");
        }
        let level = set.level("B", sensor, "2015-07-01");
        let found = errors(&level, &truth, ["b_sc_x", "b_sc_y", "b_sc_z"]);
        (0..3).for_each(|i| all[1][i].extend(&found[i]));
    }
    // An independent processing reaches 0.0339 to 0.039 nT in these axes.
    for component in all.iter().flatten() {
        assert!(rms(component) < 0.045, "{}", rms(component));
    }
}

#[test]
fn times_are_exact_over_the_leap_second() {
    let set = Set::of("telemetry");
    set.made("A", &[]);
    for (sensor, day, first) in [("OB", "2015-06-30", false), ("OB", "2015-07-01", true), ("IB", "2015-07-01", true)] {
        let level = set.level("A", sensor, day);
        let times = level.whole("time_tt2000").unwrap();
        let truth = set.truth(sensor, day).whole("time_tt2000").unwrap();
        let good = errors(&level, &set.truth(sensor, day), UVW)[0].len();
        assert_eq!(truth.iter().filter(|t| times.contains(t)).count(), good);
        assert!(good + 2 >= truth.len(), "{sensor} {day}: {good} of {}", truth.len());
        // 2015-07-01T00:00:00 UTC.
        let midnight = 488_980_868_184_000_000;
        assert!(times.is_sorted());
        assert!(times.iter().all(|t| (*t >= midnight) == first));
    }
    // Twenty vectors per second, and the leap second is one more second of the day before.
    let level = set.level("A", "OB", "2015-06-30");
    let flags = level.whole("flags").unwrap();
    let times = level.whole("time_tt2000").unwrap();
    let leap: Vec<i64> = times.into_iter().zip(flags).filter(|(_, f)| f & 16 != 0).map(|(t, _)| t).collect();
    assert_eq!(leap.len(), 20);
    assert!(leap.iter().all(|t| (488_980_867_184_000_000..488_980_868_184_000_000).contains(t)));
}

#[test]
fn housekeeping_becomes_volts_and_degrees() {
    let set = Set::of("telemetry");
    set.made("A", &["--hk", "--sensor", "IB"]);
    let table = SeriesTable::open(&set.out().join("level=HK/date=2015-06-30/calfit-HK-20150630.parquet")).unwrap();
    let truth = SeriesTable::open(&set.path("truth/hk.parquet")).unwrap();
    let place: HashMap<i64, usize> = truth.whole("time_tt2000").unwrap().into_iter().enumerate().map(|(i, t)| (t, i)).collect();
    let time = table.whole("time_tt2000").unwrap();
    // Half a step of each converter, and the noise of what it converts: 16 bits over 32768 enT and over a thermistor of 0.028 K per step,
    // 8 bits of 2.56 and 2.84 mV.
    for (name, of, most) in [
        ("t_ob_calibrated", "t_ob_degc", 0.05),
        ("t_ib_calibrated", "t_ib_degc", 0.05),
        ("pos_voltage", "pos", 0.003),
        ("neg_voltage", "neg", 0.003),
        ("ref_voltage", "u_ref", 1e-4),
        ("bx_ob", "bx", 1.0),
    ] {
        let (found, wanted) = (table.numbers(name).unwrap(), truth.numbers(of).unwrap());
        let worst = time.iter().zip(found).filter_map(|(t, v)| place.get(t).map(|at| (v - wanted[*at]).abs()));
        let worst = worst.fold(0.0_f64, f64::max);
        assert!(worst < most, "{name}: {worst}");
    }
}

/// A change of the configuration, and words of the message that refuses it.
type Refusal = (&'static str, &'static str, &'static [&'static str]);

#[test]
fn a_wrong_configuration_is_refused_with_its_place() {
    let cases: [Refusal; 14] = [
        ("mission = ", "missoin = ", &["`missoin` is not known", "`mission`"]),
        ("version = 1", "version = 2", &["`version` must be 1"]),
        ("6.0713338274930984e-01", "6.1e-01", &["uvw_to_sc", "is no rotation"]),
        (
            "[[6.0713338274930984e-01, -3.6071012972122901e-01, 7.0800936283913241e-01]",
            "[[-6.0713338274930984e-01, 3.6071012972122901e-01, -7.0800936283913241e-01]",
            &["mirrors"],
        ),
        (
            "to = \"2015-06-29T05:00:00.000000Z\"",
            "to = \"2015-06-29T06:00:00.000000Z\"",
            &["`sensor.jump` has intervals that overlap"],
        ),
        ("frame = \"sc\"", "frame = \"celestial\"", &["`sensor.jump.frame` must be"]),
        ("to = \"2015-06-29T03:00:00.000000Z\"", "to = \"2015-06-28T03:00:00.000000Z\"", &["must be after `from`"]),
        ("from = \"2015-06-29T00:00:00.000000Z\"", "from = \"29.6.2015\"", &["is no time"]),
        ("RPCMAG_001_CALIB_FSDPU_FMOB.TXT", "THERMISTOR__FM-IB.toml", &["ground"]),
        ("name = \"OB\"", "name = \"XX\"", &["XX"]),
        ("attitude_order = \"scalar-first\"", "", &["`celestial.attitude_order` is missing"]),
        ("primary = \"OB\"", "primary = \"IB\"", &["primary sensor"]),
        ("packet_s = 32", "packet_s = -32", &["`mode.packet_s` must be positive"]),
        ("adc_bits = 20", "adc_bits = 2000", &["`sensor.adc_bits`"]),
    ];
    for (from, to, words) in cases {
        let set = Set::of("telemetry");
        let output = set.change(from, to).flight("A", &[]);
        assert_eq!(output.status.code(), Some(2), "{from} -> {to}: {}", text(&output.stderr));
        says(&text(&output.stderr), words);
        assert!(!set.out().join("level=A").exists(), "{from} -> {to}");
    }
}

#[test]
fn a_day_that_cannot_be_made_does_not_stop_the_others() {
    let set = Set::of("telemetry");
    fs::remove_file(set.path("daily/RPCMAG_150630_006_CALIB_OB.toml")).unwrap();
    let output = set.flight("A", &[]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["RPCMAG_150630_006_CALIB_OB.toml", "OB 2015-06-30 was not made"]);
    assert!(!set.out().join("level=A/sensor=OB/date=2015-06-30").exists());
    assert!(set.out().join("level=A/sensor=OB/date=2015-07-01").exists());
    // A mode that is not stated is an error of its file, never a shift of zero.
    let set = Set::of("telemetry");
    let output = set.change("sid = \"SID6\"", "sid = \"SID5\"").flight("A", &[]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["row 1: its mode SID6 is not stated", "part-0.parquet"]);
    // Cut in the middle.
    let set = Set::of("telemetry");
    let path = set.path("edited/sensor=OB/date=2015-07-01/part-0.parquet");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let output = set.flight("A", &["--sensor", "OB"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["part-0.parquet: cannot be read as a table"]);
}

#[test]
fn equal_bytes_in_one_process_in_many_and_with_any_number_of_threads() {
    let one = Set::of("telemetry");
    one.change("enabled = false", "enabled = true").made("ABCEFG", &["--threads", "1", "--no-plots"]);
    let many = Set::of("telemetry");
    many.change("enabled = false", "enabled = true");
    let carry = many.path("carry.parquet");
    let first = calfit().args(["flight", "carry"]).arg(many.path("flight.toml")).arg("-o").arg(&carry).output().unwrap();
    assert!(first.status.success(), "{}", text(&first.stderr));
    let carry = carry.display().to_string();
    for day in ["2015-07-01", "2015-06-30"] {
        for sensor in ["IB", "OB"] {
            let part = ["--carry", &carry, "--from", day, "--to", day, "--sensor", sensor, "--threads", "8", "--no-plots"];
            many.made("ABCEFG", &part);
        }
    }
    let report = calfit().args(["flight", "report"]).arg(many.path("flight.toml")).arg("-o").arg(many.out()).output().unwrap();
    assert!(report.status.success(), "{}", text(&report.stderr));
    let (one, many) = (common::check::tree(&one.out()), common::check::tree(&many.out()));
    assert!(one.len() >= 24);
    assert_eq!(one.keys().collect::<Vec<_>>(), many.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(many[name] == *bytes, "{name}");
    }
}

#[test]
fn continuity_that_is_not_known_is_no_zero() {
    // The day before cannot be read: the sum at midnight is not known.
    let set = Set::of("telemetry");
    let model = set.path("daily/RPCMAG_150630_006_CALIB_IB.toml");
    fs::write(&model, "format = \"RPCMAG-DAILY\"\n").unwrap();
    let arguments = ["--sensor", "IB", "--from", "2015-07-01", "--to", "2015-07-01", "--no-plots"];
    let output = set.change("enabled = false", "enabled = true").flight("A", &arguments);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["IB 2015-07-01", "is not known", "RPCMAG_150630_006_CALIB_IB.toml"]);
    // A campaign that begins with the day does not need it.
    let set = Set::of("telemetry");
    fs::write(set.path("daily/RPCMAG_150630_006_CALIB_IB.toml"), "format = \"RPCMAG-DAILY\"\n").unwrap();
    let campaign = "[[campaign]]\nfrom = \"2015-07-01T00:00:00Z\"\nto = \"2016-01-01T00:00:00Z\"\n\n[temperature]";
    set.change("enabled = false", "enabled = true").change("[temperature]", campaign).made("A", &arguments);
    // The table of the first pass of another configuration.
    let set = Set::of("telemetry");
    let carry = set.path("carry.parquet");
    let made = calfit().args(["flight", "carry"]).arg(set.path("flight.toml")).arg("-o").arg(&carry).output().unwrap();
    assert!(made.status.success(), "{}", text(&made.stderr));
    let output = set.change("reset_gap_s = 10800", "reset_gap_s = 10801").flight("A", &["--carry", &carry.display().to_string()]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["made of another configuration"]);
}

#[test]
fn words_by_their_index_are_words() {
    // Other programs write the mode as a column of indices; the reader takes the same words.
    let set = Set::of("telemetry");
    set.made("A", &["--sensor", "OB", "--no-plots"]);
    let level = set.level("A", "OB", "2015-07-01");
    let words = level.words("sid").unwrap();
    assert_eq!(words.words, ["SID6"]);
    assert_eq!(words.codes.len(), level.rows());
}
