//! Settings from the command line and from TOML files.
//!
//! Later ones win: the run's own (a recording's, or the defaults for a CSV), then `--settings FILE.toml`, then `--set`,
//! then dedicated flags such as `--metres-per-count`.

use std::{
    fs::File,
    io::{self, Read},
    ops::Range,
    path::{Path, PathBuf},
};

use inerter_core::{Settings, SettingsError};
use miette::Diagnostic;
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::{
    calibration::{self, Calibration},
    output::{self, OutputError},
    words::{bracketed, nearest, printable},
};

/// Why settings were refused. `origin` says where the setting was given.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SettingsInputError {
    /// No setting has this name.
    #[error("{origin}: there is no setting `{name}`")]
    #[diagnostic(code(inerter::settings::unknown), help("{}", unknown_help(name)))]
    Unknown { origin: String, name: String },
    /// `--set` without `key=value`.
    #[error("{origin}: `{text}` is not of the form key=value")]
    #[diagnostic(code(inerter::settings::form), help("write for example --set structure_mass_kg=1.515"))]
    Form { origin: String, text: String },
    /// The value is not a number.
    #[error("{origin}: {name}: `{text}` is not a number")]
    #[diagnostic(
        code(inerter::settings::number),
        help("write a number in {}, with a point: 0.002 or 2e-3", unit_words(name))
    )]
    Number { origin: String, name: String, text: String },
    /// The value is invalid.
    #[error("{origin}: {source}")]
    #[diagnostic(code(inerter::settings::value), help("{}", value_help(source)))]
    Value { origin: String, source: SettingsError },
    /// The combined settings contradict each other.
    #[error("the settings cannot be used: {source}")]
    #[diagnostic(code(inerter::settings::refused), help("{}", value_help(source)))]
    Refused { source: SettingsError },
    /// The table on the calibration is invalid.
    #[error("{origin}: [calibration]: {problem}")]
    #[diagnostic(
        code(inerter::settings::calibration),
        help(
            "write for example `date = 2026-01-31`, `certificate = \"K-2031\"` and `expires = 2027-01-31` below [calibration]"
        )
    )]
    Calibration { origin: String, problem: String },
    /// The file cannot be read.
    #[error("the settings file {path} cannot be read: {source}", path = path.display())]
    #[diagnostic(
        code(inerter::settings::file),
        help("check the name; the file is TOML with lines like `memory_s = 30`")
    )]
    File { path: PathBuf, source: io::Error },
    /// The file is not TOML.
    #[error("the settings file {path}, line {line}: {message}", path = path.display())]
    #[diagnostic(code(inerter::settings::toml), help("each line is `name = number`, for example `memory_s = 30`"))]
    Toml { path: PathBuf, line: usize, message: String },
}

/// Settings that the user gave, which override the run's own.
#[derive(Clone, Debug)]
pub struct Overrides {
    values: [Option<f64>; Settings::COUNT],
    calibration: Option<Calibration>,
}

impl Default for Overrides {
    fn default() -> Self {
        Self { values: [None; Settings::COUNT], calibration: None }
    }
}

impl Overrides {
    /// Reads the TOML file and then the assignments `key=value`; later ones win.
    pub fn from_inputs(file: Option<&Path>, assignments: &[String]) -> Result<Self, SettingsInputError> {
        let mut overrides = Self::default();
        if let Some(path) = file {
            overrides.read_toml(path)?;
        }
        for text in assignments {
            overrides.assign(text)?;
        }
        Ok(overrides)
    }

    /// Sets one value by its name.
    pub fn set(&mut self, name: &str, value: f64, origin: &str) -> Result<(), SettingsInputError> {
        let unknown = || SettingsInputError::Unknown { origin: origin.into(), name: name.into() };
        let mut entries = Settings::TABLE.iter().zip(&mut self.values);
        let (info, slot) = entries.find(|(info, _)| info.name == name).ok_or_else(unknown)?;
        info.check(value).map_err(|source| SettingsInputError::Value { origin: origin.into(), source })?;
        *slot = Some(value);
        Ok(())
    }

