//! Figures of a day, and the report of all days.

use super::day::Product;
use super::derived::COMMON;
use super::{Level, Prepared, day_name};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::note::Note;
use crate::data::time::Tt2000;
use crate::files::output::Folder;
use crate::files::table::long::{Column, LongWriter};
use crate::fit::spectrum::{Density, of_record};
use crate::flight::Series;
use crate::flight::made::DayMade;
use crate::flight::means::Means;
use crate::plot::flight::{self as figures, Coverage, Extents, Height};
use crate::plot::{self, Figure};
use crate::show::flight::{DayShown, document};
use crate::show::{Drawn, html};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::{Path, PathBuf};

const REPORT: &str = "report";
const DAYS: &str = "days";
const FIGURES: &str = "figures";
/// Length of the segments of a spectrum.
const SEGMENT: usize = 1024;

/// What the program keeps of a day beside its levels, so that the report can be made of days that were made by several processes.
#[derive(Debug, Serialize, Deserialize)]
struct DayRecord {
    written_by: String,
    #[serde(flatten)]
    made: DayMade,
    figures: Vec<Drawn>,
    notes_of_mission: Vec<String>,
}

/// The figures of a sensor and day.
pub struct Pictures<'a> {
    prepared: &'a Prepared,
    sensor: &'a str,
    frame: [&'a str; 3],
    day: i32,
    coverage: Coverage,
    list: Vec<(String, Figure)>,
}

/// Extents of the rows of a day.
fn extents(span: &Range<Tt2000>, rows: impl Iterator<Item = (Tt2000, [f64; 3])>) -> [Extents; 3] {
    let mut out: [Extents; 3] = Default::default();
    let length = (span.end - span.start) as f64;
    for (time, vector) in rows {
        let share = (time - span.start) as f64 / length;
        (0..3).for_each(|i| out[i].take(share, vector[i]));
    }
    out
}

