//! The ground calibration of a sensor in flight: its files, checked against each other, as the step that applies them.

use crate::data::apply::OffsetQuantity;
use crate::data::convention::Convention;
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::files::export::rpcmag;
use crate::files::flight::mission::Sensor;
use crate::files::parameter::{self, FileKind, ThermistorFile};
use crate::flight::temperature::Thermometer;
use crate::model::field_calibration::{Coefficients, FieldCalibration, Frame, MatrixForm};
use crate::record::known::Known;
use crate::record::single_readings::SingleReadings;
use crate::workflow::apply::{check_effects, of_readings};
use crate::workflow::{ApplyOptions, Outside, applied, known};
use std::path::{Path, PathBuf};

/// The ground calibration of one sensor.
#[derive(Clone, Debug)]
pub struct Ground {
    /// From readings to the field.
    pub calibration: FieldCalibration,
    /// Known effects that are taken off the readings first.
    pub effects: Option<SingleReadings>,
    /// From counts to temperatures.
    pub thermometer: Thermometer,
    /// Standard uncertainty of its offset `T_OFF`, °C; 0 where the files state none.
    pub t_off_std_degc: f64,
    /// Temperatures of the files, °C.
    pub valid_degc: [f64; 2],
    /// Convention of the sensor frame.
    pub convention: Option<Convention>,
    /// Frame in words.
    pub frame: String,
    /// The files.
    pub inputs: Vec<Input>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

const REMEDY: &str = "name one ground calibration file, or a TCF or TPF file with its TOF and THERMISTOR files";

/// The signal of a thermistor in flight.
const VOLTS: &str = "V";

/// Reads the ground calibration of a sensor.
///
/// # Errors
/// What is wrong with a file; files of another sensor, without offset or thermistor, without a range of temperatures.
pub fn read(sensor: &Sensor, findings: &mut Vec<Finding>) -> Result<Ground, Finding> {
    let names: Vec<String> = sensor.ground.iter().map(|path| path.display().to_string()).collect();
    let all = names.join(", ");
    let model = known(sensor.model.as_ref())?;
    let ground = match sensor.ground.as_slice() {
        [path] if rpcmag::is_named(path) => of_ground_file(path, sensor, model.as_ref(), findings)?,
        _ if sensor.ignore_residual => {
            let rule = "state no residual field B_RES that `residual = \"ignore\"` could leave in the offset";
            return Err(Finding::error(&all, rule, "take `residual` out: a ground calibration file (RPCMAG) alone has it"));
        }
        files => of_parameter_files(files, &all, model.as_ref(), findings)?,
    };
    let (mut ground, stated) = ground;
    check_name(sensor, &stated, &all, &mut ground.notes)?;
    if ground.calibration.parts().offset == Some(OffsetQuantity::BOr) && !sensor.accept_b_or {
        let rule = "state the offset together with the residual field of the coil system where the sensor was calibrated";
        return Err(Finding::error(&all, rule, "name a TOF file beside it, or say accept_b_or = true"));
    }
    if sensor.frame.is_some_and(|wanted| Some(wanted) != ground.convention) {
        let wanted = sensor.frame.map_or("", Convention::sensor_frame);
        ground.notes.push(Note::new(NoteKind::Axes, format!("the field is turned to the frame {wanted}")).about(&sensor.name));
        ground.frame = wanted.to_owned();
    }
    Ok(ground)
}

/// The sensor that the files state must be the one of the configuration.
fn check_name(sensor: &Sensor, stated: &str, all: &str, notes: &mut Vec<Note>) -> Result<(), Finding> {
    match &sensor.ground_sensor {
        Some(named) if named == stated => Ok(()),
        None if stated == sensor.name => Ok(()),
        None if stated.ends_with(&sensor.name) => {
            let text = format!("the ground calibration is of {stated}, which is taken for {}", sensor.name);
            let note = Note::new(NoteKind::Method, text).about(&sensor.name);
            notes.push(note.with_remedy(format!("confirm it with ground_sensor = \"{stated}\"")));
            Ok(())
        }
        named => {
            let wanted = named.as_ref().unwrap_or(&sensor.name);
            let remedy = format!("name the files of {wanted}, or say ground_sensor = \"{stated}\"");
            Err(Finding::error(all, format!("are of sensor {stated}, not of {wanted}"), remedy))
        }
    }
}

fn of_ground_file(
    path: &Path,
    sensor: &Sensor,
    model: Option<&Known>,
    findings: &mut Vec<Finding>,
) -> Result<(Ground, String), Finding> {
    let (mut file, digested) = rpcmag::read(path, findings)?;
    let mut notes = Vec::new();
    if sensor.ignore_residual {
        file.b_res_ent = [0.0; 3];
        file.std.remove("B_RES");
        notes.push(Note::new(NoteKind::Method, "the residual field B_RES is left in the offset").about(&sensor.name));
    }
    if file.covariance.is_none() {
        // The transfer to the centre is exact where the file states no uncertainty of it.
        let exact: Vec<&str> = ["K_0", "K_1", "K_2"].into_iter().filter(|label| !file.std.contains_key(*label)).collect();
        if !exact.is_empty() && file.std.contains_key("A_0") {
            let text = format!("{} have no uncertainty in the file and are taken as exact", exact.join(", "));
            notes.push(Note::new(NoteKind::Method, text).about(&sensor.name));
        }
        for label in exact {
            file.std.insert(label.to_owned(), vec![0.0; 3]);
        }
        let text = "the file states standard uncertainties without correlations: the common uncertainty is an upper limit where slopes \
                    and offsets are anti-correlated";
        notes.push(Note::new(NoteKind::Method, text).about(&sensor.name));
    }
    let part = file.field_part();
    check_effects(&path.display().to_string(), &part, model, false)?;
    let effects = of_readings(model, "take a calibration without known effects", &mut notes)?;
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let thermometer = Thermometer { coefficients: file.thermistor.to_vec(), t_off_degc: file.t_off_degc };
    let ground = Ground {
        calibration: calibration(part.coefficients, &path.display().to_string())?,
        effects,
        thermometer,
        t_off_std_degc: stated_std(file.std.get("T_OFF").and_then(|list| list.first()).copied()),
        valid_degc: file.valid_degc,
        convention: Some(Convention::Rosetta),
        frame: part.frame,
        inputs: std::iter::once(digested.input(name)).chain(model.map(|known| known.input.clone())).collect(),
        notes,
    };
    Ok((ground, file.sensor))
}

/// An uncertainty that a file may state; without one it is taken as exact.
fn stated_std(std: Option<f64>) -> f64 {
    std.filter(|std| std.is_finite()).unwrap_or(0.0)
}

fn calibration(coefficients: Coefficients, all: &str) -> Result<FieldCalibration, Finding> {
    FieldCalibration::new(coefficients).map_err(|e| Finding::error(all, e.to_string(), REMEDY))
}

fn of_parameter_files(
    files: &[PathBuf],
    all: &str,
    model: Option<&Known>,
    findings: &mut Vec<Finding>,
) -> Result<(Ground, String), Finding> {
    let is_thermistor = |path: &&PathBuf| FileKind::of_file(path).is_some_and(|kind| kind.format == "THERMISTOR");
    let (thermistors, others): (Vec<&PathBuf>, Vec<&PathBuf>) = files.iter().partition(is_thermistor);
    let [thermistor] = thermistors[..] else {
        let rule = if thermistors.is_empty() { "hold no THERMISTOR file" } else { "hold several THERMISTOR files" };
        return Err(Finding::error(all, rule, REMEDY));
    };
    let others: Vec<PathBuf> = others.into_iter().cloned().collect();
    let options = ApplyOptions {
        frame: Frame::Sensor,
        outside: Outside::Flag,
        temperature_column: None,
        temperature_degc: None,
        effects_taken_off: false,
    };
    let made = applied(&others, model, &options, findings)?;
    let thermometer = parameter::read::<ThermistorFile>(thermistor)?;
    let polynomial = &thermometer.body.polynomial;
    let shown = thermistor.display().to_string();
    if polynomial.signal_unit != VOLTS {
        let rule = format!("takes {}, and telemetry gives volts", polynomial.signal_unit);
        return Err(Finding::error(&shown, rule, "make it from a table of voltages"));
    }
    if let Some(other) = polynomial.sensor.as_ref().filter(|sensor| **sensor != made.sensor) {
        let rule = format!("is of sensor {other}, the other files are of {}", made.sensor);
        return Err(Finding::error(&shown, rule, "name the THERMISTOR file of the same sensor"));
    }
    // What is said of files is to be the same wherever they stand.
    let mut notes = made.notes;
    for note in &mut notes {
        for path in &others {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            note.text = note.text.replace(&path.display().to_string(), &name);
            note.about = note.about.take().map(|about| about.replace(&path.display().to_string(), &name));
        }
    }
    let t_off_degc = match &thermometer.body.reference {
        Some(reference) => reference.offset_degc,
        None => {
            let text = "the thermistor was not compared with a reference thermometer: T_OFF is zero";
            notes.push(Note::new(NoteKind::Temperature, text).about(&polynomial.table));
            0.0
        }
    };
    let Some(valid_degc) = made.calibration.parts().valid_degc else {
        return Err(Finding::error(
            all,
            "do not say for which temperatures they hold",
            "make them again from runs with temperatures",
        ));
    };
    // Beyond its table the thermistor is a polynomial that nothing holds.
    let Some(valid_degc) = thermometer.body.within(valid_degc) else {
        let [low, high] = thermometer.body.range_degc();
        let rule = format!("tells temperatures from {low:.1} to {high:.1} °C, at which the calibration does not hold");
        return Err(Finding::error(&shown, rule, "name the table of the thermistor that the sensor has"));
    };
    let mut inputs = made.inputs;
    inputs.push(thermometer.input.clone());
    let convention = match made.calibration.parts().matrix {
        Some(MatrixForm::Alignment(convention)) => Some(convention),
        _ => None,
    };
    let ground = Ground {
        thermometer: Thermometer { coefficients: polynomial.coefficients.clone(), t_off_degc },
        t_off_std_degc: stated_std(thermometer.body.reference.as_ref().and_then(|reference| reference.offset_std_degc)),
        valid_degc,
        convention,
        frame: made.frame,
        calibration: made.calibration,
        effects: made.effects,
        inputs,
        notes,
    };
    Ok((ground, made.sensor))
}
