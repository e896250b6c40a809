//! From samples to estimates; the only task that touches the estimator.

use crate::BATCH;
use crate::alive::{BEAT, Task};
use crate::app::App;
use crate::logging::log;
use crate::queue::Taken;
use crate::telemetry::Outgoing;
use core::pin::pin;
use embassy_futures::select::{Either3, select3};
use embassy_time::{Duration, Instant, Timer};
use inerter_core::{Active, Bank, Counters, RawSample, Settings, State};
use inerter_wire::{EventKind, SamplesBuilder};

/// How long raw samples wait for a full batch.
const FLUSH_AFTER: Duration = Duration::from_millis(50);

/// What the commands ask of the estimator. It is done between two batches, and answered by a [`ControlDone`].
#[allow(clippy::large_enum_variant, reason = "only one exists at a time")]
pub(crate) enum Control {
    /// Put other settings in use.
    Use {
        active: Active,
        /// Forget what was gathered under the ones before.
        reset: bool,
    },
    /// Hand on the raw samples that wait for a full batch.
    Flush,
    /// Forget everything.
    Reset,
    /// Average the force code over so many samples that are not saturated.
    Tare(Tare),
    /// Give the averaging up.
    CancelTare,
    /// Take every sample that waits, then publish a final estimate.
    Finish,
}

/// The answer to a [`Control`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ControlDone {
    /// Done.
    Plain,
    /// The averaged force code, for a tare that has run its course.
    Tared { force_code: i32 },
}

/// Force codes on the way to their average.
pub(crate) struct Tare {
    wanted: u32,
    /// Codes from here on, both ways, are saturated and do not count.
    least_code: i32,
    greatest_code: i32,
    taken: u32,
    sum: i64,
}

impl Tare {
    /// To average so many samples under these settings.
    pub fn new(samples: u32, settings: &Settings) -> Self {
        let (least_code, greatest_code) = (settings.force_min_code as i32, settings.force_max_code as i32);
        Self { wanted: samples.max(1), least_code, greatest_code, taken: 0, sum: 0 }
    }
}

struct Estimating<'a> {
    app: &'a App,
    state: &'a mut State,
    active: Active,
    /// Counted before the last reset of the estimator, whose own counters begin anew.
    before: Counters,
    tare: Option<Tare>,
    batch: SamplesBuilder,
    flush_at: Option<Instant>,
    /// Samples until the sums are next due.
    until_sums: u32,
}

impl App {
    /// Takes samples through the estimator and hands on what it says. `state` is reset first.
    pub async fn estimating(&self, state: &mut State, active: Active) -> ! {
        let mut estimating = Estimating {
            app: self,
            state,
            active,
            before: Counters::default(),
            tare: None,
            batch: SamplesBuilder::new(),
            flush_at: None,
            until_sums: 0,
        };
        estimating.reset();
        let mut samples = [RawSample::default(); BATCH];
        loop {
            self.beat(Task::Estimating);
            let wake = Timer::at(estimating.wake_at());
            match select3(self.control.wait(), self.queue.take(&mut samples), wake).await {
                Either3::First(control) => estimating.control(control, &mut samples).await,
                Either3::Second(Taken::Samples(count)) => {
                    estimating.take(samples.get(..count).unwrap_or_default()).await;
                }
                Either3::Second(Taken::Ended) => estimating.end(self.streams().estimates).await,
                Either3::Third(()) => estimating.flush_when_due().await,
            }
        }
    }
}

