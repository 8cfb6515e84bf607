//! What happens to runs: every damage changes a text, if it has what the damage is about.

use super::text::Text;

/// A damage.
pub struct Damage {
    pub name: &'static str,
    /// Changes the text; false if there is nothing to be changed.
    pub apply: fn(&mut Text) -> bool,
}

type Field = [f64; 3];

/// Changes the readings, which stand with the samples or with the means; `f` gets the part of the run that is over, 0 to 1.
fn readings(text: &mut Text, f: impl Fn(f64, usize, Field) -> Field) -> bool {
    for name in ["VECTORS", "BLOCKS"] {
        if let Some(section) = text.section(name) {
            let count = section.rows.len() as f64;
            return section.change(["x", "y", "z"], |i, r| f(i as f64 / count, i, r));
        }
    }
    false
}

/// The same for tables of amplitudes and moduli as well, which have no signs.
fn sizes(text: &mut Text, f: impl Fn(f64, usize) -> f64) -> bool {
    if let Some(section) = text.section("TABLE") {
        let count = section.rows.len() as f64;
        return section.change(["bx_ent", "by_ent", "bz_ent", "bx_std_ent", "by_std_ent", "bz_std_ent"], |i, b| {
            let factor = f(i as f64 / count, i);
            b.map(|v| factor * v)
        });
    }
    if let Some(section) = text.section("SCALAR") {
        let count = section.rows.len() as f64;
        return section.change(["f"], |i, [b]| [f(i as f64 / count, i) * b]);
    }
    readings(text, |part, i, r| r.map(|v| f(part, i) * v))
}

/// Changes the settings that are not all zero.
fn settings(text: &mut Text, f: impl Fn(usize, Field) -> Field) -> bool {
    ["FIELDS", "BLOCKS", "SCALAR"].into_iter().any(|name| {
        let Some(section) = text.section(name) else { return false };
        let Some(x) = section.place("bx") else { return false };
        let is_driven = section.rows.iter().any(|row| row[x..x + 3].iter().any(|v| v.parse().is_ok_and(|v: f64| v != 0.0)));
        is_driven && section.change(["bx", "by", "bz"], &f)
    })
}

/// Moves the cells of some columns by rows.
fn roll(text: &mut Text, columns: &[&str], rows: usize) -> bool {
    ["FIELDS", "BLOCKS", "SCALAR"].into_iter().any(|name| {
        let Some(section) = text.section(name).filter(|s| s.rows.len() > rows) else { return false };
        let places: Vec<usize> = columns.iter().filter_map(|c| section.place(c)).collect();
        let before = section.rows.clone();
        let count = before.len();
        for (i, row) in section.rows.iter_mut().enumerate() {
            places.iter().for_each(|p| row[*p].clone_from(&before[(i + rows) % count][*p]));
        }
        !places.is_empty()
    })
}

/// Changes all temperatures of a channel.
fn temperature(text: &mut Text, channel: &str, f: impl Fn(f64, f64) -> f64) -> bool {
    let Some(section) = text.section("TEMPERATURES") else { return false };
    let count = section.rows.len() as f64;
    section.change([channel], |i, [v]| [f(i as f64 / count, v)])
}

/// Keeps some of the samples; counted ones keep their numbers and times.
fn keep(text: &mut Text, is_counted: bool, kept: impl Fn(usize, f64) -> bool) -> bool {
    let Some(section) = text.section("VECTORS") else { return false };
    let count = section.rows.len();
    let before = section.rows.clone();
    let mut index = 0;
    section.rows.retain(|_| {
        index += 1;
        kept(index - 1, (index - 1) as f64 / count as f64)
    });
    if !is_counted {
        // The recorder numbers what it has, and the clock is made from the numbers.
        for (row, old) in section.rows.iter_mut().zip(before) {
            row[..2].clone_from_slice(&old[..2]);
        }
    }
    true
}

