//! Which columns are readings, applied field, temperatures and the rest.

use super::{Contents, Numeric};
use crate::data::error::Finding;
use crate::files::import::mapping::TemperatureUnit;
use crate::fit::statistics::median;

/// Three columns of x, y, z.
#[derive(Clone, Debug)]
pub(super) struct Triple {
    pub names: [String; 3],
    /// Indices of the columns of numbers.
    at: [usize; 3],
    /// Part of the rows that repeat the row above.
    pub still: f64,
}

/// Unit of a triple.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    NanoTesla,
    MicroTesla,
    /// enT per count.
    Counts(f64),
    /// nT per ampere.
    Ampere([f64; 3]),
}

/// A temperature.
#[derive(Clone, Debug)]
pub(super) struct Temperature {
    /// Name of the channel.
    pub channel: String,
    pub column: String,
    pub unit: TemperatureUnit,
    /// Whether the name of the column tells the unit.
    pub unit_named: bool,
    /// The middle value, in that unit.
    pub middle: f64,
}

/// What the columns are.
#[derive(Clone, Debug)]
pub(super) struct Roles {
    pub reading: Triple,
    pub reading_unit: Unit,
    pub field: Option<Triple>,
    pub field_unit: Unit,
    /// Whether units stand in the names of the columns.
    pub unit_named: bool,
    /// Change of the readings over change of the field, as they stand in the table, and the part of the readings that the field explains.
    pub ratio: Option<(f64, f64)>,
    pub std: Option<Triple>,
    pub count: Option<String>,
    pub counter: Option<String>,
    pub position: Option<String>,
    pub positions: usize,
    pub frequency: Option<String>,
    pub temperatures: Vec<Temperature>,
    pub channels: Vec<(String, String)>,
    pub plateaus: bool,
    /// Usual step of the times, s.
    pub step_s: f64,
    /// Pauses that part runs: how many, and a time shorter than the shortest of them, s.
    pub pauses: Option<(usize, f64)>,
    pub field_is_zero: bool,
}

/// Whether a name is one of times.
pub(super) fn is_time_name(name: &str) -> bool {
    let name = name.to_lowercase();
    let words =
        ["time", "zeit", "epoch", "timestamp", "date", "datum", "utc", "seconds", "sec", "unix", "t", "t_s", "t [s]", "t (s)"];
    words.iter().any(|w| name == *w) || ["time", "zeit", "epoch", "datum"].iter().any(|w| name.contains(w))
}

