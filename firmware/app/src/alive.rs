//! Heartbeats for a watchdog.

use core::pin::Pin;
use core::sync::atomic::{AtomicU8, Ordering};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};

/// Longest time that a task waits without a heartbeat.
pub(crate) const BEAT: Duration = Duration::from_millis(250);

/// The tasks that give heartbeats, as bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Task {
    Sampling = 1,
    Estimating = 2,
    Telemetry = 4,
    /// Not required: measurement does not depend on it.
    Health = 8,
}

/// Which tasks have recently given a heartbeat.
const ALL: u8 = Task::Sampling as u8 | Task::Estimating as u8 | Task::Telemetry as u8;

/// Which tasks have given a heartbeat lately.
pub(crate) struct Heartbeats(AtomicU8);

impl Heartbeats {
    pub const fn new() -> Self {
        Self(AtomicU8::new(0))
    }

    /// Whether all required tasks have given a heartbeat since the last call.
    pub fn all_since_last(&self) -> bool {
        self.0.swap(0, Ordering::Relaxed) & ALL == ALL
    }

    /// Records a heartbeat of this task.
    pub fn beat(&self, task: Task) {
        self.0.fetch_or(task as u8, Ordering::Relaxed);
    }

    /// Waits for a future that completes by itself, while giving heartbeats of this task.
    ///
    /// By reference: a future passed by value would be stored twice.
    pub async fn with_heartbeat<F: Future>(&self, task: Task, mut future: Pin<&mut F>) -> F::Output {
        loop {
            match select(future.as_mut(), Timer::after(BEAT)).await {
                Either::First(output) => return output,
                Either::Second(()) => self.beat(task),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Heartbeats, Task};

    #[test]
    fn each_task_without_which_nothing_is_measured_is_missed() {
        let needed = [Task::Sampling, Task::Estimating, Task::Telemetry];
        for missing in [None, Some(Task::Sampling), Some(Task::Estimating), Some(Task::Telemetry)] {
            let hearts = Heartbeats::new();
            needed.into_iter().filter(|task| Some(*task) != missing).for_each(|task| hearts.beat(task));
            assert_eq!(hearts.all_since_last(), missing.is_none(), "{missing:?}");
            assert!(!hearts.all_since_last(), "each beat counts once");
        }
    }
}
