//! The levels of a day as files.

use super::day::Product;
use super::{Level, Prepared, day_name};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::provenance::Input;
use crate::data::time::{SECOND_NS, Tt2000};
use crate::files::flight::auxiliary::Positions;
use crate::files::flight::levels::{LevelRows, Shared, file_name, partition, write};
use crate::files::flight::mission::{MeansFrame, RangeMatrix, Sensor, Span};
use crate::files::flight::text;
use crate::files::output::Folder;
use crate::flight::Block;
use crate::flight::attitude::{impossible_positions, positions_km};
use crate::flight::made::DayMade;
use crate::flight::means::Means;
use std::borrow::Cow;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;

/// The name of the axes of the spacecraft in files.
const SPACECRAFT: &str = "spacecraft";

/// Writes the levels of a sensor and day.
pub struct DayWriter<'a> {
    /// The mission.
    pub prepared: &'a Prepared,
    /// Positions about the day.
    pub positions: Option<Arc<Positions>>,
    /// Whether vectors without a position were told.
    pub told: Cell<bool>,
    /// Folder of the results.
    pub out: &'a Path,
    /// Foreign files are written over.
    pub force: bool,
    /// The sensor, or what stands in its place.
    pub sensor: &'a str,
    /// Frame of level A in words.
    pub uvw: &'a str,
    /// Day, counted from 1970-01-01.
    pub day: i32,
    /// What the levels of single vectors have in common.
    pub shared: RefCell<Shared>,
    /// Files on their way to the disk, which is waited for while further levels are made.
    pub closing: RefCell<Vec<JoinHandle<Result<(), Finding>>>>,
}

