//! Small runs of every kind, without damage: those of the demonstration with short programmes.

use super::text::{Section, Text};
use crate::repository;
use calfit::files::twin;
use calfit::simulate::write_campaign;
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write;
use std::path::Path;

/// A kind of input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Linearity,
    /// With the means of the settings in place of the samples.
    Means,
    /// While the temperature moves.
    Moving,
    Sweep,
    Offset,
    Sines,
    /// A table of amplitudes.
    Amplitudes,
    ZeroField,
    Scalar,
    /// A table of means that is imported first.
    Imported,
    /// Readings to which a calibration is applied.
    Applied,
}

impl Kind {
    pub const ALL: [Kind; 11] = [
        Kind::Linearity,
        Kind::Means,
        Kind::Moving,
        Kind::Sweep,
        Kind::Offset,
        Kind::Sines,
        Kind::Amplitudes,
        Kind::ZeroField,
        Kind::Scalar,
        Kind::Imported,
        Kind::Applied,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Kind::Linearity => "linearity",
            Kind::Means => "means",
            Kind::Moving => "moving",
            Kind::Sweep => "sweep",
            Kind::Offset => "offset",
            Kind::Sines => "sines",
            Kind::Amplitudes => "amplitudes",
            Kind::ZeroField => "zero field",
            Kind::Scalar => "scalar",
            Kind::Imported => "import",
            Kind::Applied => "apply",
        }
    }

    /// Command of the analysis.
    pub fn command(self) -> &'static [&'static str] {
        match self {
            Kind::Linearity | Kind::Means | Kind::Moving | Kind::Imported => &["lin"],
            Kind::Applied => &["apply"],
            Kind::Sweep => &["thermal"],
            Kind::Offset => &["offset"],
            Kind::Sines => &["freq"],
            Kind::Amplitudes => &["freq", "--amplitudes"],
            Kind::ZeroField => &["null"],
            Kind::Scalar => &["coil", "scalar"],
        }
    }
}

/// Begin of the runs in the twin, programme, and what else it says of them.
const RUNS: [(Kind, &str, &str, &str); 7] = [
    (Kind::Scalar, "2026-03-02T07:00:00Z", "SCALAR_83.MAG", ""),
    (Kind::Linearity, "2026-03-02T08:00:00Z", "LIN.MAG", "sample_rate_hz = 32.0\n"),
    (Kind::Offset, "2026-03-02T08:31:00Z", "OFFSET.MAG", "sample_rate_hz = 32.0\n"),
    (Kind::Sines, "2026-03-02T08:46:00Z", "FREQ.MAG", "position = 5\n"),
    (Kind::Moving, "2026-03-02T15:50:00Z", "LIN.MAG", "sample_rate_hz = 32.0\n"),
    (Kind::ZeroField, "2026-03-03T06:30:00Z", "NULL.MAG", "sample_rate_hz = 4.0\n"),
    (Kind::Sweep, "2026-03-03T16:00:00Z", "SWEEP.MAG", "sample_rate_hz = 4.0\n"),
];

/// The runs without damage, and the campaign file that they need.
pub struct Undamaged {
    pub campaign: String,
    pub runs: BTreeMap<Kind, Text>,
}

