//! A run made ready to fit: rows with covariates at their times, corrections applied once, faults taken off once.

pub mod baseline;
pub mod carried;
pub mod conditions;
pub mod facility;
pub mod known;
pub mod linearised;
pub mod plan;
pub mod position;
pub mod prepared;
mod row_noise;
pub mod screens;
pub mod single_readings;
pub mod temperature_faults;
