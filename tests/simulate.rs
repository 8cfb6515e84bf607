//! `calfit simulate`: what a twin says is what its run files show, by closed forms and by the forward model of `common`, which is not
//! the tool's; mistakes in a twin are named.

use crate::common;

use common::check::{Case, calfit, text};
use common::{POSITIONS, Truth};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Real sample rate of the twin.
const RATE_HZ: f64 = 63.99;

/// A twin without noise; tests add to it and change it.
const TWIN: &str = r#"
seed = 7
[campaign]
name = "Twin"
[[campaign.position]]
id = 1
axes = ["+X", "+Y", "+Z"]
[[campaign.position]]
id = 2
axes = ["-X", "-Y", "+Z"]
[[campaign.position]]
id = 3
axes = ["-Z", "-Y", "-X"]
[[campaign.position]]
id = 4
axes = ["-Z", "+Y", "+X"]
[electronics]
sample_rate_hz = 64.0
range_ent = 4000.0
resolution_ent = 0.001
[[sensor]]
name = "FGM"
mode = "normal"
real_sample_rate_hz = 63.99
rotation_deg = [0.4, -0.7, 0.25]
sigma_x = [0.98]
sigma_y = [1.02]
sigma_z = [0.995]
xi_xy = [89.8]
xi_xz = [90.3]
xi_yz = [90.05]
b_off_x = [12.5]
b_off_y = [-8.25]
b_off_z = [3.75]
f_3db_x = [20.0]
f_3db_y = [25.0]
f_3db_z = [15.0]
response = "first order"
white_ent = [0.0, 0.0, 0.0]
[facility]
residual = [{ from = "2026-01-01T00:00:00Z", field_nt = [3.0, -5.0, 7.0] }]
[box]
start_degc = 20.0
[temperatures]
interval_s = 10.0
coil = { mean_degc = 17.0 }
rack = { mean_degc = 31.0 }
[[temperatures.thermistor]]
channel = "T59"
of = "sensor"
[[run]]
start = "2026-01-02T10:00:00Z"
programme = "STEPS.MAG"
sensor = "FGM"
mode = "normal"
"#;

/// Fields on all axes in all positions, 4 s each.
fn steps() -> String {
    let mut mag = "MAG 1\nname = \"STEPS.MAG\"\nkind = \"offset\"\n@STEPS\nduration,bx,by,bz,frequency,position\n".to_owned();
    for (position, _) in POSITIONS {
        for field in ["0,0,0", "1500,0,0", "0,-700,0", "100,200,-900"] {
            mag += &format!("4,{field},0,{position}\n");
        }
    }
    mag + "@END\n"
}

/// A twin with its programmes in a folder of its own.
struct Folder {
    case: Case,
}

impl Folder {
    fn of(twin: &str) -> Self {
        let folder = Self { case: Case::new() };
        folder.put("twin.toml", twin);
        folder.put("STEPS.MAG", &steps());
        folder
    }

    fn put(&self, name: &str, text: &str) {
        fs::write(self.case.path().join(name), text).unwrap();
    }

    fn simulate(&self, out: &str, arguments: &[&str]) -> Output {
        let [twin, out] = ["twin.toml", out].map(|name| self.case.path().join(name));
        calfit().arg("simulate").arg(twin).arg("-o").arg(out).args(arguments).output().unwrap()
    }

    /// The only run file.
    fn run(&self) -> Table {
        let output = self.simulate("campaign", &[]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert_eq!(text(&output.stderr), "");
        Table::read(&self.case.path().join("campaign/26-01-02/10-00-00.CCR"))
    }

    #[track_caller]
    fn refused(&self, words: &[&str]) {
        let output = self.simulate("campaign", &[]);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        words.iter().for_each(|word| assert!(stderr.contains(word), "{stderr}"));
        assert!(!self.case.path().join("campaign/campaign.toml").exists());
    }
}

/// A run file as rows of numbers per section, read without the tool; an empty cell is NaN.
struct Table(BTreeMap<String, (Vec<String>, Vec<Vec<f64>>)>);

impl Table {
    fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut sections: BTreeMap<String, (Vec<String>, Vec<Vec<f64>>)> = BTreeMap::new();
        let mut current: Option<String> = None;
        for line in text.lines() {
            if line.starts_with('@') {
                current = Some(line.to_owned());
            } else if let Some(name) = &current {
                match sections.get_mut(name) {
                    None => {
                        let names = line.split(',').map(str::to_owned).collect();
                        sections.insert(name.clone(), (names, Vec::new()));
                    }
                    Some((_, rows)) => rows.push(line.split(',').map(|c| c.parse().unwrap_or(f64::NAN)).collect()),
                }
            }
        }
        Self(sections)
    }

