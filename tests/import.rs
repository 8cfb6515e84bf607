//! `calfit import`: a table of any dialect becomes the run that a person would write by hand, what is guessed of a table works as it
//! is, and no damage of a table passes in silence.

use crate::common;

use calfit::data::run::Run;
use calfit::files::ccr;
use common::check::{calfit, cpf, numbers, says, text};
use common::{Gauss, Plan, RUN_FILE, RUN_ID, programme};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use tempfile::TempDir;

/// 2013-04-03T09:22:38Z, s since 1970: 15798 days, 9 h 22 min 38 s.
const START_S: i64 = 15_798 * 86_400 + 9 * 3600 + 22 * 60 + 38;
/// Samples between two temperatures.
const TEMPERATURE_EVERY: usize = 1000;

/// A run of 22 plateaus at 100 Hz with 40 lost samples. Its samples stand in the middle of their periods, so that the edges of the settings
/// are in the middle between two of them.
fn measured() -> common::Run {
    let plan =
        Plan { rate_hz: 100.0, settings: programme(&[-2000.0, -1200.0, -400.0, 400.0, 1200.0, 2000.0], 2.0), ..Plan::default() };
    let mut run = plan.run().lose(1450..1490);
    for key in ["configuration", "field_source", "coil_correction", "earthfield_compensation"] {
        run = run.without_key(key);
    }
    let at = (0..run.samples.len()).step_by(TEMPERATURE_EVERY);
    run.temperatures = at.map(|i| (run.samples[i].t, [Some(20.5), Some(24.0 + i as f64 / 4000.0)])).collect();
    run
}

/// The run file as a person would write it.
fn by_hand(run: &common::Run) -> String {
    let mut times = run.temperatures.iter().map(|(t, _)| format!("{t:.3}")).collect::<Vec<_>>().into_iter();
    let mut out = String::new();
    let mut section = String::new();
    for line in run.text().lines() {
        let row = line.starts_with(|c: char| c.is_ascii_digit());
        if line.starts_with('@') {
            section = line.to_owned();
        }
        if section == "@TEMPERATURES" && row {
            let (_, rest) = line.split_once(',').unwrap();
            out += &format!("{},{rest}\n", times.next().unwrap());
        } else {
            out += &format!("{line}\n");
        }
    }
    out
}

/// The columns of a table: name and cells, empty where there is nothing.
type Columns = Vec<(&'static str, Vec<String>)>;

/// The run as columns; `reading` writes a reading, `temperature` a temperature.
fn columns(run: &common::Run, reading: impl Fn(f64) -> String, temperature: impl Fn(f64) -> String) -> Columns {
    let field = |t: f64, axis: usize| {
        let setting = run.settings.iter().find(|s| t < s.t_end).unwrap();
        format!("{:.1}", setting.field[axis])
    };
    let warm = |i: usize, which: usize| {
        let at = run.temperatures.iter().find(|(t, _)| *t == run.samples[i].t);
        at.and_then(|(_, values)| values[which]).map_or_else(String::new, &temperature)
    };
    let each = |cell: &dyn Fn(usize) -> String| (0..run.samples.len()).map(cell).collect::<Vec<String>>();
    let mut list: Columns = vec![("n", each(&|i| run.samples[i].n.to_string()))];
    for (axis, name) in ["mx", "my", "mz"].into_iter().enumerate() {
        list.push((name, each(&|i| reading((run.samples[i].reading[axis] * 1000.0).round() / 1000.0))));
    }
    for (axis, name) in ["bx", "by", "bz"].into_iter().enumerate() {
        list.push((name, each(&|i| field(run.samples[i].t, axis))));
    }
    list.push(("t_coil", each(&|i| warm(i, 0))));
    list.push(("t_sensor", each(&|i| warm(i, 1))));
    list.push(("sensor", each(&|_| "BS_11".to_owned())));
    list.push(("mode", each(&|_| "science mode 0".to_owned())));
    list
}

fn plain(v: f64) -> String {
    format!("{v:.3}")
}

fn degrees(v: f64) -> String {
    format!("{v:.2}")
}

/// ns since the start of a sample.
fn nanoseconds(t: f64) -> i64 {
    (t * 1e3).round() as i64 * 1_000_000
}

fn csv(columns: &Columns, separator: char) -> String {
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let mut out = names.join(&separator.to_string()) + "\n";
    for row in 0..columns[0].1.len() {
        let cells: Vec<&str> = columns.iter().map(|(_, cells)| cells[row].as_str()).collect();
        out += &(cells.join(&separator.to_string()) + "\n");
    }
    out
}

/// A folder with tables, mappings and the campaigns that come of them.
struct Desk {
    dir: TempDir,
}

impl Desk {
    fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap() }
    }

    fn put(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn import(&self, mapping: &str, table: &Path, campaign: &str) -> Output {
        let mapping = self.put(&format!("{campaign}.toml"), mapping);
        calfit().arg("import").arg(mapping).arg(table).arg("-o").arg(self.path(campaign)).output().unwrap()
    }

    /// The numbers of the linear calibration of the run of a campaign. The name of the campaign, which is that of its folder where it was
    /// begun by an import, is made the same for all: the parameter file states it.
    #[track_caller]
    fn calibrated(&self, campaign: &str) -> String {
        let toml = self.path(campaign).join("campaign.toml");
        let text_of_campaign = fs::read_to_string(&toml).unwrap();
        fs::write(&toml, text_of_campaign.replace(&format!("name = \"{campaign}\""), "name = \"one\"")).unwrap();
        let out = self.path(&format!("{campaign}-out"));
        let output = calfit().arg("lin").arg(self.path(campaign)).arg("-o").arg(&out).arg("--no-plots").output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{campaign}: {}", text(&output.stderr));
        numbers(&cpf(&out, RUN_ID))
    }

    /// Imports with a mapping and with the guessed one: both calibrations are those of the run by hand.
    #[track_caller]
    fn same(&self, name: &str, mapping: &str, table: &Path, expected: &str) {
        let output = self.import(mapping, table, &format!("{name}-given"));
        assert_eq!(output.status.code(), Some(0), "{name}: {}", text(&output.stderr));
        assert!(self.calibrated(&format!("{name}-given")) == expected, "{name}: other parameters than by hand");
        let guessed = calfit().args(["import", "--guess"]).arg(table).output().unwrap();
        assert_eq!(guessed.status.code(), Some(0), "{name}: {}", text(&guessed.stderr));
        let guessed = text(&guessed.stdout);
        let output = self.import(&guessed, table, &format!("{name}-guessed"));
        assert_eq!(output.status.code(), Some(0), "{name}: {}\n{guessed}", text(&output.stderr));
        assert!(self.calibrated(&format!("{name}-guessed")) == expected, "{name}: other parameters with\n{guessed}");
    }
}

