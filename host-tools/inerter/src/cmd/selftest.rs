//! `inerter selftest`: tests the user's board and writes down the results.

mod jumpers;

use std::{
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use inerter_core::{FrontEnd, RawSample, Settings};
use inerter_data::{
    backup::{self, Kept},
    json::json_line,
    output,
    selftest::{
        Check, SelfTest, Skew, Verdict,
        judge::{self, FULL_HZ},
    },
};
use inerter_device::{
    Clock, Device, DeviceError, Interrupted, Target,
    update::{Running, ThisMachine, UpdateError, visit},
};
use inerter_jumpers::Measured;
use inerter_wire::{
    Capabilities, Command, EventKind, Frame, Health, Hello, Measure, Quantity, Record, Refusal, ResetCause, Samples,
    Streams,
};
use miette::Diagnostic;

use super::{
    args::LinkArgs,
    print::{Kind, print_json},
    reports,
    terminal::{self, interrupted, note, say},
};
use crate::{Error, error::SelfTestError, feature::Feature};

/// Name of the backups when no page is written.
const NO_PAGE: &str = "selftest";
/// File name endings of the backups: of the saved settings, and of the settings in use if they differ.
const SAVED: &str = "settings.toml";
const IN_USE: &str = "in-use.toml";
/// Time for a board to come back: the watchdog resets it after 4 s, and Windows takes seconds to create a new port.
const RETURN: Duration = Duration::from_secs(25);
/// Pause between two attempts to reach the board.
const RETRY: Duration = Duration::from_millis(300);
/// Sample rate for the noise and workload measurements (Hz).
const QUIET_HZ: f64 = 1000.0;
/// How long to collect samples (s of the device's clock), and how much longer that may take.
const LISTEN_S: f64 = 2.0;
const PATIENCE: u32 = 6;
/// The sample counter's jump after a halt is at most this many samples after the first.
const BEFORE_JUMP: usize = 2 * Samples::MAX_SAMPLES;
/// Samples still in flight after the sampler halts arrive within this time.
const HALT: Duration = Duration::from_secs(1);
/// Time to wait for a health record, which the board sends once a second.
const HEALTH: Duration = Duration::from_secs(2);

/// Test a board (chip, clocks, supply, noise, flash, watchdog, restart, update mode) and write a report.
///
/// Most of it needs no wires. With four jumpers between its outputs and inputs (docs/HARDWARE.md) the board also
/// generates the signals of a simulated inerter and measures them through its own inputs. Nothing else may be
/// connected: confirm that with --rig-unplugged or when asked. The board's settings are backed up to a file first and
/// restored at the end, also after Ctrl-C and after an error. The board restarts three times; over its own USB
/// connector it also goes into update mode and back, without being written to. Each line is a check with the result and
/// the expected range; if one fails, with its likely cause.
///
/// -o writes a report page, and beside it a JSON file and the backup, to be passed on. Without it the backup is
/// selftest.settings.toml in the current folder. An earlier backup is never replaced: the next one is named
/// .settings.2.toml. With --json one object per check and one at the end: docs/CLI.md describes them. Exit code 10 if a
/// check fails.
#[derive(clap::Args)]
pub struct Args {
    /// Page to write; beside it the same as .json, and a backup of the settings (.settings.toml)
    #[arg(short, long, value_name = "PAGE.html")]
    output: Option<PathBuf>,
    /// Replace a page and a JSON file that exist
    #[arg(long)]
    force: bool,
    /// Skip what needs jumpers
    #[arg(long)]
    without_jumpers: bool,
    /// Confirm that no rig is connected and the four wires are in place, so that the board may drive its outputs
    #[arg(long, conflicts_with = "without_jumpers")]
    rig_unplugged: bool,
    /// Save the delay of the force that is measured through the jumpers, with its uncertainty, as skew_s and skew_u95_s
    #[arg(long, conflicts_with = "without_jumpers")]
    write: bool,
    /// Skip update mode
    #[arg(long)]
    without_dfu: bool,
    #[command(flatten)]
    link: LinkArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Name of the JSON file beside a page.
fn json_of(page: &Path) -> Result<PathBuf, SelfTestError> {
    let json = page.with_extension("json");
    // Some file systems ignore case in file names.
    let folded = |path: &Path| path.to_string_lossy().to_lowercase();
    if folded(page) == folded(&json) {
        return Err(SelfTestError::SameName { page: page.into(), json });
    }
    Ok(json)
}

/// Name of a backup. It has one dot more than any page or JSON file, so it never collides with one.
fn backup_of(page: Option<&Path>, ending: &str) -> PathBuf {
    page.unwrap_or(Path::new(NO_PAGE)).with_extension(ending)
}

/// Writes the backups and says where they are. Returns the commands that restore them.
fn back_up(page: Option<&Path>, hello: &Hello, saved: Option<&Settings>, in_use: &Settings) -> Result<String, Error> {
    let write = |ending, settings| {
        let Kept { path, others } = backup::write_beside(&backup_of(page, ending), hello, settings)?;
        say(format!("settings backed up to {}", path.display()));
        if others > 0 {
            note(
                "other backups are beside it: if an earlier self-test of this board was cut off, use that test's backup",
            );
        }
        Ok::<_, Error>(path)
    };
    let mut commands =
        format!("`inerter settings restore --save {}`", write(SAVED, saved.unwrap_or(in_use))?.display());
    if saved.is_some_and(|saved| !backup::changes(saved, in_use).is_empty()) {
        commands += &format!(", then `inerter settings restore {}`", write(IN_USE, in_use)?.display());
    }
    Ok(commands)
}

pub fn run(args: &Args) -> Result<(), Error> {
    let page = args.output.as_deref();
    Feature::REPORTS.check("-o", page.is_some(), "--json prints what the page says")?;
    let json = page.map(json_of).transpose()?;
    if !args.force {
        page.into_iter().chain(json.as_deref()).try_for_each(output::refuse_existing)?;
    }
    terminal::catch_interrupts();
    let mut device = args.link.device()?;
    if !device.hello().capabilities.contains(Capabilities::MEASURE) {
        let (name, firmware) = (device.name().into(), device.hello().firmware.to_string());
        return Err(SelfTestError::CannotMeasure { name, firmware }.into());
    }
    let before = *device.settings();
    let saved = match device.keeps_settings().then(|| device.saved_settings()).transpose() {
        Ok(saved) => saved,
        Err(DeviceError::Refused { refusal: Refusal::NothingSaved | Refusal::SavedUnreadable, .. }) => None,
        Err(error) => return Err(error.into()),
    };
    let commands = back_up(page, device.hello(), saved.as_ref(), &before)?;
    let test = SelfTest {
        hello: device.hello().clone(),
        port: device.name().into(),
        begun_ns: Clock::new().now_ns(),
        checks: Vec::new(),
        measured: Vec::new(),
        skew: None,
    };
    let target = args.link.target().known(&test.hello.serial);
    let mut bench = Bench { target, device: Some(device), test, json: args.json, before, saved, has_saved: false };
    let outcome = bench.all(args);
    let restored = bench.restore();
    if !matches!(restored, Ok(true)) {
        note(format!("the settings were not restored: restore them with {commands}"));
    }
    if args.write && bench.test.skew.is_none() {
        note("the delay of the force was not measured, so --write saves nothing");
    }
    match outcome {
        // A board that stops answering has failed; the results up to that point still count.
        Err(error)
            if error.downcast_ref::<DeviceError>().is_some_and(|error| !matches!(error, DeviceError::Interrupted)) =>
        {
            let check = Check::words("whole", "Self-test as a whole", "completed", "aborted", Some(error.to_string()));
            bench.add([check])?;
        }
        outcome => outcome?,
    }
    bench.add([judge::restored(restored.map_err(|error| error.to_string()))])?;
    let test = bench.test;
    if let (Some(page), Some(json)) = (page, &json) {
        output::write(page, args.force, reports::selftest_page(&test)?)?;
        output::write(json, args.force, json_line(&test.json()) + "\n")?;
        say(format!("{} and {}", page.display(), json.display()));
    }
    if args.json {
        print_json(&test.json())?;
    } else {
        output::line(test.summary())?;
    }
    let failed = test.failed();
    if failed.is_empty() { Ok(()) } else { Err(SelfTestError::Failed { failed: failed.join(", ") }.into()) }
}

/// The board under test.
struct Bench {
    target: Target,
    /// `None` while the board restarts.
    device: Option<Device>,
    test: SelfTest,
    json: bool,
    /// Settings in use and settings saved, at the beginning.
    before: Settings,
    saved: Option<Settings>,
    /// Whether other settings have been saved since.
    has_saved: bool,
}

/// What the board sent within a period.
#[derive(Default)]
struct Heard {
    samples: Vec<RawSample>,
    bytes: usize,
    /// Health reports, from [`BEFORE_JUMP`] samples on.
    reports: Vec<Health>,
    /// Batches of samples that could not be decoded.
    unreadable: usize,
}

impl Bench {
    fn all(&mut self, args: &Args) -> Result<(), Error> {
        self.chip()?;
        self.noise()?;
        self.work()?;
        self.throughput()?;
        let kept = self.keep()?;
        self.restart(kept)?;
        self.watchdog()?;
        self.update_mode(args)?;
        if args.without_jumpers { Ok(()) } else { self.jumpers(args) }
    }

    /// Records the checks and shows them.
    fn add(&mut self, checks: impl IntoIterator<Item = Check>) -> Result<(), Error> {
        for check in checks {
            if self.json {
                print_json(&Kind { kind: "selftest_check", of: &check })?;
            } else {
                output::line(check.line())?;
            }
            self.test.checks.push(check);
        }
        Ok(output::flush()?)
    }

    /// The board; reconnects if it has restarted.
    fn device(&mut self) -> Result<&mut Device, DeviceError> {
        let device = match self.device.take() {
            Some(device) => device,
            None => self.reached(RETURN, interrupted)?,
        };
        Ok(self.device.insert(device))
    }

    /// Lets the board measure, and records the figures. A board that reports nothing has none.
    fn measure(&mut self, what: Measure) -> Result<inerter_wire::Measured, DeviceError> {
        let measured = self.device()?.measure(what)?.unwrap_or(inerter_wire::Measured::new(what));
        self.test.measured.push(measured.clone());
        Ok(measured)
    }

    fn chip(&mut self) -> Result<(), Error> {
        let hello = self.test.hello.clone();
        let chip = self.measure(Measure::Chip)?;
        self.add(judge::chip(&chip, &hello))?;
        let clocks = self.measure(Measure::Clocks)?;
        self.add(judge::clocks(&clocks, &hello))?;
        let supply = self.measure(Measure::Supply)?;
        self.add(judge::supply(&supply))
    }

    /// Settings for the test at this rate: the analogue front end is selected, everything else is unchanged.
    fn settings(&self, sample_rate_hz: f64) -> Settings {
        Settings { sample_rate_hz, front_end: FrontEnd::Analogue, ..self.before }
    }

    /// Restarts the sampler at this rate and collects what it sends.
    fn listen(&mut self, streams: Streams, sample_rate_hz: f64) -> Result<Heard, DeviceError> {
        let settings = self.settings(sample_rate_hz);
        let device = self.device()?;
        device.write_settings(&settings)?;
        device.stream(streams)?;
        device.request("to halt its sampler", Command::Stop)?;
        let halted = Instant::now();
        while device.receive()?.is_some() && halted.elapsed() < HALT {
            device.check_interrupted()?;
        }
        device.start_sampler()?;
        let wanted = (LISTEN_S * sample_rate_hz) as usize;
        let (mut heard, begun) = (Heard::default(), Instant::now());
        let reports = if streams.health { 2 } else { 0 };
        while (heard.samples.len() < wanted || heard.reports.len() < reports)
            && begun.elapsed() < Duration::from_secs_f64(LISTEN_S) * PATIENCE
        {
            device.check_interrupted()?;
            let Some(received) = device.receive()? else { continue };
            heard.bytes += received.bytes.len() + 1;
            match received.frame {
                Frame::Message { message: Record::Samples(samples), .. } => {
                    heard.unreadable += usize::from(samples.check().is_err());
                    heard.samples.extend(samples.iter().flatten());
                }
                Frame::Message { message: Record::Health(health), .. } if heard.samples.len() > BEFORE_JUMP => {
                    heard.reports.push(health);
                }
                _ => {}
            }
        }
        // A batch that was incomplete at the halt comes first; the sample counter jumps after it.
        let first = heard.samples.windows(2).take(BEFORE_JUMP);
        let jump = first.enumerate().rfind(|(_, pair)| pair[1].index.wrapping_sub(pair[0].index) != 1);
        if let Some((place, _)) = jump {
            heard.samples.drain(..=place);
        }
        Ok(heard)
    }

    fn noise(&mut self) -> Result<(), Error> {
        let heard = self.listen(Streams { samples: true, ..Streams::NONE }, QUIET_HZ)?;
        let inputs = [judge::Input::Force, judge::Input::Terminal];
        inputs.into_iter().try_for_each(|input| self.add(judge::noise(input, &heard.samples, QUIET_HZ)))
    }

    fn work(&mut self) -> Result<(), Error> {
        let settings = self.settings(QUIET_HZ);
        let device = self.device()?;
        device.write_settings(&settings)?;
        device.stream(Streams::ALL)?;
        let work = self.measure(Measure::Work)?;
        self.add(judge::work(&work))
    }

    /// Streams everything at the highest rate.
    fn throughput(&mut self) -> Result<(), Error> {
        let lost = u64::from(self.device()?.counts().lost);
        let damaged = self.device()?.counts().corrupt();
        let heard = self.listen(Streams::ALL, FULL_HZ)?;
        let counts = self.device()?.counts();
        let bad_frames =
            u64::from(counts.lost) - lost + u64::from(counts.corrupt() - damaged) + heard.unreadable as u64;
        let Heard { samples, bytes, reports, .. } = &heard;
        let heard = judge::Streamed { samples, bytes: *bytes, bad_frames, reports };
        self.add(judge::throughput(&heard))
    }

    /// Saves other settings and reads them back; returns the settings that must be in use after a restart.
    fn keep(&mut self) -> Result<Option<Settings>, Error> {
        const NAME: &str = "save";
        const LABEL: &str = "Settings saved and read back";
        let skipped = |reason: &str| Check::skipped(NAME, LABEL, reason);
        if !self.device()?.keeps_settings() {
            self.add([skipped("the board keeps no settings")])?;
            return Ok(None);
        }
        // One save for the test, and one to restore.
        let saves_left = self.test.measured.iter().rev().find_map(|measured| measured.get(Quantity::SavesLeft));
        if saves_left.is_some_and(|left| left < 2) {
            self.add([skipped("the flash was written often recently: try again in a few minutes")])?;
            return Ok(None);
        }
        let publish_rate_hz = if self.before.publish_rate_hz == 4.0 { 5.0 } else { 4.0 };
        let other = Settings { publish_rate_hz, ..self.settings(QUIET_HZ) };
        self.device()?.write_settings(&other)?;
        // From here on the saved settings must be restored, whatever happens.
        self.has_saved = true;
        match self.device()?.save_settings() {
            Err(DeviceError::Refused { refusal: Refusal::Worn { wait_s }, .. }) => {
                self.has_saved = false;
                self.add([skipped(&format!("the flash was written often recently: try again in {wait_s} s"))])?;
                return Ok(None);
            }
            result => result?,
        }
        let found = self.device()?.saved_settings()?;
        self.add([judge::same(NAME, LABEL, "as written", &other, &found)])?;
        Ok(Some(other))
    }

    /// Time since the board's start \[s\], and when the board reported it; `None` if it does not report it.
    fn uptime(&mut self) -> Result<Option<(u32, Instant)>, DeviceError> {
        let device = self.device()?;
        device.stream(Streams { health: true, ..Streams::NONE })?;
        // Records already in the queue are out of date.
        while device.pending().is_some() {}
        let begun = Instant::now();
        while begun.elapsed() < HEALTH {
            device.check_interrupted()?;
            if let Some(received) = device.receive()?
                && let Frame::Message { message: Record::Health(health), .. } = received.frame
            {
                return Ok(Some((health.uptime_s, Instant::now())));
            }
        }
        Ok(None)
    }

    /// Restarts the board and collects what it reports about the restart.
    fn comes_back(&mut self, what: &'static str, command: Command) -> Result<judge::Start, Error> {
        let before = self.uptime()?;
        self.device()?.request(what, command)?;
        self.device = None;
        thread::sleep(RETRY);
        let device = self.device()?;
        let mut told = None;
        while let Some(received) = device.pending() {
            if let Frame::Message { message: Record::Event(event), .. } = received.frame
                && let EventKind::ResetBy(cause) = event.kind
            {
                told = Some(cause);
            }
        }
        let uptime_s = match before.filter(|_| told.is_none()) {
            Some((before_s, then)) => {
                self.uptime()?.map(|(now_s, now)| (now_s, f64::from(before_s) + now.duration_since(then).as_secs_f64()))
            }
            None => None,
        };
        let chip = self.measure(Measure::Chip)?;
        Ok(judge::Start { told, flags: chip.get(Quantity::ResetFlags), uptime_s })
    }

    fn restart(&mut self, kept: Option<Settings>) -> Result<(), Error> {
        say("restarting the board");
        let start = self.comes_back("to restart", Command::Reboot)?;
        self.add([judge::restart("restart", "Restart by command", ResetCause::Software, &start)])?;
        if let Some(kept) = kept {
            let check = judge::same("kept", "Settings after the restart", "as saved", &kept, self.device()?.settings());
            self.add([check])?;
        }
        Ok(())
    }

    fn watchdog(&mut self) -> Result<(), Error> {
        say("hanging the board until its watchdog resets it: 4 s");
        let start = self.comes_back("to hang", Command::Measure(Measure::Hang))?;
        self.add([judge::restart("watchdog", "Reset by the watchdog", ResetCause::Watchdog, &start)])
    }

    fn update_mode(&mut self, args: &Args) -> Result<(), Error> {
        let skip = if args.without_dfu {
            Some("left out by --without-dfu")
        } else if !matches!(self.target, Target::Usb { .. }) {
            Some("only over the board's own USB connector")
        } else if !self.test.hello.capabilities.contains(Capabilities::DFU) {
            Some("the board cannot enter it on command")
        } else {
            None
        };
        if let Some(reason) = skip {
            return self.add([DFU, DOUBLE].map(|(name, label)| Check::skipped(name, label, reason)));
        }
        say("into update mode and back: Ctrl-C ends the test when the board is back");
        let visited = self.visit(true)?;
        self.add([there_and_back(DFU, visited)])?;
        if !terminal::can_ask() {
            return self.add([Check::skipped(DOUBLE.0, DOUBLE.1, "no terminal to ask for it")]);
        }
        say("press the board's reset button twice within half a second, in the next 15 s");
        let visited = self.visit(false)?;
        self.add([pressed(visited)])
    }

    /// Plays signals through the jumpers, if nothing else is connected to the pins.
    fn jumpers(&mut self, args: &Args) -> Result<(), Error> {
        let (name, label) = jumpers::CHECK;
        let reason = if !self.test.hello.capabilities.contains(Capabilities::PLAYER) {
            Some("the firmware cannot drive the outputs: update it")
        } else if !(args.rig_unplugged || jumpers::may_drive()?) {
            Some("a rig may be connected: unplug it, wire the jumpers, and give --rig-unplugged")
        } else {
            None
        };
        if let Some(reason) = reason {
            return self.add([Check::skipped(name, label, reason)]);
        }
        say("playing a simulated inerter through the jumpers: about a minute");
        let by_usb = |check: &Check| check.name == "clock_usb" && check.verdict != Verdict::Skipped;
        let clock_is_known = self.test.checks.iter().any(by_usb);
        let played = jumpers::play(self.device()?, clock_is_known);
        // The jumper test restores the settings itself if it can; the board's settings are read again afterwards.
        self.device = None;
        let (checks, measured) = played?;
        self.add(checks)?;
        let Some(Measured { skew_s, skew_u95_s }) = measured else { return Ok(()) };
        self.test.skew = Some(Skew { skew_s, skew_u95_s });
        say(format!(
            "skew_s = {skew_s:.3e}, skew_u95_s = {skew_u95_s:.1e}: of the board alone; the delay of an amplifier or a filter adds to it"
        ));
        if !args.write {
            return Ok(());
        }
        let with = |settings: &Settings| Settings { skew_s, skew_u95_s, ..*settings };
        self.before = with(&self.before);
        self.saved = Some(with(self.saved.as_ref().unwrap_or(&self.before)));
        self.has_saved = self.device()?.keeps_settings();
        Ok(())
    }

    /// Enters update mode and returns; an error ends the test only if the user interrupts it.
    fn visit(&mut self, enter: bool) -> Result<Result<Running, UpdateError>, Error> {
        self.device = None;
        let mut machine = ThisMachine::new(self.target.clone(), interrupted);
        let visited = visit(&mut machine, &self.test.hello, enter);
        if interrupted() {
            if let Err(error @ UpdateError::StaysInDfu { .. }) = &visited {
                note(with_help(error));
            }
            return Err(DeviceError::Interrupted.into());
        }
        Ok(visited)
    }

    /// Restores the settings in use and the saved settings; returns whether the board has them. Ctrl-C does not stop
    /// this.
    ///
    /// Streams stay off. The board does not report which streams were on, it has restarted since, and every host
    /// chooses its own.
    fn restore(&mut self) -> Result<bool, DeviceError> {
        let (before, saved, has_saved) = (self.before, self.saved, self.has_saved);
        // Wait for a board that is restarting. Waiting for one that has fallen silent would only delay the end.
        let patience = if self.device.take().is_some() { Duration::ZERO } else { RETURN };
        // Reconnect, so that the settings in use are read from the board, not from memory.
        let mut device = self.reached(patience, || false)?;
        device.stream(Streams::NONE)?;
        let kept = saved.unwrap_or(before);
        let saving =
            if has_saved { device.write_settings(&kept).and_then(|()| device.save_settings()) } else { Ok(()) };
        device.write_settings(&before)?;
        saving?;
        if has_saved && saved.is_none() {
            note("nothing was saved before: the settings that were in use are saved now");
        }
        drop(device);
        let mut device = self.reached(Duration::ZERO, || false)?;
        let is_kept = !has_saved || backup::changes(&kept, &device.saved_settings()?).is_empty();
        Ok(is_kept && backup::changes(&before, device.settings()).is_empty())
    }

    /// Reaches this board and no other, on whatever port it has now; tries for `patience`, and at least once.
    fn reached(&self, patience: Duration, interrupted: Interrupted) -> Result<Device, DeviceError> {
        let begun = Instant::now();
        loop {
            match Device::connect(&self.target, Clock::new(), interrupted) {
                Ok(device) if device.hello().serial == self.test.hello.serial => return Ok(device),
                Ok(device) if begun.elapsed() > patience => {
                    let reason = format!("another device (serial {}) answers", device.hello().serial);
                    return Err(DeviceError::Vanished { name: device.name().into(), reason, kept: String::new() });
                }
                Err(error) if !error.may_come_back() || begun.elapsed() > patience => return Err(error),
                Ok(_) | Err(_) => thread::sleep(RETRY),
            }
        }
    }
}

/// Names and labels of the visits to update mode.
const DFU: (&str, &str) = ("dfu", "Update mode and back");
const DOUBLE: (&str, &str) = ("double_reset", "Two presses of the reset button");

fn there_and_back((name, label): (&'static str, &'static str), visited: Result<Running, UpdateError>) -> Check {
    let found = if visited.is_ok() { "there and back" } else { "not back as before" };
    Check::words(name, label, "there and back", found, visited.err().as_ref().map(with_help))
}

/// The result of two presses of the button. If nobody presses it, that says nothing about the board.
fn pressed(visited: Result<Running, UpdateError>) -> Check {
    match visited {
        Err(UpdateError::DidNotAppear { seconds, .. }) => {
            let reason =
                format!("the button was not pressed twice within {seconds} s, or too slowly: start again to test it");
            Check::skipped(DOUBLE.0, DOUBLE.1, reason)
        }
        visited => there_and_back(DOUBLE, visited),
    }
}

/// The error with its help text.
fn with_help(error: &UpdateError) -> String {
    error.help().map_or_else(|| error.to_string(), |help| format!("{error}; {help}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_files_of_a_run_have_the_same_name() {
        for page in ["x.json", "X.JSON", "a/b.Json", "./x.json"] {
            let refused = json_of(Path::new(page));
            assert!(matches!(refused, Err(SelfTestError::SameName { .. })), "{page}: {refused:?}");
        }
        for page in
            ["x.html", "x", "x.toml", "x.settings.toml", "x.settings.2.toml", "x.json.html", "selftest.html", ".json"]
        {
            let page = Path::new(page);
            let json = json_of(page).unwrap();
            let backups = [SAVED, IN_USE].map(|ending| backup_of(Some(page), ending));
            let numbered = backups.each_ref().map(|path| path.with_extension("2.toml"));
            let names = [&[page.to_owned(), json][..], &backups, &numbered].concat();
            for (place, name) in names.iter().enumerate() {
                assert!(!names[..place].contains(name), "{names:?}");
            }
        }
        assert_eq!(backup_of(Some(Path::new("a/board.html")), SAVED), Path::new("a/board.settings.toml"));
        assert_eq!(backup_of(None, IN_USE), Path::new("selftest.in-use.toml"));
    }

    #[test]
    fn a_button_that_nobody_presses_is_not_tested() {
        let unpressed = UpdateError::DidNotAppear { serial: "1".into(), seconds: 15, others: vec!["2".into()] };
        let check = pressed(Err(unpressed));
        assert_eq!(check.verdict, Verdict::Skipped);
        assert!(check.reason.is_some_and(|reason| reason.contains("not pressed twice within 15 s")));
        let stays = || UpdateError::StaysInDfu { serial: "1".into(), reason: "the cable".into() };
        for check in [pressed(Err(stays())), there_and_back(DFU, Err(stays()))] {
            assert_eq!(check.verdict, Verdict::Fail);
            assert!(check.reason.is_some_and(|reason| reason.contains("press the board's reset button once")));
        }
        // A board that was told to enter update mode and did not has failed.
        let silent = UpdateError::DidNotAppear { serial: "1".into(), seconds: 15, others: Vec::new() };
        assert_eq!(there_and_back(DFU, Err(silent)).verdict, Verdict::Fail);
    }
}
