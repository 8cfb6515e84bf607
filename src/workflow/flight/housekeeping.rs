//! Housekeeping to physical units, `level=HK` (RO-IGEP-TR0028 section 4.2.2).

use super::{FlightOptions, Prepared, day_name};
use crate::data::error::Finding;
use crate::data::time::SECOND_NS;
use crate::files::flight::edited::{BEYOND_NS, EditedFile, day_files, plain, times_beside};
use crate::files::flight::levels::partition;
use crate::files::flight::text;
use crate::files::output::Folder;
use crate::files::source::digest;
use crate::files::table::long::{Column, LongWriter};
use crate::files::table::series::SeriesTable;
use crate::flight::Block;
use crate::flight::assemble::RowCounts;
use crate::flight::housekeeping::{
    common_factor, differing, field_ent, late_s, negative_v, part_apart, positive_v, reference_v, still_while_moving,
};
use crate::flight::made::DayMade;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Columns that are passed on as they are.
const PASSED: [&str; 3] = ["stage_a_id", "stage_b_id", "filter_cfg"];
/// Columns of fields as the housekeeping has them.
const FIELDS: [&str; 6] = ["bx_ob", "by_ob", "bz_ob", "bx_ib", "by_ib", "bz_ib"];
/// The level, and what stands in place of a sensor.
pub const NAME: &str = "HK";

/// The days of the housekeeping.
///
/// # Errors
/// A folder that cannot be listed, a file outside of all partitions whose times cannot be read.
pub fn days(prepared: &Prepared) -> Result<BTreeSet<i32>, Finding> {
    let Some(folder) = &prepared.mission.hk else { return Ok(BTreeSet::new()) };
    let mut days = BTreeSet::new();
    for file in day_files(folder)? {
        match file.day {
            Some(day) => days.extend([day]),
            None => {
                let times = times_beside(&file.path, &prepared.mission, &prepared.leap)?;
                days.extend(times.into_iter().map(|time| prepared.leap.utc(time).day));
            }
        }
    }
    Ok(days)
}

/// Converts the housekeeping of a day.
///
/// # Errors
/// What is wrong with its files.
pub fn make(prepared: &Prepared, options: &FlightOptions, day: i32) -> Result<Option<DayMade>, Finding> {
    let Some(folder) = &prepared.mission.hk else { return Ok(None) };
    // A file outside of all partitions may have rows of every day.
    let files: Vec<EditedFile> = day_files(folder)?.into_iter().filter(|file| file.day.is_none_or(|own| own == day)).collect();
    if files.is_empty() { Ok(None) } else { one_day(prepared, options, day, &files).map(Some) }
}

/// Bits of the unsigned counts of a column; `None` for a column that is not one of this instrument.
pub fn bits_of(prepared: &Prepared, column: &str) -> Option<i32> {
    match column {
        "ref_voltage" => Some(20),
        "pos_voltage" | "neg_voltage" => Some(8),
        _ if FIELDS.contains(&column) => Some(16),
        _ => prepared.mission.sensors.iter().any(|sensor| plain(&sensor.thermistor_column) == column).then_some(16),
    }
}

/// A file of housekeeping that is open, whatever is made of it.
pub struct HousekeepingFile {
    shown: String,
    table: SeriesTable,
    /// The names of the table by their plain form.
    names: BTreeMap<String, String>,
    /// Times of its rows, TT2000.
    pub time: Vec<i64>,
}

impl HousekeepingFile {
    /// Opens a file and reads its times.
    ///
    /// # Errors
    /// What is wrong with the table; times that contradict each other or are not of the day of the partition.
    pub fn open(prepared: &Prepared, file: &EditedFile) -> Result<Self, Finding> {
        let leap = &prepared.leap;
        let time = times_beside(&file.path, &prepared.mission, leap)?;
        let table = SeriesTable::open(&file.path)?;
        let names = table.names().into_iter().map(|name| (plain(&name), name)).collect();
        let own = Self { shown: file.path.display().to_string(), table, names, time };
        if let Some(span) = file.day.map(|day| leap.day(day)) {
            let inside = span.start - BEYOND_NS..span.end + BEYOND_NS;
            if let Some(row) = own.time.iter().position(|time| !inside.contains(time)) {
                let rule = format!("the time {} is not of the day of the partition", leap.utc(own.time[row]));
                return Err(own.refuse(row, rule, "move the row to its day"));
            }
        }
        Ok(own)
    }