/// Finds them.
///
/// # Errors
/// No three columns that could be readings.
pub(super) fn found(contents: &Contents) -> Result<Roles, Finding> {
    let mut triples = triples(&contents.numbers);
    let std = take(&mut triples, |t| is_std(t, &contents.numbers) && contents.numbers.len() > 6);
    let best = triples
        .iter()
        .enumerate()
        .max_by(|(_, a), (_, b)| field_score(a).total_cmp(&field_score(b)).then(std::cmp::Ordering::Greater))
        .map(|(i, _)| i);
    let field = if triples.len() > 1 { best.map(|i| triples.remove(i)) } else { None };
    let score = |t: &Triple| field.as_ref().map_or(0.0, |f| explained(&contents.numbers, f, t).map_or(0.0, |(_, part)| part));
    let Some(reading) = triples.into_iter().max_by(|a, b| score(a).total_cmp(&score(b)).then(std::cmp::Ordering::Greater)) else {
        let names: Vec<&str> = contents.numbers.iter().map(|n| n.name.as_str()).collect();
        let rule = format!(
            "no three columns were found whose names differ by x, y, z or 1, 2, 3; columns of numbers are {}",
            names.join(", ")
        );
        return Err(Finding::error(
            &contents.file,
            rule,
            "rename the columns of readings and field, or write the mapping by hand (`docs/import.md`)",
        ));
    };
    let ratio = field.as_ref().and_then(|f| explained(&contents.numbers, f, &reading));
    let mut steps: Vec<f64> = contents.time.ns.windows(2).map(|w| (w[1] - w[0]) as f64 / 1e9).collect();
    let pauses = pauses(&steps);
    let step_s = median(&mut steps);
    let plateaus = field.as_ref().is_some_and(|f| f.still < 0.5);
    let mut rest: Vec<&Numeric> = contents.numbers.iter().collect();
    for triple in [Some(&reading), field.as_ref(), std.as_ref()].into_iter().flatten() {
        rest.retain(|n| !triple.names.contains(&n.name));
    }
    let mut named = |wanted: &dyn Fn(&Numeric) -> bool| {
        let at = rest.iter().position(|n| wanted(n))?;
        Some(rest.remove(at))
    };
    let position = named(&|n| ["position", "pos", "position_id"].contains(&n.name.to_lowercase().as_str()) && is_whole(n));
    let frequency = named(&|n| {
        let name = n.name.to_lowercase();
        (name.starts_with("freq") || name == "f_hz") && n.values.iter().all(|v| v.is_nan() || *v >= 0.0)
    });
    let count = if std.is_some() { named(&|n| is_counter_name(&n.name) && is_whole(n)) } else { None };
    let counter = if plateaus { None } else { named(&|n| is_counter_name(&n.name) && is_counter(n)) };
    let temperatures = temperatures(&mut rest);
    let mut channels: Vec<(String, String)> = Vec::new();
    for column in &rest {
        let free = free_name(channel_name(&column.name), |name| channels.iter().any(|(c, _)| c == name));
        channels.push((free, column.name.clone()));
    }
    let (reading_unit, field_unit, unit_named) = units(&contents.numbers, &reading, field.as_ref(), ratio.map(|(r, _)| r));
    let field_is_zero =
        field.as_ref().is_some_and(|f| f.at.iter().all(|i| contents.numbers[*i].values.iter().all(|v| v.is_nan() || *v == 0.0)));
    let positions = position.map_or(1, |p| {
        let mut ids: Vec<f64> = p.values.clone();
        ids.sort_by(f64::total_cmp);
        ids.dedup();
        ids.len()
    });
    let name = |n: Option<&Numeric>| n.map(|n| n.name.clone());
    Ok(Roles {
        reading,
        reading_unit,
        field,
        field_unit,
        unit_named,
        ratio,
        std,
        count: name(count),
        counter: name(counter),
        position: name(position),
        positions,
        frequency: name(frequency),
        temperatures,
        channels,
        plateaus,
        step_s,
        pauses,
        field_is_zero,
    })
}

/// Steps of the times so long that something else was done meanwhile, with enough rows between them for runs of their own.
fn pauses(steps: &[f64]) -> Option<(usize, f64)> {
    /// No shorter pause parts runs, s: positions and temperatures take longer to change.
    const SHORTEST_S: f64 = 300.0;
    /// Nor one of fewer usual steps.
    const STEPS: f64 = 20.0;
    /// Rows of a run.
    const LEAST_ROWS: usize = 12;
    let usual = median(&mut steps.to_vec());
    let long: Vec<usize> = (0..steps.len()).filter(|i| steps[*i] > SHORTEST_S.max(STEPS * usual)).collect();
    let edges: Vec<usize> = std::iter::once(0).chain(long.iter().map(|i| i + 1)).chain([steps.len() + 1]).collect();
    let shortest = long.iter().map(|i| steps[*i]).fold(f64::INFINITY, f64::min);
    let apart = !long.is_empty() && edges.windows(2).all(|w| w[1] - w[0] >= LEAST_ROWS);
    // Half of the shortest, in two digits.
    apart.then(|| (long.len(), format!("{:.1e}", 0.5 * shortest).parse().unwrap_or(SHORTEST_S)))
}

fn take(triples: &mut Vec<Triple>, wanted: impl Fn(&Triple) -> bool) -> Option<Triple> {
    let at = triples.iter().position(wanted)?;
    Some(triples.remove(at))
}

