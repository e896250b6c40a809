//! Moves samples from the board's own source to the queue.

use crate::alive::{BEAT, Task};
use crate::app::App;
use crate::board::{Pace, SampleSource, SourceError};
use crate::logging::log;
use crate::queue::{BATCH, NotInUse};
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_futures::yield_now;
use embassy_time::Timer;
use inerter_core::RawSample;
use inerter_wire::{EventKind, Fault, Source};

/// Faults already reported as an event; later ones appear in the health records only.
#[derive(Default)]
struct Reported {
    overrun: bool,
    misaligned: bool,
}

/// Takes samples from the board's source while it is in use, and configures it while it is not.
///
/// Deadline on a [`Pace::Live`] source: the length of its buffer, because this task may wait for others on its
/// executor.
pub async fn sampling(app: &App, mut source: impl SampleSource) -> ! {
    let waits = source.pace() == Pace::OnDemand;
    app.set_sampler_waits(waits);
    let mut reported = Reported::default();
    let mut batch = [RawSample::default(); BATCH];
    loop {
        configure_until_wanted(app, &mut source).await;
        loop {
            let count = match select(app.queue.sampler_is(false), source.read(&mut batch)).await {
                Either::First(()) => break,
                Either::Second(Ok(count)) => count,
                Either::Second(Err(error)) => {
                    source_failed(app, error, &mut reported).await;
                    continue;
                }
            };
            app.heartbeats.beat(Task::Sampling);
            let samples = batch.get(..count).unwrap_or(&batch);
            if waits {
                // If it is no longer in use, the samples read ahead are dropped.
                let _ = app.queue.give(Source::Sampler, samples).await;
            } else if let Ok(lost @ 1..) = give_live(app, samples).await {
                // The sample counter will show the discontinuity.
                log!(warn, "no room for {} samples", lost);
                overrun(app, &mut reported.overrun, Fault::SamplerOverrun).await;
            }
        }
        source.halt().await;
    }
}

/// Makes the halted source apply settings, until samples are wanted from it.
async fn configure_until_wanted(app: &App, source: &mut impl SampleSource) {
    loop {
        app.heartbeats.beat(Task::Sampling);
        match select3(app.queue.sampler_is(true), app.configure.wait(), Timer::after(BEAT)).await {
            Either3::First(()) => return,
            Either3::Second(settings) => {
                let result = source.configure(&settings).await;
                app.configured.signal(result);
            }
            Either3::Third(()) => {}
        }
    }
}

/// Queues samples that cannot wait and returns how many found no room.
///
/// After a burst the estimator gets one turn to make room.
async fn give_live(app: &App, samples: &[RawSample]) -> Result<usize, NotInUse> {
    let left = app.queue.give_now(Source::Sampler, samples)?;
    if left == 0 {
        return Ok(0);
    }
    yield_now().await;
    app.queue.give_now(Source::Sampler, samples.get(samples.len() - left..).unwrap_or_default())
}

async fn source_failed(app: &App, error: SourceError, reported: &mut Reported) {
    match error {
        SourceError::Overrun => overrun(app, &mut reported.overrun, Fault::SamplerOverrun).await,
        SourceError::Misaligned => overrun(app, &mut reported.misaligned, Fault::SamplerMisaligned).await,
        SourceError::Ended => app.queue.end_sampler(),
        SourceError::Unreadable => {
            log!(error, "source unreadable");
            app.set_source_ready(false);
            app.queue.end_sampler();
            app.deliver(Task::Sampling, app.event(EventKind::Fault(Fault::SourceUnreadable))).await;
        }
    }
}

/// Counts an overrun. The first of its kind is sent as an event; the others appear in the health records only.
async fn overrun(app: &App, reported: &mut bool, fault: Fault) {
    app.note(|health| health.overruns = health.overruns.saturating_add(1));
    if !core::mem::replace(reported, true) {
        app.deliver(Task::Sampling, app.event(EventKind::Fault(fault))).await;
    }
}
