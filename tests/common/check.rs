//! Running the tool on synthetic files: the binary for what a user sees, the library where speed counts.

use super::RUN_ID;
use assert_cmd::Command;
use calfit::cli;
use calfit::data::error::{Finding, Severity};
use calfit::data::plateau::{self, Accumulator};
use calfit::data::run::{Run, Vector, VectorSink};
use calfit::files::campaign::Campaign;
use calfit::files::ccr;
use calfit::measure::lin::{self, Lin};
use calfit::workflow::RunResult;
use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Output};
use std::time::Duration;
use tempfile::TempDir;

/// A campaign folder and an output folder that go away in the end.
pub struct Case {
    dir: TempDir,
}

impl Case {
    pub fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap() }
    }

    /// A campaign of one good or bad run.
    pub fn of(bytes: impl AsRef<[u8]>) -> Self {
        let case = Self::new();
        case.put(super::RUN_FILE, bytes);
        case
    }

    pub fn path(&self) -> &Path {
        self.dir.path()
    }

    pub fn campaign(&self) -> PathBuf {
        self.dir.path().join("campaign")
    }

    pub fn out(&self) -> PathBuf {
        self.dir.path().join("out")
    }

    /// The run's own file.
    pub fn file(&self) -> PathBuf {
        self.campaign().join(super::RUN_FILE)
    }

    pub fn put(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.campaign().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    }

    /// Runs a command whose results go into a folder of their own; the folder.
    #[track_caller]
    pub fn made(&self, name: &str, arguments: &[&str], paths: &[&Path]) -> PathBuf {
        let out = self.path().join(name);
        let output = calfit().args(arguments).args(paths).args(["--no-plots", "-o"]).arg(&out).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{name}: {}", text(&output.stderr));
        out
    }

    /// `calfit lin` on the campaign.
    pub fn lin(&self, arguments: &[&str]) -> Output {
        self.run("lin", arguments)
    }

    /// A command on the campaign.
    pub fn run(&self, command: &str, arguments: &[&str]) -> Output {
        calfit().arg(command).arg(self.campaign()).arg("-o").arg(self.out()).args(arguments).output().unwrap()
    }

    /// `calfit lin` on the campaign, which must succeed; its messages.
    pub fn done(&self, arguments: &[&str]) -> String {
        let output = self.lin(&[&["--no-plots"], arguments].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stderr)
    }

    /// The parameter file of the run.
    pub fn cpf(&self) -> toml_edit::DocumentMut {
        cpf(&self.out(), RUN_ID)
    }
}

/// A file or folder of the project.
pub fn data(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Copies a folder with everything in it.
pub fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// The command line in this process.
pub fn calfit() -> Call {
    Call(vec!["calfit".into()])
}

/// A command with its arguments, called like one of a process.
pub struct Call(Vec<OsString>);

impl Call {
    pub fn arg(&mut self, argument: impl AsRef<OsStr>) -> &mut Self {
        self.0.push(argument.as_ref().to_owned());
        self
    }

    pub fn args<I: IntoIterator<Item: AsRef<OsStr>>>(&mut self, arguments: I) -> &mut Self {
        self.0.extend(arguments.into_iter().map(|a| a.as_ref().to_owned()));
        self
    }

    pub fn output(&self) -> std::io::Result<Output> {
        let (mut stdout, mut stderr) = (Vec::new(), Vec::new());
        let out = cli::Output { to: &mut stdout, is_terminal: false };
        let err = cli::Output { to: &mut stderr, is_terminal: false };
        let status = cli::run(self.0.clone(), out, err);
        // The status that a process has when it ends with this one.
        Ok(Output { status: ExitStatus::from_raw((status as i32) << 8), stdout, stderr })
    }
}

/// The program as a process of its own, with a fixed time, and an end to hanging: for what only a process shows, and where bytes of
/// results are compared, which hold the time.
pub fn process() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_calfit"));
    command.env("SOURCE_DATE_EPOCH", "1365000000").timeout(Duration::from_secs(60));
    command
}

