//! Any bytes as a table of text: what is guessed of it is a mapping.

#![no_main]

use calfit::files::import::guess;
use calfit::files::import::mapping::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let guessed = as_file("foreign.csv", bytes, guess);
    if let Some(text) = told(guessed, &[]) {
        let mut findings = Vec::new();
        let mapping = as_file("guessed.toml", text.as_bytes(), |path| read(path, &mut findings));
        assert!(mapping.is_ok(), "{text}\n{mapping:?}");
    }
});
