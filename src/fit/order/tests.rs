use super::*;
use crate::fit::random::Random;

/// Mean temperatures of the runs of one sensor in the campaign of 2013, °C, as far apart and as close as they were.
const TEMPERATURES: [f64; 7] = [21.3, -71.2, -38.6, 55.1, 22.4, 118.7, 180.2];

/// The order with the least leave-one-out error.
fn least_leave_one_out(chosen: &Chosen) -> usize {
    let known = chosen.candidates.iter().filter_map(|c| c.leave_one_out.map(|error| (c.order, error)));
    known.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(order, _)| order).unwrap()
}

fn horner(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

fn automatic(x: &[f64], y: &[f64], std: Option<&[f64]>) -> Chosen {
    choose(x, y, std, HIGHEST_ORDER, None, &Limits::default()).unwrap()
}

#[test]
fn the_polynomials_of_2013_come_back_exactly_with_their_order() {
    // BC-MAG-TR-0085 sections 12 and 13: sensitivities, angles, offsets, cut-off frequencies.
    let printed: [&[f64]; 8] = [
        &[9.72692e-1, -1.80180e-5],
        &[9.97312e-1, 8.41537e-4, -2.34026e-6],
        &[8.9789e1, -1.7948e-5],
        &[9.0109e1, -4.8477e-4, 5.5736e-7],
        &[-1.038, 5.086e-3, 1.028e-4, -8.062e-7],
        &[-9.215, -4.711e-3, -1.042e-4, 8.416e-7],
        &[-6.12748e-2, -3.29684e-6, 8.06491e-5, -4.46246e-7],
        &[5.23089e1, -1.76236e-1, 4.32362e-4],
    ];
    for coefficients in printed {
        for n in 4..=7 {
            let x = &TEMPERATURES[TEMPERATURES.len() - n..];
            let y: Vec<f64> = x.iter().map(|x| horner(coefficients, *x)).collect();
            let order = coefficients.len() - 1;
            for std in [None, Some(vec![1e-6; n]), Some(vec![10.0; n])] {
                let given = choose(x, &y, std.as_deref(), HIGHEST_ORDER, Some(order), &Limits::default()).unwrap();
                // A cubic through four points is one of many without the knowledge of its order.
                let found = if n > order + 1 { automatic(x, &y, std.as_deref()) } else { given.clone() };
                assert_eq!(found.order, order, "{coefficients:?} from {n}");
                for chosen in [given, found] {
                    for (found, expected) in chosen.polynomial.coefficients.iter().zip(coefficients) {
                        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected} from {n}");
                    }
                }
            }
        }
    }
}

#[test]
fn leave_one_out_is_what_leaving_out_gives() {
    let y = [1.0, 2.5, 1.9, 3.7, 0.4, 5.2, 4.4];
    let std = [0.3, 0.4, 0.2, 0.5, 0.3, 0.9, 0.4];
    for std in [None, Some(&std[..])] {
        let chosen = automatic(&TEMPERATURES, &y, std);
        for candidate in &chosen.candidates[..5] {
            let weight = |i: usize| std.map_or(1.0, |std| 1.0 / (std[i] * std[i]));
            let (mut sum, mut weights) = (0.0, 0.0);
            for out in 0..y.len() {
                let without = |values: &[f64]| [&values[..out], &values[out + 1..]].concat();
                let kept: Vec<f64> = (0..y.len()).filter(|i| *i != out).map(weight).collect();
                let fit =
                    polynomial::fit(&without(&TEMPERATURES), &without(&y), Some(&kept), candidate.order, &Limits::default());
                sum += weight(out) * (y[out] - fit.unwrap().evaluate(TEMPERATURES[out]).0).powi(2);
                weights += weight(out);
            }
            let (found, expected) = (candidate.leave_one_out.unwrap(), (sum / weights).sqrt());
            assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        }
        let least = least_leave_one_out(&chosen);
        let error = |order: usize| chosen.candidates[order].leave_one_out.unwrap();
        assert!((0..5).all(|order| error(least) <= error(order)));
    }
}

