//! The hidden sensor, its programme and its surroundings. All formulas are its own: nothing of the models under test is used.

use super::noise::Random;
use super::programme::{Programme, direction_of};
use calfit::data::run::Setting;
use calfit::data::units::FieldCoil;
use calfit::record::plan::{HEATED_K, Plan};
use serde::Serialize;
use std::f64::consts::TAU;
use std::ops::Range;

/// What kind of run set is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Staircases on the three axes and directions between them.
    Lin,
    /// Random directions of constant modulus while the temperature moves.
    Sweep,
    /// Hours without field.
    ZeroField,
    /// Linearity runs of one sensor in several positions.
    Positions,
    /// Sines.
    Frequency,
}

impl Kind {
    pub const ALL: [Kind; 5] = [Kind::Lin, Kind::Sweep, Kind::ZeroField, Kind::Positions, Kind::Frequency];

    /// Name in tables and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Lin => "lin",
            Kind::Sweep => "sweep",
            Kind::ZeroField => "zero-field",
            Kind::Positions => "positions",
            Kind::Frequency => "freq",
        }
    }
}

pub type Matrix = [[f64; 3]; 3];

pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

pub fn transposed(a: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

pub fn times(a: &Matrix, v: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i][0] * v[0] + a[i][1] * v[1] + a[i][2] * v[2])
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Rotation about a vector whose length is the angle, rad.
pub fn rotation(v: [f64; 3]) -> Matrix {
    let angle = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let k: Matrix = [[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]];
    let square = product(&k, &k);
    let (first, second) = if angle < 1e-9 { (1.0, 0.5) } else { (angle.sin() / angle, (1.0 - angle.cos()) / (angle * angle)) };
    std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)) + first * k[i][j] + second * square[i][j]))
}

/// The sensor as it is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sensor {
    /// Scale at 0 °C, nT/enT.
    pub sigma: [f64; 3],
    /// Its first and second power of temperature, per °C and per °C².
    pub sigma_per_k: [f64; 3],
    pub sigma_per_k2: [f64; 3],
    /// Angles between the axes xy, xz, yz, degrees.
    pub xi_deg: [f64; 3],
    /// Offset at 0 °C, enT.
    pub offset_ent: [f64; 3],
    /// Its first power of temperature, enT/°C.
    pub offset_ent_per_k: [f64; 3],
}

impl Sensor {
    pub fn drawn(kind: Kind, random: &mut Random) -> Self {
        let sweep = kind == Kind::Sweep;
        let spread = |random: &mut Random, middle: f64, by: f64| std::array::from_fn(|_| middle + by * random.normal());
        let hot = if sweep { 1.0 } else { 0.0 };
        let drifts = sweep && random.chance(0.5);
        Self {
            sigma: spread(random, 1.0, 0.02),
            sigma_per_k: spread(random, -3.0e-5 * hot, 1.0e-6 * hot),
            sigma_per_k2: spread(random, -3.8e-8 * hot, 1.0e-9 * hot),
            xi_deg: spread(random, 90.0, 0.35),
            offset_ent: spread(random, 0.0, 6.0),
            offset_ent_per_k: spread(random, 0.0, if drifts { 0.02 } else { 0.0 }),
        }
    }

    /// Response, enT/nT, from coil coordinates: `1/σ · Qᵀ · (towards the sensor)`, Q with the sensor's base vectors in its columns.
    pub fn response(&self, towards: &Matrix, degc: f64) -> Matrix {
        let [xy, xz, yz] = self.xi_deg.map(f64::to_radians);
        let third = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
        let base: Matrix =
            [[1.0, 0.0, 0.0], [xy.cos(), xy.sin(), 0.0], [xz.cos(), third, (xz.sin().powi(2) - third * third).sqrt()]];
        let turned = product(&base, towards);
        std::array::from_fn(|i| {
            let sigma = self.sigma[i] + degc * (self.sigma_per_k[i] + degc * self.sigma_per_k2[i]);
            turned[i].map(|v| v / sigma)
        })
    }
}

/// A slow quantity, straight between its equidistant points.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    pub step_s: f64,
    pub values: Vec<f64>,
}

