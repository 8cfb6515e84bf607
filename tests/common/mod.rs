//! Synthetic run files from a forward model of their own, `reading = A · field + offset + noise`, and ways to spoil them.
//!
//! A [`Plan`] says what the instrument is and what is done with it, [`Plan::run`] measures, [`Run::text`] gives the file. Every
//! fault is made by changing one thing of a good run or of its text. Nothing in this file calls the tool's code; [`check`] does.

pub mod browser;
pub mod campaign;
pub mod check;
pub mod python;

use std::fmt::Write;

/// Run id of every run that says nothing else, and its file in a campaign.
pub const RUN_ID: &str = "13-04-03_09-22-38";
pub const RUN_FILE: &str = "13-04-03/09-22-38.CCR";

/// Gaussian numbers from a fixed seed: splitmix64 and the polar form of Box and Muller.
pub struct Gauss(pub u64);

impl Gauss {
    /// Uniform in (-1, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Mean 0, standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        loop {
            let (u, v) = (self.uniform(), self.uniform());
            let s = u * u + v * v;
            if s > 0.0 && s < 1.0 {
                return u * (-2.0 * s.ln() / s).sqrt();
            }
        }
    }
}

/// What the instrument really is.
#[derive(Clone, Debug)]
pub struct Truth {
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [f64; 3],
    /// Angles between the sensor axes: ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [f64; 3],
    /// Rotation vector of the sensor against its nominal orientation, degrees, along X_m, Y_m, Z_m.
    pub turned_deg: [f64; 3],
    /// Reading in zero field, enT.
    pub offset_ent: [f64; 3],
    /// Coil axes along which X_m, Y_m, Z_m nominally lie.
    pub axes: [&'static str; 3],
}

impl Default for Truth {
    fn default() -> Self {
        Self {
            sigma: [0.98, 1.02, 0.995],
            xi_deg: [89.8, 90.3, 90.05],
            turned_deg: [0.4, -0.7, 0.25],
            offset_ent: [12.5, -8.25, 3.75],
            axes: ["+X", "+Y", "+Z"],
        }
    }
}

impl Truth {
    /// Rotation matrix of `turned_deg` (Rodrigues).
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        let v = self.turned_deg.map(f64::to_radians);
        let angle = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let k = v.map(|c| if angle > 0.0 { c / angle } else { 0.0 });
        let cross = [[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]];
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let same = if i == j { 1.0 } else { 0.0 };
                same * angle.cos() + cross[i][j] * angle.sin() + k[i] * k[j] * (1.0 - angle.cos())
            })
        })
    }

    /// Angles λ_x, μ_y, ν_z between each turned axis and its nominal direction, degrees.
    pub fn rotation_angles_deg(&self) -> [f64; 3] {
        let rotation = self.rotation();
        std::array::from_fn(|i| {
            let aside: f64 = (0..3).filter(|row| *row != i).map(|row| rotation[row][i].powi(2)).sum();
            aside.sqrt().atan2(rotation[i][i]).to_degrees()
        })
    }

    /// `A`, enT per nT: its rows are the sensor axes in coil coordinates, each divided by its σ.
    pub fn response(&self) -> [[f64; 3]; 3] {
        let [xy, xz, yz] = self.xi_deg.map(f64::to_radians);
        let q = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
        let own = [[1.0, 0.0, 0.0], [xy.cos(), xy.sin(), 0.0], [xz.cos(), q, (xz.sin().powi(2) - q * q).sqrt()]];
        let rotation = self.rotation();
        std::array::from_fn(|component| {
            let nominal: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| rotation[i][j] * own[component][j]).sum());
            let mut coil = [0.0; 3];
            for (value, axis) in nominal.iter().zip(self.axes) {
                let along = "XYZ".find(&axis[1..]).unwrap();
                coil[along] += if axis.starts_with('-') { -value } else { *value };
            }
            coil.map(|c| c / self.sigma[component])
        })
    }

    pub fn reading(&self, field: [f64; 3]) -> [f64; 3] {
        let a = self.response();
        std::array::from_fn(|i| self.offset_ent[i] + (0..3).map(|j| a[i][j] * field[j]).sum::<f64>())
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    pub t_start: f64,
    pub t_end: f64,
    pub field: [f64; 3],
    /// Hz; above 0 the field is the amplitude of a sine.
    pub frequency: f64,
    pub position: u32,
}

