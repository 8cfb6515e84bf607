//! What a result was made with, as data: `verify` makes the result again from it, and the command that people read is written from it.
//!
//! Files that were made before there were recipes have the command alone; [`Recipe::of_command`] is the one place that reads it.

use super::exclusion::Exclusion;
use super::provenance::{Input, Role};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use thiserror::Error;

/// What a result was made with, beside its inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// The analysis.
    pub analysis: String,
    /// Its options that have an influence on the numbers.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub options: Map<String, Value>,
    /// What was allowed when the run files were read, and left out of them.
    #[serde(default, skip_serializing_if = "Reading::is_strict")]
    pub reading: Reading,
}

/// What is allowed of run files, and what is left out of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// They may end before `@END`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub allow_truncated: bool,
    /// They may have many repeated rows.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub allow_duplicates: bool,
    /// What was left out by hand beside what the campaign file says.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exclude: Vec<Exclusion>,
}

impl Reading {
    fn is_strict(&self) -> bool {
        *self == Self::default()
    }
}

/// An analysis as it is recorded.
pub struct Recorded {
    /// Its name.
    pub name: &'static str,
    /// What stands after `calfit` in its command.
    command: &'static str,
    /// An option that makes this analysis of another one with the same command.
    flag: Option<&'static str>,
    /// Files that its options name.
    files: &'static [Role],
}

const fn recorded(name: &'static str, command: &'static str, files: &'static [Role]) -> Recorded {
    Recorded { name, command, flag: None, files }
}

/// The analyses of which there are files without a recipe, and those with another name than their command or other inputs than their own.
/// Those of the same command stand together, the one without a flag after the others.
pub const ANALYSES: [Recorded; 14] = [
    Recorded { flag: Some("linearise"), ..recorded("linearise", "lin", &[Role::Facility, Role::Model, Role::Temperature]) },
    recorded("lin", "lin", &[Role::Facility, Role::Linearisation, Role::Model, Role::Temperature]),
    recorded("offset", "offset", &[Role::Cpf, Role::Facility, Role::Model]),
    recorded("freq", "freq", &[Role::Model, Role::Amplitudes]),
    recorded("null", "null", &[Role::Cpf, Role::Model]),
    recorded(
        "thermal",
        "thermal",
        &[Role::Facility, Role::Linearisation, Role::Model, Role::Centre, Role::OffCentre, Role::Offset],
    ),
    recorded("sweep", "thermal", &[Role::Facility, Role::Model]),
    recorded("coil scalar", "coil scalar", &[]),
    recorded("coil residual", "coil residual", &[]),
    recorded("coil tilt", "coil tilt", &[Role::Facility]),
    recorded("thermistor", "thermistor", &[Role::Reference]),
    recorded("diagnose", "diagnose", &[Role::Facility, Role::Model, Role::Temperature, Role::Amplitudes]),
    recorded("report", "report", &[Role::Facility, Role::Linearisation, Role::Model]),
    recorded("export", "export", &[]),
];

