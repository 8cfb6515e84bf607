//! The embedded typeface as small coverage pictures.
//!
//! plotters rasterises the glyphs but drops their side bearings and sets them on whole pixels,
//! which gives uneven words, and does so anew for every string. Here each glyph is rasterised
//! once, at four times its size, and kept for each quarter-pixel position it is used at; its
//! metrics come from the font file.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use plotters::style::{FontDesc, FontFamily, FontStyle, register_font};

const FILE: &[u8] = include_bytes!("fonts/DejaVuSans.ttf");
const NAME: &str = "calfit";

/// Height of a line, ascender to descender, in font units: what plotters calls the font size.
const LINE_UNITS: f64 = 2384.0;

/// Positions per pixel, along the line, at which glyphs are kept.
const FINE: i32 = 4;

/// Steps of opacity. Few, so that a figure keeps within an indexed palette.
pub(super) const LEVELS: u8 = 15;

/// Opacity of a glyph on the pixels around its origin on the baseline.
#[derive(Default)]
pub(super) struct Glyph {
    pub left: i32,
    pub top: i32,
    pub width: usize,
    pub levels: Vec<u8>,
}

#[derive(Clone, Copy, Default)]
struct Metric {
    advance: f64,
    bearing: f64,
}

pub(super) struct Typeface {
    font: FontDesc<'static>,
    metrics: HashMap<char, Metric>,
    glyphs: HashMap<(char, u32, i32), Glyph>,
}

/// The typeface, or `None` when the embedded file cannot be used.
pub(super) fn typeface() -> Option<MutexGuard<'static, Typeface>> {
    static FACE: OnceLock<Option<Mutex<Typeface>>> = OnceLock::new();
    FACE.get_or_init(|| {
        register_font(NAME, FontStyle::Normal, FILE).ok()?;
        let font = FontDesc::new(FontFamily::Name(NAME), LINE_UNITS, FontStyle::Normal);
        font.layout_box("0").ok()?;
        Some(Mutex::new(Typeface { font, metrics: HashMap::new(), glyphs: HashMap::new() }))
    })
    .as_ref()
    // The caches are valid after every single step, so a poisoned lock does no harm.
    .map(|face| face.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Width of a text in pixels.
pub(super) fn width(text: &str, size: u32) -> f64 {
    typeface().map_or(0.0, |mut face| face.layout(text, size).1)
}

/// The text on one line, or as much of its beginning as fits, with an ellipsis.
pub(super) fn fit(text: &str, size: u32, room: f64) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let places = typeface().map(|mut face| face.layout(&text, size));
    let Some((places, length)) = places.filter(|(_, length)| *length > room) else {
        return text;
    };
    let ends = places.iter().skip(1).map(|place| place.1).chain([length]);
    let room = room - width("…", size);
    let kept: String = places.iter().zip(ends).take_while(|(_, end)| *end <= room).map(|((c, _), _)| c).collect();
    format!("{}…", kept.trim_end())
}

/// Breaks a text between words into at most `most` lines.
pub(super) fn wrap(text: &str, size: u32, room: f64, most: usize) -> Vec<String> {
    let space = width(" ", size);
    let mut used = 0.0;
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        let length = width(word, size);
        let full = lines.len() == most;
        match lines.last_mut() {
            Some(line) if full || used + space + length <= room => {
                line.push(' ');
                line.push_str(word);
                used += space + length;
            }
            _ => {
                lines.push(word.to_string());
                used = length;
            }
        }
    }
    lines.iter().map(|line| fit(line, size, room)).collect()
}

impl Typeface {
    /// Each character of a line with the position of its origin, and the length of the line.
    pub fn layout(&mut self, text: &str, size: u32) -> (Vec<(char, f64)>, f64) {
        let scale = f64::from(size) / LINE_UNITS;
        let mut pen = 0.0;
        let mut previous = None;
        let mut places = Vec::with_capacity(text.len());
        for c in text.chars() {
            let advance = self.metric(c).advance;
            if let Some(p) = previous {
                pen += self.kern(p, c) * scale;
            }
            places.push((c, pen));
            pen += advance * scale;
            previous = Some(c);
        }
        (places, pen)
    }

