//! The course of time that an amplitude may follow beside a response.

/// Form of a course: what the logarithm of an amplitude follows of the relative time, -1 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Form {
    /// A polynomial of this degree without a constant; of degree zero, nothing.
    Polynomial(usize),
    /// The exponential approach of something that warms up, with a time constant to start from, in units of half of the run.
    Approach(f64),
}

/// Highest degree of a polynomial.
const HIGHEST_DEGREE: usize = 5;
/// Time constants that are tried: a fit from one finds those up to its neighbours.
const TIME_CONSTANTS: [f64; 5] = [0.1, 0.2, 0.4, 0.8, 1.6];

impl Form {
    /// Of amplitudes that follow no time.
    pub const STILL: Self = Self::Polynomial(0);

    /// All that are tried.
    pub fn all() -> impl Iterator<Item = Self> {
        (1..=HIGHEST_DEGREE).map(Self::Polynomial).chain(TIME_CONSTANTS.map(Self::Approach))
    }

    /// Number of its parameters: coefficients from the first power on, or the size of an approach and the logarithm of its time constant.
    pub fn count(self) -> usize {
        match self {
            Self::Polynomial(degree) => degree,
            Self::Approach(_) => 2,
        }
    }

    /// How many of them, the first ones, are sizes: the course is linear in them.
    pub fn linear(self) -> usize {
        match self {
            Self::Polynomial(degree) => degree,
            Self::Approach(_) => 1,
        }
    }

    /// Parameters to start from, with the sizes given.
    pub fn start(self, sizes: impl Iterator<Item = f64>) -> Vec<f64> {
        match self {
            Self::Polynomial(_) => sizes.collect(),
            Self::Approach(time_constant) => sizes.chain([time_constant.ln()]).collect(),
        }
    }

    /// The course at a relative time, zero in the middle of the run, and its derivatives by the parameters; whether the time is known or not where there are
    /// none.
    pub fn value_and_slopes(self, parameters: &[f64], time: f64) -> (f64, Vec<f64>) {
        match (self, parameters) {
            (Self::Approach(_), [size, log_time_constant]) => {
                let time_constant = log_time_constant.exp();
                let over = |time: f64| (time + 1.0) / time_constant;
                let course = |time: f64| (-over(time)).exp();
                let shape = course(time) - course(0.0);
                (size * shape, vec![shape, size * (course(time) * over(time) - course(0.0) * over(0.0))])
            }
            _ => {
                let slopes: Vec<f64> = (1..=parameters.len()).map(|power| time.powi(power as i32)).collect();
                (parameters.iter().zip(&slopes).map(|(c, slope)| c * slope).sum(), slopes)
            }
        }
    }
}

/// A course with its parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Course {
    pub form: Form,
    pub parameters: Vec<f64>,
}

impl Course {
    /// Factor on an amplitude at a relative time; 1 where it follows none, whether the time is known or not.
    pub fn factor(&self, time: f64) -> f64 {
        self.form.value_and_slopes(&self.parameters, time).0.exp()
    }
}

#[cfg(test)]
mod tests {
    use super::Form;

    #[test]
    fn slopes_are_those_of_the_course() {
        const STEP: f64 = 1e-6;
        for (form, parameters) in [(Form::Polynomial(3), vec![0.2, -0.1, 0.3]), (Form::Approach(0.4), vec![0.7, -0.9])] {
            assert!(form.value_and_slopes(&parameters, 0.0).0.abs() < 1e-15);
            for time in [-1.0, -0.3, 0.8] {
                let (_, slopes) = form.value_and_slopes(&parameters, time);
                for (k, slope) in slopes.iter().enumerate() {
                    let at = |by: f64| {
                        let mut moved = parameters.clone();
                        moved[k] += by;
                        form.value_and_slopes(&moved, time).0
                    };
                    assert!((slope - (at(STEP) - at(-STEP)) / (2.0 * STEP)).abs() < 1e-9, "{form:?} {k} {time}");
                }
            }
        }
        assert_eq!(Form::STILL.value_and_slopes(&[], f64::NAN).0, 0.0);
    }
}
