//! What the targets share: bytes as a file, since readers take regular files only, and parameter files with a right hash.
//!
//! Every target runs alike; `ccr` wants `-detect_leaks=0` besides (see there):
//!
//!     mkdir -p fuzz/corpus/mag
//!     cargo +nightly fuzz run mag fuzz/corpus/mag fuzz/seeds/mag -- -max_len=8192 -max_total_time=30
//!
//! `fuzz/run.sh 30 mag` does the same with a stable toolchain and without cargo-fuzz, and prints how many inputs were tried.
//!
//! New inputs are collected in `fuzz/corpus`; the seeds stay as they are.

use calfit::data::error::Finding;
use calfit::data::time::LeapSeconds;
use calfit::files::flight::mission::Mission;
use calfit::files::flight::read_mission;
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| TempDir::new().expect("a temporary folder"));

/// 2015-06-30, the day of the seeds of flight processing, counted from 1970-01-01.
pub const DAY: i32 = 16_616;

/// The leap seconds that there were.
pub static LEAP: LazyLock<LeapSeconds> = LazyLock::new(LeapSeconds::default);

/// The configuration whose telemetry and tables are read.
pub static MISSION: LazyLock<Mission> = LazyLock::new(|| {
    let text = include_bytes!("../seeds/mission/rosetta.toml");
    as_file("flight.toml", text, |path| read_mission(path, &LEAP)).expect("a configuration").0
});

/// A field programme that twins of the corpus name.
const PROGRAMME: &str =
    "MAG 1\nname = \"T.MAG\"\nkind = \"linearity\"\n@STEPS\nduration,bx,by,bz,frequency,position\n24,1,2,3,0,1\n@END\n";

/// Gives the bytes to a reader as a file of this name; a field programme `T.MAG` stands beside it.
pub fn as_file<T>(name: &str, bytes: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    let programme = FOLDER.path().join("T.MAG");
    if !programme.exists() {
        std::fs::write(&programme, PROGRAMME).expect("a written file");
    }
    let path = FOLDER.path().join(name);
    std::fs::write(&path, bytes).expect("a written file");
    read(&path)
}

/// A name for the bytes of a table, by how they begin: the readers go by the end of a name.
pub fn table_name(stem: &str, bytes: &[u8]) -> String {
    format!("{stem}.{}", if bytes.starts_with(b"PAR1") { "parquet" } else { "csv" })
}

/// The bytes with the hash of their content where they state one: a parameter file is looked at beyond its hash only if that is right.
pub fn sealed(bytes: &[u8]) -> Vec<u8> {
    let Ok(text) = std::str::from_utf8(bytes) else { return bytes.to_owned() };
    let mut hash = Sha256::new();
    for line in text.lines().filter(|l| !l.starts_with("created = ") && !l.starts_with("content_sha256 = ")) {
        hash.update(line.as_bytes());
        hash.update(b"\n");
    }
    let hash: String = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
    let line = |l: &str| {
        if l.starts_with("content_sha256 = ") { format!("content_sha256 = \"{hash}\"\n") } else { format!("{l}\n") }
    };
    text.lines().map(line).collect::<String>().into_bytes()
}

/// Shows what a reader complains of, as a command does.
pub fn told<T>(result: Result<T, Finding>, findings: &[Finding]) -> Option<T> {
    for finding in findings {
        let _ = finding.to_string();
    }
    result.map_err(|finding| finding.to_string()).ok()
}
