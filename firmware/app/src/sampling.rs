//! From the board's own source to the queue.

use crate::BATCH;
use crate::app::App;
use crate::board::{Pace, SampleSource, SourceError};
use crate::logging::log;
use crate::queue::NotInUse;
use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use inerter_core::RawSample;
use inerter_wire::{EventKind, Fault, Source};

impl App {
    /// Takes samples from the board's source while it is in use.
    ///
    /// Deadline on a [`Pace::Live`] source: its own buffer, as this task may wait for others on the same executor.
    pub async fn sampling(&self, mut source: impl SampleSource) -> ! {
        let waits = source.pace() == Pace::OnDemand;
        self.set_sampler_waits(waits);
        let mut batch = [RawSample::default(); BATCH];
        loop {
            self.queue.sampler_is(true).await;
            let count = match select(self.queue.sampler_is(false), source.read(&mut batch)).await {
                Either::First(()) => continue,
                Either::Second(Ok(count)) => count,
                Either::Second(Err(error)) => {
                    self.source_failed(error).await;
                    continue;
                }
            };
            let samples = batch.get(..count).unwrap_or(&batch);
            if waits {
                // Not in use any more: what was read ahead belongs to nobody.
                let _ = self.queue.give(Source::Sampler, samples).await;
            } else if let Ok(lost @ 1..) = self.give_patiently(samples).await {
                // The sample counter will show the gap.
                log!(warn, "no room for {} samples", lost);
                self.overrun().await;
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

    async fn source_failed(&self, error: SourceError) {
        match error {
            SourceError::Overrun => self.overrun().await,
            SourceError::Ended => self.queue.end_sampler(),
            SourceError::Unreadable => {
                log!(error, "source unreadable");
                self.queue.end_sampler();
                self.deliver(self.event(EventKind::Fault(Fault::SourceUnreadable))).await;
            }
        }
    }

    /// Counts an overrun. The first one is an event, the others are seen in the health records.
    async fn overrun(&self) {
        let mut first = false;
        self.note(|health| {
            first = health.overruns == 0;
            health.overruns = health.overruns.saturating_add(1);
        });
        if first {
            self.deliver(self.event(EventKind::Fault(Fault::SamplerOverrun))).await;
        }
    }
}
