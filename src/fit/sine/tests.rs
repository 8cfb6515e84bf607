use super::*;
use crate::fit::random::Random;

/// Ornstein-Uhlenbeck processes an octave apart: noise with a spectrum near 1/f, unit variance per process.
struct Pink(Vec<f64>);

impl Pink {
    fn new(gauss: &mut Random) -> Self {
        Self((0..18).map(|_| gauss.gaussian()).collect())
    }

    fn next(&mut self, gauss: &mut Random) -> f64 {
        for (i, x) in self.0.iter_mut().enumerate() {
            let keep = (-(0.5f64.powi(i as i32))).exp();
            *x = keep * *x + (1.0 - keep * keep).sqrt() * gauss.gaussian();
        }
        self.0.iter().sum()
    }
}

fn wave(n: &[u64], [amplitude, phase_rad, offset]: [f64; 3], frequency_hz: f64, rate_hz: f64) -> Vec<f64> {
    n.iter().map(|&n| amplitude * (phase(frequency_hz, rate_hz, n) + phase_rad).sin() + offset).collect()
}

fn noisy(mut y: Vec<f64>, std: f64, gauss: &mut Random) -> Vec<f64> {
    y.iter_mut().for_each(|y| *y += std * gauss.gaussian());
    y
}

fn counters(range: std::ops::Range<u64>) -> Vec<u64> {
    range.collect()
}

/// Root mean square and share within one standard deviation.
fn coverage(pulls: &[f64]) -> (f64, f64) {
    let count = pulls.len() as f64;
    let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / count).sqrt();
    (rms, pulls.iter().filter(|p| p.abs() < 1.0).count() as f64 / count)
}

mod fits {
    use super::*;

    #[test]
    fn phases_of_large_counters_and_frequencies_are_exact() {
        // 1/4 Hz at 1 Hz: quarters of a cycle.
        assert_eq!([0, 1, 2, 3].map(|n| phase(0.25, 1.0, n)), [0.0, 0.5 * PI, PI, -0.5 * PI]);
        // Binary fractions: (1000 + 2⁻²⁰) · 999 999 937 / 128 cycles, whose fraction integers give.
        let (numerator, denominator) = ((1000u128 << 20) + 1, 128u128 << 20);
        let n = 999_999_937u64;
        let rest = (numerator * u128::from(n)) % denominator;
        let mut expected = rest as f64 / denominator as f64;
        expected -= expected.round();
        let found = phase(1000.0 + 2f64.powi(-20), 128.0, n);
        assert!((found - TAU * expected).abs() < 1e-15, "{found} {}", TAU * expected);
        // A rate which is no binary fraction: 1000 / 127.9991 with both numbers as they are in f64.
        let (f, rate) = (158.489_319_246_f64, 127.9991_f64);
        let bits = |x: f64| ((x * 2f64.powi(46)) as u128, 2f64.powi(46));
        assert_eq!(bits(f).0 as f64 / bits(f).1, f);
        let (p, q) = (bits(f).0 * u128::from(n), bits(rate).0);
        let mut expected = (p % q) as f64 / q as f64;
        expected -= expected.round();
        assert!((phase(f, rate, n) - TAU * expected).abs() < 1e-15);
        let [s, c] = Oscillator::new(f, rate).at(n);
        assert!((s - (TAU * expected).sin()).abs() < 5e-16 && (c - (TAU * expected).cos()).abs() < 5e-16);
    }

    #[test]
    fn a_sampled_sine_has_its_closed_form() {
        // Eight samples of one cycle: sine, cosine and one are orthogonal with squares 4, 4, 8.
        let n = counters(0..8);
        let mut y = wave(&n, [5.0, 0.6435011087932844, 7.0], 1.0, 8.0);
        // An alternating disturbance is orthogonal to all three: rss = 8 · 0.25.
        y.iter_mut().zip(0..).for_each(|(y, i)| *y += if i % 2 == 0 { 0.5 } else { -0.5 });
        let fit = three(&n, &y, 1.0, 8.0).unwrap();
        for (found, expected) in [
            (fit.sin, 4.0),
            (fit.cos, 3.0),
            (fit.offset, 7.0),
            (fit.amplitude, 5.0),
            (fit.phase_rad, 0.75_f64.atan()),
            (fit.rss, 2.0),
            (fit.residual_std, 0.4_f64.sqrt()),
            (fit.amplitude_std, 0.1_f64.sqrt()),
            (fit.phase_std_rad, 0.1_f64.sqrt() / 5.0),
            (fit.offset_std, 0.05_f64.sqrt()),
        ] {
            assert!((found - expected).abs() < 1e-14, "{found} {expected}");
        }
        assert_eq!((fit.dof, fit.frequency_std_hz, fit.covariance.nrows()), (5, 0.0, 3));
        assert!(fit.residuals.iter().zip(0..).all(|(r, i)| (r - [0.5, -0.5][i % 2]).abs() < 1e-14));
    }

