//! Files are written whole or not at all, and never over a file that this tool did not write.

use super::ledger::{Ledger, Origin, same_but_dates};
use super::photo;
use super::source::hex;
use crate::data::error::Finding;
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// How the files that the tool writes begin: parameter files and CSV tables, Markdown, JSON, XML, and (within the head of the picture)
/// figures.
const BEGINS: [&[u8]; 4] = [
    b"# calfit ",
    b"<!-- written by calfit ",
    b"{\n  \"written_by\": \"calfit ",
    b"<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- written by calfit ",
];
const PICTURE: (&[u8], &[u8]) = (b"\x89PNG", b"Software\0calfit ");
/// Parquet tables hold their mark at the end.
const TABLE: (&[u8], &[u8]) = (b"PAR1", b"written_by");
const MARK_WITHIN: u64 = 4096;
/// How labels of text tables begin; the table beside such a label is one of the program, and has no place for a mark itself.
const LABEL: &[u8] = b"PDS_VERSION_ID = PDS3\r\n/* calfit ";
/// Simulated runs say so among their keys.
const SIMULATED: (&[u8], &[u8]) = (b"CCR 1\n", b"\n# simulated by calfit ");
const TEMPORARY: &str = ".calfit-partial-";

/// A folder for results.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    force: bool,
    recording: Option<Recording>,
}

/// Where it is noted what is written.
#[derive(Clone, Debug)]
struct Recording {
    ledger: Ledger,
    /// Path of the folder inside the result folder, with a `/` at the end; empty for that itself.
    below: String,
    origin: Arc<Origin>,
}

impl Folder {
    /// Creates the folder if needed, takes away what an interrupted run left there, and checks that files can be written.
    ///
    /// # Errors
    /// An error of the operating system.
    pub fn open(path: &Path, force: bool) -> Result<Self, Finding> {
        must_be_folder(path)?;
        fs::create_dir_all(path).map_err(|e| Finding::io(path, "create the folder", &e))?;
        for entry in fs::read_dir(path).map_err(|e| Finding::io(path, "list the folder", &e))?.flatten() {
            if is_leftover(&entry.file_name().to_string_lossy()) {
                // A leftover that cannot be removed does no harm.
                let _ = fs::remove_file(entry.path());
            }
        }
        Ok(Self { path: path.to_owned(), force, recording: None })
    }

    /// A folder inside a folder for results, or that itself for an empty name: nothing is written elsewhere, whatever the name is or leads
    /// to.
    ///
    /// # Errors
    /// A name that leaves the folder, a link in its place, or what the operating system says.
    pub fn open_below(parent: &Path, name: &str, force: bool) -> Result<Self, Finding> {
        if name.is_empty() {
            return Self::open(parent, force);
        }
        let path = parent.join(name);
        must_stay_inside(&path, name)?;
        if fs::symlink_metadata(&path).is_ok_and(|meta| meta.is_symlink()) {
            let remedy = "take the link away, or choose another output folder with -o";
            return Err(Finding::error(&path.display().to_string(), "is a link that leads out of the output folder", remedy));
        }
        Self::open(&path, force)
    }

    /// The same folder, whose files are noted in the ledger of a result folder, with where they come from. `below` is its path there.
    #[must_use]
    pub fn recording(self, ledger: &Ledger, below: &str, origin: Origin) -> Self {
        let below = if below.is_empty() { String::new() } else { format!("{below}/") };
        Self { recording: Some(Recording { ledger: ledger.clone(), below, origin: Arc::new(origin) }), ..self }
    }

    /// Refuses a name that is taken by something this tool did not write.
    ///
    /// # Errors
    /// A folder or a foreign file of that name.
    pub fn check(&self, name: &str) -> Result<(), Finding> {
        let path = self.path.join(name);
        must_stay_inside(&path, name)?;
        let Ok(existing) = fs::symlink_metadata(&path) else { return Ok(()) };
        let shown = path.display().to_string();
        if existing.is_dir() {
            return Err(Finding::error(&shown, "the name is taken by a folder", "choose another output folder with -o"));
        }
        if self.force {
            return Ok(());
        }
        // Nobody is told to overwrite by force what cannot be read just now.
        if existing.is_file() && is_own(&path).map_err(|e| Finding::io(&path, "read", &e))? {
            return Ok(());
        }
        Err(Finding::error(
            &shown,
            "the file exists and was not written by calfit",
            "move it away, choose another folder with -o, or use --force",
        ))
    }

