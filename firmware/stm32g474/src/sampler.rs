//! The analogue front end: turns full halves of the rings into samples.
//!
//! Deadline: a half, 4 ms, from the interrupt to the last read. A miss is detected, and becomes a discontinuity. Every
//! fault costs only time: the clock that starts the conversions also counts the lost samples, so the sample counter
//! stays correct.

use crate::led;
use crate::rings::{ENTRIES_PER_S, HALF, Half, RingError, Rings};
use embassy_time::{Duration, Instant, with_timeout};
use heapless::Vec;
use inerter_app::SourceError;
use inerter_app::boxcar::Boxcar;
use inerter_core::{RawSample, Settings};

/// Sample rates available, in Hz.
pub const RATES_HZ: &[f64] = &[1_000.0, 2_000.0, 4_000.0];

/// Samples in a half at the highest rate.
const SAMPLES_PER_HALF: usize = HALF / 16;
/// Time that a half takes to fill.
const HALF_TIME: Duration = Duration::from_micros(HALF as u64 * 1_000_000 / ENTRIES_PER_S as u64);
const _: () = assert!(HALF_TIME.as_micros() * ENTRIES_PER_S as u64 == HALF as u64 * 1_000_000);
/// If no half becomes full in this time, the hardware has stopped.
const HALF_LIMIT: Duration = Duration::from_millis(20);
/// Time for which it is restarted repeatedly before it counts as broken.
const RESTART_LIMIT: Duration = Duration::from_millis(250);

/// The sampler.
pub struct Sampler {
    rings: Rings,
    boxcar: Boxcar,
    running: bool,
    /// Half that will be full next.
    next: Half,
    /// When that half began; `None` while time does not count: before the first start, and between two rates.
    begun: Option<Instant>,
    /// Samples not returned yet, from `given` on.
    ready: Vec<RawSample, SAMPLES_PER_HALF>,
    given: usize,
    /// When the last good half was taken, or reading began.
    good: Instant,
}

impl Sampler {
    /// A sampler that is halted, at 1 kHz.
    pub fn new(rings: Rings) -> Self {
        Self {
            rings,
            boxcar: Boxcar::new(ENTRIES_PER_S / 1_000),
            running: false,
            next: Half::First,
            begun: None,
            ready: Vec::new(),
            given: 0,
            good: Instant::MIN,
        }
    }

    /// Index of the next sample.
    pub fn index(&self) -> u32 {
        self.boxcar.index()
    }

    /// Sets the rate; the first sample has this index.
    pub fn configure(&mut self, settings: &Settings, index: u32) -> Result<(), SourceError> {
        let rate_hz = settings.sample_rate_hz;
        let window = RATES_HZ.iter().find(|&&rate| rate == rate_hz).map(|rate| ENTRIES_PER_S / *rate as u32);
        self.boxcar = Boxcar::starting_at(window.ok_or(SourceError::Unreadable)?, index);
        self.begun = None;
        if self.rings.are_ready() { Ok(()) } else { Err(SourceError::Unreadable) }
    }

    /// Stops the hardware.
    pub fn halt(&mut self) {
        if core::mem::take(&mut self.running) {
            self.rings.stop();
        }
        self.ready.clear();
        self.given = 0;
    }

    /// Waits for samples; see [`SampleSource::read`](inerter_app::SampleSource::read).
    pub async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        loop {
            let ready = self.ready.get(self.given..).unwrap_or_default();
            let count = ready.len().min(into.len());
            if let (Some(from), Some(to), 1..) = (ready.get(..count), into.get_mut(..count), count) {
                to.copy_from_slice(from);
                self.given += count;
                return Ok(count);
            }
            self.next_half().await?;
        }
    }

    async fn next_half(&mut self) -> Result<(), SourceError> {
        if !self.running {
            self.good = Instant::now();
            self.start();
        }
        match with_timeout(HALF_LIMIT, self.rings.full()).await {
            Ok(Ok(half)) if half == self.next => self.take(half),
            Ok(Ok(_) | Err(RingError::Late)) => self.catch_up(),
            Ok(Err(RingError::Overrun)) => self.restart(SourceError::Overrun),
            Err(_) if self.rings.are_overrun() => self.restart(SourceError::Overrun),
            Ok(Err(RingError::Misaligned)) | Err(_) => self.restart(SourceError::Misaligned),
        }
    }

    /// Starts at the first entry; entries missed since the last half are left out.
    fn start(&mut self) {
        let now = Instant::now();
        self.rings.start();
        if let Some(begun) = self.begun.replace(now) {
            self.boxcar.skip(entries_in(now - begun));
        }
        self.next = Half::First;
        self.running = true;
    }

    /// Restarts after a fault, unless there have been only faults for too long.
    fn restart(&mut self, why: SourceError) -> Result<(), SourceError> {
        self.halt();
        if self.good.elapsed() > RESTART_LIMIT {
            return Err(SourceError::Unreadable);
        }
        self.start();
        Err(why)
    }

    /// Takes the half's entries, unless the hardware returns to it meanwhile.
    fn take(&mut self, half: Half) -> Result<(), SourceError> {
        self.ready.clear();
        self.given = 0;
        let (counts, forces, terminals) = self.rings.half(half);
        // There is room for the samples of a half at any rate.
        self.boxcar.push_half(counts, forces, terminals, &mut |sample| {
            let _ = self.ready.push(sample);
        });
        self.next = half.next();
        self.begun = self.begun.map(|begun| begun + HALF_TIME);
        led::note_samples();
        if self.rings.holds(half) {
            self.good = Instant::now();
            return Ok(());
        }
        // The samples were counted but are not returned: a discontinuity.
        self.ready.clear();
        Err(SourceError::Overrun)
    }

    /// Halves were overwritten: skips them and takes the latest full one.
    fn catch_up(&mut self) -> Result<(), SourceError> {
        let latest = self.rings.latest();
        let elapsed = self.begun.map_or(Duration::MIN, |begun| begun.elapsed());
        let missed = missed_halves(elapsed.as_micros(), latest == self.next);
        self.boxcar.skip(missed * HALF as u32);
        self.begun = self.begun.map(|begun| begun + HALF_TIME * missed);
        // Its error, if any, is the one reported here.
        let _ = self.take(latest);
        Err(SourceError::Overrun)
    }
}

/// Number of entries in `time`, to the nearest.
fn entries_in(time: Duration) -> u32 {
    ((time.as_micros() * u64::from(ENTRIES_PER_S) + 500_000) / 1_000_000) as u32
}

/// Number of halves overwritten, from the time since the first of them began, when the latest is full.
///
/// The time gives the number approximately; which half is the latest shows whether it is even.
fn missed_halves(elapsed_us: u64, even: bool) -> u32 {
    let half_us = HALF_TIME.as_micros();
    // All full halves except the latest.
    let missed = (elapsed_us / half_us).saturating_sub(1) as u32;
    if missed.is_multiple_of(2) == even {
        return missed;
    }
    // The interrupt and the clock were read at the boundary of a half.
    if elapsed_us % half_us < half_us / 2 && missed > 0 { missed - 1 } else { missed + 1 }
}
