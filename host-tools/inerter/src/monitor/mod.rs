//! What a device measures, for those who look on: the screen, the page on loopback, and bridges to other programs.
//!
//! [`hub`] takes what comes to all who look on; [`feed`] makes items in SI units on one time line of it, [`causes`]
//! finds what breaks the law, and the rest shows them: `state` and `view` on a terminal, with the feature `screen`;
//! [`others`] opens what needs the feature `bridges`: `web` on a page, `bridge` in Teleplot, PlotJuggler and Foxglove.
//! All that is kept to be shown is bounded ([`trace`], [`history`]), however long it goes on.

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

/// What a mutex holds, whatever has become of a thread that held it.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
