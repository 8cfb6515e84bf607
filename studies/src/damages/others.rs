//! The same runs by other ways into the program: as a table that is imported, and as readings to which a calibration is applied.

use super::text::Text;
use super::{Analysed, called, runs};
use serde_json::Value;
use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};

const MAPPING: &str = "[run]\nkind = \"linearity\"\nsensor = \"FGM\"\nmode = \"science\"\n\n[time]\ncolumn = \"time\"\nformat = \"iso8601\"\n\n\
[reading]\ncolumns = [\"x\", \"y\", \"z\"]\n\n[field]\ncolumns = [\"bx\", \"by\", \"bz\"]\n\n[temperature]\nT59 = \"T59\"\nT29 = \"T29\"\n\n\
[rows]\nare = \"plateaus\"\n";

/// The means of a run as a table of a laboratory.
fn table(text: &Text, columns: &[&str]) -> String {
    let mut text = text.clone();
    let temperatures = text.section("TEMPERATURES").cloned();
    // At the reading of the thermistor before.
    let degc = |channel: &str, t_s: f64| {
        let table = temperatures.as_ref()?;
        let place = table.place(channel)?;
        let time = |row: &[String]| row[0].parse::<f64>().is_ok_and(|t| t <= t_s);
        let row = table.rows.iter().rev().find(|row| time(row)).or(table.rows.first())?;
        Some(row[place].clone())
    };
    let mut out = columns.join(",") + "\n";
    let Some(blocks) = text.section("BLOCKS") else { return out };
    for row in &blocks.rows {
        let number = |name: &str| blocks.place(name).and_then(|p| row[p].parse::<f64>().ok()).unwrap_or(f64::NAN);
        let begin_s = number("t_start");
        let cell = |name: &&str| match *name {
            "time" => format!("2026-03-02T08:{:02}:{:06.3}Z", (begin_s / 60.0) as u32, begin_s % 60.0),
            "t_degc" => degc("T59", begin_s).unwrap_or_default(),
            channel @ ("T59" | "T29") => degc(channel, begin_s).unwrap_or_default(),
            name => blocks.place(name).map(|p| row[p].clone()).unwrap_or_default(),
        };
        let _ = writeln!(out, "{}", columns.iter().map(cell).collect::<Vec<_>>().join(","));
    }
    out
}

/// The run file of a table, or why there is none.
pub fn imported(text: &Text, campaign: &str, folder: &Path) -> Result<Result<PathBuf, Analysed>, Box<dyn Error>> {
    let (mapping, data, out) = (folder.join("lab.toml"), folder.join("lab.csv"), folder.join("campaign"));
    std::fs::write(&mapping, MAPPING)?;
    std::fs::write(&data, table(text, &["time", "bx", "by", "bz", "x", "y", "z", "T59", "T29"]))?;
    let (status, _, told) = called(["import"].map(Into::into).into_iter().chain([mapping.into(), data.into()]), &out);
    std::fs::write(out.join("campaign.toml"), campaign).ok();
    if status != 0 {
        return Ok(Err(Analysed { status, told, warnings: Vec::new(), parameters: Vec::new() }));
    }
    Ok(Ok(out))
}

/// The field of every row, with what was flagged.
pub fn applied(text: &Text, undamaged: &Text, campaign: &str, folder: &Path) -> Result<Analysed, Box<dyn Error>> {
    let run = runs::write(super::Kind::Means, undamaged, campaign, &folder.join("ground"))?;
    let lin = folder.join("lin");
    called(["lin".into(), run.into()], &lin);
    let found = std::fs::read_dir(&lin)?.flatten().map(|e| e.path()).find(|p| p.is_dir()).ok_or("no calibration")?;
    let mut files = std::fs::read_dir(found)?.flatten().map(|e| e.path());
    let cpf = files.find(|p| p.extension().is_some_and(|end| end == "CPF")).ok_or("no calibration")?;
    let data = folder.join("readings.csv");
    std::fs::write(&data, table(text, &["time", "x", "y", "z", "t_degc"]))?;
    let out = folder.join("out");
    let (status, view, told) = called(["apply".into(), cpf.into(), data.into()], &out);
    let file = view.pointer("/files/0").cloned().unwrap_or(Value::Null);
    let mut warnings: Vec<(String, String)> = Vec::new();
    let count = |value: &Value, key: &str| value.get(key).and_then(Value::as_u64).unwrap_or(0);
    if count(&file, "without_field") > 0 {
        warnings.push(("no field".to_owned(), "vectors without field".to_owned()));
    }
    for flagged in file.get("flagged").and_then(Value::as_array).into_iter().flatten().filter(|f| count(f, "rows") > 0) {
        let meaning = flagged.get("meaning").and_then(Value::as_str).unwrap_or_default();
        let kind = if meaning.contains("temperature") { "temperature flag" } else { "field flag" };
        // Vectors at the ends of the range are flagged in any run.
        let most = if 2 * count(flagged, "rows") > count(&file, "rows") { " in most vectors" } else { "" };
        warnings.push((kind.to_owned(), format!("{meaning}{most}")));
    }
    warnings.extend(told.lines().filter(|l| l.starts_with("warning")).map(|l| ("warning".to_owned(), l.to_owned())));
    let table = std::fs::read_to_string(out.join("readings.calibrated.csv")).unwrap_or_default();
    Ok(Analysed { status, told, warnings, parameters: fields(&table) })
}

/// Field and its standard uncertainty of every row.
fn fields(table: &str) -> Vec<(String, f64, f64)> {
    let mut lines = table.lines().filter(|l| !l.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let place = |name: &str| names.iter().position(|n| *n == name);
    let mut list = Vec::new();
    for (index, line) in lines.enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        for axis in ["x", "y", "z"] {
            let of = |name: String| place(&name).and_then(|p| cells.get(p)?.parse::<f64>().ok()).unwrap_or(f64::NAN);
            list.push((format!("b{axis} of row {index}"), of(format!("b{axis}_nt")), of(format!("u_b{axis}_nt"))));
        }
    }
    list
}
