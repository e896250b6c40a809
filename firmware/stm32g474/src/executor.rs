//! The two executors.
//!
//! The thread-mode executor sleeps when there is nothing to do, and counts for how long. The sampling executor runs in
//! an interrupt, above thread mode and below every peripheral.

use crate::work;
use core::cell::Cell;
use cortex_m::peripheral::SCB;
use critical_section::Mutex;
use embassy_executor::{InterruptExecutor, SendSpawner, Spawner, raw};
use embassy_stm32::interrupt::{self, InterruptExt, Priority, typelevel};
use embassy_time::Instant;
use static_cell::StaticCell;

/// The context for which embassy-executor's Cortex-M platform wakes by SEV instead of pending an interrupt.
const THREAD: *mut () = usize::MAX as *mut ();
/// SCR.SEVONPEND: an interrupt that becomes pending ends WFE even while interrupts are masked (ARMv7-M, B3.2.7).
const SEVONPEND: u32 = 1 << 4;

/// Above thread mode, below every peripheral.
const SAMPLING_PRIORITY: Priority = Priority::P6;

static EXECUTOR: StaticCell<raw::Executor> = StaticCell::new();
static IDLE_US: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));
static SAMPLING: InterruptExecutor = InterruptExecutor::new();

/// The thread-mode executor. There is only one.
pub struct Executor(&'static raw::Executor);

impl Executor {
    /// Must be called only once.
    pub fn new(scb: &SCB) -> Self {
        // SAFETY: sets one bit, which affects WFE only.
        unsafe { scb.scr.modify(|scr| scr | SEVONPEND) };
        Self(EXECUTOR.init(raw::Executor::new(THREAD)))
    }

    /// Accepts tasks, before and while it runs.
    pub fn spawner(&self) -> Spawner {
        self.0.spawner()
    }

    /// Runs the tasks forever.
    pub fn run(self) -> ! {
        loop {
            // SAFETY: called here only, never recursively.
            unsafe { self.0.poll() };
            // Interrupts are served after the measurement, so their time counts as work.
            critical_section::with(|cs| {
                let asleep = Instant::now();
                cortex_m::asm::wfe();
                let idle_us = IDLE_US.borrow(cs);
                idle_us.set(idle_us.get() + asleep.elapsed().as_micros());
            });
        }
    }
}

/// Time spent with nothing to do since the start, in microseconds.
pub fn idle_us() -> u64 {
    critical_section::with(|cs| IDLE_US.borrow(cs).get())
}

/// Interrupt of the sampling executor: the vector of an unused peripheral.
pub struct SamplingHandler;

impl typelevel::Handler<typelevel::UART4> for SamplingHandler {
    unsafe fn on_interrupt() {
        // SAFETY: the interrupt is enabled by the executor's start.
        work::counted_sampling(|| unsafe { SAMPLING.on_interrupt() });
    }
}

/// Starts the sampling executor. Must be called only once.
pub fn start_sampling() -> SendSpawner {
    interrupt::UART4.set_priority(SAMPLING_PRIORITY);
    SAMPLING.start(interrupt::UART4)
}
