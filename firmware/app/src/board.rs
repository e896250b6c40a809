//! What a board must offer.

use crate::wear::SAVES;
use embedded_io_async::{Read, Write};
use inerter_core::{RawSample, Settings, SettingsError};
use inerter_wire::{Capabilities, ClockSource, Measure, Measured, Play, Refusal, ResetCause, SettingsValues};

/// Whether a source of samples can wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Samples come by the clock: what is not taken in time is lost, and counted.
    Live,
    /// Samples wait until they are asked for: none is lost.
    OnDemand,
}

/// Why a source gave no samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceError {
    /// There are no more; the source in use is then none.
    Ended,
    /// The hardware overtook the reader. Samples were lost, the sample counter shows how many, and the next ones come.
    Overrun,
    /// The channels ran apart and were set right. Samples were lost as by an overrun.
    Misaligned,
    /// The sensor or file cannot be read; the source in use is then none.
    Unreadable,
}

/// The board's own source of samples.
#[allow(async_fn_in_trait, reason = "used generically only, and never sent to another thread")]
pub trait SampleSource {
    /// Whether the source can wait.
    fn pace(&self) -> Pace;

    /// Waits for samples, puts them at the front of `into`, returns their number.
    ///
    /// The future may be dropped while it waits; no sample may get lost by that. A live source whose hardware gives
    /// nothing must end its wait with [`SourceError::Unreadable`]: after half a second without a sample the device does
    /// not count as alive.
    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError>;

    /// Takes over what concerns the source: rate, front end, oversampling.
    ///
    /// Called before the first read and after each change, while the source is halted and the queue is empty: the next
    /// sample read is the first one under these settings. After an error the source still has the settings before, or
    /// none; it is configured again before it is read.
    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        let _ = settings;
        Ok(())
    }

    /// The source will not be read until it is wanted again, which may be long.
    ///
    /// A live source goes on with a jump of its sample counter then, not with an overrun.
    async fn halt(&mut self) {}
}

/// A source that lies elsewhere: a task keeps what it is given by value twice.
impl<S: SampleSource> SampleSource for &mut S {
    fn pace(&self) -> Pace {
        (**self).pace()
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        (**self).read(into).await
    }

    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        (**self).configure(settings).await
    }

    async fn halt(&mut self) {
        (**self).halt().await
    }
}

/// Why settings could not be loaded or kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// The memory cannot be read or written.
    Unreadable,
    /// What is there was written by a newer firmware.
    Newer,
    /// What is there is damaged or another program's.
    Foreign,
}

/// Where settings outlive a restart.
#[allow(async_fn_in_trait, reason = "used generically only, and never sent to another thread")]
pub trait Store {
    /// The settings last saved; `None` when there never were any. Changes nothing, whatever it finds.
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError>;

    /// Keeps `settings` in place of whatever is there. Whenever power fails, either these or the ones before are loaded
    /// next.
    async fn save(&mut self, settings: &SettingsValues) -> Result<(), StoreError>;

    /// Forgets everything, whatever it is.
    async fn erase(&mut self) -> Result<(), StoreError>;
}

/// A store that lies elsewhere: a task keeps what it is given by value twice.
impl<S: Store> Store for &mut S {
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError> {
        (**self).load().await
    }

    async fn save(&mut self, settings: &SettingsValues) -> Result<(), StoreError> {
        (**self).save(settings).await
    }

    async fn erase(&mut self) -> Result<(), StoreError> {
        (**self).erase().await
    }
}

/// For a board that keeps nothing; its capabilities lack [`Capabilities::STORE`].
#[derive(Clone, Copy, Debug, Default)]
pub struct NoStore;

impl Store for NoStore {
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError> {
        Ok(None)
    }

    async fn save(&mut self, _settings: &SettingsValues) -> Result<(), StoreError> {
        Err(StoreError::Unreadable)
    }

    async fn erase(&mut self) -> Result<(), StoreError> {
        Err(StoreError::Unreadable)
    }
}

/// How this run of the device began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start<'a> {
    /// What ended the run before.
    pub cause: ResetCause,
    /// The message of the panic that ended it, if one did.
    pub panic: Option<&'a str>,
    /// Saves that it left for this one ([`App::saves_left`](crate::App::saves_left)), where a host wanted the restart;
    /// otherwise [`SAVES`].
    pub saves_left: u8,
}

impl Start<'_> {
    /// Power came.
    pub const POWER_ON: Self = Self { cause: ResetCause::PowerOn, panic: None, saves_left: SAVES };
    /// The firmware restarted itself, as asked.
    pub const SOFTWARE: Self = Self { cause: ResetCause::Software, panic: None, saves_left: SAVES };
}

