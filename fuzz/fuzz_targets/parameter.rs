//! Any text with a right hash as a parameter file of every kind: what is read can be written and read again.

#![no_main]

use calfit::files::parameter::{
    Body, CoilResidual, CoilScalar, CoilTilt, Cpf, Fpf, LinearisationFile, Model, Npf, Opf, Taf, Tcf, ThermistorFile, Tof, Tpf, read,
    read_any, read_point, to_text,
};
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fn kind<B: Body>(path: &Path, finite: bool) {
    let Some(file) = told(read::<B>(path), &[]) else { return };
    let Ok(text) = to_text(&file.body, &file.provenance) else { return };
    let again = as_file("again", text.as_bytes(), read::<B>);
    // A file by hand may hold nan where the program leaves a key out.
    if finite {
        again.expect("what was written is a parameter file");
    }
}

fuzz_target!(|bytes: &[u8]| {
    let finite = !["nan", "inf"].iter().any(|word| bytes.windows(word.len()).any(|w| w == word.as_bytes()));
    as_file("PARAMETERS", &sealed(bytes), |path| {
        told(read_any(path), &[]);
        let mut findings = Vec::new();
        let point = read_point(path, &mut findings);
        told(point, &findings);
        kind::<Cpf>(path, finite);
        kind::<Opf>(path, finite);
        kind::<Fpf>(path, finite);
        kind::<Npf>(path, finite);
        kind::<Tpf>(path, finite);
        kind::<Tof>(path, finite);
        kind::<Taf>(path, finite);
        kind::<Tcf>(path, finite);
        kind::<CoilScalar>(path, finite);
        kind::<CoilResidual>(path, finite);
        kind::<CoilTilt>(path, finite);
        kind::<LinearisationFile>(path, finite);
        kind::<ThermistorFile>(path, finite);
        kind::<Model>(path, finite);
    });
});
