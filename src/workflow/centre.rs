//! Temperature polynomials at the centre of the coil system as a file and a report.

use super::{Desk, Outcome, parameter_text};
use crate::data::error::Finding;
use crate::data::provenance::{Input, Provenance};
use crate::files::output::Folder;
use crate::files::parameter::{Body, Point, Tcf, Tpf, read_point};
use crate::measure::centre::{self, Pair};
use crate::show;
use std::path::PathBuf;

/// The files of a pair, and of the offset at the centre.
#[derive(Clone, Debug)]
pub struct PairFiles {
    centre: (Point, Input),
    off_centre: Option<(Point, Input)>,
    offset: Option<(Point, Input)>,
}

impl PairFiles {
    /// Reads them; notes on the files go to `findings`.
    ///
    /// # Errors
    /// What is wrong with a file.
    pub fn read(
        centre: &PathBuf,
        off_centre: Option<&PathBuf>,
        offset: Option<&PathBuf>,
        findings: &mut Vec<Finding>,
    ) -> Result<Self, Finding> {
        let mut one = |path: &PathBuf| read_point(path, findings).map(|(point, d)| (point.clone(), d.input(point.file)));
        Ok(Self { centre: one(centre)?, off_centre: off_centre.map(&mut one).transpose()?, offset: offset.map(one).transpose()? })
    }

    /// The pair.
    #[must_use]
    pub fn pair(&self) -> Pair<'_> {
        Pair {
            centre: &self.centre.0,
            off_centre: self.off_centre.as_ref().map(|(point, _)| point),
            offset: self.offset.as_ref().map(|(point, _)| point),
        }
    }

    /// The options that name the files, each with a space before it.
    fn recorded(&self) -> String {
        let mut text = format!(" --centre {}", self.centre.0.file);
        for (option, named) in [("--off-centre", &self.off_centre), ("--offset", &self.offset)] {
            if let Some((point, _)) = named {
                text.push_str(&format!(" {option} {}", point.file));
            }
        }
        text
    }

    fn inputs(&self) -> impl Iterator<Item = &Input> {
        std::iter::once(&self.centre).chain(&self.off_centre).chain(&self.offset).map(|(_, input)| input)
    }

    /// Takes polynomials to the centre and writes file and report. `recorded` are the other options, `inputs` the inputs of the
    /// polynomials.
    ///
    /// # Errors
    /// Why that is not possible, or what cannot be written.
    pub fn publish(&self, tpf: &Tpf, recorded: &str, mut inputs: Vec<Input>, desk: &Desk) -> Result<Tcf, Finding> {
        let tcf = centre::centre(tpf, self.pair()).map_err(|e| Finding::error(&tpf.file_name(), e.to_string(), e.remedy()))?;
        inputs.extend(self.inputs().cloned());
        let provenance = Provenance::new(format!("calfit thermal{recorded}{}", self.recorded()), inputs);
        let name = tcf.file_name();
        let folder = Folder::open(&desk.out, desk.force)?;
        folder.check(&name)?;
        let outcome = Outcome {
            name: &name,
            parameters: parameter_text(&name, &tcf, &provenance)?,
            report: format!("REPORT_{}.md", name.trim_end_matches(".TCF")),
            title: show::centre::title(&tcf),
            warnings: &tcf.warnings,
            sections: show::centre::sections(&tcf),
            provenance: &provenance,
        };
        outcome.write(&folder, &[])?;
        Ok(tcf)
    }
}