impl<'a> Pictures<'a> {
    /// No figures so far.
    #[must_use]
    pub fn new(prepared: &'a Prepared, sensor: &'a str, frame: [&'a str; 3], day: i32) -> Self {
        Self { prepared, sensor, frame, day, coverage: Coverage::default(), list: Vec::new() }
    }

    /// Takes a level of single vectors.
    pub fn take(&mut self, level: Level, product: &Product<'_>) {
        let Product::Vectors(blocks) = product else { return };
        let span = self.prepared.leap.day(self.day);
        let day = day_name(self.day);
        let rows = blocks.iter().flat_map(|block| {
            let inside = block.rows_in(&span);
            inside.map(|row| (block.time[row], [block.field[0][row], block.field[1][row], block.field[2][row]]))
        });
        self.coverage = Coverage::default();
        for block in blocks.iter() {
            for row in block.rows_in(&span) {
                let share = (block.time[row] - span.start) as f64 / (span.end - span.start) as f64;
                self.coverage.take(share, usize::from(block.mode[row]), Flags(block.flags[row]));
            }
        }
        let (what, frame) = match level {
            Level::A => ("Calibrated field at the sensor", self.frame[0]),
            Level::B => ("Calibrated field", self.frame[1]),
            Level::K => ("Calibrated field without the heater jumps that were found", self.frame[1]),
            Level::H => ("Calibrated field without wheels and lines", self.frame[2]),
            Level::L => ("Calibrated field without the heater jumps that were found", self.frame[2]),
            _ => ("Calibrated field", self.frame[2]),
        };
        let figure = figures::field(level.letter(), what, self.sensor, &day, frame, &extents(&span, rows));
        self.list.push((format!("level_{}", level.letter()), figure));
        if level == Level::A
            && let Some(index) = self.prepared.mission.sensors.iter().position(|s| s.name == self.sensor)
            && let Some(ground) = &self.prepared.ground[index]
        {
            let rows = blocks.iter().flat_map(|b| b.rows_in(&span).map(|row| (b.time[row], [b.t_degc[row]; 3])));
            let [degc, ..] = extents(&span, rows);
            self.list.push(("temperature".to_owned(), figures::temperature(self.sensor, &day, &degc, ground.valid_degc)));
        }
    }

    /// Takes the means of both sensors in axes of the spacecraft.
    pub fn difference(&mut self, names: [&str; 2], first: &Means, second: &Means) {
        let span = self.prepared.leap.day(self.day);
        let pairs = crate::flight::two_sensors::common_times(&first.time, &second.time);
        let difference =
            |[a, b]: &[usize; 2]| (first.time[*a], [0, 1, 2].map(|i| first.field_nt[i][*a] - second.field_nt[i][*b]));
        let figure = figures::difference(names, &day_name(self.day), &extents(&span, pairs.iter().map(difference)));
        self.list.push(("level_D".to_owned(), figure));
    }

    /// Takes what is to be seen of wheels and heaters in what was made.
    pub fn facts(&mut self, made: &DayMade, spectra: &[(String, Density, Density)]) {
        let day = day_name(self.day);
        let modes: Vec<&str> = self.prepared.mission.modes.iter().map(|mode| mode.sid.as_str()).collect();
        self.list.insert(0, ("coverage".to_owned(), self.coverage.figure(self.sensor, &day, &modes)));
        for (mode, before, after) in spectra {
            self.list.push((format!("wheels_{mode}"), figures::spectra(self.sensor, &day, mode, before, after)));
        }
        if made.jumps.is_empty() {
            return;
        }
        let begin = self.prepared.leap.day(self.day).start;
        let classes: Vec<String> = made.heater.iter().map(|h| h.name.clone()).collect();
        let of = |class: &String| {
            let own = made.jumps.iter().filter(|jump| jump.class == *class);
            own.filter_map(|jump| Some(((jump.time_tt2000 - begin) as f64 / 3.6e12, jump.height_nt?, jump.std_nt?))).collect()
        };
        let heights: Vec<Vec<Height>> = classes.iter().map(of).collect();
        self.list.push(("heater_jumps".to_owned(), figures::jumps(self.sensor, &day, &classes, &heights)));
    }

    /// Draws them, and writes them with what was made of the day.
    ///
    /// # Errors
    /// A figure that cannot be drawn; what the operating system says.
    pub fn write(self, made: &DayMade, out: &Path, force: bool) -> Result<(), Finding> {
        let compact = made.day.replace('-', "");
        let report = out.join(REPORT);
        let folder = Folder::open(&report.join(FIGURES), force)?;
        let drawn: Vec<Result<Vec<u8>, plot::PlotError>> = self.list.par_iter().map(|(_, figure)| plot::render(figure)).collect();
        let mut figures = Vec::new();
        for ((stem, figure), picture) in self.list.into_iter().zip(drawn) {
            let file = format!("{stem}__{}_{compact}.png", made.sensor);
            let picture = picture.map_err(|e| Finding::error(&file, e.to_string(), "run again with --no-plots"))?;
            folder.write(&file, &picture)?;
            figures.push(Drawn { file, title: figure.title, caption: figure.caption });
        }
        let of = Some(made.sensor.as_str()).filter(|sensor| *sensor != COMMON);
        let record = DayRecord {
            written_by: format!("calfit {}", env!("CARGO_PKG_VERSION")),
            made: made.clone(),
            figures,
            notes_of_mission: self.prepared.notes_of(of).iter().map(ToString::to_string).collect(),
        };
        let name = format!("{compact}_{}.json", made.sensor);
        let mut text = serde_json::to_string_pretty(&record)
            .map_err(|e| Finding::error(&name, format!("has no JSON form: {e}"), "report this"))?;
        text.push('\n');
        Folder::open(&report.join(DAYS), force)?.write(&name, text.as_bytes())
    }
}

/// The spectra of a mode on a day before and after wheels were taken off; `None` where the stretches are too short.
#[must_use]
pub fn spectra(before: &Series, after: &Series, day: &Range<Tt2000>, mode: u8, rate_hz: f64) -> Option<(Density, Density)> {
    let rows: Vec<usize> =
        (0..before.time.len()).filter(|row| before.mode[*row] == mode && day.contains(&before.time[*row])).collect();
    let pick = |series: &Series| series.field_nt.each_ref().map(|c| rows.iter().map(|row| c[*row]).collect::<Vec<f64>>());
    let of = |record: [Vec<f64>; 3]| of_record(record.each_ref().map(Vec::as_slice), rate_hz, SEGMENT);
    Some((of(pick(before))?, of(pick(after))?))
}

/// Reads the record of a day.
fn record(path: &Path) -> Result<DayRecord, Finding> {
    let text = std::fs::read(path).map_err(|e| Finding::io(path, "read", &e))?;
    serde_json::from_slice(&text)
        .map_err(|e| Finding::error(&path.display().to_string(), format!("is no record of a day: {e}"), "make the day again"))
}

/// Checks the record of a day.
///
/// # Errors
/// A file that cannot be read or is none.
pub fn check_day(path: &Path) -> Result<(), Finding> {
    record(path).map(drop)
}

/// Writes the report of all days that stand in a folder of results, with further notes: the page, whose path is returned, and the table of heater
/// jumps; `None` where there are no days.
///
/// # Errors
/// A record of a day that cannot be read; what the operating system says.
pub fn report(prepared: &Prepared, further: &[Note], out: &Path, force: bool) -> Result<Option<PathBuf>, Finding> {
    let folder = out.join(REPORT);
    let Ok(entries) = std::fs::read_dir(folder.join(DAYS)) else { return Ok(None) };
    let mut names: Vec<String> = entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.retain(|name| name.ends_with(".json") && !name.starts_with('.'));
    names.sort_unstable();
    let mut days: Vec<DayShown> = Vec::new();
    let mut notes = Vec::new();
    for name in names {
        let record = record(&folder.join(DAYS).join(&name))?;
        notes.extend(record.notes_of_mission);
        days.push((record.made, record.figures));
    }
    notes.extend(further.iter().map(ToString::to_string));
    let mission = &prepared.mission;
    let document = document(&mission.mission, &mission.instrument, &notes, &days);
    let page = html::page(&document, &mut |file| std::fs::read(folder.join(file)).ok());
    let target = Folder::open(&folder, force)?;
    target.write("REPORT.html", page.as_bytes())?;
    if days.iter().any(|(day, _)| !day.jumps.is_empty()) {
        jumps(&days, &target)?;
    }
    Ok(Some(folder.join("REPORT.html")))
}

/// The table of all heater jumps.
fn jumps(days: &[DayShown], folder: &Folder) -> Result<(), Finding> {
    let mut words: Vec<String> = Vec::new();
    let mut code = |word: &str| -> u8 {
        let at = words.iter().position(|w| w == word).unwrap_or_else(|| {
            words.push(word.to_owned());
            words.len() - 1
        });
        u8::try_from(at).unwrap_or(u8::MAX)
    };
    let (mut time, mut sensor, mut class, mut on) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut height: [Vec<f64>; 3] = Default::default();
    let mut std: [Vec<f64>; 3] = Default::default();
    for (day, _) in days {
        for jump in &day.jumps {
            time.push(jump.time_tt2000);
            sensor.push(code(&day.sensor));
            class.push(code(&jump.class));
            on.push(u8::from(jump.on));
            for i in 0..3 {
                height[i].push(jump.height_nt.map_or(f64::NAN, |h| h[i]));
                std[i].push(jump.std_nt.map_or(f64::NAN, |s| s[i]));
            }
        }
    }
    let mut columns = vec![
        ("time_tt2000", Column::Whole(&time)),
        ("sensor", Column::Words(&sensor, &words)),
        ("cls", Column::Words(&class, &words)),
        ("on", Column::Bytes(&on)),
    ];
    columns.extend(["x_nt", "y_nt", "z_nt"].into_iter().zip(&height).map(|(n, c)| (n, Column::Numbers(c))));
    columns.extend(["u_x_nt", "u_y_nt", "u_z_nt"].into_iter().zip(&std).map(|(n, c)| (n, Column::Numbers(c))));
    let says = vec![
        ("frame".to_owned(), "spacecraft".to_owned()),
        ("written_by".to_owned(), format!("calfit {}", env!("CARGO_PKG_VERSION"))),
    ];
    let mut file = folder.create("heater_jumps.parquet")?;
    let mut writer = LongWriter::new(&mut file, &columns, says)?;
    writer.write(&columns)?;
    writer.finish()?;
    file.finish().map(drop)
}
