//! One day of one sensor: telemetry in, levels out.

use super::steps::Steps;
use super::{Carry, FlightOptions, Level, Prepared, day_name};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::provenance::Input;
use crate::data::time::Tt2000;
use crate::files::flight::edited::{self, BEYOND_NS, Rows};
use crate::files::flight::levels::{LevelRows, file_name, partition, write};
use crate::files::output::Folder;
use crate::files::table::long::GROUP_ROWS;
use crate::flight::assemble::{RowCounts, assemble, blocks};
use crate::flight::attitude::positions_km;
use crate::flight::means::{Means, means};
use crate::flight::{Block, Series, Stage};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;

/// What was made of a sensor and day.
#[derive(Clone, Debug, Default, Serialize)]
pub struct DayMade {
    /// Sensor.
    pub sensor: String,
    /// Day, `YYYY-MM-DD`.
    pub day: String,
    /// What was made of the rows.
    #[serde(flatten)]
    pub rows: RowCounts,
    /// Vectors.
    pub written: usize,
    /// Vectors that are null in the last of the levels of single vectors.
    pub null: usize,
    /// Vectors by flag.
    pub flags: BTreeMap<&'static str, usize>,
    /// Levels that were written.
    pub levels: Vec<String>,
    /// Lowest and highest temperature, °C.
    pub degc: Option<[f64; 2]>,
}

/// A day on its way.
struct Day<'a> {
    prepared: &'a Prepared,
    options: &'a FlightOptions,
    sensor: &'a str,
    day: i32,
    span: Range<Tt2000>,
    frames: [String; 3],
    inputs: Vec<Input>,
    made: DayMade,
}

/// Makes the levels of a sensor and day; `None` for a day without vectors.
///
/// # Errors
/// What is wrong with its telemetry, its daily model or a result file.
pub fn make(
    prepared: &Prepared,
    carry: &Carry,
    index: usize,
    day: i32,
    options: &FlightOptions,
) -> Result<Option<DayMade>, Finding> {
    let mission = &prepared.mission;
    let sensor = &mission.sensors[index];
    let span = prepared.leap.day(day);
    let wanted = span.start - BEYOND_NS..span.end + BEYOND_NS;
    let mut rows = Rows::default();
    let mut inputs = Vec::new();
    for file in prepared.files(&sensor.name, &wanted) {
        let read = edited::read(file, sensor, mission, &prepared.leap, &wanted)?;
        if !read.tag.is_empty() {
            let name = file.path.strip_prefix(&mission.folder).unwrap_or(&file.path).to_string_lossy().into_owned();
            inputs.push(edited::hash(file)?.input(name));
        }
        rows.append(read);
    }
    let shifts = mission.steps.iter().any(|s| s == "shift");
    let assembled = assemble(&rows, &sensor.name, mission, &prepared.leap, &span, shifts)
        .map_err(|e| Finding::error(&sensor.name, e.to_string(), "state it in [[mode]]"))?;
    drop(rows);
    if assembled.counts.read == 0 {
        return Ok(None);
    }
    if let Some(model) = prepared.daily(sensor, day)? {
        inputs.push(model.input);
    }
    let made = DayMade {
        sensor: sensor.name.clone(),
        day: day_name(day),
        written: assembled.vectors.len(),
        rows: assembled.counts,
        ..DayMade::default()
    };
    let mut blocks = blocks(assembled.vectors, GROUP_ROWS, mission.uncertainty);
    let steps = Steps::make(prepared, carry, index, &(day..day + 1))?;
    let uvw = prepared.ground[index].as_ref().map_or("sensor axes", |g| g.frame.as_str()).to_owned();
    let celestial = mission.celestial.as_ref().map_or("", |c| c.frame.as_str()).to_owned();
    let frames = [uvw, "spacecraft".to_owned(), celestial];
    let mut this = Day { prepared, options, sensor: &sensor.name, day, span, frames, inputs, made };
    let last = [Stage::C, Stage::B, Stage::A].into_iter().find(|stage| this.needs(*stage));
    for (stage, level, of_means) in
        [(Stage::A, Level::A, Level::E), (Stage::B, Level::B, Level::F), (Stage::C, Level::C, Level::G)]
    {
        if last.is_none_or(|last| stage > last) {
            break;
        }
        blocks.par_iter_mut().for_each(|block| steps.apply(stage, block));
        if this.wants(level) {
            this.write_vectors(level, &blocks)?;
        }
        if this.wants(of_means) {
            let series = series(&blocks);
            let means = means(&series, &this.span, mission.mean_ns);
            this.write_means(of_means, &means, &blocks)?;
        }
    }
    this.count(&blocks);
    Ok(Some(this.made))
}

