//! Which commit a figure belongs to.

use crate::{process, tree};
use std::process::Command;

/// Where campaigns write their results, which are no part of what they try.
const RESULTS: [&str; 2] = [":!docs/tables", ":!tests/mutants"];

/// The commit that is checked out, with `-dirty` if the tree differs from it; "unknown" outside of a repository.
pub fn commit() -> String {
    let git = |arguments: &[&str]| process::first_line(Command::new("git").args(arguments).current_dir(tree::root()));
    let Some(hash) = git(&["rev-parse", "--short", "HEAD"]) else { return "unknown".to_owned() };
    let changes = git(&[&["status", "--porcelain", "--untracked-files=no", "--"][..], &RESULTS].concat());
    hash + if changes.is_some() { "-dirty" } else { "" }
}
