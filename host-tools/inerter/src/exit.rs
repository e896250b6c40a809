//! Exit codes, a public contract described in `docs/CLI.md`, and the code for each failure.

use crate::Error;

/// Everything requested was done.
pub const OK: u8 = 0;
/// A failure that none of the other codes describes.
pub const OTHER: u8 = 1;
/// The command line itself is wrong; clap ends the program with this one.
pub const USAGE: u8 = 2;
/// An input file is missing, damaged, or not what it should be.
pub const INPUT: u8 = 3;
/// A setting or parameter is unknown or has an invalid value.
pub const SETTINGS: u8 = 4;
/// The device cannot be found or opened.
pub const NO_DEVICE: u8 = 5;
/// The device vanished, fell silent or refused while in use.
pub const DEVICE_LOST: u8 = 6;
/// The device speaks another version of the wire format.
pub const WIRE_VERSION: u8 = 7;
/// The output cannot be written: disk full, no permission, file in the way.
pub const OUTPUT: u8 = 8;
/// The motion cannot identify what was asked for.
pub const NOT_SHOWN: u8 = 9;
/// The board did not pass its self-test, or a device is not shown to be within its limits.
pub const NOT_PASSED: u8 = 10;
/// Ctrl-C, by shell convention.
pub const INTERRUPTED: u8 = 130;

/// Diagnostic codes and families of them, without `inerter::`, by the exit code of these failures. A code that is not
/// here has the exit code of its family.
const FAILURES: [(u8, &[&str]); 11] = [
    (
        USAGE,
        &[
            "built_without",
            "calibrate::answer",
            "calibrate::missing",
            "calibrate::no_terminal",
            "calibrate::nobody",
            "calibrate::points",
            "compare::one",
            "flash::chip",
            "identify::stages",
            "monitor",
            "page::format",
            "plan::unstated",
            "selftest::same_name",
            "settings::unconfirmed",
            "simulate::format",
            "standard_output",
            "store::address",
            "store::ambiguous",
            "store::batch",
            "store::condition",
            "store::other_batch",
            "store::unconfirmed",
        ],
    ),
    (
        INPUT,
        &[
            "config::file",
            "csv",
            "identify::short",
            "image",
            "input",
            "limits::file",
            "recording",
            "store",
            "update::board",
        ],
    ),
    (
        SETTINGS,
        &["backup", "compare::machine", "config", "limits::form", "merge", "plan", "settings", "simulate", "want"],
    ),
    (
        NO_DEVICE,
        &[
            "device::connect",
            "device::none",
            "device::several",
            "device::turned_away",
            "doctor",
            "flash",
            "port",
            "simulate::endpoint",
            "simulate::image",
            "simulate::qemu",
            "simulate::qemu_ended",
            "update::chip",
            "update::none",
            "update::open",
            "update::permission",
            "update::several",
            "update::usb",
        ],
    ),
    (DEVICE_LOST, &["device", "fit::torn", "flash::program", "selftest::unsupported", "update"]),
    (WIRE_VERSION, &["wire::version"]),
    (OUTPUT, &["monitor::listen", "monitor::terminal", "output", "store::foreign"]),
    (
        NOT_SHOWN,
        &[
            "calibrate",
            "contact",
            "fit",
            "identify",
            "page::not_shown",
            "plan::missed",
            "plan::nothing",
            "plan::run",
            "skew",
        ],
    ),
    (NOT_PASSED, &["limits", "selftest::failed"]),
    (INTERRUPTED, &["interrupted", "update::interrupted"]),
    (OTHER, &["monitor::random"]),
];

/// The exit code for this failure.
pub fn code(error: &Error) -> u8 {
    #[cfg(feature = "tables")]
    if let Some(inerter_store::StoreError::Access { action: "written" | "removed", .. }) = error.downcast_ref() {
        return OUTPUT;
    }
    let name = error.code().map(|code| code.to_string()).unwrap_or_default();
    listed(name.trim_start_matches("inerter::")).unwrap_or(OTHER)
}

/// The exit code that [`FAILURES`] lists for a diagnostic code, or else for its family.
fn listed(name: &str) -> Option<u8> {
    let itself = FAILURES.iter().find(|(_, names)| names.contains(&name)).map(|(code, _)| *code);
    itself.or_else(|| listed(name.rsplit_once("::")?.0))
}

#[cfg(test)]
mod tests {
    use std::{
        collections::{BTreeMap, BTreeSet},
        fs,
        path::Path,
    };

    use super::*;

    /// Adds the diagnostic codes in the sources below a folder.
    fn find(folder: &Path, found: &mut BTreeSet<String>) {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            find(&path, found);
            if path.extension().is_some_and(|ending| ending == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                let codes = text.split("code(inerter::").skip(1).filter_map(|after| after.split_once(')'));
                found.extend(codes.map(|(code, _)| code.to_string()));
            }
        }
    }

    #[test]
    fn every_failure_of_the_libraries_has_an_exit_code() {
        let mut found = BTreeSet::new();
        for member in fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("..")).unwrap() {
            find(&member.unwrap().path().join("src"), &mut found);
        }
        found.retain(|code| code.chars().all(|letter| letter.is_ascii_alphanumeric() || "_:".contains(letter)));
        // Columns are given by Python only.
        found.retain(|name| !name.starts_with("columns::"));
        let unlisted: Vec<&String> = found.iter().filter(|name| listed(name).is_none()).collect();
        assert!(unlisted.is_empty(), "{unlisted:?}");
        // A new failure has the exit code of its family: check that it fits, or list it, and count it here.
        let mut counts = BTreeMap::new();
        for code in found.iter().filter_map(|name| listed(name)) {
            *counts.entry(code).or_insert(0) += 1;
        }
        let counted = [
            (OTHER, 1),
            (USAGE, 24),
            (INPUT, 54),
            (SETTINGS, 29),
            (NO_DEVICE, 30),
            (DEVICE_LOST, 20),
            (WIRE_VERSION, 1),
            (OUTPUT, 8),
            (NOT_SHOWN, 26),
            (NOT_PASSED, 3),
            (INTERRUPTED, 2),
        ];
        assert_eq!(counts, BTreeMap::from(counted));
    }

    #[test]
    fn a_family_is_known_by_its_whole_name() {
        let names = ["store::none", "store::foreign", "fit::torn", "fit::torn::twice", "device::none"];
        let codes = [INPUT, OUTPUT, DEVICE_LOST, DEVICE_LOST, NO_DEVICE].map(Some);
        assert_eq!(names.map(listed), codes);
        assert_eq!(["", "nothing", "stored::none", "plant", "ports::open"].map(listed), [None; 5]);
    }
}