/// Simulates them.
///
/// # Errors
/// The twin cannot be read or simulated.
pub fn undamaged() -> Result<Undamaged, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let demo = std::fs::read_to_string(repository("configs/demo.toml"))?;
    let Some((head, _)) = demo.split_once("[[run]]") else { return Err("the twin has no run".into()) };
    // The sweep is over in half an hour, and the moving run sees some kelvin.
    let mut twin = head
        .replace("rate_k_per_h = 20.0", "rate_k_per_h = 300.0")
        .replace("time_constant_h = 4.0", "rate_k_per_h = 120.0")
        .replace("interval_s = 20.0", "interval_s = 4.0");
    for (_, start, programme, rest) in RUNS {
        let _ = write!(
            twin,
            "\n[[run]]\nstart = \"{start}\"\nprogramme = \"{programme}\"\nsensor = \"FGM\"\nmode = \"science\"\n{rest}"
        );
    }
    let twins = folder.path().join("twin");
    std::fs::create_dir(&twins)?;
    std::fs::write(twins.join("twin.toml"), twin)?;
    std::fs::copy(repository("configs/SCALAR_83.MAG"), twins.join("SCALAR_83.MAG"))?;
    for (name, kind, steps) in programmes() {
        let rows: String = steps.iter().map(|(s, [x, y, z], f, p)| format!("{s},{x:.2},{y:.2},{z:.2},{f},{p}\n")).collect();
        let text =
            format!("MAG 1\nname = \"{name}\"\nkind = \"{kind}\"\n@STEPS\nduration,bx,by,bz,frequency,position\n{rows}@END\n");
        std::fs::write(twins.join(name), text)?;
    }
    let twin = twin::read(&twins.join("twin.toml"), &mut Vec::new()).map_err(|e| e.to_string())?;
    let out = folder.path().join("campaign");
    write_campaign(&twin, 1, &out, false, || ()).map_err(|e| e.to_string())?;
    let mut runs = BTreeMap::new();
    for (kind, start, ..) in RUNS {
        runs.insert(kind, Text::of(&std::fs::read_to_string(out.join(file(start)))?));
    }
    let means = means(&runs[&Kind::Linearity]);
    for kind in [Kind::Means, Kind::Imported, Kind::Applied] {
        runs.insert(kind, means.clone());
    }
    runs.insert(Kind::Amplitudes, amplitudes());
    Ok(Undamaged { campaign: std::fs::read_to_string(out.join("campaign.toml"))?, runs })
}

/// `2026-03-02T08:00:00Z` is in `26-03-02/08-00-00.CCR`.
fn file(start: &str) -> String {
    let (day, time) = start.trim_start_matches("20").trim_end_matches('Z').split_once('T').unwrap_or((start, ""));
    format!("{day}/{}.CCR", time.replace(':', "-"))
}

type Step = (f64, [f64; 3], f64, u32);

fn programmes() -> Vec<(&'static str, &'static str, Vec<Step>)> {
    // Up and down again on every axis, so that one moment in time is no level of the field.
    let levels = [-2000.0, -1200.0, -400.0, 400.0, 1200.0, 2000.0, 1600.0, 800.0, -800.0, -1600.0];
    let along = |axis: usize, level: f64| std::array::from_fn(|i| if i == axis { level } else { 0.0 });
    let mut linearity = vec![(4.0, [0.0; 3], 0.0, 1)];
    for axis in 0..3 {
        linearity.extend(levels.iter().map(|level| (4.0, along(axis, *level), 0.0, 1)));
        linearity.push((4.0, [0.0; 3], 0.0, 1));
    }
    let mut offset = Vec::new();
    for position in 1..=4 {
        offset.push((6.0, [0.0; 3], 0.0, position));
        for axis in 0..3 {
            offset.extend([200.0, -200.0].map(|level| (6.0, along(axis, level), 0.0, position)));
        }
        offset.push((6.0, [0.0; 3], 0.0, position));
    }
    let sines = [0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 16.0, 25.0, 32.0, 40.0, 50.0, 56.0, 61.0, 70.0, 80.0, 90.0]
        .map(|f: f64| (12.0, [0.0, 1000.0, 0.0], f, 1))
        .to_vec();
    let direction = |k: u32| {
        let (z, turn) = (1.0 - (2.0 * f64::from(k * 37 % 120) + 1.0) / 120.0, 2.4 * f64::from(k));
        let aside: f64 = (1.0 - z * z).sqrt();
        (12.0, [2000.0 * aside * turn.cos(), 2000.0 * aside * turn.sin(), 2000.0 * z], 0.0, 1)
    };
    vec![
        ("LIN.MAG", "linearity", linearity),
        ("OFFSET.MAG", "offset", offset),
        ("FREQ.MAG", "frequency", sines),
        ("NULL.MAG", "zero-field", vec![(3600.0, [0.0; 3], 0.0, 1)]),
        ("SWEEP.MAG", "sweep", (0..120).map(direction).collect()),
    ]
}

