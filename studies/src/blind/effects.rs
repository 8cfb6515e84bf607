//! Hidden effects: what they add to the readings, and what stands about them in the truth.
//!
//! Forms differ from those of a catalogue wherever nature leaves the choice; every effect with a free form also occurs in the plain form
//! (`exact`), which is the one whose amplitude can be compared.

use super::noise::Random;
use super::sensor::{CleanRun, Curve, Kind, cross, times};
use std::f64::consts::TAU;

/// Adds to the readings of a run, enT per sample, at an amplitude.
type Shape = Box<dyn Fn(&CleanRun, usize, f64) -> Vec<[f64; 3]> + Send + Sync>;

/// Adds to a slow channel at a time, s.
type Change = Box<dyn Fn(f64) -> f64 + Send + Sync>;

/// One parameter of the truth.
pub struct Parameter {
    pub name: String,
    pub unit: &'static str,
    /// At an amplitude of one.
    pub value: f64,
    /// Whether it is in proportion to the amplitude.
    pub scales: bool,
}

/// An effect with its form drawn and its amplitude open.
pub struct Effect {
    /// Name in the catalogue, or `unknown`.
    pub id: &'static str,
    pub form: String,
    pub axes: Vec<&'static str>,
    /// The form is the plain one, so that parameters of the same name can be compared.
    pub exact: bool,
    /// For `unknown`: names that the quantity it depends on may be given, the first one preferred.
    pub covariates: Vec<&'static str>,
    pub parameters: Vec<Parameter>,
    /// It is seen inside the plateaus.
    pub inside: bool,
    /// Its size is that of nature and not scaled.
    pub natural: bool,
    /// A change of a slow channel.
    pub channel: Option<(&'static str, Change)>,
    shape: Shape,
}

impl Effect {
    fn new(id: &'static str, form: impl Into<String>, shape: Shape) -> Self {
        Self {
            id,
            form: form.into(),
            axes: AXES.to_vec(),
            exact: false,
            covariates: Vec::new(),
            parameters: Vec::new(),
            inside: false,
            natural: false,
            channel: None,
            shape,
        }
    }

    /// An effect on sines, which is seen in the samples.
    pub fn of_sines(id: &'static str, form: &str, f: impl Fn(&CleanRun, f64) -> Vec<[f64; 3]> + Send + Sync + 'static) -> Self {
        Self::new(id, form, Box::new(move |clean, _, amplitude| f(clean, amplitude))).inside()
    }

    /// Of nature's own size, not scaled.
    pub fn of_nature(self) -> Self {
        self.natural()
    }

    fn on(mut self, axes: [f64; 3]) -> Self {
        self.axes = (0..3).filter(|i| axes[*i] != 0.0).map(|i| AXES[i]).collect();
        self
    }

    fn exact(mut self, exact: bool) -> Self {
        self.exact = exact;
        self
    }

    fn inside(mut self) -> Self {
        self.inside = true;
        self
    }

    fn natural(mut self) -> Self {
        self.natural = true;
        self
    }

