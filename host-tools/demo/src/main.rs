//! The demonstration: a simulated inerter on a shaker, measured by the firmware image in QEMU.
//!
//! The paper's device is moved as in the paper's three tests and by a random motion, then a worn one. Each run boots
//! the image again, shows the estimates as they come, records every frame, and replays the recording on this machine:
//! every estimate must be the same to the bit. It ends with a page for each run and an index of them. `cargo xtask
//! demo` builds what this needs; `--speed X` plays X times as fast, `--output FOLDER` writes there.

use std::{
    io::{IsTerminal, Write as _, stdout},
    path::{Path, PathBuf},
    process::ExitCode,
    time::{Duration, Instant},
};

use inerter_core::{Backlash, Estimate, Interval, Machine, Parameter, Status};
use inerter_data::{
    recording::{End, Recorder},
    replay::replay,
    settings::Overrides,
    text::value_text,
};
use inerter_device::live::{LinkEvent, Live};
use inerter_plant::Inerter;
use inerter_simulate::{Endpoint, Qemu, START_TIME, Setup, bench_sensors, find_image};
use inerter_view::{
    index::{self, Found, Listed},
    page::{self, Content},
};
use inerter_wire::{EventKind, Frame, Health, Record, Streams, catalogue};

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Lines of the live block: heading, four parameters, foot.
const BLOCK_LINES: usize = 6;
/// Between two drawings of the live block.
const DRAW_EVERY: Duration = Duration::from_millis(100);
/// Between two printed lines where there is no terminal, in seconds of the run.
const PRINT_EVERY_S: f64 = 10.0;

/// One run of the demonstration.
struct Test {
    name: &'static str,
    title: &'static str,
    device: Inerter,
    motion: &'static str,
    seconds: f64,
    speed: f64,
}

const fn test(name: &'static str, title: &'static str, device: Inerter, motion: &'static str) -> Test {
    Test { name, title, device, motion, seconds: 20.0, speed: 2.0 }
}

const TESTS: [Test; 5] = [
    Test { seconds: 80.0, speed: 8.0, ..test("slow", "0.053 Hz, 15.1 mm: friction", Inerter::paper(), "slow") },
    test("mid", "3.2 Hz, 4.16 mm: inertance", Inerter::paper(), "mid"),
    test("fast", "15.9 Hz, 0.806 mm: validation", Inerter::paper(), "fast"),
    test("random", "random, 0.5 to 15 Hz, 20 mm/s", Inerter::paper(), "random"),
    test("worn", "worn, 3.2 Hz, 4.16 mm: backlash", Inerter::worn(), "mid"),
];

/// What a run came to.
struct Outcome {
    estimate: Estimate,
    backlash: Option<Backlash>,
    recording: PathBuf,
    frames: u32,
    lost_frames: u64,
    health: Option<Health>,
    /// Whether the replay of the recording gave the same.
    same: bool,
}

impl Outcome {
    /// What the whole run shows of each parameter: its name, unit, true value, and value with interval.
    fn parameters(&self, device: &Inerter) -> Vec<(&'static str, &'static str, f64, Parameter)> {
        let law = catalogue::parameters(Machine::Linear, &self.estimate.whole_run).zip(truth(device));
        let backlash = self
            .backlash
            .iter()
            .map(|backlash| ("Backlash", "µm", MICRO * device.backlash_m, in_micrometres(backlash)));
        law.map(|((field, parameter), truth)| (field.label, field.unit, truth, parameter)).chain(backlash).collect()
    }
}

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<bool, Error> {
    let (mut speed, mut folder) = (1.0, PathBuf::from("target/demo"));
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), arguments.next()) {
            ("--speed", Some(value)) => {
                speed = value.parse().map_err(|_| format!("--speed: `{value}` is no number"))?
            }
            ("--output", Some(value)) => folder = value.into(),
            _ => return Err("usage: cargo xtask demo [--speed FACTOR] [--output FOLDER]".into()),
        }
    }
    std::fs::create_dir_all(&folder)
        .map_err(|error| format!("cannot make the folder {}: {error}", folder.display()))?;
    let image = find_image(None)?;
    let device = Inerter::paper();
    println!(
        "The paper's inerter, simulated: {} kg of effective inertance behind a screw with {} N of Coulomb and\n\
         {} N s/m of viscous friction. Its counts and force codes, 1000 a second with 1 N of noise, go into\n\
         {} on a Cortex-M4F in QEMU.",
        device.inertance_kg,
        device.coulomb_n,
        device.viscous_n_s_per_m,
        image.file_name().unwrap_or(image.as_os_str()).to_string_lossy(),
    );
    let mut outcomes = Vec::new();
    for (number, test) in TESTS.iter().enumerate() {
        println!("\n[{}/{}] {}", number + 1, TESTS.len(), test.title);
        outcomes.push(shake(test, speed, &image, &folder)?);
    }
    print!("{}", summary(&outcomes));
    println!("pages of the runs: {}", pages(&outcomes, &folder)?.display());
    Ok(outcomes.iter().all(|outcome| outcome.same && outcome.lost_frames == 0))
}