/// The same run with the means of its settings in place of the samples.
fn means(run: &Text) -> Text {
    let mut run = run.clone();
    let vectors = run.section("VECTORS").map(|s| s.rows.clone()).unwrap_or_default();
    let samples: Vec<[f64; 4]> = vectors.iter().map(|r| std::array::from_fn(|i| r[i + 1].parse().unwrap_or(f64::NAN))).collect();
    let fields = run.section("FIELDS").map(|s| s.rows.clone()).unwrap_or_default();
    let columns = ["t_start", "t_end", "bx", "by", "bz", "position", "x", "y", "z", "sx", "sy", "sz", "count"];
    let rows = fields.iter().map(|row| {
        let [begin, end] = [0, 1].map(|i| row[i].parse::<f64>().unwrap_or(f64::NAN));
        // The edges are left out as the analysis of samples does.
        let own: Vec<&[f64; 4]> = samples.iter().filter(|s| s[0] > begin + 0.3 && s[0] < end - 0.1).collect();
        let count = own.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|i| own.iter().map(|s| s[i + 1]).sum::<f64>() / count);
        let std: [f64; 3] =
            std::array::from_fn(|i| (own.iter().map(|s| (s[i + 1] - mean[i]).powi(2)).sum::<f64>() / (count - 1.0)).sqrt());
        let mut cells: Vec<String> = [0, 1, 2, 3, 4, 6].map(|i| row[i].clone()).to_vec();
        cells.extend(mean.iter().chain(&std).map(|v| format!("{v:.5}")));
        cells.push(format!("{count}"));
        cells
    });
    let blocks = Section { name: "BLOCKS".to_owned(), columns: columns.map(str::to_owned).to_vec(), rows: rows.collect() };
    run.sections.retain(|s| s.name != "FIELDS" && s.name != "VECTORS");
    run.sections.insert(0, blocks);
    run
}

/// Amplitudes of a sensor of first order with a corner at 57 Hz, every one off by its own noise.
fn amplitudes() -> Text {
    let rows = (0..24).map(|k| {
        let frequency = 0.5 * 1.28_f64.powi(k);
        let noise = |i: i32| 0.02 * f64::from((7 * k + 13 * i) % 11 - 5) / 5.0;
        let cells =
            [0, 1, 2].map(|i| format!("{:.4}", 1000.0 / (1.0 + (frequency / f64::from(57 + i)).powi(2)).sqrt() + noise(i)));
        std::iter::once(format!("{frequency:.6}")).chain(cells).chain([0.02; 3].map(|s| s.to_string())).collect()
    });
    let columns = ["frequency_hz", "bx_ent", "by_ent", "bz_ent", "bx_std_ent", "by_std_ent", "bz_std_ent"];
    let table = Section { name: "TABLE".to_owned(), columns: columns.map(str::to_owned).to_vec(), rows: rows.collect() };
    Text::plain(table)
}

/// Writes a run, or a table, into a campaign; its path.
///
/// # Errors
/// It cannot be written.
pub fn write(kind: Kind, text: &Text, campaign: &str, folder: &Path) -> Result<std::path::PathBuf, Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("campaign.toml"), campaign)?;
    let start =
        RUNS.iter().find(|(k, ..)| *k == kind || (kind == Kind::Means && *k == Kind::Linearity)).map(|(_, start, ..)| *start);
    let (path, content) = match start {
        Some(start) => (folder.join(file(start)), text.text()),
        None => (folder.join("amplitudes.csv"), text.csv()),
    };
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent)?;
    }
    std::fs::write(&path, content)?;
    Ok(path)
}