    /// The value given for this setting, if any.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.values.get(Settings::find(name)?).copied().flatten()
    }

    /// The rig's calibration in the file, if there is one.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_ref()
    }

    /// The given values, by name.
    pub fn given(&self) -> impl Iterator<Item = (&'static str, f64)> {
        Settings::TABLE.iter().zip(&self.values).filter_map(|(info, value)| Some((info.name, (*value)?)))
    }

    /// Writes the given values into `settings`.
    pub fn apply(&self, settings: &mut Settings) -> Result<(), SettingsInputError> {
        for (number, value) in self.values.iter().enumerate() {
            if let Some(value) = *value {
                settings.set(number, value).map_err(|source| SettingsInputError::Refused { source })?;
            }
        }
        Ok(())
    }

    /// True when nothing was given.
    pub fn is_empty(&self) -> bool {
        self.values.iter().all(Option::is_none)
    }

    fn assign(&mut self, text: &str) -> Result<(), SettingsInputError> {
        let origin = "--set";
        let (name, value) = text
            .split_once('=')
            .ok_or_else(|| SettingsInputError::Form { origin: origin.into(), text: text.into() })?;
        let value = value.trim();
        self.set_written(name.trim(), value, value.parse().ok(), origin)
    }

    /// Sets one value, both as it is written and as a number.
    fn set_written(
        &mut self,
        name: &str,
        text: &str,
        value: Option<f64>,
        origin: &str,
    ) -> Result<(), SettingsInputError> {
        match value {
            // An unknown name is reported first.
            None if Settings::find(name).is_some() => {
                Err(SettingsInputError::Number { origin: origin.into(), name: name.into(), text: text.into() })
            }
            value => self.set(name, value.unwrap_or_default(), origin),
        }
    }

    fn read_toml(&mut self, path: &Path) -> Result<(), SettingsInputError> {
        let text = text_of(path).map_err(|source| SettingsInputError::File { path: path.into(), source })?;
        let table = DeTable::parse(&text).map_err(|error| SettingsInputError::Toml {
            path: path.into(),
            line: line_of(&text, error.span()),
            message: error.message().into(),
        })?;
        for (key, value) in table.get_ref().iter() {
            let origin = format!("{}, line {}", path.display(), line_of(&text, Some(key.span())));
            let name: &str = key.get_ref();
            if let (calibration::TABLE, DeValue::Table(table)) = (name, value.get_ref()) {
                let read = Calibration::of_table(table);
                self.calibration = Some(read.map_err(|problem| SettingsInputError::Calibration { origin, problem })?);
                continue;
            }
            let (shown, number) = written(&text, value);
            self.set_written(name, shown, number, &origin)?;
        }
        Ok(())
    }
}

/// The settings as a TOML file that [`Overrides::from_inputs`] reads back to the same bits.
pub fn to_toml(settings: &Settings) -> String {
    let mut text = String::new();
    for ((info, about), value) in Settings::described().zip(settings.values()) {
        text += &format!("# {}{}\n{} = {value:?}\n", about.help, bracketed(about.unit), info.name);
    }
    text
}

/// The name of the settings beside a CSV: `run.csv` gets `run.settings.toml`.
pub fn beside(csv: &Path) -> PathBuf {
    csv.with_extension("settings.toml")
}

/// Writes the settings beside a CSV and returns the file's name. Replaces an existing file only with `replace`.
pub fn write_beside(
    settings: &Settings,
    calibration: Option<&Calibration>,
    csv: &Path,
    replace: bool,
) -> Result<PathBuf, OutputError> {
    let path = beside(csv);
    let calibration = calibration.map(Calibration::to_toml).unwrap_or_default();
    let text = format!("# Settings of {}\n{}{calibration}", printable(&csv.display().to_string()), to_toml(settings));
    output::write(&path, replace, text)?;
    Ok(path)
}

/// The text of a file that a person writes, of settings or flags. A file above 1 MB is rejected unread.
pub fn text_of(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    if File::open(path)?.take(LONGEST + 1).read_to_string(&mut text)? as u64 > LONGEST {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, "it is longer than 1 MB"));
    }
    Ok(text)
}

/// Maximum size of such a file \[bytes\].
const LONGEST: u64 = 1 << 20;

/// The rig's calibration in a settings file; an error if there is none.
pub fn calibration(path: &Path) -> Result<Calibration, SettingsInputError> {
    let none = || SettingsInputError::Calibration {
        origin: path.display().to_string(),
        problem: "there is no such table".into(),
    };
    Overrides::from_inputs(Some(path), &[])?.calibration().cloned().ok_or_else(none)
}

/// The line of a text in which a span begins, from 1.
pub(crate) fn line_of(text: &str, span: Option<Range<usize>>) -> usize {
    let start = span.map_or(0, |span| span.start);
    text.bytes().take(start).filter(|byte| *byte == b'\n').count() + 1
}

/// A TOML value as written, and as a number.
pub(crate) fn written<'a>(text: &'a str, value: &Spanned<DeValue>) -> (&'a str, Option<f64>) {
    let shown = text.get(value.span()).unwrap_or_default().trim();
    let is_number = matches!(value.get_ref(), DeValue::Integer(_) | DeValue::Float(_));
    (shown, shown.replace('_', "").parse().ok().filter(|_| is_number))
}

/// The range of a setting.
pub(crate) fn range_of(name: &str) -> (f64, f64) {
    Settings::TABLE.iter().find(|info| info.name == name).map_or((f64::MIN, f64::MAX), |info| (info.min, info.max))
}

/// Checks the settings as a whole; the error names the faulty one.
pub fn validate(settings: &Settings) -> Result<inerter_core::Active, SettingsInputError> {
    settings.validate().map_err(|source| SettingsInputError::Refused { source })
}

fn unknown_help(name: &str) -> String {
    match nearest(name, Settings::TABLE.iter().map(|info| info.name)) {
        Some(nearest) => format!("did you mean `{nearest}`? `inerter replay --help` lists them all"),
        None => "`inerter replay --help` lists all settings".into(),
    }
}

