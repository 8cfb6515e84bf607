//! Any bytes as a run file: the reader never panics, and one thread or two make no difference.
//!
//!     mkdir -p fuzz/corpus/ccr
//!     cargo +nightly fuzz run ccr fuzz/corpus/ccr fuzz/seeds/ccr -- -detect_leaks=0 -max_len=8192
//!
//! New inputs are collected in `fuzz/corpus`; the seeds stay as they are. Leaks are not looked for: the second thread may still
//! be on its way out when they are counted, and what the C library keeps for it is taken for lost.

#![no_main]

use calfit::data::plateau::{Accumulator, Cut};
use calfit::data::run::{Header, Setting, Vector, VectorSink};
use calfit::files::ccr::{Options, peek, read};
use libfuzzer_sys::fuzz_target;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// The reader takes regular files only, so that is what it gets.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| TempDir::new().expect("a temporary folder"));

/// The bits of all vectors, in order.
#[derive(Default, PartialEq, Debug)]
struct Bits(Vec<[u64; 5]>);

impl VectorSink for Bits {
    fn begin(&mut self, _header: &Header, _settings: &[Setting]) {
        self.0.clear();
    }

    fn vector(&mut self, vector: Vector) {
        let [x, y, z] = vector.reading.0.map(f64::to_bits);
        self.0.push([vector.n, vector.t_s.to_bits(), x, y, z]);
    }
}

/// All that the reader tells of a file, as text: two of them are the same although NaN is not equal to itself.
fn account(path: &Path, options: &Options) -> String {
    let mut sinks = (Bits::default(), Accumulator::default());
    let run = read(path, options, &mut sinks);
    let plateaus = run.is_ok().then(|| sinks.1.finish(Cut::default()));
    format!("{run:?} {:?} {plateaus:?}", sinks.0)
}

fuzz_target!(|bytes: &[u8]| {
    let path = FOLDER.path().join("run.CCR");
    std::fs::write(&path, bytes).expect("a written file");
    let _ = peek(&path);
    for lenient in [false, true] {
        let one = Options {
            allow_truncated: lenient,
            allow_duplicates: lenient,
            collect: lenient,
            two_threads: false,
            recorded_path: None,
        };
        let two = Options { two_threads: true, ..one.clone() };
        assert_eq!(account(&path, &one), account(&path, &two));
    }
});
