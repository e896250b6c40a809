//! The source tree: where it is, and which parts of it are built for the board's chip; and file access, with errors
//! that name the file.
//!
//! A relative path starts at the root.

use anyhow::{Context, Result};
use std::{
    fs,
    io::{self, ErrorKind},
    path::{MAIN_SEPARATOR, Path, PathBuf},
};

/// The triple of every Cortex-M4F image.
pub const FIRMWARE_TARGET: &str = "thumbv7em-none-eabihf";

/// Packages that are built for the target only.
pub const FIRMWARE_PACKAGES: &[&str] = &["inerter-qemu", "inerter-stm32g474"];

/// The workspace's root folder.
pub fn root() -> PathBuf {
    // This file's crate is two folders below the root. The run-time variable has priority, so that a moved tree works.
    let here = std::env::var_os("CARGO_MANIFEST_DIR")
        .map(PathBuf::from)
        .filter(|path| path.ends_with("host-tools/xtask"))
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")));
    here.ancestors().nth(2).map(Path::to_path_buf).unwrap_or(here)
}

/// A path below a folder, without that folder; `/` separates its parts on every system.
pub fn below(path: &Path, folder: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).display().to_string().replace(MAIN_SEPARATOR, "/")
}

/// The bytes of a file.
pub fn read(file: impl AsRef<Path>) -> Result<Vec<u8>> {
    named("read", file.as_ref(), fs::read)
}

/// The text of a file.
pub fn text(file: impl AsRef<Path>) -> Result<String> {
    named("read", file.as_ref(), fs::read_to_string)
}

/// The text of a file; none if there is no such file.
pub fn text_if_there(file: impl AsRef<Path>) -> Result<String> {
    named("read", file.as_ref(), |path| match fs::read_to_string(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(String::new()),
        result => result,
    })
}

/// Writes a file.
pub fn write(file: impl AsRef<Path>, content: impl AsRef<[u8]>) -> Result<()> {
    named("write", file.as_ref(), |path| fs::write(path, content))
}

/// Creates a folder if there is none.
pub fn make(folder: impl AsRef<Path>) -> Result<()> {
    named("make", folder.as_ref(), fs::create_dir_all)
}

/// Removes a folder with its contents, if it exists.
pub fn remove(folder: impl AsRef<Path>) -> Result<()> {
    named("remove", folder.as_ref(), |path| if path.exists() { fs::remove_dir_all(path) } else { Ok(()) })
}

/// All files below a folder, in order.
pub fn files(folder: impl AsRef<Path>) -> Result<Vec<PathBuf>> {
    files_except(folder, |_| false)
}

/// The same without those in some folders.
pub fn files_except(folder: impl AsRef<Path>, left_out: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in named("read", &folder, fs::read_dir)? {
            let entry = entry?;
            if !entry.file_type()?.is_dir() {
                files.push(entry.path());
            } else if !left_out(&entry.path()) {
                folders.push(entry.path());
            }
        }
    }
    files.sort();
    Ok(files)
}

fn named<T>(what: &str, path: &Path, action: impl FnOnce(PathBuf) -> io::Result<T>) -> Result<T> {
    action(root().join(path)).with_context(|| format!("cannot {what} {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_holds_the_workspace() {
        assert!(root().join("memory.x").is_file());
    }
}
