//! Values that no measurement gives, and lists that do not go together: what every kind of parameter file has in common beyond its types.

use std::collections::BTreeSet;
use toml_edit::{Item, Table, TableLike, Value};

/// No value of a file is larger.
const LARGEST: f64 = 1e30;
/// Rounding of parts and correlations of one.
const ROUNDING: f64 = 1e-9;
const ABSOLUTE_ZERO_DEGC: f64 = -273.15;

/// What cannot be in a file.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place} {rule}")]
pub(super) struct Contradiction {
    /// The key, with the tables above it.
    place: String,
    /// What of its value cannot be.
    rule: String,
}

impl Contradiction {
    pub(super) fn of(keys: &[&str], rule: impl Into<String>) -> Self {
        Self { place: keys.join("."), rule: rule.into() }
    }

    /// Of a key in the table to which the keys lead.
    fn below(keys: &[&str], key: &str, rule: impl Into<String>) -> Self {
        Self::of(&[keys, &[key]].concat(), rule)
    }
}

/// Refuses what cannot be in a file whose lists may hold nan under some keys only.
pub(super) fn check(document: &Table, may_lack: &[&str]) -> Result<(), Contradiction> {
    for (key, item) in document.iter() {
        walk(&mut vec![key], item, may_lack.contains(&key))?;
    }
    lists_of(&[], document)?;
    polynomials(document)
}

fn walk<'a>(keys: &mut Vec<&'a str>, item: &'a Item, may_lack: bool) -> Result<(), Contradiction> {
    match item {
        Item::None => Ok(()),
        Item::Value(own) => value(keys, own, may_lack),
        Item::Table(table) => below(keys, table, may_lack),
        Item::ArrayOfTables(list) => list.iter().try_for_each(|table| below(keys, table, may_lack)),
    }
}

fn below<'a>(keys: &mut Vec<&'a str>, table: &'a dyn TableLike, may_lack: bool) -> Result<(), Contradiction> {
    for (key, item) in table.iter() {
        keys.push(key);
        walk(keys, item, may_lack)?;
        keys.pop();
    }
    counts(keys, table)?;
    extremes(keys, table)?;
    names(keys, table)?;
    lists_of(keys, table)
}

fn value<'a>(keys: &mut Vec<&'a str>, own: &'a Value, may_lack: bool) -> Result<(), Contradiction> {
    if let Value::InlineTable(table) = own {
        return below(keys, table, may_lack);
    }
    let key = keys.last().copied().unwrap_or_default();
    // Uncertainties stand under the names of their quantities, and only their sign is known of them.
    let is_uncertainty = keys.iter().any(|key| key.split('_').any(|word| word == "std"));
    let mut numbers = Vec::new();
    flatten(own, &mut numbers);
    for v in numbers {
        let wrong = if v.is_nan() {
            (!may_lack).then_some("is nan where a file of this kind has a value")
        } else if v.abs() > LARGEST {
            Some("is larger than anything that is measured")
        } else if is_uncertainty {
            None
        } else {
            outside(key, v)
        };
        if let Some(wrong) = wrong {
            return Err(Contradiction::of(keys, wrong));
        }
    }
    Ok(())
}

/// Why a number cannot be the value of a key.
fn outside(key: &str, v: f64) -> Option<&'static str> {
    let has = |word: &str| key.split('_').any(|own| own == word);
    let never_negative = [
        "chi_square",
        "between_chi2",
        "condition",
        "widened",
        "inflation",
        "factor_95",
        "residual_rms_degc",
        "residual_max_degc",
        "leave_one_out_degc",
        "weight",
        "frequency_hz",
        "corner_hz",
        "f_3db_hz",
        "f_3db_model_hz",
        "f_3db_igep_hz",
        "f_s_hz",
        "mean_f_s_hz",
        "sample_rate_hz",
        "mean_sample_rate_hz",
        "ent_per_root_hz",
        "nt_per_root_hz",
        "low_ent_per_root_hz",
        "high_ent_per_root_hz",
        "tau_s",
        "largest_nt",
        "largest_field_nt",
        "largest_correction_ent",
        "modulus_nt",
        "slow_over_white",
        "plateaus_over_samples",
    ];
    match key {
        _ if never_negative.contains(&key) => (v < 0.0).then_some("is negative"),
        "scale_nt_per_eu" => (v <= 0.0).then_some("is not positive"),
        "probability" | "correlated_share" | "direction_share" => {
            (!(-ROUNDING..=1.0 + ROUNDING).contains(&v)).then_some("is no part of one")
        }
        "correlation" => (v.abs() > 1.0 + ROUNDING).then_some("is no correlation"),
        "rotation_determinant" => ((v.abs() - 1.0).abs() > 1e-6).then_some("is the determinant of no rotation"),
        _ if key.ends_with("_degc") && !has("per") => (v < ABSOLUTE_ZERO_DEGC).then_some("is below absolute zero"),
        _ => None,
    }
}