    fn rows(&self, section: &str) -> &[Vec<f64>] {
        &self.0[section].1
    }

    fn column(&self, section: &str, name: &str) -> Vec<f64> {
        let at = self.0[section].0.iter().position(|n| n == name).unwrap();
        self.rows(section).iter().map(|row| row[at]).collect()
    }

    /// Time (from the counter: the column has four decimals only) and reading of samples between two times.
    fn samples(&self, from: f64, to: f64) -> Vec<(f64, [f64; 3])> {
        let all = self.rows("@VECTORS").iter().map(|row| ((row[0] + 0.5) / RATE_HZ, [row[2], row[3], row[4]]));
        all.filter(|(t, _)| *t >= from && *t < to).collect()
    }
}

#[test]
fn a_programme_can_be_repeated_with_other_fields() {
    let once = Folder::of(TWIN).run();
    let twice = Folder::of(&format!("{TWIN}repeat = 2\nfield_factor = 0.5\n")).run();
    let (once, twice) = (once.rows("@FIELDS"), twice.rows("@FIELDS"));
    assert_eq!(twice.len(), 2 * once.len());
    for (i, row) in twice.iter().enumerate() {
        let from = &once[i % once.len()];
        assert_eq!(row[0], 4.0 * i as f64);
        assert_eq!(row[2..5], from[2..5].iter().map(|b| 0.5 * b).collect::<Vec<f64>>());
    }
}

#[test]
fn readings_without_noise_are_those_of_the_independent_forward_model_in_every_position() {
    let run = Folder::of(TWIN).run();
    let residual = [3.0, -5.0, 7.0];
    for setting in run.rows("@FIELDS") {
        let [t_start, t_end, bx, by, bz, _, position] = setting[..] else { panic!() };
        let axes = POSITIONS.iter().find(|(id, _)| f64::from(*id) == position).unwrap().1;
        let truth = Truth { axes, ..Truth::default() };
        let wanted = truth.reading([bx + residual[0], by + residual[1], bz + residual[2]]);
        let samples = run.samples(t_start + 1.0, t_end);
        assert!((191..=192).contains(&samples.len()));
        for (t, reading) in samples {
            for i in 0..3 {
                assert!((reading[i] - wanted[i]).abs() < 0.000_51, "{t} {i}: {} {}", reading[i], wanted[i]);
            }
        }
    }
    // The counter runs at the real rate, samples stand in the middle of their periods.
    for row in run.rows("@VECTORS").iter().step_by(777) {
        assert!((row[1] - (row[0] + 0.5) / RATE_HZ).abs() < 0.000_051);
    }
}

#[test]
fn a_sensor_turns_with_its_temperature() {
    // At 20 °C the rotation is that of the independent model: what it has at 0 °C is less by the change.
    let warm = TWIN
        .replace("rotation_deg = [0.4, -0.7, 0.25]", "rotation_deg = [0.2, -0.7, 0.45]\nrotation_per_k_deg = [0.01, 0.0, -0.01]");
    let run = Folder::of(&warm).run();
    let wanted = Truth::default().reading([1500.0 + 3.0, -5.0, 7.0]);
    let (_, reading) = run.samples(6.0, 7.0)[0];
    assert!((0..3).all(|i| (reading[i] - wanted[i]).abs() < 0.000_51), "{reading:?} {wanted:?}");
}

