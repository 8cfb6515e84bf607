use super::*;
use crate::data::across::{CommonChange, RunAtTemperature};
use crate::data::run::Location;

const TYPE_A: f64 = 1e-6;
const TYPE_B: f64 = 1e-4;

/// What all share.
const SCALE: &str = "scale factor of the x coil";

fn run(id: &str) -> CalibratedRun {
    CalibratedRun {
        file: format!("{id}.CPF"),
        run: RunAtTemperature {
            id: id.to_owned(),
            sensor: "FGM".to_owned(),
            mode: "science".to_owned(),
            location: Location::Centre,
            temperature_degc: Some(20.0),
            coil_temperature_degc: None,
        },
        channel: None,
        values: RunValues::Lin {
            sigma: [1.0; 3],
            xi_deg: [90.0; 3],
            b_or_ent: [0.0; 3],
            std: [Some([TYPE_A; 3]), Some([TYPE_A; 3]), Some([TYPE_A; 3])],
            freedom: None,
            common: Some(vec![CommonChange {
                source: SCALE.to_owned(),
                sigma: [TYPE_B, 0.0, 0.0],
                xi_deg: [0.0; 3],
                b_or_ent: [0.0; 3],
            }]),
            rotation_deg: [0.0; 3],
            rotation_std_deg: [0.0; 3],
            rho: None,
            r_nom: None,
            scope: Box::new(LinearScope::default()),
        },
        reference: None,
        notes: Vec::new(),
        copy_of: None,
    }
}

fn beside() -> OffCentre {
    let constant = |value: f64| TemperaturePolynomial {
        coefficients: vec![value],
        covariance: DMatrix::from_element(1, 1, TYPE_A * TYPE_A),
        valid_degc: [-20.0, 60.0],
    };
    OffCentre {
        convention: Convention::BepiColombo,
        sensor: "FGM".to_owned(),
        mode: "science".to_owned(),
        runs: Vec::new(),
        valid_degc: [-20.0, 60.0],
        sigma: [1.0; 3].map(constant),
        xi_deg: [90.0; 3].map(constant),
        b_or_ent: [0.0; 3].map(constant),
        scope: LinearScope::default(),
        of_facility: Some(vec![(SCALE.to_owned(), [TYPE_B, 0.0, 0.0, 0.0, 0.0, 0.0].map(|change| vec![change]))]),
    }
}

/// `σ⁰(T) = σ¹(T) σ⁰(T1) / σ¹(T1)`: a scale of the coil system that is wrong is wrong in all three, so that it stays once, whether a run
/// beside the centre is there or the polynomials stand for it. Of independent errors the first would have √3, the second none at all.
#[test]
fn an_error_of_the_facility_counts_once_at_the_centre() {
    let (at, off) = (run("26-03-02_08-00-00"), run("26-03-02_09-00-00"));
    for off_centre in [None, Some(&off)] {
        let found = centre(&beside(), Pair { centre: &at, off_centre, offset: None }).unwrap();
        let std = found.sigma.each_ref().map(|p| p.covariance[(0, 0)].sqrt());
        // The uncertainties of type A are a hundredth of it.
        assert!((std[0] / TYPE_B - 1.0).abs() < 1e-3, "{std:?}");
        assert!(std[1] < 2.0 * TYPE_A && std[2] < 2.0 * TYPE_A, "{std:?}");
        // k is a ratio of two runs at one facility.
        assert!(found.k_std.unwrap()[0] < 2.0 * TYPE_A, "{:?}", found.k_std);
    }
}

#[test]
fn runs_at_the_centre_have_a_mean_of_what_moves_them_together() {
    let change = |source: &str, sigma: f64| CommonChange {
        source: source.to_owned(),
        sigma: [sigma; 3],
        xi_deg: [0.0; 3],
        b_or_ent: [0.0; 3],
    };
    let of = |id: &str, changes: Vec<CommonChange>| {
        let mut run = run(id);
        run.run.temperature_degc = Some(20.0);
        let RunValues::Lin { common, .. } = &mut run.values else { panic!("a linearity run") };
        *common = Some(changes);
        run
    };
    let runs = [of("a", vec![change("scale", 2e-6)]), of("b", vec![change("scale", 4e-6), change("angle", 1e-6)])];
    let (mean, files, _) = together(&runs.each_ref(), None).expect("a mean");
    let RunValues::Lin { common, .. } = &mean.values else { panic!("a linearity run") };
    assert_eq!(files.len(), 2);
    assert_eq!(common.as_deref(), Some(&[change("scale", 3e-6), change("angle", 0.5e-6)][..]));
}