/// For a board that can do whatever [`Settings::validate`] lets pass.
pub fn accept_all(_settings: &Settings) -> Result<(), SettingsError> {
    Ok(())
}

/// For a board that has no player.
pub fn play_nothing(_play: &Play) -> Result<(u32, u16), Refusal> {
    Err(Refusal::Unsupported)
}

/// Who the device is; the sample rate of its Hello comes from the settings.
#[derive(Clone, Copy, Debug)]
pub struct Identity<'a> {
    /// Firmware name and version.
    pub firmware: &'a str,
    /// Commit that the firmware was built from.
    pub git: &'a str,
    /// Board.
    pub board: &'a str,
    /// Serial number, unique per device.
    pub serial: &'a str,
    /// What the sample clock runs from.
    pub clock: ClockSource,
    /// What the board can do. Commands beyond it are refused as unsupported; what every board can do is added to it.
    pub capabilities: Capabilities,
    /// Whether the board can do what is asked of it, beyond [`Settings::validate`]; asked before anything changes.
    pub accepts: fn(&Settings) -> Result<(), SettingsError>,
    /// Plays at the board's own inputs; asked for only where the capabilities have [`Capabilities::PLAYER`]. Gives the answer
    /// of [`Done::Played`](inerter_wire::Done::Played) and the room for knots.
    pub play: fn(&Play) -> Result<(u32, u16), Refusal>,
    /// What ended the run before this one, told to the first host.
    pub start: Start<'a>,
}

/// What only the board can measure of itself; `None` where it cannot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Share of time that the processor worked since the last call, in thousandths.
    pub cpu_load_permille: Option<u16>,
    /// Stack never used so far, in bytes.
    pub stack_free_bytes: Option<u32>,
    /// Temperature of the chip, in degrees Celsius.
    pub temperature_c: Option<f32>,
}

/// Share of time that the processor works, between one look and the next.
#[derive(Clone, Copy, Debug, Default)]
pub struct Load {
    now_us: u64,
    idle_us: u64,
}

impl Load {
    /// Since the last look, in thousandths, of the time and the idle time since the start, in microseconds; `None` when no time
    /// has passed.
    pub fn permille(&mut self, now_us: u64, idle_us: u64) -> Option<u16> {
        let (elapsed, idle) = (now_us.saturating_sub(self.now_us), idle_us.saturating_sub(self.idle_us));
        *self = Self { now_us, idle_us };
        let busy = elapsed.saturating_sub(idle) * 1_000;
        busy.checked_div(elapsed).and_then(|load| u16::try_from(load).ok())
    }
}

/// The board's own figures.
#[allow(async_fn_in_trait, reason = "used generically only, and never sent to another thread")]
pub trait Platform {
    /// Measures them; called once a second.
    fn figures(&mut self) -> Figures;

    /// Measures what a host asks for; called where the board has [`Capabilities::MEASURE`]. Must end within 2 s.
    async fn measure(&mut self, what: Measure) -> Measured {
        Measured::new(what)
    }
}

/// A board, in parts: each goes to the task that uses it.
///
/// The link is two halves. Writing may wait for a reader: the app limits it in time. Reading returns 0 or an error
/// while nobody is connected, and the app asks again later.
pub struct Board<'a, S, R, W, K, P>
where
    S: SampleSource,
    R: Read,
    W: Write,
    K: Store,
    P: Platform,
{
    /// The board's own samples.
    pub source: S,
    /// Bytes from the host.
    pub receiver: R,
    /// Bytes to the host.
    pub transmitter: W,
    /// Settings over a restart.
    pub store: K,
    /// Health figures.
    pub platform: P,
    /// Who it is.
    pub identity: Identity<'a>,
    /// Settings of a device that was never set up.
    pub defaults: Settings,
    /// Whether the sampler runs from the beginning; else it waits for `Start`.
    pub autostart: bool,
}

#[cfg(test)]
mod tests {
    use super::Load;

    #[test]
    fn load_is_what_was_worked_since_the_last_look() {
        let mut load = Load::default();
        assert_eq!(load.permille(0, 0), None);
        assert_eq!(load.permille(1_000, 750), Some(250));
        assert_eq!(load.permille(3_000, 750), Some(1_000));
        assert_eq!(load.permille(3_000, 750), None, "no time has passed");
        assert_eq!(load.permille(4_000, 9_000), Some(0), "an idle time beyond the time itself");
    }
}
