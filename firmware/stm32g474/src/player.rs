//! The player of the self-test with jumpers: two D/A converters, and two pins as an encoder.
//!
//! ```text
//! TIM7, 64 kHz --TRGO--> DAC1 (force)    ---request--> DMA2_CH2 <-- forces[256]
//!       |        '-----> DAC2 (terminal) ---request--> DMA2_CH3 <-- terminals[256]
//!       '-update request------------------------------> DMA2_CH1 <-- pins[256], interrupts at half and at the end
//! ```
//!
//! TIM7 has the clock and the period of TIM6, which samples, and lags it by a number of ticks that the host sets, so
//! that the host can observe a change of the outputs before, at and after the ADCs' aperture. All of this runs, and
//! pins are driven, only from `Begin` to `End`. At each event a converter outputs what the DMA transferred after the
//! previous event; the pins, which need no trigger, are delayed by a step, so that all three change together. A failed
//! transfer ends everything as `End` does, and `End` then reports it.
//!
//! Sources: RM0440 12.4.7 (DMA errors), 22 (DAC; trigger 2: TIM7_TRGO), 13 table 91 (DMAMUX), 33 (TIM7), 9.4.7 (BSRR).

use crate::boards::clock::{CORE_HZ, CORE_PER_US};
use crate::rings::ENTRIES_PER_S;
use core::cell::{RefCell, UnsafeCell};
use critical_section::Mutex;
use embassy_stm32::gpio::{AnyPin, Flex, Pin, Speed};
use embassy_stm32::interrupt::typelevel::{DMA2_CHANNEL1, Handler, Interrupt};
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::timer::vals::{Mms, Urs};
use embassy_stm32::pac::{DAC1, DAC2, DMA2, DMAMUX1, RCC, TIM6, TIM7};
use embassy_stm32::{Peri, peripherals};
use embassy_time::{Duration, Instant};
use inerter_app::player::{Player, Step, quadrature};
use inerter_wire::{Knot, Play, Refusal};
use static_cell::ConstStaticCell;

/// Steps in half a ring: two knots, so knots can run out only between halves.
const HALF: usize = 2 * Knot::STEPS as usize;
const RING: usize = 2 * HALF;
/// Knots that can wait.
const WAITING: usize = 256;
/// Ticks of the core's clock per step.
const TICKS: u16 = (CORE_HZ / ENTRIES_PER_S) as u16;
/// Edges closer than this, including the bus's jitter, are rejected as noise by the encoder's inputs (71 ns).
const LEAST_EDGE_TICKS: u16 = 24;
/// The outputs are released after this long without a request from the host.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time for a converter's output to wake up (DS12288: at most 7.5 us), in us.
const WAKE_UP_US: u32 = 10;

// DMA channels, counted from 0 as the registers are; their multiplexer channels are the second eight.
const PINS: usize = 0;
const FORCES: usize = 1;
const TERMINALS: usize = 2;
const MUX: usize = 8;
// DMAMUX request lines (RM0440, table 91).
const REQUEST_TIM7_UPDATE: u8 = 9;
const REQUEST_DAC1_CH1: u8 = 6;
const REQUEST_DAC2_CH1: u8 = 41;
/// TSEL (RM0440, 22.4.2).
const TRIGGER_TIM7: u8 = 2;
/// HFSEL for a bus clock over 160 MHz (RM0440, 22.7.16).
const OVER_160_MHZ: u8 = 2;

/// Read by the DMA, written by the one player in a critical section, and only the half that the DMA is not reading.
struct Memory {
    pins: UnsafeCell<[u32; RING]>,
    forces: UnsafeCell<[u16; RING]>,
    terminals: UnsafeCell<[u16; RING]>,
}

// SAFETY: see above.
unsafe impl Sync for Memory {}

