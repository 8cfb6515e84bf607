//! Any text as a facility file, with a right hash where it states one: what is read has three axes.

#![no_main]

use calfit::files::facility::read;
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let result = as_file("facility.toml", &sealed(bytes), |path| read(path, &mut Vec::new()));
    if let Some(facility) = told(result, &[]) {
        assert!(facility.periods.iter().all(|period| period.part.coil().axes().is_some()));
    }
});
