//! Raw readings to calibrated field: parameter files and vectors in, vectors with field, uncertainty and flags out.

mod course;
mod run_vectors;
mod statement;
mod table_vectors;

use super::Failure;
use crate::data::apply::OffsetQuantity;
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::{Reading as Allowed, Recipe};
use crate::data::run::{Location, Run};
use crate::data::units::{COMPONENTS, Reading};
use crate::files::field::read_field;
use crate::files::output::Folder;
use crate::files::parameter::{FieldPart, HeldIn};
use crate::files::source::digest;
use crate::files::table::stream::{Batch, Format, Reader, with_note};
use crate::model::field_calibration::{CalibratedField, CalibrationError, Coefficients, FieldCalibration, Frame, MatrixForm};
use crate::model::lag::Lag;
use crate::record::known::{Known, OtherSensor};
use crate::record::single_readings::{NeedsMore, SingleReadings, TakenOff};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statement::COLUMNS_OF_RUN;
use std::path::{Path, PathBuf};

/// What becomes of vectors outside of the ranges of the calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outside {
    /// The field is given and flagged.
    #[default]
    Flag,
    /// The field is left empty, with its flag.
    Null,
    /// The first of them is an error.
    Error,
}

/// How a calibration is applied.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ApplyOptions {
    /// Frame of the result.
    pub frame: Frame,
    /// What becomes of vectors outside.
    pub outside: Outside,
    /// Column, or channel of a run, that holds the sensor temperature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_column: Option<String>,
    /// One sensor temperature for all vectors, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_degc: Option<f64>,
    /// The known effects that were taken off the runs of the calibration are taken off the readings as well.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub effects_taken_off: bool,
}

