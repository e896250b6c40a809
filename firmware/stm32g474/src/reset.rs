//! Why the device started, and the actions that follow before anything else runs.
//!
//! - Two presses of the reset button within half a second, or a command, start the ROM's update mode (DFU).
//! - The ROM's update mode starts the new firmware by a jump; a reset then puts the chip in the state that the firmware
//!   expects, unless the option bytes lead every reset into the ROM. In that case they are changed first
//!   (`options.rs`); if that was tried or the watchdog caused a reset, the ROM's changes are undone by hand until the
//!   next start. The same happens if a reset was tried and the start still looks like a jump: no state of the chip may
//!   cause endless resets. AN2606 says that the ROM restores no register before the jump, AN3155 that it does, so
//!   nothing is assumed: a jump leaves the vectors, address 0, the protection unit or the clocks in a state other than
//!   after a reset, or exactly as a reset does.
//! - A firmware that keeps failing at its start ignores the saved settings, and finally enters update mode. Panics and
//!   faults increment the count, and the watchdog is recognised by its flag; a reset by a probe does not count.
//!
//! Sources: RM0440 7.4.30 (reset flags), 10.2.1 (MEM_MODE); AN2606 (system memory boot mode); PM0214 4.4.4 (VTOR).

use crate::{clocks, options};
use core::arch::global_asm;
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::peripheral::SCB;
use embassy_stm32::pac::rcc::vals::Sw;
use embassy_stm32::pac::{RCC, SYSCFG};
use embassy_time::{Instant, Timer};
use inerter_app::wear::SAVES;
use inerter_wire::ResetCause;

/// Vector table of the ROM (RM0440, table 4).
const ROM: *const u32 = 0x1FFF_0000 as *const u32;
/// Time within which a second press of the button counts.
const DOUBLE_PRESS: Instant = Instant::from_millis(500);
/// A run that reaches this time has not failed at its start.
const GOOD_RUN: Instant = Instant::from_secs(10);
/// Consecutive failed starts after which the saved settings are ignored, because they may be the cause.
const SUSPECTS_SETTINGS: u32 = 3;
/// Consecutive failed starts after which the device waits for another firmware.
const GIVES_UP: u32 = 6;

// Runs before memory is initialised, which must not depend on the state after the jump: with the protection unit still
// on, the first write would fault, with the ROM's handlers. Uses no stack, because nothing is known about it.
global_asm!(
    ".section .text.__pre_init,\"ax\",%progbits",
    ".global __pre_init",
    ".type __pre_init,%function",
    ".thumb_func",
    "__pre_init:",
    // MPU_CTRL.
    "ldr r0, =0xE000ED94",
    "ldr r1, [r0]",
    "cmp r1, #0",
    "bne 2f",
    // VTOR: 0 after a reset, or flash if already set.
    "ldr r0, =0xE000ED08",
    "ldr r1, [r0]",
    "bics r1, r1, #0x08000000",
    "bne 2f",
    // SYSCFG_MEMRMP.MEM_MODE, with its clock (APB2ENR.SYSCFGEN) temporarily on.
    "ldr r0, =0x40021060",
    "ldr r1, [r0]",
    "orr r2, r1, #1",
    "str r2, [r0]",
    "ldr r2, [r0]",
    "ldr r2, =0x40010000",
    "ldr r2, [r2]",
    "str r1, [r0]",
    "ands r2, r2, #7",
    "bne 2f",
    // Undoes what the ROM may have changed in the core: interrupts enabled and pending, SysTick, masks, its stack.
    "4:",
    "movs r1, #0",
    "ldr r0, =0xE000E010",
    "str r1, [r0]",
    "mvn r2, r1",
    "ldr r0, =0xE000E180",
    "str r2, [r0]",
    "str r2, [r0, #4]",
    "str r2, [r0, #8]",
    "str r2, [r0, #12]",
    "ldr r0, =0xE000E280",
    "str r2, [r0]",
    "str r2, [r0, #4]",
    "str r2, [r0, #8]",
    "str r2, [r0, #12]",
    // ICSR: PENDSVCLR and PENDSTCLR.
    "ldr r0, =0xE000ED04",
    "ldr r2, =0x0A000000",
    "str r2, [r0]",
    "dsb",
    "msr basepri, r1",
    "msr control, r1",
    "isb",
    "cpsie f",
    "cpsie i",
    // The first write to each cut of SRAM1 and SRAM2 may be lost (ES0430 2.2.7). The first cut has parity, if the
    // option bytes enable it, and must not be read before it is written: it is written twice, because start-up fills
    // this location later. The others keep their contents.
    "ldr r0, =0x20000000",
    "str r1, [r0]",
    "dsb",
    "str r1, [r0]",
    "ldr r0, =0x20008000",
    "ldr r1, [r0]",
    "str r1, [r0]",
    "ldr r0, =0x20010000",
    "ldr r1, [r0]",
    "str r1, [r0]",
    "ldr r0, =0x20014000",
    "ldr r1, [r0]",
    "str r1, [r0]",
    "dsb",
    "bx lr",
    // A jump. RCC_CSR.SFTRSTF: has a reset already been tried, with this result?
    "2:",
    "ldr r0, =0x40021094",
    "ldr r1, [r0]",
    "tst r1, #0x10000000",
    "bne 5f",
    // FLASH_OPTR: does a reset lead back to the ROM? BFB2, or nSWBOOT0 and nBOOT0 both 0.
    "ldr r0, =0x40022020",
    "ldr r1, [r0]",
    "tst r1, #0x00100000",
    "bne 5f",
    "tst r1, #0x0C000000",
    "bne 6f",
    // It does: undo by hand. Protection unit off, address 0 and vectors in flash.
    "5:",
    "movs r1, #0",
    "ldr r0, =0xE000ED94",
    "str r1, [r0]",
    "ldr r0, =0x40021060",
    "ldr r2, [r0]",
    "orr r2, r2, #1",
    "str r2, [r0]",
    "ldr r2, [r0]",
    "ldr r0, =0x40010000",
    "str r1, [r0]",
    "ldr r0, =0xE000ED08",
    "str r1, [r0]",
    "dsb",
    "isb",
    "b 4b",
    // AIRCR.SYSRESETREQ.
    "6:",
    "ldr r0, =0xE000ED0C",
    "ldr r1, =0x05FA0004",
    "dsb",
    "str r1, [r0]",
    "dsb",
    "3:",
    "b 3b",
    ".size __pre_init, . - __pre_init",
);

