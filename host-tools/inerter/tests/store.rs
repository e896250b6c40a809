//! A store from outside: several processes at once, damage of every kind, and stores that are none.

mod common;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use common::{Random, done, fails, inerter, json_lines, last, run, text};

/// A folder with two recordings.
fn recordings() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for seed in ["1", "2"] {
        let file = format!("{seed}.mcap");
        done(folder.path(), &["simulate", "--duration", "6", "--seed", seed, "-o", &file]);
    }
    folder
}

/// Files of the store, from its root.
fn files(store: &Path) -> BTreeSet<PathBuf> {
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

fn rows(folder: &Path) -> Vec<serde_json::Value> {
    json_lines(&done(folder, &["store", "ls", "s", "--json"]))
}

fn write(path: &Path, bytes: &[u8]) {
    // Sealed.
    fs::remove_file(path).ok();
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_run_says_what_a_replay_says_and_comes_back_as_it_was() {
    let folder = recordings();
    let folder = folder.path();
    let added = json_lines(&done(folder, &["store", "add", "s", "1.mcap", "2.mcap", "--json"]));
    assert_eq!(added.iter().filter(|added| added["new"] == true).count(), 2);
    let name = added[0]["run"].as_str().unwrap();
    let replayed = last(&done(folder, &["replay", "1.mcap", "--json"]));
    let row = last(&done(folder, &["store", "show", "s", &name[..8], "--json"]));
    for parameter in ["inertance", "viscous", "coulomb", "offset"] {
        let column = row.as_object().unwrap().keys().find(|key| key.starts_with(&format!("{parameter}_u95"))).unwrap();
        let field = column.replace("_u95", "");
        let to_f32 = |value: &serde_json::Value| value.as_f64().unwrap() as f32;
        assert_eq!(to_f32(&row[&field]), to_f32(&replayed["whole_run"][&field]["value"]), "{field}");
        assert_eq!(to_f32(&row[column]), to_f32(&replayed["uncertainty"][&field]["u95"]), "{column}");
        assert_eq!(row[format!("{parameter}_status")], replayed["whole_run"][&field]["status"]);
    }
    assert_eq!(row["law"], replayed["law"]["status"]);
    assert_eq!(row["settings"]["sample_rate_hz"], 1000.0);
    assert_eq!(
        row["truth"]["inertance_kg"].as_str().map(|text| text.parse().unwrap_or(0.0) > 100.0),
        Some(true),
        "{row}"
    );
    done(folder, &["store", "get", "s", &name[..8], "-o", "back.mcap"]);
    assert_eq!(fs::read(folder.join("back.mcap")).unwrap(), fs::read(folder.join("1.mcap")).unwrap());
    assert!(fails(folder, &["store", "get", "s", &name[..8], "-o", "back.mcap"], 8).contains("exists already"));
    // The list as CSV has a column for each value, and a line for each run.
    let csv = done(folder, &["store", "ls", "s", "--csv"]);
    let width: BTreeSet<usize> = csv.lines().map(|line| line.split(',').count()).collect();
    assert_eq!((csv.lines().count(), width.len()), (3, 1), "{csv}");
}

#[test]
fn a_recording_twice_is_one_run_and_conditions_choose() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let before = files(&folder.join("s"));
    fs::copy(folder.join("1.mcap"), folder.join("other name.mcap")).unwrap();
    let again = last(&done(folder, &["store", "add", "s", "other name.mcap", "--json"]));
    assert_eq!(again["new"], false);
    assert_eq!(files(&folder.join("s")), before);
    let mut values: Vec<f64> = rows(folder).iter().map(|row| row["inertance_kg"].as_f64().unwrap()).collect();
    values.sort_by(f64::total_cmp);
    let middle = format!("inertance_kg < {}", 0.5 * (values[0] + values[1]));
    let query =
        |more: &[&str]| json_lines(&done(folder, &[&["store", "query", "s"], more, &["--json"]].concat())).len();
    assert_eq!(query(&[&middle]), 1);
    assert_eq!(query(&[&middle, "law = holds"]), 1);
    assert_eq!(query(&["law = broken"]), 0);
    assert_eq!(query(&["samples = 6000", "--device", "SIM-2"]), 1);
    assert_eq!(query(&["samples = 6000", "--from", "1970-01-02"]), 0);
    assert_eq!(query(&["samples = 6000", "--to", "1970"]), 2);
    assert!(fails(folder, &["store", "query", "s", "inertance < 3"], 2).contains("did you mean inertance_kg?"));
    assert!(fails(folder, &["store", "query", "s", "inertance_kg is 3"], 2).contains("is no condition"));
    fails(folder, &["store", "ls", "s", "--from", "yesterday"], 2);
}

#[test]
fn eight_processes_lose_and_double_nothing() {
    let folder = recordings();
    let folder = folder.path();
    let add = |file: &str| inerter(folder, &["store", "add", "s", file]).spawn().unwrap();
    let adding: Vec<_> = (0..8).map(|number| add(if number % 2 == 0 { "1.mcap" } else { "2.mcap" })).collect();
    for child in adding {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    }
    assert_eq!(rows(folder).len(), 2);
    let stored = files(&folder.join("s"));
    assert_eq!(stored.len(), 13, "{stored:?}");
    done(folder, &["store", "verify", "s"]);
}

#[test]
fn a_kill_at_any_moment_leaves_no_half_run() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "2.mcap"]);
    let mut random = Random(5);
    let mut cut_off = 0;
    for _ in 0..12 {
        let mut child = inerter(folder, &["store", "add", "s", "1.mcap"]).spawn().unwrap();
        // Until something of it is there, or for a while.
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
        assert!(damages[..damages.len() - 1].iter().all(|damage| damage["problem"] == "unfinished"), "{damages:?}");
        assert!(there == 1 || damages.len() == 1, "a run that is there is whole: {damages:?}");
        cut_off += usize::from(there == 1);
        let added = last(&done(folder, &["store", "add", "s", "1.mcap", "--json"]));
        assert_eq!(added["new"], there == 1);
        done(folder, &["store", "verify", "s"]);
        done(folder, &["store", "remove", "s", added["run"].as_str().unwrap(), "--yes"]);
        assert_eq!(rows(folder).len(), 1);
    }
    assert!(cut_off > 0, "no kill came before the end");
}