impl DayWriter<'_> {
    /// Writes a level.
    ///
    /// # Errors
    /// What the operating system says, or a name that is taken.
    pub fn take(&self, level: Level, product: &Product<'_>, inputs: &[Input], made: &mut DayMade) -> Result<(), Finding> {
        let span = self.prepared.leap.day(self.day);
        self.tell_positions(level, product, &span, made);
        let metadata = self.metadata(level, inputs, made, &Written::of_product(product, &span));
        match product {
            Product::Vectors(blocks) => {
                let groups = || {
                    let own = blocks.iter().map(|block| (block, block.rows_in(&span))).filter(|(_, rows)| !rows.is_empty());
                    own.map(|(block, rows)| self.vectors(level, block, rows))
                };
                self.text(level, groups(), &metadata)?;
                self.write_file(level, groups(), metadata, Some(&mut *self.shared.borrow_mut()))?;
            }
            Product::Means(means, blocks) => self.write(level, self.means(level, means, blocks), metadata)?,
        }
        made.levels.push(level.letter().to_owned());
        Ok(())
    }

    /// A note on vectors beyond the ends of the table of positions, with the first level that has positions.
    fn tell_positions(&self, level: Level, product: &Product<'_>, day: &std::ops::Range<Tt2000>, made: &mut DayMade) {
        let Some(table) = self.positions.as_ref().filter(|_| level.is_celestial() && !self.told.get()) else { return };
        let ends = table.time.first().zip(table.time.last());
        let beyond = |time: &&Tt2000| ends.is_none_or(|(first, last)| !(first..=last).contains(time));
        let (count, of) = match product {
            Product::Vectors(blocks) => blocks.iter().fold((0, 0), |(count, of), block| {
                let own = &block.time[block.rows_in(day)];
                (count + own.iter().filter(beyond).count(), of + own.len())
            }),
            Product::Means(means, _) => (means.time.iter().filter(beyond).count(), means.time.len()),
        };
        if count > 0 {
            made.notes
                .push(format!("{count} of {of} rows of level {} have no position: they are beyond the table", level.letter()));
        }
        made.notes.extend(impossible_positions(&table.time, &table.km));
        self.told.set(true);
    }

    /// Writes rows as a level, and as text where the mission wants it.
    ///
    /// # Errors
    /// What the operating system says, or a name that is taken.
    pub fn write(&self, level: Level, rows: LevelRows<'_>, metadata: Vec<(String, String)>) -> Result<(), Finding> {
        self.text(level, std::iter::once_with(|| rows.clone()), &metadata)?;
        self.write_file(level, std::iter::once(rows), metadata, None)
    }

    fn write_file<'a>(
        &self,
        level: Level,
        groups: impl Iterator<Item = LevelRows<'a>>,
        metadata: Vec<(String, String)>,
        shared: Option<&mut Shared>,
    ) -> Result<(), Finding> {
        let folder = Folder::open(&self.out.join(partition(level.letter(), self.sensor, self.day)), self.force)?;
        let sids: Vec<String> = self.prepared.mission.modes.iter().map(|mode| mode.sid.clone()).collect();
        let name = file_name(level.letter(), self.sensor, self.day);
        let file = write(&folder, &name, groups, &sids, &self.prepared.leap, metadata, shared)?;
        self.closing.borrow_mut().push(std::thread::spawn(|| file.finish().map(drop)));
        Ok(())
    }

    /// Waits until all files stand under their names.
    ///
    /// # Errors
    /// What the operating system says of the first one that does not.
    pub fn finish(self) -> Result<(), Finding> {
        let place = || Finding::error(&self.out.display().to_string(), "a file was not finished", "try again");
        let all = self.closing.borrow_mut().drain(..).map(|one| one.join().unwrap_or_else(|_| Err(place()))).collect::<Vec<_>>();
        all.into_iter().collect()
    }

    /// The same as text, where the mission wants it.
    fn text<'a>(
        &self,
        level: Level,
        groups: impl Iterator<Item = LevelRows<'a>>,
        says: &[(String, String)],
    ) -> Result<(), Finding> {
        let mission = &self.prepared.mission;
        if !mission.text {
            return Ok(());
        }
        let folder = Folder::open(&self.out.join(partition(level.letter(), self.sensor, self.day)), self.force)?;
        let stem = text::stem(&mission.instrument, level.letter(), self.sensor, self.day);
        text::write(&folder, &stem, groups, &self.prepared.leap, says)
    }

    fn frame(&self, level: Level) -> &str {
        match level {
            Level::A | Level::E => self.uvw,
            Level::B | Level::F | Level::K => SPACECRAFT,
            Level::J => match self.prepared.mission.common.frame() {
                MeansFrame::Sensor => "sensor",
                MeansFrame::Spacecraft => SPACECRAFT,
                MeansFrame::Celestial => self.frame(Level::G),
            },
            _ => self.prepared.mission.celestial.as_ref().map_or("", |c| c.frame.as_str()),
        }
    }

    /// What a file says of itself. Nothing in it depends on when or where it was made.
    #[must_use]
    pub fn metadata(&self, level: Level, inputs: &[Input], made: &DayMade, written: &Written) -> Vec<(String, String)> {
        let mission = &self.prepared.mission;
        let inputs: Vec<&Input> = self.prepared.inputs.iter().chain(inputs).collect();
        let notes: Vec<String> = self.prepared.notes.iter().map(ToString::to_string).chain(made.notes.iter().cloned()).collect();
        let rows = &made.rows;
        let counts = serde_json::json!({
            "read": rows.read, "duplicate": rows.duplicates, "conflicting": rows.conflicts, "rejected": rows.rejected,
            "null": written.null, "written": written.rows, "sensor_bit_of_another": rows.contradicting,
        });
        let mut list = vec![
            ("level", level.letter().to_owned()),
            ("mission", mission.mission.clone()),
            ("instrument", mission.instrument.clone()),
            ("sensor", self.sensor.to_owned()),
            ("day", day_name(self.day)),
            ("frame", self.frame(level).to_owned()),
            ("units", UNITS.to_owned()),
            ("time_scale", TIME_SCALE.to_owned()),
            ("convention", self.convention()),
            ("uncertainty", UNCERTAINTY.to_owned()),
            ("steps", mission.steps.join(" ")),
            ("counts", counts.to_string()),
            ("notes", serde_json::json!(notes).to_string()),
            ("inputs", serde_json::json!(inputs).to_string()),
        ];
        if let Some(([low, high], reason)) = &mission.extended_degc {
            list.push(("extended_degc", format!("{low} to {high}: {reason}")));
        }
        if let Some(celestial) = mission.celestial.as_ref().filter(|_| level.is_celestial()) {
            list.push(("attitude_std_rad", format!("{:e}", celestial.std_rad)));
        }
        // The mark by which the program knows its own files stands last.
        list.push(("written_by", format!("calfit {}", env!("CARGO_PKG_VERSION"))));
        list.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
    }

    /// How the offset of the sensor acts; of what two sensors share, that of both.
    fn convention(&self) -> String {
        let sensors = &self.prepared.mission.sensors;
        let own: Vec<&Sensor> = sensors.iter().filter(|sensor| sensor.name == self.sensor).collect();
        let list = if own.is_empty() { sensors.iter().collect() } else { own };
        let said = list.into_iter().map(|sensor| (sensor.name.clone(), self.convention_of(sensor))).collect();
        one_or_each(said)
    }

    /// How the offset of a sensor acts on the day: that of ground files always in one way, that of matrices as each states.
    fn convention_of(&self, sensor: &Sensor) -> String {
        let leap = &self.prepared.leap;
        let day = leap.day(self.day);
        let day = Span { from: day.start, to: day.end };
        let of_matrix = |matrix: &RangeMatrix| {
            let range = matrix.range.map_or_else(String::new, |range| format!("range {range} "));
            let when = format!("{range}from {} to {}", leap.utc(matrix.span.from), leap.utc(matrix.span.to));
            (when, if matrix.added { ADDED_BEHIND } else { SUBTRACTED_BEFORE }.to_owned())
        };
        let said: Vec<(String, String)> = sensor.matrices.iter().filter(|m| m.span.meets(&day)).map(of_matrix).collect();
        if said.is_empty() { SUBTRACTED_BEFORE.to_owned() } else { one_or_each(said) }
    }

    fn positions(&self, level: Level, time: &[Tt2000]) -> Option<[Vec<f64>; 3]> {
        let table = self.positions.as_ref()?;
        level.is_celestial().then(|| positions_km(&table.time, &table.km, time))
    }

    fn vectors<'a>(&self, level: Level, block: &'a Block, rows: std::ops::Range<usize>) -> LevelRows<'a> {
        let with_t = matches!(level, Level::A | Level::B | Level::K);
        let std = |list: &[[f32; 6]]| {
            let own = list.get(rows.clone()).unwrap_or_default();
            PLACES.map(|place| own.iter().map(|c| c[place].sqrt()).collect())
        };
        let time = &block.time[rows.clone()];
        LevelRows {
            time: Cow::Borrowed(time),
            obt_s: Cow::Borrowed(&block.obt_s[rows.clone()]),
            field_nt: block.field.each_ref().map(|c| Cow::Borrowed(&c[rows.clone()])),
            t_degc: with_t.then(|| Cow::Borrowed(&block.t_degc[rows.clone()])),
            position_km: self.positions(level, time),
            mode: Cow::Borrowed(&block.mode[rows.clone()]),
            count: None,
            std_nt: self.prepared.mission.uncertainty.then(|| [std(&block.own_nt2), std(&block.common_nt2)]),
            quality: Some(Cow::Borrowed(&block.quality[rows.clone()])),
            flags: Cow::Borrowed(&block.flags[rows.clone()]),
        }
    }

    fn means<'a>(&self, level: Level, means: &'a Means, blocks: &[Block]) -> LevelRows<'a> {
        LevelRows {
            time: Cow::Borrowed(&means.time),
            obt_s: self.clock(&means.time).into(),
            field_nt: means.field_nt.each_ref().map(|c| Cow::Borrowed(c.as_slice())),
            t_degc: None,
            position_km: self.positions(level, &means.time),
            mode: Cow::Borrowed(&means.mode),
            count: Some(Cow::Borrowed(&means.count)),
            std_nt: self.prepared.mission.uncertainty.then(|| means.covariances_nt2(blocks).each_ref().map(|c| stds_nt(c))),
            quality: Some(Cow::Owned(means.quality(blocks))),
            flags: Cow::Borrowed(&means.flags),
        }
    }

    /// The clock of the spacecraft at times.
    #[must_use]
    pub fn clock(&self, times: &[Tt2000]) -> Vec<f64> {
        let begin = self.prepared.leap.clock_begin();
        #[expect(clippy::cast_precision_loss, reason = "the clock of a spacecraft has microseconds")]
        times.iter().map(|t| (t - begin) as f64 / SECOND_NS as f64).collect()
    }
}

