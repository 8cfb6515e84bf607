//! The protocol of a campaign, in the order of BC-MAG-TR-0085: setup, measurements by day, thermal analyses, coil system and
//! thermistors where they were calibrated, temperature profile, mathematical description, nomenclature, origin and uncertainty.

use super::{Drawn, FigureLink, figures, or_not_stated, runs, table, thermal};
use crate::data::provenance::{Input, Provenance};
use crate::data::run::{Run, time_of_id};
use crate::files::campaign::Campaign;
use crate::files::campaign::file::CampaignFile;
use crate::measure::thermal::{Kind, Thermal};
use crate::workflow::Measured;
use std::fmt::Write;

/// A run in the protocol.
pub struct RunPart<'a> {
    /// What it gave.
    pub measured: &'a Measured,
    /// Its figures.
    pub figures: &'a [Drawn],
}

/// A thermal analysis in the protocol.
pub struct ThermalPart<'a> {
    /// The analysis.
    pub thermal: &'a Thermal,
    /// Its figures.
    pub figures: &'a [Drawn],
}

/// A result in the protocol that belongs to no single run: of the coil system, of a thermistor.
pub struct OtherPart {
    /// Its title.
    pub title: String,
    /// Its sections, with headings of level 4.
    pub sections: String,
    /// Its figures.
    pub figures: Vec<Drawn>,
}

/// Everything that the protocol is made of.
pub struct Protocol<'a> {
    /// The campaign.
    pub campaign: &'a Campaign,
    /// Runs in time order.
    pub runs: Vec<RunPart<'a>>,
    /// Thermal analyses by sensor and mode.
    pub thermals: Vec<ThermalPart<'a>>,
    /// Calibrations of the coil system.
    pub coil: Vec<OtherPart>,
    /// Calibration tables of thermistors.
    pub thermistors: Vec<OtherPart>,
    /// The complete temperature profile.
    pub profile: Option<Drawn>,
    /// What failed: the file or group, and why.
    pub failed: Vec<(String, String)>,
    /// Files that belong to the protocol with their SHA-256.
    pub files: Vec<(String, String)>,
    /// Origin of the protocol; its inputs are all runs.
    pub provenance: Provenance,
}

/// Title of the protocol.
#[must_use]
pub fn title(campaign: &Campaign) -> String {
    let stated = campaign.file.report.iter().find(|(label, _)| *label == "Title").map(|(_, text)| text.clone());
    stated.or_else(|| campaign.file.name.clone()).unwrap_or_else(|| "Ground calibration of a magnetometer".to_owned())
}

/// The protocol as Markdown.
#[must_use]
pub fn markdown(p: &Protocol) -> String {
    let mut out = format!("<!-- written by calfit {} -->\n# {}\n\n", p.provenance.tool_version, title(p.campaign));
    let mut chapter = 0;
    let mut figure = 0;
    front(&mut out, p);
    chapter += 1;
    setup(&mut out, p, chapter);
    let mut shown: Vec<(String, String, &str)> = Vec::new();
    let days = days(&p.runs);
    let combined = chapter + days.len() + 1;
    for (day, runs) in &days {
        chapter += 1;
        measurements(&mut out, p, day, runs, chapter, combined, &mut shown, &mut figure);
    }
    chapter += 1;
    thermals(&mut out, p, chapter, &mut figure);
    for (heading, parts) in [("Calibration of the coil system", &p.coil), ("Thermistors", &p.thermistors)] {
        if !parts.is_empty() {
            chapter += 1;
            others(&mut out, heading, parts, chapter, &mut figure);
        }
    }
    chapter += 1;
    let _ = writeln!(out, "## {chapter} Complete temperature profile\n");
    match &p.profile {
        Some(drawn) => out.push_str(&figures(&FigureLink::number(std::slice::from_ref(drawn), "", &mut figure))),
        None => out.push_str("Drawn without figures, or no run recorded a temperature.\n\n"),
    }
    chapter += 1;
    let _ = writeln!(out, "## {chapter} Mathematical description of the calibration\n\n{MATHEMATICS}");
    chapter += 1;
    let _ = writeln!(out, "## {chapter} Nomenclature\n\n{NOMENCLATURE}");
    chapter += 1;
    origin(&mut out, p, chapter);
    out
}

