//! The stack: how deep it has reached (it is painted before `main`), and a guard below it.

use core::ptr;
use cortex_m::peripheral::MPU;
use cortex_m_rt::STACK_PAINT_VALUE;

// SAFETY: both symbols come from the linker script of cortex-m-rt; only their addresses are used.
unsafe extern "C" {
    static mut _stack_start: u32;
    static mut _stack_end: u32;
}

/// Size of the guard: more stack than the fault handler needs, because the guard does not stop that handler.
const GUARD: u32 = 1024;
/// RASR: no execution, no access, size 2^(9+1), enabled (ARMv7-M, B3.5.9).
const NO_ACCESS: u32 = 1 << 28 | 9 << 1 | 1;
/// CTRL: enabled, with the default map elsewhere; not in fault handlers.
const ENABLE: u32 = 1 << 2 | 1;

/// Turns a stack overflow into a fault at the stack's end, instead of a change in other memory.
///
/// Called only once it is certain that this run does not enter the ROM: the ROM's program uses the same memory, and
/// only a reset removes the guard.
pub fn guard(mpu: &mut MPU) {
    // SAFETY: the region is above all static memory and below the stack used so far.
    unsafe {
        mpu.rnr.write(0);
        mpu.rbar.write(guard_start());
        mpu.rasr.write(NO_ACCESS);
        mpu.ctrl.write(ENABLE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// The first multiple of the guard's size above the static memory.
fn guard_start() -> u32 {
    (ptr::addr_of!(_stack_end) as u32).next_multiple_of(GUARD)
}

/// Size of the whole stack, in bytes.
pub fn bytes() -> u32 {
    ptr::addr_of!(_stack_start) as u32 - (guard_start() + GUARD)
}

/// Stack never used so far, in bytes.
pub fn free_bytes() -> u32 {
    let mut word = (guard_start() + GUARD) as *const u32;
    let top = ptr::addr_of!(_stack_start);
    let mut bytes = 0;
    // SAFETY: whole, aligned words of RAM between the guard and the start of the stack; reading them is harmless.
    while word < top && unsafe { ptr::read_volatile(word) } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
        bytes += 4;
    }
    bytes
}