/// One run, from the boot of the image to the replay of its recording.
fn shake(test: &Test, speed: f64, image: &Path, folder: &Path) -> Result<Outcome, Error> {
    let speed = test.speed * speed;
    // Cut off in full motion: a stop would tell more about the inertance than the slow motion does.
    let setup = Setup::new(test.device, bench_sensors(), test.motion, Some(test.seconds), &Overrides::default())?;
    let mut qemu = Qemu::boot(image, &Endpoint::Tcp("127.0.0.1:0".into()), || false)?;
    let target = inerter_device::Target::Tcp { address: qemu.name().to_owned() };
    let alive = || Ok::<(), Error>(qemu.check()?);
    drop(inerter_device::Device::connect_starting(&target, START_TIME, &setup.settings, || false, alive)?);
    let mut live = Live::connect(target, Streams::ALL, Duration::ZERO, || false)?;

    let recording = folder.join(test.name).with_extension("mcap");
    let mut recorder = Recorder::create(&recording, true)?;
    if let Some(connected) = live.device() {
        recorder.describe(connected.hello(), connected.settings())?;
    }
    recorder.metadata(inerter_data::recording::TRUTH_METADATA, setup.truth())?;

    qemu.play(&setup, speed)?;
    let rate_hz = setup.settings.sample_rate_hz;
    let mut screen = Screen::new(test.seconds, &test.device);
    let (mut estimates, mut backlash, mut health, mut ended) = (Vec::new(), None, None, false);
    loop {
        let received = match live.next()? {
            LinkEvent::Received(received) => received,
            // The last raw samples may come after the event that says that there are no more.
            LinkEvent::Quiet if ended => break,
            LinkEvent::Quiet => {
                qemu.check()?;
                continue;
            }
            LinkEvent::Away { reason } => return Err(reason.into()),
            LinkEvent::Back => continue,
        };
        if !received.bytes.is_empty() {
            recorder.frame(received.time_ns, &received.bytes)?;
        }
        let Frame::Message { message, .. } = received.frame else { continue };
        match message {
            Record::Estimate(estimate) => {
                screen.show(f64::from(estimate.index) / rate_hz, &estimate, live.lost_frames(), false)?;
                estimates.push(estimate);
            }
            Record::Detail(detail) => backlash = Some(detail.backlash),
            Record::Health(now) => health = Some(now),
            Record::Event(event) => ended |= event.kind == EventKind::SourceEnded,
            _ => {}
        }
    }
    let lost_frames = live.lost_frames();
    let frames = recorder.frames();
    recorder.close(&End { reason: "finished".into(), lost_frames })?;
    let estimate = *estimates.last().ok_or("the image published no estimate")?;
    screen.show(test.seconds, &estimate, lost_frames, true)?;

    let same = replayed(&recording)? == estimates.iter().map(bits).collect::<Vec<_>>();
    println!(
        "      {frames} frames in {}, {lost_frames} lost; {} estimates, {}",
        recording.display(),
        estimates.len(),
        if same { "the same to the bit when replayed here" } else { "NOT THE SAME when replayed here" }
    );
    Ok(Outcome { estimate, backlash, recording, frames, lost_frames, health, same })
}