    fn refuse(&self, row: usize, rule: String, remedy: &str) -> Finding {
        Finding::error(&self.shown, format!("row {}: {rule}", row + 1), remedy)
    }

    /// That a column is not there.
    #[must_use]
    pub fn lacks(&self, column: &str) -> Finding {
        let rule = format!("has no column `{column}`; it has {}", self.table.names().join(", "));
        Finding::error(&self.shown, rule, "rename the column, or name another one")
    }

    /// The readings of a column in some rows, in the unit of the column; `None` without this column.
    ///
    /// # Errors
    /// A column of another type, a reading that is missing or that its converter does not have.
    pub fn readings(&self, prepared: &Prepared, column: &str, rows: &[usize]) -> Result<Option<Vec<f64>>, Finding> {
        let Some(name) = self.names.get(column) else { return Ok(None) };
        let all = self.table.numbers(name)?;
        const REMEDY: &str = "correct it, or leave the row out";
        if let Some(&row) = rows.iter().find(|row| all[**row].is_nan()) {
            return Err(self.refuse(row, format!("column `{name}` has no value"), REMEDY));
        }
        if let Some(bits) = bits_of(prepared, column) {
            let most = 2.0_f64.powi(bits) - 1.0;
            if let Some(&row) = rows.iter().find(|row| !(0.0..=most).contains(&all[**row])) {
                return Err(self.refuse(row, format!("the count {} of `{name}` is none of {bits} bits", all[row]), REMEDY));
            }
        }
        Ok(Some(rows.iter().map(|row| all[*row]).collect()))
    }
}

/// Readings of the field that differ from those of the telemetry by so much, enT, and this part of these: the housekeeping has steps of half an enT,
/// its times may be off by seconds, and a scale that is off by a tenth is wrong.
const FIELD_ENT: f64 = 10.0;
const FIELD_PART: f64 = 0.05;
/// The same of the thermistor, counts: 2 K of those of Rosetta.
const THERMISTOR_COUNTS: f64 = 70.0;
/// Thermistors of modes with longer packets do not tell times, s, and delays that are shorter are not told.
const LONGEST_PACKET_S: f64 = 128.0;
/// A vector belongs to a reading that is no further from it, ns.
const BESIDE_NS: i64 = 2 * SECOND_NS;

