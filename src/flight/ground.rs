//! The ground calibration (RO-IGEP-TR0028 section 4.2.3.2): `B = ω(T) σ(T) (B_r - B_off(T))`, with what is uncertain of it.

use super::temperature::Thermometer;
use super::{Block, Step};
use crate::data::flags::Flags;
use crate::data::time::Tt2000;
use crate::data::units::Reading;
use crate::model::field_calibration::{AtTemperature, FieldCalibration, SYMMETRIC};
use crate::model::polynomial::{TemperaturePolynomial, value};
use crate::record::single_readings::{SingleReadings, TakenOff};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;
use std::ops::Range;

/// The temperatures for which vectors are given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Outside of these a vector has its flag, °C.
    pub valid_degc: [f64; 2],
    /// Outside of these there is none, °C.
    pub kept_degc: [f64; 2],
}

impl Limits {
    /// Whether a temperature is without flag, and whether a vector is given at it.
    #[must_use]
    pub fn of(&self, degc: f64) -> (bool, bool) {
        let within = |[low, high]: [f64; 2]| (low..=high).contains(&degc);
        (within(self.valid_degc), within(self.kept_degc))
    }
}

/// Noise of a reading.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadingNoise {
    /// Standard deviation by mode, enT; nan where it is not known.
    pub std_ent: Vec<f64>,
    /// Step of the converter by range, enT; the last one is that of all further ranges.
    pub step_ent: Vec<f64>,
}

impl ReadingNoise {
    /// Variance of a reading in a mode and range, enT²; nan where it is not known.
    fn variance_ent2(&self, mode: u8, range: u8) -> f64 {
        let step = self.step_ent.get(usize::from(range)).or(self.step_ent.last());
        self.std_ent.get(usize::from(mode)).zip(step).map_or(f64::NAN, |(std, step)| std * std + step * step / 12.0)
    }
}

/// The ground calibration of files.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundStep {
    /// The calibration.
    pub calibration: FieldCalibration,
    /// Known effects that are taken off the readings first.
    pub effects: Option<SingleReadings>,
    /// The thermistor, for the uncertainty of its readings; absent where the table has temperatures.
    pub thermometer: Thermometer,
    /// Standard uncertainty of the offset of the thermistor, which all readings share, °C; 0 where none is stated.
    pub t_off_std_degc: f64,
    /// Temperatures.
    pub limits: Limits,
    /// Noise; absent if no uncertainties are wanted.
    pub noise: Option<ReadingNoise>,
    /// Models of single days that are subtracted behind this step: an error of the temperature acts in both at once.
    pub daily: Vec<DailySlopes>,
    /// The frame in which the field is wanted, if it is not that of the files.
    pub frame: Option<crate::data::convention::Convention>,
}

/// What the model of a day that is subtracted behind the ground calibration does with the temperature.
#[derive(Clone, Debug, PartialEq)]
pub struct DailySlopes {
    /// When it acts.
    pub span: Range<Tt2000>,
    /// `P_d` of x, y, z, nT over °C.
    pub polynomials: [TemperaturePolynomial; 3],
    /// Change of `S_d` if all temperatures are higher, nT/K.
    pub sum_nt_per_k: [f64; 3],
}

/// What all vectors at one temperature share.
struct Here {
    at: AtTemperature,
    /// From the wanted frame back to that of the files, if these are two.
    back: Option<Matrix3<f64>>,
    /// Change of the offset with the temperature, enT/K.
    offset_change_ent: Vector3<f64>,
    /// Change of the matrix with the temperature, nT/enT/K.
    matrix_change: Matrix3<f64>,
    /// Standard uncertainty of the temperature from the step of the converter, °C.
    std_degc: f64,
    /// `M Mᵀ`, of noise of one enT along every axis.
    unit_noise: [f64; 6],
}

/// Step for the derivative by the temperature, K: short against everything that polynomials of a sensor do, and long against rounding.
const STEP_K: f64 = 1e-2;

impl GroundStep {
    /// What the known effects are of the readings of some rows, which have one temperature; none without known effects.
    fn taken_off(&self, block: &Block, rows: Range<usize>, offset_ent: &Vector3<f64>) -> Vec<TakenOff> {
        let Some(effects) = &self.effects else { return Vec::new() };
        effects.taken_off(&rows.map(|row| (block.vector(row) - offset_ent).into()).collect::<Vec<_>>())
    }

