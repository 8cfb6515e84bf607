//! Long records in zero field: offset drift, noise, its Allan deviation, what the offset follows, and where the data stop.
//!
//! While the file is read a [`Record`] keeps, in bounded memory, the sums of equal bins, periodograms of the full sample rate, and the
//! record at a 64th of that rate or less for the low frequencies. Drift and coefficients are least-squares fits to at most
//! [`ROWS`] means; what slow noise does to them is told from inside the means and between them
//! ([`crate::fit::noise`]). Spectrum and Allan deviation are those of [`crate::fit::spectrum`] and [`crate::fit::allan`].

mod record;

use crate::data::zero_field::{
    AllanDeviations, ChannelDependence, DataStop, JointDependence, NoiseCorner, NoiseDensity, NoiseSpectrum, RecordExtent,
    ScaledZeroField, SpectralLine, ZeroFieldFound, ZeroFieldOffset,
};
pub use record::{BLOCK, CHUNK, MOST_FILLED, Record};

use crate::data::calibration::Sensitivities;
use crate::data::envelope;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::data::run::{Kind, Run, SlowTable};
use crate::data::units::COMPONENTS;
use crate::fit::allan::{self, Bin, Deviation};
use crate::fit::noise::dense::{self, Octave};
use crate::fit::spectrum::{self, FIRST_BIN, Line, NEXT_BIN, Point, Stage, WhiteAndSlow, limits};
use crate::fit::{Design, FitError, Limits, solve};
use crate::model::campaign::Instructions;
use crate::record::conditions::{self, Temperatures};
use nalgebra::DMatrix;
use serde::Serialize;
use thiserror::Error;

/// Means to which drift and coefficients are fitted, at most.
pub const ROWS: usize = 128;
/// Fewer samples are no record of noise.
pub const LEAST_SAMPLES: u64 = 1024;
/// Points of the spectrum in a decade.
const PER_DECADE: f64 = 16.0;
/// The density is stated at this frequency, Hz, from the bins within this factor of it.
pub const STATED_HZ: f64 = 1.0;
const STATED_RATIO: f64 = 1.15;
/// White and 1/f noise are fitted from here, Hz, to a quarter of the sample rate, above which the instrument's own filter shows.
const FIT_FROM_HZ: f64 = 2e-3;
const FIT_TO_RATE: f64 = 0.25;
/// Gaps as long as this are stops, s.
const STOP_S: f64 = 10.0;
/// Samples that are all alike for this long, and at least so many, are no measurement.
const FROZEN_S: f64 = 10.0;
const FROZEN_SAMPLES: u64 = 64;
/// Part of a mean's samples that must be there.
const LEAST_COVERAGE: f64 = 0.5;
/// A channel whose means vary by less than this part of their size does not vary.
const LEAST_VARIATION: f64 = 1e-9;
/// χ² per degree of freedom from which on white and 1/f noise do not describe the spectrum.
const BAD_FIT: f64 = 3.0;

/// How a zero-field run is analysed.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Order of the drift, 0 to 3.
    pub order: usize,
    /// Linear calibration whose sensitivities give the results in nT as well, with its file.
    pub cpf: Option<(Input, Sensitivities)>,
}

impl Default for Options {
    fn default() -> Self {
        Self { order: 1, cpf: None }
    }
}

/// Why a run has no result.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NullError {
    /// Another kind of run.
    #[error("the run is of kind {0}, not zero-field")]
    Kind(Kind),
    /// A field is applied.
    #[error("setting {0} applies a field, or a sine")]
    Field(usize),
    /// The sensor was turned.
    #[error("the run holds more than one position, so its offset is not one quantity")]
    Positions,
    /// Too short.
    #[error("the run holds {0} samples; noise and drift need {LEAST_SAMPLES} at least")]
    TooShort(u64),
    /// A fit has no answer.
    #[error("the drift cannot be fitted: {0}")]
    Fit(#[from] FitError),
}

impl NullError {
    /// What to do.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            NullError::Kind(_) => "use the command for that kind",
            NullError::Field(_) => "correct `kind` in the head of the run, or use the command for such runs",
            NullError::Positions => "use `calfit offset`, or part the run",
            NullError::TooShort(_) => "record longer",
            NullError::Fit(_) => "choose a lower --order",
        }
    }
}

