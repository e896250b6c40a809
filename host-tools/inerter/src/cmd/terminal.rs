//! What a person sees on standard error: notes, progress, and Ctrl-C as a wish rather than a death.

use std::{
    io::{self, IsTerminal, Write},
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static HAS_SCREEN: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C ends the work in good order; a second one ends the program at once.
pub fn catch_interrupts() {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            if HAS_SCREEN.load(Ordering::Relaxed) {
                ratatui::restore();
            }
            std::process::exit(130);
        }
    };
    // Fails only when a handler is there already.
    ctrlc::set_handler(handler).ok();
}

/// Whether the terminal must be given back before the program ends.
pub fn has_screen(yes: bool) {
    HAS_SCREEN.store(yes, Ordering::Relaxed);
}

/// Whether the user has pressed Ctrl-C.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// A note to the user, apart from the results.
pub fn note(text: impl AsRef<str>) {
    // Nobody reads notes where standard error is closed.
    writeln!(io::stderr(), "note: {}", text.as_ref()).ok();
}

/// Information to the user, apart from the results.
pub fn say(text: impl AsRef<str>) {
    writeln!(io::stderr(), "{}", text.as_ref()).ok();
}

/// Time after which work deserves a bar.
const PATIENCE: Duration = Duration::from_millis(700);

/// A progress bar that appears when work takes a while, on a terminal only.
pub struct Progress {
    label: &'static str,
    /// `None` for work without a known end.
    length: Option<u64>,
    started: Instant,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// For work of this length.
    pub fn new(label: &'static str, length: u64) -> Self {
        Self { label, length: Some(length), started: Instant::now(), bar: None }
    }

    /// For work without a known end.
    pub fn endless(label: &'static str) -> Self {
        Self { label, length: None, started: Instant::now(), bar: None }
    }

    /// What is said beside the label of endless work.
    pub fn say(&mut self, text: String) {
        self.set(0);
        if let Some(bar) = &self.bar {
            bar.set_message(format!("{} {text}", self.label));
            bar.tick();
        }
    }

    /// Prints a note above the bar.
    pub fn note(&self, text: impl AsRef<str>) {
        match &self.bar {
            Some(bar) => bar.suspend(|| note(text)),
            None => note(text),
        }
    }

    /// So much is done.
    pub fn set(&mut self, position: u64) {
        if self.bar.is_none() {
            if self.started.elapsed() < PATIENCE || !io::stderr().is_terminal() {
                return;
            }
            let template =
                if self.length.is_some() { "{msg} [{bar:40}] {percent} %  {eta} left" } else { "{spinner} {msg}" };
            let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = ProgressBar::with_draw_target(self.length, ProgressDrawTarget::stderr());
            let style = style.progress_chars("=> ");
            self.bar = Some(bar.with_style(style).with_message(self.label));
        }
        if let Some(bar) = &self.bar {
            bar.set_position(position.min(self.length.unwrap_or(0)));
        }
    }

    /// Takes the bar away.
    pub fn done(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}
