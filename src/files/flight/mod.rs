//! What flight processing reads and writes: its configuration, telemetry, auxiliary tables, daily models, levels.

pub mod auxiliary;
pub mod daily;
pub mod edited;
pub mod levels;
pub mod mission;
mod mission_file;
pub mod text;
pub mod times;

pub use mission_file::{is_mission, read as read_mission};
