//! The vectors of a table, with the temperatures of its column.

use super::course::Course;
use super::{FIELD, FLAGS, STD, TEMPERATURE, Work};
use crate::data::error::Finding;
use crate::files::output::Pending;
use crate::files::table::stream::{Format, Reader, Writer};

/// Column of the times of a table, s.
const TIME: &str = "t";

/// Calibrates the vectors of a table, at the temperatures of its column; what these show goes to the notes.
///
/// # Errors
/// What is wrong with the table; a column that the result would have twice; no temperature where the calibration needs one.
pub(super) fn table(work: &mut Work, mut reader: Reader, format: Format, note: &str, file: &mut Pending) -> Result<(), Finding> {
    let (data, options) = (work.data, work.options);
    let column = options.temperature_column.as_deref().unwrap_or(TEMPERATURE);
    let mut course = Course::new();
    let mut writer = Writer::new(file, format, note);
    while let Some(mut batch) = reader.next_batch()? {
        if !writer.has_begun()
            && let Some(taken) = FIELD.iter().chain(&STD).chain([&FLAGS]).find(|name| batch.has(name))
        {
            let rule = format!("has a column `{taken}` already");
            return Err(Finding::error(&data.display().to_string(), rule, "apply to the raw readings, or rename the column"));
        }
        let readings = [batch.numbers(data, "x")?, batch.numbers(data, "y")?, batch.numbers(data, "z")?];
        let degc = match (work.options.temperature_degc, &work.options.temperature_column) {
            (Some(degc), _) => vec![degc; batch.len()],
            (None, Some(column)) => batch.numbers(data, column)?,
            (None, None) if batch.has(TEMPERATURE) => batch.numbers(data, TEMPERATURE)?,
            (None, None) => {
                work.without_temperature(&format!("has no column `{TEMPERATURE}`"))?;
                vec![f64::NAN; batch.len()]
            }
        };
        // A column that holds no times is what it is to the one who made it.
        if options.temperature_degc.is_none() && course.is_ordered {
            match batch.numbers(data, TIME) {
                Ok(t_s) => course.take(&t_s, &degc),
                Err(_) => course.is_ordered = false,
            }
        }
        // The temperature that stands beside a field is the one that it was computed with.
        if let (Some(used), true) = (work.options.temperature_degc, batch.has(TEMPERATURE)) {
            if !writer.has_begun() {
                work.counts.notes.push(format!(
                    "its column `{TEMPERATURE}` was not used: the field is that at the {used} °C of --temperature, which the result has in this column"
                ));
            }
            batch.push(TEMPERATURE, degc.clone())?;
        }
        work.calibrate(&mut batch, &readings, &degc)?;
        writer.write(&batch)?;
    }
    work.counts.notes.extend(course.jumps(column));
    writer.finish()
}
