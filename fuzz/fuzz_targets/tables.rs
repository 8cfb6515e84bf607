//! Any bytes as a table of moduli and as a table of orientations.

#![no_main]

use calfit::files::{moduli, orientations};
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = as_file("moduli.csv", bytes, |path| moduli::read(path, &mut findings));
    told(result, &findings);
    let mut findings = Vec::new();
    let result = as_file("orientations.csv", bytes, |path| orientations::read(path, &mut findings));
    told(result, &findings);
});
