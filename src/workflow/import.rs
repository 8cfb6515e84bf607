//! Tables of any laboratory to run files, as a mapping says.

mod clock;
mod columns;
mod fit;
mod numbers;
mod run;
mod settings;

use crate::data::error::{Finding, Severity};
use crate::data::run::{Header, Kind, ReadingUnit};
use crate::data::start::Start;
use crate::files::ccr::{self, Decimals, Section, Writer};
use crate::files::import::mapping::{self, Given, ReadingScale};
use crate::files::import::{ForeignTable, Mapping, time};
use crate::files::output::Folder;
use crate::files::source::Digested;
use crate::files::text::quoted;
use columns::Columns;
use jiff::Timestamp;
use numbers::decimals;
use run::{Content, Source};
use serde::Serialize;
use settings::SettingsTable;
use std::collections::BTreeSet;
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A run that was written.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImportedRun {
    /// Path inside the campaign.
    pub path: String,
    /// Run id.
    pub run: String,
    /// The table that it comes from.
    pub table: String,
    /// Kind.
    pub kind: Kind,
    /// Sensor.
    pub sensor: String,
    /// Settings, or plateau means.
    pub settings: usize,
    /// Samples; 0 where the rows are means.
    pub samples: usize,
    /// Samples missing.
    pub lost: u64,
    /// Sample rate, Hz.
    pub sample_rate_hz: f64,
    /// Channels of temperatures.
    pub temperatures: Vec<String>,
    /// What was done.
    pub remarks: Vec<String>,
    #[serde(skip)]
    positions: BTreeSet<u32>,
}

/// A mapping that is applied to tables.
pub struct Import {
    mapping: Mapping,
    path: PathBuf,
    digested: Digested,
    out: PathBuf,
    force: bool,
    /// Write runs whose readings are not of the size of the field.
    allow_mismatch: bool,
}

/// The warning that names columns that are not used.
fn unused(file: &str, names: &[&String]) -> Finding {
    let names: Vec<String> = names.iter().map(|n| format!("`{n}`")).collect();
    let remedy = "name those that are wanted in the mapping, as [temperature] or [channel] for example";
    Finding::error(file, format!("columns that the mapping does not name were not used: {}", names.join(", ")), remedy)
        .weighing(Severity::Warning)
}

impl Import {
    /// Reads a mapping; runs go to the campaign folder `out`.
    ///
    /// # Errors
    /// What is wrong with the mapping.
    pub fn open(
        path: &Path,
        out: &Path,
        force: bool,
        allow_mismatch: bool,
        findings: &mut Vec<Finding>,
    ) -> Result<Self, Finding> {
        let (mapping, digested) = mapping::read(path, findings)?;
        Ok(Self { mapping, path: path.to_owned(), digested, out: out.to_owned(), force, allow_mismatch })
    }

    /// Makes the runs of one table; what a person should know goes to `findings`.
    ///
    /// # Errors
    /// Why the table makes no runs. Then nothing of it was written.
    pub fn table(&self, path: &Path, findings: &mut Vec<Finding>) -> Result<Vec<ImportedRun>, Finding> {
        let table = ForeignTable::read(path, self.mapping.format, &self.mapping.dialect)?;
        let columns = Columns::read(&table, &self.mapping, findings)?;
        let settings = match self.mapping.field.as_ref() {
            None => None,
            Some(keys) => SettingsTable::read(&self.mapping, keys, findings)?,
        };
        let source = Source { table: &table, mapping: &self.mapping, columns: &columns, settings: settings.as_ref() };
        let pieces = self.pieces(&source)?;
        if pieces.len() > 1 && settings.as_ref().is_some_and(|s| !s.is_absolute()) {
            let file = settings.as_ref().map_or("", |s| s.file());
            let rule = "the settings are in seconds since the run's start, and the table holds several runs";
            return Err(Finding::error(file, rule, "write t_start and t_end with the date"));
        }
        let mut made: Vec<(Header, Content)> = Vec::new();
        for rows in pieces {
            let (header, start_ns) = self.header(&source, &rows, made.len())?;
            if made.iter().any(|(h, _)| h.run == header.run) {
                let rule = format!("two runs of the table begin within the second of {}", header.run);
                return Err(table.refuse(rows.start, None, &rule, "correct `split_gap_s` or `split_column` under [run]"));
            }
            let content = source.content(rows, start_ns, header.kind, header.unit, findings)?;
            let header = Header { sample_rate_hz: content.rate_hz, ..header };
            findings.extend(fit::check(table.file(), &header, &content, self.allow_mismatch)?);
            self.free(&header.run)?;
            made.push((header, content));
        }
        made.iter().map(|(header, content)| self.write(&source, header, content, findings)).collect()
    }

