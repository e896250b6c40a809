//! Messages between the tasks.

use crate::tare::Tare;
use inerter_core::{Active, Detail, Estimate, Law, MoreSums, Reversal, Settings, Sums};
use inerter_wire::{Event, Health, Hello, Measured, Reply, Samples};

/// Requests of the command task to the estimator: executed between two batches, answered by a [`ControlDone`].
#[allow(clippy::large_enum_variant, reason = "only one exists at a time")]
pub(crate) enum Control {
    /// Put other settings in use.
    Use {
        active: Active,
        /// Discard what was gathered under the previous ones.
        reset: bool,
    },
    /// Send the raw samples that wait for a full batch.
    Flush,
    /// Discard everything.
    Reset,
    /// Average the force code over a number of unsaturated samples.
    Tare(Tare),
    /// Abandon the averaging.
    CancelTare,
    /// Take every waiting sample, then publish a final estimate.
    Finish,
}

/// The answer to a [`Control`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ControlDone {
    /// Done.
    Plain,
    /// The averaged force code, once a tare is complete.
    Tared { force_code: i32 },
}

/// A host's request that the app's caller executes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// Restart.
    Reboot,
    /// Restart into the chip's firmware update mode.
    Dfu,
    /// Do nothing more, until the watchdog resets the chip.
    Hang,
}

/// Sent before raw samples: compact forms of the records, because many of them wait in a queue.
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
    /// Everything that a host must know about the start precedes this, from [`EventKind::Started`] on.
    Greeted,
    /// Everything before this has been sent: end.
    Restart(Restart),
}

/// Sent after everything else: raw samples, or `None` to ask for a signal once all before it have been sent.
pub(crate) type Batched = Option<Samples>;
