//! The sampling hardware: one timer event starts everything, and no interrupt latency enters the data.
//!
//! ```text
//! TIM6, 64 kHz --TRGO--> ADC1 (force) ---request--> DMA1_CH2 --> forces[512]
//!       |        '-----> ADC2 (terminal) -request-> DMA1_CH3 --> terminals[512], interrupts at half and at the end
//!       '-update request--------------------------> DMA1_CH1 --> counts[512], from TIM2's 32-bit encoder count
//! ```
//!
//! The three rings have the same length and start together, so entry `n` of each belongs to the same event. A *half*
//! (256 entries, 4 ms) is read while the hardware fills the other one. The state of the hardware is checked at each
//! half: the rings must be at the same entry, in the expected half, with no conversion overrun.
//!
//! Sources: RM0440 12 (DMA), 13 table 91 (DMAMUX), 21 (ADC; trigger 13 of table 163 is TIM6_TRGO), 29 and 31 (timers).

use crate::adc;
use crate::boards::clock::{CORE_HZ, CORE_PER_US};
use core::cell::UnsafeCell;
use core::future::poll_fn;
use core::ptr;
use core::task::Poll;
use embassy_stm32::adc::{AdcChannel, Instance};
use embassy_stm32::gpio::Pull;
use embassy_stm32::interrupt::typelevel::{DMA1_CHANNEL3, Handler, Interrupt};
use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adc::vals::{Adstp, Dmacfg, Dmaen, Exten, Ovrmod, SampleTime};
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, FilterValue, Mms, Sms, Urs};
use embassy_stm32::pac::{ADC1, ADC2, ADC12_COMMON, DMA1, DMAMUX1, RCC, TIM2, TIM6};
use embassy_stm32::timer::input_capture::CapturePin;
use embassy_stm32::timer::{Ch1, Ch2, TimerPin};
use embassy_stm32::{Peri, peripherals};
use embassy_sync::waitqueue::AtomicWaker;

/// Events per second.
pub const ENTRIES_PER_S: u32 = 64_000;
/// Entries in half a ring: 4 ms.
pub const HALF: usize = 256;
const RING: usize = 2 * HALF;

/// Timer ticks between two events.
const TICKS: u32 = CORE_HZ / ENTRIES_PER_S;
const _: () = assert!(TICKS * ENTRIES_PER_S == CORE_HZ && TICKS <= 0x1_0000);

/// Timer ticks from an event until its codes are certain to be in the rings: 0.95 us for the conversion, and the same
/// again for the transfers.
const SETTLED: u16 = 2 * CORE_PER_US as u16;
/// The same for the check that the rings are at the same entry: a converter that samples some microseconds late still
/// belongs to its event, and restarts would hide its delay, which the test with jumpers measures.
const ALIGNED: u16 = 5 * CORE_PER_US as u16;
/// Polls of the rings, about 20 ticks each, until one falls between two events: more than [`ALIGNED`].
const POLLS: usize = 64;
/// Polls of a converter until its discarded conversion ends or it stops, of at least 10 cycles each: it takes 150.
const DISCARD_POLLS: usize = 100;

// DMA channels, counted from 0 as the registers are.
const COUNTS: usize = 0;
const FORCES: usize = 1;
const TERMINALS: usize = 2;
// DMAMUX request lines (RM0440, table 91).
const REQUEST_TIM6_UPDATE: u8 = 8;
const REQUEST_ADC1: u8 = 5;
const REQUEST_ADC2: u8 = 36;
/// ADC trigger (RM0440, table 163).
const TRIGGER_TIM6: u8 = 13;

/// Written by the DMA only.
struct Memory {
    counts: UnsafeCell<[u32; RING]>,
    forces: UnsafeCell<[u16; RING]>,
    terminals: UnsafeCell<[u16; RING]>,
}

// SAFETY: read by the one `Rings` only, and only the half that the DMA is not writing.
unsafe impl Sync for Memory {}

static MEMORY: Memory = Memory {
    counts: UnsafeCell::new([0; RING]),
    forces: UnsafeCell::new([0; RING]),
    terminals: UnsafeCell::new([0; RING]),
};
static HALF_IS_FULL: AtomicWaker = AtomicWaker::new();

