//! The daily offset models of a mission from its own calm times (RO-IGEP-TR0028 section 4.2.3.3).

use super::day::{Context, Product};
use super::{Carry, DayFailed, Level, Prepared, day_name, prepare};
use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::files::flight::auxiliary;
use crate::files::flight::daily::{covariances, head, path_of};
use crate::files::output::Folder;
use crate::files::text::quoted;
use crate::flight::calm::{CalmRow, MULTIPLE, calm_rows};
use crate::flight::daily_fit::{DailyFit, fit};
use crate::flight::made::DailyMade;
use crate::model::polynomial::TemperaturePolynomial;
use crate::plot::{self, flight as figures};
use crate::show::flight::{DailyShown, daily_document};
use crate::show::{Drawn, html};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// What is fitted, and where it goes.
#[derive(Clone, Debug)]
pub struct DailyOptions {
    /// Highest order that is tried.
    pub order: usize,
    /// Table of calm times; without it they are found.
    pub calm: Option<PathBuf>,
    /// Only this sensor.
    pub sensor: Option<String>,
    /// First and last day, counted from 1970-01-01.
    pub days: [Option<i32>; 2],
    /// Folder of the models.
    pub out: PathBuf,
    /// Foreign files are written over.
    pub force: bool,
    /// Figures are drawn.
    pub plots: bool,
}

/// The models that were made.
#[derive(Clone, Debug, Default, Serialize)]
pub struct DailyModels {
    /// Models, sensor by sensor and day by day.
    pub models: Vec<DailyMade>,
    /// Days without a model, with the reason.
    pub failed: Vec<DayFailed>,
}

/// Fits the daily models of a mission and writes them.
///
/// # Errors
/// What is wrong with the configuration or a table; what the operating system says. A day that has no model does not stop the others.
pub fn make_daily(path: &Path, options: &DailyOptions, findings: &mut Vec<Finding>) -> Result<DailyModels, Finding> {
    let mut prepared = prepare(path, findings)?;
    prepared.mission.steps.retain(|step| step != "daily");
    prepared.mission.uncertainty = true;
    let shown = path.display().to_string();
    if let Some(name) = &options.sensor
        && !prepared.mission.sensors.iter().any(|s| s.name == *name)
    {
        return Err(Finding::error(&shown, format!("has no sensor {name}"), "name one of its [[sensor]]"));
    }
    let calm =
        options.calm.as_ref().map(|table| auxiliary::calm(table, prepared.mission.time_rule, &prepared.leap)).transpose()?;
    let (spans, table) = calm.map_or((None, None), |(spans, input)| (Some(spans), Some(input)));
    let spans: Option<Vec<Range<i64>>> = spans.map(|list| list.into_iter().map(|span| span.from..span.to).collect());
    let folder = Folder::open(&options.out, options.force)?;
    let mut made = DailyModels::default();
    let mut drawn: Vec<Vec<Drawn>> = Vec::new();
    let [first, last] = options.days;
    for (index, sensor) in prepared.mission.sensors.iter().enumerate() {
        if sensor.ground.is_empty() || options.sensor.as_ref().is_some_and(|name| *name != sensor.name) {
            continue;
        }
        let wanted = |day: &i32| first.is_none_or(|first| *day >= first) && last.is_none_or(|last| *day <= last);
        for day in prepared.days(sensor)?.filter(wanted) {
            match model_of(&prepared, index, day, spans.as_deref(), options.order) {
                Ok(None) => {}
                Ok(Some(model)) => {
                    let written = model.write(&folder, &prepared, index, table.as_ref())?;
                    drawn.push(if options.plots { model.draw(&written, options)? } else { Vec::new() });
                    made.models.push(written);
                }
                Err(error) => {
                    made.failed.push(DayFailed { sensor: sensor.name.clone(), day: day_name(day), error });
                }
            }
        }
    }
    let list: Vec<DailyShown> = made.models.iter().cloned().zip(drawn).collect();
    let without: Vec<[String; 3]> =
        made.failed.iter().map(|f| [f.day.clone(), f.sensor.clone(), f.error.rule.to_string()]).collect();
    let document = daily_document(&prepared.mission.mission, &prepared.mission.instrument, &list, &without);
    let page = html::page(&document, &mut |file| std::fs::read(options.out.join(file)).ok());
    folder.write("DAILY.html", page.as_bytes())?;
    folder.sync()?;
    Ok(made)
}

/// A model with what it is made of.
struct Model {
    day: i32,
    rows: Vec<CalmRow>,
    fit: DailyFit,
    inputs: Vec<Input>,
    is_stated: bool,
}

