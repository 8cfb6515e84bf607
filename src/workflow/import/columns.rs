//! The columns of a table that a mapping names, as numbers.

use super::numbers::{celsius, scaled};
use super::settings::{Fields, whole};
use crate::data::error::{Finding, Severity};
use crate::files::import::mapping::{ChannelKeys, Given, ReadingScale, RowsAre, TemperatureUnit};
use crate::files::import::{ForeignTable, Mapping, Times, time};

/// A slow channel of the run.
pub(super) struct Slow {
    pub name: String,
    pub values: Vec<f64>,
}

/// All columns of a table that belong to the run, as long as the table.
pub(super) struct Columns {
    pub times: Times,
    /// End of every plateau, ns, where the table has it.
    pub ends: Option<Vec<i64>>,
    /// In the unit of the run's file: enT or counts.
    pub readings: [Vec<f64>; 3],
    pub std: Option<[Vec<f64>; 3]>,
    pub count: Option<Vec<u32>>,
    pub counter: Option<Vec<u64>>,
    pub fields: Option<Fields>,
    pub positions: Vec<u32>,
    pub temperatures: Vec<Slow>,
    pub channels: Vec<Slow>,
}

impl Columns {
    /// Reads them; what is not used is told in `findings`.
    pub fn read(table: &ForeignTable, mapping: &Mapping, findings: &mut Vec<Finding>) -> Result<Self, Finding> {
        let keys = &mapping.time;
        let (begin, end) = match &mapping.rows {
            RowsAre::Samples => (None, None),
            RowsAre::Plateaus { t_start, t_end } => (t_start.as_ref(), t_end.as_ref()),
        };
        let read = |column: &str, findings: &mut Vec<Finding>| {
            time::read(table, column, keys.date.as_deref(), keys.format.as_ref(), &keys.zone, findings)
        };
        let times = read(begin.unwrap_or(&keys.column), findings)?;
        let ends = end.map(|column| read(column, findings)).transpose()?.map(|t| t.ns);
        let factor = match mapping.reading.scale {
            ReadingScale::Ent(factor) => factor,
            ReadingScale::Counts(_) => 1.0,
        };
        let three = |names: &[String; 3]| -> Result<[Vec<f64>; 3], Finding> {
            let mut columns = [Vec::new(), Vec::new(), Vec::new()];
            for (column, name) in columns.iter_mut().zip(names) {
                *column = table.numbers(name)?.into_iter().map(|v| scaled(v, factor)).collect();
            }
            Ok(columns)
        };
        let field_columns = mapping.field.as_ref().filter(|f| f.table.is_none()).and_then(|f| Some((f, f.columns.as_ref()?)));
        let positions = match &mapping.run.position {
            None => vec![1; table.rows()],
            Some(Given::Value(id)) => vec![*id; table.rows()],
            Some(Given::Column(name)) => whole(table, name)?,
        };
        let columns = Self {
            times,
            ends,
            readings: three(&mapping.reading.columns)?,
            std: mapping.reading.std.as_ref().map(three).transpose()?,
            count: mapping.reading.count.as_ref().map(|name| whole(table, name)).transpose()?,
            counter: keys.counter.as_ref().map(|name| counter(table, name)).transpose()?,
            fields: field_columns.map(|(keys, names)| Fields::read(table, keys, names)).transpose()?,
            positions,
            temperatures: slow(table, &mapping.temperatures, findings)?,
            channels: slow(table, &mapping.channels, findings)?,
        };
        let used = used(mapping);
        let unknown: Vec<&String> = table.names().iter().filter(|n| !n.is_empty() && !used.contains(&n.as_str())).collect();
        if !unknown.is_empty() {
            findings.push(super::unused(table.file(), &unknown));
        }
        Ok(columns)
    }

