//! The instrument's async tasks, generic over the board.
//!
//! Terms:
//! - *sampler*: the board's own source of samples ([`SampleSource`]): a timer and its converters, or a file.
//! - *pace*: whether the source can wait ([`Pace::OnDemand`], a file) or not ([`Pace::Live`], a timer). If it can, no
//!   sample is lost on the way to a host that reads; if it cannot, samples that overflow are dropped and counted.
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
//! Each task is a function; an [`App`] holds the queues between them. [`run`] joins the tasks into one future for any
//! executor. A board that needs separate tasks, say sampling at a higher priority, spawns them one by one.
//! All memory is static: an [`App`] and an `inerter_core::State`.
#![no_std]

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
mod messages;
pub mod player;
mod queue;
mod run;
mod sampling;
mod settings;
pub mod store;
mod tare;
mod telemetry;
pub mod wear;

pub use app::App;
pub use board::{
    Board, Figures, Identity, Load, NoStore, Pace, Platform, SampleSource, SourceError, Start, Store, StoreError,
    accept_all, play_nothing,
};
pub use commands::commands;
pub use estimating::estimating;
pub use health::health_reports;
pub use links::{LinkReceiver, LinkState, LinkTransmitter, Which};
pub use messages::Restart;
pub use queue::{BATCH, QUEUE};
pub use run::run;
pub use sampling::sampling;
pub use settings::{InUse, leave_settings_alone, load_settings};
pub use store::FlashStore;
pub use telemetry::telemetry;
