//! Files as chunks of whole lines, hashed on the way, in bounded memory.

use super::text::LONGEST_LINE;
use crate::data::error::Finding;
use crate::data::provenance::Input;
use flate2::bufread::MultiGzDecoder;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek};
use std::path::Path;
use std::sync::mpsc::sync_channel;

/// Size of a chunk, bytes: what a core keeps at hand from the copy out of the page cache over the hash to the numbers.
const CHUNK: usize = 1 << 17;
/// Size of the first chunk, bytes: who looks at the head of a run alone reads and hashes no more.
const FIRST: usize = 1 << 13;

/// A piece of a file.
#[derive(Clone, Copy, Debug)]
pub enum Piece<'a> {
    /// Whole lines, each with its line end.
    Lines(&'a [u8]),
    /// What stands after the last line end of the file.
    Rest(&'a [u8]),
    /// The begin of a line that is longer than [`LONGEST_LINE`].
    Overlong(&'a [u8]),
}

/// Size and hash of what was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Digested {
    /// Bytes of the file.
    pub size_bytes: u64,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
}

impl Digested {
    /// The file as an input of a result, under the name that is recorded.
    #[must_use]
    pub fn input(self, path: String) -> Input {
        Input { path, size_bytes: self.size_bytes, sha256: self.sha256, ..Input::default() }
    }
}

/// Hashes what goes through, so that the hash is that of the bytes that were parsed.
struct Hashing<R> {
    inner: R,
    hash: Sha256,
    bytes: u64,
}

impl<R: Read> Read for Hashing<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(buffer)?;
        if let Some(new) = buffer.get(..read) {
            self.hash.update(new);
        }
        self.bytes += read as u64;
        Ok(read)
    }
}

enum Reader {
    Plain(Hashing<File>),
    Gzip(Box<MultiGzDecoder<BufReader<Hashing<File>>>>),
}

impl Reader {
    fn digested(self) -> Digested {
        let hashing = match self {
            Reader::Plain(hashing) => hashing,
            Reader::Gzip(decoder) => decoder.into_inner().into_inner(),
        };
        let sha256 = hex(&hashing.hash.finalize());
        Digested { size_bytes: hashing.bytes, sha256 }
    }
}

impl Read for Reader {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Reader::Plain(reader) => reader.read(buffer),
            Reader::Gzip(reader) => reader.read(buffer),
        }
    }
}

/// Hexadecimal text of bytes.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Cuts what a reader gives at line ends.
struct Cutter {
    reader: Reader,
    carry: Vec<u8>,
    /// Bytes that are read next.
    size: usize,
}

#[derive(Clone, Copy, PartialEq)]
enum Cut {
    Lines,
    Rest,
    Overlong,
}

/// A piece in a buffer that is used again: its memory is cleared once, not for every piece.
#[derive(Default)]
struct Chunk {
    memory: Vec<u8>,
    length: usize,
}

impl Chunk {
    fn bytes(&self) -> &[u8] {
        self.memory.get(..self.length).unwrap_or_default()
    }

