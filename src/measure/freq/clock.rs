//! The clock of the instrument: its mean rate, its drift, and what is to be said about them.

use super::rates::Rates;
use crate::data::frequency::{ClockDrift, FrequencyValues};
use crate::data::note::{Note, NoteKind};
use crate::data::run::Setting;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{CommonRate, Drift, Verdict};
use crate::fit::{Limits, order, polynomial};
use crate::measure::corner::Corner;

/// Difference of chi-square below which the next best sampling frequency is as good.
const AMBIGUOUS: f64 = 25.0;
/// A drift of this many standard uncertainties is one.
const DRIFTS: f64 = 4.0;

/// The clock of the instrument.
pub(super) struct Clock {
    rate_hz: [f64; 3],
    std_hz: [f64; 3],
    /// Weighted mean of the components, Hz.
    pub mean_hz: f64,
    mean_std_hz: f64,
    scatter_hz: f64,
    /// The three components disagree by more than their uncertainties.
    disagree: bool,
    /// Drift of all components together, Hz/s, if there is one, and the time at which the mean holds, s after counter 0.
    drift_hz_per_s: Option<f64>,
    pub centre_s: f64,
    /// Factor by which the uncertainty of each component was widened.
    inflation: [f64; 3],
    part: ClockDrift,
}

impl Clock {
    pub fn of(rates: &Rates) -> Self {
        let found = &rates.found;
        let drift = |get: fn(&Drift) -> f64| -> [f64; 3] {
            std::array::from_fn(|i| found[i].as_ref().and_then(|f| f.drift.as_ref()).map_or(f64::NAN, get))
        };
        let (drift_hz_per_s, drift_std) = (drift(|d| d.hz_per_s), drift(|d| d.std_hz_per_s));
        let drift_of_all = common_drift(drift_hz_per_s, drift_std);
        let centre_s = balanced_s(rates);
        let at_centre: [Option<(f64, f64, f64)>; 3] =
            found.each_ref().map(|f| f.as_ref().filter(|_| drift_of_all.is_some()).and_then(|f| line_at(f, centre_s)));
        let of = |i: usize| {
            let plain = found[i].as_ref().map_or((f64::NAN, f64::NAN, 1.0), |f| (f.rate_hz, f.std_hz, f.inflation));
            at_centre[i].unwrap_or(plain)
        };
        let rate_hz: [f64; 3] = std::array::from_fn(|i| of(i).0);
        let std_hz: [f64; 3] = std::array::from_fn(|i| of(i).1);
        let inflation: [f64; 3] = std::array::from_fn(|i| of(i).2);
        let known: Vec<usize> = (0..3).filter(|i| rate_hz[*i].is_finite()).collect();
        let sum = |get: &dyn Fn(usize) -> f64| known.iter().map(|i| get(*i)).sum::<f64>();
        let total = sum(&|i| std_hz[i].powi(-2));
        let mean_hz = sum(&|i| rate_hz[i] * std_hz[i].powi(-2)) / total;
        let chi_square = sum(&|i| ((rate_hz[i] - mean_hz) / std_hz[i]).powi(2));
        let widened = order::excess(chi_square, known.len().saturating_sub(1));
        let plain = sum(&|i| rate_hz[i]) / known.len() as f64;
        let scatter_hz = (sum(&|i| (rate_hz[i] - plain).powi(2)) / (known.len() as f64 - 1.0)).sqrt();
        let rival = found
            .iter()
            .flatten()
            .filter_map(|f| f.runner_up.as_ref())
            .min_by(|a, b| a.chi_square_excess.total_cmp(&b.chi_square_excess));
        Self {
            rate_hz,
            std_hz,
            mean_hz,
            mean_std_hz: widened / total.sqrt(),
            scatter_hz,
            disagree: widened > 1.0,
            drift_hz_per_s: drift_of_all,
            centre_s,
            inflation,
            part: ClockDrift {
                reference_s: drift_of_all.map(|_| centre_s),
                drift_hz_per_s,
                drift_std_hz_per_s: drift_std,
                drift_is_significant: drift_of_all.is_some(),
                rival_hz: rival.map(|r| r.rate_hz),
                rival_chi_square: rival.map(|r| r.chi_square_excess),
            },
        }
    }

    /// The rate during a stretch, Hz.
    pub fn at(&self, t_s: f64) -> f64 {
        self.mean_hz + self.drift_hz_per_s.map_or(0.0, |d| d * (t_s - self.centre_s))
    }

    /// The sampling frequency without a known drift, by which it is `moved` at its time, beside the -3 dB frequencies.
    pub fn values(&self, moved: f64, corner: &Corner) -> FrequencyValues {
        FrequencyValues {
            f_s_hz: Some(self.rate_hz.map(|f| f * moved)),
            f_s_std_hz: Some(self.std_hz),
            mean_f_s_hz: Some(self.mean_hz * moved),
            mean_f_s_std_hz: Some(self.mean_std_hz),
            scatter_f_s_hz: Some(self.scatter_hz).filter(|s| s.is_finite()),
            ..corner.values()
        }
    }

