//! Sensor offset and residual field of the coil system from one run in several positions (BC-MAG-TR-0085 section 3.4.2).
//!
//! In every position `B_r = B_off + A (B_c + B_res)`: turning the sensor changes the sign or the axis with which it sees the residual
//! field `B_res` of the coil system, and leaves the offset. The response `A` in each position is measured with the applied fields of
//! the run itself, so that a sensor which is turned by not quite 180° takes no part of the residual field for offset. For a turned
//! pair of an ideal sensor this is `B_off = (B_0 + B_180) / 2`, `B_res = (B_0 - B_180) / 2`.

mod carried;
mod effects;
mod levels;
mod refusal;
mod sight;
mod solved;
mod stay;
mod type_b;

pub use refusal::OffsetError;

use crate::data::calibration::Sensitivities;
use crate::data::note::{Note, NoteKind};
use crate::data::offset::{OffsetFound, OffsetQuality, OffsetValues, PositionVisit, ScaledOffset};
use crate::data::plateau::{Cut, Plateau, Plateaus};
use crate::data::provenance::Input;
use crate::data::result::Dropped;
use crate::data::run::{Kind, Run, interpolate};
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::model::facility::{Facility, FacilityApplied};
use crate::record::conditions::{self, Temperatures};
use crate::record::facility;
use crate::record::known::Known;
use crate::record::screens;
use effects::Taken;
use levels::{Levels, check_components};
use serde::{Deserialize, Serialize};
use solved::Solved;
use stay::{Stay, pooled, stays};

/// How an offset analysis is made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Which part of every setting is used.
    #[serde(flatten)]
    pub cut: Cut,
    /// Go on when the readings do not follow the settings.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_mismatch: bool,
    /// The linear calibration whose sensitivity turns enT into nT, with its file.
    #[serde(skip)]
    pub cpf: Option<(Input, Sensitivities)>,
    /// The facility that turns settings into applied fields; its offset field stays part of the residual field that is measured.
    #[serde(skip)]
    pub facility: Option<Facility>,
    /// Known effects of the sensor, those of which that are functions of the reading are taken off.
    #[serde(skip)]
    pub model: Option<Known>,
}

