//! Program flags from a file: which of them a file that was found, not named, may not set.

use std::ffi::OsString;

use clap::Command;
use inerter_flags::{Applied, ConfigError, FlagsFile, Rules};
use inerter_serve::loopback;

use super::terminal::note;

/// Flags that let a command replace or erase something, on a disk or a device; that name what it writes, what it runs
/// or which chip it is for; or that let others connect.
const GRAVE: &[&str] = &[
    "force",
    "yes",
    "save",
    "write",
    "output",
    "record",
    "csv",
    "parquet",
    "mat",
    "mcap",
    "png",
    "wav",
    "junit",
    "verdicts",
    "store",
    "again",
    "repair",
    "image",
    "qemu",
    "chip",
    "allow-remote",
    "foxglove-origin",
];

/// The command line, with the file's flags added where nothing was typed; prints a note for each.
pub fn apply(command: &Command, file: &FlagsFile, typed: &[OsString]) -> Result<Vec<OsString>, ConfigError> {
    let rules = Rules { grave: GRAVE, is_here: |place| loopback(place).is_some() };
    let Applied { flags, line } = inerter_flags::apply(command, file, typed, &rules)?;
    if !flags.is_empty() {
        let shown: Vec<_> = flags.iter().map(|flag| flag.to_string_lossy()).collect();
        note(format!("{} from {}", shown.join(" "), file.path.display()));
    }
    Ok(line)
}

#[cfg(test)]
mod tests {
    use clap::{Arg, CommandFactory};

    use super::*;

    #[test]
    fn a_file_that_was_only_found_runs_no_image() {
        let (command, folder) = (crate::Cli::command(), tempfile::tempdir().unwrap());
        let path = folder.path().join("inerter.toml");
        std::fs::write(&path, "[simulate]\nqemu = true\n").unwrap();
        let file = |is_named| FlagsFile { path: path.clone(), is_named };
        let typed = ["inerter", "simulate", "--tcp", "127.0.0.1:0"].map(OsString::from);
        let refused = apply(&command, &file(false), &typed).unwrap_err().to_string();
        assert!(refused.contains("it may not set `simulate.qemu`"), "{refused}");
        assert!(apply(&command, &file(true), &typed).unwrap().contains(&"--qemu".into()));
        // Results would go to a store that the file chose.
        std::fs::write(&path, "[replay]\nstore = \"s3://others/store\"\n").unwrap();
        let refused =
            apply(&command, &file(false), &["inerter", "replay"].map(OsString::from)).unwrap_err().to_string();
        assert!(refused.contains("it may not set `replay.store`"), "{refused}");
    }

    #[test]
    fn every_flag_that_takes_a_path_is_known_to_be_read_or_written() {
        fn paths(command: &Command, found: &mut std::collections::BTreeSet<String>) {
            let is_path =
                |arg: &&Arg| arg.get_value_parser().type_id() == clap::builder::ValueParser::path_buf().type_id();
            found.extend(command.get_arguments().filter(is_path).filter_map(Arg::get_long).map(String::from));
            command.get_subcommands().for_each(|below| paths(below, found));
        }
        let mut found = std::collections::BTreeSet::new();
        paths(&crate::Cli::command(), &mut found);
        let read = ["config", "calibration", "limits", "settings", "motion"];
        let known = |name: &String| GRAVE.contains(&name.as_str()) || read.contains(&name.as_str());
        let unknown: Vec<_> = found.iter().filter(|name| !known(name)).collect();
        assert!(unknown.is_empty() && found.contains("output"), "{unknown:?} of {found:?}");
    }
}
