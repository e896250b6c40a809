//! Temporary files for readers that need a path.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process,
    sync::atomic::{AtomicU32, Ordering},
};

/// A path to a temporary file, in memory if the system has a place for that. Dropping it removes the file.
pub struct Scratch(PathBuf);

impl Scratch {
    /// A unique path.
    pub fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() { memory.into() } else { env::temp_dir() };
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self(folder.join(format!("inerter-fuzz-{}-{number}", process::id())))
    }

    /// A file with these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        let scratch = Self::new();
        fs::write(&scratch.0, bytes).expect("a place for files");
        scratch
    }

    /// The path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // The file may never have been written.
        let _ = fs::remove_file(&self.0);
    }
}
