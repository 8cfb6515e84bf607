//! The parameters of one run, as a comparison of runs takes them.

use crate::data::calibration::LinearCalibration;
use crate::data::plateau::Plateaus;
use crate::data::run::Run;
use crate::data::start::Start;
use crate::diagnose::DiagnoseError;
use crate::diagnose::means::Means;
use crate::files::campaign::Campaign;
use crate::fit::propagate::propagate;
use crate::measure::coil::tilt::additive;
use crate::measure::lin;
use crate::model::effects::Catalogue;
use crate::model::facility_calibration::SensorValues;
use crate::model::position::{Class, OrientedRun, Position};
use crate::model::sensor::split;
use crate::record::prepared::PreparedRun;
use nalgebra::Matrix3;

/// Rounding of values that come without uncertainties: ln σ, nT, degrees.
const ROUNDING: [f64; 3] = [1e-10, 1e-7, 1e-10];

/// The parameters of one run, and the conditions under which they were found.
#[derive(Clone, Debug, PartialEq)]
pub struct RunValues {
    /// Run id.
    pub run: String,
    /// Sensor, mode and location: runs of one name have one sensor.
    pub sensor: String,
    /// Set of runs that was made in one place: the campaign, or the table.
    pub set: String,
    /// Orientation.
    pub position: Position,
    /// Start, s.
    pub time: Option<f64>,
    /// Mean sensor temperature, °C.
    pub sensor_degc: Option<f64>,
    /// Mean temperature of the coil system, °C.
    pub coil_degc: Option<f64>,
    /// Largest applied field, nT: deviations of scale factors and angles are given in nT at this field.
    pub field_nt: Option<f64>,
    /// Sensitivity nT/enT, offset nT, angles degrees.
    pub values: SensorValues,
    /// Their standard uncertainties, where known.
    pub std: Option<SensorValues>,
    /// Independent values from which the uncertainties are known.
    pub freedom: f64,
}

impl RunValues {
    /// From a linear calibration. The offset is that in the middle of the run.
    ///
    /// # Errors
    /// The position is none.
    pub fn of_calibration(calibration: &LinearCalibration) -> Result<Self, DiagnoseError> {
        let sigma = calibration.sigma_nt_per_ent();
        let a = &calibration.angle_deg;
        // The mean of a run contains a part of the trend's curvature, which is no property of the sensor; a fitted parabola makes
        // the value in the middle 3/2 times as uncertain as the mean (equidistant times).
        let (offset_ent, factor): ([f64; 3], f64) = match calibration.offset.trend_order {
            0 | 1 => (calibration.offset.b_or_ent, 1.0),
            _ => (
                std::array::from_fn(|i| {
                    calibration.offset.trend_ent[i].first().copied().unwrap_or(calibration.offset.b_or_ent[i])
                }),
                1.5,
            ),
        };
        let std = SensorValues {
            scale: calibration.std.sigma,
            offset_nt: std::array::from_fn(|i| factor * sigma[i] * calibration.std.b_or_ent[i]),
            angles_deg: calibration.std.xi_deg,
        };
        let known = [std.scale, std.offset_nt, std.angles_deg].iter().flatten().all(|s| s.is_finite() && *s > 0.0);
        let most = calibration.valid.field_coil_nt.iter().flatten().fold(0.0, |m: f64, b| m.max(b.abs()));
        Ok(Self {
            run: calibration.run.id.clone(),
            sensor: format!("{}, {}{}", calibration.run.sensor, calibration.run.mode, calibration.run.location.suffix()),
            set: calibration.run.campaign.clone(),
            position: Position::from_axes(&calibration.setup.position_axes)?,
            time: calibration.run.start.as_ref().map(Start::seconds),
            sensor_degc: calibration.run.temperature_degc,
            coil_degc: calibration.run.coil_temperature_degc,
            field_nt: Some(most).filter(|m| m.is_finite() && *m > 0.0),
            values: SensorValues {
                scale: sigma,
                offset_nt: std::array::from_fn(|i| sigma[i] * offset_ent[i]),
                angles_deg: [a.xi_xy, a.xi_xz, a.xi_yz],
            },
            std: known.then_some(std),
            // Slow noise may exceed what a parameter file says of it: its uncertainties count little beside the scatter of the runs.
            freedom: 1.0,
        })
    }