/// The program as a process that is ended after so many seconds of work: those do not pass faster where the machine has other things to do.
pub fn with_seconds_of_work(seconds: u32) -> Command {
    let mut command = Command::new("sh");
    let script = format!("ulimit -t {seconds} && exec \"$@\"");
    command.args(["-c", &script, "sh", env!("CARGO_BIN_EXE_calfit")]).timeout(Duration::from_secs(300));
    command
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

pub fn cpf(out: &Path, run: &str) -> toml_edit::DocumentMut {
    parameters(&out.join(run).join(format!("PARAMETER_LIN__{run}.CPF")))
}

/// A parameter file.
pub fn parameters(path: &Path) -> toml_edit::DocumentMut {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).parse().unwrap()
}

/// The text of a parameter file from the first table after the provenance on: its numbers and nothing that depends on the input's
/// bytes.
pub fn numbers(document: &toml_edit::DocumentMut) -> String {
    let mut document = document.clone();
    document.remove("provenance").unwrap();
    document.to_string()
}

/// A number of a parameter file by its path, `angle_deg.xi_xy` or `matrix.sigma.0.0`.
pub fn number(document: &toml_edit::DocumentMut, path: &str) -> f64 {
    let mut item = document.as_item();
    let mut value = None;
    for key in path.split('.') {
        value = match (value, key.parse::<usize>()) {
            (None, Err(_)) => {
                item = item.get(key).unwrap_or_else(|| panic!("no {path}"));
                item.as_value()
            }
            (Some(list), Ok(index)) => toml_edit::Value::as_array(list).unwrap().get(index),
            _ => panic!("no {path}"),
        };
    }
    let value = value.unwrap();
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64)).unwrap()
}

pub fn three(document: &toml_edit::DocumentMut, path: &str) -> [f64; 3] {
    std::array::from_fn(|i| number(document, &format!("{path}.{i}")))
}

pub fn sigma(document: &toml_edit::DocumentMut) -> [f64; 3] {
    std::array::from_fn(|i| number(document, &format!("matrix.sigma.{i}.{i}")))
}

#[track_caller]
pub fn close(found: [f64; 3], wanted: [f64; 3], tolerance: f64) {
    let near = found.iter().zip(wanted).all(|(f, w)| (f - w).abs() <= tolerance);
    assert!(near, "{found:?} is not {wanted:?} within {tolerance}");
}

#[track_caller]
pub fn says(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "`{word}` is not in: {text}");
    }
}

/// Every file below a folder.
pub fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(folder: &Path, prefix: &str, files: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(folder).into_iter().flatten().map(Result::unwrap) {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                walk(&entry.path(), &format!("{name}/"), files);
            } else {
                files.insert(name, fs::read(entry.path()).unwrap());
            }
        }
    }
    let mut files = BTreeMap::new();
    walk(folder, "", &mut files);
    files
}

/// A refusal by `calfit lin`, on standard error and as JSON.
pub struct Refusal {
    pub status: i32,
    pub stderr: String,
    pub finding: serde_json::Value,
}

/// Has a campaign of one run refused, and checks what holds for every refusal: the file is named with a rule and a remedy, no file is
/// left, and older results stay as they were.
#[track_caller]
pub fn refused(bytes: impl AsRef<[u8]>, arguments: &[&str]) -> Refusal {
    let case = Case::of(bytes);
    refused_file(&case, "09-22-38.CCR", arguments)
}

/// The same for a campaign that is there.
#[track_caller]
pub fn refused_file(case: &Case, name: &str, arguments: &[&str]) -> Refusal {
    let first = case.lin(arguments);
    let stderr = text(&first.stderr);
    assert_ne!(first.status.code(), Some(0), "accepted: {stderr}");
    assert_eq!(tree(&case.out()).keys().collect::<Vec<_>>(), Vec::<&String>::new(), "files were left");

    let folder = case.out().join(RUN_ID);
    fs::create_dir_all(&folder).unwrap();
    for name in ["PARAMETER_LIN__13-04-03_09-22-38.CPF", "LIN_RESIDUALS__13-04-03_09-22-38.png"] {
        fs::write(folder.join(name), format!("calfit wrote {name} before")).unwrap();
    }
    let before = tree(&case.out());
    let second = case.lin(&[arguments, &["--json"]].concat());
    assert!(tree(&case.out()) == before, "older results were changed");
    assert_eq!(second.status.code(), first.status.code());
    let listing: serde_json::Value = serde_json::from_slice(&second.stdout).unwrap();
    let errors = listing["failed"].as_array().unwrap();
    let finding = errors.iter().find(|f| f["severity"] == "error").unwrap_or_else(|| panic!("no error in {listing}")).clone();
    assert!(finding["file"].as_str().unwrap().ends_with(name), "{finding}");
    assert!(!finding["rule"].as_str().unwrap().is_empty() && !finding["remedy"].as_str().unwrap().is_empty(), "{finding}");
    says(&stderr, &["error: ", name, finding["rule"].as_str().unwrap(), finding["remedy"].as_str().unwrap()]);
    Refusal { status: first.status.code().unwrap(), stderr, finding }
}

