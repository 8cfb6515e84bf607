//! What a report makes beside the results of runs: calibrations of the coil system and of thermistors, ground calibration files.

use super::Work;
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::Recipe;
use crate::data::run::{Kind, Run};
use crate::files::campaign::named_file;
use crate::files::ledger::Origin;
use crate::files::parameter::Body;
use crate::files::photo;
use crate::measure::coil::{residual::is_check, scalar};
use crate::measure::{thermal, thermistor};
use crate::show::document::{Section, Text};
use crate::show::protocol::OtherPart;
use crate::show::{self, Drawn};
use crate::workflow::{
    CentreMade, CoilMade, CoilResult, CoilRun, Failure, Measured, NoGround, ThermalShown, ground_calibration, publish_coil,
    publish_thermistor, residual_of, scalar_of, thermistor_of,
};

/// Results that belong to no single run, as they were published.
#[derive(Default)]
pub(super) struct Others {
    pub files: Vec<String>,
    pub parts: Vec<OtherPart>,
    pub input: Vec<Input>,
}

/// Thermistors that were calibrated: their parts, and their files with the sensors that they sit in.
pub(super) struct Thermistors {
    pub others: Others,
    pub of_sensor: Vec<(Option<String>, String)>,
}

/// The calibrations at the centre, each with its ground calibration file or what that lacks.
#[derive(Default)]
pub(super) struct Ground {
    pub files: Vec<String>,
    pub lacking: Vec<Note>,
    pub parts: Vec<OtherPart>,
}

/// Photographs that were copied, and what they are copies of.
#[derive(Default)]
pub(super) struct Photos {
    pub drawn: Vec<Drawn>,
    pub input: Vec<Input>,
}

impl Work<'_, '_> {
    /// Copies the photographs that the campaign names.
    pub(super) fn photos(&mut self) -> Photos {
        let mut all = Photos::default();
        for (number, photo) in (1..).zip(&self.campaign.file.stated.photos) {
            let named = named_file(&self.campaign.root, &photo.file, false);
            let copied = named.and_then(|path| {
                self.common.results.places([&path]);
                let (copy, end, digested) = photo::read(&path)?;
                let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
                let input = digested.input(name);
                let file = format!("PHOTO_{number}.{end}");
                let provenance = Provenance::new(Recipe::plain("report"), vec![input.clone()]);
                self.desk.folder("", Origin::of(&provenance))?.write(&file, &copy)?;
                Ok((Drawn { file, title: photo.caption.clone(), caption: photo.caption.clone() }, input))
            });
            if let Some((drawn, input)) = self.keep(copied) {
                all.drawn.push(drawn);
                all.input.push(input);
            }
        }
        all
    }

    /// Calibrates the coil system with the scalar runs: those with settings on the axes alone tell the residual field, the others the rest.
    pub(super) fn coil(&mut self, measured: &[Measured]) -> Others {
        let runs = measured.iter().filter_map(Measured::run).filter(|run| run.header.kind == Kind::Scalar);
        let (checks, others): (Vec<&Run>, Vec<&Run>) = runs.partition(|run| is_check(run));
        let campaign = self.campaign;
        let given = |runs: Vec<&Run>| runs.into_iter().map(|run| CoilRun { run: run.clone(), campaign }).collect();
        let mut all = Others::default();
        let made = scalar_of(given(others), &scalar::Options::default(), &self.desk);
        if let Some(made) = self.keep(made).flatten() {
            self.add_coil(&made, &mut all);
        }
        let made = residual_of(given(checks), &self.desk);
        if let Some(made) = self.keep(made).flatten() {
            self.add_coil(&made, &mut all);
        }
        all
    }

    /// Publishes a calibration of the coil system and takes it.
    fn add_coil<R: CoilResult>(&mut self, made: &CoilMade<R>, all: &mut Others) {
        let published = publish_coil(made, &self.desk);
        let Some((name, figures)) = self.keep(published) else { return };
        made.result.notes().iter().for_each(|w| self.terminal.warning(&format!("{name}: {w}")));
        all.parts.push(OtherPart { title: made.result.title(), sections: (R::SHOWN.sections)(&made.result, &name), figures });
        all.files.push(name);
    }

