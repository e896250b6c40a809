//! One campaign: its seed, its limits of time and memory, and its line in the report.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    process::{self, Command},
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
    thread,
    time::{Duration, Instant},
};

use inerter_needs::Random;
use inerter_simulate::VirtualDevice;
use rustix::process::{Pid, Signal, kill_process};

use crate::common::{text, unruly::memory_kb, until};

/// More than a live command needs with any device \[kB\].
pub const MOST_KB: u64 = 64_000;
/// More than any program started by a campaign needs: twice the largest value seen (`slow_kills`) \[kB\].
const MOST_OF_ANY_KB: u64 = 256_000;
/// Number of concurrent commands.
pub const AT_ONCE: usize = 10;

/// A running campaign. It fails, and every process that it started is killed, if it takes too long or a program uses
/// too much memory.
pub struct Scenario {
    pub seed: u64,
    state: Arc<Mutex<State>>,
    passed: bool,
}

/// State shared by the campaign and its guard.
struct State {
    name: String,
    started: Instant,
    limit: Duration,
    most_kb: u64,
    /// Options that repeat it, besides its name.
    options: String,
    /// Most memory that the guard has seen in one program \[kB\].
    held_kb: u64,
}

impl Scenario {
    /// Starts a campaign for the running test, with this time limit.
    pub fn start(limit_s: u64) -> Self {
        Self::within(Duration::from_secs(limit_s), MOST_OF_ANY_KB)
    }

    fn within(limit: Duration, most_kb: u64) -> Self {
        let name = thread::current().name().unwrap_or("?").to_string();
        let name = name.rsplit("::").next().unwrap_or_default().to_string();
        let seed = number("SEED").unwrap_or(1);
        let options = format!(" --seed {seed}");
        let state = State { name, started: Instant::now(), limit, most_kb, options, held_kb: 0 };
        let state = Arc::new(Mutex::new(state));
        let guarded = Arc::downgrade(&state);
        thread::spawn(move || guard(&guarded));
        Self { seed, state, passed: false }
    }

    /// Number of kills per program. Other disturbances occur as often, or a fraction of it.
    pub fn kills(&mut self) -> u64 {
        self.size("kills", 100)
    }

    /// Number of hosts that connect and disconnect.
    pub fn cycles(&mut self) -> u64 {
        self.size("cycles", 5000)
    }

    fn size(&mut self, option: &str, usual: u64) -> u64 {
        let size = number(&option.to_uppercase()).unwrap_or(usual);
        let mut state = self.state();
        state.options += &format!(" --{option} {size}");
        // The limit applies to the usual size, on a machine with other load.
        state.limit = state.limit.mul_f64((size as f64 / usual as f64).max(1.0));
        size
    }

    /// Independent random numbers for each part of the campaign.
    pub fn random(&self, part: &str) -> Random {
        let mixed = part.bytes().fold(self.seed, |mixed, byte| Random(mixed ^ u64::from(byte)).draw());
        Random(mixed)
    }

    /// Records success, with its figures.
    pub fn passed(mut self, figures: &str) {
        self.passed = true;
        let state = self.state();
        state.line("passed", &format!("{figures}; no program used more than {} kB", state.held_kb));
    }

