//! Hidden effects: what they add to the readings, and what stands about them in the truth.
//!
//! Forms differ from those of a catalogue wherever nature leaves the choice; every effect with a free form also occurs in the plain form
//! (`exact`), which is the one whose amplitude can be compared.

mod catalogue;
mod outside;

use super::noise::Random;
use super::sensor::{CleanRun, Kind};
pub use catalogue::drawn;
pub use outside::drawn_outside;

/// Adds to the readings of a run, enT per sample, at an amplitude.
type Shape = Box<dyn Fn(&CleanRun, usize, f64) -> Vec<[f64; 3]> + Send + Sync>;

/// Adds to a slow channel at a time, s.
type Change = Box<dyn Fn(f64) -> f64 + Send + Sync>;

/// One parameter of the truth.
pub struct Parameter {
    pub name: String,
    pub unit: &'static str,
    /// At an amplitude of one.
    pub value: f64,
    /// Whether it is in proportion to the amplitude.
    pub scales: bool,
}

/// An effect with its form drawn and its amplitude open.
pub struct Effect {
    /// Name in the catalogue, or `unknown`.
    pub id: &'static str,
    pub form: String,
    pub axes: Vec<&'static str>,
    /// The form is the plain one, so that parameters of the same name can be compared.
    pub exact: bool,
    /// For `unknown`: names that the quantity it depends on may be given, the first one preferred.
    pub covariates: Vec<&'static str>,
    pub parameters: Vec<Parameter>,
    /// It is seen inside the plateaus.
    pub inside: bool,
    /// Its size is that of nature and not scaled.
    pub natural: bool,
    /// A change of a slow channel.
    pub channel: Option<(&'static str, Change)>,
    shape: Shape,
}

impl Effect {
    fn new(id: &'static str, form: impl Into<String>, shape: Shape) -> Self {
        Self {
            id,
            form: form.into(),
            axes: AXES.to_vec(),
            exact: false,
            covariates: Vec::new(),
            parameters: Vec::new(),
            inside: false,
            natural: false,
            channel: None,
            shape,
        }
    }

    /// An effect on sines, which is seen in the samples.
    pub fn of_sines(id: &'static str, form: &str, f: impl Fn(&CleanRun, f64) -> Vec<[f64; 3]> + Send + Sync + 'static) -> Self {
        Self::new(id, form, Box::new(move |clean, _, amplitude| f(clean, amplitude))).inside()
    }

    /// Of nature's own size, not scaled.
    pub fn of_nature(self) -> Self {
        self.natural()
    }

    fn on(mut self, axes: [f64; 3]) -> Self {
        self.axes = (0..3).filter(|i| axes[*i] != 0.0).map(|i| AXES[i]).collect();
        self
    }

    fn exact(mut self, exact: bool) -> Self {
        self.exact = exact;
        self
    }

    fn inside(mut self) -> Self {
        self.inside = true;
        self
    }

    fn natural(mut self) -> Self {
        self.natural = true;
        self
    }

