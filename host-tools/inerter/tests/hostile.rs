//! Untrusted text on its way to a terminal or a page: names of devices and files, panics, markers, cells.

use std::{fs, path::Path};

use crate::common::{
    self, all_are_tried, device, done, elf_file, firmware, foreign_words, inerter, is_foreign, json_lines, last, text,
};
use inerter_data::{
    recording::{End, Recorder},
    settings::Overrides,
    words::printable,
};
use inerter_wire::{Capabilities, Event, EventKind, Hello, Record};

/// Writes the clipboard, forges a line, changes the writing direction, sets a colour with a single character, and hides
/// a name within a name.
pub const WORDS: &str = "\u{1b}]52;c;aGk=\u{7}\nforged\u{202e}\u{9b}31m\u{200b}\u{e0041}";

/// The beginning of the same, as it may reach a terminal or a page.
const SHOWN: &str = r"\u001b]52;c;aGk=";

/// What a hostile device sends instead of this record.
pub fn hostile(record: &Record) -> Vec<Vec<u8>> {
    match record {
        Record::Hello(hello) => {
            let (firmware, git, board) = (Hello::text(WORDS), Hello::text(WORDS), Hello::text(WORDS));
            let hello = Hello { firmware, git, board, serial: Hello::text("a\u{1b}[2J"), ..hello.clone() };
            let panic = EventKind::Panicked(Hello::text(WORDS));
            let panic = Record::Event(Event { index: 0, kind: panic });
            vec![firmware::payload(&Record::Hello(hello)), firmware::payload(&panic)]
        }
        _ => vec![firmware::payload(record)],
    }
}

/// What a hostile device sends that claims to measure itself, without which there is no self-test.
fn measuring(record: &Record) -> Vec<Vec<u8>> {
    match record {
        Record::Hello(hello) => {
            let capabilities = hello.capabilities.with(Capabilities::MEASURE);
            hostile(&Record::Hello(Hello { capabilities, ..hello.clone() }))
        }
        _ => hostile(record),
    }
}

/// Both streams must contain only lines of printable text, none of them forged, and so must a page or a figure that it
/// writes. A check of its own may fail.
fn check(folder: &Path, arguments: &[&str]) -> String {
    let output = inerter(folder, arguments).output().unwrap();
    let (out, errors) = (text(&output.stdout), text(&output.stderr));
    check_words(arguments, &[("standard output", &out), ("standard error", &errors)]);
    assert!(output.status.code().is_some_and(|code| code <= 10), "{arguments:?}: {errors}");
    let written = arguments.iter().skip_while(|word| **word != "-o").nth(1);
    let is_shown = |name: &&&str| name.ends_with(".html") || name.ends_with(".svg");
    if let Some(name) = written.filter(is_shown) {
        check_page(folder, name);
    }
    out + &errors
}

/// No character of a page or a figure may be foreign. A line break is a space there, and forges nothing. Returns its
/// text, or none if it was not written.
fn check_page(folder: &Path, name: &str) -> String {
    let page = fs::read_to_string(folder.join(name)).unwrap_or_default();
    assert_eq!(page.split('\n').find(|line| line.contains(is_foreign)), None, "{name}");
    page
}

fn check_words(arguments: &[&str], streams: &[(&str, &str)]) {
    for (stream, words) in streams {
        let foreign = foreign_words(words);
        assert!(foreign.is_none(), "{arguments:?}, {stream}: {foreign:?}");
    }
}

/// The same check for a command that needs a terminal, until it has shown these words.
#[cfg(unix)]
fn check_at_terminal(folder: &Path, arguments: &[&str], awaited: &str) -> String {
    let (screen, shown) = common::terminal::patient();
    let mut command = inerter(folder, arguments);
    command.stdin(screen.try_clone().unwrap()).stdout(screen.try_clone().unwrap()).stderr(screen);
    let mut child = command.spawn().unwrap();
    drop(command);
    common::until(awaited, || text(&shown.lock().unwrap()).contains(awaited));
    rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT).unwrap();
    let code = child.wait().unwrap().code();
    let words = common::terminal::spoken(&text(&shown.lock().unwrap()));
    check_words(arguments, &[("terminal", &words)]);
    assert_eq!(code, Some(130), "{arguments:?}: {words}");
    words
}

