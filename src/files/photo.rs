//! Photographs that a protocol shows. The copy in a result folder carries a mark of the program, so that it can be written again.

use crate::data::error::Finding;
use crate::files::source::{Digested, read_whole};
use std::path::Path;

/// How the mark of a JPEG copy begins; it stands behind the picture, where no program looks at it.
pub(super) const MARK: &[u8] = b"\ncalfit photograph ";
/// How JPEG files begin.
pub(super) const JPEG: &[u8] = b"\xff\xd8\xff";
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Begin of a PNG file with its first chunk, the size and kind of the picture.
const PNG_HEAD: usize = 33;

/// Reads a photograph; its copy with the mark, the ending of its name, and the file as an input.
///
/// # Errors
/// A file that cannot be read, or is no PNG or JPEG picture.
pub fn read(path: &Path) -> Result<(Vec<u8>, &'static str, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let version = env!("CARGO_PKG_VERSION");
    if bytes.starts_with(JPEG) {
        let copy = [bytes.as_slice(), MARK, version.as_bytes(), b"\n"].concat();
        return Ok((copy, "jpg", digested));
    }
    if bytes.starts_with(PNG) && bytes.get(12..16) == Some(b"IHDR") && bytes.len() > PNG_HEAD {
        let text = [b"tEXtSoftware\0calfit ", version.as_bytes(), b" copy of a photograph"].concat();
        let mut sum = flate2::Crc::new();
        sum.update(&text);
        let length = (text.len() - 4) as u32;
        let (head, rest) = bytes.split_at(PNG_HEAD);
        let copy = [head, &length.to_be_bytes(), &text, &sum.sum().to_be_bytes(), rest].concat();
        return Ok((copy, "png", digested));
    }
    let rule = "is no PNG or JPEG picture";
    Err(Finding::error(&path.display().to_string(), rule, "convert it, or correct `file` of [[report.photo]] in campaign.toml"))
}