    fn depends(mut self, covariates: &[&'static str]) -> Self {
        self.covariates = covariates.to_vec();
        self
    }

    /// A parameter in proportion to the amplitude.
    fn scaled(mut self, name: impl Into<String>, unit: &'static str, value: f64) -> Self {
        self.parameters.push(Parameter { name: name.into(), unit, value, scales: true });
        self
    }

    fn per_axis(mut self, stem: &str, unit: &'static str, values: [f64; 3]) -> Self {
        for i in 0..3 {
            if values[i] != 0.0 {
                self = self.scaled(format!("{stem}_{}", AXES[i]), unit, values[i]);
            }
        }
        self
    }

    /// A parameter of the form.
    fn fixed(mut self, name: &str, unit: &'static str, value: f64) -> Self {
        self.parameters.push(Parameter { name: name.to_owned(), unit, value, scales: false });
        self
    }

    /// What it adds to the readings of a run at an amplitude, enT per sample.
    pub fn contribution(&self, clean: &CleanRun, run: usize, amplitude: f64) -> Vec<[f64; 3]> {
        (self.shape)(clean, run, amplitude)
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// A contribution from a function of the sample, in proportion to the amplitude.
fn linear(f: impl Fn(&CleanRun, usize) -> [f64; 3] + Send + Sync + 'static) -> Shape {
    Box::new(move |clean, _, amplitude| (0..clean.count).map(|s| f(clean, s).map(|v| amplitude * v)).collect())
}

/// As [`linear`], with something worked out once per run.
fn prepared<P>(
    prepare: impl Fn(&CleanRun) -> P + Send + Sync + 'static,
    f: impl Fn(&P, &CleanRun, usize) -> [f64; 3] + Send + Sync + 'static,
) -> Shape {
    Box::new(move |clean, _, amplitude| {
        let ready = prepare(clean);
        (0..clean.count).map(|s| f(&ready, clean, s).map(|v| amplitude * v)).collect()
    })
}

/// One axis mostly, at times all of them with different weights.
fn weights(random: &mut Random) -> [f64; 3] {
    if random.chance(0.65) { one(random) } else { several(random) }
}

fn one(random: &mut Random) -> [f64; 3] {
    let (axis, sign) = (random.below(3), random.sign());
    std::array::from_fn(|i| if i == axis { sign } else { 0.0 })
}

fn several(random: &mut Random) -> [f64; 3] {
    std::array::from_fn(|_| random.sign() * random.between(0.4, 1.0))
}

fn scale(weights: [f64; 3], f: impl Fn(usize) -> f64) -> [f64; 3] {
    std::array::from_fn(|i| if weights[i] == 0.0 { 0.0 } else { weights[i] * f(i) })
}

/// Ids that a kind of run can show, those of nature's own size included.
pub fn visible(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::Lin => &[
            "cubic_nonlinearity",
            "quadratic_nonlinearity",
            "saturation",
            "transverse_field",
            "coil_temperature",
            "rack_temperature",
            "sensor_temperature_sensitivity",
            "sensor_temperature_offset",
            "rotation_drift",
            "offset_drift",
            "offset_step",
            "remanence",
            "settling",
            "time_shift",
            "earthfield_leakage",
            "heater_pwm",
            "interference_tone",
            "bad_thermistor",
        ],
        Kind::Sweep => &[
            "cubic_nonlinearity",
            "quadratic_nonlinearity",
            "transverse_field",
            "coil_temperature",
            "rack_temperature",
            "thermal_lag",
            "thermal_curvature",
            "rotation_drift",
            "offset_drift",
            "offset_step",
            "bad_thermistor",
        ],
        Kind::ZeroField => &[
            "sensor_temperature_offset",
            "offset_drift",
            "offset_step",
            "earthfield_leakage",
            "heater_pwm",
            "interference_tone",
            "bad_thermistor",
        ],
        Kind::Positions => &["facility_scale", "facility_offset", "facility_angle"],
        Kind::Frequency => &["eddy_current_attenuation", "response_order", "clock_drift", "lost_samples"],
    }
}

/// Effects of the catalogue that a kind of run cannot tell from its own parameters.
pub fn absorbed(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::Lin => &["facility_scale", "facility_offset", "facility_angle"],
        Kind::Sweep => &["sensor_temperature_sensitivity", "sensor_temperature_offset", "facility_scale", "facility_angle"],
        _ => &[],
    }
}

/// Quantities outside the catalogue that effects of a kind of run depend on.
pub fn outside(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::Lin => &["modulus", "product", "extreme", "supply", "staircase", "rack rate"],
        Kind::Sweep => &["product", "staircase", "temperature rate"],
        Kind::ZeroField => &["supply", "rack rate"],
        Kind::Positions | Kind::Frequency => &[],
    }
}

fn own(clean: &CleanRun, s: usize, i: usize) -> f64 {
    clean.pure_ent[s][i] / clean.range_nt()
}
