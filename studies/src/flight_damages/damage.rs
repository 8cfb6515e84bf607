//! What happens to flight inputs: every damage changes the tables, the bytes or the configuration of a kind of input, if it has what the damage
//! is about.

use super::Kind;
use super::table::{Table, Values};

/// The inputs of a kind, in the order of their days.
#[derive(Clone)]
pub struct Inputs {
    pub kind: Kind,
    pub tables: Vec<Table>,
    /// The same tables of the other sensor.
    pub others: Vec<Table>,
    /// Text of `flight.toml`.
    pub configuration: String,
    /// What happens to the bytes of the files, once they are written.
    pub bytes: Option<fn(Vec<u8>) -> Vec<u8>>,
    /// The files are not there.
    pub gone: bool,
}

/// A damage.
pub struct Damage {
    pub name: &'static str,
    /// Changes the inputs; false if there is nothing to be changed.
    pub apply: fn(&mut Inputs) -> bool,
}

const SECOND: i64 = 1_000_000_000;
const AXES: [&str; 3] = ["bx", "by", "bz"];

impl Inputs {
    /// The columns that such tables are about.
    fn main(&self) -> &'static [&'static str] {
        match self.kind {
            Kind::Science | Kind::Csv => &AXES,
            Kind::Housekeeping => &["pos_voltage"],
            Kind::Attitude => &["q0", "q1", "q2", "q3"],
            Kind::Wheels => &["w1_hz", "w2_hz", "w3_hz", "w4_hz"],
            Kind::Heaters | Kind::Configuration => &[],
        }
    }

    fn each(&mut self, change: impl Fn(&mut Table) -> bool) -> bool {
        self.kind != Kind::Configuration && self.tables.iter_mut().filter_map(|table| change(table).then_some(())).count() > 0
    }

    /// The last table, which is that of the second day where there is one for each.
    fn last(&mut self, change: impl Fn(&mut Table) -> bool) -> bool {
        self.kind != Kind::Configuration && self.tables.last_mut().is_some_and(change)
    }

    /// The numbers of the first main column, with the part of the table that is over, 0 to 1.
    fn first_column(&mut self, change: impl Fn(f64, usize, f64) -> f64) -> bool {
        let Some(name) = self.main().first() else { return false };
        self.each(|table| {
            let count = table.rows() as f64;
            table.change(name, |row, value| change(row as f64 / count, row, value))
        })
    }

    fn in_last(&mut self, name: &str, change: impl Fn(usize, f64) -> f64) -> bool {
        self.last(|table| table.change(name, &change))
    }

    fn science(&self) -> bool {
        matches!(self.kind, Kind::Science | Kind::Csv)
    }

    fn edit(&mut self, from: &str, to: &str) -> bool {
        let is_there = self.kind == Kind::Configuration && self.configuration.contains(from);
        self.configuration = if is_there { self.configuration.replacen(from, to, 1) } else { self.configuration.clone() };
        is_there
    }

    fn edit_all(&mut self, from: &str, to: &str) -> bool {
        let is_there = self.kind == Kind::Configuration && self.configuration.contains(from);
        self.configuration = if is_there { self.configuration.replace(from, to) } else { self.configuration.clone() };
        is_there
    }

    fn set_bytes(&mut self, change: fn(Vec<u8>) -> Vec<u8>) -> bool {
        self.bytes = Some(change);
        self.kind != Kind::Configuration
    }

    fn csv_bytes(&mut self, change: fn(Vec<u8>) -> Vec<u8>) -> bool {
        self.kind == Kind::Csv && self.set_bytes(change)
    }
}

/// The times of a table, those of intervals too: TT2000 and ns since 1970, and the clock in s.
fn times(table: &mut Table, all: bool, change: impl Fn(i64) -> i64) -> bool {
    let mut any = false;
    for (name, values) in &mut table.columns {
        let is_first = name.ends_with("tt2000");
        if !all && !is_first {
            continue;
        }
        match values {
            Values::Whole(list) if is_first => list.iter_mut().for_each(|time| *time = change(*time)),
            Values::Utc(list) => list.iter_mut().for_each(|time| *time = change(*time)),
            Values::Numbers(list) if name == "time_obt" => {
                list.iter_mut().for_each(|s| *s = change((*s * SECOND as f64).round() as i64) as f64 / SECOND as f64);
            }
            _ => continue,
        }
        any = true;
    }
    any
}

