//! Kinds of runs: nuisance parameters, the strength of an effect, and how sensor, noise and effects become runs in memory.

use super::decoy::Decoy;
use super::effects::{self, Effect};
use super::freq;
use super::noise::{Cell, Family, Noise, Random, Whitener};
use super::programme::Programme;
use super::sensor::{CleanRun, Curve, Kind, POSITIONS, Sensor, product, rotation, times, transposed};
use super::{Blind, Options, TrueEffect, TrueParameter, Truth};
use calfit::data::run::{self, GivenBlock, Header, InputFile, ReadingUnit, Run, SlowTable, Vector, VectorAccount};
use calfit::data::units::Reading;
use calfit::files::campaign::Campaign;
use calfit::files::campaign::file::CampaignFile;
use calfit::model::campaign::Instructions;
use calfit::model::position::Position;
use calfit::record::plan::Plan;
use std::ops::Range;

/// A column of a design: per block (run times three plus component) its values in the cells of the run.
pub type Column = Vec<(usize, Vec<f64>)>;

/// Measures columns against the true noise, with the run's own parameters projected out.
pub struct Measure {
    cells: Vec<Vec<Cell>>,
    whiteners: Vec<Whitener>,
    /// Where the values of a block begin.
    starts: Vec<usize>,
    /// Orthonormal, each with the place where it begins.
    basis: Vec<(usize, Vec<f64>)>,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

impl Measure {
    pub fn new(clean_runs: &[CleanRun], noise: &Noise, cells: Vec<Vec<Cell>>, nuisance: &[Column]) -> Self {
        let mut whiteners = Vec::new();
        let mut starts = vec![0];
        for (clean, cells) in clean_runs.iter().zip(&cells) {
            for component in 0..3 {
                whiteners.push(Whitener::new(noise, clean, component, cells));
                starts.push(starts[starts.len() - 1] + cells.len());
            }
        }
        let mut measure = Self { cells, whiteners, starts, basis: Vec::new() };
        // Narrow columns first: what is taken from a column never reaches beyond it.
        let mut columns: Vec<(usize, usize, &Column)> = nuisance
            .iter()
            .map(|column| {
                let begin = column.iter().map(|(block, _)| measure.starts[*block]).min().unwrap_or(0);
                (begin, column.iter().map(|(block, _)| measure.starts[block + 1]).max().unwrap_or(0), column)
            })
            .collect();
        columns.sort_by_key(|(begin, end, _)| end - begin);
        for (begin, end, column) in columns {
            let mut white = vec![0.0; end - begin];
            for (block, values) in column {
                let at = measure.starts[*block] - begin;
                white[at..at + values.len()].copy_from_slice(&measure.whiteners[*block].apply(values));
            }
            let norm = dot(&white, &white).sqrt();
            // Twice is enough for orthogonality to rounding.
            for _ in 0..2 {
                for (other, unit) in &measure.basis {
                    let (low, high) = (begin.max(*other), end.min(other + unit.len()));
                    if low >= high {
                        continue;
                    }
                    let unit = &unit[low - other..high - other];
                    let along = dot(unit, &white[low - begin..high - begin]);
                    white[low - begin..high - begin].iter_mut().zip(unit).for_each(|(w, u)| *w -= along * u);
                }
            }
            let rest = dot(&white, &white).sqrt();
            if rest > 1e-7 * norm {
                white.iter_mut().for_each(|w| *w /= rest);
                measure.basis.push((begin, white));
            }
        }
        measure
    }

    /// Whitened means of records of all runs, and what the nuisance parameters leave of them.
    pub fn white(&self, records: &[Vec<[f64; 3]>]) -> (Vec<f64>, Vec<f64>) {
        let mut all = Vec::with_capacity(*self.starts.last().unwrap_or(&0));
        for (run, cells) in self.cells.iter().enumerate() {
            for component in 0..3 {
                let means: Vec<f64> = cells.iter().map(|cell| mean(&records[run], cell, component)).collect();
                all.extend(self.whiteners[3 * run + component].apply(&means));
            }
        }
        let mut left = all.clone();
        for _ in 0..2 {
            for (begin, unit) in &self.basis {
                let part = &mut left[*begin..begin + unit.len()];
                let along = dot(unit, part);
                part.iter_mut().zip(unit).for_each(|(w, u)| *w -= along * u);
            }
        }
        (all, left)
    }

