//! `calfit flight`: telemetry becomes the field that was there, every time tag the right one, every vector with the uncertainty that holds,
//! and nothing that is wrong with an input passes in silence.

use crate::common;

use calfit::data::provenance::Provenance;
use calfit::data::recipe::Recipe;
use calfit::files::parameter::{self, Model, ModelEffect, ModelParameter};
use calfit::files::table::long::{Column, LongWriter};
use calfit::files::table::series::SeriesTable;
use common::check::{calfit, copy, data, says, text};
use std::collections::HashMap;
use std::fs;
use std::path::PathBuf;
use std::process::Output;
use tempfile::TempDir;

/// A copy of a set of telemetry, which a test may change.
pub struct Set {
    folder: TempDir,
}

impl Set {
    pub fn of(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&data("tests/data/flight").join(name), &folder.path().join("set"));
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join("set").join(name)
    }

    pub fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    /// The configuration with some text in place of other text.
    pub fn change(&self, from: &str, to: &str) -> &Self {
        let path = self.path("flight.toml");
        let before = fs::read_to_string(&path).unwrap();
        assert!(before.contains(from), "the configuration holds no `{from}`");
        fs::write(path, before.replacen(from, to, 1)).unwrap();
        self
    }

    pub fn flight(&self, levels: &str, arguments: &[&str]) -> Output {
        calfit()
            .args(["flight", levels])
            .arg(self.path("flight.toml"))
            .args(arguments)
            .arg("-o")
            .arg(self.out())
            .output()
            .unwrap()
    }

    pub fn made(&self, levels: &str, arguments: &[&str]) {
        let output = self.flight(levels, arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }

    pub fn level(&self, level: &str, sensor: &str, day: &str) -> SeriesTable {
        let name = format!("calfit-{level}-{sensor}-{}.parquet", day.replace('-', ""));
        SeriesTable::open(&self.out().join(format!("level={level}/sensor={sensor}/date={day}")).join(name)).unwrap()
    }

    fn truth(&self, sensor: &str, day: &str) -> SeriesTable {
        SeriesTable::open(&self.path(&format!("truth/sensor={sensor}/date={day}/truth.parquet"))).unwrap()
    }
}

