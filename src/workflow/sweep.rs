//! Continuous sweeps as files, figures and text.

use super::thermal::{CurveView, common, covariance_together, covariances, covariances_with_type_b, tpf};
use super::{Ingredients, PerRun, Refusal, RunResult, Shown};
use crate::data::error::Finding;
use crate::data::note::{Note, Told};
use crate::data::plateau::{self, Accumulator};
use crate::data::provenance::Input;
use crate::data::result::{Covariance, RowsUsed, RunHead};
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::{SweepPart, ThermalConvention, ThermalHead, Tpf};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::sweep::{Options, Sweep, SweepBlock, WindowFit, sweep};
use crate::model::facility::Facility;
use crate::plot;
use crate::record::conditions::Temperatures;
use crate::record::known::Known;
use crate::show;
use nalgebra::DMatrix;
use serde::Serialize;

impl PerRun for Options {
    const ANALYSIS: &'static str = "sweep";
    const COMMAND: &'static str = "thermal";
    const KIND: Kind = Kind::Sweep;
    const STEM: &'static str = "SWEEP";
    const TAKES_MODEL: bool = true;
    type Sink = Accumulator;
    type Result = Sweep;

    fn sink(&self, _figures: bool) -> Self::Sink {
        Accumulator::default()
    }

    fn analyse(&self, run: &Run, accumulator: Self::Sink, campaign: &Campaign) -> Result<Sweep, Refusal> {
        let plateaus = plateau::of_run(run, accumulator, self.cut);
        sweep(run, &plateaus, &campaign.file.instructions, self).map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })
    }

    fn inputs(&self) -> Vec<Input> {
        let facility = self.facility.iter().map(|f| f.input.clone());
        facility.chain(self.model.iter().map(|m| m.input.clone())).collect()
    }

    fn model(&self) -> Option<&Known> {
        self.model.as_ref()
    }

    fn with_corrections(self, facility: Option<&Facility>, model: Option<&Known>) -> Self {
        Self { facility: facility.cloned(), model: model.cloned(), ..self }
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self { facility: files.facility()?, model: files.model()?, ..self })
    }
}

impl RunResult for Sweep {
    type Analysis = Options;
    type Parameters = Tpf;
    const NAME: &'static str = "Temperature sweep";
    const TITLE: &'static str = "Temperature sweep";
    const HEADLINE: fn(&Self) -> String = show::sweep::headline;
    const SHOWN: Shown<Self> =
        Shown { figures: plot::sweep::figures, sections: show::sweep::sections, summary: show::sweep::summary };

    fn head(&self) -> &RunHead {
        &self.run
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn rows(&self) -> Option<RowsUsed> {
        let counts = &self.settings;
        let fast = std::iter::repeat_n("the temperature moves too fast", counts.too_fast);
        let others = counts.total.saturating_sub(counts.used + counts.too_fast);
        let others = std::iter::repeat_n("see the report of the run", others);
        Some(RowsUsed::new(counts.used, counts.total, fast.chain(others).map(str::to_owned)))
    }
    fn has_type_b(&self) -> bool {
        self.quantities.iter().any(|q| q.common.as_ref().is_some_and(|all| !all.is_empty()))
    }
    fn parameters(&self) -> Tpf {
        Tpf {
            sweep: Some(sweep_part(self)),
            together: Some(together(self, &self.together)),
            together_combined: self.together_combined.as_ref().map(|covariance| together(self, covariance)),
            ..tpf(&self.quantities, thermal_head(self), self.rotation.clone(), self.scope.clone(), self.reference)
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        SweepView {
            run: &self.run,
            parameters: self.parameters(),
            windows: &self.windows,
            curves: self.quantities.iter().map(CurveView::from).collect(),
            blocks: &self.blocks,
            temperatures: &self.temperatures,
        }
    }
    #[cfg(feature = "tables")]
    fn tables(&self) -> Vec<(&'static str, String, Table)> {
        let note = "thermal: sliding windows: sigma nT/enT, xi degrees, b_or enT, residuals nT along the coil axes";
        vec![("SWEEP_WINDOWS", note.to_owned(), show::sweep::window_table(self))]
    }
}

/// A sweep as `--json` prints it.
#[derive(Serialize)]
struct SweepView<'a> {
    run: &'a RunHead,
    parameters: Tpf,
    windows: &'a [WindowFit],
    curves: Vec<CurveView<'a>>,
    blocks: &'a [SweepBlock],
    temperatures: &'a Temperatures,
}

fn thermal_head(sweep: &Sweep) -> ThermalHead {
    let [covariance_b, covariance_combined] = covariances_with_type_b(&sweep.quantities);
    ThermalHead {
        used: vec![sweep.file.clone()],
        channel: sweep.channel.clone(),
        valid_degc: sweep.valid_degc,
        sensor: sweep.run.sensor.clone(),
        mode: sweep.run.mode.clone(),
        location: sweep.run.location,
        runs: vec![sweep.run.id.clone()],
        temperature_degc: sweep.run.temperature_degc.into_iter().collect(),
        coil_temperature_degc: vec![sweep.run.coil_temperature_degc.unwrap_or(f64::NAN)],
        convention: ThermalConvention::default(),
        covariance: covariances(&sweep.quantities),
        covariance_b,
        covariance_combined,
        common: common(&sweep.quantities),
        quantity: sweep.quantities.iter().map(|q| q.found.clone()).collect(),
        told: Told::of(&sweep.notes),
    }
}

fn together(sweep: &Sweep, covariance: &DMatrix<f64>) -> Covariance {
    let own = sweep.quantities.iter().map(|q| (q.found.name.as_str(), q.found.unit.as_str(), q.polynomial.coefficients.len()));
    covariance_together(&own.collect::<Vec<_>>(), covariance)
}

fn sweep_part(sweep: &Sweep) -> SweepPart {
    SweepPart {
        settings_used: sweep.settings.used,
        settings_total: sweep.settings.total,
        settings_too_fast: sweep.settings.too_fast,
        window: sweep.window.to_string(),
        residual_nt: sweep.residual_nt,
        rotation_order: Some(sweep.turning.order),
        rotation_change_deg: Some(sweep.turning.angle_deg),
        rotation_change_std_deg: Some(sweep.turning.std_deg),
        applied_lag: Some(sweep.lag.clone()),
        lag: sweep.lags.clone(),
        facility: sweep.facility.clone(),
        model: sweep.model.clone(),
    }
}
