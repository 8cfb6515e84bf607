//! Calibrations that differ from one to the next by more than their noise: how much, and what it does to all that several of them tell.
//!
//! The values of the single calibrations scatter about the fit to all of them by their own noise and by something that is new in every one.
//! How large that is, is not known, and few calibrations tell it badly: it is averaged over all sizes that they allow, by the likelihood of the
//! differences that are left when the fit has taken what it can. Scale factors have one size, relative to themselves, and so have offset fields
//! and angles. Half of the probability is with none at all before anything was measured, the other half about the size of their noise.

use super::steps::CONVINCING;
use super::terms::{CONSTANT, Step};
use crate::data::note::{Note, NoteKind};
use crate::fit::NORMAL_95;
use crate::fit::statistics::{median, two_sided_tail};
use nalgebra::{DMatrix, DVector};

/// One calibration beside the fit to all of them.
#[derive(Clone)]
pub(super) struct Found {
    /// Its number among all calibrations.
    pub run: usize,
    /// Values of its own minus those of the fit: scale factors, nT/EU, offset fields, nT, angles, degrees.
    pub difference: [f64; CONSTANT],
    /// Standard uncertainties of its own values.
    pub std: [f64; CONSTANT],
    /// Derivatives of the nine values by the parameters that are fitted.
    pub derivatives: [Vec<f64>; CONSTANT],
}

/// Probability that calibrations do not scatter beyond their noise, before anything was measured.
const NONE: f64 = 0.5;
/// Smallest and largest scatter that is weighed, in standard uncertainties of the single calibrations, and steps between them.
const SIZES: (f64, f64, usize) = (0.1, 1e3, 30);
/// A scatter that is as probable as this is told.
const TOLD: f64 = 0.95;
/// What scatters alike, and its unit.
pub(super) const FAMILIES: [(&str, &str); 3] = [("scale factors", "nT/EU"), ("offset fields", "nT"), ("angles", "degrees")];

/// By how much the calibrations scatter.
pub(super) struct Scatter {
    /// Factors on the standard uncertainties of the fitted parameters.
    factors: Vec<f64>,
    /// Variance of the nine values in a single run about their mean.
    of_a_state: [f64; CONSTANT],
    /// Size, and the probability that there is one at all, of the families that tell it.
    families: [Option<(f64, f64)>; 3],
}

/// The values of one of the nine parameters in all calibrations.
struct Values {
    /// Fitted parameters that it follows.
    columns: Vec<usize>,
    design: DMatrix<f64>,
    difference: DVector<f64>,
    variance: Vec<f64>,
}

/// What is left of the differences with a scatter: its logarithmic likelihood, that of all differences, and the covariance of the parameters.
struct Weighed {
    likelihood: f64,
    of_all: f64,
    covariance: DMatrix<f64>,
}

impl Values {
    fn of(found: &[Found], parameter: usize, parameters: usize) -> Self {
        let columns: Vec<usize> =
            (0..parameters).filter(|c| found.iter().any(|one| one.derivatives[parameter][*c] != 0.0)).collect();
        Self {
            design: DMatrix::from_fn(found.len(), columns.len(), |r, c| found[r].derivatives[parameter][columns[c]]),
            difference: DVector::from_iterator(found.len(), found.iter().map(|one| one.difference[parameter])),
            variance: found.iter().map(|one| one.std[parameter].powi(2)).collect(),
            columns,
        }
    }

    /// Whether there are enough calibrations to leave anything of the differences.
    fn leave_something(&self) -> bool {
        self.difference.len() > self.columns.len()
    }

