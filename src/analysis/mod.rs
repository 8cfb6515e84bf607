//! One file per analysis: runs in, plain results out.

pub mod conditions;
pub mod corner;
pub mod freq;
pub mod joint;
pub mod lin;
pub mod offset;
pub mod sweep;
pub mod thermal;