/// RCC_CSR as this start found it.
static FLAGS: AtomicU32 = AtomicU32::new(0);

/// RCC_CSR as this start found it.
pub fn flags() -> u32 {
    FLAGS.load(Ordering::Relaxed)
}

/// A message from one run to the next.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
enum Note {
    Nothing = 0,
    /// The button was pressed a moment ago.
    Pressed = 0x5052_4553,
    /// Update mode is wanted.
    Update = 0x4446_5521,
}

/// A word of RAM that start-up does not touch, so it survives a reset; arbitrary after power-on.
struct Word(UnsafeCell<MaybeUninit<u32>>);

// SAFETY: read and written whole, from thread mode, or where nothing else runs any more.
unsafe impl Sync for Word {}

impl Word {
    const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    fn get(&self) -> u32 {
        // SAFETY: a word for which every content is valid; volatile, because the previous run wrote it.
        unsafe { ptr::read_volatile(self.0.get().cast()) }
    }

    fn set(&self, value: u32) {
        // SAFETY: as above; volatile, because the next run reads it.
        unsafe { ptr::write_volatile(self.0.get().cast(), value) };
    }

    /// The low byte, if the rest is this.
    fn byte_after(&self, magic: u32) -> Option<u8> {
        let word = self.get();
        (word & !0xFF == magic).then_some(word as u8)
    }
}

/// A [`Note`].
#[unsafe(link_section = ".uninit.note")]
static NOTE: Word = Word::new();

/// [`STARTS_MAGIC`] and, in the low byte, how many consecutive runs have ended too early.
#[unsafe(link_section = ".uninit.starts")]
static STARTS: Word = Word::new();
const STARTS_MAGIC: u32 = 0x5354_5200;

/// [`SAVES_MAGIC`] and, in the low byte, how many saves a run has left.
#[unsafe(link_section = ".uninit.saves")]
static SAVES_LEFT: Word = Word::new();
const SAVES_MAGIC: u32 = 0x5341_5600;

/// The saves left by the previous run, if it ended by a request; returned once.
fn take_saves_left(cause: ResetCause) -> u8 {
    let left = SAVES_LEFT.byte_after(SAVES_MAGIC);
    // Cleared, so that a later start that nobody requested does not find it.
    SAVES_LEFT.set(0);
    let asked = matches!(cause, ResetCause::Software | ResetCause::Watchdog);
    left.filter(|_| asked).unwrap_or(SAVES)
}

