//! The coefficient files that simulated telemetry is calibrated with: those that were given, or exact ones.

use super::Telemetry;
use crate::data::across::{LinearScope, RunResidualFields, RunRotations};
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind, Told};
use crate::data::provenance::Provenance;
use crate::data::recipe::Recipe;
use crate::data::result::Covariance;
use crate::data::run::Location;
use crate::data::thermistor::{ReferenceComparison, ThermistorPolynomial};
use crate::files::export::rpcmag;
use crate::files::output::Folder;
use crate::files::parameter::{
    Body, FileKind, ThermalConvention, ThermalHead, ThermistorConvention, ThermistorFile, Tof, Tpf, read_any, to_text,
};
use crate::files::source::read_whole;
use crate::files::twin::telemetry::FlightSensor;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The coefficient files of a sensor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ground {
    /// Their paths from the folder of the telemetry.
    pub files: Vec<String>,
    has_matrix: bool,
    has_thermistor: bool,
}

/// The sensor that a coefficient file states, and whether it holds a thermistor.
struct Stated {
    sensor: Option<String>,
    thermistor: bool,
    matrix: bool,
}

fn stated(path: &Path) -> Result<Stated, Finding> {
    if rpcmag::is_named(path) {
        let (file, _) = rpcmag::read(path, &mut Vec::new())?;
        return Ok(Stated { sensor: Some(file.sensor), thermistor: true, matrix: true });
    }
    let kind = FileKind::of_file(path).map_or("", |kind| kind.format);
    if !["TCF", "TPF", "TOF"].contains(&kind) {
        let remedy = "name ground calibration files, or TCF, TPF and TOF files";
        return Err(Finding::error(&path.display().to_string(), "is no coefficient file of a sensor in flight", remedy));
    }
    let document = read_any(path)?.document;
    let sensor = document.get("sensor").and_then(|v| v.as_str()).map(str::to_owned);
    Ok(Stated { sensor, thermistor: false, matrix: kind != "TOF" })
}

/// Copies the files that were given into the folder of the telemetry, to the sensor that each states, and writes exact ones
/// for sensors without. The thermistors belong to the spacecraft, so that no ground twin knows them: their files are always
/// exact where no given file holds one.
///
/// # Errors
/// A file of no sensor of the twin, or that cannot be read or written.
pub fn write(telemetry: &Telemetry<'_>, given: &[PathBuf], out: &Path, force: bool) -> Result<[Ground; 2], Finding> {
    let sensors = &telemetry.twin.sensors;
    let mut ground = [Ground::default(), Ground::default()];
    for path in given {
        let found = stated(path)?;
        let index = sensors.iter().position(|s| found.sensor.as_ref() == Some(&s.twin.name)).ok_or_else(|| {
            let rule = format!("is of sensor {}, which the twin does not have", found.sensor.as_deref().unwrap_or("unknown"));
            Finding::error(&path.display().to_string(), rule, "name the files of its sensors")
        })?;
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let (bytes, _) = read_whole(path)?;
        ground[index].put(&sensors[index], &name, &bytes, out, force)?;
        ground[index].has_matrix |= found.matrix;
        ground[index].has_thermistor |= found.thermistor;
    }
    for (own, sensor) in ground.iter_mut().zip(sensors) {
        if !own.has_matrix {
            if let Some(file) = own.files.first() {
                return Err(Finding::error(file, "states no sensitivities and angles", "name a TCF or TPF file beside it"));
            }
            // There is no first run that names could come from.
            own.body(sensor, &format!("THERMAL_PARAMETER__{}.TPF", sensor.name), &tpf(sensor), out, force)?;
            own.body(sensor, &format!("THERMAL_OFF_PARAMETER__{}.TOF", sensor.name), &tof(sensor), out, force)?;
        }
        if !own.has_thermistor {
            let body = thermistor(sensor);
            own.body(sensor, &body.file_name(), &body, out, force)?;
        }
    }
    Ok(ground)
}

impl Ground {
    fn put(&mut self, sensor: &FlightSensor, name: &str, bytes: &[u8], out: &Path, force: bool) -> Result<(), Finding> {
        let below = format!("ground/{}", sensor.name);
        Folder::open(&out.join(&below), force)?.write(name, bytes)?;
        self.files.push(format!("{below}/{name}"));
        Ok(())
    }

