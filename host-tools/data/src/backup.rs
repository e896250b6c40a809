//! Settings of a device in a file, with whose they are; and what differs between two sets.
//!
//! The file is one that `--settings` takes; the device stands in comments at its beginning.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use inerter_core::Settings;
use inerter_wire::Hello;
use miette::Diagnostic;
use serde_json::json;

use crate::{
    error::Error,
    output::{self, OutputError},
    recording::{self, is_recording},
    settings::{Overrides, SettingsInputError, text_of, to_toml},
    words::printable,
};

/// Why a backup is not restored.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum BackupError {
    /// Another device's.
    #[error("{path} is of another device: {theirs}, and this one is {ours}", path = path.display())]
    #[diagnostic(
        code(inerter::backup::other),
        help("a calibration belongs to its board, cell and screw; where those were moved to this board, add --force")
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// The device of the file.
        theirs: String,
        /// The device that is connected.
        ours: String,
    },
    /// Nobody's.
    #[error("{path} does not say whose settings it holds", path = path.display())]
    #[diagnostic(
        code(inerter::backup::nobody),
        help("it was not made by `inerter settings backup`: look at it with `inerter settings diff {path} device`, \
        then add --force", path = path.display())
    )]
    Nobody {
        /// The file.
        path: PathBuf,
    },
}

/// Whose settings they are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Owner {
    /// Board.
    pub board: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
}

impl Owner {
    /// A device.
    pub fn of(hello: &Hello) -> Self {
        Self { board: Some(hello.board.to_string()), serial: Some(hello.serial.to_string()) }
    }

    fn words(&self) -> String {
        let [board, serial] = [&self.board, &self.serial].map(|part| part.as_deref().unwrap_or("unknown"));
        format!("{board}, serial {serial}")
    }
}

/// Settings as they stand in a file: only those that it names.
#[derive(Clone, Debug, Default)]
pub struct Backup {
    /// The settings.
    pub values: Overrides,
    /// Whose they are.
    pub owner: Owner,
}

/// The text of a backup.
pub fn text(hello: &Hello, settings: &Settings) -> String {
    let mut text = String::from("# Settings of an instrumented inerter; `inerter settings restore` puts them back.\n");
    for (name, value) in [
        ("board", hello.board.as_str()),
        ("serial", hello.serial.as_str()),
        ("firmware", hello.firmware.as_str()),
        ("git", hello.git.as_str()),
    ] {
        text += &format!("# {name}: {}\n", commented(value));
    }
    text + "\n" + &to_toml(settings)
}

/// A text for a comment of TOML, which may hold no control characters: where it would not be read back as it is, as a JSON
/// string.
fn commented(value: &str) -> Cow<'_, str> {
    let plain = !value.is_empty() && value.trim() == value && !value.starts_with('"') && printable(value) == value;
    if plain { value.into() } else { printable(&json!(value).to_string()).into_owned().into() }
}

/// The text that [`commented`] wrote, or somebody by hand; none where nothing stands.
fn uncommented(text: &str) -> Option<String> {
    let text = text.trim();
    serde_json::from_str(text).ok().or_else(|| (!text.is_empty()).then(|| text.to_string()))
}

/// Writes a backup, whole or not at all. Only `replace` lets it take the place of a file.
pub fn write(path: &Path, replace: bool, hello: &Hello, settings: &Settings) -> Result<(), OutputError> {
    output::write(path, replace, text(hello, settings))
}

/// Reads a backup, or any file of settings.
pub fn read(path: &Path) -> Result<Backup, SettingsInputError> {
    let values = Overrides::from_inputs(Some(path), &[])?;
    let text = text_of(path).map_err(|source| SettingsInputError::File { path: path.into(), source })?;
    let comment = |name: &str| {
        let lines = text.lines().take_while(|line| line.starts_with('#') || line.trim().is_empty());
        let mut values =
            lines.filter_map(|line| line.trim_start_matches(['#', ' ']).strip_prefix(name)?.strip_prefix(':'));
        values.next().and_then(uncommented)
    };
    Ok(Backup { values, owner: Owner { board: comment("board"), serial: comment("serial") } })
}

impl Backup {
    /// Refuses what is not of this device.
    pub fn check_owner(&self, path: &Path, hello: &Hello) -> Result<(), BackupError> {
        let ours = Owner::of(hello);
        match &self.owner {
            owner if *owner == ours => Ok(()),
            Owner { board: None, .. } | Owner { serial: None, .. } => Err(BackupError::Nobody { path: path.into() }),
            owner => Err(BackupError::Other { path: path.into(), theirs: owner.words(), ours: ours.words() }),
        }
    }
}