/// Columns whose names differ in one letter, x y z, or one digit, 1 2 3. Letters go before digits.
fn triples(numbers: &[Numeric]) -> Vec<Triple> {
    let mut list: Vec<Triple> = Vec::new();
    for letters in [["x", "y", "z"], ["X", "Y", "Z"], ["1", "2", "3"]] {
        for (i, column) in numbers.iter().enumerate() {
            for (at, _) in column.name.match_indices(letters[0]) {
                let other = |letter: &str| {
                    let name = format!("{}{letter}{}", &column.name[..at], &column.name[at + 1..]);
                    numbers.iter().position(|n| n.name == name)
                };
                let (Some(j), Some(k)) = (other(letters[1]), other(letters[2])) else { continue };
                if list.iter().any(|t| [i, j, k].iter().any(|c| t.at.contains(c))) || is_temperature_name(&column.name) {
                    continue;
                }
                let values = [i, j, k].map(|c| &numbers[c].values);
                let rows = values[0].len();
                let same = |row: &usize| {
                    values.iter().all(|v| (v[*row] - v[row - 1]).abs() < 1e-9 || (v[*row].is_nan() && v[row - 1].is_nan()))
                };
                let still = (1..rows).filter(same).count() as f64 / (rows.max(2) - 1) as f64;
                list.push(Triple { names: [i, j, k].map(|c| numbers[c].name.clone()), at: [i, j, k], still });
            }
        }
    }
    list.sort_by_key(|t| t.at[0]);
    list
}

/// How much a triple looks like the applied field: it rests during a setting, and its name says so.
fn field_score(triple: &Triple) -> f64 {
    let name = triple.names[0].to_lowercase();
    let has = |words: &[&str]| words.iter().any(|w| name.contains(w));
    let mut score = 4.0 * f64::from(u8::from(triple.still > 0.5)) + triple.still;
    if has(&["ref", "field", "feld", "set", "soll", "coil", "spule", "appl", "cmd", "nominal", "true"]) || name.starts_with("i_")
    {
        score += 2.0;
    } else if has(&["meas", "mess", "raw", "out", "sens", "fgm", "adc", "count", "mag", "read"]) || name.starts_with('m') {
        score -= 2.0;
    } else if name.starts_with('b') {
        score += 1.0;
    }
    score
}

/// Standard deviations: never negative, small against the others, or named so.
fn is_std(triple: &Triple, numbers: &[Numeric]) -> bool {
    let name = triple.names[0].to_lowercase();
    let named =
        ["std", "sd", "sigma", "stdev", "err", "rms"].iter().any(|w| name.contains(w)) || name.starts_with("s_") || name == "sx";
    named && triple.at.iter().all(|i| numbers[*i].values.iter().all(|v| v.is_nan() || *v >= 0.0))
}

fn is_counter_name(name: &str) -> bool {
    let name = name.to_lowercase();
    ["n", "no", "nr", "count", "counter", "cnt", "sample", "samples", "index", "seq", "i", "zaehler", "zähler"]
        .contains(&name.as_str())
}

fn is_whole(column: &Numeric) -> bool {
    column.values.iter().all(|v| *v >= 0.0 && v.fract() == 0.0 && *v < 1e15)
}

/// Whole numbers that go on by one, but for losses.
fn is_counter(column: &Numeric) -> bool {
    let ones = column.values.windows(2).filter(|w| w[1] - w[0] == 1.0).count();
    is_whole(column) && column.values.windows(2).all(|w| w[1] >= w[0]) && ones * 10 > column.values.len() * 9
}

