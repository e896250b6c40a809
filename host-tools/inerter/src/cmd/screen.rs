//! `inerter monitor` in a terminal: keys in, frames out. A separate thread receives from the device, so that a slow
//! terminal never delays the device.

use std::{
    io,
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use ratatui::{
    DefaultTerminal,
    crossterm::event::{self, Event, KeyEventKind},
};

use super::terminal;
use crate::{
    Error,
    monitor::{
        MonitorError,
        feed::Item,
        hub::{Hub, Viewer, Wish},
        locked,
        state::{Action, State},
        view::{self, Theme},
    },
};

/// Minimum time between two frames.
const FRAME: Duration = Duration::from_millis(50);

/// What the device's thread and this one share.
#[derive(Clone)]
struct Shared {
    state: Arc<Mutex<State>>,
    /// Whether there is something new to draw.
    changed: Arc<AtomicBool>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        locked(&self.state)
    }
}

impl Viewer for Shared {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        self.state().item(item);
        self.changed.store(true, Ordering::Relaxed);
        Ok(())
    }
}

/// Restores the terminal, whatever happens.
struct Restore;

impl Drop for Restore {
    fn drop(&mut self) {
        terminal::has_screen(None);
        // A terminal that is gone cannot be restored, and the error cannot be shown there.
        ratatui::try_restore().ok();
    }
}

/// Shows the screen until the user quits, `over` returns true, or the device fails.
pub fn run(
    mut hub: Hub,
    recording: Option<String>,
    elsewhere: Vec<String>,
    over: impl Fn() -> bool + Send + 'static,
) -> Result<(), Error> {
    let wishes = hub.wishes();
    let state = Arc::new(Mutex::new(State::new(recording, elsewhere)));
    let shared = Shared { state, changed: Arc::new(AtomicBool::new(true)) };
    hub.add(shared.clone());
    let quit = Arc::new(AtomicBool::new(false));
    let theme = Theme { colour: std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty()) };

    terminal::has_screen(Some(|| {
        // A terminal that is gone cannot be restored, and the error cannot be shown there.
        ratatui::try_restore().ok();
    }));
    let restore = Restore;
    let failed = |source| MonitorError::Terminal { source };
    let mut drawn = ratatui::try_init().map_err(failed)?;
    let stop = quit.clone();
    let device = thread::Builder::new().name("device".into()).spawn(move || {
        let measured = hub.run(|| stop.load(Ordering::Relaxed) || over());
        terminal::last_words();
        measured
    });
    let device = device.map_err(failed)?;
    let shown = pictures(&mut drawn, &shared, theme, &|| device.is_finished(), &|action| match action {
        // If nobody receives the request, the hub has ended.
        Action::Mark(text) => drop(wishes.send(Wish::Mark(text))),
        Action::ResetEstimator => drop(wishes.send(Wish::ResetEstimator)),
        Action::Quit => quit.store(true, Ordering::Relaxed),
    });
    quit.store(true, Ordering::Relaxed);
    // Its drop would show the cursor once more, and panic if it cannot print the failure.
    if drawn.show_cursor().is_err() {
        std::mem::forget(drawn);
    }
    // Closes the recording before the terminal is restored.
    let measured = device.join();
    drop(restore);
    match measured {
        Ok(result) => result.and(shown.map_err(|error| failed(error).into())),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// Key presses, read in a separate thread: if the terminal is gone, the library's read never returns.
fn keys() -> io::Result<Receiver<io::Result<Event>>> {
    let (sender, keys) = channel();
    let read = move || {
        let mut is_there = true;
        while is_there {
            let event = event::read();
            is_there = event.is_ok();
            is_there &= sender.send(event).is_ok();
        }
    };
    thread::Builder::new().name("keys".into()).spawn(read)?;
    Ok(keys)
}

/// Handles keys and draws frames until the device's thread ends.
fn pictures(
    terminal: &mut DefaultTerminal,
    shared: &Shared,
    theme: Theme,
    ended: &dyn Fn() -> bool,
    act: &dyn Fn(Action),
) -> io::Result<()> {
    let keys = keys()?;
    let mut drawn = Instant::now().checked_sub(FRAME).unwrap_or_else(Instant::now);
    while !ended() {
        let rest = FRAME.saturating_sub(drawn.elapsed());
        match keys.recv_timeout(rest.max(Duration::from_millis(1))) {
            Ok(event) => match event? {
                Event::Key(key) if key.kind != KeyEventKind::Release => {
                    if let Some(action) = shared.state().key(key) {
                        act(action);
                    }
                    shared.changed.store(true, Ordering::Relaxed);
                }
                Event::Resize(..) => shared.changed.store(true, Ordering::Relaxed),
                _ => {}
            },
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => thread::sleep(rest),
        }
        if drawn.elapsed() < FRAME || !shared.changed.swap(false, Ordering::Relaxed) {
            continue;
        }
        drawn = Instant::now();
        // The state is locked while cells are filled, not while they are written to the terminal.
        terminal.draw(|frame| view::draw(frame, &shared.state(), theme))?;
    }
    Ok(())
}
