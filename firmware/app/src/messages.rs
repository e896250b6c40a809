//! What the tasks say to each other.

use crate::tare::Tare;
use inerter_core::{Active, Detail, Estimate, Law, MoreSums, Reversal, Settings, Sums};
use inerter_wire::{Event, Health, Hello, Measured, Reply, Samples};

/// What the commands ask of the estimator. It is done between two batches, and answered by a [`ControlDone`].
#[allow(clippy::large_enum_variant, reason = "only one exists at a time")]
pub(crate) enum Control {
    /// Put other settings in use.
    Use {
        active: Active,
        /// Forget what was gathered under the ones before.
        reset: bool,
    },
    /// Hand on the raw samples that wait for a full batch.
    Flush,
    /// Forget everything.
    Reset,
    /// Average the force code over so many samples that are not saturated.
    Tare(Tare),
    /// Give the averaging up.
    CancelTare,
    /// Take every sample that waits, then publish a final estimate.
    Finish,
}

/// The answer to a [`Control`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ControlDone {
    /// Done.
    Plain,
    /// The averaged force code, for a tare that has run its course.
    Tared { force_code: i32 },
}

/// What a host asked for, to be done by whoever runs the app.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// Restart.
    Reboot,
    /// Restart into the chip's firmware update mode.
    Dfu,
    /// Do nothing more, until the watchdog bites.
    Hang,
}

/// What goes before raw samples: small forms of the records, as many of them wait in a queue.
pub(crate) enum Outgoing {
    Hello(Hello),
    Estimate(Estimate),
    Law(Law),
    Detail(Detail),
    Reversal(Reversal),
    Health(Health),
    Event(Event),
    Reply(Reply),
    Settings(Settings),
    Saved(Settings),
    Measured(Measured),
    Sums(Sums),
    MoreSums(MoreSums),
    /// All that a host must know of the start has gone before this, from [`EventKind::Started`] on.
    Greeted,
    /// Everything before this has been sent: end.
    Restart(Restart),
}

/// What goes after everything else: raw samples, or the wish to know that all before it have been sent.
pub(crate) type Batched = Option<Samples>;
