//! The report of a thermistor's calibration table.

use super::{number, remarks, table, value};
use crate::data::units::scientific_with_uncertainty;
use crate::files::parameter::Body;
use crate::measure::thermistor::Thermistor;
use std::fmt::Write;

/// Its title.
#[must_use]
pub fn title(thermistor: &Thermistor) -> String {
    format!("Thermistor calibration, table {}", thermistor.parameters.table)
}

/// The blocks of the report with headings of the given level.
#[must_use]
pub fn sections(thermistor: &Thermistor, level: usize) -> String {
    let p = &thermistor.parameters;
    let head = "#".repeat(level);
    let mut rows = vec![["k", "c_k, °C per unit^k"].map(str::to_owned).to_vec()];
    for (k, (c, std)) in p.coefficients.iter().zip(&p.coefficients_std).enumerate() {
        rows.push(vec![k.to_string(), scientific_with_uncertainty(*c, *std)]);
    }
    let mut out = format!(
        "{head} Polynomial\n\n`T = Σ c_k s^k`, s in {}, order {} ({}). It holds from {} to {} {}, {} to {} °C. Parameter file: `{}`.\n\n{}\nIt \
         leaves up to {:.4} °C, standard deviation {} °C.\n\n",
        p.signal_unit,
        p.order,
        p.reason,
        p.valid_signal[0],
        p.valid_signal[1],
        p.signal_unit,
        p.valid_degc[0],
        p.valid_degc[1],
        p.file_name(),
        table(&rows),
        p.residual_max_degc,
        number(p.residual_std_degc, 4),
    );
    let mut rows = vec![
        ["order", "largest residual, °C", "standard deviation, °C", "leave one out, °C", "AICc"].map(str::to_owned).to_vec(),
    ];
    for o in &p.orders {
        rows.push(vec![
            o.order.to_string(),
            number(o.residual_max_degc, 4),
            number(o.residual_std_degc, 4),
            number(o.leave_one_out_degc, 4),
            o.aicc.map_or_else(|| "-".to_owned(), |a| format!("{a:.1}")),
        ]);
    }
    let within =
        p.order_within.map_or_else(|| "No order reaches".to_owned(), |o| format!("Order {o} is the lowest that reaches"));
    let _ = writeln!(out, "{head} Orders\n\n{}\n{within} {} °C at every row.\n", table(&rows), p.within_degc);
    if let Some(c) = &p.compared {
        let list: Vec<String> = c.coefficients.iter().map(|v| format!("{v}")).collect();
        let _ = writeln!(
            out,
            "{head} Comparison\n\nThe given polynomial ({}) leaves up to {:.4} °C, rms {:.4} °C; the best one of its order up to {:.4} °C. They differ by \
             up to {:.4} °C at the rows of the table.\n",
            list.join(", "),
            c.residual_max_degc,
            c.residual_rms_degc,
            c.best_max_degc,
            c.difference_max_degc
        );
    }
    if let Some(r) = &p.reference {
        let slope = match (r.slope, r.slope_std) {
            (Some(v), Some(s)) => format!(" The difference changes by {} per K.", scientific_with_uncertainty(v, s)),
            _ => String::new(),
        };
        let _ = writeln!(
            out,
            "{head} Reference thermometer\n\nT_O = {} °C, polynomial minus reference, from {} readings between {} and {} °C: `T_c = T_r - T_O`.{slope}\n",
            value(r.offset_degc, r.offset_std_degc.unwrap_or(f64::NAN)),
            r.readings,
            r.range_degc[0],
            r.range_degc[1],
        );
    }
    let mut rows =
        vec![["T, °C", "signal", "residual, °C", "uncertainty, °C", "given polynomial, °C"].map(str::to_owned).to_vec()];
    for r in &p.row {
        rows.push(vec![
            r.t_degc.to_string(),
            r.signal.to_string(),
            format!("{:+.4}", r.residual_degc),
            number(r.std_degc, 4),
            r.compared_residual_degc.map_or_else(|| "-".to_owned(), |v| format!("{v:+.4}")),
        ]);
    }
    let _ = writeln!(out, "{head} Table\n\n{}", table(&rows));
    out.push_str(&remarks(&p.warnings, level));
    out
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(thermistor: &Thermistor) -> String {
    let p = &thermistor.parameters;
    let list: Vec<String> = p.coefficients.iter().map(|c| format!("{c:.6}")).collect();
    let mut out = format!(
        "{}  order {}, {} rows, up to {:.4} °C\n  c      {}  °C/{}^k\n",
        p.table,
        p.order,
        p.row.len(),
        p.residual_max_degc,
        list.join(", "),
        p.signal_unit
    );
    if let Some(c) = &p.compared {
        let _ = writeln!(out, "  given  up to {:.4} °C, best of its order {:.4} °C", c.residual_max_degc, c.best_max_degc);
    }
    if let Some(order) = p.order_within {
        let _ = writeln!(out, "  order {order} is the lowest within {} °C", p.within_degc);
    }
    if let Some(r) = &p.reference {
        let _ = writeln!(out, "  T_O    {}  °C", value(r.offset_degc, r.offset_std_degc.unwrap_or(f64::NAN)));
    }
    out
}