/// Value and standard uncertainty per component.
pub type Level = [[f64; 2]; 3];

/// Mean of a stretch of the record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Begin and end, s since the run's start.
    pub interval_s: [f64; 2],
    /// Mean reading, enT.
    pub mean_ent: [f64; 3],
    /// Samples.
    pub count: u64,
    /// The drift that was fitted, and its standard uncertainty, enT.
    pub drift_ent: Level,
}

impl Row {
    /// Its middle, s.
    #[must_use]
    pub fn t_s(&self) -> f64 {
        0.5 * (self.interval_s[0] + self.interval_s[1])
    }
}

/// The result of a zero-field run. Values that are not determined are nan.
#[derive(Clone, Debug)]
pub struct Null {
    /// What was found.
    pub found: ZeroFieldFound,
    /// The means with the drift.
    pub rows: Vec<Row>,
    /// Mean of every channel over every row; NaN where it has no reading.
    pub channels: Vec<(String, Vec<f64>)>,
    /// Temperatures.
    pub temperatures: Temperatures,
    /// Extent of the raw data.
    pub samples: Option<Vec<envelope::Column>>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// Analyses a zero-field run.
///
/// # Errors
/// Why the run has no result.
pub fn null(run: &Run, record: Record, instructions: &Instructions, options: &Options) -> Result<Null, NullError> {
    if run.header.kind != Kind::ZeroField {
        return Err(NullError::Kind(run.header.kind));
    }
    let applies = |s: &crate::data::run::Setting| s.frequency_hz > 0.0 || s.field.0.iter().any(|b| *b != 0.0);
    if let Some(index) = run.settings.iter().position(applies) {
        return Err(NullError::Field(index + 1));
    }
    if run.settings.windows(2).any(|pair| pair[0].position != pair[1].position) {
        return Err(NullError::Positions);
    }
    let (Some(span_s), true) = (run.vectors.span_s, run.vectors.count >= LEAST_SAMPLES) else {
        return Err(NullError::TooShort(run.vectors.count));
    };
    let mut notes = Vec::new();
    let rate_hz = run.vectors.measured_rate_hz.unwrap_or(run.header.sample_rate_hz);
    let record = record.finish();
    let stop = stops(run, &record, span_s, rate_hz);
    for s in &stop {
        let text = format!("STOP {} from {:.1} to {:.1} s, {:.0} s", s.what, s.from_s, s.until_s, s.until_s - s.from_s);
        notes.push(Note::new(NoteKind::Data, text));
    }
    let temperatures = Temperatures::of(run, instructions, span_s, &mut notes);

    let bin_s = record.bin_samples as f64 / rate_hz;
    let (mut rows, width) = rows(&record, span_s[0], bin_s);
    let octaves = octaves(&record.bins, width, bin_s, record.bin_samples);
    let fitter = Fitter { rows: &rows, octaves: &octaves };
    let centre_s = 0.5 * (span_s[0] + span_s[1]);
    let half_s = 0.5 * (span_s[1] - span_s[0]);
    let (offset, drift) = fitter.drift(options.order, centre_s, half_s)?;
    for (row, drift) in rows.iter_mut().zip(drift) {
        row.drift_ent = drift;
    }

    let fitter = Fitter { rows: &rows, octaves: &octaves };
    let channels = channel_rows(run, &rows);
    let sensor_channel = instructions.channels(&run.header).0;
    let channel: Vec<ChannelDependence> =
        channels.iter().filter_map(|(name, values)| fitter.channel(name, unit(run, name), values)).collect();
    let main: Vec<&(String, Vec<f64>)> = channels
        .iter()
        .filter(|(name, _)| (*name == sensor_channel || name.starts_with("VAR")) && channel.iter().any(|c| c.name == *name))
        .collect();
    let together = if main.len() > 1 { fitter.together(&main) } else { None };

    let stages = stages(&record, rate_hz);
    let mut lines: Vec<Line> = stages.iter().flat_map(spectrum::lines).collect();
    lines.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz).then(a.component.cmp(&b.component)));
    let points = spectrum::bands(&stages, PER_DECADE, &lines);
    let density = density(&stages, &lines);
    if density.is_none() {
        let text = format!("no density at {STATED_HZ} Hz: the sample rate or the record does not reach it");
        notes.push(Note::new(NoteKind::Method, text));
    }
    let corner = corner(&points, rate_hz);
    for (i, c) in corner.iter().enumerate().filter_map(|(i, c)| c.as_ref().map(|c| (i, c))) {
        if c.chi_square_per_degree > BAD_FIT {
            let text = format!(
                "{}: white and 1/f noise do not describe the spectrum (χ² {:.1} per degree of freedom)",
                COMPONENTS[i], c.chi_square_per_degree
            );
            notes.push(Note::new(NoteKind::Method, text).about(COMPONENTS[i]));
        }
    }
    let allan = allan::deviations(&record.within, &record.bins, record.bin_samples, rate_hz);
    conditions::warn_of_run(&mut notes, run);
    let found = ZeroFieldFound {
        run: conditions::head(run, instructions, &temperatures),
        record: RecordExtent {
            samples: run.vectors.count,
            lost: run.vectors.lost,
            gaps: run.vectors.gap_count,
            bridged: record.filled,
            time_s: span_s,
            sample_rate_hz: rate_hz,
        },
        offset,
        density,
        scaled: None,
        corner: corner_part(&corner),
        line: lines.iter().map(line_part).collect(),
        spectrum: spectrum_part(&points),
        allan: allan_part(&allan),
        channel,
        together,
        stop,
    };
    let mut result = Null { found, rows, channels, temperatures, samples: None, notes };
    if let Some((input, sensitivities)) = &options.cpf {
        result.scale(&input.path, sensitivities);
    }
    Ok(result)
}

