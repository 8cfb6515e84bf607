//! Values of two parameter files side by side.

use std::borrow::Cow;

/// Keys that files of earlier versions of the program do not have.
const LATER_KEYS: [&str; 19] = [
    "apply",
    "warning_kinds",
    "valid_field_nt",
    "linearisation",
    "known_effects",
    "hypothesis",
    "std",
    "std_b",
    "std_combined",
    "covariance_b",
    "covariance_combined",
    "offset.std_covers",
    "method.std_covers",
    "method.std_b_covers",
    "together",
    "together_combined",
    "joint.together",
    "common",
    APPLIED,
];
/// Applied amplitude of the sines of a run, which every row has beside it.
const APPLIED: &str = "applied_nt";

/// Values of two parameter files side by side.
#[derive(Default)]
pub(super) struct Differences {
    /// Values compared.
    pub values: usize,
    /// Largest relative difference.
    pub largest: f64,
    /// What differs by more than is allowed.
    pub list: Vec<String>,
}

impl Differences {
    pub fn of(stated: &toml_edit::DocumentMut, again: &toml_edit::DocumentMut, tolerance: f64) -> Self {
        let mut differences = Self::default();
        // Files of the time before the polynomials of both corners have those of one.
        let again = one_corner(stated, again);
        let (mut a, mut b) = (Vec::new(), Vec::new());
        flatten("", stated.as_item(), &mut a);
        flatten("", again.as_item(), &mut b);
        let is_stated = |key: &&str| key.split('.').try_fold(stated.as_item(), |item, part| item.get(part)).is_some();
        let left_out: Vec<&str> = LATER_KEYS.into_iter().filter(|key| !is_stated(key)).chain(["provenance"]).collect();
        let is_within =
            |key: &str, outer: &str| key.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
        let is_of_row =
            |key: &str, outer: &str| outer == APPLIED && key.strip_suffix(outer).is_some_and(|rest| rest.ends_with('.'));
        let compared = |key: &str| !left_out.iter().any(|outer| is_within(key, outer) || is_of_row(key, outer));
        let own = |list: Vec<(String, String)>| list.into_iter().filter(|(k, _)| compared(k)).collect::<Vec<_>>();
        let (a, b) = (own(a), own(b));
        for (key, value) in &a {
            differences.values += 1;
            let Some((_, other)) = b.iter().find(|(k, _)| k == key) else {
                differences.list.push(format!("{key} = {value} does not come back"));
                continue;
            };
            let same = match (value.parse::<f64>(), other.parse::<f64>()) {
                (Ok(x), Ok(y)) if x.is_nan() && y.is_nan() => true,
                (Ok(x), Ok(y)) => {
                    let difference = if x == y { 0.0 } else { (x - y).abs() / x.abs().max(y.abs()) };
                    differences.largest = differences.largest.max(difference);
                    difference <= tolerance
                }
                _ => value == other,
            };
            if !same {
                differences.list.push(format!("{key} = {value} comes back as {other}"));
            }
        }
        // A key without a value is as good as none; earlier versions of the program left it out.
        let is_unknown = |value: &str| value.parse::<f64>().is_ok_and(f64::is_nan);
        for (key, value) in b.iter().filter(|(k, v)| !is_unknown(v) && !a.iter().any(|(other, _)| other == k)) {
            differences.list.push(format!("{key} = {value} is not in the file"));
        }
        differences
    }
}

/// Begin of what a TAF holds of the corner between neighbouring amplitudes.
const INTERPOLATED: &str = "f_3db_igep";

/// A file that was made again, without the corner between neighbouring amplitudes where the stated one has nothing of it.
fn one_corner<'a>(stated: &toml_edit::DocumentMut, again: &'a toml_edit::DocumentMut) -> Cow<'a, toml_edit::DocumentMut> {
    let of_corner = |name: &str| name.starts_with(INTERPOLATED);
    if stated.iter().any(|(key, _)| of_corner(key)) || !again.iter().any(|(key, _)| of_corner(key)) {
        return Cow::Borrowed(again);
    }
    let mut made = again.clone();
    made.retain(|key, _| !of_corner(key));
    if let Some(covariance) = made.get_mut("covariance").and_then(|c| c.as_table_mut()) {
        covariance.retain(|key, _| !of_corner(key));
    }
    if let Some(quantities) = made.get_mut("quantity").and_then(|q| q.as_array_of_tables_mut()) {
        quantities.retain(|table| !table.get("name").and_then(|n| n.as_str()).is_some_and(of_corner));
    }
    if let Some(warnings) = made.get_mut("warnings").and_then(|w| w.as_array_mut()) {
        warnings.retain(|warning| !warning.as_str().is_some_and(of_corner));
    }
    Cow::Owned(made)
}

/// Every value with its path.
fn flatten(path: &str, item: &toml_edit::Item, list: &mut Vec<(String, String)>) {
    use toml_edit::{Item, Value};
    fn value(path: &str, v: &Value, list: &mut Vec<(String, String)>) {
        match v {
            Value::Array(a) => a.iter().enumerate().for_each(|(i, v)| value(&format!("{path}.{i}"), v, list)),
            Value::InlineTable(t) => t.iter().for_each(|(k, v)| value(&format!("{path}.{k}"), v, list)),
            Value::String(s) => list.push((path.to_owned(), s.value().clone())),
            Value::Float(f) => list.push((path.to_owned(), format!("{:?}", f.value()))),
            other => list.push((path.to_owned(), other.to_string().trim().to_owned())),
        }
    }
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match item {
        Item::None => {}
        Item::Value(v) => value(path, v, list),
        Item::Table(t) => t.iter().for_each(|(k, v)| flatten(&join(k), v, list)),
        Item::ArrayOfTables(a) => {
            for (i, t) in a.iter().enumerate() {
                t.iter().for_each(|(k, v)| flatten(&join(&format!("{i}.{k}")), v, list));
            }
        }
    }
}
