//! `inerter info`: what a file holds.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use inerter::{
    Error, csv, output,
    recording::{self, Ending, Summary, TRUTH_METADATA},
    report::{self, EstimateJson, duration_text, json_line, plural},
    run::{self, Run},
};
use inerter_core::Settings;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{args::FileSettingsArgs, terminal::note};

/// Show what a recording or a CSV file holds.
///
/// Device, settings, duration, losses, and how it ended.
///
/// With --json one object: {"kind":"recording","file":..,"ending":"closed"|"cut_off"|"damaged","duration_s":..,
/// "samples":..,"gaps":..,"frames":..,"lost_frames":..,"damaged_frames":..,"device":{..},"settings":{..},"truth":{..},
/// "estimate":{..}}, or {"kind":"csv","file":..,"sample_rate_hz":..,"samples":..,"gaps":..}.
#[derive(clap::Args)]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let is_recording = run::is_recording(&args.file)
        .map_err(|source| recording::RecordingError::Read { path: args.file.clone(), source })?;
    if !is_recording {
        return csv_info(&args.file, args.json);
    }
    let overrides = args.settings.overrides()?;
    let mut summary = recording::summary(&args.file)?;
    let mut settings = summary.settings.unwrap_or_default();
    overrides.apply(&mut settings)?;
    let run = Run { settings, samples: std::mem::take(&mut summary.samples), ..Run::default() };
    if args.json {
        return Ok(output::line(json_line(&recording_json(&args.file, &summary, &run)))?);
    }
    summary.notes.iter().for_each(note);
    text(&args.file, &summary, &run)
}

fn ending_word(ending: &Ending) -> &'static str {
    match ending {
        Ending::Closed => "closed",
        Ending::CutOff => "cut_off",
        Ending::Damaged { .. } => "damaged",
    }
}

/// A recording in JSON; `null` where the file does not say.
#[derive(Serialize)]
struct RecordingJson<'a> {
    kind: &'static str,
    file: String,
    ending: &'static str,
    reason: Option<&'a String>,
    duration_s: f64,
    sample_rate_hz: f64,
    samples: usize,
    gaps: u64,
    lost_samples: u64,
    frames: u32,
    lost_frames: u32,
    damaged_frames: u32,
    records: &'a BTreeMap<&'static str, u64>,
    device: Option<&'a BTreeMap<String, String>>,
    settings: Option<Map<String, Value>>,
    truth: Option<Map<String, Value>>,
    estimate: Option<EstimateJson>,
}

fn recording_json<'a>(file: &Path, summary: &'a Summary, run: &Run) -> RecordingJson<'a> {
    let contents = &summary.contents;
    let settings = summary.settings.map(|_| {
        let values = Settings::TABLE.iter().zip(run.settings.values());
        values.map(|(info, value)| (info.name.to_string(), json!(value))).collect()
    });
    let truth = contents.metadata.get(TRUTH_METADATA).map(|truth| {
        let number = |text: &String| text.parse::<f64>().map_or_else(|_| json!(text), |number| json!(number));
        truth.iter().map(|(name, text)| (name.clone(), number(text))).collect()
    });
    let (gaps, lost_samples) = run.gaps();
    let live = |estimate| {
        let t_s = report::elapsed_s(estimate, run.settings.sample_rate_hz);
        EstimateJson::live(t_s, estimate, summary.detail.as_ref(), &run.settings)
    };
    RecordingJson {
        kind: "recording",
        file: file.display().to_string(),
        ending: ending_word(&contents.ending),
        reason: contents.metadata.get(recording::END_METADATA).and_then(|end| end.get("reason")),
        duration_s: run.duration_s(),
        sample_rate_hz: run.settings.sample_rate_hz,
        samples: run.samples.len(),
        gaps,
        lost_samples,
        frames: contents.counts.messages,
        lost_frames: contents.counts.lost,
        damaged_frames: contents.counts.corrupt(),
        records: &summary.records,
        device: contents.metadata.get(recording::HELLO_METADATA),
        settings,
        truth,
        estimate: summary.estimate.as_ref().map(live),
    }
}