impl Null {
    /// Gives reading, drift and density in nT as well, with the sensitivities of a linear calibration; `name` is that of its file.
    pub fn scale(&mut self, name: &str, of: &Sensitivities) {
        self.notes.extend(of.of_another(name, "readings", &self.found.run));
        let each = |list: &[[f64; 3]]| list.iter().map(|ent| of.to_nt(ent)).collect();
        self.found.scaled = Some(ScaledZeroField {
            cpf: name.to_owned(),
            sigma: of.sigma_nt_per_ent,
            mean_nt: of.to_nt(&self.found.offset.mean_ent),
            mean_std_nt: of.to_nt(&self.found.offset.mean_std_ent),
            drift_nt_per_h: each(&self.found.offset.drift_ent_per_h),
            drift_std_nt_per_h: each(&self.found.offset.drift_std_ent_per_h),
            nt_per_root_hz: self.found.density.as_ref().map(|d| of.to_nt(&d.ent_per_root_hz)),
            std_nt_per_root_hz: self.found.density.as_ref().map(|d| of.to_nt(&d.std_ent_per_root_hz)),
        });
    }
}

/// Where the data begin late, end early, have long gaps, or stand still.
fn stops(run: &Run, record: &record::Kept, span_s: [f64; 2], rate_hz: f64) -> Vec<DataStop> {
    let mut list = Vec::new();
    let least_s = (2.0 / rate_hz).max(1.0);
    if let (Some(first), Some(last)) = (run.settings.first(), run.settings.last()) {
        if span_s[0] > first.t_start_s + least_s {
            list.push(DataStop {
                what: "the data begin after the setting does".to_owned(),
                from_s: first.t_start_s,
                until_s: span_s[0],
            });
        }
        if span_s[1] + least_s < last.t_end_s {
            list.push(DataStop {
                what: "the data end before the setting does".to_owned(),
                from_s: span_s[1],
                until_s: last.t_end_s,
            });
        }
    }
    for gap in &run.vectors.gaps {
        let length_s = gap.lost as f64 / rate_hz;
        if length_s >= STOP_S {
            list.push(DataStop { what: "samples are missing".to_owned(), from_s: gap.t_s - length_s, until_s: gap.t_s });
        }
    }
    if let Some([from_s, until_s]) = record.frozen_s
        && until_s - from_s >= FROZEN_S
        && (until_s - from_s) * rate_hz >= FROZEN_SAMPLES as f64
    {
        list.push(DataStop { what: "all three readings stand still".to_owned(), from_s, until_s });
    }
    list.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    list
}

