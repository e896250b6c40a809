//! Sends random streams to the whole device, for as long as requested.
//!
//! `fuzz [--minutes N] [--seed S]` tries streams from seed S on (default 0) for N minutes (default 1). It shrinks a
//! stream with a finding, writes it to `target/fuzz/SEED.bin`, prints the finding, and fails at the end. `fuzz --play
//! FILE...` tries files. `fuzz --write-corpus` rewrites `tests/corpus`.

use inerter_tests::{
    fuzz::{Conditions, findings, shrink, stream, write_corpus},
    grid::Result,
};
use std::{
    fs,
    path::PathBuf,
    time::{Duration, Instant},
};

const USAGE: &str = "usage: fuzz [--minutes N] [--seed S] | fuzz --play FILE... | fuzz --write-corpus";
/// Interval between two progress lines.
const PROGRESS: Duration = Duration::from_secs(10);

pub fn run(words: &[&str]) -> Result<bool> {
    match words {
        ["--write-corpus"] => {
            println!("{} streams written to tests/corpus", write_corpus()?);
            Ok(true)
        }
        ["--play", files @ ..] if !files.is_empty() => play(files),
        options => {
            let (mut minutes, mut seed) = (1.0, 0);
            for pair in options.chunks(2) {
                match pair {
                    ["--minutes", value] => minutes = value.parse::<f64>().map_err(|_| USAGE)?,
                    ["--seed", value] => seed = value.parse::<u64>().map_err(|_| USAGE)?,
                    _ => return Err(USAGE.into()),
                }
            }
            search(Duration::try_from_secs_f64(minutes * 60.0).map_err(|_| USAGE)?, seed)
        }
    }
}

fn play(files: &[&str]) -> Result<bool> {
    let mut good = true;
    for file in files {
        let bytes = fs::read(file).map_err(|error| format!("{file}: {error}"))?;
        let findings = findings(&bytes, &Conditions::PLAIN);
        good &= findings.is_empty();
        println!("{file}: {}", findings.first().map_or("as it should be", String::as_str));
    }
    Ok(good)
}

fn search(time: Duration, first: u64) -> Result<bool> {
    // A panic of the device is a finding, and its one line is enough.
    std::panic::set_hook(Box::new(|_| {}));
    let (start, mut told) = (Instant::now(), Instant::now());
    let (mut bytes, mut failures, mut seed) = (0, 0, first);
    while start.elapsed() < time {
        let stream = stream(seed).bytes;
        bytes += stream.len();
        let conditions = Conditions::of(seed);
        if let Some(finding) = findings(&stream, &conditions).first() {
            failures += 1;
            let file = save(seed, &shrink(&stream, |bytes| !findings(bytes, &conditions).is_empty()))?;
            println!("seed {seed}, {conditions:?}: {finding}\n  shrunk to {}", file.display());
        }
        seed += 1;
        if told.elapsed() >= PROGRESS {
            told = Instant::now();
            println!("{} streams, {bytes} bytes, {failures} failures", seed - first);
        }
    }
    println!("{} streams from seed {first}, {bytes} bytes, {failures} failures", seed - first);
    Ok(failures == 0)
}

fn save(seed: u64, bytes: &[u8]) -> Result<PathBuf, String> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/fuzz");
    let file = folder.join(format!("{seed}.bin"));
    fs::create_dir_all(&folder)
        .and_then(|()| fs::write(&file, bytes))
        .map_err(|error| format!("{}: {error}", file.display()))?;
    Ok(file)
}
