//! How deep the stack has reached: it is painted before `main`.

use core::ptr;
use cortex_m_rt::STACK_PAINT_VALUE;

// SAFETY: both symbols come from the linker script of cortex-m-rt; only their addresses are used.
unsafe extern "C" {
    static mut _stack_start: u32;
    static mut _stack_end: u32;
}

/// Stack never used so far, in bytes.
pub fn free_bytes() -> u32 {
    let mut word = ptr::addr_of!(_stack_end);
    let top = ptr::addr_of!(_stack_start);
    let mut bytes = 0;
    // SAFETY: the linker script puts whole, aligned words of RAM between the two symbols; reading them is harmless.
    while word < top && unsafe { ptr::read_volatile(word) } == STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
        bytes += 4;
    }
    bytes
}

/// All of the stack, in bytes.
pub fn total_bytes() -> u32 {
    (ptr::addr_of!(_stack_start) as usize - ptr::addr_of!(_stack_end) as usize) as u32
}