    /// Strength of records: in multiples of the noise, whitened, and the same without nuisance parameters.
    pub fn strength(&self, records: &[Vec<[f64; 3]>]) -> (f64, f64) {
        let (all, left) = self.white(records);
        (dot(&left, &left).sqrt(), dot(&all, &all).sqrt())
    }
}

fn mean(record: &[[f64; 3]], cell: &Cell, component: usize) -> f64 {
    record[cell.first..cell.first + cell.count].iter().map(|v| v[component]).sum::<f64>() / cell.count as f64
}

/// One column of all components: means of records.
fn column_of(records: &[Vec<[f64; 3]>], cells: &[Vec<Cell>]) -> Column {
    let of = |run: usize, i: usize| cells[run].iter().map(|cell| mean(&records[run], cell, i)).collect::<Vec<f64>>();
    (0..records.len()).flat_map(|run| (0..3).map(move |i| (run, i))).map(|(run, i)| (3 * run + i, of(run, i))).collect()
}

fn as_cells(parts: &[Range<usize>]) -> Vec<Cell> {
    parts.iter().map(|p| Cell { first: p.start, count: p.len() }).collect()
}

/// Means of plateaus, blocks, or parts of a night.
pub fn plateau_cells(clean_runs: &[CleanRun]) -> Vec<Vec<Cell>> {
    clean_runs.iter().map(|clean| as_cells(&clean.parts())).collect()
}

/// Every sample inside the settings.
pub fn sample_cells(clean_runs: &[CleanRun]) -> Vec<Vec<Cell>> {
    clean_runs
        .iter()
        .map(|clean| clean.plateaus.iter().flat_map(Clone::clone).map(|first| Cell { first, count: 1 }).collect())
        .collect()
}

/// The run's own parameters: linearity, per component three fields and a trend of order 2; sweep, fields and offset times temperature
/// to the powers 0 to 2; a night, a trend of order 2; positions, one sensor with a rotation and a trend in each of them.
pub fn nuisance(clean_runs: &[CleanRun], cells: &[Vec<Cell>]) -> Vec<Column> {
    let kind = clean_runs[0].kind;
    let mut columns = Vec::new();
    if kind == Kind::Frequency {
        return freq::nuisance(&clean_runs[0], &cells[0]);
    }
    let middle = |cell: &Cell| cell.first + cell.count / 2;
    let along = |clean: &CleanRun, cell: &Cell| clean.along(cell.first) + 0.5 * (cell.count - 1) as f64 / clean.count as f64;
    let mut own = |run: usize, f: &dyn Fn(&CleanRun, &Cell) -> f64| {
        let values: Vec<f64> = cells[run].iter().map(|cell| f(&clean_runs[run], cell)).collect();
        columns.extend((0..3).map(|component| vec![(3 * run + component, values.clone())]));
    };
    for run in 0..clean_runs.len() {
        match kind {
            Kind::Lin => {
                for k in 0..3 {
                    own(run, &|clean, cell| clean.field_nt[middle(cell)][k] / clean.range_nt());
                }
            }
            Kind::Sweep => {
                for power in 0..3 {
                    for k in 0..4 {
                        own(run, &|clean, cell| {
                            let z: f64 = clean.follows_degc(middle(cell)) / 50.0;
                            z.powi(power) * if k < 3 { clean.field_nt[middle(cell)][k] / clean.range_nt() } else { 1.0 }
                        });
                    }
                }
            }
            _ => {}
        }
        let powers: &[i32] = match kind {
            Kind::Lin | Kind::ZeroField => &[0, 1, 2],
            Kind::Positions => &[1, 2],
            _ => &[],
        };
        for power in powers {
            own(run, &|clean, cell| along(clean, cell).powi(*power));
        }
    }
    if kind == Kind::Positions {
        columns.extend(of_positions(clean_runs, cells));
    }
    columns
}

/// Derivatives of the readings with respect to scale, angles and offset of the sensor and its rotation in every position.
fn of_positions(clean_runs: &[CleanRun], cells: &[Vec<Cell>]) -> Vec<Column> {
    const STEP: f64 = 1e-4;
    let mut columns: Vec<Column> = Vec::new();
    let readings = |run: usize, change: &dyn Fn(&mut CleanRun)| -> Column {
        let moved = |sign: f64| {
            let mut clean = CleanRun { field_nt: Vec::new(), pure_ent: Vec::new(), ..clean_runs[run].clone() };
            change(&mut clean);
            let response = clean.response_at(0.0);
            let values = cells[run].iter().map(|c| times(&response, clean_runs[run].field_nt[c.first]).map(|v| sign * v));
            values.collect::<Vec<[f64; 3]>>()
        };
        let (changed, as_is) = (moved(1.0), cells[run].iter().map(|c| clean_runs[run].pure_ent[c.first]).collect::<Vec<_>>());
        (0..3).map(|i| (3 * run + i, changed.iter().zip(&as_is).map(|(a, b)| (a[i] - b[i]) / STEP).collect())).collect()
    };
    for i in 0..3 {
        let everywhere =
            |change: &dyn Fn(&mut CleanRun)| (0..clean_runs.len()).flat_map(|run| readings(run, change)).collect::<Column>();
        columns.push(everywhere(&|clean| clean.sensor.sigma[i] += STEP));
        columns.push(everywhere(&|clean| clean.sensor.xi_deg[i] += STEP.to_degrees()));
        columns.push((0..clean_runs.len()).map(|run| (3 * run + i, vec![1.0; cells[run].len()])).collect());
        for run in 0..clean_runs.len() {
            columns.push(readings(run, &|clean| {
                let by = rotation(std::array::from_fn(|k| if k == i { STEP } else { 0.0 }));
                clean.towards = product(&transposed(&by), &clean.towards);
            }));
        }
    }
    columns
}

/// Readings are rounded to this, enT.
fn resolution_ent(kind: Kind) -> f64 {
    match kind {
        Kind::Lin | Kind::Positions | Kind::ZeroField => 1.0 / 32.0,
        Kind::Sweep | Kind::Frequency => 1e-3,
    }
}

/// Makes a run set with a hidden truth.
///
/// # Errors
/// An effect that this kind of run does not have.
pub fn generate(seed: u64, kind: Kind, options: &Options) -> Result<Blind, String> {
    let mut random = Random::new(seed, "scene");
    let sensor = Sensor::drawn(kind, &mut random);
    let clean_runs = drawn_runs(kind, options.programme, &sensor, &mut random);
    let mut random = Random::new(seed, "noise family");
    let drawn = Family::WITHOUT_SPIKES[random.below(Family::WITHOUT_SPIKES.len())];
    let family = options.noise.unwrap_or(drawn);
    let noise = Noise::drawn(family, &clean_runs[0], &mut random);

    let mut measures = Measures { clean_runs: &clean_runs, noise: &noise, of_plateaus: None, of_samples: None };
    let mut hidden = Vec::new();
    for (index, name) in options.effects.iter().enumerate() {
        hidden.push(Hidden::new(
            name,
            kind,
            options.strength_k,
            &mut measures,
            &mut Random::new(seed, &format!("effect {index}")),
        )?);
    }
    measure_beside_each_other(&mut hidden, &measures);

    let mut clean_runs = clean_runs;
    if let Some(plan) = options.then {
        clean_runs = clean_runs.iter().map(|clean| clean.changed(plan)).collect();
        for hidden in &mut hidden {
            let amplitude = hidden.amplitude;
            let records = clean_runs.iter().enumerate().map(|(run, clean)| hidden.effect.contribution(clean, run, amplitude));
            hidden.contribution = records.collect();
        }
    }
    let cells = plateau_cells(&clean_runs);
    let mut random = Random::new(seed, options.then.map_or("noise", Plan::name));
    let mut slow_random = Random::new(seed, "slow channels");
    let mut runs = Vec::new();
    let mut means = Vec::new();
    for (index, clean) in clean_runs.iter().enumerate() {
        let record = readings(clean, index, &hidden, noise.record(clean, &mut random));
        means.push(cell_means(&record, &cells[index]));
        let mut run = empty_run(clean, index);
        let changes: Vec<&Effect> = hidden.iter().map(|h| &h.effect).collect();
        slow_tables(clean, &changes, &mut slow_random, &mut run);
        let vectors = if kind == Kind::Sweep {
            run.blocks = clean.settings.iter().zip(&means[index]).map(|(setting, mean)| given(setting, mean)).collect();
            run.settings.clear();
            Vec::new()
        } else if kind == Kind::Frequency {
            as_vectors(clean, &record, &freq::lost(&options.effects, clean, seed), &mut run)
        } else {
            let record = with_low_pass(clean, record, &mut Random::new(seed, "low-pass"));
            as_vectors(clean, &rounded(record, options.decoy, kind), &[], &mut run)
        };
        if let Some(decoy) = options.decoy {
            decoy.damage(clean, &mut run, &mut Random::new(seed, "decoy"));
        }
        runs.push((run, vectors));
    }
    let of_cells = |h: &Hidden| h.contribution.iter().zip(&cells).map(|(record, cells)| cell_means(record, cells)).collect();
    let oracle = hidden.iter().map(of_cells).collect();
    let (effects, hidden_ent) = hidden.into_iter().map(|h| (h.truth, h.contribution)).unzip();
    let campaign = campaign(&clean_runs)?;
    let sines = (kind == Kind::Frequency).then(|| freq::truth(&clean_runs[0]));
    let response_ent_per_nt = if sines.is_some() { Vec::new() } else { clean_runs.iter().map(|s| s.response_at(0.0)).collect() };
    let truth = Truth { seed, kind, noise, effects, parameters: sensor, response_ent_per_nt, sines };
    Ok(Blind { runs, campaign, truth, oracle, hidden_ent, means, clean_runs })
}

/// The runs of a sensor without noise and effects: one, or one per position.
fn drawn_runs(kind: Kind, programme: Programme, sensor: &Sensor, random: &mut Random) -> Vec<CleanRun> {
    if kind == Kind::Frequency {
        return vec![freq::clean_run(sensor.clone(), random)];
    }
    let mut ids: Vec<u32> = POSITIONS.iter().map(|(id, _)| *id).collect();
    if kind == Kind::Positions {
        if random.chance(0.4) {
            ids.remove(1 + random.below(2));
        }
    } else {
        ids.truncate(1);
    }
    ids.into_iter().map(|id| CleanRun::with_programme(kind, programme, sensor.clone(), id, random)).collect()
}

/// Measures of strength on plateau means and on samples, each made when it is needed first.
struct Measures<'a> {
    clean_runs: &'a [CleanRun],
    noise: &'a Noise,
    of_plateaus: Option<Measure>,
    of_samples: Option<Measure>,
}