/// Offsets and residual field of one run, with what is needed to judge them. What is not determined is nan.
#[derive(Clone, Debug, PartialEq)]
pub struct Offset {
    /// Offset and residual field.
    pub values: OffsetValues,
    /// How they were found.
    pub found: OffsetFound,
    /// The facility whose scale factors and angles turned settings into applied fields; absent if the settings were taken as fields.
    pub facility: Option<FacilityApplied>,
    /// The known effects that were taken off the readings.
    pub model: Option<ModelApplied>,
    /// Plateaus that were not used.
    pub dropped: Vec<Dropped>,
    /// Every plateau of the run.
    pub plateaus: Vec<Plateau>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// Offsets and residual field of one run.
///
/// # Errors
/// [`OffsetError`]: the run is refused. Components without a turned position are refused by name in the result.
pub fn offset(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Offset, OffsetError> {
    let header = &run.header;
    if header.kind != Kind::Offset {
        return Err(OffsetError::Kind(header.kind));
    }
    if let Some((input, sensitivities)) = &options.cpf {
        sensitivities.must_fit(&input.path, header)?;
    }
    if plateaus.list.is_empty() {
        return Err(OffsetError::NoPlateaus);
    }
    if plateaus.lack_samples(run) {
        return Err(OffsetError::NoSamples { total: plateaus.list.len() });
    }
    if !options.allow_mismatch {
        screens::edges(plateaus)?;
    }
    let mut plateaus = plateaus.clone();
    let mut of_facility: Vec<Note> = Vec::new();
    let facility = options
        .facility
        .as_ref()
        .map(|f| facility::apply(&f.without_offset(), run, instructions, &mut plateaus.list, &mut of_facility))
        .transpose()?;
    let mut notes = Vec::new();
    let taken = options.model.as_ref().map(|known| Taken::off(known, &mut plateaus, instructions, &mut notes)).transpose()?;
    let visits_made = stays(&plateaus, instructions)?;
    let made = visits_made.len();
    let stays = pooled(visits_made);
    let levels = Levels::measure(&stays)?;
    check_components(&stays, &levels, options.allow_mismatch, &mut notes)?;
    let span_s = [stays.first().map_or(0.0, |s| s.time_s()[0]), stays.last().map_or(0.0, |s| s.time_s()[1])];
    let mut of_temperatures = Vec::new();
    let temperatures = Temperatures::of(run, instructions, span_s, &mut of_temperatures);
    let visits_degc = temperatures.sensor_degc().map(|_| temperatures_of_visits(&stays, &temperatures));
    let mut solved = Solved::of(&stays, &levels, visits_degc.as_deref())?;
    if let Some(taken) = &taken {
        taken.widen(&plateaus, instructions, &levels, &mut solved)?;
    }
    if solved.values.offset_ent.iter().all(|v| v.is_nan()) {
        let reasons: Vec<String> = solved.refused.iter().map(|r| format!("{}: {}", r.component, r.reason)).collect();
        return Err(OffsetError::NoPairs(reasons.join("; ")));
    }

    notes.extend(solved.notes(&levels));
    notes.extend(levels.notes.iter().cloned());
    if stays.len() < made {
        let text = format!(
            "{made} visits were taken together in {}, so that a zero level is that of a position in a part of the run",
            stays.len()
        );
        notes.push(Note::new(NoteKind::Method, text));
    }
    notes.extend(of_temperatures);
    solved.values.offset_degc = visits_degc.and_then(|degc| temperatures_of_offsets(&solved, &degc, &temperatures));
    notes.extend(temperatures.moved_k().map(|range_k| moved(range_k, solved.values.offset_degc.as_ref())));
    conditions::warn_of_plateaus(&mut notes, run, &plateaus);
    conditions::warn_of_run(&mut notes, run, instructions);
    let moved = facility.as_ref().filter(|driven| !driven.moved.is_empty());
    let of_uncertain_facility =
        moved.map(|driven| type_b::of_facility(driven, &plateaus, instructions, &levels, &mut solved)).transpose()?;
    let found = OffsetFound {
        run: conditions::head(run, instructions, &temperatures),
        scaled: None,
        quality: quality(run, &plateaus, &stays, &levels, &solved),
        visit: visits(&stays, &levels, &solved),
        method: solved.method,
        covariance: solved.covariance,
        of_facility: of_uncertain_facility,
        drift: solved.drift,
        refused: solved.refused,
    };
    let mut offset = Offset {
        values: solved.values,
        found,
        facility: facility.map(|driven| driven.part),
        model: taken.map(|taken| taken.part),
        dropped: conditions::dropped(&plateaus.list),
        plateaus: plateaus.list.clone(),
        temperatures,
        notes,
    };
    if let Some((input, sensitivities)) = &options.cpf {
        offset.scale(&input.path, sensitivities);
    }
    offset.notes.extend(of_facility);
    Ok(offset)
}

/// Sensor temperatures of the visits, °C.
fn temperatures_of_visits(stays: &[Stay], temperatures: &Temperatures) -> Vec<f64> {
    let of_visit = |stay: &Stay| {
        let degc = stay.plateaus.iter().map(|p| interpolate(&temperatures.sensor, p.t_s()));
        degc.sum::<f64>() / stay.plateaus.len() as f64
    };
    stays.iter().map(of_visit).collect()
}

/// Temperatures at which the offsets hold, °C: an offset that follows the temperature in a straight line is what it is there. `None` where they are
/// those of the run within what thermometers tell.
fn temperatures_of_offsets(solved: &Solved, visits_degc: &[f64], temperatures: &Temperatures) -> Option<[f64; 3]> {
    let of = |counts: &Vec<f64>| counts.iter().zip(visits_degc).map(|(count, degc)| count * degc).sum::<f64>();
    temperatures.beside_the_mean(solved.counts_by_visit.each_ref().map(of))
}

/// Says of a sensor temperature that moved what it means.
fn moved(range_k: f64, offset_degc: Option<&[f64; 3]>) -> Note {
    let offsets = offset_degc.map_or_else(String::new, |degc| {
        let each: Vec<String> = degc.iter().map(|t| format!("{t:.2}")).collect();
        format!(", the offsets at {} °C", each.join(", "))
    });
    let text = format!(
        "the sensor temperature moved by {range_k:.1} K during the run: offset and residual field hold at its mean temperature{offsets}; what the \
         offset follows of the temperature from one position to the next beside a straight line is in no uncertainty"
    );
    Note::new(NoteKind::Temperature, text).with_remedy("measure at a steady temperature")
}

fn quality(run: &Run, plateaus: &Plateaus, stays: &[Stay], levels: &Levels, solved: &Solved) -> OffsetQuality {
    let used: Vec<&Plateau> = stays.iter().flat_map(|s| s.plateaus.iter().copied()).collect();
    OffsetQuality {
        blocks_used: used.len(),
        blocks_total: plateaus.list.len(),
        lost_samples: run.vectors.lost,
        raw_std_ent: conditions::raw_std(&used),
        plateau_std_ent: levels.plateau_std_ent,
        chi_square: solved.chi_square,
        degrees_of_freedom: solved.degrees_of_freedom,
        plateau_degrees_of_freedom: levels.degrees_of_freedom,
        widened: solved.widened,
    }
}

fn visits(stays: &[Stay], levels: &Levels, solved: &Solved) -> Vec<PositionVisit> {
    let visit = |(v, stay): (usize, &Stay)| PositionVisit {
        position: stay.id,
        axes: stay.position.names(),
        time_s: stay.time_s(),
        blocks: stay.plateaus.len(),
        reading_ent: std::array::from_fn(|i| levels.reading_ent[(v, i)]),
        std_ent: std::array::from_fn(|i| levels.std_ent(v, i)),
        residual_ent: solved.residuals_ent.get(v).cloned().unwrap_or_default(),
    };
    stays.iter().enumerate().map(visit).collect()
}

impl Offset {
    /// Gives the offsets in nT as well, with the sensitivities of a linear calibration; `name` is that of its file.
    pub fn scale(&mut self, name: &str, of: &Sensitivities) {
        self.notes.extend(of.of_another_temperature(name, &self.found.run));
        self.found.scaled = Some(ScaledOffset {
            cpf: name.to_owned(),
            sigma: of.sigma_nt_per_ent,
            offset_nt: of.to_nt(&self.values.offset_ent),
            offset_std_nt: of.to_nt(&self.values.offset_std_ent),
            residual_nt: of.to_nt(&self.values.residual_ent),
            residual_std_nt: of.to_nt(&self.values.residual_std_ent),
        });
    }
}
