//! The reader of ground calibration files, and what none of them may say.

use super::{FORMAT, LABELS, REMEDY, RpcMag, STATEMENTS, VERSION, how_it_is_applied};
use crate::data::apply::Apply;
use crate::data::convention::Convention;
use crate::data::error::{Finding, Severity};
use crate::data::note::{Note, Told};
use crate::data::reference::{Reference, is_rotation};
use crate::data::result::Covariance;
use crate::files::parameter::{self, is_sound_table};
use crate::files::source::{Digested, read_whole};
use crate::files::text::{Group, Keys, decode};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Reads a ground calibration file; notes go to `findings`, and what the file says against its own values. The hash is compared where the file
/// has one.
///
/// # Errors
/// What is wrong with it, with its place: a missing label, too few values, another convention, a hash that does not match.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(RpcMag, Digested), Finding> {
    let (file, digested) = read_alone(path, findings)?;
    let name = path.display().to_string();
    let told = file.told.with_values_of(&name).into_iter();
    findings.extend(told.map(|note| {
        let rule = Note { of: None, ..note }.to_string();
        Finding::error(&name, rule, "make the file again from sound runs, or judge what it means for its use")
            .weighing(Severity::Warning)
    }));
    Ok((file, digested))
}

/// The same without what the file says against its own values, which stands in it.
///
/// # Errors
/// As [`read`].
pub fn read_alone(path: &Path, findings: &mut Vec<Finding>) -> Result<(RpcMag, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    Ok((parse(&path.display().to_string(), &decode(&bytes), findings)?, digested))
}

/// Parses the text of a ground calibration file, `file` in messages.
///
/// # Errors
/// As [`read`].
pub fn parse(file: &str, text: &str, findings: &mut Vec<Finding>) -> Result<RpcMag, Finding> {
    let keys = Keys::parse(file, 1, text.to_owned())?;
    let root = keys.root();
    let needed = |key: &str| -> Result<String, Finding> { root.text(key)?.ok_or_else(|| missing(file, key)) };
    if needed("format")? != FORMAT {
        return Err(root.refuse("format", &format!("is not {FORMAT}"), "name a ground calibration file"));
    }
    let version = root.whole("version")?;
    let tool = root.group("provenance")?.map(|p| p.text("tool")).transpose()?.flatten();
    match version {
        Some(VERSION) => {}
        // Other programs may have written version 1 with the angles that it states.
        Some(1) if tool.as_deref() != Some("calfit") => {}
        Some(1) => {
            let rule = "is 1: in such files of calfit every misalignment has the wrong sign";
            return Err(root.refuse("version", rule, "export it again from the files that it names"));
        }
        _ => return Err(root.refuse("version", &format!("is not {VERSION}"), "use the program that wrote it")),
    }
    match text.lines().find_map(|l| l.strip_prefix("content_sha256 = ")) {
        Some(stated) if stated.trim_matches('"') != parameter::content_hash(text) => {
            let rule = "was changed after it was written: its hash does not match";
            return Err(Finding::error(file, rule, "take the original, or export again"));
        }
        _ => {}
    }
    for (key, statement) in STATEMENTS {
        if needed(key)? != statement {
            return Err(root.refuse(key, &format!("is not `{statement}`"), "convert the values, or name a file that states it"));
        }
    }
    let mut values: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut std = BTreeMap::new();
    let uncertain = root.group("std")?;
    for (label, count, _) in LABELS {
        values.insert(label, of_label(&root, label, count)?.ok_or_else(|| missing(file, label))?);
        if let Some(list) = uncertain.as_ref().map(|group| of_label(group, label, count)).transpose()?.flatten() {
            std.insert(label.to_owned(), list);
        }
    }
    let labels = || LABELS.iter().map(|(label, _, _)| *label);
    let known = [
        "format",
        "version",
        "sensor",
        "mode",
        "valid_degc",
        "valid_field_nt",
        "known_effects",
        "warnings",
        "warning_kinds",
        "apply",
        "covariance",
        "reference",
        "std",
        "provenance",
    ];
    let stated = STATEMENTS.iter().map(|(key, _)| *key);
    findings.extend(root.unknown(&known.into_iter().chain(stated).chain(labels()).collect::<Vec<_>>()));
    if let Some(group) = &uncertain {
        findings.extend(group.unknown(&labels().collect::<Vec<_>>()));
    }
    let valid = root.numbers("valid_degc")?.ok_or_else(|| missing(file, "valid_degc"))?;
    let [low, high] = valid[..] else { return Err(root.refuse("valid_degc", "must be two numbers", REMEDY)) };
    if low > high {
        return Err(root.refuse("valid_degc", "must rise", REMEDY));
    }
    is_sound_table(file, keys.table(), &[])?;
    let lists: Lists = toml_edit::de::from_str(text)
        .map_err(|e| Finding::error(file, format!("is no ground calibration file: {}", e.message()), REMEDY))?;
    if lists.apply.is_some_and(|stated| !stated.agrees_with(&how_it_is_applied())) {
        return Err(root.refuse("apply", "says another way from the reading to the field than the rest of the file", REMEDY));
    }
    let three = |label: &str| -> [f64; 3] {
        std::array::from_fn(|i| values.get(label).and_then(|v| v.get(i)).copied().unwrap_or(f64::NAN))
    };
    let one = |label: &str| three(label)[0];
    let calibration = RpcMag {
        sensor: needed("sensor")?,
        mode: needed("mode")?,
        valid_degc: [low, high],
        a: [three("A_0"), three("A_1")],
        b_res_ent: three("B_RES"),
        sigma: [three("SIGMA_00"), three("SIGMA_01")],
        xi: [three("XI_10"), three("XI_11")],
        k_inverse: [three("K_0"), three("K_1"), three("K_2")],
        thermistor: [one("T_0"), one("T_1"), one("T_2"), one("T_3")],
        t_off_degc: one("T_OFF"),
        std,
        reference: root.group("reference")?.map(|group| reference(&group)).transpose()?,
        covariance: lists.covariance,
        valid_field_nt: lists.valid_field_nt,
        known_effects: lists.known_effects,
        told: lists.told,
    };
    calibration.is_consistent(&root)?;
    Ok(calibration)
}

