//! Copies of the tree that can be changed and built beside it.

use crate::{process, tree};
use anyhow::{Context, Result, ensure};
use std::{collections::BTreeSet, fs, path::Path, process::Command};

/// One change of a source: file, passage that is in it exactly once, replacement.
pub type Edit = (&'static str, &'static str, &'static str);

/// Makes `copy` equal to the tree below these folders, or to all of it if none is given; ignored files are left out.
/// Only what differs is written, as cargo takes a file with a new time for a new file.
pub fn tree(copy: &Path, below: &[&str]) -> Result<()> {
    let mut command = Command::new("git");
    command.args(["ls-files", "--cached", "--others", "--exclude-standard", "-z", "--"]).args(below);
    let listed = process::output(command.current_dir(tree::root()))?;
    let files: BTreeSet<&Path> =
        listed.split_terminator('\0').map(Path::new).filter(|file| tree::root().join(file).is_file()).collect();
    let mut folders = Vec::from_iter(copy.is_dir().then(|| copy.to_owned()));
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.strip_prefix(copy).is_ok_and(|file| !files.contains(file)) {
                fs::remove_file(&path)?;
            }
        }
    }
    for file in files {
        let bytes = fs::read(tree::root().join(file)).with_context(|| format!("cannot read {}", file.display()))?;
        written(&copy.join(file), &bytes)?;
    }
    Ok(())
}

/// Makes these changes in the files below `folder`.
pub fn edit(folder: &Path, edits: &[Edit]) -> Result<()> {
    for (file, text, instead) in edits {
        let path = folder.join(file);
        let source = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let found = source.matches(text).count();
        ensure!(found == 1, "`{text}` is in {file} {found} times, not once; update host-tools/xtask/src/ablation");
        written(&path, source.replace(text, instead).as_bytes())?;
    }
    Ok(())
}

/// Writes what is not there already.
pub fn written(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::read(path).is_ok_and(|present| present == bytes) {
        return Ok(());
    }
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
