use super::*;
use crate::data::run::{Gap, Header, InputFile, ReadingUnit, Setting, SlowTable, Vector, VectorAccount, VectorSink};
use crate::data::units::{FieldCoil, Reading};
use crate::fit::random::Random;
use std::f64::consts::{LN_2, PI};

const START_S: f64 = 10.0;

/// A run of `count` samples whose counters stand in `skip` are lost; its setting lasts `lasts_s`.
struct Night {
    rate_hz: f64,
    count: u64,
    lost: Vec<std::ops::Range<u64>>,
    lasts_s: f64,
    temperatures: SlowTable,
}

impl Night {
    fn new(rate_hz: f64, count: u64) -> Self {
        Self { rate_hz, count, lost: Vec::new(), lasts_s: count as f64 / rate_hz, temperatures: SlowTable::default() }
    }

    fn record(&self, mut reading: impl FnMut(f64) -> [f64; 3]) -> (Record, Run) {
        let setting = Setting {
            t_start_s: START_S,
            t_end_s: START_S + self.lasts_s,
            field: FieldCoil([0.0; 3]),
            frequency_hz: 0.0,
            position: 1,
        };
        let header = Header {
            run: "26-01-01_00-00-00".to_owned(),
            start: "2026-01-01T00:00:00Z".parse().unwrap(),
            kind: Kind::ZeroField,
            configuration: String::new(),
            sensor: String::new(),
            mode: String::new(),
            sample_rate_hz: self.rate_hz,
            unit: ReadingUnit::Ent,
            field_source: String::new(),
            coil_correction: None,
            earthfield_compensation: Vec::new(),
        };
        let mut record = Record::default();
        record.begin(&header, &[setting]);
        let mut count = 0;
        let mut span_s = [f64::NAN; 2];
        for n in 0..self.count {
            let t_s = START_S + n as f64 / self.rate_hz;
            let value = reading(t_s - START_S);
            if !self.lost.iter().any(|lost| lost.contains(&n)) {
                record.vector(Vector { n: 7 + n, t_s, reading: Reading(value) });
                count += 1;
                span_s = [if count == 1 { t_s } else { span_s[0] }, t_s];
            }
        }
        let gap = |l: &std::ops::Range<u64>| Gap { line: 0, t_s: START_S + l.end as f64 / self.rate_hz, lost: l.end - l.start };
        let vectors = VectorAccount {
            count,
            lost: self.count - count,
            gaps: self.lost.iter().map(gap).collect(),
            gap_count: self.lost.len() as u64,
            span_s: Some(span_s),
            measured_rate_hz: Some(self.rate_hz),
            ..VectorAccount::default()
        };
        let run = Run {
            header,
            settings: vec![setting],
            blocks: Vec::new(),
            temperatures: self.temperatures.clone(),
            channels: SlowTable::default(),
            scalar: Vec::new(),
            vectors,
            input: InputFile { path: String::new(), size_bytes: 0, sha256: String::new() },
            findings: Vec::new(),
            exclusions: Vec::new(),
        };
        (record, run)
    }

    fn result(&self, order: usize, reading: impl FnMut(f64) -> [f64; 3]) -> Null {
        let (record, run) = self.record(reading);
        null(&run, record, &Instructions::default(), &Options { order, ..Options::default() }).unwrap()
    }
}

fn white(seed: u64, std: f64) -> impl FnMut() -> [f64; 3] {
    let mut random = Random::seeded(seed);
    move || std::array::from_fn(|_| std * random.gaussian())
}

/// 1/f noise as a sum of autoregressive processes, and its exact density.
struct Slow {
    parts: Vec<(f64, f64)>,
    state: Vec<[f64; 3]>,
    random: Random,
}

impl Slow {
    fn new(seed: u64, kick: f64) -> Self {
        let mut random = Random::seeded(seed);
        let parts: Vec<(f64, f64)> = (0..16)
            .map(|k| {
                let decay = (-(3f64.powi(-k))).exp();
                (decay, kick * (1.0 - decay * decay).sqrt())
            })
            .collect();
        let state = parts.iter().map(|_| std::array::from_fn(|_| kick * random.gaussian())).collect();
        Self { parts, state, random }
    }

