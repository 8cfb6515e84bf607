//! Structure that no effect of the catalogue explains: a smooth function of one covariate.

use super::record::{Channel, EARLIER};
use super::{About, Acts, Column, Effect, Family, Record, Row, Spec, Unseen, one};
use crate::data::run::interpolate;
use crate::data::units::COMPONENTS;

/// Knots of the smooth function; one less is its degrees of freedom.
const MOST_KNOTS: usize = 5;
/// The same where it is looked at more closely.
const CLOSE_KNOTS: usize = 13;
/// Half of the time over which the rate of a temperature is taken, s.
const RATE_S: f64 = 15.0;

/// Its id, which is the name of its family too.
pub(super) const ID: &str = "unknown";
/// Prior weight relative to an effect of the catalogue.
const PRIOR: f64 = 0.04;
/// Components of the fields of the settings before, the last of them first.
const HISTORY: [&str; EARLIER] = ["previous field _", "field _ two settings before", "field _ three settings before"];
/// The modulus of the field.
pub const MODULUS: &str = "field modulus";
/// The covariates that belong to the times of one run.
pub const TIME: &str = "time";
/// How the names of covariates begin with which the gain goes.
pub const GAIN_WITH: &str = "gain with ";
const GAIN_WITH_TIME: &str = "gain with time";

/// A smooth function of one covariate.
pub struct Unknown;

/// A quantity that readings may depend on, at every row.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariate {
    /// Name, as `field modulus`.
    pub name: String,
    /// Unit.
    pub unit: &'static str,
    /// Value at every row.
    pub values: Vec<f64>,
    /// The function multiplies the reading and does not add to it.
    pub gain: bool,
}

impl Covariate {
    /// Every covariate of a record.
    #[must_use]
    pub fn all(record: &Record) -> Vec<Covariate> {
        let of = |name: String, unit: &'static str, value: &dyn Fn(&Row) -> f64| Covariate {
            name,
            unit,
            values: record.rows.iter().map(value).collect(),
            gain: false,
        };
        let mut all = Vec::new();
        if record.has_fields() {
            for (k, axis) in COMPONENTS.iter().enumerate() {
                all.push(of(format!("field {axis}"), "nT", &|r| r.field_coil_nt[k]));
            }
            all.push(of(MODULUS.to_owned(), "nT", &Row::modulus_nt));
            for (j, k) in [(0, 1), (0, 2), (1, 2)] {
                let name = format!("field {} times field {}", COMPONENTS[j], COMPONENTS[k]);
                all.push(of(name, "nT^2", &|r| r.field_coil_nt[j] * r.field_coil_nt[k]));
            }
            for (before, words) in HISTORY.iter().enumerate() {
                for (k, axis) in COMPONENTS.iter().enumerate() {
                    all.push(of(words.replace('_', axis), "nT", &|r| r.earlier_coil_nt[before][k]));
                }
            }
        }
        let mut slow = vec![of(TIME.to_owned(), "s", &Row::t_s)];
        let temperatures = [("sensor", &record.sensor), ("coil", &record.coil), ("rack", &record.rack)];
        for (name, channel) in temperatures {
            if let Some(channel) = channel {
                slow.push(of_channel(format!("{name} temperature"), "°C", channel));
                let rate = |r: &Row| {
                    let at = |t: f64| interpolate(&channel.course.series, t);
                    (at(r.t_s() + RATE_S) - at(r.t_s() - RATE_S)) / (2.0 * RATE_S)
                };
                slow.push(of(format!("rate of the {name} temperature"), "K/s", &rate));
            }
        }
        for channel in &record.thermistors {
            slow.push(of_channel(format!("temperature {}", channel.name), "°C", channel));
        }
        if record.has_fields() {
            let gains: Vec<Covariate> =
                slow.iter().map(|c| Covariate { name: format!("{GAIN_WITH}{}", c.name), gain: true, ..c.clone() }).collect();
            all.extend(gains);
        }
        all.extend(slow);
        if let Some(variometer) = &record.variometer {
            for (axis, channel) in COMPONENTS.iter().zip(variometer) {
                all.push(of_channel(format!("variometer {axis}"), "nT", channel));
            }
        }
        for channel in &record.others {
            all.push(of_channel(format!("channel {}", channel.name), "", channel));
        }
        all.retain(|c| {
            let (low, high) = c.values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
            c.values.iter().all(|v| v.is_finite()) && high > low
        });
        all
    }

    /// Whether it is a field of a setting before.
    #[must_use]
    pub fn is_of_history(&self) -> bool {
        HISTORY.iter().any(|words| COMPONENTS.iter().any(|axis| self.name == words.replace('_', axis)))
    }

    /// Whether no effect of the catalogue is linear in it, and no parameter of a run.
    fn is_new(&self) -> bool {
        ["times", "rate of", "channel", "settings before"].iter().any(|word| self.name.contains(word)) && !self.gain
    }

    /// Knots at quantiles of the values, between the extremes; fewer where values coincide.
    #[must_use]
    pub fn knots(&self) -> Vec<f64> {
        self.some_knots(MOST_KNOTS)
    }

    /// The columns of a smooth function of it on one axis; `None` where it has too few values.
    #[must_use]
    pub fn smooth(&self, record: &Record, axis: usize) -> Option<Vec<Column>> {
        columns(record, self, &self.spec(axis, MOST_KNOTS)?)
    }

    /// The same with as many knots as where it is looked at most closely.
    #[must_use]
    pub fn close(&self, record: &Record, axis: usize) -> Option<(Spec, Vec<Column>)> {
        let spec = self.spec(axis, CLOSE_KNOTS)?;
        let columns = columns(record, self, &spec)?;
        Some((spec, columns))
    }

    /// A function of it on one axis, with so many knots at most.
    fn spec(&self, axis: usize, most: usize) -> Option<Spec> {
        let knots = self.some_knots(most);
        let spec = Spec::new(&self.name, &[axis]);
        let with = |s: Spec, (k, knot): (usize, &f64)| s.with(&format!("knot {}", k + 1), *knot, self.unit);
        (knots.len() > 1).then(|| knots.iter().enumerate().fold(spec, with))
    }

    fn some_knots(&self, most: usize) -> Vec<f64> {
        let mut sorted = self.values.clone();
        sorted.sort_by(f64::total_cmp);
        let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
        // Half way between equal parts of the range and of the values: programmes put many settings on zero.
        let mut knots: Vec<f64> = (0..most)
            .map(|k| {
                let part = k as f64 / (most - 1) as f64;
                let quantile = sorted[(part * (sorted.len() - 1) as f64).round() as usize];
                0.5 * (low + part * (high - low)) + 0.5 * quantile
            })
            .collect();
        knots.dedup_by(|a, b| *a - *b < 0.02 * (high - low));
        knots
    }
}

