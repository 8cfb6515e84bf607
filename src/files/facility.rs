//! Facility files, TOML: `scale_nt_per_eu`, `offset_nt`, `angles_deg`, and optionally what temperatures do to them, in a table
//! `facility` or `model` or among the keys of the file, with their `covariance` beside it; or all of this in every `[[period]]`, with the
//! times `from` and `to` between which it holds. The files that `calfit coil` writes are among them.

use super::parameter::{self, is_covariance, is_sound_table};
use super::source::read_whole;
use super::text::{Group, Keys, NEAREST, decode};
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Role;
use crate::data::result::Covariance;
use crate::data::start::{NoStart, Start};
use crate::fit::student_factor;
use crate::model::facility::{Facility, FacilityParameters, Period, PeriodSpan};
use std::ops::RangeInclusive;
use std::path::Path;

/// Whether a text is that of a facility file, by a key that no other TOML file but a twin has.
#[must_use]
pub fn is_facility(text: &str) -> bool {
    let key = |line: &str| line.split_once('=').is_some_and(|(key, _)| key.trim() == "scale_nt_per_eu");
    text.lines().any(key)
}

/// Temperatures to which a facility can refer, °C: its coils and its electronics stand in a room, or in the open air.
const REFERENCE_DEGC: RangeInclusive<f64> = -50.0..=60.0;
/// Zero of the Celsius scale in kelvin.
const KELVIN: f64 = 273.15;
/// The axes of coil systems are adjusted to minutes of arc: those of CH-GFZ-TR-2601 deviate from right angles by 0.034 degrees. Beyond this
/// deviation, degrees, the angles are told.
const ADJUSTED_DEG: f64 = 0.5;
/// Beyond this deviation, degrees, which the eye sees, they are angles of no coil system.
const MOST_DEG: f64 = 5.0;

/// Keys that a facility has by itself, or in every period.
const PART: [&str; 12] = [
    "scale_nt_per_eu",
    "offset_nt",
    "angles_deg",
    "scale_per_k",
    "offset_nt_per_k",
    "reference_degc",
    "reference_temperature_degc",
    "rack_scale_per_k",
    "rack_offset_nt_per_k",
    "rack_reference_degc",
    "rack_reference_temperature_degc",
    "covariance",
];

/// A warning for every key of a file of others that is not known. Tables of the laboratory beside the facility are its own, unless their
/// name is nearly that of one that is known.
fn unknown(root: &Group) -> Result<Vec<Finding>, Finding> {
    let with = |further: &[&'static str]| [&PART, further].concat();
    let known = with(&[
        "facility",
        "model",
        "period",
        "valid",
        "undetermined",
        "degrees_of_freedom",
        "quality",
        "warnings",
        "warning_kinds",
    ]);
    let is_table = |name: &str| root.group(name).is_ok_and(|g| g.is_some()) || root.groups(name).is_ok_and(|g| !g.is_empty());
    let names = root.names().into_iter().filter(|name| !known.contains(name));
    let told = root.unknown(&known).into_iter().zip(names);
    let mut findings: Vec<Finding> =
        told.filter(|(finding, name)| !is_table(name) || finding.remedy.contains(NEAREST)).map(|(finding, _)| finding).collect();
    let mut holders = vec![root.group("covariance")?];
    for name in ["facility", "model"] {
        if let Some(table) = root.group(name)? {
            findings.extend(table.unknown(&PART));
            holders.push(table.group("covariance")?);
        }
    }
    for period in root.groups("period")? {
        findings.extend(period.unknown(&with(&["from", "to"])));
        holders.push(period.group("covariance")?);
    }
    findings.extend(holders.into_iter().flatten().flat_map(|table| table.unknown(&["parameters", "units", "matrix"])));
    if let Some(valid) = root.group("valid")? {
        findings.extend(valid.unknown(&["coil_degc", "rack_degc"]));
    }
    Ok(findings)
}

/// Reads a facility file. Keys of a file of others that are not known go to `findings` as warnings.
///
/// # Errors
/// Not TOML, a missing key, values that no coil system has, or a file of this program that was changed.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<Facility, Finding> {
    let (bytes, digested) = read_whole(path)?;
    let shown = path.display().to_string();
    let text = decode(&bytes).into_owned();
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    // A file of this program carries its hash.
    let is_own = text.lines().any(|l| l.starts_with("content_sha256 = "));
    let mut notes = if is_own { parameter::read_any(path)?.told.with_values_of(&name) } else { Vec::new() };
    let keys = Keys::parse(&shown, 1, text)?;
    if !is_own {
        findings.extend(unknown(&keys.root())?);
    }
    let periods = periods(&keys)?;
    let [valid_coil_degc, valid_rack_degc] = match keys.root().group("valid")? {
        Some(valid) => [range(&valid, "coil_degc")?, range(&valid, "rack_degc")?],
        None => [None, None],
    };
    notes.extend(undetermined(&keys.root(), &name)?);
    notes.extend(beside_right_angles(&periods, &name));
    // Tables of others may hold nan; what a facility needs is read as finite numbers.
    is_sound_table(&shown, keys.table(), &keys.root().names())?;
    Ok(Facility { input: digested.input(name).with_role(Role::Facility), periods, valid_coil_degc, valid_rack_degc, notes })
}

