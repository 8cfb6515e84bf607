//! The short form of the study of interruptions.

use crate::interruptions::{Counts, Scene};
use crate::repository;

#[test]
fn interrupted_reports_leave_whole_files_and_are_mended_by_the_next() {
    // The program lies beside the folder of the tests.
    let program = std::env::current_exe().unwrap().ancestors().nth(2).unwrap().join("calfit");
    if !program.is_file() {
        eprintln!("skipped: {} is not built", program.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::new(&program, &repository("runs/sample"), folder.path()).unwrap();
    let mut list = vec![scene.kills(4, |_| ()).unwrap(), scene.pairs(1, |_| ()).unwrap()];
    if Scene::has_tracer() {
        list.extend(scene.failed_calls(1, |_| ()).unwrap());
        list.extend(scene.killed_at_calls(1, |_| ()).unwrap());
    } else {
        eprintln!("skipped: system calls are made to fail with strace, which is not there");
    }
    let wrong: Vec<&Counts> = list.iter().filter(|counts| !counts.is_clean()).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}
