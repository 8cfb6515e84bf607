//! The field of an interval without the heaters.

use std::ops::Range;

use nalgebra::Vector3;

use super::cells::{FILLED_CELLS, Profile};
use super::{HEATER, HeaterClass, HeaterClosing, HeaterError, HeaterInterval, HeaterMethod, HeaterOptions, Jump};

/// Subtracts the class vectors within an interval and closes the samples of the edges; vectors that are null stay null, and
/// nothing outside the interval is touched. The columns hold all of the interval, or a part of it with the edges that reach into
/// it.
///
/// # Errors
/// Columns of different length.
pub fn close(
    time_tt2000: &[i64],
    field_nt: &mut [Vec<f64>; 3],
    flags: &mut [u32],
    interval: HeaterInterval,
    jumps: &[Jump],
    classes: &[HeaterClass],
    options: &HeaterOptions,
) -> Result<(), HeaterError> {
    super::check_lengths(time_tt2000, field_nt, flags)?;
    let rows = interval.rows(time_tt2000);
    if rows.is_empty() || jumps.is_empty() {
        return Ok(());
    }
    let vectors = super::vectors(classes);
    let edge_s = super::edge_s(classes);
    let seconds = |from: i64, to: i64| (to - from) as f64 * 1e-9;
    // The time a vector is the mean over is the distance to its nearer neighbour.
    let mean_s = |row: usize| {
        let before = row.checked_sub(1).map_or(f64::INFINITY, |before| seconds(time_tt2000[before], time_tt2000[row]));
        let after = time_tt2000.get(row + 1).map_or(f64::INFINITY, |&after| seconds(time_tt2000[row], after));
        before.min(after).clamp(1e-3, options.cell_s)
    };
    let mut heat = vec![Vector3::<f64>::zeros(); rows.len() + 1];
    let (mut of_edge, mut drawn) = (vec![false; rows.len()], vec![false; rows.len()]);
    // A table knows when heaters switch, whatever the vectors show.
    let is_there = |row: &usize| options.method == HeaterMethod::Found && field_nt.iter().all(|own| own[*row].is_finite());
    let there: Vec<usize> = rows.clone().filter(is_there).collect();
    let times: Vec<i64> = there.iter().map(|&row| time_tt2000[row]).collect();
    for jump in jumps {
        let vector = vectors[jump.class] * if jump.on { 1.0 } else { -1.0 };
        // Where it may lie: an edge that the vectors do not tell the place of is within its cells.
        let astray_s = (WITHIN_STDS * jump.time_std_s).min(options.cell_s);
        let longest_ns = ((0.5 * (edge_s + options.cell_s) + astray_s) * 1e9) as i64;
        let near = HeaterInterval { from_tt2000: jump.time_tt2000 - longest_ns, to_tt2000: jump.time_tt2000 + longest_ns }
            .rows(&time_tt2000[rows.clone()]);
        let mut last = Vector3::zeros();
        for row in near.clone() {
            let profile = Profile { edge_cells: edge_s, mean_cells: mean_s(rows.start + row) };
            let distance_s = seconds(jump.time_tt2000, time_tt2000[rows.start + row]);
            let share = profile.share(distance_s);
            heat[row] += vector * share - last;
            last = vector * share;
            let [earliest, latest] = [-astray_s, astray_s].map(|by| profile.share(distance_s - by));
            if earliest >= LEAST_SHARE && latest <= 1.0 - LEAST_SHARE {
                of_edge[row] = true;
                drawn[row] |= options.closing == HeaterClosing::Line || jump.time_std_s >= WELL_KNOWN_S;
            }
        }
        heat[near.end] += vector - last;
        there[unseen(&times, jump.time_tt2000, options)].iter().for_each(|row| of_edge[row - rows.start] = true);
    }
    let mut sum = Vector3::zeros();
    for (offset, row) in rows.clone().enumerate() {
        sum += heat[offset];
        // Sums of class vectors that went on and off leave rounding only.
        if sum.norm() > 1e-9 {
            (0..3).for_each(|component| field_nt[component][row] -= sum[component]);
        }
    }
    if options.method == HeaterMethod::Found {
        for stretch in untold(jumps, classes) {
            let near = stretch.rows(&time_tt2000[rows.clone()]);
            of_edge[near].iter_mut().for_each(|of_edge| *of_edge = true);
        }
    }
    for (row, _) in rows.clone().zip(&of_edge).filter(|(_, of_edge)| **of_edge) {
        flags[row] |= HEATER;
    }
    bridge(time_tt2000, field_nt, rows, &drawn);
    Ok(())
}

