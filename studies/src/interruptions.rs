//! What is left of a `report` that is killed, whose system calls fail, or that meets another one in the same folder.
//!
//! A result folder of an older state of a campaign is made anew from the whole campaign. Whatever happens on the way, every file has to be
//! that of the old or of the new state to the last byte, and the next run has to end with the new state: nothing more, nothing less, verified.
//! Where a run is refused because a system call failed, what rests on all runs is a third state: then every file has to be whole.
//!
//! Only the short runs of a campaign are taken, so that a report is a matter of some 50 ms and a thousand of them one of minutes. What long
//! runs add is computation between the same system calls.

use serde_json::Value;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Files by their path in a folder.
type Tree = BTreeMap<PathBuf, Vec<u8>>;

/// Files whose content passes through states between old and new: the list of all results and the mark of whoever is at work.
const IN_BETWEEN: [&str; 2] = ["INDEX.json", ".calfit.lock"];
/// System calls that fail once each, with the error that they fail with.
const FAILURES: [(&str, &str); 12] = [
    ("write", "ENOSPC"),
    ("fsync", "EIO"),
    ("fdatasync", "EIO"),
    ("renameat", "EACCES"),
    ("openat", "EMFILE"),
    ("mkdir", "EACCES"),
    ("unlink", "EIO"),
    ("fchmod", "EPERM"),
    ("close", "EIO"),
    ("read", "EIO"),
    ("getdents64", "EIO"),
    ("statx", "EACCES"),
];
/// System calls at which the report is killed once each: those that change files.
const KILLED_AT: [&str; 7] = ["write", "fsync", "fdatasync", "renameat", "openat", "mkdir", "unlink"];
/// Runs with fewer bytes than this are taken.
const SHORT: usize = 20_000;

fn read(folder: &Path) -> Result<Tree, Box<dyn Error>> {
    let mut tree = Tree::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(&next)? {
            let path = entry?.path();
            if path.is_dir() {
                open.push(path);
            } else {
                tree.insert(path.strip_prefix(folder)?.to_owned(), fs::read(&path)?);
            }
        }
    }
    Ok(tree)
}

fn write(folder: &Path, tree: &Tree) -> Result<(), Box<dyn Error>> {
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    for (name, bytes) in tree {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap_or(folder))?;
        fs::write(path, bytes)?;
    }
    Ok(())
}

/// Whether a file ends as files of its kind do.
fn is_whole(name: &str, bytes: &[u8]) -> bool {
    match name.rsplit('.').next() {
        Some("parquet") => bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"),
        Some("json") => serde_json::from_slice::<Value>(bytes).is_ok(),
        Some("html") => bytes.trim_ascii_end().ends_with(b"</html>"),
        _ => bytes.ends_with(b"\n"),
    }
}

/// Files of which an index says that they are stale: those of a third state that the new one does not have.
fn stale(now: &Tree) -> Vec<PathBuf> {
    let index: Option<Value> = now.get(Path::new("INDEX.json")).and_then(|bytes| serde_json::from_slice(bytes).ok());
    let files = index.as_ref().and_then(|index| index.get("files")?.as_array()).into_iter().flatten();
    let own = files.filter(|file| file["stale"] == Value::Bool(true));
    own.filter_map(|file| Some(PathBuf::from(file["path"].as_str()?))).collect()
}

/// Whether two files are the same. Where a third state may have been between them, the index names it among the files that were replaced.
fn is_same(name: &Path, a: Option<&Vec<u8>>, b: Option<&Vec<u8>>, may_be_third: bool) -> bool {
    let without_replaced = |bytes: &Vec<u8>| {
        let mut index: Value = serde_json::from_slice(bytes).ok()?;
        let files = index.get_mut("files").and_then(Value::as_array_mut)?;
        files.iter_mut().filter_map(Value::as_object_mut).for_each(|file| drop(file.remove("replaces")));
        Some(index)
    };
    match (a, b) {
        (Some(a), Some(b)) if may_be_third && name.ends_with("INDEX.json") => {
            without_replaced(a).is_some_and(|a| Some(a) == without_replaced(b))
        }
        _ => a == b,
    }
}

