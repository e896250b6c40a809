//! The program `inerter selftest` on a board of the twin: it passes on a sound board and names the cause on others.
//!
//! The program reaches the board's serial port over TCP, and has a terminal with a simulated person. Whatever the
//! outcome, the board's own report must show the settings from before the test.
//!
//! Slow: a quarter of a minute each, or more with jumpers. Skipped if the image or the program is missing.

use crate::common::carried_by;
use inerter_core::Settings;
use inerter_twin::chip::adc::Quality;
use inerter_twin::chip::dmamux::Request as DmaRequest;
use inerter_twin::chip::errata::Errata;
use inerter_twin::chip::jumpers::{Jumpers, Planted};
use inerter_twin::machine::{Machine, Options, shipping_image};
use inerter_twin::tcp;
use inerter_twin::usb_link::UsbLink;
use inerter_twin::world::Still;
use inerter_twin::{Board, Registers, Width};
use inerter_wire::{Command as Request, Record, SettingsValues};
use rustix::process::{Pid, Signal, kill_process};
use rustix::{fs, pty};
use serde_json::Value;
use std::fs::File;
use std::io::{Read, Write};
use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

/// From power-on until the firmware runs \[s\].
const START_S: f64 = 0.5;
/// Time limit for a reply; a save may have to erase a page \[s\].
const REPLY_S: f64 = 2.0;

/// Path of the program. `None` if it is not built, after reporting the skip.
fn program() -> Option<PathBuf> {
    let path = std::env::var_os("INERTER_PROGRAM")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/debug/inerter"), PathBuf::from);
    let found = path.is_file().then_some(path.clone());
    inerter_needs::or_skip(found.ok_or_else(|| format!("{}: `cargo build-lean -p inerter` makes it", path.display())))
}

/// The settings of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Kept {
    in_use: Settings,
    /// `None` if none were ever saved.
    saved: Option<Settings>,
}

impl Kept {
    /// As reported by the board.
    fn of(link: &mut UsbLink<Machine>) -> Self {
        let records = ask(link, [Request::Hello, Request::ReadSettings, Request::ReadSaved]);
        let read = |values: &SettingsValues| values.read(&Settings::default()).settings;
        let in_use = records.iter().rev().find_map(carried_by!(Record::Settings)).map(read);
        let saved = records.iter().rev().find_map(carried_by!(Record::Saved)).map(read);
        Self { in_use: in_use.expect("settings"), saved }
    }

    /// The same settings with the skew of `other`.
    fn with_skew_of(self, other: &Self) -> Self {
        let with = |settings: Settings, other: Settings| Settings {
            skew_s: other.skew_s,
            skew_u95_s: other.skew_u95_s,
            ..settings
        };
        let saved = self.saved.zip(other.saved).map(|(settings, other)| with(settings, other));
        Self { in_use: with(self.in_use, other.in_use), saved }
    }
}

/// Plugs the board in, sends it these requests, and returns the records it sends.
fn ask(link: &mut UsbLink<Machine>, requests: impl IntoIterator<Item = Request>) -> Vec<Record> {
    link.plug_in().expect("opens");
    for request in requests {
        link.request(request, REPLY_S).expect("a reply");
    }
    link.listen(0.05).expect("listens");
    let records = link.talk.records();
    link.unplug();
    records
}

/// Makes the board look used: the settings in use differ from the saved ones.
fn use_it(link: &mut UsbLink<Machine>) {
    let saved = Settings { newtons_per_code: 0.01, skew_s: 5e-5, skew_u95_s: 5e-6, ..Settings::default() };
    let in_use = Settings { newtons_per_code: 0.02, ..saved };
    let [saved, in_use] = [saved, in_use].map(|settings| Request::WriteSettings(SettingsValues::from(&settings)));
    ask(link, [Request::Hello, saved, Request::SaveSettings, in_use]);
}

/// A board whose serial port is reached over TCP.
struct Served {
    address: SocketAddr,
    over: Arc<AtomicBool>,
    /// Returns the board's settings before and after.
    thread: Option<JoinHandle<[Kept; 2]>>,
}

