//! What is taken off the samples before a spectrum is taken, and which lines are the same signal.

use super::{Grid, Inside, Signals, Slopes, belongs, clip, demean, joined};
use crate::model::effects::Catalogue;
use crate::record::prepared::Samples;

/// 90 plateaus of 6 s every 7 s at 32 Hz.
fn plateaus() -> (Samples, Vec<[usize; 2]>) {
    let samples = Samples { t_s: (0..90 * 224).map(|k| k as f64 / 32.0).collect(), ..Samples::default() };
    (samples, (0..90).map(|i| [224 * i, 224 * i + 192]).collect())
}

fn squares(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum()
}

/// A wave of 400 s leaves a saw of its slopes, and of that its bends: over 6 s with slope `w` and bend `w²` of a unit wave the saw has a
/// root mean square of `w · 6 / √12`, the bends `w² · 36 / √720`, each times the mean of a squared cosine.
#[test]
fn slow_changes_are_taken_off_the_plateaus() {
    let (samples, windows) = plateaus();
    let omega = std::f64::consts::TAU / 400.0;
    let mut values = [0, 1, 2].map(|a| samples.t_s.iter().map(|t| (omega * t + f64::from(a)).sin()).collect::<Vec<f64>>());
    demean(&mut values, &windows);
    let slopes = Slopes::new(&samples, &windows).unwrap();
    for values in &mut values {
        let within = |v: &[f64]| windows.iter().map(|[from, to]| squares(&v[*from..*to])).sum::<f64>() / (90.0 * 192.0);
        let before = within(values);
        assert!((before.sqrt() / (omega * 6.0 / 24.0_f64.sqrt()) - 1.0).abs() < 0.05, "{before}");
        slopes.level(values);
        let bends = omega * omega * 36.0 / (2.0 * 720.0_f64).sqrt();
        // What the cosines do not follow at the ends of the run adds to the bends.
        assert!(within(values).sqrt() < 0.05 * before.sqrt() + bends, "{}", within(values).sqrt());
    }
}

/// Two spikes, one of them at the begin of a plateau, leave nothing; pulses of three samples and a quick signal stay as they are.
#[test]
fn single_spikes_are_clipped() {
    let (_, windows) = plateaus();
    let signals: [fn(usize) -> f64; 2] = [
        |k| 0.1 * ((k * 7919 % 101) as f64 / 50.0 - 1.0) + if k % 600 < 3 { 20.0 } else { 0.0 },
        |k| if k % 3 == 0 { 1.0 } else { -0.5 },
    ];
    for signal in signals {
        let clean: Vec<f64> = (0..90 * 224).map(signal).collect();
        let mut values = clean.clone();
        for (k, size) in [(224, 200.0), (5 * 224 + 77, -370.0)] {
            values[k] += size;
        }
        clip(&mut values, &windows);
        let most = values.iter().zip(&clean).fold(0.0, |most: f64, (v, c)| most.max((v - c).abs()));
        assert!(most < 2.0, "{most}");
        assert_eq!(values.iter().zip(&clean).filter(|(v, c)| v != c).count(), 2);
    }
}

/// Beside a tone at 10.75 Hz, of which the third harmonic is seen at 0.25 Hz: a line there is that harmonic, one beside it is a signal of its own, and
/// one that is beside the tone itself by as much is what the tone has beside a pure period.
#[test]
fn a_line_beside_a_folded_harmonic_is_another_signal() {
    let (samples, windows) = plateaus();
    let grid = Grid::new(&samples, &windows, 32.0).unwrap();
    let (effect, line) = Signals::of(&Catalogue::default()).line.unwrap();
    let tone = Inside::new(effect, (line.term)(&[0, 1, 2], 10.75));
    let [third_hz, beside_hz] = [0.25, 0.27];
    assert!((grid.seen_hz(3.0 * 10.75) - third_hz).abs() < 1e-9);
    assert!(belongs(third_hz, &tone, &grid) && !belongs(beside_hz, &tone, &grid));
    assert!(belongs(10.77, &tone, &grid) && !belongs(11.5, &tone, &grid));
}

/// A saw that changes its sign from plateau to plateau is no slow change.
#[test]
fn what_is_quick_stays() {
    let (samples, windows) = plateaus();
    let mut values = vec![0.0; samples.t_s.len()];
    for (i, [from, to]) in windows.iter().enumerate() {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        (*from..*to).for_each(|k| values[k] = sign * (samples.t_s[k] - samples.t_s[*from] - 191.0 / 64.0));
    }
    let before = values.clone();
    Slopes::new(&samples, &windows).unwrap().level(&mut values);
    assert_eq!(values, before);
}

/// The parts of a record of 200 rows hold every sample once, and no few lengths make up all of it.
#[test]
fn parts_of_a_record_are_unequal() {
    let rows: Vec<[usize; 2]> = (0..200).map(|i| [100 * i, 100 * (i + 1)]).collect();
    let parts = joined(&rows);
    assert_eq!((parts[0][0], parts[parts.len() - 1][1]), (0, 20_000));
    assert!(parts.windows(2).all(|w| w[0][1] == w[1][0]));
    let of_length = |rows: usize| parts.iter().filter(|[from, to]| to - from == 100 * rows).count();
    assert!((3..=8).all(|rows| (4..12).contains(&of_length(rows))), "{parts:?}");
}