/// The vectors of blocks as one series.
fn series(blocks: &[Block]) -> Series {
    let mut out = Series::default();
    for block in blocks {
        out.time.extend_from_slice(&block.time);
        (0..3).for_each(|i| out.field_nt[i].extend_from_slice(&block.field[i]));
        out.mode.extend_from_slice(&block.mode);
        out.flags.extend_from_slice(&block.flags);
    }
    out
}

/// Standard uncertainties of the components of covariances.
fn stds(covariances: &[[f32; 6]], shrink: impl Fn(usize) -> f32) -> [Vec<f32>; 3] {
    [0, 3, 5].map(|place| covariances.iter().enumerate().map(|(row, c)| c[place].sqrt() * shrink(row)).collect())
}

impl Day<'_> {
    fn wants(&self, level: Level) -> bool {
        self.options.levels.has(level, self.prepared)
    }

    /// Whether a level that is wanted rests on a stage.
    fn needs(&self, stage: Stage) -> bool {
        let levels: &[Level] = match stage {
            Stage::A => &[Level::A, Level::E],
            Stage::B => &[Level::B, Level::F, Level::K],
            Stage::C => &[Level::C, Level::D, Level::G, Level::H, Level::I, Level::J, Level::L],
        };
        self.options.levels.has_any(levels, self.prepared)
    }

    fn sids(&self) -> Vec<String> {
        self.prepared.mission.modes.iter().map(|mode| mode.sid.clone()).collect()
    }

    fn folder(&self, level: Level) -> Result<Folder, Finding> {
        Folder::open(&self.options.out.join(partition(level.letter(), self.sensor, self.day)), self.options.force)
    }

    fn frame(&self, level: Level) -> &str {
        match level {
            Level::A | Level::E => &self.frames[0],
            Level::B | Level::F | Level::K => &self.frames[1],
            _ => &self.frames[2],
        }
    }

    /// What a file says of itself. Nothing in it depends on when or where it was made.
    fn metadata(&self, level: Level) -> Vec<(String, String)> {
        let mission = &self.prepared.mission;
        let inputs: Vec<Input> = self.prepared.inputs.iter().chain(&self.inputs).cloned().collect();
        let notes: Vec<String> = self.prepared.notes.iter().map(ToString::to_string).collect();
        let json = |value: serde_json::Value| value.to_string();
        let mut list = vec![
            ("level", level.letter().to_owned()),
            ("mission", mission.mission.clone()),
            ("instrument", mission.instrument.clone()),
            ("sensor", self.sensor.to_owned()),
            ("day", day_name(self.day)),
            ("frame", self.frame(level).to_owned()),
            ("units", "bx, by, bz, ua, uc nT; t_degc degC; position km; time_tt2000 ns since 2000-01-01T12:00:00 TT; time_obt s".to_owned()),
            ("time_scale", "time_tt2000 is TT and continuous; time_utc is UTC, 23:59:59.999999999 within a leap second".to_owned()),
            ("convention", "offset_unit=enT offset_acts=before_matrix offset_sign=subtracted".to_owned()),
            (
                "uncertainty",
                "standard, k = 1: ua independent from vector to vector, uc common to all and not falling with averages; spacecraft fields, \
                 jump table and drift since ground are not in it"
                    .to_owned(),
            ),
            ("steps", mission.steps.join(" ")),
            ("counts", json(serde_json::json!({
                "read": self.made.rows.read, "duplicate": self.made.rows.duplicates, "rejected": self.made.rows.rejected,
                "written": self.made.written,
            }))),
            ("notes", json(serde_json::json!(notes))),
            ("inputs", json(serde_json::json!(inputs))),
        ];
        if let Some(([low, high], reason)) = &mission.extended_degc {
            list.push(("extended_degc", format!("{low} to {high}: {reason}")));
        }
        // The mark by which the program knows its own files stands last.
        list.push(("written_by", format!("calfit {}", env!("CARGO_PKG_VERSION"))));
        list.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
    }

    fn positions(&self, level: Level, time: &[Tt2000]) -> Option<[Vec<f64>; 3]> {
        let table = self.prepared.positions.as_ref()?;
        matches!(level, Level::C | Level::G | Level::H | Level::I | Level::L).then(|| positions_km(&table.time, &table.km, time))
    }

    fn write_vectors(&mut self, level: Level, blocks: &[Block]) -> Result<(), Finding> {
        let with_t = matches!(level, Level::A | Level::B | Level::K);
        let uncertainty = self.prepared.mission.uncertainty;
        let rows = |block: &Block| LevelRows {
            time: block.time.clone(),
            obt_s: block.obt_s.clone(),
            field_nt: block.field.clone(),
            t_degc: with_t.then(|| block.t_degc.clone()),
            position_km: self.positions(level, &block.time),
            mode: block.mode.clone(),
            count: None,
            std_nt: uncertainty.then(|| [stds(&block.own_nt2, |_| 1.0), stds(&block.common_nt2, |_| 1.0)]),
            quality: Some(block.quality.clone()),
            flags: block.flags.clone(),
        };
        let name = file_name(level.letter(), self.sensor, self.day);
        let folder = self.folder(level)?;
        write(&folder, &name, blocks.iter().map(rows), &self.sids(), &self.prepared.leap, self.metadata(level))?;
        self.made.levels.push(level.letter().to_owned());
        Ok(())
    }

    fn write_means(&mut self, level: Level, means: &Means, blocks: &[Block]) -> Result<(), Finding> {
        #[expect(clippy::cast_precision_loss, reason = "the clock of a spacecraft has microseconds")]
        let clock = |t: &Tt2000| (t - self.prepared.leap.clock_begin()) as f64 * 1e-9;
        let rows = LevelRows {
            time: means.time.clone(),
            obt_s: means.time.iter().map(clock).collect(),
            field_nt: means.field_nt.clone(),
            t_degc: None,
            position_km: self.positions(level, &means.time),
            mode: means.mode.clone(),
            count: Some(means.count.clone()),
            std_nt: self.prepared.mission.uncertainty.then(|| mean_stds(means, blocks)),
            quality: None,
            flags: means.flags.clone(),
        };
        let name = file_name(level.letter(), self.sensor, self.day);
        let folder = self.folder(level)?;
        write(&folder, &name, std::iter::once(rows), &self.sids(), &self.prepared.leap, self.metadata(level))?;
        self.made.levels.push(level.letter().to_owned());
        Ok(())
    }

    fn count(&mut self, blocks: &[Block]) {
        self.made.null = blocks.iter().map(|b| b.field[0].iter().filter(|v| v.is_nan()).count()).sum();
        for (flag, words) in Flags::ALL {
            let count: usize = blocks.iter().map(|b| b.flags.iter().filter(|f| Flags(**f).any_of(flag)).count()).sum();
            if count > 0 {
                self.made.flags.insert(words, count);
            }
        }
        let degc = blocks.iter().flat_map(|b| &b.t_degc).filter(|t| t.is_finite());
        let ends = degc.fold(None, |ends: Option<[f64; 2]>, t| Some(ends.map_or([*t, *t], |[a, b]| [a.min(*t), b.max(*t)])));
        self.made.degc = ends;
    }
}

