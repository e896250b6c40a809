//! A store from outside: several processes at once, damage of every kind, and folders that are no store.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Output,
    thread,
    time::Duration,
};

use inerter_data::{
    recording::{End, Recorder, TRUTH_METADATA},
    settings::Overrides,
};
use inerter_needs::Random;
use serde_json::{Value, json};

use crate::common::{
    self, done, fails, inerter, json_lines, last, run,
    stores::{files, kill_additions, recordings, rows},
    text,
};

fn write(path: &Path, bytes: &[u8]) {
    // The file is sealed, so replace it.
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
    // A friction that is indistinguishable from zero.
    done(folder, &["simulate", "--duration", "6", "--viscous-n-s-per-m", "0", "-o", "none.mcap"]);
    let none = last(&done(folder, &["store", "add", "s", "none.mcap", "--json"]));
    let none = last(&done(folder, &["store", "show", "s", none["run"].as_str().unwrap(), "--json"]));
    let replayed = last(&done(folder, &["replay", "none.mcap", "--json"]));
    assert_eq!(none["viscous_status"], "below_u95");
    assert_eq!(none["viscous_status"], replayed["whole_run"]["viscous_n_s_per_m"]["status"]);
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
    assert_eq!((csv.lines().count(), width.len()), (4, 1), "{csv}");
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
    assert!(fails(folder, &["store", "query", "s", "inertance_kg is 3"], 2).contains("is not a condition"));
    for day in ["yesterday", "2026-99-99"] {
        fails(folder, &["store", "ls", "s", "--from", day], 2);
    }
    // Not every run has every column.
    done(folder, &["simulate", "--duration", "6", "--set", "machine=1", "-o", "rotary.mcap"]);
    done(folder, &["store", "add", "s", "rotary.mcap"]);
    assert_eq!((query(&["inertia_kg_m2 > 0"]), query(&["inertance_kg > 0"])), (1, 2));
    assert!(done(folder, &["store", "ls", "s"]).contains("kg m²"));
    let columns = done(folder, &["store", "ls", "s", "--csv"]);
    let width: BTreeSet<usize> = columns.lines().map(|line| line.split(',').count()).collect();
    assert!(columns.contains("inertia_kg_m2") && columns.contains("inertance_kg") && width.len() == 1, "{columns}");
    assert!(fails(folder, &["store", "query", "s", "nonsense = 1", "--device", "nobody"], 2).contains("such a column"));
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
    assert_eq!(stored.len(), 15, "{stored:?}");
    done(folder, &["store", "verify", "s"]);
}

#[test]
fn a_kill_at_any_moment_leaves_no_half_run() {
    let folder = recordings();
    let unfinished = kill_additions(folder.path(), 12, &mut Random(5));
    assert!(unfinished > 0, "no kill left anything unfinished");
}

/// A store with the first recording: its folder, and the files in it.
fn added(folder: &Path) -> (PathBuf, Vec<PathBuf>) {
    done(folder, &["store", "add", "s", "1.mcap"]);
    let store = folder.join("s");
    let all = files(&store).into_iter().filter(|file| file.components().count() > 1).collect();
    (store, all)
}

