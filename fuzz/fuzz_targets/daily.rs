//! Any text as a daily offset model.

#![no_main]

use calfit::files::flight::daily;
use calfit_fuzz::{DAY, as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    told(as_file("model.toml", bytes, |path| daily::read(path, "OB", DAY)), &[]);
});
