//! A simulated run as a file, or in memory. The same seeds give the same bytes.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
};

use inerter_data::{
    Error,
    export::{self, Format, Selection, Source},
    output::{self, OutputError, Pending},
    recording::{End, Recorder, TRUTH_METADATA},
    replay::{Outcome, Replay},
    run::Run,
    settings,
};
use inerter_wire::{
    Capabilities, ClockSource, Estimated, EstimatorEvent, Event, EventKind, Health, Hello, MAX_FRAME, Record, Samples,
    SamplesBuilder, SequenceCounter, SettingsValues, WIRE_VERSION, encode_record,
};

use crate::{
    error::SimulateError,
    setup::{Setup, raw},
};

/// Writes a recording (.mcap), or a CSV (.csv), which has `terminal_m` if the settings include a terminal sensor, with
/// its settings in a file beside it, whose name it returns; otherwise as [`write_recording`].
pub fn write(
    setup: &Setup,
    path: &Path,
    replace: bool,
    mut progress: impl FnMut(f64) -> Result<(), Error>,
) -> Result<Option<PathBuf>, SimulateError> {
    match path.extension().and_then(OsStr::to_str).map(str::to_lowercase).as_deref() {
        Some("csv") => {
            if !replace {
                output::refuse_existing(&settings::beside(path))?;
            }
            let run = held(setup, &mut progress)?;
            let end_s = run.start_s + run.samples.len() as f64 / setup.settings.sample_rate_hz;
            let (source, targets) = (Source::held(run), [(Format::Csv, path.into())]);
            export::export(&source, &Selection::default(), &targets, replace, None, &mut |_| progress(end_s))?;
            Ok(Some(settings::write_beside(&setup.settings, setup.calibration.as_ref(), path, replace)?))
        }
        // A device such as /dev/full accepts any format.
        ending if ending == Some("mcap") || (!path.is_file() && path.exists()) => {
            write_recording(setup, path, replace, progress)?;
            Ok(None)
        }
        _ => Err(SimulateError::Format { path: path.display().to_string() }),
    }
}

/// Writes a recording as a device would have sent it; `progress` gets the time \[s\] now and then, and may stop the
/// work. The file appears when it is complete; it replaces an existing one only with `replace`.
pub fn write_recording(
    setup: &Setup,
    path: &Path,
    replace: bool,
    mut progress: impl FnMut(f64) -> Result<(), Error>,
) -> Result<Outcome, SimulateError> {
    let pending = Pending::create(path, replace)?;
    let mut stream = Stream {
        recorder: Recorder::fill(&pending)?,
        sequence: SequenceCounter::new(),
        batch: Samples::builder(),
        time_ns: 0,
    };
    stream.recorder.describe(&hello(setup), &setup.settings)?;
    setup.calibration.iter().try_for_each(|calibration| stream.recorder.calibrated(calibration))?;
    stream.recorder.metadata(TRUTH_METADATA, setup.truth())?;
    stream.say(0, EventKind::Started)?;
    stream.send(&Record::Hello(hello(setup)))?;
    stream.send(&Record::Settings(SettingsValues::from(&setup.settings)))?;
    let mut replay = Replay::new(&setup.settings, 0.0)?;
    let mut next_second = 1;
    for sample in setup.samples()? {
        stream.time_ns = (sample.t_s.max(0.0) * 1e9) as u64;
        let raw = raw(&sample);
        for event in replay.step(&raw) {
            stream.event(raw.index, &event)?;
        }
        stream.sample(&raw)?;
        if stream.time_ns >= next_second * 1_000_000_000 {
            let counters = replay.counters();
            stream.send(&Record::Health(Health {
                index: raw.index,
                uptime_s: next_second as u32,
                lost_samples: counters.lost_samples,
                discontinuities: counters.discontinuities,
                saturated: counters.saturated,
                ..Health::default()
            }))?;
            progress(sample.t_s)?;
            next_second += 1;
        }
    }
    stream.flush()?;
    let outcome = replay.outcome();
    stream.event(outcome.estimate.index, &EstimatorEvent::Estimate(outcome.estimated()))?;
    stream.say(outcome.estimate.index, EventKind::SourceEnded)?;
    stream.recorder.close(&End { reason: "finished".into(), lost_frames: 0 })?;
    pending.commit()?;
    Ok(outcome)
}

/// The run in memory; `progress` as for [`write_recording`].
pub fn held(setup: &Setup, mut progress: impl FnMut(f64) -> Result<(), Error>) -> Result<Run, SimulateError> {
    let (mut samples, mut start_s) = (Vec::new(), None);
    for sample in setup.samples()? {
        start_s.get_or_insert(sample.t_s);
        samples.push(raw(&sample));
        if samples.len() % 1000 == 0 {
            progress(sample.t_s)?;
        }
    }
    Ok(Run {
        name: "the simulation".into(),
        settings: setup.settings,
        samples,
        start_s: start_s.unwrap_or(0.0),
        calibration: setup.calibration.clone(),
        truth: Some(setup.truth()),
        ..Run::default()
    })
}

fn hello(setup: &Setup) -> Hello {
    Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text(concat!("inerter-simulate ", env!("CARGO_PKG_VERSION"))),
        git: Hello::text(""),
        board: Hello::text("simulated"),
        serial: Hello::text(&format!("SIM-{}", setup.sensors.seed)),
        sample_rate_hz: setup.settings.sample_rate_hz,
        clock: ClockSource::Simulated,
        capabilities: Capabilities::SAMPLER.with(Capabilities::TERMINAL),
    }
}

struct Stream {
    recorder: Recorder,
    sequence: SequenceCounter,
    batch: SamplesBuilder,
    time_ns: u64,
}

impl Stream {
    fn send(&mut self, record: &Record) -> Result<(), OutputError> {
        let mut out = [0; MAX_FRAME];
        // A buffer of this size is always sufficient.
        let length = encode_record(record, self.sequence.take(), &mut out).unwrap_or(1);
        self.recorder.frame(self.time_ns, out.get(..length - 1).unwrap_or_default())
    }

    fn say(&mut self, index: u32, kind: EventKind) -> Result<(), OutputError> {
        self.send(&Record::Event(Event { index, kind }))
    }

    /// The event as a device sends it.
    fn event(&mut self, index: u32, event: &EstimatorEvent) -> Result<(), OutputError> {
        match *event {
            EstimatorEvent::Reversal(reversal) => self.send(&Record::Reversal(reversal)),
            EstimatorEvent::Changed(change) => self.say(index, EventKind::Changed(change)),
            EstimatorEvent::Warned(warning) => self.say(index, EventKind::Warned(warning)),
            EstimatorEvent::Estimate(Estimated { estimate, law, detail }) => {
                self.send(&Record::Estimate(estimate))?;
                law.map_or(Ok(()), |law| self.send(&Record::Law(law)))?;
                detail.map_or(Ok(()), |detail| self.send(&Record::Detail(detail)))
            }
        }
    }

    fn sample(&mut self, raw: &inerter_core::RawSample) -> Result<(), OutputError> {
        if self.batch.push(raw).is_err() {
            self.flush()?;
            // An empty batch has room.
            self.batch.push(raw).ok();
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), OutputError> {
        if self.batch.is_empty() {
            return Ok(());
        }
        let samples = self.batch.take();
        self.send(&Record::Samples(samples))
    }
}
