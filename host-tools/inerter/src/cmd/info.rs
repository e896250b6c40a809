//! `inerter info`: what a file contains.

use std::path::{Path, PathBuf};

use inerter_core::Settings;
use inerter_data::{
    calibration::Calibration,
    csv,
    json::{EstimateJson, rounded_s},
    output::{self, OutputError},
    recording::{self, Ending, Summary, TRUTH_METADATA},
    text,
    words::{duration_text, plural, utc},
};
use inerter_wire::Estimated;
use serde::Serialize;
use serde_json::{Value, json};

use super::{
    args::FileSettingsArgs,
    print::{print_json, print_machine_json},
    terminal::{Progress, note},
};
use crate::Error;

/// Show what a recording or a CSV file holds.
///
/// Device, settings with the calibration, duration, losses, markers, and how it ended. Needs little memory, however
/// long the recording.
///
/// With --json one object: {"kind":"recording","file":..,"ending":"closed"|"cut_off"|"damaged","duration_s":..,
/// "samples":..,"discontinuities":..,"frames":..,"lost_frames":..,"damaged_frames":..,"device":{..},"settings":{..},
/// "calibration":{..},"truth":{..},"estimate":{..}}, or {"kind":"csv","file":..,"sample_rate_hz":..,"samples":..,
/// "discontinuities":..}.
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
    let is_recording = recording::is_recording(&args.file)
        .map_err(|source| recording::RecordingError::Read { path: args.file.clone(), source })?;
    if !is_recording {
        return csv_info(&args.file, args.json);
    }
    let overrides = args.settings.overrides()?;
    let mut bar = Progress::through("reading", &args.file);
    let summary = recording::summary_watched(&args.file, |offset| bar.set(offset))?;
    bar.done();
    let mut settings = summary.settings.unwrap_or_default();
    overrides.apply(&mut settings)?;
    let (calibration, trouble) = recording::calibration(&args.file, &summary, &overrides);
    trouble.iter().for_each(note);
    if args.json {
        return print_machine_json(
            settings.machine,
            &recording_json(&args.file, &summary, &settings, calibration.as_ref()),
        );
    }
    summary.notes.iter().for_each(note);
    text(&args.file, &summary, &settings, calibration.as_ref())
}

