//! Any parameter file as JSON, key by key; a number that is none is null.

use super::{Exported, Options, Source};
use crate::data::error::Finding;

/// One JSON file per parameter file.
pub(super) fn export(sources: &[Source], options: &Options) -> Result<Vec<Exported>, Finding> {
    let one = |source: &Source| {
        let mut tree = serde_json::Map::new();
        // The first key marks the file as one that may be written again.
        let tool = format!("{} {}", options.provenance.tool, options.provenance.tool_version);
        tree.insert("written_by".to_owned(), tool.into());
        tree.extend(source.value.as_object().cloned().unwrap_or_default());
        let text =
            serde_json::to_string_pretty(&tree).map_err(|e| source.refuse(format!("has no JSON form: {e}"), "check the file"))?;
        Ok(Exported { name: format!("{}.json", source.name()), text: text + "\n" })
    };
    sources.iter().map(one).collect()
}
