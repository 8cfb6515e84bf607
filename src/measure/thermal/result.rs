//! What a thermal analysis finds.

use super::group::Kind;
use crate::data::across::{LinearScope, RunModelErrors, RunResidualFields, RunRotations};
use crate::data::note::Note;
use crate::data::quantity::QuantityFound;
use crate::data::reference::StatedReference;
use crate::data::run::Location;
use crate::fit::noise::dense::GroupNoise;
use crate::measure::joint::JointFit;
use crate::model::polynomial::TemperaturePolynomial;
use nalgebra::DMatrix;

/// Everything that the runs share, by name, with what one standard deviation of it changes: a value per run, or per coefficient.
pub type BySource = Vec<(String, Vec<f64>)>;

/// Temperatures at which a band is given.
const BAND: usize = 121;

/// The runs that an analysis rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct RunsUsed {
    /// Their parameter files.
    pub files: Vec<String>,
    /// Their ids, in the order of the files.
    pub ids: Vec<String>,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Where the sensor stood.
    pub location: Location,
    /// Channel of the sensor temperature; absent if no file tells it.
    pub channel: Option<String>,
    /// Mean sensor temperature of every run, °C.
    pub temperature_degc: Vec<f64>,
    /// Mean coil-system temperature of every run, °C; nan where there is none.
    pub coil_temperature_degc: Vec<f64>,
    /// How the sensor stands in its reference cube; absent if no file tells it, or the files do not agree.
    pub reference: Option<StatedReference>,
}

/// The polynomial of one quantity with the values it rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantityFit {
    /// How it was found, with the values it rests on.
    pub found: QuantityFound,
    /// Component or pair of components, `x` or `xy`.
    pub component: String,
    /// Runs that determine it, as indices into the runs of the group; empty for the windows of a sweep.
    pub runs: Vec<usize>,
    /// Temperatures of its values, °C.
    pub temperature_degc: Vec<f64>,
    /// Factor on its standard uncertainties because its order was chosen, as far as it was.
    pub choice: f64,
    /// The polynomial.
    pub polynomial: TemperaturePolynomial,
    /// Changes of its coefficients by one standard deviation of everything that the runs share, such as the facility, with what that is; absent
    /// where the runs do not tell.
    pub common: Option<BySource>,
    /// Temperature, value and standard uncertainty of the polynomial at even steps over its range.
    pub band: Vec<[f64; 3]>,
    /// The polynomial of the joint fit at the same temperatures, if there is one.
    pub joint_band: Vec<[f64; 3]>,
}

impl QuantityFit {
    /// What everything that the runs share adds to the covariance of the coefficients, type B; `None` where the runs do not tell.
    #[must_use]
    pub fn covariance_b(&self) -> Option<DMatrix<f64>> {
        let count = self.polynomial.coefficients.len();
        let product = |r: usize, c: usize, all: &[(String, Vec<f64>)]| all.iter().map(|(_, change)| change[r] * change[c]).sum();
        self.common.as_ref().map(|all| DMatrix::from_fn(count, count, |r, c| product(r, c, all)))
    }

    /// The quantities that are shown together, `sigma` of `sigma_x`.
    #[must_use]
    pub fn family(&self) -> &str {
        self.found.name.rsplit_once('_').map_or(self.found.name.as_str(), |(family, _)| family)
    }

    /// Temperature, °C, value and standard uncertainty of the runs or windows; nan where the uncertainties are not known.
    #[must_use]
    pub fn points(&self) -> Vec<[f64; 3]> {
        let values = self.temperature_degc.iter().zip(&self.found.value).enumerate();
        values.map(|(i, (t, value))| [*t, *value, self.found.std.get(i).copied().unwrap_or(f64::NAN)]).collect()
    }
}

/// The thermal analysis of one kind of runs of one group.
#[derive(Clone, Debug, PartialEq)]
pub struct Thermal {
    /// The runs.
    pub runs: RunsUsed,
    /// Lowest and highest temperature for which all polynomials hold, °C.
    pub valid_degc: [f64; 2],
    /// The polynomials with their runs.
    pub quantities: Vec<QuantityFit>,
    /// What only this kind of runs has.
    pub of_kind: OfKind,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// What only one kind of runs has.
#[derive(Clone, Debug, PartialEq)]
pub enum OfKind {
    /// Linear calibrations.
    Lin(Box<LinAcross>),
    /// Offset measurements: the residual field of the coil system in every run.
    Offset(RunResidualFields),
    /// Frequency measurements.
    Freq(SamplingAcross),
}

/// Linear calibrations across temperatures, beside their polynomials.
#[derive(Clone, Debug, PartialEq)]
pub struct LinAcross {
    /// Rotation of the sensor against its nominal orientation in every run.
    pub rotation: RunRotations,
    /// What the polynomials leave of the applied fields in every run; absent unless all runs are at hand with their plateaus.
    pub model_error: Option<RunModelErrors>,
    /// The fit of the temperature-dependent model to the plateaus of all runs at once.
    pub joint: Option<JointFit>,
    /// What the calibrations hold for, beside temperatures.
    pub scope: LinearScope,
    /// What the runs show of their noise together; absent unless all runs are at hand, with samples.
    pub noise: Option<GroupNoise>,
}

/// Which -3 dB frequency the polynomials are of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Corner {
    /// That of the response models.
    Model,
    /// That between neighbouring amplitudes (igep).
    Interpolated,
}

/// Frequency measurements across temperatures, beside their polynomials.
#[derive(Clone, Debug, PartialEq)]
pub struct SamplingAcross {
    /// Which -3 dB frequency.
    pub corner: Corner,
    /// Sampling frequency of every run, Hz; nan where it is not known.
    pub f_s_hz: Vec<f64>,
    /// Its standard uncertainty, Hz.
    pub f_s_std_hz: Vec<f64>,
}

impl SamplingAcross {
    /// Means over the runs of the sampling frequency and of its standard uncertainty, Hz.
    #[must_use]
    pub fn means_hz(&self) -> [Option<f64>; 2] {
        [&self.f_s_hz, &self.f_s_std_hz].map(|values| {
            let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        })
    }
}

impl Thermal {
    /// Which runs.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self.of_kind {
            OfKind::Lin(_) => Kind::Lin,
            OfKind::Offset(_) => Kind::Offset,
            OfKind::Freq(_) => Kind::Freq,
        }
    }

    /// The quantity of a name.
    #[must_use]
    pub fn quantity(&self, name: &str) -> Option<&QuantityFit> {
        self.quantities.iter().find(|q| q.found.name == name)
    }
}

/// Temperature, value and standard uncertainty at even steps over a range.
pub(in crate::measure) fn band(range_degc: [f64; 2], evaluate: impl Fn(f64) -> (f64, f64)) -> Vec<[f64; 3]> {
    (0..BAND)
        .map(|i| {
            let t = range_degc[0] + (range_degc[1] - range_degc[0]) * i as f64 / (BAND - 1) as f64;
            let (value, std) = evaluate(t);
            [t, value, std]
        })
        .collect()
}
