//! Any bytes as a file of telemetry, in a partition of its day and beside it: Parquet where they begin as such a file does, else CSV.

#![no_main]

use calfit::files::flight::edited::{self, EditedFile};
use calfit_fuzz::{DAY, LEAP, MISSION, as_file, table_name, told};
use libfuzzer_sys::fuzz_target;

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
