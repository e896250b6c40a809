//! Stores of recordings, and kills of the command that adds to one.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use inerter_needs::Random;
use serde_json::Value;

use super::{done, inerter, json_lines, last, run, text};

/// A folder with two recordings.
pub fn recordings() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for seed in ["1", "2"] {
        let file = format!("{seed}.mcap");
        done(folder.path(), &["simulate", "--duration", "6", "--seed", seed, "-o", &file]);
    }
    folder
}

/// Files of the store, relative to its root.
pub fn files(store: &Path) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    let mut folders = vec![store.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(store).unwrap().to_path_buf());
            }
        }
    }
    found
}

/// Rows of the store in this folder.
pub fn rows(folder: &Path) -> Vec<Value> {
    json_lines(&done(folder, &["store", "ls", "s", "--json"]))
}

/// Kills `store add` of the first of the recordings this often. Each time the store must hold the whole run or none of
/// it, and accept the run again. Returns how many kills left unfinished files.
pub fn kill_additions(folder: &Path, kills: u64, random: &mut Random) -> u64 {
    done(folder, &["store", "add", "s", "2.mcap"]);
    let mut unfinished = 0;
    for kill in 0..kills {
        let mut child = inerter(folder, &["store", "add", "s", "1.mcap"]).spawn().unwrap();
        // Until something of it exists, or for a while.
        let before = files(&folder.join("s"));
        for _ in 0..random.below(400) {
            if files(&folder.join("s")) != before && random.below(3) == 0 {
                break;
            }
            thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let there = rows(folder).len();
        let verified = run(folder, &["store", "verify", "s", "--json"]);
        let damages = json_lines(&text(&verified.stdout));
        let of_unfinished = damages[..damages.len() - 1].iter().all(|damage| damage["problem"] == "unfinished");
        assert!(of_unfinished, "kill {kill}: {damages:?}");
        assert!(there == 1 || damages.len() == 1, "kill {kill}: a run that is there is whole: {damages:?}");
        unfinished += u64::from(damages.len() > 1);
        if random.below(2) == 0 {
            done(folder, &["store", "verify", "s", "--repair"]);
        }
        let there = rows(folder).len();
        let added = last(&done(folder, &["store", "add", "s", "1.mcap", "--json"]));
        assert_eq!(added["new"], there == 1, "kill {kill}");
        done(folder, &["store", "verify", "s"]);
        done(folder, &["store", "remove", "s", added["run"].as_str().unwrap(), "--yes"]);
        assert_eq!(rows(folder).len(), 1, "kill {kill}");
    }
    unfinished
}