    #[test]
    fn a_sine_with_gaps_above_the_rate_is_found_without_noise() {
        let n: Vec<u64> = (5_000..9_000).filter(|n| !(6_001..6_500).contains(n) && n % 7 != 3).collect();
        let y = wave(&n, [250.0, -2.0, 40_000.0], 794.328_234_724, 127.9991);
        let fit = four(&n, &y, 794.32, 127.9991).unwrap();
        assert!((fit.frequency_hz - 794.328_234_724).abs() < 1e-11);
        assert!((fit.amplitude - 250.0).abs() < 1e-10 && (fit.phase_rad + 2.0).abs() < 1e-9);
        assert!(fit.residual_std < 1e-11);
        let fit = three(&n, &y, 794.328_234_724, 127.9991).unwrap();
        assert!((fit.amplitude - 250.0).abs() < 1e-11 && (fit.phase_rad + 2.0).abs() < 1e-13);
        assert!((fit.offset - 40_000.0).abs() < 1e-10);
    }

    #[test]
    fn a_constant_has_no_amplitude() {
        let (n, y) = (counters(0..100), [3.0; 100]);
        let fit = three(&n, &y, 10.0, 128.0).unwrap();
        assert_eq!((fit.amplitude, fit.offset, fit.amplitude_std), (0.0, 3.0, 0.0));
        assert!(matches!(four(&n, &y, 10.0, 128.0), Err(SineRefusal::Undetermined { .. })));
    }

    #[test]
    fn what_cannot_be_fitted_is_refused_with_its_numbers() {
        let (n, y) = (counters(0..1280), vec![0.0; 1280]);
        let error = three(&n, &y, 0.05, 128.0).unwrap_err();
        assert_eq!(error.to_string(), "the samples span 0.500 cycles of 0.05 Hz, at least 0.8 are needed");
        assert!(three(&n, &y, 0.09, 128.0).is_ok());
        let error = three(&n, &y, 256.0, 128.0).unwrap_err();
        assert!(matches!(error, SineRefusal::Alias { alias_hz: 0.0, limit_hz: 0.0, .. }), "{error}");
        let error = three(&n, &y, 192.05, 128.0).unwrap_err();
        assert_eq!(
            error.to_string(),
            "192.05 Hz at 128.000000 samples per second looks like 63.950000 Hz, 0.500 cycles over the samples away from 64.000000 Hz: sine and \
             cosine cannot be told apart"
        );
        assert!(three(&n, &y, 192.09, 128.0).is_ok());
        assert_eq!(three(&n[..3], &y[..3], 50.0, 128.0).unwrap_err().to_string(), "3 samples are given, 4 needed");
        assert!(matches!(four(&n[..4], &y[..4], 50.0, 128.0), Err(SineRefusal::TooFew { needed: 5, .. })));
        assert!(matches!(three(&n, &y[1..], 50.0, 128.0), Err(SineRefusal::Length { counters: 1280, readings: 1279 })));
        let mut holed = y.clone();
        holed[7] = f64::NAN;
        assert_eq!(three(&n, &holed, 50.0, 128.0), Err(SineRefusal::NotFinite { row: 7 }));
        let mut back = n.clone();
        back[9] = 8;
        assert_eq!(three(&back, &y, 50.0, 128.0), Err(SineRefusal::Counter { row: 9 }));
        for (f, rate) in
            [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (f64::NAN, 1.0), (1.0, f64::NAN), (f64::INFINITY, 1.0), (1e300, 1e-300)]
        {
            assert!(matches!(three(&n, &y, f, rate), Err(SineRefusal::Frequency { .. })), "{f} {rate}");
        }
        // One sample per cycle, always at the same phase.
        let sparse: Vec<u64> = (0..1280).map(|i| 128 * i).collect();
        let error = three(&sparse, &y, 1.0, 128.0).unwrap_err();
        assert!(matches!(error, SineRefusal::Undetermined { samples: 1280, .. }));
        let y = wave(&n, [1.0, 0.0, 0.0], 20.0, 128.0);
        assert!(matches!(four(&n, &y, 30.0, 128.0), Err(SineRefusal::NotSettled { .. })));
        let huge: Vec<f64> = (0..1280).map(|i| if i % 3 == 0 { 1e308 } else { -1e308 }).collect();
        assert!(matches!(three(&n, &huge, 50.0, 128.0), Err(SineRefusal::NotFinite { .. })));
    }

