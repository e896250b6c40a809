//! Work that Python waits for: other threads continue, a callback receives the progress, and Ctrl-C stops the wait.

use std::{
    panic,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::Duration,
};

use pyo3::{exceptions::PyRuntimeError, prelude::*};

use crate::error::Failure;

/// Time between two checks for signals, and between two calls of the callback.
const PAUSE: Duration = Duration::from_millis(50);

/// The progress of the work, and whether the caller still waits for it.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    part: Arc<AtomicU64>,
    is_stopped: Arc<AtomicBool>,
}

impl Progress {
    /// Sets the completed fraction, from 0 to 1. Fails if the caller no longer waits.
    pub fn set(&self, part: f64) -> Result<(), Failure> {
        self.part.store(part.to_bits(), Ordering::Relaxed);
        if self.is_stopped.load(Ordering::Relaxed) { Err(Failure::Stopped) } else { Ok(()) }
    }

    /// The same, for work that cannot return early: if the caller no longer waits, this unwinds the work's thread.
    pub fn tell(&self, part: f64) {
        if let Err(stopped) = self.set(part) {
            // This is no fault, so the thread unwinds without a panic message. Nobody receives the failure.
            panic::resume_unwind(Box::new(stopped));
        }
    }
}

/// Does the work in its own thread; calls `told` with the completed fraction, from 0 to 1, now and then.
///
/// If Ctrl-C or an exception in `told` stops the wait, the work ends the next time it reports progress. Its result is
/// dropped.
pub fn watch<T: Send + 'static>(
    py: Python<'_>,
    told: Option<Py<PyAny>>,
    work: impl FnOnce(&Progress) -> Result<T, Failure> + Send + 'static,
) -> PyResult<T> {
    let progress = Progress::default();
    let (sender, done) = mpsc::sync_channel(1);
    let own = progress.clone();
    // After an interrupt nobody receives the result.
    let begun = thread::Builder::new().name("inerter".into()).spawn(move || drop(sender.send(work(&own))));
    begun.map_err(|error| PyRuntimeError::new_err(format!("no thread for the work: {error}")))?;
    let done = std::sync::Mutex::new(done);
    let wait = || done.lock().map_or(Err(RecvTimeoutError::Disconnected), |done| done.recv_timeout(PAUSE));
    let tell = |part: f64| told.iter().try_for_each(|told| told.call1(py, (part,)).map(drop));
    loop {
        match py.detach(wait) {
            Ok(result) => {
                let result = result?;
                tell(1.0)?;
                return Ok(result);
            }
            Err(RecvTimeoutError::Timeout) => {
                let part = f64::from_bits(progress.part.load(Ordering::Relaxed));
                let stop = |_: &PyErr| progress.is_stopped.store(true, Ordering::Relaxed);
                py.check_signals().and_then(|()| tell(part)).inspect_err(stop)?;
            }
            Err(RecvTimeoutError::Disconnected) => {
                return Err(PyRuntimeError::new_err("a fault in the package ended the work: please report it"));
            }
        }
    }
}