pub fn three(table: &SeriesTable, names: [&str; 3]) -> [Vec<f64>; 3] {
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
        // Two minutes of vectors, of which every 50th has its truth.
        assert!(found[0].len() >= 47, "{sensor}: {}", found[0].len());
        (0..3).for_each(|i| all[0][i].extend(&found[i]));
        let stated = three(&level, ["ua_x", "ua_y", "ua_z"]);
        for i in 0..3 {
            // The stated uncertainty is that of noise of 0.03 enT, steps of 0.0286 enT, and steps of the thermistor; 48 vectors scatter
            // by 10 % about it.
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
        let mut truth = set.truth(sensor, day).whole("time_tt2000").unwrap();
        // The truth goes on for a minute more than the telemetry.
        truth.retain(|t| times.last().is_some_and(|last| t <= last));
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

#[test]
fn housekeeping_beyond_its_bits_is_refused_with_its_row() {
    let set = Set::of("telemetry");
    let day = set.path("hk/date=2015-06-30");
    fs::remove_dir_all(&day).unwrap();
    fs::create_dir_all(&day).unwrap();
    for (row, words) in [
        ("2015-06-30T12:00:00Z,13837,300", "row 2: the count 300 of `pos_voltage` is none of 8 bits"),
        ("2015-06-28T12:00:00Z,13837,5", "row 2: the time 2015-06-28T12:00:00.000000000 is not of the day"),
    ] {
        fs::write(day.join("a.csv"), format!("time_utc,t_ob,pos_voltage\n2015-06-30T11:00:00Z,13837,5\n{row}\n")).unwrap();
        let output = set.flight("A", &["--hk", "--sensor", "IB", "--no-plots"]);
        assert_eq!(output.status.code(), Some(1));
        says(&text(&output.stderr), &[words]);
        assert!(!set.out().join("level=HK").exists());
    }
}

/// A change of the configuration, and words of the message that refuses it.
type Refusal = (&'static str, &'static str, &'static [&'static str]);

#[test]
fn a_wrong_configuration_is_refused_with_its_place() {
    let cases: [Refusal; 18] = [
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
        ("name = \"OB\"", "name = \"XX\"", &["`role.primary`", "is no sensor of this file"]),
        ("attitude_order = \"scalar-first\"", "", &["`celestial.attitude_order` is missing"]),
        ("primary = \"OB\"", "primary = \"IB\"", &["primary sensor"]),
        ("packet_s = 32", "packet_s = -32", &["`mode.packet_s` must be positive"]),
        ("adc_bits = 20", "adc_bits = 2000", &["`sensor.adc_bits`"]),
        (
            "outside = \"null\"",
            "outside = \"null\"\nextended_degc = [-140.0, 70.0]\nreason = \"R 4.2.3.3\"",
            &["`temperature.extended_degc` extends nothing", "outside = \"flag\""],
        ),
        (
            "[temperature]",
            "[pca]\ncoupling = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [0.0, 0.0, 1.5]]\n\n[temperature]",
            &["`pca.coupling` changes nothing of principal components"],
        ),
        ("thermistor_column = \"t_ib\"", "residual = \"ignore\"", &["THERMAL_PARAMETER", "state no residual field B_RES"]),
        (
            "daily = \"daily/RPCMAG_{yymmdd}_006_CALIB_OB.toml\"",
            "daily_to = \"2015-07-02T00:00:00Z\"",
            &["`sensor.daily_to` changes nothing without `daily`"],
        ),
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
    says(&text(&output.stderr), &["part-0.parquet: cannot be read as a table", "OB 2015-07-01 was not made"]);
    assert!(!set.out().join("level=A/sensor=OB/date=2015-07-01").exists());
    assert!(set.out().join("level=A/sensor=OB/date=2015-06-30").exists());
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
    // The model of the day before does not hold at the temperature of the midnight.
    let set = Set::of("telemetry");
    let model = set.path("daily/RPCMAG_150630_006_CALIB_IB.toml");
    let lines = fs::read_to_string(&model).unwrap();
    let lines = lines.lines().map(|line| if line.starts_with("valid_degc") { "valid_degc = [10.0, 14.0]" } else { line });
    let lines: Vec<&str> = lines.collect();
    fs::write(&model, lines.join("\n") + "\n").unwrap();
    let output = set.change("enabled = false", "enabled = true").flight("A", &arguments);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["IB 2015-07-01", "is not known", "2015-06-30", "holds from 10 to 14 °C"]);
    // A gap over midnight that is too long: the day is made, and it is said that the constants begin anew.
    let set = Set::of("telemetry");
    let output =
        set.change("enabled = false", "enabled = true").change("reset_gap_s = 10800", "reset_gap_s = 0").flight("A", &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    says(&text(&output.stdout), &["begin anew at zero", "nT on 2015-06-30: the field may step"]);
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

/// A mission of one sensor whose telemetry is a few lines of text.
pub struct Small {
    pub folder: TempDir,
}

impl Small {
    pub fn new(configuration: &str, rows: &str) -> Self {
        let small = Self { folder: tempfile::tempdir().unwrap() };
        let day = small.folder.path().join("edited/sensor=OB/date=2015-06-29");
        fs::create_dir_all(&day).unwrap();
        fs::write(day.join("a.csv"), rows).unwrap();
        let head = "version = 1\nmission = \"test\"\ninstrument = \"MAG\"\ninput = \"edited\"\nhk = \"hk\"\n";
        fs::write(small.folder.path().join("flight.toml"), format!("{head}{configuration}")).unwrap();
        small
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("out")
    }

    fn run(&self) -> Output {
        let flight = self.folder.path().join("flight.toml");
        calfit().args(["flight", "A", "--no-plots"]).arg(flight).arg("-o").arg(self.out()).output().unwrap()
    }

    pub fn level_a(&self) -> SeriesTable {
        let output = self.run();
        assert!(output.status.success(), "{}", text(&output.stderr));
        let out = self.out();
        SeriesTable::open(&out.join("level=A/sensor=OB/date=2015-06-29/calfit-A-OB-20150629.parquet")).unwrap()
    }
}

#[test]
fn ranges_with_matrices_and_offsets_added_behind_them() {
    let configuration = r#"
[[sensor]]
name = "OB"
ent_per_count = [0.5, 4.0]
noise_ent = 0.1
[[sensor.matrix]]
from = "2015-01-01"
to = "2016-01-01"
range = 0
matrix = [[1.0, 0.02, 0.0], [0.0, 0.9, 0.0], [0.01, 0.0, 1.1]]
offset = [3.0, -2.0, 1.0]
offset_sign = "added"
[[sensor.matrix]]
from = "2015-01-01"
to = "2015-06-29T12:00:00"
range = 1
matrix = [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]
offset = [10.0, 0.0, 0.0]
offset_sign = "subtracted"
[[mode]]
sid = "N"
packet_s = 1
primary = { rate_hz = 1.0, shift_s = 0.0 }
"#;
    let rows = "time_utc,bx,by,bz,quality,sid,range\n2015-06-29T11:00:00Z,100,200,-40,0,N,0\n2015-06-29T11:00:01Z,10,20,-30,0,N,1\n\
                2015-06-29T12:00:00Z,10,20,-30,0,N,1\n";
    let level = Small::new(configuration, rows).level_a();
    let [x, y, z] = three(&level, ["bx", "by", "bz"]);
    // Readings of 50, 100, -20 enT; the offset is added behind the matrix.
    for (found, wanted) in [(x[0], 50.0 + 2.0 + 3.0), (y[0], 90.0 - 2.0), (z[0], 0.5 - 22.0 + 1.0)] {
        assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
    }
    // 40, 80, -120 enT; the offset is taken off before it.
    assert_eq!([x[1], y[1], z[1]], [60.0, 160.0, -240.0]);
    // Behind the end of the validity there is no vector, and its flag says why.
    assert!(x[2].is_nan());
    // It follows a gap as well.
    assert_eq!(level.whole("flags").unwrap(), [0, 0, 1 << 10 | 1 << 5]);
    // Noise of 0.1 enT and steps of 0.5 enT through the matrix of the first range.
    let noise2 = 0.1 * 0.1 + 0.5 * 0.5 / 12.0;
    let wanted = (noise2 * (1.0 + 0.02 * 0.02_f64)).sqrt();
    assert!((level.numbers("ua_x").unwrap()[0] - wanted).abs() < 1e-6);
    // Steps of 4 enT in the second range, through a matrix of 2 nT/enT.
    let wanted = 2.0 * (0.1 * 0.1 + 4.0 * 4.0 / 12.0_f64).sqrt();
    assert!((level.numbers("ua_x").unwrap()[1] - wanted).abs() < 1e-6);
    // The file says of each matrix how its offset acts.
    let added = "range 0 from 2015-01-01T00:00:00.000000000 to 2016-01-01T00:00:00.000000000: \
                 offset_unit=nT offset_acts=behind_matrix offset_sign=added";
    let subtracted = "range 1 from 2015-01-01T00:00:00.000000000 to 2015-06-29T12:00:00.000000000: \
                      offset_unit=enT offset_acts=before_matrix offset_sign=subtracted";
    assert_eq!(level.says("convention"), Some(format!("{added}; {subtracted}").as_str()));
}

/// An offset that is added: errors of matrix and offset go together as the stated covariance says.
#[test]
fn the_covariance_of_an_added_offset_is_taken_whole() {
    let mut rows = vec![vec![0.0; 12]; 12];
    // Of the first element of the matrix (1e-4) and the offset along x (0.05 nT), with a correlation of 0.5.
    (rows[0][0], rows[9][9], rows[0][9], rows[9][0]) = (1e-8, 2.5e-3, 2.5e-6, 2.5e-6);
    // The offset along z is uncertain by itself, 0.2 nT, and with the element that takes y to y.
    (rows[4][4], rows[11][11], rows[4][11], rows[11][4]) = (4e-8, 0.04, 1e-5, 1e-5);
    let configuration = format!(
        "[[sensor]]\nname = \"OB\"\nent_per_count = 1.0\nnoise_ent = 0.1\n[[sensor.matrix]]\nfrom = \"2015-01-01\"\nto = \"2016-01-01\"\n\
         matrix = [[2.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.3, 0.0, 4.0]]\noffset = [3.0, -2.0, 1.0]\noffset_sign = \"added\"\n\
         covariance = {rows:?}\n[[mode]]\nsid = \"N\"\npacket_s = 1\nprimary = {{ rate_hz = 1.0, shift_s = 0.0 }}\n"
    );
    let small = Small::new(&configuration, "time_utc,bx,by,bz,quality,sid\n2015-06-29T11:00:00Z,100,-50,10,0,N\n");
    let level = small.level_a();
    let [x, y, z] = three(&level, ["bx", "by", "bz"]);
    assert_eq!(level.says("convention"), Some("offset_unit=nT offset_acts=behind_matrix offset_sign=added"));
    for (found, wanted) in [x[0], y[0], z[0]].into_iter().zip([178.0, -52.0, 71.0]) {
        assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
    }
    let [x, y, z] = three(&level, ["uc_x", "uc_y", "uc_z"]);
    // 100² 1e-8 + 0.05² + 2 · 100 · 2.5e-6 along x; 50² 4e-8 along y; 0.2² along z.
    for (found, square) in [x[0], y[0], z[0]].into_iter().zip([3.1e-3_f64, 1e-4, 0.04]) {
        assert!((found / square.sqrt() - 1.0).abs() < 1e-6, "{found} {square}");
    }
}

#[test]
fn a_field_that_follows_a_current_is_taken_off() {
    let configuration = r#"
[[sensor]]
name = "OB"
ent_per_count = 1.0
[[sensor.matrix]]
from = "2015-01-01"
to = "2016-01-01"
matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
[[disturbance]]
column = "solar_a"
vector_nt_per_unit = [2.0, -1.0, 0.5]
[[mode]]
sid = "N"
packet_s = 1
primary = { rate_hz = 1.0, shift_s = 0.0 }
[pipeline]
steps = ["counts", "ground", "disturbance", "shift"]
"#;
    let rows = "time_utc,bx,by,bz,quality,sid\n2015-06-29T11:00:05Z,100,200,300,0,N\n2015-06-29T11:00:30Z,100,200,300,0,N\n";
    let small = Small::new(configuration, rows);
    let day = small.folder.path().join("hk/date=2015-06-29");
    fs::create_dir_all(&day).unwrap();
    fs::write(day.join("a.csv"), "time_utc,solar_a\n2015-06-29T11:00:00Z,1.0\n2015-06-29T11:00:20Z,5.0\n").unwrap();
    let level = small.level_a();
    let [x, y, z] = three(&level, ["bx", "by", "bz"]);
    // A quarter of the way from 1 A to 5 A; behind the last reading nothing is known.
    assert_eq!([x[0], y[0], z[0]], [96.0, 202.0, 299.0]);
    assert!(x[1].is_nan());
}

/// `Q(ξ) K⁻¹` of the Rosetta report, section 3.3.1.3, and the rest of its way from a reading to the field.
fn rosetta(reading: [f64; 3], t: f64, p: &dyn Fn(&str, usize) -> f64) -> [f64; 3] {
    let line = |zero: &str, one: &str, i: usize| p(zero, i) + p(one, i) * t;
    let s: [f64; 3] =
        std::array::from_fn(|i| line("SIGMA_00", "SIGMA_01", i) * (reading[i] - (line("A_0", "A_1", i) - p("B_RES", i))));
    let k: [f64; 3] = std::array::from_fn(|row| (0..3).map(|c| p(["K_0", "K_1", "K_2"][row], c) * s[c]).sum());
    let [xy, xz, yz] = [0, 1, 2].map(|i| line("XI_10", "XI_11", i).to_radians());
    let q = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
    let height = (1.0 - xz.cos() * xz.cos() - q * q).sqrt();
    [k[0] + xy.cos() * k[1] + xz.cos() * k[2], xy.sin() * k[1] + q * k[2], height * k[2]]
}

#[test]
fn the_common_uncertainty_holds_at_small_and_large_fields() {
    let ground = fs::read_to_string(data("tests/data/flight/exact/ground/RPCMAG_001_CALIB_FSDPU_FMOB.TXT")).unwrap();
    let file: toml_edit::DocumentMut = ground.parse().unwrap();
    let three_of = |item: &toml_edit::Item, i: usize| item[i].as_float().unwrap();
    let configuration = "[[sensor]]\nname = \"OB\"\nground = [\"OB.TXT\"]\n[[mode]]\nsid = \"N\"\npacket_s = 1\n\
                         primary = { rate_hz = 1.0, shift_s = 0.0 }\n";
    let fields = [[9300.0, -2800.0, 14_000.0], [26_000.0, -20_000.0, 30_000.0], [350_000.0, -300_000.0, 330_000.0]];
    let mut rows = "time_utc,bx,by,bz,t_ob,quality,sid\n".to_owned();
    for (i, [x, y, z]) in fields.iter().enumerate() {
        rows += &format!("2015-06-29T11:00:0{i}Z,{x},{y},{z},13837,0,N\n");
    }
    let small = Small::new(configuration, &rows);
    fs::write(small.folder.path().join("OB.TXT"), &ground).unwrap();
    let level = small.level_a();
    let (found, stated) = (three(&level, ["bx", "by", "bz"]), three(&level, ["uc_x", "uc_y", "uc_z"]));
    let t = level.numbers("t_degc").unwrap()[0];
    // RO-IGEP-TR0028 section 4.2.3.1.
    let reading = |counts: [f64; 3]| counts.map(|n| (n + 524_288.0) * 30_000.0 / 1_048_575.0 - 15_000.0);
    let nominal = |key: &str, i: usize| three_of(&file[key], i);
    let mut noise = common::Gauss(7);
    const DRAWS: usize = 4000;
    let mut inside = [[0_usize; 3]; 3];
    let mut squares = [[0.0_f64; 3]; 3];
    for _ in 0..DRAWS {
        let mut drawn: HashMap<(String, usize), f64> = HashMap::new();
        for key in ["A_0", "A_1", "B_RES", "SIGMA_00", "SIGMA_01", "XI_10", "XI_11"] {
            for i in 0..3 {
                drawn.insert((key.to_owned(), i), nominal(key, i) + three_of(&file["std"][key], i) * noise.normal());
            }
        }
        let of = |key: &str, i: usize| drawn.get(&(key.to_owned(), i)).copied().unwrap_or_else(|| nominal(key, i));
        for (row, counts) in fields.iter().enumerate() {
            let own = rosetta(reading(*counts), t, &of);
            for i in 0..3 {
                let pull = (own[i] - found[i][row]) / stated[i][row];
                inside[row][i] += usize::from(pull.abs() < 1.959_964);
                squares[row][i] += pull * pull;
            }
        }
    }
    for row in 0..3 {
        for i in 0..3 {
            let (share, pull) = (inside[row][i] as f64 / DRAWS as f64, (squares[row][i] / DRAWS as f64).sqrt());
            assert!((0.94..=0.96).contains(&share) && (0.95..=1.05).contains(&pull), "{row} {i}: {share} {pull}");
        }
    }
}

/// A ground calibration that was made with a model: the reading `L + c2 L²` comes back as the field of `L`, the uncertainty of c2 stands in the
/// common part, and without the model, or with an effect of a history that telemetry does not tell, nothing is written.
#[test]
fn known_effects_of_the_ground_calibration_are_taken_off_in_flight() {
    const C2: f64 = 2e-7;
    const C2_STD: f64 = 1e-8;
    let ground = fs::read_to_string(data("tests/data/flight/exact/ground/RPCMAG_001_CALIB_FSDPU_FMOB.TXT")).unwrap();
    let file: toml_edit::DocumentMut = ground.parse().unwrap();
    let of = |key: &str, i: usize| file[key][i].as_float().unwrap();
    let configuration = |model: &str| {
        format!(
            "[[sensor]]\nname = \"OB\"\nground = [\"OB.TXT\"]\n{model}[[mode]]\nsid = \"N\"\npacket_s = 1\n\
             primary = {{ rate_hz = 1.0, shift_s = 0.0 }}\n"
        )
    };
    let counts = [350_000.0, -300_000.0, 330_000.0];
    let rows = "time_utc,bx,by,bz,t_ob,quality,sid\n2015-06-29T11:00:00Z,350000,-300000,330000,13837,0,N\n";
    let made = |model: &str, effect: ModelEffect, is_known: bool| {
        let small = Small::new(&configuration(model), rows);
        let known = if is_known { "known_effects = [\"model.toml\"]\n[std]" } else { "[std]" };
        fs::write(small.folder.path().join("OB.TXT"), ground.replace("[std]", known)).unwrap();
        let model = Model {
            used: vec!["26-01-01_00-00-00".to_owned()],
            convention: "as printed".to_owned(),
            sensor: None,
            mode: None,
            effect: vec![effect],
        };
        let text = parameter::to_text(&model, &Provenance::new(Recipe::plain("diagnose"), Vec::new())).unwrap();
        fs::write(small.folder.path().join("model.toml"), text).unwrap();
        small
    };
    let effect = |id: &str, form: &str, name: &str, value: f64| ModelEffect {
        id: id.to_owned(),
        form: form.to_owned(),
        axes: vec!["x".to_owned()],
        run: None,
        reading_ent: None,
        parameter: vec![ModelParameter { name: name.to_owned(), value, std: Some(C2_STD), unit: "enT/enT^2".to_owned() }],
        shape: Vec::new(),
    };
    let even = || effect("quadratic_nonlinearity", "quadratic", "c2_x", C2);
    let named = "model = \"model.toml\"\n";
    let plain = made("", even(), false).level_a();
    let with = made(named, even(), true).level_a();

    let t = with.numbers("t_degc").unwrap()[0];
    let reading = counts.map(|n| (n + 524_288.0) * 30_000.0 / 1_048_575.0 - 15_000.0);
    let offset = of("A_0", 0) + of("A_1", 0) * t - of("B_RES", 0);
    // The root of L + c2 L² = reading - offset that goes to it with c2 to zero.
    let linear = (-1.0 + (1.0 + 4.0 * C2 * (reading[0] - offset)).sqrt()) / (2.0 * C2);
    let wanted = rosetta([offset + linear, reading[1], reading[2]], t, &of);
    let field = |level: &SeriesTable, names: [&str; 3]| three(level, names).map(|column| column[0]);
    let found = field(&with, ["bx", "by", "bz"]);
    assert!(C2 * linear * linear > 15.0);
    for i in 0..3 {
        assert!((found[i] - wanted[i]).abs() < 1e-6, "{found:?} is not {wanted:?}");
    }
    // The last two readings are as they were, so that what c2 does is along the first column of the matrix.
    let nothing = rosetta([offset, reading[1], reading[2]], t, &of);
    let (before, after) = (field(&plain, ["uc_x", "uc_y", "uc_z"]), field(&with, ["uc_x", "uc_y", "uc_z"]));
    for i in 0..3 {
        let by_c2 = (wanted[i] - nothing[i]) / linear * C2_STD * linear * linear;
        // The rest of the uncertainty belongs to a field that differs by 20 nT of 10 000.
        assert!((after[i] / before[i].hypot(by_c2) - 1.0).abs() < 5e-3, "{i}: {after:?} {before:?} {by_c2}");
    }
    assert!(after[0] > 1.05 * before[0]);

    let refused = |small: &Small| {
        let output = small.run();
        assert!(!output.status.success() && !small.out().join("level=A").exists());
        text(&output.stderr)
    };
    says(&refused(&made("", even(), true)), &["OB.TXT", "model.toml were taken off", "`model` of a sensor in flight"]);
    says(&refused(&made(named, even(), false)), &["OB.TXT", "was made without known effects"]);
    let remanence = effect("remanence", "own axis", "c_x", 1e-6);
    let said = refused(&made(named, remanence, true));
    says(&said, &["model.toml", "remanence"]);
}

#[test]
fn text_tables_have_labels_that_describe_every_byte() {
    let set = Set::of("telemetry");
    set.change("[temperature]", "[output]\ntext = true\n\n[temperature]").made("A", &["--sensor", "OB", "--no-plots"]);
    // Written again, the program knows its own tables.
    set.made("A", &["--sensor", "OB", "--no-plots"]);
    let folder = set.out().join("level=A/sensor=OB/date=2015-06-30");
    let table = fs::read_to_string(folder.join("RPCMAG_150630_CLA_OB.TAB")).unwrap();
    let label = fs::read_to_string(folder.join("RPCMAG_150630_CLA_OB.LBL")).unwrap();
    let value = |key: &str| -> usize {
        let line = label.lines().find(|l| l.trim().starts_with(&format!("{key} = "))).unwrap();
        line.split(" = ").nth(1).unwrap().trim().parse().unwrap()
    };
    let lines: Vec<&str> = table.split_inclusive("\r\n").collect();
    assert_eq!(lines.len(), value("FILE_RECORDS"));
    assert!(lines.iter().all(|line| line.len() == value("RECORD_BYTES")));
    // The bytes of BX as the label has them are the field of the level.
    let bx = &label[label.find("NAME = BX").unwrap()..];
    let of = |key: &str| -> usize {
        bx.lines().find(|l| l.contains(key)).unwrap().split(" = ").nth(1).unwrap().trim().parse().unwrap()
    };
    let (begin, length) = (of("START_BYTE") - 1, of("BYTES"));
    let level = set.level("A", "OB", "2015-06-30");
    for (line, wanted) in lines.iter().zip(level.numbers("bx").unwrap()) {
        let found: f64 = line[begin..begin + length].trim().parse().unwrap();
        assert!((found - wanted).abs() < 6e-6);
    }
    assert!(lines.iter().any(|line| line.starts_with("2015-06-30T23:59:60.")));
}

#[test]
fn check_and_inspect_know_a_configuration_of_flight_processing() {
    let set = Set::of("telemetry");
    let path = set.path("flight.toml");
    let output = calfit().arg("check").arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = calfit().arg("inspect").arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stdout), &["OB 2015-06-30", "IB 2015-07-01", "SID6", "rejected by their quality"]);
    fs::remove_file(set.path("attitude/attitude.parquet")).unwrap();
    fs::remove_file(set.path("ground/THERMISTOR__FM-IB.toml")).unwrap();
    let output = calfit().arg("check").arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    // Both are named, not only the first.
    says(&text(&output.stderr), &["attitude.parquet", "THERMISTOR__FM-IB.toml"]);
}

/// Timestamps of a leap second are all alike; the clock of the spacecraft tells its vectors apart.
#[test]
fn vectors_of_a_leap_second_have_the_times_of_the_clock_beside_their_timestamps() {
    let set = Set::of("telemetry");
    let file = set.path("edited/sensor=OB/date=2015-06-30/part-0.parquet");
    let table = SeriesTable::open(&file).unwrap();
    let leap = calfit::data::time::LeapSeconds::default();
    let times = table.whole("time_tt2000").unwrap();
    // 2015-07-01T00:00:00 UTC; the last second of the day before is no time of a timestamp, which stands still in it.
    let midnight = 488_980_868_184_000_000;
    let stamps: Vec<i64> = times
        .iter()
        .map(|t| {
            leap.utc(if (midnight - 1_000_000_000..midnight).contains(t) { midnight - 1_000_000_001 } else { *t }).timestamp_ns()
        })
        .collect();
    // Seconds since 2003-01-01T00:00:00 UTC, which is 94651264184000000 in this count.
    let clock: Vec<f64> = times.iter().map(|t| (t - 94_651_264_184_000_000) as f64 / 1e9).collect();
    let modes = table.words("sid").unwrap();
    let codes: Vec<u8> = modes.codes.iter().map(|code| u8::try_from(*code).unwrap()).collect();
    let whole = ["bx", "by", "bz", "t_ob", "quality"].map(|name| (name, table.whole(name).unwrap()));
    let mut columns = vec![("time_utc", Column::Timestamps(&stamps)), ("time_obt", Column::Numbers(&clock))];
    columns.extend(whole.iter().map(|(name, values)| (*name, Column::Whole(values))));
    columns.push(("sid", Column::Words(&codes, &modes.words)));
    let mut output = fs::File::create(&file).unwrap();
    let mut writer = LongWriter::new(&mut output, &columns, Vec::new()).unwrap();
    writer.write(&columns).unwrap();
    writer.finish().unwrap();
    set.made("A", &[]);
    let level = set.level("A", "OB", "2015-06-30");
    let (times, flags) = (level.whole("time_tt2000").unwrap(), level.whole("flags").unwrap());
    let within: Vec<i64> = times.into_iter().zip(flags).filter(|(_, f)| f & 16 != 0).map(|(t, _)| t).collect();
    assert_eq!(within.len(), 20);
    assert!(within.iter().all(|t| (midnight - 1_000_000_000..midnight).contains(t)));
    // Twenty vectors per second.
    assert!(within.windows(2).all(|pair| (pair[1] - pair[0] - 50_000_000).abs() < 1_000_000), "{within:?}");
}