/// The model of a sensor and day; `None` for a day without vectors.
fn model_of(
    prepared: &Prepared,
    index: usize,
    day: i32,
    spans: Option<&[Range<i64>]>,
    order: usize,
) -> Result<Option<Model>, Finding> {
    let wanted = BTreeSet::from([Level::A]);
    let carry = Carry::default();
    let span = prepared.leap.day(day);
    let mut found = None;
    Context::new(prepared, &carry, index, day, &wanted).make(&mut |_, product, own, _| {
        if let Product::Vectors(blocks) = product {
            found = Some((calm_rows(blocks, &span, spans), own.to_vec()));
        }
        Ok(())
    })?;
    let Some((rows, inputs)) = found else { return Ok(None) };
    let name = format!("{} {}", prepared.mission.sensors[index].name, day_name(day));
    let fit = fit(&rows, order).map_err(|e| Finding::error(&name, e.to_string(), e.remedy()))?;
    Ok(Some(Model { day, rows, fit, inputs, is_stated: spans.is_some() }))
}

impl Model {
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        for (c, name) in ["x", "y", "z"].into_iter().enumerate() {
            if self.fit.refused[c] {
                notes.push(format!(
                    "{name}: a higher order than {} describes the calm minutes a little better, but slow noise explains as much, or \
                     hours without part in the fit do not follow it; it is not used",
                    self.fit.polynomials[c].order()
                ));
            }
        }
        if self.fit.explained.contains(&None) {
            notes.push("fewer than three hours are calm, so that nothing was held out of the fit".to_owned());
        }
        notes
    }

    /// Writes the file of the model.
    fn write(&self, folder: &Folder, prepared: &Prepared, index: usize, table: Option<&Input>) -> Result<DailyMade, Finding> {
        let sensor = &prepared.mission.sensors[index];
        let pattern = match &sensor.daily {
            Some(pattern) => pattern.clone(),
            None => format!("{}_{{yymmdd}}_CALIB_{}.toml", prepared.mission.instrument.replace([' ', '/'], "-"), sensor.name),
        };
        let path = path_of(Path::new(""), &pattern, self.day);
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let valid_degc = self.fit.polynomials[0].valid_degc;
        let mut text = head("fitted to calm times", &sensor.name, self.day, &self.fit.polynomials, valid_degc);
        if let Some(explained) = all(self.fit.explained) {
            let _ =
                writeln!(text, "# Share of the squares of hours without part in the fit that the temperature explains: x, y, z.");
            let _ = writeln!(text, "explained = [{:?}, {:?}, {:?}]", explained[0], explained[1], explained[2]);
        }
        let how = if self.is_stated {
            "the minutes within a table of calm times".to_owned()
        } else {
            format!("minutes in which means of 1 s scatter by at most {MULTIPLE} times their noise")
        };
        let _ = writeln!(text, "# {how}");
        let intervals = self.rows.chunk_by(|a, b| a.to == b.from).map(|list| (list[0].from, list[list.len() - 1].to));
        let leap = &prepared.leap;
        let intervals: Vec<String> =
            intervals.map(|(from, to)| format!("  \"{}Z/{}Z\",", leap.utc(from), leap.utc(to))).collect();
        let _ = writeln!(text, "calm = [\n{}\n]", intervals.join("\n"));
        text.push_str(&covariances(&self.fit.polynomials));
        let inputs = prepared.inputs.iter().chain(&self.inputs).chain(table);
        let inputs: Vec<String> =
            inputs.map(|input| format!("  {},", quoted(&format!("{} sha256:{}", input.path, input.sha256)))).collect();
        let _ = writeln!(
            text,
            "\n[provenance]\nwritten_by = \"calfit {}\"\ninputs = [\n{}\n]",
            env!("CARGO_PKG_VERSION"),
            inputs.join("\n")
        );
        folder.write(&name, text.as_bytes())?;
        Ok(DailyMade {
            sensor: sensor.name.clone(),
            day: day_name(self.day),
            file: name,
            order: self.fit.polynomials.each_ref().map(TemperaturePolynomial::order),
            coefficients: self.fit.polynomials.each_ref().map(|p| p.coefficients.clone()),
            explained: self.fit.explained,
            residual_nt: self.fit.residual_nt,
            minutes: self.rows.len(),
            valid_degc,
            notes: self.notes(),
        })
    }

    /// Draws the calm minutes over the temperature with the model.
    fn draw(&self, made: &DailyMade, options: &DailyOptions) -> Result<Vec<Drawn>, Finding> {
        const FIGURES: &str = "figures";
        let points: Vec<(f64, [f64; 3])> = self.rows.iter().map(|row| (row.degc, row.field_nt)).collect();
        let figure = figures::daily(&made.sensor, &made.day, &points, &self.fit.polynomials);
        let file = format!("daily__{}_{}.png", made.sensor, made.day.replace('-', ""));
        let picture = plot::render(&figure).map_err(|e| Finding::error(&file, e.to_string(), "run again with --no-plots"))?;
        Folder::open(&options.out.join(FIGURES), options.force)?.write(&file, &picture)?;
        Ok(vec![Drawn { file, title: figure.title, caption: figure.caption }])
    }
}

fn all(list: [Option<f64>; 3]) -> Option<[f64; 3]> {
    let [x, y, z] = list;
    Some([x?, y?, z?])
}
