//! Any bytes as a table beside the telemetry; the first byte chooses which one. Parquet where the others begin as such a file does, else CSV.

#![no_main]

use calfit::files::flight::auxiliary::{Attitude, ModelField, Positions, Timed, Timeline, WheelRates, calm, heater};
use calfit::files::flight::times::TimeRule;
use calfit_fuzz::{DAY, LEAP, MISSION, as_file, table_name, told};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

/// Opens a table and reads it over its day.
fn timeline<T: Timed>(path: &Path, stated: T::Stated) {
    if let Some((timeline, _)) = told(Timeline::<T>::open(path, stated, TimeRule::default(), &LEAP), &[]) {
        told(timeline.over(&LEAP.day(DAY), &LEAP), &[]);
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((which, table)) = bytes.split_first() else { return };
    let celestial = || MISSION.celestial.clone().expect("a frame");
    as_file(&table_name("table", table), table, |path| match which {
        b'0' => timeline::<Attitude>(path, celestial()),
        b'1' => timeline::<Positions>(path, celestial().frame),
        b'2' => timeline::<WheelRates>(path, ()),
        b'3' => timeline::<ModelField>(path, celestial().frame),
        b'4' => {
            told(calm(path, TimeRule::default(), &LEAP), &[]);
        }
        _ => {
            told(heater(path, &["h1".to_owned(), "h2".to_owned()], TimeRule::default(), &LEAP), &[]);
        }
    });
});
