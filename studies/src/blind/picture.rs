//! Pictures of the score: power against strength, and which name was given to which effect.

use super::report::{ALARMS, lottery_power};
use super::score::{STRENGTHS, Score};
use super::sensor::Kind;
use calfit::plot::{self, Figure, Marks, Panel, Scale, Series, Style};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, register_font};
use std::collections::BTreeSet;

/// Power against strength, all kinds together and the three most frequent ones.
///
/// # Errors
/// What drawing says.
pub fn power(score: &Score) -> Result<Vec<u8>, String> {
    let line = |label: &str, style: Style, share: &dyn Fn(u64) -> Option<super::score::Share>| {
        let points = STRENGTHS.iter().filter_map(|k| {
            let s = share((10.0 * k).round() as u64).filter(|s| s.of > 0)?;
            let p = s.hits as f64 / s.of as f64;
            Some((*k, s.percent(), Some(100.0 * (p * (1.0 - p) / s.of as f64).sqrt())))
        });
        Series { label: label.to_owned(), style, marks: Marks::Points(points.collect()) }
    };
    let of_kind = |kind: Kind| move |k: u64| score.found.get(&(kind, k)).copied();
    let series = vec![
        line("all", Style::Single, &|k| Some(score.found_at(k))),
        line("lin", Style::X, &of_kind(Kind::Lin)),
        line("sweep", Style::Y, &of_kind(Kind::Sweep)),
        line("zero-field", Style::Z, &of_kind(Kind::ZeroField)),
        Series {
            label: "by one who knows the lottery of the noise".to_owned(),
            style: Style::Reference,
            marks: Marks::Line(
                STRENGTHS.iter().filter_map(|k| Some((*k, lottery_power(score, *k, ALARMS)?.percent()))).collect(),
            ),
        },
    ];
    let figure = Figure {
        title: "Blind study: effects found against their strength".to_owned(),
        caption: "Part of the runs with one hidden effect in which something is named. Bars: one standard deviation. Line: what the same candidates reach in plateau means for one who knows the distribution from which the noise is drawn.".to_owned(),
        x_label: "strength k".to_owned(),
        x_scale: Scale::Logarithmic,
        panels: vec![Panel { y_label: "found, %".to_owned(), y_scale: Scale::Linear, series, bands: Vec::new() }],
    };
    plot::render(&figure).map_err(|e| e.to_string())
}

const FACE: &[u8] = include_bytes!("../../../src/plot/fonts/DejaVuSans.ttf");
const NAME: &str = "blind";
/// Pixels of a field, and of the names left of and above the fields.
const FIELD: i32 = 34;
const LEFT: i32 = 330;
const TOP: i32 = 330;
const EDGE: i32 = 30;

/// Truth in rows, first names in columns; the ground is the share of the row.
///
/// # Errors
/// What drawing says.
pub fn confusion(score: &Score) -> Result<Vec<u8>, String> {
    register_font(NAME, FontStyle::Normal, FACE).map_err(|_| "the typeface cannot be read".to_owned())?;
    let truths: Vec<&String> = score.confusion.keys().map(|(t, _)| t).collect::<BTreeSet<_>>().into_iter().collect();
    let mut names: BTreeSet<&String> = score.confusion.keys().map(|(_, n)| n).collect();
    names.extend(truths.iter().copied());
    let names: Vec<&String> = names.into_iter().collect();
    let (width, height) = (LEFT + FIELD * names.len() as i32 + EDGE, TOP + FIELD * truths.len() as i32 + EDGE);
    let mut pixels = vec![255; 3 * (width * height) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (width as u32, height as u32)).into_drawing_area();
        let say = |e: &dyn std::fmt::Display| e.to_string();
        area.fill(&WHITE).map_err(|e| say(&e))?;
        let text = |size: f64| (NAME, size).into_font().color(&RGBColor(26, 26, 26));
        let right = text(16.0).pos(Pos::new(HPos::Right, VPos::Center));
        let up = text(16.0).transform(FontTransform::Rotate270).pos(Pos::new(HPos::Left, VPos::Center));
        let centre = |ink: &RGBColor| (NAME, 12.0).into_font().color(ink).pos(Pos::new(HPos::Center, VPos::Center));
        let title = text(20.0).pos(Pos::new(HPos::Left, VPos::Top));
        area.draw_text("Truth (rows), first name (columns), % of the row", &title, (EDGE, EDGE / 2)).map_err(|e| say(&e))?;
        for (j, name) in names.iter().enumerate() {
            let at = (LEFT + FIELD * j as i32 + FIELD / 2, TOP - 8);
            area.draw_text(name, &up, at).map_err(|e| say(&e))?;
        }
        for (i, truth) in truths.iter().enumerate() {
            let y = TOP + FIELD * i as i32;
            area.draw_text(truth, &right, (LEFT - 8, y + FIELD / 2)).map_err(|e| say(&e))?;
            let count = |name: &String| score.confusion.get(&((*truth).clone(), name.clone())).copied().unwrap_or(0);
            let all: u64 = names.iter().map(|n| count(n)).sum();
            for (j, name) in names.iter().enumerate() {
                let x = LEFT + FIELD * j as i32;
                let part = count(name) as f64 / all.max(1) as f64;
                let fade = |to: f64| (255.0 - part.sqrt() * (255.0 - to)) as u8;
                let ground = if truth == name {
                    RGBColor(fade(0.0), fade(90.0), fade(160.0))
                } else {
                    RGBColor(fade(200.0), fade(60.0), fade(20.0))
                };
                let field = Rectangle::new([(x + 1, y + 1), (x + FIELD - 1, y + FIELD - 1)], ground.filled());
                area.draw(&field).map_err(|e| say(&e))?;
                if part >= 0.005 {
                    let ink = if part > 0.3 { WHITE } else { RGBColor(26, 26, 26) };
                    let at = (x + FIELD / 2, y + FIELD / 2);
                    area.draw_text(&format!("{:.0}", 100.0 * part), &centre(&ink), at).map_err(|e| say(&e))?;
                }
            }
        }
        area.present().map_err(|e| say(&e))?;
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(&pixels).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(bytes)
}
