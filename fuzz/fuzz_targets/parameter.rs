//! Any text with a right hash as a parameter file of every kind: what is read can be written and read again.

#![no_main]

use calfit::files::parameter::{
    Body, CoilResidual, CoilScalar, CoilTilt, Cpf, Fpf, LinearisationFile, Model, Npf, Opf, Taf, Tcf, ThermistorFile, Tof, Tpf, read,
    read_any, read_point, to_text,
};
use calfit_fuzz::{as_file, sealed, told};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fn kind<B: Body>(path: &Path) {
    let Some(file) = told(read::<B>(path), &[]) else { return };
    // A file by hand may hold nan where the program writes none.
    let Ok(text) = to_text(&file.body, &file.provenance) else { return };
    as_file("again", text.as_bytes(), |path| read::<B>(path).expect("what was written is a parameter file"));
}

fuzz_target!(|bytes: &[u8]| {
    as_file("PARAMETERS", &sealed(bytes), |path| {
        told(read_any(path), &[]);
        let mut findings = Vec::new();
        let point = read_point(path, &mut findings);
        told(point, &findings);
        kind::<Cpf>(path);
        kind::<Opf>(path);
        kind::<Fpf>(path);
        kind::<Npf>(path);
        kind::<Tpf>(path);
        kind::<Tof>(path);
        kind::<Taf>(path);
        kind::<Tcf>(path);
        kind::<CoilScalar>(path);
        kind::<CoilResidual>(path);
        kind::<CoilTilt>(path);
        kind::<LinearisationFile>(path);
        kind::<ThermistorFile>(path);
        kind::<Model>(path);
    });
});