impl Curve {
    /// Points of a function up to a time.
    pub fn of(step_s: f64, length_s: f64, mut f: impl FnMut(f64) -> f64) -> Self {
        let count = (length_s / step_s).ceil() as usize + 1;
        Self { step_s, values: (0..count).map(|i| f(i as f64 * step_s)).collect() }
    }

    pub fn at(&self, t_s: f64) -> f64 {
        let place = (t_s / self.step_s).clamp(0.0, (self.values.len() - 1) as f64);
        let index = (place as usize).min(self.values.len().saturating_sub(2));
        let part = place - index as f64;
        self.values[index] + part * (self.values.get(index + 1).copied().unwrap_or(self.values[index]) - self.values[index])
    }

    pub fn limits(&self) -> (f64, f64) {
        self.values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)))
    }

    pub fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }

    /// Low-pass of first order, in rest at the first point.
    pub fn low_pass(&self, tau_s: f64) -> Self {
        let keep = (-self.step_s / tau_s).exp();
        let mut level = self.values[0];
        let values = self.values.iter().map(|v| {
            level = keep * level + (1.0 - keep) * v;
            level
        });
        Self { step_s: self.step_s, values: values.collect() }
    }
}

/// One run without noise and without hidden effects.
#[derive(Clone, Debug)]
pub struct CleanRun {
    pub kind: Kind,
    /// Settings of a linearity run; all others have one of their own.
    pub programme: Programme,
    /// Samples that are simulated; a sweep shows means of nine.
    pub rate_hz: f64,
    pub count: usize,
    pub settings: Vec<Setting>,
    /// Samples of every setting.
    pub plateaus: Vec<Range<usize>>,
    /// Applied field per sample, coil coordinates; zero between the settings of a linearity run.
    pub field_nt: Vec<[f64; 3]>,
    pub sensor: Sensor,
    /// Rotation from coil to sensor coordinates.
    pub towards: Matrix,
    /// Polynomial of the offset in the time over the length of the run, enT.
    pub trend_ent: [[f64; 2]; 3],
    pub sensor_degc: Curve,
    /// A second thermistor of the sensor, where there is one.
    pub second_degc: Option<Curve>,
    pub coil_degc: Curve,
    pub rack_degc: Curve,
    /// Outside field at the variometer, nT, coil coordinates.
    pub variation_nt: Option<[Curve; 3]>,
    pub supply_ma: Option<Curve>,
    pub position: u32,
    /// Readings less offset, per sample, enT.
    pub pure_ent: Vec<[f64; 3]>,
}

/// Positions of the sensor: rows are the nominal axes in coil coordinates.
pub const POSITIONS: [(u32, [&str; 3]); 4] =
    [(1, ["+X", "+Y", "+Z"]), (2, ["-X", "-Y", "+Z"]), (3, ["-Z", "-Y", "-X"]), (4, ["-Z", "+Y", "+X"])];

/// Nominal rotation from coil to sensor coordinates.
pub fn nominal(position: u32) -> Matrix {
    let axes = POSITIONS.iter().find(|(id, _)| *id == position).map_or(POSITIONS[0].1, |(_, axes)| *axes);
    axes.map(|axis| {
        let sign = if axis.starts_with('-') { -1.0 } else { 1.0 };
        std::array::from_fn(|k| if axis.ends_with(["X", "Y", "Z"][k]) { sign } else { 0.0 })
    })
}

impl CleanRun {
    /// Middle of a sample, s; the time tag of a sample that stands for an instant.
    pub fn t_s(&self, sample: usize) -> f64 {
        (sample as f64 + if self.kind == Kind::Sweep { 0.5 } else { 0.0 }) / self.rate_hz
    }

    /// Time over the length of the run, -1/2 to 1/2.
    pub fn along(&self, sample: usize) -> f64 {
        sample as f64 / self.count as f64 - 0.5
    }

    /// Largest field of a component, nT.
    pub fn range_nt(&self) -> f64 {
        if self.kind == Kind::Sweep { 50_000.0 } else { self.programme.range_nt() }
    }

