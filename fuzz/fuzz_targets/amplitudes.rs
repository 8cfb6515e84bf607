//! Any bytes as a table of amplitudes.

#![no_main]

use calfit::files::amplitudes::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = as_file("amplitudes.csv", bytes, |path| read(path, &mut findings));
    if let Some((rows, _)) = told(result, &findings) {
        assert!(rows.iter().all(|row| row.frequency_hz > 0.0));
    }
});