/// What a kind of interruption left.
#[derive(Clone, Debug, Default)]
pub struct Counts {
    /// What was done.
    pub what: String,
    /// How often.
    pub trials: usize,
    /// Runs that were cut short, refused or failed.
    pub stopped: usize,
    /// Runs after which a file was neither the old nor the new one, or no longer there.
    pub torn: usize,
    /// Runs that ended with status 0 although the folder is not the new one.
    pub silent: usize,
    /// Runs after which the next one did not end with the new state.
    pub not_mended: usize,
    /// The first of what was wrong.
    pub first: Option<String>,
}

impl Counts {
    fn of(what: &str) -> Self {
        Self { what: what.to_owned(), ..Self::default() }
    }

    fn note(&mut self, place: &str, what: String) {
        self.first.get_or_insert_with(|| format!("{place}: {what}"));
    }

    /// Whether nothing was wrong.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        self.torn + self.silent + self.not_mended == 0
    }
}

/// The campaign, the program, and the folders before and after.
pub struct Scene {
    program: PathBuf,
    campaign: PathBuf,
    out: PathBuf,
    old: Tree,
    new: Tree,
    /// How long the last undisturbed report took, s.
    course_s: Cell<f64>,
}

impl Scene {
    /// With a program and a campaign; everything is written below a folder that is empty.
    ///
    /// # Errors
    /// The program does not do its work undisturbed.
    pub fn new(program: &Path, source: &Path, below: &Path) -> Result<Self, Box<dyn Error>> {
        let mut all = read(source)?;
        all.retain(|_, bytes| bytes.len() < SHORT);
        let campaign = below.join("campaign");
        let out = below.join("out");
        let mut scene =
            Self { program: program.to_owned(), campaign, out, old: Tree::new(), new: Tree::new(), course_s: Cell::new(0.0) };
        // The old state lacks the last run.
        let last = all.keys().rfind(|name| name.to_string_lossy().contains(".CCR")).cloned().ok_or("no run")?;
        let bytes = all.remove(&last).unwrap_or_default();
        write(&scene.campaign, &all)?;
        scene.finish()?;
        scene.old = read(&scene.out)?;
        fs::create_dir_all(scene.campaign.join(&last).parent().unwrap_or(&scene.campaign))?;
        fs::write(scene.campaign.join(&last), bytes)?;
        scene.finish()?;
        scene.new = read(&scene.out)?;
        if scene.old == scene.new {
            return Err("the last run changes nothing".into());
        }
        Ok(scene)
    }

    fn command(&self, through: &[&str]) -> Command {
        let mut command = match through {
            [] => Command::new(&self.program),
            [tracer, rest @ ..] => {
                let mut command = Command::new(tracer);
                command.args(rest).arg(&self.program);
                command
            }
        };
        command.arg("report").arg(&self.campaign).args(["--no-plots", "-q", "--threads", "1", "-o"]).arg(&self.out);
        // Dates are those of a fixed moment, so that equal results have equal bytes.
        command.env("SOURCE_DATE_EPOCH", "1700000000").stdout(Stdio::null()).stderr(Stdio::null());
        command
    }

    fn finish(&self) -> Result<(), Box<dyn Error>> {
        let begin = Instant::now();
        let status = self.command(&[]).status()?;
        self.course_s.set(begin.elapsed().as_secs_f64());
        if status.success() { Ok(()) } else { Err(format!("an undisturbed report ends with {status}").into()) }
    }

