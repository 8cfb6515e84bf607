//! Temperatures to counts of the thermistor, the way back of [`Thermometer`].

use crate::flight::temperature::Thermometer;

/// Steps of its converter.
const STEPS: f64 = 65_536.0;
/// Its voltages lie within plus and minus this, V.
const HALF_VOLTS: f64 = 2.5;

/// A thermistor whose counts are wanted.
#[derive(Clone, Debug)]
pub struct Thermistor {
    /// From counts to temperatures.
    pub thermometer: Thermometer,
    /// Voltages between which the polynomial rises.
    volts: [f64; 2],
}

impl Thermistor {
    /// A thermistor whose polynomial rises over a range of temperatures, °C; `None` where it does not.
    #[must_use]
    pub fn new(thermometer: Thermometer, [low, high]: [f64; 2]) -> Option<Self> {
        let degc = |volts: f64| crate::model::polynomial::value(&thermometer.coefficients, volts) - thermometer.t_off_degc;
        // The stretch about the middle of the temperatures over which the polynomial rises.
        let steps: Vec<f64> = (0..=1000).map(|k| -HALF_VOLTS + f64::from(k) * 2.0 * HALF_VOLTS / 1000.0).collect();
        let values: Vec<f64> = steps.iter().map(|v| degc(*v)).collect();
        let begin = values.windows(2).position(|p| p[0] <= low && low < p[1])?;
        let end = begin + values[begin..].windows(2).take_while(|p| p[0] < p[1]).count();
        (values[end] >= high).then(|| Self { volts: [steps[begin], steps[end]], thermometer })
    }

    /// The count at a temperature, °C, without its step: between 0 and 2¹⁶.
    #[must_use]
    pub fn count(&self, degc: f64) -> f64 {
        let value =
            |volts: f64| crate::model::polynomial::value(&self.thermometer.coefficients, volts) - self.thermometer.t_off_degc;
        let [mut low, mut high] = self.volts;
        // Halving ends where the numbers end.
        loop {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if value(middle) < degc { low = middle } else { high = middle }
        }
        let steps = (0.5 * (low + high) + HALF_VOLTS) * (STEPS - 1.0) / (2.0 * HALF_VOLTS);
        (steps - 0.5 * STEPS).rem_euclid(STEPS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_lead_back_to_the_temperature() {
        let thermometer = Thermometer { coefficients: vec![-368.61072, 458.49304, -356.0289, 180.00644], t_off_degc: -2.7 };
        let thermistor = Thermistor::new(thermometer.clone(), [-140.0, 90.0]).unwrap();
        for degc in [-139.5, -70.0, -0.001, 17.39, 89.0] {
            let count = thermistor.count(degc);
            assert!((0.0..65_536.0).contains(&count));
            assert!((thermometer.degc(count) - degc).abs() < 1e-9, "{degc}");
        }
        let falling = Thermometer { coefficients: vec![0.0, -50.0], t_off_degc: 0.0 };
        assert!(Thermistor::new(falling, [-50.0, 50.0]).is_none());
    }
}