fn mapping(file: &str, run: &str, time: &str, temperature: &str) -> String {
    format!(
        "[file]\n{file}\n[run]\nkind = \"linearity\"\nsensor = {{ column = \"sensor\" }}\nmode = {{ column = \"mode\" }}\n{run}\n[time]\n{time}\n\
         [reading]\ncolumns = [\"mx\", \"my\", \"mz\"]\n[field]\ncolumns = [\"bx\", \"by\", \"bz\"]\nunit = \"nT\"\n[temperature]\n{temperature}\n"
    )
}

const CELSIUS: &str = "T29 = \"t_coil\"\nT59 = \"t_sensor\"";

/// A desk with the run by hand, and its calibration.
fn hand() -> (Desk, common::Run, String) {
    let (desk, run) = (Desk::new(), measured());
    desk.put(&format!("hand/{RUN_FILE}"), by_hand(&run));
    desk.put("hand/campaign.toml", "name = \"hand\"\n[[position]]\nid = 1\naxes = [\"+X\", \"+Y\", \"+Z\"]\n");
    let expected = desk.calibrated("hand");
    (desk, run, expected)
}

#[test]
fn semicolons_decimal_commas_and_iso_times_give_the_parameters_of_the_run_by_hand() {
    let (desk, run, expected) = hand();
    let comma = |v: String| v.replace('.', ",");
    let mut columns = columns(&run, |v| comma(plain(v)), |v| comma(degrees(v)));
    columns.iter_mut().filter(|(name, _)| name.starts_with('b')).flat_map(|(_, c)| c).for_each(|c| *c = comma(c.clone()));
    // Summer time in Berlin, two hours ahead of UTC.
    let iso = run.samples.iter().map(|s| {
        let ms = nanoseconds(s.t) / 1_000_000;
        let (minute, second) = (22 + (38 + ms / 1000) / 60, (38 + ms / 1000) % 60);
        format!("2013-04-03T11:{minute:02}:{second:02},{:03}", ms % 1000)
    });
    columns.insert(0, ("Zeit", iso.collect()));
    let preamble = "Labor 5\nMessung; 3\n";
    let table = desk.put("lab.csv", preamble.to_owned() + &csv(&columns, ';'));
    let file = "separator = \";\"\ndecimal = \",\"\nskip_rows = 2";
    let time = "column = \"Zeit\"\nformat = \"iso8601\"\nzone = \"Europe/Berlin\"\ncounter = \"n\"";
    let given = mapping(file, "unit = \"nT\"", time, CELSIUS);
    let output = desk.import(&given, &table, "berlin");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(desk.calibrated("berlin") == expected);
    // Without the counter the 40 lost samples are found from the times.
    let output = desk.import(&given.replace("counter = \"n\"\n", ""), &table, "times");
    says(&text(&output.stdout), &["4360 samples at 100 Hz, 40 lost"]);
    assert!(desk.calibrated("times") == expected);
    // A guess cannot know the zone: without it the run has another hour and the same parameters.
    let utc = fs::read_to_string(&table).unwrap().replace("T11:", "T09:");
    let split = utc.replace("Zeit;", "Datum;Uhrzeit;").replace("2013-04-03T", "03.04.2013;");
    let table = desk.put("utc.csv", utc);
    let given = given.replace("Europe/Berlin", "UTC");
    desk.same("iso", &given, &table, &expected);
    // The date in a column of its own.
    let own = "column = \"Uhrzeit\"\ndate = \"Datum\"\nformat = \"%d.%m.%Y %H:%M:%S%.f\"";
    let given = given.replace("column = \"Zeit\"\nformat = \"iso8601\"", own);
    desk.same("split", &given, &desk.put("split.csv", split), &expected);
}

#[test]
fn tabs_and_unix_times_give_the_parameters_of_the_run_by_hand() {
    let (desk, run, expected) = hand();
    let mut columns = columns(&run, plain, |v| format!("{:.2}", v + 273.15));
    let unix = run.samples.iter().map(|s| {
        let ms = nanoseconds(s.t) / 1_000_000;
        format!("{}.{:03}", START_S + ms / 1000, ms % 1000)
    });
    columns.push(("epoch", unix.collect()));
    let table = desk.put("lab.tsv", csv(&columns, '\t'));
    let kelvin = "T29 = { column = \"t_coil\", unit = \"K\" }\nT59 = { column = \"t_sensor\", unit = \"K\" }";
    desk.same("unix", &mapping("separator = \"\\t\"", "", "column = \"epoch\"\nformat = \"unix\"", kelvin), &table, &expected);
    // The same settings as a table beside the mapping, with seconds since the run's start.
    let mut steps = "t_start,duration,bx,by,bz\n".to_owned();
    for s in &run.settings {
        steps += &format!("{},{},{},{},{}\n", s.t_start, s.t_end - s.t_start, s.field[0], s.field[1], s.field[2]);
    }
    desk.put("steps.csv", steps);
    let given = mapping("", "", "column = \"epoch\"\nformat = \"unix\"\ncounter = \"n\"", kelvin);
    let given = given.replace("columns = [\"bx\", \"by\", \"bz\"]", "table = \"steps.csv\"");
    let output = desk.import(&given, &table, "table");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(desk.calibrated("table") == expected);
}

#[cfg(feature = "tables")]
mod typed {
    use super::*;
    use polars::prelude::{Column, DataFrame, ParquetWriter};
    use polars_arrow::array::{Array, Float64Array, Int32Array, PrimitiveArray, Utf8Array};
    use polars_arrow::datatypes::{ArrowDataType, ArrowSchema, Field, TimeUnit};
    use polars_arrow::io::ipc::write::{FileWriter, WriteOptions};
    use polars_arrow::record_batch::RecordBatchT;
    use std::sync::Arc;