    #[test]
    fn standard_deviations_cover_white_noise() {
        let (n, mut gauss) = (counters(1000..1230), Random::seeded(1));
        let clean = wave(&n, [10.0, 0.8, 3.0], 171.3, 127.9991);
        let (mut fixed, mut free) = (Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
        for _ in 0..1000 {
            let y = noisy(clean.clone(), 0.5, &mut gauss);
            let fit = three(&n, &y, 171.3, 127.9991).unwrap();
            fixed.push((fit.amplitude - 10.0) / fit.amplitude_std);
            let fit = four(&n, &y, 171.3, 127.9991).unwrap();
            free[0].push((fit.amplitude - 10.0) / fit.amplitude_std);
            free[1].push((fit.phase_rad - 0.8) / fit.phase_std_rad);
            free[2].push((fit.frequency_hz - 171.3) / fit.frequency_std_hz);
        }
        for pulls in free.iter().chain([&fixed]) {
            let (rms, share) = coverage(pulls);
            println!("rms {rms:.3}, within one std {share:.3}");
            // Standard errors 0.022 and 0.015.
            assert!((rms - 1.0).abs() < 0.08 && (share - 0.683).abs() < 0.05, "{rms} {share}");
        }
    }

    /// Root mean square of A and B over noise against the root mean square of what the noise near the frequency says.
    fn noise_ratio(frequency_hz: f64, count: u64, mut next: impl FnMut(&mut Random) -> f64) -> (f64, f64) {
        let (n, mut gauss) = (counters(0..count), Random::seeded(5));
        let (mut scatter, mut local, mut white) = (0.0, 0.0, 0.0);
        for _ in 0..150 {
            let y: Vec<f64> = n.iter().map(|_| next(&mut gauss)).collect();
            let fit = three(&n, &y, frequency_hz, 128.0).unwrap();
            scatter += 0.5 * (fit.sin.powi(2) + fit.cos.powi(2));
            local += local_noise_std(&n, &fit.residuals, frequency_hz, 128.0).unwrap().powi(2);
            white += fit.covariance[(0, 0)];
        }
        ((local / scatter).sqrt(), (white / scatter).sqrt())
    }

    #[test]
    fn noise_near_the_frequency_is_the_noise_of_the_amplitude() {
        for frequency_hz in [0.125, 0.5, 2.3, 41.0, 1000.0] {
            let (white, _) = noise_ratio(frequency_hz, 1024, Random::gaussian);
            let mut pink = Pink::new(&mut Random::seeded(9));
            let (slow, plain) = noise_ratio(frequency_hz, 1024, |gauss| pink.next(gauss));
            println!("{frequency_hz} Hz: white {white:.3}, 1/f {slow:.3} (from all residuals {plain:.3})");
            // 150 runs: the scatter has a standard error of 4 %.
            let tolerance = if frequency_hz < 1.0 { 0.25 } else { 0.12 };
            assert!((white - 1.0).abs() < tolerance && (slow - 1.0).abs() < tolerance, "{frequency_hz} Hz: {white} {slow}");
        }
        let n = counters(0..1024);
        let y = vec![0.0; 1024];
        assert_eq!(local_noise_std(&n, &y, 1.0, 128.0), Some(0.0));
        assert_eq!(local_noise_std(&n, &y, 128.0, 128.0), None);
        assert_eq!(local_noise_std(&n[..10], &y[..10], 30.0, 128.0), None);
        let sparse: Vec<u64> = n.iter().map(|n| 3 * n).collect();
        assert_eq!(local_noise_std(&sparse, &y, 10.0, 128.0), None);
    }
}

mod noise {
    use super::*;

    /// Short settings, aliases near 0 and near half of the rate among them.
    const FREQUENCIES_HZ: [f64; 14] = [0.25, 0.5, 1.0, 3.3, 7.9, 20.0, 41.0, 63.2, 100.0, 127.3, 251.0, 316.0, 501.0, 1000.0];
    const COUNT: u64 = 768;

