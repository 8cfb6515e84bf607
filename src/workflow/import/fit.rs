//! Whether readings and field are of one size, so that a wrong unit does not pass.

use super::run::Content;
use crate::data::error::{Finding, Severity};
use crate::data::run::{Header, Kind};
use std::collections::BTreeMap;

/// A sensor in engineering nanotesla reads the field within this factor; beyond, a person should look.
const LOOK: f64 = 3.0;
/// Beyond this the unit is wrong.
const WRONG: f64 = 30.0;
/// Fields and readings that change by less tell nothing, nT.
const LEAST_CHANGE_NT: f64 = 1.0;

/// Field and mean reading of a setting of a constant field.
struct Pair {
    position: u32,
    field: [f64; 3],
    reading: [f64; 3],
}

/// Compares how much readings and fields change, from setting to setting within a position.
///
/// # Errors
/// Readings that cannot be in the unit that is stated.
pub(super) fn check(file: &str, header: &Header, content: &Content, allowed: bool) -> Result<Option<Finding>, Finding> {
    let mut by_position: BTreeMap<u32, Vec<Pair>> = BTreeMap::new();
    for pair in pairs(content) {
        by_position.entry(pair.position).or_default().push(pair);
    }
    let (mut field_square, mut reading_square, mut count) = (0.0, 0.0, 0);
    for group in by_position.values().filter(|g| g.len() > 1) {
        for axis in 0..3 {
            let square = |value: fn(&Pair, usize) -> f64| {
                let mean = group.iter().map(|p| value(p, axis)).sum::<f64>() / group.len() as f64;
                group.iter().map(|p| (value(p, axis) - mean).powi(2)).sum::<f64>()
            };
            field_square += square(|p, axis| p.field[axis]);
            reading_square += square(|p, axis| p.reading[axis]);
        }
        count += group.len();
    }
    // A field of a wrong unit may seem to rest, while the readings do not.
    let changes = |square: f64| (square / count as f64).sqrt() >= LEAST_CHANGE_NT;
    let tells = count > 0 && field_square > 0.0 && (changes(field_square) || changes(reading_square));
    if header.kind == Kind::ZeroField || !tells {
        return Ok(None);
    }
    let ratio = (reading_square / field_square).sqrt();
    if (1.0 / LOOK..=LOOK).contains(&ratio) {
        return Ok(None);
    }
    let rule = format!("the readings change by {ratio:.3e} enT per nT of the field, and should by about 1");
    let remedy = match header.unit.ent_per_unit() {
        1.0 if (0.5e-3..2e-3).contains(&ratio) => {
            "the readings may be in uT, or the field in units of which `unit` under [field] makes too much".to_owned()
        }
        1.0 if (0.5e3..2e3).contains(&ratio) => {
            "the field may be in uT, or the readings in nT where `unit = \"uT\"` stands under [run]".to_owned()
        }
        1.0 => format!(
            "correct `unit` under [run] or [field]; as counts the readings would have nominal_factor = {:.6e}",
            1.0 / ratio
        ),
        factor => {
            format!(
                "correct `nominal_factor` under [run], which would fit as {:?}, or `unit` under [field]",
                short(factor / ratio)
            )
        }
    };
    let wrong = !(1.0 / WRONG..=WRONG).contains(&ratio);
    let finding = Finding::error(file, rule, remedy);
    if wrong && !allowed {
        let remedy = format!("{}; or go on with --allow mismatch", finding.remedy);
        return Err(Finding { remedy: remedy.into(), ..finding });
    }
    Ok(Some(finding.weighing(Severity::Warning)))
}

/// Four digits.
fn short(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// Settings of constant fields with their mean readings.
fn pairs(content: &Content) -> Vec<Pair> {
    let given = content.blocks.iter().map(|b| Pair { position: b.setting.position, field: b.setting.field.0, reading: b.mean.0 });
    let mut list: Vec<Pair> = given.collect();
    let mut vectors = content.vectors.iter().peekable();
    for setting in &content.settings {
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        while vectors.next_if(|v| v.t_s < setting.t_start_s).is_some() {}
        while let Some(vector) = vectors.next_if(|v| v.t_s < setting.t_end_s) {
            (0..3).for_each(|i| sum[i] += vector.reading.0[i]);
            count += 1.0;
        }
        if count > 0.0 && setting.frequency_hz == 0.0 {
            list.push(Pair { position: setting.position, field: setting.field.0, reading: sum.map(|s| s / count) });
        }
    }
    list
}
