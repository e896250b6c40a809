//! Turns samples into estimates; the only task that touches the estimator.

use crate::alive::{BEAT, Task};
use crate::app::App;
use crate::logging::log;
use crate::messages::{Control, ControlDone, Outgoing};
use crate::queue::{BATCH, Taken};
use crate::tare::Tare;
use core::pin::pin;
use embassy_futures::select::{Either3, select3};
use embassy_time::{Duration, Instant, Timer};
use inerter_core::{
    Active, Bank, Change, Counters, Detail, Estimate, Law, Output, Published, RawSample, Reversal, State, Warning,
};
use inerter_wire::{Event, EventKind, SamplesBuilder, Streams};

/// How long raw samples wait for a full batch.
const FLUSH_AFTER: Duration = Duration::from_millis(50);

/// The remaining work of a [`Control`] that takes time.
enum Rest {
    Nothing,
    Flush,
    Tare,
    Finish,
}

/// Records to be sent, in this order.
#[derive(Default)]
struct Due {
    reversal: Option<Reversal>,
    /// The two records of the fast bank, then those of the slow one.
    sums: [bool; 4],
    warning: Option<Warning>,
    change: Option<Change>,
    estimate: Option<Estimate>,
    law: Option<Law>,
    /// Published last, as it completes the rest.
    detail: Option<Detail>,
    ended: bool,
}

impl Due {
    const BOTH_BANKS: [bool; 4] = [true; 4];
    const FAST: [bool; 4] = [true, true, false, false];
    const SLOW: [bool; 4] = [false, false, true, true];

    fn publish(&mut self, &Published { estimate, detail, law }: &Published) {
        (self.estimate, self.law, self.detail) = (Some(estimate), Some(law), Some(detail));
    }
}

struct Estimating<'a> {
    app: &'a App,
    state: &'a mut State,
    active: &'a mut Active,
    /// Counts from before the last reset of the estimator, which clears its own counters.
    before: Counters,
    tare: Option<Tare>,
    batch: SamplesBuilder,
    flush_at: Option<Instant>,
    /// Samples until sums are next due.
    until_sums: u32,
    /// Their bank: each bank's once a second, half a second apart, so that they do not all meet in the queue.
    next_sums: Bank,
    due: Due,
}

/// Runs samples through the estimator and passes on its output. `state` is reset first.
pub async fn estimating(app: &App, state: &mut State, active: &mut Active) -> ! {
    let mut estimating = Estimating {
        app,
        state,
        active,
        before: Counters::default(),
        tare: None,
        batch: SamplesBuilder::new(),
        flush_at: None,
        until_sums: 0,
        next_sums: Bank::Fast,
        due: Due::default(),
    };
    estimating.reset();
    let mut samples = [RawSample::default(); BATCH];
    loop {
        app.heartbeats.beat(Task::Estimating);
        let wake = Timer::at(estimating.wake_at());
        match select3(app.control.wait(), app.queue.take(&mut samples), wake).await {
            Either3::First(control) => {
                let rest = estimating.control(control);
                estimating.finish(rest, &mut samples).await;
            }
            Either3::Second(Taken::Samples(count)) => {
                estimating.take(samples.get(..count).unwrap_or_default()).await;
            }
            Either3::Second(Taken::Ended) => estimating.end(app.streams().estimates).await,
            Either3::Third(()) => estimating.flush_when_due().await,
        }
    }
}

