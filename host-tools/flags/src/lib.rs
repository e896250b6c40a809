#![doc = include_str!("../README.md")]
//!
//! The file is the one of `--config FILE`, else of the variable `INERTER_CONFIG`, else `inerter.toml` in the current
//! folder. A key at the top is a flag of every command that has it, a table belongs to one command.
//!
//! ```toml
//! connect = "127.0.0.1:7878"
//! [record]
//! duration = 60
//! [calibrate.skew]
//! duration = 30
//! ```

mod error;

pub use error::ConfigError;
use error::VARIABLE;

use std::{ffi::OsString, path::PathBuf};

use clap::{Arg, ArgAction, Command};
use inerter_data::{settings::text_of, words::nearest};
use toml::{Table, Value};

/// Name of the file in the current folder.
const FILE: &str = "inerter.toml";

/// What a file that was only found may not set, as it may be anybody's.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// Long names of flags that let a command replace or erase something, on a disk or a device, or name what it
    /// writes, what is run or which chip it is for, or let others in.
    pub grave: &'a [&'a str],
    /// Whether `HOST:PORT` is of this machine; asked of each flag whose value has that name.
    pub is_here: fn(&str) -> bool,
}

/// A file with flags.
#[derive(Debug, PartialEq)]
pub struct FlagsFile {
    /// Its name.
    pub path: PathBuf,
    /// Whether the user named it. One that was found in the folder may be anybody's.
    pub is_named: bool,
}

/// The words that may be flags: those before `--`. Behind it are names of files, which a pattern like `*` may have put
/// there.
fn before_files(arguments: &[OsString]) -> impl Iterator<Item = &OsString> {
    arguments.iter().take_while(|argument| *argument != "--")
}

/// The file that holds for this command line, if any.
pub fn file(arguments: &[OsString]) -> Option<FlagsFile> {
    let named = |path: PathBuf| FlagsFile { path, is_named: true };
    let mut arguments = before_files(arguments).skip(1);
    while let Some(argument) = arguments.next() {
        if argument == "--config" {
            return arguments.next().map(|path| named(path.into()));
        }
        if let Some(name) = argument.to_str().and_then(|argument| argument.strip_prefix("--config=")) {
            return Some(named(name.into()));
        }
    }
    match std::env::var_os(VARIABLE) {
        Some(name) => Some(named(name.into())).filter(|file| !file.path.as_os_str().is_empty()),
        None => Some(FlagsFile { path: FILE.into(), is_named: false }).filter(|file| file.path.is_file()),
    }
}

/// The flags of a file that hold for a command line: each as it would be typed, and the line with them put in.
#[derive(Debug)]
pub struct Applied {
    /// From the file.
    pub flags: Vec<OsString>,
    /// All words.
    pub line: Vec<OsString>,
}

/// Puts the file's flags in where nothing was typed.
///
/// # Errors
///
/// [`ConfigError`] where the file cannot be read, is no TOML, names what there is not or what may not be set, or gives
/// a value that the flag does not take; also where it is for another command than the one that was typed.
pub fn apply(command: &Command, file: &FlagsFile, typed: &[OsString], rules: &Rules) -> Result<Applied, ConfigError> {
    let path = &file.path;
    let text = text_of(path).map_err(|source| ConfigError::File { path: path.into(), source })?;
    let table: Table = text.parse().map_err(|error: toml::de::Error| {
        let before = text.get(..error.span().map_or(0, |span| span.start)).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        ConfigError::Toml { path: path.into(), line, message: error.message().into() }
    })?;
    let chosen = chosen(command, typed);
    let mut reader = Reader { file, rules, typed, chosen: &chosen, flags: Vec::new() };
    // Below first: what stands there for one command wins over what stands above for all.
    for (name, value) in table.iter().filter(|(_, value)| value.is_table()) {
        reader.table(command, &[], name, value)?;
    }
    for (name, value) in table.iter().filter(|(_, value)| !value.is_table()) {
        reader.shared(command, name, value)?;
    }
    let flags: Vec<OsString> = reader.flags.into_iter().map(|(_, flag)| flag).collect();
    let (before, after) = typed.split_at(chosen.at.min(typed.len()));
    Ok(Applied { line: [before, &flags, after].concat(), flags })
}

