//! The first pass: what one day needs of the others, so that days can be made in any order (RO-IGEP-TR0028 section 4.2.3.3).

use super::derived::heater_classes;
use super::near::{Edges, Near};
use super::steps::{limits, thermometer};
use super::{Prepared, day_name};
use crate::data::error::Finding;
use crate::data::time::{SECOND_NS, Tt2000, day_of};
use crate::files::flight::edited::{self, BEYOND_NS, Rows};
use crate::files::flight::mission::{Mission, Sensor};
use crate::files::output::Folder;
use crate::files::table::long::{Column, LongWriter};
use crate::files::table::series::SeriesTable;
use crate::flight::Block;
use crate::flight::assemble::assemble;
use crate::flight::daily::{Continuity, DayEnds, Joined, continuity};
use crate::flight::heater::HeaterClass;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What the first pass found of a sensor and day.
#[derive(Clone, Debug, PartialEq)]
pub struct CarryRow {
    /// Sensor.
    pub sensor: String,
    /// Day, counted from 1970-01-01.
    pub day: i32,
    /// Corrected times of the first and the last accepted vector.
    pub time: [Tt2000; 2],
    /// Temperatures there, °C; nan without a thermistor.
    pub degc: [f64; 2],
    /// What joins its model to those of the days before.
    pub continuity: Continuity,
    /// Names of the modes that its vectors have, with blanks between them; empty until [`Carry::find_modes`].
    pub modes: String,
    /// A daily model acts on it, which is joined to those of other days; the other days are there so that the table has all of them.
    pub has_model: bool,
}

/// The first pass of a mission.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Carry {
    /// Days in order, sensor by sensor.
    pub rows: Vec<CarryRow>,
    /// What heaters add to the field of every sensor.
    pub heater: BTreeMap<String, Vec<HeaterClass>>,
    /// Days whose continuity is not known, by sensor, with the reason: a day before them cannot be read, or its model does not hold at its end.
    pub unknown: BTreeMap<(String, i32), String>,
    /// SHA-256 of the configuration that it was made of.
    pub configuration: String,
}

const COLUMNS: [&str; 3] = ["s_x_nt", "s_y_nt", "s_z_nt"];
/// Changes of these sums if all temperatures are higher by one kelvin.
const SLOPES: [&str; 3] = ["s_x_nt_per_k", "s_y_nt_per_k", "s_z_nt_per_k"];
/// Variance of the offset of the first vector, where its day is joined to the one before.
const VARIANCES: [&str; 3] = ["s_variance_x_nt2", "s_variance_y_nt2", "s_variance_z_nt2"];

impl Carry {
    /// What joins a day with vectors of a sensor to those before; nothing in a mission without continuity.
    ///
    /// # Errors
    /// A day whose `S_d` is not known.
    pub fn continuity(&self, mission: &Mission, sensor: &str, day: i32) -> Result<Continuity, Finding> {
        if !mission.continuity {
            return Ok(Continuity::default());
        }
        if let Some(row) = self.rows.iter().find(|row| row.has_model && row.sensor == sensor && row.day == day) {
            return Ok(row.continuity);
        }
        let name = format!("{sensor} {}", day_name(day));
        Err(match self.unknown.get(&(sensor.to_owned(), day)) {
            Some(reason) => {
                let rule = format!("how the model goes on at midnight is not known from a day before it: {reason}");
                Finding::error(&name, rule, "mend that day, or let a [[campaign]] begin behind it")
            }
            None => {
                let rule = "is not in the table of the first pass";
                Finding::error(&name, rule, "make the table again with `calfit flight carry`")
            }
        })
    }

    /// The day before a day whose constants begin anew, where nothing but a gap in the telemetry says so.
    #[must_use]
    pub fn broken_off(&self, mission: &Mission, sensor: &str, day: i32) -> Option<&CarryRow> {
        let place = self.rows.iter().position(|row| row.has_model && row.sensor == sensor && row.day == day)?;
        let row = &self.rows[place];
        let before = self.rows[..place].iter().rfind(|before| before.has_model).filter(|before| before.sensor == sensor)?;
        let is_new_campaign = mission.campaigns.iter().any(|span| (before.time[1] + 1..=row.time[0]).contains(&span.from));
        (mission.continuity && row.continuity.joined.is_none() && !is_new_campaign).then_some(before)
    }

