//! `lin` is silent about its residuals where there is noise alone.

use super::Size;
use crate::blind;

use blind::kinds::generate;
use blind::noise::Family;
use blind::sensor::Kind;
use calfit::data::plateau::{self, Accumulator};
use calfit::data::run::VectorSink;
use calfit::measure::lin::{Options, lin};
use rayon::prelude::*;

/// The note of `lin` that sends a run to the diagnosis.
fn fired(seed: u64, options: &blind::Options) -> Option<String> {
    let made = generate(seed, Kind::Lin, options).unwrap();
    let (run, vectors) = &made.runs[0];
    let mut sink = Accumulator::default();
    sink.begin(&run.header, &run.settings);
    vectors.iter().for_each(|v| sink.vector(*v));
    let options = Options::default();
    let plateaus = plateau::of_run(run, sink, options.cut);
    let result = lin(run, &plateaus, &made.campaign.file.instructions, &options).unwrap();
    result.notes.iter().map(ToString::to_string).find(|n| n.contains("run calfit diagnose"))
}

/// Eight times what is found in nine of ten runs.
#[test]
fn a_strong_effect_sends_a_run_to_the_diagnosis() {
    let effects = vec!["cubic_nonlinearity".to_owned()];
    let options = blind::Options { effects, strength_k: 80.0, noise: Some(Family::White), ..blind::Options::default() };
    assert!(fired(0, &options).is_some());
}

#[test]
fn clean_runs_are_not_sent_to_the_diagnosis() {
    let count: u64 = Size::asked().of(12, 200);
    for family in [Family::White, Family::PowerLaw] {
        let options = blind::Options { noise: Some(family), ..blind::Options::default() };
        let all: Vec<String> = (0..count).into_par_iter().filter_map(|seed| fired(seed, &options)).collect();
        println!("{}: {} of {count} clean runs fired {all:?}", family.name(), all.len());
        // One in a hundred at most; a few more runs are needed to tell one from none.
        assert!(all.len() as u64 <= count.div_ceil(100), "{}: {all:?}", family.name());
    }
}