#[test]
fn no_device_writes_to_the_terminal_what_it_likes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let device = device(5.0);
    let address = firmware::before(device.name(), hostile);
    fs::write(folder.join("image.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    let mut said = String::new();
    let commands = [
        &["monitor", "--plain", "--duration", "1"][..],
        &["monitor", "--json", "--duration", "1"],
        &["record", "-o", "run.mcap", "--duration", "1"],
        &["settings", "get"],
        &["settings", "get", "--json"],
        &["settings", "set", "memory_s=9"],
        &["settings", "backup", "kept.toml"],
        &["settings", "restore", "kept.toml"],
        &["settings", "factory-reset", "--yes"],
        &["calibrate"],
        &["calibrate", "load-cell", "--duration", "4"],
        &["calibrate", "zero", "--duration", "1"],
        &["calibrate", "force", "--mass", "1"],
        &["calibrate", "encoder", "--revolutions", "1", "--lead", "0.01"],
        &["calibrate", "direction", "--duration", "1"],
        &["calibrate", "skew", "--duration", "1"],
        &["calibrate", "stiffness", "--duration", "1"],
        &["calibrate", "timebase", "--duration", "1"],
        &["settings", "tare"],
        &["settings", "save"],
        &["doctor"],
        &["settings", "diff", "device", "kept.toml"],
        &["send", "run.mcap"],
        &["selftest", "-o", "board.html"],
        &["update", "image.elf"],
        &["update", "image.elf", "--force"],
    ];
    all_are_tried(&commands, |help| help.contains("--connect <HOST:PORT>"));
    for command in commands {
        let all = [command, &["--connect", &address]].concat();
        #[cfg(unix)]
        if command == ["calibrate"] {
            said += &check_at_terminal(folder, &all, SHOWN);
            continue;
        }
        let words = check(folder, &all);
        // The device introduces itself before the command is refused.
        assert!(command != ["update", "image.elf"] || words.contains(SHOWN), "{words}");
        said += &words;
    }
    // The text was shown in escaped form.
    assert!(said.contains(r"\u001b]52;c;aGk=\u0007\nforged\u202e"), "{said}");
    // In JSON the same escapes represent the text itself.
    let info = last(&done(folder, &["info", "run.mcap", "--json"]));
    assert_eq!(info.pointer("/device/board").unwrap(), Hello::text::<24>(WORDS).as_str());
}

/// A page is also sent to people who never saw the device.
#[test]
fn no_device_writes_to_the_page_of_its_self_test_what_it_likes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let device = device(5.0);
    let address = firmware::before(device.name(), measuring);
    check(folder, &["selftest", "-o", "board.html", "--without-jumpers", "--connect", &address]);
    let page = check_page(folder, "board.html");
    assert!(page.contains(SHOWN) && page.contains(r"serial a\u001b[2J"), "{page}");
}

/// The error about a bad command line repeats its arguments, and `inerter info *` puts file names there.
#[test]
fn no_argument_writes_to_the_terminal_what_it_likes() {
    let folder = tempfile::tempdir().unwrap();
    let refused: [&[&str]; 4] =
        [&[WORDS], &["info", "run.mcap", WORDS], &["info", "--nothing", WORDS], &["simulate", "--duration", WORDS]];
    for arguments in refused {
        assert!(check(folder.path(), arguments).contains("try '--help'"), "{arguments:?}");
    }
}

