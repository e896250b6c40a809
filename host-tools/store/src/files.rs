//! What a store asks of the place where its files lie.

use std::{
    io::{self, Read},
    path::PathBuf,
};

/// A place for files: each whole or not there, under a name with `/`.
pub(crate) trait Files: Send + Sync {
    /// Writes a file that is not there yet; one that is there stays as it is. Nobody sees a part of it.
    fn put(&self, name: &str, from: &mut dyn Read, length: u64) -> io::Result<()>;
    /// Hands over the bytes of a file from the first to the last.
    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()>;
    /// Names of the files that begin with this folder, in alphabetical order. Of nothing there is nothing.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;
    /// Removes a file; one that is not there is no fault.
    fn remove(&self, name: &str) -> io::Result<()>;

    /// Where it lies on this computer, where it does.
    fn file(&self, name: &str) -> Option<PathBuf>;
    /// Whether a file is there.
    fn has(&self, name: &str) -> io::Result<bool>;

    /// All of a small file.
    fn get(&self, name: &str) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.read(name, &mut |part| {
            bytes.extend_from_slice(part);
            Ok(())
        })?;
        Ok(bytes)
    }
}
