//! Where a result comes from: tool, command, time, inputs with hashes.

use crate::data::run::InputFile;
use serde::{Deserialize, Serialize};

/// One input of a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// Path inside the campaign, with forward slashes.
    pub path: String,
    /// Size, bytes.
    pub size_bytes: u64,
    /// SHA-256 of the bytes, hexadecimal.
    pub sha256: String,
}

impl From<&InputFile> for Input {
    fn from(file: &InputFile) -> Self {
        Self { path: file.path.clone(), size_bytes: file.size_bytes, sha256: file.sha256.clone() }
    }
}

/// What is written into every parameter file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// `calfit`.
    pub tool: String,
    /// Its version.
    pub tool_version: String,
    /// Machine and build for which the program was compiled.
    pub build: String,
    /// The command with every option that has an influence on the numbers, and without paths.
    pub command: String,
    /// When, RFC 3339, UTC. `SOURCE_DATE_EPOCH` fixes it.
    pub created: String,
    /// The inputs.
    pub input: Vec<Input>,
}

impl Provenance {
    /// Provenance of a result made now.
    #[must_use]
    pub fn new(command: String, input: Vec<Input>) -> Self {
        let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
        Self {
            tool: env!("CARGO_PKG_NAME").to_owned(),
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            build: format!("{}-{} {profile}", std::env::consts::ARCH, std::env::consts::OS),
            command,
            created: created(),
            input,
        }
    }
}

/// Now, or the time of `SOURCE_DATE_EPOCH`, to the second.
fn created() -> String {
    let fixed = std::env::var("SOURCE_DATE_EPOCH").ok().and_then(|v| v.parse::<i64>().ok());
    let time = match fixed.map(jiff::Timestamp::from_second) {
        Some(Ok(time)) => time,
        _ => jiff::Timestamp::now(),
    };
    time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}