    /// Field along a sensor axis over the range.
    pub fn own_field(&self, sample: usize, component: usize) -> f64 {
        times(&self.towards, self.field_nt[sample])[component] / self.range_nt()
    }

    pub fn response_at(&self, degc: f64) -> Matrix {
        self.sensor.response(&self.towards, degc)
    }

    /// Temperature that the coefficients of the sensor follow, °C; 0 where they have none.
    pub fn follows_degc(&self, sample: usize) -> f64 {
        if self.kind == Kind::Sweep { self.sensor_degc.at(self.t_s(sample)) } else { 0.0 }
    }

    /// Offset with its trend, enT.
    pub fn offset_ent(&self, sample: usize) -> [f64; 3] {
        let (u, degc) = (self.along(sample), self.follows_degc(sample));
        std::array::from_fn(|i| {
            let [first, second] = self.trend_ent[i];
            self.sensor.offset_ent[i] + self.sensor.offset_ent_per_k[i] * degc + u * (first + u * second)
        })
    }

    /// A run of this kind: `sensor` and rotation are given, programme and surroundings are drawn.
    pub fn drawn(kind: Kind, sensor: Sensor, position: u32, random: &mut Random) -> Self {
        Self::with_programme(kind, Programme::Staircases, sensor, position, random)
    }

    /// The same with the settings of a programme, if it is a linearity run.
    pub fn with_programme(kind: Kind, programme: Programme, sensor: Sensor, position: u32, random: &mut Random) -> Self {
        let small: [f64; 3] = std::array::from_fn(|_| 0.012 * random.normal());
        let towards = product(&transposed(&rotation(small)), &nominal(position));
        let mut clean = Self {
            kind,
            programme,
            rate_hz: 32.0,
            count: 0,
            settings: Vec::new(),
            plateaus: Vec::new(),
            field_nt: Vec::new(),
            sensor,
            towards,
            trend_ent: [[0.0; 2]; 3],
            sensor_degc: Curve { step_s: 1.0, values: vec![0.0] },
            second_degc: None,
            coil_degc: Curve { step_s: 1.0, values: vec![0.0] },
            rack_degc: Curve { step_s: 1.0, values: vec![0.0] },
            variation_nt: None,
            supply_ma: None,
            position,
            pure_ent: Vec::new(),
        };
        match kind {
            Kind::Lin | Kind::Positions => clean.staircases(programme, random),
            Kind::Sweep => clean.sweep(random),
            Kind::ZeroField => clean.night(random),
            Kind::Frequency => {}
        }
        clean.pure_ent = clean.pure();
        clean
    }

    /// Readings less offset of every sample, enT.
    fn pure(&self) -> Vec<[f64; 3]> {
        let constant = (self.kind != Kind::Sweep).then(|| self.response_at(0.0));
        let response = |s: usize| constant.unwrap_or_else(|| self.response_at(self.follows_degc(s)));
        (0..self.count).map(|s| times(&response(s), self.field_nt[s])).collect()
    }

