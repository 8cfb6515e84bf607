//! The figures of a day of flight processing.

use super::parts::{SENSOR, STYLES, panels};
use super::{Band, Column, Figure, Marks, Panel, Scale, Series, Style};
use crate::data::flags::Flags;
use crate::fit::spectrum::Density;
use crate::model::polynomial::TemperaturePolynomial;
use std::collections::BTreeMap;

/// Columns of a picture.
pub const COLUMNS: usize = 1200;
/// A day is kept by the second: which part of it a picture shows is known only at its end.
const SECONDS: usize = 86_400;
const HOURS: &str = "time of the day, UTC";

/// Extents of a field over a day.
#[derive(Clone, Debug, Default)]
pub struct Extents {
    /// Lowest and highest value per second; infinite without values.
    seconds: Vec<[f64; 2]>,
}

const NOTHING: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

impl Extents {
    /// Takes a value at a share of the day, 0 to 1.
    pub fn take(&mut self, share: f64, value: f64) {
        if self.seconds.is_empty() {
            self.seconds = vec![NOTHING; SECONDS];
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a second of a day")]
        let at = (share * SECONDS as f64) as usize;
        if let Some([low, high]) = self.seconds.get_mut(at).filter(|_| value.is_finite()) {
            *low = low.min(value);
            *high = high.max(value);
        }
    }

    /// The seconds from the first to the last one with a value, joined to no more columns than a picture has.
    fn marks(&self) -> Vec<Column> {
        let is_there = |second: &[f64; 2]| second[0].is_finite();
        let Some((first, last)) = self.seconds.iter().position(is_there).zip(self.seconds.iter().rposition(is_there)) else {
            return Vec::new();
        };
        let width = (last + 1 - first).div_ceil(COLUMNS);
        let hours = |second: f64| second / 3600.0;
        let column = |(i, own): (usize, &[[f64; 2]])| {
            let [min, max] = own.iter().fold(NOTHING, |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
            let middle = (first + i * width) as f64 + 0.5 * own.len() as f64;
            min.is_finite().then_some(Column { x: hours(middle), min, max })
        };
        self.seconds[first..=last].chunks(width).enumerate().filter_map(column).collect()
    }
}

fn envelope(label: String, style: Style, extents: &Extents) -> Series {
    Series { label, style, marks: Marks::Envelope(extents.marks()) }
}

/// The field of a level over a day.
#[must_use]
pub fn field(level: &str, what: &str, sensor: &str, day: &str, frame: &str, extents: &[Extents; 3]) -> Figure {
    Figure {
        title: format!("Level {level}, {sensor}, {day}"),
        caption: format!(
            "{what}. Frame: {frame}. For every column of the picture, a second or a {COLUMNS}th of the time that is shown, the range of the vectors; where \
             several columns in a row hold none, it is empty. The standard uncertainty of every vector stands in the file of the level."
        ),
        x_label: HOURS.to_owned(),
        x_scale: Scale::TimeOfDay,
        panels: panels(|c| Panel {
            y_label: format!("B{}, nT", SENSOR[c]),
            y_scale: Scale::Linear,
            series: vec![envelope(format!("{} component", SENSOR[c]), STYLES[c], &extents[c])],
            bands: vec![],
        }),
    }
}

/// The temperature of a sensor over a day, with the range in which its calibration holds.
#[must_use]
pub fn temperature(sensor: &str, day: &str, extents: &Extents, valid_degc: [f64; 2]) -> Figure {
    let columns = extents.marks();
    let [low, high] = columns.iter().fold(NOTHING, |a, b| [a[0].min(b.min), a[1].max(b.max)]);
    // The range of the calibration is mostly far wider than a day, whose course would be a flat line in it.
    let margin = (0.25 * (high - low)).max(1.0);
    let [from, to] = valid_degc;
    let is_near = low <= high && low <= to && from <= high;
    let seen = if is_near { [from.max(low - margin).min(to), to.min(high + margin).max(from)] } else { valid_degc };
    Figure {
        title: format!("Sensor temperature, {sensor}, {day}"),
        caption: format!(
            "Temperature of the sensor; the light ground is the range in which the ground calibration holds, {from:.1} to {to:.1} °C, as far as the \
             temperature comes near it."
        ),
        x_label: HOURS.to_owned(),
        x_scale: Scale::TimeOfDay,
        panels: vec![Panel {
            y_label: "temperature, °C".to_owned(),
            y_scale: Scale::Linear,
            series: vec![envelope("temperature".to_owned(), Style::Single, extents)],
            bands: vec![Band { label: "calibrated".to_owned(), low: seen[0], high: seen[1] }],
        }],
    }
}

/// Difference of the means of both sensors over a day.
#[must_use]
pub fn difference(names: [&str; 2], day: &str, extents: &[Extents; 3]) -> Figure {
    let mut figure = field("D", "Difference of the means of both sensors", "", day, "spacecraft", extents);
    figure.title = format!("{} minus {}, level D, {day}", names[0], names[1]);
    figure.caption = format!(
        "Means of {} minus means of {} in axes of the spacecraft. What both sensors see alike is not in it: it shows fields of the \
         spacecraft, and what their calibrations disagree by.",
        names[0], names[1]
    );
    figure
}

/// What there is of a day in the columns of a picture: modes, flags.
#[derive(Clone, Debug, Default)]
pub struct Coverage {
    /// Columns with vectors of each mode, and with each flag.
    rows: [BTreeMap<usize, Vec<bool>>; 2],
    any: Vec<bool>,
}

impl Coverage {
    /// Takes a vector at a share of the day, 0 to 1: the index of its mode, and its flags.
    pub fn take(&mut self, share: f64, mode: usize, flags: Flags) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a column of a picture")]
        let at = (share * COLUMNS as f64) as usize;
        if at >= COLUMNS {
            return;
        }
        let empty = || vec![false; COLUMNS];
        self.any.resize(COLUMNS, false);
        self.any[at] = true;
        self.rows[0].entry(mode).or_insert_with(empty)[at] = true;
        for (index, _) in Flags::ALL.iter().enumerate().filter(|(_, (flag, _))| flags.any_of(*flag)) {
            self.rows[1].entry(index).or_insert_with(empty)[at] = true;
        }
    }

    /// The figure; `modes` are their names.
    #[must_use]
    pub fn figure(&self, sensor: &str, day: &str, modes: &[&str]) -> Figure {
        let [of_modes, of_flags] = &self.rows;
        let without: Vec<bool> = self.any.iter().map(|any| !any).collect();
        let mut bars: Vec<(String, Vec<(f64, f64)>)> = of_modes
            .iter()
            .map(|(index, columns)| (modes.get(*index).copied().unwrap_or("mode").to_owned(), spans(columns)))
            .collect();
        bars.push(("no vectors".to_owned(), spans(&without)));
        bars.extend(of_flags.iter().map(|(index, columns)| (Flags::ALL[*index].1.to_owned(), spans(columns))));
        Figure {
            title: format!("What there is of the day, {sensor}, {day}"),
            caption: "When there are vectors of each mode and when none, and when at least one vector of a column of the picture (72 s) has \
                      a flag: tables that do not cover the day, gaps, temperatures outside of the calibration."
                .to_owned(),
            x_label: HOURS.to_owned(),
            x_scale: Scale::TimeOfDay,
            panels: vec![Panel {
                y_label: String::new(),
                y_scale: Scale::Linear,
                series: vec![Series { label: String::new(), style: Style::X, marks: Marks::Bars(bars) }],
                bands: vec![],
            }],
        }
    }
}

/// Begins and ends of the runs of columns that are set, h.
fn spans(columns: &[bool]) -> Vec<(f64, f64)> {
    let width_h = 24.0 / COLUMNS as f64;
    let mut begin = 0;
    let runs = columns.chunk_by(|a, b| a == b).map(|run| {
        let own = (begin, begin + run.len(), run[0]);
        begin += run.len();
        own
    });
    runs.filter(|(.., set)| *set).map(|(from, to, _)| (from as f64 * width_h, to as f64 * width_h)).collect()
}

/// Amplitude densities before and after wheels and lines were taken off.
#[must_use]
pub fn spectra(sensor: &str, day: &str, mode: &str, before: &Density, after: &Density) -> Figure {
    let line = |density: &Density, c: usize| {
        let bins = density.power[c].iter().enumerate().skip(1);
        Marks::Line(bins.map(|(i, p)| (i as f64 * density.step_hz, p.sqrt())).collect())
    };
    Figure {
        title: format!("Level H, {sensor}, {mode}, {day}: wheels and lines"),
        caption: "Amplitude density before and after wheels and lines were taken off. What is above the noise before and not after was \
                  interference; what stands out after is left."
            .to_owned(),
        x_label: "frequency, Hz".to_owned(),
        x_scale: Scale::Linear,
        panels: panels(|c| Panel {
            y_label: format!("B{}, nT/√Hz", SENSOR[c]),
            y_scale: Scale::Logarithmic,
            series: vec![
                Series { label: "before".to_owned(), style: Style::Reference, marks: line(before, c) },
                Series { label: format!("{} after", SENSOR[c]), style: STYLES[c], marks: line(after, c) },
            ],
            bands: vec![],
        }),
    }
}

/// Height of a heater jump: hour of the day, field in nT, its standard uncertainty.
pub type Height = (f64, [f64; 3], [f64; 3]);

/// An edge whose uncertainty is so many times the usual one says nothing, and would hide all others.
const UNCERTAIN: f64 = 5.0;

/// Heights of heater jumps over a day with their uncertainty.
#[must_use]
pub fn jumps(sensor: &str, day: &str, classes: &[String], heights: &[Vec<Height>]) -> Figure {
    const OF_CLASS: [Style; 3] = [Style::Single, Style::Second, Style::Reference];
    let most: [f64; 3] = std::array::from_fn(|c| {
        let mut stds: Vec<f64> = heights.iter().flatten().map(|(_, _, std)| std[c]).collect();
        stds.sort_unstable_by(f64::total_cmp);
        UNCERTAIN * stds.get(stds.len() / 2).copied().unwrap_or(f64::INFINITY)
    });
    let drawn = |(_, _, std): &&Height| (0..3).all(|c| std[c] <= most[c]);
    let left_out = heights.iter().flatten().filter(|height| !drawn(height)).count();
    let not_drawn = match left_out {
        0 => String::new(),
        count => format!(" Not drawn: edges with {UNCERTAIN} times the usual uncertainty or more ({count})."),
    };
    Figure {
        title: format!("Heater jumps, level K, {sensor}, {day}"),
        caption: format!(
            "Field of a heater as every single edge shows it, with its uncertainty. Edges of one heater scatter about one value; what is \
             subtracted is the mean of all of them.{not_drawn}"
        ),
        x_label: HOURS.to_owned(),
        x_scale: Scale::TimeOfDay,
        panels: panels(|c| Panel {
            y_label: format!("B{}, nT", SENSOR[c]),
            y_scale: Scale::Linear,
            series: classes
                .iter()
                .zip(heights)
                .enumerate()
                .map(|(i, (name, list))| Series {
                    label: name.clone(),
                    style: OF_CLASS[i % OF_CLASS.len()],
                    marks: Marks::Points(list.iter().filter(drawn).map(|(hour, h, std)| (*hour, h[c], Some(std[c]))).collect()),
                })
                .collect(),
            bands: vec![],
        }),
    }
}

/// Calm minutes of a day over the temperature, with the polynomial of each component and its uncertainty.
#[must_use]
pub fn daily(sensor: &str, day: &str, points: &[(f64, [f64; 3])], polynomials: &[TemperaturePolynomial; 3]) -> Figure {
    const STEPS: usize = 200;
    let [low, high] = polynomials[0].valid_degc;
    let at: Vec<f64> = (0..=STEPS).map(|i| low + (high - low) * i as f64 / STEPS as f64).collect();
    Figure {
        title: format!("Daily offset model, {sensor}, {day}"),
        caption: "Means of calm minutes over the sensor temperature, and the polynomial through them with its standard uncertainty, in \
                  axes of the sensor. A level line says that the field does not follow the temperature more than slow noise does by itself."
            .to_owned(),
        x_label: "sensor temperature, °C".to_owned(),
        x_scale: Scale::Linear,
        panels: panels(|c| {
            let values: Vec<(f64, (f64, f64))> = at.iter().map(|t| (*t, polynomials[c].evaluate(*t))).collect();
            let band = values.iter().map(|(t, (v, std))| (*t, v - std, v + std)).collect();
            Panel {
                y_label: format!("B{}, nT", SENSOR[c]),
                y_scale: Scale::Linear,
                series: vec![
                    Series {
                        label: "calm minutes".to_owned(),
                        style: Style::Reference,
                        marks: Marks::Points(points.iter().map(|(t, field)| (*t, field[c], None)).collect()),
                    },
                    Series { label: "standard uncertainty".to_owned(), style: STYLES[c], marks: Marks::Ribbon(band) },
                    Series {
                        label: format!("{} of order {}", SENSOR[c], polynomials[c].order()),
                        style: STYLES[c],
                        marks: Marks::Line(values.iter().map(|(t, (v, _))| (*t, *v)).collect()),
                    },
                ],
                bands: vec![],
            }
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A day of 20 to 22 °C in a calibration from -70 to 70 °C fills its panel; where it comes near an end, the end is shown.
    #[test]
    fn the_range_of_the_calibration_does_not_flatten_the_course_of_a_day() {
        let mut extents = Extents::default();
        (0..86_400).for_each(|s| extents.take((f64::from(s) + 0.5) / 86_400.0, 20.0 + 2.0 * f64::from(s) / 86_400.0));
        let band = |valid_degc| {
            let figure = temperature("OB", "2015-07-02", &extents, valid_degc);
            let band = &figure.panels[0].bands[0];
            [band.low, band.high].map(|degc| (10.0 * degc).round() / 10.0)
        };
        assert_eq!(band([-70.0, 70.0]), [19.0, 23.0]);
        assert_eq!(band([-70.0, 21.5]), [19.0, 21.5]);
    }

    /// An hour with a gap of four minutes: its vectors are shown by threes of seconds, and no column stands in the gap.
    #[test]
    fn columns_are_those_of_the_time_with_vectors() {
        let mut extents = Extents::default();
        let seconds = (36_000..39_600).filter(|s| !(37_000..37_240).contains(s));
        seconds.clone().for_each(|s| extents.take((f64::from(s) + 0.5) / 86_400.0, f64::from(s % 10)));
        let columns = extents.marks();
        assert!(columns.len() <= COLUMNS && columns.len() > COLUMNS * 9 / 10, "{}", columns.len());
        let distance = |pair: &[Column]| (pair[1].x - pair[0].x) * 3600.0;
        let wide: Vec<f64> = columns.windows(2).map(distance).filter(|s| *s > 3.5).collect();
        // The columns beside the gap are whole or in part before and behind it.
        assert!(wide.len() == 1 && (wide[0] - 240.0).abs() < 6.0, "{wide:?}");
        assert!(columns.iter().all(|c| c.x > 10.0 && c.x < 11.0 && c.max - c.min <= 9.0));
        // A whole day is shown as before: by 72 s.
        let mut day = Extents::default();
        (0..86_400).for_each(|s| day.take((f64::from(s) + 0.5) / 86_400.0, 1.0));
        assert_eq!(day.marks().len(), COLUMNS);
        assert!(Extents::default().marks().is_empty());
    }
}
