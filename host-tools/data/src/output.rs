//! Writing results: to standard output, and to files that may meet a full disk.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use miette::Diagnostic;
use tempfile::TempPath;

use crate::words::printable;

/// Why something could not be written.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum OutputError {
    /// The file cannot be created.
    #[error("{path} cannot be created: {source}", path = path.display())]
    #[diagnostic(code(inerter::output::create), help("{}", create_help(source, path)))]
    Create {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
    /// The file is there already, and holds something.
    #[error("{path} exists already", path = path.display())]
    #[diagnostic(code(inerter::output::exists), help("choose another name, or add --force to replace it"))]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Writing failed part of the way.
    #[error("{name} cannot be written{}: {source}", progress(written))]
    #[diagnostic(code(inerter::output::write), help("{}", write_help(source, written)))]
    Write {
        /// The file, or `standard output`.
        name: String,
        /// What was written before, for a person; empty when that is of no use.
        written: String,
        /// The reason.
        source: io::Error,
    },
}

impl OutputError {
    /// Wraps a failed write to `name`.
    pub fn write(name: impl Into<String>, source: io::Error) -> Self {
        Self::Write { name: name.into(), written: String::new(), source }
    }
}

fn progress(written: &str) -> String {
    if written.is_empty() { String::new() } else { format!(" any further, after {written}") }
}

fn create_help(source: &io::Error, path: &Path) -> String {
    match source.kind() {
        io::ErrorKind::NotFound => match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => format!("make the folder {} first", folder.display()),
            _ => "give the file a name".into(),
        },
        io::ErrorKind::PermissionDenied => "write into a folder of your own, or change its permissions".into(),
        io::ErrorKind::IsADirectory => "that is a folder: add a file name to it".into(),
        _ => "write to another place".into(),
    }
}

fn write_help(source: &io::Error, written: &str) -> String {
    let kept = if written.is_empty() { "" } else { "; what was written so far can be read" };
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            format!("the disk is full: free some space, or write to another disk{kept}")
        }
        io::ErrorKind::FileTooLarge => {
            format!("no larger file is allowed here (ulimit -f, or the file system): write to another disk{kept}")
        }
        _ => format!("check the disk, or write to another one{kept}"),
    }
}

/// Creates a file to be filled, buffered.
pub fn create(path: &Path) -> Result<BufWriter<File>, OutputError> {
    File::create(path).map(BufWriter::new).map_err(|source| OutputError::Create { path: path.into(), source })
}

/// A file that takes its name when it is complete: what stood there before stays until then.
#[derive(Debug)]
pub struct Pending {
    path: PathBuf,
    /// `None` for a pipe or a device, which are written as they are.
    temporary: Option<TempPath>,
}

impl Pending {
    /// Begins a file beside the one that it will be.
    pub fn create(path: &Path) -> Result<Self, OutputError> {
        let special = path.metadata().is_ok_and(|metadata| !metadata.is_file());
        if special {
            return Ok(Self { path: path.into(), temporary: None });
        }
        let failed = |source| OutputError::Create { path: path.into(), source };
        let name = path.file_name().ok_or_else(|| failed(io::ErrorKind::InvalidInput.into()))?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        let prefix = format!(".{}.", name.to_string_lossy());
        builder.prefix(&prefix).suffix(".part");
        // As any new file: temporary ones are closed to others.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let file = builder.tempfile_in(folder).map_err(|error| failed(plain(error)))?;
        Ok(Self { path: path.into(), temporary: Some(file.into_temp_path()) })
    }

    /// The path to write to.
    pub fn path(&self) -> &Path {
        self.temporary.as_deref().unwrap_or(&self.path)
    }

    /// Opens it, empty.
    pub fn open(&self) -> Result<File, OutputError> {
        File::create(self.path()).map_err(|source| OutputError::Create { path: self.path.clone(), source })
    }

    /// The name that it will have, for messages.
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Gives it its name, and says it.
    pub fn commit(self) -> Result<PathBuf, OutputError> {
        if let Some(temporary) = self.temporary {
            let persisted = temporary.persist(&self.path);
            persisted.map_err(|error| OutputError::Create { path: self.path.clone(), source: error.error })?;
        }
        Ok(self.path)
    }
}

/// As the operating system gave it, without the temporary name, which would only puzzle.
fn plain(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path ") {
        Some((reason, _)) => io::Error::new(error.kind(), reason),
        None => error,
    }
}

/// Refuses to go on when `path` is an ordinary file that holds something already.
pub fn refuse_existing(path: &Path) -> Result<(), OutputError> {
    match path.metadata() {
        Ok(metadata) if metadata.is_file() && metadata.len() > 0 => Err(OutputError::Exists { path: path.into() }),
        _ => Ok(()),
    }
}

/// Writes one line to standard output, [`printable`].
pub fn line(line: impl AsRef<str>) -> Result<(), OutputError> {
    text(printable(line.as_ref())).and_then(|()| text("\n"))
}

/// Writes lines to standard output, each [`printable`].
pub fn lines(lines: impl AsRef<str>) -> Result<(), OutputError> {
    lines.as_ref().lines().try_for_each(line)
}

/// Writes to standard output as it is.
pub fn text(text: impl AsRef<str>) -> Result<(), OutputError> {
    io::stdout()
        .lock()
        .write_all(text.as_ref().as_bytes())
        .map_err(|source| OutputError::write("standard output", source))
}

/// Hands everything to standard output's reader; without it a full disk would go unnoticed.
pub fn flush() -> Result<(), OutputError> {
    io::stdout().lock().flush().map_err(|source| OutputError::write("standard output", source))
}