    /// The reading of a row; absent where one of its components is.
    pub fn reading(&self, row: usize) -> Option<[f64; 3]> {
        let reading = [0, 1, 2].map(|i| self.readings[i][row]);
        reading.iter().all(|v| v.is_finite()).then_some(reading)
    }
}

/// Names of all columns that a mapping uses.
fn used(mapping: &Mapping) -> Vec<&str> {
    let run = &mapping.run;
    let mut used: Vec<&str> = vec![&mapping.time.column];
    used.extend(mapping.time.date.as_deref());
    let texts = [&run.kind, &run.sensor, &run.mode, &run.configuration, &run.field_source, &run.start];
    used.extend(texts.into_iter().filter_map(|given| match given {
        Some(Given::Column(name)) => Some(name.as_str()),
        _ => None,
    }));
    if let Some(Given::Column(name)) = &run.position {
        used.push(name);
    }
    used.extend(run.split_column.as_deref());
    used.extend(mapping.time.counter.as_deref());
    used.extend(mapping.reading.columns.iter().map(String::as_str));
    used.extend(mapping.reading.std.iter().flatten().map(String::as_str));
    used.extend(mapping.reading.count.as_deref());
    if let Some(field) = mapping.field.as_ref().filter(|f| f.table.is_none()) {
        used.extend(field.columns.iter().flatten().map(String::as_str));
        used.extend(field.frequency.as_deref());
    }
    used.extend(mapping.temperatures.iter().chain(&mapping.channels).map(|c| c.column.as_str()));
    if let RowsAre::Plateaus { t_start, t_end } = &mapping.rows {
        used.extend(t_start.iter().chain(t_end).map(String::as_str));
    }
    used
}

fn counter(table: &ForeignTable, name: &str) -> Result<Vec<u64>, Finding> {
    let one = |(row, v): (usize, f64)| {
        let is_whole = v >= 0.0 && v.fract() == 0.0 && v < 1e15;
        let rule = "the sample counter must be a whole number, 0 or more";
        if is_whole {
            Ok(v as u64)
        } else {
            Err(table.refuse(row, Some(name), rule, "repair the value, or take `counter` out of [time]"))
        }
    };
    table.numbers(name)?.into_iter().enumerate().map(one).collect()
}

fn slow(table: &ForeignTable, keys: &[ChannelKeys], findings: &mut Vec<Finding>) -> Result<Vec<Slow>, Finding> {
    let mut list = Vec::new();
    for key in keys {
        let raw = table.numbers(&key.column)?;
        let values: Vec<f64> = raw.into_iter().map(|value| celsius(value, key.unit)).collect();
        list.push(Slow { name: key.name.clone(), values });
    }
    // Temperatures have a unit; other channels may be anything.
    let temperatures =
        keys.iter().zip(&list).filter(|(key, _)| key.unit != TemperatureUnit::Celsius || key.name.starts_with('T'));
    for (key, channel) in temperatures {
        if let Some(row) = channel.values.iter().position(|v| *v < -273.15) {
            let rule = "the temperature lies below absolute zero";
            return Err(table.refuse(
                row,
                Some(&key.column),
                rule,
                "correct the cell, or the unit of the channel in the mapping",
            ));
        }
        // No sensor works at 230 °C or at -200 °C, and these are the other unit's usual temperatures.
        let middle =
            crate::fit::statistics::median(&mut channel.values.iter().copied().filter(|v| v.is_finite()).collect::<Vec<f64>>());
        let other = if key.unit == TemperatureUnit::Celsius && middle > 200.0 {
            "K"
        } else if key.unit == TemperatureUnit::Kelvin && middle < -200.0 {
            "degC"
        } else {
            continue;
        };
        let rule = format!("column `{}` would be at {middle:.1} °C", key.column);
        let remedy = format!("write {} = {{ column = \"{}\", unit = \"{other}\" }} under [temperature]", key.name, key.column);
        findings.push(Finding::error(table.file(), rule, remedy).weighing(Severity::Warning));
    }
    Ok(list)
}
