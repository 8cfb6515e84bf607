use super::*;
use crate::data::run::Setting;
use crate::data::units::{FieldCoil, Reading};
use crate::fit::random::Random;

/// Plateaus, and of each axis.
const PLATEAUS: usize = 30;
const PER_AXIS: usize = 10;
const PLATEAU_S: f64 = 24.0;
const FIELD_NT: f64 = 10_000.0;
/// Change of the sensitivity of x, per K.
const SLOPE: f64 = 5e-4;

/// One axis after the other with both signs, while the sensor cools by a kelvin every two minutes.
fn cooling() -> (Vec<Plateau>, Moving) {
    let plateau = |index: usize| {
        let mut field = [0.0; 3];
        field[index / PER_AXIS] = if index.is_multiple_of(2) { FIELD_NT } else { -FIELD_NT };
        let used_s = [PLATEAU_S * index as f64, PLATEAU_S * (index + 1) as f64];
        let [t_start_s, t_end_s] = used_s;
        let setting = Setting { t_start_s, t_end_s, field: FieldCoil(field), frequency_hz: 0.0, position: 1 };
        let mean = Reading(field);
        Plateau {
            index,
            setting,
            used_s,
            mean,
            std_ent: None,
            count: None,
            spike_samples: 0,
            dropped: None,
            contrasts: Vec::new(),
        }
    };
    let list: Vec<Plateau> = (0..PLATEAUS).map(plateau).collect();
    let mut random = Random::seeded(7);
    let reading = |i: i32| (20.0 * f64::from(i), 3.0 - f64::from(i) / 6.0 + 0.02 * random.gaussian());
    let course = Course::smooth(&(0..=36).map(reading).collect::<Vec<_>>());
    let over_k: Vec<f64> = list.iter().map(|p| mean_over(&course.series, p.used_s)).collect();
    let [low, high] = extremes(over_k.iter().copied());
    (list, Moving { at_degc: 0.0, over_k, std_k: 0.0, course, is_shown: true, range_degc: [low, high], rate_k_per_h: -30.0 })
}

/// The response is the mean over the plateaus of its axis of what each says, so that it errs by the slope times the mean of the smoothed
/// noise over them. How that follows from every reading of the thermometer is known from the weights of the smoothing.
#[test]
fn the_noise_of_a_thermometer_moves_a_response_as_its_readings_do() {
    let (list, moving) = cooling();
    assert!((moving.course.noise - 0.02).abs() < 0.01, "{}", moving.course.noise);
    let used: Vec<&Plateau> = list.iter().collect();
    let means = Means::of(&used, 0);
    let at = split(&Matrix3::identity(), &Matrix3::identity()).unwrap();
    let mut change = SensorChange::default();
    change.sensor[0] = vec![SLOPE];
    let changes = changes_by_thermometer_ent(&change, &at, &list, &moving);
    let covariance = carried::covariance(&changes, &list, &means.design().unwrap()).unwrap();
    let weights = moving.course.weights();
    let readings = moving.course.series.len();
    let by_reading = |k: usize| {
        let one: Vec<f64> = (0..readings).map(|i| f64::from(u8::from(i == k))).collect();
        let course = weights.course(&one);
        list[..PER_AXIS].iter().map(|p| mean_over(&course.series, p.used_s)).sum::<f64>() / PER_AXIS as f64
    };
    let squares: f64 = (0..readings).map(|k| by_reading(k).powi(2)).sum();
    let expected = SLOPE * moving.course.noise * squares.sqrt();
    // Sixty-four courses tell it to 1/√128.
    let found = covariance[(0, 0)].sqrt();
    assert!((found / expected - 1.0).abs() < 3.0 / 128f64.sqrt(), "{found} is not {expected}");
    // Nothing follows the temperature in the other components.
    let per = covariance.nrows() / 3;
    assert!((per..3 * per).all(|i| covariance[(i, i)] == 0.0));
}