/// How the value of an option is written.
#[derive(Clone, Copy)]
enum Form {
    /// There or not.
    Flag,
    /// A number as short as it can be.
    Number,
    /// A number that shows that it is not a count: `1.0`.
    Decimal,
    /// A text.
    Text,
    /// Numbers with commas between them.
    Numbers,
    /// A whole number, or repeated, `NAME=N`.
    Order,
    /// A whole number.
    Count,
    /// `null=N`.
    DriftOrder,
    /// Repeated, `AXIS=NUMBER`.
    Axes,
    /// A number of settings, or `NUMBERmin`.
    Window,
    /// A value of `--allow`.
    Allow(&'static str),
    /// A file among the inputs.
    File(Role),
}

/// Orders of the drift of zero-field runs and of the offset trend of linearity runs, where `order` is that of temperature polynomials.
const DRIFT_ORDER: &str = "drift_order";
const TREND_ORDER: &str = "trend_order";

/// All options that are recorded, in the order of a command: key, option, form.
const OPTIONS: [(&str, &str, Form); 34] = [
    ("order", "order", Form::Order),
    (DRIFT_ORDER, "order", Form::DriftOrder),
    (TREND_ORDER, "order", Form::Count),
    ("max_field_nt", "max-field", Form::Axes),
    ("robust", "robust", Form::Flag),
    ("window", "window", Form::Window),
    ("max_rate_k_per_min", "max-rate", Form::Number),
    ("lag", "lag", Form::Text),
    ("joint", "joint", Form::Flag),
    ("signal", "signal", Form::Text),
    ("divider", "divider", Form::Numbers),
    ("compare", "compare", Form::Numbers),
    ("within_degc", "within", Form::Decimal),
    ("", "reference", Form::File(Role::Reference)),
    ("", "amplitudes", Form::File(Role::Amplitudes)),
    ("rack_channel", "rack-channel", Form::Text),
    ("format", "format", Form::Text),
    ("at_centre", "at-centre", Form::Flag),
    ("write_model", "write-model", Form::Flag),
    ("", "cpf", Form::File(Role::Cpf)),
    ("", "facility", Form::File(Role::Facility)),
    ("", "linearisation", Form::File(Role::Linearisation)),
    ("", "model", Form::File(Role::Model)),
    ("", "temperature", Form::File(Role::Temperature)),
    ("sensor", "sensor", Form::Text),
    ("keep_all", "keep-all", Form::Flag),
    ("", "centre", Form::File(Role::Centre)),
    ("", "off-centre", Form::File(Role::OffCentre)),
    ("", "offset", Form::File(Role::Offset)),
    ("settling_s", "settling", Form::Number),
    ("coverage", "coverage", Form::Number),
    ("allow_gain", "allow", Form::Allow("gain")),
    ("allow_mismatch", "allow", Form::Allow("mismatch")),
    ("linearise", "linearise", Form::Flag),
];

/// Why a result cannot be made again from what is recorded.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RecipeError {
    /// Not the command of an analysis.
    #[error("the recorded command `{0}` is not one of this version")]
    Command(String),
    /// An option that there is not.
    #[error("the recorded command is not one of this version: there is no option `--{0}`")]
    Option(String),
    /// A value that is none of the option.
    #[error("the recorded command is not one of this version: `--{option} {value}` has no such value")]
    Value {
        /// The option.
        option: String,
        /// Its value.
        value: String,
    },
    /// A file that is not among the inputs.
    #[error("the file {path} of `--{option}` is not among the recorded inputs")]
    File {
        /// The option.
        option: String,
        /// The name of the file.
        path: String,
    },
    /// Options that the analysis does not have.
    #[error("the recipe of `{analysis}` is not one of this version: {reason}")]
    Options {
        /// The analysis.
        analysis: String,
        /// What is wrong.
        reason: String,
    },
}

impl Recipe {
    /// The recipe of an analysis with some options. What an option leaves to the analysis is not recorded.
    #[must_use]
    pub fn new(analysis: &str, options: &impl Serialize) -> Self {
        let options = match serde_json::to_value(options) {
            Ok(Value::Object(table)) => table.into_iter().filter(|(_, value)| !value.is_null()).collect(),
            // Options are tables; there is nothing to record of others.
            _ => Map::new(),
        };
        Self { analysis: analysis.to_owned(), options, reading: Reading::default() }
    }

    /// The recipe of an analysis without options.
    #[must_use]
    pub fn plain(analysis: &str) -> Self {
        Self { analysis: analysis.to_owned(), options: Map::new(), reading: Reading::default() }
    }

    /// The same with what was allowed of run files.
    #[must_use]
    pub fn reading(self, reading: Reading) -> Self {
        Self { reading, ..self }
    }

    /// The options of the analysis.
    ///
    /// # Errors
    /// An option that it does not have, or a value that is none.
    pub fn options<O: DeserializeOwned>(&self) -> Result<O, RecipeError> {
        serde_json::from_value(Value::Object(self.options.clone()))
            .map_err(|e| RecipeError::Options { analysis: self.analysis.clone(), reason: e.to_string() })
    }

