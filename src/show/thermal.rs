//! The report of a thermal analysis: the blocks of BC-MAG-TR-0085 sections 12 and 13 in their order.

use super::document::{Block, Cell, Section, Table, Text, cells};
use super::remarks;
use crate::data::across::RunResidualFields;
use crate::data::units::counted;
use crate::fit::statistics::std_of;
use crate::measure::joint::QUANTITIES;
use crate::measure::thermal::{Corner, Kind, LinAcross, OfKind, QuantityFit, RunsUsed, SamplingAcross, Thermal};
use crate::model::polynomial::TemperaturePolynomial;

/// Title of a section on one kind of runs.
#[must_use]
pub fn title(kind: Kind) -> &'static str {
    match kind {
        Kind::Lin => "Temperature calibration on linear axes",
        Kind::Offset => "Temperature calibration of the sensor offset",
        Kind::Freq => "Temperature calibration of the AC transfer function",
    }
}

/// The sections of the report.
#[must_use]
pub fn sections(thermal: &Thermal, file_name: &str) -> Vec<Section> {
    let mut sections = vec![used(thermal, file_name)];
    match &thermal.of_kind {
        OfKind::Lin(lin) => {
            rotation(&thermal.runs, lin, &mut sections);
            sections.push(family(thermal, "sigma", "Sensitivity σ against temperature", "nT/enT, °C"));
            sections.push(family(thermal, "xi", "Misalignment angles ξ against temperature", "deg, °C"));
            sections.push(family(thermal, "b_or", "Offset and residual field B_or against temperature", "enT, °C"));
            sections.push(quality(thermal).with_all(model_error(&thermal.runs, lin).into_iter().flatten()));
            sections.extend(joint(thermal, lin));
        }
        OfKind::Offset(field) => {
            sections.push(family(thermal, "b_off", "Sensor offset B_off against temperature", "enT, °C"));
            sections.push(quality(thermal));
            sections.push(residual_field(&thermal.runs, field));
        }
        OfKind::Freq(sampling) => {
            let how = if sampling.corner == Corner::Model { "of the response models" } else { "by interpolation (igep)" };
            let title = format!("-3 dB corner frequency {how} against temperature");
            sections.push(family(thermal, "f_3db", &title, "Hz, °C"));
            if sampling.corner == Corner::Model && thermal.quantities.iter().any(|q| q.family() == "f_3db_igep") {
                let title = "-3 dB corner frequency by interpolation (igep) against temperature";
                sections.push(family(thermal, "f_3db_igep", title, "Hz, °C"));
            }
            sections.push(quality(thermal));
            sections.push(sampling_frequency(&thermal.runs, sampling));
        }
    }
    sections.extend(remarks(&thermal.notes));
    sections
}

fn used(thermal: &Thermal, file_name: &str) -> Section {
    let h = &thermal.runs;
    let mut table = Table::new(["calibration parameter file", "sensor temperature", "coil system temperature"]);
    for (i, file) in h.files.iter().enumerate() {
        let coil = Some(h.coil_temperature_degc[i]).filter(|t| t.is_finite());
        table.push(cells![Text::default().code(file), Cell::degc(Some(h.temperature_degc[i])), Cell::degc(coil)]);
    }
    Section::new("Used temperature measurements").with(table).with(Text::from("Thermal parameter file: ").code(file_name).and(
        format!(
            ". Sensor-temperature channel {}, valid from {:.1} to {:.1} °C; beyond it the polynomials are extrapolations.",
            h.channel.as_deref().unwrap_or("not stated"),
            thermal.valid_degc[0],
            thermal.valid_degc[1]
        ),
    ))
}

/// The rotation of the sensor in every run, under a heading of its own where the first run gave one.
fn rotation(runs: &RunsUsed, lin: &LinAcross, sections: &mut Vec<Section>) {
    let r = &lin.rotation;
    if let Some(rho) = &r.initial {
        let words = Text::from("Calculated initial sensor rotation ").code("ρ").and(":");
        sections.push(Section::new("Facility parameter").with(words).with(super::lin::matrix(rho)));
    }
    let mut table = Table::new(["run", "sensor temperature", "λ_x", "μ_y", "ν_z", "standard uncertainty, degrees"]);
    for (i, run) in runs.ids.iter().enumerate() {
        let [lambda, mu, nu] = [r.lambda_x_deg[i], r.mu_y_deg[i], r.nu_z_deg[i]].map(Cell::angle);
        let std = [r.lambda_x_std_deg[i], r.mu_y_std_deg[i], r.nu_z_std_deg[i]];
        let std =
            if std.iter().all(|s| s.is_finite()) { std.map(|s| format!("{s:.1e}")).join(", ") } else { "not known".to_owned() };
        table.push(cells![run, Cell::degc(Some(runs.temperature_degc[i])), lambda, mu, nu, std]);
    }
    if let Some(section) = sections.last_mut() {
        section.push("Rotation of the sensor in every run:");
        section.push(table);
    }
}

