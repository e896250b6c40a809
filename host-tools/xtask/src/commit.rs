//! Which commit a figure belongs to.

use crate::{process, tree};
use std::process::Command;

/// The commit that is checked out, and whether the tree differs from it; "unknown" outside of a repository.
pub fn commit() -> String {
    let describe = ["describe", "--always", "--dirty", "--exclude", "*"];
    process::first_line(Command::new("git").args(describe).current_dir(tree::root())).unwrap_or("unknown".to_owned())
}