/// Interrupt of the ring that is filled last.
pub struct HalfHandler;

impl Handler<DMA1_CHANNEL3> for HalfHandler {
    unsafe fn on_interrupt() {
        // The flags stay set for the waiting task, so nothing is decided twice.
        DMA1_CHANNEL3::disable();
        HALF_IS_FULL.wake();
    }
}

/// One half of each ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// Entries 0 to 255.
    First,
    /// Entries 256 to 511.
    Second,
}

impl Half {
    /// The next half.
    pub fn next(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }

    fn start(self) -> usize {
        match self {
            Self::First => 0,
            Self::Second => HALF,
        }
    }
}

/// Why a half cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RingError {
    /// The reader was late: halves were overwritten.
    Late,
    /// A conversion was not fetched in time. The converters have stopped.
    Overrun,
    /// The rings are not at the same entry, or a transfer failed. Nothing in them can be trusted.
    Misaligned,
}

/// An analogue input, by its channel.
pub struct Analogue {
    channel: u8,
}

/// Takes an input of the converter `T`; its pin is analogue from reset on.
pub fn analogue<T: Instance>(pin: impl AdcChannel<T> + 'static) -> Analogue {
    Analogue { channel: pin.degrade_adc().get_hw_channel() }
}

/// The encoder's counter.
pub struct Encoder {
    _private: (),
}

/// Takes the encoder's inputs and starts counting: four counts per line, 32 bits, wrapping.
pub fn encoder(
    _timer: Peri<'static, peripherals::TIM2>,
    a: Peri<'static, impl TimerPin<peripherals::TIM2, Ch1>>,
    b: Peri<'static, impl TimerPin<peripherals::TIM2, Ch2>>,
) -> Encoder {
    // The pins stay connected.
    core::mem::forget(CapturePin::<peripherals::TIM2, Ch1>::new(a, Pull::Up));
    core::mem::forget(CapturePin::<peripherals::TIM2, Ch2>::new(b, Pull::Up));
    critical_section::with(|_| RCC.apb1enr1().modify(|w| w.set_tim2en(true)));
    TIM2.ccmr_input(0).write(|w| {
        for input in 0..2 {
            w.set_ccs(input, CcmrInputCcs::TI4);
            // 6 equal samples at 84 MHz: pulses under 71 ns are rejected as noise, and lines pass up to 3 MHz.
            w.set_icf(input, FilterValue::FDTS_DIV2_N6);
        }
    });
    TIM2.arr().write_value(u32::MAX);
    TIM2.smcr().write(|w| w.set_sms(Sms::ENCODER_MODE_3));
    TIM2.cr1().write(|w| w.set_cen(true));
    Encoder { _private: () }
}

/// The rings and the hardware that fills them.
pub struct Rings {
    _encoder: Encoder,
    /// Whether both converters are ready.
    ready: bool,
}

impl Rings {
    /// Prepares everything up to the start.
    pub fn new(force: Analogue, terminal: Analogue, encoder: Encoder) -> Self {
        critical_section::with(|_| {
            RCC.ahb2enr().modify(|w| w.set_adc12en(true));
            RCC.apb1enr1().modify(|w| w.set_tim6en(true));
        });
        // This clock differs from the timer's, though both come from the same PLL. A trigger is synchronised to it: 1.5
        // to 2.5 of its periods, cycling through four phases, because 2625 ticks are not a multiple of 4; the same for
        // both converters.
        adc::choose_clock(ADC12_COMMON);
        let ready = convert(ADC1, force.channel) & convert(ADC2, terminal.channel);
        TIM6.cr1().write(|w| w.set_urs(Urs::COUNTER_ONLY));
        TIM6.cr2().write(|w| w.set_mms(Mms::UPDATE));
        TIM6.arr().write(|w| w.set_arr((TICKS - 1) as u16));
        Self { _encoder: encoder, ready }
    }

    /// Whether the converters can convert.
    pub fn are_ready(&self) -> bool {
        self.ready
    }

