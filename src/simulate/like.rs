//! A measured run once more, from its parameter files: the same programme, sample counters and temperatures, readings from the model
//! with white noise. What the measurement has and this has not is what the model misses.

use super::noise::Random;
use crate::data::error::Finding;
use crate::data::frequency::SineAmplitude;
use crate::data::note::Note;
use crate::data::result::RunHead;
use crate::data::run::{Header, Kind, Run, Setting, Vector, VectorSink};
use crate::data::units::{FieldCoil, Reading};
use crate::files::campaign::Campaign;
use crate::files::ccr::{self, Decimals, Section, Writer};
use crate::files::output::Folder;
use crate::files::parameter::{self, Cpf, Fpf, Opf};
use crate::model::polynomial;
use crate::model::sensor::Linear;
use crate::record::known::{Added, CHUNK, Known};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Counter and time of the samples.
#[derive(Default)]
struct Clock(Vec<(u64, f64)>);

impl VectorSink for Clock {
    fn vector(&mut self, vector: Vector) {
        self.0.push((vector.n, vector.t_s));
    }
}

/// The model of a run in the words of its parameter files.
enum Model {
    /// Of a linearity run.
    Lin { sensor: Linear, trend_ent: [Vec<f64>; 3], tau_span_s: [f64; 2] },
    /// Of an offset run: the sensor by position id, with its reading in zero applied field.
    Offset(Vec<(u32, Linear, [f64; 3])>),
    /// Of a frequency run: amplitude, phase and counter at which it holds, by frequency.
    Freq { rate_hz: [f64; 3], tones: Vec<(f64, [f64; 3], [f64; 3], u64)> },
}

impl Model {
    /// Reading without noise; NaN where the parameters do not determine it.
    fn reading_ent(&self, setting: Option<&Setting>, n: u64, t_s: f64) -> [f64; 3] {
        let field = setting.map_or(FieldCoil([0.0; 3]), |s| s.field);
        match self {
            Model::Lin { sensor, trend_ent, tau_span_s: [begin, end] } => {
                let tau = if end > begin { (2.0 * (t_s - begin) / (end - begin) - 1.0).clamp(-1.0, 1.0) } else { 0.0 };
                sensor.reading(field, std::array::from_fn(|i| polynomial::value(&trend_ent[i], tau))).0
            }
            Model::Offset(places) => {
                let place = places.iter().find(|(id, ..)| setting.is_none_or(|s| s.position == *id));
                place.map_or([f64::NAN; 3], |(_, sensor, b_or_ent)| sensor.reading(field, *b_or_ent).0)
            }
            Model::Freq { rate_hz, tones } => {
                let f = setting.map_or(0.0, |s| s.frequency_hz);
                let tone = tones.iter().find(|(own, ..)| *own == f && f > 0.0);
                tone.map_or([0.0; 3], |(_, b_ent, phase_deg, counter)| {
                    std::array::from_fn(|i| {
                        b_ent[i]
                            * (TAU * (f * (n as f64 - *counter as f64) / rate_hz[i]).fract() + phase_deg[i].to_radians()).sin()
                    })
                })
            }
        }
    }
}

