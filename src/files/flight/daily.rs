//! Daily offset models, RPCMAG-DAILY (RO-IGEP-TR0028 section 4.2.3.3).

use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::data::time::{date_of, day_of};
use crate::files::parameter::{is_sound_table, matrix_of};
use crate::files::source::{read_whole, small_text};
use crate::files::text::{Keys, decode, listed, quoted};
use crate::model::polynomial::TemperaturePolynomial;
use jiff::civil::Date;
use nalgebra::DMatrix;
use std::path::{Path, PathBuf};

/// Value of `format`.
pub const FORMAT: &str = "RPCMAG-DAILY";
/// How a model acts.
pub const SIGN: &str = "subtracted from calibrated data";
const KEYS: [&str; 15] = [
    "format",
    "version",
    "sensor",
    "date",
    "model",
    "unit",
    "sign",
    "valid_degc",
    "p_x",
    "p_y",
    "p_z",
    "covariance",
    "calm",
    "explained",
    "provenance",
];
const NAMES: [&str; 3] = ["p_x", "p_y", "p_z"];
/// A model has so many coefficients at most.
const MOST: usize = 6;

/// The offset of a sensor over its temperature on one day, nT, subtracted behind the ground calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct DailyModel {
    /// Polynomials of x, y, z, nT over °C; the covariance is empty where none is stated.
    pub polynomials: [TemperaturePolynomial; 3],
    /// Lowest and highest temperature for which it holds, °C.
    pub valid_degc: [f64; 2],
    /// The file.
    pub input: Input,
}

/// The text of a file up to its covariances: the root keys, of which the caller may add further ones.
#[must_use]
pub fn head(what: &str, sensor: &str, day: i32, polynomials: &[TemperaturePolynomial; 3], valid_degc: [f64; 2]) -> String {
    let date = date_of(day);
    let (year, month, d) = (date.year(), date.month(), date.day());
    let mut text =
        format!("# calfit daily offset model, {what}\nformat = \"{FORMAT}\"\nversion = 1\nsensor = {}\n", quoted(sensor));
    text.push_str(&format!("date = \"{year:04}-{month:02}-{d:02}\"\nmodel = \"polynomial\"\nunit = \"nT\"\nsign = \"{SIGN}\"\n"));
    for (key, polynomial) in NAMES.into_iter().zip(polynomials) {
        text.push_str(&format!("{key} = {}\n", listed(&polynomial.coefficients)));
    }
    text.push_str(&format!("valid_degc = {}\n", listed(&valid_degc)));
    text
}

/// The covariances of the coefficients as a table of the file.
#[must_use]
pub fn covariances(polynomials: &[TemperaturePolynomial; 3]) -> String {
    let mut text = "\n[covariance]\n".to_owned();
    for (key, polynomial) in NAMES.into_iter().zip(polynomials) {
        let rows: Vec<String> = polynomial.covariance.row_iter().map(|row| listed(row.iter())).collect();
        text.push_str(&format!("{key} = [{}]\n", rows.join(", ")));
    }
    text
}

/// The file of a day, by the pattern of the configuration.
#[must_use]
pub fn path_of(folder: &Path, pattern: &str, day: i32) -> PathBuf {
    let date = date_of(day);
    let (year, month, d) = (date.year(), date.month(), date.day());
    let name = pattern
        .replace("{yymmdd}", &format!("{:02}{month:02}{d:02}", year % 100))
        .replace("{date}", &format!("{year:04}-{month:02}-{d:02}"));
    folder.join(name)
}

/// Whether a file is a daily offset model, by its key `format`.
#[must_use]
pub fn is_daily(path: &Path) -> bool {
    let Some(text) = small_text(path) else { return false };
    let Ok(keys) = Keys::parse(&path.display().to_string(), 1, text) else { return false };
    keys.root().text("format").is_ok_and(|format| format.as_deref() == Some(FORMAT))
}

/// Reads the model of a sensor and day.
///
/// # Errors
/// What is wrong with the file; another sensor or day.
pub fn read(path: &Path, sensor: &str, day: i32) -> Result<DailyModel, Finding> {
    read_of(path, Some((sensor, day)))
}

/// Reads a model of whatever sensor and day.
///
/// # Errors
/// What is wrong with the file.
pub fn check(path: &Path) -> Result<(), Finding> {
    read_of(path, None).map(drop)
}

