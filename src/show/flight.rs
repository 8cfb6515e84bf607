//! The report of flight processing.

use super::Drawn;
use super::document::{Block, Cell, Document, Figure, Section, Table, Text, cells};
use crate::flight::made::{DailyMade, DayMade};

/// A day with its figures.
pub type DayShown = (DayMade, Vec<Drawn>);

/// The report of all days of which there are results.
#[must_use]
pub fn document(mission: &str, instrument: &str, notes: &[String], days: &[DayShown]) -> Document {
    let mut last = 0;
    let mut sections = vec![table_of_days(days)];
    sections.extend(flags(days));
    sections.extend(wheels(days));
    sections.extend(heaters(days));
    sections.extend(shared(days));
    let mut remarks = Section::new("Remarks");
    // Each once, with the days that it is of.
    let mut said: Vec<(&String, Vec<String>)> = Vec::new();
    let of_days = days.iter().flat_map(|(day, _)| day.notes.iter().map(move |note| (note, Some(day))));
    for (note, day) in notes.iter().map(|note| (note, None)).chain(of_days) {
        let name = day.map(|day| format!("{} {}", day.sensor, day.day));
        match said.iter_mut().find(|(other, of)| *other == note && of.is_empty() == name.is_none()) {
            Some((_, of)) => of.extend(name),
            None => said.push((note, name.into_iter().collect())),
        }
    }
    if !said.is_empty() {
        let text = |(note, of): (&String, Vec<String>)| match of.as_slice() {
            [] => Text::from(note.as_str()),
            of => Text::from(format!("{}: {note}", of.join(", ")).as_str()),
        };
        remarks.push(Block::List(said.into_iter().map(text).collect()));
    }
    remarks.push(
        "Uncertainties in the files: `ua` is independent from vector to vector, `uc` common to all of them. Fields of the spacecraft, the \
         table of jumps, the attitude and drift since the ground calibration are in neither.",
    );
    sections.push(remarks);
    for (day, drawn) in days.iter().filter(|(_, drawn)| !drawn.is_empty()) {
        let figures: Vec<Figure> = Drawn::number(drawn, "figures/", &mut last);
        sections.push(Section::new(format!("{} {}", day.sensor, day.day)).with_all(figures));
    }
    Document { title: format!("{mission} {instrument}: flight processing"), front: Vec::new(), sections, colophon: None }
}

fn table_of_days(days: &[DayShown]) -> Section {
    let mut table = Table::new([
        "day",
        "sensor",
        "vectors",
        "null",
        "repeated",
        "rejected",
        "temperature, °C",
        "sum S_d that joins the daily models, nT",
        "modes",
        "levels",
    ]);
    for (day, _) in days {
        let degc = day.degc.map_or(String::new(), |[low, high]| format!("{low:.1} to {high:.1}"));
        let modes: Vec<String> = day.modes.iter().map(|(mode, count)| format!("{mode} {count}")).collect();
        let sum = day.continuity_nt.map_or(String::new(), |s| s.map(|v| format!("{v:+.3}")).join(", "));
        table.push(cells![
            day.day.as_str(),
            day.sensor.as_str(),
            day.written,
            day.null,
            day.rows.duplicates,
            day.rows.rejected,
            degc.as_str(),
            sum.as_str(),
            modes.join(", ").as_str(),
            day.levels.join(" ").as_str()
        ]);
    }
    Section::new("Days").with(table)
}

fn flags(days: &[DayShown]) -> Option<Section> {
    let mut table = Table::new(["day", "sensor", "flag", "vectors", "share, %"]);
    for (day, _) in days {
        for (words, count) in &day.flags {
            let share = 100.0 * *count as f64 / day.written.max(1) as f64;
            table.push(cells![day.day.as_str(), day.sensor.as_str(), words.as_str(), *count, Cell::fixed(share, 3)]);
        }
    }
    (!table.rows.is_empty()).then(|| Section::new("Flags").with(table))
}

fn wheels(days: &[DayShown]) -> Option<Section> {
    let mut table =
        Table::new(["day", "sensor", "mode", "changed", "in short stretches", "outside the table", "taken off x, y, z, nT rms"]);
    for (day, _) in days {
        for (mode, own) in &day.wheels {
            let rms = own.removed_rms_nt.map(|v| format!("{v:.4}")).join(", ");
            table.push(cells![
                day.day.as_str(),
                day.sensor.as_str(),
                mode.as_str(),
                own.changed,
                own.in_short_stretches,
                own.outside_table,
                rms.as_str()
            ]);
        }
    }
    (!table.rows.is_empty()).then(|| Section::new("Wheels and lines, level H").with(table))
}