/// An offset of a ground calibration, and one of a matrix with `offset_sign = "subtracted"`.
const SUBTRACTED_BEFORE: &str = "offset_unit=enT offset_acts=before_matrix offset_sign=subtracted";
/// One of a matrix with `offset_sign = "added"`.
const ADDED_BEHIND: &str = "offset_unit=nT offset_acts=behind_matrix offset_sign=added";

/// What is said of all of some things alike, once; otherwise of each with its name.
fn one_or_each(said: Vec<(String, String)>) -> String {
    match said.first() {
        Some((_, first)) if said.iter().all(|(_, words)| words == first) => first.clone(),
        _ => said.iter().map(|(name, words)| format!("{name}: {words}")).collect::<Vec<_>>().join("; "),
    }
}

/// What a file holds: its rows, and those of them that are null by the first reason that their flags give.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Rows.
    pub rows: usize,
    /// Null ones by their reason.
    pub null: BTreeMap<&'static str, usize>,
}

impl Written {
    /// Counts values with their flags.
    #[must_use]
    pub fn of(rows: impl Iterator<Item = (f64, u32)>) -> Self {
        const REASONS: [Flags; 5] = [Flags::NO_TEMPERATURE, Flags::TEMPERATURE, Flags::TIME, Flags::ROTATION, Flags::ATTITUDE];
        let mut found = Self::default();
        for (value, flags) in rows {
            found.rows += 1;
            if value.is_nan() {
                let reason = REASONS.into_iter().find(|reason| Flags(flags).any_of(*reason));
                let words =
                    reason.and_then(|reason| Flags::ALL.into_iter().find(|(flag, _)| *flag == reason)).map(|(_, words)| words);
                *found.null.entry(words.unwrap_or("no vector")).or_default() += 1;
            }
        }
        found
    }

