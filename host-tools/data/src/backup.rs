//! Settings of a device in a file, with the device they belong to; and the differences between two sets.
//!
//! The file is one that `--settings` takes; comments at its beginning name the device.

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
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum BackupError {
    /// It is of another device.
    #[error("{path} belongs to another device: {theirs}; this one is {ours}", path = path.display())]
    #[diagnostic(
        code(inerter::backup::other),
        help("a calibration belongs to its board, cell and screw; if they were moved to this board, add --force")
    )]
    Other { path: PathBuf, theirs: String, ours: String },
    /// It does not name its device.
    #[error("{path} does not say to which device its settings belong", path = path.display())]
    #[diagnostic(
        code(inerter::backup::nobody),
        help("it was not made by `inerter settings backup`: look at it with `inerter settings diff {path} device`, \
        then add --force", path = path.display())
    )]
    Nobody { path: PathBuf },
}

/// The device that settings belong to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Owner {
    /// Board.
    pub board: String,
    /// Serial number.
    pub serial: String,
}

impl Owner {
    /// A device.
    pub fn of(hello: &Hello) -> Self {
        Self { board: hello.board.to_string(), serial: hello.serial.to_string() }
    }

    fn words(&self) -> String {
        format!("{}, serial {}", self.board, self.serial)
    }
}

/// Settings in a file: only those that it names.
#[derive(Clone, Debug, Default)]
pub struct Backup {
    /// The settings.
    pub values: Overrides,
    /// The device that they belong to, if the file names it.
    pub owner: Option<Owner>,
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

/// A text for a TOML comment, which may hold no control characters: written as a JSON string if it would not read back
/// unchanged.
fn commented(value: &str) -> Cow<'_, str> {
    let plain = !value.is_empty() && value.trim() == value && !value.starts_with('"') && printable(value) == value;
    if plain { value.into() } else { printable(&json!(value).to_string()).into_owned().into() }
}

/// The text that [`commented`] or a user wrote; `None` if it is empty.
fn uncommented(text: &str) -> Option<String> {
    let text = text.trim();
    serde_json::from_str(text).ok().or_else(|| (!text.is_empty()).then(|| text.to_string()))
}

/// Writes a backup, whole or not at all. Replaces an existing file only with `replace`.
pub fn write(path: &Path, replace: bool, hello: &Hello, settings: &Settings) -> Result<(), OutputError> {
    output::write(path, replace, text(hello, settings))
}

/// A backup, and its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept {
    /// The file.
    pub path: PathBuf,
    /// Other files with such a name but different contents.
    pub others: usize,
}

/// Writes a backup beside existing ones: `NAME.toml`, or `NAME.2.toml` and so on if that is taken. An existing backup
/// with the same contents is reused. No file is replaced: it may be the only copy of settings that the device has since
/// lost.
pub fn write_beside(path: &Path, hello: &Hello, settings: &Settings) -> Result<Kept, OutputError> {
    let text = text(hello, settings);
    let mut others = 0;
    loop {
        let path = if others == 0 { path.into() } else { path.with_extension(format!("{}.toml", others + 1)) };
        // A pipe is not a backup, nor is a dangling link. A path without a name is refused.
        if path.file_name().is_none() || path.symlink_metadata().is_err() {
            match output::write(&path, false, &text) {
                // Another program created the file first.
                Err(OutputError::Exists { .. }) => {}
                result => return result.map(|()| Kept { path, others }),
            }
        } else if path.is_file() && std::fs::read(&path).is_ok_and(|there| there == text.as_bytes()) {
            return Ok(Kept { path, others });
        }
        others += 1;
    }
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
    let owner = comment("board").zip(comment("serial")).map(|(board, serial)| Owner { board, serial });
    Ok(Backup { values, owner })
}

impl Backup {
    /// Rejects a backup of another device.
    pub fn check_owner(&self, path: &Path, hello: &Hello) -> Result<(), BackupError> {
        let ours = Owner::of(hello);
        match &self.owner {
            None => Err(BackupError::Nobody { path: path.into() }),
            Some(owner) if *owner == ours => Ok(()),
            Some(owner) => Err(BackupError::Other { path: path.into(), theirs: owner.words(), ours: ours.words() }),
        }
    }
}

/// Values of all settings in a file, a backup or a recording; `None` for those that it does not hold.
pub fn values_of(path: &Path) -> Result<Vec<Option<f64>>, Error> {
    let unreadable = |source| SettingsInputError::File { path: path.into(), source };
    if is_recording(path).map_err(unreadable)? {
        let no_settings = || recording::RecordingError::NoSettings { file: path.display().to_string() };
        let settings = recording::summary(path)?.settings.ok_or_else(no_settings)?;
        return Ok(settings.values().into_iter().map(Some).collect());
    }
    let backup = read(path)?;
    Ok(Settings::TABLE.iter().map(|info| backup.values.get(info.name)).collect())
}