/// Notes on counts of a sensor of a day that its housekeeping has otherwise, or at other times. There is none where it does not have them, or cannot
/// be read, which the day of the housekeeping says.
pub fn against_telemetry(prepared: &Prepared, index: usize, day: i32, blocks: &[Block]) -> Vec<String> {
    let sensor = &prepared.mission.sensors[index];
    let name = sensor.name.to_lowercase();
    let thermistor = plain(&sensor.thermistor_column);
    let columns = [format!("bx_{name}"), format!("by_{name}"), format!("bz_{name}"), thermistor];
    let files = prepared.mission.hk.as_ref().and_then(|folder| day_files(folder).ok()).unwrap_or_default();
    let mut readings_of: [Vec<(i64, [f64; 2])>; 4] = Default::default();
    let mut thermistors: Vec<(i64, f64)> = Vec::new();
    for file in files.iter().filter(|file| file.day == Some(day)) {
        let Ok(own) = HousekeepingFile::open(prepared, file) else { continue };
        let all: Vec<usize> = (0..own.time.len()).collect();
        if let Ok(Some(readings)) = own.readings(prepared, &columns[3], &all) {
            thermistors.extend(own.time.iter().copied().zip(readings));
        }
        let beside: Vec<(usize, &Block, usize)> = (0..own.time.len())
            .filter_map(|reading| beside(blocks, own.time[reading]).map(|(block, row)| (reading, block, row)))
            .collect();
        let rows: Vec<usize> = beside.iter().map(|(reading, ..)| *reading).collect();
        for (k, column) in columns.iter().enumerate() {
            let Ok(Some(readings)) = own.readings(prepared, column, &rows) else { continue };
            readings_of[k].extend(beside.iter().zip(readings).map(|((_, block, row), reading)| {
                let pair = match block.field.get(k) {
                    Some(counts) => {
                        let factor = sensor.counts.ent_per_count(block.range[*row]);
                        [field_ent(reading), counts[*row] * factor + sensor.counts.shift_ent()]
                    }
                    None => [reading, block.thermistor[*row]],
                };
                (block.time[*row], pair)
            }));
        }
    }
    readings_of.iter_mut().for_each(|list| list.sort_by_key(|(time, _)| *time));
    let times = readings_of.each_ref().map(|list| list.iter().map(|(time, _)| *time).collect::<Vec<i64>>());
    let pairs = readings_of.map(|list| list.into_iter().map(|(_, pair)| pair).collect::<Vec<[f64; 2]>>());
    // Fields that have nothing to do with each other are no fault of one of them: another component agrees, or all have one factor.
    let is_apart = |k: &usize| differing(&pairs[*k], FIELD_ENT, FIELD_PART).is_some();
    let factor = common_factor(&pairs[..3], FIELD_ENT, FIELD_PART);
    // A factor that holds for a part of the day, outside of which all agree, says it as well.
    let common = part_apart(&pairs[..3], FIELD_ENT, FIELD_PART).filter(|_| times[0] == times[1] && times[1] == times[2]);
    let common = common.and_then(|rows| {
        let inside: Vec<Vec<[f64; 2]>> = pairs[..3].iter().map(|list| list[rows.clone()].to_vec()).collect();
        common_factor(&inside, FIELD_ENT, FIELD_PART).map(|factor| (rows, factor))
    });
    let is_same = (0..3).any(|k| !pairs[k].is_empty() && !is_apart(&k)) || factor.is_some() || common.is_some();
    let parts = [0, 1, 2].map(|k: usize| part_apart(&pairs[k..=k], FIELD_ENT, FIELD_PART));
    let when = |k: usize, rows: &Range<usize>| {
        let [from, to] = [rows.start, rows.end - 1].map(|row| prepared.leap.utc(times[k][row]));
        match (rows.start, times[k].len() - rows.end) {
            (0, _) => format!(" up to {to}"),
            (_, 0) => format!(" from {from} on"),
            _ => format!(" from {from} to {to}"),
        }
    };
    // Readings that differ for a part of the day are a fault if another component agrees there.
    let agrees_beside = |k: usize, rows: &Range<usize>| {
        let mut others = (0..3).filter(|other| *other != k && times[*other] == times[k]);
        others.any(|other| differing(&pairs[other][rows.clone()], FIELD_ENT, FIELD_PART).is_none())
    };
    let told = |(k, column): (usize, &String)| {
        let (floor, part, unit) = if k < 3 { (FIELD_ENT, FIELD_PART, "enT") } else { (THERMISTOR_COUNTS, 0.0, "counts") };
        let rows = parts.get(k).and_then(Option::as_ref);
        let of_day = || differing(&pairs[k], floor, part).filter(|_| k > 2 || is_same);
        let of_part = || {
            let rows = rows.filter(|rows| agrees_beside(k, rows))?;
            differing(&pairs[k][rows.clone()], floor, part)
        };
        let (count, most) = of_day().or_else(of_part)?;
        let when = rows.filter(|_| common.is_none()).map(|rows| when(k, rows)).unwrap_or_default();
        Some(format!("{count} of {} of `{column}` by up to {most:.0} {unit}{when}", pairs[k].len()))
    };
    let mut found: Vec<String> = columns.iter().enumerate().filter_map(told).collect();
    if let Some((rows, factor)) = &common {
        found.push(format!("all three by a factor {factor:.3}{}", when(0, rows)));
    }
    if let Some(factor) = factor.filter(|_| common.is_none() && (0..3).all(|k| is_apart(&k))) {
        found.push(format!("all three by a factor {factor:.3}"));
    }
    let unlike = (!found.is_empty()).then(|| {
        format!(
            "readings of the housekeeping differ from the telemetry beside them, {}: one of the two has other axes, another scale or other times",
            found.join(", ")
        )
    });
    let still = still_while_moving(&times[3], &pairs[3]).map(|(rows, moved)| {
        let [from, to] = [times[3][rows.start], times[3][rows.end - 1]];
        #[expect(clippy::cast_precision_loss, reason = "differences of times within a day")]
        let hours = (to - from) as f64 / (3600 * SECOND_NS) as f64;
        let [from, to] = [from, to].map(|time| prepared.leap.utc(time));
        format!(
            "`{}` keeps one count from {from} to {to}, {hours:.1} h, while that of the housekeeping moves by {moved:.0} counts: the temperatures of the \
             levels, and with them their fields, are wrong there",
            sensor.thermistor_column
        )
    });
    unlike.into_iter().chain(still).chain(late(prepared, blocks, &thermistors)).collect()
}