    fn of_product(product: &Product<'_>, day: &std::ops::Range<Tt2000>) -> Self {
        match product {
            Product::Vectors(blocks) => Self::of(blocks.iter().flat_map(|block| {
                let inside = block.rows_in(day);
                inside.map(|row| (block.field[0][row], block.flags[row]))
            })),
            Product::Means(means, _) => Self::of(means.field_nt[0].iter().copied().zip(means.flags.iter().copied())),
        }
    }
}

/// Places of the variances of x, y, z among the elements of a covariance.
const PLACES: [usize; 3] = [0, 3, 5];

const UNITS: &str =
    "bx, by, bz, ua, uc nT; t_degc degC; position km; time_tt2000 ns since 2000-01-01T12:00:00 TT; time_obt s since 2003-01-01";
const TIME_SCALE: &str = "time_tt2000 is TT and continuous; time_utc is UTC, 23:59:59.999999999 within a leap second";
const UNCERTAINTY: &str = "standard, k = 1: ua independent from vector to vector, uc common to all vectors and not falling with averages; \
    fields of the spacecraft, the table of jumps, the attitude and drift since the ground calibration are not in it";

/// Standard uncertainties of the components, nT, from covariances in the order of `SYMMETRIC`.
pub fn stds_nt(covariances_nt2: &[[f64; 6]]) -> [Vec<f32>; 3] {
    #[expect(clippy::cast_possible_truncation, reason = "uncertainties need few digits")]
    let std = |place: usize| covariances_nt2.iter().map(|c| c[place].sqrt() as f32).collect();
    PLACES.map(std)
}
