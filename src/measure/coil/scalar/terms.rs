//! The model of a scalar calibration: nine parameters, what the temperatures change of six of them, and steps between calibrations.

use crate::data::result::Covariance;
use crate::data::run::ScalarRow;
use crate::fit::Model;
use crate::measure::coil::{ANGLES, AXES};
use crate::model::coil::Coil;
use crate::model::facility::FacilityParameters;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Number of parameters at one temperature.
pub(super) const CONSTANT: usize = 9;
/// Scale factors and offset fields, which may follow a temperature.
const THERMAL: usize = 6;

/// A row with its temperatures as differences from the references, K.
#[derive(Clone)]
pub(super) struct Observation {
    pub run: usize,
    pub row: usize,
    pub scalar: ScalarRow,
    pub coil_k: [f64; 3],
    pub rack_k: f64,
}

/// One of the nine parameters that has another value from a calibration on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// The parameter: scale factors, offset fields, angles.
    pub parameter: usize,
    /// The first calibration with the new value.
    pub from_run: usize,
}

/// What is fitted.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Terms {
    /// Coefficients of the coil temperature.
    pub coil: bool,
    /// Coefficients of the rack temperature.
    pub rack: bool,
    /// Steps.
    pub steps: Vec<Step>,
    /// Parameters whose temperature coefficients are taken as zero.
    pub held: Vec<usize>,
}

impl Terms {
    /// Nine parameters alone.
    pub fn constant() -> Self {
        Self::default()
    }

    /// The same with the temperature coefficients of all that steps taken as zero.
    pub fn with_steps_in_place(&self) -> Self {
        let mut held = self.held.clone();
        held.extend(self.steps.iter().map(|s| s.parameter).filter(|p| *p < THERMAL));
        Self { held, ..self.clone() }
    }

    fn thermal(&self) -> usize {
        THERMAL * (usize::from(self.coil) + usize::from(self.rack))
    }

    /// Places of the parameters that are fitted among the nine, all coefficients, and all steps.
    fn active(&self) -> Vec<usize> {
        let thermal = CONSTANT..CONSTANT + self.thermal();
        let is_held = |i: &usize| thermal.contains(i) && self.held.contains(&((i - CONSTANT) % THERMAL));
        (0..CONSTANT + self.thermal() + self.steps.len()).filter(|i| !is_held(i)).collect()
    }

    /// Number of parameters that are fitted.
    pub fn count(&self) -> usize {
        self.active().len()
    }

    /// Where a search for these terms may begin: at what was found for other terms, and at zero for what those do not have.
    pub fn continued(&self, found: &[f64], of: &Terms) -> Vec<f64> {
        let before = of.active();
        let thermal = |terms: &Terms, place: usize| place < CONSTANT + terms.thermal();
        let same = |place: usize, other: usize| match (thermal(self, place), thermal(of, other)) {
            (true, true) => place == other && (place < CONSTANT || self.thermal() == of.thermal()),
            (false, false) => self.steps[place - CONSTANT - self.thermal()] == of.steps[other - CONSTANT - of.thermal()],
            _ => false,
        };
        let value = |place: &usize| before.iter().position(|other| same(*place, *other)).map_or(0.0, |i| found[i]);
        self.active().iter().map(value).collect()
    }

    /// Names in a parameter file, names for people, units, of all but the steps.
    fn names_without_steps(&self) -> Vec<[String; 3]> {
        let mut list = Vec::new();
        let mut of = |key: &str, text: &str, unit: &str, axes: [&str; 3]| {
            list.extend(axes.map(|a| [format!("{key}_{}", a.to_lowercase()), text.replace('#', a), unit.to_owned()]));
        };
        of("scale", "the scale factor of #", "nT/EU", AXES);
        of("offset", "the offset field of #", "nT", AXES);
        of("angle", "the angle #", "deg", ANGLES);
        for (follows, key, what) in [(self.coil, "", "coil"), (self.rack, "rack_", "rack")] {
            if follows {
                let text = |of: &str| format!("the change of the {of} of # with the {what} temperature");
                of(&format!("{key}scale_per_k"), &text("scale factor"), "1/K", AXES);
                of(&format!("{key}offset_per_k"), &text("offset field"), "nT/K", AXES);
            }
        }
        list
    }

    /// The name of one of the nine parameters for people.
    pub fn name(parameter: usize) -> String {
        let [_, text, _] = Terms::constant().names_without_steps().swap_remove(parameter);
        text
    }

    /// Whether the parameter with this place holds in a calibration: all but the steps do, these from theirs on.
    fn factor(&self, place: usize, run: usize) -> f64 {
        let step = place.checked_sub(CONSTANT + self.thermal()).map(|i| self.steps[i]);
        f64::from(u8::from(step.is_none_or(|s| s.from_run <= run)))
    }