    /// The glyph shifted right by a number of quarter pixels.
    pub fn glyph(&mut self, c: char, size: u32, phase: i32) -> &Glyph {
        let bearing = self.metric(c).bearing;
        let font = &self.font;
        self.glyphs.entry((c, size, phase)).or_insert_with(|| rasterise(font, c, size, phase, bearing))
    }

    fn metric(&mut self, c: char) -> Metric {
        *self.metrics.entry(c).or_insert_with(|| read_metric(c).unwrap_or_default())
    }

    /// Extra space between two characters in font units.
    fn kern(&mut self, left: char, right: char) -> f64 {
        let mut pair = [0; 8];
        let split = left.encode_utf8(&mut pair).len();
        let end = split + right.encode_utf8(&mut pair[split..]).len();
        let joined = std::str::from_utf8(&pair[..end]).unwrap_or_default();
        let apart = self.metric(left).advance + self.metric(right).advance;
        match self.font.layout_box(joined) {
            Ok(((start, _), (stop, _))) => f64::from(stop - start) - apart,
            Err(_) => 0.0,
        }
    }
}

/// Draws a glyph in quarter pixels and averages these into pixels.
fn rasterise(font: &FontDesc, c: char, size: u32, phase: i32, bearing: f64) -> Glyph {
    let fine_size = f64::from(size) * f64::from(FINE);
    let start = (bearing * fine_size / LINE_UNITS).floor() as i32 + phase;
    // plotters puts the baseline at half the font size.
    let baseline = (fine_size / 2.0) as i32;
    let mut dots: Vec<(i32, i32, f32)> = Vec::new();
    // The glyph of a character the font cannot draw stays empty.
    let _ = font.resize(fine_size).draw(c.encode_utf8(&mut [0; 4]), (start, -baseline), |x, y, a| {
        dots.push((x.div_euclid(FINE), y.div_euclid(FINE), a));
        Ok::<(), ()>(())
    });
    let bounds = dots.iter().fold(None, |b: Option<[i32; 4]>, &(x, y, _)| {
        let [l, t, r, d] = b.unwrap_or([x, y, x, y]);
        Some([l.min(x), t.min(y), r.max(x), d.max(y)])
    });
    let Some([left, top, right, bottom]) = bounds else {
        return Glyph::default();
    };
    let width = (right - left + 1) as usize;
    let mut cover = vec![0.0; width * (bottom - top + 1) as usize];
    for (x, y, a) in dots {
        cover[(y - top) as usize * width + (x - left) as usize] += a;
    }
    let full = (FINE * FINE) as f32;
    Glyph {
        left,
        top,
        width,
        levels: cover.iter().map(|a| (a / full * f32::from(LEVELS) + 0.5).min(f32::from(LEVELS)) as u8).collect(),
    }
}

/// Reads advance and left side bearing from the character map and the horizontal metrics.
fn read_metric(c: char) -> Option<Metric> {
    let index = glyph_index(table(b"cmap")?, u32::from(c))?;
    let long = usize::from(be16(table(b"hhea")?, 34)?);
    let hmtx = table(b"hmtx")?;
    let last = index.min(long.checked_sub(1)?);
    let bearing = match index < long {
        true => be16(hmtx, 4 * index + 2)?,
        false => be16(hmtx, 4 * long + 2 * (index - long))?,
    };
    Some(Metric { advance: f64::from(be16(hmtx, 4 * last)?), bearing: f64::from(bearing.cast_signed()) })
}