impl Estimating<'_> {
    async fn take(&mut self, samples: &[RawSample]) {
        let stream = self.app.streams();
        for sample in samples {
            self.step(sample, stream);
            self.tell().await;
            self.add_to_tare(sample);
            if stream.samples {
                self.add_to_batch(sample).await;
            }
        }
        self.count();
    }

    /// Runs a sample through the estimator and notes which records are due. No part of the output is copied unless it
    /// is present.
    fn step(&mut self, sample: &RawSample, stream: Streams) {
        let Output { published, reversal, warning, change, .. } = &self.active.step(self.state, sample);
        if stream.estimates {
            if let Some(published) = published {
                self.due.publish(published);
            }
            if reversal.is_some() {
                self.due.reversal = *reversal;
            }
        }
        self.until_sums = self.until_sums.saturating_sub(1);
        if self.until_sums == 0 {
            self.until_sums = self.samples_per_second() / 2;
            (self.due.sums, self.next_sums) = match self.next_sums {
                Bank::Fast => (Due::FAST, Bank::Slow),
                Bank::Slow => (Due::SLOW, Bank::Fast),
            };
        }
        if warning.is_some() {
            self.due.warning = *warning;
        }
        if change.is_some() {
            // The last sums before the device changed: they restart with the next update.
            (self.due.change, self.due.sums) = (*change, Due::BOTH_BANKS);
        }
        if !stream.sums {
            self.due.sums = [false; 4];
        }
    }

    fn samples_per_second(&self) -> u32 {
        self.active.settings().sample_rate_hz as u32
    }

    /// Sends the records that are due.
    async fn tell(&mut self) {
        while let Some(outgoing) = self.next_due() {
            self.app.deliver(Task::Estimating, outgoing).await;
        }
    }

    fn next_due(&mut self) -> Option<Outgoing> {
        let due = &mut self.due;
        if let Some(reversal) = due.reversal.take() {
            return Some(Outgoing::Reversal(reversal));
        }
        if let Some(place) = due.sums.iter().position(|due| *due) {
            due.sums.iter_mut().take(place + 1).for_each(|due| *due = false);
            let bank = if place < 2 { Bank::Fast } else { Bank::Slow };
            return Some(match place % 2 {
                0 => Outgoing::Sums(self.active.sums(self.state, bank)),
                _ => Outgoing::MoreSums(self.active.more_sums(self.state, bank)),
            });
        }
        let warned = due.warning.take().map(EventKind::Warned);
        if let Some(kind) = warned.or_else(|| due.change.take().map(EventKind::Changed)) {
            return Some(Outgoing::Event(Event { index: self.state.last_index(), kind }));
        }
        if let Some(estimate) = due.estimate.take() {
            return Some(Outgoing::Estimate(estimate));
        }
        if let Some(law) = due.law.take() {
            return Some(Outgoing::Law(law));
        }
        if let Some(detail) = due.detail.take() {
            return Some(Outgoing::Detail(detail));
        }
        core::mem::take(&mut due.ended).then(|| self.app.event(EventKind::SourceEnded))
    }

    /// Counts since the start, whatever was reset.
    fn counters(&self) -> Counters {
        let (before, now) = (self.before, self.state.counters());
        Counters {
            discontinuities: before.discontinuities.saturating_add(now.discontinuities),
            lost_samples: before.lost_samples.saturating_add(now.lost_samples),
            saturated: before.saturated.saturating_add(now.saturated),
            ..before
        }
    }

    /// Copies the counters to the health record.
    fn count(&self) {
        let counters = self.counters();
        self.app.note(|health| {
            health.index = self.state.last_index();
            health.discontinuities = counters.discontinuities;
            health.lost_samples = counters.lost_samples;
            health.saturated = counters.saturated;
        });
    }

    async fn add_to_batch(&mut self, sample: &RawSample) {
        if self.batch.push(sample).is_err() {
            self.flush().await;
            // An empty batch has room.
            let _ = self.batch.push(sample);
        }
        if self.flush_at.is_none() {
            self.flush_at = Some(Instant::now() + FLUSH_AFTER);
        }
    }

    /// When there is something to do or a heartbeat to give, even if no samples arrive.
    fn wake_at(&self) -> Instant {
        let beat_at = Instant::now() + BEAT;
        self.flush_at.map_or(beat_at, |flush_at| flush_at.min(beat_at))
    }

    async fn flush_when_due(&mut self) {
        if self.flush_at.is_some_and(|at| at <= Instant::now()) {
            self.flush().await;
        }
    }

    async fn flush(&mut self) {
        self.flush_at = None;
        if !self.batch.is_empty() {
            let samples = self.batch.take();
            self.app.deliver_samples(Task::Estimating, samples).await;
        }
    }

    fn add_to_tare(&mut self, sample: &RawSample) {
        let Some(tare) = &mut self.tare else { return };
        if let Some(force_code) = tare.add(sample.force_code) {
            self.tare = None;
            self.app.control_done.signal(ControlDone::Tared { force_code });
        }
    }

    fn reset(&mut self) {
        self.before = self.counters();
        self.state.reset(self.active);
        self.until_sums = self.samples_per_second();
        self.next_sums = Bank::Fast;
        log!(info, "estimator reset");
    }

    /// Ends a source whose samples have all been taken: final records, after all of its raw samples.
    async fn end(&mut self, with_estimate: bool) {
        self.flush().await;
        let sent = pin!(self.app.samples_are_sent());
        self.app.heartbeats.with_heartbeat(Task::Estimating, sent).await;
        let any = self.state.counters().samples > 0;
        if any && with_estimate {
            self.due.publish(&self.active.publish(self.state));
        }
        self.due.sums = [any && self.app.streams().sums; 4];
        self.due.ended = true;
        self.tell().await;
    }

    /// Does what takes no time, and returns the rest of the work. Kept across a wait, a `Control` would be stored
    /// twice.
    fn control(&mut self, control: Control) -> Rest {
        match control {
            Control::Use { active, reset } => {
                *self.active = active;
                if reset {
                    self.reset();
                }
            }
            Control::Flush => return Rest::Flush,
            Control::Reset => self.reset(),
            Control::Tare(tare) => {
                self.tare = Some(tare);
                return Rest::Tare;
            }
            Control::CancelTare => self.tare = None,
            Control::Finish => return Rest::Finish,
        }
        Rest::Nothing
    }

    async fn finish(&mut self, rest: Rest, samples: &mut [RawSample]) {
        match rest {
            Rest::Nothing => {}
            Rest::Flush => self.flush().await,
            // Answered when the tare is complete.
            Rest::Tare => return,
            Rest::Finish => {
                loop {
                    let count = self.app.queue.take_now(samples);
                    if count == 0 {
                        break;
                    }
                    self.take(samples.get(..count).unwrap_or_default()).await;
                }
                self.end(true).await;
            }
        }
        self.app.control_done.signal(ControlDone::Plain);
    }
}
