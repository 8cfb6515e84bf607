//! Files are written whole or not at all, and never over a file that this tool did not write.

use crate::error::Finding;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Every file that the tool writes holds its name within this many bytes of its begin or end.
const MARK_WITHIN: u64 = 4096;
const MARK: &[u8] = b"calfit";
const TEMPORARY: &str = ".calfit-partial-";

/// A folder for results.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    force: bool,
}

impl Folder {
    /// Creates the folder if needed, takes away what an interrupted run left there, and checks that files can be written.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn open(path: &Path, force: bool) -> Result<Self, Finding> {
        fs::create_dir_all(path).map_err(|e| Finding::io(path, "create the folder", &e))?;
        for entry in fs::read_dir(path).map_err(|e| Finding::io(path, "list the folder", &e))?.flatten() {
            if entry.file_name().to_string_lossy().starts_with(TEMPORARY) {
                // A leftover that cannot be removed does no harm.
                let _ = fs::remove_file(entry.path());
            }
        }
        Ok(Self { path: path.to_owned(), force })
    }

    /// Refuses a name that is taken by something this tool did not write.
    ///
    /// # Errors
    /// A folder or a foreign file of that name.
    pub fn check(&self, name: &str) -> Result<(), Finding> {
        let path = self.path.join(name);
        let Ok(existing) = fs::symlink_metadata(&path) else { return Ok(()) };
        let shown = path.display().to_string();
        if existing.is_dir() {
            return Err(Finding::error(&shown, "the name is taken by a folder", "choose another output folder with -o"));
        }
        if self.force || (existing.is_file() && is_own(&path)) {
            return Ok(());
        }
        Err(Finding::error(
            &shown,
            "the file exists and was not written by calfit",
            "move it away, choose another folder with -o, or use --force",
        ))
    }

    /// Writes a file under its final name once it is complete on disk.
    ///
    /// # Errors
    /// A name that is taken, or what the operating system says.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), Finding> {
        self.check(name)?;
        let path = self.path.join(name);
        let failed = |e: &std::io::Error| Finding::io(&path, "write", e);
        let mut file = tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(&self.path).map_err(|e| failed(&e))?;
        file.write_all(bytes).map_err(|e| failed(&e))?;
        file.flush().map_err(|e| failed(&e))?;
        readable(file.as_file()).map_err(|e| failed(&e))?;
        file.as_file().sync_data().map_err(|e| failed(&e))?;
        file.persist(&path).map_err(|e| failed(&e.error))?;
        Ok(())
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Temporary files are private; results are as readable as any other file.
#[cfg(unix)]
fn readable(file: &File) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn readable(_file: &File) -> std::io::Result<()> {
    Ok(())
}

fn is_own(path: &Path) -> bool {
    let read = || -> std::io::Result<bool> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut bytes = Vec::new();
        (&mut file).take(MARK_WITHIN).read_to_end(&mut bytes)?;
        if memchr::memmem::find(&bytes, MARK).is_some() {
            return Ok(true);
        }
        file.seek(SeekFrom::Start(length.saturating_sub(MARK_WITHIN)))?;
        bytes.clear();
        file.take(MARK_WITHIN).read_to_end(&mut bytes)?;
        Ok(memchr::memmem::find(&bytes, MARK).is_some())
    };
    read().unwrap_or(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_files_stay_and_own_files_are_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::open(dir.path(), false).unwrap();
        fs::write(dir.path().join("a.md"), "my notes").unwrap();
        assert!(folder.write("a.md", b"calfit").is_err());
        assert_eq!(fs::read(dir.path().join("a.md")).unwrap(), b"my notes");
        folder.write("b.md", b"calfit 1").unwrap();
        folder.write("b.md", b"calfit 2").unwrap();
        assert_eq!(fs::read(dir.path().join("b.md")).unwrap(), b"calfit 2");
        Folder::open(dir.path(), true).unwrap().write("a.md", b"calfit").unwrap();
        fs::create_dir(dir.path().join("c")).unwrap();
        assert!(folder.check("c").is_err());
    }
}
