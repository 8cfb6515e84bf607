//! Any text as a campaign file: what it holds or what is wrong with it is told, and the reader never panics.

#![no_main]

use calfit::files::campaign::file::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = as_file("campaign.toml", bytes, |path| read(path, &mut findings));
    told(result, &findings);
});
