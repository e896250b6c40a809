//! SysTick as the time driver of embassy-time: an interrupt a millisecond, read to the microsecond.
//!
//! If QEMU itself did not run for milliseconds, several ticks come as one interrupt. The clock has then fallen behind
//! what it reported before; it holds until it has caught up, as embassy's executor and timers need monotonic time.

use core::cell::{Cell, RefCell};
use core::task::Waker;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use critical_section::{CriticalSection, Mutex};
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

/// Core clock of the machine, in Hz.
pub const CORE_HZ: u32 = 168_000_000;
const CORE_CYCLES_PER_MILLISECOND: u32 = CORE_HZ / 1_000;
const CORE_CYCLES_PER_MICROSECOND: u32 = CORE_HZ / 1_000_000;

struct SysTick {
    milliseconds: Mutex<Cell<u64>>,
    /// The latest time that was reported, in microseconds.
    told: Mutex<Cell<u64>>,
    next_wake: Mutex<Cell<u64>>,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static CLOCK: SysTick = SysTick {
    milliseconds: Mutex::new(Cell::new(0)),
    told: Mutex::new(Cell::new(0)),
    next_wake: Mutex::new(Cell::new(u64::MAX)),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

impl SysTick {
    fn now_in(&self, cs: CriticalSection) -> u64 {
        let mut cycles_left = SYST::get_current();
        let mut milliseconds = self.milliseconds.borrow(cs).get();
        if SCB::is_pendst_pending() {
            // Wrapped, and the interrupt has not counted it yet.
            cycles_left = SYST::get_current();
            milliseconds += 1;
        }
        let cycles = (CORE_CYCLES_PER_MILLISECOND - 1).saturating_sub(cycles_left);
        let now = milliseconds * 1_000 + u64::from(cycles / CORE_CYCLES_PER_MICROSECOND);
        let told = self.told.borrow(cs);
        told.set(told.get().max(now));
        told.get()
    }

    fn wake_due(&self, cs: CriticalSection) {
        let now = self.now_in(cs);
        if self.next_wake.borrow(cs).get() <= now {
            let next = self.queue.borrow(cs).borrow_mut().next_expiration(now);
            self.next_wake.borrow(cs).set(next);
        }
    }
}

impl Driver for SysTick {
    fn now(&self) -> u64 {
        critical_section::with(|cs| self.now_in(cs))
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            if self.queue.borrow(cs).borrow_mut().schedule_wake(at, waker) {
                let next = self.next_wake.borrow(cs);
                next.set(next.get().min(at));
            }
            self.wake_due(cs);
        });
    }
}

/// Starts the clock.
pub fn start(mut systick: SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(CORE_CYCLES_PER_MILLISECOND - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| {
        let milliseconds = CLOCK.milliseconds.borrow(cs);
        milliseconds.set(milliseconds.get() + 1);
        CLOCK.wake_due(cs);
    });
}