/// The command that was typed.
struct Chosen<'a> {
    command: &'a Command,
    /// Names of the commands on the way to it.
    path: Vec<&'a str>,
    /// Where its own arguments begin.
    at: usize,
}

fn chosen<'a>(command: &'a Command, typed: &[OsString]) -> Chosen<'a> {
    let mut chosen = Chosen { command, path: Vec::new(), at: 1 };
    loop {
        let Some(argument) = typed.get(chosen.at).and_then(|argument| argument.to_str()) else { return chosen };
        if argument == "--config" {
            chosen.at += 2;
        } else if argument.starts_with("--config=") {
            chosen.at += 1;
        } else if let Some(below) = chosen.command.find_subcommand(argument) {
            chosen.path.push(below.get_name());
            chosen.command = below;
            chosen.at += 1;
        } else {
            return chosen;
        }
    }
}

struct Reader<'a> {
    file: &'a FlagsFile,
    rules: &'a Rules<'a>,
    typed: &'a [OsString],
    chosen: &'a Chosen<'a>,
    /// Each with its form as typed.
    flags: Vec<(&'a Arg, OsString)>,
}

impl<'a> Reader<'a> {
    /// A flag of every command that has it.
    fn shared(&mut self, command: &Command, name: &str, value: &Value) -> Result<(), ConfigError> {
        let all = all_flags(command);
        let mut holders = all.iter().filter(|arg| is_called(arg, name)).peekable();
        if holders.peek().is_none() {
            return Err(self.unknown("flag", name, all.into_iter().map(long)));
        }
        holders.try_for_each(|arg| self.check(arg, name, value))?;
        if let Some(arg) = flag(self.chosen.command, name) {
            self.put(arg, value);
        }
        Ok(())
    }

    /// The flags of one command, and tables of those below it.
    fn table(&mut self, command: &'a Command, above: &[&str], name: &str, value: &Value) -> Result<(), ConfigError> {
        let what = if above.is_empty() { "command".into() } else { format!("flag or command of {}", above.join(" ")) };
        let Some(command) = command.find_subcommand(name) else {
            return Err(self.unknown(&what, name, command.get_subcommands().map(Command::get_name)));
        };
        let path: Vec<&str> = above.iter().copied().chain([name]).collect();
        for (entry, value) in value.as_table().into_iter().flatten() {
            if value.is_table() {
                self.table(command, &path, entry, value)?;
                continue;
            }
            let Some(arg) = flag(command, entry) else {
                return Err(self.unknown(&format!("flag of {}", path.join(" ")), entry, flags(command).map(long)));
            };
            self.check(arg, &format!("{}.{entry}", path.join(".")), value)?;
            if self.chosen.path == path {
                self.put(arg, value);
            }
        }
        Ok(())
    }

