//! The monitor's load while it shows and records 4 kHz: processor time, memory, and losses.
//!
//! A virtual device runs in real time, `inerter monitor --record` draws on a pseudo-terminal of `script` (util-linux),
//! and `/proc` reports what it used. The figures apply to this machine under its present load.

use crate::{
    process,
    table::{self, Row},
    workspace,
};
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

/// The monitor's recording.
const RECORDING: &str = "run.mcap";
/// Samples per second of the device.
pub const RATE_HZ: f64 = 4000.0;
/// Samples of the time asked for that a recording may lack \[%\]: it begins when all views are open, which may take half
/// a second of a short run.
pub const MOST_MISSING: f64 = 5.0;
/// Time after which memory has settled: buffers have been filled once \[s\].
pub const SETTLED_S: f64 = 60.0;
/// Clock ticks per second in `/proc`, on every Linux that runs here.
pub const TICKS_HZ: f64 = 100.0;
/// Bytes of a page in `/proc/PID/statm`, on x86-64 and most others.
const PAGE_BYTES: f64 = 4096.0;

#[derive(clap::Args)]
pub struct Options {
    /// How long, in minutes
    #[arg(long, default_value_t = 10.0)]
    minutes: f64,
    /// Write docs/tables/monitor-load.md
    #[arg(long)]
    update: bool,
}

/// A program that is killed when dropped.
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Both fail only if it has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// One measurement of a process.
#[derive(Clone, Copy)]
pub struct Look {
    pub at_s: f64,
    pub processor_s: f64,
    pub memory_mb: f64,
}

pub fn run(options: &Options) -> Result<()> {
    ensure!(cfg!(target_os = "linux"), "this reads /proc: it runs on Linux only");
    let program = workspace::installed()?;
    let folder = workspace::folder("monitor-load")?;
    let (_device, address) = device(&program)?;
    let seconds = options.minutes * 60.0;
    let (looks, drawn_bytes) = watch(&program, &address, &folder, seconds)?;
    let info = info(&program, &folder, RECORDING)?;
    let samples = info["samples"].as_f64().unwrap_or(0.0);
    ensure!(
        samples >= (1.0 - MOST_MISSING / 100.0) * RATE_HZ * seconds,
        "the monitor recorded only {samples} samples in {seconds} s"
    );
    let rows = rows(&looks, &info, drawn_bytes)?;
    let missed = table::missed(&rows);
    let table = table::Table {
        name: "monitor-load",
        title: "The monitor at 4 kHz",
        about: format!(
            "`inerter monitor --record` runs for {:.0} min on a pseudo-terminal of 140 by 45 characters. It is\n\
             connected to a virtual device that streams every sample at 4 kHz, estimates, sums and health in\n\
             real time. The program is the one that is installed. Processor time and memory are those of the\n\
             monitor, from /proc. Lost samples and frames are counted in its recording. Figures of time are of\n\
             one machine that also had other work, so `cargo xtask test` does not compare them.",
            options.minutes
        ),
        rows,
        repeats: false,
    };
    table.print();
    if options.update {
        table.write()?;
    }
    ensure!(missed.is_empty(), "goals missed: {missed}");
    Ok(())
}

/// The output of `inerter info` for a recording.
pub fn info(program: &Path, folder: &Path, name: &str) -> Result<Value> {
    let info = process::output(Command::new(program).current_dir(folder).args(["info", name, "--json"]))?;
    serde_json::from_str(info.trim()).context("`inerter info --json` printed no JSON")
}

/// Time between the arrivals of a recording's first frame and its last \[s\], by the steady clock of the recording
/// program. Unlike `duration_s`, it does not come from the device's counter of samples.
pub fn host_s(info: &Value) -> Result<f64> {
    let time_ns =
        |name: &str| info[name].as_u64().with_context(|| format!("no time `{name}` in the output of `inerter info`"));
    let span_ns = time_ns("last_ns")?.checked_sub(time_ns("first_ns")?);
    Ok(span_ns.context("a recording ends before it begins")? as f64 * 1e-9)
}

