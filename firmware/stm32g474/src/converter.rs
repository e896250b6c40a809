//! The digital front end: an ADS131M04 for bridge, excitation and terminal displacement, at its own pace.
//!
//! Each "ready" edge is one sample: it latches the encoder's count, and the conversion that goes with it is read before
//! the next. The count is matched to the filter's delay ([`MatchedPosition`]), the force is corrected for the bridge's
//! excitation. After a damaged frame, a lost edge or a reset of the chip, the driver restores operation and reports a
//! discontinuity; the core's clock, from which the converter's is derived, gives the number of samples lost.

use crate::clkin::{self, Clkin};
use crate::led;
use crate::ready::{Edge, Ready};
use crate::spi::Device;
use ads131m04::{Ads131m04, Config, Conversion, Gain, MatchedPosition, Osr, Ratiometric, Recovery};
use embassy_stm32::gpio::Output;
use embassy_time::{Delay, Duration, Instant, with_timeout};
use inerter_app::SourceError;
use inerter_core::{RawSample, Settings};

/// Sample rates available, in Hz: periods of 1024, 512 and 256 us.
pub const RATES_HZ: &[f64] = &[976.5625, 1_953.125, 3_906.25];

/// Bridge of 2 mV/V at 2.5 V: 5 mV in a range of 18.75 mV; the others have a range of 1.2 V (docs/HARDWARE.md).
const GAINS: [Gain; 4] = [Gain::X64, Gain::X1, Gain::X1, Gain::X1];
/// Code of the excitation, 2.5 V through 1.8 and 1.0 kilohm: 0.8929 V of 1.2.
const EXCITATION: i32 = 6_241_524;
const RATIO: Ratiometric = match Ratiometric::new(EXCITATION) {
    Some(ratio) => ratio,
    None => panic!("the excitation is within the range"),
};
/// Force code of a bridge without its excitation: the rail, which the estimator leaves out.
const NO_FORCE: i32 = -0x80_0000;
/// If no edge arrives in this time, the converter has stopped.
const EDGE_LIMIT: Duration = Duration::from_millis(20);
/// Frames and edges are compared once in this many conversions.
const CONVERSIONS_PER_CHECK: u16 = 1_000;
/// Attempts to realign frames and edges; an edge that arrives meanwhile spoils one.
const RESYNCHRONISATIONS: usize = 3;

/// The front end.
pub struct Converter {
    chip: Ads131m04<Device, Output<'static>>,
    ready: Ready,
    clkin: Clkin,
    position: MatchedPosition,
    period: Duration,
    /// Index of the next sample.
    index: u32,
    /// A sample's index and the time of its edge, from which indices after a discontinuity are computed. `None` if the
    /// times of the conversions have shifted.
    anchor: Option<(u32, Instant)>,
    /// Time of the previous edge.
    latest: Option<Instant>,
    /// Edges may have been missed: the next one's index is computed from the clock.
    unseen: bool,
    /// Not read for a while, so missed edges are expected.
    paused: bool,
    until_check: u16,
}

impl Converter {
    /// Does not communicate with the chip yet.
    pub fn new(spi: Device, reset: Output<'static>, ready: Ready, clkin: Clkin) -> Self {
        let config = Config { clkin_hz: clkin::HZ, gains: GAINS, ..Config::default() };
        Self {
            chip: Ads131m04::new(spi, reset, config),
            ready,
            clkin,
            position: MatchedPosition::new(config.osr),
            period: period(config.osr),
            index: 0,
            anchor: None,
            latest: None,
            unseen: false,
            paused: true,
            until_check: CONVERSIONS_PER_CHECK,
        }
    }

    /// Index of the next sample.
    pub fn index(&self) -> u32 {
        self.index
    }

    /// Configures the chip for the rate; the next sample has this index, whether or not that succeeds.
    pub async fn configure(&mut self, settings: &Settings, index: u32) -> Result<(), SourceError> {
        self.index = index;
        let osr = Osr::from_data_rate(clkin::HZ, settings.sample_rate_hz).ok_or(SourceError::Unreadable)?;
        self.clkin.start();
        self.set_up().await?;
        let config = Config { osr, ..*self.chip.config() };
        self.chip.configure(config).await.map_err(|_| SourceError::Unreadable)?;
        self.position = MatchedPosition::new(osr);
        self.period = period(osr);
        self.latest = None;
        self.paused = true;
        Ok(())
    }