#[test]
fn the_criterion_has_its_textbook_value_and_none_for_few_points() {
    let (x, y) = ([0.0, 1.0, 2.0, 3.0], [1.0, 2.0, 4.0, 5.0]);
    // Mean 3, rss 10: n ln(rss/n) + 2k + 2k(k+1)/(n-k-1) with k = 2.
    let c = automatic(&x, &y, None).candidates;
    assert!((c[0].aicc.unwrap() - (4.0 * 2.5f64.ln() + 4.0 + 12.0)).abs() < 1e-12);
    assert!((c[0].rss - 10.0).abs() < 1e-12 && (c[0].residual_std - (10.0f64 / 3.0).sqrt()).abs() < 1e-12);
    assert!(c[1..].iter().all(|c| c.aicc.is_none()) && c[3].residual_std.is_nan());
    // Known standard deviations leave one parameter less: chi2 = rss / 4 for order 1, k = 2.
    let c = automatic(&x, &y, Some(&[2.0; 4])).candidates;
    assert!((c[1].chi2.unwrap() - 0.2 / 4.0).abs() < 1e-12);
    assert!((c[1].aicc.unwrap() - (0.2 / 4.0 + 4.0 + 12.0)).abs() < 1e-12);
    assert!(c[2].aicc.is_none() && !c[1].excess_scatter);
    let two = automatic(&x[..2], &y[..2], None);
    assert_eq!((two.order, two.reason, two.candidates.len()), (0, Reason::TooFewPoints, 2));
    // A plain line through four points, which the criterion never sees without standard deviations.
    let line = automatic(&x, &[1.0, 2.01, 2.99, 4.0], None);
    assert_eq!((line.order, line.reason), (1, Reason::LeaveOneOut));
}

#[test]
fn standard_deviations_are_believed_until_the_points_contradict_them() {
    let line: Vec<f64> = TEMPERATURES.iter().map(|x| 1.0 + 0.01 * x).collect();
    let scatter = [1.0, -1.0, 0.5, 1.0, -1.0, -0.5, 0.0];
    let y: Vec<f64> = line.iter().zip(scatter).map(|(y, e)| y + e).collect();
    let given = |std: f64| choose(&TEMPERATURES, &y, Some(&[std; 7]), 5, Some(1), &Limits::default()).unwrap();
    let (quiet, loud) = (given(1.0), given(0.1));
    assert_eq!((quiet.inflation, quiet.reason), (1.0, Reason::Given));
    assert!((loud.inflation - (loud.candidates[1].chi2.unwrap() / 5.0).sqrt()).abs() < 1e-12 && loud.inflation > 3.0);
    assert!(loud.candidates[1].excess_scatter && !quiet.candidates[1].excess_scatter);
    // Where the scatter decides, the size of the standard deviations no longer matters.
    let scaled = choose(&TEMPERATURES, &y, None, 5, Some(1), &Limits::default()).unwrap();
    assert!((&loud.covariance - &scaled.covariance).amax() < 1e-12 * scaled.covariance.amax());
    let ((value, std), (other, other_std)) = (loud.evaluate(200.0), scaled.evaluate(200.0));
    assert!((value - other).abs() < 1e-12 && (std / other_std - 1.0).abs() < 1e-12);
}

#[test]
fn what_cannot_be_fitted_is_refused_by_name() {
    let refused = |x: &[f64], std: Option<&[f64]>, order| {
        choose(x, &vec![1.0; x.len()], std, 5, order, &Limits::default()).unwrap_err().to_string()
    };
    let x = [20.0, 20.0, -70.0, 55.0];
    assert_eq!(refused(&x, None, Some(3)), "order 3 needs 4 different points; there are 3");
    assert_eq!(refused(&x, None, Some(6)), "order 6 is higher than 5, the highest that is fitted");
    assert_eq!(refused(&x, Some(&[1.0, 0.0, 1.0, 1.0]), None), "the standard deviation of row 1 is not positive");
    assert_eq!(refused(&[], None, None), "order 0 needs 1 different points; there are 0");
    assert_eq!(refused(&[1.0, f64::NAN], None, None), "x: row 1 is not finite");
    // Two runs at nearly one temperature carry no order of their own.
    let (x, y) = ([20.0, 20.0 + 1e-9, -70.0, 55.0, 120.0], [1.0, 1.1, 0.4, 2.0, 0.7]);
    assert_eq!(automatic(&x, &y, None).candidates.len(), 4);
    assert!(matches!(choose(&x, &y, None, 5, Some(4), &Limits::default()), Err(FitError::Undetermined { .. })));
}

/// What a rule takes from the candidates of n points.
type Rule = fn(&Chosen, usize) -> usize;

