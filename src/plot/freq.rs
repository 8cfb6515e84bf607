//! The figures of a frequency measurement (BC-MAG-TR-0085 figures 15 to 19).

use super::parts::{Named, SENSOR, STYLES, TimeAxis, temperatures};
use super::{Figure, Marks, Panel, Scale, Series, Style};
use crate::data::frequency::SineAmplitude;
use crate::data::units::with_uncertainty;
use crate::measure::corner::Component;
use crate::measure::freq::Freq;
use crate::model::response::Response;

/// Points of a model curve.
const CURVE: usize = 400;

/// All figures; a table of amplitudes has the response only.
#[must_use]
pub fn figures(freq: &Freq) -> Vec<Named> {
    let id = &freq.found.run.id;
    let mut list = Vec::new();
    let end_s = freq.stretches.iter().map(|s| s.setting.t_end_s).fold(0.0, f64::max);
    let time = TimeAxis::of(end_s, freq.found.run.start.as_ref());
    if !freq.stretches.is_empty() {
        list.push(Named { stem: "applied_frequencies", figure: applied(freq, id, &time) });
        list.push(Named { stem: "used_packets", figure: used(freq, id, &time) });
    }
    list.push(Named { stem: "frequency_response", figure: response(freq, id) });
    list.extend(near_corner(freq, id).map(|figure| Named { stem: "corner", figure }));
    if !freq.stretches.is_empty() {
        list.extend(temperatures(id, &freq.temperatures, &time, "the response holds for its mean"));
    }
    list
}

/// No join between this stretch and the next.
const BREAK: (f64, f64, f64) = (f64::NAN, f64::NAN, f64::NAN);

fn applied(freq: &Freq, id: &str, time: &TimeAxis) -> Figure {
    let steps = freq.stretches.iter().map(|s| (time.at(s.setting.t_start_s), time.at(s.setting.t_end_s), s.setting.frequency_hz));
    Figure {
        title: format!("Applied frequencies, run {id}"),
        caption: "Frequency of the sine by the facility clock, one after the other.".to_owned(),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: vec![Panel {
            y_label: "frequency, Hz".to_owned(),
            y_scale: Scale::Logarithmic,
            series: vec![Series { label: String::new(), style: Style::Single, marks: Marks::Steps(steps.collect()) }],
            bands: vec![],
        }],
    }
}

fn used(freq: &Freq, id: &str, time: &TimeAxis) -> Figure {
    let mut inside = Vec::new();
    let mut outside = Vec::new();
    for s in &freq.stretches {
        let f = s.setting.frequency_hz;
        let mut leave = |from: f64, to: f64| outside.extend([(time.at(from), time.at(to), f), BREAK]);
        match s.used_s {
            Some([from, to]) => {
                leave(s.setting.t_start_s, from);
                leave(to, s.setting.t_end_s);
                inside.extend([(time.at(from), time.at(to), f), BREAK]);
            }
            None => leave(s.setting.t_start_s, s.setting.t_end_s),
        }
    }
    let count = freq.stretches.iter().filter(|s| s.used_s.is_some()).count();
    Figure {
        title: format!("Used packets of measured data, run {id}"),
        caption: format!(
            "Part of every setting that was used: settled, undamaged, whole periods where that costs little. {count} of {} frequencies are used.",
            freq.stretches.len()
        ),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: vec![Panel {
            y_label: "frequency, Hz".to_owned(),
            y_scale: Scale::Logarithmic,
            series: vec![
                Series { label: "used".to_owned(), style: Style::X, marks: Marks::Steps(inside) },
                Series { label: "left out".to_owned(), style: Style::Reference, marks: Marks::Steps(outside) },
            ],
            bands: vec![],
        }],
    }
}

/// Ratio of an amplitude at the -3 dB frequency to that at no frequency.
const HALF_POWER: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// The line of -3 dB over a range of frequencies.
fn half_power(range_hz: [f64; 2]) -> Series {
    let level = 20.0 * HALF_POWER.log10();
    Series { label: "-3 dB".to_owned(), style: Style::Reference, marks: Marks::Line(range_hz.map(|f| (f, level)).to_vec()) }
}

