//! Answers from the person at the terminal, or from a script in their place.

use std::{
    io::{self, IsTerminal},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    time::Duration,
};

use inerter_data::json::json_line;
use serde_json::json;

use super::super::{
    print::print_now,
    terminal::{self, Bars},
};
use crate::{Error, calibrate::Dialogue, error::DialogueError};

/// Time between two checks for Ctrl-C while waiting for an answer.
const LOOK: Duration = Duration::from_millis(50);

/// Questions on standard error, answers from standard input.
pub struct Person {
    json: bool,
    lines: Option<Receiver<String>>,
    bars: Bars,
}

impl Person {
    /// With `json` questions are objects on standard output, for a program that answers.
    pub fn new(json: bool) -> Self {
        Self { json, lines: None, bars: Bars::default() }
    }
}

impl Dialogue for Person {
    fn say(&mut self, text: &str) {
        self.bars.done();
        terminal::say(text);
    }

    fn ask(&mut self, question: &str, default: &str) -> Result<String, Error> {
        self.bars.done();
        let lines = self.lines.get_or_insert_with(answers);
        if io::stdin().is_terminal() {
            // Anything typed before the question is not an answer to it.
            while lines.try_recv().is_ok() {}
        }
        if self.json {
            print_now(json_line(&json!({ "kind": "prompt", "question": question, "default": default })))?;
        } else {
            let default = if default.is_empty() { String::new() } else { format!(" ({default})") };
            // If standard error is closed, nobody sees it.
            terminal::ask(format!("{question}{default}:")).ok();
        }
        loop {
            terminal::go_on()?;
            match lines.recv_timeout(LOOK) {
                Ok(answer) if answer.trim().is_empty() => return Ok(default.into()),
                Ok(answer) => return Ok(answer.trim().into()),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(DialogueError::Nobody.into()),
            }
        }
    }

    fn progress(&mut self, label: &'static str, fraction: f64) -> Result<(), Error> {
        let goes_on = terminal::go_on();
        if goes_on.is_err() || fraction >= 1.0 {
            self.bars.done();
        } else {
            self.bars.set(label, (1000.0 * fraction) as u64, 1000);
        }
        Ok(goes_on?)
    }
}

/// Lines of standard input, read in a separate thread so that Ctrl-C is noticed meanwhile.
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
