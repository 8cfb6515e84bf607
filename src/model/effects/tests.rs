//! The catalogue says of every effect where it acts, and effects of one's own of every kind are added without a change elsewhere.

use super::between::{self, BETWEEN_RUNS, BetweenRuns, Cause, Conditions, Runs};
use super::in_samples::{Comb, InSamples};
use super::in_sine::{SineParameter, SineRun, SineSetting, SineTerm, Triple};
use super::record::Step;
use super::*;
use crate::data::run::SlowTable;
use crate::model::position::{Class, Position};
use std::f64::consts::PI;

const ABOUT: About =
    About { summary: "", formula: "", family: Family::StaticOdd, seen_in: "", needs: "", source: "", best_measurement: "" };

/// In means: a fifth power.
struct Quintic;

impl Effect for Quintic {
    fn id(&self) -> &'static str {
        "quintic"
    }

    fn about(&self) -> About {
        ABOUT
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        Ok(singly_and_together("quintic"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        Some(spec.axes.iter().map(|&a| Column::on("c5", a, "enT/enT^5", record, |_, r| r.linear_ent[a].powi(5))).collect())
    }
}

/// In samples: a saw.
struct Saw;

impl Effect for Saw {
    fn id(&self) -> &'static str {
        "saw"
    }

    fn about(&self) -> About {
        ABOUT
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Samples]
    }

    fn in_samples(&self) -> Option<InSamples> {
        let term = |axes: &[usize], period_s, _duty, delay_s| {
            Spec::new("saw", axes).with("period", period_s, "s").with("delay", delay_s, "s")
        };
        let harmonic = |order: usize, _duty, delay: f64| {
            let n = order as f64;
            let (sin, cos) = (2.0 * PI * n * delay).sin_cos();
            (-cos / (PI * n), sin / (PI * n))
        };
        Some(InSamples::Comb(Comb { period: "period", term, harmonic }))
    }

    fn period_s(&self, spec: &Spec) -> Option<f64> {
        spec.get("period")
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let (period_s, delay_s) = (spec.get("period")?, spec.get("delay")?);
        let saw = |row: &Row| ((row.t_s() - delay_s) / period_s).rem_euclid(1.0) - 0.5;
        Some(spec.axes.iter().map(|&a| Column::on("a", a, "enT", record, |_, r| saw(r))).collect())
    }
}

/// On sines: the phase grows with the square of the frequency.
struct Dispersion;

#[derive(Debug)]
struct Dispersed;

impl SineTerm for Dispersed {
    fn kind(&self) -> &'static str {
        "dispersion"
    }

    fn form(&self) -> String {
        self.kind().to_owned()
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, _i: usize, to: &mut Triple) {
        to[1] -= 1e-6 * p[0] * run.settings[j].frequency_hz.powi(2);
    }

    fn report(
        &self,
        _run: &SineRun,
        p: &[f64],
        std: &dyn Fn(usize) -> Option<f64>,
        _correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>) {
        (Spec::new(self.kind(), &self.axes()), vec![SineParameter::new("a", 1e-6 * p[0], std(0), "rad/Hz^2")])
    }

    fn limit(&self, _run: &SineRun, least: f64, _hz: f64) -> String {
        format!("a = {:e} rad/Hz^2", 1e-6 * least)
    }
}

impl Effect for Dispersion {
    fn id(&self) -> &'static str {
        "dispersion"
    }

    fn about(&self) -> About {
        ABOUT
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Sines]
    }

    fn sine_terms(&self, _run: &SineRun, _corner_hz: f64) -> Vec<Arc<dyn SineTerm>> {
        vec![Arc::new(Dispersed)]
    }
}

/// Between runs: the angles follow the temperature of the coils.
struct CoilAngles;

impl Effect for CoilAngles {
    fn id(&self) -> &'static str {
        "coil_angles"
    }

    fn about(&self) -> About {
        ABOUT
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::BetweenRuns]
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let Some(kelvin) = runs.deviations_k(|r| r.coil_degc) else {
            return Some(BetweenRuns::unseen(Cause::CoilTemperature, "no temperatures"));
        };
        let columns = between::Column::per_axis("a", "deg/K", &[0, 1, 2], Class::Angle, runs, |run| kelvin[run]);
        let term = between::Term { spec: Spec::new(BETWEEN_RUNS, &[0, 1, 2]), columns };
        Some(BetweenRuns::tried(Cause::CoilTemperature, vec![term]))
    }
}

