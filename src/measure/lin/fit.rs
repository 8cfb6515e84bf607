//! The linear model of a run and its fit to the means of the plateaus.

use super::refusal::{LinError, MOST_CONDITION};
use crate::data::plateau::Plateau;
use crate::fit::statistics::extremes;
use crate::fit::{FitError, Limits, Robust, Solution, linear, robust};
use crate::record::baseline::Baseline;
use nalgebra::{DMatrix, DVector};

/// What a trend in time leaves of the sensor temperature, K, beyond which the offset follows the temperature beside the trend: about what
/// thermometers resolve.
const LEAST_LEFT_K: f64 = 0.02;

/// The means of a fit with the model that is fitted to them.
pub(super) struct Means {
    /// The model.
    pub baseline: Baseline,
    /// Reference fields, nT.
    pub fields_nt: Vec<[f64; 3]>,
    /// Middles of the plateaus, s since the run's start.
    pub t_s: Vec<f64>,
    /// First and last of them.
    pub span_s: [f64; 2],
    /// Columns that the temperature of the sensor brings, with their names; absent where it is at rest.
    extra: Option<Extra>,
}

/// Columns that the temperature of the sensor brings.
struct Extra {
    names: Vec<String>,
    columns: DMatrix<f64>,
    /// Those of the offset, one or none, which stand first.
    offset: usize,
}

impl Means {
    /// Of the plateaus that are used; tau runs from -1 to +1 over their middles.
    pub fn of(used: &[&Plateau], order: usize) -> Self {
        let t_s: Vec<f64> = used.iter().map(|p| p.t_s()).collect();
        let span_s = extremes(t_s.iter().copied());
        let fields_nt = used.iter().map(|p| p.setting.field.0).collect();
        Self { baseline: Baseline::in_time(span_s, order), fields_nt, t_s, span_s, extra: None }
    }

    /// The same with a response that follows the powers of the temperature, given over any other, K, up to some, and with an offset that
    /// follows it too, unless the trend does within what a thermometer tells.
    pub fn with_temperature(self, over_k: &[f64], powers: usize) -> Self {
        let count = self.baseline.offset_order() + 1;
        let trend = DMatrix::from_fn(over_k.len(), count, |i, k| self.baseline.mapped(self.t_s[i]).powi(k as i32));
        let course = DVector::from_column_slice(over_k);
        let q = trend.qr().q();
        let left_k = (&course - &q * q.tr_mul(&course)).norm() / (over_k.len() as f64).sqrt();
        let offset = usize::from(left_k > LEAST_LEFT_K);
        let columns = DMatrix::from_fn(over_k.len(), offset + 3 * powers, |i, k| match k.checked_sub(offset) {
            None => over_k[i],
            Some(k) => over_k[i].powi(k as i32 / 3 + 1) * self.fields_nt[i][k % 3],
        });
        let response = |k: usize| {
            let axis = ["X", "Y", "Z"][k % 3];
            format!("the response to {axis}_c, power {} of the sensor temperature", k / 3 + 1)
        };
        let mut names = vec!["the offset's slope with the sensor temperature".to_owned(); offset];
        names.extend((0..3 * powers).map(response));
        Self { extra: Some(Extra { names, columns, offset }), ..self }
    }

    /// The columns beside those of the baseline.
    pub fn into_extra(self) -> Option<DMatrix<f64>> {
        self.extra.map(|extra| extra.columns)
    }

    /// Numbers of columns beside those of the baseline: of the offset, and of the response.
    pub fn extra(&self) -> [usize; 2] {
        self.extra.as_ref().map_or([0; 2], |extra| [extra.offset, extra.names.len() - extra.offset])
    }

    /// The columns of a component.
    pub fn columns(&self) -> DMatrix<f64> {
        let base = self.baseline.columns(&self.fields_nt, &self.t_s);
        let Some(extra) = &self.extra else { return base };
        let count = base.ncols();
        let mut all = base.resize_horizontally(count + extra.names.len(), 0.0);
        all.columns_mut(count, extra.names.len()).copy_from(&extra.columns);
        all
    }

    /// The design matrix of a component.
    pub fn design(&self) -> Result<linear::Design, FitError> {
        let mut names = self.baseline.names();
        names.extend(self.extra.iter().flat_map(|extra| extra.names.iter().cloned()));
        linear::Design::new(names, self.columns())
    }

    /// Mean `B_or` over the plateaus, enT.
    pub fn mean_b_or_ent(&self, stacked: &[f64]) -> [f64; 3] {
        let mean =
            |k: usize| self.t_s.iter().map(|t| self.baseline.mapped(*t).powi(k as i32)).sum::<f64>() / self.t_s.len() as f64;
        let powers: Vec<f64> = (0..=self.baseline.offset_order()).map(mean).collect();
        std::array::from_fn(|a| self.baseline.offsets_ent(stacked, a).iter().zip(&powers).map(|(c, m)| c * m).sum())
    }
}

/// A fit of the means.
pub(super) struct Fitted {
    /// The solution.
    pub solution: Solution,
    pseudo: Option<Solution>,
    /// Weights of the plateaus in a robust fit, otherwise 1.
    pub weights: Vec<f64>,
    /// Plateaus with reduced weight; absent if the fit was not robust.
    pub downweighted: Option<usize>,
}

impl Fitted {
    /// The solution whose residuals show the noise.
    pub fn for_noise(&self) -> &Solution {
        self.pseudo.as_ref().unwrap_or(&self.solution)
    }
}

/// Fits the means by least squares, or with less weight for outlying plateaus.
pub(super) fn fit(used: &[&Plateau], means: &Means, is_robust: bool) -> Result<Fitted, LinError> {
    let rhs = DMatrix::from_fn(used.len(), 3, |row, component| used[row].mean.0[component]);
    let limits = Limits { max_condition: MOST_CONDITION };
    let explain = |error: FitError| match error {
        FitError::Undetermined { parameters, condition } => LinError::Undetermined { parameters, condition },
        other => LinError::Fit(other),
    };
    let design = means.design().map_err(explain)?;
    if is_robust {
        let Robust { solution, pseudo, weights, downweighted, .. } =
            robust::fit(&design, &rhs, None, &limits).map_err(explain)?;
        Ok(Fitted { solution, pseudo: Some(pseudo), weights, downweighted: Some(downweighted) })
    } else {
        let solution = linear::solve(&design, &rhs, None, &limits).map_err(explain)?;
        Ok(Fitted { solution, pseudo: None, weights: vec![1.0; used.len()], downweighted: None })
    }
}

/// The coefficients of all components in one list, component after component.
pub(super) fn stack(coefficients: &DMatrix<f64>) -> Vec<f64> {
    coefficients.column_iter().flat_map(|column| column.iter().copied().collect::<Vec<f64>>()).collect()
}