    fn recorded(&self) -> Option<&'static Recorded> {
        ANALYSES.iter().find(|a| a.name == self.analysis)
    }

    /// The command as a person writes it, without the paths of the data.
    #[must_use]
    pub fn command(&self, inputs: &[Input]) -> String {
        let recorded = self.recorded();
        let mut text = format!("calfit {}", recorded.map_or(self.analysis.as_str(), |a| a.command));
        for (key, option, form) in OPTIONS {
            let of = |role: Role| recorded.is_none_or(|a| a.files.contains(&role)).then_some(role);
            let words = match form {
                Form::File(role) => of(role).map_or_else(Vec::new, |role| names(inputs, role)),
                _ => self.options.get(key).map_or_else(Vec::new, |value| form.written(value)),
            };
            let dashed = |word: String| if word.is_empty() { format!(" --{option}") } else { format!(" --{option} {word}") };
            text.extend(words.into_iter().map(dashed));
            // What was allowed stands together.
            if key == "allow_mismatch" {
                let reading = [(self.reading.allow_truncated, "truncated"), (self.reading.allow_duplicates, "duplicates")];
                text.extend(reading.iter().filter(|(allowed, _)| *allowed).map(|(_, name)| format!(" --allow {name}")));
            }
        }
        if let Some(flag) = recorded.and_then(|a| a.flag) {
            text.push_str(&format!(" --{flag}"));
        }
        text.extend(self.reading.exclude.iter().map(|e| format!(" --exclude '{e}'")));
        text
    }

    /// The recipe of a command that was recorded without one, whose files get their roles among the inputs.
    ///
    /// # Errors
    /// A command or an option that this version does not have.
    pub fn of_command(command: &str, inputs: &mut [Input]) -> Result<Self, RecipeError> {
        let unknown = || RecipeError::Command(command.to_owned());
        let mut parts = command.strip_prefix("calfit ").ok_or_else(unknown)?.split(" --");
        let words = parts.next().unwrap_or_default();
        let mut recipe = Self::plain("");
        let mut named = Vec::new();
        for part in parts {
            let (option, value) = part.split_once(' ').unwrap_or((part, ""));
            recipe.take(option, value, inputs, &mut named)?;
        }
        let of_command = |a: &&Recorded| a.command == words && a.flag.is_none_or(|flag| recipe.options.contains_key(flag));
        let analysis = ANALYSES.iter().find(of_command).ok_or_else(unknown)?;
        if let Some(flag) = analysis.flag {
            recipe.options.shift_remove(flag);
        }
        if let Some(role) = named.into_iter().find(|role| !analysis.files.contains(role)) {
            return Err(RecipeError::Option(role.option().to_owned()));
        }
        recipe.analysis = analysis.name.to_owned();
        // Among analyses of several kinds of runs a bare order is that of the trend.
        if ["thermal", "report"].contains(&analysis.name)
            && let Some(order) = recipe.options.get("order").filter(|order| order.is_number()).cloned()
        {
            recipe.options.shift_remove("order");
            recipe.options.insert(TREND_ORDER.to_owned(), order);
        }
        for input in inputs.iter_mut().filter(|i| i.role.is_none() && i.path.eq_ignore_ascii_case("campaign.toml")) {
            input.role = Some(Role::Campaign);
        }
        // The runs of a group name the linear calibration that gave their offsets in nT among their inputs, which are those of the group.
        if analysis.name == "thermal" && inputs.iter().any(|i| i.role.is_none() && i.is_run()) {
            inputs.iter_mut().filter(|i| i.role.is_none() && !i.is_run()).for_each(|i| i.role = Some(Role::Cpf));
        }
        Ok(recipe)
    }

    /// Takes one option of a command.
    fn take(&mut self, option: &str, value: &str, inputs: &mut [Input], named: &mut Vec<Role>) -> Result<(), RecipeError> {
        let wrong = || RecipeError::Value { option: option.to_owned(), value: value.to_owned() };
        match (option, value) {
            ("allow", "truncated") => self.reading.allow_truncated = true,
            ("allow", "duplicates") => self.reading.allow_duplicates = true,
            ("exclude", quoted) => {
                let text = quoted.strip_prefix('\'').and_then(|q| q.strip_suffix('\'')).ok_or_else(wrong)?;
                self.reading.exclude.push(text.parse().map_err(|_| wrong())?);
            }
            _ => {
                let mut forms = OPTIONS.iter().filter(|(_, o, _)| *o == option).peekable();
                forms.peek().ok_or_else(|| RecipeError::Option(option.to_owned()))?;
                let several = self.options.get("order").is_some_and(Value::is_array) || self.options.contains_key(DRIFT_ORDER);
                let of_value = |(_, _, form): &&(&str, &str, Form)| match form {
                    Form::Allow(name) => *name == value,
                    Form::DriftOrder => value.starts_with("null="),
                    Form::Order => !value.starts_with("null=") && (value.contains('=') || !several),
                    Form::Count => several,
                    _ => true,
                };
                let (key, _, form) = forms.find(of_value).ok_or_else(wrong)?;
                if let Form::File(role) = form {
                    let input = inputs.iter_mut().find(|i| i.role.is_none() && i.path == value);
                    let absent = || RecipeError::File { option: option.to_owned(), path: value.to_owned() };
                    input.ok_or_else(absent)?.role = Some(*role);
                    named.push(*role);
                } else {
                    let before = self.options.shift_remove(*key);
                    let read = form.read(value, before).ok_or_else(wrong)?;
                    self.options.insert((*key).to_owned(), read);
                }
            }
        }
        Ok(())
    }
}

/// Names of the inputs with a role, each once.
fn names(inputs: &[Input], role: Role) -> Vec<String> {
    let mut list: Vec<String> = Vec::new();
    for input in inputs.iter().filter(|i| i.role == Some(role)) {
        if !list.contains(&input.path) {
            list.push(input.path.clone());
        }
    }
    list
}

