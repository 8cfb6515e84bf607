//! The quantities of every kind of parameter file in one form: name, component, value, uncertainty, unit, frame, range.

use super::Source;
use crate::data::error::Finding;
use crate::data::units::COMPONENTS;
use std::fmt;

/// One number of a parameter file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Quantity {
    pub name: String,
    /// `x`, `xy`, or row and column of a matrix; empty for a scalar.
    pub component: String,
    /// Absent where it was not determined.
    pub value: Option<f64>,
    /// Standard uncertainty; absent where it is not known.
    pub std: Option<f64>,
    pub unit: Unit,
    pub frame: &'static str,
    /// Lowest and highest value of what it depends on, and the unit of that.
    pub valid: Option<([f64; 2], &'static str)>,
}

/// A unit over a power of another: `enT/degC^2`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    base: &'static str,
    per: &'static str,
    power: usize,
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.power {
            0 => write!(f, "{}", self.base),
            1 => write!(f, "{}/{}", self.base, self.per),
            power => write!(f, "{}/{}^{power}", self.base, self.per),
        }
    }
}

impl Unit {
    const fn of(base: &'static str) -> Self {
        Self { base, per: "", power: 0 }
    }

    /// The unit in the notation of the D-SI; enT counts as nT and nT/EU as nT, as the D-SI has neither.
    pub fn d_si(&self) -> String {
        // Differences of Celsius temperatures are kelvins.
        let si = |unit: &str| match unit {
            "enT" | "nT" | "nT/EU" => "\\nano\\tesla",
            "deg" => "\\degree",
            "Hz" => "\\hertz",
            "degC" => "\\degreecelsius",
            "V" => "\\volt",
            "ohm" => "\\ohm",
            _ => "\\one",
        };
        if self.power == 0 {
            return si(self.base).to_owned();
        }
        let base = match self.base {
            "nT/enT" | "1" => "",
            "degC" => "\\kelvin",
            base => si(base),
        };
        let per = if self.per == "degC" { "\\kelvin" } else { si(self.per) };
        format!("{base}{per}\\tothe{{-{}}}", self.power)
    }
}

