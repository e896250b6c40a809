//! What a board must offer.

use crate::wear::SAVES;
use embedded_io_async::{Read, Write};
use inerter_core::{RawSample, Settings, SettingsError};
use inerter_wire::{Capabilities, ClockSource, Measure, Measured, Play, Refusal, ResetCause, SettingsValues};

/// Whether a source of samples can wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Samples arrive by the clock: those not taken in time are lost, and counted.
    Live,
    /// Samples wait until they are requested: none is lost.
    OnDemand,
}

/// Why a source gave no samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceError {
    /// There are no more samples; no source is then in use.
    Ended,
    /// The hardware overtook the reader. Samples were lost; the sample counter shows how many. More samples follow.
    Overrun,
    /// The channels lost alignment and were realigned. Samples were lost as in an overrun.
    Misaligned,
    /// The sensor or file cannot be read; no source is then in use.
    Unreadable,
}

/// The board's own source of samples.
#[allow(async_fn_in_trait, reason = "used generically only, and never sent to another thread")]
pub trait SampleSource {
    /// Whether the source can wait.
    fn pace(&self) -> Pace;

    /// Waits for samples, puts them at the front of `into`, and returns their number.
    ///
    /// The future may be dropped while it waits; that must lose no sample. A live source whose hardware delivers
    /// nothing must end its wait with [`SourceError::Unreadable`]: after half a second without a sample the device no
    /// longer counts as alive.
    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError>;

    /// Applies the settings that concern the source: rate, front end, oversampling.
    ///
    /// Called before the first read and after each change, while the source is halted and the queue is empty: the next
    /// sample read is the first one under these settings. After an error the source keeps its previous settings or has
    /// none; it is configured again before it is read.
    async fn configure(&mut self, _settings: &Settings) -> Result<(), SourceError> {
        Ok(())
    }

    /// The source will not be read until it is wanted again, perhaps much later.
    ///
    /// A live source then resumes with a jump of its sample counter, not with an overrun.
    async fn halt(&mut self) {}
}

/// A source owned elsewhere: a task stores an argument passed by value twice.
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

/// Why settings could not be loaded or saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// The memory cannot be read or written.
    Unreadable,
    /// The memory holds settings written by a newer firmware.
    Newer,
    /// The memory holds data that is damaged or belongs to another program.
    Foreign,
}

/// Memory in which settings survive a restart.
#[allow(async_fn_in_trait, reason = "used generically only, and never sent to another thread")]
pub trait Store {
    /// The settings last saved; `None` if there never were any. Never changes the memory, whatever it finds.
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError>;

    /// Saves `settings` in place of whatever is there. Whenever power fails, the next load gives either these or the
    /// previous ones.
    async fn save(&mut self, settings: &SettingsValues) -> Result<(), StoreError>;

    /// Erases everything, whatever it is.
    async fn erase(&mut self) -> Result<(), StoreError>;
}

/// A store owned elsewhere: a task stores an argument passed by value twice.
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

/// For a board that cannot save settings; its capabilities lack [`Capabilities::STORE`].
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
    /// What ended the previous run.
    pub cause: ResetCause,
    /// The message of the panic that ended it, if one did.
    pub panic: Option<&'a str>,
    /// Saves that the previous run left for this one ([`App::saves_left`](crate::App::saves_left)) if a host requested
    /// the restart; otherwise [`SAVES`].
    pub saves_left: u8,
}

impl Start<'_> {
    /// Power was applied.
    pub const POWER_ON: Self = Self { cause: ResetCause::PowerOn, panic: None, saves_left: SAVES };
    /// The firmware restarted itself, as requested.
    pub const SOFTWARE: Self = Self { cause: ResetCause::Software, panic: None, saves_left: SAVES };
}

/// For a board that can apply all settings accepted by [`Settings::validate`].
pub fn accept_all(_settings: &Settings) -> Result<(), SettingsError> {
    Ok(())
}