#[test]
fn a_step_is_followed_with_the_corner_of_the_component() {
    let run = Folder::of(TWIN).run();
    // From 0 to 1500 nT at 4 s: what is missing falls by exp(-2 pi f_3dB t).
    let after = run.samples(6.0, 7.0)[0].1;
    let before = run.samples(3.0, 4.0)[0].1;
    for (t, reading) in run.samples(4.0, 4.1) {
        for (i, corner) in [20.0, 25.0, 15.0].into_iter().enumerate() {
            let missing = (before[i] - after[i]) * (-std::f64::consts::TAU * corner * (t - 4.0)).exp();
            assert!((reading[i] - after[i] - missing).abs() < 0.0021, "{t} {i}");
        }
    }
}

#[test]
fn sines_have_amplitude_and_phase_of_the_response() {
    let folder = Folder::of(TWIN);
    folder.put(
        "STEPS.MAG",
        "MAG 1\nname = \"SINES\"\nkind = \"frequency\"\n@STEPS\nduration,bx,by,bz,frequency,position\n\
         6,0,0,1000,3.7,1\n6,0,0,1000,45.25,1\n@END\n",
    );
    let run = folder.run();
    let truth = Truth::default();
    let (a, zero) = (truth.response(), truth.reading([3.0, -5.0, 7.0]));
    for (t_start, frequency) in [(0.0, 3.7), (6.0, 45.25)] {
        for (t, reading) in run.samples(t_start + 0.5, t_start + 6.0) {
            for (i, corner) in [20.0, 25.0, 15.0].into_iter().enumerate() {
                let ratio: f64 = frequency / corner;
                let phase = std::f64::consts::TAU * frequency * (t - t_start) - ratio.atan();
                let wanted = zero[i] + a[i][2] * 1000.0 / (1.0 + ratio * ratio).sqrt() * phase.sin();
                assert!((reading[i] - wanted).abs() < 0.001, "{frequency} {t} {i}");
            }
        }
    }
}

#[test]
fn equal_seeds_give_equal_bytes_whatever_the_threads_and_other_seeds_do_not() {
    let noisy = TWIN.replace("white_ent = [0.0, 0.0, 0.0]", "white_ent = [0.3, 0.2, 0.4]\nflicker_ent = [0.05, 0.05, 0.05]");
    let twin = noisy.replace(
        "[[run]]",
        "[[run]]\nstart = \"2026-01-02T09:00:00Z\"\nprogramme = \"STEPS.MAG\"\nsensor = \"FGM\"\nmode = \"normal\"\n[[run]]",
    );
    let folder = Folder::of(&twin);
    let bytes = |out: &str, arguments: &[&str]| {
        assert!(folder.simulate(out, arguments).status.success());
        ["26-01-02/09-00-00.CCR", "26-01-02/10-00-00.CCR", "campaign.toml"]
            .map(|file| fs::read(folder.case.path().join(out).join(file)).unwrap())
    };
    let one = bytes("a", &["--threads", "1"]);
    assert_eq!(one, bytes("b", &["--threads", "2"]));
    assert_eq!(one, bytes("c", &["--seed", "7"]));
    let other = bytes("d", &["--seed", "8"]);
    assert!(one[0] != other[0] && one[1] != other[1]);
    // The runs share no noise.
    let tail = |bytes: &[u8]| text(bytes).lines().rev().nth(1).unwrap().to_owned();
    assert_ne!(tail(&one[0]), tail(&one[1]));
}

#[test]
fn noise_range_resolution_and_losses_are_as_asked_for() {
    let twin = TWIN
        .replace("white_ent = [0.0, 0.0, 0.0]", "white_ent = [0.3, 0.2, 0.4]")
        .replace("resolution_ent = 0.001", "resolution_ent = 0.25\npacket_samples = 16\npacket_loss = 0.05")
        .replace("range_ent = 4000.0", "range_ent = 1200.0");
    let run = Folder::of(&twin).run();
    let vectors = run.rows("@VECTORS");
    assert!(vectors.iter().flat_map(|row| &row[2..]).all(|v| v.abs() <= 1200.0 && (v * 4.0).fract() == 0.0));
    assert!(run.samples(5.0, 8.0).iter().all(|(_, r)| r[0] == 1200.0), "1500 nT is beyond the range");
    let quiet = run.samples(0.5, 4.0);
    for (i, std) in [0.3f64, 0.2, 0.4].into_iter().enumerate() {
        let mean = quiet.iter().map(|(_, r)| r[i]).sum::<f64>() / quiet.len() as f64;
        let variance = quiet.iter().map(|(_, r)| (r[i] - mean).powi(2)).sum::<f64>() / quiet.len() as f64;
        // Rounding adds a twelfth of the square of the resolution; 200 samples tell the variance within 10 %.
        assert!((variance / (std * std + 0.25 * 0.25 / 12.0) - 1.0).abs() < 0.4, "{i}: {variance}");
    }
    // 256 packets, 12.8 lost on average: gaps are whole packets.
    let lost: Vec<f64> = vectors.windows(2).map(|pair| pair[1][0] - pair[0][0] - 1.0).filter(|gap| *gap > 0.0).collect();
    assert!(lost.iter().all(|gap| gap % 16.0 == 0.0));
    let packets = lost.iter().sum::<f64>() / 16.0;
    assert!((3.0..30.0).contains(&packets), "{packets}");
}