/// The -3 dB frequencies of the fitted model, in words.
fn corners(freq: &Freq) -> Vec<String> {
    let p = &freq.values;
    let known = (0..3).filter(|i| p.f_3db_model_hz[*i].is_finite());
    known
        .map(|i| {
            format!("{} {} Hz", SENSOR[i], with_uncertainty(p.f_3db_model_hz[i], p.f_3db_model_std_hz[i]).trim_start_matches('+'))
        })
        .collect()
}

/// The stretch of the response in which it falls to -3 dB, in parts of the DC gain; `None` without a model.
fn near_corner(freq: &Freq, id: &str) -> Option<Figure> {
    /// From and to these parts of the lowest and the highest -3 dB frequency.
    const AROUND: [f64; 2] = [0.4, 1.6];
    let shape = freq.corner.model.and_then(Response::named)?;
    let f_3db = freq.values.f_3db_model_hz;
    let found = || f_3db.iter().copied().filter(|f| f.is_finite() && *f > 0.0);
    let (low, high) = (AROUND[0] * found().fold(f64::INFINITY, f64::min), AROUND[1] * found().fold(0.0, f64::max));
    let inside = |f: f64| (low..=high).contains(&f);
    let panel = |(i, component): (usize, &Component)| {
        let model = component.model.as_ref()?;
        let parameters: Vec<f64> = model.parameters.iter().map(|p| p.value).collect();
        let curve = (0..CURVE).map(|k| low + (high - low) * k as f64 / (CURVE - 1) as f64);
        let used = freq.amplitude.iter().filter(|a| a.detected[i] && a.weight[i] >= 0.5 && inside(a.frequency_hz));
        let point = |a: &SineAmplitude| {
            let std = a.b_std_ent[i] / model.dc_ent;
            (a.frequency_hz, a.b_ent[i] / model.dc_ent, std.is_finite().then_some(std))
        };
        let line = [low, high].map(|f| (f, HALF_POWER)).to_vec();
        let series = |label: &str, style: Style, marks: Marks| Series { label: label.to_owned(), style, marks };
        Some(Panel {
            y_label: format!("{}, part of DC", SENSOR[i]),
            y_scale: Scale::Linear,
            series: vec![
                series("-3 dB", Style::Reference, Marks::Line(line)),
                series(
                    &format!("{} model", SENSOR[i]),
                    STYLES[i],
                    Marks::Line(curve.map(|f| (f, shape.value(f, &parameters))).collect()),
                ),
                series(&format!("{} amplitude", SENSOR[i]), STYLES[i], Marks::Points(used.map(point).collect())),
                series("-3 dB frequency", Style::Single, Marks::Points(vec![(f_3db[i], HALF_POWER, None)])),
            ],
            bands: vec![],
        })
    };
    let panels: Vec<Panel> = freq.corner.components.iter().enumerate().filter_map(panel).collect();
    (!panels.is_empty() && low < high).then(|| Figure {
        title: format!("Response near the -3 dB frequency, run {id}"),
        caption: format!(
            "Amplitudes as part of the DC gain of the fitted model ({}), its curve, and where it falls to 1/√2: {}.",
            freq.corner.model.unwrap_or("none"),
            corners(freq).join(", ")
        ),
        x_label: "applied frequency, Hz".to_owned(),
        x_scale: Scale::Linear,
        panels,
    })
}