/// For a board that has no player.
pub fn play_nothing(_play: &Play) -> Result<(u32, u16), Refusal> {
    Err(Refusal::Unsupported)
}

/// Identity of the device; the sample rate of its Hello comes from the settings.
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
    /// Source of the sample clock.
    pub clock: ClockSource,
    /// Capabilities of the board; those of every board are added. Commands beyond that are refused as unsupported.
    pub capabilities: Capabilities,
    /// Whether the board can apply the settings, beyond [`Settings::validate`]; called before anything changes.
    pub accepts: fn(&Settings) -> Result<(), SettingsError>,
    /// Plays signals into the board's own inputs; called only if the capabilities have [`Capabilities::PLAYER`].
    /// Returns the answer of [`Done::Played`](inerter_wire::Done::Played) and the room for knots.
    pub play: fn(&Play) -> Result<(u32, u16), Refusal>,
    /// What ended the previous run; reported to the first host.
    pub start: Start<'a>,
}

/// Figures that only the board can measure; `None` for those it cannot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Share of time that the processor was busy since the last call, in thousandths.
    pub cpu_load_permille: Option<u16>,
    /// Stack never used so far, in bytes.
    pub stack_free_bytes: Option<u32>,
    /// Temperature of the chip, in degrees Celsius.
    pub temperature_c: Option<f32>,
}

/// Share of time that the processor is busy, from one call to the next.
#[derive(Clone, Copy, Debug, Default)]
pub struct Load {
    now_us: u64,
    idle_us: u64,
}

impl Load {
    /// Share since the last call, in thousandths, from the time and the idle time since the start, in microseconds;
    /// `None` when no time has passed.
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

    /// Measures what a host requests; called if the board has [`Capabilities::MEASURE`]. Must end within 2 s.
    async fn measure(&mut self, what: Measure) -> Measured {
        Measured::new(what)
    }
}

/// A board, in parts: each goes to the task that uses it.
///
/// The link has two halves. Writing may wait for a reader; the app limits that wait. Reading returns 0 or an error
/// while nobody is connected; the app tries again later.
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
    /// Settings that survive a restart.
    pub store: K,
    /// Health figures.
    pub platform: P,
    /// Identity of the device.
    pub identity: Identity<'a>,
    /// Settings of a device that was never set up.
    pub defaults: Settings,
    /// Whether the sampler runs from the start; else it waits for `Start`.
    pub autostart: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use embassy_futures::block_on;

    /// A source of one sample, which remembers what it was asked.
    #[derive(Default)]
    struct One {
        rate_hz: Option<f64>,
        is_halted: bool,
    }

    impl SampleSource for One {
        fn pace(&self) -> Pace {
            Pace::OnDemand
        }

        async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
            into[0].index = 7;
            Ok(1)
        }

        async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
            self.rate_hz = Some(settings.sample_rate_hz);
            Ok(())
        }

        async fn halt(&mut self) {
            self.is_halted = true;
        }
    }

    /// Used like a task that borrows its source.
    #[test]
    fn a_borrowed_source_does_what_its_own_does() {
        async fn all(mut source: impl SampleSource) -> (Pace, u32) {
            let mut samples = [RawSample::default(); 2];
            source.configure(&Settings { sample_rate_hz: 500.0, ..Settings::default() }).await.unwrap();
            assert_eq!(source.read(&mut samples).await, Ok(1));
            source.halt().await;
            (source.pace(), samples[0].index)
        }
        let mut one = One::default();
        assert_eq!(block_on(all(&mut one)), (Pace::OnDemand, 7));
        assert_eq!((one.rate_hz, one.is_halted), (Some(500.0), true));
    }

    #[test]
    fn a_board_that_cannot_save_loads_nothing_and_refuses_to_save_and_erase() {
        assert_eq!(block_on(NoStore.load()), Ok(None));
        assert_eq!(block_on(NoStore.save(&SettingsValues::default())), Err(StoreError::Unreadable));
        assert_eq!(block_on(NoStore.erase()), Err(StoreError::Unreadable));
    }

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