    /// Refuses a table that was made of another configuration or of other telemetry.
    ///
    /// # Errors
    /// Why it is not the one of the day.
    pub fn is_of(&self, sensor: &str, day: i32, first: Tt2000, last: Tt2000) -> Result<(), Finding> {
        // Nothing of a day without a model rests on the table.
        match self.rows.iter().find(|row| row.has_model && row.sensor == sensor && row.day == day) {
            Some(row) if row.time != [first, last] => {
                let rule =
                    "the table of the first pass was made of other telemetry: the first or the last vector of the day differs";
                let name = format!("{sensor} {}", day_name(day));
                Err(Finding::error(&name, rule, "make the table again with `calfit flight carry`"))
            }
            _ => Ok(()),
        }
    }

    /// Looks at all days of a mission whose sensors have daily models, and with `heater` at all intervals of heaters.
    ///
    /// # Errors
    /// What is wrong with a file of telemetry or a daily model.
    pub fn find(prepared: &Prepared, heater: bool) -> Result<Self, Finding> {
        let mut carry = Self::of_days(prepared)?;
        if heater {
            for (index, sensor) in prepared.mission.sensors.iter().enumerate() {
                let classes = heater_classes(prepared, &carry, index)?;
                carry.heater.extend(classes.map(|classes| (sensor.name.clone(), classes)));
            }
        }
        Ok(carry)
    }

    fn of_days(prepared: &Prepared) -> Result<Self, Finding> {
        let mission = &prepared.mission;
        let mut carry = Self { configuration: prepared.configuration.clone(), ..Self::default() };
        let has_daily = |sensor: &Sensor| sensor.daily.is_some() && mission.steps.iter().any(|s| s == "daily");
        if !mission.continuity {
            return Ok(carry);
        }
        let sensors: Vec<usize> = (0..mission.sensors.len()).filter(|index| has_daily(&mission.sensors[*index])).collect();
        let found: Vec<Days> = sensors.par_iter().map(|index| days_of(prepared, *index)).collect::<Result<_, Finding>>()?;
        for Days { rows, unknown } in found {
            carry.rows.extend(rows);
            carry.unknown.extend(unknown);
        }
        Ok(carry)
    }

    /// Looks at the days that have vectors and no daily model as well, of which nothing in the levels depends.
    ///
    /// # Errors
    /// What is wrong with a folder of telemetry.
    pub fn find_others(&mut self, prepared: &Prepared) -> Result<(), Finding> {
        let sensors = &prepared.mission.sensors;
        let with_model = self.rows.iter().map(|row| (row.sensor.clone(), row.day));
        let known: BTreeSet<(String, i32)> = with_model.chain(self.unknown.keys().cloned()).collect();
        let others: Vec<Vec<CarryRow>> =
            (0..sensors.len()).into_par_iter().map(|index| others_of(prepared, index, &known)).collect::<Result<_, Finding>>()?;
        self.rows.extend(others.into_iter().flatten());
        let place = |name: &str| sensors.iter().position(|sensor| sensor.name == name);
        self.rows.sort_by_key(|row| (place(&row.sensor), row.day));
        Ok(())
    }