/// A virtual device in motion, and its address.
pub fn device(program: &Path) -> Result<(Running, String)> {
    let rate = RATE_HZ.to_string();
    simulated(program, &["--sample-rate-hz", &rate, "--backlash-m", "5e-5"])
}

/// A simulated device with these options, and its address.
pub fn simulated(program: &Path, options: &[&str]) -> Result<(Running, String)> {
    let mut command = Command::new(program);
    command.args(["simulate", "--tcp", "127.0.0.1:0", "--json"]).args(options);
    let (running, line) = announced(&mut command)?;
    let ready: Value = serde_json::from_str(&line).with_context(|| format!("the simulated device printed: {line}"))?;
    let address = ready["address"].as_str().with_context(|| format!("no address in: {line}"))?.to_owned();
    Ok((running, address))
}

/// Starts a device, and returns the line that it prints once it can be reached.
pub fn announced(command: &mut Command) -> Result<(Running, String)> {
    let mut child = process::spawn(command.stdin(Stdio::null()).stdout(Stdio::piped()))?;
    let output = child.stdout.take().context("no pipe to the device")?;
    let running = Running(child);
    let mut line = String::new();
    BufReader::new(output).read_line(&mut line).context("the device's address cannot be read")?;
    ensure!(!line.is_empty(), "the device ended before it printed its address");
    Ok((running, line.trim().to_owned()))
}

/// Runs the monitor; returns what it used over time, and the bytes it drew.
fn watch(program: &Path, address: &str, folder: &Path, seconds: f64) -> Result<(Vec<Look>, f64)> {
    let (pid_file, drawn) = (folder.join("pid"), folder.join("drawn"));
    let _ = fs::remove_file(&pid_file);
    let quoted = |path: &Path| format!("'{}'", path.display());
    let shell = format!(
        "stty cols 140 rows 45; echo $$ > {}; exec {} monitor --connect {address} --record {} --force --duration {seconds}",
        quoted(&pid_file),
        quoted(program),
        quoted(&folder.join(RECORDING))
    );
    let script = Command::new("script")
        .args(["--quiet", "--flush", "--return", "--command", &shell])
        .arg(&drawn)
        .env("TERM", "xterm-256color")
        // It reads keys for as long as its input is open.
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn();
    let mut script = Running(script.context("cannot start `script` (on Debian: package bsdutils)")?);
    let started = Instant::now();
    let process = loop {
        if let Some(pid) = fs::read_to_string(&pid_file).ok().and_then(|text| text.trim().parse::<u32>().ok()) {
            break PathBuf::from(format!("/proc/{pid}"));
        }
        ensure!(started.elapsed() <= Duration::from_secs(10), "the monitor did not start");
        thread::sleep(Duration::from_millis(50));
    };
    let mut looks = Vec::new();
    let every = Duration::from_secs_f64((seconds / 100.0).clamp(0.5, 5.0));
    let status = loop {
        if let Some(status) = script.0.try_wait().context("waiting for the monitor")? {
            break status;
        }
        let is_late = started.elapsed().as_secs_f64() > seconds + 60.0;
        ensure!(!is_late, "the monitor was still running a minute after its end");
        // The process may end between two measurements.
        looks.extend(look(&process, started));
        thread::sleep(every);
    };
    ensure!(status.success(), "the monitor failed ({status}); its output is in {}", drawn.display());
    let drawn = fs::metadata(&drawn).with_context(|| format!("cannot read {}", drawn.display()))?;
    Ok((looks, drawn.len() as f64))
}

