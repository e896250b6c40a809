//! Queue of samples for the estimator, from one source at a time.
//!
//! The queue knows the source in use and takes samples from no other. A change of source is therefore a single step,
//! however far the former source has got with its next batch.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::{Context, Poll};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::waitqueue::WakerRegistration;
use heapless::Deque;
use inerter_core::RawSample;
use inerter_wire::{Samples, Source};

/// Maximum number of samples that a source hands over at once, and that are processed without a pause for commands.
pub const BATCH: usize = Samples::MAX_SAMPLES;

/// Samples that can wait for the estimator: 64 ms at 4 kHz.
pub const QUEUE: usize = 256;

/// The queue, for at most `N` samples.
pub(crate) struct SampleQueue<const N: usize> {
    inner: Mutex<CriticalSectionRawMutex, RefCell<Inner<N>>>,
}

struct Inner<const N: usize> {
    samples: Deque<RawSample, N>,
    source: Source,
    ended: bool,
    taker: WakerRegistration,
    giver: WakerRegistration,
    sampler: WakerRegistration,
}

/// What [`SampleQueue::take`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Taken {
    /// This many samples, at least 1.
    Samples(usize),
    /// The sampler has ended, and its last sample was taken before.
    Ended,
}

/// The source that gives samples is no longer in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NotInUse;

impl<const N: usize> SampleQueue<N> {
    pub const fn new() -> Self {
        Self {
            inner: Mutex::new(RefCell::new(Inner {
                samples: Deque::new(),
                source: Source::Stopped,
                ended: false,
                taker: WakerRegistration::new(),
                giver: WakerRegistration::new(),
                sampler: WakerRegistration::new(),
            })),
        }
    }

    fn with<R>(&self, act: impl FnOnce(&mut Inner<N>) -> R) -> R {
        self.inner.lock(|inner| act(&mut inner.borrow_mut()))
    }

    /// The source in use.
    pub fn source(&self) -> Source {
        self.with(|inner| inner.source)
    }

    /// Samples that could be given now.
    pub fn free(&self) -> usize {
        self.with(|inner| inner.free())
    }

    /// Puts a source in use; returns the one before.
    ///
    /// Queued samples stay when the sampler halts or resumes, and are discarded when the link comes into or leaves use.
    pub fn change_source(&self, source: Source) -> Source {
        self.with(|inner| {
            let before = inner.source;
            if before != source {
                if before == Source::Link || source == Source::Link {
                    inner.samples.clear();
                }
                inner.source = source;
                inner.ended = false;
                inner.giver.wake();
                inner.sampler.wake();
            }
            before
        })
    }

    /// Halts the sampler and discards its queued samples; returns whether it was in use. Leaves the link alone.
    pub fn halt_sampler(&self) -> bool {
        self.with(|inner| {
            if inner.source == Source::Link {
                return false;
            }
            inner.samples.clear();
            inner.giver.wake();
            inner.sampler.wake();
            core::mem::replace(&mut inner.source, Source::Stopped) == Source::Sampler
        })
    }

    /// Halts a sampler that has no more samples, and reports that to the consumer after the last one.
    pub fn end_sampler(&self) {
        self.with(|inner| {
            if inner.source == Source::Sampler {
                inner.source = Source::Stopped;
                inner.ended = true;
                inner.taker.wake();
            }
        });
    }

    /// Waits until the sampler's being in use equals `wanted`. For one task only.
    pub async fn sampler_is(&self, wanted: bool) {
        poll_fn(|context| {
            self.with(|inner| {
                if (inner.source == Source::Sampler) == wanted {
                    return Poll::Ready(());
                }
                inner.sampler.register(context.waker());
                Poll::Pending
            })
        })
        .await
    }

    /// Waits until `act`, which is tried again whenever room is made, returns true; only the source in use may wait.
    fn when(
        &self,
        source: Source,
        mut act: impl FnMut(&mut Inner<N>) -> bool,
    ) -> impl Future<Output = Result<(), NotInUse>> {
        poll_fn(move |context| {
            self.with(|inner| {
                if inner.source != source {
                    return Poll::Ready(Err(NotInUse));
                }
                if act(inner) {
                    return Poll::Ready(Ok(()));
                }
                inner.giver.register(context.waker());
                Poll::Pending
            })
        })
    }

