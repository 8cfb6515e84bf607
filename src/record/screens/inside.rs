//! What changes inside a run from one moment on.

use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::fit::step;
use nalgebra::{DMatrix, DVector};

/// A jump explains so many times more than one degree of freedom of what is left: with a thousand places to choose from noise reaches 20.
const LEAST_RATIO: f64 = 60.0;
/// It explains so many times more than any other single dependence does.
const LEAST_LEAD: f64 = 25.0;
/// In a short run, whose noise may be slow, it explains at least this part of all that the fit leaves; and in any run this.
const LEAST_PART: [f64; 2] = [0.5, 0.05];
/// A run of fewer degrees of freedom is short.
const SHORT: usize = 60;
/// Fewer degrees of freedom tell nothing.
const LEAST_FREEDOM: usize = 8;

/// Rows of a fit, in order of time.
pub struct Rows<'a> {
    /// The columns of the fit.
    pub columns: &'a DMatrix<f64>,
    /// What the fit leaves.
    pub residuals: &'a [f64],
    /// What is proportional to the conversion: the reading without its offset.
    pub course: &'a [f64],
    /// Times, s.
    pub t_s: &'a [f64],
    /// Standard deviation of the noise that matters over that of the residuals, where the noise is not white.
    pub excess: f64,
    /// The course has both signs, so that a jump of the conversion is not one of the offset.
    pub has_signs: bool,
}

/// A jump of the conversion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// First row after it.
    pub row: usize,
    /// Relative size.
    pub relative: f64,
    /// Its standard uncertainty.
    pub std: f64,
}

impl Jump {
    /// The note about it.
    #[must_use]
    pub fn note(&self, what: &str, t_s: f64) -> Note {
        let (percent, std) = (100.0 * self.relative, 100.0 * self.std);
        // As many digits as its uncertainty has two of, at least three.
        let digits = if std > 0.0 { (1.0 - std.log10().floor()).clamp(3.0, 9.0) as usize } else { 3 };
        let text = format!(
            "the gain of {what} jumps by {percent:+.digits$} ± {std:.digits$} % at {t_s:.1} s: the run is not of one sensor state, and its values and uncertainties are not \
             to be used"
        );
        Note::new(NoteKind::GainJump, text).about(what).with_remedy("divide the run there, or leave one part out with --exclude")
    }
}

/// Notes on jumps of the conversion in the means of a run; the first `responses` columns of the fit are those of the response.
#[must_use]
pub fn gain_jumps(
    columns: &DMatrix<f64>,
    responses: usize,
    coefficients: &DMatrix<f64>,
    residuals: &DMatrix<f64>,
    t_s: &[f64],
) -> Vec<Note> {
    let response = columns.columns(0, responses) * coefficients.rows(0, responses);
    let of = |a: usize| {
        let (residuals, course) = (residuals.column(a), response.column(a));
        let rows =
            Rows { columns, residuals: residuals.as_slice(), course: course.as_slice(), t_s, excess: 1.0, has_signs: true };
        gain_jump(&rows).map(|jump| jump.note(COMPONENTS[a], t_s[jump.row]))
    };
    (0..3).filter_map(of).collect()
}

/// A jump of the conversion inside the rows: it explains what the fit leaves, far better than a drift, a curved response or a jump of the
/// offset would.
#[must_use]
pub fn gain_jump(rows: &Rows) -> Option<Jump> {
    let &Rows { columns, residuals, course, t_s, excess, has_signs } = rows;
    let n = residuals.len();
    let freedom = n.checked_sub(columns.ncols() + 2).filter(|f| *f >= LEAST_FREEDOM)?;
    let mut scaled = columns.clone();
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    let basis = scaled.qr().q();
    let mut free = DVector::from_column_slice(residuals);
    free -= &basis * basis.tr_mul(&free);
    let all = free.norm_squared();
    let found = step::best(&basis, free.as_slice(), course)?;
    let unit = (all - found.explained).max(f64::MIN_POSITIVE) / freedom as f64 * excess.max(1.0).powi(2);
    let part = if freedom < SHORT { LEAST_PART[0] } else { LEAST_PART[1] };
    if found.explained < LEAST_RATIO * unit || found.explained < part * all {
        return None;
    }
    let middle = 0.5 * (t_s.first()? + t_s.last()?);
    let single = |of: &dyn Fn(usize) -> f64| step::explained(&basis, free.as_slice(), of);
    let mut others = vec![
        single(&|i| (t_s[i] - middle) * course[i]),
        single(&|i| course[i].powi(2)),
        single(&|i| course[i].powi(3)),
        single(&|i| course[i] * course[i].abs()),
    ];
    if has_signs {
        others.extend(step::best(&basis, free.as_slice(), &vec![1.0; n]).map(|s| s.explained));
    }
    let other = others.into_iter().fold(0.0, f64::max);
    (found.explained - other > LEAST_LEAD * unit).then(|| Jump {
        row: found.row,
        relative: found.size,
        std: found.size.abs() * (unit / found.explained).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_written_with_the_digits_that_tell_it() {
        let text = |relative: f64, std: f64| Jump { row: 1, relative, std }.note("x", 60.0).text;
        assert!(text(-2.04e-6, 1.3e-7).starts_with("the gain of x jumps by -0.000204 ± 0.000013 % at 60.0 s"));
        assert!(text(1.0e-3, 2.0e-5).starts_with("the gain of x jumps by +0.1000 ± 0.0020 % at"));
        assert!(text(0.5, 0.0).starts_with("the gain of x jumps by +50.000 ± 0.000 % at"));
    }
}