    /// Looks at the modes of all vectors, of which nothing in the levels depends.
    ///
    /// # Errors
    /// What is wrong with a file of telemetry.
    pub fn find_modes(&mut self, prepared: &Prepared) -> Result<(), Finding> {
        let mission = &prepared.mission;
        self.rows.par_iter_mut().try_for_each(|row| {
            let Some(sensor) = mission.sensors.iter().find(|sensor| sensor.name == row.sensor) else { return Ok(()) };
            let span = prepared.leap.day(row.day);
            let mut modes: Vec<u8> = Vec::new();
            for file in prepared.files(&sensor.name, &span) {
                match edited::modes_in(file, sensor, mission, &prepared.leap, &span) {
                    Ok(found) => modes.extend(found),
                    // A damaged neighbour is told with its own day.
                    Err(_) if file.day.is_some_and(|own| own != row.day) => {}
                    Err(finding) => return Err(finding),
                }
            }
            modes.sort_unstable();
            modes.dedup();
            let names = modes.iter().filter_map(|mode| mission.modes.get(usize::from(*mode))).map(|mode| mode.sid.as_str());
            row.modes = names.collect::<Vec<_>>().join(" ");
            Ok(())
        })
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn write(&self, folder: &Folder, name: &str) -> Result<(), Finding> {
        let (codes, sensors) = coded(self.rows.iter().map(|row| &row.sensor));
        let (mode_codes, modes) = coded(self.rows.iter().map(|row| &row.modes));
        let day_codes: Vec<i64> = self.rows.iter().map(|row| i64::from(row.day)).collect();
        let dates: Vec<i64> = day_codes.iter().map(|day| day * 86_400 * SECOND_NS).collect();
        let number = |of: &dyn Fn(&CarryRow) -> f64| -> Vec<f64> { self.rows.iter().map(of).collect() };
        let whole = |of: &dyn Fn(&CarryRow) -> i64| -> Vec<i64> { self.rows.iter().map(of).collect() };
        let (first, last) = (whole(&|r| r.time[0]), whole(&|r| r.time[1]));
        let (t_first, t_last) = (number(&|r| r.degc[0]), number(&|r| r.degc[1]));
        let s: [Vec<f64>; 3] = [0, 1, 2].map(|i| number(&|r| r.continuity.sum_nt[i]));
        let slopes: [Vec<f64>; 3] = [0, 1, 2].map(|i| number(&|r| r.continuity.sum_nt_per_k[i]));
        let variances: [Vec<f64>; 3] = [0, 1, 2].map(|i| number(&|r| r.continuity.joined.map_or(0.0, |j| j.variance_nt2[i])));
        let reset: Vec<u8> = self.rows.iter().map(|row| u8::from(row.continuity.joined.is_none())).collect();
        let has_model: Vec<u8> = self.rows.iter().map(|row| u8::from(row.has_model)).collect();
        let mut columns = vec![
            ("sensor", Column::Words(&codes, &sensors)),
            ("day", Column::Whole(&day_codes)),
            ("date", Column::Timestamps(&dates)),
            ("first_tt2000", Column::Whole(&first)),
            ("last_tt2000", Column::Whole(&last)),
            ("t_first_degc", Column::Numbers(&t_first)),
            ("t_last_degc", Column::Numbers(&t_last)),
            ("modes", Column::Words(&mode_codes, &modes)),
        ];
        let known =
            COLUMNS.into_iter().zip(&s).chain(SLOPES.into_iter().zip(&slopes)).chain(VARIANCES.into_iter().zip(&variances));
        columns.extend(known.map(|(n, c)| (n, Column::Numbers(c))));
        columns.push(("reset", Column::Bytes(&reset)));
        columns.push((HAS_MODEL, Column::Bytes(&has_model)));
        let says = vec![
            ("day".to_owned(), "days since 1970-01-01".to_owned()),
            ("first_day".to_owned(), self.rows.first().map(|row| day_name(row.day)).unwrap_or_default()),
            (CONFIGURATION.to_owned(), self.configuration.clone()),
            (UNKNOWN.to_owned(), serde_json::json!(self.unknown.iter().collect::<Vec<_>>()).to_string()),
            (HEATER.to_owned(), self.heater.iter().flat_map(|(s, list)| list.iter().map(|c| line_of(s, c))).collect()),
            ("written_by".to_owned(), format!("calfit {}", env!("CARGO_PKG_VERSION"))),
        ];
        let mut file = folder.create(name)?;
        let mut writer = LongWriter::new(&mut file, &columns, says)?;
        writer.write(&columns)?;
        writer.finish()?;
        file.finish().map(drop)
    }

    /// Reads what [`Carry::write`] wrote.
    ///
    /// # Errors
    /// What is wrong with the table.
    pub fn read(path: &Path) -> Result<Self, Finding> {
        let table = SeriesTable::open(path)?;
        let words = table.words("sensor")?;
        let (day, first, last) = (table.whole("day")?, table.tt2000("first_tt2000")?, table.tt2000("last_tt2000")?);
        let (t_first, t_last) = (table.numbers("t_first_degc")?, table.numbers("t_last_degc")?);
        let three = |names: [&str; 3]| -> Result<[Vec<f64>; 3], Finding> {
            let [x, y, z] = names.map(|name| table.numbers(name));
            Ok([x?, y?, z?])
        };
        let (sums, slopes, variances) = (three(COLUMNS)?, three(SLOPES)?, three(VARIANCES)?);
        let reset = table.whole("reset")?;
        // Tables of earlier versions have none.
        let names = table.names();
        let modes = if names.iter().any(|name| name == "modes") { Some(table.words("modes")?) } else { None };
        // They had days with models alone.
        let has_model = if names.iter().any(|name| name == HAS_MODEL) { Some(table.whole(HAS_MODEL)?) } else { None };
        let row = |i: usize| CarryRow {
            sensor: words.words[words.codes[i] as usize].clone(),
            day: i32::try_from(day[i]).unwrap_or(day_of(jiff::civil::Date::MAX)),
            time: [first[i], last[i]],
            degc: [t_first[i], t_last[i]],
            continuity: Continuity {
                sum_nt: sums.each_ref().map(|c| c[i]),
                sum_nt_per_k: slopes.each_ref().map(|c| c[i]),
                joined: (reset[i] == 0).then(|| Joined { degc: t_first[i], variance_nt2: variances.each_ref().map(|c| c[i]) }),
            },
            modes: modes.as_ref().map(|modes| modes.words[modes.codes[i] as usize].clone()).unwrap_or_default(),
            has_model: has_model.as_ref().is_none_or(|own| own[i] != 0),
        };
        let mut heater: BTreeMap<String, Vec<HeaterClass>> = BTreeMap::new();
        for line in table.says(HEATER).unwrap_or_default().lines() {
            let Some((sensor, class)) = class_of(line) else {
                let shown = path.display().to_string();
                return Err(
                    Finding::error(&shown, "what it says of heaters cannot be read", "make it again").found(line.as_bytes())
                );
            };
            heater.entry(sensor).or_default().push(class);
        }
        let configuration = table.says(CONFIGURATION).unwrap_or_default().to_owned();
        let said = table.says(UNKNOWN).unwrap_or("[]");
        let unknown: Vec<((String, i32), String)> = serde_json::from_str(said).map_err(|_| {
            let rule = "what it says of days that are not known cannot be read";
            Finding::error(&path.display().to_string(), rule, "make it again").found(said.as_bytes())
        })?;
        Ok(Self { rows: (0..table.rows()).map(row).collect(), heater, unknown: unknown.into_iter().collect(), configuration })
    }
}

/// Words as their indices in a list of those that occur.
fn coded<'a>(words: impl Iterator<Item = &'a String>) -> (Vec<u8>, Vec<String>) {
    let mut list: Vec<String> = Vec::new();
    let mut codes = Vec::new();
    for word in words {
        let code = list.iter().position(|own| own == word).unwrap_or_else(|| {
            list.push(word.clone());
            list.len() - 1
        });
        codes.push(u8::try_from(code).unwrap_or(u8::MAX));
    }
    (codes, list)
}

