//! `inerter monitor` without a screen: a line per estimate, or JSON.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle},
};

use inerter_core::{Machine, Settings};
use inerter_data::{
    json::json_line,
    output::OutputError,
    text::{self, event_words},
    words::plural,
};
use serde_json::json;

use super::{
    print::print_now,
    terminal::{self, note},
};
use crate::{
    Error,
    monitor::{
        causes,
        feed::Item,
        hub::Viewer,
        losses::{Losses, UNKNOWN_FRAMES},
    },
};

/// Items that may wait for a slow reader of standard output: several minutes of a device's output.
const WAITING: usize = 4096;

/// Prints in its own thread, so that a slow reader delays neither the device nor the recording. Items that do not fit
/// in the queue are dropped and counted.
pub struct Printer {
    items: Option<SyncSender<Item>>,
    left_out: Arc<AtomicU64>,
    thread: Option<JoinHandle<Result<(), Error>>>,
}

/// A view that writes to standard output.
pub trait Printed: Viewer + Send + 'static {
    /// Reports how many items have been dropped so far.
    fn left_out(&mut self, count: u64) -> Result<(), Error>;
}

impl Printer {
    pub fn new(view: impl Printed) -> Result<Self, Error> {
        let (items, waiting) = sync_channel(WAITING);
        let left_out = Arc::new(AtomicU64::new(0));
        let counted = left_out.clone();
        let thread = thread::Builder::new().name("printer".into()).spawn(move || print(view, &waiting, &counted));
        let failed = |source| OutputError::write("standard output", source);
        Ok(Self { items: Some(items), left_out, thread: Some(thread.map_err(failed)?) })
    }
}

fn print(mut view: impl Printed, items: &Receiver<Item>, left_out: &AtomicU64) -> Result<(), Error> {
    let mut told = 0;
    for item in items {
        view.show(&item)?;
        let count = left_out.load(Ordering::Relaxed);
        if count != told {
            told = count;
            view.left_out(count)?;
        }
    }
    Ok(())
}

impl Viewer for Printer {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        let Some(items) = self.items.as_ref().filter(|_| !matches!(item, Item::Samples(_))) else { return Ok(()) };
        match items.try_send(item.clone()) {
            Err(TrySendError::Disconnected(_)) => return self.end(),
            Err(TrySendError::Full(_)) => {
                self.left_out.fetch_add(1, Ordering::Relaxed);
            }
            Ok(()) => {}
        }
        Ok(())
    }

    fn pause(&mut self) -> Result<(), Error> {
        // The thread ends early only when it fails.
        if self.thread.as_ref().is_some_and(JoinHandle::is_finished) { self.end() } else { Ok(()) }
    }

    fn end(&mut self) -> Result<(), Error> {
        self.items = None;
        let Some(thread) = self.thread.take() else { return Ok(()) };
        // The thread may be blocked in the middle of a line, by a reader that never reads again.
        terminal::last_words();
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

/// One JSON object per line.
#[derive(Default)]
pub struct Json {
    settings: Settings,
}

impl Viewer for Json {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { port, hello, settings } => {
                self.settings = *settings;
                print_now(json_line(&json!({
                    "kind": "device", "port": port, "board": hello.board, "serial": hello.serial,
                    "firmware": hello.firmware, "sample_rate_hz": hello.sample_rate_hz,
                    "wire_version": hello.wire_version,
                })))?;
            }
            Item::Settings(settings) => self.settings = *settings,
            Item::Away { reason: words } | Item::Refused { words } => note(words),
            Item::Back { port } => note(back(port)),
            _ => item.json(&self.settings).map_or(Ok(()), print_now)?,
        }
        Ok(())
    }
}

impl Printed for Json {
    fn left_out(&mut self, count: u64) -> Result<(), Error> {
        print_now(json_line(&json!({ "kind": "link", "left_out_lines": count })))
    }
}

/// One line per estimate; everything else as notes.
#[derive(Default)]
pub struct Lines {
    losses: Losses,
    machine: Machine,
}

impl Viewer for Lines {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        match item {
            Item::Device { port, hello, settings } => {
                self.losses.begin();
                self.machine = settings.machine;
                terminal::say(format!(
                    "{}, serial {}, {} Hz, {} at {port}",
                    hello.board, hello.serial, hello.sample_rate_hz, hello.firmware
                ));
                print_now(text::row_header(self.machine))?;
            }
            Item::Estimate { t_s, estimated, .. } => print_now(text::row(*t_s, estimated))?,
            Item::Health(health) => {
                let told = self.losses.problems();
                self.losses.health(*health);
                self.losses.problems().filter(|problems| Some(problems) != told.as_ref()).iter().for_each(note);
            }
            Item::LostFrames(count) => note(format!("{} lost on the way so far", plural(*count, "frame"))),
            Item::UnknownFrames(count) => {
                if self.losses.unknown_frames == 0 {
                    note(UNKNOWN_FRAMES);
                }
                self.losses.unknown_frames = *count;
            }
            Item::Event { event, .. } => note(event_words(self.machine, &event.kind)),
            Item::Cause { cause, .. } => note(causes::words(self.machine, cause)),
            Item::Marker { text, .. } => note(format!("marker: {text}")),
            Item::Away { reason: words } | Item::Refused { words } => note(words),
            Item::Back { port } => note(back(port)),
            Item::Settings(settings) => self.machine = settings.machine,
            Item::Samples(_) | Item::Reversal { .. } => {}
        }
        Ok(())
    }
}

impl Printed for Lines {
    fn left_out(&mut self, count: u64) -> Result<(), Error> {
        note(format!("{} left out so far: they were not read in time", plural(count, "line")));
        Ok(())
    }
}

fn back(port: &str) -> String {
    format!("the device is back at {port}")
}
