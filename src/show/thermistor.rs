//! The report of a thermistor's calibration table.

use super::document::{Cell, Section, Table, Text, cells};
use super::{number, remarks, value};
use crate::data::units::scientific_with_uncertainty;
use crate::measure::thermistor::Thermistor;
use std::fmt::Write;

/// Its title.
#[must_use]
pub fn title(thermistor: &Thermistor) -> String {
    format!("Thermistor calibration, table {}", thermistor.polynomial.table)
}

/// The sections of the report.
#[must_use]
pub fn sections(thermistor: &Thermistor, file_name: &str) -> Vec<Section> {
    let p = thermistor;
    let mut sections = vec![polynomial(p, file_name), orders(p)];
    if let Some(c) = &p.compared {
        let list: Vec<String> = c.coefficients.iter().map(|v| format!("{v}")).collect();
        sections.push(Section::new("Comparison").with(format!(
            "The given polynomial ({}) leaves up to {:.4} °C, rms {:.4} °C; the best one of its order up to {:.4} °C. They differ by up to \
             {:.4} °C at the rows of the table.",
            list.join(", "),
            c.residual_max_degc,
            c.residual_rms_degc,
            c.best_max_degc,
            c.difference_max_degc
        )));
    }
    if let Some(r) = &p.reference {
        let slope = match (r.slope, r.slope_std) {
            (Some(v), Some(s)) => format!(" The difference changes by {} per K.", scientific_with_uncertainty(v, s)),
            _ => String::new(),
        };
        let offset = format!(
            "T_O = {} °C, polynomial minus reference, from {} readings between {} and {} °C: ",
            value(r.offset_degc, r.offset_std_degc.unwrap_or(f64::NAN)),
            r.readings,
            r.range_degc[0],
            r.range_degc[1],
        );
        sections.push(
            Section::new("Reference thermometer").with(Text::from(offset).code("T_c = T_r - T_O").and(format!(".{slope}"))),
        );
    }
    sections.push(rows(p));
    sections.extend(remarks(&p.notes));
    sections
}

fn polynomial(p: &Thermistor, file_name: &str) -> Section {
    let mut table = Table::new(["k", "c_k, °C per unit^k"]);
    for (k, (c, std)) in p.polynomial.coefficients.iter().zip(&p.polynomial.coefficients_std).enumerate() {
        table.push(cells![k, Cell::scientific(*c, *std)]);
    }
    let holds = format!(
        ", s in {}, order {} ({}). It holds from {} to {} {}, {} to {} °C. Parameter file: ",
        p.polynomial.signal_unit,
        p.polynomial.order,
        p.polynomial.reason,
        p.polynomial.valid_signal[0],
        p.polynomial.valid_signal[1],
        p.polynomial.signal_unit,
        p.polynomial.valid_degc[0],
        p.polynomial.valid_degc[1],
    );
    Section::new("Polynomial").with(Text::default().code("T = Σ c_k s^k").and(holds).code(file_name).and(".")).with(table).with(
        format!(
            "It leaves up to {:.4} °C, standard deviation {} °C.",
            p.polynomial.residual_max_degc,
            number(p.polynomial.residual_std_degc, 4)
        ),
    )
}

fn orders(p: &Thermistor) -> Section {
    let mut table = Table::new(["order", "largest residual, °C", "standard deviation, °C", "leave one out, °C", "AICc"]);
    for o in &p.orders {
        table.push(cells![
            o.order,
            Cell::fixed(o.residual_max_degc, 4),
            Cell::fixed(o.residual_std_degc, 4),
            Cell::fixed(o.leave_one_out_degc, 4),
            o.aicc.map_or(Cell::Missing("-"), |a| Cell::fixed(a, 1)),
        ]);
    }
    let within = p
        .polynomial
        .order_within
        .map_or_else(|| "No order reaches".to_owned(), |o| format!("Order {o} is the lowest that reaches"));
    Section::new("Orders").with(table).with(format!("{within} {} °C at every row.", p.polynomial.within_degc))
}

fn rows(p: &Thermistor) -> Section {
    let mut table = Table::new(["T, °C", "signal", "residual, °C", "uncertainty, °C", "given polynomial, °C"]);
    for r in &p.row {
        table.push(cells![
            Cell::exact(r.t_degc),
            Cell::exact(r.signal),
            Cell::signed(r.residual_degc, 4),
            Cell::fixed(r.std_degc, 4),
            r.compared_residual_degc.map_or(Cell::Missing("-"), |v| Cell::signed(v, 4)),
        ]);
    }
    Section::new("Table").with(table)
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(thermistor: &Thermistor) -> String {
    let p = thermistor;
    let list: Vec<String> = p.polynomial.coefficients.iter().map(|c| format!("{c:.9e}")).collect();
    let mut out = format!(
        "{}  order {}, {} rows, up to {:.4} °C\n  c      {}  °C/{}^k\n",
        p.polynomial.table,
        p.polynomial.order,
        p.row.len(),
        p.polynomial.residual_max_degc,
        list.join(", "),
        p.polynomial.signal_unit
    );
    if let Some(c) = &p.compared {
        let _ = writeln!(out, "  given  up to {:.4} °C, best of its order {:.4} °C", c.residual_max_degc, c.best_max_degc);
    }
    if let Some(order) = p.polynomial.order_within {
        let _ = writeln!(out, "  order {order} is the lowest within {} °C", p.polynomial.within_degc);
    }
    if let Some(r) = &p.reference {
        let _ = writeln!(out, "  T_O    {}  °C", value(r.offset_degc, r.offset_std_degc.unwrap_or(f64::NAN)));
    }
    out
}