/// The days of a sensor, and those whose continuity is not known, with the reason.
struct Days {
    rows: Vec<CarryRow>,
    unknown: Vec<((String, i32), String)>,
}

/// Looks at the days of a sensor with daily models.
fn days_of(prepared: &Prepared, index: usize) -> Result<Days, Finding> {
    let mission = &prepared.mission;
    let sensor = &mission.sensors[index];
    let resets: Vec<Tt2000> = mission.campaigns.iter().map(|span| span.from).collect();
    let mut rows: Vec<CarryRow> = Vec::new();
    let mut ends = Vec::new();
    let mut broken: Vec<(i32, String)> = Vec::new();
    // Days from which on the constant is not known until it is reset: it would rest on a model beyond its temperatures.
    let mut lost: Vec<(i32, String)> = Vec::new();
    let mut midnights = Midnights::new(prepared, index);
    for day in prepared.days(sensor)? {
        let known = midnights.day_ends(day).and_then(|found| match found {
            None => Ok(None),
            Some(found) => Ok(prepared.daily(sensor, day)?.map(|model| (found, model))),
        });
        let (found, model) = match known {
            Ok(Some(known)) => known,
            Ok(None) => continue,
            Err(finding) => {
                // What is wrong with a day is said when it is made; what follows it is not known until a campaign begins.
                broken.push((day, finding.to_string()));
                continue;
            }
        };
        ends.push(DayEnds { time: found.0, degc: found.1, model: model.polynomials });
        // A polynomial is not taken beyond the temperatures that it holds for: vectors there have no offset, and no constant follows from it.
        let [low, high] = limits(mission, model.valid_degc).kept_degc;
        for (degc, from) in found.1.into_iter().zip([day, day + 1]) {
            if degc < low || degc > high {
                let rule = format!(
                    "the sensor has {degc:.2} °C at an end of {}, and the daily model holds from {low} to {high} °C: the continuity behind \
                     it is not known",
                    day_name(day)
                );
                let remedy = "name a model that holds there, or begin a [[campaign]] behind it";
                lost.push((from, Finding::error(&sensor.name, rule, remedy).to_string()));
            }
        }
        rows.push(CarryRow {
            sensor: sensor.name.clone(),
            day,
            time: found.0,
            degc: found.1,
            continuity: Continuity::default(),
            modes: String::new(),
            has_model: true,
        });
    }
    for (row, known) in rows.iter_mut().zip(continuity(&ends, mission.reset_gap_ns, &resets)) {
        row.continuity = known;
    }
    // Days whose constants begin anew, each with the day before that it follows. Behind a day that cannot be read nothing says that they do.
    let earlier = [None].into_iter().chain(rows.iter().map(|row| Some(row.day)));
    let resets_at: Vec<(Option<i32>, i32)> =
        earlier.zip(&rows).filter(|(_, row)| row.continuity.joined.is_none()).map(|(earlier, row)| (earlier, row.day)).collect();
    let mut days = Days { rows: Vec::new(), unknown: Vec::new() };
    for row in rows {
        let begun = resets.iter().rfind(|at| **at <= row.time[0]).copied();
        let before = |day: i32| day <= row.day && begun.is_none_or(|at| prepared.leap.day(day).end > at);
        let is_broken = |day: i32| before(day) && !begins_anew_behind(day, row.day, &resets_at);
        let is_lost = |from: i32| from <= row.day && !resets_at.iter().any(|(_, own)| (from..=row.day).contains(own));
        match broken.iter().find(|(day, _)| is_broken(*day)).or_else(|| lost.iter().find(|(from, _)| is_lost(*from))) {
            Some((_, reason)) => days.unknown.push(((row.sensor, row.day), reason.clone())),
            None => days.rows.push(row),
        }
    }
    Ok(days)
}