/// Uncertainties of means: the independent part falls with the number of vectors, the common one does not.
fn mean_stds(means: &Means, blocks: &[Block]) -> [[Vec<f32>; 3]; 2] {
    let own: Vec<&[f32; 6]> = blocks.iter().flat_map(|b| &b.own_nt2).collect();
    let common: Vec<&[f32; 6]> = blocks.iter().flat_map(|b| &b.common_nt2).collect();
    let mean_of = |list: &[&[f32; 6]], (first, last): (usize, usize), place: usize| -> f32 {
        let there = list.get(first..last).unwrap_or_default().iter().map(|c| f64::from(c[place])).filter(|v| !v.is_nan());
        let (sum, count) = there.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
        #[expect(clippy::cast_possible_truncation, reason = "variances need few digits")]
        let mean = (sum / count) as f32;
        mean
    };
    let std = |list: &[&[f32; 6]], falls: bool| {
        [0, 3, 5].map(|place| {
            let each = means.rows.iter().zip(&means.count).map(|(rows, count)| {
                #[expect(clippy::cast_precision_loss, reason = "vectors of a second")]
                let n = if falls { *count as f32 } else { 1.0 };
                (mean_of(list, *rows, place) / n).sqrt()
            });
            each.collect::<Vec<f32>>()
        })
    };
    [std(&own, true), std(&common, false)]
}