    fn unknown<'b>(&self, what: &str, name: &str, candidates: impl Iterator<Item = &'b str>) -> ConfigError {
        let candidates: Vec<String> = candidates.map(|candidate| candidate.replace('-', "_")).collect();
        let help = match nearest(name, candidates.iter().map(String::as_str)) {
            Some(nearest) => format!("did you mean `{nearest}`?"),
            None => "`inerter help` lists the commands, `inerter COMMAND --help` the flags of each".into(),
        };
        ConfigError::Unknown { path: self.file.path.clone(), what: what.into(), name: name.into(), help }
    }

    /// Whether the flag takes this value.
    fn check(&self, arg: &Arg, key: &str, value: &Value) -> Result<(), ConfigError> {
        let wrong = |message: String| ConfigError::Value {
            path: self.file.path.clone(),
            key: key.into(),
            message,
            help: format!("write what would follow --{} on the command line", long(arg)),
        };
        let is_address = arg.get_value_names().is_some_and(|names| names.iter().any(|name| name == "HOST:PORT"));
        let elsewhere = || texts(value).is_ok_and(|places| !places.iter().all(|place| (self.rules.is_here)(place)));
        if !self.file.is_named && (self.rules.grave.contains(&long(arg)) || is_address && elsewhere()) {
            return Err(ConfigError::Found { path: self.file.path.clone(), key: key.into() });
        }
        if is_switch(arg) {
            return if value.is_bool() { Ok(()) } else { Err(wrong("this flag takes true or false".into())) };
        }
        let values = texts(value).map_err(wrong)?;
        if values.len() != 1 && !matches!(arg.get_action(), ArgAction::Append) {
            return Err(wrong("one value is needed, not a list".into()));
        }
        values.iter().try_for_each(|value| readable(arg, value)).map_err(wrong)
    }

    /// Adds the flag, unless something was typed that it does not go with, itself included.
    fn put(&mut self, arg: &'a Arg, value: &Value) {
        let (name, command) = (long(arg), self.chosen.command);
        let told =
            |other: &Arg| before_files(self.typed).filter_map(|typed| typed.to_str()).any(|typed| says(typed, other));
        let clashes = |other: &Arg| other == arg || excludes(command, arg, other);
        let excluded = command.get_arguments().any(|other| clashes(other) && told(other));
        let is_set = self.flags.iter().any(|(set, _)| clashes(set));
        if excluded || is_set {
            return;
        }
        match value.as_bool().filter(|_| is_switch(arg)) {
            Some(false) => {}
            Some(true) => self.flags.push((arg, format!("--{name}").into())),
            None => {
                let texts = texts(value).unwrap_or_default();
                self.flags.extend(texts.iter().map(|text| (arg, format!("--{name}={text}").into())));
            }
        }
    }
}

/// Whether what was typed is this flag, long or short.
fn says(typed: &str, arg: &Arg) -> bool {
    let rest = arg.get_long().and_then(|long| typed.strip_prefix("--")?.strip_prefix(long));
    let short = arg.get_short().is_some_and(|short| {
        typed.strip_prefix('-').is_some_and(|rest| !rest.starts_with('-') && rest.starts_with(short))
    });
    short || rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
}

/// Whether either of two arguments excludes the other.
fn excludes(command: &Command, arg: &Arg, other: &Arg) -> bool {
    let names = |one: &Arg, two: &Arg| {
        one != two && command.get_arg_conflicts_with(one).iter().any(|conflict| conflict.get_id() == two.get_id())
    };
    names(arg, other) || names(other, arg)
}

fn is_switch(arg: &Arg) -> bool {
    matches!(arg.get_action(), ArgAction::SetTrue)
}

/// Reads a value as the flag would.
fn readable(arg: &Arg, value: &str) -> Result<(), String> {
    let alone = Arg::new("value").long("value").allow_hyphen_values(true).value_parser(arg.get_value_parser().clone());
    let command = Command::new("").no_binary_name(true).arg(alone);
    command.try_get_matches_from([format!("--value={value}")]).map(drop).map_err(|error| {
        let reason = std::error::Error::source(&error).map(|source| format!(": {source}")).unwrap_or_default();
        format!("`{value}` cannot be used{reason}")
    })
}

/// What would be typed.
fn texts(value: &Value) -> Result<Vec<String>, String> {
    Ok(match value {
        Value::String(text) => vec![text.clone()],
        Value::Integer(number) => vec![number.to_string()],
        Value::Float(number) => vec![format!("{number:?}")],
        Value::Boolean(yes) => vec![yes.to_string()],
        Value::Array(values) => values.iter().map(texts).collect::<Result<Vec<_>, _>>()?.concat(),
        Value::Datetime(_) | Value::Table(_) => return Err("a string, a number, true or false is needed".into()),
    })
}

