//! The report of an offset measurement: the blocks of BC-MAG-TR-0085 section 3.4.2 in their order.

use super::document::{Cell, Section, Table, Text, cells};
use super::{known_effects, not_used, remarks, run_line, triple, used_file, value};
use crate::data::offset::OffsetTypeB;
use crate::data::units::{COMPONENTS, with_uncertainty};
#[cfg(feature = "tables")]
use crate::files::parameter::Opf;
use crate::measure::offset::Offset;

/// The coil axes, and the sensor axes beside them.
const AXES: [&str; 3] = ["X", "Y", "Z"];

/// The sections of the report.
#[must_use]
pub fn sections(offset: &Offset, file_name: &str) -> Vec<Section> {
    let p = offset;
    let principle = Section::new("Principle").with(Text::words_and_code([
        "Measurements in a normal and a turned position tell the offset of the sensor and the residual field of the coil system apart: ",
        "B_off = (B_normal + B_turned)/2",
        ", ",
        "B_res = (B_normal - B_turned)/2",
        ". Where positions are not turned by exactly 180° the response measured in the run itself takes their place.",
    ]));
    let mut sections = vec![used_file(&p.found.run, file_name), principle, offsets(p), residual_field(p), visits(p), quality(p)];
    sections.extend(not_used(&p.dropped));
    sections.extend(remarks(&p.notes));
    sections
}

fn offsets(p: &Offset) -> Section {
    let mut table = Table::new(["component", "offset, enT ± standard uncertainty", "positions"]);
    for i in 0..3 {
        let positions: Vec<String> = p.found.method.positions[i].iter().map(u32::to_string).collect();
        let positions = if positions.is_empty() {
            "none".to_owned()
        } else {
            format!("{} ({})", positions.join(", "), p.found.method.component[i])
        };
        table.push(cells![
            COMPONENTS[i],
            Cell::uncertain(p.values.offset_ent[i], p.found.std_of_both(&p.values).offset_ent[i]),
            positions
        ]);
    }
    let mut section = Section::new("Sensor offsets").with(table);
    section.blocks.extend(p.model.as_ref().map(|model| known_effects(model).into()));
    let section = match &p.found.of_facility {
        Some(b) => type_b(p, b, section),
        None => section,
    };
    let Some(scaled) = &p.found.scaled else { return section };
    let row = |i: usize| {
        let offset = Cell::uncertain(scaled.offset_nt[i], scaled.offset_std_nt[i]);
        cells![COMPONENTS[i], offset, Cell::uncertain(scaled.residual_nt[i], scaled.residual_std_nt[i])]
    };
    section
        .with(Text::words_and_code(["With the sensitivities of ", &scaled.cpf, ":"]))
        .with(Table::new(["component", "offset, nT", "residual field, nT"]).with_rows((0..3).map(row)))
}

/// What the facility adds, and where it cancels.
fn type_b(p: &Offset, b: &OffsetTypeB, section: Section) -> Section {
    let families = [
        ("B_off", "enT", COMPONENTS, [p.values.offset_std_ent, b.std_b.offset_ent, b.std_combined.offset_ent]),
        ("B_res", "enT", COMPONENTS, [p.values.residual_std_ent, b.std_b.residual_ent, b.std_combined.residual_ent]),
        (
            "B_res, coil axes",
            "nT",
            AXES,
            [p.values.residual_coil_std_nt, b.std_b.residual_coil_nt, b.std_combined.residual_coil_nt],
        ),
    ];
    let mut table = Table::new(["quantity", "type A", "type B, facility", "combined"]);
    for (name, unit, axes, stds) in families {
        for i in 0..3 {
            let [type_a, of_facility, combined] = stds.map(|std| format!("{:.2e}", std[i]));
            table.push(cells![format!("{name} {}, {unit}", axes[i]), type_a, of_facility, combined]);
        }
    }
    let covers = p.found.method.std_b_covers.as_ref().map_or_else(String::new, |covers| format!("Type B covers {covers}."));
    section.with(table).with(covers)
}