    fn number(text: &str) -> Option<f64> {
        text.parse().ok()
    }

    /// Columns of numbers and of text.
    pub fn frame(columns: &Columns) -> DataFrame {
        let is_text = |name: &str| name == "sensor" || name == "mode";
        let of = |(name, cells): &(&'static str, Vec<String>)| {
            if is_text(name) {
                return Column::new((*name).into(), cells);
            }
            Column::new((*name).into(), cells.iter().map(|c| number(c)).collect::<Vec<Option<f64>>>())
        };
        DataFrame::new(columns[0].1.len(), columns.iter().map(of).collect()).unwrap()
    }

    #[test]
    fn parquet_in_microtesla_gives_the_parameters_of_the_run_by_hand() {
        let (desk, run, expected) = hand();
        let mut columns = columns(&run, |v| format!("{:.6}", v / 1000.0), degrees);
        // Milliseconds since 1970.
        columns.push((
            "timestamp",
            run.samples.iter().map(|s| (START_S * 1000 + nanoseconds(s.t) / 1_000_000).to_string()).collect(),
        ));
        let table = desk.path("lab.parquet");
        ParquetWriter::new(fs::File::create(&table).unwrap())
            .with_row_group_size(Some(1000))
            .finish(&mut frame(&columns))
            .unwrap();
        let given = mapping("format = \"parquet\"", "unit = \"uT\"", "column = \"timestamp\"\nformat = \"unix_ms\"", CELSIUS);
        desk.same("parquet", &given, &table, &expected);
    }

    #[test]
    fn arrow_with_times_of_their_own_type_gives_the_parameters_of_the_run_by_hand() {
        let (desk, run, expected) = hand();
        let columns = columns(&run, plain, degrees);
        let (mut fields, mut arrays): (Vec<Field>, Vec<Box<dyn Array>>) = (Vec::new(), Vec::new());
        let mut push = |name: &str, array: Box<dyn Array>| {
            fields.push(Field::new(name.into(), array.dtype().clone(), true));
            arrays.push(array);
        };
        let micros: Vec<Option<i64>> = run.samples.iter().map(|s| Some(START_S * 1_000_000 + nanoseconds(s.t) / 1000)).collect();
        let times = PrimitiveArray::<i64>::from(micros).to(ArrowDataType::Timestamp(TimeUnit::Microsecond, None));
        push("when", times.boxed());
        for (name, cells) in &columns {
            match *name {
                "n" => push(name, Int32Array::from(cells.iter().map(|c| c.parse().ok()).collect::<Vec<Option<i32>>>()).boxed()),
                "sensor" | "mode" => push(name, Utf8Array::<i32>::from(cells.iter().map(Some).collect::<Vec<_>>()).boxed()),
                _ => push(name, Float64Array::from(cells.iter().map(|c| number(c)).collect::<Vec<Option<f64>>>()).boxed()),
            }
        }
        let schema: Arc<ArrowSchema> = Arc::new(fields.into_iter().map(|f| (f.name.clone(), f)).collect());
        let table = desk.path("lab.arrow");
        let options = WriteOptions { compression: None };
        let mut writer = FileWriter::new(fs::File::create(&table).unwrap(), schema.clone(), None, options);
        writer.start().unwrap();
        writer.write(&RecordBatchT::new(run.samples.len(), schema, arrays), None).unwrap();
        writer.finish().unwrap();
        desk.same("arrow", &mapping("", "", "column = \"when\"", CELSIUS), &table, &expected);
    }

    #[test]
    fn cut_tables_are_refused() {
        let desk = Desk::new();
        let columns = columns(&measured(), plain, degrees);
        let whole = desk.path("whole.parquet");
        ParquetWriter::new(fs::File::create(&whole).unwrap()).finish(&mut frame(&columns)).unwrap();
        let bytes = fs::read(&whole).unwrap();
        let given = mapping("", "start = \"2013-04-03T09:22:38Z\"", "column = \"n\"\nformat = \"seconds\"", CELSIUS);
        for (name, bytes) in [
            ("cut.parquet", &bytes[..bytes.len() / 2]),
            ("begin.parquet", &bytes[..3]),
            ("none.parquet", &bytes[..0]),
            ("other.arrow", &bytes[..]),
        ] {
            let output = desk.import(&given, &desk.put(name, bytes), name);
            assert_eq!(output.status.code(), Some(2), "{name}");
            says(&text(&output.stderr), &[name, "cannot be read as a table", "damaged"]);
        }
        let output = desk.import(&given, &desk.put("named.csv", &bytes), "named");
        says(&text(&output.stderr), &["named.csv", "format = \"parquet\""]);
    }
}

/// Plateaus of the table of 3400.
const PLATEAUS: usize = 3400;
/// Length of a plateau and of a change of temperature, s.
const PLATEAU_S: i64 = 6;
const PAUSE_S: i64 = 20 * 60;

/// Begin in s, field, reading and temperature of a plateau, in closed form: directions on a spiral, three temperatures.
fn plateau(k: usize) -> (i64, [f64; 3], [f64; 3], f64) {
    let stage = (3 * k / PLATEAUS) as i64;
    let degc = [-40.0, 20.0, 60.0][stage as usize];
    let (z, turn) = (1.0 - 2.0 * ((0.618 * k as f64).fract()), 2.4 * k as f64);
    let aside = (1.0 - z * z).sqrt();
    let round = |v: f64| (v * 1e3).round() / 1e3;
    let field = [40_000.0 * aside * turn.cos(), 40_000.0 * aside * turn.sin(), 40_000.0 * z].map(round);
    let reading = [0, 1, 2].map(|i| round(field[i] / (0.97 + 0.01 * i as f64 + 1e-5 * degc) + 5.0 - i as f64));
    (k as i64 * PLATEAU_S + stage * PAUSE_S, field, reading, degc + 0.25)
}

fn plateau_table() -> String {
    let mut out = "time,refX,refY,refZ,outX,outY,outZ,temp\n".to_owned();
    for k in 0..PLATEAUS {
        let (t, b, m, degc) = plateau(k);
        let clock = |s: i64| format!("01.03.2026 {:02}:{:02}:{:02}", 8 + s / 3600, s / 60 % 60, s % 60);
        out += &format!("{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{degc}\n", clock(t), b[0], b[1], b[2], m[0], m[1], m[2]);
    }
    out
}