/// Time from the first sample to the last \[s\].
fn duration_s(summary: &Summary, settings: &Settings) -> f64 {
    summary.extent.periods as f64 / settings.sample_rate_hz
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
struct RecordingJson {
    #[serde(flatten)]
    about: Value,
    /// Kept separate, because a `Value` would print its 32-bit numbers with the digits of 64-bit ones.
    estimate: Option<EstimateJson>,
}

fn recording_json(
    file: &Path,
    summary: &Summary,
    settings: &Settings,
    calibration: Option<&Calibration>,
) -> RecordingJson {
    let contents = &summary.contents;
    let known_settings = summary.settings.map(|_| -> Value {
        let names = Settings::TABLE.iter().map(|info| info.name);
        names.zip(settings.values()).collect()
    });
    let truth = contents.metadata.get(TRUTH_METADATA).map(|truth| -> Value {
        let number = |text: &String| text.parse::<f64>().map_or_else(|_| json!(text), Value::from);
        truth.iter().map(|(name, text)| (name, number(text))).collect()
    });
    let marker = |marker: &recording::Marker| {
        let t_s = rounded_s(marker.periods as f64 / settings.sample_rate_hz);
        json!({ "t_s": t_s, "t_ns": marker.time_ns, "text": marker.text })
    };
    let about = json!({
        "kind": "recording",
        "file": file.display().to_string(),
        "ending": ending_word(&contents.ending),
        "reason": contents.metadata.get(recording::END_METADATA).and_then(|end| end.get("reason")),
        "duration_s": duration_s(summary, settings),
        "sample_rate_hz": settings.sample_rate_hz,
        "samples": summary.extent.samples,
        "discontinuities": summary.extent.discontinuities,
        "lost_samples": summary.extent.missing,
        "frames": contents.counts.messages,
        "lost_frames": contents.counts.lost,
        "damaged_frames": contents.counts.corrupt(),
        "records": summary.records,
        "first_ns": contents.span_ns.map(|(first, _)| first),
        "last_ns": contents.span_ns.map(|(_, last)| last),
        "markers": summary.markers.iter().map(marker).collect::<Vec<_>>(),
        "device": contents.metadata.get(recording::HELLO_METADATA),
        "settings": known_settings,
        "calibration": calibration.map(Calibration::texts),
        "truth": truth,
    });
    let live = |estimated: &Estimated| {
        let t_s = text::elapsed_s(&estimated.estimate, settings.sample_rate_hz);
        EstimateJson::live(t_s, estimated, settings)
    };
    RecordingJson { about, estimate: summary.estimated.as_ref().map(live) }
}

fn row(label: &str, value: String) -> Result<(), OutputError> {
    output::line(format!("{label:<12} {value}").trim_end())
}

fn text(file: &Path, summary: &Summary, settings: &Settings, calibration: Option<&Calibration>) -> Result<(), Error> {
    let contents = &summary.contents;
    let counts = &contents.counts;
    row(
        "file",
        format!("{} ({:.1} MB, {})", file.display(), contents.bytes as f64 / 1e6, ending_word(&contents.ending)),
    )?;
    if let Some(hello) = contents.metadata.get(recording::HELLO_METADATA) {
        let value = |key: &str| hello.get(key).cloned().unwrap_or_default();
        row("device", format!("{}, serial {}, {}", value("board"), value("serial"), value("firmware")))?;
        row("clock", value("clock"))?;
    }
    let (places, lost) = (summary.extent.discontinuities, summary.extent.missing);
    let samples = plural(summary.extent.samples, "sample");
    let duration = duration_text(duration_s(summary, settings));
    row("run", format!("{duration}, {samples} at {} Hz", settings.sample_rate_hz))?;
    if let Some((first, last)) = contents.span_ns {
        row("time", format!("{} to {}", utc(first), utc(last)))?;
    }
    row("missing", missing_text(places, lost))?;
    let records: Vec<String> = summary.records.iter().map(|(name, count)| format!("{count} {name}")).collect();
    row(
        "frames",
        format!("{} ({}), {} lost, {} damaged", counts.messages, records.join(", "), counts.lost, counts.corrupt()),
    )?;
    if summary.settings.is_some() {
        let mut changed = changed(settings);
        row("settings", changed.next().unwrap_or_else(|| "all defaults".into()))?;
        changed.try_for_each(|setting| row("", setting))?;
    }
    if let Some(calibration) = calibration {
        row("calibrated", calibration.words())?;
    }
    if let Some(truth) = contents.metadata.get(TRUTH_METADATA) {
        row("simulated", truth.get("excite").map(|motion| format!("motion {motion}")).unwrap_or_default())?;
    }
    for (number, marker) in summary.markers.iter().enumerate() {
        let t_s = marker.periods as f64 / settings.sample_rate_hz;
        row(if number == 0 { "markers" } else { "" }, format!("{t_s:.3} s  {}", marker.text))?;
    }
    if let Some(estimated) = &summary.estimated {
        output::lines("\nLast estimate of the device:")?;
        let truth = contents.metadata.get(TRUTH_METADATA);
        output::lines(text::table(estimated, settings, truth).trim_end())?;
    }
    Ok(())
}

/// Settings that differ from the defaults.
fn changed(settings: &Settings) -> impl Iterator<Item = String> {
    let values = Settings::TABLE.iter().zip(settings.values());
    values.filter(|(info, value)| *value != info.default).map(|(info, value)| format!("{} = {value:?}", info.name))
}

fn csv_info(file: &Path, json: bool) -> Result<(), Error> {
    let table = csv::read(file)?;
    let timebase = csv::timebase::find(&table.file, &table.t_s, table.time_decimals)?;
    let samples = table.t_s.len() as u64;
    if json {
        return print_json(&json!({
            "kind": "csv",
            "file": table.file,
            "sample_rate_hz": timebase.rate_hz,
            "samples": samples,
            "discontinuities": timebase.discontinuities,
            "lost_samples": timebase.missing,
            "irregular_intervals": timebase.irregular,
            "has_terminal": !table.terminal_m.is_empty(),
        }));
    }
    table.notes.iter().for_each(note);
    let duration = table.t_s.last().zip(table.t_s.first()).map_or(0.0, |(last, first)| last - first);
    row("file", format!("{} (CSV)", table.file))?;
    row("run", format!("{}, {} at {} Hz", duration_text(duration), plural(samples, "sample"), timebase.rate_hz))?;
    row("missing", missing_text(timebase.discontinuities, timebase.missing))?;
    let (_, terminal) = csv::column_names(table.machine);
    let there =
        if table.terminal_m.is_empty() { format!("no {terminal} column") } else { format!("{terminal} is there") };
    Ok(row("terminal", there)?)
}

fn missing_text(places: u64, samples: u64) -> String {
    match places {
        0 => "none".into(),
        _ => format!("{} in {}", plural(samples, "sample"), plural(places, "place")),
    }
}
