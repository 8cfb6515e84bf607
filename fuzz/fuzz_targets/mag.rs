//! Any bytes as a field programme: what is read can be written and read again.

#![no_main]

use calfit::files::mag::{parse, write};
use calfit_fuzz::told;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut findings = Vec::new();
    let result = parse("T.MAG", bytes, &mut findings);
    if let Some(programme) = told(result, &findings) {
        let mut text = Vec::new();
        write(&mut text, &programme).expect("written to memory");
        let again = parse("T.MAG", &text, &mut Vec::new()).expect("what was written is a programme");
        assert_eq!(again.steps.len(), programme.steps.len());
        assert_eq!((again.name, again.kind), (programme.name, programme.kind));
    }
});
