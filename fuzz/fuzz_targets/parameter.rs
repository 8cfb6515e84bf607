//! Any text with a right hash as a parameter file of every kind: what is read can be written and read again.

#![no_main]

use calfit::files::parameter::{KINDS, read_any, read_point};
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let finite = !["nan", "inf"].iter().any(|word| bytes.windows(word.len()).any(|w| w == word.as_bytes()));
    as_file("PARAMETERS", &sealed(bytes), |path| {
        told(read_any(path), &[]);
        let mut findings = Vec::new();
        let point = read_point(path, &mut findings);
        told(point, &findings);
        for kind in KINDS {
            told(kind.check(path), &[]);
            // Values that have no text form are told as such.
            let Ok(text) = kind.rewritten(path) else { continue };
            let again = as_file("again", text.as_bytes(), |path| kind.rewritten(path));
            // A file by hand may hold nan where the program leaves a key out.
            if finite {
                again.expect("what was written is a parameter file");
            }
        }
    });
});
