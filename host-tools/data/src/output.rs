//! Writes results to standard output and to files, on disks that may fill up.

use std::{
    collections::BTreeSet,
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use miette::Diagnostic;
use tempfile::TempPath;

use crate::words::printable;

/// Why something could not be written.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum OutputError {
    /// The file cannot be created.
    #[error("{path} cannot be created: {source}", path = path.display())]
    #[diagnostic(code(inerter::output::create), help("{}", create_help(source, path)))]
    Create { path: PathBuf, source: io::Error },
    /// The file already exists.
    #[error("{path} exists already", path = path.display())]
    #[diagnostic(code(inerter::output::exists), help("choose another name, or add --force to replace it"))]
    Exists { path: PathBuf },
    /// The file is one that the same command reads or writes.
    #[error("{path} is another file of this command, and would be overwritten", path = path.display())]
    #[diagnostic(code(inerter::output::input), help("choose another name"))]
    Input { path: PathBuf },
    /// The format's feature is not built in.
    #[error("{path} cannot be written: `inerter-data` was built without its format", path = path.display())]
    #[diagnostic(code(inerter::output::built_without), help("add the feature `parquet` or `matlab`"))]
    BuiltWithout { path: PathBuf },
    /// Writing failed partway.
    #[error("{name} cannot be written{}: {source}", progress(written))]
    #[diagnostic(code(inerter::output::write), help("{}", write_help(source, written)))]
    Write {
        /// The file, or `standard output`.
        name: String,
        /// What was written before, for a person; empty if that is of no use.
        written: String,
        source: io::Error,
    },
}

/// What another program did to a file while it was being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Disturbance {
    /// It no longer has a name.
    #[error("another program deleted it")]
    Deleted,
    /// Its name is gone or belongs to another file.
    #[error("another program moved it or replaced it")]
    Moved,
    /// It is shorter or longer than the data written.
    #[error("another program shortened it or wrote into it")]
    Changed,
}

impl Disturbance {
    fn help(self) -> &'static str {
        match self {
            Self::Deleted => "what was written is lost: write it again, and leave the file alone until it is complete",
            Self::Moved => {
                "the data written so far, if any, is in the file that was moved: leave a file alone until it is complete"
            }
            Self::Changed => {
                "the file is damaged: write it again under another name, and let no other program write to it"
            }
        }
    }
}

impl From<Disturbance> for io::Error {
    fn from(disturbance: Disturbance) -> Self {
        Self::other(disturbance)
    }
}

impl OutputError {
    /// Wraps a failed write to `name`.
    pub fn write(name: impl Into<String>, source: io::Error) -> Self {
        Self::Write { name: name.into(), written: String::new(), source }
    }

