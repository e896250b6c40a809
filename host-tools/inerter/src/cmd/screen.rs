//! `inerter monitor` in a terminal: keys in, pictures out. What comes from the device is taken in by a thread of its own, so that a slow
//! terminal never holds up the device.

use std::{
    io,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use ratatui::{
    DefaultTerminal,
    crossterm::event::{self, KeyEventKind},
};

use super::terminal;
use crate::{
    Error,
    monitor::{
        MonitorError,
        feed::Item,
        hub::{Hub, Viewer, Wish},
        state::{Action, Event, State},
        view::{self, Theme},
    },
};

/// Least time from one picture to the next.
const FRAME: Duration = Duration::from_millis(50);

/// What the device's thread and this one share.
#[derive(Clone)]
struct Shared {
    state: Arc<Mutex<State>>,
    /// Whether there is something new to be drawn.
    changed: Arc<AtomicBool>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Viewer for Shared {
    fn show(&mut self, item: &Item) -> Result<(), Error> {
        self.state().update(Event::Item(item));
        self.changed.store(true, Ordering::Relaxed);
        Ok(())
    }
}

/// The terminal as it was, whatever happens.
struct Restore;

impl Drop for Restore {
    fn drop(&mut self) {
        terminal::has_screen(false);
        ratatui::restore();
    }
}

/// Shows the screen until the user quits, `over` says so, or the device fails.
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

    terminal::has_screen(true);
    let restore = Restore;
    let mut drawn = ratatui::try_init().map_err(|source| MonitorError::Terminal { source })?;
    let stop = quit.clone();
    let device =
        thread::Builder::new().name("device".into()).spawn(move || hub.run(|| stop.load(Ordering::Relaxed) || over()));
    let device = device.map_err(|source| MonitorError::Terminal { source })?;
    let shown = pictures(&mut drawn, &shared, theme, &|| device.is_finished(), &|action| match action {
        // The hub has ended when nobody takes the wish.
        Action::Mark(text) => drop(wishes.send(Wish::Mark(text))),
        Action::ResetEstimator => drop(wishes.send(Wish::ResetEstimator)),
        Action::Quit => quit.store(true, Ordering::Relaxed),
    });
    quit.store(true, Ordering::Relaxed);
    // The recording is closed before the terminal is given back.
    let measured = device.join();
    drop(restore);
    match measured {
        Ok(result) => result.and(shown.map_err(|source| MonitorError::Terminal { source }.into())),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// Keys in, pictures out, until the device's thread has ended.
fn pictures(
    terminal: &mut DefaultTerminal,
    shared: &Shared,
    theme: Theme,
    ended: &dyn Fn() -> bool,
    act: &dyn Fn(Action),
) -> io::Result<()> {
    let mut drawn = Instant::now().checked_sub(FRAME).unwrap_or_else(Instant::now);
    while !ended() {
        let rest = FRAME.saturating_sub(drawn.elapsed());
        if event::poll(rest.max(Duration::from_millis(1)))? {
            match event::read()? {
                event::Event::Key(key) if key.kind != KeyEventKind::Release => {
                    if let Some(action) = shared.state().update(Event::Key(key)) {
                        act(action);
                    }
                    shared.changed.store(true, Ordering::Relaxed);
                }
                event::Event::Resize(..) => shared.changed.store(true, Ordering::Relaxed),
                _ => {}
            }
        }
        if drawn.elapsed() < FRAME || !shared.changed.swap(false, Ordering::Relaxed) {
            continue;
        }
        drawn = Instant::now();
        // The state is held while cells are filled, not while the terminal takes them.
        terminal.draw(|frame| view::draw(frame, &shared.state(), theme))?;
    }
    Ok(())
}