impl Setting {
    pub fn constant(t_start: f64, t_end: f64, field: [f64; 3], position: u32) -> Self {
        Self { t_start, t_end, field, frequency: 0.0, position }
    }
}

/// Levels on each axis in turn, zero field before, between and after.
pub fn programme(levels_nt: &[f64], plateau_s: f64) -> Vec<Setting> {
    let mut fields = vec![[0.0; 3]];
    for axis in 0..3 {
        for level in levels_nt {
            let mut field = [0.0; 3];
            field[axis] = *level;
            fields.push(field);
        }
        fields.push([0.0; 3]);
    }
    let settings = fields.into_iter().enumerate();
    settings.map(|(i, field)| Setting::constant(i as f64 * plateau_s, (i + 1) as f64 * plateau_s, field, 1)).collect()
}

/// A measurement to be made.
#[derive(Clone, Debug)]
pub struct Plan {
    pub truth: Truth,
    pub settings: Vec<Setting>,
    /// Axes of the positions; a position that is not listed is that of the truth.
    pub positions: Vec<(u32, [&'static str; 3])>,
    /// Residual field of the coil system, nT, coil axes.
    pub residual_nt: [f64; 3],
    /// Nominal sample rate.
    pub rate_hz: f64,
    /// Real sample rate over the nominal one.
    pub rate_factor: f64,
    /// -3 dB frequency of a first-order low-pass in each component.
    pub corner_hz: Option<[f64; 3]>,
    pub noise_ent: f64,
    pub seed: u64,
}

/// Positions of the campaign of 2013.
pub const POSITIONS: [(u32, [&str; 3]); 4] =
    [(1, ["+X", "+Y", "+Z"]), (2, ["-X", "-Y", "+Z"]), (3, ["-Z", "-Y", "-X"]), (4, ["-Z", "+Y", "+X"])];

/// Positions as `campaign.toml` has them.
pub fn position_table(positions: &[(u32, [&str; 3])]) -> String {
    positions.iter().map(|(id, axes)| format!("[[position]]\nid = {id}\naxes = {axes:?}\n")).collect()
}

/// Zero field, and ±200 nT on each axis in turn.
pub fn offset_fields() -> Vec<[f64; 3]> {
    let mut fields = vec![[0.0; 3]];
    for axis in 0..3 {
        for level in [200.0, -200.0] {
            let mut field = [0.0; 3];
            field[axis] = level;
            fields.push(field);
        }
    }
    fields
}

/// Fields in every one of some positions in turn.
pub fn in_positions(positions: &[u32], fields: &[[f64; 3]], plateau_s: f64) -> Vec<Setting> {
    let all = positions.iter().flat_map(|p| fields.iter().map(move |f| (*p, *f))).enumerate();
    all.map(|(i, (position, field))| Setting::constant(plateau_s * i as f64, plateau_s * (i + 1) as f64, field, position))
        .collect()
}

/// Sines one after the other on the Y coil axis, as in FREQ2000, with a pause of half a second between them.
pub fn sines(frequencies_hz: &[f64], amplitude_nt: f64) -> Vec<Setting> {
    let mut t = 1.0;
    let setting = |frequency: &f64| {
        let t_start = t;
        let t_end = t_start + (5.0 / frequency).max(12.0);
        t = t_end + 0.5;
        Setting { t_start, t_end, field: [0.0, amplitude_nt, 0.0], frequency: *frequency, position: 1 }
    };
    frequencies_hz.iter().map(setting).collect()
}

impl Default for Plan {
    /// 22 plateaus of 2 s at 128 Hz.
    fn default() -> Self {
        let settings = programme(&[-2000.0, -1200.0, -400.0, 400.0, 1200.0, 2000.0], 2.0);
        Self {
            truth: Truth::default(),
            settings,
            positions: Vec::new(),
            residual_nt: [0.0; 3],
            rate_hz: 128.0,
            rate_factor: 1.0,
            corner_hz: None,
            noise_ent: 0.05,
            seed: 1,
        }
    }
}

/// A file of some four kilobytes that still has a linear calibration.
pub fn small() -> Run {
    Plan { settings: programme(&[-2000.0, 1000.0], 1.0), rate_hz: 8.0, ..Plan::default() }.run()
}

pub fn good() -> Run {
    Plan::default().run()
}

#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub n: u64,
    pub t: f64,
    pub reading: [f64; 3],
}

/// What the file will say.
#[derive(Clone, Debug)]
pub struct Run {
    /// Keys with their values as TOML text.
    pub keys: Vec<(String, String)>,
    pub settings: Vec<Setting>,
    pub samples: Vec<Sample>,
    /// s, T29 and T59 in °C.
    pub temperatures: Vec<(f64, [Option<f64>; 2])>,
    pub time_decimals: usize,
    pub reading_decimals: usize,
    /// Sections in their order.
    pub sections: Vec<&'static str>,
}

impl Plan {
    /// Response in a position, and the reading there without an applied field.
    fn place(&self, position: u32) -> ([[f64; 3]; 3], [f64; 3]) {
        let axes = self.positions.iter().find(|(id, _)| *id == position).map_or(self.truth.axes, |(_, axes)| *axes);
        let truth = Truth { axes, ..self.truth.clone() };
        (truth.response(), truth.reading(self.residual_nt))
    }