/// The stretches in which the state of a heater is not told. Where no vector shows its first or its last edge it is on since it is off outside of the
/// interval: that edge lies where nothing speaks against it, and may be one that was missed anywhere within. And where it stays in a state for far
/// longer than it usually does, it may have gone to the other one and back.
fn untold(jumps: &[Jump], classes: &[HeaterClass]) -> Vec<HeaterInterval> {
    let between = |from: &Jump, to: &Jump| HeaterInterval { from_tt2000: from.time_tt2000, to_tt2000: to.time_tt2000 };
    let mut all = Vec::new();
    for (class, about) in classes.iter().enumerate() {
        let mut own: Vec<&Jump> = jumps.iter().filter(|jump| jump.class == class).collect();
        own.sort_by_key(|jump| jump.time_tt2000);
        all.extend(own.first_chunk().filter(|[first, _]| !first.is_shown()).map(|[first, next]| between(first, next)));
        all.extend(own.last_chunk().filter(|[_, last]| !last.is_shown()).map(|[before, last]| between(before, last)));
        let is_long = |pair: &&[&Jump]| {
            let [usual_s, scatter_s] = if pair[0].on { about.on_s } else { about.off_s };
            let there_and_back_s = 0.5 * (about.on_s[0] + about.off_s[0]);
            let beyond_s = (pair[1].time_tt2000 - pair[0].time_tt2000) as f64 * 1e-9 - usual_s;
            beyond_s > there_and_back_s.max(LONG_STDS * scatter_s)
        };
        all.extend(own.windows(2).filter(is_long).map(|pair| between(pair[0], pair[1])));
    }
    all
}

/// The vectors behind a gap, or behind the begin of the interval, in which, or soon after which, an edge was found: where it lies they do not show, or
/// badly, and its field may be on or off in them. An increment is looked at once those that it is predicted from are there.
fn unseen(time_tt2000: &[i64], jump_tt2000: i64, options: &HeaterOptions) -> Range<usize> {
    let cells_ns = |cells: usize| (cells as f64 * options.cell_s * 1e9) as i64;
    let (blind_ns, gap_ns) = (cells_ns(options.order + 1), cells_ns(FILLED_CELLS + 1));
    let place = |at: i64| time_tt2000.partition_point(|&time| time < at);
    let is_behind_gap = |row: &usize| *row == 0 || time_tt2000[*row] - time_tt2000[row - 1] > gap_ns;
    let before = (0..time_tt2000.len()).take(place(jump_tt2000) + 1).rev();
    let mut near = before.take_while(|&row| jump_tt2000 < time_tt2000[row] + blind_ns);
    near.find(is_behind_gap).map_or(0..0, |row| row..place(time_tt2000[row] + blind_ns))
}

/// Standard deviations of the times in a state beyond which one is far longer than usual.
const LONG_STDS: f64 = 5.0;
/// Share of an edge below which, and below which from the end, a sample does not count as one of the edge.
const LEAST_SHARE: f64 = 0.01;
/// Standard deviations by which an edge may lie elsewhere.
const WITHIN_STDS: f64 = 2.0;
/// Standard deviation of the time of an edge up to which its shape is better than a line, s.
const WELL_KNOWN_S: f64 = 0.3;

