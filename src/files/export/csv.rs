//! One row per quantity of a parameter file.

use super::quantity::{correlations, quantities};
use super::{Exported, Options, Source};
use crate::data::error::Finding;
use crate::data::plain::one_line;
use crate::files::text::csv_cell;
use std::fmt::Write;

/// One CSV file per parameter file. A value or uncertainty that is not known is an empty cell.
pub(super) fn export(sources: &[Source], options: &Options) -> Result<Vec<Exported>, Finding> {
    let cell = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:?}"));
    let one = |source: &Source| {
        let mut text = format!(
            "# {} {} quantities of {}, SHA-256 {}; standard uncertainties, coverage factor 1; name_Tk is the coefficient of T^k, T in degC{}{}\n\
             name,component,value,standard_uncertainty,unit,frame,valid_from,valid_to,valid_unit\n",
            options.provenance.tool,
            options.provenance.tool_version,
            one_line(source.name()),
            source.input().sha256,
            source.told().iter().map(|told| format!("; {}: {}", told.name, one_line(&told.text))).collect::<String>(),
            // The last, so that what follows `apply = ` is JSON; one line, so that the names of the columns stand in the second.
            source.value.get("apply").map_or_else(String::new, |apply| format!("; apply = {}", one_line(&apply.to_string())))
        );
        for q in quantities(source)? {
            let (low, high, unit) = q.valid.map_or((None, None, ""), |([low, high], unit)| (Some(low), Some(high), unit));
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{},{},{unit}",
                csv_cell(&q.name),
                csv_cell(&q.component),
                cell(q.value),
                cell(q.std),
                q.unit,
                q.frame,
                cell(low),
                cell(high)
            );
        }
        for pair in correlations(source) {
            let [a, b] = pair.names;
            let _ = writeln!(text, "correlation,{},{:?},,1,,,,", csv_cell(&format!("{a} * {b}")), pair.value);
        }
        Ok(Exported { name: format!("{}.csv", source.name()), text })
    };
    sources.iter().map(one).collect()
}
