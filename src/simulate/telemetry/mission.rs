//! The configuration of flight processing for simulated telemetry, and its daily models.

use super::coefficients::Ground;
use super::truth::ATTITUDE_GAP_S;
use super::{Telemetry, readings};
use crate::data::convention::Convention;
use crate::data::time::SECOND_NS;
use crate::files::flight::daily;
use crate::files::flight::mission::Span;
use crate::files::text::{listed, quoted};
use crate::files::twin::telemetry::FlightSensor;
use crate::model::polynomial::TemperaturePolynomial;
use nalgebra::DMatrix;
use std::fmt::Write;

/// Name of the configuration.
pub const FILE: &str = "flight.toml";

fn daily_pattern(sensor: &str) -> String {
    format!("RPCMAG_{{yymmdd}}_006_CALIB_{sensor}.toml")
}

/// Name and text of the daily model of a sensor.
#[must_use]
pub fn daily(sensor: &FlightSensor, day: i32, polynomials: &[Vec<f64>; 3]) -> (String, String) {
    let path = daily::path_of(std::path::Path::new(""), &daily_pattern(&sensor.name), day);
    let exact = polynomials.each_ref().map(|coefficients| TemperaturePolynomial {
        coefficients: coefficients.clone(),
        covariance: DMatrix::zeros(0, 0),
        valid_degc: sensor.valid_degc,
    });
    (path.display().to_string(), daily::head("simulated", &sensor.name, day, &exact, sensor.valid_degc))
}

/// The text of the configuration; `ground` are the coefficient files of both sensors.
#[must_use]
pub fn text(telemetry: &Telemetry<'_>, ground: &[Ground; 2]) -> String {
    let (twin, leap) = (telemetry.twin, &telemetry.leap);
    let from_to = |span: &Span| format!("from = \"{}Z\"\nto = \"{}Z\"\n", leap.utc(span.from), leap.utc(span.to));
    let mut out = format!("# calfit flight processing of simulated telemetry, seed {}\nversion = 1\n", telemetry.seed);
    let _ = writeln!(out, "mission = {}\ninstrument = {}", quoted(&twin.mission), quoted(&twin.instrument));
    out.push_str("input = \"edited\"\nhk = \"hk\"\n\n[edited]\nsensor_axes = \"uvw\"\nquality_reject_mask = 7\n");
    let reset_s = readings::RESET_GAP_NS / SECOND_NS;
    let _ = writeln!(out, "\n[continuity]\nenabled = true\nreset_gap_s = {reset_s}\n\n[temperature]\noutside = \"null\"");
    let _ = writeln!(
        out,
        "\n[celestial]\nframe = {}\nattitude = \"attitude/attitude.parquet\"\nattitude_order = \"scalar-first\"\n\
         attitude_from_to = \"sc to celestial\"\nattitude_max_gap_s = {ATTITUDE_GAP_S:?}\nposition = \"attitude/position.parquet\"",
        quoted(&twin.frame)
    );
    for (index, (sensor, own)) in twin.sensors.iter().zip(ground).enumerate() {
        let files: Vec<String> = own.files.iter().map(|f| quoted(f)).collect();
        let frame = match sensor.frame {
            Convention::BepiColombo => "bepicolombo",
            Convention::Rosetta => "rosetta",
        };
        let _ = writeln!(
            out,
            "\n[[sensor]]\nname = {}\nground = [{}]\nground_sensor = {}\nframe = \"{frame}\"\ndaily = {}\nthermistor_column = \"{}\"\n\
             noise_ent = {:?}\nfull_scale_ent = 15000.0\nadc_bits = 20",
            quoted(&sensor.name),
            files.join(", "),
            quoted(&sensor.twin.name),
            quoted(&format!("daily/{}", daily_pattern(&sensor.name))),
            ["t_ob", "t_ib"][index],
            if twin.exact { 0.0 } else { sensor.noise_ent },
        );
        for state in &sensor.rotations {
            let rows = (0..3).map(|row| listed(state.uvw_to_sc.row(row).iter()));
            let rows: Vec<String> = rows.collect();
            let _ = writeln!(
                out,
                "\n[[sensor.rotation]]\nboom = {}\n{}uvw_to_sc = [{}]",
                quoted(&state.boom),
                from_to(&state.span),
                rows.join(", ")
            );
        }
        for jump in &sensor.jumps {
            let vector = listed(jump.subtract_nt.iter());
            let _ = writeln!(out, "\n[[sensor.jump]]\n{}frame = \"sc\"\nsubtract_nt = {vector}", from_to(&jump.span));
        }
    }
    for mode in &twin.modes {
        let _ = writeln!(out, "\n[[mode]]\nsid = {}\npacket_s = {:?}", quoted(&mode.sid), mode.packet_s);
        for (role, rate) in ["primary", "secondary"].into_iter().zip(mode.rates) {
            let Some(rate) = rate else { continue };
            #[expect(clippy::cast_precision_loss, reason = "shifts of seconds")]
            let shift_s = rate.shift_ns.unwrap_or(0) as f64 / SECOND_NS as f64;
            let _ = writeln!(out, "{role} = {{ rate_hz = {:?}, shift_s = {shift_s:?} }}", rate.rate_hz);
        }
        let _ = writeln!(out, "lap_lines_hz = {}", listed(&mode.lines_hz));
    }
    let [primary, secondary] = twin.sensors.each_ref().map(|s| quoted(&s.name));
    let _ = writeln!(out, "\n[role]\nprimary = {primary}\nsecondary = {secondary}");
    if !twin.wheels.is_empty() {
        let widths: Vec<String> = twin.half_width_hz.iter().map(|(sid, width)| format!("{} = {width:?}", quoted(sid))).collect();
        let _ = writeln!(
            out,
            "\n[wheels]\ntable = \"wheels/wheels.parquet\"\nharmonics = [1]\nhalf_width_hz = {{ {} }}",
            widths.join(", ")
        );
    }
    if !twin.heaters.is_empty() {
        let classes: Vec<String> = twin.heaters.iter().map(|h| quoted(&h.name)).collect();
        let _ = writeln!(out, "\n[heater]\ntable = \"heater/romap.parquet\"\nclasses = [{}]", classes.join(", "));
        for span in &twin.heater_intervals {
            let _ = write!(out, "\n[[heater.interval]]\n{}", from_to(span));
        }
    }
    out
}