/// Replaces rows by straight lines between the vectors beside them.
fn bridge(time_tt2000: &[i64], field_nt: &mut [Vec<f64>; 3], rows: Range<usize>, drawn: &[bool]) {
    let null = |field: &[Vec<f64>; 3], row: usize| field.iter().any(|component| component[row].is_nan());
    let closed = |row: usize| rows.contains(&row) && drawn[row - rows.start];
    let mut row = rows.start;
    while row < rows.end {
        if !closed(row) {
            row += 1;
            continue;
        }
        let end = (row..rows.end).find(|&next| !closed(next) && !null(field_nt, next)).unwrap_or(rows.end);
        let before = (0..row).rev().take(LONGEST_BRIDGE).find(|&before| !null(field_nt, before));
        let after = (end..time_tt2000.len()).take(LONGEST_BRIDGE).find(|&after| !null(field_nt, after));
        for at in (row..end).filter(|&at| closed(at)) {
            if null(field_nt, at) {
                continue;
            }
            for component in field_nt.iter_mut() {
                component[at] = match (before, after) {
                    (Some(a), Some(b)) => {
                        let part = (time_tt2000[at] - time_tt2000[a]) as f64 / (time_tt2000[b] - time_tt2000[a]).max(1) as f64;
                        component[a] + (component[b] - component[a]) * part
                    }
                    (Some(one), None) | (None, Some(one)) => component[one],
                    (None, None) => component[at],
                };
            }
        }
        row = end;
    }
}

