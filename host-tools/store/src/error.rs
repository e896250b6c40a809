//! What may go wrong with a store.

use std::{
    io,
    path::{Path, PathBuf},
};

use inerter_data::recording::RecordingError;
use miette::Diagnostic;

use crate::{
    place::VERSION,
    row::{LONGEST_ROW_KB, MOST_COLUMNS},
};

/// Why a store cannot be used, or not in this way.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum StoreError {
    /// There is no store at this address.
    #[error("there is no store at {url}")]
    #[diagnostic(
        code(inerter::store::none),
        help("check the address; `inerter store add {url} FILE` makes a store with its first run")
    )]
    None { url: String },
    /// The place holds something else.
    #[error("{url} holds files, but no store")]
    #[diagnostic(code(inerter::store::foreign), help("name an empty folder, or one that does not exist yet"))]
    Foreign { url: String },
    /// A later version of the program has written it.
    #[error("the store at {url} is of version {version}; this program reads up to version {VERSION}")]
    #[diagnostic(code(inerter::store::newer), help("install a newer inerter; nothing was changed"))]
    Newer { url: String, version: u64 },
    /// The program cannot use this kind of address.
    #[error("{url} cannot be used as a store: {problem}")]
    #[diagnostic(code(inerter::store::address), help("{help}"))]
    Address { url: String, problem: String, help: String },
    /// A file of the store cannot be read or written.
    #[error("{file} in the store {url} cannot be {action}: {source}")]
    #[diagnostic(code(inerter::store::access), help("{}", access_help(source)))]
    Access {
        url: String,
        /// Its file, from the root of the store.
        file: String,
        /// `read`, `written`, `listed` or `removed`.
        action: &'static str,
        source: io::Error,
    },
    /// The contents of a file in the store are invalid.
    #[error("{file} in the store {url} is damaged: {problem}")]
    #[diagnostic(code(inerter::store::damaged), help("`inerter store verify {url}` lists all that is damaged"))]
    Damaged { url: String, file: String, problem: String },
    /// A row is longer than any of ours, or has more columns; it is not used.
    #[error("{file} in the store {url} is longer than {LONGEST_ROW_KB} KB or has more than {MOST_COLUMNS} columns")]
    #[diagnostic(
        code(inerter::store::long_row),
        help(
            "`inerter store verify {url} --repair` rebuilds it from its recording; if it is still oversized then, its recording holds the long text: remove the run with `inerter store remove`, then record it again with shorter text and add that; nothing was changed"
        )
    )]
    LongRow { url: String, file: String },
    /// The row of a recording would be too long, or have too many columns.
    #[error(
        "{file} cannot be added: its row would be longer than {LONGEST_ROW_KB} KB or have more than {MOST_COLUMNS} columns"
    )]
    #[diagnostic(
        code(inerter::store::long_texts),
        help(
            "find the long text in `inerter info --json`, about the device or the truth of a simulation, and record it shorter; nothing was added"
        )
    )]
    LongTexts { file: String },
    /// No run has this name.
    #[error("the store {url} has no run {run}")]
    #[diagnostic(
        code(inerter::store::no_run),
        help("`inerter store ls {url}` lists the runs; the beginning of a name is enough")
    )]
    NoRun { url: String, run: String },
    /// Several runs' names begin like this.
    #[error("{count} runs in the store {url} begin with {run}")]
    #[diagnostic(code(inerter::store::ambiguous), help("give more of the name"))]
    Ambiguous { url: String, run: String, count: usize },
    /// The file is not a recording.
    #[error("{path} is not a recording", path = path.display())]
    #[diagnostic(
        code(inerter::store::no_recording),
        help("a store holds recordings (.mcap): `inerter record` makes one, and `inerter cut` a part of one")
    )]
    NoRecording { path: PathBuf },
    /// A recording was changed while it was added.
    #[error("{path} changed while it was added", path = path.display())]
    #[diagnostic(code(inerter::store::changed), help("add it when its recording has ended; nothing was added"))]
    Changed { path: PathBuf },
    /// A condition cannot be parsed.
    #[error("`{condition}` is not a condition: {problem}")]
    #[diagnostic(code(inerter::store::condition), help("{help}"))]
    Condition { condition: String, problem: String, help: String },
    /// The name of a batch is invalid.
    #[error("`{name}` cannot be the name of a batch")]
    #[diagnostic(code(inerter::store::batch), help("use letters, digits, - and _, at most 80 of them"))]
    Batch { name: String },
    /// A batch was made by another command or with other settings.
    #[error("the batch {name} was made by {kind} with the settings {given}")]
    #[diagnostic(code(inerter::store::other_batch), help("choose another name for this one, or redo the whole batch"))]
    OtherBatch { name: String, kind: String, given: String },
    /// A recording cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Data(#[from] inerter_data::Error),
}

impl From<inerter_data::settings::SettingsInputError> for StoreError {
    fn from(error: inerter_data::settings::SettingsInputError) -> Self {
        Self::Data(error.into())
    }
}

impl From<inerter_data::output::OutputError> for StoreError {
    fn from(error: inerter_data::output::OutputError) -> Self {
        Self::Data(error.into())
    }
}

/// The error for a recording that cannot be read.
pub(crate) fn unreadable(path: &Path) -> impl Fn(io::Error) -> StoreError + Copy + '_ {
    |source| inerter_data::Error::from(RecordingError::Read { path: path.into(), source }).into()
}

fn access_help(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::PermissionDenied => {
            "ask for permission to this folder or bucket, or use another store; S3 takes AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "free some space, then try again",
        io::ErrorKind::NotFound => {
            "check that the bucket or folder is there; `inerter store verify` says what is missing in a store"
        }
        io::ErrorKind::TimedOut | io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionReset => {
            "check the address and the network, then try again: what was done before is kept"
        }
        _ => "try again: what was done before is kept",
    }
}