    /// Whether one daily model holds for all of these times, which rise.
    fn daily_run(&self, times: &[Tt2000]) -> bool {
        let of = |time: &Tt2000| self.daily.iter().position(|own| own.span.contains(time));
        times.first().map(of) == times.last().map(of)
    }

    /// Change of the daily model of a time with the temperature of its vector, and of its constant with those of all vectors, nT/K.
    fn daily_change_nt(&self, time: Tt2000, degc: f64) -> [Vector3<f64>; 2] {
        let Some(own) = self.daily.iter().find(|own| own.span.contains(&time)) else { return [Vector3::zeros(); 2] };
        let slopes = Vector3::from_fn(|i, _| value(&derivative(&own.polynomials[i].coefficients), degc));
        [slopes, own.sum_nt_per_k.into()]
    }

    fn here(&self, degc: f64, count: f64) -> Option<Here> {
        let at = |degc: f64| {
            let at = self.calibration.at(degc)?;
            Some(match self.frame {
                None => at,
                Some(convention) => at.turned(&convention.frame_of(&at.matrix)),
            })
        };
        let own = at(degc)?;
        let back = self.frame.and_then(|convention| Some(convention.frame_of(&self.calibration.at(degc)?.matrix).transpose()));
        if self.noise.is_none() {
            let nothing = (Vector3::zeros(), Matrix3::zeros());
            return Some(Here {
                at: own,
                back,
                offset_change_ent: nothing.0,
                matrix_change: nothing.1,
                std_degc: 0.0,
                unit_noise: [0.0; 6],
            });
        }
        let (low, high) = (at(degc - STEP_K)?, at(degc + STEP_K)?);
        let scale = 1.0 / (2.0 * STEP_K);
        let square = own.matrix * own.matrix.transpose();
        Some(Here {
            offset_change_ent: (high.offset_ent - low.offset_ent) * scale,
            matrix_change: (high.matrix - low.matrix) * scale,
            std_degc: self.thermometer.std_degc(count),
            unit_noise: SYMMETRIC.map(|place| square[place]),
            back,
            at: own,
        })
    }
}

/// Coefficients of the derivative of a polynomial, lowest order first.
pub(super) fn derivative(coefficients: &[f64]) -> Vec<f64> {
    coefficients.iter().enumerate().skip(1).map(|(k, c)| k as f64 * c).collect()
}

impl Step for GroundStep {
    fn apply(&self, block: &mut Block) {
        let mut known: HashMap<u64, Option<Here>> = HashMap::new();
        let wants = self.noise.is_some() && !block.own_nt2.is_empty();
        let linear = self.calibration.parts().linearisation.is_none();
        let mut row = 0;
        while row < block.len() {
            let (degc, count) = (block.t_degc[row], block.thermistor[row]);
            let end = row + block.t_degc[row..].iter().take_while(|t| t.to_bits() == degc.to_bits()).count();
            let needs = self.calibration.needs_temperature();
            let (without_flag, given) = if needs || degc.is_finite() { self.limits.of(degc) } else { (true, true) };
            let usable = given && (degc.is_finite() || !needs);
            let here = if usable {
                known.entry(degc.to_bits()).or_insert_with(|| self.here(if needs { degc } else { 0.0 }, count)).as_ref()
            } else {
                None
            };
            let whole_run = self.daily_run(&block.time[row..end]);
            let daily_nt = if wants { self.daily_change_nt(block.time[row], degc) } else { [Vector3::zeros(); 2] };
            let reason = if degc.is_finite() { Flags::TEMPERATURE } else { Flags::NO_TEMPERATURE };
            let taken = here.map_or_else(Vec::new, |here| self.taken_off(block, row..end, &here.at.offset_ent));
            let begin = row;
            for row in row..end {
                let Some(here) = here else {
                    block.take_away(row, reason);
                    continue;
                };
                if !without_flag {
                    block.flags[row] |= reason.0;
                }
                let taken = taken.get(row - begin);
                let raw = block.vector(row) - taken.map_or_else(Vector3::zeros, |taken| Vector3::from(taken.sum_ent));
                let reading = Reading(raw.into());
                let raw = if linear { raw } else { Vector3::from(self.calibration.linearised_ent(reading)) };
                let measured = raw - here.at.offset_ent;
                let field = here.at.matrix * measured;
                block.put(row, &field);
                let of_files = here.back.map_or(field, |back| back * field);
                if field.iter().all(|component| component.is_finite())
                    && (self.calibration.is_beyond(reading, &of_files) || taken.is_some_and(|taken| taken.beyond))
                {
                    block.flags[row] |= Flags::FIELD.0;
                }
                if wants {
                    let noise2 = self.noise.as_ref().map_or(f64::NAN, |n| n.variance_ent2(block.mode[row], block.range[row]));
                    let [daily_nt, sum_nt] = if whole_run { daily_nt } else { self.daily_change_nt(block.time[row], degc) };
                    let change = here.matrix_change * measured - here.at.matrix * here.offset_change_ent - daily_nt;
                    let by_thermistor = change * here.std_degc;
                    #[expect(clippy::cast_possible_truncation, reason = "uncertainties need few digits")]
                    (0..3).for_each(|i| block.thermistor_nt[row][i] = by_thermistor[i] as f32);
                    // The offset of the thermistor is in the temperatures at all midnights before as well.
                    let change_of_all = change - sum_nt;
                    let mut common = here.at.covariance_nt2(&measured);
                    for by_ent in taken.iter().flat_map(|taken| &taken.uncertain_ent) {
                        let by = here.at.matrix * Vector3::from(*by_ent);
                        SYMMETRIC.into_iter().zip(&mut common).for_each(|((i, k), sum)| *sum += by[i] * by[k]);
                    }
                    for (element, (i, k)) in SYMMETRIC.into_iter().enumerate() {
                        let own = here.unit_noise[element] * noise2 + by_thermistor[i] * by_thermistor[k];
                        let of_all = change_of_all[i] * change_of_all[k];
                        let common = common[element] + of_all * self.t_off_std_degc * self.t_off_std_degc;
                        #[expect(clippy::cast_possible_truncation, reason = "variances need few digits")]
                        {
                            block.own_nt2[row][element] = own as f32;
                            block.common_nt2[row][element] = common as f32;
                        }
                    }
                }
            }
            row = end;
        }
    }
}

