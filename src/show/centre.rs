//! The report of temperature polynomials that were taken to the centre of the coil system.

use super::document::{Cell, Section, Table, Text, cells};
use super::{degc, remarks, triple};
use crate::data::across::PairedCalibration;
use crate::data::units::COMPONENTS;
use crate::measure::centre::AtCentre;

const PAIRS: [&str; 3] = ["xy", "xz", "yz"];

/// Its title.
#[must_use]
pub fn title(result: &AtCentre) -> String {
    format!("Temperature calibration at the centre of the coil system, {} {}", result.beside.sensor, result.beside.mode)
}

/// The sections of the report.
#[must_use]
pub fn sections(result: &AtCentre, file_name: &str) -> Vec<Section> {
    let mut sections = vec![pair(result, file_name), geometry(result), polynomials(result)];
    if let Some(field) = result.offset.as_ref().map(|o| &o.residual) {
        let std = field.b_res_std_ent.unwrap_or([f64::NAN; 3]);
        sections.push(Section::new("Residual field").with(format!(
            "B_res = {} enT, from the offset of {} at {}.",
            triple(&field.b_res_ent, &std),
            field.file,
            degc(Some(field.temperature_degc))
        )));
    }
    sections.extend(remarks(&result.notes));
    sections
}

fn pair(result: &AtCentre, file_name: &str) -> Section {
    let row = |name: &str, run: &PairedCalibration| {
        let three = |v: [f64; 3]| v.map(|v| format!("{v:.6}")).join(", ");
        cells![name, &run.file, Cell::degc(run.temperature_degc), three(run.sigma), three(run.xi_deg)]
    };
    Section::new("Pair of linear calibrations")
        .with(
            Text::from(format!("T1 = {}. Parameter file: ", degc(Some(result.reference_degc))))
                .code(file_name)
                .and(". ω is in the Rosetta convention: the matrix Q(ξ) of direction cosines."),
        )
        .with(
            Table::new(["", "file", "temperature", "σ x, y, z, nT/enT", "ξ xy, xz, yz, deg"])
                .with_rows([row("centre", &result.centre), row("off-centre", &result.at_reference)]),
        )
}

fn geometry(result: &AtCentre) -> Section {
    let mut table = Table::new(["component", "k", "K⁻¹ row, x", "K⁻¹ row, y", "K⁻¹ row, z"]);
    for i in 0..3 {
        let mut row = cells![COMPONENTS[i], Cell::uncertain(result.transfer.k[i], result.k_std.map_or(f64::NAN, |s| s[i]))];
        row.extend((0..3).map(|c| Cell::signed(result.transfer.k_inverse[(i, c)], 7)));
        table.push(row);
    }
    Section::new("Geometry factors")
        .with(Text::words_and_code(["", "k = σ¹(T1)/σ⁰(T1)", ", ", "K = ω⁰(T1)⁻¹ ω¹(T1)", "."]))
        .with(table)
}

fn polynomials(result: &AtCentre) -> Section {
    let offsets = result.offset.as_ref().map(|o| &o.b_off_ent);
    let quantities =
        [("sigma", COMPONENTS, Some(&result.sigma)), ("xi", PAIRS, Some(&result.xi_deg)), ("b_off", COMPONENTS, offsets)];
    let mut table = Table::new(["quantity", "k", "coefficient of T^k"]);
    for (family, components, polynomials) in quantities {
        for (component, polynomial) in components.iter().zip(polynomials.into_iter().flatten()) {
            let name = format!("{family}_{component}");
            for (k, p) in polynomial.coefficients.iter().enumerate() {
                let std = polynomial.covariance.get((k, k)).map_or(f64::NAN, |c| c.sqrt());
                table.push(cells![&name, k, Cell::scientific(*p, std)]);
            }
        }
    }
    let [low, high] = result.beside.valid_degc;
    Section::new("Polynomials at the centre").with(format!("They hold from {low:.1} to {high:.1} °C.")).with(table)
}

/// The result in two lines for the terminal.
#[must_use]
pub fn summary(result: &AtCentre) -> String {
    let k = triple(&result.transfer.k, &result.k_std.unwrap_or([f64::NAN; 3]));
    format!(
        "{}  {} {}, centre of the coil system, T1 {:.2} °C\n  k  {k}\n",
        result.beside.runs.first().map_or("", String::as_str),
        result.beside.sensor,
        result.beside.mode,
        result.reference_degc
    )
}