    /// The run as it is measured next, in another way; a test signal is not made here and leaves it as it is.
    pub fn changed(&self, plan: Plan) -> Self {
        let mut next = Self { settings: Vec::new(), plateaus: Vec::new(), field_nt: Vec::new(), ..self.clone() };
        let slower = if matches!(plan, Plan::Longer | Plan::ZeroPauses) { 2.0 } else { 1.0 };
        for (j, setting) in self.settings.iter().enumerate() {
            let (begin_s, length_s) = (setting.t_start_s, setting.t_end_s - setting.t_start_s);
            let field = if plan == Plan::Reversed { self.settings[self.settings.len() - 1 - j].field } else { setting.field };
            match plan {
                Plan::Longer => next.setting(slower * begin_s, slower * length_s, field.0),
                Plan::ZeroPauses => {
                    next.setting(slower * begin_s, length_s, field.0);
                    let interval_s = self.settings.get(j + 1).map_or(length_s + 1.0, |later| later.t_start_s - begin_s);
                    next.setting(slower * begin_s + interval_s, length_s, [0.0; 3]);
                }
                _ => next.setting(begin_s, length_s, field.0),
            }
        }
        next.count = next.field_nt.len() + self.count - self.plateaus.last().map_or(0, |p| p.end);
        next.field_nt.resize(next.count, [0.0; 3]);
        if plan == Plan::Turned {
            next.towards = product(&[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], &self.towards);
        }
        let length_s = next.count as f64 / next.rate_hz;
        let curves = [&mut next.sensor_degc, &mut next.coil_degc, &mut next.rack_degc].into_iter().chain(&mut next.second_degc);
        let curves = curves.chain(next.variation_nt.iter_mut().flatten()).chain(&mut next.supply_ma);
        curves.for_each(|curve| curve.step_s *= slower);
        let heat = |curve: &mut Curve| {
            for (i, value) in curve.values.iter_mut().enumerate() {
                *value += HEATED_K * (0.5 * TAU * (i as f64 * curve.step_s / length_s).min(1.0)).sin().powi(2);
            }
        };
        match plan {
            Plan::SensorHeated => {
                heat(&mut next.sensor_degc);
                next.second_degc.iter_mut().for_each(heat);
            }
            Plan::CoilsHeated => heat(&mut next.coil_degc),
            Plan::RackHeated => heat(&mut next.rack_degc),
            _ => {}
        }
        next.pure_ent = next.pure();
        next
    }

    fn setting(&mut self, t_start_s: f64, length_s: f64, field: [f64; 3]) {
        let (position, first) = (self.position, (t_start_s * self.rate_hz).round() as usize);
        let samples = first..first + (length_s * self.rate_hz).round() as usize;
        // Fields are written with two decimals; those are applied.
        let field = field.map(|b| (b * 100.0).round() / 100.0);
        self.settings.push(Setting {
            t_start_s,
            t_end_s: t_start_s + length_s,
            field: FieldCoil(field),
            frequency_hz: 0.0,
            position,
        });
        if self.field_nt.len() < samples.end {
            self.field_nt.resize(samples.end, [0.0; 3]);
        }
        self.field_nt[samples.clone()].fill(field);
        self.plateaus.push(samples);
    }

    /// The settings of a programme, 6 s each with 1 s without field between, and surroundings whose waves fit into the run.
    fn staircases(&mut self, programme: Programme, random: &mut Random) {
        for (j, field) in programme.fields(random).into_iter().enumerate() {
            self.setting(1.0 + 7.0 * j as f64, 6.0, field);
        }
        self.count = self.field_nt.len() + 32;
        self.field_nt.resize(self.count, [0.0; 3]);
        self.trend_ent = std::array::from_fn(|_| [0.15 * random.normal(), 0.15 * random.normal()]);
        let length_s = self.count as f64 / self.rate_hz;
        let quicker = programme.quicker();
        let wave = |random: &mut Random, middle: f64, size: f64, period_s: [f64; 2]| {
            let (omega, phase) = (quicker * TAU / random.between(period_s[0], period_s[1]), random.between(0.0, TAU));
            let (slower, other) = (random.between(0.3, 0.5) * omega, random.between(0.0, TAU));
            let small = random.between(0.1, 0.4) * size;
            Curve::of(10.0, length_s, move |t| middle + size * (omega * t + phase).sin() + small * (slower * t + other).sin())
        };
        let (middle, size) = (random.between(15.5, 18.5), random.between(0.15, 0.35));
        self.sensor_degc = wave(random, middle, size, [420.0, 1500.0]);
        let (middle, size) = (random.between(16.0, 17.0), random.between(0.5, 1.0));
        self.coil_degc = wave(random, middle, size, [230.0, 420.0]);
        let (middle, size) = (random.between(31.5, 33.0), random.between(1.2, 1.9));
        self.rack_degc = wave(random, middle, size, [140.0, 240.0]);
        self.outside(10.0, length_s, 0.35, random);
    }