/// A matrix for a range and some time, in place of ground files.
#[derive(Clone, Debug, PartialEq)]
pub struct MatrixEntry {
    /// From when on.
    pub from: Tt2000,
    /// Until when, not of it.
    pub to: Tt2000,
    /// Range index; all ranges without one.
    pub range: Option<u8>,
    /// The calibration: subtracted offset (enT), matrix, their covariance.
    pub at: AtTemperature,
    /// Added behind the matrix, nT.
    pub added_nt: Vector3<f64>,
}

/// Matrices by range and time (as IMAP MAG and CHAMP keep them).
#[derive(Clone, Debug, PartialEq)]
pub struct MatrixStep {
    /// The matrices.
    pub entries: Vec<MatrixEntry>,
    /// Noise; absent if no uncertainties are wanted.
    pub noise: Option<ReadingNoise>,
}

impl Step for MatrixStep {
    fn apply(&self, block: &mut Block) {
        let wants = self.noise.is_some() && !block.own_nt2.is_empty();
        for row in 0..block.len() {
            let (time, range) = (block.time[row], block.range[row]);
            let holds = |e: &&MatrixEntry| (e.from..e.to).contains(&time) && e.range.is_none_or(|r| r == range);
            let Some(entry) = self.entries.iter().find(holds) else {
                block.take_away(row, Flags::TIME);
                continue;
            };
            let measured = block.vector(row) - entry.at.offset_ent;
            block.put(row, &(entry.at.matrix * measured + entry.added_nt));
            if wants {
                let noise2 = self.noise.as_ref().map_or(f64::NAN, |n| n.variance_ent2(block.mode[row], block.range[row]));
                let square = entry.at.matrix * entry.at.matrix.transpose();
                let common = entry.at.covariance_nt2(&measured);
                for (element, place) in SYMMETRIC.into_iter().enumerate() {
                    #[expect(clippy::cast_possible_truncation, reason = "variances need few digits")]
                    {
                        block.own_nt2[row][element] = (square[place] * noise2) as f32;
                        block.common_nt2[row][element] = common[element] as f32;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::field_calibration::{Coefficient, Coefficients, FieldRange, MatrixForm, Parameter};
    use nalgebra::DMatrix;

    /// Slopes of the offsets, enT/K.
    const SLOPES: [f64; 3] = [0.3, -0.2, 0.1];

    /// A sensor of one nT/enT along right angles, whose offsets alone follow the temperature, for fields of up to 100 nT; all of it is exact.
    fn step(t_off_std_degc: f64) -> GroundStep {
        let mut coefficients = Vec::new();
        for i in 0..3 {
            for (parameter, power, value) in [
                (Parameter::Offset(i), 0, 0.0),
                (Parameter::Offset(i), 1, SLOPES[i]),
                (Parameter::Sigma(i), 0, 1.0),
                (Parameter::Xi(i), 0, 90.0),
            ] {
                coefficients.push(Coefficient { parameter, power, value });
            }
        }
        let n = coefficients.len();
        let parts = Coefficients {
            matrix: Some(MatrixForm::Alignment(crate::data::convention::Convention::Rosetta)),
            coefficients,
            covariance: Some(DMatrix::zeros(n, n)),
            range: Some(FieldRange { turn: Matrix3::identity(), limits_nt: [[-100.0, 100.0]; 3] }),
            ..Coefficients::default()
        };
        GroundStep {
            calibration: FieldCalibration::new(parts).unwrap(),
            effects: None,
            thermometer: Thermometer { coefficients: vec![0.0, 10.0], t_off_degc: 0.0 },
            t_off_std_degc,
            limits: Limits { valid_degc: [-50.0, 50.0], kept_degc: [-50.0, 50.0] },
            noise: Some(ReadingNoise { std_ent: vec![0.0], step_ent: vec![0.0] }),
            daily: Vec::new(),
            frame: None,
        }
    }

    /// Readings along x at 10 °C.
    fn readings(x_ent: &[f64]) -> Block {
        let n = x_ent.len();
        Block {
            time: (0..n as i64).collect(),
            field: [x_ent.to_vec(), vec![0.0; n], vec![0.0; n]],
            thermistor: vec![100.0; n],
            t_degc: vec![10.0; n],
            mode: vec![0; n],
            range: vec![0; n],
            flags: vec![0; n],
            own_nt2: vec![[0.0; 6]; n],
            thermistor_nt: vec![[0.0; 3]; n],
            common_nt2: vec![[0.0; 6]; n],
            ..Block::default()
        }
    }

    #[test]
    fn the_offset_of_the_thermistor_is_uncertain_in_all_vectors_alike() {
        for std in [0.0, 0.5] {
            let mut block = readings(&[50.0, -20.0]);
            step(std).apply(&mut block);
            for found in &block.common_nt2 {
                for (element, (i, k)) in SYMMETRIC.into_iter().enumerate() {
                    // The field falls by the slope of the offset with every kelvin.
                    let wanted = std * std * SLOPES[i] * SLOPES[k];
                    assert!((f64::from(found[element]) - wanted).abs() < 1e-7, "{std} {i} {k}: {found:?}");
                }
            }
        }
    }

    /// The constant of a joined day is made of temperatures that all have the same offset, and falls or rises with it.
    #[test]
    fn the_offset_of_the_thermistor_acts_in_the_constant_of_a_daily_model_too() {
        let line = |slope: f64| TemperaturePolynomial {
            coefficients: vec![0.0, slope],
            covariance: DMatrix::zeros(0, 0),
            valid_degc: [-50.0, 50.0],
        };
        let sum_nt_per_k = [0.7, -0.4, 0.2];
        let daily = vec![DailySlopes { span: 0..1, polynomials: [line(0.05), line(0.0), line(-0.3)], sum_nt_per_k }];
        let mut block = readings(&[50.0, -20.0]);
        GroundStep { daily, ..step(0.5) }.apply(&mut block);
        // By one kelvin the field falls by the slopes of offset and model, and by the change of the constant, where the model acts.
        let falls = [[0.3 + 0.05 + 0.7, -0.2 - 0.4, 0.1 - 0.3 + 0.2], SLOPES];
        for (found, falls) in block.common_nt2.iter().zip(falls) {
            for (element, (i, k)) in SYMMETRIC.into_iter().enumerate() {
                let wanted = 0.25 * falls[i] * falls[k];
                assert!((f64::from(found[element]) - wanted).abs() < 1e-7, "{i} {k}: {found:?}");
            }
        }
    }

    #[test]
    fn a_field_outside_the_range_of_the_calibration_is_kept_and_has_its_flag() {
        // 3 enT of offset along x at 10 °C.
        let mut block = readings(&[102.0, 104.0, -96.0, -98.0, f64::NAN]);
        step(0.0).apply(&mut block);
        assert_eq!(block.flags, [0, Flags::FIELD.0, 0, Flags::FIELD.0, 0]);
        assert!((block.field[0][1] - 101.0).abs() < 1e-9);
    }
}
