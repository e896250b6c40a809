//! The person at the terminal, or the script that answers in his place.

use std::{
    io::{self, IsTerminal},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    time::Duration,
};

use inerter_data::{json::json_line, output};
use serde_json::json;

use super::super::terminal::{self, Progress};
use crate::{Error, calibrate::Dialogue, error::DialogueError};

/// Time between two looks for Ctrl-C while an answer is waited for.
const LOOK: Duration = Duration::from_millis(50);

/// Questions on standard error, answers from standard input.
pub struct Person {
    json: bool,
    lines: Option<Receiver<String>>,
    bar: Option<(&'static str, Progress)>,
}

impl Person {
    /// With `json` questions are objects on standard output, for a program that answers.
    pub fn new(json: bool) -> Self {
        Self { json, lines: None, bar: None }
    }

    /// Whether somebody can read and answer what was not planned.
    pub fn is_there() -> bool {
        io::stdin().is_terminal() && io::stderr().is_terminal()
    }

    fn done(&mut self) {
        if let Some((_, bar)) = self.bar.take() {
            bar.done();
        }
    }
}

impl Dialogue for Person {
    fn say(&mut self, text: &str) {
        self.done();
        terminal::say(text);
    }

    fn ask(&mut self, question: &str, default: &str) -> Result<String, Error> {
        self.done();
        let lines = self.lines.get_or_insert_with(answers);
        if io::stdin().is_terminal() {
            // What was typed before the question is no answer to it.
            while lines.try_recv().is_ok() {}
        }
        if self.json {
            output::line(json_line(&json!({ "kind": "prompt", "question": question, "default": default })))?;
            output::flush()?;
        } else {
            let default = if default.is_empty() { String::new() } else { format!(" ({default})") };
            // Nobody sees it where standard error is closed.
            terminal::ask(format!("{question}{default}:")).ok();
        }
        loop {
            if terminal::interrupted() {
                return Err(Error::INTERRUPTED);
            }
            match lines.recv_timeout(LOOK) {
                Ok(answer) if answer.trim().is_empty() => return Ok(default.into()),
                Ok(answer) => return Ok(answer.trim().into()),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(DialogueError::Nobody.into()),
            }
        }
    }

    fn progress(&mut self, label: &'static str, fraction: f64) -> Result<(), Error> {
        if terminal::interrupted() {
            self.done();
            return Err(Error::INTERRUPTED);
        }
        if fraction >= 1.0 {
            self.done();
            return Ok(());
        }
        if self.bar.as_ref().is_some_and(|(shown, _)| *shown != label) {
            self.done();
        }
        let (_, bar) = self.bar.get_or_insert_with(|| (label, Progress::new(label, 1000)));
        bar.set((1000.0 * fraction) as u64);
        Ok(())
    }
}

/// Lines of standard input, read in a thread of their own so that Ctrl-C is heard meanwhile.
fn answers() -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in io::stdin().lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    receiver
}