impl RpcMag {
    /// Refuses values of no sensor, a covariance of other values, and statements of how it is applied that are not those of its formula.
    fn is_consistent(&self, root: &Group) -> Result<(), Finding> {
        for (row, label) in ["K_0", "K_1", "K_2"].into_iter().enumerate() {
            if self.k_inverse[row][..row].iter().any(|v| *v != 0.0) {
                return Err(root.refuse(label, "must be zero before the diagonal, as row of an upper triangular matrix", REMEDY));
            }
            if self.k_inverse[row][row] <= 0.0 {
                return Err(root.refuse(
                    label,
                    "must be positive on the diagonal, as the inverse of angles between axes",
                    REMEDY,
                ));
            }
        }
        let at = |[c0, c1]: [[f64; 3]; 2], t: f64| -> [f64; 3] { std::array::from_fn(|i| c0[i] + c1[i] * t) };
        for t in self.valid_degc {
            if at(self.sigma, t).iter().any(|s| *s <= 0.0) {
                return Err(root.refuse("SIGMA_00", &format!("must give positive sensitivities, also at {t} °C"), REMEDY));
            }
            if Convention::Rosetta.omega(at(self.xi, t)).is_err() {
                return Err(root.refuse("XI_10", &format!("are angles that no three axes have between them at {t} °C"), REMEDY));
            }
        }
        if let Some(covariance) = &self.covariance {
            let group = root.group("covariance")?.ok_or_else(|| root.missing("covariance"))?;
            let own = &covariance.parameters;
            if let Some(name) = own.iter().find(|name| !is_value(name)) {
                return Err(group.refuse("parameters", &format!("hold `{name}`, which no such file has"), REMEDY));
            }
            if covariance.matrix.len() != own.len() {
                return Err(group.refuse("matrix", "does not have a row for every parameter", REMEDY));
            }
        }
        Ok(())
    }
}

/// Whether a name of a covariance is that of a value of such a file: `A_0_x`, `XI_10_xy`.
fn is_value(name: &str) -> bool {
    name.rsplit_once('_').is_some_and(|(label, component)| {
        LABELS.iter().any(|(own, count, _)| *own == label && *count == 3)
            && ["x", "y", "z", "xy", "xz", "yz"].contains(&component)
    })
}

