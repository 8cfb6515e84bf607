//! What no parameter file of any kind may say, whatever its hash: values that contradict themselves.

use super::domains::{self, Contradiction, flatten, number};
use crate::data::error::Finding;
use nalgebra::DMatrix;
use std::path::Path;
use toml_edit::{DocumentMut, Item, Table, Value};

/// Covariances have rounding: two halves agree to this, and an eigenvalue of the correlations is no more negative.
const ROUNDING: f64 = 1e-6;
/// Standard uncertainties below this part of the largest one of a covariance are what rounding makes of zero.
const LEAST_PART: f64 = 1e-7;

/// Refuses a file whose values contradict themselves: negative or infinite standard uncertainties, covariances that are none, ranges that
/// end before they begin, run ids that are no names, and what [`domains`] knows. Only lists below the keys of `may_lack` hold nan.
pub(super) fn is_sound(path: &Path, document: &DocumentMut, may_lack: &[&str]) -> Result<(), Finding> {
    is_sound_table(&path.display().to_string(), document, may_lack)
}

/// The same of the keys of any file with parameters.
pub(in crate::files) fn is_sound_table(file: &str, table: &Table, may_lack: &[&str]) -> Result<(), Finding> {
    below(&mut Vec::new(), table)
        .and_then(|()| domains::check(table, may_lack))
        .map_err(|rule| Finding::error(file, format!("contradicts itself: {rule}"), "take the original, or make it again"))
}

type Keys<'a> = Vec<&'a str>;

fn item<'a>(keys: &mut Keys<'a>, own: &'a Item) -> Result<(), Contradiction> {
    match own {
        Item::None => Ok(()),
        Item::Value(own) => value(keys, own),
        Item::Table(table) => below(keys, table),
        Item::ArrayOfTables(list) => list.iter().try_for_each(|table| below(keys, table)),
    }
}

fn below<'a>(keys: &mut Keys<'a>, table: &'a Table) -> Result<(), Contradiction> {
    table.iter().try_for_each(|(key, own)| {
        keys.push(key);
        item(keys, own)?;
        keys.pop();
        Ok(())
    })
}

fn value<'a>(keys: &mut Keys<'a>, own: &'a Value) -> Result<(), Contradiction> {
    if let Value::InlineTable(table) = own {
        return table.iter().try_for_each(|(key, below)| {
            keys.push(key);
            value(keys, below)?;
            keys.pop();
            Ok(())
        });
    }
    let mut numbers = Vec::new();
    flatten(own, &mut numbers);
    if numbers.iter().any(|v| v.is_infinite()) {
        return Err(Contradiction::of(keys, "is infinite"));
    }
    if keys.iter().any(|key| is_std(key)) && numbers.iter().any(|v| *v < 0.0) {
        return Err(Contradiction::of(keys, "is a standard uncertainty and negative"));
    }
    let has_rows = own.as_array().is_some_and(|list| list.iter().any(Value::is_array));
    if keys.iter().any(|key| key.starts_with("covariance")) && (has_rows || numbers.len() > 1) {
        covariance(own).map_err(|rule| Contradiction::of(keys, rule))?;
    }
    if keys.iter().any(|key| key.starts_with("valid")) && is_reversed(own) {
        return Err(Contradiction::of(keys, "ends before it begins"));
    }
    match own {
        Value::String(text) if keys.ends_with(&["run", "id"]) && !is_name(text.value()) => {
            Err(Contradiction::of(keys, format!("is no name: {:?}", text.value())))
        }
        _ => Ok(()),
    }
}

fn is_std(key: &str) -> bool {
    key.split('_').any(|word| word == "std")
}

/// A name that goes into names of files.
fn is_name(id: &str) -> bool {
    !id.is_empty() && !id.starts_with('.') && !id.chars().any(|c| c.is_control() || "/\\".contains(c))
}

/// Whether a pair of numbers, or one of a list of pairs, descends.
fn is_reversed(value: &Value) -> bool {
    let Value::Array(values) = value else { return false };
    let own: Vec<f64> = values.iter().filter_map(number).collect();
    (values.len() == 2 && own.len() == 2 && own[0] > own[1]) || values.iter().any(is_reversed)
}