impl Refusal {
    /// Unreadable input.
    #[track_caller]
    pub fn unreadable(self) -> Self {
        assert_eq!(self.status, 2, "{}", self.stderr);
        self
    }

    /// Refused by the analysis.
    #[track_caller]
    pub fn by_analysis(self) -> Self {
        assert_eq!(self.status, 1, "{}", self.stderr);
        self
    }

    #[track_caller]
    pub fn at(self, line: u64, column: u64) -> Self {
        assert_eq!(self.finding["line"], line, "{}", self.stderr);
        assert_eq!(self.finding["column"], column, "{}", self.stderr);
        says(&self.stderr, &[&format!(":{line}:{column}: ")]);
        self
    }

    #[track_caller]
    pub fn in_line(self, line: u64) -> Self {
        assert_eq!(self.finding["line"], line, "{}", self.stderr);
        says(&self.stderr, &[&format!(":{line}:")]);
        self
    }

    /// The offending text, at most 40 characters of it.
    #[track_caller]
    pub fn found(self, begin: &str) -> Self {
        let found = self.finding["found"].as_str().unwrap_or_else(|| panic!("no text in {}", self.stderr));
        assert!(found.starts_with(begin) && found.chars().count() <= 41, "{found}");
        says(&self.stderr, &[found]);
        self
    }

    #[track_caller]
    pub fn says(self, words: &[&str]) -> Self {
        says(&self.stderr, words);
        self
    }
}

/// Reads a file through the library.
pub fn read<S: VectorSink>(path: &Path, sink: &mut S) -> Result<Run, Vec<Finding>> {
    ccr::read(path, &ccr::Options::default(), sink)
}

/// The error with which the library refuses a text.
#[track_caller]
pub fn error_of(bytes: impl AsRef<[u8]>) -> Finding {
    let case = Case::of(bytes);
    let findings = read(&case.file(), &mut Accumulator::default()).expect_err("accepted");
    findings.into_iter().find(|f| f.severity == Severity::Error).unwrap()
}

/// Reads and fits a file through the library.
pub fn fit_with(path: &Path, reading: &ccr::Options, options: &lin::Options) -> Result<Lin, String> {
    let campaigns = Campaign::open(&[path.to_owned()], &mut Vec::new()).map_err(|f| f.to_string())?;
    let mut sink = Accumulator::default();
    let run =
        ccr::read(path, reading, &mut sink).map_err(|all| all.iter().map(Finding::to_string).collect::<Vec<_>>().join("\n"))?;
    let plateaus = if run.blocks.is_empty() { sink.finish(options.cut) } else { plateau::from_blocks(&run.blocks) };
    lin::lin(&run, &plateaus, &campaigns[0].file.instructions, options).map_err(|e| format!("{e}; {}", e.remedy()))
}

/// Fits a text through the library.
pub fn fit(bytes: impl AsRef<[u8]>) -> Result<Lin, String> {
    let case = Case::of(bytes);
    fit_with(&case.file(), &ccr::Options::default(), &lin::Options::default())
}

/// All numbers of a result to their last bit.
pub fn bits(lin: &Lin) -> String {
    serde_json::to_string(&lin.view()).unwrap()
}

pub fn fitted_sigma(lin: &Lin) -> [f64; 3] {
    lin.calibration.sigma_nt_per_ent()
}

/// Keeps every vector.
#[derive(Default)]
pub struct Keep(pub Vec<Vector>);

impl VectorSink for Keep {
    fn vector(&mut self, vector: Vector) {
        self.0.push(vector);
    }
}