    /// Pulls of amplitude and phase of every setting for noise of a source.
    fn pulls(runs: usize, mut next: impl FnMut(&mut Random) -> f64) -> Vec<Vec<f64>> {
        let mut gauss = Random::seeded(6);
        let mut pulls = vec![Vec::new(); FREQUENCIES_HZ.len()];
        for _ in 0..runs {
            let records: Vec<(Vec<u64>, Sine)> = (0u64..)
                .zip(FREQUENCIES_HZ)
                .map(|(i, frequency_hz)| {
                    let n = counters(i * COUNT..(i + 1) * COUNT);
                    let mut y = wave(&n, [600.0, 0.7, 5.0], frequency_hz, 128.0);
                    y.iter_mut().for_each(|y| *y += 0.1 * next(&mut gauss));
                    let fit = three(&n, &y, frequency_hz, 128.0).unwrap();
                    (n, fit)
                })
                .collect();
            let residues: Vec<Residue> = records
                .iter()
                .map(|(n, fit)| Residue {
                    n,
                    residuals: &fit.residuals,
                    frequency_hz: fit.frequency_hz,
                    phase_rad: fit.phase_rad,
                })
                .collect();
            for ((near, (_, fit)), pulls) in noise_near(&residues, 128.0).into_iter().zip(&records).zip(&mut pulls) {
                let [amplitude, phase] = near.unwrap().map(|near| near / fit.residual_std);
                pulls.push((fit.amplitude - 600.0) / (amplitude * fit.amplitude_std));
                pulls.push((fit.phase_rad - 0.7) / (phase * fit.phase_std_rad));
            }
        }
        pulls
    }

    fn check_coverage(pulls: &[Vec<f64>]) {
        for (frequency_hz, pulls) in FREQUENCIES_HZ.iter().zip(pulls) {
            let (rms, _) = coverage(pulls);
            // 200 values: a standard error of 0.05, and one spectrum for processes an octave apart is good to a tenth.
            assert!((0.8..1.25).contains(&rms), "{frequency_hz} Hz: {rms}");
        }
        let all: Vec<f64> = pulls.iter().flatten().copied().collect();
        let within = all.iter().filter(|pull| pull.abs() < 1.96).count() as f64 / all.len() as f64;
        assert!((0.935..0.965).contains(&within), "{within}");
    }

    #[test]
    fn many_sines_tell_the_noise_of_each() {
        check_coverage(&pulls(100, Random::gaussian));
        let mut pink = Pink::new(&mut Random::seeded(9));
        check_coverage(&pulls(100, |gauss| pink.next(gauss)));
    }

    #[test]
    fn a_setting_with_more_noise_counts_by_itself() {
        let mut gauss = Random::seeded(8);
        let n: Vec<Vec<u64>> = (0..8).map(|i| counters(i * 1024..(i + 1) * 1024)).collect();
        let residuals: Vec<Vec<f64>> =
            (0..8).map(|i| (0..1024).map(|_| if i == 5 { 10.0 } else { 1.0 } * gauss.gaussian()).collect()).collect();
        let residues: Vec<Residue> = (0..8)
            .map(|i| Residue { n: &n[i], residuals: &residuals[i], frequency_hz: 5.0 + 6.0 * i as f64, phase_rad: 0.0 })
            .collect();
        for (i, near) in noise_near(&residues, 128.0).into_iter().enumerate() {
            let truth = if i == 5 { 10.0 } else { 1.0 };
            let tolerance = if i == 5 { 0.4 } else { 0.15 };
            assert!(near.unwrap().iter().all(|near| (near / truth - 1.0).abs() < tolerance), "{i}: {near:?}");
        }
        let silent = vec![0.0; 1024];
        let exact = Residue { n: &n[0], residuals: &silent, frequency_hz: 5.0, phase_rad: 0.0 };
        assert_eq!(noise_near(&[exact], 128.0), [Some([0.0; 2])]);
        assert_eq!(noise_near(&[Residue { frequency_hz: 128.0, ..exact }], 128.0), [None]);
    }
}

mod segments {
    use super::*;

    /// Segments of equal length in counters, oscillating at the frequency.
    fn split(n: &[u64], y: &[f64], frequency_hz: f64, parts: u64) -> Vec<Sums> {
        let mut oscillator = Oscillator::new(frequency_hz, 128.0);
        let length = (n[n.len() - 1] + 1 - n[0]).div_ceil(parts);
        let mut sums = vec![Sums::new(y[0]); parts as usize];
        for (&i, &y) in n.iter().zip(y) {
            sums[((i - n[0]) / length) as usize].add(oscillator.at(i), y);
        }
        sums
    }

