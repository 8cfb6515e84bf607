//! The forward model that analysis, simulation and diagnosis share. It knows no files.

pub mod alignment;
pub mod applied;
pub mod campaign;
pub mod coil;
pub mod effects;
pub mod facility;
pub mod facility_calibration;
pub mod field_calibration;
pub mod lag;
pub mod linearisation;
pub mod off_centre;
pub mod polynomial;
pub mod position;
pub mod response;
pub mod sensor;
pub mod sensor_polynomials;
pub mod thermal;
