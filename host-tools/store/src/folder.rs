//! A store in a folder.

use std::{
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
};

use inerter_data::output::{OutputError, Pending};

use crate::files::Files;

/// Bytes that are read at once.
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
        name.split('/').fold(self.root.clone(), |path, part| path.join(part))
    }

    fn walk(&self, folder: &Path, name: &str, names: &mut Vec<String>) -> io::Result<()> {
        let entries = match fs::read_dir(folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            entries => entries?,
        };
        for entry in entries {
            let entry = entry?;
            let Ok(part) = entry.file_name().into_string() else { continue };
            // A file that is being written.
            if part.starts_with('.') {
                continue;
            }
            let name = if name.is_empty() { part } else { format!("{name}/{part}") };
            if entry.file_type()?.is_dir() { self.walk(&entry.path(), &name, names)? } else { names.push(name) }
        }
        Ok(())
    }
}

impl Files for Folder {
    fn put(&self, name: &str, from: &mut dyn Read, _length: u64) -> io::Result<()> {
        let path = self.path(name);
        if path.exists() {
            return Ok(());
        }
        let written = pending(&path).and_then(|pending| {
            io::copy(from, &mut pending.open().map_err(reason)?)?;
            pending.commit().map_err(reason)
        });
        match written {
            // Another process was faster, with the same bytes.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
            written => {
                let mut permissions = fs::metadata(written?)?.permissions();
                permissions.set_readonly(true);
                fs::set_permissions(&path, permissions)
            }
        }
    }

    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        let mut file = File::open(self.path(name))?;
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
        self.walk(&self.path(folder), folder.trim_end_matches('/'), &mut names)?;
        names.sort();
        Ok(names)
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        let path = self.path(name);
        // Windows keeps what may not be written.
        #[cfg(windows)]
        if let Ok(metadata) = path.metadata() {
            let mut permissions = metadata.permissions();
            permissions.set_readonly(false);
            fs::set_permissions(&path, permissions)?;
        }
        match fs::remove_file(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed,
        }?;
        // Folders go with their last file; one that holds another stays.
        let mut folder = path.parent();
        while let Some(empty) = folder.filter(|folder| *folder != self.root && fs::remove_dir(folder).is_ok()) {
            folder = empty.parent();
        }
        Ok(())
    }

    fn file(&self, name: &str) -> Option<PathBuf> {
        Some(self.path(name))
    }

    fn has(&self, name: &str) -> io::Result<bool> {
        self.path(name).try_exists()
    }
}

/// Begins a file; another process may remove the folder, empty as it is, as soon as it is there.
fn pending(path: &Path) -> io::Result<Pending> {
    let mut attempts = 0..8;
    loop {
        path.parent().map_or(Ok(()), fs::create_dir_all)?;
        match Pending::create(path, false).map_err(reason) {
            Err(error) if error.kind() == io::ErrorKind::NotFound && attempts.next().is_some() => {}
            begun => return begun,
        }
    }
}

/// The system's reason alone: the store says which file.
fn reason(error: OutputError) -> io::Error {
    match error {
        OutputError::Create { source, .. } | OutputError::Write { source, .. } => source,
        OutputError::Exists { .. } => io::ErrorKind::AlreadyExists.into(),
    }
}