    /// The rows of every run.
    fn pieces(&self, source: &Source) -> Result<Vec<Range<usize>>, Finding> {
        let run = &self.mapping.run;
        let count = source.table.rows();
        let names = run.split_column.as_ref().map(|name| source.table.texts(name)).transpose()?;
        let ns = &source.columns.times.ns;
        let gap_ns = run.split_gap_s.map(crate::data::time::ns);
        let begins = |row: &usize| {
            names.as_ref().is_some_and(|n| n[*row] != n[*row - 1]) || gap_ns.is_some_and(|gap| ns[*row] - ns[*row - 1] > gap)
        };
        let mut edges = vec![0];
        edges.extend((1..count).filter(begins));
        edges.push(count);
        Ok(edges.windows(2).map(|w| w[0]..w[1]).collect())
    }

    /// One value of a run: that of the mapping, or that of a column, which must be the same in all rows of the run.
    fn value(source: &Source, rows: &Range<usize>, given: Option<&Given<String>>) -> Result<Option<String>, Finding> {
        match given {
            None => Ok(None),
            Some(Given::Value(text)) => Ok(Some(text.clone())),
            Some(Given::Column(name)) => {
                let texts = source.table.texts(name)?;
                let first = &texts[rows.start];
                match rows.clone().find(|row| texts[*row] != *first) {
                    None => Ok(Some(first.clone())),
                    Some(row) => {
                        let rule = format!("`{}` follows `{first}` within one run", texts[row]);
                        let remedy = format!("set `split_column = \"{name}\"` under [run], or write the value into the mapping");
                        Err(source.table.refuse(row, Some(name), &rule, &remedy))
                    }
                }
            }
        }
    }

    /// The head of a run, and its start in ns of the times of the table.
    fn header(&self, source: &Source, rows: &Range<usize>, earlier: usize) -> Result<(Header, i64), Finding> {
        let run = &self.mapping.run;
        let text = |given: &Option<Given<String>>| Self::value(source, rows, given.as_ref());
        let kind_name = text(&run.kind)?.unwrap_or_else(|| Kind::Linearity.to_string());
        let kind = Kind::from_name(kind_name.trim()).filter(|k| *k != Kind::Scalar).ok_or_else(|| {
            let names: Vec<&str> = Kind::NAMES.iter().filter(|(k, _)| *k != Kind::Scalar).map(|(_, name)| *name).collect();
            let rule = format!("`{kind_name}` is not a kind of run that is imported");
            source.table.refuse(rows.start, None, &rule, &format!("use one of {}", names.join(", ")))
        })?;
        let (start, start_ns) = self.start(source, rows, text(&run.start)?, earlier)?;
        let id = Timestamp::from_second(start.seconds() as i64).map(|t| t.strftime("%y-%m-%d_%H-%M-%S").to_string());
        let unit = match self.mapping.reading.scale {
            ReadingScale::Ent(_) => ReadingUnit::Ent,
            ReadingScale::Counts(ent_per_count) => ReadingUnit::Counts { ent_per_count },
        };
        let header = Header {
            run: id.unwrap_or_default(),
            start,
            kind,
            configuration: text(&run.configuration)?.unwrap_or_default(),
            sensor: text(&run.sensor)?.unwrap_or_default(),
            mode: text(&run.mode)?.unwrap_or_default(),
            sample_rate_hz: 1.0,
            unit,
            field_source: text(&run.field_source)?.unwrap_or_default(),
            coil_correction: run.coil_correction,
            earthfield_compensation: run.earthfield_compensation.clone(),
        };
        Ok((header, start_ns))
    }

