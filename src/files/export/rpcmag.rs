//! A ground calibration file in the style of Rosetta RPC-MAG (RO-IGEP-TR0028 sections 3.3 and 4.2.3.2), and its reader.
//!
//! The labels are those of the report. The file is TOML, and its numbers have 17 significant digits, so that reading it back loses
//! nothing. What the report leaves open, it states: the convention of ω, where the offset acts, its sign and unit, and its residual field
//! `B_RES`, since the report subtracts it from `A_0 + A_1 T` in section 3.3.1.1 and leaves it out in section 4.2.3.2.

mod covariance;
mod read;

use super::{Exported, Options, Source};
use crate::data::across::LinearScope;
use crate::data::apply::{Apply, OffsetQuantity};
use crate::data::convention::Convention;
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::reference::Reference;
use crate::data::result::{Covariance, Rows};
use crate::data::run::Location;
use crate::files::ccr::run_id_is_safe;
use crate::files::parameter::{self, Tcf, ThermistorFile, Tof, Tpf};
use crate::files::text::quoted;
use crate::fit::FitError;
use crate::model::alignment;
use crate::model::polynomial::TemperaturePolynomial;
use covariance::Known;
pub use covariance::is_named;
use nalgebra::DMatrix;
pub use read::{parse, read, read_alone};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// The ground calibration of a sensor, T the calibrated sensor temperature `T_c` in °C.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RpcMag {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Lowest and highest temperature for which it holds, °C.
    pub valid_degc: [f64; 2],
    /// `A_0`, `A_1`: `B_off = A_0 + A_1 T - B_RES`, enT and enT/K.
    pub a: [[f64; 3]; 2],
    /// `B_RES`: residual field of the coil system in `A_0`, enT; zero if the sensor was turned.
    pub b_res_ent: [f64; 3],
    /// `SIGMA_00`, `SIGMA_01`: sensitivities at the centre, nT/enT and nT/enT/K.
    pub sigma: [[f64; 3]; 2],
    /// `XI_10`, `XI_11`: angles ξ¹_xy, ξ¹_xz, ξ¹_yz off-centre, degrees and degrees/K.
    pub xi: [[f64; 3]; 2],
    /// `K_0`, `K_1`, `K_2`: the rows of `K⁻¹`, `ω⁰(T) = Q(ξ¹(T)) K⁻¹`.
    pub k_inverse: Rows,
    /// `T_0` to `T_3`: `T_r = Σ T_k U^k`, °C and V.
    pub thermistor: [f64; 4],
    /// `T_OFF`: `T_c = T_r - T_OFF`, °C.
    pub t_off_degc: f64,
    /// Standard uncertainties by label, as far as they are known.
    pub std: BTreeMap<String, Vec<f64>>,
    /// How the sensor stands in its reference cube, if that is stated.
    pub reference: Option<Reference>,
    /// Covariance of the values from `A_0` to `K_2`, named `A_0_x` and so on; absent where one of them is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Covariance>,
    /// Lowest and highest field along the sensor axes for which it was made, nT.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub valid_field_nt: Option<[[f64; 2]; 3]>,
    /// Model files whose effects were taken off the readings of the runs before.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub known_effects: Vec<String>,
    /// What qualifies the values of the files that it was made from.
    #[serde(flatten)]
    pub told: Told,
}

