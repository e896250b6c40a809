//! Cycles that each task takes, by the core's cycle counter (DWT_CYCCNT; ARMv7-M, C1.8).
//!
//! Always counted: a poll costs two reads of the counter and an addition. All numbers wrap; a difference over less than
//! 25 s is correct. The counter may stop while the core sleeps, when no task runs.

use core::future::poll_fn;
use core::pin::Pin;
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};
use cortex_m::peripheral::{DCB, DWT};

/// The tasks of thread mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    Estimating,
    Telemetry,
    Commands,
    Usb,
    Supervising,
}

/// Number of tasks.
const TASKS: usize = 5;

static TAKEN: [AtomicU32; TASKS] = [const { AtomicU32::new(0) }; TASKS];
static SAMPLING: AtomicU32 = AtomicU32::new(0);

/// Starts the counter.
pub fn start(dcb: &mut DCB, dwt: &mut DWT) {
    dcb.enable_trace();
    dwt.enable_cycle_counter();
}

/// Each has only one writer, so no atomic read-modify-write is needed.
fn add(to: &AtomicU32, cycles: u32) {
    to.store(to.load(Ordering::Relaxed).wrapping_add(cycles), Ordering::Relaxed);
}

/// Counts the cycles of the sampling interrupt, including those of interrupts that preempt it.
pub fn counted_sampling(work: impl FnOnce()) {
    let begin = DWT::cycle_count();
    work();
    add(&SAMPLING, DWT::cycle_count().wrapping_sub(begin));
}

/// A clock that stops during sampling and never goes back: if sampling ran between the two reads, a task that takes
/// next to no time would get a negative number, that is, one near 2^32.
fn thread_cycles() -> u32 {
    loop {
        let sampling = SAMPLING.load(Ordering::Relaxed);
        compiler_fence(Ordering::SeqCst);
        let now = DWT::cycle_count();
        compiler_fence(Ordering::SeqCst);
        if SAMPLING.load(Ordering::Relaxed) == sampling {
            return now.wrapping_sub(sampling);
        }
    }
}

/// Counts the cycles of a task.
pub async fn counted<F: Future>(task: Task, mut future: Pin<&mut F>) -> F::Output {
    poll_fn(|context| {
        let begin = thread_cycles();
        let polled = future.as_mut().poll(context);
        if let Some(taken) = TAKEN.get(task as usize) {
            add(taken, thread_cycles().wrapping_sub(begin));
        }
        polled
    })
    .await
}

/// Cycles so far: sampling, then the tasks in order.
pub fn cycles() -> [u32; 1 + TASKS] {
    let mut all = [SAMPLING.load(Ordering::Relaxed); 1 + TASKS];
    for (place, taken) in all.iter_mut().skip(1).zip(&TAKEN) {
        *place = taken.load(Ordering::Relaxed);
    }
    all
}