fn text(file: &Path, summary: &Summary, run: &Run) -> Result<(), Error> {
    let contents = &summary.contents;
    let counts = &contents.counts;
    let row = |label: &str, value: String| output::line(format!("{label:<12} {value}").trim_end());
    row(
        "file",
        format!("{} ({:.1} MB, {})", file.display(), contents.bytes as f64 / 1e6, ending_word(&contents.ending)),
    )?;
    if let Some(hello) = contents.metadata.get(recording::HELLO_METADATA) {
        let value = |key: &str| hello.get(key).cloned().unwrap_or_default();
        row("device", format!("{}, serial {}, {}", value("board"), value("serial"), value("firmware")))?;
        row("clock", value("clock"))?;
    }
    let (gaps, lost) = run.gaps();
    let samples = plural(run.samples.len() as u64, "sample");
    row("run", format!("{}, {samples} at {} Hz", duration_text(run.duration_s()), run.settings.sample_rate_hz))?;
    row(
        "gaps",
        if gaps == 0 { "none".into() } else { format!("{}, {} missing", plural(gaps, "gap"), plural(lost, "sample")) },
    )?;
    let records: Vec<String> = summary.records.iter().map(|(name, count)| format!("{count} {name}")).collect();
    row(
        "frames",
        format!("{} ({}), {} lost, {} damaged", counts.messages, records.join(", "), counts.lost, counts.corrupt()),
    )?;
    if summary.settings.is_some() {
        let changed: Vec<String> = changed(&run.settings).collect();
        row("settings", if changed.is_empty() { "all as by default".into() } else { changed.join("\n             ") })?;
    }
    if let Some(truth) = contents.metadata.get(TRUTH_METADATA) {
        row("simulated", truth.get("excite").map(|motion| format!("motion {motion}")).unwrap_or_default())?;
    }
    if let Some(estimate) = &summary.estimate {
        output::line("\nLast estimate of the device:")?;
        let truth = contents.metadata.get(TRUTH_METADATA);
        output::line(report::table(estimate, summary.detail.as_ref(), &run.settings, truth).trim_end())?;
    }
    Ok(())
}

/// Settings that are not as by default.
fn changed(settings: &Settings) -> impl Iterator<Item = String> {
    let values = Settings::TABLE.iter().zip(settings.values());
    values.filter(|(info, value)| *value != info.default).map(|(info, value)| format!("{} = {value:?}", info.name))
}

fn csv_info(file: &Path, json: bool) -> Result<(), Error> {
    let table = csv::read(file)?;
    let timebase = csv::timebase::find(&table.file, &table.t_s, table.time_decimals)?;
    let samples = table.t_s.len() as u64;
    if json {
        return Ok(output::line(json_line(&json!({
            "kind": "csv",
            "file": table.file,
            "sample_rate_hz": timebase.rate_hz,
            "samples": samples,
            "gaps": timebase.gaps,
            "lost_samples": timebase.missing,
            "irregular_intervals": timebase.irregular,
            "has_terminal": !table.terminal_m.is_empty(),
        })))?);
    }
    table.notes.iter().for_each(note);
    let duration = table.t_s.last().zip(table.t_s.first()).map_or(0.0, |(last, first)| last - first);
    let row = |label: &str, value: String| output::line(format!("{label:<12} {value}"));
    row("file", format!("{} (CSV)", table.file))?;
    row("run", format!("{}, {} at {} Hz", duration_text(duration), plural(samples, "sample"), timebase.rate_hz))?;
    let gaps = format!("{}, {} missing", plural(timebase.gaps, "gap"), plural(timebase.missing, "sample"));
    row("gaps", if timebase.gaps == 0 { "none".into() } else { gaps })?;
    row("terminal", if table.terminal_m.is_empty() { "no terminal_m column" } else { "terminal_m is there" }.into())?;
    Ok(())
}