/// Means of bins side by side, and the number of bins in each.
fn rows(record: &record::Kept, begin_s: f64, bin_s: f64) -> (Vec<Row>, usize) {
    let width = record.bins.len().div_ceil(ROWS).max(1);
    let rows = record.bins.chunks(width).enumerate().filter_map(|(i, bins)| {
        let count: u64 = bins.iter().map(|b| u64::from(b.count)).sum();
        let full = (width as u64 * record.bin_samples) as f64;
        let begin = begin_s + (i * width) as f64 * bin_s;
        let row = Row {
            interval_s: [begin, begin + bins.len() as f64 * bin_s],
            mean_ent: std::array::from_fn(|c| record.reference[c] + bins.iter().map(|b| b.sum[c]).sum::<f64>() / count as f64),
            count,
            drift_ent: [[f64::NAN; 2]; 3],
        };
        (count as f64 >= LEAST_COVERAGE * full).then_some(row)
    });
    (rows.collect(), width)
}

/// Contrasts of neighbouring parts within the rows, from one bin up to half a row.
fn octaves(bins: &[Bin], width: usize, bin_s: f64, bin_samples: u64) -> Vec<Octave> {
    let mut octaves = Vec::new();
    let mut length = 1;
    while 2 * length <= width {
        let mut octave = Octave {
            length: length as f64 * bin_s,
            count: 0.0,
            white: 2.0 / (length as f64 * bin_samples as f64),
            squares: vec![0.0; 3],
        };
        for row in bins.chunks(width) {
            for pair in row.chunks_exact(2 * length) {
                if pair.iter().all(|b| u64::from(b.count) == bin_samples) {
                    let mean = |part: &[Bin], c: usize| part.iter().map(|b| b.sum[c]).sum::<f64>();
                    let (a, b) = pair.split_at(length);
                    for c in 0..3 {
                        octave.squares[c] += ((mean(b, c) - mean(a, c)) / (length as f64 * bin_samples as f64)).powi(2);
                    }
                    octave.count += 1.0;
                }
            }
        }
        if octave.count > 0.0 {
            octaves.push(octave);
        }
        length *= 2;
    }
    octaves
}

/// Coefficients of one component with their covariance.
struct Fitted {
    coefficients: DMatrix<f64>,
    /// Parameter j of component a at `a * p + j`.
    covariance: DMatrix<f64>,
    residual_std: Vec<f64>,
}

struct Fitter<'a> {
    rows: &'a [Row],
    octaves: &'a [Octave],
}