    /// The likelihood of the differences that no parameters explain (restricted likelihood), for a scatter.
    fn weighed(&self, scatter: f64) -> Option<Weighed> {
        let weights: Vec<f64> = self.variance.iter().map(|v| 1.0 / (v + scatter * scatter)).collect();
        let weighted = DMatrix::from_fn(self.design.nrows(), self.design.ncols(), |r, c| self.design[(r, c)] * weights[r]);
        // Coefficients per kelvin and values have different sizes.
        let normal = self.design.tr_mul(&weighted);
        let scale: Vec<f64> = (0..normal.ncols()).map(|i| normal[(i, i)].sqrt()).collect();
        let scaled = DMatrix::from_fn(normal.nrows(), normal.ncols(), |r, c| normal[(r, c)] / (scale[r] * scale[c]));
        let root = scaled.cholesky()?;
        let inverse = root.inverse();
        let covariance = DMatrix::from_fn(normal.nrows(), normal.ncols(), |r, c| inverse[(r, c)] / (scale[r] * scale[c]));
        let taken = &covariance * weighted.tr_mul(&self.difference);
        let left = &self.difference - &self.design * taken;
        let squares: f64 = left.iter().zip(&weights).map(|(d, w)| d * d * w).sum();
        let determinant = 2.0 * (root.l().diagonal().map(f64::ln).sum() + scale.iter().map(|s| s.ln()).sum::<f64>());
        let of_all = 0.5 * (weights.iter().map(|w| w.ln()).sum::<f64>() - squares);
        Some(Weighed { likelihood: of_all - 0.5 * determinant, of_all, covariance })
    }
}

/// The values of one family.
fn of_family(found: &[Found], family: usize, parameters: usize) -> Vec<Values> {
    (3 * family..3 * family + 3).map(|j| Values::of(found, j, parameters)).collect()
}

/// The usual uncertainty of values, and the sizes of a scatter that are weighed, none among them.
fn sizes(values: &[Values]) -> Option<(f64, Vec<f64>)> {
    let mut own: Vec<f64> = values.iter().flat_map(|v| v.variance.iter().map(|v| v.sqrt())).collect();
    if own.is_empty() {
        return None;
    }
    let unit = median(&mut own);
    let (smallest, largest, steps) = SIZES;
    let size = |i: usize| unit * smallest * (largest / smallest).powf(i as f64 / (steps - 1) as f64);
    Some((unit, [0.0].into_iter().chain((0..steps).map(size)).collect()))
}

/// The largest logarithmic likelihood of the differences of one family, with the scatter and the parameters that suit them best.
fn likelihood(found: &[Found], family: usize, parameters: usize) -> Option<f64> {
    let values = of_family(found, family, parameters);
    let (_, sizes) = sizes(&values)?;
    let of_size = |size: &f64| values.iter().map(|v| Some(v.weighed(*size)?.of_all)).sum::<Option<f64>>();
    sizes.iter().filter_map(of_size).reduce(f64::max)
}

/// Whether a step explains the calibrations better than a scatter from one to the next would, beside the steps that were `taken`: alone, or together
/// with steps of the other parameters of its family at the same place, as where one reference moves all scale factors. `beside` are the
/// calibrations beside a fit without steps, of so many parameters. True where they do not tell.
pub(super) fn is_beyond(step: Step, taken: &[Step], beside: &[Found], parameters: usize) -> bool {
    let (family, runs) = (step.parameter / 3, beside.len() as f64);
    let of_family = |steps: &[Step]| {
        let own: Vec<Step> = steps.iter().filter(|step| step.parameter / 3 == family).copied().collect();
        let with = |one: &Found| Found {
            derivatives: std::array::from_fn(|j| {
                let stepped = own.iter().map(|s| f64::from(u8::from(s.parameter == j && one.run >= s.from_run)));
                one.derivatives[j].iter().copied().chain(stepped).collect()
            }),
            ..*one
        };
        likelihood(&beside.iter().map(with).collect::<Vec<_>>(), family, parameters + own.len())
    };
    let others: Vec<Step> = (3 * family..3 * family + 3)
        .map(|parameter| Step { parameter, ..step })
        .filter(|other| *other != step && !taken.contains(other))
        .collect();
    let Some(without) = of_family(taken).filter(|_| beside.len() > 1) else { return true };
    let (of_one, of_place) = (0.5 * (3.0 * runs).ln(), (3.0 * (runs - 1.0)).ln() + 0.5 * CONVINCING);
    // All choices of the others, by the bits of a number.
    (0..1_usize << others.len()).any(|choice| {
        let chosen = others.iter().enumerate().filter(|(bit, _)| choice >> bit & 1 == 1).map(|(_, other)| *other);
        let steps: Vec<Step> = taken.iter().copied().chain([step]).chain(chosen).collect();
        let count = (steps.len() - taken.len()) as f64;
        of_family(&steps).is_none_or(|with| with - without > count * of_one + of_place)
    })
}

