//! Any text as a twin; the field programme T.MAG stands beside it.

#![no_main]

use calfit::files::twin::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = as_file("twin.toml", bytes, |path| read(path, &mut findings));
    told(result, &findings);
});
