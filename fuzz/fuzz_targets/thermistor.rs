//! Any bytes as a table of a thermistor, with the column of the temperature under two names.

#![no_main]

use calfit::files::thermistor::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    for temperature in ["t_degc", "reference_degc"] {
        let mut findings = Vec::new();
        let result = as_file("thermistor.csv", bytes, |path| read(path, temperature, &mut findings));
        if let Some((rows, _)) = told(result, &findings) {
            assert!(!rows.is_empty());
        }
    }
});
