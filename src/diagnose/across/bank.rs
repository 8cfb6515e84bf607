//! What may be wrong between runs.

use super::scene::{Candidate, Scene, count, numbered, scaled, thermal_order};
use super::values::RunValues;
use super::{CLASSES, LEAST_AGREEING};
use crate::data::units::COMPONENTS;
use crate::diagnose::result::NotIdentifiable;
use crate::fit::statistics::extent;
use crate::measure::coil::tilt::Family;
use crate::model::effects::Spec;
use nalgebra::DMatrix;

/// Temperatures that span less than this show nothing, K.
const LEAST_SHOWN_K: f64 = 0.2;

/// Everything that is tried, and why the rest of the catalogue is not.
pub fn bank(scene: &Scene) -> (Vec<Candidate>, Vec<NotIdentifiable>) {
    let (runs, n) = (scene.runs, scene.count());
    let at = |class: usize, run: usize, i: usize| (class * n + run) * 3 + i;
    let sensors = numbered(runs.iter().map(|r| r.sensor.as_str()));
    let mut bank: Vec<Candidate> = Vec::new();
    let mut none: Vec<NotIdentifiable> = Vec::new();
    let mut refuse = |id: &str, reason: String| none.push(NotIdentifiable { effect: id.to_owned(), reason });
    // Columns by a function of class, run and value; one per axis.
    let mut add =
        |id: &'static str, spec: Spec, names: Vec<(String, &'static str)>, f: &dyn Fn(usize, usize, usize, usize) -> f64| {
            let axes = spec.axes.clone();
            let columns = DMatrix::from_fn(9 * n, names.len(), |row, c| {
                f(row / (3 * n), (row / 3) % n, row % 3, axes.get(c % axes.len().max(1)).copied().unwrap_or(c))
            });
            bank.push(Candidate { id, key: id.to_owned(), spec, parameters: names, columns, alone: None });
        };
    let together = [vec![0, 1, 2], vec![0], vec![1], vec![2]];
    let named = |stem: &str, axes: &[usize], unit: &'static str| -> Vec<(String, &'static str)> {
        axes.iter().map(|a| (format!("{stem}_{}", COMPONENTS[*a]), unit)).collect()
    };

    // The facility: what a sensor axis sees of it depends on the orientation.
    let turned = (0..count(&sensors))
        .map(|s| numbered((0..n).filter(|r| sensors[*r] == s).map(|r| runs[r].position.orientation())))
        .map(|o| count(&o))
        .max()
        .unwrap_or(0);
    const FACILITY: [(&str, &str, &str); 3] =
        [("facility_scale", "scale", ""), ("facility_offset", "offset", "nT"), ("facility_angle", "angle", "deg")];
    for (class, (id, stem, unit)) in FACILITY.into_iter().enumerate() {
        if turned < 2 {
            refuse(id, "every sensor has one orientation: its own parameters take it up".to_owned());
            continue;
        }
        for axes in &together {
            let names = if class == 2 {
                axes.iter().map(|a| (format!("angle_{}", ["xy", "xz", "yz"][*a]), unit)).collect()
            } else {
                named(stem, axes, unit)
            };
            add(id, Spec::new("between runs", axes), names, &|c, r, i, k| {
                let (along, factor) = Family::ALL[class].sees(&runs[r].position, i);
                if c == class && along == k { factor } else { 0.0 }
            });
        }
    }
    if turned >= 2 {
        refuse(
            "facility_scale",
            "of its three factors two ratios: the common scale of coil system and sensor is seen by no orientation".to_owned(),
        );
    }

    // Temperatures.
    let moved = |of: &dyn Fn(&RunValues) -> Option<f64>| -> Option<Vec<f64>> {
        let all: Vec<f64> = runs.iter().map(of).collect::<Option<_>>()?;
        let mean = all.iter().sum::<f64>() / n as f64;
        (extent(all.iter().copied()) > LEAST_SHOWN_K).then(|| all.iter().map(|t| t - mean).collect())
    };
    let orders: Vec<usize> = (0..count(&sensors)).map(|s| thermal_order(runs, &sensors, s)).collect();
    let sensor_k = moved(&|r| r.sensor_degc);
    for (id, class, stem, unit) in
        [("sensor_temperature_sensitivity", 0, "a", "1/K"), ("sensor_temperature_offset", 1, "b", "nT/K")]
    {
        match &sensor_k {
            _ if orders.iter().any(|o| *o > 0) => {
                refuse(id, "part of the model: the sensor is a polynomial of its temperature".to_owned())
            }
            None => refuse(id, "the runs bring no sensor temperatures that differ".to_owned()),
            Some(k) => {
                for axes in &together {
                    add(id, Spec::new("between runs", axes), named(stem, axes, unit), &|c, r, i, a| {
                        if c == class && i == a { k[r] } else { 0.0 }
                    });
                }
            }
        }
    }
    match moved(&|r| r.coil_degc) {
        None => refuse("coil_temperature", "the runs bring no coil temperatures that differ".to_owned()),
        Some(k) => {
            for axes in &together {
                add("coil_temperature", Spec::new("between runs", axes), named("alpha", axes, "1/K"), &|c, r, i, a| {
                    let (along, factor) = Family::Scale.sees(&runs[r].position, i);
                    if c == 0 && along == a { factor * k[r] } else { 0.0 }
                });
            }
        }
    }
    let curved: Vec<usize> = (0..count(&sensors)).filter(|s| orders[*s] > 0).collect();
    if curved.is_empty() {
        refuse("thermal_curvature", "the runs span too few temperatures".to_owned());
    }
    for sensor in curved {
        let (u, power) = (scaled(runs, &sensors, sensor), orders[sensor] as i32 + 1);
        for (class, unit) in [(0, ""), (1, "nT"), (2, "deg")] {
            for axes in &together {
                let names = named(&format!("{}_t{power}", CLASSES[class]), axes, unit);
                add("thermal_curvature", Spec::new(CLASSES[class], axes), names, &|c, r, i, a| {
                    if c == class && i == a && sensors[r] == sensor { u(r).powi(power) } else { 0.0 }
                });
            }
        }
    }

    // Two places of one sensor.
    let sets = |s: usize| numbered((0..n).filter(|r| sensors[*r] == s).map(|r| runs[r].set.as_str()));
    let two: Vec<usize> = (0..count(&sensors)).filter(|s| count(&sets(*s)) == 2).collect();
    let mut moved_ones: Vec<Candidate> = Vec::new();
    if two.is_empty() {
        refuse("off_centre", "needs two sets of runs of one sensor, told apart by their campaigns".to_owned());
    }
    for sensor in two {
        let first = runs.iter().zip(&sensors).find(|(_, s)| **s == sensor).map_or("", |(r, _)| r.set.as_str());
        let other = |r: usize| sensors[r] == sensor && runs[r].set != first;
        add("off_centre", Spec::new("k", &[0, 1, 2]), named("k", &[0, 1, 2], ""), &|c, r, i, a| {
            if c == 0 && i == a && other(r) { 1.0 } else { 0.0 }
        });
        let names = [named("k", &[0, 1, 2], ""), vec![("xi_xy".into(), "deg"), ("xi_xz".into(), "deg"), ("xi_yz".into(), "deg")]];
        let columns = DMatrix::from_fn(9 * n, 6, |row, c| {
            let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if other(r) && class == 2 * (c / 3) && i == c % 3 { 1.0 } else { 0.0 }
        });
        let spec = Spec::new("k and K", &[0, 1, 2]);
        let key = "off_centre".to_owned();
        moved_ones.push(Candidate { id: "off_centre", key, spec, parameters: names.concat(), columns, alone: None });
    }

    bank.extend(moved_ones);

    // Time.
    let mut add = |id: &'static str, spec: Spec, names: Vec<(String, &'static str)>, f: &dyn Fn(usize, usize) -> f64| {
        let axes = spec.axes.clone();
        let columns = DMatrix::from_fn(9 * n, names.len(), |row, c| {
            let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if class == 1 && axes[c % axes.len()] == i { f(r, c / axes.len()) } else { 0.0 }
        });
        bank.push(Candidate { id, key: id.to_owned(), spec, parameters: names, columns, alone: None });
    };
    let times: Option<Vec<f64>> = runs.iter().map(|r| r.time).collect();
    match times.filter(|t| extent(t.iter().copied()) > 0.0) {
        None => {
            for id in ["offset_drift", "offset_step"] {
                refuse(id, "the runs bring no times".to_owned());
            }
        }
        Some(t) => {
            let (low, span) = (t.iter().copied().fold(f64::INFINITY, f64::min), extent(t.iter().copied()));
            let tau = |r: usize| 2.0 * (t[r] - low) / span - 1.0;
            for axes in &together {
                add("offset_drift", Spec::new("line", axes), named("p1", axes, "nT"), &|r, _| tau(r));
            }
            let mut order: Vec<f64> = t.clone();
            order.sort_by(f64::total_cmp);
            order.dedup();
            for pair in order.windows(2) {
                let middle = 0.5 * (pair[0] + pair[1]);
                for axes in &together {
                    let spec = Spec::new("step", axes).with("tau_0", middle, "s");
                    add("offset_step", spec, named("b", axes, "nT"), &|r, _| if t[r] > middle { 1.0 } else { 0.0 });
                }
            }
        }
    }

    // An orientation or a run by itself.
    let orientations = count(&scene.orientation);
    let members = |o: usize| (0..n).filter(|r| scene.orientation[*r] == o).collect::<Vec<usize>>();
    let mut outliers: Vec<(&str, Vec<usize>)> = Vec::new();
    if orientations > LEAST_AGREEING {
        outliers.extend((0..orientations).map(|o| ("orientation", members(o))));
    }
    for r in 0..n {
        let own = members(scene.orientation[r]);
        if own.len() > 2 {
            outliers.push(("run", vec![r]));
        }
    }
    for (what, own) in outliers {
        let name = if what == "run" { runs[own[0]].run.clone() } else { runs[own[0]].position.orientation() };
        for classes in [&[0, 1, 2][..], &[0], &[1], &[2]] {
            let columns = DMatrix::from_fn(9 * n, 3 * classes.len(), |row, c| {
                let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
                if class == classes[c / 3] && own.contains(&r) && i == c % 3 { 1.0 } else { 0.0 }
            });
            let parameters = classes
                .iter()
                .flat_map(|class| {
                    (0..3).map(|i| {
                        (
                            format!("{}_{}", CLASSES[*class], [COMPONENTS, COMPONENTS, ["xy", "xz", "yz"]][*class][i]),
                            ["", "nT", "deg"][*class],
                        )
                    })
                })
                .collect();
            let spec = Spec::new(&format!("{what} {name}"), &[0, 1, 2]);
            bank.push(Candidate {
                id: "unknown",
                key: format!("unknown: {what}"),
                spec,
                parameters,
                columns,
                alone: Some(own.clone()),
            });
        }
    }
    debug_assert!(bank.iter().all(|c| c.columns.nrows() == at(2, n - 1, 2) + 1));
    (bank, none)
}
