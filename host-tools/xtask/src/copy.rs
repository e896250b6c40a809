//! Copies of the tree that can be changed and built beside it.

use crate::{process, tree};
use anyhow::{Result, ensure};
use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// One change of a source: file, passage that must occur exactly once in it, replacement.
pub type Edit = (&'static str, &'static str, &'static str);

/// Makes `copy` equal to the tree below these folders, or to all of it if none is given; ignored files are left out.
/// Only files that differ are written, because cargo treats a file with a new time as changed.
pub fn tree(copy: &Path, below: &[&str]) -> Result<()> {
    let files = files(below)?;
    tree::make(copy)?;
    for path in tree::files(copy)? {
        if path.strip_prefix(copy).is_ok_and(|file| !files.contains(file)) {
            fs::remove_file(&path)?;
        }
    }
    for file in &files {
        written(&copy.join(file), &tree::read(file)?)?;
    }
    Ok(())
}

/// Paths from the root of the files that these patterns of git select, or of all; ignored files are left out.
pub fn files(patterns: &[&str]) -> Result<BTreeSet<PathBuf>> {
    let list = ["ls-files", "--cached", "--others", "--exclude-standard", "-z", "--"];
    let listed = process::output(Command::new("git").args(list).args(patterns).current_dir(tree::root()))?;
    Ok(listed.split_terminator('\0').map(PathBuf::from).filter(|file| tree::root().join(file).is_file()).collect())
}

/// Makes these changes in the files below `folder`.
pub fn edit(folder: &Path, edits: &[Edit]) -> Result<()> {
    for (file, text, instead) in edits {
        let path = folder.join(file);
        let source = tree::text(&path)?;
        let found = source.matches(text).count();
        ensure!(found == 1, "`{text}` is in {file} {found} times, not once; update host-tools/xtask/src/ablation");
        written(&path, source.replace(text, instead).as_bytes())?;
    }
    Ok(())
}

/// Writes a file unless it already has these contents.
pub fn written(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|present| present == bytes) {
        return Ok(());
    }
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    tree::write(path, bytes)
}