/// Writes a page for each run, and the one that lists them, which is returned.
fn pages(outcomes: &[Outcome], folder: &Path) -> Result<PathBuf, Error> {
    let mut listed = Vec::new();
    for (test, outcome) in TESTS.iter().zip(outcomes) {
        let content = Content::of(inerter_data::open(&outcome.recording, &Overrides::default())?, |_| {})?;
        let name = format!("{}.html", test.name);
        inerter_data::output::write(&folder.join(&name), true, &page::html(&content, &[]).0)?;
        let parameters = outcome.parameters(&test.device).into_iter().map(|(label, unit, truth, parameter)| Found {
            label: format!("{label}, {unit}"),
            value: value_text(&parameter),
            truth: truth.to_string(),
            holds: parameter.known().map(|found| holds(found, truth)),
        });
        listed.push(Listed { title: test.title.into(), page: name, parameters: parameters.collect() });
    }
    let meta = "A simulated inerter, measured by the firmware in QEMU. On average one interval in 20 misses the true value by chance.";
    let path = folder.join("index.html");
    inerter_data::output::write(&path, true, index::html("Five runs of the demo", meta, &listed))?;
    Ok(std::path::absolute(path)?)
}

/// Everything that the estimator publishes when the recording goes through it on this machine, and its last word.
fn replayed(recording: &Path) -> Result<Vec<Bits>, Error> {
    let run = inerter_data::open(recording, &Overrides::default())?;
    let mut published = Vec::new();
    let last = replay(&run, |_, estimate| -> Result<(), crate::Error> {
        published.push(bits(estimate));
        Ok(())
    })?;
    published.push(bits(&last.estimate));
    Ok(published)
}

/// An estimate to the bit: its index, and value, interval and status of each parameter.
type Bits = (u32, Vec<(u32, u32, Status)>);

fn bits(estimate: &Estimate) -> Bits {
    let parameters = [&estimate.recent, &estimate.whole_run]
        .into_iter()
        .flat_map(|parameters| catalogue::parameters(Machine::Linear, parameters));
    let bits = parameters.map(|(_, one)| (one.fitted().value.to_bits(), one.u95().to_bits(), one.status()));
    (estimate.index, bits.collect())
}

/// The truth, in the order of the catalogue's parameters.
fn truth(device: &Inerter) -> [f64; 4] {
    [device.inertance_kg, device.viscous_n_s_per_m, device.coulomb_n, 0.0]
}

/// Whether the interval covers the true value.
fn holds(found: Interval, truth: f64) -> bool {
    (f64::from(found.value) - truth).abs() <= f64::from(found.u95)
}

/// What the interval is worth, as the truth is known: one in twenty lies just beside it.
fn verdict(parameter: &Parameter, truth: f64) -> &'static str {
    match parameter.known() {
        None => "this motion cannot identify it",
        Some(found) if holds(found, truth) => "covers the true value",
        Some(Interval { value, u95 }) if holds(Interval { value, u95: 2.0 * u95 }, truth) => {
            "just misses the true value"
        }
        Some(_) => "MISSES THE TRUE VALUE",
    }
}

const MICRO: f64 = 1e6;

fn in_micrometres(backlash: &Backlash) -> Parameter {
    let micrometres = |length_m: f32| length_m * MICRO as f32;
    backlash.known().map_or(Parameter::default(), |Interval { value, u95 }| {
        Parameter::Ok(Interval { value: micrometres(value), u95: micrometres(u95) })
    })
}

/// The block that is redrawn while a run goes on, or lines where there is no terminal.
struct Screen {
    seconds: f64,
    truth: [f64; 4],
    terminal: bool,
    drawn: Option<Instant>,
    printed_s: f64,
}

impl Screen {
    fn new(seconds: f64, device: &Inerter) -> Self {
        let terminal = stdout().is_terminal();
        Self { seconds, truth: truth(device), terminal, drawn: None, printed_s: 0.0 }
    }

