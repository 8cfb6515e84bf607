//! Python for tests: a virtual environment in the target folder, made once and used again as long as it is right.
//!
//! Everything of a project that is tested comes from a copy, so that nothing is written beside its sources.

use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The oldest Python with `tomllib`.
const OLDEST: (u32, u32) = (3, 11);
/// What builds the projects; without it every installation would fetch it again.
const BUILDER: &str = "setuptools>=70.1";

/// A virtual environment.
pub struct Environment {
    folder: PathBuf,
}

impl Environment {
    /// The environment of a name with packages of the registry and projects of this repository (paths from its root). `None`, with a
    /// line on standard error that says why, where there is no Python or the packages cannot be had. A project that cannot be
    /// installed is a failure of the test.
    ///
    /// Tests that run at the same time wait for each other, those of other processes too.
    #[track_caller]
    pub fn of(name: &str, packages: &[&str], projects: &[&str]) -> Option<Self> {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python");
        fs::create_dir_all(&all).unwrap();
        let lock = File::create(all.join(format!("{name}.lock"))).unwrap();
        lock.lock().unwrap();
        let environment = Self { folder: all.join(name) };
        match environment.make(packages) {
            Ok(()) => {
                projects.iter().for_each(|project| environment.install(project));
                Some(environment)
            }
            Err(reason) => {
                eprintln!("skipped: no Python to test with: {reason}");
                None
            }
        }
    }

    /// Python in the environment. It leaves no compiled files beside what it reads, and takes no packages from elsewhere.
    pub fn python(&self) -> Command {
        let mut command = Command::new(self.folder.join("bin").join("python"));
        command
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env("PYTHONNOUSERSITE", "1")
            .env_remove("PYTHONPATH")
            .env_remove("PYTHONHOME");
        command
    }

    fn pip(&self, arguments: &[&str]) -> Command {
        let mut command = self.python();
        command.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]).args(arguments);
        command
    }

    /// The environment with its packages: what is there if it was made of the same, a new one otherwise.
    fn make(&self, packages: &[&str]) -> Result<(), String> {
        let wanted = format!("{}\n{BUILDER}\n{}\n", interpreter()?, packages.join("\n"));
        let stamp = self.folder.join("packages");
        if fs::read_to_string(&stamp).is_ok_and(|found| found == wanted) && self.python().arg("--version").output().is_ok() {
            return Ok(());
        }
        if self.folder.exists() {
            fs::remove_dir_all(&self.folder).map_err(|e| e.to_string())?;
        }
        done(Command::new("python3").args(["-m", "venv"]).arg(&self.folder))?;
        done(self.pip(&["--retries", "1", "--timeout", "20", BUILDER]).args(packages))?;
        // Last, so that an environment that was not finished is made again.
        fs::write(stamp, wanted).map_err(|e| e.to_string())
    }

    /// Installs a project from a copy, unless it is there as it is now.
    #[track_caller]
    fn install(&self, project: &str) {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join(project);
        let mut files = Vec::new();
        list(&source, &mut files);
        files.sort();
        let mut hash = Sha256::new();
        for file in &files {
            let content = fs::read(file).unwrap();
            hash.update(format!("{} {}\n", file.strip_prefix(&source).unwrap().display(), content.len()));
            hash.update(content);
        }
        let wanted: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        let name = project.replace('/', "_");
        let stamp = self.folder.join(format!("{name}.installed"));
        if fs::read_to_string(&stamp).is_ok_and(|found| found == wanted) {
            return;
        }
        let copy = tempfile::tempdir().unwrap();
        for file in &files {
            let to = copy.path().join(file.strip_prefix(&source).unwrap());
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            fs::copy(file, to).unwrap();
        }
        // What the project needs is among the packages, so that nothing is fetched here.
        let result = done(self.pip(&["--no-deps", "--no-build-isolation", "--force-reinstall"]).arg(copy.path()));
        assert!(result.is_ok(), "{project} cannot be installed: {}", result.unwrap_err());
        fs::write(stamp, wanted).unwrap();
    }
}

/// The Python of the machine with its version.
fn interpreter() -> Result<String, String> {
    let program = "import sys; print(*sys.version_info[:2], sys.executable, sys.version.split()[0])";
    let said = done(Command::new("python3").args(["-c", program]))?;
    let said = String::from_utf8_lossy(&said.stdout).trim().to_owned();
    let mut version = said.split(' ').map_while(|word| word.parse::<u32>().ok());
    match (version.next(), version.next()) {
        (Some(major), Some(minor)) if (major, minor) >= OLDEST => Ok(said),
        _ => Err(format!("python3 is {said}, {}.{} is needed", OLDEST.0, OLDEST.1)),
    }
}

/// A command that has to succeed; otherwise what it said last.
fn done(command: &mut Command) -> Result<Output, String> {
    let called = command.get_program().display().to_string();
    let output = command.output().map_err(|e| format!("{called}: {e}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    let last: Vec<&str> = said.lines().rev().take(20).collect();
    Err(format!("{called}: {}: {}", output.status, last.into_iter().rev().collect::<Vec<_>>().join("\n")))
}

/// The files of a project without what Python leaves beside them.
fn list(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
        if name == "__pycache__" || name == "build" || name.ends_with(".egg-info") || name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            list(&path, files);
        } else {
            files.push(path);
        }
    }
}