/// The calibration that parameter files make together.
#[derive(Clone, Debug)]
pub struct Applied {
    /// The calibration.
    pub calibration: FieldCalibration,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Frame of the result, in words.
    pub frame: String,
    /// The position of the sensor in which the result stands in coil axes; absent for any other frame.
    pub position: Option<HeldIn>,
    /// The thermistor that the files are of, where they say it.
    pub channel: Option<String>,
    /// How the part of the sensor whose temperature counts goes after that thermistor, where the two differ.
    pub lag: Option<Lag>,
    /// Known effects that are taken off the readings first.
    pub effects: Option<SingleReadings>,
    /// The files.
    pub inputs: Vec<Input>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// Reads parameter files as one calibration; notes on the files go to `findings`.
///
/// # Errors
/// What is wrong with a file; files of several sensors, modes or thermistors, two matrices or two offsets, none of either, a frame that
/// the files do not state, known effects that the readings still hold.
pub fn applied(
    paths: &[PathBuf],
    model: Option<&Known>,
    options: &ApplyOptions,
    findings: &mut Vec<Finding>,
) -> Result<Applied, Finding> {
    let mut inputs = Vec::new();
    let mut beside = None;
    let mut of_files = Vec::new();
    let mut matrix: Option<(&PathBuf, Coefficients, String)> = None;
    let mut offset: Option<(&PathBuf, Coefficients)> = None;
    let mut of: Option<(String, String, &PathBuf)> = None;
    let mut thermistor: Option<(String, &PathBuf)> = None;
    let mut lag = None;
    let mut position = None;
    for path in paths {
        let shown = path.display().to_string();
        let (part, input) = read_field(path, options.frame, findings)?;
        inputs.push(input);
        of_files.extend(part.notes.iter().cloned());
        check_effects(&shown, &part, model, options.effects_taken_off)?;
        match &of {
            None => of = Some((part.sensor, part.mode, path)),
            Some((sensor, mode, first)) if (sensor, mode) != (&part.sensor, &part.mode) => {
                let rule = format!("is of {} {}, {} of {sensor} {mode}", part.sensor, part.mode, first.display());
                return Err(Finding::error(&shown, rule, "name files of one sensor in one mode"));
            }
            Some(_) => {}
        }
        if let Some(channel) = part.channel {
            match &thermistor {
                Some((other, first)) if *other != channel => {
                    let rule = format!("is of the temperature of {channel}, {} of that of {other}", first.display());
                    return Err(Finding::error(&shown, rule, "name files of one thermistor"));
                }
                _ => thermistor = Some((channel, path)),
            }
        }
        // That of the sensitivities: a TOF of runs at rest has none.
        lag = lag.or(part.lag);
        let second = |first: &Path, what: &str| {
            let rule = format!("states {what}, and so does {}", first.display());
            Finding::error(&shown, rule, "name one of them")
        };
        if part.coefficients.matrix.is_some() {
            if let Some((first, ..)) = &matrix {
                return Err(second(first, "sensitivities and angles"));
            }
            if part.location == Location::OffCentre {
                let text = format!(
                    "{shown} holds for the field beside the centre of the coil system, which is not that of its settings"
                );
                let note = Note::new(NoteKind::Facility, text).about(&shown);
                beside = Some(note.with_remedy("apply the TCF file, whose sensitivities are those at the centre"));
            }
            position = part.position;
            matrix = Some((path, part.coefficients, part.frame));
        } else {
            if let Some((first, _)) = &offset {
                return Err(second(first, "the offset"));
            }
            offset = Some((path, part.coefficients));
        }
    }
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    let all = names.join(", ");
    let (Some((matrix_path, parts, frame_words)), Some((sensor, mode, _))) = (matrix, of) else {
        let rule = format!("{} no sensitivities and angles", if names.len() == 1 { "states" } else { "state" });
        return Err(Finding::error(&all, rule, "name a CPF, TPF or TCF file, or a ground calibration file"));
    };
    let refuse = |e: CalibrationError| Finding::error(&all, e.to_string(), "name files that make one calibration together");
    let parts = match offset {
        None => parts,
        Some((path, own)) => {
            if parts.matrix == Some(MatrixForm::Whole) {
                let rule = format!("goes with polynomials, not with the calibration of one run, {}", matrix_path.display());
                return Err(Finding::error(&path.display().to_string(), rule, "name a TPF file beside it"));
            }
            if parts.offset == Some(OffsetQuantity::BOff) {
                let rule = format!("states the offset, and so does {}", matrix_path.display());
                return Err(Finding::error(&path.display().to_string(), rule, "name one of them"));
            }
            parts.with_offset_of(own).map_err(refuse)?
        }
    };
    let mut notes = notes(&parts, &all);
    notes.extend(beside);
    notes.extend(of_files);
    let calibration = FieldCalibration::new(parts).map_err(refuse)?;
    let effects = of_readings(model, "take it off the readings, and say so with --effects-taken-off", &mut notes)?;
    inputs.extend(model.map(|known| known.input.clone()));
    let channel = thermistor.map(|(channel, _)| channel);
    if let Some(lag) = lag {
        let text = format!(
            "the temperatures of {all} are those of a part of the sensor that goes after the thermistor{} with a {} of {} s",
            channel.as_ref().map_or_else(String::new, |name| format!(" {name}")),
            lag.form(),
            lag.seconds()
        );
        let remedy = "in a run this is taken into account; in a table, the column of temperatures has to be that of this part";
        notes.push(Note::new(NoteKind::Temperature, text).with_remedy(remedy));
    }
    Ok(Applied { calibration, sensor, mode, frame: frame_words, position, channel, lag, effects, inputs, notes })
}

/// The effects of a model, if there is one, that are taken off readings; notes tell those that readings do not have.
pub(super) fn of_readings(model: Option<&Known>, remedy: &str, notes: &mut Vec<Note>) -> Result<Option<SingleReadings>, Finding> {
    let Some(known) = model else { return Ok(None) };
    let refuse = |e: NeedsMore| Finding::error(&known.input.path, e.to_string(), remedy);
    notes.extend(known.untold());
    let (effects, left) = SingleReadings::of(known).map_err(refuse)?;
    notes.extend(left);
    Ok(Some(effects))
}

/// Refuses a file whose known effects the readings still hold, and a model that the file was not made with.
pub(super) fn check_effects(file: &str, part: &FieldPart, model: Option<&Known>, are_taken_off: bool) -> Result<(), Finding> {
    if part.coefficients.matrix.is_none() {
        return Ok(());
    }
    if let Some(Err(other)) = model.map(|known| known.holds_for(&part.sensor, &part.mode)) {
        return Err(Finding::error(file, other.to_string(), OtherSensor::REMEDY));
    }
    let of = part.known_effects.join(", ");
    match model {
        None if part.known_effects.is_empty() || are_taken_off => Ok(()),
        None => {
            let rule = format!("holds for readings from which the effects of {of} were taken off");
            let remedy = "take a calibration without known effects, or name the model: --model of `calfit apply`, `model` of a sensor in \
                          flight";
            Err(Finding::error(file, rule, remedy))
        }
        // What a file holds counts, not its name. A file that does not say what the model held is taken at its word.
        Some(known) if !part.known_effects.is_empty() && !part.models.is_empty() => {
            let Some(other) = part.models.iter().find(|made| made.sha256 != known.input.sha256) else { return Ok(()) };
            let rule = format!(
                "was made with the known effects of {} of the SHA-256 {:.12}…, and {} has {:.12}…",
                other.path, other.sha256, known.input.path, known.input.sha256
            );
            Err(Finding::error(file, rule, "name the model that it was made with"))
        }
        Some(known) if part.known_effects == [known.input.path.clone()] => Ok(()),
        Some(known) => {
            let made = if of.is_empty() { "without known effects".to_owned() } else { format!("with those of {of}") };
            let rule = format!("was made {made}, not with those of {}", known.input.path);
            Err(Finding::error(file, rule, "name the model that it was made with"))
        }
    }
}

/// What a person should know of a calibration.
fn notes(parts: &Coefficients, files: &str) -> Vec<Note> {
    let mut notes = Vec::new();
    if parts.offset == Some(OffsetQuantity::BOr) {
        let text =
            "the offset is b_or: that of the sensor together with the residual field of the coil system where it was calibrated";
        notes.push(
            Note::new(NoteKind::Method, text)
                .with_remedy("for the offset of the sensor alone apply the TPF and TOF files of `calfit thermal`"),
        );
    }
    if parts.covariance.is_none() {
        let text = format!("{files} state no covariance of all coefficients, so that the field has no uncertainty");
        notes.push(Note::new(NoteKind::Method, text));
    }
    if parts.valid_degc.is_none() {
        let text = format!("{files} do not say for which temperatures they hold, so that no vector is flagged for it");
        notes.push(Note::new(NoteKind::Temperature, text));
    }
    if parts.range.is_none() {
        let text = format!("{files} do not say for which fields they hold, so that no vector is flagged for it");
        notes.push(Note::new(NoteKind::Method, text));
    }
    notes
}

/// What was made of a file of vectors.
#[derive(Clone, Debug, Serialize)]
pub struct AppliedFile {
    /// The file of readings.
    pub data: String,
    /// The file of calibrated vectors.
    pub file: String,
    /// Vectors.
    pub rows: usize,
    /// Vectors without a field.
    pub without_field: usize,
    /// Vectors by flag.
    pub flagged: Vec<Flagged>,
    /// What a person should know of the readings.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// Vectors with a flag.
#[derive(Clone, Debug, Serialize)]
pub struct Flagged {
    /// Value of the flag.
    pub flag: u32,
    /// What it says.
    pub meaning: &'static str,
    /// Vectors.
    pub rows: usize,
}

/// Vectors while they are calibrated.
struct Work<'a> {
    applied: &'a Applied,
    options: &'a ApplyOptions,
    data: &'a Path,
    counts: AppliedFile,
    /// What the columns are that stand before those of the calibration.
    of_data: &'static [(&'static str, &'static str)],
    /// What every component read so far.
    still_ent: [Still; 3],
}

/// What a component read so far.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Still {
    Nothing,
    Only(f64),
    Several,
}

