//! Flags from a TOML file `inerter.toml`, which may be in any folder.
//!
//! Input: a byte (whether the file was named on the command line, and how many words were typed), the words (a byte
//! each, an index into a list), then the text.
//!
//! Properties: the typed words stay in their order. A file that was found automatically sets none of the flags that it
//! must not set, and no address of another machine. The resulting line is parsed or refused with a message. Every error
//! can be displayed.

use std::ffi::OsString;

use clap::{Arg, ArgAction, Command, value_parser};
use inerter_flags::{FlagsFile, Rules, apply};
use inerter_serve::loopback;

use crate::{csv::shown, input::Input, scratch};

/// Flags that an automatically found file must not set.
const GRAVE: [&str; 2] = ["force", "output"];
/// Words that may be typed.
const WORDS: [&str; 13] = [
    "record",
    "calibrate",
    "skew",
    "--duration=5",
    "--port",
    "COM5",
    "--connect=127.0.0.1:9",
    "-o",
    "x.mcap",
    "--set",
    "a=1",
    "--config",
    "--",
];

/// A command line with every kind of flag.
fn command() -> Command {
    let value = |name: &'static str| Arg::new(name).long(name);
    let rig = || {
        [
            value("port").conflicts_with("connect"),
            value("connect").value_name("HOST:PORT"),
            value("duration").value_parser(value_parser!(f64)),
            value("set").action(ArgAction::Append),
            value("force").action(ArgAction::SetTrue),
        ]
    };
    let output = value("output").short('o').value_parser(value_parser!(std::path::PathBuf));
    Command::new("inerter")
        .arg(value("config").global(true))
        .subcommand(Command::new("record").args(rig()).arg(output))
        .subcommand(Command::new("calibrate").subcommand(Command::new("skew").args(rig())))
}

/// Checks an input.
pub fn check(mut input: Input) {
    let first = input.byte();
    let (is_named, count) = (first & 1 == 1, usize::from(first >> 1) % 8);
    let words = input.take(count).iter().filter_map(|byte| WORDS.get(usize::from(*byte) % WORDS.len()));
    let typed: Vec<OsString> = ["inerter"].iter().chain(words).map(OsString::from).collect();
    let scratch = scratch::file(input.rest());
    let file = FlagsFile { path: scratch.to_path_buf(), is_named };
    let rules = Rules { grave: &GRAVE, is_here: |place| loopback(place).is_some() };
    let Some(applied) = shown(apply(&command(), &file, &typed, &rules)) else { return };
    assert_eq!(applied.line.len(), typed.len() + applied.flags.len());
    let mut line = applied.line.iter();
    assert!(typed.iter().all(|word| line.any(|other| other == word)), "{typed:?} in {:?}", applied.line);
    for flag in &applied.flags {
        let flag = flag.to_str().expect("it comes from a text");
        let (name, value) = flag.split_once('=').unwrap_or((flag, ""));
        let name = name.strip_prefix("--").expect("each is written in its long form");
        assert!(is_named || !GRAVE.contains(&name), "{flag} was set by a file that was only found");
        assert!(is_named || name != "connect" || loopback(value).is_some(), "{flag} is elsewhere");
    }
    if let Err(error) = command().try_get_matches_from(&applied.line) {
        assert!(!error.to_string().is_empty());
    }
}

/// Files as people write them, correct and incorrect.
pub fn seeds() -> Vec<Vec<u8>> {
    let texts = [
        "port = \"COM5\"\n[record]\nduration = 60\nforce = true\noutput = \"run.mcap\"\nset = [\"a=1\", \"b=2\"]\n",
        "connect = \"127.0.0.1:7878\"\n[calibrate.skew]\nduration = 30\n",
        "connect = [\"localhost:1\", \"10.0.0.1:7878\"]\n",
        "[calibrate]\nskew = { duration = 1e300, set = [[\"a\"], [1, 2.5, true]] }\n",
        "prot = 1\n",
        "[record]\nduration = \"long\"\n[recrod]\n",
        "duration = 1979-05-27\n",
        "[record\n",
        "duration = nan\nforce = false\n",
    ];
    let mut seeds = Vec::new();
    for text in texts {
        for words in [&[][..], &[0], &[0, 3, 7, 8], &[1, 2, 4, 5], &[0, 6, 9, 10, 11], &[0, 12, 3]] {
            for is_named in [0, 1] {
                let first = (words.len() as u8) << 1 | is_named;
                seeds.push([&[first], words, text.as_bytes()].concat());
            }
        }
    }
    seeds
}