fn set_failed_starts(number: u32) {
    STARTS.set(STARTS_MAGIC | number.min(0xFF));
}

fn failed_starts() -> u32 {
    STARTS.byte_after(STARTS_MAGIC).unwrap_or(0).into()
}

/// Notes that this run ends by a panic or a fault.
pub fn note_failure() {
    set_failed_starts(failed_starts() + 1);
}

/// What is known about a start.
#[derive(Clone, Copy)]
pub struct Started {
    /// Why the device started.
    pub cause: ResetCause,
    /// Whether the previous runs ended so early and so often that the saved settings may be the cause.
    pub suspects_settings: bool,
    /// Saves that the flash may take now.
    pub saves_left: u8,
}

fn set_note(note: Note) {
    NOTE.set(note as u32);
}

fn note_is(note: Note) -> bool {
    NOTE.get() == note as u32
}

/// Finds out why the device started. Must be called first of all; may not return.
pub fn begin() -> Started {
    if RCC.cfgr().read().sws() != Sw::HSI || RCC.crrcr().read().hsi48on() {
        // Started by a jump (see `__pre_init`), with the ROM's clocks.
        if !options::start_in_rom() && !RCC.csr().read().sftrstf() {
            SCB::sys_reset();
        }
        clocks::stop();
    }
    let flags = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    FLAGS.store(flags.0, Ordering::Relaxed);
    // The pin's flag is set along with each of the others, because the chip pulls the pin low itself.
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
    let failed = match cause {
        ResetCause::Watchdog => failed_starts() + 1,
        // A panic has already been counted; a requested restart has cleared the number; a probe's reset changes
        // nothing.
        ResetCause::Software => failed_starts(),
        _ => 0,
    };
    set_failed_starts(failed);
    let by_itself = matches!(cause, ResetCause::Software | ResetCause::Watchdog);
    let pressed = note_is(Note::Pressed);
    let again = pressed && cause == ResetCause::Pin;
    let wanted = note_is(Note::Update) && cause == ResetCause::Software;
    // A press is remembered across restarts that nobody requested; otherwise two presses could not break an endless
    // series of them.
    set_note(if cause == ResetCause::Pin || pressed && by_itself { Note::Pressed } else { Note::Nothing });
    if again || wanted || failed >= GIVES_UP {
        set_note(Note::Nothing);
        set_failed_starts(0);
        enter_rom();
    }
    Started { cause, suspects_settings: failed >= SUSPECTS_SETTINGS, saves_left: take_saves_left(cause) }
}

/// Clears the memory of a button press after its time, and the count of failed starts after a good run.
pub async fn forget() {
    Timer::at(DOUBLE_PRESS).await;
    if note_is(Note::Pressed) {
        set_note(Note::Nothing);
    }
    Timer::at(GOOD_RUN).await;
    set_failed_starts(0);
}

/// Leaves a message to the next run, which was requested: not a failed start.
fn leave(note: Note, saves_left: u8) {
    SAVES_LEFT.set(SAVES_MAGIC | u32::from(saves_left));
    set_note(note);
    set_failed_starts(0);
}

/// Restarts, with this many saves left.
pub fn restart(saves_left: u8) -> ! {
    leave(Note::Nothing, saves_left);
    SCB::sys_reset()
}

/// Does nothing more, with this many saves left, until the watchdog resets the chip. For the watchdog's test, so not a
/// failed start.
pub fn hang(saves_left: u8) -> ! {
    leave(Note::Nothing, saves_left);
    loop {
        cortex_m::asm::nop();
    }
}

/// Restarts into the ROM's update mode.
pub fn update(saves_left: u8) -> ! {
    leave(Note::Update, saves_left);
    SCB::sys_reset()
}

/// Everything is as after a reset, with the protection unit off and VTOR 0: the ROM starts as if selected by the boot
/// pin.
fn enter_rom() -> ! {
    RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    // The ROM at address 0 (RM0440, 10.2.1: 001).
    SYSCFG.memrmp().modify(|w| w.set_mem_mode(1));
    // SAFETY: ROM is a vector table: stack pointer and reset vector of the chip's own update mode.
    unsafe { cortex_m::asm::bootload(ROM) }
}
