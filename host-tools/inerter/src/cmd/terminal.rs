//! Output to the user on standard error: notes and progress. Ctrl-C is a request to stop, not an immediate exit.

use std::{
    io::{self, IsTerminal, Write},
    path::Path,
    process,
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use inerter_data::{output, words::printable};

use crate::{exit, monitor::locked};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
/// The work has noticed the interrupt.
static HEEDED: AtomicBool = AtomicBool::new(false);
/// Restores the terminal if a full-screen view uses it.
static RESTORE: Mutex<Option<fn()>> = Mutex::new(None);

/// Work that has not noticed the interrupt by then is blocked on a reader or a file that may never respond.
const HEED_TIME: Duration = Duration::from_secs(3);
/// Time for the final messages.
const LAST_WORDS: Duration = Duration::from_secs(1);
/// Messages that may wait for a slow terminal.
const WAITING: usize = 256;
/// Time to restore the terminal: a stopped terminal (Ctrl-S) accepts no output.
const RESTORE_TIME: Duration = Duration::from_millis(500);

/// Ends the program at once; restores the terminal and leaves no half-written file behind.
fn end() -> ! {
    let restore = *locked(&RESTORE);
    if let Some(restore) = restore {
        let (done, restored) = mpsc::channel();
        thread::spawn(move || {
            restore();
            done.send(()).ok();
        });
        restored.recv_timeout(RESTORE_TIME).ok();
    }
    output::remove_unfinished();
    inerter_simulate::end_qemu();
    process::exit(exit::INTERRUPTED.into());
}

/// From now on Ctrl-C ends the program at once and leaves no half-written file.
pub fn tidy_at_interrupts() {
    // Fails only if a handler is already set.
    ctrlc::set_handler(|| end()).ok();
}

/// From now on Ctrl-C asks the work to stop cleanly. A second Ctrl-C ends the program at once. So does work that does
/// not check for the interrupt in time.
pub fn catch_interrupts() {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            end();
        }
        thread::spawn(|| {
            thread::sleep(HEED_TIME);
            if !HEEDED.load(Ordering::Relaxed) {
                end();
            }
        });
    };
    // Fails only if a handler is already set.
    ctrlc::set_handler(handler).ok();
}

/// Call this when only messages to the user are left. A terminal may accept no output, so after an interrupt the
/// program ends shortly even if they cannot be written.
pub fn last_words() {
    if interrupted() {
        thread::spawn(|| {
            thread::sleep(LAST_WORDS);
            end();
        });
    }
}

/// Sets how the terminal is restored before the program ends; `None` if it need not be.
pub fn has_screen(restore: Option<fn()>) {
    *locked(&RESTORE) = restore;
}

/// Whether the user has pressed Ctrl-C.
pub fn interrupted() -> bool {
    let interrupted = INTERRUPTED.load(Ordering::Relaxed);
    if interrupted {
        HEEDED.store(true, Ordering::Relaxed);
    }
    interrupted
}

/// Fails when the user has pressed Ctrl-C.
pub fn go_on() -> Result<(), inerter_data::Error> {
    if interrupted() { Err(inerter_data::Error::Interrupted) } else { Ok(()) }
}

/// Whether a user can read a question and answer it.
pub fn can_ask() -> bool {
    io::stdin().is_terminal() && io::stderr().is_terminal()
}

/// Prints a one-line note to standard error, separate from the results.
pub fn note(text: impl AsRef<str>) {
    say(format!("note: {}", text.as_ref()));
}

/// Prints a one-line message to standard error, separate from the results.
pub fn say(text: impl AsRef<str>) {
    // If standard error is closed, nobody reads it.
    writeln!(io::stderr(), "{}", printable(text.as_ref())).ok();
}

/// Prints a question; the answer is typed after it. Fails if standard error is closed.
pub fn ask(question: impl AsRef<str>) -> io::Result<()> {
    write!(io::stderr(), "{} ", printable(question.as_ref())).and_then(|()| io::stderr().flush())
}

/// Whether the answer is yes.
pub fn is_confirmed(question: impl AsRef<str>) -> bool {
    // A user who cannot see the question cannot have answered yes.
    if ask(question).is_err() {
        return false;
    }
    let mut answer = String::new();
    io::stdin().read_line(&mut answer).is_ok() && ["y", "yes"].contains(&answer.trim().to_lowercase().as_str())
}