fn day_name(day: &str) -> String {
    time_of_id(&format!("{day}_00-00-00")).map_or_else(|| day.to_owned(), |t| t.strftime("%B %-d, %Y").to_string())
}

/// Runs by the day of their ids.
fn days<'a, 'b>(runs: &'b [RunPart<'a>]) -> Vec<(String, Vec<&'b RunPart<'a>>)> {
    let mut days: Vec<(String, Vec<&RunPart>)> = Vec::new();
    for part in runs {
        let id = part.measured.run().map_or("", |r| r.header.run.as_str());
        let day = id.split('_').next().unwrap_or(id);
        match days.last_mut() {
            Some((last, list)) if last == day => list.push(part),
            _ => days.push((day.to_owned(), vec![part])),
        }
    }
    days
}

fn front(out: &mut String, p: &Protocol) {
    let starts: Vec<&str> = p.runs.iter().filter_map(|r| r.measured.run()).map(|r| r.header.start.as_str()).collect();
    let mut rows = vec![["", ""].map(str::to_owned).to_vec()];
    for (_, label) in CampaignFile::REPORT {
        if label != "Title" {
            let text = p.campaign.file.report.iter().find(|(l, _)| *l == label).map_or("not stated", |(_, text)| text.as_str());
            rows.push(vec![label.to_owned(), text.to_owned()]);
        }
    }
    let instrument = p.campaign.file.instrument.as_deref().unwrap_or("not stated");
    rows.push(vec!["Instrument".to_owned(), instrument.to_owned()]);
    if let (Some(first), Some(last)) = (starts.iter().min(), starts.iter().max()) {
        rows.push(vec!["Measurements".to_owned(), format!("from {first} to {last} (start of the last run)")]);
    }
    rows.push(vec!["Date of issue".to_owned(), p.provenance.created.clone()]);
    rows.push(vec![
        "Software".to_owned(),
        format!("{} {} ({})", p.provenance.tool, p.provenance.tool_version, p.provenance.build),
    ]);
    let _ = writeln!(out, "{}", table(&rows));
    let _ = writeln!(out, "The results hold for the sensors and electronics named here only.\n");
    if !p.failed.is_empty() {
        let list: Vec<String> = p.failed.iter().map(|(what, why)| format!("- {what}: {why}")).collect();
        let _ =
            writeln!(out, "> **WARNING** {} of the analyses failed or were refused:\n\n{}\n", p.failed.len(), list.join("\n"));
    }
}

