//! `inerter record`: records everything a device sends into a file.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use inerter_core::Machine;
use inerter_data::{
    json::json_line,
    recording::{End, Recorder},
    text::{event_words, is_trouble},
    words::{duration_text, plural},
};
use inerter_device::{Clock, Device, DeviceError, live::LinkEvent};
use inerter_wire::{EventKind, Frame, Record, Streams};
use serde_json::json;

use super::{
    args::{LinkArgs, OutputArgs, TimeArgs, calibration},
    print::{print_json, print_now},
    terminal::{self, Progress, Told, note},
};
use crate::Error;

/// Time between two progress lines or updates.
const REPORT: Duration = Duration::from_secs(1);

/// Record everything that a device sends.
///
/// The MCAP file holds every frame exactly as received. On a terminal each typed line becomes a marker with the time at
/// which it was finished; an empty line becomes a numbered marker. `inerter info` lists them.
///
/// Ends after --duration or at Ctrl-C. If the device goes away, the command waits for it (--wait); if it does not come
/// back, the recording is closed with what was received so far. A truncated file can be read up to the cut, even after
/// a power failure.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    link: LinkArgs,
    #[command(flatten)]
    time: TimeArgs,
    /// Store when and how the rig was calibrated: the table `[calibration]` of this settings file, with `date`, and
    /// `certificate` and `expires` if known
    #[arg(long, value_name = "FILE.toml")]
    calibration: Option<PathBuf>,
    /// Stop when the device has no more samples, as at the end of a simulated motion
    #[arg(long)]
    until_end: bool,
    /// Print JSON: one object when the recording begins, one when it ends
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let path = args.output.path()?;
    let calibration = calibration(args.calibration.as_deref())?;
    terminal::catch_interrupts();
    let mut live = args.link.live(Streams::ALL, args.time.wait)?;
    let mut recorder = Recorder::create(path, args.output.force)?;
    if let Some(device) = live.device() {
        recorder.describe(device.hello(), device.settings())?;
        begin(args, device)?;
    }
    if let Some(calibration) = &calibration {
        recorder.calibrated(calibration)?;
    }
    let progress = Told::new(match args.time.duration {
        Some(duration) => Progress::new("recording", duration.as_millis() as u64),
        None => Progress::endless("recording"),
    });
    let machine = live.device().map_or(Machine::Linear, |device| device.settings().machine);
    let started = Instant::now();
    let (mut reported, mut ended) = (Instant::now(), false);
    let (typed, clock, mut markers) = (terminal::typed_lines(), Clock::new(), 0);
    let failure = loop {
        let over = args.time.duration.is_some_and(|duration| started.elapsed() >= duration);
        if over || terminal::interrupted() {
            break None;
        }
        match live.next() {
            Ok(LinkEvent::Received(received)) if !received.bytes.is_empty() => {
                ended |= args.until_end && is_end(&received.frame);
                if let Some(words) = trouble(machine, &received.frame) {
                    progress.note(words);
                }
                recorder.frame(received.time_ns, &received.bytes)?;
            }
            // The last raw samples may arrive after the event.
            Ok(LinkEvent::Quiet) if ended => break None,
            Ok(LinkEvent::Received(_) | LinkEvent::Quiet) => recorder.quiet(live.now_ns())?,
            Ok(LinkEvent::Away { reason }) => {
                recorder.flush()?;
                progress.note(format!("{reason}; waiting {} s for it to come back", args.time.wait.as_secs_f64()));
            }
            Ok(LinkEvent::Back) => {
                let port = live.device().map(|device| format!(" at {}", device.name())).unwrap_or_default();
                progress.note(format!(
                    "the device is back{port}, the recording continues; the samples in between are missing"
                ));
            }
            Err(error) => break Some(error),
        }
        for line in typed.iter().flat_map(|typed| typed.try_iter()) {
            markers += 1;
            let text = if line.is_empty() { format!("marker {markers}") } else { line };
            recorder.marker(clock.now_ns(), &text)?;
            progress.note(format!("marker at {}: {text}", duration_text(recorder.duration_s())));
        }
        if reported.elapsed() >= REPORT {
            reported = Instant::now();
            match args.time.duration {
                Some(_) => progress.set(started.elapsed().as_millis() as u64),
                None => progress.say(format!(
                    "{}, {}, {} lost; Ctrl-C ends",
                    duration_text(recorder.duration_s()),
                    plural(recorder.frames().into(), "frame"),
                    live.lost_frames()
                )),
            }
        }
    };
    let (duration_s, frames) = (recorder.duration_s(), recorder.frames());
    let reason = failure.as_ref().map_or_else(|| "finished".to_string(), ToString::to_string);
    let closed = recorder.close(&End { reason: reason.clone(), lost_frames: live.lost_frames() });
    terminal::last_words();
    progress.done();
    closed?;
    match failure {
        None => end(args, duration_s, frames, live.lost_frames()),
        Some(error) => Err(kept(error, &args.output.display().to_string(), duration_s).into()),
    }
}

fn is_end(frame: &Frame<Record>) -> bool {
    matches!(frame, Frame::Message { message: Record::Event(event), .. } if event.kind == EventKind::SourceEnded)
}

/// Reports a problem during recording, as one line.
fn trouble(machine: Machine, frame: &Frame<Record>) -> Option<String> {
    let Frame::Message { message: Record::Event(event), .. } = frame else { return None };
    is_trouble(&event.kind).then(|| event_words(machine, &event.kind))
}

fn begin(args: &Args, device: &Device) -> Result<(), Error> {
    let hello = device.hello();
    let file = args.output.display();
    if args.json {
        let line = json!({
            "kind": "recording", "file": file.to_string(), "port": device.name(), "board": hello.board,
            "serial": hello.serial, "sample_rate_hz": hello.sample_rate_hz,
        });
        return print_now(json_line(&line));
    }
    let until = match args.time.duration {
        Some(duration) => format!("for {}", duration_text(duration.as_secs_f64())),
        None => "until Ctrl-C".into(),
    };
    terminal::say(format!(
        "recording {} (serial {}, {} Hz) at {} to {file} {until}",
        hello.board,
        hello.serial,
        hello.sample_rate_hz,
        device.name()
    ));
    Ok(())
}

fn end(args: &Args, duration_s: f64, frames: u32, lost_frames: u64) -> Result<(), Error> {
    let file = args.output.display().to_string();
    if args.json {
        let line = json!({
            "kind": "recorded", "file": file, "duration_s": duration_s, "frames": frames, "lost_frames": lost_frames,
        });
        return print_json(&line);
    }
    let lost = if lost_frames == 0 { "none lost".into() } else { format!("{lost_frames} lost on the way") };
    terminal::say(format!("recorded {}: {}, {lost}", duration_text(duration_s), plural(frames.into(), "frame")));
    terminal::say(format!("look at it with: inerter replay {file}"));
    Ok(())
}

/// Adds to the error what the recording nevertheless holds.
fn kept(error: DeviceError, file: &str, duration_s: f64) -> DeviceError {
    let words = format!("the {} before that can be read in {file}", duration_text(duration_s));
    match error {
        DeviceError::Vanished { name, reason, .. } => {
            DeviceError::Vanished { name, reason, kept: format!("; {words}") }
        }
        other => {
            note(words);
            other
        }
    }
}
