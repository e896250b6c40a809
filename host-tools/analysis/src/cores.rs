//! Work shared among the machine's cores.

use std::{sync::Mutex, thread};

/// The results of `each` for all work, in the order of the work, on as many cores as the machine has, up to `most`.
/// Panics if `each` does.
pub(crate) fn on_cores<T: Send, R: Send>(work: Vec<T>, most: usize, each: impl Fn(T) -> R + Sync) -> Vec<R> {
    let cores = thread::available_parallelism().map_or(1, usize::from).min(most).min(work.len());
    let mut results: Vec<Option<R>> = work.iter().map(|_| None).collect();
    let left = Mutex::new(work.into_iter().zip(&mut results));
    // Locked only while a core takes its next piece, not while it works on it.
    let next = || left.lock().ok()?.next();
    thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                while let Some((piece, result)) = next() {
                    *result = Some(each(piece));
                }
            });
        }
    });
    results.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_work() {
        for (count, most) in [(0_usize, 4), (1, 4), (100, 1), (100, 3), (100, usize::MAX)] {
            let squares: Vec<usize> = (0..count).map(|number| number * number).collect();
            assert_eq!(on_cores((0..count).collect(), most, |number: usize| number * number), squares);
        }
    }
}
