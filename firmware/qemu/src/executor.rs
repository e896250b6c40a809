//! The executor's loop, with WFI: QEMU's WFE does not sleep, and a spinning guest takes a whole core of the host.

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};
use critical_section::Mutex;
use embassy_executor::{Spawner, raw};
use embassy_time::Instant;
use static_cell::StaticCell;

static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
static PENDING: AtomicBool = AtomicBool::new(false);
static IDLE_US: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

// SAFETY: the name and signature that embassy-executor calls, defined once in the image.
#[unsafe(export_name = "__pender")]
fn pend(_context: *mut ()) {
    PENDING.store(true, Ordering::Release);
}

/// Runs the tasks that `spawn` starts, forever.
pub fn run(spawn: impl FnOnce(Spawner)) -> ! {
    let executor: &'static raw::Executor = EXECUTOR.init(raw::Executor::new(core::ptr::null_mut()));
    spawn(executor.spawner());
    loop {
        PENDING.store(false, Ordering::Release);
        // SAFETY: called here only, never recursively.
        unsafe { executor.poll() };
        critical_section::with(|cs| {
            if !PENDING.load(Ordering::Acquire) {
                let asleep = Instant::now();
                // Wakes on any pending interrupt, though it is served only after the critical section.
                cortex_m::asm::wfi();
                let idle_us = IDLE_US.borrow(cs);
                idle_us.set(idle_us.get() + asleep.elapsed().as_micros());
            }
        });
    }
}

/// Time spent with nothing to do since the start, in microseconds.
pub fn idle_us() -> u64 {
    critical_section::with(|cs| IDLE_US.borrow(cs).get())
}