/// A note on times of the housekeeping that are not those of the telemetry, told by the thermistor that both of them have.
fn late(prepared: &Prepared, blocks: &[Block], housekept: &[(i64, f64)]) -> Option<String> {
    // A thermistor is read once in a packet.
    let is_long = |mode: u8| prepared.mission.modes[usize::from(mode)].packet_s > LONGEST_PACKET_S;
    let telemetry = |time: i64| {
        let (block, row) = beside(blocks, time)?;
        (!is_long(block.mode[row])).then(|| block.thermistor[row])
    };
    let late_s = late_s(housekept, &telemetry).filter(|late_s| late_s.abs() > LONGEST_PACKET_S)?;
    let side = if late_s > 0.0 { "later" } else { "earlier" };
    Some(format!(
        "the thermistor of the housekeeping changes about {:.0} s {side} than that of the telemetry: one of the two has other times, and so \
         has a field that follows the housekeeping",
        late_s.abs()
    ))
}

/// The vector that is nearest to a time, if it is near.
fn beside(blocks: &[Block], time: i64) -> Option<(&Block, usize)> {
    let near = blocks.iter().flat_map(|block| {
        let next = block.time.partition_point(|own| *own < time);
        [next.checked_sub(1), Some(next)].into_iter().flatten().filter(|row| *row < block.len()).map(move |row| (block, row))
    });
    let nearest = near.min_by_key(|(block, row)| (block.time[*row] - time).abs())?;
    ((nearest.0.time[nearest.1] - time).abs() <= BESIDE_NS).then_some(nearest)
}

