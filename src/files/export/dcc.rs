//! A digital calibration certificate in the style of the schema of PTB, version 3: administrative data and results with expanded
//! uncertainties: coverage factor 2, and more where few data tell the uncertainty. It is well-formed and in the order of the schema; it is not signed.

mod conditions;

use super::quantity::{Quantity, correlations, quantities};
use super::{Exported, Options, Source};
use crate::data::error::Finding;
use crate::data::run::time_of_id;
use crate::data::start::Start;
use conditions::influence_conditions;
use std::fmt::Write;

/// The coverage factor where the uncertainty itself is known well.
const LEAST_COVERAGE_FACTOR: f64 = 2.0;
const NOT_STATED: &str = "not stated";
/// The code of ISO 3166 that users may give a meaning: no country is stated.
const NO_COUNTRY: &str = "ZZ";

/// One certificate per parameter file.
pub(super) fn export(sources: &[Source], options: &Options) -> Result<Vec<Exported>, Finding> {
    let one = |source: &Source| {
        let list = quantities(source)?;
        Ok(Exported { name: format!("{}.xml", source.name()), text: certificate(source, &list, options) })
    };
    sources.iter().map(one).collect()
}

/// Text as content of an element; characters that XML has no place for become blanks.
fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '\t' | '\n' => out.push(c),
            c if c < ' ' || matches!(c, '\u{7f}' | '\u{fffe}' | '\u{ffff}') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

/// An element with a text in English.
fn named(element: &str, text: &str) -> String {
    format!("<dcc:{element}><dcc:content lang=\"en\">{}</dcc:content></dcc:{element}>", escape(text))
}

/// First and last day of the measurements: those of the runs, or the day on which the file was made.
fn days(source: &Source) -> [String; 2] {
    let of_run = |id: &str| Some(time_of_id(id.get(.."yy-mm-dd_hh-mm-ss".len())?)?.date().to_string());
    let made = || source.file.provenance.created.get(..10).unwrap_or_default().to_owned();
    let named = |key: &str| source.value[key].as_array().into_iter().flatten().filter_map(|v| v.as_str());
    // The files of coils name their runs so.
    let of_ids = named("runs").chain(named("used")).chain(source.text("/run/id")).filter_map(of_run);
    let inputs = || source.file.provenance.input.iter();
    let moments = inputs().filter_map(|i| i.from.as_ref()).chain(inputs().filter_map(|i| i.until.as_ref()));
    let mut list: Vec<String> = of_ids.chain(moments.map(Start::day)).collect();
    list.sort();
    [list.first().cloned().unwrap_or_else(made), list.last().cloned().unwrap_or_else(made)]
}