/// What turning the sensor does not tell apart from the sensor stays as it was in the facility before.
fn undetermined(root: &Group, file: &str) -> Result<Option<Note>, Finding> {
    let names = root.texts("undetermined")?.unwrap_or_default();
    if names.is_empty() {
        return Ok(None);
    }
    let text = format!(
        "its runs leave undetermined: {}; there it has value and uncertainty of the facility with which they were evaluated, and no \
         uncertainty where that stated none",
        names.join("; ")
    );
    let note = Note { of: Some(file.to_owned()), ..Note::new(NoteKind::Facility, text) };
    Ok(Some(note.with_remedy("make it with --facility and the covariance of a scalar calibration")))
}

/// By how much angles deviate from right ones, degrees.
fn deviation_deg(angles_deg: [f64; 3]) -> f64 {
    angles_deg.iter().map(|angle| (angle - 90.0).abs()).fold(0.0, f64::max)
}

/// Angles that are possible, and far from those of coil systems.
fn beside_right_angles(periods: &[Period], file: &str) -> Option<Note> {
    let most_deg = periods.iter().map(|period| deviation_deg(period.part.angles_deg)).fold(0.0, f64::max);
    if most_deg <= ADJUSTED_DEG {
        return None;
    }
    let text = format!(
        "the angles between its coils deviate from right angles by up to {most_deg:.3}°; those of coil systems do by minutes of arc"
    );
    let note = Note { of: Some(file.to_owned()), ..Note::new(NoteKind::Facility, text) };
    Some(note.with_remedy("check that `angles_deg` is in degrees: 2 minutes of arc are 0.0333"))
}

/// The temperature to which values refer, °C, under one of two keys.
fn reference(table: &Group, one: &str, other: &str) -> Result<Option<f64>, Finding> {
    let first = table.number(one)?.map(|degc| (one, degc));
    let Some((key, degc)) = first.or(table.number(other)?.map(|degc| (other, degc))) else { return Ok(None) };
    // Below absolute zero it is refused as in any table.
    if REFERENCE_DEGC.contains(&degc) || degc < -KELVIN {
        return Ok(Some(degc));
    }
    let rule = format!(
        "is no temperature of a coil system or of its electronics, which stand at {} to {} °C",
        REFERENCE_DEGC.start(),
        REFERENCE_DEGC.end()
    );
    let from_kelvin = degc - KELVIN;
    let remedy = if REFERENCE_DEGC.contains(&from_kelvin) {
        format!("write it in °C: {degc} K are {from_kelvin:.2} °C")
    } else {
        "write it in °C".to_owned()
    };
    Err(table.refuse(key, &rule, &remedy))
}

/// A smallest and a largest value.
fn range(group: &Group, key: &str) -> Result<Option<[f64; 2]>, Finding> {
    let Some(values) = group.numbers(key)? else { return Ok(None) };
    match values.as_slice() {
        [low, high] if low <= high => Ok(Some([*low, *high])),
        _ => Err(group.refuse(key, "is not a smallest and a largest value", "write two temperatures in °C, the lower one first")),
    }
}

/// The periods of a file, in the order of their times; one that holds always if it names none.
fn periods(keys: &Keys) -> Result<Vec<Period>, Finding> {
    let root = keys.root();
    let groups = root.groups("period")?;
    if groups.is_empty() {
        let table = match root.group("facility")? {
            Some(group) => group,
            None => root.group("model")?.unwrap_or(keys.root()),
        };
        let part = part(&table)?;
        return Ok(vec![Period { span: PeriodSpan::default(), covariance: covariance(&root, &root, &part)?, part }]);
    }
    let mut periods: Vec<Period> = Vec::new();
    for group in groups {
        let span = PeriodSpan { from: moment(&group, "from")?, to: moment(&group, "to")? };
        if span.from.as_ref().zip(span.to.as_ref()).is_some_and(|(from, to)| from >= to) {
            return Err(group.refuse("to", "is not after the begin of the period", "write the two in their order"));
        }
        let part = part(&group)?;
        periods.push(Period { span, covariance: covariance(&root, &group, &part)?, part });
    }
    periods.sort_by(|a, b| a.span.from.cmp(&b.span.from));
    for pair in periods.windows(2) {
        let apart = pair[0].span.to.as_ref().zip(pair[1].span.from.as_ref()).is_some_and(|(to, from)| to <= from);
        if !apart {
            let rule = format!("overlaps another: one holds {}, one {}", pair[0].span, pair[1].span);
            return Err(root.refuse("period", &rule, "let one end where the next begins"));
        }
    }
    Ok(periods)
}