fn residual_field(p: &Offset) -> Section {
    let mut table = Table::new(["component", "B_res, enT ± standard uncertainty", "seen along"]);
    for i in 0..3 {
        let residual = Cell::uncertain(p.values.residual_ent[i], p.found.std_of_both(&p.values).residual_ent[i]);
        table.push(cells![COMPONENTS[i], residual, format!("{}_m = {}_c", AXES[i], p.found.method.normal_axis[i])]);
    }
    let mut section = Section::new("Residual field of the coil system").with(table).with(format!(
        "Remark: the residual field is given in the coordinates of the sensor in its normal position, not in coil coordinates. In coil \
         coordinates it is X {}, Y {}, Z {} nT.",
        value(p.values.residual_coil_nt[0], p.found.std_of_both(&p.values).residual_coil_nt[0]),
        value(p.values.residual_coil_nt[1], p.found.std_of_both(&p.values).residual_coil_nt[1]),
        value(p.values.residual_coil_nt[2], p.found.std_of_both(&p.values).residual_coil_nt[2]),
    ));
    if let Some(drift) = &p.found.drift {
        let rates: Vec<String> = (0..3)
            .map(|i| format!("{} {}", COMPONENTS[i], with_uncertainty(drift.ent_per_h[i], drift.std_ent_per_h[i])))
            .collect();
        section.push(format!(
            "Positions repeat, so a linear drift was estimated with the offsets: {} enT/h. The offsets hold for {:.0} s after the start.",
            rates.join(", "),
            drift.reference_s
        ));
    }
    section
}

fn visits(p: &Offset) -> Section {
    let mut table = Table::new(["position", "axes X_m Y_m Z_m", "time, s", "blocks", "x, enT", "y, enT", "z, enT"]);
    for v in &p.found.visit {
        let mut row = cells![v.position, v.axes.join(" "), format!("{:.0} to {:.0}", v.time_s[0], v.time_s[1]), v.blocks];
        row.extend((0..3).map(|i| Cell::uncertain(v.reading_ent[i], v.std_ent[i])));
        table.push(row);
    }
    Section::new("Readings at zero applied field").with(table)
}

fn quality(p: &Offset) -> Section {
    let q = &p.found.quality;
    let samples = q.raw_std_ent.as_ref().map_or_else(
        || "The file brings plateau means without standard deviations.".to_owned(),
        |s| {
            let mean = s.mean.map(|v| format!("{v:.3}"));
            format!("Mean standard deviation of the samples within a plateau {} enT (x, y, z).", mean.join(", "))
        },
    );
    let scatter = q.plateau_std_ent.map(|v| format!("{v:.3}"));
    Section::new("Quality").with(format!(
        "{} of {} blocks used, {} samples lost. {samples} Standard deviation of a plateau mean {} enT. The zero levels of the visits have \
         chi-square {:.1} with {} degrees of freedom against one offset and one residual field. Standard uncertainties (coverage factor 1), \
         with what a facility file states of its own, from {} degrees of freedom of the plateau means.",
        q.blocks_used,
        q.blocks_total,
        q.lost_samples,
        scatter.join(", "),
        q.chi_square,
        q.degrees_of_freedom,
        q.plateau_degrees_of_freedom
    ))
}

/// The result in one line.
#[must_use]
pub fn headline(offset: &Offset) -> String {
    format!("B_off {} enT", triple(&offset.values.offset_ent, &offset.found.std_of_both(&offset.values).offset_ent))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(offset: &Offset) -> String {
    let p = offset;
    format!(
        "{}  {} of {} blocks\n  B_off  {}  enT\n  B_res  {}  enT, seen along {}\n",
        run_line(&p.found.run),
        p.found.quality.blocks_used,
        p.found.quality.blocks_total,
        triple(&p.values.offset_ent, &p.found.std_of_both(&p.values).offset_ent),
        triple(&p.values.residual_ent, &p.found.std_of_both(&p.values).residual_ent),
        p.found.method.normal_axis.join(" "),
    )
}

/// One row per run, for a campaign.
#[cfg(feature = "tables")]
#[must_use]
pub fn parameter_table(runs: &[Opf]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    super::head_columns(&mut table, runs.iter().map(|o| &o.found.run));
    let numbers = |get: &dyn Fn(&Opf) -> f64| Values::Numbers(runs.iter().map(get).collect());
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("b_off_{axis}_ent"), numbers(&|p| p.values.offset_ent[i]));
        table.push(&format!("b_off_{axis}_std_ent"), numbers(&|p| p.found.std_of_both(&p.values).offset_ent[i]));
    }
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("b_res_{axis}_ent"), numbers(&|p| p.values.residual_ent[i]));
        table.push(&format!("b_res_{axis}_std_ent"), numbers(&|p| p.found.std_of_both(&p.values).residual_ent[i]));
    }
    for (i, axis) in COMPONENTS.into_iter().enumerate() {
        table.push(&format!("b_res_coil_{axis}_nt"), numbers(&|p| p.values.residual_coil_nt[i]));
        table.push(&format!("b_res_coil_{axis}_std_nt"), numbers(&|p| p.found.std_of_both(&p.values).residual_coil_nt[i]));
    }
    table
}
