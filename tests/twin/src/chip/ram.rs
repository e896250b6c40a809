//! Memory that both the emulated core and the DMA models access.

use std::{alloc, ptr::NonNull};

/// Bytes at a fixed address, shared with unicorn through a pointer.
///
/// No reference to the memory exists while the core runs: the core's loads and stores happen inside unicorn, ours
/// between its runs, in one thread.
#[derive(Debug)]
pub struct Ram {
    bytes: NonNull<u8>,
    layout: alloc::Layout,
}

/// Page alignment on the host, which unicorn requires.
const PAGE: usize = 4096;

impl Ram {
    /// Allocates `len` bytes, all set to `value`.
    ///
    /// # Panics
    /// If `len` is zero or too large for an allocation. Running out of memory aborts.
    pub fn new(len: usize, value: u8) -> Self {
        assert!(len > 0, "memory of length 0");
        let layout = alloc::Layout::from_size_align(len, PAGE).expect("valid allocation size");
        // SAFETY: the layout's size is not zero.
        let bytes = unsafe { alloc::alloc_zeroed(layout) };
        let Some(bytes) = NonNull::new(bytes) else { alloc::handle_alloc_error(layout) };
        let mut ram = Self { bytes, layout };
        ram.bytes_mut().fill(value);
        ram
    }

    /// The whole memory.
    pub fn bytes(&self) -> &[u8] {
        // SAFETY: allocated and initialised by `new` with this length, freed by `drop` only; the core does not run
        // meanwhile.
        unsafe { std::slice::from_raw_parts(self.bytes.as_ptr(), self.layout.size()) }
    }

    /// The whole memory, mutable.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as in `bytes`, and the borrow of `self` is exclusive.
        unsafe { std::slice::from_raw_parts_mut(self.bytes.as_ptr(), self.layout.size()) }
    }

    /// Address in host memory, for unicorn. Valid as long as `self`.
    pub fn as_ptr(&self) -> *mut u8 {
        self.bytes.as_ptr()
    }
}

/// The next number, and state, of what memory holds that has lost its power: xorshift64 (Marsaglia 2003). The quality
/// does not matter, but the sequence must repeat.
pub fn xorshift(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

impl Drop for Ram {
    fn drop(&mut self) {
        // SAFETY: allocated by `new` with this layout, once.
        unsafe { alloc::dealloc(self.bytes.as_ptr(), self.layout) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_bytes_on_a_page_of_its_own() {
        let mut ram = Ram::new(8192, 0xa5);
        assert_eq!(ram.as_ptr() as usize % PAGE, 0);
        assert!(ram.bytes().iter().all(|&byte| byte == 0xa5));
        ram.bytes_mut()[8191] = 1;
        assert_eq!((ram.bytes()[8190], ram.bytes()[8191]), (0xa5, 1));
    }
}
