//! The corner as the printed tables of 2013 have it: a straight line in (f, dB) between the two neighbours of -3 dB.

use super::refusal::Refusal;

/// Level of the corner by interpolation, dB.
const IGEP_LEVEL_DB: f64 = -3.0;

/// The corner by interpolation, Hz, from points (Hz, positive amplitude) by ascending frequency.
///
/// # Errors
/// [`Refusal::NoAmplitude`] and [`Refusal::NoCrossing`].
pub fn igep_corner_hz(points: &[(f64, f64)]) -> Result<f64, Refusal> {
    let largest = points.iter().map(|(_, amplitude)| *amplitude).fold(0.0, f64::max);
    let Some(&(highest_hz, _)) = points.last().filter(|_| largest > 0.0) else { return Err(Refusal::NoAmplitude) };
    let level = |amplitude: f64| 20.0 * (amplitude / largest).log10();
    let crossing = points.windows(2).rev().find_map(|pair| match *pair {
        [(low, above), (high, below)] if level(above) >= IGEP_LEVEL_DB && level(below) < IGEP_LEVEL_DB => {
            let (above, below) = (level(above), level(below));
            Some(low + (IGEP_LEVEL_DB - above) / (below - above) * (high - low))
        }
        _ => None,
    });
    // A table that ends above the level after low readings has its crossing still to come.
    match points.last() {
        Some((_, last)) if level(*last) < IGEP_LEVEL_DB => crossing.ok_or(Refusal::NoCrossing { highest_hz }),
        _ => Err(Refusal::NoCrossing { highest_hz }),
    }
}