    /// Starts all three rings at entry 0. The first event comes a period later.
    pub fn start(&mut self) {
        for adc in [ADC1, ADC2] {
            discard(adc);
            // A leftover conversion would be one entry ahead of the others.
            adc.isr().write(|w| {
                w.set_eoc(true);
                w.set_eos(true);
                w.set_ovr(true);
            });
        }
        let counts = MEMORY.counts.get() as u32;
        prepare(COUNTS, REQUEST_TIM6_UPDATE, TIM2.cnt().as_ptr() as u32, counts, Size::BITS32);
        prepare(FORCES, REQUEST_ADC1, ADC1.dr().as_ptr() as u32, MEMORY.forces.get() as u32, Size::BITS16);
        prepare(TERMINALS, REQUEST_ADC2, ADC2.dr().as_ptr() as u32, MEMORY.terminals.get() as u32, Size::BITS16);
        for adc in [ADC1, ADC2] {
            adc.cr().modify(|w| w.set_adstart(true));
        }
        TIM6.cnt().write(|w| w.set_cnt(0));
        // Last, because a request waits for its channel.
        TIM6.dier().write(|w| w.set_ude(true));
        TIM6.cr1().modify(|w| w.set_cen(true));
    }

    /// Stops everything, after the transfers in progress.
    pub fn stop(&mut self) {
        TIM6.cr1().modify(|w| w.set_cen(false));
        // A conversion takes 0.95 us from the event, its transfer less.
        cortex_m::asm::delay(2 * CORE_PER_US);
        TIM6.dier().write(|_| ());
        for adc in [ADC1, ADC2] {
            if adc.cr().read().adstart() {
                adc.cr().modify(|w| w.set_adstp(Adstp::STOP));
                // If it does not stop, no half will become full after the next start, which is detected.
                let _ = (0..DISCARD_POLLS).any(|_| !adc.cr().read().adstart());
            }
        }
        for channel in [COUNTS, FORCES, TERMINALS] {
            DMA1.ch(channel).cr().write(|_| ());
        }
    }

    /// Waits until a half is full. The future may be dropped.
    pub async fn full(&mut self) -> Result<Half, RingError> {
        poll_fn(|context| {
            HALF_IS_FULL.register(context.waker());
            let result = self.check();
            if result.is_pending() {
                DMA1_CHANNEL3::unpend();
                // SAFETY: the interrupt's handler only masks it again and wakes.
                unsafe { DMA1_CHANNEL3::enable() };
            }
            result
        })
        .await
    }

    /// The half that was filled last.
    pub fn latest(&self) -> Half {
        if position(TERMINALS) < HALF { Half::Second } else { Half::First }
    }

    /// The contents of a full half: counts, force codes, terminal codes.
    ///
    /// Valid only if [`holds`](Self::holds) is true afterwards.
    pub fn half(&self, half: Half) -> (&[u32; HALF], &[u16; HALF], &[u16; HALF]) {
        let start = half.start();
        // SAFETY: the pointers stay inside the rings. The DMA writes the other half; if it has come back meanwhile, the
        // numbers are arbitrary, and `holds` shows the caller that they are invalid.
        unsafe {
            (
                &*ptr::from_ref(&(*MEMORY.counts.get())[start]).cast(),
                &*ptr::from_ref(&(*MEMORY.forces.get())[start]).cast(),
                &*ptr::from_ref(&(*MEMORY.terminals.get())[start]).cast(),
            )
        }
    }

    /// Whether the hardware has not yet returned to this half.
    pub fn holds(&self, half: Half) -> bool {
        let flags = DMA1.isr().read();
        let other_is_full = match half {
            Half::First => flags.tcif(TERMINALS),
            Half::Second => flags.htif(TERMINALS),
        };
        !other_is_full && self.latest() == half
    }

    /// Whether a conversion was not fetched in time; no half will be full then.
    pub fn are_overrun(&self) -> bool {
        [ADC1, ADC2].iter().any(|adc| adc.isr().read().ovr())
    }

