//! Any text with a right hash as a ground calibration file.

#![no_main]

use calfit::files::export::rpcmag::read;
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = as_file("GROUND.toml", &sealed(bytes), |path| read(path, &mut findings));
    told(result, &findings);
});
