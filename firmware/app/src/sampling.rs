//! From the board's own source to the queue.

use crate::BATCH;
use crate::alive::{BEAT, Task};
use crate::app::App;
use crate::board::{Pace, SampleSource, SourceError};
use crate::logging::log;
use crate::queue::NotInUse;
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_futures::yield_now;
use embassy_time::Timer;
use inerter_core::RawSample;
use inerter_wire::{EventKind, Fault, Source};

/// What was told as an event already; after that it is seen in the health records.
#[derive(Default)]
struct Told {
    overrun: bool,
    misaligned: bool,
}

impl App {
    /// Takes samples from the board's source while it is in use, and settings while it is not.
    ///
    /// Deadline on a [`Pace::Live`] source: its own buffer, as this task may wait for others on the same executor.
    pub async fn sampling(&self, mut source: impl SampleSource) -> ! {
        let waits = source.pace() == Pace::OnDemand;
        self.set_sampler_waits(waits);
        let mut told = Told::default();
        let mut batch = [RawSample::default(); BATCH];
        loop {
            self.configure_until_wanted(&mut source).await;
            loop {
                let count = match select(self.queue.sampler_is(false), source.read(&mut batch)).await {
                    Either::First(()) => break,
                    Either::Second(Ok(count)) => count,
                    Either::Second(Err(error)) => {
                        self.source_failed(error, &mut told).await;
                        continue;
                    }
                };
                self.beat(Task::Sampling);
                let samples = batch.get(..count).unwrap_or(&batch);
                if waits {
                    // Not in use any more: what was read ahead belongs to nobody.
                    let _ = self.queue.give(Source::Sampler, samples).await;
                } else if let Ok(lost @ 1..) = self.give_patiently(samples).await {
                    // The sample counter will show the discontinuity.
                    log!(warn, "no room for {} samples", lost);
                    self.overrun(&mut told.overrun, Fault::SamplerOverrun).await;
                }
            }
            source.halt().await;
        }
    }

    /// Lets the halted source take over settings, until samples are wanted of it.
    async fn configure_until_wanted(&self, source: &mut impl SampleSource) {
        loop {
            self.beat(Task::Sampling);
            match select3(self.queue.sampler_is(true), self.configure.wait(), Timer::after(BEAT)).await {
                Either3::First(()) => return,
                Either3::Second(settings) => {
                    let result = source.configure(&settings).await;
                    self.configured.signal(result);
                }
                Either3::Third(()) => {}
            }
        }
    }

    /// Gives samples that cannot wait and returns how many found no room.
    ///
    /// After a burst the estimator gets one turn to make room.
    async fn give_patiently(&self, samples: &[RawSample]) -> Result<usize, NotInUse> {
        let left = self.queue.give_now(Source::Sampler, samples)?;
        if left == 0 {
            return Ok(0);
        }
        yield_now().await;
        self.queue.give_now(Source::Sampler, samples.get(samples.len() - left..).unwrap_or_default())
    }

    async fn source_failed(&self, error: SourceError, told: &mut Told) {
        match error {
            SourceError::Overrun => self.overrun(&mut told.overrun, Fault::SamplerOverrun).await,
            SourceError::Misaligned => self.overrun(&mut told.misaligned, Fault::SamplerMisaligned).await,
            SourceError::Ended => self.queue.end_sampler(),
            SourceError::Unreadable => {
                log!(error, "source unreadable");
                self.set_source_ready(false);
                self.queue.end_sampler();
                self.deliver(Task::Sampling, self.event(EventKind::Fault(Fault::SourceUnreadable))).await;
            }
        }
    }

    /// Counts an overrun. The first one of its kind is an event, the others are seen in the health records.
    async fn overrun(&self, told: &mut bool, fault: Fault) {
        self.note(|health| health.overruns = health.overruns.saturating_add(1));
        if !core::mem::replace(told, true) {
            self.deliver(Task::Sampling, self.event(EventKind::Fault(fault))).await;
        }
    }
}
