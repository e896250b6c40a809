//! What the board measures about itself on request: raw numbers, which the host evaluates.
//!
//! All of it runs in thread mode. Waits for hardware poll a bounded number of times; if nothing happens, they block the
//! other thread-mode tasks for tens of ms, while sampling continues at its higher priority. Missing values are left
//! out.
//!
//! TIM5 counts the core's clock meanwhile: the cycle counter may stop while the core sleeps. Its first input latches
//! the edges of the 32 kHz oscillator (RM0440 29.4.25, TI1SEL), one in eight.

use crate::boards::clock::{CORE_HZ, CORE_PER_US};
use crate::temperature::{self, Sensor};
use crate::{executor, flash, options, reset, stack, work};
use core::ptr;
use embassy_stm32::pac::timer::vals::CcmrInputCcs;
use embassy_stm32::pac::{CRS, DBGMCU, RCC, TIM5, USB};
use embassy_time::{Instant, Timer};
use inerter_wire::{Measure, Measured, Quantity};

/// Package register (RM0440 48.3).
const PACKAGE: *const u32 = 0x1FFF_7500 as *const u32;
/// TIM5_TISEL.TI1SEL: the 32 kHz oscillator (RM0440 table 294).
const FROM_LSI: u8 = 1;
/// Edges of the 32 kHz oscillator per latched one, and CCMR1.IC1PSC for it.
const LATCHED_ONE_IN: u32 = 8;
const ONE_IN_8: u8 = 3;
/// Number of latched edges examined: 4 ms.
const LATCHED_EDGES: u32 = 16;
/// Polls of the hardware, of at least 10 cycles each: 2 ms, in which a USB frame and an edge must occur.
const LOOKS: u32 = 200 * CORE_PER_US;
/// Two polls this close together were not interrupted.
const CLOSE: u32 = 2 * CORE_PER_US;

/// Measures `what`; measurements over time take a second.
pub async fn measure(what: Measure, sensor: &mut Sensor) -> Measured {
    let mut measured = Measured::new(what);
    match what {
        Measure::Chip => chip(&mut measured),
        Measure::Clocks => clocks(&mut measured).await,
        Measure::Supply => supply(&mut measured, sensor),
        Measure::Work => work(&mut measured).await,
        // Handled where restarts are handled.
        Measure::Hang => {}
    }
    measured
}

fn chip(measured: &mut Measured) {
    let (options, wanted) = options::in_use_and_wanted();
    // SAFETY: a constant of the chip, in its system memory.
    let package = unsafe { ptr::read(PACKAGE) };
    for (quantity, value) in [
        (Quantity::DeviceId, DBGMCU.idcode().read().0),
        (Quantity::FlashKb, flash::size_kb().into()),
        (Quantity::Package, package),
        (Quantity::OptionBytes, options),
        (Quantity::OptionBytesWanted, wanted),
        (Quantity::ResetFlags, reset::flags()),
        (Quantity::StackBytes, stack::bytes()),
        (Quantity::StackFreeBytes, stack::free_bytes()),
    ] {
        measured.push(quantity, value);
    }
}

async fn clocks(measured: &mut Measured) {
    critical_section::with(|_| RCC.apb1enr1().modify(|w| w.set_tim5en(true)));
    TIM5.tisel().write(|w| w.set_tisel(0, FROM_LSI));
    TIM5.ccmr_input(0).modify(|w| {
        w.set_ccs(0, CcmrInputCcs::TI4);
        w.set_icpsc(0, ONE_IN_8);
    });
    TIM5.ccer().modify(|w| w.set_cce(0, true));
    TIM5.cr1().modify(|w| w.set_cen(true));
    measured.push(Quantity::CoreHz, CORE_HZ);
    let times = || critical_section::with(|_| (Instant::now().as_micros() as u32, TIM5.cnt().read()));
    let (first_us, first) = times();
    let first_frame = frame();
    Timer::after_secs(1).await;
    if let Some(((number, begin), (last_number, end))) = first_frame.zip(frame()) {
        measured.push(Quantity::UsbFrames, u32::from(last_number.wrapping_sub(number) & FRAMES));
        measured.push(Quantity::UsbFramesCycles, end.wrapping_sub(begin));
    }
    let (last_us, last) = times();
    measured.push(Quantity::ClockUs, last_us.wrapping_sub(first_us));
    measured.push(Quantity::ClockUsCycles, last.wrapping_sub(first));
    let (mut periods, mut cycles) = (0, 0);
    for _ in 0..LATCHED_EDGES {
        if let Some(between) = between_edges() {
            periods += LATCHED_ONE_IN;
            cycles += between;
        }
    }
    measured.push(Quantity::LsiPeriods, periods);
    measured.push(Quantity::LsiPeriodsCycles, cycles);
    measured.push(Quantity::ClockControl, RCC.cr().read().0);
    measured.push(Quantity::RecoveryStatus, CRS.isr().read().0);
    TIM5.cr1().modify(|w| w.set_cen(false));
    critical_section::with(|_| RCC.apb1enr1().modify(|w| w.set_tim5en(false)));
}

/// USB_FNR.FN: the frame number has 11 bits.
const FRAMES: u16 = 0x7FF;

/// The number of the next USB frame that begins while nothing interrupts, and its time by TIM5.
fn frame() -> Option<(u16, u32)> {
    let look = || (USB.fnr().read().fn_(), TIM5.cnt().read());
    let (mut number, mut at) = look();
    for _ in 0..LOOKS {
        let (next, now) = look();
        if next != number && now.wrapping_sub(at) < CLOSE {
            return Some((next, now));
        }
        (number, at) = (next, now);
    }
    None
}

/// Time between two latched edges of the 32 kHz oscillator; `None` if one between them was missed.
fn between_edges() -> Option<u32> {
    TIM5.sr().write_value(Default::default());
    let edge = || {
        let latched = (0..LOOKS).any(|_| TIM5.sr().read().ccif(0));
        // Reading clears the flag.
        let at = TIM5.ccr(0).read();
        (latched && !TIM5.sr().read().ccof(0)).then_some(at)
    };
    let first = edge()?;
    Some(edge()?.wrapping_sub(first))
}

fn supply(measured: &mut Measured, sensor: &mut Sensor) {
    if let Some((temperature, reference)) = sensor.codes() {
        measured.push(Quantity::TemperatureCode, temperature.into());
        measured.push(Quantity::ReferenceCode, reference.into());
    }
    let [at_30, at_130, reference] = temperature::factory();
    measured.push(Quantity::TemperatureFactory30Code, at_30.into());
    measured.push(Quantity::TemperatureFactory130Code, at_130.into());
    measured.push(Quantity::ReferenceFactoryCode, reference.into());
}

async fn work(measured: &mut Measured) {
    let look = || (Instant::now().as_micros() as u32, executor::idle_us() as u32, work::cycles());
    let (begin_us, begin_idle_us, before) = look();
    Timer::after_secs(1).await;
    let (end_us, end_idle_us, after) = look();
    measured.push(Quantity::WorkUs, end_us.wrapping_sub(begin_us));
    measured.push(Quantity::IdleUs, end_idle_us.wrapping_sub(begin_idle_us));
    let quantities = [
        Quantity::SamplingCycles,
        Quantity::EstimatingCycles,
        Quantity::TelemetryCycles,
        Quantity::CommandsCycles,
        Quantity::UsbCycles,
        Quantity::SupervisingCycles,
    ];
    for ((quantity, before), after) in quantities.into_iter().zip(before).zip(after) {
        measured.push(quantity, after.wrapping_sub(before));
    }
}
