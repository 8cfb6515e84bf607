//! Effects outside the catalogue.

use super::{Effect, Shape, linear, one, own, prepared, scale};
use crate::blind::noise::Random;
use crate::blind::sensor::{CleanRun, Curve};

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
