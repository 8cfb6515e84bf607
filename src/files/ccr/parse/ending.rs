//! The end of a run file: a cut line, what the clock has noticed, and the run that comes out.

use super::{Parser, State, Stop};
use crate::data::error::{Finding, Severity};
use crate::data::run::{Header, Run, VectorSink, time_of_id};
use crate::files::ccr::Section;
use crate::files::ccr::header::{later_than_id, length};
use std::ffi::OsStr;
use std::path::Path;

/// Characters of a run id that tells the start.
const ID_LENGTH: usize = "yy-mm-dd_hh-mm-ss".len();
/// Those of them that stand before the time of the day.
const DAY_LENGTH: usize = "yy-mm-dd_".len();

/// What the name of a run file, YY-MM-DD/hh-mm-ss.CCR, contradicts its head in: the run id, or where that tells no time the start.
fn against_name(file: &str, header: &Header) -> Option<Finding> {
    let text = |part: Option<&OsStr>| part.map(|part| part.to_string_lossy().into_owned()).unwrap_or_default();
    let (stem, day) = (text(Path::new(file).file_name()), text(Path::new(file).parent().and_then(Path::file_name)));
    let told = |of_file: &str| time_of_id(of_file).is_some() && of_file.find('-') == Some(2);
    let of_file = stem.get(..ID_LENGTH - DAY_LENGTH).map(|time| format!("{day}_{time}")).filter(|of_file| told(of_file));
    let run = &header.run;
    let (rule, remedy) = if run.len() == ID_LENGTH {
        // In another folder than that of a day the file has its time of day alone.
        let is_same = match &of_file {
            Some(of_file) => of_file == run,
            None => run.get(DAY_LENGTH..).is_some_and(|time| stem.starts_with(time)),
        };
        if is_same {
            return None;
        }
        (format!("the run id `{run}` does not go with the file name"), "outputs are named after the run id")
    } else {
        let later_s = later_than_id(of_file.as_ref()?, &header.start)?;
        let which = if later_s > 0.0 { "later" } else { "earlier" };
        (
            format!("`start` is {}, {} {which} than the file name tells", header.start, length(later_s)),
            "correct the wrong one of the two: the periods of the facility and the order of the runs follow `start`",
        )
    };
    Some(Finding::error(file, rule, remedy).weighing(Severity::Warning))
}