    /// Queues all of `samples`, waiting for room; only the source in use may wait.
    pub async fn give(&self, source: Source, samples: &[RawSample]) -> Result<(), NotInUse> {
        let mut left = samples;
        let give = |inner: &mut Inner<N>| {
            left = left.get(inner.put(left)..).unwrap_or_default();
            left.is_empty()
        };
        self.when(source, give).await
    }

    /// Waits until there is room for `count` samples of the source in use.
    pub fn room(&self, source: Source, count: usize) -> impl Future<Output = Result<(), NotInUse>> {
        self.when(source, move |inner| inner.free() >= count)
    }

    /// Queues as many as there is room for, and returns how many did not fit.
    pub fn give_now(&self, source: Source, samples: &[RawSample]) -> Result<usize, NotInUse> {
        self.with(|inner| {
            if inner.source != source {
                return Err(NotInUse);
            }
            Ok(samples.len() - inner.put(samples))
        })
    }

    /// Waits for samples and moves them to the front of `into`. The future may be dropped while it waits.
    pub async fn take(&self, into: &mut [RawSample]) -> Taken {
        poll_fn(|context| self.with(|inner| inner.poll_take(into, context))).await
    }

    /// Moves waiting samples to the front of `into` and returns how many, without waiting.
    pub fn take_now(&self, into: &mut [RawSample]) -> usize {
        self.with(|inner| inner.get(into))
    }
}

impl<const N: usize> Inner<N> {
    fn free(&self) -> usize {
        N - self.samples.len()
    }

    fn put(&mut self, samples: &[RawSample]) -> usize {
        let mut count = 0;
        for sample in samples {
            if self.samples.push_back(*sample).is_err() {
                break;
            }
            count += 1;
        }
        if count > 0 {
            self.taker.wake();
        }
        count
    }

    fn get(&mut self, into: &mut [RawSample]) -> usize {
        let mut count = 0;
        for place in into {
            let Some(sample) = self.samples.pop_front() else { break };
            *place = sample;
            count += 1;
        }
        if count > 0 {
            self.giver.wake();
        }
        count
    }

    fn poll_take(&mut self, into: &mut [RawSample], context: &mut Context) -> Poll<Taken> {
        let count = self.get(into);
        if count > 0 {
            return Poll::Ready(Taken::Samples(count));
        }
        if core::mem::take(&mut self.ended) {
            return Poll::Ready(Taken::Ended);
        }
        self.taker.register(context.waker());
        Poll::Pending
    }
}

#[cfg(test)]
mod tests {
    use super::{NotInUse, SampleQueue, Taken};
    use core::future::Future;
    use core::sync::atomic::{AtomicBool, Ordering};
    use core::task::{Context, Poll, Waker};
    use embassy_futures::block_on;
    use embassy_futures::poll_once;
    use inerter_core::RawSample;
    use inerter_wire::Source;
    use std::sync::Arc;
    use std::task::Wake;
    use std::vec::Vec;

    fn samples(indices: core::ops::Range<u32>) -> Vec<RawSample> {
        indices.map(|index| RawSample { index, ..RawSample::default() }).collect()
    }

    #[test]
    fn what_does_not_fit_is_reported() {
        let queue = SampleQueue::<8>::new();
        assert_eq!(queue.give_now(Source::Sampler, &samples(0..1)), Err(NotInUse));
        queue.change_source(Source::Sampler);
        assert_eq!(queue.give_now(Source::Sampler, &samples(0..5)), Ok(0));
        assert_eq!(queue.give_now(Source::Sampler, &samples(5..10)), Ok(2));
        assert_eq!(queue.free(), 0);
        let mut into = [RawSample::default(); 16];
        assert_eq!(block_on(queue.take(&mut into)), Taken::Samples(8));
        assert_eq!(into[..8], samples(0..8));
    }