impl Estimating<'_> {
    async fn take(&mut self, samples: &[RawSample]) {
        let stream = self.app.streams();
        for sample in samples {
            if let Some(estimate) = self.active.step(self.state, sample)
                && stream.estimates
            {
                self.app.deliver(Task::Estimating, Outgoing::Estimate(estimate)).await;
            }
            self.until_sums = self.until_sums.saturating_sub(1);
            if self.until_sums == 0 {
                self.until_sums = self.samples_per_second();
                if stream.sums {
                    self.deliver_sums().await;
                }
            }
            self.add_to_tare(sample);
            if stream.samples {
                self.add_to_batch(sample).await;
            }
        }
        self.count();
    }

    fn samples_per_second(&self) -> u32 {
        self.active.settings().sample_rate_hz as u32
    }

    async fn deliver_sums(&self) {
        for bank in [Bank::Fast, Bank::Slow] {
            self.app.deliver(Task::Estimating, Outgoing::Sums(self.active.sums(self.state, bank))).await;
        }
    }

    /// Tells the health records what the estimator has counted.
    fn count(&self) {
        let (before, now) = (self.before, self.state.counters());
        self.app.note(|health| {
            health.index = self.state.last_index();
            health.gaps = before.gaps.saturating_add(now.gaps);
            health.lost_samples = before.lost_samples.saturating_add(now.lost_samples);
            health.saturated = before.saturated.saturating_add(now.saturated);
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

    /// When there is something to do, or a sign of life to give, without samples.
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
        if sample.force_code <= tare.least_code || sample.force_code >= tare.greatest_code {
            return;
        }
        tare.taken += 1;
        tare.sum += i64::from(sample.force_code);
        if tare.taken >= tare.wanted {
            let force_code = rounded_mean(tare.sum, tare.taken);
            self.tare = None;
            self.app.control_done.signal(ControlDone::Tared { force_code });
        }
    }

    fn reset(&mut self) {
        let now = self.state.counters();
        self.before.gaps = self.before.gaps.saturating_add(now.gaps);
        self.before.lost_samples = self.before.lost_samples.saturating_add(now.lost_samples);
        self.before.saturated = self.before.saturated.saturating_add(now.saturated);
        self.state.reset(&self.active);
        self.until_sums = self.samples_per_second();
        log!(info, "estimator reset");
    }

    /// Everything of this source has been taken: the last words, after all of its raw samples.
    async fn end(&mut self, with_estimate: bool) {
        self.flush().await;
        let sent = pin!(self.app.samples_are_sent());
        self.app.patiently(Task::Estimating, sent).await;
        if with_estimate && self.state.counters().samples > 0 {
            let estimate = self.active.estimate(self.state);
            self.app.deliver(Task::Estimating, Outgoing::Estimate(estimate)).await;
        }
        if self.app.streams().sums && self.state.counters().samples > 0 {
            self.deliver_sums().await;
        }
        self.app.deliver(Task::Estimating, self.app.event(EventKind::SourceEnded)).await;
    }

    async fn control(&mut self, control: Control, samples: &mut [RawSample]) {
        match control {
            Control::Use { active, reset } => {
                self.active = active;
                if reset {
                    self.reset();
                }
            }
            Control::Flush => self.flush().await,
            Control::Reset => self.reset(),
            Control::Tare(tare) => {
                self.tare = Some(tare);
                // Answered when it has run its course.
                return;
            }
            Control::CancelTare => self.tare = None,
            Control::Finish => {
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

/// Mean of `count` numbers that add up to `sum`, rounded half away from zero.
fn rounded_mean(sum: i64, count: u32) -> i32 {
    let count = i64::from(count.max(1));
    let half = if sum < 0 { -(count / 2) } else { count / 2 };
    ((sum + half) / count) as i32
}

#[cfg(test)]
mod tests {
    use super::rounded_mean;

    #[test]
    fn the_mean_rounds_half_away_from_zero() {
        assert_eq!(rounded_mean(5, 2), 3);
        assert_eq!(rounded_mean(-5, 2), -3);
        assert_eq!(rounded_mean(7, 3), 2);
        assert_eq!(rounded_mean(-8, 3), -3);
        assert_eq!(rounded_mean(i64::from(i32::MIN) * 500, 500), i32::MIN);
        assert_eq!(rounded_mean(0, 0), 0);
    }
}