#[test]
fn thermistors_follow_their_bodies_and_jump_when_told() {
    let twin = TWIN
        .replace(
            "start_degc = 20.0",
            "start_degc = 20.0\nsensor_time_constant_s = 60.0\n\
             phase = [{ from = \"2026-01-02T10:00:00Z\", target_degc = 80.0, rate_k_per_h = 360.0 }]",
        )
        .replace(
            "[[run]]",
            "[[temperatures.thermistor]]\nchannel = \"BOX\"\nof = \"box\"\noffset_k = 1.5\n\
             [[temperatures.thermistor]]\nchannel = \"BAD\"\nof = \"coil\"\n\
             jump = [{ from = \"2026-01-02T10:00:20Z\", until = \"2026-01-02T10:00:40Z\", by_k = [9.0, 18.0] }]\n[[run]]",
        );
    let run = Folder::of(&twin).run();
    let t = run.column("@TEMPERATURES", "t");
    for (t, value) in t.iter().zip(run.column("@TEMPERATURES", "BOX")) {
        assert!((value - (21.5 + 0.1 * t)).abs() < 0.001, "{t}: {value}");
    }
    // Temperatures are worked out every ten seconds.
    for (t, value) in t.iter().zip(run.column("@TEMPERATURES", "T59")).filter(|(t, _)| *t % 10.0 == 0.0) {
        let lagging = 20.0 + 0.1 * (t - 60.0 * (1.0 - (-t / 60.0).exp()));
        assert!((value - lagging).abs() < 0.002, "{t}: {value} {lagging}");
    }
    for (t, value) in t.iter().zip(run.column("@TEMPERATURES", "BAD")) {
        let jumped = (20.0..40.0).contains(t);
        assert!(if jumped { (26.0..=35.0).contains(&value) } else { value == 17.0 }, "{t}: {value}");
    }
}

#[test]
fn the_heater_makes_fields_in_pauses_only() {
    let heating = "phase = [{ from = \"2026-01-02T09:00:00Z\", target_degc = 150.0, rate_k_per_h = 60.0 }]\n\
                   heater = { field_nt = [0.0, 0.0, 400.0], longest_s = 2.0, delay_s = 1.0 }\n";
    let twin = |heater: &str| TWIN.replace("start_degc = 20.0\n", &format!("start_degc = 20.0\n{heater}")) + "pause_s = 5.0\n";
    let (with, without) = (Folder::of(&twin(heating)).run(), Folder::of(&twin("")).run());
    let z = |run: &Table, from: f64, to: f64| run.samples(from, to).iter().map(|(_, r)| r[2]).fold(f64::MIN, f64::max);
    for setting in with.rows("@FIELDS") {
        let [t_start, t_end, .., position] = setting[..] else { panic!() };
        let [a, b] = [&with, &without].map(|run| run.samples(t_start + 0.5, t_end));
        for ((_, a), (_, b)) in a.iter().zip(&b) {
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 0.002));
        }
        if position == 1.0 {
            // 400 nT along Z for two of the five seconds.
            assert!((z(&with, t_end + 1.2, t_end + 3.0) - z(&without, t_end + 1.2, t_end + 3.0) - 402.0).abs() < 1.0);
            assert!((z(&with, t_end + 3.5, t_end + 5.0) - z(&without, t_end + 3.5, t_end + 5.0)).abs() < 0.01);
        }
    }
}

