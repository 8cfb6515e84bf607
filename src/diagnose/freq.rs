//! Frequency runs.