/// Changes one frequency.
fn frequency(text: &mut Text, f: impl Fn(f64) -> f64) -> bool {
    let name = if text.section("TABLE").is_some() { ("TABLE", "frequency_hz") } else { ("FIELDS", "frequency") };
    let Some(section) = text.section(name.0) else { return false };
    let Some(place) = section.place(name.1) else { return false };
    let middle = section.rows.len() / 2;
    let old: f64 = section.rows[middle][place].parse().unwrap_or(0.0);
    section.rows[middle][place] = f(old).to_string();
    old > 0.0
}

fn times(text: &mut Text, by_s: f64) -> bool {
    let mut changed = false;
    if text.section("VECTORS").is_some() && text.section("FIELDS").is_some_and(|s| s.rows.len() > 1) {
        changed = text.section("FIELDS").is_some_and(|s| s.change(["t_start", "t_end"], |_, t| t.map(|t| t + by_s)));
    }
    changed
}

/// Fifty places of a run of `count` samples.
fn is_one_of_fifty(part: f64, i: usize, count: f64) -> bool {
    let _ = part;
    i % ((count / 50.0) as usize).max(1) == 7
}

const fn damage(name: &'static str, apply: fn(&mut Text) -> bool) -> Damage {
    Damage { name, apply }
}

/// All of them.
pub const ALL: [Damage; 52] = [
    damage("readings x 1000", |t| sizes(t, |_, _| 1000.0)),
    damage("readings / 1000", |t| sizes(t, |_, _| 1e-3)),
    damage("readings x 10", |t| sizes(t, |_, _| 10.0)),
    damage("readings x 2", |t| sizes(t, |_, _| 2.0)),
    damage("readings / 2", |t| sizes(t, |_, _| 0.5)),
    damage("readings of x x 2", |t| readings(t, |_, _, [x, y, z]| [2.0 * x, y, z])),
    damage("x reversed", |t| readings(t, |_, _, [x, y, z]| [-x, y, z])),
    damage("all axes reversed", |t| readings(t, |_, _, r| r.map(|v| -v))),
    damage("x and y exchanged", |t| readings(t, |_, _, [x, y, z]| [y, x, z])),
    damage("y and z exchanged", |t| readings(t, |_, _, [x, y, z]| [x, z, y])),
    damage("x, y, z turned round", |t| readings(t, |_, _, [x, y, z]| [y, z, x])),
    damage("x stuck", |t| readings(t, |_, _, [_, y, z]| [123.4, y, z])),
    damage("z stuck from the middle on", |t| readings(t, |part, _, [x, y, z]| [x, y, if part < 0.5 { z } else { 12.5 }])),
    damage("x cut off at 60 % of its range", |t| {
        let most = std::cell::Cell::new(0.0f64);
        readings(t, |_, _, r| {
            most.set(most.get().max(r[0].abs()));
            r
        });
        let limit = 0.6 * most.get();
        readings(t, |_, _, [x, y, z]| [x.clamp(-limit, limit), y, z])
    }),
    damage("one reading of 1e29", |t| readings(t, |_, i, [x, y, z]| [if i == 777 { 1e29 } else { x }, y, z])),
    damage("one mean of 1e29", |t| {
        t.section("BLOCKS").is_some() && readings(t, |_, i, [x, y, z]| [if i == 17 { 1e29 } else { x }, y, z])
    }),
    damage("one spike of 100 nT", |t| readings(t, |_, i, [x, y, z]| [x, if i == 1501 { y + 100.0 } else { y }, z])),
    damage("50 spikes of 5000 nT", |t| {
        let count = t.section("VECTORS").map_or(0.0, |s| s.rows.len() as f64);
        readings(t, |part, i, [x, y, z]| [x, y, if is_one_of_fifty(part, i, count) { z + 5000.0 } else { z }])
    }),
    damage("a spike of three samples", |t| readings(t, |_, i, r| if (901..904).contains(&i) { r.map(|v| v + 800.0) } else { r })),
    damage("first reading of 1e6", |t| readings(t, |_, i, [x, y, z]| [if i == 0 { 1e6 } else { x }, y, z])),
    damage("10 % lost, counted", |t| keep(t, true, |i, _| i / 16 % 10 != 3)),
    damage("10 % lost, not counted", |t| keep(t, false, |i, _| i / 16 % 10 != 3)),
    damage("a fifth lost in one gap", |t| keep(t, true, |_, part| !(0.4..0.6).contains(&part))),
    damage("last third lost", |t| keep(t, true, |_, part| part < 0.67)),
    damage("gain + 0.1 % from 45 % on", |t| sizes(t, |part, _| if part < 0.45 { 1.0 } else { 1.001 })),
    damage("gain + 2 % from 45 % on", |t| sizes(t, |part, _| if part < 0.45 { 1.0 } else { 1.02 })),
    damage("gain of y + 0.5 % from the middle on", |t| {
        readings(t, |part, _, [x, y, z]| [x, if part < 0.5 { y } else { 1.005 * y }, z])
    }),
    damage("offset + 20 nT from 45 % on", |t| readings(t, |part, _, r| r.map(|v| if part < 0.45 { v } else { v + 20.0 }))),
    damage("readings rounded to 10 nT", |t| readings(t, |_, _, r| r.map(|v| (v / 10.0).round() * 10.0))),
    damage("settings x 1000", |t| settings(t, |_, b| b.map(|v| 1000.0 * v))),
    damage("settings / 1000", |t| settings(t, |_, b| b.map(|v| v / 1000.0))),
    damage("settings x 10", |t| settings(t, |_, b| b.map(|v| 10.0 * v))),
    damage("settings x 2", |t| settings(t, |_, b| b.map(|v| 2.0 * v))),
    damage("settings of X reversed", |t| settings(t, |_, [x, y, z]| [-x, y, z])),
    damage("all settings reversed", |t| settings(t, |_, b| b.map(|v| -v))),
    damage("settings of X and Y exchanged", |t| settings(t, |_, [x, y, z]| [y, x, z])),
    damage("settings a row later", |t| roll(t, &["bx", "by", "bz", "frequency"], 1)),
    damage("settings of another run", |t| roll(t, &["bx", "by", "bz", "frequency"], 11)),
    damage("one setting reversed", |t| settings(t, |i, b| if i == 9 { b.map(|v| -v) } else { b })),
    damage("settings 0.6 s late", |t| times(t, 0.6)),
    damage("settings 3 s late", |t| times(t, 3.0)),
    damage("positions a row later", |t| {
        let several =
            t.section("FIELDS").is_some_and(|s| s.place("position").is_some_and(|p| s.rows.iter().any(|r| r[p] != s.rows[0][p])));
        several && roll(t, &["position"], 8)
    }),
    damage("one frequency + 1 %", |t| frequency(t, |f| 1.01 * f)),
    damage("one frequency x 1000", |t| frequency(t, |f| 1000.0 * f)),
    damage("one frequency of 99999999 Hz", |t| frequency(t, |_| 99_999_999.0)),
    damage("sensor temperature jumps by 68 K", |t| temperature(t, "T59", |part, v| if part < 0.5 { v } else { v + 68.0 })),
    damage("sensor temperature stuck", |t| temperature(t, "T59", |_, _| 21.37)),
    damage("temperatures in kelvin", |t| temperature(t, "T59", |_, v| v + 273.15) && temperature(t, "T29", |_, v| v + 273.15)),
    damage("temperatures in Fahrenheit", |t| {
        temperature(t, "T59", |_, v| 1.8 * v + 32.0) && temperature(t, "T29", |_, v| 1.8 * v + 32.0)
    }),
    damage("temperature of -300", |t| temperature(t, "T59", |_, _| -300.0)),
    damage("two temperatures, 17 and 85", |t| {
        let Some(section) = t.section("TEMPERATURES") else { return false };
        let (Some(first), Some(last)) = (section.rows.first().cloned(), section.rows.last().cloned()) else { return false };
        section.rows = vec![first, last];
        temperature(t, "T59", |part, _| if part < 0.5 { 17.0 } else { 85.0 })
    }),
    damage("channels of sensor and coil exchanged", |t| {
        let Some(section) = t.section("TEMPERATURES") else { return false };
        section.change(["T59", "T29"], |_, [a, b]| [b, a])
    }),
];
