//! A campaign with runs of every kind at four temperatures.

use super::check::Case;
use super::{POSITIONS, Plan, Run, Setting, Truth, in_positions, offset_fields, programme, sines, with_rows};
use std::sync::LazyLock;

/// Temperatures of the sensor, °C.
pub const TEMPERATURES_DEGC: [f64; 4] = [-60.0, 0.0, 60.0, 120.0];
pub const RATE_FACTOR: f64 = 127.9991 / 128.0;
const FREQUENCIES_HZ: [f64; 22] = [
    1000.0, 631.0, 398.0, 251.0, 158.0, 126.0, 100.0, 79.4, 63.1, 50.1, 39.8, 31.6, 25.1, 19.9, 12.6, 7.9, 5.01, 3.16, 1.99,
    1.26, 0.794, 0.501,
];

/// The instrument at a temperature: linear σ, ξ and f_3dB, quadratic offset.
pub fn truth(degc: f64) -> Truth {
    let cold = Truth::default();
    Truth {
        sigma: std::array::from_fn(|i| cold.sigma[i] - [1.8e-5, 1.6e-5, 2.0e-5][i] * degc),
        xi_deg: std::array::from_fn(|i| cold.xi_deg[i] + [-1.8e-5, 4.5e-5, -1.2e-4][i] * degc),
        offset_ent: std::array::from_fn(|i| {
            cold.offset_ent[i] + [3e-3, -2e-3, 1e-3][i] * degc + [4e-5, 2e-5, -3e-5][i] * degc * degc
        }),
        ..cold
    }
}

/// -3 dB frequencies of the first-order low-pass at a temperature, Hz.
pub fn corner_hz(degc: f64) -> [f64; 3] {
    std::array::from_fn(|i| [58.0, 57.0, 54.0][i] + [-0.05, -0.06, -0.03][i] * degc)
}

fn at(run: Run, kind: &str, configuration: &str, id: &str, degc: f64) -> String {
    let mut run = run.named(id).key("kind", &format!("\"{kind}\"")).key("configuration", &format!("\"{configuration}\""));
    for (_, values) in &mut run.temperatures {
        *values = [Some(18.0 + 0.01 * degc), Some(degc)];
    }
    run.text()
}

/// Id of the run of a kind at a temperature: hours 08, 09 and 10 of consecutive days.
pub fn id(hour: usize, index: usize) -> String {
    format!("13-04-{:02}_{hour:02}-00-00", 3 + index)
}

/// Names and contents of the files, which are simulated once.
static FILES: LazyLock<Vec<(String, String)>> = LazyLock::new(files);

/// Writes the campaign into a case.
pub fn write(case: &Case) {
    for (name, content) in FILES.iter() {
        case.put(name, content);
    }
}

fn files() -> Vec<(String, String)> {
    let mut toml = "name = \"Test campaign\"\ninstrument = \"Fluxgate DUT\"\noffset_trend_order = 0\n".to_owned();
    toml.push_str("[report]\ntitle = \"Ground calibration of a test magnetometer\"\nlaboratory = \"Coil facility\"\nresponsible = \"A. Person\"\n");
    for (id, axes) in POSITIONS {
        toml.push_str(&format!("[[position]]\nid = {id}\naxes = {axes:?}\n"));
    }
    let mut files = vec![("campaign.toml".to_owned(), toml)];
    for (index, degc) in TEMPERATURES_DEGC.into_iter().enumerate() {
        let plan = |settings: Vec<Setting>, seed: u64| Plan {
            truth: truth(degc),
            settings,
            positions: POSITIONS.to_vec(),
            residual_nt: [2.0, -3.0, 5.0],
            rate_factor: RATE_FACTOR,
            seed: 100 * index as u64 + seed,
            ..Plan::default()
        };
        let mut put = |hour: usize, run: Run, kind: &str, configuration: &str| {
            let id = id(hour, index);
            files.push((format!("{}.CCR", id.replace('_', "/")), at(run, kind, configuration, &id, degc)));
        };
        let levels = [-2000.0, -1200.0, -400.0, 400.0, 1200.0, 2000.0];
        put(8, plan(programme(&levels, 2.0), 1).run(), "linearity", "LIN2000XYZE.MAG");
        put(9, plan(in_positions(&[1, 2, 3, 4], &offset_fields(), 3.0), 2).run(), "offset", "OFFSET_200.MAG");
        let freq = Plan { corner_hz: Some(corner_hz(degc)), ..plan(sines(&FREQUENCIES_HZ, 1000.0), 3) };
        put(10, freq.run(), "frequency", "FREQ2000.MAG");
        if index == 0 {
            put(11, plan(vec![Setting::constant(0.0, 60.0, [0.0; 3], 1)], 4).run(), "zero-field", "NULL.MAG");
            // Directions that turn by the golden angle, while the temperature rises.
            let direction = |k: i32| {
                let (z, turn) = (1.0 - (2.0 * f64::from(k) + 1.0) / 60.0, 2.4 * f64::from(k));
                let aside = (1.0 - z * z).sqrt();
                [2000.0 * aside * turn.cos(), 2000.0 * aside * turn.sin(), 2000.0 * z]
            };
            let fields: Vec<[f64; 3]> = (0..60).map(|k| direction(7 * k % 60)).collect();
            let sweep = plan(in_positions(&[1], &fields, 2.0), 5).run();
            let text = at(sweep, "sweep", "RANDOM50000.MAG", &id(12, 0), degc);
            let warmer = |cells: &[&str]| match cells[0].parse::<f64>() {
                Ok(t) => format!("{},{},{}", cells[0], cells[1], degc + 0.5 * t),
                Err(_) => cells.join(","),
            };
            files.push((format!("{}.CCR", id(12, 0).replace('_', "/")), with_rows(&text, "@TEMPERATURES", warmer)));
        }
    }
    files
}
