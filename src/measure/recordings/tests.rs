use super::*;
use crate::fit::random::Random;

/// Noise in the digits of a file.
fn readings(seed: u64, count: usize) -> Vec<[f64; 3]> {
    let mut random = Random::seeded(seed);
    (0..count).map(|_| std::array::from_fn(|_| (10.0 * random.gaussian()).round() / 100.0)).collect()
}

fn sketch(readings: &[[f64; 3]]) -> Sketch {
    let mut sketch = Sketch::default();
    readings.iter().for_each(|reading| sketch.take(*reading));
    sketch
}

fn recording(id: &str, readings: &[[f64; 3]], degc: f64) -> Recording {
    Recording {
        id: id.to_owned(),
        sensor: "S".to_owned(),
        mode: "m".to_owned(),
        kind: Kind::Linearity,
        times_s: None,
        readings: sketch(readings),
        temperatures: Sketch::of_means([[degc].as_slice()]),
    }
}

#[test]
fn exports_of_one_recording_are_copies_of_the_longest() {
    let all = readings(1, 4000);
    let runs = [
        recording("later", &all[400..], 20.0),
        recording("whole", &all, 20.0),
        recording("shorter", &all[..3900], 20.0),
        recording("another", &readings(2, 4000), 20.0),
        // The same readings, in a file that states another temperature, are no second export.
        recording("warmer", &all[..3000], 85.0),
        // A tenth of it is a piece of a record that was cut in two.
        recording("next", &[&all[3600..], &readings(3, 3600)].concat(), 20.0),
    ];
    let found: Vec<(usize, usize)> = copies(&runs).iter().map(|copied| (copied.copy, copied.of)).collect();
    assert_eq!(found, [(0, 1), (2, 1)]);
    assert!(copies(&runs).iter().all(|copied| copied.part > 0.95));
    let notes = told(&runs);
    let [note] = notes.as_slice() else { panic!("{notes:?}") };
    assert_eq!(note.about.as_deref(), Some("later"));
    let text = note.to_string();
    assert!(text.contains(" of its readings stand in run whole as well") && text.contains("said of shorter; "), "{text}");
    // The first of equals stays.
    let twice = [recording("a", &all, 20.0), recording("b", &all, 20.0)];
    assert_eq!(copies(&twice), [Copied { copy: 1, of: 0, part: 1.0 }]);
}

#[test]
fn a_sensor_is_in_one_run_at_a_time() {
    let at = |id: &str, times_s: [f64; 2]| Recording { times_s: Some(times_s), ..recording(id, &[], 20.0) };
    let following = [at("a", [0.0, 1800.0]), at("b", [1795.0, 2400.0]), at("c", [2500.0, 2600.0])];
    assert!(told(&following).is_empty());
    let another = Recording { sensor: "T".to_owned(), ..at("d", [600.0, 900.0]) };
    let unnamed = Recording { sensor: String::new(), ..at("e", [600.0, 900.0]) };
    let slower = Recording { mode: "slow".to_owned(), ..at("f", [0.0, 1800.0]) };
    assert!(told(&[at("a", [0.0, 1800.0]), another, unnamed.clone(), unnamed, slower]).is_empty());
    // The long run goes on after the first that lies in it.
    let runs =
        [at("inside", [600.0, 900.0]), at("long", [0.0, 1800.0]), at("later", [1200.0, 4000.0]), at("free", [4000.0, 5000.0])];
    assert_eq!(
        overlaps(&runs, &[]),
        [Overlap { first: 1, second: 0, for_s: 300.0 }, Overlap { first: 1, second: 2, for_s: 600.0 }]
    );
    let notes = told(&runs);
    let [note] = notes.as_slice() else { panic!("{notes:?}") };
    let text = note.to_string();
    assert!(text.starts_with("run inside begins while run long of the same sensor goes on; 5 min of both"), "{text}");
    assert!(text.contains("said of later; correct `start`"), "{text}");
}
