//! Why flags from a file cannot be used.

use std::path::PathBuf;

use miette::Diagnostic;

/// Variable that names another one; empty means none.
pub const VARIABLE: &str = "INERTER_CONFIG";

/// Why the file cannot be used.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ConfigError {
    #[error("the flags' file {path} cannot be read: {source}", path = path.display())]
    #[diagnostic(code(inerter::config::file), help("check the name after --config, or the variable {VARIABLE}"))]
    File { path: PathBuf, source: std::io::Error },
    #[error("the flags' file {path}, line {line}: {message}", path = path.display())]
    #[diagnostic(
        code(inerter::config::toml),
        help("flags are lines like `duration = 60`, for one command below a line like `[record]`")
    )]
    Toml { path: PathBuf, line: usize, message: String },
    #[error("the flags' file {path} was not named, so it may not set `{key}`", path = path.display())]
    #[diagnostic(
        code(inerter::config::found),
        help(
            "a file that lies in the folder sets no outputs, no images to run, no --force and no addresses of other machines: type the flag, or \
             name the file with --config or {VARIABLE}"
        )
    )]
    Found { path: PathBuf, key: String },
    #[error("the flags' file {path}: there is no {what} `{name}`", path = path.display())]
    #[diagnostic(code(inerter::config::unknown), help("{help}"))]
    Unknown { path: PathBuf, what: String, name: String, help: String },
    #[error("the flags' file {path}: {key}: {message}", path = path.display())]
    #[diagnostic(code(inerter::config::value), help("{help}"))]
    Value { path: PathBuf, key: String, message: String, help: String },
}