#[test]
fn a_variation_of_the_external_field_leaks_in_and_the_variometer_shows_it() {
    let twin = TWIN.replace("[facility]", "[facility]\ndaily_nt = [1000.0, 0.0, 0.0]\nleakage = [0.5, 0.0, 0.0]");
    let run = Folder::of(&twin).run();
    let varx = run.column("@CHANNELS", "VARX");
    // 1000 nT cos(2 pi 10 h / 24 h) at 10:00.
    let expected = 1000.0 * (std::f64::consts::TAU * 10.0 / 24.0).cos();
    assert!((varx[0] - expected).abs() < 0.01, "{}", varx[0]);
    let wanted = Truth::default().reading([3.0 + 0.5 * expected, -5.0, 7.0]);
    let (_, reading) = run.samples(0.5, 1.0)[0];
    assert!((0..3).all(|i| (reading[i] - wanted[i]).abs() < 0.1), "{reading:?} {wanted:?}");
}

#[test]
fn scalar_runs_hold_the_modulus_of_the_real_field() {
    let folder = Folder::of(
        &TWIN.replace("[facility]", "[facility]\nscale_nt_per_eu = [0.9999, 1.0001, 1.0]\nangles_deg = [90.5, 90.0, 90.0]"),
    );
    folder.put(
        "STEPS.MAG",
        "MAG 1\nname = \"S\"\nkind = \"scalar\"\n@STEPS\nduration,bx,by,bz,frequency,position\n20,30000,40000,0,0,1\n@END\n",
    );
    let run = folder.run();
    let (x, y) = (30_000.0 * 0.9999, 40_000.0 * 1.0001);
    let angle = 90.5f64.to_radians();
    let field: [f64; 3] = [x + y * angle.cos() + 3.0, y * angle.sin() - 5.0, 7.0];
    let modulus = field.iter().map(|b| b * b).sum::<f64>().sqrt();
    assert_eq!(run.rows("@SCALAR").len(), 1);
    assert!((run.column("@SCALAR", "f")[0] - modulus).abs() < 0.006);
}

#[test]
fn mistakes_in_a_twin_are_named_with_their_place() {
    let cases: [(&str, &str, &[&str]); 12] = [
        ("response = \"first order\"", "response = \"third order\"", &["twin.toml:38", "third order", "is not a response"]),
        ("sigma_x = [0.98]\n", "", &["sensor.sigma_x", "missing"]),
        ("mode = \"normal\"\n[[run]]", "", &[]),
        ("of = \"sensor\"", "of = \"moon\"", &["moon", "is not a body"]),
        ("programme = \"STEPS.MAG\"", "programme = \"NONE.MAG\"", &["NONE.MAG"]),
        ("xi_xy = [89.8]", "xi_xy = [0.1]", &["26-01-02_10-00-00", "the sensor axes lie in one plane"]),
        ("sample_rate_hz = 64.0", "sample_rate_hz = -64.0", &["electronics.sample_rate_hz", "positive"]),
        ("start = \"2026-01-02T10:00:00Z\"", "start = \"noon\"", &["noon", "is not a date and time"]),
        ("start_degc = 20.0", "start_degc = \"warm\"", &["box.start_degc", "a finite number"]),
        ("id = 3", "id = 1", &["stands twice"]),
        ("rotation_deg = [0.4, -0.7, 0.25]", "rotation_deg = [0.4, -0.7]", &["rotation_deg", "three numbers"]),
        ("name = \"Twin\"", "name = \"Twin", &["twin.toml:4", "not a TOML key"]),
    ];
    for (old, new, words) in cases.into_iter().filter(|(.., words)| !words.is_empty()) {
        assert!(TWIN.contains(old), "{old}");
        Folder::of(&TWIN.replacen(old, new, 1)).refused(words);
    }
    let twice = TWIN.to_owned() + &TWIN[TWIN.find("[[run]]").unwrap()..];
    Folder::of(&twice).refused(&["two runs start at"]);
    // The last `sensor =` is that of the run.
    let unknown = TWIN.replace("\nsensor = \"FGM\"\n", "\nsensor = \"OTHER\"\n");
    Folder::of(&unknown).refused(&["OTHER", "[[sensor]]"]);
}