/// Values of all settings in a file, a backup or a recording; `None` for those that it does not hold.
pub fn values_of(path: &Path) -> Result<Vec<Option<f64>>, Error> {
    let unreadable = |source| SettingsInputError::File { path: path.into(), source };
    if is_recording(path).map_err(unreadable)? {
        let settings = recording::summary(path)?.settings;
        let settings =
            settings.ok_or_else(|| recording::RecordingError::NoSettings { file: path.display().to_string() })?;
        return Ok(settings.values().into_iter().map(Some).collect());
    }
    let backup = read(path)?;
    Ok(Settings::TABLE.iter().map(|info| backup.values.get(info.name)).collect())
}

/// Settings that differ, by name: as before and as after.
pub fn changes(before: &Settings, after: &Settings) -> Vec<(&'static str, f64, f64)> {
    let values = before.values().into_iter().zip(after.values());
    let all = Settings::TABLE.iter().zip(values).map(|(info, (before, after))| (info.name, before, after));
    all.filter(|(_, before, after)| before.to_bits() != after.to_bits()).collect()
}

#[cfg(test)]
mod tests {
    use inerter_wire::{Capabilities, ClockSource, WIRE_VERSION};
    use proptest::prelude::*;

    use super::*;

    fn hello(serial: &str) -> Hello {
        Hello {
            wire_version: WIRE_VERSION,
            firmware: Hello::text("inerter 1.0"),
            git: Hello::text(""),
            board: Hello::text("nucleo-g474re"),
            serial: Hello::text(serial),
            sample_rate_hz: 1000.0,
            clock: ClockSource::Crystal,
            capabilities: Capabilities::NONE,
        }
    }

    #[test]
    fn a_backup_reads_back_to_the_same_bits_and_knows_its_device() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        let settings = Settings { newtons_per_code: -1.0 / 3.0, skew_s: 1.52e-5, ..Settings::default() };
        write(&path, false, &hello("205735883537"), &settings).unwrap();
        let backup = read(&path).unwrap();
        let mut restored = Settings::default();
        backup.values.apply(&mut restored).unwrap();
        assert_eq!(changes(&settings, &restored), []);
        assert_eq!(backup.owner, Owner::of(&hello("205735883537")));
        assert!(backup.check_owner(&path, &hello("205735883537")).is_ok());
        assert!(matches!(backup.check_owner(&path, &hello("1")), Err(BackupError::Other { .. })));
        std::fs::write(&path, to_toml(&settings)).unwrap();
        assert!(matches!(read(&path).unwrap().check_owner(&path, &hello("1")), Err(BackupError::Nobody { .. })));
        assert!(values_of(&path).unwrap().iter().all(Option::is_some));
        let differences = changes(&Settings::default(), &settings);
        let names: Vec<_> = differences.iter().map(|(name, ..)| *name).collect();
        assert_eq!(names, ["newtons_per_code", "skew_s"]);
    }

    /// Any text, and often one that means something in TOML, in JSON, in a comment or to a terminal.
    fn any_text() -> impl Strategy<Value = String> {
        let special = prop::sample::select(vec![
            "\u{1b}[2J",
            "\n",
            "\r\n",
            "\t",
            " ",
            "\u{7f}",
            "\u{85}",
            "\u{2028}",
            "\u{feff}",
            "\"",
            "\\",
            "\\n",
            "#",
            ":",
            "\0",
            "12",
            "null",
        ]);
        let part = prop_oneof![any::<String>(), "\\PC{0,6}", special.prop_map(String::from)];
        prop::collection::vec(part, 0..5).prop_map(|parts| parts.concat())
    }

    /// Any value, and often one at the edge of what a setting takes.
    fn any_value() -> impl Strategy<Value = f64> {
        let edges =
            vec![0.0, -0.0, 1.0, -1.0, f64::MIN_POSITIVE, 5e-324, f64::MAX, f64::INFINITY, f64::NAN, 1e16, 1e-7];
        prop_oneof![any::<f64>(), -1e6..1e6, 0.0..1.0, prop::sample::select(edges)]
    }

    proptest! {
        #[test]
        fn what_backup_writes_restore_reads(
            texts in prop::array::uniform4(any_text()),
            values in prop::collection::vec(any_value(), Settings::COUNT),
        ) {
            let [board, serial, firmware, git] = &texts;
            let hello = Hello {
                board: Hello::text(board),
                firmware: Hello::text(firmware),
                git: Hello::text(git),
                ..hello(serial)
            };
            let mut settings = Settings::default();
            for (number, value) in values.iter().enumerate() {
                // A device takes no others.
                settings.set(number, *value).ok();
            }
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.toml");
            std::fs::write(&path, text(&hello, &settings)).unwrap();
            let backup = read(&path).unwrap();
            prop_assert!(backup.check_owner(&path, &hello).is_ok(), "{:?} {hello:?}", backup.owner);
            let mut restored = Settings::default();
            backup.values.apply(&mut restored).unwrap();
            prop_assert_eq!(changes(&settings, &restored), []);
            // Nor does a terminal that shows it do anything.
            let text = std::fs::read_to_string(&path).unwrap();
            prop_assert!(text.lines().all(|line| printable(line) == line), "{text:?}");
        }
    }
}