    /// Samples stand in the middle of their periods, so that none lies on the edge of a setting.
    pub fn run(&self) -> Run {
        let mut gauss = Gauss(self.seed);
        let end = self.settings.last().map_or(0.0, |s| s.t_end);
        let count = (end * self.rate_hz).round() as u64;
        // Response and zero level in the position of every setting.
        let places: Vec<([[f64; 3]; 3], [f64; 3])> = self.settings.iter().map(|s| self.place(s.position)).collect();
        let samples = (0..count).map(|n| {
            let t = (n as f64 + 0.5) / (self.rate_hz * self.rate_factor);
            let Some(at) = self.settings.iter().position(|s| t < s.t_end) else {
                return Sample { n, t, reading: places[0].1.map(|z| z + self.noise_ent * gauss.normal()) };
            };
            let (setting, (response, zero)) = (&self.settings[at], &places[at]);
            let on = setting.t_start <= t;
            let reading = std::array::from_fn(|i| {
                let full: f64 = (0..3).map(|j| response[i][j] * setting.field[j]).sum();
                let field = match (on, setting.frequency) {
                    (false, _) => 0.0,
                    (true, 0.0) => full,
                    (true, f) => {
                        let (gain, delay) = self.corner_hz.map_or((1.0, 0.0), |c| {
                            let ratio = f / c[i];
                            (1.0 / (1.0 + ratio * ratio).sqrt(), ratio.atan())
                        });
                        full * gain * (std::f64::consts::TAU * (f * t).fract() - delay).sin()
                    }
                };
                zero[i] + field + self.noise_ent * gauss.normal()
            });
            Sample { n, t, reading }
        });
        let keys = [
            ("run", "\"13-04-03_09-22-38\""),
            ("start", "\"2013-04-03T09:22:38Z\""),
            ("kind", "\"linearity\""),
            ("configuration", "\"LIN2000XYZE.MAG\""),
            ("sensor", "\"BS_11\""),
            ("mode", "\"science mode 0\""),
            ("sample_rate", &format!("{:?}", self.rate_hz)),
            ("unit", "\"enT\""),
            ("field_source", "\"FLDS\""),
            ("coil_correction", "true"),
            ("earthfield_compensation", "[\"DYNAMIC\", \"DYNAMIC\", \"DYNAMIC\"]"),
        ];
        Run {
            keys: keys.map(|(k, v)| (k.to_owned(), v.to_owned())).to_vec(),
            settings: self.settings.clone(),
            samples: samples.collect(),
            temperatures: (0..=4).map(|i| (f64::from(i) * end / 4.0, [Some(20.5), Some(24.5)])).collect(),
            time_decimals: 4,
            reading_decimals: 3,
            sections: vec!["@FIELDS", "@TEMPERATURES", "@VECTORS"],
        }
    }
}

impl Run {
    /// The same where parts of every step of the field come later, each with a time constant in s.
    pub fn behind(mut self, truth: &Truth, parts: &[(f64, f64)]) -> Self {
        let reading = |setting: &Setting| truth.reading(setting.field);
        let steps: Vec<(f64, [f64; 3])> = self
            .settings
            .windows(2)
            .map(|pair| {
                let (before, now) = (reading(&pair[0]), reading(&pair[1]));
                (pair[1].t_start, [0, 1, 2].map(|i: usize| now[i] - before[i]))
            })
            .collect();
        for sample in &mut self.samples {
            let at = steps.partition_point(|(begin, _)| *begin <= sample.t);
            for (begin, change) in &steps[..at] {
                let late: f64 = parts.iter().map(|(part, tau_s)| part * (-(sample.t - begin) / tau_s).exp()).sum();
                sample.reading.iter_mut().zip(change).for_each(|(reading, change)| *reading -= late * change);
            }
        }
        self
    }