    #[test]
    fn merged_segments_are_solved_like_their_samples() {
        let (n, mut gauss) = (counters(300..4396), Random::seeded(2));
        let y = noisy(wave(&n, [60_000.0, 1.0, 20_000.0], 3.3, 128.0), 0.02, &mut gauss);
        let segments = split(&n, &y, 3.3, 64);
        let mut total = Sums::new(-1_000.0);
        segments.iter().for_each(|segment| total.merge(segment));
        let fit = three(&n, &y, 3.3, 128.0).unwrap();
        let (sin, cos, offset, rss) = total.solve().unwrap();
        assert_eq!(total.count(), 4096);
        for (found, expected) in [(sin, fit.sin), (cos, fit.cos), (offset, fit.offset)] {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
        println!("rss {rss} {}", fit.rss);
        assert!((rss / fit.rss - 1.0).abs() < 1e-4, "{rss} {}", fit.rss);
        assert!(Sums::new(0.0).solve().is_none());
        assert!(segments[0].solve().is_some());
    }

    #[test]
    fn an_undamaged_setting_is_kept_whole() {
        let (n, mut gauss) = (counters(0..12 * 128), Random::seeded(3));
        for seed in 0..50 {
            let frequency_hz = [0.1, 1.3, 30.0, 1000.0][seed % 4];
            let y = noisy(wave(&n, [900.0, 0.1 * seed as f64, 3.0], frequency_hz, 128.0), 0.05, &mut gauss);
            assert_eq!(coherent(&split(&n, &y, frequency_hz, 64), 0.05, 1.2, 8), Some(0..64));
        }
    }

    #[test]
    fn damage_is_left_out() {
        let (n, mut gauss) = (counters(0..12 * 128), Random::seeded(4));
        let clean = |gauss: &mut Random| noisy(wave(&n, [900.0, 0.4, 3.0], 7.3, 128.0), 0.05, gauss);
        // One sample lost after sample 1000, that is within segment 41, and not counted.
        let mut slipped = clean(&mut gauss);
        slipped.remove(1000);
        slipped.push(slipped[0]);
        let kept = split(&n[..1535], &slipped[..1535], 7.3, 64);
        assert_eq!(coherent(&kept, 0.05, 1.2, 8), Some(0..41));
        // The setting before lasts for 200 samples more, that is into segment 8.
        let mut late = clean(&mut gauss);
        late[..200].copy_from_slice(&wave(&n[..200], [900.0, 0.0, 3.0], 9.0, 128.0));
        assert_eq!(coherent(&split(&n, &late, 7.3, 64), 0.05, 1.2, 8), Some(9..64));
        // A burst.
        let mut burst = clean(&mut gauss);
        burst[600..610].iter_mut().for_each(|y| *y += 5.0);
        assert_eq!(coherent(&split(&n, &burst, 7.3, 64), 0.05, 1.2, 8), Some(26..64));
        // Samples missing and counted do no harm.
        let with_gap: Vec<u64> = n.iter().copied().filter(|n| !(500..600).contains(n)).collect();
        let y = noisy(wave(&with_gap, [900.0, 0.4, 3.0], 7.3, 128.0), 0.05, &mut gauss);
        assert_eq!(coherent(&split(&with_gap, &y, 7.3, 64), 0.05, 1.2, 8), Some(0..64));
        // Nothing but noise above the floor, nothing at all, and a NaN.
        let noise = noisy(vec![0.0; n.len()], 1.0, &mut gauss);
        assert_eq!(coherent(&split(&n, &noise, 7.3, 64), 0.05, 1.2, 8), None);
        assert_eq!(coherent(&[], 0.05, 1.2, 8), None);
        let mut holed = clean(&mut gauss);
        holed[700] = f64::NAN;
        assert_eq!(coherent(&split(&n, &holed, 7.3, 64), 0.05, 1.2, 8), Some(30..64));
    }
}

mod rates {
    use super::*;

    const TRUE_HZ: f64 = 127.9991;

    /// A setting: counters, readings, frequency.
    type Samples = (Vec<u64>, Vec<f64>, f64);

    fn packets(samples: &[Samples]) -> Vec<Packet<'_>> {
        samples.iter().map(|(n, y, frequency_hz)| Packet { n, y, frequency_hz: *frequency_hz, least_std: 0.0 }).collect()
    }