const PLATEAU_MAPPING: &str = "[run]\nkind = \"linearity\"\nsensor = \"FM 1\"\nmode = \"science\"\n\
     configuration = \"SPIRAL\"\nfield_source = \"coils\"\n[time]\ncolumn = \"time\"\n\
     format = \"%d.%m.%Y %H:%M:%S\"\n[reading]\ncolumns = [\"outX\", \"outY\", \"outZ\"]\n[field]\ncolumns = [\"refX\", \"refY\", \"refZ\"]\n\
     [temperature]\nT59 = \"temp\"\n[rows]\nare = \"plateaus\"\n";

fn read(path: &Path) -> Run {
    ccr::read(path, &ccr::Options::default(), &mut ()).unwrap_or_else(|f| panic!("{f:?}"))
}

#[test]
fn thousands_of_plateaus_at_three_temperatures_are_one_run() {
    let desk = Desk::new();
    let table = desk.put("plateaus.csv", plateau_table());
    let output = desk.import(PLATEAU_MAPPING, &table, "one");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let run = read(&desk.path("one").join("26-03-01/08-00-00.CCR"));
    assert_eq!((run.header.run.as_str(), run.blocks.len(), run.findings.len()), ("26-03-01_08-00-00", PLATEAUS, 0));
    let temperatures = run.temperatures.channel("T59").unwrap();
    for (k, block) in run.blocks.iter().enumerate() {
        let (t, field, reading, degc) = plateau(k);
        assert_eq!([block.setting.t_start_s, block.setting.t_end_s], [t as f64, (t + PLATEAU_S) as f64], "{k}");
        assert_eq!((block.setting.field.0, block.mean.0, block.setting.position), (field, reading, 1), "{k}");
        assert_eq!(temperatures[k], (t as f64 + 3.0, degc), "{k}");
    }
    assert!(desk.path("one").join("campaign.toml").is_file());
}

#[test]
fn a_guess_reads_the_unit_of_a_temperature_from_its_name_or_asks() {
    let desk = Desk::new();
    let guess = |name: &str, value: f64| {
        let rows: String = (0..40)
            .map(|i| {
                let b = f64::from(i / 4 % 5) * 1000.0;
                format!("{}.0,{b},{},{},{},{},{},{value}\n", i, -b, 2.0 * b, 1.01 * b, -0.99 * b, 2.02 * b)
            })
            .collect();
        let table = desk.put("t.csv", format!("Time,Bx,By,Bz,Hx,Hy,Hz,{name}\n{rows}"));
        text(&calfit().args(["import", "--guess"]).arg(&table).output().unwrap().stdout)
    };
    says(&guess("T [K]", 295.0), &["T59 = { column = \"T [K]\", unit = \"K\" }"]);
    says(&guess("T_sensor_F", 68.0), &["T59 = { column = \"T_sensor_F\", unit = \"degF\" }"]);
    let told = guess("T_sensor_C", 20.0);
    says(&told, &["T59 = \"T_sensor_C\""]);
    assert!(!told.contains("tells the unit; 20"), "{told}");
    says(&guess("temp_sensor", 68.0), &["CHECK: no name tells the unit; 68.0 is taken for degrees Celsius"]);
}

#[test]
fn pauses_part_runs_and_a_guess_finds_them() {
    let desk = Desk::new();
    let table = desk.put("plateaus.csv", plateau_table());
    let guessed = text(&calfit().args(["import", "--guess"]).arg(&table).output().unwrap().stdout);
    says(&guessed, &["split_gap_s = 600", "are = \"plateaus\"", "\"refX\", \"refY\", \"refZ\""]);
    let split = PLATEAU_MAPPING.replace("[run]\n", "[run]\nsplit_gap_s = 600\n");
    for (name, given) in [("split", &split), ("guessed", &guessed)] {
        assert_eq!(desk.import(given, &table, name).status.code(), Some(0), "{given}");
        let mut k = 0;
        for stage in 0..3 {
            let begin = plateau(k).0;
            let file = format!("26-03-01/{:02}-{:02}-{:02}.CCR", 8 + begin / 3600, begin / 60 % 60, begin % 60);
            let run = read(&desk.path(name).join(&file));
            for block in &run.blocks {
                let (t, field, reading, _) = plateau(k);
                assert_eq!((block.setting.t_start_s, block.setting.field.0, block.mean.0), ((t - begin) as f64, field, reading));
                k += 1;
            }
            assert!(k == PLATEAUS || 3 * k / PLATEAUS == stage + 1, "{file}");
        }
        assert_eq!((k, runs(&desk.path(name))), (PLATEAUS, 3));
    }
}

#[test]
fn a_guess_finds_times_of_twelve_hours_and_is_printed_as_json() {
    let desk = Desk::new();
    // From 11:59:54 to 12:00:05 at noon: the small table with its times in another form.
    let twelve = |line: &str| {
        let Some((_, rest)) = line.split_once(',').filter(|(time, _)| *time != "time") else { return line.to_owned() };
        let n: u32 = rest.split(',').next().unwrap().parse().unwrap();
        let (hour, second) = if n < 60 { (11, 54 + n / 10) } else { (12, n / 10 - 6) };
        let minute = if n < 60 { 59 } else { 0 };
        let half = if n < 60 { "AM" } else { "PM" };
        format!("03/14/2026 {hour}:{minute:02}:{second:02}.{}5 {half},{rest}", n % 10)
    };
    let table = desk.put("twelve.csv", small().iter().map(|line| twelve(line) + "\n").collect::<String>());
    let guess = |options: &[&str]| text(&calfit().args(["import", "--guess"]).args(options).arg(&table).output().unwrap().stdout);
    let mapping = guess(&[]);
    says(&mapping, &["format = \"%m/%d/%Y %I:%M:%S%.f %p\""]);
    let json: serde_json::Value = serde_json::from_str(&guess(&["--json"])).unwrap();
    assert_eq!(json["mapping"].as_str(), Some(mapping.as_str()));
    assert_eq!(desk.import(&mapping, &table, "twelve").status.code(), Some(0));
    let run = read(&desk.path("twelve/26-03-14/11-59-54.CCR"));
    assert_eq!((run.vectors.count, run.vectors.lost), (120, 0));
}

