//! Sensitivities and angles as polynomials of the temperature, and the same sensor in the other convention of ω.
//!
//! The way from one convention to the other is exact at every temperature but not linear, so that polynomials go over into polynomials
//! only nearly: those of the other convention are fitted through the exact values at Chebyshev's temperatures. What they miss is of
//! second order in the misalignment and of first order in its change with temperature, and is stated.

use super::polynomial::{TemperaturePolynomial, value};
use crate::data::convention::{Alignment, Convention, PlanarAxes};
use crate::fit::{FitError, Limits, polynomial, propagate};
use nalgebra::DMatrix;

/// Temperatures at which polynomials are taken over: several per coefficient at the highest order, 5.
const NODES: usize = 33;

/// σ(T) and ξ(T) of one sensor in one convention, coefficients lowest order first.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignmentPolynomials {
    /// What the angles mean.
    pub convention: Convention,
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [Vec<f64>; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [Vec<f64>; 3],
}

/// Polynomials through values at several temperatures, and what they miss.
#[derive(Clone, Debug, PartialEq)]
pub struct Through {
    /// The polynomials.
    pub polynomials: AlignmentPolynomials,
    /// Largest difference of the sensitivities, nT/enT.
    pub sigma_remainder: [f64; 3],
    /// Largest difference of the angles, degrees.
    pub xi_remainder_deg: [f64; 3],
}

/// Chebyshev's temperatures, both ends among them, which keep a polynomial close everywhere in the range, °C.
#[must_use]
pub fn nodes_degc([low, high]: [f64; 2]) -> Vec<f64> {
    let node = |i: usize| {
        let phase = std::f64::consts::PI * i as f64 / (NODES - 1) as f64;
        0.5 * (low + high) + 0.5 * (high - low) * phase.cos()
    };
    (0..NODES).map(node).collect()
}

impl AlignmentPolynomials {
    /// The sensor at a temperature, °C.
    #[must_use]
    pub fn at(&self, degc: f64) -> Alignment {
        Alignment {
            convention: self.convention,
            sigma: std::array::from_fn(|i| value(&self.sigma[i], degc)),
            xi_deg: std::array::from_fn(|i| value(&self.xi_deg[i], degc)),
        }
    }

    /// Highest orders of sensitivities and angles.
    #[must_use]
    pub fn orders(&self) -> [usize; 2] {
        let most = |p: &[Vec<f64>; 3]| p.iter().map(Vec::len).max().unwrap_or(1).saturating_sub(1);
        [most(&self.sigma), most(&self.xi_deg)]
    }

    /// The orders that the same sensor needs in the other convention: its sensitivities depend on the angles as well.
    #[must_use]
    pub fn orders_in_other(&self) -> [usize; 2] {
        let [sigma, xi] = self.orders();
        [sigma.max(xi), xi]
    }

    /// Polynomials of these orders through the alignments at several temperatures, all of one convention.
    #[must_use]
    pub fn through(degc: &[f64], alignments: &[Alignment], orders: [usize; 2]) -> Option<Through> {
        let convention = alignments.first()?.convention;
        let fit = |of: &dyn Fn(&Alignment) -> f64, order: usize| {
            let y: Vec<f64> = alignments.iter().map(of).collect();
            polynomial::fit(degc, &y, None, order, &Limits::default()).ok()
        };
        let largest = |f: &polynomial::Polynomial| f.residuals.iter().copied().map(f64::abs).fold(0.0, f64::max);
        let three = |of: &dyn Fn(&Alignment, usize) -> f64, order: usize| {
            let [x, y, z] = [0, 1, 2].map(|i| fit(&|a| of(a, i), order));
            let fits = [x?, y?, z?];
            let remainder: [f64; 3] = std::array::from_fn(|i| largest(&fits[i]));
            Some((fits.map(|f| f.coefficients), remainder))
        };
        let (sigma, sigma_remainder) = three(&|a, i| a.sigma[i], orders[0])?;
        let (xi_deg, xi_remainder_deg) = three(&|a, i| a.xi_deg[i], orders[1])?;
        Some(Through { polynomials: Self { convention, sigma, xi_deg }, sigma_remainder, xi_remainder_deg })
    }

    /// The same sensor in the other convention over a range of temperatures, °C.
    ///
    /// # Errors
    /// Angles that no three axes have between them somewhere in the range.
    pub fn to_other(&self, valid_degc: [f64; 2]) -> Result<Through, PlanarAxes> {
        let degc = nodes_degc(valid_degc);
        let there = |t: &f64| self.at(*t).to_other().map(|c| c.alignment);
        let alignments: Vec<Alignment> = degc.iter().map(there).collect::<Result<_, _>>()?;
        Self::through(&degc, &alignments, self.orders_in_other()).ok_or(PlanarAxes)
    }
}