    fn body<B: Body>(&mut self, sensor: &FlightSensor, name: &str, body: &B, out: &Path, force: bool) -> Result<(), Finding> {
        let provenance = Provenance::new(Recipe::plain("simulate"), Vec::new());
        let text = to_text(body, &provenance)
            .map_err(|e| Finding::error(name, format!("the truth has no text form: {e}"), "correct the ground twin"))?;
        self.put(sensor, name, text.as_bytes(), out, force)
    }
}

/// Coefficients that are known exactly.
fn certain(polynomials: &[(&str, &Vec<f64>)]) -> BTreeMap<String, Vec<Vec<f64>>> {
    polynomials.iter().map(|(name, p)| ((*name).to_owned(), vec![vec![0.0; p.len()]; p.len()])).collect()
}

fn head(sensor: &FlightSensor, polynomials: &[(&str, &Vec<f64>)]) -> ThermalHead {
    ThermalHead {
        used: Vec::new(),
        channel: format!("T_{}", sensor.name),
        valid_degc: sensor.valid_degc,
        sensor: sensor.twin.name.clone(),
        mode: sensor.twin.mode.clone(),
        location: Location::Centre,
        runs: Vec::new(),
        temperature_degc: Vec::new(),
        coil_temperature_degc: Vec::new(),
        convention: ThermalConvention::default(),
        covariance: certain(polynomials),
        covariance_b: BTreeMap::new(),
        common: Vec::new(),
        covariance_combined: BTreeMap::new(),
        quantity: Vec::new(),
        told: Told::of(&[Note::new(NoteKind::Method, "the truth of a twin, not the result of an analysis")]),
    }
}

fn tpf(sensor: &FlightSensor) -> Tpf {
    let model = &sensor.twin.model;
    let ([sx, sy, sz], [xy, xz, yz]) = (model.sigma.each_ref(), model.xi_deg.each_ref());
    let [x, y, z] = model.b_off_ent.each_ref();
    let named = [
        ("sigma_x", sx),
        ("sigma_y", sy),
        ("sigma_z", sz),
        ("xi_xy", xy),
        ("xi_xz", xz),
        ("xi_yz", yz),
        ("b_or_x", x),
        ("b_or_y", y),
        ("b_or_z", z),
    ];
    Tpf {
        sigma_x: sx.clone(),
        sigma_y: sy.clone(),
        sigma_z: sz.clone(),
        xi_xy: xy.clone(),
        xi_xz: xz.clone(),
        xi_yz: yz.clone(),
        b_or_x: x.clone(),
        b_or_y: y.clone(),
        b_or_z: z.clone(),
        head: head(sensor, &named),
        reference: None,
        scope: LinearScope::default(),
        together: None,
        together_combined: None,
        rotation: RunRotations::default(),
        model_error: None,
        joint: None,
        sweep: None,
        noise: Vec::new(),
    }
}

fn tof(sensor: &FlightSensor) -> Tof {
    let [x, y, z] = sensor.twin.model.b_off_ent.each_ref();
    Tof {
        b_off_x: x.clone(),
        b_off_y: y.clone(),
        b_off_z: z.clone(),
        head: head(sensor, &[("b_off_x", x), ("b_off_y", y), ("b_off_z", z)]),
        residual_field: RunResidualFields::default(),
    }
}

fn thermistor(sensor: &FlightSensor) -> ThermistorFile {
    let coefficients = sensor.thermistor_degc.clone();
    ThermistorFile {
        polynomial: ThermistorPolynomial {
            table: sensor.name.clone(),
            sensor: None,
            signal: "u".to_owned(),
            signal_unit: "V".to_owned(),
            order: coefficients.len().saturating_sub(1),
            reason: "the truth of a twin".to_owned(),
            coefficients_std: vec![0.0; coefficients.len()],
            coefficients,
            residual_max_degc: 0.0,
            residual_std_degc: 0.0,
            within_degc: 0.0,
            order_within: None,
            valid_signal: [-2.5, 2.5],
            // The table is of the thermistor, the other temperatures are those of the sensor.
            valid_degc: sensor.valid_degc.map(|degc| degc + sensor.t_off_degc),
        },
        convention: ThermistorConvention::default(),
        covariance: Covariance { parameters: Vec::new(), units: Vec::new(), matrix: Vec::new() },
        compared: None,
        reference: Some(ReferenceComparison {
            offset_degc: sensor.t_off_degc,
            offset_std_degc: Some(0.0),
            readings: 1,
            range_degc: sensor.valid_degc,
            slope: None,
            slope_std: None,
        }),
        orders: Vec::new(),
        row: Vec::new(),
        told: Told::default(),
    }
}