/// Rms change of the readings over that of the field, and the part of the square of the readings that the field explains, each reading by
/// the field component that goes with it best.
fn explained(numbers: &[Numeric], field: &Triple, reading: &Triple) -> Option<(f64, f64)> {
    let columns = |t: &Triple| t.at.map(|i| &numbers[i].values);
    let (b, m) = (columns(field), columns(reading));
    let rows: Vec<usize> = (0..b[0].len()).filter(|r| b.iter().chain(&m).all(|c| c[*r].is_finite())).collect();
    if rows.len() < 4 {
        return None;
    }
    let mean = |c: &[f64]| rows.iter().map(|r| c[*r]).sum::<f64>() / rows.len() as f64;
    let (mean_b, mean_m) = (b.map(|c| mean(c)), m.map(|c| mean(c)));
    let product = |p: &[f64], mp: f64, q: &[f64], mq: f64| rows.iter().map(|r| (p[*r] - mp) * (q[*r] - mq)).sum::<f64>();
    let square_b: f64 = (0..3).map(|i| product(b[i], mean_b[i], b[i], mean_b[i])).sum();
    let mut square_m = 0.0;
    let mut part = 0.0;
    for i in 0..3 {
        let own = product(m[i], mean_m[i], m[i], mean_m[i]);
        square_m += own;
        let best = (0..3)
            .map(|j| {
                product(m[i], mean_m[i], b[j], mean_b[j]).powi(2)
                    / product(b[j], mean_b[j], b[j], mean_b[j]).max(f64::MIN_POSITIVE)
            })
            .fold(0.0, f64::max);
        part += best;
    }
    (square_b > 0.0 && square_m > 0.0).then(|| ((square_m / square_b).sqrt(), part / square_m))
}

/// The unit that a name states.
fn named_unit(name: &str) -> Option<Unit> {
    let words: Vec<&str> = name.split(|c: char| !(c.is_alphanumeric() || c == 'µ' || c == 'μ')).collect();
    let has = |list: &[&str]| words.iter().any(|w| list.contains(w));
    if has(&["uT", "µT", "μT", "ut"]) {
        Some(Unit::MicroTesla)
    } else if has(&["nT", "nt", "NT", "enT"]) {
        Some(Unit::NanoTesla)
    } else if has(&["A", "i", "I", "current"]) {
        Some(Unit::Ampere([0.0; 3]))
    } else if has(&["counts", "count", "adc", "lsb", "ADC", "LSB"]) {
        Some(Unit::Counts(0.0))
    } else {
        None
    }
}

/// Units of readings and field, and whether the names state them: otherwise the field is nT, or µT where that fits the readings.
fn units(numbers: &[Numeric], reading: &Triple, field: Option<&Triple>, ratio: Option<f64>) -> (Unit, Unit, bool) {
    let (of_reading, of_field) = (named_unit(&reading.names[0]), field.and_then(|f| named_unit(&f.names[0])));
    let near = |value: f64, to: f64| (0.3..3.0).contains(&(value / to));
    let field_unit = match (of_field, ratio) {
        (Some(Unit::Ampere(_)), Some(ratio)) => Unit::Ampere([round(ratio); 3]),
        (Some(Unit::Counts(_)), _) | (None, None) => Unit::NanoTesla,
        (Some(unit), _) => unit,
        (None, Some(ratio)) => {
            let largest =
                field.map_or(0.0, |f| f.at.iter().flat_map(|i| &numbers[*i].values).fold(0.0, |m: f64, v| m.max(v.abs())));
            if largest <= 100.0 && near(ratio, 1000.0) && of_reading != Some(Unit::MicroTesla) {
                Unit::MicroTesla
            } else {
                Unit::NanoTesla
            }
        }
    };
    let field_nt = if field_unit == Unit::MicroTesla { 1000.0 } else { 1.0 };
    let reading_unit = match (of_reading, ratio) {
        (Some(Unit::NanoTesla | Unit::MicroTesla), _) | (_, None) => {
            of_reading.filter(|u| !matches!(u, Unit::Counts(_) | Unit::Ampere(_))).unwrap_or(Unit::NanoTesla)
        }
        (Some(Unit::Counts(_)), Some(ratio)) => Unit::Counts(round(field_nt / ratio)),
        (_, Some(_)) if matches!(field_unit, Unit::Ampere(_)) => Unit::NanoTesla,
        (_, Some(ratio)) if near(ratio * 1000.0, field_nt) => Unit::MicroTesla,
        (_, Some(ratio)) if near(ratio, field_nt) => Unit::NanoTesla,
        (_, Some(ratio)) => Unit::Counts(round(field_nt / ratio)),
    };
    (reading_unit, field_unit, of_reading.is_some() && (of_field.is_some() || field.is_none()))
}