/// Says of families that they scatter and do not step.
pub(super) fn instead_of_steps(scatters: [bool; FAMILIES.len()]) -> Vec<Note> {
    let note = |(_, (name, _)): (bool, &(&str, &str))| {
        let text = format!(
            "a step of the {name} between two calibrations would explain them no better than that every one differs from the others by itself, and \
             was not taken"
        );
        Note::new(NoteKind::Fit, text)
    };
    scatters.into_iter().zip(&FAMILIES).filter(|(scatters, _)| *scatters).map(note).collect()
}

impl Scatter {
    /// Of calibrations beside the fit to all of them, which has so many parameters.
    pub fn of(found: &[Found], parameters: usize) -> Self {
        let mut scatter = Self { factors: vec![1.0; parameters], of_a_state: [0.0; CONSTANT], families: [None; 3] };
        for family in 0..3 {
            let values: Vec<Values> = of_family(found, family, parameters).into_iter().filter(Values::leave_something).collect();
            scatter.families[family] = scatter.weigh(&values);
        }
        scatter
    }

    /// Widens what one family determines; its size and probability.
    fn weigh(&mut self, values: &[Values]) -> Option<(f64, f64)> {
        let (unit, sizes) = sizes(values)?;
        let weighed: Vec<Vec<Weighed>> =
            sizes.iter().map(|size| values.iter().map(|v| v.weighed(*size)).collect()).collect::<Option<_>>()?;
        let beforehand = |size: f64| if size == 0.0 { NONE } else { (1.0 - NONE) * share(size / unit) };
        let logs: Vec<f64> = weighed
            .iter()
            .zip(&sizes)
            .map(|(all, size)| beforehand(*size).ln() + all.iter().map(|w| w.likelihood).sum::<f64>())
            .collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let relative: Vec<f64> = logs.iter().map(|log| (log - most).exp()).collect();
        let sum: f64 = relative.iter().sum();
        let probability: Vec<f64> = relative.iter().map(|r| r / sum).collect();
        for (place, own) in values.iter().enumerate() {
            for (k, column) in own.columns.iter().enumerate() {
                let std: Vec<f64> = weighed.iter().map(|all| all[place].covariance[(k, k)].sqrt()).collect();
                let of_all = interval(&probability, &std);
                self.factors[*column] = of_all / std[0];
                if let Some(of_a_state) = self.of_a_state.get_mut(*column) {
                    let state: Vec<f64> = std.iter().zip(&sizes).map(|(std, size)| std.hypot(*size)).collect();
                    *of_a_state = interval(&probability, &state).powi(2) - of_all.powi(2);
                }
            }
        }
        let there: Vec<f64> = sizes.iter().zip(&probability).skip(1).map(|(size, p)| size.ln() * p).collect();
        let is_there = 1.0 - probability[0];
        Some(((there.iter().sum::<f64>() / is_there).exp(), is_there))
    }

    /// A covariance of the fitted parameters that holds with the scatter; the correlations stay. What has a scatter is in every run another one than its
    /// mean, also in those that use the facility.
    pub fn widened(&self, mut covariance: DMatrix<f64>) -> DMatrix<f64> {
        for (r, by_row) in self.factors.iter().enumerate() {
            for (c, by_column) in self.factors.iter().enumerate() {
                covariance[(r, c)] *= by_row * by_column;
            }
        }
        self.of_a_state.iter().enumerate().for_each(|(j, variance)| covariance[(j, j)] += variance);
        covariance
    }