    fn piece(&self, cut: Cut) -> Piece<'_> {
        match cut {
            Cut::Lines => Piece::Lines(self.bytes()),
            Cut::Rest => Piece::Rest(self.bytes()),
            Cut::Overlong => Piece::Overlong(self.bytes()),
        }
    }

    /// Adds so many bytes; fewer are the last ones of the file.
    fn fill(&mut self, reader: &mut Reader, size: usize) -> std::io::Result<bool> {
        let target = self.length + size;
        if self.memory.len() < target {
            self.memory.try_reserve(target - self.memory.len()).map_err(std::io::Error::other)?;
            self.memory.resize(target, 0);
        }
        while let Some(free) = self.memory.get_mut(self.length..target).filter(|free| !free.is_empty()) {
            match reader.read(free) {
                Ok(0) => return Ok(false),
                Ok(read) => self.length += read,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }
}

impl Cutter {
    /// Fills `chunk` with the next piece.
    fn next(&mut self, chunk: &mut Chunk) -> std::io::Result<Cut> {
        chunk.length = self.carry.len();
        if chunk.memory.len() < chunk.length {
            chunk.memory.resize(chunk.length, 0);
        }
        chunk.memory.iter_mut().zip(self.carry.drain(..)).for_each(|(to, from)| *to = from);
        loop {
            let more = chunk.fill(&mut self.reader, self.size)?;
            self.size = CHUNK;
            // The last line end, if any, is found by the caller's line loop; what follows it is the next piece or the rest.
            if let Some(at) = memchr::memrchr(b'\n', chunk.bytes()) {
                self.carry.extend_from_slice(chunk.bytes().get(at + 1..).unwrap_or_default());
                chunk.length = at + 1;
                return Ok(Cut::Lines);
            }
            if !more {
                return Ok(Cut::Rest);
            }
            if chunk.length >= LONGEST_LINE {
                return Ok(Cut::Overlong);
            }
        }
    }
}

/// Opens a regular file: a pipe would wait for its other end, and a device has none.
///
/// # Errors
/// What the operating system says, or that it is no regular file.
pub fn open(path: &Path) -> Result<File, Finding> {
    let meta = std::fs::metadata(path).map_err(|e| Finding::io(path, "open", &e))?;
    must_be_regular(path, &meta)?;
    File::open(path).map_err(|e| Finding::io(path, "open", &e))
}

fn must_be_regular(path: &Path, meta: &std::fs::Metadata) -> Result<(), Finding> {
    if meta.is_file() {
        return Ok(());
    }
    let what = if meta.is_dir() { "is a folder" } else { "is a device, pipe or socket" };
    let remedy = "name a file, or copy the data into one";
    Err(Finding::error(&path.display().to_string(), format!("{what}, not a regular file"), remedy))
}

/// The text of a small file whose kind is to be found out; `None` if it cannot be that.
#[must_use]
pub fn small_text(path: &Path) -> Option<String> {
    String::from_utf8(read_whole(path).ok()?.0).ok()
}

/// Size of what is in a file, bytes; of a compressed one about what it is decompressed.
#[must_use]
pub fn content_size(path: &Path) -> u64 {
    /// Runs shrink to a fifth or so.
    const COMPRESSED: u64 = 6;
    let size = std::fs::metadata(path).map_or(0, |meta| meta.len());
    if path.extension().is_some_and(|end| end.eq_ignore_ascii_case("gz")) { COMPRESSED.saturating_mul(size) } else { size }
}

/// Refuses a file for which there is not as much memory as its contents take, before anything is read: later there would be nobody left to
/// say it.
///
/// # Errors
/// The memory is not to be had.
pub fn room_for(path: &Path, bytes: u64) -> Result<(), Finding> {
    let mut probe: Vec<u8> = Vec::new();
    let is_there = usize::try_from(bytes).is_ok_and(|bytes| probe.try_reserve_exact(bytes).is_ok());
    // Memory that nobody looks at need not be asked for at all.
    std::hint::black_box(&mut probe);
    if is_there {
        return Ok(());
    }
    let rule = format!("needs about {} MB of memory, which are not to be had", bytes.div_ceil(1_000_000));
    Err(Finding::error(&path.display().to_string(), rule, "give the program more memory, or divide the data"))
}

/// Size and hash of a file.
///
/// # Errors
/// What the operating system says.
pub fn digest(path: &Path) -> Result<Digested, Finding> {
    let io = |error: std::io::Error| Finding::io(path, "read", &error);
    let mut reader = Hashing { inner: open(path)?, hash: Sha256::new(), bytes: 0 };
    let mut buffer = vec![0; 1 << 16];
    while reader.read(&mut buffer).map_err(io)? > 0 {}
    Ok(Digested { size_bytes: reader.bytes, sha256: hex(&reader.hash.finalize()) })
}

/// Reads a regular file, plain or gzip, piece by piece; the last piece is always [`Piece::Rest`], empty if the file ends with a
/// line end. With `two_threads` reading, decompressing and hashing go on beside `take`.
///
/// # Errors
/// An error of the operating system; a file that is no regular file; one that changes while it is read; the first error of `take`.
pub fn read_pieces(
    path: &Path,
    two_threads: bool,
    mut take: impl FnMut(Piece) -> Result<(), Finding>,
) -> Result<Digested, Finding> {
    let name = path.display().to_string();
    let io = |error: std::io::Error| Finding::io(path, "read", &error);
    let before = std::fs::metadata(path).map_err(io)?;
    must_be_regular(path, &before)?;
    let mut file = File::open(path).map_err(io)?;
    let mut magic = [0; 2];
    let zipped = file.read(&mut magic).map_err(io)? == 2 && magic == [0x1f, 0x8b];
    file.rewind().map_err(io)?;
    let hashing = Hashing { inner: file, hash: Sha256::new(), bytes: 0 };
    let reader = if zipped {
        Reader::Gzip(Box::new(MultiGzDecoder::new(BufReader::with_capacity(1 << 16, hashing))))
    } else {
        Reader::Plain(hashing)
    };
    let mut cutter = Cutter { reader, carry: Vec::new(), size: FIRST };
    let wrong = |error: std::io::Error| {
        if zipped {
            Finding::error(
                &name,
                format!("cannot be decompressed: {error}"),
                "the file is damaged or cut; take it from the archive again",
            )
        } else {
            Finding::io(path, "read", &error)
        }
    };

    if two_threads {
        read_beside(&mut cutter, &mut take, &wrong)?;
    } else {
        let mut chunk = Chunk::default();
        loop {
            let cut = cutter.next(&mut chunk).map_err(&wrong)?;
            take(chunk.piece(cut))?;
            if cut != Cut::Lines {
                break;
            }
        }
    }

    let digested = cutter.reader.digested();
    let after = std::fs::metadata(path).map_err(io)?;
    if after.len() != before.len() || after.modified().ok() != before.modified().ok() || digested.size_bytes != after.len() {
        return Err(Finding::error(&name, "changed while it was read", "wait until it is complete and run again"));
    }
    Ok(digested)
}

fn read_beside(
    cutter: &mut Cutter,
    take: &mut impl FnMut(Piece) -> Result<(), Finding>,
    wrong: &(impl Fn(std::io::Error) -> Finding + Sync),
) -> Result<(), Finding> {
    std::thread::scope(|scope| {
        let (full_in, full_out) = sync_channel::<std::io::Result<(Cut, Chunk)>>(3);
        let (empty_in, empty_out) = sync_channel::<Chunk>(4);
        scope.spawn(move || {
            loop {
                let mut chunk = empty_out.try_recv().unwrap_or_default();
                let piece = cutter.next(&mut chunk).map(|cut| (cut, chunk));
                let more = matches!(piece, Ok((Cut::Lines, _)));
                // The other side hangs up after an error of its own.
                if full_in.send(piece).is_err() || !more {
                    break;
                }
            }
        });
        for piece in full_out {
            let (cut, chunk) = piece.map_err(wrong)?;
            take(chunk.piece(cut))?;
            let _ = empty_in.try_send(chunk);
        }
        Ok(())
    })
}

/// Reads a small file whole.
///
/// # Errors
/// As [`read_pieces`], and a file of more than 64 MiB.
pub fn read_whole(path: &Path) -> Result<(Vec<u8>, Digested), Finding> {
    const MOST: usize = 64 << 20;
    let mut bytes = Vec::new();
    let digested = read_pieces(path, false, |piece| {
        let (Piece::Lines(new) | Piece::Rest(new) | Piece::Overlong(new)) = piece;
        bytes.try_reserve(new.len()).map_err(|e| Finding::io(path, "read", &std::io::Error::from(e)))?;
        bytes.extend_from_slice(new);
        if bytes.len() > MOST || matches!(piece, Piece::Overlong(_)) {
            let name = path.display().to_string();
            return Err(Finding::error(&name, "is too large for a file of this kind", "check the path"));
        }
        Ok(())
    })?;
    Ok((bytes, digested))
}