/// A small table that is in order: 12 settings of 1 s at 10 Hz.
fn small() -> Vec<String> {
    let mut gauss = Gauss(7);
    let mut lines = vec!["time,n,mx,my,mz,bx,by,bz,t,sensor".to_owned()];
    for n in 0..120_usize {
        let mut b = [0.0; 3];
        b[n / 10 % 3] = [500.0, -500.0, 1000.0, -1000.0][n / 30];
        let [x, y, z] = b.map(|b| b / 0.98 + 3.0 + 0.05 * gauss.normal());
        let second = format!("{:02}.{}5", n / 10, n % 10);
        lines.push(format!("2026-03-01T08:00:{second}Z,{n},{x:.3},{y:.3},{z:.3},{},{},{},21.5,FM", b[0], b[1], b[2]));
    }
    lines
}

/// The mapping of [`small`], with some of its keys replaced.
fn small_mapping(changes: &[(&str, &str)]) -> String {
    let mut text = "[file]\nformat = \"csv\"\n[run]\nkind = \"linearity\"\nsensor = \"FM\"\nmode = \"science\"\n[time]\ncolumn = \"time\"\n\
         format = \"iso8601\"\n[reading]\ncolumns = [\"mx\", \"my\", \"mz\"]\n[field]\ncolumns = [\"bx\", \"by\", \"bz\"]\nunit = \"nT\"\n\
         [temperature]\nT59 = \"t\"\n"
        .to_owned();
    for (old, new) in changes {
        assert!(text.contains(old), "{old}");
        text = text.replacen(old, new, 1);
    }
    text
}

/// Number of run files below a folder.
fn runs(folder: &Path) -> usize {
    let list = |p: &Path| fs::read_dir(p).into_iter().flatten().map(|e| e.unwrap().path()).collect::<Vec<_>>();
    list(folder).iter().filter(|p| p.is_dir()).flat_map(|p| list(p)).count()
}

/// A table that is refused: nothing is written, and the message has the place and the words.
#[track_caller]
fn refused(mapping: &str, table: impl AsRef<[u8]>, words: &[&str]) {
    let desk = Desk::new();
    let table = desk.put("t.csv", table);
    let output = desk.import(mapping, &table, "out");
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    says(&stderr, words);
    assert!(stderr.matches("error: ").count() == 1 && stderr.contains("; "), "one error with its remedy: {stderr}");
    assert_eq!(runs(&desk.path("out")), 0, "a run was written");
}

/// A table that becomes a run, with a warning that has the words.
#[track_caller]
fn told(mapping: &str, table: impl AsRef<[u8]>, words: &[&str]) -> Run {
    let desk = Desk::new();
    let table = desk.put("t.csv", table);
    let output = desk.import(mapping, &table, "out");
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    says(&stderr, words);
    let day = fs::read_dir(desk.path("out")).unwrap().map(|e| e.unwrap().path()).find(|p| p.is_dir()).unwrap();
    let file = fs::read_dir(day).unwrap().next().unwrap().unwrap().path();
    read(&file)
}

/// The small table with one line changed, counted from 1.
fn with(line: usize, change: impl Fn(&str) -> String) -> String {
    let mut lines = small();
    lines[line - 1] = change(&lines[line - 1]);
    lines.join("\n") + "\n"
}

/// The same with one cell of a line replaced.
fn cell(line: usize, column: usize, new: &str) -> String {
    with(line, |l| {
        let mut cells: Vec<&str> = l.split(',').collect();
        cells[column] = new;
        cells.join(",")
    })
}

/// Every row changed by a function of its cells.
fn rows(change: impl Fn(usize, &mut Vec<String>)) -> String {
    let lines = small();
    let each = lines.iter().enumerate().map(|(i, l)| {
        let mut cells: Vec<String> = l.split(',').map(str::to_owned).collect();
        if i > 0 {
            change(i - 1, &mut cells);
        }
        cells.join(",") + "\n"
    });
    each.collect()
}

/// Numbers in columns multiplied by a factor.
fn times(columns: std::ops::Range<usize>, factor: f64) -> String {
    rows(|_, cells| {
        for cell in &mut cells[columns.clone()] {
            *cell = (cell.parse::<f64>().unwrap() * factor).to_string();
        }
    })
}

#[test]
fn the_small_table_is_in_order() {
    let run = told(&small_mapping(&[]), rows(|_, _| ()), &["not used: `n`, `sensor`"]);
    assert_eq!((run.settings.len(), run.vectors.count, run.vectors.lost, run.header.sample_rate_hz), (12, 120, 0, 10.0));
    assert_eq!((run.settings[1].t_start_s, run.settings[1].t_end_s, run.settings[1].field.0), (1.0, 2.0, [0.0, 500.0, 0.0]));
}

#[test]
fn a_date_and_a_time_in_two_columns_are_one_time() {
    let all = small().join("\n") + "\n";
    let joined = told(&small_mapping(&[]), &all, &[]);
    let of = |run: &Run| (run.header.start.clone(), run.settings.clone(), run.temperatures.clone());
    let split = all.replace("time,n", "clock,date,n").replace("2026-03-01T", "").replace("Z,", "Z,2026-03-01,");
    let keys = [("column = \"time\"", "column = \"clock\"\ndate = \"date\"")];
    assert!(of(&told(&small_mapping(&keys), split, &[])) == of(&joined));
    let pattern = all.replace("time,n", "clock,date,n").replace("2026-03-01T", "").replace("Z,", ",1.3.26,");
    let keys = [keys[0], ("\"iso8601\"", "\"%d.%m.%y %H:%M:%S%.f\"")];
    assert!(of(&told(&small_mapping(&keys), &pattern, &[])) == of(&joined));
    refused(&small_mapping(&keys), pattern.replacen("1.3.26", "31.2.26", 1), &["t.csv:2", "invalid date"]);
    refused(&small_mapping(&[(keys[0].0, "column = \"n\"\ndate = \"time\"")]), &all, &["time"]);
}

