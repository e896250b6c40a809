//! What a device sends to a host.

use crate::forms;
use crate::messages::messages;
use crate::{Measured, Refusal, Samples, SettingsValues};
use core::fmt;
use inerter_core::{Change, Detail, Estimate, Law, MoreSums, Reversal, Sums, Warning};
use serde::{Deserialize, Serialize};

messages! {
    /// Everything a device sends.
    #[allow(clippy::large_enum_variant, reason = "cannot be boxed without an allocator")]
    enum Record {
        0 Hello(Hello) "Identity and wire version of the device; on Command::Hello and after a start.";
        1 Samples(Samples) "Raw samples, up to 32, with their sample counter.";
        2 Estimate(#[serde(with = "forms::Estimate")] Estimate) "Inertance and friction with their intervals, at the publish rate.";
        3 Health(Health) "Losses, load and head room, once a second.";
        4 Event(Event) "A single occurrence, such as a start, a fault or a change.";
        5 Reply(Reply) "Answer to one request.";
        6 Settings(SettingsValues) "Every setting in use, on Command::ReadSettings and after a change.";
        7 Sums(Sums) "Whole-run sums of one bank: sufficient statistics, exact; either bank once a second of samples.";
        8 Reversal(Reversal) "Backlash by one reversal of the flanks alone, when it has been accepted.";
        9 Detail(#[serde(with = "forms::Detail")] Detail) "Band, backlash, contact, regime of friction and changes; the last record that accompanies an Estimate.";
        10 MoreSums(MoreSums) "Whole-run sums of abs(v) and dF/dt of one bank; after its Sums.";
        11 Law(#[serde(with = "forms::Law")] Law) "Whether the law holds, and how much of the residual noise and steps explain; between an Estimate and its Detail.";
        12 Saved(SettingsValues) "The saved settings, on Command::ReadSaved; they may differ from those in use.";
        13 Measured(Measured) "What the board measured of itself, on Command::Measure; raw numbers.";
    }
}

/// Short text of at most `N` bytes of UTF-8.
///
/// [`text`](Hello::text) truncates what is too long.
pub type Text<const N: usize> = heapless::String<N>;

/// Identity of the device.
///
/// `wire_version` stays the first field of record 0 in every version, so that any reader can read it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Wire version that the device speaks.
    pub wire_version: u16,
    /// Firmware name and version.
    pub firmware: Text<32>,
    /// Commit that the firmware was built from.
    pub git: Text<16>,
    /// Board.
    pub board: Text<24>,
    /// Serial number, unique per device.
    pub serial: Text<24>,
    /// Samples per second of the device's clock (Hz).
    pub sample_rate_hz: f64,
    /// What the sample clock runs from.
    pub clock: ClockSource,
    /// What the device can do.
    pub capabilities: Capabilities,
}

impl Hello {
    /// `source` as text of at most `N` bytes, truncated between characters.
    pub fn text<const N: usize>(source: &str) -> Text<N> {
        let mut text = Text::new();
        for letter in source.chars() {
            if text.push(letter).is_err() {
                break;
            }
        }
        text
    }
}

/// What the sample clock runs from. Its error enters the inertance twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClockSource {
    /// The chip's own oscillator, about 1 %: no accuracy of the inertance is claimed.
    #[default]
    Internal,
    /// Quartz, about 50 ppm.
    Crystal,
    /// A clock fed in from outside.
    External,
    /// No clock: samples come from a simulation or a file.
    Simulated,
}

/// What the device can do, as a set of bits. The upper 16 bits are its flash in KB, if the device states it.
///
/// Bits that a reader does not know are kept, and have no meaning for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capabilities(pub u32);

impl Capabilities {
    /// None of them.
    pub const NONE: Self = Self(0);
    /// Has a sampler of its own (`Start`, `Stop`).
    pub const SAMPLER: Self = Self(1 << 0);
    /// Takes samples over the link (`Inject`, `InjectEnd`).
    pub const INJECT: Self = Self(1 << 1);
    /// Measures the terminal displacement with its own sensor.
    pub const TERMINAL: Self = Self(1 << 2);
    /// Keeps settings over a restart (`SaveSettings`).
    pub const STORE: Self = Self(1 << 3);
    /// Enters the chip's update mode on command (`EnterDfu`).
    pub const DFU: Self = Self(1 << 4);
    /// Restarts on command (`Reboot`).
    pub const REBOOT: Self = Self(1 << 5);
    /// Streams the estimator's sums.
    pub const SUMS: Self = Self(1 << 6);
    /// Measures the board itself on command (`Measure`).
    pub const MEASURE: Self = Self(1 << 7);
    /// Puts out signals for its own inputs (`Play`).
    pub const PLAYER: Self = Self(1 << 8);

    /// This set, with this much flash (KB).
    pub const fn with_flash_kb(self, kb: u16) -> Self {
        Self(self.0 & 0xFFFF | (kb as u32) << 16)
    }

    /// Flash of the device's chip (KB), if the device states it.
    pub const fn flash_kb(self) -> Option<u16> {
        match (self.0 >> 16) as u16 {
            0 => None,
            kb => Some(kb),
        }
    }

    /// Both sets together.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all of `other` is in this set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// State of the device. Counters run since its start and stop at their greatest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Index of the latest sample.
    pub index: u32,
    /// Time since the start (s).
    pub uptime_s: u32,
    /// Frames that the device could not send; each left a gap in the sequence.
    pub dropped_frames: u32,
    /// Frames that arrived damaged or were not understood.
    pub bad_frames: u32,
    /// Samples missing where the sample counter jumped.
    pub lost_samples: u64,
    /// Jumps of the sample counter: samples were lost.
    pub discontinuities: u32,
    /// Times the sampler was overtaken by its own hardware, or its channels lost alignment.
    pub overruns: u32,
    /// Samples left out as saturated.
    pub saturated: u32,
    /// Fraction of time that the processor worked (1/1000), if the device knows it.
    pub cpu_load_permille: Option<u16>,
    /// Stack never used so far (bytes), if the device knows it.
    pub stack_free_bytes: Option<u32>,
    /// Temperature of the chip (degrees Celsius), if the device knows it.
    pub temperature_c: Option<f32>,
}

/// Something that happened once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Index of the latest sample when it happened.
    pub index: u32,
    /// What happened.
    pub kind: EventKind,
}