/// Looks a character up in the Unicode subtable of format 4; the missing glyph is 0.
fn glyph_index(cmap: &[u8], code: u32) -> Option<usize> {
    let subtable = (0..usize::from(be16(cmap, 2)?)).find_map(|i| {
        let at = be32(cmap, 8 + 8 * i)? as usize;
        cmap.get(at..).filter(|sub| be16(sub, 0) == Some(4))
    })?;
    let Ok(code) = u16::try_from(code) else {
        return Some(0);
    };
    let span = usize::from(be16(subtable, 6)?);
    for at in (14..14 + span).step_by(2) {
        if be16(subtable, at)? < code {
            continue;
        }
        let start = be16(subtable, at + 2 + span)?;
        let delta = be16(subtable, at + 2 + 2 * span)?;
        let indirect = at + 2 + 3 * span;
        if start > code {
            break;
        }
        let glyph = match usize::from(be16(subtable, indirect)?) {
            0 => code.wrapping_add(delta),
            hop => match be16(subtable, indirect + hop + 2 * usize::from(code - start))? {
                0 => 0,
                glyph => glyph.wrapping_add(delta),
            },
        };
        return Some(usize::from(glyph));
    }
    Some(0)
}

fn table(tag: &[u8; 4]) -> Option<&'static [u8]> {
    (0..usize::from(be16(FILE, 4)?)).find_map(|i| {
        let record = FILE.get(12 + 16 * i..28 + 16 * i)?;
        let start = be32(record, 8)? as usize;
        let length = be32(record, 12)? as usize;
        FILE.get(start..start.checked_add(length)?).filter(|_| record.starts_with(tag))
    })
}

fn be16(data: &[u8], at: usize) -> Option<u16> {
    let bytes = data.get(at..at + 2)?;
    Some(u16::from_be_bytes(bytes.try_into().ok()?))
}

fn be32(data: &[u8], at: usize) -> Option<u32> {
    let bytes = data.get(at..at + 4)?;
    Some(u32::from_be_bytes(bytes.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_agree_with_the_font_library() {
        let face = typeface().expect("embedded typeface");
        for c in "0Aij−²°µσχΔ×⁻…".chars() {
            let metric = read_metric(c).expect("metrics");
            let (_, (width, _)) = face.font.layout_box(&c.to_string()).expect("layout");
            assert_eq!(metric.advance, f64::from(width), "{c}");
        }
        let index = |c: char| glyph_index(table(b"cmap").expect("cmap"), u32::from(c));
        assert_ne!(index('σ'), Some(0));
        assert_eq!(index('\u{10ffff}'), Some(0));
        assert_eq!(index('\u{fff0}'), Some(0));
    }

    #[test]
    fn glyphs_stand_on_the_baseline_beside_their_origin() {
        let mut face = typeface().expect("embedded typeface");
        let glyph = face.glyph('E', 48, 0);
        let height = glyph.levels.len() / glyph.width;
        assert_eq!(glyph.top + height as i32, 0);
        assert!(glyph.left > 0);
        let left = glyph.left;
        assert_eq!(face.glyph('E', 48, 3).left, left);
        assert_eq!(face.glyph(' ', 48, 0).levels.len(), 0);
    }

    #[test]
    fn kerning_draws_pairs_together() {
        let mut face = typeface().expect("embedded typeface");
        let pair = face.layout("AV", 100).1;
        let apart = face.layout("A", 100).1 + face.layout("V", 100).1;
        assert!(pair < apart);
    }

    #[test]
    fn text_is_wrapped_and_cut_to_the_room() {
        let text = "one two three four five six seven eight nine ten";
        let lines = wrap(text, 24, 150.0, 10);
        assert_eq!(lines.join(" "), text);
        assert!(lines.iter().all(|line| width(line, 24) <= 150.0));
        let lines = wrap(text, 24, 150.0, 2);
        assert_eq!(lines.len(), 2);
        assert!(lines[1].ends_with('…') && width(&lines[1], 24) <= 150.0);
        assert_eq!(fit("  two\n words ", 24, 500.0), "two words");
        assert_eq!(fit("narrow", 24, 0.0), "…");
        assert!(wrap(" \n ", 24, 100.0, 3).is_empty());
    }
}
