//! Which commit a figure belongs to.

use crate::{process, tree};
use std::process::Command;

/// Placeholder for an unknown commit.
pub const UNKNOWN: &str = "unknown";

/// The commit that is checked out, and whether the tree differs from it.
pub fn commit() -> String {
    let mut git = Command::new("git");
    git.args(["describe", "--always", "--dirty", "--exclude", "*"]).current_dir(tree::root());
    process::first_line(&mut git).unwrap_or_else(|| UNKNOWN.to_owned())
}
