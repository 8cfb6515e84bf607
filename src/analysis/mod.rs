//! One file per analysis: runs in, plain results out.

pub mod conditions;
pub mod joint;
pub mod lin;
pub mod offset;
pub mod thermal;