    /// From a run: weighted least squares with the noise that a diagnosis finds in it, slow noise and noise of the gain included.
    ///
    /// # Errors
    /// The run has no linear calibration.
    pub fn of_run(run: &Run, plateaus: &Plateaus, campaign: &Campaign, options: &lin::Options) -> Result<Self, DiagnoseError> {
        let made = lin::lin(run, plateaus, &campaign.file.instructions, options)?;
        let mut own = Self::of_calibration(&made.calibration)?;
        let prepared = PreparedRun::new(run, plateaus, None, &campaign.file.instructions, options.facility.as_ref())
            .map_err(|e| DiagnoseError::Record(e.0))?;
        let (n, p) = prepared.design.shape();
        // Where fields beyond a limit were left out, the calibration stands as it is.
        let linear = (n == made.calibration.quality.blocks_used && p > 3)
            .then(|| Means::new(&prepared, prepared.readings.clone(), &Catalogue::default(), Vec::new()).linear())
            .flatten();
        let Some((found, covariance)) = linear else { return Ok(own) };
        let most = prepared.record.rows.iter().flat_map(|r| r.field_coil_nt).fold(0.0, |m: f64, b| m.max(b.abs()));
        let r_nom = own.position.r_nom();
        let nine = |x: &[f64]| -> Vec<f64> {
            let a = Matrix3::from_fn(|i, k| x[i * p + k] / most);
            match a.try_inverse().and_then(|phi| split(&phi, &r_nom).ok()) {
                Some(s) => (0..3).map(|i| s.sigma[i]).chain((0..3).map(|i| s.sigma[i] * x[i * p + 3])).chain(s.xi_deg).collect(),
                None => vec![f64::NAN; 9],
            }
        };
        let Ok(made) = propagate(nine, found.as_slice(), &covariance) else { return Ok(own) };
        let values =
            |v: &[f64]| SensorValues { scale: [v[0], v[1], v[2]], offset_nt: [v[3], v[4], v[5]], angles_deg: [v[6], v[7], v[8]] };
        own.values = values(&made.values);
        own.std = Some(values(&made.std));
        own.freedom = (n - p) as f64;
        Ok(own)
    }

    /// From a row of a table of run results.
    #[must_use]
    pub fn of_row(row: &OrientedRun, table: &str) -> Self {
        Self {
            run: row.run.clone(),
            sensor: row.sensor.clone(),
            set: table.to_owned(),
            position: row.position,
            // The runs of a table state no time.
            time: None,
            sensor_degc: None,
            coil_degc: None,
            field_nt: row.field_nt,
            values: SensorValues { scale: row.sigma, offset_nt: row.offset_nt, angles_deg: row.xi_deg },
            std: None,
            freedom: 0.0,
        }
    }

    /// ln σ, offset nT, ξ degrees.
    pub(super) fn of(&self, class: usize) -> [f64; 3] {
        additive(Class::ALL[class], &self.values)
    }

    /// Standard uncertainty of the same, or rounding.
    pub(super) fn std_of(&self, class: usize) -> [f64; 3] {
        let Some(std) = &self.std else { return [ROUNDING[class]; 3] };
        match class {
            0 => std::array::from_fn(|i| std.scale[i] / self.values.scale[i]),
            1 => std.offset_nt,
            _ => std.angles_deg,
        }
    }

    /// Change of a reading by one unit of a class, nT: of ln σ and ξ at the largest field.
    pub(super) fn nt_per_unit(&self, class: usize) -> f64 {
        let field = self.field_nt.unwrap_or(0.0);
        [field, 1.0, field.to_radians()][class]
    }
}