impl Served {
    fn new(machine: impl FnOnce() -> Machine + Send + 'static, is_new: bool) -> Self {
        let listener = tcp::listener().expect("a free port");
        let address = listener.local_addr().expect("bound");
        let over = Arc::new(AtomicBool::new(false));
        let ends = over.clone();
        let thread = std::thread::spawn(move || {
            let mut machine = machine();
            machine.run_for(START_S).expect("starts");
            let mut link = UsbLink::new(machine);
            if !is_new {
                use_it(&mut link);
            }
            let before = Kept::of(&mut link);
            tcp::serve(&mut link, &listener, || ends.load(Ordering::Relaxed)).unwrap_or_else(|error| panic!("{error}"));
            [before, Kept::of(&mut link)]
        });
        Self { address, over, thread: Some(thread) }
    }

    /// The board's settings before and after.
    fn end(mut self) -> [Kept; 2] {
        self.over.store(true, Ordering::Relaxed);
        self.thread.take().expect("once").join().expect("the board lives")
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

/// A terminal with a person who acts once on reading `prompt`. The thread returns everything shown.
fn terminal(prompt: &'static str, act: impl FnOnce(&mut File) + Send + 'static) -> (OwnedFd, JoinHandle<String>) {
    let person = pty::openpt(pty::OpenptFlags::RDWR | pty::OpenptFlags::NOCTTY).expect("a terminal");
    rustix::io::fcntl_setfd(&person, rustix::io::FdFlags::CLOEXEC).expect("can be");
    pty::grantpt(&person).and_then(|()| pty::unlockpt(&person)).expect("can be");
    let name = pty::ptsname(&person, Vec::new()).expect("a name");
    let flags = fs::OFlags::RDWR | fs::OFlags::NOCTTY | fs::OFlags::CLOEXEC;
    let terminal = fs::open(name.as_c_str(), flags, fs::Mode::empty()).expect("opens");
    let seen = std::thread::spawn(move || {
        let (mut person, mut seen, mut some) = (File::from(person), Vec::new(), [0; 4096]);
        let mut act = Some(act);
        // The read fails once no program holds the terminal.
        while let Ok(count) = person.read(&mut some) {
            seen.extend_from_slice(&some[..count]);
            if String::from_utf8_lossy(&seen).contains(prompt)
                && let Some(act) = act.take()
            {
                act(&mut person);
            }
        }
        String::from_utf8_lossy(&seen).into_owned()
    });
    (terminal, seen)
}

/// The question that the program asks before it drives the outputs.
const QUESTION: &str = "Drive the board's outputs?";

/// The program's verdict on a board.
struct Outcome {
    code: Option<i32>,
    /// Contents of the JSON file.
    json: Value,
    page: String,
    /// Everything shown on the terminal.
    errors: String,
    /// The board's final settings, if they differ from those before.
    changed: Option<Kept>,
}

impl Outcome {
    /// The checks with these names failed and no other, and the program's exit code says so.
    #[track_caller]
    fn fails(&self, names: &[&str]) {
        assert_eq!(self.names("fail"), names, "{}", self.errors);
        assert_eq!(self.code, Some(if names.is_empty() { 0 } else { 10 }), "{}", self.errors);
    }

    fn checks(&self) -> impl Iterator<Item = &Value> {
        self.json["checks"].as_array().expect("checks").iter()
    }

    fn names(&self, verdict: &str) -> Vec<&str> {
        let of_verdict = self.checks().filter(|check| check["verdict"] == verdict);
        of_verdict.map(|check| check["name"].as_str().expect("a name")).collect()
    }

    fn check(&self, name: &str) -> &Value {
        self.checks().find(|check| check["name"] == name).expect("the check")
    }

    fn reason(&self, name: &str) -> &str {
        self.check(name)["reason"].as_str().unwrap_or_default()
    }
}

/// One board at a time: the program's timeouts use wall-clock time.
static ALONE: Mutex<()> = Mutex::new(());

/// The program for this board, in its own folder.
fn command(program: PathBuf, name: &str, board: SocketAddr, terminal: OwnedFd) -> (Command, PathBuf) {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    // Left over from an earlier run.
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let page = folder.join("page.html");
    let mut command = Command::new(program);
    command
        .current_dir(&folder)
        .args(["selftest", "--json", "--connect", &board.to_string(), "-o"])
        .arg(&page)
        .stdin(terminal.try_clone().expect("can be"))
        .stderr(terminal);
    (command, page)
}

/// Runs the self-test with these arguments about the jumpers, and this answer if the person is asked. Only `--write`
/// may change a setting, and only the skew.
fn selftest(
    name: &str,
    (jumpers, answer): (&[&str], &'static str),
    machine: impl FnOnce(&[u8]) -> Machine + Send + 'static,
) -> Option<Outcome> {
    let (image, program) = (shipping_image()?, program()?);
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let served = Served::new(move || machine(&image), false);
    let (terminal, seen) = terminal(QUESTION, move |person| writeln!(person, "{answer}").expect("types"));
    let (mut command, page) = command(program, name, served.address, terminal);
    let output = command.args(jumpers).output().expect("the program");
    drop(command);
    let errors = seen.join().expect("the person");
    let [before, after] = served.end();
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    println!("{text}{errors}");
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let json =
        serde_json::from_str(&std::fs::read_to_string(page.with_extension("json")).expect("the file")).expect("JSON");
    assert_eq!(lines.last(), Some(&json), "the file holds what the last line does");
    let page = std::fs::read_to_string(page).expect("the page");
    assert_eq!(before.with_skew_of(&after), after, "settings of before, and after");
    let changed = (after != before).then_some(after);
    assert!(changed.is_none() || jumpers.contains(&"--write"), "{changed:?}");
    Some(Outcome { code: output.status.code(), json, page, errors, changed })
}

fn board(image: &[u8]) -> Machine {
    Machine::new(image, Still).expect("the image")
}

const UNPLUGGED: (&[&str], &str) = (&["--rig-unplugged", "--write"], "no");

/// The person says no when asked whether the outputs may be driven: a rig may be connected.
#[test]
fn a_sound_board_passes_and_nothing_is_played_where_a_rig_may_be_connected() {
    let Some(outcome) = selftest("sound", (&["--write"], "no"), board) else { return };
    outcome.fails(&[]);
    assert!(outcome.errors.contains(QUESTION));
    assert!(!outcome.names("pass").contains(&"encoder_wires"));
    assert_eq!(outcome.names("skipped"), ["dfu", "double_reset", "jumpers"]);
    assert!(outcome.reason("jumpers").starts_with("a rig may be connected"));
    is_not_written(&outcome);
    assert!(outcome.page.contains("Passed"));
    // The twin's values in the table of expected work agree with what the twin measures.
    let number = |text: &Value, before: &str| {
        let (number, _) = text.as_str()?.strip_prefix(before)?.split_once(':').unwrap_or((text.as_str()?, ""));
        number.parse::<f64>().ok()
    };
    for name in ["work_sampling", "work_estimating", "work_telemetry", "work_supervising"] {
        let check = outcome.check(name);
        let found = number(&check["found"], "").zip(number(&check["expected"], "twin "));
        let ratio = found.map(|(found, table)| found / table).expect("numbers");
        assert!((0.8..1.25).contains(&ratio), "{name}: {ratio} times what the table says");
    }
    for name in ["work_commands", "work_usb"] {
        let Value::String(expected) = &outcome.check(name)["expected"] else { panic!("{name}: no words") };
        assert!(expected.starts_with("no work: "), "{expected}");
        assert!(number(&outcome.check(name)["found"], "").is_some_and(|found| found < 1e-3), "{name} does work");
    }
    assert!(outcome.names("pass").len() >= 30, "{:?}", outcome.names("pass"));
}

/// The request is lost before the program connects: the board counts it, but says only once what it was.
#[test]
fn a_wrong_clock_a_lost_dma_request_and_a_wire_that_is_missing_are_named() {
    let board = Board { hse_hz: 24.24e6, ..Board::NUCLEO };
    let machine = move |image: &[u8]| {
        let options = Options { board, ..Options::default() };
        let mut machine = Machine::with(image, options, Still).expect("the image");
        let chip = machine.chip_mut();
        chip.jumpers = Some(Jumpers { terminal: None, ..Jumpers::RIGHT });
        chip.planted.lost = Some((DmaRequest::Tim6Update, 1.0));
        machine
    };
    let Some(outcome) = selftest("clock", UNPLUGGED, machine) else { return };
    outcome.fails(&["clock_usb", "overruns", "terminal_wire"]);
    names_and_plays_nothing_more(&outcome, "terminal_wire", "PA6 to PA1 is missing");
    assert!(outcome.reason("overruns").starts_with("a DMA transfer was lost"), "{}", outcome.reason("overruns"));
    assert!(outcome.reason("clock_usb").contains("1.00 % fast: its crystal"), "{}", outcome.reason("clock_usb"));
    assert!(outcome.page.contains("its crystal is not the one"));
}

/// The sampling timer is reloaded as if the firmware had computed twice its period, until the test restarts the board.
/// All other clocks are right.
#[test]
fn half_the_sample_rate_and_a_late_converter_are_named() {
    const AUTO_RELOAD: u32 = 0x2C;
    const TWICE: u32 = 2 * 2625 - 1;
    let late = Planted { late: [2 * 168, 0], ..Planted::default() };
    let machine = move |image: &[u8]| {
        let mut machine = wired(Jumpers::RIGHT, late)(image);
        machine.run_for(START_S).expect("starts");
        let now = machine.now();
        let timer = &mut machine.chip_mut().tim6;
        assert_eq!(timer.read(AUTO_RELOAD, Width::Word, now), Ok(2625 - 1), "the firmware started it");
        timer.write(AUTO_RELOAD, TWICE, Width::Word, now).expect("as the firmware does");
        machine
    };
    let Some(outcome) = selftest("half", UNPLUGGED, machine) else { return };
    outcome.fails(&["sample_rate", "timing"]);
    assert!(outcome.reason("sample_rate").starts_with("the sampling timer runs at a wrong rate"));
    // The test of the library checks the delay, without time pressure.
    names_and_plays_nothing_more(&outcome, "timing", "us too late: force and position are not simultaneous");
}

#[test]
fn noise_that_is_too_high_and_swapped_encoder_wires_are_named() {
    let Jumpers { a, b, .. } = Jumpers::RIGHT;
    let machine = move |image: &[u8]| {
        let mut machine = wired(Jumpers { a: b, b: a, ..Jumpers::RIGHT }, Planted::default())(image);
        machine.chip_mut().adc.set_quality(Quality { noise_lsb: 6.0, ..Quality::default() });
        machine
    };
    let Some(outcome) = selftest("noise", UNPLUGGED, machine) else { return };
    outcome.fails(&["noise_force", "noise_terminal", "encoder_wires"]);
    assert!(outcome.reason("noise_force").starts_with("the noise is too high"));
    names_and_plays_nothing_more(&outcome, "encoder_wires", "A and B are swapped");
}

/// Sends Ctrl-C some time after the program prints `prompt`. Afterwards the board must have its settings again. A new
/// board has no saved settings before; afterwards those that were in use are saved.
fn interrupted(name: &str, prompt: &'static str, pause: Duration, is_new: bool) {
    let (Some(image), Some(program)) = (shipping_image(), program()) else { return };
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let served = Served::new(move || board(&image), is_new);
    let (tell, told) = mpsc::channel();
    let (terminal, seen) = terminal(prompt, move |_| tell.send(()).expect("somebody waits"));
    let (mut command, page) = command(program, name, served.address, terminal);
    let mut child = command.arg("--without-jumpers").stdout(Stdio::null()).spawn().expect("the program");
    drop(command);
    told.recv().expect("the prompt");
    std::thread::sleep(pause);
    kill_process(Pid::from_child(&child), Signal::INT).expect("it runs");
    let code = child.wait().expect("ends").code();
    let errors = seen.join().expect("the person");
    let [before, after] = served.end();
    assert!(errors.contains(prompt), "{errors}");
    assert_eq!(code, Some(130), "{errors}");
    assert!(!errors.contains("were not restored") && !page.exists(), "{errors}");
    assert_eq!(before.saved.is_none(), is_new);
    let restored = Kept { saved: before.saved.or(Some(before.in_use)), ..before };
    assert_eq!(after, restored, "{errors}");
}

/// By then other settings are saved and in use.
#[test]
fn ctrl_c_after_the_save_leaves_the_settings_as_they_were() {
    interrupted("ctrl-c-saved", "restarting the board", Duration::ZERO, true);
}

/// By then the board hangs, and other settings are saved. Without a connection its time may run faster than a clock on
/// the wall, so the pause is far shorter than the 4 s until it is back.
#[test]
fn ctrl_c_while_the_board_is_gone_leaves_the_settings_as_they_were() {
    interrupted("ctrl-c-gone", "hanging the board", Duration::from_millis(500), false);
}

/// A board with these jumpers and this planted fault.
fn wired(jumpers: Jumpers, planted: Planted) -> impl FnOnce(&[u8]) -> Machine + Send {
    move |image| {
        // Converters that do not start together disturb each other. That would hide a late converter.
        let errata = Errata { adc_concurrent: planted.late == [0; 2], ..Errata::ALL };
        let options = Options { errata, ..Options::default() };
        let mut machine = Machine::with(image, options, Still).expect("the image");
        machine.chip_mut().jumpers = Some(jumpers);
        machine.chip_mut().planted = planted;
        machine
    }
}

/// If the skew is not measured, `--write` reports that it has nothing to save.
fn is_not_written(outcome: &Outcome) {
    assert_eq!(outcome.json["skew"], Value::Null);
    assert_eq!(outcome.changed, None);
    assert!(outcome.errors.contains("--write saves nothing"), "{}", outcome.errors);
}

/// The person agrees to drive the outputs. The measured skew appears in the page and is on the board afterwards.
#[test]
fn a_sound_board_passes_through_jumpers() {
    let Some(outcome) = selftest("jumpers", (&["--write"], "yes"), wired(Jumpers::RIGHT, Planted::default())) else {
        return;
    };
    assert!(outcome.errors.contains(QUESTION));
    outcome.fails(&[]);
    assert_eq!(outcome.names("skipped"), ["dfu", "double_reset"]);
    assert!(outcome.page.contains("Passed"));
    let passed = outcome.names("pass");
    for name in
        ["encoder_wires", "timing", "fast_edges", "inertance", "backlash_by_the_force", "backlash_by_the_terminal"]
    {
        assert!(passed.contains(&name), "{name} of {passed:?}");
        assert!(outcome.page.contains(outcome.check(name)["found"].as_str().expect("words")), "{name}");
    }
    assert_eq!(passed.last(), Some(&"restored"));
    let of = |name: &str| outcome.json["skew"][name].as_f64().expect("a number");
    let (skew_s, skew_u95_s) = (of("skew_s"), of("skew_u95_s"));
    // docs/HARDWARE.md: the sum of the board's known delays.
    assert!((skew_s + 0.63e-6).abs() < skew_u95_s && (0.05e-6..0.3e-6).contains(&skew_u95_s), "{skew_s} {skew_u95_s}");
    let Kept { in_use, saved } = outcome.changed.expect("other settings");
    for settings in [in_use, saved.expect("saved settings")] {
        let off_s = [settings.skew_s - skew_s, settings.skew_u95_s - skew_u95_s];
        assert!(off_s.iter().all(|off_s| off_s.abs() < 1e-15), "{off_s:?}");
    }
    assert!(outcome.page.contains(&format!("(skew_s): {:.2} µs", skew_s * 1e6)));
    assert!(!outcome.errors.contains("--write saves nothing"), "{}", outcome.errors);
}

/// With the flag, the program asks no question. After this check of the jumpers has failed, it plays nothing more.
fn names_and_plays_nothing_more(outcome: &Outcome, check: &str, cause: &str) {
    assert!(!outcome.errors.contains(QUESTION));
    assert!(outcome.reason(check).contains(cause), "{}", outcome.reason(check));
    assert!(outcome.page.contains(cause));
    assert!(!outcome.names("pass").contains(&"inertance"));
    is_not_written(outcome);
}

/// Whether the sampler loses samples before anything is played, or while which tape is played, depends on the moment.
/// Whatever fails last names the trigger.
#[test]
#[ignore = "long: cargo xtask test --full"]
fn a_wrong_trigger_is_named() {
    let planted = Planted { late: [2625 / 2; 2], ..Planted::default() };
    let Some(outcome) = selftest("trigger", UNPLUGGED, wired(Jumpers::RIGHT, planted)) else { return };
    let failed = outcome.names("fail");
    let last = failed.last().copied().unwrap_or_default();
    assert!(["sampling", "timing"].contains(&last), "{failed:?}: {}", outcome.errors);
    assert!(outcome.reason(last).contains("trigger"), "{}", outcome.reason(last));
    assert_eq!(outcome.code, Some(10), "{}", outcome.errors);
    is_not_written(&outcome);
}

#[test]
#[ignore = "long: cargo xtask test --full"]
fn half_the_count_rate_is_named() {
    let planted = Planted { half_counts: true, ..Planted::default() };
    let Some(outcome) = selftest("counts", UNPLUGGED, wired(Jumpers::RIGHT, planted)) else { return };
    outcome.fails(&["encoder_wires"]);
    names_and_plays_nothing_more(&outcome, "encoder_wires", "every other edge");
}