fn with_own() -> Catalogue {
    let own: [&'static dyn Effect; 4] = [&Quintic, &Saw, &Dispersion, &CoilAngles];
    own.into_iter().fold(Catalogue::default(), |catalogue, effect| catalogue.with(effect).unwrap())
}

fn sines() -> SineRun {
    let setting = |k: u32| SineSetting { frequency_hz: f64::from(k), middle_s: 10.0 * f64::from(k) };
    SineRun {
        settings: (1..9).map(setting).collect(),
        rate_hz: 128.0,
        length_s: 100.0,
        begins_known: true,
        tags_are_rounded: false,
        temperatures: SlowTable::default(),
    }
}

fn runs() -> Runs {
    let run = |k: u32| Conditions {
        sensor: 0,
        set: 0,
        position: Position::STANDARD,
        start_s: Some(f64::from(k)),
        sensor_degc: Some(20.0 + f64::from(k)),
        coil_degc: Some(20.0 + f64::from(k)),
    };
    Runs((0..4).map(run).collect())
}

/// Where an effect says that it acts, it has a form, and nowhere else. Data faults are seen in counters and channels.
#[test]
fn effects_act_where_they_say() {
    for effect in with_own().iter().filter(|e| e.about().family != Family::DataFault) {
        assert_eq!(effect.acts_in(Acts::Samples), effect.in_samples().is_some(), "{effect} in samples");
        assert_eq!(effect.acts_in(Acts::Sines), !effect.sine_terms(&sines(), 5.0).is_empty(), "{effect} on sines");
        assert_eq!(effect.acts_in(Acts::BetweenRuns), effect.between_runs(&runs()).is_some(), "{effect} between runs");
        assert!(effect.acts_in(Acts::Sines) != effect.unseen_by(Kind::Frequency).is_some(), "{effect} in a frequency run");
    }
}

/// An effect that states nothing has no form in a frequency run; that it is part of the amplitude is said by those that are.
#[test]
fn a_reason_is_stated_by_the_effect_itself() {
    for (effect, told) in [(EffectRef::new(&Quintic), false), (EffectRef::new(&cubic_nonlinearity::CubicNonlinearity), true)] {
        assert_eq!(effect.unseen_by(Kind::Frequency) == Some(PART_OF_THE_AMPLITUDE), told, "{effect}");
    }
    assert_eq!(Quintic.unseen_by(Kind::Frequency), Some(Unseen::NoForm(Kind::Frequency)));
}

/// Harmonics of an effect's wave are those of the readings that its columns tell: a unit saw over one period in 4000 steps.
#[test]
fn an_effect_of_ones_own_has_one_formula_in_samples() {
    let Some(InSamples::Comb(comb)) = Saw.in_samples() else { panic!("a comb") };
    let spec = (comb.term)(&[0], 1.0, 0.5, 0.25);
    let mut record = example::of(&interference_tone::InterferenceTone).unwrap().record;
    let row = Row { used_s: [0.0; 2], ..record.rows[0].clone() };
    record.rows = (0..4000).map(|k| Row { used_s: [f64::from(k) / 4000.0; 2], ..row.clone() }).collect();
    record.steps = Vec::<Step>::new();
    let values = Saw.columns(&record, &spec).unwrap().remove(0).values;
    for order in 1..4 {
        let part = |wave: fn(f64) -> f64| {
            let product = |(k, v): (usize, &[f64; 3])| v[0] * wave(2.0 * PI * order as f64 * k as f64 / 4000.0);
            values.iter().enumerate().map(product).sum::<f64>() / 2000.0
        };
        let (sin, cos) = (comb.harmonic)(order, 0.5, 0.25);
        assert!((part(f64::sin) - sin).abs() < 1e-3 && (part(f64::cos) - cos).abs() < 1e-3, "{order}");
    }
}
