//! Short forms of the study of damages.

use crate::damages::{ALL, Damage, Kind, Outcome, silent, table};
use crate::flight_damages as flight;

/// Damages that every kind of run is tried with.
const FEW: [&str; 7] = [
    "readings x 1000",
    "x stuck",
    "one reading of 1e29",
    "one spike of 100 nT",
    "10 % lost, counted",
    "gain + 0.1 % from 45 % on",
    "settings a row later",
];

#[track_caller]
fn none_is_silent(kinds: &[Kind], damages: &[Damage]) {
    let cells = table(kinds, damages).unwrap();
    let words: Vec<String> =
        silent(&cells).iter().map(|c| format!("{} in {}: {:?}", c.damage, c.kind.name(), c.outcome)).collect();
    assert!(words.is_empty(), "wrong without a word: {words:#?}");
    let refused = cells.iter().filter(|c| c.outcome == Outcome::Refused).count();
    assert!(refused > 0, "nothing was refused");
}

#[test]
fn runs_of_plateaus_are_never_wrong_without_a_word() {
    none_is_silent(&[Kind::Linearity, Kind::Means, Kind::Offset, Kind::Moving, Kind::Imported, Kind::Applied], &ALL);
}

#[test]
fn other_runs_are_not_wrong_without_a_word() {
    let few: Vec<Damage> = ALL.into_iter().filter(|d| FEW.contains(&d.name)).collect();
    let sparse: Vec<Damage> = ALL.into_iter().filter(|d| d.name == "two temperatures, 17 and 85").collect();
    assert!(silent(&table(&[Kind::Sweep], &sparse).unwrap()).is_empty(), "a sweep with two temperatures");
    none_is_silent(&[Kind::Sines, Kind::Sweep, Kind::Amplitudes, Kind::ZeroField, Kind::Scalar], &few);
}

#[test]
fn flight_inputs_are_never_wrong_without_a_word() {
    let wanted = [
        "no file",
        "first column reversed",
        "time_tt2000 + 10 s, others right",
        "+ 10 s",
        "every second row lost",
        "roles exchanged",
    ];
    let few: Vec<&flight::Damage> = flight::ALL.iter().filter(|d| wanted.contains(&d.name)).collect();
    let cells = flight::table(&[flight::Kind::Science], &few, "A").unwrap();
    let of = |name: &str| &cells.iter().find(|c| c.damage == name).unwrap().outcome;
    let told = |outcome: &Outcome| matches!(outcome, Outcome::Warned(of) if of.contains("note"));
    assert_eq!((of("time_tt2000 + 10 s, others right"), of("roles exchanged")), (&Outcome::Refused, &Outcome::NotThere));
    assert!(
        told(of("first column reversed")) && told(of("every second row lost")) && told(of("+ 10 s")),
        "{:?}",
        cells.iter().map(|c| &c.outcome).collect::<Vec<_>>()
    );
    assert!(silent(&cells).is_empty());
}

/// Damages of what stands beside the telemetry, with the levels in which they are told.
#[test]
fn tables_beside_the_telemetry_are_never_wrong_without_a_word() {
    let all = [
        (flight::Kind::Housekeeping, "A", ["first column stands", "- 20 min"].as_slice()),
        (flight::Kind::Heaters, "K", ["a tenth of the rows lost at once", "every second row lost"].as_slice()),
        (flight::Kind::Wheels, "H", ["200 bytes of zeros inside", "TAI in place of TT"].as_slice()),
        (flight::Kind::Configuration, "B", ["boom deployed 10 min late"].as_slice()),
    ];
    for (kind, levels, wanted) in all {
        let few: Vec<&flight::Damage> = flight::ALL.iter().filter(|d| wanted.contains(&d.name)).collect();
        assert_eq!(few.len(), wanted.len());
        for cell in flight::table(&[kind], &few, levels).unwrap() {
            let told =
                matches!(cell.outcome, Outcome::Refused) || matches!(&cell.outcome, Outcome::Warned(of) if of.contains("note"));
            assert!(told, "{} in {}: {:?}", cell.damage, cell.kind.name(), cell.outcome);
        }
    }
}
