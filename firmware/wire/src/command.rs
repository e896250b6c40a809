//! What a host requests of a device.

use crate::messages::messages;
use crate::{Measure, Play, Samples, SettingsValues};
use serde::{Deserialize, Serialize};

/// A command with an id that its reply repeats.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// Chosen by the host; the reply repeats it in [`Reply::id`](crate::Reply::id).
    pub id: u16,
    /// What to do.
    pub command: Command,
}

messages! {
    /// What a device can be requested to do. Every command gets exactly one [`Reply`](crate::Reply).
    #[allow(clippy::large_enum_variant, reason = "cannot be boxed without an allocator")]
    enum Command {
        0 Hello "Send the Hello record.";
        1 ReadSettings "Send the Settings record with every setting in use.";
        2 WriteSettings(SettingsValues) "Check the values together with those in use, then put all of them in use between two samples, or none.";
        3 SaveSettings "Save the settings in use, so that they survive a restart.";
        4 Tare "Take the present force as zero: sets force_zero_code.";
        5 Streams(Streams) "Choose which records are sent unasked.";
        6 ResetEstimator "Forget all motion seen so far.";
        7 Start "Let the device's own sampler run; ends an injection.";
        8 Stop "Halt the device's own sampler.";
        9 Inject(Samples) "Feed these samples to the estimator; the first batch takes the sampler's place and resets the estimator.";
        10 InjectEnd "Reply once every injected sample has gone through the estimator and a final Estimate is out.";
        11 EnterDfu "Restart into the chip's firmware update mode.";
        12 Reboot "Restart.";
        13 FactoryReset "Erase the settings store and put the board's defaults in use.";
        14 ReadSaved "Send the Saved record with the saved settings.";
        15 Measure(Measure) "Measure something of the board itself, and send the Measured record. The reply comes when it is done.";
        16 Play(Play) "Output signals on pins that jumpers connect to the inputs; needs Capabilities::PLAYER.";
    }
}

/// Which records a device sends without a request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Streams {
    /// `Samples`: every raw sample.
    pub samples: bool,
    /// `Estimate` and `Detail` at the publish rate, `Reversal` at reversals.
    pub estimates: bool,
    /// `Sums` and `MoreSums` of either bank, once a second of samples.
    pub sums: bool,
    /// `Health` once a second.
    pub health: bool,
}

impl Streams {
    /// Everything.
    pub const ALL: Self = Self { samples: true, estimates: true, sums: true, health: true };
    /// Nothing but replies and events.
    pub const NONE: Self = Self { samples: false, estimates: false, sums: false, health: false };
}