impl Form {
    /// The values as words of a command; an option without a value has an empty one.
    fn written(self, value: &Value) -> Vec<String> {
        let short = |value: &Value| match value.as_f64() {
            Some(number) if value.is_f64() => number.to_string(),
            _ => value.to_string(),
        };
        let decimal = |value: &Value| value.as_f64().map_or_else(String::new, |number| format!("{number:?}"));
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        match self {
            Form::Flag if value == &Value::Bool(true) => vec![String::new()],
            Form::Allow(name) if value == &Value::Bool(true) => vec![name.to_owned()],
            Form::Flag | Form::Allow(_) | Form::File(_) => Vec::new(),
            Form::Number => vec![short(value)],
            Form::Decimal => vec![decimal(value)],
            Form::Text => vec![text(value)],
            Form::Numbers => vec![value.as_array().into_iter().flatten().map(decimal).collect::<Vec<_>>().join(",")],
            Form::Order => match value.as_array() {
                Some(pairs) => pairs.iter().map(|pair| format!("{}={}", text(&pair[0]), short(&pair[1]))).collect(),
                None => vec![short(value)],
            },
            Form::Count => vec![short(value)],
            Form::DriftOrder => vec![format!("null={}", short(value))],
            Form::Axes => {
                value.as_object().into_iter().flatten().map(|(axis, limit)| format!("{axis}={}", short(limit))).collect()
            }
            Form::Window => match (value.get("minutes"), value.get("settings")) {
                (Some(minutes), _) => vec![format!("{}min", short(minutes))],
                (None, Some(settings)) => vec![short(settings)],
                (None, None) => Vec::new(),
            },
        }
    }

    /// The value of a word of a command, with what an earlier one gave; `None` where it is no value.
    fn read(self, word: &str, before: Option<Value>) -> Option<Value> {
        let number = |word: &str| word.parse::<f64>().ok().filter(|v| v.is_finite());
        let whole = |word: &str| word.parse::<u64>().ok();
        match self {
            Form::Flag => word.is_empty().then_some(Value::Bool(true)),
            Form::Allow(name) => (word == name).then_some(Value::Bool(true)),
            Form::File(_) => None,
            Form::Number | Form::Decimal => Some(number(word)?.into()),
            Form::Text => (!word.is_empty()).then(|| word.into()),
            Form::Numbers => {
                word.split(',').map(|w| number(w).map(Value::from)).collect::<Option<Vec<Value>>>().map(Value::Array)
            }
            Form::Order => match word.split_once('=') {
                None => Some(whole(word)?.into()),
                Some((name, order)) => {
                    let mut pairs = before.and_then(|v| v.as_array().cloned()).unwrap_or_default();
                    pairs.push(Value::Array(vec![name.into(), whole(order)?.into()]));
                    Some(Value::Array(pairs))
                }
            },
            Form::Count => Some(whole(word)?.into()),
            Form::DriftOrder => Some(whole(word.strip_prefix("null=")?)?.into()),
            Form::Axes => {
                let (axis, limit) = word.split_once('=')?;
                let mut axes = before.and_then(|v| v.as_object().cloned()).unwrap_or_default();
                axes.insert(axis.to_owned(), number(limit)?.into());
                Some(Value::Object(axes))
            }
            Form::Window => match word.strip_suffix("min") {
                Some(minutes) => Some(serde_json::json!({ "minutes": number(minutes)? })),
                None => Some(serde_json::json!({ "settings": whole(word)? })),
            },
        }
    }
}

/// Limits of the three axes as a table of those that have one.
pub mod axes {
    use crate::data::units::COMPONENTS;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
    use std::collections::BTreeMap;

    /// Whether no axis has a limit.
    #[must_use]
    pub fn none(limits: &[Option<f64>; 3]) -> bool {
        limits.iter().all(Option::is_none)
    }

    /// Writes the limits under the names of the axes.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(limits: &[Option<f64>; 3], serializer: S) -> Result<S::Ok, S::Error> {
        let named: BTreeMap<&str, f64> = COMPONENTS.into_iter().zip(limits).filter_map(|(name, v)| Some((name, (*v)?))).collect();
        named.serialize(serializer)
    }

    /// Reads limits under the names of axes.
    ///
    /// # Errors
    /// Those of the deserializer, and another name.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[Option<f64>; 3], D::Error> {
        let mut limits = [None; 3];
        for (name, value) in BTreeMap::<String, f64>::deserialize(deserializer)? {
            let axis =
                COMPONENTS.iter().position(|c| *c == name).ok_or_else(|| D::Error::custom(format!("no axis is {name}")))?;
            limits[axis] = Some(value);
        }
        Ok(limits)
    }
}