fn residual_field(runs: &RunsUsed, f: &RunResidualFields) -> Section {
    let axes = if f.seen_along.is_empty() {
        String::new()
    } else {
        let axes: Vec<String> = ["X", "Y", "Z"].iter().zip(&f.seen_along).map(|(m, c)| format!("{m}_m = {c}_c")).collect();
        format!(" The axes of this table are {}.", axes.join(", "))
    };
    let mut table = Table::new(["run", "B_res x, enT", "B_res y, enT", "B_res z, enT"]);
    for (i, run) in runs.ids.iter().enumerate() {
        let [x, y, z] = [f.x_ent[i], f.y_ent[i], f.z_ent[i]].map(|v| Cell::fixed(v, 3));
        table.push(cells![run, x, y, z]);
    }
    Section::new("Coil system residual field")
        .with(format!("In the coordinates of the sensor in its normal position, not in coil coordinates.{axes}"))
        .with(table)
}

fn sampling_frequency(runs: &RunsUsed, sampling: &SamplingAcross) -> Section {
    let section = Section::new("Instrument sampling frequency");
    let [Some(mean), Some(std)] = sampling.means_hz() else {
        return section.with("The files tell no sampling frequency.");
    };
    let mut table = Table::new(["run", "sensor temperature", "f_s, Hz"]);
    for (i, run) in runs.ids.iter().enumerate() {
        let temperature = Cell::degc(Some(runs.temperature_degc[i]));
        table.push(cells![run, temperature, Cell::uncertain(sampling.f_s_hz[i], sampling.f_s_std_hz[i])]);
    }
    section.with(table).with(format!("Mean sample rate {mean:.6} Hz, mean standard uncertainty of the sample rate {std:.1e} Hz."))
}

/// Variance of a coefficient, of both types where type B is known; nan where it is not known.
fn variance(fit: &QuantityFit, k: usize) -> f64 {
    let of_runs = fit.polynomial.covariance.get((k, k)).copied().unwrap_or(f64::NAN);
    of_runs + fit.covariance_b().map_or(0.0, |b| b[(k, k)])
}

/// Coefficients with their standard uncertainties, and how the order was found.
fn family(thermal: &Thermal, family: &str, title: &str, units: &str) -> Section {
    let quantities: Vec<&QuantityFit> = thermal.quantities.iter().filter(|q| q.family() == family).collect();
    let section = Section::new(title);
    if quantities.is_empty() {
        return section.with("Not determined.");
    }
    let most = quantities.iter().map(|q| q.polynomial.order()).max().unwrap_or(0);
    let mut table = Table::new(std::iter::once("quantity".to_owned()).chain((0..=most).map(|k| format!("T^{k}"))));
    for q in &quantities {
        let cell = |k: usize| {
            let value = q.polynomial.coefficients.get(k);
            value.map_or(Cell::Missing(""), |value| Cell::scientific(*value, variance(q, k).sqrt()))
        };
        table.push(std::iter::once((&q.found.name).into()).chain((0..=most).map(cell)).collect());
    }
    section
        .with(
            Text::default()
                .code("p(T) = Σ p_k T^k")
                .and(format!(" [{units}], standard uncertainties, with those of the facility where its file states them:")),
        )
        .with(table)
        .with("How the orders were found; AICc / leave-one-out error of every order that was compared:")
        .with(orders(&quantities))
}

fn orders(quantities: &[&QuantityFit]) -> Table {
    let orders = quantities.iter().map(|q| q.found.aicc.len().max(q.found.leave_one_out.len())).max().unwrap_or(0);
    let head = ["quantity", "order", "chosen by"].map(str::to_owned);
    let mut table = Table::new(head.into_iter().chain((0..orders).map(|k| format!("order {k}"))));
    for q in quantities {
        let mut row = cells![&q.found.name, q.polynomial.order(), q.found.order_by.to_string()];
        for k in 0..orders {
            let cell = |list: &[f64], form: &dyn Fn(f64) -> String| {
                list.get(k).filter(|v| v.is_finite()).map_or_else(|| "-".to_owned(), |v| form(*v))
            };
            let both = [cell(&q.found.aicc, &|v| format!("{v:.1}")), cell(&q.found.leave_one_out, &|v| format!("{v:.1e}"))];
            row.push(both.join(" / ").into());
        }
        table.push(row);
    }
    table
}