/// Label, number of values, what it is.
const LABELS: [(&str, usize, &str); 15] = [
    ("A_0", 3, "enT; x, y, z"),
    ("A_1", 3, "enT/K; x, y, z"),
    ("B_RES", 3, "enT; x, y, z: residual field of the coil system, B_off = A_0 + A_1 T - B_RES"),
    ("SIGMA_00", 3, "nT/enT; x, y, z: sigma = SIGMA_00 + SIGMA_01 T"),
    ("SIGMA_01", 3, "nT/enT/K; x, y, z"),
    ("XI_10", 3, "degrees; xy, xz, yz: xi = XI_10 + XI_11 T, where the temperature cycle was measured"),
    ("XI_11", 3, "degrees/K; xy, xz, yz"),
    ("K_0", 3, "first row of K^-1: omega = Q(xi) K^-1"),
    ("K_1", 3, "second row of K^-1"),
    ("K_2", 3, "third row of K^-1"),
    ("T_0", 1, "degC: T_r = T_0 + T_1 U + T_2 U^2 + T_3 U^3, U in V"),
    ("T_1", 1, "degC/V"),
    ("T_2", 1, "degC/V^2"),
    ("T_3", 1, "degC/V^3"),
    ("T_OFF", 1, "degC: T = T_r - T_OFF"),
];
/// What other programs would have to guess.
const STATEMENTS: [(&str, &str); 5] = [
    ("omega_convention", "Rosetta"),
    ("offset_acts", "before the matrix"),
    ("offset_sign", "subtracted"),
    ("offset_unit", "enT"),
    ("model", "B = omega sigma (B_r - B_off)"),
];
const FORMAT: &str = "RPCMAG";
/// In version 1 this program wrote the angles between the sensor axes, which belong into the formula of the other convention.
const VERSION: u32 = 2;
const REMEDY: &str = "take the file from its source again, or correct it";

/// The table `[apply]`.
fn how_it_is_applied() -> Apply {
    Apply {
        omega_formula: Some("omega = Q(xi) inverse(K), the rows of inverse(K) are K_0, K_1, K_2".to_owned()),
        ..Apply::to_sensor_frame(Convention::Rosetta, Some(OffsetQuantity::BOff))
    }
}

impl RpcMag {
    /// The values of a label.
    fn values(&self, label: &str) -> Vec<f64> {
        match label {
            "A_0" => self.a[0].to_vec(),
            "A_1" => self.a[1].to_vec(),
            "B_RES" => self.b_res_ent.to_vec(),
            "SIGMA_00" => self.sigma[0].to_vec(),
            "SIGMA_01" => self.sigma[1].to_vec(),
            "XI_10" => self.xi[0].to_vec(),
            "XI_11" => self.xi[1].to_vec(),
            "K_0" => self.k_inverse[0].to_vec(),
            "K_1" => self.k_inverse[1].to_vec(),
            "K_2" => self.k_inverse[2].to_vec(),
            "T_0" => vec![self.thermistor[0]],
            "T_1" => vec![self.thermistor[1]],
            "T_2" => vec![self.thermistor[2]],
            "T_3" => vec![self.thermistor[3]],
            _ => vec![self.t_off_degc],
        }
    }

