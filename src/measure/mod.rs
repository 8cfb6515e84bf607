//! One file per analysis: runs in, plain results out.

pub mod centre;
pub mod coil;
pub mod compare;
pub mod corner;
pub mod freq;
pub mod joint;
pub mod lin;
pub mod linearise;
pub mod null;
pub mod offset;
pub mod recordings;
mod structure;
pub mod sweep;
pub mod thermal;
pub mod thermistor;