impl Measures<'_> {
    /// Where an effect is measured: on the samples if it is seen inside the plateaus, else on their means.
    fn cells(&self, inside: bool) -> Vec<Vec<Cell>> {
        if inside { sample_cells(self.clean_runs) } else { plateau_cells(self.clean_runs) }
    }

    /// The measure beside the run's own parameters and further columns.
    fn beside(&self, inside: bool, further: impl FnOnce(&[Vec<Cell>]) -> Option<Column>) -> Measure {
        let cells = self.cells(inside);
        let mut columns = nuisance(self.clean_runs, &cells);
        columns.extend(further(&cells));
        Measure::new(self.clean_runs, self.noise, cells, &columns)
    }

    /// The measure beside the run's own parameters.
    fn of(&mut self, inside: bool) -> &Measure {
        let made = if inside { self.of_samples.take() } else { self.of_plateaus.take() };
        let measure = made.unwrap_or_else(|| self.beside(inside, |_| None));
        if inside { self.of_samples.insert(measure) } else { self.of_plateaus.insert(measure) }
    }
}

/// An effect that is hidden in the runs of a set.
struct Hidden {
    effect: Effect,
    amplitude: f64,
    /// What it adds to every sample of every run, enT.
    contribution: Vec<Vec<[f64; 3]>>,
    truth: TrueEffect,
}

