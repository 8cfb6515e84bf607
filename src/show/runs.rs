//! The run list of a campaign, as in BC-MAG-TR-0085 section 3.3.

use super::document::{Cell, Table, cells};
use super::or_not_stated;
use crate::data::run::Run;
use crate::data::start::Start;
use crate::data::units::counted;
use serde::Serialize;

/// Smallest, mean and largest value of a temperature channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TemperatureRange {
    /// Channel.
    pub channel: String,
    /// Smallest, mean, largest, °C.
    pub degc: [f64; 3],
}

/// One line of the list.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunLine {
    /// File inside the campaign.
    pub file: String,
    /// Run id.
    pub run: String,
    /// Start, UTC.
    pub start: Start,
    /// Kind.
    pub kind: crate::data::run::Kind,
    /// Field programme.
    pub configuration: String,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Settings, or plateau means where the file brings those.
    pub settings: usize,
    /// Samples.
    pub vectors: u64,
    /// Samples lost.
    pub lost: u64,
    /// Gaps.
    pub gaps: u64,
    /// Sample rate measured from counter and time tags, Hz.
    pub measured_rate_hz: Option<f64>,
    /// Duration, s.
    pub duration_s: f64,
    /// Temperatures.
    pub temperatures: Vec<TemperatureRange>,
    /// Size, bytes.
    pub size_bytes: u64,
    /// SHA-256.
    pub sha256: String,
}

impl RunLine {
    /// What there is to say about a run.
    #[must_use]
    pub fn of(run: &Run) -> Self {
        let temperatures = run
            .temperatures
            .names
            .iter()
            .filter_map(|channel| {
                let values: Vec<f64> = run.temperatures.channel(channel)?.into_iter().map(|(_, v)| v).collect();
                let low = values.iter().copied().fold(f64::INFINITY, f64::min);
                let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                (!values.is_empty()).then(|| TemperatureRange { channel: channel.clone(), degc: [low, mean, high] })
            })
            .collect();
        Self {
            file: run.input.path.clone(),
            run: run.header.run.clone(),
            start: run.header.start.clone(),
            kind: run.header.kind,
            configuration: run.header.configuration.clone(),
            sensor: run.header.sensor.clone(),
            mode: run.header.mode.clone(),
            settings: run.settings.len().max(run.blocks.len()).max(run.scalar.len()),
            vectors: run.vectors.count,
            lost: run.vectors.lost,
            gaps: run.vectors.gap_count,
            measured_rate_hz: run.vectors.measured_rate_hz,
            duration_s: run.duration_s(),
            temperatures,
            size_bytes: run.input.size_bytes,
            sha256: run.input.sha256.clone(),
        }
    }
}

/// The list as a table.
#[must_use]
pub fn run_list(lines: &[RunLine]) -> Table {
    let head = [
        "file",
        "configuration",
        "kind",
        "sensor",
        "mode",
        "settings",
        "vectors",
        "lost",
        "rate, Hz",
        "duration",
        "temperatures, °C",
    ];
    let mut table = Table::new(head);
    for l in lines {
        let temperatures: Vec<String> = l
            .temperatures
            .iter()
            .map(|t| {
                let [low, _, high] = t.degc;
                if format!("{low:.1}") == format!("{high:.1}") {
                    format!("{} {low:.1}", t.channel)
                } else {
                    format!("{} {low:.1}..{high:.1}", t.channel)
                }
            })
            .collect();
        table.push(cells![
            &l.file,
            or_not_stated(&l.configuration),
            l.kind.to_string(),
            or_not_stated(&l.sensor),
            or_not_stated(&l.mode),
            l.settings,
            l.vectors,
            if l.lost == 0 { l.lost.into() } else { Cell::from(format!("{} in {}", l.lost, counted(l.gaps, "gap"))) },
            l.measured_rate_hz.map_or(Cell::Missing("-"), |r| Cell::fixed(r, 4)),
            duration(l.duration_s),
            if temperatures.is_empty() { "-".to_owned() } else { temperatures.join(", ") },
        ]);
    }
    table
}

/// A duration as people write it.
pub(super) fn duration(seconds: f64) -> String {
    let total = seconds.round();
    let (hours, minutes) = ((total / 3600.0).floor(), (total / 60.0).floor() % 60.0);
    if hours > 0.0 { format!("{hours:.0} h {minutes:02.0} min") } else { format!("{minutes:.0} min {:02.0} s", total % 60.0) }
}
