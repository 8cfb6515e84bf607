//! The linear model of a run before any effect is added (docs/mathematics.md, "Linear calibration" and "Temperature"):
//! `B_r = Σ_k u^k A_k B_c + Σ_k u^k o_k`, with `u` the time or a temperature, mapped to -1 to 1 over the run.
//!
//! A linearity run has a constant response and an offset that is a polynomial of the time; a sweep has polynomials of the temperature for
//! both.

use crate::fit::statistics::extremes;
use crate::fit::{FitError, Limits, Solution, linear};
use nalgebra::{DMatrix, Matrix3};

/// What the polynomials are functions of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Argument {
    /// Time, s since the run's start.
    Time,
    /// Temperature, °C.
    Temperature,
}

/// The linear model of a run.
///
/// Its columns are the response to the three components of the field, power after power, then the offset, power after power; rows are
/// given as their reference fields, nT in coil axes, and their times or temperatures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Baseline {
    argument: Argument,
    middle: f64,
    half: f64,
    /// Order of the polynomials of the response; `None` where no field is applied.
    response: Option<usize>,
    offset: usize,
    /// The columns of the response are in units of this field, nT.
    unit_nt: f64,
}

impl Baseline {
    /// A constant response, and an offset that is a polynomial of the time over `span_s`, s.
    #[must_use]
    pub fn in_time(span_s: [f64; 2], offset: usize) -> Self {
        Self::over(Argument::Time, span_s, 0, offset)
    }

    /// Response and offset as polynomials of the temperature, mapped over `degc`, °C.
    #[must_use]
    pub fn in_temperature(degc: &[f64], response: usize, offset: usize) -> Self {
        Self::over(Argument::Temperature, extremes(degc.iter().copied()), response, offset)
    }

    fn over(argument: Argument, [low, high]: [f64; 2], response: usize, offset: usize) -> Self {
        let (middle, half) = (0.5 * (low + high), (0.5 * (high - low)).max(f64::MIN_POSITIVE));
        Self { argument, middle, half, response: Some(response), offset, unit_nt: 1.0 }
    }

    /// With columns in units of the largest component of these fields, so that all columns are of the size of one; without a response
    /// where no field is applied.
    #[must_use]
    pub fn in_units_of(self, fields_nt: &[[f64; 3]]) -> Self {
        let most = fields_nt.iter().flatten().fold(0.0, |most: f64, b| most.max(b.abs()));
        match most > 0.0 {
            true => Self { unit_nt: most, ..self },
            false => Self { response: None, ..self },
        }
    }

    /// Number of columns of the response.
    fn fields(&self) -> usize {
        self.response.map_or(0, |order| 3 * (order + 1))
    }

    /// Number of columns.
    #[must_use]
    pub fn count(&self) -> usize {
        self.fields() + self.offset + 1
    }

    /// Order of the polynomials of the response.
    #[must_use]
    pub fn response_order(&self) -> usize {
        self.response.unwrap_or(0)
    }

    /// Order of the polynomial of the offset.
    #[must_use]
    pub fn offset_order(&self) -> usize {
        self.offset
    }

    /// Middle of the times, s, or temperatures, °C.
    #[must_use]
    pub fn middle(&self) -> f64 {
        self.middle
    }

    /// Half of the range of the times, s, or temperatures, K.
    #[must_use]
    pub fn half(&self) -> f64 {
        self.half
    }

    /// A time, s, or temperature, °C, mapped to -1 to 1.
    #[must_use]
    pub fn mapped(&self, x: f64) -> f64 {
        (x - self.middle) / self.half
    }

    /// The columns, n x p, of rows with these fields, nT in coil axes, and times, s, or temperatures, °C.
    #[must_use]
    pub fn columns(&self, fields_nt: &[[f64; 3]], x: &[f64]) -> DMatrix<f64> {
        let fields = self.fields();
        DMatrix::from_fn(fields_nt.len(), self.count(), |i, j| {
            let power = |k: usize| self.mapped(x[i]).powi(k as i32);
            if j < fields { fields_nt[i][j % 3] / self.unit_nt * power(j / 3) } else { power(j - fields) }
        })
    }

    /// The same with the names of the parameters.
    ///
    /// # Errors
    /// [`FitError::NotFinite`].
    pub fn design(&self, fields_nt: &[[f64; 3]], x: &[f64]) -> Result<linear::Design, FitError> {
        linear::Design::new(self.names(), self.columns(fields_nt, x))
    }