/// A moment in UTC.
fn moment(group: &Group, key: &str) -> Result<Option<Start>, Finding> {
    let parse = |text: String| text.parse().map_err(|e: NoStart| group.refuse(key, &e.to_string(), NoStart::REMEDY));
    group.text(key)?.map(parse).transpose()
}

/// The table `covariance`: `parameters` and `matrix`. Where the file says how many degrees of freedom its scatter has, it is widened to that of
/// which 1.96 standard uncertainties make an interval of 95 %, as all that rest on a facility take it.
fn covariance(root: &Group, group: &Group, part: &FacilityParameters) -> Result<Option<Covariance>, Finding> {
    let Some(table) = group.group("covariance")? else { return Ok(None) };
    let parameters = table.texts("parameters")?.ok_or_else(|| table.missing("parameters"))?;
    let matrix = table.rows("matrix")?.ok_or_else(|| table.missing("matrix"))?;
    let known = |name: &&String| part.clone().value_mut(name).is_some();
    if let Some(name) = parameters.iter().find(|name| !known(name)) {
        let remedy =
            "name them as scale_x, offset_y, angle_xz, scale_per_k_x, offset_per_k_x, rack_scale_per_k_x, rack_offset_per_k_x";
        return Err(table.refuse("parameters", &format!("hold `{name}`, which no facility has"), remedy));
    }
    let count = parameters.len();
    let wrong = |rule: &str| table.refuse("matrix", rule, "write a row and a column for each of `parameters`");
    if matrix.len() != count || matrix.iter().any(|row| row.len() != count) {
        return Err(wrong("does not have a row and a column for every parameter"));
    }
    is_covariance(&matrix).map_err(|rule| table.refuse("matrix", rule, "take the file from its source again, or correct it"))?;
    let units = table.texts("units")?.unwrap_or_default();
    let factors = parameters.iter().map(|name| widening(root, name)).collect::<Result<Vec<f64>, Finding>>()?;
    let widened = |(row, own): (Vec<f64>, &f64)| row.iter().zip(&factors).map(|(v, other)| own * v * other).collect();
    let matrix = matrix.into_iter().zip(&factors).map(widened).collect();
    Ok(Some(Covariance { parameters, units, matrix }))
}

/// Student's factor for the degrees of freedom that the file states over that of the normal distribution: of all parameters in `quality`, or
/// of scale factors, offsets and angles beside each other. 1 where it states none.
fn widening(root: &Group, parameter: &str) -> Result<f64, Finding> {
    let families = ["scale", "offset", "angle"];
    let of_family = root.numbers("degrees_of_freedom")?.and_then(|all| {
        let family = families.iter().position(|family| parameter.starts_with(family))?;
        all.get(family).copied()
    });
    let freedom = match (of_family, root.group("quality")?) {
        (None, Some(quality)) => quality.number("degrees_of_freedom")?,
        (of_family, _) => of_family,
    };
    Ok(freedom.map_or(1.0, |freedom| student_factor((freedom as usize).max(1))))
}

