//! Reads the frames of a recording as a run, as single samples, or as a summary of what the file holds.

use std::{
    collections::{BTreeMap, VecDeque},
    path::Path,
};

use inerter_core::{Machine, RawSample, Settings};
use inerter_wire::{
    Estimated, EstimatorEvent, EventKind, Frame, Health, Hello, Pairing, Record, Samples, SettingsValues, step,
};

use super::{
    CALIBRATION_METADATA, END_METADATA, RecordingError, SETTINGS_METADATA, TRUTH_METADATA,
    layout::Ending,
    messages::{Framing, Message, Messages},
    read::{Contents, Incoming, Item, read},
};
use crate::{
    calibration::Calibration,
    error::Error,
    run::Run,
    settings::Overrides,
    text::{event_words, is_trouble, settings_note},
    words::{plural, printable, shortened},
};

/// What a recording holds.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Everything besides the frames.
    pub contents: Contents,
    /// The device, if its Hello is present.
    pub hello: Option<Hello>,
    /// Settings, if present.
    pub settings: Option<Settings>,
    /// The extent of the samples.
    pub extent: Extent,
    /// Remarks made during the recording.
    pub markers: Vec<Marker>,
    /// The device's own last estimate.
    pub estimated: Option<Estimated>,
    /// The device's last health.
    pub health: Option<Health>,
    /// Records by name.
    pub records: BTreeMap<&'static str, u64>,
    /// Notes about the file.
    pub notes: Vec<String>,
}

/// How many samples there are, and how many are missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    /// Samples.
    pub samples: u64,
    /// Sample periods from the first one to the last, including missing ones.
    pub periods: u64,
    /// Number of gaps.
    pub discontinuities: u64,
    /// Total number of missing samples.
    pub missing: u64,
    /// Sample counter of the first and the last one.
    pub indices: Option<(u32, u32)>,
}

impl Extent {
    /// The extent of these samples.
    pub fn of<'a>(samples: impl IntoIterator<Item = &'a RawSample>) -> Self {
        let mut extent = Self::default();
        samples.into_iter().for_each(|sample| extent.take(sample));
        extent
    }

    /// Adds the next sample.
    pub fn take(&mut self, sample: &RawSample) {
        let (first, last) = self.indices.unwrap_or((sample.index, sample.index.wrapping_sub(1)));
        let jump = if self.samples == 0 { 0 } else { step(last, sample.index) };
        self.samples += 1;
        self.periods += jump;
        self.discontinuities += u64::from(jump > 1);
        self.missing += jump.saturating_sub(1);
        self.indices = Some((first, sample.index));
    }

    /// Sample periods from the first sample to the one with this counter value, relative to the latest one: the
    /// device's records about a sample may arrive before or after it.
    pub fn periods_of(&self, index: u32) -> Option<i64> {
        let (_, last) = self.indices?;
        // The wrap-around is intended: it finds the nearer of the two directions.
        Some(self.periods as i64 + i64::from(index.wrapping_sub(last) as i32))
    }
}

/// A remark with the time at which it was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Marker {
    /// Host time \[ns\].
    pub time_ns: u64,
    /// Sample periods from the first sample to the latest one received by then.
    pub periods: u64,
    /// The remark.
    pub text: String,
}

/// Maximum number of distinct faults listed; of further ones only the count is given.
const FAULTS: usize = 20;
/// The same for settings in the metadata that were left out.
const LEFT_OUT: u64 = 20;

#[derive(Default)]
struct Collected {
    /// What follows from the messages alone.
    summary: Summary,
    /// Samples of the latest batch not handed out yet.
    batch: VecDeque<RawSample>,
    settings: Vec<SettingsValues>,
    pairing: Pairing,
    foreign: Option<u16>,
    bad_batches: u64,
    faults: Vec<String>,
    faults_untold: u64,
}

