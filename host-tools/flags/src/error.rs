//! Why flags from a file cannot be used.

use std::path::PathBuf;

use miette::Diagnostic;

/// Variable that names another file; empty means none.
pub const VARIABLE: &str = "INERTER_CONFIG";

/// Why the file cannot be used.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ConfigError {
    /// It cannot be read.
    #[error("the flag file {path} cannot be read: {source}", path = path.display())]
    #[diagnostic(code(inerter::config::file), help("check the name after --config, or the variable {VARIABLE}"))]
    File { path: PathBuf, source: std::io::Error },
    /// It is not TOML.
    #[error("the flag file {path}, line {line}: {message}", path = path.display())]
    #[diagnostic(
        code(inerter::config::toml),
        help("flags are lines like `duration = 60`, for one command below a line like `[record]`")
    )]
    Toml { path: PathBuf, line: usize, message: String },
    /// It was only found, and sets what only a named one may.
    #[error("the flag file {path} was not named explicitly, so it may not set `{key}`", path = path.display())]
    #[diagnostic(
        code(inerter::config::found),
        help(
            "a file that is merely found in the folder may not set outputs, images to run, --force or addresses of other machines: type the flag, or \
             name the file with --config or {VARIABLE}"
        )
    )]
    Found { path: PathBuf, key: String },
    /// It names a flag or command that does not exist.
    #[error("the flag file {path}: there is no {what} `{name}`", path = path.display())]
    #[diagnostic(code(inerter::config::unknown), help("{help}"))]
    Unknown {
        path: PathBuf,
        /// What there is not: a flag, a command, a flag of a command.
        what: String,
        name: String,
        help: String,
    },
    /// It gives a value that the flag does not take.
    #[error("the flag file {path}: {key}: {message}", path = path.display())]
    #[diagnostic(code(inerter::config::value), help("{help}"))]
    Value { path: PathBuf, key: String, message: String, help: String },
}