/// Lines typed from now on; `None` if nobody can type.
pub fn typed_lines() -> Option<mpsc::Receiver<String>> {
    if !io::stdin().is_terminal() {
        return None;
    }
    let (sender, lines) = mpsc::channel();
    // The thread ends with the program.
    thread::spawn(move || {
        while wait_for_input() {
            let mut line = String::new();
            match io::stdin().read_line(&mut line) {
                Ok(1..) if sender.send(line.trim().to_string()).is_ok() => {}
                _ => break,
            }
        }
    });
    Some(lines)
}

/// Waits until a line can be read; false when there will be none.
///
/// The terminal stops a background process that reads from it, and that would stop the recording too.
#[cfg(unix)]
fn wait_for_input() -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let stdin = io::stdin();
    loop {
        let mut polled = [PollFd::new(&stdin, PollFlags::IN)];
        let ready = poll(&mut polled, Some(&Timespec { tv_sec: 0, tv_nsec: 200_000_000 }));
        let in_front = rustix::termios::tcgetpgrp(&stdin).is_ok_and(|group| group == rustix::process::getpgrp());
        match ready {
            Ok(1..) if in_front => return true,
            Ok(1..) => thread::sleep(Duration::from_millis(200)),
            Ok(0) | Err(rustix::io::Errno::INTR) => {}
            Err(_) => return false,
        }
    }
}

#[cfg(not(unix))]
fn wait_for_input() -> bool {
    true
}

/// Time after which a progress bar is shown.
const PATIENCE: Duration = Duration::from_millis(700);

/// A progress bar that appears when work takes a while, on a terminal only.
pub struct Progress {
    label: &'static str,
    /// `None` if the total is unknown.
    length: Option<u64>,
    started: Instant,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Progress of work with this total.
    pub fn new(label: &'static str, length: u64) -> Self {
        Self { length: Some(length), ..Self::endless(label) }
    }

    /// Progress through a file, in bytes.
    pub fn through(label: &'static str, file: &Path) -> Self {
        Self::new(label, file.metadata().map_or(0, |metadata| metadata.len()))
    }

    /// Progress of work whose total is unknown.
    pub fn endless(label: &'static str) -> Self {
        Self { label, length: None, started: Instant::now(), bar: None }
    }

    /// Sets the text beside the label, for work whose total is unknown.
    pub fn say(&mut self, text: String) {
        self.set(0);
        if let Some(bar) = &self.bar {
            bar.set_message(printable(&format!("{} {text}", self.label)).into_owned());
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

    /// Sets how much is done.
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

    /// Sets the fraction that is done of work with a total of 1000.
    pub fn set_part(&mut self, part: f64) {
        self.set((1000.0 * part) as u64);
    }

    /// Removes the bar.
    pub fn done(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Bars for stages of work that run one after the other.
#[derive(Default)]
pub struct Bars(Option<Progress>);

impl Bars {
    /// Sets the progress of a stage; its bar replaces the previous stage's.
    pub fn set(&mut self, label: &'static str, position: u64, length: u64) {
        if self.0.as_ref().is_some_and(|bar| bar.label != label) {
            self.done();
        }
        self.0.get_or_insert_with(|| Progress::new(label, length)).set(position);
    }

    /// Removes the bar.
    pub fn done(&mut self) {
        if let Some(bar) = self.0.take() {
            bar.done();
        }
    }
}

/// A [`Progress`] that its own thread shows, so that a terminal that accepts no output blocks nobody. Messages that do
/// not fit in the queue are dropped.
pub struct Told {
    words: mpsc::SyncSender<Word>,
    thread: Option<JoinHandle<()>>,
}

/// What to show.
type Word = Box<dyn FnOnce(&mut Progress) + Send>;

impl Told {
    pub fn new(mut progress: Progress) -> Self {
        let (words, waiting) = mpsc::sync_channel::<Word>(WAITING);
        let thread = thread::Builder::new().name("teller".into()).spawn(move || {
            for show in waiting {
                show(&mut progress);
            }
            progress.done();
        });
        // Without a thread nothing is shown.
        Self { words, thread: thread.ok() }
    }

    fn tell(&self, word: impl FnOnce(&mut Progress) + Send + 'static) {
        self.words.try_send(Box::new(word)).ok();
    }

    /// Sets how much is done.
    pub fn set(&self, position: u64) {
        self.tell(move |progress| progress.set(position));
    }

    /// Sets the text beside the label, for work whose total is unknown.
    pub fn say(&self, text: String) {
        self.tell(move |progress| progress.say(text));
    }

    /// Prints a note above the bar.
    pub fn note(&self, text: impl Into<String>) {
        let text = text.into();
        self.tell(move |progress| progress.note(text));
    }

    /// Waits until everything is shown.
    pub fn done(self) {
        drop(self.words);
        self.thread.map(JoinHandle::join);
    }
}