    /// Its text.
    ///
    /// # Errors
    /// An origin that has no text form.
    pub fn to_text(&self, provenance: &crate::data::provenance::Provenance) -> Result<String, serde_json::Error> {
        let numbers = |values: &[f64]| {
            let list: Vec<String> = values.iter().map(|v| format!("{v:.16e}")).collect();
            if let [one] = list.as_slice() { one.clone() } else { format!("[{}]", list.join(", ")) }
        };
        let mut out = format!(
            "# calfit {FORMAT} ground calibration file, labels of RO-IGEP-TR0028 section 3.3\nformat = \"{FORMAT}\"\nversion = {VERSION}\n"
        );
        let _ = writeln!(out, "sensor = {}\nmode = {}", quoted(&self.sensor), quoted(&self.mode));
        for (key, statement) in STATEMENTS {
            let _ = writeln!(out, "{key} = {}", quoted(statement));
        }
        let _ = writeln!(out, "valid_degc = {}", numbers(&self.valid_degc));
        for (label, _, what) in LABELS {
            let _ = writeln!(out, "\n# {what}\n{label} = {}", numbers(&self.values(label)));
        }
        if let Some(limits) = &self.valid_field_nt {
            let rows: Vec<String> = limits.iter().map(|row| numbers(row)).collect();
            let what = "lowest and highest field along the sensor axes, nT; x, y, z";
            let _ = writeln!(out, "\n# {what}\nvalid_field_nt = [{}]", rows.join(", "));
        }
        if !self.known_effects.is_empty() {
            let files: Vec<String> = self.known_effects.iter().map(|file| quoted(file)).collect();
            let what = "model files whose effects were taken off the readings before";
            let _ = writeln!(out, "\n# {what}\nknown_effects = [{}]", files.join(", "));
        }
        if !self.told.warnings.is_empty() {
            let notes = serde_json::to_value(&self.told)?;
            let notes = notes.as_object().cloned().unwrap_or_default();
            let _ = write!(out, "\n# what the files that it was made from say against their values\n{}", parameter::toml(&notes));
        }
        let mut tables = serde_json::Map::new();
        tables.insert("apply".to_owned(), serde_json::to_value(how_it_is_applied())?);
        if let Some(covariance) = &self.covariance {
            tables.insert("covariance".to_owned(), serde_json::to_value(covariance)?);
        }
        out.push('\n');
        if let Some(reference) = &self.reference {
            tables.insert("reference".to_owned(), serde_json::to_value(reference)?);
        }
        out.push_str(&parameter::toml(&tables));
        out.push_str("\n# standard uncertainties, coverage factor 1, as far as they are known\n[std]\n");
        for (label, _, _) in LABELS {
            if let Some(std) = self.std.get(label) {
                let _ = writeln!(out, "{label} = {}", numbers(std));
            }
        }
        let mut head = serde_json::to_value(provenance)?;
        if let Some(table) = head.as_object_mut() {
            table.insert("content_sha256".to_owned(), "".into());
        }
        let mut origin = serde_json::Map::new();
        origin.insert("provenance".to_owned(), head);
        out.push_str(&parameter::toml(&origin));
        let hash = parameter::content_hash(&out);
        Ok(out.replacen("content_sha256 = \"\"", &format!("content_sha256 = \"{hash}\""), 1))
    }
}

/// The file of a sensor, as the forms that make several.
pub(super) fn export_all(sources: &[Source], options: &Options) -> Result<Vec<Exported>, Finding> {
    Ok(vec![export(sources, options)?])
}

