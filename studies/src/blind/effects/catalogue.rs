//! Effects of the catalogue, with forms of their own.

use super::{AXES, Effect, Shape, linear, one, own, prepared, scale, several, weights};
use crate::blind::noise::Random;
use crate::blind::sensor::{CleanRun, Kind, cross, times};
use std::f64::consts::TAU;

/// Draws form and axes of an effect for a run, in the plain form or in another one.
type Draw = fn(&CleanRun, bool, &mut Random) -> Effect;

/// The effects that are made here.
const DRAWN: [(&str, Draw); 23] = [
    ("cubic_nonlinearity", cubic_nonlinearity),
    ("quadratic_nonlinearity", quadratic_nonlinearity),
    ("saturation", saturation),
    ("transverse_field", transverse_field),
    ("coil_temperature", coil_temperature),
    ("rack_temperature", rack_temperature),
    ("sensor_temperature_sensitivity", sensor_temperature_sensitivity),
    ("sensor_temperature_offset", sensor_temperature_offset),
    ("thermal_lag", thermal_lag),
    ("thermal_curvature", thermal_curvature),
    ("rotation_drift", rotation_drift),
    ("offset_drift", offset_drift),
    ("offset_step", offset_step),
    ("remanence", remanence),
    ("settling", settling),
    ("time_shift", time_shift),
    ("earthfield_leakage", earthfield_leakage),
    ("heater_pwm", heater_pwm),
    ("interference_tone", interference_tone),
    ("bad_thermistor", bad_thermistor),
    ("facility_scale", facility_scale),
    ("facility_offset", facility_offset),
    ("facility_angle", facility_angle),
];

/// One case in three has the plain form.
const PLAIN: f64 = 0.34;

/// An effect of the catalogue, form and axes drawn; none for an id that is not made here.
pub fn drawn(id: &str, clean: &CleanRun, random: &mut Random) -> Option<Effect> {
    let exact = random.chance(PLAIN);
    let (_, draw) = DRAWN.iter().find(|(known, _)| *known == id)?;
    Some(draw(clean, exact, random))
}

fn length_s(clean: &CleanRun) -> f64 {
    clean.count as f64 / clean.rate_hz
}

fn cubic_nonlinearity(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let range = clean.range_nt();
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

fn quadratic_nonlinearity(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let range = clean.range_nt();
    let w = weights(random);
    let power = if exact { 2.0 } else { random.between(1.6, 2.6) };
    let shape = linear(move |clean, s| scale(w, |i| own(clean, s, i).abs().powf(power)));
    let effect = Effect::new("quadratic_nonlinearity", format!("|x|^{power:.2}"), shape).on(w).exact(exact);
    if exact { effect.per_axis("c2", "enT/enT^2", w.map(|w| w / range.powi(2))) } else { effect }
}

fn saturation(clean: &CleanRun, _: bool, random: &mut Random) -> Effect {
    let range = clean.range_nt();
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

fn transverse_field(_: &CleanRun, exact: bool, random: &mut Random) -> Effect {
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

fn coil_temperature(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let length_s = length_s(clean);
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

fn rack_temperature(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let length_s = length_s(clean);
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

fn sensor_temperature_sensitivity(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
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

fn sensor_temperature_offset(_: &CleanRun, exact: bool, random: &mut Random) -> Effect {
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
    let effect = Effect::new("sensor_temperature_offset", "offset follows the temperature, bent like an exponential", shape);
    effect.on(w).exact(exact).per_axis("b", "enT/K", w)
}

fn thermal_lag(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
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
                std::array::from_fn(|i| moved[i] - clean.pure_ent[s][i] + clean.sensor.offset_ent_per_k[i] * (degc - shown))
            })
            .collect()
    });
    let effect = Effect::new("thermal_lag", format!("low-pass of {tau_s:.0} s, in part"), shape).scaled("tau", "s", tau_s);
    // One in four is late altogether.
    if random.chance(0.25) { effect.natural() } else { effect }
}

fn thermal_curvature(_: &CleanRun, exact: bool, random: &mut Random) -> Effect {
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

fn rotation_drift(_: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let axis = several(random);
    let bend = if exact { 0.0 } else { random.between(-0.5, 0.5) };
    let shape = linear(move |clean, s| {
        let u = clean.along(s);
        cross(axis.map(|a| a * (u + bend * u * u)), clean.pure_ent[s])
    });
    Effect::new("rotation_drift", "small rotation about a fixed axis with time, bent", shape).exact(exact)
}

fn offset_drift(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
    let w = weights(random);
    let slow = random.chance(0.6);
    let (turns, phase) = (random.between(1.6, 3.2), random.between(0.0, TAU));
    let quick = random.between(0.06, 0.2);
    let faster = random.between(-0.3, 0.3);
    let shape = linear(move |clean, s| {
        let u = clean.along(s);
        scale(w, |_| if slow { (TAU * turns * (u + faster * u * u) + phase).sin() } else { 1.0 - (-(u + 0.5) / quick).exp() })
    });
    Effect::new("offset_drift", if slow { "slow wave of changing period" } else { "exponential approach" }, shape).on(w)
}

fn offset_step(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let length_s = length_s(clean);
    let w = weights(random);
    let place = random.between(0.2, 0.8) - 0.5;
    let ramp = if exact { 1e-9 } else { random.between(0.003, 0.03) };
    let shape = linear(move |clean, s| scale(w, |_| ((clean.along(s) - place) / ramp).clamp(0.0, 1.0)));
    let effect = Effect::new("offset_step", "ramped step", shape).on(w).exact(exact);
    effect.per_axis("step", "enT", w).fixed("tau_0", "s", (place + 0.5) * length_s)
}

fn remanence(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
    let range = clean.range_nt();
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

fn settling(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
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

fn time_shift(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
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

fn earthfield_leakage(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
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
    // The field that leaks is read by the sensor like any other.
    let response = clean.response_at(clean.follows_degc(clean.count / 2));
    let ent_per_nt = |i: usize| (0..3).map(|k| response[i][k] * clean.towards[i][k]).sum::<f64>();
    effect.per_axis("k", "nT/nT", std::array::from_fn(|i| w[i] / ent_per_nt(i)))
}

fn heater_pwm(clean: &CleanRun, _: bool, random: &mut Random) -> Effect {
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

fn interference_tone(clean: &CleanRun, exact: bool, random: &mut Random) -> Effect {
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

fn bad_thermistor(clean: &CleanRun, _: bool, random: &mut Random) -> Effect {
    let length_s = length_s(clean);
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

fn facility_scale(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
    let size: [f64; 3] = several(random);
    facility("facility_scale", move |b| std::array::from_fn(|k| size[k] * b[k])).per_axis("scale", "", size)
}

fn facility_offset(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
    let size: [f64; 3] = several(random);
    facility("facility_offset", move |_| size).per_axis("offset", "nT", size)
}

/// The second and third coil stand askew.
fn facility_angle(_: &CleanRun, _: bool, random: &mut Random) -> Effect {
    let size: [f64; 3] = several(random);
    let wrong = move |b: [f64; 3]| [size[0] * b[1] + size[1] * b[2], size[2] * b[2], 0.0];
    facility("facility_angle", wrong).per_axis("angle", "rad", size)
}

/// A field that is wrong by a function of the field that was set.
fn facility(id: &'static str, wrong: impl Fn([f64; 3]) -> [f64; 3] + Send + Sync + 'static) -> Effect {
    let shape = linear(move |clean, s| times(&clean.response_at(clean.follows_degc(s)), wrong(clean.field_nt[s])));
    Effect::new(id, "wrong coil calibration", shape)
}