fn setup(out: &mut String, p: &Protocol, chapter: usize) {
    let c = &p.campaign.file;
    let _ = writeln!(out, "## {chapter} Introduction\n\n### {chapter}.1 General setup\n");
    let mut rows = vec![["position", "X_m", "Y_m", "Z_m"].map(str::to_owned).to_vec()];
    for entry in &c.positions {
        let mut row = vec![entry.id.to_string()];
        row.extend(entry.axes.iter().map(|a| format!("{a}_c")));
        rows.push(row);
    }
    if c.positions.is_empty() {
        rows.push(["1", "+X_c", "+Y_c", "+Z_c"].map(str::to_owned).to_vec());
    }
    let _ = writeln!(out, "Nominal sensor axes along the coil axes, by position:\n\n{}", table(&rows));
    let heads: Vec<&Run> = p.runs.iter().filter_map(|r| r.measured.run()).collect();
    let mut sensors: Vec<(String, String)> = heads.iter().map(|r| (r.header.sensor.clone(), r.header.mode.clone())).collect();
    sensors.sort();
    sensors.dedup();
    let mut rows =
        vec![["sensor", "mode", "runs", "sensor temperature", "coil temperature", "field limits"].map(str::to_owned).to_vec()];
    for (sensor, mode) in &sensors {
        let own: Vec<&&Run> = heads.iter().filter(|r| (&r.header.sensor, &r.header.mode) == (sensor, mode)).collect();
        let Some(first) = own.first() else { continue };
        let (sensor_channel, coil_channel) = p.campaign.channels(&first.header);
        let limits: Vec<String> = ["x", "y", "z"]
            .iter()
            .zip(p.campaign.limits_nt(&first.header))
            .filter_map(|(axis, limit)| Some(format!("{axis} ±{} nT", limit?)))
            .collect();
        rows.push(vec![
            or_not_stated(sensor).to_owned(),
            or_not_stated(mode).to_owned(),
            own.len().to_string(),
            sensor_channel,
            coil_channel,
            if limits.is_empty() { "none".to_owned() } else { limits.join(", ") },
        ]);
    }
    let _ = writeln!(
        out,
        "Sensors and modes, temperature channels and limits of the applied field along the nominal sensor axes:\n\n{}",
        table(&rows)
    );
}