impl Still {
    fn with(self, readings: &[f64]) -> Self {
        let join = |seen: Self, v: &f64| match seen {
            Still::Nothing => Still::Only(*v),
            Still::Only(one) if one == *v => seen,
            _ => Still::Several,
        };
        readings.iter().filter(|v| v.is_finite()).fold(self, join)
    }
}

/// Rows of which noise makes some differ.
const LEAST_ROWS: usize = 20;

const FIELD: [&str; 3] = ["bx_nt", "by_nt", "bz_nt"];
const STD: [&str; 3] = ["u_bx_nt", "u_by_nt", "u_bz_nt"];
const FLAGS: &str = "flags";
const TEMPERATURE: &str = "t_degc";

impl<'a> Work<'a> {
    fn new(applied: &'a Applied, options: &'a ApplyOptions, data: &'a Path, source: &Source, file: &str) -> Self {
        let flagged = Flags::OF_CALIBRATION.map(|(flag, meaning)| Flagged { flag: flag.0, meaning, rows: 0 }).to_vec();
        let counts = AppliedFile {
            data: data.display().to_string(),
            file: file.to_owned(),
            rows: 0,
            without_field: 0,
            flagged,
            notes: Vec::new(),
        };
        let of_data: &[(&str, &str)] = if matches!(source, Source::Run(_)) { &COLUMNS_OF_RUN } else { &[] };
        Self { applied, options, data, counts, of_data, still_ent: [Still::Nothing; 3] }
    }

