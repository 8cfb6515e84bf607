//! Keys on which other programs rely: they stand in every file of a kind, with nan where the value is not known. In the types of this
//! program such a value is absent, so that the keys are put in when a file is written and taken out again when it is read.

use serde_json::{Map, Value, json};
use std::borrow::Cow;
use toml_edit::{DocumentMut, Item, TableLike, Value as TomlValue};

/// A key that stands in every file of a kind that has the table above it.
pub struct Kept {
    /// The key with the tables above it, `run.temperature_degc`.
    key: &'static str,
    shape: Shape,
}

/// How many numbers stand under a key.
#[derive(Clone, Copy)]
enum Shape {
    Number,
    Vector,
    /// Smallest, mean and largest per component.
    Spread,
    /// Coefficients of a polynomial.
    Coefficients,
    /// Rows of the covariance of coefficients.
    Covariance,
}

impl Kept {
    /// One number.
    pub const fn number(key: &'static str) -> Self {
        Self { key, shape: Shape::Number }
    }

    /// A value per component.
    pub const fn vector(key: &'static str) -> Self {
        Self { key, shape: Shape::Vector }
    }

    /// A table of smallest, mean and largest value per component.
    pub const fn spread(key: &'static str) -> Self {
        Self { key, shape: Shape::Spread }
    }

    /// The coefficients of a polynomial.
    pub const fn coefficients(key: &'static str) -> Self {
        Self { key, shape: Shape::Coefficients }
    }

    /// The covariance of the coefficients of a polynomial.
    pub const fn covariance(key: &'static str) -> Self {
        Self { key, shape: Shape::Covariance }
    }

    /// What stands for a value that is not known; null is nan.
    fn unknown(&self) -> Value {
        let vector = json!([null, null, null]);
        match self.shape {
            Shape::Number => Value::Null,
            Shape::Vector => vector,
            Shape::Spread => json!({ "min": vector, "mean": vector, "max": vector }),
            Shape::Coefficients => json!([null]),
            Shape::Covariance => json!([[null]]),
        }
    }

    /// The names of the tables above, and that of the key itself.
    fn path(&self) -> (impl Iterator<Item = &'static str>, &'static str) {
        let (above, own) = self.key.rsplit_once('.').unwrap_or(("", self.key));
        (above.split('.').filter(|name| !name.is_empty()), own)
    }
}

/// Puts the keys in whose values are not known.
pub(super) fn put_in(document: &mut Map<String, Value>, kept: &[Kept]) {
    for key in kept {
        let (mut above, own) = key.path();
        let table = above.try_fold(&mut *document, |table, name| table.get_mut(name)?.as_object_mut());
        if let Some(table) = table
            && table.get(own).is_none_or(Value::is_null)
        {
            table.insert(own.to_owned(), key.unknown());
        }
    }
}

/// The keys whose null is written.
pub(super) fn numbers(kept: &[Kept]) -> Vec<&'static str> {
    kept.iter().filter(|key| matches!(key.shape, Shape::Number)).map(|key| key.key).collect()
}

/// A file without the keys whose values are not known; `None` where all are known.
pub(super) fn without_unknown(document: &DocumentMut, kept: &[Kept]) -> Option<DocumentMut> {
    let mut known: Option<DocumentMut> = None;
    for key in kept {
        let (mut above, own) = key.path();
        let first: &dyn TableLike = document.as_table();
        let table = above.try_fold(first, |table, name| table.get(name)?.as_table_like());
        if !table.is_some_and(|table| table.get(own).is_some_and(is_unknown)) {
            continue;
        }
        let (mut above, own) = key.path();
        let first: &mut dyn TableLike = known.get_or_insert_with(|| document.clone()).as_table_mut();
        if let Some(table) = above.try_fold(first, |table, name| table.get_mut(name)?.as_table_like_mut()) {
            table.remove(own);
        }
    }
    known
}

/// The text of a file without the keys whose values are not known. Text that is not TOML is left as it is.
pub(super) fn taken_out<'a>(text: &'a str, kept: &[Kept]) -> Cow<'a, str> {
    // Most files know all their values.
    if kept.is_empty() || !text.contains("nan") {
        return Cow::Borrowed(text);
    }
    let known = text.parse::<DocumentMut>().ok().and_then(|document| without_unknown(&document, kept));
    known.map_or(Cow::Borrowed(text), |known| Cow::Owned(known.to_string()))
}

/// Whether there are numbers, and all of them are nan.
fn is_unknown(item: &Item) -> bool {
    fn all(value: &TomlValue) -> bool {
        match value {
            TomlValue::Float(number) => number.value().is_nan(),
            TomlValue::Array(list) => !list.is_empty() && list.iter().all(all),
            _ => false,
        }
    }
    match item {
        Item::Value(value) => all(value),
        Item::Table(table) => !table.is_empty() && table.iter().all(|(_, below)| is_unknown(below)),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::parameter::emit::toml_keeping;

    const KEPT: &[Kept] = &[
        Kept::number("run.temperature_degc"),
        Kept::spread("quality.raw_std_ent"),
        Kept::vector("slopes.b_or_ent"),
        Kept::coefficients("b_off_x"),
        Kept::covariance("covariance.b_off_x"),
        Kept::number("mean_f_s_hz"),
    ];

    #[test]
    fn keys_come_and_go_with_their_tables_and_known_values_stay() {
        let Value::Object(own) = json!({ "run": { "id": "a" }, "quality": {}, "covariance": {}, "f": [null, 1.0] }) else {
            panic!("is an object")
        };
        let mut whole = own.clone();
        put_in(&mut whole, KEPT);
        let text = toml_keeping(&whole, &numbers(KEPT));
        let read: DocumentMut = text.parse().unwrap();
        for key in ["b_off_x", "mean_f_s_hz"] {
            assert!(is_unknown(&read[key]), "{text}");
        }
        assert!(is_unknown(&read["run"]["temperature_degc"]) && is_unknown(&read["covariance"]["b_off_x"]));
        assert_eq!(read["quality"]["raw_std_ent"]["max"].as_array().unwrap().len(), 3);
        // No table is made for a key alone.
        assert!(!read.contains_key("slopes"));
        let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(words(&taken_out(&text, KEPT)), words(&toml_keeping(&own, &[])));

        let known = "mean_f_s_hz = 128.0\n[slopes]\nb_or_ent = [nan, 1.0, nan]\n";
        assert_eq!(taken_out(known, KEPT), known);
    }
}