    /// Calibrates the thermistors whose tables the campaign names.
    pub(super) fn thermistors(&mut self) -> Thermistors {
        let (mut all, mut of_sensor) = (Others::default(), Vec::new());
        let root = &self.campaign.root;
        for entry in &self.campaign.file.thermistors {
            let mut findings = Vec::new();
            let order = entry.order.map(|order| order as usize);
            // One table of several sensors has one file, which is of none of them alone.
            let is_shared = self.campaign.file.thermistors.iter().filter(|other| other.table == entry.table).count() > 1;
            let sensor = entry.sensor.clone().filter(|_| !is_shared);
            let options = thermistor::Options { order, divider: entry.divider, sensor, ..thermistor::Options::default() };
            let path = |name: &String| named_file(root, name, entry.is_outside);
            let made = path(&entry.table).and_then(|table| {
                let reference = entry.reference.as_ref().map(path).transpose()?;
                thermistor_of(&table, reference.as_deref(), &options, &mut findings)
            });
            findings.iter().for_each(|f| self.terminal.finding(f));
            let published = made.and_then(|made| publish_thermistor(&made, &self.desk).map(|published| (made, published)));
            if let Some((made, (name, figures))) = self.keep(published) {
                made.result.notes.iter().for_each(|w| self.terminal.warning(&format!("{name}: {w}")));
                let (title, sections) = (show::thermistor::title(&made.result), show::thermistor::sections(&made.result, &name));
                of_sensor.push((entry.sensor.clone(), name.clone()));
                all.files.push(name);
                all.parts.push(OtherPart { title, sections, figures });
                all.input.extend(made.provenance.input);
            }
        }
        Thermistors { others: all, of_sensor }
    }

    /// Writes the ground calibration files of the sensors that were taken to the centre. What is missing for one is no failure: nobody asked
    /// for it, and the files that it would rest on are there.
    pub(super) fn ground(
        &mut self,
        groups: &[ThermalShown],
        centres: &[CentreMade],
        thermistors: &[(Option<String>, String)],
    ) -> Ground {
        let mut all = Ground::default();
        for made in centres {
            let tcf = &made.file;
            let own_offsets = |g: &&ThermalShown| {
                let runs = &g.thermal.runs;
                g.thermal.kind() == thermal::Kind::Offset && (&runs.sensor, &runs.mode) == (&tcf.sensor, &tcf.mode)
            };
            let tof = groups.iter().find(own_offsets).filter(|_| tcf.residual_field.is_none()).map(|g| g.file.file_name());
            // The thermistor of the sensor goes before one that goes with every sensor.
            let of = |sensor: Option<&String>| thermistors.iter().find(|(own, _)| own.as_ref() == sensor).map(|(_, name)| name);
            let thermistor = of(Some(&tcf.sensor)).or_else(|| of(None)).map(String::as_str);
            let name = tcf.file_name();
            let section = Section::new("Ground calibration file");
            let section = match ground_calibration(&name, tof.as_deref(), thermistor, &self.desk) {
                Ok(file) => {
                    let section =
                        section.with(Text::default().code(&file).and(" holds these values with the labels of RO-IGEP-TR0028."));
                    all.files.push(file);
                    section
                }
                Err(NoGround::Failed(finding)) => {
                    self.failures.push((name.clone(), Failure::Refused(finding)));
                    section
                }
                Err(NoGround::Lacking(finding)) => {
                    let text = format!("there is no ground calibration file of {} {}: {}", tcf.sensor, tcf.mode, finding.rule);
                    let note = Note::new(NoteKind::LeftOut, text).about(&tcf.sensor).with_remedy(finding.remedy.as_ref());
                    all.lacking.push(note.clone());
                    section.with(note)
                }
            };
            let mut sections = show::centre::sections(&made.result, &name);
            sections.push(section);
            all.parts.push(OtherPart { title: show::centre::title(&made.result), sections, figures: Vec::new() });
        }
        all
    }

    /// The value, or its error among the failures.
    fn keep<T>(&mut self, result: Result<T, Finding>) -> Option<T> {
        result.map_err(|finding| self.failures.push((finding.file.to_string(), Failure::Refused(finding)))).ok()
    }
}