/// Settings that differ, by name: the old and the new value.
pub fn changes(before: &Settings, after: &Settings) -> Vec<(&'static str, f64, f64)> {
    let values = before.values().into_iter().zip(after.values());
    let all = Settings::TABLE.iter().zip(values).map(|(info, (before, after))| (info.name, before, after));
    all.filter(|(_, before, after)| before.to_bits() != after.to_bits()).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use proptest::prelude::*;

    use super::*;
    use crate::fixtures::{hello, new_file};

    #[test]
    fn a_backup_reads_back_to_the_same_bits_and_knows_its_device() {
        let (_folder, path) = new_file("a.toml");
        let settings = Settings { newtons_per_code: -1.0 / 3.0, skew_s: 1.52e-5, ..Settings::default() };
        write(&path, false, &hello("205735883537"), &settings).unwrap();
        let backup = read(&path).unwrap();
        let mut restored = Settings::default();
        backup.values.apply(&mut restored).unwrap();
        assert_eq!(changes(&settings, &restored), []);
        assert_eq!(backup.owner, Some(Owner::of(&hello("205735883537"))));
        assert!(backup.check_owner(&path, &hello("205735883537")).is_ok());
        assert!(matches!(backup.check_owner(&path, &hello("1")), Err(BackupError::Other { .. })));
        fs::write(&path, to_toml(&settings)).unwrap();
        assert!(matches!(read(&path).unwrap().check_owner(&path, &hello("1")), Err(BackupError::Nobody { .. })));
        assert!(values_of(&path).unwrap().iter().all(Option::is_some));
        let differences = changes(&Settings::default(), &settings);
        let names: Vec<_> = differences.iter().map(|(name, ..)| *name).collect();
        assert_eq!(names, ["newtons_per_code", "skew_s"]);
    }

    #[test]
    fn a_backup_never_takes_the_place_of_another() {
        let (folder, path) = new_file("board.settings.toml");
        let with = |skew_s| Settings { skew_s, ..Settings::default() };
        let kept = |settings| write_beside(&path, &hello("1"), &settings).unwrap();
        let named = |name: &str, others| Kept { path: folder.path().join(name), others };
        assert_eq!(kept(with(1e-6)), named("board.settings.toml", 0));
        let first = fs::read(&path).unwrap();
        // An interrupted test leaves other settings, and the next test finds them.
        assert_eq!(kept(with(2e-6)), named("board.settings.2.toml", 1));
        assert_eq!(kept(with(3e-6)), named("board.settings.3.toml", 2));
        assert_eq!(fs::read(&path).unwrap(), first);
        // A backup that exists is not written twice.
        assert_eq!(kept(with(1e-6)), named("board.settings.toml", 0));
        assert_eq!(kept(with(3e-6)), named("board.settings.3.toml", 2));
        assert_eq!(write_beside(&path, &hello("2"), &with(1e-6)).unwrap(), named("board.settings.4.toml", 3));
        assert_eq!(folder.path().read_dir().unwrap().count(), 4);
        let nowhere = folder.path().join("none/board.settings.toml");
        let no_name = folder.path().join("..");
        assert!(matches!(write_beside(&no_name, &hello("1"), &with(0.0)), Err(OutputError::Create { .. })));
        assert!(matches!(write_beside(&nowhere, &hello("1"), &with(0.0)), Err(OutputError::Create { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn a_backup_is_a_file_of_its_own() {
        let (folder, path) = new_file("board.settings.toml");
        std::os::unix::fs::symlink("/dev/null", &path).unwrap();
        fs::create_dir(folder.path().join("board.settings.2.toml")).unwrap();
        let kept = write_beside(&path, &hello("1"), &Settings::default()).unwrap();
        assert_eq!(kept, Kept { path: folder.path().join("board.settings.3.toml"), others: 2 });
        assert!(read(&kept.path).unwrap().check_owner(&kept.path, &hello("1")).is_ok());
    }

    /// Any text, often one with a meaning in TOML, in JSON, in a comment or to a terminal.
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

    /// Any value, often one at the limit of a setting.
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
                // A device accepts no others.
                settings.set(number, *value).ok();
            }
            let (_folder, path) = new_file("a.toml");
            fs::write(&path, text(&hello, &settings)).unwrap();
            let backup = read(&path).unwrap();
            prop_assert!(backup.check_owner(&path, &hello).is_ok(), "{:?} {hello:?}", backup.owner);
            let mut restored = Settings::default();
            backup.values.apply(&mut restored).unwrap();
            prop_assert_eq!(changes(&settings, &restored), []);
            // Nor does it trigger anything on a terminal that shows it.
            let text = fs::read_to_string(&path).unwrap();
            prop_assert!(text.lines().all(|line| printable(line) == line), "{text:?}");
        }
    }
}