impl Fitter<'_> {
    /// Least squares of all three components; rows with a gap in a column do not count.
    fn fit(&self, names: &[&str], columns: &[Vec<f64>]) -> Result<Fitted, FitError> {
        let used: Vec<usize> = (0..self.rows.len()).filter(|i| columns.iter().all(|c| c[*i].is_finite())).collect();
        let design = Design::new(
            names.iter().map(|n| (*n).to_owned()).collect(),
            DMatrix::from_fn(used.len(), columns.len(), |i, j| columns[j][used[i]]),
        )?;
        let rhs = DMatrix::from_fn(used.len(), 3, |i, c| self.rows[used[i]].mean_ent[c]);
        let counts: Vec<f64> = used.iter().map(|i| self.rows[*i].count as f64).collect();
        let mean = counts.iter().sum::<f64>() / counts.len().max(1) as f64;
        let weights: Vec<f64> = counts.iter().map(|n| n / mean).collect();
        let solution = solve(&design, &rhs, Some(&weights), &Limits::default())?;
        let intervals: Vec<[f64; 2]> = used.iter().map(|i| self.rows[*i].interval_s).collect();
        let noise = dense::estimate_with(&solution, &intervals, &counts, self.octaves)?;
        Ok(Fitted {
            covariance: noise.covariance(),
            residual_std: solution.residual_std.clone(),
            coefficients: solution.coefficients,
        })
    }

    /// The drift, a polynomial of `(t - centre) / half`, and its value and uncertainty at every row.
    fn drift(&self, order: usize, centre_s: f64, half_s: f64) -> Result<(ZeroFieldOffset, Vec<Level>), FitError> {
        let x: Vec<f64> = self.rows.iter().map(|r| (r.t_s() - centre_s) / half_s).collect();
        let names = &["mean", "drift", "drift^2", "drift^3"][..=order];
        let columns: Vec<Vec<f64>> = (0..=order as i32).map(|k| x.iter().map(|x| x.powi(k)).collect()).collect();
        let fit = self.fit(names, &columns)?;
        let p = order + 1;
        let std = |c: usize, j: usize| fit.covariance[(c * p + j, c * p + j)].sqrt();
        let per_h = |j: usize| (3600.0 / half_s).powi(j as i32);
        let values = |j: usize| std::array::from_fn(|c| fit.coefficients[(j, c)] * per_h(j));
        let stds = |j: usize| std::array::from_fn(|c| std(c, j) * per_h(j));
        let at = |x: f64, c: usize| {
            let value = (0..p).map(|j| fit.coefficients[(j, c)] * x.powi(j as i32)).sum();
            let variance: f64 = (0..p)
                .flat_map(|j| (0..p).map(move |k| (j, k)))
                .map(|(j, k)| fit.covariance[(c * p + j, c * p + k)] * x.powi((j + k) as i32))
                .sum();
            [value, variance.sqrt()]
        };
        let drift = x.iter().map(|x| std::array::from_fn(|c| at(*x, c))).collect();
        let range = |c: usize| {
            let means = self.rows.iter().map(|r| r.mean_ent[c]);
            means.clone().fold(f64::NEG_INFINITY, f64::max) - means.fold(f64::INFINITY, f64::min)
        };
        let offset = ZeroFieldOffset {
            time_s: centre_s,
            order,
            mean_ent: values(0),
            mean_std_ent: stds(0),
            drift_ent_per_h: (1..p).map(values).collect(),
            drift_std_ent_per_h: (1..p).map(stds).collect(),
            residual_std_ent: std::array::from_fn(|c| fit.residual_std[c]),
            range_ent: std::array::from_fn(range),
            rows: self.rows.len(),
        };
        Ok((offset, drift))
    }

    /// The means against one channel; `None` if that does not vary.
    fn channel(&self, name: &str, unit: &str, values: &[f64]) -> Option<ChannelDependence> {
        let (centred, spread) = centred(values)?;
        let fit = self.fit(&["mean", name], &[vec![1.0; values.len()], centred.clone()]).ok()?;
        let correlation = |c: usize| {
            let pairs: Vec<(f64, f64)> =
                centred.iter().zip(self.rows).filter(|(x, _)| x.is_finite()).map(|(x, r)| (*x, r.mean_ent[c])).collect();
            let mean = pairs.iter().map(|(_, y)| y).sum::<f64>() / pairs.len() as f64;
            let product: f64 = pairs.iter().map(|(x, y)| x * (y - mean)).sum();
            let squares: f64 = pairs.iter().map(|(_, y)| (y - mean).powi(2)).sum();
            product / (squares * pairs.iter().map(|(x, _)| x * x).sum::<f64>()).sqrt()
        };
        Some(ChannelDependence {
            name: name.to_owned(),
            unit: unit.to_owned(),
            range: spread,
            coefficient_ent: std::array::from_fn(|c| fit.coefficients[(1, c)]),
            coefficient_std_ent: std::array::from_fn(|c| fit.covariance[(c * 2 + 1, c * 2 + 1)].sqrt()),
            correlation: std::array::from_fn(correlation),
        })
    }

    /// The means against several channels at once; `None` if they cannot be told apart.
    fn together(&self, channels: &[&(String, Vec<f64>)]) -> Option<JointDependence> {
        let mut names = vec!["mean"];
        let mut columns = vec![vec![1.0; self.rows.len()]];
        for (name, values) in channels {
            names.push(name);
            columns.push(centred(values)?.0);
        }
        let fit = self.fit(&names, &columns).ok()?;
        let p = names.len();
        Some(JointDependence {
            channels: channels.iter().map(|(name, _)| name.clone()).collect(),
            coefficient_ent: (1..p).map(|j| std::array::from_fn(|c| fit.coefficients[(j, c)])).collect(),
            coefficient_std_ent: (1..p).map(|j| std::array::from_fn(|c| fit.covariance[(c * p + j, c * p + j)].sqrt())).collect(),
            residual_std_ent: std::array::from_fn(|c| fit.residual_std[c]),
        })
    }
}

