//! What a store needs from the place that holds its files.

use std::{
    io::{self, Read},
    path::PathBuf,
};

/// Maximum size of a small file \[bytes\]: sums have a kilobyte.
pub(crate) const SMALL: usize = 1 << 20;

/// The result, or `None` if there is no such file.
pub(crate) fn found<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        result => result.map(Some),
    }
}

/// Storage for files: each is either complete or absent, under a name with `/`.
pub(crate) trait Files: Send + Sync {
    /// Writes a file, replacing an existing one. Nobody sees a partial file, and a source that cannot be read to its
    /// end is not written.
    fn put(&self, name: &str, from: &mut dyn Read) -> io::Result<()>;
    /// Passes the bytes of a file to `take`, from first to last.
    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()>;
    /// Names of the files below this folder, in alphabetical order; empty if the folder does not exist.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;
    /// Whether the storage is completely empty.
    fn is_empty(&self) -> io::Result<bool>;
    /// Removes a file; a missing one is not an error.
    fn remove(&self, name: &str) -> io::Result<()>;
    /// Removes the remains of an interrupted writer.
    fn remove_unfinished(&self) -> io::Result<()>;
    /// Its path on this computer, if it is local.
    fn file(&self, name: &str) -> Option<PathBuf>;
    /// Whether a file exists.
    fn has(&self, name: &str) -> io::Result<bool>;

    /// The contents of a file, or `None` if they are longer than this: then the rest is not read.
    fn get_up_to(&self, name: &str, longest: usize) -> io::Result<Option<Vec<u8>>> {
        let (mut bytes, mut is_longer) = (Vec::new(), false);
        let read = self.read(name, &mut |part| {
            is_longer = part.len() > longest - bytes.len();
            if is_longer {
                return Err(io::ErrorKind::Other.into());
            }
            bytes.extend_from_slice(part);
            Ok(())
        });
        if is_longer { Ok(None) } else { read.map(|()| Some(bytes)) }
    }
}