/// Three digits.
fn round(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

fn is_temperature_name(name: &str) -> bool {
    let lower = name.to_lowercase();
    let words = ["temp", "degc", "°c", "pt100", "thermist", "kelvin"];
    let numbered = lower.strip_prefix('t').is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()));
    // "T [K]"
    let alone = name_words(&lower).first() == Some(&"t") && named_temperature_unit(name).is_some();
    words.iter().any(|w| lower.contains(w)) || numbered || lower.starts_with("t_") || alone
}

/// The words of a name.
fn name_words(name: &str) -> Vec<&str> {
    name.split(|c: char| !(c.is_alphanumeric() || c == '°')).filter(|word| !word.is_empty()).collect()
}

/// The unit that the name of a temperature states.
fn named_temperature_unit(name: &str) -> Option<TemperatureUnit> {
    let last = name_words(name).last().copied()?.to_lowercase();
    match last.as_str() {
        "k" | "kelvin" => Some(TemperatureUnit::Kelvin),
        "f" | "°f" | "degf" | "fahrenheit" => Some(TemperatureUnit::Fahrenheit),
        "c" | "°c" | "degc" | "celsius" => Some(TemperatureUnit::Celsius),
        _ => None,
    }
}

fn temperatures(rest: &mut Vec<&Numeric>) -> Vec<Temperature> {
    let mut list: Vec<Temperature> = Vec::new();
    rest.retain(|column| {
        let middle = median(&mut column.values.iter().copied().filter(|v| v.is_finite()).collect::<Vec<f64>>());
        if !is_temperature_name(&column.name) || !(-200.0..450.0).contains(&middle) {
            return true;
        }
        let named = named_temperature_unit(&column.name);
        let by_size = if middle > 200.0 { TemperatureUnit::Kelvin } else { TemperatureUnit::Celsius };
        // No sensor is at 200 °C, whatever the name says.
        let stated = named.filter(|unit| *unit != TemperatureUnit::Celsius || by_size == TemperatureUnit::Celsius);
        let (unit, unit_named) = (stated.unwrap_or(by_size), stated.is_some());
        list.push(Temperature { channel: String::new(), column: column.name.clone(), unit, unit_named, middle });
        false
    });
    let alone = list.len() == 1;
    let mut taken: Vec<String> = Vec::new();
    for temperature in &mut list {
        let lower = temperature.column.to_lowercase();
        let has = |words: &[&str]| words.iter().any(|w| lower.contains(w));
        let own = channel_name(&temperature.column);
        let wanted = if own.strip_prefix('T').is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit())) {
            own.clone()
        } else if has(&["coil", "spule"]) {
            "T29".to_owned()
        } else if alone || has(&["sens", "fgm", "probe", "dut", "head"]) {
            "T59".to_owned()
        } else {
            own.clone()
        };
        let wanted = if taken.contains(&wanted) { own } else { wanted };
        temperature.channel = free_name(wanted, |name| taken.iter().any(|t| t == name));
        taken.push(temperature.channel.clone());
    }
    list
}

/// A name that is not taken.
fn free_name(name: String, taken: impl Fn(&str) -> bool) -> String {
    let numbered = (2..).map(|i: u32| format!("{name}_{i}"));
    std::iter::once(name.clone()).chain(numbered).find(|n| !taken(n)).unwrap_or(name)
}

/// A name that a channel can have.
fn channel_name(column: &str) -> String {
    let letters = column.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' });
    let name: String = letters.collect::<String>().trim_matches('_').to_owned();
    match name.as_str() {
        "" | "T" => format!("CHANNEL_{name}"),
        _ => name,
    }
}