static MEMORY: Memory = Memory {
    pins: UnsafeCell::new([0; RING]),
    forces: UnsafeCell::new([0; RING]),
    terminals: UnsafeCell::new([0; RING]),
};
static OUTPUTS: Mutex<RefCell<Option<Outputs>>> = Mutex::new(RefCell::new(None));
/// Separate from the outputs, because initial values would take space in flash.
static KNOTS: ConstStaticCell<[Knot; WAITING]> =
    ConstStaticCell::new([Knot { force: 0, terminal: 0, advance: 0 }; WAITING]);

/// Interrupt of the ring of pins.
pub struct HalfHandler;

impl Handler<DMA2_CHANNEL1> for HalfHandler {
    unsafe fn on_interrupt() {
        with(Outputs::refill);
    }
}

fn with<R>(act: impl FnOnce(&mut Outputs) -> R) -> Option<R> {
    critical_section::with(|cs| OUTPUTS.borrow_ref_mut(cs).as_mut().map(act))
}

/// The outputs of the player.
pub struct Wires {
    a: Flex<'static>,
    b: Flex<'static>,
    /// BSRR of their port, and their bits in it.
    bsrr: u32,
    bits: (u32, u32),
}

/// Takes the outputs. None is driven before the host begins.
///
/// # Panics
/// If A and B are on different ports: one write drives both.
pub fn wires(
    _timer: Peri<'static, peripherals::TIM7>,
    _force: (Peri<'static, peripherals::DAC1>, Peri<'static, peripherals::PA4>),
    _terminal: (Peri<'static, peripherals::DAC2>, Peri<'static, peripherals::PA6>),
    a: Peri<'static, impl Pin>,
    b: Peri<'static, impl Pin>,
) -> Wires {
    assert!(a.port() == b.port(), "A and B are of one port");
    let bits = (1 << a.pin(), 1 << b.pin());
    let a: Peri<'static, AnyPin> = a.into();
    let bsrr = a.block().bsrr().as_ptr() as u32;
    Wires { a: Flex::new(a), b: Flex::new(b), bsrr, bits }
}

/// Stores the outputs for [`play`]. Must be called only once, at the start.
pub fn start(wires: Wires) {
    critical_section::with(|cs| OUTPUTS.borrow_ref_mut(cs).replace(Outputs::new(wires)));
}

/// Executes a host's request; returns the answer and the room for knots.
pub fn play(play: &Play) -> Result<(u32, u16), Refusal> {
    with(|outputs| outputs.play(play)).unwrap_or(Err(Refusal::Unsupported))
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// No pin is driven.
    Off,
    Knots,
    /// Rings of edges still to be output.
    Burst(u16),
    /// The burst is over, and the outputs hold.
    Stands,
}

struct Outputs {
    wires: Wires,
    state: State,
    player: Player,
    /// A ring buffer: `waiting` knots, from `first` on.
    knots: &'static mut [Knot; WAITING],
    first: usize,
    waiting: usize,
    /// Levels of the previous step: see the module documentation.
    pins: u32,
    /// Knots taken since the beginning.
    taken: u32,
    /// How often the outputs stopped because no knots had arrived.
    stood: u32,
    /// Edges of the burst.
    edges: u32,
    heard: Instant,
}

impl Outputs {
    fn new(wires: Wires) -> Self {
        Self {
            wires,
            state: State::Off,
            player: Player::new(),
            knots: KNOTS.take(),
            first: 0,
            waiting: 0,
            pins: 0,
            taken: 0,
            stood: 0,
            edges: 0,
            heard: Instant::MIN,
        }
    }

    fn play(&mut self, play: &Play) -> Result<(u32, u16), Refusal> {
        self.heard = Instant::now();
        let answer = match play {
            Play::Begin { phase_ticks } => self.begin(*phase_ticks)?,
            Play::Knots(knots) => self.take(knots)?,
            Play::Burst { edge_ticks, blocks } => self.burst(*edge_ticks, *blocks)?,
            Play::End => {
                self.end();
                self.stood
            }
            Play::Progress if self.state == State::Off => return Err(Refusal::NotPlaying),
            Play::Progress => self.edges,
        };
        Ok((answer, self.free()))
    }