fn quality(thermal: &Thermal) -> Section {
    let mut table = Table::new([
        "quantity",
        "unit",
        "runs",
        "valid, °C",
        "most negative error",
        "most positive error",
        "widened by",
        "95 % factor",
    ]);
    for q in &thermal.quantities {
        table.push(cells![
            &q.found.name,
            &q.found.unit,
            q.runs.len(),
            format!("{:.1} to {:.1}", q.polynomial.valid_degc[0], q.polynomial.valid_degc[1]),
            Cell::exponent(q.found.min_error, 2),
            Cell::exponent(q.found.max_error, 2),
            Cell::fixed(q.found.widened, 1),
            Cell::fixed(q.found.factor_95, 2).or("-"),
        ]);
    }
    Section::new("Model quality")
        .with(
            "Value of a run minus polynomial. Where the runs scatter by more than their own uncertainties, the scatter is added to these (the warning names it \
             and the factor); where the order was chosen, the uncertainty is that of the orders that it might be as well. The table has the product. An interval of 95 % is the standard uncertainty times the factor, which is larger \
             where the scatter of a few runs told the uncertainty:",
        )
        .with(table)
}

fn model_error(runs: &RunsUsed, lin: &LinAcross) -> Option<[Block; 2]> {
    let error = lin.model_error.as_ref()?;
    let mut table = Table::new(["run", "sensor temperature", "X, nT", "Y, nT", "Z, nT"]);
    for (i, run) in runs.ids.iter().enumerate() {
        let mut row = cells![run, Cell::degc(Some(runs.temperature_degc[i]))];
        row.extend((0..3).map(|axis| format!("{:.3} to {:.3}", error.min_nt[i][axis], error.max_nt[i][axis]).into()));
        table.push(row);
    }
    let words =
        "Minimum and maximum error of the model against temperature, applied field minus modelled measurement, coil axes:";
    Some([words.into(), table.into()])
}

fn joint(thermal: &Thermal, lin: &LinAcross) -> Option<Section> {
    let joint = lin.joint.as_ref()?;
    let mut table = Table::new(["quantity", "k", "two steps", "joint fit", "difference, standard uncertainties"]);
    for (name, polynomial) in QUANTITIES.into_iter().zip(&joint.polynomials) {
        // Both rest on the same runs and the same facility, so that only what the scatter tells may make them differ.
        let std = |p: &TemperaturePolynomial, k: usize| std_of(p.covariance.get((k, k)).copied().unwrap_or(f64::NAN));
        let two_steps = thermal.quantity(name).map(|q| &q.polynomial);
        for (k, value) in polynomial.coefficients.iter().enumerate() {
            let two = two_steps.and_then(|p| p.coefficients.get(k)).copied().unwrap_or(f64::NAN);
            let std_joint = std(polynomial, k);
            table.push(cells![
                name,
                k,
                Cell::scientific(two, two_steps.map_or(f64::NAN, |p| std(p, k))),
                Cell::scientific(*value, std_joint),
                Cell::signed((value - two) / std_joint, 1),
            ]);
        }
    }
    let section = Section::new("Joint fit").with(format!(
        "The temperature-dependent model fitted to the plateaus of all runs at once, with the temperature at every plateau; rotation and \
         offset of every run are free. Chi-square {:.0} with {} degrees of freedom, {} evaluations; uncertainties widened by {:.1}. \
         Where chi-square is far below the degrees of freedom, the plateaus agree better than their stated noise lets expect; uncertainties are \
         not narrowed for it, so that those of this fit are then larger than those of the polynomials above.",
        joint.chi2, joint.dof, joint.evaluations, joint.inflation_within
    ));
    Some(section.with(table))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(thermal: &Thermal) -> String {
    let h = &thermal.runs;
    let orders: Vec<String> = thermal.quantities.iter().map(|q| format!("{} {}", q.found.name, q.polynomial.order())).collect();
    format!(
        "{} {}{}  {}, {:.1} to {:.1} °C\n  orders {}\n",
        h.sensor,
        h.mode,
        h.location.suffix(),
        counted(h.ids.len() as u64, &format!("{} run", thermal.kind().name())),
        thermal.valid_degc[0],
        thermal.valid_degc[1],
        orders.join(", ")
    )
}