/// The file of a sensor from its results: TCF, or TPF with K the identity; TOF; THERMISTOR.
///
/// # Errors
/// What it lacks, in words, or why a file does not fit.
pub fn export(sources: &[Source], options: &Options) -> Result<Exported, Finding> {
    for source in sources {
        if !["TCF", "TPF", "TOF", "THERMISTOR"].contains(&source.format()) {
            let rule = format!("holds format {}, of which a ground calibration file takes nothing", source.format());
            return Err(source.refuse(rule, "name TCF (or TPF), TOF and THERMISTOR files"));
        }
    }
    let [tcf, tpf, tof, thermistor] =
        [one(sources, "TCF")?, one(sources, "TPF")?, one(sources, "TOF")?, one(sources, "THERMISTOR")?];
    let mut lacking: Vec<&str> = Vec::new();
    if let (Some(tpf), true, false) = (tpf, tcf.is_some(), options.at_centre) {
        let rule = "is not needed beside the TCF, which holds its polynomials";
        return Err(tpf.refuse(rule, "leave it out"));
    }
    if let (Some(tcf), true) = (tcf, options.at_centre) {
        return Err(tcf.refuse("comes from a position beside the centre", "leave --at-centre out"));
    }
    if tcf.is_none() && tpf.is_none() {
        lacking.push("SIGMA_00, SIGMA_01, XI_10, XI_11 lack a TCF file, or a TPF file with --at-centre");
    }
    if tcf.is_none() && !options.at_centre {
        lacking.push(
            "K_0, K_1, K_2 lack a TCF file (`calfit thermal --centre`), or --at-centre where the runs were made at the centre",
        );
    }
    let mut file = RpcMag {
        sensor: String::new(),
        mode: String::new(),
        valid_degc: [f64::NEG_INFINITY, f64::INFINITY],
        a: [[0.0; 3]; 2],
        b_res_ent: [0.0; 3],
        sigma: [[0.0; 3]; 2],
        xi: [[0.0; 3]; 2],
        k_inverse: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        thermistor: [0.0; 4],
        t_off_degc: 0.0,
        std: BTreeMap::new(),
        reference: None,
        covariance: None,
        valid_field_nt: None,
        known_effects: Vec::new(),
        told: Told::of(&sources.iter().flat_map(Source::notes).collect::<Vec<_>>()),
    };
    let mut known = Known::default();
    let mut offset_known = tof.is_some();
    if let Some(source) = tcf {
        let body = source.typed::<Tcf>()?.body;
        file.of(source, [&body.sensor, &body.mode], body.valid_degc)?;
        file.in_scope(source, &body.scope)?;
        let off = &body.off_centre;
        known.together(body.together.as_ref());
        let named = |name: &str| off.coefficients.get(name).cloned().unwrap_or_default();
        file.sigma = file.lines(source, SIGMA, [&body.sigma_x, &body.sigma_y, &body.sigma_z], &body.covariance)?;
        file.xi = file.lines(source, XI, XI.names.map(named).each_ref(), &off.covariance)?;
        file.k_inverse = body.k_inverse;
        file.reference = body.reference.clone();
        for (i, label) in ["K_0", "K_1", "K_2"].into_iter().enumerate() {
            file.std.extend(body.k_inverse_std.map(|s| (label.to_owned(), s[i].to_vec())));
        }
        if let (Some(field), None) = (&body.residual_field, tof) {
            offset_known = true;
            file.a = file.lines(source, B_OR, B_OR.names.map(named).each_ref(), &off.covariance)?;
            file.b_res_ent = field.b_res_ent;
            file.std.extend(field.b_res_std_ent.map(|s| ("B_RES".to_owned(), s.to_vec())));
            known.offset_beside(&off.covariance, field);
        }
    } else if let (Some(source), true) = (tpf, options.at_centre) {
        let body = source.typed::<Tpf>()?.body;
        if body.head.location == Location::OffCentre {
            let rule = "was measured beside the centre of the coil system, and not at it";
            return Err(source.refuse(rule, "take it to the centre with `calfit thermal --centre`, and name the TCF file"));
        }
        file.of(source, [&body.head.sensor, &body.head.mode], body.head.valid_degc)?;
        let refused = |e: FitError| source.refuse(format!("has no form in the Rosetta convention: {e}"), "check its values");
        // The frames of the two conventions are turned against each other.
        let in_rosetta = body.mean_alignment().to_other().ok().map(|converted| converted.alignment);
        file.reference = body.stated_reference().zip(in_rosetta).and_then(|(stated, own)| stated.in_frame_of(&own).ok());
        file.in_scope(source, &body.scope)?;
        let other = alignment::in_other(Convention::BepiColombo, &body.sigma(), &body.xi_deg()).map_err(refused)?;
        known.alignment(&other);
        let (sigma, xi) = (other.sigma, other.xi_deg);
        file.sigma = file.lines(source, SIGMA, sigma.each_ref().map(|p| &p.coefficients), &named(SIGMA.names, &sigma))?;
        file.xi = file.lines(source, XI, xi.each_ref().map(|p| &p.coefficients), &named(XI.names, &xi))?;
    }
    if let Some(source) = tof {
        let body = source.typed::<Tof>()?.body;
        file.of(source, [&body.head.sensor, &body.head.mode], body.head.valid_degc)?;
        file.a = file.lines(source, B_OFF, [&body.b_off_x, &body.b_off_y, &body.b_off_z], &body.head.covariance)?;
        known.offset(&body.head.covariance);
    }
    if !offset_known {
        lacking.push("A_0, A_1 lack a TOF file, or a TCF file made with --offset");
    }
    match thermistor {
        None => lacking.push("T_0 to T_3 and T_OFF lack a THERMISTOR file (`calfit thermistor --reference`)"),
        Some(source) => {
            let body = source.typed::<ThermistorFile>()?.body;
            if let Some(other) = body.polynomial.sensor.as_ref().filter(|own| **own != file.sensor) {
                let rule = format!("is of sensor {other}, the other files are of {}", file.sensor);
                return Err(source.refuse(rule, "name the THERMISTOR file of the same sensor"));
            }
            let polynomial = &body.polynomial;
            if polynomial.signal != "u" || polynomial.order > 3 {
                let rule = format!("is of order {} in {}; T_0 to T_3 are a cubic in V", polynomial.order, polynomial.signal_unit);
                return Err(source.refuse(rule, "fit again with `calfit thermistor --signal u --order 3`"));
            }
            file.valid_degc = body.within(file.valid_degc).ok_or_else(|| {
                let [low, high] = body.range_degc();
                let rule = format!("tells temperatures from {low:.1} to {high:.1} °C, at which the other files do not hold");
                source.refuse(rule, "name the table of the thermistor that the sensor has")
            })?;
            for (k, c) in polynomial.coefficients.iter().enumerate() {
                file.thermistor[k] = *c;
                let std = polynomial.coefficients_std.get(k).filter(|s| s.is_finite());
                file.std.extend(std.map(|s| (format!("T_{k}"), vec![*s])));
            }
            match &body.reference {
                None => lacking.push("T_OFF lacks the comparison with a reference thermometer in the THERMISTOR file (`calfit thermistor --reference`)"),
                Some(reference) => {
                    file.t_off_degc = reference.offset_degc;
                    file.std.extend(reference.offset_std_degc.map(|s| ("T_OFF".to_owned(), vec![s])));
                }
            }
        }
    }
    file.covariance = known.covariance();
    if !lacking.is_empty() {
        let files: Vec<&str> = sources.iter().map(Source::name).collect();
        return Err(Finding::error(
            &files.join(", "),
            lacking.join("; "),
            "name the files that are missing; for a report `[[thermistor]]` of campaign.toml",
        ));
    }
    let name = if run_id_is_safe(&file.sensor) {
        format!("RPCMAG_GND_CALIB_{}.TXT", file.sensor)
    } else {
        return Err(Finding::error(
            sources[0].name(),
            "its sensor cannot be part of a file name",
            "use letters, digits, `-`, `_` and `.`",
        )
        .found(file.sensor.as_bytes()));
    };
    let text = file
        .to_text(&options.provenance)
        .map_err(|e| Finding::error(&name, format!("the result has no text form: {e}"), "report this"))?;
    Ok(Exported { name, text })
}