    /// Calibrates the vectors of a batch with their temperatures.
    fn calibrate(&mut self, batch: &mut Batch, readings: &[Vec<f64>; 3], degc: &[f64]) -> Result<(), Finding> {
        let calibration = &self.applied.calibration;
        let [x, y, z] = readings;
        for (still, own) in self.still_ent.iter_mut().zip(readings) {
            *still = if *still == Still::Several { Still::Several } else { still.with(own) };
        }
        let taken = self.taken_off(readings, degc);
        let one = |i: usize| {
            let raw = [x[i], y[i], z[i]];
            let Some(taken) = taken.get(i) else { return calibration.apply(Reading(raw), Some(degc[i])) };
            let reading = Reading(std::array::from_fn(|k| raw[k] - taken.sum_ent[k]));
            with_effects(calibration.apply(reading, Some(degc[i])), taken, calibration, degc[i])
        };
        let calibrated: Vec<CalibratedField> = (0..batch.len()).into_par_iter().with_min_len(1 << 12).map(one).collect();
        let outside = |c: &CalibratedField| Flags::OF_CALIBRATION.iter().any(|(flag, _)| c.flags.any_of(*flag));
        if self.options.outside == Outside::Error
            && let Some(row) = calibrated.iter().position(outside)
        {
            return Err(self.refused(batch.before() + row + 1, calibrated[row].flags, degc[row]));
        }
        let leaves_out = |c: &CalibratedField| self.options.outside == Outside::Null && outside(c);
        let or_empty = |is_empty: bool, value: f64| if is_empty { f64::NAN } else { value };
        for (component, name) in FIELD.into_iter().enumerate() {
            batch.push(name, calibrated.iter().map(|c| or_empty(leaves_out(c), c.field_nt[component])).collect())?;
        }
        // Polynomials of the temperature state no uncertainty beyond their temperatures.
        let states_none = |c: &CalibratedField| leaves_out(c) || c.flags.any_of(Flags::TEMPERATURE);
        for (component, name) in STD.into_iter().enumerate() {
            batch.push(name, calibrated.iter().map(|c| or_empty(states_none(c), c.std_nt[component])).collect())?;
        }
        batch.push_bits(FLAGS, calibrated.iter().map(|c| c.flags.0).collect())?;
        self.counts.rows += calibrated.len();
        self.counts.without_field += calibrated.iter().filter(|c| leaves_out(c) || c.field_nt[0].is_nan()).count();
        for (count, (flag, _)) in self.counts.flagged.iter_mut().zip(Flags::OF_CALIBRATION) {
            count.rows += calibrated.iter().filter(|c| c.flags.any_of(flag)).count();
        }
        Ok(())
    }