#[test]
fn damaged_text_is_refused_with_its_place() {
    let ok = small_mapping(&[]);
    let all = rows(|_, _| ());
    refused(&ok, "", &["t.csv", "empty"]);
    refused(&ok, "# nothing\n\n", &["no header line"]);
    refused(&ok, format!("{}\n", small()[0]), &["no rows"]);
    refused(&ok, with(1, |l| l.replace("my", "mq")), &["t.csv:1", "no column `my`", "`mq`"]);
    refused(&ok, with(1, |l| l.replace("my", "mx")), &["t.csv:1", "two columns", "`mx`"]);
    refused(&ok, with(9, |l| l.rsplit_once(',').unwrap().0.to_owned()), &["t.csv:9", "9 cells", "10"]);
    refused(&ok, with(9, |l| format!("{l},7")), &["t.csv:9", "11 cells"]);
    refused(&ok, with(9, |l| l.replacen('.', ",", 2)), &["t.csv:9", "cells", "decimal"]);
    refused(&small_mapping(&[("[run]", "separator = \";\"\n[run]")]), &all, &["t.csv:1", "no column", "separator"]);
    refused(&ok, all.replace(',', ";").replace('.', ","), &["t.csv:2", "`mx`", "decimal comma", "decimal = \",\""]);
    refused(&small_mapping(&[("[run]", "decimal = \",\"\n[run]")]), all.replace(',', ";"), &["t.csv:2", "decimal point"]);
    refused(&ok, cell(30, 2, "ERR"), &["t.csv:30:", "`ERR`", "`mx`", "no number"]);
    refused(&ok, cell(30, 3, "inf"), &["t.csv:30:", "`inf`", "`my`"]);
    refused(&ok, cell(30, 5, "5OO"), &["t.csv:30:", "`5OO`", "`bx`"]);
    refused(&ok, cell(30, 8, "warm"), &["t.csv:30:", "`warm`", "column `t`"]);
    refused(&ok, cell(30, 8, "-300"), &["t.csv:30:", "absolute zero"]);
    refused(&ok, cell(30, 0, ""), &["t.csv:30", "time is empty"]);
    refused(&ok, with(30, |l| l.replacen("21.5", "\u{0}", 1)), &["t.csv:30", "NUL"]);
    let latin: Vec<u8> = with(1, |l| l.replace(",t,", ",\u{b0}C,")).chars().map(|c| c as u8).collect();
    refused(&ok, latin, &["t.csv:1:", "UTF-8", "latin-1"]);
    let utf16: Vec<u8> = std::iter::once(0xfeff).chain(all.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    refused(&ok, utf16, &["UTF-16", "iconv"]);
}

#[test]
fn times_that_cannot_be_are_refused_with_their_place() {
    let ok = small_mapping(&[]);
    let all = rows(|_, _| ());
    let mut swapped = small();
    swapped.swap(20, 21);
    refused(&ok, swapped.join("\n"), &["t.csv:22", "time goes back by 0.1 s"]);
    refused(&ok, cell(30, 0, "2026-03-01T08:00:02.75Z"), &["t.csv:30", "the time of the row above", "other readings"]);
    refused(&ok, rows(|_, c| c[0] = "2026-03-01T08:00:00Z".to_owned()), &["same time", "counter"]);
    refused(&ok, rows(|n, c| c[0] = n.to_string()), &["t.csv:2", "ISO 8601"]);
    let format = |new: &str| small_mapping(&[("\"iso8601\"", new)]);
    refused(&format("\"unix\""), &all, &["t.csv:2", "is a date", "iso8601"]);
    refused(&format("\"%d.%m.%Y\""), &all, &["t.csv:2", "pattern"]);
    refused(&format("\"seconds\""), rows(|n, c| c[0] = format!("{}", n as f64 / 10.0)), &["date of the run's start", "start ="]);
    refused(&format("\"seconds\""), rows(|n, c| c[0] = format!("{}", 1_772_352_000 + n)), &["t.csv:2", "unix"]);
    refused(&format("\"unix\""), rows(|n, c| c[0] = format!("{}", 1_772_352_000_000 + n as i64)), &["t.csv:2", "unix_ms"]);
    refused(&format("\"unix_ms\""), rows(|n, c| c[0] = format!("{}", 1_772_352_000 + n)), &["t.csv:2", "unix"]);
    let zone = |name: &str| small_mapping(&[("\"iso8601\"", &format!("\"iso8601\"\nzone = \"{name}\""))]);
    refused(&zone("Europe/Bärlin"), &all, &["out.toml:", "zone"]);
    let local = |begin: &str| all.replace("2026-03-01T08:00:", begin).replace('Z', "");
    refused(&zone("Europe/Berlin"), local("2026-03-29 02:00:"), &["t.csv:2", "never show", "summer time"]);
    refused(&zone("Europe/Berlin"), local("2026-10-25 02:00:"), &["t.csv:2", "twice"]);
    let start = |zone: &str| {
        let keys = format!("\"iso8601\"\nzone = \"{zone}\"");
        small_mapping(&[("\"iso8601\"", &keys), ("[time]", "start = \"2026-03-01T08:00:00Z\"\n[time]")])
    };
    refused(&start("+05:00"), local("2026-03-01 08:00:"), &["t.csv:2", "-5.00 h", "zone"]);
    refused(&small_mapping(&[("[time]", "sample_rate = 1000.0\n[time]")]), &all, &["10.0", "1000 Hz", "sample_rate"]);
    let counter = small_mapping(&[("\"iso8601\"", "\"iso8601\"\ncounter = \"n\"")]);
    refused(&counter, cell(30, 1, "3"), &["t.csv:30", "goes back from 27 to 3"]);
    refused(&counter, cell(30, 1, "28.5"), &["t.csv:30", "whole number"]);
    // Two samples that the counter does not know of: what the reader of run files finds is told with the line of the table.
    let late = |n: usize| 0.05 + 0.1 * n as f64 + if n < 60 { 0.0 } else { 0.2 };
    let jump = rows(|n, c| c[0] = format!("2026-03-01T08:00:{:05.2}Z", late(n)));
    let nominal = counter.replace("[time]", "sample_rate = 10.0\n[time]");
    refused(&nominal, jump, &["t.csv:62", "away from the sample counter"]);
    refused(&counter, rows(|n, c| c[1] = (10 * n).to_string()), &["counter runs at 100", "10.0"]);
    refused(&counter, rows(|_, c| c[1] = "7".to_owned()), &["t.csv:2", "same in all rows"]);
}

#[test]
fn units_and_settings_that_do_not_fit_are_refused() {
    let ok = small_mapping(&[]);
    let all = rows(|_, _| ());
    refused(&ok, times(2..5, 1e-3), &["1.02", "e-3 enT per nT", "uT"]);
    refused(&ok, times(5..8, 1e-3), &["enT per nT", "may be in uT"]);
    refused(&ok, times(5..8, 1e-4), &["t.csv:2", "make one setting", "unit"]);
    refused(&small_mapping(&[("unit = \"nT\"", "unit = \"uT\"")]), &all, &["enT per nT"]);
    refused(
        &small_mapping(&[("[time]", "unit = \"counts\"\nnominal_factor = 0.001\n[time]")]),
        &all,
        &["nominal_factor", "0.98"],
    );
    refused(&ok, times(5..8, 1e7), &["t.csv:2", "`bx`", "cannot be"]);
    refused(
        &small_mapping(&[("unit = \"nT\"", "same_setting_within_nt = 0.0")]),
        rows(|n, c| c[5] = format!("{}", n as f64)),
        &["field", "same_setting_within_nt"],
    );
    refused(
        &small_mapping(&[("[field]\ncolumns = [\"bx\", \"by\", \"bz\"]\nunit = \"nT\"\n", "")]),
        &all,
        &["applied field", "[field]"],
    );
    let position = small_mapping(&[("[time]", "position = { column = \"t\" }\n[time]")]);
    refused(&position, &all, &["t.csv:2", "whole number"]);
    let sensor = small_mapping(&[("sensor = \"FM\"", "sensor = { column = \"sensor\" }")]);
    refused(&sensor, cell(50, 9, "FM 2"), &["t.csv:50", "`FM 2` follows `FM`", "split_column"]);
    let kind = small_mapping(&[("kind = \"linearity\"", "kind = { column = \"sensor\" }")]);
    refused(&kind, &all, &["t.csv:2", "not a kind"]);
    for (change, words) in [
        (("kind = \"linearity\"", "kind = \"scalar\""), "kind"),
        (("columns = [\"mx\", \"my\", \"mz\"]", "columns = [\"mx\", \"my\"]"), "three"),
        (("columns = [\"mx\", \"my\", \"mz\"]", ""), "reading.columns"),
        (("columns = [\"mx\", \"my\", \"mz\"]", "columns = [\"mx\", \"my\", \"mz\"]\ncount = \"n\""), "plateaus"),
        (("unit = \"nT\"", "unit = \"A\""), "nt_per_a"),
        (("format = \"csv\"", "format = \"xls\""), "parquet"),
        (("\"iso8601\"", "\"noon\""), "seconds"),
    ] {
        refused(&small_mapping(&[change]), &all, &["out.toml", words]);
    }
}

#[test]
fn plateaus_and_tables_of_settings_that_contradict_themselves_are_refused() {
    let plateaus = |keys: &str| small_mapping(&[]) + "[rows]\nare = \"plateaus\"\n" + keys;
    refused(&plateaus(""), cell(30, 0, "2026-03-01T08:00:02.75Z"), &["t.csv:30", "same time"]);
    refused(&plateaus(""), cell(30, 5, ""), &["t.csv:30", "no field"]);
    refused(&plateaus("t_end = \"time\"\n"), rows(|_, _| ()), &["t.csv:2", "ends before it begins"]);
    let std = plateaus("")
        .replace("[\"mx\", \"my\", \"mz\"]", "[\"mx\", \"my\", \"mz\"]\nstd = [\"bx\", \"by\", \"bz\"]\ncount = \"n\"");
    refused(&std, rows(|_, _| ()), &["t.csv:", "standard deviation"]);
    // Settings beside the mapping.
    let steps = |text: &str, words: &[&str]| {
        let desk = Desk::new();
        desk.put("steps.csv", text);
        let table = desk.put("t.csv", rows(|_, _| ()));
        let output =
            desk.import(&small_mapping(&[("columns = [\"bx\", \"by\", \"bz\"]", "table = \"steps.csv\"")]), &table, "out");
        says(&text_of(&output), words);
        (output.status.code().unwrap(), runs(&desk.path("out")))
    };
    let head = "t_start,t_end,bx,by,bz\n";
    let bad = |rows: &str, words: &[&str]| assert_eq!(steps(&format!("{head}{rows}"), words), (2, 0), "{rows}");
    bad("0,1,500,0,0\n0.5,2,0,500,0\n", &["steps.csv:3", "before the one above it ends"]);
    bad("1,2,500,0,0\n0,1,0,500,0\n", &["steps.csv:3", "before the one above it"]);
    bad("1,1,500,0,0\n", &["steps.csv:2", "ends before it begins"]);
    bad("0,1,500,,0\n", &["steps.csv:2", "no field"]);
    bad("100,101,500,0,0\n", &["steps.csv:2", "outside of the readings"]);
    bad("2026-03-01T10:00:00Z,2026-03-01T10:00:01Z,500,0,0\n", &["steps.csv:2", "outside of the readings", "zone"]);
    bad("zero,1,500,0,0\n", &["steps.csv:2", "`t_start`"]);
    assert_eq!(steps("t_start,bx,by,bz\n0,1,2,3\n", &["steps.csv", "`duration`"]), (2, 0));
    let some = format!("{head}0,1,500,0,0\n1,2,0,500,0\n50,51,0,0,500\n");
    assert_eq!(steps(&some, &["steps.csv:4", "1 of 3 settings", "outside"]), (0, 1));
}

fn text_of(output: &Output) -> String {
    text(&output.stderr)
}

#[test]
fn what_is_left_out_or_doubtful_is_told() {
    let ok = small_mapping(&[]);
    for nothing in ["NaN", ""] {
        let run = told(&ok, cell(30, 2, nothing), &["t.csv:30", "1 of 120 rows have no reading"]);
        assert_eq!((run.vectors.count, run.vectors.lost), (119, 1));
    }
    let mut lines = small();
    lines.drain(40..45);
    let run = told(&ok, lines.join("\n"), &["t.csv:41", "5 samples are missing before this row;"]);
    assert_eq!((run.vectors.count, run.vectors.lost, run.vectors.gaps.len()), (115, 5, 1));
    // Of several gaps the first one has its row.
    lines.drain(60..63);
    lines.remove(80);
    told(&ok, lines.join("\n"), &["t.csv:41", "5 samples are missing before this row, and 4 in 2 gaps behind it"]);
    let mut lines = small();
    lines.insert(40, lines[39].clone());
    let run = told(&ok, lines.join("\n"), &["t.csv:41", "1 rows repeat the row above"]);
    assert_eq!((run.vectors.count, run.vectors.lost), (120, 0));
    told(&ok, times(2..5, 0.2), &["enT per nT", "nominal_factor"]);
    told(&ok, rows(|_, c| c[8] = "295.15".to_owned()), &["`t`", "unit = \"K\""]);
    let kelvin = small_mapping(&[("T59 = \"t\"", "T59 = { column = \"t\", unit = \"K\" }")]);
    told(&kelvin, rows(|_, _| ()), &["`t`", "-251.7", "degC"]);
    let zone = small_mapping(&[("\"iso8601\"", "\"iso8601\"\nzone = \"+01:00\"")]);
    told(&zone, rows(|_, _| ()), &["t.csv:2", "offset of their own"]);
    // The hour that comes twice, entered from the hour before: 01:59:55 is summer time, 23:59:55 UTC.
    let berlin = small_mapping(&[("\"iso8601\"", "\"iso8601\"\nzone = \"Europe/Berlin\"")]);
    let over = rows(|n, c| {
        let s = n / 10;
        let clock = if s < 5 { format!("01:59:5{}", 5 + s) } else { format!("02:00:{:02}", s - 5) };
        c[0] = format!("2026-10-25 {clock}.{}5", n % 10);
    });
    let run = told(&berlin, over, &["t.csv:52", "70 times", "twice"]);
    assert_eq!((run.header.start.as_str(), run.vectors.lost), ("2026-10-24T23:59:55Z", 0));
    let unknown = told(&ok.replace("[temperature]", "[temprature]"), rows(|_, _| ()), &["`temprature` is not known", "`t`"]);
    assert!(unknown.temperatures.names.is_empty());
}

#[test]
fn a_run_is_not_written_over() {
    let desk = Desk::new();
    let table = desk.put("t.csv", rows(|_, _| ()));
    assert_eq!(desk.import(&small_mapping(&[]), &table, "out").status.code(), Some(0));
    let path = desk.path("out/26-03-01/08-00-00.CCR");
    let first = fs::read(&path).unwrap();
    let other = small_mapping(&[("sensor = \"FM\"", "sensor = \"FM 2\"")]);
    let output = desk.import(&other, &table, "out");
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["08-00-00.CCR", "there already", "--force"]);
    assert_eq!(fs::read(&path).unwrap(), first);
    let forced =
        calfit().arg("import").arg(desk.path("out.toml")).arg(&table).arg("--force").arg("-o").arg(desk.path("out")).output();
    assert_eq!(forced.unwrap().status.code(), Some(0));
    assert_eq!(read(&path).header.sensor, "FM 2");
    // The head of the file says what was done.
    let head = fs::read_to_string(&path).unwrap();
    says(
        &head,
        &["# imported by calfit", "t.csv (sha256 ", "line 2 to line 121", "# channel T59 from column `t`", "0 samples lost"],
    );
}