impl Hidden {
    /// An effect of this strength, or of nature's own size.
    fn new(name: &str, kind: Kind, strength_k: f64, measures: &mut Measures, random: &mut Random) -> Result<Self, String> {
        let clean_runs = measures.clean_runs;
        let drawn = if kind == Kind::Frequency {
            freq::drawn(name, &clean_runs[0], random)
        } else if effects::outside(kind).contains(&name) {
            effects::drawn_outside(name, random)
        } else {
            effects::drawn(name, &clean_runs[0], random)
        };
        let effect = drawn.ok_or_else(|| format!("{name} is not made for runs of kind {}", kind.name()))?;
        let absorbed = effects::absorbed(kind).contains(&name);
        let inside = effect.inside || kind == Kind::Frequency;
        let measure = measures.of(inside);
        let records = |amplitude: f64| -> Vec<Vec<[f64; 3]>> {
            clean_runs.iter().enumerate().map(|(run, clean)| effect.contribution(clean, run, amplitude)).collect()
        };
        // Forms that are not in proportion to their amplitude come near in a few steps.
        let mut amplitude = if kind == Kind::Frequency { freq::first_amplitude(name) } else { 1.0 };
        if name == "thermal_lag" && !effect.natural {
            amplitude = 0.01;
        }
        let mut contribution = records(amplitude);
        let mut strength = measure.strength(&contribution);
        if !effect.natural {
            for _ in 0..6 {
                let (now, wanted) = if absorbed { (strength.1, 10.0 * strength_k) } else { (strength.0, strength_k) };
                if now <= 0.0 || (now / wanted - 1.0).abs() < 1e-6 {
                    break;
                }
                amplitude *= wanted / now;
                contribution = records(amplitude);
                strength = measure.strength(&contribution);
            }
        }
        let parameter = |p: &effects::Parameter| TrueParameter {
            name: p.name.clone(),
            unit: p.unit.to_owned(),
            value: p.value * if p.scales { amplitude } else { 1.0 },
        };
        let truth = TrueEffect {
            effect: effect.id.to_owned(),
            drawn_as: name.to_owned(),
            form: effect.form.clone(),
            axes: effect.axes.iter().map(|a| (*a).to_owned()).collect(),
            covariates: effect.covariates.iter().map(|c| (*c).to_owned()).collect(),
            parameters: effect.parameters.iter().map(parameter).collect(),
            exact_form: effect.exact,
            strength_k: strength.0,
            natural_size: effect.natural,
            identifiable: !absorbed,
            surviving_share: if strength.1 > 0.0 { strength.0 / strength.1 } else { 0.0 },
            beside_other_k: None,
            seen_inside_plateaus: inside,
        };
        Ok(Self { effect, amplitude, contribution, truth })
    }
}

