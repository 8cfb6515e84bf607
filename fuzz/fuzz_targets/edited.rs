//! Any bytes as a file of telemetry, in a partition of its day and beside it: Parquet where they begin as such a file does, else CSV.

#![no_main]

use calfit::data::time::LeapSeconds;
use calfit::files::flight::edited::{self, EditedFile};
use calfit::files::flight::mission::Mission;
use calfit::files::flight::read_mission;
use calfit_fuzz::{as_file, table_name, told};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

/// 2015-06-30, the day of the seeds, counted from 1970-01-01.
const DAY: i32 = 16_616;

static LEAP: LazyLock<LeapSeconds> = LazyLock::new(LeapSeconds::default);
static MISSION: LazyLock<Mission> = LazyLock::new(|| {
    let text = include_bytes!("../seeds/mission/rosetta.toml");
    as_file("flight.toml", text, |path| read_mission(path, &LEAP)).expect("a configuration").0
});

fuzz_target!(|bytes: &[u8]| {
    as_file(&table_name("telemetry", bytes), bytes, |path| {
        for day in [Some(DAY), None] {
            let file = EditedFile { day, path: path.to_owned() };
            told(edited::read_times(&file, &MISSION, &LEAP), &[]);
            let span = LEAP.day(DAY);
            for sensor in &MISSION.sensors {
                told(edited::read(&file, sensor, &MISSION, &LEAP, [&span]), &[]);
            }
        }
    });
});