/// Simulates a measured run, with known effects in the readings, and writes it into another campaign folder; returns the path of the file in
/// it. Effects that the run cannot have give a warning.
///
/// `files` are parameter files: the CPF of a linearity run, the OPF of an offset run with a CPF of the sensor, the FPF of a frequency
/// run.
///
/// # Errors
/// A run or file that cannot be read, a kind of run without a model, a file that is missing, or belongs to another run.
pub fn write_like(
    known: Option<&Known>,
    run: &Path,
    files: &[PathBuf],
    seed: u64,
    out: &Path,
    force: bool,
    notes: &mut Vec<Note>,
) -> Result<String, Finding> {
    let mut findings = Vec::new();
    let campaigns = Campaign::open(&[run.to_owned()], &mut findings)?;
    let campaign = campaigns.first().ok_or_else(|| Finding::error(&run.display().to_string(), "is no run", "name a run file"))?;
    let recorded = campaign.runs.first().map_or_else(String::new, |file| file.recorded.clone());
    let mut clock = Clock::default();
    let read = ccr::read(run, &ccr::Options::default(), &mut clock);
    let measured = read.map_err(|mut errors| errors.swap_remove(0))?;
    let (model, white_ent) = model(&measured, files, campaign, known)?;
    let level_ent = |t_s: f64| {
        let holds = |s: &&Setting| (s.t_start_s..s.t_end_s).contains(&t_s);
        model.reading_ent(measured.settings.iter().find(holds), 0, t_s)
    };
    let added = known.and_then(|known| Added::new(known, &measured, level_ent, &campaign.file.instructions, notes));

    let root = Folder::open(out, force)?;
    if out.canonicalize().is_ok_and(|out| out == campaign.root) {
        return Err(Finding::error(&out.display().to_string(), "holds the measured run", "choose another folder with -o"));
    }
    let (day, name) = recorded.rsplit_once('/').unwrap_or(("", &recorded));
    let name = name.trim_end_matches(".gz").trim_end_matches(".GZ");
    let folder = Folder::open(&out.join(day), force)?;
    let failed = |e: std::io::Error| Finding::io(&folder.path().join(name), "write", &e);
    let mut file = folder.create(name)?;
    write(&mut file, &measured, &clock, &model, added, white_ent, seed).map_err(failed)?;
    file.finish()?;
    let toml = campaign.root.join("campaign.toml");
    if campaign.input.is_some() {
        let text = std::fs::read(&toml).map_err(|e| Finding::io(&toml, "read", &e))?;
        let head = format!("# calfit {}: of the campaign of the measured run\n", env!("CARGO_PKG_VERSION"));
        root.write("campaign.toml", &[head.as_bytes(), &text].concat())?;
    }
    root.sync()?;
    Ok(if day.is_empty() { name.to_owned() } else { format!("{day}/{name}") })
}

fn write(
    out: impl std::io::Write,
    run: &Run,
    clock: &Clock,
    model: &Model,
    mut added: Option<Added>,
    white_ent: [f64; 3],
    seed: u64,
) -> std::io::Result<()> {
    let mut writer = Writer::new(out, &run.header, Decimals::default())?;
    writer.remark(&format!("simulated by calfit {}, seed {seed}, like run {}", env!("CARGO_PKG_VERSION"), run.header.run))?;
    writer.fields(&run.settings)?;
    for (section, table) in [(Section::Temperatures, &run.temperatures), (Section::Channels, &run.channels)] {
        if !table.names.is_empty() {
            writer.slow(section, table)?;
        }
    }
    let mut random = Random::new(seed, &[&run.header.run, "like"]);
    let mut settings = run.settings.iter().peekable();
    let mut chunk: Vec<[f64; 3]> = Vec::new();
    writer.vectors(clock.0.iter().enumerate().map(|(place, (n, t_s))| {
        if let Some(added) = added.as_mut().filter(|_| place % CHUNK == 0) {
            let times: Vec<f64> = clock.0[place..].iter().take(CHUNK).map(|(_, t)| *t).collect();
            chunk = added.at(&times);
        }
        let added_ent = chunk.get(place % CHUNK).copied().unwrap_or_default();
        while settings.peek().is_some_and(|s| s.t_end_s <= *t_s) {
            settings.next();
        }
        let setting = settings.peek().copied().filter(|s| s.t_start_s <= *t_s);
        let level_ent = model.reading_ent(setting, *n, *t_s);
        Vector {
            n: *n,
            t_s: *t_s,
            reading: Reading(std::array::from_fn(|i| level_ent[i] + added_ent[i] + white_ent[i] * random.normal())),
        }
    }))?;
    writer.end().map(|_| ())
}