    fn next(&mut self) -> [f64; 3] {
        for ((decay, kick), state) in self.parts.iter().zip(&mut self.state) {
            for value in state {
                *value = decay * *value + kick * self.random.gaussian();
            }
        }
        std::array::from_fn(|c| self.state.iter().map(|s| s[c]).sum())
    }

    /// `2/f_s Σ kick² / |1 - a exp(-2πi f/f_s)|²`.
    fn density(&self, f_hz: f64, rate_hz: f64) -> f64 {
        let cos = (2.0 * PI * f_hz / rate_hz).cos();
        2.0 / rate_hz * self.parts.iter().map(|(a, kick)| kick * kick / (1.0 - 2.0 * a * cos + a * a)).sum::<f64>()
    }
}

#[test]
fn white_noise_has_its_density_within_the_stated_limits() {
    // One-sided: s² = S f_s / 2.
    let (rate_hz, std) = (128.0, 0.5);
    let expected = std * (2.0f64 / rate_hz).sqrt();
    let (mut inside, mut sum, mut bands, mut held) = (0, 0.0, 0, 0);
    for seed in 0..8 {
        let mut noise = white(seed, std);
        let p = Night::new(rate_hz, 120_000).result(1, |_| noise());
        let d = p.found.density.unwrap();
        for c in 0..3 {
            inside += i32::from(d.low_ent_per_root_hz[c] < expected && expected < d.high_ent_per_root_hz[c]);
            sum += d.ent_per_root_hz[c] / expected;
            assert!((p.found.corner.white_ent_per_root_hz[c] / expected - 1.0).abs() < 0.01);
            assert!(p.found.corner.corner_hz[c] < 3.0 * p.found.corner.corner_std_hz[c] + 1e-4);
        }
        for (i, x) in p.found.spectrum.x_ent_per_root_hz.iter().enumerate() {
            bands += 1;
            held += i32::from(x * p.found.spectrum.low_factor[i] < expected && expected < x * p.found.spectrum.high_factor[i]);
        }
        assert!(p.found.line.is_empty(), "{:?}", p.found.line);
        assert!(
            p.found.spectrum.frequency_hz[0] < 4.0 / (120_000.0 / rate_hz / 2.0)
                && *p.found.spectrum.frequency_hz.last().unwrap() > 55.0
        );
    }
    assert!((sum / 24.0 - 1.0).abs() < 0.015, "{}", sum / 24.0);
    assert!(inside >= 20, "{inside} of 24 hold the density at 1 Hz");
    let part = f64::from(held) / f64::from(bands);
    assert!((0.92..0.98).contains(&part), "{part} of {bands} bands hold the density");
}

#[test]
fn slow_noise_has_its_density_at_every_frequency() {
    let rate_hz = 32.0;
    let (mut bands, mut held) = (0, 0);
    for seed in 0..4 {
        let mut slow = Slow::new(seed, 0.1);
        let p = Night::new(rate_hz, 200_000).result(1, |_| slow.next());
        for (i, f) in p.found.spectrum.frequency_hz.iter().enumerate() {
            let truth = slow.density(*f, rate_hz).sqrt();
            for x in [p.found.spectrum.x_ent_per_root_hz[i], p.found.spectrum.z_ent_per_root_hz[i]] {
                bands += 1;
                held += i32::from(x * p.found.spectrum.low_factor[i] < truth && truth < x * p.found.spectrum.high_factor[i]);
            }
        }
        assert!(p.found.line.is_empty(), "{:?}", p.found.line);
    }
    let part = f64::from(held) / f64::from(bands);
    assert!((0.91..0.99).contains(&part), "{part} of {bands} bands hold the density");
}

#[test]
fn a_line_has_its_frequency_and_amplitude() {
    for (seed, f_hz, amplitude) in [(1, 7.31, 0.05), (2, 20.0, 0.08), (3, 0.9, 0.2)] {
        let mut noise = white(seed, 0.3);
        let result = Night::new(128.0, 200_000).result(1, |t| {
            let line = amplitude * (2.0 * PI * f_hz * t + 0.3).sin();
            let mut sample = noise();
            sample[1] += line;
            sample
        });
        let p = result;
        let [line] = p.found.line.as_slice() else { panic!("{:?}", p.found.line) };
        assert_eq!(line.component, "y");
        assert!((line.frequency_hz - f_hz).abs() < line.resolution_hz, "{line:?}");
        assert!((line.amplitude_ent - amplitude).abs() < 3.5 * line.amplitude_std_ent, "{line:?}");
        assert!(line.amplitude_std_ent < 0.1 * amplitude, "{line:?}");
        // A line is no noise.
        let expected = 0.3 * (2.0f64 / 128.0).sqrt();
        assert!((p.found.density.unwrap().ent_per_root_hz[1] / expected - 1.0).abs() < 0.1);
    }
}

