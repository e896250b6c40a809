//! A running `inerter monitor --json`.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, ChildStdout, Command},
};

use serde_json::Value;

use super::{inerter, last};

/// A monitor that prints JSON until it is dropped.
pub struct Monitor {
    child: Child,
    output: BufReader<ChildStdout>,
}

impl Monitor {
    /// Connects to the device at this address.
    pub fn start(folder: &Path, device: &str, arguments: &[&str]) -> Self {
        let all = [&["monitor", "--json", "--connect", device], arguments].concat();
        Self::spawn(inerter(folder, &all))
    }

    /// Starts this command, whose standard output is a pipe.
    pub fn spawn(mut command: Command) -> Self {
        let mut child = command.spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self { child, output }
    }

    /// The next line of a kind.
    pub fn next(&mut self, kind: &str) -> Value {
        loop {
            let mut line = String::new();
            assert!(self.output.read_line(&mut line).unwrap() > 0, "the monitor ended before `{kind}`");
            let value = last(&line);
            if value["kind"] == kind {
                return value;
            }
        }
    }
}

impl Drop for Monitor {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
