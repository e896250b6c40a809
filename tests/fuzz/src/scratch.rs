//! Temporary files for readers that need a path.

use std::{env, fs, path::Path};

use tempfile::{Builder, TempPath};

/// A unique path, in memory if the system has a place for that. Dropping it removes the file.
pub fn path() -> TempPath {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { memory.into() } else { env::temp_dir() };
    let unmade = Builder::new().prefix("inerter-fuzz-").make_in(folder, |_| Ok(()));
    unmade.expect("a path of its own").into_temp_path()
}

/// A file with these bytes.
pub fn file(bytes: &[u8]) -> TempPath {
    let path = path();
    fs::write(&path, bytes).expect("a place for files");
    path
}