/// Shares of orders 0 to 4 that every rule takes of 150 groups of runs with a polynomial of the given order, each term of which moves the
/// parameter by `signal` standard deviations over the range, the points scattering by `excess` standard deviations.
fn shares<const N: usize>(n: usize, order: usize, [signal, excess]: [f64; 2], has_std: bool, rules: [Rule; N]) -> [[f64; 5]; N] {
    let groups = 150;
    let mut random = Random(88_172_645_463_325_252);
    let x = &TEMPERATURES[..n];
    let std = has_std.then(|| vec![1.0; n]);
    let mut counts = [[0.0; 5]; N];
    for _ in 0..groups {
        let truth = |x: f64| (0..=order).map(|k| 0.5 * signal * ((x - 55.0) / 126.0).powi(k as i32)).sum::<f64>();
        let y: Vec<f64> = x.iter().map(|x| truth(*x) + excess * random.gaussian()).collect();
        let chosen = choose(x, &y, std.as_deref(), 4, None, &Limits::default()).unwrap();
        for (counts, rule) in counts.iter_mut().zip(rules) {
            counts[rule(&chosen, n)] += 1.0 / f64::from(groups);
        }
    }
    counts
}

#[test]
fn the_true_order_is_chosen_most_often() {
    for has_std in [true, false] {
        for (n, highest, signal) in [(4, 1, 100.0), (6, 2, 200.0), (7, 3, 200.0)] {
            for (excess, order) in [1.0, 3.0].into_iter().flat_map(|e| (0..=highest).map(move |order| (e, order))) {
                let [counts] = shares(n, order, [signal * excess, excess], has_std, [|chosen, _| chosen.order]);
                assert!(counts[order] > 0.8, "{n} {order} {excess}: {counts:?}");
            }
        }
    }
}

/// Printed with `--nocapture`: the shares of all rules. Over all cases none of the others takes the true order more often, apart from the
/// shares that chance gives to one of them.
#[test]
fn no_other_rule_takes_the_true_order_more_often() {
    fn least(chosen: &Chosen, value: impl Fn(&Candidate) -> Option<f64>) -> usize {
        let values: Vec<f64> = chosen.candidates.iter().map(|c| value(c).unwrap_or(f64::INFINITY)).collect();
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        values.iter().position(|v| *v <= least + TIE).unwrap()
    }
    fn penalty(k: usize, n: usize) -> Option<f64> {
        let (k, n) = (k as f64, n as f64);
        (n - k - 1.0 > 0.0).then(|| 2.0 * k + 2.0 * k * (k + 1.0) / (n - k - 1.0))
    }
    let rules: [(&str, Rule); 5] = [
        ("chosen", |chosen, _| chosen.order),
        ("AICc, better of both", |chosen, _| least(chosen, |c| c.aicc)),
        ("AICc, std as given", |chosen, n| least(chosen, |c| Some(c.chi2? + penalty(c.order + 1, n)?))),
        ("AICc, one factor", |chosen, n| least(chosen, |c| Some(n as f64 * (c.rss / n as f64).ln() + penalty(c.order + 2, n)?))),
        ("leave one out", |chosen, _| least_leave_one_out(chosen)),
    ];
    let mut right = [0.0; 5];
    for n in [4, 6, 7] {
        for case in [[30.0, 1.0], [100.0, 1.0], [100.0, 3.0], [1000.0, 3.0], [1000.0, 10.0]] {
            for order in 0..=3.min(n - 2) {
                print!("n {n} signal {:4} excess {:4} order {order}:", case[0], case[1]);
                for (rule, shares) in shares(n, order, case, true, rules.map(|(_, rule)| rule)).into_iter().enumerate() {
                    right[rule] += shares[order];
                    print!("   {} {}", rules[rule].0, shares.map(|s| format!("{:3.0}", 100.0 * s)).join(" "));
                }
                println!();
            }
        }
    }
    println!("{right:?}");
    assert!(right.iter().all(|other| *other <= right[0]), "{right:?}");
}