fn of_channel(name: String, unit: &'static str, channel: &Channel) -> Covariate {
    Covariate { name, unit, values: channel.values.clone(), gain: false }
}

/// Natural cubic spline without its constant: the value over the range of the knots, and one bend per inner knot. The bends have no
/// constant and no slope over the knots, so that they do not stand in for what a linear sensor is.
#[must_use]
pub fn spline(knots: &[f64], value: f64) -> Vec<f64> {
    let n = knots.len();
    let (first, last) = (knots[0], knots[n - 1]);
    let scale = last - first;
    let along = |v: f64| (v - first) / scale - 0.5;
    let mut basis = vec![along(value)];
    if n > 2 {
        let bends = |v: f64| -> Vec<f64> {
            let u = |knot: f64| ((v - knot) / scale).max(0.0).powi(3);
            let bend = |k: usize| (u(knots[k]) - u(last)) * scale / (last - knots[k]);
            let reference = bend(n - 2);
            (0..n - 2).map(|k| bend(k) - reference).collect()
        };
        let at_knots: Vec<Vec<f64>> = knots.iter().map(|k| bends(*k)).collect();
        let middle = knots.iter().map(|k| along(*k)).sum::<f64>() / n as f64;
        let spread: f64 = knots.iter().map(|k| (along(*k) - middle).powi(2)).sum();
        basis.extend(bends(value).into_iter().enumerate().map(|(k, bend)| {
            let mean = at_knots.iter().map(|b| b[k]).sum::<f64>() / n as f64;
            let slope = knots.iter().zip(&at_knots).map(|(x, b)| (along(*x) - middle) * b[k]).sum::<f64>() / spread;
            bend - mean - slope * (along(value) - middle)
        }));
    }
    basis
}

impl Effect for Unknown {
    fn id(&self) -> &'static str {
        ID
    }

    fn about(&self) -> About {
        About {
            summary: "structured, significant, none of the above",
            formula: "x_i += S(C) or x_i S(C), S a natural cubic spline of one covariate C",
            family: Family::Unknown,
            seen_in: "all",
            needs: "any covariate",
            source: "diagnosis itself",
            best_measurement: "settings that spread over the covariate while all else stays",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn prior(&self, _trend_order: Option<usize>) -> f64 {
        PRIOR
    }

    fn is_of_one_run(&self, form: &str) -> bool {
        form == TIME || form == GAIN_WITH_TIME
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let mut all = Covariate::all(record);
        // Whatever is smooth in time is a drift of the offset, which is in the catalogue.
        all.retain(|c| c.name != TIME);
        let mut specs: Vec<Spec> = all.iter().flat_map(|c| (0..3).filter_map(move |axis| c.spec(axis, MOST_KNOTS))).collect();
        // Of what the catalogue has no effect for, a straight line comes first.
        let straight = all.iter().filter(|c| c.is_new()).flat_map(|c| (0..3).filter_map(move |axis| c.spec(axis, 2)));
        specs.extend(straight);
        // A converter has steps: the field along the axis is looked at more closely.
        for (axis, name) in COMPONENTS.iter().enumerate() {
            let own = all.iter().find(|c| c.name == format!("field {name}"));
            specs.extend(own.and_then(|c| c.spec(axis, CLOSE_KNOTS)));
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let covariate = Covariate::all(record).into_iter().find(|c| c.name == spec.form)?;
        columns(record, &covariate, spec)
    }

    fn example(&self, record: &Record) -> Option<Spec> {
        self.specs(record).ok()?.into_iter().find(|s| s.form == "field modulus")
    }
}

/// The columns of a smooth function of a covariate that is at hand.
#[must_use]
pub fn columns(record: &Record, covariate: &Covariate, spec: &Spec) -> Option<Vec<Column>> {
    let knots: Vec<f64> = spec.shape.iter().map(|(_, knot, _)| *knot).collect();
    let axis = *spec.axes.first()?;
    if knots.len() < 2 {
        return None;
    }
    let rows: Vec<Vec<f64>> = covariate.values.iter().map(|v| spline(&knots, *v)).collect();
    let unit = if covariate.gain { "1" } else { record.scale.unit() };
    let column = |k: usize| {
        Column::of(format!("s{}_{}", k + 1, COMPONENTS[axis]), unit, record, |i, r| {
            one(axis, if covariate.gain { rows[i][k] * r.linear_ent[axis] } else { rows[i][k] })
        })
    };
    // What is linear in a component of the field belongs to the linear sensor.
    let linear = COMPONENTS.iter().any(|a| covariate.name == format!("field {a}"));
    Some((usize::from(linear)..knots.len() - 1).map(column).collect())
}