impl Collected {
    fn take(&mut self, incoming: Incoming) {
        match incoming.item {
            Item::Frame(Frame::Message { message, .. }) => self.message(message),
            Item::Frame(Frame::ForeignVersion { wire_version, .. }) => self.foreign = Some(wire_version),
            Item::Frame(Frame::Lost { .. } | Frame::Restarted | Frame::Corrupt(_) | Frame::Unknown { .. }) => {}
            Item::Marker(text) => {
                let periods = self.summary.extent.periods;
                self.summary.markers.push(Marker { time_ns: incoming.time_ns, periods, text });
            }
        }
    }

    fn event(&mut self, event: EstimatorEvent) {
        if let EstimatorEvent::Estimate(estimated) = event {
            self.summary.estimated = Some(estimated);
        }
    }

    fn message(&mut self, record: Record) {
        *self.summary.records.entry(record.name()).or_default() += 1;
        for event in self.pairing.take(&record) {
            self.event(event);
        }
        match record {
            Record::Hello(hello) => self.summary.hello = Some(hello),
            Record::Samples(batch) => self.batch(&batch),
            Record::Health(health) => self.summary.health = Some(health),
            // Each value once: a host that reconnects reads the settings each time.
            Record::Settings(values) if self.settings.last() != Some(&values) => self.settings.push(values),
            Record::Event(event) => match event.kind {
                EventKind::Fault(fault) => self.fault(format!("the device reported: {fault}")),
                EventKind::Panicked(text) => {
                    self.fault(format!("the device's firmware had failed before this run: {text}; please report it"));
                }
                // A replay produces these again.
                EventKind::Changed(_) | EventKind::Warned(_) => {}
                ref kind if is_trouble(kind) => self.fault(event_words(Machine::Linear, kind)),
                _ => {}
            },
            _ => {}
        }
    }

    /// Notes each fault once, however often it occurred.
    fn fault(&mut self, words: String) {
        if self.faults.contains(&words) {
            return;
        }
        if self.faults.len() < FAULTS {
            self.faults.push(words);
        } else {
            self.faults_untold += 1;
        }
    }

    fn batch(&mut self, batch: &Samples) {
        if !append(&mut self.batch, batch) {
            self.bad_batches += 1;
        }
        self.batch.iter().for_each(|sample| self.summary.extent.take(sample));
    }
}

/// Reads a recording as far as possible, without keeping samples.
pub fn summary(path: &Path) -> Result<Summary, RecordingError> {
    summary_with(path, |_| (), |_| ())
}

/// The same; `progress` gets the bytes read so far.
pub fn summary_watched(path: &Path, progress: impl FnMut(u64)) -> Result<Summary, RecordingError> {
    summary_with(path, |_| (), progress)
}

/// The same; `each` gets every sample in order.
fn summary_with(
    path: &Path,
    mut each: impl FnMut(RawSample),
    mut progress: impl FnMut(u64),
) -> Result<Summary, RecordingError> {
    let mut collected = Collected::default();
    let contents = read(path, |incoming| {
        progress(incoming.offset);
        collected.take(incoming);
        collected.batch.drain(..).for_each(&mut each);
    })?;
    if let Some(event) = collected.pairing.flush() {
        collected.event(event);
    }
    let file = path.display().to_string();
    if let (Some(version), 0) = (collected.foreign, collected.summary.extent.samples) {
        return Err(RecordingError::ForeignVersion { file, version });
    }
    let mut notes = Vec::from_iter(ending_note(&file, &contents));
    let settings = settings(&file, &contents, &collected.settings, &mut notes);
    notes.extend(loss_notes(&file, &contents, collected.bad_batches));
    notes.extend(collected.faults.iter().map(|fault| format!("{file}: {fault}")));
    if collected.faults_untold > 0 {
        notes.push(format!(
            "{file}: {} of such faults are not listed here",
            plural(collected.faults_untold, "further report")
        ));
    }
    Ok(Summary { contents, settings, notes, ..collected.summary })
}

