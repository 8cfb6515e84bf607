//! Any text as a daily offset model.

#![no_main]

use calfit::files::flight::daily;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

/// 2015-06-30, the day of the seed, counted from 1970-01-01.
const DAY: i32 = 16_616;

fuzz_target!(|bytes: &[u8]| {
    told(as_file("model.toml", bytes, |path| daily::read(path, "OB", DAY)), &[]);
});
