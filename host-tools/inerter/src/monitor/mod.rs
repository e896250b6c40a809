//! Shows what a device measures in several views: the screen, the page on loopback, and bridges to other programs.
//!
//! [`hub`] passes the data to all views; [`feed`] converts it to items in SI units on one timeline; [`causes`] finds
//! what violates the law; the rest shows the items: `state` and `view` on a terminal, with the feature `screen`;
//! [`others`] opens the views that need the feature `bridges`: `web` on a page, `bridge` in Teleplot, PlotJuggler and
//! Foxglove. Everything stored for display is bounded ([`trace`], [`history`]), however long the monitor runs.

pub mod address;
#[cfg(feature = "bridges")]
mod bridge;
pub mod causes;
mod error;
pub mod feed;
pub mod history;
pub mod hub;
pub mod losses;
pub mod others;
#[cfg(feature = "screen")]
pub mod state;
pub mod trace;
#[cfg(feature = "screen")]
pub mod view;
#[cfg(feature = "bridges")]
mod web;

pub use error::MonitorError;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex, even if a thread panicked while it held the lock.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