    /// What is wrong with the folder right after an interruption.
    fn torn(&self, may_be_third: bool) -> Result<Option<String>, Box<dyn Error>> {
        let now = read(&self.out)?;
        for (name, bytes) in &now {
            let file = name.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            if IN_BETWEEN.contains(&file.as_str()) || file.starts_with('.') {
                continue;
            }
            let is_known = self.old.get(name) == Some(bytes) || self.new.get(name) == Some(bytes);
            if !(is_known || may_be_third && is_whole(&file, bytes)) {
                return Ok(Some(format!("{} is neither old nor new", name.display())));
            }
        }
        let lost = self.old.keys().find(|name| self.new.contains_key(*name) && !now.contains_key(*name));
        Ok(lost.map(|name| format!("{} is gone", name.display())))
    }

    /// What is wrong after the next run.
    fn mended(&self, may_be_third: bool) -> Result<Option<String>, Box<dyn Error>> {
        if let Err(error) = self.finish() {
            return Ok(Some(error.to_string()));
        }
        let left = if may_be_third { stale(&read(&self.out)?) } else { Vec::new() };
        if !left.is_empty() {
            left.iter().try_for_each(|name| fs::remove_file(self.out.join(name)))?;
            if let Err(error) = self.finish() {
                return Ok(Some(format!("with stale files deleted: {error}")));
            }
        }
        let now = read(&self.out)?;
        let differs = |name: &&PathBuf| !is_same(name, self.new.get(*name), now.get(*name), may_be_third);
        if let Some(name) = now.keys().chain(self.new.keys()).find(differs) {
            return Ok(Some(format!("{} differs from that of an undisturbed run", name.display())));
        }
        let verified = Command::new(&self.program)
            .args(["verify", "-q"])
            .arg(&self.out)
            .arg(&self.campaign)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()?;
        Ok((!verified.success()).then(|| format!("verify ends with {verified}")))
    }

    fn judge(&self, counts: &mut Counts, place: &str, success: bool, may_be_third: bool) -> Result<(), Box<dyn Error>> {
        counts.trials += 1;
        counts.stopped += usize::from(!success);
        if let Some(what) = self.torn(may_be_third)? {
            counts.torn += 1;
            counts.note(place, what);
        }
        if success && self.new.iter().any(|(name, bytes)| fs::read(self.out.join(name)).ok().as_ref() != Some(bytes)) {
            counts.silent += 1;
            counts.note(place, "status 0, but the folder is not the new one".to_owned());
        }
        if let Some(what) = self.mended(may_be_third)? {
            counts.not_mended += 1;
            counts.note(place, format!("the next run: {what}"));
        }
        Ok(())
    }