    fn create(path: &Path, source: io::Error) -> Self {
        match source.kind() {
            io::ErrorKind::AlreadyExists => Self::Exists { path: path.into() },
            _ => Self::Create { path: path.into(), source },
        }
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
    if let Some(disturbance) = source.get_ref().and_then(|inner| inner.downcast_ref::<Disturbance>()) {
        return disturbance.help().into();
    }
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

/// Creates a file that has its final name from the start. Replaces an existing file only with `replace`; a pipe or a
/// device is written directly.
pub fn create(path: &Path, replace: bool) -> Result<File, OutputError> {
    let mut options = OpenOptions::new();
    options.write(true);
    if !is_special(path) {
        options.create_new(!replace).create(true).truncate(replace);
    }
    options.open(path).map_err(|source| OutputError::create(path, source))
}

/// Writes a file whole or not at all.
pub fn write(path: &Path, replace: bool, bytes: impl AsRef<[u8]>) -> Result<(), OutputError> {
    let pending = Pending::create(path, replace)?;
    let written = pending.open()?.write_all(bytes.as_ref());
    written.map_err(|source| OutputError::write(pending.name(), source))?;
    pending.commit().map(drop)
}

/// Files that do not have their final names yet.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes every [`Pending`] file, for a program that ends at once: none can be created or completed after this.
pub fn remove_unfinished() {
    let unfinished = unfinished();
    for path in unfinished.iter() {
        fs::remove_file(path).ok();
    }
    // The lock is never released.
    std::mem::forget(unfinished);
}

/// A file that gets its name when it is complete; an existing file stays until then.
#[derive(Debug)]
pub struct Pending {
    path: PathBuf,
    replace: bool,
    /// `None` for a pipe or a device, which are written directly.
    temporary: Option<TempPath>,
}

impl Pending {
    /// Begins a temporary file beside the final one. Replaces an existing file only with `replace`.
    pub fn create(path: &Path, replace: bool) -> Result<Self, OutputError> {
        if is_special(path) {
            return Ok(Self { path: path.into(), replace, temporary: None });
        }
        if !replace {
            refuse_existing(path)?;
        }
        let failed = |source| OutputError::Create { path: path.into(), source };
        let name = path.file_name().ok_or_else(|| failed(io::ErrorKind::InvalidInput.into()))?;
        let mut builder = tempfile::Builder::new();
        let prefix = format!(".{}.", name.to_string_lossy());
        builder.prefix(&prefix).suffix(".part");
        // The permissions of any new file: temporary files are private by default.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut unfinished = unfinished();
        let file = builder.tempfile_in(folder_of(path)).map_err(|error| failed(plain(error)))?;
        unfinished.insert(file.path().into());
        Ok(Self { path: path.into(), replace, temporary: Some(file.into_temp_path()) })
    }

    /// The path to write to.
    pub fn path(&self) -> &Path {
        self.temporary.as_deref().unwrap_or(&self.path)
    }

    /// Opens it as an empty file.
    pub fn open(&self) -> Result<File, OutputError> {
        File::create(self.path()).map_err(|source| OutputError::Create { path: self.path.clone(), source })
    }

    /// Its final name, for messages.
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Gives it its final name once it is safely on disk, and returns the name.
    pub fn commit(mut self) -> Result<PathBuf, OutputError> {
        if self.temporary.is_some() {
            let synced = OpenOptions::new().write(true).open(self.path()).and_then(|file| synced(file.sync_all()));
            synced.map_err(|source| OutputError::write(self.name(), source))?;
            self.give_name()?;
            sync_folder(&self.path).map_err(|source| OutputError::write(self.name(), source))?;
        }
        Ok(std::mem::take(&mut self.path))
    }

    fn give_name(&mut self) -> Result<(), OutputError> {
        let mut unfinished = unfinished();
        let Some(temporary) = self.temporary.take() else { return Ok(()) };
        unfinished.remove(&*temporary);
        let named = if self.replace {
            temporary.persist(&self.path)
        } else {
            temporary.persist_noclobber(&self.path).or_else(|refused| match refused.error.kind() {
                // A file system such as exFAT, which cannot do both in one step.
                kind if kind != io::ErrorKind::AlreadyExists && self.path.symlink_metadata().is_err() => {
                    refused.path.persist(&self.path)
                }
                _ => Err(refused),
            })
        };
        named.map_err(|refused| OutputError::create(&self.path, refused.error))
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        let mut unfinished = unfinished();
        if let Some(temporary) = self.temporary.take() {
            unfinished.remove(&*temporary);
        }
    }
}

/// Whether it exists and is not a regular file.
fn is_special(path: &Path) -> bool {
    path.metadata().is_ok_and(|metadata| !metadata.is_file())
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Syncs the name of a file to disk: without it a power failure may leave data without a name.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    // On other systems folders cannot be opened; one without read permission cannot be synchronised either.
    if cfg!(unix) { File::open(folder_of(path)).map_or(Ok(()), |folder| synced(folder.sync_all())) } else { Ok(()) }
}

/// Pipes, devices and some file systems cannot be synchronised, which is not an error.
pub(crate) fn synced(result: io::Result<()>) -> io::Result<()> {
    result.or_else(|error| match error.kind() {
        io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported => Ok(()),
        _ => Err(error),
    })
}

/// The operating system's error, without the temporary name, which would only confuse.
fn plain(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path ") {
        Some((reason, _)) => io::Error::new(error.kind(), reason),
        None => error,
    }
}

/// Fails if `path` is a regular file, even an empty one, or a dangling link.
pub fn refuse_existing(path: &Path) -> Result<(), OutputError> {
    let is_there = path.symlink_metadata().is_ok() && !is_special(path);
    if is_there { Err(OutputError::Exists { path: path.into() }) } else { Ok(()) }
}

/// Fails if a file to be written is also read, through whatever path.
pub fn refuse_inputs<'a>(written: &[&Path], read: impl IntoIterator<Item = &'a Path>) -> Result<(), OutputError> {
    // For a file that does not exist yet, compare its folder.
    let place = |path: &Path| {
        let beside = || Some(folder_of(path).canonicalize().ok()?.join(path.file_name()?));
        path.canonicalize().ok().or_else(beside).unwrap_or_else(|| path.into())
    };
    let is_one = |one: &Path, other: &Path| place(one) == place(other);
    for read in read {
        if let Some(path) = written.iter().find(|path| is_one(path, read) && !is_special(path)) {
            return Err(OutputError::Input { path: path.to_path_buf() });
        }
    }
    Ok(())
}

/// Writes one line to standard output, [`printable`].
pub fn line(line: impl AsRef<str>) -> Result<(), OutputError> {
    line_to(&mut io::stdout().lock(), line)
}

/// Writes one line, [`printable`], to standard output, or to what stands for it in a test.
pub fn line_to(out: &mut impl Write, line: impl AsRef<str>) -> Result<(), OutputError> {
    writeln!(out, "{}", printable(line.as_ref())).map_err(|source| OutputError::write("standard output", source))
}

/// Writes lines to standard output, each [`printable`].
pub fn lines(lines: impl AsRef<str>) -> Result<(), OutputError> {
    lines.as_ref().lines().try_for_each(line)
}

/// Writes text to standard output unchanged.
pub fn text(text: impl AsRef<str>) -> Result<(), OutputError> {
    io::stdout()
        .lock()
        .write_all(text.as_ref().as_bytes())
        .map_err(|source| OutputError::write("standard output", source))
}

/// Flushes standard output; without this a full disk would go unnoticed.
pub fn flush() -> Result<(), OutputError> {
    io::stdout().lock().flush().map_err(|source| OutputError::write("standard output", source))
}