fn response(freq: &Freq, id: &str) -> Figure {
    let p = freq;
    let db = |ratio: f64| 20.0 * ratio.log10();
    let known: Vec<f64> = p.amplitude.iter().map(|a| a.frequency_hz).filter(|f| *f > 0.0).collect();
    let low = known.iter().copied().fold(f64::INFINITY, f64::min);
    let high = known.iter().copied().fold(0.0, f64::max);
    let mut levels = Vec::new();
    let mut residuals = Vec::new();
    // Curves go a little below the lowest amplitude.
    let detected = p.amplitude.iter().flat_map(|a| (0..3).filter(|i| a.detected[*i]).map(|i| a.b_ent[i]));
    let lowest = detected.filter(|b| *b > 0.0).fold(f64::INFINITY, f64::min);
    for (i, component) in freq.corner.components.iter().enumerate() {
        let largest = p.amplitude.iter().map(|a| a.b_ent[i]).filter(|b| b.is_finite()).fold(0.0, f64::max);
        let gain = component.model.as_ref().map_or(largest, |m| m.dc_ent);
        let (used, rest): (Vec<usize>, Vec<usize>) = (0..p.amplitude.len())
            .filter(|row| p.amplitude[*row].detected[i])
            .partition(|row| p.amplitude[*row].weight[i] >= 0.5);
        let point = |row: &usize| {
            let a = &p.amplitude[*row];
            // In decibels an uncertainty is a part of the amplitude.
            let std = a.b_std_ent[i];
            (a.frequency_hz, db(a.b_ent[i] / gain), std.is_finite().then(|| db(1.0 + std / a.b_ent[i])))
        };
        let plain = |row: &usize| {
            let (f, level, _) = point(row);
            (f, level)
        };
        levels.push(Series {
            label: format!("{} amplitude", SENSOR[i]),
            style: STYLES[i],
            marks: Marks::Points(used.iter().map(point).collect()),
        });
        if !rest.is_empty() {
            levels.push(Series {
                label: format!("{} not used", SENSOR[i]),
                style: STYLES[i],
                marks: Marks::Rejected(rest.iter().map(plain).collect()),
            });
        }
        if let (Some(model), Some(shape)) = (&component.model, freq.corner.model.and_then(Response::named)) {
            let parameters: Vec<f64> = model.parameters.iter().map(|p| p.value).collect();
            let curve = (0..CURVE).map(|k| {
                let f = low * (high / low).powf(k as f64 / (CURVE - 1) as f64);
                // At the bottom of a notch there is no logarithm.
                (f, db(shape.value(f, &parameters).max((0.3 * lowest / gain).clamp(1e-12, 1e-4))))
            });
            levels.push(Series { label: format!("{} model", SENSOR[i]), style: STYLES[i], marks: Marks::Line(curve.collect()) });
            let left = |row: &usize| {
                let a = &p.amplitude[*row];
                let std = a.b_std_ent[i];
                (a.frequency_hz, 100.0 * model.residual_ent[*row] / gain, std.is_finite().then(|| 100.0 * std / gain))
            };
            residuals.push(Series {
                label: format!("{} residual", SENSOR[i]),
                style: STYLES[i],
                marks: Marks::Points(used.iter().map(left).collect()),
            });
        }
    }
    if known.len() > 1 {
        levels.push(half_power([low, high]));
    }
    let nyquist = p.values.mean_f_s_hz.map(|f_s| 0.5 * f_s).filter(|half| (low..=high).contains(half));
    if let (Some(half), true) = (nyquist, lowest.is_finite()) {
        let largest = p.amplitude.iter().flat_map(|a| a.b_ent).filter(|b| b.is_finite()).fold(0.0, f64::max);
        // Points of a line of so many have no marks of their own.
        let line = (0..CURVE).map(|k| (half, db(lowest / largest) * k as f64 / (CURVE - 1) as f64)).collect();
        levels.push(Series { label: "half of f_s".to_owned(), style: Style::Single, marks: Marks::Line(line) });
    }
    let corners = corners(freq);
    let caption = if corners.is_empty() {
        "Amplitudes relative to the largest one. No response model fits.".to_owned()
    } else {
        format!(
            "Amplitudes relative to the DC gain of the fitted model ({}), and what it leaves. The curve has {CURVE} points, so that narrow notches \
             are deeper than they are drawn. -3 dB: {}.",
            p.corner.model.unwrap_or("none"),
            corners.join(", ")
        )
    };
    let mut panels = vec![Panel { y_label: "level, dB".to_owned(), y_scale: Scale::Linear, series: levels, bands: vec![] }];
    if !residuals.is_empty() {
        panels.push(Panel { y_label: "residual, % of DC".to_owned(), y_scale: Scale::Linear, series: residuals, bands: vec![] });
    }
    Figure {
        title: format!("Frequency response, run {id}"),
        caption,
        x_label: "applied frequency, Hz".to_owned(),
        x_scale: Scale::Logarithmic,
        panels,
    }
}
