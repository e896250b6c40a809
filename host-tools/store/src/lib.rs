//! A store of recorded runs, in a folder or in S3-compatible storage.
//!
//! Glossary: a *store* holds runs; a *run* is one recording with its tables, and is named by the SHA-256 of the
//! recording; a *row* is its entry in the table `runs`.
//!
//! Recordings are never changed. Everything else follows from them: the same recording added twice, or by many
//! processes at once, gives the same files with the same bytes. A run exists while its row does, which is written last
//! and removed first; the remains of an interrupted process are not a run, and adding the recording again completes
//! them. docs/STORE.md describes the layout, for those who read the files without this crate.

mod choice;
mod error;
mod files;
mod folder;
mod place;
mod results;
mod row;
#[cfg(feature = "s3")]
mod s3;
mod store;
mod sums;
mod tables;

pub use choice::{Choice, Condition, Day};
pub use error::StoreError;
pub use place::{Place, VERSION};
pub use results::{Outcome, Shard};
pub use row::{OBJECTS, Row};
pub use store::{Added, Damage, Listed, Local, Store, Verified};

/// Whether stores at `s3://` are built in: the feature `s3`, which another package of the same build may switch on.
pub const HAS_S3: bool = cfg!(feature = "s3");

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
