//! Continuous sweeps as files, figures and text.

use super::lin::recorded_cut;
use super::{PerRun, Refusal, RunReport, RunResult};
use crate::data::plateau::{self, Accumulator};
use crate::data::provenance::Input;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::Tpf;
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::sweep::{Options, Sweep, WINDOW, Window, sweep};
use crate::plot::{self, Named};
use crate::show::{self, document::Section};

impl PerRun for Options {
    const COMMAND: &'static str = "thermal";
    const KIND: Kind = Kind::Sweep;
    const STEM: &'static str = "SWEEP";
    type Sink = Accumulator;
    type Result = Sweep;

    fn sink(&self, _figures: bool) -> Self::Sink {
        Accumulator::default()
    }

    fn analyse(&self, run: &Run, accumulator: Self::Sink, campaign: &Campaign) -> Result<Sweep, Refusal> {
        let plateaus = plateau::of_run(run, accumulator, self.settling, self.least_coverage);
        sweep(run, &plateaus, campaign, self).map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })
    }

    fn inputs(&self) -> Vec<Input> {
        let facility = self.facility.iter().map(|f| f.input.clone());
        facility.chain(self.model.iter().map(|m| m.input.clone())).collect()
    }

    fn recorded(&self, _result: &Sweep) -> String {
        let mut text: String = self.orders.iter().map(|(name, order)| format!(" --order {name}={order}")).collect();
        match self.window {
            Window::Settings(WINDOW) => {}
            Window::Settings(n) => text.push_str(&format!(" --window {n}")),
            Window::Minutes(m) => text.push_str(&format!(" --window {m}min")),
        }
        if let Some(most) = self.most_k_per_min {
            text.push_str(&format!(" --max-rate {most}"));
        }
        if let Some(facility) = &self.facility {
            text.push_str(&facility.recorded());
        }
        if let Some(model) = &self.model {
            text.push_str(&model.recorded());
        }
        text + &recorded_cut(self.settling, self.least_coverage)
    }
}

impl RunReport for Sweep {
    fn head(&self) -> &RunHead {
        &self.run
    }
    fn warnings(&self) -> &[String] {
        &self.parameters.head.warnings
    }
    fn figures(&self) -> Vec<Named> {
        plot::sweep::figures(self)
    }
    fn title(&self) -> String {
        format!("Temperature sweep, run {}", self.run.id)
    }
    fn sections(&self) -> Vec<Section> {
        show::sweep::sections(self)
    }
    fn analysis(&self) -> &'static str {
        "Temperature sweep"
    }
    fn headline(&self) -> String {
        show::sweep::headline(self)
    }
    fn summary(&self) -> String {
        show::sweep::summary(self)
    }
}

impl RunResult for Sweep {
    type Parameters = Tpf;

    fn parameters(&self) -> &Tpf {
        &self.parameters
    }
    #[cfg(feature = "tables")]
    fn tables(&self) -> Vec<(&'static str, String, Table)> {
        let note = "sliding windows: sigma nT/enT, xi degrees, b_or enT, residuals nT along the coil axes";
        vec![("SWEEP_WINDOWS", note.to_owned(), show::sweep::window_table(self))]
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[&Self]) -> (&'static str, Table) {
        ("lags in s, ranges in °C", show::sweep::parameter_table(all))
    }
}