    /// The variometer and the supply wander.
    fn outside(&mut self, step_s: f64, length_s: f64, kick_nt: f64, random: &mut Random) {
        let mut walk = |start: f64, kick: f64| {
            let mut level = start + kick * random.normal();
            Curve::of(step_s, length_s, |_| {
                level += kick * random.normal();
                level
            })
        };
        self.variation_nt = Some(std::array::from_fn(|_| walk(0.0, kick_nt)));
        self.supply_ma = Some(walk(163.0, 0.05));
    }

    /// 36 s every 40 s; the sensor is cooled and heated between plateaus of temperature.
    fn sweep(&mut self, random: &mut Random) {
        self.rate_hz = 0.25;
        let blocks = 700 + random.below(60);
        for j in 0..blocks {
            self.setting(40.0 * j as f64, 36.0, direction_of(50_000.0, random));
        }
        self.count = self.field_nt.len() + 1;
        self.field_nt.resize(self.count, [0.0; 3]);
        let length_s = self.count as f64 / self.rate_hz;
        let (cold, warm) = (random.between(-38.0, -20.0), random.between(25.0, 60.0));
        let nodes = if random.chance(0.5) {
            [20.0, cold, cold - 3.0, 10.0, warm, 25.0]
        } else {
            [20.0, warm, 15.0, cold, cold + 2.0, 20.0]
        };
        let box_degc = Curve::of(30.0, length_s, |t| {
            let place = (t / length_s * 5.0).min(4.9999);
            let (index, part) = (place as usize, place.fract());
            nodes[index] + (nodes[index + 1] - nodes[index]) * 0.5 * (1.0 - (std::f64::consts::PI * part).cos())
        });
        self.sensor_degc = box_degc.low_pass(random.between(120.0, 400.0));
        self.second_degc = Some(self.sensor_degc.low_pass(random.between(400.0, 1200.0)));
        let day = |random: &mut Random, middle: f64, size: f64, period_h: f64| {
            let (omega, phase) = (TAU / (3600.0 * period_h), random.between(0.0, TAU));
            Curve::of(30.0, length_s, move |t| middle + size * (omega * t + phase).sin())
        };
        let period_h = random.between(6.0, 10.0);
        self.coil_degc = day(random, 16.5, 0.8, period_h);
        let period_h = random.between(3.0, 4.5);
        self.rack_degc = day(random, 32.0, 1.5, period_h);
    }

    /// Two to four hours at 4, 8 or 16 Hz.
    fn night(&mut self, random: &mut Random) {
        let hours = random.between(2.0, 4.0);
        self.rate_hz = f64::from([4, 8, 16][random.below(3)]);
        while self.rate_hz * 3600.0 * hours > 120_000.0 {
            self.rate_hz /= 2.0;
        }
        let length_s = (3600.0 * hours).round();
        self.setting(0.0, length_s, [0.0; 3]);
        self.count = self.field_nt.len();
        self.trend_ent = std::array::from_fn(|_| [0.5 * random.normal(), 0.5 * random.normal()]);
        let slow = |random: &mut Random, middle: f64, size: f64, period_h: [f64; 2]| {
            let waves: [[f64; 3]; 3] = std::array::from_fn(|k| {
                let omega = TAU * (k as f64 + 1.0) / (3600.0 * random.between(period_h[0], period_h[1]));
                [omega, random.between(0.0, TAU), size * random.between(0.3, 1.0) / (k as f64 + 1.0)]
            });
            Curve::of(30.0, length_s, move |t| middle + waves.iter().map(|[w, p, a]| a * (w * t + p).sin()).sum::<f64>())
        };
        let middle = random.between(15.0, 19.0);
        self.sensor_degc = slow(random, middle, 0.5, [2.0, 5.0]);
        self.coil_degc = slow(random, 16.5, 0.6, [1.0, 3.0]);
        self.rack_degc = slow(random, 32.0, 1.5, [0.7, 2.0]);
        self.outside(30.0, length_s, 0.5, random);
    }

    /// Places where means are formed: the settings, or 128 parts of a night.
    pub fn parts(&self) -> Vec<Range<usize>> {
        if self.kind == Kind::ZeroField {
            return (0..128).map(|k| k * self.count / 128..(k + 1) * self.count / 128).collect();
        }
        self.plateaus.clone()
    }
}