#[test]
fn verify_finds_a_flipped_byte_in_each_file_and_repair_makes_whole_what_it_can() {
    let folder = recordings();
    let folder = folder.path();
    let (store, all) = added(folder);
    assert_eq!(all.len(), 7, "{all:?}");
    for file in &all {
        let whole = fs::read(store.join(file)).unwrap();
        let mut flipped = whole.clone();
        for place in [0, flipped.len() / 2, flipped.len() - 1] {
            flipped[place] ^= 1;
            write(&store.join(file), &flipped);
            let output = run(folder, &["store", "verify", "s", "--json"]);
            assert_eq!(output.status.code(), Some(3), "{file:?}, {place}: {}", text(&output.stdout));
        }
        fs::remove_file(store.join(file)).unwrap();
        let missing = run(folder, &["store", "verify", "s", "--json"]);
        assert_eq!(missing.status.code(), Some(3), "{file:?} is gone: {}", text(&missing.stdout));
        // All files except the recording are derived from it, byte for byte.
        let is_recording = file.starts_with("recordings");
        write(&store.join(file), if is_recording { &whole } else { &flipped });
        done(folder, &["store", "verify", "s", "--repair"]);
        assert!(fs::read(store.join(file)).unwrap() == whole, "{file:?}");
    }
    fs::write(store.join("runs/copy.parquet"), "").unwrap();
    assert!(text(&run(folder, &["store", "verify", "s"]).stdout).contains("foreign     runs/copy.parquet"));
    fs::remove_file(store.join("runs/copy.parquet")).unwrap();
    let recording = all.iter().find(|file| file.starts_with("recordings")).unwrap();
    let mut bytes = fs::read(store.join(recording)).unwrap();
    bytes[1000] ^= 1;
    write(&store.join(recording), &bytes);
    let name = recording.file_stem().unwrap().to_str().unwrap();
    assert!(fails(folder, &["store", "get", "s", name, "-o", "back.mcap"], 3).contains("differs from what was added"));
    assert!(!folder.join("back.mcap").exists());
    // A damaged recording must not be deleted, and adding an intact copy repairs it.
    assert_eq!(run(folder, &["store", "verify", "s", "--repair"]).status.code(), Some(3));
    assert!(store.join(recording).exists());
    assert_eq!(last(&done(folder, &["store", "add", "s", "1.mcap", "--json"]))["new"], true);
    done(folder, &["store", "verify", "s"]);
    done(folder, &["store", "remove", "s", name, "--yes"]);
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
    assert!(fails(folder, &["store", "add", "s", "run.csv"], 3).contains("run.csv is not a recording"));
    assert!(fails(folder, &["store", "add", "s", "nothing.mcap"], 3).contains("nothing.mcap"));
    // The others are added.
    let words = fails(folder, &["store", "add", "s", "run.csv", "broken.mcap", "1.mcap"], 3);
    assert!(
        words.contains("2 of 3 recordings were not added") && words.contains("run.csv is not a recording"),
        "{words}"
    );
    assert_eq!(rows(folder).len(), 1);
    let name = rows(folder)[0]["run"].as_str().unwrap().to_owned();
    assert!(fails(folder, &["store", "show", "s", "zz"], 3).contains("has no run zz"));
    assert!(fails(folder, &["store", "show", "s", ""], 3).contains("has no run"));
    assert!(fails(folder, &["store", "remove", "s", &name], 2).contains("needs confirmation"));
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

/// A folder of another user: the error names the file, and the folder stays unchanged.
#[cfg(unix)]
#[test]
fn a_folder_that_may_not_be_written_is_told_and_stays_as_it_was() {
    use std::os::unix::{fs::PermissionsExt, process::CommandExt};

    let folder = recordings();
    let folder = folder.path();
    let set = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    set(folder, 0o755);
    // Root may write everywhere, so the program runs as nobody.
    let nobody = rustix::process::getuid().is_root().then_some(65534);
    let as_another = |arguments: &[&str]| {
        let mut command = inerter(folder, arguments);
        if let Some(nobody) = nobody {
            command.uid(nobody).gid(nobody);
        }
        command.output()
    };
    if !as_another(&["--version"]).is_ok_and(|output| output.status.success()) {
        return inerter_needs::skip("user 65534 cannot start the program where it lies");
    }
    let refused = |arguments: &[&str], file: &str, action: &str| {
        let output = as_another(arguments).unwrap();
        let words = text(&output.stderr);
        assert_eq!(output.status.code(), Some(8), "{arguments:?}: {words}");
        assert!(words.contains(file) && words.contains(&format!("cannot be {action}: Permission denied")), "{words}");
        assert!(words.contains("help: ask for permission to this folder"), "{words}");
    };
    set(folder, 0o555);
    refused(&["store", "add", "s", "1.mcap"], "inerter-store.json in the store s ", "written");
    set(folder, 0o755);
    assert!(!folder.join("s").exists());

    let added = last(&done(folder, &["store", "add", "s", "1.mcap", "--json"]));
    let name = added["run"].as_str().unwrap();
    let before = files(&folder.join("s"));
    let row = before.iter().find(|file| file.starts_with("runs")).unwrap();
    let sealed = [folder.join("s/recordings"), folder.join("s").join(row.parent().unwrap())];
    sealed.iter().for_each(|path| set(path, 0o555));
    refused(&["store", "add", "s", "2.mcap"], "recordings/device=SIM-2/", "written");
    refused(&["store", "remove", "s", name, "--yes"], "runs/device=SIM-1/", "removed");
    sealed.iter().for_each(|path| set(path, 0o755));
    assert_eq!(files(&folder.join("s")), before);
    done(folder, &["store", "add", "s", "2.mcap"]);
    done(folder, &["store", "verify", "s"]);
}

#[test]
fn shards_do_each_run_once_and_keep_what_a_replay_says() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let replay = |more: &[&str]| {
        let kept = json_lines(&done(folder, &[&["replay", "--store", "s", "--json"], more].concat()));
        kept.iter().map(|kept| kept["run"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let mut parts: Vec<String> = (1..=3).flat_map(|part| replay(&["--shard", &format!("{part}/3")])).collect();
    parts.sort();
    let mut names: Vec<String> = rows(folder).iter().map(|row| row["run"].as_str().unwrap().to_owned()).collect();
    names.sort();
    assert_eq!(parts, names);
    // Existing results are not computed again unless requested.
    assert!(replay(&[]).is_empty());
    assert_eq!(replay(&["--again"]).len(), 2);
    let stiff = ["--batch", "stiff", "--set", "stiffness_n_per_m=5e6"];
    assert_eq!(replay(&stiff).len(), 2);
    let results: Vec<PathBuf> =
        files(&folder.join("s")).into_iter().filter(|file| file.starts_with("results")).collect();
    assert_eq!(results.len(), 4, "{results:?}");
    for file in &results {
        let row = last(&fs::read_to_string(folder.join("s").join(file)).unwrap());
        let is_stiff = file.starts_with("results/stiff");
        let recording = format!("{}.mcap", row["run"].as_str().unwrap());
        done(folder, &["store", "get", "s", row["run"].as_str().unwrap(), "-o", &recording, "--force"]);
        let more: &[&str] = if is_stiff { &stiff[2..] } else { &[] };
        let expected = last(&done(folder, &[&["replay", &recording, "--json"], more].concat()));
        assert_eq!(row["result"], expected, "{file:?}");
        assert_eq!(row["given"].to_string(), if is_stiff { r#"{"stiffness_n_per_m":5000000.0}"# } else { "{}" });
        assert!(row["error"].is_null());
    }
    assert!(fails(folder, &["replay", "--store", "s", "--set", "memory_s=5"], 2).contains("was made by"));
    assert!(fails(folder, &["replay", "--store", "s", "--batch", "../x"], 2).contains("cannot be the name of a batch"));
    fails(folder, &["replay", "--store", "s", "--shard", "4/3"], 2);
    // A failing run gets a row, and the others are processed. Its results are removed with the run.
    let recording = files(&folder.join("s")).into_iter().find(|file| file.starts_with("recordings")).unwrap();
    write(&folder.join("s").join(&recording), b"no recording");
    let words = fails(folder, &["replay", "--store", "s", "--batch", "half"], 3);
    assert!(words.contains("1 of 2 runs could not be replayed"), "{words}");
    let half = files(&folder.join("s")).into_iter().filter(|file| file.starts_with("results/half")).count();
    assert_eq!(half, 2);
    // It counts as processed.
    assert!(replay(&["--batch", "half"]).is_empty());
    fails(folder, &["replay", "--store", "s", "--batch", "half", "--again"], 3);
    names.iter().for_each(|name| drop(done(folder, &["store", "remove", "s", name, "--yes"])));
    assert_eq!(files(&folder.join("s")).len(), 1);
}

/// Damaged rows: each is reported, and does not hide the others.
#[test]
fn a_damaged_row_is_told_and_the_others_are_listed() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let all = files(&folder.join("s"));
    let row = folder.join("s").join(all.iter().find(|file| file.starts_with("rows")).unwrap());
    let name = row.file_stem().unwrap().to_str().unwrap().to_owned();
    let deep = "[".repeat(1 << 17);
    let far = "{\"law\":1e999,\"inertance_kg\":\"\u{1b}[2J\\nforged\"}";
    let mut random = Random(8);
    let whole = fs::read(&row).unwrap();
    let mut bad: Vec<Vec<u8>> =
        [b"".as_slice(), b"[]", deep.as_bytes(), far.as_bytes(), b"\xff\xfe"].map(Into::into).into();
    bad.extend((0..40).map(|_| {
        let mut bytes = whole.clone();
        let place = random.below(bytes.len());
        bytes[place] = random.below(256) as u8;
        bytes
    }));
    for bytes in bad {
        write(&row, &bytes);
        for command in
            [&["store", "ls", "s"][..], &["store", "ls", "s", "--csv"], &["store", "query", "s", "samples > 0"]]
        {
            let output = run(folder, command);
            let said = text(&output.stdout) + &text(&output.stderr);
            assert!([Some(0), Some(3)].contains(&output.status.code()), "{command:?}: {said}");
            assert_eq!(common::foreign_words(&said), None);
            assert!(output.status.code() == Some(0) || said.contains(&format!("{name}.json: changed")), "{said}");
            assert!(text(&output.stdout).lines().count() >= 2, "the other run: {said}");
        }
    }
    // The intact part remains available.
    write(&row, b"[]");
    done(folder, &["store", "get", "s", &name, "-o", "back.mcap"]);
    done(folder, &["store", "verify", "s", "--repair"]);
    assert_eq!(rows(folder).len(), 2);
}

/// Sets columns of the first run of the store `s` in this folder; returns the file of its row, and its name.
fn edited(folder: &Path, columns: &[(&str, Value)]) -> (PathBuf, String) {
    edited_at(folder, 0, columns)
}

/// The same of the run in this place.
fn edited_at(folder: &Path, place: usize, columns: &[(&str, Value)]) -> (PathBuf, String) {
    let all = files(&folder.join("s"));
    let file = folder.join("s").join(all.iter().filter(|file| file.starts_with("rows")).nth(place).unwrap());
    let mut row: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    for (name, value) in columns {
        row[*name] = value.clone();
    }
    write(&file, row.to_string().as_bytes());
    let name = file.file_stem().unwrap().to_str().unwrap().to_owned();
    (file, name)
}

#[test]
fn a_text_of_any_length_is_cut_in_a_table_and_whole_in_json_and_csv() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let long = "x".repeat(70_000);
    let (_, name) = edited(folder, &[("law", json!(long)), (long.as_str(), json!("y"))]);
    for command in [&["store", "ls", "s"][..], &["store", "query", "s", "samples > 0"], &["store", "show", "s", &name]]
    {
        let told = done(folder, command);
        assert!(told.contains("xxx...") && told.lines().all(|line| line.chars().count() < 600), "{command:?}: {told}");
    }
    let shown = last(&done(folder, &["store", "show", "s", &name, "--json"]));
    assert!(shown["law"] == json!(long) && shown[&long] == "y");
    assert!(rows(folder).contains(&shown));
    // The name of a column, and a cell.
    let csv = done(folder, &["store", "ls", "s", "--csv"]);
    assert_eq!((csv.lines().count(), csv.matches(&long).count()), (3, 2));
}

/// Neither a cell nor the name of a column is a formula to a spreadsheet, or forges a line.
#[test]
fn texts_in_a_csv_stay_texts() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let texts = [
        ("law", "=1+1", "'=1+1"),
        ("firmware", "+1", "'+1"),
        ("board", "-1", "'-1"),
        ("software", "@SUM(1)", "'@SUM(1)"),
        ("serial", "\t=1", r"\t=1"),
        ("causes", "a;=1", "a;'=1"),
        ("recorded_utc", "a\nforged,\"1\"", r#"a\nforged,"1""#),
    ];
    let mut columns = vec![("=cmd()\nforged,1", json!("a")), ("a\nforged", json!("b")), ("offset_n", json!(-3.5))];
    columns.push(("foreign", json!(["a;=1+1;b"])));
    columns.extend(texts.map(|(column, text, _)| (column, json!(text))));
    let (_, name) = edited(folder, &columns);
    let told = done(folder, &["store", "ls", "s", "--csv"]);
    assert_eq!((told.lines().count(), common::foreign_words(&told)), (3, None));
    let mut reader = csv::Reader::from_reader(told.as_bytes());
    let head = reader.headers().unwrap().clone();
    let all: Vec<csv::StringRecord> = reader.records().map(|record| record.unwrap()).collect();
    let row = all.iter().find(|row| row.iter().any(|cell| cell == name)).unwrap();
    let cell = |column: &str| row.get(head.iter().position(|one| one == column).unwrap()).unwrap();
    for (column, _, expected) in texts {
        assert_eq!(cell(column), expected, "{column}");
    }
    assert_eq!((cell(r"'=cmd()\nforged,1"), cell(r"a\nforged"), cell("offset_n")), ("a", "b", "-3.5"));
    assert_eq!(cell("foreign"), r#"["a;'=1+1;b"]"#);

    fs::copy(folder.join("1.mcap"), folder.join("=1+1.mcap")).unwrap();
    fs::write(folder.join("limits.toml"), "[offset_n]\nmin = -1000\nmax = 1000\n").unwrap();
    run(folder, &["replay", "=1+1.mcap", "--limits", "limits.toml", "--verdicts", "v.csv"]);
    let verdicts = fs::read_to_string(folder.join("v.csv")).unwrap();
    assert!(verdicts.contains("\n'=1+1.mcap,offset_n,") && verdicts.contains(",-1000,1000,"), "{verdicts}");
}

/// Runs the program, which must end within ten seconds.
fn soon(folder: &Path, arguments: &[&str]) -> Output {
    let mut child = inerter(folder, arguments).spawn().unwrap();
    let ended = (0..2000).any(|_| {
        thread::sleep(Duration::from_millis(5));
        child.try_wait().unwrap().is_some()
    });
    child.kill().ok();
    let output = child.wait_with_output().unwrap();
    assert!(ended, "{arguments:?} does not end");
    output
}

#[test]
fn a_row_that_is_too_long_is_told_and_not_read() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let (file, name) = edited(folder, &[("law", json!("x".repeat(300_000)))]);
    let before = fs::read(&file).unwrap();
    let assert_told = || {
        for command in [&["store", "ls", "s"][..], &["store", "query", "s", "samples > 0", "--csv"]] {
            let output = soon(folder, command);
            let words = text(&output.stderr);
            assert_eq!(output.status.code(), Some(3), "{words}");
            assert!(words.contains(&format!("{name}.json: oversized")), "{words}");
            assert_eq!(text(&output.stdout).lines().count(), 2, "the other run");
        }
        let output = soon(folder, &["store", "show", "s", &name]);
        let words = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{words}");
        assert!(words.contains(&format!("{name}.json in the store s is longer than 256 KB")), "{words}");
        assert!(words.contains("`inerter store verify s --repair`"), "{words}");
        assert!(words.contains("`inerter store remove`"), "{words}");
    };
    assert_told();
    assert!(fs::read(&file).unwrap() == before);
    // 64 GB that take no space on the disk, and that nobody reads to the end in this time. Windows would need the
    // space.
    if cfg!(unix) {
        const LENGTH: u64 = 1 << 36;
        write(&file, b"");
        fs::OpenOptions::new().write(true).open(&file).unwrap().set_len(LENGTH).unwrap();
        assert_told();
        assert_eq!(fs::metadata(&file).unwrap().len(), LENGTH);
        write(&file, &before);
    }
    done(folder, &["store", "verify", "s", "--repair"]);
    assert_eq!(rows(folder).len(), 2);
}

#[test]
fn a_row_of_too_many_columns_is_told_and_not_listed() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap"]);
    let names: Vec<String> = (0..512).map(|number| format!("own_{number}")).collect();
    let columns: Vec<(&str, Value)> = names.iter().map(|name| (name.as_str(), json!(1))).collect();
    let (_, name) = edited(folder, &columns);
    let output = run(folder, &["store", "ls", "s", "--csv"]);
    let (csv, words) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(3), "{words}");
    assert!(words.contains(&format!("{name}.json: oversized")), "{words}");
    assert!(csv.lines().count() == 2 && !csv.contains("own_"), "{csv}");
    assert!(fails(folder, &["store", "show", "s", &name], 3).contains("has more than 512 columns"));
    done(folder, &["store", "verify", "s", "--repair"]);
    assert_eq!(rows(folder).len(), 2);
}

#[test]
fn a_csv_of_too_many_columns_together_is_told_and_json_has_them() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["simulate", "--duration", "6", "--seed", "3", "-o", "3.mcap"]);
    done(folder, &["store", "add", "s", "1.mcap", "2.mcap", "3.mcap"]);
    let edit = |place: usize| {
        let names: Vec<String> = (0..400).map(|number| format!("own_{place}_{number}")).collect();
        let columns: Vec<(&str, Value)> = names.iter().map(|name| (name.as_str(), json!(1))).collect();
        edited_at(folder, place, &columns).1
    };
    let name = edit(0);
    edit(1);
    let head = |csv: &str| csv.lines().next().unwrap().split(',').count();
    let two = head(&done(folder, &["store", "ls", "s", "--csv"]));
    assert!((800..1024).contains(&two), "{two}");
    // With the third row's columns there are more than 1024.
    edit(2);
    fs::write(folder.join("limits.toml"), "[offset_n]\nmin = -1000\nmax = 1000\n").unwrap();
    for command in [
        &["store", "ls", "s", "--csv"][..],
        &["store", "query", "s", "samples > 0", "--csv", "--limits", "limits.toml", "--verdicts", "v.csv"],
    ] {
        let output = run(folder, command);
        let words = text(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{words}");
        assert!(
            words.contains("have more than 1024 different columns together") && words.contains("`--json`"),
            "{words}"
        );
        assert!(output.stdout.is_empty() && !folder.join("v.csv").exists(), "{command:?}");
    }
    // What the message says to do.
    let all = rows(folder);
    assert!(all.len() == 3 && all.iter().all(|row| row.as_object().unwrap().len() < 512));
    assert!(head(&done(folder, &["store", "query", "s", &format!("run = {name}"), "--csv"])) < 512);
}