/// More that are used than there are.
fn counts(keys: &[&str], table: &dyn TableLike) -> Result<(), Contradiction> {
    for (key, item) in table.iter() {
        let Some(what) = key.strip_suffix("_used") else { continue };
        let total = table.get(&format!("{what}_total")).and_then(Item::as_integer);
        if let (Some(used), Some(total)) = (item.as_integer(), total)
            && used > total
        {
            return Err(Contradiction::below(keys, key, format!("is {used} of {total}")));
        }
    }
    Ok(())
}

/// Quantities of a covariance that have two rows.
fn names(keys: &[&str], table: &dyn TableLike) -> Result<(), Contradiction> {
    if table.get("matrix").is_none() {
        return Ok(());
    }
    let list = table.get("parameters").and_then(Item::as_array).into_iter().flatten();
    let mut seen = BTreeSet::new();
    match list.filter_map(Value::as_str).find(|name| !seen.insert(*name)) {
        Some(name) => Err(Contradiction::below(keys, "parameters", format!("names `{name}` twice"))),
        None => Ok(()),
    }
}

/// Whether a value is above another by more than a mean is off by rounding.
fn above(a: f64, b: f64) -> bool {
    a - b > ROUNDING * a.abs().max(b.abs())
}

/// Smallest, mean and largest values that are in another order.
fn extremes(keys: &[&str], table: &dyn TableLike) -> Result<(), Contradiction> {
    let list = |key: &str| table.get(key).map(numbers_of);
    if let (Some(min), Some(max)) = (list("min"), list("max")) {
        let mean = list("mean").unwrap_or_else(|| min.clone());
        let is_ordered = |i: usize| match (min.get(i), mean.get(i), max.get(i)) {
            (Some(low), Some(middle), Some(high)) => !(above(*low, *middle) || above(*middle, *high)),
            _ => true,
        };
        if !(0..min.len()).all(is_ordered) {
            return Err(Contradiction::below(keys, "min", "is above its mean or max"));
        }
    }
    for key in ["sensor_degc", "coil_degc"] {
        if let Some([low, mean, high]) = list(key).as_deref()
            && (above(*low, *mean) || above(*mean, *high))
        {
            return Err(Contradiction::below(keys, key, "are no smallest, mean and largest value"));
        }
    }
    Ok(())
}

/// Lists that go together, by the keys of the table in which they stand.
const TOGETHER: [&[&str]; 9] = [
    &["used", "runs", "temperature_degc", "coil_temperature_degc"],
    &["f_s_hz", "f_s_std_hz", "temperature_degc"],
    &["value", "std", "residual"],
    &["parameters", "units", "matrix"],
    &["coefficients", "coefficients_std"],
    &["slow_noise_of", "exponent", "slow_over_white", "plateaus_over_samples", "growth", "probability"],
    &["lambda_x_deg", "mu_y_deg", "nu_z_deg", "lambda_x_std_deg", "mu_y_std_deg", "nu_z_std_deg"],
    &[
        "x_ent",
        "y_ent",
        "z_ent",
        "x_std_ent",
        "y_std_ent",
        "z_std_ent",
        "tau_s",
        "low_factor",
        "high_factor",
        "degrees_of_freedom",
    ],
    &["frequency_hz", "x_ent_per_root_hz", "y_ent_per_root_hz", "z_ent_per_root_hz", "low_factor", "high_factor"],
];

fn lists_of(keys: &[&str], table: &dyn TableLike) -> Result<(), Contradiction> {
    for together in TOGETHER {
        let length = |key| Some((key, table.get(key)?.as_array()?.len()));
        let lengths: Vec<(&str, usize)> = together.iter().copied().filter_map(length).collect();
        // What is not known everywhere is an empty list.
        let may_be_empty = |key: &str| ["units", "std", "residual", "coefficients_std"].contains(&key);
        let counted = || lengths.iter().filter(|(key, length)| *length > 0 || !may_be_empty(key));
        let Some((first, count)) = counted().next() else { continue };
        if let Some((other, length)) = counted().find(|(_, length)| length != count) {
            return Err(Contradiction::below(keys, first, format!("has {count} values, {other} {length}")));
        }
    }
    Ok(())
}

