//! The decoders of tables take it for granted in places that a file is as they would write it, and panic otherwise.

use crate::data::error::Finding;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::Path;
use std::sync::Once;

thread_local!(static GUARDED: Cell<bool> = const { Cell::new(false) });

/// What a decoder makes of a file. A panic in it is told as what it is, a damaged file, and not as a fault of the program.
pub(super) fn guarded<T>(path: &Path, read: impl FnOnce() -> Result<T, Finding>) -> Result<T, Finding> {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            if !GUARDED.get() {
                before(panic);
            }
        }));
    });
    let outer = GUARDED.replace(true);
    // What the decoder was at is dropped, so that nobody sees it half done.
    let result = catch_unwind(AssertUnwindSafe(read));
    GUARDED.set(outer);
    result.unwrap_or_else(|_| {
        let remedy = "the file is damaged, cut, or no table of its format; take it from the archive again";
        Err(Finding::error(&path.display().to_string(), "cannot be read as a table: its structure contradicts itself", remedy))
    })
}

#[cfg(test)]
mod tests {
    use crate::files::import::Format;
    use crate::files::table::columns;
    use crate::files::table::series::SeriesTable;

    #[test]
    fn a_damaged_footer_is_refused() {
        // Found by fuzzing: a truth value in the statistics of a column is of another type.
        let bytes = include_bytes!("../../../fuzz/seeds/auxiliary/damaged_footer.parquet");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("heater.parquet");
        // The first byte of the seed chooses the reader.
        std::fs::write(&path, &bytes[1..]).unwrap();
        let told = SeriesTable::open(&path).err().unwrap().to_string();
        assert!(told.contains("heater.parquet") && told.contains("take it from the archive again"), "{told}");
    }
    #[test]
    fn a_page_of_more_values_than_rows_asks_for_no_memory() {
        // Found by fuzzing: a page of -1 values, for which a decoder wants all the memory that there can be.
        let bytes = include_bytes!("../../../fuzz/seeds/auxiliary/endless_page.parquet");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wheels.parquet");
        std::fs::write(&path, &bytes[1..]).unwrap();
        let told = columns::read(&path, Format::Parquet).err().unwrap().to_string();
        assert!(told.contains("wheels.parquet") && told.contains("cannot be read as a table"), "{told}");
    }
}