#[test]
fn verify_finds_a_flipped_byte_in_each_file_and_tidy_what_is_left() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap"]);
    let store = folder.join("s");
    let all: Vec<PathBuf> = files(&store).into_iter().filter(|file| file.components().count() > 1).collect();
    assert_eq!(all.len(), 6, "{all:?}");
    for file in &all {
        let whole = fs::read(store.join(file)).unwrap();
        let mut flipped = whole.clone();
        let middle = flipped.len() / 2;
        flipped[middle] ^= 1;
        write(&store.join(file), &flipped);
        let output = run(folder, &["store", "verify", "s", "--json"]);
        assert_eq!(output.status.code(), Some(3), "{file:?}: {}", text(&output.stdout));
        write(&store.join(file), &whole);
        fs::remove_file(store.join(file)).unwrap();
        let missing = run(folder, &["store", "verify", "s", "--json"]);
        assert_eq!(missing.status.code(), Some(3), "{file:?} is gone: {}", text(&missing.stdout));
        write(&store.join(file), &whole);
        done(folder, &["store", "verify", "s"]);
    }
    let recording = all.iter().find(|file| file.starts_with("recordings")).unwrap();
    let mut bytes = fs::read(store.join(recording)).unwrap();
    bytes[1000] ^= 1;
    write(&store.join(recording), &bytes);
    let name = recording.file_stem().unwrap().to_str().unwrap();
    assert!(fails(folder, &["store", "get", "s", name, "-o", "back.mcap"], 3).contains("is not what was added"));
    assert!(!folder.join("back.mcap").exists());
    // Without its row it is no run, and is tidied away.
    fs::remove_file(store.join(all.iter().find(|file| file.starts_with("runs")).unwrap())).unwrap();
    assert!(rows(folder).is_empty());
    done(folder, &["store", "verify", "s", "--tidy"]);
    assert_eq!(files(&store).len(), 1);
}

#[test]
fn what_is_no_store_or_no_recording_is_told_with_what_to_do() {
    let folder = recordings();
    let folder = folder.path();
    assert!(fails(folder, &["store", "ls", "s"], 3).contains("there is no store at s"));
    assert!(!folder.join("s").exists());
    assert!(fails(folder, &["store", "add", ".", "1.mcap"], 8).contains("holds files, but no store"));
    assert!(fails(folder, &["store", "add", "ftp://x/y", "1.mcap"], 2).contains("no such kind of store"));
    done(folder, &["export", "1.mcap", "--csv", "run.csv"]);
    fs::write(folder.join("broken.mcap"), &fs::read(folder.join("1.mcap")).unwrap()[..300]).unwrap();
    assert!(fails(folder, &["store", "add", "s", "run.csv"], 3).contains("run.csv is no recording"));
    assert!(fails(folder, &["store", "add", "s", "nothing.mcap"], 3).contains("nothing.mcap"));
    // The others go in.
    let words = fails(folder, &["store", "add", "s", "run.csv", "broken.mcap", "1.mcap"], 3);
    assert!(words.contains("2 of 3 recordings were not added") && words.contains("run.csv is no recording"), "{words}");
    assert_eq!(rows(folder).len(), 1);
    let name = rows(folder)[0]["run"].as_str().unwrap().to_owned();
    assert!(fails(folder, &["store", "show", "s", "zz"], 3).contains("has no run zz"));
    assert!(fails(folder, &["store", "show", "s", ""], 3).contains("has no run"));
    assert!(fails(folder, &["store", "remove", "s", &name], 2).contains("needs a yes"));
    assert!(fails(folder, &["store", "remove", "s", &name, "zz", "--yes"], 3).contains("has no run zz"));
    assert_eq!(rows(folder).len(), 1);
    write(&folder.join("s/inerter-store.json"), br#"{"kind":"inerter-store","version":99}"#);
    for command in [&["store", "ls", "s"][..], &["store", "add", "s", "2.mcap"], &["store", "verify", "s"]] {
        assert!(fails(folder, command, 3).contains("version 99"));
    }
    write(&folder.join("s/inerter-store.json"), b"[]");
    assert!(fails(folder, &["store", "ls", "s"], 3).contains("does not say which version"));
}

#[test]
fn a_place_that_cannot_be_written_is_told_and_no_run_is_there() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap"]);
    fs::write(folder.join("s/events/device=SIM-2"), "in the way").unwrap();
    let words = fails(folder, &["store", "add", "s", "2.mcap"], 8);
    assert!(words.contains("events/device=SIM-2/") && words.contains("cannot be written"), "{words}");
    assert_eq!(rows(folder).len(), 1);
    fs::remove_file(folder.join("s/events/device=SIM-2")).unwrap();
    done(folder, &["store", "add", "s", "2.mcap"]);
    done(folder, &["store", "verify", "s"]);
}