/// The days of a sensor with vectors and without a daily model that is joined to others; `known` are those with one. What is wrong with a
/// day is said when it is made.
fn others_of(prepared: &Prepared, index: usize, known: &BTreeSet<(String, i32)>) -> Result<Vec<CarryRow>, Finding> {
    let sensor = &prepared.mission.sensors[index];
    let mut midnights = Midnights::new(prepared, index);
    let mut rows = Vec::new();
    for day in prepared.days(sensor)? {
        // A model that cannot be read is not one that is not there: its day has none that could be told here.
        let has_model = || prepared.mission.continuity && !matches!(prepared.daily(sensor, day), Ok(None));
        if known.contains(&(sensor.name.clone(), day)) || has_model() {
            continue;
        }
        if let Ok(Some((time, degc))) = midnights.day_ends(day) {
            rows.push(CarryRow {
                sensor: sensor.name.clone(),
                day,
                time,
                degc,
                continuity: Continuity::default(),
                modes: String::new(),
                has_model: false,
            });
        }
    }
    Ok(rows)
}

/// Whether the constants of a day do not rest on an earlier one that cannot be read: between two days that can they begin anew.
fn begins_anew_behind(broken: i32, day: i32, resets_at: &[(Option<i32>, i32)]) -> bool {
    resets_at.iter().any(|(earlier, own)| earlier.is_some_and(|earlier| earlier > broken) && *own <= day)
}

