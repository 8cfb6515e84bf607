//! Tables whose cells say what they hold.

use super::Text;
use crate::data::units::{degrees_minutes_seconds, scientific_with_uncertainty, six_digits, with_uncertainty};
use std::fmt;

/// A table with one head and rows of its width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Names of the columns; all are empty where a table needs no head.
    pub head: Vec<String>,
    /// The rows.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// A table without rows.
    #[must_use]
    pub fn new<S: Into<String>>(head: impl IntoIterator<Item = S>) -> Self {
        Self { head: head.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// The same with these rows.
    #[must_use]
    pub fn with_rows(mut self, rows: impl IntoIterator<Item = Vec<Cell>>) -> Self {
        self.rows.extend(rows);
        self
    }

    /// Adds a row.
    pub fn push(&mut self, row: Vec<Cell>) {
        self.rows.push(row);
    }
}

/// A row of cells from values of different types.
macro_rules! cells {
    ($($cell:expr),* $(,)?) => { vec![$($crate::show::document::Cell::from($cell)),*] };
}
pub(in crate::show) use cells;

/// What a cell holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A value, with its uncertainty where that is known.
    Number(Number),
    /// Words.
    Text(Text),
    /// There is no value; the words say why or are a dash.
    Missing(&'static str),
}

/// A value, and how its digits are written.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// The value.
    pub value: f64,
    /// Its standard uncertainty, where it has one and the form shows it.
    pub std: Option<f64>,
    /// How the digits are written.
    pub form: Form,
    /// Whether a positive value with an uncertainty keeps its sign.
    pub signed: bool,
    /// Unit after the digits; empty where the head of the column names it.
    pub unit: String,
}

/// How the digits of a number are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// As many decimals as two digits of the uncertainty have: `+0.972339 ± 0.000012`.
    Uncertain,
    /// The same in powers of ten: `-1.8018e-5 ± 1.2e-9`.
    Scientific,
    /// So many decimals, and the uncertainty in powers of ten: `12.5000 ± 1.2e-4`.
    Place(usize),
    /// So many decimals: `12.500`.
    Fixed(usize),
    /// So many decimals with a sign: `+12.500`.
    Signed(usize),
    /// Powers of ten with so many decimals: `1.25e1`.
    Exponent(usize),
    /// Six digits, four of them decimals at most: `12.5000`.
    SixDigits,
    /// Degrees, minutes and seconds: `+89°47'17''`.
    Angle,
    /// As few digits as tell the value exactly: `12.5`.
    Exact,
}

/// Words of a cell whose value a fit or a measurement did not give.
pub(in crate::show) const NOT_DETERMINED: &str = "not determined";

impl Cell {
    fn number(value: f64, std: Option<f64>, form: Form) -> Self {
        if value.is_finite() {
            Cell::Number(Number { value, std, form, signed: true, unit: String::new() })
        } else {
            Cell::Missing(NOT_DETERMINED)
        }
    }

    /// A value with its standard uncertainty, which may be unknown.
    #[must_use]
    pub fn uncertain(value: f64, std: f64) -> Self {
        Self::number(value, std.is_finite().then_some(std), Form::Uncertain)
    }

    /// A value of any size with its standard uncertainty, which may be unknown, in powers of ten.
    #[must_use]
    pub fn scientific(value: f64, std: f64) -> Self {
        Self::number(value, std.is_finite().then_some(std), Form::Scientific)
    }

    /// A place on an axis with so many decimals, and its uncertainty.
    #[must_use]
    pub fn place(value: f64, std: f64, decimals: usize) -> Self {
        Self::number(value, Some(std), Form::Place(decimals))
    }

    /// A value with so many decimals.
    #[must_use]
    pub fn fixed(value: f64, decimals: usize) -> Self {
        Self::number(value, None, Form::Fixed(decimals))
    }

    /// A value with its sign and so many decimals.
    #[must_use]
    pub fn signed(value: f64, decimals: usize) -> Self {
        Self::number(value, None, Form::Signed(decimals))
    }

    /// A value in powers of ten with so many decimals.
    #[must_use]
    pub fn exponent(value: f64, decimals: usize) -> Self {
        Self::number(value, None, Form::Exponent(decimals))
    }

    /// A value with six digits, four of them decimals at most.
    #[must_use]
    pub fn six_digits(value: f64) -> Self {
        Self::number(value, None, Form::SixDigits)
    }

    /// An angle given in degrees, written in degrees, minutes and seconds.
    #[must_use]
    pub fn angle(degrees: f64) -> Self {
        Self::number(degrees, None, Form::Angle)
    }

    /// A value as it was given.
    #[must_use]
    pub fn exact(value: f64) -> Self {
        Self::number(value, None, Form::Exact)
    }