    /// Drift and the next best value; a known drift gives the sampling frequency a time even if it has no drift of its own.
    pub fn drift(&self, known_drift: bool) -> ClockDrift {
        ClockDrift { reference_s: self.part.reference_s.or(known_drift.then_some(self.centre_s)), ..self.part.clone() }
    }

    /// What a person should know of it; `settings` are those of the packets.
    pub fn notes(&self, rates: &Rates, settings: &[Setting]) -> Vec<Note> {
        let note = |text: String| Note::new(NoteKind::Method, text);
        let mut notes: Vec<Note> = rates.refused.iter().cloned().map(note).collect();
        for ((component, rate), inflation) in COMPONENTS.into_iter().zip(&rates.found).zip(self.inflation) {
            let Some(rate) = rate else { continue };
            let note = |text: String| note(text).about(component);
            if let Some(rival) = rate.runner_up.as_ref().filter(|r| r.chi_square_excess < AMBIGUOUS) {
                notes.push(note(format!(
                    "the sampling frequency of {component} is ambiguous: {:.5} Hz describes the data almost as well (chi-square {:.1} more)",
                    rival.rate_hz, rival.chi_square_excess
                )));
            }
            let apart: Vec<String> = rate
                .packets
                .iter()
                .zip(settings)
                .filter(|(p, _)| matches!(p.verdict, Verdict::Disagrees { .. }))
                .map(|(_, s)| format!("{} Hz", s.frequency_hz))
                .collect();
            if !apart.is_empty() {
                notes.push(note(format!(
                    "the sampling frequency of {component} rests on the other frequencies than {}",
                    apart.join(", ")
                )));
            }
            if inflation > 1.0 {
                notes.push(note(format!(
                    "the sampling frequencies that the settings give for {component} scatter by {inflation:.1} times what their noise lets \
                     expect; its uncertainty was widened by it"
                )));
            }
        }
        if self.disagree {
            notes.push(note(
                "the components disagree on the sampling frequency by more than their uncertainties; that of the mean was widened"
                    .to_owned(),
            ));
        }
        if let Some(drift) = self.drift_hz_per_s {
            notes.push(note(format!(
                "the sampling frequency drifts by {drift:+.2e} Hz/s; the value given holds {:.3} s after sample counter 0, and amplitudes take the \
                 drift into account",
                self.centre_s
            )));
        }
        notes
    }
}

/// Weighted mean of the drifts of the components, Hz/s, if it is one.
fn common_drift(hz_per_s: [f64; 3], std: [f64; 3]) -> Option<f64> {
    let weights = std.map(|s| if s.is_finite() && s > 0.0 { s.powi(-2) } else { 0.0 });
    let total: f64 = weights.iter().sum();
    let common = (0..3).filter(|i| weights[*i] > 0.0).map(|i| weights[i] * hz_per_s[i]).sum::<f64>() / total;
    (total > 0.0 && common.abs() * total.sqrt() > DRIFTS).then_some(common)
}

/// The time for which the rates hold, around which the information of the packets is balanced, s after counter 0.
fn balanced_s(rates: &Rates) -> f64 {
    let packets = rates.found.iter().flatten().flat_map(|f| &f.packets);
    let informed = packets.filter(|p| p.verdict == Verdict::Used && p.std_hz > 0.0);
    let (sum, weight) = informed.fold((0.0, 0.0), |(sum, weight), p| {
        let w = p.std_hz.powi(-2);
        (sum + w * p.time_s, weight + w)
    });
    if weight > 0.0 { sum / weight } else { 0.0 }
}

/// The rate at a time, its standard uncertainty and the factor by which that was widened, from a straight line through the rates of
/// the packets; `None` where they do not determine one.
fn line_at(rate: &CommonRate, time_s: f64) -> Option<(f64, f64, f64)> {
    let used: Vec<_> = rate.packets.iter().filter(|p| p.verdict == Verdict::Used && p.std_hz > 0.0).collect();
    let x: Vec<f64> = used.iter().map(|p| p.time_s - time_s).collect();
    let y: Vec<f64> = used.iter().map(|p| p.rate_hz - rate.rate_hz).collect();
    let weights: Vec<f64> = used.iter().map(|p| p.std_hz.powi(-2)).collect();
    let line = polynomial::fit(&x, &y, Some(&weights), 1, &Limits::default()).ok()?;
    let chi_square: f64 = line.residuals.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
    let inflation = order::excess(chi_square, line.dof);
    Some((rate.rate_hz + line.coefficients[0], inflation * line.unscaled_covariance[(0, 0)].sqrt(), inflation))
}