impl<S: VectorSink> Parser<'_, S> {
    /// What stands after the last line end: nothing, `@END`, or a cut line.
    pub(super) fn rest(&mut self, bytes: &[u8]) -> Result<(), Stop> {
        if self.line == 0 && bytes.is_empty() {
            return Err(Finding::error(self.file, "the file is empty", "take it from the archive again").into());
        }
        if !bytes.is_empty() {
            self.line += 1;
            if self.line == 1 {
                self.encoding(bytes)?;
                self.foreign(bytes)?;
            }
            if bytes.contains(&b'\r') {
                return Err(self.carriage_returns(bytes).into());
            }
            let whole = bytes.trim_ascii_end() == b"@END" || self.state == State::Ended;
            if whole || bytes.iter().any(|b| *b < 0x20 && *b != b'\t') || self.state == State::Magic {
                let result = self.one_line(bytes);
                self.absorb(result)?;
            } else if !self.options.allow_truncated {
                let finding = Finding::error(
                    self.file,
                    format!("the file ends inside a line; the last good row is line {}", self.last_good()),
                    "take the file from the archive again, or read what is there with --allow-truncated",
                );
                return Err(finding.at(self.line, 1).found(bytes).into());
            }
        }
        if self.state == State::Ended {
            return Ok(());
        }
        let finding = Finding::error(
            self.file,
            format!("the file ends without @END; the last good row is line {}", self.last_good()),
            "take the file from the archive again, or read what is there with --allow-truncated",
        )
        .at(self.line, 0);
        if self.options.allow_truncated && self.header.is_some() {
            self.findings.push(finding.weighing(Severity::Warning));
            return Ok(());
        }
        Err(finding.into())
    }

    fn last_good(&self) -> u64 {
        // Rows of the fast path are good unless they stopped the reader.
        if self.errors == 0 && self.line > 0 { self.line.saturating_sub(1).max(self.last_good_line) } else { self.last_good_line }
    }

    /// What the clock has noticed beside single rows.
    fn clock_findings(&self) -> Vec<Finding> {
        let clock = &self.clock;
        let mut findings = Vec::new();
        // A few repetitions are left out; many mean that something is wrong with the file.
        let mut repeated = |what: &str, count: u64, lines: &[u64], remedy: &str| {
            if count == 0 {
                return;
            }
            let many = count > 10.max(clock.account.count / 1000) && !self.options.allow_duplicates;
            let lines: Vec<String> = lines.iter().map(u64::to_string).collect();
            findings.push(
                Finding::error(
                    self.file,
                    format!("{count} {what} of the row above them (lines {} ...)", lines.join(", ")),
                    if many { "repair the file, or go on with --allow duplicates" } else { remedy },
                )
                .weighing(if many { Severity::Error } else { Severity::Warning }),
            );
        };
        repeated("rows repeat the sample counter", clock.account.duplicates, &clock.duplicate_lines, "they were left out");
        match clock.coarse_step_s() {
            None => {
                repeated("rows repeat the time tag", clock.equal_tags, &clock.equal_lines, "times come from the sample counter")
            }
            Some(step_s) => {
                findings.push(
                    Finding::error(
                        self.file,
                        format!("the time column has steps of about {step_s:.3} s, longer than a sample"),
                        "times were rebuilt from the sample counter; plateau edges are uncertain by up to one step",
                    )
                    .weighing(Severity::Warning),
                );
                let nominal = self.header.as_ref().map_or(0.0, |h| h.sample_rate_hz);
                if let Some(rate_hz) = clock.wrong_rate_hz() {
                    findings.push(Finding::error(
                        self.file,
                        format!("the time tags run at {rate_hz:.4} Hz, the header says {nominal} Hz"),
                        "correct `sample_rate`, or repair counter or time tags",
                    ));
                }
            }
        }
        findings
    }

    pub(super) fn finish(mut self) -> Result<Run, Vec<Finding>> {
        let file = self.file;
        let clock_findings = self.clock_findings();
        self.findings.extend(clock_findings);
        let header = self.header.take();
        if !self.blocks.is_empty() && (self.seen.contains(&Section::Vectors) || self.seen.contains(&Section::Fields)) {
            self.findings.push(Finding::error(
                file,
                "@BLOCKS stands beside @FIELDS or @VECTORS, so it is open which of them holds",
                "keep the plateau means or the samples, not both",
            ));
        }
        let Some(header) = header else {
            self.findings.push(Finding::error(file, "the file has no keys and no sections", "check that this is a run file"));
            return Err(self.findings);
        };
        self.findings.extend(against_name(file, &header));
        if self.findings.iter().any(|f| f.severity == Severity::Error) {
            return Err(self.findings);
        }
        if !self.begun {
            self.sink.begin(&header, &self.settings);
        }
        Ok(Run {
            header,
            settings: self.settings,
            blocks: self.blocks,
            temperatures: self.temperatures,
            channels: self.channels,
            scalar: self.scalar,
            vectors: self.clock.finish(),
            input: self.input,
            findings: self.findings,
            exclusions: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::run::{Kind, ReadingUnit};

    fn head(run: &str, start: &str) -> Header {
        Header {
            run: run.to_owned(),
            start: start.parse().unwrap(),
            kind: Kind::Linearity,
            configuration: String::new(),
            sensor: String::new(),
            mode: String::new(),
            sample_rate_hz: 1.0,
            unit: ReadingUnit::Ent,
            field_source: String::new(),
            coil_correction: None,
            earthfield_compensation: Vec::new(),
        }
    }

    #[test]
    fn file_names_go_with_the_run_id_and_the_start() {
        let told = |file: &str, run: &str| against_name(file, &head(run, "2026-03-03T11:00:00Z")).map(|f| f.rule.to_string());
        let id = "26-03-03_11-00-00";
        for file in ["26-03-03/11-00-00.CCR", "/a/26-03-03/11-00-00.ccr.gz", "11-00-00.CCR", "some/folder/11-00-00.CCR"] {
            assert_eq!(told(file, id), None, "{file}");
        }
        for file in ["26-03-04/11-00-00.CCR", "26-03-03/12-00-00.CCR", "folder/12-00-00.CCR", "26-03-03/run.CCR"] {
            assert_eq!(told(file, id), Some(format!("the run id `{id}` does not go with the file name")), "{file}");
        }
        // An id that tells no time.
        assert_eq!(told("26-03-03/11-00-00.CCR", "RUN_7"), None);
        assert_eq!(told("runs/7.CCR", "RUN_7"), None);
        let later = "`start` is 2026-03-03T11:00:00Z, 60 min later than the file name tells";
        assert_eq!(told("26-03-03/10-00-00.CCR", "RUN_7").as_deref(), Some(later));
    }
}