/// One column of times alone, of which nothing else can tell that it is wrong.
fn alone(table: &mut Table) {
    table.columns.retain(|(name, _)| !["time_utc", "time_obt", "from", "to"].contains(&name.as_str()));
}

fn moved(inputs: &mut Inputs, by_s: i64) -> bool {
    inputs.each(|table| {
        alone(table);
        times(table, true, |time| time + by_s * SECOND)
    })
}

fn without_rows(inputs: &mut Inputs, is_lost: impl Fn(f64) -> bool) -> bool {
    inputs.each(|table| {
        let count = table.rows();
        let rows: Vec<usize> = (0..count).filter(|row| !is_lost(*row as f64 / count as f64)).collect();
        table.pick(&rows);
        true
    })
}

fn lines(bytes: Vec<u8>, change: impl Fn(&mut Vec<String>)) -> Vec<u8> {
    let mut lines: Vec<String> = String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect();
    change(&mut lines);
    (lines.join("\n") + "\n").into_bytes()
}

macro_rules! damage {
    ($name:literal, $apply:expr) => {
        Damage { name: $name, apply: $apply }
    };
}

/// All damages.
pub const ALL: &[Damage] = &[
    // The files.
    damage!("no file", |i| {
        i.gone = true;
        i.kind != Kind::Configuration
    }),
    damage!("no rows", |i| i.each(|table| {
        table.pick(&[]);
        true
    })),
    damage!("cut in the middle", |i| i.set_bytes(|bytes| bytes[..bytes.len() / 2].to_vec())),
    damage!("200 bytes of zeros inside", |i| i.set_bytes(|mut bytes| {
        let middle = bytes.len() / 2;
        bytes.iter_mut().skip(middle).take(200).for_each(|byte| *byte = 0);
        bytes
    })),
    damage!("cut within the last number", |i| i.csv_bytes(|bytes| bytes[..bytes.len() - 4].to_vec())),
    damage!("with semicolons", |i| i
        .csv_bytes(|bytes| bytes.into_iter().map(|byte| if byte == b',' { b';' } else { byte }).collect())),
    damage!("without header", |i| i.csv_bytes(|bytes| lines(bytes, |lines| drop(lines.remove(0))))),
    damage!("header once more inside", |i| i.csv_bytes(|bytes| lines(bytes, |lines| {
        let head = lines[0].clone();
        lines.insert(lines.len() / 2, head);
    }))),
    damage!("a cell too many", |i| i.csv_bytes(|bytes| lines(bytes, |lines| {
        let middle = lines.len() / 2;
        lines[middle].push_str(",17");
    }))),
    // Rows.
    damage!("rows in another order", |i| i.each(|table| {
        let count = table.rows();
        table.pick(&(0..count).map(|row| row * 7919 % count).collect::<Vec<_>>());
        // 7919 is a prime, so that every row comes once.
        count % 7919 != 0
    })),
    damage!("all rows twice", |i| i.each(|table| {
        let rows: Vec<usize> = (0..table.rows()).flat_map(|row| [row, row]).collect();
        table.pick(&rows);
        true
    })),
    damage!("a tenth of the rows lost at once", |i| without_rows(i, |part| (0.45..0.55).contains(&part))),
    damage!("every second row lost", |i| i.kind != Kind::Configuration
        && i.each(|table| {
            table.pick(&(0..table.rows()).step_by(2).collect::<Vec<_>>());
            true
        })),
    damage!("rows of the other sensor", |i| {
        i.tables.clone_from(&i.others);
        !i.others.is_empty()
    }),
    damage!("rows of the other day", |i| {
        i.tables.reverse();
        i.tables.len() > 1
    }),
    // Columns.
    damage!("a column missing", |i| {
        let Some(name) = i.main().first().copied() else { return false };
        i.each(|table| {
            table.columns.retain(|(own, _)| own != name);
            true
        })
    }),
    damage!("a column of text", |i| {
        let Some(name) = i.main().first().copied() else { return false };
        i.each(|table| {
            let rows = table.rows();
            table.column(name).map(|values| *values = Values::Words(vec!["n/a".to_owned(); rows])).is_some()
        })
    }),
    damage!("one value missing", |i| {
        let Some(name) = i.main().first().copied() else { return false };
        i.last(|table| {
            let Some(values) = table.column(name) else { return false };
            let mut list: Vec<f64> = match values {
                Values::Whole(list) => list.iter().map(|v| *v as f64).collect(),
                Values::Numbers(list) => list.clone(),
                _ => return false,
            };
            let middle = list.len() / 2;
            list[middle] = f64::NAN;
            *values = Values::Numbers(list);
            true
        })
    }),
    damage!("first column reversed", |i| i.first_column(|_, _, v| -v)),
    damage!("first column reversed from 60 % on", |i| i.first_column(|part, _, v| if part > 0.6 { -v } else { v })),
    damage!("first column x 2", |i| i.first_column(|_, _, v| 2.0 * v)),
    damage!("first column x 1.1 from 60 % on", |i| i.first_column(|part, _, v| if part > 0.6 { 1.1 * v } else { v })),
    damage!("first two columns exchanged", |i| match *i.main() {
        [a, b, ..] => i.each(|table| table.exchange(a, b)),
        _ => false,
    }),
    damage!("all columns x 10", |i| {
        let names = i.main();
        i.each(|table| names.iter().filter_map(|name| table.change(name, |_, v| 10.0 * v).then_some(())).count() > 0)
    }),
    damage!("all columns reversed", |i| {
        let names = i.main();
        i.each(|table| names.iter().filter_map(|name| table.change(name, |_, v| -v).then_some(())).count() > 0)
    }),
    damage!("first column stands", |i| i.first_column(|_, _, _| 17.0)),
    damage!("one value x 1000", |i| {
        let Some(name) = i.main().first().copied() else { return false };
        i.in_last(name, |row, v| if row == 500 { 1000.0 * v } else { v })
    }),
    damage!("one value of another size", |i| i.science() && i.in_last("bx", |row, v| if row == 5000 { v + 50_000.0 } else { v })),
    damage!("twenty values of another size", |i| i.science()
        && i.in_last("bx", |row, v| if (5000..5020).contains(&row) { v + 50_000.0 } else { v })),
    damage!("1000 counts more from 60 % on", |i| i.science()
        && i.first_column(|part, _, v| if part > 0.6 { v + 1000.0 } else { v })),
    damage!("counts of 16 bits", |i| i.science()
        && i.each(|table| AXES.iter().all(|name| table.change(name, |_, v| (v / 16.0).floor())))),
    damage!("unsigned counts", |i| i.science()
        && i.each(|table| AXES.iter().all(|name| table.change(name, |_, v| v + 524_288.0)))),
    damage!("500 counts at the end", |i| i.science() && i.in_last("bx", |row, v| if row < 500 { 524_287.0 } else { v })),
    // Times.
    damage!("time_tt2000 + 10 s, others right", |i| i.each(|table| {
        let has_others = table.columns.iter().any(|(name, _)| name == "time_utc");
        has_others && times(table, false, |time| time + 10 * SECOND)
    })),
    damage!("+ 10 s", |i| moved(i, 10)),
    damage!("+ 20 min", |i| moved(i, 1200)),
    damage!("- 20 min", |i| moved(i, -1200)),
    damage!("+ 1 day", |i| moved(i, 86_400)),
    damage!("TAI in place of TT", |i| i.each(|table| {
        alone(table);
        times(table, true, |time| time - 32_184_000_000)
    })),
    damage!("in milliseconds", |i| i.each(|table| {
        alone(table);
        times(table, true, |time| time / 1_000_000)
    })),
    damage!("times 1 % too long", |i| i.each(|table| {
        alone(table);
        let mut begin = None;
        times(table, true, |time| time).then(|| {
            if let Some((_, Values::Whole(list))) = table.columns.iter().find(|(name, _)| name.ends_with("tt2000")) {
                begin = list.first().copied();
            }
        });
        let begin = begin.unwrap_or(0);
        times(table, true, |time| time + (time - begin) / 100)
    })),
    damage!("clock set back by 60.017 s inside", |i| i.science()
        && i.last(|table| {
            alone(table);
            let Some(Values::Whole(list)) = table.column("time_tt2000") else { return false };
            let middle = list.len() / 2;
            list.iter_mut().skip(middle).for_each(|time| *time -= 60_017_000_000);
            true
        })),
    // Thermistor, mode, quality.
    damage!("thermistor + 4 K for 150 s", |i| i.science()
        && i.in_last("t_ob", |row, v| if (5000..8000).contains(&row) { v + 150.0 } else { v })),
    damage!("thermistor - 11 K in every tenth packet", |i| i.science()
        && i.in_last("t_ob", |row, v| if row % 3000 < 320 { v - 400.0 } else { v })),
    damage!("thermistor - 11 K in the first packet", |i| i.science()
        && i.in_last("t_ob", |row, v| if row < 320 { v - 400.0 } else { v })),
    damage!("thermistor at 14300 always", |i| i.science() && i.each(|table| table.change("t_ob", |_, _| 14_300.0))),
    damage!("thermistors exchanged", |i| i.science() && i.each(|table| table.exchange("t_ob", "t_ib"))),
    damage!("temperatures in kelvin", |i| i.science() && i.each(|table| table.change("t_ob", |_, _| 231.0))),
    damage!("SID3 called SID2", |i| i.science() && i.each(|table| renamed(table, "SID3", "SID2"))),
    damage!("SID2 called SID3", |i| i.science() && i.each(|table| renamed(table, "SID2", "SID3"))),
    damage!("SID4 called SID9", |i| i.science() && i.each(|table| renamed(table, "SID4", "SID9"))),
    damage!("quality 0 always", |i| i.science() && i.each(|table| table.change("quality", |_, _| 0.0))),
    damage!("quality 7 always", |i| i.science() && i.each(|table| table.change("quality", |_, _| 7.0))),
    // Attitude.
    damage!("conjugated", |i| i.kind == Kind::Attitude
        && i.each(|table| ["q1", "q2", "q3"].iter().all(|name| table.change(name, |_, v| -v)))),
    damage!("scalar last", |i| i.kind == Kind::Attitude
        && i.each(
            |table| ["q0", "q1", "q2"].windows(2).all(|pair| table.exchange(pair[0], pair[1])) && table.exchange("q2", "q3")
        )),
    damage!("one row turned by a right angle", |i| i.kind == Kind::Attitude && i.each(|table| turned(table, |row| row == 400))),
    damage!("turned by a right angle from 60 % on", |i| i.kind == Kind::Attitude
        && i.each(|table| {
            let from = table.rows() * 3 / 5;
            turned(table, |row| row >= from)
        })),
    // Wheels.
    damage!("in rotations per minute", |i| i.kind == Kind::Wheels
        && i.each(|table| ["w1_hz", "w2_hz", "w3_hz", "w4_hz"].iter().all(|name| table.change(name, |_, v| 60.0 * v)))),
    damage!("1 % too fast", |i| i.kind == Kind::Wheels
        && i.each(|table| ["w1_hz", "w2_hz", "w3_hz", "w4_hz"].iter().all(|name| table.change(name, |_, v| 1.01 * v)))),
    // Heaters.
    damage!("heaters exchanged", |i| i.kind == Kind::Heaters
        && i.each(|table| renamed(table, "h1", "h0") && renamed(table, "h2", "h1") && renamed(table, "h0", "h2"))),
    damage!("a heater that is not named", |i| i.kind == Kind::Heaters && i.each(|table| renamed(table, "h2", "h9"))),
    damage!("rows that overlap", |i| i.kind == Kind::Heaters
        && i.each(|table| table.change("to_tt2000", |row, v| if row % 5 == 0 { v + 60e9 } else { v }))),
    damage!("begin and end exchanged", |i| i.kind == Kind::Heaters && i.each(|table| table.exchange("from_tt2000", "to_tt2000"))),
    // Configuration.
    damage!("full scale of the housekeeping", |i| i.edit_all("full_scale_ent = 15000.0", "full_scale_ent = 16384.0")),
    damage!("full scale of one sensor in uT", |i| i.edit("full_scale_ent = 15000.0", "full_scale_ent = 15.0")),
    damage!("converter of 24 bits", |i| i.edit("adc_bits = 20", "adc_bits = 24")),
    damage!("converter of 16 bits", |i| i.edit("adc_bits = 20", "adc_bits = 16")),
    damage!("thermistor column of the other sensor", |i| i.edit("thermistor_column = \"t_ob\"", "thermistor_column = \"t_ib\"")),
    damage!("ground files of the other sensor", |i| i.edit_all("ground/OB/", "ground/none/")
        && i.edit_all("ground/IB/", "ground/OB/")
        && i.edit_all("ground/none/", "ground/IB/")),
    damage!("boom deployed 10 min late", |i| i.edit_all("2015-06-30T23:10:00", "2015-06-30T23:20:00")),
    damage!("a rotation that is none", |i| i.edit("uvw_to_sc = [[-", "uvw_to_sc = [[")),
    damage!("shift of SID4 missing", |i| i.edit("shift_s = 1.35", "shift_s = 0.0")),
    damage!("shift of SID4 in ms", |i| i.edit("shift_s = 1.35", "shift_s = 1350.0")),
    damage!("rate of SID3 of 10 Hz", |i| i.edit("{ rate_hz = 20.0", "{ rate_hz = 10.0")),
    damage!("roles exchanged", |i| i.edit("primary = \"OB\"\nsecondary = \"IB\"", "primary = \"IB\"\nsecondary = \"OB\"")),
    damage!("scalar last stated", |i| i.edit("\"scalar-first\"", "\"scalar-last\"")),
    damage!("other direction of the attitude stated", |i| i.edit("\"sc to celestial\"", "\"celestial to sc\"")),
    damage!("heater interval half an hour late", |i| i.edit("2015-06-30T23:52:00", "2015-07-01T00:02:00")),
    damage!("a key that is not known", |i| i.edit("adc_bits", "adc_bit")),
    damage!("a jump of another sign", |i| i
        .edit("subtract_nt = [-2.4666, -5.3289, -5.6694]", "subtract_nt = [2.4666, 5.3289, 5.6694]")),
    damage!("a jump in pT", |i| i.edit("subtract_nt = [-2.4666, -5.3289, -5.6694]", "subtract_nt = [-2466.6, -5328.9, -5669.4]")),
    damage!("a jump that overlaps the next", |i| i.edit("to = \"2015-07-01T00:12:00", "to = \"2015-07-01T00:22:00")),
    damage!("noise ten times too small", |i| i.edit("noise_ent = 0.03", "noise_ent = 0.003")),
    damage!("lines of other frequencies", |i| i.edit_all("lap_lines_hz = [3.1, 7.7]", "lap_lines_hz = [3.3, 7.4]")),
];

fn renamed(table: &mut Table, from: &str, to: &str) -> bool {
    let Some(Values::Words(words)) = ["sid", "cls"]
        .into_iter()
        .find(|name| table.columns.iter().any(|(own, _)| own == name))
        .and_then(|name| table.column(name))
    else {
        return false;
    };
    let mut any = false;
    for word in words.iter_mut().filter(|word| *word == from) {
        *word = to.to_owned();
        any = true;
    }
    any
}

/// Turns quaternions about x by a right angle: (w, x, y, z) times (1, 1, 0, 0)/√2.
fn turned(table: &mut Table, is_one: impl Fn(usize) -> bool) -> bool {
    let before = table.clone();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let q = |name: &str, row: usize| match before.columns.iter().find(|(own, _)| own == name) {
        Some((_, Values::Numbers(list))) => list[row],
        _ => f64::NAN,
    };
    let parts = [("q0", "q0", "q1", -1.0), ("q1", "q1", "q0", 1.0), ("q2", "q2", "q3", 1.0), ("q3", "q3", "q2", -1.0)];
    parts.iter().all(|(name, own, other, sign)| {
        table.change(name, |row, v| if is_one(row) { half * (q(own, row) + sign * q(other, row)) } else { v })
    })
}