    /// Kills the report after times that cover all of its course.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn kills(&self, trials: usize, mut so_far: impl FnMut(&Counts)) -> Result<Counts, Box<dyn Error>> {
        let mut counts = Counts::of("killed (SIGKILL) after a time");
        for trial in 0..trials {
            write(&self.out, &self.old)?;
            let mut child = self.command(&[]).spawn()?;
            // The fractional parts of multiples of the golden section cover the course evenly for any number of trials.
            // The course is that of the run just before, since others may keep the computer busy.
            let after = self.course_s.get() * (trial as f64 * 0.618_033_988_749_895).fract();
            std::thread::sleep(Duration::from_secs_f64(after));
            let _ = child.kill();
            let success = child.wait()?.success();
            self.judge(&mut counts, &format!("killed after {:.0} ms", 1e3 * after), success, false)?;
            so_far(&counts);
        }
        Ok(counts)
    }

    /// Whether calls can be made to fail, which strace does.
    #[must_use]
    pub fn has_tracer() -> bool {
        Command::new("strace").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
    }

    /// Starts the report with something that happens at a system call; its end, and whether a call was made to fail.
    fn traced(&self, call: &str, what: &str) -> Result<(ExitStatus, bool), Box<dyn Error>> {
        write(&self.out, &self.old)?;
        let log = self.campaign.with_file_name("strace.log");
        let log_name = log.display().to_string();
        let (trace, inject) = (format!("trace={call}"), format!("inject={call}:{what}"));
        let tracer = ["strace", "-f", "-qq", "-o", &log_name, "-e", &trace, "-e", &inject];
        let status = self.command(&tracer).status()?;
        Ok((status, fs::read_to_string(&log)?.contains("(INJECTED)")))
    }

    /// Lets every call of every kind fail once, at most `most` of a kind. The calls of every thread are counted on their own.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn failed_calls(&self, most: usize, mut so_far: impl FnMut(&Counts)) -> Result<Vec<Counts>, Box<dyn Error>> {
        let mut list = Vec::new();
        for (call, error) in FAILURES {
            let mut counts = Counts::of(&format!("`{call}` fails with {error}"));
            for at in 1..=most {
                let (status, failed) = self.traced(call, &format!("error={error}:when={at}"))?;
                // Behind the last call nothing fails any more.
                if !failed {
                    break;
                }
                self.judge(&mut counts, &format!("call {at} of {call}"), status.success(), true)?;
                so_far(&counts);
            }
            list.push(counts);
        }
        Ok(list)
    }

    /// Kills the report at every call that changes files, at most `most` of a kind.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn killed_at_calls(&self, most: usize, mut so_far: impl FnMut(&Counts)) -> Result<Vec<Counts>, Box<dyn Error>> {
        let mut list = Vec::new();
        for call in KILLED_AT {
            let mut counts = Counts::of(&format!("killed at `{call}`"));
            for at in 1..=most {
                let (status, _) = self.traced(call, &format!("signal=SIGKILL:when={at}"))?;
                // Behind the last call nobody is killed any more.
                if status.success() {
                    break;
                }
                self.judge(&mut counts, &format!("killed at call {at} of {call}"), false, false)?;
                so_far(&counts);
            }
            list.push(counts);
        }
        Ok(list)
    }

    /// Starts two reports into one folder at the same time.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn pairs(&self, trials: usize, mut so_far: impl FnMut(&Counts)) -> Result<Counts, Box<dyn Error>> {
        let mut counts = Counts::of("two at the same time");
        for trial in 0..trials {
            write(&self.out, &self.old)?;
            let (mut first, mut second) = (self.command(&[]).spawn()?, self.command(&[]).spawn()?);
            let (a, b) = (first.wait()?.success(), second.wait()?.success());
            if !a && !b {
                counts.silent += 1;
                counts.note(&format!("pair {trial}"), "both refused".to_owned());
            }
            self.judge(&mut counts, &format!("pair {trial}"), a && b, false)?;
            so_far(&counts);
        }
        Ok(counts)
    }
}

/// A row of the table.
#[must_use]
pub fn line(counts: &Counts) -> String {
    let Counts { what, trials, stopped, torn, silent, not_mended, .. } = counts;
    format!("| {what} | {trials} | {stopped} | {torn} | {silent} | {not_mended} |\n")
}

/// The table of the study.
#[must_use]
pub fn report(list: &[Counts]) -> String {
    let mut text = "# Interrupted reports\n\n\
        A result folder of an older state of a campaign is made anew, and the run is interrupted: after times that are spread evenly over its course, or \
        at every system call of a kind, one after the other, counted in every thread on its own. Of two at the same time one is refused (stopped), or \
        they follow each other. Torn: a file is neither that of the old nor of \
        the new state, or is gone; where a failed call refuses a run, which changes what rests on all runs, it is not whole. Silent: status 0 with another folder than that of an undisturbed run. Not mended: the next run does not end \
        with the folder of an undisturbed run to the last byte, verified; after a refused run, whose protocol was a third state, what \
        the index calls stale is deleted, as it asks, before one more run, and the list of what was replaced is left out.\n\n\
        | interruption | trials | stopped | torn | silent | not mended |\n| --- | ---: | ---: | ---: | ---: | ---: |\n"
        .to_owned();
    list.iter().for_each(|counts| text.push_str(&line(counts)));
    let wrong: Vec<String> = list.iter().filter_map(|c| c.first.as_ref().map(|first| format!("* {}: {first}", c.what))).collect();
    if !wrong.is_empty() {
        let _ = write!(text, "\nThe first of what was wrong:\n\n{}\n", wrong.join("\n"));
    }
    text
}
