//! Any text as a LINEARISATION file with a right hash.

#![no_main]

use calfit::files::linearisation::read;
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    told(as_file("LINEARISATION.toml", &sealed(bytes), read), &[]);
});