/// An error repeats the text that it could not parse, but not all of it.
#[test]
fn no_file_fills_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let long = "x".repeat(1 << 19);
    fs::write(folder.path().join("run.csv"), "t_s,encoder_count,force_n\n0,1,2\n1,2,2\n").unwrap();
    fs::write(folder.path().join("long.toml"), format!("{long} = 1\n")).unwrap();
    fs::write(folder.path().join("flags.toml"), format!("{long} = 1\n")).unwrap();
    let common = ["replay", "run.csv", "--metres-per-count", "1e-6"];
    for arguments in [["--settings", "long.toml"], ["--config", "flags.toml"]] {
        let words = check(folder.path(), &[&common[..], &arguments].concat());
        assert!(words.contains("xxx") && words.len() < 10_000, "{} bytes", words.len());
    }
}

#[test]
fn no_file_writes_to_the_terminal_what_it_likes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let name = |ending: &str| format!("{}{ending}", WORDS.replace('/', ""));
    let (recording, csv, toml, kept) = (name(".mcap"), name(".csv"), name(".toml"), name("kept.toml"));
    let device = device(5.0);
    // A run whose device, panic and marker contain the text; then files with an error in every place that holds text.
    done(folder, &["simulate", "-o", "plain.mcap", "--duration", "3"]);
    let run = inerter_data::open(&folder.join("plain.mcap"), &Overrides::default()).unwrap();
    let mut recorder = Recorder::create(&folder.join(&recording), false).unwrap();
    let hello = run.hello.clone().unwrap();
    recorder
        .describe(&Hello { board: Hello::text(WORDS), firmware: Hello::text(WORDS), ..hello }, &run.settings)
        .unwrap();
    let samples = run.samples.chunks(8).map(|part| Record::Samples(inerter_wire::Samples::from_slice(part).0));
    let panic = Record::Event(Event { index: 0, kind: EventKind::Panicked(Hello::text(WORDS)) });
    for (sequence, record) in samples.chain([panic]).enumerate() {
        let mut frame = [0; inerter_wire::MAX_FRAME];
        let length = inerter_wire::encode_record(&record, sequence as u16, &mut frame).unwrap();
        recorder.frame(sequence as u64 * 1_000_000, frame.get(..length - 1).unwrap()).unwrap();
    }
    recorder.marker(5, WORDS).unwrap();
    recorder.metadata("inerter.truth", [("inertance_kg".to_string(), WORDS.to_string())].into()).unwrap();
    recorder.close(&End { reason: WORDS.into(), lost_frames: 0 }).unwrap();

    let header = "t_s,encoder_count,force_n\n";
    let cells = [
        format!("{}\n0,1,2\n", WORDS.replace('\n', "")),
        "t_s,encoder_count,force_n\u{1b}[2J\n0,1,2\n".to_string(),
        format!("{header}0,1,{}\n1,1,1\n", WORDS.replace('\n', "")),
        format!("{header}0,\u{9b}31m,1\n1,1,1\n"),
        format!("{header}\u{1b}[2J\n"),
    ];
    let mut said = String::new();
    for cell in cells {
        fs::write(folder.join(&csv), cell).unwrap();
        let loaded = format!("1={csv}");
        let commands = [
            &["replay", &csv][..],
            &["info", &csv],
            &["fit", &csv],
            &["diagnose", &csv],
            &["plan", &csv],
            &["identify", &csv],
            &["report", &csv, "-o", "page.html", "--force"],
            &["compare", &csv, &csv, "-o", "page.html", "--force"],
            &["export", &csv, "--csv", "out.csv", "--force"],
            &["plot", &csv, "--figure", "force", "-o", "force.svg", "--force"],
            &["send", &csv, "--connect", device.name()],
            &["calibrate", "load-cell", &csv],
            &["calibrate", "zero", &csv],
            &["calibrate", "force", "--mass", &loaded],
            &["calibrate", "direction", &csv],
            &["calibrate", "skew", &csv],
            &["calibrate", "stiffness", &csv],
        ];
        // All commands that read a CSV; `simulate` writes one.
        let reads = |help: &str| help.contains("--metres-per-count") && !help.contains("Usage: inerter simulate ");
        all_are_tried(&commands, reads);
        for command in commands {
            said += &check(folder, &[command, &["--metres-per-count", "1e-6"]].concat());
        }
    }
    fs::write(folder.join(&toml), format!("memory_s = 1.0\n\"{}\" = 2\n", r"\u001b[2J\nforged")).unwrap();
    let commands = [
        &["info", &recording][..],
        &["info", &recording, "--json"],
        &["replay", &recording],
        &["replay", &recording, "--json"],
        &["fit", &recording],
        &["diagnose", &recording],
        &["diagnose", &recording, "--json"],
        &["plan", &recording],
        &["plan", &recording, "--stroke-m", "0.01", "--want", WORDS],
        &["plan", "--preset", WORDS],
        &["simulate", "--motion", &csv, "-o", "out.mcap"],
        &["identify", &recording, "--no-profiles"],
        &["report", &recording, "-o", "report.html"],
        &["compare", &recording, "plain.mcap", "-o", "compared.html"],
        &["export", &recording, "--csv", "out.csv", "--estimates", "--force"],
        &["cut", &recording, "--from", "0.5", "-o", "part.mcap", "--force"],
        &["merge", &recording, "plain.mcap", "-o", "both.mcap", "--force"],
        &["plot", &recording, "--figure", "force", "-o", "run.svg"],
        &["send", &recording, "--connect", device.name()],
        &["calibrate", "load-cell", &recording],
        &["calibrate", "zero", &recording],
        &["calibrate", "direction", &recording],
        &["calibrate", "skew", &recording],
        &["calibrate", "stiffness", &recording],
        &["store", "add", "store", &recording],
        &["store", "ls", "store"],
        &["store", "ls", "store", "--csv"],
        &["store", "show", "store", WORDS],
        &["store", "query", "store", WORDS],
        &["store", "get", "store", WORDS, "-o", "got.mcap"],
        &["store", "verify", WORDS],
        &["store", "remove", "store", WORDS, "--yes"],
        &["settings", "diff", &recording, &toml],
        &["replay", &recording, "--settings", &toml],
        &["replay", &recording, "--set", "\u{1b}[2J=1"],
        &["replay", "\u{1b}[2J\nforged.mcap"],
        &["export", &recording, "--csv", "\u{1b}[2J\nforged/x.csv"],
        &["settings", "set", "\u{1b}[2J\nforged=1", "--connect", device.name()],
        &["settings", "backup", &kept, "--connect", device.name()],
        &["settings", "restore", &kept, "--connect", device.name()],
        &["settings", "restore", &toml, "--connect", device.name()],
        &["update", &recording],
        &["flash", &recording],
    ];
    all_are_tried(&commands, |help| {
        let arguments = help.split_once("Arguments:\n").map(|(_, rest)| rest);
        arguments.is_some_and(|arguments| !arguments.starts_with("  <SHELL>"))
    });
    for command in commands {
        said += &check(folder, command);
    }
    assert!(said.contains(r"\u001b]52;c;aGk=\u0007\nforged\u202e\u009b31m\u200b\udb40\udc41"), "{said}");
    // The run's name is in each of them.
    for name in ["report.html", "compared.html", "run.svg"] {
        let page = check_page(folder, name);
        assert!(page.contains(SHOWN) && page.contains(r"forged\u202e\u009b31m\u200b\udb40\udc41"), "{name}: {page}");
    }
    let lines = json_lines(&done(folder, &["info", &recording, "--json"]));
    assert_eq!(lines[0].pointer("/markers/0/text").unwrap(), WORDS);
}

