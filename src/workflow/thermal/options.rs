//! How thermal analyses are made, and the runs that they rest on.

use crate::data::plateau::Cut;
use crate::data::recipe::{Recipe, axes};
use crate::measure::{freq, lin, null, offset, sweep};
use crate::model::facility::Facility;
use crate::model::linearisation::Linearisation;
use crate::record::known::Known;
use crate::workflow::{Analyses, Desk};
use serde::{Deserialize, Serialize};

/// How thermal analyses are made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThermalOptions {
    /// Order per quantity or family, in place of the choice.
    #[serde(rename = "order", skip_serializing_if = "Vec::is_empty")]
    pub orders: Vec<(String, usize)>,
    /// Fit the plateaus of all runs at once as well.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub joint: bool,
    /// Order of the offset trend of linearity runs; `None` takes that of the campaign, or 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trend_order: Option<usize>,
    /// Order of the drift of zero-field runs; `None` takes the usual one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift_order: Option<usize>,
    /// Largest magnitude of the field of linearity runs along a nominal sensor axis, nT, beside those of the campaign.
    #[serde(with = "axes", skip_serializing_if = "axes::none")]
    pub max_field_nt: [Option<f64>; 3],
    /// Give outlying plateaus of linearity runs less weight.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub robust: bool,
    /// Which part of every setting is used.
    #[serde(flatten)]
    pub cut: Cut,
    /// Go on when a sensitivity is far from its nominal value.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_gain: bool,
    /// Go on when the readings do not follow the settings.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_mismatch: bool,
    /// The facility that turns the settings of the runs into fields.
    #[serde(skip)]
    pub facility: Option<Facility>,
    /// The polynomials that linearise the readings of linearity runs.
    #[serde(skip)]
    pub linearisation: Option<Linearisation>,
    /// Known effects, which are taken off the readings of the runs.
    #[serde(skip)]
    pub model: Option<Known>,
}

impl ThermalOptions {
    /// How linearity runs are analysed.
    #[must_use]
    pub fn linear(&self) -> lin::Options {
        lin::Options {
            trend_order: self.trend_order,
            max_field_nt: self.max_field_nt,
            robust: self.robust,
            cut: self.cut,
            allow_gain: self.allow_gain,
            allow_mismatch: self.allow_mismatch,
            facility: self.facility.clone(),
            linearisation: self.linearisation.clone(),
            model: self.model.clone(),
            temperature: None,
        }
    }

    /// The analyses of the single runs; of sweeps with what only they have.
    #[must_use]
    pub fn analyses(&self, sweep: sweep::Options) -> Analyses {
        let null = null::Options::default();
        let order = self.drift_order.unwrap_or(null.order);
        let (facility, model) = (self.facility.as_ref(), self.model.as_ref());
        Analyses::new(facility, model)
            .with(self.linear())
            .with(offset::Options {
                cut: self.cut,
                allow_mismatch: self.allow_mismatch,
                facility: self.facility.clone(),
                ..offset::Options::default()
            })
            .with(freq::Options { settling: self.cut.settling, allow_gain: self.allow_gain, model: self.model.clone() })
            .with(null::Options { order, ..null })
            .with(sweep::Options {
                cut: self.cut,
                orders: self.orders.clone(),
                allow_gain: self.allow_gain,
                allow_mismatch: self.allow_mismatch,
                facility: self.facility.clone(),
                model: self.model.clone(),
                ..sweep
            })
    }

    /// What an analysis across temperatures is made with.
    pub(in crate::workflow) fn recipe(&self, desk: &Desk) -> Recipe {
        Recipe::new("thermal", self).reading(desk.allowed())
    }
}
