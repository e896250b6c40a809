//! The file of a recording. A separate thread writes it, so that a slow disk does not delay reading the device, and
//! another one synchronises it, so that a program that is killed loses no more on a slow disk than on a fast one.

use std::{
    fs::File,
    io::{self, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::{self, JoinHandle},
};

use crate::output::{Disturbance, sync_folder, synced};

/// Bytes after which a batch is handed over.
const BATCH: usize = 1 << 18;
/// Batches that may wait for the disk: half a minute of a live device. After that the producer waits too.
const WAITING: usize = 64;

/// How much of the recording was handed over, is written, and is synchronised \[ns\], shared by all threads.
#[derive(Clone, Debug, Default)]
pub(super) struct Safe {
    handed_over_ns: Arc<AtomicU64>,
    written_ns: Arc<AtomicU64>,
    synced_ns: Arc<AtomicU64>,
    /// The synchronising thread has ended with an error.
    has_failed: Arc<AtomicBool>,
}

impl Safe {
    /// Sets the recording's duration at the next flush.
    pub(super) fn hand_over(&self, duration_ns: u64) {
        self.handed_over_ns.store(duration_ns, Ordering::Relaxed);
    }

    /// The duration that has reached the disk; 0 for a file that is not watched.
    pub(super) fn synced_ns(&self) -> u64 {
        self.synced_ns.load(Ordering::Relaxed)
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
        Self::start(Output { file, watched: None }, safe)
    }

    /// Syncs each flush to disk, and checks that the file at `path` is still the one being written.
    pub(super) fn watching(path: &Path, file: File, safe: Safe) -> io::Result<Self> {
        let watched = file.metadata()?.is_file().then(|| path.into());
        Self::start(Output { file, watched }, safe)
    }

    fn start(output: Output, safe: Safe) -> io::Result<Self> {
        let (batches, filled) = sync_channel(WAITING);
        let written = safe.clone();
        let thread = thread::Builder::new().name("disk".into()).spawn(move || output.fill(&filled, &written))?;
        Ok(Self { position: 0, waiting: Vec::new(), safe, batches: Some(batches), thread: Some(thread) })
    }

    fn hand_over(&mut self, until_ns: Option<u64>) -> io::Result<()> {
        let bytes = std::mem::take(&mut self.waiting);
        let has_failed = self.safe.has_failed.load(Ordering::Relaxed);
        match &self.batches {
            Some(batches) if !has_failed && batches.send(Batch { bytes, until_ns }).is_ok() => Ok(()),
            // The writing thread ends early only when it fails.
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
        self.thread.take().map_or(Ok(()), |thread| joined(thread.join()))
    }
}

fn joined(ended: thread::Result<io::Result<()>>) -> io::Result<()> {
    ended.unwrap_or_else(|_| Err(io::Error::other("a fault of this program")))
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

/// What the threads share.
struct Output {
    file: File,
    /// The path at which the file must stay, if it is a regular file that is synchronised.
    watched: Option<PathBuf>,
}

impl Output {
    fn fill(&self, batches: &Receiver<Batch>, safe: &Safe) -> io::Result<()> {
        let Some(path) = &self.watched else { return self.write(batches, |_| ()) };
        thread::scope(|scope| {
            let (wake, woken) = sync_channel(1);
            let thread = thread::Builder::new().name("sync".into());
            let syncing = thread.spawn_scoped(scope, move || self.sync(path, &woken, safe))?;
            let written = self.write(batches, |until_ns| {
                safe.written_ns.store(until_ns, Ordering::Relaxed);
                // If it is already woken, it has yet to begin, and will include this.
                wake.try_send(()).ok();
            });
            drop(wake);
            written.and(joined(syncing.join()))
        })
    }

    /// Writes all batches, and calls `flushed` after each that ends with a whole frame.
    fn write(&self, batches: &Receiver<Batch>, mut flushed: impl FnMut(u64)) -> io::Result<()> {
        let mut written = 0;
        for Batch { bytes, until_ns } in batches {
            self.check_length(written)?;
            (&self.file).write_all(&bytes)?;
            written += bytes.len() as u64;
            until_ns.into_iter().for_each(&mut flushed);
        }
        self.check_length(written)
    }

    /// Synchronises what is written whenever it is woken.
    fn sync(&self, path: &Path, woken: &Receiver<()>, safe: &Safe) -> io::Result<()> {
        let result = sync_folder(path).and_then(|()| {
            woken.iter().try_for_each(|()| {
                let until_ns = safe.written_ns.load(Ordering::Relaxed);
                self.settle(path)?;
                safe.synced_ns.store(until_ns, Ordering::Relaxed);
                Ok(())
            })
        });
        safe.has_failed.store(result.is_err(), Ordering::Relaxed);
        result
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

    fn check_length(&self, written: u64) -> io::Result<()> {
        if self.watched.is_some() && self.file.metadata()?.len() != written {
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