fn one_day(prepared: &Prepared, options: &FlightOptions, day: i32, files: &[EditedFile]) -> Result<DayMade, Finding> {
    let leap = &prepared.leap;
    let mut time: Vec<i64> = Vec::new();
    let mut numbers: Vec<(String, Vec<f64>)> = Vec::new();
    let mut whole: Vec<(String, Vec<i64>)> = Vec::new();
    let mut inputs = prepared.inputs.clone();
    let mut columns_of_day: Option<Vec<String>> = None;
    let span = leap.day(day);
    for file in files {
        let own = HousekeepingFile::open(prepared, file)?;
        let is_of_day = |row: &usize| file.day.is_some() || span.contains(&own.time[*row]);
        let kept: Vec<usize> = (0..own.time.len()).filter(is_of_day).collect();
        if kept.is_empty() && file.day.is_none() {
            continue;
        }
        let shown = file.path.strip_prefix(&prepared.mission.folder).unwrap_or(&file.path).to_string_lossy().into_owned();
        inputs.push(digest(&file.path)?.input(shown));
        let columns: Vec<String> = own.names.keys().cloned().collect();
        if *columns_of_day.get_or_insert_with(|| columns.clone()) != columns {
            let rule = "has other columns than another file of the day";
            return Err(Finding::error(&own.shown, rule, "give all files of a day the same columns"));
        }
        time.extend(kept.iter().map(|row| own.time[*row]));
        let mut put = |name: &str, column: &str, convert: &dyn Fn(f64) -> f64| -> Result<(), Finding> {
            let Some(counts) = own.readings(prepared, column, &kept)? else { return Ok(()) };
            let values = counts.into_iter().map(convert);
            match numbers.iter_mut().find(|(n, _)| n == name) {
                Some((_, list)) => list.extend(values),
                None => numbers.push((name.to_owned(), values.collect())),
            }
            Ok(())
        };
        for (index, sensor) in prepared.mission.sensors.iter().enumerate() {
            let Some(ground) = &prepared.ground[index] else { continue };
            let column = &plain(&sensor.thermistor_column);
            put(column, column, &|count| ground.thermometer.raw_degc(count))?;
            put(&format!("{column}_calibrated"), column, &|count| ground.thermometer.degc(count))?;
        }
        for name in FIELDS {
            put(name, name, &field_ent)?;
        }
        put("ref_voltage", "ref_voltage", &reference_v)?;
        put("pos_voltage", "pos_voltage", &positive_v)?;
        put("neg_voltage", "neg_voltage", &negative_v)?;
        for name in PASSED {
            let Some(column) = own.names.get(name) else { continue };
            let all = own.table.whole(column)?;
            let values = kept.iter().map(|row| all[*row]);
            match whole.iter_mut().find(|(n, _)| n == name) {
                Some((_, list)) => list.extend(values),
                None => whole.push((name.to_owned(), values.collect())),
            }
        }
    }
    // Rows in the order of their times, as in all levels.
    let mut order: Vec<usize> = (0..time.len()).collect();
    order.sort_by_key(|row| (time[*row], *row));
    let sorted = |list: &[f64]| -> Vec<f64> { order.iter().map(|row| list.get(*row).copied().unwrap_or(f64::NAN)).collect() };
    let numbers: Vec<(String, Vec<f64>)> = numbers.into_iter().map(|(name, list)| (name, sorted(&list))).collect();
    let pick = |list: &[i64]| -> Vec<i64> { order.iter().filter_map(|row| list.get(*row).copied()).collect() };
    let whole: Vec<(String, Vec<i64>)> = whole.into_iter().map(|(name, list)| (name, pick(&list))).collect();
    let time = pick(&time);
    let utc: Vec<i64> = time.iter().map(|t| leap.utc(*t).timestamp_ns()).collect();
    #[expect(clippy::cast_precision_loss, reason = "the clock of a spacecraft has microseconds")]
    let obt: Vec<f64> = time.iter().map(|t| (t - leap.clock_begin()) as f64 / SECOND_NS as f64).collect();
    let mut columns =
        vec![("time_tt2000", Column::Whole(&time)), ("time_utc", Column::Timestamps(&utc)), ("time_obt", Column::Numbers(&obt))];
    columns.extend(numbers.iter().map(|(name, list)| (name.as_str(), Column::Numbers(list))));
    columns.extend(whole.iter().map(|(name, list)| (name.as_str(), Column::Whole(list))));
    let says = vec![
        ("level".to_owned(), NAME.to_owned()),
        ("mission".to_owned(), prepared.mission.mission.clone()),
        ("instrument".to_owned(), prepared.mission.instrument.clone()),
        ("day".to_owned(), day_name(day)),
        ("frame".to_owned(), "bx, by, bz in axes of the sensor".to_owned()),
        ("counts".to_owned(), serde_json::json!({ "read": time.len(), "written": time.len() }).to_string()),
        ("inputs".to_owned(), serde_json::json!(inputs).to_string()),
        ("time_scale".to_owned(), "time_tt2000 is TT and continuous; time_utc is UTC".to_owned()),
        (
            "units".to_owned(),
            "bx_ob … enT, not calibrated; t_ob degC without T_OFF, t_ob_calibrated with it; voltages V".to_owned(),
        ),
        ("written_by".to_owned(), format!("calfit {}", env!("CARGO_PKG_VERSION"))),
    ];
    let place = options.out.join(partition(NAME, NAME, day));
    // Housekeeping is of no sensor.
    let place =
        place.parent().and_then(|p| p.parent()).map(|p| p.join(place.file_name().unwrap_or_default())).unwrap_or(place.clone());
    let folder = Folder::open(&place, options.force)?;
    let mut file = folder.create(&format!("calfit-HK-{}.parquet", day_name(day).replace('-', "")))?;
    let mut writer = LongWriter::new(&mut file, &columns, says.clone())?;
    writer.write(&columns)?;
    writer.finish()?;
    file.finish()?;
    if prepared.mission.text {
        // Housekeeping is processed as level A, in which it stands beside the vectors.
        let stem = text::stem(&prepared.mission.instrument, "A", NAME, day);
        let rows = text::HousekeepingRows { time: &time, obt_s: &obt, numbers: &numbers, whole: &whole };
        text::write_housekeeping(&folder, &stem, &rows, leap, &says)?;
    }
    Ok(DayMade {
        sensor: NAME.to_owned(),
        day: day_name(day),
        rows: RowCounts { read: time.len(), ..RowCounts::default() },
        written: time.len(),
        levels: vec![NAME.to_owned()],
        ..DayMade::default()
    })
}
