//! One file per analysis: runs in, plain results out.

pub mod lin;