    #[test]
    fn a_giver_waits_for_room_and_leaves_when_another_source_comes() {
        let queue = SampleQueue::<4>::new();
        queue.change_source(Source::Sampler);
        let more = samples(0..10);
        let mut giving = core::pin::pin!(queue.give(Source::Sampler, &more));
        assert!(poll_once(giving.as_mut()).is_pending());
        let mut into = [RawSample::default(); 3];
        assert_eq!(queue.take_now(&mut into), 3);
        assert!(poll_once(giving.as_mut()).is_pending());
        assert_eq!(queue.free(), 0);
        queue.change_source(Source::Link);
        assert_eq!(block_on(giving), Err(NotInUse));
        assert_eq!(queue.free(), 4, "the former source's samples are discarded");
        assert_eq!(block_on(queue.room(Source::Link, 4)), Ok(()));
    }

    #[test]
    fn samples_stay_when_the_sampler_halts_and_go_with_the_link() {
        for (before, after, left) in [
            (Source::Sampler, Source::Stopped, 3),
            (Source::Sampler, Source::Sampler, 3),
            (Source::Sampler, Source::Link, 0),
            (Source::Link, Source::Stopped, 0),
            (Source::Link, Source::Sampler, 0),
        ] {
            let queue = SampleQueue::<4>::new();
            queue.change_source(before);
            assert_eq!(queue.give_now(before, &samples(0..3)), Ok(0));
            assert_eq!(queue.change_source(after), before);
            assert_eq!((queue.source(), 4 - queue.free()), (after, left), "{before:?} {after:?}");
        }
    }

    #[test]
    fn the_end_comes_after_the_last_sample() {
        let queue = SampleQueue::<4>::new();
        queue.change_source(Source::Sampler);
        assert_eq!(queue.give_now(Source::Sampler, &samples(0..4)), Ok(0));
        queue.end_sampler();
        assert_eq!(queue.source(), Source::Stopped);
        let mut into = [RawSample::default(); 3];
        assert_eq!(block_on(queue.take(&mut into)), Taken::Samples(3));
        assert_eq!(block_on(queue.take(&mut into)), Taken::Samples(1));
        assert_eq!(block_on(queue.take(&mut into)), Taken::Ended);
        assert!(poll_once(queue.take(&mut into)).is_pending());
    }

    /// Records that it was woken.
    #[derive(Default)]
    struct Bell(AtomicBool);

    impl Wake for Bell {
        fn wake(self: Arc<Self>) {
            self.0.store(true, Ordering::Relaxed);
        }
    }

    /// Another poll would find the room too, but on the board a future that was not woken is not polled.
    #[test]
    fn taking_wakes_a_giver_that_waits_for_room_and_nothing_else_does() {
        let queue = SampleQueue::<4>::new();
        queue.change_source(Source::Link);
        let bell = Arc::new(Bell::default());
        let waker = Waker::from(bell.clone());
        let more = samples(0..6);
        let mut giving = core::pin::pin!(queue.give(Source::Link, &more));
        assert!(giving.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
        assert_eq!(queue.take_now(&mut []), 0);
        assert!(!bell.0.load(Ordering::Relaxed), "there is no more room than before");
        assert_eq!(queue.take_now(&mut [RawSample::default(); 3]), 3);
        assert!(bell.0.load(Ordering::Relaxed));
        assert!(giving.as_mut().poll(&mut Context::from_waker(&waker)).is_ready());
    }

    #[test]
    fn samples_wake_a_taker_that_waits_but_an_empty_batch_does_not() {
        let queue = SampleQueue::<4>::new();
        queue.change_source(Source::Sampler);
        let bell = Arc::new(Bell::default());
        let waker = Waker::from(bell.clone());
        let mut into = [RawSample::default(); 4];
        let mut taking = core::pin::pin!(queue.take(&mut into));
        assert!(taking.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
        assert_eq!(queue.give_now(Source::Sampler, &[]), Ok(0));
        assert!(!bell.0.load(Ordering::Relaxed), "there is nothing to take");
        assert_eq!(queue.give_now(Source::Sampler, &samples(0..3)), Ok(0));
        assert!(bell.0.load(Ordering::Relaxed));
        assert_eq!(taking.as_mut().poll(&mut Context::from_waker(&waker)), Poll::Ready(Taken::Samples(3)));
    }
}