    /// Names of the parameters.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        (0..self.count()).map(|j| self.name(j)).collect()
    }

    fn name(&self, j: usize) -> String {
        let axis = ["X", "Y", "Z"][j % 3];
        match (self.argument, j.checked_sub(self.fields())) {
            (Argument::Time, None) => format!("the response to {axis}_c"),
            (Argument::Time, Some(0)) => "the offset".to_owned(),
            (Argument::Time, Some(1)) => "the offset's slope".to_owned(),
            (Argument::Time, Some(2)) => "the offset's curvature".to_owned(),
            (Argument::Time, Some(power)) => format!("the offset, power {power} of the time"),
            (Argument::Temperature, None) => format!("the response to {axis}_c, power {} of the temperature", j / 3),
            (Argument::Temperature, Some(power)) => format!("the offset, power {power} of the temperature"),
        }
    }

    /// Least squares for mean readings, n x 3 enT.
    ///
    /// # Errors
    /// Those of [`linear::solve`].
    pub fn fit(
        &self,
        fields_nt: &[[f64; 3]],
        x: &[f64],
        readings_ent: &DMatrix<f64>,
        limits: &Limits,
    ) -> Result<Solution, FitError> {
        linear::solve(&self.design(fields_nt, x)?, readings_ent, None, limits)
    }

    /// Sum of the squares of what the model leaves of each component of the readings, enT². Columns that depend on each other count once.
    #[must_use]
    pub fn squares_ent2(&self, fields_nt: &[[f64; 3]], x: &[f64], readings_ent: &DMatrix<f64>) -> [f64; 3] {
        let columns = self.in_units_of(fields_nt).columns(fields_nt, x);
        let explained = columns.ncols().min(columns.nrows());
        let mut turned = readings_ent.clone();
        columns.qr().q_tr_mul(&mut turned);
        std::array::from_fn(|a| turned.column(a).rows(explained, turned.nrows() - explained).norm_squared())
    }

    /// Response, enT/nT, coil axes to sensor axes, per power of the mapped time or temperature; empty where no field is applied.
    #[must_use]
    pub fn responses(&self, stacked: &[f64]) -> Vec<Matrix3<f64>> {
        let of = |power: usize| {
            Matrix3::from_fn(|i, axis| self.coefficients(stacked, i).get(3 * power + axis).map_or(f64::NAN, |c| c / self.unit_nt))
        };
        (0..self.fields() / 3).map(of).collect()
    }

    /// Coefficients of the offset of a component, enT per power of the mapped time or temperature.
    #[must_use]
    pub fn offsets_ent<'a>(&self, stacked: &'a [f64], component: usize) -> &'a [f64] {
        self.coefficients(stacked, component).get(self.fields()..).unwrap_or_default()
    }

    /// Coefficients of a component in the stack of all of them, parameter j of component a at `a p + j`.
    fn coefficients<'a>(&self, stacked: &'a [f64], component: usize) -> &'a [f64] {
        let count = self.count();
        stacked.get(component * count..(component + 1) * count).unwrap_or_default()
    }

    /// Response, enT/nT, and offset, enT, at a time, s, or temperature, °C.
    #[must_use]
    pub fn at(&self, stacked: &[f64], x: f64) -> (Matrix3<f64>, [f64; 3]) {
        let u = self.mapped(x);
        let response = self.responses(stacked);
        let sum = response.iter().enumerate().fold(Matrix3::zeros(), |sum, (power, m)| sum + m * u.powi(power as i32));
        let offset = |i: usize| self.offsets_ent(stacked, i).iter().enumerate().map(|(k, c)| c * u.powi(k as i32)).sum();
        (sum, std::array::from_fn(offset))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forty rows whose fields go round, with times and temperatures.
    fn rows() -> (Vec<[f64; 3]>, Vec<f64>) {
        let field = |i: usize| [0, 1, 2].map(|a| 900.0 * (1.7 * (i * (a + 1)) as f64 + a as f64).sin());
        ((0..40).map(field).collect(), (0..40).map(|i| 17.0 + 3.0 * f64::from(i)).collect())
    }

    /// Response `A_0 + u A_1` and offset `o_0 + u o_1 + u² o_2` come back from exact readings, in any unit of the columns.
    #[test]
    fn polynomials_come_back() {
        let (fields, x) = rows();
        let plain = Baseline::in_temperature(&x, 1, 2);
        let matrix =
            |power: usize| Matrix3::from_fn(|i, j| if power == 0 { f64::from(i == j) } else { 1e-3 * (i + 2 * j) as f64 });
        let offset = |i: usize, u: f64| 5.0 - 2.0 * u * i as f64 + 0.5 * u * u;
        let readings = DMatrix::from_fn(40, 3, |r, i| {
            let u = plain.mapped(x[r]);
            (0..3).map(|j| (matrix(0) + u * matrix(1))[(i, j)] * fields[r][j]).sum::<f64>() + offset(i, u)
        });
        for baseline in [plain, plain.in_units_of(&fields)] {
            let fit = baseline.fit(&fields, &x, &readings, &Limits::default()).unwrap();
            let stacked = fit.coefficients.as_slice();
            let (response, offset_ent) = baseline.at(stacked, x[9]);
            let u = baseline.mapped(x[9]);
            assert!((response - (matrix(0) + u * matrix(1))).amax() < 1e-12);
            assert!((0..3).all(|i| (offset_ent[i] - offset(i, u)).abs() < 1e-9));
            assert!(baseline.squares_ent2(&fields, &x, &readings).iter().all(|s| *s < 1e-16));
            assert_eq!((baseline.count(), baseline.offsets_ent(stacked, 1).len()), (9, 3));
        }
    }

    /// What a fit to noise leaves is the same by the solver and by the projection, and without fields only the offset is there.
    #[test]
    fn squares_are_those_of_the_fit() {
        let (fields, x) = rows();
        let readings = DMatrix::from_fn(40, 3, |i, a| ((i * i * (a + 3)) as f64 * 0.37).sin());
        let baseline = Baseline::in_time([x[0], x[39]], 2);
        let fit = baseline.fit(&fields, &x, &readings, &Limits::default()).unwrap();
        for (a, squares) in baseline.squares_ent2(&fields, &x, &readings).iter().enumerate() {
            assert!((squares / fit.residuals.column(a).norm_squared() - 1.0).abs() < 1e-12);
        }
        let without = baseline.in_units_of(&[[0.0; 3]; 40]);
        assert_eq!((without.count(), without.responses(&[0.0; 9]).len()), (3, 0));
        assert_eq!(without.design(&fields, &x).unwrap().names(), ["the offset", "the offset's slope", "the offset's curvature"]);
    }
}
