//! Signs of life for a watchdog.

use core::pin::Pin;
use core::sync::atomic::{AtomicU8, Ordering};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Timer};

/// Longest time that a task waits without a sign of life.
pub(crate) const BEAT: Duration = Duration::from_millis(250);

/// The tasks that give signs of life, as bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Task {
    Sampling = 1,
    Estimating = 2,
    Telemetry = 4,
    /// Not asked for: without it nothing less is measured.
    Health = 8,
}

/// Those without which nothing is measured.
const ALL: u8 = Task::Sampling as u8 | Task::Estimating as u8 | Task::Telemetry as u8;

/// Who has gone on lately.
pub(crate) struct Heartbeats(AtomicU8);

impl Heartbeats {
    pub const fn new() -> Self {
        Self(AtomicU8::new(0))
    }

    /// Whether all went on since the last call.
    pub fn all_since_last(&self) -> bool {
        self.0.swap(0, Ordering::Relaxed) & ALL == ALL
    }

    /// This task goes on.
    pub fn beat(&self, task: Task) {
        self.0.fetch_or(task as u8, Ordering::Relaxed);
    }

    /// Waits for something that ends by itself, with signs of life of this task.
    ///
    /// By reference: a future that is handed over is kept twice.
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