/// Processor time and resident memory of a process; `None` once it has ended.
pub fn look(process: &Path, started: Instant) -> Option<Look> {
    let stat = fs::read_to_string(process.join("stat")).ok()?;
    let memory = fs::read_to_string(process.join("statm")).ok()?;
    let (ticks, pages) = (ticks(&stat)?, memory.split_whitespace().nth(1)?.parse::<f64>().ok()?);
    (pages > 0.0).then(|| Look {
        at_s: started.elapsed().as_secs_f64(),
        processor_s: ticks / TICKS_HZ,
        memory_mb: pages * PAGE_BYTES / 1e6,
    })
}

/// User and system time from `/proc/PID/stat`; the name before them may contain any characters.
pub fn ticks(stat: &str) -> Option<f64> {
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    Some(fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?)
}

fn rows(looks: &[Look], info: &Value, drawn_bytes: f64) -> Result<Vec<Row>> {
    let (first, last) = looks.first().zip(looks.last()).context("the monitor ended before it could be measured")?;
    let processor = (last.processor_s - first.processor_s) / (last.at_s - first.at_s).max(1e-3) * 100.0;
    let settled: Vec<&Look> = looks.iter().filter(|look| look.at_s >= SETTLED_S.min(last.at_s / 2.0)).collect();
    let grown = settled.first().zip(settled.last()).map_or(f64::NAN, |(first, last)| last.memory_mb - first.memory_mb);
    let most = looks.iter().map(|look| look.memory_mb).fold(0.0, f64::max);
    let number = |name: &str| table::number(info, name, "the output of `inerter info`");
    let (samples, seconds) = (number("samples")?, host_s(info)?);
    Ok(vec![
        Row::new("samples recorded", samples, ""),
        // A device that runs late would be easy to keep up with.
        Row::new("samples too few or too many for 4 kHz", (RATE_HZ * seconds - samples).abs().round(), "")
            .at_most((RATE_HZ * 0.01 * seconds).round()),
        Row::new("samples lost", number("lost_samples")?, "").at_most(0.0),
        Row::new("discontinuities", number("discontinuities")?, "").at_most(0.0),
        Row::new("frames lost", number("lost_frames")?, "").at_most(0.0),
        Row::new("processor time, of one core", processor, "%").at_most(30.0),
        Row::new("memory, maximum", most, "MB"),
        Row::new("memory, growth after the first minute", (grown * 10.0).round() / 10.0, "MB").at_most(2.0),
        Row::new("output to the terminal", drawn_bytes / 1e3 / last.at_s, "kB/s"),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_processor_time_is_found_behind_any_name() {
        let stat = "7 (a) b (c)) S 1 7 7 0 -1 4194560 900 0 0 0 123 45 0 0 20 0 3 0 55 1 2";
        assert_eq!(ticks(stat), Some(168.0));
        assert_eq!(ticks("nothing"), None);
    }

    #[test]
    fn memory_that_grows_and_frames_that_were_lost_miss_their_goals() {
        let looks: Vec<Look> = (0..100)
            .map(|place| f64::from(place) * 5.0)
            .map(|at_s| Look { at_s, processor_s: at_s * 0.1, memory_mb: 20.0 + at_s * 0.1 })
            .collect();
        let info = |samples: u64| {
            json!({
                "samples": samples, "duration_s": samples as f64 / RATE_HZ, "first_ns": 1_000_000_000_u64,
                "last_ns": 501_000_000_000_u64, "lost_samples": 0, "discontinuities": 0, "lost_frames": 3,
            })
        };
        let of = |samples: u64| rows(&looks, &info(samples), 1e6).unwrap();
        let rows = of(2_000_000);
        assert_eq!(table::missed(&rows), "frames lost, memory, growth after the first minute");
        // A device that is two percent late, and counts its samples without a gap.
        assert!(table::missed(&of(1_960_000)).starts_with("samples too few or too many for 4 kHz, "));
        let processor = rows.iter().find(|row| row.name == "processor time, of one core").unwrap();
        assert!((processor.value - 10.0).abs() < 1e-9);
    }
}