/// Reads the run in a recording; `overrides` take precedence over the recorded settings.
pub fn read_run(path: &Path, overrides: &Overrides) -> Result<Run, Error> {
    let mut samples = Vec::new();
    let summary = summary_with(path, |sample| samples.push(sample), |_| ())?;
    let settings = usable_settings(path, &summary, overrides)?;
    let truth = summary.contents.metadata.get(TRUTH_METADATA).cloned();
    let (calibration, trouble) = calibration(path, &summary, overrides);
    let recorded_ns = summary.recorded_ns();
    let Summary { mut notes, hello, .. } = summary;
    notes.extend(trouble);
    let name = path.display().to_string();
    Ok(Run { name, settings, samples, start_s: 0.0, recorded_ns, notes, hello, calibration, truth })
}

/// The calibration, from the `overrides` or else from the recording, and what is wrong with it.
pub fn calibration(path: &Path, summary: &Summary, overrides: &Overrides) -> (Option<Calibration>, Option<String>) {
    let recorded = || summary.contents.metadata.get(CALIBRATION_METADATA).map(Calibration::of_texts);
    let (calibration, trouble) = match overrides.calibration().cloned().map(Ok).or_else(recorded) {
        None => (None, None),
        Some(Ok(calibration)) => (Some(calibration.clone()), calibration.trouble(summary.recorded_ns())),
        Some(Err(problem)) => {
            (None, Some(format!("its entry on the calibration cannot be read: {}", shortened(&problem))))
        }
    };
    (calibration, trouble.map(|trouble| format!("{}: {}", path.display(), printable(&trouble))))
}

impl Summary {
    /// Host time of the first frame \[ns since 1970\]; `None` if there was no clock, as in a simulation.
    pub fn recorded_ns(&self) -> Option<u64> {
        self.contents.span_ns.map(|(first, _)| first).filter(|first| *first >= LEAST_DATE_NS)
    }
}

/// Earlier than any recording \[ns since 1970\]: the beginning of 2000. The time of a simulation begins at 0.
const LEAST_DATE_NS: u64 = 946_684_800_000_000_000;

/// Settings of a recording that has samples, with `overrides` taking precedence.
pub fn usable_settings(path: &Path, summary: &Summary, overrides: &Overrides) -> Result<Settings, Error> {
    let file = path.display().to_string();
    if summary.extent.samples == 0 {
        return Err(RecordingError::NoSamples { file }.into());
    }
    let known = summary.settings.or_else(|| overrides.get("metres_per_count").map(|_| Settings::default()));
    let mut settings = known.ok_or(RecordingError::NoSettings { file })?;
    overrides.apply(&mut settings)?;
    Ok(settings)
}

/// The raw samples of a recording one after the other, with one batch in memory.
pub fn samples(path: &Path) -> Result<impl Iterator<Item = Result<RawSample, Error>> + use<>, RecordingError> {
    let (mut messages, mut framing, mut batch) = (Messages::open(path)?, Framing::default(), VecDeque::new());
    Ok(std::iter::from_fn(move || {
        while batch.is_empty() {
            match messages.next() {
                Err(error) => return Some(Err(error.into())),
                Ok(None) => return None,
                Ok(Some(Message::Marker { .. })) => {}
                Ok(Some(Message::Raw { part, .. })) => framing.take(part, messages.bytes(), |frame| {
                    if let Frame::Message { message: Record::Samples(samples), .. } = frame {
                        append(&mut batch, &samples);
                    }
                }),
            }
        }
        batch.pop_front().map(Ok)
    }))
}

/// Appends the samples of a batch, or none if the batch is invalid.
fn append(queue: &mut VecDeque<RawSample>, batch: &Samples) -> bool {
    let is_valid = batch.check().is_ok();
    if is_valid {
        queue.extend(batch.iter().flatten());
    }
    is_valid
}