    /// What the known effects are of readings; none without known effects.
    fn taken_off(&self, [x, y, z]: &[Vec<f64>; 3], degc: &[f64]) -> Vec<TakenOff> {
        let Some(effects) = &self.applied.effects else { return Vec::new() };
        let calibration = &self.applied.calibration;
        let without = |i: usize| {
            let offset = calibration.offset_ent(if calibration.needs_temperature() { degc[i] } else { 0.0 });
            [x[i] - offset[0], y[i] - offset[1], z[i] - offset[2]]
        };
        effects.taken_off(&(0..x.len()).map(without).collect::<Vec<_>>())
    }

    /// Refuses a file of which nothing came, `holds` in words, and notes what the readings as a whole show.
    fn judge(&mut self, holds: &str) -> Result<(), Finding> {
        if self.counts.rows == 0 {
            let remedy = "name a run with samples (@VECTORS), or a table with columns x, y and z";
            return Err(Finding::error(&self.data.display().to_string(), format!("holds {holds}; nothing was applied"), remedy));
        }
        for (name, still) in COMPONENTS.into_iter().zip(self.still_ent) {
            if let (Still::Only(reading), true) = (still, self.counts.rows >= LEAST_ROWS) {
                self.counts.notes.push(format!("component {name} stands still: all of its readings are {reading}"));
            }
        }
        Ok(())
    }

    /// Refuses a file without the temperature that the calibration needs.
    fn without_temperature(&self, lacks: &str) -> Result<(), Finding> {
        if !self.applied.calibration.needs_temperature() {
            return Ok(());
        }
        let rule = format!("{lacks}, and the calibration depends on the temperature of the sensor");
        let remedy = "name its column or channel with --temperature-column, or give one temperature with --temperature";
        Err(Finding::error(&self.data.display().to_string(), rule, remedy))
    }

    fn refused(&self, row: usize, flags: Flags, degc: f64) -> Finding {
        let words: Vec<&str> =
            Flags::OF_CALIBRATION.iter().filter(|(flag, _)| flags.any_of(*flag)).map(|(_, words)| *words).collect();
        let at = if degc.is_finite() { format!(" at {degc} °C") } else { String::new() };
        let rule = format!("vector {row}{at}: {}", words.join(", "));
        let remedy = "leave such vectors out, or use --outside flag or null";
        Finding::error(&self.data.display().to_string(), rule, remedy)
    }
}

/// The uncertainty of known effects beside that of the coefficients, taken as independent of it.
fn with_effects(mut found: CalibratedField, taken: &TakenOff, calibration: &FieldCalibration, degc: f64) -> CalibratedField {
    if taken.beyond {
        found.flags |= Flags::FIELD;
    }
    let Some(matrix) = calibration.matrix(if calibration.needs_temperature() { degc } else { 0.0 }) else { return found };
    for change in &taken.uncertain_ent {
        let change = matrix * Vector3::from(*change);
        (0..3).for_each(|k| found.std_nt[k] = found.std_nt[k].hypot(change[k]));
    }
    found
}

/// Where vectors come from.
enum Source {
    /// The run without its vectors: its reader tells the hash, and what stands behind them in the file.
    Run(Box<Run>),
    Table(Reader, Format),
}

impl Source {
    fn open(data: &Path, applied: &Applied, allowed: &Allowed) -> Result<Self, Failure> {
        match Format::of_name(data) {
            None => Ok(Source::Run(Box::new(run_vectors::read_run(data, applied, allowed)?))),
            Some(format) => {
                let reader = Reader::open(data).map_err(|finding| Failure::Unreadable(vec![finding]))?;
                Ok(Source::Table(reader, format))
            }
        }
    }

