//! Eight sines with three and four parameters, to ten digits.
//!
//! Data and answers (least squares at fifty digits) are read from `shared/reference/nist/sine_ref` beside the repository and
//! are not part of it; without them the test says that it was skipped. LRE is the number of correct digits,
//! `-log10(|estimate - reference| / |reference|)`.

use std::path::{Path, PathBuf};

use calfit::fit::sine::{Sine, four, three};
use serde_json::Value;

const NEEDED: f64 = 10.0;
const RATE_HZ: f64 = 128.0;

/// Counters and readings.
fn read(path: &Path) -> (Vec<u64>, Vec<f64>) {
    let text = std::fs::read_to_string(path).expect("a readable set");
    let row = |line: &str| {
        let (n, y) = line.split_once(',').expect("two columns");
        (n.parse::<u64>().expect("a counter"), y.parse::<f64>().expect("a reading"))
    };
    text.lines().skip(1).map(row).unzip()
}

/// Correct digits, at most 15.
fn lre(estimate: f64, reference: f64) -> f64 {
    (-((estimate - reference).abs() / reference.abs()).log10()).min(15.0)
}

/// Every value of a fit that the reference has, with its name and digits.
fn digits(fit: &Sine, reference: &Value) -> Vec<(&'static str, f64)> {
    let std = |i: usize| if i < fit.covariance.nrows() { fit.covariance[(i, i)].sqrt() } else { 0.0 };
    let values = [
        ("A", fit.sin),
        ("B", fit.cos),
        ("C", fit.offset),
        ("f", fit.frequency_hz),
        ("amp", fit.amplitude),
        ("phase", fit.phase_rad),
        ("rss", fit.rss),
        ("se_A", std(0)),
        ("se_B", std(1)),
        ("se_C", fit.offset_std),
        ("se_f", fit.frequency_std_hz),
        ("se_amp", fit.amplitude_std),
        ("se_phase", fit.phase_std_rad),
    ];
    let text = |name: &str| reference[name].as_str().map(|text| text.parse::<f64>().expect("a number"));
    values.into_iter().filter_map(|(name, value)| Some((name, lre(value, text(name)?)))).collect()
}

#[test]
fn reference_values_are_met_to_ten_digits() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/nist/sine_ref");
    if !folder.is_dir() {
        println!("skipped: no sines in {}", folder.display());
        return;
    }
    let text = std::fs::read_to_string(folder.join("sine_ref.json")).expect("readable answers");
    let sets: Value = serde_json::from_str(&text).expect("JSON");
    let sets = sets.as_object().expect("sets by name");
    assert_eq!(sets.len(), 8);
    println!("{:26} {:>14} {:>14}", "set", "three", "four");
    for (name, set) in sets {
        let (n, y) = read(&folder.join(format!("{name}.csv")));
        assert_eq!(Some(n.len() as u64), set["n"].as_u64(), "{name}");
        let start: f64 = set["f_start"].as_str().and_then(|text| text.parse().ok()).expect("a frequency");
        let three = digits(&three(&n, &y, start, RATE_HZ).expect("a fit"), &set["three"]);
        let four = digits(&four(&n, &y, start, RATE_HZ).expect("a fit"), &set["four"]);
        assert_eq!((three.len(), four.len()), (12, 13), "{name}");
        let least = |digits: &[(&'static str, f64)]| digits.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)).expect("values");
        let ((in_three, worst_three), (in_four, worst_four)) = (least(&three), least(&four));
        println!("{name:26} {worst_three:5.2} {in_three:8} {worst_four:5.2} {in_four:8}");
        assert!(worst_three >= NEEDED, "{name}: three parameters, {in_three}: {worst_three:.2} digits");
        assert!(worst_four >= NEEDED, "{name}: four parameters, {in_four}: {worst_four:.2} digits");
    }
}