    fn free(&self) -> u16 {
        (WAITING - self.waiting) as u16
    }

    fn take(&mut self, knots: &[Knot]) -> Result<u32, Refusal> {
        if self.state != State::Knots {
            return Err(Refusal::NotPlaying);
        }
        if !knots.iter().all(Knot::is_possible) {
            return Err(Refusal::BadSamples);
        }
        if knots.len() > WAITING - self.waiting {
            return Err(Refusal::QueueFull { accepted: self.taken, free: self.free() });
        }
        if self.waiting == 0 && self.player.stands() && self.taken > 0 {
            self.stood = self.stood.saturating_add(1);
        }
        for knot in knots {
            self.knots[(self.first + self.waiting) % WAITING] = *knot;
            self.waiting += 1;
        }
        self.taken = self.taken.wrapping_add(knots.len() as u32);
        Ok(self.taken)
    }

    fn begin(&mut self, phase_ticks: u16) -> Result<u32, Refusal> {
        if phase_ticks >= TICKS {
            return Err(Refusal::BadSamples);
        }
        if !TIM6.cr1().read().cen() {
            return Err(Refusal::NoSamples);
        }
        self.end();
        self.player = Player::new();
        self.pins = self.levels(0);
        (self.taken, self.stood, self.edges) = (0, 0, 0);
        RCC.ahb1enr().modify(|w| w.set_dma2en(true));
        RCC.apb1enr1().modify(|w| w.set_tim7en(true));
        RCC.ahb2enr().modify(|w| {
            w.set_dac1en(true);
            w.set_dac2en(true);
        });
        for dac in [DAC1, DAC2] {
            dac.mcr().write(|w| w.set_hfsel(OVER_160_MHZ));
            dac.dhr12r(0).write(|w| w.set_dhr(Knot::MIDDLE / 16));
            dac.cr().write(|w| w.set_en(0, true));
        }
        cortex_m::asm::delay(WAKE_UP_US * CORE_PER_US);
        for pin in [&mut self.wires.a, &mut self.wires.b] {
            pin.set_low();
            pin.set_as_output(Speed::Medium);
        }
        self.fill(0);
        self.fill(HALF);
        self.prepare_pins(true);
        for (dac, channel, request, ring) in [
            (DAC1, FORCES, REQUEST_DAC1_CH1, MEMORY.forces.get() as u32),
            (DAC2, TERMINALS, REQUEST_DAC2_CH1, MEMORY.terminals.get() as u32),
        ] {
            prepare(channel, request, dac.dhr12r(0).as_ptr() as u32, ring, Size::BITS16, true);
        }
        start_timer(TICKS);
        // Starting always takes the same time: the second pass corrects the error of the first.
        let (mut set, mut found) = (phase_ticks, 0);
        for _ in 0..2 {
            let now = TIM6.cnt().read().cnt();
            TIM7.cnt().write(|w| w.set_cnt(minus(now, set)));
            found = phase();
            set = minus(plus(set, phase_ticks), found);
        }
        // All must begin with the same event, so start them away from one.
        let _ = (0..TICKS).any(|_| (TICKS / 4..TICKS / 2).contains(&TIM7.cnt().read().cnt()));
        for dac in [DAC1, DAC2] {
            dac.cr().write(|w| {
                w.set_en(0, true);
                w.set_ten(0, true);
                w.set_tsel(0, TRIGGER_TIM7);
                w.set_dmaen(0, true);
            });
        }
        TIM7.dier().write(|w| w.set_ude(true));
        self.state = State::Knots;
        // SAFETY: the interrupt's handler fills the half that is not being read.
        unsafe { DMA2_CHANNEL1::enable() };
        Ok(u32::from(found))
    }