#[test]
fn a_recording_whose_row_would_be_too_long_is_not_added() {
    let folder = recordings();
    let folder = folder.path();
    let run = inerter_data::open(&folder.join("1.mcap"), &Overrides::default()).unwrap();
    let mut recorder = Recorder::create(&folder.join("long.mcap"), false).unwrap();
    recorder.describe(&run.hello.clone().unwrap(), &run.settings).unwrap();
    for (sequence, part) in run.samples.chunks(8).enumerate() {
        let record = inerter_wire::Record::Samples(inerter_wire::Samples::from_slice(part).0);
        let mut frame = [0; inerter_wire::MAX_FRAME];
        let length = inerter_wire::encode_record(&record, sequence as u16, &mut frame).unwrap();
        recorder.frame(sequence as u64 * 1_000_000, frame.get(..length - 1).unwrap()).unwrap();
    }
    recorder.metadata(TRUTH_METADATA, [("inertance_kg".to_string(), "x".repeat(300_000))].into()).unwrap();
    recorder.close(&End { reason: String::new(), lost_frames: 0 }).unwrap();
    let words = fails(folder, &["store", "add", "s", "long.mcap"], 3);
    assert!(words.contains("long.mcap cannot be added: its row would be longer than 256 KB"), "{words}");
    assert!(!folder.join("s").exists());
    // The others are added.
    assert!(fails(folder, &["store", "add", "s", "long.mcap", "1.mcap"], 3).contains("1 of 2 recordings"));
    assert_eq!(rows(folder).len(), 1);
    done(folder, &["store", "verify", "s"]);
}