/// The strength of each of two effects with the other one among the run's own parameters.
fn measure_beside_each_other(hidden: &mut [Hidden], measures: &Measures) {
    let [first, second] = hidden else { return };
    let strength = |own: &Hidden, other: &Hidden| {
        let measure = measures.beside(own.truth.seen_inside_plateaus, |cells| Some(column_of(&other.contribution, cells)));
        Some(measure.strength(&own.contribution).0)
    };
    first.truth.beside_other_k = strength(first, second);
    second.truth.beside_other_k = strength(second, first);
}

/// Noise, field, offset and hidden effects of a run together.
fn readings(clean: &CleanRun, index: usize, hidden: &[Hidden], mut record: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    for (s, reading) in record.iter_mut().enumerate() {
        let offset = clean.offset_ent(s);
        for i in 0..3 {
            let hidden: f64 = hidden.iter().map(|h| h.contribution[index][s][i]).sum();
            reading[i] += clean.pure_ent[s][i] + offset[i] + hidden;
        }
    }
    record
}

/// Readings as the instrument rounds them, after all else.
fn rounded(mut record: Vec<[f64; 3]>, decoy: Option<Decoy>, kind: Kind) -> Vec<[f64; 3]> {
    let step = if decoy == Some(Decoy::Coarse) { 1.0 } else { resolution_ent(kind) };
    record.iter_mut().flatten().for_each(|reading| *reading = (*reading / step).round() * step);
    record
}