/// σ(T) and ξ(T) of a sensor with their covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct UncertainAlignment {
    /// Sensitivities, nT/enT; a covariance of size zero is not known.
    pub sigma: [TemperaturePolynomial; 3],
    /// Angles, degrees, likewise.
    pub xi_deg: [TemperaturePolynomial; 3],
    /// Covariance of all coefficients, polynomial by polynomial; `None` if it is not known.
    pub covariance: Option<DMatrix<f64>>,
}

/// σ(T) and ξ(T) of a sensor in the other convention, with their covariances: those of the coefficients that come in are taken as
/// independent between polynomials, and where one is not known none of the result is.
///
/// # Errors
/// Angles that no three axes have between them, or values that are not finite.
pub fn in_other(
    convention: Convention,
    sigma: &[TemperaturePolynomial; 3],
    xi_deg: &[TemperaturePolynomial; 3],
) -> Result<UncertainAlignment, FitError> {
    let valid_degc = sigma[0].valid_degc;
    let all: Vec<&TemperaturePolynomial> = sigma.iter().chain(xi_deg).collect();
    let x: Vec<f64> = all.iter().flat_map(|p| p.coefficients.iter().copied()).collect();
    let lengths: Vec<usize> = all.iter().map(|p| p.coefficients.len()).collect();
    let there = |x: &[f64]| {
        let mut rest = x;
        let mut parts = lengths.iter().map(|n| {
            let (taken, left) = rest.split_at(*n);
            rest = left;
            taken.to_vec()
        });
        let mut three = || std::array::from_fn(|_| parts.next().unwrap_or_default());
        let polynomials = AlignmentPolynomials { convention, sigma: three(), xi_deg: three() };
        polynomials.to_other(valid_degc).ok().map(|t| t.polynomials)
    };
    let flat = |p: &AlignmentPolynomials| -> Vec<f64> { p.sigma.iter().chain(&p.xi_deg).flatten().copied().collect() };
    let found = there(&x).ok_or(FitError::NotFinite { what: "polynomials in the other convention", row: 0 })?;
    let count = flat(&found).len();
    let known = all.iter().all(|p| p.covariance.nrows() == p.coefficients.len());
    let covariance = if known {
        let block = propagate::block_diagonal(all.iter().map(|p| &p.covariance));
        let carried = propagate::propagate(|x| there(x).map_or_else(|| vec![f64::NAN; count], |p| flat(&p)), &x, &block)?;
        Some(carried.covariance)
    } else {
        None
    };
    let mut at = 0;
    let mut next = |coefficients: &Vec<f64>| {
        let n = coefficients.len();
        let own = covariance.as_ref().map_or_else(|| DMatrix::zeros(0, 0), |c| c.view((at, at), (n, n)).into_owned());
        at += n;
        TemperaturePolynomial { coefficients: coefficients.clone(), covariance: own, valid_degc }
    };
    let sigma = found.sigma.each_ref().map(&mut next);
    let xi_deg = found.xi_deg.each_ref().map(&mut next);
    Ok(UncertainAlignment { sigma, xi_deg, covariance })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_there_and_back_keep_the_sensor() {
        let sensor = AlignmentPolynomials {
            convention: Convention::BepiColombo,
            sigma: [vec![1.09, -1.4e-5], vec![1.094, -9e-6], vec![0.98, 2e-5]],
            xi_deg: [vec![90.5, -8e-5], vec![89.2, 3e-5], vec![91.0, 1.2e-4]],
        };
        let range = [-60.0, 60.0];
        let there = sensor.to_other(range).unwrap();
        assert_eq!(there.polynomials.convention, Convention::Rosetta);
        let back = there.polynomials.to_other(range).unwrap().polynomials;
        for t in [-60.0, -17.0, 20.0, 60.0] {
            let (a, b) = (sensor.at(t), back.at(t));
            // Twice the remainder that is stated, and rounding.
            for i in 0..3 {
                assert!((a.sigma[i] - b.sigma[i]).abs() < 2.0 * there.sigma_remainder[i] + 1e-13, "{t}");
                assert!((a.xi_deg[i] - b.xi_deg[i]).abs() < 2.0 * there.xi_remainder_deg[i] + 1e-11, "{t}");
            }
        }
        // Of second order in a misalignment of a degree, of first order in its change by 0.014 degrees.
        assert!(there.xi_remainder_deg.iter().all(|r| *r < 1e-6), "{there:?}");
        let flat = AlignmentPolynomials { xi_deg: [vec![10.0], vec![10.0], vec![170.0]], ..sensor };
        assert_eq!(flat.to_other(range).unwrap_err(), PlanarAxes);
    }
}