#[test]
fn a_strong_line_between_bins_leaves_the_noise_beside_it_as_it_is() {
    // Hann's side lobes of a line a hundred times the noise stand above it in ten bins and more.
    let expected = 0.1 * 0.5f64.sqrt();
    for (seed, amplitude, f_hz) in [(1, 1.0, 0.8), (2, 10.0, 0.8), (3, 10.0, 1.3312)] {
        let mut noise = white(seed, 0.1);
        let p = Night::new(4.0, 14_400).result(1, |t| noise().map(|v| v + amplitude * (2.0 * PI * f_hz * t + 0.3).sin()));
        let density = p.found.density.unwrap();
        for c in 0..3 {
            let std = density.std_ent_per_root_hz[c];
            assert!((density.ent_per_root_hz[c] - expected).abs() < 3.5 * std, "{amplitude}: {density:?}");
            let white = p.found.corner.white_ent_per_root_hz[c];
            assert!((white / expected - 1.0).abs() < 0.04, "{amplitude}: {white}");
        }
    }
}

/// A line in the lowest bins of the full rate leaves the slower stages below it to slow noise.
#[test]
fn a_strong_slow_line_leaves_slow_noise_below_it() {
    let corners = |amplitude: f64| {
        let (mut slow, mut noise) = (Slow::new(5, 0.1), white(6, 0.5));
        let line = |t: f64| amplitude * (2.0 * PI * 0.2013 * t + 0.3).sin();
        let both = |t: f64| {
            let (a, b) = (slow.next(), noise());
            [0, 1, 2].map(|c| a[c] + b[c] + line(t))
        };
        let found = Night::new(32.0, 400_000).result(1, both).found;
        let below = found.spectrum.frequency_hz.iter().filter(|f| **f < 0.1).count();
        (found.corner.corner_hz, found.corner.corner_std_hz, below)
    };
    let ((without, std, few), (with, _, many)) = (corners(0.0), corners(10.0));
    assert!(many * 10 >= few * 9 && few > 20, "{few} {many}");
    for c in 0..3 {
        assert!((with[c] - without[c]).abs() < 2.0 * std[c], "{with:?} {without:?} {std:?}");
    }
}

#[test]
fn allan_deviations_of_white_noise_and_of_a_drift_are_the_closed_forms() {
    let rate_hz = 64.0;
    let mut noise = white(5, 0.2);
    let a = Night::new(rate_hz, 150_000).result(1, |_| noise()).found.allan;
    let mut held = 0;
    for (i, tau) in a.tau_s.iter().enumerate() {
        let expected = 0.2 / (tau * rate_hz).sqrt();
        for v in [a.x_ent[i], a.y_ent[i], a.z_ent[i]] {
            held += usize::from(v * a.low_factor[i] < expected && expected < v * a.high_factor[i]);
            assert!((v / expected - 1.0).abs() < 0.6, "{tau} s: {v} {expected}");
        }
    }
    assert!(a.tau_s.len() >= 15 && held as f64 >= 0.88 * 3.0 * a.tau_s.len() as f64, "{held} of {}", 3 * a.tau_s.len());
    let mut noise = white(6, 1e-9);
    let a = Night::new(rate_hz, 150_000).result(1, |t| noise().map(|n| n + 0.003 * t)).found.allan;
    for (tau, v) in a.tau_s.iter().zip(&a.y_ent).filter(|(tau, _)| **tau > 1.0) {
        assert!((v / (0.003 * tau / 2f64.sqrt()) - 1.0).abs() < 1e-6, "{tau} s: {v}");
    }
    // 1/f noise of density A/f is level at sqrt(2 ln2 A).
    let mut slow = Slow::new(7, 0.1);
    let level = (2.0 * LN_2 * 0.03 * slow.density(0.03, rate_hz)).sqrt();
    let a = Night::new(rate_hz, 150_000).result(1, |_| slow.next()).found.allan;
    for (i, tau) in a.tau_s.iter().enumerate().filter(|(_, tau)| (4.0..40.0).contains(*tau)) {
        assert!((a.x_ent[i] / level - 1.0).abs() < 0.2, "{tau} s: {} {level}", a.x_ent[i]);
    }
}