/// Column of whether a day has a daily model that is joined to others: 1 or 0.
const HAS_MODEL: &str = "daily_model";
/// What the file says of the configuration that it was made of.
const CONFIGURATION: &str = "configuration_sha256";
/// What the file says of days whose continuity is not known: JSON, a list of sensor and day, and the reason.
const UNKNOWN: &str = "unknown";
/// What the file says of heaters, a line for each: sensor, name, vector, its uncertainty, mean and scatter of the times off and on, length of edges, edges.
const HEATER: &str = "heater";

fn line_of(sensor: &str, class: &HeaterClass) -> String {
    let numbers = class.vector_nt.iter().chain(&class.std_nt).chain(&class.off_s).chain(&class.on_s).chain([&class.edge_s]);
    let numbers: Vec<String> = numbers.map(|v| format!("{v:?}")).collect();
    format!("{sensor}\t{}\t{}\t{}\n", class.name, numbers.join("\t"), class.edges)
}

fn class_of(line: &str) -> Option<(String, HeaterClass)> {
    let mut cells = line.split('\t');
    let (sensor, name) = (cells.next()?.to_owned(), cells.next()?.to_owned());
    let cells: Vec<&str> = cells.collect();
    let numbers: Vec<f64> = cells.get(..11)?.iter().map(|c| c.parse().ok()).collect::<Option<_>>()?;
    let three = |from: usize| [numbers[from], numbers[from + 1], numbers[from + 2]];
    let class = HeaterClass {
        name,
        vector_nt: three(0),
        std_nt: three(3),
        off_s: [numbers[6], numbers[7]],
        on_s: [numbers[8], numbers[9]],
        edge_s: numbers[10],
        edges: cells.get(11)?.parse().ok()?,
    };
    Some((sensor, class))
}

/// Times and temperatures, °C, of the first and the last vector.
type Ends = ([Tt2000; 2], [f64; 2]);

/// Corrected time and thermistor counts of a vector.
type End = (Tt2000, f64);

/// Telemetry near the midnights, which two days share. A file is read once.
struct Midnights<'a> {
    prepared: &'a Prepared,
    index: usize,
    /// Rows of a file near the first and the last midnight of its day, as far as they are needed yet.
    near: BTreeMap<&'a Path, (i32, Edges)>,
    /// The midnight at which a day begins, with the last accepted vector before it and the first one from it on.
    known: Option<(i32, [Option<End>; 2])>,
}

impl<'a> Midnights<'a> {
    fn new(prepared: &'a Prepared, index: usize) -> Self {
        Self { prepared, index, near: BTreeMap::new(), known: None }
    }

    /// Corrected times and temperatures of the first and the last accepted vector of a day.
    fn day_ends(&mut self, day: i32) -> Result<Option<Ends>, Finding> {
        self.near.retain(|_, (of_day, _)| *of_day + 1 >= day);
        let [_, first] = self.around(day, day)?;
        let [last, _] = self.around(day + 1, day)?;
        // Mostly the half hours beside the midnights are enough.
        let (first, last) = match (first, last) {
            (Some(first), Some(last)) => (first, last),
            _ => match self.of_day(day)? {
                Some(ends) => ends,
                None => return Ok(None),
            },
        };
        let degc = |count: f64| thermometer(self.prepared, self.index).map_or(f64::NAN, |t| t.degc(count));
        Ok(Some(([first.0, last.0], [degc(first.1), degc(last.1)])))
    }

