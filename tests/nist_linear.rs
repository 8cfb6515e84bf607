//! All eleven NIST StRD sets for linear regression, to twelve digits.
//!
//! The files are read in NIST's own layout from `shared/reference/nist/linear` beside the repository and are not part of it;
//! without them the test says that it was skipped. LRE is the number of correct digits,
//! `-log10(|estimate - certified| / |certified|)`, with the absolute error where the certified value is zero. The data are
//! decimal, the certified values have 15 digits: rounding the data to `f64` alone leaves 13.2 to 15 digits (exact
//! solution of the rounded data), which is the most any program reading `f64` can show.

use std::path::PathBuf;

use calfit::fit::{Design, Limits, linear, polynomial};
use nalgebra::DMatrix;

const NEEDED: f64 = 12.0;

/// How the columns follow from the predictors of a set.
enum Model {
    /// Powers of one predictor up to a degree.
    Powers(usize),
    /// The predictors as they are.
    Plain,
    /// The predictors and a constant.
    WithConstant,
}

const SETS: [(&str, Model); 11] = [
    ("Norris", Model::Powers(1)),
    ("Pontius", Model::Powers(2)),
    ("NoInt1", Model::Plain),
    ("NoInt2", Model::Plain),
    ("Filip", Model::Powers(10)),
    ("Longley", Model::WithConstant),
    ("Wampler1", Model::Powers(5)),
    ("Wampler2", Model::Powers(5)),
    ("Wampler3", Model::Powers(5)),
    ("Wampler4", Model::Powers(5)),
    ("Wampler5", Model::Powers(5)),
];

/// One file: certified `(estimate, standard deviation)` pairs, residual standard deviation, rows `y x1 x2 …`.
struct Set {
    certified: Vec<(f64, f64)>,
    residual_std: f64,
    rows: Vec<Vec<f64>>,
}

struct Estimate {
    coefficients: Vec<f64>,
    std: Vec<f64>,
    residual_std: f64,
}

fn parse(text: &str) -> Set {
    let number = |word: &str| word.parse::<f64>().expect("a number");
    let lines: Vec<&str> = text.lines().collect();
    let mut certified = Vec::new();
    let mut residual_std = f64::NAN;
    for line in &lines[30..55] {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            [name, value, std] if name.starts_with('B') => certified.push((number(value), number(std))),
            ["Standard", "Deviation", value] => residual_std = number(value),
            _ => {}
        }
    }
    let rows = lines[60..]
        .iter()
        .filter(|line| !line.trim().is_empty())
        .map(|line| line.split_whitespace().map(number).collect())
        .collect();
    Set { certified, residual_std, rows }
}

fn estimate(set: &Set, model: &Model) -> Estimate {
    let y: Vec<f64> = set.rows.iter().map(|row| row[0]).collect();
    let limits = Limits::default();
    if let Model::Powers(degree) = model {
        let x: Vec<f64> = set.rows.iter().map(|row| row[1]).collect();
        let fit = polynomial::fit(&x, &y, None, *degree, &limits).expect("a fit");
        let std = fit.covariance().diagonal().map(f64::sqrt);
        return Estimate { coefficients: fit.coefficients, std: std.iter().copied().collect(), residual_std: fit.residual_std };
    }
    let constant = matches!(model, Model::WithConstant);
    let columns = DMatrix::from_fn(y.len(), set.certified.len(), |i, j| match (constant, j) {
        (true, 0) => 1.0,
        (true, j) => set.rows[i][j],
        (false, j) => set.rows[i][j + 1],
    });
    let names = (0..set.certified.len()).map(|j| format!("B{j}")).collect();
    let design = Design::new(names, columns).expect("a design");
    let fit = linear::solve(&design, &DMatrix::from_column_slice(y.len(), 1, &y), None, &limits).expect("a fit");
    Estimate {
        std: fit.std().column(0).iter().copied().collect(),
        coefficients: fit.coefficients.column(0).iter().copied().collect(),
        residual_std: fit.residual_std[0],
    }
}

/// Correct digits, at most the 15 that are certified.
fn lre(estimate: f64, certified: f64) -> f64 {
    let scale = if certified == 0.0 { 1.0 } else { certified.abs() };
    (-((estimate - certified).abs() / scale).log10()).min(15.0)
}

#[test]
fn certified_values_are_met_to_twelve_digits() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/nist/linear");
    if !folder.is_dir() {
        println!("skipped: no NIST data in {}", folder.display());
        return;
    }
    println!("{:10} {:>12} {:>8} {:>12}", "set", "coefficients", "std", "residual std");
    for (name, model) in &SETS {
        let path = folder.join(format!("{name}.dat"));
        let set = parse(&std::fs::read_to_string(&path).expect("a readable set"));
        let estimate = estimate(&set, model);
        assert_eq!(estimate.coefficients.len(), set.certified.len(), "{name}");
        let smallest = |values: &[f64], pick: fn(&(f64, f64)) -> f64| {
            values.iter().zip(&set.certified).map(|(&value, pair)| lre(value, pick(pair))).fold(15.0, f64::min)
        };
        let coefficients = smallest(&estimate.coefficients, |pair| pair.0);
        let std = smallest(&estimate.std, |pair| pair.1);
        let residual_std = lre(estimate.residual_std, set.residual_std);
        println!("{name:10} {coefficients:12.2} {std:8.2} {residual_std:12.2}");
        for digits in [coefficients, std, residual_std] {
            assert!(digits >= NEEDED, "{name}: {digits:.2} digits");
        }
    }
}
