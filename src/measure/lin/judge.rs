//! What a linear fit leaves, plateau by plateau, and what a person should know about it.

use super::fit::Means;
use super::result::Block;
use crate::data::calibration::{LinearStd, OffsetTrend, TemperatureSlopes};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::result::Summary;
use crate::data::units::{COMPONENTS, FieldCoil, Reading, counted};
use crate::fit::statistics::robust_std;
use crate::fit::{DenseNoise, student_95};
use crate::measure::structure::{self, OUTLIER};
use crate::model::sensor::{Linear, Split, SplitError};
use crate::record::conditions::Temperatures;
use nalgebra::Matrix3;

/// A residual scatter of this many times the standard error of the plateau means is not noise of the samples.
const LACK_OF_FIT: f64 = 10.0;
/// Fewer degrees of freedom make intervals an eighth wider than normal ones.
const FEW: usize = 11;
/// A noise below this part of the largest reading is rounding.
const ROUNDING: f64 = 1e-12;

/// An offset that moves within the run to either side of its mean by so many times what noise makes of its trend is told.
const MOVES: f64 = 5.0;
/// What a lag of a minute changes is told beyond this many uncertainties.
const LATE: f64 = 5.0;

/// Every plateau with its residual; `weights` are those of the used ones in turn, `before` the readings at the temperatures of the plateaus
/// where the fit has them at one temperature.
pub(super) fn blocks(
    list: &[Plateau],
    before: Option<&[Reading]>,
    weights: &[f64],
    split: &Split,
    means: &Means,
    stacked: &[f64],
) -> Result<Vec<Block>, SplitError> {
    let sensor = Linear::new(split.phi)?;
    let residual = |p: &Plateau| -> FieldCoil {
        let modelled = sensor.field(p.mean, means.baseline.at(stacked, p.t_s()).1);
        FieldCoil(std::array::from_fn(|axis| p.setting.field.0[axis] - modelled.0[axis]))
    };
    let mut weights = weights.iter();
    let block = |(i, p): (usize, &Plateau)| Block {
        referred_ent: before.and_then(|b| b.get(i)).map(|b| std::array::from_fn(|a| b.0[a] - p.mean.0[a])),
        residual_coil_nt: p.mean.0.iter().all(|v| v.is_finite()).then(|| residual(p)),
        standard_error_coil_nt: standard_error_coil_nt(p, &split.phi),
        weight: if p.dropped.is_none() { weights.next().copied().unwrap_or(1.0) } else { 0.0 },
        plateau: p.clone(),
    };
    Ok(list.iter().enumerate().map(block).collect())
}

/// Says of an offset that moves within the run by far more than its mean is uncertain by; `std_ent` is what is stated of that. Whoever takes the mean
/// for another time than the middle of the run has the rest of the trend as an error.
pub(super) fn moving_offset(offset: &OffsetTrend, std_ent: [f64; 3]) -> Option<Note> {
    const STEPS: i32 = 20;
    // At the ends of even times, noise makes a trend of order p leave its mean by √((p + 1)² - 1) uncertainties of that: Legendre polynomials of the
    // order k have the variance 2 k + 1 there.
    let ends = ((offset.trend_order as f64 + 1.0).powi(2) - 1.0).sqrt();
    let off_ent = |a: usize| -> f64 {
        let at = |tau: f64| offset.trend_ent[a].iter().rev().fold(0.0, |sum, c| sum * tau + c) - offset.b_or_ent[a];
        (-STEPS..=STEPS).map(|i| at(f64::from(i) / f64::from(STEPS))).fold(0.0, |most: f64, off| most.max(off.abs()))
    };
    let told: Vec<String> = (0..3)
        .filter(|a| off_ent(*a) > MOVES * ends * std_ent[*a])
        .map(|a| format!("{:.3} enT in {} (stated ± {:.3} enT)", off_ent(a), COMPONENTS[a], std_ent[a]))
        .collect();
    (!told.is_empty()).then(|| {
        let text = format!(
            "the offset moves within the run, and b_or_ent is its mean: its trend of order {} leads away from that by up to {}; the stated uncertainty is that of \
             the mean and does not hold for the begin and the end of the run",
            offset.trend_order,
            told.join(", ")
        );
        Note::new(NoteKind::Method, text).with_remedy("let the sensor settle before the run, or use the offset of a run of the time in question")
    })
}

/// Says what it would change if the sensor followed its thermistor by a minute, as sensors in their boxes do, where that is far more than what is stated; a
/// run by itself cannot show it. A drift at a steady rate is off by the rate times the lag at every setting.
pub(super) fn late_sensor(slopes: &TemperatureSlopes, std: &LinearStd, rate_k_per_h: f64, channel: &str) -> Option<Note> {
    const MINUTES_PER_HOUR: f64 = 60.0;
    let late_k = rate_k_per_h.abs() / MINUTES_PER_HOUR;
    let angles = ["xi_xy", "xi_xz", "xi_yz"];
    let sigma = (0..3).map(|i| (format!("sigma_{}", COMPONENTS[i]), slopes.sigma[i], std.sigma[i]));
    let all = sigma.chain((0..3).map(|i| (angles[i].to_owned(), slopes.xi_deg[i], std.xi_deg[i])));
    let (name, times) = all
        .map(|(name, slope, std)| (name, (slope * late_k / std).abs()))
        .filter(|(_, times)| times.is_finite())
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (times > LATE).then(|| {
        let text = format!(
            "a sensor that follows {channel} by a minute would be {late_k:.2} K elsewhere, which would change {name} by {times:.0} times its stated \
             uncertainty: a lag does not show in this run and is not in it"
        );
        let remedy = "find the lag with a sweep and name its polynomials with --temperature, or measure at rest";
        Note::new(NoteKind::Temperature, text).about(channel).with_remedy(remedy)
    })
}