#[test]
fn other_commands_say_what_to_do_with_a_table() {
    let desk = Desk::new();
    let csv = desk.put("lab.csv", rows(|_, _| ()));
    let parquet = desk.put("lab.parquet", b"PAR1\x15\x04\x15\x10PAR1");
    let unnamed = desk.put("lab", b"ARROW1\0\0\xff\xff");
    for path in [&csv, &parquet, &unnamed] {
        for command in ["lin", "inspect", "check", "report", "null"] {
            let output = calfit().arg(command).arg(path).arg("-o").arg(desk.path(&format!("x-{command}"))).output().unwrap();
            let said = text(&output.stderr) + &text(&output.stdout);
            assert_ne!(output.status.code(), Some(0), "{command}");
            says(&said, &["table, not a run file", "calfit import", "--guess"]);
            assert!(!said.contains("frequency_hz") && !said.contains("control byte"), "{said}");
        }
    }
    let mapping = desk.put("m.toml", small_mapping(&[]));
    let output = calfit().arg("check").arg(&mapping).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let wrong = desk.put("w.toml", small_mapping(&[("\"iso8601\"", "\"noon\"")]));
    let output = calfit().arg("check").arg(&wrong).output().unwrap();
    says(&text(&output.stderr), &["w.toml:9", "time.format"]);
    for (arguments, words) in
        [(vec!["import"], "required"), (vec!["import", "m.toml"], "no table"), (vec!["import", "m.toml", "t.csv"], "-o CAMPAIGN")]
    {
        let output = calfit().args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        says(&text(&output.stderr), &[words]);
    }
}

