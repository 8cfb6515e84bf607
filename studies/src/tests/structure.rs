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

#[test]
fn clean_runs_are_not_sent_to_the_diagnosis() {
    let count: u64 = Size::asked().of(12, 200);
    for family in [Family::White, Family::PowerLaw] {
        let fired = |seed: u64| -> Option<String> {
            let options = blind::Options { noise: Some(family), ..blind::Options::default() };
            let made = generate(seed, Kind::Lin, &options).unwrap();
            let (run, vectors) = &made.runs[0];
            let mut sink = Accumulator::default();
            sink.begin(&run.header, &run.settings);
            vectors.iter().for_each(|v| sink.vector(*v));
            let options = Options::default();
            let plateaus = plateau::of_run(run, sink, options.cut);
            let result = lin(run, &plateaus, &made.campaign.file.instructions, &options).unwrap();
            result.notes.iter().map(ToString::to_string).find(|n| n.contains("run calfit diagnose"))
        };
        let all: Vec<String> = (0..count).into_par_iter().filter_map(fired).collect();
        println!("{}: {} of {count} clean runs fired {all:?}", family.name(), all.len());
        // One in a hundred at most; a few more runs are needed to tell one from none.
        assert!(all.len() as u64 <= count.div_ceil(100), "{}: {all:?}", family.name());
    }
}