/// Names of outputs, addresses and the file of flags, typed input, and descriptions inside an image or a recording.
#[test]
fn nothing_else_from_outside_writes_to_the_terminal_what_it_likes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let name = |ending: &str| format!("{}{ending}", WORDS.replace('/', ""));
    done(folder, &["simulate", "-o", "run.mcap", "--duration", "5"]);
    fs::write(folder.join("flags.toml"), "[record]\n\"\\u001b[2J\\nforged\" = \"\\u009b31m\"\n").unwrap();
    fs::write(folder.join("image.elf"), elf_file::image(5000, WORDS, WORDS)).unwrap();
    // Metadata that our recorder never writes.
    let run = inerter_data::open(&folder.join("run.mcap"), &Overrides::default()).unwrap();
    let mut recorder = Recorder::create(&folder.join("metadata.mcap"), false).unwrap();
    for metadata in ["inerter.hello", "inerter.settings", "inerter.calibration", "inerter.truth", "inerter.end", WORDS]
    {
        let keys = ["wire_version", "board", "serial", "firmware", "memory_s", "reason", WORDS];
        let map = keys.into_iter().map(|key| (key.to_string(), WORDS.to_string())).collect();
        recorder.metadata(metadata, map).unwrap();
    }
    for (sequence, part) in run.samples.chunks(8).enumerate() {
        let mut frame = [0; inerter_wire::MAX_FRAME];
        let samples = Record::Samples(inerter_wire::Samples::from_slice(part).0);
        let length = inerter_wire::encode_record(&samples, sequence as u16, &mut frame).unwrap();
        recorder.frame(sequence as u64 * 8_000_000, frame.get(..length - 1).unwrap()).unwrap();
    }
    recorder.close(&End { reason: WORDS.into(), lost_frames: 0 }).unwrap();

    let (address, toml, folder_name) = (format!("{WORDS}:1"), name(".toml"), name("folder"));
    let [mcap, csv, wav, svg, html] = [".mcap", ".csv", ".wav", ".svg", ".html"].map(name);
    let [cut, exported, parquet, mat] = ["c.mcap", "e.mcap", ".parquet", ".mat"].map(name);
    let commands = [
        &["--config", &toml, "info", "run.mcap"][..],
        &["--config", "flags.toml", "record", "-o", "x.mcap", "--connect", "127.0.0.1:1"],
        &["settings", "get", "--connect", &address],
        &["settings", "get", "--port", WORDS],
        &["settings", "get", "--serial", WORDS],
        &["doctor", "--connect", &address],
        &["simulate", "--tcp", &address],
        &["simulate", "--excite", WORDS, "-o", "x.mcap"],
        &["simulate", "--qemu", "--image", WORDS, "--tcp", "127.0.0.1:0"],
        &["simulate", "--duration", "1", "-o", &mcap],
        &["simulate", "--duration", "1", "-o", &csv],
        &["cut", "run.mcap", "-o", &cut],
        &["merge", "run.mcap", &cut, "-o", &mcap, "--force"],
        &["export", "run.mcap", "--csv", &csv, "--parquet", &parquet, "--mat", &mat, "--mcap", &exported, "--force"],
        &["plot", "run.mcap", "--figure", "force", "-o", &svg],
        &["report", "run.mcap", "-o", &html, "--png", &folder_name],
        &["compare", "run.mcap", "run.mcap", "-o", &html, "--png", &folder_name, "--force"],
        &["plan", "run.mcap", "-o", &csv, "--wav", &wav, "--force"],
        &["man", "-o", &folder_name],
        &["update", "image.elf", "--dry-run"],
        &["update", "image.elf", "--dry-run", "--json"],
        &["info", "metadata.mcap"],
        &["info", "metadata.mcap", "--json"],
        &["replay", "metadata.mcap", "--json"],
        &["export", "metadata.mcap", "--mcap", "m.mcap"],
        &["cut", "metadata.mcap", "-o", "n.mcap"],
        &["merge", "metadata.mcap", "run.mcap", "-o", "o.mcap"],
        &["report", "metadata.mcap", "-o", "page.html"],
        &["compare", "metadata.mcap", "run.mcap", "-o", "compared.html"],
        &["settings", "diff", "metadata.mcap", "run.mcap"],
    ];
    let said: String = commands.iter().map(|command| check(folder, command)).collect();
    assert!(said.contains(r"\u001b]52;c;aGk=\u0007\nforged\u202e"), "{said}");
}