#[test]
fn the_examples_of_the_reference_work() {
    let page = fs::read_to_string(common::check::data("docs/import.md")).unwrap();
    // Blocks of indented lines; empty lines between them belong to a mapping.
    let mut blocks: Vec<String> = vec![String::new()];
    for line in page.lines() {
        match line.strip_prefix("    ") {
            Some(code) => *blocks.last_mut().unwrap() += &format!("{code}\n"),
            None if line.is_empty() => {}
            None => blocks.push(String::new()),
        }
    }
    let desk = Desk::new();
    let tables = blocks.iter().filter(|b| b.starts_with("Zeit;") || b.starts_with("time,"));
    let mappings = blocks.iter().filter(|b| b.contains("[reading]"));
    let mut done = 0;
    for (table, mapping) in tables.zip(mappings) {
        done += 1;
        let table = desk.put(&format!("{done}.csv"), table);
        let output = desk.import(mapping, &table, &format!("c{done}"));
        assert_eq!((output.status.code(), text(&output.stderr).as_str()), (Some(0), ""), "{mapping}");
    }
    assert_eq!(done, 2);
    // 09:00 in a zone one hour ahead.
    let run = read(&desk.path("c1/26-03-01/08-00-00.CCR"));
    assert_eq!((run.vectors.count, run.temperatures.channel("T59").unwrap()[0].1), (2, 21.5));
    assert_eq!(read(&desk.path("c2/26-03-01/08-00-00.CCR")).blocks[1].mean.0, [-29545.82, 26795.93, -9625.13]);
}