    fn check(&self) -> Poll<Result<Half, RingError>> {
        let flags = DMA1.isr().read();
        if [COUNTS, FORCES, TERMINALS].iter().any(|&channel| flags.teif(channel)) {
            return Poll::Ready(Err(RingError::Misaligned));
        }
        let (first, second) = (flags.htif(TERMINALS), flags.tcif(TERMINALS));
        if !first && !second {
            return Poll::Pending;
        }
        DMA1.ifcr().write(|w| {
            w.set_htif(TERMINALS, first);
            w.set_tcif(TERMINALS, second);
        });
        if self.are_overrun() {
            return Poll::Ready(Err(RingError::Overrun));
        }
        if !are_aligned() {
            return Poll::Ready(Err(RingError::Misaligned));
        }
        let half = if first { Half::First } else { Half::Second };
        Poll::Ready(if (first && second) || self.latest() != half { Err(RingError::Late) } else { Ok(half) })
    }
}

/// Entry that a ring's channel writes next.
fn position(channel: usize) -> usize {
    RING.saturating_sub(usize::from(DMA1.ch(channel).ndtr().read().ndt())) % RING
}

/// Whether all rings are at the same entry. An error of one entry looks like a damper: 47 N s/m for 300 kg at 16 Hz.
fn are_aligned() -> bool {
    let tick = || TIM6.cnt().read().cnt();
    for _ in 0..POLLS {
        let before = tick();
        let positions = [COUNTS, FORCES, TERMINALS].map(position);
        // No event occurred between the two: the timer restarts at each event.
        if before >= ALIGNED && tick() >= before {
            return positions == [positions[COUNTS]; 3];
        }
    }
    false
}

fn prepare(channel: usize, request: u8, from: u32, to: u32, size: Size) {
    DMA1.ch(channel).cr().write(|_| ());
    DMA1.ifcr().write(|w| {
        w.set_gif(channel, true);
        w.set_tcif(channel, true);
        w.set_htif(channel, true);
        w.set_teif(channel, true);
    });
    DMAMUX1.ccr(channel).write(|w| w.set_dmareq_id(request));
    DMA1.ch(channel).par().write_value(from);
    DMA1.ch(channel).mar().write_value(to);
    DMA1.ch(channel).ndtr().write(|w| w.set_ndt(RING as u16));
    let interrupts = channel == TERMINALS;
    DMA1.ch(channel).cr().write(|w| {
        w.set_dir(Dir::FROM_PERIPHERAL);
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(size);
        w.set_msize(size);
        w.set_pl(Pl::VERY_HIGH);
        w.set_htie(interrupts);
        w.set_tcie(interrupts);
        w.set_teie(interrupts);
        w.set_en(true);
    });
}

/// Converts once and discards it: the first conversion after a stop may be of another channel (ES0430 2.7.10), and the
/// first one more than 1 ms after the one before may be wrong (ES0430 2.7.9).
fn discard(adc: Adc) {
    let by_event = adc.cfgr().read();
    adc.cfgr().modify(|w| {
        w.set_dmaen(Dmaen::DISABLE);
        w.set_exten(Exten::DISABLED);
    });
    adc.cr().modify(|w| w.set_adstart(true));
    // If it does not end, no half will ever become full, which is detected.
    let _ = (0..DISCARD_POLLS).any(|_| !adc.cr().read().adstart());
    let _ = adc.dr().read();
    adc.cfgr().write_value(by_event);
}

/// Whether no conversion is running and none will start within this many of the timer's ticks.
pub fn rest_for(ticks: u16) -> bool {
    let rest = SETTLED..TICKS as u16 - ticks;
    !TIM6.cr1().read().cen() || rest.contains(&TIM6.cnt().read().cnt())
}

/// Sets up one conversion of the channel per event, always fetched by DMA. Returns whether the converter is ready.
fn convert(adc: Adc, channel: u8) -> bool {
    let ready = adc::switch_on(adc);
    adc.sqr1().write(|w| w.set_sq(0, channel));
    adc.smpr().write(|w| w.set_smp(usize::from(channel), SampleTime::CYCLES24_5));
    adc.cfgr().write(|w| {
        w.set_dmaen(Dmaen::ENABLE);
        w.set_dmacfg(Dmacfg::CIRCULAR);
        w.set_extsel(TRIGGER_TIM6);
        w.set_exten(Exten::RISING_EDGE);
        // Unfetched data is kept, and requests cease: an overrun cannot go unnoticed.
        w.set_ovrmod(Ovrmod::PRESERVE);
        w.set_jqdis(true);
    });
    ready
}
