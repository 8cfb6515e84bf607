//! The end of a run file: a cut line, what the clock has noticed, and the run that comes out.

use super::{Parser, State, Stop};
use crate::data::error::{Finding, Severity};
use crate::data::run::{Run, VectorSink};
use crate::files::ccr::Section;
use std::path::Path;

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
        if !file.ends_with(&format!("{}.CCR", header.run.replace('_', "/"))) && header.run.len() == 17 {
            let stem = Path::new(file).file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let time = header.run.get(9..).unwrap_or_default();
            if !stem.starts_with(time) {
                self.findings.push(
                    Finding::error(
                        file,
                        format!("the run id `{}` does not go with the file name", header.run),
                        "outputs are named after the run id",
                    )
                    .weighing(Severity::Warning),
                );
            }
        }
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