/// Values less their mean, with their range; `None` if they hardly vary or are few.
fn centred(values: &[f64]) -> Option<(Vec<f64>, f64)> {
    let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    let (low, high) = known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let varies = known.len() >= 8 && high - low > LEAST_VARIATION * mean.abs().max(1.0);
    varies.then(|| (values.iter().map(|v| v - mean).collect(), high - low))
}

fn unit(run: &Run, channel: &str) -> &'static str {
    if run.temperatures.names.iter().any(|n| n == channel) {
        "K"
    } else if channel.starts_with("VAR") {
        "nT"
    } else {
        "unit of the channel"
    }
}

/// Means of the slow channels over the rows; between readings a straight line.
fn channel_rows(run: &Run, rows: &[Row]) -> Vec<(String, Vec<f64>)> {
    let of = |table: &SlowTable| -> Vec<(String, Vec<f64>)> {
        table
            .names
            .iter()
            .filter_map(|name| Some((name.clone(), table.channel(name)?)))
            .map(|(name, series)| (name, rows.iter().map(|row| mean_over(&series, row)).collect()))
            .collect()
    };
    let mut list = of(&run.temperatures);
    for (name, values) in of(&run.channels) {
        if !list.iter().any(|(n, _)| *n == name) {
            list.push((name, values));
        }
    }
    list
}

fn mean_over(series: &[(f64, f64)], row: &Row) -> f64 {
    let [from, until] = row.interval_s;
    let first = series.partition_point(|(t, _)| *t < from);
    let after = series.partition_point(|(t, _)| *t <= until);
    if after > first {
        return series[first..after].iter().map(|(_, v)| v).sum::<f64>() / (after - first) as f64;
    }
    match (first.checked_sub(1).and_then(|i| series.get(i)), series.get(first)) {
        (Some((t0, v0)), Some((t1, v1))) => v0 + (v1 - v0) * (row.t_s() - t0) / (t1 - t0),
        _ => f64::NAN,
    }
}

/// The spectrum from the lowest frequency to the highest: long segments of the slow record, then the full rate.
fn stages(record: &record::Kept, rate_hz: f64) -> Vec<Stage> {
    let full = record.welch.density(rate_hz).filter(|_| record.head.is_none());
    let (slow, slow_hz) = match &record.head {
        Some(head) => (head, rate_hz),
        None => (&record.slow, rate_hz / record.slow_samples as f64),
    };
    // Above this the full rate takes over, or the record is at full rate itself.
    let until_hz = full.as_ref().map_or(f64::INFINITY, |f| NEXT_BIN as f64 * f.step_hz);
    let mut stages = Vec::new();
    let mut length = spectrum::longest_segment(slow[0].len());
    let mut from = FIRST_BIN as f64;
    while length >= 64 {
        let Some(density) = spectrum::of_record(slow.each_ref().map(Vec::as_slice), slow_hz, length) else {
            // Gaps leave no segment of this length.
            length = length / 4 * 2;
            continue;
        };
        let next = length / 8 * 2;
        let step = density.step_hz;
        let is_last = next < 64 || NEXT_BIN as f64 * slow_hz / next as f64 > until_hz;
        let top = density.power[0].len() - 1;
        let end_hz = if is_last { until_hz } else { NEXT_BIN as f64 * slow_hz / next as f64 };
        let end = if end_hz.is_finite() { ((end_hz / step).ceil() as usize).min(top) } else { top };
        let begin = from.ceil() as usize;
        if end > begin {
            stages.push(Stage { density, bins: [begin, end] });
        }
        from = NEXT_BIN as f64;
        if is_last {
            break;
        }
        length = next;
    }
    if let Some(full) = full {
        let top = full.power[0].len() - 1;
        let begin = if stages.is_empty() { FIRST_BIN } else { NEXT_BIN };
        stages.push(Stage { density: full, bins: [begin, top] });
    }
    stages
}