    /// A temperature in °C that may be missing, with its unit.
    #[must_use]
    pub fn degc(value: Option<f64>) -> Self {
        value.map_or(Cell::Missing("not recorded"), |v| Self::fixed(v, 1).with_unit("°C"))
    }

    /// The same with other words where the value is missing.
    #[must_use]
    pub fn or(self, words: &'static str) -> Self {
        if matches!(self, Cell::Missing(_)) { Cell::Missing(words) } else { self }
    }

    /// The same with the unit after the digits.
    #[must_use]
    pub fn with_unit(self, unit: impl Into<String>) -> Self {
        match self {
            Cell::Number(number) => Cell::Number(Number { unit: unit.into(), ..number }),
            other => other,
        }
    }

    /// The same without a plus sign, for what is never negative.
    #[must_use]
    pub fn unsigned(self) -> Self {
        match self {
            Cell::Number(number) => Cell::Number(Number { signed: false, ..number }),
            other => other,
        }
    }

    /// What the cell holds as words.
    #[must_use]
    pub fn plain(&self) -> String {
        match self {
            Cell::Number(number) => number.to_string(),
            Cell::Text(text) => text.plain(),
            Cell::Missing(words) => (*words).to_owned(),
        }
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Number { value, std, form, signed, ref unit } = *self;
        let digits = match form {
            Form::Uncertain => {
                std.map_or_else(|| format!("{value:.2} (uncertainty not known)"), |std| with_uncertainty(value, std))
            }
            // Values of a usual size are read without a power of ten.
            Form::Scientific => match std.filter(|_| (1e-2..1e5).contains(&value.abs())) {
                Some(std) => with_uncertainty(value, std).trim_start_matches('+').to_owned(),
                None => scientific_with_uncertainty(value, std.unwrap_or(f64::NAN)),
            },
            Form::Place(decimals) => match std {
                Some(std) => format!("{value:.decimals$} ± {std:.1e}"),
                None => format!("{value:.decimals$}"),
            },
            Form::Fixed(decimals) => format!("{value:.decimals$}"),
            Form::Signed(decimals) => format!("{value:+.decimals$}"),
            Form::Exponent(decimals) => format!("{value:.decimals$e}"),
            Form::SixDigits => six_digits(value),
            Form::Angle => degrees_minutes_seconds(value),
            Form::Exact => value.to_string(),
        };
        f.write_str(if signed { &digits } else { digits.strip_prefix('+').unwrap_or(&digits) })?;
        if unit.is_empty() { Ok(()) } else { write!(f, " {unit}") }
    }
}

impl From<Text> for Cell {
    fn from(text: Text) -> Self {
        Cell::Text(text)
    }
}

impl From<String> for Cell {
    fn from(words: String) -> Self {
        Cell::Text(words.into())
    }
}

impl From<&String> for Cell {
    fn from(words: &String) -> Self {
        Cell::Text(words.as_str().into())
    }
}

impl From<&str> for Cell {
    fn from(words: &str) -> Self {
        Cell::Text(words.into())
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Self {
        Self::fixed(count as f64, 0)
    }
}

impl From<u64> for Cell {
    fn from(count: u64) -> Self {
        Self::fixed(count as f64, 0)
    }
}

impl From<u32> for Cell {
    fn from(count: u32) -> Self {
        Self::fixed(f64::from(count), 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_their_form_says() {
        let pairs = [
            (Cell::uncertain(-10.561, 0.25), "-10.56 ± 0.25"),
            (Cell::uncertain(10.561, 0.25).unsigned(), "10.56 ± 0.25"),
            (Cell::uncertain(10.561, f64::NAN), "10.56 (uncertainty not known)"),
            (Cell::uncertain(f64::NAN, 0.25), "not determined"),
            (Cell::scientific(-1.801_8e-5, 1.2e-7), "-1.802e-5 ± 1.2e-7"),
            (Cell::place(12.5, 1.2e-4, 4), "12.5000 ± 1.2e-4"),
            (Cell::fixed(12.5, 3), "12.500"),
            (Cell::signed(12.5, 2), "+12.50"),
            (Cell::exponent(12.5, 2), "1.25e1"),
            (Cell::angle(-0.5), "-0°30'0''"),
            (Cell::exact(12.5), "12.5"),
            (Cell::from(7_usize), "7"),
            (Cell::degc(Some(20.04)), "20.0 °C"),
            (Cell::degc(None), "not recorded"),
            (Cell::fixed(f64::INFINITY, 1).or("-"), "-"),
        ];
        for (cell, text) in pairs {
            assert_eq!(cell.plain(), text);
        }
    }
}
