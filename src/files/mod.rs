//! Text to types and back, nothing else: one module per file format.

pub mod amplitudes;
pub mod campaign;
pub mod ccr;
pub mod export;
pub mod facility;
pub mod field;
#[cfg(feature = "tables")]
pub mod flight;
pub mod import;
pub mod index;
pub mod ledger;
pub mod linearisation;
pub mod lock;
pub mod mag;
pub mod moduli;
pub mod orientations;
pub mod output;
pub mod parameter;
pub mod photo;
pub mod source;
#[cfg(feature = "tables")]
pub mod table;
pub mod text;
pub mod thermistor;
pub mod twin;
