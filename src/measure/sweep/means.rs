//! The settings of a sweep as its fits take them, and the orders of the polynomials.

use super::options::Options;
use crate::data::plateau::Plateau;
use crate::data::run::{Run, interpolate};
use crate::fit::aicc;
use crate::model::campaign::Instructions;
use crate::record::baseline::Baseline;
use nalgebra::DMatrix;

/// Orders that are tried where none is given.
const ORDERS: std::ops::RangeInclusive<usize> = 1..=3;

/// Orders of the polynomials: of the response and of the offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Orders {
    /// Of the response.
    pub response: usize,
    /// Of the offset.
    pub offset: usize,
}

impl Orders {
    /// Parameters of a component.
    pub fn count(self) -> usize {
        3 * (self.response + 1) + self.offset + 1
    }
}

/// The mean readings of the settings that are used, and their fields.
pub(super) struct Means {
    /// Fields, nT.
    pub fields_nt: Vec<[f64; 3]>,
    /// Middles, s since the run's start.
    pub t_s: Vec<f64>,
    /// Readings, enT: a row per setting.
    pub readings_ent: DMatrix<f64>,
}

impl Means {
    /// Of some settings.
    pub fn of(used: &[&Plateau]) -> Self {
        Self {
            fields_nt: used.iter().map(|p| p.setting.field.0).collect(),
            t_s: used.iter().map(|p| p.t_s()).collect(),
            readings_ent: DMatrix::from_fn(used.len(), 3, |row, i| used[row].mean.0[i]),
        }
    }

    /// The linear model with polynomials of the temperature.
    pub fn baseline(&self, degc: &[f64], orders: Orders) -> Baseline {
        Baseline::in_temperature(degc, orders.response, orders.offset)
    }

    /// Minus twice the log likelihood of temperatures of the settings: components count by their own noise.
    pub fn deviance(&self, degc: &[f64], orders: Orders) -> f64 {
        let n = degc.len() as f64;
        let squares = self.baseline(degc, orders).squares_ent2(&self.fields_nt, degc, &self.readings_ent);
        squares.iter().map(|s| n * (s / n).ln()).sum()
    }

    /// Temperatures of the settings by a series, (s, °C).
    pub fn degc(&self, series: &[(f64, f64)]) -> Vec<f64> {
        self.t_s.iter().map(|t| interpolate(series, *t)).collect()
    }
}

/// Orders that the analyst or the campaign asks for.
pub(super) struct Asked {
    response: Option<usize>,
    offset: Option<usize>,
}

impl Asked {
    /// What the analyst asks for now goes before what the campaign says.
    pub fn of(run: &Run, instructions: &Instructions, options: &Options) -> Self {
        let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
        let entries = instructions.thermal.iter();
        let entry = entries.filter(|e| applies(&e.sensor, &run.header.sensor) && applies(&e.mode, &run.header.mode));
        let of_campaign = entry.flat_map(|e| e.orders.iter().map(|(n, o)| (n.clone(), *o as usize)));
        let all: Vec<(String, usize)> = options.orders.iter().cloned().chain(of_campaign).collect();
        let order = |name: &str| all.iter().find(|(n, _)| n == name).map(|(_, order)| *order);
        Self { response: order("sigma"), offset: order("b_or") }
    }

    /// Whether the order of a quantity was asked for: of one of the response, or of an offset.
    pub fn has(&self, of_response: bool) -> bool {
        if of_response { self.response.is_some() } else { self.offset.is_some() }
    }

    /// Second order where nothing is asked for.
    pub fn usual(&self) -> Orders {
        Orders { response: self.response.unwrap_or(2), offset: self.offset.unwrap_or(2) }
    }

    /// Those that were asked for, the others with the least AICc, summed over the components.
    pub fn choose(&self, means: &Means, degc: &[f64]) -> Orders {
        if let (Some(response), Some(offset)) = (self.response, self.offset) {
            return Orders { response, offset };
        }
        let mut best: Option<(f64, Orders)> = None;
        for response in ORDERS.filter(|p| self.response.is_none_or(|r| r == *p)) {
            for offset in ORDERS.filter(|q| self.offset.is_none_or(|o| o == *q)) {
                let orders = Orders { response, offset };
                let value = aicc(means.deviance(degc, orders), 3 * orders.count() + 3, 3 * degc.len());
                if let Some(value) = value.filter(|v| best.is_none_or(|(least, _)| *v < least)) {
                    best = Some((value, orders));
                }
            }
        }
        best.map_or_else(|| self.usual(), |(_, orders)| orders)
    }
}
