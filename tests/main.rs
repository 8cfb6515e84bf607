//! The promises to users, one module each. They are one program: every program of tests is as large as the library with all that it
//! uses, and takes as long to link.

mod common;

#[cfg(feature = "tables")]
mod apply;
mod browser;
mod coil;
mod contract_keys;
mod contradictions;
mod diagnose;
mod diagnose_across;
mod diagnose_freq;
mod diagnose_samples;
mod diagnose_strong;
mod diagnose_verdict;
mod docs;
mod exclusion;
mod export;
mod faults;
mod faults_analyses;
mod faults_data;
mod faults_surroundings;
mod faults_text;
mod files;
#[cfg(feature = "tables")]
mod flight;
#[cfg(feature = "tables")]
mod flight_diagnosis;
#[cfg(feature = "tables")]
mod flight_faults;
mod flight_neighbours;
#[cfg(feature = "tables")]
mod flight_said;
mod freq;
mod house;
mod import;
mod kinds;
mod lin;
mod linearise;
mod model_closure;
mod model_file;
mod moving;
mod nist_linear;
mod nist_nonlinear;
mod nist_sine;
mod note_kinds;
mod null;
mod offset;
mod places;
mod protocol;
mod python;
mod recipe;
mod reference_complete;
mod report;
mod result_folder;
mod result_folder_left;
mod rosetta;
mod scale;
mod screens;
mod simulate;
mod sweep;
#[cfg(feature = "tables")]
mod telemetry_twin;
mod temperature_faults;
mod thermal;
mod twins;
mod verify;