/// A note repeats what is typed at the operator's prompt of a simulated device.
#[cfg(unix)]
#[test]
fn no_hand_writes_to_the_terminal_what_it_likes() {
    let folder = tempfile::tempdir().unwrap();
    let typed = folder.path().join("typed");
    fs::write(&typed, [format!("mass {WORDS}\n").as_bytes(), b"load \x1b[2J\n\xff\n"].concat()).unwrap();
    let mut command = inerter(folder.path(), &["simulate", "--tcp", "127.0.0.1:0", "--bench"]);
    let said = fs::File::create(folder.path().join("said")).unwrap();
    command.stdin(fs::File::open(typed).unwrap()).stdout(said.try_clone().unwrap()).stderr(said);
    let mut child = command.spawn().unwrap();
    let words = || text(&fs::read(folder.path().join("said")).unwrap());
    common::until("nothing is said", || words().contains("load \\u001b[2J"));
    child.kill().unwrap();
    child.wait().unwrap();
    check_words(&["simulate", "--bench"], &[("both streams", &words())]);
}

/// In QEMU an image can run any command.
#[cfg(unix)]
#[test]
fn no_image_that_merely_lies_in_the_folder_is_run() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    let (planted, tools) = (folder.path().join("planted"), folder.path().join("tools"));
    let image = planted.join("target/thumbv7em-none-eabihf/firmware/inerter-qemu");
    fs::create_dir_all(image.parent().unwrap()).unwrap();
    fs::create_dir_all(&tools).unwrap();
    fs::write(&image, "an image").unwrap();
    // Writes down what it was to run.
    let emulator = tools.join("qemu-system-arm");
    fs::write(&emulator, "#!/bin/sh\nprintf '%s ' \"$@\" > ran\n").unwrap();
    fs::set_permissions(&emulator, fs::Permissions::from_mode(0o755)).unwrap();
    let ran = |more: &[&str]| {
        let arguments = [&["simulate", "--tcp", "127.0.0.1:0", "--qemu"], more].concat();
        let output = inerter(&planted, &arguments).env("PATH", &tools).output().unwrap();
        assert!(!output.status.success(), "{}", text(&output.stdout));
        fs::read_to_string(planted.join("ran")).unwrap_or_default()
    };
    let found = ran(&[]);
    assert!(!found.contains("planted"), "{found}");
    let named = ran(&["--image", image.to_str().unwrap()]);
    assert!(named.contains("planted"), "{named}");
}