/// Runs at seven temperatures on a straight line with a square whose coefficient is so many of its standard deviations: the polynomial with the
/// order that was chosen is within its stated uncertainty, and would not be within that of its fit alone.
#[test]
fn what_the_choice_of_an_order_leaves_out_is_in_the_uncertainty() {
    const TRIALS: usize = 400;
    let n = TEMPERATURES.len();
    let mean = TEMPERATURES.iter().sum::<f64>() / n as f64;
    // The part of a square that no straight line follows, of unit norm.
    let line = polynomial::fit(&TEMPERATURES, &TEMPERATURES.map(|x| (x - mean).powi(2)), None, 1, &Limits::default()).unwrap();
    let norm = line.residuals.iter().map(|r| r * r).sum::<f64>().sqrt();
    let mut random = Random::seeded(20);
    for (size, alone_misses) in [(0.0, false), (2.0, true), (3.0, true)] {
        let (mut held, mut held_alone, mut held_at_ends) = (0, 0, 0);
        for _ in 0..TRIALS {
            let truth: Vec<f64> = (0..n).map(|i| 5.0 + 0.7 * TEMPERATURES[i] + size * line.residuals[i] / norm).collect();
            let y: Vec<f64> = truth.iter().map(|t| t + random.gaussian()).collect();
            let chosen = automatic(&TEMPERATURES, &y, Some(&[1.0; 7]));
            assert!(chosen.choice >= 1.0 && chosen.reason != Reason::Given);
            for (i, (x, truth)) in TEMPERATURES.iter().zip(&truth).enumerate() {
                let (value, std) = chosen.evaluate(*x);
                let holds = (value - truth).abs() < 1.96 * std;
                held += usize::from(holds);
                held_at_ends += usize::from(holds && (i == 0 || i == n - 1));
                held_alone += usize::from((value - truth).abs() < 1.96 * std / chosen.choice);
            }
        }
        let share = |count: usize| count as f64 / (TRIALS * n) as f64;
        println!("{size}: {:.3}, alone {:.3}", share(held), share(held_alone));
        // Values at one polynomial go together: the standard deviation of a share is 0.6 %.
        assert!(share(held) > 0.93, "{size}: {}", share(held));
        // Of 800 values at the ends: 95 % less two standard deviations of the share. With a factor of the mean over the points it is 84 to 92 %.
        let at_ends = held_at_ends as f64 / (2 * TRIALS) as f64;
        assert!(at_ends > 0.935, "{size}: {at_ends}");
        assert_eq!(share(held_alone) < 0.85, alone_misses, "{size}: {}", share(held_alone));
    }
    // Who gives the order answers for it.
    let y = TEMPERATURES.map(|x| 1.0 + x + random.gaussian());
    assert_eq!(choose(&TEMPERATURES, &y, Some(&[1.0; 7]), HIGHEST_ORDER, Some(1), &Limits::default()).unwrap().choice, 1.0);
}

/// Six runs that scatter about a line by ten times what they state, as when a sensor is taken out and mounted again: with one point to spare a
/// polynomial of order four passes near all of them by luck in some, and its small scatter would be the uncertainty of everything.
#[test]
fn a_polynomial_that_passes_near_all_points_by_luck_is_not_taken() {
    const SETS: usize = 4000;
    let x = &TEMPERATURES[..6];
    let mut random = Random::seeded(77);
    let mut high = 0;
    for _ in 0..SETS {
        let y: Vec<f64> = x.iter().map(|x| 3.0 - 0.02 * x + 10.0 * random.gaussian()).collect();
        let chosen = automatic(x, &y, Some(&[1.0; 6]));
        high += usize::from(chosen.order > 2);
    }
    // The same rules written down in numpy give 0.2 %, and 1.3 % without the test of the scatter.
    assert!(high <= SETS / 200, "{high} of {SETS}");
}

/// Three runs at three temperatures on a line, as in a campaign with one run at each: the line is taken from a slope on that their standard deviations
/// show beyond doubt, although one degree of freedom cannot tell how far they scatter. Runs that scatter by twenty times what they state are a line by
/// luck where the middle one is within its standard deviation of it, in one of thirty sets.
#[test]
fn three_points_show_a_slope_that_is_far_larger_than_their_standard_deviations() {
    const SETS: usize = 2000;
    let x = [-20.0, 5.0, 30.0];
    let mut random = Random::seeded(3);
    let mut lines = |slope: f64, scatter: f64| {
        let set = |_| {
            let y: Vec<f64> = x.iter().map(|x| 1.0 + slope * x / 50.0 + scatter * random.gaussian()).collect();
            automatic(&x, &y, Some(&[1.0; 3])).order == 1
        };
        (0..SETS).map(set).filter(|is_line| *is_line).count() as f64 / SETS as f64
    };
    for slope in [100.0, 200.0, 1000.0] {
        let share = lines(slope, 1.0);
        // A middle point beyond its 99 % quantile is no proof of a line.
        assert!(share > 0.975, "{slope}: {share}");
    }
    let by_luck = lines(0.0, 20.0);
    assert!(by_luck < 0.06, "{by_luck}");
    // Noise alone is no slope.
    assert!(lines(0.0, 1.0) < 0.03);
}
