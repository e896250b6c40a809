//! What a store asks of the place where its files lie.

use std::{
    io::{self, Read},
    path::PathBuf,
};

/// Most bytes of a file that is read at once: rows and sums have some kilobytes, results some tens.
const SMALL: usize = 16 << 20;

/// What there is, where it is there.
pub(crate) fn found<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        result => result.map(Some),
    }
}

/// A place for files: each whole or not there, under a name with `/`.
pub(crate) trait Files: Send + Sync {
    /// Writes a file, in place of one that is there. Nobody sees a part of it, and what cannot be read to its end is
    /// not written.
    fn put(&self, name: &str, from: &mut dyn Read) -> io::Result<()>;
    /// Hands over the bytes of a file from the first to the last.
    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()>;
    /// Names of the files below this folder, in alphabetical order. Of nothing there is nothing.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;
    /// Whether nothing at all is there.
    fn is_empty(&self) -> io::Result<bool>;
    /// Removes a file; one that is not there is no fault.
    fn remove(&self, name: &str) -> io::Result<()>;
    /// Removes what a writer left behind that was ended.
    fn remove_unfinished(&self) -> io::Result<()>;
    /// Where it lies on this computer, where it does.
    fn file(&self, name: &str) -> Option<PathBuf>;
    /// Whether a file is there.
    fn has(&self, name: &str) -> io::Result<bool>;

    /// All of a small file.
    fn get(&self, name: &str) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.read(name, &mut |part| {
            bytes.extend_from_slice(part);
            if bytes.len() > SMALL { Err(io::Error::other("it is far too long")) } else { Ok(()) }
        })?;
        Ok(bytes)
    }
}