    fn depends(mut self, covariates: &[&'static str]) -> Self {
        self.covariates = covariates.to_vec();
        self
    }

    /// A parameter in proportion to the amplitude.
    fn scaled(mut self, name: impl Into<String>, unit: &'static str, value: f64) -> Self {
        self.parameters.push(Parameter { name: name.into(), unit, value, scales: true });
        self
    }

    fn per_axis(mut self, stem: &str, unit: &'static str, values: [f64; 3]) -> Self {
        for i in 0..3 {
            if values[i] != 0.0 {
                self = self.scaled(format!("{stem}_{}", AXES[i]), unit, values[i]);
            }
        }
        self
    }

    /// A parameter of the form.
    fn fixed(mut self, name: &str, unit: &'static str, value: f64) -> Self {
        self.parameters.push(Parameter { name: name.to_owned(), unit, value, scales: false });
        self
    }

    /// What it adds to the readings of a run at an amplitude, enT per sample.
    pub fn contribution(&self, clean: &CleanRun, run: usize, amplitude: f64) -> Vec<[f64; 3]> {
        (self.shape)(clean, run, amplitude)
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// A contribution from a function of the sample, in proportion to the amplitude.
fn linear(f: impl Fn(&CleanRun, usize) -> [f64; 3] + Send + Sync + 'static) -> Shape {
    Box::new(move |clean, _, amplitude| (0..clean.count).map(|s| f(clean, s).map(|v| amplitude * v)).collect())
}

/// As [`linear`], with something worked out once per run.
fn prepared<P>(
    prepare: impl Fn(&CleanRun) -> P + Send + Sync + 'static,
    f: impl Fn(&P, &CleanRun, usize) -> [f64; 3] + Send + Sync + 'static,
) -> Shape {
    Box::new(move |clean, _, amplitude| {
        let ready = prepare(clean);
        (0..clean.count).map(|s| f(&ready, clean, s).map(|v| amplitude * v)).collect()
    })
}

/// One axis mostly, at times all of them with different weights.
fn weights(random: &mut Random) -> [f64; 3] {
    if random.chance(0.65) { one(random) } else { several(random) }
}

fn one(random: &mut Random) -> [f64; 3] {
    let (axis, sign) = (random.below(3), random.sign());
    std::array::from_fn(|i| if i == axis { sign } else { 0.0 })
}

fn several(random: &mut Random) -> [f64; 3] {
    std::array::from_fn(|_| random.sign() * random.between(0.4, 1.0))
}

fn scale(weights: [f64; 3], f: impl Fn(usize) -> f64) -> [f64; 3] {
    std::array::from_fn(|i| if weights[i] == 0.0 { 0.0 } else { weights[i] * f(i) })
}

/// Ids that a kind of run can show, those of nature's own size included.
pub fn visible(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::Lin => &[
            "cubic_nonlinearity",
            "quadratic_nonlinearity",
            "saturation",
            "transverse_field",
            "coil_temperature",
            "rack_temperature",
            "sensor_temperature_sensitivity",
            "sensor_temperature_offset",
            "rotation_drift",
            "offset_drift",
            "offset_step",
            "remanence",
            "settling",
            "time_shift",
            "earthfield_leakage",
            "heater_pwm",
            "interference_tone",
            "bad_thermistor",
        ],
        Kind::Sweep => &[
            "cubic_nonlinearity",
            "quadratic_nonlinearity",
            "transverse_field",
            "coil_temperature",
            "rack_temperature",
            "thermal_lag",
            "thermal_curvature",
            "rotation_drift",
            "offset_drift",
            "offset_step",
            "bad_thermistor",
        ],
        Kind::ZeroField => &[
            "sensor_temperature_offset",
            "offset_drift",
            "offset_step",
            "earthfield_leakage",
            "heater_pwm",
            "interference_tone",
            "bad_thermistor",
        ],
        Kind::Positions => &["facility_scale", "facility_offset", "facility_angle"],
        Kind::Frequency => &["eddy_current_attenuation", "response_order", "clock_drift", "lost_samples"],
    }
}

/// Effects of the catalogue that a kind of run cannot tell from its own parameters.
pub fn absorbed(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::Lin => &["facility_scale", "facility_offset", "facility_angle"],
        Kind::Sweep => &["sensor_temperature_sensitivity", "sensor_temperature_offset", "facility_scale", "facility_angle"],
        _ => &[],
    }
}

/// Quantities outside the catalogue that effects of a kind of run depend on.
pub fn outside(kind: Kind) -> &'static [&'static str] {
    match kind {
        Kind::Lin => &["modulus", "product", "extreme", "supply", "staircase", "rack rate"],
        Kind::Sweep => &["product", "staircase", "temperature rate"],
        Kind::ZeroField => &["supply", "rack rate"],
        Kind::Positions | Kind::Frequency => &[],
    }
}

fn own(clean: &CleanRun, s: usize, i: usize) -> f64 {
    clean.pure_ent[s][i] / clean.range_nt()
}

/// An effect of the catalogue, form and axes drawn; none for an id that is not made here.
pub fn drawn(id: &str, clean: &CleanRun, random: &mut Random) -> Option<Effect> {
    let exact = random.chance(0.34);
    let range = clean.range_nt();
    let length_s = clean.count as f64 / clean.rate_hz;
    Some(match id {
        "cubic_nonlinearity" => {
            let w = weights(random);
            let kind = if exact { 0 } else { 1 + random.below(3) };
            let form = ["x³", "sign(x) |x|^2.2", "x³ + 0.5 x⁵", "sinh(1.6 x)"][kind];
            let curve = move |u: f64| match kind {
                0 => u.powi(3),
                1 => u.signum() * u.abs().powf(2.2),
                2 => u.powi(3) + 0.5 * u.powi(5),
                _ => (1.6 * u).sinh(),
            };
            let shape = linear(move |clean, s| scale(w, |i| curve(own(clean, s, i))));
            let effect = Effect::new("cubic_nonlinearity", form, shape).on(w).exact(exact);
            if exact { effect.per_axis("c3", "enT/enT^3", w.map(|w| w / range.powi(3))) } else { effect }
        }
        "quadratic_nonlinearity" => {
            let w = weights(random);
            let power = if exact { 2.0 } else { random.between(1.6, 2.6) };
            let shape = linear(move |clean, s| scale(w, |i| own(clean, s, i).abs().powf(power)));
            let effect = Effect::new("quadratic_nonlinearity", format!("|x|^{power:.2}"), shape).on(w).exact(exact);
            if exact { effect.per_axis("c2", "enT/enT^2", w.map(|w| w / range.powi(2))) } else { effect }
        }
        "saturation" => {
            let w = one(random).map(f64::abs);
            let (onset, knee) = (random.between(0.55, 0.85), random.between(0.15, 0.6));
            let shape = linear(move |clean, s| {
                scale(w, |i| {
                    let u = own(clean, s, i);
                    let beyond = (u.abs() - onset).max(0.0) / knee;
                    -u.signum() * (beyond - beyond.tanh())
                })
            });
            Effect::new("saturation", "tanh knee", shape).on(w).fixed("onset", "enT", onset * range)
        }
        "transverse_field" => {
            let i = random.below(3);
            let (j, sign) = ((i + 1 + random.below(2)) % 3, random.sign());
            let form = if exact { random.below(2) } else { 2 };
            let shape = linear(move |clean, s| {
                let (a, b) = (own(clean, s, i), own(clean, s, j));
                let value = sign * [b * b, a * b * b, b.abs().powf(1.8)][form];
                std::array::from_fn(|k| if k == i { value } else { 0.0 })
            });
            let name = ["x_j²", "x_i x_j²", "|x_j|^1.8"][form];
            let mut effect = Effect::new("transverse_field", name, shape).exact(exact);
            effect.axes = vec![AXES[i]];
            effect.form = format!("{name}, j = {}", AXES[j]);
            effect
        }
        "coil_temperature" => {
            let w = weights(random);
            let bend = if exact { 0.0 } else { random.between(-0.15, 0.15) };
            let tau_s = if exact { 0.0 } else { 0.02 * length_s * random.uniform() };
            let shape = prepared(
                move |clean: &CleanRun| {
                    let curve = if tau_s > 0.0 { clean.coil_degc.low_pass(tau_s) } else { clean.coil_degc.clone() };
                    (curve.mean(), curve, clean.response_at(clean.follows_degc(clean.count / 2)))
                },
                move |(middle, curve, response), clean, s| {
                    let d = curve.at(clean.t_s(s)) - middle;
                    times(response, scale(w, |k| clean.field_nt[s][k] * (d + bend * d * d)))
                },
            );
            Effect::new("coil_temperature", "coil constant linear in a coil temperature, bent and slower", shape)
                .exact(exact)
                .per_axis("alpha", "1/K", w)
        }
        "rack_temperature" => {
            let with_scale = random.chance(0.4);
            let offset = several(random);
            let tau_s = if exact { 0.0 } else { random.between(0.0, 0.04) * length_s };
            let shape = prepared(
                move |clean: &CleanRun| {
                    let curve = if tau_s > 0.0 { clean.rack_degc.low_pass(tau_s) } else { clean.rack_degc.clone() };
                    (curve.mean(), curve)
                },
                move |(middle, curve), clean, s| {
                    let d = curve.at(clean.t_s(s)) - middle;
                    let gain = |i: usize| if with_scale { own(clean, s, i) } else { 0.0 };
                    scale(offset, |i| d * (1.0 + gain(i)))
                },
            );
            let effect = Effect::new("rack_temperature", if with_scale { "offset and scale" } else { "offset" }, shape);
            effect.exact(exact && !with_scale).per_axis("offset", "enT/K", offset)
        }
        "sensor_temperature_sensitivity" => {
            let w = if random.chance(0.5) { [1.0; 3] } else { weights(random) };
            let shape = prepared(
                |clean: &CleanRun| clean.sensor_degc.mean(),
                move |middle, clean, s| {
                    let d = clean.sensor_degc.at(clean.t_s(s)) - middle;
                    scale(w, |i| clean.pure_ent[s][i] * d)
                },
            );
            Effect::new("sensor_temperature_sensitivity", "scale linear in the temperature", shape).on(w).per_axis("a", "1/K", w)
        }
        "sensor_temperature_offset" => {
            let w = weights(random);
            let bend = if exact { 0.0 } else { random.between(-0.8, 0.8) };
            let shape = prepared(
                |clean: &CleanRun| {
                    let middle = clean.sensor_degc.mean();
                    (middle, clean.sensor_degc.values.iter().map(|v| (v - middle).abs()).fold(1e-9, f64::max))
                },
                move |(middle, most), clean, s| {
                    let d = clean.sensor_degc.at(clean.t_s(s)) - middle;
                    scale(w, |_| if bend == 0.0 { d } else { most / bend * (bend * d / most).exp_m1() })
                },
            );
            let effect =
                Effect::new("sensor_temperature_offset", "offset follows the temperature, bent like an exponential", shape);
            effect.on(w).exact(exact).per_axis("b", "enT/K", w)
        }
        "thermal_lag" => {
            // The part that matters follows the thermistor through a low-pass, in part: the weight sets the strength.
            let tau_s = random.log_between(120.0, 1800.0);
            let shape: Shape = Box::new(move |clean, _, amplitude| {
                let late = clean.sensor_degc.low_pass(tau_s);
                (0..clean.count)
                    .map(|s| {
                        let t_s = clean.t_s(s);
                        let shown = clean.sensor_degc.at(t_s);
                        let degc = shown + amplitude * (late.at(t_s) - shown);
                        let moved = times(&clean.response_at(degc), clean.field_nt[s]);
                        std::array::from_fn(|i| {
                            moved[i] - clean.pure_ent[s][i] + clean.sensor.offset_ent_per_k[i] * (degc - shown)
                        })
                    })
                    .collect()
            });
            let effect =
                Effect::new("thermal_lag", format!("low-pass of {tau_s:.0} s, in part"), shape).scaled("tau", "s", tau_s);
            // One in four is late altogether.
            if random.chance(0.25) { effect.natural() } else { effect }
        }
        "thermal_curvature" => {
            let w = weights(random);
            let of_offset = random.chance(0.4);
            let fourth = if exact { 0.0 } else { random.between(-0.4, 0.4) };
            let shape = linear(move |clean, s| {
                let z = clean.sensor_degc.at(clean.t_s(s)) / 50.0;
                let curve = z.powi(3) * (1.0 + fourth * z);
                scale(w, |i| curve * if of_offset { 1.0 } else { own(clean, s, i) })
            });
            let form = if of_offset { "offset with T³ and T⁴" } else { "scale with T³ and T⁴" };
            Effect::new("thermal_curvature", form, shape).on(w).exact(exact)
        }
        "rotation_drift" => {
            let axis = several(random);
            let bend = if exact { 0.0 } else { random.between(-0.5, 0.5) };
            let shape = linear(move |clean, s| {
                let u = clean.along(s);
                cross(axis.map(|a| a * (u + bend * u * u)), clean.pure_ent[s])
            });
            Effect::new("rotation_drift", "small rotation about a fixed axis with time, bent", shape).exact(exact)
        }
        "offset_drift" => {
            let w = weights(random);
            let slow = random.chance(0.6);
            let (turns, phase) = (random.between(1.6, 3.2), random.between(0.0, TAU));
            let quick = random.between(0.06, 0.2);
            let faster = random.between(-0.3, 0.3);
            let shape = linear(move |clean, s| {
                let u = clean.along(s);
                scale(
                    w,
                    |_| if slow { (TAU * turns * (u + faster * u * u) + phase).sin() } else { 1.0 - (-(u + 0.5) / quick).exp() },
                )
            });
            Effect::new("offset_drift", if slow { "slow wave of changing period" } else { "exponential approach" }, shape).on(w)
        }
        "offset_step" => {
            let w = weights(random);
            let place = random.between(0.2, 0.8) - 0.5;
            let ramp = if exact { 1e-9 } else { random.between(0.003, 0.03) };
            let shape = linear(move |clean, s| scale(w, |_| ((clean.along(s) - place) / ramp).clamp(0.0, 1.0)));
            let effect = Effect::new("offset_step", "ramped step", shape).on(w).exact(exact);
            effect.per_axis("step", "enT", w).fixed("tau_0", "s", (place + 0.5) * length_s)
        }
        "remanence" => {
            let w = if random.chance(0.6) { [1.0; 3] } else { weights(random) };
            let soft = if exact { 0.0 } else { random.between(0.5, 1.2) };
            let shape = prepared(
                |clean: &CleanRun| {
                    let mut before = vec![[0.0; 3]; clean.count];
                    for (j, plateau) in clean.plateaus.iter().enumerate() {
                        // A field is remembered from its end to the end of the next setting.
                        let end = clean.plateaus.get(j + 1).map_or(clean.count, |next| next.end);
                        before[plateau.end..end].fill(clean.pure_ent[plateau.start]);
                    }
                    before
                },
                move |before: &Vec<[f64; 3]>, clean, s| {
                    scale(w, |i| {
                        let u = before[s][i] / clean.range_nt();
                        if soft > 0.0 { (u / soft).tanh() } else { u }
                    })
                },
            );
            let effect = Effect::new("remanence", if exact { "in proportion" } else { "tanh of the previous field" }, shape);
            let effect = effect.on(w).exact(exact);
            if exact { effect.per_axis("c", "", w.map(|w| w / range)) } else { effect }
        }
        "settling" => {
            let tau_s = random.between(0.2, 1.5);
            let (second, share) = (tau_s * random.between(2.0, 5.0), if exact { 0.0 } else { random.between(0.1, 0.5) });
            let shape: Shape = Box::new(move |clean, _, amplitude| {
                let keeps = [tau_s, second].map(|tau_s| (-1.0 / (tau_s * clean.rate_hz)).exp());
                let mut levels = [[0.0; 3]; 2];
                clean
                    .pure_ent
                    .iter()
                    .map(|now| {
                        for (level, keep) in levels.iter_mut().zip(keeps) {
                            *level = std::array::from_fn(|i| keep * level[i] + (1.0 - keep) * now[i]);
                        }
                        std::array::from_fn(|i| amplitude * ((1.0 - share) * levels[0][i] + share * levels[1][i] - now[i]))
                    })
                    .collect()
            });
            let effect = Effect::new("settling", "low-pass with two time constants", shape).inside().exact(exact);
            // Its steps come one sample before those of the settings.
            effect.scaled("fraction", "", (-1.0 / (tau_s * clean.rate_hz)).exp()).fixed("tau_s", "s", tau_s)
        }
        "time_shift" => {
            let shift_s = random.sign() * random.log_between(0.04, 0.6);
            let shape: Shape = Box::new(move |clean, _, amplitude| {
                let late = amplitude * shift_s * clean.rate_hz;
                let (whole, part) = (late.floor() as isize, late - late.floor());
                let last = clean.count as isize - 1;
                (0..clean.count as isize)
                    .map(|s| {
                        let [a, b] = [s - whole, s - whole - 1].map(|k| clean.pure_ent[k.clamp(0, last) as usize]);
                        let now = clean.pure_ent[s as usize];
                        std::array::from_fn(|i| (1.0 - part) * a[i] + part * b[i] - now[i])
                    })
                    .collect()
            });
            let effect = Effect::new("time_shift", "readings late by a part of a sample or more", shape).inside().natural();
            effect.exact(true).scaled("dt", "s", shift_s)
        }
        "earthfield_leakage" => {
            let w = weights(random);
            let mix = if exact { 0.0 } else { random.between(-0.3, 0.3) };
            let shape = linear(move |clean, s| {
                let t_s = clean.t_s(s);
                let Some(variation) = &clean.variation_nt else { return [0.0; 3] };
                let v: [f64; 3] = std::array::from_fn(|k| variation[k].at(t_s));
                let own = times(&clean.towards, v);
                scale(w, |i| own[i] + mix * own[(i + 1) % 3])
            });
            let effect = Effect::new("earthfield_leakage", "variometer, with some of the next axis", shape).on(w).exact(exact);
            effect.per_axis("k", "enT/nT", w)
        }
        "heater_pwm" => {
            let w = several(random);
            let period_s = random.log_between(1.3, if clean.kind == Kind::ZeroField { 30.0 } else { 12.0 });
            let (duty, edge, phase) = (random.between(0.2, 0.7), random.between(0.01, 0.08), random.uniform());
            let shape = linear(move |clean, s| {
                let place = (clean.t_s(s) / period_s + phase).rem_euclid(1.0);
                let level = (place / edge).min((duty - place) / edge + 1.0).clamp(0.0, 1.0);
                scale(w, |_| level)
            });
            let effect = Effect::new("heater_pwm", "trapezoid", shape).inside().fixed("period", "s", period_s);
            effect.fixed("duty", "", duty).per_axis("amplitude", "enT", w)
        }
        "interference_tone" => {
            let w = several(random);
            let aliased = random.chance(0.25);
            let nyquist_hz = 0.5 * clean.rate_hz;
            let seen_hz = nyquist_hz * random.between(0.04, 0.92);
            let hz = if aliased { clean.rate_hz - seen_hz } else { seen_hz };
            let depth = if exact { 0.0 } else { random.between(0.2, 0.8) };
            let phases: [f64; 3] = std::array::from_fn(|_| random.between(0.0, TAU));
            let shape = linear(move |clean, s| {
                let t_s = clean.t_s(s);
                let wander = depth * (TAU * 1.3 * (clean.along(s) + 0.5)).sin();
                scale(w, |i| (TAU * hz * t_s + wander + phases[i]).sin())
            });
            let effect = Effect::new("interference_tone", "sine, slightly frequency modulated", shape).inside().exact(exact);
            effect.fixed("frequency", "Hz", seen_hz).per_axis("amplitude", "enT", w.map(f64::abs))
        }
        "bad_thermistor" => {
            let name = match clean.kind {
                Kind::Sweep => ["TSENS", "TCSC", "T29", "T55"][random.below(4)],
                _ => ["T59", "T29", "T55"][random.below(3)],
            };
            let (place_s, jump) = (random.between(0.2, 0.8) * length_s, random.sign() * random.between(0.6, 4.0));
            let back_s = if random.chance(0.5) { place_s + 0.15 * length_s } else { f64::INFINITY };
            let mut effect = Effect::new("bad_thermistor", "channel jumps, at times back", linear(|_, _| [0.0; 3])).natural();
            effect.axes.clear();
            effect.covariates = vec![name];
            effect.channel = Some((name, Box::new(move |t_s| if t_s >= place_s && t_s < back_s { jump } else { 0.0 })));
            effect.fixed("jump", "K", jump).fixed("tau_0", "s", place_s)
        }
        "facility_scale" | "facility_offset" | "facility_angle" => {
            let size: [f64; 3] = several(random);
            let id = visible(Kind::Positions).iter().copied().find(|known| *known == id)?;
            let shape = linear(move |clean, s| {
                let b = clean.field_nt[s];
                let wrong = match id {
                    "facility_scale" => std::array::from_fn(|k| size[k] * b[k]),
                    "facility_offset" => size,
                    // The second and third coil stand askew.
                    _ => [size[0] * b[1] + size[1] * b[2], size[2] * b[2], 0.0],
                };
                times(&clean.response_at(clean.follows_degc(s)), wrong)
            });
            let (stem, unit) = [("scale", ""), ("offset", "nT"), ("angle", "rad")]
                [["facility_scale", "facility_offset", "facility_angle"].iter().position(|k| *k == id)?];
            Effect::new(id, "wrong coil calibration", shape).per_axis(stem, unit, size)
        }
        _ => return None,
    })
}

/// An effect outside the catalogue.
pub fn drawn_outside(name: &str, random: &mut Random) -> Option<Effect> {
    let w = one(random);
    let turned = |clean: &CleanRun, s: usize| clean.pure_ent[s].map(|v| v / clean.range_nt());
    let (form, names, shape): (&str, &[&'static str], Shape) = match name {
        "modulus" => {
            let power = random.between(0.7, 1.4);
            let shape = linear(move |clean, s| {
                let b = clean.field_nt[s].iter().map(|b| (b / clean.range_nt()).powi(2)).sum::<f64>().sqrt();
                scale(w, |_| b.powf(power))
            });
            ("power of the modulus", &["field modulus", "modulus", "|B|"], shape)
        }
        "product" => {
            let third = random.below(3);
            let w: [f64; 3] = std::array::from_fn(|i| if i == third { 1.0 } else { 0.0 });
            let shape = linear(move |clean, s| {
                let u = turned(clean, s);
                scale(w, |i| u[(i + 1) % 3] * u[(i + 2) % 3])
            });
            let names: &[&'static str] = [
                &["by*bz", "y*z", "product", "by bz"][..],
                &["bz*bx", "bx*bz", "x*z", "product", "bx bz"][..],
                &["bx*by", "x*y", "product", "bx by"][..],
            ][third];
            return Some(Effect::new("unknown", "product of the two other components", shape).on(w).depends(names));
        }
        "extreme" => {
            let memory = random.between(0.75, 0.95);
            let shape = prepared(
                move |clean: &CleanRun| {
                    // The last extreme is forgotten slowly and replaced by a larger one.
                    let mut level = [0.0_f64; 3];
                    let mut levels = vec![[0.0; 3]; clean.count];
                    for (j, plateau) in clean.plateaus.iter().enumerate() {
                        let end = clean.plateaus.get(j + 1).map_or(clean.count, |next| next.start);
                        for i in 0..3 {
                            let b = clean.pure_ent[plateau.start][i] / clean.range_nt();
                            level[i] *= memory;
                            if b.abs() > level[i].abs() {
                                level[i] = b;
                            }
                        }
                        levels[plateau.start..end].fill(level);
                    }
                    levels
                },
                move |levels: &Vec<[f64; 3]>, _, s| scale(w, |i| levels[s][i]),
            );
            ("hysteresis with the memory of an extreme", &["previous", "history", "extreme"], shape)
        }
        "supply" => {
            let bend = random.between(-0.5, 0.5);
            let shape = prepared(
                |clean: &CleanRun| clean.supply_ma.as_ref().map_or(0.0, Curve::mean),
                move |middle, clean, s| {
                    let Some(supply) = &clean.supply_ma else { return [0.0; 3] };
                    let d = supply.at(clean.t_s(s)) - middle;
                    scale(w, |_| d + bend * d * d)
                },
            );
            ("supply current", &["supply_ma", "supply"], shape)
        }
        "staircase" => {
            let (steps, phase) = (random.between(2.5, 6.0), random.uniform());
            let shape = linear(move |clean, s| {
                scale(w, |i| {
                    // Integral non-linearity of a converter: a saw-tooth.
                    let place = own(clean, s, i) * steps + phase;
                    place - place.floor() - 0.5
                })
            });
            ("staircase of a converter", &["reading", "own field", "applied component", "bx", "by", "bz"], shape)
        }
        "rack rate" | "temperature rate" => {
            let rack = name == "rack rate";
            let shape = linear(move |clean, s| {
                let (t_s, curve) = (clean.t_s(s), if rack { &clean.rack_degc } else { &clean.sensor_degc });
                let rate = (curve.at(t_s + 1.5 * curve.step_s) - curve.at(t_s - 1.5 * curve.step_s)) / (3.0 * curve.step_s);
                scale(w, |_| rate * 30.0)
            });
            let names: &[&'static str] = if rack {
                &["t55 rate", "d(t55)/dt", "dt55/dt", "rate of t55"]
            } else {
                &["tcsc rate", "d(tcsc)/dt", "dtcsc/dt", "rate of tcsc", "tsens rate", "rate of tsens"]
            };
            (if rack { "rate of the rack temperature" } else { "rate of the sensor temperature" }, names, shape)
        }
        _ => return None,
    };
    Some(Effect::new("unknown", form, shape).on(w).depends(names))
}