/// Reads a model, of a sensor and day where these are asked for.
fn read_of(path: &Path, asked: Option<(&str, i32)>) -> Result<DailyModel, Finding> {
    let shown = path.display().to_string();
    let (bytes, digested) = read_whole(path)?;
    let keys = Keys::parse(&shown, 1, decode(&bytes).into_owned())?;
    let root = keys.root();
    let needed = |key: &str| -> Result<String, Finding> { root.text(key)?.ok_or_else(|| root.missing(key)) };
    if needed("format")? != FORMAT {
        return Err(root.refuse("format", &format!("is not {FORMAT}"), "name a daily offset model"));
    }
    if root.whole("version")? != Some(1) {
        return Err(root.refuse("version", "must be 1", "take the program that wrote the file"));
    }
    let of = needed("sensor")?;
    if let Some((sensor, _)) = asked.filter(|(sensor, _)| *sensor != of) {
        return Err(root.refuse("sensor", &format!("is not {sensor}"), "name the models of this sensor"));
    }
    let date: Date = needed("date")?.parse().map_err(|_| root.refuse("date", "is no date", "write YYYY-MM-DD"))?;
    if let Some((_, day)) = asked.filter(|(_, day)| *day != day_of(date)) {
        return Err(root.refuse("date", &format!("is not {}", date_of(day)), "name the model of this day"));
    }
    for (key, only) in [("sign", SIGN), ("unit", "nT")] {
        if root.text(key)?.is_some_and(|text| text != only) {
            return Err(root.refuse(key, &format!("is not `{only}`"), "convert the coefficients"));
        }
    }
    if let Some(name) = root.names().into_iter().find(|name| !KEYS.contains(name)) {
        return Err(root.refuse(name, "is not known", "take the key away, or correct it"));
    }
    let valid = root.numbers("valid_degc")?.ok_or_else(|| root.missing("valid_degc"))?;
    let [low, high] = valid[..] else { return Err(root.refuse("valid_degc", "must be two numbers", "write the range")) };
    if low > high {
        return Err(root.refuse("valid_degc", "must rise", "write the lower temperature first"));
    }
    is_sound_table(&shown, keys.table(), &[])?;
    let covariances = root.group("covariance")?;
    let polynomial = |name: &str| -> Result<TemperaturePolynomial, Finding> {
        let coefficients = root.numbers(name)?.ok_or_else(|| root.missing(name))?;
        if coefficients.is_empty() || coefficients.len() > MOST {
            return Err(root.refuse(name, "must have one to six coefficients", "write them lowest order first"));
        }
        let stated = covariances.as_ref().map(|group| group.rows(name)).transpose()?.flatten();
        let covariance = match stated {
            None => DMatrix::zeros(0, 0),
            Some(rows) => matrix_of(&rows, coefficients.len())
                .ok_or_else(|| root.refuse("covariance", "has another size than the coefficients", "make the file again"))?,
        };
        Ok(TemperaturePolynomial { coefficients, covariance, valid_degc: [low, high] })
    };
    let [x, y, z] = NAMES.map(polynomial);
    let polynomials = [x?, y?, z?];
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(DailyModel { polynomials, valid_degc: [low, high], input: digested.input(name) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_contradicts_itself_is_refused_with_its_key() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("daily.txt");
        let day = day_of("2014-11-12".parse().unwrap());
        let polynomial = TemperaturePolynomial {
            coefficients: vec![1.0, 0.5],
            covariance: DMatrix::identity(2, 2),
            valid_degc: [-50.0, 50.0],
        };
        let polynomials = [polynomial.clone(), polynomial.clone(), polynomial];
        let of = |valid_degc| head("made", "OB", day, &polynomials, valid_degc) + &covariances(&polynomials);
        let refused = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read(&path, "OB", day).err().map(|f| f.to_string())
        };
        let sound = of([-50.0, 50.0]);
        assert_eq!(refused(&sound), None);
        assert!(refused(&of([-500.0, 50.0])).is_some_and(|t| t.contains("below absolute zero")));
        let rows = sound.lines().rfind(|line| line.starts_with("p_z = [[")).unwrap();
        for (wrong, words) in
            [("[[1, 2], [2, 1]]", "covariance.p_z is no covariance"), ("[[1, 0], [0, -1]]", "negative variance")]
        {
            let told = refused(&sound.replace(rows, &format!("p_z = {wrong}")));
            assert!(told.as_ref().is_some_and(|t| t.contains(words)), "{wrong}: {told:?}");
        }
    }
}