    /// Records that this machine lacks something.
    pub fn skipped(mut self, reason: &str) {
        self.passed = true;
        self.state().line("skipped", reason);
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Scenario {
    fn drop(&mut self) {
        if !self.passed {
            self.state().failed("");
        }
    }
}

impl State {
    fn line(&self, outcome: &str, words: &str) {
        let line = format!("{}\t{outcome}\t{:.0}\t{words}\n", self.name, self.started.elapsed().as_secs_f64());
        // Not `print`: the harness hides the output of passing tests.
        io::stderr().write_all(line.as_bytes()).ok();
        if let Some(report) = std::env::var_os("INERTER_CHAOS_REPORT") {
            let file = OpenOptions::new().create(true).append(true).open(report);
            file.and_then(|mut file| file.write_all(line.as_bytes())).expect("the report cannot be written");
        }
    }

    fn failed(&self, why: &str) {
        self.line("FAILED", &format!("{why}again: cargo xtask chaos {}{}", self.name, self.options));
    }

    /// The limit that is exceeded, if any.
    fn fault(&mut self) -> Option<String> {
        if self.started.elapsed() > self.limit {
            return Some(format!("still running after {:.0} s, ", self.limit.as_secs_f64()));
        }
        for pid in started_by(process::id()) {
            let held_kb = memory_kb(pid, "VmHWM:").unwrap_or(0);
            self.held_kb = self.held_kb.max(held_kb);
            if held_kb > self.most_kb {
                let words = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
                return Some(format!("`{}` held {held_kb} kB, ", text(&words).replace('\0', " ").trim_end()));
            }
        }
        None
    }
}

/// Watches time and memory until the campaign ends, or ends it.
fn guard(state: &Weak<Mutex<State>>) {
    while let Some(state) = state.upgrade() {
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(fault) = state.fault() {
            // Keep the lock, so that the campaign writes no second line when its programs end.
            state.failed(&fault);
            // Also end programs that are started in the meantime.
            for _ in 0..10 {
                let all = started_by(process::id());
                all.into_iter().filter_map(|pid| Pid::from_raw(pid as i32)).for_each(|pid| {
                    kill_process(pid, Signal::KILL).ok();
                });
                thread::sleep(Duration::from_millis(20));
            }
            process::exit(1);
        }
        drop(state);
        thread::sleep(Duration::from_millis(100));
    }
}

/// All direct and indirect child processes of this process.
fn started_by(pid: u32) -> Vec<u32> {
    let mut all = vec![pid];
    let mut next = 0;
    while let Some(pid) = all.get(next) {
        let threads = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
        let lists = threads.filter_map(|thread| fs::read_to_string(thread.path().join("children")).ok());
        let words = lists.collect::<String>();
        all.extend(words.split_whitespace().filter_map(|word| word.parse::<u32>().ok()));
        next += 1;
    }
    all.split_off(1)
}

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(format!("INERTER_CHAOS_{variable}")).ok().filter(|text| !text.is_empty())?;
    Some(text.parse().unwrap_or_else(|_| panic!("INERTER_CHAOS_{variable} is no number: {text}")))
}

/// A moving virtual device in this process.
pub fn device() -> VirtualDevice {
    crate::common::device(1.0)
}

/// Calls `act` with each element, `at_once` of them concurrently, in any order.
pub fn each<T: Sync>(all: &[T], at_once: usize, act: impl Fn(&T) + Sync) {
    let next = std::sync::atomic::AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(|| {
                while let Some(one) = all.get(next.fetch_add(1, std::sync::atomic::Ordering::Relaxed)) {
                    act(one);
                }
            });
        }
    });
}

/// Tells the program started by [`limits_are_kept`] which limit to exceed.
const EXCEEDS: &str = "INERTER_CHAOS_EXCEEDS";

/// A campaign that hangs, or whose program uses too much memory, is ended with all its processes, and reports the
/// reason.
#[test]
fn limits_are_kept() {
    let exceeding = |what: &str| {
        let folder = tempfile::tempdir().unwrap();
        let report = folder.path().join("report.tsv");
        let mut campaign = Command::new(std::env::current_exe().unwrap());
        campaign.args(["--exact", "scenario::exceeds", "--nocapture"]).current_dir(folder.path());
        for option in ["SEED", "KILLS"] {
            campaign.env_remove(format!("INERTER_CHAOS_{option}"));
        }
        let output = campaign.env(EXCEEDS, what).env("INERTER_CHAOS_REPORT", &report).output().unwrap();
        assert!(!output.status.success(), "{what}: {}", text(&output.stderr));
        let pid: u32 = fs::read_to_string(folder.path().join("pid")).unwrap().trim().parse().unwrap();
        assert_eq!(memory_kb(pid, "VmRSS:"), None, "{what}: its program goes on");
        fs::read_to_string(report).unwrap()
    };
    let again = "again: cargo xtask chaos exceeds --seed 1";
    for (what, why) in [("time", "\tstill running after 1 s, "), ("memory", "\t`tail -c 200000000` held ")] {
        let told = exceeding(what);
        assert!(told.starts_with("exceeds\tFAILED\t") && told.contains(why) && told.contains(again), "{told}");
        assert_eq!(told.lines().count(), 1, "{told}");
    }
}

/// The campaign that is ended; without the variable it does nothing.
#[test]
fn exceeds() {
    let Some(what) = std::env::var_os(EXCEEDS) else { return };
    let (work, limit_s, most_kb) = match what.to_str() {
        Some("time") => ("exec sleep 100", 1, MOST_OF_ANY_KB),
        _ => ("sleep 1; cat /dev/zero | tail -c 200000000", 60, 50_000),
    };
    let mut program = Command::new("sh").args(["-c", &format!("echo $$ > pid; {work}")]).spawn().unwrap();
    until("the program starts", || fs::read_to_string("pid").is_ok_and(|pid| pid.ends_with('\n')));
    let mut scenario = Scenario::within(Duration::from_secs(limit_s), most_kb);
    scenario.kills();
    program.wait().unwrap();
    thread::sleep(Duration::from_secs(100));
}