    /// From here on edges are missed.
    pub fn halt(&mut self) {
        self.paused = true;
    }

    /// Waits for a sample; see [`SampleSource::read`](inerter_app::SampleSource::read).
    pub async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        let Some(place) = into.first_mut() else { return Ok(0) };
        loop {
            let Ok(edge) = with_timeout(EDGE_LIMIT, self.ready.edge()).await else {
                self.set_up().await?;
                return Err(SourceError::Misaligned);
            };
            let index = self.count(&edge);
            let paused = core::mem::take(&mut self.paused);
            if edge.missed || paused {
                // The chip holds conversions of earlier edges.
                self.resynchronise_chip().await?;
                if paused {
                    continue;
                }
                return Err(SourceError::Overrun);
            }
            let result = self.chip.read().await;
            let position = self.position.push(edge.count);
            match result {
                Ok(conversion) => {
                    self.check_backlog().await?;
                    if let (true, Some(position)) = (conversion.settled, position) {
                        led::note_samples();
                        *place = sample(index, position, &conversion);
                        return Ok(1);
                    }
                }
                Err(error) => match error.recovery() {
                    Recovery::Continue => {}
                    Recovery::Resynchronise => {
                        self.resynchronise_chip().await?;
                        return Err(SourceError::Misaligned);
                    }
                    Recovery::Initialise => {
                        self.set_up().await?;
                        return Err(SourceError::Misaligned);
                    }
                    Recovery::Person => return Err(SourceError::Unreadable),
                },
            }
        }
    }

    /// The index of this edge's sample.
    fn count(&mut self, edge: &Edge) -> u32 {
        let now = Instant::now();
        let unseen = core::mem::take(&mut self.unseen) || edge.missed || self.paused;
        let index = match (self.anchor, self.latest) {
            (Some(_), _) if !unseen => self.index,
            (Some((index, time)), _) => index.wrapping_add(self.periods_in(now - time)),
            // The previous one has index - 1.
            (None, Some(latest)) => self.index.wrapping_add(self.periods_in(now - latest).saturating_sub(1)),
            (None, None) => self.index,
        };
        self.anchor.get_or_insert((index, now));
        self.latest = Some(now);
        self.index = index.wrapping_add(1);
        index
    }

    /// Number of periods in `time`, to the nearest.
    fn periods_in(&self, time: Duration) -> u32 {
        ((time.as_micros() + self.period.as_micros() / 2) / self.period.as_micros()) as u32
    }

    /// Resets and configures the chip; the times of its conversions shift.
    async fn set_up(&mut self) -> Result<(), SourceError> {
        self.anchor = None;
        self.position.reset();
        self.until_check = CONVERSIONS_PER_CHECK;
        self.chip.init(&mut Delay).await.map_err(|_| SourceError::Unreadable)?;
        self.ready.clear();
        Ok(())
    }

    /// Reads the chip until it holds nothing and no edge has arrived meanwhile.
    async fn resynchronise_chip(&mut self) -> Result<(), SourceError> {
        self.position.reset();
        self.unseen = true;
        for _ in 0..RESYNCHRONISATIONS {
            self.ready.clear();
            self.chip.resynchronise(&mut Delay).await.map_err(|_| SourceError::Unreadable)?;
            if !self.ready.is_latched() {
                return Ok(());
            }
        }
        Err(SourceError::Unreadable)
    }

    /// From time to time, checks that the chip holds nothing after a read: otherwise frames would be a period late.
    async fn check_backlog(&mut self) -> Result<(), SourceError> {
        self.until_check -= 1;
        if self.until_check > 0 {
            return Ok(());
        }
        self.until_check = CONVERSIONS_PER_CHECK;
        if self.chip.drain().await == Ok(0) {
            return Ok(());
        }
        self.resynchronise_chip().await?;
        Err(SourceError::Misaligned)
    }
}

/// A whole number of microseconds, because the clock is 8 MHz.
fn period(osr: Osr) -> Duration {
    Duration::from_micros(u64::from(osr.period_clkin() / (clkin::HZ / 1_000_000)))
}

fn sample(index: u32, position_count: i32, conversion: &Conversion) -> RawSample {
    let [bridge, excitation, terminal_code, _] = conversion.channels;
    let force_code = RATIO.correct(bridge, excitation).unwrap_or(NO_FORCE);
    RawSample { index, position_count, force_code, terminal_code }
}