/// Polynomials whose covariances are of another size.
fn polynomials(document: &Table) -> Result<(), Contradiction> {
    for name in ["covariance", "covariance_b", "covariance_combined"] {
        let Some(table) = document.get(name).and_then(Item::as_table_like) else { continue };
        for (key, matrix) in table.iter() {
            let (Some(rows), Some(own)) = (matrix.as_array(), document.get(key).and_then(Item::as_array)) else { continue };
            if !rows.is_empty() && rows.len() != own.len() {
                let rule = format!("has {} coefficients, {name}.{key} {} rows", own.len(), rows.len());
                return Err(Contradiction::of(&[key], rule));
            }
        }
    }
    Ok(())
}

fn numbers_of(item: &Item) -> Vec<f64> {
    let mut list = Vec::new();
    if let Some(value) = item.as_value() {
        flatten(value, &mut list);
    }
    list
}

pub(super) fn flatten(value: &Value, list: &mut Vec<f64>) {
    match value {
        Value::Array(values) => values.iter().for_each(|v| flatten(v, list)),
        other => list.extend(number(other)),
    }
}

pub(super) fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Float(v) => Some(*v.value()),
        #[expect(clippy::cast_precision_loss, reason = "of whole numbers sign and size count")]
        Value::Integer(v) => Some(*v.value() as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml_edit::DocumentMut;

    #[test]
    fn what_no_measurement_gives_is_refused_with_its_key() {
        for (text, words) in [
            ("[run]\ntemperature_degc = -300.0", "run.temperature_degc is below absolute zero"),
            ("[run]\ntemperature_degc = nan", "run.temperature_degc is nan"),
            ("sigma_x = [1e300]", "sigma_x is larger"),
            ("[[amplitude]]\nfrequency_hz = -5.0", "amplitude.frequency_hz is negative"),
            ("[facility]\nscale_nt_per_eu = [1.0, 0.0, 1.0]", "facility.scale_nt_per_eu is not positive"),
            ("[[axis]]\nprobability = 1.5", "axis.probability is no part of one"),
            ("[[channel]]\ncorrelation = [0.5, -1.5, 0.0]", "channel.correlation is no correlation"),
            ("[quality]\nrotation_determinant = 0.9", "quality.rotation_determinant"),
            ("[quality]\nblocks_used = 5\nblocks_total = 4", "quality.blocks_used is 5 of 4"),
            ("[quality.raw_std_ent]\nmin = [1.0]\nmean = [0.5]\nmax = [2.0]", "quality.raw_std_ent.min is above"),
            ("[conditions]\nsensor_degc = [3.0, 2.0, 4.0]", "conditions.sensor_degc are no smallest"),
            ("runs = [\"a\", \"b\"]\ntemperature_degc = [1.0]", "runs has 2 values, temperature_degc 1"),
            ("[[quantity]]\nstd = [1.0]\nvalue = [1.0, 2.0]", "quantity.value has 2 values, std 1"),
            ("[allan]\ntau_s = [1.0]\nx_ent = []", "allan.x_ent has 0 values, tau_s 1"),
            (
                "[[noise]]\nslow_noise_of = [\"gain\", \"samples\"]\nexponent = [1.0]",
                "noise.slow_noise_of has 2 values, exponent 1",
            ),
            ("sigma_x = [1.0, 2.0]\n[covariance]\nsigma_x = [[1.0]]", "sigma_x has 2 coefficients, covariance.sigma_x 1 rows"),
        ] {
            let error = check(&text.parse::<DocumentMut>().unwrap(), &[]).unwrap_err().to_string();
            assert!(error.contains(words), "{text}: {error}");
        }
        let sound = "offset_ent = [nan, 1.0, 2.0]\nruns = [\"a\"]\ntemperature_degc = [-60.0]\n[covariance]\nparameters = [\"a\"]\nunits = []\nmatrix = [[1.0]]";
        assert_eq!(check(&sound.parse::<DocumentMut>().unwrap(), &["offset_ent"]), Ok(()));
    }
}