    /// Says by how much calibrations scatter that certainly do.
    pub fn notes(&self) -> Vec<Note> {
        let of = |(family, (name, unit)): (usize, &(&str, &str))| {
            let (size, probability) = self.families[family].filter(|(_, probability)| *probability > TOLD)?;
            let text = format!(
                "the {name} scatter from calibration to calibration by about {size:.1e} {unit} beyond their noise (probability {probability:.3}); \
                 the uncertainties hold for it, and contain that every run finds them elsewhere"
            );
            Some(Note::new(NoteKind::Fit, text))
        };
        FAMILIES.iter().enumerate().filter_map(of).collect()
    }
}

/// Probability of one of the sizes, in standard uncertainties, before anything was measured: half of a Cauchy distribution, which expects a scatter
/// of the size of the uncertainties and allows any (Gelman, Bayesian Analysis 1, 515, 2006).
fn share(size: f64) -> f64 {
    let (smallest, largest, steps) = SIZES;
    let of_one_step = (largest / smallest).ln() / (steps - 1) as f64;
    2.0 / std::f64::consts::PI * size / (1.0 + size * size) * of_one_step
}

/// The standard deviation of a normal distribution whose interval of 95 % is that of normal distributions with these standard deviations, each
/// with its probability.
fn interval(probability: &[f64], std: &[f64]) -> f64 {
    const OUTSIDE: f64 = 0.05;
    let outside = |half: f64| probability.iter().zip(std).map(|(p, s)| p * two_sided_tail(half / s)).sum::<f64>();
    let mut low = NORMAL_95 * std.iter().copied().fold(f64::INFINITY, f64::min);
    let mut high = NORMAL_95 * std.iter().copied().fold(0.0, f64::max);
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        if outside(middle) > OUTSIDE { low = middle } else { high = middle }
    }
    high / NORMAL_95
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    const COIL_K: [f64; 8] = [-0.9, 0.4, -0.1, 0.7, -0.5, 0.2, 0.9, -0.3];

    /// Calibrations that tell scale factors, offset fields and their temperature coefficients, with errors of their own of one and a scatter.
    fn drawn(count: usize, scatter: f64, gauss: &mut Random) -> Vec<Found> {
        let one = |(run, k): (usize, &f64)| Found {
            run,
            difference: std::array::from_fn(|_| gauss.gaussian() + scatter * gauss.gaussian()),
            std: [1.0; CONSTANT],
            derivatives: std::array::from_fn(|j| {
                let follows = |c: usize| if c == j { 1.0 } else { f64::from(u8::from(c == CONSTANT + j)) * k };
                (0..CONSTANT + 6).map(follows).collect()
            }),
        };
        COIL_K[..count].iter().enumerate().map(one).collect()
    }

    /// Intervals of 95 % of the coefficients hold the truth whatever the scatter is.
    #[test]
    fn intervals_hold_with_and_without_scatter() {
        const DRAWS: usize = 400;
        for count in [4_usize, 8] {
            let coil_k = &COIL_K[..count];
            for scatter in [0.0, 1.0, 30.0] {
                let mut gauss = Random::seeded(7);
                let (mut held, mut all) = (0, 0);
                for _ in 0..DRAWS {
                    let found = drawn(count, scatter, &mut gauss);
                    let own = Scatter::of(&found, CONSTANT + 6);
                    // Ordinary least squares of a straight line, by its closed form.
                    let mean = coil_k.iter().sum::<f64>() / count as f64;
                    let spread: f64 = coil_k.iter().map(|k| (k - mean).powi(2)).sum();
                    for j in 0..6 {
                        let slope = found.iter().zip(coil_k).map(|(one, k)| one.difference[j] * (k - mean)).sum::<f64>() / spread;
                        held += usize::from(slope.abs() < NORMAL_95 * own.factors[CONSTANT + j] / spread.sqrt());
                        all += 1;
                    }
                }
                let share = held as f64 / all as f64;
                println!("{count} calibrations, scatter {scatter}: {share:.3}");
                assert!((0.90..=0.995).contains(&share), "{count} calibrations, scatter {scatter}: {share}");
            }
        }
    }

    /// The values that a further run finds, which has a scatter of its own, lie within their intervals, too.
    #[test]
    fn intervals_hold_the_state_of_a_further_run() {
        const DRAWS: usize = 400;
        for count in [4_usize, 8] {
            let coil_k = &COIL_K[..count];
            let mean = coil_k.iter().sum::<f64>() / count as f64;
            let spread: f64 = coil_k.iter().map(|k| (k - mean).powi(2)).sum();
            // None and one of the size of the noise are as probable as each other, and four calibrations do not tell them apart: together.
            for scatters in [[0.0, 1.0], [10.0, 10.0], [30.0, 30.0]] {
                let mut gauss = Random::seeded(11);
                let (mut held, mut all) = (0, 0);
                for draw in 0..DRAWS {
                    let scatter = scatters[draw % 2];
                    let found = drawn(count, scatter, &mut gauss);
                    let own = Scatter::of(&found, CONSTANT + 6);
                    for j in 0..6 {
                        let middle = found.iter().map(|one| one.difference[j]).sum::<f64>() / count as f64;
                        let slope = found.iter().zip(coil_k).map(|(one, k)| one.difference[j] * (k - mean)).sum::<f64>() / spread;
                        let variance =
                            DMatrix::identity(CONSTANT + 6, CONSTANT + 6) * (1.0 / count as f64 + mean * mean / spread);
                        let std = own.widened(variance)[(j, j)].sqrt();
                        let state = scatter * gauss.gaussian();
                        held += usize::from((state - (middle - slope * mean)).abs() < NORMAL_95 * std);
                        all += 1;
                    }
                }
                let share = held as f64 / all as f64;
                println!("{count} calibrations, scatter {scatters:?}: {share:.3}");
                assert!((0.90..=0.999).contains(&share), "{count} calibrations, scatter {scatters:?}: {share}");
            }
        }
    }

    /// The step that takes most off the squares of the differences of a family, beside a line in the temperature.
    fn most_likely(found: &[Found], family: usize) -> Step {
        let places =
            (3 * family..3 * family + 3).flat_map(|parameter| (1..found.len()).map(move |from_run| Step { parameter, from_run }));
        let taken = |step: &Step| {
            let y = DVector::from_iterator(found.len(), found.iter().map(|one| one.difference[step.parameter]));
            let squares = |with_step: bool| {
                let columns = DMatrix::from_fn(found.len(), 2 + usize::from(with_step), |run, column| match column {
                    0 => 1.0,
                    1 => COIL_K[run],
                    _ => f64::from(u8::from(run >= step.from_run)),
                });
                let solved = columns.clone().svd(true, true).solve(&y, 1e-12).unwrap();
                (&y - columns * solved).norm_squared()
            };
            squares(false) - squares(true)
        };
        places.max_by(|a, b| taken(a).total_cmp(&taken(b))).unwrap()
    }

    #[test]
    fn a_scatter_is_no_step_and_a_step_is_one() {
        const DRAWS: usize = 150;
        let mut gauss = Random::seeded(9);
        // Scatter, step, parameters that step, calibrations.
        for (scatter, step, stepping, count) in [
            (10.0, 0.0, 0..0, 6),
            (1.0, 0.0, 0..0, 6),
            (0.0, 30.0, 1..2, 6),
            (1.0, 60.0, 1..2, 6),
            (0.0, 30.0, 0..3, 4),
            (0.0, 30.0, 0..2, 5),
        ] {
            let mut kept = [0; 2];
            for _ in 0..DRAWS {
                let mut found = drawn(count, scatter, &mut gauss);
                found[count / 2..].iter_mut().for_each(|one| stepping.clone().for_each(|j| one.difference[j] += step));
                for (family, kept) in kept.iter_mut().enumerate() {
                    *kept += usize::from(is_beyond(most_likely(&found, family), &[], &found, CONSTANT + 6));
                }
            }
            let [own, other] = kept.map(|kept| kept as f64 / DRAWS as f64);
            println!("scatter {scatter}, step {step} of {stepping:?}, {count} calibrations: {own:.3}, {other:.3}");
            assert!(other <= 0.05, "scatter {scatter}: {other}");
            assert!(if step > 0.0 { own > 0.9 } else { own <= 0.05 }, "scatter {scatter}, step {step} of {stepping:?}: {own}");
        }
    }
}
