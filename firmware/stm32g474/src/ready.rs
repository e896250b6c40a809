//! The converter's "ready" line: its edge latches the encoder's count, and the interrupt comes from the latch.
//!
//! So the count belongs to the edge, whenever it is fetched; and an edge that was not fetched in time is detected.

use core::future::poll_fn;
use core::task::Poll;
use embassy_stm32::gpio::Pull;
use embassy_stm32::interrupt::typelevel::{Handler, Interrupt, TIM2 as Tim2Interrupt};
use embassy_stm32::pac::TIM2;
use embassy_stm32::pac::timer::vals::CcmrInputCcs;
use embassy_stm32::timer::input_capture::CapturePin;
use embassy_stm32::timer::{Ch3, TimerPin};
use embassy_stm32::{Peri, peripherals};
use embassy_sync::waitqueue::AtomicWaker;

/// Channel 3 is the first input of the second register, and the third flag.
const INPUT: (usize, usize) = (1, 0);
const CHANNEL: usize = 2;

static LATCHED: AtomicWaker = AtomicWaker::new();

/// Interrupt of the latch.
pub struct LatchHandler;

impl Handler<Tim2Interrupt> for LatchHandler {
    unsafe fn on_interrupt() {
        // The flag stays set for the waiting task.
        Tim2Interrupt::disable();
        LATCHED.wake();
    }
}

/// The latest edge of the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Encoder count.
    pub count: u32,
    /// An edge before this one was not fetched.
    pub missed: bool,
}

/// The line.
pub struct Ready {
    _private: (),
}

impl Ready {
    /// Takes the pin. The encoder must already be counting.
    pub fn new(pin: Peri<'static, impl TimerPin<peripherals::TIM2, Ch3>>) -> Self {
        // The pin stays connected.
        core::mem::forget(CapturePin::<peripherals::TIM2, Ch3>::new(pin, Pull::Up));
        let (register, input) = INPUT;
        TIM2.ccmr_input(register).modify(|w| w.set_ccs(input, CcmrInputCcs::TI4));
        TIM2.ccer().modify(|w| {
            // The falling edge.
            w.set_ccp(CHANNEL, true);
            w.set_cce(CHANNEL, true);
        });
        TIM2.dier().modify(|w| w.set_ccie(CHANNEL, true));
        Self { _private: () }
    }

    /// Discards a latched edge.
    pub fn clear(&mut self) {
        let _ = self.fetch();
    }

    /// Whether an edge is latched and not yet fetched.
    pub fn is_latched(&self) -> bool {
        TIM2.sr().read().ccif(CHANNEL)
    }

    /// Waits for the next edge, or returns the last one not fetched. The future may be dropped.
    pub async fn edge(&mut self) -> Edge {
        poll_fn(|context| {
            LATCHED.register(context.waker());
            if let Some(edge) = self.fetch() {
                return Poll::Ready(edge);
            }
            Tim2Interrupt::unpend();
            // SAFETY: the interrupt's handler only masks it again and wakes.
            unsafe { Tim2Interrupt::enable() };
            Poll::Pending
        })
        .await
    }

    fn fetch(&mut self) -> Option<Edge> {
        let flags = TIM2.sr().read();
        if !flags.ccif(CHANNEL) {
            return None;
        }
        // Reading clears the flag; another edge from here on sets it again.
        let count = TIM2.ccr(CHANNEL).read();
        let missed = flags.ccof(CHANNEL);
        if missed {
            // Writing 0 clears a flag, writing 1 leaves it unchanged.
            TIM2.sr().write(|w| {
                w.0 = u32::MAX;
                w.set_ccof(CHANNEL, false);
            });
        }
        Some(Edge { count, missed })
    }
}