/// Amplitude density at 1 Hz from the bins around it.
fn density(stages: &[Stage], lines: &[Line]) -> Option<NoiseDensity> {
    let [low, high] = [STATED_HZ / STATED_RATIO, STATED_HZ * STATED_RATIO];
    let stage = stages.iter().find(|s| {
        let step = s.density.step_hz;
        s.bins[0] as f64 * step <= low && (s.bins[1] - 1) as f64 * step >= high
    })?;
    let step = stage.density.step_hz;
    let part = Stage { density: stage.density.clone(), bins: [(low / step).ceil() as usize, (high / step).floor() as usize + 1] };
    // One band of all of it.
    let point = *spectrum::bands(&[part], 0.5, lines).first()?;
    let [low, high] = point.limits();
    let amplitude: [f64; 3] = std::array::from_fn(|c| point.amplitude(c));
    Some(NoiseDensity {
        frequency_hz: STATED_HZ,
        band_hz: point.band_hz,
        ent_per_root_hz: amplitude,
        std_ent_per_root_hz: amplitude.map(|a| a / (2.0 * point.degrees_of_freedom).sqrt()),
        low_ent_per_root_hz: amplitude.map(|a| a * low),
        high_ent_per_root_hz: amplitude.map(|a| a * high),
        degrees_of_freedom: point.degrees_of_freedom,
    })
}

fn corner(points: &[Point], rate_hz: f64) -> [Option<WhiteAndSlow>; 3] {
    let used: Vec<&Point> =
        points.iter().filter(|p| p.frequency_hz >= FIT_FROM_HZ && p.frequency_hz <= FIT_TO_RATE * rate_hz).collect();
    std::array::from_fn(|c| spectrum::white_and_slow(&used, c))
}

fn corner_part(corner: &[Option<WhiteAndSlow>; 3]) -> NoiseCorner {
    let get = |f: &dyn Fn(&WhiteAndSlow) -> f64| std::array::from_fn(|c| corner[c].as_ref().map_or(f64::NAN, f));
    NoiseCorner {
        white_ent_per_root_hz: get(&|w| w.white.max(0.0).sqrt()),
        white_std_ent_per_root_hz: get(&|w| 0.5 * w.white_std / w.white.sqrt()),
        slow_ent_per_root_hz: get(&|w| w.slow.max(0.0).sqrt()),
        corner_hz: get(&|w| w.corner_hz),
        corner_std_hz: get(&|w| w.corner_std_hz),
        chi_square_per_degree: get(&|w| w.chi_square_per_degree),
    }
}

fn line_part(line: &Line) -> SpectralLine {
    SpectralLine {
        component: COMPONENTS[line.component].to_owned(),
        frequency_hz: line.frequency_hz,
        resolution_hz: line.step_hz,
        amplitude_ent: line.amplitude,
        amplitude_std_ent: line.amplitude_std,
        power_ratio: line.ratio,
    }
}

fn spectrum_part(points: &[Point]) -> NoiseSpectrum {
    let density = |c: usize| points.iter().map(|p| p.amplitude(c)).collect();
    NoiseSpectrum {
        frequency_hz: points.iter().map(|p| p.frequency_hz).collect(),
        x_ent_per_root_hz: density(0),
        y_ent_per_root_hz: density(1),
        z_ent_per_root_hz: density(2),
        low_factor: points.iter().map(|p| p.limits()[0]).collect(),
        high_factor: points.iter().map(|p| p.limits()[1]).collect(),
        degrees_of_freedom: points.iter().map(|p| p.degrees_of_freedom).collect(),
    }
}

fn allan_part(list: &[Deviation]) -> AllanDeviations {
    let deviation = |c: usize| list.iter().map(|d| d.deviation[c]).collect();
    AllanDeviations {
        tau_s: list.iter().map(|d| d.tau_s).collect(),
        x_ent: deviation(0),
        y_ent: deviation(1),
        z_ent: deviation(2),
        low_factor: list.iter().map(|d| limits(d.degrees_of_freedom)[0]).collect(),
        high_factor: list.iter().map(|d| limits(d.degrees_of_freedom)[1]).collect(),
        degrees_of_freedom: list.iter().map(|d| d.degrees_of_freedom).collect(),
    }
}

#[cfg(test)]
mod tests;
