//! What a sweep gives.

use super::options::Window;
use crate::data::across::{AppliedLag, LinearScope, RunRotations, ThermistorLag};
use crate::data::note::Note;
use crate::data::reference::StatedReference;
use crate::data::result::RunHead;
use crate::measure::thermal::QuantityFit;
use crate::model::applied::ModelApplied;
use crate::model::facility::FacilityApplied;
use crate::record::conditions::Temperatures;
use nalgebra::DMatrix;
use serde::Serialize;

/// The parameters of one window.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WindowFit {
    /// Middle, s since the run's start.
    pub t_s: f64,
    /// Mean reading of the thermistor that was used, without and with the lag, °C.
    pub temperature_degc: [f64; 2],
    /// The temperature rises.
    pub heating: bool,
    /// σ_x, σ_y, σ_z nT/enT; ξ_xy, ξ_xz, ξ_yz degrees; B_or of x, y, z enT.
    pub values: [f64; 9],
    /// Their standard uncertainties.
    pub std: [f64; 9],
    /// Standard deviation of applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
}

/// One setting in the light of the joint fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SweepBlock {
    /// Middle, s since the run's start.
    pub t_s: f64,
    /// Temperature with its lag, °C.
    pub temperature_degc: f64,
    /// Applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
}

/// A sweep with what is needed to judge it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Run and conditions.
    pub run: RunHead,
    /// File of the run.
    pub file: String,
    /// Thermistor that the polynomials are of.
    pub channel: String,
    /// Lowest and highest temperature of the settings, with the lag, °C.
    pub valid_degc: [f64; 2],
    /// What the polynomials hold for, beside temperatures.
    pub scope: LinearScope,
    /// The nine polynomials, with the values of windows that share no settings beside them.
    pub quantities: Vec<QuantityFit>,
    /// Covariance of all their coefficients, one quantity after the other, type A.
    pub together: DMatrix<f64>,
    /// The same of both types; absent where the facility states no type B.
    pub together_combined: Option<DMatrix<f64>>,
    /// Rotation of the sensor against its nominal orientation, at the middle temperature.
    pub rotation: RunRotations,
    /// How the rotation follows the temperature.
    pub turning: Turning,
    /// Settings used, in the run, and left out because the temperature moved too fast.
    pub settings: SettingCounts,
    /// Sliding window.
    pub window: Window,
    /// Root mean square of applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
    /// The lag that the temperatures have.
    pub lag: AppliedLag,
    /// How the sensor follows every thermistor that moves.
    pub lags: Vec<ThermistorLag>,
    /// The facility that turned settings into the reference field; absent if the settings were taken as the field.
    pub facility: Option<FacilityApplied>,
    /// The known effects that were taken off the readings; absent if none were.
    pub model: Option<ModelApplied>,
    /// How the sensor stands in its reference cube, if that is stated.
    pub reference: Option<StatedReference>,
    /// What a person should know.
    pub notes: Vec<Note>,
    /// Sliding windows in time order.
    pub windows: Vec<WindowFit>,
    /// The settings that were used.
    pub blocks: Vec<SweepBlock>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
}

/// How the rotation of a sensor follows the temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turning {
    /// Order of its polynomials.
    pub order: usize,
    /// Angle between the orientations at the highest and at the lowest temperature, degrees.
    pub angle_deg: f64,
    /// Its standard uncertainty, type A; an angle is never negative, so that one of no turn is as large as this.
    pub std_deg: f64,
}

/// Numbers of settings of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SettingCounts {
    /// Used.
    pub used: usize,
    /// In the run.
    pub total: usize,
    /// Left out because the temperature moved too fast.
    pub too_fast: usize,
}