/// Standard deviation and extremes of the residuals of the used plateaus.
pub(super) fn residual_summary(blocks: &[Block]) -> Summary {
    let used: Vec<[f64; 3]> =
        blocks.iter().filter(|b| b.plateau.dropped.is_none()).filter_map(|b| b.residual_coil_nt).map(|r| r.0).collect();
    let n = used.len() as f64;
    Summary {
        std: std::array::from_fn(|a| {
            let mean = used.iter().map(|r| r[a]).sum::<f64>() / n;
            (used.iter().map(|r| (r[a] - mean).powi(2)).sum::<f64>() / n).sqrt()
        }),
        max: std::array::from_fn(|a| used.iter().map(|r| r[a]).fold(f64::NEG_INFINITY, f64::max)),
        min: std::array::from_fn(|a| used.iter().map(|r| r[a]).fold(f64::INFINITY, f64::min)),
    }
}

/// Standard error of a plateau mean carried to coil axes, nT.
fn standard_error_coil_nt(plateau: &Plateau, phi: &Matrix3<f64>) -> Option<[f64; 3]> {
    let (std_ent, count) = (plateau.std_ent?, plateau.count.filter(|n| *n > 0)?);
    let variance_ent2 = std_ent.map(|s| s * s / count as f64);
    Some(std::array::from_fn(|axis| (0..3).map(|c| phi[(axis, c)].powi(2) * variance_ent2[c]).sum::<f64>().sqrt()))
}

/// Says where the residuals are larger than what the samples scatter, and which plateaus stand out.
pub(super) fn judge_fit(notes: &mut Vec<Note>, blocks: &[Block]) {
    let used: Vec<&Block> = blocks.iter().filter(|b| b.plateau.dropped.is_none()).collect();
    for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
        let residuals: Vec<f64> = used.iter().filter_map(|b| b.residual_coil_nt).map(|r| r.0[axis]).collect();
        let errors: Option<Vec<f64>> = used.iter().map(|b| b.standard_error_coil_nt.map(|e| e[axis])).collect();
        let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        let scatter = rms(&residuals);
        if let Some(expected) = errors.map(|e| rms(&e)).filter(|e| *e > 0.0 && scatter > LACK_OF_FIT * *e) {
            let text = format!(
                "the {name} residuals scatter by {scatter:.3} nT where the samples of the plateaus let expect {expected:.3} nT; \
                 the model lacks something, or plateaus are disturbed"
            );
            notes.push(Note::new(NoteKind::Fit, text).about(name));
        }
        let far = |of: &dyn Fn(&Block) -> Option<f64>| {
            let usual = robust_std(used.iter().filter_map(|b| of(b)));
            used.iter().map(|b| of(b).is_none_or(|r| usual > 0.0 && r.abs() > OUTLIER * usual)).collect::<Vec<bool>>()
        };
        let residual = |b: &Block| b.residual_coil_nt.map(|r| r.0[axis]);
        // The mean of few samples scatters by more than that of many.
        let of_sample = |b: &Block| Some(residual(b)? * (b.plateau.count? as f64).sqrt());
        let outliers: Vec<String> = used
            .iter()
            .zip(far(&residual).into_iter().zip(far(&of_sample)))
            .filter(|(b, (by_mean, by_samples))| residual(b).is_some() && *by_mean && *by_samples)
            .map(|(b, _)| (b.plateau.index + 1).to_string())
            .collect();
        if !outliers.is_empty() {
            let (blocks, stand) = if outliers.len() == 1 { ("block", "stands") } else { ("blocks", "stand") };
            let text =
                format!("{blocks} {} {stand} out in {name} by more than {OUTLIER} standard deviations", outliers.join(", "));
            notes.push(Note::new(NoteKind::Fit, text).about(name).with_remedy("look at them, or use --robust"));
        }
    }
}

/// Whether the residuals depend on something that the model does not have.
pub(super) fn structure_of(
    temperatures: &Temperatures,
    list: &[Plateau],
    used: &[&Plateau],
    means: &Means,
    noise: &DenseNoise,
) -> Vec<Note> {
    let columns = means.columns();
    structure::notes(&structure::Rows::of(list, used, &temperatures.sensor, &columns, noise))
}

/// Says that few means of unknown scatter tell the uncertainties.
pub(super) fn few_means(noise: &DenseNoise, freedom: usize) -> Option<Note> {
    let text = format!(
        "{} tell the uncertainties, since the file brings means without standard deviation and number of their samples: intervals of 95 % \
         are {:.1} standard uncertainties wide to either side",
        counted(freedom as u64, "degree") + " of freedom",
        student_95(freedom)
    );
    let are_few = !noise.is_from_samples() && freedom < FEW;
    are_few.then(|| Note::new(NoteKind::Method, text).with_remedy("give sx, sy, sz and count in @BLOCKS, or more settings"))
}

/// Says where readings without noise leave the uncertainties open.
pub(super) fn rounding_of(used: &[&Plateau], noise: &DenseNoise) -> Option<Note> {
    let readings = used.iter().flat_map(|p| p.mean.0).fold(0.0, |a: f64, v| a.max(v.abs()));
    let text = "the readings follow the model to the last digit: their scatter does not tell the uncertainties";
    noise.noise.iter().any(|n| n.std < ROUNDING * readings).then(|| Note::new(NoteKind::Method, text))
}
