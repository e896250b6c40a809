//! One campaign: its seed, its limit of time, and the line that it leaves.

use std::{
    fs::OpenOptions,
    io::{self, Write},
    thread,
    time::{Duration, Instant},
};

use inerter_data::settings::Overrides;
use inerter_plant::Inerter;
use inerter_simulate::{Endpoint, Setup, VirtualDevice, bench_sensors};

use crate::common::Random;

/// More than a live command holds at any device \[kB\].
pub const MOST_KB: u64 = 64_000;
/// Commands at once.
pub const AT_ONCE: usize = 10;

/// A campaign that runs.
pub struct Scenario {
    name: String,
    started: Instant,
    limit: Duration,
    pub seed: u64,
    /// How it is asked for again, beside its name and seed.
    options: String,
    passed: bool,
}

impl Scenario {
    /// The running test, which must be done within this.
    pub fn start(limit_s: u64) -> Self {
        let name = thread::current().name().unwrap_or("?").to_string();
        let name = name.rsplit("::").next().unwrap_or_default().to_string();
        let (seed, limit) = (number("SEED").unwrap_or(1), Duration::from_secs(limit_s));
        Self { name, started: Instant::now(), limit, seed, options: String::new(), passed: false }
    }

    /// How often each program is killed; other disturbances are as many, or a part of it.
    pub fn kills(&mut self) -> u64 {
        self.size("kills", 100)
    }

    /// How many hosts come and go.
    pub fn cycles(&mut self) -> u64 {
        self.size("cycles", 5000)
    }

    fn size(&mut self, option: &str, usual: u64) -> u64 {
        let size = number(&option.to_uppercase()).unwrap_or(usual);
        self.options = format!(" --{option} {size}");
        // The limit holds for the usual size, on a machine that has other work as well.
        self.limit = self.limit.mul_f64((size as f64 / usual as f64).max(1.0));
        size
    }

    /// Draws of its own for each part of the campaign.
    pub fn random(&self, part: &str) -> Random {
        let mixed = part.bytes().fold(self.seed, |mixed, byte| Random(mixed ^ u64::from(byte)).next());
        Random(mixed)
    }

    /// Notes that nothing went wrong, with the figures.
    pub fn passed(mut self, figures: &str) {
        let took = self.started.elapsed();
        assert!(
            took < self.limit,
            "{:.0} s, and no more than {:.0} s allowed",
            took.as_secs_f64(),
            self.limit.as_secs_f64()
        );
        self.passed = true;
        self.line("passed", figures);
    }

    /// Notes that this machine lacks what is needed.
    pub fn skipped(mut self, reason: &str) {
        self.passed = true;
        self.line("skipped", reason);
    }

    fn line(&self, outcome: &str, words: &str) {
        let line = format!("{}\t{outcome}\t{:.0}\t{words}\n", self.name, self.started.elapsed().as_secs_f64());
        // Not `print`: the harness swallows what a passing test prints.
        io::stderr().write_all(line.as_bytes()).ok();
        if let Some(report) = std::env::var_os("INERTER_CHAOS_REPORT") {
            let file = OpenOptions::new().create(true).append(true).open(report);
            file.and_then(|mut file| file.write_all(line.as_bytes())).expect("the report cannot be written");
        }
    }
}

impl Drop for Scenario {
    fn drop(&mut self) {
        if !self.passed {
            let again = format!("again: cargo xtask chaos {} --seed {}{}", self.name, self.seed, self.options);
            self.line("FAILED", &again);
        }
    }
}

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(format!("INERTER_CHAOS_{variable}")).ok().filter(|text| !text.is_empty())?;
    Some(text.parse().unwrap_or_else(|_| panic!("INERTER_CHAOS_{variable} is no number: {text}")))
}

/// A device of ours in motion, in this process.
pub fn device() -> VirtualDevice {
    let setup = Setup::new(Inerter::paper(), bench_sensors(), "random", None, &Overrides::default()).unwrap();
    VirtualDevice::start(&setup, &Endpoint::Tcp("127.0.0.1:0".into()), 1.0).unwrap()
}

/// Does something with each of these, some at once; the order in which they begin is theirs.
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