/// Part of the intervals of 95 % that hold the drift.
fn coverage(mut noise: impl FnMut(u64) -> Box<dyn FnMut() -> [f64; 3]>) -> f64 {
    const SEEDS: u64 = 50;
    let truth = [0.7, -0.2, 0.0];
    let mut held = 0;
    for seed in 0..SEEDS {
        let mut noise = noise(seed);
        let o = Night::new(4.0, 14_400)
            .result(1, |t| {
                let n = noise();
                std::array::from_fn(|c| 100.0 + truth[c] * t / 3600.0 + n[c])
            })
            .found
            .offset;
        for c in 0..3 {
            held += u32::from((o.drift_ent_per_h[0][c] - truth[c]).abs() < 1.96 * o.drift_std_ent_per_h[0][c]);
        }
    }
    f64::from(held) / (3 * SEEDS) as f64
}

#[test]
fn intervals_of_the_drift_hold_it() {
    let with_white = coverage(|seed| Box::new(white(seed, 0.3)));
    assert!((0.90..=0.995).contains(&with_white), "white noise: {with_white}");
    let with_slow = coverage(|seed| {
        let mut slow = Slow::new(seed, 0.1);
        Box::new(move || slow.next())
    });
    assert!((0.88..=1.0).contains(&with_slow), "1/f noise: {with_slow}");
}

#[test]
fn a_drift_of_higher_order_is_found_in_its_units() {
    let mut noise = white(3, 1e-6);
    let o = Night::new(4.0, 14_400)
        .result(3, |t| {
            let h = (t - 1799.875) / 3600.0;
            noise().map(|n| n + 5.0 - 2.0 * h + 3.0 * h * h + 7.0 * h * h * h)
        })
        .found
        .offset;
    assert_eq!(o.order, 3);
    // A mean over a row of 113 s differs from the value in its middle by 1e-4 of the curvature.
    assert!((o.mean_ent[0] - 5.0).abs() < 1e-3);
    for (found, wanted) in o.drift_ent_per_h.iter().zip([-2.0, 3.0, 7.0]) {
        assert!((found[2] - wanted).abs() < 5e-3, "{found:?} {wanted}");
    }
}

#[test]
fn stops_are_found_where_they_are() {
    let mut noise = white(1, 0.3);
    let mut night = Night::new(16.0, 64_000);
    night.lost = vec![20_000..24_000, 40_000..40_010];
    night.lasts_s = 5000.0;
    let result = night.result(1, |t| if (3000.0..3100.0).contains(&t) { [1.0, 2.0, 3.0] } else { noise() });
    let p = result;
    let found: Vec<(&str, f64, f64)> =
        p.found.stop.iter().map(|s| (s.what.as_str(), s.from_s - START_S, s.until_s - START_S)).collect();
    assert_eq!(found.len(), 3, "{found:?}");
    assert_eq!(found[0], ("samples are missing", 1250.0, 1500.0));
    assert!(found[1].0.contains("stand still") && (found[1].1 - 3000.0).abs() < 0.1 && (found[1].2 - 3100.0).abs() < 0.1);
    assert!(found[2].0.contains("end before") && (found[2].1 - 64_000.0 / 16.0).abs() < 0.1 && found[2].2 == 5000.0);
    assert!(p.notes.iter().any(|n| n.text.starts_with("STOP the data end before")));
    assert_eq!((p.found.record.bridged, p.found.record.lost), (10, 4010));
}

#[test]
fn gaps_leave_the_density_as_it_is() {
    let expected = 0.3 * (2.0f64 / 32.0).sqrt();
    let mut noise = white(2, 0.3);
    let mut night = Night::new(32.0, 300_000);
    // Short ones now and then, and one of three minutes.
    night.lost = (1..30).map(|k| k * 9_000..k * 9_000 + 16).chain(std::iter::once(141_000..147_000)).collect();
    let s = night.result(1, |_| noise()).found.spectrum;
    let within = s
        .x_ent_per_root_hz
        .iter()
        .enumerate()
        .filter(|(i, x)| **x * s.low_factor[*i] < expected && expected < **x * s.high_factor[*i])
        .count();
    assert!(within as f64 > 0.9 * s.frequency_hz.len() as f64, "{within} of {}", s.frequency_hz.len());
    assert!(s.frequency_hz[0] < 1e-3);
}