    /// The same of a sensor that warms from 24 to 25 °C, straight from the begin to the end.
    pub fn warming(mut self) -> Self {
        for (i, (_, [_, sensor])) in self.temperatures.iter_mut().enumerate() {
            *sensor = Some(24.0 + i as f64 / 4.0);
        }
        self
    }

    /// The same with another value of a key, as TOML text; a new key comes last.
    pub fn key(mut self, name: &str, value: &str) -> Self {
        match self.keys.iter_mut().find(|(k, _)| k == name) {
            Some((_, old)) => value.clone_into(old),
            None => self.keys.push((name.to_owned(), value.to_owned())),
        }
        self
    }

    pub fn without_key(mut self, name: &str) -> Self {
        self.keys.retain(|(k, _)| k != name);
        self
    }

    /// The same run made at another time, which its id tells: 13-04-03_09-22-38.
    pub fn named(self, id: &str) -> Self {
        let run = self.key("run", &format!("\"{id}\""));
        match id.split_once('_') {
            Some((day, time)) => run.key("start", &format!("\"20{day}T{}Z\"", time.replace('-', ":"))),
            None => run,
        }
    }

    /// Indices of the samples of a setting.
    pub fn samples_of(&self, setting: usize) -> std::ops::Range<usize> {
        let Setting { t_start, t_end, .. } = self.settings[setting];
        self.samples.partition_point(|s| s.t < t_start)..self.samples.partition_point(|s| s.t < t_end)
    }

    pub fn lose(mut self, samples: std::ops::Range<usize>) -> Self {
        self.samples.drain(samples);
        self
    }

    /// Writes a sample twice.
    pub fn repeat(mut self, index: usize) -> Self {
        self.samples.insert(index, self.samples[index]);
        self
    }

    pub fn spike(mut self, index: usize, component: usize, by_ent: f64) -> Self {
        self.samples[index].reading[component] += by_ent;
        self
    }

    /// Changes every reading.
    pub fn each(mut self, change: impl Fn([f64; 3]) -> [f64; 3]) -> Self {
        self.samples.iter_mut().for_each(|s| s.reading = change(s.reading));
        self
    }

    /// One component ends at ± a limit.
    pub fn saturate(self, component: usize, limit_ent: f64) -> Self {
        self.each(|mut r| {
            r[component] = r[component].clamp(-limit_ent, limit_ent);
            r
        })
    }

    /// One component gives the same reading all the time.
    pub fn stick(self, component: usize, value_ent: f64) -> Self {
        self.each(|mut r| {
            r[component] = value_ent;
            r
        })
    }

    pub fn swap(self, a: usize, b: usize) -> Self {
        self.each(|mut r| {
            r.swap(a, b);
            r
        })
    }

    pub fn reverse(self, component: usize) -> Self {
        self.each(|mut r| {
            r[component] = -r[component];
            r
        })
    }

    /// The settings say another time than the samples.
    pub fn shift_settings(mut self, by_s: f64) -> Self {
        for s in &mut self.settings {
            s.t_start += by_s;
            s.t_end += by_s;
        }
        self
    }