#[expect(clippy::too_many_arguments, reason = "the numbering runs through all chapters")]
fn measurements(
    out: &mut String,
    p: &Protocol,
    day: &str,
    parts: &[&RunPart],
    chapter: usize,
    combined: usize,
    shown: &mut Vec<(String, String, &'static str)>,
    figure: &mut usize,
) {
    let lines: Vec<(runs::RunLine, String)> = parts
        .iter()
        .filter_map(|part| part.measured.run())
        .map(|run| (runs::RunLine::of(run), p.campaign.channels(&run.header).0))
        .collect();
    let _ = writeln!(out, "## {chapter} Measurements on {}\n\n### {chapter}.1 Data\n\n{}", day_name(day), runs::day_list(&lines));
    let mut section = 1;
    let mut others: Vec<Vec<String>> = Vec::new();
    for part in parts {
        let Some(result) = part.measured.report() else { continue };
        let kind = match part.measured {
            Measured::Lin(_) => "DC-analysis",
            Measured::Offset(_) => "Offset calculation",
            Measured::Freq(_) => "AC-analysis",
            Measured::Sweep(_) => "Temperature sweep",
            Measured::Null(_) => "Zero-field measurement",
            Measured::Other(_) => continue,
        };
        let head = result.head();
        let key = (head.sensor.clone(), head.mode.clone(), kind);
        let remarks = result.warnings().len();
        others.push(vec![
            head.id.clone(),
            kind.to_owned(),
            or_not_stated(&head.sensor).to_owned(),
            or_not_stated(&head.mode).to_owned(),
            super::degc(head.temperature_degc),
            result.headline(),
            if remarks == 0 { String::new() } else { remarks.to_string() },
        ]);
        // Every analysis is shown in full once for a sensor and mode, as in the protocol of 2013; the others are in its files.
        if shown.contains(&key) {
            continue;
        }
        shown.push(key);
        section += 1;
        let _ = writeln!(
            out,
            "### {chapter}.{section} {kind} at {}, {} {}, run {}\n",
            super::degc(head.temperature_degc),
            or_not_stated(&head.sensor),
            or_not_stated(&head.mode),
            head.id
        );
        out.push_str(&result.sections(4));
        out.push_str(&figures(&FigureLink::number(part.figures, &format!("{}/", head.id), figure)));
    }
    if others.is_empty() {
        return;
    }
    let mut rows = vec![["run", "analysis", "sensor", "mode", "temperature", "result", "remarks"].map(str::to_owned).to_vec()];
    rows.extend(others);
    let thermal = if p.thermals.is_empty() { String::new() } else { format!(" Thermal analysis: refer to chapter {combined}.") };
    let _ = writeln!(
        out,
        "### {chapter}.{} Results of the day\n\nThe full report of every run stands in its folder.{thermal}\n\n{}",
        section + 1,
        table(&rows)
    );
}

fn thermals(out: &mut String, p: &Protocol, chapter: usize, figure: &mut usize) {
    let _ = writeln!(out, "## {chapter} Combined measurements\n");
    if p.thermals.is_empty() {
        let _ = writeln!(out, "The runs are not at different temperatures: there is no thermal analysis.\n");
        return;
    }
    let mut section = 0;
    for part in &p.thermals {
        section += 1;
        let head = part.thermal.file.head();
        let _ = writeln!(
            out,
            "### {chapter}.{section} Thermal analysis, {} {}: {}\n",
            or_not_stated(&head.sensor),
            or_not_stated(&head.mode),
            thermal::title(part.thermal.kind).to_lowercase().replace("ac transfer", "AC transfer")
        );
        out.push_str(&thermal::sections(part.thermal, 4));
        out.push_str(&figures(&FigureLink::number(part.figures, "", figure)));
    }
    let missing: Vec<&str> =
        Kind::ALL.iter().filter(|k| !p.thermals.iter().any(|t| t.thermal.kind == **k)).map(|k| k.name()).collect();
    if !missing.is_empty() {
        let _ =
            writeln!(out, "No thermal analysis of {} runs: there are none, or not at two temperatures.\n", missing.join(" and "));
    }
}

/// A chapter of results that belong to no single run.
fn others(out: &mut String, heading: &str, parts: &[OtherPart], chapter: usize, figure: &mut usize) {
    let _ = writeln!(out, "## {chapter} {heading}\n");
    for (section, part) in (1..).zip(parts) {
        let _ = writeln!(out, "### {chapter}.{section} {}\n", part.title);
        out.push_str(&part.sections);
        out.push_str(&figures(&FigureLink::number(&part.figures, "", figure)));
    }
}

fn origin(out: &mut String, p: &Protocol, chapter: usize) {
    let stated = |label: &str| {
        p.campaign.file.report.iter().find(|(l, _)| *l == label).map_or("not stated", |(_, text)| text.as_str()).to_owned()
    };
    let _ = writeln!(
        out,
        "## {chapter} Origin and uncertainty\n\n### {chapter}.1 Uncertainty\n\nAll uncertainties are standard uncertainties with coverage factor 1; \
         an interval of 1.96 of them is meant to hold the true value with a probability of 95 %. Degrees of freedom and the full covariance of \
         every result stand in its parameter file.\n"
    );
    let rows = [
        ["contribution", "type", "contained"],
        ["noise of the readings, white and slow", "A", "yes, from the scatter of the data"],
        ["scatter between runs", "A", "in the thermal polynomials, where it exceeds that of the single runs"],
        ["choice of the response model", "A", "in f_3dB, by leaving out one amplitude at a time"],
        ["coil constants and coil angles", "B", "no"],
        ["alignment of the coil axes, homogeneity over the sensor", "B", "no"],
        ["field source, earth-field compensation", "B", "no"],
        ["reading and place of the thermometers", "B", "no"],
        ["facility clock", "B", "no"],
    ];
    let rows: Vec<Vec<String>> = rows.iter().map(|r| r.map(str::to_owned).to_vec()).collect();
    let _ = writeln!(
        out,
        "{}\nTraceability of the reference field: {}. Uncertainty of the reference field: {}. No statement of conformity is made.\n",
        table(&rows),
        stated("Traceability of the reference field"),
        stated("Uncertainty of the reference field")
    );
    let _ = writeln!(
        out,
        "### {chapter}.2 Method\n\nFits and conventions are those of the mathematical description. Samples after a step or a change of frequency are \
         left out until the data no longer show it; stretches with spikes, plateaus with missing samples and fields beyond the stated limits \
         are left out with their reason. `{}`.\n",
        p.provenance.command
    );
    let mut rows = vec![["input", "bytes", "SHA-256"].map(str::to_owned).to_vec()];
    let row = |i: &Input| vec![i.path.clone(), i.size_bytes.to_string(), format!("`{}`", i.sha256)];
    rows.extend(p.provenance.input.iter().map(row));
    let _ = writeln!(out, "### {chapter}.3 Inputs\n\n{}", table(&rows));
    let mut rows = vec![["file", "SHA-256"].map(str::to_owned).to_vec()];
    rows.extend(p.files.iter().map(|(file, hash)| vec![format!("`{file}`"), format!("`{hash}`")]));
    let _ = writeln!(out, "### {chapter}.4 Files that belong to this protocol\n\n{}", table(&rows));
}

const MATHEMATICS: &str = "\
**Linear model.** `B_r` is the raw reading along the sensor axes in engineering nanotesla (enT), `B_c` the reference field in coil \
coordinates in nT, `B_or = B_off + B_res` offset plus residual field:

    B_c = Φ (B_r - B_or),    Φ = R_nom ρ ω σ

`R_nom` takes nominal sensor coordinates to coil coordinates and holds only 0 and ±1. Φ and a polynomial trend of `B_or` in time are \
fitted in one least-squares problem to the means of all plateaus.

**Split.** With `Ψ = (Φᵀ)⁻¹` the sensitivities are `σ_i = 1 / |column i of Ψ|` and `φ̂ = Φ σ⁻¹`. The columns of `(φ̂ᵀ)⁻¹` are unit vectors \
along the sensor axes; the angles between them are `ξ_xy`, `ξ_xz`, `ξ_yz`. They fill the upper triangular matrix `Q`, and `ω = (Qᵀ)⁻¹`. The \
rotation is `ρ = R_nom⁻¹ φ̂ ω⁻¹`, with `λ, μ, ν = arccos(ρ_11), arccos(ρ_22), arccos(ρ_33)`. Flight processing uses `φ̃ = ω σ`.

**Offset and residual field.** In a normal and a turned position

    B_off = (B_normal + B_turned) / 2,    B_res = (B_normal - B_turned) / 2

with the residual field in the coordinates of the sensor; the response measured in every position takes the place of the ideal turn.

**Sampling frequency and response.** A sine of frequency f by the facility clock has the phase `2π f n / f_s` at sample counter n. One `f_s` \
per component follows from all frequencies; above half of it an alias moves the faster the higher f is. `f_3dB` is given by interpolation \
(igep) and from the response model with the least AICc.

**Temperature.** `p(T) = Σ p_k T^k` with T in °C, weighted by the uncertainties of the runs. In the joint fit sensitivities and angles are \
polynomials, and rotation and offset of every run are free.
";

const NOMENCLATURE: &str = "\
| item | meaning |
|---|---|
| `B_c` | magnetic calibration field generated by the coil system, coil coordinates, nT |
| `B_r` | magnetic field raw data, enT |
| `B_off` | offset of the magnetometer, enT |
| `B_res` | residual field of the coil system, enT |
| `B_or` | `B_off + B_res`, offset and residual field at the centre of the coils, enT |
| `Φ` | `R_nom ρ ω σ`, calibration transfer matrix, nT/enT |
| `φ̃` | `ω σ`, reduced transfer matrix, nT/enT |
| `σ` | sensitivity, diagonal, nT/enT |
| `ω`, `ξ_ij` | misalignment matrix (lower triangular) and angles between the sensor axes |
| `ρ`, `λ, μ, ν` | rotation of the sensor against its nominal orientation and its angles |
| `R_nom` | nominal sensor coordinates to coil coordinates |
| `f_s`, `f_3dB` | sampling frequency and -3 dB corner frequency |
| enT | engineering nanotesla: readings before calibration |
| AICc | Akaike's criterion for small samples: the least marks the model of best prediction |
| DUT | device under test |
";