/// What happened. New kinds go at the end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum EventKind {
    /// The device has just started. Its stream begins with this, sequence 0, and a Hello.
    Started,
    /// The source has no more samples: the file ended, or `InjectEnd` is done.
    SourceEnded,
    /// The estimator forgot everything.
    EstimatorReset,
    /// Other settings are in use; a `Settings` record follows.
    SettingsChanged,
    /// Samples now come from another source.
    SourceChanged(Source),
    /// Something is wrong, and the device continues.
    Fault(Fault),
    /// The run before this one ended in a panic with this message.
    Panicked(Text<96>),
    /// What ended the run before this one; reported once after a start.
    ResetBy(ResetCause),
    /// The device under test has changed: the estimator has found a change and restarted.
    Changed(Change),
    /// The samples show something that no device can cause.
    Warned(Warning),
}

/// What caused a start of the device. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetCause {
    /// Power was applied, or returned after a dip.
    PowerOn,
    /// The reset pin: a button, a probe.
    Pin,
    /// The firmware itself, on request.
    Software,
    /// The independent watchdog: the firmware hung.
    Watchdog,
    /// The window watchdog: the firmware's timing broke.
    WindowWatchdog,
    /// A low-power mode that is not allowed.
    LowPower,
    /// New option bytes.
    OptionBytes,
    /// The firmware failed; `Panicked` says where.
    Panic,
    /// The board does not know.
    Unknown,
}

impl fmt::Display for ResetCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PowerOn => "power",
            Self::Pin => "the reset pin",
            Self::Software => "the firmware, as asked",
            Self::Watchdog => "the watchdog, as the firmware hung",
            Self::WindowWatchdog => "the window watchdog, as the firmware's timing broke",
            Self::LowPower => "a low-power mode that is not allowed",
            Self::OptionBytes => "new option bytes",
            Self::Panic => "a failure of the firmware",
            Self::Unknown => "an unknown cause",
        })
    }
}

/// Where samples come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Source {
    /// Nowhere: the sampler is halted.
    Stopped,
    /// The device's own sampler.
    Sampler,
    /// The link, by `Inject`.
    Link,
}

/// What is wrong with a device. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// The sampler lost samples to its own hardware.
    SamplerOverrun,
    /// The sampler's source cannot be read.
    SourceUnreadable,
    /// The settings store cannot be read or written.
    Store,
    /// The saved settings are not valid; the defaults are in use.
    SavedSettings,
    /// The watchdog ended the run before this one.
    Watchdog,
    /// The saved settings are from a newer firmware; the defaults are in use, and the saved ones are kept.
    NewerSettings,
    /// The settings store holds damaged or foreign bytes; the defaults are in use, and the bytes are kept.
    ForeignSettings,
    /// The sampler's channels lost alignment and were realigned; samples were lost.
    SamplerMisaligned,
    /// The firmware failed to start three times in a row; the saved settings are kept but not used, in case they are
    /// the cause.
    SettingsLeft,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SamplerOverrun => "the sampler lost samples: lower the sample rate",
            Self::SourceUnreadable => "the source of samples cannot be read: check the sensor or the file",
            Self::Store => "the settings store cannot be read or written: settings will not outlive a restart",
            Self::SavedSettings => {
                "the saved settings are not valid, the defaults are in use: write and save them again"
            }
            Self::Watchdog => "the device hung and was restarted by its watchdog: please report it",
            Self::NewerSettings => {
                "the saved settings are from a newer firmware, the defaults are in use: update the firmware, or save \
                 settings to replace them"
            }
            Self::ForeignSettings => {
                "the settings store is damaged or another program's, the defaults are in use: save settings to \
                 replace it"
            }
            Self::SamplerMisaligned => "the sampler's channels ran apart and were set right: please report it",
            Self::SettingsLeft => {
                "the firmware failed to start three times in a row: the saved settings were left alone in case they are \
                 why, and the defaults are in use. `inerter settings backup --saved FILE.toml` writes the saved ones to a \
                 file; a restart takes them again, `inerter settings save` replaces them"
            }
        })
    }
}

/// The answer to one request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reply {
    /// The request's id.
    pub id: u16,
    /// The result.
    pub result: Result<Done, Refusal>,
}

/// What a request achieved. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Done {
    /// Done, nothing to add.
    Plain,
    /// Injected samples were taken.
    Injected {
        /// Samples taken since the first `Inject`, wrapping at 2^32.
        accepted: u32,
        /// Samples that can be sent at once now without being refused.
        free: u16,
    },
    /// The player took the command.
    Played {
        /// What [`Play`](crate::Play) specifies for each of its commands.
        answer: u32,
        /// Number of knots for which there is room now.
        free: u16,
    },
}