/// Pipes and links in the folder are not part of the store, and reading them might never end.
#[cfg(unix)]
#[test]
fn pipes_and_links_in_a_store_hang_nothing() {
    let folder = recordings();
    let folder = folder.path();
    done(folder, &["store", "add", "s", "1.mcap"]);
    let all = files(&folder.join("s"));
    for part in ["runs", "rows", "recordings"] {
        let file = folder.join("s").join(all.iter().find(|file| file.starts_with(part)).unwrap());
        let whole = fs::read(&file).unwrap();
        for odd in ["mkfifo", "ln -s /dev/zero"] {
            fs::remove_file(&file).unwrap();
            let words: Vec<&str> = odd.split(' ').collect();
            assert!(std::process::Command::new(words[0]).args(&words[1..]).arg(&file).status().unwrap().success());
            let name = all.iter().find(|file| file.starts_with("runs")).unwrap().file_stem().unwrap().to_str().unwrap();
            for command in [
                &["store", "ls", "s"][..],
                &["store", "verify", "s"],
                &["store", "show", "s", name],
                &["store", "get", "s", name, "-o", "back.mcap", "--force"],
                &["store", "verify", "s", "--repair"],
                &["store", "add", "s", "1.mcap"],
            ] {
                let mut child = inerter(folder, command).spawn().unwrap();
                let ended = (0..2000).any(|_| {
                    thread::sleep(Duration::from_millis(5));
                    child.try_wait().unwrap().is_some()
                });
                child.kill().ok();
                assert!(ended, "{command:?} with {odd} in {part} does not end");
            }
            // Adding the recording repaired it.
            assert!(fs::symlink_metadata(&file).unwrap().is_file() && fs::read(&file).unwrap() == whole, "{part}");
        }
    }
}