    /// Writes a file under its final name once it is complete on disk. A file of a result that is there already, but for its date, stays.
    ///
    /// # Errors
    /// A name that is taken, or what the operating system says.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), Finding> {
        if let Some(recording) = &self.recording
            && let Some(there) = self.kept(name, bytes, &recording.origin.created)?
        {
            recording.note(name, hex(&Sha256::digest(&there)));
            return Ok(());
        }
        let mut file = self.create(name)?;
        file.write_all(bytes).map_err(|e| Finding::io(&file.path, "write", &e))?;
        file.finish().map(|_| ())
    }

    /// The bytes of the file with this name, if they differ from new ones by nothing but the date.
    fn kept(&self, name: &str, bytes: &[u8], created: &str) -> Result<Option<Vec<u8>>, Finding> {
        self.check(name)?;
        let path = self.path.join(name);
        let same_size = fs::symlink_metadata(&path).is_ok_and(|meta| meta.is_file() && meta.len() == bytes.len() as u64);
        let there = same_size.then(|| fs::read(&path).ok()).flatten();
        Ok(there.filter(|there| same_but_dates(there, bytes, created)))
    }

    /// A file that is written piece by piece, and has its name once it is finished.
    ///
    /// # Errors
    /// A name that is taken, or what the operating system says.
    pub fn create(&self, name: &str) -> Result<Pending, Finding> {
        self.check(name)?;
        let path = self.path.join(name);
        let file = tempfile::Builder::new()
            .prefix(&format!("{TEMPORARY}{}-", std::process::id()))
            .tempfile_in(&self.path)
            .map_err(|e| Finding::io(&path, "write", &e))?;
        let recording = self.recording.clone().map(|recording| (recording, name.to_owned(), Sha256::new()));
        Ok(Pending { file, path, size_bytes: 0, recording })
    }

    /// Makes the names of what was written last through a power loss.
    ///
    /// # Errors
    /// An error of the operating system.
    pub fn sync(&self) -> Result<(), Finding> {
        File::open(&self.path).and_then(|folder| folder.sync_all()).map_err(|e| Finding::io(&self.path, "sync the folder", &e))
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// A file under a temporary name. Without [`Pending::finish`] it vanishes.
pub struct Pending {
    file: tempfile::NamedTempFile,
    path: PathBuf,
    size_bytes: u64,
    /// Where it is noted under its name, with the hash of what was written so far.
    recording: Option<(Recording, String, Sha256)>,
}

impl Recording {
    fn note(&self, name: &str, sha256: String) {
        self.ledger.note(format!("{}{name}", self.below), sha256, &self.origin);
    }
}

impl Pending {
    /// The temporary file with what was written so far, for a reader that looks at it before it has its name.
    ///
    /// # Errors
    /// An error of the operating system.
    pub fn so_far(&mut self) -> Result<&Path, Finding> {
        self.file.flush().map_err(|e| Finding::io(&self.path, "write", &e))?;
        Ok(self.file.path())
    }

    /// Gives the file its name once it is complete on disk; returns its size.
    ///
    /// # Errors
    /// An error of the operating system.
    pub fn finish(mut self) -> Result<u64, Finding> {
        let failed = |e: &std::io::Error| Finding::io(&self.path, "write", e);
        self.file.flush().map_err(|e| failed(&e))?;
        readable(self.file.as_file()).map_err(|e| failed(&e))?;
        self.file.as_file().sync_data().map_err(|e| failed(&e))?;
        self.file.persist(&self.path).map_err(|e| Finding::io(&self.path, "write", &e.error))?;
        if let Some((recording, name, hash)) = self.recording {
            recording.note(&name, hex(&hash.finalize()));
        }
        Ok(self.size_bytes)
    }
}

impl Write for Pending {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.size_bytes += written as u64;
        if let (Some((_, _, hash)), Some(new)) = (&mut self.recording, bytes.get(..written)) {
            hash.update(new);
        }
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// A temporary file, named after the process that writes it, is left over once that process is gone.
fn is_leftover(name: &str) -> bool {
    let owner = name.strip_prefix(TEMPORARY).and_then(|rest| rest.split('-').next());
    owner.is_some_and(|process| !Path::new("/proc").join(process).exists())
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

/// Refuses a path at which there is something else than a folder.
pub(super) fn must_be_folder(path: &Path) -> Result<(), Finding> {
    if path.exists() && !path.is_dir() {
        return Err(Finding::error(&path.display().to_string(), "is not a folder", "choose another output folder with -o"));
    }
    Ok(())
}

/// Refuses names that are no names of something inside a folder: ids come from files.
fn must_stay_inside(path: &Path, name: &str) -> Result<(), Finding> {
    let mut parts = Path::new(name).components().peekable();
    if parts.peek().is_some() && parts.all(|part| matches!(part, Component::Normal(_))) {
        return Ok(());
    }
    Err(Finding::error(&path.display().to_string(), "leaves the output folder", "correct the name or the run id in the input"))
}

/// Whether there is nothing at a path, not even a link that leads nowhere.
#[must_use]
pub fn is_gone(path: &Path) -> bool {
    fs::symlink_metadata(path).is_err_and(|e| e.kind() == ErrorKind::NotFound)
}

/// Whether this tool wrote a file, by its mark.
///
/// # Errors
/// It is there and cannot be read.
pub fn is_own(path: &Path) -> std::io::Result<bool> {
    if path.extension().is_some_and(|end| end == "TAB") {
        return is_own(&path.with_extension("LBL"));
    }
    // A pipe would wait for its other end. Links that lead nowhere are not of this tool, which writes none.
    match fs::metadata(path) {
        Ok(meta) if meta.is_file() => {}
        Err(error) if error.kind() != ErrorKind::NotFound && !path.is_symlink() => return Err(error),
        _ => return Ok(false),
    }
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut head = Vec::new();
    (&mut file).take(MARK_WITHIN).read_to_end(&mut head)?;
    file.seek(SeekFrom::Start(length.saturating_sub(MARK_WITHIN)))?;
    let mut tail = Vec::new();
    file.take(MARK_WITHIN).read_to_end(&mut tail)?;
    let holds = |bytes: &[u8], mark: &[u8]| memchr::memmem::find(bytes, mark).is_some();
    Ok(BEGINS.iter().any(|begin| head.starts_with(begin))
        || head.starts_with(LABEL)
        || head.starts_with(SIMULATED.0) && holds(&head, SIMULATED.1)
        || head.starts_with(PICTURE.0) && holds(&head, PICTURE.1)
        || head.starts_with(photo::JPEG) && holds(&tail, photo::MARK)
        || head.starts_with(TABLE.0) && holds(&tail, TABLE.1) && holds(&tail, b"calfit"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_files_stay_and_own_files_are_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let folder = Folder::open(dir.path(), false).unwrap();
        fs::write(dir.path().join("a.md"), "my notes on calfit").unwrap();
        assert!(folder.write("a.md", b"x").is_err());
        assert_eq!(fs::read(dir.path().join("a.md")).unwrap(), b"my notes on calfit");
        folder.write("b.md", b"# calfit 1").unwrap();
        folder.write("b.md", b"# calfit 2").unwrap();
        assert_eq!(fs::read(dir.path().join("b.md")).unwrap(), b"# calfit 2");
        Folder::open(dir.path(), true).unwrap().write("a.md", b"calfit").unwrap();
        fs::create_dir(dir.path().join("c")).unwrap();
        assert!(folder.check("c").is_err());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_that_cannot_be_read_is_not_called_foreign() {
        // The memory of a process is a regular file without anything at its beginning.
        assert!(is_own(Path::new("/proc/self/mem")).is_err());
    }
}
