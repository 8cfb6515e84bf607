//! Telemetry of a twin in flight through `calfit flight`, against the truth that stands beside it.

use crate::common::check::{calfit, data, process, tree};
use calfit::files::table::long::{Column, LongWriter};
use calfit::files::table::series::SeriesTable;
use nalgebra::{Rotation3, Vector3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use toml_edit::{DocumentMut, TableLike};

const TWIN: &str = "configs/rosetta-telemetry.toml";
const SENSORS: [&str; 2] = ["OB", "IB"];
/// White noise of a reading and step of the converter over √12, enT.
const NOISE_ENT: f64 = 0.03;
const STEP_ENT: f64 = 30_000.0 / 1_048_575.0 / 3.464_101_615_137_754_6;

/// Telemetry of a twin in a folder of its own.
struct Flown {
    dir: TempDir,
    truth: Value,
}

impl Flown {
    /// With changes of the text of the twin, each of which must find its place.
    fn new(changes: &[(&str, &str)]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let twin = changed(dir.path(), changes);
        let output = calfit().arg("simulate").arg(twin).arg("-o").arg(dir.path().join("telemetry")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let truth = fs::read(dir.path().join("telemetry/truth/truth.json")).unwrap();
        Self { truth: serde_json::from_slice(&truth).unwrap(), dir }
    }

    /// Makes levels; returns what the command says of the days.
    fn levels(&self, levels: &str) -> Value {
        let config = self.dir.path().join("telemetry/flight.toml");
        let out = self.dir.path().join("levels");
        let output = calfit().args(["flight", levels]).arg(config).arg("-o").arg(out).arg("--json").output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn days(&self, sensor: usize) -> Vec<String> {
        let days = self.truth["sensors"][sensor]["days"].as_array().unwrap();
        days.iter().map(|d| d["day"].as_str().unwrap().to_owned()).collect()
    }

    /// The good vectors of the truth of a sensor and day, a column at a time.
    fn truth(&self, sensor: &str, day: &str) -> Good {
        let path = format!("telemetry/truth/sensor={sensor}/date={day}/truth.parquet");
        let table = SeriesTable::open(&self.dir.path().join(path)).unwrap();
        let good: Vec<bool> = table.whole("good").unwrap().into_iter().map(|g| g == 1).collect();
        Good { table, good }
    }

    fn level(&self, level: &str, sensor: &str, day: &str) -> SeriesTable {
        let name = format!("calfit-{level}-{sensor}-{}.parquet", day.replace('-', ""));
        let path = format!("levels/level={level}/sensor={sensor}/date={day}/{name}");
        SeriesTable::open(&self.dir.path().join(path)).unwrap()
    }
}

/// The twin with changes, beside a ground twin that is named by its whole path.
fn changed(dir: &Path, changes: &[(&str, &str)]) -> PathBuf {
    let mut text = fs::read_to_string(data(TWIN)).unwrap();
    let ground = format!("ground_twin = \"{}\"", data("configs/rosetta-ground.toml").display());
    for (old, new) in changes.iter().copied().chain([("ground_twin = \"rosetta-ground.toml\"", ground.as_str())]) {
        assert!(text.contains(old), "{old}");
        text = text.replace(old, new);
    }
    let path = dir.join("twin.toml");
    fs::write(&path, text).unwrap();
    path
}

struct Good {
    table: SeriesTable,
    good: Vec<bool>,
}

impl Good {
    fn numbers(&self, name: &str) -> Vec<f64> {
        let all = self.table.numbers(name).unwrap();
        all.into_iter().zip(&self.good).filter(|(_, good)| **good).map(|(v, _)| v).collect()
    }

    fn times(&self) -> Vec<i64> {
        let all = self.table.whole("time_tt2000").unwrap();
        all.into_iter().zip(&self.good).filter(|(_, good)| **good).map(|(v, _)| v).collect()
    }

    fn vectors(&self, stem: &str) -> Vec<Vector3<f64>> {
        vectors([0, 1, 2].map(|i| self.numbers(&format!("{stem}_{}", ["x", "y", "z"][i]))))
    }
}

fn vectors([x, y, z]: [Vec<f64>; 3]) -> Vec<Vector3<f64>> {
    (0..x.len()).map(|i| Vector3::new(x[i], y[i], z[i])).collect()
}

fn field(table: &SeriesTable) -> Vec<Vector3<f64>> {
    vectors(["bx", "by", "bz"].map(|name| table.numbers(name).unwrap()))
}

fn floats(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn at(coefficients: &[f64], degc: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * degc + c)
}

/// Rotation from the spacecraft to the celestial frame, from the numbers of the twin.
fn attitude(time: i64) -> Rotation3<f64> {
    let turn = |deg: [f64; 3]| Vector3::from(deg.map(f64::to_radians));
    // 2015-06-30T23:00:00 UTC: 5659 days and 11 h after 2000-01-01T12:00:00, with 35 leap seconds and 32.184 s.
    let start = ((5659 * 24 + 11) * 3600 + 35) * 1_000_000_000 + 32_184_000_000;
    let hours = (time - start) as f64 / 3.6e12;
    Rotation3::new(turn([20.0, -35.0, 110.0])) * Rotation3::new(turn([1.0, -2.5, 3.0]) * hours)
}

#[test]
fn rows_and_flags_are_those_of_the_truth() {
    let flown = Flown::new(&[]);
    let made = flown.levels("ABC");
    assert!(made["failed"].as_array().unwrap().is_empty(), "{made}");
    let mut seen = 0;
    for (index, sensor) in SENSORS.into_iter().enumerate() {
        for truth in flown.truth["sensors"][index]["days"].as_array().unwrap() {
            let of = |day: &&Value| day["sensor"] == sensor && day["day"] == truth["day"];
            let day = made["days"].as_array().unwrap().iter().find(of).unwrap();
            for key in ["read", "duplicates", "rejected", "written", "flags"] {
                assert_eq!(day[key], truth[key], "{sensor} {} {key}", truth["day"]);
            }
            assert_eq!((&day["conflicts"], &day["contradicting"]), (&0.into(), &0.into()));
            seen += 1;
            let day = truth["day"].as_str().unwrap();
            for level in ["A", "B", "C"] {
                let table = flown.level(level, sensor, day);
                let times = table.whole("time_tt2000").unwrap();
                assert_eq!(times, flown.truth(sensor, day).times(), "{level} {sensor} {day}");
                let counts: Value = serde_json::from_str(table.says("counts").unwrap()).unwrap();
                let nulls = table.numbers("bx").unwrap().iter().filter(|v| v.is_nan()).count();
                let said = counts["null"].get("no attitude").and_then(Value::as_u64).unwrap_or(0);
                assert_eq!((said, counts["null"].as_object().unwrap().len()), (nulls as u64, usize::from(nulls > 0)));
            }
        }
    }
    assert_eq!(made["days"].as_array().unwrap().len(), seen);
    // The twin shows all of it, or these comparisons say nothing.
    let all = |index: usize, key: &str| -> u64 {
        flown.truth["sensors"][index]["days"].as_array().unwrap().iter().map(|d| d[key].as_u64().unwrap()).sum()
    };
    assert!([0, 1].iter().all(|i| all(*i, "duplicates") > 0 && all(*i, "rejected") > 0));
    let mut flags: BTreeMap<String, u64> = BTreeMap::new();
    for day in flown.truth["sensors"][0]["days"].as_array().unwrap() {
        for (words, count) in day["flags"].as_object().unwrap() {
            *flags.entry(words.clone()).or_default() += count.as_u64().unwrap();
        }
    }
    for words in ["outside the table of offsets", "no attitude", "inside a leap second", "first vector after a gap"] {
        assert!(flags.get(words).is_some_and(|count| *count > 0), "{words}: {flags:?}");
    }
    // A vector every 50 ms through the second 23:59:60.
    assert!(flags["inside a leap second"] <= 20);
}

/// Heaters and wheels set flags of levels that are made after level B; the summary of a day, from which the report has its table, counts them.
#[test]
fn the_summary_of_a_day_counts_the_flags_of_later_levels() {
    let flown = Flown::new(&[]);
    let made = flown.levels("KH");
    let counted = |level: &str, sensor: &str, day: &str, bit: i64| -> u64 {
        flown.level(level, sensor, day).whole("flags").unwrap().iter().filter(|flags| **flags & bit != 0).count() as u64
    };
    let mut seen = [0; 2];
    for day in made["days"].as_array().unwrap().iter().filter(|day| SENSORS.contains(&day["sensor"].as_str().unwrap())) {
        let [sensor, date] = ["sensor", "day"].map(|key| day[key].as_str().unwrap());
        let said = |words: &str| day["flags"][words].as_u64().unwrap_or(0);
        let closed = counted("K", sensor, date, 1 << 6);
        assert_eq!(said("heater"), closed, "{sensor} {date}");
        seen[0] += closed;
        // Wheels are taken off the primary sensor alone.
        if sensor == SENSORS[0] {
            let [changed, short] = [1 << 7, 1 << 9].map(|bit| counted("H", sensor, date, bit));
            assert_eq!(said("wheels or lines taken off"), changed, "{sensor} {date}");
            assert_eq!(said("stretch too short to take wheels off"), short, "{sensor} {date}");
            seen[1] += changed;
        }
    }
    assert!(seen.iter().all(|count| *count > 0), "{seen:?}");
}

/// A smoothed temperature takes packets of the days beside its own, as many whatever else is made.
#[test]
fn smoothed_level_a_does_not_depend_on_the_other_levels() {
    let flown = Flown::new(&[]);
    let config = flown.dir.path().join("telemetry/flight.toml");
    let stated = fs::read_to_string(&config).unwrap();
    assert!(stated.contains("\n[temperature]\n") && !stated.contains("smooth_s"));
    fs::write(&config, stated.replace("\n[temperature]\n", "\n[temperature]\nsmooth_s = 200.0\n")).unwrap();
    let of = |levels: &str| {
        flown.levels(levels);
        let days =
            SENSORS.into_iter().enumerate().flat_map(|(index, sensor)| flown.days(index).into_iter().map(move |d| (sensor, d)));
        let made: Vec<_> = days
            .map(|(sensor, day)| {
                let level = flown.level("A", sensor, &day);
                (level.numbers("t_degc").unwrap(), field(&level))
            })
            .collect();
        fs::remove_dir_all(flown.dir.path().join("levels")).unwrap();
        made
    };
    let alone = of("A");
    assert!(alone.iter().all(|(degc, _)| degc.len() > 10));
    assert!(alone == of("AH") && alone == of("AK"));
}

/// A second of bad readings in a heater interval is no heater: what was switched is found as without it, and the bad vectors are counted and
/// flagged.
#[test]
fn a_short_run_of_bad_readings_spoils_no_heater_interval() {
    const BURST: std::ops::Range<usize> = 9000..9020;
    for add in [1000, 5000, 50_000] {
        let flown = Flown::new(&[]);
        let day = "2015-06-30";
        let path = flown.dir.path().join(format!("telemetry/edited/sensor=OB/date={day}/part-0.parquet"));
        let table = SeriesTable::open(&path).unwrap();
        let mut whole: BTreeMap<&str, Vec<i64>> = BTreeMap::new();
        for name in ["time_tt2000", "bx", "by", "bz", "t_ob", "t_ib", "quality"] {
            whole.insert(name, table.whole(name).unwrap());
        }
        // Counts of 28.61 pT, at 20 vectors a second.
        let bad: Vec<i64> = whole["time_tt2000"][BURST].to_vec();
        whole.get_mut("bx").unwrap()[BURST].iter_mut().for_each(|count| *count += add);
        let sid = table.words("sid").unwrap();
        let codes: Vec<u8> = sid.codes.iter().map(|code| u8::try_from(*code).unwrap()).collect();
        let mut columns: Vec<(&str, Column)> = whole.iter().map(|(name, values)| (*name, Column::Whole(values))).collect();
        columns.push(("sid", Column::Words(&codes, &sid.words)));
        drop(table);
        let mut file = fs::File::create(&path).unwrap();
        let mut writer = LongWriter::new(&mut file, &columns, Vec::new()).unwrap();
        writer.write(&columns).unwrap();
        writer.finish().unwrap();
        let made = flown.levels("K");
        assert!(made.to_string().contains("20 vectors within heater intervals stand out of those on both sides"), "{made}");
        let (mut square, mut count) = (0.0, 0.0);
        for day in flown.days(0) {
            let level = flown.level("K", "OB", &day);
            let (field, flags, times) = (field(&level), level.whole("flags").unwrap(), level.whole("time_tt2000").unwrap());
            let truth = flown.truth("OB", &day);
            let wanted: Vec<_> =
                truth.vectors("b_sc").into_iter().zip(truth.vectors("heat_sc")).map(|(b, heat)| b - heat).collect();
            for (row, time) in times.iter().enumerate() {
                // The modes of the burst are not shifted in time.
                if bad.contains(time) {
                    assert!(flags[row] & 1 << 6 != 0, "{time}");
                } else {
                    square += (field[row] - wanted[row]).norm_squared() / 3.0;
                    count += 1.0;
                }
            }
        }
        let left = (square / count).sqrt();
        println!("{add} counts: {left} nT");
        // Noise of 0.045 nT of every vector, and some hundredths of what heaters leave; the heaters themselves make up to 1.4 nT.
        assert!(left < 0.1, "{add} counts: {left} nT");
    }
}

/// What is left of a level is white noise, the steps of the converter, and what the thermistor does not tell: its steps, and
/// a temperature that moves while a packet holds one reading of it. The latter is taken off with the slopes of the truth.
#[test]
fn levels_close_to_the_noise() {
    let flown = Flown::new(&[]);
    flown.levels("ABC");
    for (index, sensor) in SENSORS.into_iter().enumerate() {
        let stated = &flown.truth["sensors"][index];
        let sigma: Vec<Vec<f64>> = stated["sigma"].as_array().unwrap().iter().map(floats).collect();
        let offset: Vec<Vec<f64>> = stated["b_off_ent"].as_array().unwrap().iter().map(floats).collect();
        let (mut squares, mut sums, mut count) = ([[0.0; 3]; 3], [[0.0; 3]; 3], 0.0);
        for day in flown.days(index) {
            let truth = flown.truth(sensor, &day);
            let daily = stated["daily_nt"].as_array().unwrap().iter().find(|d| d["day"] == day.as_str()).unwrap();
            let daily: Vec<Vec<f64>> = daily["polynomials"].as_array().unwrap().iter().map(floats).collect();
            let [a, b, c] = ["A", "B", "C"].map(|level| flown.level(level, sensor, &day));
            let measured = a.numbers("t_degc").unwrap();
            let times = truth.times();
            let (a_nt, b_nt) = (truth.vectors("a_uvw"), truth.vectors("b_sc"));
            let (external, heat) = (truth.vectors("ext"), truth.vectors("heat_sc"));
            let (wheel, lap, scn) = (truth.vectors("wheel_sc"), truth.vectors("lap_sc"), truth.vectors("scn_sc"));
            let (jump, jumped) = (truth.vectors("jump_sc"), truth.numbers("t_degc"));
            let [a, b, c] = [a, b, c].map(|table| field(&table));
            for row in 0..times.len() {
                let to_celestial = attitude(times[row]);
                let parts = to_celestial.inverse() * external[row] + heat[row] + wheel[row] + lap[row] + scn[row];
                assert!((parts - b_nt[row]).norm() < 1e-9, "{sensor} {day} {row}");
                // Both frames hold the same field: only a rotation lies between them.
                assert!((a_nt[row].norm() - (b_nt[row] + jump[row]).norm()).abs() < 1e-9, "{sensor} {day} {row}");
                let told = Vector3::from_fn(|i, _| {
                    let of_offset = at(&offset[i], measured[row]) - at(&offset[i], jumped[row]);
                    at(&sigma[i], measured[row]) * of_offset + at(&daily[i], measured[row]) - at(&daily[i], jumped[row])
                });
                // Where the attitude is not known there is no level C; the row counts nowhere.
                if c[row].x.is_nan() {
                    continue;
                }
                let own = a[row] - a_nt[row] + told;
                // Rotations keep the scatter of equal noise on all axes; what the thermistor adds is taken off before.
                let in_sc = b[row] - b_nt[row];
                let in_cel = c[row] - to_celestial * b_nt[row];
                assert!((in_sc.norm() - (a[row] - a_nt[row]).norm()).abs() < 1e-9);
                assert!((in_cel.norm() - in_sc.norm()).abs() < 1e-9);
                for i in 0..3 {
                    squares[0][i] += own[i] * own[i];
                    sums[0][i] += own[i];
                }
                count += 1.0;
            }
        }
        let expected = 1.0915 * NOISE_ENT.hypot(STEP_ENT);
        for i in 0..3 {
            let rms = (squares[0][i] / count).sqrt();
            let mean = sums[0][i] / count;
            println!("{sensor} {i}: {count} vectors, rms {rms:.5} nT, expected {expected:.5}, mean {mean:.6}");
            // Five standard deviations of the scatter of an rms, and 0.4 % by which sensitivities differ between axes.
            assert!((rms / expected - 1.0).abs() < 5.0 / (2.0_f64 * count).sqrt() + 0.004, "{sensor} {i}: {rms} {expected}");
            assert!(mean.abs() < 5.0 * expected / count.sqrt() + 5e-4, "{sensor} {i}: {mean}");
        }
        assert!(count > 10_000.0, "{sensor} {count}");
    }
}

#[test]
fn without_noise_and_steps_level_a_is_the_truth() {
    let flown = Flown::new(&[("exact = false", "exact = true")]);
    flown.levels("A");
    let mut largest = 0.0_f64;
    for (index, sensor) in SENSORS.into_iter().enumerate() {
        for day in flown.days(index) {
            let level = flown.level("A", sensor, &day);
            let truth = flown.truth(sensor, &day);
            let degc = level.numbers("t_degc").unwrap().into_iter().zip(truth.numbers("t_degc"));
            assert!(degc.into_iter().all(|(found, t)| (found - t).abs() < 1e-9));
            for (found, expected) in field(&level).iter().zip(truth.vectors("a_uvw")) {
                largest = largest.max((found - expected).amax());
            }
        }
    }
    println!("largest difference {largest:e} nT");
    assert!(largest <= 1e-8, "{largest:e} nT");
}

#[test]
fn housekeeping_is_the_truth_within_its_steps() {
    let flown = Flown::new(&[]);
    flown.levels("all");
    let truth = SeriesTable::open(&flown.dir.path().join("telemetry/truth/hk.parquet")).unwrap();
    let times = truth.whole("time_tt2000").unwrap();
    let mut row = 0;
    for day in ["2015-06-30", "2015-07-01"] {
        let path = format!("levels/level=HK/date={day}/calfit-HK-{}.parquet", day.replace('-', ""));
        let made = SeriesTable::open(&flown.dir.path().join(path)).unwrap();
        let own = made.whole("time_tt2000").unwrap();
        assert_eq!(own, times[row..row + own.len()]);
        // Half a step of every converter: 16 bits of the thermistor about -40 °C, 16 of the field, 20 and 8 of the voltages.
        for (name, of, half_step) in [
            ("t_ob_calibrated", "t_ob_degc", 0.02),
            ("t_ib_calibrated", "t_ib_degc", 0.02),
            ("bx_ob", "b_ob_x", 0.2501),
            ("by_ob", "b_ob_y", 0.2501),
            ("bz_ob", "b_ob_z", 0.2501),
            ("ref_voltage", "ref_voltage", 4.8e-6),
            ("pos_voltage", "pos_voltage", 0.00129),
            ("neg_voltage", "neg_voltage", 0.00142),
        ] {
            let expected = &truth.numbers(of).unwrap()[row..row + own.len()];
            for (found, expected) in made.numbers(name).unwrap().iter().zip(expected) {
                assert!((found - expected).abs() <= half_step, "{day} {name}: {found} {expected}");
            }
        }
        row += own.len();
    }
    assert_eq!(row, times.len());
}

#[test]
fn equal_seeds_give_equal_bytes_on_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let twin = changed(dir.path(), &[]);
    let made = |out: &str, seed: &str, threads: &str| {
        let out = dir.path().join(out);
        let mut command = process();
        command.env("RAYON_NUM_THREADS", threads).arg("simulate").arg(&twin).args(["--seed", seed]).arg("-o").arg(&out);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        tree(&out)
    };
    let (first, second, other) = (made("a", "7", "1"), made("b", "7", "2"), made("c", "8", "2"));
    assert!(first.len() > 15 && first.keys().eq(second.keys()));
    for (name, own) in &first {
        assert!(second[name] == *own, "{name}");
    }
    let edited = "edited/sensor=OB/date=2015-06-30/part-0.parquet";
    assert!(first[edited] != other[edited]);
}

#[test]
fn what_is_wrong_with_a_twin_in_flight_is_said() {
    for (change, says) in [
        (("truth_every = 1", "truth_evry = 1"), "the nearest known key is `truth_every`"),
        (("truth_every = 1", "truth_every = 0"), "`telemetry.truth_every` must be 1 or more"),
        (("ground_sensor = \"FM-OB\"", "ground_sensor = \"FM-XX\""), "is not in the ground twin"),
        (("lost = 0.02", "lost = 1.0"), "must be a probability below 1"),
        (
            ("to = \"2015-07-01T00:25:00Z\"\n[[interval]]", "to = \"2015-07-01T00:26:00Z\"\n[[interval]]"),
            "intervals that overlap",
        ),
        (("t_off_degc = -1.5\nvalid_degc = [-100.0, 90.0]", "t_off_degc = -1.5\nvalid_degc = [-100.0, 9000.0]"), "does not rise"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let twin = changed(dir.path(), &[change]);
        let output = calfit().arg("simulate").arg(twin).arg("-o").arg(dir.path().join("out")).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && errors.contains(says), "{errors}");
        assert!(!dir.path().join("out/flight.toml").exists());
    }
}

/// The twin with seven calm hours of one mode in which the temperature swings by 16 K: the offset follows it in x and y, not in z.
pub fn calm_twin(dir: &Path) -> PathBuf {
    let mut twin: DocumentMut = fs::read_to_string(data(TWIN)).unwrap().parse().unwrap();
    for key in ["gap", "heaters", "wheels"] {
        twin.remove(key);
    }
    let set = |table: &mut dyn TableLike, key: &str, text: &str| {
        table.insert(key, toml_edit::value(text.parse::<toml_edit::Value>().unwrap()));
    };
    let telemetry = twin["telemetry"].as_table_like_mut().unwrap();
    set(telemetry, "ground_twin", &format!("{:?}", data("configs/rosetta-ground.toml")));
    set(telemetry, "from", "\"2015-06-30T17:00:00Z\"");
    set(telemetry, "to", "\"2015-06-30T23:50:00Z\"");
    twin["interval"].as_array_of_tables_mut().unwrap().retain(|interval| interval["sid"].as_str() == Some("SID2"));
    let interval = twin["interval"].as_array_of_tables_mut().unwrap().get_mut(0).unwrap();
    set(interval, "from", "\"2015-06-30T17:00:00Z\"");
    set(interval, "to", "\"2015-06-30T23:50:00Z\"");
    for sensor in twin["sensor"].as_array_of_tables_mut().unwrap().iter_mut() {
        sensor.remove("jump");
        set(sensor, "temperature", "{ start_degc = -42.0, swing_k = 8.0, period_h = 2.5 }");
        set(sensor, "daily_x", "[1.5, 0.05, 4e-3]");
        set(sensor, "daily_y", "[-0.8, -0.04]");
        set(sensor, "daily_z", "[0.6]");
        let boom = sensor["rotation"].as_array_of_tables_mut().unwrap().get_mut(0).unwrap();
        set(boom, "from", "\"2015-06-30T16:00:00Z\"");
    }
    for (key, text) in [("mean_nt", "[0.0, 0.0, 0.0]"), ("scatter_nt", "[0.03, 0.03, 0.03]")] {
        set(twin["external"].as_table_like_mut().unwrap(), key, text);
    }
    for (key, text) in [("noise_nt", "[0.0, 0.0, 0.0]"), ("line_nt", "0.0")] {
        set(twin["spacecraft"].as_table_like_mut().unwrap(), key, text);
    }
    twin["attitude"].as_table_like_mut().unwrap().remove("hole");
    let path = dir.join("twin.toml");
    fs::write(&path, twin.to_string()).unwrap();
    path
}

#[test]
fn daily_models_are_found_in_calm_times() {
    let dir = tempfile::tempdir().unwrap();
    let telemetry = dir.path().join("telemetry");
    let run = |arguments: &[&str], paths: &[&Path]| -> (bool, Vec<u8>, String) {
        let output = calfit().args(arguments).args(paths).output().unwrap();
        (output.status.success(), output.stdout, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (done, _, errors) = run(&["simulate", "-o"], &[&telemetry, &calm_twin(dir.path())]);
    assert!(done, "{errors}");
    let (config, models) = (telemetry.join("flight.toml"), dir.path().join("models"));
    let (done, stdout, errors) = run(&["flight", "daily", "--sensor", "OB", "--json", "-o"], &[&models, &config]);
    assert!(done, "{errors}");
    let made: Value = serde_json::from_slice(&stdout).unwrap();
    let model = &made["models"][0];
    assert_eq!(model["order"], serde_json::json!([2, 1, 0]), "{model}");
    for c in 0..2 {
        assert!(model["explained"][c].as_f64().unwrap() > 0.5, "{model}");
    }
    // The file as a stranger reads it, against the polynomials of the truth.
    let truth: Value = serde_json::from_slice(&fs::read(telemetry.join("truth/truth.json")).unwrap()).unwrap();
    let truth = &truth["sensors"][0]["daily_nt"][0]["polynomials"];
    let name = "RPCMAG_150630_006_CALIB_OB.toml";
    let text = fs::read_to_string(models.join(name)).unwrap();
    let file: DocumentMut = text.parse().unwrap();
    let numbers =
        |item: &toml_edit::Item| -> Vec<f64> { item.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect() };
    let valid = numbers(&file["valid_degc"]);
    assert!(valid[1] - valid[0] > 15.0 && valid[0] > -51.0, "{valid:?}");
    for (c, key) in ["p_x", "p_y", "p_z"].into_iter().enumerate() {
        let own = numbers(&file[key]);
        let covariance = file["covariance"][key].as_array().unwrap();
        let rows: Vec<Vec<f64>> =
            covariance.iter().map(|row| row.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect()).collect();
        for degc in [-49.0, -42.0, -35.0] {
            let power: Vec<f64> = (0..own.len()).map(|k| f64::powi(degc, k as i32)).collect();
            let variance: f64 =
                (0..own.len()).map(|i| (0..own.len()).map(|j| power[i] * rows[i][j] * power[j]).sum::<f64>()).sum();
            let difference = at(&own, degc) - at(&floats(&truth[c]), degc);
            println!("{key} at {degc} °C: {difference:.4} ± {:.4} nT", variance.sqrt());
            assert!(difference.abs() < 4.0 * variance.sqrt() && variance.sqrt() < 0.05, "{key} {degc}: {difference} {variance}");
        }
    }
    assert!(text.contains("\ncalm = [\n  \"2015-06-30T17:00:00.000000000Z/"), "{text}");
    // Flight processing takes it, and level A is that of the true model within the uncertainty of the fitted one.
    let level = |out: &str| -> Vec<Vector3<f64>> {
        let out = dir.path().join(out);
        let (done, _, errors) = run(&["flight", "A", "--sensor", "OB", "--no-plots", "-o"], &[&out, &config]);
        assert!(done, "{errors}");
        let file = out.join("level=A/sensor=OB/date=2015-06-30/calfit-A-OB-20150630.parquet");
        let all = field(&SeriesTable::open(&file).unwrap());
        all.into_iter().filter(|v| !v.x.is_nan()).collect()
    };
    let with_true = level("true");
    fs::copy(models.join(name), telemetry.join("daily").join(name)).unwrap();
    let with_fitted = level("fitted");
    // A few readings of the thermistor lie beyond the means of calm minutes; there the model gives nothing.
    assert!(with_true.len() > 20_000 && with_fitted.len() * 100 > with_true.len() * 98, "{}", with_fitted.len());
    let mean = |list: &[Vector3<f64>]| list.iter().sum::<Vector3<f64>>() / list.len() as f64;
    let difference = mean(&with_fitted) - mean(&with_true);
    assert!(difference.amax() < 4.0 * 0.05, "{difference}");
    // Without calm times there is no model, and nothing is written.
    let table = dir.path().join("calm.csv");
    fs::write(&table, "from,to\n2015-06-30T17:00:00Z,2015-06-30T17:05:00Z\n").unwrap();
    let none = dir.path().join("none");
    let (done, _, errors) = run(&["flight", "daily", "--sensor", "OB", "-o"], &[&none, &config, Path::new("--calm"), &table]);
    assert!(!done && errors.contains("there are 5 calm minutes, and ten are needed"), "{errors}");
    assert!(!none.join(name).exists());
    let (done, _, errors) = run(&["flight", "A", "--order", "2"], &[&config]);
    assert!(!done && errors.contains("--order and --calm are options of `daily`"), "{errors}");
}