fn covariance(value: &Value) -> Result<(), &'static str> {
    let Value::Array(rows) = value else { return Ok(()) };
    let rows: Vec<Vec<f64>> = rows
        .iter()
        .map(|row| {
            let mut numbers = Vec::new();
            flatten(row, &mut numbers);
            numbers
        })
        .collect();
    is_covariance(&rows)
}

/// Why rows are no covariance. What was not determined is nan, and such a matrix is not looked at.
pub(in crate::files) fn is_covariance(rows: &[Vec<f64>]) -> Result<(), &'static str> {
    let n = rows.len();
    if rows.iter().any(|row| row.len() != n) {
        return Err("is not square");
    }
    if rows.iter().flatten().any(|v| v.is_nan()) {
        return Ok(());
    }
    // A variance that should be zero is what rounding leaves of larger ones, on either side of it.
    let least_std = LEAST_PART * (0..n).map(|i| rows[i][i]).fold(0.0, f64::max).sqrt();
    if (0..n).any(|i| rows[i][i] < -least_std * least_std) {
        return Err("has a negative variance");
    }
    let std: Vec<f64> = (0..n).map(|i| rows[i][i].max(0.0).sqrt()).collect();
    let scale = |i: usize, k: usize| match std[i].max(least_std) * std[k].max(least_std) {
        0.0 => 1.0,
        scale => scale,
    };
    let element = |i: usize, k: usize| if i == k { std[i] * std[i] } else { rows[i][k] };
    let correlation = DMatrix::from_fn(n, n, |i, k| element(i, k) / scale(i, k));
    if (&correlation - correlation.transpose()).amax() > ROUNDING {
        return Err("is not symmetric");
    }
    let least = correlation.symmetric_eigenvalues().min();
    if least < -ROUNDING * n as f64 { Err("is no covariance: a sum of its quantities has a negative variance") } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> Option<String> {
        is_sound(Path::new("f"), &text.parse().unwrap(), &["offset_std_ent", "covariance"]).err().map(|f| f.rule.to_string())
    }

    #[test]
    fn what_contradicts_itself_is_refused_with_its_key() {
        for (text, words) in [
            ("[std]\nsigma = [1e-6, -1e-6, 1e-6]", "std.sigma is a standard uncertainty and negative"),
            ("offset_std_ent = [0.1, inf, 0.1]", "offset_std_ent is infinite"),
            ("valid_degc = [20.0, -20.0]", "valid_degc ends before it begins"),
            ("[valid]\nfield_coil_nt = [[-1.0, 1.0], [1.0, -1.0]]", "valid.field_coil_nt ends"),
            ("[covariance]\nmatrix = [[1.0, 0.5], [0.4, 1.0]]", "covariance.matrix is not symmetric"),
            ("[covariance]\nsigma_x = [[1.0, 2.0], [2.0, 1.0]]", "covariance.sigma_x is no covariance"),
            (
                "[covariance]\nsigma_x = [[1.0]]\nsigma_y = [[-1.0, 0.0], [0.0, 1.0]]",
                "covariance.sigma_y has a negative variance",
            ),
            ("[covariance]\nsigma_x = [[-1.0]]", "covariance.sigma_x has a negative variance"),
            (
                "[covariance]\nparameters = [\"a\", \"a\"]\nmatrix = [[1.0, 0.0], [0.0, 1.0]]",
                "covariance.parameters names `a` twice",
            ),
            ("[covariance]\nmatrix = [[1.0, 0.0]]", "covariance.matrix is not square"),
            ("[run]\nid = \"../../../x\"", "run.id is no name"),
        ] {
            let rule = refused(text);
            assert!(rule.as_ref().is_some_and(|r| r.contains(words)), "{text}: {rule:?}");
        }
        assert_eq!(
            refused(
                "valid_degc = [-20.0, 20.0]\noffset_std_ent = [0.1, nan, 0.0]\n[covariance]\nmatrix = [[1.0, nan], [nan, 1.0]]\n[run]\nid = \"13-04-03_09-22-38\""
            ),
            None
        );
        // What rounding leaves of a variance that is zero.
        assert_eq!(refused("[covariance_b]\nmatrix = [[1e-14, 0.0], [1e-29, -1e-30]]"), None);
    }
}
