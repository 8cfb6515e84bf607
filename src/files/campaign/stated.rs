//! What the protocol states in the words of the laboratory: persons, tables, photographs, remarks, signatures.

use super::file::CampaignFile;
use crate::data::error::Finding;
use crate::data::run::time_of_id;
use crate::files::text::Group;

/// What the protocol states in the words of the laboratory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stated {
    /// Who took part, and in which part.
    pub personnel: Vec<String>,
    /// What is to be said of the whole campaign.
    pub remarks: Vec<String>,
    /// Who signs the protocol.
    pub signatures: Vec<String>,
    /// Tables such as the parameters of the instrument or the first readings of the thermistors.
    pub tables: Vec<StatedTable>,
    /// Photographs.
    pub photos: Vec<StatedPhoto>,
    /// Remarks on runs and days: the id of the run, or the day as run ids begin with it.
    pub of_runs: Vec<(String, String)>,
}

/// A table with its title.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StatedTable {
    /// Title.
    pub title: String,
    /// Names of the columns.
    pub head: Vec<String>,
    /// Rows of the width of the head.
    pub rows: Vec<Vec<String>>,
}

/// A photograph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StatedPhoto {
    /// Path from the campaign's folder.
    pub file: String,
    /// What it shows.
    pub caption: String,
}

impl Stated {
    /// Keys of `[report]` that are read here.
    pub const KEYS: [&'static str; 5] = ["personnel", "remarks", "signatures", "table", "photo"];

    /// Reads the keys of `[report]`; warnings go to `findings`.
    ///
    /// # Errors
    /// The first fault, with its place.
    pub fn take(&mut self, report: &Group, findings: &mut Vec<Finding>) -> Result<(), Finding> {
        self.personnel = report.texts_or_one("personnel")?.unwrap_or_default();
        self.remarks = report.texts_or_one("remarks")?.unwrap_or_default();
        self.signatures = report.texts_or_one("signatures")?.unwrap_or_default();
        for group in report.groups("table")? {
            findings.extend(group.unknown(&["title", "head", "rows"]));
            let title = group.text("title")?.ok_or_else(|| group.missing("title"))?;
            let head = group.texts("head")?.ok_or_else(|| group.missing("head"))?;
            let rows = group.text_rows("rows")?.ok_or_else(|| group.missing("rows"))?;
            if let Some(number) = rows.iter().position(|row| row.len() != head.len()).map(|i| i + 1) {
                let rule = format!("of the table {title}: row {number} has not as many cells as `head`, {}", head.len());
                return Err(group.refuse("rows", &rule, "write a cell for every column, \"\" for an empty one"));
            }
            self.tables.push(StatedTable { title, head, rows });
        }
        for group in report.groups("photo")? {
            findings.extend(group.unknown(&["file", "caption"]));
            let file = group.text("file")?.ok_or_else(|| group.missing("file"))?;
            let caption = group.text("caption")?.ok_or_else(|| group.missing("caption"))?;
            self.photos.push(StatedPhoto { file, caption });
        }
        Ok(())
    }

    /// Reads `[[remark]]`; warnings go to `findings`.
    ///
    /// # Errors
    /// The first fault, with its place.
    pub fn take_remarks(&mut self, root: &Group, findings: &mut Vec<Finding>) -> Result<(), Finding> {
        for group in root.groups("remark")? {
            findings.extend(group.unknown(&["run", "day", "text"]));
            let text = group.text("text")?.ok_or_else(|| group.missing("text"))?;
            let about = match (group.text("run")?, group.text("day")?) {
                (Some(run), None) => run,
                (None, Some(day)) if time_of_id(&format!("{day}_00-00-00")).is_some() => day,
                (None, Some(_)) => return Err(group.refuse("day", "is no day", "write it as run ids begin, \"13-04-03\"")),
                (None, None) => return Err(group.missing("run")),
                (Some(_), Some(_)) => {
                    return Err(group.refuse("day", "stands beside `run`", "make two entries of it"));
                }
            };
            self.of_runs.push((about, text));
        }
        Ok(())
    }

    /// Remarks on a run, or on a day.
    pub fn on<'a>(&'a self, about: &'a str) -> impl Iterator<Item = &'a str> {
        self.of_runs.iter().filter(move |(of, _)| of == about).map(|(_, text)| text.as_str())
    }
}

impl CampaignFile {
    /// What remarks are on, of which no run of a campaign has the id or the day.
    #[must_use]
    pub fn remarks_on_nothing(&self, ids: &[&str]) -> Vec<&str> {
        let known = |about: &str| ids.iter().any(|id| *id == about || id.split('_').next() == Some(about));
        self.stated.of_runs.iter().map(|(about, _)| about.as_str()).filter(|about| !known(about)).collect()
    }
}
