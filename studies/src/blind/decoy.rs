//! Damage of the data that is no effect: a diagnosis must not name one for it.

use super::noise::Random;
use super::sensor::{CleanRun, Kind};
use calfit::data::run::{Run, SlowTable};
use serde::Serialize;

/// Length of a gap, s.
const GAP_S: f64 = 1200.0;

/// What is damaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decoy {
    /// Nothing was recorded for twenty minutes while the sensor was heated or cooled fastest.
    Gap,
    /// The thermistor of the sensor stands still from some time on.
    Stuck,
    /// There is no thermistor at the coils.
    Missing,
    /// Readings are whole numbers.
    Coarse,
}

impl Decoy {
    pub const ALL: [Decoy; 4] = [Decoy::Gap, Decoy::Stuck, Decoy::Missing, Decoy::Coarse];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Decoy::Gap => "gap while heated",
            Decoy::Stuck => "thermistor stands still",
            Decoy::Missing => "no thermistor at the coils",
            Decoy::Coarse => "readings in whole enT",
        }
    }

    /// Kind of run that has it.
    pub fn kind(self) -> Kind {
        if self == Decoy::Gap { Kind::Sweep } else { Kind::Lin }
    }

    /// Effects that are a right name for it.
    pub fn may_be_named(self, effect: &str) -> bool {
        self == Decoy::Stuck && effect == "bad_thermistor"
    }

    /// Damages what a run holds beside its vectors.
    pub fn damage(self, clean: &CleanRun, run: &mut Run, random: &mut Random) {
        match self {
            Decoy::Gap => {
                let curve = &clean.sensor_degc;
                let change = |t_s: &f64| (curve.at(t_s + GAP_S) - curve.at(*t_s)).abs();
                let last_s = clean.count as f64 / clean.rate_hz - GAP_S;
                let begin_s =
                    (0..).map(|k| f64::from(k) * 60.0).take_while(|t| *t < last_s).max_by(|a, b| change(a).total_cmp(&change(b)));
                let Some(begin_s) = begin_s else { return };
                let is_left = |t_s: f64| !(begin_s..begin_s + GAP_S).contains(&t_s);
                run.blocks.retain(|b| is_left(b.setting.t_start_s) && is_left(b.setting.t_end_s));
                for table in [&mut run.temperatures, &mut run.channels] {
                    *table = kept(table, is_left);
                }
            }
            Decoy::Stuck => {
                let Some(values) = run.temperatures.values.first_mut() else { return };
                let from = (random.between(0.3, 0.7) * values.len() as f64) as usize;
                let held = values[from];
                values[from..].fill(held);
            }
            Decoy::Missing => {
                let table = &mut run.temperatures;
                if let Some(at) = table.names.iter().position(|name| name == "T29") {
                    table.names.remove(at);
                    table.values.remove(at);
                }
            }
            Decoy::Coarse => {}
        }
    }
}

/// The rows of a table at some times.
fn kept(table: &SlowTable, is_left: impl Fn(f64) -> bool) -> SlowTable {
    let of = |values: &Vec<f64>| {
        let both = values.iter().zip(&table.t_s);
        both.filter(|(_, t)| is_left(**t)).map(|(v, _)| *v).collect::<Vec<f64>>()
    };
    SlowTable { names: table.names.clone(), t_s: of(&table.t_s), values: table.values.iter().map(of).collect() }
}