    /// The place among the nine and the coefficients to which the parameter at a place adds.
    fn target(&self, place: usize) -> usize {
        place.checked_sub(CONSTANT + self.thermal()).map_or(place, |i| self.steps[i].parameter)
    }

    /// The facility in a calibration, references of the temperatures aside.
    pub fn part(&self, values: &[f64], run: usize) -> FacilityParameters {
        let mut all = vec![0.0; CONSTANT + self.thermal()];
        for (place, value) in self.active().into_iter().zip(values) {
            all[self.target(place)] += value * self.factor(place, run);
        }
        let three = |from: usize| -> [f64; 3] { std::array::from_fn(|i| all.get(from + i).copied().unwrap_or(f64::NAN)) };
        let mut part = FacilityParameters::constant(three(0), three(3), three(6));
        if self.coil {
            part.scale_per_k = Some(three(CONSTANT));
            part.offset_nt_per_k = Some(three(CONSTANT + 3));
        }
        if self.rack {
            let at = CONSTANT + if self.coil { THERMAL } else { 0 };
            part.rack_scale_per_k = Some(three(at));
            part.rack_offset_nt_per_k = Some(three(at + 3));
        }
        part
    }

    /// The coil system in a calibration with references of zero.
    pub fn coil(&self, values: &[f64], run: usize) -> Coil {
        let part = FacilityParameters { reference_degc: Some(0.0), rack_reference_degc: Some(0.0), ..self.part(values, run) };
        part.coil()
    }

    /// How one of the nine parameters in a calibration, at temperatures that differ from the references by so many kelvins, follows the fitted
    /// parameters: its derivatives by all of them.
    pub fn derivatives(&self, parameter: usize, run: usize, coil: &Coil, coil_k: [f64; 3], rack_k: f64) -> Vec<f64> {
        let k = parameter % 3;
        let scale = if parameter < 3 { coil.scale_nt_per_eu[k] } else { 1.0 };
        let rack_at = CONSTANT + if self.coil { THERMAL } else { 0 };
        let of = |place: usize| match self.target(place) {
            own if own == parameter => 1.0,
            own if parameter < THERMAL && self.coil && own == CONSTANT + parameter => scale * coil_k[k],
            own if parameter < THERMAL && self.rack && own == rack_at + parameter => scale * rack_k,
            _ => 0.0,
        };
        self.active().into_iter().map(|place| of(place) * self.factor(place, run)).collect()
    }

    /// Covariance of the facility in a calibration from that of the fitted parameters. Coefficients that were taken as zero have none.
    pub fn covariance(&self, fitted: &DMatrix<f64>, run: usize) -> Covariance {
        let active = self.active();
        let targets: Vec<usize> = active.iter().copied().filter(|place| *place < CONSTANT + self.thermal()).collect();
        let sums = DMatrix::from_fn(targets.len(), active.len(), |r, c| {
            if self.target(active[c]) == targets[r] { self.factor(active[c], run) } else { 0.0 }
        });
        let matrix = &sums * fitted * sums.transpose();
        let names = self.names_without_steps();
        let of = |which: usize| targets.iter().map(|t| names[*t][which].clone()).collect();
        Covariance {
            parameters: of(0),
            units: of(2),
            matrix: (0..targets.len()).map(|r| (0..targets.len()).map(|c| matrix[(r, c)]).collect()).collect(),
        }
    }

    /// The calibrations with which a new value begins, the first of all among them, in their order.
    pub fn begins(&self) -> Vec<usize> {
        let mut begins: Vec<usize> = [0].into_iter().chain(self.steps.iter().map(|s| s.from_run)).collect();
        begins.sort_unstable();
        begins.dedup();
        begins
    }
}

/// The modulus of the field of every row.
pub(super) struct Modulus<'a> {
    pub rows: &'a [Observation],
    pub terms: &'a Terms,
}

impl Modulus<'_> {
    fn runs(&self) -> usize {
        self.rows.iter().map(|r| r.run + 1).max().unwrap_or_default()
    }
}