/// The model of a run, and the standard deviation of its samples, enT.
fn model(run: &Run, files: &[PathBuf], campaign: &Campaign, known: Option<&Known>) -> Result<(Model, [f64; 3]), Finding> {
    let header = &run.header;
    let matrix = |rows: [[f64; 3]; 3]| Matrix3::from_fn(|r, c| rows[r][c]);
    let refuse = |rule: String, remedy: &str| Err(Finding::error(&run.input.path, rule, remedy));
    let linear = |phi: Matrix3<f64>| Linear::new(phi).map_err(|e| Finding::error(&header.run, e.to_string(), "check the CPF"));
    match header.kind {
        Kind::Linearity => {
            let cpf = the_file(files, header, true, |c: &Cpf| &c.calibration.run)?;
            if let Some(linearisation) = &cpf.linearisation {
                let rule =
                    format!("is described by a CPF for readings linearised with {}, which are not raw ones", linearisation.file);
                return refuse(rule, "give a CPF of the run made without a linearisation");
            }
            if let (Some(taken_off), None) = (&cpf.model, known) {
                let rule = format!("is described by a CPF without the effects of {}", taken_off.file);
                return refuse(rule, "name that file with --model as well");
            }
            let calibration = cpf.calibration;
            let white_ent = calibration.quality.raw_std_ent.as_ref().map_or([0.0; 3], |s| s.mean);
            let offset = calibration.offset;
            let (trend_ent, tau_span_s) = (offset.trend_ent, offset.tau_span_s);
            Ok((Model::Lin { sensor: linear(matrix(calibration.matrix.phi))?, trend_ent, tau_span_s }, white_ent))
        }
        Kind::Offset => {
            let opf = the_file(files, header, true, |o: &Opf| &o.found.run)?;
            let cpf = the_file(files, header, false, |c: &Cpf| &c.calibration.run)?;
            if opf.values.offset_ent.iter().chain(&opf.values.residual_coil_nt).any(|v| v.is_nan()) {
                return refuse("has no offset or residual field in some component".to_owned(), "measure further positions");
            }
            let split = &cpf.calibration.matrix;
            let turned = matrix(split.rho) * matrix(split.phi_tilde);
            let mut ids: Vec<u32> = run.settings.iter().map(|s| s.position).collect();
            ids.sort_unstable();
            ids.dedup();
            let mut places = Vec::new();
            for id in ids {
                let Some(position) = campaign.file.instructions.position(id) else {
                    return refuse(format!("position {id} is not in the position table"), "add it to campaign.toml");
                };
                let sensor = linear(position.r_nom() * turned)?;
                let seen = sensor.response() * Vector3::from(opf.values.residual_coil_nt);
                places.push((id, sensor, (Vector3::from(opf.values.offset_ent) + seen).into()));
            }
            Ok((Model::Offset(places), opf.found.quality.raw_std_ent.map_or([0.0; 3], |s| s.mean)))
        }
        Kind::Frequency => {
            let fpf = the_file(files, header, true, |f: &Fpf| &f.found.run)?;
            let Some(rate_hz) = fpf.values.f_s_hz else {
                return refuse("has no sampling frequency".to_owned(), "analyse its waveforms with `calfit freq`");
            };
            if fpf.effects.as_ref().is_some_and(|e| !e.effect.is_empty()) {
                return refuse("is without the effects of a model".to_owned(), "analyse the run without --model");
            }
            // Amplitudes in the file are those at one field; the run has those at the fields that were applied.
            let factor = |a: &SineAmplitude| a.applied_nt.zip(fpf.found.applied_nt).map_or(1.0, |(own, all)| own / all);
            // The variance of an amplitude from N samples is 2 / N of theirs; the median is not affected by the alias of a disturbance.
            let white_ent = std::array::from_fn(|i| {
                let of = |a: &SineAmplitude| Some(a.b_std_ent[i] * factor(a) * (a.samples? as f64 / 2.0).sqrt());
                let mut all: Vec<f64> = fpf.amplitude.iter().filter_map(of).filter(|s| s.is_finite()).collect();
                if all.is_empty() { 0.0 } else { crate::fit::statistics::median(&mut all) }
            });
            let tones = fpf
                .amplitude
                .iter()
                .filter_map(|a| Some((a.frequency_hz, a.b_ent.map(|b| b * factor(a)), a.phase_deg?, a.phase_counter?)));
            Ok((Model::Freq { rate_hz, tones: tones.collect() }, white_ent))
        }
        kind => refuse(format!("is of kind {kind}, which has no parameter file"), "name a linearity, offset or frequency run"),
    }
}

/// The parameter file of a kind among those named; `own` is one that must be of this very run, another must be of its sensor and mode.
fn the_file<B: parameter::Body>(
    files: &[PathBuf],
    header: &Header,
    own: bool,
    head: impl Fn(&B) -> &RunHead,
) -> Result<B, Finding> {
    let format = B::FORMAT;
    let path = files.iter().find(|f| parameter::is_named::<B>(f));
    let Some(path) = path else {
        let rule = format!("a {} run needs a {format} to be simulated from", header.kind);
        return Err(Finding::error(&header.run, rule, "analyse the run first, and name the file with --parameters"));
    };
    let body: B = parameter::read(path)?.body;
    let head = head(&body);
    let fits = if own { head.id == header.run } else { head.sensor == header.sensor && head.mode == header.mode };
    if fits {
        return Ok(body);
    }
    let rule = format!("belongs to run {} of {} {}, not to {}", head.id, head.sensor, head.mode, header.run);
    Err(Finding::error(&path.display().to_string(), rule, "name the file of this run"))
}
