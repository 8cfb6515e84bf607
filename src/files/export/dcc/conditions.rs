//! The conditions under which the data of a file were measured: temperatures, the applied field and how steady it was.

use super::named;
use crate::files::export::Source;
use crate::files::export::quantity::Unit;

/// Numbers of a file that tell one condition.
struct Stated {
    name: &'static str,
    description: &'static str,
    /// Where the file names the channel that they come from. Without its channel a temperature is not one of the data: the same key of a
    /// THERMISTOR file is the range of a table.
    channel: Option<&'static str>,
    /// What each is, its place and its unit.
    numbers: &'static [(&'static str, &'static str, &'static str)],
}

const SENSOR: &str = "temperature of the sensor";
const COIL: &str = "temperature of the coil system";
const RACK: &str = "temperature of the electronics rack";

/// The conditions in the order of the certificate. A file has those whose places it has.
const CONDITIONS: &[Stated] = &[
    Stated {
        name: SENSOR,
        description: "during the run",
        channel: Some("/conditions/sensor_channel"),
        numbers: &[
            ("lowest", "/conditions/sensor_degc/0", "degC"),
            ("mean", "/conditions/sensor_degc/1", "degC"),
            ("highest", "/conditions/sensor_degc/2", "degC"),
            ("highest minus lowest of the settings used", "/conditions/sensor_range_k", "K"),
            ("straight line through those of the settings used", "/conditions/sensor_rate_k_per_h", "K/h"),
        ],
    },
    Stated {
        name: SENSOR,
        description: "over all runs",
        channel: Some("/channel"),
        numbers: &[("lowest", "/valid_degc/0", "degC"), ("highest", "/valid_degc/1", "degC")],
    },
    Stated {
        name: COIL,
        description: "during the run",
        channel: Some("/conditions/coil_channel"),
        numbers: &[
            ("lowest", "/conditions/coil_degc/0", "degC"),
            ("mean", "/conditions/coil_degc/1", "degC"),
            ("highest", "/conditions/coil_degc/2", "degC"),
        ],
    },
    Stated {
        name: COIL,
        description: "over all calibrations",
        channel: None,
        numbers: &[("lowest", "/valid/coil_degc/0", "degC"), ("highest", "/valid/coil_degc/1", "degC")],
    },
    Stated {
        name: RACK,
        description: "over all calibrations",
        channel: None,
        numbers: &[("lowest", "/valid/rack_degc/0", "degC"), ("highest", "/valid/rack_degc/1", "degC")],
    },
    Stated {
        name: "applied field",
        description: "of the settings used, coil axes",
        channel: None,
        numbers: &[
            ("lowest X_c", "/valid/field_coil_nt/0/0", "nT"),
            ("highest X_c", "/valid/field_coil_nt/0/1", "nT"),
            ("lowest Y_c", "/valid/field_coil_nt/1/0", "nT"),
            ("highest Y_c", "/valid/field_coil_nt/1/1", "nT"),
            ("lowest Z_c", "/valid/field_coil_nt/2/0", "nT"),
            ("highest Z_c", "/valid/field_coil_nt/2/1", "nT"),
        ],
    },
    Stated {
        name: "modulus of the applied field",
        description: "of the settings used",
        channel: None,
        numbers: &[("lowest", "/valid/modulus_nt/0", "nT"), ("highest", "/valid/modulus_nt/1", "nT")],
    },
    Stated {
        name: "stability of the field",
        description: "standard deviation of the samples within a setting, sensor axes: field and sensor together",
        channel: None,
        numbers: &[
            ("mean x", "/quality/raw_std_ent/mean/0", "enT"),
            ("largest x", "/quality/raw_std_ent/max/0", "enT"),
            ("mean y", "/quality/raw_std_ent/mean/1", "enT"),
            ("largest y", "/quality/raw_std_ent/max/1", "enT"),
            ("mean z", "/quality/raw_std_ent/mean/2", "enT"),
            ("largest z", "/quality/raw_std_ent/max/2", "enT"),
        ],
    },
    Stated {
        name: "stability of the offset",
        description: "standard deviation of the mean of a setting in its position, sensor axes: field and sensor together",
        channel: None,
        numbers: &[
            ("x", "/quality/plateau_std_ent/0", "enT"),
            ("y", "/quality/plateau_std_ent/1", "enT"),
            ("z", "/quality/plateau_std_ent/2", "enT"),
        ],
    },
];

/// The element `influenceConditions` with a line end behind it. Nothing where the file states no condition: the schema allows none that is
/// empty.
pub(super) fn influence_conditions(source: &Source) -> String {
    let of_numbers = CONDITIONS.iter().filter_map(|one| numbers(source, one));
    let all: String = of_numbers.chain(mean_coil_temperatures(source)).chain(texts(source)).collect();
    if all.is_empty() { all } else { format!("<dcc:influenceConditions>\n{all}</dcc:influenceConditions>\n") }
}

fn condition(name: &str, description: &str, data: &str) -> String {
    let (name, description) = (named("name", name), named("description", description));
    format!("<dcc:influenceCondition>{name}{description}<dcc:data>{data}</dcc:data></dcc:influenceCondition>\n")
}

fn quantity(name: &str, value: f64, unit: &'static str) -> String {
    format!(
        "<dcc:quantity>{}<si:real><si:value>{value:?}</si:value><si:unit>{}</si:unit></si:real></dcc:quantity>",
        named("name", name),
        Unit::of(unit).d_si()
    )
}

fn numbers(source: &Source, stated: &Stated) -> Option<String> {
    let channel = match stated.channel {
        Some(place) => format!(", channel {}", source.text(place)?),
        None => String::new(),
    };
    let there = stated.numbers.iter().filter_map(|&(name, place, unit)| Some(quantity(name, source.number(place)?, unit)));
    let data: String = there.collect();
    (!data.is_empty()).then(|| condition(stated.name, &format!("{}{channel}", stated.description), &data))
}

/// The lowest and highest mean coil temperature of the runs of a file across temperatures; a run without one has nan there.
fn mean_coil_temperatures(source: &Source) -> Option<String> {
    let all = source.value.get("coil_temperature_degc")?.as_array()?.iter().filter_map(serde_json::Value::as_f64);
    let [low, high] = all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(t), high.max(t)]);
    let data = || quantity("lowest", low, "degC") + &quantity("highest", high, "degC");
    (low <= high).then(|| condition(COIL, "means of the runs", &data()))
}

/// Conditions that are words: what made the field, and how that of the earth was kept away.
fn texts(source: &Source) -> impl Iterator<Item = String> {
    let compensation = source.value.pointer("/run/earthfield_compensation").and_then(serde_json::Value::as_array);
    let per_axis: Vec<&str> = compensation.into_iter().flatten().filter_map(|v| v.as_str()).collect();
    let text = |text: &str| named("text", text);
    let field_source = source.text("/run/field_source").filter(|words| !words.is_empty());
    let field_source = field_source.map(|words| condition("source of the field", "of the coil system", &text(words)));
    let earth = (!per_axis.is_empty())
        .then(|| condition("compensation of the earth's field", "X_c, Y_c, Z_c", &text(&per_axis.join(", "))));
    field_source.into_iter().chain(earth)
}
