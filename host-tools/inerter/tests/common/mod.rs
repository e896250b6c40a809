//! Shared by the program's tests: running it, and reading its JSON.
#![allow(dead_code, reason = "tests and campaigns each use a part")]

#[path = "../../../device/src/image/elf_file.rs"]
pub mod elf_file;
pub mod firmware;
pub mod frames;
pub mod monitor;
pub mod stores;
#[cfg(unix)]
pub mod terminal;
#[cfg(unix)]
pub mod unruly;

use std::{
    path::Path,
    process::{Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use inerter_data::settings::Overrides;
use inerter_plant::Inerter;
use inerter_simulate::{Endpoint, Setup, VirtualDevice, bench_sensors};
use serde_json::Value;

/// The paper's inerter on the bench with this motion.
pub fn setup(excitation: &str) -> Setup {
    Setup::new(Inerter::paper(), bench_sensors(), excitation, None, &Overrides::default()).unwrap()
}

pub fn any_port() -> Endpoint {
    Endpoint::Tcp("127.0.0.1:0".into())
}

/// The paper's inerter in random motion as a virtual device, at this multiple of real time.
pub fn device(speed: f64) -> VirtualDevice {
    device_of(&setup("random"), speed)
}

/// The same for another set-up.
pub fn device_of(setup: &Setup, speed: f64) -> VirtualDevice {
    VirtualDevice::start(setup, &any_port(), speed).unwrap()
}

/// The program in this folder.
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

/// Runs the program, which must succeed. Returns its standard output.
pub fn done(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}{}", text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

/// Runs the program, which must exit with this code. Returns its standard error.
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

/// Asserts that both contain the same estimates, except for what only a replay adds.
pub fn assert_same_estimates(one: &str, other: &str) {
    let lines = |text| json_lines(text).iter().map(estimate_of).collect::<Vec<_>>();
    assert!(lines(one) == lines(other), "{one}\n{other}");
}

/// The content of an estimate, without what only a replay adds.
pub fn estimate_of(value: &Value) -> Value {
    let mut object = value.as_object().unwrap().clone();
    for key in ["final", "samples", "discontinuities", "lost_samples", "saturated", "uncertainty", "warnings"] {
        object.remove(key);
    }
    object.into()
}

/// Returns the text if it contains a foreign character or a forged line.
pub fn foreign_words(words: &str) -> Option<String> {
    let is_forged = words.lines().any(|line| line.starts_with("forged"));
    (is_forged || words.contains(is_foreign)).then(|| words.to_string())
}

/// Whether a character must reach neither a terminal nor a page: a control character, an invisible one, or one that
/// changes the writing direction. Line ends are allowed. The program has a list of its own.
pub fn is_foreign(letter: char) -> bool {
    let code = u32::from(letter);
    let is_control = letter.is_control() && letter != '\n';
    // Marks and overrides of the writing direction, line separators; hyphens and joiners that are not drawn.
    let is_layout = matches!(code, 0x61c | 0x200e | 0x200f | 0x2028..=0x202e | 0x2066..=0x2069);
    let is_joiner = matches!(code, 0xad | 0x34f | 0x200b..=0x200d | 0x2060..=0x2065 | 0x206a..=0x206f | 0xfeff);
    // Letters and symbols without ink: Korean and Khmer fillers, blank Braille, blank hieroglyphs, others.
    let is_filler = matches!(code, 0x115f | 0x1160 | 0x17b4 | 0x17b5 | 0x3164 | 0xffa0 | 0x16fe4);
    let is_blank = matches!(code, 0x2800 | 0x13441 | 0x13442 | 0x1d159);
    // What selects a variant of the glyph before; tags, and the rest of their block.
    let is_selector = matches!(code, 0x180b..=0x180f | 0xfe00..=0xfe0f | 0xe0000..=0xe0fff);
    // Annotations, shorthand and musical formats; the last replaces what is not text.
    let is_format = matches!(code, 0xfff0..=0xfffb | 0x1bca0..=0x1bca3 | 0x1d173..=0x1d17a | 0xfffd);
    is_control || is_layout || is_joiner || is_filler || is_blank || is_selector || is_format
}

/// Waits until a condition holds, with a generous limit.
pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < Duration::from_secs(60), "{what}");
        thread::sleep(Duration::from_millis(2));
    }
}

/// Collects every command from the program's own help, such as `settings get`, whose help satisfies `belongs`. Each of
/// them must be in `tried`.
pub fn all_are_tried(tried: &[&[&str]], belongs: impl Fn(&str) -> bool) {
    let mut waiting = vec![String::new()];
    let mut missing = Vec::new();
    while let Some(command) = waiting.pop() {
        let words: Vec<&str> = command.split_whitespace().collect();
        let help = done(Path::new("."), &[&words[..], &["--help"]].concat());
        let below = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
        // Continuation lines are indented further.
        let names = below.filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
        waiting.extend(names.filter(|name| !["", "help"].contains(name)).map(|name| format!("{command} {name}")));
        let is_command = !words.is_empty() && (!help.contains(" <COMMAND>\n") || help.contains("[OPTIONS]\n"));
        if is_command && belongs(&help) && !tried.iter().any(|tried| tried.starts_with(&words)) {
            missing.push(command);
        }
    }
    assert!(missing.is_empty(), "not tried: {missing:?}");
}
