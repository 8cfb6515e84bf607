//! The quantities of every kind of parameter file in one form: name, component, value, uncertainty, unit, frame, range.

use super::Source;
use crate::data::error::Finding;
use crate::data::result::valid_of_run;
use crate::data::units::COMPONENTS;
use crate::files::parameter::{Argument, FileKind, Polynomial, Shape, Validity};
use crate::fit::statistics::{NORMAL_95, student_95};
use std::collections::HashSet;
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
    /// Standard uncertainties that make an interval of 95 %; infinite where the scatter of the data does not tell.
    pub factor_95: f64,
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
    /// A unit by itself.
    pub const fn of(base: &'static str) -> Self {
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
            "K" => "\\kelvin",
            "K/h" => "\\kelvin\\hour\\tothe{-1}",
            "V" => "\\volt",
            "ohm" => "\\ohm",
            "s" => "\\second",
            "1/K" => "\\kelvin\\tothe{-1}",
            "nT/K" => "\\nano\\tesla\\kelvin\\tothe{-1}",
            "1/enT" => "\\nano\\tesla\\tothe{-1}",
            "1/enT^2" => "\\nano\\tesla\\tothe{-2}",
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

/// The correlation of two quantities: their covariance over the product of their standard uncertainties.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Correlation {
    /// Names and components of both.
    pub names: [String; 2],
    /// Between -1 and 1.
    pub value: f64,
}

/// Where the uncertainty of both types stands in place of that of type A, if the file states it: below `std_combined` or `covariance_combined`.
/// That of `/offset_std_ent` is `/std_combined/offset_ent`.
fn combined(source: &Source, place: &str) -> String {
    let below = |table: &str| {
        let rest = place.strip_prefix(&format!("/{table}"))?;
        (rest.is_empty() || rest.starts_with('/')).then(|| format!("/{table}_combined{rest}"))
    };
    let beside = || {
        let (name, unit) = place.strip_prefix('/')?.split_once("_std_")?;
        Some(format!("/std_combined/{name}_{unit}"))
    };
    let other = ["std", "covariance"].into_iter().find_map(below).or_else(beside);
    other.filter(|other| source.value.pointer(other).is_some()).unwrap_or_else(|| place.to_owned())
}

/// The correlations of different quantities of a file that are not zero: those of the coefficients of one polynomial, and those that the
/// file states of several quantities together.
pub(super) fn correlations(source: &Source) -> Vec<Correlation> {
    let mut list: Vec<Correlation> = Vec::new();
    let mut of_matrix = |names: &[String], place: &str| {
        let at = |i: usize, k: usize| source.number(&format!("{place}/{i}/{k}"));
        let known: HashSet<[String; 2]> = list.iter().map(|c| c.names.clone()).collect();
        for i in 0..names.len() {
            for k in (i + 1..names.len()).filter(|k| !known.contains(&[names[i].clone(), names[*k].clone()])) {
                let value = at(i, k).zip(at(i, i)).zip(at(k, k)).map(|((c, a), b)| c / (a * b).sqrt());
                if let Some(value) = value.filter(|v| v.is_finite() && *v != 0.0) {
                    list.push(Correlation { names: [names[i].clone(), names[k].clone()], value });
                }
            }
        }
    };
    let of_kind = FileKind::of_format(source.format()).and_then(|kind| kind.quantities);
    let polynomials = of_kind.map_or(&[][..], |q| q.polynomials).iter().filter(|p| matches!(p.of, Argument::Temperature));
    for p in polynomials {
        let count = source.value[p.key].as_array().map_or(0, Vec::len);
        let names: Vec<String> = (0..count).map(|k| format!("{}{k} {}", p.name, p.component)).collect();
        of_matrix(&names, &combined(source, &format!("/covariance/{}", p.key)));
    }
    let together = ["/together_combined", "/together"].into_iter().find(|place| source.value.pointer(place).is_some());
    for place in [Some(combined(source, "/covariance")), together.map(str::to_owned)].into_iter().flatten() {
        let names = source.value.pointer(&format!("{place}/parameters")).and_then(serde_json::Value::as_array);
        // `sigma_x.0` is a coefficient of a polynomial.
        let told = |name: &str| {
            let (key, order) = name.rsplit_once('.')?;
            let polynomial = of_kind?.polynomials.iter().find(|p| p.key == key)?;
            Some(format!("{}{order} {}", polynomial.name, polynomial.component))
        };
        let names = names.into_iter().flatten().filter_map(serde_json::Value::as_str);
        let names: Vec<String> = names.map(|n| told(n).unwrap_or_else(|| n.to_owned())).collect();
        of_matrix(&names, &format!("{place}/matrix"));
    }
    list
}