    /// Ten frequencies per decade from 1000 Hz down, every `stride`-th, one after the other: three cycles, at least `least_s`.
    fn sweep(stride: usize, lowest_hz: f64, least_s: f64, noise: f64, gauss: &mut Random) -> Vec<Samples> {
        let (mut at, mut all) = (0, Vec::new());
        for k in (0..=40).step_by(stride) {
            let frequency_hz = 10f64.powf(3.0 - 0.1 * k as f64);
            if frequency_hz < lowest_hz {
                break;
            }
            let count = (TRUE_HZ * least_s.max(3.0 / frequency_hz)) as u64;
            let n = counters(at..at + count);
            at += count + 100;
            let truth = [1000.0 / (1.0 + (frequency_hz / 60.0).powi(2)).sqrt(), gauss.gaussian(), 3.0];
            let y = noisy(wave(&n, truth, frequency_hz, TRUE_HZ), noise, gauss);
            all.push((n, y, frequency_hz));
        }
        all
    }

    #[test]
    fn a_sweep_gives_the_rate() {
        let mut gauss = Random::seeded(1);
        let samples = sweep(1, 0.09, 12.0, 0.05, &mut gauss);
        assert_eq!(samples.len(), 41);
        for start in [128.0, TRUE_HZ * (1.0 + 5e-4), TRUE_HZ * (1.0 - 9.9e-4)] {
            let rate = common_rate(&packets(&samples), start).unwrap();
            println!("{start}: {} ± {:.2e}, {:?}", rate.rate_hz - TRUE_HZ, rate.std_hz, rate.runner_up);
            assert!((rate.rate_hz - TRUE_HZ).abs() < 3.0 * rate.std_hz, "{} {}", rate.rate_hz - TRUE_HZ, rate.std_hz);
            assert!(rate.std_hz < 1e-7 && rate.packets.iter().filter(|p| p.verdict == Verdict::Used).count() >= 38);
            assert!(rate.runner_up.is_none_or(|r| r.chi_square_excess > 1e6));
            assert!(rate.drift.is_some_and(|drift| drift.hz_per_s.abs() < 4.0 * drift.std_hz_per_s));
        }
        let error = common_rate(&packets(&samples), TRUE_HZ * 1.002).unwrap_err();
        let message = "the best sample rate, 127.999100 Hz, is more than 0.1 % away from 128.2550982 Hz";
        assert_eq!(error.to_string(), message);
    }

    #[test]
    fn its_standard_deviation_is_its_scatter() {
        let (mut pulls, mut drifts) = (Vec::new(), Vec::new());
        for seed in 0..200 {
            let samples = sweep(5, 1.0, 1.0, 0.05, &mut Random::seeded(100 + seed));
            let rate = common_rate(&packets(&samples), 128.0).unwrap();
            pulls.push((rate.rate_hz - TRUE_HZ) / rate.std_hz);
            let drift = rate.drift.unwrap();
            drifts.push(drift.hz_per_s / drift.std_hz_per_s);
        }
        for pulls in [&pulls, &drifts] {
            let (rms, share) = coverage(pulls);
            println!("rms {rms:.3}, within one std {share:.3}");
            // Standard errors 0.05 and 0.033.
            assert!((rms - 1.0).abs() < 0.18 && (share - 0.683).abs() < 0.11, "{rms} {share}");
        }
    }

    #[test]
    fn gaps_and_large_counters_do_no_harm() {
        let mut samples = sweep(5, 1.0, 12.0, 0.05, &mut Random::seeded(3));
        for (n, y, _) in &mut samples {
            let kept = (0..n.len()).filter(|i| !(300..500).contains(i) && i % 11 != 0);
            // Counting from elsewhere changes the phases, which are free.
            (*n, *y) = kept.map(|i| (n[i] + 1_000_000_000, y[i])).unzip();
        }
        let rate = common_rate(&packets(&samples), 128.0).unwrap();
        assert!((rate.rate_hz - TRUE_HZ).abs() < 3.0 * rate.std_hz, "{} {}", rate.rate_hz - TRUE_HZ, rate.std_hz);
    }

