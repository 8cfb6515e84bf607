//! What was made of a day, for people and for programs that read the report.

use super::assemble::RowCounts;
use super::heater::{HeaterClass, Jump};
use super::wheels::ModeReport;
use crate::data::time::Tt2000;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The model of a sensor and day as it was written.
#[derive(Clone, Debug, Serialize)]
pub struct DailyMade {
    /// Sensor.
    pub sensor: String,
    /// Day, `YYYY-MM-DD`.
    pub day: String,
    /// Name of the file.
    pub file: String,
    /// Orders of x, y, z.
    pub order: [usize; 3],
    /// Coefficients of x, y, z, lowest order first, nT over °C.
    pub coefficients: [Vec<f64>; 3],
    /// Share of the squares of hours without part in the fit that the temperature explains; null with too few hours.
    pub explained: [Option<f64>; 3],
    /// What is left about the model, nT rms.
    pub residual_nt: [f64; 3],
    /// Calm minutes.
    pub minutes: usize,
    /// Lowest and highest temperature of them, °C.
    pub valid_degc: [f64; 2],
    /// What a person should know.
    pub notes: Vec<String>,
}

/// What was made of a sensor and day.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DayMade {
    /// Sensor, `common` for both, or `HK`.
    pub sensor: String,
    /// Day, `YYYY-MM-DD`.
    pub day: String,
    /// What was made of the rows.
    #[serde(flatten)]
    pub rows: RowCounts,
    /// Vectors.
    pub written: usize,
    /// Vectors that are null in the last of the levels A, B, C that was made.
    pub null: usize,
    /// Vectors by flag.
    pub flags: BTreeMap<String, usize>,
    /// Vectors by mode.
    pub modes: BTreeMap<String, usize>,
    /// Levels that were written.
    pub levels: Vec<String>,
    /// Lowest and highest temperature, °C.
    pub degc: Option<[f64; 2]>,
    /// `S_d`, nT.
    pub continuity_nt: Option<[f64; 3]>,
    /// Heaters that act on the day.
    pub heater: Vec<HeaterFound>,
    /// Heater jumps of the day.
    pub jumps: Vec<JumpFound>,
    /// What was taken off with wheels and lines, by mode.
    pub wheels: BTreeMap<String, WheelsFound>,
    /// What both sensors share, component by component; in the day of both.
    pub shared: Vec<SharedAxis>,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// The field of a heater.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeaterFound {
    /// Its name.
    pub name: String,
    /// Field in axes of the spacecraft, nT.
    pub vector_nt: [f64; 3],
    /// Its standard uncertainty, nT; absent for one that was not seen.
    pub std_nt: Option<[f64; 3]>,
    /// Edges that it is made from.
    pub edges: usize,
    /// Time that its field takes to rise or fall, s.
    pub edge_s: f64,
}

/// A jump of the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JumpFound {
    /// Middle of the edge.
    pub time_tt2000: Tt2000,
    /// Heater.
    pub class: String,
    /// Whether it is switched on.
    pub on: bool,
    /// Field with it minus field without, of this edge alone, nT; absent where no vector says it.
    pub height_nt: Option<[f64; 3]>,
    /// Its standard uncertainty, nT.
    pub std_nt: Option<[f64; 3]>,
}

/// What was taken off a mode with wheels and lines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WheelsFound {
    /// Vectors that were changed.
    pub changed: usize,
    /// Vectors in stretches that are too short.
    pub in_short_stretches: usize,
    /// Vectors outside the table of rates.
    pub outside_table: usize,
    /// Root mean square of what was taken off, nT.
    pub removed_rms_nt: [f64; 3],
}

/// The principal axis of one component of both sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SharedAxis {
    /// Its direction: primary, secondary sensor.
    pub direction: [f64; 2],
    /// Share of the variance of both that lies along it.
    pub share: f64,
    /// Correlation of both.
    pub correlation: f64,
}

impl HeaterFound {
    /// Of a class.
    #[must_use]
    pub fn of(class: &HeaterClass) -> Self {
        let std_nt = Some(class.std_nt).filter(|std| std.iter().all(|s| s.is_finite()));
        Self { name: class.name.clone(), vector_nt: class.vector_nt, std_nt, edges: class.edges, edge_s: class.edge_s }
    }
}

impl JumpFound {
    /// Of a jump, by the names of the heaters.
    #[must_use]
    pub fn of(jump: &Jump, names: &[String]) -> Self {
        let known = |values: [f64; 3]| Some(values).filter(|v| v.iter().all(|x| x.is_finite()));
        Self {
            time_tt2000: jump.time_tt2000,
            class: names.get(jump.class).cloned().unwrap_or_default(),
            on: jump.on,
            height_nt: known(jump.height_nt),
            std_nt: known(jump.std_nt),
        }
    }
}

impl WheelsFound {
    /// Of the report on a mode; `None` where nothing was to be cleaned.
    #[must_use]
    pub fn of(report: &ModeReport) -> Option<Self> {
        let own = Self {
            changed: report.changed,
            in_short_stretches: report.in_short_stretches,
            outside_table: report.outside_table,
            removed_rms_nt: report.removed_rms_nt,
        };
        (own.changed + own.in_short_stretches + own.outside_table > 0).then_some(own)
    }
}
