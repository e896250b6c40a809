//! Every command that writes files and renames them when they are complete.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

use crate::{
    common::{all_are_tried, done, inerter, last, text},
    scenario::each,
};

/// Number of concurrent writers: each gets a processor.
const AT_ONCE: usize = 3;

/// A command and its cost.
pub struct Writer {
    pub command: &'static [&'static str],
    /// Whether it needs a device, whose address is appended.
    has_device: bool,
    /// Duration of a run, in runs of a typical writer.
    pub cost: u64,
}

const fn writer(command: &'static [&'static str]) -> Writer {
    Writer { command, has_device: false, cost: 1 }
}

/// Placeholder for the only run of a store.
const ONLY_RUN: &str = "RUN";

pub const WRITERS: &[Writer] = &[
    Writer { cost: 20, ..writer(&["reproduce-paper", "-o", "."]) },
    Writer { cost: 5, ..writer(&["report", "run.mcap", "-o", "page.html", "--png", "."]) },
    Writer { cost: 5, ..writer(&["compare", "run.mcap", "first.mcap", "-o", "beside.html", "--png", "."]) },
    Writer { cost: 2, ..writer(&["plan", "run.mcap", "-o", "plan.csv", "--wav", "plan.wav"]) },
    writer(&["simulate", "--duration", "20", "-o", "sim.mcap"]),
    writer(&["simulate", "--duration", "20", "-o", "sim.csv"]),
    writer(&["export", "run.mcap", "--csv", "e.csv", "--estimates"]),
    writer(&["export", "run.mcap", "--parquet", "e.parquet"]),
    writer(&["export", "run.mcap", "--mat", "e.mat"]),
    writer(&["export", "run.mcap", "--mcap", "e.mcap"]),
    writer(&["cut", "run.mcap", "-o", "cut.mcap"]),
    writer(&["merge", "first.mcap", "second.mcap", "-o", "both.mcap"]),
    writer(&["plot", "run.mcap", "--figure", "force", "-o", "force.svg"]),
    writer(&["plot", "run.mcap", "--figure", "loop", "-o", "loop.png"]),
    writer(&["replay", "run.mcap", "--limits", "limits.toml", "--junit", "r.xml", "--verdicts", "r.csv"]),
    writer(&["store", "ls", "store", "--limits", "limits.toml", "--junit", "s.xml", "--verdicts", "s.csv"]),
    writer(&["store", "query", "store", "duration_s > 1", "--limits", "limits.toml", "--verdicts", "q.csv"]),
    writer(&["store", "get", "store", ONLY_RUN, "-o", "got.mcap"]),
    writer(&["man", "-o", "."]),
    Writer { has_device: true, ..writer(&["settings", "backup", "board.toml"]) },
];

/// The output of an undisturbed writer.
pub struct Whole {
    pub files: BTreeMap<String, Vec<u8>>,
    pub took: Duration,
}

/// Contents of the earlier files with the same names.
pub const EARLIER: &[u8] = b"earlier";

impl Writer {
    /// The command with additional arguments.
    pub fn run(&self, folder: &Path, device: &str, more: &[&str]) -> Command {
        let link: &[&str] = if self.has_device { &["--connect", device] } else { &[] };
        let run = self.command.contains(&ONLY_RUN).then(|| last(&done(folder, &["store", "ls", "store", "--json"])));
        let run = run.as_ref().and_then(|row| row["run"].as_str()).unwrap_or(ONLY_RUN);
        let words = [self.command, link, more].concat();
        inerter(folder, &words.iter().map(|word| if *word == ONLY_RUN { run } else { word }).collect::<Vec<_>>())
    }

    /// Runs it to its end, twice: both outputs must be equal.
    fn whole(&self, folder: &Path, device: &str) -> Whole {
        let before = names(folder);
        let mut all = [(); 2].map(|()| {
            let started = Instant::now();
            let output = self.run(folder, device, &[]).output().unwrap();
            assert!(output.status.success(), "{:?}: {}", self.command, text(&output.stderr));
            let took = started.elapsed();
            let files = names(folder).into_iter().filter(|name| !before.contains(name));
            let files: BTreeMap<String, Vec<u8>> =
                files.map(|name| (name.clone(), fs::read(folder.join(name)).unwrap())).collect();
            files.keys().for_each(|name| fs::remove_file(folder.join(name)).unwrap());
            Whole { files, took }
        });
        assert!(all[0].files == all[1].files, "{:?} writes other bytes each time", self.command);
        all[1].took = all[1].took.max(all[0].took);
        let [_, whole] = all;
        whole
    }
}

impl Whole {
    /// Creates a file under each of the names.
    pub fn earlier(&self, folder: &Path) {
        self.files.keys().for_each(|name| fs::write(folder.join(name), EARLIER).unwrap());
    }

    /// Each file is complete, or as it was before. With `parts`, unfinished files may remain. Returns the number of
    /// complete files, and removes everything.
    pub fn check(&self, folder: &Path, before: &[String], was_there: bool, parts: bool, what: &str) -> usize {
        let mut whole = 0;
        let mut seen = 0;
        for name in names(folder).into_iter().filter(|name| !before.contains(name)) {
            let bytes = fs::read(folder.join(&name)).unwrap();
            match self.files.get(&name) {
                Some(expected) if *expected == bytes => (whole, seen) = (whole + 1, seen + 1),
                Some(_) if was_there && bytes == EARLIER => seen += 1,
                Some(_) => panic!("{what}: {} bytes under the name {name}", bytes.len()),
                None => assert!(parts && name.starts_with('.') && name.ends_with(".part"), "{what}: {name} is left"),
            }
            fs::remove_file(folder.join(name)).unwrap();
        }
        assert!(!was_there || seen == self.files.len(), "{what}: an earlier file is gone");
        whole
    }
}

/// Prepares the input files.
fn prepare(folder: &Path) {
    done(folder, &["simulate", "--duration", "10", "-o", "run.mcap"]);
    done(folder, &["store", "add", "store", "run.mcap"]);
    done(folder, &["cut", "run.mcap", "--to", "5", "-o", "first.mcap"]);
    done(folder, &["cut", "run.mcap", "--from", "5", "-o", "second.mcap"]);
    fs::write(folder.join("limits.toml"), "[inertance_kg]\nmin = 100\n").unwrap();
}

/// Calls `act` for each writer, in its own folder, with its output.
pub fn each_writer(device: &str, act: impl Fn(&Writer, &Path, &Whole) + Sync) {
    each_of(&WRITERS.iter().collect::<Vec<_>>(), device, act);
}

/// The same for some writers.
pub fn each_of(writers: &[&Writer], device: &str, act: impl Fn(&Writer, &Path, &Whole) + Sync) {
    each(writers, AT_ONCE, |writer| {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path());
        act(writer, folder.path(), &writer.whole(folder.path(), device));
    });
}

/// Names of the files in a folder, in order.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn every_command_that_writes_files_is_tried() {
    // The recorders and `store add` have their own campaigns, and a self-test needs a board that can measure itself.
    let others: [&[&str]; 3] = [&["record"], &["monitor"], &["selftest"]];
    let tried: Vec<&[&str]> = WRITERS.iter().map(|writer| writer.command).chain(others).collect();
    all_are_tried(&tried, |help| help.contains("  Replace "));
}
