//! What a run consists of, and what every room speaks of: runs, plateaus, units, findings, where results come from.

pub mod across;
pub mod apply;
pub mod calibration;
pub mod convention;
pub mod envelope;
pub mod error;
pub mod exclusion;
pub mod flags;
pub mod frequency;
pub mod index;
pub mod linearisation;
pub mod note;
pub mod offset;
pub mod plateau;
pub mod provenance;
pub mod quantity;
pub mod recipe;
pub mod reference;
pub mod result;
pub mod run;
pub mod run_state;
pub mod start;
pub mod tables;
pub mod thermistor;
pub mod units;
pub mod zero_field;