    /// The start of a run: that of the mapping, or the whole second in which its first row lies.
    fn start(
        &self,
        source: &Source,
        rows: &Range<usize>,
        given: Option<String>,
        earlier: usize,
    ) -> Result<(Start, i64), Finding> {
        /// ns in a second and in a day.
        const SECOND: i64 = 1_000_000_000;
        const DAY: i64 = 86_400 * SECOND;
        let (table, times) = (source.table, &source.columns.times);
        let first = times.ns[rows.start];
        let whole = first.div_euclid(SECOND) * SECOND;
        let at = |ns: i64| {
            Timestamp::from_nanosecond(i128::from(ns)).map(Start::from).map_err(|_| {
                table.refuse(rows.start, Some(&self.mapping.time.column), "the time is beyond the calendar", "correct it")
            })
        };
        let moment = given
            .map(|text| {
                let (ns, absolute) = time::one(&text, None, &self.mapping.time.zone)
                    .map_err(|(rule, _)| (rule, text.clone()))
                    .map_err(|(rule, text)| {
                        table.refuse(
                            rows.start,
                            None,
                            &format!("`start = {text}`: {rule}"),
                            "write it as \"2013-04-03T09:22:38Z\"",
                        )
                    })?;
                let remedy = "write it as \"2013-04-03T09:22:38Z\"";
                if absolute {
                    Ok(ns)
                } else {
                    Err(table.refuse(rows.start, None, &format!("`start = {text}` is no date and time"), remedy))
                }
            })
            .transpose()?;
        match (moment, times.absolute) {
            (None, true) => Ok((at(whole)?, whole)),
            (None, false) => {
                let rule = "the times are seconds, and the date of the run's start is not known";
                Err(Finding::error(table.file(), rule, "add `start = \"2013-04-03T09:22:38Z\"` under [run]"))
            }
            // Runs after the first one of a table begin with their own first row.
            (Some(_), true) if earlier > 0 => Ok((at(whole)?, whole)),
            (Some(start), true) => {
                if first < start - SECOND || first > start + DAY {
                    let hours = (first - start) as f64 / 3.6e12;
                    let rule = format!("the first time is {hours:+.2} h from `start` of the mapping");
                    let remedy = "correct `start` under [run], or `format` and `zone` under [time]";
                    return Err(table.refuse(rows.start, Some(&self.mapping.time.column), &rule, remedy));
                }
                Ok((at(start)?, start))
            }
            (Some(start), false) if earlier > 0 => Ok((at(start.saturating_add(whole))?, whole)),
            (Some(start), false) => Ok((at(start)?, 0)),
        }
    }

    /// Refuses a run whose file is there already.
    fn free(&self, id: &str) -> Result<(), Finding> {
        let (day, time) = id.split_once('_').unwrap_or(("", id));
        for end in ["CCR", "CCR.gz"] {
            let path = self.out.join(day).join(format!("{time}.{end}"));
            if path.exists() && (!self.force || end == "CCR.gz") {
                let remedy = "move it away, choose another folder with -o, or write over it with --force";
                return Err(Finding::error(&path.display().to_string(), "the run is there already", remedy));
            }
        }
        Ok(())
    }

