//! From the frames of a recording to a run, and to a summary of what the file holds.

use std::{collections::BTreeMap, path::Path};

use inerter_core::{Detail, Estimate, RawSample, Settings};
use inerter_wire::{EventKind, Frame, Health, Hello, Record, Samples, SettingsValues};

use super::{
    END_METADATA, RecordingError, SETTINGS_METADATA, TRUTH_METADATA,
    read::{Contents, Ending, Incoming, read},
};
use crate::{
    error::Error,
    report::{event_words, is_trouble, plural},
    run::Run,
    settings::Overrides,
};

/// What a recording holds.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Everything beside the frames.
    pub contents: Contents,
    /// The device, when its Hello is there.
    pub hello: Option<Hello>,
    /// Settings, when they are there.
    pub settings: Option<Settings>,
    /// Raw samples in order.
    pub samples: Vec<RawSample>,
    /// The device's own last estimate.
    pub estimate: Option<Estimate>,
    /// What goes with it.
    pub detail: Option<Detail>,
    /// The device's last health.
    pub health: Option<Health>,
    /// Records by name.
    pub records: BTreeMap<&'static str, u64>,
    /// What is worth knowing about the file.
    pub notes: Vec<String>,
}

#[derive(Default)]
struct Collected {
    hello: Option<Hello>,
    settings: Vec<SettingsValues>,
    samples: Vec<RawSample>,
    estimate: Option<Estimate>,
    detail: Option<Detail>,
    health: Option<Health>,
    records: BTreeMap<&'static str, u64>,
    foreign: Option<u16>,
    bad_batches: u64,
    faults: Vec<String>,
}

impl Collected {
    fn take(&mut self, incoming: Incoming) {
        match incoming.frame {
            Frame::Message { message, .. } => self.message(message),
            Frame::ForeignVersion { wire_version, .. } => self.foreign = Some(wire_version),
            Frame::Lost { .. } | Frame::Restarted | Frame::Corrupt(_) | Frame::Unknown { .. } => {}
        }
    }

    fn message(&mut self, record: Record) {
        *self.records.entry(record.name()).or_default() += 1;
        match record {
            Record::Hello(hello) => self.hello = Some(hello),
            Record::Samples(batch) => self.batch(&batch),
            Record::Estimate(estimate) => (self.estimate, self.detail) = (Some(estimate), None),
            Record::Detail(detail) => self.detail = Some(detail),
            Record::Health(health) => self.health = Some(health),
            Record::Settings(values) => self.settings.push(values),
            Record::Event(event) => match event.kind {
                EventKind::Fault(fault) => self.fault(format!("the device reported: {fault}")),
                EventKind::Panicked(text) => {
                    self.fault(format!("the device's firmware had failed before this run: {text}; please report it"));
                }
                // What a replay says anew.
                EventKind::Changed(_) => {}
                ref kind if is_trouble(kind) => self.fault(event_words(kind)),
                _ => {}
            },
            _ => {}
        }
    }

    /// Each once, however often it came.
    fn fault(&mut self, words: String) {
        if !self.faults.contains(&words) {
            self.faults.push(words);
        }
    }

    fn batch(&mut self, batch: &Samples) {
        if batch.check().is_err() {
            self.bad_batches += 1;
        } else {
            self.samples.extend(batch.iter().flatten());
        }
    }
}

/// Reads a recording as far as it goes.
pub fn summary(path: &Path) -> Result<Summary, RecordingError> {
    let mut collected = Collected::default();
    let contents = read(path, |incoming| collected.take(incoming))?;
    let file = path.display().to_string();
    if let (Some(version), true) = (collected.foreign, collected.samples.is_empty()) {
        return Err(RecordingError::ForeignVersion { file, version });
    }
    let mut notes = ending_notes(&file, &contents);
    let settings = settings(&file, &contents, &collected.settings, &mut notes);
    notes.extend(loss_notes(&file, &contents, collected.bad_batches));
    notes.extend(collected.faults.iter().map(|fault| format!("{file}: {fault}")));
    let Collected { hello, samples, estimate, detail, health, records, .. } = collected;
    Ok(Summary { contents, hello, settings, samples, estimate, detail, health, records, notes })
}

/// Reads the run that a recording holds; `overrides` are laid over the recorded settings.
pub fn read_run(path: &Path, overrides: &Overrides) -> Result<Run, Error> {
    let file = path.display().to_string();
    let summary = summary(path)?;
    if summary.samples.is_empty() {
        return Err(RecordingError::NoSamples { file }.into());
    }
    let known = summary.settings.or_else(|| overrides.get("metres_per_count").map(|_| Settings::default()));
    let mut settings = known.ok_or_else(|| RecordingError::NoSettings { file: file.clone() })?;
    overrides.apply(&mut settings)?;
    let truth = summary.contents.metadata.get(TRUTH_METADATA).cloned();
    let Summary { samples, notes, hello, .. } = summary;
    Ok(Run { name: file, settings, samples, start_s: 0.0, notes, hello, truth })
}

/// Settings from the metadata, or else from the first Settings record.
fn settings(file: &str, contents: &Contents, records: &[SettingsValues], notes: &mut Vec<String>) -> Option<Settings> {
    let recorded =
        records.first().and_then(|values| values.read(&Settings::default()).ok()).map(|reading| reading.settings);
    let Some(map) = contents.metadata.get(SETTINGS_METADATA) else { return recorded };
    let mut settings = recorded.unwrap_or_default();
    for (name, text) in map {
        let value = text.parse().ok().filter(|value| settings.set_by_name(name, *value).is_ok());
        if value.is_none() {
            notes.push(format!("{file}: the recorded setting {name} = {text} is not known here and was left out"));
        }
    }
    let changed =
        records.iter().filter_map(|values| values.read(&settings).ok()).any(|reading| reading.settings != settings);
    if changed {
        notes.push(format!("{file}: the settings were changed while it was recorded; those of its beginning are used"));
    }
    Some(settings)
}

fn ending_notes(file: &str, contents: &Contents) -> Vec<String> {
    match &contents.ending {
        Ending::Closed => match contents.metadata.get(END_METADATA).and_then(|end| end.get("reason")) {
            Some(reason) if reason != "finished" => vec![format!("{file}: the recording ended early: {reason}")],
            _ => Vec::new(),
        },
        Ending::CutOff => vec![format!("{file}: the file breaks off; everything before is used")],
        Ending::Damaged { byte, reason } => {
            vec![format!("{file}: the file is damaged near byte {byte} ({reason}); everything before is used")]
        }
    }
}

fn loss_notes(file: &str, contents: &Contents, bad_batches: u64) -> Vec<String> {
    let counts = &contents.counts;
    let mut notes = Vec::new();
    if counts.lost > 0 {
        notes.push(format!(
            "{file}: {} lost on the way; their samples are treated as gaps",
            plural(counts.lost.into(), "frame")
        ));
    }
    if counts.corrupt() > 0 {
        notes.push(format!("{file}: {} damaged and left out", plural(counts.corrupt().into(), "frame")));
    }
    if counts.unknown > 0 {
        notes.push(format!(
            "{file}: {} of a kind that this program does not know were left out; a newer one may show more",
            plural(counts.unknown.into(), "frame")
        ));
    }
    if counts.restarts > 0 {
        notes.push(format!("{file}: the device started anew {}", plural(counts.restarts.into(), "time")));
    }
    if bad_batches > 0 {
        notes.push(format!(
            "{file}: {} of samples could not be decoded; please report it",
            plural(bad_batches, "batch")
        ));
    }
    notes
}