/// Readings behind the low-pass of the sensor, which takes a small part of an interval: it is seen in the first samples after a step alone.
fn with_low_pass(clean: &CleanRun, mut record: Vec<[f64; 3]>, random: &mut Random) -> Vec<[f64; 3]> {
    let keep = (-1.0 / random.between(0.05, 0.3)).exp();
    let mut behind = [0.0; 3];
    for (s, reading) in record.iter_mut().enumerate().skip(1) {
        let [before, now] = [s - 1, s].map(|s| clean.pure_ent.get(s).copied().unwrap_or_default());
        behind = std::array::from_fn(|i| keep * (behind[i] + before[i] - now[i]));
        reading.iter_mut().zip(behind).for_each(|(reading, behind)| *reading += behind);
    }
    record
}

/// Means of a record over some cells.
fn cell_means(record: &[[f64; 3]], cells: &[Cell]) -> Vec<[f64; 3]> {
    cells.iter().map(|c| std::array::from_fn(|i| mean(record, c, i))).collect()
}

fn campaign(clean_runs: &[CleanRun]) -> Result<Campaign, String> {
    let entry = |clean: &CleanRun| {
        let axes = POSITIONS.iter().find(|(id, _)| *id == clean.position).map_or(POSITIONS[0].1, |(_, axes)| *axes);
        Ok((clean.position, Position::from_axes(&axes.map(str::to_owned)).map_err(|e| e.to_string())?))
    };
    let positions = clean_runs.iter().map(entry).collect::<Result<_, String>>()?;
    let instructions = Instructions { positions, ..Instructions::default() };
    Ok(Campaign::in_memory(CampaignFile { instructions, ..CampaignFile::default() }))
}

fn given(setting: &run::Setting, mean: &[f64; 3]) -> GivenBlock {
    let rounded = mean.map(|v| (v * 1e3).round() / 1e3);
    GivenBlock { setting: *setting, mean: Reading(rounded), std_ent: None, count: None }
}

fn empty_run(clean: &CleanRun, index: usize) -> Run {
    let (kind, configuration, sample_rate_hz) = match clean.kind {
        Kind::Lin | Kind::Positions => (run::Kind::Linearity, "LIN2000XYZE.MAG", 32.0),
        Kind::Sweep => (run::Kind::Sweep, "RANDOM50000.MAG", 0.025),
        Kind::ZeroField => (run::Kind::ZeroField, "NULL_LANG.MAG", clean.rate_hz),
        Kind::Frequency => (run::Kind::Frequency, "FREQ2000.MAG", 128.0),
    };
    let day = index + 1;
    let header = Header {
        run: format!("26-05-{day:02}_10-00-00"),
        start: format!("2026-05-{day:02}T10:00:00Z").parse().unwrap(),
        kind,
        configuration: configuration.to_owned(),
        sensor: "DUT".to_owned(),
        mode: "science mode 0".to_owned(),
        sample_rate_hz,
        unit: ReadingUnit::Ent,
        field_source: "FLDS".to_owned(),
        coil_correction: Some(true),
        earthfield_compensation: vec!["DYNAMIC".to_owned(); 3],
    };
    Run {
        input: InputFile { path: header.run.clone(), size_bytes: 0, sha256: String::new() },
        header,
        settings: clean.settings.clone(),
        blocks: Vec::new(),
        temperatures: SlowTable::default(),
        channels: SlowTable::default(),
        scalar: Vec::new(),
        vectors: VectorAccount::default(),
        findings: Vec::new(),
        exclusions: Vec::new(),
    }
}

