//! Rows of telemetry to the vectors of a stretch of time: corrected times, order, repeated and rejected rows (RO-IGEP-TR0028 sections 4.2.3
//! and 4.2.3.5).

use super::Block;
use crate::data::flags::Flags;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::files::flight::edited::Rows;
use crate::files::flight::mission::Mission;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use thiserror::Error;

/// A vector follows a gap if it comes later after the one before than so many steps of its mode.
const GAP_STEPS: f64 = 1.5;

/// Quality bit of the sensor: 0 for the outboard sensor, 1 for the inboard one.
const SENSOR_BIT: u8 = 8;

/// What was made of the rows whose corrected times lie in a stretch.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RowCounts {
    /// Rows that were read.
    pub read: usize,
    /// Repeated rows: the same time tag and mode as one before.
    pub duplicates: usize,
    /// Repeated rows whose counts differ.
    pub conflicts: usize,
    /// Rejected by their quality.
    pub rejected: usize,
    /// Rows whose quality names another sensor.
    pub contradicting: usize,
}

/// Why rows make no vectors.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AssembleError {
    /// No rate or time shift.
    #[error("mode {sid} states no `rate_hz` with a `shift_s` for the {role} sensor")]
    NoShift {
        /// Mode.
        sid: String,
        /// Primary or secondary.
        role: &'static str,
    },
}

/// Vectors of a stretch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Assembled {
    /// The vectors.
    pub vectors: Block,
    /// What was made of the rows.
    pub counts: RowCounts,
}

const ROLES: [&str; 2] = ["primary", "secondary"];

/// ns that are added to the time of a row.
fn shift_ns(mission: &Mission, sensor: &str, mode: u8, tag: Tt2000) -> Result<i64, AssembleError> {
    let mode = &mission.modes[usize::from(mode)];
    let role = mission.roles.of(sensor, tag);
    let stated = mode.rates[role].and_then(|rate| rate.shift_ns);
    stated.ok_or_else(|| AssembleError::NoShift { sid: mode.sid.clone(), role: ROLES[role] })
}

