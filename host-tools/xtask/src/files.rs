//! Speed and memory of exporting a long recording, compared with a plain Python reader.

use crate::{
    monitor_load::{TICKS_HZ, ticks},
    process, python, tree, workspace,
};
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

/// Where the measured table is kept.
const TABLE: &str = "docs/tables/files.md";
/// Length of the recording \[s\], and its samples per second.
const DURATION_S: u64 = 3600;
const RATE_HZ: u64 = 4000;
/// Length of the part that the Python reader reads \[s\]: the whole recording would take minutes.
const PYTHON_S: u64 = 300;
/// Passes of each export; the best one counts.
const PASSES: usize = 2;
/// The goals: at most this many megabytes, and at least this many times faster.
const MEMORY_MB: f64 = 100.0;
const FASTER: f64 = 10.0;

#[derive(clap::Args)]
pub struct Options {
    /// Write docs/tables/files.md
    #[arg(long)]
    update: bool,
}

struct Measured {
    what: &'static str,
    /// Processor time of all threads together: other work on the machine does not count.
    seconds: f64,
    peak_mb: Option<f64>,
    output_mb: f64,
}

/// Measures, fails if a goal is missed, and writes the table if asked.
pub fn run(options: &Options) -> Result<()> {
    let python = python::files_environment()?;
    let inerter = workspace::installed()?;
    let folder = workspace::folder("files")?;
    println!("simulating {DURATION_S} s at {RATE_HZ} Hz into {}", folder.display());
    process::run(
        Command::new(&inerter)
            .args(["simulate", "--duration", &DURATION_S.to_string(), "--sample-rate-hz", &RATE_HZ.to_string()])
            .args(["--set", "terminal_sensor=1", "-o", "hour.mcap", "--force"])
            .stderr(Stdio::null())
            .current_dir(&folder),
    )?;
    let reader = || -> Result<f64> {
        let mut script = python::script(&python, "read_recording.py");
        script.args(["hour.mcap", &PYTHON_S.to_string()]).current_dir(&folder);
        let printed = process::output(&mut script)?;
        let read: Value = serde_json::from_str(&printed).context("the Python reader printed no JSON")?;
        let (samples, took) = (read["samples"].as_f64().unwrap_or(0.0), read["seconds"].as_f64().unwrap_or(0.0));
        ensure!(samples >= (PYTHON_S * RATE_HZ) as f64, "the Python reader found {samples} samples");
        Ok(took / samples * (DURATION_S * RATE_HZ) as f64)
    };
    // The fastest of as many passes, alternating with those of the exports: the machine may have other work.
    let (mut python_s, mut all) = (f64::INFINITY, Vec::<Measured>::new());
    for _ in 0..PASSES {
        python_s = python_s.min(reader()?);
        for (place, what) in ["csv", "parquet", "mat", "info"].into_iter().enumerate() {
            let found = measure(&inerter, &folder, what)?;
            println!("{what}: {:.2} s, {:.0} MB; Python {python_s:.1} s", found.seconds, found.peak_mb.unwrap_or(0.0));
            match all.get_mut(place) {
                None => all.push(found),
                Some(best) => {
                    best.seconds = best.seconds.min(found.seconds);
                    best.peak_mb = best.peak_mb.into_iter().chain(found.peak_mb).reduce(f64::max);
                }
            }
        }
    }
    let size_mb = fs::metadata(folder.join("hour.mcap"))?.len() as f64 / 1e6;
    let table = table(&all, python_s, size_mb);
    println!("\n{table}");
    if options.update {
        tree::write(TABLE, &table)?;
    }
    for Measured { what, seconds, peak_mb, .. } in &all {
        if peak_mb.is_some_and(|peak| peak >= MEMORY_MB) {
            bail!("{what} takes {peak_mb:?} MB, more than {MEMORY_MB}");
        }
        if ["csv", "parquet"].contains(what) && python_s / seconds < FASTER {
            bail!("{what} is only {:.1} times as fast as the Python reader", python_s / seconds);
        }
    }
    Ok(())
}

/// One run of the program: its time and its peak memory.
fn measure(inerter: &Path, folder: &Path, what: &'static str) -> Result<Measured> {
    let output = folder.join(format!("hour.{what}"));
    let mut command = Command::new(inerter);
    command.current_dir(folder).stdout(Stdio::null()).stderr(Stdio::null());
    match what {
        "info" => command.args(["info", "hour.mcap", "--json"]),
        _ => command.args(["export", "hour.mcap", "--force", &format!("--{what}")]).arg(&output),
    };
    let mut child = process::spawn(&mut command)?;
    let (mut peak_mb, mut seconds) = (None, None);
    let status = loop {
        peak_mb = peak(child.id()).or(peak_mb);
        seconds = processor_s(child.id()).or(seconds);
        if let Some(status) = child.try_wait()? {
            break status;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let seconds = seconds.context("this system does not report the processor time of a process: measure on Linux")?;
    ensure!(status.success(), "`{}` failed ({status})", process::shown(&command));
    let output_mb = fs::metadata(&output).map_or(0.0, |metadata| metadata.len() as f64 / 1e6);
    // Do not leave a gigabyte behind.
    fs::remove_file(&output).ok();
    Ok(Measured { what, seconds, peak_mb, output_mb })
}

/// Peak memory of a process so far, where the system reports it \[MB\].
fn peak(id: u32) -> Option<f64> {
    let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kilobytes| kilobytes * 1024.0 / 1e6)
}

/// Processor time of a process so far, where the system reports it \[s\].
fn processor_s(id: u32) -> Option<f64> {
    Some(ticks(&fs::read_to_string(format!("/proc/{id}/stat")).ok()?)? / TICKS_HZ)
}

fn table(all: &[Measured], python_s: f64, size_mb: f64) -> String {
    let mut text = format!(
        "# Exporting an hour at 4 kHz\n\n\
         Written by `cargo xtask bench-files --update` in one run on one machine, with the program as it is\n\
         installed. The recording has {} samples in {size_mb:.0} MB. The exports read it and write a\n\
         file; `info` only reads it. `tests/python/read_recording.py`, the Python reader, reads the first\n\
         {PYTHON_S} s; its time is scaled to the hour.\n\n\
         Time is the processor time of all threads together, the best of {PASSES} passes of each command,\n\
         taken in turn. Only the ratios carry over to other machines. Memory is the largest resident set\n\
         (`VmHWM`, read every 5 ms).\n\n\
         | command | faster than the Python reader | memory | output |\n\
         |---|--:|--:|--:|\n",
        DURATION_S * RATE_HZ,
    );
    for Measured { what, seconds, peak_mb, output_mb } in all {
        let command = if *what == "info" { "info".into() } else { format!("export --{what}") };
        let memory = peak_mb.map_or("not known".into(), |peak| format!("{peak:.0} MB"));
        let output = if *output_mb > 0.0 { format!("{output_mb:.0} MB") } else { String::new() };
        text += &format!("| `{command}` | {:.0} times | {memory} | {output} |\n", python_s / seconds);
    }
    text
}
