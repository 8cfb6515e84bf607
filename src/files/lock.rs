//! One process at a time in a result folder, by a lock of the operating system: it ends with the process that holds it, however that ends.

use super::output::must_be_folder;
use crate::data::error::Finding;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

/// Name of the file that is locked.
pub const LOCK_FILE: &str = ".calfit.lock";

/// The lock of a folder. It is given back, and its file taken away, when the value is dropped.
#[derive(Debug)]
pub struct FolderLock {
    file: Option<File>,
    path: PathBuf,
    /// The folder, where it was made for the lock.
    made: Option<PathBuf>,
}

impl FolderLock {
    /// Takes the lock of a folder, which is made if it is not there. Nobody waits: a folder that is in use is an error.
    ///
    /// # Errors
    /// Another process holds the lock, or what the operating system says.
    pub fn take(folder: &Path) -> Result<Self, Finding> {
        must_be_folder(folder)?;
        let path = folder.join(LOCK_FILE);
        // A link would make a file elsewhere, and a pipe would wait for its other end.
        if fs::symlink_metadata(&path).is_ok_and(|meta| !meta.is_file()) {
            let remedy = "take it away, or choose another output folder with -o";
            return Err(Finding::error(
                &path.display().to_string(),
                "is a link, a folder or a device, and no file of calfit",
                remedy,
            ));
        }
        let in_use = || {
            let remedy = "wait until that has ended, or choose another folder with -o";
            Finding::error(&folder.display().to_string(), "is in use by another calfit process", remedy)
        };
        // A holder that ends takes file and folder away, so that what was opened may be no longer there under its name. Everybody who
        // comes then finds a new file, at which the lock is tried again.
        const TRIES: usize = 100;
        for _ in 0..TRIES {
            let is_new = !folder.exists();
            fs::create_dir_all(folder).map_err(|e| Finding::io(folder, "create the folder", &e))?;
            let file = match OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path) {
                Ok(file) => file,
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
                Err(error) => return Err(Finding::io(&path, "write", &error)),
            };
            match file.try_lock() {
                Ok(()) if is_same(&file, &path) => {
                    return Ok(Self { file: Some(file), path, made: is_new.then(|| folder.to_owned()) });
                }
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Err(in_use()),
                Err(TryLockError::Error(error)) => return Err(Finding::io(&path, "lock", &error)),
            }
        }
        Err(in_use())
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // The file goes while it is locked, so that nobody else can hold it; where it has to stay it does no harm.
        let _ = fs::remove_file(&self.path);
        drop(self.file.take());
        if let Some(folder) = &self.made {
            // A folder with results stays.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Whether the open file is the one that has the name.
#[cfg(unix)]
fn is_same(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let id = |meta: fs::Metadata| (meta.dev(), meta.ino());
    file.metadata().ok().map(id) == fs::symlink_metadata(path).ok().map(id)
}

/// Elsewhere a file that is open keeps its name.
#[cfg(not(unix))]
fn is_same(_file: &File, path: &Path) -> bool {
    path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_is_refused_and_nothing_is_left() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("out");
        let first = FolderLock::take(&folder).unwrap();
        let refused = FolderLock::take(&folder).unwrap_err();
        assert!(refused.to_string().contains("out: is in use by another calfit process"), "{refused}");
        drop(first);
        assert!(!folder.exists());
        let second = FolderLock::take(&folder).unwrap();
        fs::write(folder.join("result"), "").unwrap();
        drop(second);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        #[cfg(unix)]
        {
            let elsewhere = dir.path().join("elsewhere");
            std::os::unix::fs::symlink(&elsewhere, folder.join(LOCK_FILE)).unwrap();
            assert!(FolderLock::take(&folder).unwrap_err().to_string().contains("is a link"));
            assert!(!elsewhere.exists());
            fs::remove_file(folder.join(LOCK_FILE)).unwrap();
        }
        // A file that a killed process left is no lock.
        fs::write(folder.join(LOCK_FILE), "").unwrap();
        drop(FolderLock::take(&folder).unwrap());
        assert!(FolderLock::take(&folder).is_ok());
    }
}