/// Settings from the metadata, or else from the first Settings record.
fn settings(file: &str, contents: &Contents, records: &[SettingsValues], notes: &mut Vec<String>) -> Option<Settings> {
    let reading = records.first().map(|values| values.read(&Settings::default()));
    // Settings that an older firmware does not send have their defaults in all its recordings: not worth a note.
    let newer = reading.as_ref().filter(|reading| reading.unknown + reading.impossible > 0);
    notes.extend(newer.and_then(settings_note).map(|note| format!("{file}: {note}")));
    let recorded = reading.map(|reading| reading.settings);
    let Some(map) = contents.metadata.get(SETTINGS_METADATA) else { return recorded };
    let mut settings = recorded.unwrap_or_default();
    let mut left_out = 0;
    for (name, text) in map {
        if text.parse().is_ok_and(|value| settings.set_by_name(name, value).is_ok()) {
            continue;
        }
        left_out += 1;
        if left_out <= LEFT_OUT {
            notes.push(format!(
                "{file}: the recorded setting {} = {} is unknown to this program and was left out",
                shortened(name),
                shortened(text)
            ));
        }
    }
    if left_out > LEFT_OUT {
        let further = plural(left_out - LEFT_OUT, "further recorded setting");
        notes.push(format!("{file}: also left out, and not listed here: {further}"));
    }
    if records.iter().any(|values| values.read(&settings).settings != settings) {
        notes.push(format!("{file}: the settings were changed during the recording; the initial ones are used"));
    }
    Some(settings)
}

fn ending_note(file: &str, contents: &Contents) -> Option<String> {
    Some(match &contents.ending {
        Ending::Closed => {
            let reason = contents.metadata.get(END_METADATA)?.get("reason").filter(|reason| *reason != "finished")?;
            format!("{file}: the recording ended early: {}", shortened(reason))
        }
        Ending::CutOff => format!("{file}: the file is cut off; everything before the cut is used"),
        Ending::Damaged { byte, reason } => {
            let reason = shortened(reason);
            format!("{file}: the file is damaged near byte {byte} ({reason}); everything before that is used")
        }
    })
}

fn loss_notes(file: &str, contents: &Contents, bad_batches: u64) -> impl Iterator<Item = String> {
    let counts = &contents.counts;
    [
        ("", counts.lost.into(), "frame", " lost on the way; their samples are missing"),
        ("", counts.corrupt().into(), "frame", " damaged and left out"),
        (
            "",
            counts.unknown.into(),
            "frame",
            " of a kind unknown to this program were left out; a newer version may show more",
        ),
        ("the device restarted ", counts.restarts.into(), "time", ""),
        ("", bad_batches, "batch", " of samples could not be decoded; please report it"),
    ]
    .into_iter()
    .filter(|(_, count, ..)| *count > 0)
    .map(move |(before, count, thing, after)| format!("{file}: {before}{}{after}", plural(count, thing)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{Stream, new_file};

    #[test]
    fn notes_of_metadata_without_end_are_counted_and_shortened() {
        let (_folder, path) = new_file("run.mcap");
        let mut stream = Stream::new(&path);
        stream.send(&Record::Health(Health::default()));
        stream.close(&"x".repeat(100_000));
        let Summary { mut contents, notes, .. } = summary(&path).unwrap();
        let [note] = notes.as_slice() else { panic!("{} notes", notes.len()) };
        assert!(note.contains("the recording ended early: xxx") && note.ends_with("x..."));
        assert!(note.len() < 1000, "{} bytes", note.len());

        let long = "y".repeat(100_000);
        let texts = (0..60_000).map(|number| (format!("{number:05}"), "1".to_owned()));
        let map: BTreeMap<String, String> = texts.chain([(format!("00000{long}"), long)]).collect();
        contents.metadata.insert(SETTINGS_METADATA.to_owned(), map);
        let mut notes = Vec::new();
        assert!(settings("run.mcap", &contents, &[], &mut notes).is_some());
        assert_eq!(notes.len(), 21);
        assert!(notes[0].contains("the recorded setting 00000 = 1 is unknown"), "{}", notes[0]);
        assert!(notes.iter().all(|note| note.len() < 1000), "the second one is shortened");
        assert!(notes[20].ends_with("not listed here: 59981 further recorded settings"), "{}", notes[20]);
    }
}
