//! What the tests of the program share: running it, and reading its JSON.
#![allow(dead_code, reason = "each test file uses its part")]

use std::{
    path::Path,
    process::{Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;

/// The program, in this folder.
pub fn inerter(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_inerter"));
    command.args(arguments).current_dir(folder).env("NO_COLOR", "1").env_remove("INERTER_QEMU_IMAGE");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs the program to its end.
pub fn run(folder: &Path, arguments: &[&str]) -> Output {
    inerter(folder, arguments).output().unwrap()
}

/// Runs the program, which must do what it was asked; gives its standard output.
pub fn done(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}{}", text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

/// Runs the program, which must end with this code; gives what it says on standard error.
pub fn fails(folder: &Path, arguments: &[&str], code: i32) -> String {
    let output = run(folder, arguments);
    let words = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}{words}", text(&output.stdout));
    words
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Every line as JSON.
pub fn json_lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))).collect()
}

/// The last line as JSON.
pub fn last(text: &str) -> Value {
    json_lines(text).pop().unwrap()
}

/// What an estimate says, without what only a replay adds.
pub fn estimate_of(value: &Value) -> Value {
    let mut object = value.as_object().unwrap().clone();
    for key in ["final", "samples", "discontinuities", "lost_samples", "saturated"] {
        object.remove(key);
    }
    object.into()
}

/// Waits for something that takes a moment, without a guess how long.
pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < Duration::from_secs(60), "{what}");
        thread::sleep(Duration::from_millis(2));
    }
}
