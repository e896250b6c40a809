//! Why the device started, and what is decided by that before anything else runs.
//!
//! - Two presses of the reset button within half a second, or a command, lead into the ROM's update mode (DFU).
//! - The ROM's update mode starts the new firmware without a reset; a reset then gives it the chip as it expects it.
//!
//! Sources: RM0440 7.4.30 (reset flags), AN2606 (system memory boot mode).

use core::mem::MaybeUninit;
use core::ptr;
use cortex_m::peripheral::SCB;
use embassy_stm32::pac::rcc::vals::Sw;
use embassy_stm32::pac::{RCC, SYSCFG};
use embassy_time::Timer;
use inerter_wire::ResetCause;

/// Vector table of the ROM (RM0440, table 4).
const ROM: *const u32 = 0x1FFF_0000 as *const u32;
/// Time within which a second press of the button counts.
const DOUBLE_PRESS_MS: u64 = 500;

/// What a run leaves behind for the next one.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
enum Note {
    Nothing = 0,
    /// The button was pressed a moment ago.
    Pressed = 0x5052_4553,
    /// Update mode is wanted.
    Update = 0x4446_5521,
}

/// Not touched by start-up, so it outlives a reset; after power came it is anything.
#[unsafe(link_section = ".uninit.note")]
static mut NOTE: MaybeUninit<u32> = MaybeUninit::uninit();

fn set_note(note: Note) {
    // SAFETY: one word, written whole, from thread mode only.
    unsafe { ptr::write_volatile(ptr::addr_of_mut!(NOTE).cast(), note as u32) };
}

fn note_is(note: Note) -> bool {
    // SAFETY: one word of RAM, for which every content is valid; volatile, as the run before wrote it.
    note as u32 == unsafe { ptr::read_volatile(ptr::addr_of!(NOTE).cast()) }
}

/// Finds out why the device started. To be called first of all; may not return.
pub fn begin() -> ResetCause {
    if RCC.cfgr().read().sws() != Sw::HSI || RCC.crrcr().read().hsi48on() {
        // Started by a jump, and the clocks are the ROM's.
        SCB::sys_reset();
    }
    let flags = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    // The pin's flag is set with each of the others, as the chip pulls it down itself.
    let cause = if flags.borrstf() {
        ResetCause::PowerOn
    } else if flags.iwdgrstf() {
        ResetCause::Watchdog
    } else if flags.wwdgrstf() {
        ResetCause::WindowWatchdog
    } else if flags.lpwrrstf() {
        ResetCause::LowPower
    } else if flags.oblrstf() {
        ResetCause::OptionBytes
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    };
    let again = note_is(Note::Pressed) && cause == ResetCause::Pin;
    let wanted = note_is(Note::Update) && cause == ResetCause::Software;
    set_note(if cause == ResetCause::Pin { Note::Pressed } else { Note::Nothing });
    if again || wanted {
        set_note(Note::Nothing);
        enter_rom();
    }
    cause
}

/// Forgets the press of the button in time.
pub async fn forget_press() {
    Timer::after_millis(DOUBLE_PRESS_MS).await;
    if note_is(Note::Pressed) {
        set_note(Note::Nothing);
    }
}

/// Restarts.
pub fn restart() -> ! {
    SCB::sys_reset()
}

/// Restarts into the ROM's update mode.
pub fn update() -> ! {
    set_note(Note::Update);
    SCB::sys_reset()
}

/// Everything is as after a reset: the ROM can start as if it had been chosen by the boot pin.
fn enter_rom() -> ! {
    RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    // The ROM at address 0 (RM0440, 10.2.1: 001).
    SYSCFG.memrmp().modify(|w| w.set_mem_mode(1));
    // SAFETY: ROM is a vector table: stack pointer and reset vector of the chip's own update mode.
    unsafe { cortex_m::asm::bootload(ROM) }
}