    /// Releases the outputs.
    fn end(&mut self) {
        if self.state == State::Off {
            return;
        }
        self.state = State::Off;
        DMA2_CHANNEL1::disable();
        halt();
        for dac in [DAC1, DAC2] {
            dac.cr().write(|_| ());
        }
        self.wires.a.set_as_analog();
        self.wires.b.set_as_analog();
        self.waiting = 0;
    }

    fn burst(&mut self, edge_ticks: u16, blocks: u16) -> Result<u32, Refusal> {
        if self.state != State::Knots || self.waiting > 0 || !self.player.stands() {
            return Err(Refusal::NotPlaying);
        }
        if !(LEAST_EDGE_TICKS..=TICKS).contains(&edge_ticks) {
            return Err(Refusal::BadSamples);
        }
        halt();
        for dac in [DAC1, DAC2] {
            // The voltages hold.
            dac.cr().write(|w| w.set_en(0, true));
        }
        // From the current count: a whole number of quadrature cycles, so the ring can be repeated.
        let count = self.player.step().count;
        // SAFETY: the DMA is stopped, and this is the one player.
        let pins = unsafe { &mut *MEMORY.pins.get() };
        for (place, at) in pins.iter_mut().zip(count + 1..) {
            *place = self.levels(at);
        }
        self.state = State::Burst(blocks);
        self.edges = 0;
        start_timer(edge_ticks);
        self.lap();
        Ok(0)
    }

    /// Outputs the ring once. It stops by itself, so that every edge is counted.
    fn lap(&mut self) {
        TIM7.cr1().write(|w| w.set_urs(Urs::COUNTER_ONLY));
        // Drops a request that arrived after the last one.
        TIM7.dier().write(|_| ());
        let State::Burst(left @ 1..) = self.state else {
            // The burst was a whole number of quadrature cycles, so the pins are as they were. The timer continues for
            // its interrupts, which make sure that the outputs are released.
            self.state = State::Stands;
            self.fill(0);
            self.fill(HALF);
            self.prepare_pins(true);
            start_timer(TICKS);
            TIM7.dier().write(|w| w.set_ude(true));
            return;
        };
        self.state = State::Burst(left - 1);
        TIM7.cnt().write(|w| w.set_cnt(0));
        self.prepare_pins(false);
        TIM7.dier().write(|w| w.set_ude(true));
        TIM7.cr1().write(|w| {
            w.set_urs(Urs::COUNTER_ONLY);
            w.set_cen(true);
        });
    }

    /// Handles a half that has been output.
    fn refill(&mut self) {
        let flags = DMA2.isr().read();
        if [PINS, FORCES, TERMINALS].into_iter().any(|channel| flags.teif(channel)) {
            // The channel has stopped for good; if it is the pins', no later interrupt could release the outputs.
            self.end();
            self.stood = Play::TRANSFER_FAILED;
            return;
        }
        let (first, second) = (flags.htif(PINS), flags.tcif(PINS));
        DMA2.ifcr().write(|w| {
            w.set_htif(PINS, first);
            w.set_tcif(PINS, second);
        });
        match self.state {
            State::Burst(_) if second => {
                self.edges = self.edges.wrapping_add(RING as u32);
                self.lap();
            }
            State::Knots => {
                // Both flags: a half was output twice. Or the DMA was too slow for a converter, which then stops for
                // good.
                let late = [DAC1, DAC2].iter().any(|dac| dac.sr().read().dmaudr(0));
                if first && second || late {
                    self.stood = self.stood.saturating_add(1);
                }
                if first {
                    self.fill(0);
                }
                if second {
                    self.fill(HALF);
                }
            }
            State::Burst(_) | State::Stands | State::Off => {}
        }
        if self.heard.elapsed() > PATIENCE {
            self.end();
        }
    }

    fn prepare_pins(&self, circular: bool) {
        let from = MEMORY.pins.get() as u32;
        prepare(PINS, REQUEST_TIM7_UPDATE, self.wires.bsrr, from, Size::BITS32, circular);
    }

