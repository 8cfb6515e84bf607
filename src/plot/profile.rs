//! The complete temperature profile of a campaign (BC-MAG-TR-0085 section 14).

use super::{Figure, Marks, Panel, Scale, Series, Style};

/// Temperatures of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileRun {
    /// Start, s since 1970.
    pub start_s: f64,
    /// Sensor temperature, (s since the run's start, °C).
    pub sensor: Vec<(f64, f64)>,
    /// Coil-system temperature, (s since the run's start, °C).
    pub coil: Vec<(f64, f64)>,
}

/// Sensor and coil temperature of all runs in time order; `first` names the first run.
#[must_use]
pub fn figure(runs: &[ProfileRun], first: &str) -> Figure {
    let begin_s = runs.iter().map(|r| r.start_s).fold(f64::INFINITY, f64::min);
    let join = |get: fn(&ProfileRun) -> &Vec<(f64, f64)>| {
        let mut line = Vec::new();
        for run in runs {
            line.extend(get(run).iter().map(|(t, v)| ((run.start_s + t - begin_s) / 3600.0, *v)));
            // Nothing is known between two runs.
            line.push((f64::NAN, f64::NAN));
        }
        line
    };
    // A run of minutes is a dot in a campaign of days.
    let means = |get: fn(&ProfileRun) -> &Vec<(f64, f64)>| {
        let mean = |run: &ProfileRun| {
            let n = get(run).len() as f64;
            let (t, v) = get(run).iter().fold((0.0, 0.0), |(t, v), (a, b)| (t + a / n, v + b / n));
            (n > 0.0).then_some(((run.start_s + t - begin_s) / 3600.0, v, None))
        };
        runs.iter().filter_map(mean).collect()
    };
    let panel = |y_label: &str, style: Style, get: fn(&ProfileRun) -> &Vec<(f64, f64)>| Panel {
        y_label: y_label.to_owned(),
        y_scale: Scale::Linear,
        series: vec![
            Series { label: "during the runs".to_owned(), style, marks: Marks::Line(join(get)) },
            Series { label: "mean of a run".to_owned(), style, marks: Marks::Points(means(get)) },
        ],
        bands: vec![],
    };
    Figure {
        title: "Complete temperature profile".to_owned(),
        caption:
            "Temperatures recorded during the runs of the campaign; nothing is drawn between runs, where none were recorded."
                .to_owned(),
        x_label: format!("time since the start of run {first}, h"),
        x_scale: Scale::Linear,
        panels: vec![panel("sensor, °C", Style::Single, |r| &r.sensor), panel("coil system, °C", Style::Single, |r| &r.coil)],
    }
}
