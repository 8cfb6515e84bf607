//! Pictures as PNG files.

use png::{BitDepth, ColorType, DeflateCompression, Encoder, EncodingError, Filter};
use png::{PixelDimensions, Unit};

use super::Figure;

/// Pixels per metre that make 150 dots per inch.
const DENSITY: u32 = 5906;

/// Leading bits of a channel that tell colours apart: the smooth edges of many shapes that
/// overlap have more colours than a palette holds.
const BITS: usize = 5;

/// Red, green and blue.
type Colour = [u8; 3];

const SOFTWARE: &str = concat!("calfit ", env!("CARGO_PKG_VERSION"));

/// Encodes pixels of three bytes each; the `exact` colours are never altered. Nothing but the
/// pixels and the texts of the figure enters.
pub(super) fn png(
    pixels: &[u8],
    (width, height): (u32, u32),
    exact: impl Iterator<Item = Colour>,
    figure: &Figure,
) -> Result<Vec<u8>, EncodingError> {
    let mut bytes = Vec::with_capacity(128 * 1024);
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_deflate_compression(DeflateCompression::Level(1));
    encoder.set_pixel_dims(Some(PixelDimensions { xppu: DENSITY, yppu: DENSITY, unit: Unit::Meter }));
    for (keyword, text) in [("Title", figure.title.as_str()), ("Description", figure.caption.as_str()), ("Software", SOFTWARE)] {
        // A plain text chunk holds Latin-1 without control characters.
        let plain = |c: char| matches!(c, '\n' | ' '..='~' | '\u{a0}'..='ÿ');
        let (keyword, text) = (keyword.to_string(), text.to_string());
        if text.chars().all(plain) {
            encoder.add_text_chunk(keyword, text)?;
        } else {
            encoder.add_itxt_chunk(keyword, text.replace('\0', " "))?;
        }
    }
    // A byte per pixel takes half the time of three, and half the space.
    let (palette, indices) = index(pixels, exact);
    encoder.set_color(ColorType::Indexed);
    encoder.set_palette(palette);
    encoder.set_filter(Filter::NoFilter);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&indices)?;
    writer.finish()?;
    Ok(bytes)
}

/// A palette and the entry that stands for each colour, by the leading bits of its channels.
struct Palette {
    colours: Vec<Colour>,
    entries: Vec<Option<u8>>,
}

impl Palette {
    /// The entry of a colour: one that differs by less than the eye sees if there is one, else a
    /// new one; once the palette is full, the nearest.
    fn entry(&mut self, colour: Colour) -> u8 {
        let [r, g, b] = colour.map(|channel| usize::from(channel >> (8 - BITS)));
        let key = (r << (2 * BITS)) | (g << BITS) | b;
        if let Some(entry) = self.entries[key] {
            return entry;
        }
        let entry = match u8::try_from(self.colours.len()) {
            Ok(entry) => {
                self.colours.push(colour);
                entry
            }
            Err(_) => self.nearest(colour),
        };
        self.entries[key] = Some(entry);
        entry
    }

    fn nearest(&self, colour: Colour) -> u8 {
        let distance = |other: &Colour| -> u32 {
            let channels = other.iter().zip(colour);
            channels.map(|(&a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
        };
        let entries = (0..=u8::MAX).zip(&self.colours);
        let nearest = entries.min_by_key(|(_, other)| distance(other));
        nearest.map_or(0, |(entry, _)| entry)
    }
}

/// The palette and the entry of each pixel.
fn index(pixels: &[u8], exact: impl Iterator<Item = Colour>) -> (Vec<u8>, Vec<u8>) {
    const WHITE: Colour = [0xff; 3];
    let mut palette = Palette { colours: Vec::with_capacity(256), entries: vec![None; 1 << (3 * BITS)] };
    let white = palette.entry(WHITE);
    for colour in exact {
        palette.entry(colour);
    }
    let mut indices = Vec::with_capacity(pixels.len() / 3);
    let mut last = (WHITE, white);
    for group in pixels.chunks(24) {
        if group == [0xff; 24] {
            indices.extend_from_slice(&[white; 8]);
            continue;
        }
        for pixel in group.chunks_exact(3) {
            let colour = [pixel[0], pixel[1], pixel[2]];
            if colour != last.0 {
                last = (colour, palette.entry(colour));
            }
            indices.push(last.1);
        }
    }
    (palette.colours.concat(), indices)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_are_kept_and_many_come_close() {
        let exact = [[1, 2, 3], [200, 100, 50]];
        let mut pixels = vec![0xff; 24];
        for n in 0..4000u32 {
            pixels.extend([(n % 256) as u8, (n / 7 % 256) as u8, (n / 16 % 256) as u8]);
        }
        pixels.extend(exact.concat());
        let (palette, indices) = index(&pixels, exact.into_iter());
        assert_eq!(palette.len(), 768);
        assert_eq!(indices.len() * 3, pixels.len());
        let shown = |n: usize| &palette[usize::from(indices[n]) * 3..][..3];
        let last = indices.len() - 1;
        assert_eq!(shown(last), exact[1]);
        assert_eq!(shown(last - 1), exact[0]);
        assert_eq!(shown(0), [0xff; 3]);
    }
}
