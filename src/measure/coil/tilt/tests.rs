use super::*;
use crate::fit::random::Random;
use nalgebra::Rotation3;

/// The four orientations of CHAMP, with noise and one disturbed orientation.
fn four(random: &mut Random, disturbed: Option<usize>) -> Vec<Oriented> {
    ["+X +Y +Z", "-Y +X +Z", "-Z +Y +X", "-Z +X -Y"]
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let size = if disturbed == Some(i) { 100.0 } else { 1.0 };
            let mut scattered = |std: f64| -> [f64; 3] { std::array::from_fn(|_| size * std * random.gaussian()) };
            let [scale, offset_nt, angles] = [1e-6, 0.1, 1e-4].map(&mut scattered);
            let (scale, angles_deg) = (scale.map(|s| 1.0 + s), angles.map(|a| 90.0 + a));
            let values = SensorValues { scale, offset_nt, angles_deg };
            Oriented { position: Position::from_orientation(name).unwrap(), rho: None, values }
        })
        .collect()
}

#[test]
fn an_orientation_is_left_out_where_it_disagrees_and_not_by_chance() {
    const SETS: usize = 500;
    let mut random = Random::seeded(11);
    let mut left_out = |disturbed: Option<usize>| {
        let stated = FacilityParameters::constant([1.0; 3], [0.0; 3], [90.0; 3]);
        let sets = (0..SETS).map(|_| odd_one_out(&four(&mut random, disturbed), &stated).unwrap());
        sets.filter(|out| out.is_some() && (disturbed.is_none() || *out == disturbed)).count()
    };
    // The probability of the best of four is at most the sum of four: 5 % of the sets, with a standard deviation of 1 %.
    assert!(left_out(None) < SETS * 8 / 100);
    assert!(left_out(Some(2)) > SETS * 9 / 10);
}

/// Axes with these angles between them, the first along x: columns.
fn axes([xy, xz, yz]: [f64; 3]) -> Matrix3<f64> {
    let cos = |deg: f64| deg.to_radians().cos();
    let sine = (1.0 - cos(xy).powi(2)).sqrt();
    let along_y = (cos(yz) - cos(xy) * cos(xz)) / sine;
    let height = (1.0 - cos(xz).powi(2) - along_y * along_y).sqrt();
    Matrix3::new(1.0, cos(xy), cos(xz), 0.0, sine, along_y, 0.0, 0.0, height)
}

#[test]
fn mountings_beside_the_nominal_orientation_do_not_disturb() {
    const SETS: usize = 60;
    let ideal = FacilityParameters::constant([1.0; 3], [0.0; 3], [90.0; 3]);
    let (scale, offset_nt, angles) = ([1.0007, 0.9995, 1.0002], [40.0, -25.0, 60.0], [90.08, 89.95, 90.11]);
    let (sigma, b_or_ent, xi) = ([0.98, 1.02, 1.005], [12.0, -30.0, 5.0], [89.7, 90.2, 90.4]);
    // One enT is 1/σ along an axis: a reading is E_iᵀ B / σ_i + b_i in the field B = C S u + o.
    let coils = axes(angles) * Matrix3::from_diagonal(&Vector3::from(scale));
    let mut random = Random::seeded(5);
    let names = ["+X +Y +Z", "-Y +X +Z", "-Z +Y +X", "-Z +X -Y", "+X -Y -Z", "+Y +Z +X"];
    let (mut squares, mut ratio_of_squares, mut count, mut left_out) = (0.0, [0.0; 2], 0.0, 0);
    for _ in 0..SETS {
        let runs: Vec<OrientedRun> = names
            .iter()
            .map(|name| {
                let position = Position::from_orientation(name).unwrap();
                let turn = 0.3f64.to_radians() * Vector3::from_fn(|_, _| random.gaussian());
                let mounted = position.r_nom() * Rotation3::new(turn).into_inner() * axes(xi);
                let response = Matrix3::from_fn(|i, k| mounted[(k, i)] / sigma[i]);
                let offset_ent = Vector3::from(b_or_ent) + response * Vector3::from(offset_nt);
                // What a run evaluated with ideal coils finds: axes that are no directions in space.
                let seen = response * coils;
                let rows: [Vector3<f64>; 3] = std::array::from_fn(|i| seen.row(i).transpose());
                let mut scattered = |std: f64| std * random.gaussian();
                let found = rows.map(|row| (1.0 + scattered(1e-6)) / row.norm());
                let angle = |a: usize, b: usize| (rows[a].dot(&rows[b]) / rows[a].norm() / rows[b].norm()).acos().to_degrees();
                OrientedRun {
                    run: (*name).to_owned(),
                    sensor: String::new(),
                    mode: None,
                    position,
                    rho: Some(split(&seen.try_inverse().unwrap(), &position.r_nom()).unwrap().rho),
                    sigma: found,
                    offset_nt: std::array::from_fn(|i| found[i] * offset_ent[i] + scattered(0.03)),
                    xi_deg: [angle(0, 1), angle(0, 2), angle(1, 2)].map(|deg| deg + scattered(1e-4)),
                    field_nt: None,
                }
            })
            .collect();
        // Squares of the deviations in uncertainties and in units of the noise.
        let pulls = |runs: &[OrientedRun]| {
            let found = tilt(runs, &ideal, None, &Options::default()).unwrap().found;
            let (f, std) = (&found.facility, &found.std);
            let of = |own: [f64; 3], truth: [f64; 3], std: [f64; 3]| -> f64 {
                (0..3).map(|k| ((own[k] - truth[k]) / std[k]).powi(2)).sum()
            };
            // The scale factor that sensor and coils have in common is not known: ratios are.
            let ratio = |s: [f64; 3]| [s[0] / s[1], s[1] / s[2], s[2] / s[0]];
            let own = std::array::from_fn(|k| std.scale_nt_per_eu[k] * 3f64.sqrt());
            let all = |scale_std: [f64; 3], offset_std_nt: [f64; 3], angle_std_deg: [f64; 3]| {
                let scales = of(ratio(f.scale_nt_per_eu), ratio(scale), scale_std);
                scales + of(f.offset_nt, offset_nt, offset_std_nt) + of(f.angles_deg, angles, angle_std_deg)
            };
            let out = found.orientation.iter().filter(|o| !o.used).count();
            ([all(own, std.offset_nt, std.angles_deg), all([1e-6; 3], [0.03; 3], [1e-4; 3])], out)
        };
        let (found, out) = pulls(&runs);
        let nominal: Vec<OrientedRun> = runs.iter().map(|run| OrientedRun { rho: None, ..run.clone() }).collect();
        squares += found[0];
        ratio_of_squares[0] += found[1];
        ratio_of_squares[1] += pulls(&nominal).0[1];
        left_out += out;
        count += 9.0;
    }
    let rms = f64::sqrt(squares / count);
    let without = (ratio_of_squares[1] / ratio_of_squares[0]).sqrt();
    // Scatter of a deviation of 12 degrees of freedom: 1.1 normal ones. The best of six is left out by chance in at most 5 % of the sets: 3, with a
    // standard deviation of 1.7.
    assert!((0.8..1.4).contains(&rms) && left_out <= 3 + 5, "{rms} {left_out}");
    // 0.3 degrees times 1e-3 and 40 nT are 5e-6 and 0.2 nT, five times the noise.
    assert!(without > 2.0, "{without}: the rotations matter here");
}

#[test]
fn an_uncertainty_that_nothing_tells_is_not_zero() {
    assert!(std_of(f64::NAN).is_nan());
    assert_eq!([std_of(-1e-30), std_of(4.0)], [0.0, 2.0]);
}