/// Puts rows in the order of their corrected times and keeps those of a stretch that are neither repeated nor rejected; rows of `day` are
/// counted. `shifts` tells whether times are corrected by the shifts of the modes.
///
/// # Errors
/// A mode without a shift.
pub fn assemble(
    rows: &Rows,
    sensor: &str,
    mission: &Mission,
    leap: &LeapSeconds,
    span: &Range<Tt2000>,
    day: &Range<Tt2000>,
    shifts: bool,
) -> Result<Assembled, AssembleError> {
    let mut time = Vec::with_capacity(rows.tag.len());
    let mut last: Option<(u8, i64)> = None;
    for (tag, mode) in rows.tag.iter().zip(&rows.mode) {
        // The shift changes with the mode; with intervals of the roles it may change with every row.
        let shift = match last {
            Some((m, shift)) if m == *mode && mission.roles.intervals.is_empty() => shift,
            _ if !shifts => 0,
            _ => shift_ns(mission, sensor, *mode, *tag)?,
        };
        last = Some((*mode, shift));
        time.push(tag + shift);
    }
    let mut order: Vec<u32> = (0..u32::try_from(time.len()).unwrap_or(u32::MAX)).collect();
    if !time.is_sorted() {
        order.sort_by_key(|row| (time[*row as usize], *row));
    }
    let mut out = Assembled::default();
    let block = &mut out.vectors;
    let reserved = order.len();
    block.time.reserve_exact(reserved);
    block.obt_s.reserve_exact(reserved);
    block.field.iter_mut().for_each(|c| c.reserve_exact(reserved));
    block.thermistor.reserve_exact(reserved);
    let mut previous: Option<Tt2000> = None;
    let mut begin = 0;
    while begin < order.len() {
        let at = time[order[begin] as usize];
        let same = order[begin..].iter().take_while(|row| time[**row as usize] == at).count();
        let group = &order[begin..begin + same];
        begin += same;
        let counted = day.contains(&at);
        for (index, row) in group.iter().enumerate() {
            let row = *row as usize;
            let counts = |row: usize| rows.counts.each_ref().map(|c| c[row].to_bits());
            out.counts.read += usize::from(counted);
            // The sensor bit is that of a mission with one outboard and one inboard sensor.
            let says_inboard = rows.quality[row] & SENSOR_BIT != 0;
            let contradicts = (sensor == "OB" && says_inboard) || (sensor == "IB" && !says_inboard);
            out.counts.contradicting += usize::from(counted && contradicts);
            let earlier = group[..index].iter().map(|r| *r as usize);
            if let Some(first) = earlier.into_iter().find(|r| rows.mode[*r] == rows.mode[row] && rows.tag[*r] == rows.tag[row]) {
                out.counts.duplicates += usize::from(counted);
                out.counts.conflicts += usize::from(counted && counts(first) != counts(row));
                continue;
            }
            if rows.quality[row] & mission.reject_mask != 0 {
                out.counts.rejected += usize::from(counted);
                continue;
            }
            let mode = &mission.modes[usize::from(rows.mode[row])];
            let role = mission.roles.of(sensor, rows.tag[row]);
            let rate_hz = mode.rates[role].map(|rate| rate.rate_hz);
            #[expect(clippy::cast_precision_loss, reason = "differences of times")]
            let late = match previous {
                Some(before) => rate_hz.is_some_and(|rate| (at - before) as f64 * rate > GAP_STEPS * SECOND_NS as f64),
                // Rows are read far enough that a step before them would be seen.
                None => rows.is_continued,
            };
            previous = Some(at);
            if !span.contains(&at) {
                continue;
            }
            let mut flags = Flags::default();
            if late {
                flags |= Flags::GAP;
            }
            block.time.push(at);
            #[expect(clippy::cast_precision_loss, reason = "shifts of seconds")]
            block.obt_s.push(rows.obt_s[row] + (at - rows.tag[row]) as f64 / SECOND_NS as f64);
            (0..3).for_each(|i| block.field[i].push(rows.counts[i][row]));
            block.thermistor.push(rows.thermistor[row]);
            block.mode.push(rows.mode[row]);
            block.quality.push(rows.quality[row]);
            block.range.push(rows.range[row]);
            block.flags.push(flags.0);
        }
    }
    if let (Some(first), Some(end)) = (block.time.first(), block.time.last())
        && (leap.utc(*first).day..=leap.utc(*end).day).any(|day| leap.ends_with_leap_second(day))
    {
        for (time, flags) in block.time.iter().zip(&mut block.flags) {
            if leap.utc(*time).in_leap_second() {
                *flags |= Flags::LEAP.0;
            }
        }
    }
    block.t_degc = vec![f64::NAN; block.len()];
    Ok(out)
}

/// Cuts vectors into blocks of at most `rows`, with places for covariances if they are wanted.
#[must_use]
pub fn blocks(mut vectors: Block, rows: usize, uncertainty: bool) -> Vec<Block> {
    let mut list = Vec::with_capacity(vectors.len().div_ceil(rows.max(1)));
    while vectors.len() > rows {
        let rest = split_off(&mut vectors, rows);
        list.push(std::mem::replace(&mut vectors, rest));
    }
    if !vectors.is_empty() {
        list.push(vectors);
    }
    if uncertainty {
        for block in &mut list {
            block.own_nt2 = vec![[0.0; 6]; block.len()];
            block.thermistor_nt = vec![[0.0; 3]; block.len()];
            block.common_nt2 = vec![[0.0; 6]; block.len()];
        }
    }
    list
}

fn split_off(block: &mut Block, at: usize) -> Block {
    Block {
        time: block.time.split_off(at),
        obt_s: block.obt_s.split_off(at),
        field: block.field.each_mut().map(|c| c.split_off(at)),
        thermistor: block.thermistor.split_off(at),
        t_degc: block.t_degc.split_off(at),
        mode: block.mode.split_off(at),
        quality: block.quality.split_off(at),
        range: block.range.split_off(at),
        flags: block.flags.split_off(at),
        own_nt2: Vec::new(),
        thermistor_nt: Vec::new(),
        common_nt2: Vec::new(),
    }
}