#[test]
fn an_unknown_key_is_a_warning_and_foreign_files_stay() {
    let folder = Folder::of(&TWIN.replace("[box]", "[box]\ncolour = 3"));
    let output = folder.simulate("campaign", &[]);
    assert!(output.status.success() && text(&output.stderr).contains("box.colour"), "{}", text(&output.stderr));
    // Its own files are replaced, a measured run is not.
    assert!(folder.simulate("campaign", &[]).status.success());
    let run = folder.case.path().join("campaign/26-01-02/10-00-00.CCR");
    fs::write(&run, "CCR 1\nrun = \"measured\"\n").unwrap();
    let output = folder.simulate("campaign", &[]);
    assert!(!output.status.success() && text(&output.stderr).contains("was not written by calfit"));
    assert!(fs::read_to_string(&run).unwrap().contains("measured"));
}

/// A campaign does not go among the results of another one, and a programme is no twin.
#[test]
fn a_folder_of_results_takes_no_campaign() {
    let folder = Folder::of(TWIN);
    let results = folder.case.path().join("results");
    fs::create_dir(&results).unwrap();
    fs::write(results.join("INDEX.json"), "{}").unwrap();
    let output = folder.simulate("results", &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("holds results of a campaign (INDEX.json)"), "{}", text(&output.stderr));
    assert_eq!(fs::read_dir(&results).unwrap().count(), 1);
    assert!(folder.simulate("results", &["--force"]).status.success());

    let output = calfit().arg("simulate").arg(folder.case.path().join("STEPS.MAG")).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("is a field programme (.MAG); `calfit simulate` takes a twin"),
        "{}",
        text(&output.stderr)
    );
}

#[test]
fn twins_are_checked_with_their_programmes() {
    let check = |path: &Path| {
        let output = calfit().arg("check").arg(path).output().unwrap();
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    };
    for name in ["demo.toml", "magnetsrode-2013.toml"] {
        let (status, said) = check(&config(name));
        assert!(status == Some(0) && !said.contains("warning"), "{said}");
    }
    let folder = Folder::of(&TWIN.replace("of = \"sensor\"", "of = \"moon\""));
    let (status, said) = check(&folder.case.path().join("twin.toml"));
    assert!(status != Some(0) && said.contains("moon"), "{said}");
}

fn config(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(name)
}

#[test]
fn the_twin_of_2013_has_every_run_and_every_printed_polynomial() {
    let twin: toml_edit::DocumentMut = fs::read_to_string(config("magnetsrode-2013.toml")).unwrap().parse().unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bepicolombo");
    let listed = fs::read_to_string(data.join("runs.csv")).unwrap();
    let listed: Vec<[String; 3]> = listed
        .lines()
        .skip(1)
        .map(|l| {
            let [date, time, config, sensor] = l.split(',').collect::<Vec<_>>()[..] else { panic!("{l}") };
            [format!("20{date}T{}Z", time.replace('-', ":")), config.to_owned(), sensor.to_owned()]
        })
        .collect();
    let runs = twin["run"].as_array_of_tables().unwrap();
    let runs: Vec<[String; 3]> =
        runs.iter().map(|r| ["start", "programme", "sensor"].map(|key| r[key].as_str().unwrap().to_owned())).collect();
    assert_eq!(runs.len(), 119);
    assert_eq!(runs, listed);

    let printed: toml_edit::DocumentMut = fs::read_to_string(data.join("thermal.toml")).unwrap().parse().unwrap();
    let files: Vec<&toml_edit::Table> = printed["file"].as_array_of_tables().unwrap().iter().collect();
    let sensors: Vec<&toml_edit::Table> = twin["sensor"].as_array_of_tables().unwrap().iter().collect();
    assert_eq!((sensors.len(), files.len()), (4, 12));
    let numbers =
        |item: &toml_edit::Item| -> Vec<f64> { item.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect() };
    // TPF, TOF and TAF of a sensor and mode follow each other in print, sensors and modes in the order of the twin.
    for (sensor, files) in sensors.iter().zip(files.chunks(3)) {
        let mut compared = 0;
        for file in files {
            for (name, item) in file.iter().filter(|(name, _)| name.starts_with(['s', 'x', 'f']) || name.starts_with("b_off")) {
                assert_eq!(numbers(&sensor[name]), numbers(item), "{} {name}", sensor["mode"]);
                compared += 1;
            }
        }
        assert_eq!(compared, 12);
        assert_eq!(sensor["real_sample_rate_hz"].as_float(), files[2]["mean_sample_rate_hz"].as_float());
    }
}