fn heaters(days: &[DayShown]) -> Option<Section> {
    let mut table = Table::new([
        "day",
        "sensor",
        "heater",
        "jumps",
        "x, nT",
        "y, nT",
        "z, nT",
        "edges that it is made from",
        "length of an edge, s",
    ]);
    for (day, _) in days {
        for heater in &day.heater {
            let jumps = day.jumps.iter().filter(|jump| jump.class == heater.name).count();
            let of = |i: usize| match heater.std_nt {
                Some(std) => Cell::uncertain(heater.vector_nt[i], std[i]),
                None => Cell::Missing("not seen"),
            };
            let [x, y, z] = [0, 1, 2].map(of);
            table.push(cells![
                day.day.as_str(),
                day.sensor.as_str(),
                heater.name.as_str(),
                jumps,
                x,
                y,
                z,
                heater.edges,
                Cell::fixed(heater.edge_s, 1)
            ]);
        }
    }
    (!table.rows.is_empty()).then(|| {
        Section::new("Heaters, level K").with(table).with(
            "Fields in axes of the spacecraft. Heaters that are found in the field have the names of the configuration in the order of \
             their strength, the weakest first: nothing else tells which one is which.",
        )
    })
}

fn shared(days: &[DayShown]) -> Option<Section> {
    let mut table = Table::new(["day", "component", "axis: primary, secondary", "share of variance", "correlation"]);
    for (day, _) in days {
        for (axis, name) in day.shared.iter().zip(["x", "y", "z"]) {
            let [a, b] = axis.direction;
            let direction = format!("{a:.4}, {b:.4}");
            table.push(cells![
                day.day.as_str(),
                name,
                direction.as_str(),
                Cell::fixed(axis.share, 4),
                Cell::fixed(axis.correlation, 4)
            ]);
        }
    }
    (!table.rows.is_empty()).then(|| {
        Section::new("What both sensors share, level J").with(table).with(
            "Where noise of the spacecraft is common to both sensors and stronger at the inboard one, the common part is worse than the \
             outboard sensor alone; a gradiometer with a measured coupling takes that noise off.",
        )
    })
}

/// The daily offset model of a sensor and day with its figures.
pub type DailyShown = (DailyMade, Vec<Drawn>);

/// The report of daily offset models; `without` names days without a model: day, sensor, reason.
#[must_use]
pub fn daily_document(mission: &str, instrument: &str, models: &[DailyShown], without: &[[String; 3]]) -> Document {
    let mut table = Table::new([
        "day",
        "sensor",
        "component",
        "order",
        "explained in hours left out, %",
        "left, nT rms",
        "calm minutes",
        "temperature, °C",
    ]);
    for (model, _) in models {
        for (c, name) in ["x", "y", "z"].into_iter().enumerate() {
            let explained = match model.explained[c] {
                _ if model.order[c] == 0 => Cell::Missing("no dependence"),
                Some(share) => Cell::fixed(100.0 * share, 1),
                None => Cell::Missing("too few hours"),
            };
            let degc = format!("{:.2} to {:.2}", model.valid_degc[0], model.valid_degc[1]);
            table.push(cells![
                model.day.as_str(),
                model.sensor.as_str(),
                name,
                model.order[c],
                explained,
                Cell::fixed(model.residual_nt[c], 3),
                model.minutes,
                degc.as_str()
            ]);
        }
    }
    let mut sections = vec![Section::new("Models").with(table).with(
        "A model of order 0 is a constant: nothing in the calm minutes follows the temperature more than slow noise does by itself. The \
         constant of every model holds whatever was constant in the calm minutes: offset, field of the spacecraft, mean of the field \
         outside. A model holds within its temperatures only.",
    )];
    let mut remarks: Vec<Text> = Vec::new();
    for (model, _) in models {
        remarks.extend(model.notes.iter().map(|note| Text::from(format!("{} {}, {note}.", model.sensor, model.day).as_str())));
    }
    remarks.extend(
        without.iter().map(|[day, sensor, reason]| Text::from(format!("{sensor} {day} has no model: {reason}.").as_str())),
    );
    if !remarks.is_empty() {
        let mut section = Section::new("Remarks");
        section.push(Block::List(remarks));
        sections.push(section);
    }
    let mut last = 0;
    for (model, drawn) in models.iter().filter(|(_, drawn)| !drawn.is_empty()) {
        let figures: Vec<Figure> = Drawn::number(drawn, "figures/", &mut last);
        sections.push(Section::new(format!("{} {}", model.sensor, model.day)).with_all(figures));
    }
    Document { title: format!("{mission} {instrument}: daily offset models"), front: Vec::new(), sections, colophon: None }
}