/// Thermistors and channels as they are read: with noise, and rounded.
fn slow_tables(clean: &CleanRun, effects: &[&Effect], random: &mut Random, run: &mut Run) {
    const THERMISTOR_NOISE_K: f64 = 0.01;
    let rounded = |v: f64| (v * 1e3).round() / 1e3;
    let mut table = |named: Vec<(&str, &Curve, f64)>| {
        let step_s = named[0].1.step_s;
        let count = named[0].1.values.len();
        let t_s: Vec<f64> = (0..count).map(|i| i as f64 * step_s).filter(|t| *t <= clean.count as f64 / clean.rate_hz).collect();
        let mut values = Vec::new();
        for (name, curve, noise) in &named {
            let changed =
                |t: f64| effects.iter().filter_map(|e| e.channel.as_ref()).filter(|c| c.0 == *name).map(|c| c.1(t)).sum::<f64>();
            values.push(t_s.iter().map(|t| rounded(curve.at(*t) + noise * random.normal() + changed(*t))).collect());
        }
        SlowTable { names: named.iter().map(|(name, _, _)| (*name).to_owned()).collect(), t_s, values }
    };
    let mut temperatures = Vec::new();
    match &clean.second_degc {
        Some(second) => {
            temperatures.extend([("TCSC", &clean.sensor_degc, THERMISTOR_NOISE_K), ("TSENS", second, THERMISTOR_NOISE_K)])
        }
        None => temperatures.push(("T59", &clean.sensor_degc, THERMISTOR_NOISE_K)),
    }
    temperatures.extend([("T29", &clean.coil_degc, THERMISTOR_NOISE_K), ("T55", &clean.rack_degc, THERMISTOR_NOISE_K)]);
    run.temperatures = table(temperatures);
    if let (Some([x, y, z]), Some(supply)) = (&clean.variation_nt, &clean.supply_ma) {
        run.channels = table(vec![("VARX", x, 0.0), ("VARY", y, 0.0), ("VARZ", z, 0.0), ("SUPPLY_MA", supply, 0.0)]);
    }
}

/// Samples with their counter; `lost` are counters that were not recorded.
fn as_vectors(clean: &CleanRun, record: &[[f64; 3]], lost: &[Range<usize>], run: &mut Run) -> Vec<Vector> {
    let at = |(n, reading): (usize, &[f64; 3])| Vector {
        n: n as u64,
        t_s: n as f64 / clean.rate_hz,
        reading: Reading(reading.map(|v| (v * 1e3).round() / 1e3)),
    };
    // Three decimals of readings in multiples of 1/32 are what a file holds of them.
    let vectors: Vec<Vector> = record.iter().enumerate().filter(|(n, _)| !lost.iter().any(|l| l.contains(n))).map(at).collect();
    run.vectors = VectorAccount {
        count: vectors.len() as u64,
        lost: lost.iter().map(|l| l.len() as u64).sum(),
        gap_count: lost.len() as u64,
        gaps: lost.iter().map(|l| run::Gap { line: 0, t_s: l.end as f64 / clean.rate_hz, lost: l.len() as u64 }).collect(),
        span_s: vectors.first().zip(vectors.last()).map(|(a, b)| [a.t_s, b.t_s]),
        measured_rate_hz: Some(clean.rate_hz),
        ..VectorAccount::default()
    };
    vectors
}
