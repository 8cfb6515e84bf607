//! What the figures of several analyses have in common.

use crate::data::start::Start;
use crate::record::conditions::Temperatures;

use super::{Figure, Marks, Panel, Scale, Series, Style};

/// A figure and the stem of its file name.
pub struct Named {
    /// `applied_fields`, for example.
    pub stem: &'static str,
    /// The figure.
    pub figure: Figure,
}

pub(super) const STYLES: [Style; 3] = [Style::X, Style::Y, Style::Z];
pub(super) const COIL: [&str; 3] = ["X", "Y", "Z"];
pub(super) const SENSOR: [&str; 3] = ["x", "y", "z"];

/// A time axis whose numbers stay small.
pub(super) struct TimeAxis {
    seconds: f64,
    pub(super) label: String,
}

impl TimeAxis {
    /// For a run that ends `end_s` seconds after its start.
    pub(super) fn of(end_s: f64, start: Option<&Start>) -> Self {
        let (seconds, unit) = match end_s {
            s if s > 4.0 * 3600.0 => (3600.0, "h"),
            s if s > 600.0 => (60.0, "min"),
            _ => (1.0, "s"),
        };
        let since = start.map_or_else(|| "the start of the run".to_owned(), Start::to_string);
        Self { seconds, label: format!("time since {since}, {unit}") }
    }

    pub(super) fn at(&self, t_s: f64) -> f64 {
        t_s / self.seconds
    }
}

/// One panel for each component.
pub(super) fn panels(make: impl Fn(usize) -> Panel) -> Vec<Panel> {
    (0..3).map(make).collect()
}

/// Coil-system and sensor temperature during a run; `what` says what the sensor temperature is for.
pub(super) fn temperatures(id: &str, temperatures: &Temperatures, time: &TimeAxis, what: &str) -> [Named; 2] {
    let conditions = temperatures.conditions.as_ref();
    let coil = conditions.map(|c| c.coil_channel.as_str());
    let sensor = conditions.map(|c| c.sensor_channel.as_str());
    let title = |of: &str| format!("{of} temperature, run {id}");
    [
        Named {
            stem: "coil_temperature",
            figure: temperature(&title("Coil system"), coil, &temperatures.coil, time, "the coil constants may follow it"),
        },
        Named { stem: "sensor_temperature", figure: temperature(&title("Sensor"), sensor, &temperatures.sensor, time, what) },
    ]
}

fn temperature(title: &str, channel: Option<&str>, series: &[(f64, f64)], time: &TimeAxis, what: &str) -> Figure {
    let points: Vec<(f64, f64)> = series.iter().map(|(t, v)| (time.at(*t), *v)).collect();
    Figure {
        title: title.to_owned(),
        caption: match channel {
            Some(channel) if !points.is_empty() => format!("Channel {channel} during the run; {what}."),
            _ => "The run brings no readings of this temperature.".to_owned(),
        },
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: vec![Panel {
            y_label: "temperature, °C".to_owned(),
            y_scale: Scale::Linear,
            series: vec![Series {
                label: channel.unwrap_or_default().to_owned(),
                style: Style::Single,
                marks: Marks::Line(points),
            }],
            bands: vec![],
        }],
    }
}