#[test]
fn invisible_characters_are_foreign_and_are_never_written() {
    let unseen = [
        // Controls, overrides of the writing direction, what has no width.
        '\0'..='\t',
        '\u{b}'..='\u{1f}',
        '\u{7f}'..='\u{9f}',
        '\u{ad}'..='\u{ad}',
        '\u{61c}'..='\u{61c}',
        '\u{200b}'..='\u{200f}',
        '\u{202a}'..='\u{202e}',
        '\u{2060}'..='\u{206f}',
        '\u{feff}'..='\u{feff}',
        // A joiner, fillers, blank Braille.
        '\u{34f}'..='\u{34f}',
        '\u{115f}'..='\u{1160}',
        '\u{17b4}'..='\u{17b5}',
        '\u{2800}'..='\u{2800}',
        '\u{3164}'..='\u{3164}',
        '\u{ffa0}'..='\u{ffa0}',
        // Selectors and tags.
        '\u{180b}'..='\u{180f}',
        '\u{fe00}'..='\u{fe0f}',
        '\u{e0000}'..='\u{e007f}',
        '\u{e0100}'..='\u{e01ef}',
    ];
    for letter in unseen.into_iter().flatten() {
        assert!(foreign_words(&format!("a{letter}")).is_some(), "{letter:?}");
    }
    assert_eq!(foreign_words("Prüfstand 3 µm ± 2 °C,\nひずみ, e\u{301}, 🛠"), None);
    // Only what stands for damaged text is a letter to the program.
    for letter in ('\0'..=char::MAX).filter(|letter| is_foreign(*letter) && *letter != '\u{fffd}') {
        assert!(printable(&format!("a{letter}")).is_ascii(), "{letter:?}");
    }
}