fn long(arg: &Arg) -> &str {
    arg.get_long().unwrap_or_default()
}

/// Whether this is the flag's name, with - or _ between its words.
fn is_called(arg: &Arg, name: &str) -> bool {
    long(arg) == name.replace('_', "-")
}

fn flag<'a>(command: &'a Command, name: &str) -> Option<&'a Arg> {
    flags(command).find(|arg| is_called(arg, name))
}

/// These say what to do, not how.
const BUILT_IN: [&str; 3] = ["help", "version", "config"];

fn flags(command: &Command) -> impl Iterator<Item = &Arg> {
    command.get_arguments().filter(|arg| arg.get_long().is_some_and(|long| !BUILT_IN.contains(&long)))
}

/// The flags of a command and of those below it.
fn all_flags(command: &Command) -> Vec<&Arg> {
    flags(command).chain(command.get_subcommands().flat_map(all_flags)).collect()
}

/// Whether the command ignores the file of flags (help, version).
pub fn is_about_the_program(arguments: &[OsString]) -> bool {
    let first = arguments.get(1).and_then(|first| first.to_str());
    first.is_some_and(|first| ["completions", "man", "help", "-h", "--help", "-V", "--version"].contains(&first))
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};
    use miette::Diagnostic;

    use super::*;

    #[derive(Parser)]
    struct Flags {
        #[command(subcommand)]
        command: Verb,
    }

    #[derive(clap::Subcommand)]
    enum Verb {
        Record {
            #[arg(long)]
            duration: Option<f64>,
            #[arg(long, conflicts_with = "connect")]
            port: Option<String>,
            #[arg(long, value_name = "HOST:PORT")]
            connect: Option<String>,
            #[arg(long)]
            force: bool,
            #[arg(short, long, required = true)]
            output: String,
            #[arg(long)]
            set: Vec<String>,
        },
    }

    fn line(words: &[&str]) -> Vec<OsString> {
        words.iter().map(OsString::from).collect()
    }

    fn read(text: &str, typed: &[&str]) -> Result<Verb, String> {
        read_file(text, typed, true)
    }

    fn read_file(text: &str, typed: &[&str], is_named: bool) -> Result<Verb, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("inerter.toml");
        std::fs::write(&path, text).unwrap();
        let typed = line(&[&["inerter", "record"][..], typed].concat());
        let rules = Rules {
            grave: &["force", "output"],
            is_here: |place| !place.contains("10.") && !place.contains("example"),
        };
        let applied =
            apply(&Flags::command(), &FlagsFile { path: path.clone(), is_named }, &typed, &rules).map_err(|error| {
                let help = error.help().map(|help| help.to_string()).unwrap_or_default();
                format!("{error}; {help}").replace(&path.display().to_string(), "inerter.toml")
            })?;
        Flags::try_parse_from(applied.line).map(|rig| rig.command).map_err(|error| error.to_string())
    }

    #[test]
    fn the_file_gives_defaults_and_what_is_typed_wins() {
        let text =
            "port = \"COM5\"\n[record]\nduration = 60\nforce = true\noutput = \"run.mcap\"\nset = [\"a=1\", \"b=2\"]\n";
        let Verb::Record { duration, port, connect, force, output, set } = read(text, &[]).unwrap();
        assert_eq!((duration, port.as_deref(), connect, force), (Some(60.0), Some("COM5"), None, true));
        assert_eq!((output.as_str(), set), ("run.mcap", vec!["a=1".to_string(), "b=2".to_string()]));
        let typed = ["--duration", "5", "--connect=h:1", "-o", "x.mcap", "--set", "c=3"];
        let Verb::Record { duration, port, connect, output, set, .. } = read(text, &typed).unwrap();
        assert_eq!((duration, port, connect.as_deref()), (Some(5.0), None, Some("h:1")));
        assert_eq!((output.as_str(), set), ("x.mcap", vec!["c=3".to_string()]));
        let Verb::Record { port, .. } =
            read("[record]\noutput = \"o\"\nconnect = \"h:1\"\n", &["--port", "p"]).unwrap();
        assert_eq!(port.as_deref(), Some("p"));
    }

    #[test]
    fn mistakes_are_named_with_the_next_step() {
        for (text, expected) in [
            ("prot = \"COM5\"\n", "inerter.toml: there is no flag `prot`; did you mean `port`?"),
            ("[recrod]\nduration = 1\n", "inerter.toml: there is no command `recrod`; did you mean `record`?"),
            (
                "[record]\ndurations = 1\n",
                "inerter.toml: there is no flag of record `durations`; did you mean `duration`?",
            ),
            (
                "[record]\nduration = \"long\"\n",
                "inerter.toml: record.duration: `long` cannot be used: invalid float literal; write what would follow --duration",
            ),
            ("[record]\nduration = [1, 2]\n", "inerter.toml: record.duration: one value is needed, not a list"),
            ("[record]\nforce = 1\n", "inerter.toml: record.force: this flag takes true or false"),
            ("[record]\nhelp = true\n", "there is no flag of record `help`"),
            ("port = \"p\"\n[record\n", "inerter.toml, line 2: unclosed table, expected `]`"),
        ] {
            let error = read(text, &["-o", "x"]).err().unwrap_or_default();
            assert!(error.starts_with(expected) || error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn a_file_is_found_by_its_flag_first() {
        let named = |name: &str| Some(FlagsFile { path: name.into(), is_named: true });
        assert_eq!(file(&line(&["inerter", "ports", "--config", "a.toml"])), named("a.toml"));
        assert_eq!(file(&line(&["inerter", "--config=b.toml", "ports"])), named("b.toml"));
    }

    #[test]
    fn a_name_behind_two_dashes_is_no_flag() {
        for words in [
            &["inerter", "info", "--", "--config=evil.toml", "run.mcap"][..],
            &["inerter", "info", "--", "--config", "evil.toml"],
        ] {
            assert_ne!(file(&line(words)).map(|file| file.path), Some(PathBuf::from("evil.toml")));
        }
        let words = line(&["inerter", "--config=a.toml", "info", "--", "x"]);
        assert_eq!(file(&words).map(|file| file.path), Some(PathBuf::from("a.toml")));
        // Nor does a file with the name of a flag keep the flag file from setting that flag.
        let typed = line(&["inerter", "record", "-o", "x", "--", "--duration=1"]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("inerter.toml");
        std::fs::write(&path, "duration = 60\n").unwrap();
        let rules = Rules { grave: &[], is_here: |_| true };
        let applied = apply(&Flags::command(), &FlagsFile { path, is_named: true }, &typed, &rules).unwrap();
        assert_eq!(applied.flags, ["--duration=60"]);
    }

    #[test]
    fn a_file_that_was_only_found_sets_nothing_that_is_written_and_no_address_elsewhere() {
        for (text, key) in [
            ("[record]\nforce = true\n", "record.force"),
            ("force = true\n", "force"),
            ("[record]\noutput = \"/etc/passwd\"\n", "record.output"),
            ("connect = \"10.0.0.1:7878\"\n", "connect"),
            ("[record]\nconnect = \"example.org:7878\"\n", "record.connect"),
        ] {
            let error = read_file(text, &["-o", "x"], false).err().unwrap_or_default();
            assert!(error.contains(&format!("was not named explicitly, so it may not set `{key}`")), "{text}: {error}");
        }
        for place in ["127.0.0.1:7878", "localhost:7878", "[::1]:7878"] {
            let Verb::Record { connect, .. } =
                read_file(&format!("connect = \"{place}\"\n"), &["-o", "x"], false).unwrap();
            assert_eq!(connect.as_deref(), Some(place));
        }
    }
}
