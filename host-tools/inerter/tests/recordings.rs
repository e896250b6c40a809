//! Every command that reads a file, with every committed recording, complete and truncated: its exit code and output.
//!
//! `tests/recordings/output.txt` contains the exit code, the number of lines and the first words. `UPDATE_RECORDINGS=1
//! cargo test-lean --test program recordings` rewrites it. It contains no figures; other tests check these.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::common::{run, text};

/// One line per command. FILE is replaced by the recording, OUT by an output file.
const COMMANDS: [&str; 19] = [
    "info FILE",
    "info FILE --json",
    "replay FILE",
    "replay FILE --json",
    "fit FILE",
    "fit FILE --json",
    "identify FILE --json",
    "calibrate skew FILE",
    "calibrate stiffness FILE",
    "calibrate zero FILE",
    "calibrate load-cell FILE",
    "calibrate direction FILE",
    "export FILE --csv OUT.csv --parquet OUT.parquet --mat OUT.mat --mcap OUT.mcap --json",
    "cut FILE --from 0.5 --to 1 -o OUT.mcap",
    "merge FILE FILE -o OUT.mcap",
    "report FILE -o OUT.html",
    "plot FILE --figure force -o OUT.svg",
    "plot FILE --figure bode -o OUT.png",
    "settings diff FILE FILE",
];

fn tests() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests")
}

/// Name and content of each recording, and the first half of the largest one.
fn recordings() -> Vec<(String, Vec<u8>)> {
    let folders = ["recordings", "cmd/files.in", "cmd/recording.in"].map(|folder| tests().join(folder));
    let files = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()).map(|entry| entry.unwrap().path());
    let mut recordings: Vec<(String, Vec<u8>)> = files
        .filter(|path| path.extension().is_some_and(|extension| extension == "mcap"))
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
        .collect();
    recordings.sort();
    let largest = recordings.iter().max_by_key(|(_, bytes)| bytes.len()).unwrap().1.clone();
    recordings.push(("cut-off.mcap".into(), largest[..largest.len() / 2].to_vec()));
    recordings
}

/// The first words that a person reads, without figures.
fn first_words(text: &str) -> String {
    let line = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    let words = line.split(|c: char| c.is_ascii_digit()).next().unwrap_or_default();
    words.trim_end_matches(['-', '.', ' ', '±']).chars().take(60).collect()
}

#[test]
fn every_command_says_what_it_said_of_every_recording() {
    let mut said = String::new();
    for (name, bytes) in recordings() {
        for command in COMMANDS {
            let folder = tempfile::tempdir().unwrap();
            fs::write(folder.path().join(&name), &bytes).unwrap();
            let arguments: Vec<String> =
                command.split(' ').map(|word| word.replace("FILE", &name).replace("OUT", "out")).collect();
            let output = run(folder.path(), &arguments.iter().map(String::as_str).collect::<Vec<_>>());
            let (out, errors) = (text(&output.stdout), text(&output.stderr));
            let code = output.status.code();
            assert!(
                !errors.contains("panicked") && matches!(code, Some(0 | 3 | 4 | 8 | 9)),
                "{name}, {command}: {code:?} {errors}"
            );
            assert!(code == Some(0) || !errors.is_empty(), "{name}, {command}: failed without a word");
            assert!(
                command.contains("--json") || out.lines().all(|line| !line.contains("NaN")),
                "{name}, {command}: {out}"
            );
            let words = first_words(if code == Some(0) && !out.is_empty() { &out } else { &errors });
            said += &format!("{} | {command} | {} | {} | {words}\n", name, code.unwrap_or(-1), out.lines().count());
        }
    }
    let golden = tests().join("recordings/output.txt");
    if std::env::var_os("UPDATE_RECORDINGS").is_some() {
        fs::write(&golden, &said).unwrap();
    }
    let before = fs::read_to_string(&golden).unwrap();
    for (now, before) in said.lines().zip(before.lines()) {
        assert_eq!(now, before);
    }
    assert_eq!(said.lines().count(), before.lines().count());
}