    #[test]
    fn packets_which_disagree_are_named_and_left_out() {
        let mut samples = sweep(2, 1.0, 12.0, 0.05, &mut Random::seeded(4));
        // One sample lost and not counted, a wrong frequency, and the worst of all readings.
        samples[1].1.remove(700);
        samples[1].0.pop();
        samples[4].2 *= 1.0 + 2e-5;
        samples[6].1[5] = 1e4;
        samples[9].1.iter_mut().for_each(|y| *y = 7.0);
        let rate = common_rate(&packets(&samples), 128.0).unwrap();
        let verdicts: Vec<&Verdict> = rate.packets.iter().map(|packet| &packet.verdict).collect();
        assert!(matches!(verdicts[1], Verdict::Disagrees { .. }) && matches!(verdicts[4], Verdict::Disagrees { .. }));
        assert!(matches!(verdicts[9], Verdict::Refused(SineRefusal::Undetermined { .. })) && rate.packets[9].rate_hz.is_nan());
        for i in (0..verdicts.len()).filter(|i| ![1, 4, 9].contains(i)) {
            assert_eq!(verdicts[i], &Verdict::Used, "{i}");
        }
        assert!((rate.rate_hz - TRUE_HZ).abs() < 3.0 * rate.std_hz, "{} {}", rate.rate_hz - TRUE_HZ, rate.std_hz);
        let Verdict::Disagrees { distance } = verdicts[4] else { panic!() };
        // A frequency which is really lower asks for a higher rate.
        assert!(*distance > 5.0 && (rate.packets[4].rate_hz / TRUE_HZ - 1.0 - 2e-5).abs() < 1e-7, "{distance}");
    }

    #[test]
    fn a_slip_in_all_components_of_the_best_setting_is_outvoted() {
        // Three components of each setting; all of the highest frequency, which weighs most, lose the same sample.
        let mut samples: Vec<Samples> = Vec::new();
        for seed in 20..23 {
            samples.extend(sweep(2, 1.0, 12.0, 0.05, &mut Random::seeded(seed)));
        }
        let settings = samples.len() / 3;
        for component in 0..3 {
            let (n, y, _) = &mut samples[component * settings];
            y.remove(700);
            n.pop();
        }
        let rate = common_rate(&packets(&samples), 128.0).unwrap();
        for (i, packet) in rate.packets.iter().enumerate() {
            assert_eq!(packet.verdict == Verdict::Used, i % settings != 0, "{i}: {packet:?}");
        }
        assert!((rate.rate_hz - TRUE_HZ).abs() < 3.0 * rate.std_hz, "{} {}", rate.rate_hz - TRUE_HZ, rate.std_hz);
    }

    #[test]
    fn a_drift_is_seen() {
        let (mut gauss, mut at, mut samples) = (Random::seeded(5), 0, Vec::new());
        for k in 0..12 {
            let (n, frequency_hz) = (counters(at..at + 1500), 900.0 - 37.0 * f64::from(k));
            at += 6000;
            let rate_hz = TRUE_HZ + 2e-6 * (n[750] as f64 / TRUE_HZ - 280.0);
            samples.push((n.clone(), noisy(wave(&n, [100.0, 1.0, 0.0], frequency_hz, rate_hz), 0.05, &mut gauss), frequency_hz));
        }
        let rate = common_rate(&packets(&samples), 128.0).unwrap();
        let drift = rate.drift.unwrap();
        assert!(
            drift.hz_per_s.abs() > 4.0 * drift.std_hz_per_s && (drift.hz_per_s - 2e-6).abs() < 4.0 * drift.std_hz_per_s,
            "{drift:?}"
        );
        assert!(rate.inflation > 10.0 && (rate.rate_hz - TRUE_HZ).abs() < 4.0 * rate.std_hz);
        assert!(rate.packets.iter().all(|packet| packet.verdict == Verdict::Used));
    }

    #[test]
    fn the_second_best_rate_tells_of_ambiguity() {
        // Two short bursts a minute apart: peaks stand 1 / (f · 60 s) apart.
        let n: Vec<u64> = (0..64).chain(7680..7744).collect();
        let excess = |noise: f64| {
            let y = noisy(wave(&n, [1.0, 0.3, 0.0], 500.0, TRUE_HZ), noise, &mut Random::seeded(6));
            let rate = common_rate(&packets(&[(n.clone(), y, 500.0)]), 128.0).unwrap();
            let second = rate.runner_up.unwrap();
            assert!(((second.rate_hz / rate.rate_hz - 1.0).abs() * 30_000.0 - 1.0).abs() < 0.1, "{second:?} {}", rate.rate_hz);
            assert!(rate.drift.is_none() && rate.dof == 0);
            second.chi_square_excess
        };
        let (clear, ambiguous) = (excess(0.001), excess(0.5));
        println!("{clear} {ambiguous}");
        // Within a burst the phase runs off by ±0.026 rad: 2.3e-4 of the power.
        assert!(clear > 8e3 && clear < 2e4 && ambiguous < 25.0);
        // One long stretch has its side lobes only: 4.7 % of the power against all of it. The noise is taken near the frequency.
        let n = counters(0..1536);
        let y = noisy(wave(&n, [1.0, 0.3, 0.0], 1000.0, TRUE_HZ), 0.05, &mut Random::seeded(7));
        let rate = common_rate(&packets(&[(n, y, 1000.0)]), 128.0).unwrap();
        let expected = (1.0 - 0.047) * 1536.0 / (2.0 * 0.0025);
        let found = rate.runner_up.unwrap().chi_square_excess;
        assert!((found / expected - 1.0).abs() < 0.3, "{found} {expected}");
        assert!((rate.rate_hz - TRUE_HZ).abs() < 4.0 * rate.std_hz);
    }

