//! Any text as a configuration of flight processing: what it holds or what is wrong with it is told.

#![no_main]

use calfit::files::flight::read_mission;
use calfit_fuzz::{LEAP, as_file, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    told(as_file("flight.toml", bytes, |path| read_mission(path, &LEAP)), &[]);
});
