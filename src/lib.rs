//! Ground calibration of fluxgate magnetometers at a coil facility.
//!
//! # The path of the data
//!
//! Files become runs ([`files`], [`data::run`]): a header, a table of settings, slow channels, and a stream of vectors. While a file is
//! read its vectors are reduced to plateau statistics ([`data::plateau`]), so that no run has to fit into memory. An analysis
//! ([`measure`]) builds a design matrix from settings and plateaus, has it solved by an estimator that knows no magnetometer
//! ([`fit`]), and gives the coefficients their meaning with the forward model ([`model`]). Its result is a plain struct with
//! uncertainties beside values; parameter files ([`files::parameter`]), figures ([`plot`]) and tables ([`show`]) all read
//! that struct. [`simulate`] goes the other way: from a twin, whose sensor and coil system are those of [`model`], to run files whose
//! truth is known. [`flight`] takes telemetry of a mission through the steps of its levels. [`workflow`] takes a run file all the way along this path; the commands ([`cli`]) say which, and what to tell.
//!
//! # Frames and units
//!
//! `B_c` is the reference field in **coil coordinates**, nT. `B_r` is the raw **reading** along the sensor axes in engineering
//! nanotesla, enT. `B_r = Φ⁻¹ B_c + B_or`, with `Φ = R_nom ρ ω σ` and `B_or = B_off + B_res`. The table of all units stands in
//! [`data::units`].

pub mod cli;
pub mod data;
pub mod diagnose;
pub mod files;
pub mod fit;
#[cfg(feature = "tables")]
pub mod flight;
pub mod measure;
pub mod model;
pub mod plot;
pub mod record;
pub mod show;
pub mod simulate;
pub mod workflow;