#[test]
fn the_coefficient_of_the_temperature_comes_back() {
    let temperature = |t: f64| 20.0 + 15.0 * (t / 7000.0).sin() - t / 3600.0;
    let mut held = 0;
    for seed in 0..10 {
        let mut night = Night::new(4.0, 60_000);
        let times: Vec<f64> = (0..500).map(|i| START_S + 30.0 * f64::from(i)).collect();
        night.temperatures = SlowTable {
            names: vec!["T59".to_owned()],
            values: vec![times.iter().map(|t| temperature(t - START_S)).collect()],
            t_s: times,
        };
        let mut slow = Slow::new(seed, 0.1);
        let p = night.result(1, |t| {
            let n = slow.next();
            [n[0] + 0.3 * temperature(t), n[1], n[2] - 0.1 * temperature(t)]
        });
        let part = &p.found.channel[0];
        assert_eq!((part.name.as_str(), part.unit.as_str()), ("T59", "K"));
        for (c, truth) in [0.3, 0.0, -0.1].into_iter().enumerate() {
            held += usize::from((part.coefficient_ent[c] - truth).abs() < 1.96 * part.coefficient_std_ent[c]);
            assert!(part.coefficient_std_ent[c] < 0.1);
        }
        assert!(part.correlation[0] > 0.8);
    }
    assert!(held >= 26, "{held} of 30");
}

#[test]
fn memory_stays_bounded_however_long_the_record_is() {
    let (mut record, _) = Night::new(128.0, 2048).record(|_| [0.0; 3]);
    let mut noise = white(4, 0.5);
    // Thirty pieces over 30 million samples: more than the bins and the slow record hold at first.
    for piece in 1..30u64 {
        for i in 0..6000 {
            let n = 7 + piece * 1_000_000 + i;
            record.vector(Vector { n, t_s: START_S + n as f64 / 128.0, reading: Reading(noise()) });
        }
    }
    let kept = record.finish();
    assert_eq!((kept.bin_samples, kept.slow_samples), (256, 256));
    assert!(kept.bins.len() < 1 << 17 && kept.slow[0].len() <= 1 << 17);
    assert!(kept.head.is_none());
    let samples: u64 = kept.bins.iter().map(|b| u64::from(b.count)).sum();
    assert_eq!(samples, 2048 + 29 * 6000);
    let density = kept.welch.density(128.0).unwrap();
    let mean = density.power[0][100..1900].iter().sum::<f64>() / 1800.0;
    assert!((mean / (0.25 * 2.0 / 128.0) - 1.0).abs() < 0.03, "{mean}");
}

#[test]
fn a_short_record_has_a_spectrum_too() {
    let mut noise = white(9, 0.5);
    let p = Night::new(4.0, 4_000).result(1, |_| noise());
    let expected = 0.5 * (2.0f64 / 4.0).sqrt();
    let d = p.found.density.unwrap();
    assert!((d.ent_per_root_hz[0] / expected - 1.0).abs() < 0.2, "{d:?}");
    assert!(p.found.spectrum.frequency_hz[0] < 0.01);
}

#[test]
fn what_is_no_zero_field_run_is_refused() {
    let refusal = |change: &dyn Fn(&mut Run)| {
        let mut noise = white(1, 1.0);
        let (record, mut run) = Night::new(4.0, 2000).record(|_| noise());
        change(&mut run);
        null(&run, record, &Instructions::default(), &Options::default()).unwrap_err()
    };
    assert_eq!(refusal(&|run| run.header.kind = Kind::Offset), NullError::Kind(Kind::Offset));
    assert_eq!(refusal(&|run| run.settings[0].field.0[1] = 5.0), NullError::Field(1));
    assert_eq!(refusal(&|run| run.settings.push(Setting { position: 2, ..run.settings[0] })), NullError::Positions);
    assert_eq!(refusal(&|run| run.vectors.count = 100), NullError::TooShort(100));
}