    /// Shows an estimate if it is time to, or if it is the last one.
    fn show(&mut self, run_s: f64, estimate: &Estimate, lost_frames: u64, is_last: bool) -> std::io::Result<()> {
        if self.terminal {
            if is_last || self.drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW_EVERY) {
                self.draw(run_s, estimate, lost_frames)?;
            }
        } else if is_last || run_s >= self.printed_s + PRINT_EVERY_S {
            self.printed_s = run_s;
            println!("      {run_s:5.1} s  {}", one_line(estimate));
        }
        Ok(())
    }

    fn draw(&mut self, run_s: f64, estimate: &Estimate, lost_frames: u64) -> std::io::Result<()> {
        let mut block = String::new();
        if self.drawn.is_some() {
            block += &format!("\x1b[{BLOCK_LINES}A");
        }
        let done = (40.0 * run_s / self.seconds) as usize;
        let bar: String = (0..40).map(|place| if place < done { '━' } else { '·' }).collect();
        block += &format!("\r      {run_s:5.1} s of {:.0} s  {bar}\x1b[K\n", self.seconds);
        for ((field, parameter), truth) in catalogue::parameters(Machine::Linear, &estimate.whole_run).zip(self.truth) {
            let color = if parameter.status() == Status::Ok { "\x1b[1m" } else { "\x1b[2m" };
            let value = value_text(&parameter);
            block +=
                &format!("      {:<20} {color}{value:<24}\x1b[0m {:<6} truth {truth}\x1b[K\n", field.label, field.unit);
        }
        block += &format!(
            "      {}, residual {:.2} N, {lost_frames} frames lost\x1b[K\n",
            if estimate.moving { "moving" } else { "at rest" },
            estimate.residual_rms_n
        );
        let mut out = stdout().lock();
        out.write_all(block.as_bytes())?;
        out.flush()?;
        self.drawn = Some(Instant::now());
        Ok(())
    }
}

fn one_line(estimate: &Estimate) -> String {
    catalogue::parameters(Machine::Linear, &estimate.whole_run)
        .map(|(field, parameter)| match parameter.status() {
            Status::NotIdentifiable => format!("{} -", field.symbol),
            _ => format!("{} {} {}", field.symbol, value_text(&parameter), field.unit),
        })
        .collect::<Vec<_>>()
        .join("   ")
}

/// The page at the end.
fn summary(outcomes: &[Outcome]) -> String {
    let rule = "─".repeat(92);
    let mut text = format!(
        "\n{rule}\nTruth, estimate of the firmware and its 95 % interval, from the whole of each run\n{rule}\n"
    );
    for (test, outcome) in TESTS.iter().zip(outcomes) {
        text += &format!("{}\n", test.title);
        for (label, unit, truth, parameter) in outcome.parameters(&test.device) {
            let value = value_text(&parameter);
            text += &format!("  {label:<20} {unit:<6} {truth:>9}   {value:<22} {}\n", verdict(&parameter, truth));
        }
    }
    let frames: u32 = outcomes.iter().map(|outcome| outcome.frames).sum();
    let lost: u64 = outcomes.iter().map(|outcome| outcome.lost_frames).sum();
    let same = outcomes.iter().filter(|outcome| outcome.same).count();
    text += &format!("{rule}\n");
    text += &format!("{frames} frames, {lost} lost; {same} of {} replays the same to the bit\n", outcomes.len());
    if let Some(free) = outcomes.iter().filter_map(|outcome| outcome.health?.stack_free_bytes).min() {
        text += &format!("stack of the image never used: {free} bytes\n");
    }
    text.push_str("recordings, each with its settings and truth:\n");
    for outcome in outcomes {
        text += &format!("  {}\n", outcome.recording.display());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_verdict_knows_the_truth() {
        let parameter = Parameter::Ok(Interval { value: 100.0, u95: 1.0 });
        assert_eq!(verdict(&parameter, 100.9), "covers the true value");
        assert_eq!(verdict(&parameter, 101.1), "just misses the true value");
        assert_eq!(verdict(&parameter, 102.1), "MISSES THE TRUE VALUE");
        assert_eq!(verdict(&Parameter::default(), 1.0), "this motion cannot identify it");
    }

    #[test]
    fn every_motion_is_known() {
        for test in &TESTS {
            let (sensors, seconds) = (bench_sensors(), Some(test.seconds));
            let setup = Setup::new(test.device, sensors, test.motion, seconds, &Overrides::default());
            assert!(setup.is_ok(), "{}", test.motion);
        }
    }
}