/// The table `[reference]`.
fn reference(group: &Group) -> Result<Reference, Finding> {
    let rotation = group.three_rows("rotation")?.ok_or_else(|| group.missing("rotation"))?;
    if !is_rotation(&rotation) {
        return Err(group.refuse("rotation", "is no rotation", REMEDY));
    }
    let from = group.text("from")?.ok_or_else(|| group.missing("from"))?;
    if from != Convention::Rosetta.sensor_frame() {
        return Err(group.refuse("from", "is not the frame of the file", REMEDY));
    }
    let std_deg = group.number("std_deg")?.ok_or_else(|| group.missing("std_deg"))?;
    let stated_for = match group.text("stated_for")? {
        Some(name) => Convention::from_name(&name).ok_or_else(|| group.refuse("stated_for", "is no convention", REMEDY))?,
        None => Convention::Rosetta,
    };
    Ok(Reference { rotation, std_deg, from, stated_for })
}

/// What is a table or a list of lists.
#[derive(Deserialize)]
struct Lists {
    apply: Option<Apply>,
    covariance: Option<Covariance>,
    valid_field_nt: Option<[[f64; 2]; 3]>,
    #[serde(default)]
    known_effects: Vec<String>,
    #[serde(flatten)]
    told: Told,
}

fn missing(file: &str, key: &str) -> Finding {
    Finding::error(file, format!("the key `{key}` is missing"), REMEDY)
}

fn of_label(group: &Group, label: &str, count: usize) -> Result<Option<Vec<f64>>, Finding> {
    if count == 1 {
        return Ok(group.number(label)?.map(|v| vec![v]));
    }
    let list = group.numbers(label)?;
    match list {
        Some(list) if list.len() != count => {
            Err(group.refuse(label, &format!("must be {count} numbers"), "write one per component"))
        }
        list => Ok(list),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_contradicts_itself_is_refused_with_its_key() {
        let sound = include_str!("../../../../fuzz/seeds/rpcmag/ground.toml");
        let refused = |text: &str| parse("GROUND.txt", text, &mut Vec::new()).err().map(|f| f.to_string());
        assert_eq!(refused(sound), None);
        let changed = |from: &str, to: &str| {
            assert!(sound.contains(from), "{from}");
            sound.replace(from, to)
        };
        let with = |table: &str| format!("{sound}\n{table}\n");
        for (text, words) in [
            (changed("XI_10 = [90.1, 89.9, 90.05]", "XI_10 = [10, 170, 90]"), "no three axes"),
            (changed("SIGMA_01 = [1e-5, 2e-5, 1e-5]", "SIGMA_01 = [1e-5, 0.1, 1e-5]"), "positive sensitivities, also at -60"),
            (changed("K_1 = [0, 1, 3e-4]", "K_1 = [0, -1, 3e-4]"), "positive on the diagonal"),
            (changed("valid_degc = [-60, 80]", "valid_degc = [-300, 80]"), "below absolute zero"),
            (changed("A_0 = [0.1, 0.1, 0.1]", "A_0 = [0.1, -0.1, 0.1]"), "std.A_0 is a standard uncertainty and negative"),
            (with("[covariance]\nparameters = [\"A_9_x\"]\nunits = [\"enT\"]\nmatrix = [[1.0]]"), "hold `A_9_x`"),
            (with("[covariance]\nparameters = [\"A_0_x\"]\nunits = [\"enT\"]\nmatrix = [[-1.0]]"), "negative variance"),
            (
                with("[covariance]\nparameters = [\"A_0_x\", \"A_0_y\"]\nunits = []\nmatrix = [[1.0, 2.0], [2.0, 1.0]]"),
                "is no covariance",
            ),
            (
                with("[apply]\nsteps = [\"sigma\", \"omega\", \"subtract_offset\"]\nframe = \"sensor\""),
                "another way from the reading to the field",
            ),
        ] {
            let told = refused(&text);
            assert!(told.as_ref().is_some_and(|t| t.contains(words)), "{words}: {told:?}");
        }
    }
}