/// Remains of an earlier attempt or of another version of this program do not become part of a run.
#[test]
fn leftovers_with_other_bytes_are_written_anew() {
    let folder = recordings();
    let folder = folder.path();
    let (store, all) = added(folder);
    for file in &all {
        write(&store.join(file), b"left over");
    }
    fs::remove_file(store.join(all.iter().find(|file| file.starts_with("runs")).unwrap())).unwrap();
    assert_eq!(last(&done(folder, &["store", "add", "s", "1.mcap", "--json"]))["new"], true);
    done(folder, &["store", "verify", "s"]);
}

/// The output states what was judged, and judging nothing is no success.
#[test]
fn a_store_is_held_against_limits() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("limits.toml"), "[inertance_kg]\nmax = 310\n").unwrap();
    for (name, more) in [("linear.mcap", &[][..]), ("rotary.mcap", &["--set", "machine=1"])] {
        done(folder, &[&["simulate", "-o", name, "--duration", "5", "--seed", "7"], more].concat());
    }
    done(folder, &["store", "add", "store", "linear.mcap"]);
    assert!(done(folder, &["store", "ls", "store", "--limits", "limits.toml"]).contains("  pass"));
    let none = ["store", "query", "store", "machine = rotary", "--limits", "limits.toml"];
    assert!(fails(folder, &none, 10).contains("nothing was checked against the limits"));
    assert!(!done(folder, &["store", "query", "store", "machine = rotary", "--csv"]).contains("limits"));
    done(folder, &["store", "add", "store", "rotary.mcap"]);
    assert!(
        fails(folder, &["store", "ls", "store", "--limits", "limits.toml"], 4)
            .contains("did you mean `inertia_kg_m2`?")
    );
    done(folder, &["store", "query", "store", "machine = linear", "--limits", "limits.toml"]);
    std::fs::write(folder.join("wrong.toml"), "[coulomb]\nmax = 1\n").unwrap();
    assert!(
        fails(folder, &["store", "query", "store", "samples < 1", "--limits", "wrong.toml"], 4).contains("`coulomb_n`")
    );
    // A run added by an earlier version lacks some of the data that a verdict needs.
    let golden = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../python/tests/golden-store/store");
    let golden = golden.to_str().unwrap();
    let output =
        run(folder, &["store", "query", golden, "machine = linear", "--limits", "limits.toml", "--verdicts", "v.csv"]);
    assert_eq!(output.status.code(), Some(10));
    let rows = std::fs::read_to_string(folder.join("v.csv")).unwrap();
    assert_eq!(
        rows.matches(",undecided,,it was added by a version that did not count wrong samples").count(),
        2,
        "{rows}"
    );
}
