//! The file of a recording, written by a separate thread, so that a slow disk does not delay reading the device.

use std::{
    fs::File,
    io::{self, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::{self, JoinHandle},
};

use crate::output::{Disturbance, sync_folder, synced};

/// Bytes after which a batch is handed over.
const BATCH: usize = 1 << 18;
/// Batches that may wait for the disk: half a minute of a live device. After that the producer waits too.
const WAITING: usize = 64;

/// How much of the recording is written \[ns\], shared by both threads.
#[derive(Clone, Debug, Default)]
pub(super) struct Safe {
    handed_over_ns: Arc<AtomicU64>,
    written_ns: Arc<AtomicU64>,
}

impl Safe {
    /// Sets the recording's duration at the next flush.
    pub(super) fn hand_over(&self, duration_ns: u64) {
        self.handed_over_ns.store(duration_ns, Ordering::Relaxed);
    }

    /// The duration that has reached the disk; 0 for a file that is not watched.
    pub(super) fn written_ns(&self) -> u64 {
        self.written_ns.load(Ordering::Relaxed)
    }
}

struct Batch {
    bytes: Vec<u8>,
    /// The recording's duration including this batch, if it ends with a whole frame \[ns\].
    until_ns: Option<u64>,
}

/// Accepts bytes in sequence; the file need not be seekable (a pipe, `/dev/full`).
pub(super) struct Sink {
    position: u64,
    waiting: Vec<u8>,
    safe: Safe,
    batches: Option<SyncSender<Batch>>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl Sink {
    /// Only writes, without syncing.
    pub(super) fn new(file: File, safe: Safe) -> io::Result<Self> {
        Self::start(Output { file, written: 0, watched: None }, safe)
    }

    /// Syncs each flush to disk, and checks that the file at `path` is still the one being written.
    pub(super) fn watching(path: &Path, file: File, safe: Safe) -> io::Result<Self> {
        let watched = file.metadata()?.is_file().then(|| path.into());
        Self::start(Output { file, written: 0, watched }, safe)
    }

    fn start(output: Output, safe: Safe) -> io::Result<Self> {
        let (batches, filled) = sync_channel(WAITING);
        let written = safe.clone();
        let thread = thread::Builder::new().name("disk".into()).spawn(move || output.fill(&filled, &written))?;
        Ok(Self { position: 0, waiting: Vec::new(), safe, batches: Some(batches), thread: Some(thread) })
    }

    fn hand_over(&mut self, until_ns: Option<u64>) -> io::Result<()> {
        let bytes = std::mem::take(&mut self.waiting);
        match &self.batches {
            Some(batches) if batches.send(Batch { bytes, until_ns }).is_ok() => Ok(()),
            // The thread ends early only when it fails.
            _ => self.end().and(Err(io::ErrorKind::BrokenPipe.into())),
        }
    }

    /// Waits until everything is written.
    pub(super) fn finish(mut self) -> io::Result<()> {
        self.flush()?;
        self.end()
    }

    fn end(&mut self) -> io::Result<()> {
        self.batches = None;
        self.thread
            .take()
            .map_or(Ok(()), |thread| thread.join().unwrap_or_else(|_| Err(io::Error::other("a fault of this program"))))
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.waiting.extend_from_slice(bytes);
        self.position += bytes.len() as u64;
        if self.waiting.len() >= BATCH {
            self.hand_over(None)?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let until_ns = self.safe.handed_over_ns.load(Ordering::Relaxed);
        self.hand_over(Some(until_ns))
    }
}

impl Seek for Sink {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position),
            _ => Err(io::Error::new(io::ErrorKind::Unsupported, "recordings are written from front to back")),
        }
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        // Whoever drops it is already reporting an error; data handed over are still written.
        self.end().ok();
    }
}

/// State of the thread.
struct Output {
    file: File,
    written: u64,
    /// The path at which the file must stay, if it is a regular file that is synchronised.
    watched: Option<PathBuf>,
}

impl Output {
    fn fill(mut self, batches: &Receiver<Batch>, safe: &Safe) -> io::Result<()> {
        if let Some(path) = &self.watched {
            sync_folder(path)?;
        }
        for Batch { bytes, until_ns } in batches {
            self.check_length()?;
            self.file.write_all(&bytes)?;
            self.written += bytes.len() as u64;
            if let (Some(until_ns), Some(path)) = (until_ns, &self.watched) {
                self.settle(path)?;
                safe.written_ns.store(until_ns, Ordering::Relaxed);
            }
        }
        self.check_length()
    }

    fn settle(&self, path: &Path) -> io::Result<()> {
        synced(self.file.sync_data())?;
        let ours = same_file::Handle::from_file(self.file.try_clone()?)?;
        match same_file::Handle::from_path(path) {
            Ok(there) if there == ours => Ok(()),
            _ if self.is_deleted()? => Err(Disturbance::Deleted.into()),
            _ => Err(Disturbance::Moved.into()),
        }
    }

    fn check_length(&self) -> io::Result<()> {
        if self.watched.is_some() && self.file.metadata()?.len() != self.written {
            return Err(Disturbance::Changed.into());
        }
        Ok(())
    }

    #[cfg(unix)]
    fn is_deleted(&self) -> io::Result<bool> {
        Ok(std::os::unix::fs::MetadataExt::nlink(&self.file.metadata()?) == 0)
    }

    /// On other systems the name is the only evidence.
    #[cfg(not(unix))]
    fn is_deleted(&self) -> io::Result<bool> {
        Ok(self.watched.as_ref().is_none_or(|path| !path.exists()))
    }
}