/// How the numbers of an entry lie in the file.
#[derive(Clone, Copy)]
enum Shape {
    /// One number; the component has this name.
    Scalar(&'static str),
    /// x, y, z.
    Vector,
    /// xy, xz, yz.
    Pairs,
    /// Three rows of three.
    Matrix,
    /// The diagonal of three rows of three; its uncertainties are x, y, z.
    Diagonal,
}

/// Name, shape, where value and uncertainty stand, unit, frame.
type Entry = (&'static str, Shape, &'static str, &'static str, &'static str, &'static str);

use Shape::{Diagonal, Matrix, Pairs, Scalar, Vector};
const SENSOR: &str = "sensor axes";
const COIL: &str = "coil axes";
const BETWEEN: &str = "between sensor axes";
const TURNED: &str = "real against nominal sensor axis";

const CPF: [Entry; 11] = [
    ("sigma", Diagonal, "/matrix/sigma", "/std/sigma", "nT/enT", SENSOR),
    ("xi", Scalar("xy"), "/angle_deg/xi_xy", "/std/xi_deg/0", "deg", BETWEEN),
    ("xi", Scalar("xz"), "/angle_deg/xi_xz", "/std/xi_deg/1", "deg", BETWEEN),
    ("xi", Scalar("yz"), "/angle_deg/xi_yz", "/std/xi_deg/2", "deg", BETWEEN),
    ("lambda", Scalar("x"), "/angle_deg/lambda_x", "/std/lambda_mu_nu_deg/0", "deg", TURNED),
    ("mu", Scalar("y"), "/angle_deg/mu_y", "/std/lambda_mu_nu_deg/1", "deg", TURNED),
    ("nu", Scalar("z"), "/angle_deg/nu_z", "/std/lambda_mu_nu_deg/2", "deg", TURNED),
    ("b_or", Vector, "/offset/b_or_ent", "/std/b_or_ent", "enT", SENSOR),
    ("phi", Matrix, "/matrix/phi", "/std/phi", "nT/enT", "sensor axes to coil axes"),
    ("phi_tilde", Matrix, "/matrix/phi_tilde", "/std/phi_tilde", "nT/enT", "sensor axes to orthogonal sensor system"),
    ("temperature", Scalar(""), "/run/temperature_degc", "", "degC", "sensor"),
];
const OPF: [Entry; 4] = [
    ("b_off", Vector, "/offset_ent", "/offset_std_ent", "enT", SENSOR),
    ("b_res", Vector, "/residual_ent", "/residual_std_ent", "enT", "sensor axes in the normal position"),
    ("b_res_coil", Vector, "/residual_coil_nt", "/residual_coil_std_nt", "nT", COIL),
    ("temperature", Scalar(""), "/run/temperature_degc", "", "degC", "sensor"),
];
const FPF: [Entry; 5] = [
    ("f_3db_model", Vector, "/f_3db_model_hz", "/f_3db_model_std_hz", "Hz", SENSOR),
    ("f_3db_igep", Vector, "/f_3db_igep_hz", "", "Hz", SENSOR),
    ("f_s", Vector, "/f_s_hz", "/f_s_std_hz", "Hz", SENSOR),
    ("mean_f_s", Scalar(""), "/mean_f_s_hz", "/mean_f_s_std_hz", "Hz", "facility clock"),
    ("temperature", Scalar(""), "/run/temperature_degc", "", "degC", "sensor"),
];
const TCF: [Entry; 3] = [
    ("k", Vector, "/k", "/k_std", "1", SENSOR),
    ("k_inverse", Matrix, "/k_inverse", "/k_inverse_std", "1", "orthogonal sensor system"),
    ("b_res", Vector, "/residual_field/b_res_ent", "/residual_field/b_res_std_ent", "enT", SENSOR),
];
const TAF: [Entry; 1] = [("mean_f_s", Scalar(""), "/mean_sample_rate_hz", "/mean_std_sample_rate_hz", "Hz", "facility clock")];
const THERMISTOR: [Entry; 1] = [(
    "T_O",
    Scalar(""),
    "/reference/offset_degc",
    "/reference/offset_std_degc",
    "degC",
    "thermistor minus reference thermometer",
)];
const COIL_SCALAR: [Entry; 3] = [
    ("scale", Vector, "/facility/scale_nt_per_eu", "/std/scale_nt_per_eu", "nT/EU", COIL),
    ("offset", Vector, "/facility/offset_nt", "/std/offset_nt", "nT", COIL),
    ("angle", Pairs, "/facility/angles_deg", "/std/angles_deg", "deg", "between coil axes"),
];

/// Families of temperature polynomials with their components, unit and frame.
const POLYNOMIALS: [(&str, [&str; 3], &str, &str); 5] = [
    ("sigma", COMPONENTS, "nT/enT", SENSOR),
    ("xi", ["xy", "xz", "yz"], "deg", BETWEEN),
    ("b_or", COMPONENTS, "enT", SENSOR),
    ("b_off", COMPONENTS, "enT", SENSOR),
    ("f_3db", COMPONENTS, "Hz", SENSOR),
];

/// All quantities of a parameter file.
///
/// # Errors
/// A kind of file without such a list.
pub(super) fn quantities(source: &Source) -> Result<Vec<Quantity>, Finding> {
    let run = || range(source, "/conditions/sensor_degc/0", "/conditions/sensor_degc/2");
    let (entries, valid): (&[Entry], Option<[f64; 2]>) = match source.format() {
        "CPF" => (&CPF, range(source, "/valid/temperature_degc/0", "/valid/temperature_degc/1")),
        "OPF" => (&OPF, run()),
        "FPF" => (&FPF, run()),
        "TPF" | "TOF" => (&[], range(source, "/valid_degc/0", "/valid_degc/1")),
        "TAF" => (&TAF, range(source, "/valid_degc/0", "/valid_degc/1")),
        "TCF" => (&TCF, range(source, "/valid_degc/0", "/valid_degc/1")),
        "THERMISTOR" => (&THERMISTOR, range(source, "/valid_degc/0", "/valid_degc/1")),
        "COIL_SCALAR" => (&COIL_SCALAR, None),
        other => {
            let remedy = "use --format json, which takes every kind of file";
            return Err(source.refuse(format!("holds format {other}, whose quantities have no list"), remedy));
        }
    };
    let valid = valid.map(|range| (range, "degC"));
    let mut list = thermistor(source);
    for (family, components, base, frame) in POLYNOMIALS {
        for component in components {
            let name = format!("{family}_{component}");
            let count = source.value[&name].as_array().map_or(0, Vec::len);
            for k in 0..count {
                let variance = source.number(&format!("/covariance/{name}/{k}/{k}"));
                list.push(Quantity {
                    name: format!("{family}_T{k}"),
                    component: component.to_owned(),
                    value: source.number(&format!("/{name}/{k}")),
                    std: variance.map(f64::sqrt),
                    unit: Unit { base, per: "degC", power: k },
                    frame,
                    valid,
                });
            }
        }
    }
    for (name, shape, value, std, unit, frame) in entries {
        for (component, value_at, std_at) in elements(*shape) {
            if source.value.pointer(value).is_none() {
                continue;
            }
            list.push(Quantity {
                name: (*name).to_owned(),
                component,
                value: source.number(&format!("{value}{value_at}")),
                std: source.number(&format!("{std}{std_at}")),
                unit: Unit::of(unit),
                frame,
                valid,
            });
        }
    }
    Ok(list)
}

/// The coefficients of a thermistor, which depend on its signal and not on a temperature.
fn thermistor(source: &Source) -> Vec<Quantity> {
    if source.format() != "THERMISTOR" {
        return Vec::new();
    }
    let signal = if source.text("/signal_unit") == Some("ohm") { "ohm" } else { "V" };
    let count = source.value["coefficients"].as_array().map_or(0, Vec::len);
    let valid = range(source, "/valid_signal/0", "/valid_signal/1").map(|range| (range, signal));
    let one = |k: usize| Quantity {
        name: format!("c_{k}"),
        component: String::new(),
        value: source.number(&format!("/coefficients/{k}")),
        std: source.number(&format!("/coefficients_std/{k}")),
        unit: Unit { base: "degC", per: signal, power: k },
        frame: "thermistor",
        valid,
    };
    (0..count).map(one).collect()
}

fn range(source: &Source, low: &str, high: &str) -> Option<[f64; 2]> {
    Some([source.number(low)?, source.number(high)?])
}

/// Component, and where its value and its uncertainty stand below those of the entry.
fn elements(shape: Shape) -> Vec<(String, String, String)> {
    let each = |names: [&str; 3]| (0..3).map(|i| (names[i].to_owned(), format!("/{i}"), format!("/{i}"))).collect();
    match shape {
        Scalar(name) => vec![(name.to_owned(), String::new(), String::new())],
        Vector => each(COMPONENTS),
        Pairs => each(["xy", "xz", "yz"]),
        Diagonal => (0..3).map(|i| (COMPONENTS[i].to_owned(), format!("/{i}/{i}"), format!("/{i}"))).collect(),
        Matrix => (0..9)
            .map(|at| {
                let (r, c) = (at / 3, at % 3);
                (format!("{}{}", r + 1, c + 1), format!("/{r}/{c}"), format!("/{r}/{c}"))
            })
            .collect(),
    }
}
