//! Any text as the index of a result folder: what is read is judged the same twice.

#![no_main]

use calfit::files::index::read;
use calfit_fuzz::{as_file, told};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    let result = as_file("INDEX.json", bytes, |path| read(path.parent().unwrap_or(Path::new("."))));
    if let Some(Some(mut index)) = told(result, &[]) {
        index.judge();
        let once = index.clone();
        index.judge();
        assert!(index == once);
    }
});