/// All quantities of a parameter file.
///
/// # Errors
/// A kind of file without such a list.
pub(super) fn quantities(source: &Source) -> Result<Vec<Quantity>, Finding> {
    let Some(of_kind) = FileKind::of_format(source.format()).and_then(|kind| kind.quantities) else {
        let remedy = "use --format json, which takes every kind of file";
        return Err(source.refuse(format!("holds format {}, whose quantities have no list", source.format()), remedy));
    };
    if source.value.get("period").and_then(serde_json::Value::as_array).is_some_and(|periods| !periods.is_empty()) {
        let rule = "holds values for several periods of time, for which a list of quantities has no place";
        return Err(source.refuse(rule, "use --format json, which takes all of it"));
    }
    let valid = of_kind.valid_degc.and_then(|validity| valid_degc(source, validity)).map(|range| (range, "degC"));
    let mut list: Vec<Quantity> = of_kind.polynomials.iter().flat_map(|p| coefficients(source, p, valid)).collect();
    for entry in of_kind.entries.iter().filter(|e| source.value.pointer(e.value).is_some()) {
        for (component, value_at, std_at) in elements(entry.shape) {
            list.push(Quantity {
                name: entry.name.to_owned(),
                component,
                value: source.number(&format!("{}{value_at}", entry.value)),
                std: source.number(&combined(source, &format!("{}{std_at}", entry.std))),
                factor_95: factor_95(source, None),
                unit: Unit::of(entry.unit),
                frame: entry.frame,
                valid,
            });
        }
    }
    Ok(list)
}

/// The coefficients of a polynomial, none where the file has no key for it; `valid_degc` is the range of the temperatures.
fn coefficients(source: &Source, polynomial: &Polynomial, valid_degc: Option<([f64; 2], &'static str)>) -> Vec<Quantity> {
    let key = polynomial.key;
    let (per, valid) = match polynomial.of {
        Argument::Temperature => ("degC", valid_degc),
        Argument::Signal => {
            let unit = if source.text("/signal_unit") == Some("ohm") { "ohm" } else { "V" };
            (unit, range(source, "/valid_signal/0", "/valid_signal/1").map(|range| (range, unit)))
        }
    };
    let std = |k: usize| match polynomial.of {
        Argument::Temperature => source.number(&combined(source, &format!("/covariance/{key}/{k}/{k}"))).map(f64::sqrt),
        Argument::Signal => source.number(&format!("/{key}_std/{k}")),
    };
    let one = |k: usize| Quantity {
        name: format!("{}{k}", polynomial.name),
        component: polynomial.component.to_owned(),
        value: source.number(&format!("/{key}/{k}")),
        std: std(k),
        factor_95: factor_95(source, Some(key)),
        unit: Unit { base: polynomial.unit, per, power: k },
        frame: polynomial.frame,
        valid,
    };
    (0..source.value[key].as_array().map_or(0, Vec::len)).map(one).collect()
}

/// How many standard uncertainties of a quantity make an interval of 95 %: what the file states of a polynomial, Student's factor for what the
/// scatter of few means told, and that of the normal distribution for what the samples told.
fn factor_95(source: &Source, polynomial: Option<&str>) -> f64 {
    let list = source.value.get("quantity").and_then(serde_json::Value::as_array);
    let found = list.into_iter().flatten().find(|q| polynomial.is_some() && q["name"].as_str() == polynomial);
    if let Some(factor) = found.and_then(|q| q["factor_95"].as_f64()) {
        return factor;
    }
    let of_samples = source.number("/quality/raw_std_ent/mean/0").is_some();
    let freedom = ["/quality/degrees_of_freedom", "/degrees_of_freedom"].into_iter().find_map(|at| source.value.pointer(at));
    let least = match freedom.filter(|_| !of_samples) {
        Some(serde_json::Value::Array(all)) => all.iter().filter_map(serde_json::Value::as_u64).min(),
        Some(one) => one.as_u64(),
        None => None,
    };
    least.map_or(NORMAL_95, |freedom| student_95(usize::try_from(freedom).unwrap_or(usize::MAX)))
}

/// Lowest and highest temperature for which the values of a file hold, °C.
fn valid_degc(source: &Source, validity: Validity) -> Option<[f64; 2]> {
    match validity {
        Validity::Between([low, high]) => range(source, low, high),
        Validity::OfRun(at) => {
            let [low, mean, high] = [0, 1, 2].map(|i| source.number(&format!("{at}/{i}")));
            Some(valid_of_run([low?, mean?, high?]))
        }
    }
}

fn range(source: &Source, low: &str, high: &str) -> Option<[f64; 2]> {
    Some([source.number(low)?, source.number(high)?])
}

/// Component, and where its value and its uncertainty stand below those of the entry.
fn elements(shape: Shape) -> Vec<(String, String, String)> {
    let each = |names: [&str; 3]| (0..3).map(|i| (names[i].to_owned(), format!("/{i}"), format!("/{i}"))).collect();
    match shape {
        Shape::Scalar(name) => vec![(name.to_owned(), String::new(), String::new())],
        Shape::Vector => each(COMPONENTS),
        Shape::Pairs => each(["xy", "xz", "yz"]),
        Shape::Diagonal => (0..3).map(|i| (COMPONENTS[i].to_owned(), format!("/{i}/{i}"), format!("/{i}"))).collect(),
        Shape::Matrix => (0..9)
            .map(|at| {
                let (r, c) = (at / 3, at % 3);
                (format!("{}{}", r + 1, c + 1), format!("/{r}/{c}"), format!("/{r}/{c}"))
            })
            .collect(),
    }
}
