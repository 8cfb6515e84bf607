//! Thousands of short settings are nothing special: the same values and uncertainties, at a cost in proportion to them.

use crate::common;

use common::check::{Case, number, parameters, says, sigma, text, three, with_seconds_of_work};
use common::{POSITIONS, Plan, Setting, offset_fields};

/// Seconds of work. Measured: a fifth of a second for 3400 settings. A cost of the cube of the settings takes ten times this limit.
const LIMIT: u32 = 10;

/// An analysis of a campaign that does not need more than that.
fn analysed(case: &Case, analysis: &str) {
    let output =
        with_seconds_of_work(LIMIT).args([analysis, "--no-plots", "-o"]).arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{} {}", output.status, text(&output.stderr));
}

/// Fields of 1000 nT all over the sphere, a second each.
fn directions(count: usize) -> Vec<Setting> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let field = |i: usize| {
        // Neighbours lie far apart.
        let k = (i * 1009) % count;
        let z = 1.0 - 2.0 * (k as f64 + 0.5) / count as f64;
        let (r, angle) = ((1.0 - z * z).sqrt(), golden * k as f64);
        [r * angle.cos(), r * angle.sin(), z].map(|v| (1e4 * v).round() / 10.0)
    };
    (0..count).map(|i| Setting::constant(i as f64, i as f64 + 1.0, field(i), 1)).collect()
}

/// σ in units of its standard uncertainty from the truth, and the standard uncertainty.
fn measured(count: usize) -> ([f64; 3], [f64; 3]) {
    let plan = Plan { settings: directions(count), rate_hz: 8.0, ..Plan::default() };
    let case = Case::of(plan.run().text());
    analysed(&case, "lin");
    let cpf = case.cpf();
    let (found, std) = (sigma(&cpf), three(&cpf, "std.sigma"));
    (std::array::from_fn(|i| (found[i] - plan.truth.sigma[i]) / std[i]), std)
}

#[test]
fn a_linearity_run_of_thousands_of_settings_is_as_right_as_one_of_hundreds() {
    let [few, many] = [340, 3400].map(measured);
    for i in 0..3 {
        assert!(few.0[i].abs() < 3.5 && many.0[i].abs() < 3.5, "{few:?} {many:?}");
        // Ten times the readings of white noise.
        let ratio = few.1[i] / many.1[i] / 10f64.sqrt();
        assert!((0.85..1.18).contains(&ratio), "{ratio}");
    }
}

#[test]
fn an_offset_run_of_thousands_of_visits_has_its_offsets() {
    let fields = offset_fields();
    // Another position after every setting.
    let settings: Vec<Setting> = (0..2800)
        .map(|i| Setting::constant(i as f64, i as f64 + 1.0, fields[(i / 4) % fields.len()], POSITIONS[i % 4].0))
        .collect();
    let plan = Plan { settings, positions: POSITIONS.to_vec(), residual_nt: [4.0, -7.0, 11.0], rate_hz: 8.0, ..Plan::default() };
    let case = Case::of(plan.run().key("kind", "\"offset\"").text());
    case.put("campaign.toml", common::position_table(&POSITIONS));
    analysed(&case, "offset");
    let opf = parameters(&case.out().join("13-04-03_09-22-38/OFF_PARAMETER__13-04-03-09-22-38.OPF"));
    for i in 0..3 {
        let (found, std) = (number(&opf, &format!("offset_ent.{i}")), number(&opf, &format!("offset_std_ent.{i}")));
        let truth = plan.truth.offset_ent[i];
        // 2800 settings of 8 samples of 0.05 enT or a little less, in positions that see each component of the residual field both ways.
        assert!(std < 0.002 && (found - truth).abs() < 3.5 * std, "{found} is not {truth} within {std}");
    }
    assert_eq!(opf["visit"].as_array_of_tables().map(|visits| visits.len()), Some(48));
    says(&opf["warnings"].to_string(), &["2800 visits were taken together in 48"]);
}
