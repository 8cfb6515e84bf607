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
    let even = (all - found.explained).max(f64::MIN_POSITIVE) / freedom as f64;
    let unit = even.max(where_it_counts(&basis, &free, course, found.row)) * excess.max(1.0).powi(2);
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

/// Variance of what a jump leaves where the course is large, which is where the jump shows: a source whose settings are wrong by a part of
/// themselves scatters there, and nowhere else.
fn where_it_counts(basis: &DMatrix<f64>, free: &DVector<f64>, course: &[f64], row: usize) -> f64 {
    let mut later = DVector::from_fn(course.len(), |i, _| if i < row { 0.0 } else { course[i] });
    later -= basis * basis.tr_mul(&later);
    later /= later.norm();
    let left = free - &later * later.dot(free);
    let taken = |i: usize| basis.row(i).norm_squared() + later[i].powi(2);
    let (mut squares, mut weights) = (0.0, 0.0);
    for (i, c) in course.iter().enumerate() {
        squares += (c * left[i]).powi(2);
        weights += c * c * (1.0 - taken(i)).max(0.0);
    }
    if weights > 0.0 { squares / weights } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    /// Jumps found in 200 runs of 37 rows, ten of which have a course of both signs; scatter in all rows and in proportion to the course, and a jump
    /// in the middle of these ten.
    fn found(even: f64, of_course: f64, jump: f64) -> usize {
        let course: Vec<f64> =
            (0..37).map(|i| if i < 10 { [0.2, 1.0, 0.4, 0.8, 0.6][i / 2] * [1.0, -1.0][i % 2] } else { 0.0 }).collect();
        let columns = DMatrix::from_fn(37, 4, |i, j| if j == 0 { course[i] } else { (i as f64 / 18.0 - 1.0).powi(j as i32 - 1) });
        let basis = columns.clone().qr().q();
        let t_s: Vec<f64> = (0..37).map(f64::from).collect();
        let mut random = Random::seeded(3);
        let run = |_: &usize| {
            let mut residuals = DVector::from_fn(37, |i, _| {
                let later = if i < 5 { 0.0 } else { jump };
                even * random.gaussian() + course[i] * (later + of_course * random.gaussian())
            });
            residuals -= &basis * basis.tr_mul(&residuals);
            let rows = Rows {
                columns: &columns,
                residuals: residuals.as_slice(),
                course: &course,
                t_s: &t_s,
                excess: 1.0,
                has_signs: true,
            };
            gain_jump(&rows).is_some()
        };
        (0..200).filter(run).count()
    }

    #[test]
    fn a_source_that_scatters_in_proportion_to_its_settings_does_not_jump() {
        assert!(found(0.0028, 0.04, 0.0) <= 2, "{}", found(0.0028, 0.04, 0.0));
        assert!(found(0.0028, 0.0, 0.1) > 190, "{}", found(0.0028, 0.0, 0.1));
    }

    #[test]
    fn a_jump_is_written_with_the_digits_that_tell_it() {
        let text = |relative: f64, std: f64| Jump { row: 1, relative, std }.note("x", 60.0).text;
        assert!(text(-2.04e-6, 1.3e-7).starts_with("the gain of x jumps by -0.000204 ± 0.000013 % at 60.0 s"));
        assert!(text(1.0e-3, 2.0e-5).starts_with("the gain of x jumps by +0.1000 ± 0.0020 % at"));
        assert!(text(0.5, 0.0).starts_with("the gain of x jumps by +50.000 ± 0.000 % at"));
    }
}