    /// Readings in counts; the keys say so.
    pub fn in_counts(mut self, ent_per_count: f64) -> Self {
        self.reading_decimals += 3;
        self.each(|r| r.map(|v| v / ent_per_count)).key("unit", "\"counts\"").key("nominal_factor", &format!("{ent_per_count:?}"))
    }

    /// A time column with steps, as from a clock that ticks slowly.
    pub fn coarse(mut self, step_s: f64) -> Self {
        self.samples.iter_mut().for_each(|s| s.t = (s.t / step_s).floor() * step_s);
        self
    }

    pub fn without_section(mut self, name: &str) -> Self {
        self.sections.retain(|s| *s != name);
        self
    }

    /// The file.
    pub fn text(&self) -> String {
        let mut out = "CCR 1\n".to_owned();
        for (key, value) in &self.keys {
            let _ = writeln!(out, "{key} = {value}");
        }
        for section in &self.sections {
            let _ = writeln!(out, "{section}");
            match *section {
                "@FIELDS" => {
                    out.push_str("t_start,t_end,bx,by,bz,frequency,position\n");
                    for Setting { t_start, t_end, field: [x, y, z], frequency, position } in &self.settings {
                        let _ = writeln!(out, "{t_start:.3},{t_end:.3},{x:.2},{y:.2},{z:.2},{frequency},{position}");
                    }
                }
                "@TEMPERATURES" => {
                    out.push_str("t,T29,T59\n");
                    for (t, values) in &self.temperatures {
                        let [a, b] = values.map(|v| v.map_or_else(String::new, |v| format!("{v:.2}")));
                        let _ = writeln!(out, "{t:.1},{a},{b}");
                    }
                }
                "@VECTORS" => {
                    out.push_str("n,t,x,y,z\n");
                    let (dt, dr) = (self.time_decimals, self.reading_decimals);
                    for Sample { n, t, reading: [x, y, z] } in &self.samples {
                        let _ = writeln!(out, "{n},{t:.dt$},{x:.dr$},{y:.dr$},{z:.dr$}");
                    }
                }
                other => panic!("{other}"),
            }
        }
        out.push_str("@END\n");
        out
    }
}

/// A text that was changed in one place.
#[derive(Clone, Debug)]
pub struct Edit {
    pub text: String,
    /// The place, from 1.
    pub line: u64,
    pub column: u64,
}

/// Number, from 1, of a line of a section: row 0 is the line of column names.
pub fn line_of(text: &str, section: &str, row: usize) -> u64 {
    let name = text.lines().position(|l| l == section).unwrap();
    (name + 2 + row) as u64
}

pub fn line(text: &str, number: u64) -> &str {
    text.lines().nth(number as usize - 1).unwrap()
}

/// The same text with another line; an empty one takes the line out.
pub fn with_line(text: &str, number: u64, new: &str) -> String {
    let lines = text.lines().zip(1..).map(|(old, n)| if n == number { new } else { old });
    lines.filter(|l| !l.is_empty()).fold(String::new(), |out, l| out + l + "\n")
}

/// The same text with another cell in a row of a section; row 1 is the first one below the column names.
pub fn with_cell(text: &str, section: &str, row: usize, name: &str, new: &str) -> Edit {
    let at = line(text, line_of(text, section, 0)).split(',').position(|n| n == name).unwrap();
    let number = line_of(text, section, row);
    let mut cells: Vec<&str> = line(text, number).split(',').collect();
    let column = 1 + cells[..at].iter().map(|c| c.len() as u64 + 1).sum::<u64>();
    cells[at] = new;
    Edit { text: with_line(text, number, &cells.join(",")), line: number, column }
}

/// Every row of a section, with its column names, changed by a function of its cells.
pub fn with_rows(text: &str, section: &str, change: impl Fn(&[&str]) -> String) -> String {
    let mut inside = false;
    text.lines().fold(String::new(), |out, l| {
        if l.starts_with('@') {
            inside = l == section;
            return out + l + "\n";
        }
        if inside { out + &change(&l.split(',').collect::<Vec<_>>()) + "\n" } else { out + l + "\n" }
    })
}