/// Null vectors beside an edge that are passed over in search of one to draw a line from.
const LONGEST_BRIDGE: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    /// A rate of so many vectors per second over 60 s, a field that rises by 0.1 nT/s, and a heater of 2 nT on from 20.25 s to 40
    /// s, as means over the vectors.
    fn record(rate: i64) -> (Vec<i64>, [Vec<f64>; 3], Vec<Jump>, Vec<HeaterClass>) {
        let time: Vec<i64> = (0..60 * rate).map(|row| row * SECOND / rate).collect();
        let profile = Profile { edge_cells: 1.0, mean_cells: 1.0 / rate as f64 };
        let heat = |at: f64| 2.0 * (profile.share(at - 20.25) - profile.share(at - 40.0));
        let x = time.iter().map(|&time| time as f64 * 1e-9).map(|at| 0.1 * at + heat(at)).collect();
        let zero = vec![0.0; time.len()];
        let jump = |at: i64, on: bool| Jump {
            time_tt2000: at,
            time_std_s: 0.01,
            interval: 0,
            class: 0,
            on,
            height_nt: [2.0, 0.0, 0.0],
            std_nt: [0.0; 3],
        };
        let class = HeaterClass {
            name: "h".into(),
            vector_nt: [2.0, 0.0, 0.0],
            std_nt: [0.0; 3],
            off_s: [20.0, 1.0],
            on_s: [20.0, 1.0],
            edges: 2,
            edge_s: 1.0,
        };
        (time, [x, zero.clone(), zero], vec![jump(20 * SECOND + SECOND / 4, true), jump(40 * SECOND, false)], vec![class])
    }

    #[test]
    fn a_straight_field_comes_back_at_every_rate_and_way() {
        for rate in [1, 5, 20] {
            for closing in [HeaterClosing::Line, HeaterClosing::Shape] {
                let (time, mut field, jumps, classes) = record(rate);
                let mut flags = vec![16; time.len()];
                let options = HeaterOptions { closing, ..HeaterOptions::new(vec!["h".into()], HeaterMethod::Found) };
                let interval = HeaterInterval { from_tt2000: 5 * SECOND, to_tt2000: 55 * SECOND };
                close(&time, &mut field, &mut flags, interval, &jumps, &classes, &options).expect("columns of equal length");
                for (row, &time) in time.iter().enumerate() {
                    let at = time as f64 * 1e-9;
                    // Outside the share that counts as an edge a line leaves at most that share of the class vector.
                    let allowed = if closing == HeaterClosing::Line { 2.0 * 2.0 * LEAST_SHARE } else { 1e-12 };
                    assert!((field[0][row] - 0.1 * at).abs() < allowed, "{rate} {at} {}", field[0][row]);
                    let reach = 0.5 * (1.0 + 1.0 / rate as f64);
                    let near = [20.25, 40.0].map(|edge| (at - edge).abs()).into_iter().fold(f64::INFINITY, f64::min);
                    assert_eq!(flags[row] & 16, 16);
                    assert!(near > reach - 0.2 || flags[row] & HEATER != 0, "{rate} {at}");
                    assert!(near < reach || flags[row] & HEATER == 0, "{rate} {at}");
                }
            }
        }
    }

    /// A heater that is on at 20.25 s and for which nothing but the end of the interval has an end: all vectors in between may be wrong.
    #[test]
    fn an_end_that_no_vector_shows_leaves_a_flag_on_all_that_rests_on_it() {
        let (time, mut field, mut jumps, classes) = record(5);
        (jumps[1].time_tt2000, jumps[1].height_nt) = (55 * SECOND, [f64::NAN; 3]);
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
        let interval = HeaterInterval { from_tt2000: 5 * SECOND, to_tt2000: 55 * SECOND };
        let mut flags = vec![0; time.len()];
        close(&time, &mut field, &mut flags, interval, &jumps, &classes, &options).expect("columns of equal length");
        let is_flagged = |at_s: i64| flags[(at_s * 5) as usize] & HEATER != 0;
        assert!((21..55).all(is_flagged) && !(0..19).any(is_flagged) && !(55..60).any(is_flagged));
        // A table knows.
        let table = HeaterOptions { method: HeaterMethod::Table(Vec::new()), ..options };
        let mut flags = vec![0; time.len()];
        close(&time, &mut field, &mut flags, interval, &jumps, &classes, &table).expect("columns of equal length");
        assert!((23..50).all(|at_s| flags[(at_s * 5) as usize] & HEATER == 0));
    }

    /// On from 20.25 to 45 s where it is usually on for 20 or for 10 s and off for 10 s: in 24.75 s there is room for 10 s off within 10 s on, and none
    /// within 20 s.
    #[test]
    fn a_stay_in_a_state_that_is_far_longer_than_usual_has_a_flag() {
        for (usual_s, is_flagged) in [(20.0, false), (10.0, true)] {
            let (time, mut field, mut jumps, mut classes) = record(5);
            jumps[1].time_tt2000 = 45 * SECOND;
            (classes[0].on_s, classes[0].off_s) = ([usual_s, 1.0], [10.0, 1.0]);
            let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
            let interval = HeaterInterval { from_tt2000: 5 * SECOND, to_tt2000: 55 * SECOND };
            let mut flags = vec![0; time.len()];
            close(&time, &mut field, &mut flags, interval, &jumps, &classes, &options).expect("columns of equal length");
            assert!((23..43).all(|at_s| (flags[(at_s * 5) as usize] & HEATER != 0) == is_flagged), "{usual_s}");
        }
    }

    #[test]
    fn outside_of_the_interval_and_before_the_first_jump_no_bit_changes() {
        let (time, mut field, jumps, classes) = record(5);
        field[0][10] = 0.1 + 0.2;
        field[1][150] = f64::NAN;
        let before = field.clone();
        let mut flags = vec![0; time.len()];
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
        let interval = HeaterInterval { from_tt2000: 2 * SECOND, to_tt2000: 30 * SECOND };
        close(&time, &mut field, &mut flags, interval, &jumps, &classes, &options).expect("columns of equal length");
        let changed: Vec<usize> = (0..time.len()).filter(|&row| field[0][row].to_bits() != before[0][row].to_bits()).collect();
        let edge = |row: &usize| time[*row] > 19 * SECOND && time[*row] < 30 * SECOND;
        assert!(!changed.is_empty() && changed.iter().all(edge));
        assert!(field[1][150].is_nan());
        let short = close(&time, &mut field, &mut [0; 3], interval, &jumps, &classes, &options);
        assert_eq!(short, Err(HeaterError::Length { what: "flags", expected: 300, found: 3 }));
    }

    #[test]
    fn a_part_of_an_interval_with_all_its_jumps_is_closed_as_in_the_whole() {
        let (time, mut whole, jumps, classes) = record(5);
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
        let interval = HeaterInterval { from_tt2000: 5 * SECOND, to_tt2000: 55 * SECOND };
        let original = whole.clone();
        close(&time, &mut whole, &mut vec![0; 300], interval, &jumps, &classes, &options).expect("columns of equal length");
        // The cut lies while the heater is on, and once within an edge.
        for cut in [150, 101] {
            for rows in [0..cut, cut..300] {
                let mut part = original.clone().map(|component| component[rows.clone()].to_vec());
                let mut flags = vec![0; rows.len()];
                close(&time[rows.clone()], &mut part, &mut flags, interval, &jumps, &classes, &options).expect("equal length");
                for (own, whole) in part[0].iter().zip(&whole[0][rows]) {
                    assert!((own - whole).abs() < 1e-12, "{own} {whole}");
                }
            }
        }
    }

    #[test]
    fn vectors_behind_a_gap_that_hides_an_edge_have_the_flag() {
        let (time, field, mut jumps, classes) = record(5);
        // From 15 to 30 s there are no vectors, and four increments must follow before one can be predicted.
        let is_left = |row: &usize| !(15 * SECOND..30 * SECOND).contains(&time[*row]);
        let rows: Vec<usize> = (0..time.len()).filter(is_left).collect();
        let time: Vec<i64> = rows.iter().map(|&row| time[row]).collect();
        let interval = HeaterInterval { from_tt2000: 0, to_tt2000: 60 * SECOND };
        for (method, at_s, flagged) in [
            (HeaterMethod::Found, 20, 30..35),
            (HeaterMethod::Found, 32, 30..35),
            (HeaterMethod::Found, 36, 0..0),
            // A table knows when.
            (HeaterMethod::Table(Vec::new()), 32, 0..0),
        ] {
            let options = HeaterOptions::new(vec!["h".into()], method);
            jumps[0].time_tt2000 = at_s * SECOND;
            let mut field = field.clone().map(|component| rows.iter().map(|&row| component[row]).collect::<Vec<_>>());
            let mut flags = vec![0; time.len()];
            close(&time, &mut field, &mut flags, interval, &jumps, &classes, &options).expect("columns of equal length");
            for (flag, time) in flags.iter().zip(&time) {
                let is_edge = [at_s, 40].iter().any(|edge| (time - edge * SECOND).abs() <= SECOND);
                let is_flagged = flagged.contains(&(time / SECOND));
                assert!(is_edge || is_flagged == (flag & HEATER != 0), "{:?} {at_s} {time}", options.method);
            }
        }
    }

    #[test]
    fn an_edge_whose_time_nobody_knows_is_bridged() {
        let (time, mut field, mut jumps, classes) = record(1);
        jumps[0].time_std_s = f64::INFINITY;
        // The time is wrong by 0.3 s: the shape would leave 0.6 nT.
        jumps[0].time_tt2000 += 3 * SECOND / 10;
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Found);
        let interval = HeaterInterval { from_tt2000: 0, to_tt2000: 60 * SECOND };
        close(&time, &mut field, &mut vec![0; 60], interval, &jumps, &classes, &options).expect("columns of equal length");
        assert!((field[0][20] - 2.0).abs() < 0.1 && (field[0][21] - 2.1).abs() < 0.1, "{:?}", &field[0][18..23]);
    }
}