    /// Writes a run under a temporary name, reads it as every command does, and gives it its name.
    fn write(
        &self,
        source: &Source,
        header: &Header,
        content: &Content,
        findings: &mut Vec<Finding>,
    ) -> Result<ImportedRun, Finding> {
        let (day, time) = header.run.split_once('_').unwrap_or(("", &header.run));
        let folder = Folder::open_below(&self.out, day, self.force)?;
        let name = format!("{time}.CCR");
        let mut file = folder.create(&name)?;
        let failed = |e: std::io::Error| Finding::io(&folder.path().join(&name), "write", &e);
        let mut head = Vec::new();
        let remarks = self.remarks(source, content);
        let mut writer = Writer::new(&mut head, header, content_decimals(header, content)).map_err(failed)?;
        write_head(&mut writer, &remarks, content).map_err(failed)?;
        if !content.vectors.is_empty() {
            writer.vectors(content.vectors.iter().copied()).map_err(failed)?;
        }
        writer.end().map_err(failed)?;
        // Places in the file, for complaints: the line above the first section, and that of the first vector below section and columns.
        let line_before =
            |mark: &[u8]| memchr::memmem::find(&head, mark).map(|at| memchr::memchr_iter(b'\n', &head[..at]).count() as u64 + 1);
        let keys = line_before(b"\n@").unwrap_or(0);
        let first_vector = line_before(b"\n@VECTORS\n").map_or(u64::MAX, |line| line + 3);
        file.write_all(&head).map_err(failed)?;
        let recorded = format!("{day}/{name}");
        let options = ccr::Options { recorded_path: Some(recorded.clone()), ..ccr::Options::default() };
        let read = ccr::read(file.so_far()?, &options, &mut ());
        let told = |finding: Finding| {
            let row = finding.line.and_then(|line| line.checked_sub(first_vector)).and_then(|i| content.rows.get(i as usize));
            match row {
                Some(row) => {
                    Finding { severity: finding.severity, ..source.table.refuse(*row, None, &finding.rule, &finding.remedy) }
                }
                None => Finding { file: format!("{} as {recorded}", source.table.file()).into(), ..finding },
            }
        };
        let run = read.map_err(|all| {
            let error = all.into_iter().find(|f| f.severity == Severity::Error);
            error.map_or_else(|| Finding::error(&recorded, "cannot be read again", "report this"), told)
        })?;
        // What the head lacks, every command tells; here rows matter.
        let matters = |f: &&Finding| f.severity == Severity::Warning && f.line.is_none_or(|line| line > keys);
        findings.extend(run.findings.iter().filter(matters).cloned().map(told));
        file.finish()?;
        folder.sync()?;
        let positions = content.settings.iter().chain(content.blocks.iter().map(|b| &b.setting)).map(|s| s.position).collect();
        Ok(ImportedRun {
            path: recorded,
            run: header.run.clone(),
            table: source.table.file().to_owned(),
            kind: header.kind,
            sensor: header.sensor.clone(),
            settings: content.settings.len() + content.blocks.len(),
            samples: content.vectors.len(),
            lost: run.vectors.lost,
            sample_rate_hz: header.sample_rate_hz,
            temperatures: content.temperatures.names.clone(),
            remarks,
            positions,
        })
    }

    /// What was done, line by line.
    fn remarks(&self, source: &Source, content: &Content) -> Vec<String> {
        let (mapping, table) = (&self.mapping, source.table);
        let (first, last) = (content.rows.first().copied().unwrap_or(0), content.rows.last().copied().unwrap_or(0));
        let mut list = vec![
            format!(
                "imported by calfit {} from {} (sha256 {}), {} to {}",
                env!("CARGO_PKG_VERSION"),
                file_name(table.file()),
                table.digested.sha256,
                table.row_name(first),
                table.row_name(last)
            ),
            format!("mapping {} (sha256 {})", file_name(&self.path.display().to_string()), self.digested.sha256),
        ];
        let format = mapping.time.format.as_ref().map_or("by its cells", |f| f.name());
        list.push(format!("time from column `{}`, format {format}, zone {}", mapping.time.column, mapping.time.zone.name));
        let unit = match mapping.reading.scale {
            ReadingScale::Ent(factor) => format!("{factor} enT each"),
            ReadingScale::Counts(factor) => format!("counts of {factor} enT"),
        };
        list.push(format!("readings from columns {}, {unit}", mapping.reading.columns.join(", ")));
        if let Some(settings) = source.settings {
            list.push(format!("settings from {}", settings.told()));
        } else if let Some(field) = &mapping.field {
            let unit = match field.scale {
                mapping::FieldScale::Same(factor) => format!("{factor} nT each"),
                mapping::FieldScale::Current(each) => format!("{each:?} nT per ampere"),
            };
            let columns = field.columns.iter().flatten().cloned().collect::<Vec<_>>().join(", ");
            list.push(format!(
                "applied field from columns {columns}, {unit}; one setting within {} nT",
                field.same_setting_within_nt
            ));
        }
        for channel in mapping.temperatures.iter().chain(&mapping.channels) {
            let unit = match channel.unit {
                mapping::TemperatureUnit::Celsius => "",
                mapping::TemperatureUnit::Kelvin => ", K - 273.15",
                mapping::TemperatureUnit::Fahrenheit => ", (degF - 32) / 1.8",
            };
            list.push(format!("channel {} from column `{}`{unit}", channel.name, channel.column));
        }
        list.extend(content.remarks.iter().cloned());
        list
    }

