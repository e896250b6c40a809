//! A store in a folder.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
};

use inerter_data::output::{OutputError, Pending, sync_folder};

use crate::files::{Files, found};

/// Bytes read at once.
const PORTION: usize = 1 << 16;

/// Files below a folder.
pub(crate) struct Folder {
    root: PathBuf,
}

impl Folder {
    pub(crate) fn new(root: PathBuf) -> Self {
        Self { root }
    }

    fn path(&self, name: &str) -> PathBuf {
        name.split('/').filter(|part| !part.is_empty()).fold(self.root.clone(), |path, part| path.join(part))
    }

    /// Regular files below a folder: links and pipes are not ours, and a read of one might never end.
    fn walk(folder: &Path, name: &str, take: &mut dyn FnMut(String, PathBuf) -> io::Result<()>) -> io::Result<()> {
        for entry in found(fs::read_dir(folder))?.into_iter().flatten() {
            let entry = entry?;
            let Ok(part) = entry.file_name().into_string() else { continue };
            let name = if name.is_empty() { part } else { format!("{name}/{part}") };
            let kind = entry.file_type()?;
            if kind.is_dir() {
                Self::walk(&entry.path(), &name, take)?;
            } else if kind.is_file() {
                take(name, entry.path())?;
            }
        }
        Ok(())
    }
}

/// The last part of a name.
fn last(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// A file being written, or left unfinished.
fn is_unfinished(name: &str) -> bool {
    last(name).starts_with('.') && name.ends_with(".part")
}

impl Files for Folder {
    fn put(&self, name: &str, from: &mut dyn Read) -> io::Result<()> {
        let path = self.path(name);
        // A pipe or a link there is not ours, and would be written through.
        if fs::symlink_metadata(&path).is_ok_and(|metadata| !metadata.is_file()) {
            fs::remove_file(&path)?;
        }
        let new_folder = path.parent().filter(|folder| !folder.exists());
        let pending = begun(&path)?;
        io::copy(from, &mut pending.open().map_err(reason)?)?;
        pending.commit().map_err(reason)?;
        // The names of new folders must be synced to disk too, or the file cannot be found.
        let folders = new_folder.into_iter().flat_map(Path::ancestors);
        folders.take_while(|folder| *folder != self.root).try_for_each(sync_folder)?;
        // Makes the file read-only. On other systems a read-only file cannot be removed either.
        #[cfg(unix)]
        fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o444))?;
        Ok(())
    }

    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        let path = self.path(name);
        if !fs::symlink_metadata(&path).map_err(absent)?.is_file() {
            return Err(io::Error::other("it is not a regular file"));
        }
        let mut file = File::open(path).map_err(absent)?;
        let mut portion = vec![0; PORTION];
        loop {
            match file.read(&mut portion)? {
                0 => return Ok(()),
                count => take(portion.get(..count).unwrap_or_default())?,
            }
        }
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        Self::walk(&self.path(folder), folder, &mut |name, _| {
            if !is_unfinished(&name) {
                names.push(name);
            }
            Ok(())
        })?;
        names.sort();
        Ok(names)
    }

    fn is_empty(&self) -> io::Result<bool> {
        let mut entries = found(fs::read_dir(&self.root))?.into_iter().flatten();
        // Another process may be writing the first file.
        let is_other = |entry: &io::Result<fs::DirEntry>| {
            !entry.as_ref().is_ok_and(|entry| is_unfinished(&entry.file_name().to_string_lossy()))
        };
        Ok(entries.find(is_other).transpose()?.is_none())
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        let path = self.path(name);
        found(fs::remove_file(&path).map_err(absent))?;
        // Folders are removed with their last file; one that holds another stays.
        let mut folder = path.parent();
        while let Some(empty) = folder.filter(|folder| *folder != self.root && fs::remove_dir(folder).is_ok()) {
            folder = empty.parent();
        }
        Ok(())
    }

    fn remove_unfinished(&self) -> io::Result<()> {
        Self::walk(&self.root, "", &mut |name, path| if is_unfinished(&name) { fs::remove_file(path) } else { Ok(()) })
    }

    fn file(&self, name: &str) -> Option<PathBuf> {
        Some(self.path(name))
    }

    fn has(&self, name: &str) -> io::Result<bool> {
        let metadata = found(fs::symlink_metadata(self.path(name)).map_err(absent))?;
        Ok(metadata.is_some_and(|metadata| metadata.is_file()))
    }
}

/// Below a path that is not a folder there are no files.
fn absent(error: io::Error) -> io::Error {
    if error.kind() == io::ErrorKind::NotADirectory { io::ErrorKind::NotFound.into() } else { error }
}

/// Begins a file; another process may remove the folder while it is still empty.
fn begun(path: &Path) -> io::Result<Pending> {
    let mut attempts = 0..8;
    loop {
        let folder = path.parent().map_or(Ok(()), fs::create_dir_all);
        match folder.and_then(|()| Pending::create(path, true).map_err(reason)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound && attempts.next().is_some() => {}
            begun => return begun,
        }
    }
}

/// The system's reason alone: the store adds the file name.
fn reason(error: OutputError) -> io::Error {
    match error {
        OutputError::Create { source, .. } | OutputError::Write { source, .. } => source,
        OutputError::Exists { .. } | OutputError::Input { .. } => io::ErrorKind::AlreadyExists.into(),
        OutputError::BuiltWithout { .. } => io::ErrorKind::Unsupported.into(),
    }
}