impl Model for Modulus<'_> {
    fn names(&self) -> Vec<String> {
        let plain = self.terms.names_without_steps();
        let name = |place: usize| match place.checked_sub(plain.len()) {
            None => plain[place][1].clone(),
            Some(step) => {
                let step = self.terms.steps[step];
                format!("the step of {} before calibration {}", Terms::name(step.parameter), step.from_run + 1)
            }
        };
        self.terms.active().into_iter().map(name).collect()
    }

    fn values(&self, parameters: &[f64], values: &mut [f64]) {
        let coils: Vec<Coil> = (0..self.runs()).map(|run| self.terms.coil(parameters, run)).collect();
        let Some(axes) = coils.iter().map(Coil::axes).collect::<Option<Vec<Matrix3<f64>>>>() else {
            return values.fill(f64::NAN);
        };
        for (value, row) in values.iter_mut().zip(self.rows) {
            *value = Vector3::from(coils[row.run].field(&axes[row.run], row.scalar.setting, row.coil_k, row.rack_k).0).norm();
        }
    }

    fn jacobian(&self, parameters: &[f64], jacobian: &mut DMatrix<f64>) {
        let coils: Vec<Coil> = (0..self.runs()).map(|run| self.terms.coil(parameters, run)).collect();
        let of = |coil: &Coil| coil.axes().zip(coil.axes_per_degree());
        let Some(axes) = coils.iter().map(of).collect::<Option<Vec<_>>>() else { return jacobian.fill(f64::NAN) };
        let active = self.terms.active();
        for (i, row) in self.rows.iter().enumerate() {
            let (coil, (axes, by_angle)) = (&coils[row.run], &axes[row.run]);
            let unit = Vector3::from(coil.field(axes, row.scalar.setting, row.coil_k, row.rack_k).0).normalize();
            let along = axes.transpose() * unit;
            let coil_factor = |k: usize| 1.0 + coil.scale_per_k[k] * row.coil_k[k];
            let rack_factor = |k: usize| 1.0 + coil.rack_scale_per_k[k] * row.rack_k;
            let driven =
                Vector3::from_fn(|k, _| coil.scale_nt_per_eu[k] * coil_factor(k) * rack_factor(k) * row.scalar.setting[k]);
            let mut all = Vec::with_capacity(CONSTANT + self.terms.thermal());
            let setting = |k: usize| along[k] * row.scalar.setting[k];
            all.extend((0..3).map(|k| setting(k) * coil_factor(k) * rack_factor(k)));
            all.extend(unit.iter());
            all.extend((0..3).map(|k| unit.dot(&(by_angle[k] * driven))));
            if self.terms.coil {
                all.extend((0..3).map(|k| setting(k) * coil.scale_nt_per_eu[k] * row.coil_k[k] * rack_factor(k)));
                all.extend((0..3).map(|k| unit[k] * row.coil_k[k]));
            }
            if self.terms.rack {
                all.extend((0..3).map(|k| setting(k) * coil.scale_nt_per_eu[k] * coil_factor(k) * row.rack_k));
                all.extend((0..3).map(|k| unit[k] * row.rack_k));
            }
            for (column, place) in active.iter().enumerate() {
                jacobian[(i, column)] = all[self.terms.target(*place)] * self.terms.factor(*place, row.run);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::nonlinear;

    #[test]
    fn the_jacobian_is_that_of_differences() {
        let row = |run: usize, setting: [f64; 3], coil_k: [f64; 3], rack_k: f64| Observation {
            run,
            row: 0,
            scalar: ScalarRow { t_s: 0.0, setting, modulus_nt: 0.0 },
            coil_k,
            rack_k,
        };
        let rows = [
            row(0, [3e4, -2e4, 1e4], [0.7, 0.6, 0.9], -1.1),
            row(1, [-1e4, 4e4, 2e4], [-0.4; 3], 0.3),
            row(1, [0.0, 0.0, -5e4], [1.0; 3], 1.0),
        ];
        let steps = vec![Step { parameter: 4, from_run: 1 }, Step { parameter: 8, from_run: 1 }];
        let terms = Terms { coil: true, rack: true, steps, held: vec![4] };
        assert_eq!((terms.count(), terms.begins()), (21, vec![0, 1]));
        let model = Modulus { rows: &rows, terms: &terms };
        let mut parameters = vec![0.99, 1.01, 1.002, 20.0, -30.0, 5.0, 89.7, 90.4, 90.2];
        // The offset of Y follows no temperature.
        parameters.extend([1.9e-3, -1.6e-3, 1.7e-3, 0.3, 0.8, -8e-4, 5e-4, 2e-4, 0.1, -0.3, 2.2, 0.3]);
        let (mut own, mut differences) = (DMatrix::zeros(3, 21), DMatrix::zeros(3, 21));
        model.jacobian(&parameters, &mut own);
        nonlinear::differentiate(&model, &parameters, &mut differences);
        for i in 0..3 {
            for j in 0..21 {
                let size = own.column(j).amax();
                assert!(
                    (own[(i, j)] - differences[(i, j)]).abs() <= 1e-7 * size,
                    "{i} {j}: {} {}",
                    own[(i, j)],
                    differences[(i, j)]
                );
            }
        }
        let part = terms.part(&parameters, 1);
        assert_eq!((part.offset_nt[1], part.offset_nt_per_k.unwrap()[1]), (-30.0 + 2.2, 0.0));
    }
}