    /// The last vector in the half hour before the midnight at which a day begins, and the first one in the half hour behind it. What of the
    /// file of another day than `wanted` cannot be read is missing there, as in the levels; that day says why.
    fn around(&mut self, day: i32, wanted: i32) -> Result<[Option<End>; 2], Finding> {
        if let Some((known, ends)) = self.known
            && known == day
        {
            return Ok(ends);
        }
        let prepared = self.prepared;
        let sensor = &prepared.mission.sensors[self.index];
        let midnight = prepared.leap.day(day).start;
        let tags = midnight - 2 * BEYOND_NS..midnight + 2 * BEYOND_NS;
        let mut rows = Rows::default();
        let mut is_whole = true;
        for file in prepared.files(&sensor.name, &tags) {
            let Some(of_day) = file.day else {
                let [read] = edited::read(file, sensor, &prepared.mission, &prepared.leap, [&tags])?;
                rows.append(read);
                continue;
            };
            if !self.near.contains_key(file.path.as_path()) {
                match Near::edges(prepared, self.index, file, of_day) {
                    Ok(edges) => drop(self.near.insert(&file.path, (of_day, edges))),
                    Err(_) if of_day != wanted => is_whole = false,
                    Err(finding) => return Err(finding),
                }
            }
            if let Some((_, near)) = self.near.get(file.path.as_path()) {
                (of_day == day).then(|| rows.append(near[0].clone()));
                (of_day + 1 == day).then(|| rows.append(near[1].clone()));
            }
        }
        let vectors = assembled(prepared, self.index, &rows, &(midnight - BEYOND_NS..midnight + BEYOND_NS))?;
        let behind = vectors.time.partition_point(|time| *time < midnight);
        let end = |row: usize| Some((*vectors.time.get(row)?, vectors.thermistor[row]));
        let ends = [behind.checked_sub(1).and_then(end), end(behind)];
        // The other day is to meet the damage by itself.
        self.known = is_whole.then_some((day, ends));
        Ok(ends)
    }

    /// The first and the last accepted vector of a day.
    fn of_day(&self, day: i32) -> Result<Option<(End, End)>, Finding> {
        let prepared = self.prepared;
        let span = &prepared.leap.day(day);
        let sensor = &prepared.mission.sensors[self.index];
        let tags = span.start - BEYOND_NS..span.end + BEYOND_NS;
        let mut rows = Rows::default();
        for file in prepared.files(&sensor.name, &tags) {
            match edited::read(file, sensor, &prepared.mission, &prepared.leap, [&tags]) {
                Ok([read]) => rows.append(read),
                Err(_) if file.day.is_some_and(|own| own != day) => {}
                Err(finding) => return Err(finding),
            }
        }
        let vectors = assembled(prepared, self.index, &rows, span)?;
        let end = |row: usize| (vectors.time[row], vectors.thermistor[row]);
        Ok(vectors.len().checked_sub(1).map(|last| (end(0), end(last))))
    }
}

/// The accepted vectors of a stretch in the order of their corrected times.
fn assembled(prepared: &Prepared, index: usize, rows: &Rows, span: &std::ops::Range<Tt2000>) -> Result<Block, Finding> {
    let mission = &prepared.mission;
    let name = &mission.sensors[index].name;
    let shifts = mission.steps.iter().any(|s| s == "shift");
    let made = assemble(rows, name, mission, &prepared.leap, span, span, shifts);
    made.map(|made| made.vectors).map_err(|e| Finding::error(name, e.to_string(), "state it in [[mode]]"))
}

#[cfg(test)]
mod tests {
    use super::begins_anew_behind;

    /// Days 1 to 9 without the third, which cannot be read; the constants begin anew on the first, behind the third, and on the seventh.
    #[test]
    fn a_day_that_cannot_be_read_is_passed_where_the_constants_begin_anew() {
        let resets_at = [(None, 1), (Some(2), 4), (Some(6), 7)];
        let known: Vec<bool> = [4, 5, 6, 7, 9].map(|day| begins_anew_behind(3, day, &resets_at)).to_vec();
        assert_eq!(known, [false, false, false, true, true]);
    }
}
