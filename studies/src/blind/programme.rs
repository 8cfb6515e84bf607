//! Programmes of linearity runs.

use super::noise::Random;
use serde::Serialize;

/// Which settings a linearity run has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Programme {
    /// Every axis in steps of 200 nT in random order with zeros between, then directions.
    #[default]
    Staircases,
    /// Thirty settings: every axis in steps of 500 nT in random order, and three directions.
    Few,
    /// As the first up to 200 nT.
    Narrow,
    /// As the first up to 60 000 nT.
    Wide,
    /// Every axis up and down again, step by step, then directions.
    Stairs,
    /// Directions alone.
    Directions,
}

impl Programme {
    pub const ALL: [Programme; 6] =
        [Programme::Staircases, Programme::Few, Programme::Narrow, Programme::Wide, Programme::Stairs, Programme::Directions];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Programme::Staircases => "staircases, 90 settings",
            Programme::Few => "30 settings",
            Programme::Narrow => "±200 nT",
            Programme::Wide => "±60 000 nT",
            Programme::Stairs => "stairs up and down",
            Programme::Directions => "random directions",
        }
    }

    /// Largest field of a component, nT.
    pub fn range_nt(self) -> f64 {
        match self {
            Programme::Narrow => 200.0,
            Programme::Wide => 60_000.0,
            _ => 2000.0,
        }
    }

    /// How much shorter it is than the first one.
    pub fn quicker(self) -> f64 {
        if self == Programme::Few { 3.0 } else { 1.0 }
    }

    /// The settings, nT, coil axes.
    pub fn fields(self, random: &mut Random) -> Vec<[f64; 3]> {
        match self {
            Programme::Staircases | Programme::Narrow | Programme::Wide => staircases(self.range_nt() / 2000.0, random),
            Programme::Few => few(random),
            Programme::Stairs => stairs(random),
            Programme::Directions => {
                let any = |j: usize, random: &mut Random| match j % 10 {
                    0 => [0.0; 3],
                    _ => direction_of(random.between(400.0, 1950.0), random),
                };
                (0..90).map(|j| any(j, random)).collect()
            }
        }
    }
}

fn along(axis: usize, steps: impl IntoIterator<Item = f64>) -> impl Iterator<Item = [f64; 3]> {
    steps.into_iter().map(move |s| std::array::from_fn(|k| if k == axis { s } else { 0.0 }))
}

/// Every axis in random order with zeros between, then directions with zeros between.
fn staircases(factor: f64, random: &mut Random) -> Vec<[f64; 3]> {
    let mut fields = vec![[0.0; 3]];
    for axis in 0..3 {
        let mut steps: Vec<f64> = (-10..=10).filter(|s| *s != 0).map(|s| f64::from(s) * 200.0 * factor).collect();
        random.shuffle(&mut steps);
        for _ in 0..4 + random.below(2) {
            steps.insert(random.below(steps.len() + 1), 0.0);
        }
        fields.extend(along(axis, steps));
    }
    for direction in 0..12 {
        if direction == 5 {
            fields.push([0.0; 3]);
        }
        fields.push(direction_of(factor * random.between(800.0, 1950.0), random));
    }
    fields
}

fn few(random: &mut Random) -> Vec<[f64; 3]> {
    let mut fields = Vec::new();
    for axis in 0..3 {
        let mut steps: Vec<f64> = (-4..=4).map(|s| f64::from(s) * 500.0).collect();
        random.shuffle(&mut steps);
        fields.extend(along(axis, steps));
    }
    fields.extend((0..3).map(|_| direction_of(random.between(800.0, 1950.0), random)));
    fields
}

fn stairs(random: &mut Random) -> Vec<[f64; 3]> {
    let mut fields = Vec::new();
    for axis in 0..3 {
        let sign = random.sign();
        let steps = (0..=5).chain((0..5).rev()).chain((-5..0).rev()).chain(-4..=0).map(|s| sign * 400.0 * f64::from(s));
        fields.extend(along(axis, steps));
    }
    fields.extend((0..12).map(|_| direction_of(random.between(800.0, 1950.0), random)));
    fields
}

/// A random direction with a modulus.
pub fn direction_of(modulus: f64, random: &mut Random) -> [f64; 3] {
    let v: [f64; 3] = std::array::from_fn(|_| random.normal());
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c * modulus / length)
}