/// The known covariances of polynomials by their names.
fn named(names: [&str; 3], polynomials: &[TemperaturePolynomial; 3]) -> BTreeMap<String, Vec<Vec<f64>>> {
    let rows = |c: &DMatrix<f64>| c.row_iter().map(|row| row.iter().copied().collect()).collect();
    let known = names.into_iter().zip(polynomials).filter(|(_, p)| !p.covariance.is_empty());
    known.map(|(name, p)| (name.to_owned(), rows(&p.covariance))).collect()
}

/// Labels of a family with the names of its polynomials.
#[derive(Clone, Copy)]
struct Family {
    labels: [&'static str; 2],
    names: [&'static str; 3],
    option: &'static str,
}

const SIGMA: Family = Family { labels: ["SIGMA_00", "SIGMA_01"], names: ["sigma_x", "sigma_y", "sigma_z"], option: "sigma=1" };
const XI: Family = Family { labels: ["XI_10", "XI_11"], names: ["xi_xy", "xi_xz", "xi_yz"], option: "xi=1" };
const B_OR: Family = Family { labels: ["A_0", "A_1"], names: ["b_or_x", "b_or_y", "b_or_z"], option: "b_or=1" };
const B_OFF: Family = Family { labels: ["A_0", "A_1"], names: ["b_off_x", "b_off_y", "b_off_z"], option: "b_off=1" };

impl RpcMag {
    /// Takes sensor, mode and temperatures of a file, which must be those of the files before it.
    fn of(&mut self, source: &Source, [sensor, mode]: [&String; 2], valid_degc: [f64; 2]) -> Result<(), Finding> {
        if self.sensor.is_empty() && self.mode.is_empty() {
            (self.sensor, self.mode) = (sensor.clone(), mode.clone());
        }
        if (&self.sensor, &self.mode) != (sensor, mode) {
            let rule = format!("is of sensor `{sensor}` mode `{mode}`, another file of `{}` mode `{}`", self.sensor, self.mode);
            return Err(source.refuse(rule, "name files of one sensor in one mode"));
        }
        self.valid_degc = [self.valid_degc[0].max(valid_degc[0]), self.valid_degc[1].min(valid_degc[1])];
        if self.valid_degc[0] > self.valid_degc[1] {
            return Err(
                source.refuse("holds for other temperatures than the other files", "name files whose temperatures overlap")
            );
        }
        Ok(())
    }

    /// Takes what the coefficients hold for, beside temperatures.
    fn in_scope(&mut self, source: &Source, scope: &LinearScope) -> Result<(), Finding> {
        if scope.linearisation.is_some() {
            let rule = "holds for linearised readings, for which a ground calibration file has no place";
            return Err(source.refuse(rule, "calibrate without a linearisation, or apply the file itself"));
        }
        self.valid_field_nt = scope.valid_field_nt;
        self.known_effects.clone_from(&scope.known_effects);
        Ok(())
    }

    /// Constants and slopes of three polynomials, their uncertainties into `std`.
    fn lines(
        &mut self,
        source: &Source,
        family: Family,
        polynomials: [&Vec<f64>; 3],
        covariance: &BTreeMap<String, Vec<Vec<f64>>>,
    ) -> Result<[[f64; 3]; 2], Finding> {
        let mut lines = [[0.0; 3]; 2];
        let mut std = Some([vec![0.0; 3], vec![0.0; 3]]);
        for (i, polynomial) in polynomials.into_iter().enumerate() {
            let name = family.names[i];
            if polynomial.is_empty() {
                return Err(source.refuse(
                    format!("{} lack {name}, which is not in it", family.labels.join(", ")),
                    "fit it again with all components",
                ));
            }
            if polynomial.len() > 2 {
                let rule = format!("{name} has order {}; {} are a straight line", polynomial.len() - 1, family.labels.join(", "));
                return Err(source.refuse(rule, format!("fit again with `calfit thermal --order {}`", family.option)));
            }
            let variances = covariance.get(name).filter(|c| c.len() == polynomial.len());
            for k in 0..2 {
                lines[k][i] = polynomial.get(k).copied().unwrap_or(0.0);
                // A slope that was not fitted has no uncertainty.
                let variance = variances.map(|c| c.get(k).and_then(|row| row.get(k)).copied().unwrap_or(0.0));
                match (variance, &mut std) {
                    (Some(v), Some(std)) if v.is_finite() && v >= 0.0 => std[k][i] = v.sqrt(),
                    _ => std = None,
                }
            }
        }
        if let Some(std) = std {
            self.std.extend(family.labels.iter().map(|l| (*l).to_owned()).zip(std));
        }
        Ok(lines)
    }
}

/// The only file of a format.
fn one<'a>(sources: &'a [Source], format: &str) -> Result<Option<&'a Source>, Finding> {
    let mut all = sources.iter().filter(|s| s.format() == format);
    match (all.next(), all.next()) {
        (_, Some(second)) => {
            Err(second.refuse(format!("is a second {format} file"), "name one per sensor and export the sensors one by one"))
        }
        (first, None) => Ok(first),
    }
}
