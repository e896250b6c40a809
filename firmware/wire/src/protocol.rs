//! Tables of records and commands: the only place where their numbers, names and meanings are written.

pub use crate::messages::{Entry, WIRE_VERSION};
use crate::{Command, Record};

/// Every record, by number.
pub const RECORDS: &[Entry] = Record::TABLE;

/// Every command, by number.
pub const COMMANDS: &[Entry] = Command::TABLE;