#[test]
fn a_measured_run_is_simulated_from_its_parameter_files() {
    // Calibrate a noisy run, simulate it from the calibration, calibrate that: the parameters are the same within their uncertainties.
    let linear = "MAG 1\nname = \"L\"\nkind = \"linearity\"\n@STEPS\nduration,bx,by,bz,frequency,position\n".to_owned();
    let steps = ["0,0,0", "1500,0,0", "-900,0,0", "0,-700,0", "0,1200,0", "0,0,-900", "0,0,1600", "0,0,0", "100,200,300"];
    let noisy = TWIN.replace("white_ent = [0.0, 0.0, 0.0]", "white_ent = [0.3, 0.2, 0.4]");
    let folder =
        Folder::of(&noisy.replace("resolution_ent = 0.001", "resolution_ent = 0.001\npacket_samples = 8\npacket_loss = 0.02"));
    folder.put("STEPS.MAG", &(linear + &steps.map(|s| format!("4,{s},0,1\n")).concat() + "@END\n"));
    folder.run();
    let path = |name: &str| folder.case.path().join(name);
    let run = |command: &str, arguments: &[&Path]| {
        let output = calfit().arg(command).args(arguments).arg("--no-plots").output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    };
    let (measured, simulated) = (path("campaign/26-01-02/10-00-00.CCR"), path("like/26-01-02/10-00-00.CCR"));
    let cpf = |out: &str| path(out).join("26-01-02_10-00-00/PARAMETER_LIN__26-01-02_10-00-00.CPF");
    run("lin", &[&measured, Path::new("-o"), &path("first")]);
    let arguments = [Path::new("--like"), &measured, Path::new("--parameters"), &cpf("first"), Path::new("-o"), &path("like")];
    run("simulate", &arguments);
    run("lin", &[&simulated, Path::new("-o"), &path("second")]);
    let (a, b) = (common::check::parameters(&cpf("first")), common::check::parameters(&cpf("second")));
    for i in 0..3 {
        for key in ["matrix.sigma", "offset.b_or_ent"] {
            let (at, std) = match key {
                "matrix.sigma" => (format!("{key}.{i}.{i}"), format!("std.sigma.{i}")),
                _ => (format!("{key}.{i}"), format!("std.b_or_ent.{i}")),
            };
            let number = common::check::number;
            let (difference, std) = (number(&a, &at) - number(&b, &at), number(&a, &std));
            assert!(difference != 0.0 && difference.abs() < 5.0 * std, "{at}: {difference} {std}");
        }
    }
    // Same counters, gaps included.
    let counters = |path: &Path| Table::read(path).column("@VECTORS", "n");
    assert_eq!(counters(&measured), counters(&simulated));
    assert!(counters(&measured).windows(2).any(|pair| pair[1] > pair[0] + 1.0));
    // Without files those of the run itself are taken.
    run("simulate", &[Path::new("--like"), &measured, Path::new("-o"), &path("alone")]);
    assert_eq!(fs::read(path("alone/26-01-02/10-00-00.CCR")).unwrap(), fs::read(&simulated).unwrap());
    // The folder of the measurement itself.
    let fails = |arguments: &[&Path], words: &str| {
        let output = calfit().args(["simulate", "--like"]).args(arguments).output().unwrap();
        assert!(!output.status.success() && text(&output.stderr).contains(words), "{}", text(&output.stderr));
    };
    let own = [&measured, Path::new("--parameters"), &cpf("first"), Path::new("-o"), &path("campaign")];
    fails(&own, "holds the measured run");
}
