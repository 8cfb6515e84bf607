//! Analyses across temperatures as files, figures and text.

use super::{Desk, Outcome, draw, parameter_text};
use crate::data::error::Finding;
use crate::data::provenance::{Input, Provenance};
use crate::files::campaign::file::ThermalEntry;
use crate::files::facility::Facility;
use crate::files::output::Folder;
use crate::files::parameter::Point;
use crate::measure::lin::Lin;
use crate::measure::thermal::{File, Group, Kind, Thermal, ThermalError, groups, thermal};
use crate::plot;
use crate::record::known::Known;
use crate::show::{self, Drawn};
use rayon::prelude::*;

/// How thermal analyses are made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermalOptions {
    /// Order per quantity or family, in place of the choice.
    pub orders: Vec<(String, usize)>,
    /// Fit the plateaus of all runs at once as well.
    pub joint: bool,
    /// The facility that turns the settings of the runs into fields.
    pub facility: Option<Facility>,
    /// Known effects, which are taken off the readings of the runs.
    pub model: Option<Known>,
}

impl ThermalOptions {
    /// The orders as on the command line, each with a space before it.
    #[must_use]
    pub fn recorded_orders(&self) -> String {
        self.orders.iter().map(|(name, order)| format!(" --order {name}={order}")).collect()
    }

    /// All options as on the command line, each with a space before it.
    #[must_use]
    pub fn recorded(&self) -> String {
        let mut text = self.recorded_orders();
        if self.joint {
            text.push_str(" --joint");
        }
        if let Some(facility) = &self.facility {
            text.push_str(&facility.recorded());
        }
        if let Some(model) = &self.model {
            text.push_str(&model.recorded());
        }
        text
    }
}

/// A thermal analysis with its figures.
pub struct ThermalShown {
    /// The result.
    pub thermal: Thermal,
    /// Its figures.
    pub figures: Vec<Drawn>,
}

/// All thermal analyses that a list of runs allows, each published or with the reason why not. `inputs` gives the inputs of the
/// points of a group.
pub fn thermals(
    points: &[Point],
    lins: &[&Lin],
    entries: &[ThermalEntry],
    options: &ThermalOptions,
    desk: &Desk,
    inputs: impl Fn(&[&Point]) -> Vec<Input> + Sync,
) -> Vec<Result<ThermalShown, Finding>> {
    let groups = groups(points, entries, &options.orders);
    let tasks: Vec<(&Group, Kind)> =
        groups.iter().flat_map(|g| Kind::ALL.into_iter().filter(|k| g.has(*k)).map(move |k| (g, k))).collect();
    tasks
        .par_iter()
        .map(|(group, kind)| {
            let result = thermal(group, *kind, lins, options.joint).map_err(|e: ThermalError| {
                Finding::error(&format!("{} {}", group.sensor, group.mode), e.to_string(), e.remedy())
            })?;
            let used: Vec<&Point> = group.points.iter().filter(|p| result.file.head().used.contains(&p.file)).collect();
            let provenance = Provenance::new(format!("calfit thermal{}", options.recorded()), inputs(&used));
            let figures = publish(&result, &provenance, desk)?;
            Ok(ThermalShown { thermal: result, figures })
        })
        .collect()
}

/// Begin of the names of figures and report.
fn stem(kind: Kind) -> &'static str {
    match kind {
        Kind::Lin => "THERMAL",
        Kind::Offset => "THERMAL_OFF",
        Kind::Freq => "THERMAL_AC",
    }
}

/// Writes figures, report and parameter file, the last one last.
fn publish(result: &Thermal, provenance: &Provenance, desk: &Desk) -> Result<Vec<Drawn>, Finding> {
    let name = result.file.file_name();
    let first = result.file.head().first_run();
    let folder = Folder::open(&desk.out, desk.force)?;
    folder.check(&name)?;
    let begin = stem(result.kind);
    let drawn = if desk.plots {
        draw(&folder, &plot::thermal::figures(result), |stem| format!("{begin}_{stem}__{first}.png"))?
    } else {
        Vec::new()
    };
    let head = result.file.head();
    let outcome = Outcome {
        name: &name,
        parameters: match &result.file {
            File::Tpf(body) => parameter_text(&name, body.as_ref(), provenance),
            File::Tof(body) => parameter_text(&name, body.as_ref(), provenance),
            File::Taf(body) => parameter_text(&name, body.as_ref(), provenance),
        }?,
        report: format!("REPORT_{begin}__{first}.md"),
        title: format!("{}, {} {}", show::thermal::title(result.kind), head.sensor, head.mode),
        warnings: &head.warnings,
        sections: show::thermal::sections(result),
        provenance,
    };
    outcome.write(&folder, &drawn)?;
    Ok(drawn)
}