    fn fill(&mut self, start: usize) {
        for place in start..start + HALF {
            if self.player.stands() && self.waiting > 0 {
                self.player.head_for(&self.knots[self.first % WAITING]);
                self.first = (self.first + 1) % WAITING;
                self.waiting -= 1;
            }
            let Step { force, terminal, count } = self.player.step();
            let levels = self.levels(count);
            let pins = core::mem::replace(&mut self.pins, levels);
            // SAFETY: the place is in the rings, the DMA is in the other half or stopped, and this is the one player.
            unsafe {
                (*MEMORY.forces.get())[place] = force;
                (*MEMORY.terminals.get())[place] = terminal;
                (*MEMORY.pins.get())[place] = pins;
            }
        }
    }

    /// The value to write to BSRR: bits to set, and above them bits to reset.
    fn levels(&self, count: i32) -> u32 {
        let (a, b) = quadrature(count);
        let of = |bit: u32, level: bool| if level { bit } else { bit << 16 };
        of(self.wires.bits.0, a) | of(self.wires.bits.1, b)
    }
}

/// Starts the timer at 0 with this period; nothing uses its updates yet.
#[inline(never)]
fn start_timer(ticks: u16) {
    TIM7.cr1().write(|w| w.set_urs(Urs::COUNTER_ONLY));
    TIM7.cr2().write(|w| w.set_mms(Mms::UPDATE));
    // Before the period, which may be shorter than the current count.
    TIM7.cnt().write(|w| w.set_cnt(0));
    TIM7.arr().write(|w| w.set_arr(ticks - 1));
    TIM7.cr1().write(|w| {
        w.set_urs(Urs::COUNTER_ONLY);
        w.set_cen(true);
    });
}

/// Stops timer and DMA, after the transfers in progress.
#[inline(never)]
fn halt() {
    TIM7.cr1().write(|_| ());
    cortex_m::asm::delay(CORE_PER_US);
    TIM7.dier().write(|_| ());
    for channel in [PINS, FORCES, TERMINALS] {
        DMA2.ch(channel).cr().write(|_| ());
    }
}

fn plus(a: u16, b: u16) -> u16 {
    if a + b >= TICKS { a + b - TICKS } else { a + b }
}

fn minus(a: u16, b: u16) -> u16 {
    if a >= b { a - b } else { a + TICKS - b }
}

/// The present lag of TIM7 behind TIM6: the mean of two readings, one before and one after, cancels the time between
/// them.
#[inline(never)]
fn phase() -> u16 {
    let (before, sampling, after) = (TIM7.cnt().read().cnt(), TIM6.cnt().read().cnt(), TIM7.cnt().read().cnt());
    minus(sampling, plus(before, minus(after, before) / 2))
}

#[inline(never)]
fn prepare(channel: usize, request: u8, to: u32, from: u32, size: Size, circular: bool) {
    DMA2.ch(channel).cr().write(|_| ());
    DMA2.ifcr().write(|w| {
        w.set_gif(channel, true);
        w.set_tcif(channel, true);
        w.set_htif(channel, true);
        w.set_teif(channel, true);
    });
    DMAMUX1.ccr(MUX + channel).write(|w| w.set_dmareq_id(request));
    DMA2.ch(channel).par().write_value(to);
    DMA2.ch(channel).mar().write_value(from);
    DMA2.ch(channel).ndtr().write(|w| w.set_ndt(RING as u16));
    let interrupts = channel == PINS;
    DMA2.ch(channel).cr().write(|w| {
        w.set_dir(Dir::FROM_MEMORY);
        w.set_circ(circular);
        w.set_minc(true);
        // A converter's register accepts only words.
        w.set_psize(Size::BITS32);
        w.set_msize(size);
        w.set_pl(Pl::HIGH);
        w.set_htie(interrupts && circular);
        w.set_tcie(interrupts);
        w.set_teie(interrupts);
        w.set_en(true);
    });
}