    fn format(&self) -> Format {
        match self {
            Source::Table(_, Format::Csv) => Format::Csv,
            _ => Format::Parquet,
        }
    }

    fn input(&self, data: &Path) -> Result<Input, Finding> {
        let name = data.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        match self {
            Source::Run(own) => Ok(Input { path: name, ..Input::from(&**own) }),
            Source::Table(..) => Ok(digest(data)?.input(name)),
        }
    }
}

/// Applies a calibration to a file of vectors: a run, or a table. Writes `<stem>.calibrated.parquet`, `.csv` for CSV, and a statement
/// `<stem>.calibrated.json` of what was done.
///
/// # Errors
/// What is wrong with the file; a run of another sensor or mode; vectors outside with [`Outside::Error`].
pub fn apply_to(
    data: &Path,
    applied: &Applied,
    options: &ApplyOptions,
    allowed: &Allowed,
    folder: &Folder,
) -> Result<AppliedFile, Failure> {
    let source = Source::open(data, applied, allowed)?;
    calibrated(data, source, applied, options, allowed, folder).map_err(Failure::Refused)
}

fn calibrated(
    data: &Path,
    source: Source,
    applied: &Applied,
    options: &ApplyOptions,
    allowed: &Allowed,
    folder: &Folder,
) -> Result<AppliedFile, Finding> {
    let stem = stem(data);
    let format = source.format();
    let name = format!("{stem}.calibrated.{}", if format == Format::Csv { "csv" } else { "parquet" });
    let statement_name = format!("{stem}.calibrated.json");
    if let Some(other) = other_result(folder, &statement_name, &name) {
        let rule = format!("its statement {statement_name} would replace that of {other}, which stands in the folder");
        let remedy = "choose another folder with -o, or take the older result away";
        return Err(Finding::error(&data.display().to_string(), rule, remedy));
    }
    let mut input = applied.inputs.clone();
    input.push(source.input(data)?);
    let recorded = serde_json::to_value(options).unwrap_or_default();
    let mut recipe = Recipe::new("apply", &recorded);
    recipe.reading = allowed.clone();
    let provenance = Provenance::new(recipe, input);
    let mut work = Work::new(applied, options, data, &source, &name);
    let no_form = |e: serde_json::Error| Finding::error(&name, format!("has no JSON form: {e}"), "report this");
    let note = serde_json::to_string(&work.statement(&provenance, None)).map_err(no_form)?;
    let mut file = folder.create(&name)?;
    let holds = match source {
        Source::Table(reader, format) => {
            table_vectors::table(&mut work, reader, format, &note, &mut file)?;
            "no vectors"
        }
        Source::Run(own) => {
            run_vectors::vectors(&mut work, &own, allowed, &note, &mut file)?;
            if own.blocks.is_empty() { "no vectors" } else { "plateau means (@BLOCKS) and no vectors" }
        }
    };
    work.judge(holds)?;
    if format == Format::Csv && !work.counts.notes.is_empty() {
        // What the readings as a whole show is known once all of them are written.
        let note = serde_json::to_string(&work.statement(&provenance, None)).map_err(no_form)?;
        file = with_note(file, folder.create(&name)?, &note)?;
    }
    file.finish()?;
    let mut text = serde_json::to_string_pretty(&work.statement(&provenance, Some(&work.counts))).map_err(no_form)?;
    text.push('\n');
    folder.write(&statement_name, text.as_bytes())?;
    Ok(work.counts)
}

/// The result that a statement in a folder is of, where it is another one than that of a name and still there.
fn other_result(folder: &Folder, statement: &str, own: &str) -> Option<String> {
    let text = std::fs::read(folder.path().join(statement)).ok()?;
    let stated: serde_json::Value = serde_json::from_slice(&text).ok()?;
    let of = stated.get("counts")?.get("file")?.as_str()?;
    (of != own && folder.path().join(of).is_file()).then(|| of.to_owned())
}

/// The name of a file without its endings.
#[must_use]
pub fn stem(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}