fn part(table: &Group) -> Result<FacilityParameters, Finding> {
    let needed = |key: &str| table.three(key)?.ok_or_else(|| table.missing(key));
    let part = FacilityParameters {
        scale_nt_per_eu: needed("scale_nt_per_eu")?,
        offset_nt: needed("offset_nt")?,
        angles_deg: needed("angles_deg")?,
        scale_per_k: table.three("scale_per_k")?,
        offset_nt_per_k: table.three("offset_nt_per_k")?,
        reference_degc: reference(table, "reference_degc", "reference_temperature_degc")?,
        rack_scale_per_k: table.three("rack_scale_per_k")?,
        rack_offset_nt_per_k: table.three("rack_offset_nt_per_k")?,
        rack_reference_degc: reference(table, "rack_reference_degc", "rack_reference_temperature_degc")?,
    };
    if part.scale_nt_per_eu.iter().any(|s| *s <= 0.0) {
        return Err(table.refuse("scale_nt_per_eu", "must be positive", "write the nT of one unit of the setting per axis"));
    }
    if (part.scale_per_k.is_some() || part.offset_nt_per_k.is_some()) && part.reference_degc.is_none() {
        return Err(table.missing("reference_degc"));
    }
    if (part.rack_scale_per_k.is_some() || part.rack_offset_nt_per_k.is_some()) && part.rack_reference_degc.is_none() {
        return Err(table.missing("rack_reference_degc"));
    }
    if part.coil().axes().is_none() {
        return Err(table.refuse(
            "angles_deg",
            "are angles that no three axes have between them",
            "correct the angles XY, XZ, YZ",
        ));
    }
    let most_deg = deviation_deg(part.angles_deg);
    if most_deg > MOST_DEG {
        let rule = format!("deviate from right angles by up to {most_deg:.1}°, which those of no coil system do");
        return Err(table.refuse("angles_deg", &rule, "write the angles XY, XZ, YZ between the coils in degrees, near 90"));
    }
    Ok(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The quantiles of Student's distribution for 2, 4 and 10 degrees of freedom are 4.303, 2.776 and 2.228.
    #[test]
    fn few_degrees_of_freedom_widen_what_the_scatter_told() {
        let head = "scale_nt_per_eu = [1, 1, 1]\noffset_nt = [0, 0, 0]\nangles_deg = [90, 90, 90]\n";
        let table = "[covariance]\nparameters = [\"scale_x\", \"angle_xy\"]\nmatrix = [[4.0, 1.0], [1.0, 9.0]]\n";
        let of = |keys: &str, quality: &str| {
            let text = format!("{head}{keys}{table}{quality}");
            periods(&Keys::parse("facility.toml", 1, text).unwrap()).unwrap().remove(0).covariance.unwrap().matrix
        };
        let near = |found: Vec<Vec<f64>>, expected: [[f64; 2]; 2]| {
            found.iter().flatten().zip(expected.as_flattened()).all(|(a, b)| (a / b - 1.0).abs() < 1e-3)
        };
        assert!(near(of("", ""), [[4.0, 1.0], [1.0, 9.0]]));
        let four = 2.776 / 1.96;
        let all = of("", "[quality]\ndegrees_of_freedom = 4\n");
        assert!(near(all, [[4.0 * four * four, four * four], [four * four, 9.0 * four * four]]));
        let (two, ten) = (4.303 / 1.96, 2.228 / 1.96);
        let each = of("degrees_of_freedom = [2, 4, 10]\n", "");
        assert!(near(each, [[4.0 * two * two, two * ten], [two * ten, 9.0 * ten * ten]]));
    }

    fn parse(text: &str) -> Result<FacilityParameters, Finding> {
        Ok(periods(&Keys::parse("facility.toml", 1, text.to_owned()).unwrap())?.remove(0).part)
    }

    #[test]
    fn keys_are_found_in_a_table_or_without_one() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\nangles_deg = [90.1, 90.0, 89.9]\n";
        let expected = FacilityParameters::constant([0.9, 1.0, 1.1], [1.0, 2.0, 3.0], [90.1, 90.0, 89.9]);
        assert_eq!(parse(plain).unwrap(), expected);
        assert_eq!(parse(&format!("[facility]\n{plain}")).unwrap(), expected);
        let model = parse(&format!(
            "[[scalar_calibration]]\n{plain}[model]\n{plain}scale_per_k = [1e-5, 0, 0]\nreference_temperature_degc = 16.5"
        ));
        assert_eq!(model.unwrap().reference_degc, Some(16.5));
    }

    #[test]
    fn a_file_that_contradicts_itself_is_refused_with_its_key() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\nangles_deg = [90.1, 90.0, 89.9]\n";
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("facility.toml");
        for (table, words) in [
            (
                "[covariance]\nparameters = [\"scale_x\", \"scale_x\"]\nunits = []\nmatrix = [[1, 0], [0, 1]]",
                "names `scale_x` twice",
            ),
            ("[covariance]\nparameters = [\"scale_x\"]\nunits = []\nmatrix = [[-1.0]]", "negative variance"),
            ("[covariance]\nparameters = [\"scale_x\", \"scale_y\"]\nmatrix = [[1, 2], [2, 1]]", "is no covariance"),
            ("reference_degc = -300.0", "below absolute zero"),
            ("[valid]\nfield_coil_nt = [[1.0, -1.0]]", "ends before it begins"),
        ] {
            std::fs::write(&path, format!("{plain}{table}\n")).unwrap();
            let error = read(&path, &mut Vec::new()).unwrap_err().to_string();
            assert!(error.contains(words), "{table}: {error}");
        }
        std::fs::write(&path, format!("{plain}[history]\nearlier = [nan, 1.0]\n")).unwrap();
        assert!(read(&path, &mut Vec::new()).is_ok());
    }

    #[test]
    fn keys_that_are_not_known_are_told_with_the_nearest_one() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\nangles_deg = [90.1, 90.0, 89.9]\n";
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("facility.toml");
        let told = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let mut findings = Vec::new();
            read(&path, &mut findings).unwrap();
            findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
        };
        assert_eq!(told(plain), "");
        for (text, key, nearest) in [
            (format!("{plain}scale_perk = [0, 0, 0]\n"), "`scale_perk`", "`scale_per_k`"),
            (format!("{plain}covarience = [[1.0]]\n"), "`covarience`", "`covariance`"),
            (format!("[facility]\n{plain}ofset_nt_per_k = [0, 0, 0]\n"), "`facility.ofset_nt_per_k`", "`offset_nt_per_k`"),
            (format!("[[period]]\nform = \"2026-01-01T00:00:00Z\"\n{plain}"), "form`", "`from`"),
        ] {
            let said = told(&text);
            assert!(said.contains(key) && said.contains(nearest) && said.contains("not known"), "{text}: {said}");
        }
    }

    /// The angles of CH-GFZ-TR-2601 section 6 are 90.0031, 89.9962 and 89.9664 degrees: 0.186, -0.228 and -2.016 minutes of arc from right ones.
    #[test]
    fn angles_in_minutes_of_arc_are_told_and_those_of_no_coil_system_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("facility.toml");
        let read_with = |angles: &str| {
            let text = format!("scale_nt_per_eu = [1, 1, 1]\noffset_nt = [1, 2, 3]\nangles_deg = {angles}\n");
            std::fs::write(&path, text).unwrap();
            read(&path, &mut Vec::new())
        };
        for right in ["[90.0031, 89.9962, 89.9664]", "[90.1, 90.0, 89.6]"] {
            let notes = read_with(right).unwrap().notes;
            assert!(notes.is_empty(), "{right}: {notes:?}");
        }
        let notes = read_with("[90.186, 89.772, 87.984]").unwrap().notes;
        let [note] = notes.as_slice() else { panic!("{notes:?}") };
        let said = note.to_string();
        assert!(said.contains("facility.toml: ") && said.contains("2.016°") && said.contains("minutes of arc"), "{said}");
        for wrong in ["[78.0, 90.0, 90.0]", "[0.0031, 0.0038, 0.0336]", "[90.0, 90.0, 101.5]"] {
            let error = read_with(wrong).unwrap_err().to_string();
            assert!(error.contains("facility.toml:3:") && error.contains("angles_deg"), "{wrong}: {error}");
        }
    }

    #[test]
    fn a_reference_temperature_in_kelvin_is_refused_with_its_value_in_degrees_celsius() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\nangles_deg = [90.1, 90.0, 89.9]\n";
        for (key, kelvin, degc) in [
            ("reference_degc", "289.65", "16.50 °C"),
            ("reference_temperature_degc", "293.15", "20.00 °C"),
            ("rack_reference_degc", "305.15", "32.00 °C"),
            ("rack_reference_temperature_degc", "305.15", "32.00 °C"),
        ] {
            let error = parse(&format!("{plain}{key} = {kelvin}\n")).unwrap_err().to_string();
            for words in [key, kelvin, degc, "-50 to 60 °C"] {
                assert!(error.contains(words), "{key}: {error}");
            }
        }
        // Fahrenheit, and the last temperatures that are possible.
        assert!(parse(&format!("{plain}reference_degc = 68.0\n")).is_err());
        assert_eq!(parse(&format!("{plain}reference_degc = 60.0\n")).unwrap().reference_degc, Some(60.0));
        assert_eq!(parse(&format!("{plain}rack_reference_degc = -50.0\n")).unwrap().rack_reference_degc, Some(-50.0));
    }

    #[test]
    fn what_is_missing_or_impossible_is_named() {
        let plain = "scale_nt_per_eu = [0.9, 1.0, 1.1]\noffset_nt = [1, 2, 3]\n";
        for (text, words) in [
            (plain.to_owned(), "angles_deg"),
            (format!("{plain}angles_deg = [90, 90]"), "three numbers"),
            (format!("{plain}angles_deg = [90, 90, 90]\nscale_per_k = [0, 0, 1e-5]"), "reference_degc"),
            ("scale_nt_per_eu = [0, 1, 1]\noffset_nt = [1, 2, 3]\nangles_deg = [90, 90, 90]".to_owned(), "positive"),
        ] {
            let error = parse(&text).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