fn certificate(source: &Source, list: &[Quantity], options: &Options) -> String {
    let told = |label: &str| options.report.iter().find(|(l, _)| *l == label).map(|(_, text)| text.as_str());
    let stated = |label: &str| told(label).unwrap_or(NOT_STATED);
    // Elements that the schema has no need of stand where something is said.
    let of_item = ["Range and firmware", "Condition of the instrument"].into_iter();
    let state: Vec<String> = of_item.filter_map(|label| Some(format!("{label}: {}", told(label)?))).collect();
    let state = if state.is_empty() { String::new() } else { named("description", &state.join("; ")) };
    let maker = told("Maker of the instrument")
        .map_or_else(String::new, |maker| format!("<dcc:manufacturer>{}</dcc:manufacturer>", named("name", maker)));
    let checked_by = told("Checked by").map_or_else(String::new, |person| {
        let person = named("name", person);
        format!("<dcc:respPerson><dcc:person>{person}</dcc:person><dcc:role>checked by</dcc:role></dcc:respPerson>")
    });
    let either =
        |a: &str, b: &str| source.text(a).or_else(|| source.text(b)).filter(|t| !t.is_empty()).unwrap_or(NOT_STATED).to_owned();
    let (tool, version) = (&options.provenance.tool, &options.provenance.tool_version);
    let sensor = either("/sensor", "/run/sensor");
    let mode = either("/mode", "/run/mode");
    let [begin, end] = days(source);
    let issued = options.provenance.created.get(..10).unwrap_or_default();
    let identifier = format!("{} SHA-256 {}", source.name(), source.input().sha256);
    let uncertainty = source.text("/convention/uncertainty").unwrap_or(NOT_STATED);
    let model = source.text("/convention/model").unwrap_or(NOT_STATED);
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- written by {tool} {version} -->\n\
         <dcc:digitalCalibrationCertificate xmlns:dcc=\"https://ptb.de/dcc\" xmlns:si=\"https://ptb.de/si\" schemaVersion=\"3.3.0\">\n\
         <dcc:administrativeData>\n"
    );
    let _ = writeln!(
        out,
        "<dcc:dccSoftware><dcc:software>{}<dcc:release>{version}</dcc:release></dcc:software></dcc:dccSoftware>\n\
         <dcc:coreData>\n<dcc:countryCodeISO3166_1>{NO_COUNTRY}</dcc:countryCodeISO3166_1>\n\
         <dcc:usedLangCodeISO639_1>en</dcc:usedLangCodeISO639_1>\n<dcc:mandatoryLangCodeISO639_1>en</dcc:mandatoryLangCodeISO639_1>\n\
         <dcc:uniqueIdentifier>{}</dcc:uniqueIdentifier>\n<dcc:beginPerformanceDate>{}</dcc:beginPerformanceDate>\n\
         <dcc:endPerformanceDate>{}</dcc:endPerformanceDate>\n<dcc:performanceLocation>laboratory</dcc:performanceLocation>\n\
         <dcc:issueDate>{}</dcc:issueDate>\n</dcc:coreData>",
        named("name", tool),
        escape(&identifier),
        escape(&begin),
        escape(&end),
        escape(issued)
    );
    let _ = writeln!(
        out,
        "<dcc:items><dcc:item>\n{}{state}{maker}\n<dcc:model>{}</dcc:model>\n<dcc:identifications><dcc:identification><dcc:issuer>manufacturer</dcc:issuer>\
         <dcc:value>{}</dcc:value></dcc:identification></dcc:identifications>\n</dcc:item></dcc:items>",
        named("name", &format!("magnetometer sensor {sensor}, mode {mode}")),
        escape(stated("Model")),
        escape(stated("Serial numbers of sensor and electronics"))
    );
    let _ = writeln!(
        out,
        "<dcc:calibrationLaboratory><dcc:contact>{}<dcc:location><dcc:city>{}</dcc:city></dcc:location></dcc:contact>\
         </dcc:calibrationLaboratory>\n<dcc:respPersons><dcc:respPerson><dcc:person>{}</dcc:person><dcc:mainSigner>true</dcc:mainSigner>\
         </dcc:respPerson>{checked_by}</dcc:respPersons>\n<dcc:customer>{}<dcc:location><dcc:city>{NOT_STATED}</dcc:city></dcc:location></dcc:customer>",
        named("name", stated("Laboratory")),
        escape(stated("Place of the measurements")),
        named("name", stated("Responsible")),
        named("name", stated("Customer"))
    );
    let apply = source.value.get("apply").map_or_else(|| NOT_STATED.to_owned(), ToString::to_string);
    let statement = |name: &str, text: &str| {
        format!("<dcc:statement>{}{}</dcc:statement>\n", named("name", name), named("description", text))
    };
    let _ = writeln!(
        out,
        "<dcc:statements>\n{}{}{}{}{}</dcc:statements>\n</dcc:administrativeData>",
        statement(
            "uncertainty",
            &format!(
                "expanded uncertainties are standard uncertainties{} times their coverage factor, {LEAST_COVERAGE_FACTOR}, or Student's factor \
                 where few data tell them; {uncertainty}",
                if source.has_combined() { " of both types, A and B (those called combined)" } else { "" }
            )
        ),
        statement("traceability", stated("Traceability of the reference field")),
        statement(
            "units",
            "readings are engineering nanotesla (enT), which stand as nanotesla; sensitivities nT/enT stand as one; nanotesla per \
             engineering unit of the coil system stand as nanotesla"
        ),
        statement("apply", &apply),
        source.told().iter().map(|told| statement(told.name, &told.text)).collect::<String>()
    );
    let _ = writeln!(
        out,
        "<dcc:measurementResults><dcc:measurementResult>\n{}\n<dcc:usedMethods><dcc:usedMethod>{}{}</dcc:usedMethod></dcc:usedMethods>\n\
         {}<dcc:results>",
        named("name", source.name()),
        named("name", &source.file.provenance.command),
        named("description", model),
        influence_conditions(source)
    );
    for q in list {
        // The schema has no place for a value that was not determined.
        let Some(value) = q.value else { continue };
        let component = if q.component.is_empty() { String::new() } else { format!(" {}", q.component) };
        let valid = q.valid.map_or_else(String::new, |([low, high], unit)| {
            format!("; valid from {:?} to {:?} {unit}", rounded(low), rounded(high))
        });
        let _ = writeln!(
            out,
            "<dcc:result>{}<dcc:data><dcc:quantity>{}<si:real><si:value>{value:?}</si:value><si:unit>{}</si:unit>{}</si:real></dcc:quantity>\
             </dcc:data></dcc:result>",
            named("name", &format!("{}{component}", q.name)),
            named("name", &format!("{}{component}, {}, {}{valid}", q.name, q.unit, q.frame)),
            q.unit.d_si(),
            q.std.map_or_else(String::new, |std| expanded(std, q.factor_95))
        );
    }
    for pair in correlations(source) {
        let [a, b] = pair.names;
        let _ = writeln!(
            out,
            "<dcc:result>{}<dcc:data><dcc:quantity>{}<si:real><si:value>{:?}</si:value><si:unit>\\one</si:unit></si:real></dcc:quantity>\
             </dcc:data></dcc:result>",
            named("name", &format!("correlation {a} * {b}")),
            named("name", &format!("correlation of {a} and {b}: covariance over the product of the standard uncertainties")),
            pair.value
        );
    }
    out.push_str("</dcc:results>\n</dcc:measurementResult></dcc:measurementResults>\n</dcc:digitalCalibrationCertificate>\n");
    out
}

/// The end of a range without the digits that come from computing a mean.
fn rounded(value: f64) -> f64 {
    const PARTS: f64 = 1e6;
    (value * PARTS).round() / PARTS
}

/// Nothing where no interval of 95 % is known.
fn expanded(std: f64, factor_95: f64) -> String {
    let factor = factor_95.max(LEAST_COVERAGE_FACTOR);
    if !factor.is_finite() {
        return String::new();
    }
    format!(
        "<si:measurementUncertaintyUnivariate><si:expandedMU><si:valueExpandedMU>{:?}</si:valueExpandedMU>\
         <si:coverageFactor>{factor:?}</si:coverageFactor><si:coverageProbability>0.95</si:coverageProbability>\
         </si:expandedMU></si:measurementUncertaintyUnivariate>",
        factor * std
    )
}
