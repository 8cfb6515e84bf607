//! Any bytes as a mapping of `calfit import`.

#![no_main]

use calfit::files::import::mapping::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = as_file("mapping.toml", bytes, |path| read(path, &mut findings));
    told(result, &findings);
});
