//! The instrument's async tasks, generic over the board.
//!
//! Terms:
//! - *sampler*: the board's own source of samples ([`SampleSource`]): a timer and its converters, or a file.
//! - *pace*: whether the source can wait ([`Pace::OnDemand`], a file) or not ([`Pace::Live`], a timer). With a source
//!   that can wait nothing is lost on the way to a reader that reads; with one that cannot, what overflows is left out
//!   and counted.
//! - *source in use*: the sampler, the link (samples injected by a host), or none.
//!
//! ```text
//! sampling --samples--> estimating --estimates, samples--> telemetry --frames--> link
//!              ^             ^                                 ^                  |
//!           injected      controls                      replies, events           |
//!              '---------- commands <---------------- requests ------------------'
//!                                            health ---once a second---^
//! ```
//!
//! [`App`] holds the queues between the tasks, [`run`] joins the tasks into one future for any executor. A board that
//! wants them apart, say sampling at a higher priority, spawns the methods of [`App`] one by one.
//! All memory is static: an [`App`] and an `inerter_core::State`.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod alive;
mod app;
mod board;
pub mod boxcar;
mod commands;
mod estimating;
mod health;
pub mod links;
mod logging;
mod queue;
mod sampling;
mod settings;
pub mod store;
mod telemetry;

pub use app::{App, run};
pub use board::{
    Board, Figures, Identity, Load, NoStore, Pace, Platform, SampleSource, SourceError, Start, Store, StoreError,
    accept_all,
};
pub use links::{LinkReceiver, LinkState, LinkTransmitter, Which};
pub use settings::{InUse, load_settings};
pub use store::FlashStore;
pub use telemetry::Restart;

/// Samples that a source hands over at once at most, and the most that are processed without a pause for commands.
pub const BATCH: usize = inerter_wire::Samples::MAX_SAMPLES;

/// Samples that can wait for the estimator: 64 ms at 4 kHz.
pub const QUEUE: usize = 256;