    /// Begins `campaign.toml` for these runs where there is none; whether it did.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn begin_campaign(&self, runs: &[ImportedRun]) -> Result<bool, Finding> {
        if runs.is_empty() || self.out.join("campaign.toml").exists() {
            return Ok(false);
        }
        let name = self.out.canonicalize().ok().and_then(|p| p.file_name().map(|n| n.to_string_lossy().into_owned()));
        let mut text = format!(
            "# calfit {}: begun by `calfit import`; yours to complete and to correct\nname = {}\n",
            env!("CARGO_PKG_VERSION"),
            quoted(&name.unwrap_or_default())
        );
        let ids: BTreeSet<u32> = runs.iter().flat_map(|r| r.positions.iter().copied()).chain([1]).collect();
        for id in ids {
            let check = if id == 1 {
                "coil axes along which the sensor axes X, Y, Z nominally lie"
            } else {
                "TO BE CORRECTED: a stand-in for how the sensor was turned"
            };
            text += &format!("\n# {check}\n[[position]]\nid = {id}\naxes = [\"+X\", \"+Y\", \"+Z\"]\n");
        }
        let sensors: BTreeSet<&str> = runs.iter().map(|r| r.sensor.as_str()).filter(|s| !s.is_empty()).collect();
        let mut channels: Vec<&String> = runs.iter().flat_map(|r| &r.temperatures).collect();
        channels.dedup();
        // The channels of the sensor and of the coil have these names where nothing else is said.
        let other = channels.iter().find(|c| c.as_str() != "T29").filter(|_| !channels.iter().any(|c| c.as_str() == "T59"));
        for sensor in sensors {
            if let Some(channel) = other {
                text += &format!("\n[[sensor]]\nname = {}\ntemperature_channel = {}\n", quoted(sensor), quoted(channel));
            }
        }
        let folder = Folder::open(&self.out, self.force)?;
        folder.write("campaign.toml", text.as_bytes())?;
        folder.sync()?;
        Ok(true)
    }
}

fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |n| n.to_string_lossy().into_owned())
}

/// Decimals with which nothing of the content is lost.
fn content_decimals(header: &Header, content: &Content) -> Decimals {
    let per_ent = 1.0 / header.unit.ent_per_unit();
    let settings = || content.settings.iter().chain(content.blocks.iter().map(|b| &b.setting));
    let slow = [&content.temperatures, &content.channels];
    let slow_times = slow.into_iter().flat_map(|table| table.t_s.iter().copied());
    let times = content.vectors.iter().map(|v| v.t_s).chain(settings().flat_map(|s| [s.t_start_s, s.t_end_s])).chain(slow_times);
    let readings = content.vectors.iter().flat_map(|v| v.reading.0);
    let means = content.blocks.iter().flat_map(|b| b.mean.0.into_iter().chain(b.std_ent.into_iter().flatten()));
    // Counts times enT per count and back are counts within rounding.
    let in_file = |v: f64| if header.unit == ReadingUnit::Ent { v } else { format!("{:.12e}", v * per_ent).parse().unwrap_or(v) };
    Decimals {
        time: decimals(times).min(9),
        field: decimals(settings().flat_map(|s| s.field.0)),
        reading: decimals(readings.chain(means).map(in_file)),
        slow: decimals(slow.into_iter().flat_map(|table| table.values.iter().flatten().copied())),
    }
}

/// Everything before the vectors.
fn write_head(writer: &mut Writer<&mut Vec<u8>>, remarks: &[String], content: &Content) -> std::io::Result<()> {
    remarks.iter().try_for_each(|remark| writer.remark(remark))?;
    if content.blocks.is_empty() {
        writer.fields(&content.settings)?;
    } else {
        writer.blocks(&content.blocks)?;
    }
    for (section, table) in [(Section::Temperatures, &content.temperatures), (Section::Channels, &content.channels)] {
        if !table.names.is_empty() {
            writer.slow(section, table)?;
        }
    }
    Ok(())
}