    #[test]
    fn a_long_packet_is_captured_in_stages() {
        // Every fiftieth sample, 750 000 cycles; then two bursts, of which the first stage sees one.
        let thinned: Vec<u64> = (0..2000).map(|i| 48 * i + i % 7).collect();
        let bursts = counters(0..2000).into_iter().chain(90_000..92_000).collect();
        for n in [thinned, bursts] {
            let y = noisy(wave(&n, [1.0, 0.3, 0.0], 1000.0, TRUE_HZ), 0.01, &mut Random::seeded(8));
            for start in [128.0, TRUE_HZ * 0.99901, TRUE_HZ * 1.00037] {
                let rate = common_rate(&packets(&[(n.clone(), y.clone(), 1000.0)]), start).unwrap();
                assert!((rate.rate_hz - TRUE_HZ).abs() < 4.0 * rate.std_hz && rate.std_hz < 2e-7);
                assert!(rate.runner_up.is_some_and(|other| other.chi_square_excess > 1e4));
            }
        }
    }

    #[test]
    fn clean_packets_give_every_digit() {
        let samples = sweep(10, 1.0, 4.0, 0.0, &mut Random::seeded(9));
        let rate = common_rate(&packets(&samples), 128.0).unwrap();
        assert!((rate.rate_hz - TRUE_HZ).abs() < 1e-11, "{}", rate.rate_hz - TRUE_HZ);
    }

    #[test]
    fn without_usable_packets_there_is_no_rate() {
        let error = common_rate(&[], 128.0).unwrap_err();
        assert_eq!(error.to_string(), "none of 0 sines can be used");
        let (n, y) = (counters(0..100), vec![0.0; 100]);
        let error = common_rate(&packets(&[(n.clone(), y.clone(), 0.1)]), 128.0).unwrap_err();
        let message = "none of 1 sines can be used: the samples span 0.078 cycles of 0.1 Hz, at least 0.8 are needed";
        assert_eq!(error.to_string(), message);
        let error = common_rate(&packets(&[(n.clone(), y.clone(), 30.0)]), 128.0).unwrap_err();
        assert!(matches!(error, RateRefusal::NoPacket { packets: 1, first: Some(SineRefusal::Undetermined { .. }) }), "{error}");
        for start in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(common_rate(&packets(&[(n.clone(), y.clone(), 30.0)]), start), Err(RateRefusal::Start { .. })));
        }
        let empty = Packet { n: &[], y: &[], frequency_hz: 1.0, least_std: 0.0 };
        let samples = sweep(10, 10.0, 2.0, 0.05, &mut Random::seeded(1));
        let mut given = packets(&samples);
        given.insert(1, empty);
        let rate = common_rate(&given, 128.0).unwrap();
        assert!(matches!(rate.packets[1].verdict, Verdict::Refused(SineRefusal::TooFew { samples: 0, .. })));
        assert!((rate.rate_hz - TRUE_HZ).abs() < 4.0 * rate.std_hz);
    }

    #[test]
    fn chi_square_quantiles_decide_on_inflation() {
        // 99 % quantiles: 6.635, 23.209, 135.807 for 1, 10, 100 degrees of freedom.
        for (dof, quantile) in [(1, 6.635), (10, 23.209), (100, 135.807)] {
            assert_eq!(crate::fit::order::excess(0.98 * quantile, dof), 1.0);
            assert!((crate::fit::order::excess(1.02 * quantile, dof) - (1.02 * quantile / dof as f64).sqrt()).abs() < 1e-12);
        }
        assert_eq!(crate::fit::order::excess(1e9, 0), 1.0);
    }
}