fn unit_words(name: &str) -> String {
    let unit = Settings::find(name).and_then(|number| Settings::TEXTS.get(number)).map_or("", |text| text.unit);
    if unit.is_empty() { "plain digits".into() } else { format!("units of {unit}") }
}

fn value_help(error: &SettingsError) -> String {
    let field = match *error {
        SettingsError::Unknown => return "`inerter replay --help` lists all settings".into(),
        SettingsError::Conflict { field, other, .. } => return format!("change {field} or {other}"),
        SettingsError::NotFinite { field }
        | SettingsError::OutOfRange { field, .. }
        | SettingsError::NotWhole { field, .. }
        | SettingsError::Zero { field }
        | SettingsError::NotOffered { field, .. } => field,
    };
    match Settings::described().find(|(info, _)| info.name == field) {
        Some((info, text)) => {
            let unit = if text.unit.is_empty() { String::new() } else { format!(" {}", text.unit) };
            format!("{}; from {:?} to {:?}{unit}, by default {:?}", text.help, info.min, info.max, info.default)
        }
        None => format!("give {field} another value"),
    }
}

/// All settings, for the end of a command's help.
pub fn help_table() -> String {
    let mut text = String::from("Settings for --set and --settings, with their defaults:\n");
    for (info, about) in Settings::described() {
        let line = format!("  {} = {:?} {}", info.name, info.default, about.unit);
        text += &format!("{}\n      {}\n", line.trim_end(), about.help);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::new_file;

    /// The settings of a file.
    fn settings_of(path: &Path) -> Settings {
        let mut settings = Settings::default();
        Overrides::from_inputs(Some(path), &[]).unwrap().apply(&mut settings).unwrap();
        settings
    }

    fn sets(assignments: &[&str]) -> Result<Overrides, SettingsInputError> {
        Overrides::from_inputs(None, &assignments.iter().map(|text| text.to_string()).collect::<Vec<_>>())
    }

    #[test]
    fn later_assignments_win() {
        let overrides = sets(&["memory_s=10", "memory_s = 20"]).unwrap();
        let mut settings = Settings::default();
        overrides.apply(&mut settings).unwrap();
        assert_eq!(settings.memory_s, 20.0);
    }

    #[test]
    fn a_misspelt_name_is_refused_with_the_nearest_one() {
        let error = sets(&["structure_mas=1"]).unwrap_err();
        assert!(error.help().unwrap().to_string().contains("`structure_mass_kg`"));
        let error = sets(&["stiffness=1"]).unwrap_err();
        assert!(error.help().unwrap().to_string().contains("`stiffness_n_per_m`"));
    }

    #[test]
    fn what_is_no_number_or_not_finite_is_refused_naming_the_setting() {
        for text in ["memory_s=ten", "memory_s=", "memory_s=1,5"] {
            assert!(
                matches!(sets(&[text]).unwrap_err(), SettingsInputError::Number { ref name, .. } if name == "memory_s")
            );
        }
        for text in ["memory_s=NaN", "memory_s=inf"] {
            assert!(sets(&[text]).unwrap_err().to_string().contains("memory_s: the value is not a finite number"));
        }
        assert!(sets(&["memory_s"]).unwrap_err().to_string().contains("key=value"));
    }

    #[test]
    fn a_toml_file_names_the_line_of_a_mistake() {
        let (_folder, path) = new_file("s.toml");
        for (text, expected) in [
            ("memory_s = 20\nmemry = 3\n", "line 2: there is no setting `memry`"),
            ("memory_s = 20\nskew_s = 1.0\n", "line 2: skew_s: 1 is outside"),
            ("memory_s = \"20\"\n", "line 1: memory_s: `\"20\"` is not a number"),
            ("\n\nmemory_s 20\n", "line 3"),
            ("memory_s = nan\n", "memory_s: the value is not a finite number"),
            ("[settings]\nmemory_s = 20\n", "line 1: there is no setting `settings`"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = Overrides::from_inputs(Some(&path), &[]).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn settings_written_as_toml_read_back_to_the_same_bits() {
        let (_folder, path) = new_file("s.toml");
        let settings = Settings { metres_per_count: 0.005 / 2048.0, stiffness_n_per_m: 2.1e6, ..Settings::default() };
        std::fs::write(&path, to_toml(&settings)).unwrap();
        assert_eq!(settings_of(&path), settings);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_without_an_end_is_refused() {
        let error = Overrides::from_inputs(Some(Path::new("/dev/zero")), &[]).unwrap_err().to_string();
        assert!(error.contains("it is longer than 1 MB"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn settings_beside_a_csv_read_back_whatever_its_name() {
        let (_folder, csv) = new_file("a\u{1b}[2J\nmemory_s = 9\r.csv");
        let settings = Settings { memory_s: 7.0, ..Settings::default() };
        let path = write_beside(&settings, None, &csv, false).unwrap();
        assert_eq!(settings_of(&path), settings);
    }
}
