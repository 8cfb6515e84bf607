//! Any text with a right hash as a model file: its effects are those of the catalogue, or what is wrong with them is told.

#![no_main]

use calfit::workflow::read_model;
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    told(as_file("model.toml", &sealed(bytes), read_model), &[]);
});
