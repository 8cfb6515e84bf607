//! The report of temperature polynomials that were taken to the centre of the coil system.

use super::document::{Cell, Section, Table, Text, cells};
use super::{degc, remarks, triple};
use crate::data::units::COMPONENTS;
use crate::files::parameter::{Body, CentreRun, Tcf};

const PAIRS: [&str; 3] = ["xy", "xz", "yz"];

/// Its title.
#[must_use]
pub fn title(tcf: &Tcf) -> String {
    format!("Temperature calibration at the centre of the coil system, {} {}", tcf.sensor, tcf.mode)
}

/// The sections of the report.
#[must_use]
pub fn sections(tcf: &Tcf) -> Vec<Section> {
    let mut sections = vec![pair(tcf), geometry(tcf), polynomials(tcf)];
    if let Some(field) = &tcf.residual_field {
        let std = field.b_res_std_ent.unwrap_or([f64::NAN; 3]);
        sections.push(Section::new("Residual field").with(format!(
            "B_res = {} enT, from the offset of {} at {}.",
            triple(&field.b_res_ent, &std),
            field.file,
            degc(Some(field.temperature_degc))
        )));
    }
    sections.extend(remarks(&tcf.warnings));
    sections
}

fn pair(tcf: &Tcf) -> Section {
    let row = |name: &str, run: &CentreRun| {
        let three = |v: [f64; 3]| v.map(|v| format!("{v:.6}")).join(", ");
        cells![name, &run.file, Cell::degc(run.temperature_degc), three(run.sigma), three(run.xi_deg)]
    };
    Section::new("Pair of linear calibrations")
        .with(
            Text::from(format!("T1 = {}. Parameter file: ", degc(Some(tcf.reference_degc))))
                .code(tcf.file_name())
                .and(". ω is in the Rosetta convention: the matrix Q(ξ) of direction cosines."),
        )
        .with(
            Table::new(["", "file", "temperature", "σ x, y, z, nT/enT", "ξ xy, xz, yz, deg"])
                .with_rows([row("centre", &tcf.centre), row("off-centre", &tcf.off_centre.at_reference)]),
        )
}

fn geometry(tcf: &Tcf) -> Section {
    let mut table = Table::new(["component", "k", "K⁻¹ row, x", "K⁻¹ row, y", "K⁻¹ row, z"]);
    for i in 0..3 {
        let mut row = cells![COMPONENTS[i], Cell::uncertain(tcf.k[i], tcf.k_std.map_or(f64::NAN, |s| s[i]))];
        row.extend((0..3).map(|c| Cell::signed(tcf.k_inverse[i][c], 7)));
        table.push(row);
    }
    Section::new("Geometry factors")
        .with(Text::words_and_code(["", "k = σ¹(T1)/σ⁰(T1)", ", ", "K = ω⁰(T1)⁻¹ ω¹(T1)", "."]))
        .with(table)
}

fn polynomials(tcf: &Tcf) -> Section {
    let quantities = [
        ("sigma", COMPONENTS, [&tcf.sigma_x, &tcf.sigma_y, &tcf.sigma_z]),
        ("xi", PAIRS, [&tcf.xi_xy, &tcf.xi_xz, &tcf.xi_yz]),
        ("b_off", COMPONENTS, [&tcf.b_off_x, &tcf.b_off_y, &tcf.b_off_z]),
    ];
    let mut table = Table::new(["quantity", "k", "coefficient of T^k"]);
    for (family, components, polynomials) in quantities {
        for (component, polynomial) in components.iter().zip(polynomials) {
            let name = format!("{family}_{component}");
            for (k, p) in polynomial.iter().enumerate() {
                let std = tcf.covariance.get(&name).map_or(f64::NAN, |c| c[k][k].sqrt());
                table.push(cells![&name, k, Cell::scientific(*p, std)]);
            }
        }
    }
    let [low, high] = tcf.valid_degc;
    Section::new("Polynomials at the centre").with(format!("They hold from {low:.1} to {high:.1} °C.")).with(table)
}

/// The result in two lines for the terminal.
#[must_use]
pub fn summary(tcf: &Tcf) -> String {
    let k = tcf.k.map(|k| format!("{k:.6}")).join(", ");
    format!(
        "{}  {} {}, centre of the coil system, T1 {:.2} °C\n  k  {k}\n",
        tcf.runs.first().map_or("", String::as_str),
        tcf.sensor,
        tcf.mode,
        tcf.reference_degc
    )
}
